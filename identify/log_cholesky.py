"""Physically consistent identification where effects are not linear in their parameters.

Every body is written by ten free numbers (Rucker and Wensing 2022): its pseudo-inertia is

    P = U Uᵀ,   U = e^α [[e^d₁, s₁₂, s₁₃, t₁], [0, e^d₂, s₂₃, t₂], [0, 0, e^d₃, t₃], [0, 0, 0, 1]],

which is positive definite for all of them and reaches every P ≻ 0 exactly once. With φ(π) the
standard parameters of the numbers π = (α, d, s, t) and τ(θ) the torque of effects of any shape,

    minimise  ‖R φ(π) + τ(θ) − z‖² + D(φ(π)) / σ² + Σ_i (θ_i − θ̄_i)² / s_i²,   θ ≥ bounds,

with the distances D of `excitant.identify.physical` that are sums of squares. Without effects its
only stationary point is the minimiser of the semidefinite fit, as long as that lies inside the
cone; where data call for an impossible body the numbers π run away and the semidefinite fit with
its margin is the one to use.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.optimize

from excitant.exceptions import BadInput, Infeasible
from excitant.identify.log_cholesky_numbers import from_log_cholesky, to_log_cholesky
from excitant.identify.physical import PRIOR_SIGMA, EffectPrior, KktResiduals, PhysicalFit
from excitant.identify.semidefinite import link_coordinates, link_weights
from excitant.robots.motion import Array, freeze

_EVALUATIONS = 500
_TOLERANCE = 1e-15
_FEW, _REFINED = 60, 1e-5  # where no minimum is demanded
_OPTIMAL = 1e-6  # of the gradient at the prior, above which it did not converge

TorqueModel = Callable[[Array], tuple[Array, Array]]
"""Whitened torque of effects, shape (m,), and its Jacobian, shape (m, k), at parameters (k,)."""


@dataclass(frozen=True, eq=False)
class NonlinearEffects:
    """Effects whose torque is any differentiable function of their parameters θ.

    Attributes:
        torque: Their torque at every row, divided by its noise, and its Jacobian.
        prior: What is known of θ beforehand, and its bounds.
        start: Where to begin, shape (k,); the prior's mean where None.
        alone: The torque without its Jacobian, where that is cheaper; as `torque` gives it if None.
    """

    torque: TorqueModel
    prior: EffectPrior
    start: Array | None = None
    alone: Callable[[Array], Array] | None = None

    def __post_init__(self) -> None:
        if self.start is not None:
            freeze(self, "start")


def fit_log_cholesky(
    R: Array,
    z: Array,
    prior: Array,
    effects: NonlinearEffects | None = None,
    prior_sigma: float | Array = PRIOR_SIGMA,
    distance: str = "pullback",
) -> PhysicalFit:
    """Solve the nonlinear fit from the prior on.

    Args:
        R: Whitened columns of the links, shape (m, 10 links). With effects, the rows themselves:
            a QR factor has lost what their torque is compared with.
        z: Whitened torque, shape (m,).
        prior: Standard parameters of the prior, consistent, shape (links, 10).
        effects: Torque beside the links'; none where None.
        prior_sigma: Relative uncertainty σ of the prior, for all links or for each.
        distance: ``"pullback"``, how the distance to the prior is measured.

    Returns:
        Standard parameters and θ with the covariance of both (constraints ignored).

    Raises:
        BadInput: Columns, torque and prior that do not fit each other.
        Infeasible: The solver did not reach a minimum.
    """
    problem = _Problem(R, z, prior, effects, prior_sigma, distance)
    numbers = problem.descended(problem.start(prior), _TOLERANCE, _EVALUATIONS)
    quality = problem.optimality(numbers)
    if quality.stationarity > _OPTIMAL:
        raise Infeasible(
            "log-Cholesky fit",
            f"no minimum after {_EVALUATIONS} evaluations; the data may call for a body that "
            "cannot be, for which the semidefinite fit is made",
        )
    return problem.fit(numbers, quality)


@dataclass(frozen=True, eq=False)
class Refinement:
    """A point from which the objective falls no further, or hardly.

    Attributes:
        fit: Standard parameters and θ there; its ``kkt`` says how close to a minimum that is.
        objective: The objective at standard parameters and θ, shape (10 links + k,).
    """

    fit: PhysicalFit
    objective: Callable[[Array], float]


def refine_log_cholesky(
    R: Array,
    z: Array,
    prior: Array,
    effects: NonlinearEffects,
    bodies: Array,
    prior_sigma: float | Array = PRIOR_SIGMA,
) -> Refinement:
    """Descend from a consistent point, such as a semidefinite fit, as far as it pays.

    Where data call for a body that cannot be, its numbers run away while the objective and θ
    settle: no minimum is demanded, and bodies are those of a fit with a margin, made for that θ.

    Args:
        R: Whitened columns of the links, shape (m, 10 links).
        z: Whitened torque, shape (m,).
        prior: Standard parameters of the prior, consistent, shape (links, 10).
        effects: Torque beside the links', with θ to start from.
        bodies: Standard parameters to start from, consistent, shape (links, 10).
        prior_sigma: Relative uncertainty σ of the prior, for all links or for each.

    Raises:
        BadInput: Columns, torque and prior that do not fit each other, or impossible bodies.
    """
    problem = _Problem(R, z, prior, effects, prior_sigma, "pullback")
    numbers = problem.descended(problem.start(bodies), _REFINED, _FEW)
    return Refinement(problem.fit(numbers, problem.optimality(numbers)), problem.objective)


class _Problem:
    """Residuals of the fit and their Jacobian as functions of (π, θ)."""

    def __init__(
        self,
        R: Array,
        z: Array,
        prior: Array,
        effects: NonlinearEffects | None,
        sigma: float | Array,
        distance: str,
    ) -> None:
        size = prior.size
        if R.shape != (len(z), size):
            raise BadInput(
                f"log-Cholesky fit: columns of shape {R.shape} for {len(z)} rows and {len(prior)} "
                f"links; expected ({len(z)}, {size})"
            )
        self.R, self.z, self.effects, self.size = R, z, effects, size
        self.known = effects.prior if effects else EffectPrior(*(np.zeros(0),) * 3)
        self.C = _prior_rows(prior, sigma, distance)
        self.target = self.C @ prior.ravel()
        self.lower = np.concatenate([np.full(size, -np.inf), self.known.lower])

    def start(self, bodies: Array) -> Array:
        """Numbers of bodies, shape (links, 10), and θ to start from, inside their bounds."""
        effects, lower = self.effects, self.known.lower
        theta = self.known.mean if effects is None or effects.start is None else effects.start
        theta = np.where(theta > lower, theta, lower + 1e-3 * np.abs(self.known.std))
        return np.concatenate([*(to_log_cholesky(values) for values in bodies), theta])

    def descended(self, numbers: Array, tolerance: float, evaluations: int) -> Array:
        """Where the objective is lowest, from some numbers on."""
        with np.errstate(over="ignore", invalid="ignore"):  # steps too long are taken back
            found = scipy.optimize.least_squares(
                self.residual,
                numbers,
                self.jacobian,
                bounds=(self.lower, np.inf),
                x_scale="jac",
                ftol=tolerance,
                xtol=tolerance,
                gtol=tolerance,
                max_nfev=evaluations,
            )
        return np.asarray(found.x, float)

    def objective(self, x: Array) -> float:
        """What is minimised, at standard parameters and θ."""
        return float((self.misfit(x[: self.size], x[self.size :]) ** 2).sum())

    def bodies(self, numbers: Array) -> tuple[Array, Array]:
        """φ, shape (10 links,), and its Jacobian by the numbers, shape (10 links, 10 links)."""
        pairs = [from_log_cholesky(each) for each in numbers[: self.size].reshape(-1, 10)]
        phi = np.concatenate([values for values, _ in pairs])
        return phi, np.asarray(scipy.linalg.block_diag(*(J for _, J in pairs)), float)

    def torque(self, theta: Array) -> tuple[Array, Array]:
        """Whitened torque of the effects and its Jacobian."""
        if self.effects is None:
            return np.zeros(len(self.z)), np.zeros((len(self.z), 0))
        return self.effects.torque(theta)

    def alone(self, theta: Array) -> Array:
        """Whitened torque of the effects."""
        effects = self.effects
        if effects is None or effects.alone is None:
            return self.torque(theta)[0]
        return effects.alone(theta)

    def residual(self, numbers: Array) -> Array:
        """Data, prior of the links, prior of the effects."""
        return self.misfit(self.bodies(numbers)[0], numbers[self.size :])

    def misfit(self, phi: Array, theta: Array) -> Array:
        """The same of standard parameters."""
        return np.concatenate(
            [
                self.R @ phi + self.alone(theta) - self.z,
                self.C @ phi - self.target,
                (theta - self.known.mean) / self.known.std,
            ]
        )

    def rows(self, theta: Array) -> Array:
        """Jacobian of the residual by (φ, θ), shape (rows, p)."""
        slopes, open_ = self.torque(theta)[1], np.zeros((len(self.C), len(theta)))
        return np.block(
            [
                [self.R, slopes],
                [self.C, open_],
                [np.zeros((len(theta), self.size)), np.diag(1 / self.known.std)],
            ]
        )

    def jacobian(self, numbers: Array) -> Array:
        """Jacobian of the residual by (π, θ)."""
        J = self.rows(numbers[self.size :])
        return np.hstack([J[:, : self.size] @ self.bodies(numbers)[1], J[:, self.size :]])

    def optimality(self, numbers: Array) -> KktResiduals:
        """Gradient that no active bound takes, relative to that of the data."""
        J = self.jacobian(numbers)
        gradient, scale = 2 * J.T @ self.residual(numbers), np.linalg.norm(J, axis=0)
        room = numbers - self.lower
        with np.errstate(invalid="ignore"):  # without bound and without slope
            bound = (gradient > 0) & (room * scale < 1e-6 * np.linalg.norm(self.z))
        free = np.where(bound, 0.0, gradient) / np.where(scale > 0, scale, 1.0)
        size = float(np.linalg.norm(self.z)) + 1.0
        slack = float(np.sum(gradient[bound] * room[bound])) / size**2
        return KktResiduals(float(np.linalg.norm(free)) / size, slack, max(0.0, -float(room.min())))

    def fit(self, numbers: Array, quality: KktResiduals) -> PhysicalFit:
        """The result, its covariance from the Gauss-Newton approximation."""
        phi, theta = self.bodies(numbers)[0], numbers[self.size :]
        J = self.rows(theta)
        before = J[len(self.z) :]
        unit = 1 / np.linalg.norm(before, axis=0)
        after = scipy.linalg.qr(J * unit, mode="r")[0][: len(unit)]
        inverse = unit[:, None] * scipy.linalg.solve_triangular(after, np.eye(len(unit)))
        covariance = inverse @ inverse.T
        prior = unit**2 * np.diag(np.linalg.inv((before * unit).T @ (before * unit)))
        share = np.sqrt(np.diag(covariance) / prior)
        L = np.asarray(np.linalg.inv(before), float)
        x = np.concatenate([phi, theta])
        data = np.asarray(np.linalg.qr(J[: len(self.z)], mode="r"), float)
        share = np.clip(share, 0.0, 1.0)
        return PhysicalFit(x, covariance, share, quality, data, L, self.size // 10)


def _prior_rows(prior: Array, sigma: float | Array, distance: str) -> Array:
    """C with ‖C (φ − φ̄)‖² = D(φ) / σ², shape (10 links, 10 links)."""
    links = len(prior)
    if distance == "pullback":
        T = link_coordinates(prior)
        return np.asarray(link_weights(links, sigma)[:, None] * np.linalg.inv(T), float)
    raise BadInput(f"log-Cholesky fit: distance '{distance}' is no sum of squares; use pullback")
