"""Section on identified parameters and how well they predict."""

from collections import Counter
from collections.abc import Callable

import numpy as np

from excitant.reports import page as p
from excitant.reports import values as v
from excitant.reports.figures.estimate import (
    forest_figure,
    forest_groups,
    friction_figure,
    owner_of,
    symbol_of,
)
from excitant.reports.figures.online import estimates_figure, payload_figure
from excitant.reports.figures.residual import residual_figure
from excitant.reports.figures.torque import Curves, over_holdout, torque_figure
from excitant.reports.values import Series
from excitant.results import (
    Determined,
    ExportedFile,
    Fault,
    Identify,
    LinkByLink,
    Mujoco,
    Number,
    Online,
    Payload,
    Stage,
)
from excitant.robots.parameters import STANDARD

CUTOFF_REMARK = (
    "errors are judged below it; measured and predicted torque are filtered alike"
)
_ENOUGH = 1.0  # excitation at which the last seconds say as much as the prior
_MESSAGES = 8  # shown without opening a fold
CURVES = Curves(
    "given",
    "identified",
    "identified model",
    "Measured torque and the models' predictions over the hold-out, below them the residuals: a "
    "residual with structure shows something that the model lacks.",
    band="half_width",
)
_IN_MUJOCO = Curves(
    "mujoco_given",
    "mujoco_identified",
    "identified model in MuJoCo",
    "Measured torque and what the two models, written as MJCF, need for the same motion in MuJoCo "
    "(inverse dynamics), through the same filter.",
)


def identify_section(result: Identify, series: Series) -> p.Section:
    """The identified model: errors before and after, and each parameter with its uncertainty."""
    joints = [row.name for row in result.joints]
    unit = result.unit
    notes = [note for note in result.notes if note != result.holdout]
    refusal = [result.refusal] * bool(result.refusal)
    return p.section(
        "Identification",
        _lead(result),
        [
            ("Key figures", [_facts(result), p.sentences(refusal, p.POOR)]),
            ("Files of the model", [exported_table(result.exported)]),
            ("Data faults", [fault_table(result.faults or [])]),
            ("Payload", _payload(result.payload)),
            ("Link by link", _link_by_link(result.link_by_link)),
            ("Masses and centres of mass", [_bodies(result)]),
            ("Friction and other effects", [_effects(result)]),
        ],
        _brief(result),
        [
            ("Friction curves", [friction_figure(result.joints, series)]),
            ("Error per joint", [_errors(result)]),
            (
                over_holdout(unit),
                [
                    torque_figure(joints, series, unit, CURVES),
                    _intervals(result, unit),
                ],
            ),
            (
                "Residual by position, velocity, load and frequency",
                [residual_figure(result, series)],
            ),
            ("In MuJoCo", _in_mujoco(result.mujoco, joints, series, unit)),
            *_online(result, series),
            (
                "Parameters, given and identified",
                [forest_figure(result.parameters)],
            ),
            ("Base parameters", [_repeats(result), _base_parameters(result)]),
            ("Standard parameters", [_parameter_table(result)]),
            (
                "How it was fitted",
                [_how(result), _physical(result), p.sentences(notes)],
            ),
        ],
    )


def _brief(result: Identify) -> p.Brief:
    """Error, hold-out, and links of a published model whose mass or centre moved by half."""
    consistent = result.physical.consistent
    errors, worst = v.errors(*_missed(result))
    physical = "physically consistent" if consistent else "not physical"
    error = f"hold-out error {errors} (nrmse, {worst}), {physical}"
    moved = [row.moved for row in result.links if row.moved and not result.refusal]
    if len(moved) > v.FEW:
        moved = [*moved[: v.FEW - 1], f"and {len(moved) - v.FEW + 1} more"]
    lines = [("" if k else "moved", words) for k, words in enumerate(moved)]
    holdout = f"{result.holdout}{_least_judged(result)}"
    files = refitted_line(result.exported)
    return ("identified", error), ("", holdout), *files, *lines


def _least_judged(result: Identify) -> str:
    """The least share of the hold-out's rows in which a joint moves, after a semicolon."""
    shares = {
        row.name: row.validate.judged
        for row in result.joints
        if row.validate.judged is not None
    }
    if not shares:
        return ""
    least = min(shares, key=lambda name: shares[name])
    if shares[least] == 1:
        return ""
    return f"; {v.percent(shares[least])} of its rows judged at {least}, the least"


