"""Columns at the rows of segments, each worked out once however many models are fitted to them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from excitant.identify.preprocessing import Segment
from excitant.robots.effects import (
    Effect,
    InertialParameters,
    JointEffect,
    JointwiseEffect,
    Payload,
)
from excitant.robots.motion import Array, read_only
from excitant.robots.regressor import regressor
from excitant.robots.robot import Robot


@dataclass(frozen=True, eq=False)
class Observed:
    """Filtered columns of a robot and its effects at the rows of segments.

    Attributes:
        robot: Effects that rest on torque take it from here.
        segments: Where.
        links: Columns of the standard parameters at their rows, shape (n, nv, 10 nv).
    """

    robot: Robot
    segments: tuple[Segment, ...]
    links: Array
    _by_motion: dict[Effect, Array] = field(default_factory=dict, repr=False)
    _by_robot: dict[Effect, Array] = field(default_factory=dict, repr=False)

    def by(self, robot: Robot) -> Observed:
        """The same rows of the same arm with other inertias and effects."""
        return Observed(robot, self.segments, self.links, self._by_motion)

    def link(self, joint: str) -> Array:
        """Columns of the link that a joint carries, shape (n, nv, 10)."""
        j = self.robot.joint_index(joint)
        return self.links[:, :, 10 * j : 10 * j + 10]

    def columns(self, effect: Effect) -> Array:
        """Columns of one effect, shape (n, nv, k) [N·m per unit]."""
        if isinstance(effect, InertialParameters | Payload):
            return self.link(effect.joints[0])
        return np.concatenate([self._once(each) for each in _singles(effect)], axis=2)

    def matrix(self, effects: Sequence[Effect]) -> Array:
        """Columns of the standard parameters followed by those of effects, shape (n, nv, p)."""
        return np.concatenate([self.links, *map(self.columns, effects)], axis=2)

    def torque(self) -> Array:
        """Torque of the robot with its effects, shape (n, nv) [N·m]."""
        tau: Array = self.links @ self.robot.phi
        for effect in self.robot.effects:
            tau = tau + self.columns(effect) @ np.array(effect.values or ())
        return tau

    def _once(self, effect: Effect) -> Array:
        known = self._by_robot if rests_on_model(effect) else self._by_motion
        if effect not in known:
            rows = [s.rows(lambda m: effect.columns(self.robot, m)) for s in self.segments]
            known[effect] = read_only(np.concatenate(rows))
        return known[effect]


def observed(robot: Robot, segments: Sequence[Segment]) -> Observed:
    """Columns of a robot at the rows of segments."""
    links = np.concatenate([s.rows(lambda motion: regressor(robot, motion)) for s in segments])
    return Observed(robot, tuple(segments), read_only(links))


def rests_on_model(effect: Effect) -> bool:
    """Whether an effect's columns depend on what else is believed of the robot."""
    return not isinstance(effect, JointEffect | InertialParameters | Payload)


def _singles(effect: Effect) -> Iterator[Effect]:
    """The effect without values, joint by joint where each has coefficients of its own."""
    bare = replace(effect, values=None)
    if not isinstance(effect, JointwiseEffect) or effect.arity:
        yield bare
        return
    for joint in effect.joints:
        yield replace(bare, joints=(joint,))
