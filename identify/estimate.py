"""`identify`: from recordings to a physically consistent model, judged on a hold-out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import scipy

from excitant.exceptions import UnknownName
from excitant.identify import tables
from excitant.identify.accuracy import (
    Accuracy,
    PredictionInterval,
    Series,
    prediction_interval,
    series,
)
from excitant.identify.drive_gains import BODY_STD, DriveGains
from excitant.identify.estimators import (
    ESTIMATORS,
    FALSE_ALARM,
    estimated,
    spoiled,
    without_gross_errors,
)
from excitant.identify.information import square_root
from excitant.identify.knowledge import Knowledge
from excitant.identify.least_squares import LeastSquares, weighted_least_squares
from excitant.identify.physical import AGREEMENT, PhysicalFit, fit_physical
from excitant.identify.poses import (
    SHOWN,
    kept,
    pose_rows,
    pose_segment,
    scatter,
)
from excitant.identify.preprocessing import Segment, prepare
from excitant.identify.prior import (
    BodyPrior,
    placeholder_links,
    prior_parameters,
)
from excitant.identify.recording import (
    Recording,
    Recordings,
    recordings_of,
    shows_poses,
)
from excitant.identify.regression import regression_of
from excitant.identify.repeats import (
    Difference,
    Repeats,
    differences,
    repeats_of,
)
from excitant.identify.reversals import (
    Turning,
    turned_rows,
    turning_notes,
    turning_spread,
)
from excitant.identify.rows import (
    Data,
    FitRows,
    Poses,
    effects_of,
    fit_rows,
    fitted,
    gains_of,
    identified_robot,
    places_of,
    predicted_torque,
    refuse_other_units,
    split,
    units_of,
)
from excitant.identify.shapes import Shapes, refined_shapes, widened
from excitant.identify.unmodelled import (
    Delay,
    Fits,
    allowing_for_springs,
    delay_of,
    impossible_values,
    of_noise,
    spread_of,
)
from excitant.robots.base_parameters import (
    BaseParameters,
    base_parameters,
    categories,
)
from excitant.robots.effects import Effect, plain
from excitant.robots.motion import Array, Mask, Motion, interpolated, read_only
from excitant.robots.parameters import BaseEstimate, is_covariance, violations
from excitant.robots.robot import Robot
from excitant.robots.shown import Shown, Table, data_frame, worst_and_median
from excitant.robots.threads import on_one_thread
from excitant.robots.torque import torque

if TYPE_CHECKING:
    import pandas as pd


BIASED = ("wls", "irls")
"""Estimators that noise of the motion biases."""
TORQUE_ROUNDS = 2
"""Fits until the torque that columns hold is that of the identified arm."""
_LACKING = (
    "the data are {:.2g} times further from what any possible arm does than noise explains: the "
    "model lacks something, and the ± of all parameters are as many times wider"
)


@dataclass(frozen=True, eq=False, repr=False)
class Estimate(Shown):
    """Result of an identification.

    Attributes:
        given: The robot as given.
        model: The identified robot: physically consistent inertias, effects with values, and its
            base parameters with their covariance.
        base: Base parameters of links and effects together.
        least_squares: Estimate of the base parameters.
        physical: Physically consistent fit of all parameters.
        base_std: Standard deviations of the base parameters, those of drive gains included; NaN
            where they rest on gains that are not known.
        std: The same of the parameters that torque shows alone, in the units in which they are
            told; NaN of all others, of which any would be the prior's, and of those that the data
            put where physics does not allow them (`impossible_values`).
        data: What was fitted and held out.
        notes: What the user should know, as sentences.
        drive: Drive gains, if torque was recorded as current.
        estimator: How the base parameters were estimated, in words.
        knowledge: What was taken for known of the bodies.
        shapes: Shapes of effects, refined where that fits better; None where there are none.
        repeats: Whether the recordings agree; None of a single one.
        reversals: Dry friction that turns over a range of speeds, as the data show.
        differences: What single recordings, those held out among them, have otherwise.
    """

    given: Robot
    model: Robot
    base: BaseParameters
    least_squares: LeastSquares
    physical: PhysicalFit
    std: Array
    base_std: Array
    data: Data
    notes: tuple[str, ...]
    drive: DriveGains | None = None
    estimator: str = ESTIMATORS["wls"]
    knowledge: Knowledge = field(default_factory=Knowledge)
    shapes: Shapes | None = None
    repeats: Repeats | None = None
    reversals: tuple[Turning, ...] = ()
    differences: tuple[Difference, ...] = ()

    @property
    def gains(self) -> Array:
        """Torque per reading, shape (nv,): drive gains of currents [N·m/A], ones otherwise."""
        return read_only(gains_of(self.given, self.data, self.drive))

    @property
    def undetermined(self) -> str:
        """Which drive gains are not known, and why, as a sentence; empty where there are none."""
        return self.drive.undetermined(self.given.joints) if self.drive else ""

    @cached_property
    def _fitted(self) -> tuple[Series, Array]:
        """Rows of the fit, and the model's torque there, shape (n, nv) [torque unit]."""
        predicted = predicted_torque(self.model, self.data.train) / self.gains
        rows = series(self.data.train, self.data.poses)
        return rows, read_only(predicted)

    @cached_property
    def train(self) -> Accuracy:
        """Accuracy of the model on the rows of the fit."""
        rows, predicted = self._fitted
        return rows.accuracy(predicted)

    @cached_property
    def holdout(self) -> Series:
        """Rows of the hold-out."""
        return series(self.data.validate, self.data.poses)

    @cached_property
    def predicted(self) -> Array:
        """Torque of the model at the rows of the hold-out, shape (n, nv) [torque unit]."""
        return read_only(
            predicted_torque(self.model, self.data.validate) / self.gains
        )

    @cached_property
    def predicted_given(self) -> Array:
        """Torque of the given robot at these rows, shape (n, nv) [torque unit]."""
        return read_only(
            predicted_torque(self.given, self.data.validate) / self.gains
        )

    @cached_property
    def validate(self) -> Accuracy:
        """Accuracy of the model on the hold-out."""
        return self.holdout.accuracy(self.predicted)

    @cached_property
    def baseline(self) -> Accuracy:
        """Accuracy of the given robot on the hold-out."""
        return self.holdout.accuracy(self.predicted_given)

    @property
    def phi(self) -> Array:
        """Identified standard parameters, shape (10 nv,)."""
        return read_only(self.physical.x[: 10 * self.given.nv])

    @cached_property
    def holdout_columns(self) -> Array:
        """Columns of the base parameters at the rows of the hold-out, shape (n, nv, r)."""
        regression = regression_of(
            self.model, self.model.effects, self.data.validate
        )
        return read_only(regression.select(self.base.columns).W)

    @cached_property
    def interval(self) -> PredictionInterval:
        """95 % intervals of readings at the rows of the hold-out."""
        W = self.holdout_columns
        fit = self.least_squares
        rows, predicted = self._fitted
        residuals = rows.counted(rows.measured - predicted)
        return prediction_interval(W, fit, residuals, self.gains)

    def result(self) -> dict[str, Any]:
        """Machine-readable result of `identify`."""
        return tables.result_of(self)

    def predict(self, recording: Recording, *, filtered: bool = True) -> Array:
        """Torque of the model at the instants of a recording, shape (n, nv) [torque unit].

        It is that of the motion as `identify_robot` sees it: positions are filtered at twice the
        cut-off. As measured torque is, it then passes the torque filter, if ``filtered``, whose
        ends say little. NaN where samples are too few to be filtered.
        """
        (run,) = _alike(self, recording)
        predicted = np.full(run.tau.shape, np.nan)
        for s in _segments(run, self.data, self.given):
            if s.of_poses:
                still = Motion(run.t, run.q, 0 * run.q, 0 * run.q)
                return read_only(torque(self.model, still) / self.gains)
            tau = torque(self.model, s.motion) / self.gains
            t = s.motion.t
            if filtered:
                tau = s.filtered(tau)
            inside = (run.t >= t[0]) & (run.t < t[-1] + 1 / s.rate_hz)
            predicted[inside] = interpolated(run.t[inside], t, tau)
        return read_only(predicted)

    def score(self, recordings: Recordings) -> list[dict[str, Any]]:
        """Accuracy of the model on recordings joint by joint, as ``result.json`` has it.

        ``rms``, ``rms_raw`` [torque unit], ``nrmse`` and ``r2`` while the joint moves, which is the
        share ``judged`` of the rows, and ``rms_all`` of all, below the cut-off of this estimate.
        """
        rows = [
            s
            for recording in _alike(self, recordings)
            for s in _segments(recording, self.data, self.given)
        ]
        predicted = predicted_torque(self.model, rows) / self.gains
        return series(rows).accuracy(predicted).entries(self.given.joints)

    def to_frame(
        self,
        of: Literal[
            "parameters", "base_parameters", "joints", "links"
        ] = "parameters",
    ) -> pd.DataFrame:
        """Records of ``result.json`` of one kind, a row each."""
        names = {"parameters": "name", "base_parameters": "expression"}
        names |= {"joints": "name", "links": "link"}
        UnknownName.refuse("table", [of], names)
        return data_frame(self.result()[of], names[of])

    def series(self) -> dict[str, Array]:
        """Torques and states on the hold-out, each of shape (n, nv), and curves of friction."""
        return tables.series_of(self)

    def _lines(self) -> list[str]:
        joints = self.given.joints
        errors = (
            worst_and_median(joints, x.nrmse)
            for x in (self.baseline, self.validate)
        )
        where = (
            "at rest" if self.data.poses else f"below {self.data.cutoff_hz:.3g} Hz"
        )
        broken = violations(self.phi, self.given.links)
        effects = self.model.effects
        return [
            f"Estimate of {self.given.name} ({self.estimator}), on the hold-out",
            f"error at most {' → '.join(errors)} (nrmse, {where})",
            f"{len(self.base)} base parameters, {'not ' * bool(broken)}physically consistent; "
            f"effects: {', '.join(dict.fromkeys(plain(e.name) for e in effects)) or 'none'}",
        ]

    def _table(self) -> Table:
        columns = (
            self.baseline.rms,
            self.validate.rms,
            self.validate.nrmse,
            self.validate.r2,
        )
        rows = zip(
            self.given.joints, *(column.tolist() for column in columns), strict=True
        )
        heads = ("joint", "rms error as given", "identified", "nrmse", "r²")
        return heads, rows


