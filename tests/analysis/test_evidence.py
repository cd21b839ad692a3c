"""Evidence is what its definition says, and rarely calls for what is not there."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
import scipy.signal
import scipy.stats

from excitant.analysis.effect_choice import _predictive
from excitant.analysis.evidence import Candidate, Evidence, cross_validation, reweighed, weigh
from excitant.analysis.selection import completed
from excitant.analysis.thresholds import EVIDENCE
from excitant.identify.regression import dense
from excitant.robots import Robot
from excitant.robots.effects import StribeckFriction, TorqueOffset

N, NV, NUISANCE = 1200, 2, 6
PERIOD = 1 / 40  # s between rows behind a filter of 10 Hz
SIZES = (1,) * 12 + (3, 10)
PRECISION = np.concatenate([np.full(NUISANCE, 400.0), np.full(sum(SIZES), 1e-4)])


def candidates() -> list[Candidate]:
    """Some that are common, some that are not; what counts are their sizes."""
    stops = (NUISANCE + np.cumsum(SIZES)).tolist()
    kinds = [TorqueOffset] * 3 + [StribeckFriction] * (len(SIZES) - 3)
    return [
        Candidate(kind((f"joint{k}",)), slice(stop - size, stop), np.eye(size))
        for k, (kind, size, stop) in enumerate(zip(kinds, SIZES, stops, strict=True))
    ]


def columns(seed: int, n: int = N) -> np.ndarray:
    """Slow waves, as a motion makes them."""
    rng, t = np.random.default_rng(seed), np.linspace(0, 1, n)[:, None, None]
    shape = (NV, len(PRECISION))
    frequency, phase = rng.uniform(1, 15, shape), rng.uniform(0, 6.28, shape)
    return np.sin(2 * np.pi * frequency * t + phase)


def residual(X: np.ndarray, rng: np.random.Generator, rho: float = 0.0) -> np.ndarray:
    """Given values off within their tolerance, and noise of different size in each joint."""
    white = rng.standard_normal((len(X) + 300, NV)) * [0.1, 1.0]
    noise = scipy.signal.lfilter([1.0], [1.0, -rho], white, axis=0)[300:]
    eta = rng.standard_normal(NUISANCE) / np.sqrt(PRECISION[:NUISANCE])
    return X[:, :, :NUISANCE] @ eta + noise


def weighed(
    X: np.ndarray, r: np.ndarray, counts: np.ndarray | bool = True, known: float = PRECISION[0]
) -> Evidence:
    counts = np.broadcast_to(counts, r.shape)
    problem = dense(X, r, [str(k) for k in range(X.shape[2])], counts)
    return weigh(problem, np.r_[known, PRECISION[1:]], NUISANCE, candidates(), PERIOD)


def evidence(seed: int = 0, rho: float = 0.0, planted: float = 0.0, n: int = N) -> Evidence:
    X, rng = columns(seed, n), np.random.default_rng([seed, 1])
    return weighed(X, residual(X, rng, rho) + planted * X[:, :, NUISANCE + 2])


def called_for(e: Evidence) -> list[Candidate]:
    """Candidates that the evidence calls for when nothing has been taken up yet."""
    falls = zip(e.candidates, e.additions([]), strict=True)
    return [c for c, fall in falls if fall > e.dispersion([], c) * e.threshold(c)]


@pytest.mark.parametrize("n", [3000, 400])
@pytest.mark.slow
@pytest.mark.parametrize("rho", [0.0, 0.7])
def test_nothing_at_work_rarely_calls_for_anything(rho: float, n: int) -> None:
    draws = 100
    count = sum(bool(called_for(evidence(seed, rho, n=n))) for seed in range(draws))
    assert count <= scipy.stats.binom.isf(1e-3, draws, EVIDENCE.false_alarm)


@pytest.mark.parametrize("rho", [0.0, 0.7])
def test_something_at_work_is_called_for(rho: float) -> None:
    for seed in range(5):
        e = evidence(seed, rho, planted=0.3)
        found = e.candidates[int(np.argmax(e.additions([])[:12]))]  # of one coefficient
        assert found is e.candidates[2]
        assert found in called_for(e)
        coordinates, covariance = e.fit([found]).coordinates, e.fit([found]).covariance
        std = np.sqrt(covariance[-1, -1])
        assert abs(coordinates[found.columns.start] - 0.3) <= 4 * std


@pytest.mark.parametrize(("rho", "low"), [(0.0, 1.0), (0.7, 1.25)])
@pytest.mark.slow
def test_by_chance_the_cost_falls_by_the_dispersion_per_coefficient(rho: float, low: float) -> None:
    """Coloured noise that the nuisance takes up leaves λ a quarter low."""
    ratios = []
    for seed in range(40):
        e = evidence(seed, rho)
        falls, blocks = e.additions([]), len(e.blocks)
        ratios += [falls[k] / e.dispersion([], e.candidates[k]) for k in range(12)]
    # 480 draws of F with 1 and blocks − 1 degrees of freedom, nearly independent
    expected = low * (blocks - 1) / (blocks - 3)
    assert np.mean(ratios) == pytest.approx(expected, abs=4 * np.sqrt(2 / len(ratios)))


@pytest.mark.parametrize("chosen", [(), (2,), (0, 13), (12, 13, 5)])
def test_cost_is_the_minimum_that_it_is_defined_as(chosen: tuple[int, ...]) -> None:
    X, rng = columns(0), np.random.default_rng(1)
    r = residual(X, rng) + 0.3 * X[:, :, NUISANCE + 2]
    counts = rng.random(r.shape) < 0.8
    e = weighed(X, r, counts)
    picked = [e.candidates[k] for k in chosen]
    active = np.r_[(slice(0, NUISANCE), *(c.columns for c in picked))]
    weight = counts / (e.sigma * np.sqrt(e.inflation))
    A = (X[:, :, active] * weight[:, :, None]).reshape(-1, len(active))
    stacked = np.vstack([A, np.diag(np.sqrt(PRECISION[active]))])
    target = np.concatenate([(r * weight).ravel(), np.zeros(len(active))])
    solution = np.linalg.lstsq(stacked, target, rcond=None)[0]
    brute = float(((stacked @ solution - target) ** 2).sum())
    coordinates, covariance = e.fit(picked).coordinates, e.fit(picked).covariance
    assert e.cost(picked) == pytest.approx(brute, rel=1e-8)
    np.testing.assert_allclose(coordinates[active], solution, rtol=1e-6, atol=1e-9)
    expected = np.linalg.inv(stacked.T @ stacked)
    np.testing.assert_allclose(covariance, expected, rtol=1e-6, atol=1e-12)
    left = (r - X[:, :, active] @ solution) * counts
    np.testing.assert_allclose(e.fit(picked).residual, left, rtol=0, atol=1e-8 * np.abs(r).max())
    # more causes never explain less, and additions are differences of cost
    falls = e.additions(picked)
    for k in set(range(len(SIZES))) - {*chosen}:
        fall = e.cost(picked) - e.cost([*picked, e.candidates[k]])
        assert falls[k] == pytest.approx(fall, rel=1e-6, abs=1e-9 * brute)
        assert e.fall(picked, e.candidates[k]) == pytest.approx(fall, rel=1e-6, abs=1e-9 * brute)
        assert falls[k] >= 0
    assert e.cost(picked) <= e.cost([])


def test_threshold_asks_more_of_more_coefficients_shapes_and_fewer_blocks() -> None:
    e = evidence(0)
    one, three, ten = (e.candidates[k] for k in (0, 12, 13))
    assert e.threshold(one) < e.threshold(three) < e.threshold(ten)
    assert e.threshold(Candidate(one.effect, one.columns, one.scale, 100)) > e.threshold(one)
    assert evidence(0, n=400).threshold(one) > e.threshold(one)
    shared = replace(e, by_share=True)
    assert shared.threshold(one) == e.threshold(one)
    assert shared.threshold(one, 5) < shared.threshold(one, 1) < e.threshold(one, 5)
    # with blocks without end, F is χ² over its degrees of freedom
    assert e.threshold(ten) > scipy.stats.chi2.isf(EVIDENCE.false_alarm / len(e.candidates), 10)


def test_standard_effects_need_less_evidence_when_tested_among_themselves(planar: Robot) -> None:
    faint = (evidence(3, planted=size) for size in np.linspace(0.0, 0.1, 101))
    e = next(e for e in faint if completed(e, planar, [], set()))
    assert completed(e, planar, [], set()) == [e.candidates[2]]
    assert not called_for(e)


def test_a_cause_that_matters_does_not_stay_in_the_noise() -> None:
    """What is taken up is taken off the residual; common causes are even before that."""
    X, rng = columns(3), np.random.default_rng(3)
    r = residual(X, rng)
    quiet = weighed(X, r)
    # up to 9 columns fitted to 1200 rows: low by up to 0.4 %, and known to √(1 / 2N)
    np.testing.assert_allclose(quiet.sigma, [0.1, 1.0], rtol=0.005 + 4 * np.sqrt(1 / (2 * N)))
    rare, common = (weighed(X, r + 3.0 * X[:, :, NUISANCE + k]) for k in (8, 1))
    assert (rare.sigma > 1.5 * quiet.sigma).any()
    for known in (reweighed(rare, [rare.candidates[8]]), common):
        np.testing.assert_allclose(known.sigma, quiet.sigma, rtol=0.01)


def test_cosine_of_alike_and_of_unlike_columns() -> None:
    X, t = columns(0), np.arange(N) * 2 * np.pi / N
    X[:, :, NUISANCE + 1] = -3 * X[:, :, NUISANCE]  # same direction, other unit
    X[:, :, NUISANCE + 2] = np.sin(40 * t)[:, None]
    X[:, :, NUISANCE + 3] = np.cos(40 * t)[:, None]
    X[:, :, :NUISANCE] *= 1e-6  # a nuisance that takes no part
    e = weighed(X, residual(X, np.random.default_rng(0)))
    one, same, sine, cosine, *_ = e.candidates
    assert e.cosine(one, same) == pytest.approx(1.0, abs=1e-9)
    assert e.cosine(sine, cosine) == pytest.approx(0.0, abs=1e-9)
    assert e.cosine(one, sine) == pytest.approx(e.cosine(sine, one))


@pytest.mark.parametrize(("precision", "expected"), [(1e-6, 0.0), (1e9, 0.5)])
def test_what_the_tolerance_explains_does_not_make_columns_alike(precision: float, expected: float):
    """A given value that is unknown, and one that is known."""
    X, t = 1e-3 * columns(0), np.arange(N) * 2 * np.pi / N
    X[:, :, 0] = np.sin(7 * t)[:, None]
    X[:, :, NUISANCE] = (np.sin(7 * t) + np.sin(40 * t))[:, None]
    X[:, :, NUISANCE + 1] = (np.sin(7 * t) + np.cos(40 * t))[:, None]
    e = weighed(X, residual(X, np.random.default_rng(0)), known=precision)
    assert e.cosine(*e.candidates[:2]) == pytest.approx(expected, abs=1e-3)


def test_each_quarter_is_predicted_from_the_others() -> None:
    e = evidence(planted=0.3)
    X, chosen = columns(0), [e.candidates[k] for k in (2, 12, 5)]
    errors = cross_validation(e, chosen)
    edges = [*e.blocks[:: len(e.blocks) // 4], N]
    for subset in (chosen, chosen[:1], []):
        active = e.active(subset)
        found = np.empty((N, NV))
        for begin, end in itertools.pairwise(edges):
            rest, root = np.r_[0:begin, end:N], np.sqrt(e.weight)
            A = [w * X[rest, j][:, active] for j, w in enumerate(root)]
            y = np.concatenate([*(root * e.problem.tau[rest]).T, np.zeros(len(active))])
            prior = np.diag(np.sqrt(e.precision[active]))
            x = np.linalg.lstsq(np.vstack([*A, prior]), y)[0]
            left = e.problem.tau[begin:end] - X[begin:end, :, active] @ x
            found[begin:end] = left**2 * e.weight
        expected = np.add.reduceat(found, e.blocks)
        np.testing.assert_allclose(errors(subset), expected, rtol=1e-6, atol=1e-6)


def test_causes_that_do_not_predict_are_left_out() -> None:
    """Neither what holds in a part of the motion only, nor what one joint refutes."""
    X, rng = columns(3), np.random.default_rng([3, 1])
    lasting, passing, of_one_joint = (NUISANCE + k for k in (2, 4, 6))
    r = residual(X, rng) + 0.3 * X[:, :, lasting]
    r[: N // 4] += 0.6 * X[: N // 4, :, passing]
    r[:, 0] += X[:, 0, of_one_joint]
    e = replace(weighed(X, r), sigma=np.array([0.1, 1.0]), inflation=np.ones(NV))
    chosen = [e.candidates[k] for k in (2, 4, 6)]
    assert _predictive(e, chosen) == chosen[:1]
    assert _predictive(e, []) == []
