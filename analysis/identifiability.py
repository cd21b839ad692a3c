"""Identifiability of an arm's parameters, link by link: structural, and by one motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, cast

import numpy as np
from msgspec.structs import asdict

from excitant.analysis.structure import Structure, distal_frames, structure
from excitant.analysis.uncertainty import (
    NOT_SHOWN,
    Experiment,
    candidate_experiments,
    default_noise,
    experiments_needed,
    planned_experiment,
    practical,
    recorded_experiment,
    relative,
    resolution,
    verdict,
)
from excitant.exceptions import BadInput, UnknownName
from excitant.identify.excitation import WindowExcitation, persistency
from excitant.identify.prior import decided_by
from excitant.names import listed
from excitant.results import Category, ParameterIdentifiability, Practical
from excitant.robots.base_parameters import BaseParameters
from excitant.robots.effects import Effect
from excitant.robots.motion import Array, Motion, Noun, read_only
from excitant.robots.parameters import moved_parameters
from excitant.robots.robot import Robot
from excitant.robots.shown import Shown, Table, data_frame
from excitant.robots.threads import on_one_thread
from excitant.robots.torque import column_units, known_values

if TYPE_CHECKING:
    import pandas as pd

    from excitant.identify.estimate import Estimate

LISTED = 8  # parameters listed in a sentence


@dataclass(frozen=True, eq=False)
class PracticalIdentifiability(Noun):
    """Practical identifiability of an arm by one motion or recording."""

    condition_number: (
        float  # of the unscaled base columns, cond₂(W); inf when some are not shown
    )
    singular_values: (
        Array  # of the base columns scaled to unit length, greatest first
    )
    practical: tuple[Practical, ...]  # each base parameter
    noise: Array  # of each measured joint's torque, assumed or estimated [N·m]
    resting: tuple[str, ...]  # joints that do not move
    basis: str  # where the standard deviations come from, as a sentence
    persistency: WindowExcitation | None  # None when not all torques are measured

    def result(self) -> dict[str, Any]:
        """Everything as plain values."""
        lost = [p for p in self.practical if p.verdict == NOT_SHOWN]
        return {
            "condition_number": self.condition_number,
            "practical": [asdict(p) for p in self.practical],
            "basis": self.basis,
            "noise": self.noise,
            "resting_joints": self.resting,
            "not_shown": [{"name": p.name, "needed": p.needed} for p in lost],
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
        motion: Practical identifiability by the given motion or recording; None without one.
        notes: Remarks to the user, as sentences.
    """

    robot: Robot
    effects: tuple[Effect, ...]
    structure: Structure
    entries: tuple[ParameterIdentifiability, ...]
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
            **(self.motion.result() if self.motion else without),
            "notes": list(self.notes),
        }

    def _link(self, link: str, joint: str) -> dict[str, Any]:
        base = self.base
        owners = [e.name.rpartition(".")[0] for e in self.entries]
        own = [k for k, owner in enumerate(owners) if owner in (link, joint)]
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
            "parameters": [asdict(e) for e in entries],
        }

    def series(self) -> dict[str, Array]:
        """For figures: singular values under a motion (r,), or of the structure with vectors."""
        if self.structure.frames is not None:
            return {
                "structural_values": self.structure.singular_values,
                "structural_vectors": self.structure.singular_vectors,
            }
        return (
            {"singular_values": self.motion.singular_values} if self.motion else {}
        )

    def to_frame(
        self, of: Literal["parameters", "base_parameters"] = "parameters"
    ) -> pd.DataFrame:
        """Every parameter, or every base parameter under the motion, a row each."""
        UnknownName.refuse("table", [of], ("parameters", "base_parameters"))
        rows = self.entries if of == "parameters" else self.practical
        return data_frame(
            [asdict(row) for row in rows], "name", ("value", "std", "verdict")
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
            + ", ".join(
                f"{kinds.count(kind)} {kind}" for kind in dict.fromkeys(kinds)
            ),
            shown,
        ]

    def _table(self) -> Table:
        if self.motion is None:
            rows = zip(self.base.names, self.structure.category, strict=True)
            return ("parameter", "identifiable"), list(rows)
        shown = [(p.name, p.value, p.std, p.verdict) for p in self.practical]
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

    Raises:
        BadInput: A motion is to be judged, but a joint has no torque limit to scale noise by;
            noise that does not fit the arm; or circumstances that contradict each other.
        UnknownName: A joint that the arm does not have.
    """
    judged = motion is not None or estimate is not None
    refused = {
        "moving: leave it out, a trajectory or recording determines which joints move": (
            moving is not None and judged
        ),
        "measured: leave it out, a recording has the torques of all joints": (
            estimate is not None and measured is not None
        ),
        "noise: give a trajectory too; the noise of a recording is estimated": (
            noise is not None and motion is None
        ),
        "frames: a motion is judged in joint frames; leave one of both out": (
            frames == "dh" and judged
        ),
        "moving: name at least one joint": moving is not None and not moving,
        "measured: name at least one joint": measured is not None and not measured,
    }
    for why, wrong in refused.items():
        if wrong:
            raise BadInput(why)
    effects = (
        tuple(effects)
        if estimate is None
        else estimate.physical.estimated(estimate.model.effects)
    )
    poses = distal_frames(robot) if frames == "dh" else None
    structural = structure(
        robot, effects, moving=moving, measured=measured, frames=poses
    )
    base = structural.base
    joints = list(enumerate(robot.joints))
    rows = [j for j, name in joints if measured is None or name in measured]
    rests: Sequence[int] = [
        j for j, name in joints if moving is not None and name not in moving
    ]
    pose = np.zeros(robot.nv)
    sigma = default_noise(robot)
    experiment: Experiment | None = None
    if estimate is not None:
        experiment = recorded_experiment(robot, base, estimate)
    elif motion is not None:
        experiment = planned_experiment(robot, base, effects, motion, noise, rows)
    if experiment is not None:
        rests = experiment.resting
        pose = experiment.q.mean(axis=0)
        sigma[rows] = experiment.sigma
    further = candidate_experiments(robot, effects, sigma, rests, pose, rows)
    entries = _entries(robot, effects, structural, further, experiment)
    known = robot, effects, structural, entries
    if experiment is not None:
        practical = _practical(robot, effects, base, experiment, further)
        notes = (*_notes(structural, practical, entries), *experiment.notes)
        return Identifiability(*known, practical, notes)
    notes = () if poses is None else (_contained(robot, structural),)
    return Identifiability(*known, notes=notes)


def _contained(robot: Robot, structural: Structure) -> str:
    """How many of each link's ten parameters torque contains, as a sentence."""
    seen = np.array(structural.category[: 10 * robot.nv]) != "unidentifiable"
    counts = seen.reshape(-1, 10).sum(axis=1)
    each = ", ".join(
        f"{name} {count}" for name, count in zip(robot.links, counts, strict=True)
    )
    return (
        "inertias are about the links' Denavit-Hartenberg frames (distal); of the ten parameters "
        f"of each link, torque contains: {each}"
    )


