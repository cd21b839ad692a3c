"""Torque per ampere of motor currents, relative to the given masses.

Current is i_j = c_j (W_j β) + F_j θ_j with one gain k_j = 1/c_j per joint. Parameters of the
outer links appear in the rows of several joints, so the gains *relative to each other* follow
from the data (alternating least squares); their common scale does not, and is set so that the
given robot's masses explain the current best.

Runs in which joints move one at a time hold next to nothing of that, and what friction does at
their ends would pass for it. Each gain is then that with which the given masses explain the
joint's current, drawn to the others as far as the torque of given masses is itself unsure, as that
of a wrist whose centre of mass lies nearly on its axis: drives of one arm are of one order.
"""

from __future__ import annotations

import numpy as np

from excitant.identify.least_squares import autocorrelation_time
from excitant.identify.preprocessing import Mask
from excitant.identify.prior import link_coordinates, link_weights, prior_parameters
from excitant.robots.base_parameters import BaseParameters
from excitant.robots.motion import Array
from excitant.robots.robot import Robot

_REWEIGHTINGS = 4  # of the noise of each joint
_ROUNDS = 200
_CONVERGED = 1e-6
_SPREAD = 0.5  # of drives of one arm: decides only what data leave open
_LINKS = 0.3  # relative uncertainty of given links
_TOGETHER = 0.5  # share of a joint's rows with another joint moving, from which rows compare


def current_gains(
    robot: Robot, base: BaseParameters, W: Array, current: Array, moves: Mask | None = None
) -> tuple[Array, bool]:
    """Gains k with torque = k · current, shape (nv,) [N·m/A], and whether joints were compared.

    A gain that the motion hardly shows stays near those of the other joints.

    Args:
        robot: The arm with the given masses.
        base: Base parameters of links and effects.
        W: Columns of links and effects, shape (n, nv, p).
        current: Motor currents, shape (n, nv) [A].
        moves: Rows in which a joint moves, shape (n, nv); only these count. All when None.
    """
    links = 10 * robot.nv
    if moves is not None:
        several = moves.sum(axis=1) > 1
        share = (moves & several[:, None]).sum(axis=0) / np.maximum(moves.sum(axis=0), 1)
        if (share < _TOGETHER).any():
            return _each_alone(robot, W, current, moves), False
        W, current = W * moves[:, :, None], current * moves
    columns = [c for c in base.columns if c < links]
    given = W[:, :, :links] @ robot.phi
    return _compared(W[:, :, columns], W[:, :, links:], current, given), True


def _compared(W: Array, F: Array, current: Array, given: Array) -> Array:
    """Gains from rows of several joints at once.

    Args:
        W: Base columns of the links, shape (n, nv, r).
        F: Columns of each joint's own effects, shape (n, nv, e).
        current: Motor currents, shape (n, nv) [A].
        given: Rigid-body torque of the given robot, shape (n, nv) [N·m].
    """
    parts = [
        _without_effects(F[:, j], W[:, j], current[:, j], given[:, j]) for j in range(W.shape[1])
    ]
    W, current, given = (np.stack(values, axis=1) for values in zip(*parts, strict=True))
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


def _each_alone(robot: Robot, W: Array, current: Array, moves: Mask) -> Array:
    """Gains from each joint's own rows, as logarithms that scatter around a common one."""
    links = 10 * robot.nv
    spread = _LINKS * link_coordinates(prior_parameters(robot)) / link_weights(robot.nv, 1.0)
    pairs = [
        _log_gain(W[rows, j, :links], W[rows, j, links:], current[rows, j], robot.phi, spread)
        for j, rows in enumerate(moves.T)
    ]
    own, variance = np.array(pairs).T
    if not np.isfinite(variance).any():
        return np.ones(robot.nv)
    weight = 1 / (variance + _SPREAD**2)
    common = float(weight @ own / weight.sum())
    return np.asarray(np.exp(common + _SPREAD**2 * weight * (own - common)), float)


def _log_gain(Y: Array, F: Array, current: Array, phi: Array, spread: Array) -> tuple[float, float]:
    """Logarithm of the gain with which the given torque explains a current, and its variance.

    Args:
        Y: Columns of the links, shape (n, 10 nv).
        F: Columns of effects, shape (n, e).
        current: Readings, shape (n,) [A].
        phi: Given standard parameters, shape (10 nv,).
        spread: Square root of their covariance, shape (10 nv, 10 nv).
    """
    count = int(np.any(F != 0, axis=0).sum())
    if len(current) <= count + 1:
        return 0.0, np.inf
    Y, i = _without_effects(F, Y, current)
    tau = Y @ phi
    size = float(tau @ tau)
    per_torque = float(tau @ i) / max(size, 1e-300)
    if per_torque <= 0:
        return 0.0, np.inf
    residual = i - per_torque * tau
    noise = float(residual @ residual) / (len(i) - count - 1)
    variance = noise * autocorrelation_time(residual) / size / per_torque**2
    unsure = float(np.sum((tau @ Y @ spread) ** 2)) / size**2
    return -float(np.log(per_torque)), variance + unsure


def _without_effects(F: Array, *values: Array) -> tuple[Array, ...]:
    """Values at a joint's rows less what its own effect columns F, shape (n, e), can explain."""
    Q = np.linalg.qr(F[:, np.any(F != 0, axis=0)])[0]
    return tuple(x - Q @ (Q.T @ x) for x in values)