def exported_table(files: list[ExportedFile]) -> p.Table | None:
    """How well what each file of the model holds predicts the hold-out; None without any."""

    def missing(row: ExportedFile) -> p.Cell:
        lacks = v.listing(row.lacks, "nothing")
        if not row.written:
            return p.Cell(f"not written, for it lacks {lacks}", p.POOR)
        return p.Cell(f"{lacks}{'; refitted' * row.refitted}")

    return p.table(
        files,
        [
            ("name:File", "file"),
            ("number:Error, worst joint", lambda row: _error(row, max)),
            ("number:median", lambda row: _error(row, np.median)),
            ("text:Lacks", missing),
        ],
        "Error on the hold-out (nrmse) of what a program reads from each file: what its format "
        "cannot hold is left out. Where a file is refitted, its friction, or bodies too, make up "
        "for that: they are not the model's. A file worse than the given model is not written.",
    )


def refitted_line(files: list[ExportedFile]) -> p.Brief:
    """Files that are refitted, with their errors, as a line; none without any."""
    errors = [
        f"{row.file} {_error(row, max)} at the worst joint, median {_error(row, np.median)}"
        for row in files
        if row.refitted and row.written
    ]
    if not errors:
        return ()
    why = "parameters there make up for what the format lacks"
    return (("refitted", f"{'; '.join(errors)} of the hold-out: {why}"),)


def _error(file: ExportedFile, pick: Callable[..., float]) -> str:
    nrmse = [x for x in file.nrmse if x is not None]
    return v.percent(pick(nrmse) if nrmse else None)


def fault_table(faults: list[Fault]) -> p.Table | None:
    """Data faults with their evidence; None without any."""
    return p.table(
        faults,
        [
            ("name:Recording", "recording"),
            ("name:Data fault", lambda r: p.Cell(v.plain(r.fault), p.POOR)),
            ("name:Joints", "joints", v.few),
            ("text:Detail", lambda r: f"{r.detail} ({_remedy(r)})"),
        ],
        "Faults of the data, found before any model was judged by them.",
        brief="data fault",
    )


def _remedy(fault: Fault) -> str:
    """What was done about a fault, or can be."""
    if fault.repaired:
        return "repaired"
    stated = f"--map: {fault.map}" if fault.map else ""
    if fault.repair:
        ways = f"--repair {fault.repair}", stated
        return f"not repaired; {'; '.join(filter(None, ways))}"
    if "gaps" in fault.evidence:
        return "nothing to repair: the stamps are right"
    if "open" in fault.evidence:
        return "not repaired; state in --map which it is"
    if "counts" in fault.evidence:
        return "not repaired; state in --map the rate"
    if fault.evidence.get("channel") == "inertia":
        return "not repaired; correct that file"
    if fault.fault == "wrong_mounting":
        return "not repaired; state the gravity in robot.yaml"
    known = "state it in --map" if fault.fault == "wrong_unit" else "record again"
    return f"not repaired; {stated or known}"


def _missed(result: Identify) -> tuple[v.Missed, v.Missed]:
    """What the given and the identified model miss of the hold-out's torque."""
    given = v.missed({row.name: row.baseline.nrmse for row in result.joints})
    return given, v.missed({row.name: row.validate.nrmse for row in result.joints})


def _lead(result: Identify) -> str:
    given, identified = _missed(result)
    subject = f"The identified model of {result.robot}"
    if identified.worst is None:
        return f"{subject} is described below."
    instead = ""
    if given.worst is not None:
        instead = f" instead of {v.percent(given.worst)} with the model as given"
    return (
        f"{subject} misses at most {v.percent(identified.worst)} of the measured torque of a joint "
        f"on the hold-out ({identified.joint}){instead} (rms over standard deviation). "
        f"{v.sentence(result.holdout)}"
    )


