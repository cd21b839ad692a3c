"""Output error: the regressor on the motion that the model makes, not on the measured one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from excitant.exceptions import Infeasible
from excitant.identify.estimators.regression import Regression
from excitant.identify.least_squares import LeastSquares, weighted_least_squares
from excitant.robots.motion import Array, freeze
from excitant.robots.simulation import Diverged

_ROUNDS = 15  # of simulating; two to four do
_SETTLED = 1e-2  # of a standard deviation, by which no parameter moves any more
_SAME = 1e-6  # of the rms torque, by which the prediction does not


@dataclass(frozen=True, eq=False)
class OutputError:
    """An output-error estimate and the way to it.

    Attributes:
        fit: The estimate.
        start: The one of weighted least squares that it began with.
        changes: Largest change of a parameter in each iteration [standard deviations].
        columns: On the motion simulated last, which the estimate is fitted to, shape (n, nv, r).
    """

    fit: LeastSquares
    start: LeastSquares
    changes: tuple[float, ...]
    columns: Array

    def __post_init__(self) -> None:
        freeze(self, "columns")

    @property
    def iterations(self) -> int:
        """Simulations that it took."""
        return len(self.changes)


def output_error(problem: Regression) -> OutputError:
    """Gauss-Newton on the torque that the model gives on its own simulated motion (DIDIM).

    Direct and inverse dynamic identification models (Gautier, Janot, Vandanjon 2013): the closed
    loop of the model is simulated with the current β, which gives columns W_s(β) of a motion
    without the noise of the measured one, and τ ≈ W_s(β) β is solved by weighted least squares
    for the next. How the simulated motion depends on β is left out of the derivative, because the
    controller holds the motion whatever β is.

    Raises:
        BadInput: Nothing is simulated.
        Infeasible: It does not converge.
        RankDeficient: The motion does not show some columns.
    """
    start = fit = weighted_least_squares(problem.W, problem.tau, problem.names)
    changes: list[float] = []
    scale = np.maximum(np.sqrt((problem.tau**2).mean(axis=0)), np.finfo(float).tiny)
    for _ in range(_ROUNDS):
        W = _columns(problem, fit.beta, len(changes))
        found = weighted_least_squares(W, problem.tau, problem.names)
        moved = found.beta - fit.beta
        std = np.sqrt(np.diag(found.covariance))
        changes.append(float((np.abs(moved) / std).max()))
        torque = float(np.sqrt(((W @ moved / scale) ** 2).mean()))
        fit = found
        if changes[-1] < _SETTLED or torque < _SAME:
            return OutputError(fit, start, tuple(changes), W)
    raise Infeasible(
        "output error",
        f"parameters still move by {changes[-1]:.2g} standard deviations after {_ROUNDS} "
        "simulations; give the controller more bandwidth, or use wls or iv",
    )


def _columns(problem: Regression, beta: Array, done: int) -> Array:
    try:
        return problem.columns_of_model(beta)
    except Diverged as error:
        raise Infeasible(
            "output error",
            f"no motion of the model after {done} iterations ({error}); "
            "use wls or iv, or a recording that shows all parameters",
        ) from error


def oe(problem: Regression) -> LeastSquares:
    """The estimate of `output_error`."""
    return output_error(problem).fit
