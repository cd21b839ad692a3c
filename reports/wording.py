"""How numbers and names are written in reports."""

from __future__ import annotations

import math
import re

from excitant.reports.reading import Result, real, records, text
from excitant.robots.effects import plain as plain

NONE = "–"
_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def _positional(value: float, decimals: int) -> str:
    written = f"{value:.{max(decimals, 0)}f}"
    return written.replace("-", "−") if float(written) else written.lstrip("-")


def power_of_ten(exponent: int) -> str:
    """A power of ten with a raised exponent, e.g. ``10⁻³``."""
    return "10" + str(exponent).translate(_SUPERSCRIPT)


def number(value: object, digits: int = 3) -> str:
    """A number with that many significant digits, a dash for none."""
    x = real(value)
    if x is None:
        return NONE
    if x == 0:
        return "0"
    exponent = int(f"{x:.{digits - 1}e}".split("e")[1])
    if -4 <= exponent < 6:
        return _positional(x, digits - 1 - exponent)
    return f"{_positional(x / 10.0**exponent, digits - 1)}×{power_of_ten(exponent)}"


def value_and_std(value: object, std: object) -> tuple[str, str]:
    """A value to the decimals of its standard deviation, which has two significant digits."""
    x, s = real(value), real(std)
    if x is None or s is None or s <= 0:
        return number(x, 4), number(s, 2)
    decimals = 1 - math.floor(math.log10(s))
    if not (decimals <= 6 and s < 1e5 and abs(x) < 1e6):
        return number(x, 4), number(s, 2)
    return _positional(x, decimals), _positional(s, decimals)


def percent(value: object, digits: int = 2) -> str:
    """A share as a percentage."""
    x = real(value)
    if x is None:
        return NONE
    share = 100 * x
    if abs(share) >= 1000:
        return ">\u00a0999\u00a0%" if share > 0 else "<\u00a0−999\u00a0%"
    if abs(share) >= 10**digits:
        return f"{_positional(share, 0)}\u00a0%"
    return f"{number(share, digits)}\u00a0%"


def quantity(value: object, unit: str, digits: int = 3) -> str:
    """A number with its unit."""
    return number(value, digits) if real(value) is None else f"{number(value, digits)}\u00a0{unit}"


def combination(direction: Result) -> str:
    """A direction in parameter space as text, e.g. ``0.81·link1.Izz − 0.52·joint2.Fv + …``.

    Args:
        direction: ``members`` with ``name`` and ``coefficient``, and their ``share`` of it.
    """
    written = ""
    for member in records(direction, "members"):
        size = real(member, "coefficient") or 0.0
        sign = (" − " if size < 0 else " + ") if written else ("−" if size < 0 else "")
        written += f"{sign}{abs(size):.2f}·{text(member, 'name')}"
    return written + (" + …" if (real(direction, "share") or 0.0) < 0.99 else "")


def listing(names: list[str], none: str = NONE) -> str:
    """Names in one line."""
    return ", ".join(names) if names else none


def sentence(words: str) -> str:
    """Words as a sentence, with a capital, a full stop and true minus signs.

    A name with an underscore keeps its small letter.
    """
    words = re.sub(r"(?<=\d)e([+-]\d+)", lambda e: f"×{power_of_ten(int(e[1]))}", words)
    words = re.sub(r"(?<![\w.])-(?=\d)", "−", words)
    capital = "_" not in words.split(" ", 1)[0]
    first = words[:1].upper() if capital else words[:1]
    return words and first + words[1:] + "." * (words[-1] not in ".!?")


def shorten(name: str, length: int) -> str:
    """A name that fits a figure: its middle gives way to an ellipsis."""
    name = " ".join(name.split())
    if len(name) <= length:
        return name
    head = (length - 1 + 1) // 2
    return f"{name[:head]}…{name[len(name) - (length - 1 - head) :]}"
