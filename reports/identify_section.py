"""Section on identified parameters and how well they predict."""

from __future__ import annotations

from collections import Counter

from excitant.reports.cutoff_figure import cutoff_parts
from excitant.reports.design_section import CUTOFF_REMARK, known_facts, uncertain
from excitant.reports.differentiator_figure import differentiator_parts
from excitant.reports.fault_table import fault_table
from excitant.reports.file_list import file_list
from excitant.reports.interval_figure import essential_line, interval_table
from excitant.reports.link_by_link_section import link_by_link_parts
from excitant.reports.model import (
    GOOD,
    PLAIN,
    POOR,
    Cell,
    Fact,
    Facts,
    Figure,
    Notes,
    Section,
    Table,
    section,
    table,
)
from excitant.reports.online_section import online_parts
from excitant.reports.payload_section import payload_parts
from excitant.reports.reading import (
    Result,
    Series,
    at,
    joint_names,
    middle,
    real,
    records,
    text,
    words,
)
from excitant.reports.torque_figures import (
    Change,
    Curves,
    error_bars,
    over_holdout,
    torque_figure,
)
from excitant.reports.wording import (
    NONE,
    listing,
    number,
    percent,
    plain,
    quantity,
    sentence,
)

_FEW = 3  # notes that may stand among the key figures
_CURVES = Curves(
    "given",
    "model as given",
    "identified",
    "identified model",
    "Measured torque and the models' prediction over the hold-out, below it what each model "
    "leaves: a blue residual without shape is noise, one with shape is something the model lacks.",
    band="half_width",
)


def identify_section(result: Result, series: Series) -> Section:
    """The identified model: errors before and after, and each parameter with its uncertainty."""
    joints, unit = joint_names(result), text(result, "unit") or "N·m"
    elsewhere = {text(result, "holdout"), text(result, "differentiators", "why")}
    notes = [sentence(note) for note in words(result, "notes") if note and note not in elsewhere]
    few = len(notes) <= _FEW
    return section(
        "Identification",
        _lead(result),
        [
            ("Key figures", [_facts(result), Notes(tuple(notes)) if few and notes else None]),
            ("Data faults", [fault_table(result)]),
            *link_by_link_parts(result, unit),
            *payload_parts(result),
            ("Error per joint", [_bars(result, unit), _joint_table(result, unit)]),
            (
                over_holdout(unit),
                [torque_figure(joints, series, unit, _CURVES), interval_table(result, unit)],
            ),
            ("Notes on the fit", [None if few else Notes(tuple(notes))]),
            *cutoff_parts(result),
            *online_parts(result, series),
            *differentiator_parts(result, series),
            ("Base parameters", [essential_line(result), _base_table(result)]),
            ("Standard parameters", [_parameter_table(result)]),
            ("Physical consistency", [_physical(result)]),
            ("Files", [file_list(result)]),
        ],
    )


def _bars(result: Result, unit: str) -> Figure | None:
    rows = records(result, "joints")
    held_out = any(at(row, "validate") is not None for row in rows)
    after = "validate" if held_out else "train"
    changes = [
        Change(
            text(row, "name"),
            real(row, "baseline", "rms"),
            real(row, after, "rms"),
            real(row, "baseline", "nrmse"),
            real(row, after, "nrmse"),
        )
        for row in rows
    ]
    return error_bars(
        changes,
        unit,
        ("model as given", "identified model"),
        f"Prediction error per joint on the {'hold-out' if held_out else 'fitted data'}, as a "
        "share of the measured torque's standard deviation so that joints compare; beside each bar "
        f"the rms [{unit}]: shorter is better.",
    )


def _lead(result: Result) -> str:
    rows = records(result, "joints")
    before, after = (middle(rows, key, "nrmse") for key in ("baseline", "validate"))
    where = "on the hold-out"
    if after is None:
        after, where = middle(rows, "train", "nrmse"), "on the fitted data (nothing was held out)"
    subject = f"The identified model of {text(result, 'robot') or 'the arm'}"
    if after is None:
        return f"{subject} is described below."
    change = "" if before is None else f" instead of {percent(before)} with the model as given"
    held = sentence(text(result, "holdout"))
    return (
        f"{subject} misses {percent(after)} of the measured torque {where}{change} "
        f"(rms over standard deviation, median over joints).{f' {held}' if held else ''}"
    )


