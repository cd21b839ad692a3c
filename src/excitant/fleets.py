"""The command about many arms: fleet."""

from __future__ import annotations

import hashlib
import io
import json
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import nullcontext, redirect_stderr, redirect_stdout
from dataclasses import replace
from os.path import isdir, isfile
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import excitant as ex
from excitant.exceptions import (
    BadInput,
    ExcitantError,
    WorkerDied,
    interrupt_in,
    line_of,
)
from excitant.files import real_path, write_file
from excitant.names import in_folder, listed, one_line, printable
from excitant.options import Data, Part, Run
from excitant.processes import connect, processors, unordered
from excitant.progress import Advance, progress_bar
from excitant.recordings import diagnose_readings, identify_readings

if TYPE_CHECKING:
    from excitant.analysis.fleet import Examined, Fleet, Value
    from excitant.results import Identify

NORMAL_95 = 1.96  # half of a 95 % interval, in standard deviations
_ARMS = "arms"
_STAMP = "input.json"
_VERBS = ("identify", "diagnose")
_DIED = (
    "the process that examined it was ended twice, as by a system that runs out of memory; "
    "examine it alone, on a larger machine"
)
_AT_ONCE = 100  # data sets whose parameters are written together
_SHOWN = 3  # findings of a data set that are told


class _DataSet(NamedTuple):
    name: str
    folder: str
    out: str  # folder of its runs


def fleet(
    *folders: str,
    jobs: int | None = None,
    cluster: str | None = None,
    run: Run = Run(),
) -> int:
    """Many arms at many dates: each identified and diagnosed, which differ, what changes.

    What is done is kept: the same command goes on where it was interrupted, and
    examines again only what has changed.

    Args:
        folders: Data sets (a robot with its recordings), or folders that hold them, at any depth.
        jobs: Processes; default: all processors.
        cluster: Dask scheduler to work on, such as tcp://10.0.0.5:8786; its workers see the same
            files.
    """
    default = f"runs/fleet-{in_folder(Path(folders[0]).name)}" if folders else ""
    root = Path(run.output or default)
    with progress_bar("fleet") as advance:
        arms = compare_fleet(
            folders, root, jobs=jobs, cluster=cluster, progress=advance
        )
    files = {"parameters.parquet": _parameters(arms.examined)}
    run.finish(arms.result(), arms.series(), files, root)
    return 1 if all(data_set.failed for data_set in arms.examined) else 0


def compare_fleet(
    folders: Sequence[str | Path],
    output: str | Path,
    *,
    jobs: int | None = None,
    cluster: str | None = None,
    progress: Advance = lambda share, words: None,
) -> Fleet:
    """Identify and diagnose all data sets, and compare arms and dates.

    Args:
        folders: Data sets, or folders that hold them.
        output: Folder in which the runs of each are kept, so that only changed ones are done anew.
        jobs: Processes; all processors when None.
        cluster: Dask scheduler to work on.
        progress: Called with the share done and the data set done last.

    Raises:
        BadInput: No data set, or one that is given twice.
    """
    root = Path(output)
    sets = [
        _DataSet(name, folder, str(real_path(root) / _ARMS / _safe(name)))
        for name, folder in _data_sets(folders, root).items()
    ]
    with connect(cluster) if cluster else nullcontext() as client:
        _examine_all(sets, jobs or processors(), client, progress)
    noted = {data_set.name: _noted(data_set.out) for data_set in sets}
    copies = _copies(noted)
    arms = ex.analysis.compare_arms(
        [
            _examined(data_set, noted[data_set.name].get("failed", ""))
            for data_set in sets
            if data_set.name not in copies
        ]
    )
    if copies:
        told = [f"{name} has the files of {own}" for name, own in copies.items()]
        arms = replace(arms, remarks=(f"counted once: {listed(told, _SHOWN)}",))
    return arms


