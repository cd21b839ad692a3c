"""Selection of causes by evidence, with the rivals of each."""

from collections.abc import Sequence, Set
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import scipy

from excitant.analysis.evidence import (
    Candidate,
    Evidence,
    Key,
    reweighed,
)
from excitant.analysis.thresholds import EVIDENCE, SELECTION
from excitant.robots.effects import Effect, plausible
from excitant.robots.motion import Array
from excitant.robots.robot import Robot


def select(
    evidence: Evidence, robot: Robot, refuted: Set[Key] = frozenset()
) -> tuple[Evidence, list[Candidate]]:
    """Causes by forward selection, each step pruned backwards, and the evidence at the end.

    Joints that the model gives no friction get that of the standard model first, so that finer
    kinds must explain more than it.
    """
    bare = frictionless(robot)
    allowed = [c for c in evidence.candidates if c.key not in refuted]
    standard = [
        c
        for c in allowed
        if c.effect.search.standard and {*c.effect.joints} <= bare
    ]
    evidence, chosen = _grown(evidence, robot, [], standard)
    return _grown(evidence, robot, chosen, allowed)


def completed(
    evidence: Evidence,
    robot: Robot,
    chosen: Sequence[Candidate],
    refuted: Set[Key],
) -> list[Candidate]:
    """Causes with the standard effects that are significant among standard effects.

    Every joint has these, so that fewer tests share the level (Genovese et al. 2006).
    """
    standard = [c for c in evidence.candidates if c.effect.search.standard]
    allowed = [c for c in standard if c.key not in refuted]
    among = replace(evidence, tests=len(standard))
    return _grown(among, robot, list(chosen), allowed)[1]


def _grown(
    evidence: Evidence,
    robot: Robot,
    chosen: list[Candidate],
    allowed: Sequence[Candidate],
) -> tuple[Evidence, list[Candidate]]:
    seen = set[frozenset[Candidate]]()
    falls = dict[Candidate, float]()
    while len(chosen) < SELECTION.largest_set:
        evidence = reweighed(evidence, chosen)
        best = _best_addition(evidence, robot, chosen, allowed)
        if best is None:
            break
        chosen = _pruned(evidence, robot, [*chosen, best], falls)
        if frozenset(chosen) in seen:
            break
        seen.add(frozenset(chosen))
    return evidence, chosen


def _best_addition(
    evidence: Evidence,
    robot: Robot,
    chosen: list[Candidate],
    allowed: Sequence[Candidate],
) -> Candidate | None:
    falls = evidence.additions(chosen)
    taken = {c.key for c in chosen}
    scores = falls - _chances(evidence.candidates)
    for k in np.argsort(-scores, kind="stable"):
        candidate = evidence.candidates[k]
        if scores[k] <= 0:
            return None
        if (
            candidate.key not in taken
            and candidate in allowed
            and _significant(evidence, chosen, candidate, falls[k])
            and not _repeats(robot, chosen, candidate)
            and _plausible(evidence, robot, [*chosen, candidate], candidate)
        ):
            return _simplest(evidence, chosen, candidate)
    return None


def _repeats(
    robot: Robot, chosen: Sequence[Candidate], candidate: Candidate
) -> bool:
    """Whether it is common to all joints and one of a single joint is chosen, or the reverse."""
    alike = [c.effect for c in chosen if c.effect.name == candidate.effect.name]
    common = candidate.effect.is_common(robot)
    return any(effect.is_common(robot) != common for effect in alike)


def _simplest(
    evidence: Evidence, chosen: Sequence[Candidate], cause: Candidate
) -> Candidate:
    """The best special case of a cause where it is no more than all of them, else itself.

    Plain friction is a special case of all finer friction of its joint, and a cause without shape
    one of a shape that this motion does not show.
    """
    effect = cause.effect
    if effect.search.shapes:  # play that is never crossed is an offset
        for other in evidence.candidates:
            same = {*other.effect.joints} == {*effect.joints}
            shaped = other.effect.search.shapes or other.size != cause.size
            if not same or shaped:
                continue
            if evidence.cosine(other, cause) > SELECTION.identical:
                return other
    finer = effect.family == "friction"
    special = [
        c
        for c in evidence.candidates
        if c.effect.joints == effect.joints
        and (
            c.effect.name in effect.search.contains
            or (finer and is_plain_friction(c.effect))
        )
        and c not in (*chosen, cause)
    ]
    if not special:
        return cause
    beside = [*chosen, *special]
    fall = evidence.fall(chosen, cause, special)
    if _significant(evidence, beside, cause, fall):
        return cause
    return max(special, key=lambda c: evidence.fall(chosen, c))


