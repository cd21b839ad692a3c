"""`diagnose`: the causes of a nominal model's errors, each with its gain on data not fitted."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from excitant.analysis.candidates import Observed, gain_root, gather, observed
from excitant.analysis.confirmation import (
    Extender,
    Extension,
    Finding,
    Holdout,
    confirmed,
    errors_by_gains,
    finding_of,
    holdout_of,
    holdout_scale,
    kept_effects,
    off_bodies,
    unextended,
)
from excitant.analysis.diagnosis_result import (
    Plan,
    curve_of,
    findings_of,
    result_of,
)
from excitant.analysis.evidence import Key
from excitant.analysis.explanation import (
    Item,
    grouped,
    headline,
    is_slight,
    lacking_friction,
    ordered,
    reason_to_downgrade,
)
from excitant.analysis.residuals import Residual, residuals
from excitant.analysis.selection import (
    Rival,
    completed,
    frictionless,
    idle,
    rivals,
    select,
)
from excitant.analysis.set_up import SetUp, set_up
from excitant.analysis.thresholds import CONFIRMATION, EVIDENCE, SEARCH, VERDICT
from excitant.exceptions import BadInput, Infeasible, RankDeficient
from excitant.identify.accuracy import Accuracy, series
from excitant.identify.attenuation import coarseness, half_segments
from excitant.identify.drive_gains import DriveGains
from excitant.identify.estimators import estimated
from excitant.identify.least_squares import (
    LeastSquares,
    weighted_least_squares,
)
from excitant.identify.objections import objections
from excitant.identify.physical import fit_physical
from excitant.identify.preprocessing import Segment
from excitant.identify.prior import prior_parameters
from excitant.identify.recording import Recording, Recordings, recordings_of
from excitant.identify.repeats import LEAVES, Difference, differences
from excitant.identify.reversals import Turning, turned_rows, turning_notes
from excitant.identify.rows import (
    Data,
    FitRows,
    fitted,
    gains_of,
    identified_robot,
    predicted_torque,
    split,
)
from excitant.robots.base_parameters import base_parameters
from excitant.robots.effects import (
    Effect,
    standard_effects,
    turning_speed,
)
from excitant.robots.motion import Array
from excitant.robots.robot import Robot
from excitant.robots.shown import Shown, Table, data_frame, worst_and_median
from excitant.robots.threads import on_one_thread

if TYPE_CHECKING:
    import pandas as pd

_NO_PLAN = Plan()
_COLUMNS = (
    "joints",
    "sentence",
    "verdict",
    "explained",
    "holdout.rms_before",
    "holdout.rms_after",
)


@dataclass(frozen=True, eq=False, repr=False)
class Diagnosis(Shown):
    """Errors of a nominal model on the hold-out, by cause.

    Attributes:
        robot: The nominal robot.
        data: Fitted and held-out data.
        train: Columns of the nominal robot at the fitted rows.
        holdout: The hold-out, with the torque of the nominal robot.
        extension: The extended model.
        findings: Causes in order of importance.
        corrected: Nominal values within their tolerance that the data correct beyond chance.
        nominal_residuals: Residuals of the nominal model, joint by joint.
        residuals: Residuals of the extended model.
        notes: Remarks to the user, as sentences.
        drive: Drive gains, if torque was recorded as current.
        set_up: Mounting, zero positions and repairs of the data, if not the nominal ones.
        differences: What single recordings have otherwise, which was taken off.
    """

    robot: Robot
    data: Data
    train: Observed
    holdout: Holdout
    extension: Extension
    findings: tuple[Finding, ...]
    corrected: tuple[Finding, ...]
    nominal_residuals: tuple[Residual, ...]
    residuals: tuple[Residual, ...]
    notes: tuple[str, ...]
    drive: DriveGains | None = None
    set_up: SetUp | None = None
    differences: tuple[Difference, ...] = ()

    @property
    def undetermined(self) -> str:
        """Which drive gains are not known, and why, as a sentence; empty where there are none."""
        return self.drive.undetermined(self.robot.joints) if self.drive else ""

    @property
    def error(self) -> Array:
        """Error of the extended model at the rows of the hold-out, (n, nv) [torque unit]."""
        return self.holdout.series.measured - self.extension.predicted

    @property
    def squares(self) -> float:
        """Squares of that over those of the torque, summed over joints in motion."""
        moved = self.holdout.series.moves.any(axis=0)
        return float(np.nansum(self.extended.nrmse[moved] ** 2))

    @cached_property
    def simulation(self) -> Accuracy:
        """Accuracy of the nominal model on the hold-out."""
        return self.holdout.nominal_accuracy

    @cached_property
    def extended(self) -> Accuracy:
        """Accuracy of the extended model on the hold-out."""
        return self.holdout.series.accuracy(self.extension.predicted)

    @cached_property
    def headline(self) -> str:
        """The main finding in a sentence, its reservation, and the number of further findings."""
        told = [
            f"{each.recording} differs in {each.where(self.robot)}, which is taken off."
            for each in self.differences
        ]
        return " ".join([*told, headline(self)])

    @cached_property
    def no_friction(self) -> frozenset[str]:
        """Joints of which the nominal model has less than half the friction, if they are most."""
        return lacking_friction(self)

    @cached_property
    def groups(self) -> list[list[Finding]]:
        """Findings by cause; those too slight to distinguish are in the notes instead."""
        groups = enumerate(grouped(self))
        return [g for k, g in groups if k < VERDICT.listed or not is_slight(g)]

    @cached_property
    def ordered(self) -> list[Item]:
        """Groups of findings by their gain, the set-up first, and what remains visibly."""
        return ordered(self)

    def unit(self, joint: int | None = None) -> str:
        """Unit of the torque of a joint, or of all."""
        return self.robot.torque_unit(self.data.unit, joint)

    def before_and_after(self, group: Sequence[Finding]) -> tuple[float, float]:
        """Rms error on the hold-out without and with a cause, over its joints of one unit."""
        joints = list({j for f in group for j in f.effect.affected(self.robot)})
        lead = group[0].joint
        torque = np.sum([f.torque for f in group], axis=0)
        before = self.holdout.rms_like(self.error + torque, joints, lead)
        return before, self.holdout.rms_like(self.error, joints, lead)

    def result(self, plan: Plan = _NO_PLAN) -> dict[str, Any]:
        """Contents of result.json, with a plan's experiments or else general actions."""
        return result_of(self, plan)

    def series(self) -> dict[str, Array]:
        """Measured, simulated and extended torque on the hold-out, and the evidence per finding."""
        arrays = {
            "t": self.holdout.series.t,
            "measured": self.holdout.series.measured,
            "simulated": self.holdout.nominal,
            "extended": self.extension.predicted,
        }
        for k, item in enumerate(self.ordered):
            curve = curve_of(self, item)
            for name in ("x", "residual", "fit"):
                if (values := getattr(curve, name)) is not None:
                    arrays[f"finding{k}_{name}"] = values
        return arrays

    def to_frame(self) -> pd.DataFrame:
        """Findings in order of importance, a row each, with what `result` says of them."""
        return data_frame(findings_of(self, _NO_PLAN), "effect", _COLUMNS)

    def _lines(self) -> list[str]:
        joints = self.robot.joints
        before = worst_and_median(joints, self.simulation.nrmse)
        after = worst_and_median(joints, self.extended.nrmse)
        count = len(self.findings)
        return [
            f"Errors of the model of {self.robot.name} by cause: "
            f"{count} finding{'s' * (count != 1)}",
            self.headline,
            f"error at most {before} → {after} (nrmse, on the hold-out)",
        ]

    def _table(self) -> Table:
        heads = ("cause", "joints", "verdict", "rms error without it", "with it")
        return heads, [
            (
                f.effect.name,
                ", ".join(f.effect.joints),
                f.verdict,
                f.rms_before,
                f.rms_after,
            )
            for f in self.findings
        ]


