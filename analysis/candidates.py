"""Causes to consider for a robot and a motion, with their columns at the rows of recordings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from excitant.analysis.evidence import Candidate, Evidence, calibrated, weigh
from excitant.analysis.residuals import moving
from excitant.identify.preprocessing import Segment
from excitant.identify.prior import PRIOR_SIGMA, link_coordinates, link_weights
from excitant.identify.regression import dense
from excitant.identify.rows import implausible_size
from excitant.robots import effects as of
from excitant.robots.effects import Effect, Parameter, joint_facts
from excitant.robots.motion import Array, read_only
from excitant.robots.parameters import isotropic
from excitant.robots.regressor import regressor
from excitant.robots.robot import Robot

TOLERANCE = 0.05  # relative standard deviation of the given values: right to ±10 %
WRONG_LINK = 1.0  # relative size of the changes that `inertial_parameters` stands for
_REACH = 0.3  # m: scale of a payload's lever, decides nothing but the units of its coordinates


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
        if (j := effect.link(self.robot)) is not None:
            return self.links[:, :, 10 * j : 10 * j + 10]
        return np.concatenate([self._once(each) for each in effect.singles()], axis=2)

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
        known = self._by_robot if effect.depends_on_model else self._by_motion
        if effect not in known:
            known[effect] = read_only(_rows(self.segments, lambda m: effect.columns(self.robot, m)))
        return known[effect]


def observed(robot: Robot, segments: Sequence[Segment]) -> Observed:
    """Columns of a robot at the rows of segments."""
    links = _rows(segments, lambda motion: regressor(robot, motion))
    return Observed(robot, tuple(segments), read_only(links))


def _rows(segments: Sequence[Segment], columns: Callable[[Any], Array]) -> Array:
    return np.concatenate([s.rows(columns) for s in segments])


def tolerance_metric(bodies: Array) -> Array:
    """What ten per cent of a link is ten per cent of, shape (links, 10)."""
    return np.array([isotropic(phi) for phi in bodies])


def gather(
    robot: Robot,
    train: Observed,
    tau: Array,
    metric: Array,
    believed: Sequence[Candidate] = (),
    *,
    identified: bool = False,
) -> Evidence:
    """Evidence for all that may be wrong with a robot.

    Args:
        robot: The given robot with its effects.
        train: What the candidates are to explain, of the robot as understood so far; effects that
            rest on torque take it from there.
        tau: Measured torque at the rows, shape (n, nv) [N·m].
        metric: Bodies that tolerances are relative to, shape (nv, 10).
        believed: Causes in the robot as understood so far.
        identified: Whether all given values are as open as in an identification, and only effects
            beyond the standard model are considered; else given values are right to ±10 %.
    """
    segments, Y = train.segments, train.links
    known = train.matrix(robot.effects)[:, :, 10 * robot.nv :]
    given = np.concatenate([np.abs(e.values or ()) for e in robot.effects] or [np.zeros(0)])
    spread = TOLERANCE * np.where(given > 0, given, 1e-9)
    if identified:
        spread = implausible_size(known, tau)
    blocks = [Y @ link_coordinates(metric), known * spread]
    sigma = PRIOR_SIGMA if identified else TOLERANCE
    weights = [link_weights(robot.nv, sigma) ** 2, np.ones(len(spread))]
    nuisance = start = 10 * robot.nv + len(spread)
    candidates = []
    again = [(c.effect, c.trials) for c in believed]
    for effect, trials in proposals(robot, segments, tau - train.torque(), again):
        if identified and not effect.further:
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
    names = [str(k) for k in range(start)]
    residual = tau - train.by(robot).torque()
    evidence = weigh(
        dense(np.concatenate(blocks, axis=2), residual, names),
        moving(segments),
        np.concatenate(weights),
        nuisance,
        candidates,
        segments[0].t[1] - segments[0].t[0],
        by_share=identified,
    )
    return evidence if identified else calibrated(evidence, robot)


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
    if (j := effect.link(robot)) is not None:
        return Y[:, :, 10 * j : 10 * j + 10]
    return believed_columns(effect, robot, reference, segments)


def believed_columns(
    effect: Effect, robot: Robot, reference: Robot, segments: Sequence[Segment]
) -> Array:
    """Columns of an effect that takes torque from the robot as understood so far.

    A gain is one of the given torque: one of what was found since would imitate each of its parts.
    """
    source = robot if effect.of_given_torque else reference
    return _rows(segments, lambda motion: effect.columns(source, motion))


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
    if effect.role == "link":
        return link_coordinates(metric[effect.rows(robot)]), link_weights(1, WRONG_LINK) ** 2
    if effect.role == "body":
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
    """Effects that propose themselves, with the number of shapes each was chosen from.

    Args:
        robot: The arm.
        segments: Recording to explain.
        unexplained: What the model so far leaves, shape (n, nv) [N·m]; ripple is looked for there.
        believed: Effects of the model so far, each with the number of shapes it was chosen from.
            They are considered again, and with them shapes close to theirs.
    """
    motions, rows = [s.motion for s in segments], [s.keep for s in segments]
    facts = joint_facts(motions, rows, unexplained, segments[0].cutoff_hz)
    return of.proposals(robot, facts, believed)
