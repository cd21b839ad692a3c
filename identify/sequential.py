"""Identification link by link (Khosla 1987, section 4): parameters from the last joint inward.

Row τ_i contains no parameter of links before i (Property 4), so the row of the last joint alone
identifies the last link, the row before it the link before, with the outer one known, and so on.
What the recordings do not show stays at the given robot.

Base parameters are counted from the given robot in units of its uncertainty, β = β₀ + L y with
y ~ N(0, 1). The stages so far know c = Dᵀ y, D orthonormal, with covariance P. Rows of joint i,
A = W_i L, give

    minimise  ‖τ_i − W_i β₀ − A (D c + V η)‖,

V the directions outside D that they show. The values from outside stay as they are ("known"), so
no row of an outer joint is needed again; what is not known of them reaches η with

    δη = H (ε − A D δc),   H = (A V)⁺,   G = H A D,

    cov(c, η) = [ P       −P Gᵀ           ]
                [ −G P    H Γ Hᵀ + G P Gᵀ ],

Γ the covariance of coloured noise ε, known from what no value of any parameter explains of the
row: the residual itself holds errors of outer values too.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy

from excitant.identify.estimate import (
    Estimate,
    estimate_by,
    notes_on,
)
from excitant.identify.information import Information, gaussian, square_root
from excitant.identify.least_squares import (
    JointRows,
    LeastSquares,
    score_covariances,
    student_width,
)
from excitant.identify.preprocessing import REST, stilled
from excitant.identify.prior import BasePrior, base_prior, prior_parameters
from excitant.identify.recording import Recordings, recordings_of
from excitant.identify.rows import Data, FitRows, effects_of, fit_rows, split
from excitant.robots.base_parameters import (
    BaseParameters,
    base_parameters,
    expression,
    last_rows,
)
from excitant.robots.effects import Effect
from excitant.robots.motion import Array, Noun
from excitant.robots.robot import Robot
from excitant.robots.threads import on_one_thread

SURER_THAN_PRIOR = 2.0  # times, from which on the recordings decide a direction
PREFERENCE = 100.0
"""Weight of a link's own parameters where one is chosen to lead a combination."""
NEGLIGIBLE_COEFFICIENT = 1e-6  # in units of the parameters' scale
ROUNDING = 1e-8  # of the clearest direction: what rounding and interpolation leave
NEGLIGIBLE_STDS = 0.05  # of a combination: terms that matter less are not written


@dataclass(frozen=True, eq=False)
class Cascade(Noun):
    """Estimate of the r base parameters after the stages so far."""

    mean: Array  # β₀, shape (r,)
    L: Array  # square root of the given robot's covariance, shape (r, r)
    D: Array  # directions known, orthonormal, shape (r, k)
    c: Array  # their values, shape (k,)
    P: Array  # their covariance, shape (k, k)

    @property
    def beta(self) -> Array:
        """Base parameters: known where shown, else those of the given robot, shape (r,)."""
        return self.mean + self.L @ (self.D @ self.c)

    @property
    def covariance(self) -> Array:
        """Their covariance; that of the given robot in directions not shown, shape (r, r)."""
        open_directions = np.eye(len(self.mean)) - self.D @ self.D.T
        return self.L @ (self.D @ self.P @ self.D.T + open_directions) @ self.L.T

    @property
    def functionals(self) -> Array:
        """The combinations of base parameters known: rows F with F β = F β̂, shape (k, r)."""
        return scipy.linalg.solve_triangular(self.L, self.D, lower=True, trans=1).T

    def information(self) -> Information:
        """All that is known, as rows about β of unit noise; nothing of the given robot in it."""
        known = gaussian(self.c, self.P)
        R = known.R @ self.functionals
        return Information(R, known.z + R @ self.mean)


def beginning(prior: BasePrior) -> Cascade:
    """Nothing known but the given robot."""
    L = square_root(prior.covariance)
    return Cascade(
        prior.mean, L, np.zeros((len(L), 0)), np.zeros(0), np.zeros((0, 0))
    )


