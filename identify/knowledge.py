"""Knowledge: what is known of an arm's bodies before any data, from a data sheet or a drawing."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np

from excitant.exceptions import BadInput, UnknownName
from excitant.identify.semidefinite import Restriction
from excitant.robots.geometry import centre_regions
from excitant.robots.motion import Array
from excitant.robots.robot import Robot
from excitant.robots.schema import Positive, Record, Three, convert, read_yaml


class Quantity(Record, frozen=True):
    """A number that is known [SI], with its standard deviation; 0 where it holds exactly."""

    value: Positive
    std: Annotated[float, msgspec.Meta(ge=0, le=1e300)] = 0.0

    def __str__(self) -> str:
        return f"{self.value:g}" + (f" ± {self.std:g}" if self.std else "")


class Box(Record, frozen=True, array_like=True):
    """Points between two corners of a link's frame [m]."""

    low: Three
    high: Three

    def __post_init__(self) -> None:
        for axis, least, greatest in zip("xyz", self.low, self.high, strict=True):
            if least > greatest:
                raise ValueError(
                    f"along {axis} the first corner ({least:g} m) lies above the second "
                    f"({greatest:g} m); exchange them"
                )


class LinkKnowledge(Record, frozen=True, omit_defaults=True):
    """Known values of one link, everything fixed to it included; None where unknown.

    Attributes:
        mass: Its mass [kg].
        com_box: Where its centre of mass lies.
    """

    mass: Positive | Quantity | None = None
    com_box: Box | None = None


class _File(Record, frozen=True):
    total_mass: Positive | Quantity | None = None
    links: dict[str, Any] | None = None


@dataclass(frozen=True)
class Knowledge:
    """Prior knowledge of a physically consistent fit.

    Attributes:
        total_mass: Mass of all moving links together, the base not counted [kg].
        links: What is known of links, by name.
        source: File it was read from.
        regions: Where the centres of mass of other links lie, by their geometry.
    """

    total_mass: float | Quantity | None = None
    links: Mapping[str, LinkKnowledge] = field(default_factory=dict)
    source: str = "knowledge"
    regions: Mapping[str, Box] = field(default_factory=dict)

    def of(self, robot: Robot) -> Knowledge:
        """The same, with the geometry of a robot's links."""
        boxes = centre_regions(robot).items()
        regions = {
            name: Box(tuple(low.tolist()), tuple(high.tolist()))
            for name, (low, high) in boxes
        }
        return replace(self, regions=regions)

    def near(self, masses: Mapping[str, float], std: float) -> Knowledge:
        """The same, with masses of links, where it tells none, known to a relative std."""
        links = dict(self.links)
        for name, mass in masses.items():
            own = links.get(name, LinkKnowledge())
            if own.mass is None:
                known = Quantity(mass, std * mass)
                links[name] = LinkKnowledge(known, own.com_box)
        return replace(self, links=links)

    @property
    def masses(self) -> dict[str, Quantity]:
        """Known masses by what they are of, links by ``mass of NAME``."""
        known = {"total_mass": self.total_mass}
        known |= {f"mass of {name}": link.mass for name, link in self.links.items()}
        return {
            name: mass if isinstance(mass, Quantity) else Quantity(mass)
            for name, mass in known.items()
            if mass is not None
        }

    @property
    def sentence(self) -> str:
        """Description of the knowledge used beside the given bodies; empty where there is none."""
        known = [f"{name} {mass} kg" for name, mass in self.masses.items()]
        known += [
            f"com_box of {name}"
            for name, link in self.links.items()
            if link.com_box is not None
        ]
        if not known:
            return ""
        return f"taken for known from {self.source}: {'; '.join(known)}"

    def entry(self) -> dict[str, Any]:
        """As in the file, without what is not known."""
        known = {"total_mass": self.total_mass, "links": dict(self.links)}
        known = {
            key: value for key, value in known.items() if value not in (None, {})
        }
        return dict(msgspec.json.decode(msgspec.json.encode(known)))


def load_knowledge(path: str | Path, links: Sequence[str]) -> Knowledge:
    """Knowledge from YAML.

    ``{total_mass: 33.5, links: {forearm: {mass: {value: 2.3, std: 0.1},
    com_box: [[-0.1, -0.1, 0], [0.1, 0.1, 0.4]]}}}``; lengths in metres in the link's frame.

    Raises:
        BadInput: Unreadable, unknown entries or links, or values that nothing can have.
    """
    record = read_yaml(path, _File, "what is known of the bodies")
    entries = record.links or {}
    for name in entries:
        if name not in links:
            raise BadInput(f"{path}: links: {UnknownName('link', name, links)}")
    known = {
        name: convert(content, LinkKnowledge, path, f"links.{name}")
        for name, content in entries.items()
    }
    return Knowledge(record.total_mass, known, str(path))


def known_rows(
    knowledge: Knowledge, links: Sequence[str]
) -> tuple[Array, Array, list[Restriction]]:
    """Knowledge about the links of an arm: rows C φ ≈ d of unit noise, and what holds exactly.

    All of it is linear in the standard parameters: masses, their sum, and a centre of mass c in a
    box, m c_lo ≤ m c ≤ m c_hi.

    Raises:
        BadInput: Knowledge of a link that the arm does not have.
    """
    for name in knowledge.links:
        if name not in links:
            raise BadInput(
                f"{knowledge.source}: links: the arm has no link '{name}'"
            )
    p = 10 * len(links)
    of_link = {
        f"mass of {name}": row
        for name, row in zip(links, np.eye(p)[::10], strict=True)
    }
    mass_rows = {"total_mass": np.sum(list(of_link.values()), axis=0)} | of_link
    rows = [np.zeros((0, p))]
    values = list[float]()
    restrictions: list[Restriction] = []
    for name, mass in knowledge.masses.items():
        row = mass_rows[name][None]
        if mass.std:
            rows.append(row / mass.std)
            values.append(mass.value / mass.std)
        else:
            what = f"{name} = {mass.value:g} kg"
            restrictions.append(
                Restriction("zero", row, np.array([mass.value]), what)
            )
    stated = {
        name: known.com_box
        for name, known in knowledge.links.items()
        if known.com_box is not None
    }
    for name, box in {**knowledge.regions, **stated}.items():
        place = np.eye(p)[10 * links.index(name) :][:10]
        restrictions += [
            replace(each, G=each.G @ place) for each in _within(box, name)
        ]
    return np.vstack(rows), np.array(values, float), restrictions


def _within(box: Box, name: str) -> Iterator[Restriction]:
    """A centre of mass in a box as restrictions of its link's ten parameters."""
    mass = np.eye(10)[0]
    first = np.eye(10)[1:4]
    low = np.array(box.low)
    high = np.array(box.high)
    # where the box has no width, a coordinate is known
    flat = low == high
    G = np.array([first - np.outer(low, mass), np.outer(high, mass) - first])
    for cone, rows in (
        ("nonnegative", G[:, ~flat].reshape(-1, 10)),
        ("zero", G[0, flat]),
    ):
        if len(rows):
            yield Restriction(cone, rows, np.zeros(len(rows)), f"com_box of {name}")
