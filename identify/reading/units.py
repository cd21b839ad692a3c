"""Units of logged quantities, as a table: a new unit or spelling is one row, or a word in it."""

import math
import unicodedata
from typing import NamedTuple, TypeAlias

Unit: TypeAlias = str | float
"""The name of a unit, or how many SI units one logged unit is."""

ISO = "ISO 8601"
"""The unit of time of dates."""
_TURN = 2 * math.pi
_REVOLUTE = True
_PRISMATIC = False


class _Row(NamedTuple):
    quantity: str  # t, q, dq, tau or i
    unit: str
    size: float  # SI units
    spellings: str = ""  # other spellings than the unit itself
    revolute: bool | None = None  # joints whose quantity it is; None for any joint


_UNITS = (
    _Row("t", "s", 1.0, "sec secs second seconds"),
    _Row("t", "ms", 1e-3, "msec msecs millisecond milliseconds millis"),
    _Row("t", "us", 1e-6, "µs μs usec usecs microsecond microseconds micros"),
    _Row("t", "ns", 1e-9, "nsec nsecs nanosec nanosecs nanosecond nanoseconds"),
    _Row("t", "min", 60.0),
    _Row("t", "h", 3600.0),
    _Row("q", "rad", 1.0, "rads radian radians", _REVOLUTE),
    _Row("q", "mrad", 1e-3, "", _REVOLUTE),
    _Row("q", "deg", _TURN / 360, "° degs degree degrees", _REVOLUTE),
    _Row("q", "rev", _TURN, "turn turns revs", _REVOLUTE),
    _Row("q", "m", 1.0, "", _PRISMATIC),
    _Row("q", "mm", 1e-3, "", _PRISMATIC),
    _Row("q", "cm", 1e-2, "", _PRISMATIC),
    _Row("dq", "rad/s", 1.0, "radps radians/s rad/sec rads/s", _REVOLUTE),
    _Row("dq", "mrad/s", 1e-3, "", _REVOLUTE),
    _Row("dq", "deg/s", _TURN / 360, "°/s degps dps degrees/s deg/sec", _REVOLUTE),
    _Row("dq", "rpm", _TURN / 60, "r/min rev/min 1/min", _REVOLUTE),
    _Row("dq", "rev/s", _TURN, "rps turn/s", _REVOLUTE),
    _Row("dq", "m/s", 1.0, "", _PRISMATIC),
    _Row("dq", "mm/s", 1e-3, "", _PRISMATIC),
    _Row("dq", "cm/s", 1e-2, "", _PRISMATIC),
    _Row("tau", "Nm", 1.0, "nm NM newtonmeter newtonmeters", _REVOLUTE),
    _Row("tau", "mNm", 1e-3, "mnm", _REVOLUTE),
    _Row("tau", "kNm", 1e3, "", _REVOLUTE),
    _Row("tau", "Ncm", 1e-2, "", _REVOLUTE),
    _Row("tau", "kgf·m", 9.80665, "kgfm", _REVOLUTE),
    _Row("tau", "kgf·cm", 0.0980665, "kgfcm", _REVOLUTE),
    _Row("tau", "lbf·in", 0.1129848, "lbfin lbin inlb inlbf", _REVOLUTE),
    _Row("tau", "lbf·ft", 1.355818, "lbfft lbft ftlb ftlbf", _REVOLUTE),
    _Row("tau", "N", 1.0, "", _PRISMATIC),
    _Row("tau", "kN", 1e3, "", _PRISMATIC),
    _Row("i", "A", 1.0, "amp amps ampere amperes"),
    _Row("i", "mA", 1e-3, "ma milliamps milliampere"),
)
_SPELLED = {row.unit: row.unit for row in _UNITS}
_SPELLED |= {word: row.unit for row in _UNITS for word in row.spellings.split()}


def spelled(text: str) -> str | None:
    """The unit that a text means, as the table names it; None when it means none."""
    plain = unicodedata.normalize("NFKC", text).strip()
    for sign in "·⋅*.- ":
        plain = plain.replace(sign, "")
    plain = plain.replace("persec", "/s").replace("per", "/")
    lower = plain if plain.startswith("M") else plain.lower()  # M is not m, milli
    return _SPELLED.get(plain) or _SPELLED.get(lower)


def units_of(quantity: str) -> tuple[str, ...]:
    """All units that a quantity (``t``, ``q``, ``dq``, ``tau``, ``i``) may be logged in."""
    return tuple(row.unit for row in _UNITS if row.quantity == quantity)


def sizes_of(quantity: str) -> dict[str, float]:
    """SI units per unit of a quantity of joints that turn, for all that it may be logged in."""
    return {
        row.unit: row.size
        for row in _UNITS
        if row.quantity == quantity and row.revolute is not _PRISMATIC
    }


def factor(quantity: str, unit: str, revolute: bool | None = None) -> float | None:
    """SI units per unit of a quantity; None when it, or a joint of this kind, has none such."""
    for row in _UNITS:
        fits = revolute is None or row.revolute in (None, revolute)
        if (row.quantity, row.unit) == (quantity, unit) and fits:
            return row.size
    return None


def rounded(value: Unit) -> Unit:
    """A number as it is written into a map, whole ones as such; names as they are."""
    if isinstance(value, str):
        return value
    number = float(f"{value:.7g}")
    return int(number) if number.is_integer() else number


def named(quantity: str, size: float, revolute: bool | None = None) -> Unit:
    """The unit of a quantity that is so many SI units, or that number where it has no name."""
    for row in _UNITS:
        fits = revolute is None or row.revolute in (None, revolute)
        if row.quantity == quantity and fits and math.isclose(size, row.size):
            return row.unit
    return rounded(size)
