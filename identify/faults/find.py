"""All tests in the order in which one fault can hide or feign another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from excitant.identify.faults.channels import dead_channels, saturation
from excitant.identify.faults.excitation import poor_excitation
from excitant.identify.faults.fault import Fault
from excitant.identify.faults.fit import smooth
from excitant.identify.faults.frames import wrong_frame
from excitant.identify.faults.log import Log, Raw, log_of
from excitant.identify.faults.modelled import not_measured
from excitant.identify.faults.outliers import missing_values, outliers, wrapped_counters
from excitant.identify.faults.physics import physics_faults, torques
from excitant.identify.faults.repair import repair
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
    found: list[Fault] = []
    rows = _Rows(log)
    found += rows.found
    log = rows.log
    if len(log) < _SHORTEST:
        return tuple(found)
    channels = [*dead_channels(log), *saturation(log, robot)]
    found += channels
    speeds = velocity_faults(log)
    found += speeds
    log, _ = repair(log, speeds)
    return (*found, *_by_physics(robot, log, channels))


class _Rows:
    """Faults of rows, and the log without them.

    Every test names rows of the log it saw; they are counted in the log as it was at first.
    """

    def __init__(self, log: Log) -> None:
        self.log, self.found = log, list[Fault]()
        self._index = np.arange(len(log))
        self._step(stamp_faults(log))
        if len(self.log) >= _SHORTEST:
            self.found += self._located([gap_fault(self.log)])
        self._step([missing_values(self.log)])
        if len(self.log) < _SHORTEST:
            return
        self._step([repeated_rows(self.log)])
        self._step(wrapped_counters(self.log))
        hidden = hidden_gaps(self.log)
        self.found += self._located([*held_channels(self.log), hidden])
        self._step(outliers(self.log, None if hidden is None else hidden.evidence["rows"]))

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
        kept = np.ones(len(self.log), bool)
        for remedy in (r for f in seen for r in f.remedies if r.action == "drop"):
            kept[remedy.rows] = False
        if kept.sum() < 2:
            self.log, self._index = self.log.take(kept), self._index[kept]
            return
        self.log, _ = repair(self.log, seen)
        self._index = self._index[kept]


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
