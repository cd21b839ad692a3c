"""Faults of a recording, found before anything is fitted to it, and recordings read with them."""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

import numpy as np

from excitant.exceptions import BadRecording, FaultWarning
from excitant.identify.faults.channels import (
    dead_channels,
    excited_together,
    held_channels,
    jumps_and_outliers,
    missing_values,
    not_measured,
    poor_excitation,
    saturation,
    torque_without_sign,
    wrapped_counters,
)
from excitant.identify.faults.fault import (
    DOUBT,
    FAULTS,
    INSTALLATION,
    NO_TORQUE,
    PROVEN,
    Fault,
    Log,
    Remedy,
    after_repair,
    joints_without_torque,
    repair,
)
from excitant.identify.faults.installation import (
    beyond_limits,
    inertias_beyond_size,
    installation_faults,
    odds_against,
    pose_faults,
    refuse_positions_beyond,
    support,
    swapped,
)
from excitant.identify.faults.stated import map_of
from excitant.identify.faults.time import (
    gap_faults,
    repeated_rows,
    stamp_faults,
    velocity_faults,
)
from excitant.identify.faults.torque_fit import smooth, torque_fit
from excitant.identify.recording import Recording, checked, shows_poses
from excitant.identify.signals import samples_motion
from excitant.robots.robot import Robot

if TYPE_CHECKING:
    from excitant.identify.parked import Parked

__all__ = [
    "FAULTS",
    "Checked",
    "Fault",
    "Log",
    "check_recordings",
    "find_copies",
    "find_faults",
    "refuse_positions_beyond",
    "repair",
]

_ROWS = 50  # fewer prove nothing
# what was told
_known = WeakKeyDictionary[Recording, tuple[Robot, tuple[Fault, ...]]]()


def find_faults(robot: Robot, recording: Recording) -> tuple[Fault, ...]:
    """Faults of a recording as logged; the arm's masses matter for signs and excitation only.

    Rows first, then channels, velocity against position, and last the physics: each test sees
    the recording as the repairs of the earlier ones would leave it, so that one fault is not
    named twice. All tests together raise a fault in at most one of fifty faultless recordings.
    """
    # a motion so slow may have a clock in another unit
    faults = (
        tuple(pose_faults(robot, Log.of(robot, recording)))
        if shows_poses(recording) and not samples_motion(recording.q)
        else _faults(robot, recording)
    )
    read = recording.read
    return tuple(
        replace(fault, map=map_of(robot, read, fault.remedies))
        if read and fault.repairable
        else fault
        for fault in faults
    )


def _faults(
    robot: Robot, recording: Recording, late: Sequence[Fault] = ()
) -> tuple[Fault, ...]:
    """Faults by their tests in order; late torque, once it is known, comes before its outliers."""
    log = Log.of(robot, recording)
    faults: list[Fault] = []
    # of the log as it came, by row of the log as repaired
    rows = np.arange(len(log))

    def note(*new: Fault) -> None:
        nonlocal log, rows
        faults.extend(fault.at(rows) for fault in new)
        if any(fault.remedies for fault in new):
            log, remaining = after_repair(log, new)
            rows = rows[remaining]

    stamps, in_order = stamp_faults(log)
    note(*stamps)
    if not in_order:
        return tuple(faults)
    parts = np.asarray(recording.starts)
    if len(log) >= _ROWS:
        note(*gap_faults(log, parts))
    note(*missing_values(log))
    for test in (repeated_rows, wrapped_counters, held_channels):
        if len(log) >= _ROWS:
            note(*test(log))
    note(*late)
    outliers = [*jumps_and_outliers(log)] if len(log) >= _ROWS else []
    note(*outliers)
    unmended = [*jumps_and_outliers(log)] if outliers else []
    for fault in unmended:
        # positions that interpolation does not mend jump, as where logs are joined
        if fault.channel == "q":
            parts = np.union1d(parts, log.t[fault.evidence["rows"]])
    if len(log) < _ROWS:
        return tuple(faults)
    channels = [*dead_channels(log), *saturation(log, robot)]
    cuts = np.split(np.arange(len(log)), np.searchsorted(log.t, parts))
    pieces = [log.take(cut) for cut in cuts if len(cut) >= _ROWS]
    longest = log.take(max(cuts, key=len)) if len(cuts) > 1 else log
    speeds = velocity_faults(longest, robot.limits.velocity)
    if len(beyond_limits(robot, longest.q)[0]):
        # positions of another unit say nothing of the clock
        speeds = [f for f in speeds if f.fault != "wrong_sample_rate"]
    longest, _ = after_repair(longest, speeds)
    physics = _by_physics(robot, longest, channels)
    poor = [f for f in physics if f.fault == "poor_excitation"]
    if poor and excited_together(robot, pieces):
        physics.remove(poor[0])
    if outliers and not late and physics and physics[0].fault == "time_delay":
        return _faults(robot, recording, physics[:1])
    meaning = {(f.fault, f.channel) for f in physics}
    if meaning & {("wrong_unit", "tau"), ("wrong_order", None)}:
        # what is no torque, or that of another joint, reaches no limit of it
        channels = [f for f in channels if "limit" not in f.evidence]
    return (*faults, *channels, *speeds, *physics)


