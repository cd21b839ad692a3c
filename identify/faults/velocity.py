"""Velocity against position: sign, unit and time base without any model of the arm.

Over windows, ∫ q̇ dt must be Δq. The slope b of one against the other is 1; it is −1 where a sign
is flipped, 180/π or 30/π where the velocity is in degrees or revolutions per minute, and c for
all joints at once where the time runs c times too fast.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from excitant.identify.faults.fault import Fault, Remedy
from excitant.identify.faults.log import Log
from excitant.identify.faults.stamps import counted
from excitant.identify.faults.statistics import normal_bound
from excitant.robots.motion import Array, freeze

_WINDOW_S, _WINDOW_ROWS = 0.2, 8
_ENOUGH = 8  # windows in which the joint moves
_CLEAR = 20.0  # resolutions: what counts as moving
_FOLLOWS = 0.9  # correlation from which on one channel is the other's integral
_MARGIN = 0.05  # a scale that is off by less changes inertial torque by less than a tenth
_NEAR = 0.03  # of a named factor
_FALLS = 0.1  # of what one rate leaves, two leave at most
UNITS = (
    (180 / np.pi, "degrees per second"),
    (30 / np.pi, "revolutions per minute"),
    (1 / (2 * np.pi), "revolutions per second"),
)
POSITION_UNITS = ((180 / np.pi, "degrees"), (1 / (2 * np.pi), "turns"), (1000.0, "millimetres"))
RATES = (0.5, 2.0, 0.25, 4.0, 1e-3, 1e3, 1e-6, 1e6, 1e-9, 1e9)


@dataclass(frozen=True, eq=False)
class Slopes:
    """How velocity and position agree.

    Attributes:
        b: Slope of ∫q̇ dt against Δq, nan where the joint does not move, shape (nv,).
        error: Its standard error, shape (nv,).
        wrong: Joints whose slope differs from 1 by more than chance and margin.
        follows: Joints whose velocity is in proportion to the change of position.
    """

    b: Array
    error: Array
    wrong: tuple[int, ...]
    follows: tuple[int, ...]

    def __post_init__(self) -> None:
        freeze(self, "b", "error")

    @property
    def common(self) -> float | None:
        """The factor that all moving joints share, when more than one moves."""
        b = self.b[list(self.follows)]
        if len(b) < 2 or len(self.wrong) < len(b):
            return None
        middle = float(np.median(b))
        return middle if (np.abs(b / middle - 1) < _MARGIN).all() else None


def _windows(log: Log, dq: Array) -> tuple[int, Array, Array]:
    """Rows of a window, Δq and ∫q̇ dt over windows, each of shape (windows, nv)."""
    w = min(max(_WINDOW_ROWS, round(_WINDOW_S / log.step)), len(log) // 20)
    rate = (dq[1:] + dq[:-1]) / 2 * np.diff(log.t)[:, None]
    way = np.concatenate([np.zeros((1, log.nv)), np.cumsum(rate, axis=0)])
    return w, np.diff(log.q[::w], axis=0), np.diff(way[::w], axis=0)


def slopes(log: Log) -> Slopes:
    """Regression of ∫q̇ dt on Δq, joint by joint."""
    nan = np.full(log.nv, np.nan)
    if log.dq is None or len(log) < 5 * _WINDOW_ROWS:
        return Slopes(nan, nan, (), ())
    _, dq, dv = _windows(log, log.dq)
    b, error, follows = nan.copy(), nan.copy(), []
    for j in range(log.nv):
        clear = np.abs(dq[:, j]) > _CLEAR * max(log.resolution[j], log.quantum[j])
        if clear.sum() < _ENOUGH or np.ptp(dv[:, j]) == 0:
            continue
        x, y = dq[:, j], dv[:, j]
        b[j] = x @ y / (x @ x)
        error[j] = np.sqrt(((y - b[j] * x) ** 2 * x**2).sum()) / (x @ x)
        if abs(x @ y) > _FOLLOWS * np.sqrt((x @ x) * (y @ y)):
            follows.append(j)
    bound = normal_bound(log.nv)
    wrong = tuple(j for j in follows if abs(b[j] - 1) > max(_MARGIN, bound * error[j]))
    return Slopes(b, error, wrong, tuple(follows))


def velocity_faults(log: Log) -> list[Fault]:
    """Faults that show in the velocity against the position."""
    found = slopes(log)
    common = found.common
    if counted(log):
        return [_counted(log, common)]
    if found.wrong and (change := _rate_change(log)) is not None:
        return [change]
    if common is not None and common > 0 and _named(common, UNITS + _inverse()) is None:
        return [_rate(log, common, found)]
    return [_of_joint(log, j, found) for j in found.wrong]


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
    ratio = float(second[best] / first[best])
    near = [r for r in RATES if abs(ratio / r - 1) < _MARGIN]
    alone = yy[-1] - xy[-1] ** 2 / xx[-1]
    if not near or left[best] > _FALLS * alone:
        return None
    at = float(log.t[(int(k[best]) + 1) * w])
    return Fault(
        "wrong_sample_rate",
        log.joints,
        f"the sample rate changes near t = {at:.4g} s though the stamps run on: ∫dq dt is "
        f"{first[best]:.4g} times the change of q before and {second[best]:.4g} times after, at "
        f"all moving joints alike; cut the recording there and stretch the time of one part",
        {"at": at, "before": float(first[best]), "after": float(second[best])},
    )


def _inverse() -> tuple[tuple[float, str], ...]:
    """Slopes of positions in other units beside velocities in rad/s."""
    return tuple((1 / factor, f"q in {unit}") for factor, unit in POSITION_UNITS[:2])


def _named(b: float, units: tuple[tuple[float, str], ...]) -> tuple[float, str] | None:
    near = [(f, unit) for f, unit in units if abs(abs(b) / f - 1) < _NEAR]
    return near[0] if near else None


def _counted(log: Log, common: float | None) -> Fault:
    detail = f"every time step is exactly 1, so t counts samples ({log.t[0]:g} to {log.t[-1]:g})"
    if common is None or common <= 0:
        return Fault("wrong_sample_rate", log.joints, detail, {"step": 1.0})
    return Fault(
        "wrong_sample_rate",
        log.joints,
        f"{detail}; q and dq agree at a step of {1 / common:.4g} s ({common:.4g} Hz)",
        {"step": 1.0, "factor": common},
        f"divides the time by {common:.5g}",
        (Remedy("scale", "t", factor=1 / common),),
    )


def _rate(log: Log, common: float, found: Slopes) -> Fault:
    near = [c for c in RATES if abs(common / c - 1) < _NEAR]
    factor = near[0] if near else common
    return Fault(
        "wrong_sample_rate",
        log.joints,
        f"the time runs {common:.4g} times too {'slow' if common > 1 else 'fast'} for the motion: "
        f"∫dq dt is {common:.4g} ± {np.nanmedian(found.error):.2g} times the change of q at all "
        f"{len(found.follows)} moving joints; the median step is {log.step:.4g} s, "
        f"{log.step / factor:.4g} s would fit",
        {"factor": common, "slopes": found.b, "errors": found.error},
        f"divides the time by {factor:.5g}",
        (Remedy("scale", "t", factor=1 / factor),),
    )


def _of_joint(log: Log, j: int, found: Slopes) -> Fault:
    b, joint = float(found.b[j]), log.joints[j]
    evidence = {"channel": "dq", "slope": b, "error": float(found.error[j])}
    sentence = f"∫dq dt of {joint} is {b:.4g} ± {found.error[j]:.2g} times the change of its q"
    flipped = ", and its sign is flipped" if b < 0 else ""
    if b < 0 and abs(abs(b) - 1) <= _MARGIN:
        return Fault(
            "wrong_sign", (joint,), f"{sentence}: dq has the opposite sign of q", evidence,
            f"negates dq of {joint}", (Remedy("scale", "dq", (j,), factor=-1.0),),
        )  # fmt: skip
    turned = _named(b, _inverse())
    if turned is not None:
        factor, unit = turned
        return Fault(
            "wrong_unit", (joint,), f"{sentence}, as with {unit} and dq in rad/s{flipped}",
            {**evidence, "channel": "q"}, f"multiplies q of {joint} by {factor:.6g}",
            (Remedy("scale", "q", (j,), factor=float(np.copysign(factor, b))),),
        )  # fmt: skip
    named = _named(b, UNITS)
    factor = float(np.copysign(named[0], b)) if named else b
    unit = f"dq is in {named[1]}" if named else "no unit that is known, a scale is wrong"
    return Fault(
        "wrong_unit", (joint,), f"{sentence}: {unit}{flipped}", evidence,
        f"divides dq of {joint} by {factor:.6g}",
        (Remedy("scale", "dq", (j,), factor=1 / factor),),
    )  # fmt: skip
