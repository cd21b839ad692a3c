"""Structural identifiability under stated circumstances, and how firmly it stands.

Which joints move, which are held and where, which torques are known, and gravity decide what
torque can show of each parameter. Every category is a decision about sizes that are zero or not;
with geometry that is nearly special (a twist 1e-6 rad off a right angle) it hangs by a hair, and
the result says so.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from excitant.analysis.expressions import length_symbols, symbolic_expressions
from excitant.analysis.nullspace import Held, parameter_nullspace
from excitant.exceptions import BadRobot, UnknownName
from excitant.robots.base_parameters import (
    TOLERANCE,
    BaseParameters,
    Observation,
    categories,
    observe,
    regroup,
    structural_motion,
)
from excitant.robots.effects import Effect
from excitant.robots.motion import Array, Motion, freeze
from excitant.robots.robot import Robot
from excitant.robots.scale import arm_length

HAIR = 1e4  # factor on the tolerance that must not change a category
_STEPS = 8  # half decades to there


@dataclass(frozen=True, eq=False)
class Structure:
    """What torque can show of each parameter, under stated circumstances.

    Attributes:
        base: Base parameters of links and effects.
        category: ``unique``, ``combined`` or ``unidentifiable`` for each of ``base.names``.
        margin: Factor by which the tolerance of all decisions (1e-8 of the longest column)
            can grow or shrink before the category changes, at most 1e4, shape (p,).
        circumstances: What it holds for, as sentences.
        close: Names whose margin is below 1e4: decided by a hair.
        flips_at: Tolerance at which the category changes, nan where the margin is 1e4, (p,).
        symbolic: The expressions with letters for lengths where that is unambiguous.
        lengths: Lengths that the letters stand for [m].
    """

    base: BaseParameters
    category: tuple[str, ...]
    margin: Array
    circumstances: tuple[str, ...]
    close: tuple[str, ...]
    flips_at: Array
    symbolic: tuple[str, ...] = ()
    lengths: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        freeze(self, "margin", "flips_at")


def structure(
    robot: Robot,
    effects: Sequence[Effect] = (),
    *,
    moving: Sequence[str] | None = None,
    measured: Sequence[str] | None = None,
    held: Held | None = None,
) -> Structure:
    """What torque can show of an arm's parameters.

    Args:
        robot: The arm; gravity and locked joints count.
        effects: Effects whose coefficients are unknown too.
        moving: Joints that move; all when None.
        measured: Joints whose torque is known; all when None.
        held: Positions of the joints that do not move [rad or m], 0 for those left out;
            ``"any"`` when they are at rest at many positions.

    Raises:
        UnknownName: A joint that the arm does not have.
    """
    _check_names(robot, moving, measured, held)
    motion = _circumstantial(robot, moving, {} if held is None else held)
    rows = None if measured is None else np.isin(robot.joints, measured)
    seen = observe(robot, effects, motion, rows)
    base = regroup(seen)
    category = categories(base)
    flips_at = _flips(seen, category)
    margin = np.nan_to_num(np.maximum(flips_at / TOLERANCE, TOLERANCE / flips_at), nan=HAIR)
    symbolic, lengths = _letters(robot, base)
    return Structure(
        base,
        category,
        margin,
        _circumstances(robot, moving, measured, held),
        tuple(n for n, at in zip(base.names, flips_at, strict=True) if np.isfinite(at)),
        flips_at,
        symbolic,
        lengths,
    )


def _check_names(
    robot: Robot, moving: Sequence[str] | None, measured: Sequence[str] | None, held: Held | None
) -> None:
    positions = held if isinstance(held, Mapping) else {}
    for name in (*(moving or ()), *(measured or ()), *positions):
        if name not in robot.joints:
            raise UnknownName("joint", name, robot.joints)


def _circumstantial(robot: Robot, moving: Sequence[str] | None, held: Held) -> Motion:
    """Random states in which only some joints move, and the others are held."""
    motion = structural_motion(robot, np.random.default_rng(0))
    if moving is None:
        return motion
    still = ~np.isin(robot.joints, moving)
    q, dq, ddq = (np.array(x) for x in (motion.q, motion.dq, motion.ddq))
    dq[:, still] = ddq[:, still] = 0.0
    if isinstance(held, Mapping):
        q[:, still] = np.array([held.get(name, 0.0) for name in robot.joints])[still]
    return replace(motion, q=q, dq=dq, ddq=ddq)


def _flips(seen: Observation, category: tuple[str, ...]) -> Array:
    """Tolerance nearest to the one in use at which each category changes, shape (p,).

    In the middle of the half decade in which it does; nan if none within a factor of `HAIR`.
    """
    flips_at = np.full(len(category), np.nan)
    for step in range(_STEPS, 0, -1):  # the nearest is written last
        for sign in (1, -1):
            other = categories(regroup(seen, TOLERANCE * 10 ** (sign * step / 2)))
            changed = np.array(other) != np.array(category)
            flips_at[changed] = TOLERANCE * 10 ** (sign * (step - 0.5) / 2)
    return flips_at


def _letters(robot: Robot, base: BaseParameters) -> tuple[tuple[str, ...], dict[str, float]]:
    """Expressions with letters, and the lengths that occur in them; numbers where joints branch."""
    try:
        lengths = length_symbols(robot)
    except BadRobot:
        return base.expressions, {}
    texts = symbolic_expressions(base, robot.links, lengths)
    letters = " ".join(texts).replace("²", " ").replace("·", " ").replace("(", " ").split()
    return texts, {x: value for x, value in lengths.items() if x in letters}


def _circumstances(
    robot: Robot,
    moving: Sequence[str] | None,
    measured: Sequence[str] | None,
    held: Held | None,
) -> tuple[str, ...]:
    found = ["the base is fixed", _gravity_sentence(robot.gravity)]
    if robot.locked:
        names = ", ".join(f"{name} at {value:.4g}" for name, value in robot.locked)
        found.append(f"{_joints(len(robot.locked))} {names} locked")
    still = [name for name in robot.joints if moving is not None and name not in moving]
    if still and held == "any":
        found.append(f"{_joints(len(still))} {', '.join(still)} at rest at many positions")
    elif still:
        at = held if isinstance(held, Mapping) else {}
        names = ", ".join(f"{name} at {at.get(name, 0.0):.4g}" for name in still)
        found.append(f"{_joints(len(still))} {names} held")
    missing = [name for name in robot.joints if measured is not None and name not in measured]
    if missing:
        found.append(f"torque of {_joints(len(missing))} {', '.join(missing)} not measured")
    return tuple(found)


def _joints(count: int) -> str:
    return "joint" if count == 1 else "joints"


def _gravity_sentence(gravity: Array) -> str:
    size = float(np.linalg.norm(gravity))
    if size == 0:
        return "no gravity"
    direction = gravity / size
    k = int(np.argmax(np.abs(direction)))
    if abs(direction[k]) > 1 - 1e-12:
        return f"gravity along {'−' if direction[k] < 0 else ''}{'xyz'[k]} of the base"
    return f"gravity along ({', '.join(f'{x:.4g}' for x in direction)}) of the base"


@dataclass(frozen=True)
class Agreement:
    """Two methods that share no regressor, side by side.

    Attributes:
        numerical: Number of base parameters by the regressor on random states.
        recursive: Number by the recursion from base to tip.
        per_link: What each link brings, by the recursion.
        angle: Largest angle between their null spaces; π/2 when the numbers differ [rad].
    """

    numerical: int
    recursive: int
    per_link: tuple[int, ...]
    angle: float

    @property
    def agree(self) -> bool:
        """Whether the null spaces are the same to 1e-6 rad."""
        return self.angle < 1e-6


def second_opinion(
    robot: Robot, *, moving: Sequence[str] | None = None, held: Held | None = None
) -> Agreement:
    """Compare the null space of the regressor with that of the recursion, torques of all that move.

    Args:
        robot: The arm.
        moving: Joints that move and whose torques are known; all when None.
        held: Positions of the others, as for `structure`.

    Raises:
        UnknownName: A joint that the arm does not have.
    """
    base = structure(robot, moving=moving, measured=moving, held=held).base
    other = parameter_nullspace(robot, moving=moving, held=held)
    angle = other.angle(base.null_space, arm_length(robot))
    return Agreement(len(base), len(other), other.shown, angle)


def structure_values(s: Structure) -> dict[str, Any]:
    """A structure as plain values for JSON."""
    base = s.base
    return {
        "standard_parameters": len(base.names),
        "base_parameters": len(base),
        "circumstances": list(s.circumstances),
        "parameters": [
            {"name": name, "category": category, "margin": float(margin)}
            for name, category, margin in zip(base.names, s.category, s.margin, strict=True)
        ],
        "regrouping": [
            {
                "expression": text,
                "symbolic": letters,
                "members": [base.names[k] for k in np.flatnonzero(row)],
            }
            for text, letters, row in zip(
                base.expressions, s.symbolic, base.regrouping, strict=True
            )
        ],
        "lengths_m": dict(s.lengths),
        "gap": list(base.gap),
        "close": list(s.close),
        "by_a_hair": _hair_sentence(s),
    }


def _hair_sentence(s: Structure) -> str | None:
    if not s.close:
        return None
    low, high = np.nanmin(s.flips_at), np.nanmax(s.flips_at)
    size = f"{low:.0e}" if high < 2 * low else f"{low:.0e} to {high:.0e}"
    return (
        f"{len(s.close)} of {len(s.base.names)} parameters are decided by a hair, by parts of "
        f"about {size} of their torque (geometry, pose or mounting nearly special): "
        f"{', '.join(s.close[:6])}{' and more' if len(s.close) > 6 else ''}"
    )
