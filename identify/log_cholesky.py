"""Physically consistent identification where effects are not linear in their parameters.

Every body is written by ten free numbers (Rucker and Wensing 2022): its pseudo-inertia is

    P = U Uᵀ,   U = e^α [[e^d₁, s₁₂, s₁₃, t₁], [0, e^d₂, s₂₃, t₂], [0, 0, e^d₃, t₃], [0, 0, 0, 1]],

which is positive definite for all of them and reaches every P ≻ 0 exactly once. With φ(π) the
standard parameters of the numbers π = (α, d, s, t) and τ(θ) the torque of effects of any shape,

    minimise  ‖R φ(π) + τ(θ) − z‖² + D(φ(π)) / σ² + Σ_i (θ_i − θ̄_i)² / s_i²,   θ ≥ bounds,

with D the pull-back distance of `excitant.identify.physical`. Without effects its only stationary
point is the minimiser of the semidefinite fit, as long as that lies inside the cone. Where data
call for a body that cannot be, its numbers run away while the objective and θ settle: no minimum
is demanded, and bodies are those of a semidefinite fit with its margin, made for that θ.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
import scipy

from excitant.exceptions import BadInput
from excitant.identify.physical import PhysicalFit
from excitant.identify.prior import PRIOR_SIGMA, EffectPrior, link_coordinates, link_weights
from excitant.identify.semidefinite import KktResiduals
from excitant.robots.motion import Array, freeze
from excitant.robots.parameters import pseudo_inertia

_EVALUATIONS, _TOLERANCE = 60, 1e-5  # of the descent, where no minimum is demanded
_OFF = ((0, 1), (1, 2), (0, 2))  # s₁₂, s₂₃, s₁₃, the order of Rucker and Wensing

TorqueModel = Callable[[Array], tuple[Array, Array]]
"""Whitened torque of effects, shape (m,), and its Jacobian, shape (m, k), at parameters (k,)."""


def from_log_cholesky(numbers: Array) -> tuple[Array, Array]:
    """Standard parameters of the numbers (α, d₁, d₂, d₃, s₁₂, s₂₃, s₁₃, t₁, t₂, t₃), and Jacobian.

    Args:
        numbers: Of one body, shape (10,).

    Returns:
        Shapes (10,) and (10, 10).
    """
    body = pin.LogCholeskyParameters(np.array(numbers, float))
    return np.asarray(body.toDynamicParameters()), np.asarray(body.calculateJacobian())


def to_log_cholesky(phi: Array) -> Array:
    """The ten numbers of a consistent body.

    Args:
        phi: Standard parameters of one link, shape (10,).

    Raises:
        BadInput: No body of positive density has them.
    """
    try:
        flip = np.linalg.cholesky(pseudo_inertia(phi)[::-1, ::-1])
    except np.linalg.LinAlgError:
        raise BadInput("log-Cholesky: parameters that no body of positive density has") from None
    U = flip[::-1, ::-1]  # upper triangular with U Uᵀ = P
    unit = U / U[3, 3]
    off = [unit[k] for k in _OFF]
    return np.array([np.log(U[3, 3]), *np.log(np.diag(unit)[:3]), *off, *unit[:3, 3]])


@dataclass(frozen=True, eq=False)
class NonlinearEffects:
    """Effects whose torque is any differentiable function of their parameters θ.

    Attributes:
        torque: Their torque at every row, divided by its noise, and its Jacobian.
        prior: What is known of θ beforehand, and its bounds.
        start: Where to begin, shape (k,).
        alone: The torque without its Jacobian, which is cheaper.
    """

    torque: TorqueModel
    prior: EffectPrior
    start: Array
    alone: Callable[[Array], Array]

    def __post_init__(self) -> None:
        freeze(self, "start")


def refine_log_cholesky(
    R: Array,
    z: Array,
    prior: Array,
    effects: NonlinearEffects,
    bodies: Array,
    prior_sigma: float | Array = PRIOR_SIGMA,
    tolerance: float = _TOLERANCE,
) -> tuple[PhysicalFit, Callable[[Array], float]]:
    """Descend from a consistent point, such as a semidefinite fit, as far as it pays.

    Args:
        R: Whitened columns of the links, shape (m, 10 links); the rows themselves, since a QR
            factor has lost what the torque of effects is compared with.
        z: Whitened torque, shape (m,).
        prior: Standard parameters of the prior, consistent, shape (links, 10).
        effects: Torque beside the links', with θ to start from.
        bodies: Standard parameters to start from, consistent, shape (links, 10).
        prior_sigma: Relative uncertainty σ of the prior, for all links or for each.
        tolerance: Relative change of objective and parameters at which the descent ends.

    Returns:
        Standard parameters and θ there, whose ``kkt`` says how close to a minimum that is; and the
        objective as a function of standard parameters and θ, shape (10 links + k,).

    Raises:
        BadInput: Columns, torque and prior that do not fit each other, or impossible bodies.
    """
    problem = _Problem(R, z, prior, effects, prior_sigma)
    start, known = effects.start, effects.prior
    theta = np.where(start > known.lower, start, known.lower + 1e-3 * np.abs(known.std))
    numbers = np.concatenate([*(to_log_cholesky(values) for values in bodies), theta])
    with np.errstate(over="ignore", invalid="ignore"):  # steps too long are taken back
        found = scipy.optimize.least_squares(
            problem.residual,
            numbers,
            problem.jacobian,
            bounds=(problem.lower, np.inf),
            x_scale="jac",
            ftol=tolerance,
            xtol=tolerance,
            gtol=tolerance,
            max_nfev=_EVALUATIONS,
        )
    return problem.fit(np.asarray(found.x, float)), problem.objective


class _Problem:
    """Residuals of the fit and their Jacobian as functions of (π, θ)."""

    def __init__(
        self, R: Array, z: Array, prior: Array, effects: NonlinearEffects, sigma: float | Array
    ) -> None:
        size = prior.size
        if R.shape != (len(z), size):
            raise BadInput(
                f"log-Cholesky fit: columns of shape {R.shape} for {len(z)} rows and {len(prior)} "
                f"links; expected ({len(z)}, {size})"
            )
        self.R, self.z, self.effects, self.known, self.size = R, z, effects, effects.prior, size
        weights = link_weights(len(prior), sigma)
        self.C = np.asarray(weights[:, None] * np.linalg.inv(link_coordinates(prior)), float)
        self.target = self.C @ prior.ravel()
        self.lower = np.concatenate([np.full(size, -np.inf), self.known.lower])

    def objective(self, x: Array) -> float:
        """What is minimised, at standard parameters and θ."""
        return float((self.misfit(x[: self.size], x[self.size :]) ** 2).sum())

    def bodies(self, numbers: Array) -> tuple[Array, Array]:
        """φ, shape (10 links,), and its Jacobian by the numbers, shape (10 links, 10 links)."""
        pairs = [from_log_cholesky(each) for each in numbers[: self.size].reshape(-1, 10)]
        phi = np.concatenate([values for values, _ in pairs])
        return phi, np.asarray(scipy.linalg.block_diag(*(J for _, J in pairs)), float)

    def misfit(self, phi: Array, theta: Array) -> Array:
        """Data, prior of the links, prior of the effects."""
        data = self.R @ phi + self.effects.alone(theta) - self.z
        known = (theta - self.known.mean) / self.known.std
        return np.concatenate([data, self.C @ phi - self.target, known])

    def residual(self, numbers: Array) -> Array:
        """The same of numbers."""
        return self.misfit(self.bodies(numbers)[0], numbers[self.size :])

    def rows(self, theta: Array) -> Array:
        """Jacobian of the residual by (φ, θ), shape (rows, p)."""
        prior = scipy.linalg.block_diag(self.C, np.diag(1 / self.known.std))
        return np.vstack([np.hstack([self.R, self.effects.torque(theta)[1]]), prior])

    def jacobian(self, numbers: Array) -> Array:
        """Jacobian of the residual by (π, θ)."""
        J = self.rows(numbers[self.size :])
        return np.hstack([J[:, : self.size] @ self.bodies(numbers)[1], J[:, self.size :]])

    def fit(self, numbers: Array) -> PhysicalFit:
        """The result, its covariance from the Gauss-Newton approximation."""
        phi, theta = self.bodies(numbers)[0], numbers[self.size :]
        J, m = self.rows(theta), len(self.z)
        data, factor, before = (np.asarray(np.linalg.qr(A, mode="r")) for A in (J[:m], J, J[m:]))
        after, root = (scipy.linalg.solve_triangular(A, np.eye(len(A))) for A in (factor, before))
        covariance = after @ after.T
        x, quality = np.concatenate([phi, theta]), self.optimality(numbers)
        links = self.size // 10
        return PhysicalFit(x, covariance, quality, data, root, links)

    def optimality(self, numbers: Array) -> KktResiduals:
        """Gradient that no active bound takes, relative to that of the data."""
        J = self.jacobian(numbers)
        gradient, scale = 2 * J.T @ self.residual(numbers), np.linalg.norm(J, axis=0)
        room, size = numbers - self.lower, float(np.linalg.norm(self.z)) + 1.0
        with np.errstate(invalid="ignore"):  # without bound and without slope
            bound = (gradient > 0) & (room * scale < 1e-6 * np.linalg.norm(self.z))
        free = np.where(bound, 0.0, gradient) / np.where(scale > 0, scale, 1.0)
        slack = float(np.sum(gradient[bound] * room[bound])) / size**2
        return KktResiduals(float(np.linalg.norm(free)) / size, slack, max(0.0, -float(room.min())))
