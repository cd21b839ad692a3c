"""Logs of any kind become the recording they hold, or are refused with what to write."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import scipy.io
import yaml

from excitant.exceptions import BadInput, BadRecording, ExcitantError
from excitant.identify import (
    ColumnMap,
    Recording,
    load_column_map,
    load_dataset,
    load_recording,
    raw_recording,
    recording_from_table,
)
from excitant.identify.reading import mat
from excitant.robots import load_robot

T = np.arange(300) / 100
_RATES = np.arange(1, 7)
Q = np.sin(np.outer(T, _RATES))
DQ = np.cos(np.outer(T, _RATES)) * _RATES
TAU = 3 * Q + DQ + _RATES
ARM = load_robot("ur10")
ORDER = sorted(range(6), key=lambda k: ARM.joints[k])  # of joints in ROS


def table(*names: str, first: int = 0, scale: Sequence[float] = (1, 1, 1, 1)) -> pd.DataFrame:
    """The motion under other names and in other units."""
    columns: dict[str, Any] = {names[0]: T * scale[0]}
    for name, values, factor in zip(names[1:], (Q, DQ, TAU), scale[1:], strict=True):
        columns |= {name.format(k + first): values[:, k] * factor for k in range(6)}
    return pd.DataFrame(columns)


EXACT = table("t", "q{}", "dq{}", "tau{}", first=1)  # names that need no guess
PLAIN = table("time", "q_{}", "qd_{}", "tau_{}")


def same(found: Recording, tau: np.ndarray = TAU) -> Recording:
    """The recording, which must be that of the motion."""
    np.testing.assert_allclose(found.t, T, atol=1e-6)
    for values, expected in ((found.q, Q), (found.dq, DQ), (found.tau, tau)):
        np.testing.assert_allclose(values, expected, rtol=1e-12, atol=1e-12)
    return found


Load = Callable[..., Recording]


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return tmp_path / "log.csv"


@pytest.fixture
def load(save: Callable[..., Path]) -> Load:
    """``load(log, content, suffix)``: a table as it is read from a file, with a map of columns."""

    def loaded(log: Any, mapping: Any = None, suffix: str = ".csv", **options: Any) -> Recording:
        if isinstance(log, pd.DataFrame):
            log = save(log, f"log{suffix}", **options)
        if mapping is not None and not isinstance(mapping, ColumnMap):
            raw = mapping if isinstance(mapping, bytes) else yaml.safe_dump(mapping).encode()
            (log.parent / "columns.yaml").write_bytes(raw)
            mapping = load_column_map(log.parent / "columns.yaml")
        return load_recording(log, ARM, mapping=mapping)

    return loaded


NAMES: dict[str, tuple[str, str, str, str, int, str]] = {
    "ur rtde": ("timestamp", "actual_q_{}", "actual_qd_{}", "actual_current_{}", 0, "A"),
    "numbered": ("time", "q_{}", "qd_{}", "torque_{}", 1, "N·m"),
    "brackets": ("Time", "position[{}]", "velocity[{}]", "effort[{}]", 0, "N·m"),
    "joint first": ("stamp", "joint{}_pos", "joint{}_vel", "joint{}_torque", 1, "N·m"),
    "camel case": ("timeStamp", "JointPos{}", "JointVel{}", "JointTorque{}", 1, "N·m"),
    "axes": ("t", "Axis {} angle", "Axis {} speed", "Axis {} current", 1, "A"),
    "dots": ("data.t", "data.q.{}", "data.qdot.{}", "data.tau.{}", 0, "N·m"),
    "exact": ("t", "q{}", "dq{}", "tau{}", 1, "N·m"),
    "present": ("t", "current_position_{}", "current_velocity_{}", "current_torque_{}", 0, "N·m"),
    "units": ("t [s]", "J{} Position [rad]", "J{} Speed [rad/s]", "J{} Torque [Nm]", 1, "N·m"),
    "a torque in A": ("t", "pos_{}", "vel_{}", "torque_{} [A]", 1, "A"),
}


@pytest.mark.parametrize("name", NAMES)
def test_common_names_are_understood_and_shown(name: str, load: Load) -> None:
    *columns, first, unit = NAMES[name]
    found = same(load(table(*columns, first=first)))
    assert found.unit == unit
    assert found.notes == () if name == "exact" else columns[1].format(first) in found.notes[0]


def test_columns_by_number_are_shown_with_their_joints(load: Load) -> None:
    """A controller's order is not always that of the description."""
    [note] = load(table("t", "position_{}", "velocity_{}", "effort_{}", first=0)).notes
    assert "q = position_0 → shoulder_pan_joint, position_1 → shoulder_lift_joint, " in note


