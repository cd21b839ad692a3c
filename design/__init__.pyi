from .bound import Bound, bound_of, lower_bound
from .constraints import (
    Clearance,
    LimitReport,
    LimitUse,
    check,
    clearance,
)
from .criterion import (
    Information,
    condition_number,
    estimated_effects,
    information,
)
from .export import (
    load_trajectory,
    motion_csv,
    trajectory_csv,
    trajectory_json,
    write_formats,
)
from .feasible import random_trajectory
from .optimal import build_design, design_trajectory
from .options import Search
from .played import Played, play, require_playable
from .result import Design, TrajectoryCheck
from .sequence import LinkByLinkDesign, design_link_by_link
from .timing import approach
from .trajectory import (
    HermiteTrajectory,
    Trajectory,
)

__all__ = [
    "Bound",
    "Clearance",
    "Design",
    "HermiteTrajectory",
    "Information",
    "LimitReport",
    "LimitUse",
    "LinkByLinkDesign",
    "Played",
    "Search",
    "Trajectory",
    "TrajectoryCheck",
    "approach",
    "bound_of",
    "build_design",
    "check",
    "clearance",
    "condition_number",
    "design_link_by_link",
    "design_trajectory",
    "estimated_effects",
    "information",
    "load_trajectory",
    "lower_bound",
    "motion_csv",
    "play",
    "random_trajectory",
    "require_playable",
    "trajectory_csv",
    "trajectory_json",
    "write_formats",
]
