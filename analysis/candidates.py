"""Causes to consider for a robot and a motion, with their columns at the rows of recordings."""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from excitant.analysis.evidence import Candidate, Evidence, calibrated, weigh
from excitant.analysis.residuals import position_noise
from excitant.analysis.thresholds import EVIDENCE
from excitant.identify.preprocessing import Segment, away_from_rest
from excitant.identify.prior import PRIOR_SIGMA, link_coordinates, link_weights
from excitant.identify.regression import ActingColumns, dense, effect_columns
from excitant.identify.reversals import REVERSALS
from excitant.identify.rows import implausible_size
from excitant.robots.effects import (
    Effect,
    GradualReversal,
    Parameter,
    joint_facts,
    proposals,
)
from excitant.robots.motion import Array, frozen
from excitant.robots.regressor import regressor
from excitant.robots.robot import Robot

PAYLOAD_LEVER = (
    0.3  # m: scales the coordinates of a payload, without effect on the result
)


@dataclass(frozen=True, eq=False)
class Observed:
    """Filtered columns of a robot and its effects at the rows of segments, each computed once."""

    robot: Robot  # effects that depend on torque take that of this model
    segments: tuple[Segment, ...]
    links: Array  # columns of the standard parameters, shape (n, nv, 10 nv)
    # friction that turns over a range of speeds, as the rows show
    reversals: tuple[GradualReversal, ...] = ()
    _by_motion: dict[Effect, ActingColumns] = field(
        default_factory=dict, repr=False
    )
    _by_robot: dict[Effect, ActingColumns] = field(default_factory=dict, repr=False)

    def by(self, robot: Robot, keep: Set[Effect] = frozenset()) -> Observed:
        """The same rows of the same arm with other inertias and effects.

        Columns of some effects are kept as they are with the present ones; those of the bodies
        alone are where the bodies are the same.
        """
        alike = robot.model is self.robot.model
        kept = {
            effect: own
            for effect, own in self._by_robot.items()
            if effect in keep or (alike and effect.physics.depends_on == "bodies")
        }
        return replace(self, robot=robot, _by_robot=kept)

    def columns(self, effect: Effect) -> Array:
        """Columns of one effect, shape (n, nv, k) [N·m per unit]."""
        if effect.link(self.robot) is not None:
            rows = effect.rows(self.robot)
            return self.links[:, :, [10 * j + k for j in rows for k in range(10)]]
        singles = effect.singles()
        self.prepare(singles)
        parts = [self._computed(each)[each].on(self.robot.nv) for each in singles]
        return np.concatenate(parts, axis=2)

    def acting(self, effect: Effect) -> ActingColumns:
        """Columns of one effect on the joints where they act."""
        if (
            effect.link(self.robot) is None
            and len(singles := effect.singles()) == 1
        ):
            self.prepare(singles)
            return self._computed(singles[0])[singles[0]]
        return ActingColumns.of(self.columns(effect))

    def matrix(self, effects: Sequence[Effect]) -> Array:
        """Columns of the standard parameters followed by those of effects, shape (n, nv, p)."""
        self.prepare(effects)
        return np.concatenate([self.links, *map(self.columns, effects)], axis=2)

    def torque(self) -> Array:
        """Torque of the robot with its effects, shape (n, nv) [N·m]."""
        self.prepare(self.robot.effects)
        tau = self.links @ self.robot.phi
        for effect in self.robot.effects:
            tau = tau + self.columns(effect) @ np.array(effect.values or ())
        return tau

    def prepare(self, effects: Sequence[Effect]) -> None:
        """Compute columns of effects that are to be asked for, in one pass over the segments."""
        singles = (
            single
            for effect in effects
            if effect.link(self.robot) is None
            for single in effect.singles()
        )
        new = [e for e in dict.fromkeys(singles) if e not in self._computed(e)]
        if not new:
            return
        columns = effect_columns(self.robot, new, self.segments)
        for effect, own in zip(new, columns, strict=True):
            self._computed(effect)[effect] = own

    def _computed(self, effect: Effect) -> dict[Effect, ActingColumns]:
        return self._by_robot if effect.physics.on_model else self._by_motion


def observed(
    robot: Robot,
    segments: Sequence[Segment],
    reversals: Sequence[GradualReversal] = (),
) -> Observed:
    """Columns of a robot at the rows of segments."""
    links = np.concatenate([s.rows(partial(regressor, robot)) for s in segments])
    return Observed(robot, tuple(segments), frozen(links), tuple(reversals))


def cause_columns(
    effect: Effect, given: Observed, understood: Observed
) -> ActingColumns:
    """Columns of a cause: for a gain by the given robot, else by the model so far."""
    return (given if effect.physics.on_given_torque else understood).acting(effect)


