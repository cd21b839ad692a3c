"""The command about many arms: fleet."""

from __future__ import annotations

import hashlib
import io
import json
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import nullcontext, redirect_stderr, redirect_stdout
from os.path import isdir, isfile
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from excitant.exceptions import (
    BadInput,
    ExcitantError,
    WorkerDied,
    interrupt_in,
    line_of,
)
from excitant.files import write_file
from excitant.names import in_folder, one_line
from excitant.options import Run
from excitant.processes import connect, unordered
from excitant.progress import Advance, progress_bar
from excitant.recordings import diagnose, identify

if TYPE_CHECKING:
    from excitant.analysis.fleet import Examined, Value
    from excitant.results import Identify

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
    *folders: str, jobs: int | None = None, cluster: str | None = None, run: Run = Run()
) -> int:
    """Many arms at many dates: each identified and diagnosed, which differ, what changes.

    What is done is kept: the same command goes on where it was interrupted, and examines again only
    what has changed.

    Args:
        folders: Data sets (a robot with its recordings), or folders that hold them, at any depth.
        jobs: Processes; default: all processors.
        cluster: Dask scheduler to work on, such as tcp://10.0.0.5:8786; its workers see the same
            files.
    """
    import joblib

    from excitant.analysis.fleet import compare_arms

    given = f"runs/fleet-{in_folder(Path(folders[0]).name)}" if folders else ""
    root = Path(run.output or given)
    sets = [
        _DataSet(name, folder, str(root.resolve() / _ARMS / _safe(name)))
        for name, folder in _found(folders, root)
    ]
    with (
        connect(cluster) if cluster else nullcontext() as client,
        progress_bar("fleet") as advance,
    ):
        _examine_all(sets, jobs or int(joblib.cpu_count()), client, advance)
    found = compare_arms([_examined(each) for each in sets])
    files = {"parameters.parquet": _parameters(found.examined)}
    run.finish(found.result(), found.series(), files, root)
    return 1 if all(each.failed for each in found.examined) else 0


def _found(folders: Sequence[str], root: Path) -> list[tuple[str, str]]:
    """Names and folders of all data sets, in order; names tell which of the given they are in."""
    from excitant.identify.dataset import is_dataset

    def below(folder: Path) -> Iterator[Path]:
        if folder.resolve() == root.resolve():
            return
        if is_dataset(folder):
            yield folder
            return
        for each in sorted(folder.iterdir()):
            if (
                each.is_dir()
                and not each.is_symlink()
                and not each.name.startswith(".")
            ):
                yield from below(each)

    found: dict[str, str] = {}
    for given in map(Path, folders):
        if not isdir(given):
            raise BadInput(f"{given}: no such folder; give folders of data sets")
        inside = list(below(given))
        if not inside:
            raise BadInput(
                f"{given}: no data set in it, which is a folder with robot.urdf, robot.yaml or "
                "dataset.json and recordings"
            )
        for path in inside:
            name = (
                given.resolve().name
                if path == given
                else path.relative_to(given).as_posix()
            )
            if name in found:
                name = f"{given.resolve().name}/{name}"
            if name in found:
                raise BadInput(f"{path}: another data set is called {name}; rename one")
            found[name] = str(path.resolve())  # workers may be in another folder
    if not found:
        raise BadInput("no folder given; name folders of data sets")
    return [*found.items()]


def _safe(name: str) -> str:
    """The name of a data set as that of a folder of its own."""
    parts = [part if in_folder(part) == part else "" for part in name.split("/")]
    told = hashlib.sha256(name.encode()).hexdigest()[:8]
    return "/".join(parts) if all(parts) else f"{in_folder(name)}-{told}"


def _examine_all(
    sets: Sequence[_DataSet], jobs: int, client: Any, advance: Advance
) -> None:
    """Examine data sets side by side; one that ends its process twice is left to itself."""
    left = dict.fromkeys(each.name for each in sets)
    try:
        for apart, alone in ((False, False), (True, False), (True, True)):
            for some in [[each] for each in sets] if alone else [sets]:
                tasks = [tuple(each) for each in some if each.name in left]
                try:
                    for name in unordered(_examine, tasks, jobs, client, apart=apart):
                        del left[name]
                        advance(1 - len(left) / len(sets), name)
                except WorkerDied:
                    if alone:
                        _note(some[0].out, _stamp(some[0].folder), _DIED)
            if not left:
                return
    except KeyboardInterrupt:
        kept = f"{len(sets) - len(left)} of {len(sets)} data sets are done and kept"
        raise KeyboardInterrupt(
            f"{kept}; the same command goes on from there"
        ) from None


