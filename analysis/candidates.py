"""Causes to consider for a robot and a motion, with their columns at the rows of recordings."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from excitant.analysis.evidence import Candidate, Evidence, calibrated, joint_columns, weigh
from excitant.analysis.residuals import moving
from excitant.identify.physical import link_coordinates, link_weights
from excitant.identify.preprocessing import Segment
from excitant.identify.rows import implausible_size
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
    JointEffect,
    JointElasticity,
    JointFacts,
    JointwiseEffect,
    KinematicError,
    Parameter,
    Payload,
    TimeDelay,
    TorqueGain,
    TorqueOffset,
    TorqueRipple,
)
from excitant.robots.motion import Array, read_only
from excitant.robots.parameters import isotropic
from excitant.robots.regressor import regressor
from excitant.robots.robot import Robot

TOLERANCE = 0.05  # relative standard deviation of the given values: right to ±10 %
WRONG_LINK = 1.0  # relative size of the changes that `inertial_parameters` stands for
_REACH = 0.3  # m: scale of a payload's lever, decides nothing but the units of its coordinates
_DELAYS = (-0.05, -0.02, -0.005, 0.002, 0.005, 0.01, 0.02, 0.04, 0.08)  # s
_GAPS = np.geomspace(3e-4, 0.1, 12)  # rad
_RATIOS = (1.0, -1.0)
_ORDERS = 3  # of ripple at each joint, the best of all
_MOST_ORDERS = 600
_STILL = 1e-3  # rad/s: slower joints rest
_CHAIN = (TorqueGain, EncoderOffset, EncoderScale, KinematicError, JointElasticity)


@dataclass(frozen=True, eq=False)
class Observed:
    """Filtered columns of a robot and its effects at the rows of segments, each worked out once.

    Attributes:
        robot: Effects that rest on torque take it from here.
        segments: Where.
        links: Columns of the standard parameters at their rows, shape (n, nv, 10 nv).
    """

    robot: Robot
    segments: tuple[Segment, ...]
    links: Array
    _by_motion: dict[Effect, Array] = field(default_factory=dict, repr=False)
    _by_robot: dict[Effect, Array] = field(default_factory=dict, repr=False)

    def by(self, robot: Robot) -> Observed:
        """The same rows of the same arm with other inertias and effects."""
        return Observed(robot, self.segments, self.links, self._by_motion)

    def columns(self, effect: Effect) -> Array:
        """Columns of one effect, shape (n, nv, k) [N·m per unit]."""
        if isinstance(effect, InertialParameters | Payload):
            j = self.robot.joint_index(effect.joints[0])
            return self.links[:, :, 10 * j : 10 * j + 10]
        return np.concatenate([self._once(each) for each in _singles(effect)], axis=2)

    def matrix(self, effects: Sequence[Effect]) -> Array:
        """Columns of the standard parameters followed by those of effects, shape (n, nv, p)."""
        return np.concatenate([self.links, *map(self.columns, effects)], axis=2)

    def torque(self) -> Array:
        """Torque of the robot with its effects, shape (n, nv) [N·m]."""
        tau: Array = self.links @ self.robot.phi
        for effect in self.robot.effects:
            tau = tau + self.columns(effect) @ np.array(effect.values or ())
        return tau

    def _once(self, effect: Effect) -> Array:
        known = self._by_robot if rests_on_model(effect) else self._by_motion
        if effect not in known:
            known[effect] = read_only(_rows(self.segments, lambda m: effect.columns(self.robot, m)))
        return known[effect]


def observed(robot: Robot, segments: Sequence[Segment]) -> Observed:
    """Columns of a robot at the rows of segments."""
    links = _rows(segments, lambda motion: regressor(robot, motion))
    return Observed(robot, tuple(segments), read_only(links))


def rests_on_model(effect: Effect) -> bool:
    """Whether an effect's columns depend on what else is believed of the robot."""
    return not isinstance(effect, JointEffect | InertialParameters | Payload)


def _singles(effect: Effect) -> Iterator[Effect]:
    """The effect without values, joint by joint where each has coefficients of its own."""
    bare = replace(effect, values=None)
    if not isinstance(effect, JointwiseEffect) or effect.arity:
        yield bare
        return
    for joint in effect.joints:
        yield replace(bare, joints=(joint,))


