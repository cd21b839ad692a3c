"""From a saved result to a page: which sections it has, and what comes first."""

from __future__ import annotations

from collections.abc import Callable

from excitant.exceptions import BadInput
from excitant.reports.analyze_section import analyze_section
from excitant.reports.comparison import VERB as COMPARE
from excitant.reports.comparison_section import comparison_section, run_table
from excitant.reports.design_section import check_section, design_section, known_facts
from excitant.reports.diagnose_section import diagnose_section
from excitant.reports.identify_section import identify_section
from excitant.reports.link_sections import links_folded
from excitant.reports.model import GOOD, POOR, Block, Fact, Notes, Page, Section
from excitant.reports.reading import Result, Series, at, middle, part, real, records, text, words
from excitant.reports.rehearse_section import rehearse_section
from excitant.reports.robot_section import robot_section
from excitant.reports.wording import NONE, listing, number, percent, plain, quantity

SECTIONS: dict[str, Callable[[Result, Series], Section]] = {
    "design": design_section,
    "check": check_section,
    "identify": identify_section,
    "analyze": analyze_section,
    "diagnose": diagnose_section,
    "robots": robot_section,
    "rehearse": rehearse_section,
}
_FEW = 3  # parameters of a hidden effect that are written out
VERBS = (*SECTIONS, "demo", COMPARE)


def build_page(result: Result, series: Series) -> Page:
    """The page of a result.

    Raises:
        BadInput: The result's ``verb`` is none that has a report.
    """
    verb = text(result, "verb")
    if verb not in VERBS:
        raise BadInput(f"result.json: verb '{verb}' has no report; known: {', '.join(VERBS)}")
    robot = text(result, "robot")
    if verb == "demo":
        return _demo_page(result, series, robot)
    if verb == COMPARE:
        return _comparison_page(result, series, robot)
    only = SECTIONS[verb](result, series)
    return Page(f"{only.title}: {robot}" if robot else only.title, only.lead, (), (only,))


def _demo_page(result: Result, series: Series, robot: str) -> Page:
    sections = tuple(
        links_folded(build({"robot": robot, **at(result, verb)}, part(series, verb)), result[verb])
        for verb, build in SECTIONS.items()
        if isinstance(at(result, verb), dict)
    )
    seed = text(result, "seed")
    return Page(
        f"Demonstration: {robot}" if robot else "Demonstration",
        "A virtual arm hides an effect from its model. A motion was designed for the model, run on "
        "the arm, the model identified, what can be known analysed, and what it still gets wrong "
        "diagnosed" + (f" (seed {seed})." if seed else "."),
        tuple(_demo_summary(result)),
        sections,
    )


def _comparison_page(result: Result, series: Series, robot: str) -> Page:
    of, parts = text(result, "of"), at(result, "sections")
    if of in SECTIONS:
        sections = [comparison_section(of, result, series)]
    else:
        sections = [
            comparison_section(verb, content, part(series, verb))
            for verb, content in (parts.items() if isinstance(parts, dict) else ())
            if verb in SECTIONS and isinstance(content, dict)
        ]
    runs = run_table(result)
    return Page(
        f"Comparison of two runs: {robot}" if robot else "Comparison of two runs",
        sections[0].lead if len(sections) == 1 else "What each step came to in both runs.",
        () if runs is None else (runs,),
        tuple(sections),
    )


def _demo_summary(result: Result) -> list[Block]:
    diagnosis = at(result, "diagnose")
    headline = text(diagnosis, "headline")
    facts = known_facts([_hidden(result), _verdict(result), _holdout(result), _condition(result)])
    blocks: list[Block] = [Notes((headline,), "lead")] if headline else []
    return blocks if facts is None else [*blocks, facts]


def _hidden(result: Result) -> Fact:
    effect, joint = text(result, "truth", "effect"), text(result, "truth", "joint")
    values = at(result, "truth", "parameters")
    remark = ""
    if isinstance(values, dict):
        units = _units(result)
        said = [
            f"{name} = {_with_unit(value, units.get(name, ''))}"
            for name, value in values.items()
            if isinstance(value, str) or real(value) is not None
        ]
        remark = ", ".join(said[:_FEW]) + (", …" if len(said) > _FEW else "")
    where = f" at {joint}" if joint else ""
    return Fact("Hidden effect", f"{plain(effect)}{where}" if effect else NONE, remark)


def _with_unit(value: object, unit: str) -> str:
    if isinstance(value, str):
        return value
    return quantity(value, unit) if unit else number(value)


def _units(result: Result) -> dict[str, str]:
    """Units of parameters by the last part of their names."""
    found = [p for f in records(result, "diagnose", "findings") for p in records(f, "parameters")]
    found += records(result, "identify", "parameters")
    named = {text(p, "name").rpartition(".")[2]: text(p, "unit") for p in found}
    return {name: unit for name, unit in named.items() if unit != "1"}


def _verdict(result: Result) -> Fact:
    correct = at(result, "verdict", "correct")
    effect, joints = text(result, "verdict", "effect"), words(result, "verdict", "joints")
    named = f"{plain(effect)} at {listing(joints)}" if joints else plain(effect)
    if correct is True:
        return Fact("Named by the diagnosis", "✓ yes", named, GOOD)
    if correct is False:
        return Fact("Named by the diagnosis", "✗ no", named or "nothing was named", POOR)
    return Fact("Named by the diagnosis", NONE)


def _holdout(result: Result) -> Fact:
    diagnosis, joint = at(result, "diagnose"), text(result, "truth", "joint")
    unit = text(diagnosis, "unit") or "N·m"
    label = "Hold-out error, before → after"
    for finding in records(diagnosis, "findings"):
        without, with_it = (real(finding, "holdout", f"rms_{key}") for key in ("before", "after"))
        same = text(finding, "effect") == text(result, "truth", "effect")
        if same and joint in words(finding, "joints") and with_it is not None:
            change = f"{number(without)} → {quantity(with_it, unit)}"
            return Fact(label, change, "rms without the finding and with it")
    rms = [
        next(
            (real(r, "rms") for r in records(diagnosis, m, "joints") if text(r, "name") == joint),
            None,
        )
        for m in ("simulation", "extended")
    ]
    if rms[0] is not None and rms[1] is not None:
        change = f"{number(rms[0])} → {quantity(rms[1], unit)}"
        return Fact(label, change, f"rms at {joint}")
    before, after = (
        middle(records(diagnosis, m, "joints"), "nrmse") for m in ("simulation", "extended")
    )
    if before is None or after is None:
        return Fact(label, NONE)
    change = f"{percent(before)} → {percent(after)}"
    return Fact(label, change, "nrmse, median over joints")


def _condition(result: Result) -> Fact:
    initial, final = (at(result, "design", "condition_number", key) for key in ("initial", "final"))
    if real(final) is None:
        return Fact("Condition number", NONE)
    change = number(final) if real(initial) is None else f"{number(initial)} → {number(final)}"
    return Fact("Condition number", change, "of the designed motion")
