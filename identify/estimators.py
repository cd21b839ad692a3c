"""Estimators of base parameters: a `Regression` in, a `LeastSquares` out.

| name | for | source |
|---|---|---|
| `wls` | joints of different noise; the default | Gautier 1997 |
| `irls` | wrong torques here and there | Huber and Ronchetti 2009 |
| `iv` | noise in the motion | Janot, Vandanjon, Gautier 2014 |
| `oe` | noise in the motion: columns on the simulated one | Gautier, Janot, Vandanjon 2013 |

`iv` needs instruments besides, here columns of every second sample (`half_regressions`); `oe` a
simulation (`excitant.identify.output_error`).
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
import scipy

from excitant.exceptions import BadInput, Infeasible, UnknownName
from excitant.identify.differentiators import Differentiator, ZeroPhaseButterworth
from excitant.identify.least_squares import (
    SMALLEST,
    Factor,
    LeastSquares,
    factorised,
    noise_of,
    weighted_least_squares,
    with_covariance,
)
from excitant.identify.output_error import closed_loop, output_error
from excitant.identify.preprocessing import POSITION_RATIO, prepare
from excitant.identify.recording import Recording
from excitant.identify.regression import Regression, dense, regression_of, triangle
from excitant.identify.rows import FitRows
from excitant.robots.motion import Array, Motion

ESTIMATORS: Mapping[str, str] = MappingProxyType(
    {
        "wls": "weighted least squares",
        "irls": "robust regression (iteratively reweighted, Student's t)",
        "iv": "instrumental variables (even and odd samples)",
        "oe": "output error (closed loop simulated, DIDIM)",
    }
)
"""Every estimator's name, and what it is, in words."""

_CERTAIN = 0.01  # chance of a false alarm of the test for errors in the motion
_ROUNDS = 200  # of reweighting
_SETTLED = 1e-7  # of the noise: change of the fitted torque, rms
_ROUNDING = 1e-13  # of the largest torque: what rounding leaves of an exact fit
_FLATTEST = 0.05  # mean slope of an influence; less is no minimum
_NORMAL = 0.6744897501960817  # median magnitude of a standard normal variable
_HUBER = 1.345  # 95 % efficient for normal noise (Huber and Ronchetti 2009)
_STUDENT = 4.0  # degrees of freedom (Lange, Little, Taylor 1989)
_STAGES = 3  # of re-estimating the noise of each joint with instruments
_SAME = 1e-6  # of a column's length: smaller errors are those of interpolation
_RATE_SHARE = 0.2  # of the rate of all samples: 0.8 of what every second one can show


def estimated(
    rows: FitRows, recordings: Sequence[Recording], name: str
) -> tuple[LeastSquares, tuple[str, ...]]:
    """Base parameters by the estimator of a name, and what the user should know.

    Args:
        rows: What is fitted.
        recordings: Behind these rows, in order; `iv` and `oe` look at them again.
        name: One of `ESTIMATORS`.

    Raises:
        UnknownName: There is no such estimator.
        RankDeficient: Motion that leaves base parameters undetermined.
        Infeasible: Robust regression or output error that does not converge.
    """
    if name not in ESTIMATORS:
        raise UnknownName("estimator", name, ESTIMATORS)
    problem, said = rows.reduced, f"base parameters by {ESTIMATORS[name]}"
    if name == "wls":
        return weighted_least_squares(problem), ()
    if name == "irls":
        return irls(problem), (said,)
    if name == "iv":
        even, odd = half_regressions(rows, recordings)
        fit = iv(even, odd)
        return fit, (said, _tested(even, odd, fit))
    loop = closed_loop(rows, recordings)
    found = output_error(loop.problem, loop.simulated)
    return found.fit, (said, found.sentence(loop.bandwidth_hz))


# robust regression


