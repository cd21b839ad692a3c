"""Columns named one by one, by a pattern, or by what their names have in common."""

from __future__ import annotations

import re
from collections.abc import Sequence

from excitant.exceptions import BadInput, BadRecording
from excitant.identify.importers.groups import Joints

_COMMON = ("{}[{{0}}]", "{}_{{0}}", "{}.{{0}}", "{}{{0}}", "{}[{{1}}]", "{}_{{1}}", "{}.{{1}}",
           "{}{{1}}")  # fmt: skip
_NAMED = ("{{joint}}.{}", "{}.{{joint}}", "{{joint}}_{}", "{}_{{joint}}", "{{joint}}/{}",
          "{}/{{joint}}", "{{joint}} {}", "{} {{joint}}")  # fmt: skip


def explicit(
    role: str,
    given: str | tuple[str, ...],
    names: Sequence[str],
    joints: Joints,
    file: str,
    source: str,
) -> tuple[str, ...]:
    """The columns that a map names, in the robot's order.

    Raises:
        BadInput: Too many or too few columns.
        BadRecording: A column that is not there.
    """
    columns = _columns(given, names, joints)
    if len(columns) != joints.count:
        raise BadInput(
            f"{source}: '{role}' names {len(columns)} columns, the robot has {joints.count} joints"
        )
    for column in columns:
        if column not in names:
            some = ", ".join(names[:12]) + (", ..." if len(names) > 12 else "")
            raise BadRecording(file, f"is not there, mend {source}; columns are {some}",
                               column=column)  # fmt: skip
    return columns


def _columns(given: str | tuple[str, ...], names: Sequence[str], joints: Joints) -> tuple[str, ...]:
    if isinstance(given, tuple):
        return given
    if "{" in given:
        return expanded(given, joints)
    if given in names and joints.count == 1:
        return (given,)
    for form in (*_NAMED, *_COMMON) if joints.names else _COMMON:
        columns = expanded(form.format(given.replace("{", "{{")), joints)
        if all(column in names for column in columns):
            return columns
    return (given,) if joints.count == 1 else expanded(f"{given}{{1}}", joints)


def expanded(pattern: str, joints: Joints) -> tuple[str, ...]:
    """A pattern for every joint: ``{0}`` counts from 0, ``{1}`` from 1, ``{joint}`` is a name."""
    return tuple(
        pattern.replace("{0}", str(k)).replace("{1}", str(k + 1)).replace("{joint}", label)
        for k, label in enumerate(joints.labels)
    )


def shortened(columns: Sequence[str], joints: Joints) -> str:
    """Columns for people: one pattern for joints' names, first and last of a rising number."""
    before, found, after = columns[0].partition(joints.labels[0])
    by_name = [f"{before}{label}{after}" for label in joints.names]
    if found and list(columns) == by_name:
        return f"{before}<joint>{after}"
    if len(columns) > 2 and pattern(columns) is not None:
        return f"{columns[0]} .. {columns[-1]}"
    return ", ".join(columns)


def pattern(columns: Sequence[str]) -> str | None:
    """The pattern with ``{0}`` or ``{1}`` that gives these columns; None when there is none."""
    for match in re.finditer(r"\d+", columns[0]):
        before, after = columns[0][: match.start()], columns[0][match.end() :]
        for mark, first in (("{0}", 0), ("{1}", 1)):
            if list(columns) == [f"{before}{k + first}{after}" for k in range(len(columns))]:
                return f"{before}{mark}{after}"
    return None
