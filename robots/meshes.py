"""Convex hulls of mesh files, made in a child process: a damaged mesh may end it, not this one."""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from os import stat
from pathlib import Path
from typing import Any

import coal
import msgspec
import numpy as np
import numpy.typing as npt

from excitant.exceptions import BadRobot
from excitant.limited import Exceeded, in_child
from excitant.robots.limits import UNLIMITED
from excitant.robots.motion import Array

Mesh = tuple[Path, tuple[float, float, float]]
"""File of a mesh, and the factors that stretch it along x, y, z."""

SECONDS = (
    30  # of processor time for all meshes of an arm; those of a humanoid take 3
)
MEMORY = 2 << 30  # bytes of address space that they may take; libraries take 0.2 GB
FORMATS = (".stl", ".dae", ".obj", ".ply", ".glb")
"""Ends of names of the formats that keep all of a mesh in one file."""

_FLAT = 1e-6  # of a mesh's size: thinner is flat, and made so thick; STL keeps 6e-8
_SMALLEST = 1e-9  # m: smaller is nothing


def hulls(meshes: Sequence[Mesh], source: str) -> list[Any]:
    """Convex hull of each mesh, a flat one made a little thick: solids of coal, never edited.

    Args:
        meshes: The files, which exist.
        source: The description that names them, for messages.

    Raises:
        BadRobot: A mesh cannot be read, is no surface, or has no numbers of an arm.
    """
    for file, _ in meshes:
        if file.suffix.lower() not in FORMATS:
            why = f"mesh {file}: its format is not read; give one of {', '.join(FORMATS)}"
            raise BadRobot(source, why)
    states = (stat(file) for file, _ in meshes)
    key = tuple((state.st_size, state.st_mtime_ns) for state in states)
    files = tuple((str(file), scale) for file, scale in meshes)
    try:
        return list(_hulls(files, key)) if files else []
    except ValueError as error:
        raise BadRobot(source, f"mesh {error}") from None


@lru_cache(maxsize=8)
def _hulls(files: tuple[tuple[str, Any], ...], _: Any) -> tuple[Any, ...]:
    """The shapes of files; the cache forgets those of files that have changed."""
    try:
        answer = in_child(corners, files, seconds=SECONDS, memory=MEMORY, files=1)
    except Exceeded as error:
        done = error.output.count(b"\n")
        file, _ = files[min(done, len(files) - 1)]
        raise ValueError(f"{file} {error}") from None
    return tuple(
        _convex(*msgspec.json.decode(line)) for line in answer.splitlines()
    )


def _convex(points: Iterable[list[float]], faces: Iterable[list[int]]) -> Any:
    """The solid of coal that has these corners and triangles."""
    triangles = coal.StdVec_Triangle()
    triangles.extend(coal.Triangle(*face) for face in faces)
    return coal.Convex(_vectors(points), triangles)


def _vectors(points: Iterable[npt.ArrayLike]) -> Any:
    vectors = coal.StdVec_Vec3s()
    vectors.extend(map(np.array, points))
    return vectors


def corners(files: Iterable[tuple[str, Sequence[float]]]) -> Iterator[bytes]:
    """Of each mesh's hull a line of JSON: its points (n, 3) [m] and triangles (m, 3)."""
    loader = coal.MeshLoader(coal.BV_OBBRSS)
    for file, scale in files:
        if not np.all(scale):
            raise ValueError(f"{file}: scale {tuple(scale)} leaves nothing of it")
        with _read(file):
            vertices = np.array(loader.load(file, np.array(scale)).vertices())
        points = _solid(vertices, file)
        with _read(file):
            hull = coal.Convex.convexHull(_vectors(points), True, "Qt")
        faces = [hull.polygons(k) for k in range(hull.num_polygons)]
        triangles = [[face[k] for k in range(3)] for face in faces]
        yield msgspec.json.encode((hull.points().tolist(), triangles)) + b"\n"


@contextmanager
def _read(file: str) -> Iterator[None]:
    """Say of what coal refuses which file it is."""
    try:
        yield
    except (ValueError, RuntimeError):
        raise ValueError(f"{file} cannot be read; convert it to STL") from None


def _solid(points: Array, file: str) -> Array:
    """Points that do not lie in a plane: those given, or where they do, on both sides of it."""
    if not (np.abs(points) < UNLIMITED).all():
        raise ValueError(f"{file}: a number is not finite or beyond any arm's size")
    centred = points - points.mean(axis=0)
    _, (long, wide, thick), axes = np.linalg.svd(centred, full_matrices=False)
    size = long / np.sqrt(len(points))
    if size < _SMALLEST or wide < _FLAT * long:
        raise ValueError(
            f"{file} has no surface; leave it out, or look at its scale"
        )
    if thick > _FLAT * long:
        return points
    step = _FLAT * size * axes[2]
    return np.concatenate([points - step, points + step])
