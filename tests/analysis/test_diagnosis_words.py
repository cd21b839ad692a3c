"""What the words of a diagnosis say of rows that no finding rests on, and of doubts."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from excitant.analysis.diagnosis import Diagnosis
from excitant.analysis.diagnosis_words import at_rest, headline
from excitant.identify.preprocessing import Segment
from excitant.robots import Motion

RATE = 200.0
RESTS = slice(300, 500)
FLOOR = 0.1


def diagnosis_with(error_at_rest: float, error_in_motion: float, **more: Any) -> Diagnosis:
    """One joint that swings, rests for a second and swings; nothing is found."""
    t = np.arange(0, 4, 1 / RATE)[:, None]
    dq = np.cos(2 * np.pi * t + 0.3)
    dq[RESTS] = 0.0
    motion = Motion(t[:, 0], np.cumsum(dq, axis=0) / RATE, dq, np.gradient(dq, axis=0) * RATE)
    measured = np.full_like(dq, error_in_motion)
    measured[RESTS] = error_at_rest
    stand_in = {
        "data": SimpleNamespace(
            validate=(Segment("run", motion, 0 * dq, 0 * dq, 10.0, slice(None)),), unit="N·m"
        ),
        "series": SimpleNamespace(measured=measured),
        "predicted": 0 * dq,
        "remainders": (SimpleNamespace(joint="elbow", floor=FLOOR, visible=False),),
        "findings": (),
    }
    return cast(Diagnosis, SimpleNamespace(**(stand_in | more)))


def test_an_error_at_rest_is_told() -> None:
    diagnosis = diagnosis_with(error_at_rest=2.0, error_in_motion=0.1)
    assert at_rest(diagnosis).startswith("elbow errs by 1.9 N·m where it rests")
    assert headline(diagnosis).startswith("No cause stands out")
    assert at_rest(diagnosis) in headline(diagnosis)


@pytest.mark.parametrize(
    ("resting", "moving"),
    [
        pytest.param(2 * FLOOR, 0.0, id="within the noise"),
        pytest.param(2.0, 2.0, id="no more than in motion"),
    ],
)
def test_else_nothing_is_said(resting: float, moving: float) -> None:
    diagnosis = diagnosis_with(resting, moving)
    assert at_rest(diagnosis) == ""
    assert headline(diagnosis).endswith("within the noise.")
