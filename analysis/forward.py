"""How far models leave the recorded motion when the recorded torque drives them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from excitant.analysis.diagnosis import Diagnosis
from excitant.exceptions import BadInput
from excitant.identify.preprocessing import Segment
from excitant.robots.effects import (
    AddedInertia,
    Effect,
    FrictionCoupling,
    GravityDirection,
    InertiaCoupling,
    JointwiseEffect,
)
from excitant.robots.motion import Array, Motion, freeze
from excitant.robots.robot import Robot
from excitant.robots.simulation import LOOP_HZ, Diverged, forward_error
from excitant.robots.state_torque import forward_model

_WINDOW = 0.6  # s: fifteen time constants of the loop that holds a model
_WINDOWS = 4  # at least, spread over the hold-out, where it is long enough
_COARSE = 2e-3  # s: longest step of integration, a twentieth of that time constant
_OF_STATE = (AddedInertia, FrictionCoupling, GravityDirection, InertiaCoupling, JointwiseEffect)


@dataclass(frozen=True, eq=False)
class Simulated:
    """A model simulated forward over windows of the hold-out.

    Attributes:
        position: Rms error of position per joint, shape (nv,) [rad or m]; NaN where it diverges.
        velocity: Rms error of velocity per joint, shape (nv,) [rad/s or m/s].
        diverged: Why the simulation was given up, empty when it was not.
        along: Effects whose torque was taken on the recorded motion: those of sensors, and those
            that depend on the past.
    """

    position: Array
    velocity: Array
    diverged: str
    along: tuple[str, ...]

    def __post_init__(self) -> None:
        freeze(self, "position", "velocity")


@dataclass(frozen=True, eq=False)
class Forward:
    """The given and the extended model, simulated alike.

    Attributes:
        given: The given model.
        extended: The extended model.
        windows: Number of windows.
        seconds: Length of each [s].
        bandwidth_hz: Of the loop that holds both on the recorded motion [Hz].
    """

    given: Simulated
    extended: Simulated
    windows: int
    seconds: float
    bandwidth_hz: float


def forward(diagnosis: Diagnosis) -> Forward:
    """Simulate both models forward over short windows of the hold-out.

    The recorded torque drives each of them, and one slow loop holds both on the recorded motion
    (`excitant.robots.simulation.forward_error`).
    """
    found = windows(diagnosis.data.validate)
    return Forward(
        given=_simulated(diagnosis.robot, diagnosis.gains, found),
        extended=_simulated(diagnosis.extension.model, diagnosis.gains, found),
        windows=len(found),
        seconds=float(np.mean([motion.t[-1] - motion.t[0] for motion, _ in found])),
        bandwidth_hz=LOOP_HZ,
    )


def windows(segments: Sequence[Segment]) -> list[tuple[Motion, Array]]:
    """Motion and torque of short stretches spread over segments, the filter's edges left out."""
    longest = sorted(segments, key=lambda s: -len(s.motion))[:_WINDOWS]
    each = -(-_WINDOWS // len(longest))
    found = []
    for s in longest:
        first, stop, _ = s.keep.indices(len(s.motion))
        size = min(round(_WINDOW * s.rate_hz) + 1, stop - first)
        count = max(1, min(each, (stop - first) // size))
        for start in np.linspace(first, stop - size, count).astype(int):
            part = slice(int(start), int(start) + size)
            found.append((s.motion[part], s.tau[part]))
    return found


def _simulated(robot: Robot, gains: Array, found: list[tuple[Motion, Array]]) -> Simulated:
    kept, along = _divided(robot)
    model, names = robot.with_effects(kept), tuple(dict.fromkeys(e.name for e in along))
    nothing, errors = np.full(robot.nv, np.nan), []
    for motion, reading in found:
        tau = reading * gains - sum(e.torque(robot, motion) for e in along)
        try:
            moved = forward_error(model, motion, tau, step=_COARSE).simulation
        except Diverged as error:
            return Simulated(nothing, nothing, f"{error.joint} diverges", names)
        errors.append(np.stack([moved.error, motion.dq - moved.motion.dq]))
    rms = np.sqrt((np.concatenate(errors, axis=1) ** 2).mean(axis=1))
    return Simulated(rms[0], rms[1], "", names)


def _divided(robot: Robot) -> tuple[list[Effect], list[Effect]]:
    """Effects that a simulation from state to state knows, and the others."""
    kept: list[Effect] = []
    along: list[Effect] = []
    for effect in robot.effects:
        known = isinstance(effect, _OF_STATE)
        if known:
            try:
                forward_model(robot.with_effects([effect]))
            except BadInput:
                known = False
        (kept if known else along).append(effect)
    return kept, along
