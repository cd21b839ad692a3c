"""Time of logs in seconds: numbers in any unit, stamps since 1970, ISO text."""

from __future__ import annotations

from decimal import Decimal
from numbers import Real
from typing import Any

import numpy as np
import pandas as pd

from excitant.identify.importers.mapping import Unit
from excitant.identify.importers.units import factor
from excitant.robots.motion import Array

_SECONDS_SINCE_1970 = (0.95e9, 4.2e9)  # the years 2000 to 2103
_SCALES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}


def stamps_unit(values: pd.Series) -> str | None:
    """The unit in which numbers are stamps since 1970; None when they are not.

    The units' ranges for the years 2000 to 2103 do not meet, so that there is no choice.
    """
    if _is_date(values):
        return "ISO 8601"
    if pd.api.types.is_timedelta64_dtype(values):
        return None
    numbers = as_numbers(values)
    numbers = numbers[np.isfinite(numbers)]
    if not len(numbers):
        return "ISO 8601" if _dates(values).notna().any() else None
    middle = float(np.median(numbers))
    low, high = _SECONDS_SINCE_1970
    return next((u for u, s in _SCALES.items() if low <= middle * s <= high), None)


def in_seconds(values: pd.Series, unit: Unit | None) -> tuple[Array, Array]:
    """Whole and remaining seconds of stamps, so that nanoseconds since 1970 keep their digits.

    Args:
        values: Column of time.
        unit: Its unit, ``"ISO 8601"`` for dates, or seconds per logged unit.

    Returns:
        Two arrays, shape (n,) [s], whose sum is the time; NaN where a cell is none.
    """
    if unit == "ISO 8601" or _is_date(values):
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
    if kinds.is_bool_dtype(values) or kinds.is_complex_dtype(values):
        return np.full(len(values), np.nan)
    if _is_date(values) or kinds.is_timedelta64_dtype(values):
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
    for unit, per_second in (("ns", 1_000_000_000), ("us", 1_000_000)):
        try:
            ticks = values.astype(kind.format(unit)).astype("int64").to_numpy()
        except (pd.errors.OutOfBoundsDatetime, pd.errors.OutOfBoundsTimedelta, OverflowError):
            continue
        return ticks, per_second
    return np.zeros(len(values), np.int64), 1


def _split(values: np.ndarray, per_second: int, bad: np.ndarray) -> tuple[Array, Array]:
    whole = (values // per_second).astype(float)
    rest = (values % per_second).astype(float) / per_second
    whole[bad] = np.nan
    return whole, rest


def _is_date(values: pd.Series) -> bool:
    return bool(pd.api.types.is_datetime64_any_dtype(values))


def _dates(values: pd.Series) -> pd.Series:
    if _is_date(values):
        return pd.to_datetime(values, utc=True)
    return pd.to_datetime(values.astype(str), format="ISO8601", errors="coerce", utc=True)
