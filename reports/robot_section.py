"""Section on one arm: what it looks like, its joints and links, and what looks wrong."""

from __future__ import annotations

import math

from excitant.reports.arm_figure import arm_figure, joint_labels
from excitant.reports.model import (
    FAIR,
    GOOD,
    POOR,
    Block,
    Cell,
    Fact,
    Facts,
    Notes,
    Section,
    Table,
    section,
    table,
)
from excitant.reports.plain_text import Cells, fields, sentences
from excitant.reports.plain_text import table as text_table
from excitant.reports.reading import Result, Series, at, real, reals, records, text, words
from excitant.reports.wording import NONE, listing, number, percent, plain, quantity, sentence

_FULL = 0.9  # of its effort limit that gravity takes: hardly any left to move


def robot_section(result: Result, series: Series) -> Section:
    """An arm with its picture, tables and warnings."""
    return section(
        "Robot",
        _lead(result),
        [
            ("Key figures", [_facts(result)]),
            ("What looks wrong", _verdict(result)),
            ("The arm", [arm_figure(series)]),
            ("Joints", [_joints(result)]),
            ("Links", [_links(result)]),
            ("Friction and drives", [_effects(result)]),
            ("Sources", [Notes((text(result, "sources"),)) if text(result, "sources") else None]),
        ],
    )


def _warned(result: Result, hint: bool) -> list[Result]:
    return [row for row in records(result, "warnings") if (at(row, "hint") is True) == hint]


def _lead(result: Result) -> str:
    joints, kind = records(result, "joints"), text(result, "kind")
    sliding = sum(text(j, "kind") == "prismatic" for j in joints)
    what = f"{len(joints)} joints" + (f", {sliding} of them sliding" if sliding else "")
    return (
        f"{kind[:1].upper() + kind[1:] if kind else 'An arm'} with {what}; "
        f"{quantity(at(result, 'mass'), 'kg', 4)} move. {_headline(result)}"
    )


def _headline(result: Result) -> str:
    found, hints = (len(_warned(result, hint)) for hint in (False, True))
    if not found:
        if hints:
            return f"No warning, and {_count(hints, 'hint')} about its description."
        return "Nothing in its description looks wrong."
    return f"{_count(found, 'thing')} in its description look{'s' * (found == 1)} wrong."


def _count(n: int, what: str) -> str:
    return f"{n} {what}{'s' * (n != 1)}"


def _facts(result: Result) -> Facts:
    found, hints = (len(_warned(result, hint)) for hint in (False, True))
    stated = real(result, "stated_mass")
    whole = f"{quantity(at(result, 'total_mass'), 'kg', 4)} with the base, as far as given"
    whole += "" if stated is None else f"; stated: {quantity(stated, 'kg', 4)}"
    facts = [
        Fact("Joints", str(len(records(result, "joints")))),
        Fact("Moving mass", quantity(at(result, "mass"), "kg", 4), whole),
        Fact("Base parameters", text(result, "base_parameters"), "of rigid links in this gravity"),
        Fact("Warnings", str(found), f"and {_count(hints, 'hint')}", POOR if found else GOOD),
    ]  # fmt: skip
    return Facts(tuple(facts))


def _verdict(result: Result) -> list[Block | None]:
    blocks: list[Block | None] = []
    for hint, tone in ((False, POOR), (True, FAIR)):
        said = tuple(_sentence(row) for row in _warned(result, hint))
        if said:
            blocks.append(Notes(said, tone))
    if not _warned(result, False):
        sizes = "" if _warned(result, True) else " and of the links' size"
        blocks.insert(0, Notes(
            (f"No warning: inertias are physical{sizes}, axes and limits are "
             "complete, and each joint can hold the arm in every pose.",), GOOD))  # fmt: skip
    notes = words(result, "notes")
    blocks.append(Notes(tuple(notes)) if notes else None)
    return blocks


def _sentence(row: Result) -> str:
    return sentence(f"{listing(words(row, 'where'))}: {text(row, 'sentence')}")


def _joints(result: Result) -> Table | None:
    rows: list[list[Cell | str]] = []
    joints = records(result, "joints")
    for label, joint in zip(joint_labels([text(j, "name") for j in joints]), joints, strict=True):
        turns = text(joint, "kind") != "prismatic"
        limit, weight = real(joint, "torque"), real(joint, "gravity_torque")
        share = None if limit is None or weight is None else weight / limit
        tone = "" if share is None else POOR if share > 1 else FAIR if share > _FULL else ""
        unit, rate = ("N·m", "rad") if turns else ("N", "m")
        rows.append([
            label,
            text(joint, "link"),
            _range(joint, turns),
            quantity(at(joint, "velocity"), f"{rate}/s"),
            quantity(at(joint, "acceleration"), f"{rate}/s²"),
            quantity(limit, unit),
            Cell(quantity(weight, unit), tone),
            Cell(percent(share), tone),
        ])  # fmt: skip
    if not rows:
        return None
    return table(
        "name:Joint | name:Link | number:Range | number:Speed | number:Acceleration | "
        "number:Effort limit | number:Gravity, at most | number:Of the limit",
        rows,
        "Joints in order from the base, with the limits that a design holds; – means no limit. "
        "Gravity, at most: the largest torque that holding the arm takes within the ranges.",
    )


