"""Differentiators: from sampled positions to velocity and acceleration.

* `ZeroPhaseButterworth`: filter forward and backward, then a quintic spline; what recordings pass.
* `LocalPolynomial`: least-squares polynomial through a moving window (Savitzky and Golay 1964);
  `five_point` is Khosla's (1987, §5.1), f' = (−2f₋₂ − f₋₁ + f₁ + 2f₂) / (10T). The causal kind
  serves a loop; `causal_polynomial` takes the window that suits the positions best.

Positions are signal plus white noise. The noise level is the floor of the upper part of the
periodogram; the signal is what stands out of the floor. A polynomial with gain g then makes the
acceleration error

    e² = ∫ S(f) (2πf)⁴ (g(f) − 1)² df + σ² · noise_gain²,

lost signal plus noise let through, both known before anything is differentiated.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import factorial
from typing import Protocol

import numpy as np
import numpy.typing as npt
import scipy

from excitant.exceptions import BadInput
from excitant.robots.motion import Array, Motion, freeze

_IRREGULAR = 1e-3  # of a step: what counts as the same step
_BUTTERWORTH_ORDER = 4
_FEWEST = 64  # samples of a spectrum
_FLOOR_SHARE = 1 / 3  # of the frequency axis, its upper end, where arms do not move
_TIME_SPAN = (0.004, 0.3)  # s: windows of polynomials that are worth a try
_CANDIDATES = 12  # windows tried


class Differentiator(Protocol):
    """What every differentiator offers."""

    @property
    def name(self) -> str:
        """Name with its settings."""

    def delay(self, rate_hz: float) -> float:
        """Time between the newest sample it needs and the instant it speaks about [s]."""

    def __call__(self, t: Array, q: Array) -> Motion:
        """Motion at the samples; q has shape (n, nv).

        Raises:
            BadInput: Too few samples, or irregular time where that cannot be.
        """


def step_of(t: Array, who: str) -> float:
    """Sampling period of regular time [s].

    Raises:
        BadInput: Time that is not regular to a thousandth of a step.
    """
    steps = np.diff(t)
    step = float(t[-1] - t[0]) / len(steps)
    if not _regular(t):
        worst = int(np.argmax(np.abs(steps - step)))
        raise BadInput(
            f"{who}: time is irregular ({steps[worst]:.4g} s after {t[worst]:.6g} s, "
            f"else {step:.4g} s); resample it, or use a local polynomial"
        )
    return step


def _regular(t: Array) -> bool:
    step = (t[-1] - t[0]) / (len(t) - 1)
    return bool(np.abs(np.diff(t) - step).max() <= _IRREGULAR * step)


def _refuse_short(t: Array, needed: int, who: str) -> None:
    if len(t) < needed:
        raise BadInput(f"{who}: {len(t)} samples, at least {needed} are needed; record longer")


@dataclass(frozen=True)
class LocalPolynomial:
    """Least-squares polynomial of some degree through 2m + 1 samples, differentiated in the middle.

    Attributes:
        half_width: m, samples on either side.
        degree: Degree of the polynomial, below 2m + 1.
        causal: Whether it serves a loop that knows no future: it then speaks about the instant m
            samples ago. The numbers are those of the other kind; only instants whose window
            ends at a sample are given.
    """

    half_width: int
    degree: int
    causal: bool = False

    def __post_init__(self) -> None:
        if not 2 <= self.degree <= 2 * self.half_width:
            raise BadInput(
                f"local polynomial: degree {self.degree} through {2 * self.half_width + 1} "
                "samples; give a degree from 2 to the number of samples less one"
            )

    @property
    def name(self) -> str:
        """Name with its settings."""
        if (self.half_width, self.degree) == (2, 2):
            kind = "five-point least squares"
        else:
            kind = f"Savitzky-Golay ({2 * self.half_width + 1} samples, degree {self.degree})"
        return f"{kind}, causal" if self.causal else kind

    def kernel(self, order: int) -> Array:
        """Weights c with f⁽ᵒ⁾ ≈ Σ c_k f_k / Tᵒ, oldest sample first, shape (2m + 1,)."""
        return _polynomial_kernels(self.half_width, self.degree)[order]

    def delay(self, rate_hz: float) -> float:
        """Half a window where it is causal [s]."""
        return self.half_width / rate_hz if self.causal else 0.0

    def gain(self, f: Array, rate_hz: float, order: int = 1) -> Array:
        """Response relative to the true derivative (its delay taken out), shape of f."""
        omega = 2 * np.pi * np.asarray(f, float) / rate_hz
        k = np.arange(-self.half_width, self.half_width + 1)
        response = np.exp(1j * omega[..., None] * k) @ self.kernel(order)
        return _relative(response, omega, order)

    def noise_gain(self, rate_hz: float, order: int = 1) -> float:
        """‖c‖ / Tᵒ."""
        return float(np.linalg.norm(self.kernel(order))) * rate_hz**order

    def __call__(self, t: Array, q: Array) -> Motion:
        """Motion at the samples; where time is irregular each window is fitted for itself.

        Where it is not causal, the first and last m instants take the polynomial of the
        nearest whole window.
        """
        m, n = self.half_width, len(t)
        _refuse_short(t, 2 * m + 1, self.name)
        if _regular(t):
            step, inner = (
                float(t[-1] - t[0]) / (n - 1),
                slice(m, n - m) if self.causal else slice(n),
            )
            parts = (
                scipy.signal.savgol_filter(q, 2 * m + 1, self.degree, k, step, axis=0)[inner]
                for k in range(3)
            )
            return Motion(t[inner], *parts)
        centre = np.clip(np.arange(m, n - m) if self.causal else np.arange(n), m, n - m - 1)
        at = np.arange(m, n - m) if self.causal else np.arange(n)
        rows = centre[:, None] + np.arange(-m, m + 1)
        step = (t[-1] - t[0]) / (n - 1)
        V = ((t[rows] - t[at][:, None]) / step)[..., None] ** np.arange(self.degree + 1)
        coefficients = np.linalg.pinv(V) @ q[rows]
        return Motion(t[at], *(coefficients[:, k] * factorial(k) / step**k for k in range(3)))


@lru_cache(maxsize=256)
def _polynomial_kernels(half_width: int, degree: int) -> tuple[Array, ...]:
    k = np.arange(-half_width, half_width + 1) / half_width
    weights = np.linalg.pinv(k[:, None] ** np.arange(degree + 1))
    return tuple(weights[order] * factorial(order) / half_width**order for order in range(3))


def five_point(*, causal: bool = False) -> LocalPolynomial:
    """Khosla's differentiator: the least-squares parabola through five samples."""
    return LocalPolynomial(2, 2, causal)


