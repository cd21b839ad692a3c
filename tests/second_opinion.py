"""Second opinions on base parameters that share no regressor with the product.

1. The null space by recursion from base to tip, after Wensing, Niemeyer and Slotine, "A geometric
characterization of observability in inertial parameter identification" (IJRR 2024). No torque shows
a change u of the parameters exactly when it changes no kinetic energy vᵀ I(u) v = y(v)ᵀ u, where
gravity is a base that may slide along g. A link's velocity is v = X(q)(w + …) of its parent's w, so
its term must not depend on its own q and q̇; then it is a term of the parent, and so on inward:

    N = ⊕ᵢ { u at link i, −Tᵢ u at its parent : u ∈ Uᵢ },
    Uᵢ = { u : y(s, v)ᵀ u = 0 for v ∈ Vᵢ,  d/dq y(X(q) w)ᵀ u = 0 for w attainable },

with Tᵢ into the parent's frame and s the joint's axis. A link shows 10 − dim Uᵢ parameters.

2. Closed-form grouping rules of serial arms, read off modified Denavit-Hartenberg numbers alone:
Gautier and Khalil, "Direct calculation of minimum set of inertial parameters of serial robots"
(IEEE T-RA 1990); Khalil and Dombre, "Modeling, Identification and Control of Robots" (2002),
chapter 9.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate

import numpy as np
import pinocchio as pin
import scipy.linalg
from khosla import dh_from_robot, frames

from excitant.analysis.structure import Held
from excitant.robots.base_parameters import LENGTH_POWERS, arm_length
from excitant.robots.dh import DHChain
from excitant.robots.motion import Array
from excitant.robots.parameters import PSEUDO_INERTIA_BASIS as BASIS
from excitant.robots.parameters import STANDARD, from_pseudo_inertia, moved_parameters
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


def _null_space(N: Array, shown: list[int]) -> NullSpace:
    return NullSpace(tuple(shown), np.linalg.qr(N / np.linalg.norm(N, axis=0))[0])


def _span(vectors: Array) -> Array:
    """Orthonormal basis of columns."""
    U, s, _ = np.linalg.svd(vectors, full_matrices=False)
    return U[:, s > _TOLERANCE]


def parameter_nullspace(
    robot: Robot, *, moving: Sequence[str] | None = None, held: Held | None = None
) -> NullSpace:
    """By recursion from base to tip: joints that move, and positions of the others, else 0."""
    at = {} if held is None or held == "any" else dict(held)
    length, model, blocks, shown = arm_length(robot), robot.model, [], []
    slide = np.append(robot.gravity, np.zeros(3)) / (np.linalg.norm(robot.gravity) or 1.0)
    attained = {-1: (slide[:, None], _energy(slide, slide)[:, None])}  # velocities, energies
    for i, name in enumerate(robot.joints):
        axis, place = model.joints[i + 1].createData().S, model.jointPlacements[i + 1]
        axis = np.array(axis).reshape(6)
        moves = moving is None or name in moving
        if not moves and held != "any":
            place = place * pin.exp6(at.get(name, 0.0) * axis)
        place = pin.SE3(place.rotation, place.translation / length)
        parent = model.parents[i + 1] - 1
        V, K = attained[parent]
        move = moved_parameters(np.eye(10), place.homogeneous)
        V, K, U = place.toActionMatrixInverse() @ V, move @ K, np.eye(10)
        if moves or held == "any":
            V, K, conditions = _step(axis, bool(robot.revolute[i]), moves, V, K)
            U = scipy.linalg.null_space(conditions.T, rcond=0.5) if conditions.size else U
        attained[i] = V, K
        block = np.zeros((robot.nv, 10, U.shape[1]))
        block[i] = U
        if parent >= 0:
            block[parent] = -move.T @ U
        blocks.append(block.reshape(10 * robot.nv, -1))
        shown.append(10 - U.shape[1])
    return _null_space(np.tile(length**LENGTH_POWERS, robot.nv)[:, None] * np.hstack(blocks), shown)


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


_SAME = 1e-9  # rad, or parts of the chain's length
_UNIT = dict(zip(STANDARD, np.eye(10), strict=True))


def grouping(robot: Robot) -> NullSpace:
    """Null space of a serial arm by rule, in the robot's joint frames."""
    chain = dh_from_robot(robot)
    places = list(robot.model.jointPlacements)[1:]
    poses = np.array(list(accumulate((place.homogeneous for place in places), np.matmul)))
    placed = frames(chain, np.zeros((1, chain.nv)))[0, 1:]
    moves = np.linalg.inv(poses) @ placed
    lost = _lost(chain, placed)
    blocks = []
    for j, directions in enumerate(lost):
        block = np.zeros((chain.nv, 10, len(directions)))
        block[j] = moved_parameters(directions, moves[j]).T
        if j > 0:
            block[j - 1] = -moved_parameters(into_previous(chain, j, directions), moves[j - 1]).T
        blocks.append(block.reshape(10 * chain.nv, -1))
    return _null_space(np.hstack(blocks), [10 - len(u) for u in lost])


