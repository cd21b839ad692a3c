"""Motion to an excitation and back: time-optimal speed along a path that keeps all limits."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

from excitant.design.constraints import check
from excitant.exceptions import BadInput, Infeasible
from excitant.robots.geometry import Scene
from excitant.robots.motion import Array, Motion, interpolated, numbered, read_only
from excitant.robots.robot import Robot
from excitant.robots.torque import largest_torque, torque

# rad/s² or m/s², of a joint with neither acceleration nor torque limit
DEFAULT_ACCELERATION = 10.0
# share of a torque limit that holding the arm may take; the rest moves it
HOLDING = 0.95

# between checked poses: rad of a revolute joint, m of a prismatic one
_RESOLUTION = (0.02, 0.005)
# rad or m between control points
_SPACINGS = (
    1.0,
    0.5,
    0.25,
    0.1,
    0.05,
    0.02,
    0.01,
)


@dataclass(frozen=True)
class PathSearch:
    """The search for a path around obstacles, by rapidly exploring trees."""

    samples: int = 1000
    "Via points that are tried."
    reach: float = 0.4
    "Longest branch that a tree grows at once [rad or m]."
    shortcuts: int = 60
    "Random shortcuts that are tried."


PATH_SEARCH = PathSearch()


@dataclass(frozen=True)
class Timing:
    """How a path is timed, and how its limits are made to hold between samples."""

    unlimited_speed: float = 1e4
    "Stands for no limit on a joint speed, in units of the path."
    stages: int = 300
    "Intervals of the path, at least."
    stages_per_piece: int = 8
    "Intervals of each polynomial piece, at least."
    passes: int = 8
    "Linearisations of friction in the squared speed, at most."
    settled: float = 5e-4
    "Relative change of the duration below which they end."
    slowings: int = 46
    "Attempts to hold the limits between samples by a lower speed."


TIMING = Timing()


Edge = Callable[[Array, Array], bool]
Branch = list[Array]  # poses from the root of a tree to one of its nodes
Dynamics = tuple[Array, Array, Array]  # a, b and c


def approach(
    robot: Robot,
    start: npt.ArrayLike,
    goal: npt.ArrayLike,
    *,
    scene: Scene | None = None,
    clearance: float = 0.0,
    rate_hz: float = 100.0,
    rng: np.random.Generator | None = None,
    name: str = "approach",
) -> Motion:
    """Fastest motion from rest at one pose to rest at another, to or from an excitation.

    The path is the straight line in joint space, or leads around where that comes too close to an
    obstacle or through a pose that the motors cannot hold. Its speed is that of TOPP-RA (Pham and
    Pham 2018) under the limits on velocity, acceleration and torque, the robot's effects included;
    a joint with neither acceleration nor torque limit gets `DEFAULT_ACCELERATION`. At both ends
    q̇ = q̈ = 0. All limits hold between samples too, in the sense of `check`.

    Args:
        robot: Arm with its limits and effects.
        start: Present pose, shape (nv,) [rad or m].
        goal: Pose to reach, shape (nv,) [rad or m].
        scene: The arm's bodies among obstacles; None to leave clearance out.
        clearance: Smallest distance that they keep [m].
        rate_hz: Control rate of the samples [Hz].
        rng: Source of via points; seeded with 0 by default.
        name: What an error says has failed.

    Raises:
        BadInput: Poses of another size or outside the limits, or a rate that makes no sense.
        Infeasible: No way was found, or a pose needs more torque than the limit against gravity.
    """
    if not 1 <= rate_hz <= 10_000:
        raise BadInput(f"{name}: rate {rate_hz:g} Hz: give 1 to 10000 Hz")
    ends = [
        _end_pose(robot, values, scene, clearance, (name, which))
        for which, values in (("start", start), ("goal", goal))
    ]
    if np.array_equal(ends[0], ends[1]):
        return _still(ends[0], np.array([0.0, 1.0 / rate_hz]))
    rng = np.random.default_rng(0) if rng is None else rng
    path = _free_path(robot, ends[0], ends[1], scene, clearance, rng)
    if isinstance(path, str):
        raise Infeasible(
            name,
            f"{path} of the straight line and no way around was found; choose another pose",
        )
    return timed(robot, path, rate_hz, name)


def _end_pose(
    robot: Robot,
    values: npt.ArrayLike,
    scene: Scene | None,
    clearance: float,
    what: tuple[str, str],
) -> Array:
    """A pose within the limits that the motors can hold and that is clear of obstacles."""
    name, which = what
    try:
        pose = read_only(values)
    except (TypeError, ValueError):
        raise BadInput(f"{name}: {which} is not a list of numbers") from None
    if pose.shape != (robot.nv,):
        raise BadInput(
            f"{name}: {which} has shape {pose.shape}, expected ({robot.nv},) for the {robot.nv} "
            f"joints of {robot.name}"
        )
    low, high = robot.limits.position.T
    hair = 1e-9 * np.maximum(1.0, np.abs(pose))
    for j in np.flatnonzero(
        ~((pose >= low - hair) & (pose <= high + hair) & np.isfinite(pose))
    ):
        raise BadInput(
            f"{name}: {which}: joint {robot.joints[j]} at {pose[j]:.6g} is outside its limits "
            f"{low[j]:.6g} to {high[j]:.6g}"
        )
    if unheld := _unheld(robot, _still(pose, np.zeros(1))):
        raise Infeasible(
            name, f"{unheld[0]} in the {which} pose; choose another pose"
        )
    distance = np.inf if scene is None else float(scene.distances(pose[None]).min())
    if not distance >= clearance:
        raise Infeasible(
            name,
            f"the {which} pose has a clearance of {distance:.4g} m, needed are "
            f"{clearance:.4g} m; choose another pose",
        )
    return pose


def _unheld(robot: Robot, motion: Motion) -> tuple[str, int] | None:
    """The joint that cannot hold the arm with torque to spare, and the instant, if any."""
    bound = robot.limits.torque
    share = np.abs(largest_torque(robot, motion)) / bound
    k, j = np.unravel_index(int(share.argmax()), share.shape)
    if share[k, j] <= HOLDING:
        return None
    unit = robot.torque_unit(joint=int(j))
    return (
        f"joint {robot.joints[j]} needs {share[k, j] * bound[j]:.4g} {unit} to hold the arm, more "
        f"than {100 * HOLDING:.0f} % of its torque limit of {bound[j]:.4g} {unit}"
    ), int(k)


def _still(pose: Array, t: Array) -> Motion:
    q = np.tile(pose, (len(t), 1))
    return Motion(t, q, np.zeros_like(q), np.zeros_like(q))


@dataclass(frozen=True, eq=False)
class Path:
    """Twice differentiable curve q(s), 0 ≤ s ≤ 1, of polynomial pieces, as toppra takes it."""

    spline: scipy.interpolate.BSpline
    pieces: int
    path_interval = np.array([0.0, 1.0])

    def __call__(self, s: npt.ArrayLike, order: int = 0) -> Array:
        """Evaluate the path or its derivative with respect to s, shape (n, nv)."""
        return self.spline(np.asarray(s, float), order)

    @property
    def travel(self) -> Array:
        """Distances of the joints between poses along the path, shape (m, nv) [rad or m]."""
        coarse = self(np.linspace(0.0, 1.0, 20 * self.pieces + 1))
        return np.abs(np.diff(coarse, axis=0))

    @property
    def dof(self) -> int:
        """Number of joints."""
        return int(self.spline.c.shape[1])


def rounded_path(waypoints: Array, spacing: float = 1.0) -> Path:
    """Polyline with rounded corners: the variation-diminishing cubic spline (Schoenberg 1967).

    Its control points lie on the polyline of differing corners (k, nv), about ``spacing`` apart
    [rad or m], at the Greville abscissae: it has the same ends and stays in the corners' hull.
    """
    length = _lengths(waypoints)
    pieces = (
        1 if len(waypoints) == 2 else max(4, int(np.ceil(length[-1] / spacing)))
    )
    knots = np.concatenate([np.zeros(3), np.linspace(0, 1, pieces + 1), np.ones(3)])
    greville = (knots[1:-3] + knots[2:-2] + knots[3:-1]) / 3
    control = interpolated(greville, length / length[-1], waypoints)
    control[0] = waypoints[0]
    control[-1] = waypoints[-1]
    return Path(scipy.interpolate.BSpline(knots, control, 3), pieces)


def _free_path(
    robot: Robot,
    start: Array,
    goal: Array,
    scene: Scene | None,
    clearance: float,
    rng: np.random.Generator,
) -> Path | str:
    """The straight path, else one around what obstructs it, else what obstructs it."""

    def blocking(waypoints: Array, spacing: float = 1.0) -> str | None:
        return _obstruction(
            robot, rounded_path(waypoints, spacing), scene, clearance
        )

    def free(a: Array, b: Array) -> bool:
        return np.array_equal(a, b) or blocking(np.stack([a, b])) is None

    straight = np.stack([start, goal])
    blocked = blocking(straight)
    if blocked is None:
        return rounded_path(straight)
    waypoints = _detour(robot, start, goal, free, rng)
    for spacing in _SPACINGS:
        if waypoints is not None and blocking(waypoints, spacing) is None:
            return rounded_path(waypoints, spacing)
    return blocked


def _obstruction(
    robot: Robot, path: Path, scene: Scene | None, clearance: float
) -> str | None:
    travel = path.travel / np.where(robot.revolute, *_RESOLUTION)
    s = np.linspace(0.0, 1.0, max(8, int(np.ceil(travel.max(axis=1).sum()))) + 1)
    q = path(s)
    if unheld := _unheld(robot, _creeping(q, path(s, 1))):
        return f"{unheld[0]} at {100 * s[unheld[1]]:.3g} %"
    if scene is not None:
        distance = scene.distances(q).min(axis=1)
        for k in np.flatnonzero(~(distance >= clearance))[:1]:
            return (
                f"clearance is {distance[k]:.4g} m, needed are {clearance:.4g} m, "
                f"at {100 * s[k]:.3g} %"
            )
    return None


def static_torque(robot: Robot, q: Array, direction: Array) -> Array:
    """Torque that holds poses while they begin to move, gravity and dry friction, (n, nv) [N·m]."""
    return torque(robot, _creeping(q, direction))


def _creeping(q: Array, direction: Array) -> Motion:
    creep = (
        1e-6 * direction / max(float(np.abs(direction).max(initial=0.0)), 1e-300)
    )
    return numbered(q, creep, np.zeros_like(q))


def _lengths(waypoints: Array) -> Array:
    return np.append(
        0.0, np.cumsum(np.linalg.norm(np.diff(waypoints, axis=0), axis=1))
    )


def _detour(
    robot: Robot, start: Array, goal: Array, free: Edge, rng: np.random.Generator
) -> Array | None:
    """Waypoints (k, nv) over free segments, by RRT-Connect (Kuffner and LaValle 2000), or None."""
    # at most half a turn beyond the box of start and goal
    around = np.stack(
        [np.minimum(start, goal) - np.pi, np.maximum(start, goal) + np.pi]
    )
    low, high = np.clip(around, *robot.limits.position.T)
    trees = [[[start]], [[goal]]]
    edges = [free, lambda a, b: free(b, a)]  # the way back from goal
    for count in range(PATH_SEARCH.samples):
        order = slice(None, None, -1 if count % 2 else 1)
        (here, there) = trees[order]
        (edge, back) = edges[order]
        grown = _grow(here, rng.uniform(low, high), edge, once=True)
        if grown is None:
            continue
        met = _grow(there, grown[-1], back, once=False)
        if met is not None and np.array_equal(met[-1], grown[-1]):
            first, second = (grown, met)[order]
            return _shortened(np.array(first + second[-2::-1]), free, rng)
    return None


def _grow(
    tree: list[Branch], target: Array, free: Edge, *, once: bool
) -> Branch | None:
    ends = np.array([branch[-1] for branch in tree])
    branch = tree[int(np.linalg.norm(ends - target, axis=1).argmin())]
    added = None
    while True:
        ahead = target - branch[-1]
        distance = float(np.linalg.norm(ahead))
        pose = (
            target
            if distance <= PATH_SEARCH.reach
            else branch[-1] + ahead * (PATH_SEARCH.reach / distance)
        )
        if distance == 0 or not free(branch[-1], pose):
            return added
        branch = added = [*branch, pose]
        tree.append(branch)
        if once or pose is target:
            return added


def _shortened(waypoints: Array, free: Edge, rng: np.random.Generator) -> Array:
    for _ in range(PATH_SEARCH.shortcuts):
        length = _lengths(waypoints)
        cut = np.sort(rng.uniform(0.0, length[-1], 2))
        a, b = interpolated(cut, length, waypoints)
        if free(a, b):
            before = waypoints[length < cut[0]]
            after = waypoints[length > cut[1]]
            waypoints = np.vstack([before, a, b, after])
    kept = np.append(
        True, np.linalg.norm(np.diff(waypoints, axis=0), axis=1) > 1e-9
    )
    return waypoints[kept]


def timed(robot: Robot, path: Path, rate_hz: float, name: str = "timing") -> Motion:
    """The fastest motion along a path from rest to rest, all limits held between samples too.

    Where the samples [Hz] exceed a limit, the motion is slowed down as a whole.
    """
    profile = time_optimal(robot, path, name=name)
    for factor in (1.0, *(1 + 1e-3 * 1.25 ** np.arange(TIMING.slowings))):
        motion = replace(profile, speed=profile.speed / factor).motion(
            path, rate_hz
        )
        uses = check(robot, motion).uses[1:4]  # of speed, acceleration and torque
        if all(use.ratio <= 1 for use in uses):
            return motion
    worst = max(uses, key=lambda use: use.ratio)
    raise Infeasible(
        name,
        f"the {worst.quantity} limit of joint {worst.joint} does not hold at any speed; choose "
        "another path or raise it",
    )


@dataclass(frozen=True, eq=False)
class Profile:
    """Speed ṡ [1/s] at positions s of a path from 0 to 1, both (n,), with constant s̈ between."""

    s: Array
    speed: Array

    @property
    def t(self) -> Array:
        """When each position is reached, shape (n,) [s]."""
        return np.append(
            0.0, np.cumsum(2 * np.diff(self.s) / (self.speed[:-1] + self.speed[1:]))
        )

    @property
    def duration(self) -> float:
        """Time from 0 to 1 [s]."""
        return float(self.t[-1])

    def _positions(self, n: int) -> Array:
        t = self.t
        instants = np.linspace(0.0, t[-1], n)
        i = np.clip(np.searchsorted(t, instants, side="right") - 1, 0, len(t) - 2)
        into = instants - t[i]
        rate = (self.speed[i + 1] - self.speed[i]) / (t[i + 1] - t[i])
        s = np.clip(self.s[i] + self.speed[i] * into + rate * into**2 / 2, 0.0, 1.0)
        s[0] = 0.0
        s[-1] = 1.0
        return s

    def motion(self, path: Path, rate_hz: float) -> Motion:
        """Samples of the path at a control rate [Hz], with q̇ = q̈ = 0 at both ends.

        The positions at the control instants are control points of a uniform cubic spline s(t),
        nowhere faster nor more accelerated than the profile, and up to three samples longer.
        """
        n = max(1, int(np.ceil(self.duration * rate_hz - 1e-9)))
        control = np.concatenate([np.zeros(2), self._positions(n + 1), np.ones(2)])
        before = control[:-2]
        now = control[1:-1]
        after = control[2:]
        s = (before + 4 * now + after) / 6
        ds = ((after - before) * rate_hz / 2)[:, None]
        dds = ((after - 2 * now + before) * rate_hz**2)[:, None]
        dq = path(s, 1)
        t = np.arange(len(s)) / rate_hz
        return Motion(t, path(s), dq * ds, dq * dds + path(s, 2) * ds**2)


def time_optimal(robot: Robot, path: Path, *, name: str = "timing") -> Profile:
    """Fastest speed along a path from rest to rest, by TOPP-RA (Pham and Pham 2018).

    Friction that depends on the speed is linearised in its square at the result before, until
    the duration settles.
    """
    s = np.linspace(
        0.0, 1.0, max(TIMING.stages, TIMING.stages_per_piece * path.pieces) + 1
    )
    limits = robot.limits
    unlimited = np.isinf(limits.acceleration) & np.isinf(limits.torque)
    acceleration = np.where(unlimited, DEFAULT_ACCELERATION, limits.acceleration)
    way = path.travel.sum(axis=0)
    finite = np.where(np.isinf(acceleration), DEFAULT_ACCELERATION, acceleration)
    unit = float(
        np.max(np.maximum(way / limits.velocity, 2 * np.sqrt(way / finite)))
    )
    profile = None
    for _ in range(TIMING.passes):
        speed = None if profile is None else profile.speed
        dynamics = _dynamics(robot, path, s, speed)
        faster = _topp(
            path, s, limits.velocity, (acceleration, limits.torque), dynamics, unit
        )
        if faster is None:
            break
        settled = (
            profile is not None and abs(faster.duration / unit - 1) < TIMING.settled
        )
        profile = faster
        unit = faster.duration
        if settled:
            break
    if profile is None:
        raise Infeasible(
            name, "no speed along the path holds the limits; choose another path"
        )
    return profile


def _dynamics(robot: Robot, path: Path, s: Array, speed: Array | None) -> Dynamics:
    """a, b and c of τ = a s̈ + b ṡ² + c, each (n, nv) (Bobrow et al. 1985)."""
    q = path(s)
    dq = path(s, 1)
    ddq = path(s, 2)
    zero = np.zeros_like(q)

    def tau(v: Array, a: Array) -> Array:
        return torque(robot, Motion(s, q, v, a))

    rest = tau(zero, zero)
    a = tau(zero, dq) - rest
    b = (tau(dq, ddq) + tau(-dq, ddq)) / 2 - rest
    c = static_torque(robot, q, dq)
    if speed is None or not robot.effects:
        return a, b, c
    v = speed[:, None]
    friction = tau(v * dq, v**2 * ddq) - b * v**2 - c
    b = b + np.divide(
        friction, v**2, out=np.zeros_like(b), where=v > 1e-6 * speed.max()
    )
    return a, b, c


def _topp(
    path: Path,
    s: Array,
    velocity: Array,
    bounds: tuple[Array, Array],
    dynamics: Dynamics,
    unit: float,
) -> Profile | None:
    """Fastest ṡ with |q' ṡ|, |q' s̈ + q'' ṡ²| and |a s̈ + b ṡ² + c| bounded, in a unit of time."""
    from toppra.algorithm import TOPPRA
    from toppra.constraint import JointVelocityConstraint

    kinematics = (path(s, 1), path(s, 2), np.zeros((len(s), path.dof)))
    limits = [
        JointVelocityConstraint(np.minimum(velocity * unit, TIMING.unlimited_speed))
    ]
    for parts, bound in zip((kinematics, dynamics), bounds, strict=True):
        if np.isfinite(bound).any():
            limits.append(_linear_constraint(parts, bound, unit))
    problem = TOPPRA(limits, path, gridpoints=s, solver_wrapper="seidel")
    speed = problem.compute_parameterization(0.0, 0.0)[1]
    if (
        speed is None
        or not np.isfinite(speed).all()
        or np.any(speed[:-1] + speed[1:] <= 0)
    ):
        return None
    return Profile(s, speed / unit)


def _linear_constraint(dynamics: Dynamics, bound: Array, unit: float) -> Any:
    """The constraint |a s̈ + b ṡ² + c| ≤ bound as toppra takes it, at both ends of each stage."""
    from toppra.constraint import DiscretizationType, LinearConstraint
    from toppra.constraint.linear_constraint import canlinear_colloc_to_interpolate

    bounded = np.isfinite(bound)
    a, b, c = ((part / bound)[:, bounded] for part in dynamics)
    a = np.hstack([a, -a]) / unit**2
    b = np.hstack([b, -b]) / unit**2
    c = np.hstack([c, -c])
    F = np.eye(a.shape[1])
    g = np.ones(a.shape[1])
    constraint = LinearConstraint()
    constraint.identical = True
    constraint.set_discretization_type(DiscretizationType.Interpolation)
    constraint.compute_constraint_params = lambda path, grid: (
        canlinear_colloc_to_interpolate(
            a, b, c, F, g, None, None, grid, identical=True
        )
    )
    return constraint
