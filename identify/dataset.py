"""Dataset: a folder of recordings with its robot, described by ``dataset.json``.

Logs too long to hold are low-passed and decimated while they are read. Torque is judged up to 10 Hz
and positions are filtered at twice that, so 160 samples a second say all that identification uses.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import date
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet
import scipy

from excitant.exceptions import BadInput, BadRecording, UnknownName
from excitant.files import size_of
from excitant.identify.importers.bags import described, is_bag
from excitant.identify.importers.names import ColumnMap, column_map, drive_of, load_column_map
from excitant.identify.preprocessing import (
    CUTOFF_HZ,
    POSITION_RATIO,
    at_instants,
    refuse_bursts,
    uninterrupted,
)
from excitant.identify.recording import (
    SUFFIXES,
    Recording,
    load_recording,
    read_chunks,
    suffix_of,
)
from excitant.robots.chains import RobotSpec
from excitant.robots.files import parse_xml, within
from excitant.robots.limits import limits_from
from excitant.robots.loading import load_robot, robot_of
from excitant.robots.mjcf import Description
from excitant.robots.motion import Array
from excitant.robots.robot import Robot
from excitant.robots.schema import RobotRecord, read_yaml

LONG = 1_000_000
"""Samples of recordings together from which they are read in pieces and decimated."""

_USUAL = (".parquet", ".csv")
_PASSED_HZ = POSITION_RATIO * CUTOFF_HZ
_RATE_HZ = 8 * _PASSED_HZ
_STOPPED_DB = 80.0  # what is folded onto the band that is passed
_DATE = re.compile(r"(?<!\d)(\d{4})-?(\d\d)-?(\d\d)(?!\d)")
_START = 1 << 16  # bytes of a text file, whose lines stand for all


class _Kinematics(msgspec.Struct, frozen=True):
    urdf: str | None = "robot.urdf"
    lock: list[str] | None = None  # joints that are locked at 0


class _Torque(msgspec.Struct, frozen=True):
    column: str | None = None
    gains: Any = msgspec.field(name="drive_gain_Nm_per_A", default=None)


class _Sidecar(msgspec.Struct, frozen=True):
    """Entries read from a ``dataset.json``; others are ignored."""

    arm: str | None = None  # serial number, or what else tells it from others of its type
    date: date | None = None
    kinematics: _Kinematics | None = None
    torque: _Torque | None = None
    units: Any = None


@dataclass(frozen=True)
class Dataset:
    """A robot and where its recordings are."""

    robot: Robot
    folder: Path | None = None  # the recordings are named relative to; None when they are paths
    mapping: ColumnMap = field(default_factory=ColumnMap)  # of columns and drives
    bag: Path | None = None  # that described the robot, and is its recording

    def recordings(self, names: Sequence[str], *, without: Sequence[str] = ()) -> list[Recording]:
        """Recordings by name; all of the folder that are not held out when none is named.

        Raises:
            BadInput: Nothing to read, or a recording both named and held out (``without``).
            BadRecording: A recording that cannot be used.
        """
        paths = self.paths(names, without=without)
        return read_recordings(paths, self.robot, mapping=self.mapping)

    def paths(self, names: Sequence[str], *, without: Sequence[str] = ()) -> list[Path]:
        """Files of recordings; see `recordings`."""
        held = {self._path(name).resolve() for name in without}
        for name in names:
            if self._path(name).resolve() in held:
                why = "is to be fitted and held out; leave it out of one of the two"
                raise BadInput(f"{name} {why}")
        given = [self._path(name) for name in names]
        paths = [p for path in given for p in _inside(path)] or self._all()
        kept = [path for path in paths if path.resolve() not in held]
        if not kept:
            raise BadInput(f"{self.folder}: every recording is held out; none is left to fit")
        return kept

    def _path(self, name: str) -> Path:
        path = Path(name) if self.folder is None else self.folder / name
        if self.folder is None or path.exists():
            return path
        found = (path.with_name(path.name + suffix) for suffix in SUFFIXES)
        return next((each for each in found if each.is_file()), path)

    def _all(self) -> list[Path]:
        if self.bag is not None:
            return [self.bag]
        if self.folder is None:
            raise BadInput("no recording given; name at least one file")
        return _inside(self.folder)


def _inside(path: Path) -> list[Path]:
    """The recordings in a folder, those in the usual formats if there are any; else the path."""
    if not path.is_dir() or is_bag(path):
        return [path]
    files = sorted(path.iterdir())
    found = [p for p in files if p.suffix in _USUAL] or [
        p for p in files if suffix_of(p) in SUFFIXES or is_bag(p)
    ]
    if not found:
        raise BadInput(f"{path}: no .parquet or .csv recording in this folder, and it is no bag")
    return found


def load_dataset(spec: str | Path, *, columns: str | Path | None = None) -> Dataset:
    """Dataset from a folder with ``dataset.json`` or ``robot.urdf``, a bag, or a robot alone.

    A bag, or a folder of bags, needs no robot beside it if it has one on ``robot_description``.

    ``columns`` is a file that says what columns mean (`load_column_map`), the folder's
    ``columns.yaml`` when not given; drive constants that it leaves out are those of a robot.yaml.

    Raises:
        BadInput: A folder without a robot, or a file that cannot be read.
    """
    folder = Path(spec)
    given = ColumnMap() if columns is None else load_column_map(columns)
    if is_bag(folder) and folder.exists():
        return Dataset(_robot_in(folder, spec), mapping=given, bag=folder)
    if not folder.is_dir():
        return Dataset(load_robot(spec), mapping=_with_drive(given, folder))
    sidecar, beside = folder / "dataset.json", folder / "columns.yaml"
    if columns is None and beside.is_file():
        given = load_column_map(beside)
    known = read_yaml(sidecar, _Sidecar, "a data set") if sidecar.is_file() else _Sidecar()
    kinematics, torque = known.kinematics or _Kinematics(), known.torque or _Torque()
    candidates = [folder / name for name in (kinematics.urdf, "robot.yaml") if name]
    model = next((path for path in candidates if path.is_file()), None)
    if model is None:
        files = sorted(folder.iterdir())
        if bag := next(filter(is_bag, files), None):
            return Dataset(_robot_in(bag, bag), folder, given)
        raise BadInput(
            f"{folder}: no robot model (robot.urdf or robot.yaml) in this folder; add one, or "
            f"give ROBOT and the paths of the recordings"
        )
    if kinematics.urdf != _Kinematics().urdf and model == candidates[0]:
        within(model, sidecar, allow="ROBOT and the paths of the recordings on the command line")
    try:
        robot = load_robot(model, lock=dict.fromkeys(kinematics.lock or [], 0.0) or None)
    except UnknownName as error:
        raise BadInput(f"{sidecar}: {error}") from None
    if isinstance(known.units, dict) and not given.units:
        given = replace(given, units=column_map({"units": known.units}, str(sidecar)).units)
    if given.drive is None and isinstance(torque.gains, list):
        given = replace(given, drive=drive_of({"gain_Nm_per_A": torque.gains}, str(sidecar)))
    return Dataset(robot, folder, replace(_with_drive(given, model), torque=torque.column))


def _robot_in(bag: Path, spec: str | Path | RobotSpec) -> Robot:
    """The robot that a bag describes; joints without states in it, or coupled ones, are held."""
    found = described(bag)
    if found is None:
        raise BadInput(
            f"{bag}: no robot_description in this bag; give ROBOT before it, or record that topic"
        )
    spec = spec if isinstance(spec, RobotSpec) else RobotSpec(spec)
    joints = parse_xml(found.urdf, bag).findall("joint")
    movable = [str(joint.get("name")) for joint in joints if joint.get("type") != "fixed"]
    coupled = {
        name
        for joint in joints
        for mimic in joint.findall("mimic")
        for name in (joint.get("name"), mimic.get("joint"))
    }
    seen = {*found.joints} - coupled | {*(spec.joints or ())}
    held = [name for name in movable if name not in seen]
    held = held if len(held) < len(movable) else []  # else names differ, by a prefix perhaps
    spec = replace(spec, lock={**dict.fromkeys(held, 0.0), **spec.lock})
    robot = robot_of(Description(found.urdf), spec)
    if any(joint in robot.joints for joint in found.limits):
        robot = robot.with_limits(limits_from({"joint_limits": found.limits}, robot, bag))
    said = f"held at 0, without states of their own in the bag: {', '.join(held)}"
    return replace(robot, notes=(*robot.notes, *[said] * bool(held)))


def is_dataset(folder: Path) -> bool:
    """Whether a folder holds a robot or recordings, be they readable or not."""
    names = {path.name for path in folder.iterdir()}
    return bool(names & {"dataset.json", "robot.urdf", "robot.yaml"}) or any(
        suffix_of(Path(name)) in SUFFIXES for name in names
    )


def origin(folder: Path, name: str) -> tuple[str, date | None]:
    """Arm and date of a data set: those of its ``dataset.json``, else what its name says.

    A name such as ``cell3/2026-03-01`` or ``cell3-20260301`` is that of the arm with the date.

    Raises:
        BadInput: A ``dataset.json`` that cannot be read.
    """
    sidecar = folder / "dataset.json"
    known = read_yaml(sidecar, _Sidecar, "a data set") if sidecar.is_file() else _Sidecar()
    arm, day = name, None
    for found in _DATE.finditer(name):
        with suppress(ValueError):
            day = date(*map(int, found.groups()))
            arm = (name[: found.start()] + name[found.end() :]).strip("/_-. ") or name
    return known.arm or arm, known.date or day


def _with_drive(given: ColumnMap, model: Path) -> ColumnMap:
    if given.drive or model.suffix not in (".yaml", ".yml") or not model.is_file():
        return given
    drive = drive_of(read_yaml(model, RobotRecord, "a robot").drive, str(model))
    return replace(given, drive=drive)


def read_recordings(
    paths: Sequence[str | Path], robot: Robot | int, *, mapping: ColumnMap | None = None
) -> list[Recording]:
    """Recordings from logs, in order; see `load_recording`.

    Logs that are too long to hold are low-passed and decimated as they are read.
    """
    if sum(_samples(Path(path)) for path in paths) > LONG:
        return [decimated(read_chunks(path, robot, mapping=mapping)) for path in paths]
    return [load_recording(path, robot, mapping=mapping) for path in paths]


def _samples(path: Path) -> int:
    """Number of samples of a Parquet file, about that of a text file, else 0; 0 if unreadable."""
    suffix = path.suffix.lower()
    try:
        size = size_of(path)
        if suffix in (".parquet", ".pq"):
            with pa.parquet.ParquetFile(path) as file:
                return int(file.metadata.num_rows)
        if suffix in (".csv", ".txt", ".tsv"):
            with path.open("rb") as file:
                start = file.read(_START)
            return int(size * start.count(b"\n") / max(len(start), 1))
    except (OSError, pa.ArrowException):
        pass  # said where it is read
    return 0


def decimated(pieces: Iterable[Recording]) -> Recording:
    """One recording of consecutive pieces, decimated to 160 Hz or a little above.

    Time keeps its gaps; at both ends of an uninterrupted part half the filter's length is lost.
    A log whose rate is below twice that is only put together.

    Raises:
        BadRecording: No uninterrupted part is longer than the filter.
    """
    pieces = iter(pieces)
    first = next(pieces)
    passed, nv = _Filter(float(np.median(np.diff(first.t)))), first.nv
    kept, count = [np.empty(0), np.empty((0, nv)), np.empty((0, nv))], 0
    rest: tuple[Array, ...] = (first.t[:0], first.q[:0], first.tau[:0])
    for piece in itertools.chain([first], pieces):
        now = [
            np.concatenate(pair) for pair in zip(rest, (piece.t, piece.q, piece.tau), strict=True)
        ]
        for part in uninterrupted(now[0]):
            refuse_bursts(now[0][part], passed.step, first.file)
            found, used = passed(*(values[part] for values in now))
            total = count + len(found[0])
            for values, more in zip(kept, found, strict=True):
                if total > len(values):  # in place: no second copy of a long log
                    values.resize((total + total // 4, *values.shape[1:]), refcheck=False)
                values[count:total] = more
            count = total
            rest = tuple(values[part][used:] for values in now)
    if not count:
        raise BadRecording(first.file, "no uninterrupted part is long enough", column="t")
    for values in kept:
        values.resize((count, *values.shape[1:]), refcheck=False)
        values.setflags(write=False)
    note = f"read in pieces, low-passed and decimated to {passed.rate_hz:.4g} Hz, for it is long"
    t, q, tau = kept
    return replace(first, t=t, q=q, tau=tau, dq=None, extras={}, notes=(*first.notes, note))


class _Filter:
    """Low-pass and decimation of samples every ``step`` [s]; keeps its grid from call to call."""

    def __init__(self, step: float) -> None:
        self.step, self.factor = step, max(1, int(1 / (step * _RATE_HZ)))
        self.rate_hz = 1 / (self.factor * step)  # of what comes out
        stop = self.rate_hz - _PASSED_HZ
        width = (stop - _PASSED_HZ) * 2 * step
        taps, beta = scipy.signal.kaiserord(_STOPPED_DB, min(max(width, 1e-3), 0.99))
        self.half, self.h = 0, np.ones(1)
        if self.factor > 1:
            self.half, cutoff = -(-taps // 2), (stop + _PASSED_HZ) / 2
            window = ("kaiser", beta)
            self.h = scipy.signal.firwin(2 * self.half + 1, cutoff, window=window, fs=1 / step)
        self.next: float | None = None  # when the next sample is due [s]

    def __call__(self, t: Array, q: Array, tau: Array) -> tuple[tuple[Array, ...], int]:
        """Samples t, q, τ that these determine, and how many of these are used up."""
        reach, every = self.half * self.step, self.factor * self.step
        if self.next is None or not t[0] - self.step < self.next - reach < t[-1]:
            self.next = float(t[0]) + reach
        count = int((t[-1] - reach - self.next) / every + 1 + 1e-6)
        if len(t) < 4 or count < 1:
            return (t[:0], q[:0], tau[:0]), 0
        n = (count - 1) * self.factor + 2 * self.half + 1
        grid = self.next - reach + self.step * np.arange(n)
        some = at_instants(t, q, tau, np.clip(grid, t[0], t[-1]))
        h = self.h[:, None]
        q, tau = (scipy.signal.oaconvolve(x, h, mode="valid", axes=0)[:: self.factor] for x in some)
        times = np.asarray(self.next + every * np.arange(count), float)
        self.next = float(times[-1] + every)
        used = int(np.searchsorted(t, self.next - reach - 3 * self.step))
        return (times, q, tau), used
