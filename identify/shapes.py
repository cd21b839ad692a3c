"""Shapes of effects, in which torque is not linear, refined together with everything else.

An effect is linear in its coefficients once its shape is fixed: the speed of Stribeck's bell, the
exponent of friction, the distance over which it builds up, the time in which a joint warms up, the
order of a ripple. Each shape is looked for on the effect's own grid first, by what its columns
explain beyond all others. Then bodies π, coefficients and logarithms of shapes, together θ, descend
on

    ‖R φ(π) + τ(θ) − z‖² + D(φ(π)) + Σ_i (θ_i − θ̄_i)² / s_i²,   θ ≥ bounds,

D the pull-back distance of `excitant.identify.physical`. Every body is written by ten free numbers
π = (α, d, s, t) (log-Cholesky: Rucker and Wensing 2022): its pseudo-inertia is

    P = U Uᵀ,   U = e^α [[e^d₁, s₁₂, s₁₃, t₁], [0, e^d₂, s₂₃, t₂], [0, 0, e^d₃, t₃], [0, 0, 0, 1]],

which is positive definite for all of them and reaches every P ≻ 0 exactly once. Where only an
impossible body fits the data, its numbers diverge while the objective settles: that is accepted.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin
import scipy

from excitant.exceptions import BadInput, Infeasible, RankDeficient
from excitant.identify.knowledge import Knowledge
from excitant.identify.least_squares import LeastSquares, weighted_least_squares
from excitant.identify.physical import PhysicalFit, fit_physical
from excitant.identify.prior import BodyPrior, EffectPrior
from excitant.identify.regression import regression_of
from excitant.identify.rows import FitRows
from excitant.identify.signals import live
from excitant.robots.base_parameters import BaseParameters, base_parameters
from excitant.robots.effects import Effect, joint_facts
from excitant.robots.motion import Array, read_only
from excitant.robots.parameters import pseudo_inertia

_CHANCE = 0.01  # that shapes change where the ones they had are right
_DECADE = float(np.log(10.0))  # σ: a shape is known to a factor of ten
_INSTANTS = 1500  # at most, evenly taken
_STEP = 1e-5  # of a shape, for its derivative
_EVALUATIONS = 60  # of the descent
_TOLERANCE = 1e-5  # where no minimum is demanded
_OFF = ((0, 1), (1, 2), (0, 2))  # s₁₂, s₂₃, s₁₃, the order of Rucker and Wensing


@dataclass(frozen=True)
class Shape:
    """One number, a field, of an effect on a joint that its torque is not linear in."""

    effect: str
    joint: str
    field: str
    unit: str
    given: float
    value: float
    std: float


@dataclass(frozen=True, eq=False)
class Shapes:
    """Shapes of all effects that have one, each joint with its own.

    Effects carry them, in the order of their columns, without values; the objective was before and
    is after. Spread: how all parameters move with one standard deviation of each independent
    combination of shapes, shape (p, k).
    """

    found: tuple[Shape, ...]
    effects: tuple[Effect, ...]
    before: float
    after: float
    spread: Array

    @property
    def better(self) -> bool:
        """Whether the objective falls by more than chance has it fall."""
        return self.before - self.after > float(
            scipy.special.chdtri(len(self.found), _CHANCE)
        )

    @property
    def sentence(self) -> str:
        """Summary in words."""
        fall = f"misfit with its prior {self.before:.4g} → {self.after:.4g}"
        if not self.better:
            return f"shapes of effects are those given: no others fit better beyond chance ({fall})"
        each = ", ".join(
            f"{s.joint} {s.effect.replace('_', ' ')} {s.field} {s.value:.3g} ± {s.std:.2g}"
            f"{f' {s.unit}' if s.unit != '1' else ''}"
            for s in self.found
        )
        return f"shapes of effects refined together with bodies and coefficients: {each}; {fall}"

    def entry(self) -> dict[str, Any]:
        """As an entry of result.json."""
        return {
            "refined": self.better,
            "objective": {"given": self.before, "refined": self.after},
            "effects": [dict(vars(each)) for each in self.found],
        }

    def rows(self, rows: FitRows) -> FitRows:
        """The rows with columns of these shapes."""
        columns = regression_of(rows.robot, self.effects, rows.data.train)
        return replace(
            rows,
            effects=self.effects,
            base=base_parameters(rows.robot, self.effects),
            regression=rows.fitting(columns),
        )

    def widened(
        self, fit: LeastSquares, physical: PhysicalFit, base: BaseParameters
    ) -> tuple[LeastSquares, PhysicalFit]:
        """Fits with these shapes, their covariances those of shapes that are not known exactly."""
        moved = base.regrouping @ self.spread
        return (
            replace(fit, covariance=fit.covariance + moved @ moved.T),
            replace(
                physical, covariance=physical.covariance + self.spread @ self.spread.T
            ),
        )


def refined_shapes(rows: FitRows, prior: Array, knowledge: Knowledge) -> Shapes | None:
    """Shapes that fit better together with bodies and coefficients; None where none can be found.

    The prior has shape (nv, 10). What is known of the bodies is of no account in the descent.
    """
    effects = tuple(
        own for e in rows.effects for own in (e.singles() if e.search.tuned else [e])
    )
    if not any(effect.search.tuned for effect in effects):
        return None
    rows = replace(rows, effects=effects)
    try:
        first = _Search(rows).refined(prior, knowledge)
        if not first.better:
            return first
        # once more with the noise that is left then
        second = _Search(first.rows(rows)).refined(prior, knowledge)
    except (RankDeficient, Infeasible, np.linalg.LinAlgError):
        return None
    pairs = zip(second.found, first.found, strict=True)
    found = tuple(replace(new, given=old.given) for new, old in pairs)
    return replace(second, found=found, before=first.before, after=first.after)


class _Search:
    """The whitened problem with columns of effects for any shapes."""

    def __init__(self, rows: FitRows) -> None:
        self.fitted = rows
        self.robot = rows.robot
        self.effects = rows.effects
        self.links = 10 * rows.robot.nv
        stride = -(-len(rows.regression) // _INSTANTS)
        self.some = slice(None, None, stride)
        fit = weighted_least_squares(rows.reduced)
        # a row that stands for many counts as many, as far as these are independent
        self.weight = replace(
            fit, inflation=np.maximum(fit.inflation / stride, 1.0)
        ).weight
        self.problem = rows.regression.at(self.some)
        W = self.problem.W
        self.R = (W * self.weight[:, None]).reshape(-1, W.shape[2])
        self.z = (self.problem.tau * self.weight).ravel()
        # effects that have a shape: their index, the columns of their coefficients, the shape
        self.places: list[tuple[int, slice, str]] = []
        at = 0
        for k, effect in enumerate(self.effects):
            count = len(effect.parameters(self.robot))
            if effect.search.tuned is not None:
                self.places.append((k, slice(at, at + count), effect.search.tuned.name))
            at += count
        self.last: tuple[bytes, Array] = (b"", self.R[:, self.links :])

    def columns(self, effect: Effect) -> Array:
        """Whitened columns of an effect at the rows, shape (rows, k)."""
        segments = self.fitted.data.train
        parts = [
            s.rows(lambda motion: effect.columns(self.robot, motion)) for s in segments
        ]
        found = np.concatenate(parts) * self.fitted.used[:, :, None]
        found = found[self.some] * self.weight[:, None]
        return np.asarray(found.reshape(len(self.z), -1), float)

    def refined(self, prior: Array, knowledge: Knowledge) -> Shapes:
        """Best shapes of the grids, then all at once."""
        given = np.array([getattr(self.effects[k], name) for k, _, name in self.places])
        open_prior = self.fitted.open_prior
        links = self.robot.links
        R, z = self.problem.factor(self.weight)
        start = fit_physical(R, z, prior, open_prior, knowledge=knowledge, links=links)
        known = EffectPrior(
            np.concatenate([open_prior.mean, np.log(given)]),
            np.concatenate([open_prior.std, np.full(len(given), _DECADE)]),
            np.concatenate([open_prior.lower, np.full(len(given), -np.inf)]),
        )
        columns = self.R[:, : self.links]
        descent = Descent(columns, self.z, start.prior, known, self.torque, self.slopes)
        theta = np.concatenate([start.x[self.links :], np.log(self._on_grids())])
        x, covariance = descent.fit(start.x[: self.links].reshape(-1, 10), theta)
        before = descent.objective(np.concatenate([start.x, np.log(given)]))
        return self._shapes(given, x, covariance, before, descent.objective(x))

    def _on_grids(self) -> Array:
        """Each shape as it is given or, where that explains more, from the effect's own grid."""
        best = []
        facts = joint_facts([segment.motion for segment in self.fitted.data.train])
        for k, place, name in self.places:
            effect = self.effects[k]
            joint = self.effects[k].joints[0]
            own = np.arange(place.start, place.stop) + self.links
            others = np.delete(self.R, own, axis=1)
            others = others[:, live(others)]
            unit = others / np.linalg.norm(others, axis=0)
            Q = scipy.linalg.qr(unit, mode="economic", pivoting=True)
            rank = int((np.abs(np.diag(Q[1])) > 1e-9 * abs(Q[1][0, 0])).sum())
            basis = Q[0][:, :rank]
            left = self.z - basis @ (basis.T @ self.z)
            fact = facts[self.robot.joint_index(joint)]
            usual = type(effect)((joint,))
            grid = effect.search.candidates(usual, fact) if fact.moves else []
            shapes = [effect, *grid]
            gains = [self._explained(each, basis, left) for each in shapes]
            best.append(getattr(shapes[int(np.argmax(gains))], name))
        return np.array(best)

    def _explained(self, effect: Effect, basis: Array, left: Array) -> float:
        """Squared torque that an effect explains of what others leave; none of the wrong sign."""
        C = self.columns(effect)
        C = C - basis @ (basis.T @ C)
        theta = np.linalg.lstsq(C, left, rcond=1e-9)[0]
        lower = np.array([p.lower for p in effect.parameters(self.robot)])
        if (theta < lower).any():
            return 0.0
        return float(left @ left - ((left - C @ theta) ** 2).sum())

    def torque(self, theta: Array) -> Array:
        """Whitened torque of all effects."""
        values, columns = self._columns(theta)
        return np.asarray(columns @ values, float)

    def slopes(self, theta: Array) -> Array:
        """Its slopes by coefficients and logarithms of shapes."""
        values, columns = self._columns(theta)
        further = []
        for (k, own, name), s in zip(self.places, theta[len(values) :], strict=True):
            moved = self.columns(
                self.effects[k].reshaped(name, float(np.exp(s + _STEP)))
            )
            further.append((moved - columns[:, own]) @ values[own] / _STEP)
        return np.column_stack([columns, *further])

    def _columns(self, theta: Array) -> tuple[Array, Array]:
        """Coefficients, and whitened columns of all effects in the shapes of θ."""
        count = len(theta) - len(self.places)
        if self.last[0] != theta[count:].tobytes():
            columns = self.R[:, self.links :].copy()
            for (k, own, name), s in zip(self.places, theta[count:], strict=True):
                columns[:, own] = self.columns(
                    self.effects[k].reshaped(name, float(np.exp(s)))
                )
            self.last = theta[count:].tobytes(), columns
        return theta[:count], self.last[1]

    def _shapes(
        self, given: Array, x: Array, C: Array, before: float, after: float
    ) -> Shapes:
        """The result of a descent to x with covariance C."""
        p = len(x) - len(given)
        values = np.exp(x[p:])
        std = np.sqrt(np.diag(C)[p:])
        # the part of the parameters' covariance that comes from that of the shapes
        root = np.linalg.cholesky(C[p:, p:])
        spread = scipy.linalg.solve_triangular(root, C[:p, p:].T, lower=True).T
        effects = list(self.effects)
        found = []
        for (k, _, name), old, new, s in zip(
            self.places, given, values, std, strict=True
        ):
            shape = effects[k].search.tuned
            assert shape is not None
            effects[k] = effects[k].reshaped(name, float(new))
            unit = effects[k].shape_unit(self.robot, shape)
            entry = effects[k].name, effects[k].joints[0], name, unit
            found.append(Shape(*entry, float(old), float(new), float(new * s)))
        return Shapes(tuple(found), tuple(effects), before, after, read_only(spread))


