"""What is published, under which names, and what is refused."""

from __future__ import annotations

import importlib.util
import json
import sys
import xml.etree.ElementTree as ET
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import mujoco
import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from excitant.cli import main
from excitant.exceptions import BadInput, UnknownName
from excitant.identify import Estimate, Recording, identify
from excitant.identify.export import (
    FORMATS,
    c_function,
    model_files,
    publication,
    python_module,
    sdf_text,
)
from excitant.identify.export.bodies import tree
from excitant.identify.export.expression import Program, call, constant, variable
from excitant.robots import Array, Motion, Robot, load_robot, torque
from excitant.robots.effects import (
    CoulombFriction,
    Effect,
    JointEffect,
    Parameter,
    Payload,
    RotorInertia,
    Term,
    TorqueOffset,
    ViscousFriction,
)
from excitant.robots.urdf import robot_from_urdf


@pytest.fixture(scope="module")
def estimate(planar: Robot) -> Estimate:
    """An identified arm whose description was 30 % off."""
    t = np.arange(0, 12, 1 / 100)
    q = np.column_stack([np.sin(2 * t) + 0.5 * np.sin(5 * t), np.cos(3 * t) + 0.4 * np.sin(7 * t)])
    dq = np.column_stack([2 * np.cos(2 * t) + 2.5 * np.cos(5 * t),
                          -3 * np.sin(3 * t) + 2.8 * np.cos(7 * t)])  # fmt: skip
    ddq = np.column_stack([-4 * np.sin(2 * t) - 12.5 * np.sin(5 * t),
                           -9 * np.cos(3 * t) - 19.6 * np.sin(7 * t)])  # fmt: skip
    recording = Recording("run", "run.csv", t, q, torque(planar, Motion(t, q, dq, ddq)))
    return identify(planar.with_parameters(1.3 * planar.phi), [recording])


def worse(estimate: Estimate) -> Estimate:
    """The same with the roles of both models on the hold-out exchanged."""
    return replace(estimate, validate=estimate.baseline, baseline=estimate.validate)


def test_a_better_model_is_published_without_a_word(estimate: Estimate) -> None:
    found = publication(estimate)
    assert found.published
    assert found.note == ""
    assert set(found.files) == {
        "identified.urdf", "model.yaml", "identified.xml", "identified.sdf"
    }  # fmt: skip


def test_a_worse_model_is_not_published_unless_forced(estimate: Estimate) -> None:
    refused = publication(worse(estimate))
    assert not refused.published
    assert refused.files == {}
    assert "--force" in refused.note
    assert "\n" not in refused.note
    for accuracy in (estimate.validate, estimate.baseline):
        assert f"{accuracy.nrmse.sum():.4g}" in refused.note
    forced = publication(worse(estimate), force=True)
    assert forced.published
    assert forced.files == publication(estimate).files
    assert "forced" in forced.note


@pytest.mark.parametrize(("factor", "published"), [(1.0, True), (1.005, True), (1.02, False)])
def test_a_model_as_good_as_the_given_one_is_published(
    estimate: Estimate, factor: float, published: bool
) -> None:
    baseline = replace(estimate.validate, nrmse=estimate.validate.nrmse / factor)
    assert publication(replace(estimate, baseline=baseline)).published is published


def test_a_joint_whose_torque_never_changed_does_not_decide(estimate: Estimate) -> None:
    def still(accuracy: object) -> object:
        return replace(accuracy, nrmse=np.array([accuracy.nrmse[0], np.nan]))

    silent = replace(estimate, validate=still(estimate.validate), baseline=still(estimate.baseline))
    assert publication(silent).published
    assert not publication(worse(silent)).published


