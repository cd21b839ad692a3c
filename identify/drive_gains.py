"""Drive gains [N·m/A] of motor currents: from the given masses, or from a known payload.

Masses: with one gain k_j = exp(κ_j) per joint, and what its own effects explain taken off, the
current of joint j is

    i_j = exp(−κ_j) (g_j + A_j y) + ε_j,   y ~ N(0, 1),

g_j the torque of the given bodies and A_j y that of their errors: half of the variance σ_k² of body
k is that of its coordinates (`excitant.identify.prior`), half that of the whole body. Currents show
bodies that are off by more than `BODY_STD`: σ_k² = Σ y² / Σ (1 − posterior variance) over a body's
errors (MacKay 1992). The errors y are eliminated (variable projection: Golub and Pereyra 1973;
Kaufman 1975). Parameters of outer links appear in the rows of several joints, so the gains
*relative to each other* follow from the currents: they minimise the reduced misfit, and scatter by
`GAIN_STD` where that is flat. Their common scale follows from the given masses alone, by
generalised least squares over all joints,

    Σ_j (e^{−κ_j} g_j)ᵀ V⁻¹ (i_j − e^{−κ_j} g_j) = 0,

V the covariance of bodies and noise together. (The minimum would shrink the scale, for larger
bodies have larger errors to explain; the equation is free of that bias.) Gauss and Newton's method
solves both together, and its matrix gives the covariance, the noise of a row being widened by its
autocorrelation time.

A gain is *known* whose standard deviation the currents have halved, from that by which gains
scatter anyway, and where the largest current makes no torque far beyond the limit of the joint.

Payload: in recordings without it and with it, base parameters and what is not known of the payload
take the place of the errors y, of which nothing is known, and g is the torque of what is known of
the payload. The scale then follows from the payload alone (Gautier and Briot 2014, "Global
identification of joint drive gains and dynamic parameters of robots").
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin
import scipy

from excitant.exceptions import BadInput
from excitant.identify.least_squares import (
    autocorrelation_time,
    believed,
)
from excitant.identify.prior import (
    largest_uncertainty,
    link_coordinates,
    link_weights,
    prior_parameters,
)
from excitant.identify.recording import Recording
from excitant.identify.regression import Regression, triangle
from excitant.identify.signals import live
from excitant.robots.motion import Array, Indices, Mask, Noun, root_mean_square
from excitant.robots.robot import Robot

GAIN_STD = 0.5  # relative, of drives of one arm: decides only what data leave open
LARGEST_STD = GAIN_STD / 2  # relative, of a known gain: data have halved it
SCALE_STD = 10.0  # of the logarithm of the common gain: nothing is known of it
OVERLOAD = (
    3.0  # largest torque of a drive over its limit: strain wave gears bear as much
)
NOISE_ROUNDS = 10  # of re-estimating noise and errors of bodies
MOST_STEPS = 100  # of Gauss and Newton's method in a round
LONGEST_STEP = 0.5  # of the logarithm of a gain
CONVERGED = 1e-7  # step that ends them
BODY_STD = 0.3  # relative std assumed for given bodies, at least
PLACEHOLDER_STD = 3.0  # the same where all links weigh the same
LARGEST_SCALE_STD = 0.2  # of the common scale, above which a payload is refused
OPEN_STD = 1e6  # rms torque [N·m] of a base parameter of which nothing is known
_IN_AMPERES = (
    ("(N·m)", "A"),
    ("N·m", "A"),
    ("kg·m²", "A·s²/rad"),
    ("kg", "A·s²/m"),
    ("N", "A"),
)


@dataclass(frozen=True, eq=False)
class DriveGains(Noun):
    """Torque per ampere of every joint, from the given masses or from a known payload.

    Attributes:
        gains: Shape (nv,) [N·m/A].
        covariance: Of their logarithms, shape (nv, nv).
        possible: Gains with which the largest currents make what the joints can bear, (nv,).
        payload: Whether they follow from a known payload.
    """

    gains: Array
    covariance: Array
    possible: Array | float = np.inf
    payload: bool = False

    @property
    def std(self) -> Array:
        """Standard deviations of the gains, shape (nv,) [N·m/A]."""
        return self.gains * np.sqrt(np.diag(self.covariance))

    @property
    def scale_std(self) -> float:
        """Relative standard deviation of their common scale."""
        return float(np.linalg.inv(self.covariance).sum() ** -0.5)

    @property
    def known(self) -> Mask:
        """Whether each gain is determined, and possible, shape (nv,)."""
        certain = np.diag(self.covariance) <= LARGEST_STD**2
        return certain & (self.gains <= self.possible)

    @property
    def _remedy(self) -> str:
        """What would determine gains."""
        if self.payload:
            return "a payload that loads the joint, off its axis, determines it"
        return "a known payload determines it (--payload-recording)"

    def undetermined(self, joints: Sequence[str]) -> str:
        """Which gains are not known, why, and what would determine them; empty where all are."""
        if self.known.all():
            return ""
        possible = np.broadcast_to(self.possible, self.gains.shape)
        relative = 100 * np.sqrt(np.diag(self.covariance))
        reasons = []
        for j in np.flatnonzero(~self.known).tolist():
            why = f"±{relative[j]:.0f} %"
            if self.gains[j] > possible[j]:
                times = OVERLOAD * self.gains[j] / possible[j]
                why = f"its torque would be {times:.2g} times the joint's limit"
            reasons.append(f"{joints[j]} ({why})")
        common = "; masses and inertias hold up to a common factor"
        return (
            f"torque was recorded as current; not determined: the gain of {', '.join(reasons)}; "
            "friction, offset and rotor inertia there are told in amperes"
            f"{common * (not self.known.any())}; {self._remedy}"
        )

    def sentence(self, joints: Sequence[str]) -> str:
        """The gains, where they come from, and what the recordings leave open."""
        parts = [self.undetermined(joints)]
        rows = zip(joints, self.gains, self.std, self.known, strict=True)
        if pairs := ", ".join(
            f"{j} {k:.4g} ± {s:.2g}" for j, k, s, yes in rows if yes
        ):
            scale = f"±{100 * self.scale_std:.2g} %"
            source = f"follow from the known payload, their common scale to {scale}"
            if not self.payload:
                source = (
                    "follow from what joints have in common and from the given masses, which "
                    f"alone fix their common scale, to {scale}, and with it masses, inertias "
                    "and friction, whose ± contains it"
                )
                source += f"; {self._remedy}" * (not parts[0])
            start = "" if parts[0] else "torque was recorded as current; "
            parts.append(f"{start}drive gains ({pairs} N·m/A) {source}")
        return "; ".join(part for part in parts if part)

    def told(self, unit: str, joint: int) -> tuple[float, str]:
        """Factor and unit in which to tell a coefficient of a joint: in amperes if not `known`."""
        for torque, current in _IN_AMPERES:
            if torque in unit and not self.known[joint]:
                k = float(self.gains[joint])
                return (k if torque.startswith("(") else 1 / k), unit.replace(
                    torque, current
                )
        return 1.0, unit

    def torque(self, recordings: Sequence[Recording]) -> list[Recording]:
        """Recordings of currents as recordings of torque, which rests on these gains."""
        return [
            replace(r, tau=r.tau * self.gains, unit="N·m", drive=self)
            for r in recordings
        ]

    def result(self) -> dict[str, Any]:
        """Entries of result.json; null where a gain is not known."""

        def of_known(values: Array) -> list[float | None]:
            pairs = zip(values.tolist(), self.known, strict=True)
            return [value if known else None for value, known in pairs]

        return {
            "drive_gain_Nm_per_A": of_known(self.gains),
            "drive_gain_std_Nm_per_A": of_known(self.std),
            "drive_gain_scale_rel_std": self.scale_std,
        }


def current_gains(
    robot: Robot, W: Array, current: Array, moves: Mask | None = None
) -> DriveGains:
    """Gains k with torque = k · current, by the given masses.

    W are the columns of links and effects, (n, nv, p); only rows in which a joint moves count,
    (n, nv), all when None.
    """
    nv = robot.nv
    links = 10 * nv
    bodies = prior_parameters(robot)
    # links that all weigh the same are placeholders
    least = BODY_STD if np.ptp(robot.phi[::10]) > 0 else PLACEHOLDER_STD
    coordinates = link_coordinates(bodies) / link_weights(nv, 1.0)
    whole = scipy.linalg.block_diag(*bodies[:, :, None])
    errors = np.hstack([coordinates, whole]) / np.sqrt(2)
    errors = np.column_stack([errors, bodies.ravel()])
    owner = np.append(np.repeat(np.arange(nv), 10), np.arange(nv))
    joints = []
    for j in range(nv):
        rows = slice(None) if moves is None else moves[:, j]
        Y = W[rows, j, :links]
        own = np.column_stack([Y @ errors, current[rows, j]])
        joints.append(without_effects(W[rows, j, links:], own)[0])
    # the last link may carry a tool, which a σ that began small would leave to the gains
    first = np.full(nv, least)
    first[-1] = largest_uncertainty(bodies)[-1]
    log_gains, covariance = _solved(joints, owner, first, least)
    largest = np.abs(current).max(axis=0, initial=0.0)
    limits = np.where(robot.limits.torque > 0, robot.limits.torque, np.inf)
    return DriveGains(
        np.exp(log_gains),
        covariance,
        possible=OVERLOAD * limits / np.maximum(largest, 1e-300),
    )


def _solved(
    joints: Sequence[Array], owner: Indices, first: Array, least: float
) -> tuple[Array, Array]:
    """Logarithms of gains, shape (nv,), and their covariance.

    Args:
        joints: Rows [A_j, g_j, i_j] of each joint, with A_j for errors of one.
        owner: The body, or group, that each error is of.
        first: Standard deviation of the errors of each, to begin with.
        least: Least standard deviation of the errors of each.
    """
    triangles = [triangle(rows) for rows in joints]
    std = first
    noise = believed(np.array([_noise(rows[:, -1]) for rows in joints]))
    log_gains = np.full(len(joints), _common(triangles, noise))
    for _ in range(NOISE_ROUNDS):
        reduced = _Reduced(triangles, noise, std[owner])
        log_gains = reduced.solved(log_gains)
        y, seen = reduced.errors(log_gains)
        coefficients = np.append(std[owner] * y, 1.0)
        residuals = [
            rows[:, -1] - rows[:, :-1] @ coefficients / k
            for rows, k in zip(joints, np.exp(log_gains), strict=True)
        ]
        noise = believed(np.array([_noise(e) for e in residuals]))
        squares = np.bincount(owner, (std[owner] * y) ** 2)
        ratio = squares / np.maximum(np.bincount(owner, seen), 1e-12)
        std = np.sqrt(np.maximum(ratio, least**2))
    return log_gains, reduced.covariance(log_gains)


def _noise(residual: Array) -> float:
    """Noise of a row, as many rows being correlated as its autocorrelation time says."""
    if not residual.any():
        return 0.0
    return residual.std() * np.sqrt(autocorrelation_time(residual))


def _common(triangles: Sequence[Array], noise: Array) -> float:
    """Logarithm of the one gain with which given masses explain the currents best."""
    pairs = zip(triangles, noise, strict=True)
    both = np.concatenate([T[:, -2:] / sigma for T, sigma in pairs])
    (given, product), _ = both.T @ both
    return np.log(given / abs(product)) if given * product else 0.0


@dataclass(frozen=True, eq=False)
class _Reduced:
    """Currents as functions of the logarithms of gains, errors of bodies eliminated.

    Attributes:
        triangles: Of each joint, of [A_j, g_j, i_j] with A_j for errors of one, (≤ 11 nv + 2, ...).
        noise: Standard deviation of each joint's rows, shape (nv,) [A].
        std: Relative standard deviations of the errors of bodies, shape (11 nv,).
    """

    triangles: Sequence[Array]
    noise: Array
    std: Array

    @cached_property
    def prior(self) -> Array:
        """Rows P, ‖P κ‖² being −2 log of the prior, shape (nv + 1, nv)."""
        nv = len(self.noise)
        mean = np.full((1, nv), 1 / nv)
        return np.vstack([(np.eye(nv) - mean) / GAIN_STD, mean / SCALE_STD])

    def rows(self, log_gains: Array) -> tuple[Array, Array, Array, Indices]:
        """Weighted A, g and i, priors of the errors below them, and the joint of each row."""
        stacked = np.vstack(
            [T / s for T, s in zip(self.triangles, self.noise, strict=True)]
        )
        joint = np.repeat(
            np.arange(len(self.noise)), [len(T) for T in self.triangles]
        )
        per_gain = np.exp(-log_gains)[joint, None] * stacked[:, :-1]
        p = len(self.std)
        A = np.vstack([per_gain[:, :p] * self.std, np.eye(p)])
        zeros = np.zeros(p)
        g = np.concatenate([per_gain[:, p], zeros])
        return A, g, np.concatenate([stacked[:, -1], zeros]), joint

    def normal(self, log_gains: Array) -> tuple[Array, Array]:
        """Matrix and right-hand side of a step of the logarithms, shapes (nv, nv) and (nv,)."""
        A, g, i, joint = self.rows(log_gains)
        Q, R = np.linalg.qr(A)
        y = scipy.linalg.solve_triangular(R, Q.T @ (i - g))
        misfit = i - g - A @ y
        nv = len(log_gains)
        D = np.zeros((len(i), nv))
        own = np.arange(len(joint))
        mean = np.full((nv, nv), 1 / nv)
        D[own, joint] = (A @ y)[own]
        D -= D @ mean  # a common scale follows from the given masses alone
        D[own, joint] += g[own]
        D -= Q @ (Q.T @ D)
        P = self.prior
        return D.T @ D + P.T @ P, -D.T @ misfit - P.T @ P @ log_gains

    def solved(self, log_gains: Array) -> Array:
        """Logarithms of the gains, from such ones, shape (nv,)."""
        for _ in range(MOST_STEPS):
            step = np.linalg.solve(*self.normal(log_gains))
            size = np.abs(step).max()
            log_gains = log_gains + step * min(
                1.0, LONGEST_STEP / max(size, 1e-300)
            )
            if size < CONVERGED:
                break
        return log_gains

    def covariance(self, log_gains: Array) -> Array:
        """To first order in noise and errors of bodies, and at least the step that is left."""
        H, gradient = self.normal(log_gains)
        left = np.linalg.solve(H, gradient)
        return np.asarray(np.linalg.inv(H) + np.outer(left, left), float)

    def errors(self, log_gains: Array) -> tuple[Array, Array]:
        """Errors y of bodies, and the part of each one's variance that data took, (11 nv,)."""
        A, g, i, _ = self.rows(log_gains)
        Q, R = np.linalg.qr(A)
        inverse = scipy.linalg.solve_triangular(R, np.eye(len(R)))
        return inverse @ (Q.T @ (i - g)), 1 - (inverse**2).sum(axis=1)


