"""Weighted least squares on base parameters under coloured noise.

Torque τ_j = W_j β + ε_j of each joint j, ε_j stationary with autocovariance γ_j, so that its
covariance matrix Γ_j is Toeplitz. The least-squares estimate A⁻¹ Σ_j W_jᵀ τ_j, A = Σ_j W_jᵀ W_j,
then has covariance A⁻¹ Ω A⁻¹ with Ω = Σ_j W_jᵀ Γ_j W_j: noise counts by its strength at the
frequencies where the columns move, not by one number.

γ_j is that of an autoregression whose order minimises Akaike's criterion (Yule and Walker's
equations). Residuals lack what the fit explained of the noise, most of it slow:

    E[e_j e_jᵀ] = Γ_j − W_j H_jᵀ − H_j W_jᵀ,   H_j = Γ_j W_j A⁻¹ − ½ W_j A⁻¹ Ω A⁻¹,

so the autocovariance of the residual is corrected by the second and third term, which depend on γ
themselves: a fixed point. (Sums over lags are divided by n: only then is γ an autocovariance.) As γ
comes from few samples that count, the power at low frequency has relative variance 2 / ν (delta
method for the coefficients), and an estimate over its standard deviation is Student's t.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self

import numpy as np
import numpy.typing as npt
import scipy

from excitant.exceptions import RankDeficient
from excitant.identify.regression import Regression, triangle
from excitant.robots.motion import Array, Noun, quotient

SMALLEST = 1e-12  # torque noise taken for none


@dataclass(frozen=True)
class NoiseSettings:
    """How noise is estimated.

    Attributes:
        rounds: Re-estimations of the noise of each joint; weights settle in two or three.
        finest: Noise relative to the largest, below which rows would leave no digits to others.
        returned: Rounds of returning the autocovariance that the fit took; each leaves the share
            that the fit takes.
        freedom: Least degrees of freedom of a noise level.
        reflection: Largest reflection coefficient of a stable autoregression.
    """

    rounds: int = 4
    finest: float = 1e-6
    returned: int = 4
    freedom: float = 3.0
    reflection: float = 0.9999


NOISE = NoiseSettings()


@dataclass(frozen=True, eq=False)
class LeastSquares(Noun):
    """Weighted least-squares estimate.

    Attributes:
        beta: Estimate, shape (r,).
        covariance: Its covariance, for noise as coloured as the residual, shape (r, r).
        sigma: Standard deviation of each joint's residual, shape (nv,) [torque unit].
        inflation: Rows of each joint that count as one independent row, at least 1, (nv,).
        bias: Root of the second moment of its bias by what the model lacks, shape (r, k).
        excess: How many times wider covariance and inflation are than noise makes deviations.
    """

    beta: Array
    covariance: Array
    sigma: Array
    inflation: Array
    bias: Array | None = field(default=None, kw_only=True)
    excess: float = field(default=1.0, kw_only=True)

    @property
    def uncertainty(self) -> Array:
        """Covariance with that of the bias, shape (r, r)."""
        if self.bias is None:
            return self.covariance
        return self.covariance + self.bias @ self.bias.T

    @property
    def std(self) -> Array:
        """Standard deviations of the estimate by noise alone, shape (r,)."""
        return np.sqrt(np.diag(self.covariance)) / self.excess

    @property
    def weight(self) -> Array:
        """Weights of joints' rows with which squares are −2 log-likelihood, shape (nv,)."""
        return 1 / (self.sigma * np.sqrt(self.inflation))

    def widened(self, times: float) -> Self:
        """The estimate so many times less certain, as if by colour of the noise."""
        return replace(
            self,
            covariance=times**2 * self.covariance,
            inflation=times**2 * self.inflation,
            excess=times * self.excess,
        )