def test_currents_are_published_with_their_gains(estimate: Estimate) -> None:
    gains = np.array([12.0, 7.0])
    currents = replace(estimate, gains=gains, data=replace(estimate.data, unit="A"))
    files = publication(currents, formats=["mjcf"]).files
    assert yaml.safe_load(files["model.yaml"])["drive"] == {"gain_Nm_per_A": [12.0, 7.0]}
    loaded = mujoco.MjModel.from_xml_string(files["identified.xml"])
    np.testing.assert_array_equal(loaded.actuator_gear[:, 0], gains)
    assert "drive" not in yaml.safe_load(publication(estimate).files["model.yaml"])


@pytest.fixture
def recorded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, estimate: Estimate) -> Path:
    """A recording that the given arm explains, and one of an arm with large torque offsets."""
    monkeypatch.chdir(tmp_path)
    [segment] = estimate.data.train
    motion = segment.motion
    arm = load_robot("planar_2r")
    other = arm.with_effects([*arm.effects, TorqueOffset(arm.joints, (40.0, 20.0))])
    for name, model in (("misled", other), ("true", arm)):
        columns = np.column_stack([motion.t, motion.q, torque(model, motion)])
        header = "t,q1,q2,tau1,tau2"
        np.savetxt(f"{name}.csv", columns, delimiter=",", header=header, comments="")
    return tmp_path


