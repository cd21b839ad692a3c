"""Column names: what a name says about quantity, joint, unit and whether it was measured."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass, replace

from excitant.identify.importers.units import spelled, units_of

_WORDS = {
    "t": "t time times timestamp timestamps stamp stamps",
    "q": "q pos position positions angle angles theta jointpos",
    "dq": "dq qd qdot vel velocity velocities speed speeds dtheta omega jointvel",
    "ddq": "ddq qdd qddot acc acceleration accelerations",
    "tau": "tau torque torques effort efforts trq moment",
    "i": "i current currents cur amperage iq",
}
_ROLES = {word: role for role, words in _WORDS.items() for word in words.split()}
_QUALIFIERS = (
    "actual act measured meas msr real feedback fb present",
    "target targets desired des commanded command cmd ref reference setpoint set goal planned "
    "model predicted pred estimated est simulated sim",
    "joint joints jnt j axis axes state states msg data value values log header relative rel "
    "elapsed unix epoch utc in",
)
_MEASURED, _COMMANDED, _NEUTRAL = (frozenset(words.split()) for words in _QUALIFIERS)
PARTS_OF_TIME = {
    **dict.fromkeys(("sec", "secs", "seconds"), "s"),
    **dict.fromkeys(("nanosec", "nanosecs", "nsec", "nsecs", "nanoseconds"), "ns"),
}
"""Words of the whole seconds, and of the nanoseconds, of a stamp in two columns."""
_BRACKETS = re.compile(r"[\[({]([^\])}]*)[\])}]")
_EXACT = re.compile(r"(q|dq|ddq|tau|i)(\d+)", re.ASCII)
_PIECES = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z°µ]+|\d+|[^\W\d_]+")


@dataclass(frozen=True)
class Meaning:
    """What a column's name says.

    Attributes:
        column: The name as logged.
        role: ``t``, ``q``, ``dq``, ``ddq``, ``tau``, ``i``; None when it names none of them, or
            a commanded or modelled quantity.
        joint: Joint's name where the column holds it, else the number in it, else None.
        term: The word that names the quantity.
        words: What else the name holds, which may change its meaning.
        unit: Unit in the name.
        measured: Whether the name says that it was measured.
        commanded: Whether the name says that it was commanded or computed.
    """

    column: str
    role: str | None = None
    joint: str | int | None = None
    term: str = ""
    words: tuple[str, ...] = ()
    unit: str | None = None
    measured: bool = False
    commanded: bool = False


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
    found = Meaning(
        column,
        role,
        joint,
        next((word for word in words if word not in rest), ""),
        tuple(word for word in rest if word not in _NEUTRAL | _MEASURED | _COMMANDED),
        unit,
        present or any(word in _MEASURED for word in rest),
        any(word in _COMMANDED for word in rest),
    )
    return _agreeing(found)


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
        if any(word in PARTS_OF_TIME for word in words):
            return "t", words, False
        return None, words, False
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


def _agreeing(found: Meaning) -> Meaning:
    """A torque in ampere is a current; any other unit of another quantity makes it unclear."""
    if found.unit is None or found.role is None or found.unit in units_of(found.role):
        return found
    if found.role == "tau" and found.unit in units_of("i"):
        return replace(found, role="i")
    return replace(found, words=(*found.words, found.unit))
