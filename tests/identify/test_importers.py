"""Logs of any kind become the recording they hold, or are refused with what to write."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import scipy.io
import yaml

from excitant.cli import main
from excitant.exceptions import BadInput, BadRecording, ExcitantError
from excitant.identify import (
    ColumnMap,
    load_column_map,
    load_dataset,
    load_recording,
    raw_recording,
)
from excitant.identify.importers.names import column_map, meaning
from excitant.robots import Robot, load_robot

T = np.arange(300) / 100
_RATES = np.arange(1, 7)
Q = np.sin(np.outer(T, _RATES))
DQ = np.cos(np.outer(T, _RATES)) * _RATES
TAU = 3 * Q + DQ + _RATES


def table(
    t: str, q: str, dq: str, tau: str, *, first: int = 0, scale: Sequence[float] = (1, 1, 1, 1)
) -> pd.DataFrame:
    """The motion under other names and in other units."""
    columns: dict[str, Any] = {t: T * scale[0]}
    for pattern, values, factor in ((q, Q, scale[1]), (dq, DQ, scale[2]), (tau, TAU, scale[3])):
        columns |= {pattern.format(k + first): values[:, k] * factor for k in range(6)}
    return pd.DataFrame(columns)


def exact() -> pd.DataFrame:
    """The motion under the names that need no guess."""
    return table("t", "q{}", "dq{}", "tau{}", first=1)


def assert_read(path: Path, robot: Robot, *, tau: np.ndarray = TAU, **options: Any) -> Any:
    recording = load_recording(path, robot, **options)
    np.testing.assert_allclose(recording.t, T, atol=1e-6)
    for found, expected in ((recording.q, Q), (recording.dq, DQ), (recording.tau, tau)):
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)
    return recording


def write_yaml(path: Path, content: object) -> ColumnMap:
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return load_column_map(path)


Save = Callable[..., Path]


@pytest.fixture
def save(tmp_path: Path) -> Save:
    """``save(log, suffix)``: the file of a log."""

    def saved(log: pd.DataFrame, suffix: str = ".csv", **options: Any) -> Path:
        path = tmp_path / f"log{suffix}"
        if suffix == ".csv":
            log.to_csv(path, **{"index": False, **options})
        else:
            log.to_parquet(path)
        return path

    return saved


NAMES = {
    "ur rtde": ("timestamp", "actual_q_{}", "actual_qd_{}", "actual_current_{}", 0, "A"),
    "numbered": ("time", "q_{}", "qd_{}", "torque_{}", 1, "N·m"),
    "brackets": ("Time", "position[{}]", "velocity[{}]", "effort[{}]", 0, "N·m"),
    "joint first": ("stamp", "joint{}_pos", "joint{}_vel", "joint{}_torque", 1, "N·m"),
    "camel case": ("timeStamp", "JointPos{}", "JointVel{}", "JointTorque{}", 1, "N·m"),
    "axes": ("t", "Axis {} angle", "Axis {} speed", "Axis {} current", 1, "A"),
    "dots": ("data.t", "data.q.{}", "data.qdot.{}", "data.tau.{}", 0, "N·m"),
    "exact": ("t", "q{}", "dq{}", "tau{}", 1, "N·m"),
    "present": ("t", "current_position_{}", "current_velocity_{}", "current_torque_{}", 0, "N·m"),
}


@pytest.mark.parametrize("name", NAMES)
def test_common_names_are_understood_and_shown(name: str, ur10: Robot, save: Save) -> None:
    t, q, dq, tau, first, unit = NAMES[name]
    recording = assert_read(save(table(t, q, dq, tau, first=first)), ur10)
    assert recording.unit == unit
    assert (name == "exact" and recording.notes == ()) or q.format(first) in recording.notes[0]


@pytest.mark.parametrize("word", ["target", "desired", "commanded", "cmd", "ref", "setpoint"])
def test_what_was_commanded_is_never_taken_for_measured(word: str, ur10: Robot, save: Save) -> None:
    measured = table("time", "q_{}", "qd_{}", "tau_{}")
    commanded = table("x", f"{word}_q_{{}}", f"{word}_qd_{{}}", f"{word}_tau_{{}}") * 2
    both = pd.concat([commanded, measured], axis=1)
    assert_read(save(both), ur10)
    for missing in ("q_", "tau_"):
        path = save(both.drop(columns=[f"{missing}{k}" for k in range(6)]))
        with pytest.raises(BadRecording, match="--map"):
            load_recording(path, ur10)


@pytest.mark.parametrize("extra", ["angle_{}", "actual_pos_{}", None])
def test_an_ambiguous_guess_is_refused_with_a_map_that_settles_it(
    extra: str | None, ur10: Robot, save: Save, tmp_path: Path
) -> None:
    """Two sets of positions, or a torque of another kind."""
    log = table("time", "pos_{}", "vel_{}", "tau_{}" if extra else "tau_motor_{}")
    path = save(log.assign(**{extra.format(k): Q[:, k] + 1 for k in range(6)}) if extra else log)
    with pytest.raises(BadRecording, match="positions could be" if extra else "no torque") as found:
        load_recording(path, ur10)
    text = str(found.value)
    assert "\n" not in text
    written = yaml.safe_load(text.partition("such as")[2])
    as_suggested = write_yaml(tmp_path / "columns.yaml", written)
    assert load_recording(path, ur10, mapping=as_suggested).q.shape == (300, 6)
    mapping = write_yaml(tmp_path / "columns.yaml", {**written, "q": "pos_{0}"})
    assert_read(path, ur10, mapping=mapping)


@pytest.mark.parametrize(
    ("form", "labels"),
    [
        ("{joint}.{what}", ("position", "velocity", "effort")),
        ("/joint_states/{joint}/{what}", ("position", "velocity", "effort")),
        ("{what}_{joint}", ("pos", "vel", "tau")),
    ],
)
def test_joints_are_matched_by_name_in_any_order(
    form: str, labels: tuple[str, str, str], ur10: Robot, save: Save
) -> None:
    columns: dict[str, Any] = {"time": T}
    for k in (3, 1, 0, 5, 4, 2):
        for what, values in zip(labels, (Q, DQ, TAU), strict=True):
            columns[form.format(joint=ur10.joints[k], what=what)] = values[:, k]
    columns[form.format(joint="gripper", what=labels[0])] = 7 * T
    assert_read(save(pd.DataFrame(columns), ".parquet"), ur10)


def test_numbered_columns_follow_the_names_that_stand_beside_them(ur10: Robot, save: Save) -> None:
    order = [3, 1, 0, 5, 4, 2]  # as ROS sorts them, not as the robot does
    columns: dict[str, Any] = {"header.stamp.secs": 1_700_000_000 + T.astype(int)}
    columns["header.stamp.nsecs"] = np.round(T % 1 * 1e9).astype(int)
    for what, values in (("position", Q), ("velocity", DQ), ("effort", TAU)):
        columns |= {f"{what}_{j}": values[:, k] for j, k in enumerate(order)}
    columns |= {f"name_{j}": ur10.joints[k] for j, k in enumerate(order)}
    path = save(pd.DataFrame(columns))
    assert_read(path, ur10)
    with pytest.raises(BadRecording, match="joint 'panda_joint1' of the robot is not among them"):
        load_recording(path, load_robot("panda"))


@pytest.mark.parametrize(
    ("separator", "decimal"), [*product((",", ";", "\t"), ".,"), (" ", "."), ("|", ",")]
)
def test_separators_and_decimal_signs(
    separator: str, decimal: str, ur10: Robot, save: Save
) -> None:
    quoted = separator == decimal  # as spreadsheets write it
    assert_read(save(exact(), sep=separator, decimal=decimal, quoting=int(quoted)), ur10)


def test_comments_preambles_units_and_marks_of_encoding(ur10: Robot, tmp_path: Path) -> None:
    lines = table("t", "q{}", "dq{}", "tau{}", first=1, scale=(1e3, 180 / np.pi, 30 / np.pi, 1e3))
    text = lines.to_csv(index=False).splitlines(keepends=True)
    units = "ms," + ",".join(["deg"] * 6 + ["rpm"] * 6 + ["mNm"] * 6) + "\n"
    body = [text[0], units, *text[1:100], "# operator: pause\n", "\n", *text[100:]]
    content = "".join(["Straße 4; robot 2\n", "# rate 100 Hz\n", *body])
    for encoding in ("utf-8", "utf-8-sig", "utf-16", "cp1252"):
        (tmp_path / "log.csv").write_text(content, encoding=encoding)
        assert "[deg]" in assert_read(tmp_path / "log.csv", ur10).notes[0]
    log = exact()
    np.savetxt(tmp_path / "log.txt", log, fmt="%.17g", header=" ".join(log.columns))
    assert_read(tmp_path / "log.txt", ur10)


def test_without_a_header_columns_are_named_by_number(ur10: Robot, tmp_path: Path) -> None:
    np.savetxt(tmp_path / "log.csv", exact(), "%.17g", ",")
    with pytest.raises(BadRecording, match="--map"):
        load_recording(tmp_path / "log.csv", ur10)
    numbers = {"t": 0, "q": [*range(1, 7)], "dq": [*range(7, 13)], "tau": [*range(13, 19)]}
    mapping = write_yaml(tmp_path / "columns.yaml", numbers)
    assert_read(tmp_path / "log.csv", ur10, mapping=mapping)


TIMES: dict[str, tuple[str, Callable[[pd.Series], Any]]] = {
    "seconds": ("t", lambda t: t + 17.5),
    "ms by name": ("time_ms", lambda t: t * 1e3),
    "us by name": ("Time [µs]", lambda t: np.round(t * 1e6).astype(int)),
    "ns by name": ("timestamp_ns", lambda t: np.round(t * 1e9).astype(int)),
    "s since 1970": ("t", lambda t: t + 1.7e9),
    "ms since 1970": ("timestamp", lambda t: 1_700_000_000_000 + np.round(t * 1e3).astype(int)),
    "us since 1970": ("timestamp", lambda t: 1_700_000_000_000_000 + np.round(t * 1e6).astype(int)),
    "ns since 1970": ("t", lambda t: 1_700_000_000_000_000_000 + np.round(t * 1e9).astype(int)),
    "ISO": ("stamp", lambda t: [f"2026-03-01T10:00:{x:09.6f}Z" for x in t]),
    "ISO of a zone": ("stamp", lambda t: [f"2026-03-01 10:00:{x:09.6f}+02:00" for x in t]),
}


@pytest.mark.parametrize("name", TIMES)
def test_time_in_any_form(name: str, ur10: Robot, save: Save) -> None:
    column, stamps = TIMES[name]
    log = exact().assign(t=lambda x: stamps(x["t"])).rename(columns={"t": column})
    assert_read(save(log), ur10)
    read = assert_read(save(log, ".parquet"), ur10)
    if "1970" in name and name != "s since 1970":  # integers keep every digit
        np.testing.assert_allclose(read.t, T, atol=1e-12)


KINDS: dict[str, tuple[Callable[[pd.DataFrame], pd.DataFrame], str | None]] = {
    "durations": (
        lambda x: x.assign(t=pd.to_timedelta(np.round(x["t"] * 1e9).astype(int))), None
    ),
    "dates": (
        lambda x: x.assign(t=pd.to_datetime(1_700_000_000 + x["t"].round(2), unit="s")), None
    ),
    "far dates": (
        lambda x: x.assign(t=[f"9999-01-01T00:00:{s:09.6f}Z" for s in x["t"]]), None
    ),
    "categories": (lambda x: x.assign(q1=x["q1"].astype(str).astype("category")), None),
    "text": (lambda x: x.astype(str), None),
    "nullable": (lambda x: x.astype("Float64"), None),
    "an index": (lambda x: x.set_index("t"), None),
    "structures": (lambda x: x.assign(q1=[{"a": v} for v in x["q1"]]), "q1"),
    "bytes": (lambda x: x.assign(q1=[str(v).encode() for v in x["q1"]]), "q1"),
    "dates for angles": (lambda x: x.assign(q1=pd.to_datetime(np.arange(len(x)))), "q1"),
    "truth values": (lambda x: x.assign(tau2=x["tau2"] > 0), "tau2"),
    "no time at all": (lambda x: x.assign(t=np.nan), "t"),
}  # fmt: skip


@pytest.mark.parametrize("name", KINDS)
def test_columns_of_any_kind_are_read_or_refused(name: str, ur10: Robot, save: Save) -> None:
    change, refused = KINDS[name]
    path = save(change(exact()), ".parquet")
    if refused is None:
        assert_read(path, ur10)
        return
    with pytest.raises(BadRecording, match="is not a finite number") as refusal:
        load_recording(path, ur10)
    assert (refusal.value.row, refusal.value.column) == (0, refused)


def test_a_map_converts_units_signs_and_currents(ur10: Robot, save: Save, tmp_path: Path) -> None:
    log = table("stamp", "p{}", "v{}", "cur_{}", scale=(1e3, 180 / np.pi, 30 / np.pi, 1e3))
    log[["p2", "v2", "cur_2", "cur_4"]] *= -1
    path, gains, ratios = save(log), np.arange(1, 7) / 10, np.full(6, 100)
    content = {
        "t": "stamp", "q": "p{0}", "dq": [f"v{k}" for k in range(6)], "i": "cur",
        "units": {"t": "ms", "q": "deg", "dq": "rpm", "i": "mA"},
        "sign": {"elbow_joint": -1, "tau": {"wrist_2_joint": -1}},
    }  # fmt: skip
    mapping = write_yaml(tmp_path / "columns.yaml", content)
    assert assert_read(path, ur10, mapping=mapping).unit == "A"
    drive = {"drive": {"gain_Nm_per_A": gains.tolist(), "gear_ratio": ratios.tolist()}}
    mapping = write_yaml(tmp_path / "columns.yaml", content | drive)
    assert assert_read(path, ur10, mapping=mapping, tau=TAU * gains * ratios).unit == "N·m"


BAD_MAPS: dict[str, tuple[object, str]] = {
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
}


@pytest.mark.parametrize("name", BAD_MAPS)
def test_a_bad_map_is_refused_by_what_is_wrong(
    name: str, ur10: Robot, save: Save, tmp_path: Path
) -> None:
    content, why = BAD_MAPS[name]
    path = save(table("time", "q_{}", "qd_{}", "tau_{}"))
    with pytest.raises(ExcitantError) as refusal:
        load_recording(path, ur10, mapping=write_yaml(tmp_path / "columns.yaml", content))
    assert why in str(refusal.value)
    assert "columns.yaml" in str(refusal.value) or "log.csv" in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_a_map_that_is_no_yaml_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "columns.yaml"
    for content in (None, b"{", b"\xff\xfe\xfd", b"a: [1", b"? !!python/object:x"):
        if content is not None:
            path.write_bytes(content)
        with pytest.raises(BadInput, match=r"columns\.yaml"):
            load_column_map(path)


def test_npz_and_mat_hold_the_same_recording(ur10: Robot, tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", time=T, q=Q, qd=DQ.T, torque=TAU, robot="ur10")
    assert_read(tmp_path / "a.npz", ur10)
    log = {"t": T, "q": Q, "dq": DQ, "tau": TAU, "comment": "first run", "rate": 100.0}
    for form in ("4", "5"):
        content: dict[str, Any] = {"log": log} if form == "5" else log
        scipy.io.savemat(tmp_path / "a.mat", content, format=form)
        assert_read(tmp_path / "a.mat", ur10)


ARRAYS: dict[str, tuple[dict[str, Any], str]] = {
    "other lengths": ({"t": T, "q": Q[:-1], "tau": TAU}, "is 299 × 6, but there are 300 samples"),
    "objects": ({"t": T, "q": np.array([{}], dtype=object)}, "cannot be read"),
    "square": ({"t": T[:6], "q": Q[:6], "tau": TAU[:6]}, "rows or columns could be samples"),
}


def test_arrays_that_do_not_fit_are_refused(ur10: Robot, tmp_path: Path) -> None:
    for arrays, why in ARRAYS.values():
        np.savez(tmp_path / "a.npz", **arrays)
        with pytest.raises(BadRecording, match=why):
            load_recording(tmp_path / "a.npz", ur10)
    for start in (b"\x89HDF\r\n\x1a\n", b"MATLAB 7.3 MAT-file".ljust(512) + b"\x89HDF\r\n\x1a\n"):
        (tmp_path / "a.mat").write_bytes(start + bytes(100))
        with pytest.raises(BadRecording, match="save it with save"):
            load_recording(tmp_path / "a.mat", ur10)


@pytest.fixture
def write_bag(ur10: Robot, write_joint_states: Callable[..., None]) -> Callable[..., None]:
    """Joint states in the order of ROS, with a gripper, and messages of another node."""

    def write(
        path: Path,
        kind: str,
        topics: Sequence[str] = ("/joint_states",),
        *,
        stamped: bool = True,
        effort: bool = True,
    ) -> None:
        order = sorted(range(6), key=lambda k: ur10.joints[k])
        channels = [np.column_stack([0.1 + 0 * T, x[:, order]]) for x in (Q, DQ, TAU)]
        channels[2] = channels[2] if effort else np.zeros(0)
        names, t = ["gripper", *(ur10.joints[k] for k in order)], T if stamped else -T - 1
        write_joint_states(path, kind, names, t, channels, topics=topics, hand=True)

    return write


@pytest.mark.parametrize("kind", ["bag", "mcap", "db3"])
def test_bags_are_read_by_joint_name(
    kind: str, ur10: Robot, write_bag: Callable[..., None], tmp_path: Path
) -> None:
    bag = tmp_path / ("log.bag" if kind == "bag" else "log")
    write_bag(bag, kind, topics=("/joint_states", "/joint_command"))
    for file in [bag] if kind == "bag" else [bag, next(bag.glob(f"*.{kind}"))]:
        recording = assert_read(file, ur10)
        np.testing.assert_allclose(recording.t, T, atol=1e-12)
        notes = {"topic: /joint_states", "joints left out: finger, gripper"}
        assert notes <= set(recording.notes)
    current = column_map({"i": "effort", "units": {"i": "mA"}}, "columns.yaml")
    assert assert_read(bag, ur10, mapping=current, tau=TAU * 1e-3).unit == "A"
    with pytest.raises(BadRecording, match="joint 'panda_joint1' of the robot is not among them"):
        load_recording(bag, load_robot("panda"))


BAGS: dict[str, tuple[dict[str, Any], str | None, str]] = {
    "two": ({"topics": ("/left/states", "/right/states")}, None, "topic: /left/states"),
    "none": ({"topics": ("/left/states",)}, "/none", "states on /none; topics with them: /left"),
    "commands": ({"topics": ("/joint_command",)}, None, "topic: /joint_command"),
    "weak": ({"effort": False}, None, "torques of shoulder_pan_joint.*is missing"),
}


def test_bags_that_leave_a_choice_or_lack_something(
    ur10: Robot, write_bag: Callable[..., None], tmp_path: Path
) -> None:
    for name, (options, topic, why) in BAGS.items():
        write_bag(tmp_path / name, "mcap", **options)
        with pytest.raises(BadRecording, match=why):
            load_recording(tmp_path / name, ur10, mapping=ColumnMap(topic=topic))
    assert_read(tmp_path / "two", ur10, mapping=ColumnMap(topic="/right/states"))
    write_bag(tmp_path / "unstamped", "mcap", stamped=False)
    notes = assert_read(tmp_path / "unstamped", ur10).notes
    assert any("that of recording" in note for note in notes)


def test_a_raw_recording_refuses_no_row(ur10: Robot, tmp_path: Path) -> None:
    """Speeds with holes are left out with a note, anything else is refused where it is checked."""
    log = exact().astype(object)
    log["temp"], log.loc[5, "dq3"] = 30.0, np.nan
    log.to_csv(tmp_path / "log.csv", index=False)
    recording = load_recording(tmp_path / "log.csv", ur10)
    assert recording.dq is None
    assert recording.notes == ("speeds left out: row 5 holds no finite number",)
    log["t"], log["tau4"] = np.sort(np.random.default_rng(0).uniform(0, 3, 300)), 0.0
    log.loc[7, "t"], log.loc[9, "q2"] = log.loc[6, "t"], "abc"
    log.to_csv(tmp_path / "log.csv", index=False)
    raw = raw_recording(tmp_path / "log.csv", ur10)
    np.testing.assert_array_equal(raw.t, log["t"].to_numpy(float) - log["t"][0])
    assert raw.dq is not None
    assert np.isnan([raw.q[9, 1], raw.dq[5, 2]]).all()
    assert raw.unreadable[9, "q2"] == "abc"
    assert set(raw.extras) == {"temp"}
    assert not any(values.flags.writeable for values in (raw.q, *raw.extras.values()))


def test_damaged_rows_and_columns(ur10: Robot, save: Save) -> None:
    """Refused by row and column; a line that was cut is left out with a note."""
    path, text = save(pd.concat([exact(), exact()[["q3"]]], axis=1)), exact().to_csv(index=False)
    with pytest.raises(BadRecording) as refusal:
        load_recording(path, ur10)
    assert refusal.value.column == "q3"
    lines = text.splitlines()
    for line, cells in ((lines[43].rpartition(",")[0], 18), (f"{lines[43]},1", 20)):
        path.write_text("\n".join([*lines[:43], line, *lines[44:]]) + "\n")
        with pytest.raises(BadRecording, match=f"{cells} cells where the header") as refusal:
            load_recording(path, ur10)
        assert refusal.value.row == 42
    path.write_text(text[:-3])
    recording = load_recording(path, ur10)
    np.testing.assert_array_equal(recording.tau, TAU[:-1])
    assert any("last line left out" in note for note in recording.notes)


MEANINGS = {
    "target_moment_0": ("tau", 0, True),
    "J2 Torque [Nm]": ("tau", 2, False),
    "torque_1 [A]": ("i", 1, False),
    "shoulder_pan position": ("q", "shoulder_pan_joint", False),
    "q_ref4": ("q", 4, True),
    "ddq_logged1": ("ddq", 1, False),
    "temperature_1": (None, 1, False),
    "actual_TCP_speed_0": ("dq", 0, False),
}


def test_names_mean_what_people_mean(ur10: Robot) -> None:
    found = {column: meaning(column, ur10.joints) for column in MEANINGS}
    assert {c: (m.role, m.joint, m.commanded) for c, m in found.items()} == MEANINGS


def test_a_folder_brings_its_map_and_its_drives(ur10: Robot, tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(ur10.urdf, encoding="utf-8")
    drive = {"gain_Nm_per_A": [0.1] * 6, "gear_ratio": [50] * 6}
    (tmp_path / "robot.yaml").write_text(yaml.safe_dump({"model": "arm.urdf", "drive": drive}))
    write_yaml(tmp_path / "columns.yaml", {"q": "wheel_{0}", "units": {"q": "deg"}})
    write_yaml(tmp_path / "rad.yaml", {"q": "wheel_{0}"})
    log = table("time", "wheel_{}", "vel_{}", "actual_current_{}", scale=(1, 180 / np.pi, 1, 1))
    log.to_csv(tmp_path / "log.csv", index=False)
    datasets = (
        (load_dataset(tmp_path), [], Q),
        (load_dataset(tmp_path, columns=tmp_path / "rad.yaml"), [], Q * 180 / np.pi),
        (
            load_dataset(tmp_path / "robot.yaml", columns=tmp_path / "rad.yaml"),
            [str(tmp_path / "log.csv")],
            Q * 180 / np.pi,
        ),
    )
    for dataset, names, q in datasets:
        [found] = dataset.recordings(names)
        np.testing.assert_allclose(found.tau, 5 * TAU)
        np.testing.assert_allclose(found.q, q, atol=1e-12)
        assert found.unit == "N·m"


def test_the_sidecar_may_say_units_and_gains(ur10: Robot, tmp_path: Path) -> None:
    (tmp_path / "robot.urdf").write_text(ur10.urdf, encoding="utf-8")
    gains = [1, 2, 3, 4, 5, 6]
    sidecar = {"torque": {"column": "i", "drive_gain_Nm_per_A": gains}, "units": {"q": "deg"}}
    (tmp_path / "dataset.json").write_text(json.dumps(sidecar))
    log = table("t", "q{}", "dq{}", "i{}", first=1, scale=(1, 180 / np.pi, 1, 1))
    log.to_parquet(tmp_path / "log.parquet")
    [found] = load_dataset(tmp_path).recordings([])
    np.testing.assert_allclose(found.tau, TAU * gains)
    np.testing.assert_allclose(found.q, Q, atol=1e-12)


def test_the_command_takes_a_map_and_shows_what_it_understood(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = pd.DataFrame({"clock": T[:100], "a": Q[:100, 0], "b": Q[:100, 1]})
    log.assign(tau_0=1.0, tau_1=TAU[:100, 1]).to_csv(tmp_path / "log.csv", index=False)
    (tmp_path / "c.yaml").write_text("{t: clock, q: [a, b], tau: 'tau_{0}'}")
    arguments = ["identify", "planar_2r", str(tmp_path / "log.csv")]
    assert main(arguments) == 1
    assert "--map" in capsys.readouterr().err
    assert main([*arguments, "--map", str(tmp_path / "c.yaml")]) == 1
    assert "column 'clock': too short: 100 samples" in capsys.readouterr().err
