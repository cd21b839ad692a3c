"""Damaged logs: one line that names the file, or values that were there; never anything else."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import scipy.io
from hypothesis import given, settings
from hypothesis import strategies as st

from excitant.exceptions import ExcitantError
from excitant.identify import Recording, load_column_map, load_recording, read_chunks
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
def log(
    request: pytest.FixtureRequest,
    save: Callable[..., Path],
    write_joint_states: Callable[..., None],
    tmp_path: Path,
) -> Path:
    """The same log in a file of some kind."""
    kind, path = request.param, tmp_path / f"log.{request.param}"
    if kind in FORMS:
        name, options = FORMS[kind]
        return save(TABLE, name, **options)
    if kind == "mat":
        scipy.io.savemat(path, {"t": T, "q": Q, "tau": TAU}, do_compression=True)
        return path
    folder = path if kind == "bag" else tmp_path / "log"
    write_joint_states(folder, kind, ROBOT.joints, T, (Q, Q, TAU))
    return path if kind == "bag" else folder / path.name


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
    delays = [t - T[k] for k, t in zip(rows, found.t, strict=True) if k is not None]
    assert (np.abs(delays - np.median(delays)) > 1e-6).sum() <= changes


def examples(few: int, many: int) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("count", [few, pytest.param(many, marks=pytest.mark.slow)])


def test_an_undamaged_file_is_read_and_one_of_nothing_refused(log: Path) -> None:
    for pieces in (False, True):
        found = attempt(log, pieces=pieces)
        assert found is not None
        np.testing.assert_array_equal(found.q, Q)
        np.testing.assert_array_equal(found.tau, TAU)
        np.testing.assert_allclose(found.t, T, atol=1e-12)
    for content in (b"", b"\0", b"\n", b"\n\n\n", b"\xff" * 300, b" "):
        log.write_bytes(content)
        assert attempt(log) is None


@examples(10, 170)
def test_damaged_bytes(log: Path, count: int) -> None:
    content = log.read_bytes()

    @settings(max_examples=count)
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
MEANT = ("t", "q", "tau", "i", "units", "sign", "drive")
MAPS = st.dictionaries(st.sampled_from([*MEANT, "dq", "topic", "other"]), VALUES, max_size=4)


def test_maps_of_any_content(tmp_path: Path) -> None:
    path, log = tmp_path / "columns.yaml", tmp_path / "log.csv"
    TABLE.to_csv(log, index=False)

    @given(MAPS)
    @settings(max_examples=60)
    def check(content: dict[str, object]) -> None:
        pd.Series(content, dtype=object).to_json(path, force_ascii=False)  # JSON is YAML
        found = attempt(log, columns=path)
        if found is not None and not set(content) & set(MEANT):
            assert_true(found, 0)

    check()
