"""The table of an arm: each standard parameter and effect coefficient, and what is known of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from excitant.analysis.given import Given
from excitant.analysis.needed import Addition, Question, needed
from excitant.analysis.practical import aim, verdict
from excitant.robots.base_parameters import BaseParameters
from excitant.robots.effects import Effect
from excitant.robots.parameters import UNITS
from excitant.robots.robot import Robot
from excitant.robots.torque import effect_values


@dataclass(frozen=True)
class Entry:
    """One standard parameter or effect coefficient in the table of an arm.

    Attributes:
        name: Its name.
        owner: Link or joint it belongs to.
        unit: Its unit.
        category: ``unique``, ``combined`` or ``unidentifiable``.
        expressions: Base parameters that it is part of.
        needed: What would show it by itself; empty where that is shown already.
        value: Estimate, or the value of the model as given; None if neither is known.
        prior: Value before any data; None if there is none.
        std: Standard deviation with the prior, ±100 % of each link, counted in; None without
            a motion.
        std_data: Standard deviation from the data alone; inf where they do not show it by
            itself; None without a motion.
        influence: How far it follows the prior, 0 to 1; None without a motion or prior.
        decided_by: ``data``, ``prior`` or ``physics`` (the limit of what a body can have); empty
            without a motion or prior.
        verdict: In a word, how well the motion determines it by itself; empty without a motion.
    """

    name: str
    owner: str
    unit: str
    category: str
    expressions: tuple[str, ...]
    needed: str
    value: float | None = None
    prior: float | None = None
    std: float | None = None
    std_data: float | None = None
    influence: float | None = None
    decided_by: str = ""
    verdict: str = ""

    @property
    def rel_std(self) -> float | None:
        """Standard deviation relative to the value; None when either is not known or zero."""
        return self.std / abs(self.value) if self.value and self.std is not None else None

    @property
    def prior_dominated(self) -> bool:
        """Whether the prior decides it: nothing shows it, or it follows the prior."""
        return self.category == "unidentifiable" or self.decided_by == "prior"


def parameter_units(robot: Robot, effects: Sequence[Effect]) -> tuple[str, ...]:
    """Units of the standard parameters followed by those of effects."""
    return (*UNITS * robot.nv, *(p.unit for e in effects for p in e.parameters(robot)))


def entries(
    robot: Robot,
    effects: Sequence[Effect],
    base: BaseParameters,
    category: Sequence[str],
    candidates: Sequence[Addition],
    given: Given | None = None,
) -> tuple[Entry, ...]:
    """Every parameter of ``base.names``.

    Args:
        robot: The arm.
        effects: Effects whose coefficients are unknown too.
        base: Base parameters, of p parameters.
        category: Of each of the p parameters.
        candidates: Experiments that could be added.
        given: A motion or recording.
    """
    known = dict(zip(robot.parameter_names, robot.phi.tolist(), strict=True))
    known |= effect_values(robot)
    units, expressions = parameter_units(robot, effects), np.array(base.expressions, object)
    unknown = Question(np.eye(len(units)), np.zeros(len(units)))
    wanted = needed(base.regrouping, unknown, candidates) if given is None else ("",) * len(units)
    plain = tuple(
        Entry(
            name,
            name.rpartition(".")[0],
            units[k],
            category[k],
            tuple(expressions[base.regrouping[:, k] != 0]),
            wanted[k],
            value=known.get(name),
            prior=known.get(name),
        )
        for k, name in enumerate(base.names)
    )
    return plain if given is None else _under(given, base, plain, candidates)


def _under(
    given: Given, base: BaseParameters, plain: Sequence[Entry], candidates: Sequence[Addition]
) -> tuple[Entry, ...]:
    """The entries with what a motion says of them."""
    p, columns = len(plain), list(base.columns)
    alone = np.array([entry.category == "unique" for entry in plain])
    std = np.where(alone, given.seen.std(np.eye(p)[:, columns]), np.inf)
    quiet = (np.abs(given.x) + 2 * std) * np.maximum(given.loudness, 1e-300) < 1
    size = aim(given.x, std, quiet, given.loudness)
    wanted = needed(given.seen.R, Question(np.eye(p), size), candidates)
    overall, decided = np.zeros(p), ("",) * p
    if given.influence is not None:
        overall, decided = given.influence.overall, given.influence.decided_by
    means = None if given.prior is None else given.prior.mean[: 10 * given.prior.links]
    return tuple(
        replace(
            entry,
            needed=wanted[k],
            value=float(given.x[k]) if given.known[k] else None,
            prior=entry.prior if means is None or k >= len(means) else float(means[k]),
            std=None if given.std is None else float(given.std[k]),
            std_data=float(std[k]),
            influence=None if given.influence is None else float(overall[k]),
            decided_by=decided[k],
            verdict=verdict(float(std[k]), float(given.x[k]), bool(quiet[k]))
            if alone[k]
            else entry.category,
        )
        for k, entry in enumerate(plain)
    )
