"""Rate, units and signs judged by the physics: which reading of the log explains its torque.

A hypothesis ("positions in degrees", "joint 3 counted the other way", "time twice too slow") is
named when it explains the torque better than the log as it stands: a likelihood ratio beyond
chance, at least one joint's squared error halved, and no joint's doubled. The ratio counts
independent rows only, as many as the autocorrelation of the error leaves.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy

from excitant.identify.faults.fault import Fault, Remedy
from excitant.identify.faults.fit import Fit, Problem, Smooth
from excitant.identify.faults.log import ALARM, Log, normal_bound
from excitant.identify.faults.velocity import RATES, slower
from excitant.identify.least_squares import autocorrelation_time
from excitant.robots.motion import Array
from excitant.robots.robot import Robot

_HALVED = 0.5
_BROAD = np.geomspace(1e-3, 1e3, 25)  # time factors tried first
_NEAR = 0.05  # of a clear factor
_EXPLAINED = 0.5  # of the torque's variance: the model is worth listening to
_SIGNAL = 3.0  # a part of the torque that is to have a sign exceeds the error by so much
_BEYOND = 1.2 * 2 * np.pi  # rad: more than joints turn to one side


@dataclass(frozen=True, eq=False)
class Torques:
    """A log ready to test hypotheses against its torque.

    Attributes:
        robot: The arm.
        log: The log.
        data: The same, filtered.
        problem: Least squares of its torque.
        fit: The log as it stands.
        rows: Independent rows of each joint, shape (nv,).
    """

    robot: Robot
    log: Log
    data: Smooth
    problem: Problem
    fit: Fit
    rows: Array

    @property
    def joints(self) -> list[int]:
        """Joints whose torque counts."""
        return self.problem.joints

    def gain(self, other: Fit) -> float:
        """Twice the log-likelihood ratio of another reading against the log as it stands."""
        ratio = np.log(self.fit.power / other.power)[self.joints]
        return float((self.rows[self.joints] * ratio).sum())

    def better(self, other: Fit, tests: int, freedom: int | None = None) -> bool:
        """Whether another reading explains the torque beyond chance.

        Args:
            other: The fit of the other reading.
            tests: Readings that were tried.
            freedom: Parameters that it has more; where the models are not nested, and when None,
                as many as the model has, since all of them can adapt to a wrong reading.
        """
        freedom = len(self.fit.x) if freedom is None else freedom
        ratio = (other.power / self.fit.power)[self.joints]
        bound = float(scipy.special.chdtri(freedom, ALARM / tests))
        return self.gain(other) > bound and bool(ratio.min() < _HALVED and ratio.max() < 2)


def torques(robot: Robot, log: Log, data: Smooth, dead: set[str]) -> Torques | None:
    """Prepare a log; None when no joint's torque can be used."""
    alive = [j for j in range(robot.nv) if log.joints[j] not in dead and np.ptp(data.tau[:, j]) > 0]
    problem = Problem(robot, data, alive)
    if not alive or len(problem.tau) < 60:
        return None
    fit = problem.fit()
    return Torques(robot, log, data, problem, fit, problem.independent(fit))


def physics_faults(case: Torques) -> list[Fault]:
    """The faults of rate, unit and sign that the torque tells; the strongest reading counts."""
    fault = _degrees(case)
    if fault is not None:
        return [fault]
    signs = _torque_signs(case)
    if signs:
        return signs
    readings = [r for r in (_rate(case), *_position_signs(case)) if r is not None]
    return [max(readings, key=lambda r: r[0])[1]] if readings else []


def _compared(case: Torques, other: Fit) -> str:
    ratio = np.sqrt(other.power / case.fit.power)[case.joints]
    best = case.joints[int(np.argmin(ratio))]
    return (
        f"the error of the best model of its torque falls to {100 * ratio.min():.2g} % at "
        f"{case.log.joints[best]} (likelihood ratio {case.gain(other):.3g} in "
        f"{case.rows[case.joints].sum():.0f} independent rows)"
    )


def _degrees(case: Torques) -> Fault | None:
    """Positions in degrees, of all joints or of those beyond a turn."""
    robot, log = case.robot, case.log
    turning = np.asarray(robot.revolute)
    beyond = turning & (np.abs(log.q).max(axis=0) > _BEYOND)
    if not beyond.any():
        return None
    each = np.where(beyond, np.pi / 180, 1.0)
    every = np.where(turning, np.pi / 180, 1.0)
    options = [every] if beyond.all() else [every, each]
    tried = [(Problem(robot, case.data, case.joints, o).fit(), o) for o in options]
    fit, factor = max(tried, key=lambda pair: case.gain(pair[0]))
    if not case.better(fit, len(tried)):
        return None
    joints = np.flatnonzero(factor != 1)
    widest = int(np.argmax(np.abs(log.q).max(axis=0)))
    return Fault(
        "wrong_unit",
        log.names(joints),
        f"q is in degrees: it reaches {np.abs(log.q[:, widest]).max():.4g} at "
        f"{log.joints[widest]}, and read in degrees {_compared(case, fit)}",
        {"channel": "q", "gain": case.gain(fit), "largest": np.abs(log.q).max(axis=0)},
        "multiplies q and dq, which agrees with it, by π/180",
        tuple(
            Remedy("scale", name, (int(j),), factor=np.pi / 180)
            for j in joints
            for name in ("q", "dq")
        ),
    )


