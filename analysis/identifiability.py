"""Identifiability of an arm's parameters, link by link: structural, and by one motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from excitant.analysis.structure import Structure, structure
from excitant.analysis.uncertainty import (
    NOT_SHOWN,
    TORQUE_NOISE,
    Direction,
    Practical,
    candidate_experiments,
    dependent_groups,
    experiments_needed,
    known_values,
    practical,
    resolution,
    verdict,
    weak_directions,
)
from excitant.exceptions import BadInput, UnknownName
from excitant.robots.base_parameters import BaseParameters
from excitant.robots.dh import distal_frames
from excitant.robots.effects import Effect
from excitant.robots.motion import Array, Motion, freeze, read_only
from excitant.robots.parameters import UNITS, moved_parameters
from excitant.robots.robot import Robot
from excitant.robots.shown import Shown, Table, data_frame
from excitant.robots.threads import on_one_thread

if TYPE_CHECKING:
    import pandas as pd

    from excitant.analysis.experiment import Experiment, PriorInfluence
    from excitant.identify.estimate import Estimate
    from excitant.identify.excitation import Persistency

_NAMED = 8  # parameters listed in a sentence


@dataclass(frozen=True)
class ParameterIdentifiability:
    """One standard parameter or effect coefficient; results of a motion are None without one."""

    name: str
    owner: str  # link or joint it belongs to
    unit: str
    category: str  # unique, combined or unidentifiable
    expressions: tuple[str, ...]  # base parameters that it is part of
    margin: (
        float  # factor on the tolerance of all rank decisions that changes its category
    )
    needed: str  # experiment that would show it by itself; empty where it is shown
    value: float | None = None  # estimate, or the value of the model as given, if known
    prior: float | None = None  # value before any data
    std: float | None = None  # standard deviation, prior included
    # from the data alone; inf where they do not show it by itself
    std_data: float | None = None
    influence: float | None = None  # how far it follows the prior, 0 to 1
    decided_by: str = ""  # data, prior or physics (the limit of physical consistency)
    verdict: str = ""  # in a word, how well the motion determines it by itself

    @property
    def rel_std(self) -> float | None:
        """Standard deviation relative to the value; None when either is not known or zero."""
        return (
            self.std / abs(self.value) if self.value and self.std is not None else None
        )

    @property
    def prior_dominated(self) -> bool:
        """Whether the prior decides it: it is unidentifiable, or follows the prior."""
        return self.category == "unidentifiable" or self.decided_by == "prior"

    def result(self) -> dict[str, Any]:
        """Its entry in ``result.json``."""
        same = (
            "name",
            "unit",
            "category",
            "value",
            "std",
            "rel_std",
            "std_data",
            "prior",
        )
        return {
            key: getattr(self, key) for key in (*same, "prior_dominated", "margin")
        } | {
            "verdict": self.verdict or None,
            "prior_influence": self.influence,
            "decided_by": self.decided_by or None,
            "expression": "; ".join(self.expressions) or None,
            "needed": self.needed or None,
        }


@dataclass(frozen=True, eq=False)
class PracticalIdentifiability:
    """Practical identifiability of an arm by one motion or recording."""

    condition_number: (
        float  # of the unscaled base columns, cond₂(W); inf when some are not shown
    )
    singular_values: Array  # of the base columns scaled to unit length, greatest first
    practical: tuple[Practical, ...]  # each base parameter
    directions: tuple[Direction, ...]  # of the base parameters, unseen or weakest
    influence: PriorInfluence | None  # None where the arm's links give no prior
    noise: Array  # of each measured joint's torque, assumed or estimated [N·m]
    resting: tuple[str, ...]  # joints that do not move
    basis: str  # where the standard deviations come from, as a sentence
    persistency: Persistency | None  # None when not all torques are measured

    def __post_init__(self) -> None:
        freeze(self, "singular_values", "noise")

    def result(self) -> dict[str, Any]:
        """Everything as plain values."""
        practical = [p.result() for p in self.practical]
        lost = [row for row in practical if row["verdict"] == NOT_SHOWN]
        return {
            "condition_number": self.condition_number,
            "practical": practical,
            "basis": self.basis,
            "noise": self.noise,
            "resting_joints": self.resting,
            "not_shown": [
                {key: row[key] for key in ("name", "needed")} for row in lost
            ],
            "directions": [d.result() for d in self.directions],
            "persistency": self.persistency and self.persistency.result(),
        }


@dataclass(frozen=True, eq=False, repr=False)
class Identifiability(Shown):
    """Identifiability of an arm: structural, and practical where a motion is given.

    Attributes:
        robot: The arm.
        effects: Effects whose coefficients are unknown too.
        structure: Structural identifiability.
        entries: Every parameter of ``base.names``.
        follow: Groups of parameters of which any one determines the others.
        motion: Practical identifiability by the given motion or recording; None without one.
        notes: Remarks to the user, as sentences.
    """

    robot: Robot
    effects: tuple[Effect, ...]
    structure: Structure
    entries: tuple[ParameterIdentifiability, ...]
    follow: tuple[tuple[str, ...], ...] = ()
    motion: PracticalIdentifiability | None = None
    notes: tuple[str, ...] = ()

    @property
    def base(self) -> BaseParameters:
        """Base parameters of links and effects."""
        return self.structure.base

    @property
    def practical(self) -> tuple[Practical, ...]:
        """Each base parameter under the motion; empty without one."""
        return self.motion.practical if self.motion else ()

    def result(self) -> dict[str, Any]:
        """Contents of ``result.json`` as plain values."""
        links = zip(self.robot.links, self.robot.joints, strict=True)
        without: dict[str, Any] = {
            "condition_number": None,
            "practical": [],
            "basis": "",
        }
        return {
            "verb": "analyze",
            "robot": self.robot.name,
            "standard_parameters": len(self.base.names),
            "base_parameters": len(self.base),
            "gap": self.base.gap,
            "structure": {
                "circumstances": self.structure.circumstances,
                "close": self.structure.close,
                "marginal": self.structure.marginal,
                **self.structure.decomposition(),
            },
            "links": [self._link(link, joint) for link, joint in links],
            "follow_each_other": self.follow,
            **(self.motion.result() if self.motion else without),
            "notes": list(self.notes),
        }

    def _link(self, link: str, joint: str) -> dict[str, Any]:
        base = self.base
        own = [k for k, e in enumerate(self.entries) if e.owner in (link, joint)]
        entries = [self.entries[k] for k in own]
        return {
            "link": link,
            "joint": joint,
            "unique": [e.name for e in entries if e.category == "unique"],
            "unidentifiable": [
                e.name for e in entries if e.category == "unidentifiable"
            ],
            "combined": [
                {
                    "expression": text,
                    "members": [base.names[k] for k in np.flatnonzero(row)],
                }
                for row, text in zip(base.regrouping, base.expressions, strict=True)
                if np.count_nonzero(row) > 1 and row[own].any()
            ],
            "parameters": [e.result() for e in entries],
        }

    def series(self) -> dict[str, Array]:
        """For figures: singular values under a motion (r,), or of the structure with vectors."""
        found = self.structure
        if found.frames is not None:
            values = found.singular_values
            vectors = found.singular_vectors
            return {"structural_values": values, "structural_vectors": vectors}
        return {"singular_values": self.motion.singular_values} if self.motion else {}

    def to_frame(
        self, of: Literal["parameters", "base_parameters"] = "parameters"
    ) -> pd.DataFrame:
        """Every parameter, or every base parameter under the motion, a row each."""
        UnknownName.refuse("table", [of], ("parameters", "base_parameters"))
        rows = self.entries if of == "parameters" else self.practical
        return data_frame(
            [row.result() for row in rows], "name", ("value", "std", "verdict")
        )

    def _lines(self) -> list[str]:
        kinds = self.structure.category
        shown = ""
        if self.motion is not None:
            lost = sum(p.verdict == NOT_SHOWN for p in self.practical)
            shown = (
                f"motion: condition number {self.motion.condition_number:.4g}, shows "
                f"{len(self.practical) - lost} of {len(self.practical)} base parameters"
            )
        return [
            f"Identifiability of {self.robot.name}: {len(self.base)} base parameters",
            f"of {len(kinds)} parameters, "
            + ", ".join(f"{kinds.count(kind)} {kind}" for kind in dict.fromkeys(kinds)),
            shown,
        ]

    def _table(self) -> Table:
        if self.motion is None:
            rows = [
                (name, kind)
                for name, kind in zip(
                    self.base.names, self.structure.category, strict=True
                )
            ]
            return ("parameter", "identifiable"), rows
        shown = [(p.expression, p.value, p.std, p.verdict) for p in self.practical]
        return ("base parameter", "value", "std", "shown by the motion"), shown


@on_one_thread
def analyze(
    robot: Robot,
    *,
    effects: Sequence[Effect] = (),
    motion: Motion | None = None,
    estimate: Estimate | None = None,
    noise: Sequence[float] | None = None,
    moving: Sequence[str] | None = None,
    measured: Sequence[str] | None = None,
    frames: Literal["joint", "dh"] = "joint",
    window: float | None = None,
    rng: np.random.Generator | None = None,
) -> Identifiability:
    """Identifiability of an arm's parameters.

    Args:
        robot: The arm.
        effects: Effects whose coefficients are unknown too.
        motion: A motion to judge, with torque noise that is independent at every instant.
        estimate: Instead, an estimate from a recording, with its noise and motion.
        noise: Torque noise of each joint [N·m]; 1 % of each joint's limit if None.
        moving: Joints that move, where no motion is given; all if None.
        measured: Joints whose torque is measured; all if None, and for an estimate.
        frames: Frames that the links' parameters are about: those of their joints, or those of the
            standard Denavit-Hartenberg convention, in which Khosla (1987) counts.
        window: Length [s] of the windows in which excitation is judged; the whole motion if None.
        rng: Draws perturbed priors for refits of an estimate; without it, the influence of the
            prior follows from linear theory.

    Raises:
        BadInput: A motion is to be judged, but a joint has no torque limit to scale noise by;
            noise that does not fit the arm; or circumstances that contradict each other.
        UnknownName: A joint that the arm does not have.
    """
    shown = motion is not None or estimate is not None
    refused = {
        "moving: leave it out, a trajectory or recording determines which joints move": (
            moving is not None and shown
        ),
        "measured: leave it out, a recording has the torques of all joints": (
            estimate is not None and measured is not None
        ),
        "noise: give a trajectory too; the noise of a recording is estimated": (
            noise is not None and motion is None
        ),
        "frames: a motion is judged in joint frames; leave one of both out": (
            frames == "dh" and shown
        ),
        "window: give a trajectory or recording too": window is not None and not shown,
        "moving: name at least one joint": moving is not None and not moving,
        "measured: name at least one joint": measured is not None and not measured,
    }
    for why, wrong in refused.items():
        if wrong:
            raise BadInput(why)
    effects = tuple(effects) if estimate is None else estimate.model.effects
    places = distal_frames(robot) if frames == "dh" else None
    found = structure(robot, effects, moving=moving, measured=measured, frames=places)
    rows = [
        j for j, name in enumerate(robot.joints) if measured is None or name in measured
    ]
    given: Experiment | None = None
    if estimate is not None:
        from excitant.analysis.experiment import recorded_experiment

        given = recorded_experiment(robot, found.base, estimate, rng)
    elif motion is not None:
        from excitant.analysis.experiment import planned_experiment

        given = planned_experiment(robot, found.base, effects, motion, noise, rows)
    noise_of_all = _noise_of_all(robot, given, rows)
    still = [
        j
        for j, name in enumerate(robot.joints)
        if moving is not None and name not in moving
    ]
    rests, pose = (
        (still, np.zeros(robot.nv))
        if given is None
        else (given.resting, given.q.mean(axis=0))
    )
    candidates = candidate_experiments(robot, effects, noise_of_all, rests, pose, rows)
    table = _entries(robot, effects, found, candidates, given)
    R = found.base.regrouping if given is None else given.information.R
    follow = tuple(
        tuple(found.base.names[k] for k in group) for group in dependent_groups(R)
    )
    if given is None:
        said = [] if places is None else [_contained(robot, found)]
        return Identifiability(robot, effects, found, table, follow, notes=tuple(said))
    under = _under_motion(robot, effects, found.base, given, candidates, window)
    notes = (*_notes(found, under, table), *given.notes)
    return Identifiability(robot, effects, found, table, follow, under, notes)


def _contained(robot: Robot, found: Structure) -> str:
    """How many of each link's ten parameters torque contains, as a sentence."""
    seen = np.array(found.category[: 10 * robot.nv]) != "unidentifiable"
    counts = seen.reshape(-1, 10).sum(axis=1)
    each = ", ".join(
        f"{name} {count}" for name, count in zip(robot.links, counts, strict=True)
    )
    return (
        "inertias are about the links' Denavit-Hartenberg frames (distal); of the ten parameters "
        f"of each link, torque contains: {each}"
    )


