"""Trajectories as files: CSV at a control rate, JSON with the exact coefficients."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from excitant.design.splines import SplineTrajectory
from excitant.design.trajectory import FourierTrajectory, Trajectory
from excitant.exceptions import BadInput
from excitant.robots import Array, Motion, Robot

_COEFFICIENTS = {"fourier": ("offset", "cosine", "sine"), "spline": ("control_points",)}
_KINDS = ("q", "dq", "ddq")


def motion_csv(motion: Motion) -> str:
    """Table ``t,q1..,dq1..,ddq1..`` in full double precision."""
    header = ",".join(["t", *(f"{kind}{j + 1}" for kind in _KINDS for j in range(motion.nv))])
    table = np.column_stack([motion.t, motion.q, motion.dq, motion.ddq])
    lines = [",".join(repr(float(value)) for value in row) for row in table]
    return "\n".join([header, *lines]) + "\n"


def trajectory_csv(trajectory: Trajectory, rate_hz: float = 100.0, repetitions: int = 1) -> str:
    """Periods at a control rate [Hz] as a table, first and last sample included."""
    return motion_csv(trajectory.motion(rate_hz, repetitions))


def trajectory_json(trajectory: Trajectory, robot: Robot) -> str:
    """The exact coefficients, with the names of the joints."""
    form = "spline" if isinstance(trajectory, SplineTrajectory) else "fourier"
    content: dict[str, Any] = {
        "format": form,
        "robot": robot.name,
        "joints": list(robot.joints),
        "period": trajectory.period,
        "harmonics": trajectory.harmonics,
    }
    for name in _COEFFICIENTS[form]:
        content[name] = getattr(trajectory, name).tolist()
    return json.dumps(content, indent=1) + "\n"


def load_trajectory(path: str | Path, robot: Robot) -> Trajectory | Motion:
    """Trajectory from a ``.json`` file of coefficients or a table of samples (CSV).

    Raises:
        BadInput: Unreadable, missing columns, another number of joints, values that are not
            finite numbers, or time that does not increase; names file, row and column. Rows
            count from 0 after the header.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise BadInput(f"trajectory {path}: no such file") from None
    except (OSError, UnicodeDecodeError):
        raise BadInput(f"trajectory {path}: not a readable text file; give CSV or JSON") from None
    if path.suffix.lower() == ".json":
        return _from_json(text, path, robot)
    return _from_csv(text, path, robot)


def _from_json(text: str, path: Path, robot: Robot) -> Trajectory:
    try:
        content = json.loads(text)
    except ValueError as error:
        raise BadInput(f"trajectory {path}: not JSON ({error})") from None
    names = _COEFFICIENTS["fourier"]
    if not isinstance(content, dict):
        raise BadInput(f"trajectory {path}: expected an object with {', '.join(names)}")
    if "control_points" in content:
        names = _COEFFICIENTS["spline"]
    missing = [name for name in ("period", *names) if name not in content]
    if missing:
        raise BadInput(f"trajectory {path}: entry '{missing[0]}' is missing")
    joints = content.get("joints")
    if isinstance(joints, list) and len(joints) == robot.nv and tuple(joints) != robot.joints:
        raise BadInput(
            f"trajectory {path}: its joints {', '.join(map(str, joints))} are not those of "
            f"{robot.name} ({', '.join(robot.joints)})"
        )
    arrays = [
        _numbers(content[name], name, path, robot, dimensions=1 if name == "offset" else 2)
        for name in names
    ]
    period = content["period"]
    number = isinstance(period, int | float) and not isinstance(period, bool)
    if not number or not (math.isfinite(period) and period > 0):
        raise BadInput(f"trajectory {path}: period {period!r} is not a positive number of seconds")
    if len(arrays) == 1:
        return _spline(arrays[0], float(period), path)
    offset, cosine, sine = arrays
    if len(cosine) != len(sine):
        raise BadInput(
            f"trajectory {path}: {len(cosine)} rows of 'cosine' but {len(sine)} of 'sine'"
        )
    return FourierTrajectory(offset, cosine, sine, float(period))


def _spline(control_points: Array, period: float, path: Path) -> SplineTrajectory:
    try:
        return SplineTrajectory(control_points, period)
    except ValueError as error:
        raise BadInput(f"trajectory {path}: {error}") from None


def _numbers(value: Any, name: str, path: Path, robot: Robot, *, dimensions: int) -> Array:
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError):
        raise BadInput(f"trajectory {path}: '{name}' is not a table of numbers") from None
    if array.ndim != dimensions or array.shape[-1] != robot.nv:
        raise BadInput(
            f"trajectory {path}: '{name}' has shape {array.shape}, but {robot.name} has "
            f"{robot.nv} joints"
        )
    if not np.isfinite(array).all():
        raise BadInput(f"trajectory {path}: '{name}' holds a value that is not finite")
    return array


def _from_csv(text: str, path: Path, robot: Robot) -> Motion:
    lines = [line for line in text.splitlines() if line.strip()]
    if len(lines) < 3:
        raise BadInput(f"trajectory {path}: needs a header and at least two rows")
    header = [name.strip() for name in lines[0].split(",")]
    index = _column_index(header, path, robot)
    table = np.empty((len(lines) - 1, len(header)))
    for row, line in enumerate(lines[1:]):
        table[row] = _parse_row(line, row, header, path)
    used = list(index.values())
    bad = np.argwhere(~np.isfinite(table[:, used]))
    if len(bad):
        row, column = int(bad[0, 0]), header[used[int(bad[0, 1])]]
        value = table[row, used[int(bad[0, 1])]]
        raise BadInput(f"trajectory {path}: row {row}, column '{column}': {value} is not finite")
    t = table[:, index["t"]]
    stuck = np.flatnonzero(np.diff(t) <= 0)
    if len(stuck):
        row = int(stuck[0]) + 1
        raise BadInput(
            f"trajectory {path}: row {row}, column 't': {t[row]:g} s does not come after "
            f"{t[row - 1]:g} s; time must increase"
        )
    parts = [table[:, [index[f"{kind}{j + 1}"] for j in range(robot.nv)]] for kind in _KINDS]
    return Motion(t, *parts)


def _column_index(header: list[str], path: Path, robot: Robot) -> dict[str, int]:
    wanted = ["t", *(f"{kind}{j + 1}" for kind in _KINDS for j in range(robot.nv))]
    given = sum(name.startswith("q") and name[1:].isdigit() for name in header)
    if given and given != robot.nv:
        raise BadInput(
            f"trajectory {path}: {given} joint columns q1..q{given}, but {robot.name} has "
            f"{robot.nv} joints"
        )
    missing = [name for name in wanted if name not in header]
    if missing:
        raise BadInput(
            f"trajectory {path}: column '{missing[0]}' is missing; the header must name "
            f"t, q1..q{robot.nv}, dq1..dq{robot.nv}, ddq1..ddq{robot.nv}"
        )
    double = [name for name in wanted if header.count(name) > 1]
    if double:
        raise BadInput(f"trajectory {path}: column '{double[0]}' occurs more than once")
    return {name: header.index(name) for name in wanted}


def _parse_row(line: str, row: int, header: list[str], path: Path) -> list[float]:
    cells = line.split(",")
    if len(cells) != len(header):
        raise BadInput(
            f"trajectory {path}: row {row} has {len(cells)} values, the header {len(header)}"
        )
    values = []
    for name, cell in zip(header, cells, strict=True):
        try:
            values.append(float(cell))
        except ValueError:
            raise BadInput(
                f"trajectory {path}: row {row}, column '{name}': '{cell.strip()}' is not a number"
            ) from None
    return values
