"""Faults of recordings: how many planted ones are found, how often a faultless one is accused."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace

import common
import numpy as np
import pandas as pd
import pinocchio as pin
import scipy.interpolate
import scipy.signal

from excitant.design import random_trajectory
from excitant.identify.faults import Log, find_faults
from excitant.robots import Robot, load_robot
from excitant.robots.virtual_arm import industrial_sensors, virtual_arm

Plant = Callable[[Robot, Log, np.random.Generator], Log]
DURATION = 8.0


def log_of_table(robot: Robot, table: pd.DataFrame) -> Log:
    """The channels of a table with columns t, q1.., dq1.. and tau1..."""
    q, tau, dq = (
        table[[f"{name}{j + 1}" for j in range(robot.nv)]].to_numpy(float)
        for name in ("q", "tau", "dq")
    )
    return Log("log", "log", table["t"].to_numpy(float), q, tau, "N·m", dq, joints=robot.joints)


def recorded(robot: Robot, seed: int, rate_hz: float = 125.0) -> Log:
    """A random motion of a virtual arm that deviates from its model, with true sensors' noise."""
    rng = np.random.default_rng([3, seed])
    sensors = industrial_sensors(robot, rate_hz)
    arm = virtual_arm(robot, rng, hidden=(), sensors=sensors)
    trajectory = random_trajectory(robot, rng, DURATION, 5)
    return log_of_table(robot, arm.record(trajectory, DURATION, rng))


def scaled(log: Log, name: str, factor: object) -> Log:
    return replace(log, **{name: getattr(log, name) * factor})


def flipped(log: Log, joint: int, *names: str) -> Log:
    sign = np.where(np.arange(log.nv) == joint, -1.0, 1.0)
    for name in names:
        log = scaled(log, name, sign)
    return log


def exchanged(log: Log, one: int, other: int, *names: str) -> Log:
    order = np.arange(log.nv)
    order[[one, other]] = other, one
    return replace(log, **{name: getattr(log, name)[:, order] for name in names})


def by_name(robot: Robot, log: Log, rng: np.random.Generator) -> Log:
    """Columns in the alphabetical order of the joints' names."""
    order = np.argsort(robot.joints)
    return replace(log, **{name: getattr(log, name)[:, order] for name in ("q", "dq", "tau")})


def edited(log: Log, name: str, where: object, change: Callable[[np.ndarray], object]) -> Log:
    values = np.array(getattr(log, name))
    values[where] = change(values[where])
    return replace(log, **{name: values})


def with_rows(log: Log, rows: np.ndarray) -> Log:
    """Values of other rows at the log's own times."""
    return replace(log.take(rows), t=log.t[: len(rows)])


def inner(log: Log, rng: np.random.Generator) -> np.ndarray:
    """Joints but the first and the last, whose zero positions torque hardly shows, by chance."""
    return 1 + rng.permutation(max(log.nv - 2, 1))


def shifted(log: Log, *joints: int, angle: float = np.pi / 2) -> Log:
    """Zero positions off by an angle, every other to the other side."""
    offset = np.zeros(log.nv)
    offset[list(joints)] = angle * (-1.0) ** np.arange(len(joints))
    return replace(log, q=log.q + offset)


def less_gravity(robot: Robot, log: Log, gravity: Sequence[float]) -> Log:
    """Torque less that which holds the arm under some gravity."""
    model = robot.with_gravity(gravity).model
    data = model.createData()
    held = [pin.computeGeneralizedGravity(model, data, q).copy() for q in log.q]
    return replace(log, tau=log.tau - held)


def geared(log: Log, ratio: float) -> Log:
    return replace(log, q=ratio * log.q, dq=ratio * np.asarray(log.dq), tau=log.tau / ratio)


def coupled(log: Log) -> Log:
    """The last axis logged with the one before added, and torque that of these axes."""
    plus = np.eye(log.nv)
    plus[-2, -1] = 1.0
    return replace(log, q=log.q @ plus, dq=log.dq @ plus, tau=log.tau @ np.linalg.inv(plus).T)


def livelier(log: Log) -> int:
    return int(np.argmax(np.ptp(log.q, axis=0)))


def frozen_torque(robot: Robot, log: Log, rng: np.random.Generator) -> Log:
    j, start = livelier(log), int(0.4 * len(log))
    rows = slice(start, start + round(1.0 / log.step))
    return edited(log, "tau", (rows, j), lambda x: x[0])


