"""Faults of a recording, found before anything is fitted to it, and recordings read with them."""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from excitant.exceptions import BadRecording, FaultWarning
from excitant.identify.faults.channels import (
    dead_channels,
    held_channels,
    jumps_and_outliers,
    missing_values,
    saturation,
    wrapped_counters,
)
from excitant.identify.faults.fault import (
    FAULTS,
    NO_TORQUE,
    PROVEN,
    SET_UP,
    Fault,
    Log,
    Remedy,
    after_repair,
    repair,
)
from excitant.identify.faults.modelled import not_measured, poor_excitation
from excitant.identify.faults.physics import smooth, torque_fit, velocity_faults
from excitant.identify.faults.set_up import (
    odds_against,
    physics_faults,
    support,
    swapped,
)
from excitant.identify.faults.time import gap_faults, repeated_rows, stamp_faults
from excitant.identify.recording import Recording, checked
from excitant.robots.robot import Robot

__all__ = [
    "FAULTS",
    "Checked",
    "Fault",
    "Log",
    "check",
    "find_copies",
    "find_faults",
]
__all__ += ["faults_of", "repair"]

_SHORTEST = 50  # samples: fewer prove nothing
_known = WeakKeyDictionary[
    Recording, tuple[Robot, tuple[Fault, ...]]
]()  # what was told


def find_faults(robot: Robot, recording: Recording) -> tuple[Fault, ...]:
    """Faults of a recording as logged; the arm's masses matter for signs and excitation only.

    Rows first, then channels, velocity against position, and last the physics: each test sees
    the recording as the repairs of the earlier ones would leave it, so that one fault is not
    named twice. All tests together raise a fault in at most one of fifty faultless recordings.
    """
    log = Log.of(robot, recording)
    found: list[Fault] = []
    rows = np.arange(len(log))  # of the log as it came, by row of the log as repaired

    def note(*faults: Fault) -> None:
        nonlocal log, rows
        found.extend(fault.at(rows) for fault in faults)
        if any(fault.remedies for fault in faults):
            log, left = after_repair(log, faults)
            rows = rows[left]

    stamps, starts = stamp_faults(log)
    note(*stamps)
    if starts is None:
        return tuple(found)
    parts = np.union1d(log.t[np.isin(rows, starts)], recording.starts)
    if len(log) >= _SHORTEST:
        note(*gap_faults(log, parts))
    tests = (repeated_rows, wrapped_counters, held_channels, jumps_and_outliers)
    for test in (missing_values, *tests):
        if len(log) >= _SHORTEST or test is missing_values:
            note(*test(log))
    if len(log) < _SHORTEST:
        return tuple(found)
    channels = [*dead_channels(log), *saturation(log, robot)]
    cuts = np.split(np.arange(len(log)), np.searchsorted(log.t, parts))
    longest = log.take(max(cuts, key=len)) if len(cuts) > 1 else log
    speeds = velocity_faults(longest)
    longest, _ = after_repair(longest, speeds)
    return (*found, *channels, *speeds, *_by_physics(robot, longest, channels))


def _by_physics(robot: Robot, log: Log, channels: Sequence[Fault]) -> list[Fault]:
    data = smooth(log)
    found = list[Fault]()
    if data is not None:
        dead = [
            f for f in channels if (f.fault, f.evidence.get("channel")) == NO_TORQUE
        ]
        case = torque_fit(robot, log, data, {fault.joints[0] for fault in dead})
        found = [] if case is None else physics_faults(case)
        if found:
            log, _ = repair(log, found)
            data = smooth(log) or data
        elif case is not None:
            found = [*not_measured(case)]
    return [*found, *poor_excitation(robot, log, data)]


def warn_of_faults(robot: Robot, recordings: Sequence[Recording]) -> None:
    """Warn of the faults of each recording, once; not of those from `read_checked`."""
    for recording in recordings:
        if recording not in _known:
            for fault in faults_of(robot, recording):
                remedy = f"; repair {fault.repair}" if fault.repair else ""
                warnings.warn(
                    f"{recording.name}: {fault.detail}{remedy}", FaultWarning, 3
                )


def faults_of(robot: Robot, recording: Recording) -> tuple[Fault, ...]:
    """Faults of a recording as `find_faults`, looked for once."""
    if recording not in _known or _known[recording][0] is not robot:
        _known[recording] = robot, find_faults(robot, recording)
    return _known[recording][1]


def find_copies(recordings: Mapping[str, Recording]) -> dict[str, Fault]:
    """Faults, by name, of recordings with all values of an earlier one, whatever their times."""
    first: dict[bytes, str] = {}
    found = {}
    for name, recording in recordings.items():
        made = hashlib.sha256(b"".join(x.tobytes() for _, x in recording.channels()))
        if (same := first.setdefault(made.digest(), name)) != name:
            detail = (
                f"{name} holds the same {len(recording)} rows as {same}: all positions, velocities "
                f"and torques are equal, so it adds no evidence and is no hold-out"
            )
            evidence = {"same_as": same, "count": len(recording)}
            found[name] = Fault("duplicate_samples", (), detail, evidence)
    return found


