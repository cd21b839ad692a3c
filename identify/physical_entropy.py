"""The physically consistent fit with an entropic prior: log-determinants in place of squares.

The Bregman divergence of −log det, D(P ‖ P̄) = tr(P̄⁻¹ P) − log det(P̄⁻¹ P) − 4, is the relative
entropy of two densities and keeps every body possible by itself (Lee and Park 2018; Lee, Wensing,
Park 2020). To second order around Q = X Xᵀ it is ½‖X⁻¹ (Q' − Q) X⁻ᵀ‖² beside its slope, the
pull-back metric at the present body. A conic solver gives the minimiser to its tolerance; Newton
steps, each a quadratic fit with the same restrictions, make it exact to rounding.
"""

from __future__ import annotations

from dataclasses import replace

import cvxpy as cp
import numpy as np
import scipy.linalg

from excitant.identify.physical_coordinates import (
    UPPER,
    congruence,
    matrices,
    svec_weights,
    symmetric,
)
from excitant.identify.physical_program import Program, Solution, solve, solve_tightly
from excitant.robots.motion import Array

_STEPS = 20
_CLOSE = 1e-8  # squared Newton decrement, from which one more full step is exact to rounding
_ROUNDING = 1e-13  # of the objective
_ENOUGH = 1e-3  # of the decrease that the slope promises
_SHORTEST = 1e-6  # share of a step


def local(program: Program, y: Array) -> Program:
    """The programme with its log-determinants to second order around y.

    Raises:
        numpy.linalg.LinAlgError: y holds a matrix that is not positive.
    """
    if program.entropy is None:
        return program
    blocks, targets = [], []
    for w, Q in zip(program.entropy, matrices(y, program.links), strict=True):
        X = np.linalg.cholesky(Q)
        blocks.append(np.sqrt(w / 2) * congruence(np.linalg.inv(X)))
        targets.append(np.sqrt(w / 2) * svec_weights() * (2 * np.eye(4) - X.T @ X)[UPPER])
    rows = np.zeros((10 * program.links, len(y)))
    rows[:, : len(rows)] = scipy.linalg.block_diag(*blocks)
    return replace(
        program,
        C=np.vstack([program.C, rows]),
        d=np.concatenate([program.d, *targets]),
        entropy=None,
    )


def solve_entropic(program: Program, centre: Array) -> Solution:
    """Minimiser and multipliers of a programme with log-determinants.

    Args:
        program: What to solve.
        centre: The prior, shape (p,), where all Q_k = 1.

    Raises:
        Infeasible: Restrictions without a common point, or the solver did not converge.
    """
    y = _conic(program, centre)
    for _ in range(_STEPS):
        found = solve(local(program, y), y, definite=False)
        step = found.y - y
        decrease, value = -float(program.gradient(y) @ step), program.value(y)
        if decrease <= max(_CLOSE * _smallest(program), _ROUNDING * abs(value)):
            return found
        share = 1.0
        while program.value(y + share * step) > value - _ENOUGH * share * decrease:
            share /= 2
            if share < _SHORTEST:
                return Solution(y, found.matrices, found.others)
        y = y + share * step
    return Solution(y, found.matrices, found.others)


def _smallest(program: Program) -> float:
    return 0.0 if program.entropy is None else float(program.entropy.min())


def _conic(program: Program, centre: Array) -> Array:
    """Minimiser to the tolerance of the conic solver, shape (p,).

    Solved in the coordinates U (y − centre), U a QR factor of data and prior to second order.
    """
    near, p = local(program, centre), len(centre)
    U = np.asarray(np.linalg.qr(np.vstack([near.A, near.C]), mode="r"), float)
    data = np.column_stack([np.vstack([program.A, program.C]), np.r_[program.z, program.d]])
    factor = np.asarray(np.linalg.qr(data, mode="r"), float)
    step = scipy.linalg.solve_triangular(U, np.eye(p))
    v = cp.Variable(p)
    misfit = (factor[:, :-1] @ step) @ v + (factor[:, :-1] @ centre - factor[:, -1])
    objective = cp.sum_squares(misfit)
    weights = np.zeros(program.links) if program.entropy is None else program.entropy
    for k, w in enumerate(weights):
        M = symmetric(10 * k, p)
        Q = cp.reshape((M @ step) @ v + M @ centre, (4, 4), order="C")
        objective += w * (cp.trace(Q) - cp.log_det(Q))
    restrictions = [
        r.condition((r.G @ step) @ v + (r.G @ centre - r.h)) for r in program.restrictions
    ]
    solve_tightly(cp.Problem(cp.Minimize(objective), restrictions))
    return np.asarray(centre + step @ np.asarray(v.value, float), float)
