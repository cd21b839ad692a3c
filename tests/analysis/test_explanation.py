"""What a diagnosis says in plain words, and why a cause that pays is not decided."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from excitant.analysis.confirmation import Finding
from excitant.analysis.diagnosis import Diagnosis, diagnose
from excitant.analysis.evidence import are_placeholders
from excitant.analysis.explanation import at_rest, headline, reason_to_downgrade
from excitant.analysis.residuals import Residual
from excitant.identify import Recording
from excitant.robots import Robot
from excitant.robots.effects import Effect, StribeckFriction, ViscousFriction
from excitant.robots.virtual_arm import HiddenEffect, industrial_sensors

Runs = Callable[..., list[Recording]]
FLOOR = 0.1
BODY = (1.0, 0.0, 0.0, 0.0, 0.01, 0.0, 0.01, 0.0, 0.0, 0.01)
LIFT = "shoulder_lift_joint"
OFFSET = HiddenEffect("torque_offset", LIFT, (("offset", 8.0),))


VISCOUS = ViscousFriction(("joint2",))


def left(*unexplained: float) -> tuple[Residual, ...]:
    """Slow structure of this rms at each joint."""
    return tuple(
        Residual(
            f"joint{j}", float(np.hypot(rms, FLOOR)), FLOOR, 2 * rms + FLOOR, 1.0, {}, {}, (0, 1)
        )
        for j, rms in enumerate(unexplained, start=1)
    )


def reason(
    rms: tuple[float, float],
    residuals: tuple[Residual, ...],
    explained: float = 0.5,
    others: tuple[tuple[Effect, float], ...] = (),
) -> str:
    """Of a cause whose torque has this rms at each of two joints."""
    torque = np.array(rms) * np.ones((10, 1))
    found, *beside = (
        cast(Finding, SimpleNamespace(effect=effect, torque=torque, explained=share))
        for effect, share in ((VISCOUS, explained), *others)
    )
    return reason_to_downgrade(found, beside, residuals)


def test_nothing_beside_it_is_no_reason() -> None:
    assert reason((0.0, 1.0), left(0.0, 0.0), others=((VISCOUS, 0.5),)) == ""


@pytest.mark.parametrize(("rms", "undecided"), [(0.9, False), (1.1, True)])
def test_more_left_than_explained_at_its_joint(rms: float, undecided: bool) -> None:
    assert ("more is left" in reason((0.0, 1.0), left(0.0, rms))) == undecided
    assert reason((0.0, 1.0), left(rms, 0.0)) == ""


@pytest.mark.parametrize(("rms", "undecided"), [(0.2, False), (0.5, True)])
def test_a_cause_at_several_joints_has_to_explain_them_all(rms: float, undecided: bool) -> None:
    assert ("several joints at once" in reason((1.0, 1.0), left(0.0, rms))) == undecided


@pytest.mark.parametrize(
    ("joint", "explained", "undecided"),
    [("joint2", 0.6, True), ("joint1", 0.6, False), ("joint2", 0.4, False)],
)
def test_a_small_cause_beside_a_large_one_of_rough_shape(
    joint: str, explained: float, undecided: bool
) -> None:
    others = ((VISCOUS, 0.05), (StribeckFriction((joint,)), explained))
    said = reason((0.0, 1.0), left(0.0, 0.0), 0.05, others)
    assert ("shape" in said) == undecided


@pytest.mark.parametrize(
    ("resting", "in_motion", "said"),
    [
        pytest.param(2.0, 0.1, "elbow errs by 2 N·m where it rests", id="at rest"),
        pytest.param(2 * FLOOR, 0.0, "", id="within the noise"),
        pytest.param(2.0, 2.0, "", id="no more than in motion"),
    ],
)
def test_an_error_at_rest_is_told(resting: float, in_motion: float, said: str) -> None:
    """One joint that rests for a while; nothing is found."""
    moves = np.ones((800, 1), bool)
    moves[300:500] = False
    stand_in: dict[str, Any] = {
        "data": SimpleNamespace(unit="N·m"),
        "held": SimpleNamespace(moves=moves),
        "left": np.where(moves, in_motion, resting),
        "residuals": (SimpleNamespace(joint="elbow", floor=FLOOR),),
        "ordered": [],
    }
    diagnosis = cast(Diagnosis, SimpleNamespace(**stand_in))
    assert at_rest(diagnosis).startswith(said)
    assert bool(at_rest(diagnosis)) == bool(said)
    assert headline(diagnosis).startswith("No cause stands out")
    assert headline(diagnosis).endswith(at_rest(diagnosis))


@pytest.mark.slow
def test_what_is_hidden_is_found_without_inertias(ur10: Robot, runs: Runs) -> None:
    """Links that all weigh the same say nothing: no axis is moved to make up for masses."""
    recordings = runs(ur10, 2, (OFFSET,), industrial_sensors(ur10), 0.03, duration=15.0)
    given = ur10.with_parameters(np.tile(BODY, ur10.nv))
    assert are_placeholders(given)
    assert not are_placeholders(ur10)
    diagnosis = diagnose(given, recordings[:1], validate=recordings[1:])
    [finding] = diagnosis.findings
    effects = [finding.effect, *(r.candidate.effect for r in finding.rivals)]
    assert "torque_offset" in {e.name for e in effects if e.joints == (LIFT,)}
    assert (diagnosis.extended.nrmse < 0.05).all()
    result = diagnosis.result()
    assert result["headline"].startswith("All links of the given model weigh 1 kg")
    assert "Beside inertias: " in result["headline"]
    assert any("fitted together with the causes" in note for note in result["notes"])
