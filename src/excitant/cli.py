"""The command line: one application, one error boundary, exit status."""

import inspect
import os
import re
import sys
import warnings
from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Any, Literal

from cyclopts import App, CycloptsError, Parameter
from cyclopts.help import DefaultFormatter, HelpPanel, PanelSpec, TableSpec

import excitant as ex
from excitant import fleets, motions, recordings
from excitant.exceptions import BadInput, FaultWarning, interrupt_in, line_of
from excitant.interrupts import check
from excitant.names import one_line
from excitant.options import Part, RobotName, Run, Seed, print_json, print_paths
from excitant.progress import progress_bar

_EVERYDAY = """--output --json --map --validate --repair --effects --joints --tip --trajectory
    --recording --no-experiments --duration --harmonics --limits --time-limit --speed --seed
    --hidden --robot --mass --jobs"""
"""Options that help shows first."""
_SOLVERS = ("pin", "clarabel", "numpy", "scipy")


def _version() -> str:
    from importlib.metadata import version

    solvers = ", ".join(f"{name} {version(name)}" for name in _SOLVERS)
    return f"{version('excitant')} ({solvers})"


def _default(value: object) -> object:
    return value if value not in (False, ()) else None


class _Grouped(DefaultFormatter):
    """Help in which options of every day stand apart from rare ones."""

    def __call__(self, console: Any, options: Any, panel: HelpPanel) -> None:
        """Print a panel, that of the options as two."""
        parts = [panel]
        if panel.title == "Parameters":
            everyday = {*_EVERYDAY.split()}
            daily = [entry for entry in panel.entries if everyday & {*entry.names}]
            rare = [entry for entry in panel.entries if entry not in daily]
            titled = (("Options", daily), ("Rare options", rare))
            parts = [
                panel.copy(title=title, entries=some)
                for title, some in titled
                if some
            ]
        for part in parts:
            super().__call__(console, options, part)


