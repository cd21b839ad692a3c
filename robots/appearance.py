"""How an arm looks to a viewer: the tree of its joints, and the shapes that they carry."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from excitant.names import listed
from excitant.robots.geometry import readable_solids
from excitant.robots.motion import Array
from excitant.robots.robot import Robot, own_axes, spans

_ROD = 0.02  # of the arm's extent: radius of what stands for a link without shapes
_LISTED = 3  # links by name
_INSTEAD = {
    "visual": "drawn by visual shapes, which are not checked",
    "rod": "without shapes, drawn as rods from joint to joint",
}


@dataclass(frozen=True, eq=False)
class Appearance:
    """The shapes by which an arm is drawn.

    A link has its collision shapes, meshes as the convex hulls that clearance is computed with; or
    else its visual shapes; or else rods from its joint to the next ones.
    """

    robot: Robot

    @cached_property
    def _shown(self) -> dict[str, list[pin.GeometryObject]]:
        """Pieces by what they are: ``collision``, ``visual``, ``rod``."""
        shown: dict[str, list[pin.GeometryObject]] = {}
        bare = set(range(self.robot.nv + 1))
        for kind in ("collision", "visual"):
            shown[kind] = [
                piece
                for piece in (readable_solids(self.robot, kind) if bare else ())
                if piece.parentJoint in bare
            ]
            bare -= {piece.parentJoint for piece in shown[kind]}
        shown["rod"] = [rod for joint in sorted(bare) for rod in self._rods(joint)]
        return shown

    def _rods(self, joint: int) -> Iterator[pin.GeometryObject]:
        """What stands for a link: its joint, and rods to the joints, or the tool, that it carries.

        A joint that turns is a bar along its axis, one that slides a block on a rail.
        """
        robot = self.robot
        radius = _ROD * self._extent
        model = robot.model
        tool = model.frames[robot.tip]
        places = list(model.jointPlacements)
        if joint and robot.revolute[joint - 1]:
            bar = coal.Cylinder(1.6 * radius, 5 * radius)
            yield _piece(joint, self._along(joint), bar)
        elif joint:
            block = coal.Box(*np.full(3, 3.2 * radius))
            yield _piece(joint, self._along(joint), block)
            low, high = robot.limits.position[joint - 1]
            if np.isfinite(high - low):
                rail = places[joint] * self._along(joint, (low + high) / 2)
                shape = coal.Cylinder(radius / 2, float(high - low))
                yield _piece(model.parents[joint], rail, shape)
        ends = [
            places[k] for k in range(1, robot.nv + 1) if model.parents[k] == joint
        ]
        ends += [tool.placement] * (tool.parentJoint == joint)
        for end in (place.translation for place in ends):
            if (length := float(np.linalg.norm(end))) > radius:
                middle = pin.SE3(_turned(end), end / 2)
                yield _piece(joint, middle, coal.Cylinder(radius, length))

    def _along(self, joint: int, shift: float = 0.0) -> pin.SE3:
        """A frame whose z is the joint's axis, shifted along it, in the frame of the joint."""
        axis = own_axes(self.robot)[joint - 1]
        return pin.SE3(_turned(axis), shift * axis)

    @cached_property
    def _extent(self) -> float:
        """Length of the arm along its joints [m]; 1 of an arm without any."""
        tool = self.robot.model.frames[self.robot.tip].placement
        reach = float(np.linalg.norm(tool.translation))
        return sum(spans(self.robot)) + reach or 1.0

    @property
    def notes(self) -> list[str]:
        """What is not drawn by collision shapes, and which meshes are missing; a sentence each."""
        notes: list[str] = []
        names = ("base", *self.robot.links)
        for kind, how in _INSTEAD.items():
            joints = sorted({piece.parentJoint for piece in self._shown[kind]})
            if joints:
                links = [names[joint] for joint in joints]
                notes.append(f"{how}: {listed(links, _LISTED)}")
        for kind in ("collision", "visual") if notes else ("collision",):
            _, missing, _ = self.robot.format.count_shapes(self.robot, kind)
            if missing:
                notes.append(f"{missing} {kind} meshes were not found")
        return notes

    @property
    def _pieces(self) -> list[pin.GeometryObject]:
        return [piece for pieces in self._shown.values() for piece in pieces]

    def entries(self) -> dict[str, Any]:
        """For ``result.json``.

        Returns:
            ``joints``, of each its ``parent`` (0 for the base), its ``place`` there at zero, its
            ``axis`` and whether it ``slides``; ``tool``, its ``joint`` and ``place``; ``shapes``,
            of each its ``joint``, ``place``, ``kind`` and ``size`` [m]; ``notes``. A place is
            x, y, z [m] and the quaternion x, y, z, w.
        """
        robot = self.robot
        model = robot.model
        frame = model.frames[robot.tip]
        joints = [
            {
                "parent": int(model.parents[j]),
                "place": _place(model.jointPlacements[j]),
                "axis": axis,
                "slides": not robot.revolute[j - 1],
            }
            for j, axis in enumerate(own_axes(self.robot).tolist(), start=1)
        ]
        shapes = [
            {
                "joint": piece.parentJoint,
                "place": _place(piece.placement),
                **_measures(piece.geometry),
            }
            for piece in self._pieces
        ]
        tool = {"joint": int(frame.parentJoint), "place": _place(frame.placement)}
        return {
            "joints": joints,
            "tool": tool,
            "shapes": shapes,
            "notes": self.notes,
        }

    def meshes(self) -> dict[str, Array]:
        """Of shape k that is a mesh ``mesh<k>_points`` (n, 3) [m] and ``mesh<k>_faces`` (m, 3)."""
        arrays: dict[str, Array] = {}
        for k, piece in enumerate(self._pieces):
            if _measures(piece.geometry)["kind"] == "mesh":
                points, faces = _triangles(piece.geometry)
                arrays |= {f"mesh{k}_points": points, f"mesh{k}_faces": faces}
        return arrays


def _piece(joint: int, place: pin.SE3, shape: Any) -> pin.GeometryObject:
    """A shape that a joint carries, by its index, 0 for the base, in the joint's frame."""
    return pin.GeometryObject("", joint, 0, place, shape)


def _turned(axis: Array) -> Array:
    """A rotation that turns z into a direction, shape (3, 3)."""
    z = np.array([0.0, 0.0, 1.0])
    return pin.Quaternion.FromTwoVectors(z, axis).matrix()


def _place(place: pin.SE3) -> list[float]:
    return pin.SE3ToXYZQUAT(place).tolist()


def _measures(shape: Any) -> dict[str, Any]:
    """Kind of a shape, and its size: edges; radius; or radius and length along z [m]."""
    match shape:
        case coal.Box():
            return {"kind": "box", "size": (2 * np.array(shape.halfSide)).tolist()}
        case coal.Sphere():
            return {"kind": "sphere", "size": [float(shape.radius)]}
        case coal.Cylinder() | coal.Capsule():
            kind = type(shape).__name__.lower()
            return {
                "kind": kind,
                "size": [float(shape.radius), 2 * float(shape.halfLength)],
            }
    return {"kind": "mesh", "size": []}


def _triangles(shape: Any) -> tuple[Array, Array]:
    """Points and faces of a convex hull."""
    faces = [shape.polygons(k) for k in range(shape.num_polygons)]
    corners = [[face[k] for k in range(3)] for face in faces]
    return np.array(shape.points(), float), np.array(corners, float)