COMMANDED = ["target_*", "desired_*", "commanded_*", "cmd_*", "ref_*", "setpoint_*", "*_ref"]


@pytest.mark.parametrize("form", COMMANDED)
def test_what_was_commanded_is_never_taken_for_measured(form: str, load: Load) -> None:
    """Nor accelerations, temperatures and speeds of the tool for anything."""
    commanded = table("x", *(form.replace("*", w) + "_{}" for w in ("q", "qd", "moment"))) * 2
    others = table("y", "ddq_logged{}", "temperature_{}", "actual_TCP_speed_{}") * 3
    both = pd.concat([commanded, others, PLAIN], axis=1)
    same(load(both))
    for missing in ("q_", "tau_"):
        with pytest.raises(BadRecording, match="--map"):
            load(both.drop(columns=[f"{missing}{k}" for k in range(6)]))


@pytest.mark.parametrize("extra", ["angle_{}", "actual_pos_{}", None])
def test_an_ambiguous_guess_is_refused_with_a_map_that_settles_it(
    extra: str | None, load: Load
) -> None:
    """Two sets of positions, or a torque of another kind."""
    log = table("time", "pos_{}", "vel_{}", "tau_{}" if extra else "tau_motor_{}")
    log = log.assign(**{extra.format(k): Q[:, k] + 1 for k in range(6)} if extra else {})
    with pytest.raises(BadRecording, match="positions could be" if extra else "no torque") as found:
        load(log)
    assert "\n" not in str(found.value)
    written = yaml.safe_load(str(found.value).partition("such as")[2])
    assert load(log, written).q.shape == (300, 6)
    same(load(log, {**written, "q": "pos_{0}"}))


@pytest.mark.parametrize(
    ("form", "labels"),
    [
        ("{joint}.{what}", "position velocity effort"),
        ("/joint_states/{joint}/{what}", "position velocity effort"),
        ("{what}_{joint}", "pos vel tau"),
        ("{short} {what}", "position velocity effort"),
    ],
)
def test_joints_are_matched_by_name_in_any_order(form: str, labels: str, load: Load) -> None:
    columns: dict[str, Any] = {"time": T}
    for joint, k in [(ARM.joints[k], k) for k in ORDER] + [("gripper", 0)]:
        short = joint.removesuffix("_joint")
        for what, values in zip(labels.split(), (Q, DQ, TAU), strict=True):
            columns[form.format(joint=joint, short=short, what=what)] = values[:, k]
    same(load(pd.DataFrame(columns), suffix=".parquet"))


def test_numbered_columns_follow_the_names_that_stand_beside_them(load: Load, log: Path) -> None:
    columns: dict[str, Any] = {"header.stamp.secs": 1_700_000_000 + T.astype(int)}
    columns["header.stamp.nsecs"] = np.round(T % 1 * 1e9).astype(int)
    for what, values in (("position", Q), ("velocity", DQ), ("effort", TAU)):
        columns |= {f"{what}_{j}": values[:, k] for j, k in enumerate(ORDER)}
    columns |= {f"name_{j}": ARM.joints[k] for j, k in enumerate(ORDER)}
    same(load(pd.DataFrame(columns)))
    with pytest.raises(BadRecording, match="joint 'panda_joint1' of the robot is not among them"):
        load_recording(log, load_robot("panda"))


@pytest.mark.parametrize(("separator", "decimal"), [*product(",;\t |", ".,")])
def test_separators_and_decimal_signs(separator: str, decimal: str, load: Load) -> None:
    quoted = separator == decimal  # as spreadsheets write it
    same(load(EXACT, sep=separator, decimal=decimal, quoting=int(quoted)))


def test_comments_preambles_units_and_marks_of_encoding(load: Load, log: Path) -> None:
    lines = table("t", "q{}", "dq{}", "tau{}", first=1, scale=(1e3, 180 / np.pi, 30 / np.pi, 1e3))
    text = lines.to_csv(index=False).splitlines(keepends=True)
    units = "ms," + ",".join(["deg"] * 6 + ["rpm"] * 6 + ["mNm"] * 6) + "\n"
    body = [text[0], units, *text[1:100], "# operator: pause\n", "\n", *text[100:]]
    content = "".join(["Straße 4; robot 2\n", "# rate 100 Hz\n", *body])
    for encoding in ("utf-8", "utf-8-sig", "utf-16", "cp1252"):
        log.write_text(content, encoding=encoding)
        assert "[deg]" in same(load(log)).notes[0]
    np.savetxt(log, EXACT, fmt="%.17g", header=" ".join(EXACT.columns))
    same(load(log))


