"""Limits from files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from excitant.exceptions import BadInput
from excitant.robots import Robot, load_limits


def test_what_the_file_leaves_out_stays(planar: Robot, tmp_path: Path) -> None:
    path = tmp_path / "limits.yaml"
    path.write_text("velocity: 1.5\n")
    limits = load_limits(path, planar)
    assert (limits.velocity == 1.5).all()
    for name in ("position", "acceleration", "torque"):
        assert np.array_equal(getattr(limits, name), getattr(planar.limits, name))


@pytest.mark.parametrize("suffix", [".yaml", ".json"])
@pytest.mark.parametrize("nested", [True, False])
def test_written_limits_are_read_back(
    planar: Robot, tmp_path: Path, suffix: str, nested: bool
) -> None:
    names = ("position", "velocity", "acceleration", "torque")
    content = {name: (getattr(planar.limits, name) * 0.5).tolist() for name in names}
    whole = {"limits": content} if nested else content
    path = tmp_path / f"limits{suffix}"
    path.write_text(json.dumps(whole) if suffix == ".json" else yaml.safe_dump(whole))
    limits = load_limits(path, planar)
    for name in names:
        assert np.array_equal(getattr(limits, name), getattr(planar.limits, name) * 0.5)


REFUSED: dict[str, tuple[str, str]] = {
    "too few": ("velocity: [1.0]\nacceleration: [1, 2, 3, 4, 5, 6, 7, 8]\n", "acceleration"),
    "words": ("velocity: fast\n", "velocity"),
    "mapping of none": ("velocity: {no_joint: 1}\n", "velocity limits: unknown joint"),
    "unknown name": ("velocities: 1\n", "did you mean 'velocity'"),
    "lower equal to upper": ("position: [1, 1]\n", "lower must be below upper"),
    "zero speed": ("velocity: 0\n", "must be positive"),
    "not a number": ("acceleration: .nan\n", "acceleration"),
    "no mapping": ("- 1\n- 2\n", "expected entries"),
    "limits empty": ("limits:\n", "limits: expected entries"),
    "not YAML": ("velocity: [1, 2\n", "not valid YAML .line 2: "),
    "empty": ("", "expected entries"),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_bad_limits_are_refused_in_one_line(planar: Robot, tmp_path: Path, kind: str) -> None:
    text, culprit = REFUSED[kind]
    path = tmp_path / "limits.yaml"
    path.write_text(text)
    with pytest.raises(BadInput, match=culprit) as refused:
        load_limits(path, planar)
    assert str(path) in str(refused.value)
    assert "\n" not in str(refused.value)


def test_the_joint_at_fault_is_named(planar: Robot, tmp_path: Path) -> None:
    path = tmp_path / "limits.yaml"
    path.write_text(yaml.safe_dump({"torque": [*[5.0] * (planar.nv - 1), 0.0]}))
    with pytest.raises(BadInput, match=planar.joints[-1]):
        load_limits(path, planar)
