"""Meaning of columns' names: quantity, joint, unit, measured or commanded.

The vocabulary is a table of words: a new logger, vendor or language is a word in one of its rows,
a unit is a row of `excitant.identify.reading.units`.
"""

import re
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from excitant.identify.reading.units import spelled, units_of


def _by_word(rows: Mapping[str, str]) -> dict[str, str]:
    return {
        word: meaning for meaning, words in rows.items() for word in words.split()
    }


_QUANTITIES = _by_word(
    {
        "t": "t ts time times timestamp timestamps stamp stamps zeit duration",
        "q": "q pos position positions angle angles theta jointpos istposition winkel",
        "dq": "dq qd qdot vel velocity velocities speed speeds dtheta omega jointvel drehzahl "
        "geschwindigkeit",
        "ddq": "ddq qdd qddot acc acceleration accelerations",
        "tau": "tau torque torques effort efforts eff trq moment drehmoment",
        "i": "i current currents cur amperage iq strom",
    }
)
PARTS_OF_TIME = _by_word(
    {"s": "sec secs seconds", "ns": "nanosec nanosecs nsec nsecs nanoseconds"}
)
"""Words of the whole seconds, and of the nanoseconds, of a stamp in two columns."""
_QUALIFIERS = _by_word(
    {
        "measured": "actual act measured meas msr real present ist istwert",
        "fed back": "feedback fb",
        "commanded": "target targets desired des commanded command cmd ref reference setpoint set "
        "goal planned model predicted pred estimated est simulated sim soll sollwert",
        "neutral": "joint joints jnt j a axis axes achse gelenk actuator actuators state states "
        "msg data value values log field header relative rel elapsed unix epoch utc in",
    }
)
_DOTS = {"dot": 1, "ddot": 2}
_DERIVATIVES = ("q", "dq", "ddq")
# that a next word makes a speed
_LENGTHS_AND_ANGLES = (
    "rad",
    "deg",
    "rev",
    "m",
    "mm",
)
_BRACKETS = re.compile(r"[\[({]([^\])}]*)[\])}]")
_SEPARATORS = re.compile(r"[\W_]+(?<!°)")
_EXACT = re.compile(r"(q|dq|ddq|tau|i)(\d+)", re.ASCII)
# of camel case
_WORDS = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z°µ]+|\d+|[^\W\d_]+")


@dataclass(frozen=True)
class Meaning:
    """Meaning of a column's name.

    Attributes:
        column: The name.
        role: Quantity: t, q, dq, ddq, tau or i.
        joint: Name of the joint where the column holds it, else its number.
        term: The word that names the quantity.
        words: Words that may change the meaning.
        unit: Unit, as `excitant.identify.reading.units` names it.
        measured: Whether a word says so.
        fed_back: Whether that word may also name a term of a controller.
        commanded: Whether a word says that it is commanded or computed.
    """

    column: str
    role: str | None = None
    joint: str | int | None = None
    term: str = ""
    words: tuple[str, ...] = ()
    unit: str | None = None
    measured: bool = False
    fed_back: bool = False
    commanded: bool = False


def meaning(column: str, joints: Sequence[str] = ()) -> Meaning:
    """Meaning of a column's name, given the names of the arm's joints."""
    if exact := _EXACT.fullmatch(column):
        return Meaning(column, exact[1], int(exact[2]), exact[1])
    words, unit = _split(column)
    joint: str | int | None
    joint, others = _joint_named_in(words, joints)
    # of a joint that slides; a number may count the axes of a sensor at the tool
    others = ["torque" if word == "force" else word for word in others]
    if joint is not None and _quantity(others)[0] is not None:
        words = others
    else:
        numbers = [k for k, word in enumerate(words) if word.isdecimal()]
        joint = int(words.pop(numbers[-1])) if numbers else None
    role, others, present = _quantity(words)
    term = next((word for word in words if word not in others), "")
    qualifiers = {_QUALIFIERS.get(word) for word in others}
    implied = ("motor",) if role == "i" else ()  # every current is a motor's
    odd = [w for w in others if w not in _QUALIFIERS and w not in implied]
    if unit is not None and role is not None and unit not in units_of(role):
        if role == "tau" and unit in units_of("i"):
            role = "i"
        else:
            odd.append(unit)
    fed_back = "fed back" in qualifiers
    measured = present or fed_back or "measured" in qualifiers
    commanded = "commanded" in qualifiers
    return Meaning(
        column, role, joint, term, tuple(odd), unit, measured, fed_back, commanded
    )


