"""Differentiators: from sampled positions to velocity and acceleration.

Every differentiator is a value with one interface (`Differentiator`): it says which part of a
derivative it passes (``gain``), how much white noise of the positions it lets into the derivative
(``noise_gain``), how late it is (``delay``), and it turns positions into a `Motion` at the
instants of the samples.

* `LocalPolynomial`: least-squares polynomial through a moving window (Savitzky and Golay 1964);
  `five_point` is Khosla's (1987, §5.1), f' = (−2f₋₂ − f₋₁ + f₁ + 2f₂) / (10T).
* `ZeroPhaseButterworth`: filter forward and backward, then differences or a quintic spline.
* `FourierFit`: all of a periodic motion at once (Swevers et al. 1997); time may be irregular.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import factorial
from typing import Literal, Protocol

import numpy as np
import numpy.typing as npt
import scipy

from excitant.exceptions import BadInput
from excitant.robots.motion import Array, Motion

_IRREGULAR = 1e-3  # of a step: what counts as the same step
_BUTTERWORTH_ORDER = 4
_NOISE_BINS = 8193  # of the frequency axis where a noise gain has no closed form


class Differentiator(Protocol):
    """What every differentiator offers; orders 0, 1 and 2 are position to acceleration."""

    @property
    def name(self) -> str:
        """Name with its settings."""

    def delay(self, rate_hz: float) -> float:
        """Time between the newest sample it needs and the instant it speaks about [s]."""

    def gain(self, f: Array, rate_hz: float, order: int = 1) -> Array:
        """Response at frequencies f [Hz] relative to the true derivative; real, 1 is ideal."""

    def noise_gain(self, rate_hz: float, order: int = 1) -> float:
        """Standard deviation of the derivative per standard deviation of white noise [s⁻ᵒ]."""

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
            f"else {step:.4g} s); resample it, or use a local polynomial or a Fourier fit"
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
    """Butterworth filter of fourth order forward and backward, then a derivative.

    Attributes:
        cutoff_hz: Cut-off of one pass [Hz]; the gain there is one half.
        scheme: ``"spline"`` differentiates the quintic spline through the filtered samples, which
            is what recordings pass before identification; ``"central"`` takes central differences.
    """

    cutoff_hz: float
    scheme: Literal["spline", "central"] = "spline"

    @property
    def name(self) -> str:
        """Name with its settings."""
        kind = "quintic spline" if self.scheme == "spline" else "central differences"
        return f"zero-phase Butterworth ({self.cutoff_hz:.4g} Hz) with {kind}"

    def delay(self, rate_hz: float) -> float:
        """None, but it needs the whole recording."""
        return 0.0

    def gain(self, f: Array, rate_hz: float, order: int = 1) -> Array:
        """|H|² of one pass times the gain of the derivative."""
        self._refuse_cutoff(rate_hz)
        omega = 2 * np.pi * np.asarray(f, float) / rate_hz
        ratio = np.tan(omega / 2) / np.tan(np.pi * self.cutoff_hz / rate_hz)
        twice = 1 / (1 + ratio ** (2 * _BUTTERWORTH_ORDER))
        return np.asarray(twice * _relative(self._difference(omega, order), omega, order), float)

    def noise_gain(self, rate_hz: float, order: int = 1) -> float:
        """Root of the mean square response over all frequencies up to half the rate."""
        f = np.linspace(0, rate_hz / 2, _NOISE_BINS)
        response = self.gain(f, rate_hz, order) * (2 * np.pi * f) ** order
        return float(np.sqrt(np.trapezoid(response**2, f) / (rate_hz / 2)))

    def _difference(self, omega: Array, order: int) -> npt.NDArray[np.complex128]:
        """Response of spline or differences per sampling period."""
        c1, c2 = np.cos(omega), np.cos(2 * omega)
        if self.scheme == "central":
            return np.asarray((1j * np.sin(omega)) ** order, complex)
        through = (66 + 52 * c1 + 2 * c2) / 120  # quintic B-spline at the integers
        first = 1j * (10 * np.sin(omega) + np.sin(2 * omega)) / 12
        parts = (through, first, -1 + (2 * c1 + c2) / 3)
        return np.asarray(parts[order] / through, complex)

    def _refuse_cutoff(self, rate_hz: float) -> None:
        if not 0 < self.cutoff_hz < rate_hz / 2:
            raise BadInput(
                f"{self.name}: the cut-off does not fit a rate of {rate_hz:.4g} Hz; "
                f"choose one below {rate_hz / 2:.4g} Hz"
            )

    def __call__(self, t: Array, q: Array) -> Motion:
        """Motion at the samples of regular time."""
        _refuse_short(t, 20, self.name)
        rate = 1 / step_of(t, self.name)
        self._refuse_cutoff(rate)
        smooth = low_pass(q, self.cutoff_hz, rate)
        if self.scheme == "central":
            dq = np.gradient(smooth, 1 / rate, axis=0, edge_order=2)
            return Motion(t, smooth, dq, np.gradient(dq, 1 / rate, axis=0, edge_order=2))
        spline = scipy.interpolate.make_interp_spline(t, smooth, k=5)
        return Motion(t, spline(t), spline(t, 1), spline(t, 2))


@dataclass(frozen=True)
class FourierFit:
    """Least-squares Fourier series of a periodic motion: exact for one, whatever the sampling.

    Gains are those of whole periods recorded at a regular rate, where the fit is a projection.

    Attributes:
        period: Duration of one period [s].
        harmonics: Number of harmonics of 1 / period.
        periods: Number of periods recorded, for the gains.
    """

    period: float
    harmonics: int
    periods: int = 1

    @property
    def name(self) -> str:
        """Name with its settings."""
        return f"Fourier series ({self.harmonics} harmonics of {1 / self.period:.4g} Hz)"

    def delay(self, rate_hz: float) -> float:
        """None, but it needs whole periods."""
        return 0.0

    def gain(self, f: Array, rate_hz: float, order: int = 1) -> Array:
        """1 at the harmonics it has, 0 at every other frequency of whole periods."""
        multiple = np.asarray(f, float) * self.period
        nearest = np.round(multiple)
        width = 0.5 / self.periods  # frequencies that whole periods tell apart
        inside = (np.abs(multiple - nearest) < width) & (nearest <= self.harmonics)
        return np.asarray(inside, float)

    def noise_gain(self, rate_hz: float, order: int = 1) -> float:
        """√(2/n Σ_k (kω)²ᵒ), for order 0 with the mean besides; n samples."""
        n = self.periods * self.period * rate_hz
        omega = 2 * np.pi / self.period * np.arange(1, self.harmonics + 1)
        mean = 1.0 if order == 0 else 0.0
        return float(np.sqrt((mean + 2 * np.sum(omega ** (2 * order))) / n))

    def __call__(self, t: Array, q: Array) -> Motion:
        """Motion at the samples; time may be irregular."""
        _refuse_short(t, 2 * self.harmonics + 1, self.name)
        omega = 2 * np.pi / self.period * np.arange(1, self.harmonics + 1)
        angle = omega * (t - t[0])[:, None]
        basis = np.hstack([np.ones((len(t), 1)), np.cos(angle), np.sin(angle)])
        solution, _, rank, _ = np.linalg.lstsq(basis, q, rcond=1e-10)
        if rank < basis.shape[1]:
            raise BadInput(
                f"{self.name}: {t[-1] - t[0]:.4g} s do not determine it; record a whole period"
            )
        a, b = np.split(solution[1:], 2)
        w = omega[:, None]
        cosine, sine = np.cos(angle), np.sin(angle)
        return Motion(
            t,
            basis @ solution,
            cosine @ (w * b) - sine @ (w * a),
            -(cosine @ (w**2 * a)) - sine @ (w**2 * b),
        )