def gather(
    robot: Robot,
    train: Observed,
    tau: Array,
    bodies: Array,
    believed: Sequence[Candidate] = (),
    *,
    gains: Array | None = None,
    identified: bool = False,
) -> Evidence:
    """Evidence for the candidate causes of a given robot's errors; its effects are kept.

    Torque tau (n, nv) [N·m] is to be explained at the rows of ``train``, of the model so far;
    believed causes are reconsidered. Tolerances are those of bodies (nv, 10): ±10 %, or as
    wide as in an identification, and then only effects beyond the standard model are candidates.
    Of torque from currents, ``gains`` is the covariance of the gains' logarithms, (nv, nv).
    """
    nominal = train.by(robot)
    segments = train.segments
    columns_of_effects = train.matrix(robot.effects)[:, :, 10 * robot.nv :]
    values = np.concatenate(
        [np.abs(e.values or ()) for e in robot.effects] or [np.zeros(0)]
    )
    spread = EVIDENCE.tolerance * np.where(values > 0, values, 1e-9)
    if identified:
        spread = implausible_size(columns_of_effects, tau)
    parts = [train.links @ link_coordinates(bodies), columns_of_effects * spread]
    sigma = PRIOR_SIGMA if identified else EVIDENCE.tolerance
    weights = [link_weights(robot.nv, sigma) ** 2, np.ones(len(spread))]
    if gains is not None:
        parts.append(nominal.torque()[:, :, None] * gain_root(gains))
        weights.append(np.ones(robot.nv))
    columns = [*map(ActingColumns.of, parts)]
    nuisance = start = sum(map(len, weights))
    candidates = []
    motions = [s.motion for s in segments]
    rows = [s.keep for s in segments]
    residual = tau - train.torque()
    noise = position_noise(segments)
    load = np.abs(tau).max(axis=0)
    facts = joint_facts(motions, rows, residual, segments[0].cutoff_hz, noise, load)
    proposed = proposals(robot, facts, [(c.effect, c.trials) for c in believed])
    for reversal in train.reversals:
        [j] = reversal.rows(robot)
        if reversal.speed > facts[j].speed_blur:
            proposed.append((reversal, len(REVERSALS.shares)))
    considered = [
        (effect, trials)
        for effect, trials in dict(proposed).items()
        if (effect.search.addable or not identified)
        # is no other than the drive's gain
        and not (gains is not None and effect.physics.on_given_torque)
    ]
    of_given = [e for e, _ in considered if e.physics.on_given_torque]
    nominal.prepare(of_given)
    train.prepare([e for e, _ in considered if e not in of_given])
    for effect, trials in considered:
        acting = cause_columns(effect, nominal, train)
        if not len(acting.joints):
            continue
        scale, weight = _coordinates(robot, effect, bodies, acting, tau)
        stop = start + len(weight)
        candidates.append(Candidate(effect, slice(start, stop), scale, trials))
        columns.append(acting @ scale)
        weights.append(weight)
        start = stop
    error = tau - nominal.torque()
    evidence = weigh(
        dense(columns, error, [*map(str, range(start))], away_from_rest(segments)),
        np.concatenate(weights),
        nuisance,
        candidates,
        segments[0].t[1] - segments[0].t[0],
        by_share=identified,
        gains=range(nuisance - (0 if gains is None else robot.nv), nuisance),
    )
    return evidence if identified else calibrated(evidence, robot)


def gain_root(covariance: Array) -> Array:
    """L of a covariance L Lᵀ of the logarithms of drive gains, singular where one is known."""
    values, vectors = np.linalg.eigh(covariance)
    return vectors * np.sqrt(np.maximum(values, 0.0))


def coefficient_sizes(
    parameters: Sequence[Parameter], columns: Array, torque: Array
) -> Array:
    """Prior scale (e,) of free coefficients, typical or implausible; columns (n, joints, e)."""
    typical = np.array([p.typical for p in parameters], float)
    return np.where(np.isnan(typical), implausible_size(columns, torque), typical)


def _coordinates(
    robot: Robot,
    effect: Effect,
    bodies: Array,
    columns: ActingColumns,
    torque: Array,
) -> tuple[Array, Array]:
    if effect.role == "link":
        return link_coordinates(bodies[effect.rows(robot)]), link_weights(
            1, EVIDENCE.wrong_link
        ) ** 2
    if effect.role == "body":
        units = bodies[:, 0].sum() * np.repeat(
            [1.0, PAYLOAD_LEVER, PAYLOAD_LEVER**2], [1, 3, 6]
        )
        return np.diag(units), np.ones(10)
    felt = torque[:, columns.joints]
    size = coefficient_sizes(effect.parameters(robot), columns.values, felt)
    return np.diag(size), np.ones(len(size))
