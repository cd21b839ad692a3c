"""An arm is drawn where its joints carry its shapes, and says what it is drawn by."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from excitant.robots import Robot, load_robot
from excitant.robots.appearance import Appearance
from excitant.robots.geometry import scene

DATA = Path(__file__).parent / "data"
MESH = '<{kind}><geometry><mesh filename="{file}"/></geometry></{kind}></link>'


def place(values: list[float]) -> pin.SE3:
    return pin.XYZQUATToSE3(np.array(values))


def placements(entries: dict, q: np.ndarray) -> list[pin.SE3]:
    """Placement of the base and of every joint, by nothing but the entries."""
    placed = [pin.SE3.Identity()]
    for joint, angle in zip(entries["joints"], q, strict=True):
        axis = np.array(joint["axis"])
        turn = np.eye(3) if joint["slides"] else pin.AngleAxis(angle, axis).matrix()
        shift = angle * axis if joint["slides"] else np.zeros(3)
        placed.append(placed[joint["parent"]] * place(joint["place"]) * pin.SE3(turn, shift))
    return placed


def test_the_tree_of_joints_is_that_of_the_arm(arm: Robot) -> None:
    entries, data = Appearance(arm).entries(), arm.model.createData()
    for q in arm.random_motion(np.random.default_rng(0), 20)[0]:
        pin.framesForwardKinematics(arm.model, data, q)
        placed = placements(entries, q)
        for there, here in zip(data.oMi, placed, strict=True):
            np.testing.assert_allclose(here.homogeneous, there.homogeneous, atol=1e-9)
        tool = placed[entries["tool"]["joint"]] * place(entries["tool"]["place"])
        np.testing.assert_allclose(tool.homogeneous, data.oMf[arm.tip].homogeneous, atol=1e-9)


def test_shapes_are_those_that_clearance_is_computed_with(builtin: Robot) -> None:
    shapes = Appearance(builtin).entries()["shapes"]
    cell = scene(builtin)
    if cell is None:
        assert builtin.name == "planar_2r"
        return
    bodies = list(cell.geometry.geometryObjects)
    assert len(shapes) == len(bodies)
    for shape, body in zip(shapes, bodies, strict=True):
        assert shape["joint"] == body.parentJoint
        here, there = place(shape["place"]).homogeneous, body.placement.homogeneous
        np.testing.assert_allclose(here, there, atol=1e-12)
        radius, *length = shape["size"]
        assert radius == body.geometry.radius
        assert length == ([] if shape["kind"] == "sphere" else [2 * body.geometry.halfLength])


def test_an_arm_without_shapes_has_rods_that_join_its_joints(gantry: Robot) -> None:
    """From every joint to the next, whatever the pose; the slide has a rail over its range."""
    look = Appearance(gantry)
    entries = look.entries()
    [note] = look.notes
    assert "without shapes, drawn as rods" in note
    rods = [shape for shape in entries["shapes"] if shape["kind"] == "cylinder"]
    placed = placements(entries, q := np.array([0.3, -0.5, 0.8]))
    ends = []
    for rod in rods:
        at, half = placed[rod["joint"]] * place(rod["place"]), rod["size"][1] / 2
        ends.append([at.act(np.array([0, 0, side * half])) for side in (-1, 1)])
    for joint in (2, 3):  # the first one slides on its rail
        parent = entries["joints"][joint - 1]["parent"]
        wanted = [placed[parent].translation, placed[joint].translation]
        gaps = [min(np.abs(np.subtract(p, wanted)).max() for p in (e, e[::-1])) for e in ends]
        assert min(gaps) < 1e-9 or np.linalg.norm(np.subtract(*wanted)) < 0.05
    slide = entries["joints"][0]
    low, high = gantry.limits.position[0]
    [rail] = [rod for rod in rods if rod["size"][1] == pytest.approx(high - low)]
    for end, value in ((-1, low), (1, high)):
        at = place(rail["place"]).act(np.array([0, 0, end * rail["size"][1] / 2]))
        there = placements(entries, np.array([value, *q[1:]]))[1].translation
        np.testing.assert_allclose(at, there, atol=1e-9)
    assert slide["slides"]


def test_a_link_without_collision_shapes_is_drawn_by_its_visual_ones(
    tmp_path: Path, gantry_urdf: str
) -> None:
    shutil.copy(DATA / "wedge.stl", tmp_path)
    path = tmp_path / "arm.urdf"
    path.write_text(gantry_urdf.replace("</link>", MESH.format(kind="visual", file="wedge.stl")))
    look = Appearance(load_robot(path))
    entries, meshes = look.entries(), look.meshes()
    assert {shape["kind"] for shape in entries["shapes"]} == {"mesh"}
    assert [note for note in look.notes if "visual shapes, which are not checked" in note]
    points, faces = meshes["mesh0_points"], meshes["mesh0_faces"].astype(int)
    assert (points.shape, faces.shape) == ((4, 3), (4, 3))
    edges = [
        tuple(sorted(pair)) for face in faces for pair in zip(face, np.roll(face, 1), strict=True)
    ]
    assert all(edges.count(edge) == 2 for edge in edges)  # closed


@pytest.mark.parametrize("kind", ["collision", "visual"])
def test_meshes_that_are_not_there_are_said(tmp_path: Path, gantry_urdf: str, kind: str) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(gantry_urdf.replace("</link>", MESH.format(kind=kind, file="none.stl")))
    look = Appearance(load_robot(path))
    rods, missing = look.notes
    assert "drawn as rods" in rods
    count = gantry_urdf.count("</link>")
    assert missing == f"{count} {kind} meshes were not found"
    assert look.meshes() == {}


def test_a_damaged_mesh_leaves_rods(tmp_path: Path, gantry_urdf: str) -> None:
    (tmp_path / "bad.stl").write_bytes(b"solid")
    path = tmp_path / "arm.urdf"
    path.write_text(gantry_urdf.replace("</link>", MESH.format(kind="collision", file="bad.stl")))
    assert "drawn as rods" in Appearance(load_robot(path)).notes[0]
