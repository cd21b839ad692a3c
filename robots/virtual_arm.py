"""The virtual arm: a hidden truth with a controller and sensors, to test whoever looks for it.

The truth is the nominal arm with inertias, friction and rotor inertia off by a few per cent, and
with effects that the nominal arm does not have. What is recorded is what sensors would give.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from excitant.exceptions import BadInput
from excitant.robots.parameters import elements, inertia, steiner
from excitant.robots.plant.controller import Trajectory
from excitant.robots.plant.nominal import (
    draw_hidden_effect,
    ideal_sensors,
    industrial_sensors,
    nominal_truth,
    typical_torque,
)
from excitant.robots.plant.physics import Drives, Truth
from excitant.robots.plant.planting import HiddenEffect, plant
from excitant.robots.plant.run import Progress, simulate
from excitant.robots.plant.sensors import Run, Sensors, recorded
from excitant.robots.robot import Robot

__all__ = [
    "HiddenEffect",
    "Sensors",
    "VirtualArm",
    "draw_hidden_effect",
    "ideal_sensors",
    "industrial_sensors",
    "nominal_truth",
    "typical_torque",
    "virtual_arm",
]

_FRICTION_TOLERANCE = 0.05


@dataclass(frozen=True, eq=False)
class VirtualArm:
    """A true arm that its user knows by its nominal description only.

    Attributes:
        nominal: What is known, and what the controller believes.
        truth: The physics.
        bare: The physics without what is hidden.
        hidden: What the truth has beside the nominal effects.
        sensors: What is recorded.
    """

    nominal: Robot
    truth: Truth
    bare: Truth
    hidden: tuple[HiddenEffect, ...]
    sensors: Sensors

    @property
    def model(self) -> Any:
        """The true rigid bodies, rotor inertia as armature; never edited."""
        return self.truth.model

    @property
    def drives(self) -> Drives:
        """The true friction."""
        return self.truth.drives

    def run(
        self,
        trajectory: Trajectory,
        duration: float,
        rng: np.random.Generator,
        progress: Progress | None = None,
        warm: float = 0.0,
    ) -> Run:
        """What happens on a trajectory; see `record`."""
        nominal, rate = nominal_truth(self.nominal), self.sensors.rate_hz
        fine = self.truth.recorder.delay.any() or np.isfinite(self.sensors.torque_cutoff_hz)
        return simulate(
            self.nominal,
            (nominal.model, nominal.drives),
            self.truth.drawn(rng, warm + duration),
            trajectory,
            duration,
            rate,
            progress,
            warm=warm,
            fine=bool(fine),
        )

    def record(
        self,
        trajectory: Trajectory,
        duration: float,
        rng: np.random.Generator,
        progress: Progress | None = None,
        warm: float = 0.0,
    ) -> pd.DataFrame:
        """Run a trajectory and record it.

        Args:
            trajectory: ``trajectory(t, order)``, shape (n, nv); starts at rest.
            duration: Length of the recording [s].
            rng: Noise of the sensors.
            progress: Called with the fraction done.
            warm: How long the arm has been running before [s].

        Returns:
            Columns ``t``, ``q1..qn``, ``dq1..dqn``, ``tau1..taun``.

        Raises:
            BadInput: The trajectory starts in motion or cannot be followed.
        """
        run = self.run(trajectory, duration, rng, progress, warm)
        return recorded(run, self.sensors, self.truth.recorder, self.drives.offset, rng)


def virtual_arm(
    robot: Robot,
    rng: np.random.Generator,
    *,
    hidden: Sequence[HiddenEffect] | None = None,
    sensors: Sensors | None = None,
    tolerance: float = 0.03,
) -> VirtualArm:
    """Build a truth around a nominal arm.

    Args:
        robot: The nominal arm; its effects, if any, are known ones.
        rng: Draws the deviations.
        hidden: What the truth has besides; one effect drawn at random when not given.
        sensors: `industrial_sensors` when not given.
        tolerance: Largest relative deviation of masses, centres of mass (relative to the
            radius of gyration) and central inertias; friction deviates by up to 5 % when this is
            not zero.

    Raises:
        BadInput: Hidden effects that leave a mass without physical consistency.
    """
    if hidden is None:
        hidden = (draw_hidden_effect(robot, rng),)
    truth = nominal_truth(robot)
    model, drives = truth.model.copy(), truth.drives
    for j in range(1, robot.nv + 1):
        model.inertias[j] = _perturbed(model.inertias[j], rng, tolerance)
    spread = _FRICTION_TOLERANCE if tolerance > 0 else 0.0
    factors = {
        name: 1 + spread * rng.uniform(-1, 1, robot.nv)
        for name in ("viscous", "coulomb", "stribeck", "rotor")
    }
    drives = replace(drives, **{k: getattr(drives, k) * f for k, f in factors.items()})
    model.armature = np.array(drives.rotor)
    bare = replace(truth, model=model, drives=drives)
    truth = plant(bare, robot.joints, hidden)
    for link, body in zip(robot.links, list(truth.model.inertias)[1:], strict=True):
        if body.mass < 0:
            raise BadInput(f"virtual arm: hidden effects leave {link} with {body.mass:.3g} kg")
    return VirtualArm(robot, truth, bare, tuple(hidden), sensors or industrial_sensors(robot))


def _perturbed(body: Any, rng: np.random.Generator, tolerance: float) -> Any:
    """A nearby body: mass and central inertia scaled, centre of mass moved."""
    factors, shift = rng.uniform(-tolerance, tolerance, 2), rng.uniform(-1, 1, 3)
    if body.mass <= 0:
        return body
    gyration = np.sqrt(max(np.trace(body.inertia), 0.0) / (2 * body.mass))
    mass, c = body.mass * (1 + factors[0]), np.array(body.lever)
    c += tolerance * gyration * shift / max(1.0, np.linalg.norm(shift))
    tensor = body.inertia * (1 + factors[1]) + steiner(mass, c)
    return inertia(np.array([mass, *(mass * c), *elements(tensor)]))
