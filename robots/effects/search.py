"""Which effects an arm may have: shapes to consider, and coefficients that can be."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from excitant.robots.motion import Array, Motion, root_mean_square, together

if TYPE_CHECKING:
    from excitant.robots.effects.base import Effect
    from excitant.robots.robot import Robot

REST_SPEED = 1e-3  # rad/s or m/s: slower joints rest
BOUND_STDS = (
    2.0  # standard deviations by which a value may violate a physical bound
)
REVERSAL_STDS = 4.0  # standard deviations of position noise that hide a reversal
TRIAL_RATIOS = (0.3, 2.5)  # of a trial value, for which its columns hold
MOST_OF_TYPICAL = 2.0  # largest coefficient relative to its typical size
SHAPE_RATIOS = (0.25, 0.5, 1.0, 2.0, 4.0)  # alternatives to a shape that was fitted

Stage = Literal["standard", "usual", "further", "diagnosis"]


@dataclass(frozen=True, eq=False)
class JointFacts:
    """Statistics of one joint in recordings, which choose and scale the shapes of effects.

    Attributes:
        speed: Highest speed [rad/s or m/s].
        reach: Range of positions [rad or m].
        start: First instant [s].
        duration: Of all recordings, from first to last instant [s].
        blur: Travel about a reversal that sampling and filter hide [rad or m].
        speed_blur: Speeds about a reversal that they hide [rad/s or m/s].
        load: Largest torque [N·m].
        q: Positions at the rows of ``unexplained``, shape (n,).
        dq: Velocities there, shape (n,).
        unexplained: Residual torque of a model, shape (n,) [N·m].
        cutoff_hz: Cut-off of the filter that this torque has passed [Hz].
    """

    speed: float = np.inf
    reach: float = np.inf
    start: float = 0.0
    duration: float = np.inf
    blur: float = 0.0
    speed_blur: float = 0.0
    load: float = np.inf
    q: Array = field(default_factory=lambda: np.zeros(0))
    dq: Array = field(default_factory=lambda: np.zeros(0))
    unexplained: Array = field(default_factory=lambda: np.zeros(0))
    cutoff_hz: float = np.inf

    @property
    def moves(self) -> bool:
        """Whether the joint is ever faster than at rest."""
        return self.speed > REST_SPEED


def joint_facts(
    motions: Sequence[Motion],
    rows: Sequence[slice] = (),
    unexplained: Array | None = None,
    cutoff_hz: float = np.inf,
    noise: Array | float = 0.0,
    load: Array | float = np.inf,
) -> tuple[JointFacts, ...]:
    """Statistics of each joint in recordings, with the residual torque of a model at some rows.

    Noise is a density of the positions, (nv,) [rad²/Hz or m²/Hz]; ``load`` the largest torque of
    each joint, (nv,) [N·m].
    """
    states = together(motions)
    start = min(float(motion.t[0]) for motion in motions)
    duration = max(float(motion.t[-1]) for motion in motions) - start
    hidden_time = max(float(motion.t[1] - motion.t[0]) for motion in motions)
    band = 0.0
    if cutoff_hz < np.inf:  # positions pass twice the cut-off
        band = 2 * cutoff_hz
        hidden_time += 1 / (2 * np.pi * band)
    acceleration = root_mean_square(states.ddq)
    blur = acceleration * hidden_time**2 / 2 + REVERSAL_STDS * np.sqrt(noise * band)
    speed = np.abs(states.dq).max(axis=0)
    reach = np.ptp(states.q, axis=0)
    hidden = acceleration * hidden_time
    most = np.broadcast_to(load, speed.shape)
    facts = tuple(
        JointFacts(s, r, start, duration, b, h, m)
        for s, r, b, h, m in np.column_stack(
            [speed, reach, blur, hidden, most]
        ).tolist()
    )
    if unexplained is None:
        return facts
    parts = zip(motions, rows, strict=True)
    states = together([motion[part] for motion, part in parts])
    return tuple(
        replace(
            facts[j],
            q=states.q[:, j],
            dq=states.dq[:, j],
            unexplained=unexplained[:, j],
            cutoff_hz=cutoff_hz,
        )
        for j in range(len(facts))
    )


@dataclass(frozen=True)
class Shape:
    """A field of an effect in which torque is not linear.

    Attributes:
        name: Name of the field.
        unit: Its unit at a turning joint.
        positive: Whether it must be positive; then a fit may refine it.
        trial: Whether it is the value of the first coefficient for which columns are computed.
        grid: Values to consider at a joint.
        most: Largest value at which the effect is not another; without it the grid is all.
        least: Smallest value that recordings tell from zero.
    """

    name: str
    unit: str
    positive: bool = True
    trial: bool = False
    grid: Callable[[JointFacts], Iterable[float]] | None = None
    most: Callable[[JointFacts], float] | None = None
    least: Callable[[JointFacts], float] = lambda facts: -np.inf


def on_grid(effect: Effect, facts: JointFacts) -> list[Effect]:
    """An effect in the shapes of its grid, or as it is without one."""
    for shape in effect.search.shapes:
        if shape.grid is not None:
            least = shape.least(facts)
            values = [float(v) for v in shape.grid(facts) if v >= least]
            return [effect.reshaped(shape.name, value) for value in values]
    return [effect]


def between(
    effect: Effect, beside: Iterable[Effect], facts: JointFacts
) -> list[Effect]:
    """An effect in shapes at thirds of the way to the nearest of some beside its own."""
    others = list(beside)
    finer: list[Effect] = []
    for shape in effect.search.shapes:
        value = getattr(effect, shape.name)
        values = {getattr(other, shape.name) for other in others}
        lower = max((v for v in values if v < value), default=value)
        upper = min((v for v in values if v > value), default=value)
        for end in (lower, upper):
            if end != value:
                spaced = np.geomspace if end * value > 0 else np.linspace
                thirds = spaced(value, end, 4)[1:3]
                finer += [effect.reshaped(shape.name, float(v)) for v in thirds]
    return finer


@dataclass(frozen=True)
class Search:
    """Which models may have an effect, where it is looked for and what it may be taken for.

    Attributes:
        stage: ``standard``: `identify` estimates it by default; ``usual``: most joints have it,
            and a model may get it; ``further``: a model may get it; ``diagnosis``: a cause of
            errors of the given model alone, which bodies and gravity hold.
        shapes: Fields that torque is not linear in.
        at_rest: Whether a joint at rest shows it too.
        contains: Names of the effects that it is where some coefficients are zero.
        imitates: Those of them that it may be mistaken for.
        places: Sets of joints to look for it at, from all joints of an arm; None: each joint, each
            joint and the next, or all at once, as it acts on them.
        candidates: Shapes to consider, from the effect in its usual shape.
        trials: Number of shapes that each of these is the best of.
        refined: Shapes to consider beside one that was selected and others around it.
        feasible: Whether coefficients (k,) with standard deviations (k,) on top of a robot's own
            are possible, beyond the bounds of its terms.
        doubt: Why such coefficients, possible as they are, are not what its name says; or empty.
    """

    stage: Stage = "further"
    shapes: tuple[Shape, ...] = ()
    at_rest: bool = False
    contains: tuple[str, ...] = ()
    imitates: tuple[str, ...] = ()
    places: Callable[[tuple[str, ...]], Iterable[tuple[str, ...]]] | None = None
    candidates: Callable[[Any, JointFacts], Iterable[Effect]] = on_grid
    trials: Callable[[JointFacts], int] = lambda facts: 1
    refined: Callable[[Any, Iterable[Effect], JointFacts], list[Effect]] = between
    feasible: Callable[[Any, Robot, Array, Array], bool] | None = None
    doubt: Callable[[Any, Robot, Array, Array], str] = lambda *_: ""

    @property
    def standard(self) -> bool:
        """Whether `identify` estimates it by default."""
        return self.stage == "standard"

    @property
    def usual(self) -> bool:
        """Whether most joints have it."""
        return self.stage in ("standard", "usual")

    @property
    def addable(self) -> bool:
        """Whether it may be added to a model."""
        return self.stage in ("usual", "further")

    @property
    def tuned(self) -> Shape | None:
        """The shape that a fit may refine, if any."""
        tuned = (s for s in self.shapes if s.positive and not s.trial)
        return next(tuned, None)


def alternatives(effect: Effect, facts: JointFacts) -> list[Effect]:
    """An effect without values in its own shape and those that it may have as well."""
    usual = effect.without_values()
    if not effect.search.shapes:
        return [usual]
    shape = effect.search.shapes[0]
    value = getattr(effect, shape.name)
    if shape.most is None:
        grid = () if shape.grid is None else shape.grid(facts)
        values = [value, *(v for v in grid if v != value)]
    else:
        most = max(abs(value), shape.most(facts))
        scaled = [ratio * value for ratio in SHAPE_RATIOS]
        values = [v for v in scaled if abs(v) <= most]
    return [usual.reshaped(shape.name, v) for v in values]


def plausible(effect: Effect, robot: Robot, values: Array, std: Array) -> bool:
    """Whether coefficients (k,), added to those that the robot has, can be.

    They have standard deviations (k,), respect the bounds of the terms and what the effect asks
    itself, and are of a size at which they mean what the effect says.
    """
    present = effect_values(robot)
    parameters = effect.parameters(robot)
    lower = np.array([p.lower - present.get(p.name, 0.0) for p in parameters])
    if not above(values, lower, std) or not _of_its_size(effect, values):
        return False
    feasible = effect.search.feasible
    return feasible is None or feasible(effect, robot, values, std)


def _of_its_size(effect: Effect, values: Array) -> bool:
    low, high = TRIAL_RATIOS
    for shape in effect.search.shapes:
        if shape.trial and not low < values[0] / getattr(effect, shape.name) < high:
            return False
    terms = effect.own_terms * (len(values) // len(effect.own_terms))
    return all(
        term.typical is None or abs(value) < MOST_OF_TYPICAL * term.typical
        for term, value in zip(terms, values, strict=True)
    )


@lru_cache(maxsize=8)
def effect_values(robot: Robot) -> Mapping[str, float]:
    """Coefficients of the robot's own effects by name; those without values are left out."""
    return {
        p.name: value
        for effect in robot.effects
        if effect.values is not None
        for p, value in zip(effect.parameters(robot), effect.values, strict=True)
    }


def above(values: Array, lower: Array | float, std: Array) -> bool:
    """Whether values reach a lower bound within their uncertainty."""
    return bool((values > lower - BOUND_STDS * std).all())
