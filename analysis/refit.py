"""What wrong inertias alone would explain: a fit of them with all given effects kept.

    τ − τ_effects ≈ W β     least squares of the links' base parameters, and
    β = B φ, P(φ_k) ≻ 0     the nearest bodies that have them, if any

The unconstrained fit says how far inertias can go at most; whether bodies can have its values is
decided by their distance from the nearest consistent ones under their covariance, which is χ²
distributed when they can. How far each link would have to move is the least change, in units of
the tolerance of given values, that explains what inertias can explain.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.stats

from excitant.analysis.diagnosis import Diagnosis
from excitant.analysis.extension import tolerance_metric
from excitant.analysis.hypotheses import TOLERANCE
from excitant.analysis.sticking import Mask, sliding
from excitant.identify.accuracy import predicted_torque, series
from excitant.identify.least_squares import SMALLEST, autocorrelation_time
from excitant.identify.physical import (
    EffectPrior,
    fit_physical,
    link_coordinates,
    link_weights,
    prior_parameters,
)
from excitant.identify.preprocessing import Segment
from excitant.robots.base_parameters import base_parameters
from excitant.robots.motion import Array, freeze
from excitant.robots.parameters import pseudo_inertia
from excitant.robots.regressor import regressor
from excitant.robots.robot import Robot

LIKELY = 3.0  # times the tolerance's standard deviation: farther off, given values are wrong
_ROUNDS = 3  # of estimating the noise
_FREE = 30.0  # relative size of changes that nothing but consistency holds back
_WEAK = 1.0  # relative size of changes where the least one is looked for
_DEPENDENT = 1e-6  # of the largest singular value: what the motion does not show
_CERTAIN = 0.99  # that values which bodies can have lie nearer


@dataclass(frozen=True)
class Move:
    """How far one link would have to change.

    Attributes:
        link: Name.
        mass: Change of its mass [kg].
        centre: Distance its centre of mass moves [m].
        inertia: Logarithm of the factor by which its mean moment of inertia about the centre of
            mass changes.
        deviations: Each of the three over the standard deviation of given values.
    """

    link: str
    mass: float
    centre: float
    inertia: float
    deviations: tuple[float, float, float]

    @property
    def most(self) -> float:
        """The largest of the deviations."""
        return max(self.deviations)


@dataclass(frozen=True, eq=False)
class Refit:
    """The given model with inertias fitted anew and its effects kept.

    Errors are rms on the hold-out while the joint moves, each of shape (nv,) [torque unit].

    Attributes:
        given: Error of the given model.
        free: Error of the unconstrained fit.
        physical: Error of the nearest bodies.
        extended: Error of the extended model.
        spread: Standard deviation of the measured torque.
        possible: Whether bodies can have the values of the unconstrained fit.
        distance: How far these are from what bodies can have, over what chance allows.
        moves: How far each link would have to change.
    """

    given: Array
    free: Array
    physical: Array
    extended: Array
    spread: Array
    possible: bool
    distance: float
    moves: tuple[Move, ...]

    def __post_init__(self) -> None:
        freeze(self, "given", "free", "physical", "extended", "spread")

    @property
    def most_moved(self) -> Move:
        """The link that would have to change most, in units of the tolerance."""
        return max(self.moves, key=lambda move: move.most)


def refit(diagnosis: Diagnosis) -> Refit:
    """Fit the inertias alone to what was fitted, and judge that on the hold-out.

    Raises:
        BadRobot: A link without mass.
        Infeasible: The semidefinite solver failed.
    """
    robot, gains = diagnosis.robot, diagnosis.gains
    base, prior = base_parameters(robot), prior_parameters(robot)
    B = base.regrouping
    train, held = diagnosis.data.train, diagnosis.data.validate
    Y = _rows(robot, train)
    tau = series(train).measured * gains - (predicted_torque(robot, train) - Y @ robot.phi)
    root, beta, rank = _least_squares(Y[:, :, base.columns], tau, sliding(train))
    nothing = EffectPrior(*(np.zeros(0),) * 3)
    free, least = (
        fit_physical(root @ B, root @ beta, prior, nothing, sigma, tolerance_metric(prior)).x
        for sigma in (_FREE, _WEAK)
    )
    distance = float(((root @ (B @ free - beta)) ** 2).sum())
    allowed = float(scipy.stats.chi2.ppf(_CERTAIN, rank))
    Yv = _rows(robot, held)
    rest = diagnosis.simulated - Yv @ robot.phi / gains
    measured, counts = diagnosis.series.measured, sliding(held)
    return Refit(
        given=_rms(measured - diagnosis.simulated, counts),
        free=_rms(measured - rest - Yv[:, :, base.columns] @ beta / gains, counts),
        physical=_rms(measured - rest - Yv @ least / gains, counts),
        extended=_rms(measured - diagnosis.predicted, counts),
        spread=measured.std(axis=0),
        possible=distance <= allowed,
        distance=distance / allowed,
        moves=_moves(robot, prior, least.reshape(-1, 10)),
    )


def _rows(robot: Robot, segments: tuple[Segment, ...]) -> Array:
    return np.concatenate([s.rows(lambda motion: regressor(robot, motion)) for s in segments])


def _rms(error: Array, counts: Mask) -> Array:
    """Root mean square of the rows that count; of all where none does, shape (nv,)."""
    weight = np.where(counts.any(axis=0), counts, True)
    return np.asarray(np.sqrt((error**2 * weight).sum(axis=0) / weight.sum(axis=0)), float)


def _least_squares(W: Array, tau: Array, counts: Mask) -> tuple[Array, Array, int]:
    """Root of the information on base parameters, shape (r, r), their estimate, and its rank.

    What the motion does not show stays at its smallest size and has no information.
    """
    W, tau = W * counts[:, :, None], tau * counts
    scale = np.sqrt((W**2).sum(axis=(0, 1)))
    scale = np.where(scale > 0, scale, 1.0)
    sigma, rounds = tau.std(axis=0), 0
    while True:
        weight = 1 / np.maximum(sigma, SMALLEST)
        rows = (W / scale * weight[:, None]).reshape(-1, W.shape[2])
        Q, R = scipy.linalg.qr(rows, mode="economic")
        beta, _, rank, _ = np.linalg.lstsq(R, Q.T @ (tau * weight).ravel(), rcond=_DEPENDENT)
        if rounds == _ROUNDS:
            return np.asarray(R * scale, float), np.asarray(beta / scale, float), int(rank)
        error = tau - W @ (beta / scale)
        size = np.sqrt((error**2).sum(axis=0) / np.maximum(counts.sum(axis=0), 1))
        slow = np.array([autocorrelation_time(column) for column in error.T])
        sigma, rounds = size * np.sqrt(slow), rounds + 1


def _moves(robot: Robot, prior: Array, found: Array) -> tuple[Move, ...]:
    """Change of each link, and in units of the tolerance of given values."""
    metric = tolerance_metric(prior)
    return tuple(
        _move(link, before, after, link_coordinates(body[None]) / link_weights(1, TOLERANCE))
        for link, before, after, body in zip(robot.links, prior, found, metric, strict=True)
    )


def _move(link: str, before: Array, after: Array, spread: Array) -> Move:
    """Change of one link; given values have the covariance spread · spreadᵀ."""
    root = _slopes(before) @ spread
    covariance, change = root @ root.T, _figures(after) - _figures(before)
    shift = float(np.linalg.norm(change[1:4]))
    way = change[1:4] / max(shift, 1e-300)
    stds = np.sqrt([covariance[0, 0], way @ covariance[1:4, 1:4] @ way, covariance[4, 4]])
    mass, inertia = float(change[0]), float(change[4])
    far = [
        abs(x) / max(float(s), 1e-300) for x, s in zip((mass, shift, inertia), stds, strict=True)
    ]
    return Move(link, mass, shift, inertia, (far[0], far[1], far[2]))


def _figures(phi: Array) -> Array:
    """Mass, centre of mass and logarithm of the mean central moment of a link, shape (5,)."""
    P = pseudo_inertia(phi)
    centre = P[:3, 3] / P[3, 3]
    central = np.trace(P[:3, :3]) - P[3, 3] * (centre @ centre)
    return np.array([P[3, 3], *centre, np.log(max(float(central), 1e-12 * P[3, 3]))])


def _slopes(phi: Array) -> Array:
    """Derivatives of `_figures`, shape (5, 10)."""
    m, centre = phi[0], phi[1:4] / phi[0]
    J = np.zeros((5, 10))
    J[0, 0] = 1.0
    J[1:4, 0], J[1:4, 1:4] = -centre / m, np.eye(3) / m
    central = np.exp(_figures(phi)[4])
    J[4, 0], J[4, 1:4] = centre @ centre, -2 * centre
    J[4, [4, 6, 9]] = 0.5
    J[4] /= central
    return J
