"""Second opinions on base parameters that share no regressor with the product.

1. The parameter null space by recursion from base to tip.

After Wensing, Niemeyer and Slotine, "A geometric characterization of observability in inertial
parameter identification" (IJRR 2024), who propagate the span of attainable velocities. Here the
span of attainable kinetic-energy functionals is propagated beside it: what is tested are
products of velocities that occur together.

No torque shows a change δπ of the parameters exactly when it changes no kinetic energy,
Σᵢ vᵢᵀ I(δπᵢ) vᵢ = 0 for all positions and velocities, and no potential energy. Gravity needs no
case of its own: it is a base that may slide along g, of which only the coupling with the joints
counts. Write vᵀ I(π) v = y(v)ᵀ π. The last link's velocity is v = X(q)(w + …) of its parent's w,
so its term must not depend on its own q and q̇; then it is a term of the parent, and so on inward.
Where the arm branches this holds for the last link of each branch: no other term has its q. So

    N = ⊕ᵢ { u at link i, −Tᵢ u at its parent : u ∈ Uᵢ },
    Uᵢ = { u : y(s, v)ᵀ u = 0 for v ∈ Vᵢ,  d/dq y(X(q) w)ᵀ u = 0 for w attainable },

where Tᵢ moves parameters to the parent's frame, s is the joint's axis, and Vᵢ the velocities
that link i attains. A link shows 10 − dim Uᵢ parameters.

2. Closed-form grouping rules of serial arms, read off the Denavit-Hartenberg numbers alone.

Gautier and Khalil, "Direct calculation of minimum set of inertial parameters of serial robots"
(IEEE T-RA 1990); Khalil and Dombre, "Modeling, Identification and Control of Robots" (2002),
chapter 9. In their frames (modified Denavit-Hartenberg) the parameters YY, MZ, M of a revolute
link and the six inertias of a prismatic link group into the link before. With r1 the first
revolute joint and r2 the first one after it that is not parallel to it, links before r2 show
less:

    revolute, r1 ≤ j < r2      ZZ, and MX, MY unless its axis stands still and gravity is along it
    prismatic, j < r1          M
    prismatic, r1 < j < r2     M, and across r1: the two first moments not along r1
    revolute, j ≥ r2           XX − YY, XY, XZ, YZ, ZZ, MX, MY
    prismatic, j ≥ r2          M, MX, MY, MZ

The rules presume gravity, or that all revolute axes are parallel.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import scipy.linalg
from khosla import dh_from_robot, frames

from excitant.analysis.structure import Held
from excitant.exceptions import BadInput, UnknownName
from excitant.robots.base_parameters import LENGTH_POWERS, arm_length
from excitant.robots.dh import DHChain
from excitant.robots.motion import Array
from excitant.robots.parameters import (
    PSEUDO_INERTIA_BASIS,
    STANDARD,
    from_pseudo_inertia,
    moved_parameters,
)
from excitant.robots.robot import Robot

_TOLERANCE = 1e-8  # of unit vectors in lengths of the arm


@dataclass(frozen=True, eq=False)
class NullSpace:
    """What no torque shows of the standard parameters, link by link.

    Attributes:
        shown: Number of base parameters that each link brings.
        basis: Orthonormal basis of the null space, shape (p, p − r).
    """

    shown: tuple[int, ...]
    basis: Array

    def __len__(self) -> int:
        """Number r of base parameters."""
        return sum(self.shown)

    def angle(self, other: npt.ArrayLike, length: float) -> float:
        """Largest angle to another basis, (p, any), or π/2 [rad]; ``length`` is the unit [m]."""
        other = np.asarray(other, float)
        if other.shape[1] != self.basis.shape[1]:
            return np.pi / 2
        unit = np.tile(length**-LENGTH_POWERS, len(other) // 10)[:, None]
        bases = (
            unit * basis / np.linalg.norm(unit * basis, axis=0) for basis in (self.basis, other)
        )
        return float(scipy.linalg.subspace_angles(*bases).max(initial=0.0))


@dataclass(frozen=True, eq=False)
class _Joint:
    """One joint: where it sits, how it moves; lengths in units of the arm's."""

    parent: int  # index of the joint that carries it, −1 on the base
    place: Array  # (4, 4), of the joint frame in the parent's
    axis: Array  # (6,), linear and angular
    turns: bool
    kind: Literal["moving", "any", "fixed"]


