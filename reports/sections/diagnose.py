"""Section on what the model gets wrong, and what would settle open questions."""

from dataclasses import replace

from excitant.names import listed
from excitant.reports import page as p
from excitant.reports import values as v
from excitant.reports.figures.residual import evidence_figure
from excitant.reports.figures.torque import Curves, over_holdout, torque_figure
from excitant.reports.sections.identify import (
    CUTOFF_REMARK,
    exported_table,
    fault_table,
    refitted_line,
)
from excitant.reports.values import Series
from excitant.results import (
    Diagnose,
    Finding,
    FoundParameter,
    JointAccuracy,
    JointResidual,
    Number,
    Part,
    Unexplained,
)

_NOISE = "noise-like"  # what a diagnosis calls a residual without structure
_QUANTITIES = (
    "constant",
    "direction",
    "velocity",
    "position",
    "load",
    "reversal",
    "time",
)
_MEANING = (
    "Constant: offset. Direction of motion: dry friction. Velocity: viscous friction. Position: "
    "springs, ripple. Load: gain, load-dependent friction. Distance since the last reversal: "
    "hysteresis, backlash. Time: drift."
)
_WITHOUT_STD = (
    " (a dash: held or chosen from a grid, of a link that torque shows only together with others, "
    "or of a cause that is not decided)"
)
_FIRST = 7  # findings in the first table
_USUAL = ("viscous_friction", "coulomb_friction")  # of every joint
_LEADING = 3  # findings that are shown without opening a fold
_CURVES = Curves(
    "simulated",
    "extended",
    "extended model",
    "Measured torque and predictions over the hold-out, below them the residuals: where blue is "
    "flat and orange is not, the named effects are the cause.",
)
_ONE_MODEL = (
    "Measured torque and the given model's prediction over the hold-out, below them the residual: "
    "structure in it shows something that the model lacks."
)


def diagnose_section(result: Diagnose, series: Series) -> p.Section:
    """The diagnosis: faults, findings in order of importance with evidence, what stays open."""
    unit = result.unit
    joints = [row.name for row in result.simulation.joints]
    findings = result.findings
    changed = _changed(result)
    lead = result.headline
    notes = [note for note in result.notes if note not in lead]
    curves = _CURVES if changed else replace(_CURVES, after="", caption=_ONE_MODEL)
    wrong = (
        "What is wrong with the given model"
        if findings
        else "Error of the given model"
    )
    first, others = _finding_parts(findings, series, unit)
    return p.section(
        "Diagnosis",
        lead,
        [
            (
                "Key figures",
                [
                    _facts(result),
                    fault_table(result.faults),
                    *_findings(findings, unit),
                ],
            ),
            ("Given values that the data correct", [_corrected(result.corrected)]),
            (wrong, [_shares(result.error.joints, unit)]),
            ("Files of the extended model", [exported_table(result.exported)]),
            *first,
        ],
        (
            ("diagnosed", lead),
            *_first_lines(findings),
            *_next(findings),
            *_corrected_line(result.corrected),
            *refitted_line(result.exported),
        ),
        [
            ("Further findings", others),
            ("Error per joint", [_errors(result, changed)]),
            (
                over_holdout(unit),
                [torque_figure(joints, series, unit, curves)],
            ),
            ("Not explained", _unexplained(result.unexplained)),
            ("Notes", [p.sentences(notes)]),
        ],
    )


def _first_lines(findings: list[Finding]) -> list[tuple[str, str]]:
    """The first findings and their finer parts, a line each, where there is more than one."""
    lines = []
    for k, finding in enumerate(findings[:_FIRST], start=1):
        lines.append(_line(str(k), finding, finding.sentence))
        lines += [
            _line(f"{k}, of this", part, f"{part.sentence}{_why(part, '; ')}")
            for part in finding.parts
            if part.effect not in _USUAL
        ]
    return lines if len(lines) > 1 else []


def _next(findings: list[Finding]) -> p.Brief:
    """The experiment that decides the first of the undecided findings."""
    numbered = enumerate(findings, start=1)
    told = [
        f"finding {k}: {row.experiment}" for k, row in numbered if row.experiment
    ]
    return tuple(("next", words) for words in told[:1])


def _line(number: str, part: Part, words: str) -> tuple[str, str]:
    return f"{number}{' (undecided)' * (part.verdict == 'undecided')}", words


def _pairs(result: Diagnose) -> list[tuple[JointAccuracy, JointAccuracy]]:
    """Errors of each joint by the given and by the extended model."""
    return list(zip(result.simulation.joints, result.extended.joints, strict=True))


def _changed(result: Diagnose) -> bool:
    """Whether the extended model predicts otherwise than the given one; not if nothing is named."""
    return any(
        after.rms is not None and after.rms != before.rms
        for before, after in _pairs(result)
    )


def _cause(finding: Finding) -> str:
    return "unknown cause" if _unknown(finding) else v.plain(finding.effect)


def _unknown(finding: Finding) -> bool:
    return finding.effect == "unknown"


