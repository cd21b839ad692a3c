"""Hidden effects by name, and planting them: from a name and parameters to physics of the plant."""

from __future__ import annotations

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
    Cable,
    CoupledShaft,
    DryFriction,
    Gear,
    JointTorque,
    Telegraph,
    Truth,
    Wall,
)

STRUCTURES = ("wall_contact", "cable_pull", "telegraph_torque", "sensor_crosstalk")
"""What an ``unknown`` effect may be: no name of the vocabulary describes it."""

_PAIRS = ("friction_coupling", "inertia_coupling", "sensor_crosstalk")
Planter = Callable[..., Truth]
"""Truth, indices of the joints, and the parameters of the effect by name; the truth with it."""


@dataclass(frozen=True)
class HiddenEffect:
    """Something the true arm has and the nominal one has not.

    Attributes:
        effect: Name of the effect.
        joint: Joint it acts on; for a payload the joint whose link holds it; empty for an effect
            of the whole arm.
        parameters: Names and values in SI units, as the functions of `PLANTERS` take them.
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


def parameters_of(kind: str) -> dict[str, float | None]:
    """Parameters of a kind of effect with their usual values; None where there is none."""
    if kind in ("payload", "inertial_parameters"):
        return dict.fromkeys(STANDARD)
    if kind in DRIVES:
        return dict.fromkeys(DRIVES[kind])
    signature = inspect.signature(PLANTERS[kind]).parameters.values()
    return {
        p.name: None if p.default is p.empty else p.default
        for p in signature
        if p.kind is p.KEYWORD_ONLY
    }


def plant(truth: Truth, joints: tuple[str, ...], effects: Iterable[HiddenEffect]) -> Truth:
    """A truth with further effects; the one given is left alone.

    Args:
        truth: What there is already.
        joints: Names of the joints.
        effects: What to add.

    Raises:
        UnknownName: An effect that the plant does not have, or a joint it has not.
        BadInput: Parameters that the effect does not have, or lacks.
    """
    for effect in effects:
        kind, given = effect.kind, dict(effect.parameters)
        if kind not in PLANTERS:
            raise UnknownName("effect of a virtual arm", kind, PLANTERS)
        for joint in effect.acts_on:
            if joint not in joints:
                raise UnknownName("joint", joint, joints)
        if kind in _PAIRS and len(effect.acts_on) != 2:
            raise BadInput(f"virtual arm: {kind} acts on two joints; give both")
        usual = parameters_of(kind)
        for name in given:
            if name not in usual:
                raise UnknownName(f"parameter of {kind}", name, usual)
        numbers = {**usual, **given}
        missing = [name for name, x in numbers.items() if x is None or not np.isfinite(x)]
        if missing:
            raise BadInput(f"virtual arm: {kind} lacks {', '.join(missing)}")
        index = [joints.index(joint) for joint in effect.acts_on] or list(range(len(joints)))
        truth = PLANTERS[kind](truth, index, **numbers)
    return truth


def _scaled(values: Array, at: Any, factor: float) -> Array:
    changed = np.array(values)
    changed[at] *= factor
    return changed


def _shifted(values: Array, at: Any, amount: float) -> Array:
    changed = np.array(values)
    changed[at] += amount
    return changed


def _added_inertia(truth: Truth, joints: list[int], **phi: float) -> Truth:
    model = truth.model.copy()
    for j in joints:
        added = np.array([phi[name] for name in STANDARD])
        model.inertias[j + 1] = inertia(model.inertias[j + 1].toDynamicParameters() + added)
    return replace(truth, model=model)


def _tilted(truth: Truth, joints: list[int], *, roll: float = 0.0, pitch: float = 0.0) -> Truth:
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
    rx: float = 0.0,
    ry: float = 0.0,
    rz: float = 0.0,
) -> Truth:
    """The joint's frame moved and turned in its parent's."""
    model = truth.model.copy()
    turn = pin.rpy.rpyToMatrix(rx, ry, rz)
    for j in joints:
        T = model.jointPlacements[j + 1]
        moved = np.array(T.translation) + np.array([dx, dy, dz])
        model.jointPlacements[j + 1] = pin.SE3(turn @ np.array(T.rotation), moved)
    return replace(truth, model=model)


DRIVES = {
    "viscous_friction": {"Fv": "viscous"},
    "coulomb_friction": {"Fc": "coulomb"},
    "stribeck_friction": {"Fs": "stribeck", "velocity": "stribeck_velocity"},
    "rotor_inertia": {"Ia": "rotor"},
    "torque_offset": {"offset": "offset"},
}
"""Parameters of effects that change numbers of the drives, and which."""


def _driven(truth: Truth, joints: list[int], **given: float) -> Truth:
    """The truth with other drives; values are added, but for a velocity, which is set."""
    drives = {name: np.array(values) for name, values in vars(truth.drives).items()}
    rows = {name: row for kind in DRIVES.values() for name, row in kind.items()}
    for name, value in given.items():
        row = rows[name]
        drives[row][joints] = value + (0.0 if name == "velocity" else drives[row][joints])
    model = truth.model.copy()
    model.armature = np.array(drives["rotor"])
    return replace(truth, model=model, drives=type(truth.drives)(**drives))


def _dry(truth: Truth, joints: list[int], level: Any, loaded: bool = False) -> Truth:
    return replace(truth, dry=(*truth.dry, *(DryFriction(j, level, loaded) for j in joints)))


def _asymmetric(
    truth: Truth,
    joints: list[int],
    *,
    Fc_plus: float = 0.0,
    Fc_minus: float = 0.0,
    Fv_plus: float = 0.0,
    Fv_minus: float = 0.0,
) -> Truth:
    """F_c± + F_v± |q̇|, with other numbers for each direction; they may be negative."""

    def level(speed: float, t: float, load: float) -> float:
        forward = math.copysign(1.0, speed) > 0
        dry, wet = (Fc_plus, Fv_plus) if forward else (Fc_minus, Fv_minus)
        return dry + wet * abs(speed)

    return _dry(truth, joints, level)


def _power_law(truth: Truth, joints: list[int], *, Fn: float, exponent: float) -> Truth:
    """F_n |q̇|^a: drag of grease."""
    return _dry(truth, joints, lambda speed, t, load: float(Fn * abs(speed) ** exponent))


def _load_dependent(truth: Truth, joints: list[int], *, Fl: float) -> Truth:
    """F_l |τ_transmitted|: tooth friction."""
    return _dry(truth, joints, lambda speed, t, load: Fl * abs(load), True)


def _warming(
    truth: Truth, joints: list[int], *, Fv: float = 0.0, Fc: float = 0.0, time: float
) -> Truth:
    """(F_c + F_v |q̇|) e^(−t/T): what cold grease adds until it is warm."""
    return _dry(truth, joints, lambda speed, t, load: (Fc + Fv * abs(speed)) * math.exp(-t / time))


def _presliding(truth: Truth, joints: list[int], *, Fh: float, distance: float) -> Truth:
    """Hysteresis that takes F_h from the joint's Coulomb friction as far as that goes."""
    coulomb = np.array(truth.drives.coulomb)
    coulomb[joints] = np.maximum(coulomb[joints] - Fh, 0.0)
    contacts = (*truth.presliding, *(Bristles(Fh, distance, j) for j in joints))
    return replace(truth, drives=replace(truth.drives, coulomb=coulomb), presliding=contacts)


