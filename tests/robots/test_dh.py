"""Denavit-Hartenberg arms: conventions, files, and what is published of built-in ones."""

import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from khosla import close, dh_from_robot, frames
from known_arms import Call
from marks import refused

from excitant.exceptions import BadRobot
from excitant.robots import Limits, Motion, Robot, load_robot, rigid_body_torque
from excitant.robots.dh import CONVENTIONS, robot_from_dh
from excitant.robots.geometry import scene
from excitant.robots.schema import CylinderRecord
from excitant.robots.urdf import robot_from_urdf


@given(seed=st.integers(0, 2**32 - 1), convention=st.sampled_from(CONVENTIONS))
def test_a_link_is_four_elementary_motions(random_chain: Call, seed: int, convention: str) -> None:
    chain = random_chain(seed, 3, convention)
    q = np.random.default_rng(seed).standard_normal((1, 3))
    for i in range(3):
        turn, slide = (q[0, i], 0.0) if chain.revolute[i] else (0.0, q[0, i])
        z = pin.exp6(np.array([0, 0, chain.d[i] + slide, 0, 0, chain.theta[i] + turn]))
        x = pin.exp6(np.array([chain.a[i], 0, 0, chain.alpha[i], 0, 0]))
        expected = (z * x if convention == "standard" else x * z).homogeneous
        assert np.allclose(chain.poses(q)[0, i], expected, rtol=0, atol=1e-13)


@pytest.mark.parametrize("name", ["a", "phi", "gravity", "tool"])
def test_a_chain_never_changes(random_chain: Call, name: str) -> None:
    with pytest.raises(ValueError, match="read-only"):
        getattr(random_chain(0, 3), name)[0] = 1


def test_a_link_without_mass_is_refused_by_name(random_chain: Call) -> None:
    chain = random_chain(0, 3)
    phi = np.where(np.arange(30) == 10, 0.0, chain.phi)
    refused("link 'l1' has no mass", robot_from_dh, replace(chain, phi=phi), error=BadRobot)


def test_limits_and_shapes_are_in_the_urdf(random_chain: Call) -> None:
    bodies = [
        CylinderRecord((0, 0, -0.3), (0, 0, 0), 0.1),
        CylinderRecord((-0.2, 0.1, 0), (0, 0, 0.1), 0.05),
        CylinderRecord((0, 0, 0.1), (0, 0, 0.1), 0.04),
    ]
    shapes = ((bodies[0],), (), (bodies[1],), (), (bodies[2],))
    revolute, inf = np.array([True, True, False, False]), np.inf
    position = np.array([[-1, 2], [-inf, inf], [0.1, 0.4], [-inf, inf]])
    limits = Limits(position, [1, 2, inf, 3], np.full(4, inf), [5, inf, 6, 7])
    chain = replace(random_chain(4, 4), revolute=revolute, shapes=shapes)
    again = robot_from_urdf(robot_from_dh(chain, limits).urdf, source="written")
    for name in ("position", "velocity", "torque"):
        assert np.array_equal(getattr(again.limits, name), getattr(limits, name)), name
    root = ET.fromstring(again.urdf)
    kinds = [joint.get("type") for joint in root.findall("joint")]
    assert kinds == ["revolute", "continuous", "prismatic", "prismatic", "fixed"]
    found = {link.get("name"): len(link.findall("collision")) for link in root.findall("link")}
    assert [found[name] for name in ("base", "l0", "l1", "l2", "l3")] == [1, 0, 1, 0, 1]


@pytest.mark.parametrize("convention", CONVENTIONS)
def test_shapes_move_with_their_links(random_chain: Call, convention: str) -> None:
    """Ends of a body placed by the chain's frames are where the URDF's geometry has them."""
    still = CylinderRecord((0.5, 0, 0), (0.5, 0, 0), 0.01)
    ball = CylinderRecord((0.1, -0.2, 0.3), (0.1, -0.2, 0.3), 0.02)
    chain = random_chain(6, 3, convention)
    chain = replace(chain, shapes=((still,), (), (), (ball,)), base=np.eye(4))
    q = np.random.default_rng(0).uniform(-1, 1, (5, 3))
    view = scene(robot_from_dh(chain))
    assert view is not None
    centre = (frames(chain, q)[:, 3] @ np.array([*ball.start, 1.0]))[:, :3]
    expected = np.linalg.norm(centre - [0.5, 0, 0], axis=1) - 0.03
    assert np.allclose(view.distances(q)[:, 0], expected, atol=1e-7)


@pytest.fixture
def loaded(tmp_path: Path) -> Call:
    """``loaded(entries)``: the arm of a robot.yaml."""

    def load(entries: Any) -> Robot:
        path = tmp_path / "robot.yaml"
        path.write_text(yaml.safe_dump(entries))
        return load_robot(path)

    return load


@pytest.fixture
def drill() -> Any:
    return yaml.safe_load((Path(__file__).parent / "data" / "drill.yaml").read_text("utf-8"))


def tip(robot: Robot, q: np.ndarray) -> np.ndarray:
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    return np.array(data.oMf[robot.tip].translation)


