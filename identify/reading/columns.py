"""Columns: which columns of a log hold time, positions, speeds and torques, in which units.

What the user's map says holds. Else a quantity is in the columns whose names say that it was
measured, and nothing that could change its meaning, where one complete set of them is there. Else
the log is refused with the map to write.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import yaml

from excitant.exceptions import BadInput, BadRecording
from excitant.identify.reading.cells import Frame
from excitant.identify.reading.names import (
    PARTS_OF_TIME,
    ColumnMap,
    Meaning,
    Unit,
    factor,
    meaning,
)
from excitant.identify.reading.tables import Table
from excitant.robots.robot import Robot

_SAID = {
    "t": "time",
    "q": "positions",
    "dq": "speeds",
    "tau": "torques",
    "i": "currents",
}
_NUMBERED = tuple(
    form.replace("0", first)
    for first in "01"
    for form in ("{}[{{0}}]", "{}_{{0}}", "{}.{{0}}", "{}{{0}}")
)
_NAMED = tuple(
    form.replace(".", sign)
    for sign in "._/ "
    for form in ("{{joint}}.{}", "{}.{{joint}}")
)
_FEW = 4  # columns that are named
_MOTORS = {"motor", "motors", "rotor", "rotors"}  # which turn otherwise than joints
_Key = str | int | None


@dataclass(frozen=True)
class Channel:
    """The columns of one quantity, in the order of the robot's joints."""

    columns: tuple[str, ...]
    factors: tuple[float, ...]  # SI units, with sign and drive gain, per logged unit
    shown: str = ""  # how the columns were understood; empty where there was no choice


@dataclass(frozen=True)
class Columns:
    """Column of each quantity of a recording."""

    t: tuple[str, ...]  # one column, or whole seconds and the nanoseconds to add
    t_unit: Unit | None  # None where the values say
    q: Channel
    dq: Channel | None  # where all joints' are there
    tau: Channel  # torques or currents
    unit: str  # of tau in SI: N·m or A
    notes: tuple[str, ...] = ()  # how the columns were understood, one line each

    @property
    def names(self) -> tuple[str, ...]:
        """All columns that are read."""
        speeds = self.dq.columns if self.dq else ()
        return (*self.t, *self.q.columns, *speeds, *self.tau.columns)


def with_names_of(table: Table, joints: Sequence[str]) -> Table:
    """A table with the robot's names of joints, where the log's differ by one prefix throughout.

    Either may have it, up to a sign as in ``left/`` or ``ur10_``; nothing changes where several
    prefixes fit, or none.
    """
    names = set(table.labels.values())
    if not joints or set(joints) <= names or len(joints) == 1 < len(names):
        return table
    ways = dict[
        str, dict[str, str]
    ]()  # by prefix: the robot's names by those of the log
    for name in names:
        longer, shorter = sorted((name, joints[0]), key=len)[::-1]
        prefix = longer.removesuffix(shorter)
        logged = {
            prefix + j if longer == name else j.removeprefix(prefix): j for j in joints
        }
        whole = len(logged) == len(joints) and set(logged) <= names
        if prefix != longer and not prefix[-1:].isalnum() and whole:
            ways[prefix] = logged
    if len(ways) != 1:
        return table
    ((prefix, own),) = ways.items()
    parts = ("position", "velocity", "effort")
    back = {
        f"{new}.{part}": f"{old}.{part}" for old, new in own.items() for part in parts
    }
    renamed = {old: new for new, old in back.items()}

    def frames(rows: int | None, columns: Sequence[str] | None) -> Iterator[Frame]:
        asked = None if columns is None else [back.get(name, name) for name in columns]
        for frame in table.frames(rows, asked):
            yield {renamed.get(name, name): cells for name, cells in frame.items()}

    note = (
        f"joints: the prefix '{prefix}' is taken off the names, as in {next(iter(own))}"
    )
    return replace(
        table,
        names=tuple(renamed.get(name, name) for name in table.names),
        frames=frames,
        labels={k: own.get(name, name) for k, name in table.labels.items()},
        notes=(*table.notes, note),
    )


