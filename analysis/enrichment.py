"""Effects beyond the standard model, chosen by evidence from the training data alone.

Starting from the standard identification, one effect after the other is added while it pays on an
inner hold-out: the training data are cut into contiguous parts, each predicted by a model of the
others. A candidate enters when

* the squared error of the joints that it acts on falls by more than two standard errors, paired
  block by block of time, and by more than a floor, and that of all joints does not rise;
* the same holds for physically consistent fits, everything identified again with it.

Candidates are ranked by linear fits with the same prior but without its inequalities, which costs
little. At the end shapes are chosen again beside all other effects, and effects that others have
made dispensable are taken out: what stays must pay beyond two standard errors with the choice of
its joint accounted for. The user's hold-out is never touched, and where nothing earns its place the
standard model remains.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from excitant.analysis.enrichment_rows import Candidate, Errors, Trial
from excitant.analysis.enrichment_trial import trial_of
from excitant.exceptions import Infeasible
from excitant.identify.estimate import identify
from excitant.identify.recording import Recording
from excitant.robots.effects import Effect, plain, standard_effects
from excitant.robots.motion import Array
from excitant.robots.robot import Robot

DEVIATIONS = 2.0  # standard errors by which the inner hold-out's error must fall
FLOOR = 0.05  # of a joint's squared error: dry friction is never an ideal sign function
_LARGEST_SET = 40
_PATIENCE = 4  # candidates in a row that fail as physically consistent fits
_LOOKED_AT = 60  # candidates judged on the inner hold-out, the best on the fit

Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class Step:
    """One effect that earned its place.

    Attributes:
        effect: The effect, its shape fixed, without values.
        fall: Fall of the squared error on the inner hold-out that it brings last, all others
            kept, relative, mean over the joints that it acts on.
        error: Standard error of that, from blocks.
    """

    effect: Effect
    fall: float
    error: float

    @property
    def sentence(self) -> str:
        """The effect and what it brings."""
        shape = {
            name: value
            for name, value in vars(self.effect).items()
            if name not in ("joints", "values")
        }
        said = ", ".join(f"{name} {value:.3g}" for name, value in shape.items())
        return (
            f"{plain(self.effect.name)} at {', '.join(self.effect.joints)}"
            f"{f' ({said})' if said else ''}: squared error there {100 * self.fall:.1f} "
            f"± {100 * self.error:.1f} % lower on an inner hold-out"
        )


@dataclass(frozen=True, eq=False)
class Enrichment:
    """Effects to identify with.

    Attributes:
        effects: The standard effects and those that were found.
        steps: What was found, in the order in which it was.
        before: Mean squared error of each joint on the inner hold-out, standard model, (nv,).
        after: The same with all effects, shape (nv,).
    """

    effects: tuple[Effect, ...]
    steps: tuple[Step, ...]
    before: Array
    after: Array

    @property
    def notes(self) -> tuple[str, ...]:
        """What was found, as sentences."""
        if not self.steps:
            return ("effects: no further one lowers the error on an inner hold-out beyond chance",)
        return tuple(f"effect added: {step.sentence}" for step in self.steps)


def enriched(
    robot: Robot, recordings: Sequence[Recording], *, cutoff_hz: float | None = None
) -> tuple[Effect, ...]:
    """Effects to identify a robot with from recordings; see `enrichment`."""
    return enrichment(robot, recordings, cutoff_hz=cutoff_hz).effects


def enrichment(
    robot: Robot,
    recordings: Sequence[Recording],
    *,
    cutoff_hz: float | None = None,
    progress: Progress | None = None,
) -> Enrichment:
    """The standard effects and those that the recordings call for.

    Args:
        robot: The arm.
        recordings: What is to be fitted; nothing that is held out.
        cutoff_hz: Cut-off of the torque filter [Hz]; that of `identify` when None.
        progress: Called with a fraction done and what was found last.

    Raises:
        BadRecording: Recordings that cannot be used.
        BadRobot: Links without mass, so no prior.
        RankDeficient: Motion that leaves base parameters undetermined.
        Infeasible: The semidefinite solver failed.
    """
    standard = standard_effects(robot.joints)
    first = identify(robot, recordings, validate=recordings, effects=standard, cutoff_hz=cutoff_hz)
    trial = trial_of(robot, first)
    start = trial.physical([])
    chosen, errors = _grown(trial, start, progress or (lambda fraction, words: None))
    chosen, errors = _reshaped(trial, chosen, errors)
    chosen, errors, steps = _pruned(trial, chosen, errors)
    effects = (*standard, *(c.effect for c in chosen))
    return Enrichment(effects, steps, start.joints, errors.joints)


def _grown(trial: Trial, errors: Errors, progress: Progress) -> tuple[list[Candidate], Errors]:
    """Forward selection from the standard model."""
    chosen: list[Candidate] = []
    failed: set[int] = set()
    while len(chosen) < _LARGEST_SET and len(failed) < _PATIENCE:
        found = _best(trial.weighed(errors), chosen, failed)
        if found is None:
            break
        better = _consistent(trial, [*chosen, found])
        if better is None or not _pays(trial, found, errors, better):
            failed.add(found.columns.start)
            continue
        chosen, errors, failed = [*chosen, found], better, set()
        progress(1 - 0.8 ** len(chosen), plain(found.effect.name))
    return chosen, errors


def _best(trial: Trial, chosen: Sequence[Candidate], failed: set[int]) -> Candidate | None:
    """The candidate that lowers the inner hold-out's error most, beyond chance."""
    taken = {c.key for c in chosen}
    allowed = [c for c in trial.candidates if c.columns.start not in failed and c.key not in taken]
    ranked = trial.ranked(chosen, allowed)[:_LOOKED_AT]
    before, after = trial.linear(chosen, ranked)
    best, most = None, 0.0
    for candidate, errors in zip(ranked, after, strict=True):
        if not _pays(trial, candidate, before, errors):
            continue
        fall = trial.fall(candidate, before, errors)[0] * len(candidate.joints)
        if fall > most:
            best, most = candidate, fall
    return best


