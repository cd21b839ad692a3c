"""Section on what can be identified: in principle, with a given motion, and link by link."""

from dataclasses import replace

from excitant.reports import page as p
from excitant.reports import values as v
from excitant.reports.figures.search import spectrum_figure
from excitant.reports.sections.design import excitation_sentence
from excitant.reports.sections.identify import fault_table
from excitant.reports.values import NONE, Series
from excitant.results import (
    Analyze,
    Combined,
    LinkIdentifiability,
    ParameterIdentifiability,
    Practical,
)
from excitant.robots.parameters import STANDARD

_TONES = {"well": p.GOOD, "roughly": p.FAIR, "negligible": p.GOOD}
_TONES |= {"hardly": p.POOR, "not shown": p.POOR}
_CATEGORY = {
    "unique": ("by\u00a0itself", p.GOOD),
    "combined": ("in\u00a0combination", p.FAIR),
    "unidentifiable": ("not\u00a0at\u00a0all", p.POOR),
}


def analyze_section(result: Analyze, series: Series) -> p.Section:
    """Identifiability link by link, and how well a motion determines each parameter."""
    links = result.links
    lead, brief = _lead_and_brief(result)
    return p.section(
        "Identifiability",
        lead,
        [
            (
                "Key figures",
                [
                    _facts(result),
                    p.notes(_basis(result)),
                    p.sentences(result.notes, brief=""),
                ],
            ),
            ("Data faults", [fault_table(result.faults)]),
            ("Parameters by link", [_by_link(links)]),
            ("Singular values", [_singular(result)]),
            ("With the given motion", _motion(result, series)),
        ],
        brief,
        [
            *(
                (_title(link), _link(result, link, f"Link {k} of {len(links)}"))
                for k, link in enumerate(links, start=1)
                if link.parameters
            ),
        ],
    )


def links_folded(page: p.Section, result: Analyze) -> p.Section:
    """A section whose links stand in one part, each behind a line until it is opened."""
    titles = {_title(link) for link in result.links}
    folds = [
        p.Folded(part.title, part.blocks)
        for part in page.parts
        if part.title in titles
    ]
    others = [part for part in page.parts if part.title not in titles]
    one = p.Folded("Link by link", folds, closed=True)
    return replace(page, parts=(*others, *[one] * bool(folds)))


def _lead_and_brief(result: Analyze) -> tuple[str, p.Brief]:
    links = result.links
    unique = sum(len(link.unique) for link in links)
    none = sum(len(link.unidentifiable) for link in links)
    total = result.standard_parameters
    base = result.base_parameters
    lead = (
        f"Of {total} standard parameters, {unique} can be identified one by one and {none} not "
        f"at all; the others appear only in combinations, {base} base parameters together."
    )
    counts = f"{unique} parameters uniquely, {none} not at all"
    lines = [
        ("identifiable", f"{base} combinations of {total} parameters; {counts}")
    ]
    verdicts = [row.verdict for row in result.practical]
    if weak := verdicts.count("hardly"):
        lines.append(
            ("", f"this motion hardly shows {weak} of {len(verdicts)} combinations")
        )
    elif verdicts and "not_shown" not in verdicts:
        better = result.persistency and result.persistency.shown
        than = "" if better is None else f", {better} better than they were known"
        lines.append(
            ("", f"this motion shows all {len(verdicts)} combinations{than}")
        )
    return lead, lines


