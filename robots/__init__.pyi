from .base_parameters import BaseParameters, base_parameters
from .chains import RobotSpec
from .check import ModelCheck
from .dh import DHChain, robot_from_dh
from .library import arm_entry, catalogue, catalogue_rows
from .limits import Limits, require_limits
from .limits_file import load_limits
from .loading import builtin_robots, load_robot
from .motion import Array, Motion
from .regressor import (
    regressor,
    regressor_derivatives,
    rigid_body_torque,
)
from .robot import Robot
from .torque import torque

__all__ = [
    "Array",
    "BaseParameters",
    "DHChain",
    "Limits",
    "ModelCheck",
    "Motion",
    "Robot",
    "RobotSpec",
    "arm_entry",
    "base_parameters",
    "builtin_robots",
    "catalogue",
    "catalogue_rows",
    "load_limits",
    "load_robot",
    "regressor",
    "regressor_derivatives",
    "require_limits",
    "rigid_body_torque",
    "robot_from_dh",
    "torque",
]
