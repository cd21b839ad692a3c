"""`identify`: from recordings to a physically consistent model, judged on a hold-out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from excitant.exceptions import UnknownName
from excitant.identify.accuracy import Accuracy, Series, predicted_torque, series
from excitant.identify.estimators import ESTIMATORS, estimated
from excitant.identify.knowledge import Knowledge
from excitant.identify.least_squares import LeastSquares
from excitant.identify.physical import PhysicalFit, fit_physical, prior_parameters
from excitant.identify.prediction import PredictionInterval, prediction_interval
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
from excitant.robots.base_parameters import BaseParameters, base_parameters
from excitant.robots.effects import Effect, standard_effects
from excitant.robots.html_table import html_table
from excitant.robots.motion import Array, Motion, read_only
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
        series: Rows of the hold-out.
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
    series: Series
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

    def _repr_html_(self) -> str:
        columns = (self.baseline.rms, self.validate.rms, self.validate.nrmse, self.validate.r2)
        rows = zip(self.given.joints, *(column.tolist() for column in columns), strict=True)
        heads = ("joint", "rms error as given", "identified", "nrmse", "r²")
        title = f"Estimate of {self.given.name} ({self.estimator}), on the hold-out"
        return html_table(title, heads, rows)


def identify(
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
        series=unseen,
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
