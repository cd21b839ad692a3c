"""Which causes pay on data that were not fitted, each with what it brings there."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from excitant.analysis.evidence import Candidate, Evidence
from excitant.analysis.extension import Extension, contribution
from excitant.analysis.observed import Observed, observed
from excitant.analysis.residuals import noise_floor
from excitant.analysis.selection import Key, Rival, underlies
from excitant.analysis.sticking import Mask, sliding
from excitant.identify.accuracy import Series, series
from excitant.identify.preprocessing import Segment
from excitant.robots.effects import Effect, InertialParameters, JointwiseEffect
from excitant.robots.motion import Array
from excitant.robots.robot import Robot
from excitant.robots.torque import effect_values

_BLOCKS = 10  # of the hold-out, to see how much the gain varies
_DEVIATIONS = 2.0  # standard errors by which the gain must exceed zero
_PLAIN = 0.1  # of a joint's squared error: what brings as much matters below the noise too
FLOOR = 0.05  # of a joint's squared error: dry friction is never an ideal sign function


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
        gain: Fall of the squared error of its joints with it, relative to that error.
        gain_error: Standard error of the gain, from blocks.
        rivals: Causes that the data cannot tell from it.
        torque: What it adds at the rows of the hold-out, shape (n, nv) [torque unit].
        margin: Gain beyond what a cause must bring to pay.
        doubt: Why it may be another cause although nothing rivals it; empty without a reason.
    """

    effect: Effect
    given: tuple[float, ...]
    std: tuple[float, ...]
    explained: float
    rms_before: float
    rms_after: float
    gain: float
    gain_error: float
    rivals: tuple[Rival, ...]
    torque: Array
    margin: float = 0.0
    doubt: str = ""

    @property
    def pays(self) -> bool:
        """Whether what it explains is beyond chance and noise; else others rest on it."""
        return self.margin >= 0

    @property
    def refuted(self) -> bool:
        """Whether the hold-out is plainly worse with it."""
        return self.gain + _DEVIATIONS * self.gain_error < -FLOOR

    @property
    def verdict(self) -> str:
        """``named``, or ``undecided`` when there are rivals or reasons to doubt it."""
        return "undecided" if self.rivals or self.doubt else "named"


@dataclass(frozen=True, eq=False)
class HeldOut:
    """The hold-out as every model is judged by it.

    Attributes:
        observed: The hold-out.
        gains: Torque per reading, shape (nv,).
        series: Its rows.
        simulated: Torque of the given model at the rows, shape (n, nv) [torque unit].
        moves: Rows at which each joint moves, shape (n, nv).
        floor: What noise leaves of each joint's torque, shape (nv,) [torque unit].
    """

    observed: Observed
    gains: Array
    series: Series
    simulated: Array
    moves: Mask
    floor: Array

    @property
    def given(self) -> Array:
        """What the given model leaves, shape (n, nv) [torque unit]."""
        return self.series.measured - self.simulated

    def worse(self, predicted: Array, than: Array, share: float = 0.0) -> bool:
        """Whether a prediction leaves more squared error than another, by a share of it.

        Rows at which a joint rests do not count for it.
        """
        measured, weight = self.series.measured, self.moves / self.series.measured.std(axis=0)
        errors = [float((((measured - tau) * weight) ** 2).sum()) for tau in (predicted, than)]
        return errors[0] > (1 + share) * errors[1]


def held_out(robot: Robot, segments: tuple[Segment, ...], gains: Array) -> HeldOut:
    """The hold-out of a given robot.

    Args:
        robot: The given robot.
        segments: The hold-out.
        gains: Torque per reading, shape (nv,).
    """
    found = observed(robot, segments)
    return HeldOut(
        found,
        gains,
        series(segments),
        found.torque() / gains,
        sliding(segments),
        np.array([noise_floor(segments, j) for j in range(robot.nv)]),
    )


@dataclass(frozen=True, eq=False)
class Fit:
    """A set of causes with the model they were fitted in.

    Attributes:
        evidence: What the causes were chosen by.
        chosen: The causes.
        extension: The extended model.
        extended: The rows of the hold-out by that model.
        predicted: Its torque at them, shape (n, nv) [torque unit].
        refuted: Causes that the evidence called for and that make the hold-out plainly worse.
    """

    evidence: Evidence
    chosen: tuple[Candidate, ...]
    extension: Extension
    extended: Observed
    predicted: Array
    refuted: frozenset[Key] = frozenset()


def confirmed(
    robot: Robot, held: HeldOut, fit: Fit, fitted: Callable[[Sequence[Candidate]], Fit]
) -> tuple[Fit, list[Finding]]:
    """The causes that pay on the hold-out.

    The one that pays least goes first, and all others are fitted anew. What others rest on stays:
    plain friction below finer friction, and a cause without which the new fit is clearly worse.

    Args:
        robot: The given robot.
        held: The hold-out.
        fit: Causes that the evidence calls for.
        fitted: Fits fewer of them.

    Returns:
        The fit with those that pay or that others rest on, and a finding for each.
    """
    needed, refuted = set[Candidate](), set[Key]()
    findings = _findings(robot, fit, held)
    while (worst := _least(robot, fit, findings, needed)) is not None:
        if findings[fit.chosen.index(worst)].refuted:
            refuted.add(worst.key)
        fewer = fitted([c for c in fit.chosen if c is not worst])
        if held.worse(fewer.predicted, fit.predicted, FLOOR):
            needed.add(worst)
        else:
            fit, findings = fewer, _findings(robot, fewer, held)
    return replace(fit, refuted=frozenset(refuted)), findings


def _least(
    robot: Robot, fit: Fit, findings: Sequence[Finding], needed: set[Candidate]
) -> Candidate | None:
    """The cause that pays least, if one does not pay and nothing rests on it."""
    for k in np.argsort([finding.margin for finding in findings], kind="stable"):
        candidate: Candidate = fit.chosen[k]
        if findings[k].pays:
            return None
        rest = [c for c in fit.chosen if c is not candidate]
        if candidate not in needed and not underlies(robot, rest, candidate):
            return candidate
    return None


def _findings(robot: Robot, fit: Fit, held: HeldOut) -> list[Finding]:
    """What each cause of a fit brings on the hold-out."""
    extension, sigma = fit.extension, fit.evidence.sigma
    error, weight = held.series.measured - fit.predicted, held.moves * held.gains / sigma
    power = float(((held.given * weight) ** 2).sum())
    findings = []
    for candidate in fit.chosen:
        torque = contribution(robot, candidate.effect, fit.extended) / held.gains
        joints = affected(robot, candidate.effect)
        without = error + torque
        fall = ((without**2 - error**2) * weight**2)[:, joints]
        relative, spread = _relative_gain(
            (without * weight)[:, joints], (torque * weight)[:, joints]
        )
        margin = relative - max(FLOOR, _DEVIATIONS * spread)
        if relative < _PLAIN and not _shows(torque * held.moves, held.floor):
            margin = min(margin, -FLOOR)
        findings.append(
            _finding(
                robot,
                extension,
                candidate,
                torque,
                explained=float(fall.sum()) / power,
                errors=(without[:, joints], error[:, joints]),
                gain=(relative, spread),
                margin=margin,
            )
        )
    return findings


def _shows(torque: Array, floor: Array) -> bool:
    """Whether a cause makes more torque than noise does, on some joint."""
    return bool((np.sqrt((torque**2).mean(axis=0)) > floor).any())


def affected(robot: Robot, effect: Effect) -> list[int]:
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
    gain: tuple[float, float],
    margin: float,
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
        *gain,
        (),
        torque,
        margin,
    )
