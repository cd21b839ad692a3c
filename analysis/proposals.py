"""Causes to consider for a robot and a motion, their shapes searched over grids."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from excitant.identify.preprocessing import Segment
from excitant.robots.effects import (
    EFFECTS,
    Backlash,
    Effect,
    EncoderOffset,
    EncoderScale,
    FrictionCoupling,
    GravityDirection,
    InertiaCoupling,
    InertialParameters,
    JointElasticity,
    JointFacts,
    JointwiseEffect,
    KinematicError,
    Payload,
    TimeDelay,
    TorqueGain,
    TorqueOffset,
    TorqueRipple,
)
from excitant.robots.motion import Array
from excitant.robots.robot import Robot

_DELAYS = (-0.05, -0.02, -0.005, 0.002, 0.005, 0.01, 0.02, 0.04, 0.08)  # s
_GAPS = np.geomspace(3e-4, 0.1, 12)  # rad
_RATIOS = (1.0, -1.0)
_ORDERS = 3  # of ripple at each joint, the best of all
_MOST_ORDERS = 600
_STILL = 1e-3  # rad/s: slower joints rest


def proposals(
    robot: Robot,
    segments: Sequence[Segment],
    unexplained: Array,
    believed: Sequence[tuple[Effect, int]] = (),
) -> list[tuple[Effect, int]]:
    """Effects with the number of shapes that each was chosen from.

    Those of single joints come from the effects themselves, so an effect of the user's own that is
    in `EFFECTS` is considered too.

    Args:
        robot: The arm.
        segments: Recording to explain.
        unexplained: What the model so far leaves, shape (n, nv) [N·m]; ripple is looked for there.
        believed: Effects of the model so far, each with the number of shapes it was chosen from.
            They are considered again, and with them shapes close to theirs.
    """
    speed = np.max([np.abs(s.motion.dq).max(axis=0) for s in segments], axis=0)
    reach = np.ptp(np.concatenate([s.motion.q for s in segments]), axis=0)
    start = min(float(s.motion.t[0]) for s in segments)
    length = max(float(s.motion.t[-1]) for s in segments) - start
    found: list[tuple[Effect, int]] = []
    for j, joint in enumerate(robot.joints):
        found.append((TorqueOffset((joint,)), 1))
        if speed[j] > _STILL:
            facts = JointFacts(float(speed[j]), float(reach[j]), start, length)
            kinds = [k for k in EFFECTS.values() if issubclass(k, JointwiseEffect)]
            shapes = [e for k in kinds if k is not TorqueOffset for e in k.candidates(joint, facts)]
            found += [(effect, 1) for effect in shapes]
            found += _ripples(joint, j, segments, unexplained[:, j])
        found += [(kind((joint,)), 1) for kind in (InertialParameters, *_CHAIN)]
        found += [(TimeDelay((joint,), trial=d), 1) for d in _DELAYS]
        found += [(Backlash((joint,), trial=float(g)), 1) for g in _GAPS]
    for pair in zip(robot.joints, robot.joints[1:], strict=False):
        found += [(FrictionCoupling(pair, ratio=ratio), 1) for ratio in _RATIOS]
        found.append((InertiaCoupling(pair), 1))
    found += [(TimeDelay(robot.joints, trial=d), 1) for d in _DELAYS]
    found += [(TorqueGain(robot.joints), 1), (GravityDirection(robot.joints), 1)]
    found.append((Payload(robot.joints[-1:]), 1))
    known, again = {effect for effect, _ in found}, dict[Effect, int]()
    for effect, trials in believed:
        beside = [e for e in known if type(e) is type(effect) and e.joints == effect.joints]
        if isinstance(effect, TorqueRipple):
            step = _step(segments, robot.joint_index(effect.joints[0]))
            beside = [replace(effect, order=effect.order + s) for s in (-step, step)]
        again |= dict.fromkeys((effect, *between(effect, beside)), trials)
    return found + [pair for pair in again.items() if pair[0] not in known]


def has_shape(effect: Effect) -> bool:
    """Whether a number shapes the effect's columns."""
    return any(isinstance(getattr(effect, field.name), float) for field in fields(effect))


def between(effect: Effect, beside: Sequence[Effect]) -> list[Effect]:
    """An effect with shapes at thirds of the way to the nearest ones beside it.

    Args:
        effect: The effect; a field with a number is what shapes it.
        beside: The same kind of effect with other shapes.
    """
    near: list[Effect] = []
    for field in fields(effect):
        own = getattr(effect, field.name)
        if not isinstance(own, float):
            continue
        others = {getattr(e, field.name) for e in beside}
        lower, upper = [v for v in others if v < own], [v for v in others if v > own]
        for end in (max(lower, default=own), min(upper, default=own)):
            if end != own:
                steps = np.geomspace if end * own > 0 else np.linspace
                values: list[dict[str, Any]] = [{field.name: float(v)} for v in steps(own, end, 4)]
                near += [replace(effect, **value) for value in values[1:3]]
    return near


_CHAIN = (
    TorqueGain,
    EncoderOffset,
    EncoderScale,
    KinematicError,
    JointElasticity,
)


def _ripples(
    joint: str, j: int, segments: Sequence[Segment], unexplained: Array
) -> list[tuple[Effect, int]]:
    """The orders of ripple that lower one joint's error most, far enough apart to differ."""
    q = np.concatenate([s.motion.q[s.keep, j] for s in segments])
    speed = np.concatenate([np.abs(s.motion.dq[s.keep, j]) for s in segments])
    step = _step(segments, j)
    first = max(1.0, 6 * step) if np.ptp(q) < 1.5 * np.pi else 1.0
    last = 2 * np.pi * segments[0].cutoff_hz / max(float(np.median(speed)), _STILL)
    orders = first + step * np.arange(min(_MOST_ORDERS, max(0, int((last - first) / step) + 1)))
    if not len(orders):
        return []
    local = np.column_stack([np.ones_like(q), q, np.cos(q), np.sin(q)])
    e = unexplained - local @ np.linalg.lstsq(local, unexplained, rcond=None)[0]
    gains = np.concatenate([_gains(part, q, e) for part in np.array_split(orders, 20)])
    found: list[tuple[Effect, int]] = []
    for k in np.argsort(-gains):
        if all(abs(orders[k] - effect.order) > 3 * step for effect, _ in found):  # type: ignore[attr-defined]
            found.append((TorqueRipple((joint,), order=float(orders[k])), len(orders)))
        if len(found) == _ORDERS:
            break
    return found


def _step(segments: Sequence[Segment], j: int) -> float:
    """Half of the difference in order that the range of a joint resolves."""
    reach = np.ptp(np.concatenate([s.motion.q[s.keep, j] for s in segments]))
    return float(np.pi / (2 * max(reach, 1e-9)))


def _gains(orders: Array, q: Array, e: Array) -> Array:
    """Fall of ‖e‖² by a cosine and a sine of each order, shape (orders,)."""
    if not len(orders):
        return np.zeros(0)
    angle = np.outer(q, orders)
    c, s = np.cos(angle), np.sin(angle)
    cc, ss, cs = (c * c).sum(axis=0), (s * s).sum(axis=0), (c * s).sum(axis=0)
    a, b = e @ c, e @ s
    determinant = np.maximum(cc * ss - cs**2, 1e-12)
    return np.asarray((ss * a**2 - 2 * cs * a * b + cc * b**2) / determinant, float)
