"""`diagnose`: the causes of a given model's errors, each with its gain on data not fitted."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from excitant.analysis.candidates import (
    TOLERANCE,
    Observed,
    gain_root,
    gather,
    observed,
)
from excitant.analysis.confirmation import (
    FLOOR,
    Extender,
    Extension,
    Finding,
    HeldOut,
    confirmed,
    finding_of,
    held_out,
    off_bodies,
    off_effects,
    unextended,
)
from excitant.analysis.discrimination import Plan
from excitant.analysis.evidence import Key
from excitant.analysis.explanation import (
    Curve,
    at_rest,
    causes,
    curve_of,
    headline,
    left_of,
    placeholders,
    reason_to_downgrade,
    sentence,
    shared_friction,
    sizes,
    unexplained,
)
from excitant.analysis.residuals import Residual, residuals
from excitant.analysis.selection import frictionless, idle, rivals, select
from excitant.analysis.set_up import SetUp, refined, set_up
from excitant.analysis.validation import Forward, Refit, forward, refit
from excitant.exceptions import ExcitantError
from excitant.identify.accuracy import Accuracy, series
from excitant.identify.drive_gains import DriveGains, current_gains
from excitant.identify.preprocessing import Segment, certain_rows
from excitant.identify.prior import prior_parameters
from excitant.identify.recording import Recordings, recordings_of
from excitant.identify.rows import Data, gains_of, predicted_torque, split, states, told
from excitant.robots.base_parameters import base_parameters
from excitant.robots.effects import Effect, plain, standard_effects
from excitant.robots.motion import Array
from excitant.robots.robot import Robot
from excitant.robots.shown import Shown, Table, data_frame, share
from excitant.robots.threads import on_one_thread

if TYPE_CHECKING:
    import pandas as pd

_NO_PLAN = Plan()
# standard deviation of the logarithm of a gain from what bodies alone show
_GAINS_OFF = 1.0
_LEAST_GAIN = 0.2  # of the gain assumed: least that is believed
_NEAR = 0.5  # that ends the search
_LACKS = 0.5  # of the friction found: a model with less lacks it
# of what friction explains: a part whose rivals do not matter to the whole
_MINOR = 0.05
_LITTLE = 0.01  # of the squared error: a round that gains less is the last
_SHOWN = 7  # causes, beyond which slight ones are told in a note
_HARDLY_OFF = "what it changes is known no better than by half of its size"
_COLUMNS = (
    "joints",
    "sentence",
    "verdict",
    "explained",
    "holdout.rms_before",
    "holdout.rms_after",
)
_ROUNDS = 5  # of the search at most, as effects may depend on the model that it finds


@dataclass(frozen=True, eq=False, repr=False)
class Diagnosis(Shown):
    """Errors of a given model on the hold-out, by cause.

    Attributes:
        robot: The given robot.
        data: Fitted and held-out data.
        train: Columns of the given robot at the fitted rows.
        held: The hold-out, with the torque of the given robot.
        extension: The extended model.
        findings: Causes in order of importance.
        given_residuals: Residuals of the given model, joint by joint.
        residuals: Residuals of the extended model.
        waterfall: Error relative to the given model's, as causes are added.
        notes: Remarks to the user, as sentences.
        drive: Drive gains, if torque was recorded as current.
        set_up: Mounting, zero positions and repairs of the data, if not those given.
    """

    robot: Robot
    data: Data
    train: Observed
    held: HeldOut
    extension: Extension
    findings: tuple[Finding, ...]
    given_residuals: tuple[Residual, ...]
    residuals: tuple[Residual, ...]
    waterfall: tuple[tuple[str, float], ...]
    notes: tuple[str, ...]
    drive: DriveGains | None = None
    set_up: SetUp | None = None

    @property
    def left(self) -> Array:
        """Residual of the extended model at the rows of the hold-out, (n, nv) [torque unit]."""
        return np.asarray(self.held.series.measured - self.extension.predicted, float)

    @cached_property
    def simulation(self) -> Accuracy:
        """Accuracy of the given model on the hold-out."""
        return self.held.series.accuracy(self.held.simulated)

    @cached_property
    def extended(self) -> Accuracy:
        """Accuracy of the extended model on the hold-out."""
        return self.held.series.accuracy(self.extension.predicted)

    @cached_property
    def states(self) -> tuple[Array, Array, Array]:
        """Positions, velocities, accelerations of the joints at these rows, each (n, nv)."""
        return states(self.data.validate)

    @cached_property
    def refit(self) -> Refit:
        """Fit of the inertias alone."""
        tau = series(self.data.train).measured * self.held.gains
        return refit(self.train, tau, self.held, self.extension.predicted)

    @cached_property
    def forward(self) -> Forward:
        """Both models simulated forward over short windows of the hold-out."""
        return forward(
            self.robot, self.extension.model, self.data.validate, self.held.gains
        )

    @cached_property
    def headline(self) -> str:
        """The main finding in a sentence, its reservation, and the number of further findings."""
        return headline(self)

    @cached_property
    def curves(self) -> list[Curve]:
        """The figure of evidence for each item of `ordered`."""
        return [curve_of(self, item) for item in self.ordered]

    @cached_property
    def bare(self) -> frozenset[str]:
        """Joints of which the given model has less than half the friction, if they are most."""
        robot = self.robot
        known = [e for e in self.robot.effects if e.family == "friction"]
        rms = self.held.series.rms
        nothing = np.zeros_like(self.held.simulated)
        given = sum(
            (self.held.observed.columns(e) @ np.array(e.values) for e in known), nothing
        )
        found = [f for f in self.findings if f.effect.family == "friction"]
        more = sum((f.torque for f in found), nothing)
        where = {joint for f in found for joint in f.effect.joints}
        lacking = rms(given / self.held.gains) < _LACKS * rms(more)
        bare = where & {
            joint for joint, yes in zip(robot.joints, lacking, strict=True) if yes
        }
        return frozenset(bare if 2 * len(bare) > robot.nv > 2 else ())

    @cached_property
    def groups(self) -> list[list[Finding]]:
        """Findings by cause: all friction that the model lacks, else an effect of one verdict.

        Of more than seven, those that are too slight to be told from what larger causes leave are
        in the notes instead.
        """
        return [
            g for k, g in enumerate(self._all_groups) if k < _SHOWN or not _slight(g)
        ]

    @property
    def _too_slight(self) -> str:
        """Note on causes that are no findings of their own; else empty."""
        names = [
            f"{plain(group[0].effect.name)} at {', '.join(f.effect.joints[0] for f in group)}"
            for group in self._all_groups[_SHOWN:]
            if _slight(group)
        ]
        said = (
            f"Too slight to be told from what larger causes leave: {'; '.join(names)}."
        )
        return said if names else ""

    @cached_property
    def _all_groups(self) -> list[list[Finding]]:
        groups: dict[Hashable, list[Finding]] = {}
        for finding in self.findings:
            effect = finding.effect
            key = effect.name, finding.verdict, effect.jointwise or effect.joints
            missing = effect.family == "friction" and {*effect.joints} <= self.bare
            turns = self.robot.revolute[finding.joint]
            groups.setdefault((turns, "friction" if missing else key), []).append(
                finding
            )
        return sorted(
            groups.values(), key=lambda group: -sum(f.explained for f in group)
        )

    @cached_property
    def ordered(self) -> list[list[Finding] | list[Residual]]:
        """Groups of findings by their gain, the set-up first, and what is left visibly."""
        known = (
            () if self.set_up is None else (*self.set_up.faults, *self.set_up.effects)
        )
        first = {(effect.name, joint) for effect in known for joint in effect.joints}
        items = list[tuple[float, list[Finding] | list[Residual]]]()
        for group in self.groups:
            lead = group[0].effect
            of_set_up = (lead.name, lead.joints[0]) in first
            items.append(
                (np.inf if of_set_up else sum(f.explained for f in group), group)
            )
        if left := sorted((r for r in self.residuals if r.visible), key=self.share_of)[
            ::-1
        ]:
            items.append((sum(map(self.share_of, left)), left))
        return [item for _, item in sorted(items, key=lambda pair: -pair[0])]

    def amended(self, faults: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
        """Faults of the recordings as `Checked.entries` tells them, with what is repaired here."""
        mine = self.set_up
        return [
            {**f, "repaired": f["repaired"] or (mine is not None and mine.amends(f))}
            for f in faults
        ]

    def unit(self, joint: int | None = None) -> str:
        """Unit of the torque of a joint, or of all."""
        return self.robot.torque_unit(self.data.unit, joint)

    def share_of(self, left: Residual) -> float:
        """One joint's residual beyond noise as a share of the given model's squared error."""
        rms = self.extended.rms
        given = (self.simulation.rms / rms) ** 2
        size = rms[self.robot.joint_index(left.joint)]
        return float((left.structured / size) ** 2 / given.sum())

    def before_and_after(self, group: Sequence[Finding]) -> tuple[float, float]:
        """Rms error on the hold-out without and with a cause, over its joints of one unit."""
        robot = self.robot
        rms = self.held.series.rms
        joints = list({j for f in group for j in f.effect.affected(robot)})
        alike = [
            j for j in joints if robot.revolute[j] == robot.revolute[group[0].joint]
        ]
        torque = np.sum([f.torque for f in group], axis=0)
        before, after = (
            float(np.sqrt((rms(e)[alike] ** 2).mean()))
            for e in (self.left + torque, self.left)
        )
        return before, after

    def result(self, plan: Plan = _NO_PLAN) -> dict[str, Any]:
        """Contents of result.json, with a plan's experiments or else general actions."""
        notes = [*self.notes, placeholders(self), at_rest(self), shared_friction(self)]
        notes.append(self._too_slight)
        labels = (f"torque [{self.unit(curve.joint)}]" for curve in self.curves)
        both = zip(self.given_residuals, self.residuals, strict=True)
        joints = self.robot.joints
        return {
            "verb": "diagnose",
            "robot": self.robot.name,
            "headline": self.headline,
            "unit": self.unit(),
            "cutoff_hz": self.data.cutoff_hz,
            **(
                {"drive_gain_Nm_per_A": None}
                if self.drive is None
                else self.drive.result()
            ),
            "holdout": self.data.holdout,
            "simulation": {"joints": self._joints(self.simulation)},
            "faults": [],
            "findings": [
                entry
                | {
                    "figure": {
                        "x_label": curve.x_label,
                        "y_label": y,
                        "joint": joints[curve.joint],
                    }
                }
                for entry, curve, y in zip(
                    self._findings(plan), self.curves, labels, strict=True
                )
            ],
            "unexplained": [
                {
                    "joint": left.joint,
                    "share": float(np.clip(1 - r2, 0, 1)),
                    **left.unexplained(),
                }
                for left, r2 in zip(self.residuals, self.extended.r2, strict=True)
            ],
            "extended": {"joints": self._joints(self.extended)},
            "error": {
                "joints": [
                    {"name": given.joint, **given.shown(), "left": left.shown()}
                    for given, left in both
                ]
            },
            "refit": self._refit(),
            "forward": self._forward(),
            "waterfall": [
                {"label": label, "rms": size} for label, size in self.waterfall
            ],
            "notes": [note for note in notes if note],
        }

    def series(self) -> dict[str, Array]:
        """Measured, simulated and extended torque on the hold-out, and the evidence per finding."""
        arrays = {
            "t": self.held.series.t,
            "measured": self.held.series.measured,
            "simulated": self.held.simulated,
            "extended": self.extension.predicted,
        }
        for k, curve in enumerate(self.curves):
            for name in ("x", "residual", "fit", "rival"):
                if (values := getattr(curve, name)) is not None:
                    arrays[f"finding{k}_{name}"] = values
        return arrays

    def _findings(self, plan: Plan) -> list[dict[str, Any]]:
        return [
            _cause(self, group, plan)
            if (group := causes(item))
            else _unknown(self, left_of(item))
            for item in self.ordered
        ]

    def to_frame(self) -> pd.DataFrame:
        """Findings in order of importance, a row each, with what `result` says of them."""
        return data_frame(self._findings(_NO_PLAN), "effect", _COLUMNS)

    def _joints(self, accuracy: Accuracy) -> list[dict[str, Any]]:
        return [
            {"name": joint, **accuracy.entry(j)}
            for j, joint in enumerate(self.robot.joints)
        ]

    def _refit(self) -> dict[str, Any]:
        try:
            found = self.refit
        except ExcitantError as error:
            return {"sentence": f"Re-fitting the inertias alone failed: {error}"}
        bodies = [f.effect for f in self.findings if f.effect.role != "torque"]
        wrong = {
            self.robot.links[row]
            for effect in bodies
            for row in effect.rows(self.robot)
        }
        said = found.sentence(
            self.robot.joints, self.unit(), bool(self.findings), wrong
        )
        return {"sentence": said, **found.result(self.robot.joints)}

    def _forward(self) -> dict[str, Any]:
        try:
            return self.forward.result(self.robot)
        except ExcitantError as error:
            return {"joints": [], "notes": [f"Forward simulation failed: {error}"]}

    def _lines(self) -> list[str]:
        errors = (
            share(float(np.nanmedian(x.nrmse)))
            for x in (self.simulation, self.extended)
        )
        count = f"{len(self.findings)} finding{'s' * (len(self.findings) != 1)}"
        return [
            f"Errors of the model of {self.robot.name} by cause: {count}",
            self.headline,
            f"error {' → '.join(errors)} (nrmse, median over joints, on the hold-out)",
        ]

    def _table(self) -> Table:
        rows = [
            (
                f.effect.name,
                ", ".join(f.effect.joints),
                f.verdict,
                f.rms_before,
                f.rms_after,
            )
            for f in self.findings
        ]
        heads = ("cause", "joints", "verdict", "rms error without it", "with it")
        return heads, rows


