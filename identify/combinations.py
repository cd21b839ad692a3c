"""Combinations of base parameters in readable form, and motions that show what is left open."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from excitant.robots.effects import Effect
from excitant.robots.motion import Array, Motion, freeze
from excitant.robots.robot import Robot
from excitant.robots.torque import observation_columns

_CLEAR = (0.3, 0.1, 1e-2, 1e-4, 1e-7)  # share of a leading parameter outside those before it
_NOTHING = 1e-6  # coefficient, in units of the parameters' scale
_STATES = 40  # beyond the parameters sought
_VISIBLE = 1e-6  # of the largest singular value
_PAIRS = 10  # joints up to which pairs of them are tried


@dataclass(frozen=True, eq=False)
class Combinations:
    """Rows of coefficients F, each with the coefficient 1 of a parameter that no other row has.

    Attributes:
        F: Coefficients, shape (k, r).
        leading: The parameter that leads each row, k of them.
    """

    F: Array
    leading: tuple[int, ...]

    def __post_init__(self) -> None:
        freeze(self, "F")

    def __len__(self) -> int:
        return len(self.leading)

    def with_more(self, rows: Array, scale: Array, preferred: Sequence[int]) -> Combinations:
        """These and further independent rows, free of the parameters that lead these.

        Args:
            rows: Coefficients of the further combinations, shape (m, r).
            scale: Scale of each parameter, shape (r,).
            preferred: Parameters that should lead, in this order; then the others.
        """
        if len(rows) == 0:
            return self
        led = list(self.leading)
        rest = (rows - rows[:, led] @ self.F) * scale
        rest[:, led] = 0.0
        Q = np.linalg.qr(rest.T)[0].T
        others = [k for k in range(len(scale)) if k not in preferred]
        free = [k for k in (*preferred, *others) if k not in led]
        leading = _leading(Q, free)
        new = np.linalg.solve(Q[:, leading], Q)
        new[np.abs(new) < _NOTHING] = 0.0
        new[:, leading] = np.eye(len(leading))
        new *= scale[leading, None] / scale
        return Combinations(np.vstack([self.F, new]), (*self.leading, *leading))


def no_combinations(r: int) -> Combinations:
    """None of r parameters."""
    return Combinations(np.zeros((0, r)), ())


def _leading(Q: Array, order: Sequence[int]) -> list[int]:
    """The first columns, in an order, that are clearly independent; as many as rows."""
    chosen: list[int] = []
    basis = np.zeros((len(Q), 0))
    for clear in _CLEAR:
        for k in order:
            if len(chosen) == len(Q):
                return chosen
            if k in chosen:
                continue
            rest = Q[:, k] - basis @ (basis.T @ Q[:, k])
            size = float(np.linalg.norm(rest))
            if size > clear:
                basis = np.column_stack([basis, rest / size])
                chosen.append(k)
    return chosen


def needed_motion(
    robot: Robot,
    effects: Sequence[Effect],
    joint: int,
    columns: Sequence[int],
    known: Array,
    pose: Array,
    scale: Array,
) -> str:
    """The smallest change of the recordings whose torque of a joint shows all its parameters.

    Tried in this order: the joint alone from this pose; at several positions of one other
    joint; together with one; the same with two; together with all joints before it.

    Args:
        robot: The arm.
        effects: Effects that are estimated.
        joint: The joint whose row is read; it moves.
        columns: Its base parameters, as columns of the observation matrix, m of them.
        known: Combinations of them that are shown already, shape (k, m).
        pose: Where joints that are not mentioned stand, shape (nv,) [rad or m].
        scale: Scale of each of the parameters, shape (m,).

    Returns:
        A sentence.
    """
    for moved, turned in _candidates(robot.nv, joint):
        motion = _states(robot, joint, moved, turned, pose, len(columns) + _STATES)
        rows = observation_columns(robot, effects, motion)[:, joint][:, list(columns)]
        if _complete(rows * scale, known * scale):
            return _sentence(robot, joint, moved, turned)
    return (
        f"move {robot.joints[joint]} together with all joints before it, at several positions "
        "of those after it"
    )


Chosen = tuple[int, ...]


def _candidates(nv: int, joint: int) -> Iterator[tuple[Chosen, Chosen]]:
    """Joints that move beside the joint, and joints that are turned between runs."""
    others = [k for k in range(nv) if k != joint]
    yield (), ()
    for size in (1, 2) if nv <= _PAIRS else (1,):
        for chosen in combinations(others, size):
            yield (), chosen
        for chosen in combinations(others, size):
            yield chosen, ()
    yield tuple(range(joint)), ()


def _states(
    robot: Robot, joint: int, moved: Chosen, turned: Chosen, pose: Array, count: int
) -> Motion:
    q, dq, ddq = robot.random_motion(np.random.default_rng(0), count)
    still = np.ones(robot.nv, bool)
    still[[joint, *moved]] = False
    dq[:, still] = ddq[:, still] = 0.0
    still[list(turned)] = False
    q[:, still] = pose[still]
    return Motion(np.arange(float(count)), q, dq, ddq)


def _complete(rows: Array, known: Array) -> bool:
    blocks = [block / max(float(np.linalg.norm(block)), 1e-300) for block in (rows, known)]
    s = np.linalg.svd(np.vstack(blocks), compute_uv=False)
    return len(s) == rows.shape[1] and bool(s[-1] > _VISIBLE * s[0])


def _sentence(robot: Robot, joint: int, moved: Chosen, turned: Chosen) -> str:
    name = robot.joints[joint]
    if turned:
        return f"move {name} alone at several positions of {_listing(robot, turned)}"
    if moved:
        return f"move {name} together with {_listing(robot, moved)}"
    return f"move {name} alone, farther or faster than here"


def _listing(robot: Robot, joints: Chosen) -> str:
    return " and ".join(robot.joints[j] for j in joints)
