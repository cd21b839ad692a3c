"""Meaning of columns: quantity, joint and unit, from their names and from a user's map."""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np

from excitant.exceptions import BadInput
from excitant.robots.schema import Finite, Name, convert, read_yaml

Unit = str | float
"""The name of a unit, or how many SI units one logged unit is."""

_TURN = 2 * math.pi
_TURNING: Mapping[str, Mapping[str, float]] = {
    "q": {"rad": 1.0, "mrad": 1e-3, "deg": _TURN / 360, "rev": _TURN},
    "dq": {
        "rad/s": 1.0,
        "mrad/s": 1e-3,
        "deg/s": _TURN / 360,
        "rpm": _TURN / 60,
        "rev/s": _TURN,
    },
    "tau": {
        "Nm": 1.0,
        "mNm": 1e-3,
        "kNm": 1e3,
        "Ncm": 1e-2,
        "kgfm": 9.80665,
        "kgfcm": 0.0980665,
    },
}
_SLIDING: Mapping[str, Mapping[str, float]] = {
    "q": {"m": 1.0, "mm": 1e-3, "cm": 1e-2},
    "dq": {"m/s": 1.0, "mm/s": 1e-3, "cm/s": 1e-2},
    "tau": {"N": 1.0, "kN": 1e3},
}
_UNITS: Mapping[str, Mapping[str, float]] = {
    "t": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0},
    **{role: {**_TURNING[role], **_SLIDING[role]} for role in _TURNING},
    "i": {"A": 1.0, "mA": 1e-3},
}
_SPELLINGS = {
    spelling: unit
    for unit, spellings in {
        "s": "sec secs second seconds",
        "ms": "msec msecs millisecond milliseconds millis",
        "us": "µs μs usec usecs microsecond microseconds micros",
        "ns": "nsec nsecs nanosec nanosecs nanosecond nanoseconds",
        "deg": "° degs degree degrees",
        "rad": "rads radian radians",
        "rev": "turn turns revs",
        "deg/s": "°/s degps dps degrees/s deg/sec",
        "rad/s": "radps radians/s rad/sec rads/s",
        "rev/s": "rps turn/s",
        "rpm": "r/min rev/min 1/min",
        "Nm": "nm NM newtonmeter newtonmeters",
        "mNm": "mnm",
        "mA": "ma milliamps milliampere",
        "A": "amp amps ampere amperes",
    }.items()
    for spelling in spellings.split()
}
_KNOWN = frozenset(unit for units in _UNITS.values() for unit in units)

_ROLES = {
    word: role
    for role, words in {
        "t": "t ts time times timestamp timestamps stamp stamps zeit duration",
        "q": "q pos position positions angle angles theta jointpos",
        "dq": "dq qd qdot vel velocity velocities speed speeds dtheta omega jointvel",
        "ddq": "ddq qdd qddot acc acceleration accelerations",
        "tau": "tau torque torques effort efforts eff trq moment drehmoment",
        "i": "i current currents cur amperage iq",
    }.items()
    for word in words.split()
}
_MEASURED, _COMMANDED, _NEUTRAL = (
    frozenset(words.split())
    for words in (
        "actual act measured meas msr real feedback fb present",
        "target targets desired des commanded command cmd ref reference setpoint set goal planned "
        "model predicted pred estimated est simulated sim",
        "joint joints jnt j a axis axes actuator actuators state states msg data value values log "
        "field header relative rel elapsed unix epoch utc in",
    )
)
PARTS_OF_TIME = {
    **dict.fromkeys(("sec", "secs", "seconds"), "s"),
    **dict.fromkeys(("nanosec", "nanosecs", "nsec", "nsecs", "nanoseconds"), "ns"),
}
"""Words of the whole seconds, and of the nanoseconds, of a stamp in two columns."""
_BRACKETS = re.compile(r"[\[({]([^\])}]*)[\])}]")
_EXACT = re.compile(r"(q|dq|ddq|tau|i)(\d+)", re.ASCII)
_PIECES = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z°µ]+|\d+|[^\W\d_]+")


