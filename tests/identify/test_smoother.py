"""Positions and speeds weighed by their noise: both found, neither worse than alone."""

from __future__ import annotations

import re

import numpy as np
import pytest
import scipy

from excitant.identify.signals import differentiated, resolution, smoothed

RATE, BAND = 500.0, 20.0
T = np.arange(0, 20, 1 / RATE)
INNER = slice(200, -200)


def motion() -> tuple[np.ndarray, ...]:
    w = 2 * np.pi * np.array([0.3, 1.1])
    amplitude, phase = np.array([[1.0, 0.4], [0.6, 0.7]]), np.array([0.3, 1.0])
    waves = [
        amplitude @ (w**k * np.sin(np.outer(T, w) + phase + k * np.pi / 2)).T for k in range(3)
    ]
    return tuple(each.T for each in waves)


Q, DQ, DDQ = motion()


def error(q: np.ndarray) -> np.ndarray:
    """Rms error of acceleration, shape (nv,)."""
    return np.sqrt(((differentiated(T, q, BAND).ddq - DDQ)[INNER] ** 2).mean(axis=0))


@pytest.mark.parametrize(("bits", "speed"), [(10, 0.02), (12, 0.01), (14, 0.01), (16, 0.001)])
def test_noise_is_found_and_what_is_fused_beats_either(bits: int, speed: float) -> None:
    step, rng = 2 * np.pi / 2**bits, np.random.default_rng(bits)
    q, dq = step * np.round(Q / step), DQ + speed * rng.standard_normal(DQ.shape)
    found, sensors = smoothed(T, q, dq, BAND)
    # 400 bins of the band, and the white floor of a third of all
    np.testing.assert_allclose(sensors.step, step, rtol=1e-6)
    np.testing.assert_allclose(sensors.position, step / np.sqrt(12), rtol=0.35)
    np.testing.assert_allclose(sensors.speed, speed, rtol=0.35)
    said = sensors.sentence(["a", "b"])
    assert re.search(r"speeds count more above \[Hz\] a [\d.]+, b [\d.]+$", said)
    crossover = speed / (2 * np.pi * step / np.sqrt(12))
    np.testing.assert_allclose(sensors.crossover_hz, crossover, rtol=0.4)
    way = np.cumsum(dq, axis=0) / RATE
    assert (error(found) < 1.1 * np.minimum(error(q), error(way))).all()


def test_speeds_that_are_perfect_change_nothing_but_noise() -> None:
    found, _ = smoothed(T, Q, DQ, BAND)
    np.testing.assert_allclose(found, Q, atol=1e-7)
    noisy = smoothed(T, Q, DQ + np.random.default_rng(0).standard_normal(Q.shape), BAND)[1]
    assert noisy.sentence(["a", "b"]).endswith(": positions count more at every frequency at a, b")
    assert smoothed(T, Q, None, BAND)[0] is Q


@pytest.mark.parametrize("kind", ["scaled", "late", "filtered", "wrong", "still"])
def test_speeds_that_are_not_those_of_the_motion_do_no_harm(kind: str) -> None:
    """Gain, offset and delay are calibrated; what is left of the motion counts as noise."""
    rng = np.random.default_rng(0)
    q = Q + 1e-5 * rng.standard_normal(Q.shape)
    fine = 1e-3 * rng.standard_normal(Q.shape)
    first = 1 - np.exp(-2 * np.pi * 5.0 / RATE)  # a controller's filter of 5 Hz
    filtered = np.array(DQ)
    for k in range(1, len(T)):
        filtered[k] = filtered[k - 1] + first * (DQ[k] - filtered[k - 1])
    speeds = {
        "scaled": 57.3 * DQ + 0.2 + fine,
        "late": np.roll(DQ, 3, axis=0) + fine,
        "filtered": filtered + fine,
        "wrong": DQ[:, ::-1] + fine,
        "still": fine,
    }
    found, _ = smoothed(T, q, speeds[kind], BAND)
    assert (error(found) < 1.05 * error(q) + 1e-3).all()


@pytest.mark.parametrize(("kind", "calibrated"), [("scaled", 1.01), ("late", 2.0)])
def test_gain_offset_and_delay_of_speeds_cost_little(kind: str, calibrated: float) -> None:
    """Coarse positions gain as much from speeds in other units, or late, as from true ones.

    A delay is calibrated to first order.
    """
    rng, step = np.random.default_rng(0), 2 * np.pi / 2**12
    q, fine = step * np.round(Q / step), 1e-3 * rng.standard_normal(Q.shape)
    late = scipy.interpolate.make_interp_spline(T, DQ)(T - 0.004)
    speeds = {"scaled": 57.3 * (DQ + fine) + 0.2, "late": late + fine}
    found, true = (smoothed(T, q, dq, BAND)[0] for dq in (speeds[kind], DQ + fine))
    assert (error(true) < 0.1 * error(q)).all()
    assert (error(found) < calibrated * error(true)).all()


def test_steps_are_those_of_a_lattice_only() -> None:
    x = np.sin(T)
    assert resolution(np.round(x, 3)) == pytest.approx(1e-3)
    assert resolution(x) == 0 == resolution(np.ones(100))
