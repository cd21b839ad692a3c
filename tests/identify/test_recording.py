"""What cannot be used is refused by its place; pieces and decimated logs say the same."""

import gzip
import itertools
import json
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
import pytest
import streaming
from arms import truth
from hypothesis import given
from hypothesis import strategies as st
from known_arms import Call, recorded, smooth_motion
from marks import refusal, refused

from excitant.api import as_recordings
from excitant.exceptions import BadInput, BadRecording
from excitant.identify import ColumnMap, Recording, identify_robot, load_dataset, load_recording
from excitant.identify.dataset import excerpt
from excitant.identify.faults import find_faults
from excitant.identify.preprocessing import prepare
from excitant.identify.reading.logs import read_chunks, recording_from_table
from excitant.identify.rows import split
from excitant.robots import load_robot

Corruption = Callable[[pd.DataFrame], pd.DataFrame]


def with_value(row: int, column: str, value: object) -> Corruption:
    return lambda x: x.assign(**{column: x[column].astype(object).where(x.index != row, value)})


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
def test_a_bad_table_is_refused_where_it_is_bad(name: str, table: pd.DataFrame, save: Call) -> None:
    corrupt, row, column, advice = CORRUPTIONS[name]
    bad = corrupt(table).reset_index(drop=True)
    texts = bad.map(lambda v: isinstance(v, str)).any()
    typed = bad.astype({c: str if texts[c] else float for c in bad})
    for path in (save(bad, "bad.csv"), save(typed, "bad.parquet")):
        error = refusal(".", load_recording, path, 2, error=BadRecording)
        assert (error.file, error.row, error.column) == (str(path), row, column)
        assert all(part in str(error) for part in (str(path), advice, f"row {row}" if row else ""))


def test_a_bad_file_is_refused_by_name(tmp_path: Path) -> None:
    (tmp_path / "corrupt.parquet").write_bytes(b"PAR1 rubbish")
    (tmp_path / "binary.csv").write_bytes(bytes(range(128, 256)) * 20)
    (tmp_path / "unknown.xyz").write_bytes(b"t,q1\n")
    long = "# " + 300_000 * "x"
    (tmp_path / "preamble.csv").write_text(f"{long}\nt,q1,q2,tau1,tau2\n0,0,0,0,0\n")
    damaged = [f"{name}.*cannot be read" for name in ("corrupt.parquet", "binary.csv")]
    others = ["unknown.xyz.*give .parquet or .csv", "nothing.csv.*no such file"]
    for words in (*damaged, "preamble.csv.*first 256 KiB", *others):
        refused(words, load_recording, tmp_path / words.partition(".*")[0], 2, error=BadRecording)


def test_other_units_and_too_little_to_hold_out_are_refused(table: pd.DataFrame) -> None:
    logs = (("torque", table), ("current", table.rename(columns={"tau1": "i1", "tau2": "i2"})))
    one, other = (recording_from_table(x, 2, file=f"{name}.csv", name=name) for name, x in logs)
    assert (one.unit, other.unit) == ("N·m", "A")
    for first, second in ((one, other), (other, one)):
        said = refused("use recordings of one unit", split, [first], [second], error=BadRecording)
        assert all(name in said for name in ("torque.csv", "current.csv"))
    refused(r"torque\.csv.*hold-out of its own", split, [one], error=BadRecording)
    split([one], [one])


@given(st.lists(st.floats(0, 1), max_size=3))
def test_parts_of_a_recording_cover_it_once(cuts: list[float]) -> None:
    t = np.sort(np.random.default_rng(0).uniform(0, 10, 500))
    recording = Recording("n", "f", t, t[:, None], t[:, None])
    ends = itertools.pairwise(sorted({0.0, *cuts, 1.0}))
    parts = [recording.between(*pair, "part").t for pair in ends]
    np.testing.assert_array_equal(np.concatenate(parts), t)


def test_one_or_several_stand_for_recordings(table: pd.DataFrame, save: Call) -> None:
    arm, file = load_robot("planar_2r"), save(table, "log.parquet")
    for one in (table, file, str(file), load_recording(file, arm)):
        for some, count in ((one, 1), ([one], 1), ((one, one), 2), (iter([one, one]), 2)):
            assert [len(each) for each in as_recordings(some, arm)] == count * [len(table)]
    assert as_recordings((), arm) == []


def printed(*words: str) -> str:
    """What another Python prints."""
    return subprocess.check_output([sys.executable, *words], text=True)


