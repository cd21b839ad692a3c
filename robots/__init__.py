"""What an arm is, and what torque it needs."""

from excitant.robots.base_parameters import BaseParameters, base_parameters
from excitant.robots.loading import builtin_robots, load_limits, load_robot
from excitant.robots.motion import Array, Motion
from excitant.robots.regressor import regressor, regressor_derivatives, rigid_body_torque
from excitant.robots.robot import Limits, Robot
from excitant.robots.torque import torque

__all__ = [
    "Array",
    "BaseParameters",
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
    "torque",
]
