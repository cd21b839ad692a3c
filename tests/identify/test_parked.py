"""A joint that stands throughout: held where it was recorded, or refused in one line."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from known_arms import smooth_motion
from marks import refused, slow
from urdf_arms import urdf_of

import excitant as ex
from excitant.api import as_recorded
from excitant.exceptions import BadRecording
from excitant.identify import Recording
from excitant.identify.faults import find_faults
from excitant.robots import Motion, load_robot, torque
from excitant.robots.effects import Payload, ViscousFriction

BODY = {"mass": 3, "inertia": 0.04, "axis": "0 1 0"}
JOINTS = (BODY, BODY | {"kind": "prismatic", "axis": "0 0 1"}, BODY)
NAMES = ("joint1", "joint2", "joint3")
Save = Callable[..., pd.DataFrame]


@pytest.fixture
def save(here: Path) -> Save:
    """``save(file, {joint: position})``: an arm, and a log of it in which some joints stand."""
    Path("arm.urdf").write_text(urdf_of(*JOINTS), encoding="utf-8")

    def saved(file: str, stands: dict[int, float], seed: int = 0, noise: float = 0) -> pd.DataFrame:
        robot, rng = load_robot("arm.urdf"), np.random.default_rng(seed)
        t = np.arange(800) / 100
        moving = smooth_motion(robot, t, seed)
        q, dq, ddq = (np.array(x) for x in (moving.q, moving.dq, moving.ddq))
        q[:, [*stands]], dq[:, [*stands]], ddq[:, [*stands]] = [*stands.values()], 0, 0
        friction = [ViscousFriction(robot.joints, (2.0, 3.0, 1.0))]
        tau = torque(robot.with_effects(friction), Motion(t, q, dq, ddq))
        tau += rng.normal(size=tau.shape)  # as no model would compute it
        q = q + noise * rng.normal(size=q.shape)
        speeds = dq + noise * rng.normal(size=q.shape) if noise else None
        table = Recording("run", file, t, q, tau, dq=speeds).to_frame()
        table.to_csv(file, index=False)
        return table

    return saved


@pytest.mark.parametrize("joint", [1, slow(2)])
@pytest.mark.parametrize("noise", [slow(0.0), 2e-3])
@pytest.mark.parametrize("chosen", [False, True])
def test_it_is_held_where_it_was_recorded(save: Save, joint: int, noise: float, chosen: bool):
    save("run1.csv", {joint: 0.4}, noise=noise)
    name, others = NAMES[joint], [each for each in NAMES if each != NAMES[joint]]
    arm = load_robot("arm.urdf", joints=others if chosen else None)
    rubbing = ViscousFriction(arm.joints, tuple(map(float, range(arm.nv))))
    body = [] if chosen else [Payload((name,), (1.5, *9 * (0.0,)))]
    parked, [run], [] = as_recorded(arm.with_effects([rubbing, *body]), "run1.csv")
    assert run.columns == ("t", *(c + n[-1] for c in ("q", "tau") for n in others))
    at = {name: pytest.approx(0.4, abs=1e-3)}
    assert (list(parked.robot.joints), dict(parked.robot.locked)) == (others, at)
    where = f"{parked.positions[name]:.4g} {'m' if joint == 1 else 'rad'}"
    said = f"held at {where}, as it does not move in run1.csv: {name}"
    assert parked.notes == (said,)
    same = load_robot("arm.urdf", lock=parked.positions)
    carried = len(body) * 1.5 * (np.arange(20) == 10 * (joint - 1))
    np.testing.assert_allclose((parked.robot.phi - same.phi)[::10], carried[::10], atol=1e-12)
    Path("held.urdf").write_text(parked.robot.urdf, encoding="utf-8")
    np.testing.assert_allclose(load_robot("held.urdf").phi, parked.robot.phi, atol=1e-9)
    [kept] = parked.robot.effects
    own = (0.0, 1.0) if chosen else tuple(float(arm.joint_index(each)) for each in others)
    assert kept == ViscousFriction(tuple(others), own)
    found = ex.identify_robot(arm, "run1.csv", effects=["viscous_friction"])
    assert found.notes[0] == said
    again, [_], [] = as_recorded(found.model, "run1.csv")
    assert again.robot.joints == parked.robot.joints


@pytest.mark.slow
def test_every_verb_has_the_same_arm_and_says_so(save: Save, excitant: Any) -> None:
    save("run1.csv", {2: 0.4})
    note = "held at 0.4 rad, as it does not move in run1.csv: joint3"
    results = [
        excitant(f"{verb} run1.csv --json {more} -o out")
        for verb in ("identify arm.urdf", "diagnose arm.urdf")
        for more in ("", "--joints joint1,joint2", "--repair")
    ]
    results += [excitant("go arm.urdf run1.csv --json -o out")]
    analyze = "analyze arm.urdf --recording run1.csv --json -o out"
    # which says what would show a joint that stands
    assert excitant(analyze).result["resting_joints"] == ["joint3"]
    results += [excitant(f"{analyze} --joints joint1,joint2")]
    assert all(note in ran.err and note in ran.result["notes"] for ran in results)
    given, chosen = (results[k].result["base_parameters"] for k in (0, 1))
    assert given == chosen
    assert excitant("identify arm.urdf run1.csv --lock joint3=0.4 -o out").status == 0


@pytest.mark.parametrize(
    ("fitted", "others", "options", "why"),
    [
        ([{2: 0.4}], [{}], {}, "joint3 goes from .* but stands at 0.4 rad in what is fitted"),
        ([{2: 0.4}], [{2: 0.5}], {}, "joint3 goes from 0.5 to 0.5 here, but stands at 0.4 rad"),
        ([{0: 0, 1: 0.1, 2: 0.2}], [], {}, "no joint moves"),
        ([{}], [], {"joints": ["joint1", "joint2"]}, "joint3 is not chosen, .*--lock joint3=Q"),
        ([{}], [], {"joints": ["joint1", "joint2"], "lock": {"joint3": 0.4}}, ""),
        ([{2: 0.4}, {}], [], {}, ""),
    ],
)
def test_what_moves_elsewhere(save: Save, fitted: Any, others: Any, options: Any, why: str) -> None:
    for k, stands in enumerate((*fitted, *others)):
        save(f"{k}.csv", stands, seed=k)
    files = [f"{k}.csv" for k in range(len(fitted) + len(others))]
    given = load_robot("arm.urdf", **options)
    sets = (files[: len(fitted)], files[len(fitted) :])
    if why:
        refused(why, as_recorded, given, *sets, error=BadRecording)
    else:
        parked, _, _ = as_recorded(given, *sets)
        assert (parked.robot.joints, parked.notes) == (given.joints, ())


def test_it_is_not_held_in_two_places_nor_where_its_channel_is_dead(save: Save) -> None:
    moving = save("m.csv", {}, noise=1e-4)
    one, two = (save(f"{q}.csv", {2: q}, seed=k) for k, q in enumerate((0.4, -0.2)))
    parked, _, _ = as_recorded("arm.urdf", [one, two])
    assert parked.robot.joints == NAMES
    assert "joint3 stands at 0.4 rad in table 1, at -0.2 rad in table 2" in parked.notes[0]
    assert as_recorded("arm.urdf", moving.assign(q3=0.4))[0].robot.joints == NAMES
    coarse = two.assign(dq3=-0.007)  # half a step of a register that has no zero
    assert as_recorded("arm.urdf", coarse)[0].robot.joints == NAMES[:2]
    parked, [run], [] = as_recorded("arm.urdf", one.assign(tau3=0.0))
    assert (parked.robot.joints, run.nv) == (NAMES[:2], 2)


def test_other_branches_and_changed_arms(save: Save) -> None:
    log = save("m.csv", {})
    tree = (BODY, JOINTS[1] | {"parent": 0}, BODY)
    Path("arm.urdf").write_text(urdf_of(*tree), encoding="utf-8")
    parked, [run], [] = as_recorded(load_robot("arm.urdf", joints=["joint1"]), log)
    assert (parked.robot.joints, run.nv) == (("joint1",), 1)
    stands = log.assign(q3=0.4)
    chosen = load_robot("arm.urdf", joints=["joint2"])
    with pytest.raises(BadRecording, match=r"the model was changed with .*joint3 at 0 rad"):
        as_recorded(chosen.with_parameters(2 * chosen.phi), stands)


def test_a_wrong_sign_beside_it_is_told_without_a_map(save: Save) -> None:
    log = save("run.csv", {2: 0.4}, noise=1e-4)
    log.assign(dq1=-log.dq1).to_csv("run.csv", index=False)
    parked, [run], [] = as_recorded("arm.urdf", "run.csv")
    [fault] = find_faults(parked.robot, run)
    assert (fault.fault, fault.joints, fault.map) == ("wrong_sign", ("joint1",), None)
