"""Next step of an undecided diagnosis: motions to run, or actions to take."""

import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain

import numpy as np

from excitant.analysis.confirmation import Finding
from excitant.analysis.diagnosis import Diagnosis
from excitant.analysis.diagnosis_result import Advice, Plan, key
from excitant.analysis.discrimination import Contest, Pair, Separation, needed
from excitant.analysis.explanation import rivals_of
from excitant.analysis.selection import is_plain_friction
from excitant.analysis.thresholds import (
    DISCRIMINATION,
    EVIDENCE,
)
from excitant.design.constraints import (
    kinematic_limits,
    position_range,
    within_limits,
)
from excitant.design.feasible import random_start, torque_use
from excitant.design.trajectory import (
    FourierSeries,
    Trajectory,
    resting_series,
)
from excitant.exceptions import Infeasible
from excitant.identify.least_squares import autocorrelation_time
from excitant.identify.rows import states
from excitant.robots.effects import (
    Effect,
    separating_experiment,
    standard_effects,
)
from excitant.robots.geometry import CLEARANCE, Scene, scene
from excitant.robots.motion import Array, Mask, Motion, together
from excitant.robots.robot import Robot
from excitant.robots.threads import on_one_thread

DURATION_S = 20.0  # of a motion that separates two causes
INFORMATIVE_HARMONICS = 20  # of a motion that is to show all values better
MOST_MOTIONS = 3
DRAWN = 96  # motions that are judged
TOP_HZ = 2.5  # fastest reversals
HELD_PROBABILITY = 0.5  # of a joint of no interest
SMALLEST_SHARE = 0.01  # of the limits: smallest movement of a joint of interest
SHRINKS = 6
DRAWS = 8  # attempts at one of these, and motions of which one is to show all values better
SAMPLED_SHARE = 0.97  # of the limits at the samples
CHECKED_POSES = 60  # for clearance, before it is certified


@dataclass(frozen=True, eq=False)
class Discriminating:
    """A motion and the separations that it achieves."""

    trajectory: Trajectory  # within all limits
    separations: tuple[Separation, ...]  # one per pair of the contest

    @property
    def deltas(self) -> Array:
        """Δ of each pair, shape (pairs,)."""
        return np.array([s.delta for s in self.separations])


@on_one_thread
def discriminating_motions(
    contest: Contest,
    rng: np.random.Generator,
    *,
    time_limit: float = np.inf,
    scene: Scene | None = None,
) -> tuple[list[Discriminating], list[Separation]]:
    """Motions that separate rivals, and the largest separation found for each pair.

    The best of the motions drawn is taken; pairs that it leaves open get another. Bodies of a
    scene must keep their clearance. A time limit [s] ends the search earlier, where depends on
    the machine.
    """
    search = _Search(
        contest,
        _within_recording(contest),
        FourierSeries(DURATION_S, round(TOP_HZ * DURATION_S)),
        scene,
        rng,
    )
    pool = search.pool(time.monotonic() + time_limit)
    largest = _largest([contest.unmoved, *(m.separations for m in pool)])
    open_ = np.array([s.delta > DISCRIMINATION.hopeless for s in largest])
    motions = list[Discriminating]()
    while open_.any() and len(motions) < MOST_MOTIONS:
        best = search.best(pool, open_)
        if best is None:
            break
        # slowed down to the limits, another may show more
        if best.deltas[open_].max() <= DISCRIMINATION.hopeless:
            continue
        motions.append(best)
        open_ &= best.deltas < needed()
    return motions, _largest([largest, *(m.separations for m in motions)])


@on_one_thread
def informative_motion(
    contest: Contest, rng: np.random.Generator, *, scene: Scene | None = None
) -> Trajectory | None:
    """Of some random motions, the one that with the recording tells most of given values.

    That is the one of largest determinant of their information (D-optimality). It is as long as
    the motions that separate may be together.
    """
    robot = _within_recording(contest)
    series = resting_series(MOST_MOTIONS * DURATION_S, INFORMATIVE_HARMONICS)
    t = contest.instants(series.period)
    p = len(contest.precision)

    def told(trajectory: Trajectory) -> float:
        information = contest.known + contest.information(trajectory.at(t))
        of_given = information[:p, :p] + np.diag(contest.precision)
        return np.linalg.slogdet(of_given).logabsdet

    with suppress(Infeasible):
        motions = [
            random_start(robot, rng, series, scene, CLEARANCE) for _ in range(DRAWS)
        ]
        for motion in sorted(motions, key=told, reverse=True):
            if feasible := within_limits(robot, motion, scene, CLEARANCE):
                return feasible
    return None


def _largest(found: Sequence[Sequence[Separation]]) -> list[Separation]:
    """The largest separation of each pair."""
    return [
        max(of_pair, key=lambda s: s.delta) for of_pair in zip(*found, strict=True)
    ]


