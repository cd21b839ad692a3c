"""Every verb works on small input; every bad input is refused in one line, and nothing written."""

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pandas as pd
import pytest
from marks import slow

from excitant import __version__
from excitant.cli import main
from excitant.design import check, random_trajectory, trajectory_csv, trajectory_json
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
def here(inputs: Path, here: Path) -> Path:
    return shutil.copytree(inputs, here, dirs_exist_ok=True)


WORKING = {
    "design": "--duration 4 --harmonics 2 --starts 1 --jobs 1",
    "check": "trajectory.csv",
    "identify": "one.csv --validate two.csv",
    "identify split": "one.csv two.csv --effects viscous_friction --cutoff 8 --force",
    "identify planned": "one.csv --validate two.csv --trajectory trajectory.json",
    "analyze": "",
    "analyze inertial": "--columns inertial --trajectory trajectory.csv",
    "analyze recording": "--recording one.csv two.csv",
    "diagnose": "one.csv --validate two.csv",
}


FURTHER = {"identify split", "identify planned", "analyze inertial"}  # options of other tests too


@pytest.mark.parametrize("name", [slow(x) if x in FURTHER else x for x in WORKING])
def test_a_verb_writes_and_prints_its_result(name: str, here: Path, excitant: Any) -> None:
    verb = name.split()[0]
    ran = excitant(f"{verb} planar_2r {WORKING[name]} --json -o out")
    assert (ran.status, ran.err) == (0, "")
    result = json.loads((here / "out" / "result.json").read_text(encoding="utf-8"))
    assert ran.result == result | {"verb": verb}
    assert {p.name for p in (here / "out").iterdir()} >= REPORT
    assert all((here / file).is_file() for file in result["files"])
    page = (here / "out" / "report.html").read_text(encoding="utf-8")
    assert not re.search(r"""(?:src|href)=["']https?:""", page)


def test_show_writes_one_page_and_does_not_judge(here: Path, excitant: Any) -> None:
    before = {path.name for path in here.iterdir()}
    (here / "slow.yaml").write_text("velocity: 0.01\n", encoding="utf-8")
    ran = excitant("show planar_2r trajectory.csv --limits slow.yaml --json -o page.html")
    assert (ran.status, ran.err) == (0, "")
    assert {path.name for path in here.iterdir()} - before == {"slow.yaml", "page.html"}
    assert ran.result == ran.result | {"verb": "show", "holds": False, "files": ["page.html"]}
    said = excitant("show planar_2r trajectory.csv --limits slow.yaml").out.splitlines()
    assert said[0].startswith("checked      velocity limit of joint")
    assert any("% of its velocity limit" in line for line in said[1:])
    assert re.fullmatch(r"runs/show-planar_2r-[\d-]+\.html", said[-1])
    page = Path(said[-1]).read_text(encoding="utf-8")
    assert "Written by excitant.</p>" in page  # nothing stands beside it


@pytest.mark.slow
def test_a_first_run_is_slower_and_checked_by_itself(here: Path, excitant: Any) -> None:
    options = "--duration 4 --harmonics 2 --starts 1 --jobs 1 --use 0.5 --speed 0.2 --floor -2"
    ran = excitant(f"design planar_2r {options} --json -o out")
    found = ran.result
    assert (ran.status, found["limit_use"], found["first_run"]["duration"]) == (0, 0.5, 20.0)
    assert max(found["limits"][q] for q in ("velocity", "acceleration", "torque")) <= 0.5
    full, slow = (pd.read_csv(f"out/{name}.csv") for name in ("trajectory", "first_run"))
    assert slow["t"].iloc[-1] == pytest.approx(20.0)
    np.testing.assert_allclose(slow["q1"][::5], full["q1"], atol=1e-9)
    np.testing.assert_allclose(slow["dq2"][::5], 0.2 * full["dq2"], atol=1e-9)
    assert found["unchecked"] == ""  # arms in a plane, whose two links cannot meet
    assert [o["name"] for o in found["obstacles"]] == ["floor"]
    left = excitant(f"design planar_2r {WORKING['design']} --no-floor -o bare").out
    assert "; not checked: self-collision; floor" in left.splitlines()[0]
    assert "; not checked: self-collision; floor" in (here / "bare" / "report.html").read_text()
    checked = excitant("check planar_2r trajectory.csv -o checked").out.splitlines()[0]
    assert checked.endswith("between samples too; not checked: self-collision; floor")


