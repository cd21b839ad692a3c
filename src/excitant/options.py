"""Options that several commands share, as typed records; each knows what it stands for."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from os.path import isdir, isfile
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter
from cyclopts.validators import Number

import excitant as ex
from excitant.exceptions import BadInput, ExcitantError
from excitant.files import require_replaceable
from excitant.interrupts import check
from excitant.names import in_folder, one_line, printable
from excitant.surroundings import Surroundings

if TYPE_CHECKING:
    from cyclopts import Token

    from excitant.identify import Dataset, Recording
    from excitant.identify.faults import Checked
    from excitant.robots import Array, Robot


def _arms(_: object) -> Iterator[str]:
    yield from ex.builtin_robots()
    yield from (path.name for path in Path().iterdir())


def _effects(_: object) -> Iterator[str]:
    from excitant.robots.effects import EFFECTS

    yield from ("auto", *EFFECTS)


def _words(_: Any, tokens: Sequence[Token]) -> list[str]:
    return [
        word for token in tokens for word in token.value.replace(",", " ").split()
    ]


def _numbers(_: Any, tokens: Sequence[Token]) -> list[float]:
    return [float(word) for word in _words(_, tokens)]


def _comma(convert: Any) -> Parameter:
    return Parameter(converter=convert, n_tokens=1, allow_leading_hyphen=True)


_ROBOT = "Built-in name, URDF, xacro, MJCF or robot.yaml"
RobotName = Annotated[str, Parameter(completer=_arms, help=f"{_ROBOT}.")]
RobotOrFolder = Annotated[
    str,
    Parameter(
        completer=_arms,
        help=f"{_ROBOT}, a folder of a robot and recordings, or a bag.",
    ),
]
TrajectoryFile = Annotated[str, Parameter(help="CSV or JSON.")]
Effects = Annotated[list[str] | None, _comma(_words), Parameter(completer=_effects)]
Names = Annotated[list[str] | None, _comma(_words)]
Numbers = Annotated[list[float] | None, _comma(_numbers)]
Files = Annotated[list[str] | None, Parameter(consume_multiple=True)]
Seed = Annotated[int, Parameter(validator=Number(gte=0))]
OUTPUT = Parameter(name=("--output", "-o"))
Around = Annotated[Surroundings, Parameter(name="*")]


@Parameter(name="*")
@dataclass(frozen=True)
class Part:
    """Selection of a part of the robot."""

    joints: Names = None
    "Keep these joints, hold all others (J1,J2,...)."
    base: str | None = None
    "Keep only joints that this link carries."
    tip: str | None = None
    "Keep the joints on the way to this link; what hangs beyond it is carried along."
    lock: Names = None
    "Hold these joints at these positions [rad or m] (J1=Q,J2,...); default: at 0."
    xacro_arg: Files = None
    "Argument of a xacro file, NAME:=VALUE; once for each."
    package: Files = None
    "Folder of a package or of other files that the description asks for; once for each."

    def spec(self, path: str) -> Any:
        """The robot to load, with the part of it that is meant."""
        given = next(
            (name for name, value in vars(self).items() if value is not None),
            "",
        )
        if given and isdir(path) and not isfile(Path(path) / "metadata.yaml"):
            raise BadInput(
                f"{path}: a folder says itself which joints its robot has; leave "
                f"--{given.replace('_', '-')} out, or put it into a robot.yaml there"
            )
        return ex.robots.RobotSpec(
            path,
            None if self.joints is None else tuple(self.joints),
            self.base,
            self.tip,
            dict(_position(word) for word in self.lock or ()),
            dict(_assignment(word) for word in self.xacro_arg or ()),
            tuple(self.package or ()),
        )

    def robot(self, path: str) -> Robot:
        """The robot; its notes go to the error stream."""
        robot = ex.load_robot(self.spec(path))
        _say({robot.source: robot.notes})
        return robot

    def dataset(self, path: str, mapping: str | None) -> Dataset:
        """The robot with the recordings beside it."""
        dataset = ex.load_dataset(self.spec(path), columns=mapping)
        _say({dataset.robot.source: dataset.robot.notes})
        return dataset


def _position(word: str) -> tuple[str, float]:
    joint, _, value = word.partition("=")
    try:
        return joint, float(value or 0.0)
    except ValueError:
        raise BadInput(f"--lock: '{value}' of {joint} is not a number") from None


def _assignment(word: str) -> tuple[str, str]:
    name, sign, value = word.partition(":=")
    if not sign or not name.strip():
        raise BadInput(f"--xacro-arg '{word}': write it as NAME:=VALUE")
    return name.strip(), value.strip()


@Parameter(name="*")
@dataclass(frozen=True)
class Data:
    """Reading and judging of recordings."""

    map: str | None = None
    "YAML that says what the columns mean, in which units; default: as their names say."
    validate: Files = None
    "Hold-out recordings; default: the last 30 % of each recording."
    cutoff: float | None = None
    "Cut-off [Hz] of the torque filter; default: 10 Hz, at which accuracy is judged."
    repair: bool = False
    "Repair the faults of the recordings that can be repaired; else they are only reported."

    def read(
        self,
        dataset: Dataset,
        names: Sequence[str],
        others: Sequence[str] = (),
        *,
        held: bool = True,
    ) -> Readings:
        """Recordings to fit (all but others where none is named), and to judge on.

        Joints that stand in what is fitted are held, where they are not to be told of.
        """
        validate = self.validate or []
        checked = ex.identify.read_checked(
            dataset,
            names,
            without=[*validate, *others],
            repaired=self.repair,
            held=held,
        )
        judging = ex.identify.Checked([], {})
        if validate:
            judging = ex.identify.read_checked(
                dataset, validate, repaired=self.repair, beside=checked
            )
        return Readings(dataset, checked, judging)


class Readings:
    """Recordings of a command, with what is to be said of them.

    Attributes:
        robot: The robot, with the joints held that stand in what is fitted.
        fit: Recordings to fit.
        holdout: Recordings to judge on; empty when none is named.
        notes: Remarks on joints that stand, and on repairs, as sentences.
        entries: Entries of result.json: ``faults`` and ``import``.
    """

    def __init__(self, dataset: Dataset, checked: Checked, held: Checked) -> None:
        self._dataset = dataset
        self._parked = checked.parked or ex.identify.Parked(
            dataset.robot, dataset.robot
        )
        self.robot = self._parked.robot
        self.fit = list(checked.recordings)
        self.holdout = list(held.recordings)
        self.notes = [*self._parked.notes, *checked.notes, *held.notes]
        runs = (*self.fit, *self.holdout)
        notes = {run.name: run.notes for run in runs if run.notes}
        _say({self.robot.source: self._parked.notes})
        self.entries: dict[str, Any] = {
            "faults": [*checked.entries(), *held.entries()],
            "import": _say(notes),
        }

    @contextmanager
    def blamed(self) -> Iterator[None]:
        """Name with an error of what is computed a fault that makes every figure wrong."""
        try:
            yield
        except ExcitantError as error:
            faults = self.entries["faults"]
            wrong = [fault for fault in faults if ex.identify.proven([fault])]
            for fault in wrong[:1]:
                if fault["detail"] not in str(error):
                    error.add_note(_explanation(fault))
            raise

    def others(self, names: Sequence[str]) -> list[Recording]:
        """Further recordings beside those to fit."""
        dataset = replace(self._dataset, robot=self._parked.free)
        return self._parked.of(dataset.recordings(names))


@Parameter(name="*")
@dataclass(frozen=True)
class Run:
    """Output of results."""

    output: Annotated[str | None, OUTPUT] = None
    "Folder to write into; default: runs/<verb>-<robot>-<time>."
    json: bool = False
    "Print result.json and nothing else."

    def require(self) -> None:
        """Refuse, before the work begins, a folder that cannot be written into after it."""
        require_replaceable(self.output or "runs/1")

    def folder(self, result: Mapping[str, Any]) -> Path:
        """Folder of the run."""
        name = f"{result['verb']}-{in_folder(result.get('robot') or result['of'])}"
        return Path(self.output or f"runs/{name}-{time.strftime('%Y%m%d-%H%M%S')}")

    def finish(
        self,
        result: dict[str, Any],
        series: Mapping[str, Array],
        files: Mapping[str, str | bytes] | None = None,
        folder: Path | None = None,
        *,
        first: Sequence[str] = (),
        shown: Sequence[str] | None = None,
    ) -> None:
        """Save the run, then print lines, its summary and paths; or the JSON.

        Of several paths those of files ``shown`` are printed, where not all are.
        """
        check()
        folder = folder or self.folder(result)
        result["files"] = [str(folder / file) for file in files or ()]
        paths, page = ex.reports.save_run(folder, result, series, files or {})
        try:
            if self.json:
                print_json(ex.reports.as_saved(result, {})[0])
            else:
                terminal = bool(sys.stdout and sys.stdout.isatty())
                told = ex.reports.brief(page, terminal=terminal)
                print(
                    *(one_line(line) for line in first if line),
                    told,
                    sep="\n",
                    end="\n\n",
                )
                print_paths(
                    [path for path in paths if shown is None or path.name in shown]
                )
        except KeyboardInterrupt:
            raise KeyboardInterrupt(f"{folder} was written") from None


def _explanation(fault: Mapping[str, Any]) -> str:
    """What a fault, under its JSON names, may explain, and the repair that there is."""
    repair = f"; --repair {fault['repair']}" if fault["repair"] else ""
    return f"what may explain it, {fault['recording']}: {fault['detail']}{repair}"


def print_paths(paths: Sequence[Path]) -> None:
    """All paths, the report last because it is the one to open."""
    for path in sorted(paths, key=lambda path: path.suffix == ".html"):
        print(printable(str(path)))


def print_json(content: Mapping[str, Any]) -> None:
    """Print plain values as JSON, in ASCII: a terminal may have no code for others."""
    print(json.dumps(content, indent=1))


def _say(notes: Mapping[str, Sequence[str]]) -> dict[str, list[str]]:
    named: dict[str, list[str]] = {}
    for name, own in notes.items():
        for note in own:
            named.setdefault(note, []).append(name)
    for note, names in named.items():
        print(one_line(f"{', '.join(names)}: {note}"), file=sys.stderr)
    return {name: list(own) for name, own in notes.items()}
