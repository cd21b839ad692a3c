"""Damaged logs: one line that names the file, or values that were there; never anything else."""

from __future__ import annotations

import io
import tempfile
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
_RNG = np.random.default_rng(0)
Q, TAU = (np.cumsum(_RNG.normal(size=(N, 2)), axis=0) / 10 for _ in range(2))
ROWS = {tuple(row) for row in np.column_stack([Q, TAU])}
ROBOT = load_robot("planar_2r")
TABLE = pd.DataFrame({"t": T, "q1": Q[:, 0], "q2": Q[:, 1], "tau1": TAU[:, 0], "tau2": TAU[:, 1]})


def _csv(separator: str = ",", decimal: str = ".", quoting: int = 0) -> bytes:
    return TABLE.to_csv(index=False, sep=separator, decimal=decimal, quoting=quoting).encode()


def _saved(save: Callable[[Any], object]) -> bytes:
    buffer = io.BytesIO()
    save(buffer)
    return buffer.getvalue()


KINDS = ("csv", "semicolons", "tabs", "quoted", "parquet", "npz", "mat", "bag", "mcap", "db3")
each_kind = pytest.mark.parametrize("kind", KINDS)
Files = dict[str, tuple[str, bytes]]


@pytest.fixture(scope="module")
def files(
    write_joint_states: Callable[..., None], tmp_path_factory: pytest.TempPathFactory
) -> Files:
    """Suffix and content of the same log in every kind of file."""
    arrays = {"t": T, "q": Q, "tau": TAU}
    found = {
        "csv": (".csv", _csv()),
        "semicolons": (".csv", _csv(";", ",")),
        "tabs": (".txt", _csv("\t")),
        "quoted": (".csv", _csv(quoting=1)),
        "parquet": (".parquet", _saved(lambda b: TABLE.to_parquet(b, write_page_checksum=True))),
        "npz": (".npz", _saved(lambda b: np.savez(b, **arrays))),
        "mat": (".mat", _saved(lambda b: scipy.io.savemat(b, arrays, do_compression=True))),
    }
    for kind in ("bag", "mcap", "db3"):
        path = tmp_path_factory.mktemp(kind) / ("a.bag" if kind == "bag" else "a")
        write_joint_states(path, kind, ROBOT.joints, T, (Q, Q, TAU))
        found[kind] = (f".{kind}", (path if kind == "bag" else path / f"a.{kind}").read_bytes())
    return found


PLACES = st.floats(0, 1, exclude_max=True)
DAMAGES = st.lists(
    st.tuples(st.sampled_from(["flip", "set", "head", "insert", "delete", "cut"]), PLACES,
              st.integers(0, 255)),
    min_size=1,
    max_size=3,
)  # fmt: skip


def damaged(content: bytes, damages: Sequence[tuple[str, float, int]]) -> bytes:
    """A file with single bytes changed (``head``: within its first 2 %), and cut."""
    data = bytearray(content)
    for kind, place, value in damages:
        k = int(place * len(data) * (0.02 if kind == "head" else 1.0))
        if k < len(data):
            data[k : len(data) if kind == "cut" else k + (kind != "insert")] = {
                "flip": [data[k] ^ 1 << value % 8], "delete": [], "cut": []
            }.get(kind, [value])  # fmt: skip
    return bytes(data)


def attempt(path: Path, *, pieces: bool = False) -> Recording | None:
    """The recording; None when it is refused in one line that names the file."""
    try:
        if not pieces:
            return load_recording(path, ROBOT)
        parts = list(read_chunks(path, ROBOT, 60))
    except ExcitantError as error:
        refusal = str(error)
        assert path.name in refusal
        assert "\n" not in refusal
        return None
    t, q, tau = (np.concatenate([getattr(part, c) for part in parts]) for c in ("t", "q", "tau"))
    return Recording(path.stem, str(path), t, q, tau, parts[0].unit)


def assert_true(found: Recording, changes: int) -> None:
    """At most so many rows differ from what was logged, and time goes on as it was logged."""
    assert found.unit == "N·m"
    assert np.isfinite(found.q).all()
    assert np.isfinite(found.tau).all()
    assert (np.diff(found.t) > 0).all()
    rows = np.column_stack([found.q, found.tau])
    strange = np.array([tuple(row) not in ROWS for row in rows])
    assert strange.sum() <= changes
    order = {tuple(row): k for k, row in enumerate(np.column_stack([Q, TAU]))}
    kept = [(order[tuple(row)], t) for row, t in zip(rows, found.t, strict=True)
            if tuple(row) in order]  # fmt: skip
    delays = np.array([t - T[k] for k, t in kept])
    assert (np.abs(delays - np.median(delays)) > 1e-6).sum() <= changes


def examples(few: int, many: int) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("count", [few, pytest.param(many, marks=pytest.mark.slow)])


@each_kind
def test_an_undamaged_file_is_read(kind: str, files: Files, tmp_path: Path) -> None:
    suffix, content = files[kind]
    (tmp_path / f"log{suffix}").write_bytes(content)
    for pieces in (False, True):
        found = attempt(tmp_path / f"log{suffix}", pieces=pieces)
        assert found is not None
        np.testing.assert_array_equal(found.q, Q)
        np.testing.assert_array_equal(found.tau, TAU)
        np.testing.assert_allclose(found.t, T, atol=1e-12)


@each_kind
@examples(10, 150)
def test_damaged_bytes(kind: str, count: int, files: Files) -> None:
    suffix, content = files[kind]

    @settings(max_examples=count)
    @given(damages=DAMAGES, pieces=st.booleans())
    def check(damages: list[tuple[str, float, int]], pieces: bool) -> None:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"log{suffix}"
            path.write_bytes(damaged(content, damages))
            found = attempt(path, pieces=pieces)
        if found is not None:
            assert_true(found, len(damages))

    check()


