"""`diagnose`: what a given model gets wrong, by cause, with the gain on data not fitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from excitant.analysis.evidence import Candidate, Evidence
from excitant.analysis.extension import Extension, contribution, extend, tolerance_metric
from excitant.analysis.hypotheses import hypotheses, rests_on_model
from excitant.analysis.residuals import Remainder, noise_floor, remainders
from excitant.analysis.selection import Rival, rivals, select
from excitant.analysis.sticking import Mask, sliding
from excitant.identify.accuracy import Accuracy, Series, predicted_torque, series
from excitant.identify.physical import prior_parameters
from excitant.identify.preprocessing import Segment
from excitant.identify.recording import Recording
from excitant.identify.rows import Data, observation, split, torque_per_reading
from excitant.robots.base_parameters import base_parameters
from excitant.robots.effects import Effect, InertialParameters, JointwiseEffect, standard_effects
from excitant.robots.motion import Array
from excitant.robots.robot import Robot
from excitant.robots.torque import effect_values

_BLOCKS = 10  # of the hold-out, to see how much the gain varies
_DEVIATIONS = 2.0  # standard errors by which the gain must exceed zero
_ROUNDS = 3  # until what the data call for no longer changes what effects rest on
_MATTERS = 0.3  # of what a cause does to the joint where it shows most
_FLOOR = 0.05  # of a joint's squared error: dry friction is never an ideal sign function


@dataclass(frozen=True, eq=False)
class Finding:
    """One cause that the data call for.

    Attributes:
        effect: The cause, on one joint, with the value that the extended model has.
        given: The value that the given model has for each coefficient.
        std: Standard deviation of each coefficient.
        explained: Share of the given model's squared error on the hold-out that it removes.
        rms_before: Error on the hold-out without it, all other causes kept [N·m or A].
        rms_after: Error on the hold-out of the extended model [N·m or A].
        gain_error: Standard error of the relative gain in squared error, from blocks.
        rivals: Causes that the data cannot tell from it.
        torque: What it adds at the rows of the hold-out, shape (n, nv) [torque unit].
        overshadowed: More is left unexplained on its joints than it explains.
    """

    effect: Effect
    given: tuple[float, ...]
    std: tuple[float, ...]
    explained: float
    rms_before: float
    rms_after: float
    gain_error: float
    rivals: tuple[Rival, ...]
    torque: Array
    overshadowed: bool = False

    @property
    def verdict(self) -> str:
        """``named``, or ``undecided`` when there are rivals or most stays unexplained."""
        return "undecided" if self.rivals or self.overshadowed else "named"


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
    prior = prior_parameters(robot)
    data = split(recordings, validate, cutoff_hz)
    gains = _gains(robot, data)
    tau = series(data.train).measured * gains
    held = _held_out(robot, data, gains)
    reference, shapes = robot, None
    for _ in range(_ROUNDS):
        evidence = hypotheses(robot, reference, tolerance_metric(prior), data.train, gains)
        evidence, chosen = select(evidence, robot)
        while True:
            extension = extend(robot, reference, prior, evidence, chosen, data.train, tau)
            predicted = predicted_torque(extension.model, data.validate) / gains
            worst, judged = _judge(robot, evidence, extension, chosen, held, predicted)
            if worst is None:
                break
            chosen = [c for c in chosen if c is not worst]
        reference, before, shapes = extension.model, shapes, {c.effect for c in chosen}
        if shapes == before or not any(rests_on_model(c.effect) for c in chosen):
            break
    if held.worse(predicted):
        extension, chosen, judged = Extension(robot, {}, np.zeros(10 * robot.nv)), [], []
        predicted = held.simulated
    judged = [
        replace(finding, rivals=tuple(rivals(evidence, robot, chosen, candidate)))
        for finding, candidate in zip(judged, chosen, strict=True)
    ]
    return _diagnosis(robot, data, held, extension, judged, predicted)


@dataclass(frozen=True, eq=False)
class _HeldOut:
    """The hold-out as every model is judged by it.

    Attributes:
        segments: The hold-out.
        gains: Torque per reading, shape (nv,).
        series: Its rows.
        simulated: Torque of the given model at the rows, shape (n, nv) [torque unit].
        moves: Rows at which each joint moves, shape (n, nv).
        floor: What noise leaves of each joint's torque, shape (nv,) [torque unit].
    """

    segments: tuple[Segment, ...]
    gains: Array
    series: Series
    simulated: Array
    moves: Mask
    floor: Array

    @property
    def given(self) -> Array:
        """What the given model leaves, shape (n, nv) [torque unit]."""
        return self.series.measured - self.simulated

    def worse(self, predicted: Array) -> bool:
        """Whether a model predicts worse than the given one."""
        measured, scale = self.series.measured, self.series.measured.std(axis=0)
        models = predicted, self.simulated
        errors = [float((((measured - tau) / scale) ** 2).sum()) for tau in models]
        return errors[0] > errors[1]


def _held_out(robot: Robot, data: Data, gains: Array) -> _HeldOut:
    segments = data.validate
    return _HeldOut(
        segments,
        gains,
        series(segments),
        predicted_torque(robot, segments) / gains,
        sliding(segments),
        np.array([noise_floor(segments, j) for j in range(robot.nv)]),
    )


def _gains(robot: Robot, data: Data) -> Array:
    """Torque per reading, from the links' base parameters and the standard effects."""
    if data.unit != "A":
        return np.ones(robot.nv)
    effects = standard_effects(robot.joints)
    W = observation(robot, effects, data.train)
    base = base_parameters(robot, effects)
    return torque_per_reading(robot, base, W, series(data.train), data.unit)


