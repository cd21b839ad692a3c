"""The benchmark of robustness: a few cases of each part, and that it sees what is broken."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import robustness as bench
from robustness_inputs import extreme_arm, motion, write_corpus

from excitant.design import random_trajectory, trajectory_csv
from excitant.robots import load_robot

FOLDER = Path(bench.__file__).parent


@pytest.fixture(scope="module")
def corpus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("corpus")
    write_corpus(folder)
    return folder


def test_every_file_is_sound_before_it_is_damaged(corpus: Path) -> None:
    for read in bench.READERS.values():
        assert read(corpus) is not None
    for line, files in bench.COMMANDS.items():
        assert all((corpus / name).is_file() for name in files), line


SLOW = pytest.mark.slow


@pytest.mark.parametrize(
    ("part", "seed"),
    [
        ("fuzz 12", 1),
        pytest.param("fuzz 150", 2, marks=SLOW),
        pytest.param("limits 2", 1, marks=SLOW),
        pytest.param("kills 2", 3, marks=SLOW),
        pytest.param("arms 1", 3, marks=SLOW),
    ],
)
def test_a_few_cases_break_nothing(part: str, seed: int) -> None:
    words = [*f"--{part}".split(), "--seed", str(seed), "--jobs", "1"]
    done = subprocess.run(
        [sys.executable, FOLDER / "robustness.py", *words], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert re.search(r"broken in any way +0 ", done.stdout)
    assert f"seed {seed}" in done.stdout


def test_a_folder_that_is_not_whole_is_seen(tmp_path: Path) -> None:
    run = tmp_path / "run"
    assert bench.half_written(run) == ""
    run.mkdir()
    assert bench.half_written(run) == "half-written"
    (run / "result.json").write_text(json.dumps({"files": ["run/model.yaml"]}))
    for name in bench.RUN - {"result.json"}:
        (run / name).touch()
    assert bench.half_written(run) == "half-written"
    (run / "model.yaml").touch()
    assert bench.half_written(run) == ""
    (tmp_path / ".excitant-1").mkdir()
    assert bench.half_written(run) == "staging left"


@pytest.mark.parametrize(
    ("status", "err", "found"),
    [
        (0, "a note\n", "result"),
        (1, "excitant: no such file\n", "refused"),
        (1, "excitant: a bug (KeyError: 3); please\n", "traceback"),
        ("Traceback ...", "", "traceback"),
        (1, "excitant: one\nexcitant: two\n", "several lines"),
        (0, "arm.py:3: RuntimeWarning: divide\n", "warning on the terminal"),
        (3, "", "status 3"),
    ],
)
def test_what_a_command_says_is_judged(status: int | str, err: str, found: str) -> None:
    assert bench.verdict(status, err, None) == found


def test_samples_beyond_a_limit_are_seen(tmp_path: Path) -> None:
    arm, rng = load_robot("planar_2r"), np.random.default_rng(0)
    path = random_trajectory(arm, rng, 4.0, 2)
    (tmp_path / "t.csv").write_text(trajectory_csv(path, 2000.0))
    fine = path.motion(2000.0)
    top = {"velocity": np.abs(fine.dq).max(axis=0), "acceleration": np.abs(fine.ddq).max(axis=0)}
    top["jerk"] = np.abs(path(fine.t, 3)).max(axis=0)
    low, high = fine.q.min(axis=0), fine.q.max(axis=0)
    given = {"position": np.column_stack([low, high])} | top
    given |= {"torque": np.full(2, 1e6)}
    assert bench.violations(arm, given, tmp_path / "t.csv") == ""
    for name, limit in top.items():
        said = bench.violations(arm, given | {name: 0.999 * limit}, tmp_path / "t.csv")
        assert said.startswith(name), said
    shorter = np.column_stack([low, high - 1e-3 * (high - low)])
    assert "position" in bench.violations(arm, given | {"position": shorter}, tmp_path / "t.csv")


def test_a_wrong_model_is_seen() -> None:
    """The given description of an extreme arm, whose bodies and friction are others."""
    arm = extreme_arm(np.random.default_rng(4))
    states = motion(np.random.default_rng(0), np.arange(0, 5, 0.02), arm.scale)
    assert arm.true.nv == len(arm.scale) == len(arm.friction)
    robot = load_robot("planar_2r")
    two = motion(np.random.default_rng(0), np.arange(0, 5, 0.02), np.ones(2))
    truth = bench.off(robot, two, np.zeros((250, 2)) + two[0])
    assert (truth > bench.WRONG).all()
    assert np.isfinite(arm.torque(states)).all()
