"""One convex step of the design: a small conic program for Clarabel."""

from dataclasses import dataclass
from typing import Any

import clarabel
import numpy as np
import scipy.sparse as sp

from excitant.design.criterion import information_derivative, smooth_model
from excitant.design.peaks import clearance_rows, torque_rows
from excitant.design.problem import DesignProblem
from excitant.robots.motion import Array

# of a torque violation (as share of the limit) against the log criterion
PENALTY = 50.0


@dataclass(frozen=True)
class StepSettings:
    """What a convex step follows, and how exactly it keeps the limits."""

    lowest: int = 8
    "Eigenvectors of the smallest eigenvalues, whose subspace a matrix inequality follows."
    highest: int = 4
    "The same of the largest eigenvalues."
    near: float = 0.5
    "Share of a kinematic limit from which an extremum is a row of the programme."
    near_torque: float = 0.7
    "The same for torque."
    near_clearance: float = -0.5
    "The same for clearance: 15 cm more than required."
    exchanges: int = 8
    "Times that extrema are added, at most."
    tolerance: float = 3e-5
    "Share of a limit by which an extremum may exceed it when the exchange ends."
    relative_tolerance: float = 0.01
    "The same as a share of the step's length, where that is more: the next step takes it back."


STEP = StepSettings()


@dataclass(frozen=True, eq=False)
class Block:
    """Part of M in a subspace, as a share of its extreme eigenvalue; with derivatives."""

    value: Array  # shape (m, m)
    derivative: Array  # by the unknowns, shape (k, m, m)
    sign: float  # -1 where λmin is followed (bounded from below), 1 with λmax


@dataclass(frozen=True, eq=False)
class LocalModel:
    """Criterion and torque of a design problem around z."""

    z: Array  # where, shape (c − 2, nv)
    blocks: tuple[Block, ...]  # eigenvalue subspaces, for ``condition`` and ``e``
    gradient: Array  # of the smooth criteria, shape (k,)
    hessian: Array  # of the smooth criteria, shape (k, k)
    rows: (
        Array  # use of torque bounds and of clearance by the unknowns, shape (m, k)
    )
    use: Array  # their use at z, shape (m,)


def local_model(problem: DesignProblem, z: Array) -> LocalModel:
    """Linearise information and torque around z."""
    linear = problem.information.linearise(problem.sampled(z))
    M = problem.information.gram(linear.Y)
    k = problem.size
    gradient = np.zeros(k)
    hessian = np.zeros((k, k))
    blocks = []
    if problem.criterion in ("a", "d"):
        dM = information_derivative(linear, problem.sample_bases, np.eye(len(M)))
        gradient, hessian = smooth_model(M, dM, problem.criterion)
    else:
        eigenvalues, V = np.linalg.eigh(M)
        spans = [
            (-1.0, slice(0, STEP.lowest)),
            (1.0, slice(max(len(M) - STEP.highest, 0), None)),
        ]
        for sign, span in spans[: 1 + (problem.criterion == "condition")]:
            scale = eigenvalues[0 if sign < 0 else -1]
            value = np.diag(eigenvalues[span]) / scale
            dM = (
                information_derivative(linear, problem.sample_bases, V[:, span])
                / scale
            )
            blocks.append(Block(value, dM, sign))
    torque = torque_rows(problem, z, STEP.near_torque)
    apart = clearance_rows(problem, z, STEP.near_clearance)
    rows, use = (np.concatenate(parts) for parts in zip(torque, apart, strict=True))
    return LocalModel(z, tuple(blocks), gradient, hessian, rows, use)


def solve_step(
    problem: DesignProblem, model: LocalModel, radius: float
) -> tuple[Array, float] | None:
    """Best step within the trust region, and the decrease of the merit that it promises, or None.

    Extrema that the solution moves beyond their limits are added until none is (an exchange). A
    long step may leave a small share of its length beyond them, which the next one takes back.
    """
    cost, A, right, cones = _programme(problem, model, radius)
    rows, room = _extremum_rows(problem, model.z, model.z, STEP.near)
    for _ in range(STEP.exchanges):
        wide = np.pad(rows, ((0, 0), (0, A.shape[1] - rows.shape[1])))
        all_cones = [*cones, clarabel.NonnegativeConeT(len(rows))]
        solution = _solved(
            cost, np.vstack([A, wide]), np.concatenate([right, room]), all_cones
        )
        if solution is None:
            return None
        dz = solution[: problem.size].reshape(model.z.shape)
        length = float(np.abs(problem.series.rest @ dz / problem.reach).max())
        tolerance = max(STEP.tolerance, STEP.relative_tolerance * length)
        added, added_room = _extremum_rows(
            problem, model.z, model.z + dz, 1 + tolerance
        )
        if not len(added):
            return dz, _predicted_gain(problem, model, solution)
        rows = np.vstack([rows, added])
        room = np.concatenate([room, added_room])
    return None


