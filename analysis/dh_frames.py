"""Denavit-Hartenberg frames of the links of any serial arm."""

from __future__ import annotations

import numpy as np

from excitant.exceptions import BadInput
from excitant.robots.motion import Array
from excitant.robots.robot import Robot

PARALLEL = 1e-6  # sine of an angle, or distance [m], that counts as none


def distal_frames(robot: Robot) -> Array:
    """Pose of each link's standard Denavit-Hartenberg frame in its joint frame, (nv, 4, 4).

    Frame i is on the axis of joint i + 1 where that is nearest to the axis of joint i, with x along
    the common normal; for the last link, on the z axis of the tool. What the axes leave open is as
    the description places the next joint, so that an arm given in this form has its own frames.

    Raises:
        BadInput: An arm that branches.
    """
    model = robot.model
    nv = robot.nv
    if list(model.parents)[1:] != list(range(nv)):
        raise BadInput(
            f"{robot.name} branches: Denavit-Hartenberg frames are those of one chain"
        )
    motions = [
        np.reshape(joint.createData().S, 6) for joint in list(model.joints)[1:]
    ]
    own = [
        s[3:] if turns else s[:3]
        for s, turns in zip(motions, robot.revolute, strict=True)
    ]
    places = [
        *list(model.jointPlacements)[2:],
        list(model.frames)[robot.tip].placement,
    ]
    frames = np.tile(np.eye(4), (nv, 1, 1))
    for T, place, here, beyond in zip(
        frames, places, own, [*own[1:], np.eye(3)[2]], strict=True
    ):
        z = place.rotation @ beyond
        point = place.translation
        across = np.cross(here, z)
        x = place.rotation[:, int(np.argmin(np.abs(beyond)))]
        if np.linalg.norm(across) > PARALLEL:
            steps = np.linalg.solve(np.column_stack([here, -z, across]), point)
            point = point + steps[1] * z
            normal = across
        else:
            normal = point - here * (here @ point)
        if np.linalg.norm(normal) > PARALLEL:
            x = normal if normal @ x >= 0 else -normal
        x = x - z * (z @ x)
        x = x / np.linalg.norm(x)
        T[:3] = np.column_stack([x, np.cross(z, x), z, point])
    return frames