def _by_physics(robot: Robot, log: Log, channels: Sequence[Fault]) -> list[Fault]:
    data = smooth(log)
    if faults := [*inertias_beyond_size(robot), *torque_without_sign(log)]:
        return faults
    # torque says nothing of where a joint is that is not read
    if data is not None and "q" not in {fault.channel for fault in channels}:
        case = torque_fit(robot, log, data, joints_without_torque(channels))
        faults = [] if case is None else installation_faults(case)
        if faults:
            log, _ = repair(log, faults)
            data = smooth(log) or data
        elif case is not None:
            faults = [*not_measured(case)]
    return [*faults, *poor_excitation(robot, log, data)]


def warn_of_faults(robot: Robot, recordings: Sequence[Recording]) -> None:
    """Warn of the faults of each recording, once; not of those from `check_recordings`."""
    for recording in recordings:
        if recording not in _known:
            for fault in faults_of(robot, recording):
                remedy = f"; repair {fault.repair}" if fault.repair else ""
                stated = f"; column map {fault.map}" if fault.map else ""
                warning = f"{recording.name}: {fault.detail}{remedy}{stated}"
                warnings.warn(warning, FaultWarning, 3)


def faults_of(robot: Robot, recording: Recording) -> tuple[Fault, ...]:
    """Faults of a recording as `find_faults`, looked for once."""
    if recording not in _known or _known[recording][0] is not robot:
        _known[recording] = robot, find_faults(robot, recording)
    return _known[recording][1]


def find_copies(recordings: Mapping[str, Recording]) -> dict[str, Fault]:
    """Faults, by name, of recordings with all values of an earlier one, whatever their times."""
    first: dict[bytes, str] = {}
    copies = {}
    for name, recording in recordings.items():
        content = b"".join(values.tobytes() for _, values in recording.channels())
        original = first.setdefault(hashlib.sha256(content).digest(), name)
        if original != name:
            detail = (
                f"{name} holds the same {len(recording)} rows as {original}: all positions, "
                "velocities and torques are equal, so it adds no evidence and is no hold-out"
            )
            copies[name] = Fault("duplicate_samples", (), detail, {})
    return copies


def find_swapped(
    robot: Robot, recordings: Sequence[Recording]
) -> tuple[list[Recording], dict[str, Fault]]:
    """Recordings with torques that were exchanged among them put back, and such faults by name."""
    exchanged = [*recordings]
    faults = dict[str, Fault]()
    for pair in swapped(robot, recordings):
        for one, other in (pair, pair[::-1]):
            name = recordings[one].name
            source = recordings[other].name
            exchanged[one] = replace(recordings[one], tau=recordings[other].tau)
            faults[name] = Fault(
                "swapped_recordings",
                robot.joints,
                f"the torque of {name} is that of the motion of {source}, and the reverse: "
                f"so exchanged, it is that of bodies near the given ones",
                {},
                f"takes the torque of {source}",
                (Remedy("exchange", "tau"),),
            )
    return exchanged, faults


def shared_installation(
    robot: Robot,
    recordings: Sequence[Recording],
    faults: Sequence[Sequence[Fault]],
    known: tuple[Fault, ...] = (),
) -> list[tuple[Fault, ...]]:
    """Faults of each recording, with those of the arm that all recordings together support most.

    First those that are known of it from others, if these support them too.

    An arm is installed one way: what a recording shows in which one joint moves, or a hand pushes,
    is no mounting and no zero position where the others speak against it.
    """
    of_data = [[f for f in some if not f.of_the_arm] for some in faults]
    of_arm = [tuple(f for f in some if f.of_the_arm) for some in faults]

    def gain(some: tuple[Fault, ...]) -> float:
        pairs = zip(recordings, of_data, strict=True)
        return sum(support(robot, each, some, others) for each, others in pairs)

    if known and gain(known) > 0:
        return [(*data, *known) for data in of_data]
    if len(recordings) == 1:
        return [tuple(faults[0])]
    gains = {some: gain(some) for some in filter(None, of_arm)}
    shown = max(gains, key=gains.__getitem__, default=())
    if gains.get(shown, 0.0) <= odds_against(robot):
        # signs and order may be those of one logger
        return [
            tuple(f for f in some if f.fault not in INSTALLATION) for some in faults
        ]
    # remedies act in the order in which they were found
    return [
        tuple(some) if arm == shown else (*data, *shown)
        for some, data, arm in zip(faults, of_data, of_arm, strict=True)
    ]


