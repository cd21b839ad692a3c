"""Friction of a joint over its velocity, as an identified model has it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from excitant.identify.rows import places_of, states, told, units_of
from excitant.robots.effects import Parameter
from excitant.robots.motion import Array, Noun

if TYPE_CHECKING:
    from excitant.identify.estimate import Estimate

_POINTS = 100  # of a curve, an even number: none is at rest


@dataclass(frozen=True, eq=False)
class FrictionCurve(Noun):
    """Friction of one joint by its velocity alone, all such effects together.

    Attributes:
        joint: Name of the joint.
        unit: Unit of the torque: N·m or N, or A where nothing fixes the drive gain.
        velocity_unit: Unit of the velocity.
        per_reading: Torque in that unit per reading.
        velocity: Velocities that the hold-out has, denser near rest, shape (m,).
        torque: Friction there, shape (m,).
        half_width: Half of its 95 % interval by the uncertainty of the coefficients, shape (m,).
    """

    joint: str
    unit: str
    velocity_unit: str
    per_reading: float
    velocity: Array
    torque: Array
    half_width: Array

    def entry(self) -> dict[str, Any]:
        """What is not an array, for ``result.json``."""
        return {
            key: getattr(self, key)
            for key in ("unit", "velocity_unit", "per_reading")
        }


def friction_curves(estimate: Estimate) -> tuple[FrictionCurve | None, ...]:
    """Friction of each joint by its velocity as estimated; None where none was."""
    motion = states(estimate.data.validate)
    velocity = estimate.holdout.in_motion(motion.dq)
    return tuple(
        _friction_curve(estimate, j, velocity[:, j])
        for j in range(estimate.given.nv)
    )


def _friction_curve(
    estimate: Estimate, j: int, velocity: Array
) -> FrictionCurve | None:
    """That of joint j, whose velocities at the rows of the hold-out have shape (n,)."""
    robot = estimate.given
    joint = robot.joints[j]
    places = list[int]()
    laws = []
    for effect, columns in places_of(robot, estimate.model.effects):
        owners = [p.name.rpartition(".")[0] for p in effect.parameters(robot)]
        own = [
            columns.start + k for k, owner in enumerate(owners) if owner == joint
        ]
        over_velocity = (
            effect.family == "friction" and effect.words.abscissa == "velocity"
        )
        if own and over_velocity and effect.law:
            places += own
            laws.append(effect.law)
    if not places:
        return None
    bend = np.linspace(-1, 1, _POINTS)
    v = np.nanmax(np.abs(velocity)) * bend * np.abs(bend)
    v = v[(v >= np.nanmin(velocity)) & (v <= np.nanmax(velocity))]
    rest = np.zeros(len(v))
    C = np.column_stack([column for law in laws for column in law(rest, v, rest)])
    # in the units in which the coefficients are reported
    units = units_of(robot, estimate.model.effects, estimate.drive)
    factors = np.array([units[k][0] for k in places])
    covariance = estimate.physical.covariance[np.ix_(places, places)]
    covariance = covariance * np.outer(factors, factors)
    std = np.sqrt(np.einsum("mk,kl,ml->m", C, covariance, C))
    torque = Parameter(f"{joint}.friction", robot.torque_unit("N·m", j))
    factor, unit = told(torque, robot, estimate.drive)
    return FrictionCurve(
        joint,
        unit=unit,
        velocity_unit="rad/s" if robot.revolute[j] else "m/s",
        per_reading=float(factor * estimate.gains[j]),
        velocity=v,
        torque=C @ (factors * estimate.physical.x[places]),
        half_width=1.96 * std,
    )


def curves_over_velocity(
    curves: Sequence[FrictionCurve | None],
) -> dict[str, Array]:
    """Curves of all joints as arrays (m, nv); NaN beyond them and where there is none."""
    arrays = {}
    for key in ("velocity", "torque", "half_width"):
        array = np.full((_POINTS, len(curves)), np.nan)
        for j, curve in enumerate(curves):
            if curve is not None:
                values = getattr(curve, key)
                array[: len(values), j] = values
        arrays[f"friction_{key}"] = array
    return arrays
