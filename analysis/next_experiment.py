"""What would make a parameter visible: candidate experiments, tried one by one on paper.

Every candidate adds rows to the observation matrix: a joint moves that rested, the base is
tilted, a sensor is put under it. Whether a parameter shows then is read from the rank and the
standard deviations of all rows together, never from a rule.

A known payload is no candidate where torque is in N·m: it adds known torque and no row that the
last link's own columns do not have already. Where torque comes as current, the common scale of
all drive gains is one more unknown, and a known payload is what shows it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pinocchio as pin

from excitant.analysis.uncertainty import ROUGHLY, deviations, listed, triangle
from excitant.identify.prior import reference_motion
from excitant.robots.effects import Effect
from excitant.robots.motion import Array, Motion
from excitant.robots.robot import Robot
from excitant.robots.torque import effect_values, observation_columns

_DURATION, _RATE_HZ = 10.0, 20.0  # of what is added
_RESTS = 0.01  # rad or m: a joint that moves less than this rests
_REPEATS = 10.0  # longest recording worth proposing, in lengths of the given one
PAYLOAD_KG = 1.0  # at the last joint's frame, where a known payload is tried
_SENSOR_NOISE = 0.01  # of the largest force and torque that the base sensor sees

NEVER = "never by joint torques"
APART = f"{NEVER} or base forces: weigh or swing the link apart from the arm"


def resting_joints(q: Array) -> tuple[int, ...]:
    """Joints whose positions, shape (n, nv), do not change."""
    return tuple(int(j) for j in np.flatnonzero(np.ptp(q, axis=0) < _RESTS))


def candidate_experiments(
    robot: Robot,
    effects: Sequence[Effect],
    sigma: Array,
    rests: Sequence[int],
    pose: Array,
    measured: Sequence[int],
) -> dict[str, Array]:
    """Experiments that could be added, the easiest first.

    Args:
        robot: The arm.
        effects: Effects whose coefficients are unknown too.
        sigma: Torque noise of each joint, shape (nv,) [N·m].
        rests: Joints that rested so far.
        pose: Where they rest, shape (nv,) [rad or m].
        measured: Joints whose torque is measured.

    Returns:
        By words that complete "shown by ...", the factor of the whitened rows, shape (p, p).
    """
    every_joint = reference_motion(robot, _DURATION, _RATE_HZ)

    def factor(arm: Robot, motion: Motion = every_joint, others: Sequence[int] = ()) -> Array:
        rows = [*measured, *others]
        return triangle(observation_columns(arm, effects, motion)[:, rows], sigma[rows])

    found = {}
    for j in rests:
        held = _holding(every_joint, [k for k in rests if k != j], pose)
        found[f"moving {robot.joints[j]}, which rests"] = factor(robot, held)
    if len(rests) > 1:
        found[f"moving {listed([robot.joints[j] for j in rests])} together"] = factor(robot)
    elif not rests:
        found["a wider and faster motion of all joints"] = factor(robot)
    for j, name in enumerate(robot.joints):
        if j not in measured:
            found[f"measuring the torque of {name}"] = factor(robot, others=[j])
    sensor = f"{NEVER}; by a force and torque sensor under the base"
    tilts, others = _tilts(robot), sum(len(effect.parameters(robot)) for effect in effects)
    found |= {f"the base {how}": factor(arm) for how, arm in tilts}
    found[sensor] = base_sensor(robot, every_joint, others)
    return found | {f"{sensor}, {how}": base_sensor(arm, every_joint, others) for how, arm in tilts}


def _tilts(robot: Robot) -> list[tuple[str, Robot]]:
    """The arm with its base tilted by 90° about each axis of the base that tilts gravity."""
    g, found = robot.gravity, []
    for name, axis in zip("xyz", np.eye(3), strict=True):
        turned = np.cross(axis, g) + axis * (axis @ g)
        if np.linalg.norm(turned - g) > 1e-6:
            found.append((f"tilted by 90° about its {name} axis", robot.with_gravity(turned)))
    return found


def _holding(motion: Motion, rests: Sequence[int], pose: Array) -> Motion:
    """The motion with some joints held where a pose has them."""
    q, dq, ddq = (np.array(values) for values in (motion.q, motion.dq, motion.ddq))
    q[:, list(rests)] = pose[list(rests)]
    dq[:, list(rests)] = ddq[:, list(rests)] = 0.0
    return Motion(motion.t, q, dq, ddq)


def base_wrench_columns(robot: Robot, motion: Motion) -> Array:
    """Force and torque on the base per unit of each standard parameter, shape (n, 6, 10 nv).

    In the base frame, force before torque [N, N·m]; the sum over links of what each body of
    inertia I under acceleration a and velocity v asks for, I (a − g) + v ×* I v.
    """
    model, data = robot.model, robot.model.createData()
    columns = np.empty((len(motion), 6, 10 * robot.nv))
    for k in range(len(motion)):
        pin.forwardKinematics(model, data, motion.q[k], motion.dq[k], motion.ddq[k])
        for j in range(1, robot.nv + 1):
            a = data.a[j] - data.oMi[j].actInv(model.gravity)
            body = pin.bodyRegressor(data.v[j], a)
            columns[k, :, 10 * j - 10 : 10 * j] = data.oMi[j].toDualActionMatrix() @ body
    return columns


def base_sensor(robot: Robot, motion: Motion, others: int) -> Array:
    """Factor of the whitened rows of a sensor under the base, effects' columns zero.

    Args:
        robot: The arm.
        motion: What it does.
        others: Number of the effects' columns.
    """
    W = base_wrench_columns(robot, motion)
    largest = np.abs(W @ robot.phi).max(axis=0)
    floor = 1e-3 * max(float(largest.max()), 1e-3)
    sigma = _SENSOR_NOISE * np.maximum(largest, floor)
    return triangle(np.pad(W, ((0, 0), (0, 0), (0, others))), sigma)


def experiments_needed(
    R: Array, A: Array, size: Array, candidates: Mapping[str, Array]
) -> tuple[str, ...]:
    """What would show each of m combinations of parameters; empty where it is shown already.

    The first candidate that shows it to 30 %, else the first that shows it at all.

    Args:
        R: Factor of the whitened rows so far, shape (rows, p).
        A: Combinations, shape (m, p).
        size: Value of each, to which its standard deviation is compared, shape (m,); 0 if
            showing it at all is enough.
        candidates: Factors of experiments that could be added, the easiest first.
    """
    enough = np.where(size == 0, np.inf, ROUGHLY * np.abs(size))
    now = deviations(R, A)
    tried = {what: deviations(np.vstack([R, more]), A) for what, more in candidates.items()}
    answers = []
    for k, (std, limit) in enumerate(zip(now, enough, strict=True)):
        some = [what for what, with_it in tried.items() if np.isfinite(with_it[k])]
        good = [what for what in some if tried[what][k] <= limit]
        times = (std / limit) ** 2 if np.isfinite(std) else np.inf
        if np.isfinite(std) and std <= limit:
            answers.append("")
        elif times <= _REPEATS:
            answers.append(f"about {int(np.ceil(times))} times as much of this motion")
        elif good:
            answers.append(good[0])
        elif np.isfinite(std):
            answers.append("less torque noise: too small beside it in any motion tried")
        else:
            answers.append(f"{some[0]}, and then roughly" if some else APART)
    return tuple(answers)


def known_values(robot: Robot, effects: Sequence[Effect]) -> tuple[Array, list[bool]]:
    """Values of all parameters, zero where not known, and which are known, each of shape (p,)."""
    known = effect_values(robot)
    names = [p.name for effect in effects for p in effect.parameters(robot)]
    x = np.concatenate([robot.phi, [known.get(name, 0.0) for name in names]])
    return x, [True] * len(robot.phi) + [name in known for name in names]


def scale_deviation(robot: Robot, effects: Sequence[Effect], sigma: Array) -> float:
    """Relative standard deviation of the drive gains' common scale κ, once a payload is known.

    With readings i = W (φ + φ_L) where the payload φ_L is on, W φ where it is off, a change δκ is
    seen as W δφ − i δκ. Without the payload δφ = φ δκ changes nothing; with it, W φ_L does.

    Args:
        robot: The arm.
        effects: Effects whose coefficients are unknown too.
        sigma: Noise of each joint, shape (nv,) [N·m].
    """
    motion = reference_motion(robot, _DURATION, _RATE_HZ)
    W = observation_columns(robot, effects, motion)
    load = np.zeros(W.shape[2])
    load[10 * robot.nv - 10] = PAYLOAD_KG
    x = known_values(robot, effects)[0]
    rows = [np.concatenate([W, -(W @ values)[:, :, None]], axis=2) for values in (x, x + load)]
    R = triangle(np.concatenate(rows), sigma)
    return float(deviations(R, np.eye(len(load) + 1)[-1:])[0])
