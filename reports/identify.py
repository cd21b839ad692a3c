"""Section on identified parameters and how well they predict."""

from __future__ import annotations

from collections import Counter

import numpy as np

from excitant.reports.identify_figures import (
    ENOUGH,
    convergence_figure,
    estimates_figure,
    excitation_figure,
    excitation_levels,
    history_of,
    link_bars,
    payload_figure,
    uncertainty_figure,
)
from excitant.reports.page import (
    FAIR,
    GOOD,
    PLAIN,
    POOR,
    Block,
    Brief,
    Cell,
    Fact,
    Facts,
    Figure,
    Notes,
    Parts,
    Section,
    Table,
    estimates,
    fact,
    facts,
    files,
    folded,
    notes,
    relative,
    section,
    table,
)
from excitant.reports.torque_figures import Curves, error_bars, over_holdout, torque_figure
from excitant.reports.values import (
    Result,
    Series,
    at,
    change,
    joint_names,
    listing,
    median,
    number,
    number4,
    percent,
    plain,
    quantity,
    real,
    reals,
    records,
    sentence,
    text,
    unit_of,
    value_and_std,
    whole,
    words,
)

CUTOFF_REMARK = "errors are judged below it; measured and predicted torque are filtered alike"
_FEW = 3  # notes that may stand among the key figures
_MESSAGES = 8  # shown without opening a fold
_BAND = 2.0  # standard deviations
_CURVES = Curves(
    "given",
    "model as given",
    "identified",
    "identified model",
    "Measured torque and the models' prediction over the hold-out; below it each model's residual: "
    "one without shape is noise, one with shape is something the model lacks.",
    band="half_width",
)


def identify_section(result: Result, series: Series) -> Section:
    """The identified model: errors before and after, and each parameter with its uncertainty."""
    joints, unit = joint_names(result), text(result, "unit") or "N·m"
    said = [sentence(n) for n in words(result, "notes") if n and n != text(result, "holdout")]
    few = len(said) <= _FEW
    return section(
        "Identification",
        _lead(result),
        [
            ("Key figures", [_facts(result), notes(said) if few else None]),
            ("Data faults", [fault_table(result)]),
            *_link_by_link(result, unit),
            ("Payload", _payload(at(result, "payload"))),
            ("Error per joint", [_bars(result, unit), _joint_table(result, unit)]),
            (
                over_holdout(unit),
                [torque_figure(joints, series, unit, _CURVES), _intervals(result, unit)],
            ),
            ("Notes on the fit", [None if few else notes(said)]),
            *_online(result, series),
            ("Base parameters", [_essential(result), _base_table(result)]),
            ("Standard parameters", [_parameter_table(result)]),
            ("Physical consistency", [_physical(result)]),
            ("Files", [files(words(result, "files"))]),
        ],
        _brief(result, unit),
    )


def _brief(result: Result, unit: str) -> Brief:
    rows = records(result, "joints")
    given, found = (
        sum(real(row, kind, "rms") or 0.0 for row in rows) for kind in ("baseline", "validate")
    )
    consistent = at(result, "physical", "consistent")
    said = (
        f"hold-out error, sum of joints, {number(given)} → {number(found)} {unit}, median r² "
        f"{number(median(rows, 'validate', 'r2'), 4)}, "
        f"{'physically consistent' if consistent else 'not physical'}"
    )
    return ("identified", said), ("", text(result, "holdout"))


def fault_table(result: Result) -> Table | None:
    """Data faults with their evidence; None without any."""
    return table(
        records(result, "faults"),
        [
            ("name:Recording", "recording"),
            ("name:Data fault", lambda r: Cell(plain(text(r, "fault")), POOR)),
            ("name:Joints", "joints"),
            ("text:Detail", "detail"),
        ],
        "Faults of the data, found before any model was judged by them.",
        brief="data fault",
    )


def _held_out(result: Result) -> bool:
    return any(at(row, "validate") is not None for row in records(result, "joints"))


