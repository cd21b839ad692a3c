"""Robot arms: models, parameters, effects, and the torque of a motion."""

from excitant.robots.base_parameters import BaseParameters, base_parameters
from excitant.robots.dh import DHChain, robot_from_dh
from excitant.robots.limits import Limits
from excitant.robots.limits_file import load_limits
from excitant.robots.loading import builtin_robots, load_robot
from excitant.robots.motion import Array, Motion
from excitant.robots.regressor import (
    regressor,
    regressor_derivatives,
    rigid_body_torque,
)
from excitant.robots.robot import Robot
from excitant.robots.torque import torque

__all__ = [
    "Array",
    "BaseParameters",
    "DHChain",
    "Limits",
    "Motion",
    "Robot",
    "base_parameters",
    "builtin_robots",
    "load_limits",
    "load_robot",
    "regressor",
    "regressor_derivatives",
    "rigid_body_torque",
    "robot_from_dh",
    "torque",
]
