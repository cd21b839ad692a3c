"""Plain gradient descent on log κ: what L-BFGS from many starts reaches, with exact gradients.

Contestant of the benchmark; uses NumPy, SciPy and Pinocchio, nothing of excitant's design.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np
import pinocchio as pin
import scipy.linalg
import scipy.optimize
from judge import Array, States, left_columns, observation, random_states

_PER_HARMONIC = 16  # samples
_WEIGHTS = (1.0, 10.0, 100.0, 1000.0)  # of the penalty, one descent after the other
_ITERATIONS = 150  # per descent


@dataclass(frozen=True, eq=False)
class Descent:
    """log κ and penalties as functions of the coefficients at rest.

    Attributes:
        model: The arm.
        limits: Limits on position, velocity, torque and perhaps acceleration.
        harmonics: Number of harmonics.
        duration: Period [s].
    """

    model: Any
    limits: dict[str, Any]
    harmonics: int
    duration: float

    @cached_property
    def columns(self) -> Array:
        """Selection of the base columns, chosen from left to right, shape (10 nv, p)."""
        reference = random_states(self.limits, np.random.default_rng(0))
        columns = left_columns(observation(self.model, reference))
        return np.eye(10 * self.model.nv)[:, columns]

    @cached_property
    def phi(self) -> Array:
        """Standard parameters of the arm, shape (10 nv,)."""
        bodies = list(self.model.inertias)[1:]
        return np.concatenate([body.toDynamicParameters() for body in bodies])

    @cached_property
    def rest(self) -> Array:
        """Coefficients with q̇ = q̈ = 0 at both ends: offset, cosine, sine; (1 + 2 H, 2 H − 1)."""
        h, zero = np.arange(1.0, self.harmonics + 1), np.zeros(self.harmonics)
        return scipy.linalg.null_space(np.array([[0.0, *zero, *h], [0.0, *(h**2), *zero]]))

    @cached_property
    def basis(self) -> Array:
        """Coefficients at rest to position, velocity, acceleration; shape (3, n, 2 H − 1)."""
        n, w = _PER_HARMONIC * self.harmonics, 2 * np.pi / self.duration
        h = np.arange(1, self.harmonics + 1)
        turn = np.exp(1j * h * np.linspace(0, 2 * np.pi, n, endpoint=False)[:, None])
        series = [(1j * h * w) ** order * turn for order in range(3)]
        constant = [np.full((n, 1), float(order == 0)) for order in range(3)]
        full = [np.hstack([c, s.real, s.imag]) for c, s in zip(constant, series, strict=True)]
        return np.array(full) @ self.rest

    @cached_property
    def bounds(self) -> tuple[Array, Array]:
        """Middle and half width of q, q̇ and q̈, each (3, 1, nv); infinite without a limit."""
        low, high = np.asarray(self.limits["position"], float).T
        open_end = np.full(len(low), np.inf)
        half = [
            (high - low) / 2,
            self.limits["velocity"],
            self.limits.get("acceleration", open_end),
        ]
        middle = np.zeros((3, 1, len(low)))
        middle[0, 0] = (low + high) / 2
        return middle, np.array(half, float)[:, None]

    def condition(self, coefficients: Array) -> float:
        """Condition number of coefficients at rest, shape (1 + 2 H, nv), at the samples."""
        x = self.basis @ (self.rest.T @ coefficients)
        return float(np.linalg.cond(observation(self.model, States(*x)) @ self.columns))

    def value(self, z: Array, weight: float) -> tuple[float, Array]:
        """Value of log κ + weight · penalty, and its exact gradient in the coefficients at rest."""
        nv = self.model.nv
        x = self.basis @ z.reshape(-1, nv)
        W = observation(self.model, States(*x)) @ self.columns
        U, sizes, Vt = np.linalg.svd(W, full_matrices=False)
        total, slope = float(np.log(sizes[0] / sizes[-1])), np.zeros_like(x)
        for k, sign in ((0, 1.0), (-1, -1.0)):
            rows = sign * U[:, k].reshape(-1, nv) / sizes[k]
            slope += self._slope(x, self.columns @ Vt[k], rows)
        penalty, push = self._penalty(x)
        slope += weight * push
        return total + weight * penalty, np.einsum("ons,onj->sj", self.basis, slope).ravel()

    def _penalty(self, x: Array) -> tuple[float, Array]:
        """Sum of squared relative excesses over all limits, and its gradient in the states."""
        middle, half = self.bounds
        excess = np.maximum(np.abs(x - middle) / half - 1, 0)
        push = 2 * excess * np.sign(x - middle) / half
        limit = np.asarray(self.limits["torque"], float)
        data = self.model.createData()
        tau = np.array([pin.rnea(self.model, data, *s).copy() for s in zip(*x, strict=True)])
        over = np.maximum(np.abs(tau) / limit - 1, 0)
        if over.any():
            push += _contracted(self.model, x, 2 * over * np.sign(tau) / limit)
        return float((excess**2).sum() + (over**2).sum()), push

    def _slope(self, x: Array, direction: Array, rows: Array) -> Array:
        """Gradient of Σ rowsᵢᵀ Y(xᵢ) direction in the states.

        Y is linear in the parameters, so this is the torque derivative of an arm whose
        parameters are shifted a little along the direction, less that of the arm itself.
        """
        step = 0.5 * self.phi[::10].min() / max(np.abs(direction[::10]).max(), 1e-12)
        step = min(step, 1.0)
        shifted = self.model.copy()
        parameters = (self.phi + step * direction).reshape(-1, 10)
        for j, values in enumerate(parameters, start=1):
            shifted.inertias[j] = pin.Inertia.FromDynamicParameters(values)
        slope: Array = (_contracted(shifted, x, rows) - _contracted(self.model, x, rows)) / step
        return slope


def _contracted(model: Any, x: Array, rows: Array) -> Array:
    """Gradient of Σ rowsᵢᵀ τ(xᵢ) in position, velocity and acceleration, shape of x."""
    data, slope = model.createData(), np.zeros_like(x)
    for i in np.flatnonzero(rows.any(axis=1)):
        parts = pin.computeRNEADerivatives(model, data, *x[:, i])
        slope[:, i] = [rows[i] @ part for part in parts]
    return slope


def descend(descent: Descent, coefficients: Array, deadline: float) -> Array:
    """Coefficients (1 + 2 H, nv) after L-BFGS with ever heavier penalties, or at the deadline."""

    def stop_late(xk: Array) -> None:
        if time.time() > deadline:
            raise StopIteration

    z = (descent.rest.T @ coefficients).ravel()
    for weight in _WEIGHTS:
        if time.time() > deadline:
            break
        z = scipy.optimize.minimize(
            partial(descent.value, weight=weight),
            z,
            jac=True,
            method="L-BFGS-B",
            callback=stop_late,
            options={"maxiter": _ITERATIONS, "maxcor": 20},
        ).x
    found: Array = descent.rest @ z.reshape(-1, descent.model.nv)
    return found
