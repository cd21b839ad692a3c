"""Log: a recording as its channels, before anything is believed of it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from excitant.identify.faults.fault import Rows
from excitant.robots.motion import Array, freeze

CHANNELS = ("q", "dq", "tau")
_SPAN = 4  # samples to either side of the one whose speed is asked


class Raw(Protocol):
    """What a raw recording offers: arrays as logged, nothing refused."""

    @property
    def t(self) -> Array:
        """Time, shape (n,) [s]."""

    @property
    def q(self) -> Array:
        """Positions, shape (n, nv)."""

    @property
    def dq(self) -> Array | None:
        """Velocities, shape (n, nv), where they were logged."""

    @property
    def tau(self) -> Array:
        """Torque or current, shape (n, nv)."""

    @property
    def unit(self) -> str:
        """Unit of the torque, N·m or A."""


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

    def take(self, rows: Rows | npt.NDArray[np.bool_]) -> Log:
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
    def resolution(self) -> Array:
        """Noise of each position: robust scale of its fourth differences, shape (nv,)."""
        return np.array([noise(column) for column in self.q.T])

    @cached_property
    def travel(self) -> Array:
        """Change of position per sample around each one, (n, nv); see `moving`."""
        n, k = len(self), _SPAN
        low, high = np.maximum(np.arange(n) - k, 0), np.minimum(np.arange(n) + k, n - 1)
        return np.asarray((self.q[high] - self.q[low]) / np.maximum(high - low, 1)[:, None])

    @cached_property
    def moving(self) -> npt.NDArray[np.bool_]:
        """Where a joint moves by several times its resolution per sample, (n, nv)."""
        return np.asarray(np.abs(self.travel) > 4 * np.maximum(self.resolution, self.quantum))

    def moves_at(self, rows: Rows, grain: Array) -> npt.NDArray[np.bool_]:
        """Whether any joint moves at some rows, as `moving` says, shape (k,).

        Args:
            rows: The rows, shape (k,).
            grain: Noise or step of each position, whichever is larger, shape (nv,).
        """
        low, high = np.maximum(rows - _SPAN, 0), np.minimum(rows + _SPAN, len(self) - 1)
        way = np.abs(self.q[high] - self.q[low])
        return np.asarray((way > 4 * grain * (high - low)[:, None]).any(axis=1), bool)

    @cached_property
    def quantum(self) -> Array:
        """Smallest step between two positions of each joint, shape (nv,)."""
        return np.array([quantum(column) for column in self.q.T])


def log_of(raw: Raw, joints: tuple[str, ...]) -> Log:
    """The channels of a raw recording."""
    return Log(raw.t, raw.q, raw.tau, raw.dq, joints, raw.unit)


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
