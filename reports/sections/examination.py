"""Page of an examination: the verdict, what it rests on joint by joint, then every section."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from excitant.reports import page as p
from excitant.reports import values as v
from excitant.reports.values import NONE, Result

_FEW = 3  # parameters of a hidden effect, and warnings or faults, that are written out
_TRUTH = {
    "named": ("✓ yes", p.GOOD, "named"),
    "undecided": ("◐ among what is undecided", p.FAIR, "among what is left undecided"),
    "missed": ("✗ no", p.POOR, "not found"),
}


def examination_page(result: Result, sections: Mapping[str, p.Section]) -> p.Page:
    """The page of ``go``, or of a demonstration of it, with the sections of its commands."""
    of_demo = v.text(result, "verb") == "demo"
    robot = v.text(result, "robot")
    seed = v.text(result, "seed")
    subtitle = "The model as given, identified, and extended by what was found to be wrong with it."
    if of_demo:
        subtitle = (
            "A virtual arm hides an effect from its model. A motion was designed for the model and "
            "run on the arm, the model was identified and its identifiability analysed, and what "
            "it still gets wrong was diagnosed" + (f" (seed {seed})." if seed else ".")
        )
    title = "Demonstration" if of_demo else "Examination"
    said = v.words(result, "verdict", "sentences")
    joints = _joints(result)
    refused = [v.sentence(each) for each in v.words(result, "verdict", "refused")]
    notes = [v.sentence(each) for each in v.words(result, "notes")]
    blocks = (
        p.notes([" ".join(said)] * bool(said), "lead"),
        p.notes(refused, p.POOR),
        p.facts(*_truth(result)) if of_demo else None,
        joints,
        p.notes(notes),
    )
    brief = [*_brief(result, sections), *_hidden_line(result, of_demo)]
    return p.Page(
        f"{title}: {robot}" if robot else title,
        subtitle,
        tuple(block for block in blocks if block is not None),
        tuple(sections.values()),
        tuple(brief),
        table=joints,
    )


def _joints(result: Result) -> p.Table | None:
    """Error of each model and main cause, joint by joint."""
    extended = {
        v.text(r, "name"): r
        for r in v.records(result, "diagnose", "extended", "joints")
    }
    findings = v.records(result, "diagnose", "findings")
    rows = [
        {
            "name": v.text(row, "name"),
            "given": v.at(row, "baseline", "nrmse"),
            "identified": v.at(row, "validate", "nrmse"),
            "extended": v.at(extended.get(v.text(row, "name")), "nrmse"),
            "cause": _cause_at(v.text(row, "name"), findings),
        }
        for row in v.records(result, "identify", "joints")
    ]

    def error(model: str) -> p.Column:
        def cell(row: Result) -> p.Cell:
            x = v.real(row, model)
            tone = (
                p.PLAIN
                if x is None
                else p.GOOD
                if x < 0.1
                else p.FAIR
                if x < 0.3
                else p.POOR
            )
            return p.Cell(v.percent(x), tone, x)

        return f"number:{model.capitalize()}", cell

    models = (error(model) for model in ("given", "identified", "extended"))
    return p.table(
        rows,
        [("name:Joint", "name"), *models, ("text:Main cause", "cause")],
        "Error of each model on the hold-out in per cent of what the torque varies (nrmse): "
        "● below 10\u00a0%, ◐ below 30\u00a0%, ○ above; and what the given model lacks most there.",
    )


def _cause_at(joint: str, findings: Sequence[Result]) -> str:
    for finding in findings:
        if joint in v.words(finding, "joints"):
            kinds = [
                f for f in v.records(finding, "parts") if joint in v.words(f, "joints")
            ]
            names = dict.fromkeys(
                v.plain(v.text(f, "effect")) for f in kinds or [finding]
            )
            undecided = " (undecided)" * (v.text(finding, "verdict") == "undecided")
            return (
                v.listing([*names][:2])
                + (" and more" if len(names) > 2 else "")
                + undecided
            )
    return NONE


def _brief(result: Result, sections: Mapping[str, p.Section]) -> list[tuple[str, str]]:
    """Lines of the terminal before the table of the joints."""
    said = v.words(result, "verdict", "sentences")
    lines = [("" if k else "verdict", words) for k, words in enumerate(said)]
    for verb, label in (
        ("robots", "robot"),
        ("design", "designed"),
        ("analyze", "known"),
    ):
        if verb in sections and (found := sections[verb].brief):
            lines.append((label, found[-1 if verb == "analyze" else 0][1]))
    wrong = [
        f"{v.listing(v.words(row, 'where')[:_FEW])}: {v.text(row, 'sentence')}"
        for row in v.records(result, "robots", "warnings")
        if v.at(row, "hint") is not True
    ]
    faults = [
        f"{v.text(row, 'recording')}: {v.text(row, 'detail')}"
        + (" (repaired)" if v.at(row, "repaired") is True else "")
        for row in v.records(result, "diagnose", "faults")
    ]
    held = v.text(result, "identify", "holdout")
    lines += [*_first("looks wrong", wrong), *_first("data fault", faults)]
    lines.append(("data", held if faults else f"no fault found; {held}"))
    after = v.text(result, "verdict", "next")
    return lines + [("next", after)] * bool(after)


def _first(label: str, said: Sequence[str]) -> list[tuple[str, str]]:
    kept = [*said[:_FEW], *[f"and {len(said) - _FEW} more"] * (len(said) > _FEW)]
    return [("" if k else label, words) for k, words in enumerate(kept)]


def _hidden_line(result: Result, of_demo: bool) -> list[tuple[str, str]]:
    if not of_demo:
        return []
    *_, told = _TRUTH.get(v.text(result, "verdict", "truth"), ("", "", "not judged"))
    return [
        ("hidden", f"{_hidden(result).value} (seed {v.text(result, 'seed')}): {told}")
    ]


def _truth(result: Result) -> list[p.Fact]:
    """What was hidden, and whether it was found."""
    label = "Named by the diagnosis"
    seen = _TRUTH.get(v.text(result, "verdict", "truth"))
    named = v.plain(v.text(result, "verdict", "effect"))
    joints = v.words(result, "verdict", "joints")
    named += f" at {v.listing(joints)}" if joints else ""
    found = p.Fact(label, NONE)
    if seen is not None:
        found = p.Fact(label, seen[0], named or "nothing was named", seen[1])
    return [_hidden(result), found]


def _hidden(result: Result) -> p.Fact:
    effect = v.plain(v.text(result, "truth", "effect"))
    joint = v.text(result, "truth", "joint")
    values = v.at(result, "truth", "parameters")
    rows = v.records(result, "identify", "parameters")
    for finding in v.records(result, "diagnose", "findings"):
        rows = [*v.records(finding, "parameters"), *rows]
    units = {
        v.text(r, "name").rpartition(".")[2]: v.text(r, "unit").removeprefix("1")
        for r in rows
    }
    said = [
        f"{name} = {value if isinstance(value, str) else v.quantity(value, units.get(name, ''))}"
        for name, value in (values.items() if isinstance(values, dict) else ())
        if isinstance(value, str) or v.real(value) is not None
    ]
    remark = ", ".join(said[:_FEW]) + (", …" if len(said) > _FEW else "")
    return p.Fact("Hidden effect", f"{effect}{' at ' * bool(joint)}{joint}", remark)