def _segments(recording: Recording, data: Data, robot: Robot) -> Sequence[Segment]:
    """Segments of a recording, of which poses are one, filtered as the data of a fit."""
    if shows_poses(recording):
        return [pose_segment(recording, robot)]
    cutoff_hz = data.cutoff_hz
    if data.delay:
        recording = Delay(data.delay).on_time(recording)
    return prepare(recording, cutoff_hz if cutoff_hz < np.inf else None)


def _alike(estimate: Estimate, recordings: Recordings) -> list[Recording]:
    """Recordings whose torque has the unit of an estimate's."""
    found = recordings_of(recordings, estimate.given)
    refuse_other_units(found, estimate.data.unit, "where it was identified")
    return found


@on_one_thread
def identify_robot(
    robot: Robot,
    recordings: Recordings,
    *,
    validate: Recordings = (),
    effects: Sequence[Effect] | None = None,
    cutoff_hz: float | None = None,
    estimator: str | None = None,
    knowledge: Knowledge | None = None,
    harmonics_hz: float | None = None,
    turning: bool | None = None,
) -> Estimate:
    """Identify a robot from recordings.

    Weighted least squares gives noise levels and base parameters; the semidefinite fit then gives
    physically consistent standard parameters. With any other estimator, that fit is to the torque
    that its base parameters predict on these rows, weighted by the noise it found. Shapes of
    effects, in which torque is not linear, are refined where that fits better.

    Args:
        robot: The arm; its inertias are the prior.
        recordings: What to fit.
        validate: What to judge on; the last 30 % of each recording when empty.
        effects: Effects to estimate; friction, offset and rotor inertia when None.
        cutoff_hz: Cut-off of the torque filter [Hz]; see `excitant.identify.split`.
        estimator: One of `excitant.identify.estimators.ESTIMATORS`; when None weighted least
            squares, on smoothed positions where the recordings show coarse ones, or robust
            regression where they show gross errors of torque, which a note tells.
        knowledge: What is known of the bodies beforehand.
        harmonics_hz: Highest harmonic of the motion as planned [Hz], which the filter passes.
        turning: Whether Coulomb friction may turn over a range of speeds at reversals, where that
            predicts better; when None if effects are None.

    Raises:
        BadInput: Knowledge that no body fulfils, or of links that the arm does not have.
        BadRecording: Recordings that cannot be used.
        BadRobot: A link of negative mass.
        UnknownName: There is no such estimator.
        RankDeficient: Motion that leaves base parameters undetermined.
        Infeasible: An estimator does not converge, or knowledge leaves no room.
    """
    UnknownName.refuse("estimator", [estimator or "wls"], ESTIMATORS)
    recordings = recordings_of(recordings, robot)
    validate = recordings_of(validate, robot)
    prior = prior_parameters(robot)
    known = (knowledge or Knowledge()).of(robot)
    default = effects is None
    gradual = default if turning is None else turning
    effects = effects_of(robot, effects)
    if default and recordings and all(map(shows_poses, (*recordings, *validate))):
        return _of_poses(robot, recordings, validate, prior, known)
    data = split(recordings, validate, cutoff_hz, harmonics_hz)
    rows, turns = _motion_rows(robot, effects, data, gradual)
    delay = delay_of(rows)
    if delay is not None:
        on_time = {each: delay.on_time(each) for each in (*recordings, *validate)}
        recordings = [on_time[each] for each in recordings]
        validate = [on_time[each] for each in validate]
        data = split(recordings, validate, cutoff_hz, harmonics_hz)
        data = replace(data, delay=delay.value)
        rows, turns = _motion_rows(robot, effects, data, gradual)
    rows = with_own_torque(rows, prior, known)
    notes = (*notes_on(rows, prior), *turning_notes(turns, robot))
    shapes = refined_shapes(rows, prior, known)
    if shapes is not None:
        if shapes.better:
            rows = shapes.rows(rows)
        notes += (shapes.sentence,)
    logs = fitted(recordings, validate)
    rows, fit, name, remarks = estimated(rows, logs, estimator)
    noise = of_noise(rows, fit)
    if name in BIASED:
        fit = _with_bias(rows, fit, noise)
    sound = rows
    if name == "irls":
        tau = without_gross_errors(rows.reduced, fit)
        sound = replace(rows, regression=rows.regression.with_torque(tau))
    fit, physical, told = _with_bodies(sound, fit, noise, prior, known, name)
    remarks += told
    spreads = [shapes.spread] if shapes is not None and shapes.better else []
    if turns:
        spreads.append(turning_spread(rows, fit, physical.covariance))
    if delay is not None:
        spreads.append(spread_of(delay, rows, fit, physical.covariance))
        remarks += (delay.sentence,)
    if spreads:
        fit, physical = widened(fit, physical, rows.base, np.hstack(spreads))
    estimate = judged(robot, rows, fit, physical, (*notes, *remarks))
    return replace(
        estimate,
        estimator=ESTIMATORS[name],
        knowledge=known,
        shapes=shapes,
        repeats=repeats_of(rows.reduced, fit, data.train),
        reversals=turns,
        differences=tuple(differences(estimate.model, rows, fit)),
    )


