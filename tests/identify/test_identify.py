"""From recordings to a model that predicts, on virtual and on real arms."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from excitant.exceptions import RankDeficient
from excitant.identify import (
    Estimate,
    Recording,
    identify_robot,
    load_dataset,
    model_files,
)
from excitant.robots import Motion, Robot, load_robot, torque
from excitant.robots.parameters import violations

Runs = Callable[..., list[Recording]]


@pytest.fixture(scope="module", params=["ur10", "panda"])
def ideal(request: pytest.FixtureRequest, runs: Runs) -> Estimate:
    """An arm whose values are off by some per cent, seen by true sensors."""
    robot = load_robot(request.param)
    excitation, holdout = runs(robot, 0, tolerance=0.03)
    return identify_robot(robot, [excitation], validate=[holdout])


def test_a_virtual_arm_is_predicted_on_another_motion(ideal: Estimate) -> None:
    # only where a joint turns back does the sign of a filtered velocity err: for about one
    # period of the 20 Hz position filter, by twice the friction torque
    segment = ideal.data.validate[0]
    turns = (np.diff(np.sign(segment.motion.dq), axis=0) != 0).sum(axis=0)
    share = turns / 20.0 / (segment.t[-1] - segment.t[0])
    friction = np.array(ideal.model.effects[1].values)
    allowed = 0.02 * segment.tau.std(axis=0) + 2 * friction * np.sqrt(share)
    assert (ideal.validate.rms <= allowed).all()
    assert (ideal.validate.rms < ideal.baseline.rms).all()
    assert ideal.validate.nrmse.mean() < 0.03


def test_the_model_is_one_that_bodies_can_have(ideal: Estimate) -> None:
    assert violations(ideal.phi, ideal.given.links) == []
    assert ideal.physical.kkt.stationarity <= 1e-8
    for effect in ideal.model.effects:
        for parameter, value in zip(
            effect.parameters(ideal.given), effect.values or (), strict=True
        ):
            assert value >= parameter.lower - 1e-6, parameter.name


def test_the_result_has_the_agreed_keys(ideal: Estimate) -> None:
    result, arrays = ideal.result(), ideal.series()
    agreed = {"estimator", "effects", "cutoff_hz", "joints", "parameters", "base_parameters"}
    assert agreed | {"physical"} <= set(result)
    for joint in result["joints"]:
        for part in ("train", "validate", "baseline"):
            assert {"rms", "rms_raw", "nrmse", "r2"} == set(joint[part]) - {"interval95"}
    keys = {"name", "link", "value", "std", "unit", "category", "prior", "prior_dominated"}
    assert all(keys == set(p) for p in result["parameters"])
    assert len(result["parameters"]) == 14 * ideal.given.nv
    assert result["physical"]["consistent"]
    unknown = [p for p in result["parameters"] if p["category"] == "unidentifiable"]
    assert unknown
    assert all(p["prior_dominated"] for p in unknown)
    assert {len(values) for values in arrays.values()} == {len(ideal.holdout.t)}


def test_accuracy_is_what_its_words_say(ideal: Estimate) -> None:
    error = ideal.holdout.measured - ideal.predicted
    np.testing.assert_allclose(ideal.validate.rms, np.sqrt((error**2).mean(axis=0)))
    spread = ideal.holdout.measured.std(axis=0)
    np.testing.assert_allclose(ideal.validate.r2, 1 - (ideal.validate.rms / spread) ** 2)


def test_exact_data_of_bodies_give_exact_predictions(
    exact: Callable[..., Recording], ur10: Robot
) -> None:
    bare, t = ur10.with_effects(()), np.arange(0, 20, 1 / 128)
    prior = bare.with_parameters((bare.phi.reshape(6, 10) * 1.2).ravel())
    recording = exact(bare, t)
    found = identify_robot(prior, [recording], effects=())
    # what is left are the edges, where the position filter does not know what came before
    assert (found.validate.nrmse <= 5e-3).all()
    assert (found.baseline.nrmse >= 0.15).all()


def test_an_arm_of_one_joint_is_identified_and_written(
    exact: Callable[..., Recording], tmp_path: Path
) -> None:
    arm = tmp_path / "pendulum.urdf"
    arm.write_text(
        """<robot name="pendulum"><link name="base"/><link name="arm"><inertial>
        <origin xyz="0 0 -0.2"/><mass value="1"/>
        <inertia ixx="0.01" iyy="0.01" izz="0.002" ixy="0" ixz="0" iyz="0"/></inertial></link>
        <joint name="hinge" type="revolute"><parent link="base"/><child link="arm"/>
        <axis xyz="0 1 0"/><limit lower="-3" upper="3" velocity="6" effort="20"/></joint></robot>"""
    )
    robot = load_robot(arm)
    found = identify_robot(
        robot.with_parameters(1.2 * robot.phi), [exact(robot, np.arange(0, 20, 0.01))]
    )
    assert (found.validate.nrmse <= 5e-3).all()
    for name, text in model_files(found.model, "identified", "model.yaml").items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    motion = Motion(np.arange(50) / 10, *robot.random_motion(np.random.default_rng(0), 50))
    reloaded = torque(load_robot(tmp_path / "model.yaml"), motion)
    np.testing.assert_allclose(reloaded, torque(found.model, motion), atol=1e-9)


def test_a_motion_that_hides_parameters_is_refused_by_name(
    exact: Callable[..., Recording], planar: Robot
) -> None:
    recording = exact(planar, np.arange(0, 20, 1 / 128))
    q = np.array(recording.q)
    q[:, 1] = 0.3
    still = Recording("still", "still.csv", recording.t, q, recording.tau)
    with pytest.raises(RankDeficient, match=r"joint2\.Fv"):
        identify_robot(planar, [still])


def test_drive_gains_are_recovered_from_current(ur10: Robot, runs: Runs) -> None:
    rng = np.random.default_rng(4)
    gains = 10 * np.exp(rng.uniform(-0.5, 0.5, ur10.nv))
    excitation, holdout = runs(ur10, 1)
    currents = [
        Recording(r.name, r.file, r.t, r.q, r.tau / gains, "A") for r in (excitation, holdout)
    ]
    found = identify_robot(ur10, currents[:1], validate=currents[1:])
    # the scale rests on the given masses, which are the true ones here; the last joint turns a
    # balanced link, whose torque its rotor could make, so its gain stays near those of the others
    np.testing.assert_allclose(found.gains[:5], gains[:5], rtol=0.02)
    assert abs(np.log(found.gains[5] / gains[5])) < 0.5
    assert any("drive gains" in note for note in found.notes)
    assert found.validate.nrmse.mean() < 0.03
    heavier = ur10.with_parameters(1.25 * ur10.phi)
    scaled = identify_robot(heavier, currents[:1], validate=currents[1:]).gains
    np.testing.assert_allclose(scaled, 1.25 * found.gains, rtol=0.01)


def test_current_and_torque_of_one_arm_say_the_same(ur10: Robot, runs: Runs) -> None:
    k = slice(100, -100)  # at rest, at both ends, the side of dry friction is a matter of rounding
    nrmse = []
    for gain, unit in ((1.0, "N·m"), (12.0, "A")):
        read = [
            Recording(r.name, r.file, r.t[k], r.q[k], r.tau[k] / gain, unit) for r in runs(ur10, 2)
        ]
        nrmse.append(identify_robot(ur10, read[:1], validate=read[1:]).validate.nrmse)
    np.testing.assert_allclose(nrmse[1], nrmse[0], atol=1e-3)


def test_real_ur10_is_no_worse_than_the_reference(data_folder: Path) -> None:
    dataset = load_dataset(data_folder / "ur10")
    found = identify_robot(dataset.robot, dataset.recordings([]))
    reference = np.array([3.34, 3.39, 2.24, 0.88, 0.46, 1.14])  # N·m, same rows and cut-off
    assert (found.validate.rms <= 1.05 * reference).all(), found.validate.rms
    assert found.validate.rms.sum() < reference.sum()
    assert violations(found.phi, dataset.robot.links) == []
    assert (found.validate.rms < found.baseline.rms).all()


def test_real_ur10e_is_predicted_from_its_currents(data_folder: Path) -> None:
    dataset = load_dataset(data_folder / "ur10e")
    train = dataset.recordings(["id_12harm_30s", "id_14harm_unloaded"])
    [held] = dataset.recordings(["val_ptp_10_points"])
    found = identify_robot(dataset.robot, train, validate=[held])
    assert found.data.unit == "A"
    assert violations(found.phi, dataset.robot.links) == []
    assert (found.gains > 0).all()
    assert (found.validate.r2 > 0.5).all(), found.validate.r2
    assert found.result()["drive_gain_Nm_per_A"] == list(found.gains)
