"""Xacro files as URDF text, without ROS, and without running what they hold.

The macro engine is that of ROS; expressions are evaluated by `excitant.robots.expressions`, files
are read within the folders that a description may reach, the environment is empty, and work is
bounded. ``trust`` leaves all that to Python, as ROS does.
"""

from __future__ import annotations

import contextlib
import glob
import html
import io
import os
import re
import time
import xml.dom.expatbuilder
import xml.dom.xmlbuilder
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from excitant.exceptions import BadRobot, ExcitantError, UnknownName
from excitant.files import read_text
from excitant.robots.expressions import (
    LARGEST,
    MATH,
    PYTHON,
    Function,
    Refused,
    Space,
    evaluate,
)
from excitant.robots.files import (
    package_folders,
    parse_xml,
    read_description,
    within,
)
from excitant.robots.schema import Loader, parsed_yaml

_WORK = 20_000_000  # steps and characters that one file may take
_ELEMENT = 200  # steps that an element counts for
_SECONDS = 10.0  # of processor time
_NESTED = 50  # files that include one another
_TRUST = "if you trust the file, --trust-xacro runs it as Python"


def is_xacro(text: str) -> bool:
    """Whether the text of a robot needs xacro."""
    return "xacro" in text and any(sign in text for sign in ("<xacro:", "${", "$("))


def urdf_from_xacro(
    path: str | Path,
    arguments: Mapping[str, str],
    packages: Sequence[str | Path] = (),
    *,
    trust: bool = False,
) -> tuple[str, tuple[str, ...]]:
    """URDF text of a xacro file, and what it was denied, as sentences.

    Args:
        path: The file.
        arguments: Values of its ``<xacro:arg>`` by name.
        packages: Folders in which ``$(find name)`` looks: the package itself, or a folder that
            holds it. Folders around the file are searched without being named.
        trust: Whether its expressions run as Python, with all files and the environment.
    """
    import xacro

    path = Path(path)
    given = _Arguments(arguments)
    reading = _Reading(path, packages)
    try:
        with (
            _replaced(reading.trusted() if trust else reading.bounded()),
            contextlib.redirect_stderr(io.StringIO()) as said,
        ):
            document = xacro.process_file(str(path), mappings=given)
            built = document.getElementsByTagName("link")
            text = str(document.toxml())
    except Exception as error:  # an expression of the file may raise any
        inner: BaseException | None = error
        while inner is not None and not isinstance(inner, ExcitantError):
            inner = getattr(inner, "exc", None)
        if inner is not None:
            raise inner from None
        raise BadRobot(path, _reason(error, said.getvalue())) from None
    for name in arguments:
        if name not in given.declared:
            raise BadRobot(
                path, str(UnknownName("xacro argument", name, sorted(given.declared)))
            )
    if not built:
        why = "if it only defines macros, give the file that calls them"
        raise BadRobot(path, f"this xacro file builds no links; {why}")
    return text, tuple(reading.notes)


class _Arguments(dict[str, str]):
    """Arguments that remember which ones the files declare or use."""

    def __init__(self, given: Mapping[str, str]) -> None:
        super().__init__(given)
        self.declared: set[str] = set()

    def __contains__(self, name: object) -> bool:
        """Whether a value is given; xacro asks when it meets a declaration."""
        self.declared.add(str(name))
        return super().__contains__(name)

    def __getitem__(self, name: str) -> str:
        """The value; xacro asks for it where the argument is used."""
        self.declared.add(name)
        return super().__getitem__(name)


def _reason(error: Exception, said: str) -> str:
    why = str(error) or type(error).__name__
    if isinstance(error, (RecursionError, MemoryError)) or "recursion depth" in why:
        return "its macros or expressions lie too deep within one another, perhaps in a loop"
    if "Undefined substitution argument" in why or "undefined arg" in why.lower():
        return f"xacro: {why}; give it with --xacro-arg NAME:=VALUE (xacro_args in a robot.yaml)"
    last = [
        line for line in said.splitlines() if line.strip() and "in file" not in line
    ]
    where = f" ({last[-1].strip()})" if last and last[-1].strip() not in why else ""
    return _short(f"xacro cannot read it: {why}{where}", 400)


Replacements = Sequence[tuple[dict[str, Any], Mapping[str, Any]]]


@contextlib.contextmanager
def _replaced(own: Replacements) -> Iterator[None]:
    """Put functions into xacro's modules for a while."""
    before = [{name: module[name] for name in functions} for module, functions in own]
    for module, functions in own:
        module.update(functions)
    try:
        yield
    finally:
        for (module, _), functions in zip(own, before, strict=True):
            module.update(functions)