def _with_bodies(
    rows: FitRows,
    fit: LeastSquares,
    noise: Array,
    prior: Array,
    known: Knowledge,
    name: str,
) -> Fits:
    """Both fits by an estimator, beside springs if any, and what is told of what the model lacks.

    Where it lacks something, the data contradict no mass: those that no description misses so far
    are fitted anew, to data that are as much less certain.
    """

    def fitted_to(fit: LeastSquares, times: float) -> Fits:
        R, z = rows.regression.factor(fit.weight)
        if name != "wls":
            z = R[:, rows.base.columns] @ fit.beta
        physical, near = _bodies(R, z, prior, rows, known, firm=times > 1)
        return allowing_for_springs(rows, fit, physical, noise, near, times)

    wider, physical, told = fitted_to(fit, 1.0)
    times = _beyond_noise(rows, wider, physical, known)
    if times == 1:
        return wider, physical, told
    masses = physical.x[: len(prior) * 10 : 10] / prior[:, 0]
    change = np.abs(np.log(masses[_described(rows.robot)]))
    if (change > np.log(tables.IMPOSSIBLE_CHANGE)).any():
        wider, physical, told = fitted_to(fit.widened(times), times)
    else:
        wider = wider.widened(times)
        physical = physical.widened(times)
    return wider, physical, (*told, _LACKING.format(times))


