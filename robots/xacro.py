"""Xacro files as URDF text: ROS's macro language (https://wiki.ros.org/xacro), without ROS.

Elements ``xacro:...`` define properties, arguments and macros, include files, and are replaced by
what they build; ``${...}`` and ``$(...)`` in attributes and text are replaced by their values.
Comments, and names of other XML namespaces, are left out. Files of others are read in a child
process of bounded time and memory, within the folders that they may reach, in an environment that
is empty.
"""

from __future__ import annotations

import copy
import glob
import html
import json
import os
import re
from collections import ChainMap
from collections.abc import Iterator, Mapping, MutableMapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree.ElementTree import Element, SubElement, tostring

from excitant.exceptions import BadRobot, ExcitantError, UnknownName
from excitant.files import read_text
from excitant.limited import Exceeded, in_child
from excitant.robots.expressions import (
    MATH,
    PYTHON,
    Entries,
    Names,
    Properties,
    Refused,
    evaluate,
)
from excitant.robots.files import (
    package_folders,
    parse_xml,
    read_description,
    within,
)
from excitant.robots.schema import Loader, parsed_yaml

SECONDS = 10  # of processor time that a file may take
MEMORY = 1 << 30  # bytes of address space that reading it may take
_NESTED = 50  # files that include one another
_TEXT = re.compile(
    r"(?P<escaped>\$\$+[{(])|\$\{(?P<expression>[^}]*)\}|\$\((?P<command>[^)]*)\)"
    r"|[^$]+|\$[^{($]+|\$$"
)
_MACRO_ARGUMENT = re.compile(
    r"""\s*([^\s:=]+?)\s*:?=\s*(\^\|?)?(\$\{.*?\}|\$\(.*?\)|(?:'[^']*'|"[^"]*"|[^\s'"])+|)"""
    r"(?:\s+|$)"
)
_UNITS = {
    "radians": 1.0,
    "degrees": MATH["pi"] / 180,
    "meters": 1.0,
    "millimeters": 1e-3,
    "foot": 0.3048,
    "inches": 0.0254,
}


def is_xacro(text: str) -> bool:
    """Whether the text of a robot needs xacro."""
    return "xacro" in text and any(sign in text for sign in ("<xacro:", "${", "$("))


def urdf_from_xacro(
    path: str | Path, arguments: Mapping[str, str], packages: Sequence[str | Path]
) -> tuple[str, tuple[str, ...]]:
    """URDF text of a xacro file, and what it was denied, as sentences.

    Args:
        path: The file.
        arguments: Values of its ``<xacro:arg>`` by name.
        packages: Folders in which ``$(find name)`` looks: the package itself, or a folder that
            holds it; the file's own package and those of ROS need not be named.
    """
    task = (process, str(path), dict(arguments), list(map(str, packages)))
    try:
        answer = in_child(*task, seconds=SECONDS, memory=MEMORY)
    except Exceeded as error:
        why = f"this xacro file {error}, perhaps in macros that call one another"
        raise BadRobot(path, why) from None
    except ValueError as error:
        raise BadRobot(path, f"xacro cannot read it: {error}") from None
    result = json.loads(answer)
    if "why" in result:
        raise BadRobot(result["source"], result["why"])
    try:
        UnknownName.refuse("xacro argument", arguments, result["declared"])
    except UnknownName as unknown:
        raise BadRobot(path, str(unknown)) from None
    return result["urdf"], tuple(result["notes"])


def process(
    path: str, arguments: Mapping[str, str], packages: Sequence[str]
) -> bytes:
    """Answer to `urdf_from_xacro` as JSON: ``urdf``, ``notes``, ``declared``; or ``why`` not."""
    reading = _Reading(Path(path), dict(arguments), packages)
    try:
        root = reading.document(path)
        built = Element(root.tag)
        with reading.inside(path):
            reading.build(root, built, _Scope())
        if built.find("link") is None:
            why = "if it only defines macros, give the file that calls them"
            raise BadRobot(path, f"this xacro file builds no links; {why}")
        answer = {
            "urdf": tostring(built, encoding="unicode"),
            "notes": reading.notes,
            "declared": sorted(reading.declared),
        }
    except BadRobot as error:
        answer = {"source": error.source, "why": error.why}
    except RecursionError:
        why = "its macros or expressions lie too deep within one another, perhaps in a loop"
        answer = {"source": path, "why": why}
    return json.dumps(answer).encode()


