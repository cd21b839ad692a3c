"""Section on what the model gets wrong, and what would settle open questions."""

from __future__ import annotations

from excitant.reports.design_section import file_list, known_facts
from excitant.reports.evidence_figures import evidence_figure
from excitant.reports.fault_table import fault_table
from excitant.reports.given_error_figures import given_error_blocks, step_figure
from excitant.reports.model import (
    FAIR,
    GOOD,
    PLAIN,
    POOR,
    Block,
    Cell,
    Fact,
    Facts,
    Notes,
    Section,
    Table,
    section,
    table,
)
from excitant.reports.reading import (
    Result,
    Series,
    at,
    joint_names,
    middle,
    real,
    records,
    text,
    words,
)
from excitant.reports.torque_figures import (
    Change,
    Curves,
    error_bars,
    over_holdout,
    torque_figure,
)
from excitant.reports.wording import (
    NONE,
    listing,
    number,
    percent,
    plain,
    quantity,
    value_and_std,
)

_LEADING, _SMALL = 3, 0.01  # findings that always have a part of their own; share of others

_CURVES = Curves(
    "simulated",
    "model as given",
    "extended",
    "extended model",
    "Measured torque and prediction over the hold-out, below it what each model leaves: where blue "
    "is flat and orange is not, the named effects are the cause.",
)


def diagnose_section(result: Result, series: Series) -> Section:
    """The diagnosis: faults, findings in order of importance with evidence, what stays open."""
    unit = text(result, "unit") or "N·m"
    joints = joint_names(result, "simulation.joints", "extended.joints")
    findings = records(result, "findings")
    notes = words(result, "notes")
    parts: list[tuple[str, list[Block | None]]] = [
        ("Key figures", [_facts(result), fault_table(result), _finding_table(result, unit)]),
        ("What is wrong with the given model", given_error_blocks(result, unit)),
        ("Error step by step", [step_figure(result)]),
    ]
    small: list[Block | None] = []
    for k, finding in enumerate(findings):
        title, blocks = _title(k, finding), _finding(k, finding, series, unit)
        share = real(finding, "explained")
        if k < _LEADING or _unknown(finding) or share is None or share > _SMALL:
            parts.append((title, blocks))
        else:
            small += [Notes((f"{title}.",)), *blocks]
    parts.append((f"Findings of less than {percent(_SMALL)} of the error each", small))
    parts += [
        ("Error per joint", [_bars(result, unit), _joint_table(result, unit)]),
        (over_holdout(unit), [torque_figure(joints, series, unit, _CURVES)]),
        ("Not explained", [_unexplained(result)]),
        ("Notes", [Notes(tuple(notes)) if notes else None]),
        ("Files", [file_list(result, "extended")]),
    ]
    return section("Diagnosis", text(result, "headline") or _headline(findings), parts)


def _unknown(finding: Result) -> bool:
    return text(finding, "effect") == "unknown"


def _title(index: int, finding: Result) -> str:
    names = words(finding, "joints")
    at_ = f" at {listing(names)}" if names else ""
    return f"Finding {index + 1}: {plain(text(finding, 'effect'))}{at_}"


def _headline(findings: list[Result]) -> str:
    if not findings:
        return "No effect beyond the model was found."
    effects = [plain(text(finding, "effect")) for finding in findings]
    return f"The model lacks: {listing(effects)}."


def _facts(result: Result) -> Facts | None:
    findings, faults = records(result, "findings"), records(result, "faults")
    verdicts = [text(finding, "verdict") for finding in findings]
    counts = [f"{n} {word}" for word in dict.fromkeys(verdicts) if (n := verdicts.count(word))]
    before, after = (
        middle(records(result, m, "joints"), "nrmse") for m in ("simulation", "extended")
    )
    change = NONE if before is None else percent(before)
    if before is not None and after is not None:
        change = f"{percent(before)} → {percent(after)}"
    return known_facts(
        [
            Fact("Hold-out error", change, "nrmse, median over joints"),
            Fact("Findings", str(len(findings)), ", ".join(counts)),
            Fact("Data faults", str(len(faults)), "", POOR if faults else GOOD),
            Fact("Cut-off", quantity(at(result, "cutoff_hz"), "Hz"), "measured and model alike"),
        ]
    )


def verdict_cell(finding: Result) -> Cell:
    """The verdict on a finding with its tone."""
    verdict = text(finding, "verdict")
    return Cell(verdict or NONE, {"named": GOOD, "undecided": FAIR}.get(verdict, PLAIN))


def _finding_table(result: Result, unit: str) -> Table | None:
    rows: list[list[Cell | str]] = [
        [
            str(k + 1),
            plain(text(finding, "effect")),
            listing(words(finding, "joints")),
            percent(at(finding, "explained")),
            number(at(finding, "holdout", "rms_before")),
            number(at(finding, "holdout", "rms_after")),
            verdict_cell(finding),
        ]
        for k, finding in enumerate(records(result, "findings"))
    ]
    if not rows:
        return None
    return table(
        f"number:# | text:Effect | name:Joints | number:Explains | number:rms before [{unit}] | "
        f"number:rms after [{unit}] | text:Verdict",
        rows,
        "What the model lacks, most important first; error on data that were held out, while the "
        "joints move (at rest, dry friction takes any value).",
    )


