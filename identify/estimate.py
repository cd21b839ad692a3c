"""`identify`: from recordings to a physically consistent model, judged on a hold-out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from excitant.identify.accuracy import Accuracy, Series, predicted_torque, series
from excitant.identify.cutoff_harmonics import planned_harmonics
from excitant.identify.cutoff_sensitivity import Sensitivity, sensitivity
from excitant.identify.cutoff_study import Study
from excitant.identify.estimator_choice import AUTO, EstimatorChoice
from excitant.identify.estimators import DESCRIPTIONS, estimator_named
from excitant.identify.estimators.of_rows import estimated
from excitant.identify.fit_choices import plain_choices, tuned_choices
from excitant.identify.knowledge import Knowledge
from excitant.identify.least_squares import LeastSquares, weighted_least_squares
from excitant.identify.physical import PhysicalFit, fit_physical, prior_parameters
from excitant.identify.prediction import PredictionInterval, prediction_interval
from excitant.identify.recording import Recording
from excitant.identify.resting import identified_robot, resting, whitened
from excitant.identify.rows import Data, FitRows, fit_rows, fitted, split
from excitant.robots.base_parameters import BaseParameters, base_parameters
from excitant.robots.effects import Effect, standard_effects
from excitant.robots.html_table import html_table
from excitant.robots.motion import Array, Motion, read_only
from excitant.robots.robot import Robot
from excitant.robots.torque import observation_columns

__all__ = ["Estimate", "identified_robot", "identify", "judged", "notes_on", "whitened"]


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
        study: Cut-offs and dead zone of the fit; None where not asked for.
        contest: How estimators compared; None where one was asked for.
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
    estimator: str = DESCRIPTIONS["wls"]
    knowledge: Knowledge = field(default_factory=Knowledge)
    study: Study | None = None
    contest: EstimatorChoice | None = None

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
    def sensitivity(self) -> Sensitivity | None:
        """How the result depends on the cut-off; None without a study."""
        if self.study is None:
            return None
        std = np.sqrt(np.diag(self.least_squares.covariance))
        return sensitivity(self.study, self.holdout_columns, self.series, std)

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
    tune: bool = False,
    harmonics_hz: float | Array | None = None,
) -> Estimate:
    """Identify a robot from recordings.

    Weighted least squares on the base parameters gives noise levels and base estimates; the
    semidefinite fit then gives physically consistent standard parameters. With any other
    estimator, the semidefinite fit is to the torque that its base parameters predict on these
    rows, weighted by the noise it found.

    Args:
        robot: The arm; its inertias are the prior.
        recordings: What to fit.
        validate: What to judge on; the last 30 % of each recording when empty.
        effects: Effects to estimate; friction, offset and rotor inertia when None.
        cutoff_hz: Cut-off of the torque filter [Hz].
        estimator: One of `excitant.identify.estimators.ESTIMATORS`, or ``"auto"``: chosen on an
            inner hold-out (`excitant.identify.estimator_choice`).
        tune: Choose cut-offs of joints and a velocity dead zone from the training data, and show
            how the result depends on the cut-off (`excitant.identify.cutoff`). A cut-off
            given is kept. Shapes of effects are refined (`excitant.identify.shapes`).
        knowledge: What is known of the bodies beforehand, and the kind of prior.
        harmonics_hz: Highest harmonic of the motion as planned, for all joints or each [Hz]; with
            `tune`, no cut-off below what it needs is chosen. Where None, it is looked for in
            recordings that repeat.

    Raises:
        BadInput: Knowledge that no body fulfils, or of links that the arm does not have;
            frequencies that cannot be.
        BadRecording: Recordings that cannot be used.
        BadRobot: Links without mass, so no prior.
        UnknownName: There is no such estimator.
        RankDeficient: Motion that leaves base parameters undetermined.
        Infeasible: The semidefinite solver failed.
    """
    if estimator != AUTO:
        estimator_named(estimator)  # refused before anything is computed
    prior = prior_parameters(robot)
    effects = standard_effects(robot.joints) if effects is None else tuple(effects)
    data = split(recordings, validate, cutoff_hz)
    base = base_parameters(robot, effects)
    known = knowledge or Knowledge()
    reference, rows = resting(robot, fit_rows(robot, effects, base, data), prior, known)
    said, parts = notes_on(robot, prior, data, rows.gains), fitted(recordings, validate)
    if tune:
        planned = None if harmonics_hz is None else planned_harmonics(harmonics_hz, robot.nv)
        chosen = tuned_choices(
            reference, rows, parts, estimator, prior, known,
            fixed=cutoff_hz is not None, harmonics=planned,
        )  # fmt: skip
    else:
        chosen = plain_choices(reference, rows, parts, estimator)
    rows, base, said = chosen.rows, chosen.rows.base, (*said, *chosen.notes)
    if chosen.estimator == "wls":
        fit = weighted_least_squares(rows.W[:, :, base.columns], rows.tau, base.expressions)
        R, z = whitened(rows.W, rows.tau, fit)
    else:
        fit, notes = estimated(reference, rows, recordings, validate, chosen.estimator)
        said, R = (*said, *notes), whitened(rows.W, rows.tau, fit)[0]
        z = R[:, base.columns] @ fit.beta
    physical = fit_physical(R, z, prior, rows.open_prior, knowledge=known, links=robot.links)
    found = judged(robot, rows, *chosen.widened(fit, physical), said)
    words = DESCRIPTIONS[chosen.estimator]
    return replace(
        found, estimator=words, knowledge=known, study=chosen.study, contest=chosen.contest
    )


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
        train=_train_accuracy(model, rows, physical.x),
        validate=unseen.accuracy(predicted),
        baseline=unseen.accuracy(predicted_given),
        series=unseen,
        predicted=read_only(predicted),
        predicted_given=read_only(predicted_given),
        notes=notes,
    )


def _train_accuracy(model: Robot, rows: FitRows, x: Array) -> Accuracy:
    """Accuracy on the training segments at the cut-off of judging, whatever rows were fitted."""
    data = rows.data
    if not data.tuned:
        return rows.measured.accuracy(rows.W @ x / rows.gains)
    return series(data.train).accuracy(predicted_torque(model, data.train) / rows.gains)


def notes_on(robot: Robot, prior: Array, data: Data, gains: Array) -> tuple[str, ...]:
    """What the user should know of the hold-out, the prior and the unit of torque."""
    notes = [data.holdout]
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
