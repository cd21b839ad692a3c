"""Tables of two runs side by side."""

from __future__ import annotations

from collections.abc import Sequence

from excitant.reports.comparison_figures import deviation_figure, leader
from excitant.reports.design_motion_figure import share_of_limit
from excitant.reports.finding_section import cause
from excitant.reports.model import (
    FAIR,
    GOOD,
    PLAIN,
    POOR,
    Block,
    Cell,
    Notes,
    Table,
    table,
)
from excitant.reports.reading import Result, at, items, real, records, text, words
from excitant.reports.wording import NONE, listing, number, percent, plain, value_and_std

_FLAT = 0.05  # relative change of an error that is called none
_NAMED = 12  # names in a sentence
_SHOWN = 40  # rows without opening a fold


def error_table(result: Result, before: str, after: str, title: str) -> Table | None:
    """Errors of both runs joint by joint, of the model before and after."""
    rows: list[list[Cell | str]] = []
    judged = not words(result, "remarks")
    for row in records(result, "errors"):
        change = real(row, "change")
        tone = PLAIN
        if judged and change is not None and abs(change) > _FLAT:
            tone = GOOD if change < 0 else POOR
        written = NONE if change is None else _change(change)
        rows.append(
            [
                text(row, "name"),
                *(number(at(row, model, s, "rms")) for model in (before, after) for s in "ab"),
                Cell(written, tone),
                *(percent(at(row, after, s, "nrmse")) for s in "ab"),
                *(number(at(row, after, s, "r2"), 4) for s in "ab"),
            ]
        )
    unit = text(result, "unit")
    heads = [f"number:{title}, rms {s} [{unit}]" for s in "AB"]
    heads += [f"number:rms {s} [{unit}]" for s in "AB"] + ["number:rms, B against A"]
    heads += [f"number:nrmse {s}" for s in "AB"] + [f"number:r² {s}" for s in "AB"]
    return table(
        " | ".join(["name:Joint", *heads]),
        rows,
        f"Errors on the hold-out, {title.lower()}: those of the model before it was changed."
        + (" ● B is better by more than 5\u00a0%, ○ worse." if judged else ""),
    ) if rows else None  # fmt: skip


def _change(share: float) -> str:
    """A relative change; one by more than a factor of two as a factor."""
    if share > 1:
        return f"×\u00a0{number(1 + share)}"
    return f"{'+' if share > 0 else ''}{percent(share)}"


def estimate_blocks(result: Result, key: str, what: str) -> list[Block | None]:
    """Estimates of both runs, those that lie furthest apart first."""
    rows = records(result, key, "rows")
    if not rows:
        return [unmatched(result, key)]
    judged, apart = (int(real(result, key, name) or 0) for name in ("judged", "apart"))
    sentence = (
        f"{apart} of {judged} {what} that both runs estimate from data differ by more than two "
        f"standard deviations of their difference; by chance about {0.0455 * judged:.0f} would. "
        "Counted as if the data were independent: on the same recording, less is a difference too."
    )
    return [
        Notes((sentence,)),
        deviation_figure(rows),
        _estimate_table(rows, what),
        unmatched(result, key),
    ]


def _estimate_table(rows: Sequence[Result], what: str) -> Table:
    cells: list[list[Cell | str]] = []
    for row in rows:
        z = real(row, "deviations")
        verdict = Cell("apart", POOR) if at(row, "apart") else Cell("agree", GOOD)
        if z is None:
            verdict = Cell("open")
        pairs = [value_and_std(at(row, s, "value"), at(row, s, "std")) for s in "ab"]
        written = [f"{value} ± {std}" for value, std in pairs]
        cells.append(
            [text(row, "name"), *written, text(row, "unit") or "SI", number(z, 2), verdict]
        )
    return table(
        "expression:Parameter | number:A | number:B | name:Unit | number:Apart [std] | "
        "text:Verdict",
        cells,
        "Value ± standard deviation, furthest apart first; open where a value follows its prior or "
        "has no standard deviation.",
        f"All {len(cells)} {what} that both runs have" if len(cells) > 8 else "",
    )


def unmatched(result: Result, key: str) -> Notes | None:
    """Names that only one of the runs has; None where both have all."""
    said = []
    for side in "ab":
        names = words(result, key, f"only_{side}")
        if names:
            more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
            named = ", ".join(leader(name) for name in names[:_NAMED])
            said.append(f"Only in {side.upper()} ({len(names)}): {named}{more}.")
    return Notes(tuple(said)) if said else None


def finding_table(result: Result) -> Table | None:
    """Findings in common, then those of one run alone."""
    found = at(result, "findings")
    rows: list[list[Cell | str]] = []
    for pair in records(found, "common"):
        first, second = at(pair, "a"), at(pair, "b")
        joints = [listing(words(each, "joints")) for each in (first, second)]
        where = joints[0] if joints[0] == joints[1] else f"A: {joints[0]}; B: {joints[1]}"
        rows.append(_finding_row("both", first, second, where))
    for side in "ab":
        for row in records(found, f"only_{side}"):
            own: tuple[Result, Result] = (row, {}) if side == "a" else ({}, row)
            where = listing(words(row, "joints"))
            rows.append(_finding_row(f"only {side.upper()}", *own, where))
    if not rows:
        return None
    return table(
        "text:Found by | text:Effect | name:Joints | number:Explains, A | number:Explains, B | "
        "text:Verdict A | text:Verdict B",
        rows,
        "What both diagnoses name comes first; what only one names is to be doubted.",
    )


