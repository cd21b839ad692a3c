"""Guesses: which columns hold which quantity, as far as their names say beyond doubt."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import yaml

from excitant.exceptions import BadRecording
from excitant.identify.importers.groups import SAID, Group, Joints
from excitant.identify.importers.names import Meaning

_PARTS = {"sec": 0, "secs": 0, "seconds": 0, "nanosec": 1, "nanosecs": 1, "nsec": 1, "nsecs": 1,
          "nanoseconds": 1}  # fmt: skip


@dataclass(frozen=True)
class Guesses:
    """What columns' names say about a log.

    Attributes:
        names: All columns.
        joints: The arm's joints.
        groups: Groups per quantity, the most plausible first.
        times: Candidates for time: a column, or seconds and nanoseconds.
        t_unit: Unit in the name of the only candidate for time.
        notes: What was left out.
    """

    names: tuple[str, ...]
    joints: Joints
    groups: Mapping[str, tuple[Group, ...]]
    times: tuple[tuple[str, ...], ...]
    t_unit: str | None = None
    notes: tuple[str, ...] = field(default=())

    def clear(self, role: str) -> list[Group]:
        """Groups that hold a quantity by their name alone, those named exactly first."""
        groups = self.groups.get(role, ())
        exact = [group for group in groups if group.canonical]
        return exact or [group for group in groups if not group.words]

    def torque_roles(self) -> list[str]:
        """``tau`` before ``i``, what is named exactly before what is guessed."""
        exact = [r for r in ("tau", "i") if any(g.canonical for g in self.groups.get(r, ()))]
        return exact or [role for role in ("tau", "i") if self.clear(role)]

    def chosen(self, role: str, file: str, *, optional: bool = False) -> Group | None:
        """The one group of a quantity; None when there is none, or none complete if optional."""
        groups = self.clear(role)
        full = [group for group in groups if group.full(self.joints) and group.twice is None]
        if len(full) == 1:
            return full[0]
        if optional or not groups:
            return None
        if full:
            spans = [", ".join(group.columns(self.joints)[:2]) for group in full]
            raise ambiguous(self, role, spans, file)
        group = max(groups, key=lambda g: len(g.members))
        group.check(self.joints, file)
        return group

    def suggestion(self) -> str:
        """A ready column map on one line, as far as names say; ``?`` where they say nothing."""
        t = list(self.times[0]) if self.times else ["?"]
        content: dict[str, object] = {"t": t[0] if len(t) == 1 else t}
        torque = next((role for role in ("tau", "i") if self.groups.get(role)), "tau")
        for role in ("q", torque):
            full = [g for g in self.groups.get(role, ()) if g.full(self.joints)]
            content[role] = list(full[0].columns(self.joints)) if full else "?"
        text: str = yaml.safe_dump(
            content, default_flow_style=True, sort_keys=False, width=1 << 20, allow_unicode=True
        )
        return text.strip()


def ambiguous(found: Guesses, role: str, spans: Sequence[str], file: str) -> BadRecording:
    """The refusal of columns of which several could be meant."""
    choices = "; or ".join(f"{span} ..." if role != "t" else span for span in spans)
    return BadRecording(
        file,
        f"{SAID[role]} could be {choices}: say which in a file for --map, such as "
        f"{found.suggestion()}",
    )


def missing(found: Guesses, role: str, file: str) -> BadRecording:
    """The refusal of a log without a quantity."""
    column = {"t": "t", "q": "q1"}.get(role)
    some = ", ".join(found.names[:12]) + (", ..." if len(found.names) > 12 else "")
    advice = f"columns are {some}; or say which in a file for --map, such as {found.suggestion()}"
    if column is None:
        return BadRecording(
            file, f"no torque: there is neither 'tau1' [N·m] nor 'i1' [A]; {advice}"
        )
    return BadRecording(file, f"is missing; rename or add it: {advice}", column=column)


def guesses(
    meanings: Sequence[Meaning], joints: Joints, labels: Mapping[int, str], file: str
) -> Guesses:
    """What columns may hold which quantity, commanded and modelled ones left out.

    Args:
        meanings: Of all columns.
        joints: The arm's joints.
        labels: Joints' names by number, where the log has them.
        file: File, for refusals.

    Raises:
        BadRecording: The log names its joints, and the robot has others.
    """
    used = [m for m in meanings if m.role is not None and not m.commanded]
    if labels and joints.names:
        absent = [name for name in joints.names if name not in labels.values()]
        if absent:
            raise BadRecording(
                file,
                f"holds the joints {', '.join(labels.values())}; joint '{absent[0]}' of the robot "
                f"is not among them; give the right robot, or lock this joint",
            )
    sorts: dict[tuple[object, ...], list[tuple[str | int | None, Meaning]]] = {}
    for m in used:
        joint = m.joint
        if isinstance(joint, int) and joints.names:
            joint = labels.get(joint, joint)
        sort = (m.role, m.words, isinstance(joint, str), m.measured, m.term)
        sorts.setdefault(sort, []).append((joint, m))
    groups: dict[str, list[Group]] = {}
    for (role, words, named, *_), members in sorts.items():
        groups.setdefault(str(role), []).append(_group(str(role), words, bool(named), members))
    ordered = {
        role: tuple(sorted(some, key=lambda g: (not g.canonical, len(g.words))))
        for role, some in groups.items()
        if role != "t"
    }
    times, unit = _times([m for m in used if m.role == "t"])
    surplus = sorted(set(labels.values()) - set(joints.names)) if joints.names else []
    notes = (f"joints left out: {', '.join(surplus)}",) if surplus else ()
    return Guesses(tuple(m.column for m in meanings), joints, ordered, times, unit, notes)


def _group(
    role: str,
    words: object,
    named: bool,
    members: Sequence[tuple[str | int | None, Meaning]],
) -> Group:
    by_joint: dict[str | int | None, Meaning] = {}
    twice: Meaning | None = None
    for joint, m in members:
        twice = m if joint in by_joint else twice
        by_joint.setdefault(joint, m)
    exact = re.compile(rf"{role}[1-9]\d*", re.ASCII)
    canonical = not named and all(exact.fullmatch(m.column) for _, m in members)
    return Group(role, by_joint, words if isinstance(words, tuple) else (), canonical, named, twice)


def _times(meanings: Sequence[Meaning]) -> tuple[tuple[tuple[str, ...], ...], str | None]:
    """Candidates for time, and the unit in the name where there is one candidate."""
    if any(m.column == "t" for m in meanings):
        return (("t",),), None
    plain = [m for m in meanings if m.joint is None and not m.words]
    parts: dict[int, list[Meaning]] = {0: [], 1: []}
    for m in meanings:
        if m.joint is None and len(m.words) == 1 and m.words[0] in _PARTS:
            parts[_PARTS[m.words[0]]].append(m)
    if len(parts[0]) == len(parts[1]) == 1:
        pair = (parts[0][0].column, parts[1][0].column)
        return ((pair,) if not plain else (pair, *((m.column,) for m in plain))), None
    units = {**{m.column: "s" for m in parts[0]}, **{m.column: "ns" for m in parts[1]}}
    some = [*plain, *parts[0], *parts[1]]
    unit = (units.get(some[0].column) or some[0].unit) if len(some) == 1 else None
    return tuple((m.column,) for m in some), unit
