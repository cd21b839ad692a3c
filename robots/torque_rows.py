"""Whose torque contains which parameter: what identification from the last link inward rests on."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from excitant.robots.base_parameters import BaseParameters
from excitant.robots.effects import Effect
from excitant.robots.motion import Motion
from excitant.robots.robot import Robot
from excitant.robots.torque import observation_columns

_STATES = 100
_TOLERANCE = 1e-10  # of a column's largest entry


def last_rows(
    robot: Robot, effects: Sequence[Effect], base: BaseParameters
) -> npt.NDArray[np.intp]:
    """The last joint whose torque contains each base parameter, shape (r,).

    By Property 4 of Khosla (1987) no torque of a joint contains links before it. A base parameter
    counts for the first link it can be written with, so this is that link's joint: what the
    torque of joint i can show of it, once the links further out are known, are the base
    parameters whose last row is i.
    """
    q, dq, ddq = robot.random_motion(np.random.default_rng(1), _STATES)
    W = observation_columns(robot, effects, Motion(np.arange(float(_STATES)), q, dq, ddq))
    size = np.abs(W[:, :, list(base.columns)]).max(axis=0)
    present = size > _TOLERANCE * size.max(axis=0)
    return np.asarray(robot.nv - 1 - np.argmax(present[::-1], axis=0), np.intp)
