"""Joints that stand throughout: held where they were recorded, and their columns left out.

A recording of a joint that does not move says nothing of its friction and its rotor. Its links are
then part of the body that carries them, at the recorded position.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from excitant.exceptions import BadRecording
from excitant.identify.preprocessing import REST
from excitant.identify.reading.logs import covers
from excitant.identify.reading.mapping import ColumnMap
from excitant.identify.recording import Recording
from excitant.identify.signals import noise, quantum
from excitant.names import listed
from excitant.robots.loading import freed, held_alone, hold
from excitant.robots.motion import Array, Mask
from excitant.robots.robot import Robot

if TYPE_CHECKING:
    import pandas as pd

    Source = Recording | pd.DataFrame | Path

_SHOWN = 4  # names in a note


@dataclass(frozen=True)
class Still:
    """When a joint stands.

    Attributes:
        noise_stds: Its positions range over at most this many standard deviations of their noise or
            rounding, ± 5 of them, where that is
        noisiest: no more than this [rad or m]: rows of another scatter are poses, not noise; or
        wander: over no more than this [rad or m], as far as a servo lets a joint go that it holds
            (real arms: 0 to 0.6 mrad), which changes the gravity of what it carries by 0.3 % of it:
            less than models are known to. Recordings in which it stands agree to this.
        speed_stds: Where speeds are recorded, they leave their median, in the mean, by no more than
            so many standard deviations of their noise beyond what `Rest` lets a joint creep. The
            median is slower than a joint that moves: half a step of a coarse register, say. Else
            the positions are a dead channel.
    """

    noise_stds: float = 10.0
    noisiest: float = 5e-3
    wander: float = 3e-3
    speed_stds: float = 5.0


STILL = Still()


@dataclass(frozen=True, eq=False)
class Parked:
    """An arm with the joints held that stand in all recordings of a fit.

    Attributes:
        robot: The arm with these joints held.
        free: The arm whose joints the recordings have.
        positions: Where each of them stands [rad or m].
        left_out: Joints whose columns are left out: these, and those held all the same.
        notes: Which joints stand, and where, as sentences.
    """

    robot: Robot
    free: Robot
    positions: Mapping[str, float] = field(default_factory=dict)
    left_out: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def of(self, recordings: Sequence[Recording]) -> list[Recording]:
        """Recordings without the columns of held joints.

        Raises:
            BadRecording: A joint moves, or stands elsewhere, that stands in what is fitted.
        """
        if not self.left_out:
            return [*recordings]
        left_out = [self.free.joint_index(joint) for joint in self.left_out]
        for recording in recordings:
            self._refuse_elsewhere(recording)
        return [without(recording, left_out) for recording in recordings]

    def _refuse_elsewhere(self, recording: Recording) -> None:
        for joint, position in self.positions.items():
            q = recording.q[:, self.free.joint_index(joint)]
            if not _stands_at(q, position):
                raise BadRecording(
                    recording.file,
                    f"{joint} goes from {q.min():.4g} to {q.max():.4g} here, but stands at "
                    f"{_at(self.free, joint, position)} in what is fitted; name a recording in "
                    "which it stands there, or fit one in which it moves",
                )


def without(recording: Recording, joints: Sequence[int]) -> Recording:
    """A recording without the columns of some joints, by index."""
    kept = np.delete(np.arange(recording.nv), joints)
    arrays = {name: x[:, kept] for name, x in recording.channels()}
    names = recording.columns
    if names:
        of_q = [names[1 + j] for j in kept]
        of_tau = [names[1 + recording.nv + j] for j in kept]
        names = (names[0], *of_q, *of_tau)
    return replace(recording, columns=names, **arrays)  # type: ignore[arg-type]


def standing(recording: Recording) -> Mask:
    """Which joints stand throughout a recording, shape (nv,); see `Still`."""
    speeds = (
        recording.dq if recording.dq is not None else np.zeros_like(recording.q)
    )
    pairs = zip(recording.q.T, speeds.T, strict=True)
    return np.array([_stands(q, dq) for q, dq in pairs])


def _stands(q: Array, dq: Array) -> bool:
    creep = REST.creep_share * REST.free_speed
    creep += STILL.speed_stds * noise(dq)
    offset = np.median(dq)
    if abs(offset) > REST.moving_share * REST.free_speed:
        return False
    return bool(np.ptp(q) <= _span(q) and np.abs(dq - offset).mean() <= creep)


def _span(q: Array) -> float:
    """Range of the positions of a joint that stands."""
    scatter = max(noise(q), quantum(q) / np.sqrt(12))
    of_noise = STILL.noise_stds * scatter if scatter <= STILL.noisiest else 0.0
    return max(of_noise, STILL.wander)


def _stands_at(q: Array, position: float) -> bool:
    """Whether a joint does not leave a position but for noise."""
    off = abs(np.median(q) - position)
    return bool(off <= STILL.wander and np.ptp(q) <= _span(q))


def freed_for(
    robot: Robot, sources: Sequence[Source], mapping: ColumnMap | None = None
) -> Robot:
    """The arm whose joints all of some logs have: itself, or with joints free that it holds.

    These are the joints that were not chosen or, where columns are numbered, all that are held.
    """
    if not robot.locked or not sources:
        return robot
    for names in dict.fromkeys((robot.unchosen, (), held_alone(robot))):
        free = freed(robot, names) if names else robot
        if all(covers(source, free, mapping) for source in sources):
            return free
    return robot


def parked(
    given: Robot, free: Robot, recordings: Sequence[Recording], held: bool = True
) -> Parked:
    """The arm with the joints held that stand in all recordings.

    Args:
        given: The arm as chosen.
        free: The arm whose joints the recordings have; see `freed_for`.
        recordings: What is to be fitted.
        held: Whether joints that are chosen and stand are held.

    Raises:
        BadRecording: A joint moves that is not chosen and changes the torque of one that is; or no
            joint moves.
    """
    if not recordings or any(each.nv != free.nv for each in recordings):
        return Parked(given, given)
    stand = np.all([standing(each) for each in recordings], axis=0)
    centres = np.array([np.median(each.q, axis=0) for each in recordings])
    apart = stand & (np.ptp(centres, axis=0) > STILL.wander)
    notes = [
        _apart(free, j, centres[:, j], recordings)
        for j in np.flatnonzero(apart).tolist()
    ]
    stand &= ~apart
    everywhere = zip(free.joints, centres.mean(axis=0).tolist(), stand, strict=True)
    places = {joint: q for joint, q, still in everywhere if still}
    chosen = given.joints if held else ()
    positions = {j: q for j, q in places.items() if j in chosen}
    if len(positions) == given.nv:
        span = max(np.ptp(each.q, axis=0).max() for each in recordings)
        raise BadRecording(
            recordings[0].file,
            f"no joint moves: positions vary by at most {span:.3g}; record a motion "
            "(excitant design makes one)",
        )
    beside = {j: q for j, q in given.locked if j in free.joints}
    for joint in {*beside} & {*given.unchosen}:
        if joint in places:
            positions[joint] = places[joint]
        else:
            _refuse_coupled(given, free, joint, recordings)
    robot = given
    if any(abs(positions.get(j, q) - q) > STILL.wander for j, q in beside.items()):
        _refuse_changed(given, free, beside, recordings)
        robot = hold(free, {j: positions.get(j, q) for j, q in beside.items()})
    more = {j: q for j, q in positions.items() if j in robot.joints}
    robot = hold(robot, more) if more else robot
    left_out = (*beside, *more)
    if positions:
        notes.insert(0, _sentence(free, positions, recordings))
    if notes:
        robot = replace(robot, notes=(*robot.notes, *notes))
    return Parked(robot, free, positions, left_out, tuple(notes))


def _refuse_changed(
    given: Robot,
    free: Robot,
    beside: Mapping[str, float],
    recordings: Sequence[Recording],
) -> None:
    """Refuse to hold joints elsewhere in an arm whose bodies are not those of its description."""
    if given.zeros or not np.allclose(hold(free, beside).phi, given.phi):
        places = [
            f"{joint} at {_at(free, joint, q)}" for joint, q in beside.items()
        ]
        raise BadRecording(
            recordings[0].file,
            f"the model was changed with {', '.join(places)}, which stand elsewhere here; "
            "give the model as described",
        )


def _refuse_coupled(
    given: Robot, free: Robot, joint: str, recordings: Sequence[Recording]
) -> None:
    """Refuse a joint that moves and is not chosen, but where no chosen one shares its chain."""
    j = free.joint_index(joint) + 1
    chains = [set(chain) for chain in free.model.supports]
    chosen = [free.joint_index(name) + 1 for name in given.joints]
    if not any(j in chains[k] or k in chains[j] for k in chosen):
        return
    q = np.concatenate([each.q[:, j - 1] for each in recordings])
    raise BadRecording(
        recordings[0].file,
        f"{joint} is not chosen, but goes from {q.min():.4g} to {q.max():.4g} "
        f"{_unit(free, joint)} in {_names(recordings)}, which changes the torque of those "
        f"chosen: choose it too, record it at rest, or hold it all the same (--lock {joint}=Q)",
    )


def _sentence(
    free: Robot, positions: Mapping[str, float], recordings: Sequence[Recording]
) -> str:
    """Which joints are held because they stand, and where."""
    names = _names(recordings)
    if len(positions) == 1:
        [(joint, q)] = positions.items()
        where = _at(free, joint, q)
        return f"held at {where}, as it does not move in {names}: {joint}"
    places = [f"{joint} at {_at(free, joint, q)}" for joint, q in positions.items()]
    return f"held, as they do not move in {names}: {', '.join(places)}"


def _apart(
    free: Robot, j: int, positions: Array, recordings: Sequence[Recording]
) -> str:
    """Where a joint stands that cannot be held, as it does so in several places."""
    joint = free.joints[j]
    places = [
        f"at {_at(free, joint, q)} in {Path(each.file).name}"
        for q, each in zip(positions.tolist(), recordings, strict=True)
    ]
    return (
        f"{joint} stands {listed(places, _SHOWN)}, so that it is not held, and its friction and "
        "rotor do not show: fit recordings of one position, or one in which it moves"
    )


def _names(recordings: Sequence[Recording]) -> str:
    return listed([Path(each.file).name for each in recordings], _SHOWN)


def _at(robot: Robot, joint: str, q: float) -> str:
    return f"{q + 0.0:.4g} {_unit(robot, joint)}"


def _unit(robot: Robot, joint: str) -> str:
    return "rad" if robot.revolute[robot.joint_index(joint)] else "m"