def resolve(table: Table, robot: Robot | int, mapping: ColumnMap) -> Columns:
    """Columns by quantity: from a map, else from names where these are unambiguous.

    Raises:
        BadRecording: A column is missing, or could be several; says what to write.
        BadInput: The map does not fit the robot.
    """
    search = _Search(table, robot, mapping)
    t, t_shown = search.time()
    q = search.channel("q")
    role, tau = search.torque()
    dq = search.channel("dq", optional=True)
    if q is None:
        raise search.missing("q")
    unit = "A" if role == "i" else "N·m"
    gains = mapping.drive
    if role == "i" and gains is not None:
        search.expect_all("drive has {} gains", gains)
        factors = tuple(
            one * gain for one, gain in zip(tau.factors, gains, strict=True)
        )
        unit = "N·m"
        tau = Channel(tau.columns, factors, f"{tau.shown or 'i'}, × drive gain = N·m")
    shown = [s for s in (t_shown, q.shown, dq.shown if dq else "", tau.shown) if s]
    notes = [f"columns: {'; '.join(shown)}"] if shown else []
    read = Columns(t, search.t_unit, q, dq, tau, unit, (*notes, *search.notes))
    for column in read.names:
        if table.names.count(column) > 1:
            raise BadRecording(
                table.file, "is there twice; rename or remove one", column=column
            )
        if read.names.count(column) > 1:
            why = "is taken for two things; say which in a file for --map"
            raise BadRecording(table.file, why, column=column)
    return read


class _Group:
    """Columns of one quantity whose names differ by the joint only, under its number or name."""

    def __init__(
        self,
        search: _Search,
        role: str,
        found: Sequence[tuple[_Key, Meaning]],
        *words: str,
    ) -> None:
        self.role = role
        self.count = search.count
        self.words = words
        self.members: dict[_Key, Meaning] = {}
        self.twice = ""  # a column of a joint that has another one
        for joint, m in found:
            self.twice = m.column if joint in self.members else self.twice
            self.members.setdefault(joint, m)
        named = any(isinstance(joint, str) for joint in self.members)
        plain = re.compile(rf"{role}[1-9]\d*", re.ASCII)
        self.exact = not named and all(plain.fullmatch(m.column) for _, m in found)
        first = 0 if 0 in self.members else 1
        self.keys: list[_Key] = [first + k for k in range(self.count)]
        if named:
            self.keys = list(search.joints)
        elif self.count == 1 and None in self.members:
            self.keys = [None]
        # numbered columns of more joints are another arm's
        held = set(self.keys) <= set(self.members) and (
            named or len(self.members) == self.count
        )
        self.full = held and not self.twice

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns in the robot's order."""
        return tuple(self.members[key].column for key in self.keys)

    def check(self, file: str, prefix: str | None = None) -> None:
        """Refuse another number of joints, holes and surplus."""
        numbers = sorted(k for k in self.members if isinstance(k, int))
        count = len(numbers)
        expected = self.count
        absent = [key for key in self.keys if key not in self.members]
        column: str | None = None
        if self.twice:
            why = "names a joint that another column names too; rename or remove one"
            column = self.twice
        elif (
            self.role == "q"
            and numbers in (list(range(count)), list(range(1, count + 1)))
            and (0 < count != expected)
        ):
            first, last = (self.members[k].column for k in (numbers[0], numbers[-1]))
            span = f"s ({first}..{last})" if count > 1 else f" ({first})"
            why = (
                f"has {count} joint{span}, the robot has {expected}; "
                f"give the recording of this robot, or lock the joints that it leaves out"
            )
        elif absent:
            why = "is missing; rename or add it"
            like = next(iter(self.members.values()), Meaning(""))
            column = f"{_SAID[self.role]} of {absent[0]}"
            if prefix is not None:
                column = f"{prefix}{absent[0]}"
            elif not isinstance(absent[0], str) and like.joint is not None:
                column = f"{absent[0]}".join(like.column.rsplit(str(like.joint), 1))
        elif count > expected:
            why = (
                f"belongs to no joint: the robot has {expected}; remove it or give the "
                "right robot"
            )
            column = self.members[numbers[-1]].column
        else:
            return
        raise BadRecording(file, why, column=column)


