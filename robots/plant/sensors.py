"""Sensors of the plant: the record of a run, with noise and systematic errors."""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from excitant.robots.motion import Array, Noun


@dataclass(frozen=True, eq=False)
class Sensors(Noun):
    """Sensors: noise as standard deviations, resolution as steps, 0 for none."""

    rate_hz: float  # sampling rate [Hz]
    position_resolution: float  # encoder step [rad or m]
    velocity_noise: float  # of the tachometers [rad/s or m/s]
    torque_noise: Array  # of each torque, shape (nv,) [N·m]
    torque_resolution: Array  # step of each torque, shape (nv,) [N·m]


@dataclass(frozen=True, eq=False)
class Encoder(Noun):
    """Reading of the encoders, in the loop and in the record: s q + o, each of shape (nv,)."""

    scale: Array
    offset: Array

    def reading(self, q: Array, dq: Array) -> tuple[Array, Array]:
        """Position and velocity as read."""
        return self.scale * q + self.offset, self.scale * dq

    def position(self, reading: Array) -> Array:
        """Position that gives a reading."""
        return (reading - self.offset) / self.scale


@dataclass(frozen=True, eq=False)
class Recorder(Noun):
    """Systematic errors of the recorded channels."""

    gain: Array  # recorded torque per torque of each joint, cross-talk off the diagonal, (nv, nv)
    delay: Array  # of each torque; negative where position and velocity are late, (nv,) [s]


@dataclass(frozen=True, eq=False)
class Run:
    """True motion and torque at ``n`` instants; arrays of shape (n, nv)."""

    t: Array  # time, shape (n,) [s]
    q: Array  # readings of the encoders
    dq: Array  # their derivative
    tau: Array  # torque that the motors gave
    link: Array  # positions of the links


def recorded(
    run: Run,
    sensors: Sensors,
    recorder: Recorder,
    offset: Array,
    rng: np.random.Generator,
) -> pd.DataFrame:
    """The table that the sensors give of a run at the sampling rate or a multiple of it.

    Columns ``t``, ``q1..qn``, ``dq1..dqn``, ``tau1..taun``; torque with an offset, (nv,) [N·m].
    """
    q, dq, tau = (np.array(x) for x in (run.q, run.dq, run.tau))
    for j, delay in enumerate(recorder.delay):
        for channel in (tau,) if delay > 0 else (q, dq) if delay < 0 else ():
            channel[:, j] = np.interp(run.t - abs(delay), run.t, channel[:, j])
    every = max(round(1 / (sensors.rate_hz * float(run.t[1] - run.t[0]))), 1)
    q, dq, tau = (channel[::every] for channel in (q, dq, tau))
    tau = (
        tau @ recorder.gain.T
        + offset
        + sensors.torque_noise * rng.standard_normal(q.shape)
    )
    dq = dq + sensors.velocity_noise * rng.standard_normal(q.shape)
    q = quantised(q, sensors.position_resolution)
    tau = quantised(tau, sensors.torque_resolution)
    channels = {"q": q, "dq": dq, "tau": tau}
    columns = {
        f"{c}{j + 1}": x
        for c, values in channels.items()
        for j, x in enumerate(values.T)
    }
    return pd.DataFrame({"t": np.arange(len(q)) / sensors.rate_hz, **columns})


def quantised(values: Array, step: float | Array) -> Array:
    """Values rounded to a step, which may be 0 for none."""
    width = np.broadcast_to(step, values.shape)
    fine = np.where(width > 0, width, 1.0)
    return np.where(width > 0, np.round(values / fine) * fine, values)
