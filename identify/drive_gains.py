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
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pinocchio as pin
import scipy

from excitant.exceptions import BadInput
from excitant.identify.accuracy import series
from excitant.identify.least_squares import factorised, with_covariance
from excitant.identify.preprocessing import Segment
from excitant.identify.recording import Recording
from excitant.identify.regression import dense, observation
from excitant.identify.rows import split
from excitant.robots.base_parameters import base_parameters, independent_columns
from excitant.robots.effects import Effect, standard_effects
from excitant.robots.motion import Array, freeze
from excitant.robots.robot import Robot

Mask = npt.NDArray[np.bool_]

_SPREAD = 0.5  # relative uncertainty of a gain that is taken from other joints
_HARDLY = 0.2  # relative uncertainty of the common scale, from which the payload is refused
_ROUNDS = 30
_SETTLED = 1e-8
_DEPENDENT = 1e-7  # part of a unit column that is outside the others
_SHOWN = 4.0  # a current's residual over that of the best combination, from which its gain is shown


@dataclass(frozen=True)
class KnownPayload:
    """A body on the last link, as weighed and measured.

    Attributes:
        mass: Its mass [kg].
        mass_std: Standard deviation of the mass [kg].
        centre: Its centre of mass in the frame of the last joint [m]; None where not known.
    """

    mass: float
    mass_std: float = 0.0
    centre: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        if not self.mass > 0 or self.mass_std < 0:
            raise BadInput(
                f"payload: {self.mass:g} ± {self.mass_std:g} kg; give a mass above 0 kg and "
                "a standard deviation that is not negative"
            )

    @property
    def known(self) -> Array:
        """The standard parameters that are known, zero elsewhere, shape (10,)."""
        if self.centre is None:
            return np.asarray(self.mass * np.eye(10)[0])
        point = pin.Inertia(self.mass, np.array(self.centre), np.zeros((3, 3)))
        return np.asarray(point.toDynamicParameters(), float)

    @property
    def open_parameters(self) -> slice:
        """Standard parameters that are not known."""
        return slice(1, 10) if self.centre is None else slice(4, 10)


@dataclass(frozen=True, eq=False)
class CurrentRows:
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
        rest = f"; that of {', '.join(hidden)} is not shown and was taken from the other joints"
        return (
            f"torque came as motor current; drive gains ({pairs} N·m/A) follow from the known "
            f"payload, their common scale to ±{100 * self.scale_std:.2g} %{rest if hidden else ''}"
        )

    def torque(self, recordings: Sequence[Recording]) -> list[Recording]:
        """Recordings of currents as recordings of torque."""
        return [replace(r, tau=r.tau * self.gains, unit="N·m") for r in recordings]

    def result(self) -> dict[str, Any]:
        """Entries of result.json."""
        return {
            "drive_gain_Nm_per_A": self.gains.tolist(),
            "drive_gain_std_Nm_per_A": self.std.tolist(),
            "drive_gain_shown": list(self.shown),
            "drive_gain_scale_rel_std": self.scale_std,
        }


def identify_drive_gains(
    robot: Robot,
    recordings: Sequence[Recording],
    loaded: Sequence[Recording],
    payload: KnownPayload,
    *,
    validate: Sequence[Recording] = (),
    effects: Sequence[Effect] | None = None,
    cutoff_hz: float | None = None,
) -> DriveGains:
    """Drive gains of an arm whose motor currents were recorded.

    Args:
        robot: The arm without the payload; its masses are of no account.
        recordings: Currents without the payload; what `identify` fits of them is used.
        loaded: Currents with the payload.
        payload: What is known of it.
        validate: As given to `identify`.
        effects: Effects of the arm; friction, offset and rotor inertia when None.
        cutoff_hz: Cut-off of the filter [Hz].

    Raises:
        BadInput: Recordings that are no currents, or a payload that hardly shows in them.
        BadRecording: Recordings that cannot be used.
    """
    for recording in (*recordings, *loaded):
        if recording.unit != "A":
            raise BadInput(
                f"payload: {recording.file} holds torque in {recording.unit}, for which no drive "
                "gain is needed; --payload-recording is for motor currents"
            )
    effects = standard_effects(robot.joints) if effects is None else tuple(effects)
    chosen, last = list(base_parameters(robot, effects).columns), 10 * (robot.nv - 1)

    def rows(segments: Sequence[Segment]) -> CurrentRows:
        W = observation(robot, effects, segments)
        return CurrentRows(W[:, :, chosen], W[:, :, last : last + 10], series(segments).measured)

    data = split(recordings, validate, cutoff_hz)
    return payload_gains(
        rows(data.train), rows(split(loaded, loaded, data.cutoff_hz).train), payload
    )


