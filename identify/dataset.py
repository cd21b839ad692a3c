"""Dataset: a folder of recordings with its robot, described by ``dataset.json``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec

from excitant.exceptions import BadInput, UnknownName
from excitant.identify.decimation import decimated, too_long
from excitant.identify.importers.mapping import (
    ColumnMap,
    column_map,
    drive_of,
    load_column_map,
)
from excitant.identify.importers.raw import (
    SUFFIXES,
    put_together,
    raw_recording,
    runs_of_parts,
)
from excitant.identify.recording import (
    Recording,
    check_finite,
    check_time,
    read_chunks,
    recording_from_raw,
)
from excitant.robots.loading import load_robot
from excitant.robots.robot import Robot
from excitant.robots.schema import RobotRecord, read_yaml

_USUAL = (".parquet", ".csv")


class KinematicsRecord(msgspec.Struct, frozen=True):
    """The model of a data set: its file, and joints that are locked at 0."""

    urdf: str | None = "robot.urdf"
    lock: list[str] | None = None


class TorqueRecord(msgspec.Struct, frozen=True):
    """Prefix of the torque columns, such as ``tau`` or ``i``, and what one ampere makes."""

    column: str | None = None
    gains: Any = msgspec.field(name="drive_gain_Nm_per_A", default=None)


class DatasetRecord(msgspec.Struct, frozen=True):
    """What is read of a ``dataset.json``; what else it says is for people."""

    kinematics: KinematicsRecord | None = None
    torque: TorqueRecord | None = None
    units: Any = None


@dataclass(frozen=True)
class Dataset:
    """A robot and where its recordings are.

    Attributes:
        robot: The arm.
        folder: Folder the recordings are named relative to; None when they are paths.
        torque_column: Prefix of the torque columns, when the sidecar says.
        mapping: What is said about the columns and drives.
    """

    robot: Robot
    folder: Path | None = None
    torque_column: str | None = None
    mapping: ColumnMap | None = None

    def recordings(self, names: Sequence[str], *, without: Sequence[str] = ()) -> list[Recording]:
        """Recordings by name; all of the folder when none is named.

        Args:
            names: Recordings to read.
            without: Recordings that are held out: not among "all", refused among names.

        Raises:
            BadInput: Nothing to read, or a recording both named and held out.
            BadRecording: A recording that cannot be used.
        """
        return read_recordings(
            self.paths(names, without=without),
            self.robot,
            mapping=self.mapping,
            torque_column=self.torque_column,
        )

    def paths(self, names: Sequence[str], *, without: Sequence[str] = ()) -> list[Path]:
        """Files of recordings; see `recordings`."""
        held = {self._path(name).resolve() for name in without}
        for name in names:
            if self._path(name).resolve() in held:
                raise BadInput(
                    f"{name} is to be fitted and held out; leave it out of one of the two"
                )
        paths = [self._path(name) for name in names] or self._all()
        kept = [path for path in paths if path.resolve() not in held]
        if not kept:
            raise BadInput(f"{self.folder}: every recording is held out; none is left to fit")
        return kept

    def _path(self, name: str) -> Path:
        path = Path(name) if self.folder is None else self.folder / name
        if self.folder is not None and not path.exists():
            for suffix in SUFFIXES:
                if (with_suffix := path.with_name(path.name + suffix)).is_file():
                    return with_suffix
        return path

    def _all(self) -> list[Path]:
        if self.folder is None:
            raise BadInput("no recording given; name at least one file")
        files = sorted(self.folder.iterdir())
        found = [p for p in files if p.suffix in _USUAL] or [
            p for p in files if p.suffix in SUFFIXES or (p / "metadata.yaml").is_file()
        ]
        if not found:
            raise BadInput(f"{self.folder}: no .parquet or .csv recording in this folder")
        return found


def load_dataset(spec: str | Path, *, columns: str | Path | None = None) -> Dataset:
    """Dataset from a folder with ``dataset.json`` or ``robot.urdf``, or from a robot alone.

    Args:
        spec: Folder, or anything that `load_robot` takes.
        columns: File that says what columns mean (`load_column_map`); ``columns.yaml`` of the
            folder when not given. Drive constants that it leaves out are those of a robot.yaml.

    Raises:
        BadInput: A folder without a robot, or a file that cannot be read.
    """
    folder = Path(spec)
    if not folder.is_dir():
        robot = load_robot(spec)
        return Dataset(robot, mapping=_mapping(columns, _drive(folder)))
    sidecar = folder / "dataset.json"
    record = DatasetRecord()
    if sidecar.is_file():
        record = read_yaml(sidecar, DatasetRecord, "a data set")
    kinematics, torque = record.kinematics or KinematicsRecord(), record.torque or TorqueRecord()
    candidates = [folder / name for name in (kinematics.urdf, "robot.yaml") if name]
    model = next((path for path in candidates if path.is_file()), None)
    if model is None:
        raise BadInput(
            f"{folder}: no robot model (robot.urdf or robot.yaml) in this folder; add one, or "
            f"give ROBOT and the paths of the recordings"
        )
    try:
        robot = load_robot(model, lock=dict.fromkeys(kinematics.lock or [], 0.0) or None)
    except UnknownName as error:
        raise BadInput(f"{sidecar}: {error}") from None
    beside = folder / "columns.yaml"
    given = columns if columns is not None or not beside.is_file() else beside
    own = {"gain_Nm_per_A": torque.gains if isinstance(torque.gains, list) else None}
    drive = drive_of(own, str(sidecar)) or _drive(model)
    return Dataset(robot, folder, torque.column, _mapping(given, drive, record.units, sidecar))


def _drive(model: Path) -> tuple[float, ...] | None:
    """Drive constants of a robot.yaml."""
    if model.suffix not in (".yaml", ".yml") or not model.is_file():
        return None
    return drive_of(read_yaml(model, RobotRecord, "a robot").drive, str(model))


def _mapping(
    columns: str | Path | None,
    drive: tuple[float, ...] | None,
    units: object = None,
    sidecar: Path = Path(),
) -> ColumnMap | None:
    """The map in a file, completed by drive constants and units that are said elsewhere."""
    given = ColumnMap() if columns is None else load_column_map(columns)
    if isinstance(units, dict) and not given.units:
        given = replace(given, units=column_map({"units": units}, str(sidecar)).units)
    if given.drive is None:
        given = replace(given, drive=drive)
    return given if given != ColumnMap() else None


def read_recordings(
    paths: Sequence[str | Path],
    robot: Robot | int,
    *,
    mapping: ColumnMap | None = None,
    torque_column: str | None = None,
) -> list[Recording]:
    """Recordings from logs, in order; files that are parts of one recording become one.

    See `load_recording`, and `excitant.identify.importers.raw.runs_of_parts` for what a part is.
    Logs that are too long to hold are low-passed and decimated as they are read, each a recording
    of its own (`excitant.identify.decimation`).
    """
    if too_long(paths):
        return [
            decimated(read_chunks(path, robot, mapping=mapping, torque_column=torque_column))
            for path in paths
        ]
    raws = [raw_recording(path, robot, mapping, torque_column=torque_column) for path in paths]
    found = []
    for parts in runs_of_parts(raws):
        if len(parts) > 1:
            for raw in parts:
                check_finite(raw)
                check_time(raw)
        found.append(recording_from_raw(put_together(parts) if len(parts) > 1 else parts[0]))
    return found