def _cause(
    diagnosis: Diagnosis, group: Sequence[Finding], plan: Plan
) -> dict[str, Any]:
    """One cause at some joints; friction of several kinds with each kind as a part."""
    kinds = list(dict.fromkeys(f.effect.name for f in group))
    robot = diagnosis.robot
    several = len(kinds) > 1
    before, after = diagnosis.before_and_after(group)
    whole = sum(f.explained for f in group)
    rivals = {
        r.candidate.key: (f.effect, r)
        for f in group
        if f.explained > several * _MINOR * whole
        for r in f.rivals
        if not several or r.candidate.effect.family != "friction"
    }
    named = all(f.verdict == "named" for f in group) or (several and not rivals)
    entry = {
        "effect": "friction" if several else kinds[0],
        "joints": list(
            dict.fromkeys(joint for f in group for joint in f.effect.joints)
        ),
        "sentence": sentence(group, diagnosis),
        "parameters": [
            entry for f in group for entry in _parameters(f, robot, diagnosis.drive)
        ],
        "sizes": [
            {"name": s.name, "value": s.value, "std": s.std, "unit": s.unit}
            for f in group
            for s in sizes(f, diagnosis)
        ],
        "explained": whole,
        "holdout": {"rms_before": before, "rms_after": after},
        "unit": diagnosis.unit(group[0].joint),
        "verdict": "named" if named else "undecided",
        "doubt": ""
        if named
        else "; ".join(dict.fromkeys(f.downgrade for f in group if f.downgrade)),
        "rivals": [
            {
                "effect": name,
                "joints": list(joints),
                "why": f"explains this motion equally well (to {max(rival.deviations, 0.0):.1f} "
                f"standard errors; |cos| between the signatures is {rival.cosine:.2f})",
                **asdict(plan.of(effect, rival.candidate.effect)),
            }
            for (name, joints), (effect, rival) in rivals.items()
        ],
    }
    if several:
        alike = {(f.effect.name, f.verdict): list[Finding]() for f in group}
        for f in group:
            alike[f.effect.name, f.verdict].append(f)
        entry["parts"] = [_cause(diagnosis, part, plan) for part in alike.values()]
    return entry


