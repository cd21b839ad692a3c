"""What each estimator makes of a UR10 whose parameters are known; see README.md."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import common
import numpy as np
import pandas as pd
import pinocchio as pin
import scipy.signal

from excitant.design import random_trajectory
from excitant.identify import Data, Recording, estimators
from excitant.identify.least_squares import LeastSquares, weighted_least_squares
from excitant.identify.preprocessing import prepare
from excitant.identify.rows import fit_rows
from excitant.robots import BaseParameters, Motion, Robot, base_parameters, load_robot
from excitant.robots.effects import standard_effects
from excitant.robots.torque import observation_columns

RATE_HZ = 250.0
HARMONICS = 5
FILTERS = {"good": 10.0, "bad": 25.0}  # Hz
KINDS = ("fine", "coloured", "outliers", "encoders")
SHARE = 0.02  # of each joint's rms torque is noise
BURST_S, BURST_SHARE, BURST_SIZE = 0.1, 0.03, 3.0
METHODS = ("wls", "irls", "wls half", "iv", "oe")
Array = np.ndarray


@dataclass(frozen=True, eq=False)
class TrueArm:
    """Pinocchio's rigid bodies, and what each joint has besides, shape (nv,) [SI]."""

    model: pin.Model
    Fv: Array | float = 0.0
    Fc: Array | float = 0.0
    offset: Array | float = 0.0
    Ia: Array | float = 0.0

    def torque(self, motion: Motion) -> Array:
        """Torque of a motion, shape (n, nv)."""
        data, states = self.model.createData(), (motion.q, motion.dq, motion.ddq)
        rigid = [pin.rnea(self.model, data, *state) for state in zip(*states, strict=True)]
        friction = self.Fv * motion.dq + self.Fc * np.sign(motion.dq) + self.offset
        return np.asarray(np.array(rigid) + friction + self.Ia * motion.ddq)


@dataclass(frozen=True, eq=False)
class Truth:
    """An arm of which everything is known, its base parameters and their values."""

    robot: Robot
    arm: TrueArm
    base: BaseParameters
    beta: Array


def truth(name: str) -> Truth:
    """A built-in arm with friction and rotors drawn in proportion to its torques."""
    robot, rng = load_robot(name).with_effects(()), np.random.default_rng(3)
    motion = Motion(np.arange(200.0), *robot.random_motion(rng, 200))
    size = TrueArm(robot.model).torque(motion).std(axis=0)
    drawn = size * rng.uniform(0.5, 1.5, (4, robot.nv)) * [[0.03], [0.05], [0.01], [0.01]]
    coefficients = dict(zip(("Fv", "Fc", "offset", "Ia"), drawn, strict=True))
    effects = standard_effects(robot.joints)
    names = (p.name.rpartition(".") for effect in effects for p in effect.parameters(robot))
    values = [coefficients[symbol][robot.joint_index(joint)] for joint, _, symbol in names]
    base = base_parameters(robot, effects)
    beta = base.regrouping @ np.concatenate([robot.phi, values])
    return Truth(robot, TrueArm(robot.model, **coefficients), base, beta)


def torque_noise(kind: str, rng: np.random.Generator, n: int, nv: int) -> Array:
    """Noise per rms of the torque, shape (n, nv)."""
    white = rng.standard_normal((n, nv))
    if kind == "coloured":
        rho = np.exp(-1 / (0.2 * RATE_HZ))
        start = white[:1] * rho / np.sqrt(1 - rho**2)
        gain = [np.sqrt(1 - rho**2)]
        white = scipy.signal.lfilter(gain, [1.0, -rho], white, axis=0, zi=start * gain[0])[0]
    found = SHARE * white
    if kind == "outliers":
        length = round(BURST_S * RATE_HZ)
        begins = rng.random((n, nv)) < BURST_SHARE / length
        found += BURST_SIZE * scipy.signal.lfilter(np.ones(length), np.ones(1), begins, axis=0)
    return np.asarray(found)


