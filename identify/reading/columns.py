"""Columns: which columns of a log hold time, positions, speeds and torques, in which units.

The user's map has the last word. Without one, a quantity is in the columns whose names say that it
was measured, and nothing that could change its meaning, where one complete set of them is there.
Otherwise the log is refused with the map to write.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from typing import Any, TypeVar

import numpy as np

from excitant.exceptions import BadInput, BadRecording
from excitant.identify.reading.cells import keys_of
from excitant.identify.reading.mapping import ColumnMap, OfJoints
from excitant.identify.reading.names import PARTS_OF_TIME, Meaning, meaning
from excitant.identify.reading.tables import Table, timed
from excitant.identify.reading.units import Unit, factor
from excitant.robots.motion import Array
from excitant.robots.robot import Robot
from excitant.robots.schema import in_one_line

_PLURALS = {
    "t": "time",
    "q": "positions",
    "dq": "speeds",
    "tau": "torques",
    "i": "currents",
}
_FORMS = (
    *("{joint}.{}", "{}.{joint}", "{joint}_{}", "{}_{joint}"),
    *("{joint}/{}", "{}/{joint}", "{joint} {}", "{} {joint}"),
    *("{}[{0}]", "{}_{0}", "{}.{0}", "{}{0}"),
    *("{}[{1}]", "{}_{1}", "{}.{1}", "{}{1}"),
)
"""Patterns of columns whose names have a text ``{}`` in common, as `ColumnMap.columns` has them."""
_NAMED_AT_MOST = 4  # columns that a refusal names
_MOTORS = {"motor", "motors", "rotor", "rotors"}  # turn otherwise than joints
_BY_NUMBER = "rename one, or give columns by number, from 0, in a file for --map"
_RATE = "the rate of the rows [Hz]"
_ADVICE = "say which in a file for --map, such as"
_Key = str | int | None
_T = TypeVar("_T")


@dataclass(frozen=True)
class Channel:
    """The columns of one quantity, in the order of the robot's joints."""

    role: str  # q, dq, tau or i
    columns: tuple[str, ...]
    # SI units, with sign, per logged unit
    factors: Array
    offsets: Array  # in logged units, added first
    # of the drives [N·m/A], where currents become torques; else ones
    gains: Array
    # coordinates of the model by those that are logged; None where they are the same
    coupling: Array | None = None
    # how the columns were understood; empty where there was no choice
    note: str = ""

    def in_si_units(self, logged: Sequence[Array]) -> Array:
        """Values of the joints, shape (n, nv), of those in its columns."""
        x = (np.column_stack(logged) + self.offsets) * self.factors * self.gains
        if self.coupling is None:
            return np.asarray(x)
        # what cannot be read stays in the joints that it is part of
        parts = [row != 0 for row in self.coupling]
        axes = zip(parts, self.coupling, strict=True)
        return np.column_stack([x[:, part] @ row[part] for part, row in axes])


@dataclass(frozen=True)
class Columns:
    """Column of each quantity of a recording."""

    t: tuple[str, ...]  # one column, or whole seconds and the nanoseconds to add
    t_unit: Unit | None  # None where the values say
    rate: float | None  # of rows that have no column of time [Hz]
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


def _aliases(
    logged: Iterable[str], joints: Sequence[str]
) -> tuple[str, dict[str, str]]:
    """A prefix by which a log's names of joints differ, and the robot's name by the log's.

    Either may have it, up to a sign as in ``left/`` or ``ur10_``. Nothing where names agree, where
    several prefixes fit, or none.
    """
    names = set(logged)
    if not joints or set(joints) <= names or len(joints) == 1 < len(names):
        return "", {}
    fitting = dict[str, dict[str, str]]()
    for name in names:
        shorter, longer = sorted((name, joints[0]), key=len)
        prefix = longer.removesuffix(shorter)
        if prefix == longer or prefix[-1:].isalnum():
            continue
        with_prefix = longer == name
        logged_as = [
            prefix + j if with_prefix else j.removeprefix(prefix) for j in joints
        ]
        if len({*logged_as}) == len(joints) and {*logged_as} <= names:
            fitting[prefix] = dict(zip(logged_as, joints, strict=True))
    return next(iter(fitting.items())) if len(fitting) == 1 else ("", {})


