"""A motion as it is played to be watched: poses, use of the limits, and what comes close."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from excitant.design.constraints import (
    Clearance,
    LimitReport,
    check,
    clearance,
    shares_of_limits,
)
from excitant.design.trajectory import HermiteTrajectory, Trajectory
from excitant.robots.appearance import Appearance
from excitant.robots.geometry import Scene, unchecked
from excitant.robots.limits import TOUCHED, unlimited
from excitant.robots.motion import Array, Motion
from excitant.robots.robot import Robot

_FRAMES_HZ = 50.0  # rate
_FRAMES = 5000  # and no more frames than that


@dataclass(frozen=True, eq=False, repr=False)
class Playback:
    """Frames of a motion, among them the instants at which a limit is touched or bodies are near.

    Attributes:
        robot: The arm.
        path: The motion, over one period or from the first to the last sample.
        scene: The arm's bodies and what is around them; None without shapes.
    """

    robot: Robot
    path: Trajectory | HermiteTrajectory
    scene: Scene | None

    @cached_property
    def limits(self) -> LimitReport:
        """Worst use of every limit over the continuous motion."""
        path = self.path
        return check(
            self.robot, path if isinstance(path, Trajectory) else path.samples
        )

    @cached_property
    def clearance(self) -> Clearance | None:
        """Smallest distance over the continuous motion; None without a scene."""
        return None if self.scene is None else clearance(self.scene, self.path)

    @cached_property
    def frames(self) -> Motion:
        """The instants that are shown."""
        path = self.path
        start = 0.0
        if isinstance(path, Trajectory):
            end = path.period
        else:
            start, end = path.samples.t[[0, -1]].tolist()
        count = min(_FRAMES, 1 + int(np.ceil(_FRAMES_HZ * (end - start))))
        marks = [use.times[use.ratios >= TOUCHED] for use in self.limits.uses]
        if self.clearance is not None:
            marks.append(np.array([self.clearance.time]))
        t = np.linspace(start, end, max(count, 2))
        return path.at(np.union1d(t, np.concatenate(marks)))

    def result(self) -> dict[str, Any]:
        """Entries of ``result.json`` on the arm, its limits, and what it is to keep clear of."""
        robot = self.robot
        scene = self.scene
        near = self.clearance
        return {
            "robot": robot.name,
            "joints": list(robot.joints),
            "revolute": robot.revolute.tolist(),
            **self.limits.entries(robot.limits),
            "unchecked": "; ".join(
                filter(None, (unlimited(robot), unchecked(robot, scene)))
            ),
            "clearance_m": near and near.certified,
            "closest": near
            and {
                "bodies": list(near.bodies),
                "t": near.time,
                "distance_m": near.distance / near.scale,
            },
            "obstacles": [o.plain() for o in scene.obstacles] if scene else [],
            "appearance": Appearance(robot).entries(),
            "bodies": [list(pair) for pair in scene.pairs] if scene else [],
        }

    def series(self) -> dict[str, Array]:
        """Frames and meshes.

        Returns:
            ``play_t`` (n,) [s], ``play_q``, ``play_dq`` (n, nv), ``play_shares`` of the limits
            (n, 4, nv), and with a scene ``play_pair``, the index of the nearest bodies (n,),
            ``play_distance`` of them (n,) [m], ``play_points`` of both (n, 2, 3) [m]; meshes as of
            `Appearance.meshes`.
        """
        motion = self.frames
        shares = shares_of_limits(self.robot, motion)
        for k, use in enumerate(self.limits.uses[:4]):
            # friction jumps where a joint turns
            for j in np.flatnonzero(use.ratios >= TOUCHED):
                shares[np.searchsorted(motion.t, use.times[j]), k, j] = use.ratios[
                    j
                ]
        series = {"play_t": motion.t, "play_q": motion.q, "play_dq": motion.dq}
        series["play_shares"] = shares
        if self.scene is not None:
            pair, distance, points = self.scene.nearest(motion.q)
            series["play_pair"] = pair.astype(float)
            series |= {"play_distance": distance, "play_points": points}
        return series | Appearance(self.robot).meshes()
