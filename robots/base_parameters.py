"""Base parameters: the combinations on which the joint torques depend, and the regrouping.

The numerical method of Gautier (1991): the rank structure of the regressor on random states
is that of the arm. Columns are taken from left to right; a column that depends on the base
columns before it is regrouped into them.

Decisions are taken on columns in units of the arm, over states drawn in units of its own length
and gravity as well as within its limits, so that they are the same for an arm in millimetres.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal
from fractions import Fraction
from functools import cached_property

import numpy as np

from excitant.robots.effects import Effect
from excitant.robots.motion import Array, Indices, Mask, Motion, numbered, read_only
from excitant.robots.parameters import moved_parameters
from excitant.robots.robot import Robot, spans
from excitant.robots.torque import column_names, observation_columns

# of the longest column: arms show parts of 0.1, angles in seven digits 1e-7
TOLERANCE = 1e-6
_ABSENT = 1e-8  # of the longest column: a column of zeros
_HALF = 300  # of the random states
_PRESENT = 1e-10  # of a column's largest entry: the torque contains it
# decades below the limit, so that friction at low speed shows its shape
_SLOWEST = -3.0
_DIGITS = 12  # of a coefficient that random states leave certain
_DENOMINATOR = 12  # largest of a fraction in an expression


LENGTH_POWERS = read_only([0, 1, 1, 1, 2, 2, 2, 2, 2, 2])
"""Power of length in the unit of each standard parameter, shape (10,)."""


def arm_length(robot: Robot) -> float:
    """Length of an arm, from its first joint to its last along the links; 1 m when zero [m]."""
    return sum(spans(robot)[1:]) or 1.0


@dataclass(frozen=True, eq=False)
class BaseParameters:
    """The base parameters β = B φ of an arm, with W φ = W[:, columns] B φ for every motion.

    Attributes:
        names: Names of all parameters φ, p of them.
        columns: Indices of the base columns, shape (r,).
        regrouping: B, shape (r, p); the identity on the base columns.
        null_space: Orthonormal basis of what no torque shows, shape (p, p − r).
        gap: Smallest part of an accepted column, and largest of a rejected one, outside the
            columns before it, where the longest column has length one; close together means
            nearly special geometry.
    """

    names: tuple[str, ...]
    columns: tuple[int, ...]
    regrouping: Array
    null_space: Array
    gap: tuple[float, float]

    def __len__(self) -> int:
        return len(self.columns)

    @property
    def leading(self) -> tuple[str, ...]:
        """The parameter that each base parameter is written with."""
        return tuple(self.names[column] for column in self.columns)

    @cached_property
    def expressions(self) -> tuple[str, ...]:
        """Each base parameter as text, e.g. ``link1.Izz + 0.36·link2.m``."""
        return tuple(
            expression(row, self.names, column)
            for row, column in zip(self.regrouping, self.columns, strict=True)
        )


def expression(row: Array, names: Sequence[str], leading: int) -> str:
    """A linear combination, coefficients of shape (p,), as text that begins with one of them."""
    text = ""
    for k in (leading, *(k for k in np.flatnonzero(row).tolist() if k != leading)):
        minus = row[k] < 0
        factor = coefficient_text(abs(float(row[k])))
        text += (" − " if minus else " + ") if text else ("−" if minus else "")
        text += ("" if factor == "1" else f"{factor}·") + names[k]
    return text


def coefficient_text(size: float) -> str:
    """A coefficient as a short decimal, a simple fraction, or five digits.

    Rounded twice, in decimal arithmetic, so that 0.00680625 reads the same on every machine.
    """
    value = Decimal(f"{size:.{_DIGITS - 1}e}")
    rounded = Decimal(f"{value:.4e}")
    if rounded != value:
        near = Fraction(size).limit_denominator(_DENOMINATOR)
        if near and abs(float(near) - size) <= 1e-9 * size:
            return f"{near.numerator}/{near.denominator}"
    return f"{float(rounded):.5g}"


@dataclass(frozen=True, eq=False)
class Observation:
    """Columns of all parameters over many states, condensed for decisions about their rank."""

    names: tuple[str, ...]  # p of them
    R: Array  # triangular factor, the longest inertial column and every other of length one, (, p)
    units: Array  # what the columns were divided by; infinite for a column of zeros, shape (p,)


def base_parameters(robot: Robot, effects: Sequence[Effect] = ()) -> BaseParameters:
    """Base parameters of the links, with those of effects when given.

    Args:
        robot: The arm; gravity and locked joints count.
        effects: Effects whose coefficients are unknown too.
    """
    motion = structural_motion(robot, np.random.default_rng(0))
    return regroup(observe(robot, effects, motion))


def structural_motion(robot: Robot, rng: np.random.Generator) -> Motion:
    """Random states that show all that a motion can: half over full turns, half within limits.

    The first half has velocities and accelerations of √(g/L) and g/L for an arm of length L.
    Those within the limits come at all speeds, down to a thousandth of the limit.
    """
    length = arm_length(robot)
    gravity = float(np.linalg.norm(robot.gravity)) or length
    rate = np.sqrt(gravity / length)
    free = rng.uniform(-1.0, 1.0, (3, _HALF, robot.nv))
    free *= np.where(robot.revolute, 1.0, length)
    free *= np.array([1.0, rate, rate**2])[:, None, None]
    free[0] *= np.where(robot.revolute, np.pi, 1.0)
    bound = np.array(robot.random_motion(rng, _HALF))
    slow = rng.uniform(_SLOWEST, 0, _HALF) * (np.arange(_HALF) % 2)
    bound[1] *= 10.0 ** slow[:, None]
    return numbered(*np.concatenate([free, bound], axis=1))


def observe(
    robot: Robot,
    effects: Sequence[Effect],
    motion: Motion,
    rows: Mask | None = None,
    frames: Array | None = None,
) -> Observation:
    """Columns of all parameters over states, in units of the arm, ready for `regroup`.

    ``rows`` says which joints' torques are known, shape (nv,); all when None. Parameters are about
    the joint frames, or about frames of the links, poses in these, shape (nv, 4, 4).
    """
    length = arm_length(robot)
    p = 10 * robot.nv
    W = observation_columns(robot, effects, motion)
    for link, T in enumerate(() if frames is None else frames):
        own = W[:, :, 10 * link : 10 * link + 10]
        own[:] = own @ moved_parameters(np.eye(10), T).T
    W *= np.where(robot.revolute, 1.0, length)[:, None]  # forces as torques
    W[:, :, :p] *= np.tile(length ** (LENGTH_POWERS - 2.0), robot.nv)
    sizes = np.abs(W[:, :, :p]).max(axis=(1, 2), keepdims=True)
    W /= np.where(sizes > 0, sizes, 1.0)
    W = W if rows is None else W[:, rows]
    R = np.linalg.qr(W.reshape(-1, W.shape[2]), mode="r")
    unit = _units(np.linalg.norm(R, axis=0), p)
    R = R / unit
    unit[:p] *= np.tile(length ** (2.0 - LENGTH_POWERS), robot.nv)
    return Observation(column_names(robot, effects), R, unit)


def _units(norms: Array, p: int) -> Array:
    """Units that bring columns to length one: the inertial ones together, others one by one."""
    units = np.where(norms > _ABSENT * norms[p:].max(initial=0.0), norms, np.inf)
    units[:p] = norms[:p].max(initial=0.0) or 1.0
    return units


def regroup(
    observation: Observation, tolerance: float = TOLERANCE
) -> BaseParameters:
    """Base parameters of what was observed.

    ``tolerance`` is the length of the part outside the columns before it from which on a column
    counts as independent, and the size from which on a coefficient counts; in its units.
    """
    R = observation.R
    units = observation.units
    leading, parts = independent_columns(R, tolerance)
    columns = list(leading)
    B = dependence(R, leading)
    B[np.abs(B) < tolerance] = 0.0
    B = _rounded(
        B * np.where(np.isfinite(units), units, 0.0) / units[columns, None]
    )
    B[:, columns] = np.eye(len(columns))
    rejected = np.delete(parts, columns)
    return BaseParameters(
        observation.names,
        leading,
        read_only(B),
        read_only(np.linalg.svd(B)[2][len(columns) :].T),
        (float(parts[columns].min(initial=1.0)), float(rejected.max(initial=0.0))),
    )


def dependence(R: Array, leading: Sequence[int]) -> Array:
    """Coefficients (r, p) by which independent columns of R, r of p, make all of them."""
    columns = list(leading)
    B = np.asarray(np.linalg.lstsq(R[:, columns], R, rcond=None)[0], float)
    B[:, columns] = np.eye(len(columns))
    return B


def independent_columns(
    R: Array, tolerance: float
) -> tuple[tuple[int, ...], Array]:
    """Columns that do not depend on those before, and the length of each outside them.

    The longest column has length one; from a length of ``tolerance`` on one is independent.
    """
    columns: list[int] = []
    parts = np.zeros(R.shape[1])
    Q = np.zeros((R.shape[0], 0))
    for k in range(R.shape[1]):
        rest = R[:, k]
        for _ in range(2):
            rest = rest - Q @ (Q.T @ rest)
        parts[k] = np.linalg.norm(rest)
        if parts[k] > tolerance:
            Q = np.column_stack([Q, rest / parts[k]])
            columns.append(k)
    return tuple(columns), parts


def _rounded(B: Array) -> Array:
    """Coefficients without the digits that come from the draw of the states."""
    exponent = np.floor(np.log10(np.abs(B), out=np.zeros_like(B), where=B != 0))
    unit = 10.0 ** (_DIGITS - 1 - exponent)
    return np.round(B * unit) / unit


def categories(base: BaseParameters) -> tuple[str, ...]:
    """Category of every parameter: ``unique``, ``combined`` or ``unidentifiable``.

    A parameter is uniquely identifiable when its unit vector is orthogonal to the null space
    of the regressor, and unidentifiable when it lies inside it (no torque contains it). Both
    can be read off B, whatever the units: a null vector is e_j − Σᵢ B_ij e_columns[i].
    """
    return categories_of(base.regrouping != 0, base.columns)


def categories_of(present: Mask, leading: Sequence[int]) -> tuple[str, ...]:
    """Categories by which coefficients of B, shape (r, p), are not zero."""
    categories = np.where(present.any(axis=0), "combined", "unidentifiable")
    alone = present.sum(axis=1) == 1
    categories[np.array(leading, int)[alone]] = "unique"
    return tuple(categories.tolist())


def last_rows(
    robot: Robot, effects: Sequence[Effect], base: BaseParameters
) -> Indices:
    """The last joint whose torque contains each base parameter, shape (r,).

    By Property 4 of Khosla (1987) no torque of a joint contains links before it. A base parameter
    counts for the first link it can be written with, so this is that link's joint: what the
    torque of joint i can show of it, once the links further out are known, are the base
    parameters whose last row is i.
    """
    states = robot.random_motion(1, 100)
    W = observation_columns(robot, effects, numbered(*states))
    size = np.abs(W[:, :, list(base.columns)]).max(axis=0)
    present = size > _PRESENT * size.max(axis=0)
    return robot.nv - 1 - np.argmax(present[::-1], axis=0)
