"""Logs of any kind and shape become the recording they hold, or are refused with what to write.

Also as other programs write them, in shapes that nobody planned for: read without a word. Where
names leave a choice, the refusal holds the map that settles it.
"""

import gzip
import importlib
import json
import re
import struct
from collections.abc import Callable, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import scipy.io
import yaml
from bags import joint_states
from known_arms import Call
from marks import refusal, refused, slow

from excitant.exceptions import BadInput, BadRecording
from excitant.identify import ColumnMap, Recording, load_column_map, load_dataset, load_recording
from excitant.identify.faults.fault import Fault, Remedy, after_repair
from excitant.identify.faults.stated import map_of
from excitant.identify.reading import mat
from excitant.identify.reading.logs import raw_recording, read_chunks, recording_from_table
from excitant.identify.reading.mapping import column_map
from excitant.robots import load_robot
from excitant.robots.virtual_arm import industrial_sensors

T = np.arange(300) / 100
RATES = np.arange(1, 7)
Q = np.sin(np.outer(T, RATES))
DQ = np.cos(np.outer(T, RATES)) * RATES
TAU = 3 * Q + DQ + RATES
ARM = load_robot("ur10")
JOINTS = ARM.joints
ORDER = sorted(range(6), key=lambda k: JOINTS[k])  # as ROS publishes them
STATES = [x[:, ORDER] for x in (Q, DQ, TAU)]
DEG = 180 / np.pi
SEC = (1_700_000_000 + T.astype(int)).tolist()
NS = np.round(T % 1 * 1e9).astype(int).tolist()
KEYS = ("position", "velocity", "effort")  # of joint states
Columns = dict[str, Any]


def named(
    time: str, forms: Sequence[str], channels: Sequence[np.ndarray] = (Q, DQ, TAU), first: int = 1
) -> Columns:
    """Columns by name, a joint after the other."""
    columns: Columns = {time: T}
    for form, values in zip(forms, channels, strict=True):
        columns |= {form.format(k + first): values[:, k] for k in range(6)}
    return columns


def table(time: str, *names: str, first: int = 0, scale: Any = (1, 1, 1, 1)) -> pd.DataFrame:
    """The motion under other names and in other units."""
    t, *channels = (x * factor for x, factor in zip((T, Q, DQ, TAU), scale, strict=True))
    return pd.DataFrame(named(time, names, channels, first) | {time: t})


EXACT = table("t", "q{}", "dq{}", "tau{}", first=1)  # names that need no guess
PLAIN = table("time", "q_{}", "qd_{}", "tau_{}")


def same(found: Recording, tau: np.ndarray = TAU, unit: str | None = None) -> Recording:
    """The recording, which must be that of the motion."""
    np.testing.assert_allclose(found.t, T, atol=1e-6)
    np.testing.assert_allclose(found.tau, tau, rtol=1e-12)
    for values, expected in ((found.q, Q), (DQ if found.dq is None else found.dq, DQ)):
        np.testing.assert_allclose(values, expected, rtol=1e-12, atol=1e-12)
    assert unit in (None, found.unit)
    return found


def text(columns: Any, separator: str = ",", decimal: str = ".") -> str:
    return pd.DataFrame(columns).to_csv(index=False, sep=separator, decimal=decimal)


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return tmp_path / "log.csv"


@pytest.fixture
def load(save: Call) -> Call:
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
def test_common_names_are_understood_and_shown(name: str, load: Call) -> None:
    """With their joints: a controller's order is not always that of the description."""
    *columns, first, unit = NAMES[name]
    found = same(load(table(*columns, first=first)))
    assert found.unit == unit
    shown = (f"{columns[1].format(k + first)} → {JOINTS[k]}" for k in range(2))
    assert found.notes == () if name == "exact" else f"q = {', '.join(shown)}, " in found.notes[0]


COMMANDED = ["target_*", "desired_*", "commanded_*", "cmd_*", "ref_*", "setpoint_*", "*_ref"]


@pytest.mark.parametrize("form", COMMANDED)
def test_what_was_commanded_is_never_taken_for_measured(form: str, load: Call) -> None:
    """Nor accelerations, temperatures and speeds of the tool for anything."""
    commanded = table("x", *(form.replace("*", w) + "_{}" for w in ("q", "qd", "moment"))) * 2
    others = table("y", "ddq_logged{}", "temperature_{}", "actual_TCP_speed_{}") * 3
    both = pd.concat([commanded, others, PLAIN], axis=1)
    same(load(both))
    for missing in ("q_", "tau_"):
        with pytest.raises(BadRecording, match="--map"):
            load(both.drop(columns=[f"{missing}{k}" for k in range(6)]))


def test_what_a_controller_feeds_back_is_no_rival_of_a_measurement(load: Call) -> None:
    log = table("time", "q_{}", "dq_{}", "tau_measured_{}")
    term = log.filter(like="tau").rename(columns=lambda c: c.replace("measured", "feedback"))
    same(load(pd.concat([log, term / 3], axis=1)))
    same(load(log.rename(columns=lambda c: c.replace("measured", "feedback"))))


