"""Many arms by one command: it goes on where it was, and no arm spoils the others."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from excitant import fleets
from excitant.design import random_trajectory
from excitant.exceptions import BadInput
from excitant.identify import faults
from excitant.identify.dataset import origin
from excitant.processes import connect, unordered
from excitant.robots import load_robot
from excitant.robots.virtual_arm import virtual_arm

ROBOT = load_robot("planar_2r")


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two sound data sets, each a recording and a description, and two that are not."""
    root = tmp_path_factory.mktemp("fleet")
    for k in range(2):
        folder, rng = root / f"arm{k}" / "2026-03-01", np.random.default_rng([k, 0])
        folder.mkdir(parents=True)
        arm = virtual_arm(ROBOT, np.random.default_rng(k), hidden=())
        table = arm.record(random_trajectory(ROBOT, rng, 8.0, 4), 8.0, rng)
        table.to_parquet(folder / "run0.parquet", index=False)
        (folder / "robot.urdf").write_text(ROBOT.urdf)
    shutil.copytree(root / "arm0", root / "broken")
    (root / "broken" / "2026-03-01" / "robot.urdf").write_text("<robot>")
    (root / "arm1").rename(root / os.fsdecode(b"arm\xe9"))  # which is not UTF-8
    (root / "lost").mkdir()
    shutil.copy(root / "arm0" / "2026-03-01" / "run0.parquet", root / "lost")
    return root


def made(folder: Path) -> dict[str, float]:
    """When each file below a folder of results was written."""
    files = (path for path in (folder / "arms").rglob("*") if path.is_file())
    return {str(path.relative_to(folder / "arms")): path.stat().st_mtime for path in files}


@pytest.mark.slow
def test_it_goes_on_where_it_was_and_names_what_is_broken(two, here, excitant, monkeypatch):
    shutil.copytree(two, here / "all")
    for name, target in (("twin", "arm0"), ("up", "..")):
        (here / "all" / name).symlink_to(target)
    asked, find = list[Any](), faults.find_faults
    monkeypatch.setattr(faults, "find_faults", lambda *log: asked.append(log) or find(*log))
    ran = excitant("fleet all --jobs 1 -o out --json")
    assert (ran.status, len(asked)) == (0, 3), ran.err  # once each
    _, sound, broken, lost = sets = ran.result["data_sets"]
    dated = [rf"{arm}/2026-03-01" for arm in ("arm0", r"arm\udce9", "broken")]
    assert [each["name"] for each in sets] == [*dated, "lost"]
    assert (sound["arm"], sound["date"], sound["failed"]) == (r"arm\udce9", "2026-03-01", None)
    copied = "counted once: twin/2026-03-01 has the files of arm0/2026-03-01"
    assert copied in ran.result["notes"]
    assert "robot.urdf" in broken["failed"]
    assert "no robot model" in lost["failed"]
    assert ran.result["arms"] == 2
    table = pd.read_parquet("out/parameters.parquet")
    assert set(table.arm) == {"arm0", r"arm\udce9"}
    assert {"joint1", "joint2", "link1", "link2"} <= set(table.joint)
    assert (table.low < table.value).all()
    assert set(table[table.parameter == "joint2.Fc"].unit) == {"N·m"}
    before = made(here / "out")
    assert excitant("fleet all --jobs 1 -o out").status == 0
    assert made(here / "out") == before
    [other] = two.glob("arm[!0]/2026-03-01/run0.parquet")
    shutil.copy(other, here / "all/arm0/2026-03-01/run0.parquet")
    (here / "all/broken/2026-03-01/robot.urdf").write_text(ROBOT.urdf)
    ran = excitant("fleet all --jobs 1 -o out --json")
    again = {name.split("/")[0] for name, t in made(here / "out").items() if before.get(name) != t}
    assert again == {"arm0", "broken", "twin"}
    assert [each["failed"] is None for each in ran.result["data_sets"]] == [True, True, False]
    assert f"{sound['name']} has the files of arm0/2026-03-01" in ran.result["notes"][0]


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("fleet", "no folder given"),
        ("fleet nowhere", "nowhere: no such folder"),
        ("fleet empty", "empty: no data set in it"),
        ("fleet a/x b/x a/x", "a/x: given twice"),
    ],
)
def test_what_is_no_fleet_is_refused(line: str, said: str, here: Path, excitant: Any) -> None:
    for name in ("empty", "a/x", "b/x"):
        (here / name).mkdir(parents=True)
    for name in "ab":
        (here / name / "x" / "robot.urdf").touch()
    ran = excitant(line)
    assert ran.status == 1
    assert said in ran.err
    assert not (here / "runs").exists()


