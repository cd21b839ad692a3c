"""Diagnoses of real arms: the extended model predicts better, and what is known of them is seen.

Expectations are loose: they are what a change for the worse would break, not records.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from excitant.analysis.diagnosis import Diagnosis, diagnose
from excitant.identify import Recording, load_dataset, recording_from_table
from excitant.robots import load_robot
from excitant.robots.parameters import violations

SAME = 1.02  # a joint may be this much worse, where nothing was found for it
FRICTION = {
    "viscous_friction",
    "coulomb_friction",
    "asymmetric_friction",
    "stribeck_friction",
    "nonlinear_viscous_friction",
    "load_dependent_friction",
    "presliding_hysteresis",
}
SLOW = {"presliding_hysteresis", "time_delay"}


def diagnosed(
    folder: Path, name: str, fitted: Sequence[str], held: Sequence[str] = ()
) -> Diagnosis:
    dataset = load_dataset(str(folder / name))
    recordings = dataset.recordings(list(fitted))
    return diagnose(
        dataset.robot, recordings, validate=dataset.recordings(list(held)) if held else []
    )


def better(diagnosis: Diagnosis, factor: float) -> None:
    """Better on every joint, by a factor over all of them, and with bodies that can be."""
    given, extended = (diagnosis.held.rms(e) for e in (diagnosis.held.given, diagnosis.left))
    assert (extended < SAME * given).all(), extended / given
    size = diagnosis.held.series.measured.std(axis=0)
    total = [float(np.sqrt(((e / size) ** 2).sum())) for e in (given, extended)]
    assert total[1] * factor < total[0], total
    model = diagnosis.extension.model
    assert violations(model.phi, model.links) == []


def seen(diagnosis: Diagnosis, kinds: set[str], joint: str) -> bool:
    """Whether one of these effects is found at a joint, or a rival of what is found there."""
    effects = [f.effect for f in diagnosis.findings]
    effects += [r.candidate.effect for f in diagnosis.findings for r in f.rivals]
    return any(e.name in kinds and joint in e.joints for e in effects)


def test_ur10_rubs_in_more_than_one_way(data_folder: Path) -> None:
    diagnosis = diagnosed(data_folder, "ur10", ["unisa_exciting"])
    better(diagnosis, 4)
    assert diagnosis.refit.gain < 0.5  # inertias alone do not explain it
    finer = FRICTION - {"viscous_friction", "coulomb_friction"}
    assert seen(diagnosis, finer, "shoulder_pan_joint")
    for joint in diagnosis.robot.joints:
        assert seen(diagnosis, FRICTION, joint), joint


@pytest.mark.slow
def test_panda_lacks_the_hand_that_its_description_has(data_folder: Path) -> None:
    """The description holds a hand of 0.73 kg, which the recorded robot does not show."""
    diagnosis = diagnosed(data_folder, "panda", ["gaz_traj1"])
    better(diagnosis, 5)
    last = diagnosis.robot.joints[-1]
    bodies = [f.effect for f in diagnosis.findings if f.effect.role != "torque"]
    [lighter] = [(effect.values or (0.0,))[0] for effect in bodies if effect.joints == (last,)]
    assert -1.1 < lighter < -0.4
    assert sum(seen(diagnosis, SLOW, joint) for joint in diagnosis.robot.joints[3:]) >= 3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "fitted", "held", "slow"),
    [
        ("ur10e", ["id_12harm_30s", "id_10harm_20s"], ["id_12harm_50s"], False),
        ("dualarm_v2", ["exc_13p5", "exc_15p7"], ["exc_52p2"], True),
    ],
)
def test_arms_on_another_excitation(
    name: str, fitted: list[str], held: list[str], slow: bool, data_folder: Path
) -> None:
    diagnosis = diagnosed(data_folder, name, fitted, held)
    better(diagnosis, 4)
    for joint in diagnosis.robot.joints:
        assert seen(diagnosis, FRICTION, joint), joint
    assert not slow or any(seen(diagnosis, SLOW, joint) for joint in diagnosis.robot.joints)


@pytest.mark.slow
def test_xmate_from_placeholder_inertias(data_folder: Path) -> None:
    """Friction at the sensors, and offsets where transfer to the other robot fails."""
    diagnosis = diagnosed(data_folder, "rokae_xmate3", ["rec02"])
    better(diagnosis, 2)
    offset = {"torque_offset", "asymmetric_friction", "spring"}
    assert all(seen(diagnosis, offset, joint) for joint in ("joint1", "joint6"))


PENDULUM = """<robot name="pendulum"><link name="base"/><link name="arm"><inertial>
<origin xyz="0 0 {height}"/><mass value="{mass}"/>
<inertia ixx="2e-4" iyy="2e-4" izz="2e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="servo" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
<limit lower="-4" upper="4" velocity="20" effort="2"/></joint></robot>"""
MOTIONS = ("sin_sin", "sin_time_square", "up_and_down")  # powered all along


@pytest.mark.slow
def test_servo_rotor_is_as_heavy_as_published_and_friction_grows_with_load(
    data_folder: Path, tmp_path: Path
) -> None:
    """Two position gains fitted, a third held out; torque by the published motor constants."""
    folder = data_folder / "bam_xl330"
    runs = json.loads((folder / "dataset.json").read_text(encoding="utf-8"))["recordings"]
    known = json.loads((folder / "known.json").read_text(encoding="utf-8"))
    motor = known["published_parameters"]["m6"]
    description = tmp_path / "pendulum.urdf"
    mass, length = runs[0]["mass_kg"], runs[0]["length_m"]
    description.write_text(PENDULUM.format(mass=mass, height=-length), encoding="utf-8")

    def recording(run: dict[str, str]) -> Recording:
        table = pd.read_parquet(folder / run["file"])
        voltage = table["pwm1"] / 885 * table["volt"]
        table["tau1"] = motor["kt"] * (voltage - motor["kt"] * table["dq1"]) / motor["R"]
        columns = table[["t", "q1", "dq1", "tau1"]]
        return recording_from_table(columns, 1, file=run["file"], name=run["name"])

    chosen = [run for run in runs if run["trajectory"] in MOTIONS]
    fitted = [recording(run) for run in chosen if run["kp"] != 200]
    held = [recording(run) for run in chosen if run["kp"] == 200]
    diagnosis = diagnose(load_robot(description), fitted, validate=held)
    better(diagnosis, 3)
    assert seen(diagnosis, {"load_dependent_friction"}, "servo")
    [rotor] = [f.effect.values for f in diagnosis.findings if f.effect.name == "rotor_inertia"]
    assert (rotor or (0.0,))[0] == pytest.approx(1.81e-3, rel=0.4)
