"""Selection of causes by evidence, with the rivals of each."""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy

from excitant.analysis.evidence import (
    Candidate,
    Evidence,
    Key,
    reweighed,
)
from excitant.robots.effects import Effect, plausible
from excitant.robots.motion import Array
from excitant.robots.robot import Robot

_LARGEST_SET = 60
_TYPICAL = 0.1  # tail probability of the chance level used to rank causes
_IDENTICAL = 0.9999  # |cos| of two causes that are identical on this motion
_FADED = 0.5  # of a cause's fall of J when last tested: below this it is tested again
# times the squared error on its joints: a cause that others must cancel
_CANCELLED = 4.0
_SHARE = 0.05  # of what a cause explains: more by separate joints is a contradiction
_BY_CHANCE = 1e-3  # probability of that when all joints agree
_TIE = 2.0  # standard errors within which two causes explain the data equally well
_TIE_ALIKE = 3.3  # the same where their signatures are alike
ALIKE = 0.9  # |cos| of such signatures
_SAME = 0.999  # |cos| of a cause that is part of another
_HALF = 0.5  # of what a cause explains: a rival must explain more


def select(
    evidence: Evidence, robot: Robot, refuted: Set[Key] = frozenset()
) -> tuple[Evidence, list[Candidate]]:
    """Causes by forward selection, each step pruned backwards, and the evidence at the end.

    Joints that the model gives no friction get that of the standard model first, so that finer
    kinds must explain more than it. A gain common to all joints must explain more than what takes
    its place: all that is missing in the model looks a little like it.
    """
    bare = frictionless(robot)
    allowed = [c for c in evidence.candidates if c.key not in refuted]
    standard = [
        c for c in allowed if c.effect.search.standard and {*c.effect.joints} <= bare
    ]
    evidence, chosen = _grown(evidence, robot, [], standard)
    evidence, chosen = _grown(evidence, robot, chosen, allowed)
    for common in [
        c
        for c in chosen
        if c.effect.physics.on_given_torque and c.effect.is_common(robot)
    ]:
        others = [c for c in allowed if c.key != common.key]
        rest = [c for c in chosen if c is not common]
        weighed, instead = _grown(evidence, robot, rest, others)
        if _beyond_chance(evidence, instead) < _beyond_chance(evidence, chosen):
            evidence = weighed
            chosen = instead
    return evidence, chosen


def _grown(
    evidence: Evidence,
    robot: Robot,
    chosen: list[Candidate],
    allowed: Sequence[Candidate],
) -> tuple[Evidence, list[Candidate]]:
    seen = set[frozenset[Candidate]]()
    falls = dict[Candidate, float]()
    while len(chosen) < _LARGEST_SET:
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
    scores = falls - [_chance(c.trials, c.size) for c in evidence.candidates]
    for k in np.argsort(-scores, kind="stable"):
        candidate: Candidate = evidence.candidates[k]
        if scores[k] <= 0:
            return None
        if candidate.key in taken or candidate not in allowed:
            continue
        if not _significant(evidence, chosen, candidate, float(falls[k])):
            continue
        if _repeats(robot, chosen, candidate):
            continue
        if _plausible(evidence, robot, [*chosen, candidate], candidate):
            return _simplest(evidence, chosen, candidate)
    return None


def _repeats(robot: Robot, chosen: Sequence[Candidate], candidate: Candidate) -> bool:
    """Whether it is common to all joints and one of a single joint is chosen, or the reverse."""
    alike = [c.effect for c in chosen if c.effect.name == candidate.effect.name]
    common = candidate.effect.is_common(robot)
    return any(effect.is_common(robot) != common for effect in alike)


def _simplest(
    evidence: Evidence, chosen: Sequence[Candidate], found: Candidate
) -> Candidate:
    """The best special case of the cause found where it is no more than all of them, else itself.

    Plain friction is a special case of all finer friction of its joint.
    """
    # so is a shape that this motion does not show: play that is never crossed is an offset
    if found.effect.search.shapes:
        for other in evidence.candidates:
            same = other.size == found.size and {*other.effect.joints} == {
                *found.effect.joints
            }
            if (
                same
                and not other.effect.search.shapes
                and evidence.cosine(other, found) > _IDENTICAL
            ):
                return other
    finer = found.effect.family == "friction"
    special = [
        c
        for c in evidence.candidates
        if (
            c.effect.name in found.effect.search.contains
            or (finer and is_plain_friction(c.effect))
        )
        and c.effect.joints == found.effect.joints
        and c not in (*chosen, found)
    ]
    if not special:
        return found
    beside = [*chosen, *special]
    fall = evidence.cost(beside) - evidence.cost([*beside, found])
    if _significant(evidence, beside, found, fall):
        return found
    return min(special, key=lambda c: evidence.cost([*chosen, c]))


def idle(evidence: Evidence, chosen: Sequence[Candidate]) -> set[Effect]:
    """Causes that explain no more than chance, whichever of a set is left out."""
    chance = np.array([_chance(c.trials, c.size) for c in evidence.candidates])
    sets = [[*chosen], *([c for c in chosen if c is not out] for out in chosen)]
    falls = np.max([evidence.additions(each) for each in sets], axis=0)
    return {
        each
        for c, low in zip(evidence.candidates, falls < chance, strict=True)
        if low and c not in chosen
        for each in c.effect.singles()
    }


def _beyond_chance(evidence: Evidence, chosen: Sequence[Candidate]) -> float:
    """J of a set, and what each of its causes would explain by chance."""
    return evidence.cost(chosen) + sum(_chance(c.trials, c.size) for c in chosen)


@lru_cache(maxsize=4096)
def _chance(trials: int, size: int) -> float:
    """Fall of J that the best of so many shapes with so many coefficients reaches by chance."""
    return float(scipy.special.chdtri(size, _TYPICAL / trials))


