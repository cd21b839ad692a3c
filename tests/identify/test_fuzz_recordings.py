"""Damaged logs: one line that names the file, or values that were there; never anything else."""

import io
import os
import struct
import tracemalloc
import zipfile
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet
import pytest
import scipy.io
from bags import joint_states
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from known_arms import Call
from marks import refused, slow

from excitant.exceptions import ExcitantError
from excitant.identify import Recording, load_column_map, load_recording, read_chunks
from excitant.identify.dataset import read_recordings
from excitant.identify.faults.fault import Log
from excitant.identify.faults.torque_fit import smooth
from excitant.identify.preprocessing import prepare
from excitant.robots import load_robot

N = 250
T = np.arange(N) / 100
Q, TAU = np.cumsum(np.random.default_rng(0).normal(size=(2, N, 2)), axis=1) / 10
ORDER = {tuple(row): k for k, row in enumerate(np.column_stack([Q, TAU]))}
ROBOT = load_robot("planar_2r")
TABLE = pd.DataFrame({"t": T, "q1": Q[:, 0], "q2": Q[:, 1], "tau1": TAU[:, 0], "tau2": TAU[:, 1]})
FORMS: dict[str, tuple[str, dict[str, Any]]] = {
    "csv": ("log.csv", {}),
    "semicolons": ("log.csv", {"sep": ";", "decimal": ","}),
    "tabs": ("log.txt", {"sep": "\t"}),
    "quoted": ("log.csv", {"quoting": 1}),
    "parquet": ("log.parquet", {"write_page_checksum": True}),
    "npz": ("log.npz", {}),
}


@pytest.fixture(params=[*FORMS, "mat", "bag", "mcap", "db3"])
def log(request: Any, save: Call, tmp_path: Path) -> Path:
    """The same log in a file of some kind."""
    kind, path = request.param, tmp_path / f"log.{request.param}"
    if kind in FORMS:
        name, options = FORMS[kind]
        return save(TABLE, name, **options)
    if kind == "mat":
        scipy.io.savemat(path, {"t": T, "q": Q, "tau": TAU}, do_compression=True)
        return path
    folder = path if kind == "bag" else tmp_path / "log"
    joint_states(folder, kind, ROBOT.joints, T, (Q, Q, TAU))
    return path if kind == "bag" else folder / path.name


EACH_ALONE = {".mat": 3}  # read in processes of their own, half a second each: fewer of them
PLACES = st.floats(0, 1, exclude_max=True)
DAMAGE = st.sampled_from(["flip", "set", "head", "insert", "delete", "cut"])
DAMAGES = st.lists(st.tuples(DAMAGE, PLACES, st.integers(0, 255)), min_size=1, max_size=3)


def damaged(content: bytes, damages: Sequence[tuple[str, float, int]]) -> bytes:
    """Single bytes changed (``head``: within the first 2 %), and cut."""
    data = bytearray(content)
    for kind, place, value in damages:
        k = int(place * len(data) * (0.02 if kind == "head" else 1.0))
        if k < len(data):
            changed = {"flip": [data[k] ^ 1 << value % 8], "delete": [], "cut": []}
            end = len(data) if kind == "cut" else k + (kind != "insert")
            data[k:end] = changed.get(kind, [value])
    return bytes(data)


def attempt(path: Path, *, pieces: bool = False, columns: Path | None = None) -> Recording | None:
    """The recording; None when it is refused in one line that names a file."""
    try:
        if not pieces:
            return load_recording(path, ROBOT, mapping=columns and load_column_map(columns))
        parts = list(read_chunks(path, ROBOT, 60))
    except ExcitantError as error:
        refusal = str(error)
    else:
        arrays = (np.concatenate([getattr(part, c) for part in parts]) for c in ("t", "q", "tau"))
        return Recording("log", str(path), *arrays, parts[0].unit)
    assert path.name in refusal or (columns and columns.name in refusal)
    assert "\n" not in refusal
    return None


def assert_true(found: Recording, changes: int) -> None:
    """At most so many rows differ from what was logged, and time goes on as it was logged."""
    assert found.unit == "N·m"
    assert np.isfinite(np.hstack([found.q, found.tau])).all()
    assert (np.diff(found.t) > 0).all()
    assert (np.ptp(found.tau, axis=0) > 0).all()
    assert not any(x.flags.writeable for x in (found.t, found.q, found.tau))
    rows = [ORDER.get(tuple(row)) for row in np.column_stack([found.q, found.tau])]
    assert rows.count(None) <= changes
    delays = [t - T[k] for k, t in zip(rows, found.t, strict=True) if k is not None] or [0.0]
    assert (np.abs(delays - np.median(delays)) > 1e-6).sum() <= changes


def examples(few: int, many: int) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("count", [few, slow(many)])


