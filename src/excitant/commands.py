"""What each command does: load, call the verb, save the run."""

from __future__ import annotations

import argparse
import io
import json
import os
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from excitant.analysis import diagnosis, diagnosis_result, identifiability
from excitant.demo import Demo, run_demo
from excitant.design import (
    FourierTrajectory,
    HermiteTrajectory,
    condition_number,
    design_result,
    design_series,
    information,
    load_trajectory,
    trajectory_csv,
    trajectory_json,
)
from excitant.design import check as check_limits
from excitant.design import design as design_trajectory
from excitant.exceptions import BadInput, UnknownName
from excitant.identify import identify as identify_robot
from excitant.identify import (
    identify_result,
    identify_series,
    load_dataset,
    model_files,
)
from excitant.progress import progress_bar
from excitant.reports import brief, load_run, save_run
from excitant.robots import (
    Array,
    Motion,
    Robot,
    base_parameters,
    builtin_robots,
    load_limits,
    load_robot,
    torque,
)
from excitant.robots.effects import EFFECTS, JointEffect, standard_effects
from excitant.robots.virtual_arm import virtual_arm

_DENSE_HZ = 100.0
_TIMED = 1000.0  # s: the bar of a search without time limit fills by starts instead


def demo(args: argparse.Namespace) -> None:
    """Run the main job on a virtual arm."""
    robot = load_robot(args.robot)
    with progress_bar("demo") as advance:
        outcome: Demo = run_demo(robot, args.seed, advance)
    directory = _directory(args, "demo", robot)
    _finish(args, directory, outcome.result, outcome.series, outcome.files)


def robots(args: argparse.Namespace) -> None:
    """List built-in arms, or show one."""
    if args.name is None:
        entries = [_robot_line(load_robot(name)) for name in builtin_robots()]
        if args.json:
            _print_json({"verb": "robots", "robots": entries})
            return
        for entry in entries:
            print(f"{entry['name']:<14} {entry['joints']} joints  {entry['mass']:6.1f} kg")
        return
    robot = load_robot(args.name)
    content = _robot_content(robot)
    if args.json:
        _print_json(content)
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


def design(args: argparse.Namespace) -> None:
    """Design an excitation trajectory."""
    robot = _limited(args)
    if not 1 <= args.rate <= 10_000:
        raise BadInput(f"--rate {args.rate:g} Hz: give a control rate from 1 to 10000 Hz")
    began = time.monotonic()
    with progress_bar("design") as advance:

        def tell(done: int, total: int | None, condition: float, ratio: float) -> None:
            spent = (time.monotonic() - began) / (args.time_limit or _TIMED)
            advance(
                done / total if total else min(spent, 1.0),
                f"{done} starts, best κ {condition:.4g}, worst limit {100 * ratio:.1f} %",
            )

        found = design_trajectory(
            robot,
            duration=args.duration,
            harmonics=args.harmonics,
            criterion=args.criterion,
            columns=args.columns,
            starts=args.starts,
            jobs=args.jobs,
            seed=args.seed,
            time_limit=args.time_limit,
            progress=tell,
        )
    files = {
        "trajectory.csv": trajectory_csv(found.trajectory, args.rate),
        "trajectory.json": trajectory_json(found.trajectory, robot),
    }
    _finish(
        args, _directory(args, "design", robot), design_result(found), design_series(found), files
    )


def check(args: argparse.Namespace) -> None:
    """Check anybody's trajectory against the limits of a robot."""
    robot = _limited(args)
    trajectory = load_trajectory(args.trajectory, robot)
    report = check_limits(robot, trajectory)
    motion = _motion(trajectory)
    result = {
        "verb": "check",
        "robot": robot.name,
        "trajectory": str(args.trajectory),
        "joints": list(robot.joints),
        "holds": report.hold,
        "limits": {use.quantity: use.ratio for use in report.uses},
        "worst": {
            use.quantity: {"joint": use.joint, "t": use.time, "ratio": use.ratio}
            for use in report.uses
            if use.ratio > 0
        },
        "limit_values": {use.quantity: getattr(robot.limits, use.quantity) for use in report.uses},
        "columns": args.columns,
        "condition_number": condition_number(information(robot, args.columns).matrix(motion)),
        "clearance_m": None,
        "verdicts": [
            f"{use.quantity} limit of {use.joint} exceeded by {100 * (use.ratio - 1):.3g} % "
            f"at {use.time:.4g} s"
            for use in report.uses
            if use.ratio > 1
        ]
        or ["all limits hold, between samples too"],
    }
    series = {
        "t": motion.t,
        "q": motion.q,
        "dq": motion.dq,
        "ddq": motion.ddq,
        "tau": torque(robot, motion),
    }
    _finish(args, _directory(args, "check", robot), result, series, {})