def _significant(
    evidence: Evidence, chosen: Sequence[Candidate], candidate: Candidate, fall: float
) -> bool:
    spread = evidence.dispersion(chosen, candidate)
    return fall > spread * evidence.threshold(candidate, len(chosen))


def _pruned(
    evidence: Evidence,
    robot: Robot,
    chosen: list[Candidate],
    falls: dict[Candidate, float],
) -> list[Candidate]:
    """The set without causes whose removal costs no more than chance explains."""
    # ``falls`` is the fall of J by each when last tested; tested again when it has halved since
    kept = list(chosen)
    for candidate in chosen:
        rest = [c for c in kept if c is not candidate]
        if underlies(robot, rest, candidate):
            continue
        fall = evidence.cost(rest) - evidence.cost(kept)
        if fall > _FADED * falls.get(candidate, np.inf):
            continue
        if _significant(evidence, rest, candidate, fall):
            falls[candidate] = fall
        else:
            kept = rest
    return kept


def underlies(robot: Robot, rest: Sequence[Candidate], candidate: Candidate) -> bool:
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
    evidence: Evidence, robot: Robot, chosen: Sequence[Candidate], candidate: Candidate
) -> bool:
    """Whether a candidate's coefficients are physically plausible and no cause is cancelled."""
    # a cause that is common to all joints must have the same coefficients at all
    if candidate.effect.is_common(robot) and not _agrees(evidence, chosen, candidate):
        return False
    coordinates, covariance = evidence.solve(chosen)
    if any(_cancelled(evidence, cause, coordinates) for cause in chosen):
        return False
    value = candidate.scale @ coordinates[candidate.columns]
    block = covariance[candidate.columns, candidate.columns]
    std = np.sqrt(np.diag(candidate.scale @ block @ candidate.scale.T))
    return plausible(candidate.effect, robot, value, std)


def _agrees(evidence: Evidence, chosen: Sequence[Candidate], cause: Candidate) -> bool:
    """Whether separate coefficients of each joint explain no more (Cochran 1954)."""
    rest = [c for c in chosen if c is not cause]
    more, freedom = evidence.separate_joints([*rest, cause], cause)
    if not freedom:
        return True
    explained = evidence.cost(rest) - evidence.cost([*rest, cause])
    chance = evidence.dispersion(rest, cause) * scipy.special.chdtri(
        freedom, _BY_CHANCE
    )
    return bool(more < max(chance, _SHARE * explained))


def _cancelled(evidence: Evidence, cause: Candidate, coordinates: Array) -> bool:
    """Whether a cause makes far more torque than there is to explain, which others cancel."""
    made = there = 0.0
    for j, here in evidence.acting(cause):
        x = coordinates[evidence.problem.index[j][here]]
        G = evidence.problem.grams[j]
        made += float(evidence.weight[j] * (x @ G[np.ix_(here, here)] @ x))
        there += float(evidence.weight[j] * G[-1, -1])
    return made > _CANCELLED * there


def frictionless(robot: Robot) -> set[str]:
    """The joints of which the model has no plain friction."""
    return set(robot.joints) - {
        j for e in robot.effects if is_plain_friction(e) for j in e.joints
    }


@dataclass(frozen=True)
class Rival:
    """Another cause that the data cannot distinguish from the one found."""

    candidate: Candidate
    deviations: float  # standard errors by which the one found explains the data better
    cosine: float  # largest |cos| between both signatures


def rivals(
    evidence: Evidence, robot: Robot, chosen: Sequence[Candidate], found: Candidate
) -> list[Rival]:
    """Causes that could replace one that was found, by the residual of each (Vuong 1989).

    A rival explains at least half of what the found cause explains, and leaves it less than half
    to explain. On joints without given friction, the standard model's may be added to it.
    """
    rest = [c for c in chosen if c is not found]
    taken = {c.key for c in chosen}
    bare = frictionless(robot)
    falls = evidence.additions(rest)
    own = falls[evidence.candidates.index(found)]
    errors = evidence.block_errors(chosen)
    standard = [
        c for c in evidence.candidates if is_plain_friction(c.effect) and c not in rest
    ]
    best: dict[Key, Rival] = {}
    for k, other in enumerate(evidence.candidates):
        if other.key in taken or _only_more(evidence, found, other):
            continue
        # standard friction at the joint of a friction cause, as far as it is missing
        missing = other.effect.family == "friction" and {*other.effect.joints} <= bare
        added = [
            c for c in standard if missing and c.effect.joints == other.effect.joints
        ]
        if falls[k] <= _HALF * own and not added:
            continue
        instead = [
            *rest,
            other,
            *(c for c in added if c is not other and c is not found),
        ]
        left = evidence.cost(instead) - evidence.cost([*instead, found])
        if left > _HALF * own:
            continue
        difference = evidence.block_errors(instead) - errors
        z = float(
            difference.sum()
            / max(np.sqrt(len(difference)) * difference.std(ddof=1), 1e-12)
        )
        cosine = evidence.cosine(found, other)
        if z >= (_TIE_ALIKE if cosine > ALIKE else _TIE):
            continue
        known = best.get(other.key)
        if (known is None or z < known.deviations) and _plausible(
            evidence, robot, instead, other
        ):
            best[other.key] = Rival(other, z, cosine)
    return sorted(best.values(), key=lambda rival: rival.deviations)


def _only_more(evidence: Evidence, found: Candidate, other: Candidate) -> bool:
    special = (
        found.effect.name in other.effect.search.contains and other.size > found.size
    )
    real = found.effect.name in other.effect.search.imitates
    return special and not real and evidence.cosine(found, other) > _SAME
