"""Links as a description states them, and an arm as points, axes and solids to be drawn."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
import pinocchio as pin

from excitant.robots.chains import tree
from excitant.robots.motion import Array
from excitant.robots.robot import Robot

_POSES = 300  # tried for one in which the arm does not hide itself
_BEND = 1.9  # rad, either way, of those
_BELOW = 0.5  # how strongly points under the base count against a pose


@dataclass(frozen=True, eq=False)
class Shape:
    """A solid of a link: box, sphere, or cylinder (a capsule counts as one).

    Attributes:
        start: One end of its axis in the link frame, shape (3,) [m].
        end: The other end; the same point for a sphere.
        radius: Around the axis; of a box, half its mean width [m].
        corners: Corners of a box around it in the link frame, shape (8, 3) [m].
        volume: Volume [m³].
        spread: Second moment per volume about its centre, in the link frame, (3, 3) [m²].
    """

    start: Array
    end: Array
    radius: float
    corners: Array
    volume: float
    spread: Array


@dataclass(frozen=True, eq=False)
class Body:
    """A link of a description, in its own frame.

    Attributes:
        link: Its name.
        carrier: The moving link it is fixed to, itself included; empty for what stands still.
        given: Whether the description states an inertia.
        mass: Mass [kg].
        com: Centre of mass, shape (3,) [m].
        inertia: Tensor about the centre of mass as given, shape (3, 3) [kg·m²].
        points: Its origin and the origins of the joints on it, shape (k, 3) [m].
        shapes: Its solids; meshes are not among them.
    """

    link: str
    carrier: str
    given: bool
    mass: float
    com: Array
    inertia: Array
    points: Array
    shapes: tuple[Shape, ...]

    @property
    def box(self) -> tuple[Array, Array]:
        """Least and greatest coordinates of joints and solids, each of shape (3,) [m]."""
        every = np.concatenate([self.points, *(shape.corners for shape in self.shapes)])
        return every.min(axis=0), every.max(axis=0)

    @property
    def size(self) -> float:
        """Diagonal of the box around joints and solids [m]."""
        low, high = self.box
        return float(np.linalg.norm(high - low))

    @property
    def second_moment(self) -> Array:
        """Second moment per mass about the centre of mass, ½ tr(I)/m 1 − I/m, (3, 3) [m²]."""
        moment = 0.5 * np.trace(self.inertia) * np.eye(3) - self.inertia
        return np.asarray(moment / self.mass)

    @property
    def solid_second_moment(self) -> Array | None:
        """Second moment per mass of the solids if of one density, (3, 3); None without any."""
        if not self.shapes:
            return None
        weights = np.array([shape.volume for shape in self.shapes])
        weights = weights / weights.sum()
        offsets = np.array([(shape.start + shape.end) / 2 for shape in self.shapes])
        offsets = offsets - weights @ offsets
        spreads = np.array([shape.spread for shape in self.shapes])
        moment: Array = np.einsum(
            "k,kij->ij", weights, spreads + offsets[:, :, None] * offsets[:, None]
        )
        return moment


def bodies(robot: Robot) -> tuple[Body, ...]:
    """The links of an arm that its joints move or that stand under it, from the base outward."""
    root = ET.fromstring(robot.urdf)
    named = tree(root, robot.source)
    under = [joint.parent for joint in named.ancestors(robot.links[0])]
    found = []
    for link in root.findall("link"):
        name = str(link.get("name"))
        carrier = named.carrier(name, robot.links)
        if carrier or name in under:
            joints = [
                origin(joint).translation
                for joint in root.findall("joint")
                if named.joints[str(joint.get("name"))].parent == name
            ]
            shapes = tuple(_shapes(link))
            found.append(
                Body(name, carrier, *_inertia(link), np.array([np.zeros(3), *joints]), shapes)
            )
    order = {link: k for k, link in enumerate(robot.links)}
    return tuple(sorted(found, key=lambda body: order.get(body.carrier, -1)))


def _inertia(link: ET.Element) -> tuple[bool, float, Array, Array]:
    """Whether a link states one, its mass, centre and tensor about it in the link's axes."""
    inertial = link.find("inertial")
    if inertial is None:
        return False, 0.0, np.zeros(3), np.zeros((3, 3))
    place = origin(inertial)
    mass = float(_attribute(inertial, "mass", "value") or 0.0)
    xx, xy, xz, yy, yz, zz = (
        float(_attribute(inertial, "inertia", f"i{key}") or 0.0)
        for key in ("xx", "xy", "xz", "yy", "yz", "zz")
    )
    tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return True, mass, place.translation, place.rotation @ tensor @ place.rotation.T


def _attribute(element: ET.Element, child: str, key: str) -> str | None:
    found = element.find(child)
    return None if found is None else found.get(key)