def _lead(result: Result) -> str:
    rows = records(result, "joints")
    before, after = (median(rows, key, "nrmse") for key in ("baseline", "validate"))
    where = "on the hold-out"
    if after is None:
        after, where = median(rows, "train", "nrmse"), "on the fitted data (nothing was held out)"
    subject = f"The identified model of {text(result, 'robot') or 'the arm'}"
    if after is None:
        return f"{subject} is described below."
    instead = "" if before is None else f" instead of {percent(before)} with the model as given"
    held = sentence(text(result, "holdout"))
    return (
        f"{subject} misses {percent(after)} of the measured torque {where}{instead} "
        f"(rms over standard deviation, median over joints).{f' {held}' if held else ''}"
    )


def _facts(result: Result) -> Facts | None:
    rows, held = records(result, "joints"), _held_out(result)
    before, after = (median(rows, k, "nrmse") for k in ("baseline", ("train", "validate")[held]))
    consistent = at(result, "physical", "consistent")
    physical, tone = {True: ("yes", GOOD), False: ("no", POOR)}.get(consistent, ("", PLAIN))
    joints = Counter(plain(effect) for effect in words(result, "effects"))
    effects = [name if n == 1 else f"{name} ({n} joints)" for name, n in joints.items()]
    count = len(records(result, "base_parameters"))
    error = "Hold-out error" if held else "Error of the fit"
    remark = "given → identified; nrmse, median over joints"
    return facts(
        Fact(error, change(before, after, percent), remark, number=after),
        Fact("Physically consistent", physical, "positive mass and inertia of every link", tone),
        fact("Base parameters", count or None, whole, "identifiable combinations"),
        fact("Cut-off", at(result, "cutoff_hz"), unit_of("Hz"), CUTOFF_REMARK),
        Fact("Estimator", plain(text(result, "estimator"))),
        Fact("Effects", listing(effects), "besides the links' inertia"),
    )


def _bars(result: Result, unit: str) -> Figure | None:
    held = _held_out(result)
    after = "validate" if held else "train"
    errors = [
        (
            text(row, "name"),
            [(real(row, model, "rms"), real(row, model, "nrmse")) for model in ("baseline", after)],
        )
        for row in records(result, "joints")
    ]
    return error_bars(
        errors,
        unit,
        _CURVES,
        f"Prediction error per joint on the {'hold-out' if held else 'fitted data'}",
    )


def _joint_table(result: Result, unit: str) -> Table | None:
    held = _held_out(result)
    judged, where = ("validate", "hold-out") if held else ("train", "fitted data")
    cutoff = real(result, "cutoff_hz")
    same = "" if cutoff is None else f" after the same filter ({quantity(cutoff, 'Hz')})"
    return table(
        records(result, "joints"),
        [
            ("name:Joint", "name"),
            (f"number:Model as given, rms [{unit}]", "baseline.rms"),
            (f"number:Identified, rms [{unit}]", f"{judged}.rms"),
            (f"number:Unfiltered rms [{unit}]", f"{judged}.rms_raw"),
            ("number:nrmse", f"{judged}.nrmse", percent),
            ("number:r²", f"{judged}.r2", number4),
            (f"number:Fitted data, rms [{unit}]", "train.rms") if held else None,
        ],
        f"Prediction error on the {where}{same}, of the model as given and as identified"
        + ("; last, the error on the data it was fitted to" if held else "")
        + ". nrmse is rms over the measured torque's standard deviation.",
    )


def _intervals(result: Result, unit: str) -> Table | None:
    """Width and coverage of the intervals per joint; None where a run has none."""
    key = "validate.interval95"
    return table(
        [r for r in records(result, "joints") if real(r, *key.split("."), "half_width")],
        [
            ("name:Joint", "name"),
            (f"number:95\u00a0% interval of a reading, ± [{unit}]", f"{key}.half_width"),
            (f"number:of which by the parameters, ± [{unit}]", f"{key}.half_width_parameters"),
            ("number:Hold-out inside", f"{key}.coverage", percent),
        ],
        "How far off a new reading may be by the fitted data, with parameters and coloured noise "
        "counted; far less than 95\u00a0% of the hold-out inside means that the model lacks "
        "something.",
    )


