"""Rows to try effects on: contiguous parts of the training data, each predicted by the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from excitant.analysis.evidence import Index
from excitant.analysis.evidence import JointColumns as Signatures
from excitant.analysis.normal_equations import NormalEquations, gram_factor
from excitant.identify.physical import (
    PRIOR_SIGMA,
    EffectPrior,
    fit_physical,
    link_coordinates,
    link_weights,
)
from excitant.robots.effects import Effect
from excitant.robots.motion import Array
from excitant.robots.robot import Robot

_PRIOR = ("mean", "std", "lower")
_BEYOND = 0.5  # of several coefficients may be such as the consistent fit then sets to zero


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
        columns: Coordinates of the bodies from the prior on, standard effects, candidates.
        tau: Torque less that of the prior's bodies, shape (n, nv) [N·m].
        prior: Standard parameters of the prior, shape (nv, 10).
        always: Number of leading columns that every model has.
        coefficients: Prior of the coefficients of effects, those of candidates included.
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
        """Candidates with values as physics allows, those that help the fit most first."""
        G = np.sum([self._gram(k) for k in range(len(self.grams))], axis=0) / len(self.grams)
        system = NormalEquations(G, self.precision, self.active(chosen))
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
            system = NormalEquations(self._gram(k), self.precision, self.active(chosen))
            change = np.zeros((self.columns.size, len(added)))
            for i, candidate in enumerate(added):
                change[:, i] = system.change(candidate.columns)
            held = self.folds == k
            starts, at = _starts(self.blocks[held])
            for j, (index, X) in enumerate(zip(self.columns.index, self.columns.rows, strict=True)):
                Xh = X[held]
                error = self.tau[held, j] - Xh @ system.solution[index]
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
            F = gram_factor(self._gram(k)[np.ix_(at_all, at_all)])
            R = F[:, :-1].copy()
            R[:, :size] = R[:, :size] @ np.linalg.inv(self._coordinates)
            fit = fit_physical(R, F[:, -1] + R[:, :size] @ self.prior.ravel(), self.prior, some)
            x = np.zeros(self.columns.size)
            x[:size] = np.linalg.solve(self._coordinates, fit.x[:size] - self.prior.ravel())
            x[active[size:]] = fit.x[size:]
            held = self.folds == k
            starts, at = _starts(self.blocks[held])
            for j, (index, X) in enumerate(zip(self.columns.index, self.columns.rows, strict=True)):
                error = self.tau[held, j] - X[held] @ x[index]
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
        return candidate.effect.credible(self.robot, value)


def _starts(blocks: Index) -> tuple[Index, Index]:
    """First row of each block among some rows, and the blocks."""
    at, starts = np.unique(blocks, return_index=True)
    return starts, at