def _parameters(
    found: Finding, robot: Robot, drive: DriveGains | None
) -> Iterator[dict[str, Any]]:
    by_fit = np.sqrt(np.diag(found.covariance)).tolist()
    rows = zip(
        found.effect.parameters(robot),
        found.effect.values or (),
        found.given,
        found.std.tolist(),
        by_fit,
        strict=True,
    )
    for p, value, given, std, std_in_units in rows:
        factor, unit = told(p, robot, drive)
        spread = std if factor == 1 else factor * std_in_units
        yield {
            "name": p.name,
            "value": factor * value,
            "given": factor * given,
            "unit": unit,
        } | {"std": spread}
    for s in found.effect.search.shapes:
        if s.positive and not s.trial:
            name = f"{found.effect.joints[0]}.{s.name}"
            value = getattr(found.effect, s.name)
            unit = found.effect.shape_unit(robot, s)
            yield {"name": name, "value": value, "std": None, "unit": unit}


def _unknown(diagnosis: Diagnosis, left: Sequence[Residual]) -> dict[str, Any]:
    """What no cause explains, of all joints at once."""
    rms = float(np.sqrt(np.mean([each.rms**2 for each in left])))
    joint = diagnosis.robot.joint_index(left[0].joint)
    return {
        "effect": "unknown",
        "joints": [each.joint for each in left],
        "sentence": unexplained(left, diagnosis),
        "parameters": [],
        "explained": 0.0,
        "share": sum(map(diagnosis.share_of, left)),
        "holdout": {"rms_before": rms, "rms_after": rms},
        "unit": diagnosis.unit(joint),
        "verdict": "unknown",
        "structure": "; ".join(dict.fromkeys(each.structure for each in left)),
        "rivals": [],
    }