def rows_logged_twice(robot: Robot, log: Log, rng: np.random.Generator) -> Log:
    rows = np.arange(len(log))
    again = np.flatnonzero(rng.random(len(log)) < 0.06)[1:]
    rows[again] -= 1
    return with_rows(log, rows)


def stamps_twice(robot: Robot, log: Log, rng: np.random.Generator) -> Log:
    return log.take(np.sort(np.r_[np.arange(len(log)), rng.choice(len(log), 20)]))


def rows_lost(robot: Robot, log: Log, rng: np.random.Generator) -> Log:
    kept = rng.random(len(log)) > 0.01
    kept[[0, -1]] = True
    return log.take(kept)


def rows_lost_unseen(robot: Robot, log: Log, rng: np.random.Generator) -> Log:
    speed = np.abs(np.asarray(log.dq)).min(axis=1)
    speed[:30], speed[-40:] = 0, 0
    k = int(np.argmax(speed))
    return with_rows(log, np.delete(np.arange(len(log)), np.arange(k, k + 5)))


def torque_outliers(robot: Robot, log: Log, rng: np.random.Generator) -> Log:
    rows, j = rng.choice(np.arange(10, len(log) - 10), 5), int(rng.integers(log.nv))
    jump = 2 * np.ptp(log.tau[:, j]) * rng.choice([-1, 1], 5)
    return edited(log, "tau", (rows, j), lambda x: x + jump)


def position_outliers(robot: Robot, log: Log, rng: np.random.Generator) -> Log:
    rows, j = rng.choice(np.arange(10, len(log) - 10), 3), int(rng.integers(log.nv))
    return edited(log, "q", (rows, j), lambda x: x + 0.1)


def unsigned_torque(robot: Robot, log: Log, rng: np.random.Generator) -> Log:
    counts = np.round(log.tau / np.ptp(log.tau, axis=0) * 20000)
    counts -= np.round(counts.mean(axis=0))
    return replace(log, tau=np.where(counts < 0, counts + 65536, counts))


def clipped_torque(robot: Robot, log: Log, rng: np.random.Generator) -> Log:
    limit = 0.7 * np.abs(log.tau).max(axis=0)
    return replace(log, tau=np.clip(log.tau, -limit, limit))


def model_for_torque(robot: Robot, log: Log, rng: np.random.Generator) -> Log:
    sections = scipy.signal.butter(4, 5.0, fs=1 / log.step, output="sos")
    smooth = scipy.signal.sosfiltfilt(sections, log.q, axis=0)
    spline = scipy.interpolate.make_interp_spline(log.t, smooth, k=5)
    states = zip(*(spline(log.t, k) for k in range(3)), strict=True)
    data = robot.model.createData()
    tau = np.array([pin.rnea(robot.model, data, *state) + 0.3 * state[1] for state in states])
    return replace(log, tau=tau)


def hardly_moving(robot: Robot, log: Log, rng: np.random.Generator) -> Log:
    share, data = 0.02, robot.model.createData()
    q, dq = log.q[0] + share * (log.q - log.q[0]), share * np.asarray(log.dq)
    noise = rng.standard_normal((2, *q.shape))
    tau = [pin.computeGeneralizedGravity(robot.model, data, x).copy() for x in q]
    tau = np.array(tau) + np.sign(dq) + 0.01 * log.tau.std(axis=0) * noise[0]
    return replace(log, q=q, dq=dq + 2e-3 * noise[1], tau=tau)