def spelled(text: str) -> str | None:
    """The unit that a text means, in this module's spelling; None when it means none."""
    plain = unicodedata.normalize("NFKC", text).strip()
    for sign in "·⋅*.- ":
        plain = plain.replace(sign, "")
    plain = plain.replace("persec", "/s").replace("per", "/")
    for word in (plain, plain.lower() if plain[:1] != "M" else plain):
        word = _SPELLINGS.get(word, word)
        if word in _KNOWN:
            return word
    return None


def units_of(role: str) -> tuple[str, ...]:
    """All units that a quantity (``t``, ``q``, ``dq``, ``tau``, ``i``) may be logged in."""
    return tuple(_UNITS.get(role, ()))


def factor(role: str, unit: str, revolute: bool | None = None) -> float | None:
    """SI units per ``unit`` of a quantity; None when it, or a joint of this kind, has none such."""
    kinds = {True: _TURNING, False: _SLIDING, None: _UNITS}
    return kinds[revolute if role in _TURNING else None][role].get(unit)


@dataclass(frozen=True)
class Meaning:
    """Meaning of a column's name."""

    column: str
    role: str | None = None  # t, q, dq, ddq, tau or i
    # its name where the column holds it, else its number
    joint: str | int | None = None
    term: str = ""  # the word that names the quantity
    words: tuple[str, ...] = ()  # what else may change its meaning
    unit: str | None = None
    measured: bool = False
    commanded: bool = False  # or computed


def meaning(column: str, joints: Sequence[str] = ()) -> Meaning:
    """Meaning of a column's name, given the names of the arm's joints."""
    if exact := _EXACT.fullmatch(column):
        return Meaning(column, exact[1], int(exact[2]), exact[1])
    words, unit = _words(column)
    joint: str | int | None
    joint, rest = _named_joint(words, joints)
    if joint is not None and _role(rest)[0] is not None:
        words = rest
    else:
        numbers = [k for k, word in enumerate(words) if word.isdecimal()]
        joint = int(words.pop(numbers[-1])) if numbers else None
    role, rest, present = _role(words)
    term = next((word for word in words if word not in rest), "")
    own = {"motor"} if role == "i" else set[str]()  # which has every current
    others = tuple(w for w in rest if w not in _NEUTRAL | _MEASURED | _COMMANDED | own)
    if unit is not None and role is not None and unit not in units_of(role):
        current = role == "tau" and unit in units_of(
            "i"
        )  # a torque in ampere is a current
        role, others = ("i", others) if current else (role, (*others, unit))
    measured, commanded = (
        not known.isdisjoint(rest) for known in (_MEASURED, _COMMANDED)
    )
    return Meaning(
        column, role, joint, term, others, unit, present or measured, commanded
    )


def _words(column: str) -> tuple[list[str], str | None]:
    unit: str | None = None

    def inside(match: re.Match[str]) -> str:
        nonlocal unit
        found = None if match[1].strip().isdecimal() else spelled(match[1])
        unit = unit or found
        return " " if found else f" {match[1]} "

    plain = _BRACKETS.sub(inside, unicodedata.normalize("NFKC", column))
    words: list[str] = []
    chunks = [chunk for chunk in re.split(r"[\W_]+(?<!°)", plain) if chunk]
    for chunk in chunks:
        found = (
            spelled(chunk)
            if len(chunk) > 1 or (chunk == "A" and len(chunks) > 1)
            else None
        )
        if unit in ("rad", "deg", "rev", "m", "mm") and "s" in (chunk, found):
            unit = f"{unit}/s"
        elif found is not None and chunk.lower() not in PARTS_OF_TIME:
            unit = unit or found
        elif chunk == "s" and words:
            unit = unit or "s"
        else:
            words += [piece.lower() for piece in _PIECES.findall(chunk)]
    words = " ".join(words).replace("nano sec", "nanosec").split()
    if unit is None and len(words) > 1 and words[-1] not in _ROLES:
        found = spelled(words[-1]) if len(words[-1]) > 1 else None
        if found is not None and words[-1] not in PARTS_OF_TIME:
            return words[:-1], found
    return words, unit


