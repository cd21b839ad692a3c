"""The seed's formulation as a second opinion: serial arms in link frames, and their recursion.

The modified Newton-Euler recursion of P. K. Khosla, "Estimation of Robot Dynamics Parameters:
Theory and Application", CMU-RI-TR-87-8, 1987. The force and moment g_i = [f_i; n_i] that link
i − 1 exerts on link i, with the moment about the origin of frame i − 1, obey (15)–(17)

    g_i = K_i φ_i + R_{i+1} g_{i+1},

    K_i = [ v̇       [ω̇×] + [ω×][ω×]                  0             ]
          [ [p×]v̇   [p×]([ω̇×] + [ω×][ω×]) − [v̇×]    [·ω̇] + [ω×][·ω] ]

so that g = (block upper-triangular) φ, and the joint's component of each g_i gives τ = M φ (18).
[·ω] is the 3 × 6 matrix with [·ω] (I_xx..I_zz) = I ω. This K_i is as it must read: the printed
one lacks brackets and dots, and a 3 × 6 block cannot be [ω×][ω×]. Nor can (17) stay as printed: it
selects the force where σ = 1, "rotary", but a rotary joint's torque is the moment about its axis.

The paper's frames are distal (standard Denavit-Hartenberg): p = p_i leads from the origin of frame
i − 1 to that of frame i, and [p×]v̇ is part of the moment. In proximal frames (modified; An,
Atkeson and Hollerbach; a URDF's) the moment is taken about the origin of the link's own frame, so
p = 0 in K_i and the term is rightly absent, while R_{i+1} carries the lever. The paper takes that
for an error of others; it is their convention. Both are computed.
"""

from itertools import accumulate

import numpy as np
import pinocchio as pin

from excitant.robots import DHChain, Robot
from excitant.robots.parameters import moved_parameters

Array = np.ndarray
_PARALLEL = 1e-5  # rad: below, common normals are too far away for the inertia's digits
_ZERO = 1e-13  # m or rad: what rounding leaves of a zero
_TENSOR = np.zeros((3, 3, 6))  # I = _TENSOR (I_xx, I_xy, I_yy, I_xz, I_yz, I_zz)
_TENSOR[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2], range(6)] = 1.0
_TENSOR = np.maximum(_TENSOR, _TENSOR.swapaxes(0, 1))


def close(left: Array, right: Array, relative: float = 1e-10) -> bool:
    """Whether arrays agree to a share of the largest element; rounding leaves about 1e-14."""
    return bool(np.abs(left - right).max() <= relative * np.abs(right).max())


def frames(chain: DHChain, q: Array) -> Array:
    """Pose in the base frame of frame 0 and of every link frame, shape (n, nv + 1, 4, 4)."""
    steps = [np.tile(chain.base, (len(q), 1, 1)), *chain.poses(q).swapaxes(0, 1)]
    return np.stack(list(accumulate(steps, np.matmul)), axis=1)


def joint_axes(robot: Robot, q: Array, data: pin.Data) -> Array:
    """Directions of the joints in the base frame in a pose, shape (nv, 3)."""
    J = np.reshape(pin.computeJointJacobians(robot.model, data, q), (6, -1))
    return np.where(robot.revolute[:, None], J[3:].T, J[:3].T)


def dh_from_robot(robot: Robot) -> DHChain:
    """A serial arm, whose locked joints stay where they are, in modified Denavit-Hartenberg form.

    Axes within 1e-5 rad of parallel are taken as parallel, because their common normal is too far
    away to keep the digits of an inertia; torques may change by as much.
    """
    model, data = robot.model, robot.model.createData()
    assert list(model.parents)[1:] == list(range(robot.nv)), f"{robot.name} branches"
    axes = joint_axes(robot, np.zeros(robot.nv), data)
    pin.updateFramePlacements(model, data)
    poses = np.array([pose.homogeneous for pose in list(data.oMi)[1:]])
    points, tip = poses[:, :3, 3], data.oMf[robot.tip].homogeneous
    origin = _nearest(points[0], axes[0], np.zeros(3))
    placed = [_frame(axes[0], np.eye(3)[0 if abs(axes[0, 0]) < 0.9 else 1], origin)]
    x = placed[0][:3, 0]
    for i in range(robot.nv - 1):
        near, origin, x = _common_normal(origin, points[i + 1], axes[i], axes[i + 1], x)
        placed.append(_frame(axes[i], x, near))
    placed.append(_frame(axes[-1], x, _nearest(points[-1], axes[-1], tip[:3, 3])))
    T = np.linalg.inv(placed[:-1]) @ placed[1:]
    R, p = T[:, :3, :3], T[:, :3, 3]
    theta = np.arctan2(0.0 - R[:, 0, 1], R[:, 0, 0])
    alpha = np.arctan2(0.0 - R[:, 1, 2], R[:, 2, 2])
    numbers = p[:, 0], p[:, 2] * np.cos(alpha) - p[:, 1] * np.sin(alpha), alpha, theta
    phi = moved_parameters(robot.phi.reshape(-1, 10), np.linalg.inv(placed[1:]) @ poses)
    names = robot.name, "modified", robot.joints, robot.links, robot.revolute
    numbers = [np.where(np.abs(v) < _ZERO, 0.0, v) for v in numbers]
    rest = phi.ravel(), robot.gravity, placed[0], np.linalg.inv(placed[-1]) @ tip
    return DHChain(*names, *numbers, *rest)


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


