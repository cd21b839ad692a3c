"""Sections on a motion: designed, checked, or rehearsed on a virtual arm."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from excitant.reports import page as p
from excitant.reports import values as v
from excitant.reports.figures.motion import (
    envelope_of,
    motion_figure,
    share_of_limit,
)
from excitant.reports.figures.search import convergence_figure, spectrum_figure
from excitant.reports.figures.space import space_figure
from excitant.reports.figures.torque import tracking_figure
from excitant.reports.player import FULL, moments, player
from excitant.reports.values import NONE, Result, Series

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


def design_section(result: Result, series: Series) -> p.Section:
    """The designed motion: how well it excites, within which limits, and how it was found."""
    kappa, scaled = (v.change(*_ends(result, key)) for key in ("", "_scaled"))
    worst = _worst_ratio(result)
    weak = [v.text(row, "name") for row in v.records(result, "weakest")[:3]]
    said = f"with columns scaled {scaled}; excited least: {v.listing(weak)}"
    notes = [v.sentence(each) for each in v.words(result, "notes")]
    return p.section(
        "Excitation design",
        _lead(result),
        [
            ("Key figures", [_facts(result), p.notes(notes, brief="")]),
            ("The arm in motion", [player(result, series)]),
            ("One motion per link", [_link_motions(result)]),
        ],
        (
            (
                "designed",
                f"condition number {kappa}, limits used up to {v.percent(worst, 4)}"
                f"{_unchecked(result)}",
            ),
            *[("", said)] * bool(weak),
        ),
        [
            *_motion(result, series),
            ("Least excited parameters", [_weakest(result)]),
            ("The search", [convergence_figure(result)]),
        ],
    )


def excitation_sentence(result: Result) -> list[str]:
    """How many of all combinations a motion shows, as a sentence; none where not judged."""
    said = v.text(result, "persistency", "sentence")
    if isinstance(v.at(result, "persistency", "persistent"), bool):
        said = f"this motion is {said}"
    return [v.sentence(said)] * bool(said)


def check_section(result: Result, series: Series) -> p.Section:
    """Whether somebody's trajectory keeps the limits, and how well it excites."""
    kappa = v.at(result, "condition_number")
    said = v.words(result, "verdicts")
    _, limits, tone = _kept(result)
    key_figures = p.facts(
        p.Fact("Limits", limits, "", tone),
        p.fact("Condition number", kappa, v.number, _columns(result)),
        _clearance(result),
        _duration(result),
    )
    return p.section(
        "Trajectory check",
        _kept_sentence(result),
        [
            ("Key figures", [key_figures]),
            ("Verdicts", [p.notes([v.sentence(verdict) for verdict in said])]),
            ("The arm in motion", [player(result, series)]),
            ("Excitation", [p.notes(excitation_sentence(result))]),
            *_motion(result, series),
        ],
        (
            *(
                ("", verdict) if k else ("checked", verdict + _unchecked(result))
                for k, verdict in enumerate(said)
            ),
            (
                "",
                f"condition number {v.number(kappa)} ({v.text(result, 'columns')} columns)",
            ),
            *[("", found) for found in _shown(result)],
        ),
    )


def show_section(result: Result, series: Series) -> p.Section:
    """A motion to watch."""
    touched = [(f"{moment.t:.4g} s", moment.words) for moment in moments(result)]
    said = v.listing(v.words(result, "verdicts"))
    return p.section(
        "Motion",
        _kept_sentence(result),
        [
            ("The arm in motion", [player(result, series)]),
            (
                "Verdicts",
                [p.notes([v.sentence(each) for each in v.words(result, "verdicts")])],
            ),
        ],
        (("checked", said + _unchecked(result)), *touched),
    )


def _kept(result: Result) -> tuple[str, str, str]:
    """Whether the limits hold, as a verb, as a word, and as a tone."""
    return {
        True: ("keeps all limits", "hold", p.GOOD),
        False: ("exceeds limits", "exceeded", p.POOR),
    }.get(v.at(result, "holds"), ("was checked against the limits", "", p.PLAIN))


def _kept_sentence(result: Result) -> str:
    name = v.text(result, "trajectory")
    robot = v.text(result, "robot")
    keeps = f"{name or 'The trajectory'} {_kept(result)[0]}"
    return f"{keeps} of {robot or 'the arm'}{_unchecked(result)}."


