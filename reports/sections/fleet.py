"""Section on a fleet: which arms differ, what changes with time, what was not examined."""

from __future__ import annotations

import numpy as np

from excitant.reports import figure as fig
from excitant.reports import page as p
from excitant.reports import values as v
from excitant.reports.figure import Axes, Axis, Figure, Key, Line, Panel, Points
from excitant.reports.values import Result, Series

_DRAWN = 6  # changes that are drawn
_MONTHS = 12.0


def fleet_section(result: Result, series: Series) -> p.Section:
    """Arms beside their siblings and over time."""
    sets, odd, drifts = (
        v.records(result, key) for key in ("data_sets", "deviations", "drifts")
    )
    failed = [each for each in sets if v.text(each, "failed")]
    arms = len({v.text(each, "arm") for each in odd})
    changing = len({v.text(each, "arm") for each in drifts})
    said = f"{v.whole(v.at(result, 'arms'))} arms, {len(sets)} data sets: "
    said += _counted(arms, "differs from its siblings", "differ from their siblings")
    said += f", {_counted(changing, 'changes', 'change')} with time"
    if failed:
        said += f"; {_counted(len(failed), 'data set has', 'data sets have')} no model"
    return p.section(
        "Fleet",
        f"{said}.",
        [
            ("Key figures", [_facts(result, arms, changing, len(failed))]),
            (
                "Arms that differ",
                [p.notes([_differs(row) for row in odd], brief="differs"), _odd(odd)],
            ),
            (
                "What changes with time",
                [
                    p.notes([_changes(row) for row in drifts], brief="changes"),
                    _figure(drifts, series),
                    _drifts(drifts),
                ],
            ),
            ("Without a model", [_failed(failed)]),
            ("Data sets", [_sets(sets)]),
            ("Notes", [p.notes(v.words(result, "notes"), brief="note")]),
        ],
        (("fleet", f"{said}."),),
    )


def _counted(n: int, one: str, many: str) -> str:
    return f"{n or 'none'} {one if n < 2 else many}"


def _facts(result: Result, odd: int, changing: int, failed: int) -> p.Facts | None:
    tones = [p.POOR if count else p.GOOD for count in (odd, changing, failed)]
    return p.facts(
        p.fact(
            "Arms", v.at(result, "arms"), v.whole, v.listing(v.words(result, "types"))
        ),
        p.fact("Differ from their siblings", odd, v.whole, "", tones[0]),
        p.fact("Change with time", changing, v.whole, "", tones[1]),
        p.fact("Data sets without a model", failed, v.whole, "", tones[2]),
    )


def _differs(row: Result) -> str:
    more = "less" if (v.real(row, "difference") or 0.0) < 0 else "more"
    value, apart, others = (
        " ± ".join(v.value_and_std(*(v.at(row, key) for key in keys)))
        for keys in (
            ("value", "std"),
            ("difference", "difference_std"),
            ("siblings", "spread"),
        )
    )
    name = v.text(row, "parameter")
    unit = v.text(row, "unit")
    return (
        f"{v.text(row, 'arm')}: {name} is {value} {unit}, {apart.lstrip('−-')} {more} than that of "
        f"its {v.whole(v.at(row, 'count'))} siblings ({others})"
    )


def _monthly(row: Result) -> tuple[float, float]:
    """Slope a month, and its standard deviation."""
    per_year, std = (v.real(row, key) or 0.0 for key in ("per_year", "std"))
    return per_year / _MONTHS, std / _MONTHS


def _changes(row: Result) -> str:
    slope, std = _monthly(row)
    way = "falls" if slope < 0 else "rises"
    size = " ± ".join(v.value_and_std(abs(slope), std))
    ends = (v.number(v.at(row, key)) for key in ("before", "after"))
    before, after = (
        f"{x} on {v.text(row, key)}"
        for x, key in zip(ends, ("first", "last"), strict=True)
    )
    return (
        f"{v.text(row, 'arm')}: {v.text(row, 'parameter')} {way} by {size} {v.text(row, 'unit')} a "
        f"month, from {before} to {after}"
    )