def largest_count(revolute: int, prismatic: int, first_along_gravity: bool) -> int:
    """Most base parameters an arm can have (Mayeda, Yoshida and Osuka, IEEE T-RA 1990).

    The count itself for revolute arms with parallel or orthogonal axes, the first two not parallel.
    """
    return 7 * revolute + 4 * prismatic - 4 - 2 * first_along_gravity


def _lost(chain: DHChain, placed: Array) -> list[Array]:
    """Directions of each link's parameters that group into the one before or show nowhere."""
    axes, points = placed[:, :3, 2], placed[:, :3, 3]
    turning = np.flatnonzero(chain.revolute)
    first = turning[0] if len(turning) else chain.nv
    other = next((j for j in turning if not _along(axes[j], axes[first])), chain.nv)
    assert chain.gravity.any() or other == chain.nv, "without gravity the rules want parallel axes"
    slides = [k for k in range(other) if not chain.revolute[k]]
    reach = float(np.abs(chain.a).sum() + np.abs(chain.d).sum())
    found = []
    for j in range(chain.nv):
        if chain.revolute[j] and j >= other:
            found.append(np.array([_UNIT["Ixx"] + _UNIT["Iyy"], _UNIT["mcz"], _UNIT["m"]]))
            continue
        across = first < j < other and not _along(axes[j], axes[first])
        kept = {"m", "mcx", "mcy", "mcz"} if across or j >= other else {"m"}
        if chain.revolute[j]:
            gaps = [np.cross(axes[j], points[k] - points[j]) for k in turning if k < j]
            still = all(np.linalg.norm(gap) <= _SAME * reach for gap in gaps)
            still &= all(_along(axes[k], axes[first]) for k in slides if k < j)
            still &= _along(chain.gravity, axes[first])
            kept = {"Izz"} if still else {"Izz", "mcx", "mcy"}
        lost = [_UNIT[name] for name in STANDARD if name not in kept]
        if across:
            lost.append(np.r_[0.0, placed[j, :3, :3].T @ axes[first], np.zeros(6)])
        found.append(np.array(lost))
    return found


def _along(a: Array, b: Array) -> bool:
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return bool(np.linalg.norm(np.cross(a, b)) <= _SAME * size)


def into_previous(chain: DHChain, j: int, phi: Array) -> Array:
    """Parameters about frame j − 1 of what has parameters φ about frame j, (k, 10), q_j = 0.

    For a revolute joint and parameters that turning about its axis does not change (YY with XX,
    MZ, M), these are relations (9.34) of Khalil and Dombre; their r is called d here.
    """
    M, MX, MY, MZ, XX, XY, YY, XZ, YZ, ZZ = phi.T
    if not chain.revolute[j] or not np.array_equal(XX, YY) or np.any([MX, MY, XY, XZ, YZ, ZZ]):
        return moved_parameters(phi, chain.poses(np.zeros((1, chain.nv)))[0, j])
    a, d, c, s = chain.a[j], chain.d[j], np.cos(chain.alpha[j]), np.sin(chain.alpha[j])
    h, z = 2 * d * MZ + d**2 * M, MZ + d * M
    Ixx, Iyy, Izz = YY + h, c**2 * (YY + h) + a**2 * M, s**2 * (YY + h) + a**2 * M
    inertia = (Ixx, a * s * z, Iyy, -a * c * z, c * s * (YY + h), Izz)
    return np.column_stack([M, a * M, -s * z, c * z, *inertia])
