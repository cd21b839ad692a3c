"""Log: a recording as its tests see it; Fault: what is wrong with it, its evidence, its repair."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
import scipy

from excitant.exceptions import BadInput
from excitant.identify.recording import Recording
from excitant.identify.signals import noise, quantum
from excitant.robots.motion import Array
from excitant.robots.robot import Robot

INSTALLATION = ("wrong_mounting", "wrong_zero")
"""Faults of the model, which has the arm otherwise than it is installed."""
OF_THE_ARM = ("wrong_sign", "wrong_order", "coupled_axes", *INSTALLATION)
"""Faults of the arm or its logger, which all recordings share."""
PROVEN = (
    *OF_THE_ARM,
    "wrong_unit",
    "wrong_sample_rate",
    "time_delay",
    "swapped_recordings",
    "not_measured",
)
"""Faults after which every figure is wrong, so that nothing is published from such data."""


def is_modelled(fault: Mapping[str, Any]) -> bool:
    """Whether a fault, under its JSON names, is one of the model that a diagnosis amends there.

    A torque without gravity is none: nothing says what was taken off it.
    """
    gravity = fault["evidence"].get("gravity", 1.0)
    return fault["fault"] in INSTALLATION and bool(np.any(gravity))


FAULTS = (
    *PROVEN,
    "dead_channel",
    "duplicate_samples",
    "dropped_samples",
    "corrupt_rows",
    "saturation",
    "wrong_frame",
    "poor_excitation",
)
"""The vocabulary, the same in results, interface and documentation."""
OPEN = "open"
"""Evidence of a fault that another column of its joint may have: the torque would be the same."""
DOUBT = "doubt"
"""Evidence of a fault that the torque speaks for, but that is less likely than none."""
NO_TORQUE = "dead_channel", "tau"
"""Fault and channel of a joint whose torque tells nothing."""
ALARM = 0.02 / 20
"""Share of faultless recordings that one family of tests may accuse; there are fewer than 20."""
Rows = npt.NDArray[np.intp]
NO_ROWS: Rows = np.zeros(0, np.intp)
Mask = npt.NDArray[np.bool_]
_SPAN = 4  # samples to either side of the one whose speed is asked
_SHOWN = 10  # of many rows, in results
DECODED: Mapping[str, Callable[[Array, float], Array]] = {
    "unwrap": lambda x, turn: np.unwrap(x, period=turn),
    "signed": lambda x, n: np.where(np.sign(n) * x > abs(n) / 2, x - n, x),
    "sign_bit": lambda x, n: np.where(
        np.sign(n) * x >= (1 - 1e-9) * abs(n), n - x, x
    ),
}
"""Values of a channel by how they are coded and the size of that code, negative as values are."""
ON_COLUMNS = {"order", "add", "scale", "offset"}
"""Actions on all values of a channel alike, which a map may state."""
_IN_SEQUENCE = (*ON_COLUMNS, "advance", *DECODED, "interpolate")
"""Actions on values: each remedy finds the log as those before it left it."""
_R = TypeVar("_R", bound=Recording)


@dataclass(frozen=True, eq=False)
class Log(Recording):
    """A recording of named joints before anything is believed of it, and what is usual in it."""

    joints: tuple[str, ...] = ()
    most: float | Array = np.inf  # torque that drives can give, (nv,) [N·m]

    @classmethod
    def of(cls, robot: Robot, recording: Recording) -> Log:
        """A recording as logged, of the arm's joints."""
        known = {
            name: getattr(recording, name)
            for name in ("t", "q", "tau", "dq", "unit")
        }
        most = robot.limits.torque if recording.unit == "N·m" else np.inf
        return cls(
            recording.name, recording.file, **known, joints=robot.joints, most=most
        )

    def names(self, joints: Any) -> tuple[str, ...]:
        """Names of joints by index."""
        return tuple(self.joints[int(j)] for j in joints)

    def first(self, rows: Rows) -> str:
        """The first of some rows, in words."""
        return f"first row {rows[0]} at t = {self.t[rows[0]]:.4g} s"

    @cached_property
    def quanta(self) -> dict[str, Array]:
        """Smallest step between two values of each joint, shape (nv,), by channel."""
        return {
            name: np.array(list(map(quantum, x.T))) for name, x in self.channels()
        }

    @cached_property
    def grain(self) -> Array:
        """Noise or step of each position, whichever is larger, shape (nv,)."""
        return np.maximum([noise(column) for column in self.q.T], self.quanta["q"])

    @cached_property
    def travel(self) -> Array:
        """Change of position per sample around each one, (n, nv)."""
        rows = np.arange(len(self))
        low = np.maximum(rows - _SPAN, 0)
        high = np.minimum(rows + _SPAN, len(self) - 1)
        return (self.q[high] - self.q[low]) / np.maximum(high - low, 1)[:, None]

    @cached_property
    def moving(self) -> Mask:
        """Rows at which a joint moves by several times its `grain` per sample, (n, nv)."""
        return np.abs(self.travel) > 4 * self.grain


