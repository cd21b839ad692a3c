"""Sections on a motion: designed, checked, or rehearsed on a virtual arm."""

from typing import Any

import numpy as np

from excitant.reports import page as p
from excitant.reports import values as v
from excitant.reports.figures.motion import (
    Limits,
    motion_figure,
    share_of_limit,
)
from excitant.reports.figures.search import spectrum_figure
from excitant.reports.player import FULL, moments, player
from excitant.reports.values import NONE, Series
from excitant.results import (
    Check,
    Design,
    Determined,
    HalfSpace,
    Motion,
    Pair,
    Persistency,
    Rehearse,
    Requirement,
    Show,
)

_CRITERIA = {
    "condition": (
        "condition number",
        "least ratio of the extreme singular values of W",
    ),
    "d": ("D-optimal", "least volume of uncertainty: greatest determinant of WᵀW"),
    "a": ("A-optimal", "least mean variance: least trace of (WᵀW)⁻¹"),
    "e": ("E-optimal", "greatest least singular value of W"),
}
_COLUMNS = {
    "friction": "of links, friction, offsets and rotors",
    "inertial": "of the links only",
}


def design_section(result: Design, series: Series) -> p.Section:
    """The designed motion: how well it excites, within which limits, and how it was found."""
    kappa = _change(result.condition_number)
    scaled = _change(result.condition_number_scaled)
    worst = _worst_ratio(result)
    weak = [row.name for row in result.weakest[:3]]
    least = f"with columns scaled {scaled}; excited least: {v.listing(weak)}"
    return p.section(
        "Excitation design",
        _lead(result),
        [
            ("Key figures", [_facts(result), p.sentences(result.notes, brief="")]),
            ("The arm in motion", [player(result, series)]),
            ("One motion per link", [_link_motions(result)]),
        ],
        (
            (
                "designed",
                f"condition number {kappa}, limits used up to {v.percent(worst, 4)}"
                f"{_unchecked(result)}",
            ),
            *[("", least)] * bool(weak),
        ),
        [
            *_motion(result, series),
            ("Least excited parameters", [_weakest(result)]),
            ("The search", [_starts(result)]),
        ],
    )


def excitation_sentence(persistency: Persistency | None) -> list[str]:
    """How many of all combinations a motion shows, as a sentence; none where not judged."""
    if persistency is None:
        return []
    return [v.sentence(f"this motion is {persistency.sentence}")]


def check_section(result: Check, series: Series) -> p.Section:
    """Whether somebody's trajectory keeps the limits, and how well it excites."""
    kappa = result.condition_number
    verdicts = result.verdicts
    excited = excitation_sentence(result.persistency)
    limits = ("hold", p.GOOD) if result.holds else ("exceeded", p.POOR)
    key_figures = p.facts(
        p.Fact("Limits", limits[0], tone=limits[1]),
        p.fact(
            "Condition number", kappa, v.condition, _columns(result.columns or "")
        ),
        _clearance(result),
        _duration(result.duration),
    )
    return p.section(
        "Trajectory check",
        _kept_sentence(result),
        [
            ("Key figures", [key_figures]),
            ("Verdicts", [p.sentences(verdicts)]),
            ("The arm in motion", [player(result, series)]),
            ("Excitation", [p.notes(excited)]),
            *_motion(result, series),
        ],
        (
            *(
                ("", verdict) if k else ("checked", verdict + _unchecked(result))
                for k, verdict in enumerate(verdicts)
            ),
            (
                "",
                f"condition number {v.condition(kappa)} ({result.columns or ''} columns)",
            ),
            *(("", words) for words in excited),
        ),
    )


def show_section(result: Show, series: Series) -> p.Section:
    """A motion to watch."""
    touched = [(f"{moment.t:.4g} s", moment.words) for moment in moments(result)]
    return p.section(
        "Motion",
        _kept_sentence(result),
        [
            ("The arm in motion", [player(result, series)]),
            ("Verdicts", [p.sentences(result.verdicts)]),
        ],
        (("checked", v.listing(result.verdicts) + _unchecked(result)), *touched),
    )


def _kept_sentence(result: Check | Show) -> str:
    keeps = "keeps all limits" if result.holds else "exceeds limits"
    name = result.trajectory or "The trajectory"
    return f"{name} {keeps} of {result.robot}{_unchecked(result)}."


def _unchecked(result: Motion) -> str:
    left = result.unchecked
    return f"; not checked: {left}" if left else ""