def savitzky_golay(half_width: int, degree: int = 4, *, causal: bool = False) -> LocalPolynomial:
    """Least-squares polynomial through 2 half_width + 1 samples."""
    return LocalPolynomial(half_width, degree, causal)


def _relative(response: npt.NDArray[np.complex128], omega: Array, order: int) -> Array:
    """Response over (jω)ᵒ, real; at ω = 0 its limit for a filter that is exact on parabolas."""
    ideal = (1j * omega) ** order
    safe = np.where(omega == 0, 1.0, ideal)
    return np.asarray(np.where(omega == 0, 1.0, (response / safe).real), float)


def low_pass(values: Array, cutoff_hz: float, rate_hz: float) -> Array:
    """Columns, shape (n, ...), through a zero-phase Butterworth filter along time."""
    sections = _butterworth(cutoff_hz, rate_hz)
    padding = min(len(values) - 1, int(3 * rate_hz / cutoff_hz))
    filtered: Array = scipy.signal.sosfiltfilt(sections, values, axis=0, padlen=padding)
    return filtered


@lru_cache(maxsize=64)
def _butterworth(cutoff_hz: float, rate_hz: float) -> Array:
    """Sections of the filter; the design costs more than filtering a short recording."""
    sections = scipy.signal.butter(_BUTTERWORTH_ORDER, cutoff_hz, fs=rate_hz, output="sos")
    return np.asarray(sections, float)


@dataclass(frozen=True)
class ZeroPhaseButterworth:
    """Butterworth filter of fourth order forward and backward, then a quintic spline.

    Attributes:
        cutoff_hz: Cut-off of one pass [Hz]; the gain there is one half.
    """

    cutoff_hz: float

    @property
    def name(self) -> str:
        """Name with its settings."""
        return f"zero-phase Butterworth ({self.cutoff_hz:.4g} Hz) with quintic spline"

    def delay(self, rate_hz: float) -> float:
        """None, but it needs the whole recording."""
        return 0.0

    def __call__(self, t: Array, q: Array) -> Motion:
        """Motion at the samples of regular time."""
        _refuse_short(t, 20, self.name)
        rate = 1 / step_of(t, self.name)
        if not 0 < self.cutoff_hz < rate / 2:
            raise BadInput(
                f"{self.name}: the cut-off does not fit a rate of {rate:.4g} Hz; "
                f"choose one below {rate / 2:.4g} Hz"
            )
        smooth = low_pass(q, self.cutoff_hz, rate)
        spline = scipy.interpolate.make_interp_spline(t, smooth, k=5)
        return Motion(t, spline(t), spline(t, 1), spline(t, 2))


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
    if len(t) < _FEWEST:
        raise BadInput(
            f"choice of a differentiator: {len(t)} samples; at least {_FEWEST} are needed"
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

    differentiator: LocalPolynomial
    error: Array
    lost: Array
    noise: Array
    why: str

    def __post_init__(self) -> None:
        freeze(self, "error", "lost", "noise")


def predicted_error(polynomial: LocalPolynomial, spectrum: Spectrum) -> tuple[Array, Array]:
    """Signal lost and noise let through in the acceleration, each of shape (nv,) [rad/s²]."""
    f, rate = spectrum.f, spectrum.rate_hz
    missing = (2 * np.pi * f) ** 4 * (polynomial.gain(f, rate, 2) - 1) ** 2
    lost = np.sqrt(missing @ spectrum.signal * (f[1] - f[0]))
    return lost, spectrum.noise * polynomial.noise_gain(rate, 2)


def causal_polynomials(spectrum: Spectrum) -> list[LocalPolynomial]:
    """Polynomials worth a try at this rate, windows in geometric steps."""
    rate = spectrum.rate_hz
    shortest, longest = (span * rate / 2 for span in _TIME_SPAN)
    limit = (round(spectrum.duration * rate) - 1) // 4
    widths = np.unique(np.geomspace(max(shortest, 2), max(longest, 4), _CANDIDATES).astype(int))
    found = [five_point(causal=True)]
    for m in (int(m) for m in widths if m <= limit):
        degrees = [d for d in (2, 4) if d < 2 * m and (m, d) != (2, 2)]
        found += [savitzky_golay(m, degree, causal=True) for degree in degrees]
    return found


def causal_polynomial(spectrum: Spectrum) -> Choice:
    """The causal polynomial with the smallest predicted acceleration error.

    Joints count relative to the acceleration their signal has.
    """
    options = causal_polynomials(spectrum)
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