@on_one_thread
def diagnose(
    robot: Robot,
    recordings: Recordings,
    *,
    validate: Recordings = (),
    cutoff_hz: float | None = None,
) -> Diagnosis:
    """Find the causes of a nominal model's errors.

    Args:
        robot: The nominal model: inertias and effects as they are believed to be.
        recordings: Recordings to explain.
        validate: Likewise, to judge on; the last 30 % of each recording when empty.
        cutoff_hz: Cut-off of the torque filter [Hz].

    Raises:
        BadRecording: Recordings that cannot be used.
        BadRobot: Links without mass.
    """
    recordings = recordings_of(recordings, robot)
    validate = recordings_of(validate, robot)
    mounted, repaired = set_up(robot, [*recordings, *validate])
    count = len(recordings)
    parts = repaired[:count], repaired[count:]
    data = split(*parts, cutoff_hz)
    raw = (
        split(recordings, validate, data.cutoff_hz).validate
        if mounted.faults
        else ()
    )
    logs = fitted(*parts)
    identified = _as_identified(mounted.robot, data, logs)
    diagnosis = _of_data(mounted, data, identified, logs, raw)
    # what a repair does is judged on the data as they are
    if raw or identified.fit is None:
        return diagnosis
    model = identified.model
    found = differences(model, identified.rows, identified.fit)
    if not found:
        return diagnosis
    alike = _without(data, found, model, identified.rows.gains)
    identified = _as_identified(mounted.robot, alike, logs)
    again = _of_data(mounted, alike, identified, logs, raw)
    if again.squares >= LEAVES * diagnosis.squares:
        return diagnosis
    return replace(again, differences=tuple(found))


