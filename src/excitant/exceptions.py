"""Everything excitant refuses, each with its evidence and what to do about it."""

import copyreg
import difflib
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from excitant.names import one_line

EXTRAS = {"rosbags": "ros", "distributed": "cluster", "mujoco": "mjcf"}
"""Extras that bring a module that may be missing."""


class ExcitantError(Exception):
    """Base of all errors that a user can act on; its text is one line."""

    def __str__(self) -> str:
        return one_line(super().__str__())

    def __reduce__(self) -> tuple[Any, ...]:
        # an error of a worker process arrives whole, whatever its constructor takes
        return copyreg.__newobj__, (type(self), *self.args), vars(self)  # type: ignore[attr-defined]


class UnknownName(ExcitantError):
    """A name that is not in the list it is looked up in, of a kind such as ``"robot"``."""

    def __init__(self, kind: str, name: str, known: Iterable[str]) -> None:
        self.name, self.known = name, tuple(known)
        near = difflib.get_close_matches(name.lower(), self.known, n=1, cutoff=0.4)
        hint = (
            f"did you mean '{near[0]}'?"
            if near
            else f"known: {', '.join(self.known)}"
        )
        super().__init__(f"unknown {kind} '{name}': {hint}")

    @classmethod
    def refuse(cls, kind: str, names: Iterable[str], known: Iterable[str]) -> None:
        """Raise for the first of some names that is not known."""
        known = tuple(known)
        for name in names:
            if name not in known:
                raise cls(kind, name, known)


class BadRobot(ExcitantError):
    """A robot description, a file or a name, that cannot be used: what is wrong, what to do."""

    def __init__(self, source: str | Path, why: str) -> None:
        self.source = str(source)
        self.why = why
        super().__init__(f"robot {source}: {why}")


class BadRecording(ExcitantError):
    """A recording that cannot be used; rows count from 0 after the header."""

    def __init__(
        self,
        file: str | Path,
        why: str,
        *,
        row: int | None = None,
        column: str | None = None,
    ) -> None:
        self.file = str(file)
        self.why = why
        self.row = row
        self.column = column
        where = [f"column '{column}'"] if column is not None else []
        where += [f"row {row}"] if row is not None else []
        super().__init__(
            f"recording {file}{''.join(', ' + w for w in where)}: {why}"
        )


class FaultWarning(UserWarning):
    """A fault of a recording that was given to a function as it is."""


class BadInput(ExcitantError):
    """A file or option, other than a robot or recording, that cannot be used."""


class OutsideLimits(ExcitantError):
    """A motion beyond a limit: a joint's position, velocity, torque or the like, in SI units."""

    def __init__(
        self, joint: str, quantity: str, value: float, limit: float, time: float
    ) -> None:
        self.joint = joint
        self.quantity = quantity
        self.value = value
        self.limit = limit
        self.time = time
        super().__init__(
            f"{quantity} of {joint} comes to {value:.6g} at {time:.4g} s, beyond its limit of "
            f"{limit:.6g}"
        )


class Infeasible(ExcitantError):
    """A problem without a solution, or one whose solver did not find it, with the reason."""

    def __init__(self, problem: str, status: str) -> None:
        self.problem = problem
        self.status = status
        super().__init__(f"{problem}: {status}")


class RankDeficient(ExcitantError):
    """Data that leave the named parameters undetermined where unique values are required."""

    def __init__(self, names: Sequence[str], why: str) -> None:
        self.names = tuple(names)
        super().__init__(f"{why}: {', '.join(self.names)}")


class WorkerDied(ExcitantError):
    """A process of many ended before its work was done."""

    def __init__(self) -> None:
        super().__init__(
            "a worker process was ended from outside, as by a system that runs out of memory; "
            "free some, or use fewer processes (--jobs)"
        )


def line_of(error: BaseException) -> str:
    """An error of a command as one line."""
    message = interrupt_in(error)
    if message is not None:
        return one_line(f"interrupted; {message or 'nothing was written'}")
    if isinstance(error, ExcitantError):
        return "; ".join([str(error), *getattr(error, "__notes__", ())])
    if isinstance(error, OSError):
        return one_line(f"{error.filename or 'file'}: {error.strerror or error}")
    if isinstance(error, MemoryError):
        return "the memory of this machine does not suffice; free some, or give less data at once"
    name = str(getattr(error, "name", "")).partition(".")[0]
    if isinstance(error, ModuleNotFoundError) and name in EXTRAS:
        return f"this needs {name}: pip install 'excitant[{EXTRAS[name]}]'"
    what = one_line(f"{type(error).__name__}: {error}")
    return f"a bug ({what}); please run it again with --debug and report what it prints"


def interrupt_in(error: BaseException | None) -> str | None:
    """Message of the KeyboardInterrupt in the chain of an exception, or None."""
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return str(error)
        error = error.__cause__ or error.__context__
    return None
