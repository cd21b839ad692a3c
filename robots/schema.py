"""YAML and JSON files that users write, as typed records."""

from __future__ import annotations

import json
import math
import re
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import msgspec
import yaml

from excitant.exceptions import BadInput, UnknownName
from excitant.files import read_text

T = TypeVar("T")
Finite = Annotated[float, msgspec.Meta(ge=-1e9, le=1e9)]
Positive = Annotated[float, msgspec.Meta(gt=0, le=1e9)]
Three = tuple[Finite, Finite, Finite]
Name = str | int
OfJoints = float | list[float] | dict[str, float] | None
_DEEPEST = 50  # levels of nesting
_DIGITS = 18  # of a whole number that is kept as one
_VALUES = 300_000  # values and characters that aliases may stand for
_MERGED = 10_000  # entries of a mapping


class Record(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Entries of a file, all of them known."""


class LimitsRecord(Record, frozen=True):
    """Limits: one value for all joints, one for each, or values by the joints' names."""

    position: (
        list[float | tuple[float, float]] | dict[str, tuple[float, float]] | None
    ) = None
    velocity: OfJoints = None
    acceleration: OfJoints = None
    torque: OfJoints = None
    jerk: OfJoints = None


class CylinderRecord(Record, frozen=True):
    """A cylinder of a link or the base, or a sphere where both ends coincide [m]."""

    start: Three = msgspec.field(name="from")
    end: Three = msgspec.field(name="to")
    radius: Positive


class TensorRecord(Record, frozen=True):
    """Elements of an inertia tensor [kg·m²]."""

    xx: Finite = 0.0
    xy: Finite = 0.0
    yy: Finite = 0.0
    xz: Finite = 0.0
    yz: Finite = 0.0
    zz: Finite = 0.0


class DHRecord(Record, frozen=True):
    """A joint and its link in Denavit-Hartenberg form; see `excitant.robots.dh`."""

    m: Positive
    a: Finite = 0.0
    d: Finite = 0.0
    alpha: Finite = 0.0
    theta: Finite = 0.0
    type: Literal["revolute", "prismatic"] = "revolute"
    joint: Name | None = None
    link: Name | None = None
    com: Three | None = None
    mc: Three | None = None
    I: TensorRecord | None = None  # noqa: E741 - the letter of the literature
    Ic: TensorRecord | None = None
    collision: tuple[CylinderRecord, ...] | None = None


class PlaceRecord(Record, frozen=True):
    """A pose [m, and the file's unit of angles]."""

    position: Three = (0.0, 0.0, 0.0)
    rpy: Three = (0.0, 0.0, 0.0)
    collision: tuple[CylinderRecord, ...] | None = None


class AboutRecord(Record, frozen=True):
    """Description of a built-in arm."""

    kind: str
    source: str
    payload_kg: Positive | None = None
    mass_kg: Positive | None = None


class RobotRecord(msgspec.Struct, frozen=True):
    """A ``robot.yaml``; entries that it does not know are left to others."""

    model: str | None = None
    name: Name | None = None
    dh: Annotated[tuple[DHRecord, ...], msgspec.Meta(min_length=1)] | None = None
    convention: Literal["standard", "modified"] | None = None
    angles: Literal["radians", "degrees"] = "radians"
    base: str | int | PlaceRecord | None = None
    tool: PlaceRecord | None = None
    gravity: Three | None = None
    joints: tuple[Name, ...] | None = None
    tip: Name | None = None
    lock: dict[str, Finite] | None = None
    xacro_args: dict[str, Any] | None = None
    packages: tuple[str, ...] | None = None
    limits: LimitsRecord | None = None
    effects: list[dict[str, Any]] | None = None
    estimate: str | None = None
    drive: Any = None
    about: AboutRecord | None = None
    sources: str = ""
    tables: list[dict[str, Any]] | None = None


class BoxRecord(Record, frozen=True):
    """A box in the cell [m, rad]."""

    size: tuple[Positive, Positive, Positive]
    position: Three
    rpy: Three = (0.0, 0.0, 0.0)


class SphereRecord(Record, frozen=True):
    """A sphere in the cell [m]."""

    radius: Positive
    position: Three


class HalfSpaceRecord(Record, frozen=True):
    """All points x with n·x ≤ offset [m]."""

    normal: Three
    offset: Finite

    def __post_init__(self) -> None:
        if not any(self.normal):
            raise ValueError("normal must not be zero")


class WorkspaceRecord(Record, frozen=True):
    """The axis-aligned box that the tool point stays in [m]."""

    low: Three
    high: Three

    def __post_init__(self) -> None:
        if not all(a < b for a, b in zip(self.low, self.high, strict=True)):
            raise ValueError("low must be below high in x, y and z")


class ObstacleRecord(Record, frozen=True):
    """One obstacle, of one shape."""

    name: str = ""
    box: BoxRecord | None = None
    sphere: SphereRecord | None = None
    half_space: HalfSpaceRecord | None = None
    workspace: WorkspaceRecord | None = None

    def __post_init__(self) -> None:
        if sum(getattr(self, shape) is not None for shape in OBSTACLE_SHAPES) != 1:
            raise ValueError(f"give exactly one of {', '.join(OBSTACLE_SHAPES)}")


OBSTACLE_SHAPES = ("box", "sphere", "half_space", "workspace")


def read_yaml(path: str | Path, kind: type[T], holds: str) -> T:
    """Content of a YAML file, or of a JSON file where its name ends so, as a type.

    Args:
        path: The file.
        kind: What it holds; a `Record` or any type that msgspec knows, ``Any`` included.
        holds: The same in words for messages, such as ``limits``.

    Raises:
        BadInput: Missing, unreadable, neither YAML nor JSON, or not of the type; says where.
    """
    path = Path(path)
    language = "JSON" if path.suffix == ".json" else "YAML"
    try:
        text = read_text(path)
        content = parsed_json(text) if language == "JSON" else parsed_yaml(text)
    except FileNotFoundError:
        raise BadInput(
            f"{path}: no such file; give a {language} file of {holds}"
        ) from None
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", "not UTF-8")
        why = f"cannot be read ({reason}); give a {language} file of {holds}"
        raise BadInput(f"{path}: {why}") from None
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise BadInput(
            f"{path}: not valid {language} ({_fault(error)}); correct it there"
        ) from None
    return convert(content, kind, path)


def in_one_line(content: object) -> str:
    """Content of a YAML file on one line."""
    text = yaml.safe_dump(
        content,
        default_flow_style=True,
        sort_keys=False,
        width=1 << 20,
        allow_unicode=True,
    )
    return text.strip()


def parsed_json(text: str | bytes, number: Callable[[str], float] = float) -> Any:
    """Content of JSON.

    Raises:
        ValueError: It is none, nests too deep, has a key twice, or ``number`` refuses one.
    """

    def whole(text: str) -> float:
        return int(text) if len(text) <= _DIGITS else number(text)

    content = json.loads(
        text,
        object_pairs_hook=_entries,
        parse_constant=number,
        parse_float=number,
        parse_int=whole,
    )
    _refuse_excess(content, math.inf)
    return content


def _entries(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    entries = dict(pairs)
    if len(entries) < len(pairs):
        [(twice, _)] = Counter(key for key, _ in pairs).most_common(1)
        raise ValueError(f"'{twice}' is given twice")
    return entries


def parsed_yaml(text: str, loader: type[Loader] | None = None) -> Any:
    """Content of YAML.

    Raises:
        ValueError: It nests too deep, or is huge.
        YAMLError: It is none, or has a key twice.
    """
    content = yaml.load(text, loader or Loader)
    _refuse_excess(content, _VALUES)
    return content


def finite(text: str) -> float:
    """The number that a text stands for; ValueError where it is not finite."""
    if not math.isfinite(value := float(text)):
        raise ValueError(f"{text} is no finite number")
    return value


def _refuse_excess(content: object, most: float) -> None:
    """Refuse, as ValueError, nesting too deep, or too many values and characters.

    What is shared counts each time, so that lists that hold themselves are refused.
    """
    total = 0
    level = [content]
    for _ in range(_DEEPEST):
        inner: list[object] = []
        for value in level:
            total += 1 + (len(value) if isinstance(value, str) else 0)
            if isinstance(value, dict):
                inner += [*value, *value.values()]
            elif isinstance(value, list | tuple | set):
                inner += value
            if total + len(inner) > most:
                raise ValueError(f"it stands for more than {most:g} values")
        if not inner:
            return
        level = inner
    raise ValueError(f"nested more than {_DEEPEST} deep")


def convert(
    content: object, kind: type[T], source: str | Path, where: str = ""
) -> T:
    """Content of a file as a type.

    Args:
        content: What YAML or JSON gave.
        kind: What it should be.
        source: The file, for messages.
        where: The part of the file that it is.

    Raises:
        BadInput: It is something else; says where, such as ``limits.velocity[2]``.
    """
    try:
        return msgspec.convert(content, kind, str_keys=True)
    except msgspec.ValidationError as error:
        why, _, path = str(error).partition(" - at `")
        place = where + path.rstrip("`").removeprefix("key in ").removeprefix("$")
        unknown = re.search("unknown field `(.*)`", why)
        if unknown:
            own = () if path else getattr(kind, "__struct_encode_fields__", ())
            why = str(UnknownName("entry", unknown[1], own or _known(place)))
        why = re.sub("Object missing required field `(.*)`", r"it lacks '\1'", why)
        why = re.sub(r"`([a-z |]+)`", lambda found: _in_words(found[1]), why)
        why = re.sub(r"number [<>]= -?1000000000.0", "finite number up to 1e9", why)
        why = why.replace("> 0.0", "above 0")
        why = why[0].lower() + why[1:]
        raise BadInput(
            ": ".join(x for x in (str(source), place.strip("."), why) if x)
        ) from None


_WORDS = {
    "float": "a number",
    "int": "a number",
    "str": "text",
    "null": "nothing",
    "bool": "true or false",
    "array": "a list",
    "object": "entries 'name: value'",
}


def _in_words(types: str) -> str:
    names = [name for name in types.split(" | ") if name != "null"] or ["null"]
    return " or ".join(dict.fromkeys(_WORDS.get(name, name) for name in names))


def _known(place: str) -> tuple[str, ...]:
    """Names that an entry may have, of the records that have a field of the place's name."""
    owner = re.sub(r"\[.*?\]", "", place).rpartition(".")[2]
    kinds = [_RECORDS[owner]] if owner in _RECORDS else Record.__subclasses__()
    names = (name for kind in kinds for name in kind.__struct_encode_fields__)
    return tuple(dict.fromkeys(names))


_RECORDS = {
    "limits": LimitsRecord,
    "dh": DHRecord,
    "base": PlaceRecord,
    "tool": PlaceRecord,
    "I": TensorRecord,
    "Ic": TensorRecord,
    "collision": CylinderRecord,
    "obstacles": ObstacleRecord,
    "box": BoxRecord,
    "sphere": SphereRecord,
    "workspace": WorkspaceRecord,
}


def _fault(error: Exception) -> str:
    """The fault in a text, with its line where that is known."""
    if isinstance(error, json.JSONDecodeError):
        return f"line {error.lineno}: {error.msg}"
    if isinstance(error, yaml.MarkedYAMLError) and error.problem_mark is not None:
        return (
            f"line {error.problem_mark.line + 1}: {error.problem or error.context}"
        )
    return str(error).partition("\n")[0] or type(error).__name__


class Loader(yaml.SafeLoader):
    """YAML 1.2's numbers, so that 1e-3 is one, and no key twice."""

    def compose_mapping_node(self, anchor: Any) -> yaml.MappingNode:
        """Refuse a key that is given twice, of which the last would count."""
        node = super().compose_mapping_node(anchor)
        seen = set[tuple[str, str]]()
        for key, _ in node.value:
            name = (key.tag, str(key.value))
            # what several << name is joined
            if name in seen and key.value != "<<":
                why = f"'{key.value}' is given twice"
                raise yaml.composer.ComposerError(None, None, why, key.start_mark)
            seen.add(name)
        return node

    def flatten_mapping(self, node: yaml.MappingNode) -> None:
        """Join the mappings that ``<<`` names, as long as that stays of a size."""
        super().flatten_mapping(node)
        if len(node.value) > _MERGED:
            raise yaml.YAMLError(f"it joins more than {_MERGED} entries")


Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)[eE][-+]?[0-9]+$"),
    list("-+0123456789."),
)
