"""Rows to try effects on: contiguous parts of the training data, each predicted by the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt
import scipy.linalg

from excitant.analysis.proposals import proposals
from excitant.analysis.signatures import Index, Signatures, signatures
from excitant.identify.accuracy import predicted_torque, series
from excitant.identify.estimate import Estimate
from excitant.identify.least_squares import autocorrelation_time
from excitant.identify.physical import (
    PRIOR_SIGMA,
    EffectPrior,
    fit_physical,
    link_coordinates,
    link_weights,
)
from excitant.identify.preprocessing import Segment
from excitant.identify.rows import implausible_size, observation
from excitant.robots.effects import (
    AsymmetricFriction,
    Backlash,
    Effect,
    FrictionCoupling,
    InertiaCoupling,
    JointElasticity,
    LoadDependentFriction,
    NonlinearViscousFriction,
    PreslidingHysteresis,
    Spring,
    StribeckFriction,
    ThermalFrictionDrift,
    TimeDelay,
    TorqueRipple,
)
from excitant.robots.motion import Array
from excitant.robots.robot import Robot

KINDS = (
    StribeckFriction,
    NonlinearViscousFriction,
    LoadDependentFriction,
    AsymmetricFriction,
    PreslidingHysteresis,
    ThermalFrictionDrift,
    FrictionCoupling,
    InertiaCoupling,
    TorqueRipple,
    Spring,
    TimeDelay,
    JointElasticity,
    Backlash,
)
"""What a model may get beyond the standard one; the rest is in the bodies' own parameters."""

SHARED = (
    StribeckFriction,
    NonlinearViscousFriction,
    LoadDependentFriction,
    PreslidingHysteresis,
)
"""What is also tried at all joints at once."""

_FOLDS = 5  # parts of all recordings together
_BLOCK_S, _BLOCKS = 0.5, (20, 60)  # s, and how many, to see how much a gain varies
_INSTANTS = 3000  # at most, evenly taken
_GUARD = 4  # rows beside a part left out: a period of the cut-off
_NEAR_TRIAL = (0.3, 2.5)  # of a trial delay or gap, for which its column is right
_BEYOND = 0.5  # of several coefficients may be such as the consistent fit then sets to zero
_LARGEST = 2.0  # of the typical size of a coefficient that has one
_RIDGE = 1e-10


@dataclass(frozen=True, eq=False)
class Candidate:
    """An effect to try.

    Attributes:
        effect: The effect, its shape fixed.
        columns: Where its columns are.
        joints: Indices of the joints whose torque it changes.
        trials: Number of shapes that it is the best of, on all rows.
    """

    effect: Effect
    columns: slice
    joints: tuple[int, ...]
    trials: int = 1

    @property
    def key(self) -> tuple[str, tuple[str, ...]]:
        """Effect and joints: candidates that differ in shape only share it."""
        return self.effect.name, self.effect.joints


@dataclass(frozen=True, eq=False)
class Errors:
    """Squared errors on parts left out.

    Attributes:
        blocks: Sum over the rows of each block of time, shape (blocks, nv) [(N·m)²].
        rows: Number of rows of all blocks.
    """

    blocks: Array
    rows: int

    @property
    def joints(self) -> Array:
        """Mean squared error of each joint, shape (nv,) [(N·m)²]."""
        return np.asarray(self.blocks.sum(axis=0) / self.rows, float)