def _facts(result: Identify) -> p.Facts | None:
    physical = ("yes", p.GOOD) if result.physical.consistent else ("no", p.POOR)
    faults = Counter(v.plain(fault.fault) for fault in result.faults or [])
    kinds = v.listing(
        [f"{n} {kind}" for kind, n in faults.items()], "none was found"
    )
    count = None if result.faults is None else len(result.faults)
    given, identified = _missed(result)
    errors, worst = v.errors(given, identified)
    return p.facts(
        p.Fact(
            "Hold-out error",
            errors,
            f"given → identified; nrmse, {worst}",
            number=identified.worst,
        ),
        p.Fact(
            "Physically consistent",
            physical[0],
            "positive mass and inertia of every link",
            physical[1],
        ),
        p.fact("Data faults", count, v.whole, kinds, p.POOR if count else p.GOOD),
        p.fact("Cut-off", result.cutoff_hz, v.unit_of("Hz"), CUTOFF_REMARK),
    )


def _how(result: Identify) -> p.Facts | None:
    joints = Counter(v.plain(effect) for effect in result.effects)
    effects = [
        name if n == 1 else f"{name} ({n} joints)" for name, n in joints.items()
    ]
    count = len(result.base_parameters)
    return p.facts(
        p.Fact("Estimator", v.plain(result.estimator)),
        p.Fact("Effects", v.listing(effects), "besides the links' inertia"),
        p.fact("Base parameters", count, v.whole, "identifiable combinations"),
    )


def _errors(result: Identify) -> p.Table | None:
    unit = result.unit
    rows = result.joints
    same = ""
    if result.cutoff_hz is not None:
        same = f" after the same filter ({v.quantity(result.cutoff_hz, 'Hz')})"
    return p.table(
        rows,
        [
            ("name:Joint", "name"),
            (f"number:Model as given, rms [{unit}]", "baseline.rms"),
            (f"number:Identified, rms [{unit}]", "validate.rms"),
            (f"number:Unfiltered rms [{unit}]", "validate.rms_raw"),
            ("number:nrmse", "validate.nrmse", v.percent),
            ("number:r²", "validate.r2", v.number4),
            ("number:Rows judged", "validate.judged", v.percent),
            (f"number:All rows, rms [{unit}]", "validate.rms_all"),
            (f"number:Fitted data, rms [{unit}]", "train.rms"),
        ],
        f"Prediction error on the hold-out{same}, of the model as given and as identified; last, "
        "the error on the data it was fitted to. Rows at which the joint rests, where dry friction "
        "holds any torque, are judged in the column of all rows only. nrmse is rms over "
        "the measured torque's standard deviation.",
    )


def _intervals(result: Identify, unit: str) -> p.Table | None:
    interval = "validate.interval95"
    return p.table(
        [row for row in result.joints if row.validate.interval95],
        [
            ("name:Joint", "name"),
            (
                f"number:95\u00a0% interval of a reading, ± [{unit}]",
                f"{interval}.half_width",
            ),
            (
                f"number:of which by the parameters, ± [{unit}]",
                f"{interval}.half_width_parameters",
            ),
            ("number:Hold-out inside", f"{interval}.coverage", v.percent),
        ],
        "Interval for a new reading, from the uncertainty of the parameters and coloured noise; "
        "far less than 95\u00a0% of the hold-out inside means that the model lacks something.",
    )


def _in_mujoco(
    mujoco: Mujoco | None, joints: list[str], series: Series, unit: str
) -> p.Blocks:
    if mujoco is None:
        return []
    table = p.table(
        mujoco.joints,
        [
            ("name:Joint", "name"),
            (
                f"number:Model as given, rms [{unit}]",
                "given",
                lambda x: v.number(x and x.rms),
            ),
            (f"number:Identified, rms [{unit}]", "identified.rms"),
            ("number:nrmse", "identified.nrmse", v.percent),
            (
                "number:Differs from excitant by",
                "differs",
                lambda x: v.percent(x and round(x, 5)),
            ),
        ],
        f"Prediction error of the MJCF files in MuJoCo {mujoco.version}; last, how far "
        "MuJoCo is from excitant's own prediction (rms over the measured torque's standard "
        "deviation): where a joint turns back, dry friction takes 2 ms there, and what MJCF cannot "
        "hold is missing.",
    )
    return [
        table,
        torque_figure(joints, series, unit, _IN_MUJOCO),
        p.sentences(mujoco.notes, p.FAIR),
    ]


def _repeats(result: Identify) -> p.Table | None:
    return p.table(
        result.repeats,
        [
            ("name:Recording", "recording"),
            ("number:Estimates off by, in standard errors", "deviation", v.number),
        ],
        "How far the estimates of each recording lie from those of all, in standard errors, rms: "
        "about 1 where noise is all that differs.",
    )


