"""Names of columns and units: which quantity, joint and unit a column holds, as its name says."""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

Unit = str | float
"""The name of a unit, or how many SI units one logged unit is."""

_TURN = 2 * math.pi
_TURNING: Mapping[str, Mapping[str, float]] = {
    "q": {"rad": 1.0, "mrad": 1e-3, "deg": _TURN / 360, "rev": _TURN},
    "dq": {"rad/s": 1.0, "mrad/s": 1e-3, "deg/s": _TURN / 360, "rpm": _TURN / 60, "rev/s": _TURN},
    "tau": {"Nm": 1.0, "mNm": 1e-3, "kNm": 1e3, "Ncm": 1e-2, "kgfm": 9.80665, "kgfcm": 0.0980665},
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
        "t": "t time times timestamp timestamps stamp stamps",
        "q": "q pos position positions angle angles theta jointpos",
        "dq": "dq qd qdot vel velocity velocities speed speeds dtheta omega jointvel",
        "ddq": "ddq qdd qddot acc acceleration accelerations",
        "tau": "tau torque torques effort efforts trq moment",
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
        "joint joints jnt j axis axes state states msg data value values log header relative rel "
        "elapsed unix epoch utc in",
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
    """What a column's name says."""

    column: str
    role: str | None = None  # t, q, dq, ddq, tau or i
    joint: str | int | None = None  # its name where the column holds it, else its number
    term: str = ""  # the word that names the quantity
    words: tuple[str, ...] = ()  # what else may change its meaning
    unit: str | None = None
    measured: bool = False
    commanded: bool = False  # or computed


def meaning(column: str, joints: Sequence[str] = ()) -> Meaning:
    """What a column's name says, given the names of the arm's joints."""
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
    others = tuple(word for word in rest if word not in _NEUTRAL | _MEASURED | _COMMANDED)
    found = Meaning(
        column,
        role,
        joint,
        next((word for word in words if word not in rest), ""),
        others,
        unit,
        present or any(word in _MEASURED for word in rest),
        any(word in _COMMANDED for word in rest),
    )
    if unit is None or role is None or unit in units_of(role):
        return found
    if role == "tau" and unit in units_of("i"):  # a torque in ampere is a current
        return replace(found, role="i")
    return replace(found, words=(*others, unit))


def _words(column: str) -> tuple[list[str], str | None]:
    """Words of a name in lower case, and its unit."""
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
        found = spelled(chunk) if len(chunk) > 1 or (chunk == "A" and len(chunks) > 1) else None
        if unit in ("rad", "deg", "rev", "m", "mm") and "s" in (chunk, found):
            unit = f"{unit}/s"
        elif found is not None and chunk.lower() not in PARTS_OF_TIME:
            unit = unit or found
        elif chunk == "s" and words:
            unit = unit or "s"
        else:
            words += [piece.lower() for piece in _PIECES.findall(chunk)]
    if unit is None and len(words) > 1 and words[-1] not in _ROLES:
        found = spelled(words[-1]) if len(words[-1]) > 1 else None
        if found is not None and words[-1] not in PARTS_OF_TIME:
            return words[:-1], found
    return words, unit


def _named_joint(words: list[str], joints: Sequence[str]) -> tuple[str | None, list[str]]:
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
        return "t" if any(word in PARTS_OF_TIME for word in words) else None, words, False
    current = len(roles) == 2 and roles[0][1] == "i" and words[roles[0][0]] == "current"
    k, role = roles[-1] if current else roles[0]
    rest = [word for j, word in enumerate(words) if j != k and not (current and word == "current")]
    if role == "t":
        rest = [word for word in rest if _ROLES.get(word) != "t"]
    dots = sum({"dot": 1, "ddot": 2}.get(word, 0) for word in rest)
    if role == "q" and dots:
        rest = [word for word in rest if word not in ("dot", "ddot")]
        role = "dq" if dots == 1 else "ddq"
    return role, rest, current