def _without(
    data: Data, found: Sequence[Difference], model: Robot, gains: Array
) -> Data:
    """Data as they would be without differences between recordings."""

    def alike(segment: Segment) -> Segment:
        for each in found:
            segment = each.without(model, gains, segment)
        return segment

    return replace(
        data,
        train=tuple(map(alike, data.train)),
        validate=tuple(map(alike, data.validate)),
    )


def _of_data(
    mounted: SetUp,
    data: Data,
    identified: _Identified,
    logs: Sequence[Recording],
    raw: Sequence[Segment],
) -> Diagnosis:
    """The diagnosis of an arm as it is set up.

    Args:
        mounted: The arm.
        data: Fitted and held-out data.
        identified: Its identification.
        logs: Recordings of the fit.
        raw: The hold-out without repairs; empty where there are none.
    """
    nominal = mounted.given
    joints = nominal.joints
    prior = prior_parameters(nominal)
    measured = series(data.train).measured
    turnings = identified.turnings
    reversals = [each.reversal for each in turnings]
    train = observed(mounted.robot, data.train, reversals)
    drive = identified.rows.drive
    tau = measured * gains_of(mounted.robot, data, drive)
    if drive is not None and data.unit == "A":
        drive = _refined_gains(train, tau, prior, drive)
    gains = gains_of(mounted.robot, data, drive)
    tau = measured * gains
    holdout = holdout_of(mounted.robot, data.validate, gains, nominal, drive)
    share = coarseness(data.train)
    halves = _halves(mounted.robot, logs, data, share)
    understood = identified.understood
    fit = _extended(mounted, train, halves, tau, prior, holdout, drive, understood)
    error = holdout.series.measured - fit.predicted
    left = residuals(joints, data.validate, error, holdout.error, fit.predicted)
    causes, others = _causes(fit, holdout, drive)
    of_set_up = [
        _of_set_up(mounted, effect, fit, holdout) for effect in mounted.effects
    ]
    if raw:
        of_set_up = [*_of_faults(mounted, raw, fit, holdout), *of_set_up]
    findings = [_judged_set_up(mounted, finding) for finding in of_set_up]
    causes = _judged(mounted, fit, holdout, causes, left)
    findings += causes
    others = [fit.unsure_of(f, causes) for f in others]
    level = VERDICT.chance / max(len(others), 1)
    corrected = [f for f in others if not f.by_chance(level)]
    coarse = _coarse_sentence(share, joints) if halves else ""
    notes = [data.holdout, *mounted.checked.notes, *[coarse] * bool(coarse)]
    turned = {e.joints for e in fit.model.effects if turning_speed(e)}
    told = [each for each in turnings if each.effect.joints in turned]
    notes += turning_notes(told, nominal)
    if drive is not None:
        notes.append(drive.sentence(joints))
    return Diagnosis(
        nominal,
        data,
        train,
        holdout,
        fit,
        tuple(findings),
        tuple(corrected),
        nominal_residuals=residuals(
            joints, data.validate, holdout.error, holdout.error, holdout.nominal
        ),
        residuals=left,
        notes=tuple(notes),
        drive=drive,
        set_up=mounted,
    )


def _judged(
    mounted: SetUp,
    fit: Extension,
    holdout: Holdout,
    causes: Sequence[Finding],
    left: Sequence[Residual],
) -> list[Finding]:
    """The causes by their gain, with the reason why one is not decided.

    Values are then as unsure as by those not decided, which may leave others undecided.
    """
    body_std = EVIDENCE.tolerance * max(1.0, fit.evidence.tolerance[0])
    standing = _impossible(mounted, fit, holdout)
    ordered = sorted(causes, key=lambda f: -f.explained)

    def reasons(findings: Sequence[Finding]) -> list[str]:
        return [
            finding.downgrade
            or standing
            or reason_to_downgrade(mounted.robot, finding, findings, left, body_std)
            for finding in findings
        ]

    judged = [
        replace(finding, downgrade=why)
        for finding, why in zip(ordered, reasons(ordered), strict=True)
    ]
    unsure = [fit.unsure_of(finding, judged) for finding in judged]
    beside = [
        why and f"{why}, as other causes are undecided" for why in reasons(unsure)
    ]
    return [
        replace(finding, downgrade=finding.downgrade or why)
        for finding, why in zip(unsure, beside, strict=True)
    ]


