"""What is known of base parameters before any data, and a reference motion to measure against."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from excitant.identify.information import Information, gaussian
from excitant.identify.physical import (
    PRIOR_SIGMA,
    link_coordinates,
    link_weights,
    prior_parameters,
)
from excitant.robots.base_parameters import BaseParameters
from excitant.robots.effects import Effect
from excitant.robots.motion import Array, Motion, freeze
from excitant.robots.robot import Robot
from excitant.robots.torque import effect_values, observation_columns, torque

_HARMONICS = 5
_LIMIT_SHARE = 0.5  # share of the limits on speed and acceleration that a reference motion uses
_FREE_SPEED, _FREE_ACCELERATION = 3.0, 10.0  # rad/s, rad/s² where there is no limit
_RANGE = 0.9  # share of the position limits


@dataclass(frozen=True, eq=False)
class BasePrior:
    """Normal distribution of the base parameters.

    Attributes:
        mean: Shape (r,).
        covariance: Regular, shape (r, r).
    """

    mean: Array
    covariance: Array

    def __post_init__(self) -> None:
        freeze(self, "mean", "covariance")

    def information(self) -> Information:
        """The same in square-root form."""
        return gaussian(self.mean, self.covariance)


def reference_motion(robot: Robot, duration: float, rate_hz: float) -> Motion:
    """All joints moving at once at half their limits: what a motion of this length can show.

    Sums of five harmonics with fixed random phases around the middle of the position limits;
    always the same for the same arm and duration.
    """
    rng = np.random.default_rng(0)
    t = np.arange(0, duration, 1 / rate_hz)
    omega = 2 * np.pi / duration * np.arange(1, _HARMONICS + 1)
    phase = rng.uniform(0, 2 * np.pi, (_HARMONICS, robot.nv))
    size = rng.uniform(0.5, 1.0, phase.shape) / omega[:, None]
    angle = omega[:, None] * t[:, None, None] + phase
    orders = [
        (size * omega[:, None] ** k * np.sin(angle + k * np.pi / 2)).sum(axis=1) for k in range(3)
    ]
    low, high = np.clip(robot.limits.position, -np.pi, np.pi).T
    speed = np.where(robot.limits.velocity < 1e3, robot.limits.velocity, _FREE_SPEED)
    limit = robot.limits.acceleration
    acceleration = np.where(limit < 1e4, limit, _FREE_ACCELERATION)
    ends = (_RANGE * (high - low) / 2, _LIMIT_SHARE * speed, _LIMIT_SHARE * acceleration)
    largest = [np.abs(values).max(axis=0) for values in orders]
    scale = np.min([end / size for end, size in zip(ends, largest, strict=True)], axis=0)
    return Motion(t, (low + high) / 2 + scale * orders[0], scale * orders[1], scale * orders[2])


def base_prior(
    robot: Robot,
    effects: Sequence[Effect],
    base: BaseParameters,
    sigma: float = PRIOR_SIGMA,
) -> BasePrior:
    """The given robot as a prior of its base parameters.

    Links are known to the relative σ of `fit_physical`; coefficients of effects are those of
    the robot where it has them, else zero, give or take one that makes all torque of its joint.

    Raises:
        BadRobot: A link without mass.
    """
    phi = prior_parameters(robot)
    T = link_coordinates(phi)
    links = T @ np.diag(link_weights(robot.nv, sigma) ** -2.0) @ T.T
    known = effect_values(robot)
    names = base.names[10 * robot.nv :]
    mean = np.concatenate([phi.ravel(), [known.get(name, 0.0) for name in names]])
    spread = _effect_sizes(robot, effects)
    covariance = scipy.linalg.block_diag(links, np.diag(spread**2))
    B = base.regrouping
    total = B @ covariance @ B.T
    return BasePrior(B @ mean, (total + total.T) / 2)


def _effect_sizes(robot: Robot, effects: Sequence[Effect]) -> Array:
    """Coefficients that would make as much torque as a reference motion needs, shape (e,)."""
    motion = reference_motion(robot, 10.0, 20.0)
    columns = observation_columns(robot, effects, motion)[:, :, 10 * robot.nv :]
    size = np.sqrt((columns**2).mean(axis=0))
    needed = np.sqrt((torque(robot, motion) ** 2).mean(axis=0))
    needed = np.maximum(needed, 1e-2 * needed.max())  # a joint without load still has friction
    with np.errstate(divide="ignore"):
        each = np.where(size > 0, needed[:, None] / np.where(size > 0, size, 1.0), np.inf)
    smallest = each.min(axis=0, initial=np.inf)
    return np.asarray(np.where(np.isfinite(smallest), smallest, 1.0), float)
