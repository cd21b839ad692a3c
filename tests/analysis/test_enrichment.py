"""Effects beyond the standard model are added where an arm has them, and where it has none not.

The virtual arm shares no code with the effects that are fitted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from excitant.analysis.enrichment import FLOOR, Enrichment, beyond_chance, enriched, enrichment
from excitant.analysis.enrichment_trial import trial_of
from excitant.cli import main
from excitant.design import random_trajectory
from excitant.identify import Recording, identify, load_dataset, recording_from_table
from excitant.identify.knowledge import Knowledge
from excitant.identify.rows import fit_rows, with_own_torque
from excitant.robots import Robot, base_parameters, load_robot
from excitant.robots.effects import (
    EFFECTS,
    LoadDependentFriction,
    PreslidingHysteresis,
    StribeckFriction,
    ThermalFrictionDrift,
    TimeDelay,
    plain,
    standard_effects,
)
from excitant.robots.parameters import violations
from excitant.robots.virtual_arm import HiddenEffect, industrial_sensors, virtual_arm

DURATION, RATE_HZ = 20.0, 125.0


def recorded(
    robot: Robot, seed: int, hidden: Sequence[HiddenEffect] = (), count: int = 1
) -> list[Recording]:
    """Motions of one virtual arm, seen by sensors with noise and resolution."""
    rng = np.random.default_rng([31, seed])
    sensors = industrial_sensors(robot, RATE_HZ)
    arm = virtual_arm(robot, rng, hidden=tuple(hidden), sensors=sensors)
    tables = [
        arm.record(random_trajectory(robot, rng, DURATION, 5), DURATION, rng) for _ in range(count)
    ]
    return [
        recording_from_table(table, robot.nv, file=f"run{k}.parquet", name=f"run{k}")
        for k, table in enumerate(tables)
    ]


def hidden(kind: str, joint: str, **values: float) -> HiddenEffect:
    return HiddenEffect(kind, joint, tuple(values.items()))


PLANTED = (
    hidden("stribeck_friction", "joint1", Fs=3.0, velocity=0.15),
    hidden("presliding_hysteresis", "joint2", Fh=2.0, distance=0.05),
)


@pytest.fixture(scope="module")
def two(planar: Robot) -> list[Recording]:
    """A motion to fit and one to judge, of an arm with both planted."""
    return recorded(planar, 0, PLANTED, count=2)


@pytest.fixture(scope="module")
def found(planar: Robot, two: list[Recording]) -> Enrichment:
    return enrichment(planar, two[:1])


def test_planted_effects_are_added_where_they_are(found: Enrichment) -> None:
    added = {(step.effect.name, joint) for step in found.steps for joint in step.effect.joints}
    assert ("stribeck_friction", "joint1") in added
    assert ("presliding_hysteresis", "joint2") in added
    assert found.effects[:4] == standard_effects(("joint1", "joint2"))
    assert tuple(step.effect for step in found.steps) == found.effects[4:]


def test_each_addition_pays_beyond_chance_and_floor(found: Enrichment) -> None:
    assert len(found.steps) >= 2
    for step in found.steps:
        places = 2 / len(step.effect.joints)
        assert step.fall > max(FLOOR, beyond_chance(places) * step.error)
        assert plain(step.effect.name) in step.sentence
    assert (found.after < 0.8 * found.before).all()


def test_what_was_added_predicts_an_unseen_motion_better(
    planar: Robot, two: list[Recording], found: Enrichment
) -> None:
    fit, unseen = two[:1], two[1:]
    plain = identify(planar, fit, validate=unseen)
    better = identify(planar, fit, validate=unseen, effects=found.effects)
    assert (better.validate.rms < 0.9 * plain.validate.rms).all()
    assert violations(better.phi, planar.links) == []


@pytest.mark.parametrize("seed", range(3))
def test_a_plain_arm_gets_the_standard_model(planar: Robot, seed: int) -> None:
    fit = recorded(planar, 10 + seed)
    assert enriched(planar, fit) == standard_effects(planar.joints)


def test_a_recording_in_pieces_is_left_out_in_few_parts(planar: Robot) -> None:
    """However many gaps it has, and with every row in one part and one block."""
    (whole,) = recorded(planar, 10)
    kept = (whole.t - whole.t[0]) % 2.5 > 0.1
    pieces = replace(whole, t=whole.t[kept], q=whole.q[kept], tau=whole.tau[kept], dq=None)
    fit = identify(planar, [pieces], validate=[pieces])
    assert len(fit.data.train) == 8
    trial = trial_of(planar, fit)
    assert set(trial.folds) == set(range(5))
    assert set(trial.blocks) == set(range(max(trial.blocks) + 1))
    for block in set(trial.blocks):
        assert len(set(trial.folds[trial.blocks == block])) == 1


def test_where_nothing_is_added_it_is_said(planar: Robot) -> None:
    same = enrichment(planar, recorded(planar, 10))
    assert same.steps == ()
    np.testing.assert_array_equal(same.before, same.after)
    assert len(same.notes) == 1


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ur10", "panda"])
def test_plain_larger_arms_get_hardly_anything(name: str) -> None:
    robot = load_robot(name)
    added = [
        step.sentence
        for seed in range(10)
        for step in enrichment(robot, recorded(robot, seed)).steps
    ]
    assert len(added) <= 1, added


@pytest.mark.parametrize(
    "effect",
    [
        StribeckFriction(("joint1",)),
        PreslidingHysteresis(("joint1", "joint2"), distance=0.02),
        LoadDependentFriction(("joint2",)),
        ThermalFrictionDrift(("joint1",), time=20.0),
        TimeDelay(("joint1", "joint2"), trial=0.01),
        *(EFFECTS[name](("joint1", "joint2")) for name in ("friction_coupling", "spring")),
        *(EFFECTS[name](("joint2",)) for name in ("joint_elasticity", "backlash")),
    ],
    ids=lambda effect: effect.name,
)
def test_identify_takes_every_kind(planar: Robot, two: list[Recording], effect: object) -> None:
    """One more kind of effect never makes the fit of what it was fitted to worse."""
    plain = identify(planar, two[:1], validate=two[1:])
    more = identify(
        planar, two[:1], validate=two[1:], effects=(*standard_effects(planar.joints), effect)
    )
    size = (plain.train.rms / plain.least_squares.sigma) ** 2
    assert ((more.train.rms / plain.least_squares.sigma) ** 2).sum() <= 1.01 * size.sum()
    assert more.model.effects[4].name == effect.name  # type: ignore[attr-defined]


def test_effects_of_torque_take_it_from_the_identified_arm(two: list[Recording]) -> None:
    """A given arm that is far off must not decide what the load of a friction is."""
    planar = load_robot("planar_2r")
    heavy = planar.with_parameters(5 * planar.phi)
    effects = (*standard_effects(planar.joints), LoadDependentFriction(planar.joints))
    fits = [identify(r, two[:1], validate=two[1:], effects=effects) for r in (planar, heavy)]
    near, far = (fit.model.effects[4].values for fit in fits)
    np.testing.assert_allclose(near, far, atol=0.02)  # the prior still differs
    np.testing.assert_allclose(fits[0].validate.nrmse, fits[1].validate.nrmse, rtol=0.05)


def test_effects_of_the_motion_alone_need_no_identified_arm(
    planar: Robot, two: list[Recording]
) -> None:
    fit = identify(planar, two[:1], validate=two[1:])
    prior, nothing = fit.prior.reshape(-1, 10), Knowledge()
    of_motion = (*standard_effects(planar.joints), PreslidingHysteresis(planar.joints))
    of_torque = (*standard_effects(planar.joints), TimeDelay(planar.joints))
    same, other = (
        with_own_torque(
            fit_rows(planar, effects, base_parameters(planar, effects), fit.data),
            prior,
            nothing,
        )
        for effects in (of_motion, of_torque)
    )
    assert same.robot is planar
    assert np.abs(other.robot.phi - planar.phi).max() > 1e-3


def test_the_command_chooses_effects(
    planar: Robot, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(3)
    arm = virtual_arm(planar, rng, hidden=PLANTED, sensors=industrial_sensors(planar, RATE_HZ))
    file = tmp_path / "run.csv"
    arm.record(random_trajectory(planar, rng, DURATION, 5), DURATION, rng).to_csv(file, index=False)
    words = ["identify", "planar_2r", str(file), "--effects", "auto", "-o", str(tmp_path / "out")]
    assert main(words) == 0
    text = (tmp_path / "out" / "result.json").read_text(encoding="utf-8")
    assert "presliding_hysteresis" in text
    assert "effect added: " in text
    assert main([*words, "--online"]) == 1
    assert "--effects auto" in capsys.readouterr().err


def test_real_friction_is_found(data_folder: Path) -> None:
    """A current-controlled arm's last 40 %, predicted with the effects its first 60 % call for."""
    dataset = load_dataset(data_folder / "ur10")
    (whole,) = dataset.recordings(["unisa_exciting"])
    fit, unseen = [whole.between(0, 0.6, "first")], [whole.between(0.6, 1, "rest")]
    plain = identify(dataset.robot, fit, validate=unseen)
    found = enriched(dataset.robot, fit)
    better = identify(dataset.robot, fit, validate=unseen, effects=found)
    assert better.validate.nrmse.sum() < 0.85 * plain.validate.nrmse.sum()
    assert violations(better.phi, dataset.robot.links) == []
