"""Torque per reading where stages must agree on it: drive gains of recordings link by link.

Gains relative to each other follow from links that the rows of several joints show at once. Runs
in which joints move one at a time hold next to nothing of that, and what friction does at their
ends would pass for it. Each gain is then that with which the given masses explain the joint's
current, drawn to the others as far as the torque of given masses is itself unsure, as that of a
wrist whose centre of mass lies nearly on its axis: drives of one arm are of one order.
"""

from __future__ import annotations

import numpy as np

from excitant.identify.drive_gain import drive_gains
from excitant.identify.least_squares import autocorrelation_time
from excitant.identify.physical import link_coordinates, link_weights, prior_parameters
from excitant.identify.standstill import Mask
from excitant.robots.base_parameters import BaseParameters
from excitant.robots.motion import Array
from excitant.robots.robot import Robot

_TOGETHER = 0.5  # share of a joint's rows with another joint moving, from which rows compare
_LINKS, _DRIVES = 0.3, 0.5  # relative uncertainty of given links, and spread of an arm's drives


def move_together(moves: Mask) -> bool:
    """Whether every joint moves mostly with another one; rows of motion, shape (n, nv)."""
    several = moves.sum(axis=1) > 1
    share = (moves & several[:, None]).sum(axis=0) / np.maximum(moves.sum(axis=0), 1)
    return bool((share >= _TOGETHER).all())


def stage_gains(
    robot: Robot, base: BaseParameters, W: Array, current: Array, moves: Mask
) -> tuple[Array, bool]:
    """Gains k with torque = k · current, shape (nv,) [N·m/A], and whether rows were compared.

    Args:
        robot: The arm with the given masses.
        base: Base parameters of links and effects.
        W: Columns of links and effects, shape (n, nv, p).
        current: Motor currents, shape (n, nv) [A].
        moves: Rows in which a joint moves; only these count, shape (n, nv).
    """
    links = 10 * robot.nv
    if move_together(moves):
        rows = W * moves[:, :, None]
        columns = [c for c in base.columns if c < links]
        given = rows[:, :, :links] @ robot.phi
        return drive_gains(rows[:, :, columns], rows[:, :, links:], current * moves, given), True
    spread = _LINKS * link_coordinates(prior_parameters(robot)) / link_weights(robot.nv, 1.0)
    pairs = [
        _log_gain(W[rows, j, :links], W[rows, j, links:], current[rows, j], robot.phi, spread)
        for j, rows in enumerate(moves.T)
    ]
    return _drawn_together(*np.array(pairs).T), False


def _drawn_together(own: Array, variance: Array) -> Array:
    """Gains of logarithms that scatter around a common one, shape (nv,)."""
    if not np.isfinite(variance).any():
        return np.ones(len(own))
    weight = 1 / (variance + _DRIVES**2)
    common = float(weight @ own / weight.sum())
    return np.asarray(np.exp(common + _DRIVES**2 * weight * (own - common)), float)


def _log_gain(Y: Array, F: Array, current: Array, phi: Array, spread: Array) -> tuple[float, float]:
    """Logarithm of the gain with which the given torque explains a current, and its variance.

    Args:
        Y: Columns of the links, shape (n, 10 nv).
        F: Columns of effects, shape (n, e).
        current: Readings, shape (n,) [A].
        phi: Given standard parameters, shape (10 nv,).
        spread: Square root of their covariance, shape (10 nv, 10 nv).
    """
    F = F[:, np.any(F != 0, axis=0)]
    if len(current) <= F.shape[1] + 1:
        return 0.0, np.inf
    Q = np.linalg.qr(F)[0]
    Y, i = (x - Q @ (Q.T @ x) for x in (Y, current))
    tau = Y @ phi
    size = float(tau @ tau)
    per_torque = float(tau @ i) / max(size, 1e-300)
    if per_torque <= 0:
        return 0.0, np.inf
    residual = i - per_torque * tau
    noise = float(residual @ residual) / (len(i) - F.shape[1] - 1)
    variance = noise * autocorrelation_time(residual) / size / per_torque**2
    unsure = float(np.sum((tau @ Y @ spread) ** 2)) / size**2
    return -float(np.log(per_torque)), variance + unsure
