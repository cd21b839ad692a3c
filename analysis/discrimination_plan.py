"""What to do next about a diagnosis that is not decided: motions to run, or actions to take."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from excitant.analysis.candidates import tolerance_metric
from excitant.analysis.confirmation import Finding
from excitant.analysis.diagnosis import Diagnosis
from excitant.analysis.discrimination import Contest, Noise, Pair
from excitant.analysis.discrimination_motion import Discriminating, discriminating_motions
from excitant.analysis.selection import is_plain_friction
from excitant.design import FourierTrajectory
from excitant.exceptions import Infeasible
from excitant.identify.least_squares import autocorrelation_time
from excitant.identify.physical import prior_parameters
from excitant.robots.effects import Effect, standard_effects
from excitant.robots.geometry import Scene, scene
from excitant.robots.robot import Robot

_MATTERS = 0.01  # share of the given model's error that a finding explains, at least
_DURATION = 20.0  # s of a motion
_NEAREST = 0.01  # m: a recording that comes nearer says that the collision shapes are too rough

Key = tuple[str, tuple[str, ...], str, tuple[str, ...]]
"""Name and joints of the cause found, and of its rival."""


@dataclass(frozen=True)
class Experiment:
    """What settles one pair of rivals.

    Attributes:
        sentence: What to do.
        separation: Expected difference in standard deviations of the noise; None for an action.
        repetitions: Runs that are needed; None for an action.
        file: Motion to run; None for an action.
    """

    sentence: str
    separation: float | None = None
    repetitions: int | None = None
    file: str | None = None


@dataclass(frozen=True, eq=False)
class Plan:
    """What settles the open questions of a diagnosis.

    Attributes:
        experiments: For each pair of rivals.
        motions: What to run, in the order of their files ``separate-1``, ….
    """

    experiments: Mapping[Key, Experiment] = field(default_factory=dict)
    motions: tuple[FourierTrajectory, ...] = ()

    def of(self, found: Effect, rival: Effect) -> Experiment:
        """What settles a pair; the general action where no motion was looked for."""
        known = self.experiments.get(key(found, rival))
        return known or Experiment(found.told_from(rival))


def key(found: Effect, rival: Effect) -> Key:
    """Names and joints of a pair."""
    return found.name, found.joints, rival.name, rival.joints


def plan(
    diagnosis: Diagnosis,
    rng: np.random.Generator,
    *,
    duration: float = _DURATION,
    most: int = 3,
    time_limit: float = 15.0,
) -> Plan:
    """Experiments that settle what a diagnosis leaves undecided.

    Motions are looked for where findings that explain at least one per cent have rivals; where
    none tells two causes apart, an action from outside the motion is named.

    Args:
        diagnosis: What was found.
        rng: Source of randomness.
        duration: Period of each motion [s].
        most: Number of motions, at most.
        time_limit: Time for the search [s].
    """
    contest = contest_of(diagnosis)
    if not contest.pairs:
        return Plan()
    try:
        motions, _ = discriminating_motions(
            contest,
            rng,
            duration=duration,
            most=most,
            time_limit=time_limit,
            scene=_surroundings(diagnosis),
        )
    except Infeasible:
        motions = []
    chosen = [_best(motions, index) for index in range(len(contest.pairs))]
    used = sorted((m for m in motions if m in chosen), key=lambda m: -chosen.count(m))
    found = {
        key(pair.found, pair.rival): _experiment(diagnosis.robot, pair, index, best, used)
        for index, (pair, best) in enumerate(zip(contest.pairs, chosen, strict=True))
    }
    return Plan(found, tuple(motion.trajectory for motion in used))


def contest_of(diagnosis: Diagnosis) -> Contest:
    """The rivals of a diagnosis, with the noise that its hold-out shows."""
    robot = diagnosis.robot
    open_ = [f for f in diagnosis.findings if f.rivals and f.explained >= _MATTERS]
    pairs = [pair for finding in open_ for pair in _pairs(diagnosis, finding)]
    return Contest(
        robot=robot,
        model=diagnosis.extension.model,
        metric=tolerance_metric(prior_parameters(robot)),
        noise=_noise(diagnosis),
        pairs=tuple(pairs),
        recorded=diagnosis.data.train,
    )


def _pairs(diagnosis: Diagnosis, finding: Finding) -> list[Pair]:
    robot, own = diagnosis.robot, finding.effect
    others = [f.effect for f in diagnosis.findings if f is not finding]
    added = np.array(own.values or ()) - np.array(finding.given)
    return [
        Pair(own.with_values(added), rival, (*others, *_friction(robot, own, rival, others)))
        for rival in (r.candidate.effect for r in finding.rivals)
    ]


def _friction(robot: Robot, found: Effect, rival: Effect, others: Sequence[Effect]) -> list[Effect]:
    """Standard friction of joints that have none, which a kind of friction may bring along."""
    known = {(e.name, j) for e in (*robot.effects, *others) for j in e.joints}
    known |= {(e.name, e.joints[0]) for e in (found, rival)}
    joints = {j for e in (found, rival) if e.family == "friction" for j in e.joints}
    return [
        effect
        for joint in robot.joints
        for effect in standard_effects((joint,))
        if joint in joints and is_plain_friction(effect) and (effect.name, joint) not in known
    ]


def _noise(diagnosis: Diagnosis) -> Noise:
    counts = diagnosis.held.moves
    error = diagnosis.left * diagnosis.gains * counts
    sigma = np.sqrt((error**2).sum(axis=0) / np.maximum(counts.sum(axis=0), 1))
    inflation = np.array([autocorrelation_time(column) for column in error.T])
    return Noise(np.maximum(sigma, 1e-9), inflation, diagnosis.data.cutoff_hz)


def _surroundings(diagnosis: Diagnosis) -> Scene | None:
    """The arm's own bodies, where the recording bears out their shapes."""
    try:
        found = scene(diagnosis.robot)
    except (ValueError, RuntimeError):
        return None
    if found is None:
        return None
    poses = diagnosis.position[:: max(1, len(diagnosis.position) // 100)]
    return found if found.distances(poses).min() > _NEAREST else None


def _best(motions: Sequence[Discriminating], index: int) -> Discriminating | None:
    """The motion that separates a pair best, if any does in a number of runs."""
    able = [motion for motion in motions if motion.separations[index].repetitions]
    return max(able, key=lambda m: m.separations[index].delta, default=None)


def _experiment(
    robot: Robot,
    pair: Pair,
    index: int,
    best: Discriminating | None,
    motions: Sequence[Discriminating],
) -> Experiment:
    """The motion to run for a pair, or the action where none helps."""
    action = pair.found.told_from(pair.rival)
    if best is None:
        return Experiment(f"no motion within the limits was found to tell them apart: {action}")
    separated, runs = best.separations[index], best.separations[index].repetitions
    file = f"separate-{motions.index(best) + 1}.csv"
    often = "one run is enough" if runs == 1 else f"{runs} runs are needed, or else: {action}"
    does = described(best.trajectory, robot)
    apart = f"separates by {separated.deviations:.3g} standard deviations"
    return Experiment(f"run {file} ({does}): {apart}; {often}", separated.deviations, runs, file)


def described(trajectory: FourierTrajectory, robot: Robot) -> str:
    """A motion in a few words: what moves how fast and how often it reverses."""
    motion = trajectory.motion(100.0)
    speed = np.abs(motion.dq).max(axis=0)
    moving = np.flatnonzero(speed > 1e-3)
    parts = [f"{trajectory.period:g} s"]
    if 0 < len(moving) <= 2 < robot.nv:
        for j in moving:
            turns = int((np.diff(np.sign(motion.dq[1:-1, j])) != 0).sum())
            unit = "rad/s" if robot.revolute[j] else "m/s"
            parts.append(f"{robot.joints[j]} reverses {turns} times at up to {speed[j]:.2g} {unit}")
        parts.append("the other joints held")
    elif len(moving) < robot.nv:
        held = [joint for j, joint in enumerate(robot.joints) if j not in moving]
        parts.append(f"{', '.join(held)} held, the others move")
    else:
        parts.append("all joints move")
    return ", ".join(parts)
