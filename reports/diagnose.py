"""Section on what the model gets wrong, and what would settle open questions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from excitant.reports.diagnose_figures import evidence_figure, share_figure, waterfall_figure
from excitant.reports.identify import CUTOFF_REMARK, fault_table
from excitant.reports.page import (
    FAIR,
    GOOD,
    PLAIN,
    POOR,
    Block,
    Cell,
    Column,
    Fact,
    Facts,
    Folded,
    Notes,
    Parts,
    Section,
    Table,
    estimates,
    fact,
    facts,
    files,
    folded,
    notes,
    section,
    table,
)
from excitant.reports.torque_figures import Curves, error_bars, over_holdout, torque_figure
from excitant.reports.values import (
    NONE,
    Result,
    Series,
    at,
    change,
    joint_names,
    listing,
    median,
    number,
    number4,
    percent,
    plain,
    quantity,
    real,
    records,
    sentence,
    text,
    unit_of,
    whole,
    words,
)

_NOISE = "noise-like"  # what a diagnosis calls a residual without structure
_LEADING = 3  # findings that are shown without opening a fold
_CURVES = Curves(
    "simulated",
    "model as given",
    "extended",
    "extended model",
    "Measured torque and prediction over the hold-out, below it each model's residual: where blue "
    "is flat and orange is not, the named effects are the cause.",
)
_ONE_MODEL = (
    "Measured torque and the given model's prediction over the hold-out, below it its residual: "
    "one without shape is noise, one with shape is something the model lacks."
)


def diagnose_section(result: Result, series: Series) -> Section:
    """The diagnosis: faults, findings in order of importance with evidence, what stays open."""
    unit = text(result, "unit") or "N·m"
    joints = joint_names(result, "simulation.joints", "extended.joints")
    findings, changed = records(result, "findings"), _changed(result)
    lead = text(result, "headline")
    said = [sentence(note) for note in words(result, "notes") if note and note not in lead]
    curves = _CURVES if changed else replace(_CURVES, after="", caption=_ONE_MODEL)
    wrong = "What is wrong with the given model" if findings else "Error of the given model"
    return section(
        "Diagnosis",
        lead,
        [
            ("Key figures", [_facts(result), fault_table(result), _finding_table(findings, unit)]),
            (
                wrong,
                [
                    share_figure(result, unit, changed),
                    notes(words(result, "refit", "sentence")),
                    _refit(result, unit),
                    _moves(result),
                    _forward(result, changed),
                    notes(words(result, "forward", "notes")),
                ],
            ),
            ("Error step by step", [waterfall_figure(result) if changed else None]),
            *_finding_parts(findings, series, unit),
            (
                "Error per joint",
                [_bars(result, unit, changed), _joint_table(result, unit, changed)],
            ),
            (over_holdout(unit), [torque_figure(joints, series, unit, curves)]),
            ("Not explained", _unexplained(result)),
            ("Notes", [notes(said)]),
            ("Files", [files(words(result, "extended", "files"))]),
        ],
        (("diagnosed", text(result, "headline")),),
    )


def _pairs(result: Result) -> list[Result]:
    """Errors of both models, one record a joint."""
    found: dict[str, dict[str, object]] = {}
    for model in ("simulation", "extended"):
        for row in records(result, model, "joints"):
            found.setdefault(text(row, "name"), {"name": text(row, "name")})[model] = row
    return list(found.values())


def _changed(result: Result) -> bool:
    """Whether the extended model predicts otherwise than the given one; not if nothing is named."""
    errors = [[real(r, m, "rms") for m in ("simulation", "extended")] for r in _pairs(result)]
    return any(after is not None and after != before for before, after in errors)


def _cause(finding: Result) -> str:
    """The effect of a finding in words."""
    return "unknown cause" if _unknown(finding) else plain(text(finding, "effect"))


def _unknown(finding: Result) -> bool:
    """Whether structure was found that no candidate explains."""
    return text(finding, "effect") == "unknown"


def _facts(result: Result) -> Facts | None:
    findings, faults = records(result, "findings"), records(result, "faults")
    verdicts = [text(finding, "verdict") for finding in findings]
    counts = [f"{n} {word}" for word in dict.fromkeys(verdicts) if (n := verdicts.count(word))]
    before, after = (
        median(records(result, m, "joints"), "nrmse") for m in ("simulation", "extended")
    )
    after = after if _changed(result) else None
    errors = change(before, after, percent)
    return facts(
        Fact("Hold-out error", errors, "nrmse, median over joints", number=after or before),
        fact("Findings", len(findings), whole, ", ".join(counts) or "nothing stands out"),
        fact("Data faults", len(faults), whole, "", POOR if faults else GOOD),
        fact("Cut-off", at(result, "cutoff_hz"), unit_of("Hz"), CUTOFF_REMARK),
    )


def _finding_table(findings: list[Result], unit: str) -> Table | None:
    """All findings in a line each, most important first."""
    rows: list[Result] = []
    for k, finding in enumerate(findings, start=1):
        known = (
            {}
            if _unknown(finding)
            else {
                "explained": at(finding, "explained"),
                "after": at(finding, "holdout", "rms_after"),
            }
        )
        rows.append({**finding, "explained": None, "k": k, **known})
    return table(
        rows,
        [
            ("number:#", lambda r: text(r, "k")),
            ("name:Effect", _cause),
            ("name:Joints", "joints"),
            ("number:Explains", "explained", percent),
            (f"number:rms without it [{unit}]", "holdout.rms_before"),
            (f"number:rms with it [{unit}]", "after"),
            ("text:Verdict", _verdict),
        ],
        "What the model lacks, most important first: its share of the squared error that the given "
        "model leaves, and the error at its joints on data that were held out, while they move, "
        "without and with it, everything else that was found being kept.",
    )


def _verdict(finding: Result) -> Cell:
    verdict = text(finding, "verdict")
    return Cell(verdict or NONE, {"named": GOOD, "undecided": FAIR}.get(verdict, PLAIN))


def _finding_parts(findings: list[Result], series: Series, unit: str) -> Parts:
    """The leading findings in parts of their own, the others folded in one."""
    parts: Parts = []
    others: list[Block | None] = []
    for k, finding in enumerate(findings):
        joints = listing(words(finding, "joints"), "")
        title = f"Finding {k + 1}: {_cause(finding)}{' at ' * bool(joints)}{joints}"
        blocks: list[Block | None] = [
            Notes((_sentence(finding, unit),)),
            evidence_figure(k, finding, series, unit),
            _parameters(finding),
            _rivals(finding),
        ]
        if k < _LEADING or _unknown(finding):
            parts.append((title, blocks))
        else:
            share, verdict = real(finding, "explained"), text(finding, "verdict")
            aside = [percent(share)] * (share is not None) + [verdict] * bool(verdict)
            title += f" ({', '.join(aside)})" if aside else ""
            others.append(Folded(title, tuple(block for block in blocks if block is not None)))
    return [*parts, ("Further findings", others)]


def _sentence(finding: Result, unit: str) -> str:
    if _unknown(finding):
        structure = text(finding, "structure").removeprefix("structured: ")
        said = "Structure is left over that no candidate explains"
        return f"{said}: it {structure}." if structure else f"{said}."
    before, after = (real(finding, "holdout", f"rms_{key}") for key in ("before", "after"))
    effect, share = _cause(finding), real(finding, "explained")
    said = f"{effect[:1].upper()}{effect[1:]} was found."
    if before is not None and after is not None:
        where = "these joints" if len(words(finding, "joints")) > 1 else "this joint"
        said = (
            f"Without it, everything else that was found being kept, the rms on the hold-out at "
            f"{where} is {quantity(before, unit)} instead of {quantity(after, unit)}."
        )
    if share is not None:
        said += f" That is {percent(share)} of the squared error that the given model leaves"
        said += ": other findings rest on it." if share > 1 else "."
    if reason := text(finding, "doubt"):
        said += f" It is not decided: {reason}."
    elif text(finding, "verdict") == "undecided":
        said += " It is not decided: the effects below explain these data as well."
    return said


def _parameters(finding: Result) -> Table | None:
    rows = records(finding, "parameters")
    given = any(real(p, "given") is not None for p in rows)
    fixed = any(real(p, "std") is None for p in rows)
    return table(
        rows,
        [
            ("name:Parameter", "name"),
            ("number:Given", "given") if given else None,
            *estimates("number:Fitted"),
            ("text:Unit", "unit", _unit),
        ],
        f"{'Value in the given model, and f' if given else 'F'}itted value with its standard "
        "deviation" + (" (a dash: chosen from a grid, or held)." if fixed else "."),
        folded(f"All {len(rows)} fitted parameters", len(rows)),
    )


def _unit(unit: object) -> str:
    return "" if unit in (None, "1") else str(unit).replace("^a", "ᵃ")


def _rivals(finding: Result) -> Table | None:
    rows = records(finding, "rivals")
    # an experiment's sentence may already hold what separation and repetitions say
    said = all(
        real(r, "separation") is None or "separates by" in text(r, "experiment") for r in rows
    )
    runs: tuple[Column, ...] = (
        ("number:Separation [σ]", "separation"),
        ("number:Runs", "repetitions", whole),
    )
    return table(
        rows,
        [
            ("name:Rival", "effect", lambda effect: plain(effect or "")),
            ("name:Joints", "joints"),
            ("text:Why it cannot be excluded", "why"),
            ("text:Experiment that settles it", "experiment"),
            *(() if said else runs),
        ],
        "Other effects that look alike in these data, and the experiment that separates them, by "
        "how many standard deviations of the noise, and in how many runs. Within few standard "
        "errors: the rival predicts no worse than chance allows. |cos| is 1 where its torque has "
        "the same course as the finding's.",
    )


def _refit(result: Result, unit: str) -> Table | None:
    return table(
        records(result, "refit", "joints"),
        [
            ("name:Joint", "name"),
            (f"number:Given, rms [{unit}]", "given"),
            (f"number:Inertias free, rms [{unit}]", "inertias"),
            (f"number:Nearest bodies, rms [{unit}]", "bodies"),
            (f"number:With the findings, rms [{unit}]", "extended"),
        ],
        "What inertias alone would explain on the hold-out while joints move, all given effects "
        "being kept: fitted freely, and as the closest physically consistent inertias.",
        "What re-fitting the inertias alone would bring, joint by joint",
    )


def _moves(result: Result) -> Table | None:
    def deviations(key: str) -> Column:
        return ("number:in std", f"deviations.{key}", lambda x: number(x, 2))

    def inertia(row: Result) -> Cell:
        factor = real(row, "inertia")
        share = None if factor is None else 100 * float(np.expm1(factor))
        return Cell(number(share, 2), PLAIN, share)

    return table(
        records(result, "refit", "links"),
        [
            ("name:Link", "link"),
            ("number:Mass [kg]", "mass_kg"),
            deviations("mass"),
            ("number:Centre of mass [mm]", "centre_mm"),
            deviations("centre"),
            ("number:Inertia [%]", inertia),
            deviations("inertia"),
        ],
        "How far each link would have to change for that, most changed first; a given value is "
        "taken as right to two of these standard deviations.",
        "Which link would have to change, and how much",
    )


def _forward(result: Result, changed: bool) -> Table | None:
    """Both models simulated forward under the recorded torque."""
    rows = records(result, "forward", "joints")
    units = listing(list(dict.fromkeys(text(row, "unit") for row in rows)))
    count, length = (real(result, "forward", key) for key in ("windows", "window_s"))
    loop = quantity(at(result, "forward", "bandwidth_hz"), "Hz", 1)
    models = ("given", "extended") if changed else ("given",)
    worse = [
        text(row, "name")
        for row in rows
        if (given := real(row, "given")) is not None
        and (real(row, "extended") or float("inf")) > given
    ]
    closer = " The extended model stays closer on every joint."
    if worse:
        closer = (
            f" The extended model is no closer at {listing(worse)}: there its dry friction near "
            "rest, or overestimated effects, move the joint more than the findings help."
        )
    return table(
        rows,
        [
            ("name:Joint", "name"),
            *((f"number:Position, {m} [m{units}]", m, _milli) for m in models),
            *((f"number:Velocity, {m} [m{units}/s]", f"velocity.{m}", _milli) for m in models),
        ],
        f"Simulated forward under the recorded torque over {count or 0:.0f} windows of "
        f"{quantity(length, 's', 2)} of the hold-out: rms by which the model leaves the recorded "
        f"motion, held on it by {'the same' if changed else 'a'} loop of {loop}."
        f"{closer if changed else ''}",
    )


def _milli(value: object) -> str:
    x = real(value)
    return "diverges" if x is None else number(1e3 * x)


def _bars(result: Result, unit: str, changed: bool) -> Block | None:
    models = ("simulation", "extended") if changed else ("simulation",)
    errors = [
        (text(row, "name"), [(real(row, m, "rms"), real(row, m, "nrmse")) for m in models])
        for row in _pairs(result)
    ]
    return error_bars(errors, unit, _CURVES, "Prediction error per joint on the hold-out")


def _joint_table(result: Result, unit: str, changed: bool) -> Table | None:
    models = [("Given", "simulation"), ("Extended", "extended")][: 1 + changed]
    cutoff = real(result, "cutoff_hz")
    same = "" if cutoff is None else f", all after the same filter ({quantity(cutoff, 'Hz')})"
    measures = (
        (f"rms [{unit}]", "rms", number),
        ("nrmse", "nrmse", percent),
        ("r²", "r2", number4),
    )
    return table(
        _pairs(result),
        [
            ("name:Joint", "name"),
            *(
                (f"number:{label}, {heading}", f"{model}.{key}", write)
                for heading, key, write in measures
                for label, model in models
            ),
        ],
        f"The model as given{' and with the findings added' * changed}, on the hold-out{same}; "
        "nrmse is rms over the measured torque's standard deviation.",
    )


def _unexplained(result: Result) -> list[Block | None]:
    rows = records(result, "unexplained")
    sized = any(text(row, "against_noise") for row in rows)
    noise = bool(rows) and all(text(row, "structure") == _NOISE for row in rows)
    return [
        notes(["The residual looks like noise at every joint."] if noise else [], GOOD),
        table(
            rows,
            [
                ("name:Joint", "joint"),
                ("number:Share", "share", percent),
                ("text:Against the noise", "against_noise") if sized else None,
                ("text:Structure", lambda r: text(r, "structure").removeprefix("structured: ")),
            ],
            "What everything found leaves: share of the measured torque's variance, its size "
            "against the noise while the joint moves, and what it varies with.",
            f"The residual joint by joint ({len(rows)})" if noise else "",
        ),
    ]
