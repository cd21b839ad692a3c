"""Confirmation of causes on data that were not fitted, with the gain of each."""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import scipy

from excitant.analysis.candidates import Observed, coefficient_sizes, observed
from excitant.analysis.evidence import (
    Candidate,
    Evidence,
    Key,
    are_placeholders,
    widened,
)
from excitant.analysis.residuals import motion_noise, noise_floor
from excitant.analysis.selection import Rival, is_plain_friction, underlies
from excitant.analysis.thresholds import (
    CONFIRMATION,
    DISCRIMINATION,
    EVIDENCE,
    SEARCH,
    VERDICT,
)
from excitant.identify.accuracy import series
from excitant.identify.attenuation import (
    NOISE_UNSURE,
    attenuation,
    without_noise,
)
from excitant.identify.drive_gains import DriveGains
from excitant.identify.objections import HoldOut
from excitant.identify.physical import PhysicalFit, agreement, fit_physical
from excitant.identify.preprocessing import Segment, away_from_rest
from excitant.identify.prior import BodyPrior, EffectPrior
from excitant.identify.regression import dense
from excitant.identify.rows import identified_robot, predicted_torque
from excitant.robots.effects import (
    Effect,
    amended,
    merged,
)
from excitant.robots.effects.body import GivenInertias, InertialParameters
from excitant.robots.motion import Array, Indices, root_mean_square
from excitant.robots.parameters import from_pseudo_inertia
from excitant.robots.robot import Robot
from excitant.robots.torque import coefficients, column_names, effect_values

NO_COVARIANCE = np.zeros((0, 0))


class HoldoutScale(NamedTuple):
    """Factor on a fitted torque that fits the hold-out best, all else as it is."""

    size: float
    std: float  # standard error, from blocks of time
    power: float  # ‖torque‖² / ‖error‖²

    @property
    def gain(self) -> float:
        """Fall of the squared error with the torque as fitted, relative: (2a − 1)‖f‖² / ‖e‖²."""
        return (2 * self.size - 1) * self.power

    @property
    def gain_std(self) -> float:
        """Standard error of the gain."""
        return 2 * self.std * self.power

    def most(self, deviations: float) -> float:
        """The gain if it is larger by so many standard errors."""
        return self.gain + deviations * self.gain_std


def holdout_scale(error: Array, torque: Array) -> HoldoutScale:
    """Scale of a torque by an error, both (n, joints), in units in which noise is alike."""
    power = (torque**2).sum()
    if power <= 0:
        return HoldoutScale(1.0, 0.0, 0.0)
    size = (error * torque).sum() / power
    scores = torque * (error - size * torque)
    parts = np.array_split(scores, CONFIRMATION.blocks)
    std = np.linalg.norm([part.sum() for part in parts]) / power
    return HoldoutScale(float(size), float(std), power / (error**2).sum())