@dataclass(frozen=True, eq=False)
class Factor:
    """QR factorisation of columns, W_j / weight_j = Q_j R diag(norms), z = Qᵀ τ / weight.

    Rows were divided by the noise of their joint, weight, shape (nv,) [torque unit].
    """

    problem: Regression
    weight: Array
    norms: Array
    R: Array
    z: Array

    def solve(self) -> Array:
        """β of least squares, shape (r,)."""
        return scipy.linalg.solve_triangular(self.R, self.z) / self.norms

    @property
    def inverse(self) -> Array:
        """(R diag(norms))⁻¹, shape (r, r)."""
        inverse = scipy.linalg.solve_triangular(self.R, np.eye(len(self.R)))
        return inverse / self.norms[:, None]


def factorised(problem: Regression, weight: Array) -> Factor:
    """Factorisation of columns, rows divided by their joint's noise.

    Raises:
        RankDeficient: Columns that are silent, or that others explain.
    """
    r = problem.p
    names = problem.names
    if problem.undetermined:
        raise RankDeficient(
            [names[k] for k in problem.undetermined],
            "this motion does not determine these parameters (move the joints that show them, "
            "or design an excitation)",
        )
    rows = problem.stacked(1 / weight)
    norms = np.linalg.norm(rows[:, :r], axis=0)
    R = triangle(rows / np.append(norms, 1.0))
    return Factor(problem, weight, norms, R[:r, :r], R[:r, r])


def weighted_least_squares(problem: Regression) -> LeastSquares:
    """Solve τ ≈ W β with one noise level per joint, estimated along the way.

    The covariance counts coloured noise and is widened by Student's t for the samples that the
    noise is known from, so that ± 1.96 standard deviations are a 95 % interval. Inflation is
    tr(A⁻¹ Ω_j) / tr(A⁻¹ A_j), the mean effect of colour over what joint j's rows determine
    (Gautier 1997; Swevers et al. 1997).

    Raises:
        RankDeficient: The motion does not show some columns.
    """
    factor, beta, residual, sigma = settled(problem)
    return replace(
        with_covariance(factor, beta, residual, factor.weight), sigma=sigma
    )


def settled(problem: Regression) -> tuple[Factor, Array, Array, Array]:
    """Factorisation, β, residual and noise level of each joint, once the weights have settled.

    Raises:
        RankDeficient: As `weighted_least_squares`.
    """
    sigma = believed(problem.tau.std(axis=0))
    for _ in range(NOISE.rounds):
        factor = factorised(problem, sigma)
        beta = factor.solve()
        residual = problem.residual(beta)
        sigma = noise_of(problem.counted(residual), len(beta))
    return factor, beta, residual, sigma


def noise_of(residuals: Sequence[Array], r: int) -> Array:
    """Standard deviation of each joint's residual after r parameters in all, shape (nv,).

    A joint without rows has the largest noise of all.
    """
    rows = np.array([len(e) for e in residuals])
    variance = np.array([e @ e for e in residuals]) / np.maximum(rows, 1)
    variance = np.where(rows > 0, variance, variance.max())
    freedom = max(rows.sum() - r, 1) / rows.sum()
    return believed(np.sqrt(variance / freedom))


def believed(sigma: Array) -> Array:
    """Noise levels, floored so that no joint's weight dominates numerically, shape (nv,)."""
    return np.maximum(sigma, max(SMALLEST, NOISE.finest * float(sigma.max())))


