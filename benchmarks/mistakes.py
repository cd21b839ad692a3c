"""Mistakes of recordings: named, refused or silent; and how often a faultless log is accused."""

import tempfile
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import redirect_stderr
from dataclasses import dataclass, replace
from functools import cache, cached_property
from io import StringIO
from itertools import product
from typing import Any
from zlib import crc32

import common
import numpy as np
import scipy
from arms import TrueArm
from worlds_plant import Plant, Rng, Trajectory, given_and_true, heavier, payload

from excitant.design import random_trajectory
from excitant.exceptions import ExcitantError
from excitant.identify import Estimate, identify_robot, load_dataset, proven, publication
from excitant.identify.faults import Log
from excitant.identify.faults.fault import OF_THE_ARM
from excitant.options import Data
from excitant.recordings import Fit
from excitant.robots import Motion, Robot, load_robot
from excitant.robots.effects import effect_values
from excitant.robots.motion import Array

DURATION = 8.0  # of each motion [s]
ENCODER, TACHO, TORQUE = 2 * np.pi / 2**17, 2e-3, 5e-3  # rad or m; rad/s or m/s; of the largest
WORSE, SMALL = 1.5, 0.05  # times the error of the model of faultless logs; nrmse
VERDICTS = ("named", "refused", "right", "said", "wrongly named", "silent and wrong", "crashed")
WHERE = {"fit": ("fit",), "hold-out": ("held",), "both": ("fit", "held")}


@dataclass(frozen=True, eq=False)
class Run:
    """A motion of an arm of MuJoCo."""

    robot: Robot  # as given
    plant: Plant  # as it is
    motion: Trajectory
    t: Array
    seed: Sequence[int]  # of the noise
    step: float = ENCODER

    @cached_property
    def log(self) -> Log:
        """What is recorded of it."""
        q, dq = (self.motion(self.t, order) for order in range(2))
        tau = self.plant.torque(self.motion, self.t)
        noise = np.random.default_rng(self.seed).standard_normal((2, *q.shape))
        tau = tau + TORQUE * peak(tau) * noise[0]
        q, dq = self.step * np.round(q / self.step), dq + TACHO * noise[1]
        return Log("log", "log", self.t, q, tau, "N·m", dq, joints=self.robot.joints)

    def moved(self, share: Callable[[Array], Any]) -> Log:
        """The same with shares of the joints' motion, by their numbers."""
        shares = share(np.arange(self.robot.nv))
        return replace(self, motion=lambda t, order: shares * self.motion(t, order)).log

    def built(self, **otherwise: Any) -> Log:
        """The same of an arm that is built or read otherwise."""
        return replace(self, plant=replace(self.plant, **otherwise)).log


def run_of(robot: Robot, seed: Sequence[int], rate_hz: float = 125.0, off: float = 0.1) -> Run:
    """A random motion of an arm, the same of seeds that differ in the last number."""
    plant = given_and_true(robot, np.random.default_rng(seed[:-1]), off)[2]
    known = effect_values(robot)
    rotors = np.array([known.get(f"{joint}.Ia", 0.0) for joint in robot.joints])
    plant = replace(plant, laws=((lambda state: state.ddq, rotors),))
    motion = random_trajectory(robot, np.random.default_rng(seed), DURATION, 5)
    return Run(robot, plant, motion, np.arange(round(DURATION * rate_hz) + 1) / rate_hz, seed)


def recorded(robot: Robot, seed: int, rate_hz: float = 125.0) -> Log:
    return run_of(robot, (3, seed, 0), rate_hz, off=0.03).log


Mistake = Callable[[Robot, Log, Rng], Log]
Change = Callable[[Array, Log, Rng], Any]  # of columns, (n, k), or of the time
JOINTS: dict[str, Callable[[Robot, Rng], Any]] = {
    "all": lambda arm, rng: slice(None),
    "any": lambda arm, rng: rng.permutation(arm.nv)[:1],
    "two": lambda arm, rng: rng.permutation(arm.nv)[:2],
    "first": lambda arm, rng: [0],
    "last": lambda arm, rng: [arm.nv - 1],
}


def inner(arm: Robot, rng: Rng) -> Array:
    """Turning joints but the first and the last, whose zeros torque hardly shows, by chance."""
    return rng.permutation(np.flatnonzero(arm.revolute)[1:-1])