def _span(vectors: Array) -> Array:
    """Orthonormal basis of columns."""
    U, s, _ = np.linalg.svd(vectors, full_matrices=False)
    return U[:, s > _TOLERANCE]


def parameter_nullspace(
    robot: Robot, *, moving: Sequence[str] | None = None, held: Held | None = None
) -> NullSpace:
    """Null space of the standard parameters by recursion from base to tip.

    Args:
        robot: The arm, which may branch; gravity and locked joints count.
        moving: Joints that move, and whose torques are known; all when None.
        held: Positions of the others [rad or m], 0 for those left out; ``"any"`` when they are
            at rest at many positions.
    """
    length = arm_length(robot)
    blocks, shown = [], []
    attained = {-1: _gravity(robot)}
    for i, joint in enumerate(_joints(robot, moving, {} if held is None else held, length)):
        (V, K), to_parent = attained[joint.parent], _moved(joint.place)
        V, K, conditions = _step(joint, _velocity_map(joint.place) @ V, to_parent.T @ K)
        attained[i] = V, K
        U = scipy.linalg.null_space(conditions.T, rcond=0.5) if conditions.size else np.eye(10)
        block = np.zeros((10 * robot.nv, U.shape[1]))
        block[10 * i : 10 * i + 10] = U
        if joint.parent >= 0:
            block[10 * joint.parent : 10 * joint.parent + 10] = -to_parent @ U
        blocks.append(block)
        shown.append(10 - U.shape[1])
    N = np.hstack(blocks) * np.tile(length**LENGTH_POWERS, robot.nv)[:, None]
    return NullSpace(tuple(shown), np.linalg.qr(N / np.linalg.norm(N, axis=0))[0])


def _gravity(robot: Robot) -> tuple[Array, Array]:
    """Velocities and energies of the base: it slides along gravity."""
    slide = np.append(robot.gravity, np.zeros(3)) / (np.linalg.norm(robot.gravity) or 1.0)
    return slide[:, None], _energy(slide, slide)[:, None]


def _joints(robot: Robot, moving: Sequence[str] | None, held: Held, length: float) -> list[_Joint]:
    for name in (*(moving or ()), *(() if held == "any" else held)):
        if name not in robot.joints:
            raise UnknownName("joint", name, robot.joints)
    found, model = [], robot.model
    for j, name in enumerate(robot.joints):
        still = moving is not None and name not in moving
        axis = np.array(model.joints[j + 1].createData().S).reshape(6)
        place = model.jointPlacements[j + 1].homogeneous
        if still and held != "any":
            at = held.get(name, 0.0) if isinstance(held, Mapping) else 0.0
            place = place @ scipy.linalg.expm(at * _twist(axis))
        place[:3, 3] /= length
        kind: Any = "moving" if not still else "any" if held == "any" else "fixed"
        found.append(_Joint(model.parents[j + 1] - 1, place, axis, bool(robot.revolute[j]), kind))
    return found


