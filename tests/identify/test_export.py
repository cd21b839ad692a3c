"""Files of a model, read back by others, need its torque; what is published, and what is not."""

from __future__ import annotations

import json
import subprocess
import sys
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from excitant.exceptions import BadInput
from excitant.identify import Estimate, Recording, identify_robot
from excitant.identify.export import model_files, publication
from excitant.identify.rows import Accuracy
from excitant.robots import DHChain, Motion, Robot, load_robot, robot_from_dh, torque
from excitant.robots.chains import RobotSpec
from excitant.robots.effects import (
    EFFECTS,
    AddedInertia,
    CoulombFriction,
    Effect,
    JointEffect,
    Payload,
    RotorInertia,
    TorqueOffset,
    ViscousFriction,
)
from excitant.robots.parameters import from_pseudo_inertia
from excitant.robots.urdf import robot_from_urdf

TREE = """
<robot name="two arms">
  <link name="world"/><link name="post"/><link name="left"/><link name="right"/>
  <link name="finger"/><link name="tip"/><link name="rod"/>
  <joint name="turn" type="continuous"><parent link="world"/><child link="post"/>
    <origin xyz="0.1 0 0.4" rpy="0.3 0 0"/><axis xyz="0 0 1"/></joint>
  <joint name="lift" type="revolute"><parent link="post"/><child link="left"/>
    <origin xyz="0.2 0.1 0" rpy="0 1 0"/><axis xyz="1 2 -2"/>
    <limit lower="-2" upper="1" velocity="3" effort="40"/></joint>
  <joint name="slide" type="prismatic"><parent link="post"/><child link="right"/>
    <origin xyz="-0.2 0 0.1" rpy="0 0 2"/><axis xyz="0 -0.6 0.8"/>
    <limit lower="-0.5" upper="0.7" velocity="1" effort="90"/></joint>
  <joint name="grip" type="prismatic"><parent link="right"/><child link="finger"/>
    <origin xyz="0 0 0.2" rpy="0.1 0.2 0.3"/><axis xyz="0 1 0"/>
    <limit lower="0" upper="0.1" velocity="1" effort="9"/></joint>
  <joint name="swing" type="revolute"><parent link="finger"/><child link="rod"/>
    <origin xyz="0.1 0 0.1" rpy="1.5707963267948966 0 0"/><axis xyz="0 0 -1"/>
    <limit lower="-1.5" upper="1.5" velocity="2" effort="20"/></joint>
  <joint name="end" type="fixed"><parent link="left"/><child link="tip"/>
    <origin xyz="0 0.1 0.3" rpy="0.5 0 1"/></joint>
</robot>
"""
SMOOTH = (ViscousFriction, RotorInertia)
ARMS = ("panda", "cylindrical", "tilted ur10", "held panda", "held puma560", "tree", "dh5")
PRECISION = {"rigid": 1e-10, "yaml": 1e-12}
n = 40


def bodies(rng: np.random.Generator, links: int) -> np.ndarray:
    """Physically consistent standard parameters, shape (10 links,)."""
    root = rng.standard_normal((links, 4, 4)) * [[0.2], [0.2], [0.2], [1.0]]
    return from_pseudo_inertia(root @ root.transpose(0, 2, 1) + 1e-3 * np.eye(4)).ravel()


def chain(seed: int) -> Robot:
    rng = np.random.default_rng(seed)
    nv = 2 + seed % 6
    base, tool = np.eye(4), np.eye(4)
    for T in (base, tool):
        T[:3, :3] = pin.Quaternion(*rng.standard_normal(4)).normalized().toRotationMatrix()
        T[:3, 3] = rng.standard_normal(3)
    special = rng.choice([0.0, np.pi / 2, -np.pi / 2], nv)
    return robot_from_dh(
        DHChain(
            name=f"chain {seed}",
            convention="standard" if seed % 2 else "modified",
            joints=tuple(f"j{i}" for i in range(nv)),
            links=tuple(f"l{i}" for i in range(nv)),
            revolute=rng.random(nv) < 0.7,
            a=rng.uniform(-0.6, 0.6, nv),
            d=rng.uniform(-0.6, 0.6, nv),
            alpha=np.where(rng.random(nv) < 0.5, special, rng.uniform(-3, 3, nv)),
            theta=rng.uniform(-3, 3, nv),
            phi=bodies(rng, nv),
            gravity=rng.uniform(-10, 10, 3),
            base=base,
            tool=tool,
        )
    )