def simulate(args: argparse.Namespace) -> None:
    """Record a trajectory on a virtual arm."""
    robot = load_robot(args.robot)
    target = Path(args.output)
    if target.suffix not in (".csv", ".parquet"):
        raise BadInput(f"{target}: name a .csv or .parquet file")
    trajectory = load_trajectory(args.trajectory, robot)
    path = (
        trajectory if isinstance(trajectory, FourierTrajectory) else HermiteTrajectory(trajectory)
    )
    duration = float(_motion(trajectory).t[-1])
    rng = np.random.default_rng(args.seed)
    arm = virtual_arm(
        robot, rng, hidden=None if args.hidden else (), tolerance=0.03 if args.hidden else 0.0
    )
    with progress_bar("simulate") as advance:
        table = arm.record(path, duration, rng, lambda fraction: advance(fraction, ""))
    _write_atomically(target, table_bytes(table, target.suffix))
    result = {
        "verb": "simulate",
        "robot": robot.name,
        "samples": len(table),
        "duration": duration,
        "hidden": [
            {"effect": h.effect, "joint": h.joint, "parameters": dict(h.parameters)}
            for h in arm.hidden
        ],
        "files": [str(target)],
    }
    if args.json:
        _print_json(result)
    else:
        print(f"{target}  {len(table)} samples over {duration:g} s")


def table_bytes(table: pd.DataFrame, suffix: str) -> bytes:
    """A table as the content of a ``.csv`` or ``.parquet`` file."""
    buffer = io.BytesIO()
    if suffix == ".csv":
        table.to_csv(buffer, index=False)
    else:
        table.to_parquet(buffer, index=False)
    return buffer.getvalue()


def _write_atomically(target: Path, content: bytes) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
        os.replace(name, target)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


def identify(args: argparse.Namespace) -> None:
    """Identify a robot from recordings."""
    dataset = load_dataset(args.robot)
    robot = dataset.robot
    estimate = identify_robot(
        robot,
        dataset.recordings(args.recordings),
        validate=dataset.recordings(args.validate) if args.validate else (),
        effects=_effects(args.effects, robot),
        cutoff_hz=args.cutoff,
    )
    directory = _directory(args, "identify", robot)
    files = model_files(estimate.model, "identified", "model.yaml")
    _finish(args, directory, identify_result(estimate), identify_series(estimate), files)


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
        motion = _motion(load_trajectory(args.trajectory, robot)) if args.trajectory else None
        found = identifiability.analyze(robot, effects=effects, motion=motion)
    directory = _directory(args, "analyze", robot)
    _finish(args, directory, identifiability.analyze_result(found), {}, {})


def diagnose(args: argparse.Namespace) -> None:
    """Name what the given model gets wrong."""
    dataset = load_dataset(args.robot)
    found = diagnosis.diagnose(
        dataset.robot,
        dataset.recordings(args.recordings),
        validate=dataset.recordings(args.validate) if args.validate else (),
        cutoff_hz=args.cutoff,
    )
    directory = _directory(args, "diagnose", dataset.robot)
    files = model_files(found.extension.model, "extended", "extended.yaml")
    result = diagnosis_result.diagnose_result(found)
    result["extended"]["files"] = [str(directory / name) for name in files]
    _finish(args, directory, result, diagnosis_result.diagnose_series(found), files)


def report(args: argparse.Namespace) -> None:
    """Render a run's report again."""
    result, series = load_run(args.directory)
    paths = save_run(args.directory, result, series)
    if args.json:
        _print_json(result)
    else:
        _print_paths(paths)


def _limited(args: argparse.Namespace) -> Robot:
    robot = load_robot(args.robot)
    return robot.with_limits(load_limits(args.limits, robot)) if args.limits else robot


def _motion(trajectory: FourierTrajectory | Motion) -> Motion:
    if isinstance(trajectory, Motion):
        return trajectory
    return trajectory.motion(_DENSE_HZ)


def _directory(args: argparse.Namespace, verb: str, robot: Robot) -> Path:
    if args.output:
        return Path(args.output)
    stamp = time.strftime("%Y%m%d-%H%M%S")
    return Path("runs") / f"{verb}-{robot.name}-{stamp}"


def _finish(
    args: argparse.Namespace,
    directory: Path,
    result: dict[str, Any],
    series: Mapping[str, Array],
    files: Mapping[str, str | bytes],
) -> None:
    """Save the run, then print its paths and summary, or its result as JSON."""
    result["files"] = [str(directory / name) for name in files]
    paths = save_run(directory, result, series, files)
    saved, _ = load_run(directory)
    if args.json:
        _print_json(saved)
        return
    print(brief(saved))
    print()
    _print_paths(paths)


def _print_paths(paths: Sequence[Path]) -> None:
    """All paths, the report last because it is the one to open."""
    for path in sorted(paths, key=lambda path: path.suffix == ".html"):
        print(path)


def _print_json(content: Mapping[str, Any]) -> None:
    json.dump(content, sys.stdout, indent=1, ensure_ascii=False)
    print()