def _beyond_noise(
    rows: FitRows, fit: LeastSquares, physical: PhysicalFit, known: Knowledge
) -> float:
    """How many times further from all possible arms the data are than by their ±; 1 by chance.

    Birge's ratio √(χ² / freedom), of what bodies could not follow (Birge 1932): those of a fit, and
    if it is not theirs by chance, of one by the covariance of the base parameters.
    """
    root = square_root(fit.uncertainty)
    R, z = (
        scipy.linalg.solve_triangular(root, values, lower=True)
        for values in (rows.base.regrouping, fit.beta)
    )

    def ratio(physical: PhysicalFit) -> float:
        misfit = ((R @ physical.x - z) ** 2).sum()
        freedom = max(len(z) - physical.followed, 1.0)
        by_chance = misfit < scipy.special.chdtri(freedom, FALSE_ALARM)
        return 1.0 if by_chance else float(np.sqrt(misfit / freedom))

    if ratio(physical) == 1:
        return 1.0
    links = rows.robot.links
    return ratio(fit_physical(R, z, physical.prior, rows.open_prior, known, links))


def _described(robot: Robot) -> Mask:
    """Links of whose mass the robot tells something, but the last: that may carry any tool."""
    described = ~placeholder_links(robot)
    described[-1] = False
    return described