def _step(joint: _Joint, V: Array, K: Array) -> tuple[Array, Array, Array]:
    """Velocities and energies that a link attains, from its parent's in the joint frame.

    Returns:
        Bases of the velocities (6, v), of the energies (10, k), and of the conditions on a
        change of the link's parameters that is to be a change of its parent's (10, c).
    """
    if joint.kind == "fixed":
        return V, K, np.zeros((10, 0))
    places = 2 * np.pi * np.arange(5) / 5 if joint.turns else np.array([-1.0, 0.0, 1.0])
    moves = [scipy.linalg.expm(x * _twist(joint.axis)) for x in places]
    V = _span(np.hstack([_velocity_map(T) @ V for T in moves]))
    K = _span(np.hstack([_moved(T).T @ K for T in moves]))
    S = _twist(joint.axis)  # below: derivative of `_moved` along the axis at the identity
    rate = from_pseudo_inertia(S @ PSEUDO_INERTIA_BASIS + PSEUDO_INERTIA_BASIS @ S.T)
    conditions = rate @ K
    if joint.kind == "moving":
        V = _span(np.column_stack([V, joint.axis]))
        pairs = np.column_stack([_energy(joint.axis, v) for v in V.T])
        K = _span(np.hstack([K, pairs]))
        conditions = np.hstack([conditions, pairs])
    return V, K, _span(conditions)


def _twist(axis: Array) -> Array:
    """Velocity (linear, angular) as a 4 × 4 matrix."""
    x, y, z = axis[3:]
    twist = np.zeros((4, 4))
    twist[:3, :3] = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
    twist[:3, 3] = axis[:3]
    return twist


def _velocity_map(T: Array) -> Array:
    """Velocities in the frame at pose T of a body, from those where T is given, (6, 6)."""
    R, p = T[:3, :3], T[:3, 3]
    cross = _twist(np.concatenate([np.zeros(3), p]))[:3, :3]
    return np.block([[R.T, -R.T @ cross], [np.zeros((3, 3)), R.T]])


def _moved(T: Array) -> Array:
    """Parameters about a frame from those about the frame at pose T in it, P ← T P Tᵀ, (10, 10)."""
    return moved_parameters(np.eye(10), T).T


def _energy(a: Array, b: Array) -> Array:
    """y(a, b) with y(a, b)ᵀ π = aᵀ I(π) b = tr(Â P B̂ᵀ), shape (10,)."""
    return np.einsum("ij,kjl,il->k", _twist(a), PSEUDO_INERTIA_BASIS, _twist(b))


_SAME = 1e-9  # rad, or parts of the chain's length
_INDEX = {name: k for k, name in enumerate(STANDARD)}


def grouping(robot: Robot) -> NullSpace:
    """Null space of a serial arm by rule, in the robot's joint frames.

    Raises:
        BadInput: No gravity, and axes that are not parallel: no rule is published for it.
    """
    chain = dh_from_robot(robot)
    places = list(robot.model.jointPlacements)[1:]
    poses = np.array(list(accumulate((place.homogeneous for place in places), np.matmul)))
    placed = np.linalg.inv(poses) @ frames(chain, np.zeros((1, chain.nv)))[0, 1:]
    lost = [_lost(chain, j, rule) for j, rule in enumerate(_rules(chain))]
    blocks = []
    for j, directions in enumerate(lost):
        block = np.zeros((10 * chain.nv, len(directions)))
        block[10 * j : 10 * j + 10] = moved_parameters(directions, placed[j]).T
        if j > 0:
            before = moved_parameters(into_previous(chain, j, directions), placed[j - 1])
            block[10 * j - 10 : 10 * j] = -before.T
        blocks.append(block)
    N = np.hstack(blocks)
    basis = np.linalg.qr(N / np.linalg.norm(N, axis=0))[0]
    return NullSpace(tuple(10 - len(u) for u in lost), basis)


def largest_count(revolute: int, prismatic: int, first_along_gravity: bool) -> int:
    """Most base parameters an arm can have (Mayeda, Yoshida and Osuka, IEEE T-RA 1990).

    The count itself for revolute arms with parallel or orthogonal axes, the first two not parallel.
    """
    return 7 * revolute + 4 * prismatic - 4 - 2 * first_along_gravity


