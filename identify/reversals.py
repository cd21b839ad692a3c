"""How suddenly dry friction turns at a reversal: at once, or over a range of speeds.

Coulomb's law jumps where a joint reverses, and at rest leaves its torque open, −F_c to F_c.
Transmissions that give way, lubricant and the filter of a current controller spread the jump:
F_c tanh(q̇ / v) runs through that interval while |q̇| is below about v.

A joint gets the v that predicts best what a fit has not seen, rows of rest included, if it predicts
better than a jump by more than chance, and no worse while the joint moves. Rows that count are left
out in blocks of time: with Q their columns in an orthonormal basis, θ = Qᵀ τ and e = τ − Q θ, the
fit to all blocks but b is

    θ_b = θ − (1 − Q_bᵀ Q_b)⁻¹ Q_bᵀ e_b.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from excitant.exceptions import RankDeficient
from excitant.identify.accuracy import BLOCKS, chance_of_loss
from excitant.identify.least_squares import (
    LeastSquares,
    autocorrelation_time,
    weighted_least_squares,
)
from excitant.identify.preprocessing import certain_rows, top_speed
from excitant.identify.regression import effect_columns, regression_of
from excitant.identify.rows import Data, FitRows, counted_rows, places_of
from excitant.robots.base_parameters import BaseParameters
from excitant.robots.effects import (
    Effect,
    GradualReversal,
    turned,
    turning,
    turning_speed,
)
from excitant.robots.motion import Array, Mask
from excitant.robots.robot import Robot


@dataclass(frozen=True)
class ReversalSettings:
    """How the speed over which friction turns is chosen.

    Attributes:
        shares: Speeds tried over the highest speed of a joint: from where most reversals are
            shorter than a sample to where friction is hardly told from viscous. Slower than
            `Segment.least_speed`, it is the noise of speeds that turns signs.
        chance: Probability of a gain by chance from which on friction turns at once, and of a
            loss at rows of motion up to which rest may be predicted at their cost. Convention.
        least: Rms error on rows left out is less by this share at least: a smaller gain is
            not worth a parameter. Convention.
        trusted: Share of rows, by their errors; larger errors count as its largest, so that a
            few rows decide nothing.
        rank: Singular value relative to the largest, below which columns are dependent.
        difference: Step of log v for the derivative of torque.
        rounds: Gauss-Newton steps of log v from the best of these speeds; two or three settle.
    """

    shares: Array = field(default_factory=lambda: np.geomspace(0.005, 0.32, 10))
    chance: float = 0.1
    least: float = 0.01
    trusted: float = 0.95
    rank: float = 1e-9
    difference: float = 1e-3
    rounds: int = 5

    @property
    def step(self) -> float:
        """Of log v, between speeds tried."""
        return np.log(self.shares[1] / self.shares[0])


REVERSALS = ReversalSettings()
DETERMINED = (
    2.0  # standard deviations above zero from which on v is told with its ±
)


class Turning(NamedTuple):
    """Dry friction of a joint over a range of speeds.

    Attributes:
        effect: Coulomb friction that turns so, without a value.
        column: Its column at all rows, shape (n,).
        gain: 1 less the squared error on rows left out over that of friction that turns at once.
        std: Standard deviation of log v; NaN where the rows do not show it.
    """

    effect: Effect
    column: Array
    gain: float
    std: float = np.nan

    @property
    def reversal(self) -> GradualReversal:
        """It as a cause of errors."""
        speed = turning_speed(self.effect)
        std = speed * float(self.std) if self.std < 1 / DETERMINED else 0.0
        return GradualReversal(self.effect.joints, None, speed, std)

    def words(self, robot: Robot) -> str:
        """Where it is, v, and its gain."""
        found = self.reversal
        spread = f" ± {found.std:.1g}" if found.std else ""
        unit = found.shape_unit(robot, found.search.shapes[0])
        gain = f"error {100 * self.less:.0f} % less"
        return f"{found.joints[0]} {found.speed:.2g}{spread} {unit} ({gain})"

    def entry(self, robot: Robot) -> dict[str, Any]:
        """As an entry of result.json."""
        found = self.reversal
        return {
            "joint": found.joints[0],
            "speed": found.speed,
            "std": found.std or None,
            "unit": found.shape_unit(robot, found.search.shapes[0]),
        }

    @property
    def less(self) -> float:
        """The same of the root of the mean square."""
        return 1 - np.sqrt(1 - self.gain)


def turned_rows(
    robot: Robot,
    effects: Sequence[Effect],
    base: BaseParameters,
    data: Data,
    spoiled: Callable[[FitRows], bool] | None = None,
) -> tuple[FitRows, tuple[Turning, ...]]:
    """The rows of a fit with dry friction that turns as they show, and where it does.

    Of rows that are ``spoiled``, as by bursts of torque, it turns at once: they decide nothing.
    """
    effects = [turning(effect, 0.0) for effect in effects]
    regression = regression_of(robot, effects, data.train)
    at_once = counted_rows(robot, effects, base, data, regression)
    reduced = regression.select(base.columns)
    used = certain_rows(effects, robot.joints, data.train)
    least = np.max([s.least_speed for s in data.train], axis=0)
    top = top_speed(data.train)
    found = list[Turning]()
    for effect, own_columns in places_of(robot, effects):
        if turning(effect, 1.0) == effect:
            continue
        for column, single in enumerate(effect.singles(), own_columns.start):
            if column not in base.columns:
                continue
            [j] = single.rows(robot)
            own = reduced.index[j] == base.columns.index(column)
            if not (own.any() and used[:, j].any()):
                continue
            fit = _LeftOut(reduced.columns[j], own, reduced.tau[:, j], used[:, j])
            speeds = [v for v in REVERSALS.shares * top[j] if v > least[j]]
            best = _turning(fit, single, robot, data, speeds)
            if best is not None:
                regression = regression.with_column(column, j, best.column)
                found.append(best)
    if not found or (spoiled is not None and spoiled(at_once)):
        return at_once, ()
    laws = turned(effects, [each.reversal for each in found])
    return counted_rows(robot, laws, base, data, regression), tuple(found)


def turning_notes(found: Sequence[Turning], robot: Robot) -> tuple[str, ...]:
    """What is told of friction that turns over a range of speeds."""
    if not found:
        return ()
    return (
        "dry friction turns over a range of speeds at reversals, F_c tanh(q̇ / v), which "
        "predicts parts of the recordings left out of a fit better than a jump, rows of rest "
        f"included: v = {', '.join(each.words(robot) for each in found)}",
    )


def _turning(
    fit: _LeftOut,
    effect: Effect,
    robot: Robot,
    data: Data,
    speeds: Sequence[float],
) -> Turning | None:
    """The best of these speeds for one joint; None where friction turns at once."""
    squares = fit.errors(fit.own) ** 2
    limit = np.quantile(squares, REVERSALS.trusted)
    at_once = np.minimum(squares, limit)
    tried = []
    for speed in speeds:
        candidate = turning(effect, float(speed))
        column = _column(candidate, robot, data)
        gains = at_once - np.minimum(fit.errors(column) ** 2, limit)
        certain = chance_of_loss(gains) < REVERSALS.chance
        if certain and chance_of_loss(-gains[fit.used]) > REVERSALS.chance:
            gain = gains.mean() / at_once.mean()
            tried.append(Turning(candidate, column, gain))
    best = max(tried, key=lambda each: each.gain, default=None)
    if best is None or best.less < REVERSALS.least:
        return None
    return _refined(fit, best, robot, data)


def _refined(fit: _LeftOut, found: Turning, robot: Robot, data: Data) -> Turning:
    """The same with v between the neighbours on the grid at which squared errors are least."""
    start = turning_speed(found.effect)
    log_ratio = 0.0
    for _ in range(REVERSALS.rounds):
        effect, ahead = (
            turning(found.effect, start * float(np.exp(log_ratio + change)))
            for change in (0.0, REVERSALS.difference)
        )
        column = _column(effect, robot, data)
        slope = (_column(ahead, robot, data) - column) / REVERSALS.difference
        columns = np.column_stack([column, slope])
        force, change = fit.coefficients(columns)
        if not force > 0:
            break
        log_ratio += change / force
        log_ratio = np.clip(log_ratio, -REVERSALS.step, REVERSALS.step)
    std = fit.std(columns)[1] / max(force, 1e-300)
    return found._replace(effect=effect, column=column, std=std)


def _column(effect: Effect, robot: Robot, data: Data) -> Array:
    """Torque of an effect on one joint per unit, at all rows, shape (n,)."""
    [j] = effect.rows(robot)
    [columns] = effect_columns(robot, [effect], data.train)
    return columns.on(robot.nv)[:, j, 0]


class _LeftOut:
    """Errors of one joint's torque, (n,), by fits that leave out blocks of time.

    Columns, shape (n, u), one of which is replaced; rows used, (n,), are fitted, all are judged.
    """

    def __init__(self, X: Array, own: Mask, tau: Array, used: Mask) -> None:
        [self.own] = X[:, own].T
        self.tau = tau
        self.used = used
        norms = np.linalg.norm(X[used], axis=0)
        others = ~own & (norms > 0)
        unit = X[:, others] / norms[others]
        _, s, Vt = np.linalg.svd(np.linalg.qr(unit[used], mode="r"))
        shown = s > REVERSALS.rank * s.max(initial=0.0)
        self.basis = unit @ (Vt[: len(s)][shown].T / s[shown])
        self.blocks = np.array_split(np.arange(len(tau)), BLOCKS)

    def coefficients(self, columns: Array) -> Array:
        """Those of columns, shape (n, k), in place of its own in the fit to all rows, (k,)."""
        beyond = self._beyond(columns)[self.used]
        tau = self._beyond(self.tau)[self.used]
        x = np.linalg.lstsq(beyond, tau, rcond=REVERSALS.rank)[0]
        return np.asarray(x, float)

    def std(self, columns: Array) -> Array:
        """Their standard deviations, shape (k,)."""
        beyond = self._beyond(columns)[self.used]
        e = self._beyond(self.tau)[self.used] - beyond @ self.coefficients(columns)
        variance = (e**2).mean() * autocorrelation_time(e)
        G = np.linalg.pinv(beyond.T @ beyond, rcond=REVERSALS.rank, hermitian=True)
        return np.sqrt(variance * np.diag(G))

    def errors(self, column: Array) -> Array:
        """Errors with this column, shape (n,), in place of its own."""
        beyond = self._beyond(column)
        size = max(np.linalg.norm(beyond[self.used]), np.finfo(float).tiny)
        Q = np.column_stack([self.basis, beyond / size])
        counted = Q * self.used[:, None]
        residual = self.tau - Q @ (counted.T @ self.tau)
        whole = (1 + REVERSALS.rank) * np.eye(Q.shape[1])
        errors = []
        for block in self.blocks:
            others = whole - counted[block].T @ counted[block]
            score = counted[block].T @ residual[block]
            change = np.linalg.solve(others, score)
            errors.append(residual[block] + Q[block] @ change)
        return np.concatenate(errors)

    def _beyond(self, columns: Array) -> Array:
        """What of columns, shape (n, k) or (n,), the others do not fit at rows used."""
        return columns - self.basis @ (self.basis[self.used].T @ columns[self.used])


def turning_spread(rows: FitRows, fit: LeastSquares, covariance: Array) -> Array:
    """Change of all parameters by one standard deviation of log v of each joint, shape (p, k).

    The covariance of all parameters, (p, p), is that for v known exactly.
    """
    slopes = []
    beta = dict(zip(rows.base.columns, fit.beta, strict=True))
    for effect, columns in places_of(rows.robot, rows.effects):
        if not turning_speed(effect):
            continue
        speeds = turning_speed(effect) * np.exp([0.0, REVERSALS.difference])
        near = [turning(effect, v) for v in speeds.tolist()]
        less, more = effect_columns(rows.robot, near, rows.data.train)
        change = more.on(rows.robot.nv) - less.on(rows.robot.nv)
        slopes.append(change * beta[columns.start] / REVERSALS.difference)
    if not slopes:
        return np.zeros((len(covariance), 0))
    D = np.concatenate(slopes, axis=2)
    names = [f"log v {k + 1}" for k in range(len(slopes))]
    try:
        wider = weighted_least_squares(rows.reduced.with_columns(D, names))
        root = np.linalg.cholesky(wider.covariance[len(beta) :, len(beta) :])
    except (RankDeficient, np.linalg.LinAlgError):  # known to a step of the grid
        root = REVERSALS.step * np.eye(len(slopes))
    p = len(covariance)
    gram = rows.regression.with_columns(D, names).gram(fit.weight**2)
    return -covariance @ gram[:p, p:-1] @ root
