"""From recordings to a model that predicts, on virtual and on real arms."""

from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from known_arms import Call
from marks import refused, slow
from plant_recordings import PENDULUM
from scipy.interpolate import make_interp_spline

from excitant.exceptions import RankDeficient
from excitant.identify import Estimate, Recording, identify_robot, load_dataset, model_files
from excitant.identify.export import publication, save_model
from excitant.robots import Motion, Robot, load_robot, torque
from excitant.robots.parameters import from_pseudo_inertia, violations

ROD = PENDULUM.with_parameters([1, 0, 0, -0.2, 0.05, 0, 0.05, 0, 0, 0.002])


def identified(robot: Robot, runs: list[Recording]) -> Estimate:
    return identify_robot(robot, runs[:-1], validate=runs[-1:])


def by_name(found: Estimate) -> dict[str, Any]:
    return {p["name"]: p for p in found.result()["parameters"]}


@pytest.fixture(scope="module", params=["ur10", slow("panda")])
def ideal(request: pytest.FixtureRequest, runs: Call) -> Estimate:
    """An arm whose values are off by some per cent, seen by true sensors."""
    robot = load_robot(request.param)
    return identified(robot, runs(robot, 0, tolerance=0.03))


def test_a_virtual_arm_is_predicted_on_another_motion(ideal: Estimate) -> None:
    # only where a joint turns back does the sign of a filtered velocity err: for about one
    # period of the 20 Hz position filter, by twice the friction torque
    segment = ideal.data.validate[0]
    turns = (np.diff(np.sign(segment.motion.dq), axis=0) != 0).sum(axis=0)
    share = turns / 20.0 / (segment.t[-1] - segment.t[0])
    friction = np.array(ideal.model.effects[1].values)
    allowed = 0.02 * segment.tau.std(axis=0) + 2 * friction * np.sqrt(share)
    assert (ideal.validate.rms <= allowed).all()
    assert (ideal.validate.rms < ideal.baseline.rms).all()
    assert ideal.validate.nrmse.mean() < 0.03


def test_the_model_is_one_that_bodies_can_have_and_the_result_complete(ideal: Estimate) -> None:
    """Its keys are those of its record, which is read wherever a report is written."""
    assert violations(ideal.phi, ideal.given.links) == []
    for effect in ideal.model.effects:
        least = np.array([p.lower for p in effect.parameters(ideal.given)])
        assert (np.array(effect.values) >= least - 1e-6).all(), effect.name
    result, arrays = ideal.result(), ideal.series()
    springs = [k for spring in ideal.physical.springs for k in spring.values]
    assert len(result["parameters"]) == 14 * ideal.given.nv + len(springs)
    assert result["physical"]["consistent"]
    unknown = [p for p in result["parameters"] if p["category"] == "unidentifiable"]
    assert {p["prior_dominated"] for p in unknown} == {True}
    assert {len(x) for k, x in arrays.items() if k[:9] != "friction_"} == {len(ideal.holdout.t)}


def test_accuracy_is_what_its_words_say(ideal: Estimate) -> None:
    """Over rows that no rest of the joint affects, where dry friction holds any torque."""
    found, moves = ideal.validate, ideal.holdout.moves
    assert not moves.all()
    for j, rows in enumerate(moves.T):
        measured = ideal.holdout.measured[rows, j]
        rms = np.sqrt(((measured - ideal.predicted[rows, j]) ** 2).mean())
        assert found.rms[j] == pytest.approx(rms, rel=1e-9)
        assert found.r2[j] == pytest.approx(1 - (rms / measured.std()) ** 2, rel=1e-9)


@pytest.mark.parametrize(("arm", "effects"), [(load_robot("ur10"), ()), (ROD, None)])
def test_exact_data_give_exact_predictions_and_files_of_that_torque(arm, effects, exact, tmp_path):
    robot = arm.with_effects(())
    recording = exact(robot, np.arange(0, 20, 1 / 128))
    found = identify_robot(robot.with_parameters(1.2 * robot.phi), [recording], effects=effects)
    # what is left are the edges, where the position filter does not know what came before
    assert (found.validate.nrmse <= 5e-3).all()
    assert (found.baseline.nrmse >= 0.15).all()
    for file, text in model_files(found.model, "identified", "model.yaml").items():
        (tmp_path / file).write_text(text, encoding="utf-8")
    motion = Motion(np.arange(50) / 10, *robot.random_motion(np.random.default_rng(0), 50))
    expected = torque(found.model, motion)
    reloaded = torque(load_robot(tmp_path / "model.yaml"), motion)
    assert np.abs(reloaded - expected).max() <= 1e-9 * np.abs(expected).max()


