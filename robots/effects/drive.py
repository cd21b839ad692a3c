"""Effects of the drives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from excitant.robots.effects.base import JointEffect, Term
from excitant.robots.effects.experiments import (
    DATA_SHEET,
    HOLD_OTHER,
    LEVER,
    LOCKED,
    SECOND,
    STATIC,
    TURNED,
    UNLOADED,
    UNPOWERED,
    ZERO,
)
from excitant.robots.motion import Array


@dataclass(frozen=True)
class RotorInertia(JointEffect):
    """τ = I_a q̈: rotor and gear inertia at the joint side."""

    name: ClassVar[str] = "rotor_inertia"
    family: ClassVar[str] = "body"
    terms: ClassVar[tuple[Term, ...]] = (Term("Ia", "kg·m²", 0.0),)
    standard: ClassVar[bool] = True
    usual: ClassVar[bool] = True
    further: ClassVar[bool] = False
    abscissa: ClassVar[str] = "acceleration"
    joint_property: ClassVar[str] = "rotor"
    formats: ClassVar[tuple[str, ...]] = ("mjcf", "sdf")
    format_notes: ClassVar[Mapping[str, str]] = {
        "sdf": "rotor inertia is written as drake:rotor_inertia, which Drake reads and Gazebo "
        "passes over"
    }
    told: ClassVar[Mapping[str, str]] = {
        "inertial_parameters": "move the joint with the outer joints folded and stretched; for a "
        "first joint, and those parallel to it, only the data sheet tells",
        "joint_elasticity": f"find the resonance by a chirp; {LOCKED}",
        "spring": "hold the joint at several angles: a spring pulls at rest, inertia does not",
        "inertia_coupling": HOLD_OTHER,
        "torque_gain": f"{LEVER}; {DATA_SHEET}",
        "payload": UNLOADED,
        "time_delay": SECOND,
        "kinematic_error": DATA_SHEET,
        "torque_ripple": SECOND,
    }

    def of_state(self, q: Array, dq: Array, ddq: Array) -> Sequence[Array]:
        """Acceleration."""
        return (ddq,)


@dataclass(frozen=True)
class TorqueOffset(JointEffect):
    """τ = τ_0: constant torque, current-sensor offset or asymmetric Coulomb friction."""

    name: ClassVar[str] = "torque_offset"
    family: ClassVar[str] = "static"
    terms: ClassVar[tuple[Term, ...]] = (Term("offset", "N·m"),)
    standard: ClassVar[bool] = True
    usual: ClassVar[bool] = True
    further: ClassVar[bool] = False
    needs_motion: ClassVar[bool] = False
    abscissa: ClassVar[str] = "time"
    joint_property: ClassVar[str] = "offset"
    formats: ClassVar[tuple[str, ...]] = ("mjcf",)
    format_notes: ClassVar[Mapping[str, str]] = {
        "mjcf": "torque offsets are the bias of the actuators: they act on controls, and are not "
        "part of what mj_inverse returns"
    }
    told: ClassVar[Mapping[str, str]] = {
        "inertial_parameters": "repeat the motion in another posture: an offset does not turn "
        "with gravity",
        "payload": "repeat the motion without the load: an offset stays",
        "spring": STATIC,
        "gravity_direction": f"{TURNED}: an offset stays, tilt turns along",
        "encoder_offset": f"{ZERO}; {UNPOWERED}",
        "torque_ripple": STATIC,
    }

    def of_state(self, q: Array, dq: Array, ddq: Array) -> Sequence[Array]:
        """One."""
        return (np.ones_like(dq),)
