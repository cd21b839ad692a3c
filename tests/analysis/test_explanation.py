"""A cause that pays is not decided, with the reason, for what lies beside it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from excitant.analysis.confirmation import Finding
from excitant.analysis.explanation import reason_to_downgrade
from excitant.analysis.residuals import Residual
from excitant.robots.effects import Effect, StribeckFriction, ViscousFriction

FLOOR = 0.1
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
