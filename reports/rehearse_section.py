"""What a rehearsal came to: on a page, in a summary, on the terminal."""

from __future__ import annotations

from excitant.reports.design_motion_figure import motion_figure
from excitant.reports.model import (
    FAIR,
    GOOD,
    POOR,
    Block,
    Cell,
    Fact,
    Facts,
    Notes,
    Section,
    section,
    table,
)
from excitant.reports.plain_text import fields
from excitant.reports.reading import Result, Series, at, joint_names, real, records, text, words
from excitant.reports.wording import NONE, number, percent, plain, quantity, value_and_std


def rehearse_section(result: Result, series: Series) -> Section:
    """Whether a motion would do, requirement by requirement."""
    rows = records(result, "items")
    advice = words(result, "advice")
    passed = at(result, "passed") is True
    facts = Facts(
        (
            Fact("Verdict", "would do" if passed else "would not do", "", GOOD if passed else POOR),
            Fact("Requirements met", f"{sum(_met(row) for row in rows)} of {len(rows)}"),
            Fact("Duration", quantity(at(result, "duration"), "s")),
            Fact("Change to be named", plain(text(result, "effect", "effect")) or NONE,
                 text(result, "effect", "joint")),
        )
    )  # fmt: skip
    motion = motion_figure(joint_names(result), result, series)
    return section(
        "Rehearsal",
        text(result, "headline") + ".",
        [
            ("Key figures", [facts]),
            ("What to change", [Notes(tuple(advice), FAIR) if advice else None]),
            ("Requirements", [_requirements(result)]),
            ("Planted and recovered", [_values(result)]),
            ("What the virtual arm did", [motion]),
        ],
    )


def _met(row: Result) -> bool:
    return at(row, "passed") is True


def _requirements(result: Result) -> Block | None:
    rows: list[list[Cell | str]] = [
        [
            Cell("met", GOOD) if _met(row) else Cell("not met", POOR),
            text(row, "name"),
            text(row, "joint") or NONE,
            text(row, "detail"),
        ]
        for row in records(result, "items")
    ]
    if not rows:
        return None
    return table(
        "text:Met | text:Requirement | name:Joint | text:Figures",
        rows,
        "The arm has friction, rotor inertia, offsets and noise as is usual, inertias off by up "
        "to 5 %, and later one change; the motion must show all of it.",
    )


def _values(result: Result) -> Block | None:
    rows: list[list[Cell | str]] = []
    for row in records(result, "items"):
        planted, value = real(row, "planted"), real(row, "recovered")
        if planted is None or value is None:
            continue
        error = (value - planted) / abs(planted) if planted else None
        recovered, std = value_and_std(value, at(row, "std"))
        rows.append(
            [
                text(row, "name"), text(row, "joint"), number(planted, 4), recovered, std,
                text(row, "unit"), Cell(percent(error), GOOD if _met(row) else POOR),
            ]
        )  # fmt: skip
    if not rows:
        return None
    return table(
        "text:What | name:Joint | number:Planted | number:Recovered | number:± std | text:Unit | "
        "number:Error",
        rows,
        "Every value planted in the arm beside what was recovered of it.",
    )


def rehearse_brief(result: Result) -> list[tuple[str, str]]:
    """One line per requirement, then what to change."""
    lines = [
        ("met" if _met(row) else "NOT MET", f"{_title(row)}: {text(row, 'detail')}")
        for row in records(result, "items")
    ]
    advice = [("to change" if k == 0 else "", a) for k, a in enumerate(words(result, "advice"))]
    verdict = "passed" if at(result, "passed") is True else "failed"
    return [*lines, *advice, (verdict, text(result, "headline"))]


def rehearse_lines(result: Result) -> list[str]:
    """Lines of the plain-text summary."""
    lines = fields("", result, ("trajectory", "seed", "duration", "passed", "headline"))
    lines.append("[[requirements]]")
    for row in records(result, "items"):
        mark = "met    " if _met(row) else "NOT MET"
        lines.append(f"    {mark}  {_title(row)}: {text(row, 'detail')}")
    advice = words(result, "advice")
    return [*lines, *(["[[what to change]]", *(f"    {a}" for a in advice)] if advice else [])]


def _title(row: Result) -> str:
    joint = text(row, "joint")
    return text(row, "name") + (f", {joint}" if joint else "")
