"""Clearance is a distance that holds at every instant, not only at the samples."""

import re
from pathlib import Path
from xml.etree import ElementTree as ET

import mujoco
import numpy as np
import pinocchio as pin
import pytest
import yaml
from marks import refused, slow
from urdf_arms import urdf_of

from excitant.design import Trajectory, build_design, clearance, design_trajectory
from excitant.exceptions import BadInput, Infeasible
from excitant.robots import Robot, load_robot
from excitant.robots.geometry import Obstacle, Scene, base_plane, floor, scene, unchecked
from excitant.robots.obstacles_file import load_obstacles
from excitant.robots.schema import BoxRecord, HalfSpaceRecord, SphereRecord, WorkspaceRecord
from excitant.robots.urdf import robot_from_urdf

ROOM = Obstacle("room", "workspace", WorkspaceRecord((-1.0,) * 3, (1.0,) * 3))
OBSTACLES = [
    {"name": "table", "half_space": {"normal": [0.0, 0.6, 0.8], "offset": -0.9}},
    {"name": "pillar", "box": {"size": [1, 3, 9], "position": [2, 0, 4], "rpy": [0.1, 0.2, 0.5]}},
    {"name": "ball", "sphere": {"radius": 0.1, "position": [-1.6, -0.7, 0.6]}},
    {"name": "my cell", "workspace": {"low": [-1.0, -2.0, -0.5], "high": [2.0, 3.0, 1.5]}},
]


@pytest.fixture(scope="module")
def cells() -> dict[str, Scene | None]:
    return {
        "six joints": scene(load_robot("ur10"), (floor(-0.15),)),
        "one joint": scene(load_robot("planar_2r", lock={"joint2": 0.3}), (ROOM,)),
        "a slide": scene(load_robot("scara")),
    }


@pytest.mark.parametrize("seed", [0, 1, slow(2), slow(3)])
def test_no_instant_is_nearer_than_certified(cells: dict[str, Scene], seed: int) -> None:
    rng, cell = np.random.default_rng(seed), cells["six joints"]
    nodes = np.vstack([rng.uniform(-2, 2, 6), 0.3 * rng.normal(size=(6, 6))])
    trajectory = Trajectory(nodes, 8)
    found = clearance(cell, trajectory)
    dense = cell.distances(trajectory(np.linspace(0, 8, 4001)))
    assert found.certified <= dense.min() <= found.distance + 1e-3
    assert found.distance - found.certified <= 2e-3
    nearest = dense.min(axis=0)
    worst = cell.pairs[int(nearest.argmin())]
    assert found.bodies == worst or abs(np.sort(nearest)[1] - dense.min()) < 2e-3


@pytest.mark.parametrize(("name", "least"), [("six joints", 50), ("one joint", 12), ("a slide", 9)])
def test_gradient_is_that_of_the_distance_and_within_the_speeds(cells, name, least):
    """A turning joint moves a body by its lever, a slide as fast as itself."""
    cell, way, bound = cells[name], np.eye(cells[name].robot.nv), cells[name].speeds()
    # coal's distances are right to about 1e-6 m, so a wide step: 1e-6 / h + O(h²) per radian
    h, checked = 1e-3, []
    for q in cell.robot.random_motion(np.random.default_rng(4), 15)[0]:
        slopes = (cell.distances(q + h * way) - cell.distances(q - h * way)) / (2 * h)
        for pair in range(len(cell.pairs)):
            distance, gradient = cell.gradient(q, pair)
            assert (np.abs(gradient) <= bound[pair] + 1e-9).all()
            if distance > 0.02:  # inside each other the nearest points jump
                np.testing.assert_allclose(gradient, slopes[:, pair], atol=5e-3)
                checked.append(gradient)
    assert len(checked) > least
    assert np.abs(checked).max() > 0.2


