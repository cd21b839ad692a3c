"""Where an arm's bodies are: collision shapes, obstacles, and the distances between them."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import yaml

from excitant.exceptions import BadInput
from excitant.robots.motion import Array
from excitant.robots.robot import Robot
from excitant.robots.urdf import full_model

_POSES = 200  # random ones, to tell pairs whose distance is a matter of drawing
_MOVING = 1e-3  # m: distances that change less do not change
_SHAPES = ("box", "sphere", "half_space", "workspace")
_KEYS = {
    "box": {"size": 3, "position": 3, "rpy": 3},
    "sphere": {"radius": 1, "position": 3},
    "half_space": {"normal": 3, "offset": 1},
    "workspace": {"low": 3, "high": 3},
}
_TOOL = "tool point"
_POINT = 1e-4  # m, radius of the sphere that stands for it


@dataclass(frozen=True)
class Obstacle:
    """A body that stands in the cell, in the base frame of the URDF.

    Attributes:
        name: Name for messages.
        shape: ``"box"``, ``"sphere"`` or ``"half_space"`` (all points x with n·x ≤ offset).
        values: ``size`` [m], ``position`` [m], ``rpy`` [rad], ``radius`` [m], ``normal``,
            ``offset`` [m] as the shape needs.
        tool_only: Whether only the tool point must keep away from it.
    """

    name: str
    shape: str
    values: tuple[tuple[str, tuple[float, ...]], ...]
    tool_only: bool = False

    def geometry(self) -> tuple[Any, Any]:
        """Shape and placement for Pinocchio."""
        v = {key: np.array(x) for key, x in self.values}
        if self.shape == "half_space":
            length = np.linalg.norm(v["normal"])
            plane = coal.Halfspace(v["normal"] / length, float(v["offset"][0] / length))
            return plane, pin.SE3.Identity()
        turn = pin.rpy.rpyToMatrix(*v.get("rpy", np.zeros(3)))
        shape = coal.Box(*v["size"]) if self.shape == "box" else coal.Sphere(float(v["radius"][0]))
        return shape, pin.SE3(turn, v["position"])


@dataclass(frozen=True, eq=False)
class Scene:
    """An arm's bodies among obstacles, with the pairs that must keep apart.

    Bodies on the same joint or on neighbouring joints are not paired.

    Attributes:
        robot: The arm.
        geometry: Pinocchio's geometry model; never edited.
        pairs: Names of both bodies of every pair.
    """

    robot: Robot
    geometry: Any
    pairs: tuple[tuple[str, str], ...]

    def distances(self, q: Array) -> Array:
        """Signed distance of every pair at every pose, shape (n, pairs) [m]."""
        model, data = self.robot.model, self.robot.model.createData()
        work = self.geometry.createData()
        found = np.empty((len(q), len(self.pairs)))
        for k, pose in enumerate(q):
            pin.computeDistances(model, data, self.geometry, work, pose)
            found[k] = [result.min_distance for result in work.distanceResults]
        return found

    def gradient(self, q: Array, pair: int) -> tuple[float, Array]:
        """Distance of one pair at one pose, and its derivative by q, shape (nv,) [m/rad]."""
        model, data = self.robot.model, self.robot.model.createData()
        work = self.geometry.createData()
        pin.computeJointJacobians(model, data, q)
        pin.updateGeometryPlacements(model, data, self.geometry, work)
        result = pin.computeDistance(self.geometry, work, pair)
        points = result.getNearestPoint1(), result.getNearestPoint2()
        ends = self.geometry.collisionPairs[pair]
        bodies = [self.geometry.geometryObjects[i].parentJoint for i in (ends.first, ends.second)]
        first, second = (_velocity(model, data, j, p) for j, p in zip(bodies, points, strict=True))
        normal = np.array(result.normal)  # from the first body to the second
        return float(result.min_distance), normal @ (second - first)

    def speeds(self) -> Array:
        """Bound on the change of each pair's distance by each joint, (pairs, nv) [m/rad].

        A joint between both bodies moves no point of the outer one faster than its distance
        from the joint, at most the stretched arm's.
        """
        reach = _reaches(self)
        bounds = np.zeros((len(self.pairs), self.robot.nv))
        for k, ends in enumerate(self.geometry.collisionPairs):
            for i in (ends.first, ends.second):
                body = self.geometry.geometryObjects[i]
                for j in _supports(self.robot.model, body.parentJoint):
                    bounds[k, j - 1] = max(bounds[k, j - 1], reach[i, j - 1])
            common = set(_supports(self.robot.model, self._joint(ends.first)))
            common &= set(_supports(self.robot.model, self._joint(ends.second)))
            bounds[k, [j - 1 for j in common]] = 0.0
        return np.where(self.robot.revolute, bounds, np.minimum(bounds, 1.0) * (bounds > 0))

    def _joint(self, body: int) -> int:
        return int(self.geometry.geometryObjects[body].parentJoint)


def _supports(model: Any, joint: int) -> list[int]:
    """The joints that carry a joint's body, itself included, without the universe."""
    return [int(j) for j in list(model.supports[joint]) if j > 0]


