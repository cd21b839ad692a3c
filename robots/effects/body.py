"""Bodies of an arm, its mounting and where its joints sit.

All are linear in their coefficients to first order, at the given model's torque.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from excitant.robots.effects import experiments as by
from excitant.robots.effects.base import (
    Acts,
    Effect,
    Parameter,
    Physics,
    Size,
    Words,
    registered,
)
from excitant.robots.effects.search import BOUND_STDS, Search, above
from excitant.robots.motion import Array, Motion, numbered, root_mean_square
from excitant.robots.parameters import STANDARD, UNITS
from excitant.robots.regressor import (
    gravity_torque,
    regressor,
    rigid_body_torque,
    rigid_torque,
)
from excitant.robots.robot import Robot

GRAVITY_TOLERANCE = 0.05  # of its size, by which a turned gravity may differ
STATES = 20  # random ones, of which two thirds tell a torque's size to a quarter
FAINT = 0.01  # of the torque of a body's change: a mass that makes less is no size of it
_BODY = tuple(zip(STANDARD, UNITS, strict=True))


@registered
class KinematicError(Effect):
    """The joint sits elsewhere in its parent link than the model says."""

    name = "kinematic_error"
    family = "geometry"
    acts_on = Acts.ONE
    terms = tuple(
        Parameter(f"d{axis}", "m", typical=0.1, vector="distance") for axis in "xyz"
    )
    physics = Physics(smooth=True)
    search = Search("diagnosis")
    words = Words(
        separated_by={
            "inertial_parameters": f"{by.KINEMATICS}; or repeat the motion in another pose region",
            "payload": by.UNLOADED,
            "gravity_direction": f"{by.LEVEL}; {by.KINEMATICS}",
        },
        sentence=lambda effect, robot, joints, sizes: (
            f"The axis of {joints[0]} seems "
            f"{1e3 * sizes[0].value:.0f}{sizes[0].spread(1e3)} mm off where the model has it"
        ),
    )

    def columns(self, robot: Robot, motion: Motion) -> Array:
        return np.stack([self._along(robot, motion, axis) for axis in np.eye(3)], 2)

    def torque(self, robot: Robot, motion: Motion) -> Array:
        return self._along(robot, motion, np.array(self.coefficients))

    def _along(self, robot: Robot, motion: Motion, shift: Array) -> Array:
        """Torque by a translation, shape (3,) [m], to first order, shape (n, nv) [N·m].

        A central difference, which is exact: torque is quadratic in a placement.
        """
        j = self.rows(robot)[0]
        if not robot.model.parents[j + 1]:  # no torque tells where the base stands
            return np.zeros(motion.q.shape)
        ahead = rigid_body_torque(_moved(robot, j, shift), motion)
        behind = rigid_body_torque(_moved(robot, j, -shift), motion)
        return (ahead - behind) / 2


def _moved(robot: Robot, j: int, step: Array) -> Robot:
    model = robot.model.copy()
    placement = model.jointPlacements[j + 1]
    placement.translation = placement.translation + step
    return replace(robot, model=model)


def _is_gravity(
    effect: GravityDirection, robot: Robot, values: Array, std: Array
) -> bool:
    """Whether the changed vector is as long as gravity."""
    size = float(np.linalg.norm(robot.gravity))
    off = abs(float(np.linalg.norm(robot.gravity + values)) - size)
    uncertain = BOUND_STDS * float(np.linalg.norm(std))
    tolerance = GRAVITY_TOLERANCE * size
    return off < tolerance + min(uncertain, tolerance)


def _true_gravity(
    effect: GravityDirection,
    robot: Robot,
    joints: Sequence[str],
    sizes: Sequence[Size],
) -> str:
    if not (robot.gravity + effect.coefficients).any():
        return "The torque has no gravity: it was taken off, or gravity is balanced"
    gravity = ", ".join(f"{x:.2f}" for x in robot.gravity + effect.coefficients)
    spread = ", ".join(f"{size.std:.2g}" for size in sizes if np.isfinite(size.std))
    gravity = f"({gravity}) ± ({spread})" if spread else f"({gravity})"
    return f"Gravity points along {gravity} m/s² in the base frame"


@registered
class GravityDirection(Effect):
    """Gravity points elsewhere in the base frame: the arm is mounted otherwise, or tilted."""

    name = "gravity_direction"
    family = "static"
    terms = tuple(Parameter(f"d{axis}", "m/s²", typical=10.0) for axis in "xyz")
    physics = Physics(smooth=True)
    search = Search("diagnosis", feasible=_is_gravity)
    words = Words(
        separated_by={
            "inertial_parameters": f"{by.LEVEL}; or {by.STRETCHED}",
            "payload": f"{by.UNLOADED}; {by.LEVEL}",
        },
        sentence=_true_gravity,
    )

    def owners(self, robot: Robot) -> tuple[str, ...]:
        return ("gravity",)

    def columns(self, robot: Robot, motion: Motion) -> Array:
        torques = [gravity_torque(robot, motion, unit) for unit in np.eye(3)]
        return np.stack(torques, axis=2)

    def applied(self, robot: Robot) -> Robot:
        return robot.with_gravity(robot.gravity + self.coefficients)


class AddedInertia(Effect):
    """Inertial parameters added to the link that one joint carries, about the joint frame."""

    family = "body"
    acts_on = Acts.ONE
    physics = Physics("motion")
    search = Search("diagnosis")

    def owners(self, robot: Robot) -> tuple[str, ...]:
        return tuple(robot.links[row] for row in self.rows(robot))

    def columns(self, robot: Robot, motion: Motion) -> Array:
        Y = regressor(robot, motion)
        parts = [Y[:, :, 10 * j : 10 * j + 10] for j in self.rows(robot)]
        return np.concatenate(parts, axis=2)

    def torque(self, robot: Robot, motion: Motion) -> Array:
        return rigid_torque(self.applied(robot), motion) - rigid_torque(
            robot, motion
        )

    def applied(self, robot: Robot) -> Robot:
        phi = np.array(robot.phi).reshape(-1, 10)
        phi[self.rows(robot)] += np.reshape(self.coefficients, (-1, 10))
        return robot.with_parameters(phi)

    def told(self, robot: Robot) -> int:
        """Index of the coefficient that says how large it is: the mass, where torque depends on it.

        Else that which makes most of the torque over random states.
        """
        states = robot.random_motion(0, STATES)
        torque = self.columns(robot, numbered(*states)) * self.coefficients
        size = root_mean_square(torque, axis=(0, 1))
        main = int(np.argmax(size))
        return main if size[0] < FAINT * size[main] else 0


def _is_load(effect: Payload, robot: Robot, values: Array, std: Array) -> bool:
    """Whether a body has mass, on which torque depends: without, it is any change of its link."""
    shown = effect.with_values(values).told(robot) == 0
    return shown and above(values[:1], 0.0, std[:1])


@registered
class Payload(AddedInertia):
    """A body held by the last link: mass, first moment and inertia about its joint frame."""

    name = "payload"
    role = "body"
    terms = tuple(Parameter(f"payload_{name}", unit) for name, unit in _BODY)
    search = Search(
        "diagnosis",
        places=lambda joints: [joints[-1:]],
        feasible=_is_load,
    )
    words = Words(
        separated_by={
            "inertial_parameters": by.UNLOADED,
        },
        sentence=lambda effect, robot, joints, sizes: (
            f"A payload of {sizes[0]} on the last link is missing from the model"
        ),
        noun=lambda effect, robot: "a payload",
    )

    def is_common(self, robot: Robot) -> bool:
        """It is: all joints carry the same body."""
        return True


def _wrong_mass(
    effect: InertialParameters,
    robot: Robot,
    joints: Sequence[str],
    sizes: Sequence[Size],
) -> str:
    [link] = effect.owners(robot)
    if told := effect.told(robot):
        name = STANDARD[told]
        return f"The inertial parameters of {link} are wrong (its {name} is off by {sizes[told]})"
    mass = sizes[0].value
    size = f"{abs(mass):.3g}{sizes[0].spread()} kg {'lighter' if mass < 0 else 'heavier'}"
    if link == robot.links[-1] and mass < 0:
        return f"{link} is {size} than the model says, as if a tool in the model were not mounted"
    return f"The inertial parameters of {link} are wrong (it is {size} than the model says)"


@registered
class InertialParameters(AddedInertia):
    """A link's inertial parameters differ from the given ones."""

    name = "inertial_parameters"
    role = "link"
    terms = tuple(Parameter(f"delta_{name}", unit) for name, unit in _BODY)
    words = Words(
        sentence=_wrong_mass,
        noun=lambda effect, robot: (
            f"wrong inertial parameters of {effect.owners(robot)[0]}"
        ),
    )


def _masses(
    effect: GivenInertias,
    robot: Robot,
    joints: Sequence[str],
    sizes: Sequence[Size],
) -> str:
    nominal = robot.phi[::10][effect.rows(robot)]
    change = effect.coefficients[::10]
    masses = ", ".join(
        f"{link} {mass:.3g} → {mass + added:.3g} kg"
        for link, mass, added in zip(
            effect.owners(robot), nominal, change, strict=True
        )
    )
    return f"The given inertias are off at several links, so they were re-identified ({masses})"


class GivenInertias(InertialParameters):
    """The inertial parameters of several links differ from the given ones."""

    acts_on = Acts.COMMON
    words = Words(
        sentence=_masses,
        noun=lambda effect, robot: (
            f"inertias of {', '.join(effect.owners(robot))} other than given"
        ),
    )
