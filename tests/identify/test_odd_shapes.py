"""Logs as other programs write them, of shapes that nobody planned for: read without a word.

Thirteen and more shapes of one motion. Where names leave a choice, the refusal holds the map that
settles it.
"""

from __future__ import annotations

import gzip
import json
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import scipy.io
import yaml

from excitant.design import random_trajectory
from excitant.exceptions import BadInput, BadRecording
from excitant.identify import Recording, load_column_map, load_dataset, load_recording
from excitant.robots import load_robot
from excitant.robots.virtual_arm import virtual_arm

T = np.arange(300) / 100
RATES = np.arange(1, 7)
Q = np.sin(np.outer(T, RATES))
DQ = np.cos(np.outer(T, RATES)) * RATES
TAU = 3 * Q + DQ + RATES
ARM = load_robot("ur10")
JOINTS = ARM.joints
SHUFFLED = sorted(range(6), key=lambda k: JOINTS[k])  # as ROS publishes them
DEG = 180 / np.pi
SEC = (1_700_000_000 + T.astype(int)).tolist()
NS = np.round(T % 1 * 1e9).astype(int).tolist()
Columns = dict[str, Any]


def same(found: Recording, unit: str = "N·m") -> None:
    np.testing.assert_allclose(found.t, T, atol=1e-6)
    np.testing.assert_allclose(found.q, Q, atol=1e-12)
    np.testing.assert_allclose(found.tau, TAU, rtol=1e-12)
    if found.dq is not None:
        np.testing.assert_allclose(found.dq, DQ, atol=1e-12)
    assert found.unit == unit


def named(
    time: str, forms: Sequence[str], channels: Sequence[np.ndarray] = (Q, DQ, TAU), first: int = 1
) -> Columns:
    """Columns by name, a joint after the other."""
    columns: Columns = {time: T}
    for form, values in zip(forms, channels, strict=True):
        columns |= {form.format(k + first): values[:, k] for k in range(6)}
    return columns


def text(columns: Columns, separator: str = ",", decimal: str = ".") -> str:
    return pd.DataFrame(columns).to_csv(index=False, sep=separator, decimal=decimal)


def lines(records: Sequence[Any]) -> str:
    return "\n".join(json.dumps(record) for record in records)


def with_units() -> str:
    """Names, then units, in two rows, as data loggers export."""
    scaled = (1e3 * T, Q * DEG, DQ * 30 / np.pi, 1e3 * TAU)
    columns = named("Time", ("Pos_{}", "Vel_{}", "Torque_{}"), scaled[1:]) | {"Time": scaled[0]}
    head, rest = text(columns).split("\n", 1)
    units = ",".join(["[ms]"] + ["[deg]"] * 6 + ["[rpm]"] * 6 + ["[mNm]"] * 6)
    return f"{head}\n{units}\n{rest}"


def rostopic() -> str:
    """``rostopic echo -p``."""
    stamp = (17 * 10**17 + np.round(T * 1e9)).astype(int)
    columns: Columns = {"%time": stamp + 5, "field.header.seq": range(300)}
    columns |= {"field.header.stamp": stamp, "field.header.frame_id": ""}
    columns |= {f"field.name{k}": JOINTS[j] for k, j in enumerate(SHUFFLED)}
    for what, values in (("position", Q), ("velocity", DQ), ("effort", TAU)):
        columns |= {f"field.{what}{k}": values[:, j] for k, j in enumerate(SHUFFLED)}
    return text(columns)


def ros2_topic(frame: str = "base_link") -> str:
    """``ros2 topic echo --csv``: no line of names."""
    names = ",".join(JOINTS[j] for j in SHUFFLED)
    numbers = np.hstack([x[:, SHUFFLED] for x in (Q, DQ, TAU)]).tolist()
    rows = zip(SEC, NS, numbers, strict=True)
    return "".join(f"{s},{n},{frame},{names},{','.join(map(repr, x))}\n" for s, n, x in rows)


def libfranka() -> str:
    """The log that libfranka writes after an error, in milliseconds, with what was commanded."""
    forms = ("q", "q_d", "dq", "dq_d", "tau_J", "tau_ext_hat_filtered")
    channels = (Q, Q + 1, DQ, DQ + 1, TAU, TAU / 9)
    states = named("time", [f"state.{name}[{{}}]" for name in forms], channels, 0)
    sent = named("time", [f"cmd.{name}[{{}}]" for name in ("q_d", "tau_J_d")], (Q, DQ), 0)
    return text(states | sent | {"time": np.round(T * 1e3).astype(int), "success_rate": 1.0})