def further(known: Cascade, W: Array, tau: Array) -> tuple[Cascade, float, float]:
    """One stage further inward, from rows of its joint, (n, r), and its torque, (n,).

    Beside what is known then: the noise of the rows, and how many count as one independent row.
    """
    if len(tau) == 0:
        return known, np.nan, 1.0
    A = W @ known.L
    D = known.D
    outer = A @ D
    target = tau - W @ known.mean - outer @ known.c
    size = float(np.linalg.norm(A))
    U, s, Vt = _directions(A - outer @ D.T, size)
    scores, sigma, inflation = _noise(_directions(A, size)[0], U, target)
    visible = s >= SURER_THAN_PRIOR * np.sqrt(np.diag(scores))
    if not visible.any():
        return known, sigma, inflation
    U = U[:, visible]
    s = s[visible]
    V = Vt[visible].T
    variance = scores[np.ix_(visible, visible)] / np.outer(s, s)
    H = U.T / s[:, None]
    G = H @ outer
    cross = -G @ known.P
    P = np.block([[known.P, cross.T], [cross, variance - cross @ G.T]])
    V = V - D @ (D.T @ V)  # once more, against rounding
    V /= np.linalg.norm(V, axis=0)
    c = np.concatenate([known.c, H @ target])
    return replace(known, D=np.hstack([D, V]), c=c, P=P), sigma, inflation


def _directions(A: Array, size: float) -> tuple[Array, Array, Array]:
    """Singular vectors and values of A above rounding."""
    U, s, Vt = scipy.linalg.svd(A, full_matrices=False)
    keep = s > ROUNDING * size
    return U[:, keep], s[keep], Vt[keep]


def _noise(every: Array, U: Array, target: Array) -> tuple[Array, float, float]:
    """Covariance of scores Uᵀε, size of ε, inflation; U lies in the span of every, (n, m)."""
    n, m = every.shape
    residual = target - every @ (every.T @ target)
    # data without noise
    floor = 1e-9 * np.linalg.norm(target) / np.sqrt(n) + 1e-12
    sigma = max(np.linalg.norm(residual) / np.sqrt(max(n - m, n / 10)), floor)
    scores, freedom = score_covariances(
        [JointRows(every, np.eye(m))], [residual / sigma]
    )
    T = every.T @ U
    covariance = sigma**2 * student_width(freedom[0]) ** 2 * (T.T @ scores[0] @ T)
    inflation = max(np.trace(covariance) / max(len(T.T), 1) / sigma**2, 1.0)
    return covariance + floor**2 * np.eye(len(T.T)), sigma, inflation


def _led_combinations(
    F: Array, led: list[int], rows: Array, scale: Array, preferred: Sequence[int]
) -> tuple[Array, list[int]]:
    """Combinations F β with further ones; in each one parameter leads, with coefficient 1."""
    if len(rows) == 0:
        return F, led
    rest = (rows - rows[:, led] @ F) * scale
    rest[:, led] = 0.0
    Q = np.linalg.qr(rest.T)[0].T
    weight = np.ones(len(scale))
    weight[list(preferred)] = PREFERENCE
    _, pivots = scipy.linalg.qr(Q * weight, mode="r", pivoting=True)
    added = sorted(pivots[: len(Q)].tolist(), key=lambda k: (k not in preferred, k))
    new = np.linalg.solve(Q[:, added], Q)
    new[np.abs(new) < NEGLIGIBLE_COEFFICIENT] = 0.0
    new[:, added] = np.eye(len(added))
    return np.vstack([F, new * scale[added, None] / scale]), led + added


def link_rows(robot: Robot, effects: tuple[Effect, ...], data: Data) -> FitRows:
    """Rows of the training segments; a joint still in all of a segment is held exactly."""
    train = tuple(
        stilled(s, np.ptp(s.motion.q, axis=0) > REST.travel) for s in data.train
    )
    base = base_parameters(robot, effects)
    return fit_rows(robot, effects, base, replace(data, train=train))


def _recordings(rows: FitRows, joint: int) -> tuple[str, ...]:
    """Recordings in which rows of a joint count."""
    train = rows.data.train
    ends = np.cumsum([len(s.t) for s in train])[:-1]
    parts = np.split(rows.used[:, joint], ends)
    names = (s.name for s, used in zip(train, parts, strict=True) if used.any())
    return tuple(dict.fromkeys(names))


@dataclass(frozen=True)
class Determined:
    """A combination of parameters that a stage determines, e.g. ``link3.Izz + 0.36·link4.m``."""

    expression: str
    value: float
    std: float


@dataclass(frozen=True)
class Stage:
    """One link."""

    joint: int  # index of its joint, whose row was read
    rows: int  # number of its rows that count
    noise: float  # their standard deviation [torque unit]; NaN without rows
    inflation: float  # rows that count as one independent row
    recordings: tuple[str, ...]  # that have such rows
    determined: tuple[Determined, ...]  # what the row adds to the links further out
    # base parameters of the link that no recording shows
    missing: tuple[str, ...] = ()

    def result(self, robot: Robot) -> dict[str, Any]:
        """Entry of result.json."""
        return vars(self) | {
            "link": robot.links[self.joint],
            "joint": robot.joints[self.joint],
            "noise": self.noise if np.isfinite(self.noise) else None,
            "determined": [vars(each) for each in self.determined],
        }


