"""All tests in the order in which one fault can hide or feign another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from excitant.identify.faults.channels import dead_channels, saturation
from excitant.identify.faults.counters import wrapped_counters
from excitant.identify.faults.excitation import poor_excitation
from excitant.identify.faults.fault import Fault
from excitant.identify.faults.fit import smooth
from excitant.identify.faults.frames import wrong_frame
from excitant.identify.faults.log import Log, Raw, log_of
from excitant.identify.faults.modelled import not_measured
from excitant.identify.faults.order import order_of, row_keys
from excitant.identify.faults.outliers import missing_values, outliers
from excitant.identify.faults.physics import physics_faults, torques
from excitant.identify.faults.repair import left_rows, repair
from excitant.identify.faults.repeats import held_channels, hidden_gaps, repeated_rows
from excitant.identify.faults.stamps import gap_fault, stamp_faults
from excitant.identify.faults.velocity import velocity_faults
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
    log = log_of(raw, robot.joints)
    rows = CheckedRows(log)
    if len(rows.log) < _SHORTEST:
        return tuple(rows.found)
    channels = [*dead_channels(rows.log), *saturation(rows.log, robot)]
    return (*rows.found, *channels, *motion_faults(robot, rows.longest, channels))


def motion_faults(robot: Robot, log: Log, channels: Sequence[Fault]) -> list[Fault]:
    """Faults that show in the velocity against the position, then those that physics shows.

    Args:
        robot: The arm.
        log: A log whose rows are in order.
        channels: Faults of its channels.
    """
    speeds = velocity_faults(log)
    log, _ = repair(log, speeds)
    return [*speeds, *_by_physics(robot, log, channels)]


class CheckedRows:
    """Faults of rows, and the log without them; empty where no row has a place in time.

    Every test names rows of the log it saw; they are counted in the log as it was at first.

    Attributes:
        log: The log as repairs would leave it.
        found: Faults.
    """

    def __init__(self, log: Log) -> None:
        self.log, self.found = log, list[Fault]()
        self._index = np.arange(len(log))
        self._starts = np.zeros(0)
        order = order_of(log.t, row_keys([x for _, x in log.channels()]), log.q)
        self._step(stamp_faults(log, order))
        if order.doubt:
            self.log = self.log.take(np.zeros(0, np.intp))
            return
        self._starts = self.log.t[np.isin(self._index, order.starts)]
        if len(self.log) >= _SHORTEST:
            self.found += self._located([gap_fault(self.log, self._starts)])
        self._step([missing_values(self.log)])
        if len(self.log) < _SHORTEST:
            return
        self._step([repeated_rows(self.log)])
        self._step(wrapped_counters(self.log))
        hidden = hidden_gaps(self.log)
        self.found += self._located([*held_channels(self.log), hidden])
        self._step(outliers(self.log, None if hidden is None else hidden.evidence["rows"]))

    @property
    def longest(self) -> Log:
        """The longest part in which the clock does not start anew."""
        parts = np.split(np.arange(len(self.log)), np.searchsorted(self.log.t, self._starts))
        return self.log.take(max(parts, key=len)) if len(parts) > 1 else self.log

    def _located(self, faults: Sequence[Fault | None]) -> list[Fault]:
        located = []
        for fault in (f for f in faults if f is not None):
            evidence = dict(fault.evidence)
            if "rows" in evidence:
                evidence["rows"] = self._index[evidence["rows"]]
            remedies = tuple(replace(r, rows=self._index[r.rows]) for r in fault.remedies)
            located.append(replace(fault, evidence=evidence, remedies=remedies))
        return located

    def _step(self, faults: Sequence[Fault | None]) -> None:
        seen = [f for f in faults if f is not None]
        if not seen:
            return
        self.found += self._located(seen)
        left = left_rows(self.log.t, [r for f in seen for r in f.remedies])
        self.log = self.log.take(left) if len(left) < 2 else repair(self.log, seen)[0]
        self._index = self._index[left]


def _by_physics(robot: Robot, log: Log, channels: Sequence[Fault]) -> list[Fault]:
    """Faults that only a model of the arm shows."""
    data = smooth(log)
    if data is None:
        poor = poor_excitation(robot, log, None)
        return [] if poor is None else [poor]
    useless = {
        joint
        for fault in channels
        if fault.fault == "dead_channel" and fault.evidence.get("channel") == "tau"
        for joint in fault.joints
    }
    case = torques(robot, log, data, useless)
    found: list[Fault] = []
    if case is not None:
        found = physics_faults(case)
        if found:
            log, _ = repair(log, found)
            data = smooth(log) or data
        else:
            found = [*not_measured(case), *wrong_frame(case)]
    poor = poor_excitation(robot, log, data)
    return [*found, *([poor] if poor is not None else [])]
