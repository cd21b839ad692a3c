"""Effects of the drives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from excitant.robots.effects import experiments as by
from excitant.robots.effects.base import PairEffect, Parameter, StandardEffect
from excitant.robots.motion import Array, Motion
from excitant.robots.robot import Robot


@dataclass(frozen=True)
class RotorInertia(StandardEffect):
    """τ = I_a q̈: rotor and gear inertia at the joint side."""

    name = "rotor_inertia"
    family = "body"
    terms = (Parameter("Ia", "kg·m²", 0.0),)
    abscissa = "acceleration"
    joint_property = "rotor"
    formats = ("mjcf", "sdf")
    format_notes: ClassVar[Mapping[str, str]] = {
        "sdf": "rotor inertia is written as drake:rotor_inertia, which Drake reads and Gazebo "
        "passes over"
    }
    told = (
        (
            "move the joint with the outer joints folded and stretched; for a first "
            "joint, and those parallel to it, only the data sheet tells",
            "inertial_parameters",
        ),
        (f"find the resonance by a chirp; {by.LOCKED}", "joint_elasticity"),
        ("hold the joint at several angles: a spring pulls at rest, inertia does not", "spring"),
        (by.HOLD_OTHER, "inertia_coupling"),
        (f"{by.LEVER}; {by.DATA_SHEET}", "torque_gain"),
        (by.UNLOADED, "payload"),
        (by.SECOND, "time_delay torque_ripple"),
        (by.DATA_SHEET, "kinematic_error"),
    )

    def of_state(self, q: Array, dq: Array, ddq: Array) -> Sequence[Array]:
        """Acceleration."""
        return (ddq,)


@dataclass(frozen=True)
class TorqueOffset(StandardEffect):
    """τ = τ_0: constant torque, current-sensor offset or asymmetric Coulomb friction."""

    name = "torque_offset"
    family = "static"
    terms = (Parameter("offset", "N·m"),)
    needs_motion = False
    abscissa = "time"
    joint_property = "offset"
    formats = ("mjcf",)
    format_notes: ClassVar[Mapping[str, str]] = {
        "mjcf": "torque offsets are the bias of the actuators: they act on controls, and are not "
        "part of what mj_inverse returns"
    }
    told = (
        (
            "repeat the motion in another posture: an offset does not turn with gravity",
            "inertial_parameters",
        ),
        ("repeat the motion without the load: an offset stays", "payload"),
        (by.STATIC, "spring torque_ripple"),
        (f"{by.TURNED}: an offset stays, tilt turns along", "gravity_direction"),
        (f"{by.ZERO}; {by.UNPOWERED}", "encoder_offset"),
    )

    def of_state(self, q: Array, dq: Array, ddq: Array) -> Sequence[Array]:
        """One."""
        return (np.ones_like(dq),)


@dataclass(frozen=True)
class InertiaCoupling(PairEffect):
    """τ_i = I q̈_k, τ_k = I q̈_i: a rotor that turns with both joints."""

    name = "inertia_coupling"
    family = "body"
    terms = (Parameter("Ic", "kg·m²"),)
    abscissa = "other acceleration"

    def columns(self, robot: Robot, motion: Motion) -> Array:
        """Each joint's acceleration in the other's row."""
        i, k = self.rows(robot)
        columns = np.zeros((len(motion), robot.nv, 1))
        columns[:, i, 0], columns[:, k, 0] = motion.ddq[:, k], motion.ddq[:, i]
        return columns
