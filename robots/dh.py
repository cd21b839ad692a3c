"""Denavit-Hartenberg chains: link frames by four numbers each, and inertias about those frames.

Two conventions are in use, for the pose of frame i in frame i − 1:

    standard (distal; Denavit & Hartenberg 1955, Paul 1981):   Rz(θ) Tz(d) Tx(a) Rx(α)
    modified (proximal; Craig 1986, Khalil & Kleinfinger 1986): Rx(α) Tx(a) Rz(θ) Tz(d)

In the standard one frame i sits at the far end of link i, on the axis of joint i + 1; in the
modified one at its near end, on the axis of joint i itself. Both are fixed to link i.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from excitant.robots.motion import Array, freeze, read_only
from excitant.robots.parameters import from_pseudo_inertia, pseudo_inertia

Convention = Literal["standard", "modified"]
CONVENTIONS: tuple[Convention, Convention] = ("standard", "modified")

_PARALLEL = 1e-5  # rad: below, common normals are too far away for the inertia's digits
_ZERO = 1e-13  # m or rad: what rounding leaves of a zero


@dataclass(frozen=True)
class Cylinder:
    """A collision shape: a cylinder between two points, or a sphere when they coincide.

    Attributes:
        link: The link it belongs to, 1 to nv, or 0 for the base.
        start: One end, in the Denavit-Hartenberg frame of the link (the base frame for 0) [m].
        end: Other end [m].
        radius: Radius [m].
    """

    link: int
    start: tuple[float, float, float]
    end: tuple[float, float, float]
    radius: float


@dataclass(frozen=True, eq=False)
class DHChain:
    """A serial arm in Denavit-Hartenberg form.

    Attributes:
        name: Name of the arm.
        convention: ``"standard"`` (distal frames) or ``"modified"`` (proximal frames).
        joints: Names of the joints, nv of them.
        links: Names of the links.
        revolute: Whether each joint turns, shape (nv,); its q adds to θ, that of others to d.
        a: Length along x, shape (nv,) [m]; a_{i−1} in Craig's letters for ``modified``.
        d: Offset along z, shape (nv,) [m].
        alpha: Twist about x, shape (nv,) [rad]; α_{i−1} in Craig's letters for ``modified``.
        theta: Angle about z at q = 0, shape (nv,) [rad].
        phi: Standard parameters about the link frames of the convention, shape (10 nv,).
        gravity: Gravity in the base frame, shape (3,) [m/s²].
        base: Pose of frame 0 in the base frame, shape (4, 4).
        tool: Pose of the tool in frame nv, shape (4, 4).
        shapes: Collision shapes.
    """

    name: str
    convention: Convention
    joints: tuple[str, ...]
    links: tuple[str, ...]
    revolute: npt.NDArray[np.bool_]
    a: Array
    d: Array
    alpha: Array
    theta: Array
    phi: Array
    gravity: Array
    base: Array
    tool: Array
    shapes: tuple[Cylinder, ...] = ()

    def __post_init__(self) -> None:
        freeze(self, "a", "d", "alpha", "theta", "phi", "gravity", "base", "tool")
        revolute = np.array(self.revolute, dtype=bool)
        revolute.setflags(write=False)
        object.__setattr__(self, "revolute", revolute)
        if self.convention not in CONVENTIONS:
            raise ValueError(f"convention '{self.convention}' is neither standard nor modified")
        per_joint = (self.a, self.d, self.alpha, self.theta, revolute, self.joints, self.links)
        if {len(x) for x in per_joint} != {self.nv} or self.phi.shape != (10 * self.nv,):
            raise ValueError(f"numbers of joints differ: {[len(x) for x in per_joint]}")

    @property
    def nv(self) -> int:
        """Number of joints."""
        return len(self.joints)

    def with_parameters(self, phi: npt.ArrayLike) -> DHChain:
        """The same arm with other standard parameters about its link frames, (10 nv,)."""
        return replace(self, phi=read_only(phi))

    def poses(self, q: npt.ArrayLike) -> Array:
        """Pose of every link frame in the one before, shape (n, nv, 4, 4).

        Args:
            q: Joint positions, shape (n, nv) [rad or m].
        """
        q = np.asarray(q, float)
        theta = self.theta + np.where(self.revolute, q, 0.0)
        d = self.d + np.where(self.revolute, 0.0, q)
        return _pose(self.convention, theta, d, self.a, self.alpha)

    def frames(self, q: npt.ArrayLike) -> Array:
        """Pose in the base frame of frame 0 and of every link frame, shape (n, nv + 1, 4, 4)."""
        steps = self.poses(q)
        found = [np.broadcast_to(self.base, (len(steps), 4, 4))]
        for i in range(self.nv):
            found.append(found[-1] @ steps[:, i])
        return np.stack(found, axis=1)


def _pose(convention: Convention, theta: Array, d: Array, a: Array, alpha: Array) -> Array:
    theta, d, a, alpha = np.broadcast_arrays(theta, d, a, alpha)
    about_z, about_x = np.zeros((2, *theta.shape, 4, 4))
    for T, angle, (j, k), axis, shift in (
        (about_z, theta, (0, 1), 2, d),
        (about_x, alpha, (1, 2), 0, a),
    ):
        T[..., j, j] = T[..., k, k] = np.cos(angle)
        T[..., k, j], T[..., j, k] = np.sin(angle), -np.sin(angle)
        T[..., axis, axis] = T[..., 3, 3] = 1.0
        T[..., axis, 3] = shift
    pose: Array = about_z @ about_x if convention == "standard" else about_x @ about_z
    return pose


def inverse(T: Array) -> Array:
    """Inverse of rigid poses, shape (..., 4, 4)."""
    turn = np.swapaxes(T[..., :3, :3], -1, -2)
    found = np.zeros_like(T)
    found[..., :3, :3], found[..., 3, 3] = turn, 1.0
    found[..., :3, 3] = -(turn @ T[..., :3, 3:])[..., 0]
    return found


def moved_parameters(phi: npt.ArrayLike, T: npt.ArrayLike) -> Array:
    """Standard parameters of the same body about another frame, P ← T P Tᵀ.

    Args:
        phi: Standard parameters, shape (..., 10).
        T: Pose of the old frame in the new one, shape (..., 4, 4).

    Returns:
        Shape (..., 10); linear in ``phi``.
    """
    T = np.asarray(T, float)
    return from_pseudo_inertia(T @ pseudo_inertia(phi) @ np.swapaxes(T, -1, -2))


def joint_frames(chain: DHChain) -> Array:
    """Pose of every link's Denavit-Hartenberg frame in its joint frame, shape (nv, 4, 4).

    The joint frame sits on the link's own joint and has its axis as z: what a URDF and
    Pinocchio call the link. It is the link frame itself in the modified convention, and frame
    i − 1 carried along by joint i in the standard one.
    """
    if chain.convention == "modified":
        return np.tile(np.eye(4), (chain.nv, 1, 1))
    inner: Array = chain.poses(np.zeros((1, chain.nv)))[0]
    return inner


def parameter_map(chain: DHChain) -> Array:
    """B with φ(joint frames) = B φ(link frames), shape (10 nv, 10 nv)."""
    B = np.zeros((10 * chain.nv, 10 * chain.nv))
    for i, T in enumerate(joint_frames(chain)):
        part = slice(10 * i, 10 * i + 10)
        B[part, part] = moved_parameters(np.eye(10), T).T
    return B


def chain_through_axes(
    points: Array, axes: Array, tip: Array, convention: Convention
) -> tuple[Array, tuple[Array, Array, Array, Array]]:
    """Denavit-Hartenberg frames and numbers of joints whose axes are known at q = 0.

    Frame 0 lies on the first axis where the base is nearest, frame nv on the last axis where
    the tip is nearest. Axes closer than 1e-5 rad to parallel are taken as parallel, because
    their common normal is too far away to keep the digits of an inertia.

    Args:
        points: A point of each axis in the base frame, shape (nv, 3) [m].
        axes: Unit vectors along the axes, the positive way, shape (nv, 3).
        tip: Origin of the tool, shape (3,) [m].
        convention: ``"standard"`` or ``"modified"``.

    Returns:
        Frames 0 to nv at q = 0, shape (nv + 1, 4, 4), and (a, d, alpha, theta), each (nv,).
    """
    first = _across(axes[0])
    origin = _nearest(points[0], axes[0], np.zeros(3))
    frames, x = [_frame(axes[0], first, origin)], first
    for i in range(len(axes) - 1):
        near, far, x = _common_normal(origin, points[i + 1], axes[i], axes[i + 1], x)
        here = (axes[i + 1], far) if convention == "standard" else (axes[i], near)
        frames.append(_frame(here[0], x, here[1]))
        origin = far
    frames.append(_frame(axes[-1], x, _nearest(points[-1], axes[-1], tip)))
    found = np.array(frames)
    steps = inverse(found[:-1]) @ found[1:]
    numbers = _numbers(steps, convention)
    return found, numbers


def _nearest(point: Array, axis: Array, to: Array) -> Array:
    nearest: Array = point + axis * (axis @ (to - point))
    return nearest


def _across(axis: Array) -> Array:
    """A unit vector across an axis, along the base's x if that is possible."""
    base = np.eye(3)[0 if abs(axis[0]) < 0.9 else 1]
    across = base - axis * (axis @ base)
    unit: Array = across / np.linalg.norm(across)
    return unit


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
        gap = far - origin
        length = float(np.linalg.norm(gap))
        return origin, far, gap / length if length > _ZERO else before
    x = cross / sine
    gap = point - origin
    along, back = (np.cross(gap, v) @ cross / sine**2 for v in (other, axis))
    near, far = origin + along * axis, point + back * other
    return near, far, -x if gap @ x < -_ZERO else x


