"""Denavit-Hartenberg chains: link frames by four numbers each, and inertias about those frames.

Two conventions are in use, for the pose of frame i in frame i − 1:

    standard (distal; Denavit & Hartenberg 1955, Paul 1981):   Rz(θ) Tz(d) Tx(a) Rx(α)
    modified (proximal; Craig 1986, Khalil & Kleinfinger 1986): Rx(α) Tx(a) Rz(θ) Tz(d)

In the standard one frame i sits at the far end of link i, on the axis of joint i + 1; in the
modified one at its near end, on the axis of joint i itself. Both are fixed to link i.

A ``robot.yaml`` gives an arm so::

    name: scara                  # the file's name when not given
    convention: standard         # or modified (Craig)
    angles: degrees              # of alpha, theta and rpy; radians when not given
    dh:                          # one entry per joint, from the base outward
      - {a: 0.4, alpha: 0, d: 0.3, theta: 0, type: revolute, joint: shoulder, link: upper_arm,
         m: 5.0, com: [-0.2, 0, 0], Ic: {xx: 0.01, yy: 0.07, zz: 0.07},
         collision: [{from: [-0.4, 0, 0], to: [0, 0, 0], radius: 0.05}]}
      - {a: 0.3, m: 3.0, mc: [-0.4, 0, 0], I: {xx: 0.01, yy: 0.1, zz: 0.1}}
    base: {position: [0, 0, 0.5], rpy: [0, 0, 0], collision: []}   # frame 0 in the base frame
    tool: {position: [0, 0, 0.1], rpy: [0, 0, 0]}                  # the tool in the last frame
    gravity: [0, 0, -9.81]                                         # in the base frame

Numbers left out are 0, ``type`` is ``revolute``, names are ``joint1``, ``link1``, and so on. In
the modified convention ``a`` and ``alpha`` are Craig's a_{i−1} and α_{i−1}. Every link needs its
mass ``m`` [kg]. Its centre of mass is ``com`` [m], or its first moment ``mc`` [kg·m]; its inertia
tensor [kg·m²] is ``I`` about the origin of the link frame, or ``Ic`` about the centre of mass,
both along the axes of the link frame, with products as tensor elements (xy is −∫ x y dm).
``limits``, ``lock``, ``joints`` and ``effects`` are as for any arm.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from excitant.exceptions import BadRobot
from excitant.robots.limits import Limits
from excitant.robots.motion import Array, freeze, read_only
from excitant.robots.parameters import elements, from_pseudo_inertia, pseudo_inertia, steiner
from excitant.robots.robot import Robot
from excitant.robots.schema import DHRecord, PlaceRecord, RobotRecord
from excitant.robots.urdf import (
    GRAVITY,
    collision,
    inertial_element,
    joint_element,
    limits_in_urdf,
    robot_from_urdf,
    urdf_text,
)

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


def dh_from_robot(robot: Robot, convention: Convention = "standard") -> DHChain:
    """The arm as a Denavit-Hartenberg chain with the same joint angles and torques.

    Locked joints stay where they are. Axes within 1e-5 rad of parallel are taken as parallel,
    which may change torques by as much; see `chain_through_axes`.

    Args:
        robot: A serial arm; its base and tool become ``base`` and ``tool`` of the chain.
        convention: ``"standard"`` or ``"modified"``.

    Raises:
        BadRobot: A joint that does not hang on the one before it.
    """
    model, data = robot.model, robot.model.createData()
    for j, parent in enumerate(list(model.parents)[1:]):
        if parent != j:
            raise BadRobot(
                robot.source,
                f"joint '{robot.joints[j]}' branches off; Denavit-Hartenberg frames need a "
                "serial arm, so keep the joints of one branch",
            )
    axes = robot.axes(np.zeros(robot.nv), data)
    pin.updateFramePlacements(model, data)
    poses = np.array([pose.homogeneous for pose in list(data.oMi)[1:]])
    tip = data.oMf[robot.tip].homogeneous
    frames, numbers = chain_through_axes(poses[:, :3, 3], axes, tip[:3, 3], convention)
    phi = moved_parameters(robot.phi.reshape(-1, 10), inverse(frames[1:]) @ poses).ravel()
    return DHChain(
        robot.name,
        convention,
        robot.joints,
        robot.links,
        robot.revolute,
        *numbers,
        phi,
        robot.gravity,
        base=frames[0],
        tool=inverse(frames[-1:])[0] @ tip,
    )


def robot_from_dh(chain: DHChain, limits: Limits | None = None, source: str | None = None) -> Robot:
    """The chain as a robot whose links sit in their joint frames.

    Args:
        chain: The chain; its masses not zero.
        limits: Limits, written into the URDF too; none when not given.
        source: Where the chain came from, for messages; its name when not given.

    Raises:
        BadRobot: A link without mass, or names that occur twice.
    """
    source = source or chain.name
    robot = robot_from_urdf(urdf_of_chain(chain, source), source, gravity=chain.gravity)
    return robot if limits is None else limits_in_urdf(robot.with_limits(limits))


def urdf_from_dh(chain: DHChain, limits: Limits | None = None) -> str:
    """URDF text of a chain; joints and links have the chain's names and q means the same."""
    return robot_from_dh(chain, limits).urdf


