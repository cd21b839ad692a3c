"""Rate, units and signs judged by the physics: which reading of the log explains its torque.

A hypothesis ("positions in degrees", "joint 3 counted the other way", "time twice too slow") is
named when it explains the torque better than the log as it stands: a likelihood ratio beyond
chance, at least one joint's squared error halved, and no joint's doubled. The ratio counts
independent rows only, as many as the autocorrelation of the error leaves.
"""

from __future__ import annotations

import numpy as np
import scipy

from excitant.identify.faults.fault import Fault, Remedy
from excitant.identify.faults.fit import TorqueFit, scaled_least_squares
from excitant.identify.faults.log import normal_bound
from excitant.identify.faults.velocity import RATES, slower
from excitant.identify.least_squares import autocorrelation_time
from excitant.robots.motion import Array

_BROAD = np.geomspace(1e-3, 1e3, 25)  # time factors tried first
_NEAR = 0.05  # of a clear factor
_EXPLAINED = 0.5  # of the torque's variance: the model is worth listening to
_SIGNAL = 3.0  # a part of the torque that is to have a sign exceeds the error by so much
_BEYOND = 1.2 * 2 * np.pi  # rad: more than joints turn to one side


def physics_faults(case: TorqueFit) -> list[Fault]:
    """The faults of rate, unit and sign that the torque tells; the strongest reading counts."""
    found = _degrees(case) or _torque_signs(case)
    readings = [] if found else [*_rate(case), *_position_signs(case)]
    return found or sorted(readings, key=lambda fault: -fault.evidence["gain"])[:1]


def _compared(case: TorqueFit, power: Array) -> str:
    ratio = np.sqrt(power / case.power)[case.joints]
    best = case.joints[int(np.argmin(ratio))]
    return (
        f"the error of the best model of its torque falls to {100 * ratio.min():.2g} % at "
        f"{case.log.joints[best]} (likelihood ratio {case.gain(power):.3g} in "
        f"{case.rows[case.joints].sum():.0f} independent rows)"
    )


def _degrees(case: TorqueFit) -> list[Fault]:
    """Positions in degrees, of all joints or of those beyond a turn."""
    log, largest = case.log, np.abs(case.log.q).max(axis=0)
    turning = np.asarray(case.robot.revolute)
    beyond = turning & (largest > _BEYOND)
    if not beyond.any():
        return []
    masks = [turning] if beyond.all() else [turning, beyond]
    tried = []
    for mask in masks:
        factor = np.where(mask, np.pi / 180, 1.0)
        tried.append(TorqueFit(case.robot, log, case.data, case.joints, factor).power)
    best = int(np.argmax([case.gain(power) for power in tried]))
    power, joints, widest = tried[best], np.flatnonzero(masks[best]), int(np.argmax(largest))
    if not case.better(power, len(tried)):
        return []
    fault = Fault(
        "wrong_unit",
        log.names(joints),
        f"q is in degrees: it reaches {largest[widest]:.4g} at {log.joints[widest]}, and read in "
        f"degrees {_compared(case, power)}",
        {"channel": "q", "gain": case.gain(power), "largest": largest},
        "multiplies q and dq, which agrees with it, by π/180",
        tuple(
            Remedy("scale", name, (int(j),), factor=np.pi / 180)
            for j in joints
            for name in ("q", "dq")
        ),
    )
    return [fault]


def _position_signs(case: TorqueFit) -> list[Fault]:
    found = []
    for j, joint in enumerate(case.log.joints):
        flip = np.ones(case.robot.nv)
        flip[j] = -1
        negated = TorqueFit(case.robot, case.log, case.data, case.joints, flip)
        readings = (("q", negated.power), ("q and tau", negated.fit(sign=flip)[1]))
        for what, power in readings:
            if case.better(power, 2 * case.robot.nv):
                channels = ("q", "dq", "tau") if "tau" in what else ("q", "dq")
                fault = Fault(
                    "wrong_sign",
                    (joint,),
                    f"{what} of {joint} count the other way than the robot's: negated, "
                    f"{_compared(case, power)}",
                    {"channel": what, "gain": case.gain(power)},
                    f"negates {what} (and dq) of {joint}",
                    tuple(Remedy("scale", name, (j,), factor=-1.0) for name in channels),
                )
                found.append(fault)
    return found


