"""Diagnoses of real arms predict better, and what is known of the arms is seen; no records."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from urdf_arms import urdf_of

from excitant.analysis.diagnosis import Diagnosis, diagnose
from excitant.identify import Recording, identify_robot, load_dataset, recording_from_table
from excitant.robots import load_robot
from excitant.robots.parameters import violations

SAME = 1.02  # a joint may be this much worse, where nothing was found for it
SIMPLE = {"viscous_friction", "coulomb_friction"}
FINER = {"asymmetric_friction", "stribeck_friction", "nonlinear_viscous_friction"}
FINER |= {"load_dependent_friction", "presliding_hysteresis"}
FRICTION = SIMPLE | FINER
SLOW = {"presliding_hysteresis", "time_delay"}


def better(diagnosis: Diagnosis, factor: float) -> Diagnosis:
    """Better on every joint, by a factor over all of them, and with bodies that can be."""
    given, extended = diagnosis.simulation.rms, diagnosis.extended.rms
    assert (extended < SAME * given).all(), extended / given
    size = diagnosis.holdout.series.measured.std(axis=0)
    total = [float(np.sqrt(((e / size) ** 2).sum())) for e in (given, extended)]
    assert total[1] * factor < total[0], total
    model = diagnosis.extension.model
    assert violations(model.phi, model.links) == []
    return diagnosis


def diagnosed(folder: Path, factor: float, fitted: list[str], held: list[str]) -> Diagnosis:
    dataset = load_dataset(str(folder))
    train, unseen = (dataset.recordings(names) if names else [] for names in (fitted, held))
    found = better(diagnose(dataset.robot, train, validate=unseen), factor)
    assert len(found.result()["findings"]) <= 7
    return found


def seen(diagnosis: Diagnosis, kinds: set[str], *joints: str) -> list[str]:
    """Joints at which one of these effects is found, or is a rival of what is found there."""
    effects = [f.effect for f in diagnosis.findings]
    effects += [r.candidate.effect for f in diagnosis.findings for r in f.rivals]
    there = {joint for e in effects if e.name in kinds for joint in e.joints}
    return [joint for joint in joints or diagnosis.robot.joints if joint in there]


@pytest.mark.slow
def test_ur10_rubs_in_more_than_one_way(data_folder: Path) -> None:
    diagnosis = diagnosed(data_folder / "ur10", 4, ["unisa_exciting"], [])
    assert seen(diagnosis, FINER, "shoulder_pan_joint")
    assert seen(diagnosis, FRICTION) == [*diagnosis.robot.joints]


@pytest.mark.slow
def test_identify_and_diagnose_differ_by_named_effects_alone(data_folder: Path) -> None:
    """With the effects that diagnose finds, identify gives the same friction within its ±."""
    dataset = load_dataset(str(data_folder / "ur10"))
    [run] = dataset.recordings(["unisa_exciting"])
    fitted, held = [run.between(0, 0.6, "first")], [run.between(0.6, 1, "rest")]
    diagnosis = diagnose(dataset.robot, fitted, validate=held)
    effects = [e for e in diagnosis.extension.model.effects if e.role == "torque"]
    usual = identify_robot(dataset.robot, fitted, validate=held)
    same = identify_robot(dataset.robot, fitted, validate=held, effects=effects)
    known = [{p["name"]: p for p in each.result()["parameters"]} for each in (usual, same)]
    found = [p for f in diagnosis.result()["findings"] for p in f["parameters"]]
    plain = [p for p in found if p["name"].rpartition(".")[2] in ("Fv", "Fc") and p["std"]]
    [note] = [n for n in diagnosis.result()["notes"] if "share the torque" in n]
    apart = []
    for p in plain:
        twins = [other[p["name"]] for other in known]
        far = [abs(p["value"] - q["value"]) / np.hypot(p["std"], q["std"]) for q in twins]
        assert far[1] < 3, p
        if far[0] > 3:
            apart.append(p["name"].rpartition(".")[0])
    assert plain
    assert all(joint in note for joint in apart)


@pytest.mark.slow
def test_panda_lacks_the_hand_that_its_description_has(data_folder: Path) -> None:
    """The description holds a hand of 0.73 kg, which the recorded robot does not show."""
    diagnosis = diagnosed(data_folder / "panda", 5, ["gaz_traj1"], [])
    joints, model = diagnosis.robot.joints, diagnosis.extension.model
    bodies = [f.effect.joints for f in diagnosis.findings if f.effect.role != "torque"]
    assert any(joints[-1] in moved for moved in bodies)
    assert -1.1 < model.phi[-10] - diagnosis.robot.phi[-10] < -0.4
    assert len(seen(diagnosis, SLOW, *joints[3:])) >= 3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "fitted", "held", "slow"),
    [
        ("ur10e", ["id_10harm_20s"], ["id_12harm_50s"], False),
        ("dualarm_v2", ["exc_13p5"], ["exc_52p2"], True),
    ],
)
def test_arms_on_another_excitation(name, fitted, held, slow, data_folder):
    diagnosis = diagnosed(data_folder / name, 4, fitted, held)
    assert seen(diagnosis, FRICTION) == [*diagnosis.robot.joints]
    assert not slow or seen(diagnosis, SLOW)


@pytest.mark.slow
def test_xmate_from_placeholder_inertias(data_folder: Path) -> None:
    """Friction at the sensors, and offsets where transfer to the other robot fails."""
    diagnosis = diagnosed(data_folder / "rokae_xmate3", 2, ["rec02"], [])
    offset = {"torque_offset", "asymmetric_friction", "spring"}
    assert seen(diagnosis, offset, "joint1", "joint6") == ["joint1", "joint6"]


PENDULUM = {"axis": "0 1 0", "inertia": 2e-4, "low": -4, "high": 4, "velocity": 20, "effort": 2}
MOTIONS = ("sin_sin", "sin_time_square", "up_and_down")  # powered all along


@pytest.mark.slow
def test_servo_rotor_is_as_heavy_as_published_and_friction_grows_with_load(data_folder, tmp_path):
    """Two position gains fitted, a third held out; torque by the published motor constants."""
    folder = data_folder / "bam_xl330"
    files = (folder / f"{name}.json" for name in ("dataset", "known"))
    runs, known = (json.loads(file.read_text("utf-8")) for file in files)
    motor, description = known["published_parameters"]["m6"], tmp_path / "pendulum.urdf"
    chosen = [run for run in runs["recordings"] if run["trajectory"] in MOTIONS]
    mass, height = chosen[0]["mass_kg"], -chosen[0]["length_m"]
    description.write_text(urdf_of(PENDULUM, mass=mass, com=f"0 0 {height}"), encoding="utf-8")

    def recording(run: dict[str, str]) -> Recording:
        table = pd.read_parquet(folder / run["file"])
        voltage = table["pwm1"] / 885 * table["volt"]
        table["tau1"] = motor["kt"] * (voltage - motor["kt"] * table["dq1"]) / motor["R"]
        columns = table[["t", "q1", "dq1", "tau1"]]
        return recording_from_table(columns, 1, file=run["file"], name=run["name"])

    fitted = [recording(run) for run in chosen if run["kp"] != 200]
    held = [recording(run) for run in chosen if run["kp"] == 200]
    diagnosis = better(diagnose(load_robot(description), fitted, validate=held), 3)
    assert seen(diagnosis, {"load_dependent_friction"})
    [rotor] = [f.effect.values for f in diagnosis.findings if f.effect.name == "rotor_inertia"]
    assert (rotor or (0.0,))[0] == pytest.approx(1.81e-3, rel=0.4)