def named(name: str) -> Robot:
    if name.startswith("dh"):
        return chain(int(name[2:]))
    if name == "tree":
        lock = {"grip": 0.03}
        arm = robot_from_urdf(TREE, RobotSpec("tree.urdf", lock=lock), gravity=[1.0, -2.0, 9.0])
        return arm.with_parameters(bodies(np.random.default_rng(1), arm.nv))
    if name == "tilted ur10":
        return load_robot("ur10").with_gravity([3.0, -4.0, -8.0])
    held = {
        "held panda": {"panda_joint3": 0.4, "panda_joint7": -1.0},
        "held puma560": {"joint1": 0.3, "joint4": 1.1},
    }
    return load_robot(name.removeprefix("held "), lock=held.get(name))


def valued(robot: Robot, kind: type[Effect], rng: np.random.Generator) -> Effect:
    if issubclass(kind, AddedInertia):
        return kind(robot.joints[-1:]).with_values(bodies(rng, 1))
    effect = kind(robot.joints[-kind.arity :])
    return effect.with_values(rng.uniform(0.1, 1.0, len(effect.parameters(robot))))


def every_effect(robot: Robot, rng: np.random.Generator) -> tuple[Effect, ...]:
    """All effects that every format can say or name, with values."""
    said = [k for k in EFFECTS.values() if issubclass(k, JointEffect | AddedInertia)]
    return tuple(valued(robot, kind, rng) for kind in said)


@pytest.fixture(scope="module", params=ARMS)
def model(request: pytest.FixtureRequest) -> Robot:
    """An arm with inertias no table has, and every effect."""
    robot, rng = named(request.param), np.random.default_rng(3)
    robot = robot.with_parameters(bodies(rng, robot.nv))
    return robot.with_effects(every_effect(robot, rng))


@pytest.fixture(scope="module")
def motion(model: Robot) -> Motion:
    return Motion(np.arange(float(n)), *model.random_motion(np.random.default_rng(0), n))


