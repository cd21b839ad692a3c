"""Links as a description states them: inertia as given, and how far the link reaches."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import pinocchio as pin

from excitant.robots.motion import Array
from excitant.robots.robot import Robot


@dataclass(frozen=True, eq=False)
class Shape:
    """A solid of a link: box, sphere, or cylinder (a capsule counts as one).

    Attributes:
        link: The link it belongs to.
        start: One end of its axis in the link frame, shape (3,) [m].
        end: The other end; the same point for a sphere.
        radius: Around the axis; of a box, half its mean width [m].
        corners: Corners of a box around it in the link frame, shape (8, 3) [m].
        volume: Volume [m³].
        spread: Second moment per volume about its centre, in the link frame, (3, 3) [m²].
    """

    link: str
    start: Array
    end: Array
    radius: float
    corners: Array
    volume: float
    spread: Array

    @property
    def centre(self) -> Array:
        """Middle of the solid in the link frame, shape (3,) [m]."""
        return np.asarray((self.start + self.end) / 2)


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
    def solid(self) -> tuple[Array, Array] | None:
        """Centre and second moment per mass of the solids if of one density; None without."""
        if not self.shapes:
            return None
        weights = np.array([shape.volume for shape in self.shapes])
        weights = weights / weights.sum()
        centres = np.array([shape.centre for shape in self.shapes])
        mean = weights @ centres
        spread = sum(
            (w * (s.spread + np.outer(c - mean, c - mean))
             for w, s, c in zip(weights, self.shapes, centres, strict=True)),
            np.zeros((3, 3)),
        )  # fmt: skip
        return mean, np.asarray(spread)


def bodies(robot: Robot) -> tuple[Body, ...]:
    """The links of an arm that its joints move or that stand under it, from the base outward."""
    root = ET.fromstring(robot.urdf)
    parents = {str(_attribute(j, "child", "link")): j for j in root.findall("joint")}
    found = []
    for link in root.findall("link"):
        name = str(link.get("name"))
        carrier = _carrier(name, parents, robot.links)
        if carrier or _stands_under(name, parents, robot.links):
            found.append(_body(link, name, carrier, root))
    order = {link: k for k, link in enumerate(robot.links)}
    return tuple(sorted(found, key=lambda body: order.get(body.carrier, -1)))


def _attribute(element: ET.Element, child: str, key: str) -> str | None:
    found = element.find(child)
    return None if found is None else found.get(key)


def _carrier(link: str, parents: Mapping[str, ET.Element], moving: Sequence[str]) -> str:
    name: str | None = link
    while name is not None and name not in moving:
        joint = parents.get(name)
        name = None if joint is None else _attribute(joint, "parent", "link")
    return name or ""


def _stands_under(link: str, parents: Mapping[str, ET.Element], moving: Sequence[str]) -> bool:
    """Whether a link is on the way from the root to the first moving link."""
    name: str | None = moving[0]
    while name is not None and name in parents:
        name = _attribute(parents[name], "parent", "link")
        if name == link:
            return True
    return False


def _body(link: ET.Element, name: str, carrier: str, root: ET.Element) -> Body:
    inertial = link.find("inertial")
    mass, com, inertia = 0.0, np.zeros(3), np.zeros((3, 3))
    if inertial is not None:
        placement = origin(inertial)
        mass = float(_attribute(inertial, "mass", "value") or 0.0)
        com = placement.translation
        inertia = placement.rotation @ _tensor(inertial) @ placement.rotation.T
    joints = [
        origin(joint).translation
        for joint in root.findall("joint")
        if _attribute(joint, "parent", "link") == name
    ]
    return Body(
        link=name,
        carrier=carrier,
        given=inertial is not None,
        mass=mass,
        com=com,
        inertia=inertia,
        points=np.array([np.zeros(3), *joints]),
        shapes=tuple(_shapes(link, name)),
    )


def origin(element: ET.Element) -> pin.SE3:
    """Placement that an element's ``<origin xyz rpy>`` states; none is the identity."""
    xyz, rpy = (
        np.array([float(x) for x in (_attribute(element, "origin", key) or "0 0 0").split()])
        for key in ("xyz", "rpy")
    )
    return pin.SE3(pin.rpy.rpyToMatrix(*rpy), xyz)


def _tensor(inertial: ET.Element) -> Array:
    xx, xy, xz, yy, yz, zz = (
        float(_attribute(inertial, "inertia", f"i{key}") or 0.0)
        for key in ("xx", "xy", "xz", "yy", "yz", "zz")
    )
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _shapes(link: ET.Element, name: str) -> Iterator[Shape]:
    """Solids of the collision elements; of the visual ones where there are none."""
    for kind in ("collision", "visual"):
        found = [shape for e in link.findall(kind) if (shape := _shape(e, name)) is not None]
        if found:
            yield from found
            return


def _shape(element: ET.Element, link: str) -> Shape | None:
    geometry = element.find("geometry")
    solid = next(iter(geometry), None) if geometry is not None else None
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
    return Shape(link, c - tip, c + tip, r, corners, volume, (R * variance) @ R.T)
