"""Geometry of an arm's bodies: links as stated, obstacles, and distances."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, product
from typing import Any

import coal
import msgspec
import numpy as np
import pinocchio as pin

from excitant.exceptions import BadRobot
from excitant.names import listed
from excitant.robots.motion import Array, Indices
from excitant.robots.robot import Robot, spans
from excitant.robots.schema import HalfSpaceRecord

CLEARANCE = 0.01  # m: required unless said otherwise
_POSES = 200  # random ones, for pairs whose distance depends on the drawing
_MOVING = 1e-3  # m: distances that change less do not change
_AROUND = 0.1  # of the size of a link's shapes: cables and covers
_TOOL = "tool point"
_FLOOR = "floor"
_UPRIGHT = (
    0.99  # cosine between the base's axis and up, at least, of an arm on a floor
)
_STANDS = 0.25  # of all poses: above the plane that an arm stands on
_BASE = 0.05  # m: shapes of a base that end so near its frame stand on it
_LISTED = 3  # links without collision shapes, by name
_POINT = 1e-4  # m, radius of the sphere that stands for it


@dataclass(frozen=True, eq=False)
class Shape:
    """A solid of a link: box, sphere, or cylinder (a capsule counts as one); in the link frame."""

    centre: Array  # shape (3,) [m]
    corners: Array  # of a box around it, shape (8, 3) [m]
    volume: float  # [m³]
    spread: Array  # second moment per volume about its centre, (3, 3) [m²]


@dataclass(frozen=True, eq=False)
class Body:
    """A link of a description, in its own frame."""

    link: str
    carrier: str  # the moving link it is fixed to, itself included; empty for what stands still
    given: bool  # whether the description states an inertia
    mass: float  # [kg]
    com: Array  # centre of mass, shape (3,) [m]
    inertia: Array  # tensor about the centre of mass as given, shape (3, 3) [kg·m²]
    points: (
        Array  # its origin and the origins of the joints on it, shape (k, 3) [m]
    )
    # of the collision elements if they have solids; no meshes
    shapes: tuple[Shape, ...]

    @property
    def box(self) -> tuple[Array, Array]:
        """Least and greatest coordinates of joints and solids, each of shape (3,) [m]."""
        every = np.concatenate(
            [self.points, *(shape.corners for shape in self.shapes)]
        )
        return every.min(axis=0), every.max(axis=0)

    @property
    def size(self) -> float:
        """Diagonal of the box around joints and solids [m]."""
        return float(np.linalg.norm(np.subtract(*self.box)))

    @property
    def second_moment(self) -> Array:
        """Second moment per mass about the centre of mass, ½ tr(I)/m 1 − I/m, (3, 3) [m²]."""
        moment = 0.5 * np.trace(self.inertia) * np.eye(3) - self.inertia
        return moment / self.mass

    @property
    def solid_second_moment(self) -> Array | None:
        """Second moment per mass of the solids if of one density, (3, 3); None without any."""
        if not self.shapes:
            return None
        volumes = [shape.volume for shape in self.shapes]
        centres = np.array([shape.centre for shape in self.shapes])
        spread = np.average(
            [shape.spread for shape in self.shapes], axis=0, weights=volumes
        )
        return spread + np.cov(centres.T, aweights=volumes, ddof=0)


def zero_pose(robot: Robot) -> Array:
    """Zero, or the end of a joint's range that is nearest to it, shape (nv,) [rad or m]."""
    return np.clip(np.zeros(robot.nv), *robot.limits.position.T)


@dataclass(frozen=True)
class Obstacle:
    """A body that stands in the cell, in the base frame of the URDF."""

    name: str
    shape: str  # box, sphere, half_space, or workspace: the box that the tool point stays in
    values: Any  # its measures, as `excitant.robots.schema` names them

    def bodies(self) -> list[tuple[str, Any, Any]]:
        """Name, shape and placement for Pinocchio; of a workspace, all that is outside it."""
        v = self.values
        here = pin.SE3.Identity()
        if self.shape == "workspace":
            return [
                (
                    f"{self.name} {'xyz'[k]} {end}",
                    coal.Halfspace(n, float(n @ limit)),
                    here,
                )
                for k, axis in enumerate(np.eye(3))
                for end, n, limit in (("low", axis, v.low), ("high", -axis, v.high))
            ]
        if self.shape == "half_space":
            length = float(np.linalg.norm(v.normal))
            plane = coal.Halfspace(np.array(v.normal) / length, v.offset / length)
            return [(self.name, plane, here)]
        if self.shape == "sphere":
            here.translation = np.array(v.position)
            return [(self.name, coal.Sphere(v.radius), here)]
        place = pin.SE3(pin.rpy.rpyToMatrix(*v.rpy), np.array(v.position))
        return [(self.name, coal.Box(*v.size), place)]

    def plain(self) -> dict[str, Any]:
        """Name, shape and values for JSON, with the keys of an obstacle file."""
        values = msgspec.to_builtins(self.values)
        return {"name": self.name, "shape": self.shape, **values}


