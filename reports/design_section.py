"""Sections on an excitation motion: designed, or only checked."""

from __future__ import annotations

from collections.abc import Mapping

from excitant.reports.design_figures import convergence_figure, spectrum_figure
from excitant.reports.design_motion_figure import envelope_of, motion_figure, share_of_limit
from excitant.reports.design_space_figure import space_figure
from excitant.reports.design_weakness import direction_table, weakest_figure, weakest_table
from excitant.reports.file_list import file_list
from excitant.reports.link_by_link_section import link_motion_parts
from excitant.reports.model import (
    FAIR,
    GOOD,
    PLAIN,
    POOR,
    Cell,
    Fact,
    Facts,
    Notes,
    Section,
    Table,
    section,
    table,
)
from excitant.reports.reading import (
    Result,
    Series,
    at,
    items,
    joint_names,
    real,
    records,
    text,
    words,
    worst_points,
)
from excitant.reports.wording import NONE, number, percent, plain, quantity, sentence, value_and_std

_CRITERIA = {
    "condition": "best seen against worst seen: least ratio of singular values of W",
    "d": "least volume of uncertainty: greatest determinant of WᵀW",
    "a": "least mean variance: least trace of (WᵀW)⁻¹",
    "e": "worst seen direction: greatest least singular value of W",
}
_NAMES = {"condition": "condition number", "d": "D-optimal", "a": "A-optimal", "e": "E-optimal"}
_COLUMNS = {
    "friction": "of links, friction, offsets and rotors",
    "inertial": "of the links only",
}
CUTOFF_REMARK = "accuracy is judged below it; measured and model filtered alike"


def design_section(result: Result, series: Series) -> Section:
    """The designed motion: how well it excites, within which limits, and how it was found."""
    joints = joint_names(result)
    return section(
        "Excitation design",
        _design_lead(result),
        [
            ("Key figures", [_design_facts(result)]),
            *link_motion_parts(result),
            (
                "Motion against limits",
                [_limit_table(result), _joint_table(result), motion_figure(joints, result, series)],
            ),
            ("Path of the tool", [space_figure(result, series)]),
            ("What the motion makes visible", [spectrum_figure(series)]),
            (
                "What it shows worst",
                [weakest_figure(result), weakest_table(result), direction_table(result)],
            ),
            ("How it was found", [convergence_figure(result), _starts(result)]),
            ("Files", [file_list(result)]),
        ],
    )


def _design_lead(result: Result) -> str:
    initial, final = (real(result, "condition_number", k) for k in ("initial", "final"))
    motion = "The motion"
    if (duration := real(result, "duration")) is not None:
        motion = f"A motion of {quantity(duration, 's')}"
    stages = records(result, "link_by_link", "stages")
    if final is None:
        return f"{motion} was designed for {text(result, 'robot') or 'the arm'}."
    before = "" if initial is None else f", {number(initial)} at the start of the search"
    if stages:
        motion, before = f"{len(stages)} motions, one per link, of {quantity(duration, 's')}", ""
    holds = ""
    points = [point for point in worst_points(result) if point.ratio is not None]
    if points:
        all_hold = all(point.holds for point in points)
        holds = " All limits hold." if all_hold else " Not all limits hold: see below."
    reached = f"a condition number of {number(final)}{before}"
    if stages:
        return f"{motion} in all, reach {reached} or less each (1 would be best).{holds}"
    return f"{motion} reaches {reached} (1 would be best).{holds}"


def _design_facts(result: Result) -> Facts | None:
    bound = real(result, "condition_number", "lower_bound")
    stages = records(result, "link_by_link", "stages")
    facts = [
        Fact(
            "Condition number",
            number(at(result, "condition_number", "final")),
            (
                f"the worst of {len(stages)} links"
                if stages
                else f"from {number(at(result, 'condition_number', 'initial'))}"
            )
            + ("" if bound is None else f"; no motion below {number(bound)}"),
        ),
        _scaled(result),
        Fact("Duration", quantity(at(result, "duration"), "s"), _harmonics(result)),
        Fact("Base parameters", text(result, "base_parameters") or NONE, _columns(result)),
        Fact(
            "Criterion",
            _NAMES.get(text(result, "criterion"), plain(text(result, "criterion"))) or NONE,
            _CRITERIA.get(text(result, "criterion"), ""),
        ),
        _clearance(result),
        Fact("Search", quantity(at(result, "wall_s"), "s"), _effort(result)),
    ]
    return known_facts(facts)


def _clearance(result: Result) -> Fact:
    """Least distance, which holds between samples too."""
    distance = real(result, "clearance_m")
    at_least = NONE if distance is None else f"≥ {quantity(1e3 * distance, 'mm')}"
    return Fact("Clearance", at_least, "to obstacles and itself, between samples too")


def _scaled(result: Result) -> Fact:
    initial = real(result, "condition_number_scaled", "initial")
    return Fact(
        "Condition number, scaled",
        number(at(result, "condition_number_scaled", "final")),
        ("" if initial is None else f"from {number(initial)}; ") + "columns of W at unit length",
    )


