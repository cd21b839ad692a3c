"""Values of expressions in xacro files, over Python's syntax tree: nothing is run as Python.

There are numbers, text, lists and dictionaries of YAML, arithmetic and comparisons, and functions
that have no effect. No object has attributes but dictionaries, whose keys these are, and methods
that are listed here. Sizes are bounded before a value is built.
"""

from __future__ import annotations

import ast
import builtins
import itertools
import math
import operator
import re
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Any

from excitant.robots.files import extent

LARGEST = 100_000  # characters and values that one value holds
_BITS = 4_000  # of a whole number
_DATA = (str, bool, int, float, complex, type(None), list, tuple, dict, set)
_ITERABLE = (str, list, tuple, dict, set)

Spend = Callable[[int], None]


class Refused(ValueError):
    """What an expression asks for and may not have."""


class Space(dict[str, Any]):
    """Names that an expression reaches as ``space.name``."""


class Function:
    """A function that expressions may call; its values are data."""

    def __init__(
        self, call: Callable[..., Any], kind: type | tuple[type, ...] = ()
    ) -> None:
        self.call = call
        self.kind = kind

    def __call__(self, *values: Any, **named: Any) -> Any:
        """The value of a call, bounded; iterators become lists."""
        found = self.call(*values, **named)
        return bounded(found if isinstance(found, _DATA) else list(found))


def evaluate(expression: str, names: Mapping[str, Any], spend: Spend) -> Any:
    """Value of an expression.

    Args:
        expression: In Python's notation.
        names: What its names stand for: data, `Function` or a `Space`.
        spend: Told of every step and its size; may end it by an exception.

    Raises:
        Refused: It needs more than the above; the text says what.
        Exception: As Python does for expressions that have no value.
    """
    if len(expression) > LARGEST:
        raise Refused(f"is longer than {LARGEST} characters")
    try:
        tree = ast.parse(expression.strip(), mode="eval")
        value = _Evaluation(names, spend).value(tree.body)
    except (RecursionError, MemoryError):
        raise Refused("is nested too deep") from None
    if isinstance(value, (Space, Function)):
        raise Refused("has a value that is no data")
    return value


def bounded(value: Any) -> Any:
    """The value, which is data of a size that is allowed."""
    if isinstance(value, int) and value.bit_length() > _BITS:
        raise Refused("leads to a number of more than 1000 digits")
    if not isinstance(value, _DATA):
        raise Refused(f"uses a value of type {type(value).__name__}")
    if isinstance(value, _ITERABLE):
        try:
            extent(value, LARGEST)
        except ValueError:
            raise Refused(
                f"leads to more than {LARGEST} values or characters"
            ) from None
    return value


def _fits(size: float, most: float = LARGEST) -> None:
    if size > most:
        raise Refused("leads to a value that is too large")


