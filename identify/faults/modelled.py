"""A "measured" torque that is the output of a model.

It betrays itself in one of two ways. A column computed from planned or smoothed motion has no
noise of its own, and rigid bodies with plain friction explain nearly all of it, which they do for
no drive: its friction is never so ideal. A column computed from the measured motion has noise,
but it is the noise of the differentiated positions, which a sensor knows nothing of.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy.ndimage
from scipy.special import comb

from excitant.identify.faults.fault import Fault
from excitant.identify.faults.log import Log, quantum
from excitant.identify.faults.physics import Torques
from excitant.robots.motion import Array

_SMOOTH = 1e-3  # of the channel's range: noise that counts as none
_ORDERS = (4, 6, 8)
_IDEAL = 0.01  # of the torque's spread: no drive is known better
_HALF = 0.5  # of the joints: one that bears mainly weight proves nothing
_EXPLAINED = 0.5  # of the noise's variance: most of it
_GAP, _REACH = 1.5, 6  # median steps; rows that two gradients and four differences reach


def not_measured(case: Torques) -> list[Fault]:
    """Joints whose torque has no error of its own, and those whose noise is that of the motion."""
    ideal, copied = _ideal(case), _derived(case.log, case.joints)
    faults = [] if ideal is None else [ideal]
    if len(copied) > _HALF * len(case.joints):
        log, worst = case.log, max(copied, key=lambda j: copied[j])
        names = log.names(copied)
        faults.append(
            Fault(
                "not_measured",
                names,
                f"tau of {', '.join(names)} is computed from the logged motion, not measured: up "
                f"to {copied[worst]:.1%} of the variance of its noise ({log.joints[worst]}) is "
                f"that of the differentiated positions and velocities",
                {"explained": [copied[j] for j in copied]},
            )
        )
    return faults


def _ideal(case: Torques) -> Fault | None:
    log = case.log
    own = {j: _own_noise(log.tau[:, j]) for j in case.joints}
    missed = np.sqrt(case.fit.power) / np.maximum(case.problem.c.tau.std(axis=0), 1e-100)
    found = [
        j
        for j in case.joints
        if own[j] < _SMOOTH * float(np.ptp(log.tau[:, j])) and missed[j] < _IDEAL
    ]
    if len(found) <= _HALF * len(case.joints):
        return None
    worst, names = max(found, key=lambda j: missed[j]), log.names(found)
    return Fault(
        "not_measured",
        names,
        f"tau of {', '.join(names)} is the output of a model, not a measurement: rigid bodies "
        f"with viscous and Coulomb friction miss it by no more than {missed[worst]:.2%} of its "
        f"spread ({log.joints[worst]}), and its own noise is at most "
        f"{max(own[j] for j in found):.1g} {log.unit}",
        {"missed": missed[found], "noise": [own[j] for j in found]},
    )


def _own_noise(x: Array) -> float:
    """White noise of a channel: what differences of rising order do not make smaller."""
    smallest = min(_difference(x, order) for order in _ORDERS)
    return max(0.0, smallest - quantum(x) / float(np.sqrt(12)))


def _difference(x: Array, order: int) -> float:
    size = float(np.median(np.abs(np.diff(x, order)))) / 0.6745
    return size / float(np.sqrt(comb(2 * order, order)))


def _derived(log: Log, joints: list[int]) -> dict[int, float]:
    """Joints whose noise the noise of the accelerations explains, with the share explained."""
    speed = [] if log.dq is None else [np.gradient(log.dq, log.t, axis=0)]
    by_position = np.gradient(np.gradient(log.q, log.t, axis=0), log.t, axis=0)
    rough = np.diff(np.column_stack([by_position, *speed]), 4, axis=0)
    regular = _regular(log)
    rough = rough[regular]
    if not len(rough):
        return {}
    size = np.sqrt((rough**2).mean(axis=0))
    rough = rough[:, size > 0] / size[size > 0]
    found = {}
    for j in joints:
        y = np.diff(log.tau[:, j], 4)[regular]
        if len(y) < 20 * rough.shape[1] or not y.any():
            continue
        left = y - rough @ np.linalg.lstsq(rough, y, rcond=None)[0]
        share = 1 - float((left**2).sum() / (y**2).sum())
        if share > _EXPLAINED:
            found[j] = share
    return found


def _regular(log: Log) -> npt.NDArray[np.bool_]:
    """Fourth differences that reach over no gap: there those of all channels are large at once."""
    gaps = np.append(np.diff(log.t) > _GAP * log.step, False)
    near = scipy.ndimage.binary_dilation(gaps, np.ones(2 * _REACH + 1, bool))
    return np.asarray(~near[2 : len(log.t) - 2], bool)
