"""Columns of base parameters averaged over a block of samples, fast enough for a control loop."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from excitant.exceptions import BadInput
from excitant.identify.preprocessing import dry_joints
from excitant.robots.base_parameters import BaseParameters
from excitant.robots.effects.base import Effect, Law
from excitant.robots.motion import Array, Motion
from excitant.robots.robot import Robot
from excitant.robots.torque import observation_columns

_Indices = npt.NDArray[np.intp]

_STATES = 100


class BlockColumns:
    """Mean columns of a block of K states.

    Effects whose shape is one formula for all joints are evaluated once for all of them.

    Args:
        robot: The arm.
        effects: Effects to estimate; each must depend on the present state alone.
        base: Base parameters of robot and effects.
        block: K.

    Attributes:
        used: For every joint, the base columns that its row can contain.

    Raises:
        BadInput: An effect that depends on the past.
    """

    def __init__(
        self, robot: Robot, effects: Sequence[Effect], base: BaseParameters, block: int
    ) -> None:
        self.robot, self._block, self._mean = robot, block, np.full(block, 1 / block)
        chosen = np.array(base.columns, int)
        self._links = chosen[chosen < 10 * robot.nv]
        self._chosen = chosen[chosen >= 10 * robot.nv] - 10 * robot.nv
        self._count = sum(len(effect.parameters(robot)) for effect in effects)
        self._fast: dict[tuple[str, ...], tuple[_Indices, list[tuple[Law, _Indices]]]] = {}
        self._slow: list[tuple[Effect, int]] = []
        start = 0
        for effect in effects:
            if effect.law is not None:
                _refuse_memory(effect.name, effect.law)
                joints = np.array(effect.rows(robot), int)
                terms = len(effect.parameters(robot)) // len(joints)
                columns = start + terms * np.arange(len(joints)) + np.arange(terms)[:, None]
                members = self._fast.setdefault(effect.joints, (joints, []))[1]
                members.append((effect.law, joints * self._count + columns))
            else:
                self._slow.append((effect, start))
            start += len(effect.parameters(robot))
        self._dry = dry_joints(effects, robot.joints)
        self.used = _structure(robot, effects, chosen)

    def __call__(self, Y: Array, states: Array) -> Array:
        """Mean columns, shape (nv, r).

        Args:
            Y: Mean regressor of the block, shape (nv, 10 nv).
            states: Position, velocity and acceleration, shape (K, 3, nv).
        """
        F, mean = np.zeros((self.robot.nv, self._count)), self._mean
        for joints, members in self._fast.values():
            q, dq, ddq = states[:, :, joints].transpose(1, 0, 2).reshape(3, -1)
            for law, cells in members:
                for cell, values in zip(cells, law(q, dq, ddq), strict=True):
                    F.put(cell, mean @ values.reshape(self._block, -1))
        for slow, start in self._slow:
            motion = Motion(np.arange(float(self._block)), *states.transpose(1, 0, 2))
            columns = slow.columns(self.robot, motion).mean(axis=0)
            F[:, start : start + columns.shape[1]] = columns
        return np.concatenate([Y[:, self._links], F[:, self._chosen]], axis=1)

    def certain(self, path: Array, least: Array) -> npt.NDArray[np.bool_]:
        """Joints that go one way along a path, or have no dry friction, shape (nv,).

        Args:
            path: Positions, shape (k, nv).
            least: Steps between them that are more than noise, shape (nv,).
        """
        steps = path[1:] - path[:-1]
        one_way = (steps > least).all(axis=0) | (steps < -least).all(axis=0)
        return np.asarray(one_way | ~self._dry, bool)


def _structure(robot: Robot, effects: Sequence[Effect], columns: _Indices) -> list[_Indices]:
    q, dq, ddq = robot.random_motion(np.random.default_rng(1), _STATES)
    W = observation_columns(robot, effects, Motion(np.arange(float(_STATES)), q, dq, ddq))
    present = np.abs(W[:, :, columns]).max(axis=0) > 0
    return [np.flatnonzero(row) for row in present]


def _refuse_memory(name: str, law: Law) -> None:
    """Refuse an effect whose torque changes when the order of the samples does."""
    rng = np.random.default_rng(2)
    q, dq, ddq = rng.standard_normal((3, _STATES))
    order = rng.permutation(_STATES)
    plain, shuffled = law(q, dq, ddq), law(q[order], dq[order], ddq[order])
    if not all(np.allclose(a[order], b) for a, b in zip(plain, shuffled, strict=True)):
        raise BadInput(
            f"on-line estimation: {name} depends on the past motion; leave it out, "
            "or identify off line"
        )
