"""Recipe: a hidden effect whose joints and shape chance has decided, but not its size."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from excitant.robots.motion import Array
from excitant.robots.plant.habits import Habits
from excitant.robots.plant.hidden_effect import STRUCTURES, HiddenEffect

Rng = np.random.Generator
Make = Callable[[float], HiddenEffect]


@dataclass(frozen=True, eq=False)
class Recipe:
    """An effect that lacks only its size.

    Attributes:
        make: The effect at a scale.
        guess: Scale that may give what is wanted.
        most: Largest scale that such arms may have.
    """

    make: Make
    guess: float = 1.0
    most: float = np.inf


def rms(x: Array) -> float:
    """Root mean square, never zero."""
    return max(float(np.sqrt(np.mean(np.square(x)))), 1e-9)


def either_way(rng: Rng) -> float:
    """A sign by chance."""
    return float(rng.choice([-1.0, 1.0]))


def effect_on(kind: str, habit: Habits, *joints: int, **parameters: float) -> HiddenEffect:
    """The effect on joints by index, parameters as plain numbers."""
    names = tuple(habit.robot.joints[j] for j in joints)
    values = tuple((name, float(value)) for name, value in parameters.items())
    effect, structure = ("unknown", kind) if kind in STRUCTURES else (kind, "")
    first = names[0] if names else ""
    return HiddenEffect(effect, first, values, names if len(names) > 1 else (), structure)


def any_joint(habit: Habits, rng: Rng) -> int:
    """A joint by chance."""
    return int(rng.integers(habit.nv))


def neighbours(habit: Habits, rng: Rng) -> tuple[int, int]:
    """A joint and the next."""
    j = int(rng.integers(max(habit.nv - 1, 1)))
    return j, j + 1


def strong_joint(habit: Habits, rng: Rng) -> int:
    """A joint by chance that moves much: where elastic gears bend."""
    strong = np.flatnonzero(habit.inertia >= 0.1 * habit.inertia.max())
    return int(rng.choice(strong))


def one_or_all(habit: Habits, rng: Rng) -> tuple[int, ...]:
    """A joint by chance, or one time in four all of them."""
    return tuple(range(habit.nv)) if rng.random() < 0.25 else (any_joint(habit, rng),)
