"""Made-up runs of every verb on a four-joint arm, with the nulls and long names of real ones."""

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from excitant.reports import SavedRun, compare, html, page_of

JOINTS = [
    "shoulder_pan_joint",
    "elbow_joint",
    "right_arm_forearm_roll_actuator_joint_with_a_very_long_name",
    "wrist_roll_joint",
]
NV = len(JOINTS)
LINKS = [f"{joint.removesuffix('_joint')}_link" for joint in JOINTS]
STANDARD = ["m", "mcx", "mcy", "mcz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz"]
SIZE = np.array([40.0, 30.0, 4.0, 0.6])

Run = tuple[dict[str, Any], dict[str, np.ndarray]]
ARM, FILTER = {"robot": "made_up_arm"}, {"cutoff_hz": 12.5, "unit": "N·m"}


def _motion(n: int, duration: float, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    t = np.linspace(0, duration, n)
    w = 2 * np.pi / duration * np.arange(1, 6)
    a, b = rng.normal(size=(2, 5, NV)) / np.arange(1, 6)[:, None]
    s, c = np.sin(np.outer(t, w)), np.cos(np.outer(t, w))
    return t, s @ a + c @ b, (c * w) @ a - (s * w) @ b, -(s * w**2) @ a - (c * w**2) @ b


def _expression(rng: np.random.Generator, link: int, terms: int) -> str:
    text = f"{LINKS[link]}.{STANDARD[int(rng.integers(10))]}"
    for _ in range(terms):
        other = f"{LINKS[int(rng.integers(link, NV))]}.{STANDARD[int(rng.integers(10))]}"
        text += f" {'+' if rng.random() < 0.6 else '−'} {rng.random():.5g}·{other}"
    return text


def _accuracy(rms: float, scale: float) -> dict[str, Any]:
    nrmse = rms / scale
    return {"rms": rms, "nrmse": nrmse, "r2": 1 - nrmse**2, "rms_raw": rms * 1.4}


def _by_joint(rms: np.ndarray, scale: np.ndarray) -> list[dict[str, Any]]:
    return [{"name": n, **_accuracy(rms[j], scale[j])} for j, n in enumerate(JOINTS)]


def _visibility(rng: np.random.Generator) -> dict[str, Any]:
    """What a design shows worst, before and after."""
    weakest = [
        {
            "name": f"{LINKS[k % NV]}.{STANDARD[k]}",
            "expression": _expression(rng, k % NV, 25 if k == 3 else k % 4),
            "unit": "kg·m²",
            "value": None if k == 4 else float(rng.normal()),
            "std_per_unit_noise_initial": 3.0 / (1 + k),
            "std_per_unit_noise_final": 0.15 / (1 + k),
        }
        for k in range(10)
    ]
    return {
        "condition_number_scaled": {"initial": 90.4, "final": 6.21},
        "joint_weights": [1.0] * NV,
        "weakest": weakest,
    }


BOX = {"shape": "box", "size": [0.2, 0.3, 0.9], "position": [0.9, 0.0, 0.45]}
OBSTACLES = [
    {"name": "table", "shape": "half_space", "normal": [0.0, 0.0, 1.0], "offset": -0.1},
    {"name": "pillar", **BOX, "rpy": [0.0, 0.0, 0.4]},
    {"name": "ball", "shape": "sphere", "radius": 0.2, "position": [0.0, 0.9, 0.4]},
    {"name": "cell", "shape": "workspace", "low": [-0.9, -0.9, 0.0], "high": [0.9, 0.9, 1.3]},
    {"name": "far wall", "shape": "box", "size": [1.0, 1.0, 1.0], "position": [40.0, 0.0, 0.0]},
]


def _space(q: np.ndarray) -> dict[str, np.ndarray]:
    """A tool's path and an arm in five poses, as curved as real ones."""
    tool = 0.6 * np.stack([np.cos(q[:, 0]), np.sin(q[:, 0]), 1 + 0.4 * np.sin(q[:, 1])], axis=1)
    share = np.linspace(0, 1, 9)[None, :, None]
    arm = share * tool[::500][:, None] + 0.1 * np.sin(np.pi * share) * np.array([0, 0, 1.0])
    return {"tool": tool, "arm": arm, "arm_t": np.linspace(0.0, 10.0, 5)}


def design_run() -> Run:
    rng = np.random.default_rng(1)
    t, q, dq, ddq = _motion(2001, 10.0, rng)
    most = {"position": abs(q).max(0), "velocity": abs(dq).max(0), "acceleration": abs(ddq).max(0)}
    ends = [9.31 + 0.7 * k**1.5 for k in range(8)]
    starts = [
        {
            "start": k,
            "condition_number": end,
            "status": "converged" if k < 6 else "stopped: time limit",
            "iterations": 40 + 7 * k,
            "history": [*(end + 160 * np.exp(-np.arange(39) / (4 + k))), None],
        }
        for k, end in enumerate(ends)
    ]
    result = {
        "verb": "design",
        **ARM,
        "joints": JOINTS,
        "duration": 10.0,
        "harmonics": 5,
        "columns": "friction",
        "base_parameters": 57,
        "criterion": "condition",
        "condition_number": {"initial": 171.2, "final": 9.31, "lower_bound": 6.02},
        "limits": {"position": 0.9998, "velocity": 1.0, "acceleration": 0.734, "torque": None},
        "limit_values": {
            "position": [[-1.02 * x, 1.02 * x] for x in most["position"]],
            "velocity": most["velocity"].tolist(),
            "acceleration": [*(most["acceleration"] * 1.3)[:-1].tolist(), None],
            "torque": None,
        },
        "worst": {
            "velocity": {"joint": "elbow_joint", "t": 7.77},
            "acceleration": {"joint": 2, "t": None},
            "torque": None,
        },
        "certified": {
            "position": [
                {"low": low, "high": high, "ratio": 0.98, "t": 3.2}
                for low, high in zip(q.min(0), q.max(0), strict=True)
            ],
            "velocity": [{"low": -x, "high": x, "ratio": 1.0, "t": 7.77} for x in most["velocity"]],
            "acceleration": [{"ratio": 0.77, "t": None}, *[None] * (NV - 1)],
            "torque": [None] * NV,
        },
        "revolute": [True] * (NV - 1) + [False],
        **_visibility(rng),
        "clearance_m": 0.043,
        "closest": {"bodies": ["forearm_0", "table"], "t": 5.0, "distance_m": 0.0434},
        "obstacles": OBSTACLES,
        "starts": starts,
        "iterations": 412,
        "wall_s": 23.4,
        "files": ["trajectory.csv", "trajectory.json", "approach.csv", "return.csv"],
    }
    tau = SIZE * (0.5 * np.sin(q) + 0.05 * ddq) + 0.1 * SIZE * np.sign(dq)
    spectra = {
        f"eigenvalues_{key}": np.sort(10 ** rng.uniform(least, 0, 57))[::-1]
        for key, least in (("initial", -4.2), ("final", -1.9))
    }
    return result, {"t": t, "q": q, "dq": dq, "ddq": ddq, "tau": tau, **spectra, **_space(q)}


def check_run() -> Run:
    designed, series = design_run()
    result = {
        "verb": "check",
        **ARM,
        "trajectory": "somebody/trajectory.csv",
        "joints": JOINTS,
        "limits": {"position": 0.81, "velocity": 1.31, "acceleration": None, "torque": 0.5},
        "worst": {"velocity": {"joint": "elbow_joint", "t": 2.5}},
        "limit_values": designed["limit_values"],
        "condition_number": None,
        "holds": False,
        "verdicts": [
            "velocity of elbow_joint reaches 131 % of its limit at 2.5 s: slow down by 1.31.",
            "all other limits hold.",
        ],
    }
    return result, {key: series[key] for key in ("t", "q", "dq", "ddq")}


def rehearse_run() -> Run:
    designed, series = design_run()
    friction = {"name": "viscous friction", "unit": "N·m·s/rad", "planted": 0.57}
    items = [
        {"name": "velocity limits", "joint": JOINTS[2], "passed": True, "detail": "99 % used"},
        {**friction, "joint": JOINTS[1], "recovered": 0.572, "std": 0.005, "passed": True,
         "detail": "planted 0.57, recovered 0.572 ± 0.005 N·m·s/rad"},
        {**friction, "joint": JOINTS[3], "recovered": 0.3, "std": None, "passed": False,
         "detail": "planted 0.57, recovered 0.3 N·m·s/rad"},
        {"name": "base parameters", "joint": None, "passed": True, "planted": None,
         "detail": "94.2 % of 312 cases within their 95 % intervals (13 parameters, 24 readings)"},
    ]  # fmt: skip
    result = {
        "verb": "rehearse",
        **ARM,
        "joints": JOINTS,
        "duration": 10.0,
        "passed": False,
        "headline": "the motion would not do: 1 of 4 requirements is not met",
        "items": items,
        "advice": ["Move wrist_roll_joint faster."],
        "effect": {"effect": "payload", "joint": JOINTS[1]},
        "limit_values": designed["limit_values"],
    }
    return result, {key: series[key] for key in ("t", "q", "dq", "tau")}


def _holdout(rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    t, q, dq, ddq = _motion(3000, 12.0, rng)
    clean = SIZE * (0.5 * np.sin(q) + 0.05 * ddq)
    friction = SIZE * (0.12 * np.tanh(dq / 0.02) + 0.05 * dq)
    measured = clean + friction + 0.02 * SIZE * rng.normal(size=q.shape)
    t = np.concatenate([14 + t[:1500], 30 + t[1500:] - t[1500] - 16])  # two recordings joined
    return t, dq, measured, 0.85 * clean, clean + 0.98 * friction


def identify_run() -> Run:
    rng = np.random.default_rng(2)
    t, _, measured, given, identified = _holdout(rng)
    scale, before, after = (x.std(0) for x in (measured, measured - given, measured - identified))
    given = given.copy()
    given[:, 3] = np.nan
    joints = [
        {
            "name": name,
            "train": _accuracy(0.95 * after[j], scale[j]),
            "validate": None if j == 0 else _accuracy(after[j], scale[j]),
            "baseline": None if j == 3 else _accuracy(before[j] * (60 if j == 2 else 1), scale[j]),
        }
        for j, name in enumerate(JOINTS)
    ]
    parameters, base = [], []
    for j, link in enumerate(LINKS):
        for k, symbol in enumerate(STANDARD):
            category = ["unique", "combined", "unidentifiable"][int(rng.integers(3))]
            row = {
                "name": f"{link}.{symbol}",
                "link": link,
                "value": float(rng.normal() * 10 ** rng.uniform(-5, 1)),
                "std": None if category == "unidentifiable" else float(10 ** rng.uniform(-5, 0)),
                "unit": "kg" if k == 0 else "kg·m" if k < 4 else "kg·m²",
                "category": category,
                "prior": None if j == 1 else float(rng.normal()),
                "prior_dominated": category != "unique",
            }
            parameters.append(row)
    for k in range(57):
        value, std = float(rng.normal()), None if k == 9 else float(10 ** rng.uniform(-4, -0.3))
        name = _expression(rng, k % NV, 25 if k == 3 else int(rng.integers(6)))
        base.append(
            {"expression": name, "value": value, "std": std, "rel_std": std and abs(std / value)}
        )
    result = {
        "verb": "identify",
        **ARM,
        "estimator": "physical",
        "effects": ["viscous_friction", "coulomb_friction", "torque_offset"],
        **FILTER,
        "holdout": "The last 30 % of each of 2 recordings was held out.",
        "joints": joints,
        "parameters": parameters,
        "base_parameters": base,
        "physical": {"consistent": True, "violations": []},
        "notes": ["wrist_roll_joint moved too little in the hold-out to be judged there.", None],
        "files": ["identified.urdf", "identified.xml", "model.yaml"],
    }
    return result, {"t": t, "measured": measured, "given": given, "identified": identified}


def analyze_run() -> Run:
    rng = np.random.default_rng(3)
    links = []
    for j, (link, joint) in enumerate(zip(LINKS, JOINTS, strict=True)):
        names = [f"{link}.{symbol}" for symbol in STANDARD]
        unique, combined, none = names[:0], names[9:], names[:9]
        if j:
            unique, combined, none = names[5:6] + names[7:9], names[:5] + names[9:], names[6:7]
        groups = [
            {"expression": _expression(rng, j, 24 if i == 1 else 4), "members": combined}
            for i in range(3)
        ]
        row = {"link": link, "joint": None if j == 3 else joint, "unique": unique}
        links.append({**row, "combined": groups, "unidentifiable": none})
    practical = [
        {
            "name": _expression(rng, k % NV, k % 4),
            "std": float(10 ** rng.uniform(-4, 0)),
            "rel_std": None if k == 4 else float(10 ** rng.uniform(-3, 1.5)),
            "verdict": ["good", "fair", "poor"][k % 3],
        }
        for k in range(57)
    ]
    counts = {"standard_parameters": 70, "base_parameters": 43, "condition_number": 31.4159}
    result = {"verb": "analyze", **ARM, **counts, "links": links, "practical": practical}
    return result, {"singular_values": np.sort(10 ** rng.uniform(-2, 1, 43))[::-1]}


def _findings() -> list[dict[str, Any]]:
    level = {"name": "elbow_joint.stribeck", "value": 4.8123, "std": 0.0312, "unit": "N·m"}
    speed = {"name": "elbow_joint.stribeck_velocity", "value": 0.0712, "std": None, "unit": "rad/s"}
    first = {
        "effect": "stribeck_friction",
        "joints": ["elbow_joint"],
        "parameters": [level, speed],
        "explained": 0.731,
        "holdout": {"rms_before": 4.62, "rms_after": 1.31},
        "verdict": "named",
        "rivals": [],
        "figure": {"x_label": "velocity of elbow_joint [rad/s]", "joint": "elbow_joint"},
    }
    rival = {
        "effect": "payload",
        "joints": [JOINTS[3]],
        "why": "A mass at the flange makes the torque of a heavier wrist link.",
        "experiment": "Move wrist_roll_joint through ±1.5 rad at 0.2 rad/s, first with the "
        "forearm level, then upright.",
    }
    second = {
        "effect": "inertial_parameters",
        "joints": [JOINTS[2], "wrist_roll_joint"],
        "parameters": [
            {"name": f"{LINKS[2]}.{s}", "value": 0.001234 * k, "std": 1e-5, "unit": "kg·m²"}
            for k, s in enumerate(STANDARD)
        ],
        "explained": 0.112,
        "holdout": {"rms_before": 1.31, "rms_after": 1.18},
        "verdict": "undecided",
        "rivals": [rival, dict.fromkeys(rival) | {"effect": "rotor_inertia"}],
        "figure": None,
    }
    third = {"effect": "unknown", "joints": None, "parameters": None, "explained": None}
    return [first, second, third]


def diagnose_run() -> Run:
    rng = np.random.default_rng(4)
    t, dq, measured, given, extended = _holdout(rng)
    scale, before, after = (x.std(0) for x in (measured, measured - given, measured - extended))
    stribeck = 6 * np.sign(dq[:, 1]) * np.exp(-np.abs(dq[:, 1]) / 0.3) + 3 * np.sign(dq[:, 1])
    steps = {
        "as given": 4.62,
        "+ stribeck_friction at elbow_joint": 1.31,
        f"+ inertial_parameters at {JOINTS[2]}, wrist_roll_joint": 1.18,
        "+ unknown": None,
    }
    result = {
        "verb": "diagnose",
        "headline": "elbow_joint has Stribeck friction that the model lacks; the inertia of the "
        "forearm is probably wrong too.",
        **ARM,
        **FILTER,
        "simulation": {"joints": _by_joint(before, scale)},
        "faults": [
            {"fault": "saturation", "joints": ["elbow_joint"], "detail": "41 samples at ±87 N·m"},
            {"fault": "duplicate_samples", "joints": None, "detail": None},
        ],
        "findings": _findings(),
        "unexplained": [
            {"joint": "wrist_roll_joint", "share": 0.021, "structure": "periodic in motor angle"},
            {"joint": "elbow_joint", "share": None, "structure": None},
        ],
        "extended": {
            "joints": _by_joint(after, scale),
            "files": ["extended.urdf", "extended.yaml"],
        },
        "waterfall": [{"label": label, "rms": rms} for label, rms in steps.items()],
        "notes": ["Velocities below 0.05 rad/s are rare: presliding was not judged."],
    }
    series = {
        "t": t,
        "measured": measured,
        "simulated": given,
        "extended": extended,
        "finding0_x": dq[:, 1],
        "finding0_residual": stribeck + rng.normal(size=len(t)),
        "finding0_fit": stribeck,
        "finding1_x": np.cumsum(rng.normal(size=len(t))),
        "finding1_residual": rng.normal(size=len(t)),
        "finding1_fit": 0.2 * rng.normal(size=len(t)),
    }
    return result, series


def demo_run() -> Run:
    effect = "stribeck_friction"
    parameters = {"level_Nm": 5.0, "velocity_rad_s": 0.07}
    result: dict[str, Any] = {
        "verb": "demo",
        **ARM,
        "seed": 7,
        "truth": {"effect": effect, "joint": "elbow_joint", "parameters": parameters},
        "verdict": {"effect": effect, "joints": ["elbow_joint"], "correct": True},
    }
    series = {}
    for build in (design_run, identify_run, analyze_run, diagnose_run):
        content, arrays = build()
        verb = content.pop("verb")
        result[verb] = content
        series |= {f"{verb}/{key}": values for key, values in arrays.items()}
    return result, series


def compare_run() -> Run:
    """Two demonstrations of the same arm, the second of a worse motion and fit."""
    result, series = demo_run()
    result["design"]["condition_number"]["final"] *= 1.7
    identified = result["identify"]
    for row in (*identified["base_parameters"][::4], *identified["parameters"][::9]):
        row["value"] += 3 * (row["std"] or 1.0)
    result["diagnose"]["findings"][2]["effect"] = "backlash"
    return compare(SavedRun("runs/one", *demo_run()), SavedRun("runs/two", result, series)), {}


_ALL = (design_run, check_run, rehearse_run, identify_run, analyze_run, diagnose_run, demo_run)
BUILDERS: dict[str, Callable[[], Run]] = {
    build.__name__.removesuffix("_run"): build for build in (*_ALL, compare_run)
}


@cache
def _page(verb: str) -> str:
    return html(page_of(*BUILDERS[verb]()))


@pytest.fixture(params=list(BUILDERS))
def run(request: pytest.FixtureRequest) -> Run:
    """A run of each verb."""
    return BUILDERS[request.param]()


@pytest.fixture(params=list(BUILDERS))
def page(request: pytest.FixtureRequest) -> str:
    """The page of each verb."""
    return _page(request.param)


@pytest.fixture(scope="session", params=list(BUILDERS))
def file(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of each verb as a file."""
    path = tmp_path_factory.mktemp(request.param) / "report.html"
    path.write_text(_page(request.param), "utf-8")
    return path


@pytest.fixture(scope="session")
def make() -> dict[str, Callable[[], Run]]:
    """How to make a run, by verb."""
    return BUILDERS


@pytest.fixture(scope="session")
def written() -> Callable[[str], str]:
    """The page of a verb's run as it is, written once for all tests."""
    return _page


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Drawings are not written, which takes most of a page's time."""
    monkeypatch.setattr("excitant.reports.drawing._svg", lambda *_: "<svg></svg>")
