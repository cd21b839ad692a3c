"""The command line: one parser, one error boundary, exit status."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from importlib import import_module

from excitant import __version__, data_arguments, motion_arguments
from excitant.arguments import ROBOT, Parser, Verbs, natural, new_verb, output_option
from excitant.exceptions import ExcitantError
from excitant.robot_arguments import part_options

_SOLVERS = ("pin", "clarabel", "cvxpy", "numpy", "scipy")
_MODULES = {
    "design": "design_command",
    "check": "motion_commands",
    "simulate": "motion_commands",
    "identify": "identify_command",
    "rehearse": "rehearse_command",
    "completion": "completion",
    "robots": "robot_commands",
}
"""Where a command is carried out, when not in ``commands``."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        arguments: Words after ``excitant``; those of the process when None.

    Returns:
        0 when done, 1 when refused, failed or not passed; wrong usage exits with 2.
    """
    debug = False
    try:
        args = parser().parse_args(arguments)
        debug = args.debug
        return _run(args)
    except BrokenPipeError:  # the reader of a pipe has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except KeyboardInterrupt:
        return _failed("interrupted; nothing was written")
    except Exception as error:
        if _interrupted(error):
            return _failed("interrupted; nothing was written")
        if debug:
            raise
        return _failed(_line(error))


def _run(args: argparse.Namespace) -> int:
    """Carry out a command; its module is imported now, for help to come at once."""
    module = import_module(f"excitant.{_MODULES.get(args.verb, 'commands')}")
    run: Callable[[argparse.Namespace], int | None] = getattr(module, args.verb)
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1):  # many small matrices: threads cost more than they bring
        return run(args) or 0


def _line(error: Exception) -> str:
    """What went wrong, in a line."""
    if isinstance(error, ExcitantError):
        return str(error)
    if isinstance(error, OSError):
        return f"{error.filename or 'file'}: {error.strerror or error}"
    what = " ".join(f"{type(error).__name__}: {error}".split())
    return f"a bug ({what}); please run it again with --debug and report what it prints"


def _interrupted(error: BaseException | None) -> bool:
    """Whether Ctrl-C is behind an error that a library made of it."""
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return True
        error = error.__cause__ or error.__context__
    return False


def _failed(why: str) -> int:
    print(f"excitant: {why}", file=sys.stderr)
    return 1


class _Version(argparse.Action):
    """Prints versions; they are looked up only when asked for."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from importlib.metadata import version

        solvers = ", ".join(f"{name} {version(name)}" for name in _SOLVERS)
        print(f"{__version__} ({solvers})")
        parser.exit()


def parser() -> Parser:
    """The parser of all commands."""
    top = Parser(
        prog="excitant",
        description="Design the motion that makes a robot arm's dynamics visible, identify them, "
        "say what can be known,\nand name what the model still gets wrong.",
        epilog="examples:\n  excitant demo --seed 3\n  excitant design --help",
    )
    top.add_argument("--version", action=_Version, nargs=0, default=argparse.SUPPRESS,
                     help="show the versions of excitant and its solvers")  # fmt: skip
    top.add_argument("--debug", action="store_true", help="show the traceback of an error")
    verbs = top.add_subparsers(title="commands", required=True, metavar="COMMAND")
    for add in (
        _demo,
        _robots,
        motion_arguments.design,
        motion_arguments.check,
        motion_arguments.simulate,
        motion_arguments.rehearse,
        data_arguments.identify,
        data_arguments.analyze,
        data_arguments.diagnose,
        _report,
        _completion,
    ):
        add(verbs)
    return top


def _demo(verbs: Verbs[Parser]) -> None:
    verb = new_verb(verbs, "demo", "the main job on a virtual arm that hides an effect",
                    "excitant demo --seed 3 -o runs/demo",
                    "excitant demo --robot panda")  # fmt: skip
    verb.add_argument("--seed", type=natural, default=0, help="draws the hidden effect")
    verb.add_argument("--robot", default="ur10", metavar="ROBOT",
                      help=f"arm to use, {ROBOT} (default: ur10)")  # fmt: skip
    part_options(verb)
    output_option(verb)


def _robots(verbs: Verbs[Parser]) -> None:
    verb = new_verb(verbs, "robots", "built-in arms, or one arm and what looks wrong in it",
                    "excitant robots",
                    "excitant robots panda",
                    "excitant robots my_arm.urdf --mass 18.4 -o runs/my_arm")  # fmt: skip
    verb.add_argument("name", nargs="?", metavar="ROBOT", help=ROBOT)
    part_options(verb)
    verb.add_argument("--mass", type=float, metavar="KG",
                      help="what the whole arm weighs, to compare with its "
                      "description")  # fmt: skip
    verb.add_argument("-o", "--output", metavar="DIR",
                      help="folder to write a page with a picture of the arm into")  # fmt: skip


def _report(verbs: Verbs[Parser]) -> None:
    verb = new_verb(verbs, "report", "render the report of a run again, or compare two runs",
                    "excitant report runs/demo",
                    "excitant report runs/before runs/after -o runs/both")  # fmt: skip
    verb.add_argument("directory", metavar="DIR", help="folder of a run")
    verb.add_argument("other", nargs="?", metavar="OTHER",
                      help="folder of another run of the same command: one page with both, and "
                      "what differs")  # fmt: skip
    output_option(verb)


def _completion(verbs: Verbs[Parser]) -> None:
    verb = new_verb(verbs, "completion", "a script that completes commands at the TAB key",
                    "excitant completion bash > "
                    "~/.local/share/bash-completion/completions/excitant",
                    'excitant completion zsh > "${fpath[1]}/_excitant"',
                    "excitant completion fish > ~/.config/fish/completions/excitant.fish",
                    result=False)  # fmt: skip
    verb.add_argument("shell", choices=("bash", "zsh", "fish"))
