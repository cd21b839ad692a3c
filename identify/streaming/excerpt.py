"""Excerpts: the beginning of what is fitted and of what is held out, for figures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from excitant.identify.accuracy import Series, series
from excitant.identify.preprocessing import Segment
from excitant.identify.streaming.columns import GIVEN, Layout
from excitant.identify.streaming.condensed import Condensed, condensed
from excitant.identify.streaming.windows import Window
from excitant.robots.motion import Array, read_only

_INSTANTS = 30_000  # of a segment that is kept, or four responses of the filter
_ROWS = 20_000  # for drive gains


class Excerpt:
    """The beginning of what is fitted, or of what is held out.

    Attributes:
        segments: The first segment, cut after some time; empty before there is one.
    """

    def __init__(self, layout: Layout) -> None:
        self._layout = layout
        self.segments: tuple[Segment, ...] = ()
        self._shown = 0
        self._rows: list[list[Array]] = []

    def take(self, window: Window, rows: Sequence[Array], half: int) -> None:
        """Keep rows of a window while there is room.

        Args:
            window: The window.
            rows: Its rows, columns as in `window_rows`.
            half: Instants that the torque filter reaches to either side.
        """
        if not len(rows[0]):
            return
        if not self.segments:
            segment = _beginning(window.segment, max(_INSTANTS, 4 * half), half)
            self.segments, self._shown = (segment,), len(segment.t)
        room = _ROWS - sum(len(kept[0]) for kept in self._rows)
        if room > 0:
            self._rows.append([read_only(each[:room]) for each in rows])

    def series(self) -> Series:
        """Time and torque at the rows of the segment."""
        return series(self.segments)

    def predicted(self, beta: Array, own: float = 0.0) -> Array:
        """Torque there by base parameters, shape (r,), and ``own`` times the given effects'."""
        torques = []
        for j, used in enumerate(self._layout.used):
            rows = self._joint(j)[: self._shown]
            torques.append(rows[:, : len(used)] @ beta[used] + own * rows[:, GIVEN])
        return np.column_stack(torques)

    def _joint(self, j: int) -> Array:
        return np.concatenate([kept[j] for kept in self._rows])

    def observation(self) -> Condensed:
        """More rows, with columns of all base parameters."""
        rows = [self._joint(j) for j in range(len(self._layout.used))]
        return condensed(self._layout, rows, len(rows[0]))


def _beginning(segment: Segment, instants: int, half: int) -> Segment:
    """The first instants of a segment; rows whose filter reaches beyond them are left out."""
    if instants >= len(segment.motion):
        return segment
    keep = slice(segment.keep.start, min(segment.keep.stop, instants - half), segment.keep.step)
    return replace(
        segment,
        motion=segment.motion[:instants],
        tau=segment.tau[:instants],
        tau_raw=segment.tau_raw[:instants],
        keep=keep,
    )
