"""What the equality constraints of an MJCF file tie together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from excitant.robots.mjcf_document import Document


@dataclass(frozen=True)
class Equalities:
    """Constraints between joints and between bodies.

    Attributes:
        followers: Joint each follows, offset and multiplier, by joint.
        fixed: Joints held in place, and where [rad or m].
        ties: Pairs of bodies that are tied together.
        notes: What was left out.
    """

    followers: Mapping[str, tuple[str, float, float]]
    fixed: Mapping[str, float]
    ties: tuple[tuple[str, str], ...]
    notes: tuple[str, ...]


def equalities(document: Document) -> Equalities:
    """Constraints in force.

    MuJoCo measures joints in a constraint from their reference positions, and angles are always
    in radians.
    """
    references = _references(document)
    followers: dict[str, tuple[str, float, float]] = {}
    fixed: dict[str, float] = {}
    ties: list[tuple[str, str]] = []
    notes: list[str] = []
    for section in document.root.findall("equality"):
        for element in section:
            given = document.attributes(element)
            if given.get("active", "true") == "false":
                continue
            if element.tag == "joint" and "joint1" in given:
                follower, master = given["joint1"], given.get("joint2")
                values = document.numbers(given, "polycoef", (0.0,), at_most=5).tolist()
                values += [0.0, 1.0, 0.0, 0.0, 0.0][len(values) :]
                offset, slope = references.get(follower, 0.0) + values[0], values[1]
                if master is None:
                    fixed[follower] = offset
                    continue
                if np.any(values[2:]):
                    notes.append(f"joint {follower} follows {master} on a curve, taken as a line")
                followers[follower] = (master, offset - slope * references.get(master, 0.0), slope)
            elif element.tag in ("connect", "weld") and "body1" in given:
                ties.append((given["body1"], given.get("body2", "world")))
            else:
                notes.append(f"equality <{element.tag}> is left out")
    return Equalities(followers, fixed, tuple(ties), tuple(notes))


def _references(document: Document) -> dict[str, float]:
    """Reference position of each named joint [rad or m]."""
    found = {}
    for world in document.root.findall("worldbody"):
        for joint in world.iter("joint"):
            given = document.attributes(joint)
            if name := given.get("name"):
                value = document.number(given, "ref")
                hinge = given.get("type", "hinge") == "hinge"
                found[name] = document.angle(value) if hinge else value
    return found