def rtde() -> str:
    """Universal Robots' RTDE example client: separated by blanks, targets beside actual values."""
    names = ("target_q_{}", "target_qd_{}", "target_moment_{}", "actual_q_{}", "actual_qd_{}")
    names = (*names, "actual_current_{}", "actual_TCP_speed_{}", "joint_temperatures_{}")
    channels = (Q + 1, DQ + 1, TAU + 1, Q, DQ, TAU, DQ, Q)
    return text(named("timestamp", names, channels, 0) | {"timestamp": T + 4e5}, " ")


def kuka() -> str:
    """KUKA's Sunrise data recorder: the name of the arm in every column, time in two."""
    arm = "LBR_iiwa_7_R800_1[{}]"
    columns = named("t", (f"axisQMsr_{arm}", f"axisTauMsr_{arm}"), (Q, TAU), 0)
    del columns["t"]
    return text({"ZeitInSec": SEC, "ZeitInNanoSec": NS} | columns, " ")


def plotted() -> str:
    """An export of a plotting program: topics in front, one of two arms that are called alike."""
    columns: Columns = {"__time": T + 1.7e9}
    for joint, *values in zip(JOINTS, Q.T, DQ.T, TAU.T, strict=True):
        for what, x in zip(("position", "velocity", "effort"), values, strict=True):
            columns[f"/left/joint_states/left_{joint}/{what}"] = x
    return text(columns)


def stamped(form: Callable[[float], str]) -> Columns:
    columns = named("timestamp", ("joint{}_pos", "joint{}_vel", "joint{}_eff"))
    return columns | {"timestamp": [form(x) for x in T]}


GERMAN = ("Position {} [rad]", "Geschw. {} speed [rad/s]", "Drehmoment {} [Nm]")
JOINT_STATES = [
    {
        "header": {"stamp": {"sec": s, "nanosec": n}, "frame_id": ""},
        "name": [JOINTS[j] for j in SHUFFLED],
        "position": q,
        "velocity": dq,
        "effort": tau,
    }
    for s, n, q, dq, tau in zip(
        SEC, NS, *(x[:, SHUFFLED].tolist() for x in (Q, DQ, TAU)), strict=True
    )
]
BY_JOINT = [{"pos": Q[:, k], "vel": DQ[:, k], "torque": TAU[:, k]} for k in range(6)]
LISTS = {"ts": T, "joint_pos": Q, "joint_vel": DQ, "joint_eff": TAU}

WRITTEN: dict[str, tuple[str, str | bytes]] = {
    "semicolons, decimal commas": (
        "log.csv",
        ("Prüfstand 3\n" + text(named("Zeit [s]", GERMAN), ";", ",")).encode("cp1252"),
    ),
    "UTF-16 of a spreadsheet": (
        "log.txt",
        text(named("time", ("q_{}", "qd_{}", "tau_{}")), "\t").encode("utf-16"),
    ),
    "units in a row of their own": ("log.csv", with_units()),
    "dates, day first": ("log.csv", text(stamped(lambda t: f"31.03.2026 10:00:{t:09.6f}"), ";")),
    "dates, month first": ("log.csv", text(stamped(lambda t: f"03/31/2026 10:00:{t:09.6f}"))),
    "time of day": ("log.csv", text(stamped(lambda t: f"10:00:{t:09.6f}"))),
    "rostopic echo -p": ("log.csv", rostopic()),
    "ros2 topic echo --csv": ("log.csv", ros2_topic()),
    "the same without a frame": ("log.csv", ros2_topic("")),
    "libfranka": ("log.csv", libfranka()),
    "RTDE": ("log.csv", rtde()),
    "Sunrise": ("log.log", kuka()),
    "topics and an arm in front": ("log.csv", plotted()),
    "axes": ("log.csv", text(named("Time", ("A{}_pos", "A{}_vel", "A{}_motor_current")))),
    "gzip": ("log.csv.gz", gzip.compress(text(named("t", ("q{}", "dq{}", "tau{}"))).encode())),
    "JSON lines of joint states": ("log.jsonl", lines(JOINT_STATES)),
    "JSON, a list of records": ("log.json", json.dumps(JOINT_STATES)),
    "JSON, lists by name": ("log.json", json.dumps({k: x.tolist() for k, x in LISTS.items()})),
}  # fmt: skip


@pytest.mark.parametrize("shape", WRITTEN)
def test_text_of_any_shape_is_read_without_a_word(shape: str, tmp_path: Path) -> None:
    name, content = WRITTEN[shape]
    (tmp_path / name).write_bytes(content.encode() if isinstance(content, str) else content)
    same(load_recording(tmp_path / name, ARM), "A" if shape in ("RTDE", "axes") else "N·m")


