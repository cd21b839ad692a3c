"""A run in a few lines, for the terminal."""

from __future__ import annotations

from collections.abc import Callable

from excitant.reports.comparison_section import comparison_lead
from excitant.reports.reading import Result, at, middle, real, records, text, words
from excitant.reports.rehearse_section import rehearse_brief
from excitant.reports.robot_section import robot_brief
from excitant.reports.wording import number, percent, plain


def brief(result: Result) -> str:
    """What a run came to, one line per question."""
    lines = _VERBS[text(result, "verb")](result)
    return "\n".join(f"{label:<13}{words}" for label, words in lines)


Lines = list[tuple[str, str]]


def _demo(result: Result) -> Lines:
    truth = f"{plain(at(result, 'truth', 'effect'))} at {text(result, 'truth', 'joint')}"
    outcome = "named" if at(result, "verdict", "correct") else "not named"
    parts = [
        line
        for verb in ("design", "identify", "analyze", "diagnose")
        for line in _VERBS[verb](at(result, verb))
    ]
    return [*parts, ("hidden", f"{truth} (seed {at(result, 'seed')}): {outcome}")]


def _design(result: Result) -> Lines:
    before, after = (real(result, "condition_number", k) for k in ("initial", "final"))
    scaled = [real(result, "condition_number_scaled", k) for k in ("initial", "final")]
    worst = max(real(result, "limits", k) or 0.0 for k in at(result, "limits"))
    weak = [text(row, "name") for row in records(result, "weakest")[:3]]
    return [
        ("designed", f"condition number {number(before)} → {number(after)}, "
         f"limits used up to {percent(worst, 4)}"),
        *([("", f"with columns scaled {number(scaled[0])} → {number(scaled[1])}; "
            f"seen worst: {', '.join(weak)}")] if weak else []),
        *(("", note) for note in words(result, "notes")),
    ]  # fmt: skip


def _identify(result: Result) -> Lines:
    rows, unit = records(result, "joints"), text(result, "unit")
    given, found = (
        sum(real(row, kind, "rms") or 0.0 for row in rows) for kind in ("baseline", "validate")
    )
    r2 = middle(rows, "validate", "r2")
    consistent = "physically consistent" if at(result, "physical", "consistent") else "not physical"
    return [
        ("identified", f"hold-out error, sum of joints, {number(given)} → {number(found)} {unit}, "
         f"median r² {number(r2, 4)}, {consistent}"),
        ("", text(result, "holdout")),
        *_faults(result),
    ]  # fmt: skip


def _faults(result: Result) -> Lines:
    return [
        ("data fault", f"{text(fault, 'recording')}: {plain(text(fault, 'fault'))}"
         f"{' at ' if words(fault, 'joints') else ''}{', '.join(words(fault, 'joints'))}: "
         f"{text(fault, 'detail')}")
        for fault in records(result, "faults")
    ]  # fmt: skip


def _analyze(result: Result) -> Lines:
    links = records(result, "links")
    unique, hidden = (sum(len(words(k, n)) for k in links) for n in ("unique", "unidentifiable"))
    total = at(result, "standard_parameters")
    lines = [
        ("identifiable", f"{at(result, 'base_parameters')} combinations of {total} parameters; "
         f"{unique} parameters uniquely, {hidden} not at all"),
    ]  # fmt: skip
    practical = records(result, "practical")
    if practical:
        verdicts = [row.get("verdict") for row in practical]
        if weak := verdicts.count("hardly"):
            lines.append(("", f"this motion hardly shows {weak} of {len(verdicts)} combinations"))
        elif "not_shown" not in verdicts:
            lines.append(("", f"this motion shows all {len(verdicts)} combinations"))
    return [*lines, *(("", note) for note in words(result, "notes"))]


def _diagnose(result: Result) -> Lines:
    return [("diagnosed", text(result, "headline")), *_faults(result)]


def _check(result: Result) -> Lines:
    kappa = number(real(result, "condition_number"))
    return [
        *(("checked" if k == 0 else "", line) for k, line in enumerate(words(result, "verdicts"))),
        ("", f"condition number {kappa} ({text(result, 'columns')} columns)"),
    ]


def _compare(result: Result) -> Lines:
    runs = [text(run, "name") for run in records(result, "runs")]
    sections = at(result, "sections")
    parts = sections if isinstance(sections, dict) else {text(result, "of"): result}
    lines = [("compared", " and ".join(f"{s} {run}" for s, run in zip("AB", runs, strict=False)))]
    for verb, content in parts.items():
        lines.append((str(verb), comparison_lead(content)))
        lines += [("", remark) for remark in words(content, "remarks")]
    return lines


_VERBS: dict[str, Callable[[Result], Lines]] = {
    "demo": _demo,
    "design": _design,
    "identify": _identify,
    "analyze": _analyze,
    "diagnose": _diagnose,
    "check": _check,
    "robots": robot_brief,
    "rehearse": rehearse_brief,
    "compare": _compare,
}
