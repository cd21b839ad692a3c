from . import analysis as analysis
from . import api as api
from . import design as design
from . import identify as identify
from . import reports as reports
from . import robots as robots
from .analysis import Diagnosis, Examination, Identifiability
from .analysis.rehearsal import Rehearsal
from .api import (
    analyze,
    as_recordings,
    check,
    design_link_by_link,
    design_trajectory,
    diagnose,
    experiments,
    go,
    identify_link_by_link,
    identify_online,
    identify_payload,
    identify_robot,
    load_recording,
    load_trajectory,
    random_trajectory,
    recording_from_table,
    rehearse,
    show,
    simulate,
    virtual_arm,
)
from .design import Design, Search, Trajectory
from .exceptions import ExcitantError
from .identify import Estimate, Recording, load_dataset
from .reports import plot
from .reports.nouns import report, save
from .robots import Robot, builtin_robots, load_robot
from .surroundings import Surroundings

__version__: str

__all__ = [
    "Design",
    "Diagnosis",
    "Estimate",
    "Examination",
    "ExcitantError",
    "Identifiability",
    "Recording",
    "Rehearsal",
    "Robot",
    "Search",
    "Surroundings",
    "Trajectory",
    "__version__",
    "analyze",
    "as_recordings",
    "builtin_robots",
    "check",
    "design_link_by_link",
    "design_trajectory",
    "diagnose",
    "experiments",
    "go",
    "identify_link_by_link",
    "identify_online",
    "identify_payload",
    "identify_robot",
    "load_dataset",
    "load_recording",
    "load_robot",
    "load_trajectory",
    "plot",
    "random_trajectory",
    "recording_from_table",
    "rehearse",
    "report",
    "save",
    "show",
    "simulate",
    "virtual_arm",
]
