"""Estimators on the rows of recordings, as `identify` uses them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from excitant.exceptions import BadInput
from excitant.identify.estimators import DESCRIPTIONS, estimator_named
from excitant.identify.estimators.halves import half_columns
from excitant.identify.estimators.instrumental import errors_in_variables
from excitant.identify.estimators.ordinary import wls
from excitant.identify.estimators.regression import Regression
from excitant.identify.least_squares import LeastSquares
from excitant.identify.recording import Recording
from excitant.identify.rows import FitRows, fitted
from excitant.robots.robot import Robot

_CERTAIN = 0.01  # chance of a false alarm of the test


def regression_of(rows: FitRows) -> Regression:
    """The regression of the base parameters, segment by segment."""
    sizes = [len(segment.t) for segment in rows.data.train]
    starts = tuple(int(start) for start in np.cumsum([0, *sizes[:-1]]))
    columns = list(rows.base.columns)
    return Regression(rows.W[:, :, columns], rows.tau, rows.base.expressions, starts)


def estimated(
    robot: Robot,
    rows: FitRows,
    recordings: Sequence[Recording],
    validate: Sequence[Recording],
    name: str,
) -> tuple[LeastSquares, tuple[str, ...]]:
    """Base parameters by the estimator of a name, and what the user should know.

    Args:
        robot: The arm.
        rows: What is fitted.
        recordings: As given to `identify`; instrumental variables look at them twice.
        validate: As given to `identify`.
        name: One of `excitant.identify.estimators.ESTIMATORS`.

    Raises:
        UnknownName: There is no such estimator.
        RankDeficient: Motion that leaves base parameters undetermined.
    """
    estimator, notes = estimator_named(name), [f"base parameters by {DESCRIPTIONS[name]}"]
    problem = regression_of(rows)
    if name == "iv":
        W, Z = half_columns(robot, rows, fitted(recordings, validate))
        problem = replace(problem, W=W, instruments=Z)
        fit = estimator(problem)
        return fit, (*notes, _tested(problem, fit))
    return estimator(problem), tuple(notes)


def _tested(problem: Regression, fit: LeastSquares) -> str:
    """What the test says of least squares of the same columns, and how much it matters."""
    try:
        statistic, p = errors_in_variables(problem.W, problem.tau, problem.Z)
    except BadInput:
        return "even and odd samples show one and the same motion: no errors of it to be tested"
    moved = np.abs(wls(problem).beta - fit.beta) / np.sqrt(np.diag(fit.covariance))
    found = "are seen" if p < _CERTAIN else "are not seen"
    return (
        f"errors of the motion that bias least squares {found} (Durbin-Wu-Hausman: "
        f"{statistic:.4g}, p = {p:.2g}); instruments move its base parameters by up to "
        f"{moved.max():.2g} standard deviations"
    )