def _bodies(
    R: Array,
    z: Array,
    prior: Array,
    rows: FitRows,
    known: Knowledge,
    firm: bool,
) -> tuple[PhysicalFit, Knowledge]:
    """The physically consistent fit, and what it takes for known.

    Descriptions tell masses better than shapes, torque tells them worse: they are near the given
    ones if that is firm, or where these, and the torque then left, are off by chance.
    """
    robot = rows.robot

    def fitted_with(bodies: Array | BodyPrior, knowledge: Knowledge) -> PhysicalFit:
        effects = rows.open_prior
        return fit_physical(R, z, bodies, effects, knowledge, robot.links)

    free = fitted_with(prior, known)
    told = _described(robot)
    given = prior[told, 0]
    if not len(given):
        return free, known
    links = np.array(robot.links)[told].tolist()
    near = known.near(dict(zip(links, given.tolist(), strict=True)), BODY_STD)
    tied = fitted_with(free.prior, near)
    left, least = (((R @ fit.x - z) ** 2).sum() for fit in (tied, free))
    off = (tied.x[: 10 * robot.nv : 10][told] / given - 1) / BODY_STD
    chance = scipy.special.chdtri(len(given), AGREEMENT.false_alarm)
    by_chance = left - least + off @ off < chance
    return (tied, near) if firm or by_chance else (free, known)