def test_numbers_are_read_without_pandas(table: pd.DataFrame, save: Call) -> None:
    code = f"""
import sys
from excitant.identify import load_recording, read_chunks
for log in {[str(save(table, f"log.{suffix}")) for suffix in ("parquet", "npz")]}:
    rows = len(load_recording(log, 2)), sum(map(len, read_chunks(log, 2, 100)))
    print(*rows, "pandas" in sys.modules)
"""
    assert printed("-c", code).split() == [str(len(table)), str(len(table)), "False"] * 2


@pytest.mark.parametrize("suffix", [".csv", ".parquet", ".npz"])
@pytest.mark.parametrize("rows", [1, 100, 210, 1000])
def test_pieces_put_together_are_the_whole(suffix, rows, table, save):
    table = table[:210]
    stamps = 1_700_000_000_000_000_000 + np.round(table.t * 1e9).astype(int)
    columns = {"q1": "a", "q2": "b"}
    log = table.assign(t=stamps, dq1=1.0, dq2=2.0).rename(columns=columns)
    path, mapping = save(log, f"log{suffix}"), ColumnMap({"q": ("b", "a")})
    whole = load_recording(path, 2, mapping=mapping)
    np.testing.assert_allclose(whole.t, table.t, atol=1e-12)
    parts = list(read_chunks(path, 2, rows, mapping=mapping))
    assert all(len(part.t) <= rows for part in parts)
    for name in ("t", "q", "tau", "dq"):
        together = np.concatenate([getattr(part, name) for part in parts])
        np.testing.assert_array_equal(together, getattr(whole, name))


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_a_bad_row_is_counted_from_the_start(suffix: str, table: pd.DataFrame, save: Call) -> None:
    for row, column, value, why in (
        (217, "q2", np.nan, "not a finite number"),
        (100, "t", 0.99, "time repeats"),  # the first row of a piece
        (150, "t", 1.49, "time repeats"),
    ):
        bad = save(with_value(row, column, value)(table).astype(float), f"log{suffix}")
        parts = read_chunks(bad, 2, 100)
        assert [len(next(parts)) for _ in range(row // 100)] == [100] * (row // 100)
        error = refusal(why, next, parts, error=BadRecording)
        assert (error.row, error.column) == (row, column)


def test_what_only_the_whole_shows_is_refused_at_the_end(table: pd.DataFrame, save: Call) -> None:
    for bad, why in (
        (table.assign(tau2=2.0), "tau2.*dead channel: 2 in every row"),
        *((table[:rows], "too short") for rows in (0, 1, 150)),
    ):
        refused(why, list, read_chunks(save(bad, "log.csv"), 2, 100), error=BadRecording)
    refused("at least one row", next, read_chunks("log.csv", 2, 0), error=BadInput)
    still = table.assign(tau2=(table.index >= 200) * 1.0)  # dead in a piece, alive in the log
    assert len(list(read_chunks(save(still, "log.csv"), 2, 100))) == 3


K, RANDOM = np.arange(60.0), np.random.default_rng(0).uniform(-1, 1, 60)


@pytest.mark.parametrize(
    ("step", "q", "speed", "samples"),
    [
        *((step, RANDOM, None, None) for step in (3.0, 86_399.0, 86_401.0)),
        (3.0, 0.1 * K, None, None),  # a sweep
        (1.0, np.sin(K / 2), 0.5 * np.cos(K / 2), None),
        (50.0, np.sin(K / 20), None, 60),  # ms
        (50.0, 60 * np.sin(K / 20), None, 60),  # ms and degrees
        (1.0, np.sin(K / 20), np.cos(K / 20), 60),  # counts samples
    ],
)
def test_rows_seconds_apart_are_poses(planar, save, step, q, speed, samples):
    """Rows that no arm can reach in milliseconds are seconds apart, and show no motion."""
    log = pd.DataFrame({"t": step * K, "q1": q, "q2": 0.9 * q, "tau1": K, "tau2": -K})
    log = log if speed is None else log.assign(dq1=speed, dq2=0.9 * speed)
    path = save(log, "log.csv")
    if samples:
        assert len(load_recording(path, planar)) == samples
        return
    why = f"{step:.4g} s apart, more than a day"
    why = f"60 rows {step:.4g} s apart show poses and no motion" if step < 86_400 else why
    refused(re.escape(why), lambda: prepare(load_recording(path, planar)), error=BadRecording)
    few = pd.DataFrame({"t": 0.2 * K, "q1": q, "q2": q, "tau1": K, "tau2": K})[:16]
    with pytest.raises(BadRecording, match=r"holds 16 samples 0.2 s apart; more than 20"):
        prepare(load_recording(save(few, "few.csv"), planar))


PEAK = """
import pathlib, sys
from excitant.identify import read_chunks
rows = sum(len(part) for part in read_chunks(sys.argv[1], 7, 50_000))
status = pathlib.Path("/proc/self/status").read_text().splitlines()
print(rows, next(line.split()[1] for line in status if "VmHWM" in line))
"""


@pytest.mark.slow
def test_memory_is_that_of_pieces(tmp_path: Path) -> None:
    """Two million rows are read in 500 MB, one million identified in 700 instead of 5500."""
    n, rng = 2_000_000, np.random.default_rng(0)
    names = [f"{name}{k}" for k in range(1, 8) for name in ("q", "tau")]
    log = pa.table({"t": np.arange(n) / 1000} | {x: rng.normal(size=n).round(6) for x in names})
    pyarrow.csv.write_csv(log, tmp_path / "log.csv")
    pyarrow.parquet.write_table(log, tmp_path / "log.parquet", row_group_size=n)
    for path in tmp_path.iterdir():
        rows, peak = map(int, printed("-c", PEAK, str(path)).split())
        assert rows == n
        assert peak / 1024 < 500
    said = printed(streaming.__file__, "--samples", "1100000")
    [(megabytes, nrmse)] = re.findall(r"memory +(\d+) MB.*nrmse (\S+)", said, re.DOTALL)
    assert int(megabytes) < 700
    assert float(nrmse) < 0.3


RATE, KNOWN = 1000.0, truth("planar_2r")
PLANAR = KNOWN.robot


def logged(t: np.ndarray) -> Recording:
    return recorded(KNOWN, smooth_motion(PLANAR, t), 0)


def pieces(whole: Recording, rows: int) -> Iterator[Recording]:
    return (whole.take(slice(k, k + rows)) for k in range(0, len(whole), rows))


@pytest.mark.slow
@pytest.mark.parametrize("jitter", [0.0, 0.3])
def test_windows_of_a_long_log_give_its_estimate(jitter: float, monkeypatch: Any) -> None:
    monkeypatch.setattr("excitant.identify.dataset.WINDOW_S", 6.0)
    t = np.arange(120_000) / RATE
    whole = logged(t + jitter / RATE * np.random.default_rng(1).uniform(-0.5, 0.5, len(t)))
    noisy = whole.tau + np.random.default_rng(2).normal(0, 1.0, whole.tau.shape)  # more than edges
    whole = replace(whole, tau=noisy, dq=np.gradient(whole.q, whole.t, axis=0))
    expected = identify_robot(PLANAR, [whole])
    std = np.sqrt(np.diag(expected.least_squares.covariance))
    for rows in (700, 9999):
        some = excerpt(pieces(whole, rows), 0.25)
        assert 0.24 < len(some) / len(whole) < 0.26
        kept = np.isin(whole.t, some.t)
        for name, values in whole.channels():
            np.testing.assert_array_equal(getattr(some, name), values[kept])
        assert find_faults(PLANAR, some) == ()
        assert max(np.diff(np.append(some.t, whole.t[-1]))) < 24 - 6 + 1  # spread over the log
        found = identify_robot(PLANAR, [some])
        own = np.sqrt(np.diag(found.least_squares.covariance))
        assert (np.abs(found.least_squares.beta - expected.least_squares.beta) < 4 * own).all()
        assert np.median(own / std) < 3  # a quarter of the log, edges of windows lost
    with_hole = pieces(replace(whole, t=whole.t + (whole.t > 2.5)), 700)
    [gap] = find_faults(PLANAR, excerpt(with_hole, 0.25))
    assert (gap.fault, gap.evidence["gaps"]) == ("dropped_samples", 1)


def test_pieces_of_long_files_have_no_speeds_that_end_and_bad_rows_are_refused(save, monkeypatch):
    whole = logged(np.arange(8000) / RATE)
    parts = [*pieces(whole, 1000)]
    some = excerpt([*(replace(part, dq=part.q) for part in parts[:4]), *parts[4:]], 0.9)
    assert (some.dq, len(some)) == (None, 8000)
    path = save(whole, "log.csv")
    known = load_dataset("planar_2r")
    assert len(known.recordings([str(path)])[0]) == 8000
    monkeypatch.setattr("excitant.identify.dataset.LONG", 5000)
    monkeypatch.setattr("excitant.identify.dataset.WINDOW_S", 2.5)
    other, packed = path.with_suffix(".log"), path.with_suffix(".txt.gz")
    shutil.copy(path, other)
    packed.write_bytes(gzip.compress(path.read_bytes()))
    for name in (path, other, packed):
        [some] = known.recordings([str(name)])
        assert 4900 < len(some) < 5600
        assert any("windows of 2.5 s, every" in note for note in some.notes)
    save(replace(whole, t=np.where(whole.t == 3.789, 1.0, whole.t)), "log.csv")
    error = refusal("goes back", known.recordings, [str(path)], error=BadRecording)
    assert (error.row, error.column) == (3789, "t")  # between two windows


@pytest.fixture
def folder(table: pd.DataFrame, tmp_path: Path, save: Call) -> Path:
    """A data set: a robot, recordings and a sidecar."""
    (tmp_path / "robot.urdf").write_text(PLANAR.urdf, encoding="utf-8")
    save(table.assign(i1=table.tau1 / 2, i2=table.tau2 / 2), "first.parquet")
    save(table, "second.csv")
    (tmp_path / "dataset.json").write_text("{}")
    return tmp_path


def test_recordings_are_named_within_the_folder_or_are_paths(folder, monkeypatch):
    monkeypatch.chdir("/")
    known, without = load_dataset(folder), load_dataset("planar_2r")
    named = known.recordings(["first", "first.parquet", "second", "second.csv"])
    assert [r.name for r in named] == ["first", "first", "second", "second"]
    assert {Path(r.file).parent for r in named} == {folder}
    assert [r.name for r in known.recordings([])] == ["first", "second"]
    assert without.recordings([str(folder / "second.csv")])[0].name == "second"
    refused("name at least one file", without.recordings, [], error=BadInput)


def test_the_sidecar_names_torque_gains_and_units_and_locks_joints(folder, table):
    def with_sidecar(content: dict[str, Any]) -> Any:
        (folder / "dataset.json").write_text(json.dumps(content))
        return load_dataset(folder)

    assert load_dataset(folder).recordings(["first"])[0].unit == "N·m"
    known = with_sidecar({"torque": {"column": "i"}})
    assert known.recordings(["first"])[0].unit == "A"
    refused("'i1'", known.recordings, ["second"], error=BadRecording)
    gains = {"column": "i", "drive_gain_Nm_per_A": [1, 3]}
    [found] = with_sidecar({"torque": gains, "units": {"q": "deg"}}).recordings(["first"])
    np.testing.assert_allclose(found.tau, table[["tau1", "tau2"]] * [0.5, 1.5])
    np.testing.assert_allclose(found.q, np.radians(table[["q1", "q2"]]), atol=1e-12)
    robot = with_sidecar({"kinematics": {"urdf": "robot.urdf", "lock": ["joint2"]}}).robot
    assert (robot.joints, dict(robot.locked)) == (("joint1",), {"joint2": 0.0})
    expected = load_robot(folder / "robot.urdf", lock={"joint2": 0.0})
    assert robot.phi.tolist() == expected.phi.tolist()


BAD_SIDECARS = """{
[]
{"kinematics": "robot.urdf"}
{"torque": "i"}
{"torque": {"column": 3}}
{"kinematics": {"lock": "joint2"}}
{"kinematics": {"lock": ["joint9"]}}
{"kinematics": {"urdf": "nothing.urdf"}}"""


@pytest.mark.parametrize("content", BAD_SIDECARS.splitlines())
def test_a_bad_sidecar_is_refused_in_one_line(folder: Path, content: str) -> None:
    (folder / "dataset.json").write_text(content)
    said = refused(str(folder), load_dataset, folder)
    assert ("dataset.json" in said) == ("nothing" not in content)
    (folder / "dataset.json").unlink()
    assert load_dataset(folder).robot.nv == 2


def test_a_folder_without_robot_or_recordings_is_refused(folder: Path) -> None:
    (folder / "first.parquet").unlink()
    (folder / "second.csv").unlink()
    refused(r"no \.parquet or \.csv recording", load_dataset(folder).recordings, [], error=BadInput)
    (folder / "robot.urdf").unlink()
    refused("no robot model", load_dataset, folder, error=BadInput)


def test_real_data_sets_read_and_what_is_held_out_is_never_fitted(data_folder: Path) -> None:
    for name, nv, unit in (("ur10", 6, "N·m"), ("panda", 7, "N·m"), ("ur10e", 6, "A")):
        known = load_dataset(data_folder / name)
        assert known.robot.nv == nv
        assert {r.unit for r in known.recordings([])} == {unit}
    known = load_dataset(data_folder / "dualarm_v2")
    names = {path.stem for path in known.paths([], without=["exc_52p2.parquet"])}
    assert names & {"exc_52p2", "exc_13p5"} == {"exc_13p5"}
    with pytest.raises(BadInput, match="exc_52p2 is to be fitted and held out"):
        known.paths(["exc_52p2"], without=["exc_52p2.parquet"])
