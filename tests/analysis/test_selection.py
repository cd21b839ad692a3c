"""Effects beyond the standard model are chosen where an arm has them, and where it has none not.

The virtual arm shares no code with the effects that are fitted.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from excitant.analysis.selection import choose_effects, described
from excitant.cli import main
from excitant.design import random_trajectory
from excitant.identify import Recording, identify_robot, load_dataset, recording_from_table
from excitant.identify.estimate import with_own_torque
from excitant.identify.knowledge import Knowledge
from excitant.identify.rows import fit_rows
from excitant.robots import Robot, base_parameters, load_robot
from excitant.robots.effects import (
    EFFECTS,
    Effect,
    LoadDependentFriction,
    PreslidingHysteresis,
    ThermalFrictionDrift,
    TimeDelay,
    standard_effects,
)
from excitant.robots.parameters import violations
from excitant.robots.virtual_arm import HiddenEffect, industrial_sensors, virtual_arm

DURATION, RATE_HZ = 20.0, 125.0
PLANTED = (
    HiddenEffect("stribeck_friction", "joint1", (("Fs", 3.0), ("velocity", 0.15))),
    HiddenEffect("presliding_hysteresis", "joint2", (("Fh", 2.0), ("distance", 0.05))),
)


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


@pytest.fixture(scope="module")
def two(planar: Robot) -> list[Recording]:
    """A motion to fit and one to judge, of an arm with both planted."""
    return recorded(planar, 0, PLANTED, count=2)


def test_planted_effects_are_chosen_and_predict_an_unseen_motion_better(
    planar: Robot, two: list[Recording]
) -> None:
    fit, unseen = two[:1], two[1:]
    effects = choose_effects(planar, fit)
    assert effects[:4] == standard_effects(planar.joints)
    chosen = {(effect.name, joint) for effect in effects[4:] for joint in effect.joints}
    assert {(each.effect, each.joint) for each in PLANTED} <= chosen
    assert len(described(effects)) == len(effects) - 4
    assert all(said.startswith("effect added: ") for said in described(effects))
    plain = identify_robot(planar, fit, validate=unseen)
    better = identify_robot(planar, fit, validate=unseen, effects=effects)
    assert (better.validate.rms < 0.9 * plain.validate.rms).all()
    assert violations(better.phi, planar.links) == []


@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in (1, 2))])
def test_a_plain_arm_gets_the_standard_model(planar: Robot, seed: int) -> None:
    effects = choose_effects(planar, recorded(planar, 10 + seed))
    assert effects == standard_effects(planar.joints)
    assert len(described(effects)) == 1


@pytest.mark.slow
def test_plain_larger_arms_get_hardly_anything() -> None:
    robots = [load_robot(name) for name in ("ur10", "panda")]
    added = [choose_effects(r, recorded(r, seed))[4:] for r in robots for seed in range(5)]
    assert sum(map(len, added)) <= 1, added


@pytest.mark.parametrize(
    "effect",
    [
        EFFECTS["stribeck_friction"](("joint1",)),
        PreslidingHysteresis(("joint1", "joint2"), distance=0.02),
        LoadDependentFriction(("joint2",)),
        ThermalFrictionDrift(("joint1",), time=20.0),
        TimeDelay(("joint1", "joint2"), trial=0.01),
        *(EFFECTS[name](("joint1", "joint2")) for name in ("friction_coupling", "spring")),
        *(EFFECTS[name](("joint2",)) for name in ("joint_elasticity", "backlash")),
    ],
    ids=lambda effect: effect.name,
)
def test_identify_takes_every_kind(planar: Robot, two: list[Recording], effect: Effect) -> None:
    """One more kind of effect never makes the fit of what it was fitted to worse."""
    standard = standard_effects(planar.joints)
    plain = identify_robot(planar, two[:1], validate=two[1:])
    more = identify_robot(planar, two[:1], validate=two[1:], effects=(*standard, effect))
    before, after = (fit.train.rms / plain.least_squares.sigma for fit in (plain, more))
    assert (after**2).sum() <= 1.01 * (before**2).sum()
    assert more.model.effects[4].name == effect.name


def test_effects_of_torque_take_it_from_the_identified_arm(two: list[Recording]) -> None:
    """A given arm that is far off must not decide what the load of a friction is."""
    planar = load_robot("planar_2r")
    heavy = planar.with_parameters(5 * planar.phi)
    effects = (*standard_effects(planar.joints), LoadDependentFriction(planar.joints))
    fits = [identify_robot(r, two[:1], validate=two[1:], effects=effects) for r in (planar, heavy)]
    near, far = (fit.model.effects[4].values for fit in fits)
    np.testing.assert_allclose(near, far, atol=0.02)  # the prior still differs
    np.testing.assert_allclose(fits[0].validate.nrmse, fits[1].validate.nrmse, rtol=0.05)


def test_effects_of_the_motion_alone_need_no_identified_arm(
    planar: Robot, two: list[Recording]
) -> None:
    fit = identify_robot(planar, two[:1], validate=two[1:])
    standard, prior = standard_effects(planar.joints), fit.prior.reshape(-1, 10)
    same, other = (
        with_own_torque(
            fit_rows(planar, effects, base_parameters(planar, effects), fit.data),
            prior,
            Knowledge(),
        ).robot
        for effects in (
            (*standard, PreslidingHysteresis(planar.joints)),
            (*standard, TimeDelay(planar.joints)),
        )
    )
    assert same is planar
    assert np.abs(other.phi - planar.phi).max() > 1e-3


def test_the_command_chooses_effects(
    two: list[Recording], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run, file = two[0], tmp_path / "run.csv"
    columns = np.column_stack([run.t, run.q, run.dq, run.tau])
    header = "t,q1,q2,dq1,dq2,tau1,tau2"
    np.savetxt(file, columns, delimiter=",", header=header, comments="")
    words = ["identify", "planar_2r", str(file), "--effects", "auto", "-o", str(tmp_path / "out")]
    assert main(words) == 0
    text = (tmp_path / "out" / "result.json").read_text(encoding="utf-8")
    assert "presliding_hysteresis" in text
    assert "effect added: " in text
    assert main([*words, "--online"]) == 1
    assert "--effects auto" in capsys.readouterr().err


@pytest.mark.slow
def test_real_friction_is_found(data_folder: Path) -> None:
    """A current-controlled arm's last 40 %, predicted with the effects its first 60 % call for."""
    dataset = load_dataset(data_folder / "ur10")
    (whole,) = dataset.recordings(["unisa_exciting"])
    fit, unseen = [whole.between(0, 0.6, "first")], [whole.between(0.6, 1, "rest")]
    plain = identify_robot(dataset.robot, fit, validate=unseen)
    found = choose_effects(dataset.robot, fit)
    better = identify_robot(dataset.robot, fit, validate=unseen, effects=found)
    assert better.validate.nrmse.sum() < 0.85 * plain.validate.nrmse.sum()
    assert violations(better.phi, dataset.robot.links) == []