def test_a_motion_that_hides_parameters_is_refused_by_name(exact: Call, planar: Robot) -> None:
    recording = exact(planar, np.arange(0, 20, 1 / 128))
    q = recording.q * [1, 0] + [0, 0.3]
    refused(r"joint2\.Fv", identify_robot, planar, [replace(recording, q=q)], error=RankDeficient)


def test_a_tool_is_told_with_the_sum_in_which_torque_shows_it(ur10: Robot, runs: Call) -> None:
    place, phi = np.array([0.06, 0.04, 0.03, 1.0]), np.array(ur10.phi)
    phi[50:] += from_pseudo_inertia(2.0 * (np.outer(place, place) + np.diag([1e-3] * 3 + [0])))
    found = identified(ur10, runs(ur10.with_parameters(phi), 1))
    assert "as +2 ± " in found.result()["links"][-1]["moved"]
    assert any("tool, with a first moment of" in note for note in found.result()["notes"])


@pytest.fixture(scope="module")
def nominal(ur10: Robot, runs: Call, own_steps: None) -> list[Recording]:
    return runs(ur10, 1)


def in_amperes(runs: list[Recording], gains: np.ndarray | float) -> list[Recording]:
    return [replace(run, tau=run.tau / gains, unit="A") for run in runs]


def test_drive_gains_are_recovered_from_current(ur10: Robot, nominal: list[Recording]) -> None:
    gains = 10 * np.exp(np.random.default_rng(4).uniform(-0.5, 0.5, ur10.nv))
    currents = in_amperes(nominal, gains)
    found = identified(ur10, currents)
    # the scale rests on the given masses, which are the true ones here; the last joint turns a
    # balanced link, whose torque its rotor could make, so its gain stays near those of the others
    np.testing.assert_allclose(found.gains[:5], gains[:5], rtol=0.02)
    assert abs(np.log(found.gains[5] / gains[5])) < 0.5
    assert any("drive gains" in note for note in found.notes)
    assert found.validate.nrmse.mean() < 0.03
    heavier = identified(ur10.with_parameters(1.25 * ur10.phi), currents)
    np.testing.assert_allclose(heavier.gains, 1.25 * found.gains, rtol=0.01)


def test_what_rests_on_drive_gains_carries_their_uncertainty(ur10, nominal):
    """Bodies to 30 % fix the common scale of currents to some per cent, and all that follows it."""
    rng = np.random.default_rng(0)
    noisy = [replace(x, tau=x.tau + 0.01 * rng.standard_normal(x.tau.shape)) for x in nominal]
    torque, current = (identified(ur10, runs) for runs in (noisy, in_amperes(noisy, 10.0)))
    drive = current.drive
    assert 0.05 < drive.scale_std < 0.3
    told = current.result()["drive_gain_std_Nm_per_A"]
    assert told == [s if yes else None for s, yes in zip(drive.std, drive.known, strict=True)]
    assert (drive.std >= drive.scale_std * drive.gains).all()
    ours, theirs = by_name(current), by_name(torque)
    for name in (f"{joint}.Fv" for joint in ur10.joints[:5]):
        p = ours[name]
        assert p["std"] >= 0.9 * drive.scale_std * p["value"] > 3 * theirs[name]["std"]
    # a prediction in ampere rests on no gain
    np.testing.assert_allclose(current.validate.nrmse, torque.validate.nrmse, atol=1e-3)
    widths = [found.interval.half_width.mean(axis=0) for found in (current, torque)]
    np.testing.assert_allclose(10 * widths[0], widths[1], rtol=0.1)


