"""Files of a model, read back by others, need its torque; what is published, and what is not."""

import json
import re
import sys
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
import pytest
import yaml
from arms import TrueArm
from hypothesis import given
from hypothesis import strategies as st
from known_arms import Call, smooth_motion, write_csv
from marks import slow
from plant_recordings import swinging

from excitant.exceptions import BadInput, UnknownName
from excitant.identify import Estimate, identify_robot, load_dataset
from excitant.identify.drive_gains import DriveGains
from excitant.identify.export import held_by, lacking, model_files, publication, save_model
from excitant.identify.mujoco import mujoco_torque, side_by_side
from excitant.identify.preprocessing import Segment
from excitant.identify.refit import Refit
from excitant.identify.rows import predicted_torque
from excitant.robots import Motion, Robot, load_robot, rigid_body_torque, robot_from_dh, torque
from excitant.robots import effects as fx
from excitant.robots.parameters import violations
from excitant.robots.urdf import robot_from_urdf

SMOOTH = (fx.ViscousFriction, fx.RotorInertia, fx.Spring)
BUILT_IN = ("planar_2r", "ur10", "panda", "cmu_dd_arm_ii", "puma560", "cylindrical")
HELD = {
    "panda": {"panda_joint3": 0.4, "panda_joint7": -1.0},
    "puma560": {"joint1": 0.3, "joint4": 1.1},
    str(Path(__file__).parents[1] / "robots" / "data" / "tree.urdf"): {"grip": 0.03},
}
CONVENTIONS = ("standard", "modified")
DRIVES = ("viscous", "coulomb", "offset", "rotor")
SUFFIXES = ("urdf", "xml", "sdf")
PRECISION = {"rigid": 1e-10, "yaml": 1e-12}
BODY = load_robot("panda").phi[10:20]
BITS = mujoco.mjtDisableBit
AGREE = 0.02  # of the torque's standard deviation: MuJoCo's dry friction turns within 2 ms
GIVEN = "worse than the model as given"
Written = tuple[Robot, Motion, dict[str, str]]


def states(robot: Robot, n: int, seed: int = 0) -> Motion:
    return Motion(np.arange(float(n)), *robot.random_motion(np.random.default_rng(seed), n))


def valued(robot: Robot, kind: type[fx.Effect], rng: np.random.Generator) -> fx.Effect:
    if issubclass(kind, fx.AddedInertia):
        return kind(robot.joints[-1:]).with_values(BODY)
    effect = kind(robot.joints[-kind.acts_on.count :])
    return effect.with_values(rng.uniform(0.1, 1.0, len(effect.parameters(robot))))


def with_every_effect(robot: Robot) -> Robot:
    """All effects that every format can say or name, with values."""
    said = [k for k in fx.EFFECTS.values() if issubclass(k, fx.JointEffect | fx.AddedInertia)]
    rng = np.random.default_rng(3)
    return robot.with_effects([valued(robot, kind, rng) for kind in said])


def with_only(model: Robot, *kinds: type[fx.Effect]) -> Robot:
    kept = (*kinds, fx.AddedInertia)
    return model.with_effects([e for e in model.effects if isinstance(e, kept)])


def write(folder: Path, files: dict[str, str]) -> Path:
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")
    return folder


@pytest.fixture(
    scope="module",
    params=[*dict.fromkeys((*CONVENTIONS, *BUILT_IN)).items(), *HELD.items()],
    ids=lambda arm: f"{'held ' if arm[1] else ''}{Path(arm[0]).stem}",
)
def written(request: pytest.FixtureRequest, random_chain: Call, random_bodies: Call) -> Written:
    """An arm with inertias no table has and every effect, states of it, and its files."""
    name, held = request.param
    chain = name in CONVENTIONS
    robot = robot_from_dh(random_chain(5, 7, name)) if chain else load_robot(name, lock=held)
    if held:  # on a slope
        robot = robot.with_gravity([3.0, -4.0, -8.0])
    model = with_every_effect(robot.with_parameters(random_bodies(3, robot.nv)))
    return model, states(model, 40), model_files(model, "arm", "arm.yaml")


def check(found: Any, expected: np.ndarray, relative: float = PRECISION["rigid"]) -> None:
    assert np.abs(np.asarray(found) - expected).max() <= relative * np.abs(expected).max()


