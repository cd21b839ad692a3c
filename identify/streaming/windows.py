"""Windows: a log as overlapping segments whose own rows are those of the whole log.

A part of the log without interruption lies on one grid of instants. A window takes so many
samples beyond its own rows on either side that neither the spline, nor the filter of positions,
nor that of torque knows that the log goes on (their impulse responses are below `RESPONSE` of
their sum there); where the part itself begins or ends, so does the window, and its edge is that
of the part.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from excitant.identify.preprocessing import (
    POSITION_RATIO,
    Segment,
    at_instants,
    longest_step,
    prepare,
)
from excitant.identify.recording import MINIMUM_DURATION, Recording
from excitant.identify.streaming.derivative import InnerButterworth
from excitant.robots.motion import Array, Motion

RESPONSE = 1e-9  # of an impulse response's sum: what is left out of it
_SAMPLES = 20  # a part needs more
_FAR_FROM_NYQUIST = 0.25  # of the rate: positions have the cut-off that is meant for them
_NEIGHBOURS = 8  # samples beyond a window that its spline goes through, where time is irregular
_EARLY = 1e-3  # of a step: a sample that may be early


@dataclass(frozen=True)
class Span:
    """A stretch of time of a log that is fitted or held out.

    Attributes:
        low: Its first instant [s].
        high: Its end, which belongs to the next span [s].
        step: Its sampling period [s].
        held: Whether it is held out.
    """

    low: float
    high: float
    step: float
    held: bool


@dataclass(frozen=True, eq=False)
class Window:
    """A piece of a span without interruption.

    Attributes:
        segment: Motion and torque, its ``keep`` the window's own rows.
        first: Whether the part of the log begins with it.
        last: Whether the part of the log ends with it.
        span: Where it lies.
    """

    segment: Segment
    first: bool
    last: bool
    span: Span


@dataclass(frozen=True, eq=False)
class _Samples:
    """Consecutive samples of one span, and whether they follow on those before."""

    span: Span
    t: Array
    q: Array
    tau: Array
    follows: bool


def windows(
    pieces: Iterable[Recording],
    spans: Sequence[Span],
    cutoff_hz: float,
    reach: float,
    own: int,
    advance: Callable[[int], None] = lambda rows: None,
) -> Iterator[Window]:
    """Windows of a log, in order.

    Args:
        pieces: The log, piece by piece.
        spans: What is fitted and what is held out, in order.
        cutoff_hz: Cut-off of the torque filter [Hz].
        reach: Samples' time that a window needs beyond its own rows [s].
        own: Number of instants that a window adds to those before.
        advance: Told how many samples have been read.
    """
    part: _Part | None = None
    count = 0
    for piece in pieces:
        for samples in _without_gaps(piece, spans, part.end if part else None):
            if not samples.follows or part is None:
                if part is not None:
                    yield from part.windows(final=True)
                part = _Part(samples.span, cutoff_hz, reach, own, piece)
            part.take(samples)
            yield from part.windows()
        count += len(piece.t)
        advance(count)
    if part is not None:
        yield from part.windows(final=True)


def _without_gaps(piece: Recording, spans: Sequence[Span], end: float | None) -> Iterator[_Samples]:
    """Samples of a piece, cut where a span ends or time jumps."""
    for span in spans:
        low, high = np.searchsorted(piece.t, [span.low, span.high])
        t = piece.t[low:high]
        if not len(t):
            continue
        before = -np.inf if end is None or end < span.low else end
        starts = np.flatnonzero(np.diff(t, prepend=before) > longest_step(span.step))
        for a, b in pairwise(np.union1d(starts, [0, len(t)])):
            rows = slice(low + a, low + b)
            yield _Samples(span, t[a:b], piece.q[rows], piece.tau[rows], a not in starts)


class _Part:
    """A part of a log without interruption, of which the last samples are held."""

    def __init__(
        self, span: Span, cutoff_hz: float, reach: float, own: int, like: Recording
    ) -> None:
        self._span, self._cutoff, self._like = span, cutoff_hz, like
        self._reach = max(int(np.ceil(max(reach, MINIMUM_DURATION) / span.step)), _SAMPLES + 1)
        self._own = max(own, 2 * self._reach)
        self._held: list[_Samples] = []
        self._done = 0  # instants before this one have become rows
        self._keep: tuple[int, int] | None = None  # edge and stride
        self.end = -np.inf

    def take(self, samples: _Samples) -> None:
        if not self._held:
            self._start = float(samples.t[0])
        self._held.append(samples)
        self.end = float(samples.t[-1])

    def windows(self, final: bool = False) -> Iterator[Window]:
        """The window that the samples are enough for, and when the part ends, the last one."""
        n = int((self.end - self._start + 1e-9) / self._span.step) + 1
        while n - self._done >= self._own + self._reach:
            stop = self._done + self._own
            yield self._window(stop + self._reach, stop)
            self._drop(stop)
        if final and self._long_enough():
            yield self._window(n, n)

    def _long_enough(self) -> bool:
        if self._done:
            return True
        samples = sum(len(s.t) for s in self._held)
        return samples > _SAMPLES and self.end - self._start >= MINIMUM_DURATION

    def _window(self, end: int, stop: int) -> Window:
        """Instants up to ``end``, of which those from the last stop to ``stop`` are its own."""
        first, last = max(0, self._done - self._reach), stop == end
        segment = self._prepared(first, end, last)
        edge, stride = self._keep or (segment.keep.start, segment.keep.step)
        self._keep = edge, stride
        begin = edge + stride * max(0, -(-(self._done - edge) // stride))
        limit = stop - edge if last else stop
        keep = slice(begin - first, max(limit, begin) - first, stride)
        self._done = stop
        return Window(replace(segment, keep=keep), first == 0, last, self._span)

    def _prepared(self, first: int, end: int, last: bool) -> Segment:
        """The segment of instants, with samples beyond them only where they are the last."""
        t, q, tau = (np.concatenate([getattr(s, k) for s in self._held]) for k in ("t", "q", "tau"))
        step = self._span.step
        local, origin = step * np.arange(float(end - first)), self._start + first * step
        begin, stop = np.searchsorted(t, origin + step * np.array([-_EARLY, end - first - 0.5]))
        more = 0 if stop - begin == len(local) else _NEIGHBOURS
        near = slice(max(begin - more, 0), None if last else stop + more)
        q, tau = at_instants(t[near] - origin, q[near], tau[near], local)
        regular = replace(self._like, t=local, q=q, tau=tau, dq=None)
        position_hz = POSITION_RATIO * self._cutoff
        inner = first > 0 and not last and position_hz * step < _FAR_FROM_NYQUIST
        [segment] = prepare(regular, self._cutoff, InnerButterworth(position_hz) if inner else None)
        m = segment.motion
        return replace(segment, motion=Motion(origin + m.t, m.q, m.dq, m.ddq))

    def _drop(self, stop: int) -> None:
        """Forget samples that no later window needs."""
        needed = self._start + (stop - 2 * self._reach) * self._span.step
        while len(self._held) > 1 and self._held[1].t[0] < needed:
            del self._held[0]