def _coarse_sentence(share: Array, joints: Sequence[str]) -> str:
    """How coarse positions are, by `coarseness`, and what is done about it."""
    return (
        f"positions are coarse beside the motion (noise of {100 * share.max():.2g} % of the "
        f"acceleration of {joints[int(np.argmax(share))]}): values are fitted to what even and "
        "odd samples show alike"
    )


def _impossible(mounted: SetUp, fit: Extension, holdout: Holdout) -> str:
    """What is doubtful or impossible in the data or the best model, with all causes; or empty."""
    judged = replace(holdout, predicted=fit.predicted)
    against = [
        each.why for each in objections(fit.model, judged) if not each.relative
    ]
    first = next(iter((*mounted.standing, *against)), "")
    return (
        f"something impossible stands beside it: {first}"
        if first
        else mounted.doubt
    )


def _halves(
    robot: Robot, recordings: Sequence[Recording], data: Data, share: Array
) -> tuple[Observed, ...]:
    """Columns by even and by odd samples where positions are coarse, by `coarseness`."""
    if not (share > CONFIRMATION.coarse).any():
        return ()
    try:
        halves = half_segments(recordings, data)
    except BadInput:
        return ()
    return tuple(observed(robot, half) for half in halves)


def _extended(
    mounted: SetUp,
    train: Observed,
    halves: tuple[Observed, ...],
    tau: Array,
    prior: Array,
    holdout: Holdout,
    drive: DriveGains | None,
    understood: Robot,
) -> Extension:
    """The extended model; the nominal one where no other predicts the hold-out better.

    The search begins with the torque of the nominal model, and with that of the arm understood.
    """
    gains = None if drive is None else drive.covariance
    evidence = gather(mounted.robot, train, tau, prior, gains=gains)
    first = Extender(prior, train, tau, holdout, evidence, gains, halves)
    changes = frozenset((effect.name, effect.joints) for effect in mounted.effects)
    fit = _iterated(first, changes)
    refuted = changes | fit.refuted
    others = [(first, fit.refuted)] if fit.refuted else []
    # the order of causes that are read from the torque must not decide
    if understood is not mounted.robot:
        train = train.by(understood)
        evidence = gather(mounted.robot, train, tau, prior, gains=gains)
        others.append((replace(first, train=train, evidence=evidence), frozenset()))
    elif doubted := _replaceable(mounted.robot, fit):
        others.append((first, doubted))
    for start, excluded in others:
        again = _iterated(start, changes | excluded)
        if holdout.worse(fit.predicted, again.predicted, CONFIRMATION.floor):
            fit = again
    # all that is missing in the model looks a little like a gain common to all joints
    gains_of_all = frozenset(
        c.key
        for c in fit.chosen
        if c.effect.physics.on_given_torque and c.effect.is_common(mounted.robot)
    )
    if gains_of_all:
        again = _iterated(first, changes | gains_of_all)
        if not holdout.worse(again.predicted, fit.predicted, CONFIRMATION.floor):
            fit = again
    assert fit.extender is not None
    more = completed(fit.evidence, mounted.robot, fit.chosen, refuted)
    if more != [*fit.chosen]:
        complete = confirmed(fit.extender, more)
        if holdout.worse(fit.predicted, complete.predicted, SEARCH.gain):
            fit = complete
    # causes that predict worse than bodies and standard effects as free as in identify are none
    usual = [c for c in first.evidence.candidates if c.effect.search.standard]
    free = first.by_data(usual)(usual)
    if holdout.worse(fit.predicted, free.predicted, CONFIRMATION.floor):
        found = {c.effect for c in fit.chosen if c.effect.search.usual}
        more = [c for c in first.evidence.candidates if c.effect in found]
        usual = list(dict.fromkeys([*usual, *more]))
        fit = confirmed(first.by_data(usual), usual)
    fit = fit.settled()
    if holdout.worse(fit.predicted, holdout.mounted):
        fit = unextended(fit.evidence, holdout)
    return fit


