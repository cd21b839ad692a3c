"""Shapes of effects, in which torque is not linear, refined together with everything else.

An effect is linear in its coefficients once its shape is fixed: the speed of Stribeck's bell, the
exponent of friction, the distance over which it builds up, the time in which a joint warms up, the
order of a ripple. Each shape is looked for on the effect's own grid first, by what its columns
explain beyond all others. Then bodies φ, coefficients and logarithms of shapes, θ, minimise

    ‖R φ + τ(θ) − z‖² − 2 log p(φ) + Σ_i (θ_i − θ̄_i)² / s_i²,   θ ≥ bounds,

p the prior density of `excitant.identify.prior`. τ(θ) is linearised where the last step ended
(Gauss and Newton), which leaves the semidefinite fit of `excitant.identify.physical`; a step is
halved until the objective falls.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy

from excitant.exceptions import Infeasible, RankDeficient
from excitant.identify.knowledge import Knowledge
from excitant.identify.least_squares import LeastSquares, weighted_least_squares
from excitant.identify.physical import PhysicalFit, fit_physical
from excitant.identify.prior import BodyPrior, EffectPrior
from excitant.identify.regression import regression_of, triangle
from excitant.identify.rows import FitRows, places_of
from excitant.identify.signals import live
from excitant.robots.base_parameters import BaseParameters, base_parameters
from excitant.robots.effects import Effect, joint_facts
from excitant.robots.motion import Array, read_only


@dataclass(frozen=True)
class Refinement:
    """Settings of the search.

    Attributes:
        false_alarm: Probability that shapes change where the nominal ones are right.
        shape_std: Prior std of the logarithm of a shape: a factor of ten.
        instants: Largest number of instants, evenly taken.
        difference: Step of the logarithm of a shape for its derivative.
        rank: Singular value relative to the largest, below which columns are dependent.
        rounds: Largest number of Gauss-Newton steps.
        settled: Relative fall of the objective below which the search ends.
        shortest: Least share of a step that is tried.
    """

    false_alarm: float = 0.01
    shape_std: float = float(np.log(10.0))
    instants: int = 1500
    difference: float = 1e-5
    rank: float = 1e-9
    rounds: int = 30
    settled: float = 1e-5
    shortest: float = 1e-3


REFINEMENT = Refinement()


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

    @property
    def words(self) -> str:
        """Where it is, value and standard deviation."""
        unit = "" if self.unit == "1" else f" {self.unit}"
        effect = self.effect.replace("_", " ")
        value = f"{self.value:.3g} ± {self.std:.2g}{unit}"
        return f"{self.joint} {effect} {self.field} {value}"


@dataclass(frozen=True, eq=False)
class Shapes:
    """Shapes of all effects that have one, each joint with its own.

    Attributes:
        refined: The shapes at the minimum.
        effects: All effects with these shapes, in the order of their columns, without values.
        before: The objective with nominal shapes.
        after: The objective at its minimum.
        spread: Change of all parameters by one standard deviation of each independent combination
            of shapes, shape (p, k).
    """

    refined: tuple[Shape, ...]
    effects: tuple[Effect, ...]
    before: float
    after: float
    spread: Array

    @property
    def better(self) -> bool:
        """Whether the objective falls by more than chance has it fall (likelihood ratio)."""
        chance = scipy.special.chdtri(len(self.refined), REFINEMENT.false_alarm)
        return self.before - self.after > float(chance)

    @property
    def sentence(self) -> str:
        """Summary in words."""
        fall = f"misfit with its prior {self.before:.4g} → {self.after:.4g}"
        if not self.better:
            return f"shapes of effects are those given: no others fit better beyond chance ({fall})"
        listed = ", ".join(shape.words for shape in self.refined)
        return f"shapes of effects refined together with bodies and coefficients: {listed}; {fall}"

    def entry(self) -> dict[str, Any]:
        """As an entry of result.json."""
        return {
            "refined": self.better,
            "effects": [dict(vars(shape)) for shape in self.refined],
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
    fit: LeastSquares, physical: PhysicalFit, base: BaseParameters, spread: Array
) -> tuple[LeastSquares, PhysicalFit]:
    """Fits with shapes that are not known exactly: covariances hold those of the shapes.

    Spread is the change of all parameters by one standard deviation of each, shape (p, k).
    """
    of_base = base.regrouping @ spread
    covariance = physical.covariance + spread @ spread.T
    return (
        replace(fit, covariance=fit.covariance + of_base @ of_base.T),
        replace(physical, covariance=covariance),
    )


def refined_shapes(
    rows: FitRows, prior: Array, knowledge: Knowledge
) -> Shapes | None:
    """Shapes that fit better together with bodies and coefficients; None where none can be found.

    The prior has shape (nv, 10). Knowledge of the bodies counts at the nominal shapes only.
    """
    effects = list[Effect]()
    for effect in rows.effects:
        effects += effect.singles() if effect.search.tuned else [effect]
    if not any(effect.search.tuned for effect in effects):
        return None
    rows = replace(rows, effects=tuple(effects))
    try:
        first = _Search(rows).refined(prior, knowledge)
        if not first.better:
            return first
        # once more with the noise that remains then
        second = _Search(first.rows(rows)).refined(prior, knowledge)
    except (RankDeficient, Infeasible, np.linalg.LinAlgError):
        return None
    pairs = zip(second.refined, first.refined, strict=True)
    refined = tuple(replace(new, given=old.given) for new, old in pairs)
    return replace(second, refined=refined, before=first.before, after=first.after)


@dataclass(frozen=True)
class _Place:
    """An effect with a shape: its position among all, its columns, the field."""

    effect: int
    columns: slice
    field: str


class _Search:
    """The whitened problem with columns of effects for any shapes."""

    def __init__(self, rows: FitRows) -> None:
        self.fitted = rows
        self.robot = rows.robot
        self.effects = rows.effects
        self.links = 10 * rows.robot.nv
        stride = -(-len(rows.regression) // REFINEMENT.instants)
        self.instants = slice(None, None, stride)
        fit = weighted_least_squares(rows.reduced)
        # a row that stands for many counts as many, as far as these are independent
        inflation = np.maximum(fit.inflation / stride, 1.0)
        self.weight = replace(fit, inflation=inflation).weight
        self.problem = rows.regression.at(self.instants)
        weighted = self.problem.W * self.weight[:, None]
        self.R = weighted.reshape(-1, self.problem.p)
        self.z = (self.problem.tau * self.weight).ravel()
        self.places = [
            _Place(k, own, effect.search.tuned.name)
            for k, (effect, own) in enumerate(places_of(rows.robot, rows.effects))
            if effect.search.tuned is not None
        ]

    def columns(self, effect: Effect) -> Array:
        """Whitened columns of an effect at the rows, shape (rows, k)."""
        segments = self.fitted.data.train
        parts = [
            s.rows(lambda motion: effect.columns(self.robot, motion))
            for s in segments
        ]
        columns = np.concatenate(parts) * self.fitted.used[:, :, None]
        weighted = columns[self.instants] * self.weight[:, None]
        return weighted.reshape(len(self.z), -1)

    def refined(self, prior: Array, knowledge: Knowledge) -> Shapes:
        """Best shapes of the grids, then all at once."""
        nominal = np.array(
            [getattr(self.effects[p.effect], p.field) for p in self.places]
        )
        coefficients = self.fitted.open_prior
        links = self.robot.links
        R, z = self.problem.factor(self.weight)
        start = fit_physical(
            R, z, prior, coefficients, knowledge=knowledge, links=links
        )
        count = len(nominal)
        spread = np.full(count, REFINEMENT.shape_std)
        known = EffectPrior(
            mean=np.concatenate([coefficients.mean, np.log(nominal)]),
            std=np.concatenate([coefficients.std, spread]),
            lower=np.concatenate([coefficients.lower, np.full(count, -np.inf)]),
        )
        before = self._objective(
            np.concatenate([start.x, np.log(nominal)]), start.prior, known
        )
        shapes = np.log(self._on_grids())
        columns = self._all_columns(shapes)
        R, z = _factor(columns, self.z)
        fit = fit_physical(R, z, start.prior, coefficients)
        x, covariance, after = self._descended(
            np.concatenate([fit.x, shapes]), start.prior, known
        )
        return self._shapes(nominal, x, covariance, before, after)

    def _on_grids(self) -> Array:
        """Each shape as it is given or, where that explains more, from the effect's own grid."""
        best = []
        facts = joint_facts([segment.motion for segment in self.fitted.data.train])
        for place in self.places:
            effect = self.effects[place.effect]
            others = np.delete(self.R, place.columns, axis=1)
            others = others[:, live(others)]
            unit = others / np.linalg.norm(others, axis=0)
            Q, R, _ = scipy.linalg.qr(unit, mode="economic", pivoting=True)
            size = np.abs(np.diag(R))
            basis = Q[:, : int((size > REFINEMENT.rank * size[0]).sum())]
            residual = self.z - basis @ (basis.T @ self.z)
            [joint] = effect.joints
            fact = facts[self.robot.joint_index(joint)]
            usual = type(effect)((joint,))
            grid = effect.search.candidates(usual, fact) if fact.moves else []
            shapes = [effect, *grid]
            gains = [self._explained(shape, basis, residual) for shape in shapes]
            best.append(getattr(shapes[np.argmax(gains)], place.field))
        return np.array(best)

    def _explained(self, effect: Effect, basis: Array, residual: Array) -> float:
        """Squared torque of an effect in the residual of all others; 0 with a wrong sign."""
        columns = self.columns(effect)
        C = columns - basis @ (basis.T @ columns)
        theta = np.linalg.lstsq(C, residual, rcond=REFINEMENT.rank)[0]
        lower = np.array([p.lower for p in effect.parameters(self.robot)])
        if (theta < lower).any():
            return 0.0
        return residual @ residual - ((residual - C @ theta) ** 2).sum()

    def _shaped(self, place: _Place, log_shape: float) -> Array:
        """Whitened columns of an effect with a shape."""
        effect = self.effects[place.effect]
        return self.columns(effect.reshaped(place.field, float(np.exp(log_shape))))

    def _all_columns(self, log_shapes: Array) -> Array:
        """Whitened columns of links and effects with these shapes, shape (rows, p)."""
        columns = self.R.copy()
        for place, log_shape in zip(self.places, log_shapes, strict=True):
            columns[:, place.columns] = self._shaped(place, log_shape)
        return columns

    def _objective(self, x: Array, prior: BodyPrior, known: EffectPrior) -> float:
        """The objective at standard parameters and θ, shape (p + shapes,)."""
        p = self.R.shape[1]
        misfit = self._all_columns(x[p:]) @ x[:p] - self.z
        deviation = (x[self.links :] - known.mean) / known.std
        bodies = prior.surprise(x[: self.links])
        return float(misfit @ misfit + bodies + deviation @ deviation)

    def _descended(
        self, x: Array, prior: BodyPrior, known: EffectPrior
    ) -> tuple[Array, Array, float]:
        """Minimiser, its covariance and the objective there, from parameters and θ on."""
        p = self.R.shape[1]
        objective = self._objective(x, prior, known)
        for _ in range(REFINEMENT.rounds):
            columns = self._all_columns(x[p:])
            slopes = []
            for place, log_shape in zip(self.places, x[p:], strict=True):
                own = place.columns
                ahead = self._shaped(place, log_shape + REFINEMENT.difference)
                change = (ahead - columns[:, own]) @ x[own]
                slopes.append(change / REFINEMENT.difference)
            J = np.column_stack([columns, *slopes])
            R, z = _factor(J, self.z + J[:, p:] @ x[p:])
            fit = fit_physical(R, z, prior, known)
            length = 1.0
            while length > REFINEMENT.shortest:
                moved = x + length * (fit.x - x)
                value = self._objective(moved, prior, known)
                if value < objective:
                    break
                length /= 2
            else:
                break
            fall = objective - value
            x = moved
            objective = value
            if fall <= REFINEMENT.settled * objective:
                break
        return x, fit.covariance, objective

    def _shapes(
        self, nominal: Array, x: Array, C: Array, before: float, after: float
    ) -> Shapes:
        """The result of a descent to x with covariance C."""
        p = self.R.shape[1]
        values = np.exp(x[p:])
        stds = values * np.sqrt(np.diag(C)[p:])
        # the part of the parameters' covariance that comes from that of the shapes
        root = np.linalg.cholesky(C[p:, p:])
        spread = scipy.linalg.solve_triangular(root, C[:p, p:].T, lower=True).T
        effects = list(self.effects)
        refined = []
        columns = (nominal.tolist(), values.tolist(), stds.tolist())
        for place, *numbers in zip(self.places, *columns, strict=True):
            effect = effects[place.effect]
            tuned = effect.search.tuned
            assert tuned is not None
            unit = effect.shape_unit(self.robot, tuned)
            shape = Shape(
                effect.name, effect.joints[0], place.field, unit, *numbers
            )
            effects[place.effect] = effect.reshaped(place.field, shape.value)
            refined.append(shape)
        return Shapes(
            tuple(refined), tuple(effects), before, after, read_only(spread)
        )


def _factor(A: Array, z: Array) -> tuple[Array, Array]:
    """R and its right side, ‖R x − ·‖² + constant = ‖A x − z‖²."""
    R = triangle(np.column_stack([A, z]))
    return R[:, :-1], R[:, -1]
