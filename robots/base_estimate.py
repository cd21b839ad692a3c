"""Base parameters of an arm as data showed them, with their covariance, and as a table in CSV."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from excitant.exceptions import BadRobot
from excitant.robots.motion import Array, freeze

_HEAD = ("parameter", "value")
_AGAIN = "write the model again, or leave its entry 'estimate' out"
_ROUNDING = 1e-8  # of a correlation


@dataclass(frozen=True, eq=False)
class BaseEstimate:
    """Base parameters of links and effects by the data alone.

    Attributes:
        names: The parameter that each is written with, r of them.
        value: Their values, shape (r,).
        covariance: Of their errors, positive definite, shape (r, r).
    """

    names: tuple[str, ...]
    value: Array
    covariance: Array

    def __post_init__(self) -> None:
        symmetric = (self.covariance + self.covariance.T) / 2  # but for rounding it is
        object.__setattr__(self, "covariance", symmetric)
        freeze(self, "value", "covariance")

    def csv(self) -> str:
        """A line for each: name, value and its row of the covariance, every digit kept."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow([*_HEAD, *self.names])
        for name, value, row in zip(
            self.names, self.value, self.covariance, strict=True
        ):
            writer.writerow([name, *(repr(float(x)) for x in (value, *row))])
        return text.getvalue()


def base_estimate_from_csv(text: str, path: Path) -> BaseEstimate:
    """The table that `BaseEstimate.csv` writes; `BadRobot` where a text holds none."""
    try:
        head, *rows = list(csv.reader(io.StringIO(text))) or [[]]
    except csv.Error as error:
        raise BadRobot(path, f"not CSV ({error}); {_AGAIN}") from None
    names = tuple(head[2:])
    if tuple(head[:2]) != _HEAD or not names or len(rows) != len(names):
        why = f"not a table 'parameter,value,...' of base parameters and as many lines; {_AGAIN}"
        raise BadRobot(path, why)
    numbers = np.zeros((len(names), 1 + len(names)))
    for line, (name, row) in enumerate(zip(names, rows, strict=True), start=2):
        try:
            numbers[line - 2] = [float(word) for word in row[1:]]
        except ValueError:
            why = f"line {line} does not hold {1 + len(names)} numbers"
            raise BadRobot(path, f"{why}; {_AGAIN}") from None
        if row[0] != name:
            raise BadRobot(
                path, f"line {line} is of '{row[0]}', not of '{name}'; {_AGAIN}"
            )
    value = numbers[:, 0]
    covariance = numbers[:, 1:]
    if not np.isfinite(value).all() or not is_covariance(covariance):
        why = "its values are not finite, or its covariance not symmetric and positive definite"
        raise BadRobot(path, f"{why}; {_AGAIN}")
    return BaseEstimate(names, value, covariance)


def is_covariance(matrix: Array) -> bool:
    """Whether a matrix, (r, r), is finite, symmetric and, as correlations, positive definite."""
    variance = np.diag(matrix)
    if not np.isfinite(matrix).all() or not (variance > 0).all():
        return False
    unit = matrix / np.sqrt(np.outer(variance, variance))
    return bool(
        np.abs(unit - unit.T).max() <= _ROUNDING and np.linalg.eigvalsh(unit)[0] > 0
    )
