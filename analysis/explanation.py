"""Why a finding may be another cause after all: rivals, and reasons that lie beside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from excitant.analysis.evidence import Candidate, Evidence, Key
from excitant.analysis.residuals import Residual
from excitant.analysis.selection import frictionless, is_plain_friction, plausible
from excitant.robots.effects import Effect, plain
from excitant.robots.motion import Array
from excitant.robots.robot import Robot

_TIE = 2.0  # standard errors within which two causes explain the data alike
_TIE_ALIKE = 3.3  # the same where their signatures are alike
_ALIKE = 0.9  # |cos| of such signatures
_SAME = 0.999  # |cos| of a cause that is part of another
_HALF = 0.5  # of what a cause explains, at least, must a rival explain
_SMALL = 0.1  # of what a cause explains whose shape is known roughly
_LITTLE = 0.05  # of the squared torque of a cause that acts on several joints
_MATTERS = 0.3  # of what a cause does to the joint where it shows most


@dataclass(frozen=True)
class Rival:
    """Another cause that the data cannot tell from the one found.

    Attributes:
        candidate: The other cause.
        deviations: By how many standard errors the one found explains the data better.
        cosine: Largest |cos| between both signatures.
    """

    candidate: Candidate
    deviations: float
    cosine: float


def rivals(
    evidence: Evidence, robot: Robot, chosen: Sequence[Candidate], found: Candidate
) -> list[Rival]:
    """Causes that could stand in place of one that was found.

    A rival explains at least half of what the found cause explains, and leaves it less than half
    to explain. The two are compared by the squared error that each leaves, block by block of time
    (Vuong 1989): within two standard errors they tie; within 3.3 where their signatures are
    alike. On joints whose friction is all new, a rival may bring the standard model's along.
    """
    rest, taken = [c for c in chosen if c is not found], {c.key for c in chosen}
    bare, falls = frictionless(robot), evidence.additions(rest)
    own, errors = falls[evidence.candidates.index(found)], evidence.block_errors(chosen)
    best: dict[Key, Rival] = {}
    for k, other in enumerate(evidence.candidates):
        if other.key in taken or _only_more(evidence, found, other):
            continue
        friends = _friction(evidence, other, rest) if {*other.effect.joints} <= bare else []
        if falls[k] <= _HALF * own and not friends:
            continue
        instead = [*rest, other, *(c for c in friends if c is not other and c is not found)]
        left = evidence.cost(instead) - evidence.cost([*instead, found])
        if left > _HALF * own:
            continue
        difference = evidence.block_errors(instead) - errors
        z = float(difference.sum() / max(np.sqrt(len(difference)) * difference.std(ddof=1), 1e-12))
        cosine = evidence.cosine(found, other)
        if z >= (_TIE_ALIKE if cosine > _ALIKE else _TIE):
            continue
        known = best.get(other.key)
        if (known is None or z < known.deviations) and plausible(evidence, robot, instead, other):
            best[other.key] = Rival(other, z, cosine)
    return sorted(best.values(), key=lambda rival: rival.deviations)


def _friction(evidence: Evidence, other: Candidate, rest: Sequence[Candidate]) -> list[Candidate]:
    """Standard friction of a friction's joint, as far as it is not there."""
    if other.effect.family != "friction":
        return []
    return [
        c
        for c in evidence.candidates
        if is_plain_friction(c.effect) and c.effect.joints == other.effect.joints and c not in rest
    ]


def _only_more(evidence: Evidence, found: Candidate, other: Candidate) -> bool:
    """Whether another cause is the one found with more coefficients."""
    special = found.effect.name in other.effect.contains and other.size > found.size
    real = found.effect.name in other.effect.imitates
    return special and not real and evidence.cosine(found, other) > _SAME


def reason_to_downgrade(
    effect: Effect,
    torque: Array,
    explained: float,
    others: Sequence[tuple[Effect, float]],
    left: Sequence[Residual],
) -> str:
    """Why a finding without rivals is still not decided, as half a sentence; empty without one.

    Args:
        effect: The cause.
        torque: What it adds at the rows of the hold-out, shape (n, nv) [torque unit].
        explained: Share of the given model's squared error that it removes.
        others: All causes that pay, each with that share.
        left: What the extended model leaves, joint by joint.
    """
    # what a cause on several joints leaves on some counts sooner: it has to explain them all
    several = bool(torque.any(axis=0).sum() > 1)
    scale = np.array([r.floor for r in left])
    if (scale > 0).all():
        unknown = np.array([r.structured if r.visible else 0.0 for r in left]) / scale
        size = np.sqrt((torque**2).mean(axis=0)) / scale
        main = size > (0.0 if several else _MATTERS * size.max())
        enough = _LITTLE if several else 1.0
        if (unknown[main] ** 2).sum() > enough * (size[main] ** 2).sum():
            if several:
                return "it acts on several joints at once, and what it leaves on some is not small"
            return "more is left unexplained on its joints than it explains"
    # what a shape misses of a large cause looks like a small one
    for other, share in others:
        same = {*effect.joints} <= {*other.joints}
        if same and other.shapes and explained < _SMALL * share:
            return f"it is small beside {plain(other.name)}, whose shape is only roughly known"
    return ""
