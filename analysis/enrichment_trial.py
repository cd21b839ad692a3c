"""The rows of a standard identification, made ready to try further effects on."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from excitant.analysis.enrichment_candidates import further_effects
from excitant.analysis.enrichment_rows import Candidate, Trial
from excitant.analysis.evidence import Index
from excitant.analysis.evidence import JointColumns as Signatures
from excitant.analysis.evidence import joint_columns as signatures
from excitant.identify.accuracy import predicted_torque, series
from excitant.identify.estimate import Estimate
from excitant.identify.least_squares import autocorrelation_time
from excitant.identify.physical import EffectPrior, link_coordinates
from excitant.identify.preprocessing import Segment
from excitant.identify.regression import observation
from excitant.identify.rows import implausible_size
from excitant.robots.effects import Effect
from excitant.robots.motion import Array
from excitant.robots.robot import Robot

_FOLDS = 5  # parts of all recordings together
_BLOCK_S, _BLOCKS = 0.5, (20, 60)  # s, and how many, to see how much a gain varies
_INSTANTS = 3000  # at most, evenly taken
_GUARD = 4  # rows beside a part left out: a period of the cut-off


def trial_of(robot: Robot, standard: Estimate) -> Trial:
    """Rows of what was fitted, with candidates from what the standard model leaves.

    Args:
        robot: The arm as given.
        standard: Its standard identification; effects that rest on torque take it from there.
    """
    segments, model = standard.data.train, standard.model
    measured = series(segments).measured * standard.gains
    left = measured - predicted_torque(model, segments)
    stride = -(-len(measured) // _INSTANTS)
    rows = slice(None, None, stride)
    always = observation(model, model.effects, segments)[rows]
    prior = standard.prior.reshape(-1, 10)
    size = 10 * robot.nv
    tau = measured[rows] - always[:, :, :size] @ prior.ravel()
    always[:, :, :size] = always[:, :, :size] @ link_coordinates(prior)
    parts, candidates, at = [always], [], always.shape[2]
    for effect, trials in further_effects(model, segments, left):
        block = np.concatenate([s.rows(lambda m: effect.columns(model, m)) for s in segments])[rows]  # noqa: B023
        if block.any() and np.isfinite(block).all():
            own = tuple(robot.joint_index(joint) for joint in effect.joints)
            candidates.append(Candidate(effect, slice(at, at + block.shape[2]), own, trials))
            parts.append(block)
            at += block.shape[2]
    columns = signatures(parts, np.ones(tau.shape, bool))
    kept = [*model.effects, *(c.effect for c in candidates)]
    coefficients = _knowledge(robot, kept, parts, size, measured[rows])
    folds, blocks = _parts(segments, stride)
    inflation = np.array([autocorrelation_time(e) for e in left[rows].T])
    sigma2 = np.maximum((left[rows] ** 2).mean(axis=0), 1e-24)
    return Trial(
        robot, columns, tau, prior, always.shape[2], coefficients, tuple(candidates),
        folds, blocks, 1 / (sigma2 * inflation), inflation, _grams(columns, tau, folds),
    )  # fmt: skip


def _knowledge(
    robot: Robot, effects: Sequence[Effect], parts: Sequence[Array], links: int, tau: Array
) -> EffectPrior:
    """Nothing known of coefficients but their signs."""
    known = [p for e in effects for p in e.parameters(robot)]
    blocks = [parts[0][:, :, links:], *parts[1:]]
    std = np.concatenate([implausible_size(block, tau) for block in blocks])
    return EffectPrior(np.zeros_like(std), std, np.array([p.lower for p in known]))


def _parts(segments: Sequence[Segment], stride: int) -> tuple[Index, Index]:
    """Part and block of every row: contiguous, none over the border of a block.

    Whole recordings are parts where there are several; of many short pieces, some are one part.
    """
    counts = np.array([len(s.t) for s in segments])
    seconds = float(sum(s.t[-1] - s.t[0] for s in segments))
    count, total = int(np.clip(seconds / _BLOCK_S, *_BLOCKS)), counts.sum()
    own = [max(1 if len(counts) > 2 else 2, round(_FOLDS * n / total)) for n in counts]
    if sum(own) > _FOLDS + 1:
        each = np.arange(total) * count // total
        folds, blocks = each * _FOLDS // count, each
    else:
        first = np.cumsum([0, *own[:-1]])
        folds = np.concatenate(
            [k + _evenly(n, m) for k, n, m in zip(first, counts, own, strict=True)]
        )
        sizes = np.bincount(folds)
        inner = [_evenly(n, max(1, round(count * n / total))) for n in sizes]
        blocks = np.concatenate([1000 * k + part for k, part in enumerate(inner)])
    thinned = (np.unique(x[::stride], return_inverse=True)[1] for x in (folds, blocks))
    return next(thinned), next(thinned)


def _evenly(rows: int, parts: int) -> Index:
    """Part of each of some rows, as equal as can be, shape (rows,)."""
    return np.arange(rows) * parts // rows


def _grams(columns: Signatures, tau: Array, folds: Index) -> tuple[tuple[Array, ...], ...]:
    """Products of each joint's columns and torque over the rows outside each part."""
    found = []
    for k in range(int(folds.max()) + 1):
        others = _outside(folds, k)
        found.append(
            tuple(
                (Z := np.column_stack([X[others], tau[others, j]])).T @ Z
                for j, X in enumerate(columns.rows)
            )
        )
    return tuple(found)


def _outside(folds: Index, k: int) -> npt.NDArray[np.bool_]:
    """Rows that are not in a part, nor beside it."""
    inside = np.flatnonzero(folds == k)
    outside = np.ones(len(folds), bool)
    outside[max(0, inside[0] - _GUARD) : inside[-1] + 1 + _GUARD] = False
    return outside