@dataclass(frozen=True)
class Influence:
    """Influence ψ(u) of a residual of u standard deviations.

    Attributes:
        name: Its name.
        clip: Huber's: magnitude from which every residual has the same influence; None for
            Student's of four degrees of freedom, which gives gross errors none in the end.
    """

    name: str
    clip: float | None = None

    def weight(self, u: Array) -> Array:
        """ψ(u) / u."""
        if self.clip is None:
            return np.asarray((_STUDENT + 1) / (_STUDENT + u**2), float)
        return np.minimum(1.0, self.clip / np.maximum(np.abs(u), SMALLEST))

    def slope(self, u: Array) -> Array:
        """ψ'(u)."""
        if self.clip is None:
            return np.asarray((_STUDENT + 1) * (_STUDENT - u**2) / (_STUDENT + u**2) ** 2, float)
        return (np.abs(u) <= self.clip).astype(float)


HUBER, STUDENT = Influence("Huber", _HUBER), Influence("Student's t")


def irls(problem: Regression, influence: Influence = STUDENT) -> LeastSquares:
    """Solve Σ_j W_jᵀ ψ(ε_j / σ_j) / σ_j = 0, σ_j from the median magnitude of joint j's residual.

    Huber's ψ first, whose solution is unique; from there the one asked for. With m_j the mean of
    ψ', the pseudo-torque W_j β + σ_j ψ / m_j has β for its least-squares solution under weights
    m_j / σ_j², and errors to which the estimate responds to first order as least squares does:
    hence the covariance, valid for coloured noise too (Huber and Ronchetti 2009, ch. 7; Holland
    and Welsch 1977 for the iteration).

    It withstands wrong torques, not wrong positions: a row wrong in W may fit and still mislead.
    A filter before it spreads a spike over its neighbours, which then look like noise.

    Raises:
        RankDeficient: The motion does not show some columns.
        Infeasible: The weights did not settle, or leave too few rows.
    """
    start = factorised(problem, _scale(problem.tau - problem.tau.mean(axis=0), 0))
    beta = start.solve()
    for each in (HUBER, influence):
        beta = _settled(start, beta, each)
    residual = problem.residual(beta)
    sigma = _scale(residual, problem.p)
    u = residual / sigma
    slope = np.maximum(influence.slope(u).mean(axis=0), _FLATTEST)
    factor = factorised(problem, sigma / np.sqrt(slope))
    return with_covariance(factor, beta, sigma * u * influence.weight(u) / slope, sigma)


def _scale(residual: Array, r: int) -> Array:
    """Standard deviation of the normal noise with this median magnitude, shape (nv,)."""
    freedom = np.sqrt(residual.size / max(residual.size - r, 1))
    size = np.median(np.abs(residual), axis=0) / _NORMAL * freedom
    least = 1e-9 * noise_of(residual, r)  # most rows fit exactly
    return np.asarray(np.maximum(size, np.maximum(least, SMALLEST)), float)


def _settled(start: Factor, beta: Array, influence: Influence) -> Array:
    """β at which reweighting rests; steps are taken in the orthonormal columns of the start."""
    problem = start.problem
    inverse = scipy.linalg.solve_triangular(start.R, np.eye(problem.p)) / start.norms[:, None]
    parts = enumerate(zip(problem.index, problem.columns, strict=True))
    Q = np.stack([X @ inverse[index] / start.weight[j] for j, (index, X) in parts], axis=1)
    flat = Q.reshape(-1, problem.p)
    for _ in range(_ROUNDS):
        residual = problem.residual(beta)
        sigma = _scale(residual, problem.p)
        weight = influence.weight(residual / sigma) * (start.weight / sigma) ** 2
        weighted = (Q * weight[:, :, None]).reshape(flat.shape)
        score = weighted.T @ (residual / start.weight).ravel()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error", scipy.linalg.LinAlgWarning)
                step = scipy.linalg.solve(weighted.T @ flat, score, assume_a="pos")
        except (np.linalg.LinAlgError, scipy.linalg.LinAlgWarning):
            raise Infeasible(
                "robust regression",
                f"rows that count with {influence.name} influence do not determine all "
                "parameters; use another estimator, or record more",
            ) from None
        beta = beta + inverse @ step
        moved, rounding = Q @ step * start.weight, _ROUNDING * np.abs(problem.tau).max(axis=0)
        if float(((moved / (sigma + rounding / _SETTLED)) ** 2).mean()) <= _SETTLED**2:
            return beta
    raise Infeasible(
        "robust regression",
        f"weights did not settle in {_ROUNDS} rounds with {influence.name} influence; "
        "use another estimator, or record more",
    )


