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

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal
from xml.etree.ElementTree import Element, SubElement

import msgspec
import numpy as np
import numpy.typing as npt
import pinocchio as pin

from excitant.exceptions import BadRobot
from excitant.robots.angles import Angles
from excitant.robots.limits import Limits
from excitant.robots.motion import Array, Mask, Noun
from excitant.robots.parameters import elements, moved_parameters, steiner
from excitant.robots.robot import Robot
from excitant.robots.schema import (
    CylinderRecord,
    DHRecord,
    PlaceRecord,
    RobotRecord,
)
from excitant.robots.urdf import GRAVITY, robot_from_urdf
from excitant.robots.urdf_writer import (
    collision,
    inertial_element,
    joint_element,
    limits_in_urdf,
    urdf_text,
)

Convention = Literal["standard", "modified"]
CONVENTIONS = ("standard", "modified")


@dataclass(frozen=True, eq=False)
class DHChain(Noun):
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
        shapes: Collision shapes of the base, in the base frame, and of every link; or none.
    """

    name: str
    convention: Convention
    joints: tuple[str, ...]
    links: tuple[str, ...]
    revolute: Mask
    a: Array
    d: Array
    alpha: Array
    theta: Array
    phi: Array
    gravity: Array
    base: Array
    tool: Array
    shapes: tuple[tuple[CylinderRecord, ...], ...] = ()

    @property
    def nv(self) -> int:
        """Number of joints."""
        return len(self.joints)

    def poses(self, q: npt.ArrayLike) -> Array:
        """Pose of every link frame in the one before, shape (n, nv, 4, 4).

        Args:
            q: Joint positions, shape (n, nv) [rad or m].
        """
        q = np.asarray(q, float)
        about_z = _screw(
            2, self.theta + q * self.revolute, self.d + q * ~self.revolute
        )
        about_x = _screw(0, self.alpha + 0 * q, self.a + 0 * q)
        if self.convention == "standard":
            return about_z @ about_x
        return about_x @ about_z


def _screw(axis: int, angle: Array, shift: Array) -> Array:
    """Turns about x (0) or z (2) and shifts along it, shape (..., 4, 4)."""
    T = np.zeros((*angle.shape, 4, 4)) + np.eye(4)
    j, k = {0: (1, 2), 2: (0, 1)}[axis]
    T[..., j, j] = T[..., k, k] = np.cos(angle)
    T[..., k, j] = np.sin(angle)
    T[..., j, k] = -np.sin(angle)
    T[..., axis, 3] = shift
    return T


def joint_frames(chain: DHChain) -> Array:
    """Pose of every link's Denavit-Hartenberg frame in its joint frame, shape (nv, 4, 4).

    The joint frame sits on the link's own joint and has its axis as z: what a URDF and
    Pinocchio call the link. It is the link frame itself in the modified convention, and frame
    i − 1 carried along by joint i in the standard one.
    """
    if chain.convention == "modified":
        return np.tile(np.eye(4), (chain.nv, 1, 1))
    return chain.poses(np.zeros((1, chain.nv)))[0]


def robot_from_dh(chain: DHChain, limits: Limits | None = None) -> Robot:
    """The chain as a robot whose links sit in their joint frames; q means the same.

    Args:
        chain: The chain; its masses not zero.
        limits: Limits, written into the URDF too; none when not given.

    Raises:
        BadRobot: A link without mass, or names that occur twice.
    """
    robot = robot_from_urdf(
        urdf_of_chain(chain, chain.name), chain.name, gravity=chain.gravity
    )
    return robot if limits is None else limits_in_urdf(robot.with_limits(limits))


def urdf_of_chain(chain: DHChain, source: str) -> str:
    """URDF of a chain without limits: links in their joint frames, shapes, tool."""
    root = Element("robot", name=chain.name)
    steps = chain.poses(np.zeros((1, chain.nv)))[0]
    inner = joint_frames(chain)
    bodies = moved_parameters(chain.phi.reshape(-1, 10), inner)
    base, tool, flange = (
        _unused(name, chain) for name in ("base", "tool", "flange")
    )
    links = [SubElement(root, "link", name=base)]
    place = chain.base
    for i, (joint, link) in enumerate(zip(chain.joints, chain.links, strict=True)):
        if bodies[i, 0] == 0:
            raise BadRobot(
                source, f"link '{link}' has no mass; give one, even if only assumed"
            )
        kind = "continuous" if chain.revolute[i] else "prismatic"
        start = place if chain.convention == "standard" else place @ steps[i]
        element = joint_element(
            root, joint, kind, links[-1].attrib["name"], link, start
        )
        SubElement(element, "axis", xyz="0 0 1")
        SubElement(element, "limit", velocity="0", effort="0")
        links.append(SubElement(root, "link", name=link))
        links[-1].append(inertial_element(bodies[i]))
        place = inner[i]
    joint_element(root, flange, "fixed", chain.links[-1], tool, place @ chain.tool)
    SubElement(root, "link", name=tool)
    frames = (np.eye(4), *inner)
    for element, frame, shapes in zip(links, frames, chain.shapes, strict=False):
        element.extend(_collision(shape, pin.SE3(frame)) for shape in shapes)
    return urdf_text(root)


def _unused(name: str, chain: DHChain) -> str:
    while name in chain.links or name in chain.joints:
        name += "_"
    return name


def _collision(shape: CylinderRecord, frame: pin.SE3) -> Element:
    """A cylinder along z turned onto the line between both ends, or a sphere."""
    start, end = (frame.act(np.array(x)) for x in (shape.start, shape.end))
    length = float(np.linalg.norm(end - start))
    centre = (start + end) / 2
    radius = repr(float(shape.radius))
    if length == 0:
        return collision(pin.SE3(np.eye(3), centre), "sphere", radius=radius)
    z = (end - start) / length
    y = np.cross(z, np.eye(3)[int(np.argmin(np.abs(z)))])
    y = y / np.linalg.norm(y)
    place = pin.SE3(np.column_stack([np.cross(y, z), y, z]), centre)
    return collision(place, "cylinder", radius=radius, length=repr(length))


def chain_from_record(record: RobotRecord, source: str, angles: Angles) -> DHChain:
    """The chain that a ``robot.yaml`` describes; see the module for its form.

    Args:
        record: The file's entries, with ``dh``.
        source: The file, for messages; its stem is the arm's name where the file gives none.
        angles: Told which angles in radians are taken as multiples of 15°.

    Raises:
        BadRobot: Entries that contradict one another, or no convention; names the link.
    """
    rows = record.dh or ()
    if record.convention is None:
        raise BadRobot(
            source, "'convention: None' must be one of standard, modified"
        )

    def radians(values: Sequence[float]) -> Array:
        if record.angles == "degrees":
            return np.radians(values)
        return angles.exact(values)

    links = [str(row.link or f"link{i}") for i, row in enumerate(rows, start=1)]
    joints = [str(row.joint or f"joint{i}") for i, row in enumerate(rows, start=1)]
    base = record.base if isinstance(record.base, PlaceRecord) else PlaceRecord()
    tool = record.tool or PlaceRecord()
    return DHChain(
        name=str(record.name or Path(source).stem),
        convention=record.convention,
        joints=tuple(joints),
        links=tuple(links),
        revolute=np.array([row.type == "revolute" for row in rows]),
        a=np.array([row.a for row in rows]),
        d=np.array([row.d for row in rows]),
        alpha=radians([row.alpha for row in rows]),
        theta=radians([row.theta for row in rows]),
        phi=np.concatenate(
            [_phi(row, n, source) for row, n in zip(rows, links, strict=True)]
        ),
        gravity=np.array(record.gravity or GRAVITY),
        base=_place(base.position, radians(base.rpy)),
        tool=_place(tool.position, radians(tool.rpy)),
        shapes=(base.collision or (), *(row.collision or () for row in rows)),
    )


def _phi(row: DHRecord, link: str, source: str) -> Array:
    """Standard parameters about the link frame, shape (10,)."""
    for one, other in (("com", "mc"), ("I", "Ic")):
        if getattr(row, one) is not None and getattr(row, other) is not None:
            raise BadRobot(
                source, f"{link}: both '{one}' and '{other}' are given; keep one"
            )
    tensor = row.I or row.Ic
    if tensor is None:
        raise BadRobot(
            source,
            f"{link}: give the inertia as 'I: {{xx: .., yy: .., zz: .., xy: ..}}' about the link "
            "frame, or as 'Ic' about the centre of mass",
        )
    mc = np.array(row.mc or (0.0, 0.0, 0.0))
    if row.com is not None:
        mc = row.m * np.array(row.com)
    about = np.array(msgspec.structs.astuple(tensor))
    if row.I is None:
        about = about + elements(steiner(row.m, mc / row.m))
    return np.concatenate([[row.m], mc, about])


def _place(position: Sequence[float], rpy: Array) -> Array:
    return pin.SE3(pin.rpy.rpyToMatrix(*rpy), np.array(position)).homogeneous
