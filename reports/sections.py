"""From a saved result to a page: which sections it has, and what comes first."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from excitant.exceptions import BadInput
from excitant.reports import page as p
from excitant.reports import values as v
from excitant.reports.analyze import analyze_section, links_folded
from excitant.reports.design import check_section, design_section, rehearse_section
from excitant.reports.diagnose import diagnose_section
from excitant.reports.drawing import style
from excitant.reports.identify import identify_section
from excitant.reports.page import (
    GOOD,
    POOR,
    Block,
    Cell,
    Fact,
    Notes,
    Page,
    Section,
    Table,
    facts,
    notes,
)
from excitant.reports.robot import robot_section
from excitant.reports.values import NONE, Result, Series

_SECTIONS: dict[str, Callable[[Result, Series], Section]] = {
    "design": design_section,
    "check": check_section,
    "identify": identify_section,
    "analyze": analyze_section,
    "diagnose": diagnose_section,
    "robots": robot_section,
    "rehearse": rehearse_section,
}
COMPARE = "compare"
NAMES = "ABCDEFGHIJKLMNOPQRSTUVWXYZ"
APART = 2.0  # standard deviations of a difference from which on estimates disagree
_LONG = 60  # rows from which on a table is folded
_HEADINGS = (("difference", "{} − A"), ("ratio", "{} / A"), ("deviations", "{} − A [std]"))
_VERBS = (*_SECTIONS, "demo", COMPARE)
_FEW = 3  # parameters of a hidden effect that are written out


def page_of(result: Result, series: Series) -> Page:
    """The page of a result.

    Args:
        result: Content of ``result.json``; the page leaves out what it lacks.
        series: Content of ``series.npz``; without it, the page has no curves.

    Raises:
        BadInput: The result's ``verb`` is none that has a report.
    """
    verb = v.text(result, "verb")
    if verb not in _VERBS:
        raise BadInput(f"result.json: verb '{verb}' has no report; known: {', '.join(_VERBS)}")
    with style():
        if verb == "demo":
            return _demo_page(result, series)
        if verb == COMPARE:
            return _comparison_page(result)
        only, robot = _SECTIONS[verb](result, series), v.text(result, "robot")
    return Page(f"{only.title}: {robot}" if robot else only.title, only.lead, (), (only,))


def _demo_page(result: Result, series: Series) -> Page:
    robot, seed = v.text(result, "robot"), v.text(result, "seed")
    sections = tuple(
        links_folded(
            build({"robot": robot, **v.at(result, verb)}, v.part(series, verb)), result[verb]
        )
        for verb, build in _SECTIONS.items()
        if isinstance(v.at(result, verb), dict)
    )
    headline = v.text(result, "diagnose", "headline")
    hidden, named = _hidden(result), v.at(result, "verdict", "correct") is True
    blocks: list[Block | None] = [
        notes([headline] if headline else [], "lead"),
        facts(hidden, _verdict(result), _holdout(result), _condition(result)),
    ]
    return Page(
        f"Demonstration: {robot}" if robot else "Demonstration",
        "A virtual arm hides an effect from its model. A motion was designed for the model and run "
        "on the arm, the model was identified and its identifiability analysed, and what it still "
        "gets wrong was diagnosed" + (f" (seed {seed})." if seed else "."),
        tuple(block for block in blocks if block is not None),
        sections,
        (("hidden", f"{hidden.value} (seed {seed}): {'' if named else 'not '}named"),),
    )


def _hidden(result: Result) -> Fact:
    effect, joint = v.plain(v.text(result, "truth", "effect")), v.text(result, "truth", "joint")
    values, units = v.at(result, "truth", "parameters"), _units(result)
    said = [
        f"{name} = {value if isinstance(value, str) else v.quantity(value, units.get(name, ''))}"
        for name, value in (values.items() if isinstance(values, dict) else ())
        if isinstance(value, str) or v.real(value) is not None
    ]
    remark = ", ".join(said[:_FEW]) + (", …" if len(said) > _FEW else "")
    return Fact("Hidden effect", f"{effect}{' at ' * bool(joint)}{joint}", remark)


def _units(result: Result) -> dict[str, str]:
    """Units of parameters by the last part of their names."""
    found = [
        row for f in v.records(result, "diagnose", "findings") for row in v.records(f, "parameters")
    ]
    found += v.records(result, "identify", "parameters")
    named = {v.text(row, "name").rpartition(".")[2]: v.text(row, "unit") for row in found}
    return {name: unit for name, unit in named.items() if unit != "1"}


def _verdict(result: Result) -> Fact:
    correct, label = v.at(result, "verdict", "correct"), "Named by the diagnosis"
    joints, effect = (
        v.words(result, "verdict", "joints"),
        v.plain(v.text(result, "verdict", "effect")),
    )
    named = f"{effect} at {v.listing(joints)}" if joints else effect
    if not isinstance(correct, bool):
        return Fact(label, NONE)
    if correct:
        return Fact(label, "✓ yes", named, GOOD)
    return Fact(label, "✗ no", named or "nothing was named", POOR)


def _holdout(result: Result) -> Fact:
    """Error of the hidden effect's joint without and with it, else of all joints."""
    diagnosis, joint = v.at(result, "diagnose"), v.text(result, "truth", "joint")
    unit, label = v.text(diagnosis, "unit") or "N·m", "Hold-out error, before → after"
    found = [
        (v.at(finding, "holdout", "rms_before"), v.at(finding, "holdout", "rms_after"))
        for finding in v.records(diagnosis, "findings")
        if v.text(finding, "effect") == v.text(result, "truth", "effect")
        and joint in v.words(finding, "joints")
        and v.real(finding, "holdout", "rms_after") is not None
    ]
    if found:
        without, with_it = found[0]
        change_ = f"{v.number(without)} → {v.quantity(with_it, unit)}"
        return Fact(label, change_, "rms without the finding and with it")
    before, after = (
        v.median(v.records(diagnosis, model, "joints"), "nrmse")
        for model in ("simulation", "extended")
    )
    return Fact(label, v.change(before, after, v.percent), "nrmse, median over joints")


