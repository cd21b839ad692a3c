"""Actions that separate two effects where no motion of the arm as it stands does."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from excitant.robots.effects.base import Effect

AT_REST = "read the torque at rest after approaching one pose from both sides"
LADDER = "move the joint at several constant speeds, 0.1 to 100 % of its limit, both directions"
UNPOWERED = "read the torque with the motor unpowered, at rest and turned by hand"
LOADS = "repeat the motion with a known payload"
WARM = "repeat the first motion after half an hour of warming up"
TURNED = "repeat the motion with the first joint turned by half a turn (q1 + π)"
REVERSALS = (
    "reverse the joint within tiny amplitudes, under gravity's load and without it"
)
LOCKED = "lock the output and load it statically in both directions while reading the encoder"
DATA_SHEET = "take rotor inertia and gear ratio from the data sheet"
CURRENT = "log the motor's true current, and drive the joint back unpowered"
SPEEDS = "repeat the same path at a third of the speed"
HOLD_OTHER = (
    "move one of the two joints while the other is held, then the other way round"
)
UNLOADED = "repeat the motion with and without the load and subtract"
KINEMATICS = (
    "measure poses of the tip (kinematic calibration) before fitting torque"
)
LEVEL = "put a spirit level on the base"
ZERO = "move the joint to its mechanical zero mark and compare with the encoder's reading"
STATIC = "hold the joint at several angles, each approached from both sides"
SECOND = "repeat the motion at another frequency"
ORDERS = "turn the joint slowly at two constant speeds and at two loads and track the orders"
CLOCK = "record a sharp torque step with one clock for torque and encoder"
LEVER = "hang a known mass at a known lever on the joint"
SAME = "hold one of the joints in question and move the others, then the other way round"
GENERAL = "repeat with a motion that moves this joint faster, slower and in other postures"
BACKWARDS = "repeat the motion backwards in time: friction turns its sign"
POSTURE = "repeat the motion in another posture"
STRETCHED = "turn the first joint slowly with the arm stretched"
TILTED = "tilt the base: gravity's part turns"
FOLDED = (
    "move the joint with the outer joints folded and stretched; for a first joint, and those "
    "parallel to it, only the data sheet decides"
)
_WEIGH = "weigh the link, or hang a known mass on it and repeat"

SEEN = "move each joint alone by a quarter turn and compare the arm with a picture of its model"
BETWEEN = {  # families of two effects that say nothing of each other in their words
    frozenset(pair): action
    for pair, action in {
        ("friction",): f"{LADDER}, then {WARM}",
        ("body",): _WEIGH,
        ("static",): f"{STATIC}; {LEVEL}",
        ("transmission",): LOCKED,
        ("geometry",): KINEMATICS,
        ("reading",): f"{CLOCK}; {LOADS}",
        ("friction", "body"): f"{BACKWARDS}, inertia and gravity do not",
        ("friction", "static"): AT_REST,
        ("friction", "transmission"): LOCKED,
        ("friction", "geometry"): f"{BACKWARDS}, an error of position does not",
        ("friction", "reading"): SPEEDS,
        ("body", "static"): SPEEDS,
        ("body", "transmission"): LOCKED,
        ("body", "geometry"): f"{KINEMATICS}; {_WEIGH}",
        ("body", "reading"): LOADS,
        ("static", "transmission"): LOCKED,
        ("static", "geometry"): ZERO,
        ("static", "reading"): LEVER,
        ("transmission", "geometry"): LOCKED,
        ("transmission", "reading"): f"{LOCKED}; {CLOCK}",
        ("geometry", "reading"): f"{KINEMATICS}; {LOADS}",
        ("set-up",): SEEN,
        ("set-up", "geometry"): SEEN,
        ("set-up", "static"): SEEN,
    }.items()
}


def measuring_experiment(effect: Effect) -> str:
    """Experiment that shows an effect by itself, whatever else there is."""
    return BETWEEN[frozenset((effect.family,))]


def separating_experiment(
    one: Effect | type[Effect], other: Effect | type[Effect]
) -> str:
    """Experiment that tells one effect from another; a general one where none is known."""
    if one.name == other.name:
        return SAME
    for effect, rival in ((one, other), (other, one)):
        for rivals, experiment in effect.words.separated_by.items():
            if rival.name in rivals.split():
                return experiment
    return BETWEEN.get(frozenset((one.family, other.family)), GENERAL)
