"""Sections on two runs side by side."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from excitant.reports.comparison_figures import (
    error_figure,
    motion_figure,
    precision_figure,
    spectrum_figure,
    torque_figures,
)
from excitant.reports.comparison_tables import (
    agreement,
    category_block,
    error_table,
    estimate_blocks,
    fault_table,
    finding_table,
    finding_values,
    limit_table,
    model_table,
    precision_table,
    unmatched,
)
from excitant.reports.model import (
    FAIR,
    GOOD,
    PLAIN,
    POOR,
    Block,
    Cell,
    Notes,
    Section,
    Table,
    table,
)
from excitant.reports.model import section as section_of
from excitant.reports.reading import Result, Series, at, real, records, text, words
from excitant.reports.wording import NONE, number, plain

Parts = list[tuple[str, list[Block | None]]]
_TITLES = {
    "design": "Excitation designs",
    "check": "Trajectory checks",
    "identify": "Identifications",
    "analyze": "Identifiability",
    "diagnose": "Diagnoses",
    "robots": "Models",
}


def comparison_section(verb: str, result: Result, series: Series) -> Section:
    """Key figures of both runs, then what is particular to their command."""
    remarks = words(result, "remarks")
    return section_of(
        _TITLES[verb],
        comparison_lead(result),
        [
            ("Key figures", [Notes(tuple(remarks), FAIR) if remarks else None, _figures(result)]),
            *_PARTS[verb](result, series),
        ],
    )


def comparison_lead(result: Result) -> str:
    """Which run is better in what, or how much of two models differs, in one sentence."""
    if (compared := real(result, "models", "compared")) is not None:
        if not compared:
            return "The two models share no name of a joint or link: only whole figures compare."
        count = len(records(result, "models", "rows"))
        return f"{count} of {compared:.0f} values that both models give differ."
    if words(result, "remarks"):
        return "The two runs do not compare one to one; the remarks say why."
    rows = records(result, "key_figures")
    better = {s: [_advantage(r, s) for r in rows if text(r, "better") == s] for s in "ab"}
    said = [
        f"{side.upper()} is better in {' and '.join(better[side])}" for side in "ab" if better[side]
    ]
    return "; ".join(said) + "." if said else "Neither run is better in a key figure."


def _advantage(row: Result, side: str) -> str:
    """A key figure inside a sentence, with the value of the better run first."""
    label, unit = text(row, "figure"), text(row, "unit")
    own, other = (_value(at(row, s), unit) for s in (side, "b" if side == "a" else "a"))
    return f"{label[:1].lower()}{label[1:]} ({own} against {other})"


def run_table(result: Result) -> Table | None:
    """Which two runs are compared."""
    runs = records(result, "runs")[:2]
    elsewhere = any(text(run, "name") != text(run, "folder") for run in runs)
    rows: list[list[Cell | str]] = [
        [side, text(run, "name"), *([text(run, "folder")] if elsewhere else [])]
        for side, run in zip("AB", runs, strict=False)
    ]
    heads = "name:Run | name:Name" + (" | text:Folder" if elsewhere else "")
    return table(heads, rows) if rows else None


def _figures(result: Result) -> Table | None:
    rows: list[list[Cell | str]] = []
    for row in records(result, "key_figures"):
        values = [_value(at(row, side), text(row, "unit")) for side in "ab"]
        if values == [NONE, NONE]:
            continue
        better, difference = text(row, "better"), real(row, "difference")
        tone = {"b": GOOD, "a": POOR}.get(better, PLAIN)
        change = NONE if difference is None else _signed(difference, text(row, "unit"))
        change = "0" if difference is not None and values[0] == values[1] else change
        rows.append([text(row, "figure"), *values, Cell(change, tone)])
    if not rows:
        return None
    return table(
        "name:Figure | text:A | text:B | number:B − A",
        rows,
        ""
        if words(result, "remarks")
        else "● where B is the better by more than a hundredth, ○ where A is.",
    )


def _value(value: object, unit: str) -> str:
    x = real(value)
    if x is None:
        return plain(value) if isinstance(value, str) else NONE
    x, unit = _handy(x, unit)
    return _written(x, 4) + (f"\u00a0{unit}" if unit else "")


def _handy(value: float, unit: str) -> tuple[float, str]:
    """Distances in millimetres."""
    return (1e3 * value, "mm") if unit == "m" else (value, unit)


def _written(value: float, digits: int) -> str:
    """Whole numbers as such, others with so many digits."""
    whole = value == round(value) and abs(value) < 1e5
    return f"{value:.0f}".replace("-", "−") if whole else number(value, digits)


def _signed(value: float, unit: str) -> str:
    if value == 0:
        return "0"
    value, unit = _handy(value, unit)
    what = "points" if unit == "%" else unit
    return f"{'+' if value > 0 else ''}{_written(value, 3)}" + (f"\u00a0{what}" if what else "")


def _identify(result: Result, series: Series) -> Parts:
    return [
        (
            "Error per joint",
            [
                error_figure(result, "validate", "on the hold-out"),
                error_table(result, "baseline", "validate", "Given"),
            ],
        ),
        ("Torque on the hold-out", list(torque_figures(result, series, "identified"))),
        (
            "Base parameters that differ",
            estimate_blocks(result, "base_parameters", "base parameters"),
        ),
        ("Standard parameters that differ", estimate_blocks(result, "parameters", "parameters")),
    ]


def _diagnose(result: Result, series: Series) -> Parts:
    return [
        ("Findings", [finding_table(result), agreement(result), finding_values(result)]),
        ("Data faults", [fault_table(result)]),
        (
            "Error per joint",
            [
                error_figure(result, "extended", "on the hold-out, with the findings added"),
                error_table(result, "simulation", "extended", "Given"),
            ],
        ),
        ("Torque on the hold-out", list(torque_figures(result, series, "extended"))),
    ]


def _motion(result: Result, series: Series) -> Parts:
    return [
        ("Limits", [limit_table(result)]),
        ("What the motions make visible", [spectrum_figure(series)]),
        ("The motions", [motion_figure(result, series)]),
    ]


def _analyze(result: Result, series: Series) -> Parts:
    rows = records(result, "precision", "rows")
    return [
        ("Parameters in another category", [category_block(result)]),
        ("What the motions make visible", [spectrum_figure(series)]),
        (
            "Certainty with each motion",
            [precision_figure(rows), precision_table(result), unmatched(result, "precision")],
        ),
    ]


def _robots(result: Result, series: Series) -> Parts:
    return [
        ("Limits and parameters that differ", [model_table(result), unmatched(result, "models")])
    ]


_PARTS: Mapping[str, Callable[[Result, Series], Parts]] = {
    "design": _motion,
    "check": _motion,
    "identify": _identify,
    "analyze": _analyze,
    "diagnose": _diagnose,
    "robots": _robots,
}
