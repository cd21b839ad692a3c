"""What a file cannot hold of a model, made up for by what it can.

A format that lacks effects of a model gives another torque than the model. What it holds, bodies
and joint properties x, is fitted to the torque τ of the complete model on the rows of the fit,

    minimise  (p / n) Σ_j ‖τ_j − W_j x‖² / e_j² − 2 log p(P)   subject to  P_k ≻ 0,  θ ≥ bounds,

with the prior density p of `excitant.identify.prior` around the bodies of the model, and e_j the
error of the joint without a refit. What a format lacks is no noise, of which more rows would tell
more: the n rows count as many as there are parameters p, so that a longer recording moves bodies
no further.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from excitant.identify.accuracy import Accuracy, Series, series
from excitant.identify.least_squares import believed
from excitant.identify.physical import fit_physical
from excitant.identify.preprocessing import Segment
from excitant.identify.prior import BodyPrior, EffectPrior, prior_parameters
from excitant.identify.regression import Regression, regression_of
from excitant.identify.rows import (
    identified_robot,
    implausible_size,
    predicted_torque,
)
from excitant.robots.effects import EFFECTS, Effect, effect_values
from excitant.robots.motion import Array
from excitant.robots.robot import Robot

REFIT_GAIN = 0.9
"""Largest nrmse, summed over the joints, of a refit over that without it, on the rows of the fit.

It counts the model's own error, too, so that bodies move only where a reader of the file sees it.
"""


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
        arm = self.arm
        if (arm.phi[::10] < 0).any():
            return None
        effects = tuple(
            e for e in self._effects if file_format in e.export.formats
        )
        coefficients = [p for e in effects for p in e.parameters(arm)]
        names = (*arm.parameter_names, *(p.name for p in coefficients))
        problem = self._regression.select(
            [self._regression.names.index(name) for name in names]
        )
        values = effect_values(held)
        mean = np.array([values.get(p.name, 0.0) for p in coefficients])
        drives = problem.select(range(len(arm.phi), problem.p))
        before = self._accuracy(problem, np.concatenate([arm.phi, mean]))
        share = np.sqrt(problem.p / len(problem))
        fit = fit_physical(
            *problem.factor(share / believed(before.rms * self.gains)),
            BodyPrior(prior_parameters(arm)),
            EffectPrior(
                mean,
                implausible_size(drives.W, problem.tau),
                np.array([p.lower for p in coefficients]),
            ),
        )
        after = self._accuracy(problem, fit.x)
        if fit.note or _total(after) > REFIT_GAIN * _total(before):
            return None
        return identified_robot(arm, effects, fit.x)

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

    def _accuracy(self, problem: Regression, x: Array) -> Accuracy:
        """Of x on the measured rows of the fit."""
        return self._rows.accuracy(problem.torque(x) / self.gains)


def _total(accuracy: Accuracy) -> float:
    return float(np.nansum(accuracy.nrmse))
