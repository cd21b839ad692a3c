"""All tests in the order in which one fault can hide or feign another, and logs read with them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from excitant.exceptions import BadRecording
from excitant.identify.dataset import Dataset
from excitant.identify.faults.channels import (
    dead_channels,
    find_copies,
    held_channels,
    saturation,
    wrapped_counters,
)
from excitant.identify.faults.fault import Fault, left_rows, repair
from excitant.identify.faults.fit import smooth, torque_fit
from excitant.identify.faults.log import Log, Raw
from excitant.identify.faults.modelled import not_measured, poor_excitation, wrong_frame
from excitant.identify.faults.outliers import missing_values, outliers
from excitant.identify.faults.physics import physics_faults
from excitant.identify.faults.time import gap_faults, hidden_gaps, repeated_rows, stamp_faults
from excitant.identify.faults.velocity import velocity_faults
from excitant.identify.importers.raw import raw_recording
from excitant.identify.recording import Recording, recording_from_raw
from excitant.robots.robot import Robot

_SHORTEST = 50  # samples: fewer prove nothing


def find_faults(robot: Robot, raw: Raw) -> tuple[Fault, ...]:
    """Faults of a recording, before anything is fitted to it.

    Rows first, then channels, velocity against position, and last the physics: each test sees
    the recording as the repairs of the earlier ones would leave it, so that one fault is not
    named twice. Nothing is changed in ``raw``. All tests together raise a fault in at most one of
    fifty faultless recordings.

    Args:
        robot: The arm; its masses matter for signs and excitation only.
        raw: The recording as logged, arrays ``t`` (n,), ``q``, ``tau`` and ``dq`` (n, nv) or None.
    """
    rows = _CheckedRows(Log(raw.t, raw.q, raw.tau, raw.dq, robot.joints, raw.unit))
    if len(rows.log) < _SHORTEST:
        return tuple(rows.found)
    channels = [*dead_channels(rows.log), *saturation(rows.log, robot)]
    log = rows.longest
    speeds = velocity_faults(log)
    log, _ = repair(log, speeds)
    return (*rows.found, *channels, *speeds, *_by_physics(robot, log, channels))


class _CheckedRows:
    """Faults of rows, and the log without them; empty where no row has a place in time.

    Every test names rows of the log it saw; they are counted in the log as it was at first.

    Attributes:
        log: The log as repairs would leave it.
        longest: The longest part of it in which the clock does not start anew.
        found: Faults.
    """

    def __init__(self, log: Log) -> None:
        self.log = self.longest = log
        self.found: list[Fault] = []
        self._rows = np.arange(len(log))
        stamps, starts = stamp_faults(log)
        self._step(*stamps)
        if starts is None:
            self.log = log.take(self._rows[:0])
            return
        parts = self.log.t[np.isin(self._rows, starts)]
        if len(self.log) >= _SHORTEST:
            self._note(*gap_faults(self.log, parts))
        self._step(*missing_values(self.log))
        if len(self.log) < _SHORTEST:
            return
        self._step(*repeated_rows(self.log))
        self._step(*wrapped_counters(self.log))
        hidden = list(hidden_gaps(self.log))
        self._note(*held_channels(self.log), *hidden)
        self._step(*outliers(self.log, hidden[0].evidence["rows"] if hidden else None))
        cuts = np.split(np.arange(len(self.log)), np.searchsorted(self.log.t, parts))
        self.longest = self.log.take(max(cuts, key=len)) if len(cuts) > 1 else self.log

    def _note(self, *faults: Fault) -> None:
        self.found += [fault.at(self._rows) for fault in faults]

    def _step(self, *faults: Fault) -> None:
        """Note faults, and go on with the log as their repair would leave it."""
        self._note(*faults)
        if faults:
            left = left_rows(self.log.t, faults)
            self.log = self.log.take(left) if len(left) < 2 else repair(self.log, faults)[0]
            self._rows = self._rows[left]


def _by_physics(robot: Robot, log: Log, channels: Sequence[Fault]) -> list[Fault]:
    """Faults that only a model of the arm shows."""
    data = smooth(log)
    found: list[Fault] = []
    if data is not None:
        torque = [
            f for f in channels if f.fault == "dead_channel" and f.evidence["channel"] == "tau"
        ]
        case = torque_fit(robot, log, data, {fault.joints[0] for fault in torque})
        found = [] if case is None else physics_faults(case)
        if found:
            log, _ = repair(log, found)
            data = smooth(log) or data
        elif case is not None:
            found = [*not_measured(case), *wrong_frame(case)]
    return [*found, *poor_excitation(robot, log, data)]


@dataclass(frozen=True, eq=False)
class Checked:
    """Recordings and what is wrong with them.

    Attributes:
        recordings: Ready to use, repaired when that was asked for.
        faults: What was found in each, by its name.
        notes: What was repaired, a sentence each.
    """

    recordings: list[Recording]
    faults: dict[str, tuple[Fault, ...]]
    notes: tuple[str, ...] = ()

    def entries(self) -> list[dict[str, Any]]:
        """The faults under their JSON names, each with its recording."""
        return [
            {"recording": name, **fault.entry()}
            for name, faults in self.faults.items()
            for fault in faults
        ]


def read_checked(
    dataset: Dataset,
    names: Sequence[str],
    *,
    without: Sequence[str] = (),
    repaired: bool = False,
) -> Checked:
    """Recordings of a dataset and their faults.

    Args:
        dataset: Where they are, and of which arm.
        names: Recordings to read; all when empty.
        without: Recordings that are held out.
        repaired: Whether to repair what can be; each file is then a recording of its own.

    Raises:
        BadInput: Nothing to read.
        BadRecording: A recording that cannot be used, also not after the repair.
    """
    if not repaired:
        recordings = dataset.recordings(names, without=without)
        return Checked(recordings, _faults(dataset.robot, {r.name: r for r in recordings}))
    raws = {
        path.stem: raw_recording(
            path, dataset.robot, dataset.mapping, torque_column=dataset.torque_column
        )
        for path in dataset.paths(names, without=without)
    }
    faults, notes, recordings = _faults(dataset.robot, raws), [], []
    for name, raw in raws.items():
        for fault in faults[name]:
            if "unclear" in fault.evidence:
                row, column = int(fault.evidence["rows"][0]), raw.columns.t[0]
                raise BadRecording(raw.file, fault.detail, row=row, column=column)
        better, done = repair(raw, faults[name])
        notes += [f"{name}: {sentence}" for sentence in done]
        recordings.append(recording_from_raw(better))
    return Checked(recordings, faults, tuple(notes))


def _faults(robot: Robot, recordings: dict[str, Any]) -> dict[str, tuple[Fault, ...]]:
    copies = find_copies(recordings)
    return {
        name: (*((copies[name],) if name in copies else ()), *find_faults(robot, raw))
        for name, raw in recordings.items()
    }