def _finding_row(by: str, a: Result, b: Result, where: str) -> list[Cell | str]:
    effect = cause(a if text(a, "effect") else b)
    shares = [percent(at(each, "explained")) for each in (a, b)]
    verdicts: list[Cell | str] = [
        Cell(v or NONE, {"named": GOOD, "undecided": FAIR}.get(v, PLAIN))
        for v in (text(each, "verdict") for each in (a, b))
    ]
    return [Cell(by, GOOD if by == "both" else FAIR), effect, where, *shares, *verdicts]


def agreement(result: Result) -> Notes | None:
    """How many findings the runs share."""
    found = at(result, "findings")
    counts = [len(items(found, key)) for key in ("common", "only_a", "only_b")]
    if not sum(counts):
        return Notes(("Neither diagnosis has a finding.",))
    return Notes(
        (f"{counts[0]} findings in common, {counts[1]} only in A and {counts[2]} only in B.",)
    )


def finding_values(result: Result) -> Table | None:
    """Fitted values of the findings that both runs have."""
    rows = [
        row
        for pair in records(result, "findings", "common")
        for row in records(pair, "parameters")
        if real(row, "difference") is not None
    ]
    return _estimate_table(rows, "fitted values") if rows else None


def fault_table(result: Result) -> Table | None:
    """Data faults in common, then those of one run alone."""
    rows: list[list[Cell | str]] = []
    found = at(result, "faults")
    listed = [("both", at(pair, "a")) for pair in records(found, "common")]
    listed += [(f"only {s.upper()}", row) for s in "ab" for row in records(found, f"only_{s}")]
    for by, row in listed:
        fault, joints = plain(text(row, "fault")), listing(words(row, "joints"))
        rows.append([by, fault, joints, text(row, "detail") or NONE])
    return table("text:Found by | text:Fault | name:Joints | text:Detail", rows) if rows else None


def limit_table(result: Result) -> Table | None:
    """The worst share of each limit in both motions."""
    rows: list[list[Cell | str]] = []
    for row in records(result, "limits"):
        cells: list[Cell | str] = [text(row, "quantity")]
        for side in "ab":
            ratio = real(row, side, "ratio")
            tone = PLAIN if ratio is None else GOOD if ratio <= 1 + 1e-9 else POOR
            cells.append(Cell(NONE if ratio is None else share_of_limit(ratio), tone))
        cells += [text(row, side, "joint") or NONE for side in "ab"]
        rows.append(cells)
    return table(
        "name:Quantity | number:A, share of limit | number:B, share of limit | "
        "name:Worst joint, A | name:Worst joint, B",
        rows,
        "The worst point of each continuous motion: ● the limit holds, ○ it is exceeded.",
    ) if rows else None  # fmt: skip


def category_block(result: Result) -> Block | None:
    """Parameters that the two analyses put into different categories."""
    rows: list[list[Cell | str]] = [
        [text(row, "name"), *(text(row, side) or NONE for side in "ab")]
        for row in records(result, "categories")
    ]
    if not rows:
        return Notes(("Both runs put every parameter into the same category.",))
    fold = f"All {len(rows)} parameters" if len(rows) > 14 else ""
    return table("name:Parameter | text:A | text:B", rows,
                 "What torque can show of a parameter in both runs.", fold)  # fmt: skip


def precision_table(result: Result) -> Table | None:
    """Standard deviations with both motions."""
    rows: list[list[Cell | str]] = []
    for row in records(result, "precision", "rows"):
        ratio = real(row, "ratio")
        tone = PLAIN if ratio is None or abs(ratio - 1) < _FLAT else GOOD if ratio < 1 else POOR
        rows.append(
            [
                text(row, "name"),
                *(number(at(row, side, "std")) for side in "ab"),
                Cell(percent(ratio), tone),
                *(plain(text(row, side, "verdict")) or NONE for side in "ab"),
            ]
        )
    return table(
        "expression:Base parameter | number:Std A (SI) | number:Std B (SI) | "
        "number:B, share of A | text:Verdict A | text:Verdict B",
        rows,
        "Standard deviation with both motions, the greatest difference first.",
        f"All {len(rows)} base parameters that both runs have" if len(rows) > 8 else "",
    ) if rows else None  # fmt: skip


def model_table(result: Result) -> Block | None:
    """Limits, loads and parameters that the models give differently; None if they share none."""
    rows: list[list[Cell | str]] = []
    for row in records(result, "models", "rows"):
        a, b = (real(row, side) for side in "ab")
        change = NONE if not a or b is None else _change(b / a - 1)
        rows.append([text(row, "name"), number(a, 4), number(b, 4), text(row, "unit"), change])
    if not real(result, "models", "compared"):
        return None
    if not rows:
        return Notes(("Both models give all that they share alike.",))
    return table(
        "name:Value | number:A | number:B | name:Unit | number:B against A",
        rows,
        "Limits and loads of joints, then parameters of links and effects; a dash is no limit.",
        f"All {len(rows)} values that differ" if len(rows) > _SHOWN else "",
    )