def test_command_writes_result_but_no_model_when_it_got_worse(
    recorded: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["identify", "planar_2r", "misled.csv", "--validate", "true.csv"]
    assert main([*words, "-o", "out"]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    [line] = [line for line in out.splitlines() if "not published" in line]
    result = json.loads((recorded / "out" / "result.json").read_text(encoding="utf-8"))
    assert result["published"] is False
    assert line in result["notes"]
    assert result["files"] == []
    written = {path.name for path in (recorded / "out").iterdir()}
    assert written == {"result.json", "summary.txt", "report.html", "series.npz"}
    assert main([*words, "--force", "--formats", "python,c", "-o", "forced"]) == 0
    result = json.loads((recorded / "forced" / "result.json").read_text(encoding="utf-8"))
    assert result["published"] is True
    suffixes = {Path(file).suffix for file in result["files"]}
    assert suffixes == {".urdf", ".yaml", ".py", ".c", ".h"}


def test_command_refuses_an_unknown_format_before_it_works(
    recorded: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["identify", "planar_2r", "absent.csv", "--formats", "mjfc"]) == 1
    assert "unknown format 'mjfc': did you mean 'mjcf'?" in capsys.readouterr().err


def test_unknown_format_is_refused(planar: Robot) -> None:
    with pytest.raises(UnknownName, match="did you mean 'python'"):
        model_files(planar, "arm", "arm.yaml", ["pyton"])


def test_effect_without_values_is_refused(planar: Robot) -> None:
    with pytest.raises(BadInput, match="viscous_friction has no values"):
        model_files(planar.with_effects([ViscousFriction(planar.joints)]), "arm", "arm.yaml")


def test_payload_becomes_part_of_its_link(planar: Robot, tmp_path: Path) -> None:
    load = np.array([2.0, 0.1, 0, 0, 0.01, 0, 0.02, 0, 0, 0.02])
    held = planar.with_effects([Payload(planar.joints[-1:]).with_values(load)])
    for name, text in model_files(held, "arm", "arm.yaml").items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    written = load_robot(tmp_path / "arm.yaml")
    assert written.effects == ()
    np.testing.assert_allclose(written.phi[10:], planar.phi[10:] + load, atol=1e-12)
    loaded = mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml"))
    assert loaded.body(planar.links[-1]).mass[0] == pytest.approx(planar.phi[10] + 2.0)


@dataclass(frozen=True)
class CubicFriction(JointEffect):
    """An effect that the exporter has never heard of."""

    name: ClassVar[str] = "cubic"
    terms: ClassVar[tuple[Term, ...]] = (Term("a", "N·m"), Term("b", "N·m"))

    def of_state(self, q: Array, dq: Array, ddq: Array) -> tuple[Array, ...]:
        return (
            np.tanh(3 * dq) / (1 + np.abs(dq)) - np.maximum(-dq, 0.0),
            -(dq**3) * np.cos(2 * q - 0.5) + np.square(ddq) / 7.0 + np.ones_like(q),
        )


@dataclass(frozen=True)
class Switch(JointEffect):
    """An effect with a case distinction that arithmetic cannot say."""

    name: ClassVar[str] = "switch"
    terms: ClassVar[tuple[Term, ...]] = (Term("a", "N·m"),)

    def of_state(self, q: Array, dq: Array, ddq: Array) -> tuple[Array, ...]:
        return (np.where(dq > 1, dq, 0.0),)


@dataclass(frozen=True)
class Coupling(Effect):
    """An effect of one joint on another."""

    name: ClassVar[str] = "coupling"

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        return (Parameter("k", "N·m"),)

    def columns(self, robot: Robot, motion: Motion) -> Array:
        return np.repeat(motion.dq[:, ::-1, None], 1, axis=2)


def test_new_effects_of_one_joint_are_written_as_code(planar: Robot) -> None:
    arm = planar.with_effects([CubicFriction(planar.joints, (0.3, -0.2, 1.1, 0.7))])
    module: dict[str, object] = {}
    exec(python_module(tree(arm)), module)
    motion = Motion(np.arange(30.0), *planar.random_motion(np.random.default_rng(0), 30))
    found = module["inverse_dynamics"](motion.q, motion.dq, motion.ddq)
    np.testing.assert_allclose(found, torque(arm, motion), rtol=1e-12, atol=1e-9)


@pytest.mark.parametrize("kind", [Switch, Coupling])
def test_effects_that_code_cannot_say_are_refused_by_name(
    planar: Robot, kind: type[Effect]
) -> None:
    effect = kind(planar.joints)
    arm = planar.with_effects([effect.with_values(np.ones(len(effect.parameters(planar))))])
    for file_format in ("python", "c"):
        with pytest.raises(BadInput, match=effect.name):
            model_files(arm, "arm", "arm.yaml", [file_format])
    text = model_files(arm, "arm", "arm.yaml", ["mjcf"])["arm.xml"]
    assert f"not in this file: {effect.name} of all joints" in text


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


def test_odd_names_neither_break_nor_enter_the_code() -> None:
    arm = robot_from_urdf(ODD, source="odd.urdf")
    arm = arm.with_parameters([1, 0, 0, 0, 1, 0, 1, 0, 0, 1] * 2)
    arm = arm.with_effects([TorqueOffset(("a--b",), (1.0,))])
    files = model_files(arm, "arm", "arm.yaml", FORMATS)
    for suffix in ("urdf", "sdf", "xml"):
        ET.fromstring(files[f"arm.{suffix}"])
    mujoco.MjModel.from_xml_string(files["arm.xml"])
    module: dict[str, object] = {}
    exec(files["arm.py"], module)
    assert module["JOINTS"] == ("mount", "a--b")
    source, header = c_function(tree(arm), "arm")
    assert "void arm_x_7_inverse_dynamics(" in header
    for text in (source, header):
        assert text.count("/*") == text.count("*/")


def test_sdf_tells_links_from_joints_of_the_same_name() -> None:
    arm = robot_from_urdf(ODD, source="odd.urdf")
    arm = arm.with_parameters([1, 0, 0, 0, 1, 0, 1, 0, 0, 1] * 2)
    model = ET.fromstring(sdf_text(tree(arm), "x.yaml")).find("world/model")
    assert model is not None
    names = [element.get("name") for element in model]
    assert len(set(names)) == len(names)


def test_held_joints_are_fixed_in_the_urdf() -> None:
    held = {"panda_joint3": 0.4, "panda_joint7": -1.0}
    arm = load_robot("panda", lock=held)
    written = robot_from_urdf(
        model_files(arm, "arm", "arm.yaml")["arm.urdf"], source="arm.urdf", gravity=arm.gravity
    )
    assert written.joints == arm.joints
    root = ET.fromstring(written.urdf)
    for joint in root.findall("joint"):
        if joint.get("name") in held:
            assert joint.get("type") == "fixed"
            assert joint.find("limit") is None


def test_a_link_without_mass_is_written_as_one() -> None:
    arm = robot_from_urdf(ODD, source="odd.urdf")
    assert arm.phi[0] == 0
    text = model_files(arm, "arm", "arm.yaml", FORMATS)["arm.urdf"]
    assert np.array_equal(robot_from_urdf(text, source="arm.urdf").phi, arm.phi)


def test_negative_friction_is_left_out_and_said_so(planar: Robot) -> None:
    arm = planar.with_effects(
        [
            CoulombFriction(planar.joints, (-0.5, 0.5)),
            RotorInertia(planar.joints, (-0.1, 0.1)),
        ]
    )
    files = model_files(arm, "arm", "arm.yaml")
    for name in ("arm.xml", "arm.sdf"):
        assert f"not in this file: negative Coulomb friction of {planar.joints[0]}" in files[name]
    loaded = mujoco.MjModel.from_xml_string(files["arm.xml"])
    np.testing.assert_array_equal(loaded.dof_frictionloss, [0.0, 0.5])
    np.testing.assert_array_equal(loaded.dof_armature, [0.0, 0.1])


numbers = st.floats(-3, 3).map(lambda x: round(x, 3)) | st.sampled_from([0.0, 1.0, -1.0])
atoms = st.sampled_from([0, 1, 2]) | numbers
formulas = st.recursive(
    atoms,
    lambda inner: st.tuples(st.sampled_from("+-*n"), inner, inner),
    max_leaves=12,
)


@given(formula=formulas, values=st.tuples(*[st.floats(-2, 2)] * 3))
def test_written_arithmetic_is_arithmetic(formula: object, values: tuple[float, ...]) -> None:
    """Whatever is folded or bracketed, the text says what the operations would give."""
    names = ("x", "y", "z")

    def evaluated(node: object, leaf: object) -> object:
        if not isinstance(node, tuple):
            return leaf(node)
        left, right = (evaluated(part, leaf) for part in node[1:])
        return {
            "+": lambda: left + right,
            "-": lambda: left - right,
            "*": lambda: left * right,
            "n": lambda: -left,
        }[node[0]]()

    known = dict(zip(names, values, strict=True))
    text = evaluated(formula, lambda x: variable(names[x]) if type(x) is int else constant(x)).text
    expected = evaluated(formula, lambda x: values[x] if type(x) is int else x)
    assert eval(text, known) == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_what_no_result_needs_is_not_written() -> None:
    program = Program()
    used = program.let("a", call("sin", variable("q")))
    program.let("b", used * 2)
    result = program.let("c", used + 1)
    assert [s.name for s in program.needed((result,))] == ["a", "c"]


def benchmark(name: str) -> Any:
    path = Path(__file__).resolve().parents[2] / "benchmarks" / f"{name}.py"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


def test_identified_mjcf_follows_the_recording_better(capsys: pytest.CaptureFixture[str]) -> None:
    """Under the same commands, feed-forward and position loop, in MuJoCo."""
    benchmark("tracking").main(["--robots", "planar_2r", "--sets", "--bandwidth", "5", "20"])
    lines = [line for line in capsys.readouterr().out.splitlines() if "ratio" in line]
    ratios = [float(line.split("ratio")[1].split(";")[0]) for line in lines]
    assert len(ratios) == 2
    assert min(ratios) > 2


def test_times_of_published_code_come_with_its_error(capsys: pytest.CaptureFixture[str]) -> None:
    benchmark("inverse_dynamics").main(["--robot", "planar_2r", "--calls", "500"])
    _, line = capsys.readouterr().out.splitlines()
    assert float(line.split()[-1]) < 1e-10
    assert all(float(word) > 0 for word in line.split()[2:5])
