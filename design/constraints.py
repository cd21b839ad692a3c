"""Limits of a motion and its clearance from obstacles and itself, in continuous time."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any

import numpy as np
import scipy

from excitant.design.trajectory import HermiteTrajectory, Trajectory
from excitant.exceptions import BadInput, OutsideLimits
from excitant.robots.geometry import Scene
from excitant.robots.limits import Limits
from excitant.robots.motion import Array, Motion, Noun
from excitant.robots.robot import Robot
from excitant.robots.torque import largest_torque

KINEMATIC = ("position", "velocity", "acceleration", "jerk")  # by derivative order

_ONE_SIDED = 4 * np.pi  # width given to a range that is bounded on one side only

SCALE = (
    0.1  # m of missing clearance that count like a limit exceeded by its own size
)


@dataclass(frozen=True)
class Certification:
    """How limits and clearance are certified between samples."""

    per_harmonic: int = 100
    "Instants per period of the highest harmonic at which torque is evaluated."
    per_sample: int = 8
    "The same per sampling interval of a recorded motion."
    shrinks: int = 30
    "Attempts to shrink a motion until all limits hold."
    resolution: float = 1e-3
    "Distance [m] to which the smallest clearance is bounded."
    intervals: int = 200
    "Intervals of time with which branch and bound begins."
    poses: int = 200_000
    "Poses beyond which the bound stays looser than the resolution."


CERTIFICATION = Certification()


Extrema = Array
"""Smallest values, when, largest values, when; shape (4, nv)."""


@dataclass(frozen=True, eq=False)
class LimitUse(Noun):
    """Use of one limit: the largest magnitude as a share of it; ≤ 1 holds."""

    quantity: str  # ``"position"``, ``"velocity"``, ``"acceleration"``, ``"jerk"`` or ``"torque"``
    ratios: Array  # per joint largest |value − middle of the range| over limit; 0 without one
    times: Array  # when each joint's largest ratio occurs, shape (nv,) [s]
    low: Array  # smallest value per joint, between samples too, shape (nv,)
    high: Array  # largest value, shape (nv,)
    limits: Array  # lower and upper limit, infinite without one, shape (nv, 2)
    joints: tuple[str, ...]  # names of the joints

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
        """Raise `OutsideLimits` with the worst joint, value and limit if one is exceeded."""
        if self.ratio > 1.0:
            j = int(self.ratios.argmax())
            above = self.high[j] - self.limits[j, 1]
            below = self.limits[j, 0] - self.low[j]
            side = int(above > below)
            value = (self.low[j], self.high[j])[side]
            limit = self.limits[j, side]
            raise OutsideLimits(
                self.joint, self.quantity, float(value), float(limit), self.time
            )

    def certified(self) -> list[dict[str, float] | None]:
        """Each joint's ``low``, ``high``, largest ``ratio`` and its ``t`` [s]; None unlimited."""
        names = ("low", "high", "ratio", "t")
        table = np.stack(
            [self.low, self.high, self.ratios, self.times], axis=1
        ).tolist()
        return [
            dict(zip(names, row, strict=True))
            if np.isfinite(limits).all()
            else None
            for row, limits in zip(table, self.limits, strict=True)
        ]


@dataclass(frozen=True, eq=False)
class LimitReport:
    """Worst use of every limit over a continuous motion; of jerk only with a limit on it."""

    position: LimitUse
    velocity: LimitUse
    acceleration: LimitUse
    torque: LimitUse
    jerk: LimitUse | None = None

    @property
    def uses(self) -> tuple[LimitUse, ...]:
        """Of all limited quantities."""
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

    def entries(self, limits: Limits) -> dict[str, Any]:
        """Entries of result.json, by quantity."""
        uses = {use.quantity: use for use in self.uses}
        values = {name: getattr(limits, name) for name in uses}
        return {
            "limits": {name: use.ratio for name, use in uses.items()},
            "limit_values": {
                name: np.where(np.isfinite(x), x, np.array(None)).tolist()
                for name, x in values.items()
            },
            "worst": {
                name: {"joint": use.joint, "t": use.time, "ratio": use.ratio}
                if use.ratio
                else None
                for name, use in uses.items()
            },
            "certified": {name: use.certified() for name, use in uses.items()},
        }


def position_range(
    limits: Limits, unlimited: float = np.inf
) -> tuple[Array, Array]:
    """Middle and half width of each joint's range, both (nv,) [rad or m].

    Without limits the middle is 0 and the half width ``unlimited``; a range bounded on one side
    only counts as two turns (4π) wide.
    """
    low, high = limits.position.T
    low = np.where(np.isinf(low), high - _ONE_SIDED, low)
    high = np.where(np.isinf(high), low + _ONE_SIDED, high)
    middle = np.add(low, high, out=np.zeros_like(low), where=high < np.inf) / 2
    return middle, np.where(np.isinf(high), unlimited, high - middle)