def _essential(result: Result) -> Notes | None:
    """How many base parameters are essential; None where that was not asked."""
    kept, dropped = (len(words(result, "essential", key)) for key in ("kept", "dropped"))
    few, every = (real(result, "essential", key) for key in ("nrmse_essential", "nrmse_all"))
    if not kept + dropped:
        return None
    said = (
        f"{kept} of {kept + dropped} base parameters are essential: with the others at zero, least "
        f"squares misses {percent(few)} of the hold-out instead of {percent(every)} (median over "
        "joints)."
    )
    return Notes((said,))


def _base_table(result: Result) -> Table | None:
    rows = records(result, "base_parameters")
    units = any(text(row, "unit") for row in rows)
    si = "" if units else " (SI)"
    return table(
        rows,
        [
            ("expression:Base parameter", "expression"),
            *estimates(f"number:Value{si}", f"number:± std{si}"),
            ("number:Relative std", relative),
            ("text:Unit", "unit") if units else None,
        ],
        "The combinations of parameters that the torque depends on. Relative standard deviation: "
        "● below 5\u00a0%, ◐ below 30\u00a0%, ○ above; near zero it is large by nature.",
        folded(f"All {len(rows)} base parameters", len(rows)),
    )


def _parameter_table(result: Result) -> Table | None:
    rows = records(result, "parameters")
    counts = Counter(plain(text(row, "category")) for row in rows if text(row, "category"))
    categories = ", ".join(f"{n} {category}" for category, n in counts.items()) or "values"
    return table(
        rows,
        [
            ("name:Parameter", lambda r: text(r, "name").removeprefix(f"{text(r, 'link')}.")),
            ("name:Link", "link"),
            *estimates(),
            ("number:Relative std", relative),
            ("text:Unit", "unit"),
            ("number:Prior", "prior", number4),
            ("text:Category", "category", lambda c: plain(c or "")),
            ("text:Decided by", _decided),
        ],
        "Values decided by the prior are those the data leave open: they complete the model, but "
        "were not measured.",
        f"All {len(rows)} parameters: {categories}",
    )


def _decided(row: Result) -> str:
    return "prior" if at(row, "prior_dominated") is True else "data"


def _physical(result: Result) -> Notes | None:
    violations = words(result, "physical", "violations")
    if not violations and at(result, "physical", "consistent") is True:
        said = "Every link has positive mass and an inertia that a body of positive density has."
        return Notes((said,), GOOD)
    return notes(violations, POOR)


def _link_by_link(result: Result, unit: str) -> Parts:
    """Parts of the page that `identify --link-by-link` adds; none without its result."""
    found = at(result, "link_by_link")
    stages = records(found, "stages")
    if not stages:
        return []
    determined, total = real(found, "determined"), real(found, "base_parameters")
    each = " + ".join(str(len(records(stage, "determined"))) for stage in stages)
    count = Fact(
        "Combinations determined",
        f"{text(found, 'determined')} of {text(found, 'base_parameters')}",
        f"{each}, from the last link inward",
        GOOD if determined is not None and determined == total else FAIR,
    )
    comparison = table(
        records(found, "comparison", "joints"),
        [
            ("name:Joint", "name"),
            (f"number:Model as given, rms [{unit}]", "given"),
            (f"number:All links at once, rms [{unit}]", "all_at_once"),
            (f"number:Link by link, rms [{unit}]", "link_by_link"),
            ("number:Link by link / at once", _ratio),
        ],
        f"All links at once: {text(found, 'comparison', 'all_at_once')}.",
    )
    return [
        (
            "Link by link against all links at once",
            [Facts((count,)), link_bars(found, unit), comparison],
        ),
        *((f"Link {text(stage, 'link')}", _stage(stage)) for stage in stages),
    ]


def _ratio(row: Result) -> Cell:
    whole, stages = real(row, "all_at_once"), real(row, "link_by_link")
    ratio = stages / whole if whole and stages is not None else None
    return Cell(number(ratio), PLAIN, ratio)


