"""Xacro files as URDF text, without ROS."""

from __future__ import annotations

import ast
import contextlib
import io
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import CodeType
from typing import Any

from excitant.exceptions import BadRobot, ExcitantError, UnknownName


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
    """
    import xacro

    path, given = Path(path), _Arguments(arguments)
    try:
        with _own_functions(path, packages), contextlib.redirect_stderr(io.StringIO()) as said:
            document = xacro.process_file(str(path), mappings=given)
    except Exception as error:  # an expression of the file may raise any
        inner = getattr(error, "exc", error)
        if isinstance(inner, ExcitantError):
            raise inner from None
        raise BadRobot(path, _reason(error, said.getvalue())) from None
    for name in arguments:
        if name not in given.declared:
            raise BadRobot(path, str(UnknownName("xacro argument", name, sorted(given.declared))))
    if not document.getElementsByTagName("link"):
        why = "if it only defines macros, give the file that calls them"
        raise BadRobot(path, f"this xacro file builds no links; {why}")
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
def _own_functions(path: Path, packages: Sequence[str | Path]) -> Iterator[None]:
    """Let ``$(find name)`` look into folders instead of a ROS installation, and evaluate safely."""

    def find(name: str) -> str:
        return str(_package_folder(name, path, packages))

    import xacro
    from xacro import substitution_args as arguments

    own = (
        (
            vars(arguments),
            {
                "_eval_find": find,
                "_eval": _evaluated_substitution,
                "_eval_dict": {**arguments._eval_dict, "find": find},
            },
        ),
        (vars(xacro), {"safe_eval": _evaluated}),
    )
    before = [{name: module[name] for name in functions} for module, functions in own]
    python = xacro._global_symbols["python"]
    removed = {name: python.pop(name) for name in _LEADING_OUT}
    for module, functions in own:
        module.update(functions)
    try:
        yield
    finally:
        python.update(removed)
        for (module, _), functions in zip(own, before, strict=True):
            module.update(functions)


def _evaluated(expression: str, names: dict[str, Any]) -> Any:
    """Value of an expression ``${..}`` that reaches nothing but the names that xacro offers."""
    names.update({"__builtins__": {}, _ATTRIBUTE: _attribute})
    return eval(_compiled(expression), names)


def _evaluated_substitution(expression: str, context: dict[str, Any]) -> str:
    """Value of ``$(eval ..)``, which sees arguments, mathematics and conversions of types."""
    from xacro import substitution_args

    known, given = substitution_args._eval_dict, context.setdefault("arg", {})
    arguments = {name: substitution_args.convert_value(x, "auto") for name, x in given.items()}

    def dirname() -> str:
        return str(substitution_args._eval_dirname(context["filename"]))

    own = {"arg": arguments.__getitem__, "dirname": dirname}
    return str(_evaluated(expression, arguments | own | known["__builtins__"] | known))


_ATTRIBUTE = "attribute of"  # no name that an expression could have
_LEADING_OUT = ("type", "vars")  # functions that xacro offers and that lead to everything else
_UNSAFE = "an expression uses {}, which is refused as unsafe"


def _compiled(expression: str) -> CodeType:
    """Code of an expression whose attributes are looked up by `_attribute`."""
    tree = ast.parse(expression.strip(), mode="eval")
    for node in ast.walk(tree):
        name = node.id if isinstance(node, ast.Name) else ""
        if name.startswith("__"):
            raise ValueError(_UNSAFE.format(name))
    return compile(ast.fix_missing_locations(_Attributes().visit(tree)), "<expression>", "eval")


class _Attributes(ast.NodeTransformer):
    """Replaces every ``value.name`` by a call."""

    def visit_Attribute(self, node: ast.Attribute) -> ast.Call:
        found = ast.Name(_ATTRIBUTE, ast.Load())
        return ast.Call(found, [self.visit(node.value), ast.Constant(node.attr)], [])


def _attribute(value: Any, name: str) -> Any:
    """An attribute of plain data or of one of xacro's name spaces; no other object has any."""
    plain = isinstance(value, (str, int, float, list, tuple, dict))
    if not plain or name.startswith("_") or name in ("format", "format_map"):
        raise ValueError(_UNSAFE.format(f"{type(value).__name__}.{name}"))
    return getattr(value, name)


def _package_folder(name: str, path: Path, packages: Sequence[str | Path]) -> Path:
    """Folder of a package: among those given, or around a file."""
    for around in (*(Path(given).resolve() for given in packages), *path.resolve().parents):
        for folder in (around, around / name):
            if folder.is_dir() and _package_name(folder) == name:
                return folder
    raise BadRobot(
        path,
        f"$(find {name}): there is no package '{name}' around the file; give its folder with "
        f"--package /path/to/{name} (packages: [..] in a robot.yaml)",
    )


def _package_name(folder: Path) -> str:
    """Name that a folder's package.xml gives it, else its own."""
    try:
        name = ET.parse(folder / "package.xml").findtext("name")
    except (OSError, ET.ParseError):
        name = None
    return (name or folder.name).strip()
