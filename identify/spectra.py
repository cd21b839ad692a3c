"""Signals by frequency: a zero-phase low-pass filter and the power spectral density."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
import numpy.typing as npt
import scipy

from excitant.robots.motion import Array

BUTTERWORTH_ORDER = 4  # of the filter, each way
_FORGOTTEN = 6.0  # periods of its cut-off, after which it has forgotten
_TOGETHER = 60_000  # values filtered together: they fit into the processor's cache
_FEW = 16  # rows in which most columns show that they are not zero


def low_pass(
    values: Array, cutoff_hz: float, rate_hz: float, kept: slice = slice(None)
) -> Array:
    """Columns, shape (n, ...), through a Butterworth filter forward and backward along time.

    Beyond its ends a signal goes on as its mirror image in the point there (Gustafsson 1996), until
    the filter has forgotten; its line from end to end passes as it is. Only some rows are ``kept``.
    """
    flat = np.reshape(values, (len(values), math.prod(np.shape(values)[1:])))
    passed = np.zeros((len(flat[kept]), flat.shape[1]))
    acting = np.flatnonzero(live(flat))
    count = -(-acting.size * len(flat) // _TOGETHER)
    for some in np.array_split(acting, count) if count else ():
        passed[:, some] = _low_passed(flat[:, some], cutoff_hz, rate_hz, kept).T
    return passed.reshape(len(passed), *np.shape(values)[1:])


def _low_passed(values: Array, cutoff_hz: float, rate_hz: float, kept: slice) -> Array:
    """Columns, shape (n, k), as rows, filtered, at some instants."""
    n = len(values)
    before = min(n - 1, int(_FORGOTTEN * rate_hz / cutoff_hz))
    size = scipy.fft.next_fast_len(n + 2 * before, real=True)
    after = min(n - 1, size - n - before)
    size = before + n + after
    inner = slice(before, before + n)
    x = np.empty((values.shape[1], size))
    x[:, inner] = values.T
    x[:, :before] = 2 * x[:, before, None] - x[:, 2 * before : before : -1]
    end = before + n - 1
    x[:, end + 1 :] = 2 * x[:, end, None] - x[:, end - 1 : end - 1 - after : -1]
    first = x[:, :1].copy()
    slope = (x[:, -1:] - x[:, :1]) / max(size - 1, 1)
    along = np.arange(size)
    x -= first + slope * along  # a constant passes without rounding
    spectrum = scipy.fft.rfft(x, overwrite_x=True)
    spectrum *= _gain(size, cutoff_hz / rate_hz)
    passed = scipy.fft.irfft(spectrum, size, overwrite_x=True)[:, inner][:, kept]
    return np.asarray(passed + first + slope * along[inner][kept], float)


@lru_cache(maxsize=64)
def _gain(size: int, cutoff: float) -> Array:
    """1 / (1 + (f / f_c)⁸) at the frequencies of so many samples; one half at f_c.

    That of the analogue filter, so that it is the same at every sampling rate.
    """
    ratio = np.arange(size // 2 + 1) / (size * cutoff)
    return np.asarray(1 / (1 + ratio ** (2 * BUTTERWORTH_ORDER)), float)


def live(values: Array) -> npt.NDArray[np.bool_]:
    """Which columns, shape (n, ...), are not zero throughout: most show it in a few rows."""
    found = np.asarray(values[:: max(1, len(values) // _FEW)].any(axis=0), bool)
    if not found.all():
        found[~found] = np.ones(len(values)) @ np.abs(values[:, ~found]) != 0
    return found


def detrended(values: Array) -> Array:
    """Columns, shape (n, ...), less the straight line through each that leaves least."""
    along = np.linspace(-1.0, 1.0, len(values))
    centred = values - values.mean(axis=0)
    slope = np.tensordot(along, centred, 1) / (along @ along)
    return np.asarray(centred - np.multiply.outer(along, slope), float)


def power_density(values: Array, rate_hz: float, longest: int) -> tuple[Array, Array]:
    """Frequencies (m,) [Hz] and one-sided power density (m, ...) of columns, shape (n, ...).

    Mean over parts of at most so many samples that overlap by half, each less its own mean and
    under a Hann window (Welch 1967).
    """
    size = min(longest, len(values))
    parts = np.lib.stride_tricks.sliding_window_view(values, size, axis=0)[
        :: size - size // 2
    ]
    window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(size) / size)
    windowed = window * (parts - parts.mean(axis=-1, keepdims=True))
    power = (np.abs(np.fft.rfft(windowed, axis=-1)) ** 2).mean(axis=0)
    power /= rate_hz * (window**2).sum()
    power[..., 1 : (size + 1) // 2] *= (
        2  # negative frequencies; neither 0 nor the Nyquist one
    )
    f = np.asarray(np.fft.rfftfreq(size, 1 / rate_hz), float)
    return f, np.moveaxis(power, -1, 0)
