"""A second opinion on base parameters that shares no regressor with the product.

The null space by recursion from base to tip, after Wensing, Niemeyer and Slotine, "A geometric
characterization of observability in inertial parameter identification" (IJRR 2024). No torque shows
a change u of the parameters exactly when it changes no kinetic energy vᵀ I(u) v = y(v)ᵀ u, where
gravity is a base that may slide along g. A link's velocity is v = X(q)(w + …) of its parent's w, so
its term must not depend on its own q and q̇; then it is a term of the parent, and so on inward:

    N = ⊕ᵢ { u at link i, −Tᵢ u at its parent : u ∈ Uᵢ },
    Uᵢ = { u : y(s, v)ᵀ u = 0 for v ∈ Vᵢ,  d/dq y(X(q) w)ᵀ u = 0 for w attainable },

with Tᵢ into the parent's frame and s the joint's axis. A link shows 10 − dim Uᵢ parameters.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
import scipy.linalg

from excitant.robots.base_parameters import LENGTH_POWERS, arm_length
from excitant.robots.motion import Array
from excitant.robots.parameters import PSEUDO_INERTIA_BASIS as BASIS
from excitant.robots.parameters import from_pseudo_inertia, moved_parameters
from excitant.robots.robot import Robot

_TOLERANCE = 1e-8  # of unit vectors in lengths of the arm


@dataclass(frozen=True, eq=False)
class NullSpace:
    """What no torque shows of the standard parameters, link by link."""

    shown: tuple[int, ...]  # number of base parameters that each link brings
    basis: Array  # orthonormal, shape (p, p − r)

    def __len__(self) -> int:
        """Number r of base parameters."""
        return sum(self.shown)

    def angle(self, other: Array, length: float) -> float:
        """Largest angle to another basis, (p, any), or π/2 [rad]; ``length`` is the unit [m]."""
        if other.shape != self.basis.shape:
            return np.pi / 2
        unit = np.tile(length**-LENGTH_POWERS, len(other) // 10)[:, None]
        bases = (unit * basis for basis in (self.basis, other))
        bases = (basis / np.linalg.norm(basis, axis=0) for basis in bases)
        return float(scipy.linalg.subspace_angles(*bases).max(initial=0.0))


def _span(vectors: Array) -> Array:
    """Orthonormal basis of columns."""
    U, s, _ = np.linalg.svd(vectors, full_matrices=False)
    return U[:, s > _TOLERANCE]


def parameter_nullspace(
    robot: Robot, *, moving: Sequence[str] | None = None, anywhere: bool = False
) -> NullSpace:
    """By recursion from base to tip: joints that move; the others rest at 0 or ``anywhere``."""
    length, model, blocks, shown = arm_length(robot), robot.model, [], []
    slide = np.append(robot.gravity, np.zeros(3)) / (np.linalg.norm(robot.gravity) or 1.0)
    attained = {-1: (slide[:, None], _energy(slide, slide)[:, None])}  # velocities, energies
    for i, name in enumerate(robot.joints):
        axis, place = model.joints[i + 1].createData().S, model.jointPlacements[i + 1]
        axis = np.array(axis).reshape(6)
        moves = moving is None or name in moving
        place = pin.SE3(place.rotation, place.translation / length)
        parent = model.parents[i + 1] - 1
        V, K = attained[parent]
        move = moved_parameters(np.eye(10), place.homogeneous)
        V, K, U = place.toActionMatrixInverse() @ V, move @ K, np.eye(10)
        if moves or anywhere:
            V, K, conditions = _step(axis, bool(robot.revolute[i]), moves, V, K)
            U = scipy.linalg.null_space(conditions.T, rcond=0.5) if conditions.size else U
        attained[i] = V, K
        block = np.zeros((robot.nv, 10, U.shape[1]))
        block[i] = U
        if parent >= 0:
            block[parent] = -move.T @ U
        blocks.append(block.reshape(10 * robot.nv, -1))
        shown.append(10 - U.shape[1])
    N = np.tile(length**LENGTH_POWERS, robot.nv)[:, None] * np.hstack(blocks)
    return NullSpace(tuple(shown), np.linalg.qr(N / np.linalg.norm(N, axis=0))[0])


def _step(axis: Array, turns: bool, moves: bool, V: Array, K: Array) -> tuple[Array, Array, Array]:
    """Velocities (6, v) and energies (10, k) that a link attains, from its parent's.

    And the conditions (10, c) on a change of its parameters to be a change of its parent's.
    """
    angles = 2 * np.pi * np.arange(5) / 5 if turns else np.array([-1.0, 0.0, 1.0])
    places = [pin.exp6(x * axis) for x in angles]
    V = _span(np.hstack([T.toActionMatrixInverse() @ V for T in places]))
    K = _span(np.hstack([moved_parameters(np.eye(10), T.homogeneous) @ K for T in places]))
    S = _twist(axis)  # below: derivative of moved parameters along the axis at the identity
    rate = from_pseudo_inertia(S @ BASIS + BASIS @ S.T)
    conditions = rate @ K
    if moves:
        V = _span(np.column_stack([V, axis]))
        pairs = np.column_stack([_energy(axis, v) for v in V.T])
        K, conditions = _span(np.hstack([K, pairs])), np.hstack([conditions, pairs])
    return V, K, _span(conditions)


def _twist(axis: Array) -> Array:
    """Velocity (linear, angular) as a 4 × 4 matrix."""
    return np.block([[pin.skew(axis[3:]), axis[:3, None]], [np.zeros((1, 4))]])


def _energy(a: Array, b: Array) -> Array:
    """y(a, b) with y(a, b)ᵀ π = aᵀ I(π) b = tr(Â P B̂ᵀ), shape (10,)."""
    return np.einsum("ij,kjl,il->k", _twist(a), BASIS, _twist(b))