@dataclass(frozen=True, eq=False)
class _Search:
    contest: Contest
    robot: Robot
    series: FourierSeries
    scene: Scene | None
    rng: np.random.Generator

    @cached_property
    def instants(self) -> tuple[Array, list[Array]]:
        """Instants at which motions are judged, and the basis of q, q̇ and q̈ there."""
        t = self.contest.instants(self.series.period)
        return t, [self.series.basis(t, order) for order in range(3)]

    @cached_property
    def samples(self) -> tuple[Array, list[Array]]:
        """Instants at which limits are checked, and the basis of q and its derivatives there."""
        t = np.linspace(0.0, self.series.period, 8 * self.series.harmonics + 1)
        return t, [self.series.basis(t, order) for order in range(4)]

    def pool(self, until: float) -> list[Discriminating]:
        """Motions of both kinds, judged; those that cannot meet the limits are left out."""
        pool: list[Discriminating] = []
        for k in range(DRAWN):
            # every fourth has all joints oscillate
            drawn = self._drawn(self._interest if k % 4 else frozenset())
            if drawn is not None:
                information = self._information(drawn)
                separations = self.contest.separations(information)
                pool.append(Discriminating(drawn, tuple(separations)))
            if pool and time.monotonic() > until:
                break
        return pool

    def best(
        self, pool: list[Discriminating], open_: Mask
    ) -> Discriminating | None:
        """The motion that best separates the open pairs within the limits, out of a pool."""
        plenty = DISCRIMINATION.plenty * needed()
        while pool:
            shown = [np.clip(m.deltas[open_], 0.1, plenty) for m in pool]
            motion = pool[np.argmax([np.log(deltas).sum() for deltas in shown])]
            pool.remove(motion)
            feasible = within_limits(
                self.robot, motion.trajectory, self.scene, CLEARANCE
            )
            if feasible is not None:
                counted = self.contest.counted(self._information(feasible))
                return Discriminating(feasible, tuple(counted))
        return None

    def _information(self, trajectory: Trajectory) -> Array:
        t, bases = self.instants
        motion = Motion(t, *(basis @ trajectory.coefficients for basis in bases))
        return self.contest.information(motion)

    @cached_property
    def _interest(self) -> frozenset[int]:
        """Joints of the causes that do not act on all, or all joints."""
        joints: set[int] = set()
        for pair in self.contest.pairs:
            for effect in (pair.found, pair.rival):
                if len(effect.joints) < self.robot.nv:
                    joints |= {
                        self.robot.joint_index(joint) for joint in effect.joints
                    }
        return frozenset(joints or range(self.robot.nv))

    def _drawn(self, interest: frozenset[int]) -> Trajectory | None:
        """Joints of interest reverse within a swelling envelope; the others rest or oscillate.

        All joints oscillate where none is of interest.
        """
        series = self.series
        rng = self.rng
        middle, half = position_range(self.robot.limits)
        for _ in range(DRAWS):
            X = np.zeros((series.size, self.robot.nv))
            share = np.zeros(self.robot.nv)
            for j in range(self.robot.nv):
                if j in interest:
                    X[:, j] = _envelope(series, rng)
                    share[j] = np.exp(rng.uniform(np.log(SMALLEST_SHARE), 0.0))
                elif not interest or rng.uniform() > HELD_PROBABILITY:
                    X[:, j] = _wave(series, rng)
                    share[j] = rng.uniform(0.3, 1.0)
            pose = middle + rng.uniform(-0.8, 0.8, self.robot.nv) * half
            if (fitted := self._fitted(X, pose, share)) is not None:
                return fitted
        return None

    def _fitted(self, X: Array, pose: Array, share: Array) -> Trajectory | None:
        """A movement about a pose, made as large as a share of the limits."""
        t, bases = self.samples
        middle, half = position_range(self.robot.limits)
        bound = kinematic_limits(self.robot.limits)[1].copy()
        bound[0] = np.maximum(half - np.abs(pose - middle), 0.02 * half)
        pose = np.clip(pose, middle - half + bound[0], middle + half - bound[0])
        reach = np.array([np.abs(basis @ X).max(axis=0) for basis in bases])
        with np.errstate(divide="ignore", invalid="ignore"):
            room = np.where(reach > 0, bound / reach, np.inf).min(axis=0)
        X = X * share * np.where(np.isfinite(room), SAMPLED_SHARE * room, 0.0)
        for _ in range(SHRINKS):
            whole = X + self.series.constant(pose)
            use = torque_use(
                self.robot, Motion(t, *(basis @ whole for basis in bases[:3]))
            )
            if use.max() <= SAMPLED_SHARE:
                fitted = self.series.trajectory(whole)
                return fitted if self._clear(fitted) else None
            X = X * 0.7
        return None

    def _clear(self, trajectory: Trajectory) -> bool:
        if self.scene is None:
            return True
        poses = trajectory(np.linspace(0.0, trajectory.period, CHECKED_POSES))
        return bool(self.scene.distances(poses).min() > CLEARANCE)


