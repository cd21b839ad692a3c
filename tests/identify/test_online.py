"""The recursion is weighted least squares; delays match; the monitor speaks when it should."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.linalg

from excitant.exceptions import BadInput
from excitant.identify import LocalPolynomial, Monitor, OnlineEstimator, Recording, identify_online
from excitant.identify.information import InformationFilter, combined, gaussian, information_of
from excitant.identify.online import replayable
from excitant.identify.prior import base_prior
from excitant.robots import Motion, Robot, base_parameters, torque
from excitant.robots.effects import (
    JointEffect,
    Payload,
    TorqueOffset,
    ViscousFriction,
    standard_effects,
)
from excitant.robots.torque import observation_columns

RATE = 250.0
T = np.arange(0, 12, 1 / RATE)
SIGMA = np.array([0.05, 0.02])
DIFFERENTIATOR = LocalPolynomial(5, 4, causal=True)
MotionOf = Callable[..., Motion]
Samples = tuple[np.ndarray, ...]
SMOOTH = (ViscousFriction, TorqueOffset)


def smooth_effects(robot: Robot) -> tuple[JointEffect, ...]:
    """Effects without a jump, so that every block gives a row."""
    return tuple(kind(robot.joints) for kind in SMOOTH)


@pytest.fixture(scope="module")
def noisy(planar: Robot, motion_of: MotionOf) -> Samples:
    """Time, positions and noisy torque."""
    motion = motion_of(planar, T)
    noise = SIGMA * np.random.default_rng(0).standard_normal(motion.q.shape)
    return T, motion.q, torque(planar.with_effects(()), motion) + noise


def estimator(robot: Robot, **options: Any) -> OnlineEstimator:
    settings: dict[str, Any] = {
        "effects": smooth_effects(robot),
        "rate_hz": RATE,
        "differentiator": DIFFERENTIATOR,
        "sigma": SIGMA,
        "prior": False,
    }
    return OnlineEstimator(robot, **(settings | options))


def assert_least_squares(
    online: OnlineEstimator, pieces: Sequence[Samples], memory: float = np.inf
) -> None:
    """The estimate is weighted least squares of the rows of all blocks, made from whole arrays."""
    robot, effects, block = online.robot, online.effects, online.block
    base, m = base_parameters(robot, effects), DIFFERENTIATOR.half_width
    columns, torques = [], []
    for t, q, tau in pieces:
        motion = DIFFERENTIATOR(t, q)
        n = len(motion) // block
        W = observation_columns(robot, effects, motion)[: n * block, :, base.columns]
        columns.append(W.reshape(n, block, robot.nv, -1).mean(axis=1))
        torques.append(tau[m : m + n * block].reshape(n, block, robot.nv).mean(axis=1))
    W, measured = np.concatenate(columns), np.concatenate(torques)
    found = online.estimate()
    assert online.rows == len(W)
    age = (len(W) - 1 - np.arange(len(W))) * block / RATE
    weight = np.exp(-age / memory / 2)[:, None] / (SIGMA * np.sqrt(found.inflation))
    A, b = (W * weight[:, :, None]).reshape(-1, W.shape[2]), (measured * weight).ravel()
    if online.prior is not None:
        A, b = np.vstack([A, online.prior.R]), np.r_[b, online.prior.z]
    beta, covariance = scipy.linalg.lstsq(A, b)[0], np.linalg.inv(A.T @ A)
    np.testing.assert_allclose(found.beta, beta, atol=1e-8 * np.abs(beta).max())
    np.testing.assert_allclose(found.covariance, covariance, atol=1e-7 * np.abs(covariance).max())


@pytest.mark.parametrize(
    ("options", "memory"),
    [
        *(({"block": block}, np.inf) for block in (1, 5, 7)),
        ({"block": 5, "forgetting": 1.5, "prior": None}, 1.5),  # of the data, not of the prior
    ],
)
def test_the_last_estimate_is_weighted_least_squares(
    planar: Robot, noisy: Samples, options: dict[str, Any], memory: float
) -> None:
    online = estimator(planar, **options)
    online.extend(*noisy)
    assert_least_squares(online, [noisy], memory)


def test_a_pause_is_no_motion(planar: Robot, noisy: Samples) -> None:
    online, half = estimator(planar, block=5), len(T) // 2
    first, second = ([x[s] for x in noisy] for s in (slice(half), slice(half, None)))
    second[0] = second[0] + 3.0
    online.extend(*first)
    online.extend(*second)
    assert_least_squares(online, [first, second])


def test_asking_on_the_way_changes_nothing(planar: Robot, noisy: Samples) -> None:
    asked, silent = (estimator(planar, forgetting=2.0) for _ in range(2))
    for k, (t, q, tau) in enumerate(zip(*noisy, strict=True)):
        asked.push(t, q, tau)
        if k > 100 and k % 37 == 0:
            asked.estimate()
    silent.extend(*noisy)
    beta = silent.estimate().beta
    np.testing.assert_allclose(asked.estimate().beta, beta, atol=1e-9 * np.abs(beta).max())


def test_noise_levels_are_learnt_and_intervals_hold(planar: Robot, motion_of: MotionOf) -> None:
    motion, effects = motion_of(planar, T), smooth_effects(planar)
    arm = planar.with_effects([e.with_values(np.full(2, 0.3)) for e in effects])
    true = base_parameters(planar, effects).regrouping @ np.r_[planar.phi, np.full(4, 0.3)]
    exact, z, sigma = torque(arm, motion), [], []
    for seed in range(12):
        noise = SIGMA * np.random.default_rng(seed).standard_normal(motion.q.shape)
        online = estimator(planar, sigma=None, block=2)
        online.extend(T, motion.q, exact + noise)
        found = online.estimate()
        z.append((found.beta - true) / found.std)
        sigma.append(found.sigma * np.sqrt(2))
    # of 18 000 rows: the standard deviation of an rms is 1 / sqrt(36000), 0.5 %
    np.testing.assert_allclose(np.mean(sigma, axis=0), SIGMA, rtol=0.025)
    inside = np.mean(np.abs(z) < 1.96)
    # the parameters of one run are correlated: count the runs as the independent ones
    assert inside > 0.95 - 3 * np.sqrt(0.95 * 0.05 / 12)


@pytest.mark.parametrize("shift", [-1, 0, 1])
def test_torque_and_regressor_speak_of_one_instant(
    planar: Robot, motion_of: MotionOf, shift: int
) -> None:
    motion = motion_of(planar, T)
    online = estimator(planar, effects=(), sigma=np.ones(2))
    exact = torque(planar.with_effects(()), motion)
    online.extend(T, motion.q, np.roll(exact, shift, axis=0))
    rows = online.recent()
    inner = rows.tau[5:-5] - (rows.W @ online.estimate().beta)[5:-5]
    error = np.sqrt((inner**2).mean()) / exact.std()
    # quartic through 11 samples at 250 Hz: second derivative of a 1.3 Hz sine is off by 1e-6;
    # a sample too late is off by about ω h = 1.3 · 2π / 250 = 3 %, of which the fit hides some
    assert error < 1e-5 if shift == 0 else error > 1e-3
    assert online.delay == pytest.approx(DIFFERENTIATOR.half_width / RATE)
    m, block = DIFFERENTIATOR.half_width, online.block
    last = m + (len(T) - 2 * m) // block * block - 1  # sample in the middle of the last window
    assert rows.motion.t[-1] == pytest.approx(T[last] - (block - 1) / 2 / RATE)


def test_a_joint_at_rest_gives_no_row_where_friction_is_dry(
    planar: Robot, motion_of: MotionOf
) -> None:
    motion = motion_of(planar, T)
    q = np.array(motion.q)
    q[:, 1] = q[0, 1]
    held = torque(planar, Motion(T, q, motion.dq * [1, 0], motion.ddq * [1, 0]))
    online = OnlineEstimator(planar, rate_hz=RATE, sigma=SIGMA)
    online.extend(T, q, held)
    used = online.recent().used
    assert not used[:, 1].any()
    assert 0.5 < used[:, 0].mean() < 1.0  # all but the blocks in which it turns back


def test_what_was_known_is_kept_when_nothing_moves(planar: Robot, motion_of: MotionOf) -> None:
    motion = motion_of(planar, T)
    online = estimator(planar, forgetting=0.2, prior=None)
    online.extend(T, motion.q, torque(planar, motion))
    learnt = online.estimate()
    t = T[-1] + 1 / RATE + T
    still = Motion(t, np.tile(motion.q[-1], (len(t), 1)), 0 * motion.q, 0 * motion.q)
    online.extend(t, still.q, torque(planar, still))
    rest = online.estimate()
    spread = np.sqrt(np.diag(base_prior(planar, online.effects, online.base).covariance))
    assert (rest.std <= spread * (1 + 1e-6)).all()
    assert np.median(rest.std / spread) > 0.5 > np.median(learnt.std / spread)


def test_rows_in_any_grouping_make_one_triangle() -> None:
    rng = np.random.default_rng(0)
    A, b = rng.standard_normal((40, 6)), rng.standard_normal(40)
    columns = np.array([1, 2, 4])
    grown = InformationFilter(columns, 6)
    for rows in np.split(np.column_stack([A[:, columns], b]), [1, 2, 9, 30]):
        grown.update(rows)
    found = grown.information()
    x = rng.standard_normal(6)
    expected = np.sum((A[:, columns] @ x[columns] - b) ** 2)
    assert found.squares(x) == pytest.approx(expected, rel=1e-12)
    whole = information_of(A, b)
    halves = combined([information_of(A[:15], b[:15]), information_of(A[15:], b[15:])])
    np.testing.assert_allclose(whole.solve(), halves.solve(), rtol=1e-12)
    P = whole.covariance()
    again = gaussian(whole.solve(), P)
    np.testing.assert_allclose(again.solve(), whole.solve(), rtol=1e-10)
    np.testing.assert_allclose(again.R.T @ again.R, whole.R.T @ whole.R, rtol=1e-9)


class Remembering(ViscousFriction):
    """Torque by the velocity one sample earlier."""

    def of_state(self, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> tuple[np.ndarray]:
        return (np.roll(dq, 1),)


def test_what_cannot_be_is_refused(planar: Robot) -> None:
    online = estimator(planar)
    with pytest.raises(BadInput, match="no row yet"):
        online.estimate()
    online.push(0.0, np.zeros(2), np.zeros(2))
    with pytest.raises(BadInput, match="goes back"):
        online.push(0.0, np.zeros(2), np.zeros(2))
    with pytest.raises(BadInput, match="is not a number"):
        online.extend(T[1:100], np.full((99, 2), np.nan), np.zeros((99, 2)))
    refused: dict[str, dict[str, Any]] = {
        "must be causal": {"differentiator": LocalPolynomial(5, 4)},
        "at least 1": {"block": 0},
        "longer time constant": {"forgetting": 1e-3},
        "depends on the past": {"effects": (Remembering(planar.joints),)},
    }
    for why, options in refused.items():
        with pytest.raises(BadInput, match=why):
            estimator(planar, **options)


def watched(robot: Robot, motion: Motion) -> Monitor:
    """A monitor after a motion that it looked at twice a second."""
    noise = 0.02 * np.random.default_rng(1).standard_normal(motion.q.shape)
    tau = torque(robot, motion) + noise
    online = OnlineEstimator(robot, rate_hz=RATE, sigma=np.full(2, 0.02))
    prior = base_prior(robot, online.effects, online.base)
    monitor = Monitor(online, prior, window=4.0)
    for k in range(len(motion)):
        online.push(float(motion.t[k]), motion.q[k], tau[k])
        if k > 50 and k % 125 == 0:
            monitor.look()
    return monitor


def test_the_monitor_is_silent_on_an_exciting_motion(planar: Robot, motion_of: MotionOf) -> None:
    monitor = watched(planar, motion_of(planar, T))
    assert not [text for _, text in monitor.messages if "not exciting" in text]
    assert [text for _, text in monitor.messages if text.startswith("converged")]
    assert monitor.look().converged


def test_the_monitor_says_since_when_and_which_joint(planar: Robot, motion_of: MotionOf) -> None:
    motion = motion_of(planar, T)
    stop = 6.0
    orders = [np.array(x) for x in (motion.q, motion.dq, motion.ddq)]
    late = stop < T
    orders[0][late, 1] = orders[0][~late][-1, 1]
    orders[1][late, 1] = orders[2][late, 1] = 0.0
    monitor = watched(planar, Motion(T, *orders))
    speaking = [(t, text) for t, text in monitor.messages if "not exciting" in text]
    assert len(speaking) == 1
    t, text = speaking[0]
    since = float(text.split("since ")[1].split(" s")[0])
    # a window of 4 s that still holds some of the motion may be enough; one without it is not
    assert stop - 4.0 <= since <= stop + 0.5
    assert stop < t <= stop + 4.6
    assert text.endswith("move joint2")


def test_a_recording_plays_through(planar: Robot, motion_of: MotionOf) -> None:
    motion = motion_of(planar, T)
    rng = np.random.default_rng(4)
    tau = torque(planar, motion) + 0.02 * rng.standard_normal(motion.q.shape)
    recording = Recording("run", "run.csv", T, motion.q, tau)
    found = identify_online(planar, [recording])
    result = found.result()
    assert (found.estimate.validate.r2 > 0.99).all()
    history = result["online"]["history"]
    r = len(found.estimate.base)
    assert len(history["t"]) == len(history["value"]) == len(history["std"]) >= 10
    assert len(history["value"][0]) == len(result["base_parameters"]) == r
    assert np.all(np.diff(history["t"]) > 0)
    first, last = (np.array(history["std"][k]) for k in (0, -1))
    assert (last <= first * (1 + 1e-9)).mean() > 0.9
    assert result["physical"]["consistent"]


def test_irregular_time_gives_what_regular_time_gives(planar: Robot, motion_of: MotionOf) -> None:
    effects, rng, betas = standard_effects(planar.joints), np.random.default_rng(4), []
    base = base_parameters(planar, effects)
    for t in (T, T + rng.uniform(-0.3, 0.3, len(T)) / RATE):
        motion = motion_of(planar, t)
        recording = Recording("r", "r.csv", t, motion.q, torque(planar, motion))
        online, samples, _ = replayable(planar, [recording], effects, base, gains=np.ones(2))
        online.extend(*samples)
        betas.append(online.estimate().beta)
    motion = motion_of(planar, T)
    W = observation_columns(planar, effects, motion)[:, :, base.columns]
    smooth = torque(planar.with_effects(()), motion)
    # torque is interpolated linearly: off by h² / 8 times its second derivative
    curvature = np.abs(np.diff(smooth, 2, axis=0)).max() * RATE**2
    allowed = (1.6 / RATE) ** 2 / 8 * curvature
    assert np.abs(W @ (betas[0] - betas[1])).max() < 4 * allowed


LOAD = np.array([1.0, 0.2, 0.0, 0.0, 0.01, 0.0, 0.055, 0.0, 0.0, 0.055])


@pytest.fixture(scope="module")
def folder(planar: Robot, motion_of: MotionOf, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The planar arm recorded without and with a load."""
    folder, rng = tmp_path_factory.mktemp("recordings"), np.random.default_rng(0)
    motion = motion_of(planar, T)
    load = Payload(planar.joints[-1:]).with_values(LOAD)
    for name, effects in (("free", ()), ("held", (load,))):
        tau = torque(planar.with_effects([*planar.effects, *effects]), motion)
        noise = 0.02 * rng.standard_normal(tau.shape)
        columns = np.column_stack([T, motion.q, tau + noise])
        header = "t,q1,q2,tau1,tau2"
        np.savetxt(folder / f"{name}.csv", columns, delimiter=",", header=header, comments="")
    return folder


