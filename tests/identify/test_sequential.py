"""Link by link: Property 4, what recordings show, calibrated values, and as good as all at once."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import scipy.signal
from arms import TrueArm
from known_arms import write_csv
from marks import slow

from excitant.design import random_trajectory
from excitant.identify import Recording, identify_link_by_link, identify_robot, load_dataset
from excitant.identify.faults import check_recordings
from excitant.identify.prior import base_prior
from excitant.identify.rows import split
from excitant.identify.sequential import LinkByLink, beginning, further, link_rows, run_stages
from excitant.robots import Array, Motion, Robot, base_parameters, load_robot
from excitant.robots.base_parameters import last_rows
from excitant.robots.effects import CoulombFriction, standard_effects
from excitant.robots.torque import observation_columns

SIX = ("ur10", "cmu_dd_arm_ii")


def truth_near(robot: Robot, rng: np.random.Generator, spread: float = 0.1) -> TrueArm:
    """Masses, levers and inertias off by up to 10 %."""
    model = robot.model.copy()
    for j in range(1, robot.nv + 1):
        body, (m, c, i) = model.inertias[j], 1 + spread * rng.uniform(-1, 1, 3)
        model.inertias[j] = pin.Inertia(m * body.mass, c * body.lever, i * body.inertia)
    sizes = {"Fv": (0.5, 2), "Fc": (0.5, 2), "offset": (-0.3, 0.3), "Ia": (0.01, 0.1)}
    return TrueArm(model, **{name: rng.uniform(*ends, robot.nv) for name, ends in sizes.items()})


def beta_of(arm: TrueArm, robot: Robot) -> Array:
    base = base_parameters(robot, standard_effects(robot.joints))
    phi = [body.toDynamicParameters() for body in list(arm.model.inertias)[1:]]
    names = (name.rpartition(".") for name in base.names[10 * robot.nv :])
    drives = [getattr(arm, symbol)[robot.joint_index(joint)] for joint, _, symbol in names]
    return base.regrouping @ np.concatenate([*phi, drives])


def recorded(
    robot: Robot, truth: TrueArm, rng: np.random.Generator, name: str = "run", *,
    moving: Sequence[int] | None = None, duration: float = 10.0, share: float = 0.01,
) -> Recording:  # fmt: skip
    """A random motion of some joints, the others held; noise as a share of the torque limits.

    Half as much as is white is correlated over ten samples.
    """
    t = np.arange(0, duration, 0.01)
    path = random_trajectory(robot, rng, duration, 5)
    q, dq, ddq = (np.array(path(t, order)) for order in range(3))
    still = [j for j in range(robot.nv) if moving is not None and j not in moving]
    q[:, still] = rng.uniform(-1.5, 1.5, len(still))
    dq[:, still] = ddq[:, still] = 0.0
    fresh = 0.22 * rng.standard_normal(q.shape)
    noise = scipy.signal.lfilter([1.0], [1.0, -0.9], fresh, axis=0)
    noise += rng.standard_normal(q.shape)
    tau = truth.torque(Motion(t, q, dq, ddq)) + share * torque_size(robot) * noise
    return Recording(name, f"{name}.csv", t, q, tau)


def torque_size(robot: Robot) -> Array:
    return np.where(np.isfinite(robot.limits.torque), robot.limits.torque, 20.0)


@pytest.mark.parametrize("name", ["ur10", "panda", "cmu_dd_arm_ii", "puma560"])
def test_property_4_holds_for_base_columns(name: str) -> None:
    robot = load_robot(name)
    effects = standard_effects(robot.joints)
    base = base_parameters(robot, effects)
    motion = Motion(np.arange(30.0), *robot.random_motion(np.random.default_rng(5), 30))
    W = observation_columns(robot, effects, motion)[:, :, base.columns]
    last = last_rows(robot, effects, base)
    for i in range(robot.nv):
        assert not W[:, i, last < i].any()
        own = W[:, i, last == i]
        assert np.linalg.matrix_rank(own / np.linalg.norm(own, axis=0)) == own.shape[1]


@pytest.mark.slow
def test_covariance_against_monte_carlo(planar: Robot) -> None:
    rng, effects = np.random.default_rng(0), standard_effects(planar.joints)
    base = base_parameters(planar, effects)
    motion = random_trajectory(planar, rng, 10.0, 5).motion(10.0)
    W = observation_columns(planar, effects, motion)[:, :, base.columns]
    prior = base_prior(planar, effects, base)
    true = prior.mean + 0.1 * np.sqrt(np.diag(prior.covariance))
    size, errors, claimed = np.array([0.01, 0.03]), [], []  # the outer joint is the noisier one
    for _ in range(400):
        tau = W @ true + size * rng.standard_normal((len(motion), 2))
        found = beginning(prior)
        for j in (1, 0):
            found, *_ = further(found, W[:, j], tau[:, j])
        assert len(found.c) == len(base)
        errors.append(found.beta - true)
        claimed.append(found.covariance)
    actual, mean = np.cov(np.array(errors).T), np.mean(claimed, axis=0)
    ratio = np.sqrt(np.diag(mean) / np.diag(actual))
    assert 0.9 < ratio.min() <= ratio.max() < 1.2
    spread = scipy.linalg.eigvalsh(actual, mean)  # one where cross terms agree
    assert 0.5 < spread[0] <= spread[-1] < 1.5  # (1 ± √(13 / 400))² for 400 draws of 13 numbers


@pytest.mark.parametrize(("name", "draws"), [slow(name, 6) for name in ("planar_2r", *SIX)])
def test_values_are_within_two_standard_deviations_as_often_as_they_should(name, draws):
    robot, found = load_robot(name), []
    for seed in range(draws):
        rng = np.random.default_rng(seed)
        truth = truth_near(robot, rng)
        runs = [recorded(robot, truth, rng, f"run{k}") for k in range(2)]
        data = split(runs, runs[:1])  # nothing is judged here
        known, stages = run_stages(link_rows(robot, standard_effects(robot.joints), data))
        error = known.c - known.D.T @ np.linalg.solve(known.L, beta_of(truth, robot) - known.mean)
        found.append(np.linalg.solve(np.linalg.cholesky(known.P), error))  # unit variance
        assert len(error) == sum(len(stage.determined) for stage in stages)
    # errors of one draw go together: bounds allow for two standard errors over the draws
    shares = np.array([np.mean(np.abs(errors) < 2) for errors in found])
    squares = np.array([np.mean(errors**2) for errors in found])
    chance = [2 * x.std(ddof=1) / np.sqrt(draws) for x in (shares, squares)]
    assert 0.9 - chance[0] < shares.mean() < 0.99 + chance[0]
    assert 0.85**2 - chance[1] < squares.mean() < 1.25**2 + chance[1]


@pytest.mark.parametrize(
    ("name", "draws", "total"), [slow("planar_2r", 4, 20.0), *(slow(name, 1, 60.0) for name in SIX)]
)
def test_predicts_as_well_as_all_at_once_in_the_same_time(name, draws, total):
    robot, squares = load_robot(name), []
    for seed in range(draws):
        rng = np.random.default_rng(seed)
        truth = truth_near(robot, rng)
        motions = [
            recorded(robot, truth, rng, f"link{n}", moving=range(n), duration=total / robot.nv)
            for n in range(robot.nv, 0, -1)
        ]
        whole = recorded(robot, truth, rng, "whole", duration=total)
        unseen = [recorded(robot, truth, rng, "unseen", share=0.0)]
        stages = identify_link_by_link(robot, motions, validate=unseen).estimate
        at_once = identify_robot(robot, [whole], validate=unseen)
        squares.append([stages.validate.rms**2, at_once.validate.rms**2])
    stages, at_once = np.sqrt(np.mean(squares, axis=0) + (0.01 * torque_size(robot)) ** 2)
    assert (stages < 1.2 * at_once).all()


@pytest.fixture(scope="module")
def literal() -> LinkByLink:
    """The DD arm, one joint moving at a time in one pose."""
    robot, rng = load_robot("cmu_dd_arm_ii"), np.random.default_rng(2)
    truth, how = TrueArm(robot.model, Fc=1.0), {"duration": 8.0, "share": 1e-9}
    runs = [recorded(robot, truth, rng, f"joint{i + 1}", moving=[i], **how) for i in range(6)]
    return identify_link_by_link(robot, runs, effects=[CoulombFriction(robot.joints)])


def test_one_joint_at_a_time_shows_14_combinations(literal: LinkByLink) -> None:
    """Besides the Coulomb friction of each joint."""
    assert [len(stage.determined) - 1 for stage in literal.stages] == [3, 3, 3, 3, 1, 1]
    assert [len(stage.missing) for stage in literal.stages] == [4, 4, 4, 4, 2, 0]
    names = [name.split()[0] for stage in literal.stages for name in stage.recordings]
    assert names == [f"joint{i}" for i in (6, 5, 4, 3, 2, 1)]


def test_what_is_not_shown_stays_at_the_given_robot(literal: LinkByLink) -> None:
    known = literal.cascade
    free = np.eye(len(known.mean)) - known.D @ known.D.T
    assert np.abs(free @ np.linalg.solve(known.L, known.beta - known.mean)).max() < 1e-9
    for stage in literal.stages:
        assert not {each.expression for each in stage.determined} & set(stage.missing)


def test_a_joint_at_rest_may_hold_any_torque(planar: Robot) -> None:
    """Dry friction takes up what motion would not need: its row must not count."""
    rng = np.random.default_rng(3)
    truth = truth_near(planar, rng)
    both = recorded(planar, truth, rng, "both")
    first = recorded(planar, truth, rng, "first", moving=[0])
    held = replace(first, tau=first.tau + np.array([0.0, 5.0]))
    plain, stuck = (identify_link_by_link(planar, [both, run]) for run in (first, held))
    assert np.array_equal(plain.cascade.beta, stuck.cascade.beta)
    counted = [[name.split()[0] for name in stage.recordings] for stage in stuck.stages]
    assert counted == [["both"], ["both", "first"]]
    alone = identify_link_by_link(planar, [first])  # the outer joint never moves
    outer = alone.stages[0]
    assert (outer.determined, outer.rows) == ((), 0)


def test_command_writes_stages(planar, tmp_path, excitant):
    rng = np.random.default_rng(5)
    truth = truth_near(planar, rng)
    files = [write_csv(tmp_path / f"{k}.csv", recorded(planar, truth, rng)) for k in range(2)]
    options = ("--link-by-link", "--json", "-o", tmp_path / "run")
    result = excitant("identify planar_2r", *files, *options).result
    found = result["link_by_link"]
    assert [stage["joint"] for stage in found["stages"]] == [*reversed(planar.joints)]
    assert sum(len(stage["determined"]) for stage in found["stages"]) == 12
    assert [name for stage in found["stages"] for name in stage["missing"]] == ["link2.Iyy"]
    assert all(joint["validate"]["rms"] < joint["baseline"]["rms"] for joint in result["joints"])
    assert ">Link by link<" in (tmp_path / "run" / "report.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_real_joints_moving_one_at_a_time(data_folder: Path) -> None:
    """UR10e: motor currents of single-joint runs, judged on motions of all joints."""
    dataset = load_dataset(data_folder / "ur10e")
    runs = dataset.recordings([f"joint{k}_alone" for k in range(1, 7)])
    unseen = dataset.recordings(["id_12harm_50s", "val_ptp_10_points"])
    found = identify_link_by_link(dataset.robot, runs, validate=unseen)
    assert all(stage.missing for stage in found.stages[:-1])
    rms, given = found.estimate.validate.rms, found.estimate.baseline.rms
    assert (rms < 0.5 * given).all()
    # from the same rows: nothing that rests spoils it
    effects = standard_effects(dataset.robot.joints)
    options = {"effects": effects, "estimator": "wls"}  # which link by link is too
    at_once = identify_robot(dataset.robot, runs, validate=unseen, **options).validate.rms
    print(
        rms,
        at_once,
        identify_robot(dataset.robot, runs, validate=unseen, effects=effects).validate.rms,
    )
    assert (np.abs(rms / at_once - 1) < 0.1).all()


def test_joints_that_move_in_turns_excite_the_arm_together() -> None:
    robot, rng = load_robot("planar_2r"), np.random.default_rng(4)
    truth = truth_near(robot, rng)
    turns = [recorded(robot, truth, rng, f"{j}", moving=[j]) for j in range(2)]
    both = recorded(robot, truth, rng, "both")
    for recordings, poor in ((turns[:1], 1), (turns, 0), ([*turns, both], 0)):
        faults = check_recordings(robot, recordings).faults.values()
        assert [f.fault for mine in faults for f in mine] == ["poor_excitation"] * poor
