"""One thing in a robot's description that looks wrong."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ModelWarning:
    """What looks wrong, where, and what to do about it.

    Attributes:
        check: Which check says so, e.g. ``placeholder_inertia``.
        where: The links or joints concerned.
        sentence: What was found and what to do, in one line.
        hint: Whether it may well be right, or matters to no torque.
    """

    check: str
    where: tuple[str, ...]
    sentence: str
    hint: bool = False

    def __str__(self) -> str:
        return f"{', '.join(self.where)}: {self.sentence}"