def _rows(segments: Sequence[Segment], columns: Callable[[Any], Array]) -> Array:
    return np.concatenate([s.rows(columns) for s in segments])


def merged(effects: Sequence[Effect]) -> list[Effect]:
    """Effects of one kind and shape as one effect on several joints."""
    kinds: dict[Effect, list[str]] = {}
    for effect in effects:
        if isinstance(effect, JointwiseEffect):
            kinds.setdefault(replace(effect, joints=(), values=None), []).extend(effect.joints)
    together: list[Effect] = [replace(kind, joints=tuple(js)) for kind, js in kinds.items()]
    return together + [e for e in effects if not isinstance(e, JointwiseEffect)]


def tolerance_metric(bodies: Array) -> Array:
    """What ten per cent of a link is ten per cent of, shape (links, 10)."""
    return np.array([isotropic(phi) for phi in bodies])


def gather(
    robot: Robot,
    train: Observed,
    tau: Array,
    metric: Array,
    believed: Sequence[Candidate] = (),
    considered: Callable[[Effect], bool] = lambda effect: True,
) -> Evidence:
    """Evidence for all that may be wrong with a robot.

    Args:
        robot: The given robot with its effects.
        train: What the candidates are to explain, of the robot as understood so far; effects that
            rest on torque take it from there.
        tau: Measured torque at the rows, shape (n, nv) [N·m].
        metric: Bodies that tolerances are relative to, shape (nv, 10).
        believed: Causes in the robot as understood so far.
        considered: Which effects to consider.
    """
    segments, Y = train.segments, train.links
    given = np.concatenate([np.abs(e.values or ()) for e in robot.effects] or [np.zeros(0)])
    known = train.matrix(robot.effects)[:, :, 10 * robot.nv :]
    blocks = [Y @ link_coordinates(metric), known * TOLERANCE * np.where(given > 0, given, 1e-9)]
    weights = [link_weights(robot.nv, TOLERANCE) ** 2, np.ones(len(given))]
    nuisance = start = 10 * robot.nv + len(given)
    candidates = []
    again = [(c.effect, c.trials) for c in believed]
    for effect, trials in proposals(robot, segments, tau - train.torque(), again):
        if not considered(effect):
            continue
        block = cause_columns(effect, robot, train.robot, segments, Y)
        if not block.any():
            continue
        scale, weight = _coordinates(robot, effect, metric, block, tau)
        stop = start + len(weight)
        candidates.append(Candidate(effect, slice(start, stop), scale, trials))
        blocks.append(block @ scale)
        weights.append(weight)
        start = stop
    step = segments[0].t[1] - segments[0].t[0]
    counts = moving(segments)
    evidence = weigh(
        joint_columns(blocks, counts),
        tau - train.by(robot).torque(),
        counts,
        np.concatenate(weights),
        nuisance,
        candidates,
        step,
    )
    return calibrated(evidence, robot)


def cause_columns(
    effect: Effect, robot: Robot, reference: Robot, segments: Sequence[Segment], Y: Array
) -> Array:
    """Columns of a cause at the rows, shape (n, nv, k); bodies take theirs from the regressor.

    Args:
        effect: The cause.
        robot: The given robot.
        reference: The robot as understood so far.
        segments: Where.
        Y: Regressor at their rows, shape (n, nv, 10 nv).
    """
    if isinstance(effect, InertialParameters | Payload):
        j = robot.joint_index(effect.joints[0])
        return Y[:, :, 10 * j : 10 * j + 10]
    return believed_columns(effect, robot, reference, segments)


def believed_columns(
    effect: Effect, robot: Robot, reference: Robot, segments: Sequence[Segment]
) -> Array:
    """Columns of an effect that takes torque from the robot as understood so far.

    A gain is one of the given torque: one of what was found since would imitate each of its parts.
    """
    of = robot if isinstance(effect, TorqueGain) else reference
    return _rows(segments, lambda motion: effect.columns(of, motion))


