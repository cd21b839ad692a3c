"""Which motion would show what recordings leave open: the fewest joints, found by trying."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np

from excitant.robots.effects import Effect
from excitant.robots.motion import Array, Motion
from excitant.robots.robot import Robot
from excitant.robots.torque import observation_columns

_STATES = 40  # beyond the parameters sought
_VISIBLE = 1e-6  # of the largest singular value
_PAIRS = 10  # joints up to which pairs of them are tried


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
