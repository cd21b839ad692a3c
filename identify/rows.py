"""What is fitted and what is held out, and the regression of an arm on it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from excitant.exceptions import BadRecording
from excitant.identify.accuracy import Series, series
from excitant.identify.drive_gains import current_gains
from excitant.identify.knowledge import Knowledge
from excitant.identify.least_squares import weighted_least_squares
from excitant.identify.physical import fit_physical
from excitant.identify.preprocessing import CUTOFF_HZ, Segment, default_cutoff, prepare
from excitant.identify.prior import EffectPrior
from excitant.identify.recording import Recording
from excitant.identify.regression import Regression, regression_of
from excitant.robots.base_parameters import BaseParameters, base_parameters
from excitant.robots.effects import Effect
from excitant.robots.motion import Array
from excitant.robots.robot import Robot

FIT_SHARE = 0.7  # of each recording is fitted when no hold-out is named
_ROUNDS = 2  # until the torque that columns hold is that of the identified arm
_PRODUCTS = 2.0  # times the highest harmonic of a motion: that of centrifugal torque


@dataclass(frozen=True, eq=False)
class Data:
    """Recordings ready for fitting and for judging.

    Attributes:
        train: Segments to fit.
        validate: Segments held out.
        unit: Unit of the torque columns, ``"N·m"`` or ``"A"``.
        cutoff_hz: Cut-off of the torque filter [Hz].
        holdout: What was held out, as a sentence.
        cutoff_why: Why that cut-off, as a sentence.
    """

    train: tuple[Segment, ...]
    validate: tuple[Segment, ...]
    unit: str
    cutoff_hz: float
    holdout: str
    cutoff_why: str = ""


def split(
    recordings: Sequence[Recording],
    validate: Sequence[Recording] = (),
    cutoff_hz: float | None = None,
    harmonics_hz: float | None = None,
) -> Data:
    """Prepare recordings; without a hold-out, keep back the last 30 % of each.

    Args:
        recordings: What to fit.
        validate: What to hold out.
        cutoff_hz: Cut-off of the torque filter [Hz]. When None 10 Hz, or twice the highest
            harmonic of the motion where that is higher, or a fifth of the slowest sampling rate
            where that is lower.
        harmonics_hz: Highest harmonic of the motion as planned [Hz], where that is known.

    Raises:
        BadRecording: Recordings in different units, or too short to split.
    """
    refuse_mixed_units((*recordings, *validate))
    why = "as given"
    if cutoff_hz is None:
        wanted = max(CUTOFF_HZ, _PRODUCTS * (harmonics_hz or 0.0))
        highest = min(default_cutoff(r) for group in _parts(recordings, validate) for r in group)
        cutoff_hz = min(wanted, highest)
        why = (
            "a fifth of the lowest sampling rate, so that positions are still filtered at twice it"
            if highest < wanted
            else "twice the highest harmonic of the motion, for torque holds products of two speeds"
            if wanted > CUTOFF_HZ
            else "above the motion of arms and below their structural resonances"
        )
    train, validated = (
        tuple(s for r in group for s in prepare(r, cutoff_hz))
        for group in _parts(recordings, validate)
    )
    names = ", ".join(r.name for r in validate)
    sentence = names or "the last 30 % of each recording (no hold-out was named)"
    return Data(
        train, validated, recordings[0].unit, cutoff_hz, f"held out: {sentence}",
        f"cut-off: {cutoff_hz:.3g} Hz ({why})",
    )  # fmt: skip


def refuse_mixed_units(recordings: Sequence[Recording]) -> None:
    """Refuse recordings whose torque is not in the unit of the first."""
    for recording in recordings:
        if recording.unit != recordings[0].unit:
            raise BadRecording(
                recording.file,
                f"torque is in {recording.unit}, but in {recordings[0].unit} in "
                f"{recordings[0].file}; use recordings of one unit",
            )


def fitted(recordings: Sequence[Recording], validate: Sequence[Recording]) -> list[Recording]:
    """What is fitted: recordings as they are, or their first part where none is held out."""
    return list(_parts(recordings, validate)[0])


def _parts(
    recordings: Sequence[Recording], validate: Sequence[Recording]
) -> tuple[Iterable[Recording], Iterable[Recording]]:
    """What is fitted and what is held out, one at a time, for long recordings fill the memory."""
    if validate:
        return recordings, validate
    return (
        (r.between(0, FIT_SHARE, "first 70 %") for r in recordings),
        (r.between(FIT_SHARE, 1, "last 30 %") for r in recordings),
    )


@dataclass(frozen=True, eq=False)
class FitRows:
    """The regression of an arm: of all its parameters on the training segments.

    Attributes:
        robot: The arm; effects whose columns hold its torque take it from here.
        effects: Effects that are estimated.
        base: Base parameters of links and effects.
        data: Segments for fitting and for validation.
        gains: Torque per reading, shape (nv,) [N·m per reading].
        regression: Columns of all parameters of links and effects, and torque [N·m].
    """

    robot: Robot
    effects: tuple[Effect, ...]
    base: BaseParameters
    data: Data
    gains: Array
    regression: Regression

    @cached_property
    def measured(self) -> Series:
        """Readings."""
        return series(self.data.train)

    @property
    def tau(self) -> Array:
        """Measured torque, shape (n, nv) [N·m]."""
        return self.regression.tau

    @property
    def W(self) -> Array:
        """Columns of links and effects, shape (n, nv, p)."""
        return self.regression.W

    @property
    def reduced(self) -> Regression:
        """The regression of the base parameters."""
        return self.regression.select(self.base.columns, self.base.expressions)

    @property
    def open_prior(self) -> EffectPrior:
        """Nothing known of coefficients of effects but their signs."""
        return open_prior(self.robot, self.effects, self.regression)


def fit_rows(robot: Robot, effects: Sequence[Effect], base: BaseParameters, data: Data) -> FitRows:
    """The rows of the training segments."""
    regression = regression_of(robot, effects, data.train)
    gains = np.ones(robot.nv)
    if data.unit == "A":
        gains = torque_per_reading(robot, base, regression.W, series(data.train), data.unit)
        regression = regression.with_torque(regression.tau * gains)
    return FitRows(robot, tuple(effects), base, data, gains, regression)


def open_prior(robot: Robot, effects: Sequence[Effect], regression: Regression) -> EffectPrior:
    """Nothing known of effects but their signs; their columns are the last of the regression."""
    size = np.zeros(regression.p)
    for index, columns in zip(regression.index, regression.columns, strict=True):
        size[index] += (columns**2).sum(axis=0)
    std = _implausible(np.sqrt(size / regression.tau.size)[10 * robot.nv :], regression.tau)
    lower = np.array([p.lower for e in effects for p in e.parameters(robot)])
    return EffectPrior(np.zeros_like(std), std, lower)


def implausible_size(columns: Array, tau: Array) -> Array:
    """A hundred times the coefficient that would explain all torque, or 1e3 when silent.

    Args:
        columns: Columns of effects, shape (n, nv, e).
        tau: Torque, shape (n, nv).
    """
    return _implausible(np.sqrt((columns**2).mean(axis=(0, 1))), tau)


def _implausible(size: Array, tau: Array) -> Array:
    torque = np.sqrt((tau**2).mean())
    return np.asarray(np.where(size > 0, 100 * torque / np.where(size > 0, size, 1.0), 1e3))


def torque_per_reading(
    robot: Robot, base: BaseParameters, W: Array, measured: Series, unit: str
) -> Array:
    """Drive gains where torque came as current, ones otherwise, shape (nv,)."""
    if unit != "A":
        return np.ones(robot.nv)
    return current_gains(robot, base, W, measured.measured)[0]


def with_own_torque(rows: FitRows, prior: Array, knowledge: Knowledge) -> FitRows:
    """The rows with columns of effects that hold the torque of the identified arm.

    Columns of load, delay or elasticity hold the torque of the arm, from which that of the given
    one may be far off. The arm is identified without them first, then with those that it calls for
    itself.

    Args:
        rows: What is fitted.
        prior: Standard parameters of the prior, shape (nv, 10).
        knowledge: What is known of the bodies.
    """
    robot, effects = rows.robot, rows.effects
    apart = tuple(e for e in effects if not e.depends_on_model)
    if len(apart) == len(effects):
        return rows
    kept, at = list(range(10 * robot.nv)), 10 * robot.nv
    for effect in effects:
        count = len(effect.parameters(robot))
        kept += range(at, at + count) if effect in apart else ()
        at += count
    base, regression = base_parameters(robot, apart), rows.regression.select(kept)
    first = replace(rows, effects=apart, base=base, regression=regression)
    reference = _identified(robot, first, prior, knowledge)
    for round_ in range(_ROUNDS):
        columns = regression_of(reference, effects, rows.data.train)
        rows = replace(rows, robot=reference, regression=columns.with_torque(rows.tau))
        if round_ + 1 < _ROUNDS:
            reference = _identified(robot, rows, prior, knowledge)
    return rows


def _identified(robot: Robot, rows: FitRows, prior: Array, knowledge: Knowledge) -> Robot:
    """The arm that weighted least squares and the semidefinite fit come to."""
    fit = weighted_least_squares(rows.reduced)
    R, z = rows.regression.factor(fit.weight)
    found = fit_physical(R, z, prior, rows.open_prior, knowledge=knowledge, links=robot.links)
    return identified_robot(robot, rows.effects, found.x)


def identified_robot(robot: Robot, effects: Sequence[Effect], x: Array) -> Robot:
    """The robot with identified inertias and effects; x as in `PhysicalFit`."""
    valued, start = [], 10 * robot.nv
    for effect in effects:
        count = len(effect.parameters(robot))
        valued.append(effect.with_values(x[start : start + count]))
        start += count
    return robot.with_parameters(x[: 10 * robot.nv]).with_effects(valued)
