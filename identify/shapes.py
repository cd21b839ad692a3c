"""Shapes of effects, in which torque is not linear, refined together with everything else.

An effect is linear in its coefficients once its shape is fixed: the speed of Stribeck's bell, the
exponent of friction, the distance over which it builds up, the time in which a joint warms up, the
order of a ripple. Each shape is looked for on the effect's own grid first, by what its columns
explain beyond all others. Then bodies, coefficients θ and logarithms s of shapes minimise

    ‖R φ(π) + C(s) θ − z‖² + D(φ(π)) + Σ (θ_i / std_i)² + Σ (s_k − s̄_k)² / σ²

from the semidefinite fit on (`excitant.identify.log_cholesky`). Other shapes are taken where that
is lower by more than as many numbers take off it by chance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy

from excitant.exceptions import Infeasible, RankDeficient
from excitant.identify.knowledge import Knowledge
from excitant.identify.least_squares import LeastSquares, weighted_least_squares
from excitant.identify.log_cholesky import NonlinearEffects, refine_log_cholesky
from excitant.identify.physical import PhysicalFit, fit_physical
from excitant.identify.preprocessing import Segment
from excitant.identify.prior import EffectPrior
from excitant.identify.regression import regression_of
from excitant.identify.rows import FitRows
from excitant.robots.base_parameters import BaseParameters, base_parameters
from excitant.robots.effects import Effect, joint_facts
from excitant.robots.motion import Array, freeze

_CHANCE = 0.01  # that shapes change where the ones they had are right
_DECADE = float(np.log(10.0))  # σ: a shape is known to a factor of ten
_INSTANTS = 1500  # at most, evenly taken
_STEP = 1e-5  # of a shape, for its derivative


@dataclass(frozen=True)
class Shape:
    """One number of an effect that its torque is not linear in.

    Attributes:
        effect: Name of the effect.
        joint: The joint it acts on.
        field: What it is called there.
        unit: Its unit.
        given: What it was.
        value: What it is now.
        std: Standard deviation, from the logarithm's [unit].
    """

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

    Attributes:
        found: The shapes.
        effects: Effects with these shapes, in the order of their columns, without values.
        before: Objective with the shapes given.
        after: Objective with these.
        spread: How parameters of links and effects move with one standard deviation of each
            independent combination of shapes, shape (p, k).
    """

    found: tuple[Shape, ...]
    effects: tuple[Effect, ...]
    before: float
    after: float
    spread: Array

    def __post_init__(self) -> None:
        freeze(self, "spread")

    @property
    def better(self) -> bool:
        """Whether the objective falls by more than chance has it fall."""
        return self.before - self.after > float(scipy.stats.chi2.isf(_CHANCE, len(self.found)))

    @property
    def sentence(self) -> str:
        """What was found."""
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
            regression=columns.with_torque(rows.tau),
        )

    def widened(
        self, fit: LeastSquares, physical: PhysicalFit, base: BaseParameters
    ) -> tuple[LeastSquares, PhysicalFit]:
        """Fits with these shapes, their covariances those of shapes that are not known exactly."""
        moved = base.regrouping @ self.spread
        return (
            replace(fit, covariance=fit.covariance + moved @ moved.T),
            replace(physical, covariance=physical.covariance + self.spread @ self.spread.T),
        )


def refined_shapes(rows: FitRows, prior: Array, knowledge: Knowledge) -> Shapes | None:
    """Shapes that fit better together with bodies and coefficients; None where none can be found.

    Args:
        rows: What is fitted.
        prior: Standard parameters of the prior, shape (nv, 10).
        knowledge: What is known of the bodies; of no account while shapes are looked for.
    """
    effects = tuple(own for e in rows.effects for own in (e.singles() if e.tuned else [e]))
    if not any(effect.tuned for effect in effects):
        return None
    rows = replace(rows, effects=effects)
    try:
        first = _Shaped(rows, prior, knowledge).refined()
        if not first.better:
            return first
        # once more with the noise that is left then
        second = _Shaped(first.rows(rows), prior, knowledge).refined()
    except (RankDeficient, Infeasible):
        return None
    pairs = zip(second.found, first.found, strict=True)
    found = tuple(replace(new, given=old.given) for new, old in pairs)
    return replace(second, found=found, before=first.before, after=first.after)