@on_one_thread
def diagnose(
    robot: Robot,
    recordings: Recordings,
    *,
    validate: Recordings = (),
    cutoff_hz: float | None = None,
) -> Diagnosis:
    """Find the causes of a given model's errors.

    Args:
        robot: The given model: inertias and effects as they are believed to be.
        recordings: Recordings to explain.
        validate: Likewise, to judge on; the last 30 % of each recording when empty.
        cutoff_hz: Cut-off of the torque filter [Hz].

    Raises:
        BadRecording: Recordings that cannot be used.
        BadRobot: Links without mass.
    """
    given = robot
    recordings = recordings_of(recordings, robot)
    validate = recordings_of(validate, robot)
    prior = prior_parameters(robot)
    mounted, amended = set_up(given, recordings, validate)
    fitted = amended[: len(recordings)]
    unseen = amended[len(recordings) :]
    data = split(fitted, unseen, cutoff_hz)
    measured = series(data.train).measured
    robot = mounted.robot
    notes = [data.holdout, *mounted.notes]
    drive = data.drive
    train = observed(robot, data.train)
    if data.unit == "A":
        usual = standard_effects(robot.joints)
        base = base_parameters(robot, usual)
        moves = certain_rows(usual, robot.joints, data.train)
        drive = current_gains(robot, base, train.matrix(usual), measured, moves)
    tau = measured * gains_of(robot, data, drive)
    mounted = refined(mounted, data.train, tau, prior)
    if mounted.robot is not robot:
        robot = mounted.robot
        train = observed(robot, data.train)
    if drive is not None and data.unit == "A":
        drive = _regained(robot, train, tau, prior, drive)
    if drive is not None:
        notes.append(drive.sentence(robot.joints))
    gains = gains_of(robot, data, drive)
    doubt = None if drive is None else drive.covariance
    tau = measured * gains
    held = held_out(robot, data.validate, gains, given)
    evidence = gather(robot, train, tau, prior, gains=doubt)
    first = Extender(prior, train, tau, held, evidence, doubt)
    known = frozenset((effect.name, effect.joints) for effect in mounted.effects)
    fit = _iterated(first, known)
    if fit.refuted:
        again = _iterated(first, known | fit.refuted)
        if held.worse(fit.predicted, again.predicted, FLOOR):
            fit = again
    if held.worse(fit.predicted, held.mounted):
        fit = unextended(fit.evidence, held)
    error = held.series.measured - fit.predicted
    errors = residuals(
        robot.joints, data.validate, held.given, held.given, held.simulated
    )
    left = residuals(robot.joints, data.validate, error, held.given, fit.predicted)
    paying = [
        replace(
            finding, rivals=tuple(rivals(fit.evidence, robot, fit.chosen, candidate))
        )
        for finding, candidate in zip(fit.findings, fit.chosen, strict=True)
        if finding.pays
    ]
    if (off := off_bodies(robot, fit, held)) is not None:
        paying.append(off)
    paying += off_effects(robot, fit, held)
    paying = [
        f
        for f in (_with_gains(each, robot, drive) for each in paying)
        if not f.as_given
    ]
    off_by = TOLERANCE * max(1.0, fit.evidence.tolerance[0])
    first_of_all = [
        _of_set_up(mounted, effect, fit, held) for effect in mounted.effects
    ]
    if mounted.faults:
        raw = split(recordings, validate, data.cutoff_hz).validate
        first_of_all = [*_of_faults(mounted, raw, fit, held), *first_of_all]
    first_of_all = [
        replace(
            f,
            rivals=mounted.rivals,
            downgrade=_HARDLY_OFF if f.near_given else f.downgrade,
        )
        for f in first_of_all
    ]
    judged = first_of_all + [
        replace(
            f,
            downgrade=f.downgrade
            or reason_to_downgrade(robot, f, paying, left, off_by),
        )
        for f in sorted(paying, key=lambda f: -f.explained)
    ]
    steps = _waterfall(held, error, [f for f in judged if f.effect.values])
    found = fit, tuple(judged), errors, left, steps, tuple(notes), drive
    return Diagnosis(given, data, train, held, *found, mounted)