@dataclass(frozen=True)
class _Default:
    """Default of a parameter: the caller's property of the same name where ``forward``, or text."""

    forward: bool = False
    text: str | None = None


class _Scope(ChainMap[str, Any]):
    """What is visible at one place of a file, and what is around it.

    Properties by their names, blocks as ``*name`` and ``**name``, macros as ``xacro:name``,
    namespaces, which are scopes, as ``name.``.
    """

    def __init__(
        self, parent: _Scope | None = None, is_namespace: bool = False
    ) -> None:
        super().__init__({}, *(() if parent is None else parent.maps))
        self.parent = self if parent is None else parent
        self.is_namespace = is_namespace

    def caller(self) -> _Scope:
        """The scope around that of a macro, namespaces left out."""
        around = self.parent
        while around.is_namespace and not self.is_namespace:
            around = around.parent
        return around

    def macro(self, name: str) -> tuple[Element, _Scope]:
        """A macro, and the scope around its own: its namespace, or that of the call."""
        if (macro := self.get(f"xacro:{name}")) is not None:
            return macro, self
        space, _, rest = name.partition(".")
        return self[f"{space}."].macro(rest)


@dataclass(frozen=True)
class _Unevaluated:
    """A property whose text is evaluated, where it was defined, once it is used."""

    text: str
    scope: _Scope


