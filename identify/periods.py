"""Motion that repeats: its period from the recording itself, and what differs between periods.

Averaging P periods divides the variance of noise by P and leaves what repeats; what differs
between periods is the noise floor of everything else (Swevers et al. 1997; Olsen, Swevers,
Verdonck 2002).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
import scipy.fft
import scipy.interpolate
import scipy.ndimage
import scipy.optimize
import scipy.stats

from excitant.exceptions import BadRecording
from excitant.identify.bandwidth import best_bandwidth
from excitant.identify.least_squares import autocorrelation_time
from excitant.robots.motion import Array, Motion, freeze, read_only

DIFFERENT = 0.02  # of the motion's standard deviation: what periods may differ by to be repeats
_ALARM = 1e-3  # chance that a motion without period passes
_SAME = 1e-4  # chance at which one lag is called worse than another
_ROUNDING = 1e-4  # of the motion's standard deviation: differences of interpolation
_CANDIDATES = 12  # lags looked at closely
_NEIGHBOURS = 8  # harmonics on either side that the noise of one is taken from


@dataclass(frozen=True, eq=False)
class Periods:
    """Whole periods of a recording, at the same phases.

    Attributes:
        name: Name of the recording.
        period: Duration of one period [s].
        start: When the first begins [s].
        q: Positions, shape (periods, n, nv) [rad or m].
        tau: Torque, unfiltered, shape (periods, n, nv) [torque unit].
    """

    name: str
    period: float
    start: float
    q: Array
    tau: Array

    def __post_init__(self) -> None:
        freeze(self, "q", "tau")

    @property
    def count(self) -> int:
        """Number P of periods, at least 2."""
        return len(self.q)

    @property
    def rate_hz(self) -> float:
        """Samples per time [Hz]."""
        return float(self.q.shape[1] / self.period)

    @property
    def t(self) -> Array:
        """Time from the beginning of a period, shape (n,) [s]."""
        return read_only(np.arange(self.q.shape[1]) / self.rate_hz)

    @property
    def f(self) -> Array:
        """Harmonics of the period, from 0 to half the rate [Hz]."""
        return np.asarray(np.fft.rfftfreq(self.q.shape[1], 1 / self.rate_hz), float)

    @cached_property
    def mean_q(self) -> Array:
        """Positions averaged over periods, shape (n, nv)."""
        return read_only(self.q.mean(axis=0))

    @cached_property
    def mean_tau(self) -> Array:
        """Torque averaged over periods, shape (n, nv)."""
        return read_only(self.tau.mean(axis=0))

    @cached_property
    def q_noise(self) -> Array:
        """Covariance of one position sample between joints, shape (nv, nv) [rad² or m²]."""
        return between_covariance(self.q - self.mean_q)

    @cached_property
    def tau_noise(self) -> Array:
        """Covariance of one torque sample between joints, shape (nv, nv) [torque unit²]."""
        return between_covariance(self.tau - self.mean_tau)

    def spectrum(self) -> tuple[Array, npt.NDArray[np.complex128]]:
        """Frequencies of a period, shape (k,) [Hz], and the noise of torque there.

        The latter is the spectral covariance of one period's torque between joints, scaled so
        that white noise has its covariance at every frequency, shape (k, nv, nv), complex.
        """
        n = len(self.t)
        D = scipy.fft.rfft(self.tau - self.mean_tau, axis=1)
        S = np.einsum("pki,pkj->kij", D, D.conj()) / (n * (self.count - 1))
        return self.f, np.asarray(S)

    @cached_property
    def bandwidth_hz(self) -> Array:
        """Highest harmonic of each joint's motion that noise does not drown, shape (nv,) [Hz]."""
        n = len(self.t)
        power = np.abs(scipy.fft.rfft(self.mean_q, axis=0)) ** 2
        deviations = np.abs(scipy.fft.rfft(self.q - self.mean_q, axis=1)) ** 2
        noise = deviations.sum(axis=0) / (self.count * (self.count - 1))
        width = 2 * _NEIGHBOURS + 1
        around = scipy.ndimage.uniform_filter1d(noise, width, axis=0, mode="nearest")
        smallest = np.finfo(float).eps ** 2 * n * power.max(axis=0)
        return read_only(best_bandwidth(self.f, power, np.maximum(around, smallest)))

    @cached_property
    def dq_noise(self) -> Array:
        """Standard deviation of the velocity of the averaged motion, shape (nv,) [rad/s].

        That of a Fourier series fitted to positions with white noise.
        """
        n = len(self.t)
        f = self.f[:, None]
        passed = ((2 * np.pi * f) ** 2 * (f <= self.bandwidth_hz * (1 + 1e-9))).sum(axis=0)
        return read_only(np.sqrt(2 / n * passed * np.diag(self.q_noise) / self.count))

    def motion(self, which: int | None = None) -> Motion:
        """The averaged motion as a Fourier series, or that of one period, with exact derivatives.

        Each joint's series ends at its `bandwidth_hz`.
        """
        q = self.mean_q if which is None else self.q[which]
        n = len(self.t)
        X = scipy.fft.rfft(q, axis=0) * (self.f[:, None] <= self.bandwidth_hz * (1 + 1e-9))
        omega = 2j * np.pi * self.f[:, None]
        return Motion(self.t, *(scipy.fft.irfft(omega**k * X, n, axis=0) for k in range(3)))