def test_a_first_run_beyond_a_limit_is_not_written_and_the_design_kept(here, excitant, monkeypatch):
    """What holds the arm is no less at a lower speed; here, its limits are a hundredth."""
    monkeypatch.setattr(
        "excitant.design.played.check",
        lambda arm, path: check(arm.with_limits(arm.limits.used(0.01)), path),
    )
    ran = excitant(f"design planar_2r {WORKING['design']} --formats ros2_client,npz --json -o out")
    [note] = [n for n in ran.result["notes"] if "first_run.csv" in n]
    assert note.endswith("so it is not written nor are programs (ros2_client)")
    assert ran.status == 1
    assert (here / "out" / "trajectory.npz").is_file()
    assert not {"first_run.csv", "ros2_client.py"} & {p.name for p in (here / "out").iterdir()}


def test_a_program_comes_with_its_first_run_and_moves_there_and_back(here: Path, excitant: Any):
    options = f"{WORKING['design']} --formats ros2_client,npz --from 0.1,-0.2"
    ran = excitant(f"design planar_2r {options} --json -o out")
    assert (ran.status, ran.result["first_run"]["speed"]) == (0, 0.2)
    names = {Path(file).name for file in ran.result["files"]}
    motions = ("approach", "trajectory", "return")
    tables = {f"{stem}.{x}" for stem in (*motions, "first_run") for x in ("csv", "npz")}
    assert names == {*tables, "ros2_client.py", "trajectory.json"}
    words = [sys.executable, here / "out" / "ros2_client.py"]
    said = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    assert [line.partition(":")[0] for line in said.splitlines()[:3]] == [*motions]


def test_what_faults_prove_wrong_is_not_published(here: Path, excitant: Any) -> None:
    """Not even where the hold-out has the same fault; repaired, it is, and that is said."""
    for name in ("one", "two"):
        table = pd.read_csv(f"{name}.csv")
        table[["q2", "dq2"]] = np.degrees(table[["q2", "dq2"]])
        table.to_csv(f"{name}-deg.csv", index=False)
    ran = excitant("identify planar_2r one-deg.csv --validate two-deg.csv -o out")
    [line] = [line for line in ran.out.splitlines() if "not published" in line]
    assert ran.status == 1
    assert re.search("one-deg: q is in degrees.*--repair", line)
    ran = excitant("identify planar_2r one-deg.csv --validate two.csv --repair --force -o repaired")
    assert (ran.status, "(repaired)" in ran.out) == (0, True)
    table.assign(t=np.arange(len(table))).to_csv("counted.csv", index=False)
    refused = excitant("identify planar_2r counted.csv --cutoff 8 -o counted").err
    assert re.search("; what may explain it, counted: .*; --repair ", refused)


def test_a_dead_torque_is_not_fitted_in_silence(here: Path, excitant: Any) -> None:
    """It falsifies what all joints share, though a hold-out as dead agrees with it."""
    rng = np.random.default_rng(0)
    for name in ("one", "two"):
        table = pd.read_csv(f"{name}.csv")
        table["tau2"] = 0.02 * rng.standard_normal(len(table))
        table.to_csv(f"{name}.csv", index=False)
    ran = excitant("identify planar_2r one.csv --validate two.csv --json -o out")
    assert (ran.status, ran.result["published"], ran.result["files"]) == (1, False, [])
    assert "not published: one: tau of joint2 is only noise" in ran.result["refusal"]
    assert ran.result["notes"][-1] == ran.result["refusal"]


@pytest.mark.slow
def test_an_extended_model_of_no_use_is_not_published(here: Path, excitant: Any) -> None:
    """Of torques that belong to another motion."""
    one, two = (pd.read_csv(f"{name}.csv") for name in ("one", "two"))
    one[["tau1", "tau2"]] = two[["tau1", "tau2"]]
    one.to_csv("mixed.csv", index=False)
    words = "diagnose planar_2r mixed.csv --no-experiments -o out"
    ran = excitant(words)
    assert (ran.status, ran.err) == (1, "")
    assert "the extended model is not published: it predicts the hold-out worse" in ran.out
    result = json.loads((here / "out" / "result.json").read_text(encoding="utf-8"))
    assert (result["published"], result["extended"]["files"]) == (False, [])
    assert not [*(here / "out").glob("extended.*")]
    assert excitant(f"{words} --force").status == 0
    assert {path.suffix for path in (here / "out").glob("extended.*")} >= {".urdf", ".yaml"}


