"""Which causes the evidence calls for, and which others would do as well."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from excitant.analysis.evidence import Candidate, Evidence
from excitant.robots.effects import Payload
from excitant.robots.robot import Robot
from excitant.robots.torque import effect_values

_LARGEST_SET = 60
_ODDS = 2 * np.log(100.0)  # a rival less than 100 times less likely cannot be excluded
_SIGN_DEVIATIONS = 2.0  # standard deviations by which a value may lie beyond what physics allows


def select(evidence: Evidence, robot: Robot) -> list[Candidate]:
    """Causes by forward selection, then pruned backwards.

    A candidate enters when the fall of J exceeds what the best of all candidates reaches by
    chance, and leaves when the others have made it dispensable.
    """
    chosen: list[Candidate] = []
    while len(chosen) < _LARGEST_SET:
        best = _best_addition(evidence, robot, chosen)
        if best is None:
            break
        chosen.append(best)
        chosen = _pruned(evidence, chosen)
        if best not in chosen:
            break
    return chosen


def _best_addition(
    evidence: Evidence, robot: Robot, chosen: Sequence[Candidate]
) -> Candidate | None:
    now, taken = evidence.cost(chosen), {c.key for c in chosen}
    scored = [
        (now - evidence.cost([*chosen, c]) - evidence.threshold(c.size), k)
        for k, c in enumerate(evidence.candidates)
        if c.key not in taken
    ]
    for score, k in sorted(scored, reverse=True):
        if score <= 0:
            return None
        candidate = evidence.candidates[k]
        if plausible(evidence, robot, [*chosen, candidate], candidate):
            return candidate
    return None


def _pruned(evidence: Evidence, chosen: list[Candidate]) -> list[Candidate]:
    """The set without those whose removal costs less than chance would."""
    kept = list(chosen)
    for candidate in chosen:
        rest = [c for c in kept if c is not candidate]
        if evidence.cost(rest) - evidence.cost(kept) < evidence.threshold(candidate.size):
            kept = rest
    return kept


def plausible(
    evidence: Evidence, robot: Robot, chosen: Sequence[Candidate], candidate: Candidate
) -> bool:
    """Whether a candidate's coefficients, with what is given, have signs physics allows."""
    _, coordinates, covariance = evidence.solve(chosen)
    value = candidate.scale @ coordinates[candidate.columns]
    block = covariance[candidate.columns, candidate.columns]
    std = np.sqrt(np.diag(candidate.scale @ block @ candidate.scale.T))
    if isinstance(candidate.effect, Payload):
        return bool(value[0] > -_SIGN_DEVIATIONS * std[0])
    parameters = candidate.effect.parameters(robot)
    given = effect_values(robot)
    lower = np.array([p.lower - given.get(p.name, 0.0) for p in parameters])
    return bool((value > lower - _SIGN_DEVIATIONS * std).all())


@dataclass(frozen=True)
class Rival:
    """Another cause that the data cannot tell from the one found.

    Attributes:
        candidate: The other cause.
        odds: How many times less likely the data are with it in place of the one found.
        cosine: Largest |cos| between both signatures.
    """

    candidate: Candidate
    odds: float
    cosine: float


def rivals(
    evidence: Evidence, robot: Robot, chosen: Sequence[Candidate], found: Candidate
) -> list[Rival]:
    """Causes that could stand in place of one that was found.

    A rival explains the data where the found cause is absent, and makes it dispensable: adding
    the found cause to the rival brings less than odds of 100 : 1.
    """
    rest = [c for c in chosen if c is not found]
    without, taken = evidence.cost(rest), {c.key for c in chosen}
    best: dict[tuple[str, tuple[str, ...]], tuple[float, Candidate]] = {}
    for candidate in evidence.candidates:
        if candidate.key in taken:
            continue
        alone = evidence.cost([*rest, candidate])
        if without - alone <= evidence.threshold(candidate.size):
            continue
        advantage = alone - evidence.cost([*chosen, candidate])
        if advantage < min(_ODDS, best.get(candidate.key, (np.inf, candidate))[0]) and plausible(
            evidence, robot, [*rest, candidate], candidate
        ):
            best[candidate.key] = (advantage, candidate)
    return [
        Rival(c, float(np.exp(max(advantage, 0.0) / 2)), evidence.cosine(found, c))
        for advantage, c in sorted(best.values(), key=lambda pair: pair[0])
    ]
