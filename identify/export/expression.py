"""Arithmetic that is written down instead of carried out, valid in Python and in C alike."""

from __future__ import annotations

import operator
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

_SUM, _PRODUCT, _ATOM = range(3)


@dataclass(frozen=True)
class Expression:
    """A number that is known when code is written, or text that will be one when it runs.

    NumPy's functions apply to it, so what an effect computes from arrays can be written down.

    Attributes:
        text: Source, the same in Python and C.
        rank: What binds weakest in the text: a sum, a product, or nothing.
        value: The number, where it is known.
        names: Variables that occur.
        functions: Functions that occur.
    """

    text: str
    rank: int = _ATOM
    value: float | None = None
    names: frozenset[str] = frozenset()
    functions: frozenset[str] = frozenset()

    @property
    def zero(self) -> bool:
        """Whether it is known to be 0."""
        return self.value == 0

    def __neg__(self) -> Expression:
        if self.value is not None:
            return constant(-self.value)
        if self.rank == _SUM:
            return _made(f"-({self.text})", _PRODUCT, self)
        text = self.text[1:] if self.text.startswith("-") else f"-{self.text}"
        return _made(text, _PRODUCT if text.startswith("-") or self.rank != _ATOM else _ATOM, self)

    def __add__(self, other: Any) -> Expression:
        other = lifted(other)
        if self.value is not None and other.value is not None:
            return constant(self.value + other.value)
        if self.zero or other.zero:
            return other if self.zero else self
        sign, text = ("-", other.text[1:]) if other.text.startswith("-") else ("+", other.text)
        return _made(f"{self.text} {sign} {text}", _SUM, self, other)

    def __mul__(self, other: Any) -> Expression:
        first, second = self, lifted(other)
        if first.value is not None and second.value is not None:
            return constant(first.value * second.value)
        if second.value is not None:
            first, second = second, first
        if first.value == 0:
            return constant(0.0)
        if first.value in (1, -1):
            return second if first.value == 1 else -second
        if second.rank == _PRODUCT and second.text.startswith("-"):
            return -(first * -second)
        text = f"{_factor(first)}*{_factor(second)}"
        return _made(text, _PRODUCT, first, second)

    def __truediv__(self, other: Any) -> Expression:
        other = lifted(other)
        if self.value is not None and other.value is not None:
            return constant(self.value / other.value)
        if self.zero:
            return self
        below = other.text if other.rank == _ATOM else f"({other.text})"
        return _made(f"{_factor(self)}/{below}", _PRODUCT, self, other)

    def __pow__(self, other: Any) -> Expression:
        other = lifted(other)
        if self.value is not None and other.value is not None:
            return constant(float(self.value**other.value))
        if other.value == 2 and self.rank == _ATOM:
            return self * self
        return call("pow", self, other)

    def __sub__(self, other: Any) -> Expression:
        return self + -lifted(other)

    def __radd__(self, other: Any) -> Expression:
        return lifted(other) + self

    def __rsub__(self, other: Any) -> Expression:
        return lifted(other) - self

    def __rmul__(self, other: Any) -> Expression:
        return self * lifted(other)

    def __rtruediv__(self, other: Any) -> Expression:
        return lifted(other) / self

    def __rpow__(self, other: Any) -> Expression:
        return lifted(other) ** self

    def __abs__(self) -> Expression:
        return call("fabs", self)

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> Any:
        if method != "__call__" or options or ufunc not in _UFUNCS:
            return NotImplemented
        return _UFUNCS[ufunc](*map(lifted, inputs))

    def __array_function__(self, function: Any, types: Any, args: Any, options: Any) -> Any:
        return constant(_FILLED[function]) if function in _FILLED else NotImplemented


def constant(value: float) -> Expression:
    """A known number; its text reads back to the same one."""
    value = float(value) + 0.0
    return Expression(repr(value), _ATOM if value >= 0 else _PRODUCT, value)


def variable(name: str) -> Expression:
    """A number that code will have under a name."""
    return Expression(name, names=frozenset({name}))


def call(function: str, *arguments: Any) -> Expression:
    """A function of C's ``math.h``, or ``sign``."""
    inner = [lifted(argument) for argument in arguments]
    made = _made(f"{function}({', '.join(x.text for x in inner)})", _ATOM, *inner)
    return Expression(made.text, _ATOM, None, made.names, made.functions | {function})


def lifted(value: Any) -> Expression:
    """The expression itself, or a number as one."""
    return value if isinstance(value, Expression) else constant(float(value))


def _made(text: str, rank: int, *parts: Expression) -> Expression:
    names = frozenset[str]().union(*(part.names for part in parts))
    functions = frozenset[str]().union(*(part.functions for part in parts))
    return Expression(text, rank, None, names, functions)


def _factor(x: Expression) -> str:
    return f"({x.text})" if x.rank == _SUM else x.text


def _calling(function: str) -> Callable[..., Expression]:
    return lambda *arguments: call(function, *arguments)


_UFUNCS: dict[Any, Callable[..., Expression]] = {
    np.add: operator.add,
    np.subtract: operator.sub,
    np.multiply: operator.mul,
    np.divide: operator.truediv,
    np.negative: operator.neg,
    np.power: operator.pow,
    np.square: lambda x: lifted(x**2),
    np.absolute: _calling("fabs"),
    np.fabs: _calling("fabs"),
    np.maximum: lambda x, y: 0.5 * (x + y + abs(x - y)),
    np.minimum: lambda x, y: 0.5 * (x + y - abs(x - y)),
    np.arctan: _calling("atan"),
    **{
        getattr(np, name): _calling(name)
        for name in ("sign", "exp", "sin", "cos", "tanh", "sqrt", "log", "cosh")
    },
}
_FILLED: dict[Any, float] = {np.ones_like: 1.0, np.zeros_like: 0.0}


@dataclass(frozen=True)
class Statement:
    """``name = expression``, under a heading."""

    heading: str
    name: str
    expression: Expression


@dataclass
class Program:
    """Straight-line code as it is being written: statements in order.

    Attributes:
        statements: What has been written.
        heading: What the next statements belong to.
    """

    statements: list[Statement] = field(default_factory=list)
    heading: str = ""

    def let(self, name: str, expression: Any) -> Expression:
        """Give an expression a name, unless it is a number or a name (or its negative)."""
        made = lifted(expression)
        if made.value is not None or re.fullmatch(r"-?\w+", made.text):
            return made
        self.statements.append(Statement(self.heading, name, made))
        return variable(name)

    def needed(self, results: tuple[Expression, ...]) -> tuple[Statement, ...]:
        """The statements that results depend on."""
        wanted = set[str]().union(*(result.names for result in results))
        kept = []
        for statement in reversed(self.statements):
            if statement.name in wanted:
                kept.append(statement)
                wanted |= statement.expression.names
        return tuple(reversed(kept))
