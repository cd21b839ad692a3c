"""Every verb works on small input; every bad input is refused in one line, and nothing written."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

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
    """An empty working folder beside the inputs, which it can name by ``../``."""
    monkeypatch.chdir(tmp_path)
    for file in inputs.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    return tmp_path


WORKING = {
    "design": "design planar_2r --duration 4 --harmonics 2 --starts 1 --jobs 1",
    "check": "check planar_2r trajectory.csv",
    "identify": "identify planar_2r one.csv --validate two.csv",
    "identify split": "identify planar_2r one.csv two.csv --effects viscous_friction --cutoff 8",
    "identify planned": "identify planar_2r one.csv --validate two.csv "
    "--trajectory trajectory.json",
    "analyze": "analyze planar_2r",
    "analyze inertial": "analyze planar_2r --columns inertial --trajectory trajectory.csv",
    "analyze recording": "analyze planar_2r --recording one.csv two.csv",
    "diagnose": "diagnose planar_2r one.csv --validate two.csv",
}


@pytest.mark.parametrize("name", WORKING)
def test_a_verb_writes_its_report_and_prints_the_result(
    name: str, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*WORKING[name].split(), "--json", "-o", "out"]) == 0
    out, err = capsys.readouterr()
    result = json.loads((here / "out" / "result.json").read_text(encoding="utf-8"))
    assert (json.loads(out), err) == (result, "")
    assert result["verb"] == name.split()[0]
    assert {p.name for p in (here / "out").iterdir()} >= REPORT
    assert all((here / file).is_file() for file in result["files"])
    page = (here / "out" / "report.html").read_text(encoding="utf-8")
    assert not re.search(r"""(?:src|href)=["']https?:""", page)


def test_a_verb_says_where_its_report_is(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*WORKING["identify"].split(), "-o", "out"]) == 0
    out, err = capsys.readouterr()
    assert all(f"out/{path.name}" in out for path in (here / "out").iterdir())
    assert err == ""


def test_without_output_a_run_has_a_folder_of_its_own(here: Path) -> None:
    assert main(["analyze", "planar_2r"]) == 0
    [folder] = (here / "runs").iterdir()
    assert folder.name.startswith("analyze-planar_2r-")


