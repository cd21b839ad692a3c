"""Torque that is a model's output, a model in other frames, motion that shows too little.

A column computed from planned or smoothed motion has no noise of its own, and rigid bodies with
plain friction explain nearly all of it, which they do for no drive. One computed from measured
motion has the noise of the differentiated positions. Denavit and Hartenberg's standard convention
gives inertia in the distal frame, at the next joint, a URDF at the link's own joint.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pinocchio as pin
import scipy

from excitant.exceptions import ExcitantError
from excitant.identify.excitation import persistency
from excitant.identify.faults.fault import ALARM, Fault, Log
from excitant.identify.faults.physics import Smooth, TorqueFit, scaled_least_squares
from excitant.identify.signals import quantum
from excitant.robots.motion import Array
from excitant.robots.robot import Robot

_MOST_JOINTS = 0.5  # of the joints: one that bears mainly weight proves nothing
_EXPLAINED = 0.5  # of a variance: most of it


def not_measured(case: TorqueFit) -> Iterator[Fault]:
    """Joints whose torque has no error of its own, and those whose noise is that of the motion."""
    log = case.log
    noise = {j: _own_noise(log.tau[:, j]) for j in case.joints}
    missed = np.sqrt(case.power) / np.maximum(case.tau.std(axis=0), 1e-100)
    span = np.ptp(log.tau, axis=0)
    # no drive is known to a hundredth of its torque, or as free of noise as to a thousandth
    ideal = [j for j in case.joints if noise[j] < 1e-3 * span[j] and missed[j] < 0.01]
    if len(ideal) > _MOST_JOINTS * len(case.joints):
        worst = max(ideal, key=lambda j: missed[j])
        names = log.names(ideal)
        own = [noise[j] for j in ideal]
        detail = (
            f"tau of {', '.join(names)} is the output of a model, not a measurement: rigid bodies "
            f"with viscous and Coulomb friction miss it by at most {100 * missed[worst]:.2f} % "
            f"of its spread ({log.joints[worst]}), and its own noise is at most {max(own):.1g} "
            f"{log.unit}"
        )
        evidence = {"missed": missed[ideal], "noise": own}
        yield Fault("not_measured", names, detail, evidence)
    derived = _derived(log, case.joints)
    if len(derived) > _MOST_JOINTS * len(case.joints):
        worst = max(derived, key=lambda j: derived[j])
        names = log.names(derived)
        detail = (
            f"tau of {', '.join(names)} is computed from the logged motion, not measured: up "
            f"to {100 * derived[worst]:.1f} % of the variance of its noise ({log.joints[worst]}) "
            f"is that of the differentiated positions and velocities"
        )
        evidence = {"explained": [*derived.values()]}
        yield Fault("not_measured", names, detail, evidence)


def _own_noise(x: Array) -> float:
    """White noise of a channel: what differences of rising order do not make smaller."""
    differences = [
        np.median(np.abs(np.diff(x, k)))
        / 0.6745
        / np.sqrt(scipy.special.comb(2 * k, k))
        for k in (4, 6, 8)
    ]
    return max(0.0, float(min(differences)) - quantum(x) / float(np.sqrt(12)))


def _derived(log: Log, joints: list[int]) -> dict[int, float]:
    """Joints whose noise, away from gaps, that of the accelerations explains, and its share."""
    accelerations = [np.gradient(np.gradient(log.q, log.t, axis=0), log.t, axis=0)]
    if log.dq is not None:
        accelerations.append(np.gradient(log.dq, log.t, axis=0))
    gaps = np.append(np.diff(log.t) > 1.5 * log.step, False)
    reach = 6  # rows of two gradients and four differences
    near = scipy.ndimage.binary_dilation(gaps, np.ones(2 * reach + 1, bool))
    regular = ~near[2 : len(log.t) - 2]
    rough = np.diff(np.column_stack(accelerations), 4, axis=0)[regular]
    if not len(rough):
        return {}
    size = np.sqrt((rough**2).mean(axis=0))
    rough = rough[:, size > 0] / size[size > 0]
    shares = {}
    for j in joints:
        y = np.diff(log.tau[:, j], 4)[regular]
        if len(y) < 20 * rough.shape[1] or not y.any():
            continue
        residual = y - rough @ np.linalg.lstsq(rough, y, rcond=None)[0]
        share = 1 - float((residual**2).sum() / (y**2).sum())
        if share > _EXPLAINED:
            shares[j] = share
    return shares


def wrong_frame(case: TorqueFit) -> Iterator[Fault]:
    """The nominal inertias, where they explain the torque only if all are in the distal frames.

    Both readings get each joint's friction, offset, rotor inertia and a gain.
    """
    if (case.robot.phi[::10] <= 0).any():
        return  # links without mass say nothing
    joints = case.joints
    variance = np.maximum(case.tau.var(axis=0)[joints], 1e-300)
    as_read = _unexplained(case, case.robot.phi)
    moved = _unexplained(case, in_joint_frames(case.robot))
    before = np.sqrt(as_read / variance)
    after = np.sqrt(moved / variance)
    gain = float((case.rows[joints] * np.log(as_read / moved)).sum())
    clear = gain > scipy.special.chdtri(1, ALARM)
    better = after.sum() < 0.75 * before.sum()
    worse = (after > 1.5 * before).any()
    if not (clear and better) or worse or np.median(after**2) > 1 - _EXPLAINED:
        return
    best = int(np.argmin(after / before))
    detail = (
        f"the inertias of the given model are those about the distal frames, at the next "
        f"joints: read so, the error of the model with friction falls to "
        f"{100 * after.sum() / before.sum():.2g} % over all joints and to "
        f"{100 * after[best] / before[best]:.2g} % at {case.log.joints[joints[best]]} "
        f"(likelihood ratio {gain:.3g}); move them to the joints' frames in the robot's file"
    )
    evidence = {"nrmse_as_read": before, "nrmse_moved": after, "gain": gain}
    yield Fault("wrong_frame", case.log.joints, detail, evidence)


def in_joint_frames(robot: Robot) -> Array:
    """Standard parameters in the joints' frames, those given being in the distal ones, (10 nv,)."""
    model = robot.model
    places = [model.jointPlacements[j + 1] for j in range(1, robot.nv)]
    places.append(model.frames[robot.tip].placement)
    moved = []
    for place, phi in zip(places, robot.phi.reshape(robot.nv, 10), strict=True):
        body = pin.Inertia.FromDynamicParameters(phi)
        moved.append(place.act(body).toDynamicParameters())
    return np.concatenate(moved)


