"""A motion is tried on a virtual arm: a good one passes, a feeble one fails where it is feeble."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from excitant.analysis.rehearsal import (
    Rehearsal,
    Situation,
    changed,
    draw_change,
    limit_items,
    planted_parameters,
    rehearsal_arm,
    rehearse,
)
from excitant.design import (
    FourierTrajectory,
    design_trajectory,
    from_coefficients,
    random_trajectory,
    trajectory_csv,
    trajectory_json,
)
from excitant.robots import Robot
from excitant.robots.effects import standard_effects

Command = Callable[..., Any]


@pytest.fixture(scope="module")
def motion(planar: Robot) -> FourierTrajectory:
    found = design_trajectory(
        planar, duration=10.0, harmonics=4, starts=1, jobs=1, seed=1
    ).trajectory
    assert isinstance(found, FourierTrajectory)
    return found


def weakened(motion: FourierTrajectory, joint: int, factor: float) -> FourierTrajectory:
    """The same motion with less amplitude on one joint."""
    coefficients = np.array(motion.coefficients)
    coefficients[1:, joint] *= factor
    return from_coefficients(coefficients, motion.period)


@pytest.fixture(scope="module")
def feeble(planar: Robot, motion: FourierTrajectory) -> Rehearsal:
    weak = weakened(motion, 1, 0.004)
    return rehearse(planar, weak, weak.period, np.random.default_rng(0))


@pytest.mark.slow
def test_a_good_motion_passes(
    planar: Robot, motion: FourierTrajectory, tmp_path: Path, excitant: Command
) -> None:
    file = tmp_path / "trajectory.json"
    file.write_text(trajectory_json(motion, planar), encoding="utf-8")
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
    page = (tmp_path / "out" / "report.html").read_text("utf-8")
    assert "The motion would do" in page
    assert "NOT MET" not in (tmp_path / "out" / "summary.txt").read_text("utf-8")


def test_a_feeble_motion_fails_and_names_the_joint(feeble: Rehearsal) -> None:
    assert not feeble.passed
    failed = [item for item in feeble.items if not item.passed]
    assert {item.joint for item in failed} >= {"joint2"}
    assert all("joint2" in item.advice for item in failed if item.joint == "joint2")
    assert all(bool(item.advice) != item.passed for item in feeble.items)
    result = feeble.result()
    assert result["passed"] is False
    assert "joint2" in result["headline"]
    assert any("farther and faster: joint2" in advice for advice in result["advice"])


def test_what_the_other_joint_shows_is_recovered_all_the_same(feeble: Rehearsal) -> None:
    if feeble.estimate is not None:
        own = [x for x in feeble.items if x.joint == "joint1" and x.name.endswith("friction")]
        assert all(item.passed for item in own)


def test_a_joint_that_stands_is_named(planar: Robot, motion: FourierTrajectory) -> None:
    still = weakened(motion, 0, 0.0)
    found = rehearse(planar, still, still.period, np.random.default_rng(0))
    [item] = [x for x in found.items if not x.passed]
    assert (item.name, item.joint) == ("identification", "joint1")
    assert "joint1.Fv" in item.detail
    assert found.estimate is None


def test_limits_are_judged_on_what_the_arm_does(planar: Robot, motion: FourierTrajectory) -> None:
    """Torque with friction is what is compared, and more than the limit is seen as more."""
    tight = planar.with_limits(replace(planar.limits, torque=np.array([1e3, 0.5])))
    rng = np.random.default_rng(0)
    arm = rehearsal_arm(tight, rng)
    run = arm.run(motion, motion.period, rng)
    [torque] = [x for x in limit_items(Situation(tight, run)) if x.name == "torque limits"]
    used = np.abs(run.tau[:, 1]).max() / 0.5
    assert used > 1.05
    assert (torque.passed, torque.joint) == (False, "joint2")
    assert f"{100 * used:.1f} %" in torque.detail
    assert "% of its speed" in torque.advice


def test_the_arm_has_what_is_said_to_be_planted(planar: Robot) -> None:
    rng = np.random.default_rng(4)
    arm = rehearsal_arm(planar, rng)
    planted = planted_parameters(arm, standard_effects(planar.joints))
    assert planted.shape == (10 * planar.nv + 4 * planar.nv,)
    Fv, Fc, offset, Ia = planted[-4 * planar.nv :].reshape(4, planar.nv)
    assert (Fv > 0).all()
    assert (Fc > 0).all()
    assert (Ia > 0).all()
    assert (offset != 0).all()
    given = planar.phi.reshape(-1, 10)[:, 0]
    assert (np.abs(planted[: 10 * planar.nv : 10] / given - 1) <= 0.05 + 1e-12).all()
    change = draw_change(planar, rng)
    assert change.effect in ("payload", "viscous_friction", "coulomb_friction")
    after = planted_parameters(changed(arm, change), standard_effects(planar.joints))
    assert not np.allclose(after, planted)
    assert np.allclose(planted_parameters(arm, standard_effects(planar.joints)), planted)


def test_a_seed_is_a_rehearsal(planar: Robot) -> None:
    arms = [rehearsal_arm(planar, np.random.default_rng(seed)) for seed in (1, 1, 2)]
    first, again, other = (planted_parameters(a, standard_effects(planar.joints)) for a in arms)
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


BAD = {
    "a moving start": ("moving.csv", "starts at rest"),
    "no such file": ("nothing.csv", "no such file"),
    "another arm": ("wide.csv", "wide.csv"),
    "too short": ("short.csv", "too short"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_refused_in_one_line(
    name: str, planar: Robot, ur10: Robot, tmp_path: Path, monkeypatch: Any, excitant: Command
) -> None:
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(0)
    fast = from_coefficients(0.2 * rng.uniform(-1, 1, (7, 2)), 5.0)
    short = from_coefficients(
        0.01 * np.array(random_trajectory(planar, rng, 1.0, 3).coefficients), 1.0
    )
    Path("moving.csv").write_text(trajectory_csv(fast), "utf-8")
    Path("short.csv").write_text(trajectory_csv(short), "utf-8")
    Path("wide.csv").write_text(trajectory_csv(random_trajectory(ur10, rng, 5.0, 3)), "utf-8")
    file, evidence = BAD[name]
    status, out, err = excitant(f"rehearse planar_2r {file} -o out")
    assert (status, out) == (1, "")
    assert err.count("\n") == 1
    assert evidence in err
    assert not Path("out").exists()