def _envelope(series: FourierSeries, rng: np.random.Generator) -> Array:
    """((1 − cos ωt) / 2)^p cos(kωt + φ): reversals that swell and fade, shape (c,), norm 1."""
    # with p ≥ 2 it is at rest at both ends; its peak speeds range from nothing to the highest
    p = int(rng.integers(2, 5))
    top = max(series.harmonics - p, 1)
    k = min(round(np.exp(rng.uniform(np.log(2), np.log(max(top, 3))))), top)
    n = 4 * series.harmonics + 4
    angle = 2 * np.pi * np.arange(n) / n
    values = ((1 - np.cos(angle)) / 2) ** p * np.cos(
        k * angle + rng.uniform(0, 2 * np.pi)
    )
    spectrum = np.fft.rfft(values)[1 : series.harmonics + 1] * 2 / n
    return _at_rest(series, np.concatenate([[0.0], spectrum.real, -spectrum.imag]))


def _wave(series: FourierSeries, rng: np.random.Generator) -> Array:
    h = np.arange(1, series.harmonics + 1)
    top = np.exp(rng.uniform(np.log(2), np.log(series.harmonics)))
    size = np.where(h <= max(top, 3), 1 / h ** rng.uniform(0, 2), 0.0)
    x = rng.normal(size=2 * series.harmonics) * np.concatenate([size, size])
    return _at_rest(series, np.concatenate([[0.0], x]))


def _at_rest(series: FourierSeries, x: Array) -> Array:
    x = series.rest @ (series.rest.T @ x)
    x[0] = 0.0
    norm = np.linalg.norm(x)
    return x / norm if norm > 0 else x


def _within_recording(contest: Contest) -> Robot:
    """The arm with the ranges of the recording where it has no limits."""
    robot = contest.robot
    if not contest.recorded:
        return robot
    shown = together([segment.motion for segment in contest.recorded])
    limits = robot.limits
    ranges = np.column_stack([shown.q.min(axis=0), shown.q.max(axis=0)])
    bounded = np.isfinite(limits.position).all(axis=1, keepdims=True)

    def known(limit: Array, values: Array) -> Array:
        return np.where(np.isfinite(limit), limit, np.abs(values).max(axis=0))

    return robot.with_limits(
        replace(
            limits,
            position=np.where(bounded, limits.position, ranges),
            velocity=known(limits.velocity, shown.dq),
            acceleration=known(limits.acceleration, shown.ddq),
        )
    )


@on_one_thread
def plan(
    diagnosis: Diagnosis, rng: np.random.Generator, *, time_limit: float = np.inf
) -> Plan:
    """Experiments that settle an undecided diagnosis; see `discriminating_motions`.

    Where none separates two causes that differ, or a cause is doubted for another reason than a
    rival, a motion is told that shows all values better.
    """
    pairs = {
        finding: _pairs(diagnosis, finding)
        for finding in diagnosis.findings
        if finding.verdict == "undecided" and finding.matters
    }
    if not pairs:
        return Plan()
    contest = _contest(diagnosis, [*chain(*pairs.values())])
    surroundings = _surroundings(diagnosis)
    motions = list[Discriminating]()
    largest = contest.unmoved
    with suppress(Infeasible):
        if contest.pairs:
            motions, largest = discriminating_motions(
                contest, rng, time_limit=time_limit, scene=surroundings
            )
    best = [_best(motions, index) for index in range(len(contest.pairs))]
    used = [motion for motion in motions if motion in best]
    trajectories = [motion.trajectory for motion in used]
    unshown = [
        b is None and not s.same_torque for b, s in zip(best, largest, strict=True)
    ]
    general: Advice | None = None
    doubted = [not rivals_of(f, diagnosis.findings) for f in pairs]
    if any([*unshown, *doubted]):
        motion = informative_motion(contest, rng, scene=surroundings)
        if motion is not None:
            trajectories.append(motion)
            file = f"separate-{len(trajectories)}.csv"
            general = Advice(
                f"run {file} ({described(motion, contest.robot)}): it shows all values better, "
                # the share is that of `--settle`
                "which decides about half of such doubts",
                None,
                1,
                file,
            )
    experiments = {
        key(pair.found, pair.rival): _experiment(
            contest, index, used, largest[index], general
        )
        for index, pair in enumerate(contest.pairs)
    }
    return Plan(experiments, tuple(trajectories), general)


