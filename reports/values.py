"""How numbers, units, names and sentences are written, and series of a run picked."""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from excitant.robots.effects import plain as plain
from excitant.robots.motion import Array

Series = Mapping[str, Array]

NONE = "–"
_BEYOND = 1e200  # no quantity is as large: what is made of it would overflow
FEW = 3  # joints or links that are told by name
SINGULAR = 1e8  # condition number: half of the digits of a normal equation are lost
_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def real(value: object) -> float | None:
    """A finite number, or None; what is beyond all quantities is no number."""
    if isinstance(value, bool) or not isinstance(value, int | float | np.number):
        return None
    return float(value) if -_BEYOND < value < _BEYOND else None


def reals(values: Sequence[float | None]) -> Array:
    """Numbers as an array; nulls become NaN."""
    return np.array(values, dtype=float)


class Missed(NamedTuple):
    """Relative error of a model at the joint that is worst, and the median of several joints."""

    worst: float | None = None
    joint: str = ""
    median: float | None = None


def missed(errors: Mapping[str, float | None]) -> Missed:
    """The worst and the median of the errors that are known, by joint."""
    known = {joint: x for joint, x in errors.items() if x is not None}
    if not known:
        return Missed()
    joint = max(known, key=lambda name: known[name])
    median = float(np.median(list(known.values()))) if len(known) > 1 else None
    return Missed(known[joint], joint, median)


def errors(before: Missed, after: Missed) -> tuple[str, str]:
    """Errors of two models at their worst joints, and in words the joint and the medians."""
    joint = after.joint or before.joint
    median = change(before.median, after.median, percent)
    remark = f"worst joint, {joint}" + f"; median {median}" * (median != NONE)
    return change(before.worst, after.worst, percent), remark


def array(series: Series, key: str, *shape: int | None) -> Array | None:
    """One series of this shape, None for any length; None when absent, other or nowhere finite."""
    values = np.asarray(series.get(key, ""))
    if not np.issubdtype(values.dtype, np.number) or values.ndim != len(shape):
        return None
    if any(n not in (None, m) for n, m in zip(shape, values.shape, strict=True)):
        return None
    return _finite(values.astype(float))


def _finite(values: Array) -> Array | None:
    return values if np.isfinite(values).any() else None


def curve(
    series: Series, key: str, joint: int | None = None, rows: int | None = None
) -> Array | None:
    """One series over so many rows, or its column of a joint; None when other or nowhere finite."""
    if joint is None:
        return array(series, key, rows)
    table = array(series, key, rows, None)
    return (
        None
        if table is None or joint >= table.shape[1]
        else _finite(table[:, joint])
    )


def curves(
    series: Series, joint: int | None, first: str, *keys: str
) -> list[Array | None]:
    """Columns of a joint, if one is named: the first, and of the others those of as many rows."""
    known = curve(series, first, joint)
    rows = -1 if known is None else len(known)
    return [known, *(curve(series, key, joint, rows) for key in keys)]


def times(series: Series) -> Array | None:
    """Time ``t``, shape (n,) [s]; None unless there are two finite instants or more."""
    t = curve(series, "t")
    return t if t is not None and len(t) > 1 and np.isfinite(t).all() else None


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


def number4(value: object) -> str:
    """A number with four significant digits."""
    return number(value, 4)


def condition(value: object) -> str:
    """A condition number, or that of columns which double precision cannot tell apart."""
    x = real(value)
    if x is not None and x > SINGULAR:
        return f"above {number(SINGULAR)}, so that not all parameters are shown"
    return number(x)


def whole(value: object) -> str:
    """A count."""
    x = real(value)
    return NONE if x is None else _positional(x, 0)


def value_and_std(value: object, std: object) -> tuple[str, str]:
    """A value to the decimals of its standard deviation, which has two significant digits."""
    x = real(value)
    s = real(std)
    if x is None or s is None or s <= 0:
        return number(x, 4), number(s, 2)
    decimals = 1 - math.floor(math.log10(s))
    if not (decimals <= 6 and s < 1e5 and abs(x) < 1e6):
        return number(x, 4), number(s, 2)
    return _positional(x, decimals), _positional(s, decimals)


def interval(value: object, std: object) -> str:
    """A value and its standard deviation, likewise."""
    return " ± ".join(value_and_std(value, std))


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
    return number(value, digits) + (
        f"\u00a0{unit}" if real(value) is not None else ""
    )


def unit_of(unit: str, digits: int = 3) -> Callable[[object], str]:
    """Format of quantities of a unit."""
    return lambda value: quantity(value, unit, digits)


def change(before: object, after: object, write: Any = number) -> str:
    """A number before and after, or whichever of both is known."""
    known = [write(x) for x in (before, after) if real(x) is not None]
    return " → ".join(known) or NONE


def listing(names: Sequence[str], none: str = NONE) -> str:
    """Names in one line."""
    return ", ".join(names) if names else none


def few(joints: Sequence[str]) -> str:
    """Joints by name, or how many they are; empty without any."""
    count = len(joints)
    return listing(joints, "") if count <= FEW else f"{count} joints"


def sentence(words: str) -> str:
    """Words as a sentence, with a capital, a full stop and true minus signs.

    A name with an underscore keeps its small letter.
    """
    words = re.sub(
        r"(?<=\d)e([+-]\d+)", lambda e: f"×{power_of_ten(int(e[1]))}", words
    )
    words = re.sub(r"(?<![\w.])-(?=\d)", "−", words)
    capital = "_" not in words.split(" ", 1)[0]
    first = words[:1].upper() if capital else words[:1]
    return words and first + words[1:] + "." * (words[-1] not in ".!?")


def shorten(name: str, length: int) -> str:
    """A name that fits a figure: its middle gives way to an ellipsis."""
    name = " ".join(name.split())
    if len(name) <= length:
        return name
    head = length // 2
    return f"{name[:head]}…{name[len(name) - (length - 1 - head) :]}"
