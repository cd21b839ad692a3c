"""Python as people expect it: short shows, names and tables as arguments, predict, score, save."""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from marks import refused

import excitant as ex
from excitant.design import play
from excitant.exceptions import BadInput, BadRecording, UnknownName
from excitant.identify import Estimate, Recording
from excitant.identify.export import save_model
from excitant.robots import Robot, torque

Tables = tuple[pd.DataFrame, pd.DataFrame]


@pytest.fixture(scope="module")
def tables(planar: Robot) -> Tables:
    """Two recordings of a virtual arm as tables."""
    rng = np.random.default_rng(4)
    arm = ex.virtual_arm("planar_2r", rng, hidden=())
    motions = [ex.random_trajectory("planar_2r", rng, 10.0, 5) for _ in range(2)]
    return tuple(arm.record(motion, 10.0, rng) for motion in motions)


@pytest.fixture(scope="module")
def estimate(tables: Tables) -> Estimate:
    return ex.identify_robot("planar_2r", tables[0], validate=tables[1])


@pytest.fixture(scope="module")
def held(tables: Tables) -> Recording:
    return ex.recording_from_table(tables[1], 2, file="held", name="held")


@pytest.fixture(scope="module")
def panda() -> dict[str, object]:
    """Every noun of every day, of an arm with seven joints."""
    robot, rng = ex.load_robot("panda"), np.random.default_rng(3)
    design = ex.design_trajectory(robot, duration=8.0, starts=1, jobs=1, time_limit=0.0)
    path = ex.random_trajectory(robot, rng, 10.0, 5)
    table = ex.virtual_arm(robot, rng).record(path, 10.0, rng)
    run = ex.recording_from_table(table, robot, file="a.csv", name="a")
    estimate = ex.identify_robot(robot, run)
    return {
        "Robot": robot,
        "Fourier": design.trajectory,
        "Motion": design.trajectory.sample(2000),
        "Design": design,
        "Recording": run,
        "Estimate": estimate,
        "Identifiability": ex.analyze(robot, estimate=estimate),
        "Identifiability ": ex.analyze(robot),
        "Errors": ex.diagnose(robot, run),
        "Check": ex.check(robot, path),
    }


@pytest.mark.slow
def test_every_noun_shows_itself_in_three_lines(panda: dict[str, object]) -> None:
    for kind, noun in panda.items():
        shown = repr(noun)
        assert shown.startswith(kind), shown
        assert len(shown) <= 400, shown
        assert shown.count("\n") <= 2, shown
    assert "panda: 7 joints" in repr(panda["Robot"])
    assert "condition number" in repr(panda["Design"])


def test_shown_lines_are_cut_and_hold_nothing_a_terminal_obeys(planar: Robot) -> None:
    lines = repr(replace(planar, name="x" * 500 + "\x1b[31m")).splitlines()
    assert [len(line) for line in lines] == [130, *map(len, lines[1:])]
    assert "\x1b" not in repr(replace(planar, name="\x1b[31m"))


def test_tables_files_and_names_stand_for_recordings_and_robots(estimate, tables, planar, tmp_path):
    """In every verb; `identify/test_recording.py` has all forms."""
    tables[1].to_parquet(file := tmp_path / "held.parquet", index=False)
    (model := tmp_path / "arm.urdf").write_text(planar.urdf, "utf-8")
    held = ex.load_recording(file, model)
    other = ex.identify_robot("planar_2r", [tables[0]], validate=[file])
    np.testing.assert_allclose(other.phi, estimate.phi)
    assert other.score(held) == estimate.score(held)
    assert ex.identify_robot(model, tables[0], validate=file).validate.r2.min() > 0.99
    online = ex.identify_online("planar_2r", tables[0], validate=file).estimate
    assert online.validate.r2.min() > 0.9
    assert len(ex.identify_link_by_link("planar_2r", tables[0], validate=held).stages) == 2
    found = ex.diagnose("planar_2r", tables[0], validate=file)
    assert found.simulation.entry(0)["rms"] == pytest.approx(estimate.baseline.rms[0], rel=1e-3)
    assert len(ex.analyze(str(model), columns="inertial").base) < len(ex.analyze(planar).base)