@dataclass(frozen=True, eq=False)
class Remedy:
    """Effect of a repair on the arrays.

    ``drop`` rows, ``interpolate`` rows of a channel, ``scale`` a channel or the time, ``order`` the
    joints of a channel (joint j is then the one recorded as ``joints[j]``), ``add`` the second of
    two joints to the first, ``offset`` values, ``unwrap`` turns, decode ``signed`` counters or a
    ``sign_bit``, ``advance`` a channel against the time, which leaves out rows that it does not
    reach, ``sort`` all rows by time, or ``exchange`` the torque for that of another recording,
    which is done where both are at hand.
    """

    action: str
    channel: str = ""  # t, q, dq or tau; empty for whole rows
    joints: tuple[int, ...] = ()
    rows: Rows = field(default_factory=lambda: NO_ROWS)
    # of values; or the range of the counter, what is added or advanced [s]
    factor: float = 1.0

    def on_columns(self, x: Array) -> Array:
        """Columns of the joints, shape (N, nv), put in order, added, scaled or moved as it says."""
        joints = list(self.joints)
        if self.action == "order":
            return x[:, joints]
        x = np.array(x)
        if self.action == "add":
            x[:, joints[0]] += self.factor * x[:, joints[1]]
        elif self.action == "scale":
            x[:, joints] *= self.factor
        elif self.action == "offset":
            x[:, joints] += self.factor
        return x

    def advanced(self, x: Array, t: Array) -> Array:
        """Columns, shape (N, nv), as they are later by what it says; those of its joints."""
        x = np.array(x)
        for j in self.joints:
            x[:, j] = np.interp(t + self.factor, t, x[:, j])
        return x


@dataclass(frozen=True, eq=False)
class Fault:
    """One fault of a recording, and what would repair it where something can be done."""

    fault: str  # one of `FAULTS`
    joints: tuple[str, ...]  # all of them when it concerns whole rows or the time
    detail: str  # the evidence in one sentence, with numbers
    # what repairs and pages read: channel, rows, factor, ...
    evidence: Mapping[str, Any]
    repair: str | None = None
    remedies: tuple[Remedy, ...] = ()
    map: str | None = None  # the same as a column map, where one can state it

    @property
    def repairable(self) -> bool:
        """Whether its remedies follow from the data, and are not one of several that would do."""
        return bool(self.remedies) and OPEN not in self.evidence

    @property
    def channel(self) -> object:
        """Channel at fault, where it is one."""
        return self.evidence.get("channel")

    @property
    def of_the_arm(self) -> bool:
        """Whether all recordings of the arm share it."""
        return self.fault in OF_THE_ARM and self.channel != "dq"

    def entry(self) -> dict[str, Any]:
        """The fault under its JSON names; of many rows the first ten."""
        return {
            "fault": self.fault,
            "joints": list(self.joints),
            "detail": self.detail,
            "evidence": {
                name: _plain(value) for name, value in self.evidence.items()
            },
            "repair": self.repair,
            "map": self.map,
        }

    def at(self, rows: Rows) -> Fault:
        """The fault with its rows counted in another log, of which these rows were seen."""
        evidence = dict(self.evidence)
        if "rows" in evidence:
            evidence["rows"] = rows[evidence["rows"]]
        remedies = tuple(replace(r, rows=rows[r.rows]) for r in self.remedies)
        return replace(self, evidence=evidence, remedies=remedies)


def as_guess(fault: Fault) -> Fault:
    """The fault with remedies that are one choice of several: nothing is repaired by them."""
    return replace(fault, repair=None, evidence={**fault.evidence, OPEN: True})


def joints_without_torque(faults: Iterable[Fault]) -> set[str]:
    """Joints whose torque tells nothing."""
    return {f.joints[0] for f in faults if (f.fault, f.channel) == NO_TORQUE}