def kinematic_limits(limits: Limits) -> tuple[Array, Array]:
    """Limits by derivative order as |q⁽ᵒ⁾ − middle| ≤ bound, both of shape (4, nv)."""
    middle, half = position_range(limits)
    bound = np.stack([half, limits.velocity, limits.acceleration, limits.jerk])
    return np.vstack([middle, np.zeros_like(bound[1:])]), bound


def check(robot: Robot, motion: Motion | Trajectory) -> LimitReport:
    """Worst use of every limit of the robot over a continuous motion.

    A trajectory is judged at its exact extrema, over one period; a sampled motion between its
    samples too, along the quintic Hermite interpolant of q, q̇ and q̈. Torque, the robot's effects
    included, is evaluated at the extrema of a cubic interpolant of a fine grid.

    Raises:
        BadInput: The motion has another number of joints, or fewer than two samples.
    """
    if motion.nv != robot.nv:
        raise BadInput(
            f"motion has {motion.nv} joints, robot {robot.name} has {robot.nv}"
        )
    path: Trajectory | HermiteTrajectory
    orders = range(robot.limits.orders)
    if isinstance(motion, Trajectory):
        path = motion
        stops = motion.extrema_in_time(0)[0].ravel()
        t = np.linspace(
            0.0,
            motion.period,
            CERTIFICATION.per_harmonic * max(motion.harmonics, 1) + 1,
        )
        extrema = [
            _extreme(*(part.T for part in motion.extrema_in_time(k)))
            for k in orders
        ]
    else:
        if len(motion) < 2:
            raise BadInput(
                f"motion has {len(motion)} samples, at least two are needed"
            )
        path = HermiteTrajectory(motion)
        share = np.arange(CERTIFICATION.per_sample) / CERTIFICATION.per_sample
        t = (motion.t[:-1, None] + share * np.diff(motion.t)[:, None]).ravel()
        t = np.append(t, motion.t[-1])
        stops = _reversals(path, t)
        extrema = [
            _extrema(partial(path, order=k), partial(path, order=k + 1), t)
            for k in orders
        ]
    limits = zip(KINEMATIC, extrema, *kinematic_limits(robot.limits), strict=False)
    position, velocity, acceleration, *jerk = (
        _use(robot, *quantity) for quantity in limits
    )
    tau = _torque_use(robot, path, t, stops)
    return LimitReport(position, velocity, acceleration, tau, *jerk)


def shares_of_limits(robot: Robot, motion: Motion) -> Array:
    """Shares of the limits that a motion uses at its instants; 0 without a limit.

    Returns:
        Of position, velocity, acceleration and torque, as in `LimitUse`, shape (n, 4, nv).
    """
    middle, bound = kinematic_limits(robot.limits)
    kinematic = np.stack([motion.q, motion.dq, motion.ddq], axis=1) - middle[:3]
    bounds = np.vstack([bound[:3], robot.limits.torque])
    values = np.concatenate(
        [kinematic, largest_torque(robot, motion)[:, None]], axis=1
    )
    with np.errstate(over="ignore"):  # of a limit that is hardly any
        return np.abs(values) / bounds


def within_limits(
    robot: Robot,
    trajectory: Trajectory,
    scene: Scene | None = None,
    least: float = 0.0,
) -> Trajectory | None:
    """The trajectory, shrunk towards its middle by what it exceeds a limit; None if that fails.

    Meant for an excess of a small share of a limit: the middle is a pose, and torque need not
    fall on the way there. With a scene also None if bodies come nearer than ``least`` [m].
    """
    X = trajectory.coefficients
    centre = trajectory.series.constant(trajectory.offset)
    for _ in range(CERTIFICATION.shrinks):
        excess = check(robot, trajectory).worst.ratio - 1
        if excess <= 0:
            apart = scene is None or clearance(scene, trajectory).certified >= least
            return trajectory if apart else None
        X = centre + (1 - 2 * excess - 1e-7) * (X - centre)
        trajectory = trajectory.series.trajectory(X)
    return None


def _use(
    robot: Robot, quantity: str, extrema: Extrema, middle: Array, bound: Array
) -> LimitUse:
    low, t_low, high, t_high = extrema
    below = middle - low > high - middle
    with np.errstate(over="ignore"):  # of a limit that is hardly any
        ratios = np.where(below, middle - low, high - middle) / bound
    times = np.where(below, t_low, t_high)
    limits = np.stack([middle - bound, middle + bound], axis=1)
    return LimitUse(quantity, ratios, times, low, high, limits, robot.joints)


