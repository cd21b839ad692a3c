"""Section on what can be identified: in principle, with a given motion, and link by link."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from excitant.reports import page as p
from excitant.reports import values as v
from excitant.reports.arm_figures import chain_figure
from excitant.reports.motion_figures import correlation_figure, spectrum_figure
from excitant.reports.page import (
    Brief,
    Cell,
    Column,
    Facts,
    Figure,
    Folded,
    Matrix,
    Notes,
    Part,
    Parts,
    Section,
    Table,
)
from excitant.reports.values import NONE, Result, Series
from excitant.robots.parameters import STANDARD

_TONES = {
    "well": p.GOOD,
    "roughly": p.FAIR,
    "negligible": p.GOOD,
    "hardly": p.POOR,
    "not shown": p.POOR,
}
_DECIDES = {
    "data": ("data", p.GOOD),
    "prior": ("prior", p.POOR),
    "physics": ("limit of physics", p.FAIR),
}
_CATEGORY = {
    "unique": ("by\u00a0itself", p.GOOD),
    "combined": ("in\u00a0combination", p.FAIR),
    "unidentifiable": ("not\u00a0at\u00a0all", p.POOR),
}
_LEGEND = (
    ("unique", "identifiable by itself"),
    ("combined", "only in combination"),
    ("none", "not identifiable"),
)


def analyze_section(result: Result, series: Series) -> Section:
    """Identifiability link by link, and how well a motion determines each parameter."""
    links = _links(result, series)
    said = [v.sentence(note) for note in v.words(result, "notes") if note]
    return p.section(
        "Identifiability",
        _lead(result),
        [
            ("Key figures", [_facts(result), p.notes(_basis(result)), p.notes(said, brief="")]),
            ("Parameters by link", [_matrix(result)]),
            (
                "With the given motion",
                [
                    _excitation(result),
                    _missing(result),
                    spectrum_figure(series),
                    _practical(result),
                ],
            ),
            (
                "Least determined by the motion",
                [_directions(result), correlation_figure(series), _correlations(result)],
            ),
            *links,
        ],
        _brief(result),
    )


def links_folded(found: Section, result: Result) -> Section:
    """A section whose links stand in one part, each behind a line until it is opened."""
    titles = {_title(link) for link in v.records(result, "links")}
    links = [each for each in found.parts if each.title in titles]
    if not links:
        return found
    folds = Part("Link by link", tuple(Folded(each.title, each.blocks) for each in links))
    others = tuple(each for each in found.parts if each.title not in titles)
    return replace(found, parts=(*others, folds))


def _lead(result: Result) -> str:
    unique, none = _counts(result)
    total, base = v.real(result, "standard_parameters"), v.real(result, "base_parameters")
    if total is None or base is None:
        return "What torque can and cannot show of each link."
    return (
        f"Of {total:.0f} standard parameters, {unique} can be identified one by one and "
        f"{none} not at all; the others appear only in combinations, "
        f"{base:.0f} base parameters together."
    )


def _brief(result: Result) -> Brief:
    unique, none = _counts(result)
    total, base = (v.text(result, key) for key in ("standard_parameters", "base_parameters"))
    lines = [
        (
            "identifiable",
            f"{base} combinations of {total} parameters; {unique} parameters uniquely, "
            f"{none} not at all",
        )
    ]
    verdicts = [v.text(row, "verdict") for row in v.records(result, "practical")]
    if weak := verdicts.count("hardly"):
        lines.append(("", f"this motion hardly shows {weak} of {len(verdicts)} combinations"))
    elif verdicts and "not_shown" not in verdicts:
        lines.append(("", f"this motion shows all {len(verdicts)} combinations"))
    return tuple(lines)


def _counts(result: Result) -> tuple[int, int]:
    """Parameters that can be identified one by one, and not at all."""
    links = v.records(result, "links")
    unique, none = (sum(len(v.words(k, n)) for k in links) for n in ("unique", "unidentifiable"))
    return unique, none


def _facts(result: Result) -> Facts | None:
    rows = [row for link in v.records(result, "links") for row in v.records(link, "parameters")]
    visible = [row for row in rows if v.text(row, "category") != "unidentifiable"]
    decided = sum(v.text(row, "decided_by") == "prior" for row in visible)
    hidden = len(v.records(result, "not_shown")) if v.records(result, "practical") else None
    keys = ("standard_parameters", "base_parameters", "condition_number")
    total, base, kappa = (v.real(result, key) for key in keys)
    of = f"of {v.whole(base)} base parameters"
    decisive = f"of {len(visible)} that torque contains, rather than by the data"
    judged = any(v.text(row, "decided_by") for row in rows)
    return p.facts(
        p.fact("Parameters", total, v.whole, "of all links, and of their joints' effects"),
        p.fact("Base parameters", base, v.whole, "identifiable combinations"),
        p.fact("Condition number", kappa, v.number, "with the given motion"),
        p.fact("Not shown by this motion", hidden, v.whole, of, p.POOR if hidden else p.GOOD),
        p.fact("Decided by the prior", decided if judged else None, v.whole, decisive),
    )


def _basis(result: Result) -> list[str]:
    basis, near = v.text(result, "basis"), v.text(result, "structure", "by_a_hair")
    holds = v.words(result, "structure", "circumstances")
    return [
        *([f"Holds for: {'; '.join(holds)}."] if holds else []),
        *([v.sentence(near)] if near else []),
        *([f"Standard deviations are {basis}."] if basis else []),
    ]


def _excitation(result: Result) -> Notes | None:
    said = v.text(result, "persistency", "sentence")
    verdict = isinstance(v.at(result, "persistency", "persistent"), bool)
    return p.notes([v.sentence(f"this motion is {said}" if verdict else said)] if said else [])


def _combined(link: Result) -> set[str]:
    return {name for row in v.records(link, "combined") for name in v.words(row, "members")}


def _matrix(result: Result) -> Matrix | None:
    links = v.records(result, "links")
    shared = {name for link in links for name in _combined(link)}
    rows = tuple(
        (v.text(link, "link"), tuple(_shown_as(link, symbol, shared) for symbol in STANDARD))
        for link in links
    )
    if not rows:
        return None
    return Matrix(
        "Link",
        STANDARD,
        rows,
        "Each link's ten parameters: mass m [kg], first moment mc [kg·m], inertia I [kg·m²] about "
        "the joint frame; links near the base show few of theirs because they move little.",
        _LEGEND,
    )


def _shown_as(link: Result, symbol: str, shared: set[str]) -> str:
    """How torque shows one parameter of a link, given those in combinations of any link."""
    names = {f"{v.text(link, 'link')}.{symbol}", symbol}
    if names & set(v.words(link, "unique")):
        return "unique"
    if names & set(v.words(link, "unidentifiable")):
        return "none"
    return "combined" if names & (shared | _combined(link)) else ""


def _practical(result: Result) -> Table | None:
    rows: list[Result] = [
        {"k": str(k), **row} for k, row in enumerate(v.records(result, "practical"), start=1)
    ]
    return p.table(
        rows,
        [
            ("number:No.", lambda r: v.text(r, "k")),
            ("expression:Base parameter", "name"),
            *p.estimates("number:Value (SI)", "number:± std (SI)"),
            ("number:Relative std", p.relative),
            ("text:Verdict", _determined),
        ],
        "How precisely this motion determines each base parameter. Relative standard deviation: "
        "● below 5\u00a0%, ◐ below 30\u00a0%, ○ above.",
        p.folded(f"All {len(rows)} base parameters", len(rows)),
    )


def _determined(row: Result) -> Cell:
    """The verdict on a base parameter, in the tone of its relative std where it has none."""
    verdict = v.plain(v.text(row, "verdict"))
    return Cell(verdict or NONE, _TONES.get(verdict, p.quality(v.real(row, "rel_std"))))


def _directions(result: Result) -> Table | None:
    """Directions that the motion does not show, and those it shows worst."""

    def share(row: Result) -> Cell:
        rel = v.real(row, "rel_std")
        return (
            Cell("not seen", p.POOR) if rel is None else Cell(v.percent(rel), p.quality(rel), rel)
        )

    return p.table(
        v.records(result, "directions"),
        [
            ("expression:Direction", "expression"),
            ("number:Std relative to prior", share),
            ("text:What it means", "meaning"),
        ],
        "Combinations of base parameters, each named by its first member, that this motion shows "
        "worst; above 100\u00a0% the data say less than the prior.",
    )


def _correlations(result: Result) -> Table | None:
    """Pairs of base parameters whose estimates are most correlated."""
    names = [v.text(row, "name") for row in v.records(result, "practical")]
    numbers = {name.split(" ")[0]: f"{k}: " for k, name in enumerate(names, start=1)}

    def correlation(row: Result) -> Cell:
        rho = v.real(row, "correlation")
        size = abs(rho or 0.0)
        return Cell(v.number(rho), p.POOR if size > 0.95 else p.FAIR if size > 0.8 else p.GOOD, rho)

    def numbered(key: str) -> Callable[[Result], str]:
        return lambda row: numbers.get(v.text(row, key), "") + v.text(row, key)

    return p.table(
        v.records(result, "correlations"),
        [
            ("name:Base parameter", numbered("first")),
            ("name:goes with", numbered("second")),
            ("number:Correlation", correlation),
        ],
        "The most correlated pairs, each base parameter named by its first member.",
    )


def _missing(result: Result) -> Table | None:
    """Base parameters that the motion does not show, and what would."""
    resting = v.words(result, "resting_joints")
    return p.table(
        v.records(result, "not_shown"),
        [("expression:Not shown by this motion", "name"), ("text:Shown by", "needed")],
        "These base parameters make no torque of their own in this motion: they keep their prior "
        f"values{f'; at rest: {v.listing(resting)}' if resting else ''}.",
    )


def _links(result: Result, series: Series) -> Parts:
    """One part for each link that lists its parameters."""
    links = v.records(result, "links")
    return [
        (
            _title(link),
            [
                _place(series, link, k, len(links)),
                _parameters(link),
                _combinations(result, link),
                _needed(link),
                _following(result, link),
            ],
        )
        for k, link in enumerate(links)
        if v.records(link, "parameters")
    ]


def _title(link: Result) -> str:
    name, joint = v.text(link, "link"), v.text(link, "joint")
    return f"{name} at {joint}" if joint not in ("", name) else name


def _place(series: Series, link: Result, index: int, count: int) -> Figure | None:
    inertial = [row for row in v.records(link, "parameters") if _symbol(row) in STANDARD]
    unique, combined, none = (
        sum(v.text(row, "category") == category for row in inertial) for category in _CATEGORY
    )
    mass = next((v.number(v.at(row, "value")) for row in inertial if _symbol(row) == "m"), NONE)
    caption = (
        f"Link {index + 1} of {count}" + (f", {mass}\u00a0kg" if mass != NONE else "") + ". "
        f"Of its ten parameters, {unique} are identifiable individually, {combined} only in "
        f"combination and {none} not at all."
    )
    return chain_figure(series, index, v.text(link, "link"), caption)


def _symbol(row: Result) -> str:
    return v.text(row, "name").rpartition(".")[2]


def _parameters(link: Result) -> Table | None:
    """The table of parameters; columns that nothing is known for are left out."""
    rows = v.records(link, "parameters")
    motion = any(v.real(row, "std") is not None for row in rows)
    influence = any(v.real(row, "prior_influence") is not None for row in rows)
    said = "Inertia about the joint's frame; friction, offset and rotor inertia of its joint."
    if motion:
        said += " The prior of ±100\u00a0% of the link is counted in the standard deviation."
    if influence:
        said += (
            " Follows prior: how far the value moves when its prior is moved, from 0, the data "
            "decide, to 1, the prior alone does."
        )
    value: tuple[Column, ...] = (("number:Value", "value", v.number4),)
    seen: tuple[Column, ...] = ()
    if motion:
        value = p.estimates()
        seen = (("text:This motion determines it", _shown), ("number:Prior", "prior"))
    if influence:
        seen += (
            ("number:Follows prior", "prior_influence", _hundredths),
            ("text:Decided by", _decided),
        )
    return p.table(
        rows,
        [
            ("name:Parameter", _symbol),
            *value,
            ("text:Unit", "unit"),
            ("text:Identifiable", lambda r: Cell(*_CATEGORY.get(v.text(r, "category"), (NONE,)))),
            *seen,
        ],
        said,
    )


def _shown(row: Result) -> Cell:
    if v.text(row, "category") != "unique":
        return Cell(NONE)
    word = v.plain(v.text(row, "verdict"))
    value, std = v.real(row, "value"), v.real(row, "std_data")
    share = f", ±{v.percent(std / abs(value))}" if value and std and word != "negligible" else ""
    return Cell(word + share if word else NONE, _TONES.get(word, p.PLAIN))


def _hundredths(share: object) -> str:
    return NONE if v.real(share) is None else f"{share:.2f}"


def _decided(row: Result) -> Cell:
    hidden = v.text(row, "category") == "unidentifiable"
    return Cell(*_DECIDES.get("prior" if hidden else v.text(row, "decided_by"), (NONE,)))


def _combinations(result: Result, link: Result) -> Table | None:
    """The combinations that its parameters are part of, and how well the motion shows them."""
    known = {v.text(row, "name"): row for row in v.records(result, "practical")}
    found = v.records(link, "combined")
    rows: list[Result] = [
        {"expression": v.text(row, "expression"), **known.get(v.text(row, "expression"), {})}
        for row in found
    ]
    seen: tuple[Column, ...] = (*p.estimates(), ("text:Determined", _determined)) if known else ()
    return p.table(
        rows,
        [("expression:Identifiable combination", "expression"), *seen],
        "Torque depends on these sums alone, not on how they divide among their members.",
        p.folded(f"Its {len(found)} combinations", len(found), 1),
    )


def _needed(link: Result) -> Table | None:
    """What would identify each parameter individually, those with the same answer together."""
    groups: dict[str, list[str]] = {}
    for row in v.records(link, "parameters"):
        if v.text(row, "needed"):
            groups.setdefault(v.text(row, "needed"), []).append(_symbol(row))
    rows: list[Result] = [{"names": names, "needed": what} for what, names in groups.items()]
    return p.table(
        rows,
        [("name:To identify individually", "names"), ("text:Required", "needed")],
        "Found by adding each experiment's rows and looking at rank and standard deviation again.",
    )


def _following(result: Result, link: Result) -> Notes | None:
    """Which parameters would follow from one that is known from elsewhere."""
    own = {v.text(row, "name") for row in v.records(link, "parameters")}
    groups = [v.words(group) for group in v.items(result, "follow_each_other")]
    said = "Once one of {} is known from elsewhere, the data give the rest of them."
    return p.notes([said.format(", ".join(group)) for group in groups if own & set(group)])