app = App(
    name="excitant",
    help="Design the motion that makes a robot arm's dynamics visible, identify them, say what can "
    "be known, and name what the model still gets wrong.",
    help_epilogue="--debug after any command shows the traceback of an error.",
    help_format="plaintext",
    help_formatter=_Grouped(
        panel_spec=PanelSpec(border_style="none"), table_spec=TableSpec()
    ),
    version=_version,
    default_parameter=Parameter(negative=(), show_default=_default),
    result_action="return_value",
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command: 0 when done and passed, 1 when refused, failed or not passed.

    Wrong usage exits with 2, also without a command, which shows the help; a command that was
    interrupted returns 130.

    Arguments are the words after ``excitant``; those of the process when None.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    debug = "--debug" in words
    # many small matrices: threads cost more than they bring, and change the last digits
    os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    warnings.simplefilter("ignore", FaultWarning)  # commands list faults themselves
    # what joblib says of an interrupt, which gets a line of its own
    warnings.filterwarnings("ignore", ".* tasks which .* cancelled")
    try:
        rest = [word for word in words if word != "--debug"]
        command, bound, _ = app.parse_args(
            rest, print_error=False, exit_on_error=False
        )
    except CycloptsError as error:
        verb = next((f" {word}" for word in words[:1] if word in app), "")
        print(
            f"excitant{verb}: {one_line(str(error))}\nusage: excitant{verb} --help",
            file=sys.stderr,
        )
        raise SystemExit(2) from None
    if not words:
        app.help_print()
        return 2
    try:
        check()
        run = bound.arguments.get("run", Run())
        if run.output is not None or command in _SAVED:
            run.require()
        status = command(*bound.args, **bound.kwargs) or 0
        print(end="", flush=True)  # here, where a full disk is told
        return status
    except BrokenPipeError:  # the reader of a pipe has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except BaseException as error:
        interrupted = interrupt_in(error) is not None
        if not interrupted and (debug or not isinstance(error, Exception)):
            raise
        print(f"excitant: {line_of(error)}", file=sys.stderr)
        return 130 if interrupted else 1


def demo(
    *,
    seed: Seed = 0,
    robot: RobotName = "ur10",
    part: Part = Part(),
    run: Run = Run(),
) -> None:
    """The main job on a virtual arm that hides an effect.

    Args:
        seed: Draws the hidden effect.
        robot: Arm to use: built-in name, URDF, xacro, MJCF or robot.yaml.
    """
    from excitant.demo import run_demo

    arm = part.robot(robot)
    with progress_bar("demo") as advance:
        result, series, files = run_demo(arm, seed, advance)
    shown = (*result["verdict"]["files"], "trajectory.csv", "report.html")
    run.finish(result, series, files, shown=shown)


def robots(
    robot: RobotName | None = None,
    /,
    *,
    mass: float | None = None,
    part: Part = Part(),
    run: Run = Run(),
) -> None:
    """Built-in arms, or one arm and what looks wrong in it.

    Args:
        robot: Built-in name, URDF, xacro, MJCF or robot.yaml.
        mass: What the whole arm weighs [kg], to compare with its description.
    """
    if robot is None:
        for option, value in (("-o", run.output), ("--mass", mass)):
            if value is not None:
                raise BadInput(
                    f"{option} is about one arm; name it, e.g. excitant robots ur10"
                )
        if run.json:
            arms = [
                asdict(arm) | {"joints": arm.joints, "mass": arm.moving_mass}
                for arm in ex.robots.catalogue()
            ]
            print_json({"verb": "robots", "robots": arms})
            return
        heads, *rows = ex.robots.catalogue_rows()
        columns = [(head, "number" if "[kg]" in head else "name") for head in heads]
        print("\n".join(ex.reports.table_lines(columns, rows)))
        return
    if mass is not None and not mass > 0:
        raise BadInput(
            f"--mass {mass:g} must be positive: what the whole arm weighs, in kg"
        )
    checked = ex.robots.ModelCheck(part.robot(robot), mass)
    result = checked.result()
    if robot in ex.builtin_robots():
        entry = ex.robots.arm_entry(robot)
        result |= {"kind": entry.kind, "sources": entry.sources}
    if run.output is not None:
        run.finish(result, checked.series())
    elif run.json:
        print_json(result)
    else:
        print(ex.reports.summary(ex.reports.page_of(result, {})), end="")


def report(*folders: str, run: Run = Run()) -> None:
    """Render the report of a run again, or compare runs.

    Args:
        folders: Folder of a run; of several runs of the same command: one page with all, and what
            differs.
    """
    if not folders:
        raise BadInput("name the folder of a run, or several to compare")
    if len(folders) > 1:
        runs = (
            ex.reports.SavedRun(folder, *ex.reports.load_run(folder))
            for folder in folders
        )
        run.finish(ex.reports.compare(*runs), {})
        return
    if run.output is not None:
        raise BadInput(
            "-o is where runs are compared; name a second run, or leave -o out"
        )
    _, series = ex.reports.load_run(folders[0])
    # the file's own text, so that it is written again to the byte
    result = ex.reports.read_result(folders[0])
    paths, _ = ex.reports.save_run(folders[0], result, series, {})
    if run.json:
        print_json(result)
    else:
        print_paths(paths)


def completion(shell: Literal["bash", "zsh", "fish"], /) -> None:
    """A script that completes commands at the TAB key."""
    script = app.generate_completion(prog_name="excitant", shell=shell)
    # bash: names of files, too
    print(script.replace("\ncomplete -F", "\ncomplete -o default -F"))


_VERBS: dict[Callable[..., Any], tuple[str, ...]] = {
    recordings.go: (
        "go my_arm.urdf bag/",
        "go my_folder -o runs/verdict",
        "go ur10 run1.csv --validate run2.csv --repair",
    ),
    demo: ("demo --seed 3 -o runs/demo", "demo --robot panda"),
    robots: (
        "robots",
        "robots panda",
        "robots my_arm.urdf --mass 18.4 -o runs/my_arm",
    ),
    motions.design: (
        "design ur10 --duration 10 --harmonics 5 --time-limit 30",
        "design my_arm.urdf --limits limits.yaml --criterion a -o runs/motion",
        "design panda --after run1.parquet --formats ros2,npz",
        "design ur10 --from 0,-1.57,1.57,0,0,0 --repeat 5 --formats ros2_client,urscript",
    ),
    motions.check: (
        "check ur10 trajectory.csv",
        "check my_arm.urdf trajectory.json --limits limits.yaml --json",
    ),
    motions.show: (
        "show ur10 trajectory.csv -o motion.html",
        "show my_arm.urdf trajectory.json --obstacles cell.yaml --floor 0 -o motion.html",
    ),
    motions.simulate: (
        "simulate ur10 trajectory.csv -o recording.parquet",
        "simulate ur10 trajectory.csv --hidden --seed 3 -o run1.csv",
    ),
    recordings.identify: (
        "identify ur10 run1.parquet --validate run2.parquet",
        "identify my_folder --effects auto --mujoco -o runs/model",
        "identify ur10 run1.parquet --payload --unloaded empty.parquet",
        "identify ur10 run1.parquet --online --forgetting 5",
    ),
    recordings.analyze: (
        "analyze panda",
        "analyze ur10 --trajectory trajectory.csv",
        "analyze ur10 --recording run1.parquet run2.parquet",
        "analyze cmu_dd_arm_ii --moving joint1,joint3",
    ),
    recordings.diagnose: (
        "diagnose ur10 run1.parquet --validate run2.parquet",
        "diagnose my_folder --no-experiments --repair",
        "diagnose my_arm.urdf run1.csv --map columns.yaml",
    ),
    motions.rehearse: (
        "rehearse ur10 trajectory.csv",
        "rehearse my_arm.urdf trajectory.json --limits limits.yaml --seed 3",
    ),
    fleets.fleet: (
        "fleet recordings/ -o runs/fleet",
        "fleet cell1 cell2 cell3 --cluster tcp://10.0.0.5:8786",
    ),
    report: (
        "report runs/demo",
        "report runs/before runs/after -o runs/both",
    ),
    completion: (
        "completion bash > ~/.local/share/bash-completion/completions/excitant",
        'completion zsh > "${fpath[1]}/_excitant"',
        "completion fish > ~/.config/fish/completions/excitant.fish",
    ),
}
"""The commands in the order of the work, each with examples."""
_SAVED = {verb for verb in _VERBS if "run" in inspect.signature(verb).parameters}
_SAVED -= {robots, report}
"""Commands that save a run, also where no folder is named."""

for _order, (_verb, _examples) in enumerate(_VERBS.items()):
    # help breaks lines itself
    _verb.__doc__ = re.sub(r"\n {8}", " ", inspect.getdoc(_verb) or "")
    _lines = "\n".join(f"  excitant {line}" for line in _examples)
    app.command(_verb, sort_key=_order, help_epilogue=f"examples:\n{_lines}")
