"""Choice of effects for an identification, by the evidence of a diagnosis."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from excitant.analysis.candidates import gather, observed
from excitant.analysis.evidence import Candidate, Evidence, cross_validation
from excitant.analysis.selection import select
from excitant.exceptions import RankDeficient
from excitant.identify.accuracy import series
from excitant.identify.estimate import Estimate, identify_robot
from excitant.identify.prior import prior_parameters
from excitant.identify.recording import Recording
from excitant.robots.effects import Effect, merged, plain, standard_effects
from excitant.robots.motion import Array
from excitant.robots.robot import Robot
from excitant.robots.threads import on_one_thread

# standard errors by which the error of unseen parts must fall with a cause
_UNSEEN = 2.0
_ROUNDS = 2  # of choosing effects: the second with what the first identified


@on_one_thread
def choose_effects(
    robot: Robot,
    recordings: Sequence[Recording],
    *,
    cutoff_hz: float | None = None,
    progress: Callable[[float, str], None] = lambda fraction, words: None,
) -> tuple[Effect, ...]:
    """The standard effects, and further ones that the recordings to be fitted support.

    The evidence is that of a diagnosis, with bodies and standard effects as free as in an
    identification; effects that depend on torque take that of the arm identified so far. Each
    effect must also reduce the error of parts of the recordings from which it was not fitted.
    Progress is called with the fraction done and the effects found.
    """
    standard = standard_effects(robot.joints)
    bodies = prior_parameters(robot)
    given: dict[str, Any] = {"validate": recordings, "cutoff_hz": cutoff_hz}
    estimate, chosen = _determined(robot, recordings, [], given)
    train = observed(estimate.model, estimate.data.train)
    tau = series(train.segments).measured * estimate.gains
    for k in range(_ROUNDS):
        rows = train.by(estimate.model)
        evidence = gather(train.robot, rows, tau, bodies, chosen, identified=True)
        before = _with(standard, chosen)
        found = _predictive(*select(evidence, train.robot))
        added = ", ".join(plain(e.name) for e in _with((), found))
        progress((k + 1) / _ROUNDS, added)
        if _with(standard, found) == before:
            break
        estimate, chosen = _determined(robot, recordings, found, given)
    return _with(standard, chosen)


def _predictive(evidence: Evidence, chosen: Sequence[Candidate]) -> list[Candidate]:
    """The causes that predict, by elimination of the weakest.

    With each the error of unseen parts falls beyond chance, and rises so at no joint it acts on.
    """
    kept = list(chosen)
    errors = cross_validation(evidence, chosen)
    while kept:
        before = errors(kept)
        scores = []
        for cause in kept:
            fall = errors([c for c in kept if c is not cause]) - before
            own = [j for j, _ in evidence.acting(cause)]
            scores.append(
                min(_score(fall.sum(axis=1)), *(_score(fall[:, own]) + 2 * _UNSEEN))
            )
        if min(scores) >= _UNSEEN:
            break
        kept.pop(int(np.argmin(scores)))
    return kept


def _score(falls: Array) -> Array:
    """Falls summed over blocks, in standard errors of that sum, (blocks, ...) → (...)."""
    spread = np.sqrt(len(falls)) * falls.std(axis=0, ddof=1)
    return np.asarray(falls.sum(axis=0) / np.maximum(spread, 1e-12), float)


def _with(
    standard: Sequence[Effect], chosen: Sequence[Candidate]
) -> tuple[Effect, ...]:
    return (*standard, *merged(c.effect for c in chosen))


def _determined(
    robot: Robot,
    recordings: Sequence[Recording],
    chosen: list[Candidate],
    given: dict[str, Any],
) -> tuple[Estimate, list[Candidate]]:
    """The arm identified with what was chosen, less any that bodies and others can stand for."""
    try:
        effects = _with(standard_effects(robot.joints), chosen)
        return identify_robot(robot, recordings, effects=effects, **given), chosen
    except RankDeficient as error:
        if not chosen:
            raise
        own = [{p.name for p in c.effect.parameters(robot)} for c in chosen]
        kept = [
            c
            for c, names in zip(chosen, own, strict=True)
            if names.isdisjoint(error.names)
        ]
        return _determined(
            robot, recordings, kept if kept != chosen else chosen[:-1], given
        )


def described(effects: Sequence[Effect]) -> tuple[str, ...]:
    """Effects chosen beyond the standard ones, as sentences."""
    said = []
    for effect in effects:
        if effect.search.standard:
            continue
        shapes = ", ".join(
            f"{s.name} {getattr(effect, s.name):.3g}" for s in effect.search.shapes
        )
        where = f"{plain(effect.name)} at {', '.join(effect.joints)}"
        said.append(f"effect added: {where}{f' ({shapes})' if shapes else ''}")
    return tuple(said) or (
        "effects: the recordings support none beyond the standard ones",
    )