def _noise_of_all(robot: Robot, given: Experiment | None, rows: Sequence[int]) -> Array:
    # of unmeasured joints, and where only rank matters, 1 % of the limit, or 1 N·m
    limits = robot.limits.torque
    usable = np.isfinite(limits) & (limits > 0)
    sigma = np.asarray(
        np.where(usable, TORQUE_NOISE * np.where(usable, limits, 0.0), 1.0), float
    )
    if given is not None:
        sigma[list(rows)] = given.sigma
    return sigma


def _under_motion(
    robot: Robot,
    effects: Sequence[Effect],
    base: BaseParameters,
    given: Experiment,
    candidates: Mapping[str, Array],
    window: float | None,
) -> PracticalIdentifiability:
    from excitant.identify.excitation import persistency

    excitation = None
    if len(given.sigma) == robot.nv:
        noise = given.sigma
        excitation = persistency(
            robot, given.motion, effects, sigma=noise, window=window
        )
    columns = list(base.columns)
    seen = given.information
    lengths = np.linalg.norm(seen.R[:, columns], axis=0)
    scaled = seen.R[:, columns] / np.where(lengths > 0, lengths, 1.0)
    units = [_units(robot, effects)[k] for k in columns]
    return PracticalIdentifiability(
        condition_number=seen.condition_number,
        singular_values=read_only(np.linalg.svd(scaled, compute_uv=False)),
        practical=practical(base, given.beta, seen, candidates),
        directions=weak_directions(
            base, units, seen, _sizes(robot, effects, base, given)
        ),
        influence=given.influence,
        noise=given.sigma,
        resting=tuple(robot.joints[j] for j in given.resting),
        basis=given.basis,
        persistency=excitation,
    )


