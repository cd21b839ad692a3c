"""Signals: the zero-phase filter, spectra, noise, and motion from positions and speeds.

Positions q and speeds v of one joint at a regular period T,

    q_i = x_i + e_i,   S_{i+1} − S_i = x_{i+1} − x_i + T w_i,   S = ∫ v dt by a cubic spline,

e and w white, of standard deviations σ_q and σ_v. The likeliest motion is the smoother of a random
walk in noise (Rauch, Tung, Striebel 1965; the local-level model of Harvey 1989),

    x = S + (1 + λ DᵀD)⁻¹ (q − S),   λ = (σ_q / (T σ_v))²,   D: first differences,

which at frequency f weighs speeds by f² / (f² + f_c²), f_c = σ_v / (2π σ_q), and positions by the
rest. Either is used wherever it knows more; nothing is switched.

σ_q and σ_v are the likeliest (Whittle 1953) of the spectrum of the differences of q − S,
σ_v² T² + 4 σ_q² sin²(π f T), in the band that positions pass afterwards. Before, the speeds are
calibrated to the positions by least squares: gain, offset and delay. The residual motion, as of
speeds that a controller has filtered, counts as their noise. No sensor has less noise than the
white one of its samples, nor, in steps of Δ, than Δ / √12.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy

from excitant.robots.motion import Array, Mask, Motion, Noun, power_density

BUTTERWORTH_ORDER = 4  # of the filter, each way
MEMORY_PERIODS = 6.0  # periods of its cut-off, after which the filter has forgotten
FLOOR_SHARE = 1 / 3  # upper end of the frequency axis, where arms do not move
_CHUNK_VALUES = 60_000  # filtered together: they fit into the processor's cache
_ROUNDING = 1e-9  # of the range of a channel
# white noise over random walk
_VARIANCE_RATIOS = np.log(np.geomspace(1e-12, 1e12, 97))


def low_pass(
    values: Array, cutoff_hz: float, rate_hz: float, rows: slice = slice(None)
) -> Array:
    """Columns, shape (n, ...), through a Butterworth filter forward and backward along time.

    Beyond its ends a signal goes on as its mirror image in the point there (Gustafsson 1996), until
    the filter has forgotten; its line from end to end passes as it is. Only some rows are returned.
    """
    flat = np.reshape(values, (len(values), math.prod(np.shape(values)[1:])))
    passed = np.zeros((len(flat[rows]), flat.shape[1]))
    acting = np.flatnonzero(live(flat))
    count = -(-acting.size * len(flat) // _CHUNK_VALUES)
    for chunk in np.array_split(acting, count) if count else ():
        passed[:, chunk] = _low_passed(flat[:, chunk], cutoff_hz, rate_hz, rows).T
    return passed.reshape(len(passed), *np.shape(values)[1:])


def _low_passed(
    values: Array, cutoff_hz: float, rate_hz: float, rows: slice
) -> Array:
    """Filtered columns, shape (n, k), as rows, at some instants."""
    n = len(values)
    before = min(n - 1, int(MEMORY_PERIODS * rate_hz / cutoff_hz))
    fast_size = scipy.fft.next_fast_len(n + 2 * before, real=True)
    after = min(n - 1, fast_size - n - before)
    size = before + n + after
    inner = slice(before, before + n)
    x = np.empty((values.shape[1], size))
    x[:, inner] = values.T
    x[:, :before] = 2 * x[:, before, None] - x[:, 2 * before : before : -1]
    end = before + n - 1
    x[:, end + 1 :] = 2 * x[:, end, None] - x[:, end - 1 : end - 1 - after : -1]
    first = x[:, :1].copy()
    slope = (x[:, -1:] - first) / max(size - 1, 1)
    along = np.arange(size)
    x -= first + slope * along  # a constant passes without rounding
    spectrum = scipy.fft.rfft(x, overwrite_x=True)
    spectrum *= _gain(size, cutoff_hz / rate_hz)
    passed = scipy.fft.irfft(spectrum, size, overwrite_x=True)[:, inner][:, rows]
    return passed + first + slope * along[inner][rows]


@lru_cache(maxsize=64)
def _gain(size: int, cutoff: float) -> Array:
    """1 / (1 + (f / f_c)⁸) at the frequencies of so many samples; one half at f_c.

    That of the analogue filter, so that it is the same at every sampling rate.
    """
    ratio = np.arange(size // 2 + 1) / (size * cutoff)
    return 1 / (1 + ratio ** (2 * BUTTERWORTH_ORDER))


def differentiated(t: Array, q: Array, cutoff_hz: float) -> Motion:
    """Motion at regular instants: positions (n, nv) low-passed, then a quintic spline."""
    rate_hz = (len(t) - 1) / float(t[-1] - t[0])
    spline = scipy.interpolate.make_interp_spline(
        t, low_pass(q, cutoff_hz, rate_hz), 5
    )
    return Motion(t, spline(t), spline(t, 1), spline(t, 2))


def live(values: Array) -> Mask:
    """Which columns, shape (n, ...), are not zero throughout; 16 rows show most of them."""
    nonzero = np.asarray(values[:: max(1, len(values) // 16)].any(axis=0), bool)
    return nonzero if nonzero.all() else np.asarray(values.any(axis=0), bool)


def detrended(values: Array) -> Array:
    """Columns, shape (n, ...), less the straight line that fits each best."""
    along = np.linspace(-1.0, 1.0, len(values))
    centred = values - values.mean(axis=0)
    slope = np.tensordot(along, centred, 1) / (along @ along)
    return centred - np.multiply.outer(along, slope)


def floor_density(x: Array, rate_hz: float) -> tuple[Array, Array, Array]:
    """Frequencies (m,), power density (m, k) of channels (n, k), and its floor (k,).

    The power of noise at one frequency is exponential, so that its mean is its median / ln 2.
    """
    f, power = power_density(detrended(x), rate_hz, len(x))
    upper = f > (1 - FLOOR_SHARE) * f[-1]
    return f, power, np.median(power[upper], axis=0) / np.log(2)


def white_noise(x: Array, rate_hz: float) -> Array:
    """Standard deviation of the white noise of channels at a regular rate, (n, k) → (k,)."""
    return np.sqrt(floor_density(x, rate_hz)[2] * rate_hz / 2)


def noise(x: Array) -> float:
    """Standard deviation of white noise on a smooth signal, from its fourth differences.

    For channels that are not trusted yet, regular time included; see `white_noise`.
    """
    if len(x) < 10:
        return 0.0
    # normal noise: median magnitude 0.6745 σ; squares of (1, 4, 6, 4, 1) sum up to 70
    return float(np.median(np.abs(np.diff(x, 4))) / 0.6745 / np.sqrt(70.0))


def samples_motion(q: Array) -> bool:
    """Whether rows of positions, shape (n, nv), are samples of a motion and no list of poses.

    Neighbours are then closer than any two rows: of the mean square of their differences over the
    variance (von Neumann 1941) 2 is usual for rows in any order, and 1 for 6 samples in a period.
    """
    spread = q.var(axis=0)
    moved = spread > 0
    ratio = (np.diff(q[:, moved], axis=0) ** 2).mean(axis=0) / spread[moved]
    return len(ratio) == 0 or bool(np.median(ratio) < 1)


def quantum(x: Array) -> float:
    """Step of a quantised channel, the lower decile of the distances of its levels; or 0."""
    gaps = _gaps(x)
    return float(np.quantile(gaps, 0.1)) if len(gaps) else 0.0


def resolution(x: Array) -> float:
    """Step of a channel all of whose values are multiples of it; 0 of any other."""
    step = quantum(x)
    if not step:
        return 0.0
    multiples = _gaps(x) / step
    # mean distance from whole numbers: 0 on a lattice, 0.25 where there is none
    return step if np.abs(multiples - np.round(multiples)).mean() <= 0.1 else 0.0


def _gaps(x: Array) -> Array:
    """Distances of neighbouring levels of a channel, but for rounding."""
    levels = np.unique(x[np.isfinite(x)])
    gaps = np.diff(levels)
    return gaps[gaps > _ROUNDING * np.ptp(levels)] if len(gaps) else gaps


@dataclass(frozen=True, eq=False)
class SensorNoise(Noun):
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

    @property
    def crossover_hz(self) -> Array:
        """Frequency above which speeds count more than positions, f_c, shape (nv,) [Hz]."""
        return self.speed / (2 * np.pi * self.position)

    @property
    def span(self) -> Array:
        """Range of the positions of a joint at rest, ± 5 deviations, shape (nv,) [rad or m]."""
        return 10.0 * self.position

    def sentence(self, joints: Sequence[str]) -> str:
        """From which frequency speeds count more than positions, joint by joint."""
        if not np.isfinite(self.speed).any():
            return "motion from positions alone: no speeds were recorded for all joints"
        crossover = dict(zip(joints, self.crossover_hz.tolist(), strict=True))
        nyquist = self.rate_hz / 2
        fused = [
            f"{joint} {f:.3g}" for joint, f in crossover.items() if f < nyquist
        ]
        alone = [joint for joint, f in crossover.items() if f >= nyquist]
        parts = []
        if fused:
            parts.append(f"speeds count more above [Hz] {', '.join(fused)}")
        if alone:
            listed = ", ".join(alone)
            parts.append(f"positions count more at every frequency at {listed}")
        heading = (
            "motion from positions and recorded speeds, weighed by their noise"
        )
        return f"{heading}: {'; '.join(parts)}"

    def speed_share(self, f: Array | float) -> Array:
        """Weight of speeds at frequencies [Hz], shape (..., nv); positions have the rest."""
        squared = np.asarray(f, float)[..., None] ** 2
        return squared / (squared + self.crossover_hz**2)

    def least_speed(self, cutoff_hz: float) -> Array:
        """Speed that a joint at rest never shows behind the filter of positions, shape (nv,).

        The most that a position makes which jumps between two neighbouring steps as it likes, and
        four standard deviations of what noise makes.
        """
        f = np.asarray(np.fft.rfftfreq(2048, 1 / self.rate_hz), float)
        passed = 1 / (1 + (f / cutoff_hz)[:, None] ** (2 * BUTTERWORTH_ORDER))
        share = self.speed_share(f)
        response = np.fft.irfft((1 - share) * passed, axis=0) * self.rate_hz
        rises = np.maximum(np.diff(response, axis=0, append=response[:1]), 0)
        jumps = self.step * rises.sum(axis=0)
        return np.maximum(jumps, 4.0 * self._derivative(f, passed))

    def acceleration(self, cutoff_hz: float, torque_hz: float) -> Array:
        """Noise of accelerations behind the filters of positions and of torque, (nv,) [rad/s²]."""
        f = np.asarray(np.fft.rfftfreq(2048, 1 / self.rate_hz), float)
        passed = [
            1 / (1 + (f / hz)[:, None] ** (2 * BUTTERWORTH_ORDER))
            for hz in (cutoff_hz, torque_hz)
        ]
        return self._derivative(f, 2 * np.pi * f[:, None] * passed[0] * passed[1])

    def _derivative(self, f: Array, gain: Array) -> Array:
        """Noise of speeds behind a gain, (m, 1), at frequencies f, (m,) [Hz]; (nv,)."""
        share = self.speed_share(f)
        of_positions = 2 * np.pi * f[:, None] * (1 - share) * self.position
        of_speeds = share * np.where(np.isfinite(self.speed), self.speed, 0.0)
        squares = (of_positions**2 + of_speeds**2) * gain**2
        return np.sqrt(2 / self.rate_hz * np.trapezoid(squares, f, axis=0))


def mean_noise(parts: Sequence[SensorNoise], samples: Sequence[int]) -> SensorNoise:
    """Noise of several parts of so many samples together, rms; the coarsest step."""

    def rms(values: list[Array]) -> Array:
        return np.sqrt(np.average(np.square(values), axis=0, weights=samples))

    return SensorNoise(
        rate_hz=min(part.rate_hz for part in parts),
        position=rms([part.position for part in parts]),
        speed=rms([part.speed for part in parts]),
        step=np.max([part.step for part in parts], axis=0),
    )


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
    least, step = _least_noise(q, period)
    position = least.copy()
    speed = np.full(q.shape[1], np.inf)
    if dq is None:
        return q, SensorNoise(1 / period, position, speed, step)
    path = scipy.interpolate.make_interp_spline(t, dq, k=3).antiderivative()(t)
    least_of_speeds, _ = _least_noise(dq, period)
    refined = np.empty_like(q)
    for j, measured in enumerate(q.T):
        # offset, offset of the speed, its gain, its delay
        causes = np.column_stack(
            [np.ones_like(t), t - t.mean(), path[:, j], dq[:, j]]
        )
        calibration = np.linalg.lstsq(causes, measured, rcond=None)[0]
        residual = measured - causes @ calibration
        walk, white = _variances(np.diff(residual), period, band_hz)
        position[j] = max(np.sqrt(white), least[j])
        floor = abs(calibration[2]) * least_of_speeds[j]
        speed[j] = max(np.sqrt(walk) / period, floor)
        ratio = min(position[j] / (period * speed[j]), float(len(t)))
        refined[:, j] = measured - residual + _local_level(residual, ratio)
    return refined, SensorNoise(1 / period, position, speed, step)


def _least_noise(x: Array, period: float) -> tuple[Array, Array]:
    """Noise that channels (n, nv) have at least, white or of steps or of rounding; steps."""
    step = np.array([resolution(channel) for channel in x.T])
    rounding = _ROUNDING * np.maximum(np.ptp(x, axis=0), _ROUNDING)
    white = np.maximum(white_noise(x, 1 / period), step / np.sqrt(12))
    return np.maximum(white, rounding), step


def _variances(steps: Array, period: float, band_hz: float) -> tuple[float, float]:
    """Variances of a random walk per step and of white noise on it, from its differences (n,)."""
    f, power = power_density(steps, 1 / period, len(steps))
    # the window smears the mean over two bins
    band = (f > 1.5 * f[1]) & (f <= band_hz)
    power = np.maximum(power[band] / (2 * period), np.finfo(float).tiny)
    size = 4 * np.sin(np.pi * f[band] * period) ** 2

    def surprise(log_ratio: float) -> float:
        relative = 1 + np.exp(log_ratio) * size
        return float(np.log(relative).mean() + np.log((power / relative).mean()))

    ratio = float(np.exp(grid_minimum(surprise, _VARIANCE_RATIOS)[0]))
    walk = float((power / (1 + ratio * size)).mean())
    return walk, ratio * walk


def grid_minimum(
    objective: Callable[[float], float], grid: Array
) -> tuple[float, float]:
    """Place and value of the least minimum of an objective near the best point of a grid."""
    k = int(np.argmin([objective(x) for x in grid]))
    ends = (grid[max(k - 1, 0)], grid[min(k + 1, len(grid) - 1)])
    best = scipy.optimize.minimize_scalar(objective, bounds=ends, method="bounded")
    return float(best.x), float(best.fun)


def _local_level(x: Array, ratio: float) -> Array:
    """(1 + ratio² DᵀD)⁻¹ x, shape (n,)."""
    bands = np.zeros((2, len(x)))
    bands[0] = 1 + 2 * ratio**2
    bands[0, [0, -1]] = 1 + ratio**2
    bands[1, :-1] = -(ratio**2)
    return scipy.linalg.solveh_banded(bands, x, lower=True)
