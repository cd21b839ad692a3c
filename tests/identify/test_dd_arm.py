"""Tables 2 to 4 of Khosla (1987) as a recovery experiment on the CMU DD Arm II."""

import dd_arm as benchmark
import numpy as np
import pytest
from scipy.stats import binom
from seed import dd_arm, dd_arm_parameters, dd_arm_tables

from excitant.robots.parameters import pseudo_inertia, violations


@pytest.fixture(scope="module")
def found() -> benchmark.Recovery:
    return benchmark.recovery(20.0)


def test_the_table_entries_are_those_of_the_tables(found: benchmark.Recovery) -> None:
    rows = dd_arm_tables()
    assert [e.entry for e in found.entries] == list(rows)
    assert len(found.entries) == 46
    values = [(e.initial, e.truth) for e in found.entries]
    printed = [(row.initial, row.value("estimated", likely=True)) for row in rows]
    np.testing.assert_allclose(values, printed, rtol=0, atol=1e-9)


def test_gradients_of_the_entries_by_differences() -> None:
    tables, phi = benchmark.tables(), dd_arm("initial").phi
    step = 1e-6 * np.random.default_rng(0).standard_normal(60)
    ahead, behind = tables.values(phi + step), tables.values(phi - step)
    atol = 1e-6 * np.abs(step).max()
    np.testing.assert_allclose(tables.gradients(phi) @ step, (ahead - behind) / 2, atol=atol)


def test_base_parameters_and_what_the_data_decide_are_the_truth(found: benchmark.Recovery) -> None:
    z = np.abs(found.beta - found.beta_true) / found.beta_std
    assert len(z) == 32 + 12
    assert z.max() < 4.5
    assert (z < 1.96).sum() >= binom.ppf(1e-3, len(z), 0.95)
    decided = [e for e in found.entries if e.decided_by == "data"]
    assert len(decided) >= 7
    assert [e.entry.name for e in decided if abs(e.value - e.truth) >= 4 * e.std] == []


def test_what_no_torque_shows_follows_the_prior(found: benchmark.Recovery) -> None:
    """A prior moved along the null space moves silent entries, and others by next to nothing.

    By little, not by nothing: the entropic distance is no square.
    """
    assert found.base_moved < 0.05
    for e in found.entries:
        if e.silent < 1e-9:
            assert e.moved < 0.05 * e.std, e.entry.name
        else:
            assert e.moved > 0.01 * np.sqrt(e.silent) * e.std, e.entry.name
    silent = [e for e in found.entries if e.silent > 1e-9]
    assert 10 < len(silent) < 46
    assert not any(e.decided_by == "data" for e in silent if e.silent > 0.05)


def test_link_5_as_printed_is_impossible_and_what_is_nearest() -> None:
    """Kolmogorov: no consistent body lies on the printed one's side of the nearest."""
    bodies = {body.link: body for body in benchmark.nearest_bodies()}
    assert set(bodies) == {"link4", "link5"}
    assert "Ixx > Iyy + Izz, 0.002602 > 0.001349 + 0.001211" in "\n".join(benchmark.body_lines())
    rng, initial = np.random.default_rng(0), dd_arm_parameters("initial").reshape(6, 10)
    for link, body in bodies.items():
        assert violations(body.printed, (link,))
        assert violations(body.nearest, (link,)) == []
        L = np.linalg.inv(np.linalg.cholesky(pseudo_inertia(initial[int(link[4:]) - 1])))
        printed, nearest = (L @ pseudo_inertia(phi) @ L.T for phi in (body.printed, body.nearest))
        assert np.linalg.norm(nearest - printed) == pytest.approx(body.distance)
        assert np.linalg.eigvalsh(nearest)[0] == pytest.approx(benchmark.MARGIN)
        for _ in range(200):
            A = rng.standard_normal((4, 4)) * rng.uniform(0, 2)
            other = A @ A.T + benchmark.MARGIN * np.eye(4)
            assert np.sum((printed - nearest) * (other - nearest)) <= 1e-9


def test_counts_of_the_experiments() -> None:
    for across, poses in ((False, 29), (True, 30)):
        kinds = benchmark.counts(np.random.default_rng(0), across)
        assert kinds["cascade"] == [7, 7, 7, 7, 3, 1]
        assert sum(kinds["literal"]) == 14
        assert sum(kinds["poses"]) == poses


@pytest.mark.slow
def test_more_data_decide_more(found: benchmark.Recovery) -> None:
    longer = benchmark.recovery(120.0)
    votes = [[e.decided_by for e in each.entries].count("data") for each in (found, longer)]
    assert votes[1] > votes[0]
    for before, after in zip(found.entries, longer.entries, strict=True):
        assert after.kept <= before.kept * 1.1 + 0.02, after.entry.name


@pytest.mark.slow
def test_the_truth_as_read_cannot_be_followed() -> None:
    """Least squares recovers what the print says; a body that can exist cannot have it."""
    read = benchmark.recovery(20.0, likely=False)
    assert (np.abs(read.beta - read.beta_true) / read.beta_std).max() < 4.5
    truth = {e.entry.name: e.truth for e in read.entries}
    assert truth["I5xx"] == 0.002602
    assert truth["I5xx"] > truth["I5yy"] + truth["I5zz"]


@pytest.mark.slow
def test_two_motions_agree_on_what_the_prior_decides() -> None:
    """So agreement proves nothing of an entry; base parameters agree by the data alone."""
    both = benchmark.two_by_two_runs(10.0)
    motions, initial = both.spreads()
    assert ((motions < 0.05) & (initial > 0.1)).sum() > 5
    motions, initial = both.spreads(of_base=True)
    assert motions.shape == (32,)
    known = motions < 0.01
    assert known.sum() > 5
    assert (initial[known] < 0.02).all()
