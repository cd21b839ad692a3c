"""MJCF files, judged by MuJoCo: the same file gives the same torque, limits and friction."""

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from khosla import close
from marks import refused
from plant_recordings import inverse_dynamics

from excitant.exceptions import BadRobot
from excitant.robots import Motion, Robot, load_robot, rigid_body_torque, torque
from excitant.robots.effects import CoulombFriction
from excitant.robots.geometry import scene
from excitant.robots.urdf import robot_from_urdf

DATA = Path(__file__).parent / "data"
FULL, GRIPPER = DATA / "full.xml", DATA / "gripper.xml"


def states(robot: Robot) -> Motion:
    return Motion(np.arange(10.0), *np.random.default_rng(0).uniform(-2, 2, (3, 10, robot.nv)))


def judged(path: Path, **given: Any) -> Robot:
    """The robot of a file, whose torque is that of MuJoCo.

    Without contacts, limits, Coulomb friction and constraints.
    """
    robot, model = load_robot(path, **given), mujoco.MjModel.from_xml_path(str(path))
    for flag in ("CONTACT", "LIMIT", "FRICTIONLOSS", "EQUALITY"):
        model.opt.disableflags |= getattr(mujoco.mjtDisableBit, f"mjDSBL_{flag}")
    kept = [effect for effect in robot.effects if not isinstance(effect, CoulombFriction)]
    motion = states(robot)
    expected = inverse_dynamics(model, robot.joints, motion)
    assert close(torque(robot.with_effects(kept), motion), expected, 1e-8)
    return robot


def test_torque_is_that_of_mujoco() -> None:
    robot, turns = judged(FULL), [True, True, True, False]
    assert robot.joints == ("pan", "lift", "bend", "push")
    assert robot.links == ("shoulder_before_lift", "shoulder", "elbow", "hand")
    assert [robot.revolute.tolist(), robot.gravity.tolist()] == [turns, [0.5, -1, -9]]
    written = robot.with_parameters(robot.phi).urdf
    again, motion = robot_from_urdf(written, "written", gravity=robot.gravity), states(robot)
    assert close(rigid_body_torque(again, motion), rigid_body_torque(robot, motion), 1e-9)


def test_limits_and_friction_are_those_of_mujoco() -> None:
    robot, model = load_robot(FULL), mujoco.MjModel.from_xml_path(str(FULL))
    limited = model.jnt_limited.astype(bool)
    assert np.allclose(robot.limits.position[limited], model.jnt_range[limited], rtol=1e-14)
    assert np.isinf(robot.limits.position[~limited]).all()
    assert np.isinf(robot.limits.velocity).all()
    assert robot.limits.torque.tolist() == [100.0, 23.0, np.inf, 40.0]
    values = {e.name: dict(zip(e.joints, e.values, strict=False)) for e in robot.effects}
    damping = model.dof_damping.reshape(robot.nv, -1)[:, 0]
    geared = np.array([50.0**2, 0, 0, 0])  # of the motor that has both
    for name, expected in (
        ("viscous_friction", damping + 2e-4 * geared),
        ("coulomb_friction", model.dof_frictionloss),
        ("rotor_inertia", model.dof_armature + 1e-4 * geared),
    ):
        found = [values[name].get(joint, 0.0) for joint in robot.joints]
        assert np.allclose(found, expected, rtol=1e-14), name


def test_shapes_that_touch_are_collision_shapes() -> None:
    pairs = scene(load_robot(FULL)).pairs
    assert {"elbow", "tool"} <= {name.rsplit("_", 1)[0] for pair in pairs for name in pair}


def geom_body(rng: np.random.Generator, number: int, angle: float) -> str:
    """A body of random shapes, orientation, joint, and perhaps a given inertia."""

    def numbers(n: int, size: float = 1.0) -> str:
        return " ".join(map(str, rng.uniform(-size, size, n)))

    turn = (
        f'quat="{numbers(4)}"',
        f'euler="{numbers(3, 3 * angle)}"',
        f'zaxis="{numbers(3)}"',
        f'axisangle="{numbers(3)} {rng.uniform(-3, 3) * angle}"',
        f'xyaxes="{numbers(6)}"',
        "",
    )[rng.integers(6)]
    kind = ("sphere", "box", "capsule", "cylinder", "ellipsoid")[rng.integers(5)]
    size = " ".join(map(str, rng.uniform(0.02, 0.2, 3)))
    moments = " ".join(map(str, rng.uniform(0.01, 0.02, 3)))
    given = f'pos="{numbers(3)}" mass="{rng.uniform(0.1, 4)}" diaginertia="{moments}" {turn}'
    return f"""<body name="b{number}" pos="{numbers(3)}" {turn}>
      <joint name="j{number}" type="{("hinge", "slide")[rng.integers(2)]}" axis="{numbers(3)}"
        pos="{numbers(3, 0.3)}" ref="{rng.uniform(-1, 1)}" damping="{rng.uniform(0, 2)}"
        armature="{rng.uniform(0, 1)}"/>
      {f"<inertial {given}/>" if rng.random() < 0.4 else ""}
      <geom type="{kind}" size="{size}" pos="{numbers(3)}" {turn} group="{rng.integers(6)}"/>
      <geom type="capsule" size="0.03" fromto="{numbers(6)}" mass="{rng.uniform(0.1, 3)}"/>"""