@pytest.mark.parametrize("extra", ["angle_{}", "actual_pos_{}", None])
def test_an_ambiguous_guess_is_refused_with_a_map_that_settles_it(extra: Any, load: Call) -> None:
    """Two sets of positions, or a torque of another kind."""
    log = table("time", "pos_{}", "vel_{}", "tau_{}" if extra else "tau_motor_{}")
    log = log.assign(**{extra.format(k): Q[:, k] + 1 for k in range(6)} if extra else {})
    why = "positions could be" if extra else "no torque"
    said = refused(why, load, log, error=BadRecording)
    written = yaml.safe_load(said.partition("such as")[2])
    assert load(log, written).q.shape == (300, 6)
    same(load(log, {**written, "q": "pos_{0}"}))


@pytest.mark.parametrize(
    "form", ["{joint}.{what}", "/joint_states/{joint}/{what}", "{kind}_{joint}", "{short} {what}"]
)
def test_joints_are_matched_by_name_in_any_order(form: str, load: Call) -> None:
    columns: Columns = {"time": T}
    for joint, k in [(JOINTS[k], k) for k in ORDER] + [("gripper", 0)]:
        words = {"joint": joint, "short": joint.removesuffix("_joint")}
        for what, kind, x in zip(KEYS, ("pos", "vel", "tau"), (Q, DQ, TAU), strict=True):
            columns[form.format(what=what, kind=kind, **words)] = x[:, k]
    same(load(pd.DataFrame(columns), suffix=".parquet"))


@pytest.mark.parametrize(("separator", "decimal"), [*product(",;\t |", ".,")])
def test_separators_and_decimal_signs(separator: str, decimal: str, load: Call) -> None:
    quoted = separator == decimal  # as spreadsheets write it
    same(load(EXACT, sep=separator, decimal=decimal, quoting=int(quoted)))


@pytest.mark.parametrize("form", ["{} {}", "[{}, {}]", "({},{})", "[{} {}]"])
def test_numbers_of_all_joints_in_a_cell(form: str, load: Call) -> None:
    start, between, end = form.split("{}")  # as arrays are printed
    columns: Columns = {"t": T}
    for name, x in zip(KEYS, (Q, DQ, TAU), strict=True):
        columns[name] = [start + between.join(map(repr, row.tolist())) + end for row in x]
    same(load(pd.DataFrame(columns)))


def test_comments_preambles_units_and_marks_of_encoding(load: Call, log: Path) -> None:
    """Units stand in a row of their own, as data loggers export."""
    scaled = table("t", "q{}", "dq{}", "tau{}", first=1, scale=(1e3, DEG, 30 / np.pi, 1e3))
    rows = text(scaled).splitlines(keepends=True)
    units = ["ms", *["deg"] * 6, *["rpm"] * 6, *["mNm"] * 6]
    for start, form in product(("Straße 4; robot 2\n# rate 100 Hz\n", ""), ("{}", "[{}]")):
        second = ",".join(map(form.format, units)) + "\n"
        body = [rows[0], second, *rows[1:100], "# operator: pause\n", "\n", *rows[100:]]
        for encoding in ("utf-8", "utf-8-sig", "utf-16", "cp1252"):
            log.write_text(start + "".join(body), encoding=encoding)
            assert "[deg]" in same(load(log)).notes[0]
    np.savetxt(log, EXACT, fmt="%.17g", header=" ".join(EXACT.columns))
    same(load(log))


def stamped(name: str, stamps: Callable[[pd.Series], Any]) -> Call:
    return lambda x: x.assign(t=stamps(x["t"])).rename(columns={"t": name})