def _frame(z: Array, x: Array, origin: Array) -> Array:
    x = x - z * (x @ z)
    x = x / np.linalg.norm(x)
    T = np.eye(4)
    T[:3, :4] = np.column_stack([x, np.cross(z, x), z, origin])
    return T


def _numbers(T: Array, convention: Convention) -> tuple[Array, Array, Array, Array]:
    """(a, d, alpha, theta) of poses that have Denavit-Hartenberg form, each shape (nv,)."""
    R, p = T[:, :3, :3], T[:, :3, 3]
    if convention == "standard":
        theta, alpha = np.arctan2(R[:, 1, 0], R[:, 0, 0]), np.arctan2(R[:, 2, 1], R[:, 2, 2])
        a, d = p[:, 0] * np.cos(theta) + p[:, 1] * np.sin(theta), p[:, 2]
    else:
        theta = np.arctan2(0.0 - R[:, 0, 1], R[:, 0, 0])
        alpha = np.arctan2(0.0 - R[:, 1, 2], R[:, 2, 2])
        a, d = p[:, 0], p[:, 2] * np.cos(alpha) - p[:, 1] * np.sin(alpha)
    a, d, alpha, theta = (np.where(np.abs(v) < _ZERO, 0.0, v) for v in (a, d, alpha, theta))
    return a, d, alpha, theta


def with_convention(chain: DHChain, convention: Convention) -> DHChain:
    """The same arm in the other convention, with the same joint angles and torques."""
    if chain.convention == convention:
        return chain
    old = chain.frames(np.zeros((1, chain.nv)))[0]
    on = old[:-1] if chain.convention == "standard" else old[1:]
    tip = old[-1] @ chain.tool
    new, numbers = chain_through_axes(on[:, :3, 3], on[:, :3, 2], tip[:3, 3], convention)
    moves = inverse(new[1:]) @ old[1:]
    a, d, alpha, theta = numbers
    return replace(
        chain,
        convention=convention,
        a=a,
        d=d,
        alpha=alpha,
        theta=theta,
        phi=moved_parameters(chain.phi.reshape(-1, 10), moves).ravel(),
        base=new[0],
        tool=inverse(new[-1:])[0] @ tip,
        shapes=tuple(_moved_shape(s, moves[s.link - 1] if s.link else None) for s in chain.shapes),
    )


def _moved_shape(shape: Cylinder, T: Array | None) -> Cylinder:
    if T is None:
        return shape
    start, end = (tuple(T[:3, :3] @ x + T[:3, 3]) for x in (shape.start, shape.end))
    return replace(shape, start=start, end=end)
