"""`identify`: from recordings to a physically consistent model, judged on a hold-out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from excitant.exceptions import UnknownName
from excitant.identify.accuracy import (
    Accuracy,
    Coverage,
    PredictionInterval,
    Series,
    coverage,
    predicted_torque,
    prediction_interval,
    series,
)
from excitant.identify.estimators import ESTIMATORS, estimated
from excitant.identify.knowledge import Knowledge
from excitant.identify.least_squares import LeastSquares, essential_parameters
from excitant.identify.physical import PhysicalFit, fit_physical
from excitant.identify.prior import prior_parameters
from excitant.identify.recording import Recording
from excitant.identify.rows import (
    Data,
    FitRows,
    fit_rows,
    fitted,
    identified_robot,
    split,
    with_own_torque,
)
from excitant.identify.shapes import Shapes, refined_shapes
from excitant.robots.base_parameters import BaseParameters, base_parameters, categories
from excitant.robots.effects import Effect, standard_effects
from excitant.robots.html_table import html_table
from excitant.robots.motion import Array, Motion, read_only
from excitant.robots.parameters import UNITS, violations
from excitant.robots.robot import Robot
from excitant.robots.torque import observation_columns


@dataclass(frozen=True, eq=False)
class Estimate:
    """What was identified.

    Attributes:
        given: The robot as given.
        model: The identified robot: physically consistent inertias, and effects with values.
        base: Base parameters of links and effects together.
        least_squares: Weighted least-squares estimate of the base parameters.
        physical: Physically consistent fit of all parameters.
        prior: Standard parameters of the prior, shape (10 nv,).
        gains: Drive gains where torque came as current, shape (nv,) [N·m/A]; ones otherwise.
        data: What was fitted and held out.
        train: Accuracy of the model on the fitted rows.
        validate: Accuracy of the model on the hold-out.
        baseline: Accuracy of the given robot on the hold-out.
        holdout: Rows of the hold-out.
        predicted: Torque of the model at those rows, shape (n, nv) [torque unit].
        predicted_given: Torque of the given robot at those rows [torque unit].
        notes: What the user should know, as sentences.
        estimator: How the base parameters were estimated, in words.
        knowledge: What was taken for known of the bodies.
        shapes: Shapes of effects, refined where that fits better; None where there are none.
    """

    given: Robot
    model: Robot
    base: BaseParameters
    least_squares: LeastSquares
    physical: PhysicalFit
    prior: Array
    gains: Array
    data: Data
    train: Accuracy
    validate: Accuracy
    baseline: Accuracy
    holdout: Series
    predicted: Array
    predicted_given: Array
    notes: tuple[str, ...]
    estimator: str = ESTIMATORS["wls"]
    knowledge: Knowledge = field(default_factory=Knowledge)
    shapes: Shapes | None = None

    @property
    def phi(self) -> Array:
        """Identified standard parameters, shape (10 nv,)."""
        return read_only(self.physical.x[: 10 * self.given.nv])

    @cached_property
    def holdout_columns(self) -> Array:
        """Columns of the base parameters at the rows of the hold-out, shape (n, nv, r)."""
        effects, used = self.model.effects, list(self.base.columns)

        def columns(motion: Motion) -> Array:
            return np.asarray(observation_columns(self.model, effects, motion)[:, :, used], float)

        return read_only(np.concatenate([part.rows(columns) for part in self.data.validate]))

    @cached_property
    def interval(self) -> PredictionInterval:
        """95 % intervals of readings at the rows of the hold-out."""
        predicted = predicted_torque(self.model, self.data.train) / self.gains
        residual = series(self.data.train).measured - predicted
        return prediction_interval(self.holdout_columns, self.least_squares, residual, self.gains)

    def result(self) -> dict[str, Any]:
        """Machine-readable result of `identify` (keys of DESIGN.md, section 5)."""
        robot = self.given
        broken = violations(self.phi, robot.links)
        half_width = self.interval.half_width
        held = coverage(self.holdout.measured, self.predicted, half_width)
        return {
            "verb": "identify",
            "robot": robot.name,
            "estimator": f"{self.estimator}, then physically consistent semidefinite fit",
            "effects": [effect.name for effect in self.model.effects],
            "cutoff_hz": self.data.cutoff_hz,
            **({} if self.shapes is None else {"shapes": self.shapes.entry()}),
            "unit": self.data.unit,
            "holdout": self.data.holdout,
            "drive_gain_Nm_per_A": list(self.gains) if self.data.unit == "A" else None,
            "joints": [
                {
                    "name": joint,
                    "train": self.train.entry(j),
                    "validate": self.validate.entry(j) | {"interval95": self._interval(held, j)},
                    "baseline": self.baseline.entry(j),
                }
                for j, joint in enumerate(robot.joints)
            ],
            "parameters": self._parameters(),
            "base_parameters": self._base_parameters(),
            "essential": self._essential(),
            "physical": {
                "consistent": not broken,
                "violations": broken,
                "kkt": vars(self.physical.kkt),
            },
            "knowledge": self.knowledge.entry(),
            "notes": [
                *self.notes,
                *([self.knowledge.sentence] if self.knowledge.sentence else []),
                *_missed(robot.joints, held),
            ],
        }

    def series(self) -> dict[str, Array]:
        """Measured, given and identified torque on the hold-out, each of shape (n, nv)."""
        return {
            "t": self.holdout.t,
            "measured": self.holdout.measured,
            "given": self.predicted_given,
            "identified": self.predicted,
            "half_width": self.interval.half_width,
        }

    def _interval(self, held: Coverage, joint: int) -> dict[str, float]:
        """Mean half width of the 95 % intervals of one joint, and how many readings they hold."""
        half, parameters = self.interval.half_width, self.interval.parameters
        return {
            "half_width": float(half[:, joint].mean()),
            "half_width_parameters": float(1.96 * parameters[:, joint].mean()),
            "coverage": float(held.share[joint]),
        }

    def _essential(self) -> dict[str, Any]:
        """The fewest base parameters, and what the hold-out says of them (median over joints)."""
        essential = essential_parameters(self.least_squares.beta, self.least_squares.covariance)
        expressions, gains = self.base.expressions, self.gains
        every, few = (
            float(np.nanmedian(self.holdout.accuracy(self.holdout_columns @ b / gains).nrmse))
            for b in (self.least_squares.beta, essential.beta)
        )
        return {
            "kept": [expressions[k] for k in essential.kept],
            "dropped": [expressions[k] for k in essential.dropped],
            "p_value": essential.p_value,
            "nrmse_all": every,
            "nrmse_essential": few,
        }

    def _parameters(self) -> list[dict[str, Any]]:
        robot, physical = self.given, self.physical
        names = self.base.names
        effects = [p for e in self.model.effects for p in e.parameters(robot)]
        units = [*UNITS * robot.nv, *(p.unit for p in effects)]
        owners = [link for link in robot.links for _ in UNITS]
        owners += [p.name.rpartition(".")[0] for p in effects]
        given = [*self.prior, *(None,) * len(effects)]
        std = np.sqrt(np.diag(physical.covariance))
        return [
            {
                "name": names[k],
                "link": owners[k],
                "value": float(physical.x[k]),
                "std": float(std[k]),
                "unit": units[k],
                "category": category,
                "prior": None if given[k] is None else float(given[k]),
                "prior_dominated": category == "unidentifiable" or physical.prior_dominated[k],
            }
            for k, category in enumerate(categories(self.base))
        ]

    def _base_parameters(self) -> list[dict[str, Any]]:
        fit = self.least_squares
        std = np.sqrt(np.diag(fit.covariance))
        return [
            {
                "expression": text,
                "value": float(value),
                "std": float(s),
                "rel_std": float(s / abs(value)) if value else None,
            }
            for text, value, s in zip(self.base.expressions, fit.beta, std, strict=True)
        ]

    def _repr_html_(self) -> str:
        columns = (self.baseline.rms, self.validate.rms, self.validate.nrmse, self.validate.r2)
        rows = zip(self.given.joints, *(column.tolist() for column in columns), strict=True)
        heads = ("joint", "rms error as given", "identified", "nrmse", "r²")
        title = f"Estimate of {self.given.name} ({self.estimator}), on the hold-out"
        return html_table(title, heads, rows)


def identify_robot(
    robot: Robot,
    recordings: Sequence[Recording],
    *,
    validate: Sequence[Recording] = (),
    effects: Sequence[Effect] | None = None,
    cutoff_hz: float | None = None,
    estimator: str = "wls",
    knowledge: Knowledge | None = None,
    harmonics_hz: float | None = None,
) -> Estimate:
    """Identify a robot from recordings.

    Weighted least squares on the base parameters gives noise levels and base estimates; the
    semidefinite fit then gives physically consistent standard parameters. With any other
    estimator, the semidefinite fit is to the torque that its base parameters predict on these
    rows, weighted by the noise it found. Shapes of effects, in which torque is not linear, are
    refined where that fits better (`excitant.identify.shapes`).

    Args:
        robot: The arm; its inertias are the prior.
        recordings: What to fit.
        validate: What to judge on; the last 30 % of each recording when empty.
        effects: Effects to estimate; friction, offset and rotor inertia when None.
        cutoff_hz: Cut-off of the torque filter [Hz]; see `excitant.identify.rows.split`.
        estimator: One of `excitant.identify.estimators.ESTIMATORS`.
        knowledge: What is known of the bodies beforehand, and the kind of prior.
        harmonics_hz: Highest harmonic of the motion as planned [Hz]; without a cut-off given,
            none is taken that filters its torque away.

    Raises:
        BadInput: Knowledge that no body fulfils, or of links that the arm does not have.
        BadRecording: Recordings that cannot be used.
        BadRobot: Links without mass, so no prior.
        UnknownName: There is no such estimator.
        RankDeficient: Motion that leaves base parameters undetermined.
        Infeasible: The semidefinite solver failed, or an estimator does not converge.
    """
    if estimator not in ESTIMATORS:
        raise UnknownName("estimator", estimator, ESTIMATORS)
    prior, known = prior_parameters(robot), knowledge or Knowledge()
    effects = standard_effects(robot.joints) if effects is None else tuple(effects)
    data = split(recordings, validate, cutoff_hz, harmonics_hz)
    rows = fit_rows(robot, effects, base_parameters(robot, effects), data)
    rows = with_own_torque(rows, prior, known)
    notes = notes_on(robot, prior, data, rows.gains)
    shapes = refined_shapes(rows, prior, known)
    if shapes is not None:
        rows = shapes.rows(rows) if shapes.better else rows
        notes += (shapes.sentence,)
    fit, said = estimated(rows, fitted(recordings, validate), estimator)
    R, z = rows.regression.factor(fit.weight)
    if estimator != "wls":
        z = R[:, rows.base.columns] @ fit.beta
    physical = fit_physical(R, z, prior, rows.open_prior, knowledge=known, links=robot.links)
    if shapes is not None and shapes.better:
        fit, physical = shapes.widened(fit, physical, rows.base)
    found = judged(robot, rows, fit, physical, (*notes, *said))
    return replace(found, estimator=ESTIMATORS[estimator], knowledge=known, shapes=shapes)


def judged(
    robot: Robot, rows: FitRows, fit: LeastSquares, physical: PhysicalFit, notes: tuple[str, ...]
) -> Estimate:
    """A fit with its accuracy on the training and the validation segments.

    Args:
        robot: The arm as given.
        rows: What was fitted.
        fit: Base parameters.
        physical: Physically consistent parameters of links and effects.
        notes: What else should be said.
    """
    data, gains = rows.data, rows.gains
    model = identified_robot(robot, rows.effects, physical.x)
    unseen = series(data.validate)
    predicted = predicted_torque(model, data.validate) / gains
    predicted_given = predicted_torque(robot, data.validate) / gains
    return Estimate(
        given=robot,
        model=model,
        base=rows.base,
        least_squares=fit,
        physical=physical,
        prior=read_only(prior_parameters(robot).ravel()),
        gains=read_only(gains),
        data=data,
        train=rows.measured.accuracy(rows.regression.torque(physical.x) / gains),
        validate=unseen.accuracy(predicted),
        baseline=unseen.accuracy(predicted_given),
        holdout=unseen,
        predicted=read_only(predicted),
        predicted_given=read_only(predicted_given),
        notes=notes,
    )


def notes_on(robot: Robot, prior: Array, data: Data, gains: Array) -> tuple[str, ...]:
    """What the user should know of the hold-out, the prior and the unit of torque."""
    notes = [data.holdout, data.cutoff_why]
    moved = [
        link
        for link, given, used in zip(robot.links, robot.phi.reshape(-1, 10), prior, strict=True)
        if not np.allclose(given, used)
    ]
    if moved:
        notes.append(
            f"the given inertia of {', '.join(moved)} is one no body can have; "
            "the nearest possible one serves as prior"
        )
    if data.unit == "A":
        notes.append(
            "torque came as motor current; drive gains relative to each other were estimated "
            f"({', '.join(f'{k:.3g}' for k in gains)} N·m/A); their common scale rests on the "
            "given masses and is not determined by currents"
        )
    return tuple(notes)


def _missed(joints: Sequence[str], held: Coverage) -> list[str]:
    """What coverage far from 95 % says, as a sentence, where there is any."""
    low = np.flatnonzero(held.too_few)
    if not len(low):
        return []
    shares = ", ".join(f"{joints[int(j)]} {100 * held.share[j]:.0f} %" for j in low)
    return [
        f"95 % intervals of the predicted torque hold less of the hold-out ({shares}): the model "
        "misses something there; `excitant diagnose` looks for its cause"
    ]
