"""Torque of a robot with its effects, and the columns of everything that is linear in it."""

from collections.abc import Sequence

import numpy as np

from excitant.robots.effects import Effect, Parameter
from excitant.robots.effects import effect_values as effect_values
from excitant.robots.motion import Array, Motion
from excitant.robots.parameters import UNITS
from excitant.robots.regressor import regressor, rigid_body_torque
from excitant.robots.robot import Robot


def torque(robot: Robot, motion: Motion) -> Array:
    """Torque that the robot with its effects needs for a motion, shape (n, nv) [N·m]."""
    tau = rigid_body_torque(robot, motion)
    for effect in robot.effects:
        tau += effect.torque(robot, motion)
    return tau


def observation_columns(
    robot: Robot, effects: Sequence[Effect], motion: Motion
) -> Array:
    """Columns of the standard parameters followed by those of effects, shape (n, nv, p)."""
    parts = [
        regressor(robot, motion),
        *(effect.columns(robot, motion) for effect in effects),
    ]
    return np.concatenate(parts, axis=2)


def coefficients(robot: Robot, effects: Sequence[Effect]) -> tuple[Parameter, ...]:
    """The coefficients of effects, in the order of their columns."""
    return tuple(p for effect in effects for p in effect.parameters(robot))


def column_names(robot: Robot, effects: Sequence[Effect]) -> tuple[str, ...]:
    """Names of the columns of `observation_columns`."""
    return (*robot.parameter_names, *(p.name for p in coefficients(robot, effects)))


def column_units(robot: Robot, effects: Sequence[Effect]) -> tuple[str, ...]:
    """Units of the parameters of `observation_columns`."""
    return (*UNITS * robot.nv, *(p.unit for p in coefficients(robot, effects)))


def known_values(robot: Robot, effects: Sequence[Effect]) -> list[float | None]:
    """Values of all parameters as the robot is given; None where not known."""
    values = effect_values(robot)
    known = (values.get(p.name) for p in coefficients(robot, effects))
    return [*robot.phi.tolist(), *known]


def largest_torque(robot: Robot, motion: Motion) -> Array:
    """Torque of largest magnitude within the uncertainty of the masses, shape (n, nv).

    With each link's parameters free within ± p, the limits' ``mass_uncertainty``, Σᵢ p |τᵢ| is
    added to the magnitude, τᵢ the torque of link i.
    """
    tau = torque(robot, motion)
    p = robot.limits.mass_uncertainty
    if p == 0:
        return tau
    margin = p * np.abs(link_torques(robot, motion)).sum(axis=2)
    return np.where(tau < 0, tau - margin, tau + margin)


def link_torques(robot: Robot, motion: Motion) -> Array:
    """Torque that each link's own inertial parameters need, shape (n, nv, links)."""
    Y = regressor(robot, motion)
    by_link = Y.reshape(*Y.shape[:2], robot.nv, 10)
    return np.einsum("njlp,lp->njl", by_link, robot.phi.reshape(-1, 10))
