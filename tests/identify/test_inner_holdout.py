"""Parts left out in turn: nothing seen twice, and errors of the motion that judge nobody."""

from __future__ import annotations

import numpy as np
import pytest

from excitant.identify.estimator_choice import chance_of_falls
from excitant.identify.estimator_entrants import Field
from excitant.identify.estimators import Regression, ml, wls
from excitant.identify.inner_holdout import (
    Entrant,
    InnerHoldout,
    every,
    phase,
    phases,
    some_rows,
    stretches,
    unseen_errors,
)
from excitant.identify.periods import Periods

N, NV = 600, 2
BETA = np.array([3.0, -0.5, 2.0, 1.0])
NAMES = tuple("abcd")


def columns(seed: int) -> np.ndarray:
    rng, t = np.random.default_rng(seed), np.linspace(0, 1, N)[:, None, None]
    W: np.ndarray = np.sin(2 * np.pi * rng.uniform(3, 20, (NV, 4)) * t + rng.uniform(0, 6, (NV, 4)))
    return W


def holdout_of(tau: np.ndarray, *looks: np.ndarray) -> InnerHoldout:
    whole = (slice(0, N),)
    return InnerHoldout(tau, looks, stretches(whole), every(whole, N))


def test_a_look_with_errors_rewards_a_bias_and_two_looks_do_not() -> None:
    """Columns twice as noisy as they are long in all: least squares is attenuated by far."""
    truth, gap = Entrant(Regression(columns(0), np.zeros((N, NV)), NAMES), np.arange(N), wls), []
    for seed in range(20):
        rng, W = np.random.default_rng(seed), columns(seed)
        tau = W @ BETA + 0.1 * rng.standard_normal((N, NV))
        first, second, fitted = (W + 0.7 * rng.standard_normal(W.shape) for _ in range(3))
        biased = Entrant(Regression(fitted, tau, NAMES), truth.at, wls)
        exact = Entrant(Regression(W, tau, NAMES), truth.at, wls)
        one, two = holdout_of(tau, first), holdout_of(tau, first, second)
        plain = [unseen_errors(e, one).mean() for e in (biased, exact)]
        crossed = [unseen_errors(e, two).mean() for e in (biased, exact)]
        assert plain[0] < plain[1]
        gap.append((crossed[1] - 0.1**2, crossed[0] - crossed[1]))
    exact_error, worse = np.array(gap).T
    # the torque's own noise is all that is left of the error of the right parameters
    assert abs(exact_error.mean()) < 4 * exact_error.std() / np.sqrt(20)
    assert worse.mean() > 4 * worse.std() / np.sqrt(20)


def test_rows_at_and_beside_what_is_left_out_are_not_fitted() -> None:
    tau = np.arange(N * NV, dtype=float).reshape(N, NV)
    holdout = holdout_of(tau, columns(0))
    entrant = Entrant(Regression(columns(0), tau, NAMES), np.arange(N), wls)
    for out in holdout.folds:
        seen = entrant.without(holdout.near(out)).tau[:, 0] / NV
        left = np.concatenate([holdout.blocks[b] for b in out])
        assert np.abs(seen[:, None] - left).min() == 5
    assert sorted(np.concatenate(holdout.blocks)) == list(range(N))


def periods_at(period: float, start: float) -> Periods:
    return Periods("run", period, start, np.zeros((2, 10, NV)), np.zeros((2, 10, NV)))


def test_phases_are_left_out_in_all_periods() -> None:
    t, own = 0.3 + np.arange(N) * 0.04, periods_at(7.0, 0.3)
    blocks = phases((slice(0, N),), (t,), (own,))
    assert len(blocks) == 10
    assert sorted(np.concatenate(blocks)) == list(range(N))
    for b, block in enumerate(blocks):
        at = phase(t[block], own)
        assert ((at >= b / 10) & (at < (b + 1) / 10)).all()
        assert np.diff(block).max() > 50  # of every period a piece


def test_segments_break_where_rows_are_missing_and_keep_their_noise() -> None:
    noise = np.array([np.eye(NV), 4 * np.eye(NV)])
    rows = Regression(columns(0), np.ones((N, NV)), NAMES, (0, 300), noise=noise)
    keep = np.ones(N, bool)
    keep[100:150] = False
    found = some_rows(rows, keep)
    assert found.starts == (0, 100, 250)
    np.testing.assert_array_equal(found.noise, noise[[0, 0, 1]])
    assert np.isfinite(ml(Regression(found.W, found.W @ BETA, NAMES)).beta).all()


def test_thinned_rows_stay_one_segment() -> None:
    rows = Regression(columns(0), np.ones((N, NV)), NAMES, (0, 250))
    thin = Entrant(rows, np.arange(N), wls).thinned(every(rows.segments, 100))
    assert len(thin.at) <= 102
    assert thin.rows.starts == (0, int(np.searchsorted(thin.at, 250)))
    np.testing.assert_array_equal(thin.rows.W, rows.W[thin.at])


@pytest.mark.parametrize("count", [10, 40])
def test_chance_of_falls_is_that_of_their_signs(count: int) -> None:
    """Uniform where nothing is better; small where every block agrees, whatever its size."""
    rng = np.random.default_rng(3)
    chances = [chance_of_falls(rng.standard_t(4, count)) for _ in range(400)]
    for level in (0.05, 0.3):
        spread = np.sqrt(level * (1 - level) / 400)
        assert abs(np.mean(np.array(chances) <= level) - level) < 4 * spread
    assert chance_of_falls(rng.exponential(1.0, count) ** 2) < 0.02
    assert chance_of_falls(np.zeros(count) if count == 10 else -np.linspace(1, 2, count)) > 0.99


def test_an_estimator_that_fails_is_said_to_be_absent() -> None:
    from excitant.identify.estimator_choice import chosen

    rng, W = np.random.default_rng(0), columns(0)
    tau = W @ BETA + 0.1 * rng.standard_normal((N, NV))
    blind = np.array(W)
    blind[: N - 60, :, 3] = 0.0  # only the last tenth shows the last parameter
    entrants = {
        "wls": Entrant(Regression(W, tau, NAMES), np.arange(N), wls),
        "ml": Entrant(Regression(blind, tau, NAMES), np.arange(N), ml),
    }
    found = chosen(Field(holdout_of(tau, W), entrants, {"iv": "why not"}))
    assert dict(found.absent)["ml"].startswith("parts of the training data do not show")
    assert "not compared: iv (why not), ml (parts" in found.sentence
    assert [c.name for c in found.contestants] == ["wls"]
