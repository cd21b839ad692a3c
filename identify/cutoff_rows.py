"""Rows of every joint at any cut-off, from columns that are evaluated once.

Columns and torque are thinned to a few times the highest cut-off, filtered joint by joint as asked
for, and kept as Gram matrices of blocks of time: a fit to some blocks and its errors on the
others then cost no more than their sums, whatever the length of the recordings.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
import scipy.linalg

from excitant.identify.differentiators import low_pass
from excitant.identify.least_squares import SMALLEST
from excitant.identify.preprocessing import Segment, unclear
from excitant.robots.base_parameters import BaseParameters
from excitant.robots.effects import Effect
from excitant.robots.motion import Array
from excitant.robots.robot import Robot
from excitant.robots.torque import observation_columns

_BLOCKS = 10  # of all recordings together, as equal as segments allow
_SHORTEST = 8  # rows of a block
_THINNED = 8.0  # instants per period of the highest cut-off
_ROWS = 4.0  # rows per period of the cut-off of judging
_ANTI_ALIAS = 0.4  # of the thinned rate
_ROUNDS = 4  # of re-estimating the noise, as in weighted least squares
_MEMORY = 0.25  # periods of a cut-off that its filter remembers to either side
_RIDGE = 1e-11  # of the largest eigenvalue of columns of unit length

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Part:
    """One segment at a thinned rate.

    Attributes:
        rate_hz: Its rate [Hz].
        columns: Base columns of each joint that are not silent, and last its torque; unfiltered,
            nv arrays of shape (n, u + 1).
        used: Which base columns those are, nv arrays of shape (u,).
        slow: Whether noise decides the sign of each joint's velocity, shape (n, nv).
        blocks: Instants that are rows, block by block.
    """

    rate_hz: float
    columns: tuple[Array, ...]
    used: tuple[npt.NDArray[np.intp], ...]
    slow: Mask
    blocks: tuple[npt.NDArray[np.intp], ...]

    def unclear(self, joint: int, cutoff_hz: float) -> Mask:
        """Rows of a joint, filtered, whose sign of velocity is noise, shape (n,)."""
        return unclear(self.slow[:, [joint]], np.array([cutoff_hz]), self.rate_hz)[:, 0]


@dataclass(frozen=True, eq=False)
class Bank:
    """All segments; Gram matrices are made when first asked for.

    Attributes:
        parts: Segments.
        size: Number r of base parameters.
        judge_hz: Cut-off at which errors are judged [Hz].
        highest_hz: Highest cut-off that the rows are made for [Hz].
    """

    parts: tuple[Part, ...]
    size: int
    judge_hz: float
    highest_hz: float
    _made: dict[tuple[int, float, bool], Array] = field(default_factory=dict, repr=False)

    @property
    def nv(self) -> int:
        """Number of joints."""
        return len(self.parts[0].columns)

    @property
    def counts(self) -> Array:
        """Rows of each block, shape (blocks,)."""
        return np.array([len(b) for part in self.parts for b in part.blocks], float)

    def grams(self, joint: int, cutoff_hz: float, moving: bool = False) -> Array:
        """[W τ]ᵀ[W τ] of a joint's rows at a cut-off, shape (blocks, r + 1, r + 1).

        Args:
            joint: Index of the joint.
            cutoff_hz: Cut-off of the filter [Hz].
            moving: Leave rows out whose sign of velocity is noise.
        """
        key = (joint, round(float(cutoff_hz), 9), moving)
        if key not in self._made:
            blocks = [g for part in self.parts for g in self._grams(part, joint, cutoff_hz, moving)]
            self._made[key] = np.array(blocks)
        return self._made[key]

    def _grams(self, part: Part, joint: int, cutoff_hz: float, moving: bool) -> list[Array]:
        X = low_pass(part.columns[joint], cutoff_hz, part.rate_hz)
        place = np.append(part.used[joint], self.size)
        counts = ~part.unclear(joint, cutoff_hz) if moving else None
        found = []
        for block in part.blocks:
            rows = X[block] if counts is None else X[block[counts[block]]]
            gram = np.zeros((self.size + 1, self.size + 1))
            gram[np.ix_(place, place)] = rows.T @ rows
            found.append(gram)
        return found

    def left_out(self, joint: int, cutoff_hz: float) -> float:
        """Share of a joint's rows whose sign of velocity is noise."""
        out = [
            part.unclear(joint, cutoff_hz)[block].sum()
            for part in self.parts
            for block in part.blocks
        ]
        return float(np.sum(out) / self.counts.sum())

    def judged(self) -> Array:
        """Gram matrices at the cut-off of judging, shape (nv, blocks, r + 1, r + 1)."""
        return np.array([self.grams(j, self.judge_hz) for j in range(self.nv)])