def test_yaml_reads_back_to_the_torque_with_every_effect(written: Written, tmp_path: Path) -> None:
    model, motion, files = written
    again = load_robot(write(tmp_path, files) / "arm.yaml")
    assert again.joints == model.joints
    check(torque(again, motion), torque(model, motion), PRECISION["yaml"])
    assert np.array_equal(again.limits.position, model.limits.position)
    assert np.array_equal(again.limits.torque, model.limits.torque)


@pytest.mark.parametrize("kind", fx.EFFECTS.values(), ids=fx.EFFECTS)
def test_yaml_reads_back_each_effect_alone(kind: type[fx.Effect], tmp_path: Path) -> None:
    robot = load_robot("panda", lock=HELD["panda"])
    alone = robot.with_effects([valued(robot, kind, np.random.default_rng(5))])
    again = load_robot(write(tmp_path, model_files(alone, "arm", "arm.yaml")) / "arm.yaml")
    motion = states(robot, 40)
    check(torque(again, motion), torque(alone, motion), PRECISION["yaml"])


def test_urdf_needs_the_torque_of_all_that_it_holds(written: Written, tmp_path: Path) -> None:
    """Read by Pinocchio with no word of joints that are held or kept."""
    model, motion, files = written
    alone = load_robot(write(tmp_path, files) / "arm.urdf").with_gravity(model.gravity)
    assert alone.joints == model.joints
    rubbing = with_only(model, fx.ViscousFriction, fx.CoulombFriction)
    check(torque(alone, motion), torque(rubbing, motion))
    fixed = ET.fromstring(files["arm.urdf"]).findall("joint[@type='fixed']")
    assert all(joint.find("limit") is None for joint in fixed)


def loaded_model(model: Robot, text: str, *disabled: Any) -> tuple[Any, Any, np.ndarray]:
    """Model, data, and where each joint stands in MuJoCo: one branch after the other."""
    loaded = mujoco.MjModel.from_xml_string(text)
    for flag in disabled:
        loaded.opt.disableflags |= flag
    order = np.array([loaded.jnt_dofadr[loaded.joint(joint).id] for joint in model.joints])
    return loaded, mujoco.MjData(loaded), order


def in_mujoco(
    model: Robot, text: str, motion: Motion, *disabled: Any, controls: np.ndarray | None = None
) -> np.ndarray:
    """Torque for the states of a motion or, where controls are given, acceleration."""
    (loaded, data, order), found = loaded_model(model, text, *disabled), []
    for k in range(len(motion)):
        data.qpos[order], data.qvel[order] = motion.q[k], motion.dq[k]
        if controls is None:
            data.qacc[order] = motion.ddq[k]
            mujoco.mj_inverse(loaded, data)
        else:
            data.ctrl[:] = controls[k]
            mujoco.mj_forward(loaded, data)
        found.append((data.qfrc_inverse if controls is None else data.qacc)[order])
    return np.array(found)


def test_mjcf_needs_the_torque_of_all_that_it_holds(written: Written) -> None:
    """Its dry friction is soft: full once the velocity outweighs the acceleration of 2 ms."""
    model, motion, files = written
    text, limits = files["arm.xml"], model.limits
    dq = np.copysign(np.maximum(np.abs(motion.dq), 0.5), motion.dq)
    fast = Motion(motion.t, motion.q, dq, 0.5 * motion.ddq / np.abs(motion.ddq).max())
    found = in_mujoco(model, text, fast, BITS.mjDSBL_LIMIT)
    check(found, torque(with_only(model, *SMOOTH, fx.CoulombFriction), fast))
    found = in_mujoco(model, text, motion, BITS.mjDSBL_CONSTRAINT)
    check(found, torque(with_only(model, *SMOOTH), motion))
    loaded = mujoco.MjModel.from_xml_string(text)
    for joint, ends, limit in zip(model.joints, limits.position, limits.torque, strict=True):
        assert loaded.joint(joint).limited[0] == np.isfinite(ends).all()
        if np.isfinite(ends).all():
            np.testing.assert_allclose(loaded.joint(joint).range, ends)
        if np.isfinite(limit):
            np.testing.assert_allclose(loaded.actuator(joint).ctrlrange, [-limit, limit])


