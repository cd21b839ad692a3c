"""`diagnose`: what a given model gets wrong, by cause, with the gain on data not fitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from excitant.analysis.confirmation import FLOOR, Finding, Fit, HeldOut, confirmed, held_out
from excitant.analysis.doubt import doubt
from excitant.analysis.evidence import Candidate, Evidence
from excitant.analysis.extension import Extension, extend, tolerance_metric
from excitant.analysis.hypotheses import hypotheses
from excitant.analysis.observed import Observed, observed, rests_on_model
from excitant.analysis.proposals import has_shape
from excitant.analysis.residuals import Remainder, remainders
from excitant.analysis.selection import Key, rivals, select
from excitant.identify.accuracy import Accuracy, Series, series
from excitant.identify.physical import prior_parameters
from excitant.identify.recording import Recording
from excitant.identify.rows import Data, split, torque_per_reading
from excitant.robots.base_parameters import base_parameters
from excitant.robots.effects import plain, standard_effects
from excitant.robots.html_table import html_table
from excitant.robots.motion import Array
from excitant.robots.robot import Robot

_ROUNDS = 3  # until what the data call for no longer changes what effects rest on


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What a given model gets wrong.

    Attributes:
        robot: The given robot.
        data: What was fitted and held out.
        gains: Torque per reading, shape (nv,).
        extension: The extended model.
        simulation: Accuracy of the given model on the hold-out.
        extended: Accuracy of the extended model on the hold-out.
        findings: Causes in order of importance.
        series: Rows of the hold-out.
        position: Joint positions at those rows, shape (n, nv) [rad].
        velocity: Joint velocities at those rows, shape (n, nv) [rad/s].
        acceleration: Joint accelerations at those rows, shape (n, nv) [rad/s²].
        simulated: Torque of the given model at those rows [torque unit].
        predicted: Torque of the extended model at those rows [torque unit].
        remainders: What the extended model leaves, joint by joint.
        waterfall: Error on the hold-out, relative to the given model's, as causes are added.
        notes: What the user should know, as sentences.
    """

    robot: Robot
    data: Data
    gains: Array
    extension: Extension
    simulation: Accuracy
    extended: Accuracy
    findings: tuple[Finding, ...]
    series: Series
    position: Array
    velocity: Array
    acceleration: Array
    simulated: Array
    predicted: Array
    remainders: tuple[Remainder, ...]
    waterfall: tuple[tuple[str, float], ...]
    notes: tuple[str, ...]

    def _repr_html_(self) -> str:
        rows = [
            (f.effect.name, ", ".join(f.effect.joints), f.verdict, f.rms_before, f.rms_after)
            for f in self.findings
        ]
        heads = ("cause", "joints", "verdict", "rms error without it", "with it")
        return html_table(f"What the model of {self.robot.name} gets wrong", heads, rows)


def diagnose(
    robot: Robot,
    recordings: Sequence[Recording],
    *,
    validate: Sequence[Recording] = (),
    cutoff_hz: float | None = None,
) -> Diagnosis:
    """Name what the given model gets wrong.

    Args:
        robot: The given model: inertias and effects as they are believed to be.
        recordings: What to explain.
        validate: What to judge on; the last 30 % of each recording when empty.
        cutoff_hz: Cut-off of the torque filter [Hz].

    Raises:
        BadRecording: Recordings that cannot be used.
        BadRobot: Links without mass.
        Infeasible: The semidefinite solver failed.
    """
    data = split(recordings, validate, cutoff_hz)
    train = observed(robot, data.train)
    gains = _gains(train, data.unit)
    held = held_out(robot, data.validate, gains)
    prior = prior_parameters(robot)
    evidence = hypotheses(robot, train, tolerance_metric(prior), gains)
    fit, findings = _understood(prior, train, held, evidence)
    if fit.refuted:
        again = _understood(prior, train, held, evidence, fit.refuted)
        if held.worse(fit.predicted, again[0].predicted, FLOOR):
            fit, findings = again
    if held.worse(fit.predicted, held.simulated):
        given = Extension(robot, {}, np.zeros(10 * robot.nv))
        fit, findings = Fit(fit.evidence, (), given, held.observed, held.simulated), []
    findings = [
        replace(finding, rivals=tuple(rivals(fit.evidence, robot, fit.chosen, candidate)))
        for finding, candidate in zip(findings, fit.chosen, strict=True)
        if finding.pays
    ]
    return _diagnosis(robot, data, held, fit, findings)


