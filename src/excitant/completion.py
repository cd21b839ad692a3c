"""Completion at the TAB key: what shells are told about the words of a command line."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator

import shtab

from excitant.design.export import FORMATS as MOTION_FORMATS
from excitant.identify.estimator_choice import AUTO
from excitant.identify.estimators import ESTIMATORS
from excitant.identify.export import FORMATS as MODEL_FORMATS
from excitant.robots import builtin_robots
from excitant.robots.effects import EFFECTS


def completion(args: argparse.Namespace) -> None:
    """Print the script for a shell."""
    from excitant.cli import parser

    print(shtab.complete(describe(parser()), shell=args.shell))


def describe(parser: argparse.ArgumentParser) -> argparse.ArgumentParser:
    """Say with every argument of all commands what it takes, in the way of shtab."""
    arms = _words("robot", builtin_robots(), files=True)
    by_metavar = {
        "ROBOT": arms,
        "ROBOT|DATASET": arms,
        "DIR": shtab.DIRECTORY,
        "FILE": shtab.FILE,
        "TRAJECTORY": shtab.FILE,
        "RECORDING": shtab.FILE,
    }
    by_option = {
        ("identify", "effects"): _words("effect", (AUTO, *EFFECTS)),
        ("identify", "estimator"): _words("estimator", (AUTO, *ESTIMATORS)),
        ("identify", "formats"): _words("model_format", MODEL_FORMATS),
        ("design", "formats"): _words("motion_format", MOTION_FORMATS),
    }
    for verb, action in _arguments(parser):
        metavar = action.metavar if isinstance(action.metavar, str) else ""
        complete = by_option.get((verb, action.dest), by_metavar.get(metavar))
        if complete is not None:
            action.complete = complete  # type: ignore[attr-defined]
    return parser


def _arguments(parser: argparse.ArgumentParser) -> Iterator[tuple[str, argparse.Action]]:
    """Every command with each of its arguments."""
    for action in parser._actions:  # argparse has no public list of them
        if isinstance(action, argparse._SubParsersAction):
            for verb, below in action.choices.items():
                yield from ((verb, argument) for argument in below._actions)


def _words(kind: str, words: Iterable[str], files: bool = False) -> shtab.CompleteType:
    """Words that an argument may be, and files where it may name one, in each shell's own way."""
    name, listed = f"_excitant_{kind}", " ".join(words)
    return {
        "bash": name,
        "zsh": name,
        "fish": f"({name})",
        "preamble": {
            "bash": f"{name}() {{\n  compgen -W '{listed}' -- \"$1\"\n"
            + ("  compgen -f -- \"$1\"\n" if files else "") + "}",
            "zsh": f"{name}() {{\n  compadd -- {listed}\n" + ("  _files\n" if files else "") + "}",
            "fish": f"function {name}\n  string split ' ' '{listed}'\n"
            + ("  __fish_complete_path (commandline -ct)\n" if files else "") + "end",
        },
    }  # fmt: skip
