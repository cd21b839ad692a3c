"""Which part of which robot a command is about: its options, and what they say."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from excitant.exceptions import BadInput

if TYPE_CHECKING:
    from excitant.identify import Dataset
    from excitant.robots import Robot
    from excitant.robots.loading import RobotSpec

_OPTIONS = ("joints", "base", "tip", "lock", "xacro_arg", "package")


def part_options(verb: argparse.ArgumentParser) -> None:
    """Options that choose a chain of a robot, and say how its xacro file is read."""
    group = verb.add_argument_group("part of the robot (default: all joints that move)")
    group.add_argument("--joints", type=_names, metavar="J1,J2,...",
                       help="keep these joints, hold all others")  # fmt: skip
    group.add_argument("--tip", metavar="LINK",
                       help="keep the joints on the way to this link; what hangs beyond it is "
                       "carried along")  # fmt: skip
    group.add_argument("--base", metavar="LINK",
                       help="keep only joints that this link carries")  # fmt: skip
    group.add_argument("--lock", type=_positions, action="append", metavar="J1=Q,J2,...",
                       help="hold these joints at these positions [rad or m] (default: at "
                       "0)")  # fmt: skip
    group.add_argument("--xacro-arg", type=_assignment, action="append", metavar="NAME:=VALUE",
                       help="argument of a xacro file; once for each")  # fmt: skip
    group.add_argument("--package", action="append", metavar="DIR",
                       help="folder of a package that a xacro file asks for with $(find NAME), "
                       "or one that holds several; once for each")  # fmt: skip


def spec(args: argparse.Namespace, path: str | None = None) -> RobotSpec:
    """The robot that the arguments of a command mean.

    Args:
        args: The arguments.
        path: What was given as the robot; ``args.robot`` when None.
    """
    from excitant.robots.loading import RobotSpec

    given = {name: getattr(args, name, None) for name in _OPTIONS}
    path = args.robot if path is None else path
    if Path(path).is_dir() and any(value is not None for value in given.values()):
        option = next(name for name, value in given.items() if value is not None)
        raise BadInput(
            f"{path}: a folder says itself which joints its robot has; leave "
            f"--{option.replace('_', '-')} out, or put it into a robot.yaml there"
        )
    return RobotSpec(
        path,
        None if given["joints"] is None else tuple(given["joints"]),
        given["base"],
        given["tip"],
        {joint: value for part in given["lock"] or () for joint, value in part.items()},
        dict(given["xacro_arg"] or ()),
        tuple(given["package"] or ()),
    )


def robot_of(args: argparse.Namespace, path: str | None = None) -> Robot:
    """The robot that the arguments of a command mean, with the limits they name; see `spec`."""
    from excitant.robots import load_limits, load_robot

    robot = noted(load_robot(spec(args, path)))
    limits = getattr(args, "limits", None)
    return robot.with_limits(load_limits(limits, robot)) if limits else robot


def dataset_of(args: argparse.Namespace) -> Dataset:
    """The robot that the arguments of a command mean, with the recordings beside it."""
    from excitant.identify import load_dataset

    given: Any = spec(args)
    dataset = load_dataset(given, columns=args.map)
    noted(dataset.robot)
    return dataset


def noted(robot: Robot) -> Robot:
    """The robot, after its notes went to the error stream."""
    for note in robot.notes:
        print(f"{robot.source}: {note}", file=sys.stderr)
    return robot


def _names(text: str) -> list[str]:
    return [word.strip() for word in text.split(",") if word.strip()]


def _positions(text: str) -> dict[str, float]:
    found = {}
    for word in _names(text):
        joint, _, value = word.partition("=")
        try:
            found[joint.strip()] = float(value or 0.0)
        except ValueError:
            raise argparse.ArgumentTypeError(f"'{value}' of {joint} is not a number") from None
    return found


def _assignment(text: str) -> tuple[str, str]:
    name, sign, value = text.partition(":=")
    if not sign or not name.strip():
        raise argparse.ArgumentTypeError(f"'{text}': write it as NAME:=VALUE")
    return name.strip(), value.strip()
