"""Values of expressions in xacro files, by simpleeval: nothing is run as Python.

Expressions reach numbers, text, lists, dictionaries of YAML, and functions without effects. No
value has attributes but those listed here. Time and memory are bounded by the process in which a
file is read (`excitant.limited`).
"""

import ast
import builtins
import math
from collections.abc import Callable, Container, Mapping
from types import SimpleNamespace
from typing import Any

from simpleeval import EvalWithCompoundTypes, InvalidExpression, NameNotDefined

_DATA = (
    str,
    bool,
    int,
    float,
    complex,
    type(None),
    list,
    tuple,
    dict,
    set,
    frozenset,
)


class Refused(ValueError):
    """What an expression asks for and may not have."""


class Entries(dict[str, Any]):
    """A dictionary of YAML, whose keys are attributes too."""

    def __getattr__(self, name: str) -> Any:
        """Value of a key."""
        try:
            return self[name]
        except KeyError:
            raise AttributeError(f"there is no entry '{name}'") from None


class Names(dict[str, Any]):
    """Names of an expression: functions, and what is looked up when it is used."""

    def __init__(self, functions: Mapping[str, Any], look_up: Callable[[str], Any]):
        super().__init__(functions)
        self.look_up = look_up

    def __getitem__(self, name: str) -> Any:
        """Value of a name; properties hide functions."""
        try:
            return self.look_up(name)
        except KeyError:
            return super().__getitem__(name)


class Properties:
    """Properties of a namespace, as attributes."""

    def __init__(self, look_up: Callable[[str], Any]) -> None:
        self._look_up = look_up

    def __getattr__(self, name: str) -> Any:
        """Value of a property."""
        try:
            return self._look_up(name)
        except KeyError:
            raise AttributeError(f"name '{name}' is not defined") from None


class _AllBut(Container[str]):
    """All attributes but some; simpleeval refuses those that begin with ``_``."""

    def __init__(self, *names: str) -> None:
        self.names = names

    def __contains__(self, name: object) -> bool:
        return name not in self.names


_TEXT = (
    "split rsplit strip lstrip rstrip lower upper title capitalize startswith endswith "
    "find rfind index count isdigit isalpha isnumeric removeprefix removesuffix join replace"
)
_ATTRIBUTES = {
    str: _TEXT.split(),
    list: {"index", "count"},
    tuple: {"index", "count"},
    dict: {"get", "keys", "values", "items"},
    Entries: _AllBut(
        "clear", "copy", "fromkeys", "pop", "popitem", "setdefault", "update"
    ),
    Properties: _AllBut(),
    SimpleNamespace: _AllBut(),
}


def evaluate(expression: str, names: Names) -> Any:
    """Value of an expression in Python's notation.

    Raises:
        Refused: It needs more than data and the functions among its names.
        Exception: As Python does for expressions that have no value.
    """
    functions = {name: value for name, value in names.items() if callable(value)}
    evaluator = EvalWithCompoundTypes(
        functions=functions, names=names, allowed_attrs=_ATTRIBUTES
    )
    del evaluator.nodes[ast.JoinedStr]  # its format could name attributes
    try:
        tree = ast.parse(expression.strip(), mode="eval")
        value = evaluator.eval(expression, previously_parsed=tree.body)
    except (RecursionError, MemoryError):
        raise Refused("it is nested too deep, or too large") from None
    except NameNotDefined as error:
        raise NameError(f"name '{error.name}' is not defined") from None
    except InvalidExpression as error:
        raise Refused(str(error)) from None
    if not isinstance(value, _DATA):
        raise Refused(f"its value is no data but a {type(value).__name__}")
    return value


_BUILTINS = (
    "list dict map len str float int bool min max round sorted range abs all any "
    "complex divmod enumerate filter frozenset ord reversed set sum tuple zip"
)
PYTHON = {
    **{name: getattr(builtins, name) for name in _BUILTINS.split()},
    "True": True,
    "False": False,
    # simpleeval refuses these two themselves
    "isinstance": lambda value, kinds: isinstance(value, kinds),
    "repr": lambda value: repr(value),
}
"""Functions of Python without effects."""

MATH = {
    name: value for name, value in vars(math).items() if not name.startswith("_")
}
"""Functions and constants of ``math``."""
