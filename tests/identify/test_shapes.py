"""Shapes of effects, found with the bodies: what was planted, and nothing where nothing was."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from arms import truth
from known_arms import HARMONICS, recorded, rows_of, smooth_motion
from marks import slow

from excitant.identify import Recording, identify_robot
from excitant.identify.knowledge import Knowledge
from excitant.identify.least_squares import weighted_least_squares
from excitant.identify.physical import fit_physical
from excitant.identify.prior import prior_parameters
from excitant.identify.rows import FitRows
from excitant.identify.shapes import Shapes, refined_shapes, widened
from excitant.robots import Array, Robot
from excitant.robots.effects import Effect, StribeckFriction, standard_effects
from excitant.robots.effects.friction import NonlinearViscousFriction

KNOWN = truth("planar_2r")
JOINTS = KNOWN.robot.joints
STRIBECK = StribeckFriction(JOINTS)
Friction = Callable[[Array], Array]


def run_of(seed: int, friction: Friction) -> Recording:
    motion = smooth_motion(KNOWN.robot, np.arange(0, 25, 1 / 100), seed, HARMONICS / 3)
    return recorded(KNOWN, motion, seed, noise=2e-3, friction=friction)


def stribeck(*speeds: float) -> Friction:
    return lambda dq: np.array([1.5, 0.8]) * np.exp(-((dq / np.array(speeds)) ** 2)) * np.sign(dq)


def refined(run: Recording, *further: Effect) -> tuple[FitRows, Shapes]:
    rows = rows_of(KNOWN.robot, run, further)
    found = refined_shapes(rows, prior_parameters(KNOWN.robot), Knowledge())
    assert found is not None
    return rows, found


@pytest.mark.slow
def test_planted_speeds_come_with_the_uncertainty_they_have() -> None:
    """Each joint its own, from one value for both that is far from either."""
    planted, scores = np.array([0.06, 0.3]), []
    for seed in range(6):
        _, found = refined(run_of(seed, stribeck(*planted)), STRIBECK)
        assert found.better
        given = [(s.joint, s.given, s.unit) for s in found.refined]
        assert given == [(joint, 0.1, "rad/s") for joint in JOINTS]
        value, std = (np.array([getattr(s, k) for s in found.refined]) for k in ("value", "std"))
        np.testing.assert_allclose(value, planted, rtol=0.1)
        assert (std < 0.05 * planted).all()
        scores.append((value - planted) / std)
    assert np.sqrt(np.mean(np.square(scores))) < 3


@pytest.mark.slow
def test_shapes_that_are_right_stay() -> None:
    found = [refined(run_of(seed, stribeck(0.1, 0.1)), STRIBECK)[1] for seed in range(8)]
    assert all(each.after <= each.before + 1e-6 * each.before for each in found)
    assert sum(not each.better for each in found) >= 7


def test_without_such_effects_or_with_a_joint_at_rest_there_are_no_shapes() -> None:
    run = run_of(1, stribeck(0.04, 0.1))
    still = replace(run, q=run.q * [1, 0])
    for seen, further in ((run, []), (still, [STRIBECK])):
        rows = rows_of(KNOWN.robot, seen, further)
        assert refined_shapes(rows, prior_parameters(KNOWN.robot), Knowledge()) is None


def test_identify_predicts_better_with_them_and_says_so(planar: Robot, monkeypatch: Any) -> None:
    fit, held = (run_of(seed, stribeck(0.04, 0.3)) for seed in (1, 2))
    effects = (*standard_effects(planar.joints), STRIBECK)
    after = identify_robot(planar, [fit], validate=[held], effects=effects)
    monkeypatch.setattr("excitant.identify.estimate.refined_shapes", lambda *_: None)
    before = identify_robot(planar, [fit], validate=[held], effects=effects)
    assert (after.validate.rms < 0.5 * before.validate.rms).all()
    result, plain = after.result(), before.result()
    entry = result["shapes"]
    assert entry["refined"]
    assert after.shapes.after < after.shapes.before
    bells = (e for e in after.model.effects if isinstance(e, StribeckFriction))
    speeds = {e["joint"]: e["value"] for e in entry["effects"]}
    assert speeds == {e.joints[0]: e.velocity for e in bells}
    assert any(note.startswith("shapes of effects refined") for note in after.notes)
    assert "shapes" not in plain
    names, known = ([p["name"] for p in each["parameters"]] for each in (result, plain))
    assert names == known


def test_what_shapes_leave_open_widens_the_rest() -> None:
    """By as much as other fits move when the speed of a bell does, by its standard deviation."""
    rows, found = refined(run_of(1, stribeck(0.3, 0.3)), STRIBECK)
    last, fits = found.refined[1], []
    for change in (-1, 0, 1):
        other = found.effects[-1].reshaped(last.field, last.value + change * last.std)
        moved = replace(found, effects=(*found.effects[:-1], other)).rows(rows)
        fits.append(weighted_least_squares(moved.reduced))
    expected = (fits[2].beta - fits[0].beta) / 2
    spread = moved.base.regrouping @ found.spread
    own = [moved.base.expressions.index(name) for name in ("joint2.Fs", "joint2.Fc", "joint2.Fv")]
    assert (np.abs(expected[own]) > 1e-4).all()
    np.testing.assert_allclose(spread[own, 1], expected[own], rtol=0.2)
    fit = fits[1]
    R, z = moved.regression.factor(fit.weight)
    physical = fit_physical(R, z, prior_parameters(KNOWN.robot), moved.open_prior)
    wide, wide_physical = widened(fit, physical, moved.base, found.spread)
    added = np.diag(wide.covariance - fit.covariance)
    np.testing.assert_allclose(added, (spread**2).sum(axis=1), rtol=1e-6, atol=1e-15)
    assert (np.diag(wide_physical.covariance - physical.covariance) >= 0).all()


@pytest.mark.parametrize("exponent", [0.4, slow(2.3)])
def test_an_exponent_is_found_and_none_nearby_is_better(exponent: float) -> None:
    """The objective at the minimum, against fits whose shapes are moved and held."""
    run = run_of(3, lambda dq: np.sign(dq) * np.abs(dq) ** exponent)
    rows, found = refined(run, NonlinearViscousFriction(JOINTS))
    best = weighted_least_squares(found.rows(rows).reduced).sigma
    for k, shape in enumerate(found.refined):
        assert abs(shape.value - exponent) < max(5 * shape.std, 0.05)
        for factor in (-3, 3):
            effects = list(found.effects)
            place = len(effects) - len(found.refined) + k
            effects[place] = effects[place].reshaped(shape.field, shape.value + factor * shape.std)
            other = replace(found, effects=tuple(effects)).rows(rows)
            assert weighted_least_squares(other.reduced).sigma[k] > best[k]