def _sizes(
    robot: Robot, effects: Sequence[Effect], base: BaseParameters, given: Experiment
) -> Array:
    # scale of each: its prior uncertainty, or else what makes as much torque as the noise
    if given.prior is not None:
        from excitant.identify.prior import base_prior

        return np.asarray(
            np.sqrt(np.diag(base_prior(robot, effects, base).covariance)), float
        )
    signal = given.information.signal[list(base.columns)]
    return np.asarray(1 / np.maximum(signal, 1e-6 * signal.max()), float)


def _notes(
    found: Structure,
    under: PracticalIdentifiability,
    table: Sequence[ParameterIdentifiability],
) -> tuple[str, ...]:
    base = found.base
    notes = []
    if under.resting:
        verb = "rests" if len(under.resting) == 1 else "rest"
        notes.append(f"{', '.join(under.resting)} {verb} in this motion")
    lost: dict[str, list[str]] = {}
    for k, parameter in zip(base.columns, under.practical, strict=True):
        if parameter.verdict == NOT_SHOWN:
            lost.setdefault(parameter.needed, []).append(base.names[k])
    for what, names in lost.items():
        more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
        notes.append(
            f"this motion does not show {', '.join(names[:_NAMED])}{more} "
            f"({len(names)} of {len(base)} base parameters); "
            f"shown {'' if what.startswith('never') else 'by '}{what}"
        )
    if (influence := under.influence) is None:
        return tuple(notes)
    from excitant.analysis.experiment import STEP

    named = [entry for entry in table if entry.category != "unidentifiable"]
    prior, physics = (
        sum(e.decided_by == who for e in named) for who in ("prior", "physics")
    )
    notes.append(
        f"apart from unidentifiable ones, {prior} of {len(table)} parameters follow the prior "
        "rather than the data: that two sets of initial values agree proves nothing there"
    )
    if influence.refits:
        notes.append(
            f"{influence.refits} fits with priors changed by up to {100 * STEP:g} % moved no base "
            f"parameter by more than {influence.base_move.max():.2g} of its standard deviation"
        )
    if physics:
        notes.append(
            f"for {physics} more, whose bodies are at the limit of physical consistency, that "
            "limit decides for any prior; without it they would follow the prior"
        )
    return tuple(notes)


