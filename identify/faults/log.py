"""Log: a recording as its channels, before anything is believed of it; chance in long channels."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

from excitant.identify.importers.raw import RawRecording
from excitant.identify.recording import Recording
from excitant.robots.motion import Array, freeze

CHANNELS = ("q", "dq", "tau")
FALSE_ALARMS = 0.02
"""Share of faultless recordings in which all tests together may raise a fault."""
ALARM = FALSE_ALARMS / 20
"""Share that one family of tests may raise; there are fewer than twenty of them."""
Rows = npt.NDArray[np.intp]
Mask = npt.NDArray[np.bool_]
_AROUND = 101  # samples that say what is usual around one
_SPAN = 4  # samples to either side of the one whose speed is asked


@dataclass(frozen=True, eq=False)
class Log:
    """Channels of a recording as logged: time may repeat, values may be missing.

    Attributes:
        t: Time, shape (n,) [s].
        q: Positions, shape (n, nv).
        tau: Torque or motor current, shape (n, nv).
        dq: Velocities, shape (n, nv); None when not logged.
        joints: Names of the joints.
        unit: ``"N·m"`` or ``"A"``.
    """

    t: Array
    q: Array
    tau: Array
    dq: Array | None
    joints: tuple[str, ...]
    unit: str = "N·m"

    def __post_init__(self) -> None:
        freeze(self, "t", "q", "tau", *(("dq",) if self.dq is not None else ()))

    def __len__(self) -> int:
        return len(self.t)

    @property
    def nv(self) -> int:
        """Number of joints."""
        return int(self.q.shape[1])

    def channels(self) -> list[tuple[str, Array]]:
        """Names and arrays, shape (n, nv), of the channels that exist."""
        return [(name, x) for name in CHANNELS if (x := getattr(self, name)) is not None]

    def names(self, joints: Any) -> tuple[str, ...]:
        """Names of joints by index."""
        return tuple(self.joints[int(j)] for j in joints)

    def take(self, rows: Rows | Mask) -> Log:
        """The log at some of its rows."""
        dq = None if self.dq is None else self.dq[rows]
        return replace(self, t=self.t[rows], q=self.q[rows], tau=self.tau[rows], dq=dq)

    @cached_property
    def step(self) -> float:
        """Median time step [s]."""
        steps = np.diff(self.t)
        forward = steps[steps > 0]
        return float(np.median(forward)) if len(forward) else 1.0

    @cached_property
    def grain(self) -> Array:
        """Noise or step of each position, whichever is larger, shape (nv,)."""
        return np.array([max(noise(column), quantum(column)) for column in self.q.T])

    @cached_property
    def quantum(self) -> Array:
        """Smallest step between two positions of each joint, shape (nv,)."""
        return np.array([quantum(column) for column in self.q.T])

    @cached_property
    def travel(self) -> Array:
        """Change of position per sample around each one, (n, nv)."""
        n, k = len(self), _SPAN
        low, high = np.maximum(np.arange(n) - k, 0), np.minimum(np.arange(n) + k, n - 1)
        return np.asarray((self.q[high] - self.q[low]) / np.maximum(high - low, 1)[:, None])

    @cached_property
    def moving(self) -> Mask:
        """Where a joint moves by several times its `grain` per sample, (n, nv)."""
        return np.asarray(np.abs(self.travel) > 4 * self.grain)


Raw = Log | Recording | RawRecording
"""What may have faults: arrays as logged, nothing refused."""


def noise(x: Array) -> float:
    """Standard deviation of white noise on a smooth signal, from its fourth differences."""
    if len(x) < 10:
        return 0.0
    return float(np.median(np.abs(np.diff(x, 4))) / 0.6745 / np.sqrt(70.0))


def quantum(x: Array) -> float:
    """Step of a quantised channel: the typical smallest distance between its levels, or 0.

    The lower decile of the distances counts, so that a few stray values do not. It is no step
    when neighbouring levels are as far apart as chance puts them.
    """
    levels = np.unique(x[np.isfinite(x)])
    gaps = np.diff(levels)
    gaps = gaps[gaps > 1e-9 * max(float(np.ptp(levels)), 1e-300)] if len(gaps) else gaps
    return float(np.quantile(gaps, 0.1)) if len(gaps) else 0.0


def tail_bound(values: Array, alarm: float = ALARM) -> float:
    """Level that the largest of the values exceeds by chance with probability ``alarm``.

    Their distribution is taken to fall off beyond its 90 % quantile like exp(−√z), as fast as
    between the median and there: far heavier than Gaussian, as dry friction, impacts and
    jitter of stamps make it, and blind to up to a tenth of outliers.

    Args:
        values: Magnitudes, shape (n,).
        alarm: Probability.
    """
    if not len(values):
        return np.inf
    low, high = np.sqrt(np.quantile(values, (0.5, 0.9)))
    decay = (high - low) / np.log(0.5 / 0.1)
    return float((high + decay * max(np.log(0.1 * len(values) / alarm), 0.0)) ** 2)


def normal_bound(tests: int) -> float:
    """Level that the largest of many standard normal variables exceeds by chance."""
    return float(-scipy.special.ndtri(ALARM / (2 * max(tests, 1))))


def running_median(x: Array, window: int) -> Array:
    """Median of so many samples around each one, column by column, shape as given."""
    size = min(window, len(x))
    columns = [scipy.ndimage.median_filter(column, size, mode="nearest") for column in x.T]
    return np.column_stack(columns)


def local_scale(values: Array) -> Array:
    """Running median of magnitudes by column, no less than a fifth of their upper quartile."""
    size = np.abs(values)
    return np.maximum(running_median(size, _AROUND), 0.2 * np.quantile(size, 0.75, axis=0))


def run_lengths(same: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Starts and lengths of the runs of True in a boolean array."""
    edges = np.diff(np.concatenate([[0], same.astype(np.int8), [0]]))
    starts, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    return starts, ends - starts