def coefficient_sizes(parameters: Sequence[Parameter], columns: Array, torque: Array) -> Array:
    """What coefficients are small against when only data decide, shape (e,).

    Args:
        parameters: The coefficients.
        columns: Their columns, shape (n, joints, e).
        torque: Torque of these joints, shape (n, joints).
    """
    size = implausible_size(columns, torque)
    for k, parameter in enumerate(parameters):
        if parameter.typical is not None:
            size[k] = parameter.typical
    return size


def _coordinates(
    robot: Robot, effect: Effect, metric: Array, columns: Array, torque: Array
) -> tuple[Array, Array]:
    """Scale of a candidate's coordinates and their prior precision."""
    if isinstance(effect, InertialParameters):
        j = robot.joint_index(effect.joints[0])
        return link_coordinates(metric[[j]]), link_weights(1, WRONG_LINK) ** 2
    if isinstance(effect, Payload):
        units = metric[:, 0].sum() * np.repeat([1.0, _REACH, _REACH**2], [1, 3, 6])
        return np.diag(units), np.ones(10)
    acts = columns.any(axis=(0, 2))
    size = coefficient_sizes(effect.parameters(robot), columns[:, acts], torque[:, acts])
    return np.diag(size), np.ones(len(size))


def proposals(
    robot: Robot,
    segments: Sequence[Segment],
    unexplained: Array,
    believed: Sequence[tuple[Effect, int]] = (),
) -> list[tuple[Effect, int]]:
    """Effects, their shapes searched over grids, with the number of shapes each was chosen from.

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
            step = _order_step(segments, robot.joint_index(effect.joints[0]))
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
    for field_ in fields(effect):
        own = getattr(effect, field_.name)
        if not isinstance(own, float):
            continue
        others = {getattr(e, field_.name) for e in beside}
        lower, upper = [v for v in others if v < own], [v for v in others if v > own]
        for end in (max(lower, default=own), min(upper, default=own)):
            if end != own:
                steps = np.geomspace if end * own > 0 else np.linspace
                values: list[dict[str, Any]] = [{field_.name: float(v)} for v in steps(own, end, 4)]
                near += [replace(effect, **value) for value in values[1:3]]
    return near


def _ripples(
    joint: str, j: int, segments: Sequence[Segment], unexplained: Array
) -> list[tuple[Effect, int]]:
    """The orders of ripple that lower one joint's error most, far enough apart to differ."""
    q = np.concatenate([s.motion.q[s.keep, j] for s in segments])
    speed = np.concatenate([np.abs(s.motion.dq[s.keep, j]) for s in segments])
    step = _order_step(segments, j)
    first = max(1.0, 6 * step) if np.ptp(q) < 1.5 * np.pi else 1.0
    last = 2 * np.pi * segments[0].cutoff_hz / max(float(np.median(speed)), _STILL)
    orders = first + step * np.arange(min(_MOST_ORDERS, max(0, int((last - first) / step) + 1)))
    if not len(orders):
        return []
    local = np.column_stack([np.ones_like(q), q, np.cos(q), np.sin(q)])
    e = unexplained - local @ np.linalg.lstsq(local, unexplained, rcond=None)[0]
    gains = np.concatenate([_gains(part, q, e) for part in np.array_split(orders, 20)])
    found: list[float] = []
    for order in orders[np.argsort(-gains)]:
        if len(found) < _ORDERS and all(abs(order - other) > 3 * step for other in found):
            found.append(float(order))
    return [(TorqueRipple((joint,), order=order), len(orders)) for order in found]


def _order_step(segments: Sequence[Segment], j: int) -> float:
    """Half of the difference in order that the range of a joint resolves."""
    reach = np.ptp(np.concatenate([s.motion.q[s.keep, j] for s in segments]))
    return float(np.pi / (2 * max(reach, 1e-9)))


def _gains(orders: Array, q: Array, e: Array) -> Array:
    """Fall of ‖e‖² by a cosine and a sine of each order, shape (orders,)."""
    angle = np.outer(q, orders)
    c, s = np.cos(angle), np.sin(angle)
    cc, ss, cs = (c * c).sum(axis=0), (s * s).sum(axis=0), (c * s).sum(axis=0)
    a, b = e @ c, e @ s
    determinant = np.maximum(cc * ss - cs**2, 1e-12)
    return np.asarray((ss * a**2 - 2 * cs * a * b + cc * b**2) / determinant, float)
