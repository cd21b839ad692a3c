"""NPZ and MAT logs: named arrays, whose rows are samples."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import scipy.io

from excitant.exceptions import BadRecording
from excitant.identify.importers.names import meaning
from excitant.identify.importers.sources import Source, of_frame

_HDF5 = b"\x89HDF\r\n\x1a\n"


def npz_source(path: Path) -> Source:
    """The log in an NPZ file; an array ``q`` of shape (n, nv) becomes ``q[0]``, ``q[1]``, ..."""
    with np.load(path, allow_pickle=False) as file:
        arrays = {name: np.asarray(file[name]) for name in file.files}
    return _source(arrays, path)


def mat_source(path: Path) -> Source:
    """The log in a MAT file of version 4 to 7.2; fields of structs become ``struct.field``.

    Raises:
        BadRecording: Version 7.3, which is another format (HDF5).
    """
    with path.open("rb") as stream:
        start = stream.read(520)
    if _HDF5 in (start[:8], start[512:520]) or start.startswith(b"MATLAB 7.3"):
        raise BadRecording(
            path, "is a MAT file of version 7.3 (HDF5); save it with save(..., '-v7') in MATLAB"
        )
    content = scipy.io.loadmat(path, simplify_cells=True)
    return _source(_flattened(content), path)


def _flattened(content: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    arrays: dict[str, Any] = {}
    for name, value in content.items():
        if name.startswith("__"):
            continue
        if isinstance(value, Mapping):
            arrays |= _flattened(value, f"{before}{name}.")
        else:
            arrays[f"{before}{name}"] = np.asarray(value)
    return arrays


def _source(arrays: Mapping[str, Any], path: Path) -> Source:
    numbers = {
        name: array[:, None] if array.ndim == 1 else array
        for name, array in arrays.items()
        if array.dtype.kind in "fiuM" and array.ndim in (1, 2) and array.size
    }
    if not numbers:
        raise BadRecording(path, "holds no array of numbers; give t, q and tau")
    n = _samples(numbers)
    columns: dict[str, Any] = {}
    left_out = []
    for name, array in numbers.items():
        rows = _as_rows(name, array, n, path)
        if rows is None:
            left_out.append(name)
            continue
        for k in range(rows.shape[1]):
            columns[name if rows.shape[1] == 1 else f"{name}[{k}]"] = rows[:, k]
    notes = (f"arrays of other lengths left out: {', '.join(left_out)}",) if left_out else ()
    return replace(of_frame(pd.DataFrame(columns), str(path)), notes=notes)


def _samples(arrays: Mapping[str, Any]) -> int:
    """How many samples the log has: as many as times, else the length that most arrays have."""
    times = [a for name, a in arrays.items() if meaning(name).role == "t" and 1 in a.shape]
    if len(times) == 1:
        return int(times[0].size)
    lengths = Counter(int(max(array.shape)) for array in arrays.values())
    return lengths.most_common(1)[0][0]


def _as_rows(name: str, array: Any, n: int, path: Path) -> Any:
    """An array with one row per sample; None when it belongs to no sample."""
    if array.shape == (n, n) and n > 1:
        raise BadRecording(path, f"is {n} × {n}: rows or columns could be samples", column=name)
    if n == array.shape[0]:
        return array
    if n == array.shape[1]:
        return array.T
    found = meaning(name)
    if found.role in ("q", "tau", "i") and not found.words and not found.commanded:
        shape = " × ".join(map(str, array.shape))
        raise BadRecording(
            path, f"is {shape}, but there are {n} samples; save arrays of one length", column=name
        )
    return None
