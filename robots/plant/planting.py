"""Hidden effects by name, and planting them: from a name and parameters to physics of the plant."""

import inspect
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin

from excitant.exceptions import BadInput, UnknownName
from excitant.robots.motion import Array
from excitant.robots.parameters import STANDARD, inertia
from excitant.robots.plant.physics import (
    Bristles,
    CoupledShaft,
    DryFriction,
    Gear,
    JointTorque,
    Telegraph,
    Truth,
)

STRUCTURES = ("telegraph_torque", "sensor_crosstalk")
"""Structures of an ``unknown`` effect, which no name of the vocabulary describes."""

_PAIRS = ("friction_coupling", "inertia_coupling", "sensor_crosstalk")


@dataclass(frozen=True)
class HiddenEffect:
    """Something the true arm has and the nominal one has not.

    Attributes:
        effect: Its name.
        joint: Joint it acts on, or whose link holds it; empty for an effect of the whole arm.
        parameters: Names, as in `parameters_of`, and values in SI units.
        joints: All that it acts on, where there are several.
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

    def entry(self) -> dict[str, Any]:
        """Entry of result.json."""
        return {
            "effect": self.effect,
            "joint": self.joint,
            "parameters": dict(self.parameters),
        }


def parameters_of(kind: str) -> dict[str, float | None]:
    """Parameters of a kind of effect with their usual values; None where there is none."""
    if kind in ("payload", "inertial_parameters"):
        return dict.fromkeys(STANDARD)
    if kind in NUMBERS:
        return dict.fromkeys(NUMBERS[kind])
    law = LAWS[kind][1] if kind in LAWS else PLANTERS[kind]
    return {
        p.name: None if p.default is p.empty else p.default
        for p in inspect.signature(law).parameters.values()
        if p.kind is p.KEYWORD_ONLY
    }


def plant(
    truth: Truth, joints: tuple[str, ...], effects: Iterable[HiddenEffect]
) -> Truth:
    """A truth with further effects, its joints named; the one given is left alone.

    Raises:
        UnknownName: An effect that the plant does not have, or a joint it has not.
        BadInput: Parameters that the effect does not have, or lacks.
    """
    for effect in effects:
        kind = effect.kind
        stated = dict(effect.parameters)
        UnknownName.refuse("effect of a virtual arm", [kind], KINDS)
        UnknownName.refuse("joint", effect.acts_on, joints)
        if kind in _PAIRS and len(effect.acts_on) != 2:
            raise BadInput(f"virtual arm: {kind} acts on two joints; give both")
        usual = parameters_of(kind)
        UnknownName.refuse(f"parameter of {kind}", stated, usual)
        numbers = {**usual, **stated}
        missing = [
            name for name, x in numbers.items() if x is None or not np.isfinite(x)
        ]
        if missing:
            raise BadInput(f"virtual arm: {kind} lacks {', '.join(missing)}")
        index = [joints.index(joint) for joint in effect.acts_on or joints]
        if kind in NUMBERS:
            truth = _changed(truth, kind, index, stated)
        elif kind in LAWS:
            part, law = LAWS[kind]
            truth = _with(truth, part, *(law(j, **numbers) for j in index))
        else:
            truth = PLANTERS[kind](truth, index, **numbers)
    return truth


def _with(truth: Truth, part: str, *further: object) -> Truth:
    more: dict[str, Any] = {part: (*getattr(truth, part), *further)}
    return replace(truth, **more)


NUMBERS: dict[str, dict[str, tuple[str, str, Callable[[Array, float], Array]]]] = {
    "viscous_friction": {"Fv": ("drives", "viscous", np.add)},
    "coulomb_friction": {"Fc": ("drives", "coulomb", np.add)},
    "stribeck_friction": {
        "Fs": ("drives", "stribeck", np.add),
        "velocity": ("drives", "stribeck_velocity", np.full_like),
    },
    "rotor_inertia": {"Ia": ("drives", "rotor", np.add)},
    "torque_offset": {"offset": ("drives", "offset", np.add)},
    "encoder_scale": {"scale": ("encoder", "scale", np.multiply)},
    "encoder_offset": {"offset": ("encoder", "offset", np.add)},
    "torque_gain": {"gain": ("recorder", "gain", np.multiply)},
    "time_delay": {"delay": ("recorder", "delay", np.add)},
}
"""Parameters of effects that change numbers of drives and sensors: which, and how."""


def _changed(
    truth: Truth, kind: str, joints: list[int], stated: dict[str, float]
) -> Truth:
    for name, value in stated.items():
        part, field, change = NUMBERS[kind][name]
        owner = getattr(truth, part)
        numbers = np.array(getattr(owner, field))
        numbers[joints] = change(numbers[joints], value)
        changed = {part: replace(owner, **{field: numbers})}
        truth = replace(truth, **changed)
    model = truth.model.copy()
    model.armature = truth.drives.rotor
    return replace(truth, model=model)


def _asymmetric(
    joint: int,
    *,
    Fc_plus: float = 0.0,
    Fc_minus: float = 0.0,
    Fv_plus: float = 0.0,
    Fv_minus: float = 0.0,
) -> DryFriction:
    """F_c± + F_v± |q̇|, with other numbers for each direction; they may be negative."""

    def level(speed: float, t: float, load: float) -> float:
        forward = math.copysign(1.0, speed) > 0
        dry, wet = (Fc_plus, Fv_plus) if forward else (Fc_minus, Fv_minus)
        return dry + wet * abs(speed)

    return DryFriction(joint, level)


def _power_law(joint: int, *, Fn: float, exponent: float) -> DryFriction:
    """F_n |q̇|^a: drag of grease."""
    return DryFriction(
        joint, lambda speed, t, load: float(Fn * abs(speed) ** exponent)
    )


def _load_dependent(joint: int, *, Fl: float) -> DryFriction:
    """F_l |τ_transmitted|: tooth friction."""
    return DryFriction(joint, lambda speed, t, load: Fl * abs(load))


def _warming(
    joint: int, *, Fv: float = 0.0, Fc: float = 0.0, time: float
) -> DryFriction:
    """(F_c + F_v |q̇|) e^(−t/T): what cold grease adds until it is warm."""
    return DryFriction(
        joint, lambda speed, t, load: (Fc + Fv * abs(speed)) * math.exp(-t / time)
    )


def _ripple(
    joint: int, *, amplitude: float, order: float, phase: float = 0.0
) -> JointTorque:
    """Cogging: A sin(n q + p), n periods per revolution of the joint."""
    return JointTorque(
        joint, lambda q, t: amplitude * math.sin(order * q + phase), on_motor=True
    )


def _spring(
    joint: int, *, stiffness: float = 0.0, moment: float = 0.0, rest: float = 0.0
) -> JointTorque:
    """A coil between two links, k (q − q_0), and a balancer on a crank, m sin(q − q_0)."""
    return JointTorque(
        joint, lambda q, t: stiffness * (q - rest) + moment * math.sin(q - rest)
    )


LAWS: dict[str, tuple[str, Callable[..., object]]] = {
    "asymmetric_friction": ("dry", _asymmetric),
    "nonlinear_viscous_friction": ("dry", _power_law),
    "load_dependent_friction": ("dry", _load_dependent),
    "thermal_friction_drift": ("dry", _warming),
    "torque_ripple": ("loads", _ripple),
    "spring": ("loads", _spring),
    "telegraph_torque": ("random", Telegraph),
}
"""Further laws of single joints: what the truth has more of, and the law of a joint."""


def _added_inertia(truth: Truth, joints: list[int], **phi: float) -> Truth:
    model = truth.model.copy()
    added = np.array([phi[name] for name in STANDARD])
    for j in joints:
        model.inertias[j + 1] = inertia(
            model.inertias[j + 1].toDynamicParameters() + added
        )
    return replace(truth, model=model)


def _tilted(
    truth: Truth, joints: list[int], *, roll: float = 0.0, pitch: float = 0.0
) -> Truth:
    """The base turned about its x axis and then about the fixed y axis."""
    model = truth.model.copy()
    base = pin.rpy.rpyToMatrix(roll, pitch, 0.0)
    model.gravity.linear = base.T @ np.array(model.gravity.linear)
    return replace(truth, model=model)


def _misplaced(
    truth: Truth,
    joints: list[int],
    *,
    dx: float = 0.0,
    dy: float = 0.0,
    dz: float = 0.0,
) -> Truth:
    """The joint's frame moved in its parent's."""
    model = truth.model.copy()
    for j in joints:
        place = model.jointPlacements[j + 1]
        place.translation = place.translation + np.array([dx, dy, dz])
    return replace(truth, model=model)


def _presliding(
    truth: Truth, joints: list[int], *, Fh: float, distance: float
) -> Truth:
    """Hysteresis that takes F_h from the joint's Coulomb friction as far as that goes."""
    coulomb = np.array(truth.drives.coulomb)
    coulomb[joints] = np.maximum(coulomb[joints] - Fh, 0.0)
    truth = replace(truth, drives=replace(truth.drives, coulomb=coulomb))
    return _with(truth, "presliding", *(Bristles(j, Fh, distance) for j in joints))


