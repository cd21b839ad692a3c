"""Every built-in arm is complete, sound, and good for each command."""

import runpy
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from known_arms import Call

from excitant.robots import Robot, builtin_robots, load_robot
from excitant.robots.geometry import scene, zero_pose
from excitant.robots.library import arm_entry
from excitant.robots.parameters import violations
from excitant.robots.urdf import robot_from_urdf
from excitant.robots.virtual_arm import industrial_sensors

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module", params=builtin_robots())
def builtin(request: pytest.FixtureRequest) -> Robot:
    return load_robot(request.param)


def test_the_page_of_arms_is_current() -> None:
    written = (ROOT / "docs" / "arms.md").read_text("utf-8")
    table, sources = runpy.run_path(str(ROOT / "docs" / "generated.py"))["arms"]()
    for part in (table, sources, *(f"| `{name}` |" for name in builtin_robots())):
        assert part in written


def test_every_arm_is_complete(builtin: Robot) -> None:
    limits = builtin.limits
    for name in ("position", "velocity", "acceleration", "torque"):
        assert np.isfinite(getattr(limits, name)).all(), name
    effects = {effect.name for effect in builtin.effects}
    assert {"viscous_friction", "coulomb_friction", "rotor_inertia"} <= effects
    assert violations(builtin.phi, builtin.links) == []
    again = robot_from_urdf(builtin.urdf, source="again").limits
    for name in ("position", "velocity", "torque"):
        assert np.array_equal(getattr(again, name), getattr(limits, name)), name
    entry = arm_entry(builtin.name)
    assert len(entry.sources) > 20
    assert entry.moving_mass == pytest.approx(builtin.phi[::10].sum())
    if entry.weight is not None:
        assert 0.6 * entry.weight < entry.moving_mass < entry.weight


def test_every_arm_has_bodies_that_keep_apart_in_most_poses(builtin: Robot) -> None:
    shaped = {body.link for body in builtin.format.bodies(builtin) if body.shapes}
    assert len(shaped & set(builtin.links)) >= builtin.nv - 1
    found = scene(builtin)
    if found is None:
        assert builtin.nv <= 2
        return
    q, _, _ = builtin.random_motion(np.random.default_rng(0), 300)
    assert (found.distances(q) > 0.01).all(axis=1).mean() > 0.5
    assert (found.distances(zero_pose(builtin)[None]) > 0.0).all()


def test_every_arm_can_be_simulated(builtin: Robot, runs: Call) -> None:
    sensors = industrial_sensors(builtin)
    [run] = runs(builtin, 1, sensors=sensors, tolerance=0.03, duration=2.0, names=["run"])
    assert (np.abs(run.tau) <= 1.5 * builtin.limits.torque).all()  # and no NaN


def test_scara_falls_by_its_spindle_only() -> None:
    """Its arms turn in the plane: gravity acts on the slide alone, with all that it carries."""
    scara = load_robot("scara")
    model = scara.model
    for q in scara.random_motion(np.random.default_rng(2), 20)[0]:
        tau = pin.computeGeneralizedGravity(model, model.createData(), q)
        assert tau == pytest.approx([0, 0, -9.81 * (0.9 + 0.35), 0], abs=1e-9)


def tool(name: str, q: np.ndarray) -> np.ndarray:
    robot = load_robot(name)
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    return np.array(data.oMf[robot.tip].translation)


def test_known_reach_and_weight() -> None:
    """Numbers of data sheets that the kinematics and masses must add up to."""
    for name, length in {"ur5e": 0.425 + 0.3922, "ur3e": 0.24355 + 0.2132}.items():
        places = [p.translation for p in list(load_robot(name).model.jointPlacements)[1:]]
        assert abs(places[2][0]) + abs(places[3][0]) == pytest.approx(length)
    iiwa = tool("iiwa14", np.zeros(7))
    assert iiwa == pytest.approx([0, 0, 0.36 + 0.42 + 0.4 + 0.126], abs=1e-9)  # to its flange
    assert tool("gen3", np.zeros(7))[2] == pytest.approx(1.1873, abs=1e-3)
    upright = np.array([0, -np.pi / 2, np.pi / 2, 0, 0, 0])
    tx40 = tool("tx40", upright)
    assert tx40[2] == pytest.approx(0.32 + 0.225 + 0.225 + 0.065)
