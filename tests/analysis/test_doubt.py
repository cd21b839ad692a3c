"""A cause that pays is doubted, with the reason, for what lies beside it."""

from __future__ import annotations

import numpy as np
import pytest

from excitant.analysis.confirmation import Finding
from excitant.analysis.doubt import doubt
from excitant.analysis.residuals import Remainder
from excitant.robots import Robot
from excitant.robots.effects import (
    Effect,
    GravityDirection,
    InertialParameters,
    StribeckFriction,
    TimeDelay,
    ViscousFriction,
)

FLOOR = 0.1


def finding(effect: Effect, rms: tuple[float, float], explained: float = 0.5) -> Finding:
    """A finding whose torque has this rms at each of two joints."""
    torque = np.array(rms) * np.ones((10, 1))
    return Finding(effect, (), (), explained, 1.0, 0.5, 0.75, 0.01, (), torque, margin=0.5)


def left(*unexplained: float) -> tuple[Remainder, ...]:
    """Slow structure of this rms at each joint."""
    return tuple(
        Remainder(f"joint{j}", float(np.hypot(rms, FLOOR)), FLOOR, 2 * rms + FLOOR, 1.0, ())
        for j, rms in enumerate(unexplained, start=1)
    )


def test_a_finding_without_anything_beside_it_is_not_doubted() -> None:
    viscous = finding(ViscousFriction(("joint2",)), (0.0, 1.0))
    assert doubt(viscous, [viscous], left(0.0, 0.0)) == ""
    assert viscous.verdict == "named"


@pytest.mark.parametrize(("rms", "doubted"), [(0.9, False), (1.1, True)])
def test_more_left_than_explained_at_its_joint(rms: float, doubted: bool) -> None:
    viscous = finding(ViscousFriction(("joint2",)), (0.0, 1.0))
    assert ("more is left" in doubt(viscous, [viscous], left(0.0, rms))) == doubted
    assert doubt(viscous, [viscous], left(rms, 0.0)) == ""


@pytest.mark.parametrize(("rms", "doubted"), [(0.2, False), (0.5, True)])
def test_a_cause_at_several_joints_has_to_explain_them_all(
    rms: float, doubted: bool, planar: Robot
) -> None:
    for effect in (
        GravityDirection(planar.joints),
        TimeDelay(planar.joints),
        InertialParameters(("joint2",)),
    ):
        common = finding(effect, (1.0, 1.0))
        assert ("several joints at once" in doubt(common, [common], left(0.0, rms))) == doubted


def test_a_small_cause_beside_a_large_one_of_rough_shape() -> None:
    small = finding(ViscousFriction(("joint2",)), (0.0, 1.0), explained=0.05)
    for name, explained, doubted in (("joint2", 0.6, True), ("joint1", 0.6, False),
                                     ("joint2", 0.4, False)):  # fmt: skip
        large = finding(StribeckFriction((name,)), (0.0, 2.0), explained)
        said = doubt(small, [small, large], left(0.0, 0.0))
        assert ("shape" in said) == doubted
        assert doubt(large, [small, large], left(0.0, 0.0)) == ""
