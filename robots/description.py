"""A robot as text, and what the text cannot hold."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Description:
    """A robot as text, and what the text cannot hold.

    Attributes:
        urdf: The URDF.
        gravity: Gravity in the root's frame, shape (3,) [m/s²].
        armature: Rotor inertia at the joint by joint [kg·m² or kg].
        springs: Stiffness and rest position by joint [N·m/rad and rad, or N/m and m].
        lock: Joints that the description holds, and where [rad or m].
        loops: Pairs of links that a constraint ties together.
        notes: What was left out.
    """

    urdf: str
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)
    armature: Mapping[str, float] = field(default_factory=dict)
    springs: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    lock: Mapping[str, float] = field(default_factory=dict)
    loops: tuple[tuple[str, str], ...] = ()
    notes: tuple[str, ...] = ()
