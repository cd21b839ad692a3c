"""Hook of the site: what the code says itself, in the place of a mark on a page."""

from __future__ import annotations

import re
from importlib import import_module
from importlib.util import find_spec
from types import ModuleType
from typing import Any

_MARK = re.compile(r"<!-- (commands|names) of (\S+) -->")


def on_page_markdown(markdown: str, **_: Any) -> str:
    """The page with help or docstrings where its marks are."""
    return _MARK.sub(lambda m: {"commands": commands, "names": names}[m[1]](m[2]), markdown)


def commands(program: str) -> str:
    """Help of every command of a program, a section each."""
    from excitant.cli import app

    return str(app.generate_docs(output_format="markdown"))


def names(package: str) -> str:
    """Everything that a package or module offers, for mkdocstrings."""
    module = import_module(package)
    visible = [n for n, v in vars(module).items() if n[0] != "_" and not isinstance(v, ModuleType)]
    public = sorted(getattr(module, "__all__", visible), key=lambda name: (name.lower(), name))
    return "\n".join(f"::: {_place(module, name)}\n" for name in public)


def arms() -> tuple[str, str]:
    """The table of the built-in arms and their sources, as arms.md has them."""
    from excitant.robots.library import catalogue, catalogue_rows

    heads, *rows = catalogue_rows()
    table = ["| " + " | ".join(heads) + " |", "|" + " --- |" * len(heads)]
    table += ["| `" + "` | ".join((row[0], " | ".join(row[1:]))) + " |" for row in rows]
    sources = [f"**{arm.name}.** {arm.sources}" for arm in catalogue()]
    return "\n".join(table), "\n\n".join(sources)


def _place(package: ModuleType, name: str) -> str:
    """Where a name is defined, if a module of the package has the same name."""
    if hasattr(package, "__path__") and find_spec(f"{package.__name__}.{name}"):
        return f"{getattr(package, name).__module__}.{name}"
    return f"{package.__name__}.{name}"