def on(names: str, change: Change | float, joints: str = "all") -> Mistake:
    """Channels changed, or multiplied, at some joints."""

    def changed(x: Array, log: Log, rng: Rng) -> Any:
        return change(x, log, rng) if callable(change) else change * x

    def mistake(arm: Robot, log: Log, rng: Rng) -> Log:
        where = ... if names == "t" else (slice(None), JOINTS[joints](arm, rng))
        for name in names.split():
            log = edited(log, name, where, lambda x: changed(x, log, rng))  # noqa: B023
        return log

    return mistake


def columns(names: str, order: Callable[[Robot], Any]) -> Mistake:
    """Columns of channels in another order of the joints."""
    return lambda arm, log, rng: replace(
        log, **{name: getattr(log, name)[:, order(arm)] for name in names.split()}
    )


def rows(chosen: Callable[[int, Rng], Any], stamped: bool = False) -> Mistake:
    """Other rows, with their own times or at those of the log."""
    take = Log.take if stamped else with_rows
    return lambda arm, log, rng: take(log, chosen(len(log), rng))


def rows_of(name: str, chosen: Callable[[int], Any]) -> Mistake:
    """A channel with other rows than the others."""
    return lambda arm, x, rng: replace(x, **{name: getattr(x, name)[chosen(len(x))]})


def with_rows(log: Log, rows: Any) -> Log:
    return replace(log.take(rows), t=log.t[: len(rows)])


def edited(log: Log, name: str, where: Any, change: Callable[[Array], Any]) -> Log:
    values = np.array(getattr(log, name), float)
    values[where] = change(values[where])
    return replace(log, **{name: values})


def scaled(log: Log, name: str, factor: object) -> Log:
    return replace(log, **{name: getattr(log, name) * factor})


def shifted(log: Log, *joints: int, angle: float = np.pi / 2) -> Log:
    """Zero positions off by an angle, every other to the other side."""
    offset = np.zeros(log.nv)
    offset[list(joints)] = angle * (-1.0) ** np.arange(len(joints))
    return replace(log, q=log.q + offset)


def coupled(log: Log, a: int = -2, b: int = -1) -> Log:
    """An axis logged with another one added, and torque that of these axes."""
    plus = np.eye(log.nv)
    plus[a, b] = 1.0
    return replace(log, q=log.q @ plus, dq=log.dq @ plus, tau=log.tau @ np.linalg.inv(plus).T)


def geared(log: Log, ratio: Any) -> Log:
    return scaled(scaled(scaled(log, "q", ratio), "dq", ratio), "tau", 1 / ratio)


def weight(robot: Robot, q: Array) -> Array:
    """Torque that holds the given bodies, (n, nv)."""
    return TrueArm(robot.model).torque(Motion(np.arange(float(len(q))), q, 0 * q, 0 * q))


def loaded(run: Run) -> Log:
    """With a load of a fifth of what moves of the arm, in its hand."""
    robot, rng = run.plant.robot, np.random.default_rng(run.seed[:2])
    body = 0.2 * robot.phi[::10].sum() * payload(robot, rng)
    return run.built(robot=heavier(robot, robot.nv - 1, body))


def in_ampere(log: Log) -> Log:
    return replace(log, tau=log.tau / np.linspace(18, 6, log.nv), unit="A")


def peak(x: Array) -> Array:
    return np.abs(x).max(axis=0)


def ticks(x: Array, *_: object) -> Array:
    """4096 a turn, about 2048."""
    return np.round(2048 + x * 4096 / TURN)


def clip(x: Array, *_: object) -> Array:
    return np.clip(x, -0.7 * peak(x), 0.7 * peak(x))


def struck(x: Array, rng: Rng, count: int) -> Any:
    """Whether a row is one of a few by chance."""
    return rng.permutation(len(x))[:, None] < count


def rows_lost_unseen(arm: Robot, log: Log, rng: Rng) -> Log:
    k = 30 + int(np.argmax(np.abs(log.dq).min(axis=1)[30:-40]))
    return with_rows(log, np.delete(np.arange(len(log)), np.arange(k, k + 5)))