@pytest.mark.parametrize("currents", [False, True])
def test_mjcf_moves_as_its_controls_say(written: Written, currents: bool) -> None:
    """Forward dynamics under the model's torque, offsets included, gives the acceleration."""
    model, motion, _ = written
    gains = np.random.default_rng(5).uniform(2.0, 20.0, model.nv) if currents else None
    text = model_files(model, "arm", "arm.yaml", ["mjcf"], gains)["arm.xml"]
    tau = torque(with_only(model, *SMOOTH, fx.TorqueOffset), motion)
    controls = tau if gains is None else tau / gains
    free = (BITS.mjDSBL_CONSTRAINT, BITS.mjDSBL_CLAMPCTRL)
    check(in_mujoco(model, text, motion, *free, controls=controls), motion.ddq, 1e-6)


def test_mjcf_puts_bodies_and_tools_where_pinocchio_does(written: Written) -> None:
    model, motion, files = written
    loaded, data, order = loaded_model(model, files["arm.xml"])
    reference = model.model.createData()
    frames = [f for f in model.model.frames if f.type == pin.FrameType.BODY]
    assert (loaded.nbody, loaded.nsite) == (model.nv + 1, len(frames) - model.nv)
    for q in motion.q[:5]:
        data.qpos[order] = q
        mujoco.mj_kinematics(loaded, data)
        pin.framesForwardKinematics(model.model, reference, q)
        for frame in frames:
            pose = reference.oMf[model.model.getFrameId(frame.name, pin.FrameType.BODY)]
            thing = data.body(frame.name) if frame.name in model.links else data.site(frame.name)
            np.testing.assert_allclose(thing.xpos, pose.translation, atol=1e-12)
            np.testing.assert_allclose(thing.xmat.reshape(3, 3), pose.rotation, atol=1e-12)


def numbers(element: ET.Element, path: str) -> np.ndarray:
    return np.array(element.findtext(path, "0").split(), float)


def read_sdf(text: str) -> tuple[ET.Element, Call]:
    """A reader of its own for SDFormat 1.9, as far as arms need it."""
    world = ET.fromstring(text).find("world")
    model, arm, drives = world.find("model"), pin.Model(), []
    arm.gravity.linear = numbers(world, "gravity")
    links = {link.get("name"): link for link in model.iterfind("link")}
    [mount] = model.findall("joint[@type='fixed']")
    assert mount.findtext("parent") == "world"
    ids = {mount.findtext("child"): 0}
    for joint in (j for j in model.iterfind("joint") if j is not mount):
        parent, child = joint.findtext("parent"), joint.findtext("child")
        link, pose = links[child], joint.find("pose")
        assert pose.attrib == {"rotation_format": "quat_xyzw", "relative_to": parent}
        assert link.find("pose").get("relative_to") == joint.get("name")
        assert not link.findtext("pose")
        sliding, place = joint.get("type") == "prismatic", pin.XYZQUATToSE3(numbers(joint, "pose"))
        kind = pin.JointModelPrismaticUnaligned if sliding else pin.JointModelRevoluteUnaligned
        axis = kind(numbers(joint, "axis/xyz"))
        ids[child] = arm.addJoint(ids[parent], axis, place, joint.get("name"))
        lever = numbers(link, "inertial/pose")
        assert not lever[3:].any()
        entries = [f"inertial/inertia/i{min(a, b)}{max(a, b)}" for a in "xyz" for b in "xyz"]
        tensor = np.reshape([numbers(link, entry) for entry in entries], (3, 3))
        body = pin.Inertia(numbers(link, "inertial/mass")[0], lever[:3], tensor)
        arm.appendBodyToJoint(ids[child], body, pin.SE3.Identity())
        keys = ("damping", "friction", "spring_stiffness", "spring_reference")
        paths = (*(f"axis/dynamics/{key}" for key in keys), "{drake.mit.edu}rotor_inertia")
        drives.append([numbers(joint, path)[0] for path in paths])
    Fv, Fc, k, rest, Ia = np.array(drives).T
    rigid = TrueArm(arm, Fv, Fc, Ia=Ia)
    return model, lambda motion: rigid.torque(motion) + k * (motion.q - rest)


