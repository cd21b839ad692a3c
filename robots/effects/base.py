"""Effect: anything that makes torque beyond the rigid-body inertia of the given links.

Its torque is linear in its coefficients once its shape is fixed. An effect answers for itself in
four parts: what makes its torque (`Physics`), where it is looked for (`Search`), how it is said
(`Words`) and what files of a model hold of it (`Export`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from enum import Enum
from itertools import pairwise
from typing import (
    TYPE_CHECKING,
    Any,
    ClassVar,
    Literal,
    Self,
    TypeVar,
    dataclass_transform,
)

import numpy as np
import numpy.typing as npt

from excitant.exceptions import BadInput, UnknownName
from excitant.robots.effects.search import JointFacts, Search, Shape
from excitant.robots.motion import Array, Motion

if TYPE_CHECKING:
    from excitant.robots.robot import Robot

Role = Literal["torque", "link", "body"]
Law = Callable[[Array, Array, Array], Sequence[Array]]
"""Torque per unit of each coefficient of one joint, of its q, q̇ and q̈, all of shape (n,)."""


def plain(name: object) -> str:
    """A word of the vocabulary as it stands in a sentence, such as ``Coulomb friction``."""
    words = str(name).replace("_", " ").replace("load dependent", "load-dependent")
    return words.replace("coulomb", "Coulomb").replace("stribeck", "Stribeck")


class Acts(Enum):
    """Joints that an effect acts on by the same coefficients."""

    EACH = "each joint with coefficients of its own"
    ONE = "one joint"
    PAIR = "2 joints"
    COMMON = "all joints that it is given"

    @property
    def count(self) -> int:
        """Number of joints; 0: as many as it is given."""
        if self is Acts.ONE:
            return 1
        return 2 if self is Acts.PAIR else 0


@dataclass(frozen=True)
class Parameter:
    """One coefficient of an effect.

    Attributes:
        name: Its symbol; after that of the joint, pair or link it belongs to, its full name.
        unit: Unit where torque is in N·m.
        lower: Smallest value that physics allows.
        typical: Size where it matters; None where that depends on the arm.
        vector: Name of the vector whose component it is, which is told by its length.
    """

    name: str
    unit: str
    lower: float = -np.inf
    typical: float | None = None
    vector: str = ""


def _unit(unit: str, slides: bool) -> str:
    """The unit of a coefficient of a turning joint, at one that slides."""
    sliding = {"(N·m)": "N", "N·m": "N", "kg·m²": "kg", "rad": "m"}
    for word in sliding if slides else ():
        unit = unit.replace(word, sliding[word])
    return unit


@dataclass(frozen=True)
class Physics:
    """What makes the torque of an effect.

    Attributes:
        depends_on: What columns are computed from beside the motion: nothing (``motion``), the
            ``bodies``, all other ``torque``, or that of the given model (``given torque``).
        smooth: Whether its torque is as smooth as the motion and never jumps.
        dry: Whether it holds a joint at rest, by any torque up to that of motion.
        amends: Whether it is by what another effect's law is wrong: a model holds the other.
        between_samples: Variance of its coefficient by what happens between the samples of a
            motion, at some joints.
    """

    depends_on: Literal["motion", "bodies", "torque", "given torque"] = "bodies"
    smooth: bool = False
    dry: bool = False
    amends: bool = False
    between_samples: Callable[[Robot, Motion, list[int]], float] | None = None

    @property
    def on_model(self) -> bool:
        """Whether columns depend on inertias or other effects."""
        return self.depends_on != "motion"

    @property
    def on_torque(self) -> bool:
        """Whether it is how a sensor reads all other torque, which does not move the arm."""
        return self.depends_on in ("torque", "given torque")

    @property
    def on_given_torque(self) -> bool:
        """Whether that is the torque of the given model; else it imitates findings."""
        return self.depends_on == "given torque"


@dataclass(frozen=True)
class Size:
    """A quantity that tells how large an effect is, and its value in the given model."""

    name: str
    unit: str
    value: float
    std: float  # nan: whether the effect is there is not decided
    given: float

    def __str__(self) -> str:
        text = f"{rounded(self.value, 3)}{self.spread()}"
        return text if self.unit == "1" else f"{text} {self.unit}"

    def entry(self) -> dict[str, Any]:
        """Its entry in ``result.json``."""
        return {
            "name": self.name,
            "value": self.value,
            "std": self.std if np.isfinite(self.std) else None,
            "unit": self.unit,
        }

    def spread(self, factor: float = 1.0) -> str:
        """`` ± `` and its standard deviation in another unit; empty where that is not known."""
        known = np.isfinite(self.std)
        return f" ± {rounded(factor * self.std, 2)}" if known else ""


def rounded(x: float, digits: int) -> str:
    """A number of so many digits, without an exponent from 1e-4 up to a million."""
    return f"{float(f'{x:.{digits}g}'):g}"


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


def usual_noun(effect: Effect, robot: Robot) -> str:
    """A cause with its place."""
    where = "all joints" if len(effect.joints) > 3 else ", ".join(effect.joints)
    return f"{effect.label} at {where}"


def usual_sentence(
    effect: Effect, robot: Robot, joints: Sequence[str], sizes: Sequence[Size]
) -> str:
    """Statement of a diagnosis on an effect at joints, its own first."""
    label = effect.label
    if len(joints) > 1:
        return f"{label[0].upper()}{label[1:]} of {len(joints)} joints is missing or wrong"
    several = len(sizes) > 1
    words = (f"{s.name} " * several + str(s) for s in sizes)
    size = ", ".join(words).replace("_", " ")
    if any(s.given for s in sizes):
        nominal = ", ".join(rounded(s.given, 3) for s in sizes)
        return f"{joints[0]}: {label} is {size}, the model says {nominal}"
    return f"{joints[0]}: {label} of {size} is not in the model"


@dataclass(frozen=True)
class Words:
    """How an effect is said and drawn.

    Attributes:
        abscissa: Quantity over which the error without it is drawn.
        separated_by: By names of rivals, the experiment that tells it from them.
        sentence: Statement of a diagnosis, as `usual_sentence`.
        noun: The cause with its place, as `usual_noun`.
        drawn: Label and values of the abscissa, NaN where not to be drawn; None: as they are.
    """

    abscissa: str = "own torque"
    separated_by: Mapping[str, str] = field(default_factory=dict)
    sentence: Callable[[Any, Robot, Sequence[str], Sequence[Size]], str] = (
        usual_sentence
    )
    noun: Callable[[Any, Robot], str] = usual_noun
    drawn: Callable[[Any, str, Array], tuple[str, Array]] | None = None


@dataclass(frozen=True)
class Export:
    """What files of a model hold of an effect.

    Attributes:
        joint_property: Property of joints in those files; empty where there is none.
        formats: Formats that have it, each with a note on what it means there otherwise.
    """

    joint_property: str = ""
    formats: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Effect(ABC):
    """Torque that is linear in the effect's coefficients once its shape is fixed.

    Attributes:
        name: In JSON, command line and documentation.
        family: Friction, body, static, transmission, geometry or reading.
        terms: Its coefficients, once or on each joint.
        acts_on: Joints that share coefficients.
        role: ``link``: its coefficients are changes of a link's own; ``body``: of a further one.
        physics: What makes its torque.
        search: Where and in which shapes it is looked for.
        words: How it is said and drawn.
        export: What files of a model hold of it.
        joints: Names of the joints it acts on.
        values: One per parameter; None while unknown.

    Raises:
        BadInput: It acts on another number of joints, or a field of its shape cannot be.
    """

    name: ClassVar[str]
    family: ClassVar[str] = ""
    terms: ClassVar[tuple[Parameter, ...]] = ()
    acts_on: ClassVar[Acts] = Acts.COMMON
    role: ClassVar[Role] = "torque"
    physics: ClassVar[Physics] = Physics()
    search: ClassVar[Search] = Search()
    words: ClassVar[Words] = Words()
    export: ClassVar[Export] = Export()

    joints: tuple[str, ...]
    values: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        count = len(self.joints)
        if count != (self.acts_on.count or count):
            raise BadInput(
                f"effect {self.name} acts on {self.acts_on.value}, not on {count}; name it or them"
            )
        if len(set(self.joints)) < count:
            raise BadInput(
                f"effect {self.name} names a joint twice: {', '.join(self.joints)}"
            )
        for shape in self.search.shapes:
            if shape.positive and not getattr(self, shape.name) > 0:
                raise BadInput(f"effect {self.name}: {shape.name} must be positive")

    @property
    def label(self) -> str:
        """Its name as it stands in a sentence."""
        return plain(self.name)

    @property
    def exported(self) -> Export:
        """What files of a model hold of it in its shape."""
        return self.export

    @property
    def jointwise(self) -> bool:
        """Whether each joint has coefficients of its own, which act on that joint only."""
        return self.acts_on is Acts.EACH

    def owners(self, robot: Robot) -> tuple[str, ...]:
        """Joints, pair or link that its terms belong to, as the names of its coefficients say."""
        if self.jointwise or len(self.joints) == 1:
            return self.joints
        return ("-".join(self.joints) if self.acts_on is Acts.PAIR else "common",)

    @property
    def own_terms(self) -> tuple[Parameter, ...]:
        """The terms that it has in its shape."""
        return self.terms

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Its coefficients, in the order of the columns."""
        sliding = np.array(robot.joints)[~robot.revolute] if self.jointwise else ()
        return tuple(
            replace(
                term,
                name=f"{owner}.{term.name}",
                unit=_unit(term.unit, owner in sliding),
            )
            for owner in self.owners(robot)
            for term in self.own_terms
        )

    def shape_unit(self, robot: Robot, shape: Shape) -> str:
        """Unit of a shape, that of the joint it belongs to."""
        return _unit(
            shape.unit, not robot.revolute[robot.joint_index(self.joints[0])]
        )

    @abstractmethod
    def columns(self, robot: Robot, motion: Motion) -> Array:
        """Torque per unit of each coefficient, shape (n, nv, k) [N·m per unit]."""

    def torque(self, robot: Robot, motion: Motion) -> Array:
        """Torque that the joints must give for it, shape (n, nv) [N·m]."""
        return self.columns(robot, motion) @ np.array(self.coefficients)

    @property
    def coefficients(self) -> tuple[float, ...]:
        """Its values; ValueError while they are unknown."""
        if self.values is None:
            raise ValueError(f"{self.name} has no values yet")
        return self.values

    @property
    def law(self) -> Law | None:
        """Its torque where the joint's own state at that instant makes it; None for others."""
        return None

    @property
    def curve(self) -> str:
        """The curve of a joint that it is part of: friction, position, encoder or none.

        Beside the standard effects, one part of each has a meaning at a joint.
        """
        friction = self.family == "friction" and self.law is not None
        return "friction" if friction and not self.search.standard else ""

    def with_values(self, values: npt.ArrayLike) -> Self:
        """The same effect with these coefficients."""
        return replace(self, values=tuple(float(v) for v in np.ravel(values)))

    def without_values(self) -> Self:
        """The same effect without values."""
        return replace(self, values=None)

    def among(self, joints: Sequence[str]) -> Self | None:
        """The effect at those of its joints that move; None where none does that it needs."""
        kept = [k for k, joint in enumerate(self.joints) if joint in joints]
        if len(kept) == len(self.joints):
            return self
        if not kept or self.acts_on.count:
            return None
        values = self.values
        if self.jointwise and values is not None:
            table = np.reshape(values, (len(self.joints), -1))
            values = tuple(table[kept].ravel().tolist())
        moving = tuple(self.joints[k] for k in kept)
        return replace(self, joints=moving, values=values)

    def reshaped(self, name: str, value: float) -> Self:
        """The effect with another value of one field of its shape."""
        change: dict[str, Any] = {name: value}
        return replace(self, **change)

    def singles(self) -> list[Self]:
        """The effect without values, joint by joint where each has coefficients of its own."""
        usual = self.without_values()
        if not self.jointwise:
            return [usual]
        return [replace(usual, joints=(joint,)) for joint in self.joints]

    def rows(self, robot: Robot) -> list[int]:
        """Indices of its joints."""
        return [robot.joint_index(joint) for joint in self.joints]

    def affected(self, robot: Robot) -> list[int]:
        """Indices of the joints whose torque it changes: its own, or any where bodies move."""
        return self.rows(robot) if self.jointwise else list(range(robot.nv))

    def is_common(self, robot: Robot) -> bool:
        """Whether it acts on all joints of an arm by the same coefficients."""
        return robot.nv > 1 and {*self.joints} == {*robot.joints}

    def link(self, robot: Robot) -> int | None:
        """The link whose columns of the regressor are its own; None for what is no body."""
        return None if self.role == "torque" else robot.joint_index(self.joints[0])

    def applied(self, robot: Robot) -> Robot:
        """The robot with what the effect changes of its bodies and gravity."""
        return robot

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
        count = len(self.own_terms)
        components = dict[tuple[str, int], list[int]]()
        for k in range(len(value)):
            term = self.own_terms[k % count]
            vector = (term.vector, k // count) if term.vector else (term.name, k)
            components.setdefault(vector, []).append(k)
        sizes = []
        for (name, _), at in components.items():
            first = at[0]
            size, std = length(value[at], covariance[np.ix_(at, at)])
            nominal = float(np.linalg.norm(given[at]))
            if not self.own_terms[first % count].vector:
                size = float(value[first])
                nominal = float(given[first])
            sizes.append(Size(name, units[first], size, std, nominal))
        return tuple(sizes)


class JointwiseEffect(Effect):
    """Effect with coefficients of its own on each joint, which act on that joint only."""

    acts_on = Acts.EACH

    @abstractmethod
    def at(self, robot: Robot, motion: Motion, j: int) -> Sequence[Array]:
        """Torque per unit of each term for joint j, each of shape (n,)."""

    def columns(self, robot: Robot, motion: Motion) -> Array:
        count = len(self.own_terms)
        columns = np.zeros((len(motion), robot.nv, count * len(self.joints)))
        for k, j in enumerate(self.rows(robot)):
            for i, column in enumerate(self.at(robot, motion, j)):
                columns[:, j, count * k + i] = column
        return columns

    def torque(self, robot: Robot, motion: Motion) -> Array:
        tau = np.zeros((len(motion), robot.nv))
        values = iter(self.coefficients)
        for j in self.rows(robot):
            for column in self.at(robot, motion, j):
                tau[:, j] += next(values) * column
        return tau


class JointEffect(JointwiseEffect):
    """Effect on each joint by that joint's own motion at that instant."""

    physics = Physics("motion")

    @abstractmethod
    def of_state(self, q: Array, dq: Array, ddq: Array) -> Sequence[Array]:
        """Torque per unit of each term for one joint, each of shape (n,)."""

    @property
    def law(self) -> Law:
        return self.of_state

    def at(self, robot: Robot, motion: Motion, j: int) -> Sequence[Array]:
        return self.of_state(motion.q[:, j], motion.dq[:, j], motion.ddq[:, j])


class PairEffect(Effect):
    """Effect between two joints, ``joints = (one, other)``."""

    acts_on = Acts.PAIR
    physics = Physics("motion")


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
    return tuple(kind(joints) for kind in EFFECTS.values() if kind.search.standard)


def proposals(
    robot: Robot,
    facts: Sequence[JointFacts],
    selected: Iterable[tuple[Effect, int]] = (),
) -> list[tuple[Effect, int]]:
    """All effects to consider on an arm, each with the number of shapes it is the best of.

    Effects selected so far, with that number, are considered again, and shapes close to theirs.
    """
    proposed: list[tuple[Effect, int]] = []
    for kind in EFFECTS.values():
        for joints in _places(kind, robot.joints):
            first = facts[robot.joint_index(joints[0])]
            if first.moves or kind.search.at_rest or kind.acts_on is not Acts.EACH:
                trials = kind.search.trials(first)
                candidates = kind.search.candidates(kind(joints), first)
                proposed += [(effect, trials) for effect in candidates]
    known = dict(proposed)
    again = dict[Effect, int]()
    for effect, trials in selected:
        beside = [
            e for e in known if e.name == effect.name and e.joints == effect.joints
        ]
        first = facts[robot.joint_index(effect.joints[0])]
        finer = effect.search.refined(effect, beside, first)
        again |= dict.fromkeys((effect, *finer), trials)
    return proposed + [pair for pair in again.items() if pair[0] not in known]


def _places(
    kind: type[Effect], joints: tuple[str, ...]
) -> Iterable[tuple[str, ...]]:
    """Sets of joints at which to look for a kind of effect."""
    if kind.search.places is not None:
        return kind.search.places(joints)
    if kind.acts_on is Acts.COMMON:
        return [joints]
    if kind.acts_on is Acts.PAIR:
        return pairwise(joints)
    return [(joint,) for joint in joints]


def merged(effects: Iterable[Effect]) -> list[Effect]:
    """Effects of one kind and shape as one on several joints, where joints have their own."""
    kinds = dict[Effect, list[str]]()
    others = list[Effect]()
    for effect in effects:
        if effect.jointwise:
            kind = replace(effect, joints=(), values=None)
            kinds.setdefault(kind, []).extend(effect.joints)
        else:
            others.append(effect)
    together = [
        replace(kind, joints=tuple(joints)) for kind, joints in kinds.items()
    ]
    return [*together, *others]


def turning_speed(effect: Effect) -> float:
    """Speed below which dry friction turns; 0 where it turns at once [rad/s or m/s]."""
    return float(vars(effect).get("turning_speed", 0.0))


def turning(effect: Effect, speed: float) -> Effect:
    """An effect with dry friction that turns over a range of speeds; others as they are."""
    known = "turning_speed" in vars(effect)
    return effect.reshaped("turning_speed", speed) if known else effect


def effect_entries(effects: Sequence[Effect]) -> list[dict[str, Any]]:
    """Effects as entries ``{effect, joints, values, …}`` of a ``robot.yaml``."""
    return [
        {"effect": effect.name}
        | {
            name: list(value) if isinstance(value, tuple) else value
            for name, value in vars(effect).items()
            if value is not None
        }
        for effect in effects
    ]


def effects_from_entries(
    entries: Sequence[Mapping[str, Any]], robot: Robot, source: str
) -> tuple[Effect, ...]:
    """Effects of a robot from entries of a file; all joints where an entry names none.

    Raises:
        BadInput: Unknown effect, joint or field, or values that do not fit.
    """
    return tuple(_from_entry(dict(entry), robot, source) for entry in entries)


def _from_entry(entry: dict[str, Any], robot: Robot, source: str) -> Effect:
    name = str(entry.pop("effect", ""))
    if name not in EFFECTS:
        raise BadInput(f"{source}: {UnknownName('effect', name, EFFECTS)}")
    kind = EFFECTS[name]
    defaults = {field.name: field.default for field in fields(kind)}
    joints = entry.pop("joints", robot.joints)
    if not isinstance(joints, list | tuple):
        raise BadInput(
            f"{source}: effect {name} needs 'joints: [names]', not '{joints}'"
        )
    joints = tuple(str(joint) for joint in joints)
    try:
        UnknownName.refuse("joint", joints, robot.joints)
        values = np.array(entry.pop("values"), float).ravel()
        shape = {key: _like(defaults[key], value) for key, value in entry.items()}
        effect = kind(joints=joints, **shape).with_values(values)
    except (BadInput, UnknownName) as error:
        raise BadInput(f"{source}: {error}") from None
    except (KeyError, TypeError, ValueError, OverflowError):
        raise BadInput(
            f"{source}: effect {name} needs 'values: [numbers]' and takes {', '.join(defaults)}"
        ) from None
    expected = len(effect.parameters(robot))
    if len(values) != expected or not np.isfinite(values).all():
        raise BadInput(
            f"{source}: effect {name} has {len(values)} values, expected {expected}, all finite"
        )
    return effect


def _like(default: Any, value: Any) -> Any:
    """A value of the type of a default: yes or no, a finite number, or other."""
    if isinstance(default, bool) != isinstance(value, bool):
        raise TypeError
    if isinstance(default, float):
        value = float(value)
        if not np.isfinite(value):
            raise ValueError
    return value
