"""Dataset: a folder of recordings with its robot, described by ``dataset.json``.

Of logs of hours, all rows are read and checked, and windows at equal distances are kept.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import date
from os.path import exists, isdir, isfile
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from excitant.exceptions import BadInput, UnknownName
from excitant.files import real_path, size_of
from excitant.identify.faults import Checked, check_recordings
from excitant.identify.parked import freed_for, parked
from excitant.identify.reading.bags import described, is_bag
from excitant.identify.reading.logs import (
    SUFFIXES,
    TEXTS,
    load_recording,
    quantities_in,
    raw_recording,
    read_chunks,
    suffix_of,
)
from excitant.identify.reading.mapping import (
    ColumnMap,
    column_map,
    drive_of,
    load_column_map,
)
from excitant.identify.reading.tables import parquet_file
from excitant.identify.recording import Recording
from excitant.robots.chains import RobotSpec
from excitant.robots.files import parse_xml, within
from excitant.robots.limits_file import limits_from
from excitant.robots.loading import load_robot, robot_of
from excitant.robots.mjcf import Description
from excitant.robots.robot import Robot
from excitant.robots.schema import RobotRecord, read_yaml

LONG = 300_000
"""Samples of recordings together, of which no more are kept: more rows than a fit uses."""
WINDOW_S = 30.0
"""Length of the windows that are kept of longer ones [s]."""

_DATE = re.compile(r"(?<!\d)(\d{4})-?(\d\d)-?(\d\d)(?!\d)")


class _Kinematics(msgspec.Struct, frozen=True):
    urdf: str | None = "robot.urdf"
    lock: list[str] | None = None  # joints that are locked at 0


class _Torque(msgspec.Struct, frozen=True):
    column: str | None = None
    gains: Any = msgspec.field(name="drive_gain_Nm_per_A", default=None)


class _Sidecar(msgspec.Struct, frozen=True):
    """Entries read from a ``dataset.json``; others are ignored."""

    # serial number, or what else tells it from others of its type
    arm: str | None = None
    date: date | None = None
    kinematics: _Kinematics | None = None
    torque: _Torque | None = None
    units: Any = None


@dataclass(frozen=True)
class Dataset:
    """A robot and where its recordings are."""

    robot: Robot
    # the recordings are named relative to; None when they are paths
    folder: Path | None = None
    mapping: ColumnMap = field(default_factory=ColumnMap)  # of columns and drives
    bag: Path | None = None  # that described the robot, and is its recording

    def recordings(self, names: Sequence[str]) -> list[Recording]:
        """Recordings by name; all of the folder when none is named.

        Raises:
            BadInput: Nothing to read.
            BadRecording: A recording that cannot be used.
        """
        return read_recordings(self.paths(names), self.robot, mapping=self.mapping)

    def paths(
        self, names: Sequence[str], *, without: Sequence[str] = ()
    ) -> list[Path]:
        """Files of recordings by name; all that are not held out (``without``) when none is named.

        Raises:
            BadInput: Nothing to read, or a recording both named and held out.
        """
        holdout = {real_path(self._path(name)) for name in without}
        for name in names:
            if real_path(self._path(name)) in holdout:
                why = "is to be fitted and held out; leave it out of one of the two"
                raise BadInput(f"{name} {why}")
        paths = [path for name in names for path in _inside(self._path(name))]
        paths = [p for p in paths or self._all() if real_path(p) not in holdout]
        if not paths:
            why = "every recording is held out; none is left to fit"
            raise BadInput(f"{self.folder}: {why}")
        return paths

    def _path(self, name: str) -> Path:
        path = Path(name) if self.folder is None else self.folder / name
        if self.folder is None or exists(path):
            return path
        files = (path.with_name(path.name + suffix) for suffix in SUFFIXES)
        return next(filter(isfile, files), path)

    def _all(self) -> list[Path]:
        if self.bag is not None:
            return [self.bag]
        if self.folder is None:
            raise BadInput("no recording given; name at least one file")
        return _inside(self.folder)


def _inside(path: Path) -> list[Path]:
    """The recordings in a folder, those in the usual formats if there are any; else the path."""
    if not isdir(path) or is_bag(path) or quantities_in(path):
        return [path]
    files = sorted(path.iterdir())
    usual = [p for p in files if p.suffix in (".parquet", ".csv")]
    logs = usual or [
        p
        for p in files
        if suffix_of(p) in SUFFIXES or is_bag(p) or quantities_in(p)
    ]
    if not logs:
        why = "no .parquet or .csv recording in this folder, and it is no bag"
        raise BadInput(f"{path}: {why}")
    return logs


def load_dataset(spec: str | Path, *, columns: str | Path | None = None) -> Dataset:
    """Dataset from a folder with ``dataset.json`` or ``robot.urdf``, a bag, or a robot alone.

    A bag, or a folder of bags, needs no robot beside it if it has one on ``robot_description``.

    ``columns`` is a file that says what columns mean (`load_column_map`), the folder's
    ``columns.yaml`` when not given; drive constants that it leaves out are those of a robot.yaml.

    Raises:
        BadInput: A folder without a robot, or a file that cannot be read.
    """
    folder = Path(spec)
    mapping = ColumnMap() if columns is None else load_column_map(columns)
    if is_bag(folder) and exists(folder):
        return Dataset(_robot_in(folder, spec), mapping=mapping, bag=folder)
    if not isdir(folder):
        return Dataset(load_robot(spec), mapping=_with_drive(mapping, folder))
    beside = folder / "columns.yaml"
    if columns is None and isfile(beside):
        mapping = load_column_map(beside)
    sidecar = folder / "dataset.json"
    record = _sidecar(folder)
    kinematics = record.kinematics or _Kinematics()
    torque = record.torque or _Torque()
    models = [folder / name for name in (kinematics.urdf, "robot.yaml") if name]
    model = next(filter(isfile, models), None)
    if model is None:
        bag = next(filter(is_bag, sorted(folder.iterdir())), None)
        if bag is not None:
            return Dataset(_robot_in(bag, bag), folder, mapping)
        raise BadInput(
            f"{folder}: no robot model (robot.urdf or robot.yaml) in this folder; add one, or "
            f"give ROBOT and the paths of the recordings"
        )
    if kinematics.urdf != _Kinematics().urdf and model == models[0]:
        advice = "ROBOT and the paths of the recordings on the command line"
        within(model, sidecar, allow=advice)
    try:
        lock = dict.fromkeys(kinematics.lock or [], 0.0)
        robot = load_robot(model, lock=lock or None)
    except UnknownName as error:
        raise BadInput(f"{sidecar}: {error}") from None
    source = str(sidecar)
    if isinstance(record.units, dict) and not mapping.units:
        units = column_map({"units": record.units}, source).units
        mapping = replace(mapping, units=units)
    if mapping.drive is None and isinstance(torque.gains, list):
        drive = drive_of({"gain_Nm_per_A": torque.gains}, source)
        mapping = replace(mapping, drive=drive)
    mapping = replace(_with_drive(mapping, model), torque=torque.column)
    return Dataset(robot, folder, mapping)


def _sidecar(folder: Path) -> _Sidecar:
    """The folder's ``dataset.json``, or one that says nothing."""
    file = folder / "dataset.json"
    return read_yaml(file, _Sidecar, "a data set") if isfile(file) else _Sidecar()