@dataclass(frozen=True, eq=False)
class LinkByLink:
    """Result of link-by-link identification."""

    estimate: Estimate  # physically consistent model and its accuracy
    cascade: Cascade  # the base parameters with their covariance
    stages: tuple[Stage, ...]  # the links, last one first

    def result(self) -> dict[str, Any]:
        """Entries of result.json: those of `identify`, and the stages under ``link_by_link``."""
        robot = self.estimate.given
        return self.estimate.result() | {
            "estimator": "link by link from the last inward, each from its own joint's row with "
            "the outer links known; then physically consistent semidefinite fit",
            "link_by_link": {
                "stages": [stage.result(robot) for stage in self.stages],
                "determined": sum(len(stage.determined) for stage in self.stages),
                "base_parameters": len(self.estimate.base),
            },
        }

    def series(self) -> dict[str, Array]:
        """Measured torque and that of the models on the hold-out, each of shape (n, nv)."""
        return self.estimate.series()


@on_one_thread
def identify_link_by_link(
    robot: Robot,
    recordings: Recordings,
    *,
    validate: Recordings = (),
    effects: Sequence[Effect] | None = None,
    cutoff_hz: float | None = None,
) -> LinkByLink:
    """Identify a robot from the last link inward.

    Args and errors are those of `identify_robot`, but no motion is refused for what it leaves open.
    """
    recordings = recordings_of(recordings, robot)
    validate = recordings_of(validate, robot)
    effects = effects_of(robot, effects)
    prior = prior_parameters(robot)
    rows = link_rows(robot, effects, split(recordings, validate, cutoff_hz))
    cascade, stages = run_stages(rows)
    noise, inflation = np.array(
        [(stage.noise, stage.inflation) for stage in reversed(stages)]
    ).T
    fit = LeastSquares(cascade.beta, cascade.covariance, noise, inflation)
    known = cascade.information()
    whitened = known.R @ rows.base.regrouping, known.z
    estimate = estimate_by(robot, rows, fit, whitened, _notes(rows, stages, prior))
    return LinkByLink(estimate, cascade, stages)


def run_stages(rows: FitRows) -> tuple[Cascade, tuple[Stage, ...]]:
    """Estimate of the base parameters after all stages, and the stages, last joint first."""
    base = rows.base
    prior = base_prior(rows.robot, rows.effects, base)
    scale = np.sqrt(np.diag(prior.covariance))
    # joint, the last whose row holds each base parameter
    last = last_rows(rows.robot, rows.effects, base)
    W = rows.W[:, :, base.columns]
    cascade = beginning(prior)
    F = np.zeros((0, len(base)))
    leading = list[int]()
    stages = []
    for j in reversed(range(rows.robot.nv)):
        before = len(leading)
        counted = rows.used[:, j]
        cascade, noise, inflation = further(
            cascade, W[counted, j], rows.tau[counted, j]
        )
        own = np.flatnonzero(last == j).tolist()
        F, leading = _led_combinations(
            F, leading, cascade.functionals[before:], scale, own
        )
        stages.append(
            Stage(
                j,
                int(counted.sum()),
                noise,
                inflation,
                _recordings(rows, j),
                _determined(base, cascade, F[before:], leading[before:], scale),
            )
        )
    missing = np.setdiff1d(np.arange(len(base)), leading)
    return cascade, tuple(
        replace(
            stage,
            missing=tuple(
                base.expressions[k] for k in missing if last[k] == stage.joint
            ),
        )
        for stage in stages
    )


def _determined(
    base: BaseParameters, known: Cascade, F: Array, leading: list[int], scale: Array
) -> tuple[Determined, ...]:
    J = F @ known.L @ known.D
    entries = []
    spread = np.sqrt(np.diag(J @ known.P @ J.T))
    for row, lead, value, s in zip(F, leading, F @ known.beta, spread, strict=True):
        terms = np.where(np.abs(row) * scale > NEGLIGIBLE_STDS * s, row, 0.0)
        terms[lead] = 1.0
        text = expression(terms @ base.regrouping, base.names, base.columns[lead])
        entries.append(Determined(text, float(value), float(s)))
    return tuple(entries)


def _notes(rows: FitRows, stages: Sequence[Stage], prior: Array) -> tuple[str, ...]:
    count = sum(len(stage.determined) for stage in stages)
    r = len(rows.base)
    rest = ""
    if count < r:
        rest = (
            "; the rest stays at the given robot: `excitant design --link-by-link` makes the "
            "motions that show it"
        )
    notes = notes_on(rows, prior)
    determined = f"link by link, these recordings determine {count} of {r} base combinations{rest}"
    return (notes[0], determined, *notes[1:])
