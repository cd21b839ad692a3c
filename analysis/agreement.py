"""Whether all joints that a common cause acts on ask for the same coefficients of it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.linalg
import scipy.stats

from excitant.analysis.evidence import Candidate, Evidence
from excitant.robots.effects import Effect
from excitant.robots.robot import Robot

_SHARE = 0.05  # of what a cause explains, at least, that joints on their own explain more
_BY_CHANCE = 1e-3  # probability of as much when all joints agree


def is_common(robot: Robot, effect: Effect) -> bool:
    """Whether an effect acts on all joints of an arm by the same coefficients."""
    return robot.nv > 1 and {*effect.joints} == {*robot.joints}


def agrees(evidence: Evidence, chosen: Sequence[Candidate], cause: Candidate) -> bool:
    """Whether joints explain no more when each has its own coefficients of a cause.

    One gravity, one payload, one delay explains all joints by the same numbers. What merely
    imitates it does not: the joints fit it each in its own way (heterogeneity: Cochran 1954).

    Args:
        evidence: Evidence.
        chosen: What is at work.
        cause: One of these.
    """
    rest = [c for c in chosen if c is not cause]
    more, freedom = _apart(evidence, [*rest, cause], cause)
    if not freedom:
        return True
    explained = evidence.cost(rest) - evidence.cost([*rest, cause])
    chance = evidence.dispersion(rest, cause) * scipy.stats.chi2.isf(_BY_CHANCE, freedom)
    return bool(more < max(chance, _SHARE * explained))


def _apart(evidence: Evidence, chosen: Sequence[Candidate], cause: Candidate) -> tuple[float, int]:
    """Fall of J when each joint has its own coefficients, and how many more these are."""
    active, signatures = evidence.active(chosen), evidence.signatures
    grams, crosses, moments, used = [], [], [], set[int]()
    for j, here in signatures.acting(cause.columns):
        at, G, weight = signatures.index[j], signatures.grams[j], evidence.weight[j]
        cross = np.zeros((len(evidence.moment), len(here)))
        cross[at] = weight * G[:, here]
        grams.append(weight * G[np.ix_(here, here)] + np.diag(evidence.precision[at[here]]))
        crosses.append(cross[active])
        moments.append(weight * evidence.moments[j, at[here]])
        used |= {*at[here].tolist()}
    if len(grams) < 2:
        return 0.0, 0
    A = evidence.gram[np.ix_(active, active)] + np.diag(evidence.precision[active])
    cross = np.concatenate(crosses, axis=1)
    known = scipy.linalg.solve(A, np.column_stack([cross, evidence.moment[active]]), assume_a="pos")
    left = np.concatenate(moments) - cross.T @ known[:, -1]
    G = scipy.linalg.block_diag(*grams) - cross.T @ known[:, :-1]
    return float(left @ np.linalg.lstsq(G, left, rcond=1e-9)[0]), len(left) - len(used)
