"""Limits of a motion on position, velocity, acceleration and torque, in continuous time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from excitant.design.interpolation import HermiteTrajectory, largest
from excitant.design.trajectory import Trajectory
from excitant.exceptions import BadInput, OutsideLimits
from excitant.robots import Array, Limits, Motion, Robot
from excitant.robots.motion import freeze
from excitant.robots.torque import largest_torque

KINEMATIC = ("position", "velocity", "acceleration", "jerk")  # by derivative order

_PER_HARMONIC = 100  # instants per period of the highest harmonic, for torque
_PER_SAMPLE = 8  # instants per sampling interval of a recorded motion
_SHRINKS = 30
_ONE_SIDED = 4 * np.pi  # width given to a range that is bounded on one side only


@dataclass(frozen=True, eq=False)
class LimitUse:
    """How far one quantity goes, as a share of its limit; ≤ 1 holds.

    Attributes:
        quantity: ``"position"``, ``"velocity"``, ``"acceleration"``, ``"jerk"`` or ``"torque"``.
        ratios: Largest magnitude over limit per joint, shape (nv,); 0 without a limit. For
            position it is |q − middle| over half the range.
        times: When each joint's largest ratio occurs, shape (nv,) [s].
        values: The quantity there, with its sign, shape (nv,).
        bounds: The limit on that side, shape (nv,); infinite without one.
        joints: Names of the joints.
    """

    quantity: str
    ratios: Array
    times: Array
    values: Array
    bounds: Array
    joints: tuple[str, ...]

    def __post_init__(self) -> None:
        freeze(self, "ratios", "times", "values", "bounds")

    @property
    def ratio(self) -> float:
        """The worst joint's ratio."""
        return float(self.ratios.max())

    @property
    def joint(self) -> str:
        """Name of the worst joint."""
        return self.joints[int(self.ratios.argmax())]

    @property
    def time(self) -> float:
        """When the worst ratio occurs [s]."""
        return float(self.times[self.ratios.argmax()])

    def require(self) -> None:
        """Refuse a joint beyond its limit.

        Raises:
            OutsideLimits: With the worst joint, its value and the limit.
        """
        if self.ratio > 1.0:
            k = int(self.ratios.argmax())
            raise OutsideLimits(
                self.joint, self.quantity, float(self.values[k]), float(self.bounds[k]), self.time
            )


@dataclass(frozen=True, eq=False)
class LimitReport:
    """Worst use of every limit over a continuous motion.

    Attributes:
        position: Use of the position range.
        velocity: Use of the velocity limit.
        acceleration: Use of the acceleration limit.
        torque: Use of the torque limit.
        jerk: Use of the limit on jerk; None without one.
    """

    position: LimitUse
    velocity: LimitUse
    acceleration: LimitUse
    torque: LimitUse
    jerk: LimitUse | None = None

    @property
    def uses(self) -> tuple[LimitUse, ...]:
        """All quantities; jerk only with a limit on it."""
        four = (self.position, self.velocity, self.acceleration, self.torque)
        return four if self.jerk is None else (*four, self.jerk)

    @property
    def worst(self) -> LimitUse:
        """The quantity that comes closest to its limit, or exceeds it most."""
        return max(self.uses, key=lambda use: use.ratio)

    @property
    def hold(self) -> bool:
        """Whether no limit is exceeded."""
        return self.worst.ratio <= 1.0


def position_range(limits: Limits) -> tuple[Array, Array]:
    """Middle and half width of each joint's range, both (nv,) [rad or m].

    Without limits the middle is 0 and the half width infinite; a range bounded on one side
    only counts as two turns (4π) wide.
    """
    low, high = limits.position.T
    low = np.where(np.isinf(low) & np.isfinite(high), high - _ONE_SIDED, low)
    high = np.where(np.isinf(high) & np.isfinite(low), low + _ONE_SIDED, high)
    bounded = np.isfinite(low) & np.isfinite(high)
    middle = np.where(bounded, (np.where(bounded, low, 0) + np.where(bounded, high, 0)) / 2, 0.0)
    return middle, np.where(bounded, high - middle, np.inf)


def kinematic_limits(limits: Limits) -> tuple[Array, Array]:
    """Limits by derivative order as |q⁽ᵒ⁾ − middle| ≤ bound, both of shape (4, nv)."""
    middle, half = position_range(limits)
    zero = np.zeros_like(middle)
    return (
        np.stack([middle, zero, zero, zero]),
        np.stack([half, limits.velocity, limits.acceleration, limits.jerk]),
    )