def recorded(known: Truth, kind: str, rng: np.random.Generator, seconds: float) -> Recording:
    t = np.arange(0, seconds, 1 / RATE_HZ)
    motion = random_trajectory(known.robot, rng, 10.0, HARMONICS).at(t)
    tau = known.arm.torque(motion)
    size = np.sqrt((tau**2).mean(axis=0))
    encoder = 2e-4 if kind == "encoders" else 2e-5
    measured = motion.q + encoder * rng.standard_normal(tau.shape)
    return Recording(kind, kind, t, measured, tau + size * torque_noise(kind, rng, *tau.shape))


def judge(known: Truth, seed: int) -> Callable[[LeastSquares], tuple[Array, float]]:
    """Scaled errors of an estimate, shape (r,) [N·m], and worst nrmse on one more motion."""
    rng = np.random.default_rng([seed, 10**6])
    effects, columns = standard_effects(known.robot.joints), list(known.base.columns)
    states = Motion(np.arange(600.0), *known.robot.random_motion(rng, 600))
    Y = observation_columns(known.robot, effects, states)[:, :, columns]
    scale = np.sqrt((Y**2).mean(axis=(0, 1)) * Y.shape[1])
    motion = random_trajectory(known.robot, rng, 10.0, HARMONICS).at(np.arange(0, 10, 0.02))
    W = observation_columns(known.robot, effects, motion)[:, :, columns]
    tau = known.arm.torque(motion)

    def errors(fit: LeastSquares) -> tuple[Array, float]:
        rms = np.sqrt(((tau - W @ fit.beta) ** 2).mean(axis=0))
        return (fit.beta - known.beta) * scale, float((rms / tau.std(axis=0)).max())

    return errors


def estimates(
    known: Truth, recording: Recording, cutoff_hz: float
) -> tuple[dict[str, LeastSquares], float]:
    """Every estimator's, and the chance of the test."""
    segments = tuple(prepare(recording, cutoff_hz))
    data = Data(segments, (), recording.unit, cutoff_hz, "")
    rows = fit_rows(known.robot, standard_effects(known.robot.joints), known.base, data)
    even, odd = estimators.half_regressions(rows, [recording])
    loop = estimators.closed_loop(rows, [recording])
    fits = (
        weighted_least_squares(rows.reduced),
        estimators.irls(rows.reduced),
        weighted_least_squares(even),
        estimators.iv(even, odd),
        estimators.output_error(loop.problem, loop.simulated).fit,
    )
    return dict(zip(METHODS, fits, strict=True)), estimators.errors_in_variables(even, odd)[1]


def main(
    *,
    robot: str = "ur10",
    draws: int = 2,
    seconds: float = 30.0,
    seed: int = 0,
    kinds: Sequence[str] = KINDS,
) -> None:
    """Fit recordings of an arm whose parameters are known.

    Args:
        draws: Number of recordings of each kind of noise.
    """
    known = truth(robot)
    held, table = judge(known, seed), {}
    for kind in kinds:
        rngs = [np.random.default_rng([seed, KINDS.index(kind), draw]) for draw in range(draws)]
        recordings = [recorded(known, kind, rng, seconds) for rng in rngs]
        for filtering, cutoff_hz in FILTERS.items():
            fits, chances = zip(*(estimates(known, r, cutoff_hz) for r in recordings), strict=True)
            scaled, shares = {"test, p": np.median(chances)}, {}
            for method in METHODS:
                errors, worst = zip(*(held(fit[method]) for fit in fits), strict=True)
                scaled[method] = np.sqrt(np.mean(np.square(errors)))
                shares[method] = 100 * np.mean(worst)
            name = f"{kind}, {filtering}"
            table |= {(name, "N·m"): scaled, (name, "%"): shares}
    frame = pd.DataFrame(table, index=[*METHODS, "test, p"])
    print(frame.T.to_string(float_format="{:.3g}".format, na_rep=""))


if __name__ == "__main__":
    common.run(main)
