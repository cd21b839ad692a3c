"""Shapes of effects, found with the bodies: what was planted, and nothing where nothing was."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from estimators import truth
from hypothesis import given
from hypothesis import strategies as st
from known_arms import HARMONICS, NONE, Whitened, recorded, rows_of, smooth_motion

from excitant.exceptions import BadInput
from excitant.identify import Recording, identify_robot
from excitant.identify.knowledge import Knowledge
from excitant.identify.least_squares import weighted_least_squares
from excitant.identify.physical import fit_physical
from excitant.identify.prior import BodyPrior, EffectPrior, prior_parameters
from excitant.identify.rows import FitRows
from excitant.identify.shapes import (
    Descent,
    Shapes,
    from_log_cholesky,
    refined_shapes,
    to_log_cholesky,
)
from excitant.robots import Array, Robot, load_robot
from excitant.robots.effects import (
    Effect,
    NonlinearViscousFriction,
    StribeckFriction,
    standard_effects,
)
from excitant.robots.parameters import isotropic, pseudo_inertia, violations

KNOWN = truth("planar_2r")
JOINTS = KNOWN.robot.joints
STRIBECK = StribeckFriction(JOINTS)
Friction = Callable[[Array], Array]


def run_of(seed: int, friction: Friction) -> Recording:
    motion = smooth_motion(KNOWN.robot, np.arange(0, 25, 1 / 200), seed, HARMONICS / 3)
    return recorded(KNOWN, motion, seed, noise=2e-3, friction=friction)


def stribeck(*speeds: float) -> Friction:
    return lambda dq: np.array([1.5, 0.8]) * np.exp(-((dq / np.array(speeds)) ** 2)) * np.sign(dq)


def refined(run: Recording, *further: Effect) -> tuple[FitRows, Shapes]:
    rows = rows_of(KNOWN.robot, run, further)
    found = refined_shapes(rows, prior_parameters(KNOWN.robot), Knowledge())
    assert found is not None
    return rows, found


def test_planted_speeds_come_with_the_uncertainty_they_have() -> None:
    """Each joint its own, from one value for both that is far from either."""
    planted, scores = np.array([0.06, 0.3]), []
    for seed in range(6):
        _, found = refined(run_of(seed, stribeck(*planted)), STRIBECK)
        assert found.better
        given = [(s.joint, s.given, s.unit) for s in found.found]
        assert given == [(joint, 0.1, "rad/s") for joint in JOINTS]
        value, std = (np.array([getattr(s, k) for s in found.found]) for k in ("value", "std"))
        np.testing.assert_allclose(value, planted, rtol=0.1)
        assert (std < 0.05 * planted).all()
        scores.append((value - planted) / std)
    assert np.sqrt(np.mean(np.square(scores))) < 3


def test_shapes_that_are_right_stay() -> None:
    kept = 0
    for seed in range(8):
        _, found = refined(run_of(seed, stribeck(0.1, 0.1)), STRIBECK)
        assert found.after <= found.before + 1e-6 * found.before
        kept += not found.better
    assert kept >= 7


def test_without_such_effects_or_with_a_joint_at_rest_there_are_no_shapes() -> None:
    run = run_of(1, stribeck(0.04, 0.1))
    still = replace(run, q=run.q * [1, 0])
    for seen, further in ((run, []), (still, [STRIBECK])):
        rows = rows_of(KNOWN.robot, seen, further)
        assert refined_shapes(rows, prior_parameters(KNOWN.robot), Knowledge()) is None


def test_identify_predicts_better_with_them_and_says_so(
    planar: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    fit, held = (run_of(seed, stribeck(0.04, 0.3)) for seed in (1, 2))
    effects = (*standard_effects(planar.joints), STRIBECK)
    after = identify_robot(planar, [fit], validate=[held], effects=effects)
    monkeypatch.setattr("excitant.identify.estimate.refined_shapes", lambda *_: None)
    before = identify_robot(planar, [fit], validate=[held], effects=effects)
    assert (after.validate.rms < 0.5 * before.validate.rms).all()
    result, plain = after.result(), before.result()
    entry = result["shapes"]
    assert entry["refined"]
    assert entry["objective"]["refined"] < entry["objective"]["given"]
    assert {e["joint"]: e["value"] for e in entry["effects"]} == {
        e.joints[0]: e.velocity for e in after.model.effects if isinstance(e, StribeckFriction)
    }
    assert any(note.startswith("shapes of effects refined") for note in after.notes)
    assert "shapes" not in plain
    names, known = ([p["name"] for p in each["parameters"]] for each in (result, plain))
    assert names == known


def test_what_shapes_leave_open_widens_the_rest() -> None:
    """By as much as other fits move when the speed of a bell does, by its standard deviation."""
    rows, found = refined(run_of(1, stribeck(0.3, 0.3)), STRIBECK)
    last, fits = found.found[1], []
    for change in (-1, 0, 1):
        other = found.effects[-1].reshaped(last.field, last.value + change * last.std)
        moved = replace(found, effects=(*found.effects[:-1], other)).rows(rows)
        fits.append(weighted_least_squares(moved.reduced))
    expected = (fits[2].beta - fits[0].beta) / 2
    widened = moved.base.regrouping @ found.spread
    own = [moved.base.expressions.index(name) for name in ("joint2.Fs", "joint2.Fc", "joint2.Fv")]
    assert (np.abs(expected[own]) > 1e-4).all()
    np.testing.assert_allclose(widened[own, 1], expected[own], rtol=0.2)
    fit = fits[1]
    R, z = moved.regression.factor(fit.weight)
    physical = fit_physical(R, z, prior_parameters(KNOWN.robot), moved.open_prior)
    wide, wide_physical = found.widened(fit, physical, moved.base)
    added = np.diag(wide.covariance - fit.covariance)
    np.testing.assert_allclose(added, (widened**2).sum(axis=1), rtol=1e-6, atol=1e-15)
    assert (np.diag(wide_physical.covariance - physical.covariance) >= 0).all()


@pytest.mark.parametrize("exponent", [0.4, 2.3])
def test_an_exponent_is_found(exponent: float) -> None:
    run = run_of(3, lambda dq: np.sign(dq) * np.abs(dq) ** exponent)
    _, found = refined(run, NonlinearViscousFriction(JOINTS))
    for shape in found.found:
        assert abs(shape.value - exponent) < max(5 * shape.std, 0.05)


@given(st.lists(st.floats(-2, 2), min_size=10, max_size=10).map(np.array))
def test_any_numbers_make_a_body_and_come_back(numbers: Array) -> None:
    phi, _ = from_log_cholesky(numbers)
    assert violations(phi, ("body",)) == []
    condition = np.linalg.cond(pseudo_inertia(phi))
    np.testing.assert_allclose(to_log_cholesky(phi), numbers, atol=1e-14 * condition + 1e-12)


def test_a_body_that_cannot_be_has_no_numbers() -> None:
    with pytest.raises(BadInput, match="no body of positive density"):
        to_log_cholesky(np.array([1.0, 0, 0, 0, 1, 0, 1, 0, 0, 3]))


def fitted(
    R: Array, z: Array, prior: Array, known: EffectPrior = NONE, column: Array | None = None
) -> tuple[Array, Array]:
    """From the prior on to the minimum, with effects of these columns."""
    A = np.zeros((len(z), 0)) if column is None else column
    problem = Descent(R, z, BodyPrior(prior), known, lambda theta: A @ theta, lambda _: A)
    return problem.fit(prior, known.mean, tolerance=1e-15)


@pytest.mark.parametrize("name", ["planar_2r", "ur10"])
def test_the_minimiser_is_that_of_the_semidefinite_fit(name: str) -> None:
    arm, rng = Whitened(name, 0.5, effects=False), np.random.default_rng(0)
    prior = np.array([isotropic(values) for values in arm.prior])
    truth = (prior * rng.uniform(0.9, 1.1, (len(prior), 1))).ravel()
    z = arm.R @ truth + rng.standard_normal(len(arm.R))
    convex = fit_physical(arm.R, z, BodyPrior(prior), NONE)
    Q = np.linalg.solve(pseudo_inertia(prior), pseudo_inertia(convex.x.reshape(-1, 10)))
    assert np.linalg.eigvals(Q).real.min() > 1e-2  # no constraint is near
    x, covariance = fitted(arm.R, z, prior)
    scale = np.sqrt(np.diag(convex.covariance))
    assert (np.abs(x - convex.x) <= 1e-5 * scale).all()
    difference = (covariance - convex.covariance) / np.outer(scale, scale)
    np.testing.assert_allclose(difference, 0, atol=1e-5)


def test_signs_of_effects_hold() -> None:
    """Viscous friction that drives is refused."""
    arm = Whitened("planar_2r", 1.0)
    links, column = arm.R[:, :20], arm.R[:, 20:21]
    known = EffectPrior(np.zeros(1), np.full(1, 10.0), np.zeros(1))
    z = links @ arm.prior.ravel() - 0.5 * column[:, 0]
    assert 0 <= fitted(links, z, arm.prior, known, column)[0][20] < 1e-4


def test_data_that_no_body_can_make_give_bodies() -> None:
    """The minimum lies on the edge of the cone, where no numbers are."""
    robot = load_robot("planar_2r")
    impossible = np.array(robot.phi)
    impossible[10 + 9] *= -1  # Izz of the second link below zero
    [violation] = violations(impossible, robot.links)
    assert violation.startswith(robot.links[1])
    R = np.diag(1 / np.maximum(np.abs(robot.phi), 1e-3)) / 1e-2  # every parameter is seen to 1 %
    data = R, R @ impossible, prior_parameters(robot)
    for x in (fit_physical(*data, NONE).x, fitted(*data)[0]):
        assert violations(x, robot.links) == []
        # what was consistent stays, but for the pull of the prior: (1 % / 1)²
        np.testing.assert_allclose(x[:10], robot.phi[:10], rtol=1e-3, atol=1e-4)