def _velocity(model: Any, data: Any, joint: int, point: Array) -> Array:
    """Velocity of a point of a joint's body by joint velocity, shape (3, nv)."""
    if joint == 0:
        return np.zeros((3, model.nv))
    J = pin.getJointJacobian(model, data, joint, pin.LOCAL_WORLD_ALIGNED)
    lever = np.asarray(point) - data.oMi[joint].translation
    moved: Array = J[:3] - pin.skew(lever) @ J[3:]
    return moved


def _reaches(scene: Scene) -> Array:
    """Largest distance of each body's points from each supporting joint, (bodies, nv) [m]."""
    model, objects = scene.robot.model, scene.geometry.geometryObjects
    reach = np.zeros((len(objects), scene.robot.nv))
    slide = np.where(scene.robot.revolute, 0.0, np.abs(scene.robot.limits.position).max(axis=1))
    for i, body in enumerate(objects):
        if body.parentJoint == 0:
            continue
        body.geometry.computeLocalAABB()
        length = float(np.linalg.norm(body.placement.translation))
        length += float(np.linalg.norm(body.geometry.aabb_center)) + body.geometry.aabb_radius
        for j in reversed(_supports(model, body.parentJoint)):
            reach[i, j - 1] = length
            length += float(np.linalg.norm(model.jointPlacements[j].translation)) + slide[j - 1]
    return reach


def scene(
    robot: Robot, obstacles: Sequence[Obstacle] = (), package_dirs: Sequence[str] = ()
) -> Scene | None:
    """Collision scene of a robot; None when no motion can bring two of its shapes together.

    Meshes that are not found are left out, and so are pairs of the arm's own bodies that overlap
    at every pose or whose distance never changes: no motion can do anything about them.

    Args:
        robot: The arm; its URDF's ``<collision>`` elements count.
        obstacles: Bodies in the cell.
        package_dirs: Folders for ``package://`` mesh addresses.
    """
    root = ET.fromstring(robot.urdf)
    _drop_missing_meshes(root, robot, package_dirs)
    model, reference, locked = full_model(root, robot)
    text = ET.tostring(root, encoding="unicode")
    geometry = pin.buildGeomFromUrdfString(
        model, text, pin.GeometryType.COLLISION, package_dirs=list(package_dirs)
    )
    boxed = {obstacle.name for obstacle in obstacles if obstacle.tool_only}
    if not len(geometry.geometryObjects) and not boxed:
        return None
    if locked:
        _, (geometry,) = pin.buildReducedModel(model, [geometry], locked, reference)
    for obstacle in obstacles:
        shape, placement = obstacle.geometry()
        geometry.addGeometryObject(pin.GeometryObject(obstacle.name, 0, 0, placement, shape))
    if boxed:
        geometry.addGeometryObject(_tool_point(robot))
    everything = _paired(robot, geometry, _pairs(robot, geometry, boxed))
    q, _, _ = robot.random_motion(np.random.default_rng(0), _POSES)
    distance = everything.distances(q)
    moving = (distance.max(axis=0) > 0) & (np.ptp(distance, axis=0) > _MOVING)
    fixed = {obstacle.name for obstacle in obstacles}
    kept = [
        (pair.first, pair.second)
        for pair, moves, names in zip(
            everything.geometry.collisionPairs, moving, everything.pairs, strict=True
        )
        if moves or fixed & set(names)
    ]
    return _paired(robot, geometry, kept) if kept else None


def _paired(robot: Robot, geometry: Any, pairs: Sequence[tuple[int, int]]) -> Scene:
    geometry = geometry.copy()
    geometry.removeAllCollisionPairs()
    for one, other in pairs:
        geometry.addCollisionPair(pin.CollisionPair(one, other))
    names = [body.name for body in geometry.geometryObjects]
    return Scene(robot, geometry, tuple((names[i], names[j]) for i, j in pairs))


def _tool_point(robot: Robot) -> Any:
    frame = robot.model.frames[robot.tip]
    placement = frame.placement
    return pin.GeometryObject(_TOOL, frame.parentJoint, robot.tip, placement, coal.Sphere(_POINT))