def _shown(result: Result) -> list[str]:
    found = v.at(result, "persistency")
    shown = v.real(found, "shown")
    of = v.real(found, "combinations")
    if shown is None or of is None:
        return []
    windows = v.real(found, "windows") or 1
    length = v.quantity(v.at(found, "window_s"), "s")
    over = f" in every window of {length}" if windows > 1 else ""
    return [f"shows {shown:.0f} of {of:.0f} combinations{over}"]


def _unchecked(result: Result) -> str:
    left = v.text(result, "unchecked")
    return f"; not checked: {left}" if left else ""


def rehearse_section(result: Result, series: Series) -> p.Section:
    """Whether a motion suffices, requirement by requirement."""
    rows = v.records(result, "items")
    passed = v.at(result, "passed") is True
    headline = v.text(result, "headline")
    hidden = v.plain(v.text(result, "effect", "effect"))
    met = sum(_met(row) for row in rows)
    known = [
        r for r in rows if None not in (v.real(r, "planted"), v.real(r, "recovered"))
    ]
    key_figures = p.facts(
        p.Fact(
            "Verdict", "go" if passed else "no go", "", p.GOOD if passed else p.POOR
        ),
        p.Fact("Requirements met", f"{met} of {len(rows)}", number=met),
        _duration(result),
        p.Fact("Planted change", hidden, v.text(result, "effect", "joint")),
    )
    requirements = p.table(
        rows,
        [
            ("text:Met", lambda row: _verdict(_met(row), "met", "NOT MET")),
            ("name:Requirement", "name"),
            ("name:Joint", "joint"),
            ("text:Figures", "detail"),
        ],
        "The virtual arm has usual friction, rotor inertia, offsets and noise, and inertias off by "
        "up to 5 %; one more effect changes later. The motion must show all of it.",
        brief="",
    )
    planted = {"diagnosis": hidden}  # of that requirement, the change that it must name
    recovered = p.table(
        [
            {**row, "value": v.at(row, "recovered"), "name": planted.get(name, name)}
            for row in known
            for name in [v.text(row, "name")]
        ],
        [
            ("name:Quantity", "name"),
            ("name:Joint", "joint"),
            ("number:Planted", "planted", v.number4),
            *p.estimates("number:Recovered"),
            ("text:Unit", "unit"),
            ("number:Error", _error),
        ],
        "Every value planted in the arm and what was recovered of it.",
    )
    motion = motion_figure(v.joint_names(result), result, series)
    return p.section(
        "Rehearsal",
        v.sentence(headline),
        [
            ("Key figures", [key_figures]),
            (
                "What to change",
                [p.notes(v.words(result, "advice"), p.FAIR, brief="to change")],
            ),
            ("Requirements", [requirements]),
            ("Planted and recovered", [recovered]),
            ("Tracking by each model", _tracking(result, series)),
            ("Motion of the virtual arm", [motion]),
        ],
        (("passed" if passed else "failed", headline), *_closer(result)),
    )


def _closer(result: Result) -> p.Brief:
    """How much closer the arm follows by the identified model, and by the extended one later."""
    said = []
    for when, model in (("before", "identified"), ("after", "extended")):
        times = [
            x
            for row in v.records(result, "tracking", when)
            if (x := v.real(row, "ratio"))
        ]
        if times:
            ends = dict.fromkeys(v.number(each, 2) for each in (min(times), max(times)))
            said.append(f"{' to '.join(ends)} times less with the {model} model")
    return (("tracking", f"error {', after the change '.join(said)}"),) if said else ()


def _tracking(result: Result, series: Series) -> p.Blocks:
    found = v.at(result, "tracking")
    if found is None:
        return []
    before, after = (v.records(found, when) for when in ("before", "after"))
    later = {v.text(row, "name"): row for row in after}
    rows = [{**row, "changed": later.get(v.text(row, "name"), {})} for row in before]

    def error(*keys: str) -> Callable[[Result], p.Cell]:
        def cell(row: Result) -> p.Cell:
            size = v.real(row, *keys)
            shown = (
                NONE
                if size is None
                else v.quantity(1e3 * size, f"m{v.text(row, 'unit')}")
            )
            return p.Cell(shown, value=size)

        return cell

    def closer(*keys: str) -> Callable[[Result], p.Cell]:
        def cell(row: Result) -> p.Cell:
            times = v.real(row, *keys)
            return _verdict(
                (times or 0.0) > 1, f"{v.number(times)} times", v.number(times)
            )

        return cell

    duration, loop = (v.real(found, key) for key in ("duration", "bandwidth_hz"))
    table = p.table(
        rows,
        [
            ("name:Joint", "name"),
            ("number:Model as given, rms", error("rms", "given")),
            ("number:Identified", error("rms", "identified")),
            ("number:Closer by", closer("ratio")),
            ("number:Changed: model as given", error("changed", "rms", "given")),
            ("number:Identified before", error("changed", "rms", "identified")),
            ("number:Extended", error("changed", "rms", "extended")),
            ("number:Closer by", closer("changed", "ratio")),
        ],
        f"Tracking error of another, random motion of {v.quantity(duration, 's')} under "
        "computed-torque feed-forward of each model, on the virtual arm as it was identified and "
        f"after its change. The position loop is the same for all: {v.quantity(loop, 'Hz')}, "
        "critically damped, with noisy readings.",
    )
    return [tracking_figure(v.joint_names(result), result, series), table]