class _Shaped:
    """The whitened problem with columns of effects for any shapes."""

    def __init__(self, rows: FitRows, prior: Array, knowledge: Knowledge) -> None:
        self.robot, self.effects, self.prior = rows.robot, rows.effects, prior
        self.segments: Sequence[Segment] = rows.data.train
        self.links = 10 * rows.robot.nv
        stride = -(-len(rows.regression) // _INSTANTS)
        self.some = slice(None, None, stride)
        fit = weighted_least_squares(rows.reduced)
        # a row that stands for many counts as many, as far as these are independent
        self.fit = replace(fit, inflation=np.maximum(fit.inflation / stride, 1.0))
        self.weight = self.fit.weight
        self.problem = rows.regression.at(self.some)
        W = self.problem.W
        self.R = (W * self.weight[:, None]).reshape(-1, W.shape[2])
        self.z = (self.problem.tau * self.weight).ravel()
        self.known, self.knowledge = rows.open_prior, knowledge
        self.facts = joint_facts([segment.motion for segment in self.segments])
        self.places = self._places()
        self.last: tuple[bytes, Array] = (b"", self.R)

    def _places(self) -> list[tuple[int, slice, str]]:
        """Each effect that has a shape, the columns of its coefficients, and the shape's name."""
        found, at = [], self.links
        for k, effect in enumerate(self.effects):
            count = len(effect.parameters(self.robot))
            if effect.tuned is not None:
                found.append((k, slice(at, at + count), effect.tuned.name))
            at += count
        return found

    def columns(self, effect: Effect) -> Array:
        """Whitened columns of an effect at the rows, shape (rows, k)."""
        parts = [s.rows(lambda motion: effect.columns(self.robot, motion)) for s in self.segments]
        found = np.concatenate(parts)[self.some] * self.weight[:, None]
        return np.asarray(found.reshape(len(self.z), -1), float)

    def refined(self) -> Shapes:
        """Best shapes of the grids, then all at once."""
        given = np.array([getattr(self.effects[k], name) for k, _, name in self.places])
        R, z = self.problem.factor(self.weight)
        start = fit_physical(
            R, z, self.prior, self.known, knowledge=self.knowledge, links=self.robot.links
        )
        count = len(given)
        mean = np.concatenate([self.known.mean, np.log(given)])
        std = np.concatenate([self.known.std, np.full(count, _DECADE)])
        lower = np.concatenate([self.known.lower, np.full(count, -np.inf)])
        best = self._on_grids()
        theta = np.concatenate([start.x[self.links :], np.log(best)])
        fit, objective = refine_log_cholesky(
            self.R[:, : self.links], self.z, self.prior,
            NonlinearEffects(self.torque, EffectPrior(mean, std, lower), theta, self.alone),
            start.x[: self.links].reshape(-1, 10),
        )  # fmt: skip
        at_given = np.concatenate([start.x, np.log(given)])
        return self._shapes(given, fit, objective(at_given), objective(fit.x))

    def _on_grids(self) -> Array:
        """Each shape as it is given or, where that explains more, from the effect's own grid."""
        best = []
        for k, place, name in self.places:
            effect = self.effects[k]
            others = np.delete(self.R, np.arange(place.start, place.stop), axis=1)
            live = others[:, (others != 0).any(axis=0)]
            Q = scipy.linalg.qr(live / np.linalg.norm(live, axis=0), mode="economic", pivoting=True)
            rank = int((np.abs(np.diag(Q[1])) > 1e-9 * abs(Q[1][0, 0])).sum())
            basis = Q[0][:, :rank]
            left = self.z - basis @ (basis.T @ self.z)
            shapes = [effect, *self._grid(effect)]
            gains = [self._explained(each, basis, left) for each in shapes]
            best.append(getattr(shapes[int(np.argmax(gains))], name))
        return np.array(best)

    def _grid(self, effect: Effect) -> list[Effect]:
        """Shapes that the effect itself proposes for what its joint does."""
        facts = self.facts[self.robot.joint_index(effect.joints[0])]
        return list(effect.candidates(effect.joints[0], facts)) if facts.moves else []

    def _explained(self, effect: Effect, basis: Array, left: Array) -> float:
        """Squared torque that an effect explains of what others leave; none of the wrong sign."""
        C = self.columns(effect)
        C = C - basis @ (basis.T @ C)
        theta = np.linalg.lstsq(C, left, rcond=1e-9)[0]
        lower = np.array([p.lower for p in effect.parameters(self.robot)])
        return (
            0.0 if (theta < lower).any() else float(left @ left - ((left - C @ theta) ** 2).sum())
        )

    def alone(self, theta: Array) -> Array:
        """Whitened torque of all effects."""
        values, columns = self._columns(theta)
        return np.asarray(columns @ values, float)

    def torque(self, theta: Array) -> tuple[Array, Array]:
        """The same and its slopes by coefficients and logarithms of shapes."""
        values, columns = self._columns(theta)
        slopes = np.empty((len(self.z), len(self.places)))
        for i, ((k, place, name), s) in enumerate(
            zip(self.places, theta[len(values) :], strict=True)
        ):
            own = slice(place.start - self.links, place.stop - self.links)
            moved = self.columns(self.effects[k].reshaped(name, float(np.exp(s + _STEP))))
            slopes[:, i] = (moved - columns[:, own]) @ values[own] / _STEP
        return columns @ values, np.hstack([columns, slopes])

    def _columns(self, theta: Array) -> tuple[Array, Array]:
        """Coefficients, and whitened columns of all effects in the shapes of θ."""
        count = len(theta) - len(self.places)
        if self.last[0] != theta[count:].tobytes():
            columns = self.R[:, self.links :].copy()
            for (k, place, name), s in zip(self.places, theta[count:], strict=True):
                own = slice(place.start - self.links, place.stop - self.links)
                columns[:, own] = self.columns(self.effects[k].reshaped(name, float(np.exp(s))))
            self.last = theta[count:].tobytes(), columns
        return theta[:count], self.last[1]

    def _shapes(self, given: Array, fit: PhysicalFit, before: float, after: float) -> Shapes:
        """The result; shapes as they are given where others are no better."""
        count = len(given)
        p = len(fit.x) - count
        C = fit.covariance
        values, std = np.exp(fit.x[p:]), np.sqrt(np.diag(C)[p:])
        # the part of the parameters' covariance that comes from that of the shapes
        root = np.linalg.cholesky(C[p:, p:])
        spread = scipy.linalg.solve_triangular(root, C[:p, p:].T, lower=True).T
        effects = list(self.effects)
        found = []
        for (k, _, name), old, new, s in zip(self.places, given, values, std, strict=True):
            shape = effects[k].tuned
            assert shape is not None
            effects[k] = effects[k].reshaped(name, float(new))
            entry = effects[k].name, effects[k].joints[0], name, shape.unit
            found.append(Shape(*entry, float(old), float(new), float(new * s)))
        return Shapes(tuple(found), tuple(effects), before, after, spread)