def origin(element: ET.Element) -> pin.SE3:
    """Placement that an element's ``<origin xyz rpy>`` states; none is the identity."""
    xyz, rpy = (
        np.array([float(x) for x in (_attribute(element, "origin", key) or "0 0 0").split()])
        for key in ("xyz", "rpy")
    )
    return pin.SE3(pin.rpy.rpyToMatrix(*rpy), xyz)


def _shapes(link: ET.Element) -> Iterator[Shape]:
    """Solids of the collision elements; of the visual ones where there are none."""
    for kind in ("collision", "visual"):
        found = [shape for e in link.findall(kind) if (shape := _shape(e)) is not None]
        if found:
            yield from found
            return


def _shape(element: ET.Element) -> Shape | None:
    solid = element.find("geometry/*")
    if solid is None:
        return None
    if solid.tag == "sphere":
        r = float(solid.get("radius", "0"))
        half, volume, variance, axis = np.full(3, r), 4.19 * r**3, np.full(3, r * r / 5), 0.0
    elif solid.tag in ("cylinder", "capsule"):
        r, length = float(solid.get("radius", "0")), float(solid.get("length", "0"))
        beyond = r if solid.tag == "capsule" else 0.0
        half, volume = np.array([r, r, length / 2 + beyond]), np.pi * r * r * length
        variance, axis = np.array([r * r / 4, r * r / 4, length**2 / 12]), length
    elif solid.tag == "box":
        half = np.array([float(x) for x in solid.get("size", "0 0 0").split()]) / 2
        volume, variance, axis = 8 * float(half.prod()), half**2 / 3, 2 * float(half[2])
        r = float(half[:2].mean())
    else:
        return None
    if volume <= 0:
        return None
    place = origin(element)
    R, c = place.rotation, place.translation
    corners = c + (np.array(list(product((-1, 1), repeat=3))) * half) @ R.T
    tip = R[:, 2] * axis / 2
    return Shape(c - tip, c + tip, r, corners, volume, (R * variance) @ R.T)


def zero_pose(robot: Robot) -> Array:
    """Zero, or the end of a joint's range that is nearest to it, shape (nv,) [rad or m]."""
    return np.clip(np.zeros(robot.nv), *robot.limits.position.T)


def bent_pose(robot: Robot) -> Array:
    """A pose that keeps the joints apart in a picture, always the same, shape (nv,) [rad or m]."""
    low, high = np.clip(robot.limits.position, -_BEND, _BEND).T
    low, high = np.minimum(low, robot.limits.position[:, 1]), np.maximum(low, high)
    poses = np.random.default_rng(0).uniform(low, high, (_POSES, robot.nv))
    poses[:, 0] = np.clip(0.3, *robot.limits.position[0])
    best: Array = poses[int(np.argmax([_clarity(_points(robot, q)) for q in poses]))]
    return best


def _clarity(points: Array) -> float:
    """Least distance of joints that are not neighbours, relative to the arm, less what is low."""
    gaps = np.linalg.norm(points[:, None] - points[None], axis=2)[np.triu_indices(len(points), 2)]
    size = max(float(gaps.max(initial=0.0)), 1e-9)
    meant = gaps[gaps > 1e-3 * size]  # joints that meet in a point do so in every pose
    below = float(min(points[:, 2].min(), 0.0))
    return (float(meant.min(initial=size)) + _BELOW * below) / size


def _points(robot: Robot, q: Array) -> Array:
    model, data = robot.model, robot.model.createData()
    pin.framesForwardKinematics(model, data, q)
    joints = [data.oMi[j].translation.copy() for j in range(1, robot.nv + 1)]
    return np.array([np.zeros(3), *joints, data.oMf[robot.tip].translation.copy()])


def sketch(robot: Robot, q: Array) -> dict[str, Array]:
    """An arm in a pose, shape (nv,) [rad or m], in the base frame.

    Returns:
        ``pose``; ``points``, base, joints and tool, shape (nv + 2, 3) [m]; ``axes``, directions of
        the joints, shape (nv, 3); ``solids``, number of the joint that carries each (0 for the
        base), both ends of its axis and its radius, shape (k, 8) [m].
    """
    model, data = robot.model, robot.model.createData()
    axes = robot.axes(q, data)
    pin.updateFramePlacements(model, data)
    solids = []
    for body in bodies(robot):
        frame = data.oMf[model.getFrameId(body.link, pin.FrameType.BODY)]
        joint = robot.links.index(body.carrier) + 1 if body.carrier else 0
        for shape in body.shapes:
            solids.append([joint, *frame.act(shape.start), *frame.act(shape.end), shape.radius])
    found = np.array(solids) if solids else np.empty((0, 8))
    return {
        "pose": np.asarray(q, float),
        "points": _points(robot, q),
        "axes": axes,
        "solids": found,
    }
