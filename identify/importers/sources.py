"""Sources: a log as named columns, read whole or piece by piece."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import pandas as pd

from excitant.exceptions import BadRecording
from excitant.identify.importers.groups import Joints
from excitant.identify.importers.names import Meaning, meaning

SUFFIXES = (".parquet", ".pq", ".csv", ".txt", ".tsv", ".npz", ".mat", ".bag", ".mcap", ".db3")
Frames = Callable[[int | None, Sequence[str] | None], Iterator[pd.DataFrame]]


@dataclass(frozen=True)
class Source:
    """A log that can be read.

    Attributes:
        file: Its path.
        names: Columns, in order; a name may be there twice.
        frames: ``frames(rows, columns)``: tables of at most so many rows (one table when None)
            with some columns (all when None). Numbers that cannot be read stay text.
        labels: Joints' names by number, where the log has them.
        notes: What was understood or left out on the way.
        joined: Whether columns are ``joint.quantity`` and rows come from messages, of which only
            those that hold what is asked for are read.
    """

    file: str
    names: tuple[str, ...]
    frames: Frames
    labels: Mapping[int, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    joined: bool = False

    def meanings(self, joints: Joints) -> list[Meaning]:
        """What the columns' names say, given the arm's joints."""
        if not self.joined:
            return [meaning(name, joints.names) for name in self.names]
        order = {label: k for k, label in self.labels.items()}
        found = []
        for name in self.names:
            joint, _, quantity = name.rpartition(".")
            said = meaning(quantity)
            if joint:
                said = Meaning(name, said.role, joint if joints.names else order[joint])
            found.append(said)
        return found


def open_source(path: str | Path, *, topic: str | None = None) -> Source:
    """The log in a file, or in the folder of a ROS 2 bag, by its suffix.

    Args:
        path: Parquet, CSV, NPZ, MAT (up to version 7.2), ROS 1 or 2 bag, MCAP.
        topic: Topic of a bag's ``sensor_msgs/JointState``, where it has several.

    Raises:
        BadRecording: No such file, an unknown format, or not readable as what it claims to be.
    """
    path = Path(path)
    try:
        is_bag_folder = (path / "metadata.yaml").is_file()
        if not path.is_file() and not is_bag_folder:
            raise BadRecording(path, _no_file(path))
        suffix = ".bag" if is_bag_folder else path.suffix.lower()
        return _opened(path, suffix, topic)
    except BadRecording:
        raise
    except Exception as error:  # readers of others raise anything on a damaged file
        raise unreadable(path, error) from None


def unreadable(path: str | Path, error: BaseException) -> BadRecording:
    """The refusal of a file that its reader cannot read."""
    lines = str(error).strip().splitlines()
    return BadRecording(path, f"cannot be read ({lines[0] if lines else type(error).__name__})")


def _no_file(path: Path) -> str:
    if path.is_dir():
        return "is a folder without metadata.yaml of a ROS 2 bag; give a file, or a bag"
    return "no such file"


def _opened(path: Path, suffix: str, topic: str | None) -> Source:
    if suffix in (".parquet", ".pq"):
        from excitant.identify.importers.parquet import parquet_source

        return parquet_source(path)
    if suffix in (".csv", ".txt", ".tsv"):
        from excitant.identify.importers.csv_text import csv_source

        return csv_source(path)
    if suffix in (".npz", ".mat"):
        from excitant.identify.importers.arrays import mat_source, npz_source

        return npz_source(path) if suffix == ".npz" else mat_source(path)
    if suffix in (".bag", ".mcap", ".db3"):
        from excitant.identify.importers.bags import bag_source

        return bag_source(path, topic)
    raise BadRecording(
        path, f"unknown format '{path.suffix}'; give .parquet or .csv, .npz, .mat, .bag or .mcap"
    )


def of_frame(frame: pd.DataFrame, file: str) -> Source:
    """The source of a table in memory."""
    names = tuple(str(name) for name in frame.columns)
    frame = frame.set_axis(list(range(len(names))), axis=1)

    def frames(rows: int | None, columns: Sequence[str] | None) -> Iterator[pd.DataFrame]:
        kept = [k for k, name in enumerate(names) if columns is None or name in columns]
        part = frame[kept].set_axis([names[k] for k in kept], axis=1)
        step = rows or max(len(part), 1)
        for start in range(0, max(len(part), 1), step):
            yield part.iloc[start : start + step]

    return Source(file, names, frames)