def _met(row: Result) -> bool:
    return v.at(row, "passed") is True


def _verdict(holds: bool, yes: str, no: str) -> p.Cell:
    return p.Cell(yes, p.GOOD) if holds else p.Cell(no, p.POOR)


def _error(row: Result) -> p.Cell:
    planted = v.real(row, "planted") or 0.0
    value = v.real(row, "value") or 0.0
    error = (value - planted) / abs(planted) if planted else None
    return p.Cell(v.percent(error), p.GOOD if _met(row) else p.POOR, error)


def _motion(result: Result, series: Series) -> p.Parts:
    motion = motion_figure(v.joint_names(result), result, series)
    return [
        ("Motion against limits", [*_limits(result), motion]),
        ("Path of the tool", [space_figure(result, series)]),
        ("Excitation of the parameters", [spectrum_figure(series)]),
    ]


def _ends(result: Result, which: str = "") -> list[float | None]:
    """The condition number before and after the search, of W or of W with scaled columns."""
    return [
        v.real(result, f"condition_number{which}", key) for key in ("initial", "final")
    ]


def _lead(result: Result) -> str:
    initial, final = _ends(result)
    duration = v.real(result, "duration")
    stages = v.records(result, "link_by_link", "stages")
    if final is None:
        return f"A motion was designed for {v.text(result, 'robot') or 'the arm'}."
    motion = (
        "The motion" if duration is None else f"A motion of {v.quantity(duration, 's')}"
    )
    motion += _split(result, ", {} periods of {},")
    worst = _worst_ratio(result)
    holds = ""
    if worst is not None:
        used = share_of_limit(worst)
        holds = f" Limits are exceeded: {used} of one is used{_unchecked(result)}."
        if worst <= FULL:
            holds = f" All limits hold, used up to {used}{_unchecked(result)}."
    reached = f"a condition number of {v.number(final)}"
    if stages:
        return (
            f"{len(stages)} motions, one per link, of {v.quantity(duration, 's')} in all, reach "
            f"{reached} or less each (1 would be best).{holds}"
        )
    before = (
        "" if initial is None else f", {v.number(initial)} at the start of the search"
    )
    return f"{motion} reaches {reached}{before} (1 would be best).{holds}"


def _facts(result: Result) -> p.Facts | None:
    stages = v.records(result, "link_by_link", "stages")
    bound = v.real(result, "condition_number", "lower_bound")
    kappa = _ends(result)
    scaled = _ends(result, "_scaled")
    said = (
        f"the worst of {len(stages)} links" if stages else f"from {v.number(kappa[0])}"
    )
    said += "" if bound is None else f"; no motion below {v.number(bound)}"
    since = "" if scaled[0] is None else f"from {v.number(scaled[0])}; "
    unit_length = f"{since}columns of W at unit length"
    criterion = v.text(result, "criterion")
    name, meaning = _CRITERIA.get(criterion, (v.plain(criterion), ""))
    starts = len(v.records(result, "starts"))
    iterations = v.real(result, "iterations")
    effort = [f"{starts} starts"] * bool(starts)
    effort += [] if iterations is None else [f"{iterations:.0f} iterations"]
    return p.facts(
        p.fact("Condition number", kappa[1], v.number, said),
        p.fact("Condition number, scaled", scaled[1], v.number, unit_length),
        _duration(result),
        p.fact(
            "Base parameters",
            v.at(result, "base_parameters"),
            v.whole,
            _columns(result),
        ),
        p.Fact("Criterion", name, meaning),
        _clearance(result),
        p.Fact(
            "Search",
            v.quantity(v.at(result, "wall_s"), "s"),
            ", ".join(effort),
            timing=True,
        ),
    )