def _motion_rows(
    robot: Robot, effects: Sequence[Effect], data: Data, gradual: bool
) -> tuple[FitRows, tuple[Turning, ...]]:
    """Rows of a fit, and where dry friction turns over a range of speeds, if it may."""
    problem = robot, effects, base_parameters(robot, effects), data
    return turned_rows(*problem, spoiled) if gradual else (fit_rows(*problem), ())


def _of_poses(
    robot: Robot,
    recordings: Sequence[Recording],
    validate: Sequence[Recording],
    prior: Array,
    known: Knowledge,
) -> Estimate:
    """The estimate from poses of an arm at rest; see `excitant.identify.poses`."""
    rows = pose_rows(robot, recordings, validate)
    unexplained = scatter(rows)
    fit = weighted_least_squares(rows.reduced)
    whitened = rows.regression.factor(fit.weight)
    notes = notes_on(rows, prior)
    estimate = estimate_by(robot, rows, fit, whitened, notes, known)
    return replace(
        estimate,
        # base parameters of gravity are no prior of a motion's
        model=replace(estimate.model, estimate=None),
        data=replace(rows.data, poses=Poses(SHOWN * unexplained, kept(robot))),
    )


def _with_bias(rows: FitRows, fit: LeastSquares, noise: Array) -> LeastSquares:
    """The fit with its bias by noise of the motion, to first order, in its covariance."""
    R, _ = rows.reduced.factor(1 / fit.sigma)
    bias = np.linalg.solve(R.T @ R, noise)
    return replace(fit, covariance=fit.covariance + np.outer(bias, bias))


def judged(
    robot: Robot,
    rows: FitRows,
    fit: LeastSquares,
    physical: PhysicalFit,
    notes: tuple[str, ...],
) -> Estimate:
    """The estimate of a robot as given from rows, with base parameters and physical ones.

    Uncertain drive gains k of currents add J C Jᵀ to the covariances, C that of log k. A gain
    scales its joint's torque, so the columns of J are A⁻¹ W_jᵀ W_j β, A that of normal equations.
    Predicted currents rest on no gain, so the least-squares covariance stays as it is. What rests
    on gains that are not known has no standard deviation worth the name: it is NaN.
    """
    drive = rows.drive
    widened = fit.uncertainty
    unknown = np.zeros(len(widened), bool)
    if drive is not None:
        pull = rows.by_gain(fit.weight, fit.beta)
        R, _ = rows.reduced.factor(fit.weight)
        J = read_only(np.linalg.solve(R.T @ R, pull[list(rows.base.columns)]))
        widened = widened + J @ drive.covariance @ J.T
        unknown = _rests_on_unknown(fit.covariance, J, drive)
        # what is told in amperes rests on no gain
        units = units_of(robot, rows.effects, drive)
        in_torque = [factor == 1 for factor, _ in units]
        J = physical.covariance @ pull * np.array(in_torque)[:, None]
        wider = physical.covariance + J @ drive.covariance @ J.T
        physical = replace(physical, covariance=wider)
    base_std = np.where(unknown, np.nan, np.sqrt(np.diag(widened)))
    model = identified_robot(robot, rows.effects, physical.x)
    model = model.with_effects([*model.effects, *physical.springs])
    if is_covariance(widened):
        beta = rows.base.regrouping @ physical.x if physical.springs else fit.beta
        model = replace(
            model, estimate=BaseEstimate(rows.base.leading, beta, widened)
        )
    notes += () if drive is None else (drive.sentence(robot.joints),)
    notes += (physical.note,) if physical.note else ()
    return Estimate(
        given=robot,
        model=model,
        base=rows.base,
        least_squares=fit,
        physical=physical,
        std=_of_parameters(rows, fit, base_std),
        base_std=base_std,
        data=rows.data,
        notes=notes,
        drive=drive,
    )


