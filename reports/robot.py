"""Section on one arm: what it looks like, its joints and links, and what looks wrong."""

from __future__ import annotations

import math

from excitant.reports.arm_figures import arm_figure
from excitant.reports.page import (
    FAIR,
    GOOD,
    PLAIN,
    POOR,
    Block,
    Cell,
    Column,
    Facts,
    Section,
    Table,
    fact,
    facts,
    notes,
    section,
    table,
)
from excitant.reports.values import (
    NONE,
    Result,
    Series,
    at,
    listing,
    number,
    number4,
    percent,
    plain,
    quantity,
    real,
    reals,
    records,
    text,
    unit_of,
    whole,
    words,
)

_FULL = 0.9  # of its effort limit that gravity takes: hardly any left to move


def robot_section(result: Result, series: Series) -> Section:
    """An arm with its picture, tables and warnings."""
    return section(
        "Robot",
        _lead(result),
        [
            ("Key figures", [_facts(result)]),
            ("Warnings", _warnings(result)),
            ("The arm", [arm_figure(series)]),
            ("Joints", [_joints(result)]),
            ("Links", [_links(result)]),
            ("Friction and drives", [_effects(result)]),
            ("Sources", [notes(words(result, "sources"))]),
        ],
        (
            (
                "checked",
                f"{_count(len(records(result, 'joints')), 'joint')}, "
                f"{quantity(at(result, 'total_mass'), 'kg', 4)}. {_verdict(result)}",
            ),
        ),
    )


def _said(result: Result, hint: bool) -> list[str]:
    return [
        f"{listing(words(row, 'where'))}: {text(row, 'sentence')}."
        for row in records(result, "warnings")
        if (at(row, "hint") is True) == hint
    ]


def _lead(result: Result) -> str:
    joints, kind = records(result, "joints"), text(result, "kind") or "an arm"
    sliding = sum(text(j, "kind") == "prismatic" for j in joints)
    what = _count(len(joints), "joint") + (f" ({sliding} of them sliding)" if sliding else "")
    mass = quantity(at(result, "mass"), "kg", 4)
    lead = f"{kind[:1].upper()}{kind[1:]}: {what}, {mass} of moving links"
    return f"{lead}. {_verdict(result)}"


def _verdict(result: Result) -> str:
    found, hints = len(_said(result, False)), len(_said(result, True))
    if found:
        return f"{_count(found, 'thing')} in its description look{'s' * (found == 1)} wrong."
    if hints:
        return f"No warning, and {_count(hints, 'hint')} about its description."
    return "Nothing in its description looks wrong."


def _count(n: int, what: str) -> str:
    return f"{n} {what}{'s' * (n != 1)}"


def _facts(result: Result) -> Facts | None:
    found, hints = len(_said(result, False)), len(_said(result, True))
    stated = real(result, "stated_mass")
    mass = f"{quantity(at(result, 'total_mass'), 'kg', 4)} with the base, as far as given"
    mass += "" if stated is None else f"; stated: {quantity(stated, 'kg', 4)}"
    return facts(
        fact("Joints", len(records(result, "joints")), whole),
        fact("Moving mass", at(result, "mass"), unit_of("kg", 4), mass),
        fact("Base parameters", at(result, "base_parameters"), whole, "of rigid links"),
        fact("Warnings", found, whole, f"and {_count(hints, 'hint')}", POOR if found else GOOD),
    )


def _warnings(result: Result) -> list[Block | None]:
    found, hints = _said(result, False), _said(result, True)
    size = "" if hints else " and of the links' size"
    sound = (
        f"No warning: inertias are physical{size}, axes and limits are complete, and each joint "
        "can hold the arm in every pose."
    )
    return [
        notes([] if found else [sound], GOOD),
        notes(found, POOR, brief="WARNING"),
        notes(hints, FAIR, brief="hint"),
        notes(words(result, "notes")),
    ]


