"""MJCF files, judged by MuJoCo: the same file gives the same torque, limits and friction."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from excitant.exceptions import BadRobot, ExcitantError
from excitant.robots import Motion, Robot, load_robot, torque
from excitant.robots.effects import CoulombFriction
from excitant.robots.geometry import scene

SAME = 1e-8  # of the largest torque
ONE = '<mujoco><worldbody><body name="a">{}</body></worldbody></mujoco>'

FULL = """
<mujoco model="full">
  <compiler angle="degree" eulerseq="zYx" autolimits="true"/>
  <option gravity="0.5 -1 -9"/>
  <default>
    <joint damping="0.3" range="-90 120"/>
    <motor ctrllimited="true" ctrlrange="-2 3"/>
    <default class="heavy">
      <geom density="2700"/>
      <joint armature="0.07" frictionloss="0.4"/>
      <default class="sliding"><joint type="slide" range="-0.2 0.4" damping="5"/></default>
    </default>
  </default>
  <worldbody>
    <geom type="plane" size="2 2 0.1"/>
    <body name="pillar" pos="0 0 0.3" euler="20 -10 35">
      <geom type="box" size="0.1 0.1 0.3"/>
      <body name="shoulder" pos="0.1 0 0.4" axisangle="1 1 0 50">
        <joint name="pan" axis="0 0.2 1" pos="0.02 0.01 0"/>
        <joint name="lift" axis="1 0 0" pos="0 0.05 0.02" ref="25" stiffness="12" springref="10"/>
        <inertial pos="0.03 0.1 0.02" mass="3.1" quat="0.9 0.1 0.2 0.4"
          diaginertia="0.04 0.03 0.02"/>
        <geom type="capsule" fromto="0 0 0 0.1 0.2 0.5" size="0.05"/>
        <frame pos="0 0.1 0.3" euler="15 25 -40" childclass="heavy">
          <body name="elbow" xyaxes="1 0.2 0 0 1 0.5">
            <joint name="bend" axis="0 1 0" limited="false"/>
            <geom type="ellipsoid" size="0.1 0.08 0.2" zaxis="1 1 1"/>
            <geom type="cylinder" size="0.05 0.2" pos="0.1 0.1 0.2" mass="1.5" quat="1 2 3 4"/>
            <geom type="sphere" size="0.06" pos="0 0 0.3" contype="0" conaffinity="0"/>
            <body name="hand" pos="0 0 0.4">
              <joint name="push" class="sliding" axis="1 0 1" ref="0.1"/>
              <inertial pos="0.1 0 0.05" mass="0.8"
                fullinertia="0.01 0.012 0.005 0.001 0.0002 -0.0003"/>
              <body name="tool" pos="0.1 0 0" zaxis="0 0 -1"><geom type="box" fromto="0 0 0 0 0 0.2"
                size="0.02"/></body>
            </body>
          </body>
        </frame>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor joint="pan" gear="50" armature="1e-4" damping="2e-4"/>
    <position joint="push" kp="100" gear="2" forcerange="-30 20"/>
    <motor joint="lift" gear="10" forcerange="-15 15"/>
    <motor joint="lift" gear="-1"/>
  </actuator>
</mujoco>
"""


def judge(path: Path) -> mujoco.MjModel:
    """MuJoCo's model of a file, without contacts, limits, Coulomb friction and constraints."""
    model = mujoco.MjModel.from_xml_path(str(path))
    for flag in ("CONTACT", "LIMIT", "FRICTIONLOSS", "EQUALITY"):
        model.opt.disableflags |= getattr(mujoco.mjtDisableBit, f"mjDSBL_{flag}")
    return model


def inverse_dynamics(model: mujoco.MjModel, joints: tuple[str, ...], motion: Motion) -> np.ndarray:
    """Torque of some joints at every instant by MuJoCo, all others at their reference."""
    data = mujoco.MjData(model)
    ids = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, joint) for joint in joints]
    assert min(ids) >= 0
    at = model.jnt_dofadr[ids]
    tau = np.empty(motion.q.shape)
    for k in range(len(motion)):
        data.qpos[:], data.qvel[:], data.qacc[:] = model.qpos0, 0, 0
        data.qpos[model.jnt_qposadr[ids]] = motion.q[k]
        data.qvel[at], data.qacc[at] = motion.dq[k], motion.ddq[k]
        mujoco.mj_inverse(model, data)
        tau[k] = data.qfrc_inverse[at]
    return tau


def states(robot: Robot, seed: int = 0) -> Motion:
    rng = np.random.default_rng(seed)
    return Motion(np.arange(10.0), *rng.uniform(-2, 2, (3, 10, robot.nv)))