def test_sdf_needs_the_torque_of_all_that_it_holds(written: Written) -> None:
    """It names nothing twice and has the limits."""
    model, motion, files = written
    read, needed = read_sdf(files["arm.sdf"])
    check(needed(motion), torque(with_only(model, *SMOOTH, fx.CoulombFriction), motion))
    names = [e.get("name") for e in read if e.get("name")]
    assert len({"world", *names}) == 1 + len(names)
    for limit, ends in zip(read.findall("joint/axis/limit"), model.limits.position, strict=True):
        found = [limit.findtext(key) for key in ("lower", "upper")]
        assert found == [str(x) if np.isfinite(x) else None for x in ends]


def test_ros2_parameters_hold_what_a_controller_adds(written: Written) -> None:
    """Doubles by name for any node: feed-forward of speed, friction, and what weighs the arm."""
    model, motion, _ = written
    text = model_files(model, "arm", "arm.yaml", ["ros2_control"])["arm_ros2_control.yaml"]
    [(node, [(key, found)])] = [(n, [*c.items()]) for n, c in yaml.safe_load(text).items()]
    assert (node, key) == ("/**", "ros__parameters")
    assert not re.search(r"[:-] -?\d+$", text, re.MULTILINE)
    friction, gains = found["friction"], found["gains"]
    assert tuple(friction) == tuple(gains) == model.joints
    kinds = (*SMOOTH[:2], fx.CoulombFriction, fx.TorqueOffset)
    own = {key: np.array([each[key] for each in friction.values()]) for key in DRIVES}
    rubbing = own["viscous"] * motion.dq + own["coulomb"] * np.sign(motion.dq)
    rubbing += own["offset"] + own["rotor"] * motion.ddq
    bare = with_only(model)
    check(rubbing, torque(with_only(model, *kinds), motion) - torque(bare, motion))
    assert gains == {j: {"ff_velocity_scale": own["viscous"]} for j, own in friction.items()}
    bodies = []
    for link in found["links"].values():
        tensor = np.array(link["inertia"])[[[0, 1, 2], [1, 3, 4], [2, 4, 5]]]
        body = pin.Inertia(link["mass"], np.array(link["centre_of_mass"]), tensor)
        bodies.append(body.toDynamicParameters())
    assert found["gravity"] == bare.gravity.tolist()
    check(torque(bare.with_effects([]).with_parameters(bodies), motion), torque(bare, motion))
    assert "# not in this file: Stribeck friction" in text
    assert all(line.startswith("#") for line in text.partition("/**")[0].splitlines())


def test_files_name_what_they_cannot_hold(written: Written) -> None:
    names = ("Stribeck friction", "torque offset", "rotor inertia", "viscous friction")
    for file, count in (("arm.urdf", 3), ("arm.sdf", 2), ("arm.xml", 1)):
        text = written[2][file]
        assert "arm.yaml holds everything" in text
        said = [f"not in this file: {name}" in text for name in names]
        assert said == [k < count for k in range(4)], file


@given(seed=st.integers(0, 10**6), nv=st.integers(2, 7), convention=st.sampled_from(CONVENTIONS))
def test_any_chain_needs_the_same_torque_in_every_format(random_chain, seed, nv, convention):
    model = with_every_effect(robot_from_dh(random_chain(seed, nv, convention)))
    motion, files = states(model, 5, seed), model_files(model, "arm", "arm.yaml")
    alone = robot_from_urdf(files["arm.urdf"], source="arm.urdf", gravity=model.gravity)
    for found, kinds in (
        (read_sdf(files["arm.sdf"])[1](motion), (*SMOOTH, fx.CoulombFriction)),
        (in_mujoco(model, files["arm.xml"], motion, BITS.mjDSBL_CONSTRAINT), SMOOTH),
        (torque(alone, motion), ()),
    ):
        check(found, torque(with_only(model, *kinds), motion))


@pytest.mark.parametrize("name", ["planar_2r", slow("ur10")])
def test_the_models_need_in_mujoco_what_excitant_predicts(name: str, runs: Any) -> None:
    robot = load_robot(name)
    fit, held = runs(robot, 4, tolerance=0.03)
    both = side_by_side(identify_robot(robot, [fit], validate=[held]))
    assert max(joint["differs"] for joint in both.result()["joints"]) < AGREE
    series = both.series()
    assert series["mujoco_identified"].shape == series["mujoco_given"].shape
    assert np.abs(series["mujoco_given"] - both.estimate.predicted_given).mean() < 0.1