class _Reading:
    """What xacro gets in place of its own functions, while it reads one file."""

    def __init__(self, path: Path, packages: Sequence[str | Path]) -> None:
        import xacro

        self.xacro, self.path, self.packages = xacro, path, tuple(packages)
        self.found: list[Path] = []  # packages that the file asked for
        self.texts: dict[str, str] = {}
        self.notes: list[str] = []
        self.work, self.start = 0, time.thread_time()
        self.names = {**MATH, **PYTHON, **self._own()}
        self.names |= {
            "math": Space(MATH),
            "python": Space(PYTHON),
            "xacro": Space(self._own()),
        }

    def trusted(self) -> Replacements:
        """Only packages are sought without a ROS installation."""
        from xacro import substitution_args as arguments

        known = {**arguments._eval_dict, "find": self.find}
        return [(vars(arguments), {"_eval_find": self.find, "_eval_dict": known})]

    def bounded(self) -> Replacements:
        """Everything that runs, reads or repeats."""
        from xacro import substitution_args as arguments

        return [
            (
                vars(arguments),
                {
                    "_eval_find": self.find,
                    "_eval_env": self.environment,
                    "_eval_optenv": self.environment,
                    "_eval": self.substitution,
                },
            ),
            (
                vars(self.xacro),
                {
                    "safe_eval": self.expression,
                    "eval_text": self._counted(self.xacro.eval_text),
                    "eval_all": self._counted(self.xacro.eval_all),
                    "eval_extension": self._counted(self.xacro.eval_extension),
                    "get_include_files": self.includes,
                    "parse": self.parse,
                    "re_macro_arg": _MACRO_ARGUMENT,
                    "_global_symbols": self.names,
                },
            ),
        ]

    def spend(self, amount: int) -> None:
        """Count work, and end it when it is too much."""
        self.work += amount
        if self.work > _WORK or time.thread_time() - self.start > _SECONDS:
            raise BadRobot(
                self.path,
                "this xacro file takes too much work, perhaps in macros that call one another; "
                f"{_TRUST} for as long as it takes",
            )

    def _counted(self, function: Any) -> Any:
        def counted(given: Any, *others: Any) -> Any:
            size = len(given) if isinstance(given, str) else _ELEMENT
            if size > LARGEST:
                raise BadRobot(
                    self.path, f"a text in it has more than {LARGEST} characters"
                )
            self.spend(1 + size)
            found = function(given, *others)
            self.spend(len(found) if isinstance(found, str) else 0)
            return found

        return counted

    def find(self, name: str) -> str:
        """Folder of a package: among those given, or around the file."""
        folder = next(package_folders(name, self.path, self.packages), None)
        if folder is None:
            raise BadRobot(
                self.path,
                f"$(find {name}): there is no package '{name}' around the file; give its folder "
                f"with --package /path/to/{name} (packages: [..] in a robot.yaml)",
            )
        self.found.append(folder)
        return str(folder)

    def environment(self, name: str, default: str | None = None) -> str:
        """An environment variable: there is none, whatever is set."""
        if default is None:
            raise BadRobot(
                self.path, f"$(env {name}) asks for the environment; {_TRUST}"
            )
        if name in os.environ:
            self.notes.append(
                f"$(optenv {name}) is taken as not set; --trust-xacro reads it"
            )
        return default

    def expression(self, expression: str, names: Mapping[str, Any]) -> Any:
        """Value of ``${..}``."""
        try:
            value = evaluate(expression, names, self.spend)
        except Refused as error:
            where = self._where(expression)
            raise BadRobot(
                self.path,
                f"the expression '{_short(expression)}'{where} {error}; only plain values of "
                f"bounded size are evaluated; {_TRUST}",
            ) from None
        self.spend(len(value) if isinstance(value, str) else 0)
        return value

    def substitution(self, expression: str, context: dict[str, Any]) -> str:
        """Value of ``$(eval ..)``, which sees arguments, mathematics and conversions of types."""
        from xacro import substitution_args

        given = context.setdefault("arg", {})
        arguments = {
            name: substitution_args.convert_value(x, "auto")
            for name, x in given.items()
        }
        own = {
            "true": True,
            "false": False,
            "arg": Function(lambda name: arguments[name]),
            "dirname": Function(
                lambda: substitution_args._eval_dirname(context["filename"])
            ),
            "find": Function(self.find),
            "env": Function(self.environment),
            "optenv": Function(
                lambda name, default="": self.environment(name, default)
            ),
        }
        return str(self.expression(expression, MATH | PYTHON | arguments | own))

    def _where(self, expression: str) -> str:
        """File and line of an expression, where it stands there in one line."""
        for file, text in reversed(self.texts.items()):
            for number, line in enumerate(text.splitlines(), start=1):
                if expression in html.unescape(line):
                    return f" in line {number} of {file}"
        return ""

    def parse(self, inp: object, filename: str) -> Any:
        """Document of a file, without its comments."""
        del inp  # xacro has none when it reads a file
        files = self.xacro.filestack
        if len(files) > _NESTED:
            why = (
                f"files include one another more than {_NESTED} deep, perhaps in a loop"
            )
            raise BadRobot(self.path, why)
        try:
            text = read_text(filename)
        except OSError as error:
            files.pop()
            raise self.xacro.XacroException(
                f"{error.strerror}: {filename}", exc=error
            ) from None
        except UnicodeDecodeError:
            text = read_description(filename)
        self.spend(len(text))
        parse_xml(text, filename, "xacro")
        self.texts[filename] = text
        options = xml.dom.xmlbuilder.Options()
        options.comments = False
        return xml.dom.expatbuilder.ExpatBuilderNS(options).parseString(text)

    def includes(self, named: str, symbols: Any) -> Iterator[str]:
        """Files of an ``<xacro:include>``, whose name may hold ``*`` and the like."""
        path = self.xacro.abs_filename_spec(str(self.xacro.eval_text(named, symbols)))
        folder, name = os.path.split(path)
        if glob.has_magic(folder):
            why = f"it includes {path}: only the last part of a name may hold * or ?; {_TRUST}"
            raise BadRobot(self.path, why)
        found = sorted(glob.glob(path)) if glob.has_magic(name) else [path]
        for file in found:
            yield str(self._within(file))

    def _within(self, file: str) -> Path:
        """A file that the one that is read may name."""
        here = self.xacro.filestack[-1] or self.path
        within(file, here, (self.path.parent, *self.packages, *self.found))
        return Path(file)

    def _own(self) -> dict[str, Any]:
        """Functions of xacro's own."""
        silent = Function(lambda *_, **__: "")
        return {
            "load_yaml": Function(self.yaml),
            "abs_filename": Function(self.xacro.abs_filename_spec),
            "dotify": Function(self.xacro.YamlDictWrapper),
            "arg": Function(
                lambda name: self.xacro.substitution_args_context["arg"][name]
            ),
            "tokenize": Function(_tokenize),
            "fatal": Function(_fatal),
            **dict.fromkeys(("message", "warning", "error", "print_location"), silent),
        }

    def yaml(self, file: str) -> Any:
        """Content of a YAML file, whose keys are attributes too."""
        path = self._within(self.xacro.abs_filename_spec(file))
        try:
            text = read_text(path)
        except (OSError, UnicodeDecodeError) as error:
            why = f"{getattr(error, 'strerror', 'not UTF-8')}: {path}"
            raise self.xacro.XacroException(why) from None
        self.spend(len(text))
        self.xacro.filestack.append(str(path))
        try:
            content = parsed_yaml(text, _units(self.xacro))
        finally:
            self.xacro.filestack.pop()
        return self.xacro.YamlListWrapper.wrap(content)


def _units(xacro: Any) -> type[Loader]:
    """YAML whose numbers may have a unit, such as ``!degrees 90``."""

    class WithUnits(Loader):
        pass

    for unit in xacro.ConstructUnits:
        WithUnits.add_constructor(unit.value.tag, unit.constructor)
    return WithUnits


def _tokenize(text: str, sep: str = ",; ", skip_empty: bool = True) -> list[str]:
    found = re.split(f"[{re.escape(sep)}]", text)
    return [item for item in found if item] if skip_empty else found


def _fatal(*words: object) -> None:
    raise ValueError(" ".join(map(str, words)))


def _short(text: str, most: int = 80) -> str:
    return text if len(text) < most else f"{text[: most - 3]}..."


# xacro's own takes time that is exponential in the length of some texts
_MACRO_ARGUMENT = re.compile(
    r"""^\s*([^\s:=]+?)\s*:?=\s*(\^\|?)?(\$\{.*?\}|\$\(.*?\)|(?:'[^']*'|"[^"]*"|[^\s'"])+|)"""
    r"(?:\s+|$)(.*)"
)
