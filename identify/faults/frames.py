"""Inertias of the given model that stand for other frames than they are read in.

Tables of parameters by Denavit and Hartenberg's standard convention give each link's first moments
and inertia in its distal frame, at the next joint; a URDF or Craig's convention has them in the
proximal frame, at the link's own joint. Numbers of the one taken for the other are bodies that
could be, so that nothing but the torque tells.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import scipy.stats

from excitant.identify.faults.fault import ALARM, Fault
from excitant.identify.faults.physics import Torques
from excitant.robots.motion import Array
from excitant.robots.robot import Robot

_BETTER = 0.75  # of the error that the model leaves, summed over joints relative to their torque
_WORSE = 1.5  # times a joint's own error, at most
_EXPLAINED = 0.5  # of the torque's variance at half of the joints: the numbers then mean something


def wrong_frame(case: Torques) -> list[Fault]:
    """The given inertias, where they explain the torque only if read in the distal frames.

    Both readings get each joint's friction, offset, rotor inertia and a gain, so that neither the
    unit of torque nor what else the model lacks counts. Links are read alike: a table has one
    convention.
    """
    if (case.robot.phi[::10] <= 0).any():
        return []  # links without mass say nothing
    as_read, moved = (_left(case, phi) for phi in (case.robot.phi, in_joint_frames(case.robot)))
    joints, size = case.joints, case.problem.c.tau.var(axis=0)
    before, after = (np.sqrt(left / np.maximum(size, 1e-300))[joints] for left in (as_read, moved))
    gain = float((case.rows * np.log(as_read / moved))[joints].sum())
    clear = gain > scipy.stats.chi2.isf(ALARM, 1) and after.sum() < _BETTER * before.sum()
    if not clear or (after > _WORSE * before).any() or np.median(after**2) > 1 - _EXPLAINED:
        return []
    best = joints[int(np.argmin(after / before))]
    return [
        Fault(
            "wrong_frame",
            case.log.joints,
            f"the inertias of the given model are those about the distal frames, at the next "
            f"joints: read so, the error of the model with friction falls to "
            f"{100 * after.sum() / before.sum():.2g} % over all joints and to "
            f"{100 * np.sqrt(moved[best] / as_read[best]):.2g} % at {case.log.joints[best]} "
            f"(likelihood ratio {gain:.3g}); move them to the joints' frames in the robot's file",
            {"nrmse_as_read": before, "nrmse_moved": after, "gain": gain},
        )
    ]


def in_joint_frames(robot: Robot) -> Array:
    """Standard parameters in the joints' frames, those given being in the distal ones, (10 nv,)."""
    bodies = (place.act(body) for place, body in _placed(robot))
    return np.concatenate([body.toDynamicParameters() for body in bodies])


def in_distal_frames(robot: Robot) -> Array:
    """Standard parameters of the links in their distal frames, shape (10 nv,)."""
    bodies = (place.actInv(body) for place, body in _placed(robot))
    return np.concatenate([body.toDynamicParameters() for body in bodies])


def _placed(robot: Robot) -> list[tuple[Any, Any]]:
    """Distal frame of each link in its joint's frame, and its inertia, both Pinocchio's."""
    model = robot.model
    places = [model.jointPlacements[j + 1] for j in range(1, robot.nv)]
    places.append(model.frames[robot.tip].placement)
    values = robot.phi.reshape(robot.nv, 10)
    bodies = [pin.Inertia.FromDynamicParameters(each) for each in values]
    return list(zip(places, bodies, strict=True))


def _left(case: Torques, phi: Array) -> Array:
    """Mean square of what a model and each joint's own effects leave, shape (nv,)."""
    c = case.problem.c
    torque = (c.G + c.D) @ phi
    left = np.ones(len(case.log.joints))
    for j in case.joints:
        X = np.column_stack([torque[:, j], c.F[:, j]])
        size = np.sqrt((X**2).mean(axis=0))
        X = X / np.where(size > 0, size, 1.0)
        error = c.tau[:, j] - X @ np.linalg.lstsq(X, c.tau[:, j], rcond=1e-10)[0]
        left[j] = max(float((error**2).mean()), 1e-12 * float(case.problem.size[j]))
    return left