def write(folder: Path, model: Robot) -> Path:
    for name, text in model_files(model, "identified", "model.yaml").items():
        (folder / name).write_text(text, encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def folder(model: Robot, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("published"), model)


def with_only(model: Robot, *kinds: type[Effect]) -> Robot:
    return model.with_effects([e for e in model.effects if isinstance(e, (*kinds, AddedInertia))])


def check(found: Any, expected: np.ndarray, relative: float) -> None:
    assert np.abs(np.asarray(found) - expected).max() <= relative * np.abs(expected).max()


def test_yaml_reads_back_to_the_torque_with_every_effect(
    model: Robot, motion: Motion, folder: Path
) -> None:
    written = load_robot(folder / "model.yaml")
    assert written.joints == model.joints
    check(torque(written, motion), torque(model, motion), PRECISION["yaml"])
    assert np.array_equal(written.limits.position, model.limits.position)
    assert np.array_equal(written.limits.torque, model.limits.torque)


@pytest.mark.parametrize("kind", EFFECTS.values(), ids=EFFECTS)
def test_yaml_reads_back_each_effect_alone(kind: type[Effect], tmp_path: Path) -> None:
    robot, rng = named("held panda"), np.random.default_rng(5)
    motion = Motion(np.arange(float(n)), *robot.random_motion(rng, n))
    alone = robot.with_effects([valued(robot, kind, rng)])
    written = load_robot(write(tmp_path, alone) / "model.yaml")
    check(torque(written, motion), torque(alone, motion), PRECISION["yaml"])


def test_urdf_needs_the_torque_of_all_that_it_holds(
    model: Robot, motion: Motion, folder: Path
) -> None:
    """Read by Pinocchio with no word of joints that are held or kept."""
    alone = load_robot(folder / "identified.urdf").with_gravity(model.gravity)
    expected = with_only(model, ViscousFriction, CoulombFriction)
    check(torque(alone, motion), torque(expected, motion), PRECISION["rigid"])


BITS = mujoco.mjtDisableBit


def mujoco_model(model: Robot, text: str, *disabled: Any) -> tuple[Any, Any, np.ndarray]:
    """Model, data, and where each joint stands in MuJoCo: one branch after the other."""
    loaded = mujoco.MjModel.from_xml_string(text)
    for flag in disabled:
        loaded.opt.disableflags |= flag
    order = np.array([loaded.jnt_dofadr[loaded.joint(joint).id] for joint in model.joints])
    return loaded, mujoco.MjData(loaded), order


def mujoco_inverse(loaded: Any, data: Any, order: np.ndarray, motion: Motion) -> np.ndarray:
    tau = np.empty(motion.q.shape)
    for k in range(len(motion)):
        data.qpos[order], data.qvel[order] = motion.q[k], motion.dq[k]
        data.qacc[order] = motion.ddq[k]
        mujoco.mj_inverse(loaded, data)
        tau[k] = data.qfrc_inverse[order]
    return tau


def test_mjcf_needs_the_torque_of_dry_friction_where_joints_slide(
    model: Robot, motion: Motion, folder: Path
) -> None:
    """Its friction is soft: full once the velocity outweighs the acceleration of some 10 ms."""
    sliding = np.copysign(np.maximum(np.abs(motion.dq), 0.5), motion.dq)
    fast = Motion(motion.t, motion.q, sliding, 0.5 * motion.ddq / np.abs(motion.ddq).max())
    text = (folder / "identified.xml").read_text(encoding="utf-8")
    loaded, *rest = mujoco_model(model, text, BITS.mjDSBL_LIMIT)
    expected = torque(with_only(model, *SMOOTH, CoulombFriction), fast)
    check(mujoco_inverse(loaded, *rest, fast), expected, PRECISION["rigid"])
    loaded.opt.disableflags |= BITS.mjDSBL_CONSTRAINT
    smooth = mujoco_inverse(loaded, *rest, motion)
    check(smooth, torque(with_only(model, *SMOOTH), motion), PRECISION["rigid"])
    for j, joint in enumerate(model.joints):
        bounded = bool(np.isfinite(model.limits.position[j]).all())
        assert loaded.joint(joint).limited[0] == bounded
        if bounded:
            np.testing.assert_allclose(loaded.joint(joint).range, model.limits.position[j])
        limit = model.limits.torque[j]
        if np.isfinite(limit):
            np.testing.assert_allclose(loaded.actuator(joint).ctrlrange, [-limit, limit])


@pytest.mark.parametrize("currents", [False, True])
def test_mjcf_moves_as_its_controls_say(model: Robot, motion: Motion, currents: bool) -> None:
    """Forward dynamics under the model's torque, offsets included, gives the acceleration."""
    gains = np.random.default_rng(5).uniform(2.0, 20.0, model.nv) if currents else None
    text = model_files(model, "arm", "arm.yaml", ["mjcf"], gains)["arm.xml"]
    free = (BITS.mjDSBL_CONSTRAINT, BITS.mjDSBL_CLAMPCTRL)
    loaded, data, order = mujoco_model(model, text, *free)
    tau = torque(with_only(model, *SMOOTH, TorqueOffset), motion)
    controls = tau if gains is None else tau / gains
    found = np.empty(tau.shape)
    for k in range(len(motion)):
        data.qpos[order], data.qvel[order], data.ctrl[:] = motion.q[k], motion.dq[k], controls[k]
        mujoco.mj_forward(loaded, data)
        found[k] = data.qacc[order]
    check(found, motion.ddq, 1e-6)


def test_mjcf_puts_bodies_and_tools_where_pinocchio_does(
    model: Robot, motion: Motion, folder: Path
) -> None:
    text = (folder / "identified.xml").read_text(encoding="utf-8")
    (loaded, data, order), reference = mujoco_model(model, text), model.model.createData()
    frames = [f for f in model.model.frames if f.type == pin.FrameType.BODY]
    assert loaded.nbody == model.nv + 1
    assert loaded.nsite == len(frames) - model.nv
    for k in range(5):
        data.qpos[order] = motion.q[k]
        mujoco.mj_kinematics(loaded, data)
        pin.framesForwardKinematics(model.model, reference, motion.q[k])
        for frame in frames:
            pose = reference.oMf[model.model.getFrameId(frame.name, pin.FrameType.BODY)]
            thing = data.body(frame.name) if frame.name in model.links else data.site(frame.name)
            place = thing.xpos
            np.testing.assert_allclose(place, pose.translation, atol=1e-12)
            np.testing.assert_allclose(thing.xmat.reshape(3, 3), pose.rotation, atol=1e-12)


class Sdf:
    """A reader of its own for SDFormat 1.9, as far as arms need it."""

    def __init__(self, text: str) -> None:
        world = ET.fromstring(text).find("world")
        assert world is not None
        self.model = world.find("model")
        self.pin = pin.Model()
        self.pin.gravity.linear = np.array(world.findtext("gravity", "").split(), float)
        self.joints = [j for j in self.model.findall("joint") if j.get("type") != "fixed"]
        self.ids: dict[str, int] = {}
        [mount] = [j for j in self.model.findall("joint") if j.get("type") == "fixed"]
        assert mount.findtext("parent") == "world"
        self.ids[mount.findtext("child")] = 0
        for joint in self.joints:
            self.add(joint)

    def add(self, joint: ET.Element) -> None:
        axis, name = numbers(joint, "axis/xyz"), joint.get("name")
        kinds = {"prismatic": pin.JointModelPrismaticUnaligned}
        kind = kinds.get(joint.get("type"), pin.JointModelRevoluteUnaligned)(axis)
        pose = joint.find("pose")
        assert pose.get("rotation_format") == "quat_xyzw"
        assert pose.get("relative_to") == joint.findtext("parent")
        x, y, z, *xyzw = np.array(pose.text.split(), float)
        place = pin.SE3(pin.Quaternion(np.array(xyzw)), np.array([x, y, z]))
        parent = self.ids[joint.findtext("parent")]
        index = self.pin.addJoint(parent, kind, place, name)
        child = joint.findtext("child")
        link = next(e for e in self.model.findall("link") if e.get("name") == child)
        assert link.find("pose").get("relative_to") == name
        assert not link.findtext("pose")
        inertial = link.find("inertial")
        lever = numbers(inertial, "pose")
        assert not lever[3:].any()
        tensor = [float(inertial.findtext(f"inertia/i{''.join(sorted(a + b))}"))
                  for a in "xyz" for b in "xyz"]  # fmt: skip
        mass = float(inertial.findtext("mass"))
        body = pin.Inertia(mass, lever[:3], np.reshape(tensor, (3, 3)))
        self.pin.appendBodyToJoint(index, body, pin.SE3.Identity())
        self.ids[child] = index

    def torque(self, motion: Motion) -> np.ndarray:
        data, states = self.pin.createData(), zip(motion.q, motion.dq, motion.ddq, strict=True)
        tau = np.array([pin.rnea(self.pin, data, *state) for state in states])
        for j, joint in enumerate(self.joints):
            rotor = joint.findtext("{drake.mit.edu}rotor_inertia") or "0"
            damping, friction = (
                float(joint.findtext(f"axis/dynamics/{key}")) for key in ("damping", "friction")
            )
            tau[:, j] += damping * motion.dq[:, j] + friction * np.sign(motion.dq[:, j])
            tau[:, j] += float(rotor) * motion.ddq[:, j]
        return tau


def numbers(element: ET.Element, path: str) -> np.ndarray:
    return np.array(element.findtext(path).split(), float)


def test_sdf_needs_the_torque_of_all_that_it_holds(
    model: Robot, motion: Motion, folder: Path
) -> None:
    """It names nothing twice and has the limits."""
    read = Sdf((folder / "identified.sdf").read_text(encoding="utf-8"))
    expected = torque(with_only(model, *SMOOTH, CoulombFriction), motion)
    check(read.torque(motion), expected, PRECISION["rigid"])
    names = [e.get("name") for e in read.model if e.get("name")]
    assert len(set(names)) == len(names)
    assert not {"world", "", None} & set(names)
    for joint, limits in zip(read.joints, model.limits.position, strict=True):
        found = (joint.findtext(f"axis/limit/{key}") for key in ("lower", "upper"))
        expected = [x if np.isfinite(x) else None for x in limits]
        assert [None if x is None else float(x) for x in found] == expected


def test_files_name_what_they_cannot_hold(model: Robot, folder: Path) -> None:
    urdf, mjcf, sdf = (
        (folder / f"identified.{suffix}").read_text(encoding="utf-8")
        for suffix in ("urdf", "xml", "sdf")
    )
    for text in (urdf, mjcf, sdf):
        assert "not in this file: Stribeck friction" in text
        assert "model.yaml holds everything" in text
    for text in (urdf, sdf):
        assert "not in this file: torque offset" in text
    assert "not in this file: rotor inertia" in urdf
    assert "not in this file: rotor inertia" not in mjcf + sdf
    assert "not in this file: viscous friction" not in urdf + mjcf + sdf


@given(seed=st.integers(0, 2**32 - 1))
def test_any_chain_needs_the_same_torque_in_every_format(seed: int) -> None:
    robot, rng = chain(seed), np.random.default_rng(seed)
    model = robot.with_effects(every_effect(robot, rng))
    motion = Motion(np.arange(5.0), *robot.random_motion(rng, 5))
    files = model_files(model, "arm", "arm.yaml")
    sliding = with_only(model, *SMOOTH, CoulombFriction)
    check(Sdf(files["arm.sdf"]).torque(motion), torque(sliding, motion), PRECISION["rigid"])
    loaded = mujoco_model(model, files["arm.xml"], BITS.mjDSBL_CONSTRAINT)
    smooth = mujoco_inverse(*loaded, motion)
    check(smooth, torque(with_only(model, *SMOOTH), motion), PRECISION["rigid"])


@pytest.fixture(scope="module")
def estimate(planar: Robot, exact: Callable[..., Recording]) -> Estimate:
    """An identified arm whose description was 30 % off."""
    recording = exact(planar, np.arange(0, 12, 1 / 100))
    return identify_robot(planar.with_parameters(1.3 * planar.phi), [recording])


def judged(estimate: Estimate, validate: Accuracy, baseline: Accuracy) -> Estimate:
    """The estimate with these accuracies on the hold-out instead of its own."""
    copy = replace(estimate)
    vars(copy).update(validate=validate, baseline=baseline)  # cached properties
    return copy


def test_a_worse_model_is_not_published_unless_forced(estimate: Estimate) -> None:
    better = publication(estimate)
    assert better.published
    assert better.note == ""
    assert set(better.files) == {*(f"identified.{e}" for e in ("urdf", "xml", "sdf")), "model.yaml"}
    worse = judged(estimate, estimate.baseline, estimate.validate)
    refused, forced = publication(worse), publication(worse, force=True)
    assert not refused.published
    assert refused.files == {}
    assert "--force" in refused.note
    for accuracy in (estimate.validate, estimate.baseline):
        assert f"{accuracy.nrmse.sum():.4g}" in refused.note
    assert forced.published
    assert forced.files == better.files
    assert "forced" in forced.note


@pytest.mark.parametrize(("factor", "published"), [(1.0, True), (1.005, True), (1.02, False)])
def test_a_model_as_good_as_the_given_one_is_published(
    estimate: Estimate, factor: float, published: bool
) -> None:
    for nrmse in (estimate.validate.nrmse, np.array([0.1, np.nan])):  # whose torque never changed
        accuracy = replace(estimate.validate, nrmse=nrmse)
        baseline = replace(accuracy, nrmse=nrmse / factor)
        assert publication(judged(estimate, accuracy, baseline)).published is published


def test_currents_are_published_with_their_gains(estimate: Estimate) -> None:
    gains = np.array([12.0, 7.0])
    read = replace(estimate, gains=gains, data=replace(estimate.data, unit="A"))
    currents = judged(read, estimate.validate, estimate.baseline)
    files = publication(currents, formats=["mjcf"]).files
    assert yaml.safe_load(files["model.yaml"])["drive"] == {"gain_Nm_per_A": [12.0, 7.0]}
    loaded = mujoco.MjModel.from_xml_string(files["identified.xml"])
    np.testing.assert_array_equal(loaded.actuator_gear[:, 0], gains)
    assert "drive" not in yaml.safe_load(publication(estimate).files["model.yaml"])


def test_command_writes_result_but_no_model_when_it_got_worse(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, planar: Robot, motion_of: Any, excitant: Any
) -> None:
    """Of an arm with large torque offsets, judged on one that the given arm explains."""
    monkeypatch.chdir(tmp_path)
    motion = motion_of(planar, np.arange(0, 8, 1 / 100))
    other = planar.with_effects([*planar.effects, TorqueOffset(planar.joints, (40.0, 20.0))])
    for name, model in (("misled", other), ("true", planar)):
        columns = np.column_stack([motion.t, motion.q, torque(model, motion)])
        header = "t,q1,q2,tau1,tau2"
        np.savetxt(f"{name}.csv", columns, delimiter=",", header=header, comments="")
    words = "identify planar_2r misled.csv --validate true.csv"
    ran = excitant(f"{words} -o out")
    assert (ran.status, ran.err) == (0, "")
    [line] = [line for line in ran.out.splitlines() if "not published" in line]
    result = json.loads((tmp_path / "out" / "result.json").read_text(encoding="utf-8"))
    assert (result["published"], result["files"]) == (False, [])
    assert line in result["notes"]
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert written == {"result.json", "summary.txt", "report.html", "series.npz"}
    result = excitant(f"{words} --force --formats sdf --json -o forced").result
    assert result["published"] is True
    assert {Path(file).suffix for file in result["files"]} == {".urdf", ".yaml", ".sdf"}


def test_payload_becomes_part_of_its_link(planar: Robot, tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="viscous_friction has no values"):
        model_files(planar.with_effects([ViscousFriction(planar.joints)]), "arm", "arm.yaml")
    load = np.array([2.0, 0.1, 0, 0, 0.01, 0, 0.02, 0, 0, 0.02])
    held = planar.with_effects([Payload(planar.joints[-1:]).with_values(load)])
    written = load_robot(write(tmp_path, held) / "model.yaml")
    assert written.effects == ()
    np.testing.assert_allclose(written.phi[10:], planar.phi[10:] + load, atol=1e-12)
    loaded = mujoco.MjModel.from_xml_path(str(tmp_path / "identified.xml"))
    assert loaded.body(planar.links[-1]).mass[0] == pytest.approx(planar.phi[10] + 2.0)


ODD = """
<robot name="arm */ &quot;&quot;&quot; {x} -- 7 &#252;">
  <link name="base"/><link name="mount"/><link name="a--b"><inertial><mass value="1"/>
  <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
  <joint name="mount" type="revolute"><parent link="base"/><child link="mount"/>
    <limit lower="-1" upper="1" velocity="1" effort="1"/></joint>
  <joint name="a--b" type="prismatic"><parent link="mount"/><child link="a--b"/>
    <limit lower="-1" upper="1" velocity="1" effort="1"/></joint>
</robot>
"""


def test_odd_names_break_no_file_and_occur_once() -> None:
    bare = robot_from_urdf(ODD, source="odd.urdf")
    arm = bare.with_parameters([1, 0, 0, 0, 1, 0, 1, 0, 0, 1] * 2)
    arm = arm.with_effects([TorqueOffset(("a--b",), (1.0,))])
    files = model_files(arm, "arm", "arm.yaml")
    ET.fromstring(files["arm.urdf"])
    mujoco.MjModel.from_xml_string(files["arm.xml"])
    model = ET.fromstring(files["arm.sdf"]).find("world/model")
    assert model is not None
    names = [element.get("name") for element in model]
    assert len(set(names)) == len(names)
    assert bare.phi[0] == 0  # a link without mass is written as one
    text = model_files(bare, "arm", "arm.yaml")["arm.urdf"]
    assert np.array_equal(robot_from_urdf(text, source="arm.urdf").phi, bare.phi)


def test_negative_friction_is_left_out_and_said_so(planar: Robot) -> None:
    pairs = ((CoulombFriction, 0.5), (RotorInertia, 0.1))
    arm = planar.with_effects([kind(planar.joints, (-x, x)) for kind, x in pairs])
    files = model_files(arm, "arm", "arm.yaml")
    for name in ("arm.xml", "arm.sdf"):
        assert f"not in this file: negative Coulomb friction of {planar.joints[0]}" in files[name]
    loaded = mujoco.MjModel.from_xml_string(files["arm.xml"])
    np.testing.assert_array_equal(loaded.dof_frictionloss, [0.0, 0.5])
    np.testing.assert_array_equal(loaded.dof_armature, [0.0, 0.1])


@pytest.mark.slow
def test_identified_mjcf_follows_the_recording_better() -> None:
    """Under the same commands, feed-forward and position loop, in MuJoCo."""
    file = Path(__file__).resolve().parents[2] / "benchmarks" / "tracking.py"
    words = ["--robots", "planar_2r", "--sets", "--bandwidth", "5", "20"]
    said = subprocess.run(
        [sys.executable, file, *words], capture_output=True, text=True, check=True
    )
    ratios = [float(x.split(";")[0]) for x in said.stdout.split("ratio")[1:]]
    assert len(ratios) == 2
    assert min(ratios) > 2
