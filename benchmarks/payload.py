"""On-line payload of the CMU DD Arm II: cost per sample, and whether its intervals are honest."""

import gc
import time
from collections.abc import Sequence
from typing import NamedTuple

import common
import numpy as np
import pandas as pd
import pinocchio as pin
from dd_arm import STEP_S, fitted, simulated
from scipy.stats import binom
from seed import dd_arm

from excitant.identify import OnlineEstimator, PayloadEstimator, Recording
from excitant.identify.differentiators import causal_polynomial, position_spectrum
from excitant.identify.estimate import judged
from excitant.identify.least_squares import weighted_least_squares
from excitant.identify.physical import fit_physical
from excitant.identify.prior import prior_parameters
from excitant.robots import Robot
from excitant.robots.effects import standard_effects

MASS, CENTRE, RADIUS = (0.3, 2.0), 0.05, 0.03  # kg; m off the last axis and along it; m
ASKED = (1.0, 2.0, 5.0, 10.0)  # s with the load
GOAL, LEVEL = 0.02, 1.96  # of the mass; standard deviations of a 95 % interval


class Run(NamedTuple):
    """A payload and its estimates after each of `ASKED`, shape (4,) and (4, 3) for the centre."""

    mass: float
    centre: np.ndarray
    found: np.ndarray
    std: np.ndarray
    found_centre: np.ndarray
    centre_std: np.ndarray


def cost(recording: Recording, replays: int) -> str:
    """Processor time of `OnlineEstimator.push`, friction, offset and rotor inertia estimated too.

    Of each sample the least of the replays.
    """
    taken, robot = np.empty((replays, len(recording.t))), dd_arm("initial")
    choice = causal_polynomial(position_spectrum(recording.t, recording.q)).differentiator
    for replay in taken:
        estimator = OnlineEstimator(robot, rate_hz=1 / STEP_S, differentiator=choice)
        gc.collect()
        gc.disable()  # as a control loop does
        for k, sample in enumerate(zip(recording.t, recording.q, recording.tau, strict=True)):
            start = time.thread_time_ns()
            estimator.push(*sample)
            replay[k] = (time.thread_time_ns() - start) / 1e3
        gc.enable()
    least = taken.min(axis=0)
    return (
        f"cost per sample, {len(estimator.base)} parameters at {1 / STEP_S:.0f} Hz: "
        f"mean {least.mean():.0f} µs, median {np.median(least):.0f} µs, "
        f"worst {least.max():.0f} µs (of any replay {taken.max():.0f} µs)"
    )


def loaded_arm(truth: Robot, rng: np.random.Generator) -> tuple[Robot, float, np.ndarray]:
    """The arm with a payload of random mass and centre on its last link."""
    mass, centre = rng.uniform(*MASS), rng.uniform(-CENTRE, CENTRE, 3) + np.array([0, 0, CENTRE])
    body = pin.Inertia(mass, centre, mass * RADIUS**2 * np.eye(3)).toDynamicParameters()
    return truth.with_parameters(truth.phi + np.pad(body, (len(truth.phi) - 10, 0))), mass, centre


def identified(recordings: Sequence[Recording]) -> Robot:
    """The model of `identify_robot` with its covariance, without a search for faults."""
    given = dd_arm("initial")
    rows = fitted(given, recordings, standard_effects(given.joints))
    fit = weighted_least_squares(rows.reduced)
    physical = fit_physical(
        *rows.regression.factor(fit.weight), prior_parameters(given), rows.open_prior
    )
    return judged(given, rows, fit, physical, ()).model


def run(seed: int) -> Run:
    rng, truth = np.random.default_rng(seed), dd_arm("estimated", likely=True)
    free = simulated(truth, rng, 20.0)
    arm, positions = identified(free), position_spectrum(free[0].t, free[0].q)
    carrying, mass, centre = loaded_arm(truth, rng)
    [recording] = simulated(carrying, rng, 10.0)
    payload = PayloadEstimator(
        arm,
        rate_hz=1 / STEP_S,
        differentiator=causal_polynomial(positions).differentiator,
        position_noise=positions.noise,
    )
    due, seen = list(ASKED), []
    for t, q, tau in zip(recording.t, recording.q, recording.tau, strict=True):
        payload.push(float(t), q, tau)
        if due and t >= due[0] - 1.5 * STEP_S:
            last = payload.estimate()
            seen.append((last.mass, last.std[0], last.centre, last.centre_std))
            del due[0]
    return Run(mass, centre, *map(np.array, zip(*seen, strict=True)))


def table(runs: Sequence[Run]) -> pd.DataFrame:
    """Errors, intervals and how often these hold the truth, by time with the load."""
    relative = np.array([r.found / r.mass - 1 for r in runs])
    z = np.array([(r.found - r.mass) / r.std for r in runs])
    z_centre = np.array([(r.found_centre - r.centre) / r.centre_std for r in runs])
    offset = np.array([np.linalg.norm(r.found_centre - r.centre, axis=1) for r in runs])
    columns = {
        "mass, rms error [%]": 100 * np.sqrt((relative**2).mean(axis=0)),
        "worst [%]": 100 * np.abs(relative).max(axis=0),
        "within 2 % [%]": 100 * (np.abs(relative) < GOAL).mean(axis=0),
        "interval ± [%]": 100 * LEVEL * np.mean([r.std / r.mass for r in runs], axis=0),
        "holds mass [%]": 100 * (np.abs(z) < LEVEL).mean(axis=0),
        "holds centre [%]": 100 * (np.abs(z_centre) < LEVEL).mean(axis=(0, 2)),
        "centre, rms error [mm]": 1e3 * np.sqrt((offset**2).mean(axis=0)),
    }
    return pd.DataFrame(columns, index=pd.Index(ASKED, name="load [s]"))


def main(*, runs: int = 200, replays: int = 20, seed: int = 0) -> None:
    """Time samples, and draw payloads.

    Args:
        runs: Number of payloads.
        replays: Of the recording that is timed.
    """
    truth = dd_arm("estimated", likely=True)
    [recording] = simulated(truth, np.random.default_rng(seed), 10.0)
    print(cost(recording, replays))
    if runs:
        low, high = 100 * np.array(binom.interval(0.95, runs, 0.95)) / runs
        print(f"{runs} payloads of {MASS[0]} to {MASS[1]} kg; by chance, 95 % intervals hold")
        print(f"{low:.1f} to {high:.1f} % of them")
        drawn = table([run(1000 * seed + k) for k in range(runs)])
        print(drawn.to_string(float_format="{:.2f}".format))


if __name__ == "__main__":
    common.run(main)
