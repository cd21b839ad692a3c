"""The design problem that every contestant solves, and the files that tell them."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from excitant.exceptions import BadInput, BadRobot
from excitant.robots import Robot, builtin_robots, load_limits, load_robot

OWN = Path(__file__).resolve().parent / "problems"
BESIDE = Path(__file__).resolve().parents[2] / "shared" / "problems"


@dataclass(frozen=True, eq=False)
class Problem:
    """A design problem, inertial columns, rigid bodies only.

    Attributes:
        name: Name of its file.
        robot: The arm with the problem's limits and without effects.
        duration: Duration of the motion [s].
        harmonics: Number of harmonics of the Fourier contestants.
        rate_hz: Rate at which motions are judged [Hz].
        folder: Where ``robot.urdf`` and ``problem.json`` are written for the contestants.
    """

    name: str
    robot: Robot
    duration: float
    harmonics: int
    rate_hz: float
    folder: Path

    @property
    def urdf(self) -> Path:
        """The arm as a file."""
        return self.folder / "robot.urdf"

    @property
    def file(self) -> Path:
        """The problem as a file that names the arm's."""
        return self.folder / "problem.json"

    @property
    def limits(self) -> dict[str, Any]:
        """Limits in SI units, as lists; without those that there are not."""
        named = {
            name: getattr(self.robot.limits, name)
            for name in ("position", "velocity", "acceleration", "torque")
        }
        return {name: value.tolist() for name, value in named.items() if np.isfinite(value).all()}

    def write(self) -> None:
        """Write the files that contestants and judges read."""
        self.folder.mkdir(parents=True, exist_ok=True)
        self.urdf.write_text(self.robot.urdf, encoding="utf-8")
        content = {
            "model": self.urdf.name,
            "duration": self.duration,
            "harmonics": self.harmonics,
            "limits": self.limits,
            "evaluate_hz": self.rate_hz,
        }
        self.file.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def problems_folder() -> Path:
    """Folder of the shared problems: EXCITANT_PROBLEMS, else ``../shared/problems``."""
    return Path(os.environ.get("EXCITANT_PROBLEMS", BESIDE))


def problem_file(name: str) -> Path:
    """File of a problem given by path, or by name among the shared ones and our own.

    Raises:
        BadInput: There is none; lists those there are.
    """
    given = Path(name)
    if given.is_file():
        return given
    folders = (problems_folder(), OWN)
    for folder in folders:
        if (folder / f"{given.stem}.json").is_file():
            return folder / f"{given.stem}.json"
    known = sorted(path.stem for folder in folders for path in folder.glob("*.json"))
    missing = "" if folders[0].is_dir() else f"; no shared problems in {folders[0]}"
    raise BadInput(
        f"problem '{name}' is no file and none of {', '.join(known)}{missing}; give a file or set "
        "EXCITANT_PROBLEMS"
    )


def load_problem(
    path: Path, folder: Path | None = None, robot: str | None = None, harmonics: int | None = None
) -> Problem:
    """Problem of a JSON file: ``model``, ``duration``, ``harmonics``, ``limits``, ``evaluate_hz``.

    Args:
        path: The file; its ``model`` is a built-in arm or a path relative to it.
        folder: Where the contestants' files go; beside the problem by default.
        robot: Another arm under the same limits.
        harmonics: Another number of harmonics.

    Raises:
        BadInput: Entries missing, or limits that leave position, velocity or torque open.
        BadRobot: The arm has joints locked, which its URDF would not tell.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        model, duration = str(content["model"]), float(content["duration"])
        harmonics = harmonics or int(content["harmonics"])
        rate_hz = float(content.get("evaluate_hz", 100.0))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise BadInput(f"problem {path}: {type(error).__name__} {error}") from None
    if model not in builtin_robots():
        model = str(path.parent / model)
    arm = load_robot(robot or model).with_effects(())
    arm = arm.with_limits(load_limits(path, arm)) if "limits" in content else arm
    if arm.locked:
        raise BadRobot(arm.source, "has locked joints; give a URDF without them")
    problem = Problem(path.stem, arm, duration, harmonics, rate_hz, folder or path.parent)
    unlimited = {"position", "velocity", "torque"} - problem.limits.keys()
    if unlimited:
        raise BadInput(f"problem {path}: joints without limits on {', '.join(sorted(unlimited))}")
    return problem
