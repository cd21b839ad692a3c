"""What a file cannot hold of a model, made up for by what it can.

A format that lacks effects of a model gives another torque than the model. What it holds, bodies
and joint properties x, is fitted to the torque τ of the complete model on the rows of the fit,

    minimise  Σ_j ‖τ_j − W_j x‖² / e_j² − 2 log p(P)   subject to  P_k ≻ 0,  θ ≥ bounds,

with the prior density p of `excitant.identify.prior` around the bodies of the model, and e_j the
error that the joint is left with. The torque of the model stands for the measured one, for gross
errors of a recording are no part of it. Joint properties alone are fitted first, bodies only where
that is still better.

What is lacking must be imitated in other motions, too: an offset of torque looks like a first
moment where a joint keeps to one side. Both fits are judged on the rows and on the same motion in a
mirror, to which they were not fitted: positions about the middle of each joint's range, and speeds
the other way round, where the complete model tells the torque.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy

from excitant.identify.accuracy import Series, series
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
from excitant.identify.tables import LARGE_CHANGE
from excitant.robots.effects import EFFECTS, Effect, effect_values
from excitant.robots.motion import Array, Indices, Mask, Motion
from excitant.robots.robot import Robot

REFIT_GAIN = 0.95
"""Largest nrmse, summed over the joints, of a refit over that of the simpler choice, on the rows
and in the mirror. It counts the model's own error, too: a reader of the file sees both. Less would
move bodies for what no reader notices (benchmarks/recordings.py).
"""
REFIT_ROUNDS = 2
"""Fits with the errors e_j of the one before: a joint that friction was lacking counts again."""


@dataclass(frozen=True, eq=False)
class Refit:
    """Fits of what formats hold to the torque of a complete model.

    Attributes:
        arm: The model, with bodies among its effects in its links.
        segments: What it was fitted to.
        gains: Torque per reading, shape (nv,) [N·m per reading].
        known: Joints at which they are known, shape (nv,); files state no torque elsewhere.
    """

    arm: Robot
    segments: Sequence[Segment]
    gains: Array
    known: Mask

    def of(self, held: Robot, file_format: str) -> Robot | None:
        """What a format holds of the model, refitted; None where that is not clearly better.

        Args:
            held: What it holds without a refit.
            file_format: One of `excitant.identify.export.FORMATS`.
        """
        if (self.arm.phi[::10] < 0).any():
            return None
        heir = self._heir(held, file_format)
        best = heir.start
        recorded = self._recorded
        least = self._totals(best)
        complete = self._total(np.zeros_like(recorded.tau))
        for fit in (heir.drives, heir.everything):
            most = REFIT_GAIN * least
            if (complete > most).any():
                break
            x = best
            for _ in range(REFIT_ROUNDS):
                weight = 1 / believed(self._errors(recorded.residual(x)))
                x = fit(*recorded.factor(weight))
            totals = self._totals(x)
            if (totals <= most).all():
                best = x
                least = totals
        if best is heir.start:
            return None
        robot = identified_robot(self.arm, self._effects, best)
        return robot.with_effects([e for e in robot.effects if any(e.values or ())])

    def _heir(self, held: Robot, file_format: str) -> _Heir:
        """What a format holds, at the joints whose gains are known."""
        links = len(self.arm.phi)
        values = effect_values(held)
        coefficients = [p for e in self._effects for p in e.parameters(self.arm)]
        mean = np.array([values.get(p.name, 0.0) for p in coefficients])
        kept = np.flatnonzero(
            np.concatenate([self._fitted(e, file_format) for e in self._effects])
        )
        drives = self._recorded.select((links + kept).tolist())
        return _Heir(
            np.concatenate([self.arm.phi, mean]),
            links + kept,
            prior_parameters(self.arm),
            EffectPrior(
                mean[kept],
                implausible_size(drives.W, drives.tau),
                np.array([p.lower for p in coefficients])[kept],
            ),
        )

    def _fitted(self, effect: Effect, file_format: str) -> Mask:
        """Which coefficients of a joint property a format lets fit, shape (terms nv,).

        Those at joints whose gains are known; of what arms usually lack, as springs, only where
        the model has it.
        """
        own = [
            other.joints for other in self.arm.effects if other.name == effect.name
        ]
        there = np.isin(self.arm.joints, sum(own, ())) | effect.search.standard
        held = self.known & there & (file_format in effect.exported.formats)
        return np.repeat(held, len(effect.own_terms))

    @cached_property
    def _effects(self) -> tuple[Effect, ...]:
        """All joint properties that any format holds, at all joints."""
        return tuple(
            kind(self.arm.joints)
            for kind in EFFECTS.values()
            if kind.export.joint_property
        )

    @cached_property
    def _rows(self) -> Series:
        return series(self.segments)

    @cached_property
    def _recorded(self) -> Regression:
        """Columns of bodies and joint properties on the rows of the fit."""
        return self._columns(self.segments)

    @cached_property
    def _mirrored(self) -> Regression:
        """The same of the motion in a mirror."""
        return self._columns([_mirrored(s, self.arm) for s in self.segments])

    def _columns(self, segments: Sequence[Segment]) -> Regression:
        """Columns with the torque of the model, at rows that count."""
        columns = regression_of(self.arm, self._effects, segments)
        tau = predicted_torque(self.arm, segments)
        return columns.counting(self._rows.counts & self.known).with_torque(tau)

    @cached_property
    def _remaining(self) -> Array:
        """Errors of the complete model on the rows of the fit, shape (nv,) [N·m]."""
        predicted = self._recorded.tau / self.gains
        return self._rows.rms(self._rows.measured - predicted) * self.gains

    def _errors(self, residual: Array) -> Array:
        """Errors with a residual (n, nv) to the model's torque, the model's own too, (nv,)."""
        return np.hypot(self._rows.rms(residual), self._remaining)

    def _totals(self, x: Array) -> Array:
        """`_total` of parameters on the recorded motion and in the mirror, shape (2,)."""
        motions = (self._recorded, self._mirrored)
        return np.array([self._total(motion.residual(x)) for motion in motions])

    def _total(self, residual: Array) -> float:
        """Nrmse with it, summed over the joints whose gains are known."""
        std = self._rows.std * self.gains
        judged = self.known & (std > 0)
        return float((self._errors(residual)[judged] / std[judged]).sum())


@dataclass(frozen=True, eq=False)
class _Heir:
    """What a file holds of a model, to be fitted; x holds bodies and all joint properties, (p,).

    Attributes:
        start: What it holds without a refit, shape (p,).
        kept: Joint properties that its format holds.
        bodies: Consistent bodies near the model's, shape (nv, 10).
        effects: Prior and bounds of those properties.
    """

    start: Array
    kept: Indices
    bodies: Array
    effects: EffectPrior

    def drives(self, R: Array, z: Array) -> Array:
        """Joint properties fitted, bodies as they are."""
        links = self.bodies.size
        precision = 1 / self.effects.std
        columns = np.vstack([R[:, self.kept], np.diag(precision)])
        rest = z - R[:, :links] @ self.start[:links]
        scale = 1 / np.linalg.norm(columns, axis=0)
        fit = scipy.optimize.lsq_linear(
            columns * scale,
            np.concatenate([rest, precision * self.effects.mean]),
            (self.effects.lower / scale, np.inf),
            method="bvls",
        )
        x = self.start.copy()
        x[self.kept] = scale * fit.x
        return x

    def everything(self, R: Array, z: Array) -> Array:
        """Bodies fitted, too, as far towards the optimum as no mass changes by too much.

        The start where floating point ends before the optimum.
        """
        columns = np.append(np.arange(self.bodies.size), self.kept)
        fit = fit_physical(R[:, columns], z, BodyPrior(self.bodies), self.effects)
        x = self.start.copy()
        if not fit.note:
            change = fit.x - x[columns]
            mass = self.bodies[:, 0]
            share = np.abs(change[: self.bodies.size : 10] / mass).max()
            x[columns] += change * min(1.0, LARGE_CHANGE / share)
        return x


def _mirrored(segment: Segment, arm: Robot) -> Segment:
    """The motion about the middle of each joint's range, of its mean position without one."""
    motion = segment.motion
    ends = arm.limits.position.T
    bounded = np.isfinite(ends).all(axis=0)
    ends = np.where(bounded, ends, motion.q.mean(axis=0))
    q = ends.sum(axis=0) - motion.q
    return replace(segment, motion=Motion(motion.t, q, -motion.dq, -motion.ddq))
