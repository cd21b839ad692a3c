"""The command that identifies: load, choose the way, save the run with its model."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any

from excitant.analysis.enrichment import Enrichment, enrichment
from excitant.design import load_trajectory
from excitant.exceptions import BadInput, UnknownName
from excitant.identify import (
    Dataset,
    DriveGains,
    Estimate,
    KnownPayload,
    Recording,
    drive_result,
    identify_drive_gains,
    identify_link_by_link,
    identify_online,
    identify_payload,
    identify_result,
    identify_series,
    in_torque,
    link_by_link_result,
    link_by_link_series,
    load_knowledge,
    online_result,
    online_series,
    payload_result,
    publication,
)
from excitant.identify import identify as identify_robot
from excitant.identify.estimator_choice import AUTO
from excitant.identify.estimators import estimator_named
from excitant.identify.export import DEFAULT_FORMATS, FORMATS
from excitant.identify.faults import read_checked
from excitant.identify.rows import fitted
from excitant.output import finish, run_directory, show_import
from excitant.progress import progress_bar
from excitant.robot_arguments import dataset_of
from excitant.robots import Array, Motion, Robot
from excitant.robots.effects import EFFECTS, Effect, JointEffect


def identify(args: argparse.Namespace) -> None:
    """Identify a robot from recordings."""
    _refuse_contradictions(args)
    dataset = dataset_of(args)
    robot = dataset.robot
    chosen = args.effects == AUTO
    effects: Sequence[Effect] | None = None if chosen else _effects(args.effects, robot)
    formats = _formats(args.formats)
    without = [*args.validate, *args.unloaded, *args.payload_recording]
    checked = read_checked(dataset, args.recordings, without=without, repaired=args.repair)
    recordings: Sequence[Recording] = checked.recordings
    validate = dataset.recordings(args.validate) if args.validate else []
    imported = show_import([*recordings, *validate])
    options = {"validate": validate, "effects": effects, "cutoff_hz": args.cutoff}
    drive = _drive(args, dataset, recordings, options)
    if drive is not None:
        recordings, options["validate"] = (in_torque(r, drive) for r in (recordings, validate))
    further = _further(args, robot, recordings, validate) if chosen else None
    if further is not None:
        effects = options["effects"] = further.effects
    estimate, result, series = _identified(args, robot, recordings, options)
    if args.payload:
        unloaded = dataset.recordings(args.unloaded) if args.unloaded else []
        if drive is not None:
            unloaded = in_torque(unloaded, drive)
        result["payload"] = payload_result(
            identify_payload(robot, recordings, unloaded=unloaded, effects=effects)
        )
    result |= {"faults": checked.entries(), "import": imported}
    result["notes"] += [*checked.notes, *(further.notes if further is not None else ())]
    if drive is not None:
        result |= drive_result(drive)
        result["notes"].append(drive.sentence(robot.joints))
    _publish(args, estimate, result, identify_series(estimate) | series, formats)


def _further(
    args: argparse.Namespace,
    robot: Robot,
    recordings: Sequence[Recording],
    validate: Sequence[Recording],
) -> Enrichment:
    """Effects that the training data call for."""
    with progress_bar("effects") as advance:
        return enrichment(
            robot, fitted(recordings, validate), cutoff_hz=args.cutoff, progress=advance
        )


def _drive(
    args: argparse.Namespace,
    dataset: Dataset,
    recordings: Sequence[Recording],
    options: dict[str, Any],
) -> DriveGains | None:
    """Drive gains from recordings with a known payload; None where none is given."""
    if not args.payload_recording:
        return None
    centre = args.payload_com
    payload = KnownPayload(
        args.payload_mass, args.payload_mass_std, None if centre is None else tuple(centre)
    )
    loaded = dataset.recordings(args.payload_recording)
    return identify_drive_gains(dataset.robot, recordings, loaded, payload, **options)


def _publish(
    args: argparse.Namespace,
    estimate: Estimate,
    result: dict[str, Any],
    series: dict[str, Array],
    formats: Sequence[str],
) -> None:
    """Write the run with its model, unless the given one is better."""
    published = publication(estimate, formats=formats, force=args.force)
    result["published"] = published.published
    result["notes"] += [published.note] if published.note else []
    finish(args, run_directory(args, "identify", estimate.given), result, series, published.files)
    if published.note and not args.json:
        print(published.note)


def _refuse_contradictions(args: argparse.Namespace) -> None:
    if args.effects == AUTO and (args.online or args.link_by_link or args.payload):
        raise BadInput(
            "--effects auto needs all rows at once and the arm alone; name effects, or leave "
            "--online, --link-by-link and --payload out"
        )
    if args.unloaded and not args.payload:
        raise BadInput("--unloaded names what --payload is compared with; give --payload too")
    if bool(args.payload_recording) != (args.payload_mass is not None):
        raise BadInput("--payload-recording and --payload-mass belong together; give both")
    if args.payload_com is not None and len(args.payload_com) != 3:
        raise BadInput("--payload-com needs three numbers, X,Y,Z in metres")
    if args.forgetting is not None and not args.online:
        raise BadInput("--forgetting is for --online; give --online too")
    if args.link_by_link and args.online:
        raise BadInput("--link-by-link needs whole recordings; leave --online out")
    if args.estimator is not None:
        if args.estimator != AUTO:
            estimator_named(args.estimator)
        if args.link_by_link or args.online:
            raise BadInput("--estimator is for all rows at once; leave the other way out")
    for name in ("knowledge", "trajectory"):
        if getattr(args, name) and (args.link_by_link or args.online):
            raise BadInput(f"--{name} is for all rows at once; leave the other way out")


def _identified(
    args: argparse.Namespace,
    robot: Robot,
    recordings: Sequence[Recording],
    options: dict[str, Any],
) -> tuple[Estimate, dict[str, Any], dict[str, Array]]:
    """The estimate, its result and its further series, in the way that was asked for."""
    if args.online:
        with progress_bar("identify") as advance:
            found = identify_online(
                robot, recordings, **options, forgetting=args.forgetting,
                progress=lambda fraction: advance(fraction, ""),
            )  # fmt: skip
        return found.estimate, online_result(found), online_series(found.run)
    if args.link_by_link:
        stages = identify_link_by_link(robot, recordings, **options)
        return stages.estimate, link_by_link_result(stages), link_by_link_series(stages)
    known = load_knowledge(args.knowledge, robot.links) if args.knowledge else None
    highest = _highest_harmonic(args.trajectory, robot) if args.trajectory else None
    with progress_bar("identify"):
        estimate = identify_robot(
            robot, recordings, **options,
            estimator=args.estimator or AUTO, knowledge=known, tune=True, harmonics_hz=highest,
        )  # fmt: skip
    return estimate, identify_result(estimate), {}


def _highest_harmonic(path: str, robot: Robot) -> float:
    """Highest frequency of a planned motion [Hz]."""
    planned = load_trajectory(path, robot)
    if isinstance(planned, Motion):
        raise BadInput(
            f"--trajectory {path} holds samples; give the trajectory.json, which holds harmonics"
        )
    return planned.harmonics / planned.period


def _formats(names: str | None) -> Sequence[str]:
    if names is None:
        return DEFAULT_FORMATS
    formats = [word.strip() for word in names.split(",")]
    for name in formats:
        if name not in FORMATS:
            raise UnknownName("format", name, FORMATS)
    return formats


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
