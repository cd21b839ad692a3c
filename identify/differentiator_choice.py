"""Which differentiator suits a recording: the one whose predicted acceleration error is smallest.

Positions are signal plus white noise. The noise level is the floor of the upper part of the
periodogram; the signal is what stands out of the floor. A differentiator with gain g then makes
the acceleration error

    e² = ∫ S(f) (2πf)⁴ (g(f) − 1)² df + σ² · noise_gain²,

lost signal plus noise let through, both known before anything is differentiated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from excitant.exceptions import BadInput
from excitant.identify.differentiators import (
    Differentiator,
    FourierFit,
    ZeroPhaseButterworth,
    five_point,
    savitzky_golay,
)
from excitant.robots.motion import Array, freeze

FEWEST = 64  # samples of a spectrum
_FLOOR_SHARE = 1 / 3  # of the frequency axis, its upper end, where arms do not move
_TIME_SPAN = (0.004, 0.3)  # s: windows of polynomials that are worth a try
_SLOWEST_CUTOFF = 1.0  # Hz
_CANDIDATES = 12  # settings tried per kind


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Positions as signal and white noise.

    Attributes:
        f: Frequencies, shape (m,) [Hz].
        signal: Power density of the signal, zero where the noise could make what is seen,
            shape (m, nv) [rad²/Hz].
        noise: Standard deviation of the white noise of each joint, shape (nv,) [rad or m].
        rate_hz: Sampling rate [Hz].
        duration: Time recorded [s].
    """

    f: Array
    signal: Array
    noise: Array
    rate_hz: float
    duration: float

    def __post_init__(self) -> None:
        freeze(self, "f", "signal", "noise")


def position_spectrum(t: Array, q: Array) -> Spectrum:
    """Signal and noise of positions, shape (n, nv).

    Irregular time is resampled linearly at its mean rate: noise then comes out a little low.
    A bin counts as signal where noise alone would exceed it in one recording out of n.

    Raises:
        BadInput: Fewer than 64 samples.
    """
    if len(t) < FEWEST:
        raise BadInput(
            f"choice of a differentiator: {len(t)} samples; at least {FEWEST} are needed"
        )
    grid = np.linspace(t[0], t[-1], len(t))
    regular = np.column_stack([np.interp(grid, t, column) for column in q.T])
    rate = (len(t) - 1) / (t[-1] - t[0])
    f, power = scipy.signal.periodogram(
        scipy.signal.detrend(regular, axis=0), fs=float(rate), window="hann", axis=0
    )
    upper = f > (1 - _FLOOR_SHARE) * rate / 2
    floor = np.median(power[upper], axis=0) / np.log(2)  # exponential: median = mean · ln 2
    stands_out = power > floor * 2 * np.log(len(f))
    signal = np.where(stands_out & ~upper[:, None], np.maximum(power - floor, 0), 0.0)
    noise = np.sqrt(floor * rate / 2)
    return Spectrum(f, signal, noise, float(rate), float(t[-1] - t[0]))


@dataclass(frozen=True, eq=False)
class Choice:
    """The differentiator chosen, and why.

    Attributes:
        differentiator: The choice.
        error: Predicted acceleration error of each joint, shape (nv,) [rad/s²].
        lost: Part of it that is signal lost [rad/s²].
        noise: Part of it that is noise let through [rad/s²].
        why: One sentence.
    """

    differentiator: Differentiator
    error: Array
    lost: Array
    noise: Array
    why: str

    def __post_init__(self) -> None:
        freeze(self, "error", "lost", "noise")


def predicted_error(differentiator: Differentiator, spectrum: Spectrum) -> tuple[Array, Array]:
    """Signal lost and noise let through in the acceleration, each of shape (nv,) [rad/s²]."""
    f, rate = spectrum.f, spectrum.rate_hz
    missing = (2 * np.pi * f) ** 4 * (differentiator.gain(f, rate, 2) - 1) ** 2
    lost = np.sqrt(missing @ spectrum.signal * (f[1] - f[0]))
    return lost, spectrum.noise * differentiator.noise_gain(rate, 2)


def candidates(
    spectrum: Spectrum, *, causal: bool = False, period: float | None = None
) -> list[Differentiator]:
    """Differentiators worth a try at this rate, windows and cut-offs in geometric steps."""
    rate = spectrum.rate_hz
    shortest, longest = (span * rate / 2 for span in _TIME_SPAN)
    limit = (round(spectrum.duration * rate) - 1) // 4
    widths = np.unique(np.geomspace(max(shortest, 2), max(longest, 4), _CANDIDATES).astype(int))
    found: list[Differentiator] = [five_point(causal=causal)]
    for m in (int(m) for m in widths if m <= limit):
        degrees = [d for d in (2, 4) if d < 2 * m and (m, d) != (2, 2)]
        found += [savitzky_golay(m, degree, causal=causal) for degree in degrees]
    if causal:
        return found
    cutoffs = np.geomspace(min(_SLOWEST_CUTOFF, 0.1 * rate), 0.4 * rate, _CANDIDATES)
    found += [ZeroPhaseButterworth(float(cutoff)) for cutoff in cutoffs]
    if period is not None and spectrum.duration > 0.99 * period:
        most = max(1, int(min(20.0, 0.4 * rate) * period))
        orders = np.unique(np.geomspace(1, most, _CANDIDATES).astype(int))
        periods = max(1, round(spectrum.duration / period))
        found += [FourierFit(period, int(h), periods) for h in orders]
    return found


def choose_differentiator(
    t: Array, q: Array, *, causal: bool = False, period: float | None = None
) -> Choice:
    """The differentiator with the smallest predicted acceleration error.

    Joints count relative to the acceleration their signal has.

    Args:
        t: Time, shape (n,) [s].
        q: Positions, shape (n, nv).
        causal: Whether it serves a loop: a local polynomial then, that speaks late.
        period: Period of the motion where it has one [s]; offers a Fourier fit too.

    Raises:
        BadInput: Too few samples.
    """
    spectrum = position_spectrum(t, q)
    return best_of(candidates(spectrum, causal=causal, period=period), spectrum)


def best_of(options: Sequence[Differentiator], spectrum: Spectrum) -> Choice:
    """The best of some differentiators for a spectrum."""
    f, width = spectrum.f, spectrum.f[1] - spectrum.f[0]
    size = np.sqrt((2 * np.pi * f) ** 4 @ spectrum.signal * width)
    moving = size > 0
    weight = np.where(moving, 1 / np.where(moving, size, 1.0), 0.0 if moving.any() else 1.0)
    parts = [predicted_error(option, spectrum) for option in options]
    cost = [float(np.sum(weight**2 * (lost**2 + noise**2))) for lost, noise in parts]
    order = np.argsort(cost)
    best, (lost, noise) = options[order[0]], parts[order[0]]
    total = np.sqrt(lost**2 + noise**2)
    j = int(np.argmax(weight * total))
    why = (
        f"{best.name}: predicted acceleration error {total[j]:.3g} (signal lost {lost[j]:.3g}, "
        f"noise {noise[j]:.3g}) at a position noise of {spectrum.noise[j]:.3g} of joint {j + 1}, "
        "the joint where it weighs most"
    )
    if len(order) > 1:
        second = np.hypot(*parts[order[1]])[j]
        why += f"; next, {second:.3g} with {options[order[1]].name}"
    return Choice(best, total, lost, noise, why)
