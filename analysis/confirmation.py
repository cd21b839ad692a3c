"""Confirmation of causes on data that were not fitted, with the gain of each."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from excitant.analysis.candidates import (
    TOLERANCE,
    WRONG_LINK,
    Observed,
    coefficient_sizes,
    observed,
)
from excitant.analysis.evidence import (
    Candidate,
    Evidence,
    Key,
    are_placeholders,
    widened,
)
from excitant.analysis.residuals import motion_noise, noise_floor
from excitant.analysis.selection import Rival, underlies
from excitant.identify.accuracy import Series, series
from excitant.identify.physical import fit_physical
from excitant.identify.preprocessing import Segment, away_from_rest
from excitant.identify.prior import BodyPrior, EffectPrior
from excitant.identify.regression import dense
from excitant.identify.rows import identified_robot, predicted_torque
from excitant.robots.effects import Effect, merged
from excitant.robots.effects.body import GivenInertias
from excitant.robots.motion import Array
from excitant.robots.parameters import from_pseudo_inertia
from excitant.robots.robot import Robot
from excitant.robots.torque import column_names, effect_values

_BLOCKS = 10  # of the hold-out, to see how much the gain varies
# standard errors by which a gain must exceed zero, a value the given one
DEVIATIONS = 2.0
# standard errors by which a joint's error grows with a cause common to all
_CONTRADICTED = 3.0
_PLAIN = 0.1  # of a joint's squared error: a gain as large counts even below the noise
_FAINT = 0.005  # of a joint's torque: no model is right to so much
IDEAL = 0.01  # of it: what is missed by ideal friction, filters and samples
FLOOR = 0.05  # of a joint's squared error: dry friction is never an ideal sign function
_PAYLOAD_SIGMA = 100.0  # relative: a payload is left free
_PAYLOAD_SHARE = 0.05  # its reference body: of the arm's mass
_PAYLOAD_RADIUS = 0.1  # m


class Asked(NamedTuple):
    """Size that the error of unseen data asks of a torque, relative to the one fitted."""

    size: float
    error: float  # its standard error, from blocks of time
    power: float  # ‖torque‖² / ‖error‖²

    @property
    def gain(self) -> float:
        """Fall of the squared error with the torque as fitted, relative: (2a − 1)‖f‖² / ‖e‖²."""
        return (2 * self.size - 1) * self.power

    @property
    def gain_error(self) -> float:
        """Standard error of the gain."""
        return 2 * self.error * self.power


@dataclass(frozen=True, eq=False)
class Finding:
    """One cause that the data support.

    Attributes:
        effect: The cause, on one joint, with the value that the extended model has.
        given: The value that the given model has for each coefficient.
        covariance: Of its k coefficients by the fit, shape (k, k).
        by_gains: Their errors by one standard deviation of the drive gains, shape (k,).
        explained: Share of the given model's squared error on the hold-out that it removes.
        joint: Index of the joint where it is largest relative to what remains.
        rms_before: Error on the hold-out without it, all others kept, of its joints that turn or
            slide as that one does [torque unit].
        rms_after: The same of the extended model [torque unit].
        asked: Size that the hold-out asks for at its joints, all else as it is, and the gain.
        torque: What it adds at the rows of the hold-out, shape (n, nv) [torque unit].
        share: Rms of that relative to the measured torque, of the joint where it is largest.
        margin: Gain beyond the threshold of confirmation; negative where the size may be chance.
        rivals: Causes that the data cannot distinguish from it.
        downgrade: Reason to call it undecided although it has no rival; else empty.
    """

    effect: Effect
    given: tuple[float, ...]
    covariance: Array
    by_gains: Array
    explained: float
    joint: int
    rms_before: float
    rms_after: float
    asked: Asked
    torque: Array
    share: float
    margin: float = 0.0
    rivals: tuple[Rival, ...] = ()
    downgrade: str = ""

    @property
    def std(self) -> Array:
        """Standard deviation of each coefficient, shape (k,)."""
        std: Array = np.hypot(np.sqrt(np.diag(self.covariance)), self.by_gains)
        return std

    @property
    def pays(self) -> bool:
        """Whether its gain and its size exceed chance and noise; if not, others need it."""
        return self.margin >= 0

    @property
    def near_given(self) -> bool:
        """Whether all its values are the given ones to two standard deviations."""
        off = np.abs(np.array(self.effect.values or ()) - self.given)
        return len(off) > 0 and bool((off < DEVIATIONS * self.std).all())

    @property
    def as_given(self) -> bool:
        """Whether it is a value that the model has, to two standard deviations."""
        return (
            self.effect.role == "torque"
            and bool(np.any(self.given))
            and self.near_given
        )

    @property
    def refuted(self) -> bool:
        """Whether the error on the hold-out is significantly larger with it."""
        return self.asked.gain + DEVIATIONS * self.asked.gain_error < -FLOOR

    @property
    def verdict(self) -> str:
        """``named``, or ``undecided`` when there are rivals or reasons to downgrade it."""
        return "undecided" if self.rivals or self.downgrade else "named"


@dataclass(frozen=True, eq=False)
class HeldOut:
    """The hold-out by which every model is judged; torques of shape (n, nv) [torque unit]."""

    observed: Observed  # its rows, of the given robot
    gains: Array  # torque per reading, shape (nv,)
    series: Series  # measured torque, and the rows at which each joint moves
    simulated: Array  # torque of the given model
    mounted: Array  # of the given model in the set-up found
    floor: Array  # noise of each joint's filtered torque, measured and modelled, shape (nv,)

    @property
    def given(self) -> Array:
        """Residual of the given model."""
        return self.series.measured - self.simulated

    def worse(self, predicted: Array, than: Array, share: float = 0.0) -> bool:
        """Whether a prediction has a larger squared error than another, by a share, in motion."""
        measured = self.series.measured
        weight = self.series.moves / measured.std(axis=0)
        errors = [
            float((((measured - tau) * weight) ** 2).sum()) for tau in (predicted, than)
        ]
        return errors[0] > (1 + share) * errors[1]


def held_out(
    robot: Robot,
    segments: tuple[Segment, ...],
    gains: Array,
    given: Robot | None = None,
) -> HeldOut:
    """The hold-out of a robot as it is set up, and as given; its torque per reading, (nv,)."""
    found = observed(robot, segments)
    floor = np.array([noise_floor(segments, j) for j in range(robot.nv)])
    floor = np.hypot(floor, motion_noise(robot, segments) / gains)
    mounted = simulated = found.torque() / gains
    if given is not None and given is not robot:
        simulated = predicted_torque(given, segments) / gains
    return HeldOut(found, gains, series(segments), simulated, mounted, floor)


@dataclass(frozen=True, eq=False)
class Extension:
    """The given model with causes added, everything re-identified physically consistently."""

    evidence: Evidence  # by which the causes were chosen
    chosen: tuple[Candidate, ...]
    model: Robot  # the given robot with re-identified inertias and effects, those found included
    names: tuple[str, ...]  # of its parameters
    covariance: Array  # of them
    held: Observed  # columns of that model at the rows of the hold-out
    predicted: Array  # its torque at them, shape (n, nv) [torque unit]
    findings: tuple[Finding, ...] = ()  # each cause with its gain on the hold-out
    refuted: frozenset[Key] = (
        frozenset()
    )  # selected causes with which the hold-out is worse

    def covariance_of(self, names: Sequence[str]) -> Array:
        """Covariance of some of the parameters, shape (k, k)."""
        at = [self.names.index(name) for name in names]
        block: Array = self.covariance[np.ix_(at, at)]
        return block


def unextended(evidence: Evidence, held: HeldOut) -> Extension:
    """The given model as it is set up."""
    return Extension(
        evidence,
        (),
        held.observed.robot,
        (),
        np.zeros((0, 0)),
        held.observed,
        held.mounted,
    )


@dataclass(frozen=True, eq=False)
class Extender:
    """Fits the given robot with added causes: these are free, all else keeps its tolerance."""

    prior: Array  # standard parameters of the given robot as prior, shape (nv, 10)
    train: Observed  # columns to fit, of the model so far
    tau: Array  # measured torque at the rows, shape (n, nv) [N·m]
    held: HeldOut
    evidence: Evidence  # noise levels, and the tolerance that the data support
    gains: Array | None = None  # covariance of the logarithms of drive gains, (nv, nv)

    def __call__(self, chosen: Sequence[Candidate]) -> Extension:
        """The extended model with a set of causes."""
        robot = self.held.observed.robot
        evidence = self.evidence
        effects = _effects(robot, chosen)
        W = self.train.matrix(effects)
        names = column_names(robot, effects)
        problem = dense(W, self.tau, names, away_from_rest(self.train.segments))
        R, z = problem.factor(np.sqrt(evidence.weight))
        bodies, sigma = self._bodies(chosen)
        open_ = self._effect_prior(effects, chosen, W[:, :, 10 * len(bodies) :])
        fit = fit_physical(R, z, BodyPrior(bodies, sigma), open_)
        model = identified_robot(robot, effects, fit.x)
        found = self.held.observed.by(model)
        predicted = found.torque() / self.held.gains
        extension = Extension(
            evidence, tuple(chosen), model, names, fit.covariance, found, predicted
        )
        return replace(extension, findings=_findings(robot, extension, self.held))

    def _bodies(self, chosen: Sequence[Candidate]) -> tuple[Array, Array]:
        """Prior and its relative uncertainty for every link, and for a payload if there is one."""
        robot = self.held.observed.robot
        sigma = TOLERANCE * widened(robot, self.evidence.tolerance[0])
        wrong = [
            row
            for c in chosen
            if c.effect.role == "link"
            for row in c.effect.rows(robot)
        ]
        sigma[wrong] = np.maximum(sigma[wrong], WRONG_LINK)
        if not any(c.effect.role == "body" for c in chosen):
            return self.prior, sigma
        mass = _PAYLOAD_SHARE * self.prior[:, 0].sum()
        reference = from_pseudo_inertia(
            mass * np.diag([*(_PAYLOAD_RADIUS**2,) * 3, 1.0])
        )
        return np.vstack([self.prior, reference]), np.array([*sigma, _PAYLOAD_SIGMA])

    def _effect_prior(
        self, effects: Sequence[Effect], chosen: Sequence[Candidate], columns: Array
    ) -> EffectPrior:
        robot = self.held.observed.robot
        free = {p.name for c in chosen for p in c.effect.parameters(robot)}
        scalar = [e for e in effects if e.role != "body"]
        parameters = [p for e in scalar for p in e.parameters(robot)]
        mean = np.array(
            [v for e in scalar for v in e.values or (0.0,) * len(e.parameters(robot))]
        )
        tight = np.maximum(self.evidence.tolerance[1] * TOLERANCE * np.abs(mean), 1e-9)
        loose = np.array([p.name in free for p in parameters], dtype=bool)
        std = np.where(loose, coefficient_sizes(parameters, columns, self.tau), tight)
        return EffectPrior(mean, std, np.array([p.lower for p in parameters]))


def _effects(robot: Robot, chosen: Sequence[Candidate]) -> list[Effect]:
    has = {p.name for e in robot.effects for p in e.parameters(robot)}
    bodies = [c.effect for c in chosen if c.effect.role == "body"]
    found = [c.effect for c in chosen if c.effect.role == "torque"]
    added = [e for e in found if not {p.name for p in e.parameters(robot)} <= has]
    return [*bodies, *robot.effects, *merged(added)]


def confirmed(extender: Extender, chosen: Sequence[Candidate]) -> Extension:
    """The fit with the causes that the hold-out confirms, by elimination of the weakest.

    Plain friction below finer friction stays, and a cause without which the refit is clearly worse.
    """
    held = extender.held
    fit = extender(chosen)
    kept = set[Candidate]()
    refuted = set[Key]()
    while (worst := _weakest(held.observed.robot, fit, kept)) is not None:
        if fit.findings[fit.chosen.index(worst)].refuted:
            refuted.add(worst.key)
        fewer = extender([c for c in fit.chosen if c is not worst])
        if held.worse(fewer.predicted, fit.predicted, FLOOR):
            kept.add(worst)
        else:
            fit = fewer
    return replace(fit, refuted=frozenset(refuted))


def _weakest(robot: Robot, fit: Extension, kept: set[Candidate]) -> Candidate | None:
    for k in np.argsort([finding.margin for finding in fit.findings], kind="stable"):
        candidate: Candidate = fit.chosen[k]
        if fit.findings[k].pays:
            return None
        rest = [c for c in fit.chosen if c is not candidate]
        if candidate not in kept and not underlies(robot, rest, candidate):
            return candidate
    return None


def _findings(robot: Robot, fit: Extension, held: HeldOut) -> tuple[Finding, ...]:
    findings = []
    for candidate in fit.chosen:
        values, given, covariance = _coefficients(robot, fit, candidate.effect)
        torque = fit.held.columns(candidate.effect) @ (values - given) / held.gains
        effect = candidate.effect.with_values(values.tolist())
        found = finding_of(robot, fit, held, effect, torque, given.tolist(), covariance)
        if effect.role == "torque" and found.near_given:
            found = replace(found, margin=min(found.margin, -FLOOR))
        findings.append(found)
    return tuple(findings)


def off_effects(robot: Robot, fit: Extension, held: HeldOut) -> Iterator[Finding]:
    """The given effects, joint by joint, whose values the data correct noticeably."""
    least = _noticed(fit.evidence.tolerance[1])
    taken = {candidate.key for candidate in fit.chosen}
    for effect in (
        single for each in robot.effects for single in each.singles() if fit.names
    ):
        if effect.role != "torque" or (effect.name, effect.joints) in taken:
            continue
        values, given, covariance = _coefficients(robot, fit, effect)
        torque = fit.held.columns(effect) @ (values - given) / held.gains
        off = effect.with_values(values.tolist())
        found = finding_of(robot, fit, held, off, torque, given.tolist(), covariance)
        if found.pays and found.share > least:
            yield found


def _noticed(tolerance: float) -> float:
    """Share of a torque by which given values are noticeably off: right to ±10 % are no finding.

    Where they are off by more than they might be, smaller corrections belong to the finding.
    """
    return 2 * TOLERANCE / max(tolerance, 1.0)


def off_bodies(robot: Robot, fit: Extension, held: HeldOut) -> Finding | None:
    """The links whose given inertias the data contradict, as one finding; None where none pays."""
    apart = {
        row
        for c in fit.chosen
        if c.effect.role != "torque"
        for row in c.effect.rows(robot)
    }
    if are_placeholders(robot) or not fit.names:
        return None
    change = fit.model.phi - robot.phi

    def of(rows: Sequence[int]) -> Finding:
        at = np.concatenate([np.arange(10 * k, 10 * k + 10) for k in rows])
        effect = GivenInertias(tuple(robot.joints[k] for k in rows)).with_values(
            change[at]
        )
        torque = fit.held.links[:, :, at] @ change[at] / held.gains
        given = (0.0,) * len(at)
        covariance = fit.covariance_of([robot.parameter_names[k] for k in at])
        return finding_of(robot, fit, held, effect, torque, given, covariance)

    rows = [k for k in range(robot.nv) if k not in apart and of([k]).pays]
    found = of(rows) if rows else None
    least = _noticed(fit.evidence.tolerance[0])
    return found if found is not None and found.share > least else None


def finding_of(
    robot: Robot,
    fit: Extension,
    held: HeldOut,
    effect: Effect,
    torque: Array,
    given: Sequence[float],
    covariance: Array,
) -> Finding:
    """A cause with its gain on the hold-out, where it makes a torque (n, nv) [torque unit]."""
    rows = held.series
    error = held.series.measured - fit.predicted
    weight = rows.moves * held.gains / fit.evidence.sigma
    power = float(((held.given * weight) ** 2).sum())
    joints = np.array(effect.affected(robot))
    without = error + torque
    fall = ((without**2 - error**2) * weight**2)[:, joints]
    asked = _asked((without * weight)[:, joints], (torque * weight)[:, joints])
    margin = asked.gain - max(FLOOR, DEVIATIONS * asked.gain_error)
    shows = np.sqrt(((torque * rows.moves) ** 2).mean(axis=0)) > held.floor
    most = effect.rows(robot)[0]
    if not effect.jointwise:
        most = int(np.argmax(rows.rms(torque) / rows.rms(error)))
    alike = joints[robot.revolute[joints] == robot.revolute[most]]
    before, after = (
        np.sqrt((rows.rms(e)[alike] ** 2).mean()) for e in (without, error)
    )
    # what depends on the model looks like noise of positions
    plain = asked.gain > _PLAIN and not effect.physics.on_model
    share = float(
        (rows.rms(torque) / np.maximum(rows.rms(rows.measured), 1e-300)).max()
    )
    if not (plain or shows.any()) or share < _FAINT:
        margin = min(margin, -FLOOR)
    return Finding(
        effect,
        tuple(given),
        covariance,
        np.zeros(len(given)),
        explained=float(fall.sum()) / power,
        joint=most,
        rms_before=float(before),
        rms_after=float(after),
        asked=asked,
        torque=torque,
        share=share,
        margin=margin,
        downgrade=_contradicted(
            robot, effect, without * rows.moves, torque * rows.moves
        ),
    )


def _contradicted(robot: Robot, effect: Effect, error: Array, torque: Array) -> str:
    """The joints whose error grows with a cause that is common to all; half a sentence."""
    if not effect.is_common(robot) or effect.role == "body":
        return ""
    each = [_asked(error[:, [j]], torque[:, [j]]) for j in range(robot.nv)]
    against = [
        joint
        for joint, asked in zip(robot.joints, each, strict=True)
        if asked.gain + _CONTRADICTED * asked.gain_error < -FLOOR
    ]
    if not against:
        return ""
    return f"all joints have it, and the error of {', '.join(against)} grows with it"


def _asked(error: Array, torque: Array) -> Asked:
    power = (torque**2).sum()
    if power <= 0:
        return Asked(1.0, 0.0, 0.0)
    size = (error * torque).sum() / power
    scores = torque * (error - size * torque)
    blocks = np.array([part.sum() for part in np.array_split(scores, _BLOCKS)])
    return Asked(
        float(size), float(np.linalg.norm(blocks) / power), power / (error**2).sum()
    )


def _coefficients(
    robot: Robot, fit: Extension, effect: Effect
) -> tuple[Array, Array, Array]:
    if effect.role == "link":
        j = robot.joint_index(effect.joints[0])
        part = slice(10 * j, 10 * j + 10)
        change = fit.model.phi[part] - robot.phi[part]
        return change, np.zeros(10), fit.covariance_of(robot.parameter_names[part])
    fitted = effect_values(fit.model)
    known = effect_values(robot)
    names = [p.name for p in effect.parameters(robot)]
    value = np.array([fitted[name] for name in names])
    given = np.array([known.get(name, 0.0) for name in names])
    return value, given, fit.covariance_of(names)
