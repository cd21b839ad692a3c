"""Velocity against position: rate, units and signs that show without any model.

Over windows, ∫ q̇ dt must be Δq. The slope b of one against the other is 1; it is −1 where a sign is
flipped, 180/π or 30/π where the velocity is in degrees or revolutions per minute, and c for all
joints at once where the time runs c times too fast.
"""

from __future__ import annotations

import numpy as np

from excitant.identify.faults.fault import Fault, Log, Remedy, normal_bound
from excitant.robots.motion import Array

_WINDOW_S = 0.2  # of a window, at least `_WINDOW_ROWS` rows
_WINDOW_ROWS = 8
_MOVING_WINDOWS = 8  # in which a joint must move before its slope counts
_MARGIN = 0.05  # of a slope: less changes inertial torque by less than a tenth
_UNIT_MARGIN = 0.03  # of a slope that a unit explains
_UNITS = {
    180 / np.pi: ("dq", ": dq is in degrees per second"),
    30 / np.pi: ("dq", ": dq is in revolutions per minute"),
    1 / (2 * np.pi): ("dq", ": dq is in revolutions per second"),
    np.pi / 180: ("q", ", as with q in degrees and dq in rad/s"),
    2 * np.pi: ("q", ", as with q in turns and dq in rad/s"),
}
"""Slopes of ∫q̇ dt against Δq that a unit explains, the channel in that unit, and words."""
RATES = (0.5, 2.0, 0.25, 4.0, 1e-3, 1e3, 1e-6, 1e6, 1e-9, 1e9)
"""Factors by which a clock may be off for a reason."""


def velocity_faults(log: Log) -> list[Fault]:
    """Faults that show in the velocity against the position."""
    b, error, follows = _slopes(log)
    tolerance = np.maximum(_MARGIN, normal_bound(log.nv) * error)
    wrong = [j for j in follows if abs(b[j] - 1) > tolerance[j]]
    shared = _shared_slope(b[follows]) if wrong == follows else None
    of_clock = shared is not None and shared > 0
    if len(log) > 3 and (np.diff(log.t) == 1.0).all():
        first, last = log.t[[0, -1]]
        detail = (
            f"every time step is exactly 1, so t counts samples ({first:g} to {last:g})"
        )
        if shared is None or not of_clock:
            return [Fault("wrong_sample_rate", log.joints, detail, {"step": 1.0})]
        detail += f"; q and dq agree at a step of {1 / shared:.4g} s ({shared:.4g} Hz)"
        return [slow_clock(log, shared, detail, step=1.0)]
    if wrong and (change := _rate_change(log)) is not None:
        return [change]
    if shared is None or not of_clock or _unit_slope(shared) is not None:
        return [_joint_fault(log, j, float(b[j]), float(error[j])) for j in wrong]
    near = [rate for rate in RATES if abs(shared / rate - 1) < _UNIT_MARGIN]
    factor = near[0] if near else shared
    detail = (
        f"the time runs {shared:.4g} times too {'slow' if shared > 1 else 'fast'} for the motion: "
        f"∫dq dt is {shared:.4g} ± {np.nanmedian(error):.2g} times the change of q at all "
        f"{len(follows)} moving joints; the median step is {log.step:.4g} s, "
        f"{log.step / factor:.4g} s would fit"
    )
    return [slow_clock(log, factor, detail, factor=shared, slopes=b, errors=error)]


def _shared_slope(slopes: Array) -> float | None:
    """The slope that all moving joints share, when more than one moves."""
    if len(slopes) < 2:
        return None
    shared = float(np.median(slopes))
    return shared if (np.abs(slopes / shared - 1) < _MARGIN).all() else None


