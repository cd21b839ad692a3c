"""Section on what can be identified, in principle and with a given motion."""

from __future__ import annotations

from excitant.reports.chain_figure import correlation_figure
from excitant.reports.design_figures import singular_value_figure
from excitant.reports.design_section import known_facts, quality
from excitant.reports.link_sections import (
    TONES,
    correlation_table,
    direction_table,
    link_parts,
    missing_table,
)
from excitant.reports.model import (
    GOOD,
    PLAIN,
    POOR,
    Cell,
    Fact,
    Matrix,
    Notes,
    Section,
    Table,
    section,
    table,
)
from excitant.reports.reading import Result, Series, at, real, records, text, words
from excitant.reports.wording import NONE, listing, number, percent, plain, sentence, value_and_std
from excitant.robots.parameters import STANDARD


def analyze_section(result: Result, series: Series) -> Section:
    """Identifiability link by link, and how well a motion determines each parameter."""
    links = link_parts(result, series)
    return section(
        "Identifiability",
        _lead(result),
        [
            ("Key figures", [known_facts(_facts(result)), _notes(result)]),
            ("Parameters by link", [_matrix(result), None if links else _link_table(result)]),
            (
                "With the given motion",
                [
                    _excitation(result),
                    missing_table(result),
                    singular_value_figure(series),
                    _practical(result),
                ],
            ),
            (
                "What the motion shows worst",
                [direction_table(result), correlation_figure(series), correlation_table(result)],
            ),
            *links,
        ],
    )


def _facts(result: Result) -> list[Fact]:
    rows = [row for link in records(result, "links") for row in records(link, "parameters")]
    visible = [row for row in rows if text(row, "category") != "unidentifiable"]
    decided = sum(text(row, "decided_by") == "prior" for row in visible)
    hidden = len(records(result, "not_shown"))
    shown = records(result, "practical")
    total, base = (text(result, key) for key in ("standard_parameters", "base_parameters"))
    judged = any(text(row, "decided_by") for row in rows)
    return [
        Fact("Parameters", total, "of all links, and of their joints' effects"),
        Fact("Base parameters", base, "combinations that torque can show"),
        Fact("Condition number", number(at(result, "condition_number")), "with the given motion"),
        Fact("Not shown by this motion", str(hidden) if shown else NONE,
             f"of {base} base parameters", POOR if hidden else GOOD),
        Fact("Follow the prior", str(decided) if judged else NONE,
             f"of {len(visible)} that torque contains, rather than the data"),
    ]  # fmt: skip


def _notes(result: Result) -> Notes | None:
    basis, hair = text(result, "basis"), text(result, "structure", "by_a_hair")
    holds = words(result, "structure", "circumstances")
    found = [
        *([f"Holds for: {'; '.join(holds)}."] if holds else []),
        *([sentence(hair)] if hair else []),
        *([f"Standard deviations are {basis}."] if basis else []),
        *(sentence(note) for note in words(result, "notes") if note),
    ]
    return Notes(tuple(found)) if found else None


def _excitation(result: Result) -> Notes | None:
    said = text(result, "persistency", "sentence")
    if not said:
        return None
    verdict = isinstance(at(result, "persistency", "persistent"), bool)
    return Notes((sentence(f"this motion is {said}" if verdict else said),))


def _lead(result: Result) -> str:
    counts = {
        key: sum(len(words(link, key)) for link in records(result, "links"))
        for key in ("unique", "unidentifiable")
    }
    total, base = real(result, "standard_parameters"), real(result, "base_parameters")
    if total is None or base is None:
        return "What torque can and cannot show of each link."
    return (
        f"Of {total:.0f} standard parameters, {counts['unique']} can be identified one by one and "
        f"{counts['unidentifiable']} not at all; the others appear only in combinations, "
        f"{base:.0f} base parameters together."
    )


def _combined(link: Result) -> set[str]:
    found: set[str] = set()
    for row in records(link, "combined"):
        found |= set(words(row, "members"))
    return found


def _matrix(result: Result) -> Matrix | None:
    links = records(result, "links")
    combined = set().union(*(_combined(link) for link in links)) if links else set()
    rows = []
    for link in links:
        name = text(link, "link")
        unique, none = set(words(link, "unique")), set(words(link, "unidentifiable"))
        cells = []
        for short in STANDARD:
            names = {f"{name}.{short}", short}
            own = combined if f"{name}.{short}" in combined else _combined(link)
            cells.append(
                "unique"
                if names & unique
                else "none"
                if names & none
                else "combined"
                if names & own
                else ""
            )
        rows.append((name, tuple(cells)))
    if not rows:
        return None
    return Matrix(
        "Link",
        STANDARD,
        tuple(rows),
        "Each link's ten parameters: mass m [kg], first moment mc [kg·m], inertia I [kg·m²] about "
        "the joint frame; links near the base show few of theirs because they move little.",
        (
            ("unique", "identifiable by itself"),
            ("combined", "only in combination"),
            ("none", "not identifiable"),
        ),
    )


def _link_table(result: Result) -> Table | None:
    rows: list[list[Cell | str]] = []
    for link in records(result, "links"):
        name, joint = text(link, "link"), text(link, "joint")
        name += f" at {joint}" if joint not in ("", name) else ""
        found = [
            ("identifiable by itself", listing(words(link, "unique"), "")),
            *(
                ("only in combination", text(row, "expression"))
                for row in records(link, "combined")
            ),
            ("not identifiable", listing(words(link, "unidentifiable"), "")),
        ]
        for category, expression in found:
            if expression:
                rows.append([name, category, expression])
                name = ""
    if not rows:
        return None
    return table(
        "name:Link | text:Category | expression:Parameters or combination",
        rows,
        "Which combinations the torque depends on; a combination is listed with the link whose "
        "parameter leads it.",
        "Parameters and combinations of every link",
    )


def _practical(result: Result) -> Table | None:
    rows: list[list[Cell | str]] = []
    for k, row in enumerate(records(result, "practical")):
        verdict = plain(text(row, "verdict"))
        tone = TONES.get(verdict, quality(at(row, "rel_std")) if verdict else PLAIN)
        rel = Cell(percent(at(row, "rel_std")), quality(at(row, "rel_std")))
        rows.append(
            [str(k + 1), text(row, "name"), *value_and_std(at(row, "value"), at(row, "std")), rel]
        )
        rows[-1].append(Cell(verdict or NONE, tone))
    if not rows:
        return None
    return table(
        "number:No. | expression:Base parameter | number:Value (SI) | number:Std (SI) | "
        "number:Relative std | text:Verdict",
        rows,
        "How precisely this motion determines each base parameter. Relative standard deviation: "
        "● below 5\u00a0%, ◐ below 30\u00a0%, ○ above.",
        f"All {len(rows)} base parameters" if len(rows) > 12 else "",
    )
