"""Every recording that cannot be used is refused in one line that says where and what to do."""

from __future__ import annotations

import itertools
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
import pytest
from hypothesis import given
from hypothesis import strategies as st

from excitant.exceptions import BadInput, BadRecording
from excitant.identify import (
    ColumnMap,
    Recording,
    load_recording,
    read_chunks,
    recording_from_table,
    split,
)

Corruption = Callable[[pd.DataFrame], pd.DataFrame]
Save = Callable[..., Path]


def with_value(row: int, column: str, value: object) -> Corruption:
    return lambda table: table.astype(object).where(
        (table.index[:, None] != row) | (table.columns != column), value
    )


CORRUPTIONS: dict[str, tuple[Corruption, int | None, str | None, str]] = {
    "missing position": (lambda x: x.drop(columns="q1"), None, "q1", "rename or add"),
    "missing torque": (lambda x: x.drop(columns="tau2"), None, "tau2", "rename or add"),
    "missing time": (lambda x: x.drop(columns="t"), None, "t", "rename or add"),
    "no torque": (lambda x: x.drop(columns=["tau1", "tau2"]), None, None, "neither 'tau1'"),
    "not a number": (with_value(17, "q2", np.nan), 17, "q2", "remove or repair"),
    "infinite": (with_value(3, "tau1", np.inf), 3, "tau1", "remove or repair"),
    "text": (with_value(5, "tau2", "abc"), 5, "tau2", "'abc'"),
    "one joint too few": (lambda x: x.drop(columns=["q2", "tau2"]), None, None, "lock the joints"),
    "one joint too many": (lambda x: x.assign(q3=x.q1, tau3=x.tau1), None, None, "lock the joints"),
    "one torque too many": (lambda x: x.assign(tau3=x.tau1), None, "tau3", "remove it"),
    "time goes back": (lambda x: x.iloc[np.r_[0:40, 41, 40, 42:300]], 41, "t", "goes back"),
    "time repeats": (with_value(40, "t", 0.39), 40, "t", "repeats"),
    "short": (lambda x: x[:150], None, "t", "at least 2 s"),
    "one row": (lambda x: x[:1], None, "t", "at least 2 s"),
    "no rows": (lambda x: x[:0], None, "t", "at least 2 s"),
    "dead channel": (lambda x: x.assign(tau2=0.25), None, "tau2", "repair the sensor"),
}


@pytest.mark.parametrize("name", CORRUPTIONS)
def test_a_bad_table_is_refused_where_it_is_bad(
    name: str, table: pd.DataFrame, save: Save, tmp_path: Path
) -> None:
    corrupt, row, column, advice = CORRUPTIONS[name]
    bad = corrupt(table).reset_index(drop=True)
    texts = bad.map(lambda v: isinstance(v, str)).any()
    typed = bad.astype({c: str if texts[c] else float for c in bad})
    for path in (save(bad, tmp_path / "bad.csv"), save(typed, tmp_path / "bad.parquet")):
        with pytest.raises(BadRecording) as refusal:
            load_recording(path, 2)
        error, text = refusal.value, str(refusal.value)
        assert (error.file, error.row, error.column) == (str(path), row, column)
        assert all(part in text for part in (str(path), advice, f"row {row}" if row else ""))
        assert "\n" not in text


@pytest.mark.parametrize(
    ("name", "content", "why"),
    [
        ("corrupt.parquet", b"PAR1 rubbish", "cannot be read"),
        ("binary.csv", bytes(range(128, 256)) * 20, "cannot be read"),
        ("unknown.xyz", b"t,q1\n", "give .parquet or .csv"),
        ("nothing.csv", None, "no such file"),
    ],
)
def test_a_bad_file_is_refused_by_name(
    name: str, content: bytes | None, why: str, tmp_path: Path
) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(BadRecording, match=f"{name}.*{why}") as refusal:
        load_recording(tmp_path / name, 2)
    assert "\n" not in str(refusal.value)


def test_recordings_in_different_units_are_refused(table: pd.DataFrame) -> None:
    renamed = table.rename(columns={"tau1": "i1", "tau2": "i2"})
    one = recording_from_table(table, 2, file="torque.csv", name="torque")
    other = recording_from_table(renamed, 2, file="current.csv", name="current")
    assert (one.unit, other.unit) == ("N·m", "A")
    for first, second in ((one, other), (other, one)):
        with pytest.raises(BadRecording, match="use recordings of one unit") as refusal:
            split([first], [second])
        assert all(name in str(refusal.value) for name in ("torque.csv", "current.csv"))


def test_too_little_to_hold_out_is_refused_with_advice(table: pd.DataFrame) -> None:
    recording = recording_from_table(table, 2, file="f.csv", name="n")
    assert recording.duration > 2.0
    with pytest.raises(BadRecording, match=r"f\.csv.*hold-out of its own"):
        split([recording])
    split([recording], [recording])


