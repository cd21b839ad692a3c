"""Sensors of the plant: what is recorded of a run, and how it may lie."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import pandas as pd
import scipy

from excitant.exceptions import BadInput
from excitant.robots.motion import Array, freeze, read_only


@dataclass(frozen=True, eq=False)
class Sensors:
    """What is recorded of the truth.

    Attributes:
        rate_hz: Sampling rate [Hz].
        position_resolution: Encoder step [rad or m]; 0 for none.
        velocity_noise: Standard deviation of the velocity [rad/s or m/s].
        torque_noise: Standard deviation of each torque, shape (nv,) [N·m].
        torque_resolution: Step of each torque, shape (nv,) [N·m]; 0 for none.
        torque_cutoff_hz: Cut-off of the drive's first-order low-pass before the torque is
            sampled; noise is added behind it [Hz].
        velocity: Where the velocity columns come from: a tachometer, the difference of two
            encoder readings, or none.
    """

    rate_hz: float
    position_resolution: float
    velocity_noise: float
    torque_noise: Array
    torque_resolution: Array
    torque_cutoff_hz: float = np.inf
    velocity: Literal["tachometer", "encoder", "none"] = "tachometer"

    def __post_init__(self) -> None:
        freeze(self, "torque_noise", "torque_resolution")
        if self.velocity not in ("tachometer", "encoder", "none"):
            raise BadInput(f"sensors: velocity '{self.velocity}': tachometer, encoder or none")


@dataclass(frozen=True, eq=False)
class Encoder:
    """Reading of the encoders, in the loop and in the record: s q + o.

    Attributes:
        scale: s, shape (nv,).
        offset: o, shape (nv,) [rad or m].
    """

    scale: Array
    offset: Array

    def __post_init__(self) -> None:
        freeze(self, "scale", "offset")

    def reading(self, q: Array, dq: Array) -> tuple[Array, Array]:
        """Position and velocity as read."""
        return self.scale * q + self.offset, self.scale * dq

    def position(self, reading: Array) -> Array:
        """Position that gives a reading."""
        return np.asarray((reading - self.offset) / self.scale, dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Recorder:
    """How the recorded channels differ from what the drives saw.

    Attributes:
        gain: Recorded torque per torque of each joint, shape (nv, nv); off its diagonal the
            cross-talk between channels.
        delay: How late each torque is recorded; negative where position and velocity are,
            shape (nv,) [s].
        factor: Factor on the finished column of each channel, ``q``, ``dq`` or ``tau``: a sign
            or a unit.
    """

    gain: Array
    delay: Array
    factor: dict[str, Array] = field(default_factory=dict)

    def __post_init__(self) -> None:
        freeze(self, "gain", "delay")
        factor = {name: read_only(values) for name, values in self.factor.items()}
        object.__setattr__(self, "factor", factor)


@dataclass(frozen=True, eq=False)
class Run:
    """What happened, at ``n`` instants.

    Attributes:
        t: Time, shape (n,) [s].
        q: Readings of the encoders, shape (n, nv).
        dq: Their derivative, shape (n, nv).
        tau: Torque that the motors gave, shape (n, nv).
        link: Positions of the links, shape (n, nv).
    """

    t: Array
    q: Array
    dq: Array
    tau: Array
    link: Array


def recorded(
    run: Run, sensors: Sensors, recorder: Recorder, offset: Array, rng: np.random.Generator
) -> pd.DataFrame:
    """The table that the sensors give.

    Args:
        run: What happened, at the sampling rate or a multiple of it.
        sensors: What is recorded.
        recorder: How the record lies.
        offset: What the torque sensors add, shape (nv,) [N·m].
        rng: Noise.

    Returns:
        Columns ``t``, ``q1..qn``, ``dq1..dqn`` unless there are none, ``tau1..taun``.
    """
    t, q, dq, tau = _sampled(run, sensors, recorder)
    shape = q.shape
    if not np.array_equal(recorder.gain, np.eye(shape[1])):
        tau = tau @ recorder.gain.T
    tau = tau + offset + sensors.torque_noise * rng.standard_normal(shape)
    reading = quantised(q, sensors.position_resolution)
    noise = sensors.velocity_noise * rng.standard_normal(shape)
    if sensors.velocity == "encoder":
        dq = np.diff(reading, axis=0, prepend=reading[:1]) * sensors.rate_hz
    else:
        dq = dq + noise
    columns = {"q": reading, "dq": dq, "tau": quantised(tau, sensors.torque_resolution)}
    if sensors.velocity == "none":
        del columns["dq"]
    for name, factor in recorder.factor.items():
        if name in columns:
            columns[name] = columns[name] * factor
    numbered = {f"{c}{j + 1}": v[:, j] for c, v in columns.items() for j in range(shape[1])}
    return pd.DataFrame({"t": t, **numbered})


def _sampled(run: Run, sensors: Sensors, recorder: Recorder) -> tuple[Array, Array, Array, Array]:
    """Time, position, velocity and torque at the sampling instants, late and filtered."""
    q, dq, tau = (np.array(x) for x in (run.q, run.dq, run.tau))
    step = float(run.t[1] - run.t[0])
    if np.isfinite(sensors.torque_cutoff_hz):
        tau = _low_pass(tau, sensors.torque_cutoff_hz, step)
    for j, delay in enumerate(recorder.delay):
        for channel in (tau,) if delay > 0 else (q, dq) if delay < 0 else ():
            channel[:, j] = np.interp(run.t - abs(delay), run.t, channel[:, j])
    every = max(round(1 / (sensors.rate_hz * step)), 1)
    t = np.arange(len(q[::every])) / sensors.rate_hz
    return t, q[::every], dq[::every], tau[::every]


def _low_pass(x: Array, cutoff_hz: float, step: float) -> Array:
    """First-order low-pass, causal, at rest at the first value."""
    a = np.exp(-2 * np.pi * cutoff_hz * step)
    y = scipy.signal.lfilter([1 - a], [1.0, -a], x - x[0], axis=0)
    return np.asarray(x[0] + y, dtype=np.float64)


def quantised(values: Array, step: float | Array) -> Array:
    """Values rounded to a step, which may be 0 for none."""
    width = np.broadcast_to(step, values.shape)
    fine = np.where(width > 0, width, 1.0)
    return np.where(width > 0, np.round(values / fine) * fine, values)