def _judge(
    robot: Robot,
    evidence: Evidence,
    extension: Extension,
    chosen: Sequence[Candidate],
    held: _HeldOut,
    predicted: Array,
) -> tuple[Candidate | None, list[Finding]]:
    """The cause that pays least on the hold-out, if one does not pay; else the findings."""
    error, weight = held.series.measured - predicted, held.moves * held.gains / evidence.sigma
    power = float(((held.given * weight) ** 2).sum())
    findings, worst, least = [], None, 0.0
    for candidate in chosen:
        torque = contribution(extension, robot, candidate.effect, held.segments) / held.gains
        joints = _joints(robot, candidate.effect)
        without = error + torque
        gain = ((without**2 - error**2) * weight**2)[:, joints]
        relative, spread = _relative_gain(
            (without * weight)[:, joints], (torque * weight)[:, joints]
        )
        pays = relative - max(_FLOOR, _DEVIATIONS * spread)
        if not _shows(torque * held.moves, held.floor):
            pays = min(pays, -_FLOOR)
        if pays < least:
            worst, least = candidate, pays
        findings.append(
            _finding(
                robot,
                extension,
                candidate,
                torque,
                explained=float(gain.sum()) / power,
                errors=(without[:, joints], error[:, joints]),
                gain_error=spread,
            )
        )
    return worst, findings


def _shows(torque: Array, floor: Array) -> bool:
    """Whether a cause makes more torque than noise does, on some joint."""
    return bool((np.sqrt((torque**2).mean(axis=0)) > floor).any())


def _joints(robot: Robot, effect: Effect) -> list[int]:
    """Joints whose torque an effect changes: its own, or all for a body."""
    if isinstance(effect, JointwiseEffect):
        return [robot.joint_index(joint) for joint in effect.joints]
    return list(range(robot.nv))


def _relative_gain(error: Array, torque: Array) -> tuple[float, float]:
    """Fall of the squared error, relative to it, when a cause's torque is taken off it.

    The gain is (2a − 1)‖f‖² with the slope a of the error on the torque f. Its standard error
    is that of the slope, robust to autocorrelation by blocks of time.
    """
    power = (torque**2).sum()
    if power <= 0:
        return 0.0, 0.0
    slope = (error * torque).sum() / power
    scores = torque * (error - slope * torque)
    blocks = np.array([part.sum() for part in np.array_split(scores, _BLOCKS)])
    unit = power / (error**2).sum()
    return float((2 * slope - 1) * unit), float(2 * np.linalg.norm(blocks) / power * unit)


def _finding(
    robot: Robot,
    extension: Extension,
    candidate: Candidate,
    torque: Array,
    *,
    explained: float,
    errors: tuple[Array, Array],
    gain_error: float,
) -> Finding:
    effect = candidate.effect
    names = [p.name for p in effect.parameters(robot)]
    if isinstance(effect, InertialParameters):
        j = robot.joint_index(effect.joints[0])
        part = slice(10 * j, 10 * j + 10)
        values = list(extension.model.phi[part] - robot.phi[part])
        given, std = [0.0] * 10, list(extension.link_std[part])
    else:
        fitted, known = effect_values(extension.model), effect_values(robot)
        values = [fitted[name] for name in names]
        given = [known.get(name, 0.0) for name in names]
        std = [extension.std[name] for name in names]
    before, after = (float(np.sqrt((e**2).mean())) for e in errors)
    return Finding(
        effect.with_values(values),
        tuple(given),
        tuple(float(s) for s in std),
        explained,
        before,
        after,
        gain_error,
        (),
        torque,
    )


def _diagnosis(
    robot: Robot,
    data: Data,
    held: _HeldOut,
    extension: Extension,
    findings: list[Finding],
    predicted: Array,
) -> Diagnosis:
    error = held.series.measured - predicted
    left = remainders(robot.joints, data.validate, error, held.given, predicted)
    doubtful = [replace(f, overshadowed=_overshadowed(f, left)) for f in findings]
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
        extension=extension,
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


def _overshadowed(finding: Finding, left: Sequence[Remainder]) -> bool:
    """Whether what nothing explains is larger than what this cause explains, in noise."""
    scale = np.array([r.floor for r in left])
    if not (scale > 0).all():
        return False
    unknown = np.array([r.structured if r.visible else 0.0 for r in left])
    size = np.sqrt((finding.torque**2).mean(axis=0))
    main = size / scale > _MATTERS * (size / scale).max()
    return bool((unknown[main] ** 2).sum() > (size[main] ** 2).sum())


def _waterfall(
    given: Array, extended: Array, findings: Sequence[Finding]
) -> tuple[tuple[str, float], ...]:
    """Error over all joints as causes are added to the given model in order of importance."""
    size = np.sqrt((given**2).mean(axis=0))
    steps, error = [("given model", 1.0)], given
    for finding in findings:
        error = error - finding.torque
        name = finding.effect.name.replace("_", " ")
        label = f"+ {name} at {', '.join(finding.effect.joints)}"
        steps.append((label, _relative(error, size)))
    return (*steps, ("all re-identified", _relative(extended, size)))


def _relative(error: Array, size: Array) -> float:
    return float(np.sqrt(((error / size) ** 2).mean()))
