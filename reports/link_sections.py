"""What is known of one link: its place in the chain, its parameters, what would show the rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from excitant.reports.chain_figure import chain_figure
from excitant.reports.design_section import quality
from excitant.reports.model import (
    FAIR,
    GOOD,
    PLAIN,
    POOR,
    Block,
    Cell,
    Figure,
    Folded,
    Notes,
    Part,
    Section,
    Table,
    table,
)
from excitant.reports.reading import Result, Series, at, real, records, text, words
from excitant.reports.wording import NONE, listing, number, percent, plain, value_and_std
from excitant.robots.parameters import STANDARD

TONES = {"well": GOOD, "roughly": FAIR, "negligible": GOOD, "hardly": POOR, "not shown": POOR}
_DECIDES = {"data": ("data", GOOD), "prior": ("prior", POOR), "physics": ("limit of physics", FAIR)}
_CATEGORY = {
    "unique": "by\u00a0itself",
    "combined": "in\u00a0combination",
    "unidentifiable": "not\u00a0at\u00a0all",
}


def link_parts(result: Result, series: Series) -> list[tuple[str, list[Block | None]]]:
    """One part for each link that lists its parameters."""
    links = records(result, "links")
    return [
        (_title(link), _blocks(result, series, link, k, len(links)))
        for k, link in enumerate(links)
        if records(link, "parameters")
    ]


def links_folded(found: Section, result: Result) -> Section:
    """A section whose links stand in one part, each behind a line until it is opened."""
    titles = {_title(link) for link in records(result, "links")}
    links = [each for each in found.parts if each.title in titles]
    if not links:
        return found
    folded = Part("Link by link", tuple(Folded(each.title, each.blocks) for each in links))
    others = tuple(each for each in found.parts if each.title not in titles)
    return replace(found, parts=(*others, folded))


def _title(link: Result) -> str:
    name, joint = text(link, "link"), text(link, "joint")
    return f"{name} at {joint}" if joint not in ("", name) else name


def _blocks(
    result: Result, series: Series, link: Result, index: int, count: int
) -> list[Block | None]:
    return [
        _place(series, link, index, count),
        _parameters(link),
        _combinations(result, link),
        _needed(link),
        _following(result, link),
    ]


def _place(series: Series, link: Result, index: int, count: int) -> Figure | None:
    inertial = [row for row in records(link, "parameters") if _symbol(row) in STANDARD]
    of = {
        category: sum(text(row, "category") == category for row in inertial)
        for category in _CATEGORY
    }
    mass = next((number(at(row, "value")) for row in inertial if _symbol(row) == "m"), NONE)
    caption = (
        f"Link {index + 1} of {count}" + (f", {mass}\u00a0kg" if mass != NONE else "") + ". "
        f"Of its ten parameters torque shows {of['unique']} by themselves, {of['combined']} only "
        f"in combination and {of['unidentifiable']} not at all."
    )
    return chain_figure(series, index, text(link, "link"), caption)


def _symbol(row: Result) -> str:
    return text(row, "name").rpartition(".")[2]


def _parameters(link: Result) -> Table | None:
    """The table of parameters; columns that nothing is known for are left out."""
    rows = records(link, "parameters")
    motion = any(real(row, "std") is not None for row in rows)
    influence = any(real(row, "prior_influence") is not None for row in rows)
    lines: list[list[Cell | str]] = []
    for row in rows:
        value, std = (
            value_and_std(at(row, "value"), at(row, "std"))
            if motion
            else (number(at(row, "value"), 4), "")
        )
        line: list[Cell | str] = [
            _symbol(row),
            f"{value} ± {std}" if motion and std != NONE else value,
            text(row, "unit"),
            Cell(_CATEGORY.get(text(row, "category"), NONE), _category_tone(row)),
        ]
        if motion:
            line += [_determined(row), number(at(row, "prior"))]
        if influence:
            line += [_share(row), _decided(row)]
        lines.append(line)
    if not lines:
        return None
    heads = "text:Parameter | number:Value | text:Unit | text:Torque shows it"
    if motion:
        heads += " | text:This motion determines it | number:Prior"
    if influence:
        heads += " | number:Follows prior | text:Decided by"
    return table(heads, lines, _explanation(motion, influence))


def _explanation(motion: bool, influence: bool) -> str:
    sentence = "Inertia about the joint's frame; friction, offset and rotor inertia of its joint."
    if motion:
        sentence += (
            " Value ± standard deviation, with the prior of ±100\u00a0% of the link counted in."
        )
    if influence:
        sentence += (
            " Follows prior: how far the value moves when its prior is moved, from 0, the data "
            "decide, to 1, the prior alone does."
        )
    return sentence


def _category_tone(row: Result) -> str:
    tones = {"unique": GOOD, "combined": FAIR, "unidentifiable": POOR}
    return tones.get(text(row, "category"), PLAIN)


def _determined(row: Result) -> Cell:
    if text(row, "category") != "unique":
        return Cell(NONE)
    word = plain(text(row, "verdict"))
    value, std = real(row, "value"), real(row, "std_data")
    share = f", ±{percent(std / abs(value))}" if value and std and word != "negligible" else ""
    return Cell(word + share if word else NONE, TONES.get(word, PLAIN))


def _share(row: Result) -> str:
    influence = real(row, "prior_influence")
    return NONE if influence is None else f"{influence:.2f}"


def _decided(row: Result) -> Cell:
    if text(row, "category") == "unidentifiable":
        return Cell("prior", POOR)
    return Cell(*_DECIDES.get(text(row, "decided_by"), (NONE, PLAIN)))


def _combinations(result: Result, link: Result) -> Table | None:
    """The combinations that its parameters are part of, with what the motion says of them."""
    known = {text(row, "name"): row for row in records(result, "practical")}
    rows: list[list[Cell | str]] = []
    for found in records(link, "combined"):
        expression = text(found, "expression")
        if not known:
            rows.append([expression])
            continue
        row = known.get(expression, {})
        value, std = value_and_std(at(row, "value"), at(row, "std"))
        word = plain(text(row, "verdict"))
        tone = TONES.get(word, quality(at(row, "rel_std")))
        rows.append([expression, value, std, Cell(word or NONE, tone)])
    if not rows:
        return None
    heads = "expression:Combination that torque shows"
    if known:
        heads += " | number:Value | number:Std | text:Determined"
    note = "Torque depends on these sums alone; how they divide among their members does not show."
    return table(heads, rows, note, f"Its {len(rows)} combinations" if len(rows) > 1 else "")


def _needed(link: Result) -> Table | None:
    """What would show each parameter by itself, those with the same answer together."""
    groups: dict[str, list[str]] = {}
    for row in records(link, "parameters"):
        if text(row, "needed"):
            groups.setdefault(text(row, "needed"), []).append(_symbol(row))
    if not groups:
        return None
    rows: list[list[Cell | str]] = [[listing(names, ""), what] for what, names in groups.items()]
    return table(
        "name:To see by itself | text:This is needed",
        rows,
        "Found by adding each experiment's rows and looking at rank and standard deviation again.",
    )


def _following(result: Result, link: Result) -> Notes | None:
    """Which parameters would follow from one that is known from elsewhere."""
    groups = result.get("follow_each_other")
    own = {text(row, "name") for row in records(link, "parameters")}
    found = [
        f"Once one of {', '.join(group)} is known from elsewhere, the data give the rest of them."
        for group in (words(each) for each in (groups if isinstance(groups, list) else []))
        if own & set(group)
    ]
    return Notes(tuple(found)) if found else None


def direction_table(result: Result) -> Table | None:
    """Directions that the motion does not see, and those it sees worst."""
    rows: list[list[Cell | str]] = []
    for row in records(result, "directions"):
        rel = real(row, "rel_std")
        cell = Cell("not seen", POOR) if rel is None else Cell(percent(rel), quality(rel))
        rows.append([text(row, "expression"), cell, text(row, "meaning")])
    if not rows:
        return None
    return table(
        "expression:Direction | number:Std relative to prior | text:What it means",
        rows,
        "Combinations of base parameters, each named by its first member, that this motion shows "
        "worst; above 100\u00a0% the data say less than the prior.",
    )


def correlation_table(result: Result) -> Table | None:
    """Pairs of base parameters whose estimates are most correlated."""
    names = [text(row, "name") for row in records(result, "practical")]
    numbers = {_lead(name): str(k + 1) for k, name in enumerate(names)}
    rows: list[list[Cell | str]] = []
    for row in records(result, "correlations"):
        pair = (text(row, "first"), text(row, "second"))
        size = abs(real(row, "correlation") or 0.0)
        tone = POOR if size > 0.95 else FAIR if size > 0.8 else GOOD
        rho = Cell(number(at(row, "correlation")), tone)
        rows.append([*(_numbered(name, numbers) for name in pair), rho])
    if not rows:
        return None
    return table(
        "name:Base parameter | name:goes with | number:Correlation",
        rows,
        "The most correlated pairs, each base parameter named by its first member.",
    )


def _lead(expression: str) -> str:
    return expression.split(" ")[0]


def _numbered(name: str, numbers: dict[str, str]) -> str:
    return f"{numbers[name]}: {name}" if name in numbers else name


def missing_table(result: Result) -> Table | None:
    """Base parameters that the motion does not show, with what would."""
    rows: Sequence[Result] = records(result, "not_shown")
    if not rows:
        return None
    return table(
        "expression:Not shown by this motion | text:Shown by",
        [[text(row, "name"), text(row, "needed") or NONE] for row in rows],
        "These base parameters make no torque of their own in this motion: they keep their prior "
        "values"
        + (
            f"; at rest: {listing(words(result, 'resting_joints'))}."
            if words(result, "resting_joints")
            else "."
        ),
    )
