"""Drive gains [N·m/A] of motor currents: from the given masses, or from a known payload.

Masses: current is i_j = c_j (W_j β) + F_j θ_j with one gain k_j = 1/c_j per joint. Parameters of
outer links appear in the rows of several joints, so the gains *relative to each other* follow from
the data (alternating least squares); their common scale does not, and is set so that the given
masses explain the current best. Runs in which joints move one at a time hold next to nothing of
that, and what friction does at their ends would pass for it. Each gain is then that with which the
given masses explain the joint's current, drawn to the others as far as the torque of given masses
is itself unsure, as that of a wrist whose centre of mass lies nearly on its axis.

Payload: without it (a) and with it (b), the torque of joint j is k_j i_j, so that

    [ I_a  −W_a   0    0  ] [k; β; π; s] ≈ 0,
    [ I_b  −W_b  −V   −g  ]

I the diagonal currents, W the columns of the base parameters β of links and effects, V those of
what is not known of the payload and g the torque of what is known: its solution up to a factor is
total least squares over all joints, and the factor follows from s = 1 (Gautier and Briot 2014,
"Global identification of joint drive gains and dynamic parameters of robots"). Only the currents
have errors here, as many in each column as its joint has rows; so the exact columns are eliminated
and k solves the generalised eigenproblem of Van Huffel and Vandewalle (1991). Rows are weighted by
1 / (k_j σ_j), which makes it maximum likelihood. A gain whose joint's current its own friction and
rotor could explain is not shown; it is taken to be that of the other joints, give or take a half.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin
import scipy

from excitant.exceptions import BadInput
from excitant.identify.least_squares import (
    autocorrelation_time,
    factorised,
    with_covariance,
)
from excitant.identify.preprocessing import Mask
from excitant.identify.prior import link_coordinates, link_weights, prior_parameters
from excitant.identify.recording import Recording
from excitant.identify.regression import Regression, dense, triangle
from excitant.identify.signals import live
from excitant.robots.base_parameters import BaseParameters, independent_columns
from excitant.robots.motion import Array, freeze
from excitant.robots.robot import Robot

GAIN_STD = 0.5  # relative, of drives of one arm: decides only what data leave open
NOISE_ROUNDS = 4  # of re-estimating the noise of each joint
MOST_ALTERNATIONS = 200  # between gains and parameters
CONVERGED = 1e-6  # change of the logarithm of a gain that ends them
BODY_STD = 0.3  # relative std assumed for given bodies
PLACEHOLDER_STD = 3.0  # the same where all links weigh the same
MOVING_TOGETHER = (
    0.5  # of a joint's rows with another one moving: rows then compare
)
LARGEST_SCALE_STD = 0.2  # of the common scale, above which a payload is refused
PAYLOAD_ROUNDS = 30  # of re-weighting with a known payload, at most
SETTLED = 1e-8  # change of gains and noise that ends them
DEPENDENT = 1e-7  # part of a unit column that is outside the others
_IN_AMPERES = (
    ("(N·m)", "A"),
    ("N·m", "A"),
    ("kg·m²", "A·s²/rad"),
    ("kg", "A·s²/m"),
    ("N", "A"),
)
SHOWN_RATIO = 4.0  # of a current's residual to the least one: its gain is shown


@dataclass(frozen=True, eq=False)
class DriveGains:
    """Torque per ampere of every joint, from the given masses or from a known payload."""

    gains: Array  # shape (nv,) [N·m/A]
    covariance: Array  # of their logarithms, shape (nv, nv)
    scale_std: float  # relative standard deviation of their common scale
    # whether joints were compared; else each is judged by its own rows
    compared: bool = True
    # of a known payload: whether the recordings show each gain
    shown: tuple[bool, ...] = ()

    def __post_init__(self) -> None:
        freeze(self, "gains", "covariance")

    @property
    def std(self) -> Array:
        """Standard deviations of the gains, shape (nv,) [N·m/A]."""
        return self.gains * np.sqrt(np.diag(self.covariance))

    @property
    def fixed(self) -> bool:
        """Whether anything fixes the common scale: it is known to better than all of itself."""
        return self.scale_std < 1

    def sentence(self, joints: Sequence[str]) -> str:
        """The gains, where they come from, and what the recordings leave open."""
        pairs = ", ".join(
            f"{k:.4g} ± {s:.2g}" for k, s in zip(self.gains, self.std, strict=True)
        )
        start = f"torque was recorded as current; drive gains ({pairs} N·m/A)"
        scale = self.scale_std
        if self.shown:
            hidden = [
                joint
                for joint, seen in zip(joints, self.shown, strict=True)
                if not seen
            ]
            rest = f"; that of {', '.join(hidden)} is not shown and was taken from the other joints"
            return (
                f"{start} follow from the known payload, their common scale to ±{100 * scale:.2g} %"
                f"{rest if hidden else ''}"
            )
        known = "a known payload determines it (--payload-recording)"
        if not self.fixed:
            return (
                f"{start} are relative to each other, for nothing fixes their common scale (the "
                f"given masses, to ±{100 * scale:.0f} %): friction is told in amperes, and masses, "
                f"inertias and base parameters hold up to that factor; {known}"
            )
        if not self.compared:
            start += (
                " follow from the given masses joint by joint, and from each other where masses "
                "hardly load the joint, for joints that move one at a time do not show them "
                "relative to each other"
            )
        else:
            start += " were estimated from what joints have in common"
        return (
            f"{start}; their common scale, which currents do not determine, follows from the given "
            f"masses to ±{100 * scale:.0f} %, and with it all masses, inertias and friction, whose "
            f"± contains it; {known}"
        )

    def told(self, unit: str, joint: int) -> tuple[float, str]:
        """Factor and unit in which to tell a coefficient of a joint: in amperes if not `fixed`."""
        for torque, current in _IN_AMPERES:
            if torque in unit and not self.fixed:
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
        """Entries of result.json."""
        return {
            "drive_gain_Nm_per_A": self.gains.tolist(),
            "drive_gain_std_Nm_per_A": self.std.tolist(),
            "drive_gain_scale_rel_std": self.scale_std,
            **({"drive_gain_shown": list(self.shown)} if self.shown else {}),
        }


def current_gains(
    robot: Robot,
    base: BaseParameters,
    W: Array,
    current: Array,
    moves: Mask | None = None,
) -> DriveGains:
    """Gains k with torque = k · current.

    A gain that the motion hardly shows stays near those of the other joints. W are the columns of
    links and effects, (n, nv, p); only rows in which a joint moves count, (n, nv), all when None.
    """
    links = 10 * robot.nv
    # links that all weigh the same are placeholders
    sigma = BODY_STD if np.ptp(robot.phi[::10]) > 0 else PLACEHOLDER_STD
    spread = link_coordinates(prior_parameters(robot)) / link_weights(
        robot.nv, sigma
    )
    if moves is not None:
        several = moves.sum(axis=1) > 1
        share = (moves & several[:, None]).sum(axis=0) / np.maximum(
            moves.sum(axis=0), 1
        )
        if (share < MOVING_TOGETHER).any():
            return _each_alone(robot, W, current, moves, spread)
        W = W * moves[:, :, None]
        current = current * moves
    shown = [c for c in base.columns if c < links]
    return _compared(
        W[:, :, :links], W[:, :, links:], current, shown, robot.phi, spread
    )


def _compared(
    Y: Array, F: Array, current: Array, shown: list[int], phi: Array, spread: Array
) -> DriveGains:
    nv = Y.shape[1]
    effects = [F[:, j] for j in range(nv)]
    alike = [_stand_in(F_j, Y[:, j] @ phi) for j, F_j in enumerate(effects)]
    # as on a gantry without gravity, where rotors are like masses
    if None not in alike:
        pairs = zip(effects, alike, strict=True)
        effects = [np.delete(F_j, k, axis=1) for F_j, k in pairs if k is not None]
    parts = [
        without_effects(F_j, Y[:, j], current[:, j])
        for j, F_j in enumerate(effects)
    ]
    Y, current = (np.stack(values, axis=1) for values in zip(*parts, strict=True))
    W = Y[:, :, shown]
    given = Y @ phi
    gram = np.einsum("njr,njs->jrs", W, W, optimize=True)
    moment = np.einsum("njr,nj->jr", W, current, optimize=True)
    gains = np.ones(nv)
    sigma = np.maximum(current.std(axis=0), 1e-12)
    independent = np.ones(nv)
    beta = np.zeros(len(shown))
    for _ in range(NOISE_ROUNDS):
        gains, beta = _alternate(gram, moment, independent / sigma**2, gains)
        residual = current - W @ beta / gains
        sigma = np.maximum(residual.std(axis=0), 1e-12)
        independent = 1 / np.array([autocorrelation_time(e) for e in residual.T])
    model = given / gains
    size = ((model / sigma) ** 2).sum()
    scale = size / (model * current / sigma**2).sum()
    # relative to each other, to first order in the noise, beside the parameters
    information = np.zeros((nv + len(shown),) * 2)
    for j in range(nv):
        columns = (
            np.column_stack([np.outer(-W[:, j] @ beta, np.eye(nv)[j]), W[:, j]])
            / gains[j]
        )
        information += columns.T @ columns * independent[j] / sigma[j] ** 2
    contrasts = scipy.linalg.null_space(np.ones((1, nv)))
    reduced = scipy.linalg.block_diag(contrasts, np.eye(len(shown)))
    information = reduced.T @ information @ reduced
    information[: nv - 1, : nv - 1] += np.eye(nv - 1) / GAIN_STD**2
    apart = np.linalg.pinv(information, hermitian=True)[: nv - 1, : nv - 1]
    # the common scale, by the uncertainty of the given links
    pull = (
        np.einsum("nj,njp->p", model / gains / sigma**2, Y, optimize=True) @ spread
    )
    unsure = float(np.linalg.norm(pull) / size)
    covariance = contrasts @ apart @ contrasts.T + unsure**2
    return DriveGains(gains * abs(scale), covariance, unsure, True)


def _stand_in(F: Array, given: Array) -> int | None:
    """The largest of the effects that together make all the torque of the given links, if any."""
    x = np.linalg.lstsq(F, given, rcond=None)[0]
    if np.linalg.norm(given - F @ x) > DEPENDENT * np.linalg.norm(given):
        return None
    return int(np.argmax(np.abs(x) * np.linalg.norm(F, axis=0)))


def _alternate(
    gram: Array, moment: Array, weight: Array, gains: Array
) -> tuple[Array, Array]:
    prior = 1 / GAIN_STD**2  # of 1/k around the geometric mean, which is kept at 1
    for _ in range(MOST_ALTERNATIONS):
        A = np.einsum("j,jrs->rs", weight / gains**2, gram)
        beta = np.linalg.lstsq(A, (weight / gains) @ moment, rcond=1e-12)[0]
        information = weight * np.einsum("r,jrs,s->j", beta, gram, beta)
        evidence = weight * (moment @ beta)
        updated = (information + prior) / np.maximum(evidence + prior, prior / 10)
        updated /= np.exp(np.log(updated).mean())
        change = np.abs(np.log(updated / gains)).max()
        gains = updated
        if change < CONVERGED:
            break
    return gains, beta


def _each_alone(
    robot: Robot, W: Array, current: Array, moves: Mask, spread: Array
) -> DriveGains:
    """Gains from each joint's own rows, as logarithms that scatter around a common one."""
    links = 10 * robot.nv
    nv = robot.nv
    pairs = [
        _log_gain(
            W[rows, j, :links],
            W[rows, j, links:],
            current[rows, j],
            robot.phi,
            spread,
        )
        for j, rows in enumerate(moves.T)
    ]
    own, variance = np.array(pairs).T
    if not np.isfinite(variance).any():
        return DriveGains(
            np.ones(nv), np.full((nv, nv), GAIN_STD**2), GAIN_STD, False
        )
    weight = 1 / (variance + GAIN_STD**2)
    common = float(weight @ own / weight.sum())
    gains = np.exp(common + GAIN_STD**2 * weight * (own - common))
    unsure = 1 / float(weight.sum())
    covariance = np.diag(GAIN_STD**2 * (1 - GAIN_STD**2 * weight)) + unsure
    return DriveGains(gains, covariance, float(np.sqrt(unsure)), False)