SAVED: dict[str, tuple[str, Callable[[Path], Any]]] = {
    "arrays by samples": ("log.npz", lambda path: np.savez(path, **LISTS)),
    "arrays by joints": ("log.npz", lambda p: np.savez(p, **{k: x.T for k, x in LISTS.items()})),
    "a struct": ("log.mat", lambda path: scipy.io.savemat(path, {"log": LISTS})),
    "a struct for each joint": (
        "log.mat",
        lambda path: scipy.io.savemat(path, {"log": {"t": T, "joints": BY_JOINT}}),
    ),
    "lists in Parquet": (
        "log.parquet",
        lambda path: pd.DataFrame({k: list(x) for k, x in LISTS.items()}).to_parquet(path),
    ),
}


@pytest.mark.parametrize("shape", SAVED)
def test_arrays_of_any_shape_are_read_without_a_word(shape: str, tmp_path: Path) -> None:
    name, save = SAVED[shape]
    save(tmp_path / name)
    same(load_recording(tmp_path / name, ARM))


def test_numbers_without_names_are_refused_with_the_map_that_reads_them(tmp_path: Path) -> None:
    path, columns = tmp_path / "log.dat", tmp_path / "columns.yaml"
    for channels in ((Q, DQ, TAU), (Q, TAU)):
        np.savetxt(path, np.column_stack([T, *channels]), fmt="%.17g")
        with pytest.raises(BadRecording) as refusal:
            load_recording(path, ARM)
        columns.write_text(str(refusal.value).partition("such as ")[2])
        same(load_recording(path, ARM, mapping=load_column_map(columns)))


@pytest.mark.parametrize(
    ("extra", "why"),
    [
        (named("t", ("left_q_{}", "left_dq_{}", "left_tau_{}")), "positions could be"),
        (named("t", ("motor_q_{}", "motor_dq_{}", "motor_tau_{}")), None),
    ],
)
def test_words_before_joints_name_an_arm_but_not_its_motors(
    extra: Columns, why: str | None, tmp_path: Path
) -> None:
    """Of two arms the user says which; motors turn otherwise than joints."""
    log = tmp_path / "log.csv"
    arm = named("t", ("right_q_{}", "right_dq_{}", "right_tau_{}"))
    log.write_text(text(arm | extra))
    if why is None:
        same(load_recording(log, ARM))
        log.write_text(text(extra))
    with pytest.raises(BadRecording, match=why or "no torque"):
        load_recording(log, ARM)


PLAIN = ("pos_{}", "vel_{}", "tau_{}")
BY_NAME = {f"{joint}_{what}": 0.0 for joint in JOINTS for what in ("angle", "position", "torque")}
REFUSED: dict[str, tuple[str, str]] = {
    "no torque": ("log.csv", text(named("t", PLAIN[:2], (Q, DQ)))),
    "no position": ("log.csv", text(named("t", PLAIN[2:], (TAU,)))),
    "no time": ("log.csv", text(named("sample", PLAIN))),
    "two positions": ("log.csv", text(named("t", (*PLAIN, "angle_{}"), (Q, DQ, TAU, Q)))),
    "two by name": ("log.csv", text({"t": T} | BY_NAME)),
    "another arm": ("log.csv", text({k: x for k, x in named("t", PLAIN).items() if "6" not in k})),
    "no names": ("log.dat", text(named("t", PLAIN)).partition("\n")[2]),
    "no numbers": ("log.csv", "a,b,c\n"),
    "another format": ("log.xlsx", "PK"),
    "no record": ("log.json", "{}"),
    "text for a number": ("log.csv", text(named("t", PLAIN)).replace("0.01,", "late,", 1)),
    "a short row": ("log.csv", text(named("t", PLAIN)) + "1,2\n"),
}


@pytest.mark.parametrize("shape", REFUSED)
def test_a_refusal_is_short_and_says_the_path_once(shape: str, tmp_path: Path) -> None:
    name, content = REFUSED[shape]
    (tmp_path / name).write_text(content)
    with pytest.raises(BadRecording) as refusal:
        load_recording(tmp_path / name, ARM)
    said = str(refusal.value)
    assert said.count(str(tmp_path)) == 1
    assert len(said.replace(str(tmp_path), "")) < 200, said


def test_damaged_json_is_refused_by_row(tmp_path: Path) -> None:
    path = tmp_path / "log.jsonl"
    less = [*JOINT_STATES]
    less[7] = {k: x for k, x in less[7].items() if k != "effort"}
    short = [*JOINT_STATES]
    short[9] = {**short[9], "effort": [1.0]}
    for records, why in ((less, "'effort', row 7: is missing"), (short, "cannot be read")):
        path.write_text(lines(records))
        with pytest.raises(BadRecording, match=why):
            load_recording(path, ARM)
    for broken in ("", "[]", "3", '{"t": 1', "[1, 2]"):
        path.write_text(broken)
        with pytest.raises(BadRecording):
            load_recording(path, ARM)


