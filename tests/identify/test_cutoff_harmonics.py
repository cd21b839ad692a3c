"""Known harmonics bound the cut-off from below: as planned, or of a recording that repeats."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest

from excitant.exceptions import BadInput
from excitant.identify import Recording, identify, identify_result
from excitant.identify.cutoff import _passing
from excitant.identify.cutoff_harmonics import PRODUCTS, planned_harmonics, recorded_harmonics
from excitant.identify.rows import split
from excitant.robots import Motion, Robot, torque
from excitant.robots.effects import standard_effects

RATE, PERIOD = 125.0, 5.0


@pytest.fixture(scope="module")
def arm(planar: Robot) -> Robot:
    values = ([3.0, 2.0], [2.0, 1.0], [0.2, -0.1], [0.3, 0.2])
    effects = standard_effects(planar.joints)
    return planar.with_effects([e.with_values(v) for e, v in zip(effects, values, strict=True)])


def periodic(highest: Sequence[int], seconds: float = 20.0) -> Motion:
    """Fourier series of five seconds with so many harmonics at each joint, alike in speed."""
    t, rng = np.arange(0, seconds, 1 / RATE), np.random.default_rng(5)
    phase = rng.uniform(0, 2 * np.pi, (max(highest), 2))
    parts = np.zeros((3, len(t), 2))
    for j, count in enumerate(highest):
        for h in range(1, count + 1):
            w = 2 * np.pi * h / PERIOD
            for k in range(3):
                parts[k, :, j] += w ** (k - 1) * np.sin(w * t + phase[h - 1, j] + k * np.pi / 2)
    return Motion(t, *parts)


def recorded(arm: Robot, motion: Motion, shake: float, seed: int = 0) -> Recording:
    """Shaking at 5 Hz, so that a lower cut-off pays, and a little noise at all frequencies."""
    rng = np.random.default_rng(seed)
    tau = torque(arm, motion)
    size = tau.std(axis=0)
    tone = np.sin(2 * np.pi * 5.0 * motion.t + rng.uniform(0, 6.28))[:, None]
    noise = 0.02 * rng.standard_normal(tau.shape) + shake * tone * (
        1 + rng.standard_normal(tau.shape)
    )
    q = motion.q + 1e-5 * rng.standard_normal(motion.q.shape)
    return Recording("run", "run.csv", motion.t, q, tau + size * noise)


@pytest.mark.parametrize("highest", [(3, 3), (2, 7)])
def test_harmonics_of_a_recording_that_repeats_are_found(
    arm: Robot, highest: tuple[int, int]
) -> None:
    run = recorded(arm, periodic(highest), 0.0)
    found = recorded_harmonics(split([run], [run], 10.0).train, [run])
    assert found is not None
    np.testing.assert_allclose(found.highest_hz, np.array(highest) / PERIOD, rtol=1e-3)
    np.testing.assert_allclose(found.torque_hz, PRODUCTS * np.array(highest) / PERIOD, rtol=1e-3)
    assert "repeats every 5 s" in found.source


def test_a_motion_that_does_not_repeat_has_none(
    arm: Robot, motion_of: Callable[..., Motion]
) -> None:
    run = recorded(arm, motion_of(arm, np.arange(0, 15, 1 / RATE)), 0.0)
    assert recorded_harmonics(split([run], [run], 10.0).train, [run]) is None


def test_no_cut_off_takes_known_harmonics_away(arm: Robot) -> None:
    """A shaking at 5 Hz calls for less than that; with harmonics up to 2.6 Hz, that is too low."""
    run = recorded(arm, periodic((4, 4)), 0.5)
    lows = [
        identify(arm, [run], validate=[run], tune=True, harmonics_hz=hz) for hz in (0.0, 2.6, 6.0)
    ]
    studies = [each.study for each in lows]
    chosen = [study.choice.cutoffs_hz for study in studies if study is not None]
    assert (chosen[0] < PRODUCTS * 2.6).any()
    assert (chosen[1] >= PRODUCTS * 2.6).all()
    assert (chosen[2] == 10.0).all()
    said = [" ".join(each.notes) for each in lows]
    assert "known harmonics (as planned): up to joint1 2.6 Hz" in said[1]
    assert "with --cutoff 12 it stays" in said[2]
    entry = identify_result(lows[1])["cutoff_hz_per_joint"]
    assert [row["highest_harmonic_hz"] for row in entry] == [2.6, 2.6]


def test_the_recording_itself_gives_the_bound(arm: Robot) -> None:
    quick, slow = (
        identify(arm, [run], validate=[run], tune=True)
        for run in (recorded(arm, periodic((13, 13)), 0.5), recorded(arm, periodic((2, 2)), 0.5))
    )
    assert quick.study is not None
    assert slow.study is not None
    assert (quick.study.choice.cutoffs_hz >= PRODUCTS * 13 / PERIOD).all()
    assert (slow.study.choice.cutoffs_hz < PRODUCTS * 13 / PERIOD).any()


@pytest.mark.parametrize("given", [-1.0, np.nan, np.ones(3)])
def test_frequencies_that_cannot_be_are_refused(given: float | np.ndarray) -> None:
    with pytest.raises(BadInput, match="highest harmonic"):
        planned_harmonics(given, 2)


def test_joints_share_a_cut_off_only_as_far_as_their_harmonics_let_them() -> None:
    grid = 10.0 * 2.0 ** (-np.arange(5) / 2)
    found = _passing(np.full(4, 2.5), grid, np.array([0.0, 2.6, 6.0, 12.0]))
    np.testing.assert_allclose(found, [2.5, grid[3], grid[1], 10.0])
    np.testing.assert_allclose(_passing(np.full(4, 10.0), grid, np.zeros(4)), 10.0)
