"""What a file format cannot say of a model, in sentences."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from excitant.identify.export.bodies import Tree, held_kinds
from excitant.robots.effects import plain

_LIMITED = ("urdf", "mjcf", "sdf")  # formats that hold some effects only
_COMMON_GRAVITY = (0.0, 0.0, -9.81)


def not_held(arm: Tree, file_format: str) -> tuple[str, ...]:
    """What is left out of a file of one format, or means something else there.

    Args:
        arm: The model.
        file_format: ``"urdf"``, ``"mjcf"`` or ``"sdf"``; nothing is left out of the others.
    """
    if file_format not in _LIMITED:
        return ()
    found = []
    for kind in held_kinds():
        values = {body.joint: getattr(body, kind.joint_property) for body in arm.bodies}
        joints = [joint for joint, value in values.items() if value]
        lower = min(term.lower for term in kind.terms)
        negative = [joint for joint, value in values.items() if value < lower]
        if joints and file_format not in kind.formats:
            found.append(f"not in this file: {plain(kind.name)} of {_listed(arm, joints)}")
        elif negative:
            found.append(f"not in this file: negative {plain(kind.name)} of {', '.join(negative)}")
        elif joints and file_format in kind.format_notes:
            found.append(kind.format_notes[file_format])
    if file_format == "sdf" and not np.allclose(arm.gravity, _COMMON_GRAVITY):
        found.append("gravity is that of the world, which Drake wants to be told in code")
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
