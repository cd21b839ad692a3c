"""Which estimator predicts best what it has not seen, by an inner hold-out.

Parts of the training data are left out in turn (`excitant.identify.inner_holdout`); each estimator
that can be compared there (`excitant.identify.estimator_entrants`) predicts them from the rest. The
differences between estimators on the same parts, and their spread, say which one to take: another
than weighted least squares only where it is better by more than chance allows. The user's hold-out
is not touched, so that the final figures stay those of unseen data.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.stats

from excitant.exceptions import Infeasible, RankDeficient
from excitant.identify.cutoff import in_percent, paired
from excitant.identify.estimator_entrants import DEFAULT, RIVALS, Field, field_of, plain_field
from excitant.identify.estimators import DESCRIPTIONS
from excitant.identify.estimators.regression import Regression
from excitant.identify.inner_holdout import unseen_errors
from excitant.identify.recording import Recording
from excitant.identify.rows import FitRows
from excitant.robots.motion import Array
from excitant.robots.robot import Robot

__all__ = [
    "AUTO", "DEFAULT", "RIVALS", "Contestant", "EstimatorChoice", "choose_estimator",
    "estimator_for",
]  # fmt: skip

AUTO = "auto"
"""Name of the choice itself, where an estimator is asked for."""

_CHANCE = 0.02  # that anything else than the default is taken where nothing is better
_ALL_SIGNS = 14  # blocks whose signs are all tried


@dataclass(frozen=True)
class Contestant:
    """How an estimator predicted blocks that it had not seen.

    Attributes:
        name: Its name.
        nrmse: Error over the standard deviation of the torque, geometric mean over joints.
        fall: How much lower its mean square errors are than those of the default, relative, mean
            over joints.
        error: Standard error of that, from the spread between blocks.
        chance: Chance of a fall as large where it is no better.
    """

    name: str
    nrmse: float
    fall: float
    error: float
    chance: float = 1.0


@dataclass(frozen=True)
class EstimatorChoice:
    """The estimator chosen.

    Attributes:
        name: Its name.
        contestants: All that were tried, the default first.
        sentence: Why.
        absent: Names that could not be compared, and why, as pairs.
    """

    name: str
    contestants: tuple[Contestant, ...]
    sentence: str
    absent: tuple[tuple[str, str], ...] = ()


def choose_estimator(
    problem: Regression, judged: tuple[Array, Array] | None = None
) -> EstimatorChoice:
    """The default, or an estimator of rows that predicts blocks left out better beyond chance.

    Args:
        problem: The training rows.
        judged: Columns (n, nv, r) and torque (n, nv) at the same instants, to be predicted; those
            of the problem when None.
    """
    return chosen(plain_field(problem, judged))


def estimator_for(
    robot: Robot,
    rows: FitRows,
    recordings: Sequence[Recording],
    judged: FitRows | None = None,
) -> EstimatorChoice:
    """The choice for the rows of recordings, judged at the common cut-off.

    Args:
        robot: The arm.
        rows: What is fitted.
        recordings: Behind these rows, in order.
        judged: The same instants at the cut-off of judging, where rows are fitted otherwise.
    """
    return chosen(field_of(robot, rows, judged or rows, recordings))


def chosen(field: Field) -> EstimatorChoice:
    """The default, or the entrant that predicts what is left out better beyond chance."""
    errors: dict[str, Array] = {}
    absent = dict(field.absent)
    for name, entrant in field.entrants.items():
        try:
            errors[name] = unseen_errors(entrant, field.holdout)
        except RankDeficient:
            absent[name] = "parts of the training data do not show all parameters"
        except Infeasible:
            absent[name] = "its weights do not settle"
    why = tuple(absent.items())
    if DEFAULT not in errors:
        return EstimatorChoice(
            DEFAULT, (), f"estimator: {DESCRIPTIONS[DEFAULT]}; parts of the training data do not "
            "show all parameters, so that nothing can be compared on them", why,
        )  # fmt: skip
    found = _contestants(field, errors)
    tried = max(1, len(field.entrants) - 1)
    better = [c for c in found[1:] if c.fall > 0 and c.chance < _CHANCE / tried]
    name = max(better, key=lambda c: c.fall).name if better else DEFAULT
    return EstimatorChoice(name, found, _sentence(name, found, _where(field), absent), why)


def _contestants(field: Field, errors: Mapping[str, Array]) -> tuple[Contestant, ...]:
    """From errors of blocks and joints, (blocks, nv) of each estimator, the default first."""
    unit = field.holdout.unit(errors[DEFAULT])
    spread = np.maximum(field.holdout.tau.std(axis=0), np.finfo(float).tiny)
    found = []
    for name, each in errors.items():
        size = np.maximum(each.mean(axis=0), np.finfo(float).tiny)
        nrmse = float(np.exp(0.5 * np.log(size / spread**2).mean()))
        if name == DEFAULT:
            found.append(Contestant(name, nrmse, 0.0, 0.0))
            continue
        fall, error = paired(errors[DEFAULT], each, unit)
        chance = chance_of_falls(((errors[DEFAULT] - each) / unit).mean(axis=1))
        found.append(Contestant(name, nrmse, fall, error, chance))
    return tuple(found)


def chance_of_falls(falls: Array) -> float:
    """Chance of a mean as large where each could as well be of the other sign.

    Fisher's randomisation test, over all signs: exact however much blocks differ in size, as they
    do where a bias shows in some of them only. Of many blocks the mean is normal (Student's t).

    Args:
        falls: One for each block, shape (blocks,).
    """
    count = len(falls)
    if count > _ALL_SIGNS:
        return float(scipy.stats.ttest_1samp(falls, 0.0, alternative="greater").pvalue)
    signs = 1 - 2 * (np.arange(2**count)[:, None] >> np.arange(count) & 1)
    rounding = 1e-12 * float(np.abs(falls).sum())
    return float((signs @ falls >= falls.sum() - rounding).mean())


def _where(field: Field) -> str:
    """What was predicted, in words."""
    words = "on an inner hold-out cut from the training data"
    if "ml" in field.entrants:
        words += " (the same part of all periods)"
    if len(field.holdout.looks) > 1:
        words += ", errors of the motion taken out (even against odd samples)"
    return words


def _sentence(name: str, found: Sequence[Contestant], where: str, absent: Mapping[str, str]) -> str:
    default, rivals = found[0], list(found[1:])
    start, end = f"estimator: {DESCRIPTIONS[name]}", _not_compared(absent)
    if not rivals:
        return f"{start}; no other one could be compared {where}{end}"
    if name == DEFAULT:
        rest = ", ".join(
            f"{c.name} {c.nrmse:.3g} (mean square error {in_percent(-c.fall, c.error, '+')})"
            for c in rivals
        )
        return (
            f"{start}: {where}, nrmse {default.nrmse:.3g}; none is better beyond chance: "
            f"{rest}{end}"
        )
    best = next(c for c in rivals if c.name == name)
    return (
        f"{start}: {where}, nrmse {best.nrmse:.3g} against {default.nrmse:.3g} of {DEFAULT}, mean "
        f"square error lower by {in_percent(best.fall, best.error)} on the same blocks{end}"
    )


def _not_compared(absent: Mapping[str, str]) -> str:
    """Who took no part, and why, those of one reason together."""
    reasons = dict.fromkeys(absent.values())
    parts = [
        f"{' and '.join(name for name, own in absent.items() if own == why)} ({why})"
        for why in reasons
    ]
    return f"; not compared: {', '.join(parts)}" if parts else ""