class _Reading:
    """The reading of one xacro file with those that it includes."""

    def __init__(
        self,
        path: Path,
        arguments: dict[str, str],
        packages: Sequence[str],
    ) -> None:
        self.path = path
        self.arguments = arguments
        self.packages = packages
        self.declared: set[str] = set()
        self.packages_found: list[Path] = []
        self.files: list[str] = []  # that include one another, the innermost last
        self.texts: dict[str, str] = {}
        self.notes: list[str] = []
        self.evaluating: list[str] = []  # properties that need one another
        self.commands = {
            "arg": self.argument,
            "find": self.find,
            "env": self.environment,
        }
        own = {
            "load_yaml": self.yaml,
            "abs_filename": self._beside,
            "dotify": Entries,
            "arg": self.argument,
            "tokenize": _tokenize,
            "fatal": _fatal,
            **dict.fromkeys(
                ("message", "warning", "error", "print_location"),
                lambda *_, **__: "",
            ),
        }
        spaces = {"math": MATH, "python": PYTHON, "xacro": own}
        self.functions = {**MATH, **PYTHON, **own}
        self.functions |= {name: SimpleNamespace(**x) for name, x in spaces.items()}

    # Elements

    def build(self, element: Element, out: Element, scope: _Scope) -> None:
        """Add to an element what the content of another builds, its attributes included."""
        for name, value in element.attrib.items():
            if not name.startswith("xacro:"):
                out.set(name, str(self.value(value, scope)))
        self.build_content(element, out, scope)

    def build_content(self, element: Element, out: Element, scope: _Scope) -> None:
        """Add to an element what the children of another build."""
        text = self.value(element.text or "", scope)
        out.text = f"{out.text or ''}{text}".strip() or None
        for child in element:
            self.build_child(child, out, scope)

    def build_child(self, element: Element, out: Element, scope: _Scope) -> None:
        """Add to an element what another builds."""
        prefix, _, kind = element.tag.rpartition(":")
        if prefix != "xacro":
            self.build(element, SubElement(out, element.tag), scope)
            return
        match kind:
            case "if" | "unless":
                condition = _required(element, "value")
                holds = _truth(self.value(condition, scope), condition)
                if holds == (kind == "if"):
                    self.build_content(element, out, scope)
            case "property":
                self._build_property(element, scope)
            case "arg":
                name = _required(element, "name")
                default = _required(element, "default")
                self.declared.add(name)
                if name not in self.arguments:
                    self.arguments[name] = str(self.value(default, scope))
            case "macro":
                name = _required(element, "name").removeprefix("xacro:")
                if name == "call" or "." in name:
                    raise self._error(f"a macro cannot be called '{name}'")
                scope[f"xacro:{name}"] = element
            case "insert_block":
                name = _required(element, "name")
                if f"**{name}" in scope:
                    self.build_content(scope[f"**{name}"], out, scope)
                elif f"*{name}" in scope:
                    self.build_child(scope[f"*{name}"], out, scope)
                else:
                    raise self._error(f"there is no block '{name}'")
            case "include":
                self._build_include(element, out, scope)
            case "element":
                built = copy.copy(element)
                built.tag = self._text(element, "xacro:name", scope)
                self.build_child(built, out, scope)
            case "attribute":
                name = self._text(element, "name", scope)
                out.set(name, self._text(element, "value", scope))
            case "call":
                call = copy.copy(element)
                name = self._text(element, "macro", scope)
                del call.attrib["macro"]
                self._call(name, call, out, scope)
            case _:
                self._call(kind, element, out, scope)

    def _build_property(self, element: Element, scope: _Scope) -> None:
        name = self._text(element, "name", scope)
        if not name.isidentifier() or name.startswith("__"):
            raise self._error(
                f"property '{name}' is no name; use letters, digits and _"
            )
        value: Any = element.get("value")
        default = element.get("default")
        if _truth(self.value(element.get("remove", "false"), scope), "remove"):
            for outer in scope.maps:
                outer.pop(name, None)
            return
        if default is not None:
            if name in scope:
                return
            value = default
        if value is None:
            name = f"**{name}"
            value = element
        lazy = _truth(
            self.value(element.get("lazy_eval", "true"), scope), "lazy_eval"
        )
        target: MutableMapping[str, Any] = scope
        if (reach := element.get("scope")) in ("global", "parent"):
            lazy = False
            target = scope.maps[-1] if reach == "global" else scope.caller()
        if not lazy and isinstance(value, str):
            value = self.value(value, scope)
        value = _literal(value)
        unevaluated = lazy and isinstance(value, str)
        target[name] = _Unevaluated(value, scope) if unevaluated else value

    def _build_include(self, element: Element, out: Element, scope: _Scope) -> None:
        optional = _truth(element.get("optional", "false"), "optional")
        inner = scope
        if namespace := element.get("ns"):
            inner = _Scope(scope, is_namespace=True)
            name = str(self.value(namespace, scope))
            scope[f"{name}."] = inner
            scope[name] = Properties(partial(self._look_up, inner))
        for file in self._included(self._text(element, "filename", scope)):
            if optional and not os.path.exists(file):
                continue
            with self.inside(file):
                self.build_content(self.document(file), out, inner)

    def _call(
        self, name: str, element: Element, out: Element, scope: _Scope
    ) -> None:
        """Build what a macro builds with the attributes and blocks of an element."""
        try:
            macro, around = scope.macro(name)
        except KeyError:
            raise self._error(f"unknown macro name: xacro:{name}") from None
        inner = _Scope(around)
        parameters = dict(_parameters(macro.get("params", "")))
        for key, value in element.attrib.items():
            if key not in parameters:
                raise self._error(f"macro '{name}' has no parameter '{key}'")
            inner[key] = _literal(self.value(value, scope))
        content = Element("blocks")
        self.build_content(element, content, scope)
        blocks = list(content)
        for key, default in parameters.items():
            if key.startswith("*"):
                if not blocks:
                    raise self._error(f"macro '{name}' needs a block for '{key}'")
                inner[key] = blocks.pop(0)
            elif key not in element.attrib:
                inner[key] = _literal(self._default(name, key, default, scope))
        if blocks:
            raise self._error(f"macro '{name}' has no block for <{blocks[0].tag}>")
        self.build_content(macro, out, inner)

    def _default(
        self, macro: str, name: str, default: _Default, scope: _Scope
    ) -> Any:
        if default.forward and name in scope:
            return self._look_up(scope, name)
        if default.text is None:
            raise self._error(
                f"macro '{macro}' needs a value of its parameter '{name}'"
            )
        return self.value(default.text, scope)

    # Values

    def _look_up(self, scope: _Scope, name: str) -> Any:
        """Value of a property; KeyError where there is none."""
        value = scope[name]
        if isinstance(value, _Unevaluated):
            if name in self.evaluating:
                names = " -> ".join([*self.evaluating, name])
                raise self._error(f"properties need one another in a loop: {names}")
            self.evaluating.append(name)
            owner = value.scope
            value = owner[name] = _literal(self.value(value.text, owner))
            self.evaluating.pop()
        return value

    def _text(self, element: Element, key: str, scope: _Scope) -> str:
        """Value of an attribute that an element must have, as text."""
        return str(self.value(_required(element, key), scope))

    def value(self, text: str, scope: _Scope) -> Any:
        """Value of a text with its expressions and commands; of a single one with its type."""
        parts: list[Any] = []
        for part in _TEXT.finditer(text):
            if part["expression"] is not None:
                expression = str(self.value(part["expression"], scope))
                names = Names(self.functions, partial(self._look_up, scope))
                parts.append(self._evaluated(expression, names))
            elif part["command"] is not None:
                parts.append(self._command(str(self.value(part["command"], scope))))
            else:
                parts.append(part[0][1:] if part["escaped"] else part[0])
        return parts[0] if len(parts) == 1 else "".join(map(str, parts))

    def _evaluated(self, expression: str, names: Names) -> Any:
        short = _shortened(expression, 80)
        try:
            return evaluate(expression, names)
        except (ExcitantError, RecursionError, MemoryError):
            raise
        except Refused as error:
            raise self._error(
                f"the expression '{short}'{self._line(expression)} is refused: {error}; only "
                "plain values of bounded size are evaluated"
            ) from None
        except Exception as error:  # an expression of the file may raise any
            why = _shortened(str(error) or type(error).__name__, 300)
            raise self._error(
                f"xacro cannot evaluate '{short}'{self._line(expression)}: {why}"
            ) from None

    def _command(self, command: str) -> Any:
        """Value of ``$(command)``."""
        name, _, rest = command.strip().partition(" ")
        words = rest.split()
        if name == "eval":
            return str(self._evaluated(rest, self._names_of_arguments()))
        if name == "optenv" and words:
            return self.environment(words[0], " ".join(words[1:]))
        if name in self.commands and len(words) == 1:
            return self.commands[name](words[0])
        raise self._error(f"xacro does not know $({command})")

    def _names_of_arguments(self) -> Names:
        """Names in ``$(eval ..)``: arguments as what they look like, conversions, mathematics."""
        own = {
            "true": True,
            "false": False,
            **self.commands,
            "arg": lambda name: _typed(self.argument(name)),
            "optenv": lambda name, default="": self.environment(name, default),
        }
        arguments = {name: _typed(text) for name, text in self.arguments.items()}
        return Names(MATH | PYTHON | own, (arguments | own).__getitem__)

    def argument(self, name: str) -> str:
        """Value of an argument."""
        self.declared.add(name)
        if name not in self.arguments:
            raise self._error(
                f"xacro: undefined argument '{name}'; give it with --xacro-arg NAME:=VALUE "
                "(xacro_args in a robot.yaml)"
            )
        return self.arguments[name]

    def environment(self, name: str, default: str | None = None) -> str:
        """An environment variable: there is none, whatever is set."""
        if default is None:
            why = "asks for the environment, which is not read; write the value instead"
            raise self._error(f"$(env {name}) {why}")
        if name in os.environ:
            self.notes.append(f"$(optenv {name}) is taken as not set")
        return default

    # Files

    @contextmanager
    def inside(self, file: str) -> Iterator[None]:
        """Read a file, which others are named relative to."""
        self.files.append(file)
        if len(self.files) > _NESTED:
            why = f"files include one another more than {_NESTED} deep, perhaps in a loop"
            raise self._error(why)
        yield
        self.files.pop()

    def document(self, file: str) -> Element:
        """Root of a file."""
        try:
            text = read_text(file)
        except OSError as error:
            raise self._error(
                f"xacro cannot read {file}: {error.strerror}"
            ) from None
        except UnicodeDecodeError:
            text = read_description(file)
        self.texts[file] = text
        return parse_xml(text, file, "xacro", prefix="xacro")

    def find(self, name: str) -> str:
        """Folder of a package, as `package_folders` finds it."""
        folder = next(package_folders(name, self.path, self.packages), None)
        if folder is None:
            raise self._error(
                f"$(find {name}): the file lies in no package '{name}'; give its folder with "
                f"--package /path/to/{name}"
            )
        self.packages_found.append(folder)
        return str(folder)

    def _beside(self, file: str) -> str:
        """Path of a file that is named relative to the one that is read."""
        return os.path.join(os.path.dirname(self.files[-1]), file)

    def _included(self, named: str) -> Iterator[str]:
        """Files of an ``<xacro:include>``, whose name may hold ``*`` and the like."""
        path = self._beside(named)
        folder = os.path.dirname(path)
        if glob.has_magic(folder):
            raise self._error(
                f"it includes {path}: only the last part of a name may hold * or ?"
            )
        for file in sorted(glob.glob(path)) if glob.has_magic(path) else [path]:
            self._require_allowed(file)
            yield file

    def _require_allowed(self, file: str) -> None:
        """Refuse a file that the one that is read may not name."""
        allowed = [
            self.path.parent,
            *map(Path, self.packages),
            *self.packages_found,
        ]
        within(file, self.files[-1], allowed)

    def yaml(self, file: str) -> Any:
        """Content of a YAML file."""
        path = self._beside(file)
        self._require_allowed(path)
        try:
            text = read_text(path)
        except (OSError, UnicodeDecodeError) as error:
            why = getattr(error, "strerror", "not UTF-8")
            raise self._error(f"xacro cannot read {path}: {why}") from None
        with self.inside(path):
            return _dotted(parsed_yaml(text, self._loader()))

    def _loader(self) -> type[Loader]:
        """YAML whose numbers may have a unit, such as ``!degrees 90``."""

        class WithUnits(Loader):
            pass

        names = Names(self.functions, dict[str, Any]().__getitem__)

        def quantity(loader: Any, node: Any) -> float:
            value = self._evaluated(loader.construct_scalar(node), names)
            return float(value) * _UNITS[node.tag.removeprefix("!")]

        for unit in _UNITS:
            WithUnits.add_constructor(f"!{unit}", quantity)
        return WithUnits

    # Messages

    def _error(self, why: str) -> BadRobot:
        return BadRobot(self.path, why)

    def _line(self, expression: str) -> str:
        """File and line of an expression, where it stands there in one line."""
        for file, text in reversed(self.texts.items()):
            for number, line in enumerate(text.splitlines(), start=1):
                if expression in html.unescape(line):
                    return f" in line {number} of {file}"
        return ""