def find_swapped(
    robot: Robot, recordings: Sequence[Recording]
) -> tuple[list[Recording], dict[str, Fault]]:
    """Recordings with torques that were exchanged among them put back, and such faults by name."""
    better = [*recordings]
    found = dict[str, Fault]()
    for pair in swapped(robot, recordings):
        for one, other in (pair, pair[::-1]):
            mine = recordings[one]
            its = recordings[other]
            better[one] = replace(mine, tau=its.tau)
            detail = (
                f"the torque of {mine.name} is that of the motion of {its.name}, and the reverse: "
                f"so exchanged, it is that of bodies near the given ones"
            )
            done = f"takes the torque of {its.name}"
            evidence = {"torque_of": its.name}
            remedies = (Remedy("exchange", "tau"),)
            known = "swapped_recordings", robot.joints, detail, evidence, done, remedies
            found[mine.name] = Fault(*known)
    return better, found


def supported(
    robot: Robot,
    recordings: Mapping[str, Recording],
    faults: Mapping[str, Sequence[Fault]],
) -> dict[str, tuple[Fault, ...]]:
    """Faults by recording, without mountings and zero positions that all together do not support.

    An arm is mounted one way: what a recording shows in which one joint moves, or a hand pushes, is
    no set-up where the others speak against it.
    """
    kept = {}
    for name, mine in faults.items():
        shown = [fault for fault in mine if fault.fault in SET_UP]
        if shown and len(recordings) > 1:
            gains = (
                support(
                    robot, each, shown, [f for f in faults[other] if not f.of_the_arm]
                )
                for other, each in recordings.items()
            )
            if sum(gains) <= odds_against(robot):
                mine = [fault for fault in mine if fault not in shown]
        kept[name] = tuple(mine)
    return kept


@dataclass(frozen=True, eq=False)
class Checked:
    """Recordings and what is wrong with them."""

    recordings: list[Recording]  # ready to use, repaired when that was asked for
    faults: dict[str, tuple[Fault, ...]]  # of each, by its name
    notes: tuple[str, ...] = ()  # what was repaired, a sentence each
    repaired: bool = False  # whether faults that have a remedy are repaired in them

    def entries(self) -> list[dict[str, Any]]:
        """The faults under their JSON names, each with its recording and whether it is repaired."""
        return [
            {"recording": name, **fault.entry()}
            | {"repaired": self.repaired and bool(fault.remedies)}
            for name, faults in self.faults.items()
            for fault in faults
        ]


def proven(entries: Sequence[Mapping[str, Any]]) -> list[str]:
    """Faults by which every figure is wrong and that are not repaired, a sentence each.

    Of unit, sign or clock, or a torque that is none, which falsifies what all joints share; see
    `Checked`.
    """
    return [
        f"{fault['recording']}: {fault['detail']}"
        for fault in entries
        if not fault["repaired"]
        and (fault["fault"] in PROVEN or (fault["fault"], _channel(fault)) == NO_TORQUE)
    ]


def _channel(fault: Mapping[str, Any]) -> object:
    return fault["evidence"].get("channel")


def check(
    robot: Robot, recordings: Sequence[Recording], *, repaired: bool = False
) -> Checked:
    """Recordings with their faults, repaired where that is asked for.

    Args:
        robot: The arm as given.
        recordings: Recordings as logged, or checked ones.
        repaired: Whether to repair what has a remedy.

    Raises:
        BadRecording: A recording that cannot be used, also not after the repair.
    """
    copies = find_copies({recording.name: recording for recording in recordings})
    exchanged, swaps = find_swapped(robot, recordings)
    by_name = {recording.name: recording for recording in exchanged}
    alone = {name: faults_of(robot, recording) for name, recording in by_name.items()}
    faults = dict[str, tuple[Fault, ...]]()
    for name, mine in supported(robot, by_name, alone).items():
        among = [found[name] for found in (copies, swaps) if name in found]
        faults[name] = (*among, *mine)
    if not repaired:
        return Checked(list(recordings), faults)
    notes = list[str]()
    usable = list[Recording]()
    for name, recording in by_name.items():
        for fault in faults[name]:
            if "unclear" in fault.evidence:
                row = int(fault.evidence["rows"][0])
                column = recording.columns[0]
                raise BadRecording(recording.file, fault.detail, row=row, column=column)
        better, done = repair(recording, faults[name])
        notes += [f"{name}: {sentence}" for sentence in done]
        usable.append(checked(better))
        open_faults = tuple(fault for fault in faults[name] if not fault.remedies)
        _known[usable[-1]] = robot, open_faults
    return Checked(usable, faults, tuple(notes), repaired)