def _split(column: str) -> tuple[list[str], str | None]:
    """Words of a name in lower case, and the unit that it holds."""
    unit: str | None = None

    def opened(match: re.Match[str]) -> str:
        nonlocal unit
        inside = match[1].strip()
        bracketed = None if inside.isdecimal() else spelled(inside)
        unit = unit or bracketed
        return " " if bracketed else f" {inside} "

    plain = _BRACKETS.sub(opened, unicodedata.normalize("NFKC", column))
    chunks = [chunk for chunk in _SEPARATORS.split(plain) if chunk]
    words: list[str] = []
    for chunk in chunks:
        telling = len(chunk) > 1 or (chunk in ("A", "N") and len(chunks) > 1)
        here = spelled(chunk) if telling else None
        if unit in _LENGTHS_AND_ANGLES and "s" in (chunk, here):
            unit = f"{unit}/s"
        elif here is not None and chunk.lower() not in PARTS_OF_TIME:
            unit = unit or here
        elif chunk == "s" and words:
            unit = unit or "s"
        else:
            words += [word.lower() for word in _WORDS.findall(chunk)]
    words = " ".join(words).replace("nano sec", "nanosec").split()
    last = words[-1] if len(words) > 1 else ""
    if (
        unit is None
        and len(last) > 1
        and last not in {*_QUANTITIES, *PARTS_OF_TIME}
    ):
        unit = spelled(last)
        words = words[:-1] if unit else words
    return words, unit


def _joint_named_in(
    words: list[str], joints: Sequence[str]
) -> tuple[str | None, list[str]]:
    """The joint whose name stands in a column's, longest first, and the other words.

    Neutral words of a joint's name may be missing where what is left tells it from the others.
    """
    forms = [(joint, _split(joint)[0]) for joint in joints]
    short = [
        [w for w in form if _QUALIFIERS.get(w) != "neutral"] for _, form in forms
    ]
    for joint, form in zip(joints, short, strict=True):
        telling = any(len(word) > 1 and not word.isdecimal() for word in form)
        if telling and short.count(form) == 1:
            forms.append((joint, form))
    for joint, form in sorted(forms, key=lambda named: -len(named[1])):
        for k in range(len(words) - len(form) + 1) if form else ():
            end = k + len(form)
            if words[k:end] == form:
                return joint, words[:k] + words[end:]
    return None, words


def _quantity(words: list[str]) -> tuple[str | None, list[str], bool]:
    """The quantity, the other words, and whether "current" meant "present"."""
    at = [k for k, word in enumerate(words) if word in _QUANTITIES]
    if not at:
        timed = any(word in PARTS_OF_TIME for word in words)
        return "t" if timed else None, words, False
    present = len(at) == 2 and words[at[0]] == "current"
    telling = at[-1] if present else at[0]
    quantity = _QUANTITIES[words[telling]]
    others = [word for k, word in enumerate(words) if k != telling]
    if present:
        others = [word for word in others if word != "current"]
    if quantity == "t":
        others = [word for word in others if _QUANTITIES.get(word) != "t"]
    order = sum(_DOTS.get(word, 0) for word in others)
    if quantity == "q" and order:
        others = [word for word in others if word not in _DOTS]
        quantity = _DERIVATIVES[min(order, 2)]
    return quantity, others, present
