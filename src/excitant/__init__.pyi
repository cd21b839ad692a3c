from .analysis import (
    Diagnosis,
    Examination,
    Identifiability,
    analyze,
    diagnose,
    examine,
)
from .analysis.rehearsal import rehearse
from .design import (
    Design,
    FourierTrajectory,
    design_trajectory,
    load_trajectory,
    random_trajectory,
)
from .exceptions import ExcitantError
from .identify import (
    Estimate,
    Recording,
    identify_robot,
    load_dataset,
    load_recording,
    recording_from_table,
)
from .reports import plot
from .reports.run import report, save
from .robots import Robot, builtin_robots, load_robot
from .robots.virtual_arm import virtual_arm

__version__: str

__all__ = [
    "Design",
    "Diagnosis",
    "Estimate",
    "Examination",
    "ExcitantError",
    "FourierTrajectory",
    "Identifiability",
    "Recording",
    "Robot",
    "__version__",
    "analyze",
    "builtin_robots",
    "design_trajectory",
    "diagnose",
    "examine",
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
    "virtual_arm",
]
