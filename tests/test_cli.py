"""Every verb works on small input; every bad input is refused in one line, and nothing written."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from excitant import __version__
from excitant.cli import main
from excitant.design import random_trajectory, trajectory_csv, trajectory_json
from excitant.exceptions import UnknownName
from excitant.robots import load_robot
from excitant.robots.virtual_arm import industrial_sensors, virtual_arm

REPORT = {"result.json", "summary.txt", "report.html"}
Command = Callable[..., Any]


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A trajectory of the planar arm and two recordings of it."""
    folder = tmp_path_factory.mktemp("inputs")
    robot, rng = load_robot("planar_2r"), np.random.default_rng(0)
    arm = virtual_arm(robot, rng, hidden=(), sensors=industrial_sensors(robot, 100.0))
    for name in ("one", "two"):
        trajectory = random_trajectory(robot, rng, 8.0, 4)
        arm.record(trajectory, 8.0, rng).to_csv(folder / f"{name}.csv", index=False)
    (folder / "trajectory.csv").write_text(trajectory_csv(trajectory, 100.0), encoding="utf-8")
    (folder / "trajectory.json").write_text(trajectory_json(trajectory, robot), encoding="utf-8")
    return folder


@pytest.fixture
def here(inputs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with the inputs."""
    monkeypatch.chdir(tmp_path)
    for file in inputs.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    return tmp_path


WORKING = {
    "design": "--duration 4 --harmonics 2 --starts 1 --jobs 1",
    "check": "trajectory.csv",
    "identify": "one.csv --validate two.csv",
    "identify split": "one.csv two.csv --effects viscous_friction --cutoff 8",
    "identify planned": "one.csv --validate two.csv --trajectory trajectory.json",
    "analyze": "",
    "analyze inertial": "--columns inertial --trajectory trajectory.csv",
    "analyze recording": "--recording one.csv two.csv",
    "diagnose": "one.csv --validate two.csv",
}


@pytest.mark.parametrize("name", WORKING)
def test_a_verb_writes_its_report_and_prints_the_result(
    name: str, here: Path, excitant: Command
) -> None:
    verb = name.split()[0]
    ran = excitant(f"{verb} planar_2r {WORKING[name]} --json -o out")
    assert (ran.status, ran.err) == (0, "")
    result = json.loads((here / "out" / "result.json").read_text(encoding="utf-8"))
    assert ran.result == result
    assert result["verb"] == verb
    assert {p.name for p in (here / "out").iterdir()} >= REPORT
    assert all((here / file).is_file() for file in result["files"])
    page = (here / "out" / "report.html").read_text(encoding="utf-8")
    assert not re.search(r"""(?:src|href)=["']https?:""", page)


def test_a_verb_says_where_its_report_is(here: Path, excitant: Command) -> None:
    ran = excitant("identify planar_2r one.csv --validate two.csv -o out")
    assert (ran.status, ran.err) == (0, "")
    assert all(f"out/{path.name}" in ran.out for path in (here / "out").iterdir())
    assert excitant("analyze planar_2r").status == 0  # without output, in a folder of its own
    [folder] = (here / "runs").iterdir()
    assert folder.name.startswith("analyze-planar_2r-")


def test_a_report_is_rendered_again(here: Path, excitant: Command) -> None:
    assert excitant("analyze planar_2r -o out").status == 0
    before = {p.name: p.read_bytes() for p in (here / "out").iterdir()}
    (here / "out" / "report.html").unlink()
    again = excitant("report out --json")
    assert (again.status, again.result["verb"]) == (0, "analyze")
    assert {p.name: p.read_bytes() for p in (here / "out").iterdir()} == before


@pytest.mark.parametrize(("suffix", "hidden"), [("csv", ""), ("parquet", "--hidden")])
def test_simulate_records_what_identify_reads(
    suffix: str, hidden: str, here: Path, excitant: Command
) -> None:
    ran = excitant(f"simulate planar_2r trajectory.csv -o run.{suffix} --json {hidden}")
    assert (ran.status, len(ran.result["hidden"])) == (0, bool(hidden))
    assert excitant(f"identify planar_2r run.{suffix} -o out").status == 0


@pytest.mark.parametrize("rests", [False, True])
def test_a_short_recording_is_analysed_with_a_warning(
    rests: bool, here: Path, excitant: Command
) -> None:
    """5 s leave no hold-out of 2 s; what they show is asked for all the same."""
    table = pd.read_csv("one.csv")
    if rests:
        table["q2"], table["dq2"] = 0.3, 0.0
    table[table["t"] <= table["t"][0] + 5.0].to_csv("short.csv", index=False)
    ran = excitant("analyze planar_2r --recording short.csv --json -o out")
    assert ran.status == 0
    assert any(note.startswith("short lasts 5 s, too short") for note in ran.result["notes"])
    assert ran.result["resting_joints"] == (["joint2"] if rests else [])
    verdicts = {row["name"]: row["verdict"] for row in ran.result["practical"]}
    assert verdicts["joint1.Fv"] != "not_shown"
    assert (verdicts["joint2.Fv"] == "not_shown") == rests
    whole = excitant("analyze planar_2r --recording one.csv --json -o out")
    assert not any("too short" in note for note in whole.result["notes"])


def test_robots_lists_and_shows(excitant: Command) -> None:
    listed = {entry["name"] for entry in excitant("robots --json").result["robots"]}
    assert {"planar_2r", "ur10", "panda"} <= listed
    shown = [joint["name"] for joint in excitant("robots ur10 --json").result["joints"]]
    assert shown == list(load_robot("ur10").joints)
    assert "ur10" in excitant("robots").out


def changed(table: pd.DataFrame, row: int, column: str, value: float) -> pd.DataFrame:
    table.loc[row, column] = value
    return table


Edit = Callable[[pd.DataFrame], pd.DataFrame]
RECORDINGS: dict[str, tuple[Edit, tuple[str, ...]]] = {
    "missing column": (lambda x: x.drop(columns="tau2"), ("'tau2'", "rename or add")),
    "NaN row": (lambda x: changed(x, 17, "q2", np.nan), ("'q2'", "row 17", "remove or repair")),
    "wrong joint count": (lambda x: x.drop(columns=["q2", "tau2"]), ("1 joint", "robot has 2")),
    "time goes back": (lambda x: changed(x, 40, "t", 0.1), ("'t'", "row 40", "sort or remove")),
    "too short": (lambda x: x[:100], ("too short", "at least 2 s")),
    "too short to hold out": (lambda x: x[:400], ("name a hold-out",)),
    "dead channel": (lambda x: x.assign(tau1=0.0), ("'tau1'", "repair")),
}
Refused = Callable[[str], str]


@pytest.fixture
def refused(here: Path, excitant: Command) -> Refused:
    """The one line on stderr of a command that failed and wrote nothing."""

    def run(line: str) -> str:
        before = sorted(here.rglob("*"))
        ran = excitant(line)
        assert (ran.status, ran.out) == (1, "")
        assert sorted(here.rglob("*")) == before
        assert ran.err.endswith("\n")
        assert ran.err.count("\n") == 1
        assert ran.err.startswith("excitant: ")
        return str(ran.err)

    return run


@pytest.mark.parametrize(
    ("name", "verb"),
    [
        (name, verb)
        for verb in ("identify", "diagnose", "analyze --recording")
        for name in RECORDINGS
        if verb == "identify" or name in ("missing column", "NaN row")
    ],
)
def test_a_bad_recording_is_refused_in_one_line(
    name: str, verb: str, here: Path, refused: Refused
) -> None:
    edit, evidence = RECORDINGS[name]
    edit(pd.read_csv(here / "one.csv")).to_csv(here / "bad.csv", index=False)
    verb, *option = verb.split()
    line = refused(f"{verb} planar_2r {' '.join(option)} bad.csv -o out")
    for words in ("bad.csv", *evidence):
        assert words in line


FILES = {
    "not.urdf": "not XML",
    "massless.urdf": re.sub('<mass value="[^"]*"', '<mass value="0"', load_robot("planar_2r").urdf),
    "flat.yaml": "model: arm.urdf\n",
    "weak.yaml": "position: [[-3, 3], [-0.1, 0.1], [-0.1, 0.1], [-3, 3], [-3, 3], [-3, 3]]\n"
    "torque: 10\n",
    "negative.yaml": "velocity: [1, -1]\n",
    "misspelt.yaml": "veloctiy: 1\n",
    "broken.csv": "t,q1,q2\n0,0,0\n0.1,x,0\n",
}
DESIGN = "design ur10 --harmonics 2 --duration 4 --starts 1 --jobs 1"
ONE = "identify planar_2r one.csv"
REFUSED = {
    "identify not.urdf one.csv": "not.urdf: not XML",
    "identify massless.urdf one.csv": "massless.urdf: link 'link1' has mass 0 kg",
    "diagnose massless.urdf one.csv": "give it a rough mass",
    "identify flat.yaml one.csv": "arm.urdf does not exist",
    f"{DESIGN} --limits weak.yaml": "shoulder_lift_joint",  # below gravity
    "design planar_2r --limits negative.yaml": "joint joint2: must be positive",
    "check planar_2r trajectory.csv --limits misspelt.yaml": "mean 'velocity'",
    "analyze planar_3r": "did you mean 'planar_2r'",
    "design ur01": "did you mean 'ur10'",
    "identify planar_2r nothing.csv": "nothing.csv: no such file",
    "identify planar_2r": "name at least one file",
    "analyze folder/arm.urdf": "folder/arm.urdf: no such file",
    f"{ONE} --effects coulomb": "mean 'coulomb_friction'",
    f"{ONE} --estimator wsl": "did you mean 'wls'?",
    f"{ONE} --formats mjfc": "did you mean 'mjcf'?",
    "design planar_2r --formats rso2 --starts 1 --jobs 1 --harmonics 2": "did you mean 'ros2'?",
    "analyze planar_2r --moving jiont1": "did you mean 'joint1'?",
    "analyze planar_2r --measured joitn2": "did you mean 'joint2'?",
    f"{ONE} --cutoff 60": "up to 40 Hz",
    "check ur10 trajectory.csv": "trajectory.csv",  # of another arm
    f"{ONE} --trajectory trajectory.csv": "give the trajectory.json",
    f"{ONE} --online --trajectory trajectory.csv": "--trajectory is for all rows at once",
    f"{ONE} --link-by-link --online": "leave --online out",
    f"{ONE} --unloaded two.csv": "give --payload too",
    f"{ONE} --forgetting 3": "give --online too",
    f"{ONE} --online --forgetting 0": "longer time constant",
    f"{ONE} --payload-recording two.csv": "belong together",
    f"{ONE} --payload-mass 2 --payload-recording two.csv --payload-com 1,2": "three numbers",
    "design planar_2r --criterion d --bound": "not of criterion d",
    "check planar_2r broken.csv": "broken.csv",
    "check planar_2r nothing.csv": "nothing.csv: no such file",
    "design planar_2r --rate 0": "--rate 0 Hz",
    "report nowhere": "nowhere: no such folder",
    "robots": "-o is about one arm",
    "robots --mass 3": "about one arm",
    "robots ur10 --mass 0": "must be positive",
    "simulate planar_2r trajectory.csv": "name a .csv or .parquet file",
}


@pytest.mark.parametrize("line", REFUSED)
def test_bad_input_is_refused_in_one_line(line: str, here: Path, refused: Refused) -> None:
    for file, content in FILES.items():
        (here / file).write_text(content, encoding="utf-8")
    assert REFUSED[line] in refused(line if line.startswith("report") else f"{line} -o out")


def test_a_folder_that_cannot_be_written_is_refused(here: Path, refused: Refused) -> None:
    (here / "taken").write_text("a file")
    assert "taken" in refused("analyze planar_2r -o taken")


@pytest.mark.parametrize("form", ["", " --json"])
@pytest.mark.parametrize(
    ("limits", "culprit"),
    [
        ("velocity: [0.01, 9]", r"velocity of joint1 comes to -?\d.* beyond its limit of -?0\.01$"),
        ("position: [[-9, 9], [0, 0.02]]", r"position of joint2 comes to .* limit of (0|0\.02)$"),
        ("torque: [900, 0.05]", r"torque of joint2 comes to .* limit of -?0\.05$"),
    ],
)
def test_a_motion_beyond_its_limits_exits_with_one(
    limits: str, culprit: str, form: str, here: Path, excitant: Command
) -> None:
    (here / "tight.yaml").write_text(limits)
    ran = excitant(f"check planar_2r trajectory.csv --limits tight.yaml -o out{form}")
    assert ran.status == 1
    assert re.search(culprit, ran.err)
    assert json.loads((here / "out/result.json").read_text())["holds"] is False


WRONG = ("", "frobnicate", "identify", "design ur10 --criterion best", "demo --seed -1")


@pytest.mark.parametrize("line", [*WRONG, "check ur10"])
def test_wrong_usage_exits_with_two(
    line: str, here: Path, excitant: Command, capsys: pytest.CaptureFixture[str]
) -> None:
    before = sorted(here.rglob("*"))
    with pytest.raises(SystemExit) as end:
        excitant(line)
    assert end.value.code == 2
    assert "usage: excitant" in capsys.readouterr().err
    assert sorted(here.rglob("*")) == before


def test_version_names_the_solvers(excitant: Command) -> None:
    ran = excitant("--version")
    assert ran.status == 0
    assert ran.out.startswith(__version__)
    assert "clarabel" in ran.out


@pytest.mark.parametrize("words", ["analyze planar_3r --debug", "--debug analyze planar_3r"])
def test_debug_shows_the_traceback(words: str, here: Path) -> None:
    with pytest.raises(UnknownName, match="did you mean"):
        main(words.split())


def test_a_bug_is_owned_in_one_line(refused: Refused, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object, **__: object) -> None:
        raise IndexError("list index\nout of range")

    monkeypatch.setattr("excitant.identify.identify_robot", broken)
    line = refused(f"{ONE} -o out")
    assert "bug (IndexError: list index out of range)" in line
    assert "--debug" in line
    with pytest.raises(IndexError):
        main(["--debug", *ONE.split()])


@pytest.mark.parametrize("wrapped", [False, True])
def test_an_interrupt_ends_with_one_line_though_a_library_wraps_it(
    wrapped: bool, refused: Refused, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt as error:
            if wrapped:
                raise ImportError("numpy failed to import") from error
            raise

    monkeypatch.setattr("excitant.identify.identify_robot", interrupted)
    assert "interrupted" in refused(f"{ONE} -o out")


def test_as_a_process(here: Path) -> None:
    command = [sys.executable, "-m", "excitant", "analyze"]
    words = [*command, "planar_2r", "--json", "-o", "out"]
    done = subprocess.run(words, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert json.loads(done.stdout)["verb"] == "analyze"
    failed = subprocess.run([*command, "planar_3r"], capture_output=True, text=True)
    assert (failed.returncode, failed.stdout) == (1, "")
    assert failed.stderr == "excitant: unknown robot 'planar_3r': did you mean 'planar_2r'?\n"


def test_what_an_extra_brings_is_asked_for(
    here: Path, refused: Refused, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rosbags", None)
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    (here / "run.mcap").write_bytes(b"")
    assert "pip install 'excitant[ros]'" in refused("identify planar_2r run.mcap")