@dataclass(frozen=True, eq=False)
class Trial:
    """Training rows with the columns of everything that may be in a model.

    Attributes:
        robot: The arm as given.
        columns: Standard parameters, standard effects, candidates.
        tau: Torque, shape (n, nv) [N·m].
        prior: Standard parameters of the prior, shape (nv, 10).
        always: Number of leading columns that every model has.
        coefficients: Prior of the coefficients of effects, those of candidates included.
        typical: Size beyond which a coefficient is no longer what its effect says, shape (e,).
        candidates: What may be added.
        folds: Part of each row, shape (n,).
        blocks: Block of each row, shape (n,).
        weight: Of each joint's rows, shape (nv,).
        inflation: Rows of each joint that count as one, shape (nv,).
        grams: Per part, products of each joint's columns and torque on the other parts' rows.
    """

    robot: Robot
    columns: Signatures
    tau: Array
    prior: Array
    always: int
    coefficients: EffectPrior
    typical: Array
    candidates: tuple[Candidate, ...]
    folds: Index
    blocks: Index
    weight: Array
    inflation: Array
    grams: tuple[tuple[Array, ...], ...]

    def weighed(self, errors: Errors) -> Trial:
        """The same with joints weighted by the error that they are predicted with."""
        sigma2 = np.maximum(errors.joints, 1e-24)
        return replace(self, weight=1 / (sigma2 * self.inflation))

    def fall(self, candidate: Candidate, before: Errors, after: Errors) -> tuple[float, float]:
        """Fall of the squared errors of the joints that a candidate acts on, relative to theirs.

        Returns:
            The mean over these joints, and its standard error from the spread between blocks.
            Minus one and zero where the errors of all joints together rise, or those of these
            joints in more than one part.
        """
        size = np.maximum(before.joints, 1e-24)
        falls = (before.blocks - after.blocks) / (before.rows * size)
        own = falls[:, candidate.joints].mean(axis=1)
        parts = np.bincount(self._fold_of_block, own)
        if falls.sum() <= 0 or (parts <= 0).sum() > 1:
            return -1.0, 0.0
        return float(own.sum()), float(np.sqrt(len(own)) * own.std(ddof=1))

    def relative(self, errors: Errors, scale: Errors) -> float:
        """Mean over joints of squared errors relative to others."""
        return float((errors.joints / np.maximum(scale.joints, 1e-24)).mean())

    def ranked(self, chosen: Sequence[Candidate], allowed: Sequence[Candidate]) -> list[Candidate]:
        """Candidates that lower the error of the fit, best first, their values as physics allows."""
        G = np.sum([self._gram(k) for k in range(len(self.grams))], axis=0) / len(self.grams)
        system = _System(G, self.precision, self.active(chosen))
        falls = []
        for candidate in allowed:
            value, fall = system.addition(candidate.columns)
            falls.append(fall if self._plausible(candidate, value) else -np.inf)
        order = np.argsort(-np.array(falls), kind="stable")
        return [allowed[k] for k in order if falls[k] > 0]

    def linear(
        self, chosen: Sequence[Candidate], added: Sequence[Candidate]
    ) -> tuple[Errors, list[Errors]]:
        """Errors on parts left out, of the set and of the set with each candidate added."""
        count = int(self.blocks.max()) + 1
        before = np.zeros((count, self.robot.nv))
        after = np.zeros((len(added), count, self.robot.nv))
        for k in range(len(self.grams)):
            system = _System(self._gram(k), self.precision, self.active(chosen))
            change = np.column_stack([system.change(c.columns) for c in added] or [[]])
            held = self.folds == k
            starts, at = _starts(self.blocks[held])
            for j, (index, X) in enumerate(zip(self.columns.index, self.columns.rows, strict=True)):
                Xh = X[held]
                error = self._target[held, j] - Xh @ system.solution[index]
                before[at, j] += np.add.reduceat(error**2, starts)
                if len(added):
                    new = error[:, None] - Xh @ change[index]
                    after[:, at, j] += np.add.reduceat(new**2, starts, axis=0).T
        rows = len(self.tau)
        return Errors(before, rows), [Errors(each, rows) for each in after]

    def physical(self, chosen: Sequence[Candidate]) -> Errors:
        """Errors on parts left out, of physically consistent fits to the others."""
        active, size = self.active(chosen), 10 * self.robot.nv
        effects = active[size:] - size
        some = EffectPrior(*(getattr(self.coefficients, name)[effects] for name in _PRIOR))
        found = np.zeros((int(self.blocks.max()) + 1, self.robot.nv))
        at_all = np.append(active, self.columns.size)
        for k in range(len(self.grams)):
            F = _factor(self._gram(k)[np.ix_(at_all, at_all)])
            R = F[:, :-1].copy()
            R[:, :size] = R[:, :size] @ np.linalg.inv(self._coordinates)
            fit = fit_physical(R, F[:, -1] + R[:, :size] @ self.prior.ravel(), self.prior, some)
            x = np.zeros(self.columns.size)
            x[:size] = np.linalg.solve(self._coordinates, fit.x[:size] - self.prior.ravel())
            x[active[size:]] = fit.x[size:]
            held = self.folds == k
            starts, at = _starts(self.blocks[held])
            for j, (index, X) in enumerate(zip(self.columns.index, self.columns.rows, strict=True)):
                error = self._target[held, j] - X[held] @ x[index]
                found[at, j] += np.add.reduceat(error**2, starts)
        return Errors(found, len(self.tau))

    def active(self, chosen: Sequence[Candidate]) -> Index:
        """Columns of a model."""
        parts = [np.arange(self.always)]
        parts += [np.arange(c.columns.start, c.columns.stop) for c in chosen]
        return np.concatenate(parts)

    @property
    def precision(self) -> Array:
        """Prior precision of all coordinates, shape (p,)."""
        links = link_weights(self.robot.nv, PRIOR_SIGMA) ** 2
        return np.concatenate([links, self.coefficients.std**-2.0])

    @cached_property
    def _fold_of_block(self) -> Index:
        """Part that each block belongs to, shape (blocks,)."""
        found = np.zeros(int(self.blocks.max()) + 1, np.intp)
        found[self.blocks] = self.folds
        return found

    @property
    def _coordinates(self) -> Array:
        return link_coordinates(self.prior)

    @property
    def _target(self) -> Array:
        """Torque less that of the prior, shape (n, nv)."""
        return self.tau

    def _gram(self, k: int) -> Array:
        """Weighted products of all columns and, last, the torque, without part k."""
        size = self.columns.size
        G = np.zeros((size + 1, size + 1))
        for w, index, own in zip(self.weight, self.columns.index, self.grams[k], strict=True):
            at = np.append(index, size)
            G[np.ix_(at, at)] += w * own
        return G

    def _plausible(self, candidate: Candidate, value: Array) -> bool:
        """Whether coefficients are such as physics allows."""
        start = 10 * self.robot.nv
        part = slice(candidate.columns.start - start, candidate.columns.stop - start)
        beyond = float((value < self.coefficients.lower[part]).mean())
        if beyond > (_BEYOND if len(candidate.joints) > 1 else 0.0):
            return False
        trial = getattr(candidate.effect, "trial", None)
        if trial is not None:
            share = float(value[0]) / trial
            return _NEAR_TRIAL[0] < share < _NEAR_TRIAL[1]
        return bool((np.abs(value) < self.typical[part]).all())


