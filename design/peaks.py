"""Peaks of torque and proximity along a trajectory, with derivatives in its unknowns.

Friction jumps where a joint turns back: there both one-sided limits of torque are evaluated, at
a tiny velocity of either sign. Where a joint only almost turns, the torque of the other side
counts with a weight that grows to 1 as the velocity falls to 0, so that no constraint appears
from nowhere between two steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from excitant.design.constraints import SCALE, pose_use
from excitant.design.problem import DesignProblem
from excitant.robots.effects import Effect
from excitant.robots.motion import Array, Indices, Motion
from excitant.robots.regressor import torque_derivatives as rigid_derivatives
from excitant.robots.robot import Robot
from excitant.robots.torque import largest_torque, link_torques, torque

_CREEP = 1e-5  # speed that stands for a one-sided limit [rad/s or m/s]
# of central differences of effects; below `_CREEP`, so that no sign changes
_STEP = 1e-6
_SLOW = 0.05  # of the speed scale, below which a joint almost turns
_STILL = 1e-6  # acceleration, as a share of the largest, below which a turn stays where it is

# instants, joints, sides and weights, each (k,)
Candidates = tuple[Array, Indices, Array, Array]


@dataclass(frozen=True, eq=False)
class TorquePeaks:
    """Instants at which one joint's torque is locally largest."""

    t: Array  # instants, shape (k,) [s]
    joint: Indices
    side: Array  # 0, or the sign of velocity where the joint turns back
    weight: Array  # 1, but less where the joint only almost turns
    use: Array  # weighted magnitude over the torque bound

    def above(self, share: float) -> TorquePeaks:
        """Those whose use exceeds a share."""
        k = self.use > share
        return TorquePeaks(*(part[k] for part in vars(self).values()))

    def motion(self, problem: DesignProblem, z: Array) -> Motion:
        """The motion at the instants, creeping where it turns."""
        q, dq, ddq = (basis @ z for basis in problem.bases(self.t))
        turning = np.flatnonzero(self.side)
        dq[turning, self.joint[turning]] = _CREEP * self.side[turning]
        return Motion(self.t, q, dq, ddq)


def torque_peaks(problem: DesignProblem, z: Array) -> TorquePeaks:
    """Peaks of every joint's torque along a trajectory, located between samples by a parabola."""
    motion = Motion(
        problem.instants, *(basis @ z for basis in problem.grid_bases[:3])
    )
    tau = largest_torque(problem.robot, motion)
    if not problem.robot.effects:
        candidates = [_smooth_peaks(problem, z, tau, 0.0)]
    else:
        jump = _jump(problem.robot, motion)
        candidates = [
            _turns(problem, z, motion.dq),
            _almost_turns(problem, z, motion.dq),
        ]
        for way in (1.0, -1.0):
            one_way = tau + way * jump * (way * motion.dq < 0)
            candidates.append(_smooth_peaks(problem, z, one_way, way))
    parts = [np.concatenate(part) for part in zip(*candidates, strict=True)]
    t, joint, side, weight = (part[parts[-1] > 0] for part in parts)
    peaks = TorquePeaks(t, joint, side, weight, np.zeros(len(t)))
    worst = largest_torque(problem.robot, peaks.motion(problem, z))[
        np.arange(len(t)), joint
    ]
    return replace(peaks, use=weight * np.abs(worst) / problem.torque_bound[joint])


def _jump(robot: Robot, motion: Motion) -> Array:
    """Jump of a joint's torque if it turned to the positive side, shape (n, nv)."""
    jump = np.zeros_like(motion.q)
    for side in (1.0, -1.0):
        creeping = Motion(
            motion.t, motion.q, np.full_like(jump, side * _CREEP), motion.ddq
        )
        for effect in robot.effects:
            jump += side * effect.torque(robot, creeping)
    return jump


def _smooth_peaks(
    problem: DesignProblem, z: Array, tau: Array, side: float
) -> Candidates:
    """Peaks with friction as if every joint moved to this side; else they count if it is slow."""
    use = np.abs(tau) / problem.torque_bound
    before, after = _beside(use)
    k, joint = np.nonzero((use >= before) & (use > after))
    rise = after[k, joint] - before[k, joint]
    bend = before[k, joint] - 2 * use[k, joint] + after[k, joint]
    shift = np.clip(-0.5 * rise / np.minimum(bend, -1e-300), -0.5, 0.5)
    t = problem.instants[k] + shift * problem.period / len(use)
    along = side * _own(problem, z, t, joint, 1)
    weight = np.clip(1 + along / _slow_speed(problem.robot)[joint], 0.0, 1.0)
    return t, joint, np.where(along < 0, side, 0.0), weight