def test_without_a_header_columns_are_named_by_number(load: Load) -> None:
    with pytest.raises(BadRecording, match="--map"):
        load(EXACT, header=False)
    numbers = {"t": 0, "q": [*range(1, 7)], "dq": [*range(7, 13)], "tau": [*range(13, 19)]}
    same(load(EXACT, numbers, header=False))


def stamped(name: str, stamps: Callable[[pd.Series], Any]) -> Callable[..., pd.DataFrame]:
    return lambda x: x.assign(t=stamps(x["t"])).rename(columns={"t": name})


TIMES: dict[str, Callable[..., pd.DataFrame]] = {
    "s": stamped("t", lambda t: t + 17.5),
    "ms": stamped("time_ms", lambda t: t * 1e3),
    "us": stamped("Time [µs]", lambda t: (t * 1e6).round().astype(int)),
    "ns": stamped("timestamp_ns", lambda t: (t * 1e9).round().astype(int)),
    "s since 1970": stamped("t", lambda t: t + 1.7e9),
    "ms since epoch": stamped("timestamp", lambda t: 17 * 10**11 + (t * 1e3).round().astype(int)),
    "us since epoch": stamped("timestamp", lambda t: 17 * 10**14 + (t * 1e6).round().astype(int)),
    "ns since epoch": stamped("t", lambda t: 17 * 10**17 + (t * 1e9).round().astype(int)),
    "ISO": stamped("stamp", lambda t: [f"2026-03-01T10:00:{x:09.6f}Z" for x in t]),
    "a zone": stamped("stamp", lambda t: [f"2026-03-01 10:00:{x:09.6f}+02:00" for x in t]),
    "far dates": stamped("t", lambda t: [f"9999-01-01T00:00:{x:09.6f}Z" for x in t]),
}
TYPES: dict[str, Callable[..., pd.DataFrame]] = {
    "durations": stamped("t", lambda t: pd.to_timedelta((t * 1e9).round().astype(int))),
    "dates": stamped("t", lambda t: pd.to_datetime(17 * 10**17 + (t * 1e9).round().astype(int))),
    "categories": lambda x: x.assign(q1=x["q1"].astype(str).astype("category")),
    "text": lambda x: x.astype(str),
    "nullable": lambda x: x.astype("Float64"),
    "an index": lambda x: x.set_index("t"),
}
UNUSABLE: dict[str, tuple[str, Callable[[pd.Series], Any]]] = {
    "structures": ("q1", lambda x: [{"a": v} for v in x]),
    "bytes": ("q1", lambda x: [str(v).encode() for v in x]),
    "dates for angles": ("q1", lambda x: pd.to_datetime(np.arange(len(x)))),
    "truth values": ("tau2", lambda x: x > 0),
    "no time at all": ("t", lambda x: np.nan),
}


@pytest.mark.parametrize("kind", [*TIMES, *TYPES])
def test_times_and_numbers_of_any_kind_are_read(kind: str, load: Load) -> None:
    log = (TIMES | TYPES)[kind](EXACT)
    for suffix in (".csv", ".parquet") if kind in TIMES else (".parquet",):
        found = same(load(log, suffix=suffix))
        if "epoch" in kind or kind == "dates":  # integers keep every digit
            np.testing.assert_allclose(found.t, T, atol=1e-12)


WHOLE: dict[str, Callable[..., pd.DataFrame]] = {
    "whole": stamped("t", lambda t: 17 * 10**17 + (t * 1e9).round().astype("int64")),
    "whole, nullable": stamped("t", lambda t: 17 * 10**17 + (t * 1e9).round().astype("Int64")),
    "whole, of Arrow": lambda x: WHOLE["whole"](x).convert_dtypes(dtype_backend="pyarrow"),
}


