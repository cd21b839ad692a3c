"""Regrouping expressions with letters: ``link2.Izz + a3²·link3.m`` for coefficients of lengths.

A coefficient gets a letter when it is, to 1e-9, a form that grouping makes of the
Denavit-Hartenberg lengths between the two links, and when no other form has the same value:

    first moment from mass           x, x + y
    moment of inertia from mass      x², x² + y² + …, x² − y²;  from first moment 2 x
    product of inertia from mass     x y;          from first moment x
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import combinations

import numpy as np

from excitant.robots.base_parameters import BaseParameters, expression
from excitant.robots.dh import Convention, dh_from_robot
from excitant.robots.robot import Robot

_SAME = 1e-9  # relative; smaller parts of the longest length are none
_DIGITS = 12  # of a length
_TERMS = 4  # squares in a sum
_KIND = {
    "m": "mass",
    **dict.fromkeys(("mcx", "mcy", "mcz"), "first"),
    **dict.fromkeys(("Ixx", "Iyy", "Izz"), "moment"),
    **dict.fromkeys(("Ixy", "Ixz", "Iyz"), "product"),
}

Lengths = Mapping[str, float]


def length_symbols(robot: Robot, convention: Convention = "modified") -> dict[str, float]:
    """Lengths of an arm's Denavit-Hartenberg table that are not zero [m].

    Args:
        robot: A serial arm.
        convention: In the modified one, a2 lies between the axes of joints 1 and 2, and d2
            along that of joint 2; in the standard one, that a is a1.

    Raises:
        BadRobot: Joints that branch.
    """
    chain = dh_from_robot(robot, convention)
    table = np.column_stack([chain.a, chain.d])
    least = _SAME * np.abs(table).max()
    return {
        f"{letter}{j}": float(f"{value:.{_DIGITS}g}")
        for j, row in enumerate(table, start=1)
        for letter, value in zip("ad", row, strict=True)
        if abs(value) > least
    }


def symbolic_expressions(
    base: BaseParameters, links: tuple[str, ...], lengths: Lengths
) -> tuple[str, ...]:
    """Base parameters as text, with letters for lengths where that is unambiguous.

    Args:
        base: The base parameters.
        links: Names of the links, in order.
        lengths: Lengths by their letters, as `length_symbols` gives them [m].
    """
    found = []
    for row, leading in zip(base.regrouping, base.columns, strict=True):
        nearest: dict[tuple[float, str], tuple[int, str] | None] = {}
        factors = {}
        for k in map(int, np.flatnonzero(row)):
            key = float(row[k]), base.names[k].rpartition(".")[2]  # what a link passes on
            if key not in nearest:
                nearest[key] = _letters(key[0], base.names[leading], base.names[k], links, lengths)
            if (text := nearest[key]) is not None:
                factors[k] = text
        found.append(expression(row, base.names, leading, factors))
    return tuple(found)


def _letters(
    value: float, leading: str, member: str, links: tuple[str, ...], lengths: Lengths
) -> tuple[int, str] | None:
    """Sign and text of a member's coefficient, where lengths between the two links make it.

    Frames at the far end of a link bring in the leading link's own lengths.
    """
    (link, _, own), (other, _, its) = leading.rpartition("."), member.rpartition(".")
    if link not in links or other not in links or own not in _KIND or its not in _KIND:
        return None
    first, last = links.index(link) + 1, links.index(other) + 1
    for start in (first + 1, first):
        between = {x: v for x, v in lengths.items() if start <= int(x[1:]) <= last}
        near = [
            (form, text, size)
            for form, text, size in _forms(between, _KIND[own], _KIND[its])
            if abs(abs(size) - abs(value)) <= _SAME * abs(value)
        ]
        if len({form for form, _, _ in near}) == 1:
            _, text, size = near[0]
            return (1 if size * value > 0 else -1), text
        if near:
            return None
    return None


def _forms(lengths: Lengths, own: str, its: str) -> Iterator[tuple[str, str, float]]:
    """What grouping one kind of parameter into another makes of lengths: form, text, value.

    Lengths nearest to the leading link come first.
    """
    pairs = list(combinations(lengths.items(), 2))
    for x, a in lengths.items():
        match own, its:
            case ("first", "mass") | ("product", "first"):
                yield x[0], x, a
            case "moment", "first":
                yield f"2{x[0]}", f"2·{x}", 2 * a
            case "moment", "mass":
                yield f"{x[0]}²", f"{x}²", a**2
    for (x, a), (y, b) in pairs:
        match own, its:
            case "first", "mass":
                yield "sum", f"({x} + {y})", a + b
            case "moment", "mass":
                yield "difference", f"({x}² − {y}²)", a**2 - b**2
            case "product", "mass":
                yield "product", f"{x}·{y}", a * b
    if (own, its) == ("moment", "mass"):
        for count in range(2, min(len(lengths), _TERMS) + 1):
            for some in combinations(lengths, count):
                text = " + ".join(f"{x}²" for x in some)
                yield "squares", f"({text})", sum(lengths[x] ** 2 for x in some)
