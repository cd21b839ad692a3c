"""Knowledge: what is known of an arm's bodies before any data, from a data sheet or a drawing."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from excitant.exceptions import BadInput, UnknownName
from excitant.robots.yaml_entries import yaml_content

PRIORS = ("pullback", "entropic", "euclidean")
_KEYS = ("prior", "total_mass", "links")
_EXAMPLE = "{prior: entropic, total_mass: 33.5, links: {forearm: {mass: {value: 2.3, std: 0.1}}}}"
_ELLIPSOID = "{centre: [x, y, z], radii: [a, b, c]}"
Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Quantity:
    """A number that is known.

    Attributes:
        value: The number [SI].
        std: Its standard deviation; 0 where it holds exactly.
    """

    value: float
    std: float = 0.0


@dataclass(frozen=True)
class Box:
    """Points between two corners of a link's frame.

    Attributes:
        low: Least coordinates [m].
        high: Greatest coordinates [m].
    """

    low: Vector
    high: Vector


@dataclass(frozen=True)
class Ellipsoid:
    """Points of an ellipsoid along the axes of a link's frame.

    Attributes:
        centre: Its centre [m].
        radii: Its half axes [m].
    """

    centre: Vector
    radii: Vector


@dataclass(frozen=True)
class LinkKnowledge:
    """What is known of one link, everything fixed to it included; None where nothing is.

    Attributes:
        mass: Its mass [kg].
        com_box: Where its centre of mass lies.
        com_ellipsoid: Where its centre of mass lies.
        body_ellipsoid: What the whole body lies in (Wensing, Kim, Slotine 2018).
    """

    mass: Quantity | None = None
    com_box: Box | None = None
    com_ellipsoid: Ellipsoid | None = None
    body_ellipsoid: Ellipsoid | None = None


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

    prior: str = "pullback"
    total_mass: Quantity | None = None
    links: Mapping[str, LinkKnowledge] = field(default_factory=dict)
    source: str = "knowledge"

    def __post_init__(self) -> None:
        if self.prior not in PRIORS:
            raise UnknownName("prior", self.prior, PRIORS)

    @property
    def sentence(self) -> str:
        """What is taken for known, beside the given bodies; empty where nothing is."""
        said = [] if self.total_mass is None else [f"total mass {_written(self.total_mass)}"]
        for name, each in self.links.items():
            places = [k for k in ("com_box", "com_ellipsoid", "body_ellipsoid") if vars(each)[k]]
            mass = [] if each.mass is None else [f"mass {_written(each.mass)}"]
            said.append(f"{name}: {', '.join([*mass, *places])}")
        return f"taken for known from {self.source}: {'; '.join(said)}" if said else ""

    def entry(self) -> dict[str, Any]:
        """As in the file, without what is not known."""
        links = {name: _known(vars(each)) for name, each in self.links.items()}
        return _known({"prior": self.prior, "total_mass": self.total_mass, "links": links})


def _written(quantity: Quantity) -> str:
    spread = f" ± {quantity.std:g}" if quantity.std else ""
    return f"{quantity.value:g}{spread} kg"


def _known(values: Mapping[str, Any]) -> dict[str, Any]:
    return {
        key: _entry(value) for key, value in values.items() if value is not None and value != {}
    }


def _entry(value: Any) -> Any:
    if isinstance(value, Quantity):
        return {"value": value.value, "std": value.std} if value.std else value.value
    if isinstance(value, Box):
        return [list(value.low), list(value.high)]
    if isinstance(value, Ellipsoid):
        return {"centre": list(value.centre), "radii": list(value.radii)}
    return value


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
    return knowledge_of(yaml_content(path, "what is known"), links, str(path))


def knowledge_of(content: object, links: Sequence[str], source: str) -> Knowledge:
    """Knowledge from the content of a YAML file; see `load_knowledge`."""
    entries = _entries(content, source, _KEYS, _EXAMPLE)
    prior = entries.get("prior", "pullback")
    if prior not in PRIORS:
        raise BadInput(f"{source}: {UnknownName('prior', str(prior), PRIORS)}")
    total = entries.get("total_mass")
    about = _entries(entries.get("links") or {}, f"{source}: links", links, _EXAMPLE, "link")
    return Knowledge(
        prior,
        None if total is None else _mass(total, f"{source}: total_mass"),
        {name: _link(value, f"{source}: links: {name}") for name, value in about.items()},
        source,
    )


def _entries(
    content: object, where: str, known: Iterable[str], example: str, kind: str = "entry"
) -> dict[str, Any]:
    if not isinstance(content, dict):
        raise BadInput(f"{where}: expected entries such as {example}")
    for key in content:
        if key not in tuple(known):
            raise BadInput(f"{where}: {UnknownName(kind, str(key), known)}")
    return content


def _link(content: object, where: str) -> LinkKnowledge:
    keys = tuple(LinkKnowledge.__dataclass_fields__)
    entries = _entries(content, where, keys, "{mass: 2.3, com_box: [[lo..], [hi..]]}")
    given = {key: (value, f"{where}: {key}") for key, value in entries.items() if value is not None}
    return LinkKnowledge(
        mass=_mass(*given["mass"]) if "mass" in given else None,
        com_box=_box(*given["com_box"]) if "com_box" in given else None,
        com_ellipsoid=_ellipsoid(*given["com_ellipsoid"]) if "com_ellipsoid" in given else None,
        body_ellipsoid=_ellipsoid(*given["body_ellipsoid"]) if "body_ellipsoid" in given else None,
    )


def _mass(content: object, where: str) -> Quantity:
    if isinstance(content, dict):
        entries = _entries(content, where, ("value", "std"), "{value: 2.3, std: 0.1}")
        value, std = (_number(entries.get(key, 0.0), f"{where}: {key}") for key in ("value", "std"))
    else:
        value, std = _number(content, where), 0.0
    if value <= 0 or std < 0:
        raise BadInput(
            f"{where}: {value:g} kg ± {std:g} kg is no mass; give a value above 0, and a std of 0 "
            "where it holds exactly"
        )
    return Quantity(value, std)


def _box(content: object, where: str) -> Box:
    if not isinstance(content, list) or len(content) != 2:
        raise BadInput(f"{where}: expected two corners, [[x, y, z], [x, y, z]] in metres")
    low, high = (_vector(corner, where) for corner in content)
    for axis, least, greatest in zip("xyz", low, high, strict=True):
        if least > greatest:
            raise BadInput(
                f"{where}: along {axis} the first corner ({least:g} m) lies above the second "
                f"({greatest:g} m); exchange them"
            )
    return Box(low, high)


def _ellipsoid(content: object, where: str) -> Ellipsoid:
    entries = _entries(content, where, ("centre", "radii"), _ELLIPSOID)
    if len(entries) != 2:
        raise BadInput(f"{where}: needs both of {_ELLIPSOID} in metres")
    centre, radii = (_vector(entries[key], f"{where}: {key}") for key in ("centre", "radii"))
    if min(radii) <= 0:
        raise BadInput(f"{where}: radii must be above 0; for a known place give a com_box")
    return Ellipsoid(centre, radii)


def _vector(content: object, where: str) -> Vector:
    if not isinstance(content, list) or len(content) != 3:
        raise BadInput(f"{where}: expected three numbers, [x, y, z] in metres")
    x, y, z = (_number(value, where) for value in content)
    return x, y, z


def _number(content: object, where: str) -> float:
    if isinstance(content, bool) or not isinstance(content, int | float):
        raise BadInput(f"{where}: '{content}' is no number")
    if not math.isfinite(content):
        raise BadInput(f"{where}: {content} is not finite; leave out what is not known")
    return float(content)
