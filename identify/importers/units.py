"""Units of logged columns in SI units, and time in seconds, also stamps since 1970 and dates."""

from __future__ import annotations

import math
import unicodedata
from collections.abc import Mapping
from decimal import Decimal
from numbers import Real
from typing import Any

import numpy as np
import pandas as pd

from excitant.robots.motion import Array

Unit = str | float
"""The name of a unit, or how many SI units one logged unit is."""
ISO = "ISO 8601"

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
_SECONDS_SINCE_1970 = (0.95e9, 4.2e9)  # the years 2000 to 2103


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
    return tuple(COMMON.get(role, ())) + tuple(ANGULAR.get(role, ())) + tuple(LINEAR.get(role, ()))


def stamps_unit(values: pd.Series) -> str | None:
    """The unit in which numbers are stamps since 1970; None when they are not.

    The units' ranges for the years 2000 to 2103 do not meet, so that there is no choice.
    """
    if _is_date(values):
        return ISO
    if pd.api.types.is_timedelta64_dtype(values):
        return None
    numbers = as_numbers(values)
    numbers = numbers[np.isfinite(numbers)]
    if not len(numbers):
        return ISO if _dates(values).notna().any() else None
    middle = float(np.median(numbers))
    low, high = _SECONDS_SINCE_1970
    scales = {unit: COMMON["t"][unit] for unit in ("s", "ms", "us", "ns")}
    return next((unit for unit, s in scales.items() if low <= middle * s <= high), None)


def in_seconds(values: pd.Series, unit: Unit | None) -> tuple[Array, Array]:
    """Whole and remaining seconds of stamps, so that nanoseconds since 1970 keep their digits.

    Args:
        values: Column of time.
        unit: Its unit, ``"ISO 8601"`` for dates, or seconds per logged unit.

    Returns:
        Two arrays, shape (n,) [s], whose sum is the time; NaN where a cell is none.
    """
    if unit == ISO or _is_date(values):
        dates = _dates(values)
        return _split(*_ticks(dates, "datetime64[{}, UTC]"), dates.isna().to_numpy())
    if pd.api.types.is_timedelta64_dtype(values):
        return _split(*_ticks(values, "timedelta64[{}]"), values.isna().to_numpy())
    scale = (factor("t", unit) or 1.0) if isinstance(unit, str) else unit or 1.0
    whole = pd.api.types.is_integer_dtype(values) and not values.isna().any()
    if whole and scale in (1e-3, 1e-6, 1e-9):
        return _split(values.to_numpy(), round(1 / scale), np.zeros(len(values), bool))
    numbers = as_numbers(values)
    with np.errstate(over="ignore", invalid="ignore"):
        return numbers * scale, np.zeros(len(numbers))


def as_numbers(values: pd.Series) -> Array:
    """Numbers of a column; NaN for text, dates, truth values and where there is nothing."""
    kinds = pd.api.types
    others = (kinds.is_bool_dtype, kinds.is_complex_dtype, kinds.is_timedelta64_dtype, _is_date)
    if any(is_other(values) for is_other in others):
        return np.full(len(values), np.nan)
    if not kinds.is_numeric_dtype(values) and not isinstance(values.dtype, pd.StringDtype):
        plain = values.astype(object).map(lambda v: v if _is_plain(v) else None)
        values = plain.astype(object)
    numbers = pd.to_numeric(values, errors="coerce")
    return np.asarray(numbers.to_numpy(float, na_value=np.nan))


def _is_plain(value: object) -> bool:
    """Whether a cell is text or a real number, and no truth value."""
    return isinstance(value, str | Real | Decimal) and not isinstance(value, bool | np.bool_)


def _ticks(values: Any, kind: str) -> tuple[np.ndarray, int]:
    """Whole ticks of dates and how many make a second; nanoseconds where their range allows."""
    try:
        return values.astype(kind.format("ns")).astype("int64").to_numpy(), 1_000_000_000
    except (pd.errors.OutOfBoundsDatetime, pd.errors.OutOfBoundsTimedelta, OverflowError):
        return values.astype(kind.format("us")).astype("int64").to_numpy(), 1_000_000


def _split(values: np.ndarray, per_second: int, bad: np.ndarray) -> tuple[Array, Array]:
    whole = (values // per_second).astype(float)
    whole[bad] = np.nan
    return whole, (values % per_second).astype(float) / per_second


def _is_date(values: pd.Series) -> bool:
    return bool(pd.api.types.is_datetime64_any_dtype(values))


def _dates(values: pd.Series) -> pd.Series:
    if _is_date(values):
        return pd.to_datetime(values, utc=True)
    return pd.to_datetime(values.astype(str), format="ISO8601", errors="coerce", utc=True)