DEGREES, ALL = 180 / np.pi, slice(None)
FAULTS: dict[str, dict[str, Plant]] = {
    "dead_channel": {
        "zero_torque": lambda _, log, rng: edited(
            log, "tau", (ALL, rng.integers(log.nv)), lambda x: 0.0
        ),
        "noise_for_torque": lambda _, log, rng: edited(
            log, "tau", (ALL, livelier(log)), lambda x: rng.standard_normal(len(x))
        ),
        "frozen_torque": frozen_torque,
    },
    "wrong_sign": {
        "velocity_negated": lambda _, log, rng: flipped(log, rng.integers(log.nv), "dq"),
        "torque_negated": lambda _, log, rng: flipped(log, rng.integers(log.nv), "tau"),
        "position_negated": lambda _, log, rng: flipped(log, log.nv - 1, "q", "dq"),
    },
    "wrong_unit": {
        "velocity_in_rpm": lambda _, log, rng: scaled(log, "dq", 30 / np.pi),
        "position_in_degrees": lambda _, log, rng: scaled(log, "q", DEGREES),
        "all_in_degrees": lambda _, log, rng: scaled(scaled(log, "q", DEGREES), "dq", DEGREES),
        "torque_in_newton_millimetres": lambda _, log, rng: scaled(log, "tau", 1000.0),
    },
    "wrong_order": {
        "joints_exchanged": lambda _, log, rng: exchanged(log, 0, 1, "q", "dq", "tau"),
        "torques_exchanged": lambda _, log, rng: exchanged(log, 0, 1, "tau"),
        "order_of_names": by_name,
    },
    "wrong_sample_rate": {
        "half_rate": lambda _, log, rng: scaled(log, "t", 2.0),
        "half_rate_without_velocity": lambda _, log, rng: replace(scaled(log, "t", 2.0), dq=None),
        "milliseconds": lambda _, log, rng: scaled(log, "t", 1000.0),
        "counted_samples": lambda _, log, rng: replace(log, t=np.arange(float(len(log)))),
    },
    "duplicate_samples": {
        "rows_logged_twice": rows_logged_twice,
        "stamps_twice": stamps_twice,
        "held_torque": lambda _, log, rng: replace(log, tau=log.tau[np.arange(len(log)) // 4 * 4]),
    },
    "dropped_samples": {"rows_lost": rows_lost, "rows_lost_unseen": rows_lost_unseen},
    "corrupt_rows": {
        "not_a_number": lambda _, log, rng: edited(
            log, "tau", (rng.integers(len(log)), 0), lambda x: np.nan
        ),
        "torque_outliers": torque_outliers,
        "position_outliers": position_outliers,
        "unsigned_torque": unsigned_torque,
    },
    "saturation": {"clipped_torque": clipped_torque},
    "not_measured": {"model_for_torque": model_for_torque},
    "poor_excitation": {"hardly_moving": hardly_moving},
}
INSTALLED: dict[str, tuple[str, Plant]] = {
    "zero_a_quarter_off": ("wrong_zero", lambda _, x, rng: shifted(x, inner(x, rng)[0])),
    "two_zeros_off": ("wrong_zero", lambda _, x, rng: shifted(x, *inner(x, rng)[:2])),
    "zero_off": ("wrong_zero", lambda _, x, rng: shifted(x, inner(x, rng)[0], angle=0.7)),
    "on_a_wall": ("wrong_mounting", lambda arm, x, rng: less_gravity(arm, x, [-9.81, 0, -9.81])),
    "no_gravity": ("wrong_mounting", lambda arm, x, rng: less_gravity(arm, x, [0, 0, -9.81])),
    "coupled_wrist": ("coupled_axes", lambda _, x, rng: coupled(x)),
    "pound_inches": ("wrong_unit", lambda _, x, rng: scaled(x, "tau", 8.8507)),
    "currents": ("wrong_unit", lambda _, x, rng: scaled(x, "tau", 1 / rng.uniform(5, 20, x.nv))),
    "behind_a_gear": ("wrong_unit", lambda _, x, rng: geared(x, 101.0)),
}
PLANTS = {how: (fault, plant) for fault, plants in FAULTS.items() for how, plant in plants.items()}
RATES_HZ = (100.0, 125.0, 250.0, 500.0)


def main(
    *,
    robots: Sequence[str] = ("planar_2r", "ur10", "panda"),
    recordings: int = 20,
    clean_only: bool = False,
) -> None:
    """Look for faults in faultless recordings and in those with a planted one.

    Args:
        recordings: Number of recordings of each arm.
        clean_only: Count false alarms only.
    """
    logs = [
        (robot, recorded(robot, seed, RATES_HZ[seed % len(RATES_HZ)]))
        for robot in map(load_robot, robots)
        for seed in range(recordings)
    ]
    faultless = [{fault.fault for fault in find_faults(*log)} for log in logs]
    accused = dict(Counter(name for names in faultless for name in names))
    print(f"faultless: {sum(map(bool, faultless))} of {len(logs)} accused {accused}", flush=True)
    for how, (name, plant) in (PLANTS | INSTALLED).items() if not clean_only else ():
        hits, beside = 0, Counter[str]()
        for seed, (robot, log) in enumerate(logs):
            planted = plant(robot, log, np.random.default_rng(seed))
            names = {fault.fault for fault in find_faults(robot, planted)}
            hits += name in names
            beside.update(names - {name})
        print(f"{name:<18} {how:<28} {hits:>3} of {len(logs)}  beside {dict(beside)}", flush=True)


if __name__ == "__main__":
    common.run(main)
