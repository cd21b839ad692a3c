"""Logs larger than memory: `identify` takes them piece by piece, and says what that rules out."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from excitant.exceptions import BadInput
from excitant.identify import Dataset, load_knowledge
from excitant.identify.estimator_choice import AUTO
from excitant.identify.streaming import (
    StreamedEstimate,
    identify_streamed,
    larger_than_memory,
)
from excitant.progress import progress_bar
from excitant.robots.effects import Effect, standard_effects

_ESTIMATORS = (None, AUTO, "wls")


def streamed(
    args: argparse.Namespace, dataset: Dataset, effects: Sequence[Effect] | None
) -> StreamedEstimate | None:
    """The estimate of recordings that are larger than memory; None when they are not.

    Raises:
        BadInput: An option that needs whole recordings.
    """
    robot = dataset.robot
    fit = dataset.paths(args.recordings, without=[*args.validate, *args.unloaded])
    held = dataset.paths(args.validate) if args.validate else []
    estimated = standard_effects(robot.joints) if effects is None else effects
    count = 10 * robot.nv + sum(len(effect.parameters(robot)) for effect in estimated)
    if not larger_than_memory([*fit, *held], robot.nv, count):
        return None
    _refuse(args)
    with progress_bar("identify") as advance:
        return identify_streamed(
            robot, fit, validate=held, effects=effects, cutoff_hz=args.cutoff,
            knowledge=load_knowledge(args.knowledge, robot.links) if args.knowledge else None,
            mapping=dataset.mapping, torque_column=dataset.torque_column,
            progress=lambda fraction: advance(fraction, ""), tune=True, repaired=args.repair,
        )  # fmt: skip


def _refuse(args: argparse.Namespace) -> None:
    given = [
        f"--{name.replace('_', '-')}"
        for name in ("online", "link_by_link", "payload", "payload_recording", "trajectory")
        if getattr(args, name)
    ]
    if args.estimator not in _ESTIMATORS:
        given.append(f"--estimator {args.estimator}")
    if args.effects == AUTO:
        given.append("--effects auto")
    if given:
        raise BadInput(
            f"{', '.join(given)}: not for recordings that are larger than memory, which are read "
            "piece by piece; leave it out, or give a shorter part of them"
        )
