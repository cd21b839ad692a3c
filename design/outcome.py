"""What a design comes to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from excitant.design.clearance import Clearance
from excitant.design.clearance import clearance as motion_clearance
from excitant.design.constraints import LimitReport, check
from excitant.design.criterion import Information, condition_number
from excitant.design.search import SearchState
from excitant.design.trajectory import Trajectory
from excitant.robots import Array, BaseParameters, Motion, Robot
from excitant.robots.geometry import Scene
from excitant.robots.motion import read_only

_DENSE_HZ, _DENSE = 100.0, 1000  # samples of the figures reported: rate, and at least so many


@dataclass(frozen=True, eq=False)
class StartRecord:
    """How one search went.

    Attributes:
        index: Number of the start; its seed is (seed, index).
        parent: Start whose solution it began from, or None for a random one.
        condition: Condition number it ended with, at the samples of the search (with the
            smooth sign of velocity, for ``"friction"``).
        status: ``"converged"``, ``"stopped"`` (not worth going on beside others),
            ``"iteration limit"``, ``"time limit"``, ``"interrupted"`` or ``"infeasible"``.
        iterations: Steps taken.
        history: Condition number at the beginning and after every step.
    """

    index: int
    parent: int | None
    condition: float
    status: str
    iterations: int
    history: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Design:
    """An excitation trajectory and what it achieves.

    Condition numbers and eigenvalues are those of the base columns, unscaled, at 100 Hz or at
    1000 samples if that is denser, with the true sign of velocity; weighted by noise and with
    the information of earlier recordings where these were given.

    Attributes:
        robot: The arm.
        initial: The first random feasible trajectory.
        trajectory: The excitation trajectory, at rest at both ends.
        information: What is made visible: columns, base parameters, weights.
        criterion: ``"condition"``, ``"d"``, ``"a"`` or ``"e"``.
        condition_initial: Condition number of the initial trajectory.
        condition_final: Condition number of the trajectory.
        eigenvalues_initial: Eigenvalues of M = WᵀW / n before, ascending, shape (r,).
        eigenvalues_final: Eigenvalues of M after.
        limits: Worst use of every limit over the continuous motion.
        scene: The arm's bodies and obstacles; None without.
        clearance: Smallest distance over the continuous motion; None without a scene.
        starts: How each search went.
        wall_s: Time taken [s].
    """

    robot: Robot
    initial: Trajectory
    trajectory: Trajectory
    information: Information
    criterion: str
    condition_initial: float
    condition_final: float
    eigenvalues_initial: Array
    eigenvalues_final: Array
    limits: LimitReport
    scene: Scene | None
    clearance: Clearance | None
    starts: tuple[StartRecord, ...]
    wall_s: float

    @property
    def base(self) -> BaseParameters:
        """Base parameters of the columns."""
        return self.information.base

    @property
    def columns(self) -> str:
        """``"friction"`` or ``"inertial"``."""
        return self.information.columns

    @property
    def duration(self) -> float:
        """Period [s]."""
        return self.trajectory.period

    @property
    def harmonics(self) -> int:
        """Number of harmonics; of a spline, half its pieces."""
        return self.trajectory.harmonics

    @property
    def iterations(self) -> int:
        """Steps taken in all searches together."""
        return sum(start.iterations for start in self.starts)


def outcome(
    information: Information,
    criterion: str,
    ends: tuple[Trajectory, Trajectory],
    scene: Scene | None,
    searches: Sequence[SearchState],
    wall_s: float,
) -> Design:
    """A design with its exact figures.

    Args:
        information: What is made visible, of which arm.
        criterion: Name of the criterion.
        ends: The initial trajectory and the one chosen.
        scene: The arm's bodies and obstacles; None without.
        searches: As they ended.
        wall_s: Time taken [s].
    """
    before, after = (information.matrix(dense_motion(trajectory)) for trajectory in ends)
    chosen = ends[1]
    return Design(
        robot=information.robot,
        initial=ends[0],
        trajectory=chosen,
        information=information,
        criterion=criterion,
        condition_initial=condition_number(before),
        condition_final=condition_number(after),
        eigenvalues_initial=read_only(np.linalg.eigvalsh(before)),
        eigenvalues_final=read_only(np.linalg.eigvalsh(after)),
        limits=check(information.robot, chosen),
        scene=scene,
        clearance=None if scene is None else motion_clearance(scene, chosen),
        starts=tuple(_record(search) for search in searches),
        wall_s=wall_s,
    )


def _record(search: SearchState) -> StartRecord:
    condition = search.history[-1] if search.history else np.inf
    return StartRecord(
        search.index, search.parent, condition, search.status, search.iterations, search.history
    )


def dense_motion(trajectory: Trajectory) -> Motion:
    """The samples on which condition numbers are reported, first and last included."""
    return trajectory.sample(max(_DENSE, round(_DENSE_HZ * trajectory.period)) + 1)
