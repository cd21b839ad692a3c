"""The benchmark of robustness: a few cases of each part, and that it sees what is broken."""

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import robustness as bench
from marks import slow
from robustness_inputs import motion, write_corpus

from excitant.design import random_trajectory, trajectory_csv
from excitant.identify import model_files
from excitant.robots import Motion, load_robot, torque

FOLDER = Path(bench.__file__).parent


@pytest.fixture(scope="module")
def corpus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("corpus")
    write_corpus(folder)
    return folder


@pytest.mark.slow
def test_every_file_is_sound_before_it_is_damaged(corpus: Path) -> None:
    for name, read in bench.READERS.items():
        assert read(corpus, name) is not None
    for line, files in bench.COMMANDS.items():
        assert all((corpus / name).is_file() for name in files), line


PARTS = (("fuzz 6", 1), ("fuzz 100", 2), ("limits 1", 1), ("kills 1", 3), ("arms 1", 3))


@pytest.mark.parametrize(("part", "seed"), [slow(*part) for part in PARTS])
def test_a_few_cases_break_nothing(part: str, seed: int) -> None:
    words = f"{part.replace(' ', ' --count ')} --seed {seed} --jobs 1".split()
    command = [sys.executable, FOLDER / "robustness.py", *words]
    done = subprocess.run(command, capture_output=True, text=True)
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
    given = {"position": np.column_stack([low, high]), "torque": np.full(2, 1e6)} | top
    assert bench.violations(arm, given, tmp_path / "t.csv") == ""
    for name, limit in top.items():
        said = bench.violations(arm, given | {name: 0.999 * limit}, tmp_path / "t.csv")
        assert said.startswith(name), said
    shorter = np.column_stack([low, high - 1e-3 * (high - low)])
    assert "position" in bench.violations(arm, given | {"position": shorter}, tmp_path / "t.csv")


def test_a_wrong_model_is_seen(tmp_path: Path) -> None:
    """A model that was published without a word, beside torque that is twice its own."""
    robot = load_robot("planar_2r")
    for name, text in model_files(robot, "model", "model.yaml").items():
        (tmp_path / name).write_text(text)
    states = motion(np.random.default_rng(0), np.arange(0, 5, 0.02), np.ones(2))
    truth = torque(robot, Motion(np.arange(250.0), *states))
    joints = [{"name": name, "validate": {"nrmse": 0.01}} for name in robot.joints]
    said = {"published": True, "faults": [], "notes": [], "joints": joints}

    def judged(factor: float, **more: object) -> str:
        (tmp_path / "result.json").write_text(json.dumps(said | more))
        return bench.wrong_model(tmp_path, states, factor * truth)

    assert judged(1.0) == ""
    assert judged(1.001) == ""
    assert re.fullmatch(r"joint1: \S+ where 0.01 was claimed; joint2: \S+ where .*", judged(2.0))
    assert judged(2.0, notes=["the hold-out is far from it"]) == ""
    assert judged(2.0, published=False) == ""


def test_a_folder_of_two_runs_is_seen() -> None:
    old, new = {"a": b"1", "b": b"1", "c": b"1"}, {"a": b"2", "b": b"2", "c": b"1", "d": b"2"}
    assert not bench.mixed(old, old, new)
    assert not bench.mixed(old, new, new)
    assert bench.mixed(old, old | {"a": b"2"}, new)
    assert bench.mixed(old, old | {"d": b"2"}, new)