@dataclass(frozen=True, eq=False)
class Checked:
    """Recordings and what is wrong with them."""

    recordings: list[Recording]  # ready to use, repaired when that was asked for
    faults: dict[str, tuple[Fault, ...]]  # of each, by its name
    notes: tuple[str, ...] = ()  # what was repaired, a sentence each
    repaired: bool = False  # whether faults that have a remedy are repaired in them
    parked: Parked | None = None  # joints that stand in what is fitted

    def beside(self, parked: Parked, recordings: list[Recording]) -> Checked:
        """The same of recordings without the joints that stand in what is fitted."""
        robot = parked.robot
        for before, after in zip(self.recordings, recordings, strict=True):
            if after is not before and before in _known:
                _known[after] = robot, _at_joints(_known[before][1], robot)
        faults = {
            name: _at_joints(some, robot) for name, some in self.faults.items()
        }
        return replace(self, recordings=recordings, faults=faults, parked=parked)

    @property
    def of_the_arm(self) -> tuple[Fault, ...]:
        """Faults of the arm that all recordings share."""
        every = [
            tuple(f for f in some if f.of_the_arm) for some in self.faults.values()
        ]
        return every[0] if len({*every}) == 1 else ()

    def entries(self) -> list[dict[str, Any]]:
        """The faults under their JSON names, each with its recording and whether it is repaired."""
        return [
            {"recording": name, **fault.entry()}
            | {"repaired": self.repaired and fault.repairable}
            for name, faults in self.faults.items()
            for fault in faults
        ]


def _at_joints(faults: Sequence[Fault], robot: Robot) -> tuple[Fault, ...]:
    """Faults but those of joints that a robot holds."""
    return tuple(f for f in faults if not f.joints or {*f.joints} & {*robot.joints})


def proven(entries: Sequence[Mapping[str, Any]]) -> list[str]:
    """Faults by which every figure is wrong and that are not repaired, a sentence each.

    Of unit, sign or clock, values that jump as they are coded, or a torque that is none, which
    falsifies what all joints share; see `Checked`.
    """
    return [
        f"{fault['recording']}: {fault['detail']}"
        for fault in entries
        if not fault["repaired"]
        and DOUBT not in fault["evidence"]
        and (
            fault["fault"] in PROVEN
            or "jumps" in fault["evidence"]
            or (fault["fault"], fault["evidence"].get("channel")) == NO_TORQUE
        )
    ]


def check_recordings(
    robot: Robot,
    recordings: Sequence[Recording],
    *,
    repaired: bool = False,
    only: Collection[str] = FAULTS,
    modelled: Collection[str] = (),
    known: tuple[Fault, ...] = (),
) -> Checked:
    """Recordings with their faults, repaired where that is asked for.

    Args:
        robot: The arm as given.
        recordings: Recordings as logged, or checked ones.
        repaired: Whether to repair what has a remedy.
        only: Faults that are looked at.
        modelled: Faults that are left to the model.
        known: Faults of the arm that other recordings show.

    Raises:
        BadRecording: A recording that cannot be used, also not after the repair.
    """
    copies = find_copies({recording.name: recording for recording in recordings})
    exchanged, swaps = find_swapped(robot, recordings)
    alone = [
        [fault for fault in faults_of(robot, each) if fault.fault in only]
        for each in exchanged
    ]
    poor = {f for faults in alone for f in faults if f.fault == "poor_excitation"}
    if poor and excited_together(robot, [Log.of(robot, r) for r in exchanged]):
        alone = [[f for f in faults if f not in poor] for faults in alone]
    faults = dict[str, tuple[Fault, ...]]()
    notes = list[str]()
    usable = list[Recording]()
    shared = shared_installation(robot, exchanged, alone, known)
    for recording, mine in zip(exchanged, shared, strict=True):
        name = recording.name
        among = [found[name] for found in (copies, swaps) if name in found]
        faults[name] = (*among, *mine)
        if not repaired:
            continue
        for fault in mine:
            if "unclear" in fault.evidence:
                row = int(fault.evidence["rows"][0])
                column = recording.columns[0]
                raise BadRecording(
                    recording.file, fault.detail, row=row, column=column
                )
        better = recording
        done: Sequence[str] = ()
        repairable = [f for f in faults[name] if f.fault not in modelled]
        if any(fault.repairable for fault in repairable):
            better, done = repair(recording, repairable)
        notes += [f"{name}: {sentence}" for sentence in done]
        # what was not read from a file has no columns to name, and was believed
        usable.append(checked(better) if recording.columns else better)
        if done:
            still = tuple(f for f in faults[name] if not f.repairable)
            _known[usable[-1]] = robot, still
    if not repaired:
        return Checked(list(recordings), faults)
    return Checked(usable, faults, tuple(notes), repaired)