def _robot_in(bag: Path, spec: str | Path | RobotSpec) -> Robot:
    """The robot that a bag describes; joints without states in it, or coupled ones, are locked."""
    description = described(bag)
    if description is None:
        why = "no robot_description in this bag; give ROBOT before it, or record that topic"
        raise BadInput(f"{bag}: {why}")
    spec = spec if isinstance(spec, RobotSpec) else RobotSpec(spec)
    joints = parse_xml(description.urdf, bag).findall("joint")
    movable = [str(j.get("name")) for j in joints if j.get("type") != "fixed"]
    coupled = {
        name
        for joint in joints
        for mimic in joint.findall("mimic")
        for name in (joint.get("name"), mimic.get("joint"))
    }
    logged = {*description.joints} - coupled | {*(spec.joints or ())}
    locked = [name for name in movable if name not in logged]
    if len(locked) == len(movable):  # names differ, by a prefix perhaps
        locked = []
    spec = replace(spec, lock={**dict.fromkeys(locked, 0.0), **spec.lock})
    robot = robot_of(Description(description.urdf), spec)
    if any(joint in robot.joints for joint in description.limits):
        limits = limits_from({"joint_limits": description.limits}, robot, bag)
        robot = robot.with_limits(limits)
    if not locked:
        return robot
    note = f"held at 0, without states of their own in the bag: {', '.join(locked)}"
    return replace(robot, notes=(*robot.notes, note))


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
    record = _sidecar(folder)
    arm = name
    day = None
    for match in _DATE.finditer(name):
        with suppress(ValueError):
            day = date(*map(int, match.groups()))
            arm = (name[: match.start()] + name[match.end() :]).strip(
                "/_-. "
            ) or name
    return record.arm or arm, record.date or day


