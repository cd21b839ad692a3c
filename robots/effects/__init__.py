"""What makes torque beyond the rigid-body inertia of the given links, one file per family."""

from excitant.robots.effects.base import (
    EFFECTS,
    Effect,
    JointEffect,
    JointFacts,
    JointwiseEffect,
    PairEffect,
    Parameter,
    Shape,
    effect_values,
    joint_facts,
    merged,
    plain,
    proposals,
    registered,
)
from excitant.robots.effects.friction import (
    AsymmetricFriction,
    CoulombFriction,
    FrictionCoupling,
    LoadDependentFriction,
    NonlinearViscousFriction,
    StribeckFriction,
    ViscousFriction,
)
from excitant.robots.effects.history import PreslidingHysteresis, ThermalFrictionDrift
from excitant.robots.effects.inertia import (
    AddedInertia,
    InertiaCoupling,
    InertialParameters,
    Payload,
    RotorInertia,
)
from excitant.robots.effects.sensing import (
    EncoderOffset,
    EncoderScale,
    GravityDirection,
    KinematicError,
    TimeDelay,
    TorqueGain,
)
from excitant.robots.effects.serialisation import effect_entries, effects_from_entries
from excitant.robots.effects.transmission import (
    Backlash,
    JointElasticity,
    Spring,
    TorqueOffset,
    TorqueRipple,
)

for _kind in (
    ViscousFriction,
    CoulombFriction,
    AsymmetricFriction,
    StribeckFriction,
    NonlinearViscousFriction,
    LoadDependentFriction,
    PreslidingHysteresis,
    FrictionCoupling,
    ThermalFrictionDrift,
    TorqueOffset,
    RotorInertia,
    InertiaCoupling,
    TorqueGain,
    TorqueRipple,
    Spring,
    JointElasticity,
    Backlash,
    TimeDelay,
    EncoderOffset,
    EncoderScale,
    KinematicError,
    GravityDirection,
    Payload,
    InertialParameters,
):
    registered(_kind)


def standard_effects(joints: tuple[str, ...]) -> tuple[Effect, ...]:
    """What `identify` estimates by default: friction, offset and rotor inertia of each joint."""
    return tuple(kind(joints) for kind in EFFECTS.values() if kind.standard)


__all__ = [
    "EFFECTS",
    "AddedInertia",
    "AsymmetricFriction",
    "Backlash",
    "CoulombFriction",
    "Effect",
    "EncoderOffset",
    "EncoderScale",
    "FrictionCoupling",
    "GravityDirection",
    "InertiaCoupling",
    "InertialParameters",
    "JointEffect",
    "JointElasticity",
    "JointFacts",
    "JointwiseEffect",
    "KinematicError",
    "LoadDependentFriction",
    "NonlinearViscousFriction",
    "PairEffect",
    "Parameter",
    "Payload",
    "PreslidingHysteresis",
    "RotorInertia",
    "Shape",
    "Spring",
    "StribeckFriction",
    "ThermalFrictionDrift",
    "TimeDelay",
    "TorqueGain",
    "TorqueOffset",
    "TorqueRipple",
    "ViscousFriction",
    "effect_entries",
    "effect_values",
    "effects_from_entries",
    "joint_facts",
    "merged",
    "plain",
    "proposals",
    "registered",
    "standard_effects",
]
