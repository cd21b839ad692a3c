"""Who decides an entry: one rule, that `identify` and `analyze` share."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from excitant.analysis import identifiability
from excitant.identify import Recording, identify_robot
from excitant.identify.knowledge import Knowledge, LinkKnowledge, Quantity
from excitant.identify.physical import fit_physical
from excitant.identify.prior import EffectPrior, follows, linear_influence, prior_parameters
from excitant.robots import Robot, load_robot
from excitant.robots.virtual_arm import industrial_sensors

NONE = EffectPrior(*(np.zeros(0),) * 3)


def test_data_that_show_everything_decide_everything() -> None:
    L, R = np.diag(np.arange(1.0, 11)), 1e3 * np.eye(10)
    assert (linear_influence(R, L, np.ones(10), 1) < 1e-3).all()


def test_without_data_all_is_the_priors() -> None:
    L = np.diag(np.arange(1.0, 11))
    np.testing.assert_allclose(linear_influence(np.zeros((1, 10)), L, np.ones(10), 1), 1.0)


def test_a_sum_that_is_seen_leaves_its_members_to_the_prior() -> None:
    """Their deviations shrink to 0.3 and 0.95 of the prior's; both still follow it."""
    R = np.zeros((9, 10))
    R[0, :2] = 1e4
    R[1:, 2:] = 1e4 * np.eye(8)
    L = np.diag([1.0, 0.33, *(1.0,) * 8])
    posterior = np.linalg.inv(R.T @ R + np.linalg.inv(L @ L.T))
    assert np.sqrt(posterior[0, 0]) < 0.5  # of the prior's: once taken for the data's
    influence = linear_influence(R, L, np.ones(10), 1)
    assert (influence[:2] > 0.99).all()
    assert (influence[2:] < 1e-3).all()


def test_a_sum_of_one_large_member_is_decided_by_the_data() -> None:
    R = np.zeros((9, 10))
    R[0, :2] = 1e4
    R[1:, 2:] = 1e4 * np.eye(8)
    influence = linear_influence(R, np.diag([1.0, 0.05, *(1.0,) * 8]), np.ones(10), 1)
    assert influence[0] < 0.5 < influence[1]


def test_kinds_that_hardly_reach_an_entry_do_not_count() -> None:
    ratio = np.array([[1.0, 1.0, np.nan], [0.2, 0.2, 0.2]])
    reach = np.array([[0.24, 0.26, np.nan], [1.0, 1.0, 1.0]])
    np.testing.assert_allclose(follows(ratio, reach), [0.2, 1.0, 0.2])


@pytest.mark.parametrize("kind", ["pullback", "euclidean"])
def test_the_root_is_that_of_the_prior_covariance(kind: str) -> None:
    robot, rng = load_robot("planar_2r"), np.random.default_rng(0)
    prior = prior_parameters(robot)
    R = rng.normal(size=(20, 20)) / np.abs(prior).max() * 30
    fit = fit_physical(R, R @ prior.ravel(), prior, NONE, knowledge=Knowledge(kind))
    expected = np.linalg.inv(R.T @ R + np.linalg.inv(fit.root @ fit.root.T))
    scale = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(
        fit.covariance / np.outer(scale, scale), expected / np.outer(scale, scale), atol=1e-6
    )


def test_what_is_known_exactly_is_the_priors() -> None:
    robot = load_robot("planar_2r")
    prior = prior_parameters(robot)
    known = Knowledge(links={robot.links[0]: LinkKnowledge(mass=Quantity(2.0))})
    R = 1e7 * np.eye(20)
    body = prior * np.array([[2.0 / prior[0, 0]], [1.0]])
    fit = fit_physical(R, R @ body.ravel(), prior, NONE, knowledge=known, links=robot.links)
    assert fit.influence[0] == 1.0
    assert fit.root.shape == (20, 19)
    assert (fit.influence[1:] < 0.1).all()


def test_identify_and_analyze_say_the_same(
    planar: Robot, runs: Callable[..., list[Recording]]
) -> None:
    [recording, _] = runs(planar, 3, sensors=industrial_sensors(planar))
    found = identify_robot(planar, [recording])
    said = {p["name"]: p["prior_dominated"] for p in found.result()["parameters"]}
    analysis = identifiability.analyze(
        planar, effects=found.model.effects, estimate=found, rng=np.random.default_rng(0)
    )
    rows = [p for link in analysis.result()["links"] for p in link["parameters"]]
    clear = [r for r in rows if r["decided_by"] and abs(r["prior_influence"] - 0.5) > 0.25]
    assert len(clear) > 15
    for row in clear:
        if row["decided_by"] != "physics":  # which only repeated fits tell from the prior
            assert said[row["name"]] == row["prior_dominated"], row
    missed = [
        p["name"]
        for k, p in enumerate(found.result()["parameters"])
        if p["category"] == "combined" and said[p["name"]] and found.physical.prior_share[k] < 0.5
    ]
    assert all(p["prior_dominated"] for p in rows if p["name"] in missed)
