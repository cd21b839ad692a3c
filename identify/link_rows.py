"""Rows of all recordings for identification link by link, and how the joints moved in them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from excitant.identify.accuracy import series
from excitant.identify.base_prior import base_prior
from excitant.identify.regression import regression_of
from excitant.identify.rows import Data, FitRows
from excitant.identify.stage_gains import stage_gains
from excitant.identify.standstill import Mask, dry_joints, moving, stilled
from excitant.robots.base_parameters import BaseParameters, base_parameters
from excitant.robots.effects import Effect
from excitant.robots.motion import Array
from excitant.robots.robot import Robot
from excitant.robots.torque_rows import last_rows

_SOMETIMES = 0.1  # of the time that a joint moves: what happens more rarely is not mentioned
_POSE = 0.1  # rad or m: positions that differ less are one pose


@dataclass(frozen=True, eq=False)
class LinkRows:
    """Rows of all recordings, and which of them count.

    Attributes:
        fit: Columns and torque; joints that stay still in a segment are held exactly.
        moves: Instants at which joints move, per segment at its full rate, each (n, nv).
        used: Rows that count: of moving joints, and of those without dry friction, (n, nv).
        last: The last joint whose row holds each base parameter, shape (r,).
        scale: Uncertainty of the given robot's base parameters, shape (r,).
        compared: Whether drive gains rest on rows of several joints.
    """

    fit: FitRows
    moves: tuple[Mask, ...]
    used: Mask
    last: npt.NDArray[np.intp]
    scale: Array
    compared: bool

    @property
    def base(self) -> BaseParameters:
        """Base parameters of links and effects."""
        return self.fit.base

    def recordings(self, joint: int) -> tuple[str, ...]:
        """Recordings in which rows of a joint count."""
        train = self.fit.data.train
        parts = np.split(self.used[:, joint], np.cumsum([len(s.t) for s in train])[:-1])
        names = [s.name for s, used in zip(train, parts, strict=True) if used.any()]
        return tuple(dict.fromkeys(names))

    def pose(self, joint: int) -> Array:
        """Where the arm stands on average while a joint moves, shape (nv,)."""
        train = self.fit.data.train
        pairs = zip(train, self.moves, strict=True)
        poses = [s.motion.q[m[:, joint]] for s, m in pairs if m[:, joint].any()]
        poses = poses or [s.motion.q for s in train]
        return np.asarray(np.concatenate(poses).mean(axis=0), float)

    def mode(self, robot: Robot, joint: int) -> str:
        """Which joints move while a joint does, in words; rare moments are left aside."""
        times, poses = [], []
        for segment, moves in zip(self.fit.data.train, self.moves, strict=True):
            now = moves[:, joint]
            if now.any():
                times.append(moves[now].sum(axis=0) / segment.rate_hz)
                poses.append(np.delete(segment.motion.q[now].mean(axis=0), joint))
        if not poses:
            return "does not move"
        each = np.array(times)
        share = each.sum(axis=0) / each[:, joint].sum()
        often = each[:, joint] > _SOMETIMES * each[:, joint].sum()
        share[joint] = 0.0
        others = np.flatnonzero(share > _SOMETIMES)
        if len(others):
            if joint and set(range(joint)) <= set(others.tolist()):
                return "moves with all joints before it"
            return "moves with " + ", ".join(robot.joints[k] for k in others)
        spread = np.ptp(np.array(poses)[often], axis=0).max(initial=0.0)
        briefly = " but for moments" if share.max() > 0 else ""
        return f"moves alone{briefly}, the others in " + (
            "several poses" if spread > _POSE else "one pose"
        )


def link_rows(robot: Robot, effects: tuple[Effect, ...], data: Data) -> LinkRows:
    """Rows of the training segments, see `LinkRows`."""
    moves = tuple(moving(robot, data.train))
    train = tuple(stilled(s, m) for s, m in zip(data.train, moves, strict=True))
    data = replace(data, train=train)
    base = base_parameters(robot, effects)
    regression, measured = regression_of(robot, effects, train), series(train)
    used = np.concatenate([m[s.keep] for s, m in zip(train, moves, strict=True)])
    used = used | ~dry_joints(effects, robot.joints)
    gains, compared = np.ones(robot.nv), True
    if data.unit == "A":
        gains, compared = stage_gains(robot, base, regression.W, measured.measured, used)
    regression = regression.with_torque(regression.tau * gains)
    fit = FitRows(robot, effects, base, data, gains, regression)
    scale = np.sqrt(np.diag(base_prior(robot, effects, base).covariance))
    return LinkRows(fit, moves, used, last_rows(robot, effects, base), scale, compared)
