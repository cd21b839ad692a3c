"""The commands about arms and recordings: load, call the verb, save the run."""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

from excitant.analysis import diagnosis, diagnosis_result, identifiability
from excitant.demo import Demo, run_demo
from excitant.design import load_trajectory
from excitant.exceptions import BadInput, UnknownName
from excitant.identify import identify as identify_robot
from excitant.identify import (
    identify_online,
    identify_payload,
    identify_result,
    identify_series,
    load_dataset,
    model_files,
    online_result,
    online_series,
    payload_result,
)
from excitant.motion_commands import sampled
from excitant.output import finish, print_json, print_paths, run_directory
from excitant.progress import progress_bar
from excitant.reports import load_run, save_run
from excitant.robots import Robot, base_parameters, builtin_robots, load_robot
from excitant.robots.effects import EFFECTS, JointEffect, standard_effects


def demo(args: argparse.Namespace) -> None:
    """Run the main job on a virtual arm."""
    robot = load_robot(args.robot)
    with progress_bar("demo") as advance:
        outcome: Demo = run_demo(robot, args.seed, advance)
    directory = run_directory(args, "demo", robot)
    finish(args, directory, outcome.result, outcome.series, outcome.files)


def robots(args: argparse.Namespace) -> None:
    """List built-in arms, or show one."""
    if args.name is None:
        entries = [_robot_line(load_robot(name)) for name in builtin_robots()]
        if args.json:
            print_json({"verb": "robots", "robots": entries})
            return
        for entry in entries:
            print(f"{entry['name']:<14} {entry['joints']} joints  {entry['mass']:6.1f} kg")
        return
    robot = load_robot(args.name)
    content = _robot_content(robot)
    if args.json:
        print_json(content)
        return
    print(f"{robot.name}: {robot.nv} joints, {content['base_parameters']} base parameters")
    print(f"{'joint':<24} {'link':<20} {'position':>17} {'speed':>7} {'accel.':>7} {'torque':>7}")
    for entry in content["joints"]:
        low, high = entry["position"]
        print(
            f"{entry['name']:<24} {entry['link']:<20} {_short(low):>8} {_short(high):>8} "
            f"{_short(entry['velocity']):>7} {_short(entry['acceleration']):>7} "
            f"{_short(entry['torque']):>7}"
        )
    for entry in content["joints"]:
        print(f"{entry['link']:<24} mass {entry['mass']:.4g} kg")


def _short(value: float | None) -> str:
    return "none" if value is None else f"{value:.4g}"


def _robot_line(robot: Robot) -> dict[str, Any]:
    return {"name": robot.name, "joints": robot.nv, "mass": float(robot.phi[::10].sum())}


def _robot_content(robot: Robot) -> dict[str, Any]:
    limits = robot.limits
    joints = [
        {
            "name": joint,
            "link": robot.links[j],
            "position": [_finite(x) for x in limits.position[j]],
            **{
                name: _finite(getattr(limits, name)[j])
                for name in ("velocity", "acceleration", "torque")
            },
            "mass": float(robot.phi[10 * j]),
        }
        for j, joint in enumerate(robot.joints)
    ]
    return {
        "verb": "robots",
        **_robot_line(robot),
        "joints": joints,
        "gravity": robot.gravity.tolist(),
        "effects": [effect.name for effect in robot.effects],
        "base_parameters": len(base_parameters(robot)),
        "parameters": dict(zip(robot.parameter_names, robot.phi.tolist(), strict=True)),
    }


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def identify(args: argparse.Namespace) -> None:
    """Identify a robot from recordings."""
    dataset = load_dataset(args.robot)
    robot = dataset.robot
    effects = _effects(args.effects, robot)
    if args.unloaded and not args.payload:
        raise BadInput("--unloaded names what --payload is compared with; give --payload too")
    if args.forgetting is not None and not args.online:
        raise BadInput("--forgetting is for --online; give --online too")
    without = [*args.validate, *args.unloaded]
    recordings = dataset.recordings(args.recordings, without=without)
    options: dict[str, Any] = {
        "validate": dataset.recordings(args.validate) if args.validate else (),
        "effects": effects,
        "cutoff_hz": args.cutoff,
    }
    if args.online:
        with progress_bar("identify") as advance:
            found = identify_online(
                robot, recordings, **options, forgetting=args.forgetting,
                progress=lambda fraction: advance(fraction, ""),
            )  # fmt: skip
        estimate, result, series = found.estimate, online_result(found), online_series(found.run)
    else:
        estimate, series = identify_robot(robot, recordings, **options), {}
        result = identify_result(estimate)
    if args.payload:
        unloaded = dataset.recordings(args.unloaded) if args.unloaded else ()
        result["payload"] = payload_result(
            identify_payload(robot, recordings, unloaded=unloaded, effects=effects)
        )
    directory = run_directory(args, "identify", robot)
    files = model_files(estimate.model, "identified", "model.yaml")
    finish(args, directory, result, identify_series(estimate) | series, files)


def _effects(names: str | None, robot: Robot) -> list[JointEffect] | None:
    if names is None:
        return None
    known = {name: kind for name, kind in EFFECTS.items() if issubclass(kind, JointEffect)}
    effects: list[JointEffect] = []
    for name in (word.strip() for word in names.split(",")):
        if name not in known:
            raise UnknownName("effect", name, known)
        effects.append(known[name](robot.joints))
    return effects


def analyze(args: argparse.Namespace) -> None:
    """Say what can be known of an arm's parameters."""
    dataset = load_dataset(args.robot)
    robot = dataset.robot
    if args.recording:
        estimate = identify_robot(robot, dataset.recordings(args.recording))
        found = identifiability.analyze(robot, estimate=estimate)
    else:
        effects = standard_effects(robot.joints) if args.columns == "friction" else ()
        motion = sampled(load_trajectory(args.trajectory, robot)) if args.trajectory else None
        found = identifiability.analyze(robot, effects=effects, motion=motion)
    directory = run_directory(args, "analyze", robot)
    finish(args, directory, identifiability.analyze_result(found), {}, {})


def diagnose(args: argparse.Namespace) -> None:
    """Name what the given model gets wrong."""
    dataset = load_dataset(args.robot)
    found = diagnosis.diagnose(
        dataset.robot,
        dataset.recordings(args.recordings, without=args.validate),
        validate=dataset.recordings(args.validate) if args.validate else (),
        cutoff_hz=args.cutoff,
    )
    directory = run_directory(args, "diagnose", dataset.robot)
    files = model_files(found.extension.model, "extended", "extended.yaml")
    result = diagnosis_result.diagnose_result(found)
    result["extended"]["files"] = [str(directory / name) for name in files]
    finish(args, directory, result, diagnosis_result.diagnose_series(found), files)


def report(args: argparse.Namespace) -> None:
    """Render a run's report again."""
    result, series = load_run(args.directory)
    paths = save_run(args.directory, result, series)
    if args.json:
        print_json(result)
    else:
        print_paths(paths)
