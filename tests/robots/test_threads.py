"""Linear algebra on one thread, whatever the process allows."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from excitant.analysis import identifiability
from excitant.analysis.diagnosis import diagnose
from excitant.analysis.discrimination_plan import plan
from excitant.analysis.effect_choice import choose_effects
from excitant.analysis.rehearsal import rehearse
from excitant.design import design_link_by_link, design_trajectory, lower_bound
from excitant.identify import (
    identify_link_by_link,
    identify_online,
    identify_payload,
    identify_robot,
)
from excitant.robots.threads import on_one_thread


def numbers() -> set[int]:
    return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}


def test_one_thread_within_and_as_before_after() -> None:
    np.ones((2, 2)) @ np.ones((2, 2))
    with threadpool_limits(2):
        before = numbers()
        assert on_one_thread(numbers)() == {1}
        assert numbers() == before


@pytest.mark.parametrize(
    "verb",
    [
        design_trajectory, design_link_by_link, lower_bound, identify_robot, identify_link_by_link,
        identify_online, identify_payload, identifiability.analyze, choose_effects, diagnose, plan,
        rehearse,
    ],
)  # fmt: skip
def test_every_verb_computes_on_one_thread(verb: Callable[..., Any]) -> None:
    wrapper = on_one_thread(verb)
    assert verb.__code__ is wrapper.__code__
    assert verb.__wrapped__.__name__ == verb.__name__