def _with_drive(mapping: ColumnMap, model: Path) -> ColumnMap:
    """A map with the drive constants of a robot.yaml, where it has none."""
    is_yaml = model.suffix in (".yaml", ".yml") and isfile(model)
    if mapping.drive or not is_yaml:
        return mapping
    record = read_yaml(model, RobotRecord, "a robot")
    return replace(mapping, drive=drive_of(record.drive, str(model)))


def read_recordings(
    paths: Sequence[str | Path],
    robot: Robot | int,
    *,
    mapping: ColumnMap | None = None,
) -> list[Recording]:
    """Recordings from logs, in order; see `load_recording`.

    Of logs that are too long to hold, windows at equal distances are kept (`excerpt`).
    """
    share = LONG / max(1, sum(_samples(Path(path)) for path in paths))
    if share >= 1:
        return [load_recording(path, robot, mapping=mapping) for path in paths]
    logs = [read_chunks(path, robot, mapping=mapping) for path in paths]
    return [excerpt(pieces, share) for pieces in logs]


def read_checked(
    dataset: Dataset,
    names: Sequence[str],
    *,
    without: Sequence[str] = (),
    repaired: bool = False,
    beside: Checked | None = None,
    held: bool = True,
) -> Checked:
    """Recordings of a dataset, with their faults, and without the joints that stand in them.

    Args:
        dataset: The robot and where its recordings are.
        names: Recordings by name; see `Dataset.recordings`.
        without: Recordings that are held out.
        repaired: Whether to repair what has a remedy; see `check_recordings`.
        beside: Recordings that are fitted; None where these are.
        held: Whether joints that are chosen and stand are held.

    Raises:
        BadInput: Nothing to read.
        BadRecording: A recording that cannot be used, also not after the repair, or beside others.
    """
    robot = dataset.robot
    mapping = dataset.mapping
    paths = dataset.paths(names, without=without)
    still = None if beside is None else beside.parked
    known = () if beside is None else beside.of_the_arm
    if still is None:
        others = dataset.paths(without) if without else []
        free = freed_for(robot, [*paths, *others], mapping)
    else:
        free = still.free
    if repaired:
        raw = [raw_recording(path, free, mapping) for path in paths]
        checked = check_recordings(free, raw, repaired=True, known=known)
        still = still or parked(robot, free, checked.recordings, held)
        return checked.beside(still, still.of(checked.recordings))
    recordings = read_recordings(paths, free, mapping=mapping)
    still = still or parked(robot, free, recordings, held)
    moving = still.of(recordings)
    return check_recordings(still.robot, moving, known=known).beside(still, moving)


def _samples(path: Path) -> int:
    """Number of samples of a Parquet file, about that of a text file, else 0; 0 if unreadable."""
    import pyarrow

    suffix = suffix_of(path)
    try:
        size = size_of(path)
        if suffix in (".parquet", ".pq"):
            with parquet_file(path) as file:
                return int(file.metadata.num_rows)
        if suffix in TEXTS:
            with path.open("rb") as file:
                start = file.read(1 << 16)  # whose lines stand for all
            packed = suffix.endswith(".gz")
            text = (
                zlib.decompressobj(wbits=31).decompress(start) if packed else start
            )
            return int(size * text.count(b"\n") / max(len(start), 1))
    except (OSError, pyarrow.ArrowException, zlib.error):
        pass  # said where it is read
    return 0


def excerpt(pieces: Iterable[Recording], share: float) -> Recording:
    """About this share of consecutive pieces: windows of 30 s at equal distances, every sample.

    The first window begins with the log. A log that ends within its first window is kept whole.
    """
    every = WINDOW_S / share
    parts = []
    for piece in pieces:
        rows = np.flatnonzero(np.mod(piece.t, every) < WINDOW_S)
        if len(rows):
            parts.append(piece.take(rows))
    # speeds may end within the log
    first = min(parts, key=lambda part: len(part.channels()))
    names = ("t", *(name for name, _ in first.channels()))
    arrays: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in names
    }
    t = arrays["t"]
    starts = tuple(every * np.arange(1, 1 + t[-1] // every))
    note = f"{share:.2g} of a long log: windows of {WINDOW_S:g} s, every {every:.4g} s, are used"
    return replace(first, **arrays, starts=starts, notes=(*first.notes, note))