@dataclass(frozen=True, eq=False)
class Scene:
    """An arm's bodies among obstacles, with the pairs of names that must keep apart.

    Bodies on the same joint or on neighbouring joints are not paired. Of two bodies of the arm that
    no motion brings twice the clearance apart, half of their largest distance is required: their
    distance counts by ``scale`` times as much.
    """

    robot: Robot
    geometry: Any  # Pinocchio's geometry model; never edited
    pairs: tuple[tuple[str, str], ...]
    obstacles: tuple[Obstacle, ...]
    scale: Array  # of the distance of each pair, at least 1, shape (pairs,)

    def distances(self, q: Array) -> Array:
        """Signed distance of every pair at every pose, as it counts, shape (n, pairs) [m]."""
        distances = np.empty((len(q), len(self.pairs)))
        for k, results in enumerate(self._results(q)):
            distances[k] = [result.min_distance for result in results]
        return distances * self.scale

    def nearest(self, q: Array) -> tuple[Indices, Array, Array]:
        """At every pose the pair whose distance counts least.

        Returns:
            Its index (n,), the signed distance (n,) [m], and the nearest points of its bodies in
            the base frame, shape (n, 2, 3) [m].
        """
        pairs = []
        distance = []
        points = []
        for results in self._results(q):
            counts = self.scale * [result.min_distance for result in results]
            pairs.append(pair := int(counts.argmin()))
            least = results[pair]
            distance.append(least.min_distance)
            points.append([least.getNearestPoint1(), least.getNearestPoint2()])
        return np.array(pairs), np.array(distance), np.array(points)

    def _results(self, q: Array) -> Iterator[Any]:
        """What Pinocchio finds of all pairs at every pose."""
        model = self.robot.model
        data = model.createData()
        work = self.geometry.createData()
        for pose in q:
            pin.computeDistances(model, data, self.geometry, work, pose)
            yield work.distanceResults

    def gradient(self, q: Array, pair: int) -> tuple[float, Array]:
        """Distance of one pair at one pose, and its derivative by q, shape (nv,) [m/rad]."""
        model = self.robot.model
        data = model.createData()
        work = self.geometry.createData()
        pin.computeJointJacobians(model, data, q)
        pin.updateGeometryPlacements(model, data, self.geometry, work)
        result = pin.computeDistance(self.geometry, work, pair)
        ends = self.geometry.collisionPairs[pair]
        first, second = (
            _velocity(
                model, data, self.geometry.geometryObjects[i].parentJoint, point
            )
            for i, point in (
                (ends.first, result.getNearestPoint1()),
                (ends.second, result.getNearestPoint2()),
            )
        )
        slope = result.normal @ (second - first)  # normal from first to second
        scale = float(self.scale[pair])
        return scale * float(result.min_distance), scale * slope

    def speeds(self) -> Array:
        """Bound on the change of each pair's distance by each joint, (pairs, nv) [m/rad].

        A joint between both bodies moves no point of the outer one faster than its distance
        from the joint, at most the stretched arm's; a sliding one moves it as fast as itself.
        """
        ends = [(pair.first, pair.second) for pair in self.geometry.collisionPairs]
        one, other = _reaches(self)[np.array(ends).T]
        between = np.isfinite(one) != np.isfinite(other)
        bounds = np.where(self.robot.revolute, np.fmax(one, other), 1.0)
        return self.scale[:, None] * np.where(between, bounds, 0.0)


def _velocity(model: Any, data: Any, joint: int, point: Array) -> Array:
    """Velocity of a point of a joint's body by joint velocity, shape (3, nv)."""
    if joint == 0:
        return np.zeros((3, model.nv))
    J = np.reshape(
        pin.getJointJacobian(model, data, joint, pin.LOCAL_WORLD_ALIGNED), (6, -1)
    )
    return J[:3] - pin.skew(point - data.oMi[joint].translation) @ J[3:]