_PRIOR = ("mean", "std", "lower")


class _System:
    """Regularised normal equations of a set of columns, ready for additions.

    Args:
        G: Products of all columns and, last, the torque, shape (p + 1, p + 1).
        precision: Prior precision, shape (p,).
        active: The set.
    """

    def __init__(self, G: Array, precision: Array, active: Index) -> None:
        self._G, self._precision, self._active = G, precision, active
        A = G[np.ix_(active, active)] + np.diag(precision[active])
        A[np.diag_indices_from(A)] *= 1 + _RIDGE
        self._factor = scipy.linalg.cho_factor(A, lower=True)
        self._explained = scipy.linalg.cho_solve(self._factor, G[active])  # (a, p + 1)
        self.solution = np.zeros(len(precision))
        self.solution[active] = self._explained[:, -1]

    def addition(self, columns: slice) -> tuple[Array, float]:
        """Coefficients of columns that are added, and the fall of the cost."""
        at = np.arange(columns.start, columns.stop)
        cross = self._G[np.ix_(self._active, at)]
        schur = self._G[np.ix_(at, at)] - cross.T @ self._explained[:, at]
        rest = self._G[at, -1] - cross.T @ self._explained[:, -1]
        schur = schur + np.diag(self._precision[at])
        value = np.linalg.lstsq(schur, rest, rcond=1e-9)[0]
        return value, float(rest @ value)

    def change(self, columns: slice) -> Array:
        """Change of the solution when columns are added, shape (p,)."""
        value, _ = self.addition(columns)
        change = np.zeros(len(self._precision))
        change[columns] = value
        change[self._active] = -self._explained[:, columns] @ value
        return change


