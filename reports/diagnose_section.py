"""Section on what the model gets wrong, and what would settle open questions."""

from __future__ import annotations

from dataclasses import replace

from excitant.reports.design_section import CUTOFF_REMARK, known_facts
from excitant.reports.fault_table import fault_table
from excitant.reports.file_list import file_list
from excitant.reports.finding_section import cause, finding_parts, finding_table
from excitant.reports.given_error_figures import given_error_blocks, step_figure
from excitant.reports.model import (
    GOOD,
    POOR,
    Block,
    Cell,
    Fact,
    Facts,
    Figure,
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
    quantity,
    sentence,
)

_GIVEN_TITLE = {True: "What is wrong with the given model", False: "Error of the given model"}
_NOISE = "noise-like"  # what a diagnosis calls a residual without structure
_ONE_MODEL = (
    "Measured torque and the given model's prediction over the hold-out, below it what the model "
    "leaves: a residual without shape is noise, one with shape is something the model lacks."
)
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
    findings, changed = records(result, "findings"), _changed(result)
    lead = text(result, "headline") or _headline(findings)
    notes = [sentence(note) for note in words(result, "notes") if note and note not in lead]
    parts: list[tuple[str, list[Block | None]]] = [
        ("Key figures", [_facts(result), fault_table(result), finding_table(result, unit)]),
        (_GIVEN_TITLE[bool(findings)], given_error_blocks(result, unit, changed)),
        ("Error step by step", [step_figure(result) if changed else None]),
    ]
    parts += finding_parts(findings, series, unit)
    parts += [
        ("Error per joint", [_bars(result, unit, changed), _joint_table(result, unit, changed)]),
        (over_holdout(unit), [_torque(joints, series, unit, changed)]),
        ("Not explained", _unexplained(result)),
        ("Notes", [Notes(tuple(notes)) if notes else None]),
        ("Files", [file_list(result, "extended")]),
    ]
    return section("Diagnosis", lead, parts)


def _changed(result: Result) -> bool:
    """Whether the extended model predicts otherwise than the given one; not if nothing is named."""
    pairs = [(real(b, "rms"), real(a, "rms")) for _, b, a in _pairs(result)]
    return any(a is not None and a != b for b, a in pairs)


def _torque(joints: list[str], series: Series, unit: str, changed: bool) -> Figure | None:
    if changed:
        return torque_figure(joints, series, unit, _CURVES)
    given = {key: value for key, value in series.items() if key != _CURVES.after}
    return torque_figure(joints, given, unit, replace(_CURVES, caption=_ONE_MODEL))


def _headline(findings: list[Result]) -> str:
    if not findings:
        return "No effect beyond the model was found."
    effects = [cause(finding) for finding in findings]
    return f"The model lacks: {listing(effects)}."


def _facts(result: Result) -> Facts | None:
    findings, faults = records(result, "findings"), records(result, "faults")
    verdicts = [text(finding, "verdict") for finding in findings]
    counts = [f"{n} {word}" for word in dict.fromkeys(verdicts) if (n := verdicts.count(word))]
    before, after = (
        middle(records(result, m, "joints"), "nrmse") for m in ("simulation", "extended")
    )
    change = NONE if before is None else percent(before)
    if before is not None and after is not None and _changed(result):
        change = f"{percent(before)} → {percent(after)}"
    return known_facts(
        [
            Fact("Hold-out error", change, "nrmse, median over joints"),
            Fact("Findings", str(len(findings)), ", ".join(counts) or "nothing stands out"),
            Fact("Data faults", str(len(faults)), "", POOR if faults else GOOD),
            Fact("Cut-off", quantity(at(result, "cutoff_hz"), "Hz"), CUTOFF_REMARK),
        ]
    )


def _pairs(result: Result) -> list[tuple[str, Result, Result]]:
    before = {text(row, "name"): row for row in records(result, "simulation", "joints")}
    after = {text(row, "name"): row for row in records(result, "extended", "joints")}
    return [(name, before.get(name, {}), after.get(name, {})) for name in {**before, **after}]


def _bars(result: Result, unit: str, changed: bool) -> Block | None:
    changes = [
        Change(name, real(b, "rms"), real(a, "rms"), real(b, "nrmse"), real(a, "nrmse"))
        for name, b, a in ((name, b, a if changed else {}) for name, b, a in _pairs(result))
    ]
    return error_bars(
        changes,
        unit,
        ("model as given", "extended model"),
        "Error of the simulation per joint on the hold-out, as a share of the measured torque's "
        f"standard deviation so that joints compare; beside each bar the rms [{unit}]: shorter is "
        "better.",
    )


def _joint_table(result: Result, unit: str, changed: bool) -> Table | None:
    models = ("Given", "Extended") if changed else ("Given",)
    rows: list[list[Cell | str]] = []
    for name, *pair in _pairs(result):
        shown = pair[: len(models)]
        rows.append(
            [
                name,
                *(number(at(row, "rms")) for row in shown),
                *(percent(at(row, "nrmse")) for row in shown),
                *(number(at(row, "r2"), 4) for row in shown),
            ]
        )
    if not rows:
        return None
    cutoff = real(result, "cutoff_hz")
    same = "" if cutoff is None else f", all after the same filter ({quantity(cutoff, 'Hz')})"
    measures = (f"rms [{unit}]", "nrmse", "r²")
    heads = [f"number:{model}, {measure}" for measure in measures for model in models]
    return table(
        " | ".join(["name:Joint", *heads]),
        rows,
        f"The model as given{' and with the findings added' * changed}, on the hold-out{same}; "
        "nrmse is rms over the measured torque's standard deviation.",
    )


def _unexplained(result: Result) -> list[Block | None]:
    found = records(result, "unexplained")
    if not found:
        return []
    sized = any(text(row, "against_noise") for row in found)
    rows: list[list[Cell | str]] = [
        [
            text(row, "joint"),
            percent(at(row, "share")),
            *([text(row, "against_noise") or NONE] if sized else []),
            text(row, "structure").removeprefix("structured: ") or NONE,
        ]
        for row in found
    ]
    caption = (
        "What everything found leaves: share of the measured torque's variance, its size against "
        "the noise while the joint moves, and what it varies with."
    )
    heads = "number:Share | " + ("text:Against the noise | " if sized else "") + "text:Structure"
    noise = all(text(row, "structure") == _NOISE for row in found)
    fold = f"What is left, joint by joint ({len(rows)})" if noise else ""
    return [
        Notes(("What is left looks like noise at every joint.",), GOOD) if noise else None,
        table(f"name:Joint | {heads}", rows, caption, fold),
    ]
