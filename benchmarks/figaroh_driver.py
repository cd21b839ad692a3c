"""Excitation trajectory by FIGAROH's public interface, for its own Python environment.

Called as ``python figaroh_driver.py SPECIFICATION.json``, which `contestants.run_figaroh` writes;
imports nothing of excitant. The steps are those of FIGAROH's UR10 example; see README.md.
"""

import json
import sys
import tempfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import yaml
from figaroh.optimal.base_optimal_trajectory import (
    BaseOptimalTrajectory,
    BaseTrajectoryIPOPTProblem,
)
from figaroh.tools.robot import load_robot


def inner_hz(given: SimpleNamespace) -> int:
    """Lowest rate whose samples hit every waypoint exactly, as FIGAROH presumes."""
    move = given.segment_s / given.moves
    for rate in range(given.frequency_hz, 10 * given.frequency_hz):
        samples = {k * (1 / rate) for k in range(round(given.segment_s * rate) + 1)}
        if all(move * k in samples for k in range(given.moves + 1)):
            return rate
    raise SystemExit(f"no sampling rate meets {given.moves} moves in {given.segment_s} s")


def settings(joints: list[str], rate_hz: float, cutoff_hz: float, drives: bool) -> dict[str, Any]:
    """FIGAROH's unified configuration, rigid bodies only or with what drives add."""
    zeros = [0.0] * len(joints)
    parts = dict.fromkeys(("friction", "joint_offset", "actuator_inertia"), drives)
    return yaml.safe_load(f"""
        robot:
          name: arm
          properties:
            joints: {{active_joints: {joints}}}
            mechanics: {{reduction_ratios: {[1.0] * len(joints)}, actuator_inertias: {zeros},
              joint_offsets: {zeros}, friction_coefficients: {{viscous: {zeros}, static: {zeros}}}}}
        tasks:
          identification:
            problem: {{include_external_forces: false, use_joint_torques: true, model_components:
              {json.dumps(parts | {"static_regressor": True, "inertia_regressor": True})}}}
            signal_processing: {{sampling_frequency: {rate_hz}, cutoff_frequency: {cutoff_hz}}}
        """)


def configuration(given: SimpleNamespace, joints: list[str]) -> dict[str, Any]:
    """Settings of a problem, without a margin inside its limits."""
    content = settings(joints, given.rate_hz, 0.1 * given.rate_hz, drives=False)
    content["tasks"]["optimal_trajectory"] = yaml.safe_load(f"""
        problem: {{soft_lim: 0.0, max_attempts: 500, max_iterations: {given.iterations},
          segment_attempts: {given.attempts}}}
        trajectory: {{waypoints: {given.moves + 1}, frequency: {inner_hz(given)},
          segment_duration: {given.segment_s / given.moves}}}
        """)
    return content


def activate(task: Any, robot: Any, joints: list[str]) -> None:
    """Tell a task of FIGAROH, and set it up for, the joints that move."""
    ids = [robot.model.getJointId(name) for name in joints]
    bodies = [robot.model.joints[k] for k in ids]
    task.identif_config |= {"active_joints": joints, "act_Jid": ids, "act_J": bodies}
    task.identif_config |= {f"act_idx{k}": [getattr(b, f"idx_{k}") for b in bodies] for k in "qv"}
    task.initialize()


class RecordingProblem(BaseTrajectoryIPOPTProblem):
    """FIGAROH's problem of one segment, which keeps the waypoints of its solution."""

    def solve_with_waypoints(self, wps: Any) -> tuple[bool, dict[str, Any]]:
        """Solve as FIGAROH does, and keep times, waypoints and their derivatives."""
        success, results = super().solve_with_waypoints(wps)
        if success:
            rest = np.reshape(results["x_opt"], (self.n_wps - 1, self.n_joints))
            waypoints = np.vstack([self.wp_init, rest]).T
            solved = (self.tps, waypoints, self.vel_wps, self.acc_wps)
            self.opt_traj.solved.append(solved)
        return success, results


class RecordingTrajectory(BaseOptimalTrajectory):
    """FIGAROH's optimiser; ``solved`` holds the spline of every segment."""

    def __init__(self, robot: Any, joints: list[str], configuration: str) -> None:
        super().__init__(robot, joints, configuration)
        self.solved: list[tuple[Any, ...]] = []

    def create_ipopt_problem(self, *arguments: Any) -> RecordingProblem:
        """One segment, as FIGAROH states it."""
        return RecordingProblem(self, *arguments)


def prepared(given: SimpleNamespace) -> RecordingTrajectory:
    robot = load_robot(given.urdf, load_by_urdf=True)
    limits = {k: np.asarray(v, float) for k, v in given.limits.items()}
    robot.model.lowerPositionLimit[:] = limits["position"][:, 0]
    robot.model.upperPositionLimit[:] = limits["position"][:, 1]
    robot.model.velocityLimit[:] = limits["velocity"]
    robot.model.effortLimit[:] = limits["torque"]
    joints = [str(name) for name in list(robot.model.names)[1:]]
    with tempfile.NamedTemporaryFile("w", suffix=".yaml") as file:
        yaml.safe_dump(configuration(given, joints), file)
        file.flush()
        optimiser = RecordingTrajectory(robot, joints, file.name)
    activate(optimiser, robot, joints)
    return optimiser


def sampled(optimiser: RecordingTrajectory, rate_hz: float) -> np.ndarray:
    """All segments in a row at a rate [Hz], columns t, q, dq, ddq."""
    parts = []
    for k, (times, *waypoints) in enumerate(optimiser.solved):
        _, q, dq, ddq = optimiser.CB.get_full_config(rate_hz, times, *waypoints)
        parts.append(np.hstack([q, dq, ddq])[min(k, 1) :])
    states = np.vstack(parts)
    return np.column_stack([np.arange(len(states)) / rate_hz, states])


def main() -> int:
    """Design, write the trajectory, and tell what the optimiser said on standard output."""
    given = SimpleNamespace(**json.loads(Path(sys.argv[1]).read_text(encoding="utf-8")))
    np.random.seed(given.seed)  # noqa: NPY002
    optimiser = prepared(given)
    results = optimiser.solve(stack_reps=given.segments)
    if len(optimiser.solved) < given.segments:
        print(json.dumps({"solved": len(optimiser.solved)}))
        return 3
    table = sampled(optimiser, given.rate_hz)
    nv = table.shape[1] // 3
    names = ["t", *(f"{kind}{j + 1}" for kind in ("q", "dq", "ddq") for j in range(nv))]
    np.savetxt(given.csv, table, "%.17g", ",", header=",".join(names), comments="")
    converged = [bool(segment["converged"]) for segment in results["iteration_data"]]
    print(json.dumps({"solved": len(optimiser.solved), "converged": converged}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