def _shaft(
    truth: Truth, joints: list[int], *, Fv: float = 0.0, Fc: float = 0.0, ratio: float = 1.0
) -> Truth:
    return replace(
        truth, shafts=(*truth.shafts, CoupledShaft((joints[0], joints[1]), ratio, Fv, Fc))
    )


def _coupled_rotors(truth: Truth, joints: list[int], *, Ic: float) -> Truth:
    return replace(truth, rotors=_shifted(truth.rotors, (joints, joints[::-1]), Ic))


def _ripple(
    truth: Truth, joints: list[int], *, amplitude: float, order: float, phase: float = 0.0
) -> Truth:
    """Cogging: A sin(n q + p), n periods per revolution of the joint."""

    def torque(q: float, t: float) -> float:
        return amplitude * math.sin(order * q + phase)

    return replace(truth, loads=(*truth.loads, *(JointTorque(j, torque, True) for j in joints)))


def _spring(
    truth: Truth,
    joints: list[int],
    *,
    stiffness: float = 0.0,
    moment: float = 0.0,
    rest: float = 0.0,
) -> Truth:
    """A coil between two links, k (q − q_0), or a balancer on a crank, m sin(q − q_0)."""

    def coil(q: float, t: float) -> float:
        return stiffness * (q - rest)

    def crank(q: float, t: float) -> float:
        return moment * math.sin(q - rest)

    present = [law for law, size in ((coil, stiffness), (crank, moment)) if size]
    loads = [JointTorque(j, law) for law in present for j in joints]
    return replace(truth, loads=(*truth.loads, *loads))


def _gear(
    truth: Truth, joints: list[int], *, stiffness: float, damping: float = 0.0, motor: float = 0.0
) -> Truth:
    """An elastic gear; ``motor`` is inertia of the motor beside the rotor inertia."""
    return _play(truth, joints, gap=0.0, stiffness=stiffness, damping=damping, motor=motor)