def bank(
    robot: Robot,
    effects: Sequence[Effect],
    base: BaseParameters,
    segments: Sequence[Segment],
    gains: Array,
    *,
    judge_hz: float,
    lowest_hz: float,
    highest_hz: float,
    slowest: Array,
) -> Bank:
    """Rows of segments at cut-offs between two limits.

    Args:
        robot: The arm.
        effects: Effects that are estimated.
        base: Base parameters of links and effects.
        segments: What is fitted, prepared for a cut-off of at least the highest.
        gains: Torque per reading, shape (nv,).
        judge_hz: Cut-off at which errors are judged [Hz].
        lowest_hz: Lowest cut-off that will be asked for [Hz]; sets what lies between blocks.
        highest_hz: Highest one [Hz].
        slowest: Speed of each joint below which its sign is not known, shape (nv,) [rad/s].
    """
    duration = sum(len(s.motion) / s.rate_hz for s in segments)
    parts = []
    for segment in segments:
        stride = max(1, int(segment.rate_hz / (_THINNED * highest_hz)))
        rate, tau = segment.rate_hz / stride, segment.tau_raw
        if stride > 1:
            tau = low_pass(tau, _ANTI_ALIAS * rate, segment.rate_hz)
        motion = segment.motion[::stride]
        W = observation_columns(robot, effects, motion)[:, :, list(base.columns)]
        used = tuple(np.flatnonzero((W[:, j] != 0).any(axis=0)) for j in range(robot.nv))
        torque = tau[::stride] * gains
        columns = tuple(np.column_stack([W[:, j, u], torque[:, j]]) for j, u in enumerate(used))
        share = len(segment.motion) / segment.rate_hz / duration
        blocks = _blocks(len(motion), rate, judge_hz, lowest_hz, share)
        parts.append(Part(rate, columns, used, np.abs(motion.dq) <= slowest, blocks))
    return Bank(tuple(parts), len(base), judge_hz, highest_hz)


def _blocks(
    n: int, rate_hz: float, judge_hz: float, lowest_hz: float, share: float
) -> tuple[npt.NDArray[np.intp], ...]:
    """Rows of consecutive blocks; between them the slowest filter's memory is left out.

    At the ends of a segment, edges are those of the rows that are judged: columns and torque
    pass the same filter there too.
    """
    edge = min(round(rate_hz / judge_hz), n // 4)
    rows = np.arange(edge, n - edge, max(1, int(rate_hz / (_ROWS * judge_hz))))
    count = max(1, min(round(_BLOCKS * share), len(rows) // _SHORTEST))
    parts = np.array_split(rows, count)
    gap = _MEMORY * rate_hz / lowest_hz / max(1, int(rate_hz / (_ROWS * judge_hz)))
    cut = min(round(gap), len(parts[-1]) // 4)
    return tuple(
        part[cut if k else 0 : len(part) - (cut if k < count - 1 else 0)]
        for k, part in enumerate(parts)
    )


def weighted_fit(grams: Array, rows: float) -> Array:
    """Base parameters of weighted least squares, the noise of joints estimated along the way.

    Args:
        grams: Gram matrix of each joint's rows and torque, shape (nv, r + 1, r + 1).
        rows: Number of rows of each joint.
    """
    r = grams.shape[1] - 1
    power = grams[:, r, r] / rows
    freedom = rows * len(grams) / max(rows * len(grams) - r, 1.0)
    beta = np.zeros(r)
    for _ in range(_ROUNDS):
        total = np.tensordot(1 / np.maximum(power, SMALLEST**2), grams, 1)
        norms = np.sqrt(np.maximum(np.diag(total)[:r], SMALLEST))
        A = total[:r, :r] / np.outer(norms, norms) + _RIDGE * r * np.eye(r)
        beta = scipy.linalg.cho_solve(scipy.linalg.cho_factor(A), total[:r, r] / norms) / norms
        power = squared_errors(grams, beta) / rows * freedom
    return np.asarray(beta, float)


def squared_errors(grams: Array, beta: Array) -> Array:
    """Σ (W β − τ)² from Gram matrices, shape (..., r + 1, r + 1) → (...)."""
    v = np.append(beta, -1.0)
    return np.asarray(np.maximum(np.einsum("...rs,r,s->...", grams, v, v, optimize=True), 0), float)