def _extremum_rows(
    problem: DesignProblem, z: Array, there: Array, share: float
) -> tuple[Array, Array]:
    """Rows a·dz ≤ room around z for the extrema of ``there`` beyond a share of their limit."""
    parts = []
    rooms = []
    for order in range(problem.robot.limits.orders):
        t, joint = problem.kinematic_peaks(there, order, share)
        phi = problem.basis(t, order)
        middle = problem.middle[order, joint]
        bound = problem.bound[order, joint]
        here, then = (
            np.einsum("kd,kd->k", phi, x[:, joint].T) - middle for x in (z, there)
        )
        scale = np.sign(then) / bound
        rows = np.zeros((len(t), *z.shape))
        rows[np.arange(len(t)), :, joint] = phi * scale[:, None]
        parts.append(rows.reshape(len(t), problem.size))
        rooms.append(1 - here * scale)
    return np.vstack(parts), np.concatenate(rooms)


def _programme(
    problem: DesignProblem, model: LocalModel, radius: float
) -> tuple[tuple[sp.csc_matrix, Array], Array, Array, list[Any]]:
    """(P, c), A, b, cones of min ½vᵀPv + cᵀv; v is dz, a bound per block and the torque excess."""
    k = problem.size
    nb = len(model.blocks)
    m = len(model.use)
    n = k + nb + 1
    box = np.kron(
        problem.series.rest, np.eye(problem.robot.nv)
    ) / problem.reach.reshape(-1, 1)
    linear = np.zeros((2 * len(box) + m + 1, n))
    linear[: 2 * len(box), :k] = np.vstack([box, -box])
    linear[2 * len(box) : -1, :k] = model.rows
    linear[2 * len(box) :, -1] = -1.0
    right = [np.full(2 * len(box), radius), 1 - model.use, np.zeros(1)]
    parts = [linear]
    cones = [clarabel.NonnegativeConeT(len(linear))]
    for i, block in enumerate(model.blocks):
        A, b = _lmi(block, k, i, n)
        parts.append(A)
        right.append(b)
        cones.append(clarabel.PSDTriangleConeT(len(block.value)))
    P = np.zeros((n, n))
    P[:k, :k] = np.triu(model.hessian)
    c = np.concatenate(
        [model.gradient, [block.sign for block in model.blocks], [PENALTY]]
    )
    return (sp.csc_matrix(P), c), np.vstack(parts), np.concatenate(right), cones


def _lmi(block: Block, k: int, i: int, n: int) -> tuple[Array, Array]:
    """Rows of value + Σ derivative dz ⪰ s I (lowest) or ⪯ t I, as a scaled triangle."""
    column, row = np.tril_indices(len(block.value))
    weight = np.where(row == column, 1.0, np.sqrt(2.0))
    A = np.zeros((len(row), n))
    A[:, :k] = block.sign * (block.derivative[:, row, column] * weight).T
    A[:, k + i] = -block.sign * (row == column)
    return A, -block.sign * block.value[row, column] * weight


def _solved(
    cost: tuple[sp.csc_matrix, Array], A: Array, right: Array, cones: list[Any]
) -> Array | None:
    sparse = sp.csc_matrix(A)
    # refinement costs a fifth of the time and is rarely needed
    for refined in (
        False,
        True,
    ):
        settings = clarabel.DefaultSettings()
        settings.iterative_refinement_enable = refined
        settings.verbose = False
        settings.max_iter = 60
        # others start threads beside other searches
        settings.direct_solve_method = "qdldl"
        settings.tol_gap_abs = settings.tol_gap_rel = 1e-6
        settings.tol_feas = 1e-7
        solution = clarabel.DefaultSolver(
            *cost, sparse, right, cones, settings
        ).solve()
        if str(solution.status) in ("Solved", "AlmostSolved"):
            return np.array(solution.x)
    return None


def _predicted_gain(
    problem: DesignProblem, model: LocalModel, solution: Array
) -> float:
    k = problem.size
    dz = solution[:k]
    change = model.gradient @ dz + 0.5 * dz @ model.hessian @ dz
    for block, bound in zip(model.blocks, solution[k:-1], strict=True):
        change += block.sign * np.log(max(float(bound), 1e-3))
    before = max(0.0, float(model.use.max(initial=0.0)) - 1.0)
    return float(PENALTY * (before - solution[-1]) - change)