def _play(
    truth: Truth,
    joints: list[int],
    *,
    gap: float,
    stiffness: float,
    damping: float = 0.0,
    motor: float = 0.0,
) -> Truth:
    for j in joints:
        if truth.drives.rotor[j] + motor <= 0:
            raise BadInput("virtual arm: an elastic joint needs inertia of its motor; give motor")
        if any(gear.joint == j for gear in truth.gears):
            raise BadInput("virtual arm: two elastic gears on one joint; give one, with its gap")
    gears = (Gear(j, stiffness, damping, gap, motor) for j in joints)
    return replace(truth, gears=(*truth.gears, *gears))


def _encoder_scale(truth: Truth, joints: list[int], *, scale: float) -> Truth:
    scales = _scaled(truth.encoder.scale, joints, scale)
    return replace(truth, encoder=replace(truth.encoder, scale=scales))


def _encoder_offset(truth: Truth, joints: list[int], *, offset: float) -> Truth:
    offsets = _shifted(truth.encoder.offset, joints, offset)
    return replace(truth, encoder=replace(truth.encoder, offset=offsets))


def _torque_gain(truth: Truth, joints: list[int], *, gain: float) -> Truth:
    gains = _scaled(truth.recorder.gain, joints, gain)
    return replace(truth, recorder=replace(truth.recorder, gain=gains))


def _crosstalk(truth: Truth, joints: list[int], *, gain: float) -> Truth:
    """A share of the second joint's torque in the record of the first."""
    gains = _shifted(truth.recorder.gain, tuple(joints), gain)
    return replace(truth, recorder=replace(truth.recorder, gain=gains))


def _delay(truth: Truth, joints: list[int], *, delay: float) -> Truth:
    """The torque is this late, or if negative the position."""
    delays = _shifted(truth.recorder.delay, joints, delay)
    return replace(truth, recorder=replace(truth.recorder, delay=delays))


def _factor(
    truth: Truth, joints: list[int], *, q: float = 1.0, dq: float = 1.0, tau: float = 1.0
) -> Truth:
    """Factors on the columns."""
    before, ones = truth.recorder.factor, np.ones(truth.nv)
    given = {"q": q, "dq": dq, "tau": tau}
    factor = {name: _scaled(before.get(name, ones), joints, x) for name, x in given.items()}
    return replace(truth, recorder=replace(truth.recorder, factor=factor))


def _wall(
    truth: Truth,
    joints: list[int],
    *,
    nx: float,
    ny: float,
    nz: float,
    distance: float,
    stiffness: float,
    damping: float = 0.0,
) -> Truth:
    normal = np.array([nx, ny, nz])
    wall = Wall(normal / np.linalg.norm(normal), distance, stiffness, damping)
    return replace(truth, forces=(*truth.forces, wall))


def _cable(
    truth: Truth,
    joints: list[int],
    *,
    x: float,
    y: float,
    z: float,
    tension: float,
    friction: float,
    distance: float,
) -> Truth:
    cable = Cable(np.array([x, y, z]), tension, Bristles(friction, distance))
    return replace(truth, forces=(*truth.forces, cable))


def _telegraph(truth: Truth, joints: list[int], *, amplitude: float, rate: float) -> Truth:
    return replace(truth, random=(*truth.random, *(Telegraph(j, amplitude, rate) for j in joints)))


PLANTERS: dict[str, Planter] = {
    **dict.fromkeys(DRIVES, _driven),
    "inertial_parameters": _added_inertia,
    "payload": _added_inertia,
    "gravity_direction": _tilted,
    "asymmetric_friction": _asymmetric,
    "nonlinear_viscous_friction": _power_law,
    "load_dependent_friction": _load_dependent,
    "presliding_hysteresis": _presliding,
    "friction_coupling": _shaft,
    "thermal_friction_drift": _warming,
    "inertia_coupling": _coupled_rotors,
    "torque_gain": _torque_gain,
    "torque_ripple": _ripple,
    "spring": _spring,
    "joint_elasticity": _gear,
    "backlash": _play,
    "time_delay": _delay,
    "encoder_offset": _encoder_offset,
    "encoder_scale": _encoder_scale,
    "kinematic_error": _misplaced,
    "wrong_sign": _factor,
    "wrong_unit": _factor,
    "wall_contact": _wall,
    "cable_pull": _cable,
    "telegraph_torque": _telegraph,
    "sensor_crosstalk": _crosstalk,
}
"""How each effect is planted, and each structure of an unknown one."""