@pytest.mark.parametrize("kind", [*WHOLE, *(kind for kind in TYPES if kind != "an index")])
def test_data_frames_of_any_kind_are_read(kind: str) -> None:
    found = same(recording_from_table((WHOLE | TYPES)[kind](EXACT), ARM, file="log", name="log"))
    if kind in WHOLE:  # every digit
        np.testing.assert_allclose(found.t, T, atol=1e-12)


@pytest.mark.parametrize("dtype", ["float64", "Float64", "double[pyarrow]"])
def test_a_value_that_is_missing_is_refused(dtype: str) -> None:
    log = EXACT.astype(dtype)
    log.loc[7, "q2"] = None
    with pytest.raises(BadRecording, match="'nan' is not a finite number") as refusal:
        recording_from_table(log, ARM, file="log", name="log")
    assert (refusal.value.row, refusal.value.column) == (7, "q2")


@pytest.mark.parametrize("kind", UNUSABLE)
def test_what_is_no_number_is_refused(kind: str, load: Load) -> None:
    column, change = UNUSABLE[kind]
    with pytest.raises(BadRecording, match="is not a finite number") as refusal:
        load(EXACT.assign(**{column: change(EXACT[column])}), suffix=".parquet")
    assert (refusal.value.row, refusal.value.column) == (0, column)


def test_a_map_converts_units_signs_and_currents(load: Load) -> None:
    log = table("stamp", "p{}", "v{}", "cur_{}", scale=(1e3, 180 / np.pi, 30 / np.pi, 1e3))
    log[["p2", "v2", "cur_2", "cur_4"]] *= -1
    gains, ratios = np.arange(1, 7) / 10, np.full(6, 100)
    content = {
        "t": "stamp", "q": "p{0}", "dq": [f"v{k}" for k in range(6)], "i": "cur",
        "units": {"t": "ms", "q": "deg", "dq": "rpm", "i": "mA"},
        "sign": {"elbow_joint": -1, "tau": {"wrist_2_joint": -1}},
    }  # fmt: skip
    assert same(load(log, content)).unit == "A"
    drive = {"gain_Nm_per_A": gains.tolist(), "gear_ratio": ratios.tolist()}
    assert same(load(log, content | {"drive": drive}), TAU * gains * ratios).unit == "N·m"


BAD_MAPS: dict[str, tuple[Any, str]] = {
    "no entries": ([1], "expected entries"),
    "unknown entry": ({"qq": "a"}, "did you mean 'q'"),
    "unknown unit": ({"units": {"q": "parsec"}}, "no unit 'parsec'"),
    "unit of another quantity": ({"units": {"q": "mA"}}, "no unit 'mA'"),
    "unknown quantity": ({"units": {"torq": "Nm"}}, "unknown entry 'torq'"),
    "sign": ({"sign": {"elbow_joint": 2}}, "must be 1 or -1"),
    "unknown joint": ({"sign": {"elbow": -1}}, "unknown joint 'elbow'"),
    "missing column": ({"t": "clock"}, "is not there"),
    "too few columns": ({"q": ["q_0", "q_1"]}, "names 2 columns, the robot has 6"),
    "missing pattern": ({"q": "qq_{0}"}, "'qq_0'"),
    "both torques": ({"tau": "tau", "i": "tau"}, "keep the measured one"),
    "twice": ({"q": "tau_{0}"}, "taken for two things"),
    "gains": ({"i": "tau", "drive": {"gain_Nm_per_A": [1]}}, "drive has 1 gains"),
    "no numbers": ({"drive": {"gain_Nm_per_A": ["x"]}}, "gain_Nm_per_A[0]: expected a number"),
    "slides": ({"units": {"q": "mm"}}, "its q is not in mm"),
    "three times": ({"t": ["time", "time", "time"]}, "one column, or seconds and nanoseconds"),
    "topic": ({"topic": 3}, "topic: expected text"),
    "not closed": (b"{", "columns.yaml"),
    "not closed either": (b"a: [1", "columns.yaml"),
    "no text": (b"\xff\xfe\xfd", "columns.yaml"),
    "an object": (b"? !!python/object:x", "columns.yaml"),
}


@pytest.mark.parametrize("name", BAD_MAPS)
def test_a_bad_map_is_refused_by_what_is_wrong(name: str, load: Load) -> None:
    content, why = BAD_MAPS[name]
    with pytest.raises(ExcitantError) as refusal:
        load(PLAIN, content)
    assert why in str(refusal.value)
    assert "columns.yaml" in str(refusal.value) or "log.csv" in str(refusal.value)
    assert "\n" not in str(refusal.value)
    with pytest.raises(BadInput, match=r"nothing\.yaml"):
        load_column_map("nothing.yaml")


