"""The recursion is weighted least squares; delays match; the monitor speaks when it should."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.linalg
from known_arms import Call, smooth_motion, write_csv
from marks import refused

from excitant.exceptions import BadInput
from excitant.identify import LocalPolynomial, Monitor, OnlineEstimator, Recording
from excitant.identify.information import InformationFilter
from excitant.identify.online import replayable
from excitant.identify.prior import base_prior
from excitant.robots import Motion, Robot, base_parameters, load_robot, torque
from excitant.robots.effects import TimeDelay, TorqueOffset, ViscousFriction, standard_effects
from excitant.robots.torque import observation_columns

RATE = 250.0
T = np.arange(0, 12, 1 / RATE)
SIGMA = np.array([0.05, 0.02])
DIFFERENTIATOR = LocalPolynomial(5, 4)
MOTION = smooth_motion(load_robot("planar_2r"), T)


def estimator(robot: Robot, **options: Any) -> OnlineEstimator:
    """Of effects without a jump, so that every block gives a row."""
    effects = tuple(kind(robot.joints) for kind in (ViscousFriction, TorqueOffset))
    usual = {"rate_hz": RATE, "differentiator": DIFFERENTIATOR, "sigma": SIGMA, "prior": False}
    return OnlineEstimator(robot, **({"effects": effects} | usual | options))


def noisy(robot: Robot, motion: Motion, sigma: Any, seed: int = 0) -> np.ndarray:
    noise = sigma * np.random.default_rng(seed).standard_normal(motion.q.shape)
    return torque(robot, motion) + noise


FORGETTING = {"block": 5, "forgetting": 1.5, "prior": None}  # of the data, not of the prior


@pytest.mark.parametrize("options", [{"block": 1}, {"block": 5}, {"block": 7}, FORGETTING])
def test_the_last_estimate_is_weighted_least_squares(planar, options):
    """Of the rows of all blocks, made from whole arrays; a pause is no motion."""
    tau, half = noisy(planar.with_effects(()), MOTION, SIGMA), len(T) // 2
    online, m = estimator(planar, **options), DIFFERENTIATOR.half_width
    block, columns, torques = online.block, [], []
    for late, part in enumerate((slice(half), slice(half, None))):
        t, q, measured = T[part] + 3.0 * late, MOTION.q[part], tau[part]
        for k in range(len(t)):
            online.push(t[k], q[k], measured[k])
            if k > 100 and k % 101 == 0:  # asking on the way changes nothing
                online.estimate()
        windows = np.lib.stride_tricks.sliding_window_view(q, 2 * m + 1, axis=0)
        derivatives = [windows @ DIFFERENTIATOR.kernel(order) * RATE**order for order in range(3)]
        known = Motion(t[m:-m], *derivatives)
        n = len(known) // block
        W = observation_columns(planar, online.effects, known)[: n * block, :, online.base.columns]
        columns.append(W.reshape(n, block, planar.nv, -1).mean(axis=1))
        torques.append(measured[m : m + n * block].reshape(n, block, planar.nv).mean(axis=1))
    W, measured = np.concatenate(columns), np.concatenate(torques)
    found = online.estimate()
    assert online.rows == len(W)
    age = (len(W) - 1 - np.arange(len(W))) * block / RATE
    weight = np.exp(-age / options.get("forgetting", np.inf) / 2)[:, None]
    weight = weight / (SIGMA * np.sqrt(found.inflation))
    A, b = (W * weight[:, :, None]).reshape(-1, W.shape[2]), (measured * weight).ravel()
    if online.prior is not None:
        A, b = np.vstack([A, online.prior.R]), np.r_[b, online.prior.z]
    beta, covariance = scipy.linalg.lstsq(A, b)[0], np.linalg.inv(A.T @ A)
    np.testing.assert_allclose(found.beta, beta, atol=1e-8 * np.abs(beta).max())
    np.testing.assert_allclose(found.covariance, covariance, atol=1e-7 * np.abs(covariance).max())


def test_no_sample_takes_rows_of_more_than_one_joint(planar: Robot, monkeypatch: Any) -> None:
    """So that the slowest costs little more than the others (`benchmarks/payload.py`)."""
    taken, take = [0], InformationFilter.take

    def counted(self: InformationFilter) -> None:
        taken[0] += self.waiting > 0
        take(self)

    monkeypatch.setattr(InformationFilter, "take", counted)
    online, most = estimator(planar, block=5), 0
    for k in range(1000):
        before = taken[0]
        online.push(T[k], MOTION.q[k], MOTION.q[k])
        most = max(most, taken[0] - before)
    assert most == 1
    assert taken[0] < online.rows  # several rows of a joint at once


@pytest.mark.slow
def test_noise_levels_are_learnt_and_intervals_hold(planar: Robot) -> None:
    effects, z, sigma = estimator(planar).effects, [], []
    arm = planar.with_effects([e.with_values(np.full(2, 0.3)) for e in effects])
    true = base_parameters(planar, effects).regrouping @ np.r_[planar.phi, np.full(4, 0.3)]
    for seed in range(20):
        online = estimator(planar, sigma=None, block=10)
        online.extend(T, MOTION.q, noisy(arm, MOTION, SIGMA, seed))
        found = online.estimate()
        z.append((found.beta - true) / found.std)
        sigma.append(found.sigma * np.sqrt(10))
    # of 6 000 rows: the standard deviation of an rms is 1 / sqrt(12000), 0.9 %
    np.testing.assert_allclose(np.mean(sigma, axis=0), SIGMA, rtol=0.025)
    inside = np.mean(np.abs(z) < 1.96)
    # the parameters of one run are correlated: count the runs as the independent ones
    assert inside > 0.95 - 3 * np.sqrt(0.95 * 0.05 / 20)


def test_measured_velocity_spares_the_noise_of_positions(planar: Robot) -> None:
    """Intervals hold with it; positions that coarse spoil the estimate without it."""
    effects, rng = estimator(planar).effects, np.random.default_rng(4)
    arm = planar.with_effects([e.with_values(np.full(2, 0.3)) for e in effects])
    true = base_parameters(planar, effects).regrouping @ np.r_[planar.phi, np.full(4, 0.3)]
    q = MOTION.q + 1e-3 * rng.standard_normal(MOTION.q.shape)
    dq = MOTION.dq + 1e-3 * rng.standard_normal(q.shape)
    off = []
    for speeds in (dq, None):
        online = estimator(planar, sigma=None, block=10)
        online.extend(T, q, noisy(arm, MOTION, SIGMA), speeds)
        found = online.estimate()
        off.append((np.abs(found.beta - true) / found.std).max())
    assert off[0] < 3.5 < 4.5 < off[1]


def test_rows_that_the_fit_can_follow_all_say_nothing_of_their_noise(planar: Robot) -> None:
    tau = noisy(planar.with_effects(()), MOTION, SIGMA)
    online = estimator(planar, sigma=None, block=1)
    online.extend(T[:13], MOTION.q[:13], tau[:13])  # three rows of each joint
    assert (online.estimate().sigma > 0.5 * SIGMA).all()


@pytest.mark.parametrize("shift", [-1, 0, 1])
def test_torque_and_regressor_are_of_one_instant(planar: Robot, shift: int) -> None:
    online = estimator(planar, effects=(), sigma=np.ones(2))
    exact = torque(planar.with_effects(()), MOTION)
    online.extend(T, MOTION.q, np.roll(exact, shift, axis=0))
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


def stopping(motion: Motion, since: float = 0.0) -> Motion:
    """The motion, the second joint at rest from an instant on."""
    moves = np.column_stack([np.ones(len(T)), since > T])
    last = motion.q[np.searchsorted(T, since)]
    return Motion(T, np.where(moves, motion.q, last), motion.dq * moves, motion.ddq * moves)


def test_a_joint_at_rest_gives_no_row_where_friction_is_dry(planar: Robot) -> None:
    held = stopping(MOTION)
    online = OnlineEstimator(planar, rate_hz=RATE, sigma=SIGMA)
    online.extend(T, held.q, torque(planar, held))
    used = online.recent().used
    assert not used[:, 1].any()
    assert 0.5 < used[:, 0].mean() < 1.0  # all but the blocks in which it turns back


def test_what_cannot_be_is_refused(planar: Robot) -> None:
    online = estimator(planar)
    refused("no row yet", online.estimate, error=BadInput)
    online.push(0.0, np.zeros(2), np.zeros(2))
    refused("goes back", online.push, 0.0, np.zeros(2), np.zeros(2), error=BadInput)
    with pytest.raises(BadInput, match="is not a number"):
        online.extend(T[1:100], np.full((99, 2), np.nan), np.zeros((99, 2)))
    for why, option, value in (
        ("at least 1", "block", 0),
        ("longer time constant", "forgetting", 1e-3),
        ("depends on the past", "effects", (TimeDelay(planar.joints),)),
    ):
        refused(why, estimator, planar, **{option: value}, error=BadInput)


def test_the_monitor_says_since_when_and_which_joint(planar: Robot) -> None:
    stop = 6.0
    known = stopping(MOTION, stop)
    tau = noisy(planar, known, 0.02, 1)
    online = OnlineEstimator(planar, rate_hz=RATE, sigma=np.full(2, 0.02))
    monitor = Monitor(online, base_prior(planar, online.effects, online.base), window=4.0)
    for k in range(len(T)):
        online.push(T[k], known.q[k], tau[k])
        if k > 50 and k % 125 == 0:
            monitor.look()
    [(t, text)] = [each for each in monitor.messages if "not exciting" in each[1]]
    since = float(text.split("since ")[1].split(" s")[0])
    # a window of 4 s that still holds some of the motion may be enough; one without it is not
    assert stop - 4.0 <= since <= stop + 0.5
    assert stop < t <= stop + 4.6
    assert text.endswith("move joint2")


def test_irregular_time_gives_what_regular_time_gives(planar: Robot) -> None:
    effects, rng, betas = standard_effects(planar.joints), np.random.default_rng(4), []
    base = base_parameters(planar, effects)
    for t in (T, T + rng.uniform(-0.3, 0.3, len(T)) / RATE):
        moved = smooth_motion(planar, t)
        recording = Recording("r", "r.csv", t, moved.q, torque(planar, moved))
        online, samples, _ = replayable(planar, [recording], effects, base, gains=np.ones(2))
        online.extend(*samples)
        betas.append(online.estimate().beta)
    W = observation_columns(planar, effects, MOTION)[:, :, base.columns]
    smooth = torque(planar.with_effects(()), MOTION)
    # torque is interpolated linearly: off by h² / 8 times its second derivative
    curvature = np.abs(np.diff(smooth, 2, axis=0)).max() * RATE**2
    allowed = (1.6 / RATE) ** 2 / 8 * curvature
    assert np.abs(W @ (betas[0] - betas[1])).max() < 4 * allowed


def test_online_writes_estimates_over_time(planar: Robot, tmp_path: Path, excitant: Call) -> None:
    run = Recording("run", "run.csv", T, MOTION.q, noisy(planar, MOTION, 0.02))
    file = write_csv(tmp_path / "run.csv", run)
    # the given model is the true one here
    options = ("--online", "--forgetting", 20, "--force", "--json", "-o", tmp_path)
    ran = excitant("identify planar_2r", file, *options)
    assert all(joint["validate"]["r2"] > 0.99 for joint in ran.result["joints"])
    assert ran.result["physical"]["consistent"]
    online, base = ran.result["online"], ran.result["base_parameters"]
    assert {"delay_s", "differentiator"} <= online.keys()
    assert online["converged"]
    assert [m["text"].partition(":")[0] for m in online["messages"]] == ["converged"]
    with np.load(tmp_path / "series.npz") as series:
        t, value, std = (series[f"online_{key}"] for key in ("t", "value", "std"))
    assert online["history"]["t"] == t.tolist()
    assert value.shape == std.shape == (len(t), len(base))
    assert len(t) >= 10
    assert (np.diff(t) > 0).all()
    assert (std[-1] <= std[0] * (1 + 1e-9)).mean() > 0.9
    np.testing.assert_allclose(value[-1], [entry["value"] for entry in base], rtol=1e-5)
    written = {path.name for path in tmp_path.iterdir()}
    assert written >= {"series.npz", "summary.txt", "report.html", "model.yaml"}