def _causes(
    fit: Extension, holdout: Holdout, drive: DriveGains | None
) -> tuple[list[Finding], list[Finding]]:
    """Significant changes of the nominal model, each with its rivals, and other values of it."""
    robot = holdout.robot
    causes = []
    for finding, candidate in zip(fit.findings, fit.chosen, strict=True):
        changed = finding.effect.values != finding.nominal
        if changed and not (finding.torque * holdout.series.moves).any():
            unseen = "nothing of it shows on the hold-out"
            causes.append(replace(finding, downgrade=unseen))
        elif finding.significant:
            alike = rivals(fit.evidence, robot, fit.chosen, candidate)
            # one that is left is enough: the cause is undecided
            model: Robot | None = None
            while (
                alike
                and (model := _instead(alike[0], finding, fit, holdout)) is None
            ):
                alike.pop(0)
            causes.append(replace(finding, rivals=tuple(alike), instead=model))
    if (bodies := off_bodies(fit, holdout)) is not None:
        if drive is not None and not drive.known.any():
            why = "masses rest on the drive gains, of which none is determined"
            bodies = replace(bodies, downgrade=why)
        causes.append(bodies)
    noticed, others = kept_effects(fit, holdout)

    def with_gains(findings: Sequence[Finding]) -> list[Finding]:
        return [
            replace(f, by_gains=errors_by_gains(f, robot, drive)) for f in findings
        ]

    changes = [f for f in with_gains([*causes, *noticed]) if not f.is_no_change]
    return changes, with_gains(others)


def _instead(
    rival: Rival, finding: Finding, fit: Extension, holdout: Holdout
) -> Robot | None:
    """The model with a rival, all else fitted again; None where it predicts the hold-out worse.

    That is beyond chance, on this motion, and by a noticeable part of what the cause explains
    there: causes of the same torque differ by their priors alone, however surely. Nor is it one if
    the cause is there beside it: if a link that is one, as uncertain as the others, is off as well.
    """
    assert fit.extender is not None
    extender = fit.extender.as_given(finding.effect)
    model = extender.model(rival.instead)
    if extender.is_off(finding.effect, model):
        return None
    weight = holdout.series.moves * holdout.gains / fit.evidence.sigma
    error = (holdout.series.measured - fit.predicted) * weight
    left = (error**2).sum()
    explained = ((error + finding.torque * weight) ** 2).sum() - left
    change = (extender.predicted(model) - fit.predicted) * weight
    scale = holdout_scale(error, change)
    # of the same torque, values of other causes differ by convention
    squares = ((finding.torque * weight) ** 2).sum()
    if (change**2).sum() <= VERDICT.same_torque * squares:
        return fit.model
    if -scale.gain * left <= CONFIRMATION.floor * explained:
        return model
    return None if scale.most(rival.tie) < 0 else model


class _Identified(NamedTuple):
    """An arm as identified.

    Attributes:
        rows: Its regression.
        turnings: Friction that turns over a range of speeds there.
        model: The arm with physically consistent bodies and effects, or as given.
        fit: Its least squares; None where they are not determined.
    """

    rows: FitRows
    turnings: Sequence[Turning]
    model: Robot
    fit: LeastSquares | None

    @property
    def understood(self) -> Robot:
        """The given arm, with the effects found where it gives joints no friction.

        What is read from the torque, as a delay, is read from that of the friction too.
        """
        given = self.rows.robot
        if self.fit is None or not frictionless(given):
            return given
        return given.with_effects(self.model.effects)


def _as_identified(
    robot: Robot, data: Data, logs: Sequence[Recording]
) -> _Identified:
    """The identification by the rows of identify.

    Drive gains are those that suit the nominal bodies best, friction left free.
    """
    usual = standard_effects(robot.joints)
    base = base_parameters(robot, usual)
    rows, turnings = turned_rows(robot, usual, base, data)
    try:
        if data.unit == "A":
            rows, fit, *_ = estimated(rows, logs, None)
        else:
            fit = weighted_least_squares(rows.reduced)
        R, z = rows.regression.factor(fit.weight)
        physical = fit_physical(R, z, prior_parameters(robot), rows.open_prior)
    except (RankDeficient, Infeasible):
        return _Identified(rows, turnings, robot, None)
    model = identified_robot(robot, rows.effects, physical.x)
    return _Identified(rows, turnings, model, fit)