def test_what_cannot_be_used_is_refused_in_one_line(estimate, tables, planar, tmp_path):
    panda = ex.load_robot("panda")
    run = ex.recording_from_table(tables[0], planar, file="run.csv", name="run")
    holed = tables[0].assign(tau2=tables[0]["tau2"].where(tables[0].index != 7))
    amperes = replace(run, unit="A")
    for error, said, call, *given in (
        (UnknownName, "unknown robot 'pnda': did you mean 'panda'", ex.identify_robot, "pnda", run),
        (BadRecording, "run.csv: has 2 joints, but panda has 7", ex.diagnose, panda, run),
        (BadInput, "no recording given", ex.identify_robot, planar, []),
        (BadRecording, r"recording gone\.csv: no such", ex.load_recording, "gone.csv", planar),
        (BadRecording, "table 2, .*'tau2', row 7: ", ex.identify_robot, planar, [tables[0], holed]),
        (BadRecording, "in A, but in N·m where it was identified", estimate.predict, amperes),
        (UnknownName, "unknown joint 'elbow'", planar.joint_index, "elbow"),
        (UnknownName, "did you mean 'links'", estimate.to_frame, "link"),
        (BadInput, r"excitant\.save\(estimate, folder\)", save_model, estimate, tmp_path / "run"),
    ):
        refused(f"^.*{said}.*$", call, *given, error=error)


def test_everything_at_once_takes_a_table_and_shows_itself(tables: Tables) -> None:
    found = ex.go("planar_2r", tables[0], validate=tables[1])
    assert re.fullmatch(r"Examination of planar_2r: use [\s\S]{1,370}", repr(found))
    assert "nrmse, given" in found._repr_html_()


def test_a_virtual_arm_records_a_file_and_motions_are_rehearsed(tmp_path: Path) -> None:
    path = ex.random_trajectory("planar_2r", np.random.default_rng(0), 4.0, 3)
    simulation = ex.simulate("planar_2r", path, seed=1, hidden=True)
    assert (len(simulation.hidden), simulation.duration) == (1, pytest.approx(4.0))
    assert ex.simulate("planar_2r", path, seed=1).hidden == ()


def test_scores_are_those_of_the_result(estimate: Estimate, tables: Tables) -> None:
    for part, table in (("train", tables[0]), ("validate", tables[1])):
        run = ex.recording_from_table(table, 2, file=part, name=part)
        for score, joint in zip(estimate.score(run), estimate.result()["joints"], strict=True):
            judged = {key: x for key, x in joint[part].items() if key != "interval95"}
            assert score == {"name": joint["name"], **judged}


def test_prediction_is_the_models_torque_where_samples_can_be_filtered(estimate, held):
    filtered, raw = estimate.predict(held), estimate.predict(held, filtered=False)
    assert filtered.shape == raw.shape == (len(held), 2)
    assert np.isfinite(filtered).all()
    (segment,) = estimate.data.validate
    np.testing.assert_allclose(filtered[segment.keep], estimate.predicted)
    np.testing.assert_allclose(raw, torque(estimate.model, segment.motion))
    rows = np.random.default_rng(0).permutation(len(held))[: len(held) - 300]
    irregular = held.take(np.sort(rows))
    inner = slice(200, -200)
    there = np.interp(irregular.t, held.t, filtered[:, 0])
    error = estimate.predict(irregular)[inner, 0] - there[inner]
    assert np.sqrt((error**2).mean()) < 0.05 * held.tau[:, 0].std()
    parted = held.take((held.t < 7.0) | (held.t > 9.0))
    known = np.isfinite(estimate.predict(parted)).all(axis=1)
    np.testing.assert_array_equal(known, parted.t < 7.0)


@pytest.mark.slow
def test_currents_are_predicted_as_currents(planar: Robot, runs: Callable[..., list[Recording]]):
    gains = np.array([20.0, 5.0])
    both = runs(planar, 3, duration=12.0)
    fit, held = (replace(run, tau=run.tau / gains, unit="A") for run in both)
    found = ex.identify_robot(planar, fit, validate=held)
    error = held.tau - found.predict(held)
    assert (error.std(axis=0) < 0.05 * held.tau.std(axis=0)).all()
    assert found.score(held)[1]["rms"] == found.result()["joints"][1]["validate"]["rms"]
    with pytest.raises(BadRecording, match="torque is in N·m, but in A"):
        found.score(replace(held, unit="N·m"))


@pytest.mark.parametrize("unit", ["N·m", "A"])
def test_a_recording_comes_back_from_its_table(unit: str, held: Recording) -> None:
    run = replace(held, unit=unit, extras={"heat": held.t / 9})
    back = ex.recording_from_table(run.to_frame(), 2, file="back", name="back")
    assert back.unit == unit
    for (name, given), (same, found) in zip(run.channels(), back.channels(), strict=True):
        assert name == same
        np.testing.assert_array_equal(given, found)
    np.testing.assert_array_equal(back.extras["heat"], run.extras["heat"])


