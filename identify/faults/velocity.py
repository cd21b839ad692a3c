"""Velocity against position: sign, unit and time base without any model of the arm.

Over windows, ∫ q̇ dt must be Δq. The slope b of one against the other is 1; it is −1 where a sign
is flipped, 180/π or 30/π where the velocity is in degrees or revolutions per minute, and c for
all joints at once where the time runs c times too fast.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy

from excitant.identify.faults.fault import Fault, Log, Remedy, normal_bound
from excitant.robots.motion import Array

_WINDOW_S, _WINDOW_ROWS = 0.2, 8
_ENOUGH = 8  # windows in which the joint moves
_CLEAR = 20.0  # resolutions: what counts as moving
_FOLLOWS = 0.9  # correlation from which on one channel is the other's integral
_MARGIN = 0.05  # a scale that is off by less changes inertial torque by less than a tenth
_NEAR = 0.03  # of a named factor
_FALLS = 0.1  # of what one rate leaves, two leave at most
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
    bound = normal_bound(log.nv)
    wrong = [j for j in follows if abs(b[j] - 1) > max(_MARGIN, bound * error[j])]
    # the factor that all moving joints share, when more than one moves
    common = float(np.median(b[follows])) if len(follows) > 1 and wrong == follows else None
    if common is not None and (np.abs(b[follows] / common - 1) >= _MARGIN).any():
        common = None
    if len(log) > 3 and (np.diff(log.t) == 1.0).all():
        return [_counted(log, common)]
    if wrong and (change := _rate_change(log)) is not None:
        return [change]
    if common is None or common <= 0 or _named(common) is not None:
        return [_of_joint(log, j, float(b[j]), float(error[j])) for j in wrong]
    factor = next((c for c in RATES if abs(common / c - 1) < _NEAR), common)
    detail = (
        f"the time runs {common:.4g} times too {'slow' if common > 1 else 'fast'} for the motion: "
        f"∫dq dt is {common:.4g} ± {np.nanmedian(error):.2g} times the change of q at all "
        f"{len(follows)} moving joints; the median step is {log.step:.4g} s, "
        f"{log.step / factor:.4g} s would fit"
    )
    return [slower(log, factor, detail, factor=common, slopes=b, errors=error)]


def _windows(log: Log, dq: Array) -> tuple[int, Array, Array]:
    """Rows of a window, Δq and ∫q̇ dt over windows, each of shape (windows, nv)."""
    w = min(max(_WINDOW_ROWS, round(_WINDOW_S / log.step)), len(log) // 20)
    way = scipy.integrate.cumulative_trapezoid(dq, log.t, axis=0, initial=0)
    return w, np.diff(log.q[::w], axis=0), np.diff(way[::w], axis=0)


def _slopes(log: Log) -> tuple[Array, Array, list[int]]:
    """Slopes of ∫q̇ dt on Δq (NaN without motion), their standard errors, joints in proportion."""
    b, error = np.full((2, log.nv), np.nan)
    follows: list[int] = []
    if log.dq is None or len(log) < 5 * _WINDOW_ROWS:
        return b, error, follows
    _, dq, dv = _windows(log, log.dq)
    for j, (x, y) in enumerate(zip(dq.T, dv.T, strict=True)):
        clear = np.abs(x) > _CLEAR * log.grain[j]
        if clear.sum() < _ENOUGH or np.ptp(y) == 0:
            continue
        b[j] = x @ y / (x @ x)
        error[j] = np.sqrt(((y - b[j] * x) ** 2 * x**2).sum()) / (x @ x)
        if abs(x @ y) > _FOLLOWS * np.sqrt((x @ x) * (y @ y)):
            follows.append(j)
    return b, error, follows


def _rate_change(log: Log) -> Fault | None:
    """A rate that changes once, all joints alike, while the stamps run on as before."""
    w, x, y = _windows(log, np.asarray(log.dq))
    unit = np.maximum(np.abs(x).max(axis=0), 1e-12)
    x, y = x / unit, y / unit
    xx, xy, yy = ((a * b).sum(axis=1).cumsum() for a, b in ((x, x), (x, y), (y, y)))
    k = np.arange(_ENOUGH, len(x) - _ENOUGH)
    if not len(k) or (xx[k] <= 0).any() or (xx[-1] - xx[k] <= 0).any():
        return None
    first, second = xy[k] / xx[k], (xy[-1] - xy[k]) / (xx[-1] - xx[k])
    left = yy[-1] - first * xy[k] - second * (xy[-1] - xy[k])
    best = int(np.argmin(left))
    before, after = float(first[best]), float(second[best])
    alone = yy[-1] - xy[-1] ** 2 / xx[-1]
    if left[best] > _FALLS * alone or not any(abs(after / before / r - 1) < _MARGIN for r in RATES):
        return None
    at = float(log.t[(int(k[best]) + 1) * w])
    return Fault(
        "wrong_sample_rate",
        log.joints,
        f"the sample rate changes near t = {at:.4g} s though the stamps run on: ∫dq dt is "
        f"{before:.4g} times the change of q before and {after:.4g} times after, at all moving "
        f"joints alike; cut the recording there and stretch the time of one part",
        {"at": at, "before": before, "after": after},
    )


def _named(slope: float) -> float | None:
    """The factor of a unit that a slope is near to, whatever its sign."""
    return next((factor for factor in _UNITS if abs(abs(slope) / factor - 1) < _NEAR), None)


def _counted(log: Log, common: float | None) -> Fault:
    detail = f"every time step is exactly 1, so t counts samples ({log.t[0]:g} to {log.t[-1]:g})"
    if common is None or common <= 0:
        return Fault("wrong_sample_rate", log.joints, detail, {"step": 1.0})
    detail += f"; q and dq agree at a step of {1 / common:.4g} s ({common:.4g} Hz)"
    return slower(log, common, detail, step=1.0)


def slower(log: Log, factor: float, detail: str, /, **evidence: object) -> Fault:
    """The fault of a clock that runs so many times too slow."""
    remedy = Remedy("scale", "t", factor=1 / factor)
    repair = f"divides the time by {factor:.5g}"
    return Fault(
        "wrong_sample_rate", log.joints, detail, {"factor": factor, **evidence}, repair, (remedy,)
    )


def _of_joint(log: Log, j: int, b: float, error: float) -> Fault:
    joint, unit, sign = log.joints[j], _named(b), float(np.sign(b))
    fault, flipped = "wrong_unit", ", and its sign is flipped" if b < 0 else ""
    channel, what = _UNITS[unit] if unit else ("dq", ": no unit that is known, a scale is wrong")
    factor, repair = unit or abs(b), f"divides dq of {joint} by {sign * (unit or abs(b)):.6g}"
    remedy = Remedy("scale", channel, (j,), factor=sign / factor)
    if abs(b + 1) <= _MARGIN:
        fault, what, flipped = "wrong_sign", ": dq has the opposite sign of q", ""
        repair, remedy = f"negates dq of {joint}", replace(remedy, factor=-1.0)
    elif channel == "q":
        repair = f"multiplies q of {joint} by {factor:.6g}"
        remedy = replace(remedy, factor=sign * factor)
    detail = f"∫dq dt of {joint} is {b:.4g} ± {error:.2g} times the change of its q{what}{flipped}"
    evidence = {"channel": channel, "slope": b, "error": error}
    return Fault(fault, (joint,), detail, evidence, repair, (remedy,))
