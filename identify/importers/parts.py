"""Parts: files into which one recording was split."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from excitant.identify.importers.raw import RawRecording

_NUMBERED = re.compile(r"(.*?)(\d+)(\.[^.]*)?", re.ASCII)  # run_, 12, .csv
_LONGEST_STEP = 10.0  # median steps between the last row of a part and the first of the next


def runs_of_parts(raws: Sequence[RawRecording]) -> Iterator[list[RawRecording]]:
    """Recordings as they are, those that are parts of one together.

    The next part has the same name with the next number, the same columns, and time that goes
    on where the last one ended: recordings that each start at 0 are never parts of one.
    """
    run: list[RawRecording] = []
    for raw in raws:
        if run and not _continues(run[-1], raw):
            yield run
            run = []
        run.append(raw)
    if run:
        yield run


def put_together(parts: Sequence[RawRecording]) -> RawRecording:
    """One recording of its parts, in order."""
    first, last = parts[0], parts[-1]
    speeds = [raw.dq for raw in parts if raw.dq is not None]
    common = [name for name in first.extras if all(name in raw.extras for raw in parts)]
    return replace(
        first,
        name=f"{first.name}..{last.name}",
        t=np.concatenate([raw.t + _between(first, raw) for raw in parts]),
        q=np.concatenate([raw.q for raw in parts]),
        tau=np.concatenate([raw.tau for raw in parts]),
        dq=np.concatenate(speeds) if len(speeds) == len(parts) else None,
        extras={name: np.concatenate([raw.extras[name] for raw in parts]) for name in common},
        notes=(*first.notes, f"parts of one recording: {', '.join(raw.name for raw in parts)}"),
        unreadable={},
    )


def _continues(before: RawRecording, raw: RawRecording) -> bool:
    if before.columns.names != raw.columns.names or before.unit != raw.unit:
        return False
    if not _next_name(before.file, raw.file) or len(before.t) < 3 or not len(raw.t):
        return False
    gap = _between(before, raw) - float(before.t[-1])
    return 0 < gap <= _LONGEST_STEP * float(np.median(np.diff(before.t)))


def _next_name(one: str, other: str) -> bool:
    first, second = (_NUMBERED.fullmatch(Path(file).name) for file in (one, other))
    if Path(one).parent != Path(other).parent or first is None or second is None:
        return False
    same = first[1] == second[1] and first[3] == second[3]
    return same and int(second[2]) == int(first[2]) + 1


def _between(one: RawRecording, other: RawRecording) -> float:
    """Time from the first row of one to that of another [s]."""
    return (other.start[0] - one.start[0]) + (other.start[1] - one.start[1])