def _shaft(
    truth: Truth,
    joints: list[int],
    *,
    Fv: float = 0.0,
    Fc: float = 0.0,
    ratio: float = 1.0,
) -> Truth:
    one, other = joints
    return _with(truth, "shafts", CoupledShaft((one, other), ratio, Fv, Fc))


def _coupled_rotors(truth: Truth, joints: list[int], *, Ic: float) -> Truth:
    rotors = np.array(truth.rotors)
    rotors[joints, joints[::-1]] += Ic
    return replace(truth, rotors=rotors)


def _crosstalk(truth: Truth, joints: list[int], *, gain: float) -> Truth:
    """A share of the second joint's torque in the record of the first."""
    gains = np.array(truth.recorder.gain)
    gains[*joints] += gain
    return replace(truth, recorder=replace(truth.recorder, gain=gains))


def _gear(
    truth: Truth,
    joints: list[int],
    *,
    stiffness: float,
    damping: float = 0.0,
    motor: float = 0.0,
    gap: float = 0.0,
) -> Truth:
    """An elastic gear; ``motor`` is inertia of the motor beside the rotor inertia."""
    for j in joints:
        if truth.drives.rotor[j] + motor <= 0:
            raise BadInput(
                "virtual arm: an elastic joint needs inertia of its motor; give motor"
            )
        if any(gear.joint == j for gear in truth.gears):
            raise BadInput(
                "virtual arm: two elastic gears on one joint; give one, with its gap"
            )
    return _with(
        truth, "gears", *(Gear(j, stiffness, damping, gap, motor) for j in joints)
    )


PLANTERS: dict[str, Callable[..., Truth]] = {
    "inertial_parameters": _added_inertia,
    "payload": _added_inertia,
    "gravity_direction": _tilted,
    "presliding_hysteresis": _presliding,
    "friction_coupling": _shaft,
    "inertia_coupling": _coupled_rotors,
    "joint_elasticity": _gear,
    "backlash": _gear,
    "kinematic_error": _misplaced,
    "sensor_crosstalk": _crosstalk,
}
"""The others: truth, indices of the joints, and the parameters by name; the truth with it."""
KINDS = (*NUMBERS, *LAWS, *PLANTERS)
"""Everything that can be planted."""
