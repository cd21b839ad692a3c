"""Choice of effects for an identification, by the evidence of a diagnosis."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from excitant.analysis.candidates import gather, observed
from excitant.analysis.evidence import Candidate, Evidence, cross_validation
from excitant.analysis.selection import in_deviations, select
from excitant.analysis.thresholds import SELECTION
from excitant.exceptions import RankDeficient
from excitant.identify.accuracy import series
from excitant.identify.estimate import Estimate, identify_robot
from excitant.identify.prior import prior_parameters
from excitant.identify.recording import Recording
from excitant.robots.effects import Effect, merged, plain, standard_effects
from excitant.robots.robot import Robot
from excitant.robots.threads import on_one_thread

ROUNDS = 2  # the second with what the first identified


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
    options = {"validate": recordings, "cutoff_hz": cutoff_hz}
    estimate, chosen = _determined(robot, recordings, [], options)
    train = observed(estimate.model, estimate.data.train)
    tau = series(train.segments).measured * estimate.gains
    for k in range(ROUNDS):
        rows = train.by(estimate.model)
        evidence = gather(train.robot, rows, tau, bodies, chosen, identified=True)
        before = _with(standard, chosen)
        causes = _predictive(*select(evidence, train.robot))
        added = ", ".join(plain(e.name) for e in _with((), causes))
        progress((k + 1) / ROUNDS, added)
        if _with(standard, causes) == before:
            break
        estimate, chosen = _determined(robot, recordings, causes, options)
    # with Coulomb friction that turns as it does there
    usual = [e for e in estimate.model.effects if e.search.standard]
    return _with([e.without_values() for e in usual], chosen)


def _predictive(evidence: Evidence, chosen: Sequence[Candidate]) -> list[Candidate]:
    """The causes that predict, by elimination of the weakest.

    With each the error of unseen parts falls beyond chance, and rises so at no joint it acts on.
    """
    causes = list(chosen)
    errors = cross_validation(evidence, chosen)
    while causes:
        before = errors(causes)
        scores = []
        for cause in causes:
            fall = errors([c for c in causes if c is not cause]) - before
            joints = [j for j, _ in evidence.acting(cause)]
            of_joints = in_deviations(fall[:, joints]) + 2 * SELECTION.unseen
            scores.append(min(in_deviations(fall.sum(axis=1)), *of_joints))
        if min(scores) >= SELECTION.unseen:
            break
        causes.pop(np.argmin(scores))
    return causes


def _with(
    standard: Sequence[Effect], chosen: Sequence[Candidate]
) -> tuple[Effect, ...]:
    return (*standard, *merged(c.effect for c in chosen))


def _determined(
    robot: Robot,
    recordings: Sequence[Recording],
    chosen: list[Candidate],
    options: dict[str, Any],
) -> tuple[Estimate, list[Candidate]]:
    """The arm identified with what was chosen, less any that bodies and others can stand for."""
    try:
        effects = _with(standard_effects(robot.joints), chosen)
        options = options | {"effects": effects, "turning": True}
        return identify_robot(robot, recordings, **options), chosen
    except RankDeficient as error:
        if not chosen:
            raise
        determined = [
            c
            for c in chosen
            if {p.name for p in c.effect.parameters(robot)}.isdisjoint(error.names)
        ]
        fewer = determined if determined != chosen else chosen[:-1]
        return _determined(robot, recordings, fewer, options)


def described(effects: Sequence[Effect]) -> tuple[str, ...]:
    """Effects chosen beyond the standard ones, as sentences."""
    sentences = []
    for effect in effects:
        if effect.search.standard:
            continue
        shapes = ", ".join(
            f"{s.name} {getattr(effect, s.name):.3g}" for s in effect.search.shapes
        )
        where = f"{plain(effect.name)} at {', '.join(effect.joints)}"
        sentences.append(f"effect added: {where}{f' ({shapes})' if shapes else ''}")
    none = "effects: the recordings support none beyond the standard ones"
    return tuple(sentences or [none])
