"""Agreement of several recordings of one arm, and what one of them has otherwise than the others.

With the information Λ_r = W_rᵀ W_r of each recording (rows weighted as in the fit of all, so that
their noise has unit variance) and Λ = Σ Λ_r, the score s_r = W_rᵀ (τ_r − W_r β̂) of recording r has
the covariance Λ_r − Λ_r Λ⁻¹ Λ_r where all recordings are of one model and one noise. So
s_rᵀ (Λ_r − Λ_r Λ⁻¹ Λ_r)⁺ s_r is χ²: its root over the degrees of freedom is by how many of their
standard errors the estimates of r are off, rms. What recordings say apart, whether or not each
shows all parameters, is their spread: Λ⁻¹ (Σ s_r s_rᵀ) Λ⁻¹ m / (m − 1), m recordings, is the
covariance of β̂ whatever differs between them (Liang and Zeger 1986).

What one has otherwise, a load, a zero position, friction or gravity, is told by the torque that is
left with the base parameters of the others,

    τ_r = W_r β + C c + noise,    W_s β ≈ τ_s of all others s,

C being the columns of one cause at its rows. What differs is the cause that leaves the fewest
squares, where these are less than half of those without it: at all rows, and in either half of the
recording when c is fitted to the other half. Torque is linear in c but for a zero position, which
is sought from all right angles.
"""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np
import scipy

from excitant.exceptions import RankDeficient
from excitant.identify.information import Information, combined, information_of
from excitant.identify.least_squares import LeastSquares, weighted_least_squares
from excitant.identify.preprocessing import Segment, certain_rows
from excitant.identify.regression import Regression, regression_of
from excitant.identify.rows import FitRows
from excitant.robots.effects import EFFECTS, Effect, Size
from excitant.robots.motion import Array, Mask, Noun, quotient, root_mean_square
from excitant.robots.robot import Robot
from excitant.robots.torque import coefficients

FALSE_ALARM = 0.01  # of recordings of one arm, called different
RANK = 1e-9  # eigenvalue over the largest, up to which a recording shows nothing
MODEL_ERROR = 0.005  # of a torque's rms: errors of any model, which count as noise
DISAGREES = 2.0
"""Squares per row of a recording over those of the others, from which on it disagrees."""
LEAVES = 0.5
"""Part of the squares beyond the usual that a difference leaves at most."""
SURE = 0.001
"""Probability that a difference which is there leaves as many more squares than another (χ²)."""
OF_JOINTS = (
    "torque_offset",
    "torque_gain",
    "coulomb_friction",
    "viscous_friction",
)
"""What may differ at one joint, beside its zero position."""
ANGLES = (
    0.0,
    np.pi / 2,
    -np.pi / 2,
    np.pi,
)  # around which a zero position is sought
SHOWN = 2.0  # standard deviations of a size that is told
CHUNK = 4096  # samples whose columns are held at once
STEPS = 3  # Gauss-Newton steps of an angle: columns are its first derivatives


@dataclass(frozen=True, eq=False)
class Repeats(Noun):
    """Whether recordings agree.

    Attributes:
        recordings: Their names, m of them.
        deviation: By how many of their standard errors the estimates of each are off, rms over
            what it shows, shape (m,); about 1 where noise is all that differs, NaN where it shows
            nothing.
        chance: Of deviations so large where noise is all that differs.
        spread: Standard deviation of each base parameter by what recordings say apart, (r,).
    """

    recordings: tuple[str, ...]
    deviation: Array
    chance: float
    spread: Array

    @property
    def differ(self) -> bool:
        """Whether the recordings differ by more than their noise."""
        return self.chance < FALSE_ALARM

    def sentence(self, std: Array) -> str:
        """Whether they agree, in words; std is that of the base parameters, shape (r,)."""
        if not self.differ:
            return f"the {len(self.recordings)} recordings agree within their noise"
        worst = np.nanargmax(self.deviation)
        ratio = self.spread / np.maximum(std, np.finfo(float).tiny)
        return (
            f"the recordings differ by more than their noise, most {self.recordings[worst]} (its "
            f"estimates by {self.deviation[worst]:.2g} of their standard errors, rms): base "
            f"parameters spread by {np.nanmedian(ratio):.2g} times their ± (median; worst "
            f"{np.nanmax(ratio):.2g}), which counts noise alone"
        )

    def entry(self) -> list[dict[str, Any]]:
        """Its entry in ``result.json``."""
        pairs = zip(self.recordings, self.deviation.tolist(), strict=True)
        return [{"recording": name, "deviation": size} for name, size in pairs]


