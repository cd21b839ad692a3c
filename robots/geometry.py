"""Where an arm's bodies are: collision shapes, obstacles in the cell, and their distances."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import coal
import msgspec
import numpy as np
import pinocchio as pin

from excitant.robots.motion import Array
from excitant.robots.robot import Robot
from excitant.robots.schema import OBSTACLE_SHAPES, ObstacleRecord, convert, read_yaml
from excitant.robots.urdf import full_model

_POSES = 200  # random ones, to tell pairs whose distance is a matter of drawing
_MOVING = 1e-3  # m: distances that change less do not change
_TOOL = "tool point"
_POINT = 1e-4  # m, radius of the sphere that stands for it


@dataclass(frozen=True)
class Obstacle:
    """A body that stands in the cell, in the base frame of the URDF.

    Attributes:
        name: Name for messages.
        shape: ``"box"``, ``"sphere"``, ``"half_space"`` (all points x with n·x ≤ offset) or
            ``"workspace"``, the axis-aligned box that the tool point stays in.
        values: Its numbers, a record of `excitant.robots.schema`.
    """

    name: str
    shape: str
    values: Any

    @property
    def tool_only(self) -> bool:
        """Whether only the tool point must keep away from it."""
        return self.shape == "workspace"

    def bodies(self) -> list[tuple[str, Any, Any]]:
        """Name, shape and placement for Pinocchio; of a workspace, all that is outside it."""
        v, here = self.values, pin.SE3.Identity()
        if self.shape == "workspace":
            return [
                (f"{self.name} {'xyz'[k]} {end}", coal.Halfspace(n, float(n @ limit)), here)
                for k, axis in enumerate(np.eye(3))
                for end, n, limit in (("low", axis, v.low), ("high", -axis, v.high))
            ]
        if self.shape == "half_space":
            length = float(np.linalg.norm(v.normal))
            plane = coal.Halfspace(np.array(v.normal) / length, v.offset / length)
            return [(self.name, plane, here)]
        if self.shape == "sphere":
            return [(self.name, coal.Sphere(v.radius), pin.SE3(np.eye(3), np.array(v.position)))]
        place = pin.SE3(pin.rpy.rpyToMatrix(*v.rpy), np.array(v.position))
        return [(self.name, coal.Box(*v.size), place)]

    def plain(self) -> dict[str, Any]:
        """Name, shape and values for JSON, with the keys of an obstacle file."""
        return {"name": self.name, "shape": self.shape, **msgspec.to_builtins(self.values)}


def load_obstacles(path: str | Path) -> tuple[Obstacle, ...]:
    """Obstacles from a YAML file: a list of ``{name, box|sphere|half_space|workspace: {...}}``.

    A workspace, ``{low: [x, y, z], high: [x, y, z]}`` [m], is a box that the tool point stays in.

    Raises:
        BadInput: Unreadable, an unknown shape, or values that do not fit; names the entry.
    """
    content: Any = read_yaml(path, Any, "obstacles")
    listed = content.get("obstacles") if isinstance(content, dict) else content
    records = convert(listed, list[ObstacleRecord], path, ".obstacles")
    found = []
    for k, record in enumerate(records, start=1):
        shape = next(s for s in OBSTACLE_SHAPES if getattr(record, s) is not None)
        found.append(Obstacle(record.name or f"{shape} {k}", shape, getattr(record, shape)))
    return tuple(found)


@dataclass(frozen=True, eq=False)
class Scene:
    """An arm's bodies among obstacles, with the pairs that must keep apart.

    Bodies on the same joint or on neighbouring joints are not paired.

    Attributes:
        robot: The arm.
        geometry: Pinocchio's geometry model; never edited.
        pairs: Names of both bodies of every pair.
        obstacles: What stands in the cell.
    """

    robot: Robot
    geometry: Any
    pairs: tuple[tuple[str, str], ...]
    obstacles: tuple[Obstacle, ...] = ()

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
    # Pinocchio gives the Jacobian of a single joint as a vector
    J = np.reshape(pin.getJointJacobian(model, data, joint, pin.LOCAL_WORLD_ALIGNED), (6, -1))
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


def scene(robot: Robot, obstacles: Sequence[Obstacle] = ()) -> Scene | None:
    """Collision scene of a robot; None when no motion can bring two of its shapes together.

    Meshes count with their convex hulls, which takes a hundredth of the time. Meshes that are not
    found are left out, and so are pairs of the arm's own bodies that overlap at every pose or whose
    distance never changes: no motion can do anything about them.

    Args:
        robot: The arm; its URDF's ``<collision>`` elements count.
        obstacles: Bodies in the cell.
    """
    root = ET.fromstring(robot.urdf)
    _find_meshes(root, robot)
    model, reference, locked = full_model(root, robot)
    text = ET.tostring(root, encoding="unicode")
    geometry = pin.buildGeomFromUrdfString(model, text, pin.GeometryType.COLLISION)
    _make_convex(geometry)
    boxed = {name for o in obstacles if o.tool_only for name, _, _ in o.bodies()}
    if not len(geometry.geometryObjects) and not boxed:
        return None
    if locked:
        _, (geometry,) = pin.buildReducedModel(model, [geometry], locked, reference)
    fixed = set()
    for name, shape, placement in (body for o in obstacles for body in o.bodies()):
        geometry.addGeometryObject(pin.GeometryObject(name, 0, 0, placement, shape))
        fixed.add(name)
    if boxed:
        geometry.addGeometryObject(_tool_point(robot))
    everything = _paired(robot, geometry, _pairs(robot, geometry, boxed), obstacles)
    q, _, _ = robot.random_motion(np.random.default_rng(0), _POSES)
    distance = everything.distances(q)
    moving = (distance.max(axis=0) > 0) & (np.ptp(distance, axis=0) > _MOVING)
    kept = [
        (pair.first, pair.second)
        for pair, moves, names in zip(
            everything.geometry.collisionPairs, moving, everything.pairs, strict=True
        )
        if moves or fixed & set(names)
    ]
    return _paired(robot, geometry, kept, obstacles) if kept else None


def _paired(
    robot: Robot, geometry: Any, pairs: Sequence[tuple[int, int]], obstacles: Sequence[Obstacle]
) -> Scene:
    geometry = geometry.copy()
    geometry.removeAllCollisionPairs()
    for one, other in pairs:
        geometry.addCollisionPair(pin.CollisionPair(one, other))
    names = [body.name for body in geometry.geometryObjects]
    return Scene(robot, geometry, tuple((names[i], names[j]) for i, j in pairs), tuple(obstacles))


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


def _make_convex(geometry: Any) -> None:
    """Replace meshes by their convex hulls; flat ones have none and stay."""
    for body in geometry.geometryObjects:
        mesh = body.geometry
        if not isinstance(mesh, coal.BVHModelBase):
            continue
        try:
            mesh.buildConvexHull(True, "Qt")
        except (ValueError, RuntimeError):
            continue
        body.geometry = mesh.convex


def _find_meshes(root: ET.Element, robot: Robot) -> None:
    """Name mesh files by their full paths; remove collision shapes whose mesh is not there."""
    folder = Path(robot.source).parent
    for link in root.findall("link"):
        for collision in link.findall("collision"):
            mesh = collision.find("geometry/mesh")
            if mesh is None:
                continue
            name = str(mesh.get("filename")).removeprefix("package://").removeprefix("file://")
            if (folder / name).is_file():
                mesh.set("filename", str((folder / name).resolve()))
            else:
                link.remove(collision)
