"""Hide effects in virtual arms, diagnose the recordings, count what was named; see README.md."""

from __future__ import annotations

import argparse
import itertools
import json
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import joblib
import numpy as np
from hidden_effects import KINDS, draw_effect
from threadpoolctl import threadpool_limits
from worlds import apart, campaign

from excitant.analysis.diagnosis import diagnose
from excitant.design import random_trajectory
from excitant.exceptions import ExcitantError
from excitant.identify import Recording, recording_from_table
from excitant.processes import owned
from excitant.robots import Robot, load_robot
from excitant.robots.plant.arm import Trajectory
from excitant.robots.torque import effect_values
from excitant.robots.virtual_arm import HiddenEffect, VirtualArm, virtual_arm

ARMS = ("ur10", "panda", "puma560", "planar_2r")
DURATION, HARMONICS = 15.0, 5  # of each motion [s]
TOLERANCE = 0.03  # of the given inertias
_WIDER = 8.0  # a wrong body must show beyond what the tolerance of all bodies does
_CLEARLY = 3.0  # times the noise floor
_SIZES = (2.0, 3.0, 5.0, 8.0, 13.0, 30.0)
_BODIES = ("inertial_parameters", "payload")
SPEED_OVER = (60.0, 114.0)  # s of motion
SPEED_WITH = ("stribeck_friction", "torque_ripple", "payload")
_PAIRED = (
    "payload", "gravity_direction", "coulomb_friction", "viscous_friction", "stribeck_friction",
    "torque_ripple", "time_delay", "encoder_offset", "torque_gain", "torque_offset", "spring",
    "presliding_hysteresis", "load_dependent_friction",
)  # fmt: skip


@dataclass(frozen=True)
class Case:
    """One virtual arm with what it hides."""

    number: int  # its seed, beside that of the suite
    seed: int
    arm: str
    kinds: tuple[str, ...]  # what is hidden; empty for a clean arm


def cases(args: argparse.Namespace) -> list[Case]:
    rng = np.random.default_rng(0)
    single = [(kind,) for kind in args.kinds.split(",")]
    pairs = [tuple(map(str, rng.choice(_PAIRED, 2, replace=False))) for _ in range(args.pairs)]
    groups = [*([kinds] * args.draws for kinds in single), [()] * args.clean, pairs]
    hidden = [
        (arm, kinds)
        for group in groups
        for arm, kinds in zip(itertools.cycle(args.arms.split(",")), group, strict=False)
    ]
    return [Case(k, args.seed, *each) for k, each in enumerate(hidden, start=1)]


def recorded(
    arm: VirtualArm, motion: Trajectory, duration: float, rng: np.random.Generator, name: str
) -> Recording:
    table = arm.record(motion, duration, rng)
    return recording_from_table(table, arm.nominal.nv, file=name, name=name)


def run(case: Case) -> dict[str, Any]:
    threadpool_limits(1)
    rng = np.random.default_rng([case.seed, case.number])
    robot, hidden, size = load_robot(case.arm), [], float("nan")
    begun = time.perf_counter()
    try:
        for kind in case.kinds:
            size = float(np.exp(rng.uniform(np.log(_SIZES[0]), np.log(_SIZES[-1]))))
            shown = size * (_WIDER if kind in _BODIES else 1.0)
            hidden.append(draw_effect(robot, rng, kind, shown))
        arm = virtual_arm(robot, rng, hidden=hidden, tolerance=TOLERANCE)
        train, held = (
            recorded(arm, random_trajectory(robot, rng, DURATION, HARMONICS), DURATION, rng, name)
            for name in ("excitation", "holdout")
        )
    except ExcitantError as error:
        return {"case": vars(case), "not_drawn": str(error)}
    drawn = time.perf_counter()
    result = diagnose(robot, [train], validate=[held]).result()
    findings = apart(result["findings"])
    found = [brief(finding) for finding in findings]
    return {
        "case": vars(case),
        "hidden": [[h.effect, list(h.acts_on), h.kind, dict(h.parameters)] for h in hidden],
        "size": size,
        "found": found,
        "score": score(robot, hidden, findings),
        "seconds": [drawn - begun, time.perf_counter() - drawn],
    }