def trial_of(robot: Robot, standard: Estimate) -> Trial:
    """Rows of what was fitted, with candidates from what the standard model leaves.

    Args:
        robot: The arm as given.
        standard: Its standard identification; effects that rest on torque take it from there.
    """
    segments, model = standard.data.train, standard.model
    measured = series(segments).measured * standard.gains
    left = measured - predicted_torque(model, segments)
    proposed = [pair for pair in proposals(model, segments, left) if isinstance(pair[0], KINDS)]
    proposed += [(effect, 1) for effect in _shared([e for e, _ in proposed], robot.joints)]
    stride = -(-len(measured) // _INSTANTS)
    rows = slice(None, None, stride)
    always = observation(model, model.effects, segments)[rows]
    prior = standard.prior.reshape(-1, 10)
    size = 10 * robot.nv
    tau = measured[rows] - always[:, :, :size] @ prior.ravel()
    always[:, :, :size] = always[:, :, :size] @ link_coordinates(prior)
    parts, candidates, at = [always], [], always.shape[2]
    for effect, trials in proposed:
        block = np.concatenate([s.rows(lambda m: effect.columns(model, m)) for s in segments])[rows]  # noqa: B023
        if block.any() and np.isfinite(block).all():
            own = tuple(robot.joint_index(joint) for joint in effect.joints)
            candidates.append(Candidate(effect, slice(at, at + block.shape[2]), own, trials))
            parts.append(block)
            at += block.shape[2]
    columns = signatures(parts, np.ones(tau.shape, bool))
    kept = [*model.effects, *(c.effect for c in candidates)]
    coefficients, typical = _knowledge(robot, kept, parts, size, measured[rows])
    folds, blocks = _parts(segments, stride)
    inflation = np.array([autocorrelation_time(e) for e in left[rows].T])
    sigma2 = np.maximum((left[rows] ** 2).mean(axis=0), 1e-24)
    return Trial(
        robot, columns, tau, prior, always.shape[2], coefficients, typical, tuple(candidates),
        folds, blocks, 1 / (sigma2 * inflation), inflation, _grams(columns, tau, folds),
    )  # fmt: skip


def _shared(single: Sequence[Effect], joints: tuple[str, ...]) -> list[Effect]:
    """The kinds of friction that all drives of an arm have in common, of one shape at all joints.

    Shapes are those proposed for the joint in the middle of the order of their sizes.
    """
    if len(joints) < 2:
        return []
    found: list[Effect] = []
    for kind in SHARED:
        own = [[e for e in single if type(e) is kind and e.joints == (j,)] for j in joints]
        moving = [effects for effects in own if effects]
        if not moving:
            continue
        names = tuple(effects[0].joints[0] for effects in moving)
        size = [next(iter(_shape(effects[0]).values()), 0.0) for effects in moving]
        middle = moving[int(np.argsort(size)[len(size) // 2])]
        found += [replace(effect, joints=names) for effect in middle] if len(names) > 1 else []
    return found


def _shape(effect: Effect) -> dict[str, float]:
    return {k: v for k, v in vars(effect).items() if k not in ("joints", "values")}


def _knowledge(
    robot: Robot, effects: Sequence[Effect], parts: Sequence[Array], links: int, tau: Array
) -> tuple[EffectPrior, Array]:
    """Nothing known of coefficients but their signs; how large they may be, where known."""
    known = [p for e in effects for p in e.parameters(robot)]
    blocks = [parts[0][:, :, links:], *parts[1:]]
    std = np.concatenate([implausible_size(block, tau) for block in blocks])
    typical = np.array([np.inf if p.typical is None else _LARGEST * p.typical for p in known])
    return EffectPrior(np.zeros_like(std), std, np.array([p.lower for p in known])), typical


def _parts(segments: Sequence[Segment], stride: int) -> tuple[Index, Index]:
    """Part and block of every row: contiguous, none over the border of a segment."""
    counts = np.array([len(s.t) for s in segments])
    seconds = float(sum(s.t[-1] - s.t[0] for s in segments))
    count = int(np.clip(seconds / _BLOCK_S, *_BLOCKS))
    folds, blocks, fold, block = [], [], 0, 0
    for n in counts:
        parts = max(1, round(_FOLDS * n / counts.sum()))
        parts = max(parts, 2 if len(counts) < 3 else 1)
        within = np.minimum(np.arange(n) * parts // n, parts - 1)
        each = max(1, round(count * n / counts.sum() / parts))
        inner = np.concatenate(
            [np.arange(m) * each // m for m in np.bincount(within, minlength=parts)]
        )
        folds.append(fold + within)
        blocks.append(block + within * each + inner)
        fold, block = fold + parts, block + parts * each
    rows = slice(None, None, stride)
    return np.concatenate(folds)[rows], np.unique(
        np.concatenate(blocks)[rows], return_inverse=True
    )[1]


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


def _starts(blocks: Index) -> tuple[Index, Index]:
    """First row of each block among some rows, and the blocks."""
    at, starts = np.unique(blocks, return_index=True)
    return starts, at


def _factor(G: Array) -> Array:
    """F with Fᵀ F = G, of as many rows as G has."""
    unit = np.sqrt(np.maximum(np.diag(G), 1e-300))
    values, vectors = np.linalg.eigh(G / np.outer(unit, unit))
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))).T * unit, float)