def test_design_keeps_the_clearance(planar: Robot) -> None:
    wall = Obstacle("wall", "box", BoxRecord((0.1, 4.0, 4.0), (0.55, 0.0, 0.0)))  # in its reach
    around = scene(planar, (wall,))
    options = {"columns": "inertial", "periods": 1, "harmonics": 3, "starts": 1, "jobs": 1}
    free = design_trajectory(planar, **options)
    kept = design_trajectory(planar, scene=around, clearance=0.03, **options)
    assert clearance(around, free.trajectory).distance < 0.03  # the wall matters
    dense = around.distances(kept.trajectory(np.linspace(0, kept.duration, 5001)))
    assert min(dense.min(), kept.clearance.certified) >= 0.03
    assert kept.limits.hold


@pytest.mark.slow
def test_the_tool_stays_in_its_workspace(planar: Robot) -> None:
    low, high = (-0.9, -0.1, -0.5), (0.5, 0.1, 0.9)
    around = scene(planar, (Obstacle("cell", "workspace", WorkspaceRecord(low, high)),))
    options = {"columns": "inertial", "periods": 1, "harmonics": 3, "starts": 1, "jobs": 1}
    data, inside = planar.model.createData(), []
    for cell in (around, ()):
        found = design_trajectory(planar, scene=cell, clearance=0.0, **options)
        tools = []
        for q in found.trajectory.sample(1001).q:
            pin.framesForwardKinematics(planar.model, data, q)
            tools.append(data.oMf[planar.tip].translation.copy())
        inside.append(np.all((np.array(tools) >= low) & (np.array(tools) <= high)))
    assert inside == [True, False]  # the cell matters


def test_a_cell_without_room_is_refused(planar: Robot) -> None:
    everywhere = Obstacle("rock", "sphere", SphereRecord(5.0, (0.0, 0.0, 0.0)))
    with pytest.raises(Infeasible, match="too close to an obstacle"):
        design_trajectory(planar, starts=1, jobs=1, scene=scene(planar, (everywhere,)))


def test_obstacles_are_written_as_they_were_read(ur10: Robot, tmp_path: Path) -> None:
    file = tmp_path / "obstacles.yaml"
    file.write_text(yaml.safe_dump(OBSTACLES), encoding="utf-8")
    rows = [obstacle.plain() for obstacle in scene(ur10, load_obstacles(file)).obstacles]
    assert [row["name"] for row in rows] == [entry["name"] for entry in OBSTACLES]
    for row, entry in zip(rows, OBSTACLES, strict=True):
        for key, value in entry[row["shape"]].items():
            np.testing.assert_allclose(row[key], value, atol=1e-12)


REFUSED = {
    "- box: {size: [1, 1], position: [0, 0, 0]}": r"s\[0\].box.size: expected a list of length 3",
    "- sphere: {radius: -1, position: [0, 0, 0]}": "radius: expected a number above 0",
    "- sphere: {radius: 1}": "sphere: it lacks 'position'",
    "- cone: {}": "obstacles.0.: unknown entry 'cone'",
    "- half_space: {normal: [0, 0, 0], offset: 1}": "normal must not be zero",
    "- workspace: {low: [0, 0, 1], high: [1, 1, 0]}": r"s\[0\]\.workspace: low must be below high",
    "box": "expected a list",
    "- [": "not valid YAML .line 1: ",
}


@pytest.mark.parametrize("text", REFUSED)
def test_bad_obstacles_are_refused_in_one_line(text: str, tmp_path: Path) -> None:
    file = tmp_path / "cell.yaml"
    file.write_text(text)
    assert "cell.yaml" in refused(REFUSED[text], load_obstacles, file, error=BadInput)


@pytest.mark.parametrize("name", ["ur10", "scara", "puma560"])
def test_an_arm_stands_on_the_plane_of_its_base(name: str) -> None:
    """The pedestal of puma560 is part of its description."""
    robot = load_robot(name)
    assert base_plane(robot) == pytest.approx(-0.67 if name == "puma560" else 0.0, abs=1e-3)
    assert base_plane(robot.with_gravity([9.81, 0.0, 0.0])) is None  # bolted to a wall