def test_what_nothing_fixes_is_told_in_amperes(ur10, nominal, tmp_path) -> None:
    """Placeholders fix no scale: friction is what it is per ampere, and the model still fits."""
    like_the_arm = np.diag([0.02, 0.02, 0.02, 1.0])
    blank = ur10.with_parameters(np.tile(from_pseudo_inertia(like_the_arm), ur10.nv))
    torque, current = identified(ur10, nominal), identified(blank, in_amperes(nominal, 10.0))
    assert not current.drive.known.any()
    assert not [n for n in publication(current).files if n.endswith((".urdf", ".xml", ".sdf"))]
    with pytest.warns(UserWarning, match="not determined"):
        assert save_model(current, tmp_path / "asked.urdf") == [tmp_path / "asked.urdf"]
    ours, theirs = by_name(current), by_name(torque)
    units = {"Fv": "A·s/rad", "Fc": "A", "offset": "A", "Ia": "A·s²/rad"}
    for joint, (name, unit) in product(ur10.joints[:5], units.items()):
        p, known = (each[f"{joint}.{name}"] for each in (ours, theirs))
        assert p["unit"] == unit
        # what a rotor and a link share has no ± of its own, and follows the given bodies
        std = np.inf if name == "Ia" else np.hypot(10 * p["std"], known["std"])
        assert abs(10 * p["value"] - known["value"]) <= 4 * std
    assert ours[f"{ur10.links[0]}.m"]["unit"] == "kg"
    assert any("told in amperes" in note for note in current.notes)


def mass_std(found: Estimate, link: int) -> float:
    return float(np.sqrt(found.physical.covariance[10 * link, 10 * link]))


def test_a_body_that_moves_by_half_is_named_without_a_false_uncertainty(ur10, nominal):
    """Torque shows its mass only together with others': it has no ± of its own."""
    link, light = 2, ur10.with_parameters(ur10.phi / 3)
    found = identified(light, nominal)
    result = found.result()
    body = result["links"][link]
    mass, centre = body["mass"], body["centre"]
    assert abs(mass["value"] - 3 * mass["given"]) < 3 * mass_std(found, link)
    assert f"forearm_link: mass {mass['given']:.3g} → {mass['value']:.3g} kg" in body["moved"]
    way = np.subtract(centre["value"], centre["given"])
    assert centre["shift"] == pytest.approx(np.linalg.norm(way))
    for p in result["parameters"]:
        assert (p["std"] is None) == (p["category"] != "unique")
        assert p["category"] == "unique" or p["decided_by"] != "data"
    assert any("moved by half" in note and body["moved"] in note for note in result["notes"])
    assert not identified(ur10, nominal).result()["links"][link]["moved"]


@pytest.mark.slow
def test_recordings_that_differ_are_told_from_those_that_agree(ur10, nominal):
    """Cluster-robust errors are those by noise, until one recording has more friction."""
    rng = np.random.default_rng(5)
    noisy = [nominal[0].tau + rng.standard_normal(nominal[0].tau.shape) for _ in range(3)]
    runs = [replace(nominal[0], tau=tau, name=f"run{k}") for k, tau in enumerate(noisy)]
    alike = identified(ur10, [*runs, nominal[1]]).repeats
    assert 0.6 < np.sqrt((alike.deviation**2).mean()) < 1.2
    assert not alike.differ
    again = identified(ur10, [*runs[::-1], nominal[1]]).repeats  # results are functions of the set
    np.testing.assert_array_equal(again.deviation, alike.deviation)
    more = runs[1].tau + 2.0 * np.sign(runs[1].dq) * (np.arange(6) == 2)
    found = identified(ur10, [runs[0], replace(runs[1], tau=more), runs[2], nominal[1]])
    assert found.repeats.differ
    k = found.base.expressions.index("elbow_joint.Fc")
    assert found.repeats.spread[k] > 2 * found.least_squares.std[k]
    assert any("most run1" in note for note in found.result()["notes"])


def test_one_link_that_is_wrong_spoils_no_other(ur10: Robot, nominal: list[Recording]) -> None:
    """Only it is given more room: it is found, and the links around it stay as they are."""
    link, phi = 2, np.array(ur10.phi)
    phi[10 * link : 10 * link + 10] *= 3
    found = identified(ur10.with_parameters(phi), nominal)
    true, bodies = float(ur10.phi[10 * link]), found.result()["links"]
    assert abs(bodies[link]["mass"]["value"] - true) < min(4 * mass_std(found, link), 0.15 * true)
    assert [bool(each["moved"]) for each in bodies] == [k == link for k in range(ur10.nv)]
    sigma = np.asarray(found.physical.prior.sigma)
    assert sigma[link] > 5 * max(np.delete(sigma, link))
    told = next(note for note in found.result()["notes"] if "data contradict the given" in note)
    assert [name in told for name in ur10.links] == [k == link for k in range(ur10.nv)]


