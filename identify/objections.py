"""Objections to a model on the hold-out: what cannot be true of an arm, or predicts too badly.

A model with an objection is not published: an engineer would look at the columns of the recording
first.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from excitant.identify.accuracy import (
    CHANCE_OF_LOSS,
    Accuracy,
    Series,
    chance_of_loss,
)
from excitant.identify.drive_gains import DriveGains
from excitant.identify.preprocessing import Segment
from excitant.robots.motion import Array, Motion
from excitant.robots.robot import Robot

MISSED = 0.6  # nrmse of a joint: beyond it, more than a third of its variance is not explained


@dataclass(frozen=True, eq=False)
class HoldOut:
    """Torque of a model and of the nominal one on the hold-out, by which files are judged.

    Attributes:
        segments: The hold-out.
        series: Its rows, with the measured torque.
        gains: Torque per reading, shape (nv,) [N·m per reading].
        predicted: Torque of the model at its rows, shape (n, nv) [torque unit].
        nominal: Torque of the model as given, shape (n, nv) [torque unit].
        drive: Drive gains, if torque was recorded as current.
    """

    segments: Sequence[Segment]
    series: Series
    gains: Array
    predicted: Array
    nominal: Array
    drive: DriveGains | None

    @cached_property
    def accuracy(self) -> Accuracy:
        """Of the model."""
        return self.series.accuracy(self.predicted)

    @cached_property
    def nominal_accuracy(self) -> Accuracy:
        """Of the model as given."""
        return self.series.accuracy(self.nominal)

    @cached_property
    def losses(self) -> Array:
        """How much worse the model is than the one as given, row by row; see `Series.losses`."""
        return self.series.losses(self.predicted, self.nominal)

    @cached_property
    def got_worse(self) -> str:
        """Errors of all joints together where they got worse beyond chance; else empty."""
        if chance_of_loss(self.losses.sum(axis=1)) >= CHANCE_OF_LOSS:
            return ""
        first, then = (
            float(np.nansum(accuracy.nrmse))
            for accuracy in (self.nominal_accuracy, self.accuracy)
        )
        return f"nrmse summed over the joints {first:.4g} → {then:.4g}"


class Objection(NamedTuple):
    """Why a model is not to be used, and what to do about it."""

    why: str
    advice: str
    relative: bool = False  # to the model as given: nothing impossible


_COLUMNS = (
    "look at the torque and position columns there: order, sign, unit, resolution"
)


def of_data(faults: Sequence[str]) -> list[Objection]:
    """Objections of a model that is fitted to data with faults, a sentence each."""
    correct = "correct the recording, with --repair where it says so"
    return [Objection(fault, correct) for fault in faults]


def objections(model: Robot, judged: HoldOut) -> list[Objection]:
    """Objections to a model, what is impossible first."""
    against = []
    if useless := useless_joints(model.joints, judged):
        why = (
            f"it predicts the hold-out worse than no model at {'; '.join(useless)}"
        )
        against.append(Objection(why, _COLUMNS))
    elif missed := _missed(model.joints, judged):
        against.append(Objection(f"it misses {'; '.join(missed)}", _COLUMNS))
    if not judged.series.judged.any():
        why = "no joint moves in the hold-out, or its torque is noise: nothing judges the model"
        against.append(
            Objection(why, "name a recording with motion for --validate")
        )
    if strained := _strained(model, judged):
        why = f"its friction is more than the drive can give: {'; '.join(strained)}"
        advice = "look at the unit of the torque and at the drive gains there"
        against.append(Objection(why, advice))
    if judged.got_worse:
        why = f"it predicts the hold-out worse than the model as given, {judged.got_worse}"
        advice = "see whether fit and hold-out are of the same arm and load, or excite more"
        against.append(Objection(why, advice, relative=True))
    return against


def useless_joints(joints: Sequence[str], judged: HoldOut) -> list[str]:
    """Joints whose mean torque predicts the hold-out better than the model, with r²."""
    r2 = judged.accuracy.r2
    return [
        f"{joints[j]} (r² = {r2[j]:.3g})"
        for j in np.flatnonzero(judged.series.judged & (r2 < 0)).tolist()
    ]


def _missed(joints: Sequence[str], judged: HoldOut) -> list[str]:
    nrmse = judged.accuracy.nrmse
    return [
        f"{100 * nrmse[j]:.0f} % of the torque of {joints[j]}"
        for j in np.flatnonzero(judged.series.judged & (nrmse > MISSED)).tolist()
    ]


def _strained(model: Robot, judged: HoldOut) -> list[str]:
    """Joints whose friction in the hold-out exceeds their effort limit, with both."""
    friction = [effect for effect in model.effects if effect.family == "friction"]

    def torque(motion: Motion) -> Array:
        none = np.zeros((len(motion), model.nv))
        return sum((effect.torque(model, motion) for effect in friction), none)

    parts = [
        np.abs(segment.rows(torque)).max(axis=0) for segment in judged.segments
    ]
    largest = np.max(parts, axis=0)
    limits = model.limits.torque
    strained = (largest > limits) & (limits > 0)
    if judged.drive is not None:
        strained &= judged.drive.known
    return [
        f"{largest[j]:.4g} {model.torque_unit(joint=j)} of {limits[j]:.4g} at "
        f"{model.joints[j]}"
        for j in np.flatnonzero(strained).tolist()
    ]