def _rules(chain: DHChain) -> tuple[str, ...]:
    """The rule that each link follows."""
    placed = frames(chain, np.zeros((1, chain.nv)))[0, 1:]
    axes, points = placed[:, :3, 2], placed[:, :3, 3]
    turning = [j for j in range(chain.nv) if chain.revolute[j]]
    first = turning[0] if turning else chain.nv
    other = next((j for j in turning if not _along(axes[j], axes[first])), chain.nv)
    if not chain.gravity.any() and other < chain.nv:
        raise BadInput("without gravity the closed-form rules only hold for parallel axes")
    slides = [k for k in range(other) if not chain.revolute[k]]
    reach = float(np.abs(chain.a).sum() + np.abs(chain.d).sum())
    found = []
    for j in range(chain.nv):
        if j >= other:
            found.append("revolute" if chain.revolute[j] else "prismatic")
        elif not chain.revolute[j]:
            across = j > first and not _along(axes[j], axes[first])
            found.append("prismatic across r1" if across else "prismatic, mass only")
        else:
            gaps = [np.cross(axes[j], points[k] - points[j]) for k in turning if k < j]
            still = all(np.linalg.norm(gap) <= _SAME * reach for gap in gaps)
            still &= all(_along(axes[k], axes[first]) for k in slides if k < j)
            still &= _along(chain.gravity, axes[first])
            found.append("parallel to r1, standing still" if still else "parallel to r1")
    return tuple(found)


def _along(a: Array, b: Array) -> bool:
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return bool(np.linalg.norm(np.cross(a, b)) <= _SAME * size)


_KEPT = {
    "prismatic": ("m", "mcx", "mcy", "mcz"),
    "prismatic across r1": ("m", "mcx", "mcy", "mcz"),
    "prismatic, mass only": ("m",),
    "parallel to r1": ("Izz", "mcx", "mcy"),
    "parallel to r1, standing still": ("Izz",),
}


def _lost(chain: DHChain, j: int, rule: str) -> Array:
    """Directions of a link's parameters that group into the one before or show nowhere, (k, 10)."""
    unit = np.eye(10)
    if rule == "revolute":
        both = unit[_INDEX["Ixx"]] + unit[_INDEX["Iyy"]]
        return np.array([both, unit[_INDEX["mcz"]], unit[_INDEX["m"]]])
    lost = unit[[k for name, k in _INDEX.items() if name not in _KEPT[rule]]]
    if rule != "prismatic across r1":
        return lost
    placed = frames(chain, np.zeros((1, chain.nv)))[0, 1:]
    along = np.zeros(10)
    along[1:4] = placed[j, :3, :3].T @ placed[int(np.argmax(chain.revolute)), :3, 2]
    return np.vstack([lost, along])


def into_previous(chain: DHChain, j: int, phi: Array) -> Array:
    """Parameters about frame j − 1 of what has parameters φ about frame j, (k, 10), q_j = 0.

    For a revolute joint and parameters that turning about its axis does not change (YY with XX,
    MZ, M), these are relations (9.34) of Khalil and Dombre; their r is called d here.
    """
    others = [_INDEX[name] for name in ("mcx", "mcy", "Ixy", "Ixz", "Iyz", "Izz")]
    alike = np.array_equal(phi[:, _INDEX["Ixx"]], phi[:, _INDEX["Iyy"]])
    if not chain.revolute[j] or not alike or phi[:, others].any():
        return moved_parameters(phi, chain.poses(np.zeros((1, chain.nv)))[0, j])
    a, d, c, s = chain.a[j], chain.d[j], np.cos(chain.alpha[j]), np.sin(chain.alpha[j])
    YY, MZ, M = (phi[:, _INDEX[name]] for name in ("Iyy", "mcz", "m"))
    h, z = 2 * d * MZ + d**2 * M, MZ + d * M
    Ixx, Iyy, Izz = YY + h, c**2 * (YY + h) + a**2 * M, s**2 * (YY + h) + a**2 * M
    inertia = (Ixx, a * s * z, Iyy, -a * c * z, c * s * (YY + h), Izz)
    return np.column_stack([M, a * M, -s * z, c * z, *inertia])
