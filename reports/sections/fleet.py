"""Section on a fleet: which arms differ, what changes with time, what was not examined."""

import numpy as np

from excitant.reports import page as p
from excitant.reports import values as v
from excitant.reports.figure import (
    FITTED,
    MEASURED,
    Axes,
    Axis,
    Figure,
    Key,
    Line,
    Panel,
    Points,
    bars,
    figure,
)
from excitant.reports.values import Series
from excitant.results import DataSet, Deviation, Difference, Drift, Fleet

_DRAWN = 6  # changes that are drawn
_MONTHS = 12.0
_TOLD = 3  # differences that the terminal shows
_ODD = (
    "The most certain first. Of the siblings: mean and standard deviation from arm to arm. A "
    "fleet of sound arms has any entry here, or what changes, in at most 5 % of cases."
)


def fleet_section(result: Fleet, series: Series) -> p.Section:
    """Arms beside their siblings and over time."""
    sets = result.data_sets
    odd = result.deviations
    drifts = result.drifts
    failed = [row for row in sets if row.failed]
    arms = len({row.arm for row in odd})
    changing = len({row.arm for row in drifts})
    lead = (
        f"{_counted(result.arms, 'arm', 'arms')}, {_counted(len(sets), 'data set', 'data sets')}: "
        f"{_counted(arms, 'differs from its siblings', 'differ from their siblings')}, "
        f"{_counted(changing, 'changes', 'change')} with time"
    )
    if result.differences:
        count = len(result.differences)
        lead += (
            f"; {_counted(count, 'parameter is', 'parameters are')} not the same for all arms, "
            "which does not tell the odd one, if any"
        )
    if failed:
        lead += (
            f"; {_counted(len(failed), 'data set has', 'data sets have')} no model"
        )
    return p.section(
        "Fleet",
        f"{lead}.",
        [
            ("Key figures", [_facts(result, arms, changing, len(failed))]),
            (
                "Arms that differ",
                [
                    p.notes([_differs(row) for row in odd], brief="differs"),
                    p.notes([_ODD] * bool(odd)),
                ],
            ),
            (
                "What is not the same for all arms",
                [
                    p.notes(
                        [_apart(row) for row in result.differences[:_TOLD]],
                        brief="not the same",
                    ),
                    p.notes([_apart(row) for row in result.differences[_TOLD:]]),
                ],
            ),
            (
                "What changes with time",
                [
                    p.notes([_changes(row) for row in drifts], brief="changes"),
                    _figure(drifts, series),
                ],
            ),
            ("Without a model", [_failed(failed)]),
            ("Data sets", [_sets([row for row in sets if not row.failed])]),
            ("Notes", [p.notes(result.notes, brief="note")]),
        ],
        (("fleet", f"{lead}."),),
    )


def _counted(n: int, one: str, many: str) -> str:
    return f"{n or 'none'} {one if n < 2 else many}"


def _facts(result: Fleet, odd: int, changing: int, failed: int) -> p.Facts | None:
    tones = [p.POOR if count else p.GOOD for count in (odd, changing, failed)]
    return p.facts(
        p.fact("Arms", result.arms, v.whole, v.listing(result.types)),
        p.fact("Differ from their siblings", odd, v.whole, "", tones[0]),
        p.fact("Change with time", changing, v.whole, "", tones[1]),
        p.fact("Data sets without a model", failed, v.whole, "", tones[2]),
    )


def _differs(row: Deviation) -> str:
    more = "less" if row.difference < 0 else "more"
    value = v.interval(row.value, row.std)
    apart = v.interval(row.difference, row.difference_std)
    others = v.interval(row.siblings, row.spread)
    return (
        f"{row.arm}: {row.parameter} is {value} {row.unit}, {apart.lstrip('−-')} {more} than that "
        f"of its {row.count} siblings ({others})"
    )


def _apart(row: Difference) -> str:
    difference = v.interval(row.difference, row.std)
    return (
        f"{row.parameter} differs by {difference} {row.unit} between {row.low} "
        f"({v.number(row.low_value)}) and {row.high} ({v.number(row.high_value)})"
    )


def _changes(row: Drift) -> str:
    slope = row.per_year / _MONTHS
    std = row.std / _MONTHS
    way = "falls" if slope < 0 else "rises"
    return (
        f"{row.arm}: {row.parameter} {way} by {v.interval(abs(slope), std)} {row.unit} a "
        f"month, from {v.number(row.before)} on {row.first} to {v.number(row.after)} on {row.last}"
    )


def _figure(drifts: list[Drift], series: Series) -> Figure | None:
    panels = [_panel(k, row, series) for k, row in enumerate(drifts[:_DRAWN])]
    return figure(
        panels,
        "Parameters that change, each data set with its standard deviation.",
        (
            Key("dot", MEASURED, "data set"),
            Key("line", FITTED, "line through all"),
        ),
    )


def _panel(k: int, row: Drift, series: Series) -> Panel | None:
    days = v.array(series, f"drift{k}/days", None)
    if days is None:
        return None
    x, std = (
        v.array(series, f"drift{k}/{key}", len(days)) for key in ("value", "std")
    )
    if x is None or std is None:
        return None
    ends = np.array([np.nanmin(days), np.nanmax(days)])
    marks = (
        Line(np.repeat(days, 3), bars(x - std, x + std), MEASURED, width=1.0),
        Points(days, x, MEASURED, "data set"),
        Line(ends, v.reals([row.before, row.after]), FITTED, "line through all"),
    )
    ticks = np.linspace(ends[0], ends[1], 3).tolist()
    dates = [(day, str(np.datetime64(0, "D") + round(day))) for day in ticks]
    axes = Axes(
        marks,
        Axis(ticks=dates),
        Axis(f"value [{row.unit}]"),
        150,
    )
    arm = row.arm
    name = row.parameter
    return Panel((axes,), f"{name} of {arm} over time", f"{arm}: {name}")


def _failed(failed: list[DataSet]) -> p.Table | None:
    return p.table(
        failed,
        [("name:Data set", "name"), ("text:Why", "failed")],
        "Mend these and run the command again: only they are examined anew.",
        brief="no model" if len(failed) <= p.LONG else None,
    )


def _sets(sets: list[DataSet]) -> p.Table | None:
    return p.table(
        sets,
        [
            ("name:Data set", "name"),
            ("name:Arm", "arm"),
            ("name:Date", "date"),
            (
                "text:Diagnosis",
                lambda r: (
                    " ".join(map(v.sentence, r.found)) or "nothing stands out"
                ),
            ),
        ],
        "What diagnose says of each; its pages are in the folder arms.",
        long="What the diagnosis says of each",
    )