def idle(evidence: Evidence, chosen: Sequence[Candidate]) -> set[Effect]:
    """Causes that explain no more than chance, whichever of a set is left out."""
    chance = _chances(evidence.candidates)
    sets = [[*chosen], *([c for c in chosen if c is not out] for out in chosen)]
    falls = np.max([evidence.additions(causes) for causes in sets], axis=0)
    return {
        single
        for c, by_chance in zip(evidence.candidates, falls < chance, strict=True)
        if by_chance and c not in chosen
        for single in c.effect.singles()
    }


@lru_cache(maxsize=1)
def _chances(candidates: tuple[Candidate, ...]) -> Array:
    """Fall of J that the best shape of each reaches by chance where it is absent, (candidates,)."""
    sizes = np.array([c.size for c in candidates])
    trials = np.array([c.trials for c in candidates])
    return scipy.special.chdtri(sizes, SELECTION.chance_tail / trials)


def _significant(
    evidence: Evidence,
    chosen: Sequence[Candidate],
    candidate: Candidate,
    fall: float,
) -> bool:
    threshold = evidence.threshold(candidate, len(chosen))
    if fall <= EVIDENCE.least_dispersion * threshold:  # told without the samples
        return False
    return fall > evidence.dispersion(chosen, candidate) * threshold


def _pruned(
    evidence: Evidence,
    robot: Robot,
    chosen: list[Candidate],
    falls: dict[Candidate, float],
) -> list[Candidate]:
    """The set without causes whose removal costs no more than chance explains."""
    # ``falls`` is the fall of J by each when last tested; tested again when it has halved since
    pruned = list(chosen)
    rises = dict(zip(pruned, evidence.removals(pruned), strict=True))
    for candidate in chosen:
        rest = [c for c in pruned if c is not candidate]
        if underlies(robot, rest, candidate):
            continue
        fall = rises[candidate]
        if fall > SELECTION.faded * falls.get(candidate, np.inf):
            continue
        if _significant(evidence, rest, candidate, fall):
            falls[candidate] = fall
        else:
            pruned = rest
            rises = dict(zip(pruned, evidence.removals(pruned), strict=True))
    return pruned


def underlies(
    robot: Robot, rest: Sequence[Candidate], candidate: Candidate
) -> bool:
    """Whether finer friction builds on this plain one (heredity: Hamada and Wu 1992)."""
    effect = candidate.effect
    if not is_plain_friction(effect) or not {*effect.joints} <= frictionless(robot):
        return False
    finer = (
        c.effect
        for c in rest
        if c.effect.family == "friction" and not c.effect.search.standard
    )
    return any(
        e.joints == effect.joints and effect.name not in e.search.contains
        for e in finer
    )


def is_plain_friction(effect: Effect) -> bool:
    """Whether an effect is friction that every joint has, viscous or Coulomb."""
    return effect.search.standard and effect.family == "friction"


def _plausible(
    evidence: Evidence,
    robot: Robot,
    chosen: Sequence[Candidate],
    candidate: Candidate,
) -> bool:
    """Whether a candidate's coefficients are physically plausible and no cause is cancelled."""
    # a cause that is common to all joints must have the same coefficients at all
    if candidate.effect.is_common(robot) and not _agrees(
        evidence, chosen, candidate
    ):
        return False
    coordinates = evidence.fit(chosen).coordinates
    if any(_cancelled(evidence, cause, coordinates) for cause in chosen):
        return False
    rest = [c for c in chosen if c is not candidate]
    _, information = evidence.beside(rest, candidate)
    scale = candidate.scale
    covariance = np.linalg.inv(information)
    std = np.sqrt(np.diag(scale @ covariance @ scale.T))
    value = scale @ coordinates[candidate.columns]
    return plausible(candidate.effect, robot, value, std)


