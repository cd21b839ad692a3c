"""Units of logged columns, and how many SI units one of them is."""

from __future__ import annotations

import math
import unicodedata
from collections.abc import Mapping

_TURN = 2 * math.pi

ANGULAR: Mapping[str, Mapping[str, float]] = {
    "q": {"rad": 1.0, "mrad": 1e-3, "deg": _TURN / 360, "rev": _TURN},
    "dq": {"rad/s": 1.0, "mrad/s": 1e-3, "deg/s": _TURN / 360, "rpm": _TURN / 60, "rev/s": _TURN},
    "tau": {"Nm": 1.0, "mNm": 1e-3, "kNm": 1e3, "Ncm": 1e-2, "kgfm": 9.80665, "kgfcm": 0.0980665},
}
LINEAR: Mapping[str, Mapping[str, float]] = {
    "q": {"m": 1.0, "mm": 1e-3, "cm": 1e-2},
    "dq": {"m/s": 1.0, "mm/s": 1e-3, "cm/s": 1e-2},
    "tau": {"N": 1.0, "kN": 1e3},
}
COMMON: Mapping[str, Mapping[str, float]] = {
    "t": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0},
    "i": {"A": 1.0, "mA": 1e-3},
}
_SPELLINGS = {
    **dict.fromkeys(("sec", "secs", "second", "seconds"), "s"),
    **dict.fromkeys(("msec", "msecs", "millisecond", "milliseconds", "millis"), "ms"),
    **dict.fromkeys(("µs", "μs", "usec", "usecs", "microsecond", "microseconds", "micros"), "us"),
    **dict.fromkeys(("nsec", "nsecs", "nanosec", "nanosecs", "nanosecond", "nanoseconds"), "ns"),
    **dict.fromkeys(("°", "degs", "degree", "degrees"), "deg"),
    **dict.fromkeys(("rads", "radian", "radians"), "rad"),
    **dict.fromkeys(("turn", "turns", "revs"), "rev"),
    **dict.fromkeys(("°/s", "degps", "dps", "degrees/s", "deg/sec"), "deg/s"),
    **dict.fromkeys(("radps", "radians/s", "rad/sec", "rads/s"), "rad/s"),
    **dict.fromkeys(("rps", "turn/s"), "rev/s"),
    **dict.fromkeys(("r/min", "rev/min", "1/min"), "rpm"),
    **dict.fromkeys(("nm", "NM", "newtonmeter", "newtonmeters"), "Nm"),
    **dict.fromkeys(("mnm",), "mNm"),
    **dict.fromkeys(("ma", "milliamps", "milliampere"), "mA"),
    **dict.fromkeys(("amp", "amps", "ampere", "amperes"), "A"),
}
_KNOWN = {unit for table in (ANGULAR, LINEAR, COMMON) for row in table.values() for unit in row}


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


def factor(role: str, unit: str, revolute: bool | None = None) -> float | None:
    """How many SI units one ``unit`` of a quantity is; None when it has no such unit.

    Args:
        role: ``t``, ``q``, ``dq``, ``tau`` or ``i``.
        unit: As `spelled` gives it.
        revolute: Whether the joint turns; either kind of unit when None.
    """
    if role in COMMON:
        return COMMON[role].get(unit)
    tables = {True: (ANGULAR,), False: (LINEAR,), None: (ANGULAR, LINEAR)}[revolute]
    return next((table[role][unit] for table in tables if unit in table[role]), None)


def units_of(role: str) -> tuple[str, ...]:
    """All units that a quantity may be logged in."""
    if role in COMMON:
        return tuple(COMMON[role])
    return (*ANGULAR[role], *LINEAR[role])


def roles_of(unit: str) -> frozenset[str]:
    """The quantities that may be logged in a unit."""
    return frozenset(role for role in ("t", "q", "dq", "tau", "i") if unit in units_of(role))
