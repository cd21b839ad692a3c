"""What robustness.py feeds to excitant: sound files, their damage, and extreme arms."""

import json
import re
import shutil
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pinocchio as pin
import scipy.io
import yaml

Rng = np.random.Generator
Array = np.ndarray
TESTS = Path(__file__).resolve().parents[1] / "tests"

# Damage of files

VALUES = (
    "nan", "inf", "-inf", "1e400", "1e308", "1e-320", "0", "-1", "", "abc", "1,5", "1 2", "{", "[",
    "1" * 400, "é", "\0", "&lt;", "true", "null", "../../../etc/passwd", "*a", "&a [*a]",
    "${__import__('os').system('touch ran')}", "${9**9**8}", "$(env HOME)", "/dev/zero",
    '!!python/object/apply:os.system ["touch ran"]', "-9223372036854775809",
)  # fmt: skip
PATTERNS = (
    r"-?\d+\.?\d*(?:e[-+]?\d+)?", r'(?<=")[^"]*(?=")', r"[A-Za-z_]+", r"[^\n]*\n", r"<[^>]*>",
)  # fmt: skip


def damaged_text(rng: Rng, content: bytes) -> bytes:
    """One or two words, lines or tags replaced, doubled or cut out; or the end cut off."""
    text = content.decode()
    for _ in range(rng.integers(1, 3)):
        found = [*re.finditer(str(rng.choice(PATTERNS)), text)]
        if rng.random() < 0.05:
            text = text[: rng.integers(len(text) + 1)]
        elif found:
            at, other = (found[k] for k in rng.integers(len(found), size=2))
            news = VALUES if rng.random() < 0.5 else (other[0], other[0] * 2, "")
            new = news[rng.integers(len(news))]
            text = text[: at.start()] + new + text[at.end() :]
    return text.encode()


def damaged_bytes(rng: Rng, content: bytes) -> bytes:
    """One to three bytes flipped, set, inserted or deleted, many of them at the head; or a cut."""
    data = bytearray(content)
    for _ in range(rng.integers(1, 4)):
        k = int(rng.integers(max(1, int(len(data) * rng.choice([0.02, 1.0])))))
        kind = rng.choice(["flip", "set", "insert", "delete", "cut"], p=[0.3, 0.3, 0.15, 0.15, 0.1])
        end = len(data) if kind == "cut" else k + (kind != "insert")
        byte = int(rng.integers(256))
        flipped = data[k] ^ 1 << byte % 8 if k < len(data) else byte
        data[k:end] = {"flip": [flipped], "set": [byte], "insert": [byte]}.get(str(kind), [])
    return bytes(data)


