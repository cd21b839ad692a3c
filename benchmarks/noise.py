"""What a motion's excitation is worth: errors of base parameters at a given torque noise.

Shares no code with excitant: torques by Pinocchio's recursive Newton-Euler algorithm, the fit by
weighted least squares on Pinocchio's regressor.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from judge import Array, States, left_columns, observation, random_states, torques

DRAWS = 200


@dataclass(frozen=True)
class ParameterError:
    """Errors of the base parameters (chosen from left to right), over all draws of the noise.

    Attributes:
        scaled: Root mean square over draws and parameters of δβᵢ cᵢ [N·m], where cᵢ is the rms
            of regressor column i over random states within the limits: the torque that the
            error of one parameter makes there.
        predicted: Root mean square of the torque error Y δβ of one joint over draws and the
            same random states [N·m]; does not depend on the choice of base parameters.
        worst: Standard deviation of the worst determined combination of unit length [SI].
        misfit: Largest difference of the noise-free torque to W β, over the largest torque;
            how far the fitted model is from the one that made the torque.
    """

    scaled: float
    predicted: float
    worst: float
    misfit: float


def parameter_error(
    model: Any, limits: dict[str, Any], states: States, sigma: Array, seed: int = 0
) -> ParameterError:
    """Fit noisy torques of a motion ``DRAWS`` times.

    Args:
        model: The true arm.
        limits: Limits within which the random states lie.
        states: The motion, known exactly.
        sigma: Standard deviation of the torque noise per joint, shape (nv,) [N·m]; rows are
            weighted by its inverse.
        seed: Seed of the noise; every motion of the same length meets the same noise.
    """
    reference = random_states(limits, np.random.default_rng(0))
    Y = observation(model, reference)
    columns = left_columns(Y)
    Y = Y[:, columns]
    beta = np.linalg.lstsq(Y, torques(model, reference).ravel())[0]
    W, tau = observation(model, states)[:, columns], torques(model, states)
    rng = np.random.default_rng(seed)
    noisy = tau + sigma * rng.standard_normal((DRAWS, *tau.shape))
    weight = np.tile(1 / sigma, len(tau))
    inverse = np.linalg.pinv(weight[:, None] * W)
    errors = (weight * noisy.reshape(DRAWS, -1)) @ inverse.T - beta
    scale = np.sqrt(np.mean(Y**2, axis=0) * states.q.shape[1])
    return ParameterError(
        scaled=_rms(errors * scale),
        predicted=_rms(errors @ Y.T),
        worst=float(np.linalg.norm(inverse, 2)),
        misfit=float(np.abs(W @ beta - tau.ravel()).max() / np.abs(tau).max()),
    )


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