def _windows(log: Log, dq: Array) -> tuple[int, Array, Array]:
    """Rows of a window, Δq and ∫q̇ dt over windows, each of shape (windows, nv)."""
    rows = min(max(_WINDOW_ROWS, round(_WINDOW_S / log.step)), len(log) // 20)
    steps = np.diff(log.t)[:, None] * (dq[1:] + dq[:-1]) / 2
    way = np.concatenate([np.zeros((1, dq.shape[1])), steps.cumsum(axis=0)])
    return rows, np.diff(log.q[::rows], axis=0), np.diff(way[::rows], axis=0)


def _slopes(log: Log) -> tuple[Array, Array, list[int]]:
    """Slopes of ∫q̇ dt on Δq (NaN without motion), their standard errors, joints in proportion."""
    b, error = np.full((2, log.nv), np.nan)
    follows: list[int] = []
    if log.dq is None or len(log) < 5 * _WINDOW_ROWS:
        return b, error, follows
    _, changes, ways = _windows(log, log.dq)
    for j, (x, y) in enumerate(zip(changes.T, ways.T, strict=True)):
        clear = np.abs(x) > 20 * log.grain[j]
        if clear.sum() < _MOVING_WINDOWS or np.ptp(y) == 0:
            continue
        b[j] = x @ y / (x @ x)
        error[j] = np.sqrt(((y - b[j] * x) ** 2 * x**2).sum()) / (x @ x)
        correlation = abs(x @ y) / np.sqrt((x @ x) * (y @ y))
        if correlation > 0.9:  # one channel is the other's integral
            follows.append(j)
    return b, error, follows


def _rate_change(log: Log) -> Fault | None:
    """A rate that changes once, all joints alike, while the stamps run on as before."""
    rows, x, y = _windows(log, np.asarray(log.dq))
    unit = np.maximum(np.abs(x).max(axis=0), 1e-12)
    x = x / unit
    y = y / unit
    xx = (x * x).sum(axis=1).cumsum()
    xy = (x * y).sum(axis=1).cumsum()
    yy = (y * y).sum(axis=1).cumsum()
    k = np.arange(_MOVING_WINDOWS, len(x) - _MOVING_WINDOWS)
    if not len(k) or (xx[k] <= 0).any() or (xx[-1] - xx[k] <= 0).any():
        return None
    first = xy[k] / xx[k]
    second = (xy[-1] - xy[k]) / (xx[-1] - xx[k])
    with_two = yy[-1] - first * xy[k] - second * (xy[-1] - xy[k])
    with_one = yy[-1] - xy[-1] ** 2 / xx[-1]
    best = int(np.argmin(with_two))
    before = float(first[best])
    after = float(second[best])
    clear = with_two[best] <= 0.1 * with_one
    if not clear or not any(abs(after / before / r - 1) < _MARGIN for r in RATES):
        return None
    at = float(log.t[(int(k[best]) + 1) * rows])
    detail = (
        f"the sample rate changes near t = {at:.4g} s though the stamps run on: ∫dq dt is "
        f"{before:.4g} times the change of q before and {after:.4g} times after, at all moving "
        f"joints alike; cut the recording there and stretch the time of one part"
    )
    evidence = {"at": at, "before": before, "after": after}
    return Fault("wrong_sample_rate", log.joints, detail, evidence)


def _unit_slope(slope: float) -> float | None:
    """The slope of the unit that explains a slope, whatever its sign."""
    near = (s for s in _UNITS if abs(abs(slope) / s - 1) < _UNIT_MARGIN)
    return next(near, None)


def slow_clock(log: Log, factor: float, detail: str, /, **evidence: object) -> Fault:
    """The fault of a clock that runs so many times too slow."""
    done = f"divides the time by {factor:.5g}"
    remedy = Remedy("scale", "t", factor=1 / factor)
    evidence = {"factor": factor, **evidence}
    return Fault("wrong_sample_rate", log.joints, detail, evidence, done, (remedy,))


def _joint_fault(log: Log, j: int, slope: float, error: float) -> Fault:
    """The wrong unit or sign of one joint's velocity or position."""
    joint = log.joints[j]
    unit = _unit_slope(slope)
    sign = float(np.sign(slope))
    size = unit or abs(slope)
    channel = "dq"
    if abs(slope + 1) <= _MARGIN:
        fault = "wrong_sign"
        what = ": dq has the opposite sign of q"
        done = f"negates dq of {joint}"
        factor = -1.0
    else:
        fault = "wrong_unit"
        what = ": no unit that is known, a scale is wrong"
        done = f"divides dq of {joint} by {sign * size:.6g}"
        factor = sign / size
        if unit is not None:
            channel, what = _UNITS[unit]
        if channel == "q":
            done = f"multiplies q of {joint} by {size:.6g}"
            factor = sign * size
        what += ", and its sign is flipped" if slope < 0 else ""
    remedy = Remedy("scale", channel, (j,), factor=factor)
    detail = f"∫dq dt of {joint} is {slope:.4g} ± {error:.2g} times the change of its q{what}"
    evidence = {"channel": channel, "slope": slope, "error": error}
    return Fault(fault, (joint,), detail, evidence, done, (remedy,))