def _facts(result: Analyze) -> p.Facts | None:
    rows = [row for link in result.links for row in link.parameters]
    visible = [row for row in rows if row.category != "unidentifiable"]
    decided = sum(row.decided_by == "prior" for row in visible)
    hidden = len(result.not_shown) if result.practical else None
    of = f"of {result.base_parameters} base parameters"
    decisive = f"of {len(visible)} that torque contains, rather than by the data"
    judged = any(row.decided_by for row in rows)
    return p.facts(
        p.fact(
            "Parameters",
            result.standard_parameters,
            v.whole,
            "of all links, and of their joints' effects",
        ),
        p.fact(
            "Base parameters",
            result.base_parameters,
            v.whole,
            "identifiable combinations",
        ),
        p.fact(
            "Condition number",
            result.condition_number,
            v.condition,
            "with the given motion",
        ),
        p.fact(
            "Not shown by this motion",
            hidden,
            v.whole,
            of,
            p.POOR if hidden else p.GOOD,
        ),
        p.fact(
            "Decided by the prior", decided if judged else None, v.whole, decisive
        ),
    )


def _basis(result: Analyze) -> list[str]:
    basis = result.basis
    structure = result.structure
    holds = "; ".join(structure.circumstances)
    sentences = (
        f"Holds for: {holds}." * bool(holds),
        v.sentence(structure.marginal or ""),
        f"Standard deviations are {basis}." * bool(basis),
    )
    return [sentence for sentence in sentences if sentence]


def _by_link(links: list[LinkIdentifiability]) -> p.Table | None:
    """The categories of each link's ten parameters."""
    shared = {n for k in links for row in k.combined for n in row.members}

    def column(symbol: str) -> p.Column:
        def category(link: LinkIdentifiability) -> p.Cell:
            names = {f"{link.link}.{symbol}", symbol}
            if names & set(link.unique):
                return p.Cell("alone", p.GOOD)
            if names & set(link.unidentifiable):
                return p.Cell("no", p.POOR)
            return p.Cell("sums", p.FAIR) if names & shared else p.Cell("")

        return f"text:{symbol}", category

    return p.table(
        links,
        [("name:Link", "link"), *map(column, STANDARD)],
        "Each link's ten parameters, identifiable alone, only in sums (combinations), or not: mass "
        "m [kg], first moment mc [kg·m], inertia I [kg·m²] about the joint frame; links near the "
        "base show few of theirs because they move little.",
    )


def _singular(result: Analyze) -> p.Table | None:
    """What Denavit-Hartenberg frames are asked for: the decomposition that categories rest on."""
    if result.structure.frames != "dh":
        return None
    rank = result.base_parameters
    sizes = result.structure.singular_values
    vectors = result.structure.singular_vectors
    rows = list(zip(range(1, len(sizes) + 1), sizes, vectors, strict=True))
    return p.table(
        rows,
        [
            ("number:No.", lambda r: r[0], v.whole),
            ("number:Singular value", lambda r: r[1]),
            (
                "text:Torque",
                lambda r: "shows it" if r[0] <= rank else "does not contain it",
            ),
            (
                "expression:Right singular vector, by its largest members",
                lambda r: r[2],
            ),
        ],
        "Of the columns of all parameters over random states, in units of the arm. A parameter is "
        "identifiable by itself where it is orthogonal to all vectors of singular value zero, and "
        "unidentifiable where it is one of them.",
        long="All {} singular values",
    )


def _motion(result: Analyze, series: Series) -> p.Blocks:
    resting = result.resting_joints
    missing = p.table(
        result.not_shown,
        [
            ("expression:Not shown by this motion", "name"),
            ("text:Shown by", "needed"),
        ],
        "These base parameters make no torque of their own in this motion: they keep their prior "
        f"values{f'; at rest: {v.listing(resting)}' if resting else ''}.",
    )
    practical = p.table(
        result.practical,
        [
            ("expression:Base parameter", "name"),
            *p.estimates("number:Value (SI)", "number:± std (SI)"),
            ("number:Relative std", p.relative),
            ("text:Verdict", _determined),
        ],
        "How precisely this motion determines each base parameter. Relative standard deviation: "
        "● below 5\u00a0%, ◐ below 30\u00a0%, ○ above.",
        long="All {} base parameters",
    )
    figure = spectrum_figure(series)
    return [
        p.notes(excitation_sentence(result.persistency)),
        missing,
        figure,
        practical,
    ]