class _Search:
    def __init__(self, table: Table, robot: Robot | int, mapping: ColumnMap) -> None:
        self.table = table
        self.mapping = mapping
        arm = None if isinstance(robot, int) else robot
        self.count = robot if isinstance(robot, int) else robot.nv
        self.joints: tuple[str, ...] = arm.joints if arm else ()
        self.revolute = (
            [bool(turns) for turns in arm.revolute] if arm else [None] * self.count
        )
        self.said = self.joints or tuple(str(k + 1) for k in range(self.count))
        labels = table.labels
        surplus = sorted(set(labels.values()) - set(self.joints)) if arm else []
        self.notes = (f"joints left out: {', '.join(surplus)}",) if surplus else ()
        absent = [name for name in self.joints if name not in labels.values()]
        if labels and absent and not mapping.columns:
            why = f"holds the joints {', '.join(labels.values())}; joint '{absent[0]}' of the robot"
            advice = "is not among them; give the right robot, or lock this joint"
            raise BadRecording(table.file, f"{why} {advice}")
        meanings = [self._meaning(column) for column in table.names]
        used = [m for m in meanings if m.role is not None and not m.commanded]
        alike: dict[tuple[Any, ...], list[tuple[_Key, Meaning]]] = {}
        for m in used:
            named = isinstance(m.joint, int) and bool(arm)
            joint = labels.get(m.joint, m.joint) if named else m.joint  # type: ignore[arg-type]
            sort = (m.role, m.words, isinstance(joint, str), m.measured, m.term)
            alike.setdefault(sort, []).append((joint, m))
        self.groups: dict[str, list[_Group]] = {}  # the most plausible first
        for (role, words, *_), found in alike.items():
            self.groups.setdefault(role, []).append(_Group(self, role, found, *words))
        for groups in self.groups.values():
            groups.sort(key=lambda group: (not group.exact, len(group.words)))
        self.arms = self._arms()
        self.times, unit = _times([m for m in used if m.role == "t"])
        said = mapping.units.get("t")
        self.t_unit: Unit | None = (
            unit if said is None or isinstance(said, tuple) else said
        )

    def _arms(self) -> set[tuple[str, ...]]:
        """Words beside quantity and joint: none, or else those that positions and torques share.

        They name the arm then, as in ``left_q1`` and ``left_tau1``, unless they name its motors.
        """
        roles = [self.groups.get(role, []) for role in ("q", "tau", "i")]
        q, tau, i = ({g.words for g in groups if g.full} for groups in roles)
        own = {words for words in q & (tau | i) if _MOTORS.isdisjoint(words)}
        plain = any(not g.words for groups in roles for g in groups)
        return {()} if plain or not own else own

    def _meaning(self, column: str) -> Meaning:
        joint, _, quantity = column.rpartition(".")
        if not self.table.joined or not joint:
            return meaning(column, self.joints)
        order = {label: k for k, label in self.table.labels.items()}
        return Meaning(
            column, meaning(quantity).role, joint if self.joints else order[joint]
        )

    def time(self) -> tuple[tuple[str, ...], str]:
        """The columns of time, and how they were understood."""
        if (given := self.mapping.columns.get("t")) is not None:
            columns = (given,) if isinstance(given, str) else given
            self._there(columns)
            if len(columns) > 2:
                why = "'t' is one column, or seconds and nanoseconds"
                raise BadInput(f"{self.mapping.source}: {why}")
        elif len(self.times) > 1:
            raise self._ambiguous("t", [", ".join(times) for times in self.times])
        elif self.times:
            columns = self.times[0]
        else:
            raise self.missing("t")
        if columns == ("t",) and self.t_unit is None:
            return columns, ""
        return columns, f"t = {' + '.join(columns)}{_in_unit(self.t_unit, columns[0])}"

    def channel(self, role: str, *, optional: bool = False) -> Channel | None:
        """Columns of a quantity; None when there are none, or not of all joints if optional."""
        hints: tuple[str | None, ...] = (None,) * self.count
        exact = False
        if (given := self.mapping.columns.get(role)) is not None:
            columns = self._given(role, given)
        else:
            group = self._chosen(role, optional)
            if group is None:
                return None
            columns = group.columns
            exact = group.exact
            hints = tuple(group.members[key].unit for key in group.keys)
        factors = self._factors(role, hints)
        units = self.mapping.units.get(role, hints[0])
        if exact and units is None:
            return Channel(columns, factors)
        told = self._shortened(columns)
        named = all(j in c for j, c in zip(self.joints, columns, strict=False))
        if role == "q" and not exact and not named:
            # by number: a wrong order is seen here
            pairs = zip(columns, self.joints, strict=True)
            told = ", ".join(f"{column} → {joint}" for column, joint in pairs)
        return Channel(
            columns, factors, f"{role} = {told}{_in_unit(units, columns[0])}"
        )

    def torque(self) -> tuple[str, Channel]:
        """Torques, or currents where there are none or the user says so."""
        prefix = self.mapping.torque
        said = [role for role in ("tau", "i") if role in self.mapping.columns]
        if len(said) == 2:
            why = "both 'tau' and 'i' are given; keep the measured one"
            raise BadInput(f"{self.mapping.source}: {why}")
        if not said and prefix is not None:
            role = "i" if prefix == "i" else "tau"
            form = rf"{re.escape(prefix)}([1-9]\d*)"
            found = (
                (name, re.fullmatch(form, name, re.ASCII)) for name in self.table.names
            )
            members = [
                (int(m[1]), Meaning(name, role, int(m[1]))) for name, m in found if m
            ]
            group = _Group(self, role, members)
            group.check(self.table.file, prefix)
            return role, Channel(
                group.columns, self._factors(role, (None,) * self.count)
            )
        exact = [
            r for r in ("tau", "i") if any(g.exact for g in self.groups.get(r, ()))
        ]
        for role in said or exact or ("tau", "i"):
            if (channel := self.channel(role)) is not None:
                return role, channel
        raise self.missing("tau")

    def expect_all(self, what: str, values: Sequence[object]) -> None:
        """Refuse a map that says something of another number of joints than the robot has."""
        if len(values) != self.count:
            said = what.format(len(values))
            raise BadInput(
                f"{self.mapping.source}: {said}, the robot has {self.count} joints"
            )

    def _chosen(self, role: str, optional: bool) -> _Group | None:
        """The columns that hold a quantity by their name alone, those named exactly first."""
        found = self.groups.get(role, [])
        groups = [g for g in found if g.exact] or [
            g for g in found if g.words in self.arms
        ]
        full = [group for group in groups if group.full]
        if len(full) == 1:
            return full[0]
        if optional or not groups:
            return None
        if full:
            raise self._ambiguous(role, [self._shortened(g.columns) for g in full])
        group = max(groups, key=lambda g: len(g.members))
        group.check(self.table.file)
        return group

    def _given(self, role: str, given: str | tuple[str, ...]) -> tuple[str, ...]:
        names = self.table.names
        one = self.count == 1
        columns = (given,) if isinstance(given, str) else given
        if isinstance(given, str) and "{" in given:
            columns = self._expanded(given)
        elif isinstance(given, str) and not (given in names and one):
            named = _NAMED if self.joints else ()
            forms = [
                self._expanded(form.format(given)) for form in (*named, *_NUMBERED)
            ]
            there = [form for form in forms if set(form) <= set(names)]
            columns = there[0] if there else columns if one else forms[-1]
        self.expect_all(f"'{role}' names {{}} columns", columns)
        self._there(columns)
        return columns

    def _expanded(self, pattern: str) -> tuple[str, ...]:
        """A pattern for every joint: ``{0}`` counts from 0, ``{1}`` from 1, ``{joint}`` names."""
        return tuple(
            pattern.replace("{0}", str(k))
            .replace("{1}", str(k + 1))
            .replace("{joint}", label)
            for k, label in enumerate(self.said)
        )

    def _there(self, columns: Sequence[str]) -> None:
        for column in columns:
            if column not in self.table.names:
                why = f"is not there, correct {self.mapping.source}; columns are {self._some()}"
                raise BadRecording(self.table.file, why, column=column)

    def _factors(self, role: str, hints: Sequence[str | None]) -> tuple[float, ...]:
        source = self.mapping.source
        given = self.mapping.units.get(role, tuple(hints))
        units = given if isinstance(given, tuple) else (given,) * self.count
        self.expect_all(f"units of {role}: {{}} given", units)
        signs = self.mapping.sign.get("tau" if role == "i" else role, {})
        for joint in signs:
            if joint not in self.said:
                known = ", ".join(self.said)
                raise BadInput(
                    f"{source}: sign of unknown joint '{joint}'; known: {known}"
                )
        factors = []
        for unit, label, turns in zip(units, self.said, self.revolute, strict=True):
            size = factor(role, unit, turns) if isinstance(unit, str) else unit or 1.0
            if size is None:
                kind = "turns" if turns else "slides"
                raise BadInput(
                    f"{source}: joint {label} {kind}: its {role} is not in {unit}"
                )
            factors.append(size * signs.get(label, 1.0))
        return tuple(factors)

    def _shortened(self, columns: Sequence[str]) -> str:
        """Columns for people: one pattern for joints' names, first and last of a rising number."""
        pattern = self._pattern(columns)
        if pattern is None or "{joint}" in pattern:
            return (
                ", ".join(columns)
                if pattern is None
                else pattern.replace("{joint}", "<joint>")
            )
        return f"{columns[0]} .. {columns[-1]}"

    def _pattern(self, columns: Sequence[str]) -> str | None:
        """Columns that differ by joint with ``{joint}``, ``{0}`` or ``{1}`` where they do."""
        before, found, after = columns[0].partition(self.said[0])
        if found and list(columns) == [
            f"{before}{name}{after}" for name in self.joints
        ]:
            return f"{before}{{joint}}{after}"
        for match in re.finditer(r"\d+", columns[0]) if len(columns) > 2 else ():
            head = columns[0][: match.start()]
            tail = columns[0][match.end() :]
            for first in (0, 1):
                if list(columns) == [
                    f"{head}{k + first}{tail}" for k in range(len(columns))
                ]:
                    return f"{head}{{{first}}}{tail}"
        return None

    def _some(self) -> str:
        """The first columns, of those whose names say nothing if there are any."""
        groups = [
            group for groups in self.groups.values() for group in groups if group.full
        ]
        known = {m.column for group in groups for m in group.members.values()}
        known |= {column for columns in self.times for column in columns}
        names = [
            name for name in self.table.names if name not in known
        ] or self.table.names
        return ", ".join(names[:_FEW]) + (", ..." if len(names) > _FEW else "")

    def _suggestion(self) -> str:
        """A ready column map on one line, as far as names say; ``?`` where they say nothing."""
        n = self.count
        width = len(self.table.names)
        if all(map(str.isdecimal, self.table.names)) and width in (
            1 + 2 * n,
            1 + 3 * n,
        ):
            order = ("q", "dq", "tau") if width > 1 + 2 * n else ("q", "tau")
            first = {role: 1 + k * n for k, role in enumerate(order)}
            spans = [f"{role}: {[*range(k, k + n)]}" for role, k in first.items()]
            return f"say which is which in a file for --map, such as {{t: 0, {', '.join(spans)}}}"
        t = list(self.times[0]) if self.times else ["?"]
        content: dict[str, object] = {"t": t[0] if len(t) == 1 else t}
        torque = next((role for role in ("tau", "i") if self.groups.get(role)), "tau")
        for role in ("q", torque):
            full = [g for g in self.groups.get(role, ()) if g.full]
            columns = full[0].columns if full else ("?",)
            content[role] = self._pattern(columns) or (list(columns) if full else "?")
        text: str = yaml.safe_dump(
            content,
            default_flow_style=True,
            sort_keys=False,
            width=1 << 20,
            allow_unicode=True,
        )
        return f"say which in a file for --map, such as {text.strip()}"

    def _ambiguous(self, role: str, spans: Sequence[str]) -> BadRecording:
        why = f"{_SAID[role]} could be {'; or '.join(spans)}: {self._suggestion()}"
        return BadRecording(self.table.file, why)

    def missing(self, role: str) -> BadRecording:
        """The refusal of a log without a quantity."""
        advice = f"there are {self._some()}; {self._suggestion()}"
        if role == "tau":
            why = f"no torque, neither 'tau1' [N·m] nor 'i1' [A]: {advice}"
            return BadRecording(self.table.file, why)
        if all(map(str.isdecimal, self.table.names)):
            why = f"its columns have no names: {self._suggestion()}"
            return BadRecording(self.table.file, why)
        column = "t" if role == "t" else "q1"
        why = f"is missing; rename or add it: {advice}"
        return BadRecording(self.table.file, why, column=column)