def test_robot_yaml_in_denavit_hartenberg_form(loaded: Call, drill: Any) -> None:
    robot = loaded(drill)
    assert (robot.name, robot.effects[0].joints) == ("drill", ("quill",))
    assert robot.joints == ("shoulder", "joint2", "quill")
    assert robot.links == ("upper", "link2", "link3")
    numbers = robot.gravity, robot.revolute, robot.limits.torque
    expected = [0, 0, -9.8], [True, True, False], [50, 30, 100]
    assert tuple(x.tolist() for x in numbers) == expected
    elbow, wrist = np.radians([90, 120])
    x = 0.4 * np.cos(elbow) + 0.3 * np.cos(wrist)
    y = 0.4 * np.sin(elbow) + 0.3 * np.sin(wrist)
    assert np.allclose(tip(robot, np.zeros(3)), [x, y, 0.5 + 0.1 - 0.1], rtol=0, atol=1e-12)
    again = robot_from_urdf(robot.description, source="again", gravity=robot.gravity)
    assert np.array_equal(again.limits.position, robot.limits.position)
    assert np.array_equal(again.phi, robot.phi)
    assert scene(robot) is not None


def test_inertia_about_frame_or_centre_of_mass_is_the_same_arm(loaded: Call, drill: Any) -> None:
    """Link 1 of the file by Steiner's theorem, with mc for com."""
    expected, link = loaded(drill).phi, drill["dh"][0]
    c, m, central = np.array(link.pop("com")), link["m"], link.pop("Ic")
    tensor = m * (c @ c * np.eye(3) - np.outer(c, c))
    rows = {"xx": (0, 0), "yy": (1, 1), "zz": (2, 2), "xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}
    link["mc"] = (m * c).tolist()
    link["I"] = {key: central.get(key, 0.0) + float(tensor[k]) for key, k in rows.items()}
    assert np.allclose(loaded(drill).phi, expected, rtol=0, atol=1e-13)


def test_angles_are_radians_unless_said(loaded: Call, drill: Any) -> None:
    expected = tip(loaded(drill), np.full(3, 0.2))
    del drill["angles"]
    drill["dh"][1] |= {"alpha": np.pi, "theta": np.pi / 6}
    drill["base"]["rpy"] = [0, 0, np.pi / 2]
    assert np.allclose(tip(loaded(drill), np.full(3, 0.2)), expected, atol=1e-13)


def test_joints_and_locks_of_the_file_apply(loaded: Call, drill: Any) -> None:
    whole = loaded(drill)
    drill["limits"] = {"velocity": [1, 2]}
    part = loaded(drill | {"lock": {"joint2": 0.3}})
    assert loaded(drill | {"joints": ["shoulder", "quill"]}).joints == part.joints
    assert part.joints == ("shoulder", "quill")
    assert part.limits.velocity.tolist() == [1, 2]
    t, moving = np.arange(5.0), np.random.default_rng(0).standard_normal((3, 5, 2))
    full = np.insert(moving, 1, [[0.3], [0.0], [0.0]], axis=2)
    expected = rigid_body_torque(whole, Motion(t, *full))[:, [0, 2]]
    assert close(rigid_body_torque(part, Motion(t, *moving)), expected)


def test_published_numbers_come_back() -> None:
    """The UR10's and the PUMA's own Denavit-Hartenberg numbers, up to the sense of x."""
    ur10, puma = (dh_from_robot(load_robot(name)) for name in ("ur10", "puma560"))
    assert np.allclose(ur10.a, [0, 0, 0.612, 0.5723, 0, 0], atol=1e-9)
    assert np.allclose(ur10.d, [0.1273, 0, 0, 0.163941, 0.1157, 0.0922], atol=1e-9)
    assert np.allclose(np.abs(ur10.alpha), np.pi / 2 * np.array([0, 1, 0, 0, 1, 1]), atol=1e-9)
    assert np.allclose(np.abs(puma.a), [0, 0, 0.4318, 0.0203, 0, 0], atol=1e-9)
    assert np.allclose(puma.d[1] + puma.d[2], 0.2435 - 0.0934, atol=1e-9)
    assert np.isclose(abs(puma.d[3]), 0.4331, atol=1e-9)


def test_puma_weighs_what_is_published() -> None:
    """Gravity torque of the stretched arm from the published masses and levers alone."""
    stretched = Motion([0.0], [[0, 0, np.pi / 2, 0, 0, 0]], *np.zeros((2, 1, 6)))
    tau = rigid_body_torque(load_robot("puma560"), stretched)[0]
    at_elbow = 4.8 * 0.070 + 0.82 * (0.4331 - 0.019) + 0.34 * 0.4331 + 0.09 * (0.4331 + 0.032)
    beyond = 4.8 + 0.82 + 0.34 + 0.09
    shoulder = 17.4 * 0.068 + 0.4318 * beyond + at_elbow
    assert np.abs(tau[1:3]) == pytest.approx(9.81 * np.array([shoulder, at_elbow]), rel=0.05)
    assert tau[0] == pytest.approx(0.0, abs=1e-12)