def assert_same_torque(path: Path, robot: Robot) -> None:
    motion = states(robot)
    expected = inverse_dynamics(judge(path), robot.joints, motion)
    kept = [effect for effect in robot.effects if not isinstance(effect, CoulombFriction)]
    difference = np.abs(torque(robot.with_effects(kept), motion) - expected).max()
    assert difference <= SAME * np.abs(expected).max()


@pytest.fixture
def full(tmp_path: Path) -> Path:
    path = tmp_path / "full.xml"
    path.write_text(FULL)
    return path


def test_torque_is_that_of_mujoco(full: Path) -> None:
    robot = load_robot(full)
    assert robot.joints == ("pan", "lift", "bend", "push")
    assert robot.revolute.tolist() == [True, True, True, False]
    assert robot.links == ("shoulder_before_lift", "shoulder", "elbow", "hand")
    assert robot.gravity.tolist() == [0.5, -1, -9]
    assert_same_torque(full, robot)


def test_limits_and_friction_are_those_of_mujoco(full: Path) -> None:
    robot, model = load_robot(full), mujoco.MjModel.from_xml_path(str(full))
    limited = model.jnt_limited.astype(bool)
    assert np.allclose(robot.limits.position[limited], model.jnt_range[limited], rtol=1e-14)
    assert np.isinf(robot.limits.position[~limited]).all()
    assert np.isinf(robot.limits.velocity).all()
    assert robot.limits.torque.tolist() == [100.0, 23.0, np.inf, 40.0]
    values = {
        effect.name: dict(zip(effect.joints, effect.values, strict=True))
        for effect in robot.effects
        if effect.name != "spring"
    }
    damping = model.dof_damping.reshape(robot.nv, -1)[:, 0]
    geared = np.array([50.0**2, 0, 0, 0])  # of the motor that has both
    for name, expected in (
        ("viscous_friction", damping + 2e-4 * geared),
        ("coulomb_friction", model.dof_frictionloss),
        ("rotor_inertia", model.dof_armature + 1e-4 * geared),
    ):
        found = [values[name].get(joint, 0.0) for joint in robot.joints]
        assert np.allclose(found, expected, rtol=1e-14), name


def test_shapes_that_touch_are_collision_shapes(full: Path) -> None:
    found = scene(load_robot(full))
    assert found is not None
    moving = {name.rsplit("_", 1)[0] for pair in found.pairs for name in pair}
    assert {"elbow", "tool"} <= moving


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
    given = (
        f'<inertial pos="{numbers(3)}" mass="{rng.uniform(0.1, 4)}" diaginertia="{moments}" '
        f"{turn}/>"
    )
    return f"""<body name="b{number}" pos="{numbers(3)}" {turn}>
      <joint name="j{number}" type="{("hinge", "slide")[rng.integers(2)]}" axis="{numbers(3)}"
        pos="{numbers(3, 0.3)}" ref="{rng.uniform(-1, 1)}" damping="{rng.uniform(0, 2)}"
        armature="{rng.uniform(0, 1)}"/>
      {given if rng.random() < 0.4 else ""}
      <geom type="{kind}" size="{size}" pos="{numbers(3)}" {turn} group="{rng.integers(6)}"/>
      <geom type="capsule" size="0.03" fromto="{numbers(6)}" mass="{rng.uniform(0.1, 3)}"/>"""


BOUNDS = (
    "",
    'boundmass="2.5" boundinertia="0.02"',
    'balanceinertia="true"',
    'settotalmass="7"',
    'inertiagrouprange="0 3"',
)


@given(
    seed=st.integers(0, 2**32 - 1),
    angle=st.sampled_from(("radian", "degree")),
    sequence=st.sampled_from(("xyz", "ZYX", "zXz", "YzX")),
    geoms=st.sampled_from(("auto", "true")),
    bounds=st.sampled_from(BOUNDS),
)
@settings(max_examples=20, suppress_health_check=list(HealthCheck))
def test_any_compiler_gives_the_torque_of_mujoco(
    tmp_path_factory: pytest.TempPathFactory,
    seed: int,
    angle: str,
    sequence: str,
    geoms: str,
    bounds: str,
) -> None:
    rng = np.random.default_rng(seed)
    compiler = (
        f'<compiler angle="{angle}" eulerseq="{sequence}" inertiafromgeom="{geoms}" {bounds}/>'
    )
    size = 1.0 if angle == "radian" else 57.0
    bodies = "".join(geom_body(rng, k, size) for k in range(3)) + "</body>" * 3
    path = tmp_path_factory.mktemp("mjcf") / "arm.xml"
    path.write_text(f"<mujoco>{compiler}<worldbody>{bodies}</worldbody></mujoco>")
    assert_same_torque(path, load_robot(path))


