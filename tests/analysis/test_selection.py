"""Effects beyond the standard model are chosen where an arm has them, and where it has none not."""

from itertools import product
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from known_arms import write_csv
from marks import slow
from planted import Runs, hidden

from excitant.analysis import effect_choice
from excitant.analysis.candidates import Observed, gather, observed
from excitant.analysis.effect_choice import choose_effects, described
from excitant.analysis.evidence import Candidate
from excitant.exceptions import RankDeficient
from excitant.identify import Recording, identify_robot, load_dataset
from excitant.identify.estimate import Estimate
from excitant.identify.prior import prior_parameters
from excitant.identify.regression import regression_of
from excitant.identify.rows import predicted_torque, split
from excitant.robots import Robot, load_robot
from excitant.robots import effects as kinds
from excitant.robots.effects.search import joint_facts
from excitant.robots.parameters import violations
from excitant.robots.virtual_arm import HiddenEffect, industrial_sensors

JOINTS = ("joint1", "joint2")
STANDARD = kinds.standard_effects(JOINTS)
PLANTED = (
    hidden("stribeck_friction", "joint1", Fs=3.0, velocity=0.15),
    hidden("presliding_hysteresis", "joint2", Fh=2.0, distance=0.05),
)


def recorded(
    runs: Runs, robot: Robot, seed: int, hidden: tuple[HiddenEffect, ...] = (), *more: str
) -> list[Recording]:
    """Motions of one virtual arm, seen by sensors with noise and resolution."""
    sensors = industrial_sensors(robot, 125.0)
    return runs(robot, [31, seed], hidden, sensors, 0.03, duration=20.0, names=("first", *more))


@pytest.fixture(scope="module")
def two(planar: Robot, runs: Runs) -> list[Recording]:
    """A motion to fit and one to judge, of an arm with both planted."""
    return recorded(runs, planar, 0, PLANTED, "second")


@pytest.fixture(scope="module")
def plain(planar: Robot, two: list[Recording]) -> Estimate:
    return identify_robot(planar, two[:1], validate=two[1:], effects=STANDARD)


@pytest.mark.slow
def test_planted_effects_are_chosen_and_predict_an_unseen_motion_better(planar, two, plain):
    effects = choose_effects(planar, two[:1])
    assert effects[:4] == STANDARD
    chosen = {(effect.name, joint) for effect in effects[4:] for joint in effect.joints}
    assert {(each.effect, each.joint) for each in PLANTED} <= chosen
    assert len(described(effects)) == len(effects) - 4
    assert all(said.startswith("effect added: ") for said in described(effects))
    better = identify_robot(planar, two[:1], validate=two[1:], effects=effects)
    assert (better.validate.rms < 0.9 * plain.validate.rms).all()
    assert violations(better.phi, planar.links) == []


@pytest.mark.parametrize("seed", [0, *(slow(k) for k in (1, 2))])
def test_a_plain_arm_gets_the_standard_model(planar: Robot, runs: Runs, seed: int) -> None:
    effects = choose_effects(planar, recorded(runs, planar, 10 + seed))
    assert effects == STANDARD
    assert len(described(effects)) == 1


@pytest.mark.slow
def test_what_the_motion_leaves_undetermined_is_not_chosen(planar, two, monkeypatch):
    """Whether the refusal names the effect itself, or only what it leaves undetermined."""
    first, second = (kinds.Spring((joint,)) for joint in JOINTS)
    causes = [Candidate(effect, slice(0), np.zeros((0, 0))) for effect in (first, second)]
    monkeypatch.setattr(effect_choice, "select", lambda evidence, robot: (evidence, causes))
    monkeypatch.setattr(effect_choice, "_predictive", lambda evidence, chosen: list(chosen))
    for names in ([p.name for p in second.parameters(planar)], ["link2.m"]):

        def refusing(*given: Any, effects: Any, names: list[str] = names, **options: Any) -> Any:
            if any(e.name == "spring" and "joint2" in e.joints for e in effects):
                raise RankDeficient(names, "undetermined")
            return identify_robot(*given, effects=effects, **options)

        monkeypatch.setattr(effect_choice, "identify_robot", refusing)
        assert [e for e in choose_effects(planar, two[:1]) if not e.search.standard] == [first]


@pytest.mark.slow
def test_plain_larger_arms_get_hardly_anything(runs: Runs) -> None:
    robots = [load_robot(name) for name in ("ur10", "panda")]
    chosen = [choose_effects(r, recorded(runs, r, seed)) for r in robots for seed in range(2)]
    added = [effect for effects in chosen for effect in effects if not effect.search.standard]
    assert len(added) <= 1, added


@pytest.mark.slow
@pytest.mark.parametrize(
    "effect",
    [
        kinds.EFFECTS["stribeck_friction"](JOINTS[:1]),
        kinds.PreslidingHysteresis(JOINTS, distance=0.02),
        kinds.LoadDependentFriction(JOINTS[1:]),
        kinds.ThermalFrictionDrift(JOINTS[:1], time=20.0),
        kinds.TimeDelay(JOINTS, trial=0.01),
        *(kinds.EFFECTS[name](JOINTS) for name in ("friction_coupling", "spring")),
        *(kinds.EFFECTS[name](JOINTS[1:]) for name in ("joint_elasticity", "backlash")),
    ],
    ids=lambda effect: effect.name,
)
def test_identify_takes_every_kind(planar, two, plain, effect):
    """One more kind of effect never makes the fit of what it was fitted to worse."""
    more = identify_robot(planar, two[:1], validate=two[1:], effects=(*STANDARD, effect))
    before, after = (fit.train.rms / plain.least_squares.sigma for fit in (plain, more))
    assert (after**2).sum() <= 1.01 * (before**2).sum()
    assert more.model.effects[4].name == effect.name


