"""Link by link: what each stage determined, what its recordings lack, and the motions for it."""

from __future__ import annotations

from excitant.reports.drawing import FITTED, GIVEN, GREEN, axes, panel, percent_x
from excitant.reports.model import (
    FAIR,
    GOOD,
    Block,
    Cell,
    Fact,
    Facts,
    Figure,
    Key,
    Notes,
    Table,
    table,
)
from excitant.reports.reading import Result, at, real, records, text, words
from excitant.reports.wording import (
    NONE,
    listing,
    number,
    quantity,
    shorten,
    value_and_std,
)

Parts = list[tuple[str, list[Block | None]]]

_METHODS = (
    ("given", "model as given", GIVEN),
    ("all_at_once", "all links at once", GREEN),
    ("link_by_link", "link by link", FITTED),
)
_CUT = 1.5  # of the measured torque's standard deviation: longer bars are cut


def link_by_link_parts(result: Result, unit: str) -> Parts:
    """Parts of the page that `identify --link-by-link` adds; none without its result."""
    found = at(result, "link_by_link")
    stages = records(found, "stages")
    if not stages:
        return []
    parts: Parts = [
        (
            "Link by link against all links at once",
            [_facts(found, stages), _bars(found, unit), _comparison(found, unit)],
        )
    ]
    parts += [(f"Link {text(stage, 'link')}", _stage(stage)) for stage in stages]
    return parts


def _facts(found: Result, stages: list[Result]) -> Facts:
    determined, total = real(found, "determined"), real(found, "base_parameters")
    complete = determined is not None and determined == total
    each = " + ".join(str(len(records(stage, "determined"))) for stage in stages)
    return Facts(
        (
            Fact(
                "Combinations determined",
                f"{text(found, 'determined')} of {text(found, 'base_parameters')}",
                f"{each}, from the last link inward",
                GOOD if complete else FAIR,
            ),
        )
    )


def _bars(found: Result, unit: str) -> Figure | None:
    rows = records(found, "comparison", "joints")
    shares = [[_share(row, key) for key, _, _ in _METHODS] for row in rows]
    if not rows or not any(x is not None for row in shares for x in row):
        return None
    (ax,) = axes(0.66 * len(rows) + 0.52, left=0.14)
    top = min(max(x for row in shares for x in row if x is not None), _CUT)
    for k, (row, lengths) in enumerate(zip(rows, shares, strict=True)):
        ax.text(0, k - 0.37, shorten(text(row, "name"), 40), va="center", ha="left")
        for i, (length, (key, _, colour)) in enumerate(zip(lengths, _METHODS, strict=True)):
            if length is None:
                continue
            y, end = k - 0.14 + 0.23 * i, min(length, top)
            ax.barh(y, end, height=0.2, color=colour)
            cut = " (bar cut)" if length > top * 1.0001 else ""
            ax.text(end + 0.012 * top, y, quantity(at(row, key), unit) + cut, va="center",
                    ha="left", fontsize=8)  # fmt: skip
    ax.set_ylim(len(rows) - 0.5, -0.6)
    ax.set_xlim(0, 1.38 * top)
    ax.set_yticks([])
    ax.spines["left"].set_visible(False)
    percent_x(ax)
    ax.set_xlabel("rms of residual, share of the measured torque's std")
    said = "; ".join(
        f"{text(row, 'name')} "
        + ", ".join(f"{label} {quantity(at(row, key), unit)}" for key, label, _ in _METHODS)
        for row in rows
    )
    legend = tuple(Key("box", colour, label) for _, label, colour in _METHODS)
    return Figure(
        (panel(ax, f"rms per joint on the hold-out: {said}"),),
        "Prediction error per joint on the hold-out of the model as given, of all links fitted at "
        f"once and link by link from the same recordings; beside each bar the rms [{unit}]: "
        "shorter is better.",
        legend,
    )


def _share(row: Result, key: str) -> float | None:
    rms, std = real(row, key), real(row, "measured_std")
    return None if rms is None or not std else rms / std


def _comparison(found: Result, unit: str) -> Table | None:
    rows: list[list[Cell | str]] = []
    for row in records(found, "comparison", "joints"):
        whole, stages = real(row, "all_at_once"), real(row, "link_by_link")
        ratio = stages / whole if whole and stages is not None else None
        rows.append(
            [text(row, "name"), *(number(at(row, key)) for key, _, _ in _METHODS), number(ratio)]
        )
    if not rows:
        return None
    heads = " | ".join(f"number:{label.capitalize()}, rms [{unit}]" for _, label, _ in _METHODS)
    return table(
        f"name:Joint | {heads} | number:Link by link / at once",
        rows,
        f"All links at once: {text(found, 'comparison', 'all_at_once')}.",
    )


def _stage(stage: Result) -> list[Block | None]:
    joint = text(stage, "joint")
    used, rows = words(stage, "recordings"), real(stage, "rows")
    said = f"{joint} does not move."
    if used and rows is not None:
        mode = text(stage, "mode")
        said = f"Torque of {joint}: {rows:.0f} rows of {listing(used)}; {joint} {mode}."
    needed = words(stage, "needed")
    return [
        Notes((said,)),
        _determined(stage),
        Notes(tuple(f"To see the rest, {each}." for each in needed), FAIR) if needed else None,
    ]


def _determined(stage: Result) -> Table | None:
    rows: list[list[Cell | str]] = [
        [
            text(each, "expression"),
            Cell("determined", GOOD),
            *value_and_std(at(each, "value"), at(each, "std")),
        ]
        for each in records(stage, "determined")
    ]
    rows += [[each, Cell("not shown", FAIR), NONE, NONE] for each in words(stage, "missing")]
    if not rows:
        return None
    missing = len(words(stage, "missing"))
    fold = f"{len(rows) - missing} combinations determined, {missing} not shown"
    return table(
        "expression:Combination | text:Verdict | number:Value (SI) | number:Std (SI)",
        rows,
        "What the joint's own torque adds to what the links further out have shown already"
        + (f"; {missing} more combinations of this link are not shown and stay at the given robot."
           if missing else "; nothing of this link is left open."),
        fold if len(rows) > 6 else "",
    )  # fmt: skip


def link_motion_parts(result: Result) -> Parts:
    """Parts of the page that `design --link-by-link` adds; none without its result."""
    rows: list[list[Cell | str]] = [
        [
            text(stage, "file"),
            text(stage, "link"),
            str(len(words(stage, "moves"))),
            number(at(stage, "duration")),
            text(stage, "base_parameters") or NONE,
            number(at(stage, "condition_number", "initial")),
            number(at(stage, "condition_number", "final")),
            number(at(stage, "condition_number_scaled", "final")),
        ]
        for stage in records(result, "link_by_link", "stages")
    ]
    if not rows:
        return []
    return [
        (
            "One motion per link",
            [
                table(
                    "name:File | name:Link | number:Joints moving | number:Duration [s] | "
                    "number:Base parameters | number:Condition number, first | "
                    "number:Condition number | number:Condition number, scaled",
                    rows,
                    "Each motion shows the base parameters of its link in the torque of that "
                    "link's joint alone, the links further out being known by then; the figures "
                    "below show the motions one after the other.",
                )
            ],
        )
    ]
