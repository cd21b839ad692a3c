"""Where a trajectory needs most torque, and how that changes with its coefficients.

Torque is smooth but for friction, which jumps where a joint turns back. There the largest
torque is a one-sided limit, which no sample attains: both sides are evaluated at the very
instant, with the joint's velocity replaced by a tiny one of either sign.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from excitant.design.trajectory import fourier_basis
from excitant.robots import Array, Motion, Robot, torque

if TYPE_CHECKING:
    from excitant.design.problem import DesignProblem

_CREEP = 1e-5  # speed that stands for a one-sided limit [rad/s or m/s]
_STEP = 1e-6  # of central differences of effects; below `_CREEP`, so that no sign changes
_STILL = 1e-6  # acceleration, as a share of the largest, below which a turn stays where it is


@dataclass(frozen=True, eq=False)
class TorquePeaks:
    """Instants at which one joint's torque is locally largest.

    Attributes:
        t: Instants, shape (k,) [s].
        joint: Joint, shape (k,).
        side: 0, or the sign of velocity where the joint turns back, shape (k,).
        use: Magnitude over the torque bound, shape (k,).
    """

    t: Array
    joint: npt.NDArray[np.intp]
    side: Array
    use: Array

    def above(self, share: float) -> TorquePeaks:
        """Those whose use exceeds a share."""
        k = self.use > share
        return TorquePeaks(self.t[k], self.joint[k], self.side[k], self.use[k])

    def motion(self, problem: DesignProblem, z: Array) -> Motion:
        """The motion at the instants, creeping where it turns."""
        q, dq, ddq = (basis @ z for basis in problem.bases(self.t))
        turning = np.flatnonzero(self.side)
        dq[turning, self.joint[turning]] = _CREEP * self.side[turning]
        return Motion(self.t, q, dq, ddq)


def torque_peaks(problem: DesignProblem, z: Array) -> TorquePeaks:
    """Peaks of every joint's torque along a trajectory, estimated between samples."""
    q, dq, ddq = (basis @ z for basis in problem.grid_bases[:3])
    robot, t = problem.robot, problem.instants
    use = np.abs(torque(robot, Motion(t, q, dq, ddq))) / problem.torque_bound
    before, after = np.roll(use, 1, axis=0), np.roll(use, -1, axis=0)
    k, joint = np.nonzero((use >= before) & (use > after))
    here, rise = use[k, joint], after[k, joint] - before[k, joint]
    bend = np.minimum(before[k, joint] - 2 * here + after[k, joint], -1e-300)
    shift = np.clip(-0.5 * rise / bend, -0.5, 0.5)
    if robot.effects:
        v = dq[:, joint]
        columns = np.arange(len(k))
        around = [v[(k + step) % len(t), columns] for step in (-1, 0, 1)]
        shift[(np.min(around, axis=0) <= 0) & (np.max(around, axis=0) >= 0)] = 0.0
    times = t[k] + shift * problem.period / len(t)
    smooth = TorquePeaks(times, joint, np.zeros(len(k)), here + 0.25 * np.abs(rise * shift))
    if not robot.effects:
        return smooth
    turns = _turns(problem, z, dq)
    return TorquePeaks(
        *(
            np.concatenate([getattr(smooth, name), getattr(turns, name)])
            for name in ("t", "joint", "side", "use")
        )
    )


def _turns(problem: DesignProblem, z: Array, dq: Array) -> TorquePeaks:
    """Both sides of every turn, the start of the period among them."""
    n, nv = dq.shape
    following = np.roll(dq, -1, axis=0)
    k, joint = np.nonzero(dq * following < 0)
    share = dq[k, joint] / (dq[k, joint] - following[k, joint])
    t = (k + share) * problem.period / n
    for _ in range(2):
        v, a = (_own(problem, z, t, joint, order) for order in (1, 2))
        step = np.divide(v, a, out=np.zeros_like(v), where=a != 0.0)
        t = t - np.clip(step, -problem.period / n, problem.period / n)
    t, joint = np.append(t, np.zeros(nv)), np.append(joint, np.arange(nv))
    side = np.repeat([1.0, -1.0], len(t))
    both = TorquePeaks(np.tile(t, 2), np.tile(joint, 2), side, np.ones(len(side)))
    tau = torque(problem.robot, both.motion(problem, z))[np.arange(len(side)), both.joint]
    use = np.abs(tau) / problem.torque_bound[both.joint]
    return TorquePeaks(both.t, both.joint, both.side, use)


