"""How often the 95 % intervals of `identify` hold the truth.

    OMP_NUM_THREADS=1 python benchmarks/coverage.py [--recordings 500] [--jobs 2]

Every recording is a new random motion of an arm whose parameters are known. Its torque comes from
Pinocchio's recursive Newton-Euler algorithm with friction, offset and rotor inertia written here,
in no way from the regressor that is fitted. Encoders have noise; the noise of the torque is white,
first-order autoregressive with a correlation time of 0.05 s and 0.2 s, or white noise low-passed
at 3 Hz, each of the same standard deviation. What `identify` does up to its base parameters with
their covariance is done: positions filtered and differentiated, columns and torque filtered alike
and decimated, weighted least squares. An interval is value ± 1.96 standard deviations.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import joblib
import numpy as np
import pinocchio as pin
import scipy.signal
from threadpoolctl import threadpool_limits

from excitant.design import random_trajectory
from excitant.identify import Data, Recording
from excitant.identify.least_squares import weighted_least_squares
from excitant.identify.preprocessing import prepare
from excitant.identify.regression import Regression
from excitant.identify.rows import fit_rows
from excitant.robots import BaseParameters, Robot, base_parameters, load_robot
from excitant.robots.effects import standard_effects

RATE_HZ = 125.0
ENCODER = 2e-5  # rad: standard deviation of a position
NOISE_SHARE = 0.02  # of each joint's rms torque
HARMONICS = 5
Z95 = 1.959963984540054
NOISES = ("white", "ar 0.05 s", "ar 0.2 s", "low-pass 3 Hz")


def arguments(words: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", nargs="+", default=["planar_2r", "ur10"])
    parser.add_argument("--recordings", type=int, default=500, help="per arm and kind of noise")
    parser.add_argument("--seconds", type=float, default=30.0, help="of one recording")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true", help="figures per parameter, as JSON")
    return parser.parse_args(words)


@dataclass(frozen=True, eq=False)
class Truth:
    """An arm of which everything is known.

    Attributes:
        robot: Its links.
        viscous: Viscous friction, shape (nv,) [N·m·s/rad].
        coulomb: Coulomb friction, shape (nv,) [N·m].
        offset: Constant torque, shape (nv,) [N·m].
        rotor: Rotor inertia, shape (nv,) [kg·m²].
        base: Base parameters of links and effects.
        beta: Their true values, shape (r,).
    """

    robot: Robot
    viscous: np.ndarray
    coulomb: np.ndarray
    offset: np.ndarray
    rotor: np.ndarray
    base: BaseParameters
    beta: np.ndarray

    def torque(self, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
        """Torque of a motion, arrays of shape (n, nv)."""
        model, data = self.robot.model, self.robot.model.createData()
        links = np.array([pin.rnea(model, data, *state) for state in zip(q, dq, ddq, strict=True)])
        friction = self.viscous * dq + self.coulomb * np.sign(dq)
        return np.asarray(links + friction + self.offset + self.rotor * ddq)


def truth(name: str) -> Truth:
    """A built-in arm with friction and rotors drawn in proportion to its torques."""
    robot, rng = load_robot(name).with_effects(()), np.random.default_rng(3)
    states = zip(*robot.random_motion(rng, 200), strict=True)
    data = robot.model.createData()
    size = np.std([pin.rnea(robot.model, data, *state) for state in states], axis=0)
    share = size * rng.uniform(0.5, 1.5, (4, robot.nv))
    viscous, coulomb, offset, rotor = share * np.array([[0.03], [0.05], [0.01], [0.01]])
    effects = standard_effects(robot.joints)
    values = dict(zip(("Fv", "Fc", "offset", "Ia"), (viscous, coulomb, offset, rotor), strict=True))
    coefficients = [
        values[p.name.rpartition(".")[2]][robot.joint_index(p.name.rpartition(".")[0])]
        for effect in effects
        for p in effect.parameters(robot)
    ]
    base = base_parameters(robot, effects)
    beta = base.regrouping @ np.concatenate([robot.phi, coefficients])
    return Truth(robot, viscous, coulomb, offset, rotor, base, beta)


def noise(kind: str, rng: np.random.Generator, n: int, nv: int) -> np.ndarray:
    """Stationary noise of unit variance, shape (n, nv)."""
    settle = round(3 * RATE_HZ)
    white = rng.standard_normal((n + settle, nv))
    if kind == "white":
        return np.asarray(white[settle:])
    if kind.startswith("ar "):
        rho = np.exp(-1 / (RATE_HZ * float(kind.split()[1])))
        made = scipy.signal.lfilter([np.sqrt(1 - rho**2)], [1.0, -rho], white, axis=0)
        return np.asarray(made[settle:])
    sections = scipy.signal.butter(2, float(kind.split()[1]), fs=RATE_HZ, output="sos")
    impulse = scipy.signal.sosfilt(sections, np.eye(1, settle)[0])
    made = scipy.signal.sosfilt(sections, white, axis=0) / np.linalg.norm(impulse)
    return np.asarray(made[settle:])


def recorded(known: Truth, rng: np.random.Generator, seconds: float) -> Iterator[Recording]:
    """One motion, recorded once with every kind of noise."""
    trajectory = random_trajectory(known.robot, rng, 10.0, HARMONICS)
    t = np.arange(0, seconds, 1 / RATE_HZ)
    q, dq, ddq = (trajectory(t, order) for order in range(3))
    tau = known.torque(q, dq, ddq)
    size = NOISE_SHARE * np.sqrt((tau**2).mean(axis=0))
    measured = q + ENCODER * rng.standard_normal(q.shape)
    for kind in NOISES:
        yield Recording(kind, kind, t, measured, tau + size * noise(kind, rng, *tau.shape))


def errors(known: Truth, seed: int, number: int, seconds: float) -> np.ndarray:
    """Error over standard deviation of every base parameter, shape (noises, r)."""
    rng = np.random.default_rng([seed, number])
    rows: Regression | None = None
    found = []
    for recording in recorded(known, rng, seconds):
        train = tuple(prepare(recording))
        if rows is None:  # the same positions make the same columns
            data = Data(train, (), recording.unit, train[0].cutoff_hz, "")
            effects = standard_effects(known.robot.joints)
            rows = fit_rows(known.robot, effects, known.base, data).reduced
        tau = np.concatenate([segment.tau[segment.keep] for segment in train])
        fit = weighted_least_squares(rows.with_torque(tau))
        found.append((fit.beta - known.beta) / np.sqrt(np.diag(fit.covariance)))
    return np.array(found)


@dataclass(frozen=True, eq=False)
class Coverage:
    """What was found for one arm.

    Attributes:
        robot: Name of the arm.
        names: Leading names of the base parameters, r of them.
        errors: Error over standard deviation, shape (recordings, noises, r).
    """

    robot: str
    names: tuple[str, ...]
    errors: np.ndarray

    @property
    def shares(self) -> np.ndarray:
        """Share of recordings whose interval holds the truth, shape (noises, r)."""
        return np.asarray((np.abs(self.errors) <= Z95).mean(axis=0))


def coverage(
    name: str, recordings: int, seconds: float, *, seed: int = 0, jobs: int = 1
) -> Coverage:
    """Identify many recordings of one arm."""
    known = truth(name)
    tasks = (joblib.delayed(_errors_alone)(known, seed, k, seconds) for k in range(recordings))
    found = np.array(joblib.Parallel(n_jobs=jobs, batch_size=5)(tasks))
    names = tuple(known.base.names[column] for column in known.base.columns)
    return Coverage(name, names, found)


def _errors_alone(known: Truth, seed: int, number: int, seconds: float) -> np.ndarray:
    with threadpool_limits(1):
        return errors(known, seed, number, seconds)


def lines(found: Coverage) -> Iterator[str]:
    """Table of one arm: overall, per kind of parameter, and the extremes."""
    kinds = [name.rpartition(".")[2] for name in found.names]
    groups = {
        "inertia": [k for k, kind in enumerate(kinds) if kind.startswith("I") and kind != "Ia"],
        "moment": [k for k, kind in enumerate(kinds) if kind.startswith("m")],
        "Fv": [k for k, kind in enumerate(kinds) if kind == "Fv"],
        "Fc": [k for k, kind in enumerate(kinds) if kind == "Fc"],
        "offset": [k for k, kind in enumerate(kinds) if kind == "offset"],
        "Ia": [k for k, kind in enumerate(kinds) if kind == "Ia"],
    }
    count, r = len(found.errors), len(found.names)
    yield f"{found.robot}: {count} recordings, {r} parameters; 95 % intervals hold the truth in"
    heads = [name for name, members in groups.items() if members]
    yield f"  {'noise':<15}{'all':>8}{'lowest':>9}{'highest':>9}  " + "".join(
        f"{head:>9}" for head in heads
    )
    for kind, share in zip(NOISES, 100 * found.shares, strict=True):
        cells = "".join(f"{share[groups[head]].mean():9.1f}" for head in heads)
        yield f"  {kind:<15}{share.mean():8.2f}{share.min():9.1f}{share.max():9.1f}  {cells}"
    chance = 100 * 3 * np.sqrt(0.95 * 0.05 / count)
    yield f"  one parameter varies by chance within 95 ± {chance:.1f} % (three standard deviations)"


def main(words: Sequence[str] | None = None) -> None:
    args = arguments(words)
    for name in args.robots:
        found = coverage(name, args.recordings, args.seconds, seed=args.seed, jobs=args.jobs)
        if args.json:
            shares = dict(zip(NOISES, found.shares.tolist(), strict=True))
            print(json.dumps({"robot": name, "parameters": found.names, "coverage": shares}))
        else:
            print("\n".join(lines(found)), flush=True)


if __name__ == "__main__":
    main()
