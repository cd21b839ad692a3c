"""Errors of an arm's geometry, mounting and bodies.

All are linear in their coefficients to first order, at the given model's torque.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from excitant.robots.effects import experiments as by
from excitant.robots.effects.base import (
    SIGN_DEVIATIONS,
    Effect,
    JointFacts,
    Parameter,
    Size,
    registered,
    within,
)
from excitant.robots.motion import Array, Motion
from excitant.robots.parameters import STANDARD, UNITS
from excitant.robots.regressor import (
    gravity_torque,
    regressor,
    rigid_body_torque,
    torque_along,
)
from excitant.robots.robot import Robot

_TURNED = 0.05  # of 9.81 m/s², by which a turned gravity may differ in size
_METRE = 1e-3  # of the central difference; torque is quadratic in a placement, so any would do
_BODY = tuple(zip(STANDARD, UNITS, strict=True))


@dataclass(frozen=True)
class _GeometryEffect(Effect):
    """A joint is elsewhere than its encoder or the model says."""

    family = "geometry"
    arity = 1
    smooth = True
    of_state_alone = False
    further = False


@registered
class EncoderOffset(_GeometryEffect):
    """True angle = reading + δ."""

    name = "encoder_offset"
    terms = (Parameter("offset_angle", "rad", typical=0.3),)
    told = (
        (
            f"{by.ZERO}; the last joint's offset is a turned last link",
            "inertial_parameters",
        ),
        (f"{by.ZERO}; or {by.UNLOADED}", "payload"),
        (
            f"{by.TURNED}: tilt's phase follows q1, an encoder's offset does not",
            "gravity_direction",
        ),
        (f"{by.ZERO}, and at the far end of its range", "encoder_scale"),
    )

    def columns(self, robot: Robot, motion: Motion) -> Array:
        shift = np.ones(len(motion))
        return torque_along(robot, motion, self.rows(robot)[0], shift)[:, :, None]


@registered
class EncoderScale(_GeometryEffect):
    """True angle = (1 + s) reading; speed and acceleration alike."""

    name = "encoder_scale"
    terms = (Parameter("scale", "1", typical=0.3),)
    told = ((by.KINEMATICS, "inertial_parameters"),)

    def columns(self, robot: Robot, motion: Motion) -> Array:
        j = self.rows(robot)[0]
        return torque_along(robot, motion, j, motion.q[:, j])[:, :, None]


@registered
class KinematicError(_GeometryEffect):
    """The joint sits elsewhere in its parent link than the model says."""

    name = "kinematic_error"
    terms = tuple(
        Parameter(f"d{axis}", "m", typical=0.1, vector="distance") for axis in "xyz"
    )
    told = (
        (
            f"{by.KINEMATICS}; or repeat the motion in another pose region",
            "inertial_parameters",
        ),
        (by.UNLOADED, "payload"),
        (f"{by.LEVEL}; {by.KINEMATICS}", "gravity_direction"),
    )

    def columns(self, robot: Robot, motion: Motion) -> Array:
        """Central differences by the translation; the first joint feels the same everywhere."""
        j = self.rows(robot)[0]
        parts = []
        if robot.model.parents[j + 1] == 0:
            return np.zeros((*motion.q.shape, 3))
        for step in _METRE * np.eye(3):
            ahead, behind = (
                rigid_body_torque(_moved(robot, j, s * step), motion) for s in (1, -1)
            )
            parts.append((ahead - behind) / (2 * _METRE))
        return np.stack(parts, axis=2)

    def sentence(
        self, robot: Robot, joints: Sequence[str], sizes: Sequence[Size]
    ) -> str:
        distance = f"{1e3 * sizes[0].value:.0f} ± {1e3 * sizes[0].std:.2g} mm"
        return f"The axis of {joints[0]} seems {distance} off where the model has it"


def _moved(robot: Robot, j: int, step: Array) -> Robot:
    model = robot.model.copy()
    model.jointPlacements[j + 1].translation = (
        model.jointPlacements[j + 1].translation + step
    )
    return replace(robot, model=model)


@registered
class GravityDirection(Effect):
    """Gravity points elsewhere in the base frame: the arm is mounted otherwise, or tilted."""

    name = "gravity_direction"
    terms = tuple(Parameter(f"d{axis}", "m/s²", typical=10.0) for axis in "xyz")
    family = "static"
    smooth = True
    further = False
    told = (
        (f"{by.LEVEL}; or {by.STRETCHED}", "inertial_parameters"),
        (f"{by.UNLOADED}; {by.LEVEL}", "payload"),
    )

    @classmethod
    def proposed(
        cls, robot: Robot, facts: Sequence[JointFacts]
    ) -> list[tuple[Self, int]]:
        return [(cls(robot.joints), 1)]

    def owners(self, robot: Robot) -> tuple[str, ...]:
        return ("gravity",)

    def columns(self, robot: Robot, motion: Motion) -> Array:
        return np.stack(
            [gravity_torque(robot, motion, unit) for unit in np.eye(3)], axis=2
        )

    def plausible(self, robot: Robot, values: Array, std: Array) -> bool:
        """Whether the changed vector is still as long as gravity."""
        size = float(np.linalg.norm(robot.gravity))
        off = abs(float(np.linalg.norm(robot.gravity + values)) - size)
        unsure = SIGN_DEVIATIONS * float(np.linalg.norm(std))
        return off < _TURNED * size + min(unsure, _TURNED * size)

    def applied(self, robot: Robot) -> Robot:
        return robot.with_gravity(robot.gravity + self._known())

    def sentence(
        self, robot: Robot, joints: Sequence[str], sizes: Sequence[Size]
    ) -> str:
        true = ", ".join(f"{x:.2f}" for x in robot.gravity + self._known())
        spread = ", ".join(f"{size.std:.2g}" for size in sizes)
        return f"Gravity points along ({true}) ± ({spread}) m/s² in the base frame"


@dataclass(frozen=True)
class AddedInertia(Effect):
    """Inertial parameters added to the link that one joint carries, about the joint frame."""

    family = "body"
    arity = 1
    depends_on_model = False
    further = False

    def owners(self, robot: Robot) -> tuple[str, ...]:
        return (robot.links[self.rows(robot)[0]],)

    def columns(self, robot: Robot, motion: Motion) -> Array:
        j = self.rows(robot)[0]
        return regressor(robot, motion)[:, :, 10 * j : 10 * j + 10]

    def applied(self, robot: Robot) -> Robot:
        phi = robot.phi.reshape(-1, 10).copy()
        phi[self.rows(robot)[0]] += self._known()
        return robot.with_parameters(phi)


@registered
class Payload(AddedInertia):
    """A body held by the last link: mass, first moment and inertia about its joint frame."""

    name = "payload"
    role = "body"
    terms = tuple(Parameter(f"payload_{name}", unit) for name, unit in _BODY)
    told = ((by.UNLOADED, "inertial_parameters"),)

    @classmethod
    def proposed(
        cls, robot: Robot, facts: Sequence[JointFacts]
    ) -> list[tuple[Self, int]]:
        return [(cls(robot.joints[-1:]), 1)]

    def is_common(self, robot: Robot) -> bool:
        """It is: all joints carry the same body."""
        return True

    def plausible(self, robot: Robot, values: Array, std: Array) -> bool:
        """Whether its mass is not negative."""
        return within(values[:1], 0.0, std[:1])

    def noun(self, robot: Robot) -> str:
        return "a payload"

    def sentence(
        self, robot: Robot, joints: Sequence[str], sizes: Sequence[Size]
    ) -> str:
        return f"A payload of {sizes[0]} on the last link is missing from the model"


@registered
class InertialParameters(AddedInertia):
    """A link's inertial parameters differ from the given ones."""

    name = "inertial_parameters"
    role = "link"
    terms = tuple(Parameter(f"delta_{name}", unit) for name, unit in _BODY)

    def noun(self, robot: Robot) -> str:
        return f"wrong inertial parameters of {robot.links[self.rows(robot)[0]]}"

    def sentence(
        self, robot: Robot, joints: Sequence[str], sizes: Sequence[Size]
    ) -> str:
        j = self.rows(robot)[0]
        mass = f"{sizes[0].value:+.2f} ± {sizes[0].std:.2g} kg"
        if j == robot.nv - 1 and sizes[0].value < 0:
            return (
                f"{robot.links[j]} is lighter than the model says ({mass}), as if a tool "
                "in the model were not mounted"
            )
        return f"The inertial parameters of {robot.links[j]} are wrong (mass {mass})"


class GivenInertias(InertialParameters):
    """The inertial parameters of several links differ from the given ones."""

    arity = 0

    def owners(self, robot: Robot) -> tuple[str, ...]:
        return tuple(robot.links[row] for row in self.rows(robot))

    def columns(self, robot: Robot, motion: Motion) -> Array:
        Y = regressor(robot, motion)
        return np.concatenate(
            [Y[:, :, 10 * j : 10 * j + 10] for j in self.rows(robot)], axis=2
        )

    def noun(self, robot: Robot) -> str:
        return f"inertias of {', '.join(self.owners(robot))} other than given"

    def sentence(
        self, robot: Robot, joints: Sequence[str], sizes: Sequence[Size]
    ) -> str:
        masses = robot.phi[::10][self.rows(robot)]
        added = self._known()[::10]
        said = ", ".join(
            f"{link} {mass:.3g} → {mass + more:.3g} kg"
            for link, mass, more in zip(self.owners(robot), masses, added, strict=True)
        )
        return f"The given inertias are off at several links, so they were re-identified ({said})"