def _facts(result: Result) -> Facts | None:
    consistent = at(result, "physical", "consistent")
    physical = (
        {True: "yes", False: "no"}.get(consistent, NONE) if isinstance(consistent, bool) else NONE
    )
    tone = {"yes": GOOD, "no": POOR}.get(physical, PLAIN)
    joints = Counter(plain(effect) for effect in words(result, "effects"))
    effects = [name if n == 1 else f"{name} ({n} joints)" for name, n in joints.items()]
    count = len(records(result, "base_parameters"))
    return known_facts(
        [
            _error_fact(result),
            Fact("Physically consistent", physical, "every link a body that can exist", tone),
            Fact("Base parameters", str(count) if count else NONE, "all that torque can show"),
            Fact("Cut-off", quantity(at(result, "cutoff_hz"), "Hz"), CUTOFF_REMARK),
            Fact("Estimator", plain(text(result, "estimator"))),
            Fact("Effects", listing(effects), "besides the links' inertia"),
        ]
    )


def _error_fact(result: Result) -> Fact:
    rows = records(result, "joints")
    held = any(at(row, "validate") is not None for row in rows)
    before, after = (middle(rows, k, "nrmse") for k in ("baseline", ("train", "validate")[held]))
    change = percent(after)
    if before is not None and after is not None:
        change = f"{percent(before)} → {change}"
    where = "Hold-out error" if held else "Error of the fit"
    return Fact(where, change, "given → identified; nrmse, median over joints")


def _joint_table(result: Result, unit: str) -> Table | None:
    held = any(at(row, "validate") is not None for row in records(result, "joints"))
    judged = "validate" if held else "train"
    rows: list[list[Cell | str]] = [
        [
            text(row, "name"),
            number(at(row, "baseline", "rms")),
            number(at(row, judged, "rms")),
            number(at(row, judged, "rms_raw")),
            percent(at(row, judged, "nrmse")),
            number(at(row, judged, "r2"), 4),
            *([number(at(row, "train", "rms"))] if held else []),
        ]
        for row in records(result, "joints")
    ]
    if not rows:
        return None
    cutoff = real(result, "cutoff_hz")
    same = "" if cutoff is None else f" after the same filter ({quantity(cutoff, 'Hz')})"
    return table(
        f"name:Joint | number:Model as given, rms [{unit}] | number:Identified, rms [{unit}] | "
        f"number:Unfiltered rms [{unit}] | number:nrmse | number:r²"
        + (f" | number:Fitted data, rms [{unit}]" if held else ""),
        rows,
        f"Error of the prediction on the {'hold-out' if held else 'fitted data'}{same}: as given, "
        "then as identified"
        + (
            ", at last what the identified model leaves of the data it was fitted to"
            if held
            else ""
        )
        + ". nrmse is rms over the measured torque's standard deviation.",
    )


def _base_table(result: Result) -> Table | None:
    rows: list[list[Cell | str]] = [
        [text(row, "expression"), *uncertain(row), text(row, "unit")]
        for row in records(result, "base_parameters")
    ]
    if not rows:
        return None
    si = "" if any(row[-1] for row in rows) else " (SI)"
    columns = f"expression:Base parameter | number:Value{si} | number:Std{si} | number:Relative std"
    return table(
        columns + ("" if si else " | name:Unit"),
        [row[:-1] for row in rows] if si else rows,
        "The combinations of parameters that the torque depends on. Relative standard deviation: "
        "● below 5\u00a0%, ◐ below 30\u00a0%, ○ above; near zero it is large by nature.",
        f"All {len(rows)} base parameters" if len(rows) > 12 else "",
    )


def _parameter_table(result: Result) -> Table | None:
    found = records(result, "parameters")
    if not found:
        return None
    counts = Counter(plain(text(row, "category")) for row in found if text(row, "category"))
    rows: list[list[Cell | str]] = [
        [
            text(row, "name").removeprefix(f"{text(row, 'link')}."),
            text(row, "link") or NONE,
            *uncertain(row),
            text(row, "unit") or NONE,
            number(at(row, "prior"), 4),
            plain(text(row, "category")) or NONE,
            "prior" if at(row, "prior_dominated") is True else "data",
        ]
        for row in found
    ]
    return table(
        "name:Parameter | name:Link | number:Value | number:Std | number:Relative std | "
        "name:Unit | number:Before | text:Category | text:Value comes from",
        rows,
        "Values that come from the prior are those the data leave open: they complete the model, "
        "but were not measured.",
        f"All {len(rows)} parameters: "
        + (", ".join(f"{n} {category}" for category, n in counts.items()) or "values"),
    )


def _physical(result: Result) -> Notes | None:
    violations = words(result, "physical", "violations")
    if violations:
        return Notes(tuple(violations), POOR)
    if at(result, "physical", "consistent") is True:
        sentence = (
            "Every link has positive mass and an inertia that a body of positive density has."
        )
        return Notes((sentence,), GOOD)
    return None
