"""Shapes that a cause may have where it must follow what another one does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from excitant.robots.effects import Effect, NonlinearViscousFriction, TimeDelay
from excitant.robots.motion import Motion
from excitant.robots.robot import Robot

_NEAR = (0.25, 0.5, 1.0, 2.0, 4.0)  # times the shape that was found
_SHAPES = ("velocity", "distance", "time", "trial")
_SLOW = 0.4  # of a joint's highest speed: a Stribeck velocity beyond it is Coulomb friction
_SHORT = 0.1  # of a joint's range: friction that builds up over more is a spring
_LONGEST_DELAY, _WIDEST_GAP = 0.04, 0.1  # s, rad


def shapes(effect: Effect, robot: Robot, recorded: Sequence[Motion]) -> list[Effect]:
    """An effect without values, in its own shape and in those that it may also have.

    Args:
        effect: The effect.
        robot: The arm.
        recorded: Motions that shapes are measured by; without any, none is too large.
    """
    own = bare(effect)
    if isinstance(own, NonlinearViscousFriction):
        return [own, *(replace(own, exponent=a) for a in own.exponents if a != own.exponent)]
    for name in _SHAPES:
        if hasattr(own, name):
            value, most = getattr(own, name), _largest(own, name, robot, recorded)
            near = (factor * value for factor in _NEAR)
            return [replace(own, **{name: v}) for v in near if abs(v) <= max(abs(value), most)]
    return [own]


def _largest(effect: Effect, name: str, robot: Robot, recorded: Sequence[Motion]) -> float:
    """Largest shape that counts; beyond it, an effect becomes another."""
    if name == "trial":
        return _LONGEST_DELAY if isinstance(effect, TimeDelay) else _WIDEST_GAP
    if not recorded:
        return np.inf
    j = robot.joint_index(effect.joints[0])
    if name == "velocity":
        return _SLOW * max(float(np.abs(m.dq[:, j]).max()) for m in recorded)
    if name == "distance":
        return _SHORT * float(np.ptp(np.concatenate([m.q[:, j] for m in recorded])))
    return max(float(m.t[-1]) for m in recorded) - min(float(m.t[0]) for m in recorded)


def bare(effect: Effect) -> Effect:
    """An effect without values."""
    return replace(effect, values=None)