def _understood(
    prior: Array,
    train: Observed,
    held: HeldOut,
    evidence: Evidence,
    refuted: frozenset[Key] = frozenset(),
) -> tuple[Fit, list[Finding]]:
    """Causes that the data call for and the hold-out confirms, and the model with them.

    Effects that rest on torque take it from the model as understood so far, and shapes are first
    searched over coarse grids, then between their points. So the causes are looked for again where
    that may change them, for as long as the hold-out does not lose.

    Args:
        prior: Standard parameters of the given robot as prior, shape (nv, 10).
        train: What to explain, of the given robot.
        held: The hold-out.
        evidence: Of all causes, by the given robot.
        refuted: Causes left out, for the hold-out speaks against them.
    """
    robot, tau = train.robot, series(train.segments).measured * held.gains
    rounds: list[tuple[Fit, list[Finding]]] = []
    shapes = None
    for _ in range(_ROUNDS):
        if rounds:
            last = rounds[-1][0]
            train = train.by(last.extension.model)
            evidence = hypotheses(robot, train, tolerance_metric(prior), held.gains, last.chosen)
        evidence, chosen = select(evidence, robot, refuted)
        fitted = partial(_fit, robot, prior, train, tau, held, evidence)
        fit, findings = confirmed(robot, held, fitted(chosen), fitted)
        if rounds and held.worse(fit.predicted, rounds[-1][0].predicted, FLOOR):
            break
        rounds.append((fit, findings))
        before, shapes = shapes, {c.effect for c in fit.chosen}
        if shapes == before or not any(rests_on_model(e) or has_shape(e) for e in shapes):
            break
    return rounds[-1]


def _fit(
    robot: Robot,
    prior: Array,
    train: Observed,
    tau: Array,
    held: HeldOut,
    evidence: Evidence,
    causes: Sequence[Candidate],
) -> Fit:
    extension = extend(robot, prior, evidence, causes, train, tau)
    extended = held.observed.by(extension.model)
    return Fit(evidence, tuple(causes), extension, extended, extended.torque() / held.gains)


def _gains(train: Observed, unit: str) -> Array:
    """Torque per reading, from the links' base parameters and the standard effects."""
    robot = train.robot
    if unit != "A":
        return np.ones(robot.nv)
    effects = standard_effects(robot.joints)
    base = base_parameters(robot, effects)
    return torque_per_reading(robot, base, train.matrix(effects), series(train.segments), unit)


def _diagnosis(
    robot: Robot,
    data: Data,
    held: HeldOut,
    fit: Fit,
    findings: list[Finding],
) -> Diagnosis:
    predicted = fit.predicted
    error = held.series.measured - predicted
    left = remainders(robot.joints, data.validate, error, held.given, predicted)
    doubtful = [replace(f, doubt=doubt(f, findings, left)) for f in findings]
    findings = sorted(doubtful, key=lambda f: -f.explained)
    notes = [data.holdout]
    if data.unit == "A":
        notes.append(
            "torque came as motor current; effects are in N·m by drive gains whose common scale "
            "rests on the given masses"
        )
    return Diagnosis(
        robot=robot,
        data=data,
        gains=held.gains,
        extension=fit.extension,
        simulation=held.series.accuracy(held.simulated),
        extended=held.series.accuracy(predicted),
        findings=tuple(findings),
        series=held.series,
        position=np.concatenate([s.motion.q[s.keep] for s in data.validate]),
        velocity=np.concatenate([s.motion.dq[s.keep] for s in data.validate]),
        acceleration=np.concatenate([s.motion.ddq[s.keep] for s in data.validate]),
        simulated=held.simulated,
        predicted=predicted,
        remainders=left,
        waterfall=_waterfall(held.given, error, findings),
        notes=tuple(notes),
    )


def _waterfall(
    given: Array, extended: Array, findings: Sequence[Finding]
) -> tuple[tuple[str, float], ...]:
    """Error over all joints as causes are added to the given model in order of importance."""
    size = np.sqrt((given**2).mean(axis=0))
    steps, error = [("given model", 1.0)], given
    for finding in findings:
        error = error - finding.torque
        label = f"+ {plain(finding.effect.name)} at {', '.join(finding.effect.joints)}"
        steps.append((label, _relative(error, size)))
    return (*steps, ("all re-identified", _relative(extended, size)))


def _relative(error: Array, size: Array) -> float:
    return float(np.sqrt(((error / size) ** 2).mean()))
