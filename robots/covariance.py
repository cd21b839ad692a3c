"""Covariance of an arm's parameters as a file: CSV, a column for each, named in the first line."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from excitant.exceptions import BadRobot
from excitant.robots.files import read_description
from excitant.robots.motion import Array
from excitant.robots.robot import Robot
from excitant.robots.torque import column_names

_AGAIN = "write the model again, or leave the entry 'covariance' out of it"
_ROUNDING = 1e-8  # of a correlation matrix, by which it may fall short of one


def covariance_csv(robot: Robot, covariance: Array) -> str:
    """Text of the covariance of a robot's parameters, shape (p, p), every digit kept."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(column_names(robot, robot.effects))
    writer.writerows([repr(float(value)) for value in row] for row in covariance)
    return text.getvalue()


def read_covariance(path: Path, robot: Robot) -> Array:
    """Covariance of a robot's parameters from a file, shape (p, p).

    Raises:
        BadRobot: A file that cannot be read, of other parameters, or that is no covariance.
    """
    names = list(column_names(robot, robot.effects))
    rows = _rows(path)
    head = next(rows, [])
    if head != names:
        why = f"{len(head)} columns, but the model has {len(names)} parameters"
        if len(head) == len(names):
            one, other = next(pair for pair in zip(head, names, strict=True) if len({*pair}) > 1)
            why = f"column '{one}' stands where the model has '{other}'"
        raise BadRobot(path, f"{why}; {_AGAIN}")
    values = list[list[float]]()
    for number, row in enumerate(rows, start=2):
        try:
            values.append([float(word) for word in row])
        except ValueError as error:
            raise BadRobot(path, f"line {number}: {error}; {_AGAIN}") from None
        if len(row) != len(names):
            raise BadRobot(path, f"line {number} has {len(row)} numbers of {len(names)}; {_AGAIN}")
    if len(values) != len(names):
        raise BadRobot(path, f"{len(values)} rows of {len(names)}; {_AGAIN}")
    C = np.array(values)
    scale = np.sqrt(np.maximum(np.diag(C), 0.0))
    unit = C / np.outer(*[np.where(scale > 0, scale, 1.0)] * 2)
    if not np.isfinite(C).all() or np.abs(unit - unit.T).max() > _ROUNDING:
        raise BadRobot(path, f"it is not a symmetric matrix of finite numbers; {_AGAIN}")
    if np.linalg.eigvalsh(unit)[0] < -_ROUNDING * len(unit):
        raise BadRobot(path, f"no covariance: it has a negative eigenvalue; {_AGAIN}")
    return C


def _rows(path: Path) -> Iterator[list[str]]:
    try:
        yield from csv.reader(io.StringIO(read_description(path)))
    except csv.Error as error:
        raise BadRobot(path, f"not CSV ({error}); {_AGAIN}") from None