@dataclass(frozen=True, eq=False)
class Finding:
    """One cause that the data support.

    Attributes:
        effect: The cause, on one joint, with the value that the extended model has.
        nominal: The value that the nominal model has for each coefficient.
        covariance: Of its k coefficients by the fit if it is the cause, shape (k, k).
        by_gains: Their errors by one standard deviation of the drive gains, shape (k,).
        explained: Share of the nominal model's squared error on the hold-out that it removes;
            beyond one where other causes depend on it.
        part: The same of the error at the joints that it acts on.
        joint: Index of the joint where it is largest relative to what remains.
        rms_before: Error on the hold-out without it, all others kept, of its joints that turn or
            slide as that one does [torque unit].
        rms_after: The same of the extended model [torque unit].
        scale: Scale of its torque by the hold-out at its joints, and the gain.
        torque: What it adds at the rows of the hold-out, shape (n, nv) [torque unit].
        share: Rms of that relative to the measured torque, of the joint where it is largest.
        margin: Gain beyond the threshold of confirmation; negative where the size may be chance.
        rivals: Causes that the data cannot distinguish from it.
        downgrade: Reason to call it undecided although it has no rival; else empty.
        instead: The extended model with the first of its rivals in its place, if it has one.
    """

    effect: Effect
    nominal: tuple[float, ...]
    covariance: Array
    by_gains: Array
    explained: float
    part: float
    joint: int
    rms_before: float
    rms_after: float
    scale: HoldoutScale
    torque: Array
    share: float
    margin: float = 0.0
    rivals: tuple[Rival, ...] = ()
    downgrade: str = ""
    instead: Robot | None = None

    @property
    def change(self) -> Array:
        """How far its coefficients are off the nominal ones, shape (k,)."""
        return np.array(self.effect.values or ()) - self.nominal

    @property
    def total(self) -> Array:
        """Covariance of its coefficients with their errors by the gains, shape (k, k)."""
        return self.covariance + np.outer(self.by_gains, self.by_gains)

    @property
    def std(self) -> Array:
        """Standard deviation of each coefficient, shape (k,)."""
        return np.sqrt(np.diag(self.total))

    @property
    def significant(self) -> bool:
        """Whether its gain and its size exceed chance and noise; if not, others need it."""
        return self.margin >= 0

    @property
    def is_open(self) -> bool:
        """Whether it may as well be smaller as larger than given, to two standard deviations."""
        first = self._deviations(self.total)[:1]
        return any(off < CONFIRMATION.deviations for off in first)

    @property
    def is_vague(self) -> bool:
        """Whether no size that is told of it is as large as its standard deviation.

        Of links together none is told; of a body, its mass is. Gains of drives do not count.
        """
        effect = self.effect
        if effect.role == "link" and len(effect.joints) > 1:
            return False
        deviations = self._deviations(self.covariance)
        told = deviations if effect.role == "torque" else deviations[:1]
        return bool(told) and max(told) < 1.0

    def _deviations(self, covariance: Array) -> list[float]:
        """How far each of its sizes is off the nominal one, in standard deviations."""
        values = np.array(self.effect.values or ())
        units = [""] * len(values)
        sizes = self.effect.sizes(values, np.array(self.nominal), covariance, units)
        return [abs(s.value - s.given) / max(s.std, 1e-300) for s in sizes]

    @property
    def is_nominal(self) -> bool:
        """Whether all its values are the nominal ones to two standard deviations."""
        change = np.abs(self.change)
        threshold = CONFIRMATION.deviations * self.std
        return len(change) > 0 and bool((change < threshold).all())

    def by_chance(self, level: float) -> bool:
        """Whether values as far from the nominal ones come by chance that often, or more (χ²)."""
        if not self.total.any():
            return False
        change = self.change
        distance = change @ scipy.linalg.pinvh(self.total) @ change
        return bool(distance < scipy.special.chdtri(len(change), level))

    @property
    def is_no_change(self) -> bool:
        """Whether it is an effect of the nominal model with its value."""
        of_model = self.effect.role == "torque" and any(self.nominal)
        return of_model and self.is_nominal

    @property
    def refuted(self) -> bool:
        """Whether the error on the hold-out is significantly larger with it."""
        return self.scale.most(CONFIRMATION.deviations) < -CONFIRMATION.floor

    @property
    def matters(self) -> bool:
        """Whether an experiment that decides it is worth while."""
        return self.part >= DISCRIMINATION.matters

    @property
    def verdict(self) -> str:
        """``named``, or ``undecided`` when there are rivals or reasons to downgrade it."""
        return "undecided" if self.rivals or self.downgrade else "named"