def _finding(index: int, finding: Result, series: Series, unit: str) -> list[Block | None]:
    joints = words(finding, "joints")
    return [
        Notes((_sentence(finding, unit),)),
        evidence_figure(index, finding, joints, series, unit),
        _finding_parameters(finding),
        _rivals(finding),
    ]


def _sentence(finding: Result, unit: str) -> str:
    if _unknown(finding):
        structure = text(finding, "structure")
        said = "Structure is left over that no candidate explains"
        return f"{said}: {structure}." if structure else f"{said}."
    before, after = (real(finding, "holdout", key) for key in ("rms_before", "rms_after"))
    effect, share = plain(text(finding, "effect")), real(finding, "explained")
    sentence = f"{effect[:1].upper()}{effect[1:]} was found."
    if before is not None and after is not None:
        sentence = (
            f"With {effect}, and all else that was found, the rms on the hold-out is "
            f"{quantity(after, unit)} at these joints; without it, {quantity(before, unit)}."
        )
    if share is not None:
        sentence += f" That is {percent(share)} of the squared error that the given model leaves"
        sentence += ": other findings rest on it." if share > 1 else "."
    if doubt := text(finding, "doubt"):
        sentence += f" It is not decided: {doubt}."
    elif text(finding, "verdict") == "undecided":
        sentence += " It is not decided: the effects below explain these data as well."
    return sentence


def _finding_parameters(finding: Result) -> Table | None:
    rows: list[list[Cell | str]] = [
        [text(p, "name"), *value_and_std(at(p, "value"), at(p, "std")), text(p, "unit") or NONE]
        for p in records(finding, "parameters")
    ]
    if not rows:
        return None
    fold = f"All {len(rows)} fitted parameters" if len(rows) > 12 else ""
    return table(
        "name:Parameter | number:Value | number:Std | name:Unit",
        rows,
        "Fitted values with their standard deviation.",
        fold,
    )


def _rivals(finding: Result) -> Table | None:
    rows: list[list[Cell | str]] = [
        [
            plain(text(rival, "effect")),
            listing(words(rival, "joints")),
            text(rival, "why") or NONE,
            text(rival, "experiment") or NONE,
            number(at(rival, "separation")),
            number(at(rival, "repetitions")),
        ]
        for rival in records(finding, "rivals")
    ]
    caption = (
        "Other effects that look alike in these data, and the experiment that separates them, by "
        "how many standard deviations of the noise, and in how many runs."
    )
    columns = (
        "text:Rival | name:Joints | text:Why it cannot be excluded | "
        "text:Experiment that settles it | number:Separation [σ] | number:Runs"
    )
    return table(columns, rows, caption) if rows else None


def _pairs(result: Result) -> list[tuple[str, Result, Result]]:
    before = {text(row, "name"): row for row in records(result, "simulation", "joints")}
    after = {text(row, "name"): row for row in records(result, "extended", "joints")}
    return [(name, before.get(name, {}), after.get(name, {})) for name in {**before, **after}]


def _bars(result: Result, unit: str) -> Block | None:
    changes = [
        Change(name, real(b, "rms"), real(a, "rms"), real(b, "nrmse"), real(a, "nrmse"))
        for name, b, a in _pairs(result)
    ]
    return error_bars(
        changes,
        unit,
        ("model as given", "extended model"),
        "Error of the simulation per joint on the hold-out, as a share of the measured torque's "
        f"standard deviation; beside each bar the rms [{unit}].",
    )


def _joint_table(result: Result, unit: str) -> Table | None:
    rows: list[list[Cell | str]] = [
        [
            name,
            *(number(at(row, "rms")) for row in (b, a)),
            *(percent(at(row, "nrmse")) for row in (b, a)),
            *(number(at(row, "r2"), 4) for row in (b, a)),
        ]
        for name, b, a in _pairs(result)
    ]
    if not rows:
        return None
    cutoff = real(result, "cutoff_hz")
    same = "" if cutoff is None else f", all after the same filter ({quantity(cutoff, 'Hz')})"
    return table(
        f"name:Joint | number:Given, rms [{unit}] | number:Extended, rms [{unit}] | "
        "number:Given, nrmse | number:Extended, nrmse | number:Given, r² | number:Extended, r²",
        rows,
        f"The model as given and with the findings added, on the hold-out{same}.",
    )


def _unexplained(result: Result) -> Table | None:
    rows: list[list[Cell | str]] = [
        [
            text(row, "joint"),
            percent(at(row, "share")),
            text(row, "against_noise") or NONE,
            text(row, "structure") or NONE,
        ]
        for row in records(result, "unexplained")
    ]
    caption = (
        "What everything found leaves: share of the measured torque's variance, its size against "
        "the noise while the joint moves, and what it varies with."
    )
    columns = "name:Joint | number:Share | text:Against the noise | text:Structure"
    return table(columns, rows, caption) if rows else None
