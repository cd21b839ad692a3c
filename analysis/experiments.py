"""Which action tells two causes apart where no motion of the arm as it stands does."""

from __future__ import annotations

from collections.abc import Iterable

_AT_REST = "read the torque at rest after approaching one pose from both sides"
_LADDER = "move the joint at several constant speeds, 0.1 to 100 % of its limit, both directions"
_UNPOWERED = "read the torque with the motor unpowered, at rest and turned by hand"
_LOADS = "repeat the motion with a known payload"
_WARM = "repeat the first motion after half an hour of warming up"
_TURNED = "repeat the motion with the first joint turned by half a turn (q1 + π)"
_REVERSALS = "reverse the joint within tiny amplitudes, under gravity's load and without it"
_LOCKED = "lock the output and load it statically in both directions while reading the encoder"
_DATA_SHEET = "take rotor inertia and gear ratio from the data sheet"
_CURRENT = "log the motor's true current, and drive the joint back unpowered"
_SPEEDS = "repeat the same path at a third of the speed"
_HOLD_OTHER = "move one of the two joints while the other is held, then the other way round"
_UNLOADED = "repeat the motion with and without the load and subtract"
_KINEMATICS = "measure poses of the tip (kinematic calibration) before fitting torque"
_WEIGH = "weigh the link, or hang a known mass on it and repeat"
_LEVEL = "put a spirit level on the base"
_ZERO = "move the joint to its mechanical zero mark and compare with the encoder's reading"
_STATIC = "hold the joint at several angles, each approached from both sides"
_SECOND = "repeat the motion at another frequency"
_ORDERS = "turn the joint slowly at two constant speeds and at two loads and track the orders"
_CLOCK = "record a sharp torque step with one clock for torque and encoder"
_LEVER = "hang a known mass at a known lever on the joint"

