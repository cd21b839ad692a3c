"""Section on what the model gets wrong, and what would settle open questions."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from excitant.reports import page as p
from excitant.reports import values as v
from excitant.reports.figures.error import error_bars, waterfall_figure
from excitant.reports.figures.residual import evidence_figure
from excitant.reports.figures.torque import Curves, over_holdout, torque_figure
from excitant.reports.sections.identify import (
    CUTOFF_REMARK,
    exported_table,
    fault_table,
)
from excitant.reports.values import NONE, Result, Series

_NOISE = "noise-like"  # what a diagnosis calls a residual without structure
_QUANTITIES = (
    "constant",
    "direction",
    "velocity",
    "position",
    "load",
    "reversal",
    "time",
)
_MEANING = (
    "Constant: offset. Direction of motion: dry friction. Velocity: viscous friction. Position: "
    "springs, ripple. Load: gain, load-dependent friction. Distance since the last reversal: "
    "hysteresis, backlash. Time: drift. Last, the error slower, as fast, faster than the motion."
)
_BANDS = ("slower", "motion", "faster")
_FIRST = 7  # findings in the first table
_NAMED = 3  # joints in a title
_LEADING = 3  # findings that are shown without opening a fold
_CURVES = Curves(
    "simulated",
    "extended",
    "extended model",
    "Measured torque and predictions over the hold-out, below them the residuals: where blue is "
    "flat and orange is not, the named effects are the cause.",
)
_ONE_MODEL = (
    "Measured torque and the given model's prediction over the hold-out, below them the residual: "
    "structure in it shows something that the model lacks."
)


def diagnose_section(result: Result, series: Series) -> p.Section:
    """The diagnosis: faults, findings in order of importance with evidence, what stays open."""
    unit = v.text(result, "unit") or "N·m"
    joints = [v.text(row, "name") for row in _pairs(result)]
    findings = v.records(result, "findings")
    changed = _changed(result)
    lead = v.text(result, "headline")
    said = [
        v.sentence(note)
        for note in v.words(result, "notes")
        if note and note not in lead
    ]
    curves = _CURVES if changed else replace(_CURVES, after="", caption=_ONE_MODEL)
    wrong = (
        "What is wrong with the given model" if findings else "Error of the given model"
    )
    shares = [_shares(result, left, unit) for left in (False, True)[: 1 + changed]]
    first, others = _finding_parts(findings, series, unit)
    return p.section(
        "Diagnosis",
        lead,
        [
            (
                "Key figures",
                [_facts(result), fault_table(result), *_findings(findings, unit)],
            ),
            (wrong, [*shares, *_refit(result, unit), *_forward(result, changed)]),
            ("Files of the extended model", [exported_table(result)]),
            *first,
        ],
        (("diagnosed", lead), *_told(findings)),
        [
            ("Further findings", others),
            (
                "Error step by step",
                [waterfall_figure(result) if changed else None],
            ),
            ("Error per joint", _errors(result, unit, changed)),
            (
                over_holdout(unit),
                [torque_figure(joints, series, unit, curves)],
            ),
            ("Not explained", _unexplained(result)),
            ("Notes", [p.notes(said)]),
        ],
    )


def _told(findings: list[Result]) -> list[tuple[str, str]]:
    """The first findings, a line each, where there is more than the headline."""
    said = [
        (
            f"{k}{' (undecided)' * (v.text(f, 'verdict') == 'undecided')}",
            v.text(f, "sentence"),
        )
        for k, f in enumerate(findings[:_FIRST], start=1)
    ]
    return said if len(said) > 1 else []


def _pairs(result: Result) -> list[Result]:
    found: dict[str, dict[str, object]] = {}
    for model in ("simulation", "extended"):
        for row in v.records(result, model, "joints"):
            found.setdefault(v.text(row, "name"), {"name": v.text(row, "name")})[
                model
            ] = row
    return list(found.values())


def _changed(result: Result) -> bool:
    """Whether the extended model predicts otherwise than the given one; not if nothing is named."""
    errors = [
        [v.real(r, m, "rms") for m in ("simulation", "extended")]
        for r in _pairs(result)
    ]
    return any(after is not None and after != before for before, after in errors)


def _cause(finding: Result) -> str:
    return "unknown cause" if _unknown(finding) else v.plain(v.text(finding, "effect"))


def _unknown(finding: Result) -> bool:
    return v.text(finding, "effect") == "unknown"


def _facts(result: Result) -> p.Facts | None:
    findings = v.records(result, "findings")
    faults = v.records(result, "faults")
    verdicts = [v.text(finding, "verdict") for finding in findings]
    counts = [
        f"{n} {word}" for word in dict.fromkeys(verdicts) if (n := verdicts.count(word))
    ]
    before, after = (
        v.median(v.records(result, m, "joints"), "nrmse")
        for m in ("simulation", "extended")
    )
    after = after if _changed(result) else None
    errors = v.change(before, after, v.percent)
    return p.facts(
        p.Fact(
            "Hold-out error",
            errors,
            "nrmse, median over joints",
            number=after or before,
        ),
        p.fact(
            "Findings",
            len(findings),
            v.whole,
            ", ".join(counts) or "nothing stands out",
        ),
        p.fact("Data faults", len(faults), v.whole, "", p.POOR if faults else p.GOOD),
        p.fact("Cut-off", v.at(result, "cutoff_hz"), v.unit_of("Hz"), CUTOFF_REMARK),
    )


def _findings(findings: list[Result], unit: str) -> p.Blocks:
    """The first page of findings, and those that are behind a fold."""
    found = p.numbered(findings)
    first = found[:_FIRST]
    rest = found[_FIRST:]
    more = f"{len(rest)} more finding{'s' * (len(rest) > 1)}, of less gain"
    return [_finding_table(first, unit), _finding_table(rest, unit, more)]


def _finding_table(
    findings: list[Result], unit: str, folded: str = ""
) -> p.Table | None:
    rows = [
        {**finding, "explained": None, "after": None}
        if _unknown(finding)
        else {**finding, "after": v.at(finding, "holdout", "rms_after")}
        for finding in findings
    ]
    return p.table(
        rows,
        [
            ("number:#", lambda r: v.text(r, "k")),
            ("name:Effect", _cause),
            ("name:Joints", "joints"),
            ("number:Explains", "explained", v.percent),
            (f"number:rms without it [{unit}]", "holdout.rms_before"),
            (f"number:rms with it [{unit}]", "after"),
            ("text:Verdict", _verdict),
        ],
        "What the model lacks, most important first: its share of the given model's squared error, "
        "and the hold-out error of its moving joints without and with it, with all other findings.",
        folded,
    )


def _verdict(finding: Result) -> p.Cell:
    verdict = v.text(finding, "verdict")
    return p.Cell(
        verdict or NONE, {"named": p.GOOD, "undecided": p.FAIR}.get(verdict, p.PLAIN)
    )


def _finding_parts(
    findings: list[Result], series: Series, unit: str
) -> tuple[p.Parts, p.Blocks]:
    """The leading findings and what is unknown, a part each, and the others behind their titles."""
    parts: p.Parts = []
    others: p.Blocks = []
    for k, finding in enumerate(findings):
        names = v.words(finding, "joints")
        joints = (
            v.listing(names, "") if len(names) <= _NAMED else f"{len(names)} joints"
        )
        title = f"Finding {k + 1}: {_cause(finding)}{' at ' * bool(joints)}{joints}"
        blocks: p.Blocks = [
            p.notes([_sentence(finding, unit)]),
            evidence_figure(k, finding, series, unit),
            _kinds(finding, unit),
            _parameters(finding),
            _rivals(finding),
        ]
        if k < _LEADING or _unknown(finding):
            parts.append((title, blocks))
        else:
            share = v.real(finding, "explained")
            verdict = v.text(finding, "verdict")
            aside = [v.percent(share)] * (share is not None) + [verdict] * bool(verdict)
            title += f" ({', '.join(aside)})" if aside else ""
            others.append((title, blocks))
    return parts, others


def _kinds(finding: Result, unit: str) -> p.Table | None:
    """The kinds of friction that one finding sums up."""
    return p.table(
        v.records(finding, "parts"),
        [
            ("name:Kind", lambda part: v.plain(v.text(part, "effect"))),
            ("name:Joints", "joints"),
            ("number:Explains", "explained", v.percent),
            (f"number:rms without it [{unit}]", "holdout.rms_before"),
            (f"number:rms with it [{unit}]", "holdout.rms_after"),
            ("text:Verdict", _verdict),
            ("text:Looks the same", _lookalikes),
        ],
        "Its kinds; which of them it is, is less certain than that there is friction.",
    )


def _lookalikes(part: Result) -> str:
    names = [v.plain(v.text(rival, "effect")) for rival in v.records(part, "rivals")]
    return v.listing(list(dict.fromkeys(names)))


def _sentence(finding: Result, unit: str) -> str:
    told = v.text(finding, "sentence")
    if _unknown(finding):
        structure = v.text(finding, "structure").removeprefix("structured: ")
        said = "Structure is left over that no candidate explains"
        return told or (f"{said}: it {structure}." if structure else f"{said}.")
    before, after = (
        v.real(finding, "holdout", f"rms_{key}") for key in ("before", "after")
    )
    unit = v.text(finding, "unit") or unit
    effect = _cause(finding)
    share = v.real(finding, "explained")
    said = f"{effect[:1].upper()}{effect[1:]} was found."
    if before is not None and after is not None:
        where = "these joints" if len(v.words(finding, "joints")) > 1 else "this joint"
        said = (
            f"Without it, everything else that was found being kept, the rms on the hold-out at "
            f"{where} is {v.quantity(before, unit)} instead of {v.quantity(after, unit)}."
        )
    if share is not None:
        said += f" That is {v.percent(share)} of the squared error that the given model leaves"
        said += ": other findings depend on it." if share > 1 else "."
    said = f"{told}. {said}" if told else said
    if reason := v.text(finding, "doubt"):
        said += f" It is not decided: {reason}."
    elif v.text(finding, "verdict") == "undecided":
        said += " It is not decided: the effects below explain these data as well."
    return said


def _parameters(finding: Result) -> p.Table | None:
    rows = v.records(finding, "parameters")
    given = any(v.real(row, "given") is not None for row in rows)
    fixed = any(v.real(row, "std") is None for row in rows)
    return p.table(
        rows,
        [
            ("name:Parameter", "name"),
            ("number:Given", "given") if given else None,
            *p.estimates("number:Fitted"),
            (
                "text:Unit",
                "unit",
                lambda u: "" if u in (None, "1") else u.replace("^a", "ᵃ"),
            ),
        ],
        f"{'Value in the given model, and f' if given else 'F'}itted value with its standard "
        "deviation" + (" (a dash: chosen from a grid, or held)." if fixed else "."),
        p.folded(f"All {len(rows)} fitted parameters", len(rows)),
    )


def _rivals(finding: Result) -> p.Table | None:
    rows = v.records(finding, "rivals")
    # an experiment's sentence may already hold what separation and repetitions say
    said = all(
        v.real(r, "separation") is None or "separates by" in v.text(r, "experiment")
        for r in rows
    )
    return p.table(
        rows,
        [
            ("name:Rival", "effect", lambda effect: v.plain(effect or "")),
            ("name:Joints", "joints"),
            ("text:Why it cannot be excluded", "why"),
            ("text:Experiment that settles it", "experiment"),
            None if said else ("number:Separation [σ]", "separation"),
            None if said else ("number:Runs", "repetitions", v.whole),
        ],
        "Other effects that look alike in these data, and the experiment that separates them by so "
        "many standard deviations of the noise in so many runs. |cos| is 1 where both torques are "
        "proportional.",
    )


def _shares(result: Result, left: bool, unit: str) -> p.Table | None:
    rows = [
        {"joint": v.text(row, "name"), **((v.at(row, "left") or {}) if left else row)}
        for row in v.records(result, "error", "joints")
    ]

    def share(group: str, key: str) -> p.Column:
        def cell(row: Result) -> p.Cell:
            x = v.real(row, group, key)
            return p.Cell(
                v.percent(x), p.POOR if v.text(row, "telling") == key else p.PLAIN, x
            )

        return f"number:{key}", cell

    return p.table(
        rows,
        [
            ("name:Joint", "joint"),
            (f"number:rms [{unit}]", "rms"),
            *(share("shares", key) for key in _QUANTITIES),
            *(share("bands", key) for key in _BANDS),
        ],
        f"Error {'left by the extended model' if left else 'of the model as given'} while the "
        "joint moves, and the shares of its square that go with one quantity (they overlap): "
        f"○ marks the simplest that explains it. {'' if left else _MEANING}",
        "What the extended model leaves, joint by joint" if left else "",
    )


def _refit(result: Result, unit: str) -> p.Blocks:

    def deviations(key: str) -> p.Column:
        return ("number:in std", f"deviations.{key}", lambda x: v.number(x, 2))

    def inertia(row: Result) -> p.Cell:
        factor = v.real(row, "inertia")
        share = None if factor is None else 100 * float(np.expm1(factor))
        return p.Cell(v.number(share, 2), p.PLAIN, share)

    models = {"given": "Given", "inertias": "Inertias free", "bodies": "Nearest bodies"}
    models["extended"] = "With the findings"
    errors = p.table(
        v.records(result, "refit", "joints"),
        [
            ("name:Joint", "name"),
            *((f"number:{name}, rms [{unit}]", key) for key, name in models.items()),
        ],
        "What inertias alone would explain on the hold-out while joints move, all given effects "
        "being kept: fitted freely, and as the closest physically consistent inertias.",
        "What re-fitting the inertias alone would bring, joint by joint",
    )
    links = p.table(
        v.records(result, "refit", "links"),
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
    return [p.notes(v.words(result, "refit", "sentence")), errors, links]


def _forward(result: Result, changed: bool) -> p.Blocks:
    rows = v.records(result, "forward", "joints")
    units = v.listing(list(dict.fromkeys(v.text(row, "unit") for row in rows)))
    count, length = (v.real(result, "forward", key) for key in ("windows", "window_s"))
    loop = v.quantity(v.at(result, "forward", "bandwidth_hz"), "Hz", 1)
    models = ("given", "extended") if changed else ("given",)
    worse = [
        v.text(row, "name")
        for row in rows
        if (given := v.real(row, "given")) is not None
        and (v.real(row, "extended") or float("inf")) > given
    ]
    closer = " The extended model stays closer on every joint."
    if worse:
        closer = f" The extended model is no closer at {v.listing(worse)}."

    milli = partial(p.milli, none="diverges")
    table = p.table(
        rows,
        [
            ("name:Joint", "name"),
            *((f"number:Position, {m} [m{units}]", milli(m)) for m in models),
            *(
                (f"number:Velocity, {m} [m{units}/s]", milli("velocity", m))
                for m in models
            ),
        ],
        f"Simulated forward under the recorded torque over {count or 0:.0f} windows of "
        f"{v.quantity(length, 's', 2)} of the hold-out: rms by which the model leaves the recorded "
        f"motion, held on it by {'the same' if changed else 'a'} loop of {loop}."
        f"{closer if changed else ''}",
        "How far the simulated motion leaves the recorded one",
    )
    return [table, p.notes(v.words(result, "forward", "notes"))]


def _errors(result: Result, unit: str, changed: bool) -> p.Blocks:
    pairs = _pairs(result)
    what = "Prediction error per joint on the hold-out"
    models = [("Given", "simulation"), ("Extended", "extended")][: 1 + changed]
    cutoff = v.real(result, "cutoff_hz")
    same = (
        ""
        if cutoff is None
        else f", all after the same filter ({v.quantity(cutoff, 'Hz')})"
    )
    measures = ((f"rms [{unit}]", "rms", v.number), ("nrmse", "nrmse", v.percent))
    table = p.table(
        pairs,
        [
            ("name:Joint", "name"),
            *(
                (f"number:{label}, {heading}", f"{model}.{key}", write)
                for heading, key, write in (*measures, ("r²", "r2", v.number4))
                for label, model in models
            ),
        ],
        f"The model as given{' and with the findings added' * changed}, on the hold-out{same}; "
        "nrmse is rms over the measured torque's standard deviation.",
    )
    return [
        error_bars(pairs, [m for _, m in models], unit, _CURVES.after_label, what),
        table,
    ]


def _unexplained(result: Result) -> p.Blocks:
    rows = v.records(result, "unexplained")
    sized = any(v.text(row, "against_noise") for row in rows)
    noise = bool(rows) and all(v.text(row, "structure") == _NOISE for row in rows)
    return [
        p.notes(["The residual looks like noise at every joint."] * noise, p.GOOD),
        p.table(
            rows,
            [
                ("name:Joint", "joint"),
                ("number:Share", "share", v.percent),
                ("text:Against the noise", "against_noise") if sized else None,
                (
                    "text:Structure",
                    lambda r: v.text(r, "structure").removeprefix("structured: "),
                ),
            ],
            "What everything found leaves: share of the measured torque's variance, its size "
            "against the noise while the joint moves, and what it varies with.",
            f"The residual joint by joint ({len(rows)})" if noise else "",
        ),
    ]
