"""Page of an examination: the verdict, what it rests on joint by joint, then every section."""

from collections.abc import Mapping, Sequence
from typing import Any

from excitant.reports import page as p
from excitant.reports import values as v
from excitant.reports.values import NONE
from excitant.results import Demo, Finding, Go, IdentifiedJoint, Number, Verdict

_FEW = (
    3  # parameters of a hidden effect, and warnings or faults, that are written out
)
_TRUTH = {
    None: (NONE, p.PLAIN, "not judged"),
    "named": ("✓ yes", p.GOOD, "named"),
    "undecided": (
        "◐ among what is undecided",
        p.FAIR,
        "among what is left undecided",
    ),
    "missed": ("✗ no", p.POOR, "not found"),
}


def examination_page(
    result: Go | Demo, sections: Mapping[str, p.Section]
) -> p.Page:
    """The page of ``go``, or of a demonstration of it, with the sections of its commands."""
    verdict = result.verdict
    title = "Examination"
    subtitle = "The model as given, identified, and extended by what was found to be wrong with it."
    hidden: list[p.Fact] = []
    last: p.Brief = ()
    if isinstance(result, Demo):
        title = "Demonstration"
        subtitle = (
            "A virtual arm hides an effect from its model. A motion was designed for the model and "
            "run on the arm, the model was identified and its identifiability analysed, and what "
            f"it still gets wrong was diagnosed (seed {result.seed})."
        )
        mark, tone, words = _TRUTH[verdict.truth]
        effect = _hidden(result)
        hidden = [
            effect,
            p.Fact("Named by the diagnosis", mark, _named(verdict), tone),
        ]
        last = (("hidden", f"{effect.value} (seed {result.seed}): {words}"),)
    joints = _joints(result)
    blocks = (
        p.notes([" ".join(verdict.sentences)], "lead"),
        p.sentences(verdict.refused, p.POOR),
        p.facts(*hidden),
        joints,
        p.sentences(result.notes),
    )
    return p.Page(
        f"{title}: {result.robot}",
        subtitle,
        list(filter(None, blocks)),
        list(sections.values()),
        (*_brief(result, sections), *last),
        table=joints,
    )


def _joints(result: Go | Demo) -> p.Table | None:
    """Error of each model and main cause, joint by joint."""
    extended = {row.name: row for row in result.diagnose.extended.joints}
    findings = result.diagnose.findings

    def error(x: Number) -> p.Cell:
        tone = p.PLAIN
        if x is not None:
            tone = p.GOOD if x < 0.1 else p.FAIR if x < 0.3 else p.POOR
        return p.cell(x, v.percent, tone)

    def after(row: IdentifiedJoint) -> p.Cell:
        return error(extended[row.name].nrmse if row.name in extended else None)

    return p.table(
        result.identify.joints,
        [
            ("name:Joint", "name"),
            ("number:Given", lambda row: error(row.baseline.nrmse)),
            ("number:Identified", lambda row: error(row.validate.nrmse)),
            ("number:Extended", after),
            ("text:Main cause", lambda row: _cause_at(row.name, findings)),
        ],
        "Error of each model on the hold-out in per cent of what the torque varies (nrmse): "
        "● below 10\u00a0%, ◐ below 30\u00a0%, ○ above; and what the given model lacks most there.",
    )


def _cause_at(joint: str, findings: Sequence[Finding]) -> str:
    """The cause that makes most of the torque at a joint, wherever it sits."""

    def torque(finding: Finding) -> float:
        return finding.by_joint.get(joint) or 0.0

    finding = max(findings, key=torque, default=None)
    if finding is None or not torque(finding):
        return NONE
    kinds = [part for part in finding.parts if joint in part.joints] or [finding]
    named = [kind for kind in kinds if kind.verdict == "named"]
    names = dict.fromkeys(v.plain(kind.effect) for kind in named or kinds)
    undecided = " (undecided)" * (not named and finding.verdict != "unknown")
    more = " and more" * (len(names) > 2)
    return v.listing([*names][:2]) + more + undecided


def _brief(
    result: Go | Demo, sections: Mapping[str, p.Section]
) -> list[tuple[str, str]]:
    """Lines of the terminal before the table of the joints."""
    lines = [
        ("" if k else "verdict", words)
        for k, words in enumerate(result.verdict.sentences)
    ]
    labels = {"robots": "robot", "design": "designed", "analyze": "known"}
    for verb, label in labels.items():
        if verb in sections:
            line = sections[verb].brief[-1 if verb == "analyze" else 0]
            lines.append((label, line[1]))
    warnings = [
        f"{v.listing(row.where)}: {row.sentence}"
        for row in result.robots.warnings
        if not row.hint
    ]
    faults = [
        f"{row.recording}: {row.detail}{' (repaired)' * row.repaired}"
        for row in result.diagnose.faults
    ]
    holdout = result.identify.holdout
    lines += [*_first("looks wrong", warnings), *_first("data fault", faults)]
    lines.append(("data", holdout if faults else f"no fault found; {holdout}"))
    after = result.verdict.next
    return lines + [("next", after)] * bool(after)


def _first(label: str, sentences: Sequence[str]) -> list[tuple[str, str]]:
    more = [f"and {len(sentences) - _FEW} more"] * (len(sentences) > _FEW)
    lines = [*sentences[:_FEW], *more]
    return [("" if k else label, words) for k, words in enumerate(lines)]


def _named(verdict: Verdict) -> str:
    """What was found."""
    if verdict.effect is None:
        return "nothing was named"
    at = f" at {v.listing(verdict.joints)}" if verdict.joints else ""
    return v.plain(verdict.effect) + at


def _hidden(result: Demo) -> p.Fact:
    """What was hidden."""
    truth = result.truth
    parameters = [row for f in result.diagnose.findings for row in f.parameters]
    rows: list[Any] = [*reversed(parameters), *result.identify.parameters]
    units = {
        row.name.rpartition(".")[2]: row.unit.removeprefix("1") for row in rows
    }
    sizes = [
        f"{name} = {v.quantity(value, units.get(name, ''))}"
        for name, value in truth.parameters.items()
    ]
    remark = ", ".join(sizes[:_FEW]) + (", …" if len(sizes) > _FEW else "")
    at = f" at {truth.joint}" if truth.joint else ""
    return p.Fact("Hidden effect", v.plain(truth.effect) + at, remark)
