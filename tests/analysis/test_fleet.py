"""Arms beside their siblings and over time: planted ones are found, sound fleets are left alone."""

from collections.abc import Sequence
from dataclasses import replace
from datetime import date, timedelta

import numpy as np
import pytest
import scipy
from marks import slow

from excitant.analysis.fleet import CHANCE, Examined, Fleet, Value, compare_arms, odd_ones

START = date(2026, 1, 1)


def fleet(
    rng: np.random.Generator, arms: int = 12, dates: int = 4, parameters: int = 6,
    odd: Sequence[tuple[int, int, float]] = (), rising: Sequence[tuple[int, int, float]] = (),
) -> list[Examined]:  # fmt: skip
    """Data sets of sound arms, but (arm, parameter, by how much, or by how much a year)."""
    mean = 1 + 0.1 * rng.standard_normal((arms, parameters))
    for arm, k, size in odd:
        mean[arm, k] += size
    found = []
    for arm in range(arms):
        for d in range(dates):
            day = START + timedelta(days=90 * d + int(rng.integers(20)))
            std = 0.05 * rng.uniform(0.5, 2.0, parameters)
            x = mean[arm] + np.hypot(0.05, std) * rng.standard_normal(parameters)
            for one, k, slope in rising:
                x[k] += slope * (one == arm) * (day - START).days / 365.25
            values = {f"p{k}": Value(float(x[k]), float(std[k]), "N·m") for k in range(parameters)}
            found.append(Examined(f"{arm}/{day}", f"arm{arm}", day, "kind", values=values))
    return found


def said(found: Fleet) -> set[tuple[str, str]]:
    return {(each.arm, each.parameter) for each in (*found.deviations, *found.drifts)}


@pytest.mark.slow
def test_a_sound_fleet_is_rarely_accused() -> None:
    rng, draws = np.random.default_rng(0), 150
    accused = 0
    for _ in range(draws):
        arms, dates = int(rng.integers(4, 25)), int(rng.integers(1, 6))
        accused += bool(said(compare_arms(fleet(rng, arms, dates, 3))))
    assert accused <= scipy.stats.binom.ppf(0.99, draws, CHANCE)


@pytest.mark.parametrize("dates", [slow(1), 4])
def test_arms_that_differ_are_found_with_honest_intervals(dates: int) -> None:
    rng, off, spread = np.random.default_rng(1), [], []
    for _ in range(20):
        found = compare_arms(fleet(rng, 16, dates, odd=[(3, 2, 1.8), (5, 2, 2.0), (9, 4, -1.8)]))
        assert {("arm3", "p2"), ("arm5", "p2"), ("arm9", "p4")} <= said(found)
        first = next(d for d in found.deviations if (d.arm, d.parameter) == ("arm3", "p2"))
        assert first.count == 14
        spread.append(first.spread)
        off.append((first.difference - 1.8) / np.hypot(first.difference_std, first.spread))
    assert np.mean(spread) == pytest.approx(0.1 if dates > 1 else np.hypot(0.1, 0.05), abs=0.02)
    assert np.abs(np.mean(off)) < 3 / np.sqrt(20)
    assert 0.5 < np.std(off) < 1.5


def test_what_changes_is_found_with_its_slope() -> None:
    rng, off = np.random.default_rng(2), []
    for _ in range(20):
        found = compare_arms(fleet(rng, 8, 6, rising=[(6, 1, 1.5)]))
        [drift] = [d for d in found.drifts if (d.arm, d.parameter) == ("arm6", "p1")]
        assert ("arm6", "p1") not in {(d.arm, d.parameter) for d in found.deviations}
        assert START <= drift.first < START + timedelta(days=20)
        rise = drift.per_year * (drift.last - drift.first).days / 365.25
        assert drift.after - drift.before == pytest.approx(rise)
        off.append((drift.per_year - 1.5) / drift.std)
        steps = np.diff(found.series()["drift0/days"])
        assert (len(steps), steps.min() > 0) == (5, True)
    assert np.abs(np.mean(off)) < 3 / np.sqrt(20)
    assert 0.5 < np.std(off) < 1.5


def test_odd_values_as_in_rosners_example() -> None:
    """Table 2 of Rosner (1983): three outliers of 54 at 5 %, none of which hides the others."""
    low = "-.25 .68 .94 1.15 1.2 1.26 1.26 1.34 1.38 1.43 1.49 1.49 1.55 1.56 1.58 1.65 1.69 1.7"
    middle = "1.76 1.77 1.81 1.91 1.94 1.96 1.99 2.06 2.09 2.1 2.14 2.15 2.23 2.24 2.26 2.35 2.37"
    high = "2.4 2.47 2.54 2.62 2.64 2.9 2.92 2.92 2.93 3.21 3.26 3.3 3.59 3.68 4.3 4.64 5.34 5.42"
    x = np.array(f"{low} {middle} {high} 6.01".split(), float)
    found = odd_ones(x, np.full(len(x), 1e-12), 0.05)
    assert sorted(x[[k for k, _ in found]]) == [5.34, 5.42, 6.01]


def test_what_a_fleet_cannot_tell_is_said() -> None:
    rng = np.random.default_rng(3)
    few = compare_arms(fleet(rng, 3, 2, odd=[(1, 1, 50.0)]))
    assert not said(few)
    [apart] = [each for each in few.differences if each.parameter == "p1"]
    assert (apart.high, apart.difference) == ("arm1", pytest.approx(50, abs=4 * apart.std + 0.5))
    first, second = few.result()["notes"]
    assert "from 4 of a type on" in first
    assert "at most 2 dated data sets" in second
    broken = Examined("x", "x", failed="no model")
    found = compare_arms([*fleet(rng, 5, 3), broken]).result()
    assert (found["notes"], found["arms"]) == ([], 5)
    assert found["data_sets"][-1]["failed"] == "no model"


def test_types_are_not_compared_with_each_other() -> None:
    rng = np.random.default_rng(4)
    one = fleet(rng, 6, 1)
    other = []
    for e in fleet(rng, 4, 1):
        values = {k: x._replace(value=x.value + 10) for k, x in e.values.items()}
        other.append(replace(e, name=e.name + "b", arm=e.arm + "b", kind="other", values=values))
    assert not said(compare_arms([*one, *other]))
    found = compare_arms([*one, replace(other[0], kind="kind")])
    assert not found.drifts
    assert {arm for arm, _ in said(found)} == {"arm0b"}
