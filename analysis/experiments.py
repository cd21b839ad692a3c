"""Which experiment tells two causes apart."""

from __future__ import annotations

_EXPERIMENTS = {
    frozenset(("viscous_friction", "coulomb_friction")): (
        "move the joint at several constant speeds, 1 to 100 % of its limit, both directions"
    ),
    frozenset(("coulomb_friction", "stribeck_friction")): (
        "move the joint at several constant speeds, 0.1 to 100 % of its limit, both directions"
    ),
    frozenset(("viscous_friction", "stribeck_friction")): (
        "move the joint at several constant speeds, 0.1 to 100 % of its limit, both directions"
    ),
    frozenset(("coulomb_friction", "torque_offset")): (
        "read the torque at rest after approaching one pose from both sides"
    ),
    frozenset(("torque_offset", "stribeck_friction")): (
        "read the torque at rest after approaching one pose from both sides"
    ),
    frozenset(("rotor_inertia", "inertial_parameters")): (
        "move the joint with the outer joints folded and stretched; for a first joint only the "
        "data sheet tells"
    ),
    frozenset(("payload", "inertial_parameters")): (
        "repeat the motion with and without the load and subtract"
    ),
    frozenset(("torque_offset", "inertial_parameters")): (
        "repeat the motion in another posture: an offset does not turn with gravity"
    ),
    frozenset(("torque_offset", "payload")): (
        "repeat the motion without the load: an offset stays"
    ),
}
_GENERAL = "repeat with a motion that moves this joint faster, slower and in other postures"


def experiment(one: str, other: str) -> str:
    """What to do to tell two effects apart, by their names."""
    return _EXPERIMENTS.get(frozenset((one, other)), _GENERAL)