def _required(element: Element, key: str) -> str:
    value = element.get(key)
    if value is None:
        raise ValueError(f"<{element.tag}> lacks its attribute '{key}'")
    return value


def _parameters(text: str) -> Iterator[tuple[str, _Default]]:
    """Parameters of a macro: ``name``, ``name:=default``, ``name:=^|default``, ``*block``.

    Each comes with its default; a block is marked by ``*``.
    """
    while text := text.lstrip():
        if stated := _MACRO_ARGUMENT.match(text):
            name, forward, default = stated.groups()
            yield name, _Default(bool(forward), default or None)
            text = text[stated.end() :]
        else:
            name, *rest = text.split(None, 1)
            yield name, _Default()
            text = "".join(rest)


def _literal(value: Any) -> Any:
    """A text as the number or truth value that it stands for, or without its quotes."""
    if not isinstance(value, str):
        return value
    if len(value) >= 2 and value[0] == value[-1] == "'":
        return value[1:-1]
    if "_" in value:
        return value
    for kind in (int, float):
        with suppress(ValueError):
            return kind(value)
    truths = {"true": True, "True": True, "false": False, "False": False}
    return truths.get(value, value)


def _typed(text: str) -> Any:
    """An argument as what it looks like."""
    try:
        return float(text) if "." in text else int(text)
    except ValueError:
        return {"true": True, "false": False}.get(text.lower(), text)


def _truth(value: Any, condition: str) -> bool:
    value = _literal(value)
    if isinstance(value, str):
        raise ValueError(f'"{condition}" is "{value}", neither true nor false')
    return bool(value)


def _dotted(content: Any) -> Any:
    """Content of YAML whose keys are attributes too."""
    if isinstance(content, dict):
        return Entries({key: _dotted(value) for key, value in content.items()})
    return [_dotted(x) for x in content] if isinstance(content, list) else content


def _tokenize(text: str, sep: str = ",; ", skip_empty: bool = True) -> list[str]:
    words = re.split(f"[{re.escape(sep)}]", text)
    return [word for word in words if word] if skip_empty else words


def _fatal(*words: object) -> None:
    raise ValueError(" ".join(map(str, words)))


def _shortened(text: str, most: int) -> str:
    return text if len(text) < most else f"{text[: most - 3]}..."
