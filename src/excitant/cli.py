"""The command line: arguments, one error boundary, exit status."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from importlib import import_module
from importlib.metadata import version

from threadpoolctl import threadpool_limits

from excitant import __version__
from excitant.exceptions import ExcitantError

_SOLVERS = ("pin", "clarabel", "cvxpy", "numpy", "scipy")
_ABOUT_MOTION = ("design", "check", "simulate")
_ROBOT = "built-in name, URDF or robot.yaml"
_DATASET = f"{_ROBOT}, or a folder with dataset.json"


class _Help(argparse.RawDescriptionHelpFormatter):
    """Descriptions as written, so that examples keep their lines."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        arguments: Words after ``excitant``; those of the process when None.

    Returns:
        0 when done, 1 when refused or failed; wrong usage exits with 2.
    """
    args = _parser().parse_args(arguments)
    try:
        run = _command(args.verb)
        with threadpool_limits(1):  # many small matrices: threads cost more than they bring
            run(args)
    except ExcitantError as error:
        if args.debug:
            raise
        return _failed(str(error))
    except BrokenPipeError:  # the reader of a pipe has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except OSError as error:
        if args.debug:
            raise
        return _failed(f"{error.filename or 'file'}: {error.strerror or error}")
    except KeyboardInterrupt:
        return _failed("interrupted; nothing was written")
    return 0


def _command(verb: str) -> Callable[[argparse.Namespace], None]:
    """What carries a command out; imported when it is called, for help to come at once."""
    module = "motion_commands" if verb in _ABOUT_MOTION else "commands"
    run: Callable[[argparse.Namespace], None] = getattr(import_module(f"excitant.{module}"), verb)
    return run


def _failed(why: str) -> int:
    print(f"excitant: {why}", file=sys.stderr)
    return 1


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="excitant",
        formatter_class=_Help,
        description="Design the motion that makes a robot arm's dynamics visible, identify them, "
        "say what can be known,\nand name what the model still gets wrong.",
        epilog="example:\n  excitant demo --seed 3",
    )
    solvers = ", ".join(f"{name} {version(name)}" for name in _SOLVERS)
    parser.add_argument("--version", action="version", version=f"{__version__} ({solvers})")
    verbs = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    for add in (
        _demo,
        _robots,
        _design,
        _check,
        _simulate,
        _identify,
        _analyze,
        _diagnose,
        _report,
    ):
        add(verbs)
    return parser


_Verbs = argparse._SubParsersAction  # argparse has no public name for it


def _verb(
    verbs: _Verbs[argparse.ArgumentParser], name: str, summary: str, example: str
) -> argparse.ArgumentParser:
    verb = verbs.add_parser(
        name,
        help=summary,
        description=summary[0].upper() + summary[1:] + ".",
        epilog=f"example:\n  {example}",
        formatter_class=_Help,
    )
    verb.set_defaults(verb=name)
    verb.add_argument("--debug", action="store_true", help="show the traceback of an error")
    verb.add_argument("--json", action="store_true", help="print result.json and nothing else")
    return verb


def _output(verb: argparse.ArgumentParser) -> None:
    verb.add_argument(
        "-o", "--output", metavar="DIR", help="folder to write into (default: runs/<verb>-...)"
    )


def _demo(verbs: _Verbs[argparse.ArgumentParser]) -> None:
    verb = _verb(verbs, "demo", "the main job on a virtual arm that hides an effect",
                 "excitant demo --seed 3 -o runs/demo")  # fmt: skip
    verb.add_argument("--seed", type=_natural, default=0, help="draws the hidden effect")
    verb.add_argument("--robot", default="ur10", help=f"arm to use, {_ROBOT} (default: ur10)")
    _output(verb)


def _robots(verbs: _Verbs[argparse.ArgumentParser]) -> None:
    verb = _verb(verbs, "robots", "built-in arms, or one arm's joints, limits and parameters",
                 "excitant robots panda")  # fmt: skip
    verb.add_argument("name", nargs="?", metavar="ROBOT", help=_ROBOT)


def _design(verbs: _Verbs[argparse.ArgumentParser]) -> None:
    verb = _verb(verbs, "design", "an excitation trajectory within all limits",
                 "excitant design ur10 --duration 10 --harmonics 5 --time-limit 30")  # fmt: skip
    verb.add_argument("robot", metavar="ROBOT", help=_ROBOT)
    verb.add_argument("--duration", type=_span, default=10.0, metavar="S[:S]",
                      help="period [s], or the shortest and the longest to choose from "
                      "(default: 10)")  # fmt: skip
    verb.add_argument("--harmonics", type=_harmonics, default=5, metavar="H",
                      help="Fourier terms, or 'search' to add them while they pay "
                      "(default: 5)")  # fmt: skip
    verb.add_argument("--series", default="fourier", choices=("fourier", "spline"),
                      help="spline: B-splines of 2 H pieces, for tight cells")  # fmt: skip
    verb.add_argument("--max-frequency", type=float, default=2.5, metavar="HZ",
                      help="highest that a search for harmonics adds (default: 2.5)")  # fmt: skip
    verb.add_argument("--criterion", default="condition", choices=("condition", "d", "a", "e"))
    verb.add_argument("--columns", default="friction", choices=("friction", "inertial"),
                      help="what to make visible: all that identify estimates, or the links "
                      "only (default: friction)")  # fmt: skip
    verb.add_argument("--noise", type=_numbers, metavar="S1,S2,...",
                      help="torque noise of each joint, which weights its equations")  # fmt: skip
    verb.add_argument("--after", nargs="+", metavar="RECORDING",
                      help="recordings made already: design what should run next")  # fmt: skip
    verb.add_argument("--link-by-link", action="store_true",
                      help="one motion per link, from the last inward, each of this "
                      "duration")  # fmt: skip
    verb.add_argument("--limits", metavar="FILE", help="YAML or JSON with limits to use instead")
    verb.add_argument("--bound", action="store_true",
                      help="also a numerical lower bound on the condition number of any such "
                      "motion (a minute more)")  # fmt: skip
    _surroundings(verb)
    verb.add_argument("--from", dest="start", metavar="Q1,Q2,...",
                      help="present pose: writes approach.csv and return.csv too")  # fmt: skip
    verb.add_argument("--formats", metavar="NAME,...",
                      help="further files: ros2 (YAML), mcap, urscript, npz")  # fmt: skip
    verb.add_argument("--rate", type=float, default=100.0, help="rate of trajectory.csv [Hz]")
    verb.add_argument("--repeat", type=int, default=1, metavar="N",
                      help="periods in trajectory.csv, for averaging (default: 1)")  # fmt: skip
    verb.add_argument("--starts", type=int, help="number of searches (default: 16)")
    verb.add_argument("--jobs", type=int, help="processes (default: all processors)")
    verb.add_argument("--cluster", metavar="ADDRESS", help="Dask scheduler to search on, "
                      "such as tcp://10.0.0.5:8786")  # fmt: skip
    verb.add_argument("--seed", type=_natural, default=0)
    verb.add_argument("--time-limit", type=float, metavar="S", help="return the best so far [s]")
    _output(verb)


def _surroundings(verb: argparse.ArgumentParser) -> None:
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


def _check(verbs: _Verbs[argparse.ArgumentParser]) -> None:
    verb = _verb(verbs, "check", "limits between samples and conditioning of any trajectory",
                 "excitant check ur10 trajectory.csv")  # fmt: skip
    verb.add_argument("robot", metavar="ROBOT", help=_ROBOT)
    verb.add_argument("trajectory", metavar="TRAJECTORY", help="CSV or JSON")
    verb.add_argument("--limits", metavar="FILE", help="YAML or JSON with limits to use instead")
    _surroundings(verb)
    verb.add_argument("--columns", default="friction", choices=("friction", "inertial"))
    _output(verb)


def _simulate(verbs: _Verbs[argparse.ArgumentParser]) -> None:
    verb = _verb(verbs, "simulate", "what a virtual arm would record",
                 "excitant simulate ur10 trajectory.csv -o recording.parquet")  # fmt: skip
    verb.add_argument("robot", metavar="ROBOT", help=_ROBOT)
    verb.add_argument("trajectory", metavar="TRAJECTORY", help="CSV or JSON")
    verb.add_argument("-o", "--output", metavar="FILE", required=True, help=".parquet or .csv")
    verb.add_argument("--seed", type=_natural, default=0, help="draws noise and what is hidden")
    verb.add_argument("--hidden", action="store_true",
                      help="let the arm differ from its model: values off by some per cent, and "
                      "one effect that is not in the model")  # fmt: skip


def _columns(verb: argparse.ArgumentParser) -> None:
    verb.add_argument("--map", metavar="FILE",
                      help="YAML that says what the columns of the recordings mean, in which "
                      "units (default: as their names say)")  # fmt: skip


def _fit_options(verb: argparse.ArgumentParser) -> None:
    verb.add_argument("robot", metavar="ROBOT|DATASET", help=_DATASET)
    verb.add_argument("recordings", nargs="*", metavar="RECORDING",
                      help="Parquet, CSV, NPZ, MAT, ROS bag or MCAP; all of the folder when none "
                      "is named")  # fmt: skip
    _columns(verb)
    verb.add_argument("--validate", nargs="+", default=[], metavar="RECORDING",
                      help="hold-out (default: the last 30 %% of each recording)")  # fmt: skip
    verb.add_argument("--cutoff", type=float, metavar="HZ",
                      help="cut-off of the torque filter (default: 10 Hz, at which accuracy is "
                      "judged; identify chooses the fit's from the data)")  # fmt: skip
    verb.add_argument("--repair", action="store_true",
                      help="repair the faults of the recordings to fit that can be repaired, and "
                      "say so; without it they are only reported")  # fmt: skip
    _output(verb)


def _identify(verbs: _Verbs[argparse.ArgumentParser]) -> None:
    verb = _verb(verbs, "identify", "from recordings to a physically consistent model",
                 "excitant identify ur10 run1.parquet --validate run2.parquet")  # fmt: skip
    _fit_options(verb)
    verb.add_argument("--effects", metavar="NAME,...",
                      help="effects to estimate (default: viscous_friction,coulomb_friction,"
                      "torque_offset,rotor_inertia), or auto: these and what an inner hold-out "
                      "calls for")  # fmt: skip
    verb.add_argument("--estimator", metavar="NAME",
                      help="of the base parameters: ols, wls, irls (robust), gls (coloured noise), "
                      "iv and oe (noisy positions), tls, ml (periods averaged), or auto: "
                      "chosen on an inner hold-out (default: auto)")  # fmt: skip
    verb.add_argument("--knowledge", metavar="FILE",
                      help="YAML with what is known of the bodies: masses, their sum, where "
                      "centres of mass lie; and the kind of prior")  # fmt: skip
    verb.add_argument("--formats", metavar="NAME,...",
                      help="files of the model beside URDF and model.yaml: mjcf, sdf, python, c "
                      "(default: mjcf,sdf)")  # fmt: skip
    verb.add_argument("--force", action="store_true",
                      help="publish the model even if the given one predicts the hold-out "
                      "better")  # fmt: skip
    verb.add_argument("--online", action="store_true",
                      help="sample by sample, as in a control loop: estimates over time, and "
                      "where the motion did not excite enough")  # fmt: skip
    verb.add_argument("--link-by-link", action="store_true",
                      help="from the last link inward, each from its own joint's torque; one "
                      "joint at a time may move")  # fmt: skip
    verb.add_argument("--forgetting", type=float, metavar="S",
                      help="with --online: time constant of forgetting [s] (default: "
                      "nothing is forgotten)")  # fmt: skip
    verb.add_argument("--payload", action="store_true",
                      help="also what the last link carries in these recordings, on top of the "
                      "model given or of --unloaded")  # fmt: skip
    verb.add_argument("--unloaded", nargs="+", default=[], metavar="RECORDING",
                      help="with --payload: the arm without load, any motion")  # fmt: skip
    drive = verb.add_argument_group(
        "drive gains from a known payload (where currents are recorded)"
    )
    drive.add_argument("--payload-recording", nargs="+", default=[], metavar="RECORDING",
                       help="the arm with the payload, any motion")  # fmt: skip
    drive.add_argument("--payload-mass", type=float, metavar="KG", help="its mass [kg]")
    drive.add_argument("--payload-mass-std", type=float, default=0.0, metavar="KG",
                       help="standard deviation of the mass [kg] (default: 0)")  # fmt: skip
    drive.add_argument("--payload-com", type=_numbers, metavar="X,Y,Z",
                       help="its centre of mass in the frame of the last joint [m]; write "
                       "--payload-com=X,Y,Z where X is negative")  # fmt: skip


def _analyze(verbs: _Verbs[argparse.ArgumentParser]) -> None:
    verb = _verb(verbs, "analyze", "what can be known, link by link",
                 "excitant analyze panda --trajectory trajectory.csv")  # fmt: skip
    verb.add_argument("robot", metavar="ROBOT|DATASET", help=_DATASET)
    motion = verb.add_mutually_exclusive_group()
    motion.add_argument("--trajectory", metavar="FILE", help="how well this motion shows it")
    motion.add_argument("--recording", nargs="+", metavar="FILE", help="or these recordings")
    _columns(verb)
    verb.add_argument("--noise", type=_numbers, metavar="S1,S2,...",
                      help="with --trajectory: torque noise of each joint (default: 1 %% of its "
                      "limit)")  # fmt: skip
    verb.add_argument("--moving", type=_names, metavar="J1,J2,...",
                      help="joints that move (default: all, or as the motion says)")  # fmt: skip
    verb.add_argument("--measured", type=_names, metavar="J1,J2,...",
                      help="joints whose torque is measured (default: all)")  # fmt: skip
    verb.add_argument("--columns", default="friction", choices=("friction", "inertial"))
    _output(verb)


def _diagnose(verbs: _Verbs[argparse.ArgumentParser]) -> None:
    verb = _verb(verbs, "diagnose", "what the given model gets wrong, by cause",
                 "excitant diagnose ur10 run1.parquet --validate run2.parquet")  # fmt: skip
    _fit_options(verb)
    verb.add_argument("--no-experiments", action="store_true",
                      help="look for no motion that would settle what is undecided")  # fmt: skip
    verb.add_argument("--experiment-time", type=float, default=15.0, metavar="S",
                      help="time to look for such motions (default: 15)")  # fmt: skip


def _report(verbs: _Verbs[argparse.ArgumentParser]) -> None:
    verb = _verb(verbs, "report", "render the report of a run again",
                 "excitant report runs/demo")  # fmt: skip
    verb.add_argument("directory", metavar="DIR", help="folder of a run")


def _span(text: str) -> float | tuple[float, float]:
    shortest, _, longest = text.partition(":")
    return (float(shortest), float(longest)) if longest else float(text)


def _harmonics(text: str) -> int | None:
    return None if text == "search" else int(text)


def _numbers(text: str) -> list[float]:
    return [float(word) for word in text.split(",")]


def _names(text: str) -> list[str]:
    return [word.strip() for word in text.split(",") if word.strip()]


def _natural(text: str) -> int:
    value = int(text)
    if value < 0:
        raise argparse.ArgumentTypeError("must not be negative")
    return value
