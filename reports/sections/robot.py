"""Section on one arm: what it looks like, its joints and links, and what looks wrong."""

from __future__ import annotations

import math

from excitant.reports import page as p
from excitant.reports import values as v
from excitant.reports.figures.arm import arm_figure
from excitant.reports.values import NONE, Result, Series

_FULL = 0.9  # of its effort limit that gravity takes: hardly any left to move


def robot_section(result: Result, series: Series) -> p.Section:
    """An arm with its picture, tables and warnings."""
    joints = v.records(result, "joints")
    kind = v.text(result, "kind") or "an arm"
    count = _count(len(joints), "joint")
    sliding = sum(not _turns(joint) for joint in joints)
    mass, total = (
        v.quantity(v.at(result, key), "kg", 4) for key in ("mass", "total_mass")
    )
    what = f"{count} ({sliding} of them sliding)" if sliding else count
    found = _said(result, False)
    hints = _said(result, True)
    verdict = "Nothing in its description looks wrong."
    if found:
        things = _count(len(found), "thing")
        verdict = f"{things} in its description look{'s' * (len(found) == 1)} wrong."
    elif hints:
        verdict = f"No warning, and {_count(len(hints), 'hint')} about its description."
    size = "" if hints else " and of the links' size"
    sound = (
        f"No warning: inertias are physical{size}, axes and "
        "limits are complete, and each joint can hold the arm in every pose."
    )
    return p.section(
        "Robot",
        f"{kind[:1].upper()}{kind[1:]}: {what}, {mass} of moving links. {verdict}",
        [
            ("Key figures", [_facts(result, len(found), len(hints))]),
            (
                "Warnings",
                [
                    p.notes([] if found else [sound], p.GOOD),
                    p.notes(found, p.POOR, brief="WARNING"),
                    p.notes(hints, p.FAIR, brief="hint"),
                    p.notes(v.words(result, "notes")),
                ],
            ),
            ("The arm", [arm_figure(series)]),
            ("Joints", [_joints(joints)]),
            ("Links", [_links(result)]),
            ("Friction and drives", [_effects(result)]),
            ("Sources", [p.notes(v.words(result, "sources"))]),
        ],
        (("checked", f"{count}, {total}. {verdict}"),),
    )


def _said(result: Result, hint: bool) -> list[str]:
    return [
        f"{v.listing(v.words(row, 'where'))}: {v.text(row, 'sentence')}."
        for row in v.records(result, "warnings")
        if (v.at(row, "hint") is True) == hint
    ]


def _count(n: int, what: str) -> str:
    return f"{n} {what}{'s' * (n != 1)}"


def _facts(result: Result, found: int, hints: int) -> p.Facts | None:
    stated = v.real(result, "stated_mass")
    mass = f"{v.quantity(v.at(result, 'total_mass'), 'kg', 4)} with the base, as far as given"
    mass += "" if stated is None else f"; stated: {v.quantity(stated, 'kg', 4)}"
    tone = p.POOR if found else p.GOOD
    return p.facts(
        p.fact("Joints", len(v.records(result, "joints")), v.whole),
        p.fact("Moving mass", v.at(result, "mass"), v.unit_of("kg", 4), mass),
        p.fact(
            "Base parameters",
            v.at(result, "base_parameters"),
            v.whole,
            "of rigid links",
        ),
        p.fact("Warnings", found, v.whole, f"and {_count(hints, 'hint')}", tone),
    )


def _joints(joints: list[Result]) -> p.Table | None:
    return p.table(
        p.numbered(joints),
        [
            ("name:Joint", lambda r: f"{r['k']}.\u00a0{v.text(r, 'name')}"),
            ("name:Link", "link"),
            ("number:Range", _range),
            _limit("Speed", "velocity", "rad/s", "m/s"),
            _limit("Acceleration", "acceleration", "rad/s²", "m/s²"),
            _limit("Effort limit", "torque", "N·m", "N"),
            _limit("Gravity, at most", "gravity_torque", "N·m", "N"),
            (
                "number:Of the limit",
                lambda r: p.Cell(v.percent(_share(r)), _tone(r), _share(r)),
            ),
        ],
        "Joints in order from the base, with the limits that a design holds; – means no limit. "
        "Gravity, at most: the largest torque that holding the arm takes within the ranges.",
    )