def _named_joint(
    words: list[str], joints: Sequence[str]
) -> tuple[str | None, list[str]]:
    """The joint whose name stands in a column's, longest first, and the other words."""
    forms = [(joint, _words(joint)[0]) for joint in joints]
    short = [(joint, [w for w in form if w not in _NEUTRAL]) for joint, form in forms]
    bare = [form for _, form in short]
    forms += [
        (joint, form)
        for joint, form in short
        if any(len(w) > 1 and not w.isdecimal() for w in form) and bare.count(form) == 1
    ]
    for joint, form in sorted(forms, key=lambda pair: -len(pair[1])):
        for k in range(len(words) - len(form) + 1) if form else ():
            if words[k : k + len(form)] == form:
                return joint, words[:k] + words[k + len(form) :]
    return None, words


def _role(words: list[str]) -> tuple[str | None, list[str], bool]:
    """The quantity, the other words, and whether "current" meant "present"."""
    roles = [(k, _ROLES[word]) for k, word in enumerate(words) if word in _ROLES]
    if not roles:
        return (
            "t" if any(word in PARTS_OF_TIME for word in words) else None,
            words,
            False,
        )
    current = len(roles) == 2 and roles[0][1] == "i" and words[roles[0][0]] == "current"
    k, role = roles[-1] if current else roles[0]
    rest = [
        word
        for j, word in enumerate(words)
        if j != k and not (current and word == "current")
    ]
    if role == "t":
        rest = [word for word in rest if _ROLES.get(word) != "t"]
    dots = sum({"dot": 1, "ddot": 2}.get(word, 0) for word in rest)
    if role == "q" and dots:
        rest = [word for word in rest if word not in ("dot", "ddot")]
        role = "dq" if dots == 1 else "ddq"
    return role, rest, current


_ASKED = ("t", "q", "dq", "tau", "i")
_Names = Name | Annotated[list[Name], msgspec.Meta(min_length=1)] | None
_UnitsGiven = str | Finite | list[str | Finite] | None
_Constants = Finite | list[Finite] | None


def _record(name: str, kinds: Mapping[str, Any]) -> Any:
    fields = [(entry, kind, None) for entry, kind in kinds.items()]
    return msgspec.defstruct(name, fields, frozen=True, forbid_unknown_fields=True)


_UnitsRecord = _record(
    "Units", {**dict.fromkeys(_ASKED, _UnitsGiven), "t": str | Finite | None}
)
_DriveRecord = _record("Drive", {"gain_Nm_per_A": _Constants, "gear_ratio": _Constants})
_ColumnsRecord = _record(
    "Columns",
    {
        **dict.fromkeys(_ASKED, _Names),
        **dict.fromkeys(("units", "drive"), Any),
        "sign": dict[Name, float | dict[Name, float]] | None,
        "topic": str | None,
    },
)


@dataclass(frozen=True)
class ColumnMap:
    """Columns of a recording by quantity; those not given are inferred from names.

    Attributes:
        columns: Per quantity (``t, q, dq, tau, i``) the column of each joint in the robot's
            order, or one text: a column, a pattern with ``{0}`` (joints counted from 0), ``{1}``
            (from 1) or ``{joint}`` (its name), or what the columns' names have in common.
        units: Per quantity one unit or one per joint; a number is how many SI units one is.
        sign: +1 or −1 per quantity (``q, dq, tau``) and joint whose axis is logged reversed.
        drive: Torque at each joint per ampere [N·m/A], where currents are to become torques.
        topic: Topic of a bag.
        torque: Prefix of the torque columns where ``columns`` names none: ``i`` for ``i1, i2, ..``.
        source: File it was read from.
    """

    columns: Mapping[str, str | tuple[str, ...]] = field(default_factory=dict)
    units: Mapping[str, Unit | tuple[Unit, ...]] = field(default_factory=dict)
    sign: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    drive: tuple[float, ...] | None = None
    topic: str | None = None
    torque: str | None = None
    source: str = "columns.yaml"