def _units(robot: Robot, effects: Sequence[Effect]) -> tuple[str, ...]:
    return (*UNITS * robot.nv, *(p.unit for e in effects for p in e.parameters(robot)))


def _entries(
    robot: Robot,
    effects: Sequence[Effect],
    found: Structure,
    candidates: Mapping[str, Array],
    given: Experiment | None,
) -> tuple[ParameterIdentifiability, ...]:
    base = found.base
    units = _units(robot, effects)
    unique = np.array(found.category) == "unique"
    before = known_values(robot, effects)
    if found.frames is not None:
        bodies = robot.phi.reshape(-1, 10)
        before[: 10 * robot.nv] = moved_parameters(
            bodies, np.linalg.inv(found.frames)
        ).ravel()
    R = base.regrouping
    size = np.zeros(len(units))
    said: dict[str, Sequence[Any]] = {"value": before, "prior": before}
    if given is not None:
        R = given.information.R
        influence = given.influence
        std = given.information.std(np.eye(len(units))[:, list(base.columns)])
        std = np.where(unique, std, np.inf)
        negligible, size = resolution(given.x, std, given.information.signal)
        x = given.x.tolist()
        factors = np.ones(len(x))
        if given.told:
            factors = np.array([f for f, _ in given.told])
            units = tuple(u for _, u in given.told)
        values = (factors * given.x).tolist()
        said["std_data"] = (factors * std).tolist()
        said["value"] = [
            v if known else None for v, known in zip(values, given.known, strict=True)
        ]
        said["verdict"] = [
            verdict(std[k], x[k], bool(negligible[k])) if unique[k] else kind
            for k, kind in enumerate(found.category)
        ]
        if given.prior is not None:
            bodies = given.prior.mean[: 10 * given.prior.links].tolist()
            said["prior"] = [*bodies, *before[len(bodies) :]]
        if given.std is not None:
            said["std"] = given.std.tolist()
        if influence is not None:
            said["influence"] = influence.overall.tolist()
            said["decided_by"] = influence.decided_by
    needed = experiments_needed(R, np.eye(len(units)), size, candidates)
    expressions = np.array(base.expressions, object)
    return tuple(
        ParameterIdentifiability(
            name=name,
            owner=name.rpartition(".")[0],
            unit=units[k],
            category=found.category[k],
            expressions=tuple(expressions[base.regrouping[:, k] != 0]),
            margin=float(found.margin[k]),
            needed=needed[k],
            **{key: values[k] for key, values in said.items()},
        )
        for k, name in enumerate(base.names)
    )
