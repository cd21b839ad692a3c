"""Total least squares: errors in columns and torque alike."""

from __future__ import annotations

import numpy as np

from excitant.exceptions import BadInput, RankDeficient
from excitant.identify.estimators.regression import Regression
from excitant.identify.least_squares import (
    LeastSquares,
    factorised,
    noise_of,
    weighted_least_squares,
    with_covariance,
)
from excitant.robots.motion import Array

_VERTICAL = 1e-12  # part of torque in a solution that needs none


def tls(problem: Regression, errors: Array | None = None) -> LeastSquares:
    """Smallest correction of columns and torque after which τ = W β holds exactly.

    Rows are weighted by the noise that weighted least squares finds, columns and torque are
    divided by the size of their errors; β is read from the last right singular vector. Columns
    without errors are eliminated first (Golub and Van Loan 1980; Van Huffel and Vandewalle 1991;
    Gautier and Briot 2014 for robots). The covariance is first order in the errors.

    Known weakness: the ratio of the errors must be known, equal in all rows and independent
    between columns, and none of this holds for a regressor computed from measured positions, whose
    errors depend on the motion. Without `errors` each column is taken to be as wrong, relative to
    its length, as the torque; then least squares is corrected for noise that is not there, which
    inflates parameters that the motion shows badly. Prefer instruments.

    Args:
        problem: What to solve.
        errors: Standard deviation of each column's errors where torque has its joint's noise of
            one, in the column's unit per torque unit, shape (r,); zero for exact columns.

    Raises:
        BadInput: Negative errors, or not one per column.
        RankDeficient: The motion does not show some columns, or no finite solution exists.
    """
    W, tau, names = problem.W, problem.tau, problem.names
    r = len(names)
    sigma = weighted_least_squares(W, tau, names).sigma
    start = factorised(W, sigma, names)
    target = tau / sigma
    sizes = (
        start.norms / (float(np.linalg.norm(target)) or 1.0)
        if errors is None
        else np.asarray(errors, float)
    )
    if sizes.shape != (r,) or not (np.isfinite(sizes) & (sizes >= 0)).all():
        raise BadInput(f"total least squares: give errors of {r} columns, none negative")
    beta = _solved(start.X * start.norms, target, sizes, names)
    residual = tau - W @ beta
    corrected = _corrected(W, residual, beta, sizes, sigma)
    factor = factorised(corrected, sigma, names)
    return with_covariance(factor, beta, residual, noise_of(residual, r))


def _solved(X: Array, target: Array, sizes: Array, names: tuple[str, ...]) -> Array:
    """β of weighted rows; exact columns are eliminated by orthogonal rows."""
    r = len(sizes)
    exact, wrong = np.flatnonzero(sizes == 0), np.flatnonzero(sizes > 0)
    flat = X.reshape(-1, r)
    stacked = np.column_stack([flat[:, exact], flat[:, wrong] / sizes[wrong], target.ravel()])
    R = np.asarray(np.linalg.qr(stacked, mode="r"), float)
    e = len(exact)
    v = np.linalg.svd(R[e:, e:])[2][-1]
    if abs(v[-1]) <= _VERTICAL:
        raise RankDeficient(
            [names[k] for k in wrong[np.abs(v[:-1]) > 0.1]],
            "total least squares has no finite solution; these columns are no larger than errors "
            "(use another estimator, or give the errors of the columns)",
        )
    beta = np.empty(r)
    scaled = -v[:-1] / v[-1]
    beta[exact] = np.linalg.solve(R[:e, :e], R[:e, -1] - R[:e, e:-1] @ scaled)
    beta[wrong] = scaled / sizes[wrong]
    return beta


def _corrected(W: Array, residual: Array, beta: Array, sizes: Array, sigma: Array) -> Array:
    """Columns with the smallest correction that explains each row, shape (n, nv, r).

    A row's residual e is shared between torque and columns in proportion to their variances:
    ΔW = e D²β / (1 + βᵀD²β), D the sizes of the columns' errors.
    """
    share = sizes**2 * beta / (1 + float((sizes * beta) @ (sizes * beta)))
    return np.asarray(W + residual[:, :, None] * share, float)