def _regained(
    robot: Robot, train: Observed, tau: Array, prior: Array, drive: DriveGains
) -> DriveGains:
    """Drive gains that suit the given bodies and friction best, beside the causes that there are.

    Where no friction is given, the gain stays that of the given bodies.
    """
    bare = frictionless(robot)
    if bare == {*robot.joints}:
        return drive
    before = drive.covariance + _GAINS_OFF**2 * np.diag(
        [joint not in bare for joint in robot.joints]
    )
    root = gain_root(before)
    gains = drive.gains
    for _ in range(_ROUNDS):
        scaled = tau * (gains / drive.gains)
        evidence, chosen = select(
            gather(robot, train, scaled, prior, gains=before), robot
        )
        x, covariance = evidence.solve(chosen)
        off = 1 + root @ x[evidence.gains]
        gains = gains / np.maximum(off, _LEAST_GAIN)
        if (off > _NEAR).all():
            break
    known = (
        root
        @ covariance[np.ix_(evidence.gains, evidence.gains)]
        @ root.T
        / np.outer(off, off)
    )
    return replace(drive, gains=gains, covariance=known)


def _slight(group: Sequence[Finding]) -> bool:
    """Whether a group is undecided, without rivals, and within the misfit of larger causes."""
    open_ = all(f.downgrade and not f.rivals for f in group)
    return open_ and sum(f.explained for f in group) < TOLERANCE**2