def _practical(
    robot: Robot,
    effects: Sequence[Effect],
    base: BaseParameters,
    experiment: Experiment,
    further: Mapping[str, Array],
) -> PracticalIdentifiability:
    sigma = experiment.sigma
    information = experiment.information
    R = information.R[:, base.columns]
    lengths = np.linalg.norm(R, axis=0)
    scaled = R / np.where(lengths > 0, lengths, 1.0)
    return PracticalIdentifiability(
        condition_number=information.condition_number,
        singular_values=read_only(np.linalg.svd(scaled, compute_uv=False)),
        practical=practical(base, experiment.beta, information, further),
        noise=sigma,
        resting=tuple(robot.joints[j] for j in experiment.resting),
        basis=experiment.basis,
        persistency=persistency(robot, experiment.motion, effects, sigma=sigma)
        if len(sigma) == robot.nv
        else None,
    )


def _notes(
    structural: Structure,
    under: PracticalIdentifiability,
    table: Sequence[ParameterIdentifiability],
) -> tuple[str, ...]:
    base = structural.base
    notes = []
    if under.resting:
        verb = "rests" if len(under.resting) == 1 else "rest"
        notes.append(f"{', '.join(under.resting)} {verb} in this motion")
    lost: dict[str, list[str]] = {}
    for k, parameter in zip(base.columns, under.practical, strict=True):
        if parameter.verdict == NOT_SHOWN:
            needed = parameter.needed or ""
            lost.setdefault(needed, []).append(base.names[k])
    for what, names in lost.items():
        notes.append(
            f"this motion does not show {listed(names, LISTED)} "
            f"({len(names)} of {len(base)} base parameters); "
            f"shown {'' if what.startswith('never') else 'by '}{what}"
        )
    decided = [e.decided_by for e in table if e.category != "unidentifiable"]
    if any(decided):
        notes.append(
            f"apart from unidentifiable ones, {decided.count('prior')} of {len(table)} parameters "
            "follow the prior rather than the data: that two sets of initial values agree proves "
            "nothing there"
        )
    return tuple(notes)


