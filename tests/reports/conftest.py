"""Runs of every verb, made up for a four-joint arm: records with nulls and long names."""

import copy
import re
import shutil
from collections.abc import Callable, Iterator
from functools import cache, partial
from html import unescape
from html.parser import HTMLParser
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from planted import motion_of
from records import full

from excitant.analysis.identifiability import analyze
from excitant.reports import SavedRun, compare, html, page_of
from excitant.reports.run import as_saved
from excitant.results import record_of
from excitant.robots import load_robot
from excitant.robots.check import ModelCheck
from excitant.robots.effects import standard_effects

LONG_NAME = "right_arm_forearm_roll_actuator_joint_with_a_very_long_name"
JOINTS = ["shoulder_pan_joint", "elbow_joint", LONG_NAME, "wrist_roll_joint"]
NV = len(JOINTS)
SIZE = np.array([40.0, 30.0, 4.0, 0.6])

Run = tuple[dict[str, Any], dict[str, np.ndarray]]
ARM: dict[str, Any] = {"robot": "made_up_arm", "joints": JOINTS}
FILTERED: dict[str, Any] = {"robot": "made_up_arm", "cutoff_hz": 12.5, "unit": "N·m"}


def _motion(n: int, duration: float, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    t, w = np.linspace(0, duration, n), 2 * np.pi / duration * np.arange(1, 6)
    a, b = rng.normal(size=(2, 5, NV)) / np.arange(1, 6)[:, None]
    waves = np.exp(1j * np.outer(t, w))
    return t, *((waves * (1j * w) ** order @ (b - 1j * a)).real for order in range(3))


def _rows(**columns: Any) -> list[dict[str, Any]]:
    return pd.DataFrame(columns).to_dict("records")


def _accuracy(rms: np.ndarray, scale: np.ndarray, **more: Any) -> list[dict[str, Any]]:
    nrmse = rms / scale
    return _rows(**more, rms=rms, nrmse=nrmse, r2=1 - nrmse**2, rms_raw=1.4 * rms)


BOX = {"shape": "box", "size": [0.2, 0.3, 0.9], "position": [0.9, 0.0, 0.45]}
OBSTACLES = [
    {"name": "table", "shape": "half_space", "normal": [0.0, 0.0, 1.0], "offset": -0.1},
    {"name": "pillar", **BOX, "rpy": [0.0, 0.0, 0.4]},
    {"name": "ball", "shape": "sphere", "radius": 0.2, "position": [0.0, 0.9, 0.4]},
    {"name": "cell", "shape": "workspace", "low": [-0.9, -0.9, 0.0], "high": [0.9, 0.9, 1.3]},
    {"name": "far wall", "shape": "box", "size": [1.0, 1.0, 1.0], "position": [40.0, 0.0, 0.0]},
]


def _played(t: np.ndarray, *derivatives: np.ndarray) -> Run:
    """Frames of an arm with a shape of every kind; its last joint slides."""
    up, turned = [0.0, 0.0, 0.3, 0.0, 0.0, 0.0, 1.0], [0.0, 0.1, 0.2, 0.5, 0.5, 0.5, 0.5]
    kinds = {"box": [0.2, 0.2, 0.1], "cylinder": [0.06, 0.3], "sphere": [0.07]}
    kinds |= {"capsule": [0.05, 0.2], "mesh": []}
    shapes = _rows(joint=range(5), place=[turned] * 5, kind=[*kinds], size=[*kinds.values()])
    slides = [False] * (NV - 1) + [True]
    joints = _rows(parent=range(NV), place=[turned, up] * 2, axis=[[0, 0, 1]] * NV, slides=slides)
    look = {"joints": joints, "tool": {"joint": NV, "place": up}, "shapes": shapes}
    look |= {"notes": ["drawn by visual shapes, which are not checked: base"]}
    used = [np.abs(x) / np.abs(x).max(0) for x in (*derivatives, derivatives[0])]
    frames = {"t": t, "q": derivatives[0], "dq": derivatives[1], "shares": np.stack(used, axis=1)}
    frames |= {"pair": (t > 5).astype(float), "distance": 0.1 * np.cos(t)}
    frames["points"] = np.tile([[0.0, 0.0, 0.3], [0.1, 0.2, 0.0]], (len(t), 1, 1))
    series = {f"play_{name}": values[::4] for name, values in frames.items()}
    series["mesh4_points"] = 0.2 * np.vstack([np.zeros(3), np.eye(3)])
    series["mesh4_faces"] = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    bodies = [["forearm_0", "table"], ["forearm_0", "base_with_a_very_long_name_indeed_0"]]
    return {"appearance": look, "bodies": bodies}, series


@cache
def analyze_run() -> Run:
    """A real one, of a motion in which the elbow rests."""
    arm = load_robot("ur10")
    motion = motion_of(arm, resting=[2])
    found = analyze(arm, effects=standard_effects(arm.joints), motion=motion)
    return as_saved(found.result(), found.series())


def _parameters() -> list[dict[str, Any]]:
    """Of a real arm, link by link."""
    return [
        {**row, "link": link["link"], "prior_dominated": row["decided_by"] == "prior"}
        for link in analyze_run()[0]["links"]
        for row in link["parameters"]
    ]


def _base_parameters() -> list[dict[str, Any]]:
    return [{**row, "expression": row["name"]} for row in analyze_run()[0]["practical"]]


def robots_run() -> Run:
    check = ModelCheck(load_robot("scara"))
    return check.result(), check.series()


def design_run() -> Run:
    rng = np.random.default_rng(1)
    t, q, dq, ddq = _motion(2001, 10.0, rng)
    most, fast, jolt = (abs(x).max(0) for x in (q, dq, ddq))
    weakest = [
        row | {"std_per_unit_noise_initial": 3.0 / k, "std_per_unit_noise_final": 0.15 / k}
        for k, row in enumerate(_base_parameters()[:10], start=1)
    ]
    ends = 9.31 + 0.7 * np.arange(8) ** 1.5
    status = ["converged"] * 6 + ["stopped: time limit"] * 2
    starts = _rows(condition_number=ends, status=status)
    certified = {
        "position": _rows(low=q.min(0), high=q.max(0), ratio=0.98, t=3.2),
        "velocity": _rows(low=-fast, high=fast, ratio=1.0, t=7.77),
        "acceleration": [{"low": -9.0, "high": 9.0, "ratio": 0.77, "t": 1.0}, *[None] * (NV - 1)],
        "torque": [None] * NV,
    }
    result = ARM | {"verb": "design", "duration": 10.0, "harmonics": 5, "columns": "friction"}
    result |= {"criterion": "condition", "base_parameters": 57, "joint_weights": [1.0] * NV}
    result |= {
        "condition_number": {"initial": 171.2, "final": 9.31, "lower_bound": 6.02},
        "condition_number_scaled": {"initial": 90.4, "final": 6.21},
        "limits": {"position": 0.9998, "velocity": 1.0, "acceleration": 0.734, "torque": None},
        "worst": {"velocity": {"joint": JOINTS[1], "t": 7.77}}
        | {"acceleration": {"joint": JOINTS[2], "t": 1.0}, "torque": None},
        "limit_values": {"position": np.stack([-1.02 * most, 1.02 * most], axis=1)}
        | {"velocity": fast, "acceleration": [*1.3 * jolt[:-1], None], "torque": None},
        "closest": {"bodies": ["forearm_0", "table"], "t": 5.0, "distance_m": 0.0434},
        "files": ["trajectory.csv", "trajectory.json", "approach.csv", "return.csv"],
    }
    result |= {"certified": certified, "weakest": weakest, "starts": starts}
    result |= {"obstacles": OBSTACLES, "clearance_m": 0.043, "revolute": [True, True, True, False]}
    tau = SIZE * (0.5 * np.sin(q) + 0.05 * ddq) + 0.1 * SIZE * np.sign(dq)
    series = {"t": t, "q": q, "dq": dq, "ddq": ddq, "tau": tau}
    series["dddq"] = np.gradient(ddq, t, axis=0)
    for key, least in (("initial", -4.2), ("final", -1.9)):
        series[f"eigenvalues_{key}"] = np.sort(10 ** rng.uniform(least, 0, 57))[::-1]
    look, frames = _played(t, q, dq, ddq)
    return result | look, series | frames


def check_run() -> Run:
    designed, series = design_run()
    verdict = "velocity of elbow_joint reaches 131 % of its limit at 2.5 s: slow down by 1.31."
    limits = {"position": 0.81, "velocity": 1.31, "acceleration": None, "torque": 0.5}
    result = ARM | {"verb": "check", "trajectory": "somebody/trajectory.csv", "limits": limits}
    result |= {"limit_values": designed["limit_values"], "verdicts": [verdict, "all others hold."]}
    result |= {"worst": {"velocity": {"joint": "elbow_joint", "t": 2.5}}}
    return result, {key: series[key] for key in ("t", "q", "dq", "ddq")}


def show_run() -> Run:
    designed, series = design_run()
    kept = ("certified", "appearance", "bodies", "obstacles", "closest")
    return check_run()[0] | {"verb": "show"} | {key: designed[key] for key in kept}, series


def rehearse_run() -> Run:
    designed, series = design_run()
    friction = {"name": "viscous friction", "unit": "N·m·s/rad", "planted": 0.57}
    items = [
        {"name": "velocity limits", "joint": JOINTS[0], "passed": True, "detail": "99 % used"},
        {**friction, "joint": JOINTS[1], "passed": True, "recovered": 0.572, "std": 0.005},
        {**friction, "joint": JOINTS[3], "passed": False, "recovered": 0.3, "detail": "too little"},
    ]
    headline = "the motion would not do: 1 of 3 requirements is not met"
    result = ARM | {"verb": "rehearse", "duration": 10.0, "passed": False, "headline": headline}
    result |= {"items": items, "advice": ["Move wrist_roll_joint faster."]}
    result |= {"effect": {"effect": "payload", "joint": JOINTS[1]}}
    result |= {"limit_values": designed["limit_values"]}
    return result, {key: series[key] for key in ("t", "q", "dq", "tau")}


def _holdout(rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    t, q, dq, ddq = _motion(3000, 12.0, rng)
    clean = SIZE * (0.5 * np.sin(q) + 0.05 * ddq)
    friction = SIZE * (0.12 * np.tanh(dq / 0.02) + 0.05 * dq)
    measured = clean + friction + 0.02 * SIZE * rng.normal(size=q.shape)
    t = np.concatenate([14 + t[:1500], 30 + t[1500:] - t[1500] - 16])  # two recordings joined
    return t, q, dq, measured, 0.85 * clean, clean + 0.98 * friction


def _online(rng: np.random.Generator, rows: int) -> Run:
    """What the monitor saw at 24 looks; too little excitation from 6 to 9 s."""
    t = 1.0 + 0.5 * np.arange(24)
    std = np.exp(-t[:, None] / rng.uniform(2, 20, rows))
    level = [None] * 4 + [0.01 if 6 < x < 9 else 30.0 for x in t[4:]]
    history = {"t": t, "excitation_level": level}
    converged = "converged: the estimate is surer of the torque than a row of data"
    poor = "not exciting enough since 2.1 s: 3 of 40 visible <directions>"
    messages = _rows(t=[4.0, 6.5], text=[converged, poor])
    value = 1 + 0.3 * std * rng.standard_normal(std.shape)
    online = {"delay_s": 0.03, "converged": True, "messages": messages, "history": history}
    return online, {"online_t": t, "online_value": value, "online_std": std}


def _link(name: str, k: int) -> dict[str, Any]:
    mass = {"given": 4.0 - k, "value": 4.2 - k, "decided_by": ("data", "both")[k % 2]}
    centre = {"given": [0.0, 0.1, -0.02], "value": [0.001, 0.11, -0.02]}
    centre |= {"shift": 0.01, "decided_by": "prior"}
    return {"link": name, "mass": mass, "centre": centre, "moved": None}


def _friction(result: dict[str, Any], dq: np.ndarray) -> dict[str, np.ndarray]:
    """Curves of friction over velocity, none of the last joint."""
    known = {"unit": "N·m", "velocity_unit": "rad/s", "per_reading": 1.0}
    for row in result["joints"][:-1]:
        row["friction"] = known
    v = np.nanmax(np.abs(dq), axis=0) * np.linspace(-1, 1, 100)[:, None]
    v[:, -1] = np.nan
    torque = SIZE * (0.12 * np.sign(v) + 0.05 * v)
    curves = {"velocity": v, "torque": torque, "half_width": 0.02 * SIZE + 0 * v}
    return {f"friction_{key}": values for key, values in curves.items()}


def identify_run() -> Run:
    """With all that its options add."""
    rng = np.random.default_rng(2)
    t, q, dq, measured, given, identified = _holdout(rng)
    scale, before, after = (x.std(0) for x in (measured, measured - given, measured - identified))
    given[:, 3] = np.nan
    interval = {"half_width": 0.3, "half_width_parameters": 0.1, "coverage": 0.712}
    validate = [None, *_accuracy(after, scale, interval95=[interval] * NV)[1:]]
    baseline = [*_accuracy(before * [1, 1, 60, 1], scale)[:3], None]
    train = _accuracy(0.95 * after, scale)
    base = _base_parameters()
    online, estimates = _online(rng, len(base))
    payload = {"link": "link7", "mass": {"value": 1.5, "std": 0.002, "unit": "kg"}}
    centre = {"value": [0.02, -0.03, 0.2], "std": [1e-4, 1e-4, 5e-3], "unit": "m"}
    payload |= {"centre_of_mass": centre, "parameters": _parameters()[:10]}
    payload["shortcomings"] = ["centre of mass along z is known to ±10 mm only"]
    payload["notes"] = ["torque was recorded as current: a gain wrong by 1 % makes mass wrong"]
    seen = {"determined": [{"expression": "l2.Izz", "value": 1.0, "std": 0.1}]}
    left = {"missing": ["l2.m"]}
    used = {"recordings": ["r"], "rows": 100}
    stages = [{"link": "l2", "joint": "j2", **used, **seen, **left}, {"link": "l1", "joint": "j1"}]
    by_link = {"determined": 1, "base_parameters": 2, "stages": stages}
    note = "wrist_roll_joint moved too little in the hold-out to be judged there."
    result = FILTERED | {"verb": "identify", "estimator": "physical", "notes": [note]}
    result["effects"] = ["viscous_friction", "coulomb_friction", "torque_offset"]
    result["holdout"] = "The last 30 % of each of 2 recordings was held out."
    result["joints"] = _rows(name=JOINTS, train=train, validate=validate, baseline=baseline)
    result["files"] = ["identified.urdf", "identified.xml", "model.yaml"]
    result["physical"] = {"consistent": True}
    result |= {"link_by_link": by_link, "payload": payload, "online": online}
    series = {"t": t, "measured": measured, "given": given, "identified": identified}
    series |= {"half_width": np.full_like(measured, 0.3), "position": q}
    series["velocity"] = np.where(np.abs(dq) > 0.01, dq, np.nan)
    series |= _friction(result, series["velocity"])
    links = [_link(joint.removesuffix("_joint"), k) for k, joint in enumerate(JOINTS)]
    result |= {"links": links, "faults": diagnose_run()[0]["faults"]}
    result |= {"parameters": _parameters(), "base_parameters": base}
    return result, series | estimates


def _findings() -> list[Any]:
    level = {"name": "elbow_joint.stribeck", "value": 4.8123, "std": 0.0312, "unit": "N·m"}
    speed = {"name": "elbow_joint.stribeck_velocity", "value": 0.0712, "std": None, "unit": "rad/s"}
    stribeck = {"effect": "stribeck_friction", "joints": ["elbow_joint"], "verdict": "named"}
    stribeck |= {"parameters": [level, speed], "explained": 0.731}
    stribeck |= {"holdout": {"rms_before": 4.62, "rms_after": 1.31}, "by_joint": {JOINTS[1]: 4.43}}
    label = "distance since the last reversal, signed by direction [rad]"
    stribeck |= {"figure": {"x_label": label, "joint": "elbow_joint"}}
    move = "Move wrist_roll_joint through ±1.5 rad at 0.2 rad/s with the forearm level."
    why = "A mass at the flange makes the torque of a heavier wrist link."
    rival = {"effect": "payload", "joints": [JOINTS[3]], "why": why, "experiment": move}
    inertia = {"effect": "inertial_parameters", "joints": JOINTS[2:], "verdict": "undecided"}
    inertia |= {"parameters": _parameters()[10:20], "explained": 0.112}
    inertia |= {"holdout": {"rms_before": 1.31, "rms_after": 1.18}}
    inertia |= {"rivals": [rival, dict.fromkeys(rival) | {"effect": "rotor_inertia"}]}
    return [stribeck, inertia, {"effect": "unknown", "joints": []}]


def diagnose_run() -> Run:
    rng = np.random.default_rng(4)
    t, _, dq, measured, given, extended = _holdout(rng)
    scale, before, after = (x.std(0) for x in (measured, measured - given, measured - extended))
    stribeck = 6 * np.sign(dq[:, 1]) * np.exp(-np.abs(dq[:, 1]) / 0.3) + 3 * np.sign(dq[:, 1])
    headline = "elbow_joint has Stribeck friction that the model lacks; the inertia of the forearm "
    cut = {"fault": "saturation", "joints": ["elbow_joint"], "detail": "41 samples at ±87 N·m"}
    left = {"joint": "wrist_roll_joint", "share": 0.021, "structure": "periodic in motor angle"}
    result = FILTERED | {"verb": "diagnose", "headline": headline + "is probably wrong too."}
    for model, rms in (("simulation", before), ("extended", after)):
        result[model] = {"joints": _accuracy(rms, scale, name=JOINTS)}
    result |= {"faults": [cut, {"fault": "duplicate_samples"}]}
    result |= {"unexplained": [left, {"joint": "elbow_joint"}]}
    result["notes"] = ["Velocities below 0.05 rad/s are rare: presliding was not judged."]
    shares = {"constant": 0.02, "direction": 0.81, "velocity": 0.83, "position": 0.0, "load": 0.8}
    error = {"rms": 4.0, "shares": shares, "telling": "direction"}
    wrong = [{"name": name, **error} for name in JOINTS]
    result |= {"findings": _findings(), "error": {"joints": wrong}}
    noise = rng.normal(size=(3, len(t)))
    series = {"t": t, "measured": measured, "simulated": given, "extended": extended}
    series |= {"finding0_x": dq[:, 1], "finding0_residual": stribeck + noise[0]}
    series |= {"finding0_fit": stribeck, "finding1_x": noise[1].cumsum()}
    return result, series | {"finding1_residual": noise[2], "finding1_fit": 0.2 * noise[0]}


def go_run() -> Run:
    sentences = ["Of the torque, the given model misses 62 %.", "Use extended.urdf."]
    verdict = {"sentences": sentences, "use": "extended", "files": ["extended.urdf"]}
    verdict |= {"refused": [], "next": "record more", "verdict": "named"}
    verdict |= {"effect": "stribeck_friction", "joints": ["elbow_joint"]}
    result, series = ARM | {"verb": "go", "verdict": verdict, "notes": ["q was repaired"]}, {}
    for verb in ("robots", "identify", "analyze", "diagnose"):
        result[verb], arrays = BUILDERS[verb]()
        for key in ("verb", "online", "payload", "link_by_link"):
            result[verb].pop(key, None)
        series |= {f"{verb}/{key}": values for key, values in arrays.items()}
    return result | {"files": ["runs/go/extended.urdf"]}, series


def demo_run() -> Run:
    truth = {"parameters": {"level_Nm": 5.0, "velocity_rad_s": 0.07}}
    truth |= {"effect": "stribeck_friction", "joint": "elbow_joint"}
    result, series = go_run()
    result |= {"verb": "demo", "seed": 7, "truth": truth}
    result["verdict"] |= {"truth": "named", "correct": True}
    result["design"], arrays = BUILDERS["design"]()
    del result["design"]["verb"]
    return result, series | {f"design/{key}": values for key, values in arrays.items()}


def compare_run() -> Run:
    """Two demonstrations of the same arm, the second of a worse motion and fit."""
    result, series = demo_run()
    result["design"]["condition_number"]["final"] *= 1.7
    identified = result["identify"]
    for row in (*identified["base_parameters"][::4], *identified["parameters"][::9]):
        row["value"] = (row["value"] or 0.0) + 3 * (row["std"] or 1.0)
    result["diagnose"]["findings"][2]["effect"] = "backlash"
    runs = {"runs/one": demo_run(), "runs/two": (result, series)}
    saved = (SavedRun(name, record_of(full(**run)), more) for name, (run, more) in runs.items())
    return compare(*saved), {}


@cache
def _made(build: Callable[[], Run]) -> Run:
    result, series = build()
    return full(**result), series


def _saved(build: Callable[[], Run]) -> Run:
    """A result as it is read back, the caller's own."""
    return copy.deepcopy(_made(build))


def fleet_run() -> Run:
    name, unit = f"{JOINTS[2]}.Fc", "N·m"
    odd = {"arm": "cell 3", "parameter": name, "unit": unit, "value": 3.4, "std": 0.009}
    odd |= {"siblings": 0.4, "spread": 0.02, "difference": 3.0, "difference_std": 0.01, "count": 4}
    drift = {"arm": "cell 2", "parameter": "link1.mcx + 0.5·link2.m", "unit": "kg·m"}
    drift |= {"per_year": -6.0, "std": 0.1, "before": 2.4, "after": 0.4, "count": 5}
    drift |= {"first": "2026-01-01", "last": "2026-05-01"}
    told = ["The forearm carries 2 kg more than the model has.", "fault: q of joint 2 is held"]
    sets = []
    for k, day in product(range(5), ("2026-01-01", "2026-03-01", "2026-05-01")):
        one = {"name": f"cell {k}/{day}", "arm": f"cell {k}", "date": day}
        sets.append(one | {"type": "made_up_arm", "found": told[: k % 3]})
    failed = "lost: no robot model (robot.urdf or robot.yaml); add one"
    sets.append({"name": "lost", "arm": "lost", "failed": failed})
    result = {"verb": "fleet", "of": f"{len(sets)} data sets", "arms": 5, "types": ["made_up_arm"]}
    result |= {"data_sets": sets, "deviations": [odd, odd], "drifts": [drift]}
    result |= {"notes": ["other: 1 arm; from 4 of a type on one can be told from the others"]}
    days = 20454 + 30.0 * np.arange(5)
    x = np.linspace(2.4, 0.4, 5)
    series = {"drift0/days": days, "drift0/value": x, "drift0/std": np.full(5, 0.02)}
    return result | {"files": ["runs/fleet/parameters.parquet"]}, series


_VERBS = (robots_run, design_run, check_run, show_run, rehearse_run, identify_run, analyze_run)
BUILDERS: dict[str, Callable[[], Run]] = {
    build.__name__.removesuffix("_run"): partial(_saved, build)
    for build in (*_VERBS, diagnose_run, fleet_run, go_run, demo_run, compare_run)
}


def _plain(source: str) -> str:
    source = re.sub(r"<(style|script).*?</\1>|<wbr>", "", source, flags=re.DOTALL)
    return " ".join(unescape(re.sub(r"<[^>]*>", " ", source)).split())


class Shown(HTMLParser):
    """A page as its reader meets it; every element is closed as it was opened."""

    def __init__(self, source: str) -> None:
        super().__init__()
        self.source, self.open = source, []
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.feed(source)
        self.close()
        assert self.open == []
        self.words = _plain(source)
        self.headings = [_plain(h) for h in re.findall(r"<h3[^>]*>(.*?)</h3>", source)]
        drawn = [attrs for _, attrs in self.elements if attrs.get("role") == "img"]
        self.labels = [attrs["aria-label"] or "" for attrs in drawn]

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        if tag not in {"meta", "br", "wbr", "hr", "img", "link", "input"}:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def all(self, tag):
        return [attrs for name, attrs in self.elements if name == tag]


@cache
def _page(verb: str) -> Shown:
    return Shown(html(page_of(*BUILDERS[verb]())))


@pytest.fixture(params=list(BUILDERS))
def run(request: pytest.FixtureRequest) -> Run:
    return BUILDERS[request.param]()


@pytest.fixture(params=list(BUILDERS))
def page(request: pytest.FixtureRequest) -> Shown:
    return _page(request.param)


@pytest.fixture(scope="session", params=list(BUILDERS))
def file(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp(request.param) / "report.html"
    path.write_text(_page(request.param).source, "utf-8")
    return path


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """The system's Chromium, without a window."""
    driver = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed")
    names = ("chromium", "chromium-browser", "google-chrome")
    if (program := next(filter(None, map(shutil.which, names)), None)) is None:
        pytest.skip("no Chromium on the PATH")
    with driver.sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=program)
        yield chromium
        chromium.close()


@pytest.fixture(scope="session")
def make() -> dict[str, Callable[[], Run]]:
    return BUILDERS


@pytest.fixture(scope="session")
def written() -> Callable[[str], Shown]:
    return _page


@pytest.fixture(scope="session")
def show() -> Callable[[dict[str, Any], dict[str, np.ndarray]], Shown]:
    return lambda result, series: Shown(html(page_of(result, series)))