def load_column_map(path: str | Path) -> ColumnMap:
    """Column map from YAML, such as ``{t: stamp, q: 'pos_{1}', tau: [a, b], units: {q: deg}}``.

    ``sign: {joint: -1}`` turns a joint round, ``sign: {tau: {joint: -1}}`` its torque alone.
    ``drive: {gain_Nm_per_A: [..], gear_ratio: [..]}`` makes torque of current.

    Raises:
        BadInput: Unreadable, unknown entries or units, with the nearest that exists.
    """
    return column_map(read_yaml(path, Any, "what columns mean"), str(path))


def column_map(content: object, source: str) -> ColumnMap:
    """Column map from the content of a YAML file; see `load_column_map`."""
    record = convert(content, _ColumnsRecord, source)
    units = convert(record.units or {}, _UnitsRecord, source, "units")
    columns: dict[str, str | tuple[str, ...]] = {}
    given: dict[str, Unit | tuple[Unit, ...]] = {}
    for role in _ASKED:
        if (names := getattr(record, role)) is not None:
            listed = isinstance(names, list)
            columns[role] = tuple(map(str, names)) if listed else str(names)
        if (unit := getattr(units, role)) is not None:
            some = [
                _unit(role, u, source)
                for u in (unit if isinstance(unit, list) else [unit])
            ]
            given[role] = tuple(some) if isinstance(unit, list) else some[0]
    return ColumnMap(
        columns=columns,
        units=given,
        sign=_signs(record.sign or {}, source),
        drive=drive_of(record.drive, source),
        topic=record.topic,
        source=source,
    )


def drive_of(content: object, source: str) -> tuple[float, ...] | None:
    """Torque at each joint per ampere [N·m/A] from ``{gain_Nm_per_A: [..], gear_ratio: [..]}``.

    The gains are those of the motors where there are ratios. None without gains.

    Raises:
        BadInput: Unknown entries, or anything but finite numbers other than zero.
    """
    record = convert(content or {}, _DriveRecord, source, "drive")
    if not record.gain_Nm_per_A:
        return None
    gains = np.atleast_1d(np.array(record.gain_Nm_per_A, float))
    ratios = np.atleast_1d(np.array(record.gear_ratio or np.ones(len(gains)), float))
    if len(ratios) != len(gains):
        raise BadInput(
            f"{source}: drive: {len(gains)} gains and {len(ratios)} gear ratios"
        )
    if not (gains * ratios).all():
        raise BadInput(f"{source}: drive: no gain and no gear ratio may be 0")
    return tuple((gains * ratios).tolist())


def _unit(role: str, value: str | float, source: str) -> Unit:
    unit = spelled(value) if isinstance(value, str) else float(value)
    if unit and (isinstance(unit, float) or unit in units_of(role)):
        return unit
    known = ", ".join(units_of(role))
    raise BadInput(
        f"{source}: {role} has no unit '{value}'; known: {known}, or a number"
    )


def _signs(content: Mapping[Any, Any], source: str) -> dict[str, dict[str, float]]:
    found: dict[str, dict[str, float]] = {"q": {}, "dq": {}, "tau": {}}
    for name, value in content.items():
        some = value if isinstance(value, dict) else {name: value}
        roles = [str(name)] if isinstance(value, dict) else list(found)
        for joint, sign in some.items():
            if sign not in (1, -1) or roles[0] not in found:
                raise BadInput(
                    f"{source}: sign of '{joint}' must be 1 or -1, for q, dq or tau"
                )
            for role in roles:
                found[role][str(joint)] = sign
    return found
