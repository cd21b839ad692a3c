"""Covariance of least squares under coloured noise, with what the fit took out of the residual.

Torque τ_j = W_j β + ε_j of each joint j, ε_j stationary with autocovariance γ_j, so that its
covariance matrix Γ_j is Toeplitz. The least-squares estimate A⁻¹ Σ_j W_jᵀ τ_j, A = Σ_j W_jᵀ W_j,
then has covariance A⁻¹ Ω A⁻¹ with Ω = Σ_j W_jᵀ Γ_j W_j: noise counts by its strength at the
frequencies where the columns move, not by one number.

γ_j is that of an autoregression whose order minimises Akaike's criterion (Yule and Walker's
equations). Residuals lack what the fit explained of the noise, most of it slow:

    E[e_j e_jᵀ] = Γ_j − W_j H_jᵀ − H_j W_jᵀ,   H_j = Γ_j W_j A⁻¹ − ½ W_j A⁻¹ Ω A⁻¹,

so the autocovariance of the residual is corrected by the second and third term, which depend on γ
themselves: a fixed point, reached in a few rounds. (Sums over lags are divided by n, not by their
number: only then is γ an autocovariance.) What remains is that γ comes from few samples that
count: the power at low frequency has relative variance 2 / ν (delta method for the coefficients),
so an estimate over its standard deviation is Student's t of ν degrees of freedom, not normal.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy

from excitant.robots.motion import Array

_ROUNDS = 4  # of giving back what the fit took; each leaves the share of noise that it takes
_FEWEST = 3.0  # degrees of freedom, below which no noise is known
_STABLE = 0.9999  # largest reflection coefficient of an autoregression


@dataclass(frozen=True, eq=False)
class JointRows:
    """Rows of one joint without the columns that are silent there.

    Attributes:
        used: Columns that are not silent, u of them.
        W: Shape (u, n).
        spectrum: Its Fourier transform, padded with zeros to `size`, shape (u, size / 2 + 1).
        size: Length of the transform.
    """

    used: npt.NDArray[np.intp]
    W: Array
    spectrum: npt.NDArray[np.complex128]
    size: int

    def coloured(self, gamma: Array) -> Array:
        """W_jᵀ Γ_j, shape (u, n), Γ_j that of the autoregression behind γ."""
        if gamma[0] <= 0:  # a residual that is nothing but rounding
            return self.W
        n = self.W.shape[1]
        a, variance = autoregression(gamma, n)
        power = variance / np.abs(scipy.fft.rfft(a, self.size)) ** 2
        return np.asarray(scipy.fft.irfft(power * self.spectrum, self.size)[:, :n], float)

    def taken(self, G: Array, inverse: Array, both: Array, lags: int) -> Array:
        """Autocovariance that the fit took, shape (lags + 1,).

        Args:
            G: W_jᵀ Γ_j, shape (u, n).
            inverse: A⁻¹.
            both: A⁻¹ Ω A⁻¹.
            lags: Largest lag.
        """
        block = np.ix_(self.used, self.used)
        H = inverse[block] @ G - both[block] @ self.W / 2
        cross = np.einsum("uf,uf->f", self.spectrum.conj(), scipy.fft.rfft(H, self.size)).real
        return np.asarray(scipy.fft.irfft(2 * cross, self.size)[: lags + 1] / self.W.shape[1])


def joint_rows(W: Array, used: npt.NDArray[np.intp] | None = None) -> JointRows:
    """Rows of one joint, shape (n, r), ready for `scores_of`; or those of the columns used."""
    if used is None:
        used = np.flatnonzero((W != 0).any(axis=0))
        W = W[:, used]
    columns, size = np.ascontiguousarray(W.T), scipy.fft.next_fast_len(2 * len(W), True)
    return JointRows(used, columns, scipy.fft.rfft(columns, size), size)


def score_covariances(W: Array, residual: Array, inverse: Array) -> tuple[Array, Array]:
    """W_jᵀ Γ_j W_j of each joint, shape (nv, r, r), and their degrees of freedom, shape (nv,).

    The sum of the former is Ω.

    Args:
        W: Columns, each row divided by its joint's noise, shape (n, nv, r).
        residual: Residuals of least squares, divided alike, shape (n, nv).
        inverse: A⁻¹ = (Σ_j W_jᵀ W_j)⁻¹, shape (r, r).
    """
    return scores_of([joint_rows(W[:, j]) for j in range(W.shape[1])], residual, inverse)


def scores_of(rows: list[JointRows], residual: Array, inverse: Array) -> tuple[Array, Array]:
    """`score_covariances` of columns that are kept joint by joint."""
    n, lags = len(residual), _lags(len(residual))
    observed = autocovariance(residual, lags)
    gammas = list(observed.T)
    for _ in range(_ROUNDS):
        parts = [joint.coloured(gamma) for joint, gamma in zip(rows, gammas, strict=True)]
        both = inverse @ _scores(rows, parts, len(inverse)).sum(axis=0) @ inverse
        for j, joint in enumerate(rows):
            gammas[j] = observed[:, j] + joint.taken(parts[j], inverse, both, lags)
    parts = [joint.coloured(gamma) for joint, gamma in zip(rows, gammas, strict=True)]
    freedom = np.array([degrees_of_freedom(gamma, n) for gamma in gammas])
    return _scores(rows, parts, len(inverse)), freedom


def degrees_of_freedom(gamma: Array, n: int) -> float:
    """ν of the power of slow noise, from the autocovariance of n samples.

    log S(0) = log σ² − 2 log A(1) with A(1) = 1 + Σ a_k; the coefficients a have covariance
    σ² Γ_p⁻¹ / n, and σ² the relative variance 2 / n.
    """
    if gamma[0] <= 0:
        return float(n)
    a, variance = autoregression(gamma, n)
    p = len(a) - 1
    relative = 2 / n
    if p:
        ones = np.ones(p)
        spread = variance / n * ones @ scipy.linalg.solve_toeplitz(gamma[:p], ones)
        relative += 4 * float(spread) / float(a.sum()) ** 2
    return float(np.clip(2 / relative, _FEWEST, n))


def _lags(n: int) -> int:
    """Largest order of an autoregression of n samples."""
    return min(n // 4, int(10 * np.log10(n)))


def _scores(rows: list[JointRows], parts: list[Array], r: int) -> Array:
    found = np.zeros((len(rows), r, r))
    for score, joint, G in zip(found, rows, parts, strict=True):
        S = joint.W @ G.T
        score[np.ix_(joint.used, joint.used)] = (S + S.T) / 2
    return found


def autocovariance(values: Array, lags: int) -> Array:
    """Σ_i x_i x_{i+k} / n of columns of zero mean, shape (lags + 1, columns)."""
    n = len(values)
    return np.array([(values[: n - k] * values[k:]).sum(axis=0) / n for k in range(lags + 1)])


def autoregression(gamma: Array, n: int) -> tuple[Array, float]:
    """The autoregression that Akaike's criterion prefers (Levinson and Durbin's recursion).

    Args:
        gamma: Autocovariance at lags 0 to p, shape (p + 1,).
        n: Number of samples behind it.

    Returns:
        Polynomial 1 + a_1 z⁻¹ + …, and the variance of the innovations.
    """
    a, variance = np.ones(1), float(gamma[0])
    best = (n * np.log(variance), a, variance)
    for p in range(1, len(gamma)):
        reflection = -float(a @ gamma[p:0:-1]) / variance
        if abs(reflection) > _STABLE:
            break
        a = np.append(a, 0.0) + reflection * np.append(a, 0.0)[::-1]
        variance *= 1 - reflection**2
        criterion = n * np.log(variance) + 2 * p
        if criterion < best[0]:
            best = (criterion, a, variance)
    return best[1], best[2]