def rehearse_section(result: Rehearse, series: Series) -> p.Section:
    """Whether a motion suffices, requirement by requirement."""
    rows = result.items
    passed = result.passed
    hidden = v.plain(result.effect.effect)
    met = sum(row.passed for row in rows)
    recovered = [row for row in rows if None not in (row.planted, row.recovered)]
    key_figures = p.facts(
        p.Fact(
            "Verdict", "go" if passed else "no go", "", p.GOOD if passed else p.POOR
        ),
        p.Fact("Requirements met", f"{met} of {len(rows)}", number=met),
        _duration(result.duration),
        p.Fact("Planted change", hidden, result.effect.joint),
    )
    requirements = p.table(
        rows,
        [
            ("text:Met", lambda row: _verdict(row.passed, "met", "NOT MET")),
            ("name:Requirement", "name"),
            ("name:Joint", "joint"),
            ("text:Figures", "detail"),
        ],
        "The virtual arm has usual friction, rotor inertia, offsets and noise, and inertias off by "
        "up to 5 %; one more effect changes later. The motion must show all of it.",
        brief="",
    )
    # of that requirement, the change that it must name
    planted = {"diagnosis": hidden}
    table = p.table(
        recovered,
        [
            ("name:Quantity", "name", lambda name: str(planted.get(name, name))),
            ("name:Joint", "joint"),
            ("number:Planted", "planted", v.number4),
            *p.estimates(
                "number:Recovered",
                of=lambda r: Determined(r.name, r.recovered, r.std),
            ),
            ("text:Unit", "unit"),
            ("number:Error", _error),
        ],
        "Every value planted in the arm and what was recovered of it.",
    )
    motion = motion_figure(result.joints, Limits(result.limit_values), series)
    return p.section(
        "Rehearsal",
        v.sentence(result.headline),
        [
            ("Key figures", [key_figures]),
            (
                "What to change",
                [p.notes(result.advice, p.FAIR, brief="to change")],
            ),
            ("Requirements", [requirements]),
            ("Planted and recovered", [table]),
            ("Motion of the virtual arm", [motion]),
        ],
        (("passed" if passed else "failed", result.headline),),
    )


def _verdict(holds: bool, yes: str, no: str) -> p.Cell:
    return p.Cell(yes, p.GOOD) if holds else p.Cell(no, p.POOR)


def _error(row: Requirement) -> p.Cell:
    planted = row.planted or 0.0
    recovered = row.recovered or 0.0
    error = (recovered - planted) / abs(planted) if planted else None
    return p.cell(error, v.percent, p.GOOD if row.passed else p.POOR)


def _motion(result: Motion, series: Series) -> p.Parts:
    limits = Limits(result.limit_values, result.certified, result.revolute)
    motion = motion_figure(result.joints, limits, series)
    return [
        ("Motion against limits", [_limits(result), motion]),
        ("Excitation of the parameters", [spectrum_figure(series)]),
    ]


def _change(pair: Pair | None) -> str:
    return NONE if pair is None else v.change(pair.initial, pair.final, v.condition)


def _lead(result: Design) -> str:
    kappa = result.condition_number
    if kappa.final is None:
        return f"A motion was designed for {result.robot}."
    duration = v.quantity(result.duration, "s")
    worst = _worst_ratio(result)
    holds = ""
    if worst is not None:
        used = share_of_limit(worst)
        holds = f" Limits are exceeded: {used} of one is used{_unchecked(result)}."
        if worst <= FULL:
            holds = f" All limits hold, used up to {used}{_unchecked(result)}."
    reached = f"a condition number of {v.condition(kappa.final)}"
    if result.link_by_link:
        return (
            f"{len(result.link_by_link.stages)} motions, one per link, of {duration} in all, reach "
            f"{reached} or less each (1 would be best).{holds}"
        )
    before = ""
    if kappa.initial is not None:
        before = f", {v.condition(kappa.initial)} at the start of the search"
    motion = f"A motion of {duration}{_split(result, ', {} periods of {},')}"
    return f"{motion} reaches {reached}{before} (1 would be best).{holds}"


def _facts(result: Design) -> p.Facts | None:
    kappa = result.condition_number
    reached = f"from {v.number(kappa.initial)}"
    if result.link_by_link:
        reached = f"the worst of {len(result.link_by_link.stages)} links"
    if kappa.lower_bound is not None:
        reached += f"; no motion below {v.number(kappa.lower_bound)}"
    scaled = result.condition_number_scaled or Pair(None, None)
    unit_length = "columns of W at unit length"
    if scaled.initial is not None:
        unit_length = f"from {v.number(scaled.initial)}; {unit_length}"
    criterion = result.criterion
    name, meaning = _CRITERIA.get(criterion, (v.plain(criterion), ""))
    starts = len(result.starts)
    effort = f"{starts} start{'s' * (starts != 1)}, {result.iterations} iterations"
    if not starts:
        effort = f"{result.iterations} iterations"
    return p.facts(
        p.fact("Condition number", kappa.final, v.number, reached),
        p.fact("Condition number, scaled", scaled.final, v.number, unit_length),
        _duration(
            result.duration,
            _split(result, "{} periods of {}, ") + f"{result.harmonics} harmonics",
        ),
        p.fact(
            "Base parameters",
            result.base_parameters,
            v.whole,
            _columns(result.columns),
        ),
        p.Fact("Criterion", name, meaning),
        _clearance(result),
        p.Fact("Search", v.quantity(result.wall_s, "s"), effort, timing=True),
    )