@pytest.mark.parametrize("currents", [False, True])
def test_without_dry_friction_they_need_exactly_that(written: Written, currents: bool) -> None:
    """Offsets among it, of every arm, branches and held joints too; as currents where these are."""
    model = with_only(written[0], *SMOOTH, fx.TorqueOffset)
    motion = swinging(model, np.arange(0, 2, 0.01))
    rows = [Segment("", motion, motion.q, motion.q, 10.0, slice(10, 190, 2))]
    gains = np.linspace(2.0, 9.0, model.nv) if currents else 1.0
    found = gains * mujoco_torque(model, rows, gains if currents else None)
    check(found, predicted_torque(model, rows), 1e-9)


def test_mujoco_agrees_on_a_real_arm(data_folder: Path) -> None:
    """Whose wrist turns so slowly that MuJoCo's usual friction has half of its torque there."""
    s = load_dataset(data_folder / "ur10")
    found = identify_robot(s.robot, s.recordings([]), effects=fx.standard_effects(s.robot.joints))
    assert max(joint["differs"] for joint in side_by_side(found).result()["joints"]) < AGREE


def test_a_model_that_mujoco_refuses_is_left_out_with_a_note(planar: Robot, exact: Call) -> None:
    phi = np.array(planar.phi)
    phi[[4, 6, 9]] = 1e-3, 1e-3, 1.0  # about x, y, z: no body has it
    recording = exact(planar, np.arange(0, 12, 1 / 100))
    found = side_by_side(identify_robot(planar.with_parameters(phi), [recording]))
    assert found.given is None
    assert "MuJoCo refuses planar_2r" in found.result()["notes"][0]
    assert found.result()["joints"][0]["given"] is None


def test_command_draws_both_models_in_mujoco(tmp_path, planar, exact, excitant, monkeypatch):
    one = write_csv(tmp_path / "one.csv", exact(planar, np.arange(0, 8, 1 / 100)))
    words = ("identify planar_2r", one, "--mujoco", "-o", tmp_path / "out")
    ran = excitant(*words, "--formats", "ros2_control", "--json")
    assert ran.result["mujoco"]["version"] == mujoco.__version__
    assert len(ran.result["mujoco"]["joints"]) == planar.nv
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    said = ("In MuJoCo", "identified model in MuJoCo", "identified_ros2_control.yaml")
    assert all(words in page for words in said)
    monkeypatch.setitem(sys.modules, "mujoco", None)
    ran = excitant(*words[:-1], tmp_path / "none")
    assert (ran.status, ran.out) == (1, "")
    assert ran.err == "excitant: this needs mujoco: pip install 'excitant[mjcf]'\n"
    assert not (tmp_path / "none").exists()


@pytest.fixture(scope="module")
def estimate(planar: Robot, exact: Call) -> Estimate:
    """An identified arm whose description was 30 % off."""
    recording = exact(planar, np.arange(0, 12, 1 / 100))
    return identify_robot(planar.with_parameters(1.3 * planar.phi), [recording])


def judged(estimate: Estimate, predicted: np.ndarray, given: np.ndarray) -> Estimate:
    """The estimate with these predictions of the hold-out instead of its own."""
    copy = replace(estimate)
    vars(copy).update(predicted=predicted, predicted_given=given)  # cached properties
    return copy


def erring(estimate: Estimate, *sizes: float, seed: int = 0) -> np.ndarray:
    """The hold-out predicted with white errors, per joint in standard deviations of its torque."""
    noise = np.random.default_rng(seed).standard_normal(estimate.holdout.measured.shape)
    return estimate.holdout.measured + noise * sizes * estimate.holdout.measured.std(axis=0)


