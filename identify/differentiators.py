"""Causal differentiators of a loop: local polynomials, and the one that suits positions best.

Least-squares polynomials through a moving window (Savitzky and Golay 1964); through five samples
Khosla's (1987, §5.1), f' = (−2f₋₂ − f₋₁ + f₁ + 2f₂) / (10T). Recordings are differentiated without
delay instead (`excitant.identify.signals.differentiated`).

Positions are signal plus white noise, whose level is the floor of the upper part of the
periodogram. A polynomial with gain g then makes the acceleration error

    e² = ∫ S(f) (2πf)⁴ (g(f) − 1)² df + σ² · noise_gain².
"""

from dataclasses import dataclass
from functools import lru_cache
from math import factorial
from typing import NamedTuple

import numpy as np

from excitant.exceptions import BadInput
from excitant.identify.signals import FLOOR_SHARE, floor_density
from excitant.robots.motion import Array, interpolated

_LEAST_SAMPLES = 64  # of a spectrum
_SHORTEST_S = 0.004  # s: window of the quickest polynomial tried
_LONGEST_S = 0.3  # s: window of the slowest
_WINDOWS = 12  # tried, in geometric steps


@dataclass(frozen=True)
class LocalPolynomial:
    """Least-squares polynomial through 2m + 1 samples at a regular rate, differentiated.

    Each instant is the middle of a window that ends at a sample, m samples late.
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
        samples = 2 * self.half_width + 1
        return f"Savitzky-Golay ({samples} samples, degree {self.degree})"

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
        # at ω = 0 the limit of a filter that is exact on parabolas
        ideal = np.where(omega == 0, 1.0, (1j * omega) ** order)
        return np.where(omega == 0, 1.0, (response / ideal).real)

    def noise_gain(self, rate_hz: float, order: int = 1) -> float:
        """‖c‖ / Tᵒ."""
        return float(np.linalg.norm(self.kernel(order))) * rate_hz**order


@lru_cache(maxsize=256)
def _kernels(half_width: int, degree: int) -> tuple[Array, ...]:
    k = np.arange(-half_width, half_width + 1) / half_width
    weights = np.linalg.pinv(k[:, None] ** np.arange(degree + 1))
    return tuple(
        weights[order] * factorial(order) / half_width**order for order in range(3)
    )


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
    n = len(t)
    if n < _LEAST_SAMPLES:
        raise BadInput(
            f"choice of a differentiator: {n} samples; at least {_LEAST_SAMPLES} are needed"
        )
    grid = np.linspace(t[0], t[-1], n)
    regular = interpolated(grid, t, q)
    rate_hz = float((n - 1) / (t[-1] - t[0]))
    f, power, floor = floor_density(regular, rate_hz)
    moving = f <= (1 - FLOOR_SHARE) * f[-1]
    signal = (power > floor * 2 * np.log(len(f))) & moving[:, None]
    noise = np.sqrt(floor * rate_hz / 2)
    return Spectrum(f, np.where(signal, power - floor, 0.0), noise, rate_hz, n)


class Choice(NamedTuple):
    """The differentiator chosen, its predicted acceleration error (nv,) [rad/s²], and why."""

    differentiator: LocalPolynomial
    error: Array
    why: str


def causal_polynomials(spectrum: Spectrum) -> list[LocalPolynomial]:
    """Polynomials worth a try at this rate, windows in geometric steps."""
    shortest = max(_SHORTEST_S * spectrum.rate_hz / 2, 2)
    longest = max(_LONGEST_S * spectrum.rate_hz / 2, 4)
    widths = np.unique(
        np.geomspace(shortest, longest, _WINDOWS).astype(int)
    ).tolist()
    fitting = [m for m in widths if m <= (spectrum.samples - 2) // 4]
    sizes = [(m, degree) for m in fitting for degree in (2, 4) if degree < 2 * m]
    others = [size for size in sizes if size != (2, 2)]
    return [LocalPolynomial(*size) for size in [(2, 2), *others]]


def causal_polynomial(spectrum: Spectrum) -> Choice:
    """The causal polynomial of smallest predicted error, relative to what joints accelerate."""
    candidates = causal_polynomials(spectrum)
    f = spectrum.f
    rate_hz = spectrum.rate_hz
    power = (2 * np.pi * f) ** 4 * (f[1] - f[0])
    size = np.sqrt(power @ spectrum.signal)
    moving = size > 0
    still = 0.0 if moving.any() else 1.0
    weight = np.where(moving, 1 / np.where(moving, size, 1.0), still)
    errors = [power * (c.gain(f, rate_hz, 2) - 1) ** 2 for c in candidates]
    lost = [np.sqrt(error @ spectrum.signal) for error in errors]
    noise = [spectrum.noise * c.noise_gain(rate_hz, 2) for c in candidates]
    total = np.hypot(lost, noise)
    best, *others = np.argsort((weight**2 * total**2).sum(axis=1))
    j = int(np.argmax(weight * total[best]))
    why = (
        f"{candidates[best].name}: predicted acceleration error {total[best, j]:.3g} (signal lost "
        f"{lost[best][j]:.3g}, noise {noise[best][j]:.3g}) at a position noise of "
        f"{spectrum.noise[j]:.3g} of joint {j + 1}, the joint where it weighs most"
    )
    if others:
        why += (
            f"; next, {total[others[0], j]:.3g} with {candidates[others[0]].name}"
        )
    return Choice(candidates[best], total[best], why)