def _rate(case: TorqueFit) -> list[Fault]:
    """Profile likelihood over a factor of the time: inertial torque goes with its square."""

    def gain(logarithm: float) -> float:
        return case.gain(case.fit(s=float(np.exp(2 * logarithm)))[1])

    def bound(side: int) -> float:
        """Factor at which the likelihood has fallen by its 95 % bound."""
        width = 0.01
        while gain(peak) - gain(peak + side * width) < 3.84 and width < 3:
            width *= 1.5
        return float(np.exp(peak + side * width))

    start = max(np.log(_BROAD).tolist(), key=gain)
    step = np.log(_BROAD[1] / _BROAD[0])
    peak = scipy.optimize.minimize_scalar(
        lambda x: -gain(x),
        bounds=(start - step, start + step),
        method="bounded",
        options={"xatol": 1e-3, "maxiter": 25},
    ).x
    c, log = float(np.exp(peak)), case.log
    power = case.fit(s=c**2)[1]
    near = [r for r in RATES if abs(c / r - 1) < _NEAR]
    freedom = 1 if near else None  # an odd factor may stand for anything the model lacks
    if abs(c - 1) < 2 * _NEAR or not case.better(power, len(_BROAD), freedom):
        return []
    low, high = bound(-1), bound(1)
    factor = near[0] if near else c
    detail = (
        f"the time runs {c:.3g} times too {'slow' if c > 1 else 'fast'} for the torque "
        f"(95 % between {low:.3g} and {high:.3g}): so corrected, {_compared(case, power)}; the "
        f"median step is {log.step:.4g} s, {log.step / factor:.4g} s would fit"
    )
    return [slower(log, factor, detail, factor=c, interval=(low, high), gain=case.gain(power))]


def _torque_signs(case: TorqueFit) -> list[Fault]:
    """Torques against the given model and against the friction they pay for.

    τ_j = g τ_model + F_v q̇ + F_c sign q̇ + I_a q̈ + offset. Gain g and the power that friction takes
    must not be negative. One that is, beyond chance, flips the sign unless the other objects.
    """
    model = (case.G + case.D) @ case.robot.phi
    bound = normal_bound(2 * len(case.joints))
    found = []
    for j in case.joints:
        gain, friction, explained = _signs(case, model[:, j], j)
        votes = [z for z in (gain, friction) if abs(z) > bound]
        if explained < _EXPLAINED or not votes or max(votes) > 0:
            continue
        joint, why = case.log.joints[j], []
        if gain < -bound:
            why.append(f"it is {gain:.1f} standard errors opposite to the given model's torque")
        if friction < -bound:
            why.append(f"its friction would drive the joint by {-friction:.1f} standard errors")
        found.append(
            Fault(
                "wrong_sign",
                (joint,),
                f"tau of {joint} has the wrong sign: {' and '.join(why)} "
                f"({100 * explained:.0f} % of its variance explained)",
                {"channel": "tau", "gain": gain, "friction": friction, "explained": explained},
                f"negates tau of {joint}",
                (Remedy("scale", "tau", (j,), factor=-1.0),),
            )
        )
    return found


def _signs(case: TorqueFit, model: Array, j: int) -> tuple[float, float, float]:
    """Gain and friction power in standard errors (0 when within the error), variance explained."""
    dq, dry, y = *case.F[:, j, :2].T, case.tau[:, j]
    columns = np.column_stack([model, case.F[:, j]])
    W, x, error = scaled_least_squares(columns, y)
    left = float(error.std())
    independent = max(len(y) / autocorrelation_time(error), 8.0)
    C = np.linalg.pinv(W.T @ W / len(y), rcond=1e-10) * left**2 / independent
    size = np.sqrt((columns[:, 1:3] ** 2).mean(axis=0))
    power = np.array([(dq * dq).mean(), np.abs(dq * dry).mean()]) / np.where(size > 0, size, 1.0)
    z = []
    for part, weight in ((slice(0, 1), np.ones(1)), (slice(1, 3), power)):
        clear = (W[:, part] @ x[part]).std() > _SIGNAL * left
        variance = float(weight @ C[part, part] @ weight)
        z.append(float(weight @ x[part] / np.sqrt(max(variance, 1e-300))) if clear else 0.0)
    return z[0], z[1], 1 - float(error.var() / max(y.var(), 1e-300))