def payload_gains(free: CurrentRows, loaded: CurrentRows, payload: KnownPayload) -> DriveGains:
    """Drive gains from currents without and with a known payload.

    Args:
        free: The arm without it.
        loaded: The arm with it, any motion.
        payload: What is known of it.

    Raises:
        BadInput: The payload does not show in the currents, or hardly.
    """
    hardly = (
        f"payload: {payload.mass:g} kg hardly show in these currents; use a heavier payload, say "
        "where its centre of mass is, or move it through more poses and longer"
    )
    current = np.concatenate([free.current, loaded.current])
    exact = _exact_columns(free, loaded, payload, hardly)
    k, theta, shown = _solved(exact, current)
    if (k <= 0).any():
        raise BadInput(f"{hardly}: the gains found are not positive")
    log_cov = _covariance(exact, current, k, theta, shown)
    mean = shown / shown.sum()
    # all that is known of the payload, and with it every gain, grows in proportion to its mass
    weighed = np.log1p(payload.mass_std / payload.mass) ** 2
    scale = float(np.sqrt(mean @ log_cov @ mean + weighed))
    if scale > _HARDLY:
        raise BadInput(
            f"{hardly}: they fix the common scale of the drive gains to ±{100 * scale:.0f} % only"
        )
    std = k * np.sqrt(np.diag(log_cov) + weighed)
    return DriveGains(k, std, tuple(bool(each) for each in shown), scale)


def _exact_columns(
    free: CurrentRows, loaded: CurrentRows, payload: KnownPayload, hardly: str
) -> Array:
    """Columns without errors of all rows, the payload's known torque last, shape (n, nv, e).

    Columns of the payload that others explain are left out.
    """
    unknown, known = loaded.last[:, :, payload.open_parameters], loaded.last @ payload.known
    added = np.concatenate([unknown, known[:, :, None]], axis=2)
    blank = np.zeros((*free.current.shape, added.shape[2]))
    rows = ((free.base, blank), (loaded.base, added))
    exact = np.concatenate([np.concatenate(pair, axis=2) for pair in rows])
    flat = exact.reshape(-1, exact.shape[2])
    norms = np.linalg.norm(flat, axis=0)
    R = np.linalg.qr(flat / np.where(norms > 0, norms, 1.0), mode="r")
    found, _ = independent_columns(np.asarray(R, float), _DEPENDENT)
    if exact.shape[2] - 1 not in found:
        raise BadInput(f"{hardly}: no torque of it differs from the arm's own")
    if not set(range(free.base.shape[2])) <= set(found):
        raise BadInput(
            "payload: the recordings do not determine all base parameters of the arm; move all "
            "joints in the recordings without payload"
        )
    return exact[:, :, list(found)]


def _solved(exact: Array, current: Array) -> tuple[Array, Array, Mask]:
    """Gains, shape (nv,), coefficients of the exact columns, the known one 1, and what is shown."""
    n, nv = current.shape
    triangles = [
        np.asarray(np.linalg.qr(np.column_stack([X, i]), mode="r"), float)
        for X, i in zip(exact.transpose(1, 0, 2), current.T, strict=True)
    ]
    k, sigma = np.ones(nv), np.maximum(current.std(axis=0), 1e-12)
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
    # a gain is shown whose current alone leaves more than noise beside the exact columns
    scaled = left / np.sqrt(noise)
    alone = (scaled**2).sum(axis=0)
    best = float(np.linalg.svd(scaled, compute_uv=False)[-1] ** 2)
    shown = alone > _SHOWN * max(best, 1e-300)
    if not shown.any():
        shown[:] = True
    tie = np.eye(len(weight))[:, shown]
    tie[~shown] = 1 / shown.sum()
    _, _, Vt = np.linalg.svd(left @ tie / np.sqrt(noise[shown]))
    k = tie @ (Vt[-1] / np.sqrt(noise[shown]))
    theta = scipy.linalg.solve_triangular(R, Q.T @ (currents @ k)) / norms
    sign = 1.0 if k.sum() >= 0 else -1.0
    return sign * k, sign * np.asarray(theta, float), shown


def _covariance(exact: Array, current: Array, k: Array, theta: Array, shown: Mask) -> Array:
    """Covariance of the logarithms of the gains, to first order in coloured noise, (nv, nv)."""
    torque = exact @ theta
    per_gain = np.einsum("nj,jk->njk", -torque / k, np.eye(len(k)))
    columns = np.concatenate([per_gain[:, :, shown], exact[:, :, :-1] / k[:, None]], axis=2)
    residual = current - torque / k
    sigma = np.maximum(residual.std(axis=0), 1e-12)
    names = tuple(f"column {c}" for c in range(columns.shape[2]))
    factor = factorised(dense(columns, residual, names), sigma)
    fit = with_covariance(factor, np.zeros(columns.shape[2]), residual, sigma)
    covariance = _SPREAD**2 * np.eye(len(k))
    count = int(shown.sum())
    covariance[np.ix_(shown, shown)] = fit.covariance[:count, :count]
    return covariance