def _reshaped(
    trial: Trial, chosen: list[Candidate], errors: Errors
) -> tuple[list[Candidate], Errors]:
    """Each effect in the shape that is best beside all others."""
    for candidate in list(chosen):
        rest = [c for c in chosen if c is not candidate]
        shapes = trial.ranked(rest, [c for c in trial.candidates if c.key == candidate.key])
        if len(shapes) < 2:
            continue
        _, after = trial.weighed(errors).linear(rest, shapes)
        best = shapes[int(np.argmin([trial.relative(e, errors) for e in after]))]
        if best is candidate:
            continue
        other = _consistent(trial, [*rest, best])
        if other is not None and trial.relative(other, errors) < trial.relative(errors, errors):
            chosen, errors = [best if c is candidate else c for c in chosen], other
    return chosen, errors


def _pruned(
    trial: Trial, chosen: list[Candidate], errors: Errors
) -> tuple[list[Candidate], Errors, tuple[Step, ...]]:
    """The set without what has become dispensable, the least needed first."""
    while True:
        others = [_consistent(trial, [c for c in chosen if c is not each]) for each in chosen]
        falls = [
            (np.inf, 0.0) if without is None else trial.fall(each, without, errors)
            for each, without in zip(chosen, others, strict=True)
        ]
        dispensable = [
            k
            for k, (each, without) in enumerate(zip(chosen, others, strict=True))
            if without is not None and not _pays(trial, each, without, errors, _places(trial, each))
        ]
        if not dispensable:
            steps = (Step(c.effect, *fall) for c, fall in zip(chosen, falls, strict=True))
            return chosen, errors, tuple(steps)
        least = min(dispensable, key=lambda k: falls[k][0])
        errors = others[least] or errors
        chosen = [c for k, c in enumerate(chosen) if k != least]


def _places(trial: Trial, candidate: Candidate) -> float:
    """At how many places of the arm a candidate could have been."""
    return trial.robot.nv / len(candidate.joints)


def _consistent(trial: Trial, chosen: Sequence[Candidate]) -> Errors | None:
    """Errors of physically consistent fits; None where the solver finds none."""
    try:
        return trial.physical(chosen)
    except Infeasible:
        return None


def _pays(
    trial: Trial, candidate: Candidate, before: Errors, after: Errors, choices: float = 1.0
) -> bool:
    """Whether a fall exceeds the floor and chance, given from how many it was chosen."""
    fall, error = trial.fall(candidate, before, after)
    return bool(fall > max(FLOOR, beyond_chance(candidate.trials * choices) * error))


def beyond_chance(choices: float) -> float:
    """Standard errors that the best of many must exceed, as two are for one (Bonferroni)."""
    return float(scipy.stats.norm.isf(scipy.stats.norm.sf(DEVIATIONS) / choices))