def _of_set_up(
    mounted: SetUp, effect: Effect, fit: Extension, held: HeldOut
) -> Finding:
    """The finding of a change of mounting or zero position."""
    model = mounted.without(effect, fit.model)
    torque = (
        fit.predicted - predicted_torque(model, held.observed.segments) / held.gains
    )
    given = (0.0,) * len(effect.values or ())
    covariance = np.diag(np.square(mounted.std_of(effect)))
    return finding_of(mounted.robot, fit, held, effect, torque, given, covariance)


def _of_faults(
    mounted: SetUp, raw: Sequence[Segment], fit: Extension, held: HeldOut
) -> Iterator[Finding]:
    """Findings of the faults of the data that are repaired, together without their repair."""
    error = series(raw).measured - predicted_torque(fit.model, raw) / held.gains
    left = held.series.measured - fit.predicted
    torque = error - left if error.shape == left.shape else np.zeros_like(left)
    for fault in mounted.faults:
        found = finding_of(
            mounted.robot, fit, held, fault, torque, (), np.zeros((0, 0))
        )
        # the given model's own error is that on the repaired data
        share = 1 - (found.rms_after / max(found.rms_before, 1e-300)) ** 2
        yield replace(found, explained=float(share))


def _with_gains(finding: Finding, robot: Robot, drive: DriveGains | None) -> Finding:
    """A finding whose uncertainty counts that of the drive gains that its size rests on."""
    return replace(finding, by_gains=_by_gains(finding, robot, drive))


