"""How far the given values are off, by what the data say of most of them.

Given values are taken as right to ±10 %, and to less where the data show that most of them are:
their deviations, in the directions that the data determine, have a median size that a few wrong
ones do not move (empirical Bayes with a robust scale). Placeholders say nothing of the links.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.linalg

from excitant.analysis.evidence import Evidence, reweighed
from excitant.analysis.signatures import Index
from excitant.robots.motion import Array, read_only
from excitant.robots.robot import Robot

_DETERMINED = 25.0  # data over prior information of a direction that counts
_FEWEST = 8  # such directions, to judge by
_MEDIAN = 0.4549  # of χ² with one degree of freedom
_RANGE = (0.02, 1.0)  # of the tolerance
_UNKNOWN = 400.0  # tolerances: a link may be twenty times as heavy as a placeholder


def are_placeholders(robot: Robot) -> bool:
    """Whether all links weigh the same, as those of no arm of three joints or more do."""
    mass = robot.phi[::10]
    return len(mass) > 2 and bool(np.allclose(mass, mass[0], rtol=1e-6))


def widened(robot: Robot) -> float:
    """Factor on the tolerance of a robot's links before data are seen."""
    return _UNKNOWN if are_placeholders(robot) else 1.0


def calibrated(evidence: Evidence, robot: Robot) -> Evidence:
    """The same evidence with the tolerance of given values that the data support.

    Args:
        evidence: Evidence with the prior of ±10 %; its leading columns stand for the links, those
            up to `Evidence.nuisance` for the effects.
        robot: The given robot.
    """
    links = 10 * robot.nv
    parts = np.arange(links), np.arange(links, evidence.nuisance)
    factors = [_size(evidence, part) for part in parts]
    if are_placeholders(robot):
        factors[0] = _UNKNOWN
    precision = np.array(evidence.precision)
    for part, factor in zip(parts, factors, strict=True):
        precision[part] /= factor**2
    scaled = replace(evidence, precision=read_only(precision), tolerance=(factors[0], factors[1]))
    return reweighed(scaled, [])


def _size(evidence: Evidence, part: Index) -> float:
    """Typical deviation of given values in units of the tolerance."""
    if len(part) < 2:
        return _RANGE[1]
    others = np.setdiff1d(np.arange(evidence.nuisance), part)
    A = evidence.gram + np.diag(evidence.precision)
    H, m = evidence.gram[np.ix_(part, part)], evidence.moment[part]
    if len(others):
        cross = scipy.linalg.solve(
            A[np.ix_(others, others)], evidence.gram[np.ix_(others, part)], assume_a="pos"
        )
        H = H - evidence.gram[np.ix_(part, others)] @ cross
        m = m - cross.T @ evidence.moment[others]
    unit = 1 / np.sqrt(evidence.precision[part])
    values, vectors = np.linalg.eigh(unit[:, None] * H * unit)
    shown = values > _DETERMINED
    if shown.sum() < _FEWEST:
        return _RANGE[1]
    deviation = (vectors[:, shown].T @ (unit * m)) / values[shown]
    variance = float(np.median(deviation**2 - _chance(values[shown]))) / _MEDIAN
    return float(np.clip(np.sqrt(max(variance, 0.0)), *_RANGE))


def _chance(information: Array) -> Array:
    """What noise alone adds to the median of a squared deviation."""
    return np.asarray(_MEDIAN / information, float)