def test_a_report_is_rendered_again(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["analyze", "planar_2r", "-o", "out"]) == 0
    before = {p.name: p.read_bytes() for p in (here / "out").iterdir()}
    (here / "out" / "report.html").unlink()
    capsys.readouterr()
    assert main(["report", "out", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["verb"] == "analyze"
    assert {p.name: p.read_bytes() for p in (here / "out").iterdir()} == before


@pytest.mark.parametrize(("suffix", "hidden"), [("csv", False), ("parquet", True)])
def test_simulate_records_what_identify_reads(
    suffix: str, hidden: bool, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["simulate", "planar_2r", "trajectory.csv", "-o", f"run.{suffix}", "--json"]
    assert main([*words, *(["--hidden"] if hidden else [])]) == 0
    result = json.loads(capsys.readouterr().out)
    assert len(result["hidden"]) == int(hidden)
    assert main(["identify", "planar_2r", f"run.{suffix}", "-o", "out"]) == 0


@pytest.mark.parametrize("rests", [False, True])
def test_a_short_recording_is_analysed_with_a_warning(
    rests: bool, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """5 s leave no hold-out of 2 s; what they show is asked for all the same."""
    table = pd.read_csv("one.csv")
    if rests:
        table["q2"], table["dq2"] = 0.3, 0.0
    table[table["t"] <= table["t"][0] + 5.0].to_csv("short.csv", index=False)
    assert main(["analyze", "planar_2r", "--recording", "short.csv", "--json", "-o", "out"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert any(note.startswith("short lasts 5 s, too short") for note in result["notes"])
    assert result["resting_joints"] == (["joint2"] if rests else [])
    verdicts = {row["name"]: row["verdict"] for row in result["practical"]}
    assert verdicts["joint1.Fv"] != "not_shown"
    assert (verdicts["joint2.Fv"] == "not_shown") == rests
    assert main(["analyze", "planar_2r", "--recording", "one.csv", "--json", "-o", "out"]) == 0
    assert not any("too short" in n for n in json.loads(capsys.readouterr().out)["notes"])


def test_robots_lists_and_shows(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["robots", "--json"]) == 0
    listed = [entry["name"] for entry in json.loads(capsys.readouterr().out)["robots"]]
    assert {"planar_2r", "ur10", "panda"} <= set(listed)
    assert main(["robots", "ur10", "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert [j["name"] for j in shown["joints"]] == list(load_robot("ur10").joints)
    assert main(["robots"]) == 0
    assert "ur10" in capsys.readouterr().out


Edit = Callable[[pd.DataFrame], pd.DataFrame]


def with_nan(table: pd.DataFrame) -> pd.DataFrame:
    table.loc[17, "q2"] = np.nan
    return table


def back_in_time(table: pd.DataFrame) -> pd.DataFrame:
    table.loc[40, "t"] = 0.1
    return table


RECORDINGS: dict[str, tuple[Edit, tuple[str, ...]]] = {
    "missing column": (lambda x: x.drop(columns="tau2"), ("'tau2'", "rename or add")),
    "NaN row": (with_nan, ("'q2'", "row 17", "remove or repair")),
    "wrong joint count": (lambda x: x.drop(columns=["q2", "tau2"]), ("1 joint", "robot has 2")),
    "time goes back": (back_in_time, ("'t'", "row 40", "sort or remove")),
    "too short": (lambda x: x[:100], ("too short", "at least 2 s")),
    "too short to hold out": (lambda x: x[:400], ("name a hold-out",)),
    "dead channel": (lambda x: x.assign(tau1=0.0), ("'tau1'", "repair")),
}


def refused(words: list[str], here: Path, capsys: pytest.CaptureFixture[str]) -> str:
    """The one line on stderr of a command that failed and wrote nothing."""
    before = sorted(here.rglob("*"))
    assert main(words) == 1
    assert sorted(here.rglob("*")) == before
    out, err = capsys.readouterr()
    assert out == ""
    assert err.endswith("\n")
    assert err.count("\n") == 1
    assert err.startswith("excitant: ")
    return err


@pytest.mark.parametrize(
    ("name", "verb"),
    [
        (name, verb)
        for verb in ("identify", "diagnose", "analyze")
        for name in RECORDINGS
        if verb == "identify" or name in ("missing column", "NaN row")
    ],
)
def test_a_bad_recording_is_refused_in_one_line(
    name: str, verb: str, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    edit, evidence = RECORDINGS[name]
    edit(pd.read_csv(here / "one.csv")).to_csv(here / "bad.csv", index=False)
    option = ["--recording"] if verb == "analyze" else []
    line = refused([verb, "planar_2r", *option, "bad.csv", "-o", "out"], here, capsys)
    assert "bad.csv" in line
    for words in evidence:
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
REFUSED = {
    "URDF that is not XML": ("identify not.urdf one.csv", "not.urdf: not XML"),
    "no prior": ("identify massless.urdf one.csv", "massless.urdf: link 'link1' has mass 0 kg"),
    "no prior to diagnose": ("diagnose massless.urdf one.csv", "give it a rough mass"),
    "no such model": ("identify flat.yaml one.csv", "arm.urdf does not exist"),
    "limits below gravity": (f"{DESIGN} --limits weak.yaml", "shoulder_lift_joint"),
    "negative limit": ("design planar_2r --limits negative.yaml", "joint joint2: must be positive"),
    "misspelt limit": ("check planar_2r trajectory.csv --limits misspelt.yaml", "mean 'velocity'"),
    "unknown robot": ("analyze planar_3r", "did you mean 'planar_2r'"),
    "unknown robot to design": ("design ur01", "did you mean 'ur10'"),
    "no such file": ("identify planar_2r nothing.csv", "nothing.csv: no such file"),
    "no recording": ("identify planar_2r", "name at least one file"),
    "no such robot file": ("analyze folder/arm.urdf", "folder/arm.urdf: no such file"),
    "unknown effect": ("identify planar_2r one.csv --effects coulomb", "mean 'coulomb_friction'"),
    "cut-off": ("identify planar_2r one.csv --cutoff 60", "up to 40 Hz"),
    "trajectory of another arm": ("check ur10 trajectory.csv", "trajectory.csv"),
    "samples planned": (
        "identify planar_2r one.csv --trajectory trajectory.csv",
        "give the trajectory.json",
    ),
    "planned on-line": (
        "identify planar_2r one.csv --online --trajectory trajectory.csv",
        "--trajectory is for all rows at once",
    ),
    "bound of another criterion": ("design planar_2r --criterion d --bound", "not of criterion d"),
    "bad trajectory": ("check planar_2r broken.csv", "broken.csv"),
    "no trajectory": ("check planar_2r nothing.csv", "nothing.csv: no such file"),
    "rate": ("design planar_2r --rate 0", "--rate 0 Hz"),
    "no run": ("report nowhere", "nowhere: no such folder"),
    "format": ("simulate planar_2r trajectory.csv", "name a .csv or .parquet file"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_bad_input_is_refused_in_one_line(
    name: str, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for file, content in FILES.items():
        (here / file).write_text(content, encoding="utf-8")
    words, evidence = REFUSED[name]
    output = [] if words.startswith("report") else ["-o", "out"]
    line = refused([*words.split(), *output], here, capsys)
    assert evidence in line


def test_a_folder_that_cannot_be_written_is_refused(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (here / "taken").write_text("a file")
    assert "taken" in refused(["analyze", "planar_2r", "-o", "taken"], here, capsys)


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
    limits: str, culprit: str, form: str, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (here / "tight.yaml").write_text(limits)
    words = f"check planar_2r trajectory.csv --limits tight.yaml -o out{form}".split()
    assert main(words) == 1
    assert re.search(culprit, capsys.readouterr().err)
    assert json.loads((here / "out/result.json").read_text())["holds"] is False


WRONG = (
    "",
    "frobnicate",
    "identify",
    "design ur10 --criterion best",
    "demo --seed -1",
    "check ur10",
)


@pytest.mark.parametrize("words", WRONG)
def test_wrong_usage_exits_with_two(
    words: str, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = sorted(here.rglob("*"))
    with pytest.raises(SystemExit) as end:
        main(words.split())
    assert end.value.code == 2
    assert "usage: excitant" in capsys.readouterr().err
    assert sorted(here.rglob("*")) == before


def test_version_names_the_solvers(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    out = capsys.readouterr().out
    assert out.startswith(__version__)
    assert "clarabel" in out


@pytest.mark.parametrize("words", ["analyze planar_3r --debug", "--debug analyze planar_3r"])
def test_debug_shows_the_traceback(words: str, here: Path) -> None:
    with pytest.raises(UnknownName, match="did you mean"):
        main(words.split())


def test_a_bug_is_owned_in_one_line(
    here: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise IndexError("list index\nout of range")

    monkeypatch.setattr("excitant.identify.identify_robot", broken)
    words = ["identify", "planar_2r", "one.csv", "-o", "out"]
    line = refused(words, here, capsys)
    assert "bug (IndexError: list index out of range)" in line
    assert "--debug" in line
    with pytest.raises(IndexError):
        main(["--debug", *words])


@pytest.mark.parametrize("wrapped", [False, True])
def test_an_interrupt_ends_with_one_line_though_a_library_wraps_it(
    wrapped: bool, here: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt as error:
            if wrapped:
                raise ImportError("numpy failed to import") from error
            raise

    monkeypatch.setattr("excitant.identify.identify_robot", interrupted)
    assert "interrupted" in refused(["identify", "planar_2r", "one.csv", "-o", "out"], here, capsys)


def test_as_a_process(here: Path) -> None:
    command = [sys.executable, "-m", "excitant"]
    done = subprocess.run(
        [*command, "analyze", "planar_2r", "--json", "-o", "out"], capture_output=True, text=True
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert json.loads(done.stdout)["verb"] == "analyze"
    failed = subprocess.run([*command, "analyze", "planar_3r"], capture_output=True, text=True)
    assert (failed.returncode, failed.stdout) == (1, "")
    assert failed.stderr == "excitant: unknown robot 'planar_3r': did you mean 'planar_2r'?\n"


def test_what_an_extra_brings_is_asked_for(
    here: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rosbags", None)
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    (here / "run.mcap").write_bytes(b"")
    line = refused(["identify", "planar_2r", "run.mcap"], here, capsys)
    assert "pip install 'excitant[ros]'" in line
