"""Hidden effects: names, joints and parameters of what a virtual arm has and its user ignores."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from excitant.exceptions import BadInput, UnknownName
from excitant.robots.parameters import STANDARD

PARAMETERS: dict[str, tuple[str, ...]] = {
    "inertial_parameters": STANDARD,
    "payload": STANDARD,
    "gravity_direction": ("roll", "pitch"),
    "viscous_friction": ("Fv",),
    "coulomb_friction": ("Fc",),
    "asymmetric_friction": ("Fc_plus", "Fc_minus", "Fv_plus", "Fv_minus"),
    "stribeck_friction": ("Fs", "velocity"),
    "nonlinear_viscous_friction": ("Fn", "exponent"),
    "load_dependent_friction": ("Fl",),
    "presliding_hysteresis": ("Fh", "distance"),
    "friction_coupling": ("Fv", "Fc", "ratio"),
    "thermal_friction_drift": ("Fv", "Fc", "time"),
    "rotor_inertia": ("Ia",),
    "inertia_coupling": ("Ic",),
    "torque_offset": ("offset",),
    "torque_gain": ("gain",),
    "torque_ripple": ("amplitude", "order", "phase"),
    "spring": ("stiffness", "moment", "rest"),
    "joint_elasticity": ("stiffness", "damping", "motor"),
    "backlash": ("gap", "stiffness", "damping", "motor"),
    "time_delay": ("delay",),
    "encoder_offset": ("offset",),
    "encoder_scale": ("scale",),
    "kinematic_error": ("dx", "dy", "dz", "rx", "ry", "rz"),
    "wrong_sign": ("q", "dq", "tau"),
    "wrong_unit": ("q", "dq", "tau"),
    "wall_contact": ("nx", "ny", "nz", "distance", "stiffness", "damping"),
    "cable_pull": ("x", "y", "z", "tension", "friction", "distance"),
    "telegraph_torque": ("amplitude", "rate"),
    "sensor_crosstalk": ("gain",),
}
"""Parameters of each effect, and of each structure of an unknown one.

Where the meaning is not plain: ``roll`` and ``pitch`` turn the base about its x axis and then
about the fixed y axis; asymmetric friction adds F_c± + F_v± |q̇| in either direction; presliding
takes F_h from the joint's Coulomb friction as far as that goes; coupled friction acts on a shaft
that turns at q̇_j + ratio q̇_k; a spring is k (q − q_0) + m sin(q − q_0); ``motor`` is inertia of
the motor beside the rotor inertia; the torque is ``delay`` late, or if negative the position;
kinematic errors move and turn the joint's frame in its parent's; data faults are factors on the
columns; cross-talk adds a share of the second joint's torque to the record of the first.
"""

OPTIONAL: dict[str, dict[str, float]] = {
    "gravity_direction": {"roll": 0.0, "pitch": 0.0},
    "asymmetric_friction": dict.fromkeys(PARAMETERS["asymmetric_friction"], 0.0),
    "friction_coupling": {"Fv": 0.0, "Fc": 0.0, "ratio": 1.0},
    "thermal_friction_drift": {"Fv": 0.0, "Fc": 0.0},
    "torque_ripple": {"phase": 0.0},
    "spring": {"stiffness": 0.0, "moment": 0.0, "rest": 0.0},
    "joint_elasticity": {"damping": 0.0, "motor": 0.0},
    "backlash": {"damping": 0.0, "motor": 0.0},
    "kinematic_error": dict.fromkeys(PARAMETERS["kinematic_error"], 0.0),
    "wrong_sign": dict.fromkeys(PARAMETERS["wrong_sign"], 1.0),
    "wrong_unit": dict.fromkeys(PARAMETERS["wrong_unit"], 1.0),
    "wall_contact": {"damping": 0.0},
}
"""Values of parameters that may be left out."""

STRUCTURES = ("wall_contact", "cable_pull", "telegraph_torque", "sensor_crosstalk")
"""What an ``unknown`` effect may be: no name of the vocabulary describes it."""


@dataclass(frozen=True)
class HiddenEffect:
    """Something the true arm has and the nominal one has not.

    Attributes:
        effect: Name of the effect.
        joint: Joint it acts on; for a payload the joint whose link holds it; empty for an effect
            of the whole arm.
        parameters: Names and values in SI units, as `PARAMETERS` lists them.
        joints: All joints it acts on, where there are several.
        structure: Which one, of an ``unknown`` effect.
    """

    effect: str
    joint: str
    parameters: tuple[tuple[str, float], ...]
    joints: tuple[str, ...] = ()
    structure: str = ""

    @property
    def kind(self) -> str:
        """Structure of an unknown effect, else the name."""
        return self.structure or self.effect

    @property
    def acts_on(self) -> tuple[str, ...]:
        """Its joints, one or several."""
        return self.joints or ((self.joint,) if self.joint else ())

    def numbers(self) -> dict[str, float]:
        """Every parameter, those left out at their usual value.

        Raises:
            UnknownName: A parameter that the effect does not have.
            BadInput: One that it lacks, or one that is not finite.
        """
        known, given = PARAMETERS[self.kind], dict(self.parameters)
        for name in given:
            if name not in known:
                raise UnknownName(f"parameter of {self.kind}", name, known)
        usual = OPTIONAL.get(self.kind, {})
        numbers = {name: given.get(name, usual.get(name, np.nan)) for name in known}
        missing = [name for name, value in numbers.items() if not np.isfinite(value)]
        if missing:
            raise BadInput(f"virtual arm: {self.kind} lacks {', '.join(missing)}")
        return numbers
