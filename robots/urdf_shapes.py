"""Bodies, shapes and meshes that a URDF states, and the writing of a URDF: the format of robots."""

import os
from functools import lru_cache
from itertools import product
from os.path import isfile
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, fromstring, tostring

import numpy as np
import pinocchio as pin

from excitant.exceptions import BadRobot
from excitant.files import real_path
from excitant.robots.chains import tree
from excitant.robots.files import package_folders, ros_folders, within
from excitant.robots.geometry import Body, Shape
from excitant.robots.meshes import Mesh, hulls
from excitant.robots.motion import Array
from excitant.robots.robot import Robot
from excitant.robots.urdf_model import build_model, held_pose, quietly
from excitant.robots.urdf_writer import (
    child_attribute,
    current_urdf,
    floats,
    stated_joints,
    stated_place,
)

_LARGEST_MESH = 500_000_000  # bytes


class UrdfFormat:
    """What a URDF says of the robot that was read from it, and the robot does not hold."""

    def written(self, robot: Robot) -> str:
        """URDF text of the robot as it is now."""
        as_read = robot.described and not robot.locked
        return robot.description if as_read else current_urdf(robot)

    def bodies(self, robot: Robot) -> tuple[Body, ...]:
        """Links that the joints move or that stand under them, from the base outward."""
        root = fromstring(robot.description)
        named = tree(root, robot.source)
        under = [joint.parent for joint in named.ancestors(robot.links[0])]
        origins: dict[str, list[Array]] = {}
        for name, joint in stated_joints(root).items():
            points = origins.setdefault(named.joints[name].parent, [np.zeros(3)])
            points.append(stated_place(joint).translation)
        bodies = []
        for link in root.findall("link"):
            name = link.attrib["name"]
            carrier = named.carrier(name, robot.links)
            if carrier or name in under:
                points = origins.get(name, [np.zeros(3)])
                kinds = (link.findall(kind) for kind in ("collision", "visual"))
                solids = (tuple(filter(None, map(_shape, kind))) for kind in kinds)
                shapes = next(filter(None, solids), ())
                bodies.append(
                    Body(name, carrier, *_inertia(link), np.array(points), shapes)
                )
        order = ["", *robot.links]
        return tuple(sorted(bodies, key=lambda body: order.index(body.carrier)))

    @staticmethod
    @lru_cache(maxsize=8)
    def solids(robot: Robot, kind: str) -> Any:
        """Collision or visual shapes as Pinocchio's geometry model; never edited.

        Meshes are hulls, those that are missing left out.

        Raises:
            BadRobot: A mesh is damaged.
        """
        root = fromstring(robot.description)
        meshes, _, _ = _take_meshes(root, robot, kind)
        shapes = dict(
            zip(meshes, hulls([*meshes.values()], robot.source), strict=True)
        )
        model = build_model(root, robot.source)
        locked, reference = held_pose(model, dict(robot.locked))
        text = tostring(root, encoding="unicode")
        wanted = getattr(pin.GeometryType, kind.upper())
        with quietly(robot.source):
            geometry = pin.buildGeomFromUrdfString(model, text, wanted)
        for body in geometry.geometryObjects:
            body.geometry = shapes.get(body.name, body.geometry)
        if locked:
            _, (geometry,) = pin.buildReducedModel(
                model, [geometry], locked, reference
            )
        return geometry

    def carriers(self, robot: Robot, kind: str) -> set[str]:
        """Moving links that carry collision or visual shapes; empty for what stands still."""
        root = fromstring(robot.description)
        named = tree(root, robot.source)
        links = root.findall(f"link[{kind}]")
        return {named.carrier(link.attrib["name"], robot.links) for link in links}

    def count_shapes(self, robot: Robot, kind: str) -> tuple[int, int, int]:
        """Number of shapes, of those whose mesh is not there, and is where it may not be read."""
        root = fromstring(robot.description)
        stated = len(root.findall(f"link/{kind}"))
        _, missing, outside = _take_meshes(root, robot, kind)
        return stated, missing, outside


URDF = UrdfFormat()


