"""Speed along a path: the dynamics projected on it, and sampling in time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from excitant.design.paths import Path, static_torque
from excitant.robots import Array, Motion, Robot, torque
from excitant.robots.motion import freeze


@dataclass(frozen=True, eq=False)
class Profile:
    """Speed ṡ over position s of a path, with constant s̈ between the points given.

    Attributes:
        s: Positions, increasing from 0 to 1, shape (n,).
        speed: ṡ there, shape (n,) [1/s]; nowhere zero at two neighbours.
    """

    s: Array
    speed: Array

    def __post_init__(self) -> None:
        freeze(self, "s", "speed")

    @property
    def t(self) -> Array:
        """When each position is reached, shape (n,) [s]."""
        return np.append(0.0, np.cumsum(2 * np.diff(self.s) / (self.speed[:-1] + self.speed[1:])))

    @property
    def duration(self) -> float:
        """Time from 0 to 1 [s]."""
        return float(self.t[-1])

    def slower(self, factor: float) -> Profile:
        """The same motion stretched in time."""
        return Profile(self.s, self.speed / factor)

    def positions(self, n: int) -> Array:
        """Positions at ``n`` equidistant instants, first and last included, shape (n,)."""
        t = self.t
        instants = np.linspace(0.0, t[-1], n)
        i = np.clip(np.searchsorted(t, instants, side="right") - 1, 0, len(t) - 2)
        into = instants - t[i]
        rate = (self.speed[i + 1] - self.speed[i]) / (t[i + 1] - t[i])
        s: Array = np.clip(self.s[i] + self.speed[i] * into + rate * into**2 / 2, 0.0, 1.0)
        s[0], s[-1] = 0.0, 1.0
        return s

    def motion(self, path: Path, rate_hz: float) -> Motion:
        """Samples of the path at a control rate [Hz], with q̇ = q̈ = 0 at both ends.

        The positions at the control instants become the control points of a uniform cubic
        spline s(t), which turns jumps of acceleration into ramps of one sample. Its derivatives
        are means of differences of the control points, so it is nowhere faster nor more
        accelerated than the profile. It takes up to three samples longer.
        """
        n = max(1, int(np.ceil(self.duration * rate_hz - 1e-9)))
        control = np.concatenate([np.zeros(2), self.positions(n + 1), np.ones(2)])
        before, now, after = control[:-2], control[1:-1], control[2:]
        s = (before + 4 * now + after) / 6
        ds = ((after - before) * rate_hz / 2)[:, None]
        dds = ((after - 2 * now + before) * rate_hz**2)[:, None]
        dq = path(s, 1)
        t = np.arange(len(s)) / rate_hz
        return Motion(t, path(s), dq * ds, dq * dds + path(s, 2) * ds**2)


@dataclass(frozen=True, eq=False)
class PathDynamics:
    """Torque along a path as τ = a s̈ + b ṡ² + c (Bobrow et al. 1985), each of shape (n, nv).

    Attributes:
        a: Inertia on the path [N·m].
        b: Centrifugal and Coriolis torque, with friction beyond that of ``c`` [N·m].
        low: Smallest c around each position: gravity and dry friction [N·m].
        high: Largest c.
    """

    a: Array
    b: Array
    low: Array
    high: Array

    def __post_init__(self) -> None:
        freeze(self, "a", "b", "low", "high")


def path_kinematics(path: Path, s: Array) -> PathDynamics:
    """Acceleration along a path in the same form, with c = 0."""
    zero = np.zeros((len(s), path.dof))
    return PathDynamics(path(s, 1), path(s, 2), zero, zero)


def path_dynamics(
    robot: Robot, path: Path, s: Array, speed: Array | None = None, blur: float = 0.0
) -> PathDynamics:
    """Dynamics of the robot with its effects on a path.

    Friction that depends on the speed is not of this form. It is replaced by its secant in ṡ²
    between rest and the given speed, where it is then exact; without a speed it is left out.

    Args:
        robot: Arm with its effects.
        path: The path.
        s: Equidistant positions on it, shape (n,).
        speed: ṡ at which friction is exact, shape (n,) [1/s].
        blur: Time before and after each position over which c is taken at its worst, because
            dry friction jumps where a joint turns back while the acceleration takes time [s].
    """
    q, dq, ddq = path(s), path(s, 1), path(s, 2)
    zero = np.zeros_like(q)

    def tau(v: Array, a: Array) -> Array:
        return torque(robot, Motion(s, q, v, a))

    rest = tau(zero, zero)
    a = tau(zero, dq) - rest
    b = (tau(dq, ddq) + tau(-dq, ddq)) / 2 - rest
    if speed is None or not robot.effects:
        c = static_torque(robot, q, dq)
        return PathDynamics(a, b, c, c)
    c, v = static_torque(robot, q, dq), speed[:, None]
    friction = tau(v * dq, v**2 * ddq) - b * v**2 - c
    b = b + np.divide(friction, v**2, out=np.zeros_like(b), where=v > 1e-6 * speed.max())
    reach = np.ceil(blur * speed / (s[1] - s[0])).astype(int)
    return PathDynamics(a, b, -_largest_around(-c, reach), _largest_around(c, reach))


def _largest_around(values: Array, reach: npt.NDArray[np.int_]) -> Array:
    """Largest value of each column within ``reach`` rows, same shape (n, m)."""
    rows = np.arange(len(values))
    largest = values.copy()
    for shift in range(1, min(int(reach.max()), len(values)) + 1):
        for neighbour in (rows - shift, rows + shift):
            near = np.where(reach >= shift, np.clip(neighbour, 0, rows[-1]), rows)
            largest = np.maximum(largest, values[near])
    return largest
