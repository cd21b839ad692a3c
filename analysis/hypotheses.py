"""What may be wrong with a given model: its tolerances, and the causes to consider."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from excitant.analysis.evidence import Candidate
from excitant.identify.accuracy import predicted_torque, series
from excitant.identify.physical import link_coordinates, link_weights
from excitant.identify.preprocessing import Segment
from excitant.identify.rows import implausible_size, observation
from excitant.robots.effects import (
    CoulombFriction,
    Effect,
    InertialParameters,
    Payload,
    RotorInertia,
    StribeckFriction,
    TorqueOffset,
    ViscousFriction,
)
from excitant.robots.motion import Array, read_only
from excitant.robots.robot import Robot

TOLERANCE = 0.05  # relative standard deviation of the given values: right to ±10 %
WRONG_LINK = 1.0  # relative size of the changes that `inertial_parameters` stands for
_STRIBECK_SPEEDS = np.geomspace(0.01, 0.4, 8)  # of each joint's highest speed in the recording
_REACH = 0.3  # m: scale of a payload's lever, decides nothing but the units of its coordinates


@dataclass(frozen=True, eq=False)
class Rows:
    """Residual of the given model with all columns, at the rows of some segments.

    Attributes:
        X: Columns, nuisance first, shape (n, nv, p).
        residual: Measured less given torque, shape (n, nv) [N·m].
    """

    X: Array
    residual: Array


@dataclass(frozen=True, eq=False)
class Hypotheses:
    """Columns of a diagnosis, the same for every recording.

    Attributes:
        robot: The given robot.
        metric: Bodies that tolerances are relative to, shape (nv, 10).
        candidates: Causes to consider.
        nuisance: Number of leading columns that stand for tolerances of the given values.
        precision: Prior precision of every column's coordinate.
        given_scale: Tolerance of each coefficient of the given effects.
    """

    robot: Robot
    metric: Array
    candidates: tuple[Candidate, ...]
    nuisance: int
    precision: Array
    given_scale: Array

    def rows(self, segments: Sequence[Segment], gains: Array) -> Rows:
        """Residual and columns of segments; torque readings times gains are N·m."""
        robot = self.robot
        singles = [c.effect for c in self.candidates if not isinstance(c.effect, _BODIES)]
        W = observation(robot, [*robot.effects, *singles], segments)
        links = 10 * robot.nv
        given = links + len(self.given_scale)
        parts = [
            W[:, :, :links] @ link_coordinates(self.metric),
            W[:, :, links:given] * self.given_scale,
        ]
        start = given
        for candidate in self.candidates:
            if isinstance(candidate.effect, _BODIES):
                j = robot.joint_index(candidate.effect.joints[0])
                columns = W[:, :, 10 * j : 10 * j + 10]
            else:
                columns = W[:, :, start : start + candidate.size]
                start += candidate.size
            parts.append(columns @ candidate.scale)
        measured = series(segments).measured * gains
        return Rows(
            read_only(np.concatenate(parts, axis=2)),
            read_only(measured - predicted_torque(robot, segments)),
        )


_BODIES = (InertialParameters, Payload)


def hypotheses(
    robot: Robot, metric: Array, segments: Sequence[Segment], tolerance: float = TOLERANCE
) -> Hypotheses:
    """Columns for a robot, the shapes of the candidates fitted to the motion's speeds.

    Args:
        robot: The given robot with its effects.
        metric: Bodies that tolerances are relative to, shape (nv, 10).
        segments: Recording the candidates are to explain.
        tolerance: Relative standard deviation of the given inertias and effects.
    """
    given = np.concatenate([np.abs(e.values or ()) for e in robot.effects] or [np.zeros(0)])
    given_scale = tolerance * np.where(given > 0, given, 1e-9)
    weights = [link_weights(robot.nv, tolerance) ** 2, np.ones(len(given))]
    nuisance = start = 10 * robot.nv + len(given)
    candidates = []
    for effect, scale, weight in _effects(robot, metric, segments):
        stop = start + len(weight)
        candidates.append(Candidate(effect, slice(start, stop), scale))
        weights.append(weight)
        start = stop
    return Hypotheses(
        robot,
        metric,
        tuple(candidates),
        nuisance,
        read_only(np.concatenate(weights)),
        read_only(given_scale),
    )


def _effects(
    robot: Robot, metric: Array, segments: Sequence[Segment]
) -> list[tuple[Effect, Array, Array]]:
    """Each candidate with the scale of its coordinates and their prior precision."""
    found: list[tuple[Effect, Array, Array]] = []
    speed = np.max([np.abs(s.motion.dq).max(axis=0) for s in segments], axis=0)
    torque = np.concatenate([s.tau[s.keep] for s in segments])
    for j, joint in enumerate(robot.joints):
        own: list[Effect] = [
            kind((joint,))
            for kind in (ViscousFriction, CoulombFriction, TorqueOffset, RotorInertia)
        ]
        own += [
            StribeckFriction((joint,), velocity=float(v * speed[j]))
            for v in _STRIBECK_SPEEDS
            if speed[j] > 0
        ]
        for effect in own:
            columns = np.concatenate([effect.columns(robot, s.motion[s.keep]) for s in segments])
            size = implausible_size(columns[:, [j]], torque[:, [j]])
            found.append((effect, np.diag(size), np.ones(1)))
        block = link_coordinates(metric[[j]])
        found.append((InertialParameters((joint,)), block, link_weights(1, WRONG_LINK) ** 2))
    found.append((Payload((robot.joints[-1],)), _payload_scale(metric), np.ones(10)))
    return found


def _payload_scale(metric: Array) -> Array:
    """Units of a payload's coordinates: the arm's mass at the scale of a lever."""
    mass = metric[:, 0].sum()
    units = mass * np.repeat([1.0, _REACH, _REACH**2], [1, 3, 6])
    return np.diag(units)
