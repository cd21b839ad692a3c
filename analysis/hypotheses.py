"""What may be wrong with a given model: its tolerances, and the causes to consider."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from excitant.analysis.evidence import Candidate, Evidence, weigh
from excitant.analysis.observed import Observed
from excitant.analysis.proposals import proposals
from excitant.analysis.signatures import signatures
from excitant.analysis.sticking import sliding
from excitant.analysis.tolerance import calibrated
from excitant.identify.accuracy import series
from excitant.identify.physical import link_coordinates, link_weights
from excitant.identify.preprocessing import Segment
from excitant.identify.rows import implausible_size
from excitant.robots.effects import (
    Effect,
    InertialParameters,
    Parameter,
    Payload,
    TorqueGain,
)
from excitant.robots.motion import Array, Motion
from excitant.robots.robot import Robot

TOLERANCE = 0.05  # relative standard deviation of the given values: right to ±10 %
WRONG_LINK = 1.0  # relative size of the changes that `inertial_parameters` stands for
_REACH = 0.3  # m: scale of a payload's lever, decides nothing but the units of its coordinates


def hypotheses(
    robot: Robot,
    train: Observed,
    metric: Array,
    gains: Array,
    believed: Sequence[Candidate] = (),
    tolerance: float = TOLERANCE,
) -> Evidence:
    """Evidence for all that may be wrong with a robot.

    Args:
        robot: The given robot with its effects.
        train: What the candidates are to explain, of the robot as understood so far; effects that
            rest on torque take it from there.
        metric: Bodies that tolerances are relative to, shape (nv, 10).
        gains: Torque per reading, shape (nv,).
        believed: Causes in the robot as understood so far.
        tolerance: Relative standard deviation of the given inertias and effects.
    """
    segments, reference, Y = train.segments, train.robot, train.links
    measured = series(segments).measured * gains
    given = np.concatenate([np.abs(e.values or ()) for e in robot.effects] or [np.zeros(0)])
    given_scale = tolerance * np.where(given > 0, given, 1e-9)
    blocks = [Y @ link_coordinates(metric)]
    for effect in robot.effects:
        blocks.append(train.columns(effect))
    if robot.effects:
        known = np.concatenate(blocks[1:], axis=2) * given_scale
        blocks = [blocks[0], known]
    weights = [link_weights(robot.nv, tolerance) ** 2, np.ones(len(given))]
    nuisance = start = 10 * robot.nv + len(given)
    candidates = []
    unexplained = measured - train.torque()
    again = [(c.effect, c.trials) for c in believed]
    for effect, trials in proposals(robot, segments, unexplained, again):
        block = cause_columns(effect, robot, reference, segments, Y)
        if not block.any():
            continue
        scale, weight = _coordinates(robot, effect, metric, block, measured)
        stop = start + len(weight)
        candidates.append(Candidate(effect, slice(start, stop), scale, trials))
        blocks.append(block @ scale)
        weights.append(weight)
        start = stop
    step = segments[0].t[1] - segments[0].t[0]
    residual = measured - train.by(robot).torque()
    counts = sliding(segments)
    columns = signatures(blocks, counts)
    evidence = weigh(columns, residual, counts, np.concatenate(weights), nuisance, candidates, step)
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
    return _columns(effect, robot if isinstance(effect, TorqueGain) else reference, segments)


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


def _rows(segments: Sequence[Segment], columns: Callable[[Motion], Array]) -> Array:
    return np.concatenate([s.rows(columns) for s in segments])


def _columns(effect: Effect, robot: Robot, segments: Sequence[Segment]) -> Array:
    return _rows(segments, lambda motion: effect.columns(robot, motion))


def _coordinates(
    robot: Robot, effect: Effect, metric: Array, columns: Array, torque: Array
) -> tuple[Array, Array]:
    """Scale of a candidate's coordinates and their prior precision."""
    if isinstance(effect, InertialParameters):
        j = robot.joint_index(effect.joints[0])
        return link_coordinates(metric[[j]]), link_weights(1, WRONG_LINK) ** 2
    if isinstance(effect, Payload):
        return _payload_scale(metric), np.ones(10)
    acts = columns.any(axis=(0, 2))
    size = coefficient_sizes(effect.parameters(robot), columns[:, acts], torque[:, acts])
    return np.diag(size), np.ones(len(size))


def _payload_scale(metric: Array) -> Array:
    """Units of a payload's coordinates: the arm's mass at the scale of a lever."""
    mass = metric[:, 0].sum()
    units = mass * np.repeat([1.0, _REACH, _REACH**2], [1, 3, 6])
    return np.diag(units)