def test_effects_of_torque_take_it_from_the_identified_arm(planar: Robot, two: list[Recording]):
    """A given arm that is far off must not decide what the load of a friction is."""
    heavy = planar.with_parameters(5 * planar.phi)
    effects = (*STANDARD, kinds.LoadDependentFriction(JOINTS))
    fits = [identify_robot(r, two[:1], validate=two[1:], effects=effects) for r in (planar, heavy)]
    near, far = (fit.model.effects[4].values for fit in fits)
    np.testing.assert_allclose(near, far, atol=0.02)  # the prior still differs
    np.testing.assert_allclose(fits[0].validate.nrmse, fits[1].validate.nrmse, rtol=0.15)


@pytest.mark.slow
def test_the_command_chooses_effects(two: list[Recording], tmp_path: Path, excitant: Any) -> None:
    file, out = write_csv(tmp_path / "run.csv", two[0]), tmp_path / "out"
    line = f"identify planar_2r {file} --effects auto -o {out}"
    assert excitant(line).status == 0
    text = (out / "result.json").read_text(encoding="utf-8")
    assert "presliding_hysteresis" in text
    assert "effect added: " in text
    online = excitant(f"{line} --online")
    assert (online.status, "--effects auto" in online.err) == (1, True)


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.6, 0.7])
def test_real_friction_is_found(data_folder: Path, share: float) -> None:
    """The last part of a current-controlled arm's motion, with the effects that the first shows."""
    dataset = load_dataset(data_folder / "ur10")
    [whole] = dataset.recordings(["unisa_exciting"])
    fit, unseen = [whole.between(0, share, "first")], [whole.between(share, 1, "rest")]
    found = choose_effects(dataset.robot, fit)
    usual = kinds.standard_effects(dataset.robot.joints)
    bare = identify_robot(dataset.robot, fit, validate=unseen, effects=usual)
    better = identify_robot(dataset.robot, fit, validate=unseen, effects=found)
    assert better.validate.nrmse.sum() < 0.85 * bare.validate.nrmse.sum()
    assert violations(better.phi, dataset.robot.links) == []


EACH = (  # one of each way in which an effect gets its columns
    kinds.Payload(JOINTS[1:], (0.5, *[0.01] * 9)),
    kinds.ViscousFriction(JOINTS, (0.3, 0.2)),
    kinds.LoadDependentFriction(JOINTS, (0.05, 0.04)),
    kinds.FrictionCoupling(JOINTS, values=(0.1, 0.2)),
    kinds.KinematicError(JOINTS[1:], (0.01, 0.0, -0.01)),
    kinds.TimeDelay(JOINTS, (0.002,)),
)


@pytest.fixture(scope="module")
def rows(planar: Robot, two: list[Recording]) -> Observed:
    return observed(planar, split(two[:1], two[1:], None).train)


@pytest.mark.parametrize("factor", [1.0, 2.0])
def test_columns_are_those_of_any_model(factor: float, rows: Observed, planar: Robot) -> None:
    model = planar.with_parameters(factor * planar.phi).with_effects(EACH)
    found, W = rows.by(model), regression_of(model, EACH, rows.segments).W
    np.testing.assert_allclose(found.matrix(EACH), W, atol=1e-12)
    np.testing.assert_allclose(found.torque(), predicted_torque(model, rows.segments), atol=1e-9)


def test_a_reversal_that_filter_and_sampling_hide_is_not_proposed(rows: Observed, planar: Robot):
    facts = joint_facts([s.motion for s in rows.segments], cutoff_hz=rows.segments[0].cutoff_hz)
    reversals = [
        kinds.GradualReversal((joint,), None, share * each.speed_blur)
        for joint, each, share in zip(JOINTS, facts, (0.99, 1.01), strict=True)
    ]
    train, bodies = observed(planar, rows.segments, reversals), prior_parameters(planar)
    tau = np.random.default_rng(0).normal(train.torque(), 0.1)
    found = gather(planar, train, tau, bodies)
    assert [c.effect for c in found.candidates if c.effect in reversals] == reversals[1:]


def test_each_column_is_worked_out_once(rows: Observed, planar: Robot) -> None:
    """By the motion alone, for all models of the arm."""
    kind, heavier = kinds.CoulombFriction, rows.by(planar.with_parameters(2 * planar.phi))
    with patch.object(kind, "columns", autospec=True, side_effect=kind.columns) as columns:
        for joints, each in product((JOINTS, JOINTS[:1], JOINTS[::-1]), (rows, heavier)):
            each.columns(kind(joints, tuple(range(len(joints)))))
    asked = sorted(call.args[0].joints for call in columns.call_args_list)
    assert asked == [("joint1",), ("joint2",)]
