"""Laws of the regressor and of its derivatives."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from excitant.robots import Motion, Robot, regressor, regressor_derivatives, rigid_body_torque

States = Callable[[Robot, int, int], Motion]
Bodies = Callable[[int, int], np.ndarray]

RELATIVE = 1e-8
STENCIL = {1: 4 / 5, 2: -1 / 5, 3: 4 / 105, 4: -1 / 280}
"""Weights of the central difference of eighth order: error h⁸ f⁽⁹⁾ / 630 ≈ 1e-12 at h = 0.05."""


def close(left: np.ndarray, right: np.ndarray, relative: float = RELATIVE) -> bool:
    return bool(np.abs(left - right).max() <= relative * np.abs(right).max())


def finite_difference(robot: Robot, motion: Motion, by: str, joint: int) -> np.ndarray:
    h, total = 0.05, np.zeros((len(motion), robot.nv, 10 * robot.nv))
    for steps, weight in STENCIL.items():
        for sign in (1, -1):
            states = {name: np.array(getattr(motion, name)) for name in ("q", "dq", "ddq")}
            states[by][:, joint] += sign * steps * h
            total += sign * weight / h * regressor(robot, Motion(motion.t, **states))
    return total


@given(seed=st.integers(0, 2**32 - 1))
def test_regressor_times_parameters_is_newton_euler(
    arm: Robot, random_states: States, random_bodies: Bodies, seed: int
) -> None:
    motion = random_states(arm, seed, 5)
    other = arm.with_parameters(random_bodies(seed, arm.nv))
    for robot in (arm, other):
        assert close(regressor(robot, motion) @ robot.phi, rigid_body_torque(robot, motion))


@pytest.mark.parametrize("by", ["q", "dq", "ddq"])
def test_derivatives_are_those_of_finite_differences(
    arm: Robot, random_states: States, by: str
) -> None:
    motion = random_states(arm, 3, 4)
    derivative = getattr(regressor_derivatives(arm, motion), f"by_{by}")
    for joint in range(arm.nv):
        expected = finite_difference(arm, motion, by, joint)
        assert np.abs(derivative[joint] - expected).max() <= RELATIVE * np.abs(derivative).max()


@given(seed=st.integers(0, 2**32 - 1))
def test_derivatives_contract_to_those_of_the_torque(
    arm: Robot, random_states: States, seed: int
) -> None:
    motion, data = random_states(arm, seed, 3), arm.model.createData()
    d = regressor_derivatives(arm, motion)
    assert np.array_equal(d.Y, regressor(arm, motion))
    for k in range(len(motion)):
        state = (motion.q[k], motion.dq[k], motion.ddq[k])
        by_q, by_dq, by_ddq = pin.computeRNEADerivatives(arm.model, data, *state)
        for ours, theirs in ((d.by_q, by_q), (d.by_dq, by_dq), (d.by_ddq, by_ddq)):
            assert close((ours[:, k] @ arm.phi).T, np.array(theirs))