def test_a_verb_says_where_its_report_is(here: Path, excitant: Any) -> None:
    ran = excitant("identify planar_2r one.csv --validate two.csv -o out")
    assert (ran.status, ran.err) == (0, "")
    assert all(f"out/{path.name}" in ran.out for path in (here / "out").iterdir())
    assert excitant("analyze planar_2r").status == 0  # without output, in a folder of its own
    [folder] = (here / "runs").iterdir()
    assert folder.name.startswith("analyze-planar_2r-")


def test_a_report_is_rendered_again(here: Path, excitant: Any) -> None:
    assert excitant("analyze planar_2r -o out").status == 0
    before = {p.name: p.read_bytes() for p in (here / "out").iterdir()}
    (here / "out" / "report.html").unlink()
    again = excitant("report out --json")
    assert (again.status, again.result["verb"]) == (0, "analyze")
    assert {p.name: p.read_bytes() for p in (here / "out").iterdir()} == before


@pytest.mark.parametrize("run", ["run.csv", "run.parquet --hidden"])
def test_simulate_records_what_identify_reads(here: Path, excitant: Any, run: str) -> None:
    ran = excitant(f"simulate planar_2r trajectory.csv --json -o {run}")
    assert (ran.status, len(ran.result["hidden"])) == (0, "hidden" in run)
    ran = excitant(f"identify planar_2r {run.split()[0]} --json -o out")
    assert ran.status == (not ran.result["published"])


@pytest.mark.parametrize("rests", [False, True])
def test_a_short_recording_is_analysed_with_a_note(rests: bool, here: Path, excitant: Any) -> None:
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


@pytest.fixture
def refused(here: Path, excitant: Any) -> Callable[..., str]:
    """The one line on stderr of a command that failed and wrote nothing."""

    def run(line: str, status: int = 1) -> str:
        before = sorted(here.rglob("*"))
        ran = excitant(line)
        assert (ran.status, ran.out) == (status, "")
        assert sorted(here.rglob("*")) == before
        assert re.fullmatch(r"excitant: .*\n", ran.err)
        return str(ran.err)

    return run