def repeats_of(
    problem: Regression, fit: LeastSquares, segments: Sequence[Segment]
) -> Repeats | None:
    """Whether the recordings behind the rows of a fit agree; None of a single one."""
    parts = {name: problem.at(rows) for name, rows in recordings_in(segments)}
    names = tuple(parts)
    if len(names) < 2:
        return None
    weight = noise_within(parts.values(), fit)
    information = {}
    scores = {}
    for name, part in parts.items():
        R, z = part.factor(weight)
        information[name] = R.T @ R
        scores[name] = R.T @ (z - R @ fit.beta)
    total = np.sum(list(information.values()), axis=0)
    unit = 1 / np.sqrt(np.diag(total))
    inverse = np.linalg.inv(total * np.outer(unit, unit))
    off = np.zeros(len(names))
    freedom = np.zeros(len(names))
    for k, name in enumerate(names):
        own = information[name] * np.outer(unit, unit)
        values, vectors = scipy.linalg.eigh(own - own @ inverse @ own)
        shown = values > RANK * max(values[-1], RANK)
        seen = (vectors.T @ (unit * scores[name]))[shown]
        off[k] = (seen**2 / values[shown]).sum()
        freedom[k] = shown.sum()
    steps = np.array([unit * (inverse @ (unit * s)) for s in scores.values()])
    m = len(names)
    # of m scores that sum to zero, m − 1 are independent
    independent = (m - 1) / m
    chance = scipy.special.chdtrc(
        independent * freedom.sum(), independent * off.sum()
    )
    return Repeats(
        names,
        np.sqrt(quotient(off, freedom, otherwise=np.nan)),
        float(chance),
        np.sqrt((steps**2).sum(axis=0) * m / (m - 1)),
    )


def recordings_in(segments: Sequence[Segment]) -> Iterator[tuple[str, slice]]:
    """The rows of each recording, whose segments follow each other, by its name."""
    end = 0
    for name, own in groupby(segments, lambda s: s.name):
        begin = end
        end += sum(len(s.t) for s in own)
        yield name, slice(begin, end)


def noise_within(parts: Iterable[Regression], fit: LeastSquares) -> Array:
    """Weights of joints' rows by the noise of recordings that show all parameters alone, (nv,).

    That around the estimate of all holds what recordings differ by, too; it counts where there is
    no such recording.
    """
    noise = []
    rows = []
    for part in parts:
        with suppress(RankDeficient):
            noise.append(weighted_least_squares(part).weight ** -2.0)
            rows.append(len(part))
    if not rows:
        return fit.weight
    return np.average(noise, axis=0, weights=rows) ** -0.5