def _rests_on_unknown(covariance: Array, J: Array, drive: DriveGains) -> Mask:
    """What rests mostly on drive gains that are not known, shape (r,).

    J, shape (r, nv), is what relative changes of the gains add; the covariance lacks that.
    """
    by_unknown, by_known = (
        np.einsum("pj,jk,pk->p", J[:, g], drive.covariance[np.ix_(g, g)], J[:, g])
        for g in (~drive.known, drive.known)
    )
    certain = np.diag(covariance) + by_known
    parts = np.abs(J)
    mostly = 2 * parts[:, ~drive.known].sum(axis=1) > parts.sum(axis=1)
    return mostly | (by_unknown > certain)


def _of_parameters(rows: FitRows, fit: LeastSquares, base_std: Array) -> Array:
    """Standard deviations of parameters that are base parameters by themselves, else NaN, (p,)."""
    base = rows.base
    std = np.full(len(base.names), np.nan)
    units = units_of(rows.robot, rows.effects, rows.drive)
    category = categories(base)
    of_readings = np.sqrt(np.diag(fit.uncertainty))
    impossible = impossible_values(rows.robot, rows.effects, base, fit)
    for i, k in enumerate(base.columns):
        if category[k] == "unique" and i not in impossible:
            factor, _ = units[k]
            # amperes do not depend on the gain
            std[k] = base_std[i] if factor == 1 else factor * of_readings[i]
    return std


def estimate_by(
    robot: Robot,
    rows: FitRows,
    fit: LeastSquares,
    whitened: tuple[Array, Array],
    notes: tuple[str, ...],
    knowledge: Knowledge | None = None,
) -> Estimate:
    """The estimate with bodies fitted to whitened rows R x ≈ z of all parameters."""
    known = knowledge or Knowledge().of(robot)
    prior = prior_parameters(robot)
    physical = fit_physical(*whitened, prior, rows.open_prior, known, robot.links)
    return replace(judged(robot, rows, fit, physical, notes), knowledge=known)


def notes_on(rows: FitRows, prior: Array) -> tuple[str, ...]:
    """Notes on the hold-out, the cut-off and the prior."""
    robot = rows.robot
    notes = [rows.data.holdout, rows.data.cutoff_why]
    if rows.data.sensors is not None:
        notes.append(rows.data.sensors.sentence(robot.joints))
    if rows.rests:
        notes.append(rows.rests)
    nominal = robot.phi.reshape(-1, 10)
    impossible = [
        link
        for link, phi, used in zip(robot.links, nominal, prior, strict=True)
        if not np.allclose(phi, used)
    ]
    if impossible:
        notes.append(
            f"the given inertia of {', '.join(impossible)} is one no body can have; "
            "the nearest possible one serves as prior"
        )
    return tuple(notes)


def with_own_torque(rows: FitRows, prior: Array, knowledge: Knowledge) -> FitRows:
    """The rows with columns of effects that hold the torque of the identified arm.

    Columns of load, delay or elasticity hold the torque of the arm, from which that of the given
    one may be far off. The arm is identified without them first, then with those that it
    selects. The prior has shape (nv, 10).
    """
    robot = rows.robot
    effects = rows.effects
    alone = tuple(e for e in effects if not e.physics.on_model)
    if len(alone) == len(effects):
        return rows
    columns = list(range(10 * robot.nv))
    for effect, own in places_of(robot, effects):
        if not effect.physics.on_model:
            columns += range(own.start, own.stop)
    current = replace(
        rows,
        effects=alone,
        base=base_parameters(robot, alone),
        regression=rows.regression.select(columns),
    )
    for _ in range(TORQUE_ROUNDS):
        weight = weighted_least_squares(current.reduced).weight
        R, z = current.regression.factor(weight)
        fit = fit_physical(
            R, z, prior, current.open_prior, knowledge=knowledge, links=robot.links
        )
        reference = identified_robot(robot, current.effects, fit.x)
        regression = regression_of(reference, effects, rows.data.train)
        current = replace(
            rows, robot=reference, regression=rows.fitting(regression)
        )
    return current
