"""Separation of rival causes by a motion.

Two causes A and B explain a recording equally well. If A is present as it was found, a further
motion adds a torque s_A that B, with its best coefficients and shape, must reproduce together with
the recording:

    Δ = min over η, θ_B of ‖s_A − N η − C_B θ_B‖²_Λ + ‖η‖²_prior,

summed over the rows of both (T-optimality: Atkinson and Fedorov 1975). N are given values within
their tolerance and the other causes, Λ the noise with its autocorrelation. The smaller Δ of the two
directions counts; where one is a special case of the other, only the general one can be A.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy

from excitant.analysis.candidates import Observed, cause_columns
from excitant.analysis.evidence import widened
from excitant.analysis.thresholds import DISCRIMINATION, EVIDENCE, SELECTION
from excitant.identify.preprocessing import Segment, away_from_rest, top_speed
from excitant.identify.prior import link_coordinates, link_weights, prior_parameters
from excitant.identify.regression import ActingColumns, dense
from excitant.robots.effects import Effect, JointFacts, alternatives, joint_facts
from excitant.robots.motion import Array, Motion
from excitant.robots.regressor import regressor
from excitant.robots.robot import Robot

FREE = 1e-9  # prior precision of free coefficients, relative to their information
SAMPLES_PER_ROW = 2.0  # of a motion
ROWS_PER_PERIOD = 4.0  # of the cut-off, as many as recordings are decimated to


@dataclass(frozen=True)
class Separation:
    """Separation of two causes by a motion."""

    delta: float  # Δ in squared standard deviations of the noise
    whole: float  # the same of the cause alone, beside given values and the other causes
    # runs until `diagnose` decides; None where a contest's most runs are too few
    repetitions: int | None = None

    @property
    def cosine(self) -> float:
        """Between one cause's torque and its best imitation by the other."""
        if self.whole <= 0:
            return 1.0
        return float(np.sqrt(1 - self.delta / self.whole))

    @property
    def same_torque(self) -> bool:
        """Whether both make the same torque, one that can be seen."""
        seen = self.whole > DISCRIMINATION.hopeless
        return seen and self.cosine > SELECTION.identical

    @property
    def enough(self) -> bool:
        """Whether `diagnose` decides, at a stricter level where both still look alike."""
        alike = self.cosine > SELECTION.alike
        level = DISCRIMINATION.alike_level if alike else DISCRIMINATION.level
        return self.delta >= needed(level)


@dataclass(frozen=True, eq=False)
class Pair:
    """Two causes of which either explains a recording."""

    found: Effect  # its values relative to those of the given model
    rival: Effect  # its values are ignored
    # further causes, whose coefficients the data decide
    beside: tuple[Effect, ...] = ()