@dataclass(frozen=True, eq=False)
class Difference:
    """What one recording has otherwise than those that are fitted beside it.

    Attributes:
        segments: The recording.
        effect: The cause, with the values that it has more.
        covariance: Of these.
        left: Part of the squares that it leaves.
        rivals: Causes that would do as well.
    """

    segments: tuple[Segment, ...]
    effect: Effect
    covariance: Array
    left: float
    rivals: tuple[Effect, ...]

    @property
    def recording(self) -> str:
        """Its name."""
        return self.segments[0].name

    def sizes(self, robot: Robot) -> tuple[Size, ...]:
        """By how much."""
        values = np.array(self.effect.coefficients)
        units = [p.unit for p in self.effect.parameters(robot)]
        sizes = self.effect.sizes(values, 0 * values, self.covariance, units)
        shown = tuple(s for s in sizes if abs(s.value) > SHOWN * s.std)
        # a payload is told by its mass, where torque shows it
        return shown[:1] if self.effect.role == "body" else shown or sizes

    def entry(self, robot: Robot) -> dict[str, Any]:
        """Its entry in ``result.json``."""
        return {
            "recording": self.recording,
            "effect": self.effect.name,
            "joints": list(self.effect.joints),
            "sizes": [size.entry() for size in self.sizes(robot)],
            "left": self.left,
            "rivals": [[e.name, list(e.joints)] for e in self.rivals],
        }

    def sentence(self, robot: Robot) -> str:
        """What differs, in words."""
        sizes = self.sizes(robot)
        several = len(sizes) > 1
        size = ", ".join(f"{s.name} {s}" if several else str(s) for s in sizes)
        others = "".join(f" or {_place(e, robot)}" for e in self.rivals)
        return (
            f"{self.recording} differs from what is fitted beside it in "
            f"{self.where(robot)} by {size}{others}: with that, {100 * self.left:.2g} % of its "
            "squared error is left"
        )

    def where(self, robot: Robot) -> str:
        """What differs, and at which joint."""
        return _place(self.effect, robot)

    def without(self, model: Robot, gains: Array, segment: Segment) -> Segment:
        """A segment as it would be without; gains (nv,) are torque per reading."""
        if not any(segment is own for own in self.segments):
            return segment
        if _is_zero(self.effect):
            return _read(model, self.effect, segment)
        motion = segment.motion
        torque = np.concatenate(
            [
                self.effect.torque(model, motion[start : start + CHUNK])
                for start in range(0, len(motion), CHUNK)
            ]
        )
        return replace(
            segment,
            tau=segment.tau - segment.filtered(torque / gains),
            tau_raw=segment.tau_raw - torque / gains,
        )


def unsure_zeros(robot: Robot, differences: Sequence[Difference]) -> list[str]:
    """Zero positions in which recordings differ, a sentence each: which is right nothing says."""
    return [
        f"{each.sentence(robot)}; say which zero position is right, or leave that recording out"
        for each in differences
        if all(map(_is_zero, (each.effect, *each.rivals)))
    ]


def _place(effect: Effect, robot: Robot) -> str:
    where = "" if effect.is_common(robot) else f" of {', '.join(effect.joints)}"
    return f"the {effect.label}{where}"


def _is_zero(effect: Effect) -> bool:
    """Whether it is a zero position, which changes what is read."""
    return effect.name == "encoder_offset"


def _read(model: Robot, effect: Effect, segment: Segment) -> Segment:
    """The segment with the positions of a joint as they are where its zero is off by a value."""
    offset = np.zeros(model.nv)
    offset[effect.rows(model)] = effect.coefficients
    motion = replace(segment.motion, q=segment.motion.q + offset)
    return replace(segment, motion=motion)


_Parts = tuple[Information, Information, Information]
"""What a recording says, what its first half does, and its second."""


class _Case(NamedTuple):
    """A cause from where its value is sought, and what rows say of the base and of it."""

    effect: Effect
    start: Array
    rows: _Parts