def _refined_gains(
    train: Observed, tau: Array, prior: Array, drive: DriveGains
) -> DriveGains:
    """Drive gains that suit the nominal bodies and friction best, beside the causes that there are.

    Where no friction is in the model, the gain stays that of the nominal bodies.
    """
    robot = train.robot
    without = frictionless(robot)
    if without == {*robot.joints}:
        return drive
    with_friction = np.diag([joint not in without for joint in robot.joints])
    before = drive.covariance + SEARCH.drive_std**2 * with_friction
    root = gain_root(before)
    gains = drive.gains
    for _ in range(SEARCH.rounds):
        scaled = tau * (gains / drive.gains)
        evidence = gather(robot, train, scaled, prior, gains=before)
        evidence, chosen = select(evidence, robot)
        factor = 1 + root @ evidence.fit(chosen).coordinates[evidence.gains]
        gains = gains / np.maximum(factor, SEARCH.least_drive)
        if (factor > SEARCH.close_drive).all():
            break
    block = evidence.fit(chosen).covariance[np.ix_(evidence.gains, evidence.gains)]
    after = root @ block @ root.T / np.outer(factor, factor)
    # friction may share the scale of the bodies, but not decide it
    scale = SEARCH.own_scale * drive.scale_std**2
    after = after + max(scale - after.mean(), 0.0)
    return replace(drive, gains=gains, covariance=after)


def _of_set_up(
    mounted: SetUp, effect: Effect, fit: Extension, holdout: Holdout
) -> Finding:
    """The finding of a change of mounting or zero position."""
    without = mounted.without(effect, fit.model)
    tau = predicted_torque(without, holdout.observed.segments) / holdout.gains
    nominal = (0.0,) * len(effect.values or ())
    covariance = np.diag(np.square(mounted.std_of(effect)))
    torque = fit.predicted - tau
    return finding_of(fit, holdout, effect, torque, nominal, covariance)


def _of_faults(
    mounted: SetUp, raw: Sequence[Segment], fit: Extension, holdout: Holdout
) -> Iterator[Finding]:
    """Findings of the faults of the data that are repaired, together without their repair."""
    error = series(raw).measured - predicted_torque(fit.model, raw) / holdout.gains
    repaired = holdout.series.measured - fit.predicted
    torque = np.zeros_like(repaired)
    # a repair may leave rows out
    both = min(len(error), len(repaired))
    torque[:both] = error[:both] - repaired[:both]
    for fault in mounted.faults:
        finding = finding_of(fit, holdout, fault, torque)
        # the nominal model's own error is that on the repaired data
        ratio = finding.rms_after / max(finding.rms_before, 1e-300)
        yield replace(finding, explained=float(1 - ratio**2))


def _judged_set_up(mounted: SetUp, finding: Finding) -> Finding:
    reason = finding.downgrade
    if finding.is_nominal:
        reason = "its size is not known to better than half of it"
    elif finding.rms_after >= finding.rms_before:
        reason = "it does not predict the hold-out better"
    return replace(finding, rivals=mounted.rivals, downgrade=reason)


def _iterated(first: Extender, excluded: frozenset[Key]) -> Extension:
    """The model with the causes that the hold-out confirms, searched for again with that model."""
    holdout = first.holdout
    robot = holdout.robot
    best: Extension | None = None
    extender = first
    evidence = first.evidence
    for _ in range(SEARCH.rounds):
        if best is not None:
            extender = extender.by(best.model, idle(best.evidence, best.chosen))
            evidence = gather(
                robot,
                extender.train,
                first.tau,
                first.prior,
                best.chosen,
                gains=first.gains,
            )
        evidence, chosen = select(evidence, robot, excluded)
        fit = confirmed(replace(extender, evidence=evidence), chosen)
        if best is not None:
            if holdout.worse(fit.predicted, best.predicted, SEARCH.gain):
                break
            if not holdout.worse(best.predicted, fit.predicted, SEARCH.gain):
                return fit
        best = fit
        if not any(
            c.effect.physics.on_model or c.effect.search.shapes for c in chosen
        ):
            break
    assert best is not None
    return best


def _replaceable(robot: Robot, fit: Extension) -> frozenset[Key]:
    """Causes with a rival that is read from the torque of the model.

    That torque has them once they are selected, so that their order would decide.
    """
    return frozenset(
        cause.key
        for cause in fit.chosen
        if not cause.effect.physics.on_model
        and rivals(fit.evidence, robot, fit.chosen, cause, of_torque=True)
    )
