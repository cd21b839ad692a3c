"""Knowledge: what is known of an arm's bodies before any data, from a data sheet or a drawing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import msgspec

from excitant.exceptions import BadInput, UnknownName
from excitant.robots.schema import Positive, Record, Three, convert, read_yaml

PRIORS = ("pullback", "entropic", "euclidean")


class Quantity(Record, frozen=True):
    """A number that is known.

    Attributes:
        value: The number [SI].
        std: Its standard deviation; 0 where it holds exactly.
    """

    value: Positive
    std: Annotated[float, msgspec.Meta(ge=0, le=1e300)] = 0.0

    def __str__(self) -> str:
        return f"{self.value:g}" + (f" ± {self.std:g}" if self.std else "")


class Box(Record, frozen=True, array_like=True):
    """Points between two corners of a link's frame.

    Attributes:
        low: Least coordinates [m].
        high: Greatest coordinates [m].
    """

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
    """Points of an ellipsoid along the axes of a link's frame.

    Attributes:
        centre: Its centre [m].
        radii: Its half axes [m].
    """

    centre: Three
    radii: tuple[Positive, Positive, Positive]


class LinkKnowledge(Record, frozen=True, omit_defaults=True):
    """What is known of one link, everything fixed to it included; None where nothing is.

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


class KnowledgeRecord(Record, frozen=True):
    """A file of what is known; the entries of ``links`` are `LinkKnowledge`."""

    prior: str = PRIORS[0]
    total_mass: Positive | Quantity | None = None
    links: dict[str, Any] | None = None


@dataclass(frozen=True)
class Knowledge:
    """What a physically consistent fit may take for granted.

    Attributes:
        prior: How distance to the given bodies is measured: ``"pullback"``, ``"entropic"`` or
            ``"euclidean"``.
        total_mass: Mass of all moving links together, the base not counted [kg].
        links: What is known of links, by name.
        source: File it was read from.
    """

    prior: str = PRIORS[0]
    total_mass: float | Quantity | None = None
    links: Mapping[str, LinkKnowledge] = field(default_factory=dict)
    source: str = "knowledge"

    def __post_init__(self) -> None:
        if self.prior not in PRIORS:
            raise UnknownName("prior", self.prior, PRIORS)

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
        """What is taken for known, beside the given bodies; empty where nothing is."""
        masses = self.masses
        said = [f"total mass {masses['total_mass']} kg"] if "total_mass" in masses else []
        for name, link in self.links.items():
            mass = [f"mass {masses[f'mass of {name}']} kg"] if link.mass is not None else []
            regions = [key for key in link.__struct_fields__[1:] if getattr(link, key) is not None]
            said.append(f"{name}: {', '.join([*mass, *regions])}")
        return f"taken for known from {self.source}: {'; '.join(said)}" if said else ""

    def entry(self) -> dict[str, Any]:
        """As in the file, without what is not known."""
        known = {"prior": self.prior, "total_mass": self.total_mass, "links": dict(self.links)}
        known = {key: value for key, value in known.items() if value not in (None, {})}
        return dict(msgspec.json.decode(msgspec.json.encode(known)))


def load_knowledge(path: str | Path, links: Sequence[str]) -> Knowledge:
    """Knowledge from YAML.

    ``{prior: entropic, total_mass: 33.5, links: {forearm: {mass: {value: 2.3, std: 0.1},
    com_box: [[-0.1, -0.1, 0], [0.1, 0.1, 0.4]]}}}``; lengths in metres in the link's frame.

    Args:
        path: The file.
        links: Names of the robot's links.

    Raises:
        BadInput: Unreadable, unknown entries or links, or values that nothing can have.
    """
    found = read_yaml(path, KnowledgeRecord, "what is known of the bodies")
    about = found.links or {}
    for name in about:
        if name not in links:
            raise BadInput(f"{path}: links: {UnknownName('link', name, links)}")
    if found.prior not in PRIORS:
        raise BadInput(f"{path}: {UnknownName('prior', found.prior, PRIORS)}")
    known = {
        name: convert(content, LinkKnowledge, path, f"links.{name}")
        for name, content in about.items()
    }
    return Knowledge(found.prior, found.total_mass, known, str(path))