def _copies(noted: Mapping[str, Mapping[str, str]]) -> dict[str, str]:
    """Data sets with the files of another, which counts instead, one with a model if there is."""
    first = dict[str, str]()
    for name in sorted(noted, key=lambda name: bool(noted[name].get("failed"))):
        first.setdefault(noted[name].get("input", ""), name)
    own = {name: first[entry.get("input", "")] for name, entry in noted.items()}
    return {name: other for name, other in own.items() if other != name}


def _data_sets(folders: Sequence[str | Path], root: Path) -> dict[str, str]:
    """Folders of all data sets by name, which is their path below what the folders share."""
    if not folders:
        raise BadInput("no folder given; name folders of data sets")
    sets = dict[str, str]()
    for folder in map(Path, folders):
        if not isdir(folder):
            raise BadInput(f"{folder}: no such folder; give folders of data sets")
    shared = os.path.commonpath([os.path.abspath(folder) for folder in folders])
    for folder in map(Path, folders):
        inside = list(_below(folder, root, real_path(folder).parents))
        if not inside:
            raise BadInput(
                f"{folder}: no data set in it, which is a folder with robot.urdf, robot.yaml or "
                "dataset.json and recordings"
            )
        for path in inside:
            below = os.path.relpath(os.path.abspath(path), shared)
            name = printable(os.path.basename(shared) if below == "." else below)
            if name in sets:
                raise BadInput(f"{path}: given twice; name each data set once")
            sets[name] = str(real_path(path))  # workers may be in another folder
    return sets


def _below(folder: Path, root: Path, above: Sequence[Path]) -> Iterator[Path]:
    """Data sets in a folder, at any depth, but not among the results; links are followed."""
    resolved = real_path(folder)
    if resolved == real_path(root) or resolved in above:
        return
    if ex.identify.is_dataset(folder):
        yield folder
        return
    for inner in sorted(folder.iterdir()):
        if inner.is_dir() and not inner.name.startswith("."):
            yield from _below(inner, root, (*above, resolved))


def _safe(name: str) -> str:
    """The name of a data set as that of a folder of its own."""
    parts = [part if in_folder(part) == part else "" for part in name.split("/")]
    digest = hashlib.sha256(name.encode()).hexdigest()[:8]
    return "/".join(parts) if all(parts) else f"{in_folder(name)}-{digest}"


def _examine_all(
    sets: Sequence[_DataSet], jobs: int, client: Any, advance: Advance
) -> None:
    """Examine data sets side by side; one that ends its process twice is left to itself."""
    left = {data_set.name for data_set in sets}
    try:
        for apart, alone in ((False, False), (True, False), (True, True)):
            for batch in [[data_set] for data_set in sets] if alone else [sets]:
                tasks = [
                    tuple(data_set) for data_set in batch if data_set.name in left
                ]
                try:
                    for name in unordered(
                        _examine, tasks, jobs, client, apart=apart
                    ):
                        left.remove(name)
                        advance(1 - len(left) / len(sets), name)
                except WorkerDied:
                    if alone:
                        _note(batch[0].out, _stamp(batch[0].folder), _DIED)
            if not left:
                return
    except KeyboardInterrupt:
        done = f"{len(sets) - len(left)} of {len(sets)} data sets are done and kept"
        raise KeyboardInterrupt(
            f"{done}; the same command goes on from there"
        ) from None


def _examine(name: str, folder: str, out: str) -> str:
    """Identify and diagnose a data set, unless that was done with the same files."""
    stamp = _stamp(folder)
    if _noted(out).get("input") == stamp:
        return name
    _note(out, stamp, _refusal(folder, out))
    return name


def _refusal(folder: str, out: str) -> str:
    """Identify and diagnose; the line with which that was refused, empty where it was not."""
    try:
        with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
            read = Data().read(Part().dataset(folder, None), ())
            identify_readings(read, Run(output=f"{out}/identify"))
            run = Run(output=f"{out}/diagnose")
            diagnose_readings(read, run, experiments=False)
    except Exception as error:
        if interrupt_in(error) is not None:
            raise KeyboardInterrupt from None
        return line_of(error)
    return ""