FILES = {
    "not.urdf": "not XML",
    "minus.urdf": re.sub('<mass value="[^"]*"', '<mass value="-1"', load_robot("planar_2r").urdf),
    "misspelt.yaml": "veloctiy: 1\n",
    "twice.json": '{"velocity": 1, "velocity": 2}',
    "far.csv": "t,q1,q2,tau1,tau2\n" + "".join(f"{k / 9},1e17,{k},1,{k}\n" for k in range(81)),
    "taken": "a file",
    "broken.csv": "t,q1,q2,tau1\n0,0,0,0\n0.1,x,0,0\n",
}
ONE = "identify planar_2r one.csv"
REFUSED = {
    "identify not.urdf one.csv": "not.urdf: not XML",
    "identify minus.urdf one.csv": "minus.urdf: link 'link1' has mass -1 kg",
    "check planar_2r trajectory.csv --limits misspelt.yaml": "mean 'velocity'",
    "check planar_2r trajectory.csv --limits twice.json": "twice.json: not valid JSON ('velocity'",
    "analyze planar_3r": "did you mean 'planar_2r'",
    "design ur01": "did you mean 'ur10'",
    "identify planar_2r nothing.csv": "nothing.csv: no such file",
    "identify planar_2r broken.csv": "broken.csv, column 'tau2'",
    "diagnose planar_2r broken.csv": "broken.csv, column 'tau2'",
    "analyze planar_2r --recording broken.csv": "broken.csv, column 'tau2'",
    "identify planar_2r": "name at least one file",
    "analyze folder/arm.urdf": "folder/arm.urdf: no such file",
    f"{ONE} --effects coulomb": "mean 'coulomb_friction'",
    f"{ONE} --estimator wsl": "did you mean 'wls'?",
    f"{ONE} --formats mjfc": "did you mean 'mjcf'?",
    "design planar_2r --formats rso2 --starts 1 --jobs 1 --harmonics 2": "did you mean 'ros2'?",
    "design planar_2r --formats urscript": "six turning joints, planar_2r has 2",
    "analyze planar_2r --moving jiont1": "did you mean 'joint1'?",
    "analyze planar_2r --measured joitn2": "did you mean 'joint2'?",
    f"{ONE} --cutoff 60": "up to 40 Hz",
    "check ur10 trajectory.csv": "trajectory.csv",  # of another arm
    f"{ONE} --trajectory trajectory.csv": "give the trajectory.json",
    f"{ONE} --online --trajectory trajectory.csv": "--trajectory is for all rows at once",
    f"{ONE} --estimator irls --online": "--estimator is for all rows at once",
    f"{ONE} --estimator irls --link-by-link": "--estimator is for all rows at once",
    f"{ONE} --link-by-link --online": "leave --online out",
    f"{ONE} --unloaded two.csv": "give --payload too",
    f"{ONE} --forgetting 3": "give --online too",
    f"{ONE} --online --forgetting 0": "longer time constant",
    f"{ONE} --payload-recording two.csv": "belong together",
    f"{ONE} --payload-mass 2 --payload-recording two.csv --payload-com 1,2": "three numbers",
    "design planar_2r --criterion d --bound": "not of criterion d",
    "design planar_2r --link-by-link --bound": "leave --bound out",
    "design planar_2r --link-by-link --noise 1,1": "leave --noise out",
    "design planar_2r --link-by-link --from 0,0": "leave --from out",
    "design planar_2r --link-by-link --after run.csv": "leave --after out",
    "design planar_2r --after far.csv": "far.csv: q of joint1, joint2 leaves",
    "check planar_2r broken.csv": "broken.csv",
    "show ur10 trajectory.csv -o page.html": "trajectory.csv: 2 joint columns",
    "show ur10 trajectory.json -o page.html": "has 2 joints, but ur10 has 6",
    "show planar_2r trajectory.csv --obstacles nothing.yaml -o page.html": "nothing.yaml",
    "show planar_2r trajectory.csv": "name a .html file",
    "check planar_2r nothing.csv": "nothing.csv: no such file",
    "rehearse planar_2r nothing.csv": "nothing.csv: no such file",
    "rehearse ur10 trajectory.csv": "trajectory.csv: 2 joint columns",
    "design planar_2r --rate 0": "--rate 0 Hz",
    "design planar_2r --starts 1 --use 1.2": "use of 1.2",
    "design planar_2r --starts 1 --speed 0": "--speed 0",
    "design planar_2r --starts 1 --floor 0 --no-floor": "exclude each other",
    "report nowhere": "nowhere: no such folder",
    "robots": "-o is about one arm",
    "robots --mass 3": "about one arm",
    "robots ur10 --mass 0": "must be positive",
    "analyze planar_2r -o taken": "taken",
    "analyze planar_2r -o /": "holds it, and would be replaced",
    "analyze planar_2r -o loop/run": "loop is no folder",
    "identify planar_2r loop": "symbolic links",
    "simulate planar_2r trajectory.csv": "name a .csv or .parquet file",
    f"simulate planar_2r trajectory.csv -o {'x' * 256}.csv": "a name of more than 255 bytes",
}


@pytest.mark.parametrize("line", REFUSED)
def test_bad_input_is_refused_in_one_line(line: str, here: Path, refused: Any) -> None:
    for file, content in FILES.items():
        (here / file).write_text(content, encoding="utf-8")
    (here / "loop").symlink_to("loop")
    assert REFUSED[line] in refused(line if re.search("^report| -o ", line) else f"{line} -o out")


@pytest.mark.parametrize("form", ["", slow(" --json")])
@pytest.mark.parametrize(
    ("limits", "culprit"),
    [
        ("velocity: [0.01, 9]", r"velocity of joint1 comes to -?\d.* beyond its limit of -?0\.01$"),
        ("position: [[-9, 9], [0, 0.02]]", r"position of joint2 comes to .* limit of (0|0\.02)$"),
        ("torque: [900, 0.05]", r"torque of joint2 comes to .* limit of -?0\.05$"),
    ],
)
def test_a_motion_beyond_its_limits_exits_with_one(limits, culprit, form, here, excitant):
    (here / "tight.yaml").write_text(limits)
    ran = excitant(f"check planar_2r trajectory.csv --limits tight.yaml -o out{form}")
    assert ran.status == 1
    assert re.search(culprit, ran.err)
    assert json.loads((here / "out/result.json").read_text())["holds"] is False


