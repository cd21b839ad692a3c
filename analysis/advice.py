"""Experiments that decide an undecided diagnosis."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from excitant.robots.effects import Effect, separating_experiment

if TYPE_CHECKING:
    from excitant.design import FourierTrajectory

Key = tuple[str, tuple[str, ...], str, tuple[str, ...]]
"""Name and joints of the cause found, and of its rival."""


@dataclass(frozen=True)
class Advice:
    """Experiment that decides between two rivals, with the names of ``result.json``."""

    experiment: str  # what to do, as a sentence
    # expected, in standard deviations; None for an action
    separation: float | None = None
    repetitions: int | None = None  # runs that are needed
    file: str | None = None  # motion to run


@dataclass(frozen=True, eq=False)
class Plan:
    """Experiments that decide an undecided diagnosis; general actions when empty."""

    experiments: Mapping[Key, Advice] = field(default_factory=dict)
    motions: tuple[
        FourierTrajectory, ...
    ] = ()  # in the order of their files separate-1, …

    def of(self, found: Effect, rival: Effect) -> Advice:
        """Experiment for a pair; the general action where no motion was looked for."""
        advice = self.experiments.get(key(found, rival))
        return advice or Advice(separating_experiment(found, rival))


def key(found: Effect, rival: Effect) -> Key:
    """Names and joints of a pair."""
    return found.name, found.joints, rival.name, rival.joints