def _reaches(scene: Scene) -> Array:
    """Largest distance of each body's points from each supporting joint, else NaN, (bodies, nv)."""
    model = scene.robot.model
    objects = scene.geometry.geometryObjects
    reach = np.full((len(objects), scene.robot.nv), np.nan)
    slide = np.where(
        scene.robot.revolute, 0.0, np.abs(scene.robot.limits.position).max(axis=1)
    )
    for i, body in enumerate(objects):
        if body.parentJoint == 0:
            continue
        body.geometry.computeLocalAABB()
        length = np.linalg.norm(body.placement.translation)
        length += (
            np.linalg.norm(body.geometry.aabb_center) + body.geometry.aabb_radius
        )
        for j in reversed(list(model.supports[body.parentJoint])[1:]):
            reach[i, j - 1] = length
            step = np.linalg.norm(model.jointPlacements[j].translation)
            length += step + slide[j - 1]
    return reach


def scene(
    robot: Robot, obstacles: Sequence[Obstacle] = (), clearance: float = CLEARANCE
) -> Scene | None:
    """Collision scene of a robot; None when no motion can bring two of its shapes together.

    Meshes count with their convex hulls, which takes a hundredth of the time. Meshes that are not
    found are left out, and so are pairs of the arm's own bodies that touch at every pose or whose
    distance never changes: no motion can do anything about them.

    Args:
        robot: The arm; its URDF's ``<collision>`` elements count.
        obstacles: Bodies in the cell.
        clearance: Distance that will be required [m].
    """
    geometry = robot.format.solids(robot, "collision").copy()
    boxed = {
        name
        for o in obstacles
        if o.shape == "workspace"
        for name, _, _ in o.bodies()
    }
    if not len(geometry.geometryObjects) and not boxed:
        return None
    fixed = set()
    for name, shape, placement in (body for o in obstacles for body in o.bodies()):
        geometry.addGeometryObject(pin.GeometryObject(name, 0, 0, placement, shape))
        fixed.add(name)
    if boxed:
        tool = robot.model.frames[robot.tip]
        at = (tool.parentJoint, robot.tip, tool.placement)
        point = coal.Sphere(_POINT)
        geometry.addGeometryObject(pin.GeometryObject(_TOOL, *at, point))
    pairs = _pairs(robot, geometry, boxed)
    everything = _paired(robot, geometry, pairs, obstacles, np.ones(len(pairs)))
    distance = everything.distances(robot.random_motion(0, _POSES)[0])
    largest = distance.max(axis=0)
    beside = np.array([bool(fixed & {*pair}) for pair in everything.pairs], bool)
    apart = (largest > _MOVING) & (np.ptp(distance, axis=0) > _MOVING)
    kept = np.flatnonzero(apart | beside)
    scale = np.maximum(1.0, 2 * clearance / np.maximum(largest, _MOVING))
    scale = np.where(beside, 1.0, scale)[kept]
    if not len(kept):
        return None
    return _paired(robot, geometry, [pairs[k] for k in kept], obstacles, scale)


def usual_scene(robot: Robot, clearance: float) -> Scene | None:
    """Scene of an arm of whose cell nothing is said: its bodies, the floor it stands on."""
    height = base_plane(robot)
    obstacles = () if height is None else (floor(height),)
    return scene(robot, obstacles, clearance)


def floor(height: float) -> Obstacle:
    """The floor at a height in the base frame [m]."""
    return Obstacle(_FLOOR, "half_space", HalfSpaceRecord((0.0, 0.0, 1.0), height))


def base_plane(robot: Robot) -> float | None:
    """Height of the plane that an arm stands on [m]; None if it hangs or shows no fixed base.

    It is that of the base frame where the fixed shapes end near it, else their lowest point. Half
    of all directions lie above a floor: of an arm that stands on it, a quarter of all poses or
    more.
    """
    up = -robot.gravity
    fixed = [body for body in readable_solids(robot) if body.parentJoint == 0]
    if not fixed or not up[2] > _UPRIGHT * np.linalg.norm(up):
        return None
    lowest = min(float(_corners(body)[:, 2].min()) for body in fixed)
    height = 0.0 if abs(lowest) < _BASE else lowest
    ground = scene(robot, [floor(height)], 0.0)
    if ground is None:
        return height
    poses = robot.random_motion(0, _POSES)[0]
    above = [_FLOOR in pair for pair in ground.pairs]
    distance = ground.distances(poses)[:, above]
    return height if (distance > 0).all(axis=1).mean() >= _STANDS else None


def _corners(body: Any) -> Array:
    """Corners of the box around a solid, in the frame of its joint, shape (8, 3) [m]."""
    box = body.geometry
    box.computeLocalAABB()
    ranges = zip(box.aabb_local.min_, box.aabb_local.max_, strict=True)
    corners = np.array(list(product(*ranges)))
    return corners @ body.placement.rotation.T + body.placement.translation