def _contest(diagnosis: Diagnosis, pairs: Sequence[Pair]) -> Contest:
    bodies, effects = diagnosis.extension.evidence.tolerance
    counts = diagnosis.holdout.series.moves
    error = diagnosis.error * diagnosis.holdout.gains * counts
    sigma = np.sqrt((error**2).sum(axis=0) / np.maximum(counts.sum(axis=0), 1))
    inflation = np.array([autocorrelation_time(column) for column in error.T])
    return Contest(
        robot=diagnosis.train.robot,
        model=diagnosis.extension.model,
        pairs=tuple(pairs),
        weight=1 / (np.maximum(sigma, 1e-9) ** 2 * inflation),
        cutoff_hz=diagnosis.data.cutoff_hz,
        recorded=diagnosis.data.train,
        tolerance=(EVIDENCE.tolerance * bodies, EVIDENCE.tolerance * effects),
    )


def _pairs(diagnosis: Diagnosis, finding: Finding) -> list[Pair]:
    robot = diagnosis.robot
    effect = finding.effect
    added = finding.change
    # another law has no coefficients; set-ups that look the same do so for every motion
    if not added.any() or not all(r.candidate.size for r in finding.rivals):
        return []
    pairs = []
    for rival in rivals_of(finding, diagnosis.findings):
        found = [f.effect for f in diagnosis.findings if f is not finding]
        others = [other for other in found if other is not rival]
        beside = (*others, *_friction(robot, effect, rival, others))
        if rival.parameters(robot):
            pairs.append(Pair(effect.with_values(added), rival, beside))
    return pairs


def _friction(
    robot: Robot, found: Effect, rival: Effect, others: Sequence[Effect]
) -> list[Effect]:
    present = {(e.name, j) for e in (*robot.effects, *others) for j in e.joints}
    present |= {(e.name, e.joints[0]) for e in (found, rival)}
    joints = {j for e in (found, rival) if e.family == "friction" for j in e.joints}
    return [
        effect
        for joint in robot.joints
        for effect in standard_effects((joint,))
        if joint in joints
        and is_plain_friction(effect)
        and (effect.name, joint) not in present
    ]


def _surroundings(diagnosis: Diagnosis) -> Scene | None:
    """The arm's own bodies, where the recording does not contradict their shapes."""
    q = states(diagnosis.data.validate).q
    surroundings = None
    with suppress(ValueError, RuntimeError):
        surroundings = scene(diagnosis.robot)
    if surroundings is None:
        return None
    nearest = surroundings.distances(q[:: max(1, len(q) // 100)]).min()
    return surroundings if nearest > DISCRIMINATION.nearest else None


def _best(motions: Sequence[Discriminating], index: int) -> Discriminating | None:
    able = [motion for motion in motions if motion.separations[index].repetitions]
    return max(able, key=lambda m: m.separations[index].delta, default=None)


def _experiment(
    contest: Contest,
    index: int,
    motions: Sequence[Discriminating],
    largest: Separation,
    general: Advice | None,
) -> Advice:
    """The best motion for one pair of a contest, or an action where there is none.

    The largest separation by any motion, possible or not, tells why: of causes that differ,
    a motion that shows all values better may yet decide.
    """
    pair = contest.pairs[index]
    action = separating_experiment(pair.found, pair.rival)
    best = _best(motions, index)
    if best is None:
        why = _why_none(largest)
        if general is None or largest.same_torque:
            return Advice(f"{why}: {action}")
        sentence = f"{why}; {general.experiment}, or else: {action}"
        return replace(general, experiment=sentence)
    runs = best.separations[index].repetitions
    deviations = float(np.sqrt(best.deltas[index]))
    file = f"separate-{motions.index(best) + 1}.csv"
    often = "one run is enough"
    if runs != 1:
        often = f"{runs} runs are needed, or else: {action}"
    motion = described(best.trajectory, contest.robot)
    sentence = f"run {file} ({motion}): separates by {deviations:.3g} standard deviations; {often}"
    return Advice(sentence, deviations, runs, file)


def _why_none(largest: Separation) -> str:
    if largest.whole <= DISCRIMINATION.hopeless:
        return "given values within their tolerance make its torque in every motion"
    if largest.same_torque:
        return "both make the same torque in every motion"
    deviations = f"{np.sqrt(largest.delta):.2g} standard deviations"
    return f"no motion within the limits separates them by more than {deviations}"


def described(trajectory: Trajectory, robot: Robot) -> str:
    """A motion in a few words: its duration, and which joints move."""
    speed = np.abs(trajectory.motion(100.0).dq).max(axis=0)
    moving = [robot.joints[j] for j in np.flatnonzero(speed > 1e-3)]
    which = "all joints" if len(moving) == robot.nv else ", ".join(moving)
    verb = "moves" if len(moving) == 1 else "move"
    return f"{trajectory.period:g} s, {which} {verb}"
