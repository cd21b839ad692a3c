"""What is wrong with the given model: what inertias alone would explain, and forward simulation."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from excitant.analysis.confirmation import held_out
from excitant.analysis.diagnosis import Diagnosis, diagnose
from excitant.analysis.residuals import BANDS, QUANTITIES
from excitant.analysis.validation import LIKELY, refit, windows
from excitant.identify import Recording
from excitant.identify.rows import series
from excitant.robots import Robot
from excitant.robots.virtual_arm import HiddenEffect, draw_hidden_effect, industrial_sensors

Runs = Callable[..., list[Recording]]
Case = tuple[HiddenEffect, Diagnosis]
TOLERANCE = 0.03


def case(kind: str, robot: Robot, runs: Runs) -> Case:
    """A virtual arm with one kind of effect hidden, diagnosed."""
    rng = np.random.default_rng(5)
    while (hidden := draw_hidden_effect(robot, rng)).effect != kind:
        pass
    recorded = runs(robot, 5, (hidden,), industrial_sensors(robot), TOLERANCE)
    return hidden, diagnose(robot, recorded[:1], validate=recorded[1:])


@pytest.fixture(scope="module")
def payload(ur10: Robot, runs: Runs) -> Case:
    return case("payload", ur10, runs)


@pytest.fixture(scope="module")
def coulomb(planar: Robot, runs: Runs) -> Case:
    return case("coulomb_friction", planar, runs)


def test_inertias_alone_explain_a_payload(payload: Case) -> None:
    _, diagnosis = payload
    found = diagnosis.refit
    assert found.gain > 0.95
    assert found.possible
    assert found.most_moved.link == diagnosis.robot.links[-1]
    assert found.most_moved.most > LIKELY
    assert found.most_moved.mass > 0
    said = diagnosis.result()["refit"]["sentence"]
    assert diagnosis.robot.links[-1] in said
    assert "among the findings" in said
    error = diagnosis.held.given
    assert found.errors["given"] == pytest.approx(np.sqrt((error**2).mean(axis=0)), rel=0.05)


def test_inertias_alone_do_not_explain_friction(coulomb: Case) -> None:
    hidden, diagnosis = coulomb
    found = diagnosis.refit
    assert found.gain < 0.3
    j = diagnosis.robot.joint_index(hidden.joint)
    assert found.errors["extended"][j] < 0.5 * found.errors["inertias"][j]
    assert "the cause is" in diagnosis.result()["refit"]["sentence"]


def test_bodies_explain_no_more_than_free_parameters_where_they_are_fitted(payload: Case) -> None:
    """On the data that were fitted, the unconstrained minimum is the smallest of all."""
    _, diagnosis = payload
    tau = series(diagnosis.data.train).measured
    on_train = held_out(diagnosis.robot, diagnosis.data.train, diagnosis.held.gains)
    errors = refit(diagnosis.train, tau, on_train, on_train.simulated).errors
    assert ((errors["bodies"] / errors["inertias"]) ** 2).mean() >= 1 / (1 + 1e-3)


def test_the_extended_model_stays_closer_to_the_motion(payload: Case) -> None:
    found = payload[1].forward
    assert not found.given.diverged
    assert not found.extended.diverged
    assert (found.extended.position < found.given.position).all()
    assert found.extended.position.sum() < 0.3 * found.given.position.sum()


def test_windows_lie_within_what_the_filter_leaves_whole(payload: Case) -> None:
    _, diagnosis = payload
    segments = diagnosis.data.validate
    found = windows(segments)
    first = min(s.motion.t[s.keep][0] for s in segments)
    last = max(s.motion.t[s.keep][-1] for s in segments)
    step = 1 / segments[0].rate_hz
    assert len(found) == 4
    for motion, tau in found:
        assert len(motion) == len(tau)
        assert motion.t[0] >= first
        assert motion.t[-1] <= last + 25 * step


def test_the_result_says_what_is_wrong(payload: Case) -> None:
    _, diagnosis = payload
    result, robot = diagnosis.result(), diagnosis.robot
    for part in ("error", "refit", "forward"):
        assert [row["name"] for row in result[part]["joints"]] == list(robot.joints)
    for row in result["error"]["joints"]:
        for part in (row, row["left"]):
            assert set(part["shares"]) <= set(QUANTITIES)
            assert set(part["bands"]) == set(BANDS)
            assert all(0 <= share <= 1 for share in part["shares"].values())
    assert {row["link"] for row in result["refit"]["links"]} == set(robot.links)
    assert result["refit"]["most_moved"] == diagnosis.refit.most_moved.link
    assert {row["unit"] for row in result["forward"]["joints"]} == {"rad"}


def test_every_curve_of_evidence_has_a_row_for_each_of_the_hold_out(coulomb: Case) -> None:
    _, diagnosis = coulomb
    arrays = diagnosis.series()
    assert {len(values) for values in arrays.values()} == {len(diagnosis.held.series.t)}
    x, residual, fit = (arrays[f"finding0_{name}"] for name in ("x", "residual", "fit"))
    shown = np.isfinite(x)
    assert shown.any()
    left = np.sqrt(((residual - fit)[shown] ** 2).mean())
    assert left < 0.5 * np.sqrt((residual[shown] ** 2).mean())


def test_a_finding_lowers_the_error_while_joints_move(coulomb: Case) -> None:
    _, diagnosis = coulomb
    before, after = diagnosis.before_and_after(diagnosis.findings[:1])
    assert after < before
    assert f"{before:.2g} → {after:.2g}" in diagnosis.headline