def _inertia(link: Element) -> tuple[bool, float, Array, Array]:
    """Whether a link states one, its mass, centre and tensor about it in the link's axes."""
    inertial = link.find("inertial")
    if inertial is None:
        return False, 0.0, np.zeros(3), np.zeros((3, 3))
    place = stated_place(inertial)
    mass = float(child_attribute(inertial, "mass", "value", "0"))
    xx, xy, xz, yy, yz, zz = (
        float(child_attribute(inertial, "inertia", f"i{axes}", "0"))
        for axes in ("xx", "xy", "xz", "yy", "yz", "zz")
    )
    tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return True, mass, place.translation, place.rotation @ tensor @ place.rotation.T


def _shape(element: Element) -> Shape | None:
    """The solid of a collision or visual element; None for meshes and what has no volume."""
    solid = element.find("geometry/*")
    if solid is None:
        return None
    r = float(solid.get("radius", "0"))
    length = float(solid.get("length", "0"))
    box = floats(solid.get("size", "0 0 0")) / 2
    variance = np.array([r * r / 4, r * r / 4, length**2 / 12])
    bar = np.array([r, r, length / 2]), np.pi * r * r * length, variance
    known = {  # half the extents, volume, variances
        "sphere": (np.full(3, r), 4.19 * r**3, np.full(3, r * r / 5)),
        "cylinder": bar,
        "capsule": (bar[0] + [0, 0, r], *bar[1:]),
        "box": (box, 8 * box.prod(), box**2 / 3),
    }
    half, volume, variance = known.get(solid.tag, (box, 0.0, box))
    if volume <= 0:
        return None
    place = stated_place(element)
    R = place.rotation
    c = place.translation
    corners = c + (np.array(list(product((-1, 1), repeat=3))) * half) @ R.T
    return Shape(c, corners, float(volume), (R * variance) @ R.T)


def _take_meshes(
    root: Element, robot: Robot, kind: str
) -> tuple[dict[str, Mesh], int, int]:
    """Put a sphere in place of each mesh, and remove shapes whose mesh is not there.

    Returns:
        The meshes, by what Pinocchio calls the shapes; the number of those that are not there, and
        of them those that lie where the description may not reach.
    """
    meshes: dict[str, Mesh] = {}
    missing = outside = 0
    for link in root.findall("link"):
        k = 0  # of the shapes that remain
        for element in link.findall(kind):
            if (mesh := element.find("geometry/mesh")) is not None:
                path = None
                try:
                    path = _mesh_file(str(mesh.get("filename")), robot)
                except BadRobot:
                    outside += 1
                if path is None:
                    missing += 1
                    link.remove(element)
                    continue
                x, y, z = floats(mesh.get("scale", "1 1 1")).tolist()
                meshes[f"{link.attrib['name']}_{k}"] = (path, (x, y, z))
                element[:] = [_BALL, *element.findall("origin")]
            k += 1
    return meshes, missing, outside


_BALL = fromstring('<geometry><sphere radius="1"/></geometry>')


def _mesh_file(name: str, robot: Robot) -> Path | None:
    """File of a mesh: beside the description, in a package that holds it, or in one of ROS.

    Raises:
        BadRobot: It is there, but where the description may not reach.
    """
    if not name.startswith("package://"):
        path = real_path(robot.source).parent / name.removeprefix("file://")
        return (
            within(path, robot.source, robot.packages) if _is_mesh(path) else None
        )
    package, _, inside = name.removeprefix("package://").partition("/")
    inside = os.path.normpath(inside)
    if inside.startswith(("..", os.sep)):
        return None
    for folder in package_folders(package, robot.source, robot.packages):
        path = real_path(folder / inside)
        if _is_mesh(path) and path.is_relative_to(folder):
            return path
    # an installed package may consist of links
    installed = (folder / inside for folder in ros_folders(package))
    return next(filter(_is_mesh, installed), None)


def _is_mesh(path: Path) -> bool:
    """Whether a path is that of a file of a size that meshes have."""
    try:
        return isfile(path) and path.stat().st_size < _LARGEST_MESH
    except (OSError, ValueError):  # a name that no file can have
        return False