def _position_signs(case: Torques) -> list[tuple[float, Fault]]:
    found = []
    tests = 2 * case.robot.nv
    for j in range(case.robot.nv):
        flip = np.ones(case.robot.nv)
        flip[j] = -1
        problem = Problem(case.robot, case.data, case.joints, flip)
        for both, fit in ((False, problem.fit()), (True, problem.fit(sign=flip))):
            if not case.better(fit, tests):
                continue
            joint = case.log.joints[j]
            what = "q and tau" if both else "q"
            remedies = [Remedy("scale", name, (j,), factor=-1.0) for name in ("q", "dq")]
            remedies += [Remedy("scale", "tau", (j,), factor=-1.0)] if both else []
            fault = Fault(
                "wrong_sign",
                (joint,),
                f"{what} of {joint} count the other way than the robot's: negated, "
                f"{_compared(case, fit)}",
                {"channel": what, "gain": case.gain(fit)},
                f"negates {what} (and dq) of {joint}",
                tuple(remedies),
            )
            found.append((case.gain(fit), fault))
    return found


def _rate(case: Torques) -> tuple[float, Fault] | None:
    """Profile likelihood over a factor of the time: inertial torque goes with its square."""

    def gain(logarithm: float) -> float:
        return case.gain(case.problem.fit(s=float(np.exp(2 * logarithm))))

    start = float(np.log(max(_BROAD, key=lambda c: gain(float(np.log(c))))))
    step = float(np.log(_BROAD[1] / _BROAD[0]))
    best = scipy.optimize.minimize_scalar(
        lambda x: -gain(x),
        bounds=(start - step, start + step),
        method="bounded",
        options={"xatol": 1e-3, "maxiter": 25},
    )
    c = float(np.exp(best.x))
    fit = case.problem.fit(s=c**2)
    near = [r for r in RATES if abs(c / r - 1) < _NEAR]
    freedom = 1 if near else None  # an odd factor may stand for anything the model lacks
    if abs(c - 1) < 2 * _NEAR or not case.better(fit, len(_BROAD), freedom):
        return None
    low, high = (np.exp(best.x + side * _half_width(gain, float(best.x), side)) for side in (-1, 1))
    factor, log = near[0] if near else c, case.log
    detail = (
        f"the time runs {c:.3g} times too {'slow' if c > 1 else 'fast'} for the torque "
        f"(95 % between {low:.3g} and {high:.3g}): so corrected, {_compared(case, fit)}; the "
        f"median step is {log.step:.4g} s, {log.step / factor:.4g} s would fit"
    )
    gained = case.gain(fit)
    return gained, slower(log, factor, detail, factor=c, interval=(low, high), gain=gained)


def _half_width(gain: Callable[[float], float], best: float, side: int) -> float:
    """How far the logarithm of a factor may move before the likelihood falls by its 95 % bound."""
    top, width = gain(best), 0.01
    while top - gain(best + side * width) < 3.84 and width < 3:
        width *= 1.5
    return width


def _torque_signs(case: Torques) -> list[Fault]:
    """Torques against the given model and against the friction they pay for.

    τ_j = g τ_model + F_v q̇ + F_c sign q̇ + I_a q̈ + offset. Gain g and the power that friction takes
    must not be negative. One that is, beyond chance, flips the sign unless the other objects.
    """
    c, log = case.problem, case.log
    model = (c.G + c.D) @ case.robot.phi
    bound = normal_bound(2 * len(case.joints))
    found = []
    for j in case.joints:
        gain, friction, explained = _signs(c, model[:, j], j)
        votes = [z for z in (gain, friction) if abs(z) > bound]
        if explained < _EXPLAINED or not votes or max(votes) > 0:
            continue
        why = []
        if gain < -bound:
            why.append(f"it is {gain:.1f} standard errors opposite to the given model's torque")
        if friction < -bound:
            why.append(f"its friction would drive the joint by {-friction:.1f} standard errors")
        found.append(
            Fault(
                "wrong_sign",
                log.names([j]),
                f"tau of {log.joints[j]} has the wrong sign: {' and '.join(why)} "
                f"({100 * explained:.0f} % of its variance explained)",
                {"channel": "tau", "gain": gain, "friction": friction, "explained": explained},
                f"negates tau of {log.joints[j]}",
                (Remedy("scale", "tau", (j,), factor=-1.0),),
            )
        )
    return found


def _signs(c: Problem, model: Array, j: int) -> tuple[float, float, float]:
    """Gain and friction power in standard errors (0 when within the error), variance explained."""
    dq, dry, ddq, one = c.F[:, j].T
    W, y = np.column_stack([model, dq, dry, ddq, one]), c.tau[:, j]
    size = np.sqrt((W**2).mean(axis=0))
    W = W / np.where(size > 0, size, 1.0)
    x, *_ = np.linalg.lstsq(W, y, rcond=1e-10)
    error = y - W @ x
    left = float(error.std())
    independent = max(len(y) / autocorrelation_time(error), 8.0)
    C = np.linalg.pinv(W.T @ W / len(y), rcond=1e-10) * left**2 / independent
    power = np.array([0.0, (dq * dq).mean(), np.abs(dq * dry).mean(), 0.0, 0.0])
    power = power / np.where(size > 0, size, 1.0)
    parts = (np.eye(5)[0], power)
    z = [float(a @ x / np.sqrt(max(a @ C @ a, 1e-300))) for a in parts]
    shown = [float((W[:, :1] @ x[:1]).std()), float((W[:, 1:3] @ x[1:3]).std())]
    z = [s if part > _SIGNAL * left else 0.0 for s, part in zip(z, shown, strict=True)]
    return z[0], z[1], 1 - float(error.var() / max(y.var(), 1e-300))
