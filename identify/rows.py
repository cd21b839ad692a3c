"""What is fitted and what is held out: recordings as rows of the identification problem."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from excitant.exceptions import BadRecording
from excitant.identify.accuracy import Series, series
from excitant.identify.current_gains import current_gains
from excitant.identify.physical import EffectPrior
from excitant.identify.preprocessing import Segment, prepare
from excitant.identify.recording import Recording
from excitant.robots.base_parameters import BaseParameters
from excitant.robots.effects import Effect
from excitant.robots.motion import Array, Motion
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
        tuned: The segments to fit with rows as they are fitted, where these differ from `train`,
            whose rows are those that are judged; empty where they do not.
    """

    train: tuple[Segment, ...]
    validate: tuple[Segment, ...]
    unit: str
    cutoff_hz: float
    holdout: str
    tuned: tuple[Segment, ...] = ()

    @property
    def to_fit(self) -> tuple[Segment, ...]:
        """Segments whose rows are fitted."""
        return self.tuned or self.train


def split(
    recordings: Sequence[Recording],
    validate: Sequence[Recording] = (),
    cutoff_hz: float | None = None,
) -> Data:
    """Prepare recordings; without a hold-out, keep back the last 30 % of each.

    Raises:
        BadRecording: Recordings in different units, or too short to split.
    """
    refuse_mixed_units((*recordings, *validate))
    held = list(validate) or [held_out(r) for r in recordings]
    sentence = holdout_sentence([r.name for r in validate])
    parts = fitted(recordings, validate)
    if cutoff_hz is None:
        cutoff_hz = min(prepare(r)[0].cutoff_hz for r in (*parts, *held))
    train, validated = (
        tuple(s for r in group for s in prepare(r, cutoff_hz)) for group in (parts, held)
    )
    return Data(train, validated, recordings[0].unit, cutoff_hz, sentence)


def refuse_mixed_units(recordings: Sequence[Recording]) -> None:
    """Refuse recordings whose torque is not in the unit of the first."""
    for recording in recordings:
        if recording.unit != recordings[0].unit:
            raise BadRecording(
                recording.file,
                f"torque is in {recording.unit}, but in {recordings[0].unit} in "
                f"{recordings[0].file}; use recordings of one unit",
            )


def holdout_sentence(names: Sequence[str]) -> str:
    """What is held out, given the names of hold-outs, if any."""
    if names:
        return f"held out: {', '.join(names)}"
    return "held out: the last 30 % of each recording (no hold-out was named)"


def fitted(recordings: Sequence[Recording], validate: Sequence[Recording]) -> list[Recording]:
    """What is fitted: recordings as they are, or their first part where none is held out."""
    if validate:
        return list(recordings)
    return [r.between(0, FIT_SHARE, "first 70 %") for r in recordings]


def held_out(recording: Recording) -> Recording:
    """What is held out of a recording where no hold-out is named."""
    return recording.between(FIT_SHARE, 1, "last 30 %")


@dataclass(frozen=True, eq=False)
class FitRows:
    """What is fitted: filtered columns and torque of the training segments.

    Attributes:
        effects: Effects that are estimated.
        base: Base parameters of links and effects.
        data: Segments for fitting and for validation.
        W: Columns of links and effects, shape (n, nv, p).
        measured: Readings.
        gains: Torque per reading, shape (nv,) [N·m per reading].
        open_prior: Nothing known of effects but their signs.
    """

    effects: tuple[Effect, ...]
    base: BaseParameters
    data: Data
    W: Array
    measured: Series
    gains: Array
    open_prior: EffectPrior

    @property
    def tau(self) -> Array:
        """Measured torque, shape (n, nv) [N·m]."""
        return np.asarray(self.measured.measured * self.gains, float)


def fit_rows(
    robot: Robot, effects: tuple[Effect, ...], base: BaseParameters, data: Data
) -> FitRows:
    """The rows of the training segments."""
    W, measured = observation(robot, effects, data.to_fit), series(data.to_fit)
    gains = torque_per_reading(robot, base, W, measured, data.unit)
    prior = open_prior(robot, effects, W, measured.measured * gains)
    return FitRows(effects, base, data, W, measured, gains, prior)


def open_prior(robot: Robot, effects: Sequence[Effect], W: Array, tau: Array) -> EffectPrior:
    """Nothing known of effects but their signs, from rows as in `FitRows`."""
    std = implausible_size(W[:, :, 10 * robot.nv :], tau)
    lower = np.array([p.lower for e in effects for p in e.parameters(robot)])
    return EffectPrior(np.zeros_like(std), std, lower)


def observation(robot: Robot, effects: Sequence[Effect], segments: Sequence[Segment]) -> Array:
    """Filtered columns of links and effects at the rows of all segments, (n, nv, p)."""

    def columns(motion: Motion) -> Array:
        return observation_columns(robot, effects, motion)

    return np.concatenate([segment.rows(columns) for segment in segments])


def torque_per_reading(
    robot: Robot, base: BaseParameters, W: Array, measured: Series, unit: str
) -> Array:
    """Drive gains where torque came as current, ones otherwise, shape (nv,)."""
    if unit != "A":
        return np.ones(robot.nv)
    return current_gains(robot, base, W, measured.measured)[0]


def implausible_size(columns: Array, tau: Array) -> Array:
    """A hundred times the coefficient that would explain all torque, or 1e3 when silent.

    Args:
        columns: Columns of effects, shape (n, nv, e).
        tau: Torque, shape (n, nv).
    """
    size = np.sqrt((columns**2).mean(axis=(0, 1)))
    torque = np.sqrt((tau**2).mean())
    return np.asarray(np.where(size > 0, 100 * torque / np.where(size > 0, size, 1.0), 1e3))