def _by_gains(finding: Finding, robot: Robot, drive: DriveGains | None) -> Array:
    """Errors of a finding's coefficients by one standard deviation of the drive gains.

    It is of their logarithms: a value far below the given one is as unsure as that.
    """
    values = np.array(finding.effect.values or ())
    size: Array = np.copysign(np.maximum(np.abs(values), np.abs(finding.given)), values)
    if drive is None:
        return 0 * size
    effect = finding.effect
    own = [
        robot.joint_index(joint) for joint in effect.joints if effect.role == "torque"
    ]
    spread = (
        max(np.sqrt(drive.covariance[j, j]) for j in own) if own else drive.scale_std
    )
    return np.asarray(spread * size, float)


def _iterated(first: Extender, refuted: frozenset[Key] = frozenset()) -> Extension:
    """The model with the causes that the hold-out confirms, searched for again with that model."""
    held = first.held
    robot = first.train.robot
    best: Extension | None = None
    extender = first
    evidence = first.evidence
    for _ in range(_ROUNDS):
        if best is not None:
            train = extender.train.by(best.model, keep=idle(evidence, best.chosen))
            evidence = gather(
                robot, train, first.tau, first.prior, best.chosen, gains=first.gains
            )
            extender = replace(first, train=train, evidence=evidence)
        evidence, chosen = select(extender.evidence, robot, refuted)
        fit = confirmed(replace(extender, evidence=evidence), chosen)
        if best is not None and held.worse(fit.predicted, best.predicted, FLOOR):
            break
        before = best
        best = fit
        same = before is not None and {c.key for c in before.chosen} == {
            c.key for c in fit.chosen
        }
        if (
            before is not None
            and same
            and not held.worse(before.predicted, fit.predicted, _LITTLE)
        ):
            break
        if not any(
            c.effect.physics.on_model or c.effect.search.shapes for c in fit.chosen
        ):
            break
    assert best is not None
    return best


def _waterfall(
    held: HeldOut, extended: Array, findings: Sequence[Finding]
) -> tuple[tuple[str, float], ...]:
    steps = ["given model"]
    errors = [held.given]
    for finding in findings:
        errors.append(errors[-1] - finding.torque)
        steps.append(
            f"+ {plain(finding.effect.name)} at {', '.join(finding.effect.joints)}"
        )
    rms = np.array([held.series.rms(error) for error in (*errors, extended)])
    sizes = np.sqrt(((rms / rms[0]) ** 2).mean(axis=1))
    return tuple(zip([*steps, "all re-identified"], sizes.tolist(), strict=True))