def _log_gain(
    Y: Array, F: Array, current: Array, phi: Array, spread: Array
) -> tuple[float, float]:
    """Logarithm of the gain with which given torque Y φ explains a current, and its variance."""
    count = int(live(F).sum())
    if len(current) <= count + 1:
        return 0.0, np.inf
    Y, i = without_effects(F, Y, current)
    tau = Y @ phi
    size = float(tau @ tau)
    per_torque = float(tau @ i) / max(size, 1e-300)
    if per_torque <= 0:
        return 0.0, np.inf
    residual = i - per_torque * tau
    noise = float(residual @ residual) / (len(i) - count - 1)
    variance = noise * autocorrelation_time(residual) / size / per_torque**2
    return -float(np.log(per_torque)), variance + gain_doubt(Y, phi, spread) ** 2


def gain_doubt(Y: Array, phi: Array, spread: Array) -> float:
    """Standard deviation of a gain on torque Y φ, (n, 10 links), φ with covariance S Sᵀ."""
    tau = Y @ phi
    return float(np.linalg.norm(tau @ Y @ spread) / max(float(tau @ tau), 1e-300))


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
    hardly = (
        f"payload: {payload.mass:g} kg hardly show in these currents; use a heavier payload, say "
        "where its centre of mass is, or move it through more poses and longer"
    )
    current = np.concatenate([free.tau, loaded.tau])
    exact = _exact_columns(free.W, loaded.W, payload.columns(body), hardly)
    k, theta, shown = _solved(exact, current)
    if (k <= 0).any():
        raise BadInput(f"{hardly}: the gains found are not positive")
    log_cov = _covariance(exact, current, k, theta, shown)
    mean = shown / shown.sum()
    # all that is known of the payload, and with it every gain, grows in proportion to its mass
    weighed = np.log1p(payload.mass_std / payload.mass) ** 2
    scale = float(np.sqrt(mean @ log_cov @ mean + weighed))
    if scale > LARGEST_SCALE_STD:
        raise BadInput(
            f"{hardly}: they fix the common scale of the drive gains to ±{100 * scale:.0f} % only"
        )
    return DriveGains(
        k, log_cov + weighed, scale, shown=tuple(bool(each) for each in shown)
    )