def _torque_use(
    robot: Robot, path: Trajectory | HermiteTrajectory, t: Array, stops: Array
) -> LimitUse:
    """Torque over continuous time; just before and after ``stops`` friction may jump."""
    zero = np.zeros(robot.nv)
    bound = robot.limits.torque
    if np.all(np.isinf(bound)):
        return _use(robot, "torque", np.zeros((4, robot.nv)), zero, bound)
    dt = 1e-6 * float(np.median(np.diff(t)))
    if robot.effects:
        beside = np.concatenate([stops - 1e-3 * dt, stops + 1e-3 * dt])
        t = np.unique(np.clip(np.concatenate([t, beside]), t[0], t[-1]))

    def tau(s: Array) -> Array:
        return largest_torque(robot, path.at(s))

    def rate(s: Array) -> Array:
        ahead = np.minimum(s + dt, t[-1])
        behind = np.maximum(s - dt, t[0])
        return (tau(ahead) - tau(behind)) / (ahead - behind)[:, None]

    return _use(robot, "torque", _extrema(tau, rate, t), zero, bound)


def _reversals(spline: HermiteTrajectory, t: Array) -> Array:
    v = spline(t, 1)
    k, joint = np.nonzero(v[:-1] * v[1:] < 0)
    before = v[k, joint]
    after = v[k + 1, joint]
    return t[k] + (t[k + 1] - t[k]) * before / (before - after)


def _extrema(
    evaluate: Callable[[Array], Array], slope: Callable[[Array], Array], t: Array
) -> Extrema:
    """Extrema of each channel, evaluated where its cubic Hermite interpolant is stationary."""
    value = evaluate(t)
    joined = scipy.interpolate.CubicHermiteSpline(t, value, slope(t)).derivative()
    roots = joined.roots(discontinuity=False, extrapolate=False)
    inside = [times[np.isfinite(times)] for times in roots]
    at = evaluate(np.concatenate(inside)) if any(map(len, inside)) else value[:0]
    parts = np.split(at, np.cumsum([len(times) for times in inside])[:-1])
    return _extreme(
        [np.concatenate([t, times]) for times in inside],
        [np.append(value[:, j], part[:, j]) for j, part in enumerate(parts)],
    )


def _extreme(times: Iterable[Array], values: Iterable[Array]) -> Extrema:
    extremes = [
        (x.min(), t[x.argmin()], x.max(), t[x.argmax()])
        for t, x in zip(times, values, strict=True)
    ]
    return np.array(extremes).T


@dataclass(frozen=True)
class Clearance:
    """Smallest distance over a continuous motion, negative where bodies overlap.

    Of bodies that no motion brings twice the clearance apart, it counts ``scale`` times.
    """

    distance: float  # the smallest found, as it counts [m]
    certified: float  # one that no instant is nearer than, as it counts [m]
    bodies: tuple[str, str]
    time: float  # [s]
    scale: float  # of these bodies' distance


@lru_cache(maxsize=8)
def clearance(scene: Scene, path: Trajectory | HermiteTrajectory) -> Clearance:
    """Smallest distance over one period or between all samples, by branch and bound in time.

    Between two instants a pair's distance falls below neither end by more than half of what
    its bodies can approach each other in that time, a bound from joint speeds and lever arms.
    """
    start, end, speed = _span(path)
    t = np.linspace(start, end, CERTIFICATION.intervals + 1)
    distance = scene.distances(path(t))
    approach = scene.speeds() @ speed  # m/s, per pair
    left = distance[:-1]
    right = distance[1:]
    begin = t[:-1]
    length = t[1] - t[0]
    best = _smallest(scene, distance, t)
    evaluated = len(t)
    while True:
        bound = ((left + right - approach * length) / 2).min(axis=1)
        open_ = bound < best.distance - CERTIFICATION.resolution
        certified = min(
            best.distance - CERTIFICATION.resolution,
            float(bound.min(initial=np.inf)),
        )
        if not open_.any() or evaluated > CERTIFICATION.poses:
            return replace(best, certified=certified)
        left = left[open_]
        right = right[open_]
        begin = begin[open_]
        length = length / 2
        middle = scene.distances(path(begin + length))
        evaluated += len(middle)
        smallest = _smallest(scene, middle, begin + length)
        best = min(best, smallest, key=lambda c: c.distance)
        left = np.vstack([left, middle])
        right = np.vstack([middle, right])
        begin = np.concatenate([begin, begin + length])


def _span(path: Trajectory | HermiteTrajectory) -> tuple[float, float, Array]:
    if isinstance(path, Trajectory):
        return 0.0, path.period, np.abs(path.extrema(1)).max(axis=0)
    t = path.samples.t
    fine = np.linspace(t[0], t[-1], 20 * len(t))
    return float(t[0]), float(t[-1]), 1.05 * np.abs(path(fine, 1)).max(axis=0)


def _smallest(scene: Scene, distance: Array, t: Array) -> Clearance:
    k, pair = np.unravel_index(int(np.argmin(distance)), distance.shape)
    value = float(distance[k, pair])
    return Clearance(
        value, value, scene.pairs[int(pair)], float(t[k]), float(scene.scale[pair])
    )


def pose_use(scene: Scene | None, required: float, q: Array) -> Array:
    """1 where a pose has the distance required [m]; more where it has less, shape (n,)."""
    if scene is None:
        return np.zeros(len(q))
    return 1 + (required - scene.distances(q).min(axis=1)) / SCALE
