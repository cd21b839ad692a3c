"""What the actuators of an MJCF file can give, joint by joint."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from excitant.robots.mjcf_document import Document
from excitant.robots.motion import Array

_NONE = (-np.inf, np.inf)
_PLAIN = ("general", "motor")  # whose force is a gain times the control


@dataclass(frozen=True)
class JointActuation:
    """What drives a joint.

    Attributes:
        forces: Lowest and highest torque of each of its actuators, shape (k, 2) [N·m or N].
        armature: Rotor inertia of all at the joint [kg·m² or kg].
        damping: Viscous friction of all at the joint [N·m·s/rad or N·s/m].
    """

    forces: tuple[tuple[float, float], ...] = ()
    armature: float = 0.0
    damping: float = 0.0

    def effort(self, document: Document, joint: Mapping[str, str]) -> float:
        """Torque limit as a URDF has it, zero for none: what both directions can have."""
        low, high = np.sum(self.forces, axis=0) if self.forces else np.array(_NONE)
        at_joint = _range(document, joint, "actuatorfrcrange", "actuatorfrclimited")
        low, high = max(low, at_joint[0]), min(high, at_joint[1])
        limit = float(min(-low, high))
        return limit if np.isfinite(limit) and limit > 0 else 0.0


def actuation(document: Document) -> dict[str, JointActuation]:
    """What drives each joint that actuators name; tendons and sites are left out."""
    found: dict[str, JointActuation] = {}
    for section in document.root.findall("actuator"):
        for element in section:
            given = document.attributes(element)
            joint = given.get("joint", given.get("jointinparent"))
            if joint is None:
                continue
            size = document.numbers(given, "gear", (1.0,), at_most=6)
            gear = float(size[0])
            known = found.get(joint, JointActuation())
            found[joint] = JointActuation(
                (*known.forces, _torques(document, element.tag, given, gear)),
                known.armature + gear**2 * document.number(given, "armature"),
                known.damping
                + gear**2 * float(document.numbers(given, "damping", (0.0,), at_most=3)[0]),
            )
    return found


def _torques(
    document: Document, tag: str, given: Mapping[str, str], gear: float
) -> tuple[float, float]:
    """Lowest and highest torque of one actuator at its joint."""
    limits = np.array(_range(document, given, "forcerange", "forcelimited"))
    affine = given.get("biastype", "none") != "none" or given.get("gaintype", "fixed") != "fixed"
    dynamic = given.get("dyntype", "none") not in ("none", "filter", "filterexact")
    if tag in _PLAIN and not affine and not dynamic:
        gain = 1.0
        if tag == "general":
            gain = float(document.numbers(given, "gainprm", (1.0,), at_most=10)[0])
        control = np.array(_range(document, given, "ctrlrange", "ctrllimited"))
        reach = np.sort(gain * control) if gain else np.zeros(2)
        limits = np.array([max(limits[0], reach[0]), min(limits[1], reach[1])])
    at_joint: Array = np.sort(gear * limits) if gear else np.zeros(2)
    return float(at_joint[0]), float(at_joint[1])


def _range(
    document: Document, given: Mapping[str, str], key: str, switch: str
) -> tuple[float, float]:
    """A range that is in force, else an infinite one."""
    said = given.get(switch, "auto")
    automatic = document.compiler.get("autolimits", "true") == "true"
    if key not in given or said == "false" or (said == "auto" and not automatic):
        return _NONE
    low, high = document.numbers(given, key, (0.0, 0.0)).tolist()
    return (low, high) if low < high else _NONE
