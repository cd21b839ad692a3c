"""Differentiators: from sampled positions to velocity and acceleration.

* `ZeroPhaseButterworth`: filter forward and backward, then a quintic spline; what recordings pass.
* `LocalPolynomial`: least-squares polynomial through a moving window (Savitzky and Golay 1964);
  through five samples it is Khosla's (1987, §5.1), f' = (−2f₋₂ − f₋₁ + f₁ + 2f₂) / (10T). They
  serve a loop; `causal_polynomial` takes the window that suits the positions best.

Positions are signal plus white noise, whose level is the floor of the upper part of the
periodogram. A polynomial with gain g then makes the acceleration error

    e² = ∫ S(f) (2πf)⁴ (g(f) − 1)² df + σ² · noise_gain².
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from math import factorial
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import scipy

from excitant.exceptions import BadInput
from excitant.identify.spectra import detrended, low_pass, power_density
from excitant.robots.motion import Array, Motion

Differentiator = Callable[[Array, Array], Motion]
"""Motion at samples: of time, shape (n,) [s], and positions, shape (n, nv)."""

_IRREGULAR = 1e-3  # of a step: what counts as the same step
_FEWEST = 64  # samples of a spectrum
_FLOOR_SHARE = 1 / 3  # of the frequency axis, its upper end, where arms do not move
_TIME_SPAN = (0.004, 0.3)  # s: windows of polynomials that are worth a try
_CANDIDATES = 12  # windows tried


def _step(t: Array, needed: int, who: str) -> float:
    """Sampling period of regular time [s]; refuses less than so many samples."""
    if len(t) < needed:
        raise BadInput(
            f"{who}: {len(t)} samples, at least {needed} are needed; record longer"
        )
    steps = np.diff(t)
    step = float(t[-1] - t[0]) / (len(t) - 1)
    worst = int(np.argmax(np.abs(steps - step)))
    if abs(steps[worst] - step) > _IRREGULAR * step:
        raise BadInput(
            f"{who}: time is irregular ({steps[worst]:.4g} s after {t[worst]:.6g} s, "
            f"else {step:.4g} s); resample it"
        )
    return step


@dataclass(frozen=True)
class LocalPolynomial:
    """Least-squares polynomial through 2m + 1 samples at a regular rate, differentiated.

    It serves a loop: each instant is the middle of a window that ends at a sample, m samples late.
    """

    half_width: int  # m, samples on either side
    degree: int = 4  # of the polynomial, from 2 to 2m

    def __post_init__(self) -> None:
        if not 2 <= self.degree <= 2 * self.half_width:
            raise BadInput(
                f"local polynomial: degree {self.degree} through {2 * self.half_width + 1} "
                "samples; give a degree from 2 to the number of samples less one"
            )

    @property
    def name(self) -> str:
        """Name with its settings."""
        return (
            f"Savitzky-Golay ({2 * self.half_width + 1} samples, degree {self.degree})"
        )

    def kernel(self, order: int) -> Array:
        """Weights c with f⁽ᵒ⁾ ≈ Σ c_k f_k / Tᵒ, oldest sample first, shape (2m + 1,)."""
        return _kernels(self.half_width, self.degree)[order]

    def delay(self, rate_hz: float) -> float:
        """Half a window [s]."""
        return self.half_width / rate_hz

    def gain(self, f: Array, rate_hz: float, order: int = 1) -> Array:
        """Response relative to the true derivative (its delay taken out), shape of f."""
        omega = 2 * np.pi * np.asarray(f, float) / rate_hz
        k = np.arange(-self.half_width, self.half_width + 1)
        response = np.exp(1j * omega[..., None] * k) @ self.kernel(order)
        ideal = np.where(omega == 0, 1.0, (1j * omega) ** order)
        # at ω = 0 the limit of a filter that is exact on parabolas
        return np.asarray(np.where(omega == 0, 1.0, (response / ideal).real), float)

    def noise_gain(self, rate_hz: float, order: int = 1) -> float:
        """‖c‖ / Tᵒ."""
        return float(np.linalg.norm(self.kernel(order))) * rate_hz**order

    def __call__(self, t: Array, q: Array) -> Motion:
        """Motion at the middle of every whole window, shape (n − 2m, nv)."""
        m = self.half_width
        n = len(t)
        step = _step(t, 2 * m + 1, self.name)
        inner = slice(m, n - m)
        parts = (
            scipy.signal.savgol_filter(q, 2 * m + 1, self.degree, k, step, axis=0)[
                inner
            ]
            for k in range(3)
        )
        return Motion(t[inner], *parts)


@lru_cache(maxsize=256)
def _kernels(half_width: int, degree: int) -> tuple[Array, ...]:
    k = np.arange(-half_width, half_width + 1) / half_width
    weights = np.linalg.pinv(k[:, None] ** np.arange(degree + 1))
    return tuple(
        weights[order] * factorial(order) / half_width**order for order in range(3)
    )


@dataclass(frozen=True)
class ZeroPhaseButterworth:
    """Butterworth filter of fourth order forward and backward, then a quintic spline.

    At the cut-off [Hz] the gain is one half.
    """

    cutoff_hz: float

    def __call__(self, t: Array, q: Array) -> Motion:
        """Motion at the samples; q has shape (n, nv)."""
        name = f"zero-phase Butterworth ({self.cutoff_hz:.4g} Hz)"
        rate = 1 / _step(t, 20, name)
        if not 0 < self.cutoff_hz < rate / 2:
            raise BadInput(
                f"{name}: the cut-off does not fit a rate of {rate:.4g} Hz; "
                f"choose one below {rate / 2:.4g} Hz"
            )
        spline = scipy.interpolate.make_interp_spline(
            t, low_pass(q, self.cutoff_hz, rate), k=5
        )
        return Motion(t, spline(t), spline(t, 1), spline(t, 2))


class Spectrum(NamedTuple):
    """Positions as signal, its power density over f, (m, nv) [rad²/Hz], and noise, (nv,) [rad]."""

    f: Array
    signal: Array
    noise: Array
    rate_hz: float
    samples: int


def position_spectrum(t: Array, q: Array) -> Spectrum:
    """Signal and noise of positions, shape (n, nv).

    Irregular time is resampled linearly at its mean rate: noise then comes out a little low.
    A bin counts as signal where noise alone would exceed it in one recording out of n.

    Raises:
        BadInput: Fewer than 64 samples.
    """
    if len(t) < _FEWEST:
        raise BadInput(
            f"choice of a differentiator: {len(t)} samples; at least {_FEWEST} are needed"
        )
    grid = np.linspace(t[0], t[-1], len(t))
    regular = np.column_stack([np.interp(grid, t, column) for column in q.T])
    rate = float((len(t) - 1) / (t[-1] - t[0]))
    f, power, floor = _density(regular, rate)
    upper = _upper(f)
    stands_out = power > floor * 2 * np.log(len(f))
    signal = np.where(stands_out & ~upper[:, None], np.maximum(power - floor, 0), 0.0)
    return Spectrum(f, signal, np.sqrt(floor * rate / 2), rate, len(t))


def white_noise(x: Array, rate_hz: float) -> Array:
    """Standard deviation of the white noise of channels at a regular rate, (n, k) → (k,)."""
    return np.asarray(np.sqrt(_density(x, rate_hz)[2] * rate_hz / 2), float)


def _density(x: Array, rate_hz: float) -> tuple[Array, Array, Array]:
    """Frequencies, power density of channels over them, and its floor."""
    f, power = power_density(detrended(x), rate_hz, len(x))
    # exponential: median = mean · ln 2
    return f, power, np.median(power[_upper(f)], axis=0) / np.log(2)


def _upper(f: Array) -> npt.NDArray[np.bool_]:
    return np.asarray(f > (1 - _FLOOR_SHARE) * f[-1])


class Choice(NamedTuple):
    """The differentiator chosen, its predicted acceleration error (nv,) [rad/s²], and why."""

    differentiator: LocalPolynomial
    error: Array
    why: str


def causal_polynomials(spectrum: Spectrum) -> list[LocalPolynomial]:
    """Polynomials worth a try at this rate, windows in geometric steps."""
    shortest, longest = (span * spectrum.rate_hz / 2 for span in _TIME_SPAN)
    widths = np.unique(
        np.geomspace(max(shortest, 2), max(longest, 4), _CANDIDATES).astype(int)
    )
    sizes = [(2, 2)] + [
        (m, degree)
        for m in map(int, widths)
        for degree in (2, 4)
        if m <= (spectrum.samples - 2) // 4 and degree < 2 * m and (m, degree) != (2, 2)
    ]
    return [LocalPolynomial(*size) for size in sizes]


def causal_polynomial(spectrum: Spectrum) -> Choice:
    """The causal polynomial of smallest predicted error, relative to what joints accelerate."""
    options = causal_polynomials(spectrum)
    (f, signal, noise, rate, _) = spectrum
    power = (2 * np.pi * f) ** 4 * (f[1] - f[0])
    size = np.sqrt(power @ signal)
    moving = size > 0
    weight = np.where(
        moving, 1 / np.where(moving, size, 1.0), 0.0 if moving.any() else 1.0
    )
    lost = [
        np.sqrt((power * (each.gain(f, rate, 2) - 1) ** 2) @ signal) for each in options
    ]
    passed = [noise * each.noise_gain(rate, 2) for each in options]
    total = np.hypot(lost, passed)
    k, *others = np.argsort((weight**2 * total**2).sum(axis=1))
    j = int(np.argmax(weight * total[k]))
    why = (
        f"{options[k].name}: predicted acceleration error {total[k, j]:.3g} (signal lost "
        f"{lost[k][j]:.3g}, noise {passed[k][j]:.3g}) at a position noise of {noise[j]:.3g} of "
        f"joint {j + 1}, the joint where it weighs most"
    )
    if others:
        why += f"; next, {total[others[0], j]:.3g} with {options[others[0]].name}"
    return Choice(options[k], total[k], why)
