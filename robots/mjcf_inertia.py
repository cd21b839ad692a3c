"""Inertia of the bodies of an MJCF file: as it is given, or of their shapes."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin

from excitant.exceptions import BadRobot
from excitant.robots.mjcf_document import Document, along
from excitant.robots.motion import Array

_DENSITY = 1000.0  # kg/m³, MuJoCo's default
_MASSLESS = ("plane", "hfield", "sdf")
_SIZES = {"sphere": 1, "capsule": 2, "cylinder": 2, "box": 3, "ellipsoid": 3}

Placed = tuple[ET.Element, pin.SE3, str]
"""An element of a body, its frame in the body's, and the default class around it."""


def given_inertia(document: Document, element: ET.Element) -> pin.Inertia:
    """Inertia of an ``<inertial>`` in its body's frame."""
    given = dict(element.attrib)
    mass = document.number(given, "mass")
    pose = document.pose(given)
    if "fullinertia" in given:
        xx, yy, zz, xy, xz, yz = document.numbers(given, "fullinertia", np.zeros(6).tolist())
        tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    else:
        tensor = np.diag(document.numbers(given, "diaginertia", (0, 0, 0)))
    if mass < 0:
        raise BadRobot(document.source, f"an <inertial> has the negative mass {mass:g} kg")
    return pin.Inertia(mass, pose.translation, pose.rotation @ tensor @ pose.rotation.T)


def inertia_of_shapes(document: Document, geoms: Iterable[Placed], body: str) -> pin.Inertia:
    """Inertia of a body's geoms together in the body's frame."""
    first, last = (
        document.numbers(document.compiler, "inertiagrouprange", (0, 5)).astype(int).tolist()
    )
    total = pin.Inertia.Zero()
    for element, frame, childclass in geoms:
        given = document.attributes(element, childclass)
        if not first <= document.number(given, "group") <= last:
            continue
        shape, placement = _shape_inertia(document, given, body)
        if shape.mass > 0:
            total = total + (frame * placement).act(shape)
    return total


def bounded(document: Document, inertia: pin.Inertia) -> pin.Inertia:
    """The inertia with what ``boundmass``, ``boundinertia`` and ``balanceinertia`` do to it."""
    compiler = document.compiler
    mass = max(float(inertia.mass), document.number(compiler, "boundmass"))
    least = document.number(compiler, "boundinertia")
    balance = compiler.get("balanceinertia", "false") == "true"
    if mass == inertia.mass and least == 0 and not balance:
        return inertia
    moments, axes = np.linalg.eigh(inertia.inertia)
    moments = np.maximum(moments, least)
    if balance and moments[0] + moments[1] < moments[2]:
        moments[:] = moments.mean()
    return pin.Inertia(mass, inertia.lever, axes @ np.diag(moments) @ axes.T)


def _shape_inertia(
    document: Document, given: Mapping[str, str], body: str
) -> tuple[pin.Inertia, pin.SE3]:
    """Inertia of one geom about its own frame, and that frame in what holds the geom."""
    kind = shape_kind(given)
    if kind in _MASSLESS or ("mass" in given and document.number(given, "mass") == 0):
        return pin.Inertia.Zero(), pin.SE3.Identity()
    if given.get("shellinertia", "false") == "true":
        raise BadRobot(document.source, _needs_inertial(body, "a geom with shellinertia"))
    if "mesh" in given:
        unit, placement = _mesh_inertia(document, given, body), document.pose(given)
    elif kind in _SIZES:
        size, placement = shape_size(document, given)
        unit = _solid(kind, size)
    else:
        raise BadRobot(document.source, _needs_inertial(body, f"a geom of type '{kind}'"))
    density = document.number(given, "density", _DENSITY)
    mass = document.number(given, "mass", density * float(unit.mass))
    scale = mass / unit.mass if unit.mass else 0.0
    return pin.Inertia(mass, unit.lever, scale * unit.inertia), placement


def _needs_inertial(body: str, what: str) -> str:
    return (
        f"body '{body}' takes its inertia from {what}, which is not supported; give it <inertial>"
    )


def shape_kind(given: Mapping[str, str]) -> str:
    """Type of a geom."""
    return given.get("type", "mesh" if "mesh" in given else "sphere")