def centre_regions(robot: Robot) -> dict[str, tuple[Array, Array]]:
    """Boxes that the links' centres of mass lie in: least and greatest coordinates, (3,) [m].

    A box holds the link's joints, its collision shapes with a tenth of its size around them, and
    the centre of mass as given. A link without shapes gets a margin of half the longest distance
    of two joints in a row instead, which holds for all of 672 links with mass between two joints
    of the robots in example-robot-data (99 % of them by a factor of 1.4); the last link the whole
    of it, since it carries a tool that the description may lack. Arms without any length have none.
    """
    model = robot.model
    places = [np.array(place.translation) for place in model.jointPlacements]
    longest = max(spans(robot)[1:], default=0.0)
    points = [[np.zeros(3), np.array(body.lever)] for body in model.inertias]
    for joint, place in enumerate(places[1:], start=1):
        points[model.parents[joint]].append(place)
    solid = set()
    for body in readable_solids(robot):
        points[body.parentJoint] += list(_corners(body))
        solid.add(body.parentJoint)
    regions = {}
    for joint, link in enumerate(robot.links, start=1):
        low = np.min(points[joint], axis=0)
        high = np.max(points[joint], axis=0)
        last = joint == robot.nv
        margin = longest / (2 - last)
        if joint in solid and not last:
            margin = _AROUND * float(np.linalg.norm(high - low))
        if margin > 0:
            regions[link] = low - margin, high + margin
    return regions


def readable_solids(robot: Robot, kind: str = "collision") -> list[Any]:
    """Collision or visual shapes as Pinocchio has them, meshes as hulls; none if one is damaged."""
    try:
        return list(robot.format.solids(robot, kind).geometryObjects)
    except BadRobot:
        return []


def unchecked(robot: Robot, scene: Scene | None) -> str:
    """What clearance in a scene leaves out, as ``self-collision, 8 of 8 meshes not found; floor``.

    Shapes of neighbouring links, which touch by design, are never checked against each other.
    """
    stated, missing, outside = robot.format.count_shapes(robot, "collision")
    solid = robot.format.carriers(robot, "collision")
    drawn = robot.format.carriers(robot, "visual")
    shapeless = [
        link or "base" for link in ("", *robot.links) if link in drawn - solid
    ]
    moving = solid - {""}
    gaps = []
    if missing or not moving or scene is None:
        why = ""
        if missing:
            why = f", {missing} of {stated} collision meshes not found"
        elif not moving:
            why = f", no {'moving ' * bool(stated)}link has a collision shape"
        if outside:
            why += f" ({outside} outside the description's folder: --package FOLDER allows them)"
        gaps.append(f"self-collision{why}")
    elif shapeless:
        gaps.append(f"{listed(shapeless, _LISTED)}, without collision shapes")
    if scene is not None and (near := int((scene.scale > 1).sum())):
        most = int(np.argmax(scene.scale))
        count = near - 1
        more = f", and {count} more pair{'s' * (count > 1)} alike" if count else ""
        gaps.append(
            f"full clearance between {' and '.join(scene.pairs[most])}, never far apart (half of "
            f"their largest distance is kept{more})"
        )
    if scene is None or _FLOOR not in [o.name for o in scene.obstacles]:
        gaps.append(_FLOOR)
    return "; ".join(gaps)


def _paired(
    robot: Robot,
    geometry: Any,
    pairs: Sequence[tuple[int, int]],
    obstacles: Sequence[Obstacle],
    scale: Array,
) -> Scene:
    geometry = geometry.copy()
    geometry.removeAllCollisionPairs()
    for one, other in pairs:
        geometry.addCollisionPair(pin.CollisionPair(one, other))
    names = [body.name for body in geometry.geometryObjects]
    named = tuple((names[i], names[j]) for i, j in pairs)
    return Scene(robot, geometry, named, tuple(obstacles), scale)


def _pairs(robot: Robot, geometry: Any, boxed: set[str]) -> list[tuple[int, int]]:
    """Bodies on joints that are not neighbours; the tool point with its workspace alone."""
    joints = [body.parentJoint for body in geometry.geometryObjects]
    parents = robot.model.parents
    names = {*boxed, _TOOL}
    alone = [body.name in names for body in geometry.geometryObjects]
    return [
        (i, k)
        for i, k in combinations(range(len(joints)), 2)
        if joints[i] != joints[k]
        and (alone[i] or parents[joints[i]] != joints[k])
        and (alone[k] or parents[joints[k]] != joints[i])
        and alone[i] == alone[k]
    ]
