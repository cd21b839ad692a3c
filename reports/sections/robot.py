"""Section on one arm: what it looks like, its joints and links, and what looks wrong."""

import math
from dataclasses import replace

from excitant.reports import page as p
from excitant.reports import values as v
from excitant.reports.player import arm_player
from excitant.reports.values import NONE, Series
from excitant.results import ModelWarning, Number, RobotJoint, RobotLink, Robots

_FULL = 0.9  # of its effort limit that gravity takes: hardly any left to move


def robot_section(result: Robots, series: Series) -> p.Section:
    """An arm to look at, with tables and warnings."""
    joints = result.joints
    kind = result.kind or "an arm"
    count = _count(len(joints), "joint")
    sliding = sum(not _turns(joint) for joint in joints)
    mass = v.quantity(result.mass, "kg", 4)
    what = f"{count} ({sliding} of them sliding)" if sliding else count
    warnings = [_sentence(row) for row in result.warnings if not row.hint]
    hints = [_sentence(row) for row in result.warnings if row.hint]
    verdict = "Nothing in its description looks wrong."
    if warnings:
        things = _count(len(warnings), "thing")
        verdict = (
            f"{things} in its description look{'s' * (len(warnings) == 1)} wrong."
        )
    elif hints:
        verdict = (
            f"No warning, and {_count(len(hints), 'hint')} about its description."
        )
    size = "" if hints else " and of the links' size"
    sound = (
        f"No warning: inertias are physical{size}, axes and "
        "limits are complete, and each joint can hold the arm in every pose."
    )
    return p.section(
        "Robot",
        f"{kind[:1].upper()}{kind[1:]}: {what}, {mass} of moving links. {verdict}",
        [
            ("Key figures", [_facts(result, len(warnings), len(hints))]),
            (
                "Warnings",
                [
                    p.notes([] if warnings else [sound], p.GOOD),
                    p.notes(warnings, p.POOR, brief="WARNING"),
                    p.notes(hints, p.FAIR, brief="hint"),
                    p.notes(result.notes),
                ],
            ),
            ("The arm", [arm_player(result, series)]),
            ("Joints", [_joints(joints)]),
            ("Links", [_links(result)]),
            ("Friction and drives", [_effects(result)]),
            ("Sources", [p.notes([result.sources] if result.sources else [])]),
        ],
        (("checked", f"{count}, {mass} of moving links. {verdict}"),),
    )


def _sentence(warning: ModelWarning) -> str:
    return f"{v.listing(warning.where)}: {warning.sentence}."


def _count(n: int, what: str) -> str:
    return f"{n} {what}{'s' * (n != 1)}"


def _facts(result: Robots, warnings: int, hints: int) -> p.Facts | None:
    stated = result.stated_mass
    mass = (
        f"{v.quantity(result.total_mass, 'kg', 4)} with the base, as far as given"
    )
    mass += "" if stated is None else f"; stated: {v.quantity(stated, 'kg', 4)}"
    tone = p.POOR if warnings else p.GOOD
    return p.facts(
        p.fact("Joints", len(result.joints), v.whole),
        p.fact("Moving mass", result.mass, v.unit_of("kg", 4), mass),
        p.fact(
            "Base parameters",
            result.base_parameters,
            v.whole,
            "of rigid links",
        ),
        p.fact("Warnings", warnings, v.whole, f"and {_count(hints, 'hint')}", tone),
    )


def _joints(joints: list[RobotJoint]) -> p.Table | None:
    return p.table(
        joints,
        [
            ("name:Joint", lambda r: f"{joints.index(r) + 1}.\u00a0{r.name}"),
            ("name:Link", "link"),
            ("number:Range", _range),
            ("number:Speed", lambda r: _limit(r, r.velocity, "rad/s", "m/s")),
            (
                "number:Acceleration",
                lambda r: _limit(r, r.acceleration, "rad/s²", "m/s²"),
            ),
            ("number:Effort limit", lambda r: _limit(r, r.torque, "N·m", "N")),
            (
                "number:Gravity, at most",
                lambda r: replace(
                    _limit(r, r.gravity_torque, "N·m", "N"), tone=_tone(r)
                ),
            ),
            (
                "number:Of the limit",
                lambda r: p.cell(_share(r), v.percent, _tone(r)),
            ),
        ],
        "Joints in order from the base, with the limits that a design holds; – means no limit. "
        "Gravity, at most: the largest torque that holding the arm takes within the ranges.",
    )


def _turns(joint: RobotJoint) -> bool:
    return joint.kind != "prismatic"


def _limit(joint: RobotJoint, value: Number, angular: str, linear: str) -> p.Cell:
    unit = angular if _turns(joint) else linear
    return p.Cell(v.quantity(value, unit), value=value)


def _share(joint: RobotJoint) -> float | None:
    limit = joint.torque
    weight = joint.gravity_torque
    return None if not limit or weight is None else weight / limit


def _tone(joint: RobotJoint) -> str:
    share = _share(joint) or 0.0
    return p.POOR if share > 1 else p.FAIR if share > _FULL else p.PLAIN


def _range(joint: RobotJoint) -> str:
    ends = v.reals(joint.position)
    if any(math.isnan(end) for end in ends):
        return "without end" if _turns(joint) else NONE
    if not _turns(joint):
        return f"{v.number(ends[0])} to {v.quantity(ends[1], 'm')}"
    low, high = (
        f"{math.degrees(end):.1f}".removesuffix(".0").replace("-", "−")
        for end in ends
    )
    return f"{low}° to {high}°"


def _links(result: Robots) -> p.Table | None:
    def carrier(link: RobotLink) -> str:
        itself = link.moves_with == link.link
        return "itself" if itself else link.moves_with or "base (fixed)"

    def com(link: RobotLink) -> str:
        return ", ".join(
            v.number(0.0 if abs(x) < 1e-7 else 1e3 * x) for x in v.reals(link.com)
        )

    def moments(link: RobotLink) -> str:
        return ", ".join(map(v.number, v.reals(link.principal_moments)))

    def milli(value: Number) -> str:
        return v.number(1e3 * (value or 0.0))

    return p.table(
        [link for link in result.links if link.mass],
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


def _effects(result: Robots) -> p.Table | None:
    values = {row.name: row for row in result.effect_values}

    def column(symbol: str, effect: str) -> p.Column:
        def cell(joint: RobotJoint) -> p.Cell:
            row = values.get(f"{joint.name}.{symbol}")
            if row is None:
                return p.Cell(NONE)
            return p.Cell(v.quantity(row.value, row.unit), value=row.value)

        return (f"number:{effect[:1].upper()}{effect[1:]} {symbol}", cell)

    kinds = {
        name.rpartition(".")[2]: v.plain(row.effect) for name, row in values.items()
    }
    return p.table(
        result.joints if kinds else [],
        [("name:Joint", "name"), *(column(*each) for each in kinds.items())],
        "What makes torque beyond the rigid links, as the model has it.",
    )
