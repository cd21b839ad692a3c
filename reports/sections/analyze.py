"""Section on what can be identified: in principle, with a given motion, and link by link."""

from __future__ import annotations

from dataclasses import replace

from excitant.reports import page as p
from excitant.reports import values as v
from excitant.reports.figures.search import spectrum_figure
from excitant.reports.sections.design import excitation_sentence
from excitant.reports.sections.identify import fault_table
from excitant.reports.values import NONE, Result, Series
from excitant.robots.parameters import STANDARD

_TONES = {"well": p.GOOD, "roughly": p.FAIR, "negligible": p.GOOD}
_TONES |= {"hardly": p.POOR, "not shown": p.POOR}
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


def analyze_section(result: Result, series: Series) -> p.Section:
    """Identifiability link by link, and how well a motion determines each parameter."""
    links = v.records(result, "links")
    said = [v.sentence(note) for note in v.words(result, "notes") if note]
    lead, brief = _lead_and_brief(result)
    return p.section(
        "Identifiability",
        lead,
        [
            (
                "Key figures",
                [_facts(result), p.notes(_basis(result)), p.notes(said, brief="")],
            ),
            ("Data faults", [fault_table(result)]),
            ("Parameters by link", [_matrix(links)]),
            ("Singular values", [_singular(result)]),
            ("With the given motion", _motion(result, series)),
        ],
        brief,
        [
            ("Least determined by the motion", [_weakest(result)]),
            *(
                (_title(link), _link(result, link, f"Link {k} of {len(links)}"))
                for k, link in enumerate(links, start=1)
                if v.records(link, "parameters")
            ),
        ],
    )


def links_folded(found: p.Section, result: Result) -> p.Section:
    """A section whose links stand in one part, each behind a line until it is opened."""
    titles = {_title(link) for link in v.records(result, "links")}
    folds = tuple(
        p.Folded(part.title, part.blocks)
        for part in found.parts
        if part.title in titles
    )
    others = tuple(part for part in found.parts if part.title not in titles)
    one = p.Folded("Link by link", folds, closed=True)
    return replace(found, parts=(*others, *[one] * bool(folds)))


def _lead_and_brief(result: Result) -> tuple[str, p.Brief]:
    links = v.records(result, "links")
    unique, none = (
        sum(len(v.words(k, n)) for k in links) for n in ("unique", "unidentifiable")
    )
    total = v.text(result, "standard_parameters")
    base = v.text(result, "base_parameters")
    lead = "What torque can and cannot show of each link."
    if total and base:
        lead = (
            f"Of {total} standard parameters, {unique} can be identified one by one and {none} not "
            f"at all; the others appear only in combinations, {base} base parameters together."
        )
    counts = f"{unique} parameters uniquely, {none} not at all"
    lines = [("identifiable", f"{base} combinations of {total} parameters; {counts}")]
    verdicts = [v.text(row, "verdict") for row in v.records(result, "practical")]
    if weak := verdicts.count("hardly"):
        lines.append(
            ("", f"this motion hardly shows {weak} of {len(verdicts)} combinations")
        )
    elif verdicts and "not_shown" not in verdicts:
        better = v.real(result, "persistency", "shown")
        than = "" if better is None else f", {better:.0f} better than they were known"
        lines.append(("", f"this motion shows all {len(verdicts)} combinations{than}"))
    return lead, tuple(lines)


def _facts(result: Result) -> p.Facts | None:
    rows = [
        row
        for link in v.records(result, "links")
        for row in v.records(link, "parameters")
    ]
    visible = [row for row in rows if v.text(row, "category") != "unidentifiable"]
    decided = sum(v.text(row, "decided_by") == "prior" for row in visible)
    hidden = (
        len(v.records(result, "not_shown")) if v.records(result, "practical") else None
    )
    keys = ("standard_parameters", "base_parameters", "condition_number")
    total, base, kappa = (v.real(result, key) for key in keys)
    of = f"of {v.whole(base)} base parameters"
    decisive = f"of {len(visible)} that torque contains, rather than by the data"
    judged = any(v.text(row, "decided_by") for row in rows)
    return p.facts(
        p.fact(
            "Parameters", total, v.whole, "of all links, and of their joints' effects"
        ),
        p.fact("Base parameters", base, v.whole, "identifiable combinations"),
        p.fact("Condition number", kappa, v.number, "with the given motion"),
        p.fact(
            "Not shown by this motion",
            hidden,
            v.whole,
            of,
            p.POOR if hidden else p.GOOD,
        ),
        p.fact("Decided by the prior", decided if judged else None, v.whole, decisive),
    )