def _duration(duration: float, remark: str = "") -> p.Fact:
    return p.fact("Duration", duration, v.unit_of("s"), remark)


def _split(result: Design, words: str) -> str:
    """Number and length of the periods of a motion in words, if it has more than one."""
    count = result.periods or 1
    if count == 1:
        return ""
    return words.format(count, v.quantity(result.duration / count, "s"))


def _clearance(result: Motion) -> p.Fact:
    distance = result.clearance_m
    height = "".join(
        f"floor at {v.quantity(obstacle.offset, 'm')}, "
        for obstacle in result.obstacles
        if isinstance(obstacle, HalfSpace) and obstacle.name == "floor"
    )
    remark = f"to {height}obstacles and itself, between samples too"
    return p.fact(
        "Clearance",
        distance,
        lambda d: f"≥ {v.quantity(1e3 * d, 'mm')}" if d else "",
        remark,
    )


def _columns(columns: str) -> str:
    return _COLUMNS.get(columns, f"columns: {v.plain(columns)}" if columns else "")


def _shares(result: Motion) -> dict[str, float | None]:
    """The largest share of each quantity's limit; None if unlimited."""
    return {
        quantity: None if ratio == 0 and not result.worst.get(quantity) else ratio
        for quantity, ratio in result.limits.items()
    }


def _worst_ratio(result: Motion) -> float | None:
    ratios = [ratio for ratio in _shares(result).values() if ratio is not None]
    return max(ratios, default=None)


def _limits(result: Motion) -> p.Table | None:
    shares = _shares(result)

    def verdict(quantity: str) -> p.Cell:
        ratio = shares[quantity]
        if ratio is None:
            return p.Cell("no limit given")
        return _verdict(ratio <= FULL, "holds", "exceeded")

    def worst_at(quantity: str, field: str) -> Any:
        return getattr(result.worst.get(quantity), field, None)

    return p.table(
        list(shares),
        [
            ("name:Quantity", str),
            ("number:Share of limit", shares.get, share_of_limit),
            ("text:Verdict", verdict),
            ("text:Joint", lambda quantity: worst_at(quantity, "joint")),
            ("number:At [s]", lambda quantity: worst_at(quantity, "t")),
        ],
        "The worst point of the continuous motion, also between samples: 100 % is the limit.",
    )


def _weakest(result: Design) -> p.Table | None:
    equal = len(set(result.joint_weights)) <= 1
    weighted = "" if equal else " (joints differ as the noise given for the design)"
    return p.table(
        result.weakest,
        [
            ("expression:Base parameter", "expression"),
            ("number:Std at start", "std_per_unit_noise_initial"),
            ("number:Std designed", "std_per_unit_noise_final"),
            ("text:Unit", "unit"),
            ("number:Value in the model", "value"),
        ],
        "Standard deviation (std) by least squares from the motion at 100 Hz, at least 1000 "
        f"samples, for white torque noise of 1 N·m{weighted}. Fv is viscous and Fc Coulomb "
        "friction, Ia the rotor's inertia.",
    )


def _starts(result: Design) -> p.Table | None:
    rows = sorted(result.starts, key=lambda row: row.condition_number or np.inf)
    return p.table(
        rows,
        [
            ("number:Start", "start", v.whole),
            ("number:Builds upon", "parent", v.whole),
            ("number:Condition number", "condition_number"),
            ("number:Convex steps", "iterations", v.whole),
            ("text:Ended", "status"),
        ],
        "The best first: several that end at the same value suggest that a much better motion does "
        "not exist.",
        long="All {} starts",
    )


def _link_motions(result: Design) -> p.Table | None:
    return p.table(
        result.link_by_link.stages if result.link_by_link else [],
        [
            ("name:File", "file"),
            ("name:Link", "link"),
            ("number:Joints moving", lambda r: str(len(r.moves))),
            ("number:Duration [s]", "duration"),
            ("number:Base parameters", "base_parameters", v.whole),
            ("number:Condition number, first", "condition_number.initial"),
            ("number:Condition number", "condition_number.final"),
            ("number:Condition number, scaled", "condition_number_scaled.final"),
        ],
        "Each motion shows the base parameters of its link in the torque of that link's joint, the "
        "links further out being known by then; the figures below show a period of each in turn.",
    )