@dataclass(frozen=True, eq=False)
class _Fit:
    """What is fitted, and the identified arm.

    Attributes:
        model: The arm.
        rows: Data and effects.
        fit: The base parameters.
        weight: Weight of each joint's rows, by the noise of each recording alone, shape (nv,).
    """

    model: Robot
    rows: FitRows
    fit: LeastSquares
    weight: Array

    def problem(
        self,
        effects: Sequence[Effect],
        segments: Sequence[Segment],
        used: Mask | None = None,
    ) -> Regression:
        """Base parameters and effects at the rows of segments that count, torque in N·m."""
        rows = self.rows
        both = regression_of(self.model, (*rows.effects, *effects), segments)
        more = len(coefficients(self.model, effects))
        columns = (*rows.base.columns, *range(both.p - more, both.p))
        if used is None:
            used = certain_rows(rows.effects, self.model.joints, segments)
        torque = both.tau * rows.gains
        return both.select(columns).with_torque(torque).counting(used)

    def parts(self, problem: Regression) -> _Parts:
        """All rows, those of the first half and those of the second, as `rows_of`."""
        middle = len(problem) // 2
        return (
            self.rows_of(problem),
            self.rows_of(problem.at(slice(middle))),
            self.rows_of(problem.at(slice(middle, None))),
        )

    def tells(self, effect: Effect) -> bool:
        """Whether its size rests on no drive gain that is not known."""
        drive = self.rows.drive
        if drive is None or drive.known.all():
            return True
        if effect.jointwise:
            return bool(drive.known[effect.rows(self.model)].all())
        return effect.role != "body"

    def rows_of(self, problem: Regression) -> Information:
        """What a recording says, rows weighted as they count as independent."""
        return information_of(*problem.factor(self.weight))

    def count(self, problem: Regression) -> float:
        """Rows that count as independent."""
        rows = [len(values) for values in problem.counted(problem.tau)]
        return max(1.0, np.sum(rows / self.fit.inflation))

    def cases(
        self,
        segments: Sequence[Segment],
        used: Mask | None,
        beside: Sequence[Information],
    ) -> Iterator[_Case]:
        """All that may differ in a recording, of which these are the segments and rows."""
        model = self.model
        effects = [
            EFFECTS["payload"](model.joints[-1:]),
            EFFECTS["gravity_direction"](model.joints),
        ]
        if model.nv > 1:
            effects.append(EFFECTS["torque_gain"](model.joints))
        for name in OF_JOINTS:
            effects += [EFFECTS[name]((joint,)) for joint in model.joints]
        whole, first, last = self.parts(self.problem(effects, segments, used))
        end = len(self.fit.beta)
        base = range(end)
        for effect in effects:
            size = len(effect.parameters(model))
            at = [*base, *range(end, end + size)]
            rows = whole.of(at), first.of(at), last.of(at)
            yield _Case(effect, np.zeros(size), rows)
            end += size
        for joint in np.array(model.joints)[model.revolute].tolist():
            effect = EFFECTS["encoder_offset"]((joint,))
            turned = partial(self.turned, effect, segments, used)
            around = [self.rows_of(turned(angle)) for angle in ANGLES]
            best = np.argmin([_left(beside, own, own) for own in around])
            angle = ANGLES[best]
            own = around[best]
            for _ in range(STEPS):
                angle += _together(beside, own).solve()[-1]
                angle = float(np.angle(np.exp(1j * angle)))  # within half a turn
                problem = turned(angle)
                own = self.rows_of(problem)
            yield _Case(effect, np.array([angle]), self.parts(problem))

    def turned(
        self,
        effect: Effect,
        segments: Sequence[Segment],
        used: Mask | None,
        angle: float,
    ) -> Regression:
        """Base parameters and a zero position, which is sought around an angle."""
        valued = effect.with_values(angle)
        read = [_read(self.model, valued, segment) for segment in segments]
        return self.problem([effect], read, used)