def test_an_undamaged_file_is_read_and_one_of_nothing_refused(log: Path) -> None:
    for pieces in (False, True):
        found = attempt(log, pieces=pieces)
        assert found is not None
        np.testing.assert_array_equal(found.q, Q)
        np.testing.assert_array_equal(found.tau, TAU)
        np.testing.assert_allclose(found.t, T, atol=1e-12)
    nothing = (b"", b"\0", b"\n", b"\n\n\n", b"\xff" * 300, b" ")
    for content in nothing[:: EACH_ALONE.get(log.suffix, 1)]:
        log.write_bytes(content)
        assert attempt(log) is None


@examples(10, 170)
def test_damaged_bytes(log: Path, count: int) -> None:
    content = log.read_bytes()

    @settings(max_examples=count // EACH_ALONE.get(log.suffix, 1))
    @given(DAMAGES, st.booleans())
    def check(damages: list[tuple[str, float, int]], pieces: bool) -> None:
        log.write_bytes(damaged(content, damages))
        found = attempt(log, pieces=pieces)
        if found is not None:
            assert_true(found, len(damages))

    check()


NUMBERS = ["1_000", "0x10", "1,5", "1.234,56", "１２", "∞", "1e400", " 1", "1 2", "NaN", "-inf"]
CELLS = st.floats() | st.integers(-(10**30), 10**30) | st.none() | st.booleans()
CELLS |= st.text(max_size=6) | st.sampled_from([*NUMBERS, "TRUE", "2026-01-01", "65535"])
ALIKE = ["q1", "Q1", "q１", "tau1", "i1", "dq1", "τ1", "target_q1", "q_ref1", "q[1]", "q1 [deg]"]
NAMES = st.sampled_from([*ALIKE, "position", "joint1", "名前", "time", "q1\n", "q 1 ", "1"])
NAMES |= st.text(min_size=1, max_size=8).filter(lambda text: not text.isspace())
COLUMN, ROW = st.integers(0, 4), st.integers(0, N)
EDITS = st.one_of(
    st.tuples(st.just("cell"), COLUMN, CELLS, ROW.map(lambda k: slice(k, k + 1))),
    st.tuples(st.just("fill"), COLUMN, CELLS, st.just(slice(N))),
    st.tuples(st.just("add"), NAMES),
    st.tuples(st.just("rename"), COLUMN, NAMES),
    st.tuples(st.sampled_from(["twice", "drop", "text"]), COLUMN),
    st.tuples(st.just("order"), st.permutations(range(5))),
    st.tuples(st.sampled_from(["again", "keep"]), ROW),
)


def edited(table: pd.DataFrame, edits: Sequence[tuple[Any, ...]]) -> pd.DataFrame:
    """The table with cells, names, order, types or shape changed."""
    for kind, value, *more in edits:
        width = table.shape[1]
        k = value % width if isinstance(value, int) else 0
        if kind in ("cell", "fill"):
            cells = table.iloc[:, k].astype(object)
            cells.iloc[more[1]] = more[0]
            table.isetitem(k, cells)
        elif kind == "add":
            table = pd.concat([table, pd.Series(7.5, table.index, name=value)], axis=1)
        elif kind == "rename":
            table = table.set_axis(table.columns.where(np.arange(width) != k, more[0]), axis=1)
        elif kind == "twice":
            table = pd.concat([table, table.iloc[:, [k]]], axis=1)
        elif kind == "drop" and width > 1:
            table = table.drop(columns=table.columns[k])
        elif kind == "order":
            table = table.iloc[:, [*(j for j in value if j < width), *range(5, width)]]
        elif kind == "text":
            table.isetitem(k, table.iloc[:, k].astype(str))
        elif kind == "again":
            table = pd.concat([table, table[value : value + 1]])
        elif kind == "keep":
            table = table[:value]
    return table


@examples(50, 400)
def test_edited_tables(count: int, tmp_path: Path) -> None:
    @settings(max_examples=count)
    @given(st.lists(EDITS, min_size=1, max_size=4), st.sampled_from([".csv", ".parquet"]))
    def check(edits: list[tuple[object, ...]], suffix: str) -> None:
        table, path = edited(TABLE.copy(), edits), tmp_path / f"log{suffix}"
        if suffix == ".csv":
            table.to_csv(path, index=False)
        else:
            try:
                table.to_parquet(path)
            except Exception:  # a table that Parquet cannot hold
                return
        found = attempt(path)
        if found is not None and not any(e[0] == "rename" and e[2] == "q1 [deg]" for e in edits):
            kinds = [kind for kind, *_ in edits]
            taken = N * ("add" in kinds and not {"rename", "drop"}.isdisjoint(kinds))
            assert_true(found, kinds.count("cell") + N * kinds.count("fill") + taken)

    check()


WORDS = ["q{1}", "tau{1}", "q", "t", "deg", "{0}", "{joint}", "{"]
PARTS = st.sampled_from(["q", "tau", "t", "joint1", "gain_Nm_per_A", "x"])
VALUES = st.recursive(
    CELLS | st.integers(-3, 10) | st.sampled_from(WORDS),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(PARTS, inner, max_size=3),
    max_leaves=6,
)
MEANT = ("t", "q", "tau", "i", "units", "sign", "drive", "offset", "coupling", "rate")
MAPS = st.dictionaries(st.sampled_from([*MEANT, "dq", "topic", "other"]), VALUES, max_size=4)


@given(MAPS)
@settings(max_examples=120, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_maps_of_any_content(tmp_path: Path, content: dict[str, object]) -> None:
    path, log = tmp_path / "columns.yaml", tmp_path / "log.csv"
    TABLE.to_csv(log, index=False)
    pd.Series(content, dtype=object).to_json(path, force_ascii=False)  # JSON is YAML
    found = attempt(log, columns=path)
    if found is not None and not set(content) & set(MEANT):
        assert_true(found, 0)


UNITS = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}
ORIGINS = st.sampled_from([0.0, 17.5, 1.7e9])  # s: any, and stamps since 1970
GAPS = st.sampled_from([0.0, 0.2, 1e3, 1e9, 1e15, 1e200])


@examples(30, 200)
def test_time_in_any_unit_with_any_gap(count: int, tmp_path: Path) -> None:
    """In memory that does not grow with the time that is said to have passed."""

    @settings(max_examples=count)
    @given(st.sampled_from([*UNITS]), ORIGINS, GAPS, st.integers(1, N - 1), st.booleans())
    def check(unit: str, origin: float, gap: float, row: int, whole: bool) -> None:
        t = (T + origin + gap * (np.arange(N) >= row)) * UNITS[unit]
        path, whole = tmp_path / "log.csv", whole and unit != "s" and gap < 1e3
        TABLE.assign(t=np.round(t).astype(np.int64) if whole else t).to_csv(path, index=False)
        found = attempt(path)
        if found is not None:
            smooth(Log.of(ROBOT, found))
            with suppress(ExcitantError):
                prepare(found)
        if gap < 1e3:
            assert found is not None
            late = gap * (np.arange(N) >= row)
            np.testing.assert_allclose(found.t, T + late, atol=1e-4 if origin else 1e-9)

    check()


@pytest.mark.parametrize("t", [0 * T, np.full(N, 1.7e9), T * 1e15, [b"%f" % x for x in T], T > 1])
def test_what_is_no_time_is_refused(t: Any, tmp_path: Path) -> None:
    TABLE.assign(t=t).to_parquet(tmp_path / "log.parquet")
    assert attempt(tmp_path / "log.parquet") is None


def sparse(path: Path, start: str = "") -> None:
    path.write_text(start)
    os.truncate(path, 5 << 30)


def claims(path: Path, shape: tuple[int, ...], zeros: int = 0) -> None:
    """An array whose header claims more than the file holds, or that packs zeros."""
    header, about = io.BytesIO(), {"descr": "<f8", "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(header, about)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("t.npy", header.getvalue() + bytes(zeros))


def zeros_in_parquet(path: Path) -> None:
    column = pa.chunked_array([pa.array(np.zeros(300_000))] * 10)
    pa.parquet.write_table(pa.table(dict.fromkeys(TABLE.columns, column)), path)


CLAIM_IN_MAT = struct.pack("<5i", 0, 2**31 - 1, 100, 0, 2) + b"t\0" + bytes(100)
LOGS = ("csv", "parquet", "npz", "mat", "bag")
HUGE: dict[str, tuple[str, Callable[[Path], object]]] = {
    **{f"zeros {s}": (f"log.{s}", sparse) for s in (*LOGS, "mcap", "db3")},
    "a line": ("log.csv", lambda path: sparse(path, TABLE.to_csv(index=False))),
    "a claim": ("log.npz", lambda path: claims(path, (10**12,))),
    "a claim in two": ("log.npz", lambda path: claims(path, (2**62, 2**62))),
    "packed zeros": ("log.npz", lambda path: claims(path, (2**22,), 2**25)),
    "a claim in MAT": ("log.mat", lambda path: path.write_bytes(CLAIM_IN_MAT)),
    "Parquet": ("log.parquet", zeros_in_parquet),
    **{f"pipe {s}": (f"log.{s}", os.mkfifo) for s in LOGS},
    "a device": ("log.csv", lambda path: path.symlink_to("/dev/zero")),
    "a folder": ("log.npz", Path.mkdir),
}


@pytest.mark.parametrize("kind", HUGE)
def test_huge_files_and_what_is_none_are_refused_at_once(kind, tmp_path, monkeypatch):
    name, write = HUGE[kind]
    write(tmp_path / name)
    for module in ("arrays", "tables"):
        monkeypatch.setattr(f"excitant.identify.reading.{module}.MOST", 1 << 24)
    tracemalloc.start()
    try:
        assert attempt(tmp_path / name) is None
        refused(name, read_recordings, [tmp_path / name], ROBOT)
        assert tracemalloc.get_traced_memory()[1] < 1 << 26
    finally:
        tracemalloc.stop()
