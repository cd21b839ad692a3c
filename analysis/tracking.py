"""Tracking: how closely an arm follows a motion when a model gives the torque for it.

Computed-torque feed-forward and an independent position loop (An, Atkeson, Hollerbach 1988, ch. 5):

    τ = τ̂(q_d, q̇_d, q̈_d) + B (ω² (q_d − q) + 2ω (q̇_d − q̇)),

with τ̂ by the model in question, and B by the given one whatever τ̂ is, so that all models are
compared at the same gains [N·m/rad]. The arm is the plant, which shares no code with the models.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from excitant.robots.motion import Array, Motion, freeze
from excitant.robots.plant.arm import BANDWIDTH, Trajectory
from excitant.robots.robot import Robot
from excitant.robots.torque import torque
from excitant.robots.virtual_arm import VirtualArm

BANDWIDTH_HZ = float(BANDWIDTH / (2 * np.pi))
"""Bandwidth ω / 2π of the position loop [Hz]."""

_RATE_HZ = 1000.0  # of the feed-forward torque


@dataclass(frozen=True, eq=False)
class Tracking:
    """Tracking errors of one arm on one motion, by the model that gave the torque.

    Attributes:
        models: Names of the models, m of them; the last is the best informed.
        t: Time, shape (n,) [s].
        error: Desired less true position, shape (m, n, nv) [rad or m].
    """

    models: tuple[str, ...]
    t: Array
    error: Array

    def __post_init__(self) -> None:
        freeze(self, "t", "error")

    @property
    def rms(self) -> Array:
        """Root mean square error of each joint by model, shape (m, nv) [rad or m]."""
        return np.asarray(np.sqrt((self.error**2).mean(axis=1)), float)

    @property
    def ratio(self) -> Array:
        """Error by the first model over that by the last, shape (nv,)."""
        first, *_, last = self.rms
        return np.asarray(first / np.maximum(last, np.finfo(float).tiny), float)

    def entries(self, robot: Robot) -> list[dict[str, Any]]:
        """Entries of result.json, one per joint."""
        return [
            {
                "name": joint,
                "unit": "rad" if robot.revolute[j] else "m",
                "rms": dict(zip(self.models, self.rms[:, j].tolist(), strict=True)),
                "ratio": float(self.ratio[j]),
            }
            for j, joint in enumerate(robot.joints)
        ]

    def series(self, name: str) -> dict[str, Array]:
        """Errors over time under keys that begin with a name, each of shape (n, nv)."""
        return {
            f"{name}_{model}": e
            for model, e in zip(self.models, self.error, strict=True)
        }


def track(
    arm: VirtualArm,
    models: Mapping[str, Robot],
    path: Trajectory,
    duration: float,
    rng: np.random.Generator,
) -> Tracking:
    """Let an arm follow a motion by each model in turn, under the same noise of readings.

    Args:
        arm: The arm; gains of the loop are those of its nominal description.
        models: Models by name, the best informed last.
        path: Positions ``path(t, order)`` and derivatives, shape (n, nv); from rest.
        duration: Length of the motion [s].
        rng: Draws the noise.

    Raises:
        BadInput: The motion starts at speed, or the arm cannot follow it.
    """
    t = np.linspace(0.0, duration, max(2, int(np.ceil(duration * _RATE_HZ)) + 1))
    motion = Motion(t, *(path(t, order) for order in range(3)))
    seed = int(rng.integers(2**32))
    errors = []
    for model in models.values():
        tau = torque(model, motion)

        def needed(at: Array, tau: Array = tau) -> Array:
            return np.column_stack([np.interp(at, t, column) for column in tau.T])

        run = arm.follow(path, duration, needed, np.random.default_rng(seed))
        errors.append(path(run.t, 0) - run.q)
    return Tracking(tuple(models), run.t, np.array(errors))
