"""Motion from measured positions and speeds, each weighed by its noise at every frequency.

Positions q and speeds v of one joint at a regular period T,

    q_i = x_i + e_i,   S_{i+1} − S_i = x_{i+1} − x_i + T w_i,   S = ∫ v dt by a cubic spline,

e and w white, of standard deviations σ_q and σ_v. The likeliest motion is the smoother of a random
walk in noise (Rauch, Tung, Striebel 1965; the local-level model of Harvey 1989),

    x = S + (1 + λ DᵀD)⁻¹ (q − S),   λ = (σ_q / (T σ_v))²,   D: first differences,

which at frequency f weighs speeds by f² / (f² + f_c²), f_c = σ_v / (2π σ_q), and positions by the
rest. Either is used wherever it knows more; nothing is switched.

σ_q and σ_v are the likeliest (Whittle 1953) of the spectrum of the differences of q − S,
σ_v² T² + 4 σ_q² sin²(π f T), in the band that positions pass afterwards. Before, the speeds are
calibrated to the positions by least squares: gain, offset and delay. What then is left of the
motion itself, as of speeds that a controller has filtered, counts as their noise. No sensor has
less noise than the white one of its samples, nor, in steps of Δ, than Δ / √12.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from excitant.identify.differentiators import white_noise
from excitant.identify.spectra import BUTTERWORTH_ORDER, power_density
from excitant.robots.motion import Array, freeze

_LATTICE = 0.1  # mean distance of levels' gaps from multiples of a step; 0.25 where there is none
_ROUNDING = 1e-9  # of what a channel spans
_RATIOS = np.log(np.geomspace(1e-12, 1e12, 97))  # of variances, tried
_CERTAIN = 4.0  # standard deviations of noise that no speed is mistaken for
_FARTHEST = 5.0  # standard deviations that no position is off, of millions
_GRID = 2048  # frequencies


def noise(x: Array) -> float:
    """Standard deviation of white noise on a smooth signal, from its fourth differences."""
    if len(x) < 10:
        return 0.0
    return float(np.median(np.abs(np.diff(x, 4))) / 0.6745 / np.sqrt(70.0))


def quantum(x: Array) -> float:
    """Step of a quantised channel, the lower decile of the distances of its levels; or 0."""
    return _low(_gaps(x))


def resolution(x: Array) -> float:
    """Step of a channel all of whose values are multiples of it; 0 of any other."""
    gaps = _gaps(x)
    step = _low(gaps)
    if not step or np.abs(gaps / step - np.round(gaps / step)).mean() > _LATTICE:
        return 0.0
    return step


def _low(gaps: Array) -> float:
    return float(np.quantile(gaps, 0.1)) if len(gaps) else 0.0


def _gaps(x: Array) -> Array:
    levels = np.unique(x[np.isfinite(x)])
    gaps = np.diff(levels)
    return (
        gaps[gaps > _ROUNDING * max(float(np.ptp(levels)), 1e-300)]
        if len(gaps)
        else gaps
    )


@dataclass(frozen=True, eq=False)
class SensorNoise:
    """Noise of positions and speeds as sampled, each shape (nv,).

    Attributes:
        rate_hz: Sampling rate [Hz].
        position: Standard deviation of positions [rad or m].
        speed: The same of speeds [rad/s or m/s]; infinite where none were measured.
        step: Resolution of positions, 0 where they have none [rad or m].
    """

    rate_hz: float
    position: Array
    speed: Array
    step: Array

    def __post_init__(self) -> None:
        freeze(self, "position", "speed", "step")

    @property
    def crossover_hz(self) -> Array:
        """Frequency above which speeds count more than positions, f_c, shape (nv,) [Hz]."""
        return np.asarray(self.speed / (2 * np.pi * self.position), float)

    @property
    def span(self) -> Array:
        """Range that positions of a joint at rest stay in, shape (nv,) [rad or m]."""
        return np.asarray(2 * _FARTHEST * self.position, float)

    def entry(self, joint: int, cutoff_hz: float) -> dict[str, Any]:
        """Entry of a joint in ``result.json``; the speed's weight is that at a cut-off [Hz]."""
        known = bool(np.isfinite(self.speed[joint]))
        return {
            "position_noise": float(self.position[joint]),
            "position_step": float(self.step[joint]) or None,
            "speed_noise": float(self.speed[joint]) if known else None,
            "crossover_hz": float(self.crossover_hz[joint]) if known else None,
            "speed_weight": float(self.speed_share(cutoff_hz)[joint]),
        }

    def sentence(self, joints: Sequence[str]) -> str:
        """From which frequency speeds count more than positions, joint by joint."""
        if not np.isfinite(self.speed).any():
            return "motion from positions alone: no speeds were recorded for all joints"
        top = self.rate_hz / 2
        found = dict(zip(joints, self.crossover_hz.tolist(), strict=True))
        both = ", ".join(f"{joint} {f:.3g}" for joint, f in found.items() if f < top)
        never = ", ".join(joint for joint, f in found.items() if f >= top)
        told = [f"speeds count more above [Hz] {both}"] * bool(both)
        told += [f"positions count more at every frequency at {never}"] * bool(never)
        shares = "; ".join(told)
        return f"motion from positions and recorded speeds, weighed by their noise: {shares}"

    def speed_share(self, f: Array | float) -> Array:
        """Weight of speeds at frequencies [Hz], shape (..., nv); positions have the rest."""
        f = np.asarray(f, float)[..., None]
        return np.asarray(f**2 / (f**2 + self.crossover_hz**2), float)

    def least_speed(self, cutoff_hz: float) -> Array:
        """Speed that a joint at rest never shows behind the filter of positions, shape (nv,).

        The most that a position makes which jumps between two neighbouring steps as it likes, and
        four standard deviations of what noise makes.
        """
        f = np.asarray(np.fft.rfftfreq(_GRID, 1 / self.rate_hz), float)
        passed = 1 / (1 + (f / cutoff_hz)[:, None] ** (2 * BUTTERWORTH_ORDER))
        share = self.speed_share(f)
        h = np.fft.irfft((1 - share) * passed, axis=0) * self.rate_hz
        jumps = self.step * np.maximum(np.diff(h, axis=0, append=h[:1]), 0).sum(axis=0)
        of_positions = 2 * np.pi * f[:, None] * (1 - share) * self.position
        of_speeds = share * np.where(np.isfinite(self.speed), self.speed, 0.0)
        squares = (of_positions**2 + of_speeds**2) * passed**2
        noise = np.sqrt(2 / self.rate_hz * np.trapezoid(squares, f, axis=0))
        return np.asarray(np.maximum(jumps, _CERTAIN * noise), float)


