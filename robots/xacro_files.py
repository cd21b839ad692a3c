"""Xacro files as URDF text, without ROS."""

from __future__ import annotations

import contextlib
import io
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from xml.parsers.expat import ExpatError

import xacro
from xacro import substitution_args

from excitant.exceptions import BadRobot, ExcitantError, UnknownName

_REFUSALS = (
    xacro.XacroException, ExpatError, OSError, ValueError, TypeError, KeyError, AttributeError,
    SyntaxError, NameError, ZeroDivisionError, RuntimeError,
)  # fmt: skip
"""What xacro raises: its own errors, and those of the expressions it evaluates."""


def is_xacro(text: str) -> bool:
    """Whether the text of a robot needs xacro."""
    return "xacro" in text and any(sign in text for sign in ("<xacro:", "${", "$("))


def urdf_from_xacro(
    path: str | Path, arguments: Mapping[str, str], packages: Sequence[str | Path] = ()
) -> str:
    """URDF text of a xacro file.

    Args:
        path: The file.
        arguments: Values of its ``<xacro:arg>`` by name.
        packages: Folders in which ``$(find name)`` looks: the package itself, or a folder that
            holds it. Folders around the file are searched without being named.

    Raises:
        BadRobot: A package that is not found, an argument that the file does not have or that it
            misses, or anything else that xacro refuses.
    """
    path, given = Path(path), _Arguments(arguments)
    try:
        with _finding_packages(path, packages), contextlib.redirect_stderr(io.StringIO()) as said:
            document = xacro.process_file(str(path), mappings=given)
    except ExcitantError:
        raise
    except _REFUSALS as error:
        inner = getattr(error, "exc", None)
        if isinstance(inner, ExcitantError):
            raise inner from None
        raise BadRobot(path, _reason(error, said.getvalue())) from None
    for name in arguments:
        if name not in given.declared:
            raise BadRobot(path, str(UnknownName("xacro argument", name, sorted(given.declared))))
    if not document.getElementsByTagName("link"):
        raise BadRobot(
            path,
            "this xacro file builds no links; if it only defines macros, give the file that calls "
            "them",
        )
    text: str = document.toxml()
    return text


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
    if "Undefined substitution argument" in why or "undefined arg" in why.lower():
        return f"xacro: {why}; give it with --xacro-arg NAME:=VALUE (xacro_args in a robot.yaml)"
    last = [line for line in said.splitlines() if line.strip() and "in file" not in line]
    where = f" ({last[-1].strip()})" if last and last[-1].strip() not in why else ""
    return f"xacro cannot read it: {why}{where}"


@contextlib.contextmanager
def _finding_packages(path: Path, packages: Sequence[str | Path]) -> Iterator[None]:
    """Let xacro's ``$(find name)`` look into folders instead of a ROS installation."""

    def find(name: str) -> str:
        return str(package_folder(name, path, packages))

    functions = substitution_args._eval_dict
    before = substitution_args._eval_find, functions["find"]
    substitution_args._eval_find = functions["find"] = find
    try:
        yield
    finally:
        substitution_args._eval_find, functions["find"] = before


def package_folder(name: str, path: Path, packages: Sequence[str | Path]) -> Path:
    """Folder of a package: among those given, or around a file.

    Raises:
        BadRobot: There is none of this name.
    """
    for given in map(Path, packages):
        for folder in (given, given / name):
            if folder.is_dir() and _package_name(folder) == name:
                return folder.resolve()
    for above in path.resolve().parents:
        for folder in (above, above / name):
            if folder.is_dir() and _package_name(folder) == name:
                return folder
    raise BadRobot(
        path,
        f"$(find {name}): there is no package '{name}' around the file; give its folder with "
        f"--package /path/to/{name} (packages: [..] in a robot.yaml)",
    )


def _package_name(folder: Path) -> str:
    """Name that a folder's package.xml gives it, else its own."""
    manifest = folder / "package.xml"
    try:
        name = ET.parse(manifest).findtext("name")
    except (OSError, ET.ParseError):
        name = None
    return (name or folder.name).strip()
