"""Directions in parameter space that a motion hardly shows, named; and correlations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from excitant.analysis.practical import Sight
from excitant.robots.base_parameters import BaseParameters
from excitant.robots.motion import Array

_MEMBER = 0.3  # coefficient of a unit vector from which a parameter is named


@dataclass(frozen=True)
class Direction:
    """Base parameters that trade against each other because torque hardly shows it.

    Attributes:
        members: Name and unit of each, with the change that one standard deviation of the
            torque noise hides; of a direction not seen at all, the change per unit of the first.
        std: Standard deviation along it relative to the sizes of its members; inf if unseen.
        share: Part of the direction that its members make.
    """

    members: tuple[tuple[str, float, str], ...]
    std: float
    share: float

    @property
    def expression(self) -> str:
        """The direction as text, e.g. ``link3.Ixx − 0.83·link2.Izz``."""
        text, lead = "", self.members[0][1]
        for name, change, _ in self.members:
            size = f"{abs(change / lead):.2g}"
            sign = (" − " if change / lead < 0 else " + ") if text else ""
            text += sign + ("" if size == "1" else f"{size}·") + name
        return text

    @property
    def meaning(self) -> str:
        """What the direction means, as a sentence."""
        name, change, unit = self.members[0]
        if not np.isfinite(self.std):
            if len(self.members) == 1:
                return f"{name} changes no torque of this motion"
            others = _listed([f"{other} by {c:.2g}" for other, c, _ in self.members[1:]])
            return f"{name} by 1 with {others} (SI units) changes no torque of this motion"
        if len(self.members) == 1:
            return f"{name} may be {abs(change):.2g} {unit} off without showing above the noise"
        moves = [
            f"{other} {'falls' if c * change < 0 else 'rises'} by {abs(c):.2g} {u}"
            for other, c, u in self.members[1:]
        ]
        return (
            f"{name} may rise by {abs(change):.2g} {unit} while {_listed(moves)}: "
            "torque changes by no more than the noise"
        )


def _listed(words: Sequence[str]) -> str:
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)


def weak_directions(
    base: BaseParameters, units: Sequence[str], seen: Sight, size: Array, count: int = 5
) -> tuple[Direction, ...]:
    """Directions that a motion does not see, then those it sees worst.

    With D the sizes of the base parameters, the latter are the leading eigenvectors u of
    D⁻¹ C D⁻¹, C the covariance; a change D u √λ of the parameters is one standard deviation.

    Args:
        base: Base parameters, r of them.
        units: Units of the base parameters.
        seen: What the motion shows.
        size: What counts as much of each base parameter, shape (r,).
        count: How many of those that are seen.
    """
    names = [base.names[k] for k in base.columns]
    found = [_direction(row, row, np.inf, names, units, size) for row in seen.unseen]
    values, U = np.linalg.eigh(seen.covariance / np.outer(size, size))
    for k in np.argsort(-values, kind="stable")[:count]:
        std = float(np.sqrt(max(float(values[k]), 0.0)))
        if std > 0:
            found.append(_direction(U[:, k], U[:, k] * std * size, std, names, units, size))
    return tuple(found)


def _direction(
    row: Array, change: Array, std: float, names: Sequence[str], units: Sequence[str], size: Array
) -> Direction:
    """A direction with its named members, strongest first; an unseen one in its own units."""
    weight = row if np.isfinite(std) else row / size
    weight = weight / np.linalg.norm(weight)
    order = [int(k) for k in np.argsort(-np.abs(weight), kind="stable")]
    kept = [k for k in order if abs(weight[k]) >= _MEMBER] or order[:1]
    if not np.isfinite(std):
        kept = [k for k in order if abs(weight[k]) > 1e-3]
        change = change / change[kept[0]]
    members = tuple((names[k], float(change[k]), units[k]) for k in kept)
    return Direction(members, std, float((weight[kept] ** 2).sum()))


def correlation(covariance: Array) -> Array:
    """Correlation matrix; zero for what has no variance, shape as given."""
    std = np.sqrt(np.diag(covariance))
    safe = np.where(std > 0, std, 1.0)
    matrix = covariance / np.outer(safe, safe)
    np.fill_diagonal(matrix, np.where(std > 0, 1.0, 0.0))
    return np.asarray(np.clip(matrix, -1.0, 1.0), float)


def largest_correlations(matrix: Array, count: int = 10) -> list[tuple[int, int, float]]:
    """Pairs of base parameters with the largest |ρ|, as indices and ρ."""
    rows, columns = np.triu_indices(len(matrix), 1)
    values = matrix[rows, columns]
    order = np.argsort(-np.abs(values), kind="stable")[:count]
    return [(int(rows[k]), int(columns[k]), float(values[k])) for k in order if values[k]]