def with_covariance(
    factor: Factor, beta: Array, error: Array, sigma: Array
) -> LeastSquares:
    """An estimate with its covariance A⁻¹ Ω A⁻¹, widened for what the noise is known from.

    Every estimator here is, to first order in the noise, least squares of some columns X_j with an
    error ε_j: β̂ − β = A⁻¹ Σ_j X_jᵀ ε_j, A = Σ_j X_jᵀ X_j. The columns are W itself (weighted), W
    with the slope of the influence (robust), or W projected on instruments.

    The error, shape (n, nv), is ε_j as the residual shows it; sigma is reported as noise, (nv,).
    """
    problem = factor.problem
    root = factor.inverse
    scaled = error / factor.weight
    rows = []
    for j, index in enumerate(problem.index):
        V = np.linalg.qr(root[index].T)[0]
        W = problem.columns[j][problem.rows(j)] / factor.weight[j]
        rows.append(JointRows(W @ (root[index] @ V), V))
    scores, freedom = score_covariances(rows, problem.counted(scaled))
    parts = root @ scores @ root.T
    # Student's t of the sum of all joints' variances (Satterthwaite 1946)
    variances = np.diagonal(parts, axis1=1, axis2=2)
    squares = variances.sum(axis=0) ** 2
    spread = (variances**2 / freedom[:, None]).sum(axis=0)
    nu = quotient(squares, spread, otherwise=np.inf)
    width = student_width(nu)
    covariance = parts.sum(axis=0) * np.outer(width, width)
    seen = np.array([(joint.X**2).sum() for joint in rows])  # tr(A⁻¹ A_j)
    white = seen * (sigma / factor.weight) ** 2
    coloured = np.trace(scores, axis1=1, axis2=2)
    inflation = quotient(coloured, white, otherwise=1.0)
    return LeastSquares(beta, covariance, sigma, np.maximum(inflation, 1.0))


def student_width(freedom: Array | float) -> Array:
    """Student's over normal 97.5 % quantile, for degrees of freedom of any shape."""
    student = scipy.special.stdtrit(freedom, 0.975)
    return np.asarray(student / scipy.special.ndtri(0.975), float)


@dataclass(frozen=True, eq=False)
class JointRows:
    """Rows X Vᵀ of one joint j in coordinates of the parameters in which A = Σ_j W_jᵀ W_j is one.

    Attributes:
        X: Shape (n, u).
        V: Orthonormal columns, shape (r, u).
    """

    X: Array
    V: Array

    @property
    def size(self) -> int:
        """Length of transforms, padded with zeros."""
        return int(scipy.fft.next_fast_len(2 * len(self.X), True))

    @cached_property
    def spectrum(self) -> npt.NDArray[np.complex128]:
        """Fourier transform of X, shape (u, size / 2 + 1)."""
        return self._transform(np.ascontiguousarray(self.X.T))

    def _transform(self, values: Array) -> npt.NDArray[np.complex128]:
        return scipy.fft.rfft(values, self.size)

    def coloured(self, gamma: Array, exponent: float = 1.0) -> Array:
        """Xᵀ Γ_j to a power, shape (u, size), Γ_j that of the autoregression behind γ."""
        if gamma[0] <= 0:  # a residual that is nothing but rounding
            return self.X.T
        a, variance = autoregression(gamma, len(self.X))
        power = variance / np.abs(self._transform(a)) ** 2
        return scipy.fft.irfft(power**exponent * self.spectrum, self.size)

    def score(self, gamma: Array) -> Array:
        """W_jᵀ Γ_j W_j, of squares, which are positive semidefinite, shape (r, r)."""
        half = self.coloured(gamma, 0.5)
        return self.V @ (half @ half.T) @ self.V.T

    def taken(self, gamma: Array, total: Array, lags: int) -> Array:
        """Autocovariance that the fit took of γ, Ω being the total, (r, r); shape (lags + 1,)."""
        n = len(self.X)
        if not n:
            return np.zeros(lags + 1)
        H = self.coloured(gamma)[:, :n] - self.V.T @ total @ self.V @ self.X.T / 2
        product = np.einsum("uf,uf->f", self.spectrum.conj(), self._transform(H))
        cross = scipy.fft.irfft(2 * product.real, self.size)
        return cross[: lags + 1] / n


