"""Section on identified parameters and how well they predict."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

import numpy as np

from excitant.reports import page as p
from excitant.reports import values as v
from excitant.reports.figures.error import error_bars
from excitant.reports.figures.estimate import (
    forest_figure,
    forest_groups,
    friction_figure,
)
from excitant.reports.figures.online import (
    ENOUGH,
    estimates_figure,
    excitation_figure,
    excitation_levels,
    payload_figure,
)
from excitant.reports.figures.residual import agreement_figure, residual_figure
from excitant.reports.figures.torque import Curves, over_holdout, torque_figure
from excitant.reports.values import Result, Series
from excitant.robots.parameters import STANDARD

CUTOFF_REMARK = (
    "errors are judged below it; measured and predicted torque are filtered alike"
)
_FEW = 3  # links that moved are told on the terminal
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


def identify_section(result: Result, series: Series) -> p.Section:
    """The identified model: errors before and after, and each parameter with its uncertainty."""
    joints = v.joint_names(result)
    unit = v.text(result, "unit") or "N·m"
    said = [
        v.sentence(n)
        for n in v.words(result, "notes")
        if n and n != v.text(result, "holdout")
    ]
    refusal = v.sentence(v.text(result, "refusal"))
    return p.section(
        "Identification",
        _lead(result),
        [
            (
                "Key figures",
                [_facts(result), p.notes([refusal] * bool(refusal), p.POOR)],
            ),
            ("Files of the model", [exported_table(result)]),
            ("Data faults", [fault_table(result)]),
            ("Payload", _payload(v.at(result, "payload"))),
            ("Link by link against all links at once", _link_by_link(result, unit)),
            ("Masses and centres of mass", [_bodies(result)]),
            ("Friction and other effects", [_effects(result)]),
        ],
        _brief(result, unit),
        [
            ("Friction curves", [friction_figure(result, series)]),
            ("Error per joint", _errors(result, unit)),
            (
                over_holdout(unit),
                [
                    torque_figure(joints, series, unit, CURVES),
                    _intervals(result, unit),
                ],
            ),
            (
                "Measured against predicted",
                [agreement_figure(result, series, unit)],
            ),
            (
                "Residual by position, velocity, load and frequency",
                [residual_figure(result, series, unit)],
            ),
            ("In MuJoCo", _in_mujoco(result, series, unit)),
            *_online(result, series),
            ("Parameters, given and identified", [forest_figure(result)]),
            ("Base parameters", _base_parameters(result)),
            ("Standard parameters", [_parameter_table(result)]),
            ("How it was fitted", [_how(result), _physical(result), p.notes(said)]),
        ],
    )


def _brief(result: Result, unit: str) -> p.Brief:
    """Error, hold-out, and the links whose mass or centre of mass moved by half."""
    rows = v.records(result, "joints")
    given, found = (v.median(rows, kind, "nrmse") for kind in ("baseline", "validate"))
    consistent = v.at(result, "physical", "consistent")
    said = (
        f"hold-out error {v.change(given, found, v.percent)} (nrmse, median over joints), "
        f"{'physically consistent' if consistent else 'not physical'}"
    )
    moved = [
        words for row in v.records(result, "links") if (words := v.text(row, "moved"))
    ]
    few = (
        moved
        if len(moved) <= _FEW
        else [*moved[: _FEW - 1], f"and {len(moved) - _FEW + 1} more"]
    )
    named = [("moved" if k == 0 else "", words) for k, words in enumerate(few)]
    return ("identified", said), ("", v.text(result, "holdout")), *named


def exported_table(result: Result) -> p.Table | None:
    """How well what each file of the model holds predicts the hold-out; None without any."""
    rows = v.records(result, "exported")

    def error(pick: Callable[..., float]) -> Callable[[Result], p.Cell]:
        def cell(row: Result) -> p.Cell:
            nrmse = [x for x in v.reals(row, "nrmse") if np.isfinite(x)]
            return p.Cell(v.percent(pick(nrmse)) if nrmse else v.NONE)

        return cell

    def missing(row: Result) -> p.Cell:
        lacks = v.listing(v.words(row, "lacks"), "nothing")
        if v.at(row, "written") is False:
            return p.Cell(f"not written, for it lacks {lacks}", p.POOR)
        return p.Cell(lacks)

    return p.table(
        rows,
        [
            ("name:File", "file"),
            ("number:Error, median joint", error(np.median)),
            ("number:worst joint", error(max)),
            ("text:Lacks", missing),
        ],
        "Error on the hold-out (nrmse) of what a program reads from each file: what its format "
        "cannot hold is left out. A file that is worse than the given model is not written.",
    )


def fault_table(result: Result) -> p.Table | None:
    """Data faults with their evidence; None without any."""
    return p.table(
        v.records(result, "faults"),
        [
            ("name:Recording", "recording"),
            ("name:Data fault", lambda r: p.Cell(v.plain(v.text(r, "fault")), p.POOR)),
            ("name:Joints", "joints"),
            ("text:Detail", lambda r: f"{v.text(r, 'detail')} ({_remedy(r)})"),
        ],
        "Faults of the data, found before any model was judged by them.",
        brief="data fault",
    )


def _remedy(fault: Result) -> str:
    """What was done about a fault, or can be."""
    left = v.text(fault, "repair") and f"--repair {v.text(fault, 'repair')}"
    return (
        "repaired"
        if v.at(fault, "repaired")
        else f"not repaired; {left or 'record again'}"
    )


def _held_out(result: Result) -> bool:
    return any(v.at(row, "validate") is not None for row in v.records(result, "joints"))


def _lead(result: Result) -> str:
    rows = v.records(result, "joints")
    before, after = (v.median(rows, key, "nrmse") for key in ("baseline", "validate"))
    where = "on the hold-out"
    if after is None:
        after = v.median(rows, "train", "nrmse")
        where = "on the fitted data (nothing was held out)"
    subject = f"The identified model of {v.text(result, 'robot') or 'the arm'}"
    if after is None:
        return f"{subject} is described below."
    instead = (
        ""
        if before is None
        else f" instead of {v.percent(before)} with the model as given"
    )
    held = v.sentence(v.text(result, "holdout"))
    return (
        f"{subject} misses {v.percent(after)} of the measured torque {where}{instead} "
        f"(rms over standard deviation, median over joints).{f' {held}' if held else ''}"
    )


def _facts(result: Result) -> p.Facts | None:
    rows = v.records(result, "joints")
    held = _held_out(result)
    before, after = (
        v.median(rows, k, "nrmse") for k in ("baseline", ("train", "validate")[held])
    )
    consistent = v.at(result, "physical", "consistent")
    physical, tone = {True: ("yes", p.GOOD), False: ("no", p.POOR)}.get(
        consistent, ("", p.PLAIN)
    )
    faults = Counter(
        v.plain(v.text(fault, "fault")) for fault in v.records(result, "faults")
    )
    kinds = v.listing([f"{n} {kind}" for kind, n in faults.items()], "none was found")
    error = "Hold-out error" if held else "Error of the fit"
    remark = "given → identified; nrmse, median over joints"
    found = sum(faults.values()) if "faults" in result else None
    return p.facts(
        p.Fact(error, v.change(before, after, v.percent), remark, number=after),
        p.Fact(
            "Physically consistent",
            physical,
            "positive mass and inertia of every link",
            tone,
        ),
        p.fact("Data faults", found, v.whole, kinds, p.POOR if found else p.GOOD),
        p.fact("Cut-off", v.at(result, "cutoff_hz"), v.unit_of("Hz"), CUTOFF_REMARK),
    )


def _how(result: Result) -> p.Facts | None:
    joints = Counter(v.plain(effect) for effect in v.words(result, "effects"))
    effects = [name if n == 1 else f"{name} ({n} joints)" for name, n in joints.items()]
    count = len(v.records(result, "base_parameters"))
    return p.facts(
        p.Fact("Estimator", v.plain(v.text(result, "estimator"))),
        p.Fact("Effects", v.listing(effects), "besides the links' inertia"),
        p.fact("Base parameters", count or None, v.whole, "identifiable combinations"),
    )


def _errors(result: Result, unit: str) -> p.Blocks:
    rows = v.records(result, "joints")
    held = _held_out(result)
    judged, where = ("validate", "hold-out") if held else ("train", "fitted data")
    cutoff = v.real(result, "cutoff_hz")
    same = (
        "" if cutoff is None else f" after the same filter ({v.quantity(cutoff, 'Hz')})"
    )
    what = f"Prediction error per joint on the {where}"
    models = ("baseline", judged)
    table = p.table(
        rows,
        [
            ("name:Joint", "name"),
            (f"number:Model as given, rms [{unit}]", "baseline.rms"),
            (f"number:Identified, rms [{unit}]", f"{judged}.rms"),
            (f"number:Unfiltered rms [{unit}]", f"{judged}.rms_raw"),
            ("number:nrmse", f"{judged}.nrmse", v.percent),
            ("number:r²", f"{judged}.r2", v.number4),
            (f"number:Fitted data, rms [{unit}]", "train.rms") if held else None,
        ],
        f"Prediction error on the {where}{same}, of the model as given and as identified"
        + ("; last, the error on the data it was fitted to" if held else "")
        + ". nrmse is rms over the measured torque's standard deviation.",
    )
    return [error_bars(rows, models, unit, CURVES.after_label, what), table]


def _intervals(result: Result, unit: str) -> p.Table | None:
    key = "validate.interval95"
    by = "parameters and lengths" if "lengths" in result else "parameters"
    return p.table(
        [
            r
            for r in v.records(result, "joints")
            if v.real(r, *key.split("."), "half_width")
        ],
        [
            ("name:Joint", "name"),
            (
                f"number:95\u00a0% interval of a reading, ± [{unit}]",
                f"{key}.half_width",
            ),
            (
                f"number:of which by the {by}, ± [{unit}]",
                f"{key}.half_width_parameters",
            ),
            ("number:Hold-out inside", f"{key}.coverage", v.percent),
        ],
        f"Interval for a new reading, from the uncertainty of the {by} and coloured noise; "
        "far less than 95\u00a0% of the hold-out inside means that the model lacks something.",
    )


def _in_mujoco(result: Result, series: Series, unit: str) -> p.Blocks:
    found = v.at(result, "mujoco")
    if found is None:
        return []
    table = p.table(
        v.records(found, "joints"),
        [
            ("name:Joint", "name"),
            (f"number:Model as given, rms [{unit}]", "given.rms"),
            (f"number:Identified, rms [{unit}]", "identified.rms"),
            ("number:nrmse", "identified.nrmse", v.percent),
            (
                "number:Differs from excitant by",
                "differs",
                lambda x: v.percent(round(x, 5)),
            ),
        ],
        f"Prediction error of the MJCF files in MuJoCo {v.text(found, 'version')}; last, how far "
        "MuJoCo is from excitant's own prediction (rms over the measured torque's standard "
        "deviation): where a joint turns back, dry friction takes 2 ms there, and what MJCF cannot "
        "hold is missing.",
    )
    figure = torque_figure(v.joint_names(result), series, unit, _IN_MUJOCO)
    return [
        table,
        figure,
        p.notes([v.sentence(n) for n in v.words(found, "notes")], p.FAIR),
    ]


def _base_parameters(result: Result) -> p.Blocks:
    kept, dropped = (
        len(v.words(result, "essential", key)) for key in ("kept", "dropped")
    )
    few, every = (
        v.real(result, "essential", key) for key in ("nrmse_essential", "nrmse_all")
    )
    said = (
        f"{kept} of {kept + dropped} base parameters are essential: with the others at zero, "
        f"least squares misses {v.percent(few)} of the hold-out instead of {v.percent(every)} "
        "(median over joints)."
    )
    rows = v.records(result, "base_parameters")
    units = any(v.text(row, "unit") for row in rows)
    si = "" if units else " (SI)"
    table = p.table(
        rows,
        [
            ("expression:Base parameter", "expression"),
            *p.estimates(f"number:Value{si}", f"number:± std{si}"),
            ("number:Relative std", p.relative),
            ("text:Unit", "unit") if units else None,
        ],
        "The combinations of parameters that the torque depends on. Relative standard deviation: "
        "● below 5\u00a0%, ◐ below 30\u00a0%, ○ above; near zero it is large by nature.",
        p.folded(f"All {len(rows)} base parameters", len(rows)),
    )
    return [p.notes([said] * bool(kept + dropped)), table]


def _parameter_table(result: Result) -> p.Table | None:
    rows = v.records(result, "parameters")
    counts = Counter(
        v.plain(v.text(row, "category")) for row in rows if v.text(row, "category")
    )
    categories = (
        ", ".join(f"{n} {category}" for category, n in counts.items()) or "values"
    )
    return p.table(
        rows,
        [
            (
                "name:Parameter",
                lambda r: v.text(r, "name").removeprefix(f"{v.text(r, 'link')}."),
            ),
            ("name:Link", "link"),
            *p.estimates(),
            ("number:Relative std", p.relative),
            ("text:Unit", "unit"),
            ("number:Prior", "prior", v.number4),
            ("text:Category", "category", lambda c: v.plain(c or "")),
            ("text:Decided by", lambda r: p.decided(v.text(r, "decided_by"))),
        ],
        "Values decided by the prior are those the data leave open: they complete the model, but "
        "were not measured.",
        f"All {len(rows)} parameters: {categories}",
    )


def _bodies(result: Result) -> p.Table | None:
    """Masses and centres of mass, given and identified."""

    def centre(key: str) -> Callable[[Result], str]:
        return lambda row: v.listing(
            [v.whole(1e3 * x) for x in v.reals(row, "centre", key)]
        )

    def moved(row: Result) -> dict[str, float | None]:
        known = (v.real(row, "centre", key) for key in ("shift", "shift_std"))
        return dict(zip(("value", "std"), (x and 1e3 * x for x in known), strict=True))

    return p.table(
        [{**row, "moved": moved(row)} for row in v.records(result, "links")],
        [
            ("name:Link", "link"),
            ("number:Mass [kg]|given", "mass.given"),
            *p.estimates(
                "number:Mass [kg]|identified", "number:Mass [kg]|± std", "mass"
            ),
            ("text:Mass [kg]|by", lambda r: p.decided(v.text(r, "mass", "decided_by"))),
            ("number:Centre of mass [mm]|given", centre("given")),
            ("number:Centre of mass [mm]|identified", centre("value")),
            *p.estimates(
                "number:Centre of mass [mm]|moved by",
                "number:Centre of mass [mm]|± std",
                "moved",
            ),
            (
                "text:Centre of mass [mm]|by",
                lambda r: p.decided(v.text(r, "centre", "decided_by")),
            ),
        ],
        "Centres of mass: x, y, z in the frame of the link's joint. What the prior decides "
        "completes the model, but was not measured.",
    )


def _effects(result: Result) -> p.Table | None:
    """Coefficients of friction and other effects, given and identified: a row per joint."""
    found = {
        name: {v.text(row, "owner"): row for row in rows}
        for name, rows in forest_groups(result).items()
        if v.text(rows[0], "symbol") not in STANDARD
    }
    owners = dict.fromkeys(owner for rows in found.values() for owner in rows)
    columns: list[p.Column | None] = [("name:Joint", "owner")]
    for name, rows in found.items():
        given = any(v.real(row, "given") is not None for row in rows.values())
        columns += [
            (f"number:{name}|given", f"{name}.given", v.number) if given else None,
            *p.estimates(f"number:{name}|identified", f"number:{name}|± std", name),
        ]
    return p.table(
        [
            {"owner": owner, **{name: rows.get(owner) for name, rows in found.items()}}
            for owner in owners
        ],
        columns,
        "The given model has none where no given value stands.",
    )


def _physical(result: Result) -> p.Notes | None:
    violations = v.words(result, "physical", "violations")
    if not violations and v.at(result, "physical", "consistent") is True:
        said = "Every link has positive mass and an inertia that a body of positive density has."
        return p.notes([said], p.GOOD)
    return p.notes(violations, p.POOR)


def _link_by_link(result: Result, unit: str) -> p.Blocks:
    found = v.at(result, "link_by_link")
    stages = v.records(found, "stages")
    rows = v.records(found, "comparison", "joints")
    if not stages:
        return []
    determined = v.real(found, "determined")
    total = v.real(found, "base_parameters")
    each = " + ".join(str(len(v.records(stage, "determined"))) for stage in stages)
    count = p.Fact(
        "Combinations determined",
        f"{v.text(found, 'determined')} of {v.text(found, 'base_parameters')}",
        f"{each}, from the last link inward",
        p.GOOD if determined is not None and determined == total else p.FAIR,
    )
    models = {"given": "Model as given", "all_at_once": "All links at once"}
    models["link_by_link"] = "Link by link"
    comparison = p.table(
        rows,
        [
            ("name:Joint", "name"),
            *((f"number:{name}, rms [{unit}]", key) for key, name in models.items()),
        ],
        "Prediction error on the hold-out, fitted to the same recordings. All links at once: "
        f"{v.text(found, 'comparison', 'all_at_once')}.",
    )
    folds = ((f"Link {v.text(stage, 'link')}", _stage(stage)) for stage in stages)
    return [p.Facts((count,)), comparison, *folds]


def _stage(stage: Result) -> p.Blocks:
    joint = v.text(stage, "joint")
    used = v.words(stage, "recordings")
    rows = v.real(stage, "rows")
    said = f"{joint} does not move."
    if used and rows is not None:
        moves = f"{joint} {v.text(stage, 'mode')}"
        said = f"Torque of {joint}: {rows:.0f} rows of {v.listing(used)}; {moves}."
    missing = [{"expression": each} for each in v.words(stage, "missing")]
    verdict = {True: p.Cell("determined", p.GOOD), False: p.Cell("not shown", p.FAIR)}
    return [
        p.notes([said]),
        p.table(
            [*v.records(stage, "determined"), *missing],
            [
                ("expression:Combination", "expression"),
                ("text:Verdict", lambda r: verdict["value" in r]),
                *p.estimates("number:Value (SI)", "number:± std (SI)"),
            ],
            "What the joint's own torque adds to what the links further out have shown; "
            f"{len(missing) or 'no'} combinations of this link keep the given value.",
        ),
        p.notes(
            [f"To identify the rest, {each}." for each in v.words(stage, "needed")],
            p.FAIR,
        ),
    ]


def _payload(payload: Result | None) -> p.Blocks:
    if payload is None:
        return []
    return [
        _payload_facts(payload),
        p.notes(
            [v.sentence(each) for each in v.words(payload, "shortcomings")], p.FAIR
        ),
        p.notes([v.sentence(each) for each in v.words(payload, "notes")]),
        payload_figure(payload),
        p.table(
            v.records(payload, "parameters"),
            [
                ("name:Parameter", "name"),
                *p.estimates(),
                ("text:Unit", "unit"),
                (
                    "text:Decided by",
                    "prior_dominated",
                    lambda x: "expectation" if x else "data",
                ),
            ],
            "Standard parameters of the body about the frame of its joint, physically consistent. "
            "The motion does not show those decided by the expectation (a ball at the flange).",
        ),
    ]


def _payload_facts(payload: Result) -> p.Facts | None:
    """Mass and centre of mass; good where two standard deviations are 2 % and 3 mm at most."""
    m = v.real(payload, "mass", "value")
    s = v.real(payload, "mass", "std")
    if m is None:
        return None
    tone = p.PLAIN if s is None else p.GOOD if 2 * s <= 0.02 * abs(m) else p.FAIR
    remark = f"one standard deviation; held by {v.text(payload, 'link')}"
    found = [
        p.Fact("Mass", f"{' ± '.join(v.value_and_std(m, s))}\u00a0kg", remark, tone, m)
    ]
    centre, std = (
        1e3 * v.reals(payload, "centre_of_mass", key) for key in ("value", "std")
    )
    for axis, c, each in zip("xyz", centre, std, strict=False):
        label = f"Centre of mass, {axis}"
        tone = p.GOOD if 2 * each <= 3 else p.FAIR
        value = f"{' ± '.join(v.value_and_std(c, each))}\u00a0mm"
        found.append(p.Fact(label, value, "in the frame of its joint", tone, c))
    return p.facts(*found)


def _online(result: Result, series: Series) -> p.Parts:
    if v.at(result, "online") is None:
        return []
    rows = v.records(result, "online", "messages")
    messages = p.table(
        rows,
        [("number:Time [s]", "t", v.number4), ("text:Message", "text")],
        "What the monitor said while the samples came in; it speaks when something changes.",
        p.folded(f"All {len(rows)} messages of the monitor", len(rows), _MESSAGES),
    )
    return [
        ("On-line estimation", [_online_facts(result), messages]),
        ("Estimates over time", [estimates_figure(result, series)]),
        ("Excitation over time", [excitation_figure(result)]),
    ]


def _online_facts(result: Result) -> p.Facts | None:
    state = {True: "yes", False: "not yet"}.get(v.at(result, "online", "converged"), "")
    t, level = excitation_levels(result)
    judged = np.isfinite(level)
    share = float((level[judged] >= ENOUGH).mean()) if judged.any() else None
    delay_s = v.real(result, "online", "delay_s")
    span = np.ptp(t) if len(t) else None
    delay = None if delay_s is None else 1e3 * delay_s
    aged = "age of the newest instant"
    converging = "every joint's torque is known better than one row of data shows it"
    return p.facts(
        p.Fact("Converged", state, converging, p.GOOD if state == "yes" else p.FAIR),
        p.fact(
            "Exciting enough",
            share,
            v.percent,
            f"of the windows at {judged.sum()} looks",
        ),
        p.fact("Delay", delay, v.unit_of("ms"), f"{aged} that the estimate is of"),
        p.fact("Duration", span, v.unit_of("s"), f"{len(t)} looks kept"),
    )
