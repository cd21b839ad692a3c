"""Accuracy of the given model: share explained by inertias alone, and forward simulation.

Inertias alone, all given effects kept:

    τ − τ_effects ≈ W β     least squares of the links' base parameters, and
    β = B φ, P(φ_k) ≻ 0     the nearest bodies that have them, if any

The unconstrained fit is tested for physical consistency by its distance from the nearest consistent
values, χ² distributed if it is consistent. The change of each link is the smallest, in units of the
tolerance of given values, that explains as much.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
import scipy

from excitant.analysis.candidates import Observed
from excitant.analysis.confirmation import Holdout
from excitant.analysis.thresholds import EVIDENCE, PLAUSIBILITY
from excitant.exceptions import BadInput
from excitant.identify.least_squares import SMALLEST, autocorrelation_time
from excitant.identify.physical import fit_physical
from excitant.identify.preprocessing import Mask, Segment, away_from_rest
from excitant.identify.prior import (
    BodyPrior,
    EffectPrior,
    link_coordinates,
    link_weights,
    prior_parameters,
)
from excitant.identify.regression import Regression, dense
from excitant.robots.base_parameters import base_parameters
from excitant.robots.effects import Effect
from excitant.robots.motion import Array, Motion
from excitant.robots.parameters import pseudo_inertia
from excitant.robots.robot import Robot
from excitant.robots.simulation import Diverged, forward_error, forward_model

NOISE_ITERATIONS = 4  # of fitting with the noise of the fit before
FREE_BODIES = 30.0  # relative std of bodies that only consistency restricts
WEAK_BODIES = 1.0  # relative std in the search for the smallest change

WINDOW_S = 0.6  # fifteen time constants of the stabilising loop
WINDOWS = 4  # at least, spread over the hold-out, where it is long enough
LONGEST_STEP = (
    2e-3  # s: longest step of integration, a twentieth of that time constant
)


@dataclass(frozen=True)
class Move:
    """Change of one link that would explain the error."""

    link: str
    mass: float  # change [kg]
    centre: float  # distance that its centre of mass moves [m]
    inertia: (
        float  # logarithm of the factor on its mean moment about the centre of mass
    )
    # of each of the three, over the std of given values
    deviations: dict[str, float]

    @property
    def most(self) -> float:
        """The largest of the deviations."""
        return max(self.deviations.values())


@dataclass(frozen=True, eq=False)
class Refit:
    """The given model with inertias fitted anew and its effects kept.

    ``errors`` are rms on the hold-out while joints move, each of shape (nv,) [torque unit]: of the
    ``given`` model, of free ``inertias``, of the nearest ``bodies`` and of the ``extended`` model.
    """

    errors: Mapping[str, Array]
    spread: Array  # standard deviation of the measured torque, shape (nv,)
    possible: bool  # whether the unconstrained fit is physically consistent but for chance
    distance: (
        float  # of that fit from consistent values, relative to what chance allows
    )
    moves: tuple[Move, ...]  # of each link

    @property
    def most_moved(self) -> Move:
        """The link that would have to change most, in units of the tolerance."""
        return max(self.moves, key=lambda move: move.most)

    @property
    def gain(self) -> float:
        """Share of the squared error that free inertias remove, joints relative to torque."""
        inertias, nominal = (
            float(
                ((self.errors[model] / np.maximum(self.spread, 1e-12)) ** 2).sum()
            )
            for model in ("inertias", "given")
        )
        return 1 - inertias / max(nominal, 1e-300)


def refit(train: Observed, tau: Array, holdout: Holdout, extended: Array) -> Refit:
    """Fit the inertias alone to torque tau [N·m], and judge them beside the extended model."""
    robot = train.robot
    base = base_parameters(robot)
    prior = prior_parameters(robot)
    B = base.regrouping
    Y = train.links
    without_links = tau - (train.torque() - Y @ robot.phi)
    problem = dense(Y[:, :, base.columns], without_links, base.expressions)
    root, beta, rank = _least_squares(problem, away_from_rest(train.segments))
    none = np.zeros(0)
    free, least = (
        fit_physical(
            root @ B,
            root @ beta,
            BodyPrior(prior, std),
            EffectPrior(none, none, none),
        ).x
        for std in (FREE_BODIES, WEAK_BODIES)
    )
    distance = float(((root @ (B @ free - beta)) ** 2).sum())
    allowed = float(scipy.special.chdtri(rank, 1 - PLAUSIBILITY.certain))
    Y = holdout.observed.links
    of_links = holdout.error + Y @ robot.phi / holdout.gains
    measured = holdout.series.measured
    errors = {
        "given": holdout.error,
        "inertias": of_links - Y[:, :, base.columns] @ beta / holdout.gains,
        "bodies": of_links - Y @ least / holdout.gains,
        "extended": measured - extended,
    }
    return Refit(
        {model: holdout.series.rms(error) for model, error in errors.items()},
        spread=measured.std(axis=0, where=holdout.series.counts),
        possible=distance <= allowed,
        distance=distance / allowed,
        moves=_moves(robot, prior, least.reshape(-1, 10)),
    )


def _least_squares(problem: Regression, counts: Mask) -> tuple[Array, Array, int]:
    """Root of the information on base parameters, their estimate, and its rank."""
    # directions that the motion does not show get the least norm and no information
    problem = problem.counting(counts)
    counted = np.maximum(counts.sum(axis=0), 1)
    scale = np.linalg.norm(problem.factor(np.ones(problem.nv))[0], axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    sigma = problem.tau.std(axis=0)
    for _ in range(NOISE_ITERATIONS):
        R, z = problem.factor(1 / np.maximum(sigma, SMALLEST))
        beta, _, rank, _ = np.linalg.lstsq(
            R / scale, z, rcond=PLAUSIBILITY.dependent
        )
        error = problem.residual(beta / scale)
        slow = np.array([autocorrelation_time(column) for column in error.T])
        sigma = np.sqrt((error**2).sum(axis=0) / counted * slow)
    return R, np.asarray(beta / scale, float), int(rank)


def _moves(robot: Robot, prior: Array, fitted: Array) -> tuple[Move, ...]:
    moves = []
    for link, before, after in zip(robot.links, prior, fitted, strict=True):
        spread = link_coordinates(before[None]) / link_weights(
            1, EVIDENCE.tolerance
        )
        root = _slopes(before) @ spread
        covariance = root @ root.T
        change = _figures(after) - _figures(before)
        shift = float(np.linalg.norm(change[1:4]))
        way = change[1:4] / max(shift, 1e-300)
        stds = np.sqrt(
            [covariance[0, 0], way @ covariance[1:4, 1:4] @ way, covariance[4, 4]]
        )
        size = {
            "mass": float(change[0]),
            "centre": shift,
            "inertia": float(change[4]),
        }
        deviations = {
            name: abs(x) / max(float(s), 1e-300)
            for (name, x), s in zip(size.items(), stds, strict=True)
        }
        moves.append(Move(link, **size, deviations=deviations))
    return tuple(moves)


def _figures(phi: Array) -> Array:
    """Mass, centre of mass and logarithm of the mean central moment of a link, shape (5,)."""
    P = pseudo_inertia(phi)
    centre = P[:3, 3] / P[3, 3]
    central = np.trace(P[:3, :3]) - P[3, 3] * (centre @ centre)
    return np.array(
        [P[3, 3], *centre, np.log(max(float(central), 1e-12 * P[3, 3]))]
    )


def _slopes(phi: Array) -> Array:
    m = phi[0]
    centre = phi[1:4] / phi[0]
    J = np.zeros((5, 10))
    J[0, 0] = 1.0
    J[1:4, 0], J[1:4, 1:4] = -centre / m, np.eye(3) / m
    J[4, 0] = centre @ centre
    J[4, 1:4] = -2 * centre
    J[4, [4, 6, 9]] = 0.5
    J[4] /= np.exp(_figures(phi)[4])
    return J


@dataclass(frozen=True, eq=False)
class Simulated:
    """A model simulated forward over windows of the hold-out; rms errors of joints, (nv,)."""

    position: Array  # [rad or m]; NaN where it diverges
    velocity: Array  # [rad/s or m/s]
    diverged: str  # why the simulation was stopped; empty when it was not
    # effects of sensors or with memory, evaluated on the recorded motion
    along: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Forward:
    """The given and the extended model, simulated alike."""

    models: Mapping[str, Simulated]  # ``given`` and ``extended``
    windows: int  # number of windows
    seconds: float  # length of each [s]


def forward(
    nominal: Robot, extended: Robot, segments: Sequence[Segment], gains: Array
) -> Forward:
    """Simulate two models forward over short windows of the hold-out; gains are (nv,)."""
    stretches = windows(segments)
    models = {"given": nominal, "extended": extended}
    return Forward(
        {
            name: _simulated(model, gains, stretches)
            for name, model in models.items()
        },
        windows=len(stretches),
        seconds=float(
            np.mean([motion.t[-1] - motion.t[0] for motion, _ in stretches])
        ),
    )


def windows(segments: Sequence[Segment]) -> list[tuple[Motion, Array]]:
    """Motion and torque of short stretches spread over segments, the filter's edges left out."""
    longest = sorted(segments, key=lambda s: -len(s.motion))[:WINDOWS]
    wanted = -(-WINDOWS // len(longest))
    stretches = []
    for s in longest:
        first, stop, _ = s.keep.indices(len(s.motion))
        size = min(round(WINDOW_S * s.rate_hz) + 1, stop - first)
        count = max(1, min(wanted, (stop - first) // size))
        for start in np.linspace(first, stop - size, count).astype(int):
            part = slice(int(start), int(start) + size)
            stretches.append((s.motion[part], s.tau[part]))
    return stretches


def _simulated(
    robot: Robot, gains: Array, stretches: list[tuple[Motion, Array]]
) -> Simulated:
    simulable = [effect for effect in robot.effects if _simulable(robot, effect)]
    along = [effect for effect in robot.effects if effect not in simulable]
    model = robot.with_effects(simulable)
    names = tuple(dict.fromkeys(e.name for e in along))
    errors = []
    for motion, measured in stretches:
        tau = measured * gains - sum(e.torque(robot, motion) for e in along)
        try:
            moved = forward_error(model, motion, tau, step=LONGEST_STEP)
        except Diverged as error:
            nan = np.full(robot.nv, np.nan)
            return Simulated(nan, nan, f"{error.joint} diverges", names)
        errors.append(np.stack([moved.error, motion.dq - moved.motion.dq]))
    position, velocity = np.sqrt((np.concatenate(errors, axis=1) ** 2).mean(axis=1))
    return Simulated(position, velocity, "", names)


def _simulable(robot: Robot, effect: Effect) -> bool:
    """Whether forward simulation supports an effect."""
    if not effect.physics.of_state:
        return False
    with suppress(BadInput):
        return forward_model(robot.with_effects([effect])) is not None
    return False