def check(robot: Robot, motion: Motion | Trajectory) -> LimitReport:
    """Worst use of every limit of the robot over a continuous motion.

    A trajectory is judged at its exact extrema, over one period; a sampled motion
    between its samples too, along the quintic Hermite interpolant of q, q̇ and q̈. Torque is
    that of the rigid bodies and the robot's effects, located by cubic interpolation of a fine
    grid and evaluated at the interpolant's extrema.

    Raises:
        BadInput: The motion has another number of joints, or fewer than two samples.
    """
    if motion.nv != robot.nv:
        raise BadInput(f"motion has {motion.nv} joints, robot {robot.name} has {robot.nv}")
    orders = range(robot.limits.orders)
    if isinstance(motion, Trajectory):
        uses = [_exact_use(robot, motion, order) for order in orders]
        n = _PER_HARMONIC * max(motion.harmonics, 1)
        t, path = np.linspace(0.0, motion.period, n + 1), motion
        stops = motion.extremum_times(0).ravel()
        tau = _torque_use(robot, path, t, stops)
        return LimitReport(uses[0], uses[1], uses[2], tau, *uses[3:])
    if len(motion) < 2:
        raise BadInput(f"motion has {len(motion)} samples, at least two are needed")
    spline = HermiteTrajectory(motion)
    share = np.arange(_PER_SAMPLE) / _PER_SAMPLE
    fine = (motion.t[:-1, None] + share * np.diff(motion.t)[:, None]).ravel()
    fine = np.append(fine, motion.t[-1])
    uses = [_sampled_use(robot, spline, order, fine) for order in orders]
    tau = _torque_use(robot, spline, fine, _reversals(spline, fine))
    return LimitReport(uses[0], uses[1], uses[2], tau, *uses[3:])


def within_limits(robot: Robot, trajectory: Trajectory) -> Trajectory | None:
    """The trajectory, shrunk towards its middle by what it exceeds a limit; None if that fails.

    Meant for an excess of a small share of a limit: the middle is a pose, and torque need not
    fall on the way there.
    """
    X = trajectory.coefficients
    centre = trajectory.series.constant(trajectory.series.mean(X))
    for _ in range(_SHRINKS):
        excess = check(robot, trajectory).worst.ratio - 1
        if excess <= 0:
            return trajectory
        X = centre + (1 - 2 * excess - 1e-7) * (X - centre)
        trajectory = trajectory.series.trajectory(X)
    return None


def _use(robot: Robot, order: int, away: Array, times: Array) -> LimitUse:
    """Use of a kinematic limit by the largest distance from the middle, with its sign, (nv,)."""
    middle, bound = (x[order] for x in kinematic_limits(robot.limits))
    limit = middle + np.copysign(bound, away)
    ratios = np.abs(away) / bound
    return LimitUse(KINEMATIC[order], ratios, times, middle + away, limit, robot.joints)


def _exact_use(robot: Robot, trajectory: Trajectory, order: int) -> LimitUse:
    times, values = trajectory.extrema_in_time(order)
    away = values - kinematic_limits(robot.limits)[0][order]
    k, joints = np.abs(away).argmax(axis=0), np.arange(robot.nv)
    return _use(robot, order, away[k, joints], times[k, joints])


def _sampled_use(robot: Robot, spline: HermiteTrajectory, order: int, t: Array) -> LimitUse:
    middle = kinematic_limits(robot.limits)[0][order]
    away, times = largest(lambda s: spline(s, order) - middle, lambda s: spline(s, order + 1), t)
    return _use(robot, order, away, times)


def _torque_use(
    robot: Robot, path: Trajectory | HermiteTrajectory, t: Array, stops: Array
) -> LimitUse:
    """Torque over continuous time; just before and after ``stops`` friction may jump."""
    if np.all(np.isinf(robot.limits.torque)):
        zero = np.zeros(robot.nv)
        return LimitUse("torque", zero, zero, zero, robot.limits.torque, robot.joints)
    dt = 1e-6 * float(np.median(np.diff(t)))
    if robot.effects:
        beside = np.concatenate([stops - 1e-3 * dt, stops + 1e-3 * dt])
        t = np.unique(np.clip(np.concatenate([t, beside]), t[0], t[-1]))

    def tau(s: Array) -> Array:
        return largest_torque(robot, path.at(s))

    def rate(s: Array) -> Array:
        ahead, behind = np.minimum(s + dt, t[-1]), np.maximum(s - dt, t[0])
        slope: Array = (tau(ahead) - tau(behind)) / (ahead - behind)[:, None]
        return slope

    peak, times = largest(tau, rate, t)
    limit = robot.limits.torque
    ratios = np.abs(peak) / limit
    return LimitUse("torque", ratios, times, peak, np.copysign(limit, peak), robot.joints)


def _reversals(spline: HermiteTrajectory, t: Array) -> Array:
    """Instants at which a joint changes direction, by linear interpolation of its velocity."""
    v = spline(t, 1)
    k, joint = np.nonzero(v[:-1] * v[1:] < 0)
    before, after = v[k, joint], v[k + 1, joint]
    crossing: Array = t[k] + (t[k + 1] - t[k]) * before / (before - after)
    return crossing