TOTAL = ('settotalmass="7"', 'inertiagrouprange="0 3"')
BOUNDS = ("", 'boundmass="2.5" boundinertia="0.02"', 'balanceinertia="true"', *TOTAL)


@given(
    seed=st.integers(0, 2**32 - 1),
    angle=st.sampled_from(("radian", "degree")),
    sequence=st.sampled_from(("xyz", "ZYX", "zXz", "YzX")),
    geoms=st.sampled_from(("auto", "true")),
    bounds=st.sampled_from(BOUNDS),
)
@settings(suppress_health_check=list(HealthCheck))
def test_any_compiler_gives_the_torque_of_mujoco(tmp_path, seed, angle, sequence, geoms, bounds):
    rng, size = np.random.default_rng(seed), 1.0 if angle == "radian" else 57.0
    bodies = "".join(geom_body(rng, k, size) for k in range(3)) + "</body>" * 3
    path = tmp_path / "arm.xml"
    compiler = f'angle="{angle}" eulerseq="{sequence}" inertiafromgeom="{geoms}" {bounds}'
    path.write_text(f"<mujoco><compiler {compiler}/><worldbody>{bodies}</worldbody></mujoco>")
    judged(path)


@pytest.mark.parametrize("frame", ["", 'refpos="0.1 0.2 -0.1" refquat="1 0.5 0.2 0.1"'])
def test_inertia_of_a_mesh_is_that_of_its_volume(tmp_path: Path, frame: str) -> None:
    path = tmp_path / "mesh.xml"
    text = f"""<mujoco><compiler meshdir="{DATA}"/>
        <asset><mesh file="wedge.stl" scale="1 1.5 0.8" inertia="exact" {frame}/></asset>
        <worldbody><body name="a"><joint name="j" axis="0 1 0"/>
        <geom type="mesh" mesh="wedge" pos="0.1 0.2 0.3" euler="10 20 30"/>
        <body name="b" pos="0 0 1"><joint name="k" axis="1 0 0"/>
        <geom type="mesh" mesh="wedge" mass="2"/></body></body></worldbody></mujoco>"""
    path.write_text(text)
    judged(path, packages=[DATA])


def test_gripper_and_loose_things_are_held_off_the_chain() -> None:
    robot = load_robot(GRIPPER, tip="arm", lock={"one": 0.03})
    assert robot.joints == ("turn",)
    assert dict(robot.locked)["two"] == pytest.approx(0.01 - 0.03)
    assert any("as the joints they mimic: two at -0.02" in note for note in robot.notes)
    assert any("cube_free" in note for note in robot.notes)
    refused("cube_free", load_robot, GRIPPER, error=BadRobot)
    opening = load_robot(GRIPPER, base="arm")
    assert opening.joints == ("one",)
    assert any("is not modelled: two at" in note for note in opening.notes)
    named = {"joints": ["one", "two"], "error": BadRobot}
    refused("'two' mimics 'one'", load_robot, GRIPPER, **named)


def test_a_loop_is_refused_where_it_moves(tmp_path: Path) -> None:
    path = tmp_path / "loop.xml"
    tie = '<equality><connect body1="left" body2="right" anchor="0 0 0"/></equality></mujoco>'
    path.write_text(GRIPPER.read_text("utf-8").partition("<equality>")[0] + tie)
    refused("closes a loop", load_robot, path, base="arm", error=BadRobot)
    assert load_robot(path, tip="arm").joints == ("turn",)


def test_missing_drawings_are_left_out(tmp_path: Path) -> None:
    """A mesh that only shows a body, and its texture, need not be there."""
    path = tmp_path / "arm.xml"
    text = """<mujoco><asset><mesh name="m" file="m.stl"/><texture name="t" type="2d" file="t.png"/>
        <material name="paint" texture="t"/></asset><worldbody><body name="a"><joint name="j"/>
        <inertial pos="0.1 0 0" mass="2" diaginertia="0.1 0.1 0.1"/>
        <geom type="mesh" mesh="m" material="paint"/></body></worldbody></mujoco>"""
    path.write_text(text)
    assert load_robot(path).phi[0] == 2.0
