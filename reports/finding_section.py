"""The findings of a diagnosis: each with its evidence, its values and its rivals."""

from __future__ import annotations

from excitant.reports.evidence_figures import evidence_figure
from excitant.reports.model import (
    FAIR,
    GOOD,
    PLAIN,
    Block,
    Cell,
    Folded,
    Notes,
    Table,
    table,
)
from excitant.reports.reading import Result, Series, at, real, records, text, words
from excitant.reports.wording import NONE, listing, number, percent, plain, quantity, value_and_std

_LEADING = 3  # findings that are shown without opening a fold

Parts = list[tuple[str, list[Block | None]]]


def unknown(finding: Result) -> bool:
    """Whether structure was found that no candidate explains."""
    return text(finding, "effect") == "unknown"


def cause(finding: Result) -> str:
    """The effect of a finding in words."""
    return "unknown cause" if unknown(finding) else plain(text(finding, "effect"))


def verdict_cell(finding: Result) -> Cell:
    """The verdict on a finding with its tone."""
    verdict = text(finding, "verdict")
    return Cell(verdict or NONE, {"named": GOOD, "undecided": FAIR}.get(verdict, PLAIN))


def finding_table(result: Result, unit: str) -> Table | None:
    """All findings in a line each, most important first."""
    rows: list[list[Cell | str]] = []
    for k, finding in enumerate(records(result, "findings")):
        before, after = (number(at(finding, "holdout", f"rms_{key}")) for key in _BOTH)
        explained = percent(at(finding, "explained"))
        if unknown(finding):
            explained, after = NONE, NONE
        where = listing(words(finding, "joints"))
        rows.append(
            [str(k + 1), cause(finding), where, explained, before, after, verdict_cell(finding)]
        )
    if not rows:
        return None
    return table(
        f"number:# | text:Effect | name:Joints | number:Explains | number:rms without it [{unit}] "
        f"| number:rms with it [{unit}] | text:Verdict",
        rows,
        "What the model lacks, most important first: its share of the squared error that the given "
        "model leaves, and the error at its joints on data that were held out, while they move, "
        "without and with it, all else that was found kept.",
    )


_BOTH = ("before", "after")


def finding_parts(findings: list[Result], series: Series, unit: str) -> Parts:
    """The leading findings in parts of their own, the others folded in one."""
    parts: Parts = []
    folded: list[Block | None] = []
    for k, finding in enumerate(findings):
        blocks = _finding(k, finding, series, unit)
        if k < _LEADING or unknown(finding):
            parts.append((_title(k, finding), blocks))
        else:
            shown = tuple(block for block in blocks if block is not None)
            folded.append(Folded(f"{_title(k, finding)}{_aside(finding)}", shown))
    parts.append(("Further findings", folded))
    return parts


def _title(index: int, finding: Result) -> str:
    names = words(finding, "joints")
    return f"Finding {index + 1}: {cause(finding)}{f' at {listing(names)}' if names else ''}"


def _aside(finding: Result) -> str:
    share, verdict = real(finding, "explained"), text(finding, "verdict")
    said = [*([] if share is None else [percent(share)]), *([verdict] if verdict else [])]
    return f" ({', '.join(said)})" if said else ""


def _finding(index: int, finding: Result, series: Series, unit: str) -> list[Block | None]:
    joints = words(finding, "joints")
    return [
        Notes((_sentence(finding, unit),)),
        evidence_figure(index, finding, joints, series, unit),
        _parameters(finding),
        _rivals(finding),
    ]


def _sentence(finding: Result, unit: str) -> str:
    if unknown(finding):
        structure = text(finding, "structure").removeprefix("structured: ")
        said = "Structure is left over that no candidate explains"
        return f"{said}: it {structure}." if structure else f"{said}."
    before, after = (real(finding, "holdout", f"rms_{key}") for key in _BOTH)
    effect, share = cause(finding), real(finding, "explained")
    sentence = f"{effect[:1].upper()}{effect[1:]} was found."
    if before is not None and after is not None:
        where = "these joints" if len(words(finding, "joints")) > 1 else "this joint"
        sentence = (
            f"Left out, with all else that was found kept, the rms on the hold-out at {where} is "
            f"{quantity(before, unit)} instead of {quantity(after, unit)}."
        )
    if share is not None:
        sentence += f" That is {percent(share)} of the squared error that the given model leaves"
        sentence += ": other findings rest on it." if share > 1 else "."
    if doubt := text(finding, "doubt"):
        sentence += f" It is not decided: {doubt}."
    elif text(finding, "verdict") == "undecided":
        sentence += " It is not decided: the effects below explain these data as well."
    return sentence


def _parameters(finding: Result) -> Table | None:
    found = records(finding, "parameters")
    given = any(real(p, "given") is not None for p in found)
    rows: list[list[Cell | str]] = [
        [
            text(p, "name"),
            *([number(at(p, "given"))] if given else []),
            *value_and_std(at(p, "value"), at(p, "std")),
            _unit(text(p, "unit")),
        ]
        for p in found
    ]
    if not rows:
        return None
    fixed = any(real(p, "std") is None for p in found)
    return table(
        f"name:Parameter | {'number:Given | ' * given}number:Fitted | number:Std | name:Unit",
        rows,
        f"{'Value in the given model, and f' if given else 'F'}itted value with its standard "
        "deviation" + (" (a dash: chosen from a grid, or held)." if fixed else "."),
        f"All {len(rows)} fitted parameters" if len(rows) > 12 else "",
    )


def _unit(unit: str) -> str:
    return NONE if unit in ("", "1") else unit.replace("^a", "ᵃ")


def _rivals(finding: Result) -> Table | None:
    found = records(finding, "rivals")
    said = all(_says_runs(rival) for rival in found)
    rows: list[list[Cell | str]] = [
        [
            plain(text(rival, "effect")),
            listing(words(rival, "joints")),
            text(rival, "why") or NONE,
            text(rival, "experiment") or NONE,
            *([] if said else [number(at(rival, "separation")), _whole(rival, "repetitions")]),
        ]
        for rival in found
    ]
    caption = (
        "Other effects that look alike in these data, and the experiment that separates them, by "
        "how many standard deviations of the noise, and in how many runs. Within few standard "
        "errors: the rival predicts no worse than chance allows. |cos| is 1 where its torque has "
        "the same course as the finding's."
    )
    columns = (
        "text:Rival | name:Joints | text:Why it cannot be excluded | "
        "text:Experiment that settles it"
    ) + ("" if said else " | number:Separation [σ] | number:Runs")
    return table(columns, rows, caption) if rows else None


def _says_runs(rival: Result) -> bool:
    """Whether the experiment's sentence holds what separation and repetitions say."""
    return real(rival, "separation") is None or "separates by" in text(rival, "experiment")


def _whole(row: Result, key: str) -> str:
    count = real(row, key)
    return NONE if count is None else f"{count:.0f}"
