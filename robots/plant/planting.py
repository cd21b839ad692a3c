"""Planting: from the name of a hidden effect and its parameters to physics of the plant."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin

from excitant.exceptions import BadInput, UnknownName
from excitant.robots.motion import Array
from excitant.robots.parameters import STANDARD
from excitant.robots.plant.friction import (
    Asymmetric,
    Bristles,
    CoupledShaft,
    LoadDependent,
    PowerLaw,
    Presliding,
    Warming,
)
from excitant.robots.plant.hidden_effect import HiddenEffect
from excitant.robots.plant.loads import Cable, Coil, Counterbalance, Ripple, Telegraph, Wall
from excitant.robots.plant.sensors import Encoder, Recorder
from excitant.robots.plant.transmission import Transmission
from excitant.robots.plant.truth import Truth

_PAIRS = ("friction_coupling", "inertia_coupling", "sensor_crosstalk")
Numbers = Mapping[str, float]
Planter = Callable[[Truth, list[int], Numbers], Truth]


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
        if effect.kind not in PLANTERS:
            raise UnknownName("effect of a virtual arm", effect.kind, PLANTERS)
        for joint in effect.acts_on:
            if joint not in joints:
                raise UnknownName("joint", joint, joints)
        index = [joints.index(joint) for joint in effect.acts_on] or list(range(len(joints)))
        if effect.kind in _PAIRS and len(effect.acts_on) != 2:
            raise BadInput(f"virtual arm: {effect.kind} acts on two joints; give both")
        truth = PLANTERS[effect.kind](truth, index, effect.numbers())
    return truth


def _added_inertia(truth: Truth, joints: list[int], p: Numbers) -> Truth:
    model = truth.model.copy()
    for j in joints:
        added = np.array([p[name] for name in STANDARD])
        phi = model.inertias[j + 1].toDynamicParameters() + added
        model.inertias[j + 1] = pin.Inertia.FromDynamicParameters(phi)
    return replace(truth, model=model)


def _tilted(truth: Truth, joints: list[int], p: Numbers) -> Truth:
    model = truth.model.copy()
    base = pin.rpy.rpyToMatrix(p["roll"], p["pitch"], 0.0)
    model.gravity.linear = base.T @ np.array(model.gravity.linear)
    return replace(truth, model=model)


def _misplaced(truth: Truth, joints: list[int], p: Numbers) -> Truth:
    model = truth.model.copy()
    turn = pin.rpy.rpyToMatrix(p["rx"], p["ry"], p["rz"])
    for j in joints:
        T = model.jointPlacements[j + 1]
        moved = np.array(T.translation) + np.array([p["dx"], p["dy"], p["dz"]])
        model.jointPlacements[j + 1] = pin.SE3(turn @ np.array(T.rotation), moved)
    return replace(truth, model=model)


def _drive(**rows: str) -> Planter:
    """Plant parameters into rows of the drives: ``symbol=row``; velocities are set, not added."""

    def planted(truth: Truth, joints: list[int], p: Numbers) -> Truth:
        drives = {name: np.array(getattr(truth.drives, name)) for name in vars(truth.drives)}
        for symbol, row in rows.items():
            drives[row][joints] = p[symbol] + (0.0 if symbol == "velocity" else drives[row][joints])
        model = truth.model.copy()
        model.armature = np.array(drives["rotor"])
        return replace(truth, model=model, drives=type(truth.drives)(**drives))

    return planted


def _each(field: str, make: Callable[[int, Numbers], Any]) -> Planter:
    """Add one thing per joint to a field of the truth."""

    def planted(truth: Truth, joints: list[int], p: Numbers) -> Truth:
        added: dict[str, Any] = {field: (*getattr(truth, field), *(make(j, p) for j in joints))}
        return replace(truth, **added)

    return planted


def _presliding(truth: Truth, joints: list[int], p: Numbers) -> Truth:
    coulomb = np.array(truth.drives.coulomb)
    coulomb[joints] = np.maximum(coulomb[joints] - p["Fh"], 0.0)
    contacts = tuple(Presliding(j, Bristles(p["Fh"], p["distance"])) for j in joints)
    drives = replace(truth.drives, coulomb=coulomb)
    return replace(truth, drives=drives, presliding=(*truth.presliding, *contacts))


def _shaft(truth: Truth, joints: list[int], p: Numbers) -> Truth:
    shaft = CoupledShaft((joints[0], joints[1]), p["ratio"], p["Fv"], p["Fc"])
    return replace(truth, shafts=(*truth.shafts, shaft))


def _coupled_rotors(truth: Truth, joints: list[int], p: Numbers) -> Truth:
    rotors, (j, k) = np.array(truth.rotors), joints
    rotors[[j, k], [k, j]] += p["Ic"]
    return replace(truth, rotors=rotors)


def _spring(truth: Truth, joints: list[int], p: Numbers) -> Truth:
    coils = [Coil(j, p["stiffness"], p["rest"]) for j in joints if p["stiffness"]]
    cranks = [Counterbalance(j, p["moment"], p["rest"]) for j in joints if p["moment"]]
    return replace(truth, loads=(*truth.loads, *coils, *cranks))


def _gear(truth: Truth, joints: list[int], p: Numbers) -> Truth:
    for j in joints:
        if truth.drives.rotor[j] + p["motor"] <= 0:
            raise BadInput("virtual arm: an elastic joint needs inertia of its motor; give motor")
        if any(gear.joint == j for gear in truth.transmissions):
            raise BadInput("virtual arm: two elastic gears on one joint; give one, with its gap")
    gears = (
        Transmission(j, p["stiffness"], p["damping"], p.get("gap", 0.0), p["motor"]) for j in joints
    )
    return replace(truth, transmissions=(*truth.transmissions, *gears))


def _encoder(truth: Truth, joints: list[int], p: Numbers) -> Truth:
    scale, offset = np.array(truth.encoder.scale), np.array(truth.encoder.offset)
    scale[joints] *= p.get("scale", 1.0)
    offset[joints] += p.get("offset", 0.0)
    return replace(truth, encoder=Encoder(scale, offset))


def _torque_gain(truth: Truth, joints: list[int], p: Numbers) -> Truth:
    gain = np.array(truth.recorder.gain)
    gain[joints] *= p["gain"]
    return replace(truth, recorder=replace(truth.recorder, gain=gain))


def _crosstalk(truth: Truth, joints: list[int], p: Numbers) -> Truth:
    gain = np.array(truth.recorder.gain)
    gain[joints[0], joints[1]] += p["gain"]
    return replace(truth, recorder=replace(truth.recorder, gain=gain))


def _delay(truth: Truth, joints: list[int], p: Numbers) -> Truth:
    delay = np.array(truth.recorder.delay)
    delay[joints] += p["delay"]
    return replace(truth, recorder=replace(truth.recorder, delay=delay))


def _factor(truth: Truth, joints: list[int], p: Numbers) -> Truth:
    factor: dict[str, Array] = {}
    for name in ("q", "dq", "tau"):
        factor[name] = np.array(truth.recorder.factor.get(name, np.ones(truth.nv)))
        factor[name][joints] *= p[name]
    return replace(truth, recorder=Recorder(truth.recorder.gain, truth.recorder.delay, factor))


def _wall(truth: Truth, joints: list[int], p: Numbers) -> Truth:
    normal = np.array([p["nx"], p["ny"], p["nz"]])
    wall = Wall(normal / np.linalg.norm(normal), p["distance"], p["stiffness"], p["damping"])
    return replace(truth, forces=(*truth.forces, wall))


def _cable(truth: Truth, joints: list[int], p: Numbers) -> Truth:
    anchor = np.array([p["x"], p["y"], p["z"]])
    cable = Cable(anchor, p["tension"], Bristles(p["friction"], p["distance"]))
    return replace(truth, forces=(*truth.forces, cable))


PLANTERS: dict[str, Planter] = {
    "inertial_parameters": _added_inertia,
    "payload": _added_inertia,
    "gravity_direction": _tilted,
    "viscous_friction": _drive(Fv="viscous"),
    "coulomb_friction": _drive(Fc="coulomb"),
    "asymmetric_friction": _each(
        "dry",
        lambda j, p: Asymmetric(j, (p["Fc_plus"], p["Fc_minus"]), (p["Fv_plus"], p["Fv_minus"])),
    ),
    "stribeck_friction": _drive(Fs="stribeck", velocity="stribeck_velocity"),
    "nonlinear_viscous_friction": _each("dry", lambda j, p: PowerLaw(j, p["Fn"], p["exponent"])),
    "load_dependent_friction": _each("dry", lambda j, p: LoadDependent(j, p["Fl"])),
    "presliding_hysteresis": _presliding,
    "friction_coupling": _shaft,
    "thermal_friction_drift": _each("dry", lambda j, p: Warming(j, p["Fc"], p["Fv"], p["time"])),
    "rotor_inertia": _drive(Ia="rotor"),
    "inertia_coupling": _coupled_rotors,
    "torque_offset": _drive(offset="offset"),
    "torque_gain": _torque_gain,
    "torque_ripple": _each("loads", lambda j, p: Ripple(j, p["amplitude"], p["order"], p["phase"])),
    "spring": _spring,
    "joint_elasticity": _gear,
    "backlash": _gear,
    "time_delay": _delay,
    "encoder_offset": _encoder,
    "encoder_scale": _encoder,
    "kinematic_error": _misplaced,
    "wrong_sign": _factor,
    "wrong_unit": _factor,
    "wall_contact": _wall,
    "cable_pull": _cable,
    "telegraph_torque": _each("loads", lambda j, p: Telegraph(j, p["amplitude"], p["rate"])),
    "sensor_crosstalk": _crosstalk,
}
