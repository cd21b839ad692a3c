"""An arm is drawn where its joints carry its shapes, and says what it is drawn by."""

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from excitant.robots import Robot
from excitant.robots.appearance import Appearance
from excitant.robots.geometry import scene
from excitant.robots.urdf import robot_from_urdf

DATA = Path(__file__).parent / "data"


def meshed(urdf: str, kind: str, file: str) -> str:
    mesh = f'<{kind}><geometry><mesh filename="{file}"/></geometry></{kind}>'
    return urdf.replace("</link>", f"{mesh}</link>")


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
    assert entries["joints"][0]["slides"]
    low, high = gantry.limits.position[0]
    [rail] = [rod for rod in rods if rod["size"][1] == pytest.approx(high - low)]
    for end, value in ((-1, low), (1, high)):
        at = place(rail["place"]).act(np.array([0, 0, end * rail["size"][1] / 2]))
        there = placements(entries, np.array([value, *q[1:]]))[1].translation
        np.testing.assert_allclose(at, there, atol=1e-9)


def test_a_link_without_collision_shapes_is_drawn_by_its_visual_ones(gantry_urdf: str) -> None:
    text = meshed(gantry_urdf, "visual", "wedge.stl")
    look = Appearance(robot_from_urdf(text, str(DATA / "arm.urdf")))
    entries, meshes = look.entries(), look.meshes()
    assert {shape["kind"] for shape in entries["shapes"]} == {"mesh"}
    assert [note for note in look.notes if "visual shapes, which are not checked" in note]
    points, faces = meshes["mesh0_points"], meshes["mesh0_faces"].astype(int)
    assert (points.shape, faces.shape) == ((4, 3), (4, 3))
    pairs = [tuple(sorted(face[[k, k - 1]])) for face in faces for k in range(3)]
    assert all(pairs.count(edge) == 2 for edge in pairs)  # closed


@pytest.mark.parametrize("kind", ["collision", "visual"])
def test_meshes_that_are_not_there_or_damaged_leave_rods(tmp_path, gantry_urdf, kind):
    text = meshed(gantry_urdf, kind, "bad.stl")
    look = Appearance(robot_from_urdf(text, str(tmp_path / "arm.urdf")))
    rods, missing = look.notes
    assert "drawn as rods" in rods
    assert missing == f"{gantry_urdf.count('</link>')} {kind} meshes were not found"
    assert look.meshes() == {}
    (tmp_path / "bad.stl").write_bytes(b"solid")
    damaged = Appearance(robot_from_urdf(text, str(tmp_path / "arm.urdf")))
    assert "drawn as rods" in damaged.notes[0]