def _facts(result: Diagnose) -> p.Facts | None:
    findings = result.findings
    faults = result.faults
    verdicts = [finding.verdict for finding in findings]
    counts = [
        f"{n} {word}"
        for word in dict.fromkeys(verdicts)
        if (n := verdicts.count(word))
    ]
    before = v.missed({row.name: row.nrmse for row in result.simulation.joints})
    after = v.Missed()
    if _changed(result):
        after = v.missed({row.name: row.nrmse for row in result.extended.joints})
    errors, worst = v.errors(before, after)
    return p.facts(
        p.Fact(
            "Hold-out error",
            errors,
            f"nrmse, {worst}",
            number=after.worst or before.worst,
        ),
        p.fact(
            "Findings",
            len(findings),
            v.whole,
            ", ".join(counts) or "nothing stands out",
        ),
        p.fact(
            "Data faults", len(faults), v.whole, "", p.POOR if faults else p.GOOD
        ),
        p.fact("Cut-off", result.cutoff_hz, v.unit_of("Hz"), CUTOFF_REMARK),
    )


def _findings(findings: list[Finding], unit: str) -> p.Blocks:
    """The first page of findings, and those that are behind a fold."""
    numbered = list(enumerate(findings, start=1))
    first = numbered[:_FIRST]
    rest = numbered[_FIRST:]
    more = f"{len(rest)} more finding{'s' * (len(rest) > 1)}, of less gain"
    return [_finding_table(first, unit), _finding_table(rest, unit, more)]


def _finding_table(
    findings: list[tuple[int, Finding]], unit: str, folded: str = ""
) -> p.Table | None:
    def share(row: tuple[int, Finding]) -> Number:
        return None if _unknown(row[1]) else row[1].explained

    def after(row: tuple[int, Finding]) -> Number:
        return None if _unknown(row[1]) else row[1].holdout.rms_after

    return p.table(
        findings,
        [
            ("number:#", lambda r: str(r[0])),
            ("name:Effect", lambda r: _cause(r[1])),
            ("name:Joints", lambda r: r[1].joints),
            ("number:Explains", share, v.percent),
            (f"number:rms without it [{unit}]", lambda r: r[1].holdout.rms_before),
            (f"number:rms with it [{unit}]", after),
            ("text:Verdict", lambda r: _verdict(r[1])),
        ],
        "What the model lacks, most important first: its share of the given model's squared error, "
        "and the hold-out error of its moving joints without and with it, with all other findings.",
        folded,
    )


def _corrected_line(rows: list[FoundParameter]) -> list[tuple[str, str]]:
    if not rows:
        return []
    names = listed([row.name for row in rows], 1)
    words = "corrected by the data within the tolerance of given values"
    return [("", f"{names}: {words}, listed in report.html")]


def _corrected(rows: list[FoundParameter]) -> p.Table | None:
    return p.table(
        rows,
        [
            ("name:Parameter", "name"),
            ("number:Given", "given", v.number),
            *p.estimates("number:By the data", "number:± std"),
            ("text:Unit", "unit"),
        ],
        "Within the tolerance of given values, so that they are no findings, yet further off than "
        "comes by chance; the extended model has the corrected ones.",
        long="All {} values",
    )


def _verdict(part: Part) -> p.Cell:
    tones = {"named": p.GOOD, "undecided": p.FAIR}
    return p.Cell(part.verdict, tones.get(part.verdict, p.PLAIN))


def _finding_parts(
    findings: list[Finding], series: Series, unit: str
) -> tuple[p.Parts, p.Blocks]:
    """The leading findings and what is unknown, a part each, and the others behind their titles."""
    parts: p.Parts = []
    others: p.Blocks = []
    for k, finding in enumerate(findings):
        joints = v.few(finding.joints)
        title = f"Finding {k + 1}: {_cause(finding)}{' at ' * bool(joints)}{joints}"
        blocks: p.Blocks = [
            p.notes([_sentence(finding, unit)]),
            evidence_figure(k, finding, series, unit),
            _kinds(finding, unit),
            _parameters(finding),
            _rivals(finding),
        ]
        if k < _LEADING or _unknown(finding):
            parts.append((title, blocks))
        else:
            aside = f"{v.percent(finding.explained)}, {finding.verdict}"
            others.append((f"{title} ({aside})", blocks))
    return parts, others


def _kinds(finding: Finding, unit: str) -> p.Table | None:
    """The kinds of friction that one finding sums up."""
    return p.table(
        finding.parts,
        [
            ("name:Kind", lambda part: v.plain(part.effect)),
            ("name:Joints", "joints"),
            ("number:Explains", "explained", v.percent),
            (f"number:rms without it [{unit}]", "holdout.rms_before"),
            (f"number:rms with it [{unit}]", "holdout.rms_after"),
            ("text:Verdict", _verdict),
            ("text:Why undecided", _why),
        ],
        "Its kinds; which of them it is, is less certain than that there is friction.",
    )