@dataclass(frozen=True, eq=False)
class Contest:
    """Pairs of rival causes of one arm, to be separated by a further motion."""

    robot: Robot  # as given, its values correct within their tolerance
    model: Robot  # of the diagnosis; causes that depend on torque take that of this model
    pairs: tuple[Pair, ...]
    weight: Array  # Λ: 1 / (variance × autocorrelation time) of each joint's noise, shape (nv,)
    cutoff_hz: float = 10.0  # of the filter that torque and columns pass
    recorded: tuple[Segment, ...] = ()  # the recording, which both causes explain
    # relative standard deviations of the given bodies and of the given effects
    tolerance: tuple[float, float] = (EVIDENCE.tolerance, EVIDENCE.tolerance)

    @cached_property
    def causes(self) -> dict[Effect, slice]:
        """Columns of all causes in all their shapes, after those of the given values."""
        start = len(self.precision)
        columns: dict[Effect, slice] = {}
        for pair in self.pairs:
            for effect in (
                *self._shapes(pair.found),
                *self._shapes(pair.rival),
                *(effect.without_values() for effect in pair.beside),
            ):
                if effect not in columns:
                    size = len(effect.parameters(self.robot))
                    columns[effect] = slice(start, start + size)
                    start += size
        return columns

    @cached_property
    def precision(self) -> Array:
        """Prior precision of the given values, shape (p,)."""
        count = sum(len(e.values or ()) for e in self.robot.effects)
        tolerance = self.tolerance[0] * widened(self.robot)
        links = link_weights(self.robot.nv, tolerance) ** 2
        return np.concatenate([links, np.ones(count)])

    @cached_property
    def known(self) -> Array:
        """Information of the recording, shape (columns, columns)."""
        if not self.recorded:
            size = max(at.stop for at in self.causes.values())
            return np.zeros((size, size))
        return self._gram(self.recorded)

    @cached_property
    def unmoved(self) -> list[Separation]:
        """Separation of every pair by the recording alone."""
        return self.separations(np.zeros_like(self.known))

    @cached_property
    def imitations(self) -> tuple[Array, ...]:
        """Coefficients with which each rival best imitates the cause found in the recording."""
        R, floor = _without_given(self.known, self.precision)
        coefficients = []
        for pair in self.pairs:
            at = self._indices(pair.found)
            beside = self._beside(pair)
            b = R[:, at] @ np.array(pair.found.values)
            both = [*beside, *self._indices(pair.rival)]
            coefficients.append(_explaining(R, floor, both, b)[len(beside) :])
        return tuple(coefficients)

    @cached_property
    def _facts(self) -> Sequence[JointFacts]:
        if not self.recorded:
            return (JointFacts(),) * self.robot.nv
        return joint_facts([segment.motion for segment in self.recorded])

    @cached_property
    def _metric(self) -> Array:
        return link_coordinates(prior_parameters(self.robot))

    @property
    def rows_hz(self) -> float:
        """Rows per second, of a further motion as of the recording [Hz]."""
        if not self.recorded:
            return ROWS_PER_PERIOD * self.cutoff_hz
        t = self.recorded[0].t
        return 1 / (t[1] - t[0])

    def instants(self, period: float) -> Array:
        """When a motion is judged [s]: evenly, first and last included."""
        return np.linspace(
            0.0, period, round(period * SAMPLES_PER_ROW * self.rows_hz) + 1
        )

    def information(self, motion: Motion) -> Array:
        """Information of a motion, shape (columns, columns)."""
        return self._gram((along(motion, self.cutoff_hz, self.rows_hz),))

    def separations(self, information: Array) -> list[Separation]:
        """Separation of every pair by the recording and a motion of this information."""
        R, floor = _without_given(self.known + information, self.precision)
        separations = []
        for pair, imitation in zip(self.pairs, self.imitations, strict=True):
            beside = self._beside(pair)
            ways = [(pair.found, np.array(pair.found.values), pair.rival)]
            if imitation.any():
                ways.append((pair.rival, imitation, pair.found))
                ways = [w for w in ways if w[0].name not in w[2].search.contains]
            both_ways = [self._apart(R, floor, beside, *way) for way in ways]
            separations.append(min(both_ways, key=lambda s: s.delta))
        return separations

    def counted(self, information: Array) -> list[Separation]:
        """Separation of every pair, with its number of runs by repeated evaluation."""
        # the prior cost of wrong given values does not grow with the number of runs
        once = self.separations(information)
        runs: list[int | None] = [None] * len(once)
        for n in range(DISCRIMINATION.most_runs, 0, -1):
            for k, several in enumerate(self.separations(n * information)):
                if several.enough:
                    runs[k] = n
        return [replace(s, repetitions=n) for s, n in zip(once, runs, strict=True)]

    def _apart(
        self,
        R: Array,
        floor: Array,
        beside: list[int],
        true: Effect,
        value: Array,
        other: Effect,
    ) -> Separation:
        at = self._indices(true)
        b = R[:, at] @ value
        power = float(value @ b[at])

        def unexplained(columns: list[int]) -> float:
            return power - float(b[columns] @ _explaining(R, floor, columns, b))

        whole = unexplained(beside) if beside else power
        imitations = (
            unexplained([*beside, *self._indices(shape)])
            for shape in self._shapes(other)
        )
        remaining = float(np.clip(min(whole, *imitations), 0.0, max(whole, 0.0)))
        return Separation(remaining, whole)

    def _shapes(self, effect: Effect) -> list[Effect]:
        joint = self.robot.joint_index(effect.joints[0])
        return alternatives(effect, self._facts[joint])

    def _indices(self, effect: Effect) -> list[int]:
        at = self.causes[effect.without_values()]
        skip = len(self.precision)
        return list(range(at.start - skip, at.stop - skip))

    def _beside(self, pair: Pair) -> list[int]:
        return [
            column for effect in pair.beside for column in self._indices(effect)
        ]

    def _gram(self, segments: Sequence[Segment]) -> Array:
        """Weighted products of all columns at the rows of segments, those at rest left out."""
        # a joint rests while it is slow relative to its recorded motion
        parts = list(self._parts(segments))
        names = [str(k) for k in range(sum(part.values.shape[2] for part in parts))]
        counts = away_from_rest(
            segments, top_speed(self.recorded) if self.recorded else 0.0
        )
        problem = dense(parts, np.zeros(counts.shape), names, counts)
        return problem.gram(self.weight)[:-1, :-1]

    def _parts(self, segments: Sequence[Segment]) -> Iterator[ActingColumns]:
        links = np.concatenate([self._links(s) for s in segments])
        extended = Observed(self.model, tuple(segments), links)
        nominal = extended.by(self.robot)
        yield ActingColumns.of(links) @ self._metric
        for effect in self.robot.effects:
            size = np.maximum(np.abs(effect.values or ()), 1e-9)
            yield cause_columns(effect, nominal, extended) @ np.diag(
                self.tolerance[1] * size
            )
        for effect in self.causes:
            yield cause_columns(effect, nominal, extended)

    def _links(self, segment: Segment) -> Array:
        """Regressor at the rows, unfiltered for a motion yet to be run, which is smooth."""
        if segment in self.recorded:
            return segment.rows(lambda m: regressor(self.robot, m))
        return regressor(self.robot, segment.motion[segment.keep])