def _agrees(
    evidence: Evidence, chosen: Sequence[Candidate], cause: Candidate
) -> bool:
    """Whether separate coefficients of each joint explain no more (Cochran 1954)."""
    rest = [c for c in chosen if c is not cause]
    more, freedom = evidence.separate_joints([*rest, cause], cause)
    if not freedom:
        return True
    explained = evidence.fall(rest, cause)
    chance = evidence.dispersion(rest, cause) * scipy.special.chdtri(
        freedom, SELECTION.common_chance
    )
    return bool(more < max(chance, SELECTION.common_share * explained))


def _cancelled(evidence: Evidence, cause: Candidate, coordinates: Array) -> bool:
    """Whether a cause makes far more torque than there is to explain, which others cancel."""
    at = cause.columns
    made = coordinates[at] @ evidence.gram[at, at] @ coordinates[at]
    there = evidence.powers @ evidence.problem.acts[:, at].any(axis=1)
    return bool(made > SELECTION.cancelled * there)


def frictionless(robot: Robot) -> set[str]:
    """The joints of which the model has no plain friction."""
    return set(robot.joints) - {
        j for e in robot.effects if is_plain_friction(e) for j in e.joints
    }


@dataclass(frozen=True)
class Rival:
    """Another cause that the data cannot distinguish from the one found."""

    candidate: Candidate
    instead: tuple[Candidate, ...]  # all causes, with it in place of the one found
    deviations: (
        float  # standard errors by which the one found explains the data better
    )
    cosine: float  # largest |cos| between both signatures

    @property
    def tie(self) -> float:
        """Such deviations from which on it explains less than the one found."""
        alike = self.cosine > SELECTION.alike
        return SELECTION.tie_alike if alike else SELECTION.tie


def rivals(
    evidence: Evidence,
    robot: Robot,
    chosen: Sequence[Candidate],
    cause: Candidate,
    *,
    of_torque: bool = False,
) -> list[Rival]:
    """Causes that could replace a chosen one, by the residual of each (Vuong 1989).

    A rival explains at least half of what the cause explains, and leaves it less than half to
    explain. On joints without nominal friction, the standard model's may be added to it, and finer
    friction that builds on it is none of it. Or only those ``of_torque``, which are read from that
    of the model.
    """
    rest = [c for c in chosen if c is not cause]
    keys = {c.key for c in chosen}
    without_friction = frictionless(robot)
    falls = evidence.additions(rest)
    least = SELECTION.rival_share * falls[evidence.candidates.index(cause)]
    errors = evidence.block_errors(chosen)
    standard = [
        c
        for c in evidence.candidates
        if is_plain_friction(c.effect) and c not in rest
    ]
    best: dict[Key, Rival] = {}
    for fall, other in zip(falls, evidence.candidates, strict=True):
        if of_torque and other.effect.physics.depends_on != "torque":
            continue
        if other.key in keys or _only_more(evidence, cause, other):
            continue
        if underlies(robot, [other], cause):
            continue
        # standard friction at the joint of a friction cause, as far as it is missing
        joints = other.effect.joints
        missing = (
            other.effect.family == "friction" and {*joints} <= without_friction
        )
        added = [c for c in standard if missing and c.effect.joints == joints]
        if fall <= least and not added:
            continue
        new = [other, *(c for c in added if c not in (other, cause))]
        if evidence.fall(rest, cause, new) > least:
            continue
        instead = [*rest, *new]
        deviations = float(in_deviations(evidence.block_errors(instead) - errors))
        cosine = evidence.cosine(cause, other)
        rival = Rival(other, tuple(instead), deviations, cosine)
        if deviations >= rival.tie:
            continue
        if other.key in best and deviations >= best[other.key].deviations:
            continue
        if _plausible(evidence, robot, instead, other):
            best[other.key] = rival
    return sorted(best.values(), key=lambda rival: rival.deviations)


def in_deviations(differences: Array) -> Array:
    """Differences summed over blocks, in standard errors of that sum, (blocks, ...) → (...)."""
    spread = np.sqrt(len(differences)) * differences.std(axis=0, ddof=1)
    return differences.sum(axis=0) / np.maximum(spread, 1e-12)


def _only_more(evidence: Evidence, cause: Candidate, other: Candidate) -> bool:
    """Whether another cause contains one, and imitates it with what it has more."""
    name = cause.effect.name
    special = name in other.effect.search.contains and other.size > cause.size
    if not special or name in other.effect.search.imitates:
        return False
    return evidence.cosine(cause, other) > SELECTION.contained