def dropped(
    joints: tuple[str, ...],
    rows: Rows,
    detail: str,
    fault: str = "corrupt_rows",
    **evidence: Any,
) -> Fault:
    """A fault of rows that a repair leaves out."""
    known = {"rows": rows, **evidence}
    done = f"leaves these {len(rows)} rows out"
    return Fault(fault, joints, detail, known, done, (Remedy("drop", rows=rows),))


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray | list | tuple):
        return [_plain(v) for v in list(value)[:_SHOWN]]
    if isinstance(value, np.generic):
        value = value.item()
    return value if not isinstance(value, float) or np.isfinite(value) else None


def repair(recording: _R, faults: Sequence[Fault]) -> tuple[_R, tuple[str, ...]]:
    """The recording with its repairable faults repaired, and what was done, a sentence each.

    Raises:
        BadInput: The repairs leave no two samples.
    """
    certain = [fault for fault in faults if fault.repairable]
    better, rows = after_repair(recording, certain)
    if len(rows) < 2:
        raise BadInput(
            f"repair leaves {len(rows)} of {len(recording)} rows; record again"
        )
    return better, tuple(
        f"{fault.fault} ({', '.join(fault.joints)}): repaired, which {fault.repair}"
        for fault in certain
    )


def after_repair(recording: _R, faults: Sequence[Fault]) -> tuple[_R, Rows]:
    """The recording with its faults repaired, and which of its rows are left, in their new order.

    Rows of remedies count rows of this recording: sorted first, and left out last.
    """
    remedies = [r for fault in faults for r in fault.remedies]
    kept = np.ones(len(recording), bool)
    order = np.arange(len(recording))
    for remedy in remedies:
        if remedy.action == "drop":
            kept[remedy.rows] = False
    if any(remedy.action == "sort" for remedy in remedies):
        order = np.argsort(recording.t, kind="stable")
    kept = kept[order]
    place = np.argsort(order)
    ordered = recording.take(order)
    values: dict[str, Any] = {name: np.array(x) for name, x in ordered.channels()}
    values["t"] = np.array(ordered.t)
    for remedy in remedies:
        if remedy.action in _IN_SEQUENCE and remedy.channel in values:
            _apply(values, remedy, place[remedy.rows], kept)
    return replace(ordered, **values).take(kept), order[kept]


def _apply(
    values: dict[str, Array], remedy: Remedy, rows: Rows, kept: Mask
) -> None:
    """Do what a remedy says to channels by name, and rows kept, in place; others do not count."""
    x = values[remedy.channel]
    if remedy.channel == "t":
        values["t"] = x[0] + (x - x[0]) * remedy.factor
        return
    t = values["t"]
    if remedy.action in ON_COLUMNS:
        values[remedy.channel] = remedy.on_columns(x)
        return
    if remedy.action == "advance":
        values[remedy.channel] = remedy.advanced(x, t)
        kept &= (t + remedy.factor >= t.min()) & (t + remedy.factor <= t.max())
        return
    for j in remedy.joints:
        if remedy.action in DECODED:
            x[:, j] = DECODED[remedy.action](x[:, j], remedy.factor)
        else:
            good = kept & np.isfinite(x[:, j]) & np.isfinite(t)
            good[rows] = False
            if len(order := np.flatnonzero(good)):
                x[rows, j] = np.interp(rows, order, x[order, j])


def tail_bound(values: Array, alarm: float = ALARM) -> float:
    """Level that the largest of some magnitudes exceeds by chance with probability ``alarm``.

    Beyond its 90 % quantile their distribution is taken to fall off like exp(−√z), as fast as
    between the median and there: far heavier than Gaussian, and blind to a tenth of outliers.
    """
    if not len(values):
        return np.inf
    low, high = np.sqrt(np.quantile(values, (0.5, 0.9)))
    decay = (high - low) / np.log(0.5 / 0.1)
    return float((high + decay * max(np.log(0.1 * len(values) / alarm), 0.0)) ** 2)


def normal_bound(tests: int) -> float:
    """Level that the largest of many standard normal variables exceeds by chance."""
    return float(-scipy.special.ndtri(ALARM / (2 * max(tests, 1))))


def run_lengths(same: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Starts and lengths of the runs of True in a boolean array."""
    edges = np.diff(np.pad(same.astype(np.int8), 1))
    starts = np.flatnonzero(edges == 1)
    return starts, np.flatnonzero(edges == -1) - starts
