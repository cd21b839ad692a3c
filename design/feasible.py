"""Trajectories within all limits to start from, and why there may be none."""

from dataclasses import dataclass

import numpy as np

from excitant.design.constraints import kinematic_limits, pose_use, position_range
from excitant.design.trajectory import FourierSeries, Trajectory, resting_series
from excitant.exceptions import Infeasible
from excitant.robots.geometry import Scene
from excitant.robots.motion import Array, Motion, numbered
from excitant.robots.robot import Robot
from excitant.robots.torque import largest_torque


@dataclass(frozen=True)
class StartSettings:
    """How a motion within all limits is drawn at random."""

    poses: int = 2000
    "Poses that are tried for one within torque limits and clearance."
    rounds: int = 30
    "Rounds in which these are drawn, nearer and nearer to the best."
    draws: int = 20
    "Motions that are drawn, of which the first feasible one is taken."
    shrinks: int = 40
    "Attempts to shrink a motion until it is feasible."
    widenings: int = 4
    "Shares tried for each joint between all of its motion and what all joints may."
    samples: int = 32
    "Samples per harmonic at which torque and clearance are judged."
    harmonics: int = 10
    "Highest harmonic of a random motion."
    torque_share: float = 0.99
    "Share of the torque limits at the samples, which leaves room between them."


START = StartSettings()


def random_trajectory(
    robot: Robot, rng: np.random.Generator, duration: float, harmonics: int
) -> Trajectory:
    """A random Fourier series at rest at both ends and within all limits of the robot.

    The duration is its period [s].

    Raises:
        BadInput: The duration is not positive, or there are fewer than 2 harmonics.
        Infeasible: No pose, or no motion found, within position and torque limits.
    """
    return random_start(robot, rng, resting_series(duration, harmonics))


def random_start(
    robot: Robot,
    rng: np.random.Generator,
    series: FourierSeries,
    scene: Scene | None = None,
    required: float = 0.0,
) -> Trajectory:
    """A random trajectory of a series, as `random_trajectory`; bodies of a scene apart [m]."""
    t = series.instants(START.samples)

    def uses(trajectory: Trajectory) -> Array:
        """Of each torque limit, and of the clearance."""
        apart = pose_use(scene, required, trajectory(t)).max()
        return np.append(torque_use(robot, trajectory.at(t)), apart)

    drawn: list[tuple[float, int, Trajectory]] = []
    for k in range(START.draws):
        trajectory = _draw(robot, rng, series)
        drawn.append((float(uses(trajectory).max()), k, trajectory))
        if drawn[-1][0] <= START.torque_share:
            return trajectory
    best = min(drawn)[2]
    X0 = series.constant(_standstill(robot, rng, scene, required))
    way = best.coefficients - X0
    for share in 0.7 ** np.arange(1, START.shrinks):
        *use, apart = uses(series.trajectory(X0 + share * way))
        if max(*use, apart) > START.torque_share:
            continue
        shares = np.full(robot.nv, share)
        for j in rng.permutation(robot.nv):  # what one joint must not, another may
            for more in share ** np.linspace(0, 1, START.widenings, endpoint=False):
                wider = np.where(np.arange(robot.nv) == j, more, shares)
                if (
                    uses(series.trajectory(X0 + wider * way)).max()
                    <= START.torque_share
                ):
                    shares = wider
                    break
        return series.trajectory(X0 + shares * way)
    if max(use) <= START.torque_share:
        raise Infeasible(
            f"trajectory of {robot.name}",
            "every motion tried comes too close to an obstacle or to the arm itself; lower the "
            "required clearance or widen the position limits",
        )
    raise Infeasible(
        f"trajectory of {robot.name}",
        f"torque limit of joint {robot.joints[int(np.argmax(use))]} is exceeded by every motion "
        f"tried, however slow (down to {max(use):.4g} times the limit); raise the torque limit",
    )


def torque_use(robot: Robot, motion: Motion) -> Array:
    """Largest torque over its limit per joint at the instants of a motion, shape (nv,)."""
    return (np.abs(largest_torque(robot, motion)) / robot.limits.torque).max(axis=0)


def _draw(
    robot: Robot, rng: np.random.Generator, series: FourierSeries
) -> Trajectory:
    """Random waves, scaled joint by joint into the kinematic limits."""
    middle, half = position_range(robot.limits, np.pi)
    bound = kinematic_limits(robot.limits)[1]
    waves = FourierSeries(series.period, min(series.harmonics, START.harmonics))
    fade = 1 / np.arange(1, waves.harmonics + 1)[:, None] ** rng.uniform(0.0, 2.0)
    X = rng.normal(size=(waves.size, robot.nv))
    X[1:] *= np.vstack([fade, fade])
    X[0] = 0.0
    X = waves.rest @ (waves.rest.T @ X)
    X[0] = 0.0
    X = series.nearest(waves.trajectory(X))
    moved = series.trajectory(X)
    reach = [
        np.maximum(*(np.abs(e) for e in moved.extrema(k)))
        for k in range(len(bound))
    ]
    shift = (
        rng.uniform(0.0, 0.6, robot.nv) * rng.choice([-1.0, 1.0], robot.nv) * half
    )
    room = [half - np.abs(shift), *bound[1:]]
    share = np.min(
        [b / np.maximum(r, 1e-12) for b, r in zip(room, reach, strict=True)], axis=0
    )
    X = X * share * rng.uniform(0.5, 0.99, robot.nv)
    return series.trajectory(X + series.constant(middle + shift))


def _standstill(
    robot: Robot, rng: np.random.Generator, scene: Scene | None, required: float
) -> Array:
    """A pose that all limits allow, shape (nv,): the best random one, improved around itself."""
    middle, half = position_range(robot.limits, np.pi)
    width = 1.0
    pose = middle
    best = np.inf
    use = np.zeros(robot.nv)
    apart = 0.0
    for _ in range(START.rounds):
        poses = pose + width * half * rng.uniform(
            -1, 1, (START.poses // START.rounds * 2, robot.nv)
        )
        poses = np.clip(poses, middle - half, middle + half)
        zero = np.zeros_like(poses)
        held = numbered(poses, zero, zero)
        uses = np.abs(largest_torque(robot, held)) / robot.limits.torque
        near = pose_use(scene, required, poses)
        worst = np.maximum(uses.max(axis=1), near)
        k = int(worst.argmin())
        if worst[k] < best:
            best = float(worst[k])
            pose = poses[k]
            use = uses[k]
            apart = float(near[k])
        width *= 0.8
    if best < START.torque_share:
        return pose
    if scene is not None and apart >= use.max():
        distance = scene.distances(pose[None])[0]
        pair = scene.pairs[int(distance.argmin())]
        least = 1e3 * float(distance.min())
        raise Infeasible(
            f"trajectory of {robot.name}",
            f"every pose tried is too close to an obstacle or to the arm itself: at best, "
            f"{pair[0]} and {pair[1]} are {least:.3g} mm apart, required {1e3 * required:.3g} mm; "
            "lower the required clearance, move the obstacles or the floor (--floor, --no-floor), "
            "or widen the position limits",
        )
    tight = np.flatnonzero(use >= 0.999 * best).tolist()
    limit = ", ".join(
        f"{robot.limits.torque[j]:.4g} {robot.torque_unit(joint=j)}" for j in tight
    )
    raise Infeasible(
        f"trajectory of {robot.name}",
        f"torque limit of {', '.join(robot.joints[j] for j in tight)} ({limit}) is below what "
        f"gravity needs at every pose within the position limits (at least {best:.3g} times the "
        "limit); raise the torque limit or widen the position limits",
    )
