"""Files of a model, read back by others, need the torque of the model."""

from __future__ import annotations

import ast
import ctypes
import shutil
import subprocess
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from excitant.identify.export import FORMATS, model_files
from excitant.robots import DHChain, Motion, Robot, load_robot, robot_from_dh, torque
from excitant.robots.effects import (
    EFFECTS,
    AddedInertia,
    CoulombFriction,
    Effect,
    JointEffect,
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
BUILT_IN = ("planar_2r", "ur10", "panda", "cmu_dd_arm_ii", "puma560", "cylindrical")
ARMS = (*BUILT_IN, "tilted ur10", "held panda", "held puma560", "tree", *("dh1", "dh4", "dh5"))
PRECISION = {"rigid": 1e-10, "yaml": 1e-12, "code": 1e-10}
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
        arm = robot_from_urdf(TREE, source="tree.urdf", lock=lock, gravity=[1.0, -2.0, 9.0])
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


@pytest.fixture(scope="module")
def folder(model: Robot, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("published")
    for name, text in model_files(model, "identified", "model.yaml", FORMATS).items():
        (path / name).write_text(text, encoding="utf-8")
    return path


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
def test_yaml_reads_back_each_effect_alone(
    kind: type[Effect], tmp_path: Path, model: Robot, motion: Motion
) -> None:
    alone = model.with_effects([valued(model, kind, np.random.default_rng(5))])
    for name, text in model_files(alone, "arm", "arm.yaml", ()).items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    written = load_robot(tmp_path / "arm.yaml")
    check(torque(written, motion), torque(alone, motion), PRECISION["yaml"])


def test_urdf_needs_the_torque_of_all_that_it_holds(
    model: Robot, motion: Motion, folder: Path
) -> None:
    """Read by Pinocchio with no word of joints that are held or kept."""
    alone = load_robot(folder / "identified.urdf").with_gravity(model.gravity)
    expected = with_only(model, ViscousFriction, CoulombFriction)
    check(torque(alone, motion), torque(expected, motion), PRECISION["rigid"])


def mujoco_model(folder: Path, *disabled: Any) -> tuple[Any, Any]:
    loaded = mujoco.MjModel.from_xml_path(str(folder / "identified.xml"))
    for flag in disabled:
        loaded.opt.disableflags |= flag
    return loaded, mujoco.MjData(loaded)


def mujoco_order(model: Robot, loaded: Any) -> np.ndarray:
    """Where each joint stands in MuJoCo, which goes down one branch after the other."""
    return np.array([loaded.jnt_dofadr[loaded.joint(joint).id] for joint in model.joints])


def mujoco_inverse(loaded: Any, data: Any, order: np.ndarray, motion: Motion) -> np.ndarray:
    tau = np.empty(motion.q.shape)
    for k in range(len(motion)):
        data.qpos[order], data.qvel[order] = motion.q[k], motion.dq[k]
        data.qacc[order] = motion.ddq[k]
        mujoco.mj_inverse(loaded, data)
        tau[k] = data.qfrc_inverse[order]
    return tau


def test_mjcf_needs_the_torque_without_dry_friction(
    model: Robot, motion: Motion, folder: Path
) -> None:
    loaded, data = mujoco_model(folder, mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    found = mujoco_inverse(loaded, data, mujoco_order(model, loaded), motion)
    check(found, torque(with_only(model, *SMOOTH), motion), PRECISION["rigid"])


def test_mjcf_needs_the_torque_of_dry_friction_where_joints_slide(
    model: Robot, motion: Motion, folder: Path
) -> None:
    """Its friction is soft: full once the velocity outweighs the acceleration of some 10 ms."""
    sliding = np.copysign(np.maximum(np.abs(motion.dq), 0.5), motion.dq)
    fast = Motion(motion.t, motion.q, sliding, 0.5 * motion.ddq / np.abs(motion.ddq).max())
    loaded, data = mujoco_model(folder, mujoco.mjtDisableBit.mjDSBL_LIMIT)
    found = mujoco_inverse(loaded, data, mujoco_order(model, loaded), fast)
    expected = torque(with_only(model, *SMOOTH, CoulombFriction), fast)
    check(found, expected, PRECISION["rigid"])


def test_mjcf_moves_as_its_controls_say(model: Robot, motion: Motion, folder: Path) -> None:
    """Forward dynamics under the model's torque, offsets included, gives the acceleration."""
    bits = mujoco.mjtDisableBit
    loaded, data = mujoco_model(folder, bits.mjDSBL_CONSTRAINT, bits.mjDSBL_CLAMPCTRL)
    order = mujoco_order(model, loaded)
    tau = torque(with_only(model, *SMOOTH, TorqueOffset), motion)
    found = np.empty(tau.shape)
    for k in range(len(motion)):
        data.qpos[order], data.qvel[order], data.ctrl[:] = motion.q[k], motion.dq[k], tau[k]
        mujoco.mj_forward(loaded, data)
        found[k] = data.qacc[order]
    check(found, motion.ddq, 1e-6)


def test_mjcf_puts_bodies_and_tools_where_pinocchio_does(
    model: Robot, motion: Motion, folder: Path
) -> None:
    loaded, data = mujoco_model(folder)
    order, reference = mujoco_order(model, loaded), model.model.createData()
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


def test_mjcf_has_the_limits(model: Robot, folder: Path) -> None:
    loaded, _ = mujoco_model(folder)
    for j, joint in enumerate(model.joints):
        bounded = bool(np.isfinite(model.limits.position[j]).all())
        assert loaded.joint(joint).limited[0] == bounded
        if bounded:
            np.testing.assert_allclose(loaded.joint(joint).range, model.limits.position[j])
        limit = model.limits.torque[j]
        if np.isfinite(limit):
            np.testing.assert_allclose(loaded.actuator(joint).ctrlrange, [-limit, limit])


def test_mjcf_takes_currents_where_gains_are_known(model: Robot, motion: Motion) -> None:
    gains = np.random.default_rng(5).uniform(2.0, 20.0, model.nv)
    text = model_files(model, "arm", "arm.yaml", ["mjcf"], gains)["arm.xml"]
    loaded = mujoco.MjModel.from_xml_string(text)
    bits = mujoco.mjtDisableBit
    loaded.opt.disableflags |= bits.mjDSBL_CONSTRAINT | bits.mjDSBL_CLAMPCTRL
    data, order = mujoco.MjData(loaded), mujoco_order(model, loaded)
    tau = torque(with_only(model, *SMOOTH, TorqueOffset), motion)
    data.qpos[order], data.qvel[order], data.ctrl[:] = motion.q[0], motion.dq[0], tau[0] / gains
    mujoco.mj_forward(loaded, data)
    np.testing.assert_allclose(data.qacc[order], motion.ddq[0], rtol=1e-6, atol=1e-6)


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
        xx, xy, xz, yy, yz, zz = (
            float(inertial.findtext(f"inertia/{key}"))
            for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        )
        tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        body = pin.Inertia(float(inertial.findtext("mass")), lever[:3], tensor)
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
    found = Sdf((folder / "identified.sdf").read_text(encoding="utf-8")).torque(motion)
    expected = torque(with_only(model, *SMOOTH, CoulombFriction), motion)
    check(found, expected, PRECISION["rigid"])


def test_sdf_needs_the_same_torque_in_drake(model: Robot, motion: Motion, folder: Path) -> None:
    """Read by libsdformat; Drake has no Coulomb friction, and takes gravity from code."""
    parsing = pytest.importorskip("pydrake.multibody.parsing", reason="Drake is not installed")
    plants = pytest.importorskip("pydrake.multibody.plant")
    tree = pytest.importorskip("pydrake.multibody.tree")
    plant = plants.MultibodyPlant(0.0)
    [instance] = parsing.Parser(plant).AddModels(str(folder / "identified.sdf"))
    plant.mutable_gravity_field().set_gravity_vector(model.gravity)
    plant.Finalize()
    context = plant.CreateDefaultContext()
    rows = [plant.GetJointByName(joint, instance).velocity_start() for joint in model.joints]
    found = np.empty(motion.q.shape)
    for k in range(len(motion)):
        state = np.zeros((3, model.nv))
        state[:, rows] = motion.q[k], motion.dq[k], motion.ddq[k]
        plant.SetPositions(context, state[0])
        plant.SetVelocities(context, state[1])
        forces = tree.MultibodyForces(plant)
        plant.CalcForceElementsContribution(context, forces)
        found[k] = plant.CalcInverseDynamics(context, state[2], forces)[rows]
    check(found, torque(with_only(model, *SMOOTH), motion), PRECISION["rigid"])


def test_sdf_names_nothing_twice_and_has_the_limits(model: Robot, folder: Path) -> None:
    read = Sdf((folder / "identified.sdf").read_text(encoding="utf-8"))
    names = [e.get("name") for e in read.model if e.get("name")]
    assert len(set(names)) == len(names)
    assert not {"world", "", None} & set(names)
    for joint, limits in zip(read.joints, model.limits.position, strict=True):
        found = (joint.findtext(f"axis/limit/{key}") for key in ("lower", "upper"))
        expected = [x if np.isfinite(x) else None for x in limits]
        assert [None if x is None else float(x) for x in found] == expected


def test_python_module_gives_the_torque(model: Robot, motion: Motion, folder: Path) -> None:
    module = executed(folder / "identified.py")
    expected = torque(model, motion)
    together = module["inverse_dynamics"](motion.q, motion.dq, motion.ddq)
    check(together, expected, PRECISION["code"])
    single = [
        module["inverse_dynamics"](*x) for x in zip(motion.q, motion.dq, motion.ddq, strict=True)
    ]
    check(single, expected, PRECISION["code"])
    still = np.zeros((1, model.nv))
    rest = torque(model, Motion([0.0], motion.q[:1], still, still))
    check(module["inverse_dynamics"](motion.q[:1], still, still), rest, PRECISION["code"])
    assert module["JOINTS"] == model.joints
    with pytest.raises(ValueError, match="shape"):
        module["inverse_dynamics"](motion.q[0, :-1], motion.dq[0], motion.ddq[0])


def test_python_module_needs_numpy_only(folder: Path) -> None:
    nodes = ast.walk(ast.parse((folder / "identified.py").read_text(encoding="utf-8")))
    imports = {alias.name for x in nodes if isinstance(x, ast.Import) for alias in x.names}
    assert imports == {"math", "numpy"}
    nodes = ast.walk(ast.parse((folder / "identified.py").read_text(encoding="utf-8")))
    assert not any(isinstance(node, ast.ImportFrom) for node in nodes)


def executed(path: Path) -> dict[str, Any]:
    module: dict[str, Any] = {}
    exec(compile(path.read_text(encoding="utf-8"), str(path), "exec"), module)
    return module


@pytest.fixture(scope="session")
def compiler() -> str:
    found = next(filter(None, map(shutil.which, ("cc", "gcc", "clang"))), None)
    if found is None:
        pytest.skip("no C compiler (cc, gcc or clang) on the path")
    return found


@pytest.fixture
def c_library(folder: Path, compiler: str) -> Path:
    library = folder / "identified.so"
    flags = ["-std=c99", "-Wall", "-Wextra", "-pedantic", "-Werror", "-O2", "-shared", "-fPIC"]
    words = [compiler, *flags, folder / "identified.c", "-o", library, "-lm"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return library


def test_c_function_gives_the_torque(
    model: Robot, motion: Motion, folder: Path, c_library: Path
) -> None:
    header = (folder / "identified.h").read_text(encoding="utf-8")
    [name] = {w.split("(")[0] for w in header.split() if "_inverse_dynamics(" in w}
    call = getattr(ctypes.CDLL(str(c_library)), name)
    call.restype = None
    pointer = np.ctypeslib.ndpointer(float, flags="C")
    call.argtypes = [pointer] * 4
    found = np.full(motion.q.shape, np.nan)
    for k in range(len(motion)):
        call(*(np.array(x[k]) for x in (motion.q, motion.dq, motion.ddq)), found[k])
    check(found, torque(model, motion), PRECISION["code"])
    assert "malloc" not in (folder / "identified.c").read_text(encoding="utf-8")


def test_files_name_what_they_cannot_hold(model: Robot, folder: Path) -> None:
    urdf, mjcf, sdf = (
        (folder / f"identified.{suffix}").read_text(encoding="utf-8")
        for suffix in ("urdf", "xml", "sdf")
    )
    for text in (urdf, mjcf, sdf):
        assert "not in this file: stribeck_friction" in text
        assert "model.yaml holds everything" in text
    for text in (urdf, sdf):
        assert "not in this file: torque offset" in text
    assert "not in this file: rotor inertia" in urdf
    assert "not in this file: rotor inertia" not in mjcf + sdf
    assert "not in this file: viscous" not in urdf + mjcf + sdf


@given(seed=st.integers(0, 2**32 - 1))
def test_any_chain_needs_the_same_torque_in_every_format(seed: int) -> None:
    robot, rng = chain(seed), np.random.default_rng(seed)
    model = robot.with_effects(every_effect(robot, rng))
    motion = Motion(np.arange(5.0), *robot.random_motion(rng, 5))
    files = model_files(model, "arm", "arm.yaml", FORMATS)
    module: dict[str, Any] = {}
    exec(files["arm.py"], module)
    found = module["inverse_dynamics"](motion.q, motion.dq, motion.ddq)
    check(found, torque(model, motion), PRECISION["code"])
    sliding = with_only(model, *SMOOTH, CoulombFriction)
    check(Sdf(files["arm.sdf"]).torque(motion), torque(sliding, motion), PRECISION["rigid"])
    loaded = mujoco.MjModel.from_xml_string(files["arm.xml"])
    loaded.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    smooth = mujoco_inverse(loaded, mujoco.MjData(loaded), np.arange(robot.nv), motion)
    check(smooth, torque(with_only(model, *SMOOTH), motion), PRECISION["rigid"])