def _times(
    meanings: Sequence[Meaning],
) -> tuple[tuple[tuple[str, ...], ...], str | None]:
    """Candidates for time (a column, or seconds and nanoseconds), and the unit of the only one."""
    if any(m.column == "t" for m in meanings):
        return (("t",),), None
    alone = [m for m in meanings if m.joint is None]
    plain = [m for m in alone if not m.words]
    for better in (lambda m: m.term != "duration", lambda m: "header" in m.column):
        plain = [m for m in plain if better(m)] or plain
    seconds, nanoseconds = (
        [
            m
            for m in alone
            if len(m.words) == 1 and PARTS_OF_TIME.get(m.words[0]) == unit
        ]
        for unit in ("s", "ns")
    )
    if len(seconds) == len(nanoseconds) == 1:
        pair = (seconds[0].column, nanoseconds[0].column)
        return (pair, *((m.column,) for m in plain)), None
    some = [*plain, *seconds, *nanoseconds]
    unit = "s" if seconds else "ns" if nanoseconds else some[0].unit if some else None
    return tuple((m.column,) for m in some), unit if len(some) == 1 else None


def _in_unit(units: Unit | tuple[Unit | None, ...] | None, column: str) -> str:
    if units is None or (
        isinstance(units, str) and column.endswith((f"[{units}]", f"({units})"))
    ):
        return ""
    return f" [{', '.join(map(str, units)) if isinstance(units, tuple) else units}]"