@pytest.mark.parametrize(
    ("found", "given", "published", "said"),
    [
        ((0.1, 0.1), (0.5, 0.5), True, ()),
        ((0.1, 0.1), (0.1, 0.1), True, ()),  # chance
        ((0.2, 0.1), (0.1, 0.5), True, ("joint1", "better at")),
        ((0.5, 0.5), (0.1, 0.1), False, (GIVEN, "joint1", "joint2")),
        ((0.1, 0.5), (0.2, 0.1), False, (GIVEN, "worst at joint2")),
        ((0.1, 1.5), (0.2, 9.0), False, ("worse than no model at joint2 (r² = -1.",)),
    ],
)
def test_a_model_worse_than_another_or_none_must_be_forced(estimate, found, given, published, said):
    model = judged(estimate, erring(estimate, *found), erring(estimate, *given, seed=1))
    plain, forced = publication(model), publication(model, force=True)
    assert forced.published
    beside = {"model.yaml", "model-estimate.csv", "identified.links"}
    assert set(forced.files) == {*(f"identified.{x}" for x in SUFFIXES), *beside}
    assert plain.published == published
    assert plain.files == (forced.files if published else {})
    assert all(words in plain.note for words in said)
    if published:
        assert plain.note == forced.note
        assert bool(plain.note) == bool(said)
    else:
        assert "--force" in plain.note
        assert "forced" in forced.note


def test_a_joint_whose_torque_is_its_noise_shows_nothing_to_be_judged(estimate: Estimate) -> None:
    rows, rng = estimate.holdout, np.random.default_rng(2)
    noise = rng.standard_normal(rows.t.size)
    measured = np.column_stack([rows.measured[:, 0], noise])
    model = judged(estimate, np.column_stack([measured[:, 0], 0.1 - 0.1 * noise]), measured)
    vars(model).update(holdout=replace(rows, measured=measured, raw=2 * measured))
    assert model.validate.r2[1] < 0
    assert "no model" not in publication(model).note


def test_nothing_in_python_holds_the_model_as_given(estimate: Estimate, tmp_path: Path) -> None:
    model, motion = estimate.model, states(estimate.model, 20)
    (tmp_path / "text.urdf").write_text(model.urdf, encoding="utf-8")
    [mjcf] = save_model(estimate, tmp_path / "arm.xml")
    save_model(estimate, tmp_path / "arm.yaml")
    arms = {"text.urdf": model, "arm.yaml": model, "arm.urdf": publication(estimate).arm("urdf")}
    for file, arm in arms.items():
        check(
            rigid_body_torque(load_robot(tmp_path / file), motion), rigid_body_torque(arm, motion)
        )
    check(torque(load_robot(tmp_path / "arm.yaml"), motion), torque(model, motion))
    assert mujoco.MjModel.from_xml_path(str(mjcf)).nv == model.nv
    files = {*arms, "arm.xml", "arm.links", "arm-estimate.csv"}
    assert {path.name for path in tmp_path.iterdir()} == files
    with pytest.raises(UnknownName, match=r"unknown format '\.step'"):
        save_model(estimate, tmp_path / "arm.step")
    carrying = model.with_effects([fx.Payload(model.joints[-1:]).with_values(BODY)])
    again = robot_from_urdf(carrying.urdf, "carrying")
    check(rigid_body_torque(again, motion), torque(carrying, motion))


def test_a_file_that_lacks_too_much_is_not_written(planar, exact, tmp_path):
    """Nor can anything in it stand for a ripple, of which the given model has most."""
    ripple = fx.TorqueRipple(planar.joints, order=20.0)
    true, most = (ripple.with_values([k, 2 * k] * planar.nv) for k in (4.0, 3.6))
    recording = exact(planar.with_effects([true]), np.arange(0, 12, 1 / 100))
    found = identify_robot(planar.with_effects([most]), [recording], effects=[ripple])
    model = publication(found)
    unwritten = {f"identified.{suffix}" for suffix in SUFFIXES}
    assert set(model.files) == {"model.yaml", "identified.links", "model-estimate.csv"}
    names = ", ".join(f"identified.{suffix}" for suffix in SUFFIXES)
    assert f"{names} are not written: without torque ripple of all joints" in model.note
    assert "\n" not in model.note
    exported = {file.file: file.entry() for file in model.exported}
    assert set(exported) == {"model.yaml", *unwritten}
    np.testing.assert_allclose(exported["model.yaml"]["rms"], found.validate.rms)
    assert exported["model.yaml"]["lacks"] == []
    given = found.baseline.nrmse.sum()
    for name in unwritten:
        assert not exported[name]["written"]
        assert sum(exported[name]["nrmse"]) > given > sum(exported["model.yaml"]["nrmse"])
    again = load_robot(write(tmp_path, dict(model.files)) / "model.yaml")
    check(predicted_torque(again, found.data.validate), found.predicted, PRECISION["yaml"])
    with pytest.warns(UserWarning, match=r"asked\.urdf: without torque ripple of all"):
        save_model(found, tmp_path / "asked.urdf")
    forced = publication(found, force=True)
    assert unwritten < set(forced.files)
    assert "not written" not in forced.note


