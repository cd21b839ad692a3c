"""Run directories, saved whole or not at all, and read back."""

import io
import json
import math
from collections.abc import Mapping, Sequence
from os.path import isdir, isfile
from pathlib import Path, PurePosixPath
from typing import Any

import msgspec
import numpy as np

from excitant.exceptions import BadInput
from excitant.files import read_bytes, write_folder
from excitant.identify.reading.arrays import read_arrays
from excitant.reports.page import Page
from excitant.reports.pages import page_of
from excitant.reports.render import html, summary
from excitant.results import Result, plain_of, record_of
from excitant.robots.motion import Array
from excitant.robots.schema import finite, parsed_json

RESULT = "result.json"
SERIES = "series.npz"
SUMMARY = "summary.txt"
REPORT = "report.html"

# values; longer arrays are saved in single precision where that loses nothing
_LONG = 1000
_SINGLE = 1e-6  # of an array's range: error allowed to single precision


def save_run(
    directory: str | Path,
    result: Mapping[str, Any] | Result,
    series: Mapping[str, Array],
    files: Mapping[str, str | bytes] | None = None,
) -> tuple[list[Path], Page]:
    """Write a run directory with its report, or replace an old run in one step.

    Files of the old run that the new one does not have go with it; what others put there stays.

    Args:
        directory: Made when missing; on failure it is as it was.
        result: A record, or JSON-like: NumPy numbers and arrays are converted, NaN and infinity
            become null.
        series: Numeric arrays by key.
        files: Further artefacts, content by name relative to the directory.

    Returns:
        The paths written, artefacts first; the page of the report.

    Raises:
        BadInput: A name or value cannot be saved, or the directory cannot be written.
    """
    directory = Path(directory)
    contents = dict(files or {})
    for name in contents:
        _refuse_name(name)
    encoded = _dump(result if isinstance(result, Mapping) else plain_of(result))
    packed = _pack(series)
    read = json.loads(encoded)
    arrays = read_arrays(packed)
    contents[SERIES] = packed
    paths = map(_parts, read.get("files", []))
    old = (_beside(directory, parts, contents) for parts in paths)
    beside = dict.fromkeys([*filter(None, old), *contents, SUMMARY, RESULT])
    page = page_of(read | {"files": list(beside)}, arrays)
    contents[SUMMARY] = summary(page)
    contents[REPORT] = html(page)
    contents[RESULT] = encoded
    gone = _files_of(directory) - _names(read.get("files", []))
    return write_folder(directory, contents, gone), page


def _beside(
    directory: Path, parts: Sequence[str], new: Mapping[str, Any]
) -> str | None:
    """An artefact's name relative to the directory, from its path; None where it is not there."""
    names = ("/".join(parts[k:]) for k in range(parts[:1] == ("/",), len(parts)))
    return next(
        (name for name in names if name in new or isfile(directory / name)), None
    )


def _files_of(directory: Path) -> set[str]:
    """Names of the artefacts of the run in a directory; none where there is no run."""
    try:
        return _names(_record(directory).files)
    except BadInput:
        return set()


def _names(files: list[str]) -> set[str]:
    """Names of artefacts relative to the directory, from their paths, however it is called."""
    parts = map(_parts, files)
    return {"/".join(names[k:]) for names in parts for k in range(len(names))}


def _parts(file: str) -> tuple[str, ...]:
    return PurePosixPath(file).parts


def as_saved(
    result: Mapping[str, Any], series: Mapping[str, Array]
) -> tuple[dict[str, Any], dict[str, Array]]:
    """Result and series as they would be read back after saving."""
    return json.loads(_dump(result)), read_arrays(_pack(series))


def load_run(directory: str | Path) -> tuple[Result, dict[str, Array]]:
    """Result and series of a run directory; BadInput when a file is missing or corrupt."""
    directory = Path(directory)
    if not isdir(directory):
        raise BadInput(
            f"{directory}: no such folder; give the folder that a run was written to"
        )
    result = _record(directory)
    packed = _content(directory / SERIES)
    try:
        series = read_arrays(packed)
    except Exception as error:  # damaged archives make their reader raise anything
        raise BadInput(
            f"{directory / SERIES}: not an archive of arrays ({error}); run the command again"
        ) from None
    return result, series


def read_result(directory: str | Path) -> dict[str, Any]:
    """Plain values of ``result.json``; BadInput when it is missing or no JSON."""
    path = Path(directory) / RESULT
    try:
        return parsed_json(_content(path), finite)
    except (ValueError, RecursionError) as error:
        raise BadInput(
            f"{path}: not JSON ({error}); run the command again"
        ) from None


def _record(directory: Path) -> Result:
    try:
        return record_of(read_result(directory))
    except msgspec.ValidationError as error:
        why = f"not a result of excitant: {error}"
        raise BadInput(f"{directory / RESULT}: {why}") from None


def _content(path: Path) -> bytes:
    try:
        return read_bytes(path)
    except FileNotFoundError:
        raise BadInput(
            f"{path}: missing; the run is incomplete, run the command again"
        ) from None
    except OSError as error:
        why = f"cannot be read: {error.strerror}"
        raise BadInput(f"{path}: {why}; run the command again") from None


def _refuse_name(name: str) -> None:
    path = PurePosixPath(name)
    inside = (
        name
        and not path.is_absolute()
        and ".." not in path.parts
        and "\\" not in name
    )
    if not inside or not path.parts:
        raise BadInput(
            f"artefact '{name}': its name must stay inside the run's folder"
        )
    if str(path) in (RESULT, SERIES, SUMMARY, REPORT):
        raise BadInput(f"artefact '{name}': this name is taken by the run itself")


def _dump(result: Mapping[str, Any]) -> bytes:
    text = json.dumps(_plain(result, "result"), ensure_ascii=False, allow_nan=False)
    # laid out in C: with an indent, the encoder of json is Python
    return (msgspec.json.format(text, indent=1) + "\n").encode()


def _plain(value: Any, where: str) -> Any:
    if value is None or isinstance(value, bool):
        return value
    if isinstance(value, str | Path):
        return str(value).encode(errors="replace").decode()
    if isinstance(value, np.bool_):
        return bool(value)
    if isinstance(value, int | np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, np.ndarray):
        return _plain(value.tolist(), where)
    if isinstance(value, Mapping):
        return {
            str(key): _plain(item, f"{where}.{key}") for key, item in value.items()
        }
    if isinstance(value, list | tuple):
        return [_plain(item, f"{where}[{k}]") for k, item in enumerate(value)]
    raise BadInput(f"{where}: a {type(value).__name__} cannot be saved as JSON")


def _pack(series: Mapping[str, Array]) -> bytes:
    arrays = {}
    for key, values in series.items():
        array = np.asarray(values)
        if array.dtype.kind not in "biuf":
            raise BadInput(
                f"series '{key}': {array.dtype} cannot be saved, only numbers"
            )
        arrays[key] = _single(array)
    buffer = io.BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **arrays)
    return buffer.getvalue()


def _single(array: Any) -> Any:
    """The array in single precision where its range shows no difference."""
    if array.dtype != np.float64 or array.size < _LONG:
        return array
    finite = array[np.isfinite(array)]
    if not finite.size or np.abs(finite).max() > np.finfo(np.float32).max:
        return array
    error = np.abs(finite - finite.astype(np.float32)).max()
    return array.astype(np.float32) if error <= _SINGLE * np.ptp(finite) else array
