"""Whether the experiment that a diagnosis proposes settles what it leaves undecided."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import common
import numpy as np
from common import wilson
from cyclopts import Parameter

from excitant.analysis.advice import Plan, key
from excitant.analysis.diagnosis import Diagnosis, diagnose
from excitant.analysis.discrimination_plan import plan
from excitant.design import Trajectory, random_trajectory
from excitant.exceptions import ExcitantError
from excitant.identify import Recording, recording_from_table
from excitant.robots import Robot, load_robot
from excitant.robots.effects import Effect
from excitant.robots.virtual_arm import (
    HiddenEffect,
    VirtualArm,
    draw_payload,
    industrial_sensors,
    typical_motion,
    typical_torque,
    virtual_arm,
)

DURATION, HARMONICS = 15.0, 5  # of each motion [s]
TOLERANCE = 0.03  # of the given inertias
_RANGE, _SPEED = 0.3, 0.4  # of the limits: what makes a motion poor
_SIZES = (4.0, 15.0)  # rms torque over what a filter of 10 Hz leaves of the noise
_PASSED = 0.28  # share of white noise of 250 Hz behind that filter
_MOST_RUNS = 10
KINDS = (
    *("payload", "gravity_direction", "viscous_friction", "coulomb_friction"),
    *("asymmetric_friction", "stribeck_friction", "nonlinear_viscous_friction"),
    *("load_dependent_friction", "presliding_hysteresis", "friction_coupling", "rotor_inertia"),
    *("inertia_coupling", "torque_offset", "torque_gain", "torque_ripple", "spring"),
    *("joint_elasticity", "backlash", "time_delay", "encoder_offset", "encoder_scale"),
    "kinematic_error",
)


def hidden_effect(robot: Robot, rng: np.random.Generator, kind: str) -> HiddenEffect:
    """An effect at some joint; a law of that joint makes a torque of 4 to 15 times the noise."""
    if kind == "payload":
        return draw_payload(robot, rng)
    couples = kind in ("friction_coupling", "inertia_coupling")
    first = min(1, robot.nv - 1) if kind == "kinematic_error" else 0  # of the first, nothing shows
    j = int(rng.integers(first, robot.nv - couples))
    size = float(np.exp(rng.uniform(*np.log(_SIZES))))
    torque = size * _PASSED * float(industrial_sensors(robot).torque_noise[j])
    q, dq, ddq = (float(np.sqrt(np.mean(x[:, j] ** 2))) for x in typical_motion(robot))
    stiffness = 200 * float(typical_torque(robot)[j])  # N·m/rad: the load bends it by 5 mrad
    gear = {"stiffness": stiffness, "damping": 0.01 * stiffness, "motor": torque / ddq}
    values: dict[str, Any] = {
        "gravity_direction": {"roll": 0.03, "pitch": -0.02},
        "viscous_friction": {"Fv": torque / dq},
        "coulomb_friction": {"Fc": torque},
        "asymmetric_friction": {"Fc_plus": torque, "Fv_plus": 0.5 * torque / dq},
        "stribeck_friction": {"Fs": 3 * torque, "velocity": 0.1 * dq},
        "nonlinear_viscous_friction": {"Fn": torque / np.sqrt(dq), "exponent": 0.5},
        "load_dependent_friction": {"Fl": 0.05},
        "presliding_hysteresis": {"Fh": 2 * torque, "distance": 0.05},
        "friction_coupling": {"Fc": torque / 2, "Fv": torque / 2 / dq, "ratio": 1.0},
        "rotor_inertia": {"Ia": torque / ddq},
        "inertia_coupling": {"Ic": torque / ddq},
        "torque_offset": {"offset": torque},
        "torque_gain": {"gain": 1.1},
        "torque_ripple": {"amplitude": 1.4 * torque, "order": 6.0, "phase": 0.5},
        "spring": {"stiffness": torque / q, "rest": 0.3},
        "joint_elasticity": gear,
        "backlash": gear | {"gap": 0.02},
        "time_delay": {"delay": 0.01},
        "encoder_offset": {"offset": 0.05},
        "encoder_scale": {"scale": 1.03},
        "kinematic_error": {"dx": 0.02, "dz": -0.01},
    }[kind]
    joints = robot.joints[j : j + 1 + couples]
    joint = "" if kind == "gravity_direction" else joints[0]
    return HiddenEffect(kind, joint, tuple(values.items()), joints if couples else ())


def recorded(
    arm: VirtualArm, motion: Trajectory, duration: float, rng: np.random.Generator, name: str
) -> Recording:
    table = arm.record(motion, duration, rng)
    return recording_from_table(table, arm.nominal.nv, file=name, name=name)


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
    """One arm: what was open before and after the proposed runs; no outcomes where it fails."""
    robot, rng = load_robot(name), np.random.default_rng([77, number])
    case: dict[str, Any] = {"arm": name, "kind": kind, "number": number, "outcomes": []}
    try:
        hidden = hidden_effect(robot, rng, kind)
        arm = virtual_arm(robot, rng, hidden=[hidden], tolerance=TOLERANCE)
        first, holdout = (recorded(arm, poor(robot, rng), DURATION, rng, n) for n in ("run", "new"))
        before = diagnose(robot, [first], validate=[holdout])
        proposed = plan(before, np.random.default_rng(0), time_limit=time_limit)
        runs = list(_runs(arm, proposed, rng))
        after = diagnose(robot, [first, *runs], validate=[holdout]) if runs else before
    except ExcitantError as error:
        return case | {"error": str(error)}
    outcomes = list(_outcomes(before, after, proposed, hidden))
    return case | {"hidden": [hidden.acts_on, dict(hidden.parameters)], "outcomes": outcomes}


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


def main(
    *,
    arms: Sequence[str] = ("planar_2r", "ur10"),
    kinds: Sequence[str] = KINDS,
    draws: int = 2,
    time_limit: float = 15.0,
    jobs: int = 2,
    output: Annotated[Path | None, Parameter(alias="-o")] = None,
) -> None:
    """Hide effects, propose motions, run them.

    Args:
        draws: Number of each kind and arm.
        time_limit: Of the search for a motion [s].
        output: File to which every case is appended as a line of JSON.
    """
    cases = itertools.product(arms, kinds, range(draws), [time_limit])
    results = common.answers(run_case, cases, jobs, output)
    outcomes = [outcome for case in results for outcome in case["outcomes"]]
    moved = [o for o in outcomes if o["how"] == "motion"]
    hidden = [o["settled"] for o in moved if o["true"]]
    all_moved = [o["settled"] for o in moved]
    print(f"settled by motion, pairs with the hidden effect: {wilson(hidden)} % of {len(hidden)}")
    print(f"settled by motion, all pairs: {wilson(all_moved)} % of {len(moved)}")
    print(f"{len(outcomes) - len(moved)} pairs need an action: no motion tells them apart")
    print(f"{sum('error' in case for case in results)} of {len(results)} cases without a result")


if __name__ == "__main__":
    common.run(main)
