"""Cells of a log by column: numbers, dates and text, read as numbers and as time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from decimal import Decimal
from numbers import Real
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import numpy.typing as npt

from excitant.identify.reading.units import ISO, Unit, factor
from excitant.robots.motion import Array

if TYPE_CHECKING:
    import pandas as pd

Cells: TypeAlias = "npt.NDArray[Any] | pd.Series"
"""Cells of a column: an array of numbers, or a series of anything else."""
Frame: TypeAlias = Mapping[str, Cells]
"""Some rows of a log by column."""

_ORDERS = ("%d.%m.%Y %H:%M:%S.%f", "%m/%d/%Y %H:%M:%S.%f", "%d/%m/%Y %H:%M:%S.%f")
_SECONDS_SINCE_1970 = (0.95e9, 4.2e9)  # the years 2000 to 2103
_SCALES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_FAR_APART = 0.5  # s: no motion of an arm shows in samples so rare


def keys_of(names: Sequence[str]) -> list[str]:
    """What columns are found under: their names, or numbers from 0 where a name is there twice."""
    times = Counter(names)
    return [name if times[name] == 1 else str(k) for k, name in enumerate(names)]


def cells(series: pd.Series) -> Cells:
    """Cells of a series: an array where they are numbers, whole ones where none is missing."""
    kind = series.dtype.kind
    if kind not in "iuf":
        return series
    if isinstance(series.dtype, np.dtype):
        return series.to_numpy()
    whole = np.dtype(f"{kind}8")
    if series.hasnans:
        return series.to_numpy(float, na_value=np.nan)
    return series.to_numpy(whole)


def as_numbers(values: Cells) -> Array:
    """Numbers of a column; NaN for text, dates, truth values and where there is nothing.

    What single precision cannot hold, no sensor gives: a number beyond it is infinite, below it 0.
    """
    if values.dtype.kind in "bcmM":
        return np.full(len(values), np.nan)
    numbers = _as_floats(values)
    with np.errstate(all="ignore"):
        single = numbers.astype(np.float32)
    return np.where(np.isfinite(single) & (single != 0), numbers, single)


def _as_floats(values: Cells) -> Array:
    if isinstance(values, np.ndarray):
        return np.asarray(values, float)
    import pandas as pd

    if not isinstance(values.dtype, pd.StringDtype):
        real = (str, Real, Decimal)
        plain = [
            isinstance(v, real) and not isinstance(v, bool | np.bool_)
            for v in values
        ]
        values = values.astype(object).where(np.array(plain, bool), None)
    numbers = pd.to_numeric(values, errors="coerce")
    return numbers.to_numpy(float, na_value=np.nan)


def stamps_unit(
    values: Cells, possible: Callable[[float], bool] = lambda step: True
) -> tuple[str | None, str]:
    """The unit of time that numbers show, None where it is seconds, and what they are.

    Stamps of the years 2000 to 2103 are in the one unit in which they lie there. Other numbers are
    in the largest in which two samples are less than half a second apart, if the arm can move so
    far in such a step [s] (``possible``); every step exactly 1 may count samples, and stays.
    """
    if _is_date(values):
        return ISO, "dates"
    if values.dtype.kind == "m":
        return None, ""
    numbers = as_numbers(values)
    numbers = numbers[np.isfinite(numbers)]
    if not len(numbers):
        return (ISO, "dates") if _dates(values).notna().any() else (None, "")
    with np.errstate(over="ignore"):
        steps = np.diff(numbers)
        (low, high) = _SECONDS_SINCE_1970
    middle = float(np.median(numbers))
    forward = steps[(steps > 0) & (steps != 1)]
    step = float(np.median(forward)) if 2 * len(forward) > len(steps) else 0.0
    short = {unit: s for unit, s in _SCALES.items() if step * s < _FAR_APART}
    since = [unit for unit, s in short.items() if low <= middle * s <= high]
    unit = next(iter(since or short), "s")
    if unit == "s" or not (since or possible(step * _SCALES[unit])):
        return None, ""
    if since:
        return unit, f"stamps since 1970 [{unit}]"
    return unit, f"[{unit}], for as seconds its samples would be {step:.4g} s apart"


def in_seconds(values: Cells, unit: Unit | None) -> tuple[Array, Array]:
    """Whole and remaining seconds of stamps, so that nanoseconds since 1970 keep their digits.

    ``unit`` is `ISO` for dates, or seconds per logged unit; cells that are no time become NaN.
    """
    dated = unit == ISO or _is_date(values)
    lasting = values.dtype.kind == "m"
    if dated or lasting:
        import pandas as pd

        times = _dates(values) if dated else pd.Series(values)
        kind: Any = "datetime64[{}, UTC]" if dated else "timedelta64[{}]"
        try:
            stamps = times.astype(kind.format("ns"))
            per_second = 1_000_000_000
        except (
            pd.errors.OutOfBoundsDatetime,
            pd.errors.OutOfBoundsTimedelta,
            OverflowError,
        ):
            stamps = times.astype(kind.format("us"))
            per_second = 1_000_000
        ticks: Any = stamps.astype("int64").to_numpy()
        bad = times.isna().to_numpy()
    else:
        scale = (factor("t", unit) or 1.0) if isinstance(unit, str) else unit or 1.0
        if values.dtype.kind not in "iu" or scale not in (1e-3, 1e-6, 1e-9):
            with np.errstate(over="ignore", invalid="ignore"):
                return as_numbers(values) * scale, np.zeros(len(values))
        ticks = values
        per_second = round(1 / scale)
        bad = np.zeros(len(values), bool)
    seconds = np.where(bad, np.nan, ticks // per_second)
    return seconds, (ticks % per_second).astype(float) / per_second


def _is_date(values: Cells) -> bool:
    return values.dtype.kind == "M"


def _dates(values: Cells) -> pd.Series:
    """Instants of dates, written in the order of ISO 8601 or with the day or month first.

    Times of day alone are those of one day.
    """
    import pandas as pd

    if _is_date(values):
        return pd.to_datetime(pd.Series(values), utc=True)
    text = pd.Series(values).astype(str).str.replace(",", ".", regex=False)
    iso = pd.to_datetime(text, format="ISO8601", errors="coerce", utc=True)
    if iso.notna().any():
        return iso
    for order in _ORDERS:
        dates = pd.to_datetime(text, format=order, errors="coerce", utc=True)
        if dates.notna().all():
            return dates
    return pd.to_timedelta(text, errors="coerce") + pd.Timestamp(0, tz="UTC")
