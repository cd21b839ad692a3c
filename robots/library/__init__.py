"""Built-in arms and the sources of their numbers.

Each is a URDF with a YAML of the limits and effects that a URDF cannot hold, or such a YAML alone.
"""

from dataclasses import dataclass
from importlib import resources

import numpy as np

from excitant.robots.loading import builtin_record, builtin_robots, load_robot


@dataclass(frozen=True)
class ArmEntry:
    """One built-in arm."""

    name: str
    kind: str
    revolute: int  # number of joints that turn
    prismatic: int  # number of joints that slide
    payload: float | None  # what it may carry [kg]; None where unpublished
    weight: float | None  # with its base, as published [kg]; None where unpublished
    moving_mass: float  # what its joints move in the model [kg]
    source: str  # where its inertias come from, in a few words
    sources: str  # sources of all numbers, and which are only representative

    @property
    def joints(self) -> int:
        """Number of joints."""
        return self.revolute + self.prismatic


def arm_entry(name: str) -> ArmEntry:
    """Description of a built-in arm."""
    record = builtin_record(name)
    robot = load_robot(name)
    about = record.about
    file = resources.files("excitant.robots.library") / f"{name}.urdf"
    assert about is not None
    text = file.read_text("utf-8") if file.is_file() else ""
    # what the URDF says of itself
    heading = text.partition("<!--")[2].partition("-->")[0]
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
        (
            "name",
            "joints",
            "kind",
            "payload [kg]",
            "mass [kg]",
            "moving [kg]",
            "inertias from",
        )
    ]
    for arm in catalogue():
        joints = f"{arm.joints}" + (
            f" ({arm.prismatic} sliding)" if arm.prismatic else ""
        )
        numbers = [
            "–" if x is None else f"{x:.4g}"
            for x in (arm.payload, arm.weight, arm.moving_mass)
        ]
        rows.append((arm.name, joints, arm.kind, *numbers, arm.source))
    return rows