def _unexplained(case: TorqueFit, phi: Array) -> Array:
    """Mean square that a model and each joint's own effects leave, of the joints that count."""
    torque = (case.G + case.D) @ phi
    squares = []
    for j in case.joints:
        columns = np.column_stack([torque[:, j], case.F[:, j]])
        error = scaled_least_squares(columns, case.tau[:, j])[2]
        squares.append(max(float((error**2).mean()), 1e-12 * float(case.size[j])))
    return np.array(squares)


def poor_excitation(robot: Robot, log: Log, data: Smooth | None) -> Iterator[Fault]:
    """Directions of the base parameters that the motion shows worse than they are known."""
    span = np.ptp(log.q, axis=0)
    still = span <= 50 * log.grain
    if data is None:
        if still.all() or not span.any():
            detail = f"no joint moves: positions vary by at most {span.max():.3g}"
            yield Fault("poor_excitation", log.joints, detail, {"span": span})
        return
    try:
        window = persistency(robot, data.motion)
    except ExcitantError:
        return  # the arm has no inertia to compare with
    least = (
        0.1  # of the prior's information: less makes nothing more certain by even 5 %
    )
    missing = int((window.levels < least).sum())
    if not missing:
        return
    visible = len(window.levels)
    lacking = tuple(j for j in log.joints if j in window.joints)
    resting = log.names(np.flatnonzero(still))
    names = lacking or resting or log.joints
    weakest = ", ".join(window.weak[0].parameters) if window.weak else "all"
    detail = (
        f"{missing} of {visible} directions of the parameters that such an arm can show "
        f"in this time get less than {least:g} of the information that the given model already "
        f"has, the weakest {window.level:.2g} ({weakest}); move {', '.join(names)}"
    )
    evidence = {
        "missing": missing,
        "visible": visible,
        "level": window.level,
        "still": resting,
    }
    yield Fault("poor_excitation", names, detail, evidence)