@dataclass(frozen=True, eq=False)
class Holdout(HoldOut):
    """The hold-out of a diagnosis, on which the nominal model predicts itself.

    Attributes:
        observed: Its rows, of the nominal robot in the set-up found.
        mounted: Torque of the nominal model in the set-up found, shape (n, nv) [torque unit].
        floor: Noise of each joint's filtered torque, measured and modelled, shape (nv,).
    """

    observed: Observed
    mounted: Array
    floor: Array

    @property
    def robot(self) -> Robot:
        """The nominal robot in the set-up found."""
        return self.observed.robot

    @property
    def error(self) -> Array:
        """Error of the nominal model."""
        return self.series.measured - self.nominal

    def worse(
        self,
        predicted: Array,
        than: Array,
        share: float = 0.0,
        *,
        at_rest: bool = False,
    ) -> bool:
        """Whether a prediction has a larger squared error than another, by a share, in motion.

        Or at all rows, those ``at_rest`` too.
        """
        measured = self.series.measured
        weight = (self.series.moves | at_rest) / measured.std(axis=0)
        error, other = (
            (((measured - each) * weight) ** 2).sum() for each in (predicted, than)
        )
        return bool(error > (1 + share) * other)

    def rms_like(self, error: Array, joints: Sequence[int], lead: int) -> float:
        """Rms of an error over the joints that turn or slide as a leading one does."""
        revolute = self.robot.revolute
        alike = [j for j in joints if revolute[j] == revolute[lead]]
        return float(root_mean_square(self.series.rms(error)[alike]))


def holdout_of(
    robot: Robot,
    segments: tuple[Segment, ...],
    gains: Array,
    nominal: Robot,
    drive: DriveGains | None,
) -> Holdout:
    """The hold-out of a robot as it is set up, and as it is described; gains are (nv,)."""
    rows = observed(robot, segments)
    floor = np.array([noise_floor(segments, j) for j in range(robot.nv)])
    floor = np.hypot(floor, motion_noise(robot, segments) / gains)
    mounted = rows.torque() / gains
    given = mounted
    if nominal is not robot:
        given = predicted_torque(nominal, segments) / gains
    return Holdout(
        segments, series(segments), gains, given, given, drive, rows, mounted, floor
    )


@dataclass(frozen=True, eq=False)
class Extension:
    """The nominal model with causes added, everything re-identified physically consistently."""

    evidence: Evidence  # by which the causes were chosen
    chosen: tuple[Candidate, ...]
    model: Robot  # with re-identified inertias and effects, those of the causes included
    names: tuple[str, ...]  # of its parameters
    covariance: Array  # of them
    observed: Observed  # columns of that model at the rows of the hold-out
    predicted: Array  # its torque at them, shape (n, nv) [torque unit]
    findings: tuple[Finding, ...] = ()  # each cause with its gain on the hold-out
    # selected causes with which the hold-out is worse
    refuted: frozenset[Key] = frozenset()
    extender: Extender | None = (
        None  # by which it was fitted; None of the nominal model
    )

    def settled(self) -> Extension:
        """It with bodies as uncertain as the data say, and no effects that cancel each other.

        Friction turns as in an identification where that predicts better, rows of rest included,
        and hardly worse in motion. A cause stays without which the hold-out is predicted worse: it
        is not cancelled there.
        """
        if self.extender is None:
            return self
        worse = self.extender.holdout.worse
        extender = self.extender.by_data(self.chosen)
        fit = extender(self.chosen)
        if worse(fit.predicted, self.predicted, CONFIRMATION.floor):
            extender, fit = self.extender, self
        turning = replace(extender, turns=True)
        turns = turning.again(self.chosen) if extender.train.reversals else fit
        better = worse(fit.predicted, turns.predicted, at_rest=True)
        if better and not worse(turns.predicted, fit.predicted, SEARCH.gain):
            extender, fit = turning, turns
        needed = set[Key]()
        while (cause := _cancelled(fit, needed)) is not None:
            without = extender.again([c for c in fit.chosen if c is not cause])
            if worse(without.predicted, fit.predicted, CONFIRMATION.floor):
                needed.add(cause.key)
            else:
                fit = without
        return fit

    def places(self, effect: Effect) -> list[int]:
        """Places of an effect's coefficients among the parameters, none of those of links."""
        names = [p.name for p in effect.parameters(self.model)]
        return [self.names.index(name) for name in names if name in self.names]

    def unsure_of(self, finding: Finding, causes: Sequence[Finding]) -> Finding:
        """A finding with what it would change by if undecided causes are other ones, as error.

        Without a cause whose coefficients x_u are off the nominal ones by d, all parameters x are
        off by C_xu C_uu⁻¹ d. With its rival, they are those fitted then; not those of a joint's
        friction with another law for it, which are a convention.
        """
        size = len(finding.covariance)
        own = self.places(finding.effect)[:size]
        covariance = np.array(finding.covariance)
        robot = self.observed.robot
        for cause in causes:
            if cause.effect is finding.effect or not size:
                continue
            if cause.instead is not None and not _is_one_friction(
                finding.effect, cause.rivals[0].candidate.effect
            ):
                here = coefficients_of(self.model, robot, finding.effect)
                there = coefficients_of(cause.instead, robot, finding.effect)
                covariance += np.outer(there - here, there - here)
            at = self.places(cause.effect)[: len(cause.covariance)]
            if cause.downgrade and own and at:
                inverse = scipy.linalg.pinvh(self.covariance[np.ix_(at, at)])
                shift = self.covariance[np.ix_(own, at)] @ inverse @ cause.change
                covariance += np.outer(shift, shift)
        return replace(finding, covariance=covariance)


