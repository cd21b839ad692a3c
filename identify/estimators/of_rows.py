"""Estimators on the rows of recordings, as `identify` uses them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from excitant.exceptions import BadInput
from excitant.identify.estimators import DESCRIPTIONS, estimator_named
from excitant.identify.estimators.closed_loop import closed_loop
from excitant.identify.estimators.halves import half_columns
from excitant.identify.estimators.instrumental import errors_in_variables
from excitant.identify.estimators.ordinary import wls
from excitant.identify.estimators.output_error import output_error
from excitant.identify.estimators.periodic import MaximumLikelihood, maximum_likelihood
from excitant.identify.estimators.regression import Regression
from excitant.identify.least_squares import LeastSquares, information, noise_of
from excitant.identify.recording import Recording
from excitant.identify.rows import FitRows, fitted
from excitant.robots.robot import Robot

_CERTAIN = 0.01  # chance of a false alarm of the test


def regression_of(rows: FitRows) -> Regression:
    """The regression of the base parameters, segment by segment."""
    sizes = [len(segment.t) for segment in rows.data.to_fit]
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
        recordings: As given to `identify`; `iv`, `oe` and `ml` look at them again.
        validate: As given to `identify`.
        name: One of `excitant.identify.estimators.ESTIMATORS`.

    Raises:
        UnknownName: There is no such estimator.
        RankDeficient: Motion that leaves base parameters undetermined.
        BadRecording: Maximum likelihood of a motion that does not repeat.
        Infeasible: Output error that does not converge.
    """
    estimator, notes = estimator_named(name), [f"base parameters by {DESCRIPTIONS[name]}"]
    problem = regression_of(rows)
    if name == "iv":
        W, Z = half_columns(robot, rows, fitted(recordings, validate))
        problem = replace(problem, W=W, instruments=Z)
        fit = estimator(problem)
        return fit, (*notes, _tested(problem, fit))
    if name == "oe":
        fit, said = _simulated(robot, rows, fitted(recordings, validate))
        return fit, (*notes, *said)
    if name == "ml":
        found = maximum_likelihood(robot, rows, fitted(recordings, validate))
        return _of_all_rows(found.fit, problem), (*notes, *_averaged(robot, found))
    return estimator(problem), tuple(notes)


def _simulated(
    robot: Robot, rows: FitRows, recordings: Sequence[Recording]
) -> tuple[LeastSquares, tuple[str, ...]]:
    """Output error, and what the simulation was told."""
    loop = closed_loop(robot, rows, recordings)
    found = output_error(loop.problem)
    low, high = loop.bandwidth_hz.min(), loop.bandwidth_hz.max()
    width = f"{low:.3g} Hz" if high - low < 0.1 * low else f"{low:.3g} to {high:.3g} Hz"
    std = np.sqrt(np.diag(found.fit.covariance))
    moved = np.abs(found.fit.beta - found.start.beta) / std
    return found.fit, (
        f"the model was simulated on the measured motion up to {width}, as the positions "
        f"themselves suggest; converged after {found.iterations} iterations, which moved "
        f"parameters by up to {moved.max():.2g} standard deviations",
    )


def _averaged(robot: Robot, found: MaximumLikelihood) -> tuple[str, ...]:
    """What was averaged, and what the model lacks."""
    averaged = ", ".join(f"{p.count} of {p.period:.4g} s in '{p.name}'" for p in found.rows.periods)
    lack = found.lack_of_fit
    each = ", ".join(
        f"{joint} {ratio:.3g}" for joint, ratio in zip(robot.joints, lack.ratio, strict=True)
    )
    missing = [joint for joint, p in zip(robot.joints, lack.p, strict=True) if p < _CERTAIN]
    verdict = (
        f"more than noise is left at {', '.join(missing)}: some effect is missing"
        if missing
        else "nothing but noise is left"
    )
    return (
        f"periods averaged: {averaged}",
        f"residual variance over that of the noise between periods: {each}; {verdict}",
    )


def _of_all_rows(fit: LeastSquares, problem: Regression) -> LeastSquares:
    """A fit of averaged rows with noise of all rows that gives them the same information.

    The physically consistent fit weighs all rows by their joint's noise and inflation.
    """
    residual = problem.tau - problem.W @ fit.beta
    sigma = noise_of(residual, len(fit.beta))
    A = information(problem.W / sigma[:, None]).sum(axis=0)
    share = float(np.trace(fit.covariance @ A)) / len(fit.beta)
    return replace(fit, sigma=sigma, inflation=np.full(len(sigma), max(share, 1.0)))


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
