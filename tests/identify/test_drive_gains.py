"""A known payload gives drive gains their scale, with honest uncertainty, or is refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pinocchio as pin
import pytest

from excitant.exceptions import BadInput
from excitant.identify import KnownPayload, Recording, identify_drive_gains, identify_robot
from excitant.identify.drive_gains import DriveGains, payload_gains
from excitant.identify.regression import Regression, dense
from excitant.robots import Array, Motion, Robot, base_parameters, load_robot
from excitant.robots.effects import standard_effects
from excitant.robots.torque import observation_columns

MASS, CENTRE = 2.0, (0.02, -0.03, 0.18)
INERTIA = (0.008, 0.0, 0.01, 0.0, 0.0, 0.012)
MotionOf = Callable[..., Motion]
Runs = tuple[Recording, Recording]


class Bench:
    """An arm with friction, whose currents are recorded with and without a payload."""

    def __init__(self, name: str, motion_of: MotionOf) -> None:
        self.robot, self.motion_of = load_robot(name).with_effects(()), motion_of
        nv = self.robot.nv
        rng = np.random.default_rng(1)
        self.gains = 10 * np.exp(rng.uniform(-0.5, 0.5, nv))
        self.friction = rng.uniform(0.2, 1, (3, nv)) * np.array([[3], [2], [0.1]])
        self.effects = standard_effects(self.robot.joints)
        self.base = base_parameters(self.robot, self.effects)
        self.bare = self.robot.model
        self.loaded = self.with_payload(MASS)

    def with_payload(self, mass: float, centre: tuple[float, ...] = CENTRE) -> pin.Model:
        spread = np.diag([INERTIA[0], INERTIA[2], INERTIA[5]]) * mass / MASS
        model = self.bare.copy()
        model.inertias[self.robot.nv] += pin.Inertia(mass, np.array(centre), spread)
        return model

    def torque(self, model: pin.Model, m: Motion) -> Array:
        data = model.createData()
        rigid = [pin.rnea(model, data, *s) for s in zip(m.q, m.dq, m.ddq, strict=True)]
        viscous, coulomb, rotor = self.friction
        return np.array(rigid) + viscous * m.dq + coulomb * np.sign(m.dq) + rotor * m.ddq

    def rows(self, model: pin.Model, seed: int, share: float = 0.02) -> Regression:
        rng = np.random.default_rng([3, seed])
        m = self.motion_of(self.robot, np.arange(0, 20, 0.05), seed)
        tau = self.torque(model, m)
        noise = share * self.torque(self.bare, m).std(axis=0) * rng.standard_normal(tau.shape)
        W = observation_columns(self.robot, self.effects, m)[:, :, self.base.columns]
        return dense(W, (tau + noise) / self.gains, self.base.expressions)

    def found(self, free: Regression, held: Regression, payload: KnownPayload) -> DriveGains:
        body = self.base.regrouping[:, 10 * (self.robot.nv - 1) : 10 * self.robot.nv]
        return payload_gains(free, held, payload, body)

    def recording(self, name: str, model: pin.Model, seed: int) -> Recording:
        rng = np.random.default_rng([4, seed])
        m = self.motion_of(self.robot, np.arange(0, 20, 0.01), seed)
        tau = self.torque(model, m)
        noise = 0.05 * tau.std(axis=0) * rng.standard_normal(tau.shape)
        return Recording(name, f"{name}.csv", m.t, m.q, (tau + noise) / self.gains, "A")


@pytest.fixture(scope="module")
def planar_bench(motion_of: MotionOf) -> Bench:
    return Bench("planar_2r", motion_of)


@pytest.fixture(scope="module")
def ur10_bench(motion_of: MotionOf) -> Bench:
    return Bench("ur10", motion_of)


PAYLOADS = (KnownPayload(MASS), KnownPayload(MASS, centre=CENTRE))


def test_without_noise_the_gains_are_exact(ur10_bench: Bench) -> None:
    b = ur10_bench
    free, held = b.rows(b.bare, 0, 1e-9), b.rows(b.loaded, 1, 1e-9)
    for payload in PAYLOADS:
        found = b.found(free, held, payload)
        np.testing.assert_allclose(found.gains, b.gains, rtol=1e-5)
        assert all(found.shown)


@pytest.mark.parametrize("payload", PAYLOADS)
def test_gains_are_within_three_deviations_that_are_calibrated(
    planar_bench: Bench, payload: KnownPayload
) -> None:
    b, errors = planar_bench, []
    for draw in range(30):
        free, held = b.rows(b.bare, 2 * draw), b.rows(b.loaded, 2 * draw + 1)
        found = b.found(free, held, payload)
        errors.append((found.gains - b.gains) / found.std)
        assert (found.std < 0.02 * b.gains).all()
    assert np.abs(errors).max() < 3.5
    assert np.mean(np.abs(errors) < 3) > 0.98
    assert 0.8 < np.sqrt(np.mean(np.square(errors))) < 1.2


def test_the_payloads_own_uncertainty_counts(planar_bench: Bench) -> None:
    b = planar_bench
    free, held = b.rows(b.bare, 6, 1e-4), b.rows(b.loaded, 7, 1e-4)
    weighed = b.found(free, held, KnownPayload(MASS, mass_std=0.02 * MASS))
    np.testing.assert_allclose(weighed.std / weighed.gains, 0.02, rtol=0.02)
    assert weighed.scale_std == pytest.approx(0.02, rel=0.02)
    # a payload twice as heavy as it was said to be makes gains half as large
    wrong = b.found(free, held, KnownPayload(MASS / 2))
    np.testing.assert_allclose(wrong.gains, b.gains / 2, rtol=1e-3)


def test_a_gain_that_does_not_show_is_said_to_be_another_s(ur10_bench: Bench) -> None:
    """A payload on the last axis leaves the last joint with what its friction could make."""
    b = ur10_bench
    held = b.rows(b.with_payload(MASS, (0.0, 0.0, 0.1)), 9)
    found = b.found(b.rows(b.bare, 8), held, KnownPayload(MASS))
    assert found.shown == (True,) * 5 + (False,)
    assert (np.abs(found.gains - b.gains)[:5] < 3.5 * found.std[:5]).all()
    assert found.std[5] == pytest.approx(0.5 * found.gains[5], rel=0.01)
    assert "wrist_3_joint is not shown" in found.sentence(b.robot.joints)


def test_a_payload_too_small_to_show_is_refused(planar_bench: Bench) -> None:
    b = planar_bench
    small = 1e-4
    held = b.rows(b.with_payload(small), 11, 0.05)
    with pytest.raises(BadInput, match=r"hardly show.*use a heavier payload"):
        b.found(b.rows(b.bare, 10, 0.05), held, KnownPayload(small))
    with pytest.raises(BadInput, match="hardly show"):  # nothing is carried at all
        b.found(b.rows(b.bare, 10), b.rows(b.bare, 11), KnownPayload(MASS, centre=CENTRE))


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"mass": 0.0}, "mass above 0"),
        ({"mass": float("nan")}, "mass above 0"),
        ({"mass": 1.0, "mass_std": -1.0}, "not negative"),
    ],
)
def test_payloads_that_cannot_be(values: dict, said: str) -> None:
    with pytest.raises(BadInput, match=said):
        KnownPayload(**values)


@pytest.fixture(scope="module")
def recorded(planar_bench: Bench) -> Runs:
    b = planar_bench
    return b.recording("free", b.bare, 20), b.recording("held", b.loaded, 21)


def test_recordings_of_currents_become_torques(planar_bench: Bench, recorded: Runs) -> None:
    b, (free, held) = planar_bench, recorded
    # wrong masses in the description: the payload, not they, fixes the scale
    wrong: Robot = b.robot.with_parameters(1.5 * b.robot.phi)
    drive: DriveGains = identify_drive_gains(wrong, [free], [held], KnownPayload(MASS))
    assert (np.abs(drive.gains - b.gains) < 4 * drive.std).all()
    assert (drive.std < 0.05 * b.gains).all()
    entry = drive.result()
    assert entry["drive_gain_Nm_per_A"] == drive.gains.tolist()
    assert entry["drive_gain_shown"] == [True, True]
    found = identify_robot(wrong, drive.torque([free]))
    assert found.data.unit == "N·m"
    base, beta = found.base, found.base.regrouping[:, :20] @ b.robot.phi
    inertial = [k for k, c in enumerate(base.columns) if c < 20]
    std = np.sqrt(np.diag(found.least_squares.covariance)) + 0.03 * np.abs(beta)
    assert (np.abs(found.least_squares.beta - beta) < 4 * std)[inertial[:2]].all()
    with pytest.raises(BadInput, match="for motor currents"):
        identify_drive_gains(wrong, drive.torque([free]), [held], KnownPayload(MASS))


def test_command(
    tmp_path: Path, planar_bench: Bench, recorded: Runs, excitant: Callable[..., Any]
) -> None:
    for each in recorded:
        columns = {"t": each.t}
        for k in range(2):
            columns[f"q{k + 1}"], columns[f"i{k + 1}"] = each.q[:, k], each.tau[:, k]
        pd.DataFrame(columns).to_parquet(tmp_path / f"{each.name}.parquet")
    free, held = (tmp_path / f"{each.name}.parquet" for each in recorded)
    com = ",".join(map(str, CENTRE))
    options = ("--payload-mass", MASS, f"--payload-com={com}", "--json", "-o", tmp_path / "run")
    result = excitant("identify planar_2r", free, "--payload-recording", held, *options).result
    gains, std = (
        np.array(result[key]) for key in ("drive_gain_Nm_per_A", "drive_gain_std_Nm_per_A")
    )
    assert (np.abs(gains - planar_bench.gains) < 4 * std).all()
    assert result["unit"] == "N·m"
    assert any("follow from the known payload" in note for note in result["notes"])
