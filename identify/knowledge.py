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
from excitant.robots.parameters import PSEUDO_INERTIA_BASIS
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


class Ellipsoid(Record, frozen=True):
    """Points of an ellipsoid along the axes of a link's frame; radii are its half axes [m]."""

    centre: Three
    radii: tuple[Positive, Positive, Positive]

    def to_unit(self) -> Array:
        """Map from homogeneous coordinates to those of the unit ball, shape (3, 4)."""
        radii = np.array(self.radii)
        return np.column_stack([np.diag(1 / radii), -np.array(self.centre) / radii])


class LinkKnowledge(Record, frozen=True, omit_defaults=True):
    """Known values of one link, everything fixed to it included; None where unknown.

    Attributes:
        mass: Its mass [kg].
        com_box: Where its centre of mass lies.
        com_ellipsoid: Where its centre of mass lies.
        body_ellipsoid: What the whole body lies in (Wensing, Kim, Slotine 2018).
    """

    mass: Positive | Quantity | None = None
    com_box: Box | None = None
    com_ellipsoid: Ellipsoid | None = None
    body_ellipsoid: Ellipsoid | None = None

    @property
    def regions(self) -> list[str]:
        """Names of the regions known."""
        return [
            key
            for key in self.__struct_fields__[1:]
            if getattr(self, key) is not None
        ]


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
        masses = self.masses
        parts = (
            [f"total mass {masses['total_mass']} kg"]
            if "total_mass" in masses
            else []
        )
        for name, link in self.links.items():
            mass = (
                [f"mass {masses[f'mass of {name}']} kg"]
                if link.mass is not None
                else []
            )
            parts.append(f"{name}: {', '.join([*mass, *link.regions])}")
        return (
            f"taken for known from {self.source}: {'; '.join(parts)}"
            if parts
            else ""
        )

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

    All of it is convex in the standard parameters: masses and their sum are linear; a centre of
    mass c in a box is m c_lo ≤ m c ≤ m c_hi; in an ellipsoid of radii r around c₀ it is the
    second-order cone ‖(m c − m c₀) / r‖ ≤ m; and a body inside an ellipsoid exists for P ≻ 0
    exactly when tr(P E) ≥ 0, the mean of 1 − ‖(x − c₀) / r‖² over its mass (Wensing et al. 2018).

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
    values = [np.zeros(0)]
    restrictions: list[Restriction] = []
    for name, mass in knowledge.masses.items():
        row = mass_rows[name][None]
        if mass.std:
            rows.append(row / mass.std)
            values.append(np.array([mass.value / mass.std]))
        else:
            what = f"{name} = {mass.value:g} kg"
            restrictions.append(
                Restriction("zero", row, np.array([mass.value]), what)
            )
    regions = [
        (name, LinkKnowledge(com_box=box))
        for name, box in knowledge.regions.items()
        if name not in knowledge.links or not knowledge.links[name].regions
    ]
    for name, known in (*regions, *knowledge.links.items()):
        place = np.eye(p)[10 * links.index(name) :][:10]
        restrictions += [
            replace(each, G=each.G @ place) for each in _regions(known, name)
        ]
    return np.vstack(rows), np.concatenate(values), restrictions


def _regions(known: LinkKnowledge, name: str) -> Iterator[Restriction]:
    """Restrictions of one link's ten parameters."""
    mass = np.eye(10)[0]
    first = np.eye(10)[1:4]
    if known.com_box is not None:
        # where the box has no width, a coordinate is known
        low = np.array(known.com_box.low)
        high = np.array(known.com_box.high)
        flat = low == high
        G = np.array([first - np.outer(low, mass), np.outer(high, mass) - first])
        for cone, rows in (
            ("nonnegative", G[:, ~flat].reshape(-1, 10)),
            ("zero", G[0, flat]),
        ):
            if len(rows):
                yield Restriction(
                    cone, rows, np.zeros(len(rows)), f"com_box of {name}"
                )
    if known.com_ellipsoid is not None:
        G = np.vstack(
            [mass, known.com_ellipsoid.to_unit() @ np.vstack([first, mass])]
        )
        yield Restriction(
            "second_order", G, np.zeros(4), f"com_ellipsoid of {name}"
        )
    if known.body_ellipsoid is not None:
        to_unit = known.body_ellipsoid.to_unit()
        E = np.diag([0.0, 0.0, 0.0, 1.0]) - to_unit.T @ to_unit
        row = np.einsum("kij,ij->k", PSEUDO_INERTIA_BASIS, E)
        yield Restriction(
            "nonnegative", row[None], np.zeros(1), f"body_ellipsoid of {name}"
        )