def without_effects(F: Array, *values: Array) -> tuple[Array, ...]:
    """Values at a joint's rows less what its own effect columns F, shape (n, e), can explain."""
    Q = np.linalg.qr(F[:, live(F)])[0]
    return tuple(x - Q @ (Q.T @ x) for x in values)


@dataclass(frozen=True)
class KnownPayload:
    """A body on the last link, as weighed and measured."""

    mass: float  # [kg]
    mass_std: float = 0.0  # [kg]
    centre: Sequence[float] | None = (
        None  # in the last joint's frame [m], where known
    )

    def __post_init__(self) -> None:
        if not self.mass > 0 or self.mass_std < 0:
            raise BadInput(
                f"payload: {self.mass:g} ± {self.mass_std:g} kg; give a mass above 0 kg and "
                "a standard deviation that is not negative"
            )

    def columns(self, body: Array) -> Array:
        """Columns of what is not known of it, and last what is known adds; body (n, 10)."""
        if self.centre is None:
            return np.column_stack([body[:, 1:], self.mass * body[:, 0]])
        point = pin.Inertia(self.mass, np.array(self.centre), np.zeros((3, 3)))
        return np.column_stack([body[:, 4:], body @ point.toDynamicParameters()])


def payload_gains(
    free: Regression, loaded: Regression, payload: KnownPayload, body: Array
) -> DriveGains:
    """Drive gains from currents [A], in place of torque, without and with a known payload.

    Body: base parameters that a body on the last link adds per standard parameter, (r, 10).

    Raises:
        BadInput: The payload does not show in the currents, or hardly.
    """
    own = payload.columns(body)
    empty = np.pad(free.W, ((0, 0), (0, 0), (0, own.shape[1])))
    carrying = np.concatenate([loaded.W, loaded.W @ own], axis=2)
    columns = np.concatenate([empty, carrying])
    size = root_mean_square(columns[:, :, :-1], axis=(0, 1))
    columns[:, :, :-1] /= np.where(size > 0, size, 1.0)
    current = np.concatenate([free.tau, loaded.tau])
    rows = np.dstack([columns, current]).transpose(1, 0, 2)
    owner = np.zeros(len(size), int)
    log_gains, covariance = _solved([*rows], owner, np.array([OPEN_STD]), OPEN_STD)
    # all that is known of the payload, and with it every gain, grows in proportion to its mass
    weighed = np.log1p(payload.mass_std / payload.mass) ** 2
    drive = DriveGains(np.exp(log_gains), covariance + weighed, payload=True)
    if drive.scale_std > LARGEST_SCALE_STD:
        raise BadInput(
            f"payload: {payload.mass:g} kg hardly show in these currents: they fix the common "
            f"scale of the drive gains to ±{100 * drive.scale_std:.0f} % only; use a heavier "
            "payload, say where its centre of mass is, or move it through more poses and longer"
        )
    return drive
