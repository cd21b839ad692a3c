"""Errors keep their evidence wherever they are raised."""

import pickle

import pytest

from excitant import exceptions
from excitant.exceptions import (
    BadInput,
    BadRecording,
    BadRobot,
    ExcitantError,
    Infeasible,
    OutsideLimits,
    RankDeficient,
    UnknownName,
    WorkerDied,
)

ERRORS = [
    BadInput("limits.yaml: no such joint"),
    BadRecording("run.csv", "NaN", row=3, column="q1"),
    BadRobot("arm.urdf", "no mass"),
    Infeasible("trajectory of arm", "no motion is slow enough"),
    OutsideLimits("elbow", "velocity", 3.2, 3.1, 0.5),
    RankDeficient(["elbow.Ia"], "not determined"),
    UnknownName("robot", "ur01", ["ur10"]),
    WorkerDied(),
]


def test_the_list_is_complete():
    kinds = {k for k in vars(exceptions).values() if isinstance(k, type)}
    assert {k for k in kinds if issubclass(k, ExcitantError)} == {*map(type, ERRORS), ExcitantError}


@pytest.mark.parametrize("error", ERRORS, ids=lambda e: type(e).__name__)
def test_an_error_arrives_whole_from_a_worker_process(error):
    again = pickle.loads(pickle.dumps(error))
    assert (type(again), str(again), vars(again)) == (type(error), str(error), vars(error))
