"""What a model leaves: how much of it is noise, and with what the rest varies."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from excitant.analysis.residuals import QUANTITIES, noise_floor, residuals
from excitant.identify.differentiators import low_pass
from excitant.identify.preprocessing import Segment
from excitant.robots import Motion

RATE, CUTOFF, SECONDS = 200.0, 10.0, 60.0
PASSED = np.pi / 8 / np.sin(np.pi / 8) * 7 / 8  # ∫ dx / (1 + x⁸)²: power that the filter passes


def segment(seed: int, sigma: float, signal: float = 0.0, seconds: float = SECONDS) -> Segment:
    """One joint that moves in two harmonics, its torque noisy."""
    rng, t = np.random.default_rng(seed), np.arange(0, seconds, 1 / RATE)
    w, size = np.array([1.3, 3.7]), np.array([0.8, 0.3])
    angle = np.outer(t, w) + rng.uniform(0, 6.28, 2)
    q, dq, ddq = (
        (size * f).sum(axis=1)[:, None]
        for f in (np.sin(angle), w * np.cos(angle), -(w**2) * np.sin(angle))
    )
    tau = signal * q + sigma * rng.standard_normal(q.shape)
    keep = slice(20, -20, 5)
    return Segment("run", Motion(t, q, dq, ddq), low_pass(tau, CUTOFF, RATE), tau, CUTOFF, keep)


@pytest.mark.parametrize("signal", [0.0, 50.0])
def test_noise_floor_is_what_white_noise_leaves_behind_the_filter(signal: float) -> None:
    sigma = 0.4
    segments = [segment(seed, sigma, signal) for seed in range(2)]
    band = 2 * CUTOFF / RATE  # white noise in the band below the cut-off
    expected = sigma * np.sqrt(PASSED * band)  # the filter passes a little less than that
    assert noise_floor(segments, 0) == pytest.approx(expected, rel=0.03)
    noise = np.concatenate([segment(seed, sigma).tau for seed in range(2)])
    assert noise_floor(segments, 0) == pytest.approx(noise.std(), rel=0.05)


def test_noise_floor_grows_with_the_noise_and_not_with_the_signal() -> None:
    quiet, loud = ([segment(0, sigma, 30.0)] for sigma in (0.1, 0.3))
    assert noise_floor(loud, 0) == pytest.approx(3 * noise_floor(quiet, 0), rel=0.02)


def test_noise_floor_is_unknown_where_the_rate_leaves_no_band() -> None:
    s = segment(0, 0.4)
    slow = Segment("run", s.motion[::10], s.tau[::10], s.tau_raw[::10], 8.0, slice(None))
    assert slow.rate_hz == pytest.approx(20)
    assert noise_floor([slow], 0) == 0.0


def left(kind: str, size: float) -> tuple[list[Segment], np.ndarray, np.ndarray]:
    """Error at the rows, structured in one way and as noisy as the torque; load."""
    segments = [segment(seed, 0.2) for seed in range(2)]
    at = [s.motion[s.keep] for s in segments]
    q, dq = (np.concatenate([getattr(m, name) for m in at]) for name in ("q", "dq"))
    noise = np.concatenate([s.tau[s.keep] for s in segments])
    load = np.random.default_rng(1).uniform(2, 40, 40)[np.arange(len(q)) // 60 % 40][:, None]
    time = np.linspace(-1, 1, len(q))[:, None]
    structure = {
        "position": np.cos(4 * q),
        "direction": np.sign(dq),
        "velocity": np.sign(dq) * np.abs(dq) ** 2,
        "load": load * np.sign(dq) / 20,
        "time": time**3,
        "nothing": np.zeros_like(q),
    }[kind]
    return segments, noise + size * structure, load


@pytest.mark.parametrize("kind", ["position", "direction", "velocity", "load", "time"])
def test_structure_is_found_where_it_is(kind: str) -> None:
    segments, error, load = left(kind, 1.0)
    (found,) = residuals(("elbow",), segments, error, error, load)
    assert found.joint == "elbow"
    assert found.visible
    assert found.dominant == kind
    assert found.structure.startswith("structured")
    assert found.structure.endswith(QUANTITIES[kind])
    assert found.rms == pytest.approx(np.sqrt((error**2).mean()), rel=0.05)
    size = np.sqrt(((error - left(kind, 0.0)[1]) ** 2).mean())
    assert found.structured == pytest.approx(size, rel=0.1)
    assert found.shares[kind] > 0.5


def test_noise_alone_is_not_structure() -> None:
    segments, error, load = left("nothing", 0.0)
    (found,) = residuals(("elbow",), segments, error, error, load)
    assert not found.visible
    assert found.structure == "noise-like"
    assert max(found.shares.values()) < 0.05
    assert found.structured < found.floor


def test_structure_below_the_noise_is_not_visible() -> None:
    segments, error, load = left("velocity", 0.03)
    (found,) = residuals(("elbow",), segments, error, error, load)
    assert not found.visible


def test_what_a_rest_leaves_does_not_count() -> None:
    segments, error, load = left("nothing", 0.0)
    still = []
    for s in segments:
        dq = np.array(s.motion.dq)
        dq[4000:6000] = 0.0
        motion = Motion(s.motion.t, s.motion.q, dq, s.motion.ddq)
        still.append(Segment(s.name, motion, s.tau, s.tau_raw, CUTOFF, s.keep))
    stuck = np.concatenate([(s.motion.dq[s.keep] == 0) for s in still])
    assert stuck.sum() > 700
    (found,) = residuals(("elbow",), still, error + 9.0 * stuck, error, load)
    assert found.rms == pytest.approx(np.sqrt((error[~stuck] ** 2).mean()), rel=0.05)
    assert not found.visible


def test_an_error_against_noise_in_words() -> None:
    segments, error, load = left("direction", 1.0)
    (found,) = residuals(("elbow",), segments, error, error, load)
    times = float(found.against_noise.removesuffix(" times the noise"))
    assert times == pytest.approx(found.rms / found.floor, rel=0.1)
    (loud,) = residuals(("elbow",), segments, 300 * error / found.floor, error, load)
    assert replace(loud, floor=loud.rms / 250).against_noise == "over 100 times the noise"
    assert "smoothed or computed" in replace(found, floor=0.0).against_noise
    assert "smoothed or computed" in replace(found, floor=found.rms / 28957.9).against_noise
