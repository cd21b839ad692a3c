"""Whether the experiment that a diagnosis proposes settles what it leaves undecided."""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import common
import numpy as np
from common import wilson
from diagnosis import HARMONICS, record
from worlds_plant import DURATION, KINDS, Drawing, Hidden, Plant, given_and_true

from excitant.analysis.diagnosis import Diagnosis, diagnose
from excitant.analysis.diagnosis_result import Plan, key
from excitant.analysis.discrimination_plan import plan
from excitant.design import Trajectory, random_trajectory
from excitant.exceptions import ExcitantError
from excitant.identify import Recording
from excitant.robots import Robot, load_robot
from excitant.robots.effects import Effect

_OFF = 0.03  # of the given inertias and friction
_RANGE, _SPEED = 0.3, 0.4  # of the limits: what makes a motion poor
_SIZES = (0.01, 0.05)  # of the effect's torque to its joint's, rms: too small to be plain
_MOST_RUNS = 10
_KINDS = tuple(kind for kind in KINDS if kind != "inertial_parameters")


def poor(robot: Robot, rng: np.random.Generator) -> Trajectory:
    limits = robot.limits
    low, high = np.clip(limits.position, -np.pi, np.pi).T
    width = _RANGE * (high - low)
    start = rng.uniform(low, high - width)
    narrow = replace(
        limits,
        position=np.column_stack([start, start + width]),
        velocity=_SPEED * np.minimum(limits.velocity, 3.0),
    )
    return random_trajectory(robot.with_limits(narrow), rng, DURATION, HARMONICS)


def is_true(effect: Effect, hidden: Hidden) -> bool:
    return effect.name == hidden.effect and bool(set(hidden.joints) & set(effect.joints))


def settled(after: Diagnosis, hidden: Hidden, pair: Sequence[Effect]) -> bool:
    """Whether the hidden effect is found and nothing else of a pair stands beside it, or for it."""
    true = [f for f in after.findings if is_true(f.effect, hidden)]
    false = [f.effect for f in after.findings if f not in true]
    false += [r.candidate.effect for f in true for r in f.rivals]
    wrong = {(e.name, e.joints) for e in false}
    return bool(true) and not any((e.name, e.joints) in wrong for e in pair)


def run_case(name: str, kind: str, number: int, time_limit: float) -> dict[str, Any]:
    """One arm: what was open before and after the proposed runs; no outcomes where it fails."""
    rng = np.random.default_rng([77, number])
    case: dict[str, Any] = {"arm": name, "kind": kind, "number": number, "outcomes": []}
    robot, given, true = given_and_true(load_robot(name), rng, _OFF)
    try:
        motions = poor(robot, rng), poor(robot, rng)
        plant, hidden = Drawing(true, given, motions, rng, _SIZES).hide(true, kind, set())
        first, holdout = (record(plant, motion, "white", 1.0, rng, "poor") for motion in motions)
        before = diagnose(robot, [first], validate=[holdout])
        proposed = plan(before, np.random.default_rng(0), time_limit=time_limit)
        runs = list(_runs(plant, proposed, rng))
        after = diagnose(robot, [first, *runs], validate=[holdout]) if runs else before
    except ExcitantError as error:
        return case | {"error": str(error)}
    outcomes = list(_outcomes(before, after, proposed, hidden))
    return case | {"joints": hidden.joints, "size": hidden.size, "outcomes": outcomes}


def _runs(plant: Plant, proposed: Plan, rng: np.random.Generator) -> Iterator[Recording]:
    """Every motion as often as the pairs that it serves need it."""
    for k, motion in enumerate(proposed.motions, start=1):
        served = [e for e in proposed.experiments.values() if e.file == f"separate-{k}.csv"]
        count = min(max((e.repetitions or 1 for e in served), default=0), _MOST_RUNS)
        for repeat in range(count):
            name = f"separate-{k}-{repeat + 1}"
            yield record(plant, motion, "white", 1.0, rng, name, motion.period)


def _outcomes(
    before: Diagnosis, after: Diagnosis, proposed: Plan, hidden: Hidden
) -> Iterator[dict[str, Any]]:
    """What became of each undecided pair for which an experiment was proposed."""
    for finding in before.findings:
        for rival in finding.rivals:
            pair = (finding.effect, rival.candidate.effect)
            experiment = proposed.experiments.get(key(*pair))
            if experiment is not None:
                yield {
                    "pair": [effect.name for effect in pair],
                    "how": "action" if experiment.file is None else "motion",
                    "separation": experiment.separation,
                    "runs": experiment.repetitions or 0,
                    "settled": settled(after, hidden, pair),
                    "true": any(is_true(effect, hidden) for effect in pair),
                }


def main(
    *,
    arms: Sequence[str] = ("planar_2r", "ur10"),
    kinds: Sequence[str] = _KINDS,
    draws: int = 2,
    time_limit: float = 15.0,
    jobs: int = 2,
    output: common.Output = None,
) -> None:
    """Hide effects, propose motions, run them.

    Args:
        draws: Number of each kind and arm.
        time_limit: Of the search for a motion [s].
    """
    cases = itertools.product(arms, kinds, range(draws), [time_limit])
    results = common.answers(run_case, cases, jobs, output)
    outcomes = [outcome for case in results for outcome in case["outcomes"]]
    moved = [o for o in outcomes if o["how"] == "motion"]
    for pairs, some in (("pairs with the hidden effect", [True]), ("all pairs", [True, False])):
        hits = [o["settled"] for o in moved if o["true"] in some]
        print(f"settled by motion, {pairs}: {wilson(hits)} % of {len(hits)}")
    print(f"{len(outcomes) - len(moved)} pairs need an action: no motion tells them apart")
    print(f"{sum('error' in case for case in results)} of {len(results)} cases without a result")


if __name__ == "__main__":
    common.run(main)
