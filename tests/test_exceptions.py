"""Errors keep their evidence wherever they are raised."""

import pickle

import pytest

from excitant import exceptions as ex

ERRORS = [
    ex.BadInput("limits.yaml: no such joint"),
    ex.BadRecording("run.csv", "NaN", row=3, column="q1"),
    ex.BadRobot("arm.urdf", "no mass"),
    ex.Infeasible("trajectory of arm", "no motion is slow enough"),
    ex.OutsideLimits("elbow", "velocity", 3.2, 3.1, 0.5),
    ex.RankDeficient(["elbow.Ia"], "not determined"),
    ex.UnknownName("robot", "ur01", ["ur10"]),
    ex.WorkerDied(),
]


def test_the_list_is_complete():
    kinds = {k for k in vars(ex).values() if isinstance(k, type)}
    expected = {*map(type, ERRORS), ex.ExcitantError}
    assert {k for k in kinds if issubclass(k, ex.ExcitantError)} == expected


@pytest.mark.parametrize("error", ERRORS, ids=lambda e: type(e).__name__)
def test_an_error_arrives_whole_from_a_worker_process(error):
    again = pickle.loads(pickle.dumps(error))
    assert (type(again), str(again), vars(again)) == (type(error), str(error), vars(error))