def along(
    motion: Motion, cutoff_hz: float, rows_hz: float | None = None
) -> Segment:
    """Segment of an equidistant motion, at four of the cut-off by default."""
    step = motion.t[1] - motion.t[0]
    still = np.zeros_like(motion.q)
    edge = round(1 / (cutoff_hz * step))
    stride = max(1, round(1 / ((rows_hz or ROWS_PER_PERIOD * cutoff_hz) * step)))
    keep = slice(edge, len(motion) - edge, stride)
    return Segment("motion", motion, still, still, cutoff_hz, keep)


def needed(level: float = DISCRIMINATION.level) -> float:
    """Δ at which one run separates two causes at this level of significance.

    The difference of the squared errors that they leave in N runs (Vuong 1989) has mean N Δ and
    standard deviation 2 √(N Δ), so N Δ = 4 (z_{level/2} + z_{1−power})².
    """
    z = scipy.special.ndtri([1 - level / 2, DISCRIMINATION.power]).sum()
    return float(4 * z**2)


def _without_given(information: Array, precision: Array) -> tuple[Array, Array]:
    """Information on causes with the given values eliminated, and its rounding error."""
    p = len(precision)
    A = information[:p, :p] + np.diag(precision)
    half = scipy.linalg.solve_triangular(
        np.linalg.cholesky(A), information[:p, p:], lower=True
    )
    floor = 1e-10 * np.maximum(np.diag(information)[p:], 1e-12)
    return information[p:, p:] - half.T @ half, floor


def _explaining(R: Array, floor: Array, columns: Sequence[int], b: Array) -> Array:
    """Coefficients of columns that best explain a torque of inner products b with all columns."""
    at = list(columns)
    scale = np.sqrt(np.maximum(np.diag(R)[at], floor[at]))
    A = R[np.ix_(at, at)] / np.outer(scale, scale) + FREE * np.eye(len(at))
    return np.linalg.lstsq(A, b[at] / scale, rcond=1e-11)[0] / scale