Bag = Callable[..., Path]
STATES = [x[:, SHUFFLED] for x in (Q, DQ, TAU)]
LIMITS = {"elbow_joint": {"has_velocity_limits": True, "max_velocity": 1.25}}


@pytest.fixture
def bag(write_joint_states: Callable[..., None], tmp_path: Path) -> Bag:
    """``bag(kind, prefix, texts=..., parameters=...)``: joint states in the order of ROS."""

    def written(kind: str, prefix: str = "", hand: bool = False, **more: Any) -> Path:
        path = tmp_path / f"bag{len(list(tmp_path.iterdir()))}{'.bag' * (kind == 'bag')}"
        names = [prefix + JOINTS[j] for j in SHUFFLED]
        write_joint_states(path, kind, names, T, STATES, hand=hand, **more)
        return path

    return written


@pytest.mark.parametrize("prefix", ["left_arm/", "ur10_", ""])
@pytest.mark.parametrize("kind", ["bag", "mcap", "db3"])
def test_bags_are_read_whatever_stands_before_joints_names(
    kind: str, prefix: str, bag: Bag
) -> None:
    found = load_recording(bag(kind, prefix, hand=True), ARM)
    same(found)
    assert any(f"'{prefix}'" in note for note in found.notes) == bool(prefix)


def test_the_robot_may_have_the_prefix_and_two_that_fit_are_refused(bag: Bag) -> None:
    other = ARM.urdf
    for joint in JOINTS:
        other = other.replace(f'"{joint}"', f'"ur10_{joint}"')
    path = bag("mcap")
    (path.parent / "arm.urdf").write_text(other)
    same(load_recording(path, load_robot(path.parent / "arm.urdf")))
    two = bag("mcap", "a_", other="b_")
    with pytest.raises(BadRecording, match="holds the joints a_"):
        load_recording(two, ARM)
    columns = path.parent / "columns.yaml"
    parts = {"q": "b_{joint}.position", "tau": "b_{joint}.effort"}
    columns.write_text(yaml.safe_dump(parts))
    same(load_recording(two, ARM, mapping=load_column_map(columns)))


def test_a_bag_brings_its_robot_and_limits(bag: Bag) -> None:
    ends = '<parent link="tool0"/><child link="tip"/>'
    ends += '<limit lower="0" upper="1" effort="1" velocity="1"/>'
    finger = f'<joint name="finger" type="prismatic">{ends}</joint>'
    urdf = ARM.urdf.replace("</robot>", f'<link name="tip"/>{finger}</robot>')
    limits = yaml.safe_dump({"joint_limits": LIMITS})
    path = bag("mcap", texts={"robot_description": urdf, "joint_limits": limits})
    for spec, names in ((path, []), (path.parent, []), (path.parent, [path.name])):
        dataset = load_dataset(spec)
        assert dataset.robot.joints == JOINTS
        assert any("held at 0" in n and "finger" in n for n in dataset.robot.notes)
        assert dataset.robot.limits.velocity[2] == 1.25
        [found] = dataset.recordings(names)
        same(found)


def test_a_bag_without_a_robot_is_refused_and_one_may_be_given_beside_it(bag: Bag) -> None:
    path = bag("mcap")
    with pytest.raises(BadInput, match="no robot_description in this bag; give ROBOT"):
        load_dataset(path)
    [found] = load_dataset("ur10").recordings([str(path.parent)])
    same(found)


def test_a_bag_alone_is_enough_for_a_verdict(
    write_joint_states: Callable[..., None], excitant: Callable[..., Any], tmp_path: Path
) -> None:
    robot, rng = load_robot("planar_2r"), np.random.default_rng(1)
    log = virtual_arm(robot, rng, hidden=()).record(
        random_trajectory(robot, rng, 8.0, 4), 16.0, rng
    )
    channels = [log[[f"{what}2", f"{what}1"]].to_numpy() for what in ("q", "dq", "tau")]
    path, names = tmp_path / "bag", ["left/joint2", "left/joint1"]
    texts = {"robot_description": robot.urdf}
    write_joint_states(path, "mcap", names, log["t"], channels, texts=texts)
    ran = excitant("go", path, "-o", tmp_path / "out")
    assert ran.status == 0
    assert ran.err.count("'left/' is taken off the names") == 1
    assert re.search("^verdict .*\n.*\n +(Use extended|Use model|Keep)", ran.out)
