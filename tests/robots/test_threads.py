"""Linear algebra on one thread, whatever the process allows."""

from pkgutil import resolve_name

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from excitant.robots.threads import on_one_thread

VERBS = """design:design_trajectory design:design_link_by_link design:lower_bound
    identify:identify_robot identify:identify_link_by_link identify:identify_online
    identify:identify_payload analysis.identifiability:analyze analysis.effect_choice:choose_effects
    analysis.diagnosis:diagnose analysis.discrimination_plan:plan analysis.rehearsal:rehearse"""


def numbers() -> set[int]:
    return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}


def test_one_thread_within_and_as_before_after() -> None:
    np.ones((2, 2)) @ np.ones((2, 2))
    with threadpool_limits(2):
        before = numbers()
        assert on_one_thread(numbers)() == {1}
        assert numbers() == before


@pytest.mark.parametrize("name", VERBS.split())
def test_every_verb_computes_on_one_thread(name: str) -> None:
    verb = resolve_name(f"excitant.{name}")
    wrapper = on_one_thread(verb)
    assert verb.__code__ is wrapper.__code__
    assert verb.__wrapped__.__name__ == verb.__name__