def _is_one_friction(one: Effect, other: Effect) -> bool:
    apart = {*one.joints}.isdisjoint(other.joints)
    return not apart and one.family == other.family == "friction"


def unextended(evidence: Evidence, holdout: Holdout) -> Extension:
    """The nominal model as it is set up."""
    rows = holdout.observed
    return Extension(
        evidence, (), rows.robot, (), NO_COVARIANCE, rows, holdout.mounted
    )


class _Rows(NamedTuple):
    """Rows to fit a model to."""

    effects: list[Effect]  # of the model
    names: tuple[str, ...]  # of its parameters
    W: Array  # columns of bodies and effects, (n, nv, p)
    R: Array  # the same whitened, without the noise of positions where it can be told
    noisy: Array  # the same with that noise
    z: Array  # whitened torque


@dataclass(frozen=True, eq=False)
class Extender:
    """Fits the nominal robot with added causes: these are free, all else keeps its tolerance."""

    prior: (
        Array  # standard parameters of the nominal robot as prior, shape (nv, 10)
    )
    train: Observed  # columns to fit, of the model so far
    tau: Array  # measured torque at the rows, shape (n, nv) [N·m]
    holdout: Holdout
    evidence: Evidence  # noise levels, and the tolerance that the data support
    gains: Array | None = (
        None  # covariance of the logarithms of drive gains, (nv, nv)
    )
    # the columns as even and as odd samples show them, where positions are coarse
    halves: tuple[Observed, ...] = ()
    # how uncertain the data say that each link is, (nv,): the bias by noise of the motion counts
    link_std: Array | None = None
    # whether friction of all joints turns as identify has it, cause or not
    turns: bool = False

    def __call__(self, chosen: Sequence[Candidate]) -> Extension:
        """The extended model with a set of causes."""
        robot = self.holdout.robot
        rows = self._rows(chosen)
        fit = self._fit(chosen, rows)
        model = identified_robot(robot, rows.effects, fit.x)
        score = NOISE_UNSURE * (rows.R.T @ ((rows.noisy - rows.R) @ fit.x))
        if self.link_std is not None and not self.halves:
            segments = self.train.segments
            used = away_from_rest(segments)
            weight = np.sqrt(self.evidence.weight)
            columns = range(len(fit.x))
            score = attenuation(
                robot, rows.effects, segments, used, weight, columns, fit.x
            )
        bias = fit.covariance @ score
        observed = self.holdout.observed.by(model)
        extension = Extension(
            self.evidence,
            tuple(chosen),
            model,
            rows.names,
            fit.covariance + np.outer(bias, bias),
            observed,
            observed.torque() / self.holdout.gains,
            extender=self,
        )
        return replace(extension, findings=_findings(extension, self.holdout))

    def model(self, chosen: Sequence[Candidate]) -> Robot:
        """That model alone."""
        rows = self._rows(chosen)
        x = self._fit(chosen, rows).x
        return identified_robot(self.holdout.robot, rows.effects, x)

    def predicted(self, model: Robot) -> Array:
        """Torque of a model at the rows of the hold-out, shape (n, nv) [torque unit]."""
        return self.holdout.observed.by(model).torque() / self.holdout.gains

    def as_given(self, effect: Effect) -> Extender:
        """The same with a link of which an effect tells as uncertain as the others."""
        if effect.role != "link" or self.link_std is None:
            return self
        std = np.array(self.link_std)
        std[effect.rows(self.holdout.robot)] = std.min()
        return replace(self, link_std=std)

    def is_off(self, effect: Effect, model: Robot) -> bool:
        """Whether a model has a link, of which an effect tells, off the given one beyond chance."""
        if effect.role != "link":
            return False
        rows = effect.rows(self.holdout.robot)
        given = self._body_prior(())
        sigma = np.broadcast_to(given.sigma, len(given.bodies))
        link = BodyPrior(given.bodies[rows], sigma[rows])
        phi = model.phi.reshape(-1, 10)[rows].ravel()
        chance = scipy.special.chdtri(len(phi), VERDICT.chance)
        return bool(link.surprise(phi) > chance)

    def again(self, chosen: Sequence[Candidate]) -> Extension:
        """The extended model with other causes, beside which links are as uncertain anew."""
        extender = self if self.link_std is None else self.by_data(chosen)
        return extender(chosen)

    def by_data(self, chosen: Sequence[Candidate]) -> Extender:
        """The same with links as uncertain as the data say, beside a set of causes."""
        rows = self._rows(chosen)
        std = agreement(rows.R, rows.z, self._body_prior(chosen).bodies)
        return replace(self, link_std=std[: len(self.prior)])

    def _rows(self, chosen: Sequence[Candidate]) -> _Rows:
        robot = self.holdout.robot
        hidden = self.train.reversals if self.turns else ()
        effects = _effects(robot, chosen, hidden)
        W, noise = self._columns(effects)
        names = column_names(robot, effects)
        used = away_from_rest(self.train.segments)
        weight = np.sqrt(self.evidence.weight)
        R, z = dense(W, self.tau, names, used).factor(weight)
        noisy = R
        if noise is not None:
            errors = dense(noise, self.tau, names, used).gram(weight**2)
            R = without_noise(R, errors[:-1, :-1])
        return _Rows(effects, names, W, R, noisy, z)

    def _fit(self, chosen: Sequence[Candidate], rows: _Rows) -> PhysicalFit:
        bodies = self._body_prior(chosen)
        columns = rows.W[:, :, bodies.bodies.size :]
        scalar = self._effect_prior(rows.effects, chosen, columns)
        return fit_physical(rows.R, rows.z, bodies, scalar)

    def by(self, model: Robot, keep: Set[Effect]) -> Extender:
        """The same with columns of another model, but for those of some effects that are kept."""
        return replace(
            self,
            train=self.train.by(model, keep),
            halves=tuple(half.by(model, keep) for half in self.halves),
        )

    def _columns(self, effects: Sequence[Effect]) -> tuple[Array, Array | None]:
        """Columns of bodies and effects, and their noise where it can be told, (n, nv, p)."""
        if not self.halves:
            return self.train.matrix(effects), None
        even, odd = (half.matrix(effects) for half in self.halves)
        return (even + odd) / 2, (even - odd) / 2

    def _body_prior(self, chosen: Sequence[Candidate]) -> BodyPrior:
        """Prior of every link, and of a payload if there is one."""
        robot = self.holdout.robot
        sigma = EVIDENCE.tolerance * widened(robot, self.evidence.tolerance[0])
        if self.link_std is not None:
            sigma = np.maximum(sigma, self.link_std)
        for c in chosen:
            if c.effect.role == "link":
                rows = c.effect.rows(robot)
                sigma[rows] = np.maximum(sigma[rows], EVIDENCE.wrong_link)
        if not any(c.effect.role == "body" for c in chosen):
            return BodyPrior(self.prior, sigma)
        mass = CONFIRMATION.payload_share * self.prior[:, 0].sum()
        moment = CONFIRMATION.payload_radius**2
        payload = from_pseudo_inertia(mass * np.diag([moment, moment, moment, 1.0]))
        bodies = np.vstack([self.prior, payload])
        return BodyPrior(bodies, np.append(sigma, CONFIRMATION.payload_std))

    def _effect_prior(
        self, effects: Sequence[Effect], chosen: Sequence[Candidate], columns: Array
    ) -> EffectPrior:
        robot = self.holdout.robot
        scalar = [e for e in effects if e.role != "body"]
        parameters = coefficients(robot, scalar)
        mean = np.array(
            [
                v
                for e in scalar
                for v in e.values or (0.0,) * len(e.parameters(robot))
            ]
        )
        tolerance = self.evidence.tolerance[1] * EVIDENCE.tolerance
        known = np.maximum(tolerance * np.abs(mean), 1e-9)
        names = {p.name for c in chosen for p in c.effect.parameters(robot)}
        free = np.array([p.name in names for p in parameters], dtype=bool)
        std = np.where(
            free, coefficient_sizes(parameters, columns, self.tau), known
        )
        return EffectPrior(mean, std, np.array([p.lower for p in parameters]))