class _Evaluation:
    """Walk over the tree of one expression."""

    def __init__(self, names: Mapping[str, Any], spend: Spend) -> None:
        self.names, self.spend, self.local = names, spend, dict[str, Any]()

    def value(self, node: ast.expr) -> Any:
        self.spend(1)
        kind = type(node).__name__
        if (evaluated := getattr(self, f"_{kind}", None)) is None:
            raise Refused(f"uses {_WORDS.get(kind, kind)}")
        return evaluated(node)

    def data(self, node: ast.expr) -> Any:
        """Value of a node that is data; a large one costs more."""
        value = self.value(node)
        if isinstance(value, _ITERABLE):
            self.spend(extent(value, LARGEST))
        elif not isinstance(value, _DATA):
            raise Refused(f"uses {ast.unparse(node)} as a value")
        return value

    def _Constant(self, node: ast.Constant) -> Any:
        return bounded(node.value)

    def _Name(self, node: ast.Name) -> Any:
        name = node.id
        if name in self.local:
            return self.local[name]
        try:
            return self.names[name]
        except KeyError:
            pass
        if name.startswith("__") or hasattr(builtins, name) or hasattr(math, name):
            raise Refused(f"uses {name}")
        raise NameError(f"name '{name}' is not defined")

    def made(self, value: Any) -> Any:
        """A value that was built, bounded and paid for."""
        if isinstance(bounded(value), _ITERABLE):
            self.spend(extent(value))
        return value

    def _List(self, node: ast.List) -> list[Any]:
        found: list[Any] = self.made([self.value(each) for each in node.elts])
        return found

    def _Tuple(self, node: ast.Tuple) -> tuple[Any, ...]:
        return tuple(self._List(node))  # type: ignore[arg-type]

    def _UnaryOp(self, node: ast.UnaryOp) -> Any:
        operation = _UNARY.get(type(node.op))
        if operation is None:
            raise Refused(f"uses {ast.unparse(node)}")
        return operation(self.data(node.operand))

    def _BinOp(self, node: ast.BinOp) -> Any:
        operation = _BINARY.get(type(node.op))
        if operation is None:
            raise Refused(f"uses {ast.unparse(node)}")
        return self.made(operation(self.data(node.left), self.data(node.right)))

    def _BoolOp(self, node: ast.BoolOp) -> Any:
        stops = isinstance(node.op, ast.Or)
        value = None
        for each in node.values:
            value = self.value(each)
            if bool(value) == stops:
                break
        return value

    def _Compare(self, node: ast.Compare) -> bool:
        left = self.data(node.left)
        for operation, other in zip(node.ops, node.comparators, strict=True):
            right = self.data(other)
            if not _COMPARED[type(operation)](left, right):
                return False
            left = right
        return True

    def _IfExp(self, node: ast.IfExp) -> Any:
        return self.value(node.body if self.value(node.test) else node.orelse)

    def _Subscript(self, node: ast.Subscript) -> Any:
        held: Any = self.value(node.value)
        if type(held) not in _ITERABLE and not isinstance(held, (list, dict)):
            raise Refused(f"uses {ast.unparse(node)}")
        found = held[self._index(node.slice)]
        return self.made(found) if isinstance(node.slice, ast.Slice) else found

    def _index(self, node: ast.expr) -> Any:
        if not isinstance(node, ast.Slice):
            return self.data(node)
        ends = (node.lower, node.upper, node.step)
        return slice(*(None if end is None else self.data(end) for end in ends))

    def _Attribute(self, node: ast.Attribute) -> Any:
        held = self.value(node.value)
        spaces = isinstance(held, Space) or hasattr(
            type(held), "__getattr__"
        )  # xacro's, of YAML
        if not spaces or not isinstance(held, dict):
            raise Refused(f"uses {ast.unparse(node)}")
        try:
            return held[node.attr]
        except KeyError:
            raise Refused(f"uses {ast.unparse(node)}, which is not known") from None

    def _Call(self, node: ast.Call) -> Any:
        function = self._function(node.func)
        values = [self._argument(each) for each in node.args]
        if any(each.arg is None for each in node.keywords):
            raise Refused("uses **")
        named = {str(each.arg): self._argument(each.value) for each in node.keywords}
        return self.made(function(*values, **named))

    def _argument(self, node: ast.expr) -> Any:
        value = self.value(node)
        if isinstance(value, _ITERABLE):
            self.spend(extent(value, LARGEST))
        elif not isinstance(value, (*_DATA, Function)):
            raise Refused(f"uses {ast.unparse(node)} as a value")
        return value

    def _function(self, node: ast.expr) -> Function:
        if isinstance(node, ast.Attribute):
            held = self.value(node.value)
            kinds = [] if isinstance(held, Space) else _METHODS.items()
            for method in (
                known.get(node.attr) for kind, known in kinds if isinstance(held, kind)
            ):
                if method is not None:
                    return Function(partial(method, held))
            if not isinstance(held, dict):
                raise Refused(f"uses {ast.unparse(node)}")
        function = self.value(node)
        if not isinstance(function, Function):
            raise Refused(f"calls {ast.unparse(node)}")
        return function

    def _ListComp(self, node: ast.ListComp | ast.GeneratorExp) -> list[Any]:
        collected: list[Any] = []

        def inner(rest: list[ast.comprehension]) -> None:
            if not rest:
                collected.append(self.value(node.elt))
                _fits(len(collected))
                return
            for item in tuple(self.data(rest[0].iter)):
                self._assign(rest[0].target, item)
                if all(self.value(test) for test in rest[0].ifs):
                    inner(rest[1:])

        before = self.local
        self.local = dict(before)
        try:
            inner(node.generators)
        finally:
            self.local = before
        return self.made(collected)  # type: ignore[no-any-return]

    _GeneratorExp = _ListComp

    def _assign(self, target: ast.expr, item: Any) -> None:
        self.spend(1)
        if isinstance(target, ast.Name):
            self.local[target.id] = item
        elif isinstance(target, (ast.Tuple, ast.List)) and isinstance(item, _ITERABLE):
            for inner, each in zip(target.elts, tuple(item), strict=True):
                self._assign(inner, each)
        else:
            raise Refused(f"assigns to {ast.unparse(target)}")


_WORDS = {"Lambda": "a lambda", "NamedExpr": ":=", "Await": "await", "Starred": "*"}


def _times(left: Any, right: Any) -> Any:
    for one, other in ((left, right), (right, left)):
        if isinstance(one, (str, list, tuple)) and isinstance(other, int):
            _fits(extent(one) * max(other, 0))
    return left * right


def _power(base: Any, exponent: Any) -> Any:
    if isinstance(base, int) and isinstance(exponent, int) and abs(base) > 1:
        _fits(base.bit_length() * exponent, _BITS)
    return base**exponent


