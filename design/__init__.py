"""Motions that make a robot arm's dynamics visible."""

from excitant.design.approach import approach, retime, return_path
from excitant.design.bound import Bound, lower_bound
from excitant.design.clearance import Clearance, clearance
from excitant.design.constraints import LimitReport, LimitUse, check
from excitant.design.criterion import Information, condition_number, information
from excitant.design.export import load_trajectory, motion_csv, trajectory_csv, trajectory_json
from excitant.design.feasible import random_trajectory
from excitant.design.formats import write_formats
from excitant.design.interpolation import HermiteTrajectory
from excitant.design.link_by_link import LinkByLinkDesign, design_link_by_link
from excitant.design.link_by_link_result import (
    link_by_link_design_result,
    link_by_link_design_series,
    link_by_link_files,
)
from excitant.design.optimal import CLEARANCE, build_design, design
from excitant.design.outcome import Design, StartRecord
from excitant.design.result import design_result, design_series
from excitant.design.splines import SplineTrajectory
from excitant.design.trajectory import FourierTrajectory, Trajectory, from_coefficients

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
    "SplineTrajectory",
    "StartRecord",
    "Trajectory",
    "approach",
    "build_design",
    "check",
    "clearance",
    "condition_number",
    "design",
    "design_link_by_link",
    "design_result",
    "design_series",
    "from_coefficients",
    "information",
    "link_by_link_design_result",
    "link_by_link_design_series",
    "link_by_link_files",
    "load_trajectory",
    "lower_bound",
    "motion_csv",
    "random_trajectory",
    "retime",
    "return_path",
    "trajectory_csv",
    "trajectory_json",
    "write_formats",
]
