"""Plain-text summary of a result: one line per value, so that two runs compare with ``diff``.

The layout follows the fit reports of lmfit. Numbers have fixed width, and neither durations of
the computation nor paths are written: a line changes only when what it says has changed.
"""

from __future__ import annotations

from collections.abc import Callable

from excitant.reports.comparison_summary import comparison_lines
from excitant.reports.plain_text import (
    FIGURE,
    Cells,
    fields,
    figure,
    numbers_first,
    one_line,
    sentences,
    table,
)
from excitant.reports.reading import Result, at, real, records, text, words, worst_points
from excitant.reports.rehearse_section import rehearse_lines
from excitant.reports.robot_section import robot_lines
from excitant.reports.wording import combination


def summarize(result: Result) -> str:
    """Summary of a result as text with a final newline; null and missing values are ``-``."""
    verb = text(result, "verb")
    lines = fields(f"excitant {verb}".rstrip(), result, ("robot",))
    if verb == "demo":
        lines += fields("hidden", at(result, "truth"), ("effect", "joint"))
        lines += _parameters(at(result, "truth", "parameters"))
        lines += fields("verdict", at(result, "verdict"), ("effect", "joints", "correct"))
        for name, write in _WRITERS.items():
            if at(result, name) is not None:
                lines += ["", f"[[{name}]]", *write(at(result, name))]
    elif verb in _WRITERS:
        lines += _WRITERS[verb](result)
    return "\n".join(line.rstrip() for line in lines) + "\n"


def _parameters(values: object) -> list[str]:
    if not isinstance(values, dict):
        return []
    return fields("", values, tuple(map(str, values)))


def _limits(result: Result) -> list[str]:
    rows: list[Cells] = [
        (point.quantity, point.ratio, point.t, point.joint or "-") for point in worst_points(result)
    ]
    return table("limits: worst ratio", ("quantity", "ratio", "t [s]", "joint"), rows)


def _design(result: Result) -> list[str]:
    keys = (
        "duration",
        "harmonics",
        "columns",
        "criterion",
        "base_parameters",
        "condition_number.initial",
        "condition_number.final",
        "condition_number.lower_bound",
        "condition_number_scaled.initial",
        "condition_number_scaled.final",
        "clearance_m",
        "iterations",
    )
    starts: list[Cells] = [
        (
            text(s, "start") or str(k),
            real(s, "condition_number"),
            real(s, "iterations"),
            text(s, "status"),
        )
        for k, s in enumerate(records(result, "starts"))
    ]
    return [
        *fields("", result, keys),
        *_limits(result),
        *_weakest(result),
        *table("starts", ("start", "condition", "iterations", "status"), starts),
    ]


def _weakest(result: Result) -> list[str]:
    """What a design shows worst: torque per unit before and after, of parameters and directions."""
    heads = ("initial", "final")
    parameters: list[Cells] = [
        (text(row, "expression"), *(real(row, f"information_{key}") for key in heads))
        for row in records(result, "weakest")
    ]
    directions: list[Cells] = [
        (combination(row), real(row, "other"), real(row, "strength"))
        for row in records(result, "weak_directions", "final")
    ]
    return [
        *numbers_first("weakest base parameters: torque per unit [N.m]", heads, parameters),
        *numbers_first("weakest directions: torque per unit [N.m]", heads, directions),
    ]


def _check(result: Result) -> list[str]:
    return [
        *fields("", result, ("trajectory", "holds", "condition_number", "clearance_m")),
        *_limits(result),
        *sentences("verdicts", words(result, "verdicts")),
    ]


def _identify(result: Result) -> list[str]:
    lines = fields("", result, ("estimator", "effects", "cutoff_hz", "unit", "holdout"))
    rows = records(result, "joints")
    for name, title in (
        ("baseline", "model as given"),
        ("train", "fitted data"),
        ("validate", "hold-out"),
    ):
        accuracy: list[Cells] = [
            (
                text(row, "name"),
                *(real(row, name, key) for key in ("rms", "rms_raw", "nrmse", "r2")),
            )
            for row in rows
            if at(row, name) is not None
        ]
        lines += table(f"error: {title}", ("joint", "rms", "rms_raw", "nrmse", "r2"), accuracy)
    base: list[Cells] = [
        (text(row, "expression"), *(real(row, key) for key in ("value", "std", "rel_std")))
        for row in records(result, "base_parameters")
    ]
    # expressions are long: numbers come first, so that columns stay put
    lines += numbers_first("base parameters", ("value", "std", "rel_std"), base)
    parameters: list[Cells] = [
        (
            text(row, "name"),
            real(row, "value"),
            real(row, "std"),
            text(row, "unit") or "-",
            text(row, "category") or "-",
            "prior" if at(row, "prior_dominated") is True else "data",
        )
        for row in records(result, "parameters")
    ]
    heads = ("parameter", "value", "std", "unit", "category", "from")
    lines += table("parameters", heads, parameters)
    lines += fields("physical consistency", at(result, "physical"), ("consistent",))
    lines += [f"    {one_line(each)}" for each in words(result, "physical", "violations")]
    return lines + sentences("notes", words(result, "notes"))