def _exact_columns(free: Array, loaded: Array, own: Array, hardly: str) -> Array:
    """Columns without errors, those of the payload that others explain left out, (n, nv, e)."""
    r, added = own.shape
    empty = np.pad(free, ((0, 0), (0, 0), (0, added)))
    exact = np.concatenate([empty, np.concatenate([loaded, loaded @ own], axis=2)])
    flat = exact.reshape(-1, r + added)
    norms = np.linalg.norm(flat, axis=0)
    R = triangle(flat / np.where(norms > 0, norms, 1.0))
    independent, _ = independent_columns(R, DEPENDENT)
    if r + added - 1 not in independent:
        raise BadInput(f"{hardly}: no torque of it differs from the arm's own")
    if not set(range(r)) <= set(independent):
        raise BadInput(
            "payload: the recordings do not determine all base parameters of the arm; move all "
            "joints in the recordings without payload"
        )
    return exact[:, :, list(independent)]


def _solved(exact: Array, current: Array) -> tuple[Array, Array, Mask]:
    """Gains, shape (nv,), coefficients of the exact columns, the known one 1, and what is shown."""
    n, nv = current.shape
    triangles = [
        triangle(np.column_stack([X, i]))
        for X, i in zip(exact.transpose(1, 0, 2), current.T, strict=True)
    ]
    k = np.ones(nv)
    sigma = np.maximum(current.std(axis=0), 1e-12)
    for _ in range(PAYLOAD_ROUNDS):
        weight = 1 / (k * sigma)
        gains, theta, shown = _eliminated(
            triangles, weight, n * (weight * sigma) ** 2
        )
        rest = [
            np.linalg.norm(gains[j] * T[:, -1] - T[:, :-1] @ theta)
            for j, T in enumerate(triangles)
        ]
        ahead = np.maximum(np.array(rest) / np.sqrt(n) / np.abs(gains), 1e-12)
        change = (
            np.abs(gains / k / np.mean(gains / k) - 1).max()
            + np.abs(ahead / sigma - 1).max()
        )
        k = np.abs(gains)
        sigma = ahead
        if change < SETTLED:
            break
    return gains / theta[-1], theta / theta[-1], shown