def resolve(
    table: Table, robot: Robot | int, mapping: ColumnMap
) -> tuple[Table, Columns]:
    """The table, with time where a map gives its rate, and its columns by quantity.

    They are those of a map, else those whose names are unambiguous.

    Raises:
        BadRecording: A column is missing, or could be several; says what to write.
        BadInput: The map does not fit the robot.
    """
    if mapping.rate is not None:
        table = timed(table, mapping.rate)
        columns = {**mapping.columns, "t": table.names[-1]}
        units = {**mapping.units, "t": "s"}
        mapping = replace(mapping, columns=columns, units=units)
    search = _Search(table, robot, mapping)
    t, t_unit, t_note = search.time()
    q = search.channel("q")
    tau = search.torque()
    dq = search.channel("dq", optional=True)
    if q is None:
        raise search.missing("q")
    unit = "A" if tau.role == "i" and mapping.drive is None else "N·m"
    notes = [
        note for note in (t_note, q.note, dq.note if dq else "", tau.note) if note
    ]
    understood = [f"columns: {'; '.join(notes)}"] if notes else []
    found = Columns(
        t,
        t_unit,
        mapping.rate,
        q,
        dq,
        tau,
        unit,
        (*understood, *search.notes),
    )
    for name in found.names:
        if table.names.count(name) > 1:
            why = f"is there twice; {_BY_NUMBER}"
            raise BadRecording(table.file, why, column=name)
        if found.names.count(name) > 1:
            why = "is taken for two things; say which in a file for --map"
            raise BadRecording(table.file, why, column=name)
    return table, found


class _Group:
    """Columns of one quantity whose names differ by the joint only, under its number or name.

    Attributes:
        columns: Columns in the robot's order; None where not each joint has one.
    """

    def __init__(
        self,
        role: str,
        members: Sequence[tuple[_Key, Meaning]],
        joints: Sequence[str],
        count: int,
        prefix: str,
    ) -> None:
        self.role = role
        self.words = members[0][1].words
        self.members: dict[_Key, Meaning] = {}
        for key, m in members:
            self.members.setdefault(key, m)
        self.doubles = [m for key, m in members if self.members[key] is not m]
        plain = re.compile(rf"{re.escape(prefix)}[1-9]\d*", re.ASCII)
        named = any(isinstance(key, str) for key in self.members)
        self.exact = not named and all(
            plain.fullmatch(m.column) for _, m in members
        )
        first = 0 if 0 in self.members else 1
        self.keys: list[_Key] = [*range(first, first + count)]
        if named:
            self.keys = [*joints]
        elif count == 1 and None in self.members:
            self.keys = [None]
        # numbered columns of more joints are another arm's
        another = not named and len(self.members) != count
        complete = set(self.keys) <= set(self.members)
        self.full = complete and not another and not self.doubles

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns in the robot's order."""
        return tuple(self.members[key].column for key in self.keys)

    def refusal(self, file: str) -> BadRecording | None:
        """What a group lacks, or has too much, to hold one column of each joint."""
        numbers = sorted(key for key in self.members if isinstance(key, int))
        absent = [key for key in self.keys if key not in self.members]
        from_zero = numbers == [*range(len(numbers))]
        gapless = from_zero or numbers == [*range(1, len(numbers) + 1)]
        expected = len(self.keys)
        if self.doubles:
            why = f"names a joint that another column names too; {_BY_NUMBER}"
            return BadRecording(file, why, column=self.doubles[-1].column)
        if self.role == "q" and gapless and 0 < len(numbers) != expected:
            first, last = (
                self.members[k].column for k in (numbers[0], numbers[-1])
            )
            span = f"s ({first}..{last})" if len(numbers) > 1 else f" ({first})"
            why = (
                f"has {len(numbers)} joint{span}, the robot has {expected}; "
                f"give the recording of this robot, or lock the joints that it leaves out"
            )
            return BadRecording(file, why)
        if absent:
            like = next(iter(self.members.values()))
            column = f"{_PLURALS[self.role]} of {absent[0]}"
            if not isinstance(absent[0], str) and like.joint is not None:
                column = f"{absent[0]}".join(like.column.rsplit(str(like.joint), 1))
            return BadRecording(file, "is missing; rename or add it", column=column)
        if len(numbers) <= expected:
            return None
        why = f"belongs to no joint: the robot has {expected}; remove it or give the right robot"
        return BadRecording(file, why, column=self.members[numbers[-1]].column)