def between_covariance(deviations: Array) -> Array:
    """Covariance of one sample from deviations from the mean period, (P, n, nv) → (nv, nv)."""
    P, n, nv = deviations.shape
    flat = deviations.reshape(-1, nv)
    return read_only(flat.T @ flat / ((P - 1) * n))


def periods_of(t: Array, q: Array, tau: Array, name: str, file: str = "") -> Periods:
    """Whole periods of a recording, found in its positions.

    The period is the shortest lag after which the motion comes back as well as after the best
    one, by an F-test; it is refined between samples so that all periods agree best. The motion
    repeats if periods differ much less than chance would have it for a motion as smooth as this
    one (F-test, all lags accounted for), and by less than `DIFFERENT`.

    Args:
        t: Regular time, shape (n,) [s].
        q: Positions, shape (n, nv).
        tau: Torque, shape (n, nv).
        name: Name of the recording.
        file: Its file, for messages.

    Raises:
        BadRecording: The motion does not repeat, or less than two periods were recorded.
    """
    search = _Search(t, np.asarray(q, float))
    best = search.best()
    if best is None or best.difference > DIFFERENT or search.chance(best) > _ALARM:
        raise BadRecording(file or name, f"'{name}' {_why(search, best)}")
    period = best.lag * search.step
    count, n = search.periods(best.lag), round(best.lag)
    if abs(best.lag - n) < 1e-9:
        parts = [values[: count * n] for values in (q, tau)]
    else:
        at = t[0] + period * np.arange(count * n) / n
        parts = [scipy.interpolate.make_interp_spline(t, v, k=5)(at) for v in (q, tau)]
    shape = (count, n, q.shape[1])
    return Periods(name, period, float(t[0]), *(part.reshape(shape) for part in parts))


def _why(search: _Search, best: _Lag | None) -> str:
    advice = "record two periods or more, or use another estimator"
    if best is None:
        half = len(search.x) * search.step / 2
        return f"does not repeat: no lag up to {half:.4g} s brings its motion back; {advice}"
    return (
        f"does not repeat: after {best.lag * search.step:.4g} s its motion comes back with "
        f"differences of {100 * best.difference:.2g} % of its standard deviation; {advice}"
    )


@dataclass(frozen=True)
class _Lag:
    """A lag [samples] and how well the motion comes back after it.

    Attributes:
        lag: Number of samples, not whole.
        difference: Root mean square difference between periods over √2, relative to the standard
            deviation of the motion.
        freedom: Number of independent differences behind it.
    """

    lag: float
    difference: float
    freedom: float


