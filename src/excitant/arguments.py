"""What the arguments of several commands share: a verb, a robot, and how words are read."""

from __future__ import annotations

import argparse
import difflib
from collections.abc import Sequence
from typing import Any, NoReturn

from excitant.robot_arguments import part_options

ROBOT = "built-in name, URDF, xacro, MJCF or robot.yaml"
DATASET = f"{ROBOT}, or a folder with dataset.json"

Verbs = argparse._SubParsersAction  # argparse has no public name for it


class Parser(argparse.ArgumentParser):
    """A parser that says what a mistyped command, option or choice may have meant."""

    def __init__(self, **options: Any) -> None:
        super().__init__(formatter_class=argparse.RawDescriptionHelpFormatter, **options)

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> tuple[argparse.Namespace, list[str]]:
        """See argparse; unknown long options are refused before anything else."""
        known = [word for word in self._option_string_actions if word.startswith("--")]
        for word in self._own_words(args or ()):
            option = word.partition("=")[0]
            if not any(name.startswith(option) for name in known):
                self.error(f"unknown option {option}{_did_you_mean(option, known)}")
        return super().parse_known_args(args, namespace)

    def _own_words(self, words: Sequence[str]) -> list[str]:
        """Long options before the first word that is none, where commands follow; else all."""
        own = []
        for word in words:
            if word == "--" or (self._subparsers is not None and not word.startswith("-")):
                break
            if word.startswith("--") and " " not in word:
                own.append(word)
        return own

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """See argparse; the nearest choice instead of all of them."""
        if action.choices is None or value in action.choices:
            return
        known = [str(choice) for choice in action.choices]
        hint = _did_you_mean(str(value), known) or f": known are {', '.join(known)}"
        raise argparse.ArgumentError(action, f"unknown '{value}'{hint}")

    def error(self, message: str) -> NoReturn:
        """What is wrong and where help is, on the error stream; exit status 2."""
        self.exit(2, f"{self.prog}: {message}\nusage: {self.prog} --help\n")


def _did_you_mean(word: str, known: Sequence[str]) -> str:
    near = difflib.get_close_matches(word.lower(), known, n=1)
    return f": did you mean {near[0]}?" if near else ""


def new_verb(
    verbs: Verbs[Parser], name: str, summary: str, *examples: str, result: bool = True
) -> argparse.ArgumentParser:
    """A command with the options that all have.

    Args:
        verbs: Where it is added.
        name: What it is called.
        summary: What it does or gives, in a line.
        examples: Complete command lines, shown at the end of its help.
        result: Whether it has a result that ``--json`` prints.
    """
    verb = verbs.add_parser(
        name,
        help=summary,
        description=summary[0].upper() + summary[1:] + ".",
        epilog="\n  ".join(("examples:" if len(examples) > 1 else "example:", *examples)),
    )
    verb.set_defaults(verb=name)
    verb.add_argument("--debug", action="store_true", default=argparse.SUPPRESS,
                      help="show the traceback of an error")  # fmt: skip
    if result:
        verb.add_argument("--json", action="store_true", help="print result.json and nothing else")
    return verb


def robot_argument(verb: argparse.ArgumentParser) -> None:
    """The arm that a command is about, and the part of it."""
    verb.add_argument("robot", metavar="ROBOT", help=ROBOT)
    part_options(verb)


def dataset_argument(verb: argparse.ArgumentParser) -> None:
    """The arm that a command is about, or a folder that holds it with its recordings."""
    verb.add_argument("robot", metavar="ROBOT|DATASET", help=DATASET)
    part_options(verb)


def output_option(verb: argparse.ArgumentParser) -> None:
    """Where a run goes."""
    verb.add_argument(
        "-o", "--output", metavar="DIR", help="folder to write into (default: runs/<verb>-...)"
    )


def limits_option(verb: argparse.ArgumentParser) -> None:
    """Limits of the robot that are not those it comes with; `robot_of` takes them."""
    verb.add_argument("--limits", metavar="FILE", help="YAML or JSON with limits to use instead")


def columns_option(verb: argparse.ArgumentParser) -> None:
    """How columns of recordings are understood."""
    verb.add_argument("--map", metavar="FILE",
                      help="YAML that says what the columns of the recordings mean, in which "
                      "units (default: as their names say)")  # fmt: skip


def surroundings_options(verb: argparse.ArgumentParser) -> None:
    """What the arm must keep clear of, and how far."""
    verb.add_argument("--mass-uncertainty", type=float, default=0.0, metavar="PERCENT",
                      help="hold the torque limits even if each link's mass and inertia are "
                      "larger or smaller by so much (default: 0)")  # fmt: skip
    verb.add_argument("--obstacles", metavar="FILE",
                      help="YAML with boxes, spheres, half-spaces, or a workspace of the "
                      "tool")  # fmt: skip
    verb.add_argument("--clearance", type=float, metavar="M",
                      help="least distance to obstacles and between the arm's own bodies "
                      "(default: 0.01 m where the robot has collision shapes)")  # fmt: skip
    verb.add_argument("--ignore-collisions", action="store_true",
                      help="leave clearance out")  # fmt: skip


def span(text: str) -> float | tuple[float, float]:
    """One number, or two as ``S:S``."""
    shortest, _, longest = text.partition(":")
    return (float(shortest), float(longest)) if longest else float(text)


def harmonics(text: str) -> int | None:
    """A number, or None for ``search``."""
    return None if text == "search" else int(text)


def numbers(text: str) -> list[float]:
    """Numbers between commas."""
    return [float(word) for word in text.split(",")]


def names(text: str) -> list[str]:
    """Words between commas."""
    return [word.strip() for word in text.split(",") if word.strip()]


def natural(text: str) -> int:
    """An integer that is not negative."""
    value = int(text)
    if value < 0:
        raise argparse.ArgumentTypeError("must not be negative")
    return value