def model_for_torque(robot: Robot, log: Log, rng: Rng) -> Log:
    sections = scipy.signal.butter(4, 5.0, fs=1 / log.step, output="sos")
    smooth = scipy.signal.sosfiltfilt(sections, log.q, axis=0)
    spline = scipy.interpolate.make_interp_spline(log.t, smooth, k=5)
    motion = Motion(log.t, *(spline(log.t, k) for k in range(3)))
    return replace(log, tau=TrueArm(robot.model, Fv=0.3).torque(motion))


ALL, DEGREES, TURN = "q dq tau", 180 / np.pi, 2 * np.pi
PLANTS: dict[str, tuple[str, Mistake]] = {
    "zero_torque": ("dead_channel", on("tau", 0, "any")),
    "noise_for_torque": ("dead_channel",
        on("tau", lambda x, log, rng: rng.standard_normal(x.shape), "last")),
    "frozen_torque": ("duplicate_samples dead_channel",
        rows_of("tau", lambda n: np.r_[:400, [400] * 125, 525:n])),
    "velocity_negated": ("wrong_sign", on("dq", -1, "any")),
    "torque_negated": ("wrong_sign", on("tau", -1, "any")),
    "position_negated": ("wrong_sign", on("q dq", -1, "last")),
    "velocity_in_rpm": ("wrong_unit", on("dq", 30 / np.pi)),
    "position_in_degrees": ("wrong_unit", on("q", DEGREES)),
    "all_in_degrees": ("wrong_unit", on("q dq", DEGREES)),
    "torque_in_newton_millimetres": ("wrong_unit", on("tau", 1000)),
    "joints_exchanged": ("wrong_order", columns(ALL, lambda arm: [1, 0, *range(2, arm.nv)])),
    "torques_exchanged": ("wrong_order", columns("tau", lambda arm: [1, 0, *range(2, arm.nv)])),
    "order_of_names": ("wrong_order", columns(ALL, lambda arm: np.argsort(arm.joints))),
    "half_rate": ("wrong_sample_rate", on("t", 2)),
    "half_rate_without_velocity": ("wrong_sample_rate",
        lambda arm, x, rng: replace(x, t=2 * x.t, dq=None)),
    "milliseconds": ("wrong_sample_rate", on("t", 1000)),
    "counted_samples": ("wrong_sample_rate", on("t", lambda t, *_: np.arange(len(t)))),
    "rows_logged_twice": ("duplicate_samples dropped_samples corrupt_rows",  # two late in a row
        rows(lambda n, rng: np.r_[0, np.arange(1, n) - (rng.random(n - 1) < 0.06)])),
    "stamps_twice": ("duplicate_samples",
        rows(lambda n, rng: np.sort(np.r_[0:n, rng.choice(n, 20)]), stamped=True)),
    "held_torque": ("duplicate_samples", rows_of("tau", lambda n: np.arange(n) // 4 * 4)),
    "rows_lost": ("dropped_samples",
        rows(lambda n, rng: np.flatnonzero(rng.random(n) > 0.01), stamped=True)),
    "rows_lost_unseen": ("dropped_samples", rows_lost_unseen),
    "not_a_number": ("corrupt_rows",
        on("tau", lambda x, log, rng: np.where(struck(x, rng, 1), np.nan, x), "first")),
    "torque_outliers": ("corrupt_rows",
        on("tau", lambda x, log, rng: x + 2 * np.ptp(x) * struck(x, rng, 5), "any")),
    "position_outliers": ("corrupt_rows",
        on("q", lambda x, log, rng: x + 0.1 * struck(x, rng, 3), "any")),
    "unsigned_torque": ("corrupt_rows wrong_unit",
        on("tau", lambda x, *_: np.round(1e4 * (x - x.mean(axis=0)) / peak(x)) % 65536)),
    "clipped_torque": ("saturation", on("tau", clip)),
    "model_for_torque": ("not_measured", model_for_torque),
}  # fmt: skip
"""What is found in the log of any arm, and the faults that tell it, the usual one first."""
READ: dict[str, tuple[str, Mistake]] = PLANTS | {
    "zero_a_quarter_off": ("wrong_zero", lambda arm, x, rng: shifted(x, inner(arm, rng)[0])),
    "zero_opposite": ("wrong_zero", lambda arm, x, rng: shifted(x, inner(arm, rng)[0], angle=3.14)),
    "zero_off": ("wrong_zero", lambda arm, x, rng: shifted(x, inner(arm, rng)[0], angle=0.7)),
    "two_zeros_off": ("wrong_zero", lambda arm, x, rng: shifted(x, *inner(arm, rng)[:2])),
    "no_gravity": ("wrong_mounting", lambda arm, x, rng: replace(x, tau=x.tau - weight(arm, x.q))),
    "coupled_wrist": ("coupled_axes", lambda arm, x, rng: coupled(x)),
    "coupled_forearm": ("coupled_axes",
        lambda arm, x, rng: coupled(x, *np.flatnonzero(arm.revolute)[-3:-1])),
    "pound_inches": ("wrong_unit", on("tau", 8.8507)),
    "pound_inches_of_one": ("wrong_unit", on("tau", 8.8507, "any")),
    "kilogram_metres": ("wrong_unit", on("tau", 0.102)),
    "currents": ("wrong_unit", on("tau", lambda x, log, rng: x / rng.uniform(5, 20, log.nv))),
    "current_of_one": ("wrong_unit", on("tau", 0.1, "any")),
    "per_cent_of_limit": ("wrong_unit",
        lambda arm, x, rng: scaled(x, "tau", 100 / arm.limits.torque)),
    "behind_a_gear": ("wrong_unit", lambda arm, x, rng: geared(x, 101.0)),
    "one_behind_a_gear": ("wrong_unit",
        lambda arm, x, rng: geared(x, 101.0 ** (np.arange(arm.nv) == rng.integers(arm.nv)))),
    "torque_of_motors": ("wrong_unit", on("tau", 1 / 101)),
    "turns": ("wrong_unit", on("q", 1 / TURN)),
    "one_in_degrees": ("wrong_unit", on("q", DEGREES, "any")),
    "velocity_in_degrees": ("wrong_unit", on("dq", DEGREES)),
    "ticks": ("wrong_unit", on("q", ticks)),
    "ticks_without_velocity": ("wrong_unit", lambda arm, x, rng: replace(x, q=ticks(x.q), dq=None)),
    "ticks_of_one": ("wrong_unit", on("q", ticks, "any")),
    "servo_registers": ("wrong_unit",  # speed in steps of 0.229 rpm, current of 2.69 mA at 2 N·m/A
        lambda arm, x, rng: replace(
            x, q=ticks(x.q), dq=np.round(41.7 * x.dq), tau=np.round(186 * x.tau))),
    "sign_bit": ("corrupt_rows wrong_unit",  # a register of per mille, bit 10 its sign, as per cent
        on("tau", lambda x, *_: np.round(1e3 * np.abs(x) / peak(x)) / 10 + 102.4 * (x < 0))),
    "nanoseconds": ("wrong_sample_rate", on("t", 1e9)),
    "clock_a_tenth_fast": ("wrong_sample_rate", on("t", 0.9)),
    "stamps_of_a_slow_clock": ("duplicate_samples wrong_sample_rate",
        on("t", lambda t, *_: np.floor(t / 0.02) * 0.02)),
    "rows_backwards": ("wrong_sign wrong_sample_rate", rows(lambda n, rng: np.arange(n)[::-1])),
    "third_lost_unseen": ("dropped_samples corrupt_rows",
        rows(lambda n, rng: np.r_[0 : n // 3, 2 * n // 3 : n])),
    "frozen_tail": ("duplicate_samples dead_channel",
        rows(lambda n, rng: np.minimum(np.arange(n), rng.integers(0.6 * n, 0.9 * n)))),
    "held_position": ("duplicate_samples", rows_of("q", lambda n: np.arange(n) // 4 * 4)),
    "held_velocity": ("duplicate_samples", rows_of("dq", lambda n: np.arange(n) // 4 * 4)),
    "all_torques_negated": ("wrong_sign", on("tau", -1)),
    "two_torques_negated": ("wrong_sign", on("tau", -1, "two")),
    "joint_negated": ("wrong_sign", on(ALL, -1, "any")),
    "torque_without_sign": ("wrong_sign corrupt_rows", on("tau", lambda x, *_: np.abs(x))),
    "joints_reversed": ("wrong_order", columns(ALL, lambda arm: np.arange(arm.nv)[::-1])),
    "torques_one_column_on": ("wrong_order", columns("tau", lambda arm: np.roll(range(arm.nv), 1))),
    "wrist_torques_exchanged": ("wrong_order",
        columns("tau", lambda arm: [*range(arm.nv - 2), arm.nv - 1, arm.nv - 2])),
    "velocities_exchanged": ("wrong_order", columns("dq", lambda arm: [1, 0, *range(2, arm.nv)])),
    "wrap": ("corrupt_rows",
        on("q", lambda x, *_: (x - (x.max() + x.min()) / 2) % TURN - np.pi, "first")),
    "wrap_at_zero": ("corrupt_rows", on("q", lambda x, *_: x % TURN)),
    "torque_bursts": ("corrupt_rows", on("tau", lambda x, log, rng: x + x.std(axis=0) * np.repeat(
        rng.choice([-3, 0, 3], (100, log.nv), p=[0.015, 0.97, 0.015]), 12, axis=0)[: len(x)])),
    "pushed_by_hand": ("corrupt_rows",
        on("tau", lambda x, log, rng: x + np.outer(np.exp(-((2 * log.t - 8) ** 2)), peak(x)))),
    "dead_velocity": ("dead_channel", on("dq", 0, "any")),
    "dead_position": ("dead_channel poor_excitation", on("q", lambda x, *_: x[0], "any")),
    "clipped_position": ("saturation dead_channel corrupt_rows poor_excitation", on("q", clip)),
    "smoothed_torque": ("time_delay", on("tau", lambda x, *_:
        x[0] + scipy.signal.lfilter([0.02], [1, -0.98], x - x[0], axis=0))),
    "coarse_torque": ("", on("tau", lambda x, *_: np.round(2 * x / peak(x)) * peak(x) / 2)),
}  # fmt: skip
"""What is read otherwise. Without a fault that tells it, a model is to be refused or right."""
MADE: dict[str, tuple[str, Callable[[Run], Log]]] = {
    **{
        f"gravity_along_{name}": ("wrong_mounting",
            lambda run, g=g: run.built(robot=run.plant.robot.with_gravity(g)))
        for name, g in {"x": [9.81, 0, 0], "z": [0, 0, 9.81], "a_slope": [4.0, 3.0, -8.4]}.items()
    },
    "late_by_200_ms": ("time_delay", lambda run: run.built(delay=0.2)),
    "late_by_60_ms": ("time_delay", lambda run: run.built(delay=0.06)),
    "one_late": ("time_delay", lambda run: run.built(delay=0.1 * (np.arange(run.robot.nv) == 1))),
    "positions_late": ("time_delay", lambda run: run.built(delay=-0.1)),
    "parked": ("poor_excitation", lambda run: run.moved(lambda j: j < len(j) - 1)),
    "parked_elbow": ("poor_excitation", lambda run: run.moved(lambda j: j != 2)),
    "hardly_moving": ("poor_excitation", lambda run: replace(run, motion=lambda t, order:
        0.02 * run.motion(t, order) + 0.98 * run.motion(0 * t, 0) * (order == 0)).log),
    "brakes_close": ("corrupt_rows", lambda run: run.built(laws=(*run.plant.laws,
        (lambda state: np.sign(state.dq) * (state.t > 4)[:, None], peak(run.log.tau) / 2)))),
    "one_joint_moves": ("poor_excitation", lambda run: run.moved(lambda j: j == 1)),
    "stands": ("poor_excitation", lambda run: run.moved(lambda j: 0 * j)),
    "static_poses": ("poor_excitation", lambda run: replace(
        run, motion=lambda t, order: run.motion(t / 9.375, order) * (order == 0),
        t=run.t[::40] * 9.375).log),
}  # fmt: skip
"""What is built or moved otherwise."""
PAIRED: dict[str, tuple[str, Callable[[Log, Log], tuple[Log, Log]]]] = {
    "copied_hold_out": ("duplicate_samples", lambda fit, held: (fit, fit)),
    "copied_later": ("duplicate_samples", lambda fit, held: (fit, replace(fit, t=fit.t + 60.0))),
    "copied_thinner": ("duplicate_samples", lambda fit, held: (fit, fit.take(slice(1, None, 2)))),
    "overlapping_hold_out": ("duplicate_samples",
        lambda fit, held: (fit.take(slice(700)), fit.take(slice(300, None)))),
    "torques_of_each_other": ("swapped_recordings",
        lambda fit, held: (replace(fit, tau=held.tau), replace(held, tau=fit.tau))),
}  # fmt: skip
"""What is no hold-out of the fit: no model can be judged by it."""
FAULTLESS: dict[str, tuple[Callable[[Run], Log], float, float]] = {
    "off_by_10": (lambda run: run.log, 125.0, 0.1),
    "off_by_30": (lambda run: run.log, 125.0, 0.3),
    "without_velocity": (lambda run: replace(run.log, dq=None), 100.0, 0.1),
    "in_ampere": (lambda run: in_ampere(run.log), 125.0, 0.1),
    "in_ampere_off_by_30": (lambda run: in_ampere(run.log), 200.0, 0.3),
    "loaded": (loaded, 125.0, 0.1),
    "rests": (lambda run: replace(
        run, motion=lambda t, order: run.motion(np.clip(t - 2, 0, DURATION), order),
        t=np.arange(12 * 125) / 125).log, 125.0, 0.1),
    "encoders_of_12_bits": (lambda run: replace(run, step=TURN / 2**12).log, 125.0, 0.1),
    "encoders_of_14_bits": (lambda run: replace(run, step=TURN / 2**14).log, 500.0, 0.1),
}  # fmt: skip
"""Logs as they should be, their rates [Hz], and how far bodies and friction are off."""
MADE |= {how: ("", make) for how, (make, *_) in FAULTLESS.items()}
KINDS: dict[str, tuple[str, Any]] = {**READ, **MADE, **PAIRED}


@cache
def runs(arm: str, seed: int, rate_hz: float = 125.0, off: float = 0.1) -> list[Run]:
    """Those to fit, to hold out, and one that is never seen."""
    return [run_of(load_robot(arm), (3, seed, k), rate_hz, off) for k in range(3)]


def planted(kind: str, where: str, both: Sequence[Run]) -> list[Log]:
    """Recordings to fit and to hold out."""
    make, logs = KINDS[kind][1], [run.log for run in both]
    if kind in PAIRED:
        return list(make(*logs))
    for k, run in enumerate(both):
        rng = np.random.default_rng([run.seed[1], crc32(kind.encode())])
        if WHERE["both"][k] in WHERE[where]:
            logs[k] = make(run) if kind in MADE else make(run.robot, run.log, rng)
    return logs


def told(arm: str, logs: Sequence[Log]) -> tuple[list[tuple[str, set[str]]], Estimate | None]:
    """Recordings and faults that `identify` tells of two files, each with what it calls alike.

    Also what it publishes.
    """
    entries: list[dict[str, Any]] = []
    estimate = None
    with tempfile.TemporaryDirectory() as folder, redirect_stderr(StringIO()):
        files = [f"{folder}/{name}.parquet" for name in WHERE["both"]]
        for file, log in zip(files, logs, strict=True):
            log.to_frame().to_parquet(file)
        try:
            read = Data(validate=files[1:]).read(load_dataset(arm), files[:1])
            entries = read.entries["faults"]
            options = {"effects": None, "cutoff": None, "validate": read.holdout}
            found = Fit().identified(read.robot, read.fit, options)
            if publication(found, formats=(), faults=proven(entries)).published:
                estimate = found
        except ExcitantError:
            pass  # refused
    faults = []
    for entry in entries:
        alike = {fault for fault, _ in entry["evidence"].get("alike", ())}
        faults.append((entry["recording"], {entry["fault"], *alike}))
    return faults, estimate


def errors(estimate: Estimate, log: Log) -> Array:
    """Nrmse of each joint, none of rounding."""
    return np.array([joint["nrmse"] * (joint["rms"] > 1e-12) for joint in estimate.score(log)])


@cache
def least_errors(arm: str, seed: int) -> Array:
    """Those of the model of faultless logs."""
    fit, held, unseen = (run.log for run in runs(arm, seed))
    return errors(identify_robot(load_robot(arm), fit, validate=held), unseen)


def verdict(kind: str, where: str, arm: str, seed: int) -> dict[str, Any]:
    """One of `VERDICTS` on a case, and what was said or missed."""
    warnings.simplefilter("ignore")
    case = {"kind": kind, "where": where, "arm": arm, "seed": seed}
    *both, unseen = runs(arm, seed, *FAULTLESS.get(kind, ())[1:])
    wanted, there = {*KINDS[kind][0].split()}, WHERE[where]
    try:
        faults, estimate = told(arm, planted(kind, where, both))
    except Exception as bug:  # whichever
        return case | {"verdict": "crashed", "why": repr(bug)}
    wrong = [(at, names) for at, names in faults if at not in there or not names & wanted]
    if wrong:
        why = sorted({f"{' or '.join(names)} of {at}" for at, names in wrong})
        return case | {"verdict": "wrongly named", "why": ", ".join(why)}
    if faults or estimate is None:
        return case | {"verdict": "named" if faults else "refused", "why": ""}
    known = estimate.validate.nrmse  # what the first line says
    moving = [unseen.robot.joint_index(joint) for joint in estimate.given.joints]
    if kind in FAULTLESS:
        off, least = errors(estimate, MADE[kind][1](unseen)), known
    elif len(moving) < unseen.robot.nv:  # of a joint that stands in the hold-out as well
        off, least = known, least_errors(arm, seed)[moving]
    else:
        same = where == "both" and (kind in MADE or wanted & {*OF_THE_ARM})  # the arm is as it is
        log = planted(kind, "fit", [unseen])[0] if same else unseen.log
        off, least = errors(estimate, log), least_errors(arm, seed)
        known = estimate.validate.rms / log.tau.std(axis=0)  # poses spread otherwise in each log
    right = np.maximum(WORSE * least, SMALL)
    verdicts = {"right": right, "said": np.fmax(right, WORSE * known)}
    fits = [v for v, most in verdicts.items() if kind not in PAIRED and (off <= most).all()]
    found = [*fits, "silent and wrong"][0]
    return case | {"verdict": found, "why": f"nrmse {off.max():.2g}"}


def chosen(words: Sequence[str]) -> list[str]:
    """Mistakes by name or part of a name, with or without commas between; all without a word."""
    parts = [part for word in words for part in word.split(",")]
    found = {kind for kind in KINDS for part in parts if part in kind and part not in KINDS}
    return [k for k in KINDS if k in parts or k in found or not (parts or k in FAULTLESS)]


def totals(results: Sequence[dict[str, Any]]) -> Iterator[str]:
    yield f"\n{len(results)} cases, shares [%] (95 %)"
    for name in VERDICTS:
        yield f"{name:18s}" + common.wilson([r["verdict"] == name for r in results], 1)
    for r in results:
        if r["verdict"] in VERDICTS[4:]:
            words = "--kinds {kind} --where {where} --arms {arm} --seeds {seed}".format(**r)
            yield f"{r['verdict']}, {r['why']}: python benchmarks/mistakes.py {words}"


def main(
    *,
    arms: Sequence[str] = ("ur5e", "gen3", "scara", "so100"),
    seeds: Sequence[int] = (0, 1),
    kinds: Sequence[str] = (),
    where: Sequence[str] = tuple(WHERE),
    faultless: int = 0,
    processes: int = 1,
) -> None:
    """Make mistakes in recordings of MuJoCo's arms and see what `identify` tells of them.

    Args:
        kinds: Names of mistakes, or parts of names; all when none.
        where: Recordings with the mistake: fit, hold-out, both.
        faultless: Number of pairs of faultless logs, instead of mistakes.
    """
    where = ("both",) if faultless else where
    results: list[dict[str, Any]] = []
    print(f"{'':30s}" + "".join(f"{place:>24s}" for place in where))
    print(f"{'':30s}" + len(where) * "".join(f"{name[:3]:>4s}" for name in VERDICTS))
    for kind in FAULTLESS if faultless else chosen(kinds):
        places = ["both"] if kind in PAIRED or kind in FAULTLESS else where
        numbers = range(-(-faultless // len(FAULTLESS) // len(arms))) if faultless else seeds
        cases = product([kind], places, arms, numbers)
        here = common.answers(verdict, cases, processes, None)
        results += here
        counts = Counter((r["where"], r["verdict"]) for r in here)
        cells = (counts[place, name] or "." for place in where for name in VERDICTS)
        print(f"{kind:30s}" + "".join(f"{cell:>4}" for cell in cells), flush=True)
    print("\n".join(totals(results)))


if __name__ == "__main__":
    common.run(main)