@given(st.lists(st.floats(0, 1), max_size=3))
def test_parts_of_a_recording_cover_it_once(cuts: list[float]) -> None:
    t = np.sort(np.random.default_rng(0).uniform(0, 10, 500))
    recording = Recording("n", "f", t, t[:, None], t[:, None])
    ends = itertools.pairwise(sorted({0.0, *cuts, 1.0}))
    parts = [recording.between(*pair, "part").t for pair in ends]
    np.testing.assert_array_equal(np.concatenate(parts), t)


@pytest.mark.parametrize("suffix", [".csv", ".parquet", ".npz"])
@pytest.mark.parametrize("rows", [1, 7, 100, 300, 1000])
def test_pieces_put_together_are_the_whole(
    suffix: str, rows: int, table: pd.DataFrame, save: Save, tmp_path: Path
) -> None:
    stamps = 1_700_000_000_000_000_000 + np.round(table.t * 1e9).astype(int)
    columns = {"q1": "a", "q2": "b"}
    log = table.assign(t=stamps, dq1=1.0, dq2=2.0).rename(columns=columns)
    path, mapping = save(log, tmp_path / f"log{suffix}"), ColumnMap({"q": ("b", "a")})
    whole = load_recording(path, 2, mapping=mapping)
    np.testing.assert_allclose(whole.t, table.t, atol=1e-12)
    parts = list(read_chunks(path, 2, rows, mapping=mapping))
    assert all(len(part.t) <= rows for part in parts)
    for name in ("t", "q", "tau", "dq"):
        together = np.concatenate([getattr(part, name) for part in parts])
        np.testing.assert_array_equal(together, getattr(whole, name))


def test_files_of_one_log_go_on(table: pd.DataFrame, save: Save, tmp_path: Path) -> None:
    one, other = (save(x, tmp_path / f"{len(x)}.csv") for x in (table[:90], table[90:]))
    parts = list(read_chunks([one, other], 2, 50))
    np.testing.assert_allclose(np.concatenate([p.t for p in parts]), table.t, atol=1e-12)
    np.testing.assert_array_equal(np.concatenate([p.q for p in parts]), table[["q1", "q2"]])
    with pytest.raises(BadRecording, match="time goes back") as refusal:
        list(read_chunks([other, one], 2, 50))
    assert (refusal.value.file, refusal.value.row) == (str(one), 0)


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_a_bad_row_is_counted_from_the_start(
    suffix: str, table: pd.DataFrame, save: Save, tmp_path: Path
) -> None:
    for row, column, value, why in (
        (217, "q2", np.nan, "not a finite number"),
        (100, "t", table["t"][99], "time repeats"),  # the first row of a piece
        (150, "t", table["t"][149], "time repeats"),
    ):
        bad = table.copy()
        bad.loc[row, column] = value
        parts = read_chunks(save(bad, tmp_path / f"log{suffix}"), 2, 100)
        assert [len(next(parts)) for _ in range(row // 100)] == [100] * (row // 100)
        with pytest.raises(BadRecording, match=why) as refusal:
            next(parts)
        assert (refusal.value.row, refusal.value.column) == (row, column)


def test_what_only_the_whole_shows_is_refused_at_the_end(
    table: pd.DataFrame, save: Save, tmp_path: Path
) -> None:
    path = tmp_path / "log.csv"
    with pytest.raises(BadRecording, match="dead channel: 2 in every row") as refusal:
        list(read_chunks(save(table.assign(tau2=2.0), path), 2, 100))
    assert refusal.value.column == "tau2"
    for rows in (0, 1, 150):
        with pytest.raises(BadRecording, match="too short"):
            list(read_chunks(save(table[:rows], path), 2, 100))
    with pytest.raises(BadInput, match="at least one row"):
        next(read_chunks(path, 2, 0))
    still = table.assign(tau2=(table.index >= 200) * 1.0)  # dead in a piece, alive in the log
    assert len(list(read_chunks(save(still, path), 2, 100))) == 3


PEAK = """
import pathlib, sys
from excitant.identify import read_chunks
rows = sum(len(part) for part in read_chunks(sys.argv[1], 7, 50_000))
status = pathlib.Path("/proc/self/status").read_text().splitlines()
print(rows, next(line.split()[1] for line in status if "VmHWM" in line))
"""


@pytest.mark.slow
def test_two_million_rows_take_less_than_500_megabytes(tmp_path: Path) -> None:
    n, rng = 2_000_000, np.random.default_rng(0)
    names = [f"{name}{k}" for k in range(1, 8) for name in ("q", "tau")]
    log = pa.table({"t": np.arange(n) / 1000} | {x: rng.normal(size=n).round(6) for x in names})
    pyarrow.csv.write_csv(log, tmp_path / "log.csv")
    pyarrow.parquet.write_table(log, tmp_path / "log.parquet", row_group_size=n)
    for path in tmp_path.iterdir():
        command = [sys.executable, "-c", PEAK, str(path)]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        rows, peak = map(int, done.stdout.split())
        assert rows == n
        assert peak / 1024 < 500