def _stage(stage: Result) -> list[Block | None]:
    joint, used, rows = text(stage, "joint"), words(stage, "recordings"), real(stage, "rows")
    said = f"{joint} does not move."
    if used and rows is not None:
        said = (
            f"Torque of {joint}: {rows:.0f} rows of {listing(used)}; {joint} {text(stage, 'mode')}."
        )
    found, missing = records(stage, "determined"), words(stage, "missing")
    cells: list[Result] = [*found, *({"expression": each} for each in missing)]
    left = f"{len(missing)} more combinations of this link are not shown and keep the given value"
    return [
        Notes((said,)),
        table(
            cells,
            [
                ("expression:Combination", "expression"),
                (
                    "text:Verdict",
                    lambda r: Cell("determined", GOOD) if "value" in r else Cell("not shown", FAIR),
                ),
                *estimates("number:Value (SI)", "number:± std (SI)"),
            ],
            "What the joint's own torque adds to what the links further out have shown already; "
            f"{left if missing else 'nothing of this link is left open'}.",
            folded(
                f"{len(found)} combinations determined, {len(missing)} not shown", len(cells), 6
            ),
        ),
        notes([f"To identify the rest, {each}." for each in words(stage, "needed")], FAIR),
    ]


def _payload(payload: Result | None) -> list[Block | None]:
    """What the arm carries: mass, centre of mass and inertia, and how well they are known."""
    if payload is None:
        return []
    return [
        _payload_facts(payload),
        notes([sentence(each) for each in words(payload, "shortcomings")], FAIR),
        notes([sentence(each) for each in words(payload, "notes")]),
        payload_figure(payload),
        table(
            records(payload, "parameters"),
            [
                ("name:Parameter", "name"),
                *estimates(),
                ("text:Unit", "unit"),
                (
                    "text:Decided by",
                    lambda r: "expectation" if at(r, "prior_dominated") is True else "data",
                ),
            ],
            "Standard parameters of the body about the frame of its joint, physically consistent. "
            "The motion does not show those decided by the expectation (a ball at the flange).",
        ),
    ]


def _payload_facts(payload: Result) -> Facts | None:
    m, s = real(payload, "mass", "value"), real(payload, "mass", "std")
    if m is None:
        return None
    tone = PLAIN if s is None else GOOD if _BAND * s <= 0.02 * abs(m) else FAIR
    remark = f"one standard deviation; held by {text(payload, 'link')}"
    found = [Fact("Mass", f"{' ± '.join(value_and_std(m, s))}\u00a0kg", remark, tone, m)]
    centre, std = (1e3 * reals(payload, "centre_of_mass", key) for key in ("value", "std"))
    for axis, c, each in zip("xyz", centre, std, strict=False):
        value = f"{' ± '.join(value_and_std(c, each))}\u00a0mm"
        tone = GOOD if _BAND * each <= 3 else FAIR
        found.append(Fact(f"Centre of mass, {axis}", value, "in the frame of its joint", tone, c))
    return facts(*found)


def _online(result: Result, series: Series) -> Parts:
    """Parts of the page that `identify --online` adds; none without its result."""
    if at(result, "online") is None:
        return []
    history = history_of(result, series)
    rows = records(result, "online", "messages")
    messages = table(
        rows,
        [("number:Time [s]", "t", number4), ("text:Message", "text")],
        "What the monitor said while the samples came in; it speaks when something changes.",
        folded(f"All {len(rows)} messages of the monitor", len(rows), _MESSAGES),
    )
    return [
        ("On-line estimation", [_online_facts(result), messages]),
        ("Estimates over time", [uncertainty_figure(history), estimates_figure(history)]),
        ("Excitation over time", [excitation_figure(result)]),
        ("Convergence", [convergence_figure(result)]),
    ]


def _online_facts(result: Result) -> Facts | None:
    converged = at(result, "online", "converged")
    state = {True: "yes", False: "not yet"}.get(converged, "")
    t, level = excitation_levels(result)
    judged = np.isfinite(level)
    share = float((level[judged] >= ENOUGH).mean()) if judged.any() else None
    delay_s = real(result, "online", "delay_s")
    delay = None if delay_s is None else 1e3 * delay_s
    converging = "every joint's torque is known better than one row of data shows it"
    return facts(
        Fact("Converged", state, converging, GOOD if state == "yes" else FAIR),
        fact("Exciting enough", share, percent, f"of the windows at {judged.sum()} looks"),
        fact("Delay", delay, unit_of("ms"), "age of the newest instant that the estimate is of"),
        fact("Duration", np.ptp(t) if len(t) else None, unit_of("s"), f"{len(t)} looks kept"),
    )
