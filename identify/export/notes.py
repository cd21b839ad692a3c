"""What a file format cannot say of a model, in sentences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from excitant.identify.export.bodies import Tree

_HOLDS: Mapping[str, tuple[str, ...]] = {
    "urdf": ("viscous", "coulomb"),
    "mjcf": ("viscous", "coulomb", "rotor", "offset"),
    "sdf": ("viscous", "coulomb", "rotor"),
}
_COMMON_GRAVITY = (0.0, 0.0, -9.81)
_WORDS = {
    "viscous": "viscous friction",
    "coulomb": "Coulomb friction",
    "rotor": "rotor inertia",
    "offset": "torque offset",
}
_OWN_TERMS = {
    "mjcf": {
        "coulomb": "frictionloss is a soft constraint: it has its full value, against the motion, "
        "once a joint slides, and turns with the velocity within some milliseconds",
        "offset": "torque offsets are the bias of the actuators: they act on controls, and are "
        "not part of what mj_inverse returns",
    },
    "sdf": {"rotor": "rotor inertia is written as drake:rotor_inertia, which Drake reads and "
            "Gazebo passes over"},
}  # fmt: skip


def not_held(arm: Tree, file_format: str) -> tuple[str, ...]:
    """What is left out of a file of one format, or means something else there.

    Args:
        arm: The model.
        file_format: ``"urdf"``, ``"mjcf"`` or ``"sdf"``; nothing is left out of the others.
    """
    holds = _HOLDS.get(file_format, tuple(_WORDS))
    found = []
    for term, words in _WORDS.items():
        joints = [body.joint for body in arm.bodies if getattr(body, term)]
        negative = [b.joint for b in arm.bodies if getattr(b, term) < 0 and term != "offset"]
        if joints and term not in holds:
            found.append(f"not in this file: {words} of {_listed(arm, joints)}")
        elif negative and file_format in _HOLDS:
            found.append(f"not in this file: negative {words} of {', '.join(negative)}")
        elif joints and term in _OWN_TERMS.get(file_format, {}):
            found.append(_OWN_TERMS[file_format][term])
    if file_format == "sdf" and not np.allclose(arm.gravity, _COMMON_GRAVITY):
        found.append("gravity is that of the world, which Drake wants to be told in code")
    if file_format in _HOLDS:
        for effect in arm.others:
            found.append(f"not in this file: {effect.name} of {_listed(arm, effect.joints)}")
    return tuple(found)


def as_comment(sentences: tuple[str, ...], complete: str) -> str:
    """Sentences as the text of an XML comment, which must not hold two dashes.

    Args:
        sentences: What `not_held` gives.
        complete: File that has everything, to point to.
    """
    lines = ["identified by excitant", *sentences]
    if any(sentence.startswith("not in") for sentence in sentences):
        lines.append(f"{complete} holds everything")
    text = "\n    ".join(("", *lines))
    while "--" in text:
        text = text.replace("--", "- -")
    return f"{text}\n  "


def _listed(arm: Tree, joints: Sequence[str]) -> str:
    return "all joints" if len(joints) == len(arm.bodies) else ", ".join(joints)