class _Search:
    """What the names of a table, the joints of a robot and a map say of the columns."""

    def __init__(
        self, table: Table, robot: Robot | int, mapping: ColumnMap
    ) -> None:
        self.table = table
        self.mapping = mapping
        if isinstance(robot, int):
            self.joints: tuple[str, ...] = ()
            self.labels = tuple(str(k + 1) for k in range(robot))
            self.revolute: list[bool | None] = [None] * robot
        else:
            self.joints = self.labels = robot.joints
            self.revolute = robot.revolute.tolist()
        self.count = len(self.labels)
        prefix, self.aliases = _aliases(table.labels.values(), self.joints)
        self.notes = list[str]()
        if self.aliases:
            example = next(iter(self.aliases))
            note = f"joints: the prefix '{prefix}' is taken off the names, as in {example}"
            self.notes.append(note)
        logged_as = {joint: name for name, joint in self.aliases.items()}
        self.logged_as = [logged_as.get(label, label) for label in self.labels]
        self.numbered = {k: self._joint(name) for k, name in table.labels.items()}
        logged = [*self.numbered.values()]
        if self.joints and (surplus := sorted({*logged} - {*self.joints})):
            self.notes.append(f"joints left out: {', '.join(surplus)}")
        absent = [name for name in self.joints if name not in logged]
        if logged and absent and not mapping.columns:
            why = (
                f"holds the joints {', '.join(logged)}; joint '{absent[0]}' of the robot is not "
                "among them; give the right robot, or lock this joint"
            )
            raise BadRecording(table.file, why)
        mapped = [role for role in ("tau", "i") if role in mapping.columns]
        if len(mapped) == 2:
            why = "both 'tau' and 'i' are given; keep the measured one"
            raise BadInput(f"{mapping.source}: {why}")
        self.prefix = None if mapped else mapping.torque
        self.mapped_torque = mapped
        understood = [
            m for m in map(self._meaning, table.names) if m.role and not m.commanded
        ]
        # what is fed back beside a measurement is a term of the controller
        measured = {m.role for m in understood if m.measured and not m.fed_back}
        self.meanings = [
            m for m in understood if not (m.fed_back and m.role in measured)
        ]

    @cached_property
    def times(self) -> tuple[tuple[tuple[str, ...], ...], str | None]:
        """Candidates for time, and the unit of the only one; see `_times`."""
        return _times([m for m in self.meanings if m.role == "t"])

    @cached_property
    def groups(self) -> dict[str, list[_Group]]:
        """Groups of columns by quantity, the most plausible first."""
        alike: dict[tuple[Any, ...], list[tuple[_Key, Meaning]]] = {}
        for m in self.meanings:
            key = m.joint
            if isinstance(key, int) and self.joints:
                key = self.numbered.get(key, key)
            kind = (m.role, m.words, isinstance(key, str), m.measured, m.term)
            alike.setdefault(kind, []).append((key, m))
        groups: dict[str, list[_Group]] = {}
        for (role, *_), members in alike.items():
            prefix = self.prefix if self.prefix and role in ("tau", "i") else role
            group = _Group(role, members, self.joints, self.count, prefix)
            groups.setdefault(role, []).append(group)
        for several in groups.values():
            several.sort(key=lambda group: (not group.exact, len(group.words)))
        return groups

    @cached_property
    def arms(self) -> set[tuple[str, ...]]:
        """Words beside quantity and joint: none, or else those that positions and torques share.

        They name the arm then, as in ``left_q1`` and ``left_tau1``, unless they name its motors.
        """
        several = [self.groups.get(role, []) for role in ("q", "tau", "i")]
        q, tau, i = ({g.words for g in groups if g.full} for groups in several)
        shared = {words for words in q & (tau | i) if _MOTORS.isdisjoint(words)}
        plain = any(not g.words for groups in several for g in groups)
        return {()} if plain or not shared else shared

    def _joint(self, name: str) -> str:
        """The robot's name of a joint of the log."""
        return self.aliases.get(name, name)

    def _meaning(self, column: str) -> Meaning:
        joint, _, quantity = column.rpartition(".")
        if self.table.joined and joint:
            order = [*self.table.labels.values()]
            key = self._joint(joint) if self.joints else order.index(joint)
            return Meaning(column, meaning(quantity).role, key)
        if self.prefix is not None:
            form = rf"{re.escape(self.prefix)}([1-9]\d*)"
            if torque := re.fullmatch(form, column, re.ASCII):
                role = "i" if self.prefix == "i" else "tau"
                return Meaning(column, role, int(torque[1]))
        name = (
            f"{self.aliases[joint]}.{quantity}" if joint in self.aliases else column
        )
        return replace(meaning(name, self.joints), column=column)

    def time(self) -> tuple[tuple[str, ...], Unit | None, str]:
        """The columns of time, their unit, and how they were understood."""
        candidates, candidates_unit = self.times
        if (mapped := self.mapping.columns.get("t")) is not None:
            columns = self._there((mapped,) if isinstance(mapped, str) else mapped)
            if len(columns) > 2:
                why = "'t' is one column, or seconds and nanoseconds"
                raise BadInput(f"{self.mapping.source}: {why}")
        elif len(candidates) > 1:
            raise self._ambiguous("t", [", ".join(names) for names in candidates])
        elif candidates:
            columns = candidates[0]
        else:
            raise self.missing("t")
        of_name = candidates_unit if columns in candidates else None
        if len(columns) == 1:
            of_name = of_name or _unit_in(columns[0], "t")
        unit: Any = self.mapping.units.get("t", of_name)
        note = f"t = {' + '.join(columns)}{_in_unit([unit], columns[0])}"
        return columns, unit, "" if columns == ("t",) and unit is None else note

    def channel(self, role: str, *, optional: bool = False) -> Channel | None:
        """Columns of a quantity; None when there are none, or not of all joints if optional."""
        exact = False
        mapped = self.mapping.columns.get(role)
        if mapped is not None:
            columns = self._mapped(role, mapped)
            pairs = zip(columns, self.revolute, strict=True)
            hints = [_unit_in(column, role, turns) for column, turns in pairs]
        else:
            group = self._chosen(role, optional)
            if group is None:
                return None
            columns = group.columns
            exact = group.exact
            hints = [group.members[key].unit for key in group.keys]
        name = "tau" if role == "i" else role
        given = self.mapping
        units = self._of_joints(f"units of {role}", given.units.get(role), hints)
        none = [0.0] * self.count
        offsets = self._of_joints(f"offset of {role}", given.offset.get(role), none)
        ones = [1.0] * self.count
        signs = self._of_joints("sign", given.sign.get(name), ones)
        drive = given.drive if role == "i" else None
        gains = self._of_joints("drive", drive, ones)
        channel = Channel(
            role,
            columns,
            np.multiply(self._sizes(role, units), signs),
            np.array(offsets),
            np.array(gains),
            self._coupling(name),
        )
        said = [
            f", offset {_alike(offsets)}" * any(offsets),
            ", × drive gain = N·m" * bool(drive),
        ]
        if exact and not any((*units, *said)):
            return channel
        words = self._shortened(columns)
        named = all(map(str.__contains__, columns, self.logged_as))
        if role == "q" and self.joints and not exact and not named:
            # by number: a wrong order is seen here
            by_joint = zip(columns, self.joints, strict=True)
            words = ", ".join(f"{column} → {joint}" for column, joint in by_joint)
        note = f"{role} = {words}{_in_unit(units, columns[0])}{''.join(said)}"
        return replace(channel, note=note)

    def torque(self) -> Channel:
        """Torques, or currents where there are none or the user says so."""
        both = ("tau", "i")
        exact = [r for r in both if any(g.exact for g in self.groups.get(r, ()))]
        absent = self.prefix is not None and not exact
        for role in self.mapped_torque or exact or both * (not absent):
            if (channel := self.channel(role)) is not None:
                other = "tau" if role == "i" else "i"
                if other in self.mapping.offset:
                    why = f"offset of {other}, but the log has {role}; correct one"
                    raise BadInput(f"{self.mapping.source}: {why}")
                return channel
        raise self.missing("tau")

    def _expect_all(self, what: str, values: Sequence[object]) -> None:
        """Refuse a map that says something of another number of joints than the robot has."""
        if len(values) != self.count:
            why = f"{what.format(len(values))}, the robot has {self.count} joints"
            raise BadInput(f"{self.mapping.source}: {why}")

    def _expect_joints(self, what: str, joints: Iterable[str]) -> None:
        """Refuse a map that says something of a joint that the robot has not."""
        for joint in joints:
            if joint not in self.labels:
                why = f"unknown joint '{joint}'; known: {', '.join(self.labels)}"
                raise BadInput(f"{self.mapping.source}: {what}: {why}")

    def _of_joints(
        self, what: str, given: OfJoints[_T] | None, default: Sequence[_T]
    ) -> list[_T]:
        """What a map gives of each joint, the default where it gives nothing."""
        if given is None:
            return [*default]
        if isinstance(given, Mapping):
            self._expect_joints(what, given)
            pairs = zip(self.labels, default, strict=True)
            return [given.get(joint, value) for joint, value in pairs]
        values = given if isinstance(given, tuple) else (given,) * self.count
        self._expect_all(f"{what}: {{}} given", values)
        return [*values]

    def _chosen(self, role: str, optional: bool) -> _Group | None:
        """The columns that hold a quantity by their name alone, those named exactly first."""
        groups = self.groups.get(role, [])
        exact = [g for g in groups if g.exact]
        groups = exact or [g for g in groups if g.words in self.arms]
        full = [group for group in groups if group.full]
        if len(full) == 1:
            return full[0]
        if optional or not groups:
            return None
        if full:
            raise self._ambiguous(role, [self._shortened(g.columns) for g in full])
        largest = max(groups, key=lambda g: len(g.members))
        if (refusal := largest.refusal(self.table.file)) is not None:
            raise refusal
        return largest

    def _mapped(self, role: str, mapped: str | tuple[str, ...]) -> tuple[str, ...]:
        """The columns that a map names for a quantity."""
        if not isinstance(mapped, str):
            columns = mapped
        elif "{" in mapped:
            columns = self._expanded(mapped)
        elif self.count == 1 and mapped in self.table.names:
            columns = (mapped,)
        else:
            forms = [form.replace("{}", mapped) for form in _FORMS]
            usable = [f for f in forms if self.joints or "{joint}" not in f]
            sets = [self._expanded(form) for form in usable]
            there = [names for names in sets if {*names} <= {*self.table.names}]
            absent = (mapped,) if self.count == 1 else sets[-1]
            columns = there[0] if there else absent
        self._expect_all(f"'{role}' names {{}} columns", columns)
        return self._there(columns)

    def _expanded(self, pattern: str) -> tuple[str, ...]:
        """A pattern for every joint: ``{0}`` counts from 0, ``{1}`` from 1, ``{joint}`` names."""
        return tuple(
            pattern.replace("{0}", str(k))
            .replace("{1}", str(k + 1))
            .replace("{joint}", label)
            for k, label in enumerate(self.logged_as)
        )

    def _there(self, columns: Iterable[str]) -> tuple[str, ...]:
        """Columns that a map names, or counts from 0."""
        names = self.table.names
        by_number = {str(k): name for k, name in enumerate(keys_of(names))}
        there = by_number | {name: name for name in names}
        for column in columns:
            if column not in there:
                why = f"is not there, correct {self.mapping.source}; columns are {self._some()}"
                raise BadRecording(self.table.file, why, column=column)
        return tuple(there[column] for column in columns)

    def _sizes(self, role: str, units: Sequence[Unit | None]) -> list[float]:
        """SI units per logged unit of each joint."""
        sizes = []
        for unit, joint, turns in zip(
            units, self.labels, self.revolute, strict=True
        ):
            size = (
                factor(role, unit, turns) if isinstance(unit, str) else unit or 1.0
            )
            if size is None:
                kind = "turns" if turns else "slides"
                why = f"joint {joint} {kind}: its {role} is not in {unit}"
                raise BadInput(f"{self.mapping.source}: {why}")
            sizes.append(size)
        return sizes

    def _coupling(self, name: str) -> Array | None:
        """Coordinates of the model by those of the log; see `ColumnMap.coupling`."""
        stated = self.mapping.coupling.get(name)
        if not stated:
            return None
        logged = np.eye(self.count)
        for joint, parts in stated.items():
            others = [*map(str, parts)]
            self._expect_joints("coupling", [joint, *others])
            columns = [self.labels.index(other) for other in others]
            logged[self.labels.index(joint), columns] = [*parts.values()]
        if np.linalg.matrix_rank(logged) < self.count:
            why = "coupling: such readings do not determine the joints; correct it"
            raise BadInput(f"{self.mapping.source}: {why}")
        return np.asarray(logged.T if name == "tau" else np.linalg.inv(logged))

    def _shortened(self, columns: Sequence[str]) -> str:
        """Columns for people: one pattern for joints' names, first and last of a rising number."""
        pattern = self._pattern(columns)
        if pattern is None:
            return ", ".join(columns)
        if "{joint}" in pattern:
            return pattern.replace("{joint}", "<joint>")
        return f"{columns[0]} .. {columns[-1]}"

    def _pattern(self, columns: Sequence[str]) -> str | None:
        """Columns that differ by joint with ``{joint}``, ``{0}`` or ``{1}`` where they do."""
        first = columns[0]
        label = self.logged_as[0]
        named = self.joints and label in first
        patterns = [first.replace(label, "{joint}", 1)] if named else []
        for match in re.finditer(r"\d+", first) if len(columns) > 2 else ():
            head = first[: match.start()]
            tail = first[match.end() :]
            patterns += [f"{head}{{0}}{tail}", f"{head}{{1}}{tail}"]
        expanded = (p for p in patterns if self._expanded(p) == tuple(columns))
        return next(expanded, None)

    def _some(self) -> str:
        """The first columns, of those whose names say nothing if there are any."""
        telling = {*chain(*self.times[0])}
        for group in chain(*self.groups.values()):
            if group.full:
                telling |= {m.column for m in group.members.values()}
        every = [*self.table.names]
        keys = zip(keys_of(every), every, strict=True)
        shown = [k if k == name else f"{k} ({name})" for k, name in keys]
        names = [x for x in shown if x not in telling] or shown
        more = ", ..." if len(names) > _NAMED_AT_MOST else ""
        return ", ".join(names[:_NAMED_AT_MOST]) + more

    @property
    def _unnamed(self) -> bool:
        return all(map(str.isdecimal, self.table.names))

    def _suggestion(self) -> str:
        """A ready column map on one line, as far as names say; ``?`` where they say nothing."""
        n = self.count
        times = self.times[0]
        content: dict[str, object] = {"rate": 100}
        if times:
            content = {"t": times[0][0] if len(times[0]) == 1 else [*times[0]]}
        orders = {2: ("q", "tau"), 3: ("q", "dq", "tau")}
        for first in (1, 0) if self._unnamed else ():  # without time, if need be
            several, rest = divmod(len(self.table.names) - first, n)
            if rest == 0 and several in orders:
                starts = range(first, len(self.table.names), n)
                spans = {
                    role: [*range(k, k + n)]
                    for role, k in zip(orders[several], starts, strict=True)
                }
                return f"{_ADVICE} {in_one_line(({'t': 0} if first else content) | spans)}"
        torque = next(
            (role for role in ("tau", "i") if self.groups.get(role)), "tau"
        )
        for role in ("q", torque):
            full = [g.columns for g in self.groups.get(role, ()) if g.full]
            content[role] = (self._pattern(full[0]) or [*full[0]]) if full else "?"
        return f"{_ADVICE} {in_one_line(content)}"

    def _ambiguous(self, role: str, spans: Sequence[str]) -> BadRecording:
        why = (
            f"{_PLURALS[role]} could be {'; or '.join(spans)}: {self._suggestion()}"
        )
        return BadRecording(self.table.file, why)

    def missing(self, role: str) -> BadRecording:
        """The refusal of a log without a quantity."""
        file = self.table.file
        if role == "tau" and self.prefix:
            column = f"{self.prefix}1"
            return BadRecording(file, "is missing; rename or add it", column=column)
        if role == "tau":
            what = "no torque, neither 'tau1' [N·m] nor 'i1' [A]"
            why = f"{what}: there are {self._some()}; {self._suggestion()}"
            return BadRecording(file, why)
        if role == "t" and self.mapping.columns:
            advice = f"its column, or {_RATE} such as {{rate: 100}}"
            return BadRecording(
                file, f"no time; add to {self.mapping.source} {advice}"
            )
        if self._unnamed:
            why = f"its columns have no names: {self._suggestion()}"
            return BadRecording(file, why)
        advice = f"there are {self._some()}; {self._suggestion()}"
        other = f", or {_RATE}" if role == "t" else ""
        why = f"is missing; rename or add it{other}: {advice}"
        return BadRecording(file, why, column="t" if role == "t" else "q1")


