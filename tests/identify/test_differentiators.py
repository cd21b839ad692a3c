"""Gains and noise gains are those of the filters, polynomials come out exact, choices hold."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.optimize
from numpy.polynomial import Polynomial

from excitant.exceptions import BadInput
from excitant.identify import (
    LocalPolynomial,
    Recording,
    ZeroPhaseButterworth,
    five_point,
)
from excitant.identify.differentiators import (
    causal_polynomial,
    causal_polynomials,
    position_spectrum,
)
from excitant.identify.preprocessing import prepare

STEP, RATE = 2e-3, 500.0
POLYNOMIALS = [five_point(), LocalPolynomial(8, 4)]
NAMES = ("q", "dq", "ddq")


def test_five_points_are_the_least_squares_parabola_with_the_published_figures() -> None:
    five = five_point()
    np.testing.assert_allclose(10 * five.kernel(1), [-2, -1, 0, 1, 2], atol=1e-14)
    np.testing.assert_allclose(7 * five.kernel(2), [2, -1, -2, -1, 2], atol=1e-13)
    assert five.noise_gain(RATE) * STEP == pytest.approx(1 / np.sqrt(10), rel=1e-12)  # 0.316
    gains = five.gain(np.array([2.0, 10.0, 20.0]), RATE)
    np.testing.assert_allclose(gains, [0.9996, 0.991, 0.965], atol=5e-4)
    half_power = scipy.optimize.brentq(lambda f: five.gain(f, RATE) - np.sqrt(0.5), 30, 100)
    assert half_power == pytest.approx(60.5, abs=0.05)


@pytest.mark.parametrize("differentiator", POLYNOMIALS, ids=lambda each: each.name)
@pytest.mark.parametrize("order", [0, 1, 2])
def test_gain_and_noise_gain_are_those_announced(
    differentiator: LocalPolynomial, order: int
) -> None:
    """Of a sinusoid, and the norm of the impulse response."""
    t = np.arange(0, 8, STEP)
    middle = slice(len(t) // 3, 2 * len(t) // 3)
    for f in (1.0, 7.0, 25.0):
        w = 2 * np.pi * f
        found = getattr(differentiator(t, np.sin(w * t)[:, None]), NAMES[order])
        gain = float(differentiator.gain(np.array([f]), RATE, order)[0])
        error = found[middle, 0] - gain * w**order * np.sin(w * t + order * np.pi / 2)[middle]
        assert np.abs(error).max() <= 1e-8 * w**order
    response = getattr(differentiator(t, np.eye(len(t))[:, [2000]]), NAMES[order])
    announced = differentiator.noise_gain(RATE, order)
    assert announced == pytest.approx(np.linalg.norm(response), rel=1e-6)


def test_polynomials_are_exact_up_to_their_degree() -> None:
    t = np.arange(200) * STEP
    q = Polynomial(np.random.default_rng(0).standard_normal(5), domain=[0, t[-1]], window=[0, 1])
    found = LocalPolynomial(6, 4)(t, q(t)[:, None])
    for order, name in enumerate(NAMES):
        true = q.deriv(order)(t) if order else q(t)
        allowed = 1e-8 * np.abs(true).max()
        np.testing.assert_allclose(getattr(found, name)[:, 0], true, atol=allowed, err_msg=name)


@pytest.mark.parametrize("half_width", [2, 9])
def test_the_causal_kind_says_the_same_later(half_width: int) -> None:
    t, q = np.arange(300) * STEP, np.random.default_rng(1).standard_normal((300, 2))
    early = LocalPolynomial(half_width, 2)(t, q)
    late = LocalPolynomial(half_width, 2, causal=True)
    found = late(t, q)
    assert late.delay(RATE) == pytest.approx(half_width * STEP)
    for name in ("t", *NAMES):
        expected = getattr(early, name)[half_width:-half_width]
        np.testing.assert_allclose(getattr(found, name), expected)
    # the instant reported last needs the newest sample and none after it
    assert found.t[-1] + late.delay(RATE) == pytest.approx(t[-1])


def test_what_cannot_be_is_refused_in_one_line() -> None:
    t = np.arange(100) * STEP
    irregular = np.delete(t, 50)
    for differentiator, times, why in (
        (ZeroPhaseButterworth(20.0), irregular, "time is irregular"),
        (five_point(), irregular, "time is irregular"),
        (ZeroPhaseButterworth(260.0), t, "choose one below 250 Hz"),
        (five_point(), t[:4], "at least 5 are needed"),
    ):
        with pytest.raises(BadInput, match=why):
            differentiator(times, np.sin(times)[:, None])
    with pytest.raises(BadInput, match="degree 5 through 5 samples"):
        LocalPolynomial(2, 5)


def recorded(noise: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ten seconds of two joints with position noise, and their true acceleration."""
    t = np.arange(0, 10, 1e-3)
    w = 2 * np.pi * np.array([0.7, 3.1])[:, None, None]
    waves = np.array([1.0, 0.2])[:, None, None] * np.sin(w * t[:, None] + np.array([0.0, 1.0]))
    rng = np.random.default_rng(seed)
    q = waves.sum(axis=0)
    return t, q + noise * rng.standard_normal(q.shape), -(w**2 * waves).sum(axis=0)


def acceleration_error(
    differentiator: LocalPolynomial, t: np.ndarray, q: np.ndarray, true: np.ndarray
) -> np.ndarray:
    """Root mean square per joint, away from the ends."""
    edge = differentiator.half_width
    error = differentiator(t, q).ddq - true[edge:-edge]
    return np.sqrt((error[500:-500] ** 2).mean(axis=0))


@pytest.mark.parametrize("noise", [1e-6, 1e-4, 1e-3])
def test_the_predicted_error_is_the_error(noise: float) -> None:
    t, q, true = recorded(noise)
    choice = causal_polynomial(position_spectrum(t, q))
    # a recording of some hundred independent errors gives their rms to about ten per cent
    error = acceleration_error(choice.differentiator, t, q, true)
    np.testing.assert_allclose(error, choice.error, rtol=0.35)
    assert choice.differentiator.delay(1e3) > 0
    assert "predicted acceleration error" in choice.why
    assert "\n" not in choice.why


def test_no_candidate_is_much_better_than_the_choice() -> None:
    t, q, true = recorded(1e-4, seed=3)
    spectrum = position_spectrum(t, q)
    np.testing.assert_allclose(spectrum.noise, 1e-4, rtol=0.1)
    chosen, *others = (
        np.linalg.norm(acceleration_error(each, t, q, true))
        for each in (causal_polynomial(spectrum).differentiator, *causal_polynomials(spectrum))
    )
    assert chosen <= 1.3 * min(others)


def test_preprocessing_takes_another_differentiator() -> None:
    t, q, true = recorded(0.0)
    recording = Recording("n", "f", t, q, q)
    [segment] = prepare(recording, 10.0, LocalPolynomial(8, 4))
    inner = slice(100, -100)
    np.testing.assert_allclose(segment.motion.ddq[inner], true[inner], atol=1e-3)
    with pytest.raises(BadInput, match="without delay"):
        prepare(recording, 10.0, five_point(causal=True))