def _effects(
    robot: Robot, chosen: Sequence[Candidate], hidden: Sequence[Effect]
) -> list[Effect]:
    present = {p.name for p in coefficients(robot, robot.effects)}
    bodies = [c.effect for c in chosen if c.effect.role == "body"]
    causes = [c.effect for c in chosen if c.effect.role == "torque"]
    amends = [e for e in causes if e.physics.amends]
    added = [
        e
        for e in causes
        if not e.physics.amends
        and not {p.name for p in e.parameters(robot)} <= present
    ]
    return amended([*bodies, *robot.effects, *merged(added)], amends, hidden)


def _cancelled(fit: Extension, needed: Set[Key] = frozenset()) -> Candidate | None:
    """The least cause that another mostly cancels, or None.

    Their sum is known, not what each of them is. Plain friction stays, the finer goes; what is
    needed stays.
    """
    pairs = zip(fit.chosen, fit.findings, strict=True)
    found = [
        (is_plain_friction(c.effect), f.margin, c)
        for c, f in pairs
        if c.key not in needed
        and c.effect.role == "torque"
        and any(cancelling(f, g) for g in fit.findings if g is not f)
    ]
    return min(found, key=lambda each: each[:2])[2] if found else None


def cancelling(one: Finding, other: Finding) -> bool:
    """Whether two causes together make much less torque than either; bodies may well do so."""
    if not {*one.effect.joints} & {*other.effect.joints}:
        return False
    if "torque" not in (one.effect.role, other.effect.role):
        return False
    both = ((one.torque + other.torque) ** 2).sum()
    least = min((one.torque**2).sum(), (other.torque**2).sum())
    return bool(both < VERDICT.cancelling * least)


