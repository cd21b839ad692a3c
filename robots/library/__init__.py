"""Built-in arms: what they are, and where their numbers come from.

Each is a URDF with a YAML of the limits and effects that a URDF cannot hold, or such a YAML alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import resources

import numpy as np

from excitant.robots.loading import builtin_record, builtin_robots, load_robot


@dataclass(frozen=True)
class ArmEntry:
    """One built-in arm.

    Attributes:
        name: Its name.
        kind: What it is.
        revolute: Number of joints that turn.
        prismatic: Number of joints that slide.
        payload: What it may carry [kg]; None where nobody says.
        weight: What it weighs with its base, as published [kg]; None where nobody says.
        moving_mass: What its joints move in the model [kg].
        source: Where its inertias come from, in a few words.
        sources: Sources of all numbers, and which are only representative.
    """

    name: str
    kind: str
    revolute: int
    prismatic: int
    payload: float | None
    weight: float | None
    moving_mass: float
    source: str
    sources: str

    @property
    def joints(self) -> int:
        """Number of joints."""
        return self.revolute + self.prismatic


def arm_entry(name: str) -> ArmEntry:
    """What a built-in arm is."""
    record, robot = builtin_record(name), load_robot(name)
    about, file = record.about, resources.files("excitant.robots.library") / f"{name}.urdf"
    assert about is not None
    text = file.read_text("utf-8") if file.is_file() else ""
    heading = text.partition("<!--")[2].partition("-->")[0]  # what the URDF says of itself
    return ArmEntry(
        name=name,
        kind=about.kind,
        revolute=int(np.sum(robot.revolute)),
        prismatic=int(np.sum(~robot.revolute)),
        payload=about.payload_kg,
        weight=about.mass_kg,
        moving_mass=float(robot.phi[::10].sum()),
        source=about.source,
        sources=" ".join((heading + record.sources).split()),
    )


def catalogue() -> tuple[ArmEntry, ...]:
    """All built-in arms by name."""
    return tuple(map(arm_entry, builtin_robots()))


def catalogue_rows() -> list[tuple[str, ...]]:
    """The arms as a table of texts, its heading first."""
    rows: list[tuple[str, ...]] = [
        ("name", "joints", "kind", "payload [kg]", "mass [kg]", "moving [kg]", "inertias from")
    ]
    for arm in catalogue():
        joints = f"{arm.joints}" + (f" ({arm.prismatic} sliding)" if arm.prismatic else "")
        numbers = [
            "–" if x is None else f"{x:.4g}" for x in (arm.payload, arm.weight, arm.moving_mass)
        ]
        rows.append((arm.name, joints, arm.kind, *numbers, arm.source))
    return rows


def catalogue_page() -> str:
    """The page of the documentation that lists the arms (Markdown)."""
    heads, *rows = catalogue_rows()
    table = ["| " + " | ".join(heads) + " |", "|" + " --- |" * len(heads)]
    table += ["| `" + "` | ".join((row[0], " | ".join(row[1:]))) + " |" for row in rows]
    notes = [f"**{arm.name}.** {arm.sources}" for arm in catalogue()]
    return "\n".join((_HEAD, *table, "", _NOTES, "", "\n\n".join(notes), ""))


_HEAD = """\
# Built-in arms

Every arm has kinematics, masses and inertias, limits of position, speed, acceleration and torque,
friction and rotor inertia, and rough collision shapes. No meshes, nothing to download.
`excitant robots NAME` prints one arm with its joints, links and what looks odd about its numbers;
`excitant robots NAME -o DIR` draws it. *Mass* is what the maker says of the whole arm, *moving*
what the joints carry in the model. This page is written by
`excitant.robots.library.catalogue_page()`.
"""
_NOTES = """\
## Sources

What is not published is called representative or assumed in the arm's file: good for trying things
out, not for your arm."""
