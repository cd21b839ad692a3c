"""Recordings of a dataset, with their faults found and, when asked, repaired."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from excitant.exceptions import BadRecording
from excitant.identify.dataset import Dataset
from excitant.identify.faults.copies import find_copies
from excitant.identify.faults.fault import Fault
from excitant.identify.faults.find import find_faults
from excitant.identify.faults.repair import repair
from excitant.identify.importers.raw import raw_recording
from excitant.identify.recording import Recording, recording_from_raw


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
        return Checked(recordings, _faults(dataset, {r.name: r for r in recordings}))
    raws = {
        path.stem: raw_recording(
            path, dataset.robot, dataset.mapping, torque_column=dataset.torque_column
        )
        for path in dataset.paths(names, without=without)
    }
    faults, notes, recordings = _faults(dataset, raws), [], []
    for name, raw in raws.items():
        refuse_unordered(raw.file, raw.columns.t[0], faults[name])
        better, done = repair(raw, faults[name])
        notes += [f"{name}: {sentence}" for sentence in done]
        recordings.append(recording_from_raw(better))
    return Checked(recordings, faults, tuple(notes))


def refuse_unordered(file: str, column: str, faults: Sequence[Fault]) -> None:
    """Refuse a log whose rows no repair brings into the order of time.

    Args:
        file: The log.
        column: Its column of time.
        faults: Its faults.

    Raises:
        BadRecording: Says why, and what to do.
    """
    for fault in faults:
        if "doubt" in fault.evidence:
            raise BadRecording(
                file, fault.detail, row=int(fault.evidence["rows"][0]), column=column
            )


def _faults(dataset: Dataset, recordings: dict[str, Any]) -> dict[str, tuple[Fault, ...]]:
    copies = find_copies(recordings)
    return {
        name: (*((copies[name],) if name in copies else ()), *find_faults(dataset.robot, raw))
        for name, raw in recordings.items()
    }