def test_an_arm_that_hangs_through_the_plane_of_its_base_has_no_floor(ur10: Robot) -> None:
    root = ET.fromstring(ur10.urdf)
    [first] = [j for j in root.findall("joint") if j.get("name") == ur10.joints[0]]
    first.find("origin").attrib.update(xyz="0 0 -0.127", rpy="3.14159265 0 0")
    hanging = robot_from_urdf(ET.tostring(root, encoding="unicode"), source="arm.urdf")
    assert base_plane(hanging) is None


def drawn_close(gap: float) -> Robot:
    """An arm whose last link, on an axis tilted a little, passes closely above its first."""
    box = '<collision><origin xyz="{}"/><geometry><box size="{}"/></geometry></collision>'
    above = box.format(f"0.1 0 {0.02 + gap}", "0.02 0.02 0.02")
    usual = {"com": "0.05 0.02 0", "mass": 1, "inertia": 0.1, "low": -3, "high": 3, "effort": 50}
    first = {"xyz": "0 0 0", "shape": box.format("0.05 0 0", "0.3 0.3 0.02")}
    last = {"rpy": "0.03 0 0", "shape": above}
    text = urdf_of(first, {}, last, **{"xyz": "0.05 0 0"} | usual)
    return robot_from_urdf(text, source="close.urdf")


@pytest.mark.slow
def test_bodies_drawn_closer_than_the_clearance_keep_half_of_their_distance() -> None:
    robot = drawn_close(0.006)
    around, apart = scene(robot), scene(robot, (), 0.0)
    assert around.pairs == (("link1_0", "link3_0"),)
    q = robot.random_motion(np.random.default_rng(1), 500)[0]
    true = apart.distances(q)[:, 0]
    assert 0 < true.max() < 0.01  # no motion gives them a centimetre
    np.testing.assert_allclose(around.distances(q)[:, 0], around.scale[0] * true)
    assert around.scale[0] * true.max() == pytest.approx(0.02, rel=0.05)
    assert unchecked(robot, around).startswith("full clearance between link1_0 and link3_0")
    found = design_trajectory(robot, scene=around, columns="inertial", starts=1, jobs=1, seed=1)
    motion = found.trajectory(np.linspace(0, found.duration, 2001))
    assert apart.distances(motion).min() >= 0.45 * true.max()
    nearest = found.result()["closest"]["distance_m"]
    assert nearest == pytest.approx(apart.distances(motion).min(), abs=1e-4)
    value, slope = around.gradient(q[0], 0)
    for j, step in enumerate(1e-6 * np.eye(3)):
        ahead, behind = (around.gradient(q[0] + sign * step, 0)[0] for sign in (1, -1))
        assert (ahead - behind) / 2e-6 == pytest.approx(slope[j], abs=1e-4 * abs(value) / 1e-3)


def test_poses_that_are_all_too_close_are_refused_by_the_names_of_the_bodies() -> None:
    robot = drawn_close(0.006)
    wall = Obstacle("wall", "half_space", HalfSpaceRecord((0.0, 0.0, 1.0), 0.5))
    with pytest.raises(Infeasible, match=r"at best, link\d_0 and wall are -\d+ mm apart, required"):
        design_trajectory(robot, scene=scene(robot, (wall,)), starts=1, jobs=1)


