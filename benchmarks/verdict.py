"""What the judges say of a motion."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
from judge import Array, conditioning, read_motion
from noise import ParameterError, parameter_error
from problem import Problem, problems_folder

from excitant.design import check, load_trajectory
from excitant.exceptions import BadInput, ExcitantError

if TYPE_CHECKING:
    from runs import Run

_AGREE = 1e-6  # relative; both judges work in double precision, κ loses a few digits
_REST = 1e-9
NOISE = (("equal", 1.0), ("limit", 0.01))
"""Torque noise: so many N·m on every joint, or such a share of each joint's limit."""


@dataclass(frozen=True)
class Verdict:
    """Figures of one run; infinite or empty without a motion.

    Attributes:
        method: Contestant.
        setting: Harmonics ``H=5``, or segments and moves ``2x5``.
        wall_s: Time by the clock [s].
        cpu_s: Processor time [s].
        note: What the contestant said.
        left: Condition number of the base columns chosen from left to right.
        proj: Condition number of the projection on the row space.
        base: Number of base parameters.
        samples: Number of samples judged.
        worst: Largest use of a limit over the continuous motion; at most 1 holds.
        worst_where: The quantity and joint of it.
        peak_ddq: Largest acceleration [rad/s²].
        at_rest: Whether velocity and acceleration vanish at both ends.
        errors: Parameter errors by kind of noise.
    """

    method: str
    setting: str
    wall_s: float
    cpu_s: float
    note: str
    left: float = np.inf
    proj: float = np.inf
    base: int = 0
    samples: int = 0
    worst: float = np.inf
    worst_where: str = ""
    peak_ddq: float = np.inf
    at_rest: bool = False
    errors: dict[str, ParameterError] | None = None

    @property
    def label(self) -> str:
        """Contestant with its setting."""
        return f"{self.method} {self.setting}"


def failed(run: Run) -> Verdict:
    """The verdict on a run that brought no motion."""
    return Verdict(run.method, run.setting, run.wall_s, run.cpu_s, run.note)


def external_judge(given: Path | None) -> Path | None:
    """The ``evaluate.py`` to call: given, or that of the shared problems if it is there."""
    if given is not None and not given.is_file():
        raise BadInput(f"judge {given}: no such file")
    beside = problems_folder() / "evaluate.py"
    return given or (beside if beside.is_file() else None)


def judged(problem: Problem, run: Run, file: Path, judge: Path | None) -> Verdict:
    """All figures of a motion.

    Raises:
        ExcitantError: Both judges' condition numbers differ.
    """
    model = pin.buildModelFromUrdf(str(problem.urdf))
    _, states = read_motion(file, problem.robot.nv)
    found = conditioning(model, problem.limits, states)
    left, proj = found.left, found.proj
    if judge is not None:
        left, proj = evaluated(problem, file, judge)
        if abs(left - found.left) > _AGREE * left or abs(proj - found.proj) > _AGREE * proj:
            raise ExcitantError(
                f"{file}: {judge} finds {left}, {proj}; judge.py {found.left}, {found.proj}"
            )
    worst, where = limit_use(problem, file)
    ends = np.abs(np.vstack([states.dq[[0, -1]], states.ddq[[0, -1]]])).max()
    return Verdict(
        run.method,
        run.setting,
        run.wall_s,
        run.cpu_s,
        run.note,
        left,
        proj,
        found.base,
        len(states.q),
        worst,
        where,
        float(np.abs(states.ddq).max()),
        bool(ends <= _REST * np.abs(states.ddq).max()),
        {
            kind: parameter_error(model, problem.limits, states, noise_std(problem, kind, size))
            for kind, size in NOISE
        },
    )


def noise_std(problem: Problem, kind: str, size: float) -> Array:
    """Standard deviation of the torque noise per joint [N·m]."""
    limit = np.asarray(problem.limits["torque"], float)
    return size * (np.ones_like(limit) if kind == "equal" else limit)


def limit_use(problem: Problem, file: Path) -> tuple[float, str]:
    """Largest use of a limit over the continuous motion, and where.

    A Fourier series is judged by its coefficients, any other motion along the quintic Hermite
    interpolant of its samples.
    """
    exact = file.with_suffix(".json")
    motion = load_trajectory(exact if exact.exists() else file, problem.robot)
    use = check(problem.robot, motion).worst
    return use.ratio, f"{use.quantity} {use.joint}"


def evaluated(problem: Problem, file: Path, judge: Path) -> tuple[float, float]:
    """Condition numbers, left and proj, by the external judge in a process of its own."""
    limits: dict[str, Any] = dict(problem.limits)
    low, high = np.asarray(limits["position"], float).T.tolist()
    named = {"q_lo": low, "q_hi": high, "dq": limits["velocity"], "tau": limits["torque"]}
    if "acceleration" in limits:
        named["ddq"] = limits["acceleration"]
    folder = problem.folder
    (folder / "judge-limits.json").write_text(json.dumps(named), encoding="utf-8")
    out = file.with_suffix(".judged.json")
    words = [sys.executable, judge, problem.urdf, file, "--no-collision"]
    words += ["--limits", folder / "judge-limits.json", "--json", out]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [str(word) for word in words], capture_output=True, text=True, env=environment, check=False
    )
    if done.returncode:
        raise ExcitantError(f"judge {judge}: {done.stderr.strip().splitlines()[-1]}")
    condition = json.loads(out.read_text(encoding="utf-8"))["condition"]["inertial"]
    return float(condition["left"]["raw"]), float(condition["proj"]["raw"])