def confirmed(extender: Extender, chosen: Sequence[Candidate]) -> Extension:
    """The fit with the causes that the hold-out confirms, by elimination of the weakest.

    Plain friction below finer friction stays, and a cause without which the refit is clearly worse.
    So does one at joints that rest throughout the hold-out, which says nothing of it.
    """
    holdout = extender.holdout
    fit = extender(chosen)
    moved = {*np.flatnonzero(holdout.series.moves.any(axis=0)).tolist()}
    needed = {
        c for c in chosen if moved.isdisjoint(c.effect.affected(holdout.robot))
    }
    refuted = set[Key]()
    while (worst := _weakest(holdout.robot, fit, needed)) is not None:
        if fit.findings[fit.chosen.index(worst)].refuted:
            refuted.add(worst.key)
        fewer = extender([c for c in fit.chosen if c is not worst])
        if holdout.worse(fewer.predicted, fit.predicted, CONFIRMATION.floor):
            needed.add(worst)
        else:
            fit = fewer
    return replace(fit, refuted=frozenset(refuted))


def _weakest(
    robot: Robot, fit: Extension, needed: set[Candidate]
) -> Candidate | None:
    pairs = zip(fit.findings, fit.chosen, strict=True)
    for finding, candidate in sorted(pairs, key=lambda pair: pair[0].margin):
        if finding.significant:
            return None
        rest = [c for c in fit.chosen if c is not candidate]
        if candidate not in needed and not underlies(robot, rest, candidate):
            return candidate
    return None