def test_what_is_not_checked_is_said(planar: Robot, ur10: Robot, tmp_path: Path) -> None:
    shape = '<collision><geometry><mesh filename="no.stl"/></geometry></collision>'
    half = ur10.urdf.replace("<collision", shape + "<collision", 1)
    none = re.sub("<collision>.*?</collision>", "", ur10.urdf, flags=re.DOTALL)
    broken, bare = (robot_from_urdf(text, source="arm.urdf") for text in (half, none))
    total = half.count("<collision>")
    missing = f"self-collision, 1 of {total} collision meshes not found; floor"
    assert unchecked(broken, scene(broken)) == missing
    assert scene(bare) is None
    assert unchecked(bare, None) == "self-collision, no link has a collision shape; floor"
    assert unchecked(ur10, scene(ur10)) == "floor"
    assert unchecked(ur10, scene(ur10, (floor(0.0),))) == ""
    assert unchecked(planar, None) == "self-collision; floor"
    shapes = re.findall("<collision>.*?</collision>", ur10.urdf, flags=re.DOTALL)
    visual = shapes[-1].replace("collision>", "visual>")
    pelvis, wrist = (ur10.urdf, ur10.urdf.replace(shapes[-1], visual))
    for other in shapes[1:]:
        pelvis = pelvis.replace(other, "")
    drawn, alone = (robot_from_urdf(text, source="arm.urdf") for text in (wrist, pelvis))
    assert unchecked(drawn, scene(drawn)) == "wrist_3_link, without collision shapes; floor"
    lack = "self-collision, no moving link has a collision shape; floor"
    assert unchecked(alone, scene(alone, (floor(0.0),))) == lack
    (tmp_path / "no.stl").write_text("not a mesh")  # counted, not read: clearance may be left out
    there = robot_from_urdf(half, source=str(tmp_path / "arm.urdf"))
    assert unchecked(there, None) == "self-collision; floor"


@pytest.mark.slow
@pytest.mark.parametrize("name", ["scara", "panda", "so100"])
def test_mujoco_sees_no_contact_floor_included(name: str) -> None:
    """At 1 kHz, bodies of neighbouring links aside; left alone, the same arms do collide."""
    robot = load_robot(name)
    around = scene(robot, (floor(base_plane(robot)),))
    options = {"columns": "inertial", "harmonics": 4, "starts": 1, "jobs": 1, "duration": 5.0}
    found = design_trajectory(robot, scene=around, **options)
    assert contacts_in_mujoco(robot, found.trajectory.motion(1000.0).q) == 0
    q = robot.random_motion(np.random.default_rng(0), 300)[0]
    assert contacts_in_mujoco(robot, q) > 10


def contacts_in_mujoco(robot: Robot, q: np.ndarray) -> int:
    """Poses (n, nv) in which MuJoCo finds bodies in each other, or in a plane under the base."""
    root = ET.fromstring(robot.urdf)
    for link in root.findall("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
    ET.SubElement(ET.SubElement(root, "mujoco"), "compiler", fusestatic="false")
    spec = mujoco.MjSpec.from_string(ET.tostring(root, encoding="unicode"))
    plane = {"type": mujoco.mjtGeom.mjGEOM_PLANE, "size": [0, 0, 1]}
    spec.worldbody.add_geom(name="floor", pos=[0, 0, base_plane(robot)], **plane)
    model = spec.compile()
    data, carrier = mujoco.MjData(model), np.zeros(model.nbody, int)
    for body in range(1, model.nbody):
        joint = model.body_jntadr[body]
        own = model.joint(joint).name if joint >= 0 else ""
        held = carrier[model.body_parentid[body]]
        carrier[body] = robot.joints.index(own) + 1 if own in robot.joints else held
    addresses = [model.joint(joint).qposadr[0] for joint in robot.joints]
    for joint, value in robot.locked:
        data.qpos[model.joint(joint).qposadr[0]] = value
    count = 0
    for pose in q:
        data.qpos[addresses] = pose
        for step in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_collision):
            step(model, data)
        deep = [contact.geom for contact in data.contact[: data.ncon] if contact.dist < 0]
        pairs = np.sort(carrier[model.geom_bodyid[np.reshape(deep, (-1, 2)).astype(int)]], axis=1)
        count += any(a != b and robot.model.parents[b] != a for a, b in pairs.tolist())
    return count


@pytest.mark.usefixtures("own_time")
def test_a_design_keeps_clear_of_itself_and_the_floor_without_a_word() -> None:
    """The wrist came 846 mm below the floor where nothing was said of a scene."""
    options = {"duration": 5.0, "harmonics": 3, "starts": 1, "jobs": 1, "time_limit": 2.0}
    robot = load_robot("ur10")
    kept = design_trajectory(robot, **options)
    assert [obstacle.name for obstacle in kept.scene.obstacles] == ["floor"]
    assert kept.clearance.distance >= 0.01
    assert build_design(robot, scene=()).scene is None
