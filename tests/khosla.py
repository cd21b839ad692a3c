"""The seed's formulation as a second opinion: serial arms in link frames, and their recursion.

1. Denavit-Hartenberg chains of arms whose joint axes are known, in either convention.

2. The modified Newton-Euler recursion of P. K. Khosla, "Estimation of Robot Dynamics Parameters:
Theory and Application", CMU-RI-TR-87-8, 1987. The force and moment g_i = [f_i; n_i] that link
i − 1 exerts on link i, with the moment about the origin of frame i − 1, obey (15)–(17)

    g_i = K_i φ_i + R_{i+1} g_{i+1},

    K_i = [ v̇       [ω̇×] + [ω×][ω×]                  0             ]
          [ [p×]v̇   [p×]([ω̇×] + [ω×][ω×]) − [v̇×]    [·ω̇] + [ω×][·ω] ]

so that g = (block upper-triangular) φ, and the joint's component of each g_i gives τ = M φ (18).
[·ω] is the 3 × 6 matrix with [·ω] (I_xx..I_zz) = I ω. This K_i is as it must read: the printed
one lacks brackets and dots, and a 3 × 6 block cannot be [ω×][ω×].

The paper's frames are distal (standard Denavit-Hartenberg): p = p_i leads from the origin of frame
i − 1 to that of frame i, and [p×]v̇ is part of the moment. In proximal frames (modified; An,
Atkeson and Hollerbach; a URDF's) the moment is taken about the origin of the link's own frame, so
p = 0 in K_i and the term is rightly absent, while R_{i+1} carries the lever. The paper takes that
for an error of others; it is their convention. Both are computed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from excitant.robots import DHChain, Robot
from excitant.robots.dh import Convention
from excitant.robots.parameters import moved_parameters

Array = np.ndarray
_PARALLEL = 1e-5  # rad: below, common normals are too far away for the inertia's digits
_ZERO = 1e-13  # m or rad: what rounding leaves of a zero


def frames(chain: DHChain, q: Array) -> Array:
    """Pose in the base frame of frame 0 and of every link frame, shape (n, nv + 1, 4, 4)."""
    steps = chain.poses(q)
    found = [np.broadcast_to(chain.base, (len(steps), 4, 4))]
    for i in range(chain.nv):
        found.append(found[-1] @ steps[:, i])
    return np.stack(found, axis=1)


def dh_from_robot(robot: Robot, convention: Convention = "standard") -> DHChain:
    """A serial arm, whose locked joints stay where they are, as a Denavit-Hartenberg chain.

    Axes within 1e-5 rad of parallel are taken as parallel, because their common normal is too far
    away to keep the digits of an inertia; torques may change by as much.
    """
    model, data = robot.model, robot.model.createData()
    assert list(model.parents)[1:] == list(range(robot.nv)), f"{robot.name} branches"
    axes = robot.axes(np.zeros(robot.nv), data)
    pin.updateFramePlacements(model, data)
    poses = np.array([pose.homogeneous for pose in list(data.oMi)[1:]])
    tip = data.oMf[robot.tip].homogeneous
    placed, numbers = through_axes(poses[:, :3, 3], axes, tip[:3, 3], convention)
    moves = np.linalg.inv(placed[1:]) @ poses
    return DHChain(
        robot.name,
        convention,
        robot.joints,
        robot.links,
        robot.revolute,
        *numbers,
        moved_parameters(robot.phi.reshape(-1, 10), moves).ravel(),
        robot.gravity,
        base=placed[0],
        tool=np.linalg.inv(placed[-1]) @ tip,
    )


def with_convention(chain: DHChain, convention: Convention) -> DHChain:
    """The same arm in the other convention, with the same joint angles and torques."""
    if chain.convention == convention:
        return chain
    old = frames(chain, np.zeros((1, chain.nv)))[0]
    on = old[:-1] if chain.convention == "standard" else old[1:]
    tip = old[-1] @ chain.tool
    new, (a, d, alpha, theta) = through_axes(on[:, :3, 3], on[:, :3, 2], tip[:3, 3], convention)
    phi = moved_parameters(chain.phi.reshape(-1, 10), np.linalg.inv(new[1:]) @ old[1:]).ravel()
    tool = np.linalg.inv(new[-1]) @ tip
    numbers = {"a": a, "d": d, "alpha": alpha, "theta": theta, "phi": phi}
    return replace(chain, convention=convention, **numbers, base=new[0], tool=tool, shapes=())


def through_axes(
    points: Array, axes: Array, tip: Array, convention: Convention
) -> tuple[Array, tuple[Array, Array, Array, Array]]:
    """Frames 0 to nv, and (a, d, alpha, theta), of joints whose axes are known at q = 0.

    Frame 0 lies on the first axis where the base is nearest, frame nv on the last axis where
    the tip is nearest.
    """
    x = np.eye(3)[0 if abs(axes[0, 0]) < 0.9 else 1]
    origin = _nearest(points[0], axes[0], np.zeros(3))
    placed = [_frame(axes[0], x, origin)]
    x = placed[0][:3, 0]
    for i in range(len(axes) - 1):
        near, far, x = _common_normal(origin, points[i + 1], axes[i], axes[i + 1], x)
        here = (axes[i + 1], far) if convention == "standard" else (axes[i], near)
        placed.append(_frame(here[0], x, here[1]))
        origin = far
    placed.append(_frame(axes[-1], x, _nearest(points[-1], axes[-1], tip)))
    found = np.array(placed)
    T = np.linalg.inv(found[:-1]) @ found[1:]
    R, p = T[:, :3, :3], T[:, :3, 3]
    if convention == "standard":
        theta, alpha = np.arctan2(R[:, 1, 0], R[:, 0, 0]), np.arctan2(R[:, 2, 1], R[:, 2, 2])
        a, d = p[:, 0] * np.cos(theta) + p[:, 1] * np.sin(theta), p[:, 2]
    else:
        theta = np.arctan2(0.0 - R[:, 0, 1], R[:, 0, 0])
        alpha = np.arctan2(0.0 - R[:, 1, 2], R[:, 2, 2])
        a, d = p[:, 0], p[:, 2] * np.cos(alpha) - p[:, 1] * np.sin(alpha)
    a, d, alpha, theta = (np.where(np.abs(v) < _ZERO, 0.0, v) for v in (a, d, alpha, theta))
    return found, (a, d, alpha, theta)


def _nearest(point: Array, axis: Array, to: Array) -> Array:
    return point + axis * (axis @ (to - point))


def _common_normal(
    origin: Array, point: Array, axis: Array, other: Array, before: Array
) -> tuple[Array, Array, Array]:
    """Feet on two axes of their common normal, and its direction from the first to the second.

    Through ``origin`` (on the first axis) when they are parallel; along ``before`` when they
    are the same line.
    """
    cross = np.cross(axis, other)
    sine = float(np.linalg.norm(cross))
    if sine < _PARALLEL:
        far = _nearest(point, other, origin)
        length = float(np.linalg.norm(far - origin))
        return origin, far, (far - origin) / length if length > _ZERO else before
    x, gap = cross / sine, point - origin
    along, back = (np.cross(gap, v) @ cross / sine**2 for v in (other, axis))
    return origin + along * axis, point + back * other, -x if gap @ x < -_ZERO else x


def _frame(z: Array, x: Array, origin: Array) -> Array:
    x = x - z * (x @ z)
    x, T = x / np.linalg.norm(x), np.eye(4)
    T[:3, :4] = np.column_stack([x, np.cross(z, x), z, origin])
    return T


@dataclass(frozen=True, eq=False)
class LinkMotion:
    """How the links move, each in its own frame; arrays of shape (n, nv, ...).

    Attributes:
        turn: Rotation from frame i to frame i − 1 (A_i).
        axis: The joint's axis in its link's frame (A_iᵀ z).
        p: From the point that g_i has its moment about to the link frame [m].
        reach: From the point of g_i to that of g_{i+1}; the last to the origin of frame nv [m].
        omega: Angular velocity [rad/s].
        domega: Angular acceleration [rad/s²].
        dv: Acceleration of the frame's origin minus gravity [m/s²].
    """

    turn: Array
    axis: Array
    p: Array
    reach: Array
    omega: Array
    domega: Array
    dv: Array


def cross_matrix(v: Array) -> Array:
    """[v×] with [v×] x = v × x; shape (..., 3) to (..., 3, 3)."""
    return np.cross(v[..., None, :], np.eye(3)).swapaxes(-1, -2)


def inertia_columns(v: Array) -> Array:
    """[·v] with [·v] (I_xx, I_xy, I_yy, I_xz, I_yz, I_zz) = I v; (..., 3) to (..., 3, 6)."""
    found = np.zeros((*v.shape, 6))
    for k, (i, j) in enumerate(((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))):
        found[..., i, k], found[..., j, k] = v[..., j], v[..., i]
    return found


def _times(A: Array, x: Array) -> Array:
    return (A @ x[..., None])[..., 0]


def _swing(omega: Array, domega: Array, lever: Array) -> Array:
    return np.cross(domega, lever) + np.cross(omega, np.cross(omega, lever))


def forward_recursion(chain: DHChain, q: Array, dq: Array, ddq: Array) -> LinkMotion:
    """Velocities and accelerations from the base outward, eqs (1)–(3), with v̇_0 = −g."""
    T = chain.poses(q)
    turn, back = T[..., :3, :3], np.swapaxes(T[..., :3, :3], -1, -2)
    distal = chain.convention == "standard"
    lever = _times(back, T[..., :3, 3]) if distal else T[..., :3, 3]  # frame i, frame i − 1
    z = np.array([0.0, 0.0, 1.0])
    axis = back @ z if distal else np.broadcast_to(z, (*dq.shape, 3))
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


def kinematic_matrix(motion: LinkMotion) -> Array:
    """K_i: force and moment per unit of each standard parameter of the link, (n, nv, 6, 10)."""
    spin, arm = cross_matrix(motion.omega), cross_matrix(motion.p)
    swing = cross_matrix(motion.domega) + spin @ spin
    K = np.zeros((*motion.omega.shape[:-1], 6, 10))
    K[..., :3, 0] = motion.dv
    K[..., :3, 1:4] = swing
    K[..., 3:, 0] = _times(arm, motion.dv)
    K[..., 3:, 1:4] = arm @ swing - cross_matrix(motion.dv)
    K[..., 3:, 4:] = inertia_columns(motion.domega) + spin @ inertia_columns(motion.omega)
    return K


def torque_matrix(
    chain: DHChain,
    q: Array,
    dq: Array,
    ddq: Array,
    change: Callable[[Array, LinkMotion], None] | None = None,
) -> Array:
    """M with τ = M φ, φ about the link frames of the chain, shape (n, nv, 10 nv).

    Row i is zero before column 10 i (Property 4: the equations of links i + 1 .. nv contain
    nothing of link i). ``change`` may edit the kinematic matrix before it is used.
    """
    motion = forward_recursion(chain, q, dq, ddq)
    K = kinematic_matrix(motion)
    if change is not None:
        change(K, motion)
    part = np.where(chain.revolute[:, None], [0.0, 1.0], [1.0, 0.0])
    selection = (part[:, :, None] * motion.axis[:, :, None, :]).reshape(len(K), chain.nv, 6)
    M = np.zeros((len(K), chain.nv, 10 * chain.nv))
    stack = np.zeros((len(K), 6, 10 * chain.nv))
    for i in reversed(range(chain.nv)):
        if i + 1 < chain.nv:  # R_{i+1} = [[A, 0], [[p×] A, A]]
            turn, reach = motion.turn[:, i + 1], motion.reach[:, i]
            R = np.zeros((len(K), 6, 6))
            R[:, :3, :3] = R[:, 3:, 3:] = turn
            R[:, 3:, :3] = cross_matrix(reach) @ turn
            stack = R @ stack
        stack[:, :, 10 * i : 10 * i + 10] = K[:, i]
        M[:, i] = np.einsum("nj,njp->np", selection[:, i], stack)
    return M


def modified_torque(chain: DHChain, q: Array, dq: Array, ddq: Array) -> Array:
    """Torque M φ of the arm with its parameters, shape (n, nv) [N·m or N]."""
    return torque_matrix(chain, q, dq, ddq) @ chain.phi