def _analyze(result: Result) -> list[str]:
    lines = fields("", result, ("standard_parameters", "base_parameters", "condition_number"))
    for link in records(result, "links"):
        title = text(link, "link") + (f" ({text(link, 'joint')})" if text(link, "joint") else "")
        lines.append(f"[[{one_line(title)}]]")
        lines += [f"    unique          {name}" for name in words(link, "unique")]
        lines += [
            f"    combined        {one_line(text(c, 'expression'))}"
            for c in records(link, "combined")
        ]
        lines += [f"    unidentifiable  {name}" for name in words(link, "unidentifiable")]
    practical: list[Cells] = [
        (text(row, "name"), real(row, "std"), real(row, "rel_std"), text(row, "verdict") or "-")
        for row in records(result, "practical")
    ]
    heads = ("std", "rel_std", "verdict")
    lines += numbers_first("with the given motion", heads, practical)
    return lines + sentences("notes", words(result, "notes"))


def _diagnose(result: Result) -> list[str]:
    lines = fields("", result, ("headline", "unit", "cutoff_hz"))
    faults: list[Cells] = [
        (f"{text(f, 'fault')} at {', '.join(words(f, 'joints')) or '-'}: {text(f, 'detail')}",)
        for f in records(result, "faults")
    ]
    lines += table("data faults", ("fault",), faults)
    for name, title in (("simulation", "model as given"), ("extended", "extended model")):
        accuracy: list[Cells] = [
            (text(row, "name"), *(real(row, key) for key in ("rms", "nrmse", "r2")))
            for row in records(result, name, "joints")
        ]
        lines += table(f"hold-out error: {title}", ("joint", "rms", "nrmse", "r2"), accuracy)
    for k, finding in enumerate(records(result, "findings")):
        lines += _finding(k, finding)
    rest: list[Cells] = [
        (text(row, "joint"), real(row, "share"), text(row, "structure") or "-")
        for row in records(result, "unexplained")
    ]
    lines += table("not explained", ("joint", "share", "structure"), rest)
    steps: list[Cells] = [
        (text(row, "label"), real(row, "rms")) for row in records(result, "waterfall")
    ]
    lines += table("hold-out error step by step", ("model", "rms"), steps)
    return lines + sentences("notes", words(result, "notes"))


def _finding(index: int, finding: Result) -> list[str]:
    keys = ("joints", "verdict", "explained", "holdout.rms_before", "holdout.rms_after")
    lines = fields(f"finding {index + 1}: {one_line(text(finding, 'effect'))}", finding, keys)
    rows = records(finding, "parameters")
    wide = max(32, *(len(text(row, "name")) for row in rows), 0)
    for row in rows:
        value, std = figure(real(row, "value")), figure(real(row, "std"))
        name = one_line(text(row, "name"))
        lines.append(
            f"    {name:<{wide}} = {value:>{FIGURE}} +/- {std:>{FIGURE}} {text(row, 'unit')}"
        )
    for rival in records(finding, "rivals"):
        what = f"{text(rival, 'effect')} at {', '.join(words(rival, 'joints')) or '-'}"
        lines.append(f"    rival: {one_line(what)}: {one_line(text(rival, 'why'))}")
        if text(rival, "experiment"):
            lines.append(f"        experiment: {one_line(text(rival, 'experiment'))}")
    return lines


_WRITERS: dict[str, Callable[[Result], list[str]]] = {
    "design": _design,
    "check": _check,
    "identify": _identify,
    "analyze": _analyze,
    "diagnose": _diagnose,
    "robots": robot_lines,
    "rehearse": rehearse_lines,
    "compare": comparison_lines,
}