# instrumental variables


def iv(problem: Regression, instruments: Regression) -> LeastSquares:
    """Two-stage least squares: W projected on the instruments Z, then fitted to the torque.

    Least squares is biased where W has errors, because WᵀW contains their squares. Instruments
    have errors independent of those of W and of the torque, so that Zᵀ(τ − W β) = 0 has no such
    term. Janot, Vandanjon, Gautier (2014) simulate the closed loop for them; here they are
    columns on other samples of the same motion (`half_regressions`). For as many instruments as
    columns the estimate is (ZᵀW)⁻¹ Zᵀτ, rows weighted by the noise of their joint. Variance is
    larger than that of least squares; weak instruments leave bias. Columns that are no linear
    functions of the noise (signs of velocities) keep part of theirs.

    Args:
        problem: Columns W and torque.
        instruments: Columns Z at the same instants, at least as many.

    Raises:
        RankDeficient: Columns, or instruments, that the motion does not show.
    """
    sigma = weighted_least_squares(problem).sigma
    for _ in range(_STAGES):
        factor = factorised(_projected(problem, instruments, sigma), sigma)
        beta = factor.solve()
        residual = problem.residual(beta)
        sigma = noise_of(residual, len(beta))
    return with_covariance(factor, beta, residual, sigma)


def _projected(problem: Regression, instruments: Regression, sigma: Array) -> Regression:
    """The problem with the part of its columns that instruments explain."""
    k, r = instruments.p, problem.p
    stage = factorised(instruments, sigma)
    both = instruments.with_columns(problem.W, problem.names)
    R = triangle(both.stacked(1 / sigma)[:, :-1] / np.append(stage.norms, np.ones(r)))
    C = scipy.linalg.solve_triangular(R[:k, :k], R[:k, k:]) / stage.norms[:, None]
    pairs = zip(instruments.index, instruments.columns, strict=True)
    explained = np.stack([Z @ C[index] for index, Z in pairs], axis=1)
    return dense(explained, problem.tau, problem.names, problem.starts)


def errors_in_variables(problem: Regression, instruments: Regression) -> tuple[float, float]:
    """Test whether errors of W move with those of the torque.

    Durbin (1954), Wu (1973), Hausman (1978), as a regression with the errors added.
    V is the part of W that instruments do not explain. Without errors in W that matter, V has no
    coefficient of its own in τ ≈ W β + V γ. The statistic γ̂ᵀ C⁻¹ γ̂, C the covariance of γ̂ under
    coloured noise, is then χ² with as many degrees of freedom as V has independent columns. A
    small p says that least squares is biased, by noise in the motion or by its filter (perhaps by
    little: compare the estimates); a model that lacks physics leaves p large, unless what it lacks
    moves with V.

    Returns:
        Statistic, and p, the chance of one as large where least squares is not biased.

    Raises:
        BadInput: Instruments that explain W entirely leave nothing to test.
        RankDeficient: Columns, or instruments, that the motion does not show.
    """
    r, W = problem.p, problem.W
    sigma = weighted_least_squares(problem).sigma
    left = (W - _projected(problem, instruments, sigma).W) / sigma[:, None]
    lengths = np.linalg.norm(W / sigma[:, None], axis=(0, 1))
    U, s, _ = scipy.linalg.svd((left / lengths).reshape(-1, r), full_matrices=False)
    keep = s > _SAME
    if not keep.any():
        raise BadInput(
            "the instruments explain the columns entirely, so nothing is left to test; "
            "give instruments with errors of their own"
        )
    V = U[:, keep].reshape(*W.shape[:2], -1) * sigma[:, None]
    added = tuple(f"error {k + 1}" for k in range(V.shape[2]))
    fit = weighted_least_squares(problem.with_columns(V, added))
    gamma, C = fit.beta[r:], fit.covariance[r:, r:]
    statistic = float(gamma @ scipy.linalg.solve(C, gamma, assume_a="pos"))
    return statistic, float(scipy.stats.chi2.sf(statistic, len(gamma)))