def test_a_file_makes_up_for_what_its_format_lacks(planar, exact, tmp_path):
    """By Pinocchio and by MuJoCo, whose dry friction turns within 2 ms; model.yaml holds all."""
    friction = fx.AsymmetricFriction(planar.joints)
    true = planar.with_effects([friction.with_values(np.linspace(2.0, 4.5, 4 * planar.nv))])
    recording = exact(true, np.arange(0, 12, 1 / 100))
    found = identify_robot(planar, [recording], effects=[friction])
    rows, segments, done = found.holdout, found.data.validate, publication(found)
    write(tmp_path, dict(done.files))
    for file in done.exported[1:]:
        assert file.entry()["refitted"]
        assert "are fitted to make up for it" in done.files[file.file]
        assert not violations(file.arm.phi, planar.links)
        cut = rows.accuracy(predicted_torque(held_by(found.model, file.file_format), segments))
        assert file.accuracy.nrmse.sum() < 0.5 * cut.nrmse.sum()
    urdf, mjcf = (done.exported[k].accuracy.rms for k in (1, 2))
    save_model(found, tmp_path / "asked.urdf")
    for name in ("identified.urdf", "asked.urdf"):
        read = predicted_torque(load_robot(tmp_path / name), segments)
        np.testing.assert_allclose(urdf, rows.accuracy(read).rms, rtol=1e-9)
    again = model_files(done.arm("mjcf"), "arm", "arm.yaml")["arm.xml"].partition("-->")[2]
    assert done.files["identified.xml"].endswith(again)
    difference = np.abs(mjcf - rows.accuracy(mujoco_torque(done.arm("mjcf"), segments)).rms)
    assert (difference < AGREE * rows.measured.std(axis=0)).all()
    check(predicted_torque(load_robot(tmp_path / "model.yaml"), segments), found.predicted, 1e-12)


def test_currents_are_published_with_their_gains(estimate: Estimate) -> None:
    drive = DriveGains(np.array([12.0, 7.0]), np.zeros((2, 2)))
    read = replace(estimate, drive=drive, data=replace(estimate.data, unit="A"))
    currents = judged(read, estimate.predicted, estimate.predicted_given)
    files = publication(currents, formats=["mjcf"]).files
    assert yaml.safe_load(files["model.yaml"])["drive"] == {"gain_Nm_per_A": [12.0, 7.0]}
    assert 'gear="7.0"' in files["identified.xml"]
    assert "drive" not in yaml.safe_load(publication(estimate).files["model.yaml"])
    unsure = replace(read, drive=replace(drive, covariance=np.diag([0.0, 0.3])))
    files = publication(judged(unsure, estimate.predicted, estimate.predicted_given)).files
    joints = ET.fromstring(files["identified.xml"]).iterfind(".//body/joint")
    assert [float(joint.get("damping", 0)) > 0 for joint in joints] == [True, False]
    assert "not determined: the drive gain of joint2" in files["model.yaml"]


def test_command_writes_result_but_no_model_when_it_got_worse(tmp_path, planar, exact, excitant):
    """Of an arm with large torque offsets, judged on one that the given arm explains."""
    true = exact(planar, np.arange(0, 8, 1 / 100))
    unseen = write_csv(tmp_path / "true.csv", true)
    misled = write_csv(tmp_path / "misled.csv", replace(true, tau=np.add(true.tau, [40.0, 20.0])))
    words = ("identify planar_2r", misled, "--validate", unseen)
    ran = excitant(*words, "-o", tmp_path / "out")
    assert (ran.status, ran.err) == (1, "")
    [line] = [line for line in ran.out.splitlines() if "not published" in line]
    result = json.loads((tmp_path / "out" / "result.json").read_text(encoding="utf-8"))
    assert (result["published"], result["files"]) == (False, [])
    assert line in result["notes"]
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names == {"result.json", "summary.txt", "report.html", "series.npz"}
    options = ("--force", "--formats", "sdf", "--json", "-o", tmp_path / "forced")
    result = excitant(*words, *options).result
    assert result["published"] is True
    written = {file.rpartition(".")[2] for file in result["files"]}
    assert written == {"urdf", "links", "yaml", "sdf", "csv"}


