"""Effects that a model may get beyond the standard one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from excitant.analysis.candidates import proposals
from excitant.identify.preprocessing import Segment
from excitant.robots.effects import (
    AsymmetricFriction,
    Backlash,
    Effect,
    FrictionCoupling,
    InertiaCoupling,
    JointElasticity,
    LoadDependentFriction,
    NonlinearViscousFriction,
    PreslidingHysteresis,
    Spring,
    StribeckFriction,
    ThermalFrictionDrift,
    TimeDelay,
    TorqueRipple,
)
from excitant.robots.motion import Array
from excitant.robots.robot import Robot

KINDS = (
    StribeckFriction,
    NonlinearViscousFriction,
    LoadDependentFriction,
    AsymmetricFriction,
    PreslidingHysteresis,
    ThermalFrictionDrift,
    FrictionCoupling,
    InertiaCoupling,
    TorqueRipple,
    Spring,
    TimeDelay,
    JointElasticity,
    Backlash,
)
"""What a model may get beyond the standard one; the rest is in the bodies' own parameters."""

SHARED = (
    StribeckFriction,
    NonlinearViscousFriction,
    LoadDependentFriction,
    PreslidingHysteresis,
)
"""What is also tried at all joints at once."""


def further_effects(
    robot: Robot, segments: Sequence[Segment], unexplained: Array
) -> list[tuple[Effect, int]]:
    """Effects with the number of shapes that each was chosen from; see `proposals`.

    Each kind at each joint in several shapes, and what all drives have in common at all joints.
    """
    own = [pair for pair in proposals(robot, segments, unexplained) if isinstance(pair[0], KINDS)]
    return own + [(effect, 1) for effect in _shared([e for e, _ in own], robot.joints)]


def _shared(single: Sequence[Effect], joints: tuple[str, ...]) -> list[Effect]:
    """The kinds of friction that all drives of an arm have in common, of one shape at all joints.

    Shapes are those proposed for the joint in the middle of the order of their sizes.
    """
    if len(joints) < 2:
        return []
    found: list[Effect] = []
    for kind in SHARED:
        own = [[e for e in single if type(e) is kind and e.joints == (j,)] for j in joints]
        moving = [effects for effects in own if effects]
        if not moving:
            continue
        names = tuple(effects[0].joints[0] for effects in moving)
        size = [next(iter(_shape(effects[0]).values()), 0.0) for effects in moving]
        middle = moving[int(np.argsort(size)[len(size) // 2])]
        found += [replace(effect, joints=names) for effect in middle] if len(names) > 1 else []
    return found


def _shape(effect: Effect) -> dict[str, float]:
    return {k: v for k, v in vars(effect).items() if k not in ("joints", "values")}