def test_a_fleet_without_any_model_is_a_failure(here: Path, excitant: Any) -> None:
    (here / "x").mkdir()
    (here / "x" / "robot.urdf").write_text("<robot>")
    assert excitant("fleet x -o out").status == 1
    assert json.loads((here / "out/result.json").read_text())["data_sets"][0]["failed"]


@pytest.mark.parametrize(
    ("name", "arm", "day"),
    [
        ("cell3/2026-03-01", "cell3", date(2026, 3, 1)),
        ("cell3-20260301", "cell3", date(2026, 3, 1)),
        ("2026-03-01_ur10_sn17", "ur10_sn17", date(2026, 3, 1)),
        ("2026-13-01", "2026-13-01", None),
        ("2026-03-01", "2026-03-01", date(2026, 3, 1)),
        ("sn20260301123", "sn20260301123", None),
        ("ur10", "ur10", None),
    ],
)
def test_arm_and_date_by_name(name: str, arm: str, day: date | None, tmp_path: Path) -> None:
    assert origin(tmp_path, name) == (arm, day)


def test_arm_and_date_by_file(tmp_path: Path) -> None:
    sidecar = tmp_path / "dataset.json"
    sidecar.write_text('{"arm": "sn 17", "date": "2026-02-03"}')
    assert origin(tmp_path, "cell3/2026-03-01") == ("sn 17", date(2026, 2, 3))
    sidecar.write_text('{"date": "yesterday"}')
    with pytest.raises(BadInput, match=r"dataset\.json.*date"):
        origin(tmp_path, "cell3")


def test_a_data_set_that_ends_its_process_is_left_and_the_rest_is_done(tmp_path, monkeypatch):
    sets, here = [], os.getpid()
    for name in ("a", "bad", "b"):
        (tmp_path / name).mkdir()
        sets.append(fleets._DataSet(name, str(tmp_path / name), str(tmp_path / "out" / name)))

    def examine(name: str, folder: str, out: str) -> str:
        assert os.getpid() != here
        if name == "bad":
            os.kill(os.getpid(), signal.SIGKILL)
        with (tmp_path / f"{name}.done").open("a") as file:
            file.write("x")
        return name

    monkeypatch.setattr(fleets, "_examine", examine)
    fleets._examine_all(sets, 2, None, lambda share, words: None)
    assert {path.stem for path in tmp_path.glob("*.done")} == {"a", "b"}
    assert "ended twice" in fleets._noted(str(tmp_path / "out" / "bad"))["failed"]


@pytest.mark.slow
def test_ctrl_c_keeps_what_is_done(two: Path, here: Path, excitant: Any) -> None:
    shutil.copytree(two, here / "all")
    process = subprocess.Popen(
        [sys.executable, "-m", "excitant", "fleet", "all", "--jobs", "1", "-o", "out"],
        stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True, start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip
    end = time.monotonic() + 120
    while not list(here.glob("out/arms/*/*/input.json")) and time.monotonic() < end:
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    # the first may have been written, but not yet be counted
    assert re.search(r"\b[01] of 4 data sets are done and kept; the same command goes on", err)
    before = made(here / "out")
    assert excitant("fleet all --jobs 1 -o out").status == 0
    assert {name: made(here / "out")[name] for name in before} == before


@pytest.mark.slow
def test_a_cluster_comes_to_the_same(two: Path, here: Path, excitant: Any) -> None:
    from distributed import LocalCluster

    shutil.copytree(two, here / "all")
    alone = excitant("fleet all --jobs 1 -o alone --json").result
    with LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster:
        with connect(cluster.scheduler_address) as client:
            assert [os.getpid()] != list(unordered(os.getpid, [()], 1, client))
        ran = excitant(f"fleet all --cluster {cluster.scheduler_address} -o there --json")
    assert ran.status == 0, ran.err
    assert ran.result["data_sets"] == alone["data_sets"]
    one, other = (pd.read_parquet(f"{x}/parameters.parquet") for x in ("alone", "there"))
    pd.testing.assert_frame_equal(one, other)


def test_every_data_set_has_a_folder_of_its_own() -> None:
    names = ["a/b", "a/b c", "a/b_c", "x" * 80, "x" * 81, "../a", "a"]
    assert fleets._safe("cell3/2026-03-01") == "cell3/2026-03-01"
    assert len({fleets._safe(name) for name in names}) == len(names)
    assert not any(".." in fleets._safe(name) for name in names)