def _tested(problem: Regression, instruments: Regression, fit: LeastSquares) -> str:
    """What the test says of least squares of the same columns, and how much it matters."""
    try:
        statistic, p = errors_in_variables(problem, instruments)
    except BadInput:
        return "even and odd samples show one and the same motion: no errors of it to be tested"
    moved = np.abs(weighted_least_squares(problem).beta - fit.beta) / fit.std
    found = "are seen" if p < _CERTAIN else "are not seen"
    return (
        f"errors of the motion that bias least squares {found} (Durbin-Wu-Hausman: "
        f"{statistic:.4g}, p = {p:.2g}); instruments move its base parameters by up to "
        f"{moved.max():.2g} standard deviations"
    )


@dataclass(frozen=True)
class EverySecond:
    """A differentiator that sees every second sample, and speaks about all instants.

    Attributes:
        first: 0 for even samples, 1 for odd ones.
        inner: What differentiates; samples left out are interpolated by a quintic spline before.
    """

    first: int
    inner: Differentiator

    @property
    def name(self) -> str:
        """Name with its settings."""
        return f"{('even', 'odd')[self.first]} samples, {self.inner.name}"

    def delay(self, rate_hz: float) -> float:
        """That of the inner one [s]."""
        return self.inner.delay(rate_hz)

    def __call__(self, t: Array, q: Array) -> Motion:
        """Motion at all samples; q has shape (n, nv)."""
        seen = slice(self.first, None, 2)
        return self.inner(t, scipy.interpolate.make_interp_spline(t[seen], q[seen], k=5)(t))


def half_regressions(
    rows: FitRows, recordings: Sequence[Recording]
) -> tuple[Regression, Regression]:
    """Base columns from even and from odd samples at the rows of a fit.

    Their errors are independent where the noise of a position sensor is so from sample to sample
    at regular time: not for a sensor that low-passes before it logs, nor for errors that depend
    on the position (scale, eccentricity), for which every sample is wrong alike.

    Args:
        rows: What is fitted.
        recordings: Behind these rows, in order.

    Raises:
        BadInput: A rate below five times the cut-off.
    """
    cutoff_hz, halves = rows.data.cutoff_hz, []
    for first in (0, 1):
        segments = []
        for recording in recordings:
            rate_hz = 1 / float(np.median(np.diff(recording.t)))
            highest = _RATE_SHARE * rate_hz
            if cutoff_hz > highest * (1 + 1e-6):
                raise BadInput(
                    f"{recording.name}: every second sample at {rate_hz:.4g} Hz does not show "
                    f"motion up to the cut-off of {cutoff_hz:g} Hz; choose one up to "
                    f"{highest:.3g} Hz"
                )
            inner = ZeroPhaseButterworth(min(POSITION_RATIO * cutoff_hz, highest))
            segments += prepare(recording, cutoff_hz, EverySecond(first, inner))
        half = regression_of(rows.robot, rows.effects, segments).with_torque(rows.tau)
        halves.append(half.select(rows.base.columns, rows.base.expressions))
    return halves[0], halves[1]