_PAIRS: dict[str, dict[str, str]] = {
    "viscous_friction": {
        "coulomb_friction": _LADDER,
        "stribeck_friction": _LADDER,
        "nonlinear_viscous_friction": _LADDER,
        "time_delay": _SPEEDS,
        "thermal_friction_drift": _WARM,
        "asymmetric_friction": _LADDER,
        "torque_gain": _CURRENT,
        "load_dependent_friction": _LOADS,
        "friction_coupling": _HOLD_OTHER,
        "encoder_scale": _KINEMATICS,
    },
    "coulomb_friction": {
        "stribeck_friction": _LADDER,
        "torque_offset": _AT_REST,
        "asymmetric_friction": _AT_REST,
        "presliding_hysteresis": _REVERSALS,
        "load_dependent_friction": _LOADS,
        "backlash": _REVERSALS,
        "friction_coupling": _HOLD_OTHER,
        "thermal_friction_drift": _WARM,
        "nonlinear_viscous_friction": _LADDER,
    },
    "asymmetric_friction": {
        "torque_offset": _AT_REST + ", and once with the motor unpowered",
        "stribeck_friction": _LADDER,
        "nonlinear_viscous_friction": _LADDER,
        "load_dependent_friction": _LOADS,
        "thermal_friction_drift": _WARM,
        "friction_coupling": _HOLD_OTHER,
    },
    "stribeck_friction": {
        "nonlinear_viscous_friction": _LADDER,
        "presliding_hysteresis": _REVERSALS,
        "load_dependent_friction": f"{_LADDER}, at two payloads",
        "backlash": _REVERSALS,
        "time_delay": _SPEEDS,
        "torque_offset": _AT_REST,
        "friction_coupling": _HOLD_OTHER,
        "thermal_friction_drift": _WARM,
    },
    "load_dependent_friction": {
        "torque_gain": "repeat the motion backwards in time: friction turns its sign, a gain does "
        "not; then with a known payload",
        "presliding_hysteresis": f"{_REVERSALS}, at two payloads",
        "backlash": _REVERSALS,
        "nonlinear_viscous_friction": f"{_LADDER}, at two payloads",
        "friction_coupling": _HOLD_OTHER,
    },
    "presliding_hysteresis": {
        "backlash": _REVERSALS,
        "time_delay": _SPEEDS,
        "joint_elasticity": _LOCKED,
    },
    "friction_coupling": {"inertia_coupling": _HOLD_OTHER},
    "rotor_inertia": {
        "inertial_parameters": "move the joint with the outer joints folded and stretched; for a "
        "first joint, and those parallel to it, only the data sheet tells",
        "joint_elasticity": f"find the resonance by a chirp; {_LOCKED}",
        "spring": "hold the joint at several angles: a spring pulls at rest, inertia does not",
        "inertia_coupling": _HOLD_OTHER,
        "torque_gain": f"{_LEVER}; {_DATA_SHEET}",
        "payload": _UNLOADED,
        "time_delay": _SECOND,
        "kinematic_error": _DATA_SHEET,
        "torque_ripple": _SECOND,
    },
    "torque_offset": {
        "inertial_parameters": "repeat the motion in another posture: an offset does not turn "
        "with gravity",
        "payload": "repeat the motion without the load: an offset stays",
        "spring": _STATIC,
        "gravity_direction": f"{_TURNED}: an offset stays, tilt turns along",
        "encoder_offset": f"{_ZERO}; {_UNPOWERED}",
        "torque_ripple": _STATIC,
    },
    "torque_gain": {
        "inertial_parameters": f"{_LOADS}: a gain scales its torque too",
        "payload": f"{_LOADS} beside the unknown one",
        "gravity_direction": f"{_LEVEL}; {_LOADS}",
        "spring": _LEVER,
        "kinematic_error": f"{_LOADS}; {_KINEMATICS}",
        "encoder_scale": _KINEMATICS,
        "encoder_offset": f"{_ZERO}; {_LOADS}",
    },
    "torque_ripple": {
        "spring": _STATIC,
        "encoder_offset": _ZERO,
        "joint_elasticity": _ORDERS,
        "backlash": _ORDERS,
        "inertial_parameters": _STATIC,
        "payload": _UNLOADED,
    },
    "spring": {
        "inertial_parameters": f"{_UNPOWERED}; or tilt the base: gravity's part turns, a "
        "spring's stays",
        "payload": _UNLOADED,
        "gravity_direction": f"{_TURNED}: a spring's torque stays",
        "encoder_offset": _ZERO,
        "joint_elasticity": _LOCKED,
        "encoder_scale": _ZERO,
    },
    "joint_elasticity": {
        "backlash": f"{_LOCKED}: play yields at once, a spring in proportion",
        "time_delay": f"{_LOCKED}; {_CLOCK}",
        "encoder_offset": _LOCKED,
        "encoder_scale": _LOCKED,
        "inertial_parameters": _LOCKED,
        "payload": _UNLOADED,
    },
    "backlash": {"time_delay": _SPEEDS},
    "time_delay": {
        "inertial_parameters": _SPEEDS,
        "encoder_scale": _SPEEDS,
        "thermal_friction_drift": _WARM,
    },
    "encoder_offset": {
        "inertial_parameters": f"{_ZERO}; the last joint's offset is a turned last link",
        "payload": f"{_ZERO}; or {_UNLOADED}",
        "gravity_direction": f"{_TURNED}: tilt's phase follows q1, an encoder's offset does not",
        "kinematic_error": _KINEMATICS,
        "encoder_scale": f"{_ZERO}, and at the far end of its range",
    },
    "encoder_scale": {"inertial_parameters": _KINEMATICS, "kinematic_error": _KINEMATICS},
    "kinematic_error": {
        "inertial_parameters": f"{_KINEMATICS}; or repeat the motion in another pose region",
        "payload": _UNLOADED,
        "gravity_direction": f"{_LEVEL}; {_KINEMATICS}",
    },
    "gravity_direction": {
        "inertial_parameters": f"{_LEVEL}; or turn the first joint slowly with the arm stretched",
        "payload": f"{_UNLOADED}; {_LEVEL}",
    },
    "payload": {"inertial_parameters": _UNLOADED},
}
_EXPERIMENTS = {
    frozenset((one, other)): action for one, row in _PAIRS.items() for other, action in row.items()
}
_FAMILIES: dict[str, tuple[str, ...]] = {
    "friction": (
        "viscous_friction", "coulomb_friction", "asymmetric_friction", "stribeck_friction",
        "nonlinear_viscous_friction", "load_dependent_friction", "presliding_hysteresis",
        "friction_coupling", "thermal_friction_drift",
    ),
    "body": ("inertial_parameters", "payload", "rotor_inertia", "inertia_coupling"),
    "static": ("torque_offset", "spring", "torque_ripple", "gravity_direction"),
    "transmission": ("joint_elasticity", "backlash"),
    "geometry": ("encoder_offset", "encoder_scale", "kinematic_error"),
    "reading": ("torque_gain", "time_delay"),
}  # fmt: skip
_BETWEEN = {
    frozenset(("friction",)): f"{_LADDER}, then {_WARM}",
    frozenset(("body",)): _WEIGH,
    frozenset(("static",)): f"{_STATIC}; {_LEVEL}",
    frozenset(("transmission",)): _LOCKED,
    frozenset(("geometry",)): _KINEMATICS,
    frozenset(("reading",)): f"{_CLOCK}; {_LOADS}",
    frozenset(("friction", "body")): "repeat the motion backwards in time: friction turns its "
    "sign, inertia and gravity do not",
    frozenset(("friction", "static")): _AT_REST,
    frozenset(("friction", "transmission")): _LOCKED,
    frozenset(("friction", "geometry")): "repeat the motion backwards in time: friction turns its "
    "sign, an error of position does not",
    frozenset(("friction", "reading")): _SPEEDS,
    frozenset(("body", "static")): _SPEEDS,
    frozenset(("body", "transmission")): _LOCKED,
    frozenset(("body", "geometry")): f"{_KINEMATICS}; {_WEIGH}",
    frozenset(("body", "reading")): _LOADS,
    frozenset(("static", "transmission")): _LOCKED,
    frozenset(("static", "geometry")): _ZERO,
    frozenset(("static", "reading")): _LEVER,
    frozenset(("transmission", "geometry")): _LOCKED,
    frozenset(("transmission", "reading")): f"{_LOCKED}; {_CLOCK}",
    frozenset(("geometry", "reading")): f"{_KINEMATICS}; {_LOADS}",
}
_SAME = "hold one of the joints in question and move the others, then the other way round"
_GENERAL = "repeat with a motion that moves this joint faster, slower and in other postures"


def experiment(one: str, other: str) -> str:
    """What to do to tell two effects apart, by their names."""
    if one == other:
        return _SAME
    known = _EXPERIMENTS.get(frozenset((one, other)))
    return known or _BETWEEN.get(frozenset(_families((one, other))), _GENERAL)


def _families(names: Iterable[str]) -> list[str]:
    return [family for name in names for family, members in _FAMILIES.items() if name in members]
