"""`identify`: from recordings to a physically consistent model, judged on a hold-out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from excitant.exceptions import BadRecording
from excitant.identify.accuracy import Accuracy, Series, predicted_torque, series
from excitant.identify.drive_gain import drive_gains
from excitant.identify.least_squares import LeastSquares, weighted_least_squares
from excitant.identify.physical import EffectPrior, PhysicalFit, fit_physical, prior_parameters
from excitant.identify.preprocessing import Segment, prepare
from excitant.identify.recording import Recording
from excitant.robots.base_parameters import BaseParameters, base_parameters
from excitant.robots.effects import Effect, standard_effects
from excitant.robots.motion import Array, Motion, read_only
from excitant.robots.robot import Robot
from excitant.robots.torque import observation_columns

FIT_SHARE = 0.7  # of each recording is fitted when no hold-out is named


@dataclass(frozen=True, eq=False)
class Data:
    """Recordings ready for fitting and for judging.

    Attributes:
        train: Segments to fit.
        validate: Segments held out.
        unit: Unit of the torque columns, ``"N·m"`` or ``"A"``.
        cutoff_hz: Cut-off of the torque filter [Hz].
        holdout: What was held out, as a sentence.
    """

    train: tuple[Segment, ...]
    validate: tuple[Segment, ...]
    unit: str
    cutoff_hz: float
    holdout: str


def split(
    recordings: Sequence[Recording],
    validate: Sequence[Recording] = (),
    cutoff_hz: float | None = None,
) -> Data:
    """Prepare recordings; without a hold-out, keep back the last 30 % of each.

    Raises:
        BadRecording: Recordings in different units, or too short to split.
    """
    for recording in (*recordings, *validate):
        if recording.unit != recordings[0].unit:
            raise BadRecording(
                recording.file,
                f"torque is in {recording.unit}, but in {recordings[0].unit} in "
                f"{recordings[0].file}; use recordings of one unit",
            )
    if validate:
        parts, held = list(recordings), list(validate)
        sentence = f"held out: {', '.join(r.name for r in validate)}"
    else:
        parts = [r.between(0, FIT_SHARE, "first 70 %") for r in recordings]
        held = [r.between(FIT_SHARE, 1, "last 30 %") for r in recordings]
        sentence = "held out: the last 30 % of each recording (no hold-out was named)"
    if cutoff_hz is None:
        cutoff_hz = min(prepare(r)[0].cutoff_hz for r in (*parts, *held))
    train, validated = (
        tuple(s for r in group for s in prepare(r, cutoff_hz)) for group in (parts, held)
    )
    return Data(train, validated, recordings[0].unit, cutoff_hz, sentence)


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

    @property
    def phi(self) -> Array:
        """Identified standard parameters, shape (10 nv,)."""
        return read_only(self.physical.x[: 10 * self.given.nv])


def identify(
    robot: Robot,
    recordings: Sequence[Recording],
    *,
    validate: Sequence[Recording] = (),
    effects: Sequence[Effect] | None = None,
    cutoff_hz: float | None = None,
) -> Estimate:
    """Identify a robot from recordings.

    Weighted least squares on the base parameters gives noise levels and base estimates; the
    semidefinite fit then gives physically consistent standard parameters.

    Args:
        robot: The arm; its inertias are the prior.
        recordings: What to fit.
        validate: What to judge on; the last 30 % of each recording when empty.
        effects: Effects to estimate; friction, offset and rotor inertia when None.
        cutoff_hz: Cut-off of the torque filter [Hz].

    Raises:
        BadRecording: Recordings that cannot be used.
        BadRobot: Links without mass, so no prior.
        RankDeficient: Motion that leaves base parameters undetermined.
        Infeasible: The semidefinite solver failed.
    """
    prior = prior_parameters(robot)
    effects = standard_effects(robot.joints) if effects is None else tuple(effects)
    data = split(recordings, validate, cutoff_hz)
    base = base_parameters(robot, effects)
    W = observation(robot, effects, data.train)
    measured = series(data.train)
    gains = torque_per_reading(robot, base, W, measured, data.unit)
    tau = measured.measured * gains
    fit = weighted_least_squares(W[:, :, base.columns], tau, base.expressions)
    R, z = whitened(W, tau, fit)
    physical = fit_physical(R, z, prior, _open_prior(robot, effects, W, tau))
    model = identified_robot(robot, effects, physical.x)
    rows = series(data.validate)
    predicted = predicted_torque(model, data.validate) / gains
    predicted_given = predicted_torque(robot, data.validate) / gains
    return Estimate(
        given=robot,
        model=model,
        base=base,
        least_squares=fit,
        physical=physical,
        prior=read_only(prior.ravel()),
        gains=read_only(gains),
        data=data,
        train=measured.accuracy(W @ physical.x / gains),
        validate=rows.accuracy(predicted),
        baseline=rows.accuracy(predicted_given),
        series=rows,
        predicted=read_only(predicted),
        predicted_given=read_only(predicted_given),
        notes=_notes(robot, prior, data, gains),
    )


def observation(robot: Robot, effects: Sequence[Effect], segments: Sequence[Segment]) -> Array:
    """Filtered columns of links and effects at the rows of all segments, (n, nv, p)."""

    def columns(motion: Motion) -> Array:
        return observation_columns(robot, effects, motion)

    return np.concatenate([segment.rows(columns) for segment in segments])


def whitened(W: Array, tau: Array, fit: LeastSquares) -> tuple[Array, Array]:
    """QR factor (R, z) of the weighted problem, so that ‖R x − z‖² is −2 log-likelihood.

    Autocorrelated residuals count by their number of independent samples.
    """
    weight = 1 / (fit.sigma * np.sqrt(fit.inflation))
    rows = np.concatenate([W, tau[:, :, None]], axis=2) * weight[:, None]
    flat = rows.reshape(-1, rows.shape[2])
    R = np.asarray(scipy.linalg.qr(flat, mode="r")[0], float)[: rows.shape[2]]
    return R[:, :-1], R[:, -1]


def identified_robot(robot: Robot, effects: Sequence[Effect], x: Array) -> Robot:
    """The robot with identified inertias and effects; x as in `PhysicalFit`."""
    valued, start = [], 10 * robot.nv
    for effect in effects:
        count = len(effect.parameters(robot))
        valued.append(effect.with_values(x[start : start + count]))
        start += count
    return robot.with_parameters(x[: 10 * robot.nv]).with_effects(valued)


def torque_per_reading(
    robot: Robot, base: BaseParameters, W: Array, measured: Series, unit: str
) -> Array:
    """Drive gains where torque came as current, ones otherwise, shape (nv,)."""
    if unit != "A":
        return np.ones(robot.nv)
    links = 10 * robot.nv
    columns = [c for c in base.columns if c < links]
    given = W[:, :, :links] @ robot.phi
    return drive_gains(W[:, :, columns], W[:, :, links:], measured.measured, given)


def _open_prior(robot: Robot, effects: Sequence[Effect], W: Array, tau: Array) -> EffectPrior:
    """Nothing known of effects but their signs."""
    std = implausible_size(W[:, :, 10 * robot.nv :], tau)
    lower = np.array([p.lower for e in effects for p in e.parameters(robot)])
    return EffectPrior(np.zeros_like(std), std, lower)


def implausible_size(columns: Array, tau: Array) -> Array:
    """A hundred times the coefficient that would explain all torque, or 1e3 when silent.

    Args:
        columns: Columns of effects, shape (n, nv, e).
        tau: Torque, shape (n, nv).
    """
    size = np.sqrt((columns**2).mean(axis=(0, 1)))
    torque = np.sqrt((tau**2).mean())
    return np.asarray(np.where(size > 0, 100 * torque / np.where(size > 0, size, 1.0), 1e3))


def _notes(robot: Robot, prior: Array, data: Data, gains: Array) -> tuple[str, ...]:
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