def test_data_frames_hold_what_the_result_holds(estimate: Estimate, tables: Tables, planar: Robot):
    result = estimate.result()
    for kind, name in (("parameters", "name"), ("base_parameters", "expression")):
        frame = estimate.to_frame(kind)  # type: ignore[arg-type]
        assert list(frame.index) == [row[name] for row in result[kind]]
        assert frame["value"].tolist() == [row["value"] for row in result[kind]]
    assert estimate.to_frame("joints")["validate.rms"].tolist() == estimate.validate.rms.tolist()
    assert estimate.to_frame("links").loc["link1", "mass.value"] == estimate.phi[0]
    assert planar.to_frame().to_numpy().ravel().tolist() == planar.phi.tolist()
    assert planar.to_frame().loc["link2", "m"] == planar.phi[10]
    known = ex.analyze(planar, estimate=estimate)
    assert list(known.to_frame().index) == list(known.base.names)
    assert known.to_frame("base_parameters")["std"].tolist() == [p.std for p in known.practical]
    found = ex.diagnose(planar.with_effects(()), tables[0], validate=tables[1])
    findings = found.result()["findings"]
    assert found.to_frame()["explained"].tolist() == [f["explained"] for f in findings] != []
    clean = replace(found, findings=(), residuals=()).to_frame()
    assert clean.empty
    assert set(clean) < set(found.to_frame())


@pytest.mark.slow
def test_saved_runs_are_those_of_the_command_line(tables: Tables, here: Path, excitant: Any):
    for name, table in zip(("fit.csv", "held.csv"), tables, strict=True):
        table.to_csv(name, index=False)
    excitant("identify planar_2r fit.csv --validate held.csv -o theirs")
    estimate = ex.identify_robot("planar_2r", "fit.csv", validate="held.csv")
    paths = ex.save(estimate, "ours")
    assert {path.name for path in paths} == {path.name for path in Path("theirs").iterdir()}
    ours, theirs = (json.loads(Path(f, "result.json").read_text()) for f in ("ours", "theirs"))
    assert set(theirs) - set(ours) == {"faults", "import"}
    for key in ("joints", "parameters", "published", "physical"):
        assert ours[key] == theirs[key]
    assert [Path(file).name for file in ours["files"]] == [Path(f).name for f in theirs["files"]]
    model = ex.load_robot("ours/model.yaml")
    np.testing.assert_allclose(model.phi, estimate.phi)
    assert ex.save(ex.diagnose("planar_2r", "fit.csv"), "diagnosis")[0].name == "extended.urdf"
    with pytest.raises(BadInput, match="a int has no report"):
        ex.save(3, "three")  # type: ignore[arg-type]


def test_a_saved_design_is_the_motion(tmp_path: Path) -> None:
    options = {"duration": 6.0, "harmonics": 3, "starts": 1, "jobs": 1, "time_limit": 1.0}
    design = ex.design_trajectory("planar_2r", **options)
    names = [path.name for path in ex.save(design, tmp_path)]
    assert names[:2] == ["trajectory.csv", "trajectory.json"]
    again = ex.load_trajectory(tmp_path / "trajectory.json", "planar_2r")
    np.testing.assert_array_equal(again.coefficients, design.trajectory.coefficients)
    played = play(design, start=(0.1, -0.2), formats=("npz",), speed=0.5)
    assert {"approach.csv", "return.npz", "first_run.csv"} <= {*played.files}
    assert played.complete
    for name, wrong in (("rate", 0.0), ("repeat", 0), ("speed", 2.0), ("start", (0.1,))):
        refused(name.replace("start", "from"), play, design, **{name: wrong}, error=BadInput)


def test_a_model_that_got_worse_is_left_out_with_a_warning(estimate: Estimate, tmp_path: Path):
    turned = tuple(replace(s, tau=-s.tau, tau_raw=-s.tau_raw) for s in estimate.data.validate)
    worse = replace(estimate, data=replace(estimate.data, validate=turned))
    with pytest.warns(UserWarning, match="is not published: it predicts the hold-out worse"):
        paths = ex.save(worse, tmp_path / "run")
    assert not [path for path in paths if path.suffix == ".urdf"]
    assert json.loads((tmp_path / "run/result.json").read_text())["published"] is False
    with pytest.warns(UserWarning, match="published because it was forced"):
        forced = ex.save(worse, tmp_path / "run", force=True)
    assert [path for path in forced if path.suffix == ".urdf"]