def _basis(result: Result) -> list[str]:
    basis = v.text(result, "basis")
    near = v.text(result, "structure", "marginal")
    holds = v.listing(v.words(result, "structure", "circumstances"), "", "; ")
    said = (
        f"Holds for: {holds}." * bool(holds),
        v.sentence(near),
        f"Standard deviations are {basis}." * bool(basis),
    )
    return [each for each in said if each]


def _matrix(links: list[Result]) -> p.Matrix | None:
    shared = {
        n
        for k in links
        for row in v.records(k, "combined")
        for n in v.words(row, "members")
    }

    def shown_as(link: Result, symbol: str) -> str:
        names = {f"{v.text(link, 'link')}.{symbol}", symbol}
        if names & set(v.words(link, "unique")):
            return "unique"
        if names & set(v.words(link, "unidentifiable")):
            return "none"
        return "combined" if names & shared else ""

    rows = (
        (v.text(link, "link"), tuple(shown_as(link, s) for s in STANDARD))
        for link in links
    )
    caption = (
        "Each link's ten parameters: mass m [kg], first moment mc [kg·m], inertia I [kg·m²] about "
        "the joint frame; links near the base show few of theirs because they move little."
    )
    return p.Matrix("Link", STANDARD, tuple(rows), caption, _LEGEND) if links else None


def _singular(result: Result) -> p.Table | None:
    """What Denavit-Hartenberg frames are asked for: the decomposition that categories rest on."""
    if v.text(result, "structure", "frames") != "dh":
        return None
    values = v.reals(result, "structure", "singular_values")
    words = v.words(result, "structure", "singular_vectors")
    rank = v.at(result, "base_parameters")
    rows = [
        {"k": k, "value": value, "vector": text, "seen": k <= rank}
        for k, (value, text) in enumerate(zip(values, words, strict=False), start=1)
    ]
    return p.table(
        rows,
        [
            ("number:No.", "k", v.whole),
            ("number:Singular value", "value"),
            (
                "text:Torque",
                "seen",
                lambda seen: "shows it" if seen else "does not contain it",
            ),
            ("expression:Right singular vector, by its largest members", "vector"),
        ],
        "Of the columns of all parameters over random states, in units of the arm. A parameter is "
        "identifiable by itself where it is orthogonal to all vectors of singular value zero, and "
        "unidentifiable where it is one of them.",
        p.folded(f"All {len(rows)} singular values", len(rows)),
    )


def _motion(result: Result, series: Series) -> p.Blocks:
    resting = v.words(result, "resting_joints")
    missing = p.table(
        v.records(result, "not_shown"),
        [("expression:Not shown by this motion", "name"), ("text:Shown by", "needed")],
        "These base parameters make no torque of their own in this motion: they keep their prior "
        f"values{f'; at rest: {v.listing(resting)}' if resting else ''}.",
    )
    rows = v.records(result, "practical")
    practical = p.table(
        rows,
        [
            ("expression:Base parameter", "name"),
            *p.estimates("number:Value (SI)", "number:± std (SI)"),
            ("number:Relative std", p.relative),
            ("text:Verdict", _determined),
        ],
        "How precisely this motion determines each base parameter. Relative standard deviation: "
        "● below 5\u00a0%, ◐ below 30\u00a0%, ○ above.",
        p.folded(f"All {len(rows)} base parameters", len(rows)),
    )
    figure = spectrum_figure(series)
    return [p.notes(excitation_sentence(result)), missing, figure, practical]


def _determined(row: Result) -> p.Cell:
    verdict = v.plain(v.text(row, "verdict"))
    return p.Cell(
        verdict or NONE, _TONES.get(verdict, p.quality(v.real(row, "rel_std")))
    )


