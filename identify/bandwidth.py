"""How fast a recorded motion is: up to which frequency its acceleration rises above the noise."""

from __future__ import annotations

import numpy as np
import scipy.signal

from excitant.robots.motion import Array

_CAUTION = 2.0
_FLOOR = (0.5, 0.9)  # of half the rate: where positions show nothing but the noise of encoders


def best_bandwidth(f: Array, power: Array, noise: Array) -> Array:
    """Frequency up to which passing positions makes the best acceleration, shape (nv,) [Hz].

    Passing all up to f_b loses the signal above and keeps the noise below it. The expected squared
    error of acceleration, Σ_{f > f_b} (2πf)⁴ (P − N) + Σ_{f ≤ f_b} (2πf)⁴ N, is smallest where
    Σ_{f ≤ f_b} f⁴ (2N − P) is. Noise counts twice as much here, lest the largest of many
    frequencies without motion pass for motion.

    Args:
        f: Frequencies, rising, shape (k,) [Hz].
        power: Power P of the measured positions at these, shape (k, nv).
        noise: Power N of their noise in the same unit, broadcast to (k, nv).
    """
    cost = np.cumsum(f[:, None] ** 4 * (2 * _CAUTION * noise - power), axis=0)
    return np.asarray(f[np.argmin(cost, axis=0)], float)


def motion_bandwidth(q: Array, rate_hz: float) -> Array:
    """`best_bandwidth` of positions at a regular rate, shape (n, nv), per joint [Hz].

    The spectrum is that of a window that falls off at both ends, so that a motion that does not
    end where it began does not pass for a fast one. White noise of encoders is taken from the
    upper part of the spectrum, its median there being ln 2 of its mean.
    """
    n = len(q)
    window = scipy.signal.windows.blackmanharris(n)[:, None]
    spectrum = np.fft.rfft(window * scipy.signal.detrend(q, axis=0), axis=0)
    f = np.asarray(np.fft.rfftfreq(n, 1 / rate_hz), float)
    power = np.abs(spectrum) ** 2
    upper = (f >= _FLOOR[0] * rate_hz / 2) & (f <= _FLOOR[1] * rate_hz / 2)
    noise = np.median(power[upper], axis=0) / np.log(2)
    return best_bandwidth(f, power, noise)
