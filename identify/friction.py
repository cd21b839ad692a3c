"""Friction of a joint over its velocity, as an identified model has it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from excitant.identify.rows import told
from excitant.robots.effects import Parameter
from excitant.robots.motion import Array, freeze

if TYPE_CHECKING:
    from excitant.identify.estimate import Estimate

_POINTS = 100  # of a curve, an even number: none is at rest
_DEVIATIONS = 1.96  # standard deviations that hold 95 %


@dataclass(frozen=True, eq=False)
class FrictionCurve:
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

    def __post_init__(self) -> None:
        freeze(self, "velocity", "torque", "half_width")

    def entry(self) -> dict[str, Any]:
        """What is not an array, for ``result.json``."""
        return {
            key: getattr(self, key) for key in ("unit", "velocity_unit", "per_reading")
        }


def friction_curve(estimate: Estimate, joint: str) -> FrictionCurve | None:
    """Friction of a joint by its velocity as estimated; None where none was."""
    robot = estimate.given
    j = estimate.given.joint_index(joint)
    first = 10 * robot.nv
    places = list[int]()
    laws = []
    for effect in estimate.model.effects:
        names = [p.name.rpartition(".")[0] for p in effect.parameters(robot)]
        own = [first + k for k, name in enumerate(names) if name == joint]
        if (
            own
            and effect.family == "friction"
            and effect.abscissa == "velocity"
            and effect.law
        ):
            places += own
            laws.append(effect.law)
        first += len(names)
    if not places:
        return None
    seen = estimate.velocity[:, j]
    bend = np.linspace(-1, 1, _POINTS)
    v = np.nanmax(np.abs(seen)) * bend * np.abs(bend)
    v = v[(v >= np.nanmin(seen)) & (v <= np.nanmax(seen))]
    rest = np.zeros(len(v))
    C = np.column_stack([column for law in laws for column in law(rest, v, rest)])
    # in the units in which the coefficients are told
    x = np.array([estimate.told[k][0] for k in places]) * estimate.physical.x[places]
    covariance = estimate.physical.covariance[np.ix_(places, places)]
    scale = estimate.std[places] / np.sqrt(np.diag(covariance))
    covariance = covariance * np.outer(scale, scale)
    half = _DEVIATIONS * np.sqrt(np.einsum("mk,kl,ml->m", C, covariance, C))
    torque = Parameter(f"{joint}.friction", robot.torque_unit("N·m", j))
    factor, unit = told(torque, robot, estimate.drive)
    turns = "rad/s" if robot.revolute[j] else "m/s"
    return FrictionCurve(
        joint, unit, turns, float(factor * estimate.gains[j]), v, C @ x, half
    )


def curves_over_velocity(estimate: Estimate) -> dict[str, Array]:
    """Series of the curves of all joints, each (m, nv); NaN beyond them and where there is none."""
    keys = ("velocity", "torque", "half_width")
    arrays = {
        f"friction_{key}": np.full((_POINTS, estimate.given.nv), np.nan) for key in keys
    }
    for j, curve in enumerate(estimate.friction):
        for key in keys if curve is not None else ():
            values = getattr(curve, key)
            arrays[f"friction_{key}"][: len(values), j] = values
    return arrays