_PLACE = re.compile(r"%(\(\w+\))?[-+ #0]*\d{0,2}(\.\d{1,2})?[diouxXeEfFgGcrsa%]")


def _remainder(left: Any, right: Any) -> Any:
    if isinstance(left, str) and "%" in _PLACE.sub("", left):
        raise Refused("uses a format that is not plain")
    if isinstance(left, str):
        _fits(len(left) + len(_PLACE.findall(left)) * extent(right))
    return left % right


_BINARY: dict[type, Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: _times,
    ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv,
    ast.Mod: _remainder,
    ast.Pow: _power,
}
_UNARY: dict[type, Callable[[Any], Any]] = {
    ast.UAdd: operator.pos,
    ast.USub: operator.neg,
    ast.Not: operator.not_,
}
_COMPARED: dict[type, Callable[[Any, Any], Any]] = {
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Is: operator.is_,
    ast.IsNot: operator.is_not,
    ast.In: lambda item, held: item in held,
    ast.NotIn: lambda item, held: item not in held,
}


def _join(text: str, parts: Iterable[str]) -> str:
    parts = list(parts)
    _fits(sum(map(len, parts)) + len(text) * len(parts))
    return text.join(parts)


def _replace(text: str, old: str, new: str, *count: int) -> str:
    _fits(len(text) + text.count(old) * len(new))
    return text.replace(old, new, *count)


_PLAIN = "split rsplit strip lstrip rstrip lower upper title capitalize startswith endswith find"
_PLAIN += " rfind index count isdigit isalpha isnumeric removeprefix removesuffix"
_METHODS: dict[type, dict[str, Callable[..., Any]]] = {
    str: {name: getattr(str, name) for name in _PLAIN.split()}
    | {"join": _join, "replace": _replace},
    list: {"index": list.index, "count": list.count},
    tuple: {"index": tuple.index, "count": tuple.count},
    dict: {
        "get": lambda held, key, *other: (
            held[key] if key in held else (*other, None)[0]
        ),
        "keys": lambda held: list(dict.keys(held)),
        "values": lambda held: [held[key] for key in dict.keys(held)],
        "items": lambda held: [(key, held[key]) for key in dict.keys(held)],
    },
}


def _range(*ends: int) -> range:
    found = range(*ends)
    _fits(len(found))
    return found


def _sum(values: Iterable[Any], start: Any = 0) -> Any:
    if not all(isinstance(value, (int, float, complex)) for value in (*values, start)):
        raise Refused("adds up other things than numbers")
    return sum(values, start)


def _round(value: Any, digits: int | None = None) -> Any:
    _fits(abs(digits or 0), 1000)
    return round(value, digits)


def _map(call: Any, *values: Iterable[Any]) -> list[Any]:
    found = []
    total = 0
    for each in zip(*values, strict=False):
        found.append(call(*each))
        total += extent(found[-1], LARGEST)
        _fits(total)
    return found


def _enumerate(values: Iterable[Any], start: int = 0) -> list[Any]:
    return list(enumerate(values, start))


def _filter(test: Any, values: Iterable[Any]) -> list[Any]:
    return [value for value in values if (test(value) if test else value)]


def _isinstance(value: Any, kind: Any) -> bool:
    kinds = kind if isinstance(kind, tuple) else (kind,)
    return any(isinstance(value, each.kind) for each in kinds)


def _zip(*values: Iterable[Any]) -> list[Any]:
    return list(itertools.islice(zip(*values, strict=False), LARGEST))


PYTHON: dict[str, Any] = {
    "True": True,
    "False": False,
    "map": Function(_map),
    "filter": Function(_filter),
    "isinstance": Function(_isinstance),
    "range": Function(_range),
    "sum": Function(_sum),
    "round": Function(_round),
    "enumerate": Function(_enumerate),
    "zip": Function(_zip),
    "reversed": Function(lambda values: list(values)[::-1]),
    "frozenset": Function(set),
    **{
        kind.__name__: Function(kind, kind)
        for kind in (list, dict, str, int, bool, set, tuple)
    },
    "float": Function(float, float),
    "complex": Function(complex, complex),
    **{
        name: Function(getattr(builtins, name))
        for name in (
            "len",
            "min",
            "max",
            "abs",
            "all",
            "any",
            "divmod",
            "ord",
            "repr",
            "sorted",
        )
    },
}
"""Functions of Python without effects, whose values are bounded."""

_SLOW = ("comb", "factorial", "perm", "prod", "lcm", "isqrt", "sumprod")
MATH: dict[str, Any] = {
    name: Function(value) if callable(value) else value
    for name, value in vars(math).items()
    if not name.startswith("_") and name not in _SLOW
}
"""Functions and constants of ``math``, but for some that would take for ever."""
