"""What a file cannot hold of a model, made up for by what it can.

A format that lacks effects of a model gives another torque than the model. What it holds, bodies
and joint properties x, is fitted to the torque τ of the complete model on the rows of the fit,

    minimise  (p / n) Σ_j ‖τ_j − W_j x‖² / e_j² − 2 log p(P)   subject to  P_k ≻ 0,  θ ≥ bounds,

with the prior density p of `excitant.identify.prior` around the bodies of the model, and e_j the
error of the joint without a refit. What a format lacks is no noise, of which more rows would tell
more: the n rows count as many as there are parameters p, so that a longer recording moves bodies
no further. Joint properties alone are fitted first, bodies only where that is still better, both
judged on parts of the rows that they were not fitted to: what is lacking must be imitated in other
motions too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
import scipy

from excitant.identify.accuracy import Accuracy, Series, series
from excitant.identify.least_squares import believed
from excitant.identify.physical import fit_physical
from excitant.identify.preprocessing import Segment
from excitant.identify.prior import BodyPrior, EffectPrior, prior_parameters
from excitant.identify.regression import Regression, joined, regression_of
from excitant.identify.rows import (
    identified_robot,
    implausible_size,
    predicted_torque,
)
from excitant.robots.effects import EFFECTS, Effect, effect_values
from excitant.robots.motion import Array
from excitant.robots.robot import Robot

REFIT_GAIN = 0.9
"""Largest nrmse, summed over the joints, of a refit over that of the simpler choice, on rows that
the refit has not seen. It counts the model's own error, too: a reader of the file sees both.
"""
REFIT_PARTS = 4
"""Parts of the rows, each of which is predicted by a refit to the others."""


@dataclass(frozen=True, eq=False)
class Refit:
    """Fits of what formats hold to the torque of a complete model.

    Attributes:
        arm: The model, with bodies among its effects in its links.
        segments: What it was fitted to.
        gains: Torque per reading, shape (nv,) [N·m per reading].
    """

    arm: Robot
    segments: Sequence[Segment]
    gains: Array

    def of(self, held: Robot, file_format: str) -> Robot | None:
        """What a format holds of the model, refitted; None where that is not clearly better.

        Args:
            held: What it holds without a refit.
            file_format: One of `excitant.identify.export.FORMATS`.
        """
        if (self.arm.phi[::10] < 0).any():
            return None
        effects = tuple(e for e in self._effects if file_format in e.export.formats)
        coefficients = [p for e in effects for p in e.parameters(self.arm)]
        names = [p.name for p in coefficients]
        wanted = (*self.arm.parameter_names, *names)
        problem = self._regression.select(
            [self._regression.names.index(name) for name in wanted]
        )
        values = effect_values(held)
        mean = np.array([values.get(name, 0.0) for name in names])
        drives = problem.select(range(len(self.arm.phi), problem.p))
        start = np.concatenate([self.arm.phi, mean])
        accuracy = self._accuracy(problem.torque(start))
        heir = _Heir(
            start,
            prior_parameters(self.arm),
            EffectPrior(
                mean,
                implausible_size(drives.W, problem.tau),
                np.array([p.lower for p in coefficients]),
            ),
            1 / believed(accuracy.rms * self.gains),
        )
        x: Array | None = None
        complete = _total(self._accuracy(problem.tau))
        least = REFIT_GAIN * _total(accuracy)
        for fitted in (heir.drives, heir.everything):
            if complete > least:
                break
            found = fitted(problem)
            if _total(self._accuracy(problem.torque(found))) > least:
                continue
            unseen = _total(self._accuracy(_of_unseen(problem, fitted)))
            if unseen <= least:
                x = found
                least = REFIT_GAIN * unseen
        return None if x is None else identified_robot(self.arm, effects, x)

    @cached_property
    def _effects(self) -> tuple[Effect, ...]:
        """All joint properties that any format holds."""
        return tuple(
            kind(self.arm.joints)
            for kind in EFFECTS.values()
            if kind.export.joint_property
        )

    @cached_property
    def _rows(self) -> Series:
        return series(self.segments)

    @cached_property
    def _regression(self) -> Regression:
        """Columns of bodies and joint properties, with the torque of the model."""
        columns = regression_of(self.arm, self._effects, self.segments)
        tau = predicted_torque(self.arm, self.segments)
        return columns.counting(self._rows.counts).with_torque(tau)

    def _accuracy(self, tau: Array) -> Accuracy:
        """Of a torque on the measured rows of the fit, shape (n, nv) [N·m]."""
        return self._rows.accuracy(tau / self.gains)


@dataclass(frozen=True, eq=False)
class _Heir:
    """What a file holds of a model, to be fitted; vectors as in `PhysicalFit`.

    Attributes:
        start: What it holds without a refit, shape (p,).
        bodies: Consistent bodies near the model's, shape (nv, 10).
        effects: Joint properties.
        weight: Of the rows of each joint, shape (nv,) [1/(N·m)].
    """

    start: Array
    bodies: Array
    effects: EffectPrior
    weight: Array

    def drives(self, problem: Regression) -> Array:
        """Joint properties fitted, bodies as they are."""
        R, z = problem.factor(self.weight)
        links = self.start[: self.bodies.size]
        precision = 1 / self.effects.std
        columns = np.vstack([R[:, len(links) :], np.diag(precision)])
        wanted = [z - R[:, : len(links)] @ links, precision * self.effects.mean]
        scale = 1 / np.linalg.norm(columns, axis=0)
        fit = scipy.optimize.lsq_linear(
            columns * scale,
            np.concatenate(wanted),
            (self.effects.lower / scale, np.inf),
            method="bvls",
        )
        return np.concatenate([links, scale * fit.x])

    def everything(self, problem: Regression) -> Array:
        """Bodies fitted, too; the start where floating point ends before the optimum."""
        share = np.sqrt(problem.p / len(problem))
        R, z = problem.factor(share * self.weight)
        fit = fit_physical(R, z, BodyPrior(self.bodies), self.effects)
        return self.start if fit.note else fit.x


def _of_unseen(problem: Regression, fitted: Callable[[Regression], Array]) -> Array:
    """Torque of each part of the rows by a fit to the others, shape (n, nv) [N·m]."""
    ends = np.linspace(0, len(problem), REFIT_PARTS + 1).astype(int).tolist()
    parts = []
    for first, last in pairwise(ends):
        others = (slice(0, first), slice(last, None))
        x = fitted(joined([problem.at(rows) for rows in others]))
        parts.append(problem.at(slice(first, last)).torque(x))
    return np.concatenate(parts)


def _total(accuracy: Accuracy) -> float:
    return float(np.nansum(accuracy.nrmse))
