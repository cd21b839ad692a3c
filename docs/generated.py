"""Hook of the site: what the code says itself, in the place of a mark on a page."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any

NOTEBOOKS = Path(__file__).parent / "notebooks"
_MARK = re.compile(r"<!-- (commands|names|notebook) of (\S+) -->")


def on_page_markdown(markdown: str, **_: Any) -> str:
    """The page with help, docstrings or a notebook where its marks are."""
    makers = {"commands": commands, "names": names, "notebook": notebook}
    return _MARK.sub(lambda m: makers[m[1]](m[2]), markdown)


def commands(program: str) -> str:
    """Help of every command of a program, a section each."""
    from excitant.cli import app

    return str(app.generate_docs(output_format="markdown"))


def names(package: str) -> str:
    """Everything that a package or module offers, for mkdocstrings."""
    module = import_module(package)
    visible = [
        n
        for n, v in vars(module).items()
        if n[0] != "_" and not isinstance(v, ModuleType)
    ]
    public = sorted(
        getattr(module, "__all__", visible), key=lambda name: (name.lower(), name)
    )
    return "\n".join(f"::: {_place(module, name)}\n" for name in public)


def notebook(name: str) -> str:
    """The cells of a notebook, with what they showed when it was run last."""
    cells = json.loads((NOTEBOOKS / name).read_text("utf-8"))["cells"]
    return "\n\n".join(part for cell in cells for part in _parts(cell))


def _parts(cell: dict[str, Any]) -> Iterator[str]:
    source = "".join(cell["source"])
    yield source if cell["cell_type"] == "markdown" else f"```python\n{source}\n```"
    for shown in cell.get("outputs", ()):
        data = shown.get("data", {})
        if picture := data.get("image/png"):
            yield f'<img alt="what the cell draws" src="data:image/png;base64,{picture}">'
        elif table := data.get("text/html"):
            plain = re.sub(
                "<table[^>]*>", "<table>", re.sub("(?s)<style.*?</style>", "", table)
            )
            yield f"<div>{' '.join(plain.split())}</div>"
        else:
            yield f"```text\n{''.join(shown.get('text', ())) or data['text/plain']}\n```"


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
    found = getattr(package, name)
    if isinstance(found, ModuleType):
        return found.__name__
    if hasattr(package, "__path__") and find_spec(f"{package.__name__}.{name}"):
        return f"{found.__module__}.{name}"
    return f"{package.__name__}.{name}"
