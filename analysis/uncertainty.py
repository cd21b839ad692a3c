"""How well one motion shows an arm's parameters: deviations, unseen directions, correlations.

With the torque noise σ of each joint, the whitened columns W/σ of all parameters x have a
triangular factor R, and ‖R δ‖ is the torque that a change δ makes, in standard deviations of the
noise. All of this page is R: null directions are not seen, and (RᵀR)⁻¹ is the covariance of what
is (Gautier and Khalil 1992; Swevers et al. 1997).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from excitant.exceptions import BadInput
from excitant.identify.prior import silent_columns
from excitant.robots.base_parameters import (
    BaseParameters,
    Observation,
    independent_columns,
    regroup,
)
from excitant.robots.motion import Array, freeze
from excitant.robots.robot import Robot

TORQUE_NOISE = 0.01  # of each joint's torque limit, where no recording tells the noise
WELL, ROUGHLY = 0.1, 0.3  # relative standard deviation
NOT_SHOWN = "not_shown"
_MEMBER = 0.3  # coefficient of a unit vector from which a parameter is named
_SEEN = 1e-9  # smallest singular value of normalised columns, relative; below it is rounding
_TOUCHES = 1e-6  # part of a unit vector in unseen directions from which it counts


def torque_noise(robot: Robot, given: Sequence[float] | None = None) -> Array:
    """Standard deviation of each joint's torque noise, shape (nv,) [N·m].

    Args:
        robot: The arm; 1 % of its torque limits where nothing is given.
        given: One value per joint.

    Raises:
        BadInput: Values that do not fit the arm, or a joint without a limit to scale by.
    """
    if given is not None:
        sigma = np.asarray(given, float)
        if sigma.shape != (robot.nv,) or not (np.isfinite(sigma) & (sigma > 0)).all():
            raise BadInput(
                f"noise {', '.join(f'{s:g}' for s in sigma)}: give one positive number [N·m] for "
                f"each of the {robot.nv} joints of {robot.name}"
            )
        return sigma
    sigma = TORQUE_NOISE * robot.limits.torque
    if not np.isfinite(sigma).all():
        joint = robot.joints[int(np.argmin(np.isfinite(sigma)))]
        raise BadInput(
            f"{robot.source}: joint {joint} has no torque limit to scale noise by; "
            "give the noise of each joint (--noise) or a limit"
        )
    return np.asarray(sigma, float)


def triangle(W: Array, sigma: Array) -> Array:
    """Triangular factor R of whitened columns, ‖R x‖ = ‖W x / σ‖, shape (p, p).

    Args:
        W: Columns of all parameters, shape (n, rows, p).
        sigma: Standard deviation of each row's noise, shape (rows,).
    """
    p = W.shape[2]
    R = np.linalg.qr((W / sigma[:, None]).reshape(-1, p), mode="r")
    return np.vstack([R, np.zeros((p - len(R), p))])


def deviations(R: Array, A: Array) -> Array:
    """Standard deviation of each combination A x by least squares, shape (m,); inf where unseen.

    Args:
        R: Factor of the whitened columns, shape (rows, p).
        A: Combinations of interest, shape (m, p).
    """
    scale, s, V = _decomposed(R)
    parts = (A / scale) @ V
    seen = s > _SEEN * max(float(s[0]), 1e-300)
    size = np.linalg.norm(parts, axis=1)
    hidden = np.linalg.norm(parts[:, ~seen], axis=1) > _TOUCHES * size
    std = np.sqrt(((parts[:, seen] / s[seen]) ** 2).sum(axis=1))
    return np.asarray(np.where(hidden, np.inf, std), float)


def dependent_groups(R: Array) -> tuple[tuple[int, ...], ...]:
    """Columns that follow from each other: once one of a group is known, so are the others.

    Those are the columns whose rows of the null space are parallel.

    Args:
        R: Shape (rows, p).
    """
    _, s, V = _decomposed(R)
    N = V[:, s <= _SEEN * max(float(s[0]), 1e-300)] if len(s) else V[:, :0]
    size = np.linalg.norm(N, axis=1)
    hidden = np.flatnonzero(size > _TOUCHES)
    directions = N[hidden] / size[hidden, None]
    parallel = np.abs(directions @ directions.T) > 1 - _TOUCHES**1.5
    groups = dict.fromkeys(tuple(int(k) for k in hidden[row]) for row in parallel)
    return tuple(group for group in groups if len(group) > 1)


def without_rounding(W: Array) -> Array:
    """Columns, shape (n, rows, p), with those that are silent but for rounding set to zero."""
    silent = silent_columns(np.sqrt((W**2).sum(axis=0)))
    return np.asarray(np.where(silent, 0.0, W), float)


def _unit_columns(R: Array) -> tuple[Array, Array]:
    """Lengths of the columns, and the columns scaled to length one, or zero where silent."""
    norms = np.linalg.norm(R, axis=0)
    heard = ~silent_columns(R)
    scale = np.where(heard, norms, norms[heard].min(initial=np.inf) if heard.any() else 1.0)
    return scale, np.where(heard, R / scale, 0.0)


def _decomposed(R: Array) -> tuple[Array, Array, Array]:
    """Column scales, and singular values with right vectors of R in these scales."""
    scale, unit = _unit_columns(R)
    _, s, Vt = np.linalg.svd(unit, full_matrices=True)
    return scale, np.pad(s, (0, len(Vt) - len(s))), Vt.T


def shown_base(names: tuple[str, ...], W: Array) -> BaseParameters:
    """The base parameters that the rows of one motion have, which may be fewer than the arm's.

    Args:
        names: Names of the parameters, p of them.
        W: Columns of all parameters, shape (n, rows, p).
    """
    R = triangle(W, np.ones(W.shape[1]))
    norms, unit = _unit_columns(R)
    return regroup(Observation(names, unit, np.where(unit.any(axis=0), norms, 0.0)), _SEEN)


@dataclass(frozen=True, eq=False)
class MotionInformation:
    """What the torque of a motion tells of the base parameters β.

    Attributes:
        R: Triangular factor of the whitened columns of all parameters, shape (p, p).
        covariance: Of β as far as it is seen, shape (r, r); zero along the unseen directions.
        unseen: Directions of β that change no torque of this motion, shape (d, r), each
            with as few members as there can be.
        signal: Largest rms torque per unit of a base parameter, in noise, shape (r,).
    """

    R: Array
    covariance: Array
    unseen: Array
    signal: Array

    def __post_init__(self) -> None:
        freeze(self, "R", "covariance", "unseen", "signal")

    def std(self, C: Array) -> Array:
        """Standard deviation of combinations C β, shape (m,); inf where unseen.

        Args:
            C: Combinations, shape (m, r).
        """
        values = np.sqrt(np.maximum(np.einsum("mr,rs,ms->m", C, self.covariance, C), 0.0))
        length = np.linalg.norm(self.unseen, axis=1, keepdims=True)
        hidden = (np.abs(C @ (self.unseen / length).T) > _TOUCHES).any(axis=1)
        return np.asarray(np.where(hidden, np.inf, values), float)


def motion_information(
    base: BaseParameters, W: Array, sigma: Array, covariance: Array | None = None
) -> MotionInformation:
    """What a motion with this noise shows.

    Args:
        base: Base parameters, r of them.
        W: Columns of all parameters, shape (n, rows, p).
        sigma: Standard deviation of each row's noise, shape (rows,).
        covariance: Of the base parameters when it is known already, shape (r, r).
    """
    R = triangle(W, sigma)
    columns = list(base.columns)
    if covariance is None:
        covariance = _covariance(R[:, columns])
    whitened = np.sqrt((W[:, :, columns] ** 2).mean(axis=0)) / sigma[:, None]
    return MotionInformation(R, covariance, unseen_directions(R[:, columns]), whitened.max(axis=0))


def unseen_directions(R: Array) -> Array:
    """Null space of R by sparse vectors: each column that depends on those before it, shape (d, r).

    Args:
        R: Shape (rows, r).
    """
    scale, unit = _unit_columns(R)
    own, _ = independent_columns(unit, _SEEN)
    rest = [k for k in range(R.shape[1]) if k not in own]
    found = np.zeros((len(rest), R.shape[1]))
    found[:, list(own)] = -np.linalg.lstsq(unit[:, list(own)], unit[:, rest], rcond=None)[0].T
    found[np.abs(found) < _TOUCHES] = 0.0
    found[range(len(rest)), rest] = 1.0
    found /= scale
    return np.asarray(found / found[range(len(rest)), rest][:, None], float)


def _covariance(R: Array) -> Array:
    scale, s, V = _decomposed(R)
    seen = s > _SEEN * max(float(s[0]), 1e-300)
    half = V[:, seen] / s[seen] / scale[:, None]
    return np.asarray(half @ half.T, float)


@dataclass(frozen=True)
class Practical:
    """How well a motion shows one base parameter.

    Attributes:
        expression: The base parameter.
        value: Its value.
        std: Standard deviation of its estimate; inf when the motion does not show it.
        negligible: Whether its torque stays below the noise whatever value within two standard
            deviations it has.
        needed: What would show it; empty where the motion does.
    """

    expression: str
    value: float
    std: float
    negligible: bool
    needed: str = ""

    @property
    def rel_std(self) -> float | None:
        """Standard deviation relative to the value; None when the value is zero or not shown."""
        return self.std / abs(self.value) if self.value and np.isfinite(self.std) else None

    @property
    def verdict(self) -> str:
        """``well`` (to 10 %), ``roughly`` (to 30 %), ``negligible``, ``hardly``, ``not_shown``."""
        return verdict(self.std, self.value, self.negligible)

    def result(self) -> dict[str, Any]:
        """What ``result.json`` says of it."""
        figures = {key: getattr(self, key) for key in ("value", "std", "rel_std", "verdict")}
        return {"name": self.expression, **figures, "needed": self.needed or None}


def verdict(std: float, value: float, negligible: bool) -> str:
    """In a word, how well something of this value is determined."""
    if not np.isfinite(std):
        return NOT_SHOWN
    if value and std <= ROUGHLY * abs(value):
        return "well" if std <= WELL * abs(value) else "roughly"
    return "negligible" if negligible else "hardly"


def size_to_resolve(value: Array, std: Array, negligible: Array, signal: Array) -> Array:
    """The size beside which a standard deviation should be small; 0 if being shown is enough.

    Of something not known to have a value: what makes a torque of twice the noise.

    Args:
        value: Values, zero where not known, shape (m,).
        std: Standard deviations so far, shape (m,).
        negligible: What is negligible, shape (m,).
        signal: Torque per unit, in noise, shape (m,).
    """
    unknown = 0.5 / ROUGHLY / np.maximum(signal, 1e-300)
    size = np.where(value == 0, unknown, np.abs(value))
    return np.asarray(np.where(negligible | ~np.isfinite(std), 0.0, size), float)


def practical(
    base: BaseParameters, values: Array, seen: MotionInformation
) -> tuple[Practical, ...]:
    """Every base parameter under a motion.

    Args:
        base: Base parameters, r of them.
        values: Their values, shape (r,).
        seen: What the motion shows.
    """
    std = seen.std(np.eye(len(base)))
    torque = (np.abs(values) + 2 * std) * np.maximum(seen.signal, 1e-300)
    return tuple(
        Practical(text, float(value), float(s), bool(t < 1))
        for text, value, s, t in zip(base.expressions, values, std, torque, strict=True)
    )


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
            others = listed([f"{other} by {c:.2g}" for other, c, _ in self.members[1:]])
            return f"{name} by 1 with {others} (SI units) changes no torque of this motion"
        if len(self.members) == 1:
            return f"{name} may be {abs(change):.2g} {unit} off without showing above the noise"
        moves = [
            f"{other} {'falls' if c * change < 0 else 'rises'} by {abs(c):.2g} {u}"
            for other, c, u in self.members[1:]
        ]
        return (
            f"{name} may rise by {abs(change):.2g} {unit} while {listed(moves)}: "
            "torque changes by no more than the noise"
        )

    def result(self) -> dict[str, Any]:
        """What ``result.json`` says of it."""
        members = [dict(zip(("name", "change", "unit"), m, strict=True)) for m in self.members]
        said = {key: getattr(self, key) for key in ("expression", "meaning", "share")}
        return {**said, "rel_std": self.std, "members": members}


def listed(words: Sequence[str]) -> str:
    """Words with commas and ``and``."""
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)


def weak_directions(
    base: BaseParameters, units: Sequence[str], seen: MotionInformation, size: Array, count: int = 5
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