def _findings(fit: Extension, holdout: Holdout) -> tuple[Finding, ...]:
    findings = []
    for candidate in fit.chosen:
        finding = _refitted(fit, holdout, candidate.effect)
        if finding.effect.role == "torque" and finding.is_nominal:
            margin = min(finding.margin, -CONFIRMATION.floor)
            finding = replace(finding, margin=margin)
        findings.append(finding)
    return tuple(findings)


def _refitted(fit: Extension, holdout: Holdout, effect: Effect) -> Finding:
    """The change of an effect's values, or of links, from the nominal ones."""
    robot = holdout.robot
    if effect.physics.amends:
        force = coefficients_of(fit.model, robot, effect)[:1]
        torque = fit.observed.columns(effect) @ force / holdout.gains
        return finding_of(fit, holdout, effect.with_values(()), torque)
    values, nominal, covariance = _coefficients(robot, fit, effect)
    torque = fit.observed.columns(effect) @ (values - nominal) / holdout.gains
    changed = effect.with_values(values.tolist())
    return finding_of(fit, holdout, changed, torque, nominal.tolist(), covariance)


def kept_effects(
    fit: Extension, holdout: Holdout
) -> tuple[list[Finding], list[Finding]]:
    """The nominal effects that are no causes, joint by joint, with the values of the data.

    Those whose values the data correct noticeably, and the others, which are within the tolerance.
    """
    least = _noticed(fit.evidence.tolerance[1])
    chosen = {candidate.key for candidate in fit.chosen}
    noticed = list[Finding]()
    others = list[Finding]()
    singles = (
        single for effect in holdout.robot.effects for single in effect.singles()
    )
    for effect in singles if fit.names else ():
        if effect.role == "torque" and (effect.name, effect.joints) not in chosen:
            finding = _refitted(fit, holdout, effect)
            clear = finding.significant and finding.share > least
            (noticed if clear else others).append(finding)
    return noticed, others


def _noticed(tolerance: float) -> float:
    """Share of a torque by which nominal values are noticeably off: those within ±10 % are not.

    Where they are off by more than they might be, smaller corrections belong to the finding.
    """
    return 2 * EVIDENCE.tolerance / max(tolerance, 1.0)


def off_bodies(fit: Extension, holdout: Holdout) -> Finding | None:
    """The links whose nominal inertias the data contradict, as one finding, or None."""
    robot = holdout.robot
    if are_placeholders(robot) or not fit.names:
        return None
    changed = {
        joint
        for c in fit.chosen
        if c.effect.role != "torque"
        for joint in c.effect.joints
    }

    def of(*joints: str) -> Finding:
        kind = GivenInertias if len(joints) > 1 else InertialParameters
        return _refitted(fit, holdout, kind(joints))

    others = (joint for joint in robot.joints if joint not in changed)
    off = [joint for joint in others if of(joint).significant]
    if not off:
        return None
    finding = of(*off)
    return finding if finding.share > _noticed(fit.evidence.tolerance[0]) else None