CELLS = st.one_of(
    st.floats(),
    st.integers(-(10**30), 10**30),
    st.text(max_size=6),
    st.none(),
    st.booleans(),
    st.sampled_from(["1_000", "0x10", "1,5", "1.234,56", "１２", "∞", "1e400", "TRUE", " 1", "1 2",
                     "NaN", "-inf", "2026-01-01", "65535"]),
)  # fmt: skip
NAMES = st.one_of(
    st.text(min_size=1, max_size=8).filter(lambda text: not text.isspace()),
    st.sampled_from(["q1", "Q1", "q１", "tau1", "i1", "dq1", "τ1", "target_q1", "q_ref1", "q[1]",
                     "q1 [deg]", "position", "joint1", "名前", "time", "q1\n", "q 1 ", "1"]),
)  # fmt: skip
EDITS = st.one_of(
    st.tuples(st.just("cell"), st.integers(0, N - 1), st.integers(0, 4), CELLS),
    st.tuples(st.just("add"), NAMES),
    st.tuples(st.just("rename"), st.integers(0, 4), NAMES),
    st.tuples(st.sampled_from(["twice", "drop", "text"]), st.integers(0, 4)),
    st.tuples(st.just("order"), st.permutations(range(5))),
    st.tuples(st.just("again"), st.integers(0, N - 1)),
    st.tuples(st.just("keep"), st.integers(0, N)),
)


def edited(table: pd.DataFrame, edits: Sequence[tuple[Any, ...]]) -> pd.DataFrame:
    """The table with cells, names, order, types or shape changed."""
    for kind, value, *more in edits:
        width = table.shape[1]
        if kind == "cell":
            column = more[0] % width
            cells = list(table.iloc[:, column])
            cells[value : value + 1] = [more[1]] if value < len(cells) else []
            table.isetitem(column, pd.Series(cells, table.index, dtype=object))
        elif kind == "add":
            table = pd.concat([table, pd.Series(7.5, table.index, name=value)], axis=1)
        elif kind == "rename":
            names = list(table.columns)
            names[value % width] = more[0]
            table = table.set_axis(names, axis=1)
        elif kind == "twice":
            table = pd.concat([table, table.iloc[:, [value % width]]], axis=1)
        elif kind == "drop" and width > 1:
            table = table.drop(columns=table.columns[value % width])
        elif kind == "order":
            table = table.iloc[:, [*(k for k in value if k < width), *range(5, width)]]
        elif kind == "text":
            table.isetitem(value % width, table.iloc[:, value % width].astype(str))
        elif kind == "keep":
            table = table[:value]
        elif kind == "again":
            table = pd.concat([table, table[value : value + 1]])
    return table


@examples(50, 400)
def test_edited_tables(count: int) -> None:
    @settings(max_examples=count)
    @given(st.lists(EDITS, min_size=1, max_size=4), st.sampled_from([".csv", ".parquet"]))
    def check(edits: list[tuple[object, ...]], suffix: str) -> None:
        table = edited(TABLE.copy(), edits)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"log{suffix}"
            if suffix == ".csv":
                table.to_csv(path, index=False)
            else:
                try:
                    table.to_parquet(path)
                except Exception:  # a table that Parquet cannot hold
                    return
            found = attempt(path)
        if found is not None and not any(e[0] == "rename" and e[2] == "q1 [deg]" for e in edits):
            assert_true(found, sum(kind == "cell" for kind, *_ in edits))

    check()


VALUES = st.recursive(
    st.one_of(st.none(), st.booleans(), st.integers(-3, 10), st.floats(), st.text(max_size=6),
              st.sampled_from(["q{1}", "tau{1}", "q", "t", "deg", "{0}", "{joint}", "{"])),
    lambda inner: st.one_of(
        st.lists(inner, max_size=3),
        st.dictionaries(st.sampled_from(["q", "tau", "t", "joint1", "gain_Nm_per_A", "x"]), inner,
                        max_size=3),
    ),
    max_leaves=6,
)  # fmt: skip
KEYS = st.sampled_from(["t", "q", "dq", "tau", "i", "units", "sign", "drive", "topic", "other"])


@given(content=st.dictionaries(KEYS, VALUES, max_size=4))
@settings(max_examples=30)
def test_maps_of_any_content(content: dict[str, object]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path, log = Path(folder) / "columns.yaml", Path(folder) / "log.csv"
        pd.Series(content, dtype=object).to_json(path, force_ascii=False)  # JSON is YAML
        log.write_bytes(_csv())
        found, refusal = None, ""
        try:
            found = load_recording(log, ROBOT, mapping=load_column_map(path))
        except ExcitantError as error:
            refusal = str(error)
    if found is None:
        assert "columns.yaml" in refusal or "log.csv" in refusal
        assert "\n" not in refusal
    elif not set(content) & {"t", "q", "tau", "i", "units", "sign", "drive"}:
        assert_true(found, 0)


@pytest.mark.parametrize("suffix", [".csv", ".parquet", ".npz", ".mat", ".bag", ".mcap", ".db3"])
def test_nothing_in_a_file_is_refused(suffix: str, tmp_path: Path) -> None:
    for content in (b"", b"\0", b"\n", b"\n\n\n", b"\xff" * 300, b" "):
        (tmp_path / f"log{suffix}").write_bytes(content)
        assert attempt(tmp_path / f"log{suffix}") is None