def _range(joint: Result, turns: bool) -> str:
    ends = reals(joint, "position")
    if len(ends) != 2 or any(math.isnan(end) for end in ends):
        return "without end" if turns else NONE
    if not turns:
        return f"{number(ends[0])} to {quantity(ends[1], 'm')}"
    low, high = (f"{math.degrees(end):.1f}".removesuffix(".0").replace("-", "−") for end in ends)
    return f"{low}° to {high}°"


def _links(result: Result) -> Table | None:
    rows: list[list[Cell | str]] = []
    for link in records(result, "links"):
        if not real(link, "mass"):
            continue
        name, carrier = text(link, "link"), text(link, "moves_with")
        com = [1e3 * x for x in reals(link, "com")]
        rows.append([
            name,
            "stands" if not carrier else "itself" if carrier == name else carrier,
            number(at(link, "mass"), 4),
            ", ".join(number(0.0 if abs(x) < 1e-4 else x) for x in com),
            ", ".join(number(x) for x in reals(link, "principal_moments")),
            number(1e3 * (real(link, "radius_of_gyration") or 0.0)),
            number(1e3 * (real(link, "size") or 0.0)),
        ])  # fmt: skip
    if not rows:
        return None
    return table(
        "name:Link | name:Moves with | number:Mass [kg] | number:Centre of mass x, y, z [mm] | "
        "number:Principal moments [kg·m²] | number:Radius of gyration [mm] | number:Size [mm]",
        rows,
        "Links with mass: centre of mass in the link frame, moments about it. The radius of "
        "gyration is the largest over directions; a body of the link's size (diagonal of the box "
        "around its joints and solids) has less than half of that.",
    )


def _effects(result: Result) -> Table | None:
    values = records(result, "effect_values")
    joints = [text(joint, "name") for joint in records(result, "joints")]
    kinds = list(dict.fromkeys((text(v, "effect"), _symbol(v)) for v in values))
    rows: list[list[Cell | str]] = []
    for joint in joints:
        cells: list[Cell | str] = [joint]
        for effect, symbol in kinds:
            found = [v for v in values if (text(v, "effect"), _symbol(v)) == (effect, symbol)
                     and text(v, "name") == f"{joint}.{symbol}"]  # fmt: skip
            cells.append(quantity(at(found[0], "value"), text(found[0], "unit")) if found else NONE)
        rows.append(cells)
    if not kinds or not rows:
        return None
    heads = " | ".join(f"number:{plain(e)[:1].upper()}{plain(e)[1:]} {s}" for e, s in kinds)
    return table(
        f"name:Joint | {heads}", rows,
        "What makes torque beyond the rigid links, as the model has it.",
    )  # fmt: skip


def _symbol(value: Result) -> str:
    return text(value, "name").rpartition(".")[2]


def robot_lines(result: Result) -> list[str]:
    """Summary of an arm as text."""
    keys = ("kind", "mass", "total_mass", "stated_mass", "base_parameters", "effects", "gravity")
    joints: list[Cells] = [
        (
            text(joint, "name"),
            text(joint, "kind"),
            *(None if math.isnan(x) else float(x) for x in reals(joint, "position")),
            *(real(joint, k) for k in ("velocity", "acceleration", "torque", "gravity_torque")),
        )
        for joint in records(result, "joints")
    ]
    heads = ("joint", "kind", "lower", "upper", "velocity", "acceleration", "effort", "gravity")
    links: list[Cells] = [
        (
            text(link, "link"),
            text(link, "moves_with") or "-",
            real(link, "mass"),
            *(float(x) for x in reals(link, "com")),
            *(float(x) for x in reals(link, "principal_moments")),
        )
        for link in records(result, "links")
    ]
    about = ("link", "moves with", "mass", "com x", "com y", "com z", "I1", "I2", "I3")
    return [
        *fields("", result, keys),
        *text_table("joints: rad, m, N.m, N", heads, joints),
        *text_table("links: kg, m, kg.m2", about, links),
        *sentences("warnings", [_sentence(row) for row in _warned(result, False)]),
        *sentences("hints", [_sentence(row) for row in _warned(result, True)]),
        *sentences("notes", words(result, "notes")),
    ]


def robot_brief(result: Result) -> list[tuple[str, str]]:
    """An arm in a few lines, warnings in full."""
    return [
        ("checked", f"{_count(len(records(result, 'joints')), 'joint')}, "
         f"{quantity(at(result, 'total_mass'), 'kg', 4)}. {_headline(result)}"),
        *(("warning", _sentence(row)) for row in _warned(result, False)),
        *(("hint", _sentence(row)) for row in _warned(result, True)),
    ]  # fmt: skip
