"""Excitation design, identification, identifiability and diagnosis of robot arms.

The verbs and nouns of every day are at hand as ``import excitant as ex``: ``ex.load_robot``,
``ex.design_trajectory``, ``ex.load_recording``, ``ex.identify_robot``, ``ex.analyze``,
``ex.diagnose``, ``ex.rehearse``, ``ex.report``. Each is imported when it is first used; everything
else is in the packages ``excitant.robots``, ``design``, ``identify``, ``analysis``, ``reports``.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from excitant.analysis import Diagnosis, Identifiability, analyze, diagnose
    from excitant.analysis.rehearsal import rehearse
    from excitant.design import Design, FourierTrajectory, load_trajectory, random_trajectory
    from excitant.design import design as design_trajectory
    from excitant.exceptions import ExcitantError
    from excitant.identify import Estimate, Recording, load_dataset, recording_from_table
    from excitant.identify import identify as identify_robot
    from excitant.identify import read_recording as load_recording
    from excitant.reports.notebook import report
    from excitant.robots import Robot, builtin_robots, load_robot
    from excitant.robots.virtual_arm import virtual_arm

__version__ = "0.1.0"

_HOMES = {
    "Design": ("excitant.design", "Design"),
    "Diagnosis": ("excitant.analysis", "Diagnosis"),
    "Estimate": ("excitant.identify", "Estimate"),
    "ExcitantError": ("excitant.exceptions", "ExcitantError"),
    "FourierTrajectory": ("excitant.design", "FourierTrajectory"),
    "Identifiability": ("excitant.analysis", "Identifiability"),
    "Recording": ("excitant.identify", "Recording"),
    "Robot": ("excitant.robots", "Robot"),
    "analyze": ("excitant.analysis", "analyze"),
    "builtin_robots": ("excitant.robots", "builtin_robots"),
    "design_trajectory": ("excitant.design", "design"),
    "diagnose": ("excitant.analysis", "diagnose"),
    "identify_robot": ("excitant.identify", "identify"),
    "load_dataset": ("excitant.identify", "load_dataset"),
    "load_recording": ("excitant.identify", "read_recording"),
    "load_robot": ("excitant.robots", "load_robot"),
    "load_trajectory": ("excitant.design", "load_trajectory"),
    "random_trajectory": ("excitant.design", "random_trajectory"),
    "recording_from_table": ("excitant.identify", "recording_from_table"),
    "rehearse": ("excitant.analysis.rehearsal", "rehearse"),
    "report": ("excitant.reports.notebook", "report"),
    "virtual_arm": ("excitant.robots.virtual_arm", "virtual_arm"),
}
"""The module of every name, and what it is called there."""

__all__ = [
    "Design",
    "Diagnosis",
    "Estimate",
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
    "identify_robot",
    "load_dataset",
    "load_recording",
    "load_robot",
    "load_trajectory",
    "random_trajectory",
    "recording_from_table",
    "rehearse",
    "report",
    "virtual_arm",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'excitant' has no attribute '{name}'")
    module, original = _HOMES[name]
    found = globals()[name] = getattr(import_module(module), original)
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES})