@pytest.mark.parametrize("pull", [lambda q: 30.0 * q, lambda q: 150.0 * np.cos(q)])
def test_a_spring_opens_the_intervals_of_what_it_is_taken_for(pull: Call, ur10, nominal) -> None:
    """A linear one, which errors show, and one as gravity's torque: the bodies speak for it."""
    lift = np.arange(6) == 1
    runs = [replace(run, tau=run.tau + lift * pull(run.q)) for run in nominal]
    without, found = identified(ur10, nominal), identified(ur10, runs)
    off = np.abs(found.least_squares.beta - without.least_squares.beta)
    assert (off > 10 * without.base_std).any()
    assert (off < 3 * found.base_std).all()
    told = [sum("counterbalance" in note for note in each.notes) for each in (without, found)]
    assert told == [0, 1]
    # the model has it beside its bodies, and no file imitates it by a mass
    assert {e.name for e in found.model.effects} > {e.name for e in without.model.effects}
    assert (found.validate.nrmse < 0.01).all()
    for arm in (found.model, *(file.arm for file in publication(found).exported)):
        np.testing.assert_array_less(abs(arm.phi[::10] / ur10.phi[::10] - 1), 0.55)


@pytest.mark.parametrize("late", [-0.008, 0.02])
def test_a_delay_common_to_all_joints_is_made_up_for(late: float, ur10, nominal) -> None:
    """Of a log without one nothing is told; that of a single joint is none of the log."""
    tau = [make_interp_spline(x.t, x.tau)(np.clip(x.t - late, 0, x.t[-1])) for x in nominal]
    pairs = [*zip(nominal, tau, strict=True)]
    alone = [replace(x, tau=np.where(np.arange(6) == 1, own, x.tau)) for x, own in pairs]
    runs = (nominal, [replace(x, tau=own) for x, own in pairs], alone)
    without, found, single = (identified(ur10, each) for each in runs)
    told = [sum(" ms: " in x for x in each.notes) for each in (without, found, single)]
    assert told == [0, 1, 0]
    assert abs(found.data.delay - late) < 1e-3
    off = np.abs(found.least_squares.beta - without.least_squares.beta)
    assert (off < 4 * found.base_std).all()


def test_real_ur10_is_no_worse_than_the_reference(data_folder: Path) -> None:
    dataset = load_dataset(data_folder / "ur10")
    found = identify_robot(dataset.robot, dataset.recordings([]))
    reference = np.array([3.34, 3.39, 2.24, 0.88, 0.46, 1.14])  # N·m, same rows and cut-off
    assert (found.validate.rms <= 1.05 * reference).all(), found.validate.rms
    assert found.validate.rms.sum() < reference.sum()
    assert violations(found.phi, dataset.robot.links) == []
    assert (found.validate.rms < found.baseline.rms).all()


@pytest.mark.slow
def test_real_ur10e_is_predicted_from_its_currents(data_folder: Path) -> None:
    dataset = load_dataset(data_folder / "ur10e")
    train = dataset.recordings(["id_12harm_30s", "id_14harm_unloaded"])
    [held] = dataset.recordings(["val_ptp_10_points"])
    found = identify_robot(dataset.robot, train, validate=[held])
    assert found.data.unit == "A"
    assert violations(found.phi, dataset.robot.links) == []
    # the large joints have about 11 to 14 N·m/A, the wrists about 9; all but the last are told
    told = found.drive.known
    assert told[:-1].all()
    assert np.abs(found.gains - 11)[told].max() < 3
    assert (found.validate.r2 > 0.5).all(), found.validate.r2


def test_what_no_arm_does_widens_every_interval_and_moves_no_mass_far(ur10, nominal, runs) -> None:
    """A link has products of inertia that no body has: the model lacks something, and says so."""
    none = ur10.with_parameters(ur10.phi + 0.3 * np.isin(np.arange(60), [25, 35]))
    without, found = identified(ur10, nominal), identified(ur10, runs(none, 1))
    assert [any("possible arm" in x for x in each.notes) for each in (without, found)] == [0, 1]
    assert (found.base_std > 2 * without.base_std).all()
    np.testing.assert_allclose(found.phi[::10], ur10.phi[::10], rtol=0.3)