def _condition(result: Result) -> Fact:
    ends = [v.at(result, "design", "condition_number", key) for key in ("initial", "final")]
    return Fact("Condition number", v.change(*ends), "of the designed motion")


def _comparison_page(result: Result) -> Page:
    """Page of a comparison, from its saved result."""
    runs, remarks = v.records(result, "runs"), v.words(result, "remarks")
    letters = list(NAMES[: len(runs)])
    legend = [
        f"{letter}: {v.text(run, 'name')}. {' '.join(v.words(run, 'leads'))}"
        for letter, run in zip(letters, runs, strict=True)
    ]
    sections = [
        p.section(
            v.text(each, "title"),
            _count(each),
            [(v.text(t, "part"), [_table(t, letters)]) for t in v.records(each, "tables")],
            ((v.text(each, "title"), _count(each)),),
        )
        for each in v.records(result, "sections")
    ]
    robot, name = v.text(result, "robot"), "Comparison of runs"
    blocks: list[Notes | None] = [
        p.notes(legend),
        p.notes([v.sentence(r) for r in remarks], "poor"),
    ]
    return Page(
        f"{name}: {robot}" if robot else name,
        f"{len(runs)} runs of excitant {v.text(result, 'of')}; differences and ratios are those to "
        f"A. {sections[0].lead if len(sections) == 1 else ''}",
        tuple(block for block in blocks if block is not None),
        tuple(sections),
        tuple(("note", remark) for remark in remarks),
    )


def _count(each: Result) -> str:
    rows = [row for part in v.records(each, "tables") for row in v.records(part, "rows")]
    differ = sum(len(set(v.words(row, "written"))) > 1 for row in rows)
    apart = [x for row in rows for x in v.at(row, "deviations") or () if v.real(x) is not None]
    said = f"{differ} of {len(rows)} figures differ."
    if apart:
        far = sum(x > APART for x in apart)
        said += (
            f" {far} of {len(apart)} estimates lie more than two standard deviations of their "
            f"difference apart; by chance about {0.0455 * len(apart):.0f} would, if the runs' data "
            "are independent."
        )
    return said


def _table(found: Result, letters: Sequence[str]) -> Table | None:
    rows, missing = v.records(found, "rows"), [None] * len(letters)

    def values(key: str, k: int) -> list[float | None]:
        return [v.real([*(v.at(row, key) or ()), *missing][k]) for row in rows]

    def cells(key: str, k: int) -> list[Cell]:
        far = [key == "deviations" and (x or 0.0) > APART for x in values(key, k)]
        return [
            Cell(v.number(x), p.POOR if f else p.PLAIN, x)
            for x, f in zip(values(key, k), far, strict=True)
        ]

    columns = [(v.text(found, "of"), "name", [Cell(v.text(row, "name")) for row in rows])]
    if any(v.text(row, "figure") for row in rows):
        columns.append(("Quantity", "name", [Cell(v.text(row, "figure")) for row in rows]))
    for k, letter in enumerate(letters):
        written = [Cell([*v.words(row, "written"), *[v.NONE] * len(letters)][k]) for row in rows]
        columns.append((letter, "number", written))
    for k, letter in enumerate(letters[1:]):
        for key, heading in _HEADINGS:
            if any(x is not None for x in values(key, k)):
                columns.append((heading.format(letter), "number", cells(key, k)))
    heads = tuple((heading, kind) for heading, kind, _ in columns)
    body = tuple(zip(*(each for _, _, each in columns), strict=True))
    return Table(heads, body, "", p.folded(f"All {len(rows)} figures", len(rows), _LONG))
