"""Limits from files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from excitant.exceptions import BadInput
from excitant.robots import Robot, load_limits


def test_what_the_file_leaves_out_stays(builtin: Robot, tmp_path: Path) -> None:
    path = tmp_path / "limits.yaml"
    path.write_text("velocity: 1.5\n")
    limits = load_limits(path, builtin)
    assert (limits.velocity == 1.5).all()
    for name in ("position", "acceleration", "torque"):
        assert np.array_equal(getattr(limits, name), getattr(builtin.limits, name))


@pytest.mark.parametrize("suffix", [".yaml", ".json"])
@pytest.mark.parametrize("nested", [True, False])
def test_written_limits_are_read_back(
    builtin: Robot, tmp_path: Path, suffix: str, nested: bool
) -> None:
    names = ("position", "velocity", "acceleration", "torque")
    content = {name: (getattr(builtin.limits, name) * 0.5).tolist() for name in names}
    whole = {"limits": content} if nested else content
    path = tmp_path / f"limits{suffix}"
    path.write_text(json.dumps(whole) if suffix == ".json" else yaml.safe_dump(whole))
    limits = load_limits(path, builtin)
    for name in names:
        assert np.array_equal(getattr(limits, name), getattr(builtin.limits, name) * 0.5)


REFUSED: dict[str, tuple[str, str]] = {
    "too few": ("velocity: [1.0]\nacceleration: [1, 2, 3, 4, 5, 6, 7, 8]\n", "acceleration"),
    "position without pairs": ("position: [1, 2, 3]\n", "position"),
    "words": ("velocity: fast\n", "velocity"),
    "word among numbers": ("torque: [1, two]\n", "torque"),
    "nested too deep": ("velocity: [[[1]]]\n", "velocity"),
    "mapping of none": ("velocity: {no_joint: 1}\n", "velocity limits: unknown joint"),
    "unknown name": ("velocities: 1\n", "did you mean 'velocity'"),
    "lower above upper": ("position: [1, -1]\n", "lower must be below upper"),
    "lower equal to upper": ("position: [1, 1]\n", "lower must be below upper"),
    "zero speed": ("velocity: 0\n", "must be positive"),
    "negative torque": ("torque: -3\n", "must be positive"),
    "not a number": ("acceleration: .nan\n", "acceleration"),
    "position not a number": ("position: [.nan, 1]\n", "position"),
    "no mapping": ("- 1\n- 2\n", "expected entries"),
    "limits no mapping": ("limits: [1, 2]\n", "limits: expected entries"),
    "limits a number": ("limits: 3\n", "limits: expected entries"),
    "limits empty": ("limits:\n", "limits: expected entries"),
    "limit of a joint a word": ("velocity: {joint1: fast}\n", "velocity"),
    "not YAML": ("velocity: [1, 2\n", "not valid YAML .line 2: "),
    "empty": ("", "expected entries"),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_bad_limits_are_refused_in_one_line(builtin: Robot, tmp_path: Path, kind: str) -> None:
    text, culprit = REFUSED[kind]
    path = tmp_path / "limits.yaml"
    path.write_text(text)
    with pytest.raises(BadInput, match=culprit) as refused:
        load_limits(path, builtin)
    assert str(path) in str(refused.value)
    assert "\n" not in str(refused.value)


def test_the_joint_at_fault_is_named(builtin: Robot, tmp_path: Path) -> None:
    path = tmp_path / "limits.yaml"
    path.write_text(yaml.safe_dump({"torque": [*[5.0] * (builtin.nv - 1), 0.0]}))
    with pytest.raises(BadInput, match=builtin.joints[-1]):
        load_limits(path, builtin)


def test_missing_file(builtin: Robot, tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="no such file"):
        load_limits(tmp_path / "absent.yaml", builtin)