WRONG = {
    "frobnicate": "frobnicate",
    "identify": "ROBOT",
    "check ur10": "TRAJECTORY",
    "demo --seed -1": "--seed",
    "desgin ur10": 'Did you mean "design"?',
    "design ur10 --duratoin 5": "Unknown option: --duratoin. Did you mean --duration?",
    "simulate ur10 t.csv --ouput r.csv": "Did you mean --output instead of --ouput?",
    "design ur10 --criterion conditoin": 'Did you mean "condition"?',
    "design ur10 --criterion best": 'Choose from: "condition", "d", "a", "e"',
    "completion bsh": 'Did you mean "bash"?',
    "design ur10 --starts=many": 'unable to convert "many" into int',
}


@pytest.mark.parametrize("line", WRONG)
def test_wrong_usage_exits_with_two_and_a_near_word(line: str, here: Path, capsys: Any) -> None:
    before = sorted(here.rglob("*"))
    with pytest.raises(SystemExit) as end:
        main(line.split())
    assert end.value.code == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 2)
    assert WRONG[line] in err
    assert "usage: excitant" in err
    assert sorted(here.rglob("*")) == before


def test_help_without_a_command_and_a_version_that_names_the_solvers(excitant: Any) -> None:
    bare, version = excitant(""), excitant("--version")
    assert bare == (2, excitant("--help").out, "")
    assert " go " in bare.out
    assert version.status == 0
    assert re.match(rf"{re.escape(__version__)}.*clarabel", version.out, re.DOTALL)


BUG = IndexError("list index\nout of range")
WRAPPED = ImportError("numpy failed to import")
WRAPPED.__cause__ = KeyboardInterrupt()


def test_a_failure_is_owned_in_one_line(refused: Any, monkeypatch: Any) -> None:
    for error in (KeyboardInterrupt(), WRAPPED, BUG):
        monkeypatch.setattr("excitant.identify_robot", mock.Mock(side_effect=error))
        said = refused(f"{ONE} -o out", status=1 if error is BUG else 130)
        assert ("interrupted" in said) == (error is not BUG)
    assert "a bug (IndexError: list index out of range); please run it again with --debug" in said
    for words in (f"--debug {ONE}", f"{ONE} --debug"):
        with pytest.raises(IndexError):
            main(words.split())


def test_neither_too_little_memory_nor_closed_streams_are_a_bug(refused, monkeypatch, here) -> None:
    monkeypatch.setattr("excitant.identify_robot", mock.Mock(side_effect=MemoryError()))
    assert "memory of this machine does not suffice" in refused(f"{ONE} -o out", status=1)
    words = f"{sys.executable} -m excitant {ONE} -o out 0<&- 1>&- 2>&-"
    assert subprocess.run(words, shell=True).returncode in (0, 1)
    assert (here / "out" / "report.html").exists()


def test_as_a_process_in_a_pipe(here: Path) -> None:
    command = [sys.executable, "-m", "excitant"]
    shown = subprocess.run(
        [*command, "robots", "planar_2r"],
        capture_output=True,
        env=os.environ | {"PYTHONIOENCODING": "ascii"},
    )
    assert (shown.returncode, shown.stderr) == (0, b"")  # where ° has no code
    words = [*command, *["analyze", "planar_2r", "-o", "out"]]
    done = subprocess.run(words, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert "out/report.html" in done.stdout
    assert "\x1b" not in done.stdout
    failed = subprocess.run([*command, "analyze", "planar_3r"], capture_output=True, text=True)
    assert (failed.returncode, failed.stdout) == (1, "")
    assert failed.stderr == "excitant: unknown robot 'planar_3r': did you mean 'planar_2r'?\n"


def test_what_an_extra_brings_is_asked_for(here: Path, refused: Any, monkeypatch: Any) -> None:
    monkeypatch.setitem(sys.modules, "rosbags", None)
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    (here / "run.mcap").write_bytes(b"")
    assert "pip install 'excitant[ros]'" in refused("identify planar_2r run.mcap")