def differences(model: Robot, rows: FitRows, fit: LeastSquares) -> list[Difference]:
    """What each recording has otherwise than those that are fitted beside it.

    Args:
        model: The identified arm.
        rows: What is fitted, and what is held out.
        fit: The base parameters by that.
    """
    data = rows.data
    parts = {name: rows.reduced.at(at) for name, at in recordings_in(data.train)}
    noise = 1 / noise_within(parts.values(), fit)
    size = root_mean_square(rows.tau)
    known = _Fit(model, rows, fit, 1 / np.hypot(noise, MODEL_ERROR * size))
    alone = {name: known.rows_of(part) for name, part in parts.items()}
    misfits = [
        own.squares(own.solve()) / known.count(parts[name])
        for name, own in alone.items()
    ]
    usual = max(1.0, np.median(misfits))
    found = list[Difference]()

    def disagreement(own: Information, count: float) -> float:
        """Squares by what others show, over those of a recording where nothing differs."""
        beside = [other for other in alone.values() if other is not own]
        return _left(beside, own, own) / (usual * count) if beside else 0.0

    def look(name: str, part: Regression, segments: Sequence[Segment]) -> None:
        alike = tuple(s for s in segments if s.name == name)
        expected = usual * known.count(part)
        found.extend(_difference(known, alike, [*alone.values()], part, expected))

    # the one that disagrees most first; the others, which are most, are not judged by it
    while len(alone) > 2 and 2 * len(alone) > len(parts):
        off = {
            name: disagreement(own, known.count(parts[name]))
            for name, own in alone.items()
        }
        worst = max(off, key=lambda name: off[name])
        if off[worst] < DISAGREES:
            break
        del alone[worst]
        look(worst, parts[worst], data.train)
    held = known.problem((), data.validate)
    for name, at in recordings_in(data.validate):
        part = held.at(at)
        if disagreement(known.rows_of(part), known.count(part)) > DISAGREES:
            look(name, part, data.validate)
    return found


def _together(beside: Sequence[Information], own: Information) -> Information:
    """What recordings say together; those beside have the first of the parameters."""
    more = len(own.z) - len(beside[0].z)
    wide = [
        Information(
            np.pad(i.R, ((0, more), (0, more))), np.pad(i.z, (0, more)), i.rest
        )
        for i in beside
    ]
    return combined([*wide, own])


def _left(
    beside: Sequence[Information], shown: Information, judged: Information
) -> float:
    """Squares of some rows by the parameters that others show."""
    return judged.squares(_together(beside, shown).solve())


def _difference(
    known: _Fit,
    segments: tuple[Segment, ...],
    beside: Sequence[Information],
    part: Regression,
    expected: float,
) -> Iterator[Difference]:
    """What a recording has otherwise, if that can be told.

    Args:
        known: What is fitted.
        segments: The recording.
        beside: Rows of the others.
        part: Its own, of base parameters alone.
        expected: Squares of such a recording where nothing differs.
    """
    base = known.parts(part)
    r = part.p
    count = known.count(part)
    cases = [*known.cases(segments, part.used, beside)]
    squares = np.array([_left(beside, c.rows[0], c.rows[0]) for c in cases])
    dispersion = max(1.0, squares.min() / count)
    # Schwarz's criterion
    prices = [dispersion * np.log(count) * len(case.start) for case in cases]
    order = squares + prices
    best = np.argmin(order)
    case = cases[best]

    def explains(shown: int, judged: int, expected: float) -> bool:
        before, after = (
            _left(beside, rows[shown], rows[judged]) for rows in (base, case.rows)
        )
        return after - expected <= LEAVES * (before - expected)

    halves = explains(1, 2, expected / 2) and explains(2, 1, expected / 2)
    if not (explains(0, 0, expected) and halves and known.tells(case.effect)):
        return
    both = _together(beside, case.rows[0])
    inverse = np.linalg.pinv(both.R.T @ both.R)
    alike = order - order[best] < dispersion * scipy.special.chdtri(1, SURE)
    effects = [c.effect for c, same in zip(cases, alike, strict=True) if same]
    yield Difference(
        segments=segments,
        effect=case.effect.with_values(case.start + both.solve()[r:]),
        covariance=np.asarray(dispersion * inverse[r:, r:], float),
        left=float(squares[best]) / _left(beside, base[0], base[0]),
        rivals=tuple(e for e in effects if e != case.effect),
    )