TIMES: dict[str, Call] = {
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
TYPES: dict[str, Call] = {
    "durations": stamped("t", lambda t: pd.to_timedelta((t * 1e9).round().astype(int))),
    "dates": stamped("t", lambda t: pd.to_datetime(17 * 10**17 + (t * 1e9).round().astype(int))),
    "categories": lambda x: x.assign(q1=x["q1"].astype(str).astype("category")),
    "text": lambda x: x.astype(str),
    "nullable": lambda x: x.astype("Float64"),
    "an index": lambda x: x.set_index("t"),
    "whole": stamped("t", lambda t: 17 * 10**17 + (t * 1e9).round().astype("int64")),
    "whole, nullable": stamped("t", lambda t: 17 * 10**17 + (t * 1e9).round().astype("Int64")),
    "whole, of Arrow": lambda x: TYPES["whole"](x).convert_dtypes(dtype_backend="pyarrow"),
}
UNUSABLE: dict[str, tuple[str, Callable[[pd.Series], Any]]] = {
    "structures": ("q1", lambda x: [{"a": v} for v in x]),
    "bytes": ("q1", lambda x: [str(v).encode() for v in x]),
    "dates for angles": ("q1", lambda x: pd.to_datetime(np.arange(len(x)))),
    "truth values": ("tau2", lambda x: x > 0),
    "no time at all": ("t", lambda x: np.nan),
}


@pytest.mark.parametrize("kind", [*TIMES, *TYPES])
def test_times_and_numbers_of_any_kind_are_read(kind: str, load: Call) -> None:
    """From files, and from data frames."""
    log = (TIMES | TYPES)[kind](EXACT)
    found = [load(log, suffix=suffix) for suffix in (".csv", ".parquet")[kind in TYPES :]]
    if kind in TYPES and kind != "an index":
        found.append(recording_from_table(log, ARM, file="log", name="log"))
    for each in map(same, found):
        if re.search("epoch|^dates|whole", kind):  # integers keep every digit
            np.testing.assert_allclose(each.t, T, atol=1e-12)


@pytest.mark.parametrize("dtype", ["float64", "Float64", "double[pyarrow]"])
def test_a_value_that_is_missing_is_refused(dtype: str) -> None:
    log = EXACT.astype(dtype)
    log.loc[7, "q2"] = None
    with pytest.raises(BadRecording, match="'nan' is not a finite number") as refusal:
        recording_from_table(log, ARM, file="log", name="log")
    assert (refusal.value.row, refusal.value.column) == (7, "q2")


@pytest.mark.parametrize("kind", UNUSABLE)
def test_what_is_no_number_is_refused(kind: str, load: Call) -> None:
    column, change = UNUSABLE[kind]
    with pytest.raises(BadRecording, match="is not a finite number") as refusal:
        load(EXACT.assign(**{column: change(EXACT[column])}), suffix=".parquet")
    assert (refusal.value.row, refusal.value.column) == (0, column)


@pytest.mark.parametrize("column", ["q1", "tau1"])
def test_numbers_that_no_sensor_gives_are_refused(column: str, load: Call) -> None:
    """What single precision cannot hold: beyond it no number, below it no signal."""
    with pytest.raises(BadRecording, match=r"e\+298' is not a finite number"):
        load(EXACT.assign(**{column: 1e298 * (1.0 + T)}), suffix=".csv")
    assert not load(EXACT.assign(q1=1e-320 * T), suffix=".csv").q[:, 0].any()


def test_a_line_of_digits_is_refused_at_once(tmp_path: Path) -> None:
    """Time to read it grows with its length, not with the square of it: 1e4 s else."""
    (tmp_path / "log.csv").write_text("1" * 1_000_000)
    refused("no row of numbers", load_recording, tmp_path / "log.csv", ARM, error=BadRecording)


def read_as(q: np.ndarray, dq: np.ndarray, tau: np.ndarray, *names: str) -> pd.DataFrame:
    """The log with these values, its last columns under other names."""
    log = pd.DataFrame(np.column_stack([T, q, dq, tau]), columns=EXACT.columns)
    return log.set_axis([*log.columns[: 19 - len(names)], *names], axis=1)


WRISTS = np.eye(6)
WRISTS[5, 4] = 1  # the last axis is read with the one before
COUPLED = Q @ WRISTS.T, DQ @ WRISTS.T, TAU @ np.linalg.inv(WRISTS)
OTHER = {"wrist_3_joint": {"wrist_2_joint": 1}}
IN_DEG = {f"q{k}": f"q{k} [deg]" for k in RATES}
ELBOW = np.where(RATES == 3, DEG, 1)
TURNED = np.where(RATES == 3, -1, 1)
READ_AS: dict[str, tuple[pd.DataFrame, Columns]] = {
    "patterns": (
        table("stamp", "p{}", "v{}", "cur_{}", scale=(1e3, DEG, 30 / np.pi, 1e3)),
        {"t": "stamp", "q": "p{0}", "dq": [f"v{k}" for k in range(6)], "i": "cur"}
        | {"units": {"t": "ms", "q": "deg", "dq": "rpm", "i": "mA"}},
    ),
    "drives": (
        read_as(Q, DQ, TAU / (5 * RATES)),
        {"i": "tau", "drive": {"gain_Nm_per_A": (RATES / 10).tolist(), "gear_ratio": [50] * 6}},
    ),
    "signs": (
        read_as(Q * TURNED, DQ * TURNED, TAU * TURNED * np.where(RATES == 5, -1, 1)),
        {"sign": {"elbow_joint": -1, "tau": {"wrist_2_joint": -1}}},
    ),
    "counts": (read_as(Q * 500 + 2048, DQ, TAU), {"units": {"q": 2e-3}, "offset": {"q": -2048}}),
    "a zero": (read_as(Q + ELBOW - 1, DQ, TAU), {"offset": {"q": {"elbow_joint": 1 - DEG}}}),
    "offsets": (read_as(Q, DQ, TAU - RATES), {"offset": {"tau": RATES.tolist()}}),
    "a joint": (read_as(Q, DQ * ELBOW, TAU), {"units": {"dq": {"elbow_joint": "deg/s"}}}),
    "coupled axes": (read_as(*COUPLED), {"coupling": OTHER}),
    "coupled positions": (read_as(*COUPLED[:2], TAU), {"coupling": {"q": OTHER, "dq": OTHER}}),
    "no time": (EXACT.drop(columns="t"), {"rate": 100}),
    "one name": (read_as(Q, DQ, TAU, *["x"] * 6), {"tau": [*range(13, 19)]}),
    "q [deg]": (read_as(Q * DEG, DQ, TAU).rename(columns=IN_DEG), {"q": "q{1} [deg]"}),
    "time [h]": (EXACT.rename(columns={"t": "x [h]"}) / [3600, *[1] * 18], {"t": 0}),
}
UNMAPPED = {"no time": r"the rate of the rows \[Hz\].*rate: 100", "one name": r"13 \(x\), 14 \(x\)"}


@pytest.mark.parametrize("name", READ_AS)
def test_a_map_says_how_a_log_relates_to_the_model(name: str, load: Call, log: Path) -> None:
    """Whole, and in pieces."""
    frame, content = READ_AS[name]
    log.write_text(text(frame))
    same(load(log, content))
    parts = [*read_chunks(log, ARM, 70, mapping=load_column_map(log.with_name("columns.yaml")))]
    np.testing.assert_allclose(np.concatenate([part.t for part in parts]), T, atol=1e-6)
    np.testing.assert_allclose(np.vstack([part.tau for part in parts]), TAU)
    if name in UNMAPPED:
        refused(UNMAPPED[name], load, log, error=BadRecording)


def remedies(action: str, factor: float, joints: Sequence[int], *channels: str) -> list[Remedy]:
    return [Remedy(action, name, tuple(joints), factor=factor) for name in channels]


REPAIRS: dict[str, list[Remedy]] = {  # by the map that states it, where the log needed none
    "q: [q2, q1,": remedies("order", 1, (1, 0, 2, 3, 4, 5), "q", "dq", "tau"),
    "{sign: {elbow_joint: -1}}": remedies("scale", -1, [2], "q", "dq", "tau"),
    "{units: {q: deg, dq: deg/s}}": remedies("scale", 1 / DEG, range(6), "q", "dq"),
    "{units: {tau: {elbow_joint: 0.3}}}": remedies("scale", 0.3, [2], "tau"),
    "{coupling: {wrist_3_joint: {wrist_2_joint: 1}}}": [
        *remedies("add", -1, (5, 4), "q", "dq"), *remedies("add", 1, (4, 5), "tau")
    ],
    "{q: {elbow_joint: {wrist_1_joint: -0.5": remedies("add", 0.5, (2, 3), "q", "dq"),
    "{units: {t: ms}}": remedies("scale", 1e-3, (), "t"),
}  # fmt: skip
GIVEN: tuple[Columns, ...] = (
    {},
    {"units": {"q": "deg", "tau": RATES.tolist()}, "offset": {"q": 3, "dq": {"elbow_joint": 0.1}},
     "sign": {"q": {"elbow_joint": -1}}, "coupling": OTHER},
    {"rate": 100, "i": [f"tau{k}" for k in RATES], "drive": {"gain_Nm_per_A": RATES.tolist()}},
)  # fmt: skip


@pytest.mark.parametrize("said", REPAIRS)
@pytest.mark.parametrize("given", GIVEN)
def test_a_map_states_what_a_repair_does(given: Columns, said: str, load: Call, log: Path) -> None:
    """Whatever map the log was read with."""
    log.write_text(text(EXACT.drop(columns=["t"] if "rate" in given else [])))
    found = load(log, given)
    stated = map_of(ARM, found.read, REPAIRS[said]) or ""
    assert said in stated or given
    new = yaml.safe_load(stated)
    new |= {k: x | new[k] for k, x in given.items() if k in new and isinstance(x, dict)}
    again = raw_recording(log, ARM, column_map(given | new, "columns.yaml"))
    fault = Fault("", (), "", {}, "", tuple(REPAIRS[said]))
    expected, _ = after_repair(found, [fault])
    for name, values in (("t", expected.t), *expected.channels()):
        np.testing.assert_allclose(getattr(again, name), values, rtol=1e-6, atol=1e-9)
    assert map_of(ARM, found.read, remedies("drop", 1, [], "")) is None


BAD_MAPS: dict[str, tuple[Any, str]] = {
    "no entries": ([1], "expected entries"),
    "unknown entry": ({"qq": "a"}, "did you mean 'q'"),
    "unknown unit": ({"units": {"q": "parsec"}}, "no unit 'parsec'"),
    "unit of another quantity": ({"units": {"q": "mA"}}, "no unit 'mA'"),
    "unknown quantity": ({"units": {"torq": "Nm"}}, "unknown entry 'torq'"),
    "sign": ({"sign": {"elbow_joint": 2}}, "must be 1 or -1"),
    "unknown joint": ({"sign": {"elbow": -1}}, "unknown joint 'elbow'"),
    "unit of no joint": ({"units": {"q": {"elbow": "deg"}}}, "units of q: unknown joint 'elbow'"),
    "offset of no joint": ({"offset": {"q": {"elbow": 1}}}, "offset of q: unknown joint 'elbow'"),
    "two offsets": ({"offset": {"q": [1, 2]}}, "offset of q: 2 given, the robot has 6 joints"),
    "offset of currents": ({"offset": {"i": 1}}, "offset of i, but the log has tau"),
    "coupled to none": ({"coupling": {JOINTS[0]: {"x": 1}}}, "coupling: unknown joint 'x'"),
    "coupling": ({"coupling": {"q": {JOINTS[0]: 1}}}, f"'{JOINTS[0]}' must be {{joint: number}}"),
    "all one": ({"coupling": {JOINTS[0]: {JOINTS[0]: 0}}}, "do not determine the joints"),
    "rate": ({"rate": 0}, "rate: expected"),
    "rate and time": ({"rate": 10, "t": "time"}, "both 't' and 'rate'"),
    "no such number": ({"q": [1, 2, 3, 4, 5, 19]}, "'19': is not there"),
    "missing column": ({"t": "clock"}, "is not there"),
    "too few columns": ({"q": ["q_0", "q_1"]}, "names 2 columns, the robot has 6"),
    "missing pattern": ({"q": "qq_{0}"}, "'qq_0'"),
    "both torques": ({"tau": "tau", "i": "tau"}, "keep the measured one"),
    "twice": ({"q": "tau_{0}"}, "taken for two things"),
    "gains": ({"i": "tau", "drive": {"gain_Nm_per_A": [1]}}, "drive: 1 given, the robot has 6"),
    "no numbers": ({"drive": {"gain_Nm_per_A": ["x"]}}, "gain_Nm_per_A[0]: expected a number"),
    "slides": ({"units": {"q": "mm"}}, "its q is not in mm"),
    "three times": ({"t": ["time", "time", "time"]}, "one column, or seconds and nanoseconds"),
    "topic": ({"topic": 3}, "topic: expected text"),
    "not closed": (b"{", "columns.yaml"),
    "no text": (b"\xff\xfe\xfd", "columns.yaml"),
    "an object": (b"? !!python/object:x", "columns.yaml"),
}


@pytest.mark.parametrize("name", BAD_MAPS)
def test_a_bad_map_is_refused_by_what_is_wrong(name: str, load: Call) -> None:
    content, why = BAD_MAPS[name]
    said = refused(re.escape(why), load, PLAIN, content)
    assert "columns.yaml" in said or "log.csv" in said
    refused(r"nothing\.yaml", load_column_map, "nothing.yaml", error=BadInput)


def lines(records: Sequence[Any]) -> str:
    return "\n".join(json.dumps(record) for record in records)


def rostopic() -> str:
    """``rostopic echo -p``."""
    stamp = (17 * 10**17 + np.round(T * 1e9)).astype(int)
    columns: Columns = {"%time": stamp + 5, "field.header.seq": range(300)}
    columns |= {"field.header.stamp": stamp, "field.header.frame_id": ""}
    columns |= {f"field.name{k}": JOINTS[j] for k, j in enumerate(ORDER)}
    for what, values in zip(KEYS, STATES, strict=True):
        columns |= {f"field.{what}{k}": values[:, k] for k in range(6)}
    return text(columns)


def ros2_topic(frame: str = "base_link") -> str:
    """``ros2 topic echo --csv``: no line of names."""
    names = ",".join(JOINTS[j] for j in ORDER)
    rows = zip(SEC, NS, np.hstack(STATES).tolist(), strict=True)
    return "".join(f"{s},{n},{frame},{names},{','.join(map(repr, x))}\n" for s, n, x in rows)


def libfranka() -> str:
    """The log that libfranka writes after an error, in milliseconds, with what was commanded."""
    forms = ("q", "q_d", "dq", "dq_d", "tau_J", "tau_ext_hat_filtered")
    channels = (Q, Q + 1, DQ, DQ + 1, TAU, TAU / 9)
    states = named("time", [f"state.{name}[{{}}]" for name in forms], channels, 0)
    sent = named("time", [f"cmd.{name}[{{}}]" for name in ("q_d", "tau_J_d")], (Q, DQ), 0)
    return text(states | sent | {"time": np.round(T * 1e3).astype(int), "success_rate": 1.0})


def kuka() -> str:
    """KUKA's Sunrise data recorder: the name of the arm in every column, time in two."""
    arm = "LBR_iiwa_7_R800_1[{}]"
    columns = named("t", (f"axisQMsr_{arm}", f"axisTauMsr_{arm}"), (Q, TAU), 0)
    del columns["t"]
    return text({"ZeitInSec": SEC, "ZeitInNanoSec": NS} | columns, " ")


def plotted() -> str:
    """An export of a plotting program: topics in front, one of two arms that are called alike."""
    columns: Columns = {"__time": T + 1.7e9}
    for what, values in zip(KEYS, (Q, DQ, TAU), strict=True):
        paths = (f"/left/joint_states/left_{joint}/{what}" for joint in JOINTS)
        columns |= dict(zip(paths, values.T, strict=True))
    return text(columns)


def dated(form: str, separator: str = ",") -> str:
    columns = named("timestamp", ("joint{}_pos", "joint{}_vel", "joint{}_eff"))
    return text(columns | {"timestamp": [form.format(t) for t in T]}, separator)


GERMAN = ("Achse {} Istposition [rad]", "Achse {} Drehzahl [rad/s]", "Drehmoment {} [Nm]")
BENCH = text(named("Zeit [s]", GERMAN), ";", ",")
JOINT_STATES = [
    {"header": {"stamp": {"sec": s, "nanosec": n}, "frame_id": ""}}
    | {"name": [JOINTS[j] for j in ORDER]}
    | dict(zip(KEYS, values, strict=True))
    for s, n, *values in zip(SEC, NS, *(x.tolist() for x in STATES), strict=True)
]
BY_JOINT = [{"pos": Q[:, k], "vel": DQ[:, k], "torque": TAU[:, k]} for k in range(6)]
STRUCT = {"log": {"t": T, "joints": BY_JOINT}}
LISTS = {"ts": T, "joint_pos": Q, "joint_vel": DQ, "joint_eff": TAU}
CELLS = {k: list(x) for k, x in LISTS.items()}
SHAPES: dict[str, tuple[str, Any]] = {  # a file, and what it holds or what writes it
    "semicolons, decimal commas": ("log.csv", f"Prüfstand 3\n{BENCH}".encode("cp1252")),
    "UTF-16 of a spreadsheet": ("log.txt", text(PLAIN, "\t").encode("utf-16")),
    "dates, day first": ("log.csv", dated("31.03.2026 10:00:{:09.6f}", ";")),
    "dates, month first": ("log.csv", dated("03/31/2026 10:00:{:09.6f}")),
    "time of day": ("log.csv", dated("10:00:{:09.6f}")),
    "rostopic echo -p": ("log.csv", rostopic()),
    "ros2 topic echo --csv": ("log.csv", ros2_topic()),
    "the same without a frame": ("log.csv", ros2_topic("")),
    "libfranka": ("log.csv", libfranka()),
    "Sunrise": ("log.log", kuka()),
    "topics and an arm in front": ("log.csv", plotted()),
    "axes": ("log.csv", text(named("Time", ("A{}_pos", "A{}_vel", "A{}_motor_current")))),
    "gzip": ("log.csv.gz", gzip.compress(text(EXACT).encode())),
    "JSON lines of joint states": ("log.jsonl", lines(JOINT_STATES)),
    "JSON, a list of records": ("log.json", json.dumps(JOINT_STATES)),
    "JSON, lists by name": ("log.json", json.dumps({k: x.tolist() for k, x in LISTS.items()})),
    "JSON, records and more": ("log.json", json.dumps({"mass": 2, "entries": JOINT_STATES})),
    "arrays by samples": ("log.npz", lambda path: np.savez(path, **LISTS, phase_name=["a"] * 300)),
    "arrays by joints": ("log.npz", lambda p: np.savez(p, **{k: x.T for k, x in LISTS.items()})),
    "a struct": ("log.mat", lambda path: scipy.io.savemat(path, {"log": LISTS})),
    "a struct for each joint": ("log.mat", lambda path: scipy.io.savemat(path, STRUCT)),
    "lists in Parquet": ("log.parquet", lambda path: pd.DataFrame(CELLS).to_parquet(path)),
}  # fmt: skip


@pytest.mark.parametrize("shape", SHAPES)
def test_logs_of_any_shape_are_read_without_a_word(shape: str, tmp_path: Path) -> None:
    name, content = SHAPES[shape]
    if callable(content):
        content(tmp_path / name)
    else:
        (tmp_path / name).write_bytes(content.encode() if isinstance(content, str) else content)
    found = load_recording(tmp_path / name, ARM)
    same(found, unit="A" if shape == "axes" else "N·m")


@pytest.mark.parametrize("separator", [" ", ","])
@pytest.mark.parametrize("channels", [(Q, DQ, TAU), (Q, TAU)])
def test_numbers_without_names_are_refused_with_a_map_for_them(separator, channels, load, log):
    np.savetxt(log, np.column_stack([T, *channels]), fmt="%.17g", delimiter=separator)
    said = refused("--map", load, log, error=BadRecording)
    same(load(log, yaml.safe_load(said.partition("such as ")[2])), unit="N·m")


@pytest.mark.parametrize(("other", "why"), [("left", "positions could be"), ("motor", None)])
def test_words_before_joints_name_an_arm_but_not_its_motors(other, why, load, log):
    """Of two arms the user says which; motors turn otherwise than joints."""
    words = ("q", "dq", "tau")
    arm, extra = (named("t", [f"{x}_{y}_{{}}" for y in words]) for x in ("right", other))
    log.write_text(text(arm | extra))
    if why is None:
        same(load(log), unit="N·m")
        log.write_text(text(extra))
    refused(why or "no torque", load, log, error=BadRecording)


FORMS = ("pos_{}", "vel_{}", "tau_{}")
BY_NAME = {f"{joint}_{what}": 0.0 for joint in JOINTS for what in ("angle", "position", "torque")}
REFUSED: dict[str, tuple[str, str]] = {
    "no torque": ("log.csv", text(named("t", FORMS[:2], (Q, DQ)))),
    "no position": ("log.csv", text(named("t", FORMS[2:], (TAU,)))),
    "no time": ("log.csv", text(named("sample", FORMS))),
    "two positions": ("log.csv", text(named("t", (*FORMS, "angle_{}"), (Q, DQ, TAU, Q)))),
    "two by name": ("log.csv", text({"t": T} | BY_NAME)),
    "another arm": ("log.csv", text({k: x for k, x in named("t", FORMS).items() if "6" not in k})),
    "no names": ("log.dat", text(named("t", FORMS)).partition("\n")[2]),
    "no numbers": ("log.csv", "a,b,c\n"),
    "another format": ("log.xlsx", "PK"),
    "no record": ("log.json", "{}"),
    "text for a number": ("log.csv", text(named("t", FORMS)).replace("0.01,", "late,", 1)),
    "a short row": ("log.csv", text(named("t", FORMS)) + "1,2\n"),
}


@pytest.mark.parametrize("shape", REFUSED)
def test_a_refusal_is_short_and_says_the_path_once(shape: str, tmp_path: Path) -> None:
    name, content = REFUSED[shape]
    (tmp_path / name).write_text(content)
    said = refused(".", load_recording, tmp_path / name, ARM, error=BadRecording)
    assert said.count(str(tmp_path)) == 1
    assert len(said.replace(str(tmp_path), "")) < 200, said


def test_damaged_json_is_refused_by_row(tmp_path: Path) -> None:
    path = tmp_path / "log.jsonl"
    less = {k: x for k, x in JOINT_STATES[7].items() if k != "effort"}
    short = JOINT_STATES[7] | {"effort": [1.0]}
    for changed, why in ((less, "'effort', row 7: is missing"), (short, "cannot be read")):
        path.write_text(lines([*JOINT_STATES[:7], changed, *JOINT_STATES[8:]]))
        refused(why, load_recording, path, ARM, error=BadRecording)
    for broken in ("", "[]", "3", '{"t": 1', "[1, 2]"):
        path.write_text(broken)
        refused(".", load_recording, path, ARM, error=BadRecording)


def test_npz_and_mat_hold_the_same_recording_or_are_refused(load: Call, tmp_path: Path) -> None:
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
        refused(why, load, tmp_path / "a.npz", error=BadRecording)
    for start in (b"\x89HDF\r\n\x1a\n", b"MATLAB 7.3 MAT-file".ljust(512) + b"\x89HDF\r\n\x1a\n"):
        (tmp_path / "a.mat").write_bytes(start + bytes(100))
        refused("save it with save", load, tmp_path / "a.mat", error=BadRecording)


def test_a_mat_file_may_hold_an_object_or_end_its_reader(load, tmp_path, monkeypatch):
    """As ``begun = datetime``, of which SciPy does not read the header, or by some bytes."""

    def element(kind: int, content: bytes) -> bytes:
        return struct.pack("<II", kind, len(content)) + content + bytes(-len(content) % 8)

    names = b"".join(element(1, name) for name in (b"begun", b"MCOS", b"datetime"))
    size = element(6, struct.pack("<II", 13, 0)) + element(5, struct.pack("<ii", 6, 1))
    handle = element(14, size + element(1, b"") + element(6, struct.pack("<6I", *[1] * 6)))
    found = element(14, element(6, struct.pack("<II", 17, 0)) + names + handle)
    scipy.io.savemat(tmp_path / "a.mat", {"t": T, "q": Q, "dq": DQ, "tau": TAU})
    with open(tmp_path / "a.mat", "ab") as file:
        file.write(found)
    same(load(tmp_path / "a.mat"))
    dies = "import os, signal\ndef load(*_): os.kill(os.getpid(), signal.SIGSEGV)"
    (tmp_path / "dies.py").write_text(dies)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(mat, "load", importlib.import_module("dies").load)
    refused(r"cannot be read.*damaged", load, tmp_path / "a.mat", error=BadRecording)


@pytest.fixture
def bag(tmp_path: Path) -> Call:
    """``bag(kind, *topics)``: joint states with a gripper, and messages of another node."""

    def written(
        kind: str, *topics: str, prefix: str = "", t: Any = T, states: Any = STATES, **more: Any
    ) -> Path:
        path = tmp_path / f"log{len(list(tmp_path.iterdir()))}{'.bag' * (kind == 'bag')}"
        names = [prefix + name for name in ("gripper", *(JOINTS[k] for k in ORDER))]
        channels = [np.column_stack([0.1 + 0 * T, x]) if len(x) else x for x in states]
        topics = topics or ("/joint_states",)
        joint_states(path, kind, names, t, channels, topics=topics, hand=True, **more)
        return path

    return written


@pytest.mark.parametrize("prefix", [slow(""), "left_arm/", slow("ur10_")])
@pytest.mark.parametrize("kind", ["bag", "mcap", "db3"])
def test_bags_are_read_by_joint_name_whatever_stands_before(kind, prefix, load, bag):
    path = bag(kind, "/joint_states", "/joint_command", prefix=prefix)
    for file in [path] if kind == "bag" else [path, next(path.glob(f"*.{kind}"))]:
        found = same(load(file), unit="N·m")
        np.testing.assert_allclose(found.t, T, atol=1e-12)
        notes = {"topic: /joint_states", f"joints left out: finger, {prefix}gripper"}
        assert notes <= set(found.notes)
        assert any(f"'{prefix}'" in note for note in found.notes) == bool(prefix)
    same(load(path, {"i": "effort", "units": {"i": "mA"}}), TAU * 1e-3, "A")
    with pytest.raises(BadRecording, match="joint 'panda_joint1' of the robot is not among them"):
        load_recording(path, load_robot("panda"))


def test_bags_that_leave_a_choice_or_lack_something(load: Call, bag: Call) -> None:
    two = bag("mcap", "/left/states", "/right/states")
    weak = bag("mcap", "/joint_states", states=[*STATES[:2], np.zeros(0)])
    for path, topic, why in (
        (two, None, "topic: /left/states"),
        (two, "/none", "states on /none; topics with them: /left"),
        (bag("mcap", "/joint_command"), None, "topic: /joint_command"),
        (weak, None, "torques of shoulder_pan_joint.*is missing"),
    ):
        refused(why, load, path, ColumnMap(topic=topic), error=BadRecording)
    same(load(two, ColumnMap(topic="/right/states")))
    unstamped = same(load(bag("mcap", "/joint_states", t=-T - 1)))
    assert any("that of recording" in note for note in unstamped.notes)


def test_the_robot_may_have_the_prefix_and_two_that_fit_are_refused(load: Call, bag: Call) -> None:
    other = ARM.urdf
    for joint in JOINTS:
        other = other.replace(f'"{joint}"', f'"ur10_{joint}"')
    path = bag("mcap")
    (path.parent / "arm.urdf").write_text(other)
    same(load_recording(path, load_robot(path.parent / "arm.urdf")), unit="N·m")
    two = bag("mcap", prefix="a_", other="b_")
    refused("holds the joints a_", load, two, error=BadRecording)
    same(load(two, {"q": "b_{joint}.position", "tau": "b_{joint}.effort"}), unit="N·m")


def test_a_bag_brings_its_robot_and_limits(bag: Call) -> None:
    ends = '<parent link="tool0"/><child link="tip"/>'
    ends += '<limit lower="0" upper="1" effort="1" velocity="1"/>'
    jaw = f'<joint name="jaw" type="prismatic">{ends}</joint>'
    urdf = ARM.urdf.replace("</robot>", f'<link name="tip"/>{jaw}</robot>')
    elbow = {"has_velocity_limits": True, "max_velocity": 1.25}
    limits = yaml.safe_dump({"joint_limits": {"elbow_joint": elbow}})
    path = bag("mcap", texts={"robot_description": urdf, "joint_limits": limits})
    for spec, names in ((path, []), (path.parent, []), (path.parent, [path.name])):
        dataset = load_dataset(spec)
        assert dataset.robot.joints == JOINTS
        assert any("held at 0" in n and "jaw" in n for n in dataset.robot.notes)
        assert dataset.robot.limits.velocity[2] == 1.25
        same(*dataset.recordings(names), unit="N·m")
    path = bag("mcap")
    refused("no robot_description in this bag; give ROBOT", load_dataset, path, error=BadInput)
    same(*load_dataset("ur10").recordings([str(path)]), unit="N·m")


@pytest.mark.slow
def test_a_bag_alone_is_enough_for_a_verdict(runs, planar, excitant, tmp_path):
    sensors = industrial_sensors(planar)
    [run] = runs(planar, 1, sensors=sensors, tolerance=0.03, duration=16.0, names=["run"])
    path, names = tmp_path / "bag", ["left/joint2", "left/joint1"]
    channels = [x[:, ::-1] for x in (run.q, run.dq, run.tau)]
    texts = {"robot_description": planar.urdf}
    joint_states(path, "mcap", names, run.t, channels, texts=texts)
    ran = excitant("go", path, "-o", tmp_path / "out")
    assert ran.status == 0
    assert ran.err.count("'left/' is taken off the names") == 1
    assert re.search("^verdict .*\n.*\n +(Use extended|Use model|Keep)", ran.out)


def test_a_raw_recording_refuses_no_row(load: Call, save: Call) -> None:
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


def test_damaged_rows_and_columns(load: Call, log: Path) -> None:
    """Refused by row and column; a line that was cut is left out with a note."""
    twice = pd.concat([EXACT, EXACT[["q3"]]], axis=1)
    assert refusal(".", load, twice, error=BadRecording).column == "q3"
    text = EXACT.to_csv(index=False)
    lines = text.splitlines()
    for line, cells in ((lines[43].rpartition(",")[0], 18), (f"{lines[43]},1", 20)):
        log.write_text("\n".join([*lines[:43], line, *lines[44:]]) + "\n")
        assert refusal(f"{cells} cells where the header", load, log, error=BadRecording).row == 42
    log.write_text(text[:-3])
    np.testing.assert_array_equal(load(log).tau, TAU[:-1])
    assert any("last line left out" in note for note in load(log).notes)


def test_a_folder_brings_its_map_and_its_drives(save: Call, log: Path) -> None:
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


@pytest.mark.parametrize("form", ["{}", "q{}"])
def test_files_of_a_quantity_each_are_one_recording(form: str, tmp_path: Path) -> None:
    folder = tmp_path / "run1"
    folder.mkdir()
    stems = {"positions_deg": Q * DEG, "velocities": DQ, "efforts": TAU}
    for stem, values in stems.items():
        columns = {form.format(JOINTS[k] if form == "{}" else k + 1): values[:, k] for k in ORDER}
        pd.DataFrame({"t": T} | columns).to_csv(folder / f"{stem}.csv")
    assert same(*load_dataset("ur10").recordings([str(folder)])).dq is not None
    pd.DataFrame({"t": T + 0.001, "q1": T}).to_csv(folder / "efforts.csv")
    why = "positions_deg.csv, column 't': differs from that of efforts"
    refusal(why, load_dataset("ur10").recordings, [str(folder)])


def test_the_command_takes_a_map_and_shows_what_it_understood(excitant, save, log):
    columns = {"clock": T, "a": Q[:, 0], "b": Q[:, 1], "tau_0": 1.0, "tau_1": TAU[:, 1]}
    save(pd.DataFrame(columns)[:100], "log.csv")
    log.with_suffix(".yaml").write_text("{t: clock, q: [a, b], tau: 'tau_{0}'}")
    ran = excitant("identify planar_2r", log)
    assert (ran.status, "--map" in ran.err) == (1, True)
    ran = excitant("identify planar_2r", log, "--map", log.with_suffix(".yaml"))
    assert (ran.status, "column 'clock': too short: 100 samples" in ran.err) == (1, True)
