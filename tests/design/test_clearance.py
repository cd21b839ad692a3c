"""Clearance is a distance that holds at every instant, not only at the samples."""

import re
from pathlib import Path

import numpy as np
import pytest

from excitant.design import clearance, design_trajectory, from_coefficients
from excitant.exceptions import BadInput, Infeasible
from excitant.robots import load_robot
from excitant.robots.geometry import Obstacle, Scene, load_obstacles, scene
from excitant.robots.schema import BoxRecord, HalfSpaceRecord, SphereRecord, WorkspaceRecord
from excitant.robots.urdf import robot_from_urdf

FLOOR = Obstacle("floor", "half_space", HalfSpaceRecord((0.0, 0.0, 1.0), -0.15))


@pytest.fixture(scope="module")
def cell() -> Scene:
    found = scene(load_robot("ur10"), (FLOOR,))
    assert found is not None
    return found


def path(cell: Scene, seed: int):
    rng = np.random.default_rng(seed)
    nv = cell.robot.nv
    return from_coefficients(np.vstack([rng.uniform(-2, 2, nv), 0.3 * rng.normal(size=(6, nv))]), 8)


@pytest.mark.parametrize("seed", range(4))
def test_no_instant_is_nearer_than_certified(cell: Scene, seed: int) -> None:
    trajectory = path(cell, seed)
    found = clearance(cell, trajectory)
    dense = cell.distances(trajectory(np.linspace(0, 8, 4001)))
    assert found.certified <= dense.min() <= found.distance + 1e-3
    assert found.distance - found.certified <= 2e-3
    k = int(np.argmin(dense.min(axis=1)))
    worst = cell.pairs[int(dense[k].argmin())]
    assert found.bodies == worst or abs(np.sort(dense.min(axis=0))[1] - dense.min()) < 2e-3


def test_gradient_is_that_of_the_distance(cell: Scene) -> None:
    rng = np.random.default_rng(3)
    # coal's distances are right to about 1e-6 m, so a wide step: 1e-6 / h + O(h²) per radian
    h, checked = 1e-3, 0
    for q in rng.uniform(-2, 2, (12, 6)):
        for pair in range(0, len(cell.pairs), 5):
            distance, gradient = cell.gradient(q, pair)
            if distance < 0.02:  # inside each other the nearest points jump
                continue
            ends = [cell.distances(q + s * h * np.eye(6))[:, pair] for s in (1, -1)]
            np.testing.assert_allclose(gradient, (ends[0] - ends[1]) / (2 * h), atol=5e-3)
            checked += 1
    assert checked > 50


def test_gradient_of_an_arm_of_one_joint() -> None:
    room = Obstacle("room", "workspace", WorkspaceRecord((-1.0,) * 3, (1.0,) * 3))
    one = scene(load_robot("planar_2r", lock={"joint2": 0.3}), (room,))
    assert one is not None
    h, q = 1e-3, np.array([0.7])
    above, below = (one.distances(q[None] + s * h)[0] for s in (1, -1))
    slopes = [one.gradient(q, pair)[1] for pair in range(len(one.pairs))]
    np.testing.assert_allclose(np.ravel(slopes), (above - below) / (2 * h), atol=5e-3)
    assert np.abs(slopes).max() > 0.2


def test_speeds_bound_every_gradient(cell: Scene) -> None:
    """Of turning joints, and of a slide, which moves a body as fast as itself."""
    sliding = scene(load_robot("scara"))
    assert sliding is not None
    for found in (cell, sliding):
        bound = found.speeds()
        for q in found.robot.random_motion(np.random.default_rng(4), 15)[0]:
            for pair in range(len(found.pairs)):
                assert (np.abs(found.gradient(q, pair)[1]) <= bound[pair] + 1e-9).all()


def test_design_keeps_the_clearance() -> None:
    robot = load_robot("planar_2r")
    wall = Obstacle("wall", "box", BoxRecord((0.1, 4.0, 4.0), (0.55, 0.0, 0.0)))  # in its reach
    around = scene(robot, (wall,))
    assert around is not None
    options = {"columns": "inertial", "harmonics": 3, "starts": 2, "jobs": 1}
    free = design_trajectory(robot, **options)  # type: ignore[arg-type]
    kept = design_trajectory(robot, scene=around, clearance=0.03, **options)  # type: ignore[arg-type]
    assert clearance(around, free.trajectory).distance < 0.03  # the wall matters
    assert kept.clearance is not None
    assert kept.clearance.certified >= 0.03
    dense = around.distances(kept.trajectory(np.linspace(0, kept.duration, 5001)))
    assert dense.min() >= 0.03
    assert kept.limits.hold


def test_a_cell_without_room_is_refused() -> None:
    robot = load_robot("planar_2r")
    everywhere = Obstacle("rock", "sphere", SphereRecord(5.0, (0.0, 0.0, 0.0)))
    with pytest.raises(Infeasible, match="too close to an obstacle"):
        design_trajectory(robot, starts=1, jobs=1, scene=scene(robot, (everywhere,)))


def test_a_robot_without_shapes_has_no_scene() -> None:
    bare = re.sub("<collision>.*?</collision>", "", load_robot("planar_2r").urdf, flags=re.DOTALL)
    assert scene(robot_from_urdf(bare, source="bare.urdf")) is None


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (
            "- box: {size: [1, 1], position: [0, 0, 0]}",
            r"s\[0\].box.size: expected a list of length 3",
        ),
        ("- sphere: {radius: -1, position: [0, 0, 0]}", "radius: expected a number above 0"),
        ("- sphere: {radius: 1}", "sphere: it lacks 'position'"),
        ("- cone: {}", "obstacles.0.: unknown entry 'cone'"),
        ("- half_space: {normal: [0, 0, 0], offset: 1}", "normal must not be zero"),
        ("box", "expected a list"),
        ("- [", "not valid YAML .line 1: "),
    ],
)
def test_bad_obstacles_are_refused_in_one_line(text: str, says: str, tmp_path: Path) -> None:
    file = tmp_path / "cell.yaml"
    file.write_text(text)
    with pytest.raises(BadInput, match=says) as error:
        load_obstacles(file)
    assert "\n" not in str(error.value)
    assert "cell.yaml" in str(error.value)
