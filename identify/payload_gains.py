"""Drive gains [N·m/A] and their scale from recordings with and without a known payload.

Without the payload (a) and with it (b), the torque of joint j is k_j i_j, so that

    [ I_a  −W_a   0    0  ] [k; β; π; s] ≈ 0,
    [ I_b  −W_b  −V   −g  ]

I the diagonal currents, W the columns of the base parameters β of links and effects, V those of
what is not known of the payload and g the torque of what is known: its solution up to a factor is
total least squares over all joints, and the factor follows from s = 1 (Gautier and Briot 2014,
"Global identification of joint drive gains and dynamic parameters of robots"). Only the currents
have errors here, as many in each column as its joint has rows; so the exact columns are eliminated
and k solves the generalised eigenproblem of Van Huffel and Vandewalle (1991). Rows are weighted by
1 / (k_j σ_j), which makes it maximum likelihood.

A gain whose joint's current its own friction and rotor could explain is not shown; it is taken
to be that of the other joints, give or take a half.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.linalg

from excitant.exceptions import BadInput
from excitant.identify.known_payload import KnownPayload
from excitant.identify.least_squares import factorised, with_covariance
from excitant.identify.regression import dense
from excitant.robots.base_parameters import independent_columns
from excitant.robots.motion import Array, freeze

Mask = npt.NDArray[np.bool_]

SPREAD = 0.5  # relative uncertainty of a gain that is taken from other joints
HARDLY = 0.2  # relative uncertainty of the common scale, from which the payload is refused
_ROUNDS = 30
_SETTLED = 1e-8
_DEPENDENT = 1e-7  # part of a unit column that is outside the others
_SHOWN = 4.0  # a current's residual over that of the best combination, from which its gain is shown


@dataclass(frozen=True, eq=False)
class Rows:
    """Recorded currents with what may explain them.

    Attributes:
        base: Columns of the base parameters, shape (n, nv, r).
        last: Columns of a body on the last link, shape (n, nv, 10).
        current: Readings, shape (n, nv) [A].
    """

    base: Array
    last: Array
    current: Array


@dataclass(frozen=True, eq=False)
class DriveGains:
    """Torque per ampere of every joint.

    Attributes:
        gains: Shape (nv,) [N·m/A].
        std: Their standard deviations, the payload's own uncertainty counted, shape (nv,).
        shown: Whether the recordings show each gain, nv of them.
        scale_std: Relative standard deviation of their common scale.
    """

    gains: Array
    std: Array
    shown: tuple[bool, ...]
    scale_std: float

    def __post_init__(self) -> None:
        freeze(self, "gains", "std")

    def sentence(self, joints: Sequence[str]) -> str:
        """What was found, with what the recordings leave open."""
        pairs = ", ".join(f"{k:.4g} ± {s:.2g}" for k, s in zip(self.gains, self.std, strict=True))
        hidden = [joint for joint, seen in zip(joints, self.shown, strict=True) if not seen]
        rest = (
            f"; that of {', '.join(hidden)} is not shown and was taken from the other joints"
            if hidden
            else ""
        )
        return (
            f"torque came as motor current; drive gains ({pairs} N·m/A) follow from the known "
            f"payload, their common scale to ±{100 * self.scale_std:.2g} %{rest}"
        )


def payload_gains(free: Rows, loaded: Rows, payload: KnownPayload) -> DriveGains:
    """Drive gains from currents without and with a known payload.

    Args:
        free: The arm without it.
        loaded: The arm with it, any motion.
        payload: What is known of it.

    Raises:
        BadInput: The payload does not show in the currents, or hardly.
    """
    problem = _problem(free, loaded, payload)
    k, theta, shown = _solved(problem)
    if (k <= 0).any():
        raise BadInput(f"payload: {_hardly(payload)}: the gains found are not positive")
    log_cov = _covariance(problem, k, theta, shown)
    mean = np.where(shown, 1.0, 0.0) / shown.sum()
    scale = float(mean @ log_cov @ mean)
    variance = np.diag(log_cov).copy()
    for other in payload.moved():
        change = np.log(_solved(_problem(free, loaded, other))[0] / k)
        variance += change**2
        scale += float(mean @ change) ** 2
    if np.sqrt(scale) > HARDLY:
        raise BadInput(
            f"payload: {_hardly(payload)}: they fix the common scale of the drive gains to "
            f"±{100 * np.sqrt(scale):.0f} % only"
        )
    seen = tuple(bool(each) for each in shown)
    return DriveGains(k, k * np.sqrt(variance), seen, float(np.sqrt(scale)))


def _hardly(payload: KnownPayload) -> str:
    return (
        f"{payload.mass:g} kg hardly show in these currents; use a heavier payload, say where its "
        "centre of mass is, or move it through more poses and longer"
    )


@dataclass(frozen=True, eq=False)
class _Homogeneous:
    """Exact columns, the known torque last, and currents of all rows, without and with payload."""

    exact: Array  # (n, nv, e)
    current: Array  # (n, nv)


def _problem(free: Rows, loaded: Rows, payload: KnownPayload) -> _Homogeneous:
    unknown, known = loaded.last[:, :, payload.open_parameters], loaded.last @ payload.known
    added = np.concatenate([unknown, known[:, :, None]], axis=2)
    blank = np.zeros((*free.current.shape, added.shape[2]))
    exact = np.concatenate(
        [
            np.concatenate([free.base, blank], axis=2),
            np.concatenate([loaded.base, added], axis=2),
        ]
    )
    return _Homogeneous(
        _without_dependent(exact, free.base.shape[2], payload),
        np.concatenate([free.current, loaded.current]),
    )


def _without_dependent(exact: Array, r: int, payload: KnownPayload) -> Array:
    """Columns without those of the payload that others explain; its known torque must stay."""
    flat = exact.reshape(-1, exact.shape[2])
    norms = np.linalg.norm(flat, axis=0)
    R = np.linalg.qr(flat / np.where(norms > 0, norms, 1.0), mode="r")
    found, _ = independent_columns(np.asarray(R, float), _DEPENDENT)
    if exact.shape[2] - 1 not in found:
        raise BadInput(f"payload: {_hardly(payload)}: no torque of it differs from the arm's own")
    lost = set(range(r)) - set(found)
    if lost:
        raise BadInput(
            "payload: the recordings do not determine all base parameters of the arm; move all "
            "joints in the recordings without payload"
        )
    return exact[:, :, list(found)]


def _solved(problem: _Homogeneous) -> tuple[Array, Array, Mask]:
    """Gains, shape (nv,), coefficients of the exact columns, the known one 1, and what is shown."""
    n, nv = problem.current.shape
    triangles = [
        np.asarray(np.linalg.qr(np.column_stack([X, i]), mode="r"), float)
        for X, i in zip(problem.exact.transpose(1, 0, 2), problem.current.T, strict=True)
    ]
    k, sigma = np.ones(nv), np.maximum(problem.current.std(axis=0), 1e-12)
    shown = np.ones(nv, bool)
    for _ in range(_ROUNDS):
        weight = 1 / (k * sigma)
        found, theta, shown = _eliminated(triangles, weight, n * (weight * sigma) ** 2)
        rest = [
            np.linalg.norm(found[j] * T[:, -1] - T[:, :-1] @ theta) for j, T in enumerate(triangles)
        ]
        ahead = np.maximum(np.array(rest) / np.sqrt(n) / np.abs(found), 1e-12)
        change = np.abs(found / k / np.mean(found / k) - 1).max() + np.abs(ahead / sigma - 1).max()
        k, sigma = np.abs(found), ahead
        if change < _SETTLED:
            break
    return found / theta[-1], theta / theta[-1], shown


def _eliminated(
    triangles: Sequence[Array], weight: Array, noise: Array
) -> tuple[Array, Array, Mask]:
    """Solution of the weighted homogeneous system, of norm one, and which gains it shows.

    Args:
        triangles: Factors of each joint's exact columns and its current.
        weight: Of each joint's rows, shape (nv,).
        noise: Expected squares of the weighted errors of each current column, shape (nv,).
    """
    X = np.vstack([w * T[:, :-1] for w, T in zip(weight, triangles, strict=True)])
    norms = np.linalg.norm(X, axis=0)
    currents = scipy.linalg.block_diag(
        *(w * T[:, -1:] for w, T in zip(weight, triangles, strict=True))
    )
    Q, R = np.linalg.qr(X / norms)
    left = currents - Q @ (Q.T @ currents)
    scaled = left / np.sqrt(noise)
    shown = _shown(scaled)
    tie = np.eye(len(weight))[:, shown]
    tie[~shown] = 1 / shown.sum()
    _, _, Vt = np.linalg.svd(left @ tie / np.sqrt(noise[shown]))
    k = tie @ (Vt[-1] / np.sqrt(noise[shown]))
    theta = scipy.linalg.solve_triangular(R, Q.T @ (currents @ k)) / norms
    sign = 1.0 if k.sum() >= 0 else -1.0
    return sign * k, sign * np.asarray(theta, float), shown


def _shown(scaled: Array) -> Mask:
    """Gains whose current alone leaves more than noise once exact columns explain what they can."""
    alone = (scaled**2).sum(axis=0)
    best = float(np.linalg.svd(scaled, compute_uv=False)[-1] ** 2)
    shown = alone > _SHOWN * max(best, 1e-300)
    return shown if shown.any() else np.ones(len(alone), bool)


def _covariance(problem: _Homogeneous, k: Array, theta: Array, shown: Mask) -> Array:
    """Covariance of the logarithms of the gains, to first order in coloured noise, (nv, nv)."""
    torque = problem.exact @ theta
    per_gain = np.zeros((*torque.shape, len(k)))
    for j in range(len(k)):
        per_gain[:, j, j] = -torque[:, j] / k[j]
    columns = np.concatenate([per_gain[:, :, shown], problem.exact[:, :, :-1] / k[:, None]], axis=2)
    residual = problem.current - torque / k
    sigma = np.maximum(residual.std(axis=0), 1e-12)
    names = tuple(f"column {c}" for c in range(columns.shape[2]))
    factor = factorised(dense(columns, residual, names), sigma)
    fit = with_covariance(factor, np.zeros(columns.shape[2]), residual, sigma)
    covariance = SPREAD**2 * np.eye(len(k))
    count = int(shown.sum())
    covariance[np.ix_(shown, shown)] = fit.covariance[:count, :count]
    return covariance