def brief(finding: dict[str, Any]) -> list[Any]:
    rivals = [f"{r['effect']}@{'+'.join(r['joints'][:2])}" for r in finding["rivals"]]
    share = round(finding.get("share", finding["explained"]), 3)
    return [finding["effect"], finding["joints"][:2], finding["verdict"], share, rivals]


def score(
    robot: Robot, hidden: Sequence[HiddenEffect], findings: Sequence[dict[str, Any]]
) -> dict[str, Any]:
    """How many hidden effects were named, or in an undecided set too; named ones not hidden."""
    right = named = 0
    for effect in hidden:
        if any(_is(f, effect) and f["verdict"] in ("named", "unknown") for f in findings):
            named, right = named + 1, right + 1
        elif any(_among(f, effect) for f in findings if f["verdict"] == "undecided"):
            right += 1
    wrong = [
        f["effect"]
        for f in findings
        if f["verdict"] == "named"
        and not any(_is(f, effect) or _more_friction(robot, f, effect) for effect in hidden)
    ]
    return {"right": right, "named": named, "wrong": wrong}


def _is(finding: dict[str, Any], effect: HiddenEffect) -> bool:
    if finding["effect"] != effect.effect:
        return False
    where = set(effect.acts_on)
    return effect.effect == "unknown" or not where or bool(where & set(finding["joints"]))


def _more_friction(robot: Robot, finding: dict[str, Any], effect: HiddenEffect) -> bool:
    """Whether bristles that were hidden carry more than the joint's given Coulomb friction."""
    if (effect.effect, finding["effect"]) != ("presliding_hysteresis", "coulomb_friction"):
        return False
    joint, given = finding["joints"][0], effect_values(robot)
    return joint in effect.acts_on and dict(effect.parameters)["Fh"] > given.get(f"{joint}.Fc", 0.0)


def _among(finding: dict[str, Any], effect: HiddenEffect) -> bool:
    return _is(finding, effect) or any(_is(rival, effect) for rival in finding["rivals"])


def summary(results: Sequence[dict[str, Any]]) -> str:
    done = [r for r in results if "score" in r]
    singles = [r for r in done if len(r["hidden"]) == 1]
    known = [r for r in singles if r["hidden"][0][0] != "unknown"]
    clear = [r["score"] for r in known if r["size"] >= _CLEARLY]
    unknown = [r["score"] for r in singles if r["hidden"][0][0] == "unknown"]
    clean = [r["score"] for r in done if not r["hidden"]]
    pairs = [r["score"] for r in done if len(r["hidden"]) == 2]
    lines = [
        rate("right, effects of at least 3 x the floor", [s["right"] for s in clear]),
        rate("  of these named", [s["named"] for s in clear]),
        rate("a wrong name given", [s["wrong"] for s in clear]),
        rate("right, all sizes", [r["score"]["right"] for r in known]),
        rate("unknown said of unknown", [s["right"] for s in unknown]),
        rate("a name given to unknown", [s["wrong"] for s in unknown]),
        rate("clean, nothing named", [not s["wrong"] for s in clean]),
        rate("both of two found", [s["right"] == 2 for s in pairs]),
        rate("a wrong name beside two", [s["wrong"] for s in pairs]),
        f"not drawn (the arm cannot show it): {len(results) - len(done)}",
        "",
        "size     right",
    ]
    for low, high in itertools.pairwise(_SIZES):
        at = [r["score"]["right"] for r in known if low <= r["size"] < high]
        lines.append(f"{low:3g}-{high:<3g}  " + rate("", at))
    return "\n".join([*lines, "", *_confusion(singles)])


