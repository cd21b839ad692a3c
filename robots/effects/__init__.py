"""What makes torque beyond the rigid-body inertia of the given links, one file per family."""

from excitant.robots.effects.base import Effect, JointEffect, Parameter, Term
from excitant.robots.effects.drive import RotorInertia, TorqueOffset
from excitant.robots.effects.friction import CoulombFriction, StribeckFriction, ViscousFriction
from excitant.robots.effects.load import AddedInertia, InertialParameters, Payload
from excitant.robots.effects.serialisation import effect_entries, effects_from_entries

EFFECTS: dict[str, type[Effect]] = {
    effect.name: effect
    for effect in (
        ViscousFriction,
        CoulombFriction,
        StribeckFriction,
        RotorInertia,
        TorqueOffset,
        Payload,
        InertialParameters,
    )
}
"""Effects by their name in JSON, command line and documentation."""


def standard_effects(joints: tuple[str, ...]) -> tuple[Effect, ...]:
    """What `identify` estimates by default: friction, offset and rotor inertia of each joint."""
    return (
        ViscousFriction(joints),
        CoulombFriction(joints),
        TorqueOffset(joints),
        RotorInertia(joints),
    )


__all__ = [
    "EFFECTS",
    "AddedInertia",
    "CoulombFriction",
    "Effect",
    "InertialParameters",
    "JointEffect",
    "Parameter",
    "Payload",
    "RotorInertia",
    "StribeckFriction",
    "Term",
    "TorqueOffset",
    "ViscousFriction",
    "effect_entries",
    "effects_from_entries",
    "standard_effects",
]