def _turns(problem: DesignProblem, z: Array, dq: Array) -> Candidates:
    """Both sides of every turn, the start of the period among them."""
    n, nv = dq.shape
    following = np.roll(dq, -1, axis=0)
    k, joint = np.nonzero(dq * following < 0)
    share = dq[k, joint] / (dq[k, joint] - following[k, joint])
    t = _polished(problem, z, (k + share) * problem.period / n, joint, 1)
    t = np.append(t, np.zeros(nv))
    joint = np.append(joint, np.arange(nv))
    side = np.repeat([1.0, -1.0], len(t))
    return np.tile(t, 2), np.tile(joint, 2), side, np.ones(len(side))


def _almost_turns(problem: DesignProblem, z: Array, dq: Array) -> Candidates:
    """The other side where a joint is slow: at the samples, and where it is slowest."""
    size = np.abs(dq)
    n = len(dq)
    before, after = _beside(dq)
    slowest = (size <= np.abs(before)) & (size < np.abs(after))
    k, joint = np.nonzero(slowest & (dq * before > 0) & (dq * after > 0))
    t = _polished(problem, z, k * problem.period / n, joint, 2)
    slow = np.nonzero(size < _slow_speed(problem.robot))
    k = np.append(k, slow[0])
    joint = np.append(joint, slow[1])
    t = np.append(t, problem.instants[slow[0]])
    side = -np.sign(dq[k, joint])
    # below 0 it turns twice between two samples
    short = -side * _own(problem, z, t, joint, 1)
    return (
        t,
        joint,
        side,
        np.clip(1 - short / _slow_speed(problem.robot)[joint], 0.0, 1.0),
    )


def _beside(values: Array) -> tuple[Array, Array]:
    """Values at the instants before and after each, over a period."""
    return np.roll(values, 1, axis=0), np.roll(values, -1, axis=0)


def _slow_speed(robot: Robot) -> Array:
    return _SLOW * robot.limits.usual_speed


def _polished(
    problem: DesignProblem, z: Array, t: Array, joint: Indices, order: int
) -> Array:
    """Instants moved by Newton's method to zeros of a derivative, less than a grid step."""
    spacing = problem.period / len(problem.instants)
    for _ in range(2):
        value, slope = (_own(problem, z, t, joint, order + k) for k in (0, 1))
        step = np.divide(value, slope, out=np.zeros_like(value), where=slope != 0.0)
        t = t - np.clip(step, -spacing, spacing)
    return t


def _own(
    problem: DesignProblem, z: Array, t: Array, joint: Indices, order: int
) -> Array:
    return np.einsum("kd,kd->k", problem.basis(t, order), z[:, joint].T)


def torque_rows(
    problem: DesignProblem, z: Array, share: float
) -> tuple[Array, Array]:
    """Derivatives of the use at peaks above a share, shape (m, unknowns), and the use, (m,)."""
    peaks = torque_peaks(problem, z).above(share)
    joint = peaks.joint
    m = np.arange(len(peaks.t))
    motion = peaks.motion(problem, z)
    bases = problem.bases(peaks.t)
    tau, *parts = torque_derivatives(problem.robot, motion, joint)
    sign = np.sign(tau[m, joint]) / problem.torque_bound[joint]
    rows = np.zeros((len(m), *z.shape))
    jerk = problem.basis(peaks.t, 3) @ z
    rate = np.zeros(len(m))
    for phi, D, speed in zip(
        bases, parts, (motion.dq, motion.ddq, jerk), strict=True
    ):
        rows += phi[:, :, None] * D[m, joint][:, None, :]
        rate += np.einsum("kj,kj->k", D[m, joint], speed)
    rows[m, :, joint] -= bases[1] * _delay(peaks, motion, rate)[:, None]
    v = np.einsum("kd,kd->k", bases[1], z[:, joint].T)
    growth = np.where(
        peaks.weight < 1, -np.sign(v) / _slow_speed(problem.robot)[joint], 0.0
    )
    rows *= peaks.weight[:, None, None]
    rows[m, :, joint] += bases[1] * (tau[m, joint] * growth)[:, None]
    use = tau[m, joint] * sign * peaks.weight
    return rows.reshape(len(m), problem.size) * sign[:, None], use