def urdf_of_chain(chain: DHChain, source: str) -> str:
    """URDF of a chain without limits: links in their joint frames, shapes, tool."""
    root = ET.Element("robot", name=chain.name)
    steps, inner = chain.poses(np.zeros((1, chain.nv)))[0], joint_frames(chain)
    bodies = moved_parameters(chain.phi.reshape(-1, 10), inner)
    base, tool, flange = (_unused(name, chain) for name in ("base", "tool", "flange"))
    links = [ET.SubElement(root, "link", name=base)]
    place = chain.base
    for i, (joint, link) in enumerate(zip(chain.joints, chain.links, strict=True)):
        if bodies[i, 0] == 0:
            raise BadRobot(source, f"link '{link}' has no mass; give one, even if only assumed")
        kind = "continuous" if chain.revolute[i] else "prismatic"
        start = place if chain.convention == "standard" else place @ steps[i]
        element = joint_element(root, joint, kind, links[-1].attrib["name"], link, start)
        ET.SubElement(element, "axis", xyz="0 0 1")
        ET.SubElement(element, "limit", velocity="0", effort="0")
        links.append(ET.SubElement(root, "link", name=link))
        links[-1].append(inertial_element(bodies[i]))
        place = inner[i]
    joint_element(root, flange, "fixed", chain.links[-1], tool, place @ chain.tool)
    ET.SubElement(root, "link", name=tool)
    for shape in chain.shapes:
        frame = inner[shape.link - 1] if shape.link else np.eye(4)
        links[shape.link].append(_collision(shape, frame))
    return urdf_text(root)


def _unused(name: str, chain: DHChain) -> str:
    while name in chain.links or name in chain.joints:
        name += "_"
    return name


def _collision(shape: Cylinder, frame: Array) -> ET.Element:
    """A cylinder along z turned onto the line between both ends, or a sphere."""
    start, end = (frame[:3, :3] @ np.array(x) + frame[:3, 3] for x in (shape.start, shape.end))
    length, centre, radius = float(np.linalg.norm(end - start)), (start + end) / 2, shape.radius
    if length == 0:
        return collision(pin.SE3(np.eye(3), centre), "sphere", radius=repr(float(radius)))
    z = (end - start) / length
    R = _frame(z, np.eye(3)[int(np.argmin(np.abs(z)))], centre)[:3, :3]
    numbers = {"radius": repr(float(radius)), "length": repr(length)}
    return collision(pin.SE3(R, centre), "cylinder", **numbers)


def chain_from_record(record: RobotRecord, source: str, name: str = "") -> DHChain:
    """The chain that a ``robot.yaml`` describes; see the module for its form.

    Args:
        record: The file's entries, with ``dh``.
        source: The file, for messages.
        name: Name of the arm where the file gives none.

    Raises:
        BadRobot: Entries that contradict one another, or no convention; names the link.
    """
    rows = record.dh or ()
    if record.convention is None:
        raise BadRobot(source, "'convention: None' must be one of standard, modified")
    unit = np.pi / 180 if record.angles == "degrees" else 1.0
    links = tuple(str(row.link or f"link{i}") for i, row in enumerate(rows, start=1))
    base = record.base if isinstance(record.base, PlaceRecord) else PlaceRecord()
    shapes = (base.collision, *(row.collision for row in rows))
    return DHChain(
        name=str(record.name or name or Path(source).stem),
        convention=record.convention,
        joints=tuple(str(row.joint or f"joint{i}") for i, row in enumerate(rows, start=1)),
        links=links,
        revolute=np.array([row.type == "revolute" for row in rows]),
        a=np.array([row.a for row in rows]),
        d=np.array([row.d for row in rows]),
        alpha=unit * np.array([row.alpha for row in rows]),
        theta=unit * np.array([row.theta for row in rows]),
        phi=np.concatenate([_phi(row, n, source) for row, n in zip(rows, links, strict=True)]),
        gravity=np.array(record.gravity or GRAVITY),
        base=_place(base, unit),
        tool=_place(record.tool or PlaceRecord(), unit),
        shapes=tuple(
            Cylinder(i, x.start, x.end, x.radius) for i, own in enumerate(shapes) for x in own or ()
        ),
    )


def _phi(row: DHRecord, link: str, source: str) -> Array:
    """Standard parameters about the link frame, shape (10,)."""
    for one, other in (("com", "mc"), ("I", "Ic")):
        if getattr(row, one) is not None and getattr(row, other) is not None:
            raise BadRobot(source, f"{link}: both '{one}' and '{other}' are given; keep one")
    tensor = row.I or row.Ic
    if tensor is None:
        raise BadRobot(
            source,
            f"{link}: give the inertia as 'I: {{xx: .., yy: .., zz: .., xy: ..}}' about the link "
            "frame, or as 'Ic' about the centre of mass",
        )
    mc = np.array(row.mc or (0.0, 0.0, 0.0)) if row.com is None else row.m * np.array(row.com)
    about = np.array(
        [
            [tensor.xx, tensor.xy, tensor.xz],
            [tensor.xy, tensor.yy, tensor.yz],
            [tensor.xz, tensor.yz, tensor.zz],
        ]
    )
    if row.I is None:
        c = mc / row.m
        about = about + steiner(row.m, c)
    return np.concatenate([[row.m], mc, elements(about)])


def _place(record: PlaceRecord, unit: float) -> Array:
    T = np.eye(4)
    T[:3, 3] = record.position
    T[:3, :3] = pin.rpy.rpyToMatrix(*(unit * np.array(record.rpy)))
    return T
