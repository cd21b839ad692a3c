"""Effect: anything that makes torque beyond the rigid-body inertia of the given links."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import (
    TYPE_CHECKING,
    Any,
    ClassVar,
    Literal,
    Protocol,
    Self,
    TypeVar,
    dataclass_transform,
)

import numpy as np
import numpy.typing as npt

from excitant.exceptions import BadInput
from excitant.robots.effects.experiments import BETWEEN, GENERAL, SAME
from excitant.robots.motion import Array, Motion

if TYPE_CHECKING:
    from excitant.robots.robot import Robot

_LARGEST = 2.0  # of the typical size of a coefficient that has one
# standard deviations by which a value may lie beyond what physics allows
SIGN_DEVIATIONS = 2.0
_NEAR = (0.3, 2.5)  # of a trial value, for which the columns are right
_TIMES = (0.25, 0.5, 1.0, 2.0, 4.0)  # a shape that was found, where it may be another
# standard deviations of the noise of positions that hide where one turns back
_DEVIATIONS = 4.0
_STILL = 1e-3  # rad/s: slower joints rest

Role = Literal["torque", "link", "body"]
Law = Callable[[Array, Array, Array], Sequence[Array]]
"""Torque per unit of each coefficient of one joint, of its q, q̇ and q̈, all of shape (n,)."""


def plain(name: object) -> str:
    """A word of the vocabulary as it stands in a sentence, such as ``Coulomb friction``."""
    words = str(name).replace("_", " ").replace("load dependent", "load-dependent")
    return words.replace("coulomb", "Coulomb").replace("stribeck", "Stribeck")


def _unit(unit: str, slides: bool) -> str:
    """The unit of a joint's coefficient, where this is that of a turning one's."""
    for turning, sliding in (
        ("(N·m)", "N"),
        ("N·m", "N"),
        ("kg·m²", "kg"),
        ("rad", "m"),
    ):
        unit = unit.replace(turning, sliding) if slides else unit
    return unit


@dataclass(frozen=True)
class Parameter:
    """One coefficient of an effect."""

    name: str  # its symbol; after that of the joint, pair or link it belongs to, its full name
    unit: str  # where torque is in N·m
    lower: float = -np.inf  # smallest value that physics allows
    # size where it matters; None where that depends on the arm
    typical: float | None = None
    vector: str = ""  # quantity whose component it is, told by its length


@dataclass(frozen=True)
class Size:
    """A quantity that tells how large an effect is, and its value in the given model."""

    name: str
    unit: str
    value: float
    std: float
    given: float = 0.0

    def __str__(self) -> str:
        text = f"{self.value:.3g} ± {self.std:.2g}"
        return text if self.unit == "1" else f"{text} {self.unit}"


def length(x: Array, covariance: Array) -> tuple[float, float]:
    """Length of a vector (k,) with covariance (k, k), and its standard deviation.

    The standard deviation is √(uᵀ C u) with u = x / ‖x‖ to first order. Within two of them of
    zero the direction is not determined, and that of the least certain direction is returned.
    """
    size = float(np.linalg.norm(x))
    worst = float(np.linalg.norm(covariance, 2)) ** 0.5
    if size == 0:
        return size, worst
    direction = x / size
    std = float(np.sqrt(np.abs(direction @ covariance @ direction)))
    return size, std if size > 2 * std else worst


@dataclass(frozen=True, eq=False)
class JointFacts:
    """Statistics of one joint in recordings, which choose and scale the shapes of effects."""

    speed: float = np.inf  # highest [rad/s or m/s]
    reach: float = np.inf  # range of positions [rad or m]
    start: float = 0.0  # first instant [s]
    duration: float = np.inf  # of all recordings, from first to last instant [s]
    # how far it moves about a reversal while samples and filter see none
    blur: float = 0.0
    q: Array = field(
        default_factory=lambda: np.zeros(0)
    )  # at the rows of `unexplained`, (n,)
    dq: Array = field(default_factory=lambda: np.zeros(0))  # there, (n,)
    unexplained: Array = field(
        default_factory=lambda: np.zeros(0)
    )  # torque left, (n,) [N·m]
    cutoff_hz: float = np.inf  # of the filter that this torque has passed [Hz]

    @property
    def moves(self) -> bool:
        """Whether the joint is ever faster than at rest."""
        return self.speed > _STILL


def joint_facts(
    motions: Sequence[Motion],
    rows: Sequence[slice] = (),
    unexplained: Array | None = None,
    cutoff_hz: float = np.inf,
    noise: Array | float = 0.0,
) -> tuple[JointFacts, ...]:
    """Statistics of each joint in recordings, with the residual torque of a model at some rows.

    Noise is a density of the positions, (nv,) [rad²/Hz or m²/Hz].
    """

    def joined(parts: Sequence[Motion]) -> tuple[Array, Array]:
        return np.concatenate([m.q for m in parts]), np.concatenate(
            [m.dq for m in parts]
        )

    q, dq = joined(motions)
    speed = np.abs(dq).max(axis=0).tolist()
    reach = np.ptp(q, axis=0).tolist()
    start = min(float(m.t[0]) for m in motions)
    duration = max(float(m.t[-1]) for m in motions) - start
    unseen = max(float(m.t[1] - m.t[0]) for m in motions)
    passed = 0.0
    if cutoff_hz < np.inf:  # positions pass twice the cut-off
        unseen = unseen + 1 / (2 * np.pi * 2 * cutoff_hz)
        passed = 2 * cutoff_hz
    pull = np.sqrt(np.mean(np.concatenate([m.ddq for m in motions]) ** 2, axis=0))
    blur = (pull * unseen**2 / 2 + _DEVIATIONS * np.sqrt(noise * passed)).tolist()
    facts = [
        JointFacts(top, far, start, duration, near)
        for top, far, near in zip(speed, reach, blur, strict=True)
    ]
    if unexplained is None:
        return tuple(facts)
    q, dq = joined([motion[part] for motion, part in zip(motions, rows, strict=True)])
    return tuple(
        replace(
            seen,
            q=q[:, j],
            dq=dq[:, j],
            unexplained=unexplained[:, j],
            cutoff_hz=cutoff_hz,
        )
        for j, seen in enumerate(facts)
    )


@dataclass(frozen=True)
class Shape:
    """A field of an effect that torque is not linear in, by its name."""

    name: str
    unit: str
    positive: bool = True  # whether it must be; then a fit may refine it
    # the coefficient that columns, not linear in it, are computed for
    trial: bool = False
    grid: Callable[[JointFacts], Iterable[float]] | None = None  # values to consider
    # largest that counts, beyond it the effect is another; without it, the grid has what may be
    most: Callable[[JointFacts], float] | None = None
    # smallest that recordings tell from none at all
    least: Callable[[JointFacts], float] = lambda facts: -np.inf


class Stepper(Protocol):
    """An effect in a simulation that carries a state of its own from step to step."""

    def __call__(self, t: float, q: Array, dq: Array, ddq: Array) -> Array: ...

    def advance(self, q: Array) -> None: ...


@dataclass(frozen=True)
class Effect(ABC):
    """Torque that is linear in the effect's coefficients once its shape is fixed.

    Raises:
        BadInput: It acts on another number of joints, or a field of its shape cannot be.
    """

    name: ClassVar[str]
    # friction, body, static, transmission, geometry or reading
    family: ClassVar[str] = ""
    arity: ClassVar[int] = 0  # how many joints it acts on; 0: as many as it is given
    jointwise: ClassVar[bool] = False  # each joint has coefficients that act on it only
    terms: ClassVar[
        tuple[Parameter, ...]
    ] = ()  # its coefficients, once or on each joint
    # "link": changes of a link's own; "body": of a further one
    role: ClassVar[Role] = "torque"
    shapes: ClassVar[tuple[Shape, ...]] = ()
    # columns depend on inertias or other effects
    depends_on_model: ClassVar[bool] = True
    # columns are those of a sensor of all other torque
    acts_on_torque: ClassVar[bool] = False
    # that of the given model; else it imitates findings
    of_given_torque: ClassVar[bool] = False
    smooth: ClassVar[bool] = False  # as the motion is: its torque never jumps
    # a simulation knows it; others follow a known motion
    of_state_alone: ClassVar[bool] = True
    standard: ClassVar[bool] = False  # `identify` estimates it by default
    usual: ClassVar[bool] = False  # most joints have it
    # a model may get it; not what bodies and gravity hold
    further: ClassVar[bool] = True
    needs_motion: ClassVar[bool] = False  # joints that rest do not show it
    contains: ClassVar[
        tuple[str, ...]
    ] = ()  # what it is when some coefficients are zero
    imitates: ClassVar[tuple[str, ...]] = ()  # what of that it can be at work for
    told: ClassVar[
        tuple[tuple[str, str], ...]
    ] = ()  # experiment, rivals it is separated from
    abscissa: ClassVar[str] = "own torque"  # what the error without it is drawn over
    joint_property: ClassVar[str] = ""  # what joints in files of a model have for it
    formats: ClassVar[tuple[str, ...]] = ()  # of the files that have it
    format_notes: ClassVar[Mapping[str, str]] = {}  # what it means there otherwise

    joints: tuple[str, ...]  # it acts on
    values: tuple[float, ...] | None = None  # one per parameter; None while unknown

    def __post_init__(self) -> None:
        count = len(self.joints)
        if self.arity and count != self.arity:
            wanted = "one joint" if self.arity == 1 else f"{self.arity} joints"
            raise BadInput(
                f"effect {self.name} acts on {wanted}, not on {count}; name it or them"
            )
        if len(set(self.joints)) < count:
            raise BadInput(
                f"effect {self.name} names a joint twice: {', '.join(self.joints)}"
            )
        for shape in self.shapes:
            if shape.positive and not getattr(self, shape.name) > 0:
                raise BadInput(f"effect {self.name}: {shape.name} must be positive")

    @property
    def label(self) -> str:
        """Its name as it stands in a sentence."""
        return plain(self.name)

    def owners(self, robot: Robot) -> tuple[str, ...]:
        """Joints, pair or link that its terms belong to, as the names of its coefficients say."""
        if self.jointwise or len(self.joints) == 1:
            return self.joints
        return ("-".join(self.joints) if self.arity else "common",)

    @property
    def own_terms(self) -> tuple[Parameter, ...]:
        """The terms that it has in its shape."""
        return self.terms

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Its coefficients, in the order of the columns."""
        slides = np.array(robot.joints)[~robot.revolute] if self.jointwise else ()
        return tuple(
            replace(
                term,
                name=f"{owner}.{term.name}",
                unit=_unit(term.unit, owner in slides),
            )
            for owner in self.owners(robot)
            for term in self.own_terms
        )

    def shape_unit(self, robot: Robot, shape: Shape) -> str:
        """Unit of a shape, that of the joint it belongs to."""
        return _unit(shape.unit, not robot.revolute[robot.joint_index(self.joints[0])])

    @abstractmethod
    def columns(self, robot: Robot, motion: Motion) -> Array:
        """Torque per unit of each coefficient, shape (n, nv, k) [N·m per unit]."""

    def torque(self, robot: Robot, motion: Motion) -> Array:
        """Torque that the joints must give for it, shape (n, nv) [N·m]."""
        tau: Array = self.columns(robot, motion) @ np.array(self._known())
        return tau

    def _known(self) -> tuple[float, ...]:
        if self.values is None:
            raise ValueError(f"{self.name} has no values yet")
        return self.values

    @property
    def law(self) -> Law | None:
        """Its torque where the joint's own state at that instant makes it; None for others."""
        return None

    def with_values(self, values: npt.ArrayLike) -> Self:
        """The same effect with these coefficients."""
        return replace(self, values=tuple(float(v) for v in np.ravel(values)))

    def bare(self) -> Self:
        """The same effect without values."""
        return replace(self, values=None)

    def singles(self) -> list[Self]:
        """The effect without values, joint by joint where each has coefficients of its own."""
        if not self.jointwise:
            return [self.bare()]
        return [replace(self, joints=(joint,), values=None) for joint in self.joints]

    def rows(self, robot: Robot) -> list[int]:
        """Indices of its joints."""
        return [robot.joint_index(joint) for joint in self.joints]

    def affected(self, robot: Robot) -> list[int]:
        """Indices of the joints whose torque it changes: its own, or any where bodies move."""
        return self.rows(robot) if self.jointwise else list(range(robot.nv))

    @property
    def is_friction_curve(self) -> bool:
        """Whether it is friction by the joint's velocity alone, finer than the usual."""
        return self.family == "friction" and self.law is not None and not self.standard

    @property
    def is_position_curve(self) -> bool:
        """Whether it is a smooth torque by the joint's position alone."""
        return False

    def is_common(self, robot: Robot) -> bool:
        """Whether it acts on all joints of an arm by the same coefficients."""
        return robot.nv > 1 and {*self.joints} == {*robot.joints}

    def link(self, robot: Robot) -> int | None:
        """The link whose columns of the regressor are its own; None for what is no body."""
        return None if self.role == "torque" else robot.joint_index(self.joints[0])

    @classmethod
    def candidates(cls, joint: str, facts: JointFacts) -> Iterable[Self]:
        """Shapes of the effect to consider at a joint: those of its grid, or the usual one."""
        usual = cls((joint,))
        for shape in cls.shapes:
            if shape.grid is not None:
                seen = [float(v) for v in shape.grid(facts) if v >= shape.least(facts)]
                return [usual.reshaped(shape.name, value) for value in seen]
        return [usual]

    @classmethod
    def proposed(
        cls, robot: Robot, facts: Sequence[JointFacts]
    ) -> list[tuple[Self, int]]:
        """All of it to consider on an arm, with the number of shapes each is the best of."""
        return [
            (effect, 1)
            for joint, seen in zip(robot.joints, facts, strict=True)
            if seen.moves or not cls.needs_motion
            for effect in cls.candidates(joint, seen)
        ]

    def refined(self, beside: Iterable[Effect], facts: JointFacts) -> list[Self]:
        """The effect in shapes at thirds of the way to the nearest of some beside its own."""
        near: list[Self] = []
        for name in (shape.name for shape in self.shapes):
            own = getattr(self, name)
            others = {getattr(e, name) for e in beside}
            lower = [v for v in others if v < own]
            upper = [v for v in others if v > own]
            for end in (max(lower, default=own), min(upper, default=own)):
                if end != own:
                    steps = np.geomspace if end * own > 0 else np.linspace
                    near += [
                        self.reshaped(name, float(v)) for v in steps(own, end, 4)[1:3]
                    ]
        return near

    def alternatives(self, facts: JointFacts) -> list[Self]:
        """The effect without values in its own shape and those that it may have as well."""
        own = self.bare()
        for shape in self.shapes[:1]:
            value = getattr(own, shape.name)
            if shape.most is not None:
                most = max(abs(value), shape.most(facts))
                values = [
                    times * value for times in _TIMES if abs(times * value) <= most
                ]
            else:
                grid = () if shape.grid is None else shape.grid(facts)
                values = [value, *(v for v in grid if v != value)]
            return [own.reshaped(shape.name, v) for v in values]
        return [own]

    def reshaped(self, name: str, value: float) -> Self:
        """The effect with another value of one field of its shape."""
        change: dict[str, Any] = {name: value}
        return replace(self, **change)

    @property
    def tuned(self) -> Shape | None:
        """The shape parameter that a fit may refine, if any."""
        return next(
            (shape for shape in self.shapes if shape.positive and not shape.trial), None
        )

    def credible(self, robot: Robot, values: Array) -> bool:
        """Whether coefficients are of a size at which they mean what the effect says."""
        for shape in self.shapes:
            if (
                shape.trial
                and not _NEAR[0] < values[0] / getattr(self, shape.name) < _NEAR[1]
            ):
                return False
        typical = [p.typical for p in self.parameters(robot)]
        most = np.array(
            [np.inf if size is None else _LARGEST * size for size in typical]
        )
        return bool((np.abs(values) < most).all())

    def plausible(self, robot: Robot, values: Array, std: Array) -> bool:
        """Whether values (k,), added to those that the robot has, are such as physics allows."""
        known = effect_values(robot)
        parameters = self.parameters(robot)
        lower = np.array([p.lower - known.get(p.name, 0.0) for p in parameters])
        return within(values, lower, std) and self.credible(robot, values)

    def applied(self, robot: Robot) -> Robot:
        """The robot with what the effect changes of its bodies and gravity."""
        return robot

    def stepper(self, robot: Robot) -> Stepper | None:
        """The effect with a state of its own, carried from step to step, where it has one."""
        return None

    def noun(self, robot: Robot) -> str:
        """The cause with its place."""
        where = "all joints" if len(self.joints) > 3 else ", ".join(self.joints)
        return f"{self.label} at {where}"

    def sizes(
        self, value: Array, given: Array, covariance: Array, units: Sequence[str]
    ) -> tuple[Size, ...]:
        """How large it is: each coefficient, or the length of the vector of several.

        Args:
            value: Coefficients, shape (k,).
            given: Those of the given model, shape (k,).
            covariance: Of the coefficients, shape (k, k).
            units: Of the coefficients.
        """
        terms = self.own_terms * (len(value) // len(self.own_terms))
        vectors = dict[tuple[str, int], list[int]]()
        for k, term in enumerate(terms):
            apart = k // len(self.own_terms) if term.vector else k
            vectors.setdefault((term.vector, apart), []).append(k)
        sizes = []
        for (vector, _), at in vectors.items():
            if vector:
                size, std = length(value[at], covariance[np.ix_(at, at)])
                nominal = float(np.linalg.norm(given[at]))
                sizes.append(Size(vector, units[at[0]], size, std, nominal))
            else:
                k = at[0]
                std = float(np.sqrt(covariance[k, k]))
                size = float(value[k])
                nominal = float(given[k])
                sizes.append(Size(terms[k].name, units[k], size, std, nominal))
        return tuple(sizes)

    def sentence(
        self, robot: Robot, joints: Sequence[str], sizes: Sequence[Size]
    ) -> str:
        """Statement of a diagnosis on the effect at joints, its own first."""
        name = self.label
        if len(joints) > 1:
            return f"{name[0].upper()}{name[1:]} of {len(joints)} joints is missing or wrong"
        several = len(sizes) > 1
        words = (f"{s.name} " * several + str(s) for s in sizes)
        size = ", ".join(words).replace("_", " ")
        if any(s.given for s in sizes):
            nominal = ", ".join(f"{s.given:.3g}" for s in sizes)
            return f"{joints[0]}: {name} is {size}, the model says {nominal}"
        return f"{joints[0]}: {name} of {size} is not in the model"

    @classmethod
    def told_from(cls, rival: Effect | type[Effect]) -> str:
        """Action that tells it from another effect."""
        if cls.name == rival.name:
            return SAME
        pairs = ((cls.told, rival.name), (rival.told, cls.name))
        known = (
            action
            for told, name in pairs
            for action, all_ in told
            if name in all_.split()
        )
        return next(known, BETWEEN.get(frozenset((cls.family, rival.family)), GENERAL))

    def drawn(self, label: str, x: Array) -> tuple[str, Array]:
        """Label and values of the quantity it is drawn over, NaN where not to be shown."""
        return label, x


class JointwiseEffect(Effect):
    """Effect with coefficients of its own on each joint, which act on that joint only."""

    jointwise: ClassVar[bool] = True
    needs_motion: ClassVar[bool] = True

    @abstractmethod
    def at(self, robot: Robot, motion: Motion, j: int) -> Sequence[Array]:
        """Torque per unit of each term for joint j, each of shape (n,)."""

    def columns(self, robot: Robot, motion: Motion) -> Array:
        count = len(self.own_terms) * len(self.joints)
        columns = np.zeros((len(motion), robot.nv, count))
        per_joint = [
            (j, values)
            for j in self.rows(robot)
            for values in self.at(robot, motion, j)
        ]
        for column, (j, values) in enumerate(per_joint):
            columns[:, j, column] = values
        return columns

    def torque(self, robot: Robot, motion: Motion) -> Array:
        tau = np.zeros((len(motion), robot.nv))
        values = iter(self._known())
        for j in self.rows(robot):
            for column in self.at(robot, motion, j):
                tau[:, j] += next(values) * column
        return tau


class JointEffect(JointwiseEffect):
    """Effect on each joint by that joint's own motion at that instant."""

    depends_on_model: ClassVar[bool] = False

    @abstractmethod
    def of_state(self, q: Array, dq: Array, ddq: Array) -> Sequence[Array]:
        """Torque per unit of each term for one joint, each of shape (n,)."""

    @property
    def law(self) -> Law:
        return self.of_state

    def at(self, robot: Robot, motion: Motion, j: int) -> Sequence[Array]:
        return self.of_state(motion.q[:, j], motion.dq[:, j], motion.ddq[:, j])


class StandardEffect(JointEffect):
    """Effect that most joints have and `identify` estimates by default."""

    standard: ClassVar[bool] = True
    usual: ClassVar[bool] = True
    further: ClassVar[bool] = False


class PairEffect(Effect):
    """Effect between two joints, ``joints = (one, other)``."""

    arity: ClassVar[int] = 2
    depends_on_model: ClassVar[bool] = False

    @classmethod
    def proposed(
        cls, robot: Robot, facts: Sequence[JointFacts]
    ) -> list[tuple[Self, int]]:
        return [(cls(pair), 1) for pair in pairwise(robot.joints)]


Kind = TypeVar("Kind", bound=Effect)
EFFECTS: dict[str, type[Effect]] = {}
"""Effects by their name in JSON, command line and documentation."""


@dataclass_transform(frozen_default=True)
def registered(kind: type[Kind]) -> type[Kind]:
    """A frozen dataclass of effects, known by its name to files, commands and diagnoses."""
    EFFECTS[kind.name] = made = dataclass(frozen=True)(kind)
    return made


def standard_effects(joints: tuple[str, ...]) -> tuple[Effect, ...]:
    """Default effects of `identify`: friction, offset and rotor inertia of each joint."""
    return tuple(kind(joints) for kind in EFFECTS.values() if kind.standard)


def proposals(
    robot: Robot,
    facts: Sequence[JointFacts],
    believed: Iterable[tuple[Effect, int]] = (),
) -> list[tuple[Effect, int]]:
    """All effects to consider on an arm, each with the number of shapes it is the best of.

    Effects believed so far, with that number, are considered again, and shapes close to theirs.
    """
    found = [pair for kind in EFFECTS.values() for pair in kind.proposed(robot, facts)]
    known = {effect: effect for effect, _ in found}
    again = dict[Effect, int]()
    for effect, trials in believed:
        beside = [
            e for e in known if e.name == effect.name and e.joints == effect.joints
        ]
        seen = facts[robot.joint_index(effect.joints[0])]
        again |= dict.fromkeys((effect, *effect.refined(beside, seen)), trials)
    return found + [pair for pair in again.items() if pair[0] not in known]


def merged(effects: Iterable[Effect]) -> list[Effect]:
    """Effects of one kind and shape as one on several joints, where joints have their own."""
    kinds = dict[Effect, list[str]]()
    others = list[Effect]()
    for effect in effects:
        if effect.jointwise:
            kinds.setdefault(replace(effect, joints=(), values=None), []).extend(
                effect.joints
            )
        else:
            others.append(effect)
    return [
        *(replace(kind, joints=tuple(joints)) for kind, joints in kinds.items()),
        *others,
    ]


def effect_values(robot: Robot) -> dict[str, float]:
    """Coefficients of the robot's own effects by name; those not known are left out."""
    return {
        p.name: value
        for effect in robot.effects
        if effect.values is not None
        for p, value in zip(effect.parameters(robot), effect.values, strict=True)
    }


def within(values: Array, lower: Array | float, std: Array) -> bool:
    """Whether values reach a bound within their uncertainty."""
    return bool((values > lower - SIGN_DEVIATIONS * std).all())
