"""Which estimator predicts best what it has not seen, by an inner hold-out.

Blocks of the training data are left out in turn; each estimator predicts them from the rest. The
differences between estimators on the same blocks, and their spread, say which one to take: another
than weighted least squares only where it is better by more than chance allows. The user's hold-out
is not touched, so that the final figures stay those of unseen data.

Robust regression always takes part, instrumental variables where a test finds errors in the
motion. The others do not: `ols` and `tls` assume more than `wls` and gain nothing by it, and `gls`
counts slow misfit for little, which is what most of a prediction's error consists of (on seven
hold-outs of real arms its error was 1.1 to 3.1 times that of `wls`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from excitant.exceptions import ExcitantError, Infeasible, RankDeficient
from excitant.identify.cutoff import beyond_chance, in_percent, paired
from excitant.identify.estimators import DESCRIPTIONS, ESTIMATORS, errors_in_variables, half_columns
from excitant.identify.estimators.of_rows import regression_of
from excitant.identify.estimators.regression import Regression
from excitant.identify.recording import Recording
from excitant.identify.rows import FitRows
from excitant.robots.motion import Array
from excitant.robots.robot import Robot

AUTO = "auto"
"""Name of the choice itself, where an estimator is asked for."""

DEFAULT = "wls"
RIVALS = ("irls",)
_FOLDS, _BLOCKS = 5, 10  # blocks are left out two at a time, far from each other
_INSTANTS = 800  # at most, evenly taken: enough to tell estimators apart
_GAP = 4  # rows beside what is left out: a period of the cut-off
_CERTAIN = 0.01  # chance of a false alarm of the test for errors in the motion
_SAMPLES = 30_000  # of the recordings together, above which that test costs seconds

Indices = npt.NDArray[np.intp]


@dataclass(frozen=True)
class Contestant:
    """How an estimator predicted blocks that it had not seen.

    Attributes:
        name: Its name.
        nrmse: Error over the standard deviation of the torque, geometric mean over joints.
        fall: How much lower its mean square errors are than those of the default, relative, mean
            over joints.
        error: Standard error of that, from the spread between blocks.
    """

    name: str
    nrmse: float
    fall: float
    error: float


@dataclass(frozen=True)
class EstimatorChoice:
    """The estimator chosen.

    Attributes:
        name: Its name.
        contestants: All that were tried, the default first.
        sentence: Why.
    """

    name: str
    contestants: tuple[Contestant, ...]
    sentence: str


def choose_estimator(
    problem: Regression,
    judged: tuple[Array, Array] | None = None,
    others: dict[str, Regression] | None = None,
) -> EstimatorChoice:
    """The default, or the estimator that predicts blocks left out better beyond chance.

    Args:
        problem: The training rows.
        judged: Columns (n, nv, r) and torque (n, nv) at the same instants, to be predicted; those
            of the problem when None.
        others: Further estimators by name, each with rows of its own at the same instants.
    """
    blocks = _blocks(problem)
    W, tau = (problem.W, problem.tau) if judged is None else judged
    entries = dict.fromkeys((DEFAULT, *RIVALS), problem) | (others or {})
    errors: dict[str, Array] = {}
    for name, rows in entries.items():
        try:
            errors[name] = _unseen_errors(name, rows, blocks, W, tau)
        except (RankDeficient, Infeasible):
            continue  # blocks that show too little, or weights that do not settle
    spread = np.maximum(tau.std(axis=0), np.finfo(float).tiny)
    return _decided(errors, spread, len(entries) - 1)


def _decided(errors: dict[str, Array], spread: Array, tried: int) -> EstimatorChoice:
    """The choice from mean square errors of blocks and joints, (blocks, nv) of each estimator."""
    if DEFAULT not in errors:
        return EstimatorChoice(
            DEFAULT, (), f"estimator: {DESCRIPTIONS[DEFAULT]}; parts of the training data do not "
            "show all parameters, so that nothing can be compared on them",
        )  # fmt: skip
    found = []
    for name, each in errors.items():
        size = np.maximum(each.mean(axis=0), np.finfo(float).tiny)
        nrmse = float(np.exp(0.5 * np.log(size / spread**2).mean()))
        fall, error = (0.0, 0.0) if name == DEFAULT else paired(errors[DEFAULT], each)
        found.append(Contestant(name, nrmse, fall, error))
    count = len(errors[DEFAULT])
    better = [c for c in found[1:] if beyond_chance(c.fall, c.error, tried, count)]
    chosen = max(better, key=lambda c: c.fall).name if better else DEFAULT
    return EstimatorChoice(chosen, tuple(found), _sentence(chosen, found))


def _sentence(chosen: str, found: Sequence[Contestant]) -> str:
    default, rivals = found[0], list(found[1:])
    where = "on an inner hold-out cut from the training data"
    start = f"estimator: {DESCRIPTIONS[chosen]}"
    if not rivals:
        return f"{start}; no other one could be compared {where}"
    if chosen == DEFAULT:
        rest = ", ".join(
            f"{c.name} {c.nrmse:.3g} (mean square error {in_percent(-c.fall, c.error, '+')})"
            for c in rivals
        )
        return f"{start}: {where}, nrmse {default.nrmse:.3g}; none is better beyond chance: {rest}"
    best = next(c for c in rivals if c.name == chosen)
    return (
        f"{start}: {where}, nrmse {best.nrmse:.3g} against {default.nrmse:.3g} of {DEFAULT}, mean "
        f"square error lower by {in_percent(best.fall, best.error)} on the same blocks"
    )


def _blocks(problem: Regression) -> list[Indices]:
    """Instants of consecutive blocks, none over the border of a segment, evenly thinned."""
    n = len(problem.tau)
    stride = -(-n // _INSTANTS)
    found = []
    for part in problem.segments:
        rows = np.arange(part.start, part.stop, stride)
        found += np.array_split(rows, max(1, round(_BLOCKS * len(rows) * stride / n)))
    return found


def _unseen_errors(
    name: str, rows: Regression, blocks: Sequence[Indices], W: Array, tau: Array
) -> Array:
    """Mean square errors of blocks, each predicted from others, shape (blocks, nv)."""
    errors = np.empty((len(blocks), tau.shape[1]))
    folds = min(_FOLDS, len(blocks))
    for k in range(folds):
        out = list(range(k, len(blocks), folds))
        beta = ESTIMATORS[name](_without(rows, blocks, out)).beta
        for b in out:
            errors[b] = ((W[blocks[b]] @ beta - tau[blocks[b]]) ** 2).mean(axis=0)
    return errors


def _without(rows: Regression, blocks: Sequence[Indices], out: Sequence[int]) -> Regression:
    """The regression on the blocks that are not left out; blocks side by side are one segment."""
    kept: list[Indices] = []
    starts: list[int] = []
    for part, joined in _kept(rows, blocks, out):
        if not joined:
            starts.append(sum(len(each) for each in kept))
        kept.append(part)
    at = np.concatenate(kept)
    Z = None if rows.instruments is None else rows.instruments[at]
    return replace(rows, W=rows.W[at], tau=rows.tau[at], instruments=Z, starts=tuple(starts))


def _kept(
    rows: Regression, blocks: Sequence[Indices], out: Sequence[int]
) -> Iterator[tuple[Indices, bool]]:
    """Blocks that stay, without what lies beside those left out, and whether each goes on."""
    borders = set(rows.starts)
    for b, block in enumerate(blocks):
        if b in out:
            continue
        after_gap, before_gap = b - 1 in out, b + 1 in out
        part = block[_GAP if after_gap else 0 : len(block) - (_GAP if before_gap else 0)]
        if len(part):
            yield part, b > 0 and not after_gap and int(block[0]) not in borders


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
    problem = regression_of(rows)
    if not rows.data.tuned or judged is None:
        return choose_estimator(problem, None, instrument_rows(robot, rows, problem, recordings))
    return choose_estimator(problem, (judged.W[:, :, list(judged.base.columns)], judged.tau))


def instrument_rows(
    robot: Robot, rows: FitRows, problem: Regression, recordings: Sequence[Recording]
) -> dict[str, Regression]:
    """Instrumental variables as a further contestant, where errors of the motion bias the rest.

    Args:
        robot: The arm.
        rows: What is fitted.
        problem: Its regression.
        recordings: Behind these rows, in order.
    """
    if sum(len(r.t) for r in recordings) > _SAMPLES:
        return {}
    try:
        W, Z = half_columns(robot, rows, recordings)
        some = np.concatenate(_blocks(problem))
        _, p = errors_in_variables(W[some], problem.tau[some], Z[some])
    except ExcitantError:  # a rate too low for halves, or nothing to be tested
        return {}
    return {"iv": replace(problem, W=W, instruments=Z)} if p < _CERTAIN else {}