def _turns(joint: Result) -> bool:
    return v.text(joint, "kind") != "prismatic"


def _limit(heading: str, key: str, angular: str, linear: str) -> p.Column:
    def cell(joint: Result) -> p.Cell:
        value = v.real(joint, key)
        unit = angular if _turns(joint) else linear
        tone = _tone(joint) if key == "gravity_torque" else p.PLAIN
        return p.Cell(v.quantity(value, unit), tone, value)

    return (f"number:{heading}", cell)


def _share(joint: Result) -> float | None:
    limit = v.real(joint, "torque")
    weight = v.real(joint, "gravity_torque")
    return None if not limit or weight is None else weight / limit


def _tone(joint: Result) -> str:
    share = _share(joint) or 0.0
    return p.POOR if share > 1 else p.FAIR if share > _FULL else p.PLAIN


def _range(joint: Result) -> str:
    ends = v.reals(joint, "position")
    if len(ends) != 2 or any(math.isnan(end) for end in ends):
        return "without end" if _turns(joint) else NONE
    if not _turns(joint):
        return f"{v.number(ends[0])} to {v.quantity(ends[1], 'm')}"
    low, high = (
        f"{math.degrees(end):.1f}".removesuffix(".0").replace("-", "−") for end in ends
    )
    return f"{low}° to {high}°"


def _links(result: Result) -> p.Table | None:
    def carrier(link: Result) -> str:
        with_ = v.text(link, "moves_with")
        return "itself" if with_ == v.text(link, "link") else with_ or "base (fixed)"

    def com(link: Result) -> str:
        return ", ".join(
            v.number(0.0 if abs(x) < 1e-7 else 1e3 * x) for x in v.reals(link, "com")
        )

    def moments(link: Result) -> str:
        return ", ".join(v.number(x) for x in v.reals(link, "principal_moments"))

    def milli(value: object) -> str:
        return v.number(1e3 * (v.real(value) or 0.0))

    return p.table(
        [link for link in v.records(result, "links") if v.real(link, "mass")],
        [
            ("name:Link", "link"),
            ("text:Moves with", carrier),
            ("number:Mass [kg]", "mass", v.number4),
            ("number:Centre of mass x, y, z [mm]", com),
            ("number:Principal moments [kg·m²]", moments),
            ("number:Radius of gyration [mm]", "radius_of_gyration", milli),
            ("number:Size [mm]", "size", milli),
        ],
        "Links with mass: centre of mass in the link frame, moments about it. The radius of "
        "gyration is the largest over directions; a body of the link's size (diagonal of the box "
        "around its joints and solids) has less than half of that.",
    )


def _effects(result: Result) -> p.Table | None:
    values = {v.text(each, "name"): each for each in v.records(result, "effect_values")}

    def column(symbol: str, effect: str) -> p.Column:
        def cell(joint: Result) -> p.Cell:
            found = values.get(f"{v.text(joint, 'name')}.{symbol}")
            value = v.real(found, "value")
            return p.Cell(v.quantity(value, v.text(found, "unit")), p.PLAIN, value)

        return (f"number:{effect[:1].upper()}{effect[1:]} {symbol}", cell)

    kinds = {
        n.rpartition(".")[2]: v.plain(v.text(r, "effect"))
        for n, r in values.items()
        if n
    }
    return p.table(
        v.records(result, "joints") if kinds else [],
        [("name:Joint", "name"), *(column(*each) for each in kinds.items())],
        "What makes torque beyond the rigid links, as the model has it.",
    )
