"""Motions that drive rival causes apart, within the limits of the arm."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from excitant.analysis.discrimination import Contest, Separation, needed
from excitant.design import CLEARANCE, FourierTrajectory, clearance, random_trajectory
from excitant.design.constraints import kinematic_limits, position_range, within_limits
from excitant.design.feasible import torque_use
from excitant.design.trajectory import FourierSeries, from_coefficients
from excitant.exceptions import Infeasible
from excitant.robots.geometry import Scene
from excitant.robots.motion import Array
from excitant.robots.robot import Limits, Robot

HOPELESS = 4.0  # Δ below which no motion is worth running
_SCREENED, _REFINED = 48, 48  # motions judged, at most
_PLENTY = 6.0  # times the Δ that is needed: more is of no use
_MUCH_BETTER = 1.5  # times the Δ of a motion must another promise to be run too
_TOP_HZ = 2.5  # fastest reversals
_WAVES = (3, 5, 10, 20)  # harmonics of random motions
_HELD = 0.5  # probability that a joint of no interest stands still
_SMALLEST = 0.01  # of the limits: smallest movement of a joint of interest
_SHRINKS, _DRAWS = 6, 8
_TORQUE_SHARE = 0.98
_ROOM = 0.97  # of the limits at the samples
_POSES = 60  # looked at for clearance before it is certified


@dataclass(frozen=True, eq=False)
class Discriminating:
    """A motion with what it tells apart.

    Attributes:
        trajectory: The motion, within all limits.
        separations: One per pair of the contest.
    """

    trajectory: FourierTrajectory
    separations: tuple[Separation, ...]

    @property
    def deltas(self) -> Array:
        """Δ of each pair, shape (pairs,)."""
        return np.array([s.delta for s in self.separations])


def discriminating_motions(
    contest: Contest,
    rng: np.random.Generator,
    *,
    duration: float = 20.0,
    most: int = 3,
    time_limit: float = 15.0,
    scene: Scene | None = None,
) -> tuple[list[Discriminating], Array]:
    """Motions that tell rivals apart, the most telling first.

    Many motions are judged: random ones at several frequencies, and joints of interest that
    reverse within a swelling envelope, from tiny to large, others held or moving. The one that
    settles most pairs is improved by random changes until its smallest Δ is plenty; pairs that it
    leaves open get another.

    Args:
        contest: The rivals.
        rng: Source of randomness.
        duration: Period of each motion [s].
        most: Number of motions, at most.
        time_limit: Time after which the best so far is taken [s].
        scene: Bodies that must keep apart; None to leave clearance out.

    Returns:
        The motions, and for each pair the largest Δ of all motions judged, shape (pairs,).
    """
    deadline = time.monotonic() + time_limit
    screened = time.monotonic() + 0.5 * time_limit
    search = _Search(contest, _within_recording(contest), duration, scene, rng)
    pool = []
    for trajectory in search.drawn(_SCREENED):
        if (judged := search.judged(trajectory)) is not None:
            pool.append(judged)
        if time.monotonic() > screened:
            break
    if not pool:
        return [], np.zeros(len(contest.pairs))
    highest = np.max([motion.deltas for motion in pool], axis=0)
    open_, motions = highest > HOPELESS, list[Discriminating]()
    while open_.any() and len(motions) < most:
        best = search.best(pool, open_)
        served = open_ & (best.deltas > HOPELESS) if best is not None else open_ & False
        if best is None or not served.any():
            break
        left = deadline - time.monotonic()
        best = search.improved(best, served, time.monotonic() + left / (most - len(motions)))
        motions.append(best)
        open_ &= (best.deltas < needed()) & (highest > _MUCH_BETTER * best.deltas)
        highest = np.maximum(highest, best.deltas)
    return motions, highest


@dataclass(frozen=True, eq=False)
class _Search:
    contest: Contest
    robot: Robot
    duration: float
    scene: Scene | None
    rng: np.random.Generator

    def drawn(self, count: int) -> Iterator[FourierTrajectory]:
        """Motions of all kinds, in turn; those that find no way into the limits left out."""
        for k in range(count):
            if k % 4 == 0:
                try:
                    harmonics = _WAVES[(k // 4) % len(_WAVES)]
                    yield random_trajectory(self.robot, self.rng, self.duration, harmonics)
                except Infeasible:
                    continue
            elif (found := self._sweep()) is not None:
                yield found

    def judged(self, trajectory: FourierTrajectory) -> Discriminating:
        """A motion with its separations."""
        information = self.contest.information(self.contest.sampled(trajectory))
        return Discriminating(trajectory, tuple(self.contest.separations(information)))

    def best(self, pool: list[Discriminating], open_: Array) -> Discriminating | None:
        """The motion of a pool that tells most of what is open, of those that keep the limits."""
        for motion in sorted(pool, key=lambda m: -_worth(m.deltas[open_])):
            if self._kept(motion.trajectory) is not None:
                return motion
        return None

    def improved(self, motion: Discriminating, served: Array, until: float) -> Discriminating:
        """A motion whose smallest Δ among the pairs it serves is larger, by random changes."""
        step = 0.5
        for _ in range(_REFINED):
            least = motion.deltas[served].min()
            if least > _PLENTY * needed() or time.monotonic() > until:
                break
            changed = self._changed(motion.trajectory, step)
            other = None if changed is None else self.judged(changed)
            better = other is not None and other.deltas[served].min() > least
            if better and other is not None and self._kept(other.trajectory) is not None:
                motion, step = other, min(1.5 * step, 1.0)
            else:
                step = max(0.85 * step, 0.05)
        kept = self._kept(motion.trajectory)
        return motion if kept is None or kept is motion.trajectory else self.judged(kept)

    def _kept(self, trajectory: FourierTrajectory) -> FourierTrajectory | None:
        """The trajectory within all limits, certified; None where that fails."""
        kept = within_limits(self.robot, trajectory)
        if kept is None or not isinstance(kept, FourierTrajectory):
            return None
        if self.scene is not None:
            poses = kept(np.linspace(0.0, self.duration, _POSES))
            if self.scene.distances(poses).min() < CLEARANCE:
                return None
            if clearance(self.scene, kept).certified < CLEARANCE:
                return None
        return kept

    @property
    def _interest(self) -> set[int]:
        """Joints of any rival, where that is not a matter of all of them."""
        joints: set[int] = set()
        for pair in self.contest.pairs:
            for effect in (pair.found, pair.rival):
                if len(effect.joints) < self.robot.nv:
                    joints |= {self.robot.joint_index(joint) for joint in effect.joints}
        return joints or set(range(self.robot.nv))

    def _sweep(self) -> FourierTrajectory | None:
        """Joints of interest reverse within a swelling envelope; the others rest or wave."""
        series = FourierSeries(self.duration, max(3, round(_TOP_HZ * self.duration)))
        middle, half = position_range(self.robot.limits)
        for _ in range(_DRAWS):
            X = np.zeros((series.size, self.robot.nv))
            share = np.zeros(self.robot.nv)
            for j in range(self.robot.nv):
                if j in self._interest:
                    X[:, j] = _envelope(series, self.rng)
                    share[j] = np.exp(self.rng.uniform(np.log(_SMALLEST), 0.0))
                elif self.rng.uniform() > _HELD:
                    X[:, j] = _wave(series, self.rng)
                    share[j] = self.rng.uniform(0.3, 1.0)
            pose = middle + self.rng.uniform(-0.8, 0.8, self.robot.nv) * half
            if (found := self._fitted(series, X, pose, share)) is not None:
                return found
        return None

    def _changed(self, trajectory: FourierTrajectory, step: float) -> FourierTrajectory | None:
        """A motion nearby: another pose, larger or smaller movements, other waves."""
        series, rng = trajectory.series, self.rng
        X, half = trajectory.coefficients.copy(), position_range(self.robot.limits)[1]
        pose = X[0] + step * 0.3 * half * rng.normal(size=self.robot.nv) * (rng.uniform() < 0.5)
        X[0] = 0.0
        for j in range(self.robot.nv):
            if rng.uniform() < 0.5:
                X[:, j] *= np.exp(step * rng.normal())
            if rng.uniform() < 0.3:
                fresh = _envelope(series, rng) if rng.uniform() < 0.5 else _wave(series, rng)
                X[:, j] += step * rng.uniform() * np.linalg.norm(X[:, j]) * fresh
        return self._fitted(series, X, pose, None)

    def _fitted(
        self, series: FourierSeries, X: Array, pose: Array, share: Array | None
    ) -> FourierTrajectory | None:
        """A movement about a pose, made as large as a share of the limits, or to keep them."""
        t = np.linspace(0.0, self.duration, 8 * series.harmonics + 1)
        middle, half = position_range(self.robot.limits)
        bound = kinematic_limits(self.robot.limits)[1].copy()
        bound[0] = np.maximum(half - np.abs(pose - middle), 0.02 * half)
        pose = np.clip(pose, middle - half + bound[0], middle + half - bound[0])
        reach = np.array([np.abs(series.basis(t, k) @ X).max(axis=0) for k in range(len(bound))])
        with np.errstate(divide="ignore", invalid="ignore"):
            room = np.where(reach > 0, bound / reach, np.inf).min(axis=0)
        room = np.where(np.isfinite(room), _ROOM * room, 0.0)
        X = X * (np.minimum(room, 1.0) if share is None else share * room)
        for _ in range(_SHRINKS):
            trajectory = from_coefficients(X + series.constant(pose), self.duration)
            use = torque_use(self.robot, trajectory.at(t))
            if use.max() <= _TORQUE_SHARE:
                return trajectory
            X = X * 0.7
        return None


def _worth(deltas: Array) -> float:
    """How much a motion settles: pairs first, then how well."""
    if not len(deltas):
        return -np.inf
    return float(np.log(np.clip(deltas, 0.1, _PLENTY * needed())).sum())


def _envelope(series: FourierSeries, rng: np.random.Generator) -> Array:
    """((1 − cos ωt) / 2)^p cos(kωt + φ): reversals that swell and fade, shape (c,), norm 1.

    With p ≥ 2 it is at rest at both ends; its peak speeds range from nothing to the highest.
    """
    p = int(rng.integers(2, 5))
    top = max(series.harmonics - p, 1)
    k = min(round(float(np.exp(rng.uniform(np.log(2), np.log(max(top, 3)))))), top)
    n = 4 * series.harmonics + 4
    angle = 2 * np.pi * np.arange(n) / n
    values = ((1 - np.cos(angle)) / 2) ** p * np.cos(k * angle + rng.uniform(0, 2 * np.pi))
    spectrum = np.fft.rfft(values)[1 : series.harmonics + 1] * 2 / n
    return _at_rest(series, np.concatenate([[0.0], spectrum.real, -spectrum.imag]))


def _wave(series: FourierSeries, rng: np.random.Generator) -> Array:
    """A few random harmonics, low ones mostly, shape (c,), norm 1."""
    h = np.arange(1, series.harmonics + 1)
    top = np.exp(rng.uniform(np.log(2), np.log(series.harmonics)))
    size = np.where(h <= max(top, 3), 1 / h ** rng.uniform(0, 2), 0.0)
    x = rng.normal(size=2 * series.harmonics) * np.concatenate([size, size])
    return _at_rest(series, np.concatenate([[0.0], x]))


def _at_rest(series: FourierSeries, x: Array) -> Array:
    x = series.rest @ (series.rest.T @ x)
    x[0] = 0.0
    norm = np.linalg.norm(x)
    return np.asarray(x / norm if norm > 0 else x, float)


def _within_recording(contest: Contest) -> Robot:
    """The arm, limits that it does not state set to what the recording reached."""
    robot, limits = contest.robot, contest.robot.limits
    if not contest.recorded:
        return robot
    q = np.concatenate([s.motion.q for s in contest.recorded])
    speed, push = (
        np.max([np.abs(getattr(s.motion, name)).max(axis=0) for s in contest.recorded], axis=0)
        for name in ("dq", "ddq")
    )
    reached = np.column_stack([q.min(axis=0), q.max(axis=0)])
    unbounded = ~np.isfinite(limits.position).all(axis=1, keepdims=True)
    known: Limits = replace(
        limits,
        position=np.where(unbounded, reached, limits.position),
        velocity=np.where(np.isfinite(limits.velocity), limits.velocity, speed),
        acceleration=np.where(np.isfinite(limits.acceleration), limits.acceleration, push),
    )
    return robot.with_limits(known)
