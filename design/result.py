"""A design as the noun that reports and files are made of."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from excitant.design.constraints import Clearance, LimitReport
from excitant.design.criterion import Information, condition_number
from excitant.design.export import trajectory_csv, trajectory_json
from excitant.design.playback import Playback
from excitant.design.search import SearchState
from excitant.design.trajectory import Trajectory
from excitant.exceptions import OutsideLimits
from excitant.robots.base_parameters import BaseParameters
from excitant.robots.geometry import Scene
from excitant.robots.motion import Array, Motion
from excitant.robots.robot import Robot
from excitant.robots.shown import Shown, Table
from excitant.robots.torque import column_units, known_values, torque

_DENSE_HZ = 100.0  # samples of the figures reported: rate
_DENSE = 1000  # and at least so many
_WEAKEST = 10  # base parameters listed


def dense_motion(trajectory: Trajectory) -> Motion:
    """The samples of a period that condition numbers are reported on, first and last included."""
    return trajectory.sample(max(_DENSE, round(_DENSE_HZ * trajectory.period)) + 1)


_TIMED = (
    "the time limit ended the search, so that how far it came depends on the machine; a number of "
    "starts without a time limit gives the same motion each time"
)


@dataclass(frozen=True, eq=False, repr=False)
class Design(Shown):
    """An excitation trajectory, its certificate, what it shows of the arm, and how it was found.

    Condition numbers and eigenvalues are those of the base columns, unscaled, at 100 Hz or at
    1000 samples if that is denser, with the true sign of velocity; weighted by noise and with
    the information of earlier recordings where these were given.

    Attributes:
        information: What is made visible on which arm: columns, base parameters, weights.
        criterion: ``"condition"``, ``"d"``, ``"a"`` or ``"e"``.
        initial: The first random feasible trajectory.
        trajectory: The excitation trajectory, at rest at both ends.
        scene: The arm's bodies and obstacles; None without.
        use: Share of the limits on velocity, acceleration, torque and jerk that it may use.
        starts: How each search went.
        wall_s: Time taken [s].
    """

    information: Information
    criterion: str
    initial: Trajectory
    trajectory: Trajectory
    scene: Scene | None
    use: float
    starts: tuple[SearchState, ...]
    wall_s: float

    @property
    def robot(self) -> Robot:
        """The arm."""
        return self.information.robot

    @property
    def interrupted(self) -> bool:
        """Whether the search was interrupted; the trajectory is then the best so far."""
        return any(start.status == "interrupted" for start in self.starts)

    @property
    def base(self) -> BaseParameters:
        """Base parameters of the columns."""
        return self.information.base

    @property
    def duration(self) -> float:
        """Length of the motion, all its periods [s]."""
        return self.trajectory.duration

    @property
    def harmonics(self) -> int:
        """Number of harmonics of a period."""
        return self.trajectory.harmonics

    @cached_property
    def before(self) -> Array:
        """M = WᵀW / n of the initial trajectory, shape (r, r)."""
        return self.information.matrix(dense_motion(self.initial))

    @cached_property
    def after(self) -> Array:
        """M of the trajectory, shape (r, r)."""
        return self.information.matrix(dense_motion(self.trajectory))

    @property
    def condition_initial(self) -> float:
        """Condition number of the initial trajectory."""
        return condition_number(self.before)

    @property
    def condition_final(self) -> float:
        """Condition number of the trajectory."""
        return condition_number(self.after)

    @property
    def limits(self) -> LimitReport:
        """Worst use of every limit over the continuous motion."""
        return self.playback.limits

    @property
    def clearance(self) -> Clearance | None:
        """Smallest distance over the continuous motion; None without a scene."""
        return self.playback.clearance

    @cached_property
    def playback(self) -> Playback:
        """The motion to watch."""
        return Playback(self.robot, self.trajectory, self.scene)

    def result(self) -> dict[str, Any]:
        """The content of ``result.json``; ``weakest`` have the least torque of their own after."""
        return {
            "verb": "design",
            **self.playback.result(),
            "duration": self.duration,
            "periods": self.trajectory.periods,
            "harmonics": self.harmonics,
            "columns": self.information.columns,
            "base_parameters": len(self.base),
            "criterion": self.criterion,
            "condition_number": {
                "initial": self.condition_initial,
                "final": self.condition_final,
                "lower_bound": None,
            },
            "condition_number_scaled": {
                "initial": scaled_condition_number(self.before),
                "final": scaled_condition_number(self.after),
            },
            "joint_weights": self.information.weights.tolist(),
            "weakest": self._weakest(),
            "limit_use": self.use,
            "starts": [
                {
                    "start": start.index,
                    "parent": start.parent,
                    "condition_number": [None, *start.history][-1],
                    "status": start.status,
                    "iterations": start.iterations,
                }
                for start in self.starts
            ],
            "iterations": sum(start.iterations for start in self.starts),
            "wall_s": self.wall_s,
            "notes": [
                *["interrupted: this is the best motion found by then"]
                * self.interrupted,
                *[_TIMED]
                * any(start.status == "time limit" for start in self.starts),
            ],
            "files": [],
        }

    def series(self) -> dict[str, Array]:
        """Curves: one period of the motion with its torque, and eigenvalues.

        Returns:
            ``t`` (n,), ``q``, ``dq``, ``ddq``, ``tau`` (n, nv), ``eigenvalues_initial`` and
            ``eigenvalues_final`` (r,), ascending. With a limit on jerk also ``dddq`` (n, nv). And
            the series of the `Playback`.
        """
        robot = self.robot
        motion = dense_motion(self.trajectory)
        series = vars(motion) | {
            "tau": torque(robot, motion),
            "eigenvalues_initial": np.linalg.eigvalsh(self.before),
            "eigenvalues_final": np.linalg.eigvalsh(self.after),
        }
        if robot.limits.orders > 3:
            series["dddq"] = self.trajectory(motion.t, 3)
        return series | self.playback.series()

    def files(self, rate_hz: float = 100.0, repetitions: int = 1) -> dict[str, str]:
        """The trajectory as a table at a control rate [Hz], and exactly."""
        return {
            "trajectory.csv": trajectory_csv(self.trajectory, rate_hz, repetitions),
            "trajectory.json": trajectory_json(self.trajectory, self.robot),
        }

    def _lines(self) -> list[str]:
        first = self.condition_initial
        last = self.condition_final
        worst = self.limits.worst
        return [
            f"Design for {self.robot.name}: condition number {first:.4g} → {last:.4g}",
            f"{self.duration:.4g} s, {self.harmonics} harmonics, criterion {self.criterion}, "
            f"{len(self.base)} base parameters",
            f"uses at most {100 * worst.ratio:.3g} % of a limit "
            f"({worst.quantity} of {worst.joint})",
        ]

    def _table(self) -> Table:
        rows = [
            (use.quantity, use.joint, use.ratio, use.time)
            for use in self.limits.uses
        ]
        return ("limit", "joint that comes closest", "share of it", "at [s]"), rows

    def _weakest(self) -> list[dict[str, Any]]:
        base = self.base
        robot = self.robot
        root = math.sqrt(max(_DENSE, round(_DENSE_HZ * self.duration)) + 1)
        lone = {
            "initial": lone_torque(self.before),
            "final": lone_torque(self.after),
        }
        effects = self.information.effects
        known = known_values(robot, effects)
        beta = base.regrouping @ np.array([value or 0.0 for value in known])
        units = column_units(robot, effects)
        rows = []
        for k in np.argsort(lone["final"], kind="stable")[:_WEAKEST]:
            row = {"name": base.leading[k], "expression": base.expressions[k]}
            row |= {"unit": units[base.columns[k]], "value": float(beta[k])}
            for when, size in lone.items():
                row[f"std_per_unit_noise_{when}"] = 1 / (root * float(size[k]))
            rows.append(row)
        return rows


@dataclass(frozen=True, eq=False, repr=False)
class TrajectoryCheck(Playback, Shown):
    """Whether a motion keeps all limits and clear of bodies, and how well it excites."""

    motion: Motion  # its samples
    least: float  # distance required [m]
    information: Information | None = (
        None  # what it is to make visible, if anything
    )

    def evenly(self, rate_hz: float) -> Motion:
        """The motion at even steps of about this rate, whatever those of its samples are."""
        start, end = self.motion.t[[0, -1]]
        steps = max(4, int((end - start) * rate_hz))
        return self.path.at(np.linspace(start, end, steps + 1))

    @property
    def touched(self) -> bool:
        """Whether bodies come too close."""
        return self.clearance is not None and self.clearance.distance < self.least

    @property
    def verdicts(self) -> list[str]:
        """Each limit that is exceeded, and bodies that come too close, in words."""
        verdicts = [
            f"{use.quantity} limit of {use.joint} exceeded by {100 * (use.ratio - 1):.3g} % "
            f"at {use.time:.4g} s"
            for use in self.limits.uses
            if use.ratio > 1
        ]
        near = self.clearance
        if near is not None and self.touched:
            verdicts.append(
                f"{near.bodies[0]} and {near.bodies[1]} come within "
                f"{1000 * near.distance / near.scale:.3g} mm at {near.time:.4g} s, required "
                f"{1000 * self.least / near.scale:.3g} mm"
            )
        return verdicts or ["all limits hold, between samples too"]

    def _lines(self) -> list[str]:
        return [
            f"Check of a motion of {self.robot.name}, {self.motion.t[-1]:.4g} s",
            *self.verdicts,
        ]

    def _table(self) -> Table:
        rows = [
            (use.quantity, use.joint, f"{100 * use.ratio:.3g} %")
            for use in self.limits.uses
        ]
        return ("limit", "joint", "used"), rows

    def result(self) -> dict[str, Any]:
        """The content of ``result.json``."""
        asked = self.information
        entries = super().result()
        entries["worst"] = {
            name: worst for name, worst in entries["worst"].items() if worst
        }
        if asked is not None:
            kappa = condition_number(asked.matrix(self.motion))
            entries |= {"columns": asked.columns, "condition_number": kappa}
        return {
            "verb": "check",
            **entries,
            "duration": float(self.motion.t[-1] - self.motion.t[0]),
            "holds": self.limits.hold and not self.touched,
            "verdicts": self.verdicts,
        }

    def series(self) -> dict[str, Array]:
        """The motion with its torque, and what the `Playback` has."""
        tau = torque(self.robot, self.motion)
        return vars(self.motion) | {"tau": tau} | super().series()

    def require(self) -> None:
        """Refuse a limit that is exceeded, or bodies that come too close.

        Raises:
            OutsideLimits: With what is worst.
        """
        self.limits.worst.require()
        if (near := self.clearance) is not None and self.touched:
            bodies = " and ".join(near.bodies)
            least = self.least / near.scale
            raise OutsideLimits(
                bodies, "distance", near.distance / near.scale, least, near.time
            )


def scaled_condition_number(M: Array) -> float | None:
    """cond₂ of W with columns scaled to unit length, from M = WᵀW / n; None with a zero column."""
    length = np.sqrt(np.diag(M))
    return condition_number(M / np.outer(length, length)) if length.all() else None


def lone_torque(M: Array) -> Array:
    """Torque that only one base parameter explains, root mean square per its unit, shape (r,).

    1 / √(M⁻¹)ₖₖ is the length of column k of W / √n outside the span of the others. From n
    instants with white noise σ the standard deviation of the parameter is σ / (√n · this).
    """
    values, V = np.linalg.eigh(M)
    floor = max(float(values[-1]), 1e-300) * np.finfo(float).eps
    return 1 / np.sqrt((V**2 / np.maximum(values, floor)).sum(axis=1))
