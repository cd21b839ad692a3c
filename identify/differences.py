"""What differs between recordings of one arm: a load, a zero position, friction, gravity.

The torque of recording r is judged by what the others say of the base parameters:

    τ_r = W_r β + C c + noise,    W_s β ≈ τ_s of all others s,

C being the columns of one cause at its rows. What differs is the cause that leaves the fewest
squares, where these are less than half of those without it: at all rows, and in either half of the
recording when c is fitted to the other half. Torque is linear in c but for a zero position, which
is sought from all right angles.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import scipy

from excitant.identify.least_squares import LeastSquares
from excitant.identify.preprocessing import Segment, certain_rows
from excitant.identify.regression import Regression, regression_of, triangle
from excitant.identify.repeats import noise_within, recordings_in
from excitant.identify.rows import FitRows
from excitant.robots.effects import EFFECTS, Effect, Size, plain
from excitant.robots.motion import Array
from excitant.robots.robot import Robot

DISAGREES = 2.0
"""Squares per row of a recording over those of the fit, from which on it disagrees."""
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
"""What may differ at one joint."""
ANGLES = (
    0.0,
    np.pi / 2,
    -np.pi / 2,
    np.pi,
)  # around which a zero position is sought
STEPS = 3  # Gauss-Newton steps of an angle: columns are its first derivatives


@dataclass(frozen=True, eq=False)
class Difference:
    """What one recording has otherwise than those that are fitted beside it.

    Attributes:
        recording: Its name.
        effect: The cause, with the values that it has more.
        covariance: Of these.
        left: Part of the squares that it leaves.
        rivals: Causes that would do as well.
    """

    recording: str
    effect: Effect
    covariance: Array
    left: float
    rivals: tuple[Effect, ...]

    def sizes(self, robot: Robot) -> tuple[Size, ...]:
        """By how much."""
        values = np.array(self.effect.coefficients)
        units = [p.unit for p in self.effect.parameters(robot)]
        sizes = self.effect.sizes(values, 0 * values, self.covariance, units)
        # a payload is told by its mass
        return sizes[:1] if self.effect.role == "body" else sizes

    def entry(self, robot: Robot) -> dict[str, Any]:
        """Its entry in ``result.json``."""
        return {
            "recording": self.recording,
            "effect": self.effect.name,
            "joints": list(self.effect.joints),
            "sizes": [
                {"name": s.name, "value": s.value, "std": s.std, "unit": s.unit}
                for s in self.sizes(robot)
            ],
            "left": self.left,
            "rivals": [[e.name, list(e.joints)] for e in self.rivals],
        }

    def sentence(self, robot: Robot) -> str:
        """What differs, in words."""
        causes = " or ".join(_place(e, robot) for e in (self.effect, *self.rivals))
        size = ", ".join(map(str, self.sizes(robot)))
        return (
            f"{self.recording} differs from what is fitted beside it in {causes}, by {size}: with "
            f"that, {100 * self.left:.2g} % of its squared error is left"
        )

    def without(self, model: Robot, gains: Array, segment: Segment) -> Segment:
        """A segment as it would be without; gains (nv,) are torque per reading."""
        if segment.name != self.recording:
            return segment
        if _is_zero(self.effect):
            return _read(model, self.effect, segment)
        torque = self.effect.torque(model, segment.motion) / gains
        return replace(
            segment,
            tau=segment.tau - segment.filtered(torque),
            tau_raw=segment.tau_raw - torque,
        )


def _place(effect: Effect, robot: Robot) -> str:
    where = "" if effect.is_common(robot) else f" of {', '.join(effect.joints)}"
    return f"the {plain(effect.name)}{where}"


def _is_zero(effect: Effect) -> bool:
    """Whether it is a zero position, which changes what is read."""
    return effect.name == "encoder_offset"


def _read(model: Robot, effect: Effect, segment: Segment) -> Segment:
    """The segment with the positions of a joint as they are where its zero is off by a value."""
    offset = np.zeros(model.nv)
    offset[effect.rows(model)] = effect.coefficients
    motion = replace(segment.motion, q=segment.motion.q + offset)
    return replace(segment, motion=motion)


class _Case(NamedTuple):
    """A cause from where its value is sought, and rows with its columns after those of the base."""

    effect: Effect
    start: Array
    problem: Regression


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
        self, effects: Sequence[Effect], segments: Sequence[Segment]
    ) -> Regression:
        """Base parameters and effects at the rows of segments that count, torque in N·m."""
        rows = self.rows
        both = regression_of(self.model, (*rows.effects, *effects), segments)
        more = sum(len(effect.parameters(self.model)) for effect in effects)
        columns = (*rows.base.columns, *range(both.p - more, both.p))
        used = certain_rows(rows.effects, self.model.joints, segments)
        torque = both.tau * rows.gains
        return both.select(columns).with_torque(torque).counting(used)

    def rows_of(self, problem: Regression) -> Array:
        """Columns and torque as a triangle, rows weighted as they count as independent."""
        return triangle(problem.stacked(self.weight))

    def count(self, problem: Regression) -> float:
        """Rows that count as independent."""
        rows = [len(values) for values in problem.counted(problem.tau)]
        return float(np.sum(rows / self.fit.inflation))

    def cases(
        self, segments: Sequence[Segment], beside: Sequence[Array]
    ) -> Iterator[_Case]:
        """All that may differ in a recording, of which these are the segments."""
        model = self.model
        effects = [
            EFFECTS["payload"](model.joints[-1:]),
            EFFECTS["gravity_direction"](model.joints),
            *(
                EFFECTS[name]((joint,))
                for name in OF_JOINTS
                for joint in model.joints
            ),
        ]
        wide = self.problem(effects, segments)
        base = range(len(self.fit.beta))
        end = len(base)
        for effect in effects:
            size = len(effect.parameters(model))
            own = wide.select([*base, *range(end, end + size)])
            yield _Case(effect, np.zeros(size), own)
            end += size
        for joint in np.array(model.joints)[model.revolute].tolist():
            around = [self.turned((joint,), angle, segments) for angle in ANGLES]
            turned = [self.rows_of(case.problem) for case in around]
            case = around[int(np.argmin([_left(beside, R, R) for R in turned]))]
            for _ in range(STEPS):
                both = _together(beside, self.rows_of(case.problem))
                angle = float(case.start[0] + _solution(both)[-1])
                case = self.turned((joint,), angle, segments)
            yield case

    def turned(
        self, joints: tuple[str, ...], angle: float, segments: Sequence[Segment]
    ) -> _Case:
        """A zero position that is sought around an angle."""
        effect = EFFECTS["encoder_offset"](joints)
        valued = effect.with_values(angle)
        read = [_read(self.model, valued, segment) for segment in segments]
        return _Case(effect, np.array([angle]), self.problem([effect], read))


def differences(model: Robot, rows: FitRows, fit: LeastSquares) -> list[Difference]:
    """What each recording has otherwise than those that are fitted beside it.

    Args:
        model: The identified arm.
        rows: What is fitted, and what is held out.
        fit: The base parameters by that.
    """
    data = rows.data
    trained = {name: rows.reduced.at(at) for name, at in recordings_in(data.train)}
    known = _Fit(model, rows, fit, noise_within(trained.values(), fit))
    alone = {name: known.rows_of(part) for name, part in trained.items()}
    usual = np.median(
        [
            _squares(alone[name], _solution(alone[name])) / known.count(part)
            for name, part in trained.items()
        ]
    )
    held = known.problem((), data.validate)
    unseen = {name: held.at(at) for name, at in recordings_in(data.validate)}
    found = list[Difference]()

    def disagreement(name: str, part: Regression) -> float:
        """Squares by what others show, over those of a recording where nothing differs."""
        beside = [
            rows for other, rows in alone.items() if trained[other] is not part
        ]
        own = known.rows_of(part)
        left = _left(beside, own, own) if beside else 0.0
        return left / float(usual * known.count(part))

    def look(name: str, part: Regression, segments: Sequence[Segment]) -> None:
        expected = float(usual * known.count(part))
        alike = [s for s in segments if s.name == name]
        found.extend(_difference(known, alike, [*alone.values()], part, expected))

    # the one that disagrees most first, which others are not judged by
    while trained:
        off = {name: disagreement(name, part) for name, part in trained.items()}
        worst = max(off, key=lambda name: off[name])
        if off[worst] < DISAGREES:
            break
        part = trained.pop(worst)
        del alone[worst]
        look(worst, part, data.train)
    for name, part in unseen.items():
        if disagreement(name, part) > DISAGREES:
            look(name, part, data.validate)
    return found


def _solution(rows: Array) -> Array:
    """Parameters of least squares."""
    x = np.linalg.lstsq(rows[:, :-1], rows[:, -1], rcond=None)[0]
    return np.asarray(x, float)


def _squares(rows: Array, x: Array) -> float:
    return float(np.sum((rows[:, :-1] @ x - rows[:, -1]) ** 2))


def _together(beside: Sequence[Array], own: Array) -> Array:
    """Rows of recordings over each other; those beside have fewer columns, the first ones."""
    more = own.shape[1] - beside[0].shape[1]
    wide = [np.insert(R, [R.shape[1] - 1] * more, 0.0, axis=1) for R in beside]
    return np.vstack([*wide, own])


def _left(beside: Sequence[Array], shown: Array, judged: Array) -> float:
    """Squares of some rows by the parameters that others show."""
    return _squares(judged, _solution(_together(beside, shown)))


def _difference(
    known: _Fit,
    segments: Sequence[Segment],
    beside: Sequence[Array],
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
    whole = known.rows_of(part)
    r = whole.shape[1] - 1
    count = known.count(part)
    cases = [*known.cases(segments, beside)]
    rows = [known.rows_of(case.problem) for case in cases]
    squares = np.array([_left(beside, own, own) for own in rows])
    dispersion = max(1.0, float(squares.min()) / count)
    # Schwarz's criterion
    prices = [dispersion * np.log(count) * len(case.start) for case in cases]
    order = squares + prices
    best = int(np.argmin(order))
    case = cases[best]
    own = known.rows_of(case.problem)
    left = _left(beside, own, own)
    without = _left(beside, whole, whole)
    middle = len(part) // 2
    first = slice(None, middle)
    last = slice(middle, None)

    def halved(shown: slice, judged: slice) -> bool:
        before, after = (
            _left(beside, *(known.rows_of(x.at(at)) for at in (shown, judged)))
            for x in (part, case.problem)
        )
        return after - expected / 2 <= LEAVES * (before - expected / 2)

    explained = left - expected <= LEAVES * (without - expected)
    if not (explained and halved(first, last) and halved(last, first)):
        return
    both = _together(beside, own)
    inverse = np.linalg.pinv(both[:, :-1].T @ both[:, :-1])
    alike = order - order[best] < dispersion * scipy.special.chdtri(1, SURE)
    effects = [c.effect for c, same in zip(cases, alike, strict=True) if same]
    yield Difference(
        recording=segments[0].name,
        effect=case.effect.with_values(case.start + _solution(both)[r:]),
        covariance=np.asarray(dispersion * inverse[r:, r:], float),
        left=left / without,
        rivals=tuple(e for e in dict.fromkeys(effects) if e != case.effect),
    )