def score_covariances(
    rows: Sequence[JointRows], residuals: Sequence[Array]
) -> tuple[Array, Array]:
    """W_jᵀ Γ_j W_j of each joint, whose sum is Ω, (nv, r, r), and degrees of freedom, (nv,).

    Residuals of least squares, each (n_j,), are divided by the noise of their joint as its rows
    are. Rows that follow after a pause are taken to follow at once.
    """
    counts = [len(e) for e in residuals]
    lags = [min(n // 4, int(10 * np.log10(max(n, 1)))) for n in counts]
    observed = [autocovariance(e, k) for e, k in zip(residuals, lags, strict=True)]
    gammas = observed
    for remaining in range(NOISE.returned, -1, -1):
        scores = np.array([*map(JointRows.score, rows, gammas)])
        if remaining:
            total = scores.sum(axis=0)
            joints = zip(observed, rows, gammas, lags, strict=True)
            gammas = [
                first + joint.taken(gamma, total, k)
                for first, joint, gamma, k in joints
            ]
    return scores, np.array([*map(_degrees_of_freedom, gammas, counts)])


def _degrees_of_freedom(gamma: Array, n: int) -> float:
    """ν of the power of slow noise, from the autocovariance of n samples.

    log S(0) = log σ² − 2 log A(1) with A(1) = 1 + Σ a_k; the coefficients a have covariance
    σ² Γ_p⁻¹ / n, and σ² the relative variance 2 / n.
    """
    if gamma[0] <= 0:
        return float(max(n, NOISE.freedom))
    a, variance = autoregression(gamma, n)
    p = len(a) - 1
    relative = 2 / n
    if p:
        ones = np.ones(p)
        inverse_sum = float(ones @ scipy.linalg.solve_toeplitz(gamma[:p], ones))
        relative += 4 * variance / n * inverse_sum / float(a.sum()) ** 2
    return float(np.clip(2 / relative, NOISE.freedom, n))


def autocovariance(values: Array, lags: int) -> Array:
    """Σ_i x_i x_{i+k} / n of values of zero mean, (n,) or (n, columns), at lags 0 to k."""
    n = len(values)
    sums = [(values[: n - k] * values[k:]).sum(axis=0) for k in range(lags + 1)]
    return np.array(sums) / max(n, 1)


def autoregression(gamma: Array, n: int) -> tuple[Array, float]:
    """The autoregression that Akaike's criterion prefers (Levinson and Durbin's recursion).

    From the autocovariance of n samples at lags 0 to p: polynomial 1 + a_1 z⁻¹ + …, and the
    variance of the innovations.
    """
    a = np.ones(1)
    variance = float(gamma[0])
    best = (n * np.log(variance), a, variance)
    for p in range(1, len(gamma)):
        reflection = -float(a @ gamma[p:0:-1]) / variance
        if abs(reflection) > NOISE.reflection:
            break
        longer = np.append(a, 0.0)
        a = longer + reflection * longer[::-1]
        variance *= 1 - reflection**2
        criterion = n * np.log(variance) + 2 * p
        if criterion < best[0]:
            best = (criterion, a, variance)
    return best[1], best[2]


def autocorrelation(values: Array) -> Array:
    """ρ_k of the first third of all lags, ρ_0 = 1, shape (n,) → (n / 3,); white if constant."""
    centred = values - values.mean()
    n = len(values)
    size = scipy.fft.next_fast_len(2 * n, True)
    spectrum = np.abs(scipy.fft.rfft(centred, size)) ** 2
    correlation = scipy.fft.irfft(spectrum, size)[: max(n // 3, 1)]
    if correlation[0] <= 0:
        return np.eye(len(correlation))[0]
    return correlation / correlation[0]


def autocorrelation_time(residual: Array) -> float:
    """Integrated autocorrelation time 1 + 2 Σ ρ_k, summed to the first non-positive ρ_k."""
    rho = autocorrelation(residual)
    end = int(np.argmax(rho <= 0)) if (rho <= 0).any() else len(rho)
    return float(max(1.0, 1 + 2 * rho[1:end].sum()))
