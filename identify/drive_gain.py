"""Drive gains [N·m/A] from recordings of motor current, relative to the given masses.

Current is i_j = c_j (W_j β) + F_j θ_j with one gain k_j = 1/c_j per joint. Parameters of the
outer links appear in the rows of several joints, so the gains *relative to each other* follow
from the data (alternating least squares); their common scale does not, and is set so that the
given robot's masses explain the current best.
"""

from __future__ import annotations

import numpy as np

from excitant.identify.least_squares import autocorrelation_time
from excitant.robots.motion import Array

_REWEIGHTINGS = 4  # of the noise of each joint
_ROUNDS = 200
_CONVERGED = 1e-6
_SPREAD = 0.5  # drives of one arm have gains of one order: decides only what data leave open


def drive_gains(W: Array, F: Array, current: Array, given: Array) -> Array:
    """Gains k with torque = k · current, shape (nv,) [N·m/A].

    A gain that the motion hardly shows stays near those of the other joints.

    Args:
        W: Base columns of the links, shape (n, nv, r).
        F: Columns of each joint's own effects, shape (n, nv, e).
        current: Motor currents, shape (n, nv) [A].
        given: Rigid-body torque of the given robot, shape (n, nv) [N·m].
    """
    W, current, given = (_without_effects(values, F) for values in (W, current, given))
    gram = np.einsum("njr,njs->jrs", W, W, optimize=True)
    moment = np.einsum("njr,nj->jr", W, current, optimize=True)
    gains, beta = np.ones(W.shape[1]), np.zeros(W.shape[2])
    sigma, independent = np.maximum(current.std(axis=0), 1e-12), np.ones(W.shape[1])
    for _ in range(_REWEIGHTINGS):
        gains, beta = _alternate(gram, moment, sigma, independent, gains)
        residual = current - W @ beta / gains
        sigma = np.maximum(residual.std(axis=0), 1e-12)
        independent = 1 / np.array([autocorrelation_time(e) for e in residual.T])
    model = given / gains
    scale = ((model / sigma) ** 2).sum() / (model * current / sigma**2).sum()
    return np.asarray(gains * abs(scale), float)


def _alternate(
    gram: Array, moment: Array, sigma: Array, independent: Array, gains: Array
) -> tuple[Array, Array]:
    """Alternate between base parameters and gains until the gains settle."""
    prior = 1 / _SPREAD**2  # of 1/k around the geometric mean, which is kept at 1
    for _ in range(_ROUNDS):
        weight = independent / sigma**2
        A = np.einsum("j,jrs->rs", weight / gains**2, gram)
        beta = np.linalg.lstsq(A, (weight / gains) @ moment, rcond=1e-12)[0]
        information = weight * np.einsum("r,jrs,s->j", beta, gram, beta)
        evidence = weight * (moment @ beta)
        updated = (information + prior) / np.maximum(evidence + prior, prior / 10)
        updated /= np.exp(np.log(updated).mean())
        change = np.abs(np.log(updated / gains)).max()
        gains = updated
        if change < _CONVERGED:
            break
    return gains, beta


def _without_effects(values: Array, F: Array) -> Array:
    """Values, shape (n, nv, ...), less what each joint's own effect columns can explain."""
    rest = np.empty_like(values)
    for j in range(F.shape[1]):
        columns = F[:, j][:, np.any(F[:, j] != 0, axis=0)]
        Q = np.linalg.qr(columns)[0]
        rest[:, j] = values[:, j] - Q @ (Q.T @ values[:, j])
    return rest