def test_online_writes_estimates_over_time(
    folder: Path, tmp_path: Path, excitant: Callable[..., Any]
) -> None:
    # the given model is the true one here
    options = ("--online", "--forgetting", 20, "--force", "--json", "-o", tmp_path)
    ran = excitant("identify planar_2r", folder / "free.csv", *options)
    assert ran.status == 0
    online = ran.result["online"]
    assert {"messages", "history", "converged", "delay_s", "differentiator"} <= online.keys()
    assert all(joint["validate"]["r2"] > 0.98 for joint in ran.result["joints"])
    last = online["history"]["value"][-1]
    assert last == [entry["value"] for entry in ran.result["base_parameters"]]
    for name in ("series.npz", "summary.txt", "report.html", "model.yaml"):
        assert (tmp_path / name).is_file()


def test_payload_against_the_unloaded_arm(
    folder: Path, tmp_path: Path, excitant: Callable[..., Any]
) -> None:
    options = ("--payload", "--unloaded", folder / "free.csv", "--json", "-o", tmp_path)
    ran = excitant("identify planar_2r", folder / "held.csv", *options)
    values = {p["name"]: p for p in ran.result["payload"]["parameters"]}
    # two parallel axes show what is felt in their plane
    for name, true in (("mcx", 0.2), ("mcz", 0.0)):
        assert abs(values[name]["value"] - true) < 4 * values[name]["std"], name
    assert values["mcx"]["value"] == pytest.approx(0.2, rel=0.1)
