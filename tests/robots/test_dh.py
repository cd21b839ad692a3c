"""Denavit-Hartenberg arms: from robots, to robots, from files; torques stay the same."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from khosla import dh_from_robot, frames, modified_torque

from excitant.exceptions import BadRobot, ExcitantError
from excitant.robots import (
    DHChain,
    Limits,
    Motion,
    Robot,
    load_robot,
    rigid_body_torque,
    robot_from_dh,
)
from excitant.robots.dh import CONVENTIONS, Convention
from excitant.robots.geometry import scene
from excitant.robots.schema import CylinderRecord
from excitant.robots.urdf import robot_from_urdf

Chains = Callable[..., DHChain]
States = Callable[[Robot, int, int], Motion]
Bodies = Callable[[int, int], np.ndarray]
SEEDS = st.integers(0, 2**32 - 1)
EXACT = 1e-10


def close(left: np.ndarray, right: np.ndarray, relative: float = EXACT) -> bool:
    return bool(np.abs(left - right).max() <= relative * np.abs(right).max())


def chain_torque(chain: DHChain, motion: Motion) -> np.ndarray:
    return modified_torque(chain, motion.q, motion.dq, motion.ddq)


def tips(chain: DHChain, q: np.ndarray) -> np.ndarray:
    return frames(chain, q)[:, -1] @ chain.tool


# Conventions


@given(seed=SEEDS, convention=st.sampled_from(CONVENTIONS))
def test_a_link_is_four_elementary_motions(
    random_chain: Chains, seed: int, convention: Convention
) -> None:
    chain = random_chain(seed, 3, convention)
    q = np.random.default_rng(seed).standard_normal((1, 3))
    for i in range(3):
        turn, slide = (q[0, i], 0.0) if chain.revolute[i] else (0.0, q[0, i])
        z = pin.exp6(np.array([0, 0, chain.d[i] + slide, 0, 0, chain.theta[i] + turn]))
        x = pin.exp6(np.array([chain.a[i], 0, 0, chain.alpha[i], 0, 0]))
        expected = (z * x if convention == "standard" else x * z).homogeneous
        assert np.allclose(chain.poses(q)[0, i], expected, rtol=0, atol=1e-13)


# Robots to chains and back


@pytest.mark.parametrize("convention", CONVENTIONS)
def test_every_arm_has_a_chain_with_the_same_torques(
    arm: Robot, random_states: States, convention: Convention
) -> None:
    tilted, motion = arm.with_gravity([1.0, -2.0, -9.0]), random_states(arm, 1, 20)
    chain = dh_from_robot(tilted, convention)
    assert close(chain_torque(chain, motion), rigid_body_torque(tilted, motion))
    back = robot_from_dh(chain)
    assert (back.joints, back.links) == (arm.joints, arm.links)
    assert np.array_equal(back.revolute, arm.revolute)
    assert close(rigid_body_torque(back, motion), rigid_body_torque(tilted, motion))


@given(seed=SEEDS, nv=st.integers(1, 9), convention=st.sampled_from(CONVENTIONS))
def test_chain_to_urdf_and_back(
    random_chain: Chains, seed: int, nv: int, convention: Convention
) -> None:
    chain = random_chain(seed, nv, convention)
    robot = robot_from_dh(chain)
    motion = Motion(np.arange(4.0), *np.random.default_rng(seed).standard_normal((3, 4, nv)))
    assert close(rigid_body_torque(robot, motion), chain_torque(chain, motion))
    for other in CONVENTIONS:
        back = dh_from_robot(robot, other)
        assert close(chain_torque(back, motion), chain_torque(chain, motion))
        assert np.allclose(tips(back, motion.q), tips(chain, motion.q), rtol=0, atol=1e-12)


def test_published_numbers_come_back() -> None:
    """The UR10's and the PUMA's own Denavit-Hartenberg numbers, up to the sense of x."""
    ur10 = dh_from_robot(load_robot("ur10"), "standard")
    assert np.allclose(ur10.a, [0, 0.612, 0.5723, 0, 0, 0], atol=1e-9)
    assert np.allclose(ur10.d, [0.1273, 0, 0, 0.163941, 0.1157, 0.0922], atol=1e-9)
    assert np.allclose(np.abs(ur10.alpha), np.pi / 2 * np.array([1, 0, 0, 1, 1, 0]), atol=1e-9)
    puma = dh_from_robot(load_robot("puma560"), "modified")
    assert np.allclose(np.abs(puma.a), [0, 0, 0.4318, 0.0203, 0, 0], atol=1e-9)
    assert np.allclose(puma.d[1] + puma.d[2], 0.2435 - 0.0934, atol=1e-9)
    assert np.isclose(abs(puma.d[3]), 0.4331, atol=1e-9)


def test_a_link_without_mass_is_refused_by_name(random_chain: Chains) -> None:
    chain = random_chain(0, 3)
    phi = np.array(chain.phi)
    phi[10] = 0.0
    with pytest.raises(BadRobot, match="link 'l1' has no mass"):
        robot_from_dh(replace(chain, phi=phi))


def test_limits_and_shapes_are_in_the_urdf(random_chain: Chains) -> None:
    chain = random_chain(4, 4)
    chain = replace(
        chain,
        revolute=np.array([True, True, False, False]),
        shapes=(
            (CylinderRecord((0, 0, -0.3), (0, 0, 0), 0.1),),
            (),
            (CylinderRecord((-0.2, 0.1, 0), (0, 0, 0.1), 0.05),),
            (),
            (CylinderRecord((0, 0, 0.1), (0, 0, 0.1), 0.04),),
        ),
    )
    inf = np.inf
    position = np.array([[-1, 2], [-inf, inf], [0.1, 0.4], [-inf, inf]])
    limits = Limits(position, [1, 2, inf, 3], np.full(4, inf), [5, inf, 6, 7])
    again = robot_from_urdf(robot_from_dh(chain, limits).urdf, source="written")
    for name in ("position", "velocity", "torque"):
        assert np.array_equal(getattr(again.limits, name), getattr(limits, name)), name
    root = ET.fromstring(again.urdf)
    kinds = [joint.get("type") for joint in root.findall("joint")]
    assert kinds == ["revolute", "continuous", "prismatic", "prismatic", "fixed"]
    bodies = {link.get("name"): link.findall("collision") for link in root.findall("link")}
    assert [len(bodies[name]) for name in ("base", "l0", "l1", "l2", "l3")] == [1, 0, 1, 0, 1]


@pytest.mark.parametrize("convention", CONVENTIONS)
def test_shapes_move_with_their_links(random_chain: Chains, convention: Convention) -> None:
    """Ends of a body placed by the chain's frames are where the URDF's geometry has them."""
    still = CylinderRecord((0.5, 0, 0), (0.5, 0, 0), 0.01)
    ball = CylinderRecord((0.1, -0.2, 0.3), (0.1, -0.2, 0.3), 0.02)
    chain = random_chain(6, 3, convention)
    chain = replace(chain, shapes=((still,), (), (), (ball,)), base=np.eye(4))
    q = np.random.default_rng(0).uniform(-1, 1, (5, 3))
    view = scene(robot_from_dh(chain))
    assert view is not None
    frame = frames(chain, q)[:, 3]
    centre = frame[:, :3, :3] @ np.array(ball.start) + frame[:, :3, 3]
    expected = np.linalg.norm(centre - [0.5, 0, 0], axis=1) - 0.03
    assert np.allclose(view.distances(q)[:, 0], expected, atol=1e-7)


# Files

ARM = """
name: scara
convention: standard
angles: degrees
gravity: [0, 0, -9.8]
dh:
  - {a: 0.4, d: 0.1, joint: shoulder, link: upper, m: 5, com: [-0.2, 0.01, 0],
     Ic: {xx: 0.01, yy: 0.07, zz: 0.075, xy: 0.002}, collision:
     [{from: [-0.4, 0, 0], to: [0, 0, 0], radius: 0.05}]}
  - {a: 0.3, alpha: 180, theta: 30, m: 3, mc: [-0.4, 0.02, 0.1],
     I: {xx: 0.02, yy: 0.1, zz: 0.1, xz: 0.003}}
  - {type: prismatic, joint: quill, m: 1, I: {xx: 0.01, yy: 0.01, zz: 0.001},
     collision: [{from: [0, 0, 0], to: [0, 0, 0], radius: 0.04}]}
