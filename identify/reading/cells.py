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
from excitant.identify.signals import samples_motion
from excitant.robots.motion import Array, quotient

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
    if series.hasnans:
        return series.to_numpy(float, na_value=np.nan)
    return series.to_numpy(np.dtype(f"{kind}8"))


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
    return pd.to_numeric(values, errors="coerce").to_numpy(float, na_value=np.nan)


def stamps_unit(
    values: Cells, possible: Callable[[float], bool]
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
        low, high = _SECONDS_SINCE_1970
    middle = np.median(numbers)
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
    if dated or values.dtype.kind == "m":
        import pandas as pd

        times = _dates(values) if dated else pd.Series(values)
        kind: Any = "datetime64[{}, UTC]" if dated else "timedelta64[{}]"
        try:
            stamps = times.astype(kind.format("ns"))
            per_second = 1_000_000_000
        except (ValueError, OverflowError):  # out of bounds
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


def regular_clock(t: Array, q: Array, column: str) -> tuple[Array, tuple[str, ...]]:
    """Time of rows that were sampled regularly, though their stamps jitter, and a note of it.

    Stamps stay, and nothing is said, unless

    - half the steps are off by more than a twentieth of the period, and their sum does not wander
      off a straight line: their deviations from it are in any order;
    - positions do not change by what the stamps say. Of a step Δt, that is slower or faster by
      β v (Δt − T) than its neighbours let expect, v the speed and T the period; β is 1 where stamps
      are those of the samples, 0 where samples are regular.

    Args:
        t: Stamps, shape (n,) [s].
        q: Positions, shape (n, nv).
        column: That of the stamps.
    """
    finite = np.isfinite(t).all() and np.isfinite(q).all()
    if len(t) < 50 or not finite or not samples_motion(q):
        return t, ()
    half = len(t) // 2
    period = np.median(t[half:] - t[:-half]) / half
    regular = period * np.arange(len(t), dtype=float)
    deviation = t - regular
    jitter = np.median(np.abs(np.diff(t) - period))
    if jitter <= 0.05 * period or period <= 0 or samples_motion(deviation[:, None]):
        return t, ()
    expected, change = _beside(np.diff(q, axis=0))
    _, more = _beside(np.diff(t) / period)
    by_stamps = expected * more[:, None]
    weight = quotient(1.0, change.var(axis=0))
    power = by_stamps**2 @ weight
    shown = (by_stamps * change) @ weight
    total = max(float(power.sum()), 1e-300)
    beta = shown.sum() / total
    most = abs(beta) + 3 * np.linalg.norm(shown - beta * power) / total
    if not power.any() or most > 0.5:
        return t, ()
    note = (
        f"time: {column} holds stamps that jitter by {100 * deviation.std() / period:.2g} % of "
        f"their step of {period:.4g} s, of which positions follow at most {100 * most:.2g} %: "
        "rows are regular, and the time is the straight line through the stamps"
    )
    return regular, (note,)


def _beside(x: Array) -> tuple[Array, Array]:
    """Mean of the two values on either side along the first axis, and what each has more."""
    mean = (x[:-4] + x[1:-3] + x[3:-1] + x[4:]) / 4
    return mean, x[2:-2] - mean


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