@pytest.mark.parametrize("frame", ["", 'refpos="0.1 0.2 -0.1" refquat="1 0.5 0.2 0.1"'])
def test_inertia_of_a_mesh_is_that_of_its_volume(
    tmp_path: Path, wedge: Callable[[Path], None], frame: str
) -> None:
    (tmp_path / "meshes").mkdir()
    wedge(tmp_path / "meshes" / "wedge.stl")
    path = tmp_path / "mesh.xml"
    path.write_text(
        f"""<mujoco><compiler meshdir="meshes"/>
        <asset><mesh file="wedge.stl" scale="1 1.5 0.8" inertia="exact" {frame}/></asset>
        <worldbody><body name="a"><joint name="j" axis="0 1 0"/>
        <geom type="mesh" mesh="wedge" pos="0.1 0.2 0.3" euler="10 20 30"/>
        <body name="b" pos="0 0 1"><joint name="k" axis="1 0 0"/>
        <geom type="mesh" mesh="wedge" mass="2"/></body></body></worldbody></mujoco>"""
    )
    assert_same_torque(path, load_robot(path))


GRIPPER = """
<mujoco><compiler angle="radian"/><worldbody>
  <body name="arm"><joint name="turn" axis="0 1 0"/><geom size="0.1" pos="0.2 0 0"/>
    <body name="left" pos="0.4 0 0"><joint name="one" type="slide" axis="0 1 0"/>
      <geom size="0.03"/></body>
    <body name="right" pos="0.4 0 0"><joint name="two" type="slide" axis="0 1 0"/>
      <geom size="0.03"/></body>
  </body>
  <body name="cube" pos="1 0 0"><freejoint name="cube_free"/><geom size="0.05"/></body>
</worldbody>
<equality><joint joint1="two" joint2="one" polycoef="0.01 -1 0 0 0"/></equality></mujoco>
"""


def test_gripper_and_loose_things_are_held_off_the_chain(tmp_path: Path) -> None:
    path = tmp_path / "cell.xml"
    path.write_text(GRIPPER)
    robot = load_robot(path, tip="arm", lock={"one": 0.03})
    assert robot.joints == ("turn",)
    assert dict(robot.locked)["two"] == pytest.approx(0.01 - 0.03)
    assert any("two follows one" in note for note in robot.notes)
    assert any("cube_free" in note for note in robot.notes)
    with pytest.raises(BadRobot, match="cube_free"):
        load_robot(path)
    with pytest.raises(BadRobot, match="'two' mimics 'one'"):
        load_robot(path, base="arm")


def test_a_loop_is_refused_where_it_moves(tmp_path: Path) -> None:
    path = tmp_path / "loop.xml"
    tie = '<equality><connect body1="left" body2="right" anchor="0 0 0"/></equality>'
    path.write_text(GRIPPER.split("<equality>")[0] + tie + "</mujoco>")
    with pytest.raises(BadRobot, match="closes a loop"):
        load_robot(path, base="arm")
    assert load_robot(path, tip="arm").joints == ("turn",)


REFUSED = {
    "no worldbody": ("<mujoco/>", "worldbody"),
    "not closed": ("<mujoco><worldbody>", "XML"),
    "mass of words": (
        ONE.format('<joint/><inertial pos="0 0 0" mass="much"/>'),
        "attribute 'mass'",
    ),
    "ball joint": (ONE.format('<joint name="b" type="ball"/><geom size="1"/>'), "'b'"),
    "missing include": ('<mujoco><include file="none.xml"/></mujoco>', "none.xml"),
    "missing mesh": (
        '<mujoco><asset><mesh name="m" file="m.stl"/></asset><worldbody><body><joint/>'
        '<geom type="mesh" mesh="m"/></body></worldbody></mujoco>',
        "m.stl",
    ),
    "two bodies of one name": (ONE.format('<joint/><geom size="1"/><body name="a"/>'), "'a'"),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_what_cannot_be_read_is_refused_in_one_line(tmp_path: Path, kind: str) -> None:
    text, culprit = REFUSED[kind]
    path = tmp_path / "arm.xml"
    path.write_text(text)
    with pytest.raises(ExcitantError) as refused:
        load_robot(path)
    said = str(refused.value)
    assert culprit in said.replace(str(path), "")
    assert "arm.xml" in said
    assert "\n" not in said


def test_missing_drawings_are_left_out(tmp_path: Path) -> None:
    """A mesh that only shows a body, and its texture, need not be there."""
    path = tmp_path / "arm.xml"
    path.write_text(
        """<mujoco><asset><mesh name="m" file="m.stl"/><texture name="t" type="2d" file="t.png"/>
        <material name="paint" texture="t"/></asset><worldbody><body name="a"><joint name="j"/>
        <inertial pos="0.1 0 0" mass="2" diaginertia="0.1 0.1 0.1"/>
        <geom type="mesh" mesh="m" material="paint"/></body></worldbody></mujoco>"""
    )
    assert load_robot(path).phi[0] == 2.0