def _eliminated(
    triangles: Sequence[Array], weight: Array, noise: Array
) -> tuple[Array, Array, Mask]:
    """Gains and coefficients, of norm one, and which are shown; noise of the columns, squared."""
    rows = [w * T for w, T in zip(weight, triangles, strict=True)]
    X = np.vstack([T[:, :-1] for T in rows])
    currents = scipy.linalg.block_diag(*(T[:, -1:] for T in rows))
    norms = np.linalg.norm(X, axis=0)
    Q, R = np.linalg.qr(X / norms)
    remaining = currents - Q @ (Q.T @ currents)
    # a gain is shown whose current alone leaves more than noise beside the exact columns
    scaled = remaining / np.sqrt(noise)
    best = float(np.linalg.svd(scaled, compute_uv=False)[-1] ** 2)
    shown = (scaled**2).sum(axis=0) > SHOWN_RATIO * max(best, 1e-300)
    if not shown.any():
        shown[:] = True
    tie = np.eye(len(weight))[:, shown]
    tie[~shown] = 1 / shown.sum()
    _, _, Vt = np.linalg.svd(remaining @ tie / np.sqrt(noise[shown]))
    k = tie @ (Vt[-1] / np.sqrt(noise[shown]))
    theta = scipy.linalg.solve_triangular(R, Q.T @ (currents @ k)) / norms
    sign = 1.0 if k.sum() >= 0 else -1.0
    return sign * k, sign * theta, shown


def _covariance(
    exact: Array, current: Array, k: Array, theta: Array, shown: Mask
) -> Array:
    """Covariance of the logarithms of the gains, to first order in coloured noise, (nv, nv)."""
    torque = exact @ theta
    per_gain = np.einsum("nj,jk->njk", -torque / k, np.eye(len(k)))
    columns = np.concatenate(
        [per_gain[:, :, shown], exact[:, :, :-1] / k[:, None]], axis=2
    )
    residual = current - torque / k
    sigma = np.maximum(residual.std(axis=0), 1e-12)
    names = tuple(f"column {c}" for c in range(columns.shape[2]))
    factor = factorised(dense(columns, residual, names), sigma)
    fit = with_covariance(factor, np.zeros(columns.shape[2]), residual, sigma)
    covariance = GAIN_STD**2 * np.eye(len(k))
    count = int(shown.sum())
    covariance[np.ix_(shown, shown)] = fit.covariance[:count, :count]
    return covariance