def _weakest(result: Result) -> p.Table | None:
    def share(row: Result) -> p.Cell:
        rel = v.real(row, "rel_std")
        if rel is None:
            return p.Cell("not seen", p.POOR)
        return p.Cell(v.percent(rel), p.quality(rel), rel)

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


def _title(link: Result) -> str:
    name = v.text(link, "link")
    joint = v.text(link, "joint")
    return f"{name} at {joint}" if joint not in ("", name) else name


def _link(result: Result, link: Result, place: str) -> p.Blocks:
    inertial = [
        row for row in v.records(link, "parameters") if _symbol(row) in STANDARD
    ]
    unique, combined, none = (
        sum(v.text(row, "category") == category for row in inertial)
        for category in _CATEGORY
    )
    mass = next((v.at(row, "value") for row in inertial if _symbol(row) == "m"), None)
    where = place if mass is None else f"{place}, {v.quantity(mass, 'kg')}"
    said = (
        f"{where}. Of its ten parameters, {unique} are identifiable individually, {combined} only "
        f"in combination and {none} not at all."
    )
    groups: dict[str, list[str]] = {}
    for row in v.records(link, "parameters"):
        if v.text(row, "needed"):
            groups.setdefault(v.text(row, "needed"), []).append(_symbol(row))
    needed = p.table(
        [{"names": names, "needed": what} for what, names in groups.items()],
        [("name:To identify individually", "names"), ("text:Required", "needed")],
        "Found by adding each experiment's rows and looking at rank and standard deviation again.",
    )
    own = {v.text(row, "name") for row in v.records(link, "parameters")}
    follow = [
        f"Once one of {', '.join(group)} is known from elsewhere, the data give the rest of them."
        for group in map(v.words, v.items(result, "follow_each_other"))
        if own & set(group)
    ]
    known = {v.text(row, "name"): row for row in v.records(result, "practical")}
    names = [v.text(row, "expression") for row in v.records(link, "combined")]
    seen: tuple[p.Column, ...] = (*p.estimates(), ("text:Determined", _determined))
    combinations = p.table(
        [{"expression": name, **known.get(name, {})} for name in names],
        [
            ("expression:Identifiable combination", "expression"),
            *(seen if known else ()),
        ],
        "Torque depends on these sums alone, not on how they divide among their members.",
        p.folded(f"Its {len(names)} combinations", len(names), 1),
    )
    return [p.notes([said]), _parameters(link), combinations, needed, p.notes(follow)]


def _symbol(row: Result) -> str:
    return v.text(row, "name").rpartition(".")[2]


def _parameters(link: Result) -> p.Table | None:
    rows = v.records(link, "parameters")
    motion = any(v.real(row, "std") is not None for row in rows)
    influence = any(v.real(row, "prior_influence") is not None for row in rows)
    said = "Inertia about the joint's frame; friction, offset and rotor inertia of its joint."
    if motion:
        said += " The prior of the link is counted in the standard deviation."
    if influence:
        said += (
            " Follows prior: how far the value moves when its prior is moved, from 0, the data "
            "decide, to 1, the prior alone does."
        )
    plain: p.Column = ("number:Value", "value", v.number4)

    def decided(row: Result) -> p.Cell:
        hidden = v.text(row, "category") == "unidentifiable"
        return p.decided("prior" if hidden else v.text(row, "decided_by"))

    return p.table(
        rows,
        [
            ("name:Parameter", _symbol),
            *(p.estimates() if motion else (plain,)),
            ("text:Unit", "unit"),
            (
                "text:Identifiable",
                lambda r: p.Cell(*_CATEGORY.get(v.text(r, "category"), (NONE,))),
            ),
            ("text:This motion determines it", _shown) if motion else None,
            ("number:Prior", "prior") if motion else None,
            ("number:Follows prior", "prior_influence") if influence else None,
            ("text:Decided by", decided) if influence else None,
        ],
        said,
    )


def _shown(row: Result) -> p.Cell:
    if v.text(row, "category") != "unique":
        return p.Cell(NONE)
    word = v.plain(v.text(row, "verdict"))
    value = v.real(row, "value")
    std = v.real(row, "std_data")
    share = (
        f", ±{v.percent(std / abs(value))}"
        if value and std and word != "negligible"
        else ""
    )
    return p.Cell(word + share if word else NONE, _TONES.get(word, p.PLAIN))
