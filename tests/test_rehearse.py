"""A motion is tried on a virtual arm: a good one passes, a feeble one fails where it is feeble."""

import json
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest

import excitant as ex
from excitant.analysis import rehearsal
from excitant.design import Trajectory, trajectory_csv, trajectory_json
from excitant.robots import Robot
from excitant.robots.effects import standard_effects

Command = Callable[..., Any]


@pytest.fixture(scope="module")
def motion(planar: Robot) -> Trajectory:
    options = {"duration": 10.0, "harmonics": 4, "starts": 1, "jobs": 1, "seed": 1}
    return ex.design_trajectory(planar, **options).trajectory


def tried(robot: Robot, motion: Trajectory, *amplitudes: float) -> rehearsal.Rehearsal:
    """The motion with less amplitude of each joint."""
    coefficients = np.vstack([motion.coefficients[:1], motion.coefficients[1:] * amplitudes])
    weak = Trajectory(coefficients, motion.period)
    return rehearsal.rehearse(robot, weak, weak.period, np.random.default_rng(0))


def test_clearance_is_a_requirement() -> None:
    """Of a motion that drives the wrist through the floor, as `check` has it."""
    through = ex.Surroundings(ignore_collisions=True)
    robot = ex.load_robot("ur10")
    path = ex.random_trajectory(robot, np.random.default_rng(0), 4.0, 3)
    checked = ex.check(robot, path)
    assert checked.touched
    item = rehearsal.clearance_item(checked.scene, path, checked.least)
    assert not item.passed
    assert item.detail in checked.verdicts
    assert ex.check(robot, path, surroundings=through).clearance is None


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["json", "csv"])
def test_a_good_motion_passes(planar, motion, tmp_path, excitant, suffix):
    file = tmp_path / f"trajectory.{suffix}"
    text = trajectory_csv(motion) if suffix == "csv" else trajectory_json(motion, planar)
    file.write_text(text, encoding="utf-8")
    status, out, err = excitant("rehearse planar_2r", file, "--seed", 1, "-o", tmp_path / "out")
    assert (status, err) == (0, ""), out
    result = json.loads((tmp_path / "out" / "result.json").read_text("utf-8"))
    assert result["passed"] is True
    assert all(item["passed"] and not item["advice"] for item in result["items"])
    friction = [x for x in result["items"] if x["name"].endswith("friction")]
    assert len(friction) == 4
    for item in friction:
        assert item["recovered"] == pytest.approx(item["planted"], rel=0.1)
        assert 0 < item["std"] < 0.1 * item["planted"]
        assert f"{item['name']}, {item['joint']}: planted" in out
    assert "The motion would do" in (tmp_path / "out" / "report.html").read_text("utf-8")
    assert "NOT MET" not in (tmp_path / "out" / "summary.txt").read_text("utf-8")


@pytest.mark.slow
def test_a_feeble_motion_fails_and_names_the_joint(planar: Robot, motion: Trajectory):
    """What the other joint shows is recovered all the same."""
    feeble = tried(planar, motion, 1.0, 0.004)
    assert not feeble.passed
    failed = [item for item in feeble.items if not item.passed]
    assert {item.joint for item in failed} >= {"joint2"}
    assert all("joint2" in item.advice for item in failed if item.joint == "joint2")
    assert all(bool(item.advice) != item.passed for item in feeble.items)
    assert not [x for x in failed if x.joint == "joint1" and x.name.endswith("friction")]
    result = feeble.result()
    assert result["passed"] is False
    assert "joint2" in result["headline"]
    assert any("farther and faster: joint2" in advice for advice in result["advice"])


@pytest.mark.slow
def test_a_joint_that_stands_is_named(planar: Robot, motion: Trajectory) -> None:
    found = tried(planar, motion, 0.0, 1.0)
    [item] = [x for x in found.items if not x.passed]
    assert (item.name, item.joint) == ("identification", "joint1")
    assert "joint1.Fv" in item.detail
    assert found.estimate is None


@pytest.mark.slow
def test_limits_are_judged_on_what_the_arm_does(planar: Robot, motion: Trajectory) -> None:
    """Torque with friction is what is compared, and more than the limit is seen as more."""
    tight = planar.with_limits(replace(planar.limits, torque=np.array([1e3, 0.5])))
    rng = np.random.default_rng(0)
    run = rehearsal.rehearsal_arm(tight, rng).run(motion, motion.period, rng)
    items = rehearsal.limit_items(rehearsal.Situation(tight, run))
    [torque] = [item for item in items if item.name == "torque limits"]
    used = np.abs(run.tau[:, 1]).max() / 0.5
    assert used > 1.05
    assert (torque.passed, torque.joint) == (False, "joint2")
    assert f"{100 * used:.1f} %" in torque.detail
    assert "% of its speed" in torque.advice


def test_the_arm_has_what_is_said_to_be_planted(planar: Robot) -> None:
    """And a seed is a rehearsal."""
    effects = standard_effects(planar.joints)
    planted_in = partial(rehearsal.planted_parameters, effects=effects)
    rngs = [*map(np.random.default_rng, (4, 4, 2))]
    arms = [rehearsal.rehearsal_arm(planar, rng) for rng in rngs]
    planted, again, different = map(planted_in, arms)
    assert np.array_equal(again, planted)
    assert not np.array_equal(different, planted)
    Fv, Fc, offset, Ia = planted[10 * planar.nv :].reshape(4, planar.nv)
    assert (np.array([Fv, Fc, Ia]) > 0).all()
    assert offset.all()
    assert (np.abs(planted[: 10 * planar.nv : 10] / planar.phi[::10] - 1) <= 0.05 + 1e-12).all()
    change = rehearsal.draw_change(planar, rngs[0])
    assert change.effect in ("payload", "viscous_friction", "coulomb_friction")
    assert not np.allclose(planted_in(rehearsal.changed(arms[0], change)), planted)
    assert np.allclose(planted_in(arms[0]), planted)


@pytest.mark.parametrize(("size", "period"), [(0.2, 5.0), (0.0, 1.0)])
def test_a_moving_start_and_a_short_motion_are_refused_in_one_line(size, period, here, excitant):
    waves = size * np.random.default_rng(0).uniform(-1, 1, (7, 2))
    (here / "motion.csv").write_text(trajectory_csv(Trajectory(waves, period)), "utf-8")
    status, out, err = excitant("rehearse planar_2r motion.csv -o out")
    assert (status, out, err.count("\n")) == (1, "", 1)
    assert ("starts at rest" if size else "too short") in err
    assert not (here / "out").exists()
