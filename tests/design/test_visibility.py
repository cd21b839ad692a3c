"""What a design says about parameters agrees with least squares, and about its cell with it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from excitant.design import Design, design_trajectory
from excitant.design.result import lone_torque, scaled_condition_number, weak_directions
from excitant.robots import Robot
from excitant.robots.geometry import load_obstacles, scene

OBSTACLES = [
    {"name": "table", "half_space": {"normal": [0.0, 0.6, 0.8], "offset": -0.9}},
    {"name": "pillar", "box": {"size": [1, 3, 9], "position": [2, 0, 4], "rpy": [0.1, 0.2, 0.5]}},
    {"name": "ball", "sphere": {"radius": 0.1, "position": [-1.6, -0.7, 0.6]}},
    {"name": "my cell", "workspace": {"low": [-1.0, -2.0, -0.5], "high": [2.0, 3.0, 1.5]}},
]


@pytest.fixture(scope="module")
def found(planar: Robot) -> Design:
    return design_trajectory(planar, harmonics=3, starts=2, jobs=1, noise=[1.0, 4.0])


def test_lone_torque_is_the_part_of_a_column_outside_the_others() -> None:
    W = np.random.default_rng(0).normal(size=(40, 6)) * [1, 10, 0.1, 1, 5, 2]
    W[:, 3] += 20 * W[:, 0]
    for k, size in enumerate(lone_torque(W.T @ W / 40)):
        others = np.delete(W, k, axis=1)
        rest = W[:, k] - others @ np.linalg.lstsq(others, W[:, k], rcond=None)[0]
        assert size == pytest.approx(np.linalg.norm(rest) / np.sqrt(40), rel=1e-6)
    W = W[:, :3]
    W[:, 2] = W[:, 0] - W[:, 1]
    assert lone_torque(W.T @ W / 40).max() < 1e-5 * np.abs(W).max()


def test_scaled_condition_number_does_not_depend_on_units() -> None:
    W = np.random.default_rng(2).normal(size=(50, 5))
    units = np.array([1.0, 1e3, 1e-3, 7.0, 0.2])
    M, N = W.T @ W, (W * units).T @ (W * units)
    unit_length = W / np.linalg.norm(W, axis=0)
    assert scaled_condition_number(M) == pytest.approx(np.linalg.cond(unit_length))
    assert scaled_condition_number(N) == pytest.approx(scaled_condition_number(M))
    M[0] = M[:, 0] = 0.0
    assert scaled_condition_number(M) is None


def test_weak_directions_are_the_last_singular_vectors() -> None:
    rng = np.random.default_rng(3)
    W, other = rng.normal(size=(2, 60, 4)) * [5.0, 0.1, 0.2, 3.0]
    names = ["a", "b", "c", "d"]
    found = weak_directions(names, W.T @ W / 60, other.T @ other / 60, count=2)
    _, sizes, Vt = np.linalg.svd(W / np.sqrt(60))
    for direction, size, v in zip(found, sizes[::-1], Vt[::-1], strict=False):
        assert direction["strength"] == pytest.approx(size)
        assert direction["other"] == pytest.approx(np.linalg.norm(other @ v) / np.sqrt(60))
        assert direction["members"][0]["name"] == names[int(np.abs(v).argmax())]
        assert direction["members"][0]["coefficient"] == pytest.approx(np.abs(v).max())
        assert all(abs(member["coefficient"]) >= 0.3 for member in direction["members"])


def test_predicted_standard_deviations_are_those_of_weighted_least_squares(found: Design) -> None:
    result, motion = found.result(), found.trajectory.sample(1001)
    W = found.information.observation(motion).reshape(-1, len(found.base))
    std = np.sqrt(np.diag(np.linalg.inv(W.T @ W)))
    names = [found.base.names[k] for k in found.base.columns]
    order = np.argsort(-std, kind="stable")[:10]
    assert [row["name"] for row in result["weakest"]] == [names[k] for k in order]
    for k, row in zip(order, result["weakest"], strict=True):
        assert row["std_per_unit_noise_final"] == pytest.approx(std[k], rel=1e-6)
        assert row["expression"] == found.base.expressions[k]
    unit_length = W / np.linalg.norm(W, axis=0)
    scaled = result["condition_number_scaled"]
    assert scaled["final"] == pytest.approx(np.linalg.cond(unit_length), rel=1e-6)
    assert result["joint_weights"] == pytest.approx([2.0, 0.5])


def test_obstacles_are_written_as_they_were_read(ur10: Robot, tmp_path: Path) -> None:
    file = tmp_path / "obstacles.yaml"
    file.write_text(yaml.safe_dump(OBSTACLES), encoding="utf-8")
    surroundings = scene(ur10, load_obstacles(file))
    assert surroundings is not None
    found = {row["name"]: row for row in (obstacle.plain() for obstacle in surroundings.obstacles)}
    assert len(found) == len(OBSTACLES)
    for entry in OBSTACLES:
        row = found[str(entry["name"])]
        for key, value in dict(entry[row["shape"]]).items():
            np.testing.assert_allclose(row[key], value, atol=1e-12)


def test_tool_ends_the_arm_at_every_pose(found: Design) -> None:
    series = found.series()
    assert "other_tools" not in series
    assert series["arm"].shape == (len(series["arm_t"]), found.robot.nv + 2, 3)
    at = np.searchsorted(series["t"], series["arm_t"])
    np.testing.assert_allclose(series["arm"][:, -1], series["tool"][at])
    np.testing.assert_allclose(series["arm"][:, 0], 0.0)
    lengths = np.linalg.norm(np.diff(series["arm"], axis=1), axis=2)
    np.testing.assert_allclose(lengths, lengths[:1].repeat(len(lengths), axis=0), atol=1e-12)
