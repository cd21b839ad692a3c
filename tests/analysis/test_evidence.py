"""Evidence is what its definition says, and rarely calls for what is not there."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.signal

from excitant.analysis.evidence import FALSE_ALARM, Candidate, Evidence, weigh
from excitant.robots.effects import TorqueOffset

N, NV, NUISANCE = 3000, 2, 6
SIZES = (1,) * 12 + (3, 10)


def candidates() -> list[Candidate]:
    found, start = [], NUISANCE
    for k, size in enumerate(SIZES):
        effect = TorqueOffset((f"joint{k}",))
        found.append(Candidate(effect, slice(start, start + size), np.eye(size)))
        start += size
    return found


PRECISION = np.concatenate([np.full(NUISANCE, 400.0), np.full(sum(SIZES), 1e-4)])


def columns(seed: int) -> np.ndarray:
    """Slow waves, as a motion makes them."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0, 1, N)[:, None, None]
    shape = (NV, NUISANCE + sum(SIZES))
    frequency, phase = rng.uniform(1, 15, shape), rng.uniform(0, 6.28, shape)
    X: np.ndarray = np.sin(2 * np.pi * frequency * t + phase)
    return X


def residual(X: np.ndarray, rng: np.random.Generator, rho: float) -> np.ndarray:
    """Given values off within their tolerance, and noise of different size in each joint."""
    white = rng.standard_normal((N + 300, NV)) * [0.1, 1.0]
    noise = scipy.signal.lfilter([1.0], [1.0, -rho], white, axis=0)[300:]
    eta = rng.standard_normal(NUISANCE) / np.sqrt(PRECISION[:NUISANCE])
    r: np.ndarray = X[:, :, :NUISANCE] @ eta + noise
    return r


def evidence(seed: int = 0, rho: float = 0.0, planted: float = 0.0) -> Evidence:
    X, rng = columns(seed), np.random.default_rng(seed + 1)
    r = residual(X, rng, rho) + planted * X[:, :, NUISANCE + 2]
    return weigh(X, r, PRECISION, NUISANCE, candidates())


def alarms(rho: float, draws: int) -> int:
    count = 0
    for seed in range(draws):
        e = evidence(seed, rho)
        alone = e.cost([])
        count += any(alone - e.cost([c]) > e.threshold(c.size) for c in e.candidates)
    return count


@pytest.mark.parametrize("rho", [0.0, 0.7])
def test_nothing_at_work_rarely_calls_for_anything(rho: float) -> None:
    draws = 100
    # FALSE_ALARM per recording is a bound (Bonferroni); noise levels estimated from
    # rows to which 31 columns were fitted are low, which makes it up to twice that
    expected = 2 * FALSE_ALARM * draws
    assert alarms(rho, draws) <= expected + 3 * np.sqrt(expected)


def test_something_at_work_is_called_for() -> None:
    e = evidence(planted=0.2)
    falls = [e.cost([]) - e.cost([c]) - e.threshold(c.size) for c in e.candidates]
    assert int(np.argmax(falls)) == 2
    assert falls[2] > 0


@pytest.mark.parametrize("chosen", [(), (2,), (0, 13), (12, 13, 5)])
def test_cost_is_the_minimum_that_it_is_defined_as(chosen: tuple[int, ...]) -> None:
    X, rng = columns(0), np.random.default_rng(1)
    r = residual(X, rng, 0.0) + 0.3 * X[:, :, NUISANCE + 2]
    e = weigh(X, r, PRECISION, NUISANCE, candidates())
    picked = [e.candidates[k] for k in chosen]
    active = np.r_[(slice(0, NUISANCE), *(c.columns for c in picked))]
    weight = 1 / (e.sigma * np.sqrt(e.inflation))
    A = (X[:, :, active] * weight[:, None]).reshape(-1, len(active))
    stacked = np.vstack([A, np.diag(np.sqrt(PRECISION[active]))])
    target = np.concatenate([(r * weight).ravel(), np.zeros(len(active))])
    solution = np.linalg.lstsq(stacked, target, rcond=None)[0]
    brute = float(((stacked @ solution - target) ** 2).sum())
    cost, coordinates, covariance = e.solve(picked)
    assert e.cost(picked) == pytest.approx(brute, rel=1e-8)
    assert cost == pytest.approx(brute, rel=1e-8)
    np.testing.assert_allclose(coordinates[active], solution, rtol=1e-6, atol=1e-9)
    expected = np.linalg.inv(stacked.T @ stacked)
    np.testing.assert_allclose(covariance[np.ix_(active, active)], expected, rtol=1e-6, atol=1e-12)


def test_more_causes_never_explain_less() -> None:
    e, chosen = evidence(3), []
    costs = [e.cost(chosen)]
    for candidate in e.candidates:
        chosen.append(candidate)
        costs.append(e.cost(chosen))
    assert (np.diff(costs) <= 1e-9 * costs[0]).all()
    assert costs[0] <= e.power


def test_cosine_of_alike_and_of_unlike_columns() -> None:
    X = columns(0)
    X[:, :, NUISANCE + 1] = -3 * X[:, :, NUISANCE]  # same direction, other unit
    t = np.arange(N) * 2 * np.pi / N
    X[:, :, NUISANCE + 2] = np.sin(40 * t)[:, None]
    X[:, :, NUISANCE + 3] = np.cos(40 * t)[:, None]
    X[:, :, :NUISANCE] *= 1e-6  # a nuisance that takes no part
    e = weigh(X, residual(X, np.random.default_rng(0), 0.0), PRECISION, NUISANCE, candidates())
    one, same, sine, cosine, *_ = e.candidates
    assert e.cosine(one, same) == pytest.approx(1.0, abs=1e-9)
    assert e.cosine(sine, cosine) == pytest.approx(0.0, abs=1e-9)
    assert e.cosine(one, sine) == pytest.approx(e.cosine(sine, one))


def test_what_the_tolerance_can_explain_does_not_make_columns_alike() -> None:
    X = 1e-3 * columns(0)
    t = np.arange(N) * 2 * np.pi / N
    X[:, :, 0] = np.sin(7 * t)[:, None]
    X[:, :, NUISANCE] = (np.sin(7 * t) + np.sin(40 * t))[:, None]
    X[:, :, NUISANCE + 1] = (np.sin(7 * t) + np.cos(40 * t))[:, None]
    r = residual(X, np.random.default_rng(0), 0.0)
    for precision, expected in ((1e-6, 0.0), (1e9, 0.5)):  # given value unknown, and known
        e = weigh(X, r, np.r_[precision, PRECISION[1:]], NUISANCE, candidates())
        assert e.cosine(*e.candidates[:2]) == pytest.approx(expected, abs=1e-3)


def test_noise_levels_are_found() -> None:
    e = evidence(5)
    # 31 columns fitted to 3000 rows: low by up to 0.5 %, and known to √(1 / 2N)
    np.testing.assert_allclose(e.sigma, [0.1, 1.0], rtol=0.005 + 4 * np.sqrt(1 / (2 * N)))
