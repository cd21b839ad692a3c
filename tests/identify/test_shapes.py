"""Shapes of effects, found with the bodies: what was planted, and nothing where nothing was."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from excitant.exceptions import BadInput
from excitant.identify import Recording, identify_robot
from excitant.identify.knowledge import Knowledge
from excitant.identify.least_squares import weighted_least_squares
from excitant.identify.physical import fit_physical
from excitant.identify.prior import EffectPrior, prior_parameters
from excitant.identify.rows import FitRows, fit_rows, split
from excitant.identify.shapes import Descent, from_log_cholesky, refined_shapes, to_log_cholesky
from excitant.robots import Array, Motion, Robot, base_parameters, load_robot
from excitant.robots.effects import (
    Effect,
    NonlinearViscousFriction,
    StribeckFriction,
    standard_effects,
)
from excitant.robots.parameters import isotropic, pseudo_inertia, violations
from excitant.robots.regressor import regressor

RATE = 200.0
BELL = (1.5, 0.8)  # N·m


def motion_at(t: np.ndarray, seed: int) -> Motion:
    rng = np.random.default_rng(seed)
    w, phase = (rng.uniform(*limits, (4, 1, 2)) for limits in ((0.3, 3.0), (0, 6.28)))
    parts = (
        (rng_size(seed) * w**k * np.sin(w * t[:, None] + phase + k * np.pi / 2)).sum(axis=0)
        for k in range(3)
    )
    return Motion(t, *parts)


def rng_size(seed: int) -> np.ndarray:
    return np.random.default_rng([seed, 1]).uniform(0.2, 0.5, (4, 1, 2))


def recorded(
    robot: Robot, seed: int, friction: Callable[[np.ndarray], np.ndarray], noise: float = 0.03
) -> Recording:
    """Recursive Newton-Euler; viscous, Coulomb and one more friction written here."""
    rng, t = np.random.default_rng(seed), np.arange(0, 25, 1 / RATE)
    motion, data = motion_at(t, seed), robot.model.createData()
    states = zip(motion.q, motion.dq, motion.ddq, strict=True)
    tau = np.array([pin.rnea(robot.model, data, *state) for state in states])
    tau += [0.8, 0.4] * motion.dq + [1.0, 0.5] * np.sign(motion.dq) + friction(motion.dq)
    return Recording(
        f"run{seed}", "run.csv", t, motion.q, tau + noise * rng.standard_normal(tau.shape)
    )


def stribeck(*speeds: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda dq: np.array(BELL) * np.exp(-((dq / np.array(speeds)) ** 2)) * np.sign(dq)


def rows_of(robot: Robot, run: Recording, further: Sequence[Effect]) -> FitRows:
    effects = (*standard_effects(robot.joints), *further)
    return fit_rows(robot, effects, base_parameters(robot, effects), split([run], [run], 10.0))


def test_planted_speeds_come_with_the_uncertainty_they_have(planar: Robot) -> None:
    """Each joint its own, from one value for both that is far from either."""
    truth, scores = np.array([0.06, 0.3]), []
    for seed in range(6):
        run = recorded(planar, seed, stribeck(*truth))
        rows = rows_of(planar, run, [StribeckFriction(planar.joints)])
        found = refined_shapes(rows, prior_parameters(planar), Knowledge())
        assert found is not None
        assert found.better
        assert [(s.joint, s.given, s.unit) for s in found.found] == [
            (joint, 0.1, "rad/s") for joint in planar.joints
        ]
        value, std = (np.array([getattr(s, k) for s in found.found]) for k in ("value", "std"))
        np.testing.assert_allclose(value, truth, rtol=0.1)
        assert (std < 0.05 * truth).all()
        scores.append((value - truth) / std)
    assert np.sqrt(np.mean(np.square(scores))) < 3


def test_shapes_that_are_right_stay(planar: Robot) -> None:
    kept = 0
    for seed in range(8):
        run = recorded(planar, seed, stribeck(0.1, 0.1))
        rows = rows_of(planar, run, [StribeckFriction(planar.joints)])
        found = refined_shapes(rows, prior_parameters(planar), Knowledge())
        assert found is not None
        assert found.after <= found.before + 1e-6 * found.before
        kept += not found.better
    assert kept >= 7


def test_without_such_effects_there_are_no_shapes(planar: Robot) -> None:
    rows = rows_of(planar, recorded(planar, 0, stribeck(0.1, 0.1)), [])
    assert refined_shapes(rows, prior_parameters(planar), Knowledge()) is None


def test_identify_predicts_better_with_them_and_says_so(
    planar: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    fit, held = (recorded(planar, seed, stribeck(0.04, 0.3)) for seed in (1, 2))
    effects = (*standard_effects(planar.joints), StribeckFriction(planar.joints))
    after = identify_robot(planar, [fit], validate=[held], effects=effects)
    monkeypatch.setattr("excitant.identify.estimate.refined_shapes", lambda *_: None)
    before = identify_robot(planar, [fit], validate=[held], effects=effects)
    assert (after.validate.rms < 0.5 * before.validate.rms).all()
    entry = after.result()["shapes"]
    assert entry["refined"]
    assert entry["objective"]["refined"] < entry["objective"]["given"]
    speeds = {e["joint"]: (e["value"], e["std"]) for e in entry["effects"]}
    in_model = {
        e.joints[0]: e.velocity for e in after.model.effects if isinstance(e, StribeckFriction)
    }
    assert in_model == {joint: value for joint, (value, _) in speeds.items()}
    assert any(note.startswith("shapes of effects refined") for note in after.notes)
    assert "shapes" not in before.result()
    names = [p["name"] for p in after.result()["parameters"]]
    assert names == [p["name"] for p in before.result()["parameters"]]


def test_what_shapes_leave_open_widens_the_rest(planar: Robot) -> None:
    """By as much as other fits move when the speed of a bell does, by its standard deviation."""
    run = recorded(planar, 1, stribeck(0.3, 0.3))
    rows = rows_of(planar, run, [StribeckFriction(planar.joints)])
    found = refined_shapes(rows, prior_parameters(planar), Knowledge())
    assert found is not None
    last, betas = found.found[1], []
    for change in (-1, 0, 1):
        other = found.effects[-1].reshaped(last.field, last.value + change * last.std)
        moved = replace(found, effects=(*found.effects[:-1], other)).rows(rows)
        betas.append(weighted_least_squares(moved.reduced))
    expected = (betas[2].beta - betas[0].beta) / 2
    widened = moved.base.regrouping @ found.spread
    own = [moved.base.expressions.index(name) for name in ("joint2.Fs", "joint2.Fc", "joint2.Fv")]
    both = np.array([expected[own], widened[own, 1]])
    assert (np.abs(both[0]) > 1e-4).all()
    np.testing.assert_allclose(both[1], both[0], rtol=0.2)
    fit = betas[1]
    R, z = moved.regression.factor(fit.weight)
    physical = fit_physical(R, z, prior_parameters(planar), moved.open_prior)
    wide, wide_physical = found.widened(fit, physical, moved.base)
    added = np.diag(wide.covariance - fit.covariance)
    np.testing.assert_allclose(added, (widened**2).sum(axis=1), rtol=1e-6, atol=1e-15)
    assert (np.diag(wide_physical.covariance - physical.covariance) >= 0).all()


@pytest.mark.parametrize("exponent", [0.4, 2.3])
def test_an_exponent_is_found(planar: Robot, exponent: float) -> None:
    run = recorded(planar, 3, lambda dq: np.sign(dq) * np.abs(dq) ** exponent)
    rows = rows_of(planar, run, [NonlinearViscousFriction(planar.joints)])
    found = refined_shapes(rows, prior_parameters(planar), Knowledge())
    assert found is not None
    for shape in found.found:
        assert abs(shape.value - exponent) < max(5 * shape.std, 0.05)


def test_a_joint_at_rest_keeps_its_shape(planar: Robot) -> None:
    run = recorded(planar, 1, stribeck(0.04, 0.1))
    still = np.array(run.q)
    still[:, 1] = still[0, 1]
    rows = rows_of(planar, replace(run, q=still), [StribeckFriction(planar.joints)])
    found = refined_shapes(rows, prior_parameters(planar), Knowledge())
    assert found is None or found.found[1].value == pytest.approx(0.1, rel=0.2)


NONE = EffectPrior(*(np.zeros(0),) * 3)
Torque = Callable[[Array], tuple[Array, Array]]
NUMBERS = st.lists(st.floats(-2, 2), min_size=10, max_size=10).map(np.array)


@given(NUMBERS)
def test_any_numbers_make_a_body_and_come_back(numbers: Array) -> None:
    phi, J = from_log_cholesky(numbers)
    assert violations(phi, ("body",)) == []
    P = pseudo_inertia(phi)
    condition = np.linalg.cond(P)
    np.testing.assert_allclose(to_log_cholesky(phi), numbers, atol=1e-14 * condition + 1e-12)
    for k in range(10):
        step = 1e-6 * np.eye(10)[k]
        change = from_log_cholesky(numbers + step)[0] - from_log_cholesky(numbers - step)[0]
        np.testing.assert_allclose(J[:, k], change / 2e-6, atol=1e-8 * np.abs(P).max())


def test_the_numbers_are_those_of_the_paper() -> None:
    a, d1, d2, d3, s12, s23, s13, t1, t2, t3 = numbers = np.linspace(-0.4, 0.5, 10)
    U = np.exp(a) * np.array(
        [[np.exp(d1), s12, s13, t1], [0, np.exp(d2), s23, t2], [0, 0, np.exp(d3), t3], [0, 0, 0, 1]]
    )
    P = pseudo_inertia(from_log_cholesky(numbers)[0])
    np.testing.assert_allclose(P, U @ U.T, rtol=1e-12)


def test_a_body_that_cannot_be_has_no_numbers() -> None:
    with pytest.raises(BadInput, match="no body of positive density"):
        to_log_cholesky(np.array([1.0, 0, 0, 0, 1, 0, 1, 0, 0, 3]))


def descent(
    R: Array, z: Array, prior: Array, torque: Torque | None = None, known: EffectPrior = NONE
) -> Descent:
    torque = torque or (lambda _: (np.zeros(len(z)), np.zeros((len(z), 0))))
    return Descent(R, z, prior, known, lambda x: torque(x)[0], lambda x: torque(x)[1])


def fitted(problem: Descent) -> tuple[Array, Array]:
    """From the prior on, to the minimum."""
    return problem.fit(problem.prior, problem.known.mean, tolerance=1e-15)


@pytest.mark.parametrize("name", ["planar_2r", "ur10"])
def test_the_minimiser_is_that_of_the_semidefinite_fit(name: str) -> None:
    robot, rng = load_robot(name), np.random.default_rng(0)
    motion = Motion(np.arange(200) / 100, *robot.random_motion(rng, 200))
    prior = np.array([isotropic(values) for values in prior_parameters(robot)])
    R = regressor(robot, motion).reshape(-1, prior.size) / 0.5
    truth = (prior * rng.uniform(0.9, 1.1, (robot.nv, 1))).ravel()
    z = R @ truth + rng.standard_normal(len(R))
    convex = fit_physical(R, z, prior, NONE)
    Q = np.linalg.solve(pseudo_inertia(prior), pseudo_inertia(convex.x.reshape(-1, 10)))
    assert np.linalg.eigvals(Q).real.min() > 1e-2  # no constraint is near
    x, covariance = fitted(descent(R, z, prior))
    scale = np.sqrt(np.diag(convex.covariance))
    assert (np.abs(x - convex.x) <= 1e-5 * scale).all()
    np.testing.assert_allclose(
        covariance / np.outer(scale, scale),
        convex.covariance / np.outer(scale, scale),
        atol=1e-5,
    )


def test_the_jacobian_of_the_whole_is_exact() -> None:
    rng, prior = np.random.default_rng(2), prior_parameters(load_robot("planar_2r"))
    known = EffectPrior(np.full(8, 0.5), np.ones(8), np.zeros(8))
    R, z, A = rng.standard_normal((60, 20)), rng.standard_normal(60), rng.standard_normal((60, 8))
    problem = descent(R, z, prior, lambda x: (np.sin(A @ x), np.cos(A @ x)[:, None] * A), known)
    numbers = [to_log_cholesky(values) for values in prior]
    at = np.concatenate([*numbers, known.mean]) + 0.1 * rng.standard_normal(28)
    J = problem.jacobian(at)
    for k in range(28):
        step = 1e-6 * np.eye(28)[k]
        change = (problem.residual(at + step) - problem.residual(at - step)) / 2e-6
        np.testing.assert_allclose(J[:, k], change, atol=1e-7 * (1 + np.abs(J).max()))


def test_signs_of_effects_hold() -> None:
    robot, rng = load_robot("planar_2r"), np.random.default_rng(3)
    prior = prior_parameters(robot)
    motion = Motion(np.arange(100) / 100, *robot.random_motion(rng, 100))
    R = regressor(robot, motion).reshape(-1, 20)
    column = np.zeros((100, 2, 1))
    column[:, 0, 0] = motion.dq[:, 0]
    column = column.reshape(200, 1)
    known = EffectPrior(np.zeros(1), np.full(1, 10.0), np.zeros(1))
    z = R @ prior.ravel() - 0.5 * column[:, 0]
    x, _ = fitted(descent(R, z, prior, lambda theta: (column @ theta, column), known))
    assert 0 <= x[20] < 1e-4  # viscous friction that drives is refused


def test_data_that_no_body_can_make_still_give_bodies() -> None:
    """The minimum lies on the edge of the cone, where no numbers are."""
    robot = load_robot("planar_2r")
    impossible = np.array(robot.phi)
    impossible[10 + 9] *= -1
    R = np.diag(1 / np.maximum(np.abs(robot.phi), 1e-3)) / 1e-2
    x, _ = fitted(descent(R, R @ impossible, prior_parameters(robot)))
    assert violations(x, robot.links) == []
