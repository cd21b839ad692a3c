"""Lengths that are assumed: what is said of parameters and torque holds for other lengths."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pinocchio as pin
import pytest
from plant_recordings import displaced

from excitant.design import random_trajectory
from excitant.exceptions import BadInput
from excitant.identify import Estimate, Recording, identify_robot, recording_from_table
from excitant.identify.accuracy import torque_std
from excitant.identify.least_squares import LeastSquares
from excitant.identify.lengths import LengthErrors, length_deviations
from excitant.identify.preprocessing import certain_rows
from excitant.identify.regression import regression_of
from excitant.robots import Robot, load_robot
from excitant.robots.effects import standard_effects
from excitant.robots.plant.planting import HiddenEffect
from excitant.robots.plant.sensors import Run
from excitant.robots.regressor import rigid_body_torque
from excitant.robots.virtual_arm import VirtualArm, industrial_sensors, virtual_arm

STD = 0.005  # m


def of_other_lengths(robot: Robot, rng: np.random.Generator) -> VirtualArm:
    """An arm whose joints sit elsewhere, drawn from what is allowed for."""
    shifts = rng.normal(scale=STD, size=(robot.nv, 3))
    moved = [
        HiddenEffect("kinematic_error", joint, tuple(zip(("dx", "dy", "dz"), d, strict=True)))
        for joint, d in zip(robot.joints, shifts.tolist(), strict=True)
    ]
    return virtual_arm(robot, rng, hidden=moved, sensors=industrial_sensors(robot))


def recorded(arm: VirtualArm, rng: np.random.Generator) -> Recording:
    """A motion that is followed exactly, its torque by Newton and Euler, behind noisy sensors."""
    path, t = random_trajectory(arm.nominal, rng, 10.0, 5), np.arange(0, 10, 0.004)
    q, dq, ddq = (path(t, order) for order in range(3))
    model, data = arm.truth.model, arm.truth.model.createData()
    states = zip(q, dq, ddq, strict=True)
    tau = arm.truth.drives.friction(dq) + [pin.rnea(model, data, *x) for x in states]
    table = arm.recorded(Run(t, q, dq, tau, q), rng)
    return recording_from_table(table, arm.nominal.nv, file="run.csv", name="run")


def true_base(estimate: Estimate, arm: VirtualArm) -> np.ndarray:
    """True base parameters, grouped with the lengths that the model has."""
    bodies = [body.toDynamicParameters() for body in list(arm.truth.model.inertias)[1:]]
    effects = standard_effects(arm.nominal.joints)
    drives = [getattr(arm.truth.drives, effect.export.joint_property) for effect in effects]
    return estimate.base.regrouping @ np.concatenate([*bodies, *drives])


@pytest.fixture(scope="module")
def run(planar: Robot) -> Recording:
    rng = np.random.default_rng(3)
    return recorded(of_other_lengths(planar, rng), rng)


@pytest.fixture(scope="module")
def found(planar: Robot, run: Recording) -> Estimate:
    return identify_robot(planar, [run], length_std=[0.0, STD])


def test_the_covariance_is_that_of_the_whole_matrix(planar: Robot, found: Estimate) -> None:
    """A⁻¹ Wᵀ (Γ + J S Jᵀ) W A⁻¹ with rows by rows, J by moving the joint of another arm."""
    lengths, step = found.lengths, 1e-4
    model, data = lengths.model, found.data.train
    used = certain_rows(found.model.effects, planar.joints, data)
    W = regression_of(planar, found.model.effects, data).select(found.base.columns).counting(used)
    n = 120  # rows at which the matrix is held
    place = slice(None, None, len(W) // n)
    J = np.stack(
        [
            sum(
                sign
                * np.concatenate(
                    [
                        s.rows(lambda m, d=d: rigid_body_torque(displaced(model, 1, d), m))
                        for s in data
                    ]
                )
                for sign, d in ((1, step * axis), (-1, -step * axis))
            )
            / (2 * step)
            for axis in np.eye(3)
        ],
        axis=2,
    )
    weight = 1 / found.least_squares.sigma**2
    A = np.einsum("njr,j,njs->rs", W.W, weight, W.W)
    G = np.linalg.solve(A, np.einsum("njr,j,njk->rk", W.W, weight, J))  # W is zero elsewhere
    expected = STD**2 * G @ G.T
    np.testing.assert_allclose(lengths.base @ lengths.base.T, expected, rtol=1e-5, atol=1e-12)
    total = lengths.by_noise + expected
    np.testing.assert_allclose(found.least_squares.covariance, total, rtol=1e-5, atol=1e-12)
    np.testing.assert_allclose(lengths.columns(data)[place, :, 3:], STD * J[place], atol=1e-8)
    assert not lengths.columns(data)[:, :, :3].any()  # of no deviation


def test_values_stay_and_deviations_widen(planar: Robot, run: Recording, found: Estimate) -> None:
    without = identify_robot(planar, [run])
    assert without.lengths is None
    np.testing.assert_array_equal(found.least_squares.beta, without.least_squares.beta)
    np.testing.assert_array_equal(found.physical.x, without.physical.x)
    noise = np.sqrt(np.diag(found.lengths.by_noise))
    assert (noise <= 1.001 * without.base_std).all()  # lengths are no noise any more
    assert (found.base_std >= noise).all()
    assert (found.std >= without.std * (1 - 1e-12)).all()
    assert np.max(found.lengths.widening) > 2
    np.testing.assert_allclose(found.lengths.widening, found.base_std / noise)
    result = found.result()
    assert result["lengths"]["std"] == [0.0, STD]
    assert result["lengths"]["widening"]["largest"] == pytest.approx(found.lengths.widening.max())
    [said] = [note for note in result["notes"] if note.startswith("lengths are assumed")]
    assert "± 5 mm" in said
    assert "lengths" not in without.result()


def test_torque_that_parameters_stand_in_for_is_not_uncertain(planar: Robot) -> None:
    """Where W G = J, least squares takes up an error of lengths whatever it is."""
    rng = np.random.default_rng(0)
    W, G = rng.normal(size=(20, 2, 4)), rng.normal(size=(4, 6))
    nothing = np.zeros((4, 4))
    lengths = LengthErrors(np.ones(2), planar, G, G, nothing, np.zeros((20, 2)))
    J, other = W @ G, rng.normal(size=(20, 2, 6))
    fit = LeastSquares(np.zeros(4), nothing + G @ G.T, np.ones(2), np.ones(2))
    both = lengths.of_prediction(fit)
    np.testing.assert_allclose(torque_std(np.concatenate([W, J], axis=2), both), 0, atol=1e-6)
    left = np.linalg.norm(other - J, axis=2)
    np.testing.assert_allclose(torque_std(np.concatenate([W, other], axis=2), both), left)


@pytest.mark.slow
def test_intervals_hold_arms_of_other_lengths(planar: Robot) -> None:
    """95 % of parameters and readings within chance, as arms differ; far less without."""
    shares = np.empty((16, 3))
    for seed, row in enumerate(shares):
        rng = np.random.default_rng([seed, 7])
        arm = of_other_lengths(planar, rng)
        run, held = (recorded(arm, rng) for _ in range(2))
        for k, std in enumerate((0.0, STD)):
            found = identify_robot(planar, [run], validate=[held], length_std=std)
            error = np.abs(found.least_squares.beta - true_base(found, arm))
            row[k] = (error <= 1.96 * found.base_std).mean()
        error = np.abs(found.holdout.measured - found.predicted)
        row[2] = (error <= found.interval.half_width).mean()
    chance = 3 * shares.std(axis=0, ddof=1) / np.sqrt(len(shares))
    without, counted, readings = shares.mean(axis=0) - 0.95
    assert without < -chance[0], shares.mean(axis=0)
    assert np.abs(counted) < min(chance[1], 0.05), shares.mean(axis=0)
    assert np.abs(readings) < min(chance[2], 0.02), shares.mean(axis=0)


def test_robot_yaml_says_that_lengths_are_assumed(here: Path, planar: Robot) -> None:
    Path("arm.urdf").write_text(planar.urdf, "utf-8")
    Path("robot.yaml").write_text("model: arm.urdf\nlength_std: 0.002\n", "utf-8")
    assert load_robot("robot.yaml").length_std == 0.002
    assert load_robot("robot.yaml", joints=["joint1"]).length_std == 0.002
    Path("robot.yaml").write_text("model: arm.urdf\nlength_std: -1\n", "utf-8")
    with pytest.raises(BadInput, match="length_std"):
        load_robot("robot.yaml")


def test_what_the_robot_says_holds_unless_told_otherwise(planar: Robot, run: Recording) -> None:
    assumed = replace(planar, length_std=STD)
    said = identify_robot(assumed, [run])
    np.testing.assert_array_equal(said.lengths.std, [STD, STD])
    assert identify_robot(assumed, [run], length_std=0.0).lengths is None
    assert identify_robot(planar, [run], length_std=[STD, 0.0]).lengths is None  # nothing is moved


@pytest.mark.parametrize(
    ("std", "evidence"),
    [
        ([0.1, 0.1, 0.1], "3 numbers for 2 joints"),
        ([0.0, -0.1], "of joint2: -0.1 m"),
        (float("nan"), "nan m"),
        (float("inf"), "inf m"),
    ],
)
def test_what_is_no_deviation_is_refused(planar: Robot, std: Any, evidence: str) -> None:
    with pytest.raises(BadInput, match=evidence):
        length_deviations(std, planar)


def test_the_command_takes_it_for_all_rows_at_once(
    here: Path, excitant: Callable[..., Any], planar: Robot, run: Recording
) -> None:
    columns = {f"{n}{j + 1}": x[:, j] for n, x in run.channels() for j in range(run.nv)}
    pd.DataFrame({"t": run.t} | columns).to_csv("run.csv", index=False)
    done = excitant("identify planar_2r run.csv --length-std 0.005 --json")
    assert done.result["lengths"]["std"] == [STD, STD]
    Path("robot.yaml").write_text("model: arm.urdf\nlength_std: 0.002\n", "utf-8")
    Path("arm.urdf").write_text(planar.urdf, "utf-8")
    done = excitant("identify robot.yaml run.csv --online --json")
    assert any("length_std of the robot" in note for note in done.result["notes"])
    refused = excitant("identify planar_2r run.csv --length-std 0.005 --online")
    assert (refused.status, refused.err.count("\n")) == (1, 1)
    assert "--length-std" in refused.err
