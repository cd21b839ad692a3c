"""Logs too long to hold: low-passed and decimated while they are read, piece by piece.

Torque is judged up to 10 Hz and positions are filtered at twice that
(`excitant.identify.preprocessing`), so 160 samples a second say all that identification uses. A
linear-phase filter passes what lies below 20 Hz and takes away what decimation would fold onto it.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import scipy

from excitant.exceptions import BadRecording
from excitant.identify.preprocessing import (
    CUTOFF_HZ,
    POSITION_RATIO,
    at_instants,
    uninterrupted,
)
from excitant.identify.recording import Recording
from excitant.robots.motion import Array

LONG = 1_000_000
"""Samples of recordings together from which they are read in pieces and decimated."""

_PASSED_HZ = POSITION_RATIO * CUTOFF_HZ
_RATE_HZ = 8 * _PASSED_HZ
_STOPPED_DB = 80.0  # what is folded onto the band that is passed
_LINES = 1000  # of a text file, whose length stands for all
_TEXT = (".csv", ".txt", ".tsv")


def too_long(paths: Iterable[str | Path]) -> bool:
    """Whether logs are read in pieces; bags and arrays, not counted unread, never are."""
    return sum(_samples(Path(path)) for path in paths) > LONG


def _samples(path: Path) -> int:
    """Number of samples of a Parquet file, about that of a text file, else 0; 0 if unreadable."""
    suffix = path.suffix.lower()
    try:
        if suffix in (".parquet", ".pq"):
            with pa.parquet.ParquetFile(path) as file:
                return int(file.metadata.num_rows)
        if suffix in _TEXT:
            with path.open("rb") as file:
                lines = list(itertools.islice(file, 1, _LINES))
            return int(path.stat().st_size * len(lines) / max(sum(map(len, lines)), 1))
    except (OSError, pa.ArrowException):
        pass  # said where it is read
    return 0


def decimated(pieces: Iterable[Recording]) -> Recording:
    """One recording of consecutive pieces, decimated to 160 Hz or a little above.

    Time keeps its gaps; at both ends of an uninterrupted part half the filter's length is lost.
    A log whose rate is below twice that is only put together.

    Raises:
        BadRecording: No uninterrupted part is longer than the filter.
    """
    samples, count, rest = np.empty((0, 0)), 0, tuple[Array, ...]()
    for piece in pieces:
        now: tuple[Array, ...] = (piece.t, piece.q, piece.tau)
        if not rest:
            first, passed = piece, _Filter(float(np.median(np.diff(piece.t))))
        else:
            now = tuple(np.concatenate(pair) for pair in zip(rest, now, strict=True))
        for part in uninterrupted(now[0]):
            found, used = passed(*(values[part] for values in now))
            if count + len(found) > len(samples):
                # one array that doubles: many small ones between large ones waste memory
                grown = np.empty((2 * (count + len(found)), found.shape[1]))
                if count:
                    grown[:count] = samples[:count]
                samples = grown
            if len(found):
                samples[count : count + len(found)] = found
                count += len(found)
            rest = tuple(values[part][used:] for values in now)
    if not count:
        raise BadRecording(first.file, "no uninterrupted part is long enough", column="t")
    t, nv = samples[:count, 0], first.q.shape[1]
    note = f"read in pieces, low-passed and decimated to {passed.rate_hz:.4g} Hz, for it is long"
    return replace(
        first,
        t=t,
        q=samples[:count, 1 : nv + 1],
        tau=samples[:count, nv + 1 :],
        dq=None,
        notes=(*first.notes, note),
    )


class _Filter:
    """Low-pass and decimation of samples at about one rate; keeps its grid from call to call.

    Args:
        step: Sampling period [s].
    """

    def __init__(self, step: float) -> None:
        self.step, self.factor = step, max(1, int(1 / (step * _RATE_HZ)))
        stop = 1 / (self.factor * step) - _PASSED_HZ
        width = (stop - _PASSED_HZ) * 2 * step
        taps, beta = scipy.signal.kaiserord(_STOPPED_DB, min(max(width, 1e-3), 0.99))
        self.half = -(-taps // 2) if self.factor > 1 else 0
        cutoff = (stop + _PASSED_HZ) / 2
        self.h = (
            scipy.signal.firwin(2 * self.half + 1, cutoff, window=("kaiser", beta), fs=1 / step)
            if self.half
            else np.ones(1)
        )
        self.next: float | None = None  # when the next sample is due [s]

    @property
    def rate_hz(self) -> float:
        """Rate of what comes out [Hz]."""
        return 1 / (self.factor * self.step)

    def __call__(self, t: Array, q: Array, tau: Array) -> tuple[Array, int]:
        """Samples [t, q, τ] that these determine, and how many of these are used up."""
        reach, every = self.half * self.step, self.factor * self.step
        if self.next is None or not t[0] - self.step < self.next - reach < t[-1]:
            self.next = float(t[0]) + reach
        count = int((t[-1] - reach - self.next) / every + 1 + 1e-6)
        if len(t) < 4 or count < 1:
            return np.empty((0, 1 + 2 * q.shape[1])), 0
        n = (count - 1) * self.factor + 2 * self.half + 1
        grid = self.next - reach + self.step * np.arange(n)
        values = np.hstack(at_instants(t, q, tau, np.clip(grid, t[0], t[-1])))
        values = scipy.signal.oaconvolve(values, self.h[:, None], mode="valid", axes=0)
        times = self.next + every * np.arange(count)
        self.next = float(times[-1] + every)
        used = int(np.searchsorted(t, self.next - reach - 3 * self.step))
        return np.column_stack([times, values[:: self.factor]]), used