def from_log_cholesky(numbers: Array) -> tuple[Array, Array]:
    """Standard parameters of (α, d₁, d₂, d₃, s₁₂, s₂₃, s₁₃, t₁, t₂, t₃), and Jacobian (10, 10)."""
    body = pin.LogCholeskyParameters(np.array(numbers, float))
    return np.asarray(body.toDynamicParameters()), np.asarray(body.calculateJacobian())


def to_log_cholesky(phi: Array) -> Array:
    """The ten numbers of a consistent body with standard parameters φ, shape (10,).

    Raises:
        BadInput: No body of positive density has them.
    """
    try:
        flip = np.linalg.cholesky(pseudo_inertia(phi)[::-1, ::-1])
    except np.linalg.LinAlgError:
        raise BadInput(
            "log-Cholesky: parameters that no body of positive density has"
        ) from None
    U = flip[::-1, ::-1]  # upper triangular with U Uᵀ = P
    unit = U / U[3, 3]
    off = [unit[k] for k in _OFF]
    return np.array([np.log(U[3, 3]), *np.log(np.diag(unit)[:3]), *off, *unit[:3, 3]])


@dataclass(frozen=True, eq=False)
class Descent:
    """The fit of bodies and θ where the torque of effects is any function of θ, shape (k,).

    R holds the whitened columns of the links, (m, 10 links), z the torque, (m,); torque
    and slopes are those of effects at θ, (m,) and (m, k), whitened.
    """

    R: Array
    z: Array
    prior: BodyPrior
    known: EffectPrior
    torque: Callable[[Array], Array]
    slopes: Callable[[Array], Array]

    def fit(
        self, bodies: Array, theta: Array, tolerance: float = _TOLERANCE
    ) -> tuple[Array, Array]:
        """Descend from consistent bodies, (links, 10), and θ until the objective settles.

        Returns:
            Standard parameters and θ where both and the objective change relatively by less than
            the tolerance, shape (10 links + k,), and their Gauss-Newton covariance.

        Raises:
            BadInput: Impossible bodies.
        """
        lower = self.known.lower
        theta = np.where(theta > lower, theta, lower + 1e-3 * np.abs(self.known.std))
        numbers = np.concatenate(
            [*(to_log_cholesky(values) for values in bodies), theta]
        )
        bounds = np.concatenate([np.full(self.prior.bodies.size, -np.inf), lower])
        with np.errstate(
            over="ignore", invalid="ignore"
        ):  # steps too long are taken back
            found = scipy.optimize.least_squares(
                self.residual,
                numbers,
                self.jacobian,
                bounds=(bounds, np.inf),
                x_scale="jac",
                ftol=tolerance,
                xtol=tolerance,
                gtol=tolerance,
                max_nfev=_EVALUATIONS,
            )
        phi, theta = self._split(np.asarray(found.x, float))
        factor = np.linalg.qr(self._rows(self.prior.quadratic(phi)[1], theta), mode="r")
        inverse = scipy.linalg.solve_triangular(factor, np.eye(len(factor)))
        return np.concatenate([phi, theta]), inverse @ inverse.T

    def objective(self, x: Array) -> float:
        """The objective at standard parameters and θ, shape (10 links + k,)."""
        return float(
            (
                self._misfit(x[: self.prior.bodies.size], x[self.prior.bodies.size :])
                ** 2
            ).sum()
        )

    def residual(self, numbers: Array) -> Array:
        """Of data, prior of the links, prior of the effects, at (π, θ)."""
        return self._misfit(*self._split(numbers))

    def jacobian(self, numbers: Array) -> Array:
        """Jacobian of the residual by (π, θ)."""
        size = self.prior.bodies.size
        phi, theta = self._split(numbers)
        J = self._rows(self.prior.slopes(phi), theta)
        blocks = [from_log_cholesky(each)[1] for each in numbers[:size].reshape(-1, 10)]
        return np.hstack([J[:, :size] @ scipy.linalg.block_diag(*blocks), J[:, size:]])

    def _split(self, numbers: Array) -> tuple[Array, Array]:
        """Standard parameters and θ of (π, θ)."""
        size = self.prior.bodies.size
        phi = [from_log_cholesky(each)[0] for each in numbers[:size].reshape(-1, 10)]
        return np.concatenate(phi), numbers[size:]

    def _misfit(self, phi: Array, theta: Array) -> Array:
        data = self.R @ phi + self.torque(theta) - self.z
        known = (theta - self.known.mean) / self.known.std
        return np.concatenate([data, self.prior.residual(phi), known])

    def _rows(self, slopes: Array, theta: Array) -> Array:
        """Jacobian of the residual by (φ, θ), shape (rows, p), with that of the prior bodies."""
        prior = scipy.linalg.block_diag(slopes, np.diag(1 / self.known.std))
        return np.vstack([np.hstack([self.R, self.slopes(theta)]), prior])
