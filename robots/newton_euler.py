"""The modified Newton-Euler recursion of Khosla (1987).

P. K. Khosla, "Estimation of Robot Dynamics Parameters: Theory and Application",
CMU-RI-TR-87-8, 1987. Equations (1)–(9) are the classical recursion. With the inertia about the
link frame instead of the centre of mass (10)–(14) they become linear in

    φ_i = (m, m c_x, m c_y, m c_z, I_xx, I_xy, I_yy, I_xz, I_yz, I_zz)

(tensor elements, as everywhere here). The force and moment g_i = [f_i; n_i] that link i − 1
exerts on link i, with the moment about the origin of frame i − 1, obey (15)–(17)

    g_i = K_i φ_i + R_{i+1} g_{i+1},

    K_i = [ v̇       [ω̇×] + [ω×][ω×]                  0             ]
          [ [p×]v̇   [p×]([ω̇×] + [ω×][ω×]) − [v̇×]    [·ω̇] + [ω×][·ω] ]

so that g = (block upper-triangular) φ, and the joint's component of each g_i gives τ = M φ (18).
[·ω] is the 3 × 6 matrix with [·ω] (I_xx..I_zz) = I ω. This K_i is as it must read: the printed
one lacks brackets and dots, and a 3 × 6 block cannot be [ω×][ω×].

Frames. The paper's are distal (standard Denavit-Hartenberg): p = p_i leads from the origin of
frame i − 1 to that of frame i, and [p×]v̇ is part of the moment. In proximal frames (modified
Denavit-Hartenberg; An, Atkeson & Hollerbach; a URDF's) the moment is taken about the origin of
the link's own frame, so p = 0 in K_i and the term is rightly absent, while R_{i+1} carries the
lever. The paper takes that for an error of others; it is their convention. Both are computed.

The joint's axis is (0, sin α, cos α) in the distal link frame for any twist α; the paper's
restriction to 0 and ±90° is not needed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from excitant.robots.dh import DHChain
from excitant.robots.motion import Array

_Z = np.array([0.0, 0.0, 1.0])
_ELEMENTS = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))


@dataclass(frozen=True, eq=False)
class LinkMotion:
    """How the links move, each in its own frame: the result of the forward recursion.

    Attributes:
        turn: Rotation from frame i to frame i − 1 (A_i), shape (n, nv, 3, 3).
        axis: The joint's axis in its link's frame (A_iᵀ z), shape (n, nv, 3).
        p: From the point that g_i has its moment about to the link frame, shape (n, nv, 3) [m].
        reach: From the point of g_i to that of g_{i+1}; the last to the origin of frame nv,
            shape (n, nv, 3) [m].
        omega: Angular velocity, shape (n, nv, 3) [rad/s].
        domega: Angular acceleration, shape (n, nv, 3) [rad/s²].
        dv: Acceleration of the frame's origin minus gravity, shape (n, nv, 3) [m/s²].
    """

    turn: Array
    axis: Array
    p: Array
    reach: Array
    omega: Array
    domega: Array
    dv: Array


def cross_matrix(v: npt.ArrayLike) -> Array:
    """[v×] with [v×] x = v × x; shape (..., 3) to (..., 3, 3)."""
    v = np.asarray(v, float)
    found = np.zeros((*v.shape, 3))
    for k, (i, j) in enumerate(((1, 2), (2, 0), (0, 1))):
        found[..., i, j], found[..., j, i] = -v[..., k], v[..., k]
    return found


def inertia_columns(v: npt.ArrayLike) -> Array:
    """[·v] with [·v] (I_xx, I_xy, I_yy, I_xz, I_yz, I_zz) = I v; (..., 3) to (..., 3, 6)."""
    v = np.asarray(v, float)
    found = np.zeros((*v.shape, 6))
    for k, (i, j) in enumerate(_ELEMENTS):
        found[..., i, k] = v[..., j]
        found[..., j, k] = v[..., i]
    return found


def _times(A: Array, x: Array) -> Array:
    """A x for every sample."""
    product: Array = (A @ x[..., None])[..., 0]
    return product


def forward_recursion(
    chain: DHChain, q: npt.ArrayLike, dq: npt.ArrayLike, ddq: npt.ArrayLike
) -> LinkMotion:
    """Velocities and accelerations from the base outward, eqs (1)–(3), with v̇_0 = −g.

    Positions, velocities and accelerations have shape (n, nv).
    """
    dq, ddq = np.asarray(dq, float), np.asarray(ddq, float)
    T = chain.poses(q)
    turn, back = T[..., :3, :3], np.swapaxes(T[..., :3, :3], -1, -2)
    distal = chain.convention == "standard"
    lever = _times(back, T[..., :3, 3]) if distal else T[..., :3, 3]  # frame i, frame i − 1
    axis = back @ _Z if distal else np.broadcast_to(_Z, (*dq.shape, 3))
    omega, domega = np.zeros((2, len(dq), 3))
    dv = np.broadcast_to(-chain.base[:3, :3].T @ chain.gravity, (len(dq), 3))
    found = []
    for i in range(chain.nv):
        if not distal:
            dv = dv + _swing(omega, domega, lever[:, i])
        omega, domega, dv = (_times(back[:, i], x) for x in (omega, domega, dv))
        speed, push = axis[:, i] * dq[:, i, None], axis[:, i] * ddq[:, i, None]
        if chain.revolute[i]:
            domega = domega + push + np.cross(omega, speed)
            omega = omega + speed
        else:
            dv = dv + push + 2 * np.cross(omega, speed)
        if distal:
            dv = dv + _swing(omega, domega, lever[:, i])
        found.append((omega, domega, dv))
    ahead = np.concatenate([lever[:, 1:], np.zeros((len(dq), 1, 3))], axis=1)
    p, reach = (lever, lever) if distal else (np.zeros_like(lever), ahead)
    moving = (np.stack(x, axis=1) for x in zip(*found, strict=True))
    return LinkMotion(turn, axis, p, reach, *moving)


def _swing(omega: Array, domega: Array, lever: Array) -> Array:
    swing: Array = np.cross(domega, lever) + np.cross(omega, np.cross(omega, lever))
    return swing


def kinematic_matrix(p: Array, omega: Array, domega: Array, dv: Array) -> Array:
    """K_i: force and moment per unit of each standard parameter of the link.

    From what `LinkMotion` says of it, each of shape (..., 3), to shape (..., 6, 10).
    """
    spin, arm = cross_matrix(omega), cross_matrix(p)
    swing = cross_matrix(domega) + spin @ spin
    K = np.zeros((*np.shape(omega)[:-1], 6, 10))
    K[..., :3, 0] = dv
    K[..., :3, 1:4] = swing
    K[..., 3:, 0] = _times(arm, dv)
    K[..., 3:, 1:4] = arm @ swing - cross_matrix(dv)
    K[..., 3:, 4:] = inertia_columns(domega) + spin @ inertia_columns(omega)
    return K


def pseudo_rotation(turn: Array, reach: Array) -> Array:
    """R_{i+1} = [[A, 0], [[p×] A, A]]: carries force and moment from frame i + 1 to frame i.

    Args:
        turn: A_{i+1}, shape (..., 3, 3).
        reach: Between the points of the moments, in frame i, shape (..., 3) [m].

    Returns:
        Shape (..., 6, 6).
    """
    R = np.zeros((*np.shape(reach)[:-1], 6, 6))
    R[..., :3, :3] = R[..., 3:, 3:] = turn
    R[..., 3:, :3] = cross_matrix(reach) @ turn
    return R


def wrench_matrix(chain: DHChain, motion: LinkMotion) -> Array:
    """The block upper-triangular matrix with g = (matrix) φ for all links, eq. (18).

    Returns:
        Shape (n, nv, 6, 10 nv): rows of link i, columns of links i to nv, zero before them.
    """
    K = kinematic_matrix(motion.p, motion.omega, motion.domega, motion.dv)
    stack = np.zeros((len(K), chain.nv, 6, 10 * chain.nv))
    for i in reversed(range(chain.nv)):
        stack[:, i, :, 10 * i : 10 * i + 10] = K[:, i]
        if i + 1 < chain.nv:
            R = pseudo_rotation(motion.turn[:, i + 1], motion.reach[:, i])
            stack[:, i, :, 10 * i + 10 :] = R @ stack[:, i + 1, :, 10 * i + 10 :]
    return stack


def select_torque(chain: DHChain, motion: LinkMotion, g: Array) -> Array:
    """The joint's component of force (prismatic) or moment (revolute).

    Args:
        chain: The arm.
        motion: Its motion.
        g: Force and moment of every link, shape (n, nv, 6) or (n, nv, 6, k).

    Returns:
        Shape (n, nv) or (n, nv, k).
    """
    part = np.where(chain.revolute[:, None], [0.0, 1.0], [1.0, 0.0])
    selection = (part[:, :, None] * motion.axis[:, :, None, :]).reshape(*g.shape[:2], 6)
    torque: Array = np.einsum("nij,nij...->ni...", selection, g)
    return torque


def torque_matrix(chain: DHChain, q: npt.ArrayLike, dq: npt.ArrayLike, ddq: npt.ArrayLike) -> Array:
    """M with τ = M φ, φ about the link frames of the chain, shape (n, nv, 10 nv).

    The seed's regressor. Row i is zero before column 10 i (Property 4: the equations of links
    i + 1 .. nv contain nothing of link i), which is what identification link by link rests on.
    """
    motion = forward_recursion(chain, q, dq, ddq)
    return select_torque(chain, motion, wrench_matrix(chain, motion))


def modified_torque(
    chain: DHChain, q: npt.ArrayLike, dq: npt.ArrayLike, ddq: npt.ArrayLike
) -> Array:
    """Torque M φ of the arm with its parameters, shape (n, nv) [N·m or N]."""
    tau: Array = torque_matrix(chain, q, dq, ddq) @ chain.phi
    return tau
