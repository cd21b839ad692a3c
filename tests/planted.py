"""Motions that excite an arm, and what a virtual arm hides; what fixtures give."""

from collections.abc import Callable, Sequence

import numpy as np

from excitant.analysis.diagnosis import Diagnosis
from excitant.design import random_trajectory
from excitant.identify import Recording
from excitant.robots import Motion, Robot
from excitant.robots.plant.planting import STRUCTURES
from excitant.robots.virtual_arm import HiddenEffect, draw_hidden_effect

Runs = Callable[..., list[Recording]]
Diagnosed = Callable[..., Diagnosis]
Case = Callable[[str], tuple[HiddenEffect, Diagnosis]]
FRICTION = ("viscous_friction", "coulomb_friction", "stribeck_friction")
DRAWN = (*FRICTION, "rotor_inertia", "payload", "torque_offset")
SCALAR = ("viscous_friction", "coulomb_friction", "rotor_inertia", "torque_offset")


def motion_of(robot: Robot, seed: int = 0, resting: Sequence[int] = ()) -> Motion:
    """Ten seconds of five harmonics at 50 Hz, some of the joints at rest."""
    motion = random_trajectory(robot, np.random.default_rng(seed), 10.0, 5).motion(50.0)
    q, dq, ddq = (np.array(x) for x in (motion.q, motion.dq, motion.ddq))
    q[:, resting], dq[:, resting], ddq[:, resting] = 0.4, 0.0, 0.0
    return Motion(motion.t, q, dq, ddq)


def stacked(*motions: Motion) -> Motion:
    """Motions at 50 Hz one after the other."""
    parts = [np.concatenate([getattr(m, n) for m in motions]) for n in ("q", "dq", "ddq")]
    return Motion(np.arange(len(parts[0])) / 50.0, *parts)


def hidden(kind: str, *joints: str, **parameters: float) -> HiddenEffect:
    effect, structure = ("unknown", kind) if kind in STRUCTURES else (kind, "")
    several = joints if len(joints) > 1 else ()
    return HiddenEffect(effect, (*joints, "")[0], tuple(parameters.items()), several, structure)


def drawn(robot: Robot, kind: str, seed: int) -> HiddenEffect:
    """An effect of one of the kinds `DRAWN`, where and as large as the virtual arm draws it."""
    rng = np.random.default_rng([seed, DRAWN.index(kind)])
    while (effect := draw_hidden_effect(robot, rng)).effect != kind:
        pass
    return effect