def _delay(peaks: TorquePeaks, motion: Motion, rate: Array) -> Array:
    """Change of torque per change of velocity at a turn, which that velocity moves in time."""
    a = motion.ddq[np.arange(len(motion)), peaks.joint]
    still = np.abs(a) <= _STILL * np.abs(motion.ddq).max(initial=0.0)
    moving = (peaks.side != 0) & (peaks.weight == 1) & ~still
    return np.divide(rate, a, out=np.zeros_like(a), where=moving)


def torque_derivatives(
    robot: Robot, motion: Motion, joint: Indices
) -> tuple[Array, Array, Array, Array]:
    """Largest torque, shape (n, nv), and its derivatives by q, q̇, q̈, (n, nv, nv), torque first.

    Within the uncertainty of the masses that of ``joint[k]`` is to be the largest at instant k.
    """
    if robot.limits.mass_uncertainty == 0:
        D = np.stack(rigid_derivatives(robot, motion))
    else:
        D = np.empty((3, len(motion), robot.nv, robot.nv))
        for k, body in enumerate(_worst_bodies(robot, motion, joint)):
            D[:, [k]] = rigid_derivatives(body, motion[k : k + 1])
    if robot.effects:
        D += _effect_derivatives(robot, motion)
    return largest_torque(robot, motion), D[0], D[1], D[2]


def _worst_bodies(robot: Robot, motion: Motion, joint: Indices) -> list[Robot]:
    """The arm with the masses that make ``joint[k]``'s torque at instant k largest."""
    k = np.arange(len(motion))
    total = torque(robot, motion)[k, joint]
    way = (
        np.sign(link_torques(robot, motion)[k, joint])
        * np.where(total < 0, -1, 1)[:, None]
    )
    shares = 1 + robot.limits.mass_uncertainty * way
    return [
        robot.with_parameters(robot.phi * np.repeat(share, 10)) for share in shares
    ]


def _effect_derivatives(robot: Robot, motion: Motion) -> Array:
    n, nv = motion.q.shape
    D = np.zeros((3, n, nv, nv))
    own = [effect for effect in robot.effects if effect.law is not None]
    others = [effect for effect in robot.effects if effect.law is None]
    joints = np.arange(nv)
    for order in range(3):
        D[order][:, joints, joints] = _difference(
            robot, own, motion, order, np.ones(nv)
        )
        if others:
            for j, unit in enumerate(np.eye(nv)):
                D[order, :, :, j] += _difference(robot, others, motion, order, unit)
    return D


def _difference(
    robot: Robot, effects: Sequence[Effect], motion: Motion, order: int, way: Array
) -> Array:
    """Derivative of the effects' torque along a way of q, q̇ or q̈, shape (n, nv)."""
    change = np.zeros((3, *motion.q.shape))
    change[order] = _STEP * way
    state = np.stack([motion.q, motion.dq, motion.ddq])
    ahead, behind = (
        Motion(motion.t, *(state + sign * change)) for sign in (1.0, -1.0)
    )
    total = np.zeros(motion.q.shape)
    for effect in effects:
        total += effect.torque(robot, ahead) - effect.torque(robot, behind)
    return total / (2 * _STEP)


def worst_use(problem: DesignProblem, z: Array) -> float:
    """Worst use of the torque bounds at the peaks, and of the clearance at the grid's instants."""
    apart = pose_use(
        problem.scene, problem.required, problem.grid_bases[0] @ z
    ).max()
    return max(float(torque_peaks(problem, z).use.max(initial=0.0)), float(apart))


def clearance_rows(
    problem: DesignProblem, z: Array, near: float
) -> tuple[Array, Array]:
    """Derivatives (m, unknowns) of the clearance's use above ``near``, and the use, (m,)."""
    if problem.scene is None:
        return np.zeros((0, problem.size)), np.zeros(0)
    q = problem.grid_bases[0] @ z
    distance = problem.scene.distances(q)
    use = 1 + (problem.required - distance) / SCALE
    before, after = _beside(distance)
    rows = []
    uses = []
    for k, pair in np.argwhere(
        (distance <= before) & (distance < after) & (use > near)
    ):
        _, gradient = problem.scene.gradient(q[k], int(pair))
        rows.append(-np.outer(problem.grid_bases[0][k], gradient).ravel() / SCALE)
        uses.append(use[k, pair])
    return np.reshape(rows, (-1, problem.size)), np.array(uses)
