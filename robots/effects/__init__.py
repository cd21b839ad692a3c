"""Effects: sources of torque beyond the rigid bodies of the given links, a file per family."""

# registered, and so listed and considered, in this order
from excitant.robots.effects.friction import (
    AsymmetricFriction,
    CoulombFriction,
    FrictionCoupling,
    GradualReversal,
    LoadDependentFriction,
    NonlinearViscousFriction,
    PreslidingHysteresis,
    StribeckFriction,
    ThermalFrictionDrift,
    ViscousFriction,
    turned,
)

# isort: split
from excitant.robots.effects.drive import (
    Backlash,
    InertiaCoupling,
    JointElasticity,
    RotorInertia,
    Spring,
    TorqueOffset,
    TorqueRipple,
)

# isort: split
from excitant.robots.effects.sensing import (
    EncoderEccentricity,
    EncoderOffset,
    EncoderScale,
    MotorSaturation,
    TimeDelay,
    TorqueGain,
)

# isort: split
from excitant.robots.effects.body import (
    AddedInertia,
    GivenInertias,
    GravityDirection,
    InertialParameters,
    KinematicError,
    Payload,
)

# isort: split
from excitant.robots.effects.base import (
    EFFECTS,
    Acts,
    Effect,
    Export,
    JointEffect,
    JointwiseEffect,
    PairEffect,
    Parameter,
    Physics,
    Size,
    Words,
    effect_entries,
    effects_from_entries,
    merged,
    plain,
    proposals,
    registered,
    standard_effects,
    turning,
    turning_speed,
)
from excitant.robots.effects.experiments import (
    separating_experiment,
)
from excitant.robots.effects.search import (
    JointFacts,
    Search,
    Shape,
    alternatives,
    effect_values,
    joint_facts,
    plausible,
)

__all__ = [
    "EFFECTS",
    "Acts",
    "AddedInertia",
    "AsymmetricFriction",
    "Backlash",
    "CoulombFriction",
    "Effect",
    "EncoderEccentricity",
    "EncoderOffset",
    "EncoderScale",
    "Export",
    "FrictionCoupling",
    "GivenInertias",
    "GradualReversal",
    "GravityDirection",
    "InertiaCoupling",
    "InertialParameters",
    "JointEffect",
    "JointElasticity",
    "JointFacts",
    "JointwiseEffect",
    "KinematicError",
    "LoadDependentFriction",
    "MotorSaturation",
    "NonlinearViscousFriction",
    "PairEffect",
    "Parameter",
    "Payload",
    "Physics",
    "PreslidingHysteresis",
    "RotorInertia",
    "Search",
    "Shape",
    "Size",
    "Spring",
    "StribeckFriction",
    "ThermalFrictionDrift",
    "TimeDelay",
    "TorqueGain",
    "TorqueOffset",
    "TorqueRipple",
    "ViscousFriction",
    "Words",
    "alternatives",
    "effect_entries",
    "effect_values",
    "effects_from_entries",
    "joint_facts",
    "merged",
    "plain",
    "plausible",
    "proposals",
    "registered",
    "separating_experiment",
    "standard_effects",
    "turned",
    "turning",
    "turning_speed",
]
