"""What can be known of an arm's parameters, link by link, and how well one motion shows it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from excitant.analysis.directions import Direction, correlation, weak_directions
from excitant.analysis.next_experiment import Addition, Question, additions, shown_by
from excitant.analysis.persistency import persistency_result
from excitant.analysis.practical import (
    NOT_SHOWN,
    TORQUE_NOISE,
    Practical,
    aim,
    companions,
    practical,
)
from excitant.analysis.prior_influence import STEP, PriorInfluence
from excitant.analysis.structure import Structure, structure
from excitant.analysis.uncertainty import (
    Entry,
    Measurement,
    entries,
    parameter_units,
    planned,
    recorded,
)
from excitant.exceptions import BadInput
from excitant.identify.base_prior import base_prior
from excitant.identify.estimate import Estimate
from excitant.robots.base_parameters import BaseParameters
from excitant.robots.effects import Effect
from excitant.robots.html_table import html_table
from excitant.robots.motion import Array, Motion, freeze, read_only
from excitant.robots.robot import Robot

_NAMED = 8  # parameters in a sentence


@dataclass(frozen=True, eq=False)
class UnderMotion:
    """What one motion, or one recording, shows of an arm.

    Attributes:
        condition_number: Of the unscaled base columns, cond₂(W); inf when some are not shown.
        singular_values: Of the base columns scaled to unit length, greatest first.
        practical: Each base parameter.
        directions: Directions of the base parameters that are not seen or seen worst.
        correlation: Of the base parameters, shape (r, r).
        needed: What would show each base parameter; empty where the motion does.
        influence: How the prior decides; None where the arm's links give no prior.
        noise: Torque noise of each joint that was assumed or found, shape (nv,) [N·m].
        rests: Joints that do not move.
        basis: Where the standard deviations come from, as a sentence.
        persistency: Whether it is persistently exciting, as `persistency_result` says it;
            None when not all torques are measured.
    """

    condition_number: float
    singular_values: Array
    practical: tuple[Practical, ...]
    directions: tuple[Direction, ...]
    correlation: Array
    needed: tuple[str, ...]
    influence: PriorInfluence | None
    noise: Array
    rests: tuple[str, ...]
    basis: str
    persistency: dict[str, Any] | None

    def __post_init__(self) -> None:
        freeze(self, "singular_values", "correlation", "noise")


@dataclass(frozen=True, eq=False)
class Identifiability:
    """Identifiability of an arm: structural, and practical where a motion is given.

    Attributes:
        robot: The arm.
        effects: Effects whose coefficients are unknown too.
        structure: What torque can show in principle.
        entries: Every parameter of ``base.names``.
        follow: Groups of parameters that follow from each other once one is known.
        motion: What the given motion or recording shows; None without one.
        notes: What the user should know, as sentences.
    """

    robot: Robot
    effects: tuple[Effect, ...]
    structure: Structure
    entries: tuple[Entry, ...]
    follow: tuple[tuple[str, ...], ...] = ()
    motion: UnderMotion | None = None
    notes: tuple[str, ...] = ()

    @property
    def base(self) -> BaseParameters:
        """Base parameters of links and effects."""
        return self.structure.base

    @property
    def category(self) -> tuple[str, ...]:
        """``unique``, ``combined`` or ``unidentifiable`` for each parameter of ``base.names``."""
        return self.structure.category

    @property
    def practical(self) -> tuple[Practical, ...]:
        """Each base parameter under the motion; empty without one."""
        return self.motion.practical if self.motion else ()

    @property
    def condition_number(self) -> float | None:
        """Of the unscaled base columns under the motion, cond₂(W); None without one."""
        return self.motion.condition_number if self.motion else None

    def _repr_html_(self) -> str:
        title = f"Identifiability of {self.robot.name}: {len(self.base)} base parameters"
        if self.motion is None:
            rows = [(name, kind) for name, kind in zip(self.base.names, self.category, strict=True)]
            return html_table(title, ("parameter", "identifiable"), rows)
        shown = [(p.expression, p.value, p.std, p.verdict) for p in self.practical]
        return html_table(title, ("base parameter", "value", "std", "shown by the motion"), shown)


def analyze(
    robot: Robot,
    *,
    effects: Sequence[Effect] = (),
    motion: Motion | None = None,
    estimate: Estimate | None = None,
    noise: Sequence[float] | None = None,
    moving: Sequence[str] | None = None,
    measured: Sequence[str] | None = None,
    rng: np.random.Generator | None = None,
) -> Identifiability:
    """Identifiability of an arm's parameters.

    Args:
        robot: The arm.
        effects: Effects whose coefficients are unknown too.
        motion: A motion to judge, with torque noise that is independent at every instant.
        estimate: Instead, what was identified from a recording: its noise and motion.
        noise: Torque noise of each joint [N·m]; 1 % of each joint's limit if None.
        moving: Joints that move, where no motion says it; all if None.
        measured: Joints whose torque is measured; all if None, and for an estimate.
        rng: Draws perturbed priors for refits of an estimate; without it, the influence of the
            prior follows from linear theory.

    Raises:
        BadInput: A motion is to be judged, but a joint has no torque limit to scale noise by;
            noise that does not fit the arm; or circumstances that contradict each other.
        UnknownName: A joint that the arm does not have.
        Infeasible: A refit failed.
    """
    _refuse_contradictions(motion, estimate, noise, moving, measured)
    effects = tuple(effects) if estimate is None else estimate.model.effects
    found = structure(robot, effects, moving=moving, measured=measured)
    rows = [j for j, name in enumerate(robot.joints) if measured is None or name in measured]
    given: Measurement | None = None
    if estimate is not None:
        given = recorded(robot, found.base, estimate, rng)
    elif motion is not None:
        given = planned(robot, found.base, effects, motion, noise, rows)
    noise_of_all = _noise_of_all(robot, given, rows)
    still = [j for j, name in enumerate(robot.joints) if moving is not None and name not in moving]
    rests, pose = (still, np.zeros(robot.nv)) if given is None else (given.rests, given.pose)
    candidates = additions(robot, effects, noise_of_all, rests, pose, rows)
    table = entries(robot, effects, found.base, found.category, candidates, given)
    shown = found.base.regrouping if given is None else given.seen.R
    follow = tuple(tuple(found.base.names[k] for k in group) for group in companions(shown))
    if given is None:
        return Identifiability(robot, effects, found, table, follow)
    excitation = None
    if len(rows) == robot.nv:
        excitation = persistency_result(robot, effects, given.motion, sigma=noise_of_all)
    under = _under_motion(robot, effects, found.base, given, candidates, excitation)
    notes = (*_notes(found, under, table), *given.notes)
    return Identifiability(robot, effects, found, table, follow, under, notes)


def _refuse_contradictions(
    motion: Motion | None,
    estimate: Estimate | None,
    noise: Sequence[float] | None,
    moving: Sequence[str] | None,
    measured: Sequence[str] | None,
) -> None:
    if moving is not None and (motion is not None or estimate is not None):
        raise BadInput("moving: a trajectory or recording says itself which joints move; leave out")
    if estimate is not None and measured is not None:
        raise BadInput("measured: is for motions before they are run; a recording has all torques")
    if noise is not None and motion is None:
        raise BadInput("noise: is for a trajectory, give one; a recording has its own noise")
    for name, joints in (("moving", moving), ("measured", measured)):
        if joints is not None and not joints:
            raise BadInput(f"{name}: name at least one joint")


def _noise_of_all(robot: Robot, given: Measurement | None, rows: Sequence[int]) -> Array:
    """Torque noise of every joint, shape (nv,) [N·m].

    Of those not measured, and where only rank is asked for, 1 % of the limit, or 1 N·m.
    """
    limits = robot.limits.torque
    usable = np.isfinite(limits) & (limits > 0)
    sigma = np.asarray(np.where(usable, TORQUE_NOISE * np.where(usable, limits, 0.0), 1.0), float)
    if given is not None:
        sigma[list(rows)] = given.sigma
    return sigma


def _under_motion(
    robot: Robot,
    effects: Sequence[Effect],
    base: BaseParameters,
    given: Measurement,
    candidates: Sequence[Addition],
    excitation: dict[str, Any] | None,
) -> UnderMotion:
    columns, seen = list(base.columns), given.seen
    found = practical(base, given.beta, seen)
    lengths = np.linalg.norm(seen.R[:, columns], axis=0)
    scaled = seen.R[:, columns] / np.where(lengths > 0, lengths, 1.0)
    plain = np.linalg.qr(given.W[:, :, columns].reshape(-1, len(base)), mode="r")
    std, quiet = np.array([p.std for p in found]), np.array([p.negligible for p in found])
    size = aim(given.beta, std, quiet, seen.loudness)
    units = [parameter_units(robot, effects)[k] for k in columns]
    return UnderMotion(
        condition_number=np.inf if len(seen.unseen) else float(np.linalg.cond(plain)),
        singular_values=read_only(np.linalg.svd(scaled, compute_uv=False)),
        practical=found,
        directions=weak_directions(base, units, seen, _sizes(robot, effects, base, given)),
        correlation=correlation(seen.covariance),
        needed=shown_by(seen.R, Question(base.regrouping, size), candidates),
        influence=given.influence,
        noise=given.sigma,
        rests=tuple(robot.joints[j] for j in given.rests),
        basis=given.basis,
        persistency=excitation,
    )


def _sizes(
    robot: Robot, effects: Sequence[Effect], base: BaseParameters, given: Measurement
) -> Array:
    """What counts as much of each base parameter: its prior uncertainty, shape (r,).

    Without a prior, what makes as much torque as the noise.
    """
    if given.prior is not None:
        return np.asarray(np.sqrt(np.diag(base_prior(robot, effects, base).covariance)), float)
    loud = given.seen.loudness
    return np.asarray(1 / np.maximum(loud, 1e-6 * loud.max()), float)


def _notes(found: Structure, under: UnderMotion, table: Sequence[Entry]) -> tuple[str, ...]:
    base, notes = found.base, []
    if under.rests:
        verb = "rests" if len(under.rests) == 1 else "rest"
        notes.append(f"{', '.join(under.rests)} {verb} in this motion")
    lost: dict[str, list[str]] = {}
    for k, (parameter, what) in enumerate(zip(under.practical, under.needed, strict=True)):
        if parameter.verdict == NOT_SHOWN:
            lost.setdefault(what, []).append(base.names[base.columns[k]])
    for what, names in lost.items():
        more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
        notes.append(
            f"this motion does not show {', '.join(names[:_NAMED])}{more} "
            f"({len(names)} of {len(base)} base parameters); shown by {what}"
        )
    return (*notes, *(_prior_notes(under.influence, table) if under.influence else ()))


def _prior_notes(influence: PriorInfluence, table: Sequence[Entry]) -> list[str]:
    named = [entry for entry in table if entry.category != "unidentifiable"]
    prior, physics = (sum(e.decided_by == who for e in named) for who in ("prior", "physics"))
    notes = [
        f"besides what no torque shows, {prior} of {len(table)} parameters follow the prior "
        "rather than the data: two sets of initial values that agree prove nothing there"
    ]
    if influence.refits:
        notes.append(
            f"{influence.refits} fits from priors moved by up to {100 * STEP:g} % moved no base "
            f"parameter by more than {influence.base_move.max():.2g} of its standard deviation"
        )
    if physics:
        notes.append(
            f"{physics} more would follow the prior if bodies were not at the limit of what can "
            "exist; there physical consistency decides, wherever the prior is"
        )
    return notes