def rate(label: str, hits: Sequence[Any]) -> str:
    share = f"{100 * np.mean([bool(h) for h in hits]):5.1f} %" if hits else "    -  "
    return f"{share} of {len(hits):3d}  {label}"


def _confusion(singles: Sequence[dict[str, Any]]) -> Iterator[str]:
    rows: dict[str, Counter[str]] = defaultdict(Counter)
    for r in singles:
        truth, found = r["hidden"][0], r["found"]
        word = "nothing" if not found else str(found[0][0])
        if found and word == truth[0] and truth[1] and not set(found[0][1]) & set(truth[1]):
            word += " elsewhere"
        rows[truth[0]][word + (" ?" if found and found[0][2] == "undecided" else "")] += 1
    yield "hidden: what came first (? undecided)"
    for kind, counts in sorted(rows.items()):
        yield f"  {kind:27s} " + ", ".join(f"{n} {word}" for word, n in counts.most_common())


def speed(seed: int) -> None:
    """Processor time of `diagnose` over the length of a recording."""
    print("panda, 250 Hz, three effects hidden, given bodies off by 10 %, hold-out of 20 s")
    for duration in SPEED_OVER:
        rng, robot = np.random.default_rng(seed), load_robot("panda")
        hidden = [draw_effect(robot, rng, kind, 10.0) for kind in SPEED_WITH]
        arm = virtual_arm(robot, rng, hidden=hidden, tolerance=0.1)
        fit, held = (
            recorded(arm, random_trajectory(robot, rng, 20.0, HARMONICS), length, rng, "run")
            for length in (duration, 20.0)
        )
        with threadpool_limits(1):
            begun = time.process_time()
            diagnose(robot, [fit], validate=[held])
            took = time.process_time() - begun
        print(f"{len(fit)} samples, {fit.duration:.0f} s x {robot.nv} joints: {took:.1f} s")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=8, help="of each kind of effect")
    parser.add_argument("--clean", type=int, default=60)
    parser.add_argument("--pairs", type=int, default=40)
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--arms", default=",".join(ARMS), help="built-in arms, in turn")
    parser.add_argument("--seed", type=int, help="default 2026; with --worlds a new one")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--log", help="write every case as a line of JSON")
    worlds = parser.add_argument_group("arms of MuJoCo, see worlds.py")
    worlds.add_argument("--worlds", action="store_true", help="run these instead")
    worlds.add_argument("--count", type=int, default=300, help="of cases")
    worlds.add_argument("--case", type=int, help="tell all of one case of a seed")
    worlds.add_argument("-o", "--output", help="write every case as a line of JSON")
    parser.add_argument("--speed", action="store_true", help="time a diagnosis instead")
    args = parser.parse_args()
    if args.speed:
        speed(args.seed or 0)
        return
    if args.worlds:
        campaign(args.count, args.seed, args.case, args.jobs, args.output)
        return
    args.seed = 2026 if args.seed is None else args.seed
    todo = cases(args)
    begun, results = time.perf_counter(), []
    work = joblib.Parallel(args.jobs, return_as="generator_unordered")
    for k, result in enumerate(work(joblib.delayed(owned(run))(case) for case in todo)):
        results.append(result)
        if args.log:
            with open(args.log, "a", encoding="utf-8") as log:
                log.write(json.dumps(result) + "\n")
        if sys.stderr.isatty():
            print(f"\r{k + 1} of {len(todo)}", end="", file=sys.stderr, flush=True)
    seconds = np.array([r["seconds"] for r in results if "seconds" in r])
    print(summary(results))
    minutes = (time.perf_counter() - begun) / 60
    print(f"\n{len(todo)} cases in {minutes:.1f} min; mean s to draw and record, to diagnose: "
          f"{seconds.mean(axis=0).round(1)}")  # fmt: skip


if __name__ == "__main__":
    main()
