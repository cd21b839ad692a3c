"""Motions that make a robot arm's dynamics visible."""

from excitant.design.constraints import LimitReport, LimitUse, check
from excitant.design.criterion import Information, condition_number, information
from excitant.design.export import load_trajectory, motion_csv, trajectory_csv, trajectory_json
from excitant.design.feasible import random_trajectory
from excitant.design.interpolation import HermiteTrajectory
from excitant.design.optimal import Design, StartRecord, build_design, design
from excitant.design.result import design_result, design_series
from excitant.design.trajectory import FourierTrajectory

__all__ = [
    "Design",
    "FourierTrajectory",
    "HermiteTrajectory",
    "Information",
    "LimitReport",
    "LimitUse",
    "StartRecord",
    "build_design",
    "check",
    "condition_number",
    "design",
    "design_result",
    "design_series",
    "information",
    "load_trajectory",
    "motion_csv",
    "random_trajectory",
    "trajectory_csv",
    "trajectory_json",
]