def _stamp(folder: str) -> str:
    """What tells the files of a data set from any others."""
    digest = hashlib.sha256(ex.__version__.encode())
    for path in sorted(Path(folder).rglob("*")):
        if isfile(path):
            with path.open("rb") as file:
                content = hashlib.file_digest(file, "sha256").hexdigest()
            digest.update(f"{path.relative_to(folder)} {content}\n".encode())
    return digest.hexdigest()


def _note(out: str, stamp: str, failed: str) -> None:
    write_file(
        Path(out) / _STAMP, json.dumps({"input": stamp, "failed": failed}) + "\n"
    )


def _noted(out: str) -> dict[str, str]:
    try:
        stamp = json.loads((Path(out) / _STAMP).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return stamp if isinstance(stamp, dict) else {}


def _examined(data_set: _DataSet, failed: str) -> Examined:
    """What a data set came to; why there is no model, where that is noted."""
    name, folder, out = data_set
    examined = ex.analysis.Examined(name, name, None, failed=failed)
    try:
        arm, day = ex.identify.origin(Path(folder), name)
        examined = replace(examined, arm=arm, day=day)
        if examined.failed:
            return examined
        model: Any
        diagnosis: Any
        model, diagnosis = (
            ex.reports.load_run(Path(out) / verb)[0] for verb in _VERBS
        )
    except ExcitantError as error:
        return replace(examined, failed=examined.failed or str(error))
    examined = replace(examined, kind=model.robot)
    if not model.published:
        return replace(examined, failed=one_line(model.refusal))
    sentences = [finding.sentence for finding in diagnosis.findings[:_SHOWN]]
    sentences += [f"fault: {fault.detail}" for fault in diagnosis.faults]
    return replace(examined, values=_values(model), found=tuple(sentences))


def _values(model: Identify) -> dict[str, Value]:
    units = {p.name: p.unit for p in model.parameters}
    values = {}
    for row in model.base_parameters:
        if row.value is None or row.std is None:
            continue
        # held once, however many data sets have it
        name = sys.intern(row.expression)
        unit = sys.intern(units.get(_leading(name), ""))
        values[name] = ex.analysis.Value(row.value, row.std, unit)
    return values


def _leading(expression: str) -> str:
    """The parameter that a base parameter begins with."""
    return expression.split()[0].rpartition("·")[2]


def _parameters(examined: Sequence[Examined]) -> bytes:
    """All base parameters of all data sets with their 95 % intervals, as a Parquet file."""
    import pyarrow.parquet

    words = ("data_set", "arm", "date", "type", "joint", "parameter")
    numbers = dict.fromkeys(("value", "std", "low", "high"), pyarrow.float64())
    kinds = dict.fromkeys(words, pyarrow.string()) | numbers
    kinds |= {"date": pyarrow.date32(), "unit": pyarrow.string()}
    schema = pyarrow.schema(kinds)
    buffer = io.BytesIO()
    with pyarrow.parquet.ParquetWriter(buffer, schema) as writer:
        for start in range(0, len(examined), _AT_ONCE):
            batch = examined[start : start + _AT_ONCE]
            rows = [row for data_set in batch for row in _rows(data_set)]
            writer.write_table(pyarrow.Table.from_pylist(rows, schema))
    return buffer.getvalue()


def _rows(examined: Examined) -> Iterator[dict[str, Any]]:
    """The base parameters of a data set with their 95 % intervals, as rows of the table."""
    for name, (value, std, unit) in (examined.values or {}).items():
        half = NORMAL_95 * std
        yield {
            "data_set": examined.name,
            "arm": examined.arm,
            "date": examined.day,
            "type": examined.kind,
            "joint": _leading(name).rpartition(".")[0],
            "parameter": name,
            "value": value,
            "std": std,
            "low": value - half,
            "high": value + half,
            "unit": unit,
        }