def known_facts(facts: list[Fact]) -> Facts | None:
    """The facts that have a value."""
    known = tuple(fact for fact in facts if fact.value not in (NONE, ""))
    return Facts(known) if known else None


def _harmonics(result: Result) -> str:
    count = real(result, "harmonics")
    if count is None:
        return ""
    spline = text(result, "series") == "spline"  # twice as many pieces as harmonics
    return f"spline of {2 * count:.0f} pieces" if spline else f"{count:.0f} harmonics"


def _columns(result: Result) -> str:
    columns = text(result, "columns")
    return _COLUMNS.get(columns, f"columns: {plain(columns)}" if columns else "")


def _effort(result: Result) -> str:
    starts, iterations = len(records(result, "starts")), real(result, "iterations")
    parts = [f"{starts} starts"] if starts else []
    parts += [] if iterations is None else [f"{iterations:.0f} iterations"]
    return ", ".join(parts)


def _limit_table(result: Result) -> Table | None:
    rows: list[list[Cell | str]] = []
    for point in worst_points(result):
        share, verdict = NONE, Cell("no limit given")
        if point.ratio is not None:
            share = share_of_limit(point.ratio)
            verdict = Cell("holds", GOOD) if point.holds else Cell("exceeded", POOR)
        rows.append([point.quantity, share, verdict, point.joint or NONE, number(point.t)])
    if not rows:
        return None
    return table(
        "name:Quantity | number:Worst share of limit | text:Verdict | name:Joint | number:At [s]",
        rows,
        "The worst point of the continuous motion, also between samples: 100 % is the limit.",
    )


def _joint_table(result: Result) -> Table | None:
    """The certified share of each limit, joint by joint."""
    certified, joints = at(result, "certified"), joint_names(result)
    if not isinstance(certified, Mapping) or not joints:
        return None
    quantities = [
        str(q) for q in certified if any(isinstance(r, Mapping) for r in items(certified, q))
    ]
    if not quantities:
        return None
    rows: list[list[Cell | str]] = []
    for k, joint in enumerate(joints):
        shares = [envelope_of(result, quantity, k) for quantity in quantities]
        rows.append([joint, *(NONE if e is None else share_of_limit(e.ratio) for e in shares)])
    heads = " | ".join(f"number:{plain(quantity).capitalize()}" for quantity in quantities)
    return table(
        f"name:Joint | {heads}",
        rows,
        "Certified share of every joint's limit: where 100 % is reached, that limit bounds what "
        "the motion can show; a dash means no limit.",
        f"Share of the limits joint by joint ({len(joints)})",
    )


def _starts(result: Result) -> Table | None:
    rows: list[list[Cell | str]] = [
        [
            text(start, "start") or str(k),
            number(at(start, "condition_number"), 4),
            text(start, "iterations") or NONE,
            plain(text(start, "status")) or NONE,
        ]
        for k, start in enumerate(records(result, "starts"))
    ]
    if not rows:
        return None
    return table(
        "number:Start | number:Condition number | number:Iterations | text:Status",
        rows,
        "Every start of the search with where it ended.",
        f"All {len(rows)} starts" if len(rows) > 8 else "",
    )


def check_section(result: Result, series: Series) -> Section:
    """Whether somebody's trajectory keeps the limits, and how well it excites."""
    holds = at(result, "holds")
    name = text(result, "trajectory") or "The trajectory"
    arm = text(result, "robot") or "the arm"
    lead = f"{name} was checked."
    if isinstance(holds, bool):
        lead = f"{name} {'keeps all' if holds else 'does not keep the'} limits of {arm}."
    verdicts = [sentence(verdict) for verdict in words(result, "verdicts")]
    tone = PLAIN if not isinstance(holds, bool) else (GOOD if holds else POOR)
    facts = [
        Fact("Limits", {GOOD: "hold", POOR: "exceeded"}.get(tone, NONE), "", tone),
        Fact("Condition number", number(at(result, "condition_number"))),
        _clearance(result),
        Fact("Duration", quantity(at(result, "duration"), "s")),
    ]
    return section(
        "Trajectory check",
        lead,
        [
            ("Key figures", [known_facts(facts)]),
            ("Verdicts", [Notes(tuple(verdicts)) if verdicts else None]),
            (
                "Motion against limits",
                [
                    _limit_table(result),
                    _joint_table(result),
                    motion_figure(joint_names(result), result, series),
                ],
            ),
            ("Path of the tool", [space_figure(result, series)]),
            ("What the motion makes visible", [spectrum_figure(series)]),
        ],
    )


def quality(rel_std: object) -> str:
    """Tone of a relative standard deviation: below 5 % good, below 30 % fair, else poor."""
    x = real(rel_std)
    if x is None:
        return PLAIN
    return GOOD if abs(x) < 0.05 else FAIR if abs(x) < 0.3 else POOR


def uncertain(row: Result) -> list[Cell | str]:
    """Cells value, standard deviation and relative standard deviation of one estimate."""
    value, std = value_and_std(at(row, "value"), at(row, "std"))
    rel = at(row, "rel_std")
    if rel is None and real(row, "std") is not None and real(row, "value"):
        rel = abs(float(row["std"]) / float(row["value"]))
    return [value, std, Cell(percent(rel), quality(rel))]
