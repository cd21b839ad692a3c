"""Information of a motion about the base parameters, its exact derivatives, and criteria."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from excitant.exceptions import BadInput, UnknownName
from excitant.robots.base_parameters import BaseParameters, base_parameters
from excitant.robots.effects import Effect, standard_effects
from excitant.robots.motion import Array, Motion, Noun
from excitant.robots.regressor import RegressorDerivatives, regressor_derivatives
from excitant.robots.robot import Robot
from excitant.robots.torque import observation_columns

COLUMNS = ("friction", "inertial")
CRITERIA = ("condition", "d", "a", "e")

_SIGN_WIDTH = (
    0.02  # of the speed scale: where the smooth sign of the derivatives turns
)


@dataclass(frozen=True, eq=False)
class Information(Noun):
    """Objective of a design: base columns of the observation matrix W.

    They are ``"inertial"`` (standard parameters of the links) or ``"friction"`` (those with
    viscous and Coulomb friction, torque offset and rotor inertia of every joint).
    """

    robot: Robot
    columns: str
    base: BaseParameters  # of these columns
    weights: Array  # of each joint's equations, 1 / its noise relative to the others, shape (nv,)
    earlier: Array  # information of earlier recordings per sample of the new motion, (r, r)

    @property
    def effects(self) -> tuple[Effect, ...]:
        """Whose columns follow those of the links."""
        return estimated_effects(self.robot, self.columns)

    def observation(self, motion: Motion, *, smooth: bool = False) -> Array:
        """Base columns at every instant, shape (n, nv, r).

        ``smooth`` puts tanh in place of the sign of velocity, as the derivatives have it.
        """
        Y = observation_columns(self.robot, self.effects, motion)
        if smooth and self.effects:
            # Coulomb columns, one per joint, follow the viscous ones
            j = np.arange(self.robot.nv)
            Y[:, j, 11 * len(j) + j] = np.tanh(motion.dq / sign_width(self.robot))
        return Y[:, :, list(self.base.columns)] * self.weights[:, None]

    def matrix(self, motion: Motion, *, smooth: bool = False) -> Array:
        """M = WᵀW / n, with what earlier recordings hold already, shape (r, r)."""
        return self.gram(self.observation(motion, smooth=smooth))

    def gram(self, observation: Array) -> Array:
        """M of weighted base columns at n instants, shape (n, nv, r) to (r, r)."""
        W = observation.reshape(-1, len(self.base))
        return W.T @ W / len(observation) + self.earlier

    def linearise(self, motion: Motion) -> RegressorDerivatives:
        """Base columns with their exact derivatives by q, q̇ and q̈ (with the smooth sign)."""
        exact = regressor_derivatives(self.robot, motion)
        parts = list(vars(exact).values())
        if self.columns == "friction":
            added = _friction_derivatives(self.robot, motion)
            parts = [
                np.concatenate(pair, axis=-1)
                for pair in zip(parts, added, strict=True)
            ]
        keep = list(self.base.columns)
        return RegressorDerivatives(
            *(part[..., keep] * self.weights[:, None] for part in parts)
        )


def estimated_effects(robot: Robot, columns: str) -> tuple[Effect, ...]:
    """Effects beside the links: those that `identify` estimates by default, or none."""
    return standard_effects(robot.joints) if columns == "friction" else ()


def information(
    robot: Robot,
    columns: str = "friction",
    *,
    noise: npt.ArrayLike | None = None,
    earlier: Sequence[Motion] = (),
    duration: float = 10.0,
) -> Information:
    """Objective on the columns of this name.

    Args:
        robot: The arm.
        columns: ``"friction"`` or ``"inertial"``.
        noise: Standard deviation of each joint's torque noise, shape (nv,) [N·m or N]; equal
            if not given.
        earlier: Motions recorded before, whose information counts for as long as they lasted.
        duration: Of the motion to be designed [s].

    Raises:
        UnknownName: Columns other than ``"friction"`` and ``"inertial"``.
        BadInput: Noise that is not one positive number per joint, or motions of other joints.
    """
    UnknownName.refuse("columns", [columns], COLUMNS)
    sigma = np.ones(robot.nv) if noise is None else np.asarray(noise, float)
    if sigma.shape != (robot.nv,) or not (
        np.isfinite(sigma).all() and (sigma > 0).all()
    ):
        raise BadInput(
            f"torque noise: give one positive number [N·m] for each of the {robot.nv} joints of "
            f"{robot.name}"
        )
    base = base_parameters(robot, estimated_effects(robot, columns))
    known = np.zeros((len(base), len(base)))
    new = Information(
        robot, columns, base, np.exp(np.log(sigma).mean()) / sigma, known
    )
    for motion in earlier:
        if motion.nv != robot.nv:
            raise BadInput(
                f"a recording has {motion.nv} joints, {robot.name} has {robot.nv}"
            )
        known = known + new.matrix(motion) * float(np.ptp(motion.t)) / duration
    return replace(new, earlier=known)


def condition_number(M: Array) -> float:
    """cond₂(W) from M = WᵀW / n: √(λmax / λmin)."""
    eigenvalues = np.linalg.eigvalsh(M)
    return float(
        np.sqrt(eigenvalues[-1]) / np.sqrt(max(float(eigenvalues[0]), 1e-300))
    )


def sign_width(robot: Robot) -> Array:
    """Speed within which the smooth sign turns, shape (nv,) [rad/s or m/s]."""
    return _SIGN_WIDTH * robot.limits.usual_speed


def _friction_derivatives(
    robot: Robot, motion: Motion
) -> tuple[Array, Array, Array, Array]:
    """Columns of `standard_effects` (smooth sign) and their derivatives by q, q̇, q̈."""
    n = len(motion)
    nv = robot.nv
    j = np.arange(robot.nv)
    width = sign_width(robot)
    sign = np.tanh(motion.dq / width)
    Y = np.zeros((n, nv, 4 * nv))
    by_q, by_dq, by_ddq = np.zeros((3, nv, n, nv, 4 * nv))
    for block, values in enumerate(
        (motion.dq, sign, np.ones_like(sign), motion.ddq)
    ):
        Y[:, j, block * nv + j] = values
    by_dq[j, :, j, j] = 1.0
    by_dq[j, :, j, nv + j] = ((1 - sign**2) / width).T
    by_ddq[j, :, j, 3 * nv + j] = 1.0
    return Y, by_q, by_dq, by_ddq


def information_derivative(
    linear: RegressorDerivatives, basis: Sequence[Array], U: Array
) -> Array:
    """Derivatives of UᵀMU by coefficients of q⁽ᵒ⁾ = basis[o] @ X, shape (c · nv, m, m).

    From the basis functions at n instants, each (n, c), and directions U (r, m); ordered as
    X.ravel().
    """
    n, nv, _ = linear.Y.shape
    m = U.shape[1]
    c = basis[0].shape[1]
    WU = np.swapaxes(linear.Y @ U, 1, 2)
    total = np.zeros((c, nv, m * m))
    for phi, block in zip(
        basis, (linear.by_q, linear.by_dq, linear.by_ddq), strict=True
    ):
        S = WU[None] @ (block @ U)
        total += np.tensordot(phi, S.reshape(nv, n, m * m), axes=(0, 1))
    D = total.reshape(c * nv, m, m) / n
    return D + np.swapaxes(D, 1, 2)


def objective(M: Array, criterion: str) -> float:
    """Value to be minimised, dimensionless; a criterion halved or doubled moves it alike.

    ``condition``: log(λmax/λmin); ``d``: −log det M / r; ``a``: log tr M⁻¹; ``e``: −log λmin.
    """
    eigenvalues = np.maximum(np.linalg.eigvalsh(M), 1e-300)
    log = np.log(eigenvalues)
    values = {
        "condition": log[-1] - log[0],
        "d": -log.mean(),
        "a": np.log((1 / eigenvalues).sum()),
        "e": -log[0],
    }
    return float(values[criterion])


def smooth_model(M: Array, dM: Array, criterion: str) -> tuple[Array, Array]:
    """Gradient (k,) and Hessian (k, k) ⪰ 0 of objective ``d`` or ``a`` along M + Σ dM_i x_i."""
    eigenvalues, V = np.linalg.eigh(M)
    eigenvalues = np.maximum(eigenvalues, 1e-300)
    root = V / np.sqrt(eigenvalues)
    A = (root.T @ dM @ root).reshape(len(dM), len(M), len(M))
    if criterion == "d":
        flat = A.reshape(len(dM), -1)
        return -np.einsum("kii->k", A) / len(M), flat @ flat.T / len(M)
    weight = 1 / eigenvalues
    total = weight.sum()
    gradient = -np.einsum("kii,i->k", A, weight) / total
    half = (A * np.sqrt(weight)).reshape(len(dM), -1)
    return gradient, 2 * half @ half.T / total