def _own(
    problem: DesignProblem, z: Array, t: Array, joint: npt.NDArray[np.intp], order: int
) -> Array:
    """A derivative of joint ``joint[k]`` at instant ``t[k]``."""
    phi = fourier_basis(t, problem.harmonics, problem.period, order) @ problem.Z
    values: Array = np.einsum("kd,kd->k", phi, z[:, joint].T)
    return values


def torque_rows(problem: DesignProblem, z: Array, share: float) -> tuple[Array, Array]:
    """Derivatives of the use at peaks above a share, shape (m, unknowns), and the use, (m,).

    A smooth peak moves without effect on its height; a turn takes its torque with it.
    """
    if np.all(np.isinf(problem.torque_bound)):
        return np.zeros((0, problem.size)), np.zeros(0)
    peaks = torque_peaks(problem, z).above(share)
    joint, m = peaks.joint, np.arange(len(peaks.t))
    motion, bases = peaks.motion(problem, z), problem.bases(peaks.t)
    tau, *parts = torque_derivatives(problem.robot, motion)
    sign = np.sign(tau[m, joint]) / problem.torque_bound[joint]
    rows = np.zeros((len(m), *z.shape))
    jerk = fourier_basis(peaks.t, problem.harmonics, problem.period, 3) @ problem.Z @ z
    rate = np.zeros(len(m))
    for phi, D, speed in zip(bases, parts, (motion.dq, motion.ddq, jerk), strict=True):
        rows += phi[:, :, None] * D[m, joint][:, None, :]
        rate += np.einsum("kj,kj->k", D[m, joint], speed)
    a = motion.ddq[m, joint]
    moving = (peaks.side != 0) & (np.abs(a) > _STILL * np.abs(motion.ddq).max(initial=0.0))
    delay = np.divide(rate, a, out=np.zeros_like(a), where=moving)
    rows[m, :, joint] -= bases[1] * delay[:, None]
    return rows.reshape(len(m), problem.size) * sign[:, None], tau[m, joint] * sign


def torque_derivatives(robot: Robot, motion: Motion) -> tuple[Array, Array, Array, Array]:
    """Torque and its derivatives by q, q̇, q̈ at every instant.

    Rigid bodies analytically (Carpentier and Mansard 2018), effects by central differences.

    Returns:
        Shapes (n, nv), and three of (n, nv, nv): torque joint first.
    """
    model, data = robot.model, robot.model.createData()
    n, nv = motion.q.shape
    D = np.empty((3, n, nv, nv))
    for k in range(n):
        pin.computeRNEADerivatives(model, data, motion.q[k], motion.dq[k], motion.ddq[k])
        D[0, k], D[1, k], D[2, k] = data.dtau_dq, data.dtau_dv, data.M
    upper = np.triu(D[2])
    D[2] = upper + np.swapaxes(np.triu(upper, 1), 1, 2)
    if robot.effects:
        D += _effect_derivatives(robot, motion)
    return torque(robot, motion), D[0], D[1], D[2]


def _effect_derivatives(robot: Robot, motion: Motion) -> Array:
    n, nv = motion.q.shape
    D = np.zeros((3, n, nv, nv))
    state = np.stack([motion.q, motion.dq, motion.ddq])
    for order in range(3):
        for j in range(nv):
            change = np.zeros_like(state)
            change[order, :, j] = _STEP
            ahead, behind = (Motion(motion.t, *(state + sign * change)) for sign in (1.0, -1.0))
            for effect in robot.effects:
                difference = effect.torque(robot, ahead) - effect.torque(robot, behind)
                D[order, :, :, j] += difference / (2 * _STEP)
    return D