class _Search:
    """Positions of one recording, and how they differ from themselves a lag later."""

    def __init__(self, t: Array, q: Array) -> None:
        self.step = float(t[-1] - t[0]) / (len(t) - 1)
        self.x = q - q.mean(axis=0)
        self.variance = float((self.x**2).mean(axis=0).sum())
        self.spline = scipy.interpolate.make_interp_spline(np.arange(len(q)), self.x, k=5)

    def periods(self, lag: float) -> int:
        """Whole periods of a lag; the last sample may be the one before the next would begin."""
        return int((len(self.x) + 0.5) // lag)

    def best(self) -> _Lag | None:
        """The shortest lag that is as good as the best."""
        found = [lag for lag in map(self.refined, self.candidates()) if self.periods(lag.lag) > 1]
        if not found:
            return None
        least = min(found, key=lambda lag: lag.difference)
        good = [lag for lag in found if not self.worse(lag, least)]
        return self.snapped(min(good, key=lambda lag: lag.lag))

    def candidates(self) -> list[int]:
        """Whole lags where the difference has a low minimum, of two periods at least."""
        n = len(self.x)
        size = scipy.fft.next_fast_len(2 * n, True)
        X = scipy.fft.rfft(self.x, size, axis=0)
        correlation = scipy.fft.irfft((np.abs(X) ** 2).sum(axis=1), size)[:n]
        energy = np.concatenate([[0.0], np.cumsum((self.x**2).sum(axis=1))])
        lags = np.arange(1, min(n // 2 + 2, n))
        total = energy[n - lags] + energy[n] - energy[lags]
        D = (total - 2 * correlation[lags]) / ((n - lags) * 2 * max(self.variance, 1e-300))
        inner = (D[1:-1] < D[:-2]) & (D[1:-1] <= D[2:]) & (D[1:-1] < 4 * DIFFERENT)
        where = 1 + np.flatnonzero(inner)
        return sorted(int(lags[k]) for k in where[np.argsort(D[where])][:_CANDIDATES])

    def refined(self, lag: int) -> _Lag:
        """The best lag within a sample, all periods against all others."""
        solved = scipy.optimize.minimize_scalar(
            self._spread, bounds=(lag - 1.0, lag + 1.0), method="bounded", options={"xatol": 1e-6}
        )
        return self.judged(float(solved.x))

    def snapped(self, lag: _Lag) -> _Lag:
        """A whole number of samples where a likelihood ratio does not speak against it."""
        if self.periods(round(lag.lag)) < 2:
            return lag
        whole, floor = self.judged(float(round(lag.lag))), max(lag.difference, _ROUNDING)
        critical = scipy.stats.chi2.isf(_ALARM, 1)
        told = lag.freedom * ((whole.difference / floor) ** 2 - 1)
        return lag if told > critical else whole

    def judged(self, lag: float) -> _Lag:
        """A lag with what its periods differ by."""
        deviations = self._deviations(lag)
        P, n = deviations.shape[:2]
        variance = float((deviations**2).sum()) / ((P - 1) * n)
        moving = deviations.reshape(P * n, -1)
        tau = max(autocorrelation_time(column) for column in moving.T) if variance > 0 else 1.0
        return _Lag(lag, float(np.sqrt(variance / self.variance)), max((P - 1) * n / tau, 1.0))

    def worse(self, lag: _Lag, than: _Lag) -> bool:
        """Whether periods of one lag differ more than those of another."""
        critical = scipy.stats.f.isf(_SAME, lag.freedom, than.freedom)
        floor = max(than.difference, _ROUNDING)
        return bool(lag.difference**2 > critical * floor**2)

    def chance(self, lag: _Lag) -> float:
        """Chance of differences as small for a motion as smooth that does not repeat."""
        tau = min(autocorrelation_time(column) for column in self.x.T)
        independent = len(self.x) / tau
        freedom = max(independent * (1 - 1 / self.periods(lag.lag)), 1.0)
        ratio = max(lag.difference, 1e-12) ** 2
        return float(independent * scipy.stats.f.cdf(ratio, freedom, independent))

    def _spread(self, lag: float) -> float:
        return float((self._deviations(lag) ** 2).mean())

    def _deviations(self, lag: float) -> Array:
        """From the mean period, shape (P, n, nv)."""
        P, n = max(self.periods(lag), 2), int(lag)
        at = lag * np.arange(P)[:, None] + np.arange(n)
        values = self.spline(at)
        return np.asarray(values - values.mean(axis=0), float)
