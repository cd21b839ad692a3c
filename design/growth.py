"""Searching the functions of time too: how many harmonics, and which period."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from excitant.design.constraints import within_limits
from excitant.design.multistart import MultiStart
from excitant.design.problem import DesignProblem
from excitant.design.search import SearchState, best_solutions
from excitant.design.tasks import Effort
from excitant.robots import Array

_FACTOR = 1.5  # by which the number of harmonics grows
_WORTH = 0.02  # least decrease of the criterion for which it grows on
_FAMILY = 4  # best solutions that go on with more harmonics
_FIRST, _SHARE = 0.1, 0.35  # of the remaining time for the first and each further number
_SAMPLED = 6  # starts that compare periods
_PERIODS, _COMPARING = 5, 0.3  # periods compared, and the share of the time for that

Found = tuple[DesignProblem, tuple[SearchState, ...]]


def grow(problem: DesignProblem, effort: Effort, top_hz: float) -> Found:
    """The design with harmonics added for as long as they pay.

    The best solutions for few harmonics are, or are near, trajectories with more: the search
    goes on from them.

    Args:
        problem: With the least number of harmonics.
        effort: For the first number of harmonics; its deadline holds for all.
        top_hz: Highest frequency [Hz].
    """
    searches = MultiStart(problem, _share(effort, effort.starts, _FIRST)).run()
    while time.time() < effort.deadline and not _interrupted(searches):
        larger = replace(problem, series=problem.series.resized(_more(problem.series.terms)))
        seeds = _seeds(larger, problem, searches)
        if larger.series.terms / larger.period > top_hz or not seeds:
            break
        found = MultiStart(larger, _share(effort, len(seeds)), seeds).run()
        gain = _value(searches) - _value(found)
        if not gain > 0:
            break
        problem, searches = larger, found
        if gain < _WORTH:
            break
    seeds = _seeds(problem, problem, searches)
    if seeds and effort.starts is None and not _interrupted(searches):
        searches = MultiStart(problem, effort, seeds).run()
    return problem, searches


def best_period(
    problem: DesignProblem, effort: Effort, shortest: float, longest: float
) -> DesignProblem:
    """The problem with the period, among some between two [s], that a few starts do best with."""
    began, tried = time.time(), []
    periods = np.geomspace(shortest, longest, _PERIODS)
    span = _COMPARING * (effort.deadline - began) / _PERIODS
    for k, period in enumerate(periods):
        series = problem.series.resized(problem.series.terms, float(period))
        candidate = replace(problem, series=series)
        until = began + (k + 1) * span
        searches = MultiStart(candidate, replace(effort, starts=_SAMPLED, deadline=until)).run()
        tried.append((_value(searches), k, candidate))
        if _interrupted(searches):
            break
    return min(tried, key=lambda entry: entry[:2])[2]


def _more(terms: int) -> int:
    return int(np.ceil(_FACTOR * terms))


def _share(effort: Effort, starts: int | None, share: float = _SHARE) -> Effort:
    now = time.time()
    return replace(effort, starts=starts, deadline=now + share * (effort.deadline - now))


def _seeds(
    problem: DesignProblem, before: DesignProblem, searches: Sequence[SearchState]
) -> tuple[Array, ...]:
    """The best solutions of a search as unknowns of a problem, within its limits."""
    seeds = []
    for z in best_solutions(searches, _FAMILY):
        near = problem.trajectory(problem.unknowns(before.trajectory(z)))
        kept = within_limits(problem.robot, near)
        if kept is not None:
            seeds.append(problem.unknowns(kept))
    return tuple(seeds)


def _value(searches: Sequence[SearchState]) -> float:
    return min((s.best_value for s in searches), default=np.inf)


def _interrupted(searches: Sequence[SearchState]) -> bool:
    return any(s.status == "interrupted" for s in searches)
