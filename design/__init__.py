"""Motions that make a robot arm's dynamics visible."""

from excitant.design.bound import Bound, lower_bound
from excitant.design.constraints import (
    Clearance,
    LimitReport,
    LimitUse,
    check,
    clearance,
)
from excitant.design.criterion import Information, condition_number, information
from excitant.design.export import (
    load_trajectory,
    motion_csv,
    trajectory_csv,
    trajectory_json,
    write_formats,
)
from excitant.design.feasible import random_trajectory
from excitant.design.optimal import build_design, design_trajectory
from excitant.design.result import Design, TrajectoryCheck
from excitant.design.sequence import LinkByLinkDesign, design_link_by_link
from excitant.design.timing import approach
from excitant.design.trajectory import (
    FourierTrajectory,
    HermiteTrajectory,
    Trajectory,
    from_coefficients,
)
from excitant.robots.geometry import CLEARANCE

__all__ = [
    "CLEARANCE",
    "Bound",
    "Clearance",
    "Design",
    "FourierTrajectory",
    "HermiteTrajectory",
    "Information",
    "LimitReport",
    "LimitUse",
    "LinkByLinkDesign",
    "Trajectory",
    "TrajectoryCheck",
    "approach",
    "build_design",
    "check",
    "clearance",
    "condition_number",
    "design_link_by_link",
    "design_trajectory",
    "from_coefficients",
    "information",
    "load_trajectory",
    "lower_bound",
    "motion_csv",
    "random_trajectory",
    "trajectory_csv",
    "trajectory_json",
    "write_formats",
]