def test_npz_and_mat_hold_the_same_recording_or_are_refused(load: Load, tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", time=T, q=Q, qd=DQ.T, torque=TAU, robot="ur10")
    same(load(tmp_path / "a.npz"))
    arrays = {"t": T, "q": Q, "dq": DQ, "tau": TAU, "comment": "first run", "rate": 100.0}
    for form, content in (("4", arrays), ("5", {"log": arrays})):
        scipy.io.savemat(tmp_path / "a.mat", content, format=form)
        same(load(tmp_path / "a.mat"))
    for t, q, tau, why in (
        (T, Q[:-1], TAU, "is 299 × 6, but there are 300 samples"),
        (T, np.array([{}], dtype=object), TAU, "cannot be read"),
        (T[:6], Q[:6], TAU[:6], "rows or columns could be samples"),
        (T.astype(bytes), Q, TAU, "column 't': holds bytes instead of numbers"),
        (T, Q.astype(str), TAU, "column 'q': holds text instead of numbers"),
    ):
        np.savez(tmp_path / "a.npz", t=t, q=q, tau=tau)
        with pytest.raises(BadRecording, match=why):
            load(tmp_path / "a.npz")
    for start in (b"\x89HDF\r\n\x1a\n", b"MATLAB 7.3 MAT-file".ljust(512) + b"\x89HDF\r\n\x1a\n"):
        (tmp_path / "a.mat").write_bytes(start + bytes(100))
        with pytest.raises(BadRecording, match="save it with save"):
            load(tmp_path / "a.mat")


def test_a_mat_file_that_ends_its_reader_is_damaged(
    load: Load, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Some bytes make SciPy write where it must not."""
    scipy.io.savemat(tmp_path / "a.mat", {"t": T, "q": Q, "dq": DQ, "tau": TAU})
    same(load(tmp_path / "a.mat"))
    dies = "import os, signal\ndef load(*_): os.kill(os.getpid(), signal.SIGSEGV)"
    (tmp_path / "dies.py").write_text(dies)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(mat, "load", importlib.import_module("dies").load)
    with pytest.raises(BadRecording, match=r"cannot be read.*damaged"):
        load(tmp_path / "a.mat")


HAND = ["gripper", *(ARM.joints[k] for k in ORDER)]
CHANNELS = [np.column_stack([0.1 + 0 * T, x[:, ORDER]]) for x in (Q, DQ, TAU)]
Bag = Callable[..., Path]


@pytest.fixture
def bag(write_joint_states: Callable[..., None], tmp_path: Path) -> Bag:
    """``bag(kind, *topics)``: joint states with a gripper, and messages of another node."""

    def written(kind: str, *topics: str, t: np.ndarray = T, channels: Any = CHANNELS) -> Path:
        path = tmp_path / ("log.bag" if kind == "bag" else f"log{len(list(tmp_path.iterdir()))}")
        write_joint_states(path, kind, HAND, t, channels, topics=topics, hand=True)
        return path

    return written


@pytest.mark.parametrize("kind", ["bag", "mcap", "db3"])
def test_bags_are_read_by_joint_name(kind: str, load: Load, bag: Bag) -> None:
    path = bag(kind, "/joint_states", "/joint_command")
    for file in [path] if kind == "bag" else [path, next(path.glob(f"*.{kind}"))]:
        found = same(load(file))
        np.testing.assert_allclose(found.t, T, atol=1e-12)
        assert {"topic: /joint_states", "joints left out: finger, gripper"} <= set(found.notes)
    assert same(load(path, {"i": "effort", "units": {"i": "mA"}}), TAU * 1e-3).unit == "A"
    with pytest.raises(BadRecording, match="joint 'panda_joint1' of the robot is not among them"):
        load_recording(path, load_robot("panda"))


def test_bags_that_leave_a_choice_or_lack_something(load: Load, bag: Bag) -> None:
    two = bag("mcap", "/left/states", "/right/states")
    weak = bag("mcap", "/joint_states", channels=[*CHANNELS[:2], np.zeros(0)])
    for path, topic, why in (
        (two, None, "topic: /left/states"),
        (two, "/none", "states on /none; topics with them: /left"),
        (bag("mcap", "/joint_command"), None, "topic: /joint_command"),
        (weak, None, "torques of shoulder_pan_joint.*is missing"),
    ):
        with pytest.raises(BadRecording, match=why):
            load(path, ColumnMap(topic=topic))
    same(load(two, ColumnMap(topic="/right/states")))
    unstamped = same(load(bag("mcap", "/joint_states", t=-T - 1)))
    assert any("that of recording" in note for note in unstamped.notes)


def test_a_raw_recording_refuses_no_row(load: Load, save: Callable[..., Path]) -> None:
    """Speeds with holes are left out with a note, anything else is refused where it is checked."""
    rough = EXACT.astype(object).assign(temp=30.0)
    rough.loc[5, "dq3"] = np.nan
    found = load(rough)
    assert found.dq is None
    assert found.notes == ("speeds left out: row 5 holds no finite number",)
    rough["t"], rough["tau4"] = np.sort(np.random.default_rng(0).uniform(0, 3, 300)), 0.0
    rough.loc[7, "t"], rough.loc[9, "q2"] = rough.loc[6, "t"], "abc"
    raw = raw_recording(save(rough, "log.csv"), ARM)
    np.testing.assert_array_equal(raw.t, rough["t"].to_numpy(float) - rough["t"][0])
    assert raw.dq is not None
    assert np.isnan([raw.q[9, 1], raw.dq[5, 2]]).all()
    assert raw.unreadable[9, "q2"] == "abc"
    assert set(raw.extras) == {"temp"}
    assert not any(values.flags.writeable for values in (raw.q, *raw.extras.values()))


def test_damaged_rows_and_columns(load: Load, log: Path) -> None:
    """Refused by row and column; a line that was cut is left out with a note."""
    with pytest.raises(BadRecording) as refusal:
        load(pd.concat([EXACT, EXACT[["q3"]]], axis=1))
    assert refusal.value.column == "q3"
    text = EXACT.to_csv(index=False)
    lines = text.splitlines()
    for line, cells in ((lines[43].rpartition(",")[0], 18), (f"{lines[43]},1", 20)):
        log.write_text("\n".join([*lines[:43], line, *lines[44:]]) + "\n")
        with pytest.raises(BadRecording, match=f"{cells} cells where the header") as refusal:
            load(log)
        assert refusal.value.row == 42
    log.write_text(text[:-3])
    np.testing.assert_array_equal(load(log).tau, TAU[:-1])
    assert any("last line left out" in note for note in load(log).notes)


def test_a_folder_brings_its_map_and_its_drives(save: Callable[..., Path], log: Path) -> None:
    folder = log.parent
    drive = {"gain_Nm_per_A": [0.1] * 6, "gear_ratio": [50] * 6}
    (folder / "arm.urdf").write_text(ARM.urdf, encoding="utf-8")
    for name, content in {
        "robot": {"model": "arm.urdf", "drive": drive},
        "columns": {"q": "wheel_{0}", "units": {"q": "deg"}},
        "rad": {"q": "wheel_{0}"},
    }.items():
        (folder / f"{name}.yaml").write_text(yaml.safe_dump(content))
    save(table("time", "wheel_{}", "vel_{}", "actual_current_{}"), "log.csv")
    rad = {"columns": folder / "rad.yaml"}
    for dataset, names, unit in (
        (load_dataset(folder), [], np.pi / 180),
        (load_dataset(folder, **rad), [], 1.0),
        (load_dataset(folder / "robot.yaml", **rad), [str(log)], 1.0),
    ):
        [found] = dataset.recordings(names)
        np.testing.assert_allclose(found.tau, 5 * TAU)
        np.testing.assert_allclose(found.q, Q * unit, atol=1e-12)
        assert found.unit == "N·m"


def test_the_command_takes_a_map_and_shows_what_it_understood(
    excitant: Callable[..., Any], save: Callable[..., Path], log: Path
) -> None:
    columns = {"clock": T, "a": Q[:, 0], "b": Q[:, 1], "tau_0": 1.0, "tau_1": TAU[:, 1]}
    save(pd.DataFrame(columns)[:100], "log.csv")
    log.with_suffix(".yaml").write_text("{t: clock, q: [a, b], tau: 'tau_{0}'}")
    ran = excitant("identify planar_2r", log)
    assert (ran.status, "--map" in ran.err) == (1, True)
    ran = excitant("identify planar_2r", log, "--map", log.with_suffix(".yaml"))
    assert ran.status == 1
    assert "column 'clock': too short: 100 samples" in ran.err