def shape_size(document: Document, given: Mapping[str, str]) -> tuple[Array, pin.SE3]:
    """Half sizes of a primitive geom, and its pose."""
    kind = shape_kind(given)
    size = np.zeros(3)
    if "size" in given:
        numbers = document.numbers(given, "size", (0.0,), at_most=3)
        size[: len(numbers)] = numbers
    if "fromto" not in given:
        placement = document.pose(given)
    else:
        start, end = document.numbers(given, "fromto", np.zeros(6).tolist()).reshape(2, 3)
        placement = pin.SE3(along(start - end), (start + end) / 2)
        half = float(np.linalg.norm(start - end)) / 2
        size = np.array([size[0], half, 0.0] if kind in ("capsule", "cylinder") else
                        [size[0], size[0], half])  # fmt: skip
    if not (size[: _SIZES.get(kind, 0)] > 0).all():
        raise BadRobot(
            document.source, f"geom '{given.get('name', kind)}': a {kind} needs positive sizes"
        )
    return size, placement


def _solid(kind: str, size: Array) -> pin.Inertia:
    """Inertia of a primitive of density one about its centre."""
    x, y, z = size
    if kind == "sphere":
        return _unit_body(4 / 3 * np.pi * x**3, np.full(3, 0.4 * x**2))
    if kind == "box":
        return _unit_body(8 * x * y * z, np.array([y**2 + z**2, x**2 + z**2, x**2 + y**2]) / 3)
    if kind == "ellipsoid":
        moments = np.array([y**2 + z**2, x**2 + z**2, x**2 + y**2]) / 5
        return _unit_body(4 / 3 * np.pi * x * y * z, moments)
    across = x**2 / 4 + y**2 / 3
    cylinder = _unit_body(2 * np.pi * x**2 * y, np.array([across, across, x**2 / 2]))
    if kind == "cylinder":
        return cylinder
    half = _unit_body(2 / 3 * np.pi * x**3, np.array([83 / 320, 83 / 320, 0.4]) * x**2)
    caps = [
        pin.Inertia(half.mass, np.array([0, 0, side * (y + 3 / 8 * x)]), half.inertia)
        for side in (1.0, -1.0)
    ]
    return cylinder + caps[0] + caps[1]


def _unit_body(volume: float, moments_per_mass: Array) -> pin.Inertia:
    return pin.Inertia(volume, np.zeros(3), volume * np.diag(moments_per_mass))


def _mesh_inertia(document: Document, given: Mapping[str, str], body: str) -> pin.Inertia:
    """Inertia of a closed mesh of density one about the frame its geom gives it."""
    file, scale, placement = mesh_file(document, given["mesh"])
    if not file.is_file():
        raise BadRobot(document.source, f"body '{body}' has its mass from {file}, which is missing")
    try:
        mesh = coal.MeshLoader().load(str(file), np.ones(3))
    except (ValueError, RuntimeError) as error:
        raise BadRobot(document.source, f"mesh {file} cannot be read ({error})") from None
    vertices = (np.array(mesh.vertices()) - placement.translation) @ placement.rotation * scale
    triangles = np.array([[t[0], t[1], t[2]] for t in map(mesh.tri_indices, range(mesh.num_tris))])
    if np.prod(scale) < 0:  # a mirrored mesh is inside out
        triangles = triangles[:, ::-1]
    inertia = _solid_inside(vertices[triangles])
    if inertia is None:
        raise BadRobot(
            document.source, _needs_inertial(body, f"mesh {file.name} that encloses no volume")
        )
    return inertia


def _solid_inside(corners: Array) -> pin.Inertia | None:
    """Inertia of density one inside closed triangles, shape (n, 3, 3); by signed tetrahedra."""
    volumes = np.einsum("ni,ni->n", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    volume = float(volumes.sum())
    if volume <= 0:
        return None
    total = corners.sum(axis=1)
    centre = volumes @ total / 4 / volume
    second = np.einsum("n,ni,nj->ij", volumes, total, total)
    second = (second + np.einsum("n,nki,nkj->ij", volumes, corners, corners)) / 20
    second -= volume * np.outer(centre, centre)
    return pin.Inertia(volume, centre, np.trace(second) * np.eye(3) - second)


def mesh_file(document: Document, name: str) -> tuple[Path, Array, pin.SE3]:
    """File of a mesh asset, its scale, and the frame (refpos, refquat) it is measured in.

    Vertices are moved into that frame first and scaled then.
    """
    compiler = document.compiler
    for element in document.root.iterfind("asset/mesh"):
        given = document.attributes(element)
        file = given.get("file", "")
        if given.get("name", Path(file).stem) != name or not file:
            continue
        folder = compiler.get("meshdir", compiler.get("assetdir", ""))
        if compiler.get("strippath", "false") == "true":
            file = Path(file).name
        frame = {"pos": given.get("refpos", "0 0 0"), "quat": given.get("refquat", "1 0 0 0")}
        scale = document.numbers(given, "scale", (1, 1, 1))
        return Path(document.source).parent / folder / file, scale, document.pose(frame)
    raise BadRobot(document.source, f"there is no mesh file '{name}' among its assets")