base: {position: [0, 0, 0.5], rpy: [0, 0, 90],
       collision: [{from: [0, 0, 0], to: [0, 0, 0.4], radius: 0.1}]}
tool: {position: [0, 0, 0.1]}
limits: {position: [[-2, 2], [-2.5, 2.5], [0, 0.3]], velocity: 3, torque: [50, 30, 100]}
effects: [{effect: viscous_friction, joints: [quill], values: [4]}]
"""


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "robot.yaml"
    path.write_text(text)
    return path


def test_robot_yaml_in_denavit_hartenberg_form(tmp_path: Path) -> None:
    robot = load_robot(written(tmp_path, ARM))
    assert robot.name == "scara"
    assert robot.joints == ("shoulder", "joint2", "quill")
    assert robot.links == ("upper", "link2", "link3")
    assert robot.gravity.tolist() == [0, 0, -9.8]
    assert robot.revolute.tolist() == [True, True, False]
    assert robot.limits.torque.tolist() == [50, 30, 100]
    assert robot.effects[0].joints == ("quill",)
    chain = dh_from_robot(robot)
    tip = tips(chain, np.zeros((1, 3)))[0, :3, 3]
    elbow, wrist = np.radians(90), np.radians(120)
    expected = [
        0.4 * np.cos(elbow) + 0.3 * np.cos(wrist),
        0.4 * np.sin(elbow) + 0.3 * np.sin(wrist),
        0.5 + 0.1 - 0.1,
    ]
    assert np.allclose(tip, expected, rtol=0, atol=1e-12)
    again = robot_from_urdf(robot.urdf, source="again", gravity=robot.gravity)
    assert np.array_equal(again.limits.position, robot.limits.position)
    assert np.array_equal(again.phi, robot.phi)
    assert scene(robot) is not None


def test_inertia_about_frame_or_centre_of_mass_is_the_same_arm(tmp_path: Path) -> None:
    """Link 1 of the file by Steiner's theorem, with mc for com."""
    given = yaml.safe_load(ARM)
    link = given["dh"][0]
    c, m = np.array(link.pop("com")), link["m"]
    central = link.pop("Ic")
    tensor = m * (c @ c * np.eye(3) - np.outer(c, c))
    rows = {"xx": (0, 0), "yy": (1, 1), "zz": (2, 2), "xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}
    link["mc"] = (m * c).tolist()
    link["I"] = {key: central.get(key, 0.0) + float(tensor[k]) for key, k in rows.items()}
    other = load_robot(written(tmp_path, yaml.safe_dump(given)))
    assert np.allclose(other.phi, load_robot(written(tmp_path, ARM)).phi, rtol=0, atol=1e-13)


def test_angles_are_radians_unless_said(tmp_path: Path) -> None:
    text = ARM.replace("angles: degrees\n", "").replace("alpha: 180", f"alpha: {np.pi}")
    text = text.replace("theta: 30", f"theta: {np.pi / 6}").replace("90]", f"{np.pi / 2}]")
    radians, degrees = (load_robot(written(tmp_path, t)) for t in (text, ARM))
    q = np.ones((1, 3)) * 0.2
    assert np.allclose(tips(dh_from_robot(radians), q), tips(dh_from_robot(degrees), q), atol=1e-13)


def test_joints_and_locks_of_the_file_apply(tmp_path: Path) -> None:
    given = yaml.safe_load(ARM) | {"limits": {"velocity": [1, 2]}}
    whole, part, kept = (
        load_robot(written(tmp_path, yaml.safe_dump(given | choice | {"limits": limits})))
        for choice, limits in (
            ({}, {}),
            ({"lock": {"joint2": 0.3}}, given["limits"]),
            ({"joints": ["shoulder", "quill"]}, given["limits"]),
        )
    )
    assert part.joints == kept.joints == ("shoulder", "quill")
    assert part.limits.velocity.tolist() == [1, 2]
    q, dq, ddq = np.random.default_rng(0).standard_normal((3, 5, 2))
    full = [np.insert(x, 1, v, axis=1) for x, v in ((q, 0.3), (dq, 0.0), (ddq, 0.0))]
    t = np.arange(5.0)
    expected = rigid_body_torque(whole, Motion(t, *full))[:, [0, 2]]
    assert close(rigid_body_torque(part, Motion(t, q, dq, ddq)), expected)


REFUSED: dict[str, tuple[tuple[str, str], str]] = {
    "no convention": (("convention: standard", ""), "convention: None.*standard, modified"),
    "unknown key": (("a: 0.4", "aa: 0.4"), r"dh\[0\]: unknown entry 'aa': did you mean 'a'"),
    "not finite": (("theta: 30", "theta: .inf"), r"dh\[1\].theta: expected a finite"),
    "negative mass": (("m: 3", "m: -3"), r"dh\[1\].m: expected a number above 0"),
    "two centres": (("com: [-0.2, 0.01, 0]", "com: [0, 0, 0], mc: [0, 0, 0]"), "upper: both"),
    "no inertia": (("I: {xx: 0.01, yy: 0.01, zz: 0.001}", "a: 0"), "link3: give the inertia"),
    "shape": (("radius: 0.05", "size: 0.05"), r"dh\[0\].collision\[0\]: unknown entry 'size'"),
    "base": (("base: {position", "base: {place"), "base: unknown entry 'place'"),
    "gravity": (("gravity: [0, 0, -9.8]", "gravity: 9.8"), "gravity: expected a list"),
    "names twice": (("joint: quill", "joint: shoulder"), "joint 'shoulder' is defined twice"),
    "both model and dh": (("name: scara", "model: arm.urdf"), "both 'model' and 'dh'"),
    "unknown lock": (("name: scara", "lock: {elbow: 1}"), "unknown joint 'elbow'"),
    "limit": (("velocity: 3", "velocity: -3"), "velocity limit"),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_bad_entries_are_refused_in_one_line(kind: str, tmp_path: Path) -> None:
    (old, new), message = REFUSED[kind]
    assert old in ARM
    with pytest.raises(ExcitantError, match=message) as refused:
        load_robot(written(tmp_path, ARM.replace(old, new, 1)))
    assert "\n" not in str(refused.value)
    if kind != "unknown lock":
        assert "robot.yaml" in str(refused.value)


# Built-in arms


def test_puma_weighs_what_is_published() -> None:
    """Gravity torque of the stretched arm from the published masses and levers alone."""
    puma = load_robot("puma560")
    stretched = Motion([0.0], [[0, 0, np.pi / 2, 0, 0, 0]], np.zeros((1, 6)), np.zeros((1, 6)))
    tau = rigid_body_torque(puma, stretched)[0]
    at_elbow = 4.8 * 0.070 + 0.82 * (0.4331 - 0.019) + 0.34 * 0.4331 + 0.09 * (0.4331 + 0.032)
    beyond = 4.8 + 0.82 + 0.34 + 0.09
    shoulder = 17.4 * 0.068 + 0.4318 * beyond + at_elbow
    assert abs(tau[2]) == pytest.approx(9.81 * at_elbow, rel=0.05)
    assert abs(tau[1]) == pytest.approx(9.81 * shoulder, rel=0.05)
    assert tau[0] == pytest.approx(0.0, abs=1e-12)