def _pairs(robot: Robot, geometry: Any, boxed: set[str]) -> list[tuple[int, int]]:
    """Bodies on joints that are not neighbours; the tool point with its workspace alone."""
    joints = [body.parentJoint for body in geometry.geometryObjects]
    parents = list(robot.model.parents)
    alone = [body.name in boxed or body.name == _TOOL for body in geometry.geometryObjects]
    return [
        (i, k)
        for i in range(len(joints))
        for k in range(i + 1, len(joints))
        if joints[i] != joints[k]
        and (alone[i] or parents[joints[i]] != joints[k])
        and (alone[k] or parents[joints[k]] != joints[i])
        and alone[i] == alone[k]
    ]


def _drop_missing_meshes(root: ET.Element, robot: Robot, package_dirs: Sequence[str]) -> None:
    """Remove collision shapes whose mesh file is not there."""
    folders = [Path(robot.source).parent, *(Path(p) for p in package_dirs)]
    for link in root.findall("link"):
        for collision in link.findall("collision"):
            mesh = collision.find("geometry/mesh")
            if mesh is None:
                continue
            name = str(mesh.get("filename")).removeprefix("package://").removeprefix("file://")
            if not any((folder / name).is_file() for folder in folders):
                link.remove(collision)


def load_obstacles(path: str | Path) -> tuple[Obstacle, ...]:
    """Obstacles from a YAML file: a list of ``{name, box|sphere|half_space|workspace: {...}}``.

    A workspace, ``{low: [x, y, z], high: [x, y, z]}`` [m], is a box that the tool point stays in.

    Raises:
        BadInput: Unreadable, an unknown shape, or values that do not fit; names the entry.
    """
    try:
        content = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise BadInput(f"{path}: {error.strerror}; give a YAML file of obstacles") from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise BadInput(f"{path}: not YAML ({str(error).splitlines()[0]})") from None
    entries = content.get("obstacles") if isinstance(content, dict) else content
    if not isinstance(entries, list):
        raise BadInput(f"{path}: expected a list of obstacles, '- box: {{size: [..], ...}}'")
    return tuple(part for k, entry in enumerate(entries) for part in _obstacle(path, k, entry))


def _obstacle(path: str | Path, k: int, entry: object) -> tuple[Obstacle, ...]:
    where = f"{path}: obstacle {k + 1}"
    shapes = [s for s in _SHAPES if isinstance(entry, Mapping) and s in entry]
    if not isinstance(entry, Mapping) or len(shapes) != 1:
        raise BadInput(f"{where}: give exactly one of {', '.join(_SHAPES)}")
    shape, content = shapes[0], entry[shapes[0]]
    values = []
    for key, count in _KEYS[shape].items():
        if key == "rpy" and isinstance(content, Mapping) and key not in content:
            continue
        try:
            numbers = tuple(float(x) for x in np.ravel(content[key]))
        except (KeyError, TypeError, ValueError):
            raise BadInput(f"{where}: {shape} needs {', '.join(_KEYS[shape])} as numbers") from None
        positive = key in ("size", "radius")
        if (
            len(numbers) != count
            or not np.isfinite(numbers).all()
            or (positive and min(numbers) <= 0)
        ):
            raise BadInput(
                f"{where}: {key} must be {count} {'positive ' if positive else ''}numbers"
            )
        values.append((key, numbers))
    if shape == "half_space" and not any(values[0][1]):
        raise BadInput(f"{where}: normal must not be zero")
    name = str(entry.get("name", f"{shape} {k + 1}"))
    if shape == "workspace":
        return _workspace(where, name, *(numbers for _, numbers in values))
    return (Obstacle(name, shape, tuple(values)),)


def _workspace(
    where: str, name: str, low: tuple[float, ...], high: tuple[float, ...]
) -> tuple[Obstacle, ...]:
    """The half-spaces around a box, which the tool point must not enter."""
    if not all(a < b for a, b in zip(low, high, strict=True)):
        raise BadInput(f"{where}: low must be below high in x, y and z")
    sides = []
    for axis, (a, b) in enumerate(zip(low, high, strict=True)):
        for sign, offset, side in ((1.0, a, "low"), (-1.0, -b, "high")):
            normal = tuple(sign * float(axis == k) for k in range(3))
            values = (("normal", normal), ("offset", (offset,)))
            sides.append(Obstacle(f"{name} {'xyz'[axis]} {side}", "half_space", values, True))
    return tuple(sides)