def mean_noise(parts: Sequence[SensorNoise], samples: Sequence[int]) -> SensorNoise:
    """Noise of several parts of so many samples together, rms; the coarsest step."""

    def rms(values: list[Array]) -> Array:
        return np.asarray(
            np.sqrt(np.average(np.square(values), axis=0, weights=samples)), float
        )

    position = rms([part.position for part in parts])
    speed = rms([part.speed for part in parts])
    step = np.max([part.step for part in parts], axis=0)
    return SensorNoise(min(part.rate_hz for part in parts), position, speed, step)


def smoothed(
    t: Array, q: Array, dq: Array | None, band_hz: float
) -> tuple[Array, SensorNoise]:
    """Positions that measured speeds refine, and the noise of both.

    Args:
        t: Regular time, shape (n,) [s].
        q: Measured positions, shape (n, nv) [rad or m].
        dq: Measured speeds, shape (n, nv) [rad/s or m/s]; None leaves positions as they are.
        band_hz: Band in which the motion is wanted, and noise is looked for [Hz].
    """
    period = float(t[-1] - t[0]) / (len(t) - 1)
    step = np.array([resolution(x) for x in q.T])
    least = _least(q, step, period)
    if dq is None:
        return q, SensorNoise(1 / period, least, np.full(q.shape[1], np.inf), step)
    way = scipy.interpolate.make_interp_spline(t, dq, k=3).antiderivative()(t)
    found = np.empty_like(q)
    levels = np.empty((2, q.shape[1]))
    least_of_speeds = _least(dq, np.array([resolution(x) for x in dq.T]), period)
    for j in range(q.shape[1]):
        known = np.column_stack([np.ones_like(t), t - t.mean(), way[:, j], dq[:, j]])
        calibration = np.linalg.lstsq(known, q[:, j], rcond=None)[0]
        left = q[:, j] - known @ calibration
        drift, white = _variances(np.diff(left), period, band_hz)
        levels[:, j] = np.sqrt(white), np.sqrt(drift) / period
        floor = least[j], abs(calibration[2]) * least_of_speeds[j]
        levels[:, j] = np.maximum(levels[:, j], floor)
        ratio = levels[0, j] / (period * levels[1, j])
        found[:, j] = q[:, j] - left + _local_level(left, min(ratio, float(len(t))))
    return found, SensorNoise(1 / period, levels[0], levels[1], step)


def _least(x: Array, step: Array, period: float) -> Array:
    """Noise that channels have at least: white, of their steps and of rounding, shape (nv,)."""
    rounding = _ROUNDING * np.maximum(np.ptp(x, axis=0), _ROUNDING)
    white = np.maximum(white_noise(x, 1 / period), step / np.sqrt(12))
    return np.asarray(np.maximum(white, rounding), float)


def _variances(steps: Array, period: float, band_hz: float) -> tuple[float, float]:
    """Variances of a random walk per step and of white noise on it, from its differences (n,)."""
    f, power = power_density(steps, 1 / period, len(steps))
    band = (f > 1.5 * f[1]) & (f <= band_hz)  # the window smears the mean over two bins
    power = power[band] / (2 * period)
    size = 4 * np.sin(np.pi * f[band] * period) ** 2
    power = np.maximum(power, np.finfo(float).tiny)

    def surprise(log_ratio: float) -> float:
        relative = 1 + np.exp(log_ratio) * size
        return float(np.log(relative).mean() + np.log((power / relative).mean()))

    k = int(np.argmin([surprise(x) for x in _RATIOS]))
    ends = _RATIOS[max(k - 1, 0)], _RATIOS[min(k + 1, len(_RATIOS) - 1)]
    ratio = float(
        np.exp(
            scipy.optimize.minimize_scalar(surprise, bounds=ends, method="bounded").x
        )
    )
    walk = float((power / (1 + ratio * size)).mean())
    return walk, ratio * walk


def _local_level(x: Array, ratio: float) -> Array:
    """(1 + ratio² DᵀD)⁻¹ x, shape (n,)."""
    bands = np.zeros((2, len(x)))
    bands[0] = 1 + 2 * ratio**2
    bands[0, [0, -1]] = 1 + ratio**2
    bands[1, :-1] = -(ratio**2)
    return np.asarray(scipy.linalg.solveh_banded(bands, x, lower=True), float)
