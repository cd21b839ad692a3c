"""Base parameters: what the joint torques depend on, and how parameters regroup into them.

The numerical method of Gautier (1991): the rank structure of the regressor on random states
is that of the arm. Columns are taken from left to right; a column that depends on the base
columns before it is regrouped into them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from excitant.robots.effects import Effect
from excitant.robots.motion import Array, Motion, read_only
from excitant.robots.robot import Robot
from excitant.robots.torque import column_names, observation_columns

_STATES = 600
_TOLERANCE = 1e-8  # of a normalised column; double precision leaves about 1e-13


@dataclass(frozen=True, eq=False)
class BaseParameters:
    """The base parameters β = B φ of an arm, with W φ = W[:, columns] B φ for every motion.

    Attributes:
        names: Names of all parameters φ, p of them.
        columns: Indices of the base columns, shape (r,).
        regrouping: B, shape (r, p); the identity on the base columns.
        null_space: Orthonormal basis of what no torque shows, shape (p, p − r).
        gap: Smallest part of an accepted column, and largest of a rejected one, outside the
            columns before it (both relative); close together means special geometry "by a hair".
    """

    names: tuple[str, ...]
    columns: tuple[int, ...]
    regrouping: Array
    null_space: Array
    gap: tuple[float, float]

    def __len__(self) -> int:
        return len(self.columns)

    @property
    def expressions(self) -> tuple[str, ...]:
        """Each base parameter as text, e.g. ``link1.Izz + 0.36·link2.m``."""
        return tuple(
            expression(row, self.names, column)
            for row, column in zip(self.regrouping, self.columns, strict=True)
        )


def expression(row: Array, names: Sequence[str], leading: int) -> str:
    """A linear combination as text, its leading parameter first."""
    others = [int(k) for k in np.flatnonzero(np.abs(row) > 1e-7)]
    order = [leading, *(k for k in others if k != leading)]
    text = ""
    for k in order:
        value, size = row[k], f"{abs(row[k]):.5g}"
        sign = (" − " if value < 0 else " + ") if text else ("−" if value < 0 else "")
        text += sign + ("" if size == "1" else f"{size}·") + names[k]
    return text


def random_observation(robot: Robot, effects: Sequence[Effect], states: int = _STATES) -> Array:
    """Observation matrix on random states, shape (states · nv, p); always the same ones."""
    q, dq, ddq = robot.random_motion(np.random.default_rng(0), states)
    motion = Motion(np.arange(states, dtype=float), q, dq, ddq)
    columns = observation_columns(robot, effects, motion)
    return columns.reshape(-1, columns.shape[2])


def base_parameters(robot: Robot, effects: Sequence[Effect] = ()) -> BaseParameters:
    """Base parameters of the links, with those of effects when given.

    Args:
        robot: The arm; gravity and locked joints count.
        effects: Effects whose coefficients are unknown too.
    """
    names = column_names(robot, effects)
    R = scipy.linalg.qr(random_observation(robot, effects), mode="r")[0][: len(names)]
    norms = np.linalg.norm(R, axis=0)
    columns: list[int] = []
    basis = np.zeros((R.shape[0], 0))
    accepted, rejected = [1.0], [0.0]
    for k in np.flatnonzero(norms > _TOLERANCE * norms.max()):
        rest = R[:, k] / norms[k]
        for _ in range(2):
            rest = rest - basis @ (basis.T @ rest)
        size = float(np.linalg.norm(rest))
        if size > _TOLERANCE:
            basis = np.column_stack([basis, rest / size])
            columns.append(int(k))
            accepted.append(size)
        else:
            rejected.append(size)
    regrouping = np.linalg.lstsq(R[:, columns], R, rcond=None)[0]
    regrouping[np.abs(regrouping) < 1e-9] = 0.0
    regrouping[:, columns] = np.eye(len(columns))
    return BaseParameters(
        names,
        tuple(columns),
        read_only(regrouping),
        read_only(scipy.linalg.null_space(regrouping)),
        (min(accepted), max(rejected)),
    )


def categories(base: BaseParameters) -> tuple[str, ...]:
    """Category of every parameter: ``unique``, ``combined`` or ``unidentifiable``.

    A parameter is uniquely identifiable when its unit vector is orthogonal to the null space
    of the regressor, and unidentifiable when it lies inside it (no torque contains it).
    """
    shown = np.linalg.norm(base.regrouping, axis=0) > _TOLERANCE
    alone = np.linalg.norm(base.null_space, axis=1) < _TOLERANCE
    return tuple(
        "unidentifiable" if not s else "unique" if a else "combined"
        for s, a in zip(shown, alone, strict=True)
    )