def _odd(odd: list[Result]) -> p.Table | None:
    def siblings(row: Result) -> str:
        mean, spread = v.value_and_std(v.at(row, "siblings"), v.at(row, "spread"))
        return f"{mean} ± {spread} ({v.whole(v.at(row, 'count'))} arms)"

    return p.table(
        odd,
        [
            ("name:Arm", "arm"),
            ("expression:Parameter", "parameter"),
            ("number:It has", lambda r: _pair(r, "value", "std")),
            ("number:Its siblings", siblings),
            ("number:Difference", lambda r: _pair(r, "difference", "difference_std")),
            ("name:Unit", "unit"),
        ],
        "The most certain first. Of the siblings: mean and standard deviation from arm to arm. A "
        "fleet of sound arms has any entry here or below in at most 5 % of cases.",
    )


def _pair(row: Result, value: str, std: str) -> p.Cell:
    pair = v.at(row, value), v.at(row, std)
    return p.Cell(" ± ".join(v.value_and_std(*pair)), p.PLAIN, v.real(pair[0]))


def _drifts(drifts: list[Result]) -> p.Table | None:
    def slope(row: Result) -> p.Cell:
        pair = _monthly(row)
        return p.Cell(" ± ".join(v.value_and_std(*pair)), p.PLAIN, pair[0])

    return p.table(
        drifts,
        [
            ("name:Arm", "arm"),
            ("expression:Parameter", "parameter"),
            ("number:A month", slope),
            ("name:Unit", "unit"),
            ("number:From", lambda r: v.number(v.at(r, "before"))),
            ("name:On", "first"),
            ("number:To", lambda r: v.number(v.at(r, "after"))),
            ("name:By", "last"),
            ("number:Data sets", "count", v.whole),
        ],
        "Slope of a line through all dates, and its ends.",
    )


def _figure(drifts: list[Result], series: Series) -> Figure | None:
    panels = [_panel(k, row, series) for k, row in enumerate(drifts[:_DRAWN])]
    return fig.figure(
        panels,
        "Parameters that change, each data set with its standard deviation.",
        (
            Key("dot", fig.MEASURED, "data set"),
            Key("line", fig.FITTED, "line through all"),
        ),
    )


def _panel(k: int, row: Result, series: Series) -> Panel | None:
    before = v.real(row, "before")
    after = v.real(row, "after")
    days = v.array(series, f"drift{k}/days", None)
    if days is None or before is None or after is None:
        return None
    x, std = (v.array(series, f"drift{k}/{key}", len(days)) for key in ("value", "std"))
    if x is None or std is None:
        return None
    ends = np.array([np.nanmin(days), np.nanmax(days)])
    apart = np.full(len(days), np.nan)
    bars = np.column_stack([x - std, x + std, apart]).ravel()
    marks = (
        Line(np.repeat(days, 3), bars, fig.MEASURED, width=1.0),
        Points(days, x, fig.MEASURED, "data set"),
        Line(ends, np.array([before, after]), fig.FITTED, "line through all"),
    )
    ticks = np.linspace(ends[0], ends[1], 3).tolist()
    dates = [(day, str(np.datetime64(0, "D") + round(day))) for day in ticks]
    axes = Axes(
        marks,
        Axis(ticks=tuple(dates)),
        Axis(f"value [{v.text(row, 'unit')}]"),
        150,
    )
    arm = v.text(row, "arm")
    name = v.text(row, "parameter")
    return Panel((axes,), f"{name} of {arm} over time", f"{arm}: {name}")


def _failed(failed: list[Result]) -> p.Table | None:
    return p.table(
        failed,
        [("name:Data set", "name"), ("text:Why", "failed")],
        "Mend these and run the command again: only they are examined anew.",
        brief="no model" if len(failed) <= p.LONG else None,
    )


def _sets(sets: list[Result]) -> p.Table | None:
    return p.table(
        [each for each in sets if not v.text(each, "failed")],
        [
            ("name:Data set", "name"),
            ("name:Arm", "arm"),
            ("name:Date", "date"),
            (
                "text:Diagnosis",
                lambda r: " ".join(v.words(r, "found")) or "nothing stands out",
            ),
        ],
        "What diagnose says of each; its pages are in the folder arms.",
        p.folded("What the diagnosis says of each", len(sets)),
    )