def _base_parameters(result: Identify) -> p.Table | None:
    return p.table(
        result.base_parameters,
        [
            ("name:Link or joint", "link"),
            ("expression:Base parameter", "expression"),
            *p.estimates("number:Value (SI)", "number:± std (SI)"),
            ("number:Relative std", p.relative),
            *[("number:Spread (SI)", "spread", v.number)] * bool(result.repeats),
        ],
        "The combinations of parameters that the torque depends on. Spread: standard deviation by "
        "what several recordings say apart, which is that by noise where they agree. Relative "
        "standard deviation: ● below 5\u00a0%, ◐ below 30\u00a0%, ○ above; near zero it is large "
        "by nature.",
        long="All {} base parameters",
    )


def _parameter_table(result: Identify) -> p.Table | None:
    rows = result.parameters
    counts = Counter(row.category for row in rows)
    categories = ", ".join(f"{n} {category}" for category, n in counts.items())
    return p.table(
        rows,
        [
            ("name:Parameter", lambda r: r.name.removeprefix(f"{r.link}.")),
            ("name:Link", "link"),
            *p.estimates(),
            ("number:Relative std", p.relative),
            ("text:Unit", "unit"),
            ("number:Prior", "prior", v.number4),
            ("text:Category", "category"),
            ("text:Decided by", lambda r: p.decided(r.decided_by)),
        ],
        "Only what torque shows alone has a ±. Values decided by the prior, or by both, complete "
        "the model, but were not measured one by one.",
        f"All {len(rows)} parameters: {categories}",
    )


def _bodies(result: Identify) -> p.Table | None:
    """Masses and centres of mass, given and identified; None where no drive gain is known."""
    gains = result.drive_gain_Nm_per_A
    if gains is not None and not any(gains):
        return None

    def place(centre: list[Number]) -> str:
        return v.listing([v.whole(x and 1e3 * x) for x in centre])

    return p.table(
        result.links,
        [
            ("name:Link", "link"),
            ("number:Mass [kg]|given", "mass.given"),
            ("number:Mass [kg]|identified", "mass.value"),
            ("text:Mass [kg]|by", lambda r: p.decided(r.mass.decided_by)),
            ("number:Centre of mass [mm]|given", "centre.given", place),
            ("number:Centre of mass [mm]|identified", "centre.value", place),
            (
                "number:Centre of mass [mm]|moved by",
                "centre.shift",
                lambda x: v.whole(x and 1e3 * x),
            ),
            (
                "text:Centre of mass [mm]|by",
                lambda r: p.decided(r.centre.decided_by),
            ),
        ],
        "Centres of mass: x, y, z in the frame of the link's joint. Torque shows masses and "
        "centres of mass only in combinations (base parameters), of which the prior makes these: "
        "they complete the model, but were not measured one by one.",
    )


def _effects(result: Identify) -> p.Table | None:
    """Coefficients of friction and other effects, given and identified: a row per joint."""
    groups = {
        name: {owner_of(row): row for row in rows}
        for name, rows in forest_groups(result.parameters).items()
        if symbol_of(rows[0]) not in STANDARD
    }

    def columns(name: str) -> list[p.Column]:
        rows = groups[name]

        def given(owner: str) -> Number:
            return rows[owner].given if owner in rows else None

        known = any(row.given is not None for row in rows.values())
        return [
            *[(f"number:{name}|given", given)] * known,
            *p.estimates(
                f"number:{name}|identified", f"number:{name}|± std", rows.get
            ),
        ]

    owners = dict.fromkeys(owner for rows in groups.values() for owner in rows)
    return p.table(
        list(owners),
        [
            ("name:Joint", str),
            *(column for name in groups for column in columns(name)),
        ],
        "The given model has none where no given value stands.",
    )


def _physical(result: Identify) -> p.Notes | None:
    if result.physical.violations or not result.physical.consistent:
        return p.notes(result.physical.violations, p.POOR)
    sound = "Every link has positive mass and an inertia that a body of positive density has."
    return p.notes([sound], p.GOOD)