def _why(part: Part, before: str = "") -> str:
    """Why a part is undecided, after some words; empty where it is named."""
    if part.doubt:
        return f"{before}{part.doubt}"
    names = [v.plain(rival.effect) for rival in part.rivals]
    alike = v.listing(list(dict.fromkeys(names)), "")
    return alike and f"{before}{alike} would look the same"


def _sentence(finding: Finding, unit: str) -> str:
    if _unknown(finding):
        return finding.sentence
    unit = finding.unit or unit
    before = finding.holdout.rms_before
    after = finding.holdout.rms_after
    error = f"{v.sentence(_cause(finding))[:-1]} was found."
    if before is not None and after is not None:
        where = "these joints" if len(finding.joints) > 1 else "this joint"
        error = (
            f"Without it, everything else that was found being kept, the rms on the hold-out at "
            f"{where} is {v.quantity(before, unit)} instead of {v.quantity(after, unit)}."
        )
    share = finding.explained
    if share is not None:
        error += f" That is {v.percent(share)} of the squared error that the given model leaves."
    sentence = f"{finding.sentence}. {error}"
    if finding.verdict != "undecided":
        return sentence
    doubt = finding.doubt or "the effects below explain these data as well"
    decides = (
        finding.experiment and f" Experiment that decides: {finding.experiment}."
    )
    return f"{sentence} It is not decided: {doubt}.{decides}"


def _parameters(finding: Finding) -> p.Table | None:
    rows = finding.parameters
    given = any(row.given is not None for row in rows)
    fixed = any(row.std is None for row in rows)
    return p.table(
        rows,
        [
            ("name:Parameter", "name"),
            ("number:Given", "given") if given else None,
            *p.estimates("number:Fitted"),
            (
                "text:Unit",
                "unit",
                lambda unit: "" if unit == "1" else unit.replace("^a", "ᵃ"),
            ),
        ],
        f"{'Value in the given model, and f' if given else 'F'}itted value with its standard "
        f"deviation{_WITHOUT_STD if fixed else ''}.",
        long="All {} fitted parameters",
    )


def _rivals(finding: Finding) -> p.Table | None:
    return p.table(
        finding.rivals,
        [
            ("name:Rival", "effect", v.plain),
            ("name:Joints", "joints"),
            ("text:Why it cannot be excluded", "why"),
            ("text:Experiment that settles it", "experiment"),
        ],
        "Other effects that look alike in these data, and the experiment that separates them. "
        "|cos| is 1 where both torques are proportional.",
    )


def _shares(joints: list[JointResidual], unit: str) -> p.Table | None:
    def share(key: str) -> p.Column:
        def cell(row: JointResidual) -> p.Cell:
            tone = p.POOR if row.telling == key else p.PLAIN
            return p.cell(row.shares.get(key), v.percent, tone)

        return f"number:{key}", cell

    return p.table(
        joints,
        [
            ("name:Joint", "name"),
            (f"number:rms [{unit}]", "rms"),
            *map(share, _QUANTITIES),
        ],
        "Error of the model as given while the joint moves, and the shares of its square that go "
        f"with one quantity (they overlap): ○ marks the simplest that explains it. {_MEANING}",
        "What the error goes with, joint by joint",
    )


def _errors(result: Diagnose, changed: bool) -> p.Table | None:
    unit = result.unit
    models = [("Given", result.simulation.joints)]
    if changed:
        models.append(("Extended", result.extended.joints))

    def column(label: str, model: int, key: str, write: p.Write) -> p.Column:
        return label, lambda row: getattr(row[model], key), write

    errors = {
        f"rms [{unit}]": ("rms", v.number),
        "nrmse": ("nrmse", v.percent),
        "r²": ("r2", v.number4),
    }

    same = ""
    if result.cutoff_hz is not None:
        same = f", all after the same filter ({v.quantity(result.cutoff_hz, 'Hz')})"
    return p.table(
        _pairs(result),
        [
            ("name:Joint", lambda r: r[0].name),
            *(
                column(f"number:{model}, {heading}", k, *error)
                for heading, error in errors.items()
                for k, (model, _) in enumerate(models)
            ),
        ],
        f"The model as given{' and with the findings added' * changed}, on the hold-out{same}; "
        "nrmse is rms over the measured torque's standard deviation.",
    )


def _unexplained(rows: list[Unexplained]) -> p.Blocks:
    sized = any(row.against_noise for row in rows)
    noise = bool(rows) and all(row.structure == _NOISE for row in rows)
    return [
        p.notes(["The residual looks like noise at every joint."] * noise, p.GOOD),
        p.table(
            rows,
            [
                ("name:Joint", "joint"),
                ("number:Share", "share", v.percent),
                ("text:Against the noise", "against_noise") if sized else None,
                (
                    "text:Structure",
                    lambda r: r.structure.removeprefix("structured: "),
                ),
            ],
            "What everything found leaves: share of the measured torque's variance, its size "
            "against the noise while the joint moves, and what it varies with.",
            f"The residual joint by joint ({len(rows)})" if noise else "",
        ),
    ]