def _joints(result: Result) -> Table | None:
    rows: list[Result] = [
        {**joint, "label": f"{k}.\u00a0{text(joint, 'name')}"}
        for k, joint in enumerate(records(result, "joints"), start=1)
    ]
    return table(
        rows,
        [
            ("name:Joint", "label"),
            ("name:Link", "link"),
            ("number:Range", _range),
            _limit("Speed", "velocity", "rad/s", "m/s"),
            _limit("Acceleration", "acceleration", "rad/s²", "m/s²"),
            _limit("Effort limit", "torque", "N·m", "N"),
            _limit("Gravity, at most", "gravity_torque", "N·m", "N"),
            ("number:Of the limit", lambda r: Cell(percent(_share(r)), _tone(r), _share(r))),
        ],
        "Joints in order from the base, with the limits that a design holds; – means no limit. "
        "Gravity, at most: the largest torque that holding the arm takes within the ranges.",
    )


def _turns(joint: Result) -> bool:
    return text(joint, "kind") != "prismatic"


def _limit(heading: str, key: str, angular: str, linear: str) -> Column:
    def cell(joint: Result) -> Cell:
        value, unit = real(joint, key), angular if _turns(joint) else linear
        tone = _tone(joint) if key == "gravity_torque" else PLAIN
        return Cell(quantity(value, unit), tone, value)

    return (f"number:{heading}", cell)


def _share(joint: Result) -> float | None:
    limit, weight = real(joint, "torque"), real(joint, "gravity_torque")
    return None if not limit or weight is None else weight / limit


def _tone(joint: Result) -> str:
    share = _share(joint) or 0.0
    return POOR if share > 1 else FAIR if share > _FULL else PLAIN


def _range(joint: Result) -> str:
    ends = reals(joint, "position")
    if len(ends) != 2 or any(math.isnan(end) for end in ends):
        return "without end" if _turns(joint) else NONE
    if not _turns(joint):
        return f"{number(ends[0])} to {quantity(ends[1], 'm')}"
    low, high = (f"{math.degrees(end):.1f}".removesuffix(".0").replace("-", "−") for end in ends)
    return f"{low}° to {high}°"


def _links(result: Result) -> Table | None:
    def carrier(link: Result) -> str:
        with_ = text(link, "moves_with")
        return "itself" if with_ == text(link, "link") else with_ or "base (fixed)"

    def com(link: Result) -> str:
        return ", ".join(number(0.0 if abs(x) < 1e-7 else 1e3 * x) for x in reals(link, "com"))

    def milli(value: object) -> str:
        return number(1e3 * (real(value) or 0.0))

    return table(
        [link for link in records(result, "links") if real(link, "mass")],
        [
            ("name:Link", "link"),
            ("text:Moves with", carrier),
            ("number:Mass [kg]", "mass", number4),
            ("number:Centre of mass x, y, z [mm]", com),
            (
                "number:Principal moments [kg·m²]",
                lambda r: ", ".join(number(x) for x in reals(r, "principal_moments")),
            ),
            ("number:Radius of gyration [mm]", "radius_of_gyration", milli),
            ("number:Size [mm]", "size", milli),
        ],
        "Links with mass: centre of mass in the link frame, moments about it. The radius of "
        "gyration is the largest over directions; a body of the link's size (diagonal of the box "
        "around its joints and solids) has less than half of that.",
    )


def _effects(result: Result) -> Table | None:
    values = {text(v, "name"): v for v in records(result, "effect_values")}
    kinds = {
        name.rpartition(".")[2]: plain(text(v, "effect")) for name, v in values.items() if name
    }

    def column(symbol: str, effect: str) -> Column:
        def cell(joint: Result) -> Cell:
            found = values.get(f"{text(joint, 'name')}.{symbol}")
            value = real(found, "value")
            return Cell(quantity(value, text(found, "unit")), PLAIN, value)

        return (f"number:{effect[:1].upper()}{effect[1:]} {symbol}", cell)

    return table(
        records(result, "joints") if kinds else [],
        [("name:Joint", "name"), *(column(*each) for each in kinds.items())],
        "What makes torque beyond the rigid links, as the model has it.",
    )