def _examine(name: str, folder: str, out: str) -> str:
    """Identify and diagnose a data set, unless that was done with the same files."""
    stamp = _stamp(folder)
    if _noted(out).get("input") == stamp:
        return name
    failed = _refusal(identify, folder, run=Run(output=f"{out}/identify"))
    if not failed:
        run = Run(output=f"{out}/diagnose")
        failed = _refusal(diagnose, folder, run=run, experiments=False)
    _note(out, stamp, failed)
    return name


def _refusal(command: Callable[..., object], folder: str, **options: Any) -> str:
    """Run a command; the line with which it was refused, empty where it has a result."""
    try:
        with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
            command(folder, **options)
    except Exception as error:
        if interrupt_in(error) is not None:
            raise KeyboardInterrupt from None
        return line_of(error)
    return ""


def _stamp(folder: str) -> str:
    """What tells the files of a data set from any others."""
    from importlib.metadata import version

    told = hashlib.sha256(version("excitant").encode())
    for path in sorted(Path(folder).rglob("*")):
        if isfile(path):
            with path.open("rb") as file:
                content = hashlib.file_digest(file, "sha256").hexdigest()
            told.update(f"{path.relative_to(folder)} {content}\n".encode())
    return told.hexdigest()


def _note(out: str, stamp: str, failed: str) -> None:
    write_file(
        Path(out) / _STAMP, json.dumps({"input": stamp, "failed": failed}) + "\n"
    )


def _noted(out: str) -> dict[str, str]:
    try:
        found = json.loads((Path(out) / _STAMP).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


def _examined(data_set: _DataSet) -> Examined:
    """What a data set came to."""
    from excitant.analysis.fleet import Examined
    from excitant.identify.dataset import origin
    from excitant.reports import load_run
    from excitant.results import Diagnose, Identify

    name, folder, out = data_set
    arm = name
    day = None
    failed = _noted(out).get("failed", "")
    try:
        arm, day = origin(Path(folder), name)
        if failed:
            return Examined(name, arm, day, failed=failed)
        model, diagnosis = (load_run(Path(out) / verb)[0] for verb in _VERBS)
    except ExcitantError as error:
        return Examined(name, arm, day, failed=failed or str(error))
    assert isinstance(model, Identify)
    assert isinstance(diagnosis, Diagnose)
    if not model.published:
        return Examined(name, arm, day, model.robot, failed=one_line(model.refusal))
    said = [finding.sentence for finding in diagnosis.findings[:_SHOWN]]
    said += [f"fault: {fault.detail}" for fault in diagnosis.faults]
    return Examined(name, arm, day, model.robot, "", _values(model), tuple(said))


def _values(model: Identify) -> dict[str, Value]:
    from excitant.analysis.fleet import Value

    units = {p.name: p.unit for p in model.parameters}
    found = {}
    for row in model.base_parameters:
        if row.value is None or row.std is None:
            continue
        name = sys.intern(row.expression)  # held once, however many data sets have it
        unit = sys.intern(units.get(_leading(name), ""))
        found[name] = Value(row.value, row.std, unit)
    return found


def _leading(expression: str) -> str:
    """The parameter that a base parameter begins with."""
    return expression.split()[0].rpartition("·")[2]


def _parameters(examined: Sequence[Examined]) -> bytes:
    """All base parameters of all data sets with their 95 % intervals, as a Parquet file."""
    import pyarrow as pa
    import pyarrow.parquet

    schema = pa.schema(
        [("data_set", pa.string()), ("arm", pa.string()), ("date", pa.date32())]
        + [(name, pa.string()) for name in ("type", "joint", "parameter")]
        + [(name, pa.float64()) for name in ("value", "std", "low", "high")]
        + [("unit", pa.string())]
    )
    buffer = io.BytesIO()
    with pa.parquet.ParquetWriter(buffer, schema) as writer:
        for start in range(0, len(examined), _AT_ONCE):
            some = examined[start : start + _AT_ONCE]
            rows = [row for each in some for row in _rows(each)]
            writer.write_table(pa.Table.from_pylist(rows, schema))
    return buffer.getvalue()


def _rows(examined: Examined) -> Iterator[dict[str, Any]]:
    """The base parameters of a data set with their 95 % intervals, as rows of the table."""
    about = {"data_set": examined.name, "arm": examined.arm, "date": examined.day}
    for name, (value, std, unit) in (examined.values or {}).items():
        yield about | {
            "type": examined.kind, "joint": _leading(name).rpartition(".")[0], "parameter": name,
            "value": value, "std": std, "low": value - 1.96 * std, "high": value + 1.96 * std,
            "unit": unit,
        }  # fmt: skip
