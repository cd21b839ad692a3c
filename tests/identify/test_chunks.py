"""A log read piece by piece is the log, in the memory of a piece."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
import pytest

from excitant.exceptions import BadInput, BadRecording
from excitant.identify import ColumnMap, read_chunks, read_recording

PEAK = """
import pathlib, resource, sys
from excitant.identify import read_chunks
rows = sum(len(part.t) for part in read_chunks(sys.argv[1], 7, 50_000))
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss  # on Linux at least its parent's
status = pathlib.Path("/proc/self/status")
if status.is_file():
    peak = next(x.split()[1] for x in status.read_text().splitlines() if "VmHWM" in x)
print(rows, int(peak) / 1024)
"""


def write(table: pd.DataFrame, path: Path) -> Path:
    if path.suffix == ".csv":
        table.to_csv(path, index=False)
    elif path.suffix == ".npz":
        np.savez(path, **{name: table[name] for name in table})
    else:
        table.to_parquet(path, row_group_size=70)
    return path


@pytest.mark.parametrize("suffix", [".csv", ".parquet", ".npz"])
@pytest.mark.parametrize("rows", [1, 7, 100, 300, 1000])
def test_pieces_put_together_are_the_whole(
    suffix: str, rows: int, table: pd.DataFrame, tmp_path: Path
) -> None:
    path = write(table.assign(t=table.t + 1.7e9, dq1=1.0, dq2=2.0), tmp_path / f"log{suffix}")
    whole, parts = read_recording(path, 2), list(read_chunks(path, 2, rows))
    assert all(len(part.t) <= rows for part in parts)
    for name in ("t", "q", "tau", "dq"):
        together = np.concatenate([getattr(part, name) for part in parts])
        np.testing.assert_array_equal(together, getattr(whole, name))


def test_time_is_understood_once_for_all_pieces(table: pd.DataFrame, tmp_path: Path) -> None:
    stamps = 1_700_000_000_000_000_000 + np.round(table.t * 1e9).astype(int)
    path = write(table.assign(t=stamps), tmp_path / "log.csv")
    parts = list(read_chunks(path, 2, 90))
    np.testing.assert_allclose(np.concatenate([p.t for p in parts]), table.t, atol=1e-12)


def test_files_of_one_log_go_on(table: pd.DataFrame, tmp_path: Path) -> None:
    files = [
        write(table[rows], tmp_path / f"log_{k}.csv")
        for k, rows in enumerate((slice(0, 90), slice(90, 300)))
    ]
    parts = list(read_chunks(files, 2, 50))
    np.testing.assert_allclose(np.concatenate([p.t for p in parts]), table.t, atol=1e-12)
    np.testing.assert_array_equal(np.concatenate([p.q for p in parts]), table[["q1", "q2"]])
    with pytest.raises(BadRecording, match="time goes back") as refusal:
        list(read_chunks(files[::-1], 2, 50))
    assert (refusal.value.file, refusal.value.row) == (str(files[0]), 0)


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_a_bad_row_is_counted_from_the_start(
    suffix: str, table: pd.DataFrame, tmp_path: Path
) -> None:
    bad = table.copy()
    bad.loc[217, "q2"] = np.nan
    parts = read_chunks(write(bad, tmp_path / f"log{suffix}"), 2, 100)
    assert [len(next(parts).t), len(next(parts).t)] == [100, 100]
    with pytest.raises(BadRecording, match="not a finite number") as refusal:
        next(parts)
    assert (refusal.value.row, refusal.value.column) == (217, "q2")
    for row in (100, 150):  # the first row of a piece, and one within
        bad = table.copy()
        bad.loc[row, "t"] = bad.loc[row - 1, "t"]
        with pytest.raises(BadRecording, match="time repeats") as refusal:
            list(read_chunks(write(bad, tmp_path / f"log{suffix}"), 2, 100))
        assert (refusal.value.row, refusal.value.column) == (row, "t")


def test_what_only_the_whole_shows_is_refused_at_the_end(
    table: pd.DataFrame, tmp_path: Path
) -> None:
    with pytest.raises(BadRecording, match="dead channel: 2 in every row") as refusal:
        list(read_chunks(write(table.assign(tau2=2.0), tmp_path / "a.csv"), 2, 100))
    assert refusal.value.column == "tau2"
    with pytest.raises(BadRecording, match="too short"):
        list(read_chunks(write(table[:150], tmp_path / "b.csv"), 2, 100))
    for rows in (0, 1):
        with pytest.raises(BadRecording, match="too short"):
            list(read_chunks(write(table[:rows], tmp_path / "b.csv"), 2, 100))
    still = table.assign(tau2=(table.index >= 200) * 1.0)  # dead in a piece, alive in the log
    assert len(list(read_chunks(write(still, tmp_path / "c.csv"), 2, 100))) == 3


def test_pieces_take_a_map_and_refuse_no_rows(table: pd.DataFrame, tmp_path: Path) -> None:
    path = write(table.rename(columns={"q1": "a", "q2": "b"}), tmp_path / "log.csv")
    parts = list(read_chunks(path, 2, 100, mapping=ColumnMap({"q": ("b", "a")})))
    np.testing.assert_array_equal(np.concatenate([p.q for p in parts]), table[["q2", "q1"]])
    with pytest.raises(BadInput, match="at least one row"):
        next(read_chunks(path, 2, 0))


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".parquet", ".csv"])
def test_two_million_rows_take_less_than_500_megabytes(suffix: str, tmp_path: Path) -> None:
    n, rng = 2_000_000, np.random.default_rng(0)
    columns = {"t": np.arange(n) / 1000}
    for k in range(1, 8):
        columns |= {f"q{k}": rng.normal(size=n).round(6), f"tau{k}": rng.normal(size=n).round(6)}
    path, log = tmp_path / f"log{suffix}", pa.table(columns)
    if suffix == ".csv":
        pyarrow.csv.write_csv(log, path)
    else:
        pyarrow.parquet.write_table(log, path, row_group_size=n)
    done = subprocess.run(
        [sys.executable, "-c", PEAK, str(path)], capture_output=True, text=True, check=True
    )
    rows, peak = done.stdout.split()
    assert int(rows) == n
    assert float(peak) < 500