def _entries(
    robot: Robot,
    effects: Sequence[Effect],
    structural: Structure,
    further: Mapping[str, Array],
    experiment: Experiment | None,
) -> tuple[ParameterIdentifiability, ...]:
    base = structural.base
    units = column_units(robot, effects)
    nominal = known_values(robot, effects)
    if structural.frames is not None:
        to_joints = np.linalg.inv(structural.frames)
        bodies = moved_parameters(robot.phi.reshape(-1, 10), to_joints)
        nominal[: 10 * robot.nv] = bodies.ravel().tolist()
    R = base.regrouping
    size = np.zeros(len(units))
    columns: dict[str, Sequence[Any]] = {"value": nominal, "prior": nominal}
    if experiment is not None:
        R = experiment.information.R
        size, judged = _judged(base, structural.category, experiment)
        columns |= judged
        if experiment.told:
            units = tuple(unit for _, unit in experiment.told)
        if experiment.bodies is not None:
            links = experiment.bodies.ravel().tolist()
            columns["prior"] = [*links, *nominal[len(links) :]]
    needed = experiments_needed(R, np.eye(len(units)), size, further)
    expressions = np.array(base.expressions, object)
    entries = []
    for k, name in enumerate(base.names):
        category = cast(Category, structural.category[k])
        known = {key: values[k] for key, values in columns.items()}
        entries.append(
            ParameterIdentifiability(
                name,
                units[k],
                category,
                **known,
                rel_std=relative(known.get("std"), known["value"]),
                prior_dominated=category == "unidentifiable"
                or known.get("decided_by") == "prior",
                margin=float(structural.margin[k]),
                expression="; ".join(expressions[base.regrouping[:, k] != 0])
                or None,
                needed=needed[k] or None,
            )
        )
    return tuple(entries)


def _judged(
    base: BaseParameters, category: Sequence[str], experiment: Experiment
) -> tuple[Array, dict[str, Sequence[Any]]]:
    """Sizes as of `resolution`, and what an experiment says of each parameter, by field."""
    information = experiment.information
    x = experiment.x
    unique = np.array(category) == "unique"
    std = information.std(np.eye(len(x))[:, base.columns])
    std = np.where(unique, std, np.inf)
    negligible, size = resolution(x, std, information.signal)
    factors = np.array([factor for factor, _ in experiment.told] or np.ones(len(x)))
    values = zip((factors * x).tolist(), experiment.known, strict=True)
    columns = {
        "std_data": (factors * std).tolist(),
        "value": [value if known else None for value, known in values],
        "verdict": [
            verdict(std[k], x[k], bool(negligible[k])) if unique[k] else kind
            for k, kind in enumerate(category)
        ],
    }
    if experiment.std is not None:
        columns["std"] = [
            None if np.isnan(std) else std for std in experiment.std.tolist()
        ]
    if experiment.influence is not None:
        columns["prior_influence"] = experiment.influence.tolist()
        columns["decided_by"] = decided_by(experiment.influence, category)
    return size, columns