def _determined(row: Practical | None) -> p.Cell:
    if row is None:
        return p.Cell(NONE)
    verdict = v.plain(row.verdict)
    return p.Cell(verdict, _TONES.get(verdict, p.quality(row.rel_std)))


def _title(link: LinkIdentifiability) -> str:
    name = link.link
    return f"{name} at {link.joint}" if link.joint not in ("", name) else name


def _link(result: Analyze, link: LinkIdentifiability, place: str) -> p.Blocks:
    inertial = [row for row in link.parameters if _symbol(row) in STANDARD]
    unique, in_sums, none = (
        sum(row.category == category for row in inertial) for category in _CATEGORY
    )
    mass = next((row.value for row in inertial if _symbol(row) == "m"), None)
    where = place if mass is None else f"{place}, {v.quantity(mass, 'kg')}"
    summary = (
        f"{where}. Of its ten parameters, {unique} are identifiable individually, {in_sums} only "
        f"in combination and {none} not at all."
    )
    groups: dict[str, list[str]] = {}
    for row in link.parameters:
        if row.needed:
            groups.setdefault(row.needed, []).append(_symbol(row))
    needed = p.table(
        list(groups.items()),
        [
            ("name:To identify individually", lambda r: ", ".join(r[1])),
            ("text:Required", lambda r: r[0]),
        ],
        "Found by adding each experiment's rows and looking at rank and standard deviation again.",
    )
    practical = {row.name: row for row in result.practical}

    def estimate(row: Combined) -> Practical | None:
        return practical.get(row.expression)

    determined = (
        *p.estimates(of=estimate),
        ("text:Determined", lambda r: _determined(estimate(r))),
    )
    combinations = p.table(
        link.combined,
        [
            ("expression:Identifiable combination", "expression"),
            *(determined if practical else ()),
        ],
        "Torque depends on these sums alone, not on how they divide among their members.",
        long="Its {} combinations",
        most=1,
    )
    return [
        p.notes([summary]),
        _parameters(link),
        combinations,
        needed,
    ]


def _symbol(row: ParameterIdentifiability) -> str:
    return row.name.rpartition(".")[2]


def _parameters(link: LinkIdentifiability) -> p.Table | None:
    rows = link.parameters
    motion = any(row.std is not None for row in rows)
    influence = any(row.prior_influence is not None for row in rows)
    caption = "Inertia about the joint's frame; friction, offset and rotor inertia of its joint."
    if motion:
        caption += " The prior of the link is counted in the standard deviation."
    if influence:
        caption += (
            " Follows prior: how far the value moves when its prior is moved, from 0, the data "
            "decide, to 1, the prior alone does."
        )
    plain = ("number:Value", "value", v.number4)

    def decided(row: ParameterIdentifiability) -> p.Cell:
        hidden = row.category == "unidentifiable"
        return p.decided("prior" if hidden else row.decided_by)

    return p.table(
        rows,
        [
            ("name:Parameter", _symbol),
            *(p.estimates() if motion else (plain,)),
            ("text:Unit", "unit"),
            ("text:Identifiable", lambda r: p.Cell(*_CATEGORY[r.category])),
            ("text:This motion determines it", _shown) if motion else None,
            ("number:Prior", "prior") if motion else None,
            ("number:Follows prior", "prior_influence") if influence else None,
            ("text:Decided by", decided) if influence else None,
        ],
        caption,
    )


def _shown(row: ParameterIdentifiability) -> p.Cell:
    if row.category != "unique":
        return p.Cell(NONE)
    word = v.plain(row.verdict or "")
    value = row.value
    std = row.std_data
    share = (
        f", ±{v.percent(std / abs(value))}"
        if value and std and word != "negligible"
        else ""
    )
    return p.Cell(word + share if word else NONE, _TONES.get(word, p.PLAIN))