def damaged_table(rng: Rng, table: pd.DataFrame) -> tuple[str, pd.DataFrame]:
    """What goes wrong in logs: cells, stretches, columns, units, signs, order, time."""
    n, columns, rows = len(table), [*table.columns[1:]], table.copy()
    one, two = map(str, rng.choice(columns, 2, replace=False))
    at, much = int(rng.integers(n)), int(rng.integers(1, n // 4))
    size = float(table[one].abs().max())
    span = slice(at, at + much)
    held = {"hole": np.nan, "held": table[one][at], "zeros": 0.0}
    kind = str(rng.choice([*COLUMNS, *held, "swapped", "lost", "again"]))
    if kind in COLUMNS:
        column = "t" if kind in ("time", "backwards") else one
        rows[column] = COLUMNS[kind](rng, table[column].to_numpy(), size)
    elif kind in held:
        rows.iloc[span, rows.columns.get_loc(one)] = held[kind]
    elif kind == "swapped":
        rows[[one, two]] = table[[two, one]].to_numpy()
    elif kind == "lost":
        rows = rows.drop(rows.index[span])
    else:
        rows = pd.concat([rows[:at], rows[at:][:much], rows[at:]])
    return f"{kind} {one}" + (f", {two}" if kind == "swapped" else ""), rows


COLUMNS: dict[str, Callable[[Rng, Array, float], Any]] = {
    "spike": lambda rng, x, m: np.where(np.arange(len(x)) == rng.integers(len(x)), 1e3 * m, x),
    "dead": lambda rng, x, m: rng.choice([0.0, m]),
    "negative": lambda rng, x, m: -x,
    "degrees": lambda rng, x, m: np.rad2deg(x),
    "noise": lambda rng, x, m: x + 0.3 * m * rng.standard_normal(len(x)),
    "coarse": lambda rng, x, m: (m / 4) * (x * 4 // m),
    "clipped": lambda rng, x, m: x.clip(-m / 3, m / 3),
    "late": lambda rng, x, m: np.append(np.zeros(8), x[:-8]),
    "time": lambda rng, x, m: x * rng.choice([1e-3, 0.5, 1e3, 1e6, 1e9]),
    "backwards": lambda rng, x, m: x[::-1],
    "shuffled": lambda rng, x, m: rng.permutation(x),
}
"""Of a column, or of time, and the largest value of the column."""

# Sound files


MAP = "t: time\nq: 'angle_{1}'\ntau: 'moment_{1}'\nunits: {t: ms}\n"
CELL = """- workspace: {low: [-0.9, -0.5, -0.9], high: [1.0, 0.5, 1.0]}
- name: ceiling
  half_space: {normal: [0, 0, -1], offset: -0.95}
- box: {size: [0.2, 0.4, 0.2], position: [-0.8, 0, 0]}
- sphere: {radius: 0.1, position: [-0.8, 0, 0]}
"""
LIMITS = "position: [[-2, 2], [-2, 2]]\nvelocity: 3\nacceleration: {joint1: 9}\njerk: [90, 90]\n"
KNOWN = "total_mass: 8\nlinks:\n  link2: {mass: {value: 3, std: 0.1}}\n"


def write_corpus(folder: Path) -> None:
    """Every kind of file that excitant reads, sound: of planar_2r, beside the tests' arms."""
    from excitant.cli import main
    from excitant.design import random_trajectory, trajectory_csv, trajectory_json
    from excitant.robots import load_robot

    sys.path.append(str(TESTS))
    from bags import joint_states

    shutil.copytree(TESTS / "robots" / "data", folder / "data")
    arm, rng = load_robot("planar_2r"), np.random.default_rng(0)
    (folder / "planar.urdf").write_text(arm.urdf)
    texts = {"arm.yaml": "model: planar.urdf\ngravity: [0, 0, -9.81]\nlimits: {acceleration: 20}\n"}
    t, few = np.arange(0, 8, 0.01), slice(250)
    for name in ("run1", "run2"):
        path = random_trajectory(arm, rng, 8.0, 4)
        states = tuple(path(t, order) for order in range(3))
        table = planar(arm.urdf).table(rng, t, states)
        table.to_csv(folder / f"{name}.csv", index=False)
    q, dq, tau = (x[few] for x in (*states[:2], table[["tau1", "tau2"]].to_numpy()))
    (folder / "trajectory.csv").write_text(trajectory_csv(path))
    (folder / "trajectory.json").write_text(trajectory_json(path, arm))
    table[few].to_csv(folder / "log.csv", index=False, sep=";", decimal=",")
    table[few].to_csv(folder / "log.csv.gz", index=False)
    table[few].to_json(folder / "log.jsonl", orient="records", lines=True)
    table[few].to_parquet(folder / "log.parquet")
    np.savez(folder / "log.npz", **{name: table[name][few] for name in table})
    scipy.io.savemat(folder / "log.mat", {"t": t[few], "q": q, "tau": tau})
    for name, kind in (("log.bag", "bag"), ("ros", "mcap"), ("sql", "db3")):
        joint_states(folder / name, kind, arm.joints, t[few], (q, dq, tau))
    renamed = {"t": "time"} | {f"q{j}": f"angle_{j}" for j in (1, 2)}
    renamed |= {f"tau{j}": f"moment_{j}" for j in (1, 2)}
    table[few].assign(t=1e3 * t[few]).rename(columns=renamed).to_csv(folder / "ms.csv", index=False)
    texts |= {"columns.yaml": MAP, "cell.yaml": CELL, "limits.yaml": LIMITS, "known.yaml": KNOWN}
    for name, text in texts.items():
        (folder / name).write_text(text)
    (folder / "set").mkdir()
    for name in ("run1.csv", "run2.csv", "planar.urdf"):
        shutil.copy(folder / name, folder / "set" / name)
    about = {
        "kinematics": {"urdf": "planar.urdf"},
        "torque": {"column": "tau"},
        "recordings": {"run1.csv": {"role": "excitation"}, "run2.csv": {"role": "validation"}},
    }
    (folder / "set" / "dataset.json").write_text(json.dumps(about, indent=1))
    runs = f"{folder}/run1.csv --validate {folder}/run2.csv -o {folder}/model"
    assert main(f"identify planar_2r {runs}".split()) == 0


# Arms and their simulation, which share nothing with excitant


def heavier(model: Any, shares: float | Array) -> Any:
    """The model with each body's mass and inertia times a share of its own."""
    other = model.copy()
    for k, share in enumerate(np.broadcast_to(shares, model.nv), start=1):
        body = model.inertias[k]
        other.inertias[k] = pin.Inertia(share * body.mass, body.lever, share * body.inertia)
    return other


def simulated(model: Any, states: tuple[Array, ...]) -> Array:
    """Rigid-body torque by Pinocchio's recursive Newton-Euler algorithm."""
    data = model.createData()
    return np.array([pin.rnea(model, data, *x).copy() for x in zip(*states, strict=True)])


def motion(rng: Rng, t: Array, scale: Array) -> tuple[Array, Array, Array]:
    """A sum of four sines per joint: positions, velocities, accelerations."""
    omega = 2 * np.pi * np.array([0.1, 0.2, 0.3, 0.5])[:, None]
    size = rng.uniform(-0.3, 0.3, (4, len(scale))) * scale
    angle = omega * t[:, None, None] + rng.uniform(0, 2 * np.pi, (4, len(scale)))
    q, dq, ddq = ((size * omega**k * np.sin(angle + k * np.pi / 2)).sum(axis=1) for k in range(3))
    return q, dq, ddq


@dataclass(frozen=True)
class ExtremeArm:
    """An arm as it is described, and as it is."""

    words: str  # what is extreme about it
    files: dict[str, str]
    true: Any  # Pinocchio's model
    friction: Array
    scale: Array  # of its motions: 1 where a joint turns

    def table(self, rng: Rng, t: Array, states: tuple[Array, ...]) -> pd.DataFrame:
        """A recording with noise of 0.5 % of the largest torque."""
        tau = self.torque(states)
        tau += 0.005 * np.abs(tau).max(axis=0) * rng.standard_normal(tau.shape)
        columns = [f"{x}{j + 1}" for x in ("q", "tau") for j in range(tau.shape[1])]
        noisy = states[0] + 2e-5 * rng.standard_normal(tau.shape)
        return pd.DataFrame(np.column_stack([t, noisy, tau]), columns=["t", *columns])

    def torque(self, states: tuple[Array, ...]) -> Array:
        """What the arm needs: half as much viscous friction at 1 rad/s as there is dry one."""
        dq = states[1]
        return simulated(self.true, states) + self.friction * (np.tanh(dq / 0.005) + 0.5 * dq)


def planar(urdf: str) -> ExtremeArm:
    """What planar_2r is, 8 % heavier than described and rubbing."""
    model = heavier(pin.buildModelFromXML(urdf), 1.08)
    return ExtremeArm("planar_2r", {}, model, np.array([2.0, 1.0]), np.ones(2))


ANGLES = {
    "0": 0.0, "1.5707963": np.pi / 2, "1.57": np.pi / 2, "-1.5708": -np.pi / 2,
    "3.14159": np.pi, "0.785398": np.pi / 4, "0.3": 0.3,
}  # fmt: skip
BODY = """<inertial><origin xyz="{com}"/><mass value="{m:.9g}"/>
<inertia ixx="{i:.9g}" iyy="{i:.9g}" izz="{i:.9g}" ixy="0" ixz="0" iyz="0"/></inertial>"""
JOINT = """<link name="l{k}">{body}</link><joint name="j{k}" type="{kind}"><parent link="l{p}"/>
<child link="l{k}"/><origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>{limit}{mimic}</joint>"""


def extreme_arm(rng: Rng) -> ExtremeArm:
    """1 to 14 joints of all kinds; bodies of all sizes or none; rounded angles; any gravity."""
    n = int(rng.choice([1, 1, 2, 2, 3, 4, 5, 6, 7, 7, 8, 10, 12, 14]))
    light = 10 ** rng.uniform(-3, 3) if rng.random() < 0.4 else 1.0
    alike = rng.random() < 0.2  # all axes alike, as of a selective compliance arm
    kinds = rng.choice(["revolute", "continuous", "prismatic"], n, p=[0.65, 0.15, 0.2])
    mimic = n > 2 and rng.random() < 0.2
    empty = set(rng.choice(n, rng.integers(0, 2 if n > 1 else 1), replace=False).tolist())
    empty |= {n - 1} if n > 1 and rng.random() < 0.15 else set()
    words = [f"{n} joints", f"masses x {light:.2g}"] + ["mimic"] * mimic
    words += ["parallel axes"] * alike + [f"no body at {sorted(empty)}"] * bool(empty)
    words += ["sliding"] * ("prismatic" in kinds)
    told, true = [], []
    for k in range(n):
        m = light * 3.0 / (k + 1) * 10 ** (rng.uniform(-3, 1) if rng.random() < 0.1 else 0.0)
        com = rng.uniform(-0.1, 0.1, 3) if rng.random() < 0.8 else np.zeros(3)
        body = {"com": "{} {} {}".format(*com), "m": m, "i": m * rng.uniform(0.002, 0.02)}
        small = body | {"m": 0.02 * m, "i": 0.02 * body["i"]}
        angle = str(rng.choice([*ANGLES])) if not alike else "0"
        axis = "0 0 1" if alike else str(rng.choice(["1 0 0", "0 1 0", "0 0 1", "0 0 -1"]))
        slides = kinds[k] == "prismatic"
        reach = 0.4 if slides else 2.5
        limit = f'<limit lower="{-reach}" upper="{reach}" velocity="2" effort="EFFORT{k}"/>'
        link: dict[str, Any] = {"k": k + 1, "p": k, "kind": kinds[k], "axis": axis, "limit": limit}
        link |= {"xyz": "{:.4f} {:.4f} {:.4f}".format(*rng.uniform(-0.3, 0.3, 3))}
        link |= {"mimic": '<mimic joint="j1"/>' if mimic and k == n - 1 else ""}
        told.append(
            link | {"rpy": f"{angle} 0 0", "body": "" if k in empty else BODY.format(**body)}
        )
        whole = BODY.format(**(small if k in empty else body))
        kind = kinds[k].replace("continuous", "revolute")  # as many positions as speeds
        true.append(link | {"rpy": f"{ANGLES[angle]!r} 0 0", "body": whole, "kind": kind})
    gravity = [np.array([0, 0, -9.81]), np.zeros(3), np.array([0, 6.9, -6.9])]
    g = gravity[rng.choice(3, p=[0.7, 0.15, 0.15])]
    words += ["no gravity"] * (not g.any())
    model = pin.buildModelFromXML(_urdf(true).replace("EFFORT", "1"))
    model.gravity.linear = g
    if mimic:
        model = pin.buildReducedModel(model, [n], pin.neutral(model))
    scale = np.where(kinds[: model.nv] == "prismatic", 0.3, 1.0)
    model = heavier(model, rng.uniform(0.9, 1.1, model.nv))
    states = motion(rng, np.arange(0, 10, 0.05), scale)
    size = np.abs(simulated(model, states)).max(axis=0)
    friction = np.maximum(0.05 * size, 1e-3 * size.max())
    text = _urdf(told)
    for k in range(n):
        effort = 6 * (size + friction)[min(k, model.nv - 1)]
        text = text.replace(f'"EFFORT{k}"', f'"{effort:.6g}"')
    robot: dict[str, Any] = {"model": "arm.urdf", "gravity": g.tolist()}
    robot |= {"lock": {f"j{n}": 0.0}} if mimic else {}
    files = {"arm.urdf": text, "arm.yaml": yaml.safe_dump(robot)}
    return ExtremeArm(", ".join(words), files, model, friction, scale)


def _urdf(joints: list[dict[str, Any]]) -> str:
    parts = "\n".join(JOINT.format(**joint) for joint in joints)
    return f'<robot name="arm"><link name="l0"/>{parts}</robot>'