def finding_of(
    fit: Extension,
    holdout: Holdout,
    effect: Effect,
    torque: Array,
    nominal: Sequence[float] = (),
    covariance: Array = NO_COVARIANCE,
) -> Finding:
    """A cause with its gain on the hold-out, where it makes a torque (n, nv) [torque unit]."""
    robot = holdout.robot
    rows = holdout.series
    error = rows.measured - fit.predicted
    without = error + torque
    weight = rows.moves * holdout.gains / fit.evidence.sigma
    power = ((holdout.error * weight) ** 2).sum(axis=0)
    joints = effect.affected(robot)
    fall = ((without**2 - error**2) * weight**2)[:, joints]
    scale = holdout_scale(
        (without * weight)[:, joints], (torque * weight)[:, joints]
    )
    lead = effect.rows(robot)[0]
    # a joint that rests throughout shows no torque but what dry friction holds
    size = rows.rms(torque) * rows.moves.any(axis=0)
    if not effect.jointwise:
        lead = int(np.argmax(size / rows.rms(error)))
    measured = np.maximum(rows.rms(rows.measured), 1e-300)
    share = float((size / measured).max())
    margin = scale.gain
    margin -= max(CONFIRMATION.floor, CONFIRMATION.deviations * scale.gain_std)
    # what depends on the model looks like noise of positions
    plain = scale.gain > CONFIRMATION.plain and not effect.physics.on_model
    rms = root_mean_square(torque * rows.moves)
    # noise is no larger than what is left
    visible = plain or (rms > np.minimum(holdout.floor, rows.rms(error))).any()
    if not visible or share < CONFIRMATION.faint:
        margin = min(margin, -CONFIRMATION.floor)
    return Finding(
        effect,
        tuple(nominal),
        covariance,
        np.zeros(len(nominal)),
        explained=float(fall.sum() / power.sum()),
        part=float(fall.sum() / max(power[joints].sum(), 1e-300)),
        joint=lead,
        rms_before=holdout.rms_like(without, joints, lead),
        rms_after=holdout.rms_like(error, joints, lead),
        scale=scale,
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
    against = []
    for j, joint in enumerate(robot.joints):
        scale = holdout_scale(error[:, [j]], torque[:, [j]])
        if scale.most(CONFIRMATION.contradicted) < -CONFIRMATION.floor:
            against.append(joint)
    if not against:
        return ""
    return (
        f"all joints have it, and the error of {', '.join(against)} grows with it"
    )


def _coefficients(
    robot: Robot, fit: Extension, effect: Effect
) -> tuple[Array, Array, Array]:
    """Values of the extended and the nominal model, (k,), and the covariance of the former."""
    value = coefficients_of(fit.model, robot, effect)
    if effect.role == "link":
        at = _inertial_rows(robot, effect)
        return value, np.zeros(len(at)), fit.covariance[np.ix_(at, at)]
    before = coefficients_of(robot, robot, effect)
    places = fit.places(effect)
    covariance = np.array(fit.covariance[np.ix_(places, places)])
    between_samples = effect.physics.between_samples
    if fit.extender and between_samples:
        joints = effect.rows(robot)
        segments = fit.extender.train.segments
        variances = [between_samples(fit.model, x.motion, joints) for x in segments]
        covariance += np.mean(variances) / len(segments)
    return value, before, covariance


def coefficients_of(model: Robot, robot: Robot, effect: Effect) -> Array:
    """Coefficients that a model of a nominal robot has of an effect, (k,): of links, the change."""
    if effect.role == "link":
        at = _inertial_rows(robot, effect)
        return model.phi[at] - robot.phi[at]
    values = effect_values(model)
    return np.array([values.get(p.name, 0.0) for p in effect.parameters(robot)])


def _inertial_rows(robot: Robot, effect: Effect) -> Indices:
    places = np.arange(robot.phi.size).reshape(-1, 10)
    return places[effect.rows(robot)].ravel()


def errors_by_gains(
    finding: Finding, robot: Robot, drive: DriveGains | None
) -> Array:
    """Errors of a finding's coefficients by one standard deviation of the drive gains.

    It is of their logarithms: a value far below the nominal one is as unsure as that, and what a
    link has more or less, as the link.
    """
    effect = finding.effect
    values = np.array(effect.values or ())
    largest = np.maximum(np.abs(values), np.abs(finding.nominal))
    if effect.role != "torque" and len(values):
        links = robot.phi[_inertial_rows(robot, effect)]
        largest = np.maximum(largest, np.abs(links))
    size = np.copysign(largest, values)
    if drive is None:
        return 0 * size
    if effect.role == "torque" and effect.joints:
        rows = effect.rows(robot)
        spread = np.sqrt(drive.covariance[rows, rows].max())
    else:
        spread = drive.scale_std
    return spread * size
