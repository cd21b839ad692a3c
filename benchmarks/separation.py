"""Whether the experiment that a diagnosis proposes settles what it leaves undecided."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from diagnosis import DURATION, HARMONICS, TOLERANCE, brief, rate, recorded
from hidden_effects import KINDS, draw_effect
from threadpoolctl import threadpool_limits

from excitant.analysis.advice import Plan, key
from excitant.analysis.diagnosis import Diagnosis, diagnose
from excitant.analysis.discrimination_plan import plan
from excitant.design import Trajectory, random_trajectory
from excitant.exceptions import ExcitantError
from excitant.identify.recording import Recording
from excitant.robots import Robot, load_robot
from excitant.robots.effects import Effect
from excitant.robots.virtual_arm import HiddenEffect, VirtualArm, virtual_arm

_LEFT_OUT = ("inertial_parameters", "thermal_friction_drift", "unknown")
_RANGE, _SPEED = 0.3, 0.4  # of the limits: what makes a motion poor
_SIZES = (4.0, 15.0)  # visible sizes
_MOST_RUNS = 10


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


def is_true(effect: Effect, hidden: HiddenEffect) -> bool:
    where = set(hidden.acts_on)
    return effect.name == hidden.effect and (not where or bool(where & set(effect.joints)))


def settled(after: Diagnosis, hidden: HiddenEffect, pair: Sequence[Effect]) -> bool:
    """Whether the hidden effect is found and nothing else of a pair stands beside it, or for it."""
    true = [f for f in after.findings if is_true(f.effect, hidden)]
    false = [f.effect for f in after.findings if f not in true]
    false += [r.candidate.effect for f in true for r in f.rivals]
    wrong = {(e.name, e.joints) for e in false}
    return bool(true) and not any((e.name, e.joints) in wrong for e in pair)


def run_case(name: str, kind: str, number: int, time_limit: float) -> dict[str, Any]:
    robot, rng = load_robot(name), np.random.default_rng([77, number])
    size = float(np.exp(rng.uniform(*np.log(_SIZES))))
    hidden = draw_effect(robot, rng, kind, size)
    arm = virtual_arm(robot, rng, hidden=[hidden], tolerance=TOLERANCE)
    first, held = (recorded(arm, poor(robot, rng), DURATION, rng, n) for n in ("first", "held"))
    before = diagnose(robot, [first], validate=[held])
    proposed = plan(before, np.random.default_rng(0), time_limit=time_limit)
    runs = list(_runs(arm, proposed, rng))
    after = diagnose(robot, [first, *runs], validate=[held]) if runs else before
    return {
        "arm": name,
        "hidden": [kind, hidden.acts_on, dict(hidden.parameters)],
        "before": [brief(finding) for finding in before.result()["findings"]],
        "after": [brief(finding) for finding in after.result()["findings"]],
        "outcomes": list(_outcomes(before, after, proposed, hidden)),
    }


def _runs(arm: VirtualArm, proposed: Plan, rng: np.random.Generator) -> Iterator[Recording]:
    """Every motion as often as the pairs that it serves need it."""
    for k, motion in enumerate(proposed.motions, start=1):
        served = [e for e in proposed.experiments.values() if e.file == f"separate-{k}.csv"]
        count = min(max((e.repetitions or 1 for e in served), default=0), _MOST_RUNS)
        for repeat in range(count):
            yield recorded(arm, motion, motion.period, rng, f"separate-{k}-{repeat + 1}")


def _outcomes(
    before: Diagnosis, after: Diagnosis, proposed: Plan, hidden: HiddenEffect
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=2, help="of each kind and arm")
    parser.add_argument("--arms", default="planar_2r,ur10")
    kinds = ",".join(kind for kind in KINDS if kind not in _LEFT_OUT)
    parser.add_argument("--kinds", default=kinds)
    parser.add_argument("--first", type=int, default=0, help="number of the first draw")
    parser.add_argument("--time-limit", type=float, default=15.0)
    parser.add_argument("--log", help="write every case as a line of JSON")
    args = parser.parse_args()
    outcomes: list[dict[str, Any]] = []
    threadpool_limits(1)
    for name in args.arms.split(","):
        for kind in args.kinds.split(","):
            for number in range(args.first, args.first + args.draws):
                try:
                    case = run_case(name, kind, number, args.time_limit)
                except ExcitantError as error:
                    case = {"arm": name, "hidden": kind, "error": str(error), "outcomes": []}
                outcomes += case["outcomes"]
                if args.log:
                    with open(args.log, "a", encoding="utf-8") as file:
                        file.write(json.dumps(case) + "\n")
    moved = [o for o in outcomes if o["how"] == "motion"]
    true = [o["settled"] for o in moved if o["true"]]
    print(rate("settled: pairs with the hidden effect, by motion", true))
    print(rate("settled: all pairs, by motion", [o["settled"] for o in moved]))
    print(f"{len(outcomes) - len(moved)} pairs need an action: no motion tells them apart")


if __name__ == "__main__":
    main()