def _duration(result: Result) -> p.Fact:
    count = v.real(result, "harmonics")
    duration = v.real(result, "duration")
    series = ""
    if count is not None:
        spline = (
            v.text(result, "series") == "spline"
        )  # twice as many pieces as harmonics
        series = (
            f"spline of {2 * count:.0f} pieces" if spline else f"{count:.0f} harmonics"
        )
    series = _split(result, "{} periods of {}, ") + series
    return p.fact("Duration", duration, v.unit_of("s"), series)


def _split(result: Result, words: str) -> str:
    """Number and length of the periods of a motion in words, if it has more than one."""
    duration = v.real(result, "duration")
    count = v.real(result, "periods") or 1.0
    if duration is None or count == 1:
        return ""
    return words.format(f"{count:.0f}", v.quantity(duration / count, "s"))


def _clearance(result: Result) -> p.Fact:
    distance = v.real(result, "clearance_m")
    floors = [r for r in v.records(result, "obstacles") if v.text(r, "name") == "floor"]
    height = "".join(f"floor at {v.quantity(v.at(r, 'offset'), 'm')}, " for r in floors)
    remark = f"to {height}obstacles and itself, between samples too"
    return p.fact(
        "Clearance",
        distance,
        lambda d: f"≥ {v.quantity(1e3 * d, 'mm')}" if d else "",
        remark,
    )


def _columns(result: Result) -> str:
    columns = v.text(result, "columns")
    return _COLUMNS.get(columns, f"columns: {v.plain(columns)}" if columns else "")


def _worst(result: Result) -> list[Result]:
    """The largest share of each quantity's limit with its joint and time; None if unlimited."""
    limits = v.at(result, "limits")
    rows: list[Result] = []
    for quantity in limits if isinstance(limits, Mapping) else ():
        ratio = v.real(limits, quantity)
        where = v.at(result, "worst", quantity)
        ratio = None if ratio == 0 and where is None else ratio
        rows.append({"t": None, **(where or {}), "quantity": quantity, "ratio": ratio})
    return rows


def _worst_ratio(result: Result) -> float | None:
    return max(
        (x for row in _worst(result) if (x := row["ratio"]) is not None), default=None
    )


def _limits(result: Result) -> p.Blocks:
    names = v.joint_names(result)
    certified = v.at(result, "certified")

    def joint(row: Result) -> str:
        where = v.at(row, "joint")
        known = isinstance(where, int) and 0 <= where < len(names)
        return names[where] if known else v.text(row, "joint") or NONE

    def verdict(row: Result) -> p.Cell:
        ratio = v.real(row, "ratio")
        if ratio is None:
            return p.Cell("no limit given")
        return _verdict(ratio <= FULL, "holds", "exceeded")

    worst = p.table(
        _worst(result),
        [
            ("name:Quantity", "quantity"),
            ("number:Share of limit", "ratio", share_of_limit),
            ("text:Verdict", verdict),
            ("text:Joint", joint),
            ("number:At [s]", "t"),
        ],
        "The worst point of the continuous motion, also between samples: 100 % is the limit.",
    )
    quantities = [q for q in certified or () if v.records(certified, q)]
    rows: list[Result] = [
        {"joint": joint}
        | {q: e[2] for q in quantities if (e := envelope_of(result, q, k)) is not None}
        for k, joint in enumerate(names)
    ]
    each = p.table(
        rows if quantities else [],
        [
            ("name:Joint", "joint"),
            *(
                (f"number:{v.plain(q).capitalize()}", q, share_of_limit)
                for q in quantities
            ),
        ],
        "Certified share of every joint's limit: a limit used to 100 % bounds what the motion can "
        "show; a dash means no limit.",
        f"Share of the limits joint by joint ({len(names)})",
    )
    return [worst, each]


def _weakest(result: Result) -> p.Table | None:
    weights = v.reals(result, "joint_weights")
    equal = not len(weights) or bool(np.all(weights == weights[0]))
    weighted = "" if equal else " (joints differ as the noise given for the design)"
    return p.table(
        v.records(result, "weakest"),
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


def _link_motions(result: Result) -> p.Table | None:
    return p.table(
        v.records(result, "link_by_link", "stages"),
        [
            ("name:File", "file"),
            ("name:Link", "link"),
            ("number:Joints moving", lambda r: str(len(v.words(r, "moves")))),
            ("number:Duration [s]", "duration"),
            ("number:Base parameters", "base_parameters", v.whole),
            ("number:Condition number, first", "condition_number.initial"),
            ("number:Condition number", "condition_number.final"),
            ("number:Condition number, scaled", "condition_number_scaled.final"),
        ],
        "Each motion shows the base parameters of its link in the torque of that link's joint, the "
        "links further out being known by then; the figures below show a period of each in turn.",
    )
