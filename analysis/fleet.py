"""Arms of one type beside each other, and each arm over time.

A base parameter, identified from data set d of arm a at time t with a standard deviation s, is

    x_ad = μ + δ_a + β_a (t_ad − t̄_a) + ε_ad,   ε ~ N(0, s_ad² + ω²),   δ ~ N(0, τ²).

ω is what data sets of one arm differ by beyond s, the same for all arms of a type; τ is by how much
sound arms differ. Both are such that what is left has the size expected of it (Paule, Mandel 1982),
ω from lines through the dates of each arm, τ from the means of the arms.

An arm *differs* where δ_a is an extreme Studentised deviate of its type (the generalised test of
Rosner 1983, which up to a quarter of odd arms do not hide from each other). Few arms do not say by
how much sound ones differ, so that none of them is odd unless far from the others: where equal arms
would not have such values, those furthest apart are told, with their *difference*. An arm *changes*
where β_a is not 0 by Student's t. Chances are those of the whole fleet (Bonferroni): where all arms
are sound and steady, any of them is called odd or changing in at most 5 % of fleets.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from datetime import date
from functools import cached_property
from typing import Any, NamedTuple

import msgspec
import numpy as np
import scipy

from excitant.results import Deviation, Difference, Drift
from excitant.robots.motion import Array, Indices, Mask

CHANCE = 0.05  # of a false alarm in a fleet
FEWEST_ARMS = 4  # of which one can be told from the others
FEWEST_DATES = 3  # or a line drawn
_ODD = 4  # of so many arms one may be odd
_TINY = 1e-9  # of a parameter's size: a standard deviation is no less
YEAR = 365.25  # days


class Value(NamedTuple):
    """An estimate, its standard deviation and its unit."""

    value: float
    std: float
    unit: str


@dataclass(frozen=True)
class Examined:
    """What one data set came to.

    Attributes:
        name: Of the data set.
        arm: Which arm it is of.
        day: When it was recorded; None where nobody says.
        kind: Type of the arm; only arms of one type are compared.
        failed: Why there is no model, as one line; empty where there is one.
        values: Base parameters by name.
        found: What the diagnosis says, and faults of the data, as short lines.
    """

    name: str
    arm: str
    day: date | None = None
    kind: str = ""
    failed: str = ""
    values: Mapping[str, Value] = field(default_factory=dict)
    found: tuple[str, ...] = ()


@dataclass(frozen=True)
class Fleet:
    """Data sets of many arms, the arms that differ, and what changes."""

    examined: tuple[Examined, ...]
    deviations: tuple[Deviation, ...]
    differences: tuple[Difference, ...]
    drifts: tuple[Drift, ...]
    remarks: tuple[str, ...] = ()

    def result(self) -> dict[str, Any]:
        """Entries of ``result.json``."""
        done = [data_set for data_set in self.examined if not data_set.failed]
        return {
            "verb": "fleet",
            "of": f"{len(self.examined)} data sets",
            "arms": len({(e.kind, e.arm) for e in done}),
            "types": sorted({e.kind for e in done}),
            "data_sets": [_entry(data_set) for data_set in self.examined],
            "deviations": msgspec.to_builtins(self.deviations),
            "differences": msgspec.to_builtins(self.differences),
            "drifts": msgspec.to_builtins(self.drifts),
            "notes": [*self.remarks, *_notes(done)],
        }

    def series(self) -> dict[str, Array]:
        """Dates [days since 1970], values and standard deviations behind each drift."""
        arrays: dict[str, Array] = {}
        for k, drift in enumerate(self.drifts):
            rows = [
                (_days(e.day), *e.values[drift.parameter][:2])
                for e in self.examined
                if e.arm == drift.arm and e.day and drift.parameter in e.values
            ]
            columns = np.array(sorted(rows)).T
            for name, column in zip(("days", "value", "std"), columns, strict=True):
                arrays[f"drift{k}/{name}"] = column
        return arrays


def _entry(data_set: Examined) -> dict[str, Any]:
    return {
        "name": data_set.name,
        "arm": data_set.arm,
        "date": str(data_set.day) if data_set.day else None,
        "type": data_set.kind or None,
        "failed": data_set.failed or None,
        "found": list(data_set.found),
    }


def _notes(done: Sequence[Examined]) -> Iterator[str]:
    for kind in sorted({data_set.kind for data_set in done}):
        own = [data_set for data_set in done if data_set.kind == kind]
        arms = {data_set.arm for data_set in own}
        if len(arms) < FEWEST_ARMS:
            yield (
                f"{kind}: {len(arms)} arm{'s' * (len(arms) > 1)}; from {FEWEST_ARMS} of a type on "
                "one can be told from the others"
            )
        dates = max(
            sum(e.arm == arm and e.day is not None for e in own) for arm in arms
        )
        if dates < FEWEST_DATES:
            yield (
                f"{kind}: at most {dates} dated data sets of an arm; from {FEWEST_DATES} on it is "
                'seen what changes (put "date": "2026-03-01" into dataset.json, or a date into '
                "the folder's name)"
            )


def compare_arms(examined: Sequence[Examined]) -> Fleet:
    """The arms of a fleet beside each other and over time."""
    groups = list(_groups([data_set for data_set in examined if data_set.values]))
    chance = CHANCE / 3
    lines = sum(len(group.lines) for group in groups)
    drifts = list[Drift]()
    compared = list[_Group]()
    for group in groups:
        own = [d for d in group.drifts(lines) if d.chance <= chance]
        steady = group.without({d.arm for d in own})
        drifts += own
        compared += [steady] * (len(steady.arms) > 1)
    drifts.sort(key=lambda d: d.chance)
    deviations = list[Deviation]()
    differences = list[Difference]()
    for group in compared:
        odd = [*group.deviations(chance / len(compared))]
        deviations += odd
        if not odd:
            differences.append(group.difference(len(compared)))
    deviations.sort(key=lambda d: -d.ratio)
    differences.sort(key=lambda d: (d.chance, -d.difference / d.std))
    apart = tuple(d for d in differences if d.chance <= chance)
    return Fleet(tuple(examined), tuple(deviations), apart, tuple(drifts))


class _Fit(NamedTuple):
    """A line over time through the data sets of each arm, or their mean; shapes (arms,)."""

    mean: Array
    variance: Array  # of the mean
    middle: Array  # date that it belongs to [days]
    slope: Array  # per year; 0 without a line
    slope_variance: Array  # infinite without a line
    squares: float  # weighted, of what is left


@dataclass(frozen=True, eq=False)
class _Group:
    """One parameter of all arms of a type; data sets in the order of time within an arm."""

    name: str
    unit: str
    arms: tuple[str, ...]
    arm: Indices  # of each data set
    days: Array  # since 1970, nan where unknown
    x: Array
    variance: Array  # s²

    @cached_property
    def dated(self) -> Mask:
        """Data sets through which a line is drawn."""
        known = np.isfinite(self.days)
        pairs = np.unique(
            np.column_stack([self.arm[known], self.days[known]]), axis=0
        )
        dates = np.bincount(pairs[:, 0].astype(np.intp), minlength=len(self.arms))
        return known & (dates >= FEWEST_DATES)[self.arm]

    @cached_property
    def lines(self) -> Indices:
        """Arms with a line."""
        return np.unique(self.arm[self.dated])

    @cached_property
    def used(self) -> Mask:
        """Data sets that count: beside a line, those without a date do not."""
        return self.dated | ~np.isin(self.arm, self.lines)

    def without(self, arms: Set[str]) -> _Group:
        """The group without some arms."""
        names = tuple(arm for arm in self.arms if arm not in arms)
        places = [names.index(arm) if arm in names else -1 for arm in self.arms]
        place = np.array(places)[self.arm]
        rows = place >= 0
        return replace(
            self,
            arms=names,
            arm=place[rows],
            days=self.days[rows],
            x=self.x[rows],
            variance=self.variance[rows],
        )

    def fit(self, more: float) -> _Fit:
        """Lines and means, where data sets vary by so much more than their variance says."""
        w = self.used / (self.variance + more)
        days = np.where(self.dated, self.days, 0.0)

        def per_arm(values: Array) -> Array:
            return np.asarray(
                np.bincount(self.arm, w * values, len(self.arms)), float
            )

        weight = per_arm(np.ones(len(w)))
        mean = per_arm(self.x) / weight
        middle = per_arm(days) / weight
        t = np.where(self.dated, days - middle[self.arm], 0.0) / YEAR
        apart = self.x - mean[self.arm]
        spread = per_arm(t**2)
        safe = np.where(spread > 0, spread, 1.0)
        slope = per_arm(t * apart) / safe
        left = float(w @ (apart - slope[self.arm] * t) ** 2)
        of_slope = np.where(spread > 0, 1 / safe, np.inf)
        return _Fit(mean, 1 / weight, middle, slope, of_slope, left)

    @cached_property
    def within(self) -> tuple[float, int]:
        """ω², and the degrees of freedom that it is estimated with."""
        freedom = int(self.used.sum()) - len(self.arms) - len(self.lines)
        return _excess(
            lambda more: self.fit(more).squares, freedom
        ) if freedom else 0.0, freedom

    def drifts(self, tested: int) -> Iterator[Drift]:
        """Lines of all arms, with the chance among so many that were tested."""
        more, freedom = self.within
        lines = self.lines
        fit = self.fit(more)
        t = np.abs(fit.slope) / np.sqrt(fit.slope_variance)
        chance = np.minimum(1.0, 2 * tested * scipy.special.stdtr(freedom, -t))
        for k in lines:
            days = self.days[(self.arm == k) & self.dated]
            ends = np.array([days.min(), days.max()])
            before, after = (
                fit.mean[k] + fit.slope[k] * (ends - fit.middle[k]) / YEAR
            )
            first, last = (date.fromordinal(_EPOCH + round(end)) for end in ends)
            yield Drift(
                self.arms[k], self.name, self.unit, float(fit.slope[k]),
                float(np.sqrt(fit.slope_variance[k])), first, last, float(before), float(after),
                len(days), float(chance[k]),
            )  # fmt: skip

    def deviations(self, chance: float) -> Iterator[Deviation]:
        """Arms that differ, at a chance that any does where none is odd."""
        if len(self.arms) < FEWEST_ARMS:
            return
        fit = self.fit(self.within[0])
        mean = fit.mean
        variance = fit.variance
        odd = odd_ones(mean, variance, chance)
        rest = np.setdiff1d(np.arange(len(mean)), [k for k, _ in odd])
        between = _between(mean[rest], variance[rest])
        siblings, of_mean, _ = _about_mean(mean[rest], variance[rest] + between)
        for k, ratio in odd:
            yield Deviation(
                self.arms[k], self.name, self.unit, float(mean[k]), float(np.sqrt(variance[k])),
                siblings, float(np.sqrt(between)), float(mean[k] - siblings),
                float(np.sqrt(variance[k] + of_mean)), len(rest), ratio,
            )  # fmt: skip

    def difference(self, tested: int) -> Difference:
        """The arms that are furthest apart, with the chance among so many groups of equal arms."""
        more, freedom = self.within
        fit = self.fit(more)
        middle, _, squares = _about_mean(fit.mean, fit.variance)
        others = len(self.arms) - 1
        # by how much data sets of one arm differ is itself estimated, or not known at all
        chance = 1.0
        if freedom:
            chance = float(scipy.special.fdtrc(others, freedom, squares / others))
        apart = (fit.mean - middle) / np.sqrt(fit.variance)
        low = np.argmin(apart)
        high = np.argmax(apart)
        least, most = float(fit.mean[low]), float(fit.mean[high])
        std = float(np.sqrt(fit.variance[low] + fit.variance[high]))
        return Difference(
            self.name, self.unit, self.arms[low], least, self.arms[high], most, most - least, std,
            others + 1, min(1.0, tested * chance),
        )  # fmt: skip


def odd_ones(x: Array, variance: Array, chance: float) -> list[tuple[int, float]]:
    """Values that are none of their kind, with how far they are beyond what chance allows.

    Generalised extreme Studentised deviates (Rosner 1983) of values that have variances of their
    own: each is compared with the mean of those that are nearer, whose spread is estimated without
    it (where variances are alike, that is Rosner's test). Any is found by a chance where none is
    odd. At most every fourth can be.
    """
    kept = np.arange(len(x))
    removed = list[tuple[int, float]]()
    count = 0
    for _ in range(len(x) // _ODD):
        between = _between(x[kept], variance[kept])
        mean, _, _ = _about_mean(x[kept], variance[kept] + between)
        far = np.abs(x[kept] - mean) / np.sqrt(variance[kept] + between)
        k = int(kept[np.argmax(far)])
        n = len(kept)
        kept = kept[kept != k]
        # errors of the arms are known, their spread is not: both are in this, and Student's t
        between = _between(x[kept], variance[kept])
        mean, of_mean, _ = _about_mean(x[kept], variance[kept] + between)
        deviate = abs(x[k] - mean) / np.sqrt(variance[k] + between + of_mean)
        allowed = scipy.special.stdtrit(n - 2, 1 - chance / (2 * n))
        removed.append((k, float(deviate / allowed)))
        if deviate > allowed:
            count = len(removed)
    return removed[:count]


def _about_mean(x: Array, variance: Array) -> tuple[float, float, float]:
    """Weighted mean, its variance, and the weighted squares about it."""
    w = 1 / variance
    mean = float(w @ x / w.sum())
    return mean, float(1 / w.sum()), float(w @ (x - mean) ** 2)


def _between(x: Array, variance: Array) -> float:
    """τ² with which values differ as much as their variances say."""
    return _excess(lambda more: _about_mean(x, variance + more)[2], len(x) - 1)


def _excess(left: Callable[[float], float], freedom: int) -> float:
    """Variance to add, so that the weighted squares are as many as their degrees of freedom."""
    if left(0.0) <= freedom:
        return 0.0
    high = 1e-30
    while left(high) > freedom:
        high *= 10.0
    return float(
        scipy.optimize.brentq(
            lambda more: left(more) - freedom, 0.0, high, rtol=1e-6
        )
    )


_EPOCH = date(1970, 1, 1).toordinal()


def _days(day: date | None) -> float:
    return np.nan if day is None else float(day.toordinal() - _EPOCH)


def _groups(examined: Sequence[Examined]) -> Iterator[_Group]:
    for kind in sorted({data_set.kind for data_set in examined}):
        own = sorted(
            (data_set for data_set in examined if data_set.kind == kind),
            key=lambda data_set: (
                data_set.arm,
                data_set.day or date.max,
                data_set.name,
            ),
        )
        for name in dict.fromkeys(
            name for data_set in own for name in data_set.values
        ):
            having = [
                (data_set, data_set.values[name])
                for data_set in own
                if name in data_set.values
            ]
            arms = tuple(dict.fromkeys(data_set.arm for data_set, _ in having))
            x, std = np.array([value[:2] for _, value in having], float).T
            yield _Group(
                name,
                having[0][1].unit,
                arms,
                np.array([arms.index(data_set.arm) for data_set, _ in having]),
                np.array([_days(data_set.day) for data_set, _ in having]),
                x,
                np.maximum(std, _TINY * np.abs(x).max() + 1e-300) ** 2,
            )