def _link_by_link(fit: LinkByLink | None) -> p.Blocks:
    if fit is None:
        return []
    by_link = " + ".join(str(len(stage.determined)) for stage in fit.stages)
    count = p.Fact(
        "Combinations determined",
        f"{fit.determined} of {fit.base_parameters}",
        f"{by_link}, from the last link inward",
        p.GOOD if fit.determined == fit.base_parameters else p.FAIR,
    )
    folds = ((f"Link {stage.link}", _stage(stage)) for stage in fit.stages)
    return [p.Facts((count,)), *folds]


def _stage(stage: Stage) -> p.Blocks:
    source = f"{stage.joint} does not move."
    if stage.recordings:
        recordings = v.listing(stage.recordings)
        source = f"Torque of {stage.joint}: {stage.rows} rows of {recordings}."
    missing = [Determined(expression, None, None) for expression in stage.missing]

    def verdict(row: Determined) -> p.Cell:
        if row in missing:
            return p.Cell("not shown", p.FAIR)
        return p.Cell("determined", p.GOOD)

    return [
        p.notes([source]),
        p.table(
            [*stage.determined, *missing],
            [
                ("expression:Combination", "expression"),
                ("text:Verdict", verdict),
                *p.estimates("number:Value (SI)", "number:± std (SI)"),
            ],
            "What the joint's own torque adds to what the links further out have shown; "
            f"{len(missing) or 'no'} combinations of this link keep the given value.",
        ),
    ]


def _payload(payload: Payload | None) -> p.Blocks:
    if payload is None:
        return []
    return [
        _payload_facts(payload),
        p.sentences(payload.shortcomings, p.FAIR),
        p.sentences(payload.notes),
        payload_figure(payload),
        p.table(
            payload.parameters,
            [
                ("name:Parameter", "name"),
                *p.estimates(),
                ("text:Unit", "unit"),
                (
                    "text:Decided by",
                    lambda r: "expectation" if r.prior_dominated else "data",
                ),
            ],
            "Standard parameters of the body about the frame of its joint, physically consistent. "
            "The motion does not show those decided by the expectation (a ball at the flange).",
        ),
    ]


def _payload_facts(payload: Payload) -> p.Facts:
    """Mass and centre of mass; good where two standard deviations are 2 % and 3 mm at most."""
    m = payload.mass.value
    s = payload.mass.std
    tone = p.GOOD if 2 * s <= 0.02 * abs(m) else p.FAIR
    remark = f"one standard deviation; held by {payload.link}"
    mass = f"{v.interval(m, s)}\u00a0kg"
    facts = [p.Fact("Mass", mass, remark, tone, m)]
    centre = payload.centre_of_mass
    for axis, c, std in zip("xyz", centre.value, centre.std, strict=True):
        tone = p.GOOD if 2 * std <= 3e-3 else p.FAIR
        value = f"{v.interval(1e3 * c, 1e3 * std)}\u00a0mm"
        label = f"Centre of mass, {axis}"
        facts.append(
            p.Fact(label, value, "in the frame of its joint", tone, 1e3 * c)
        )
    return p.Facts(facts)


def _online(result: Identify, series: Series) -> p.Parts:
    online = result.online
    if online is None:
        return []
    messages = p.table(
        online.messages,
        [("number:Time [s]", "t", v.number4), ("text:Message", "text")],
        "What the monitor said while the samples came in; it speaks when something changes.",
        long="All {} messages of the monitor",
        most=_MESSAGES,
    )
    return [
        ("On-line estimation", [_online_facts(online), messages]),
        ("Estimates over time", [estimates_figure(result, series)]),
    ]


def _online_facts(online: Online) -> p.Facts | None:
    state = ("yes", p.GOOD) if online.converged else ("not yet", p.FAIR)
    t = v.reals(online.history.t)
    level = v.reals(online.history.excitation_level)
    judged = np.isfinite(level)
    share = float((level[judged] >= _ENOUGH).mean()) if judged.any() else None
    span = np.ptp(t) if len(t) else None
    aged = "age of the newest instant"
    converging = (
        "every joint's torque is known better than one row of data shows it"
    )
    return p.facts(
        p.Fact("Converged", state[0], converging, state[1]),
        p.fact(
            "Exciting enough",
            share,
            v.percent,
            f"of the windows at {judged.sum()} looks",
        ),
        p.fact(
            "Delay",
            1e3 * online.delay_s,
            v.unit_of("ms"),
            f"{aged} that the estimate is of",
        ),
        p.fact("Duration", span, v.unit_of("s"), f"{len(t)} looks kept"),
    )