def test_negative_friction_is_left_out_and_friction_without_values_refused(planar: Robot) -> None:
    with pytest.raises(BadInput, match="viscous_friction has no values"):
        model_files(planar.with_effects([fx.ViscousFriction(planar.joints)]), "arm", "arm.yaml")
    pairs = ((fx.CoulombFriction, 0.5), (fx.RotorInertia, 0.1))
    arm = planar.with_effects([kind(planar.joints, (-x, x)) for kind, x in pairs])
    files = model_files(arm, "arm", "arm.yaml")
    for name in ("arm.xml", "arm.sdf"):
        assert f"not in this file: negative Coulomb friction of {planar.joints[0]}" in files[name]
    loaded = mujoco.MjModel.from_xml_string(files["arm.xml"])
    np.testing.assert_array_equal(loaded.dof_frictionloss, [0.0, 0.5])
    np.testing.assert_array_equal(loaded.dof_armature, [0.0, 0.1])


ODD = """
<robot name="arm */ &quot;&quot;&quot; {x} -- 7 &#252;">
  <link name="base"/><link name="mount"/><link name="a--b"><inertial><mass value="1"/>
  <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
  <joint name="mount" type="continuous"><parent link="base"/><child link="mount"/></joint>
  <joint name="a--b" type="continuous"><parent link="mount"/><child link="a--b"/></joint>
</robot>
"""


def test_odd_names_break_no_file_and_occur_once() -> None:
    bare = robot_from_urdf(ODD, source="odd.urdf")
    arm = bare.with_parameters([1, 0, 0, 0, 1, 0, 1, 0, 0, 1] * 2)
    files = model_files(arm.with_effects([fx.TorqueOffset(("a--b",), (1.0,))]), "arm", "arm.yaml")
    ET.fromstring(files["arm.urdf"])
    mujoco.MjModel.from_xml_string(files["arm.xml"])
    names = [element.get("name") for element in read_sdf(files["arm.sdf"])[0]]
    assert len(set(names)) == len(names)
    assert bare.phi[0] == 0  # a link without mass is written as one
    text = model_files(bare, "arm", "arm.yaml")["arm.urdf"]
    assert np.array_equal(robot_from_urdf(text, source="arm.urdf").phi, bare.phi)


def test_what_files_make_up_for_holds_in_other_motions_and_known_torque(planar: Robot) -> None:
    """An offset looks like a first moment while the arm points to one side, not in the mirror."""
    path, found = smooth_motion(planar, np.arange(0, 12, 1 / 100)), []
    offset, friction = fx.TorqueOffset(planar.joints), fx.AsymmetricFriction(planar.joints)
    friction = friction.with_values(np.linspace(2.0, 4.5, 4 * planar.nv))
    for effect, middle in ((offset.with_values([8.0, 0.0]), np.pi / 2), (friction, 0.0)):
        arm = planar.with_effects([effect])
        motion = Motion(path.t, 0.4 * path.q + [middle, 0.0], 0.4 * path.dq, 0.4 * path.ddq)
        tau = torque(arm, motion)
        rows = Segment("run", motion, tau, tau, 10.0, slice(100, -100, 4))
        known = np.array([True, effect is not friction])
        found.append(Refit(arm, [rows], np.ones(2), known).of(held_by(arm, "urdf"), "urdf"))
    assert found[0] is None
    assert all(effect.values[0] > 0 == effect.values[1] for effect in found[1].effects)


def test_no_format_has_friction_that_turns_gradually() -> None:
    arm = load_robot("planar_2r")
    gradual = fx.turning(fx.CoulombFriction(arm.joints, (2.0, 3.0)), 0.1)
    for file_format in ("urdf", "mjcf", "sdf"):
        turned, jumping = (arm.with_effects([e]) for e in (gradual, fx.turning(gradual, 0.0)))
        told = ["gradual reversal of the friction of all joints"]
        assert (lacking(turned, file_format), lacking(jumping, file_format)) == (told, [])
        assert held_by(turned, file_format).effects == jumping.effects