def _cross_matrix(v: Array) -> Array:
    """[v×] with [v×] x = v × x; shape (n, 3) to (n, 3, 3)."""
    return np.cross(v[:, None], np.eye(3)).swapaxes(1, 2)


def _times(A: Array, x: Array) -> Array:
    return (A @ x[..., None])[..., 0]


def torque_matrix(chain: DHChain, q: Array, dq: Array, ddq: Array) -> Array:
    """M with τ = M φ, φ about the link frames of the chain, shape (n, nv, 10 nv).

    Row i is zero before column 10 i (Property 4: the equations of links i + 1 .. nv contain
    nothing of link i).
    """
    T, distal = chain.poses(q).swapaxes(0, 1), chain.convention == "standard"
    turn, back, p = T[..., :3, :3], T[..., :3, :3].swapaxes(-1, -2), T[..., :3, 3]
    # from the point of g_i to that of g_{i+1}, in frame i
    reach = _times(back, p) if distal else [*p[1:], np.zeros((len(q), 3))]
    omega, domega = np.zeros((2, len(q), 3))
    dv = np.tile(-chain.base[:3, :3].T @ chain.gravity, (len(q), 1))  # minus gravity
    swing, axes, kinematics = np.zeros((len(q), 3, 3)), [], []
    for i in range(chain.nv):  # from the base outward, eqs (1)–(3)
        if not distal:
            dv = dv + _times(swing, p[i])
        omega, domega, dv = (_times(back[i], v) for v in (omega, domega, dv))
        axis = back[i, :, :, 2] if distal else np.tile([0.0, 0.0, 1.0], (len(q), 1))
        speed, push = axis * dq[:, i, None], axis * ddq[:, i, None]
        if chain.revolute[i]:
            domega = domega + push + np.cross(omega, speed)
            omega = omega + speed
        else:
            dv = dv + push + 2 * np.cross(omega, speed)
        spin = _cross_matrix(omega)
        swing = _cross_matrix(domega) + spin @ spin
        dv = dv + distal * _times(swing, reach[i])
        arm = distal * _cross_matrix(reach[i])
        inertial, gyroscopic = (np.einsum("ijk,nj->nik", _TENSOR, v) for v in (domega, omega))
        K = np.zeros((len(q), 6, 10))
        K[:, :3, 0], K[:, 3:, 0] = dv, _times(arm, dv)
        K[:, :3, 1:4] = swing
        K[:, 3:, 1:4] = arm @ swing - _cross_matrix(dv)
        K[:, 3:, 4:] = inertial + spin @ gyroscopic
        axes.append(axis)
        kinematics.append(K)
    M, stack = np.zeros((len(q), chain.nv, 10 * chain.nv)), np.zeros((len(q), 6, 10 * chain.nv))
    for i in reversed(range(chain.nv)):
        if i + 1 < chain.nv:  # R_{i+1} = [[A, 0], [[p×] A, A]]
            R = np.zeros((len(q), 6, 6))
            R[:, :3, :3] = R[:, 3:, 3:] = turn[i + 1]
            R[:, 3:, :3] = _cross_matrix(reach[i]) @ turn[i + 1]
            stack = R @ stack
        stack[:, :, 10 * i : 10 * i + 10] = kinematics[i]
        part = stack[:, 3:] if chain.revolute[i] else stack[:, :3]
        M[:, i] = np.einsum("nj,njp->np", axes[i], part)
    return M
