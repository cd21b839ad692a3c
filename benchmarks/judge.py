"""Neutral judge of a motion: NumPy and Pinocchio only, nothing of excitant; see README.md."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pinocchio as pin

Array = npt.NDArray[np.float64]

_STATES = 600
_INDEPENDENT = 1e-8  # of a column's own length
DRAWS = 200  # of the noise


@dataclass(frozen=True, eq=False)
class States:
    """Positions, velocities and accelerations, each of shape (n, nv); SI units."""

    q: Array
    dq: Array
    ddq: Array


def read_motion(path: Path) -> States:
    """States of a table ``t,q1..,dq1..,ddq1..``."""
    table = np.loadtxt(path, delimiter=",", skiprows=1)
    return States(*np.split(table[:, 1:], 3, axis=1))


def random_states(limits: dict[str, Any], rng: np.random.Generator, n: int = _STATES) -> States:
    """States drawn uniformly within the limits; accelerations within 10 rad/s² without one."""
    low, high = np.asarray(limits["position"], float).T
    speed = np.asarray(limits["velocity"], float)
    acceleration = np.asarray(limits.get("acceleration", np.full(len(speed), 10.0)), float)
    shape = (n, len(speed))
    return States(
        rng.uniform(low, high, shape),
        rng.uniform(-speed, speed, shape),
        rng.uniform(-acceleration, acceleration, shape),
    )


def observation(model: Any, states: States) -> Array:
    """Stacked joint torque regressor W, shape (n nv, 10 nv)."""
    return np.vstack(each(pin.computeJointTorqueRegressor, model, states))


def each(compute: Any, model: Any, states: States) -> list[Array]:
    data = model.createData()
    rows = zip(states.q, states.dq, states.ddq, strict=True)
    return [compute(model, data, *state).copy() for state in rows]


def left_columns(W: Array) -> npt.NDArray[np.intp]:
    """Columns that are no combination of those to their left, by Gram-Schmidt, twice."""
    lengths = np.linalg.norm(W, axis=0)
    chosen, Q = [], np.zeros((len(W), 0))
    for k in np.flatnonzero(lengths > _INDEPENDENT * lengths.max()):
        rest = W[:, k] / lengths[k]
        for _ in range(2):
            rest = rest - Q @ (Q.T @ rest)
        length = np.linalg.norm(rest)
        if length > _INDEPENDENT:
            chosen.append(k)
            Q = np.column_stack([Q, rest / length])
    return np.array(chosen)


def conditioning(model: Any, limits: dict[str, Any], states: States) -> dict[str, Any]:
    """Condition numbers of a motion, and the number of base parameters."""
    reference = observation(model, random_states(limits, np.random.default_rng(0)))
    W, columns = observation(model, states), left_columns(reference)
    _, sizes, Vt = np.linalg.svd(reference, full_matrices=False)
    row_space = Vt[sizes > _INDEPENDENT * sizes[0]].T
    left, proj = (float(np.linalg.cond(x)) for x in (W[:, columns], W @ row_space))
    return {"left": left, "proj": proj, "base": len(columns)}


@dataclass(frozen=True)
class ParameterError:
    """Errors of the base parameters (chosen from left to right), over all draws of the noise."""

    scaled: float  # rms of δβᵢ cᵢ [N·m], cᵢ the rms of regressor column i over random states
    predicted: float  # rms of the torque error Y δβ of a joint on the same states [N·m]
    worst: float  # standard deviation of the worst determined combination of unit length [SI]
    misfit: float  # largest difference of noise-free torque to W β, over the largest torque


def parameter_error(
    model: Any, limits: dict[str, Any], states: States, sigma: Array
) -> ParameterError:
    """Fit noisy torques of a motion, known exactly, ``DRAWS`` times, rows weighted by 1 / σ.

    σ is the standard deviation of the torque noise per joint, shape (nv,) [N·m]. The random states
    lie within the limits; every motion of the same length meets the same noise.
    """
    reference = random_states(limits, np.random.default_rng(0))
    Y = observation(model, reference)
    columns = left_columns(Y)
    Y = Y[:, columns]
    beta = np.linalg.lstsq(Y, np.ravel(each(pin.rnea, model, reference)))[0]
    W, tau = observation(model, states)[:, columns], np.array(each(pin.rnea, model, states))
    noisy = tau + sigma * np.random.default_rng(0).standard_normal((DRAWS, *tau.shape))
    weight = np.tile(1 / sigma, len(tau))
    inverse = np.linalg.pinv(weight[:, None] * W)
    errors = (weight * noisy.reshape(DRAWS, -1)) @ inverse.T - beta
    scale = np.sqrt(np.mean(Y**2, axis=0) * states.q.shape[1])
    return ParameterError(
        scaled=float(np.sqrt(np.mean((errors * scale) ** 2))),
        predicted=float(np.sqrt(np.mean((errors @ Y.T) ** 2))),
        worst=float(np.linalg.norm(inverse, 2)),
        misfit=float(np.abs(W @ beta - tau.ravel()).max() / np.abs(tau).max()),
    )