def _times(
    meanings: Sequence[Meaning],
) -> tuple[tuple[tuple[str, ...], ...], str | None]:
    """Candidates for time (a column, or seconds and nanoseconds), and the unit of the only one."""
    if any(m.column == "t" for m in meanings):
        return (("t",),), None
    alone = [m for m in meanings if m.joint is None]
    plain = [m for m in alone if not m.words]
    plain = [m for m in plain if m.term != "duration"] or plain
    plain = [m for m in plain if "header" in m.column] or plain
    parts = [(PARTS_OF_TIME.get(m.words[0]), m) for m in alone if len(m.words) == 1]
    seconds = [m for unit, m in parts if unit == "s"]
    nanoseconds = [m for unit, m in parts if unit == "ns"]
    if len(seconds) == len(nanoseconds) == 1:
        pair = (seconds[0].column, nanoseconds[0].column)
        return (pair, *((m.column,) for m in plain)), None
    single = [*plain, *seconds, *nanoseconds]
    unit = None
    if len(single) == 1:
        unit = "s" if seconds else "ns" if nanoseconds else single[0].unit
    return tuple((m.column,) for m in single), unit


def _unit_in(column: str, role: str, turns: bool | None = None) -> str | None:
    """Unit in a column's name, where the quantity has such."""
    unit = meaning(column).unit
    return unit if unit and factor(role, unit, turns) is not None else None


def _alike(values: Sequence[object]) -> str:
    """The value of all joints, or one of each."""
    return ", ".join(
        f"{value:.6g}" if isinstance(value, float) else str(value)
        for value in (values if len({*values}) > 1 else values[:1])
    )


def _in_unit(units: Sequence[Unit | None], column: str) -> str:
    """Units in brackets, but where there are none or the column's name has them."""
    unit = _alike(["SI" if unit is None else unit for unit in units])
    silent = not any(units) or column.endswith((f"[{unit}]", f"({unit})"))
    return "" if silent else f" [{unit}]"
