"""One self-contained HTML page from a saved result."""

from __future__ import annotations

import hashlib
from base64 import b64encode
from functools import cache
from importlib.resources import files

import jinja2
from markupsafe import Markup, escape

from excitant.reports.drawing import style
from excitant.reports.model import Page
from excitant.reports.reading import Result, Series
from excitant.reports.sections import build_page


def render(result: Result, series: Series) -> str:
    """Report page of a result: no network, figures drawn inside.

    Its one script enlarges figures; the page allows no other, and can do without it.

    Args:
        result: Content of ``result.json``; keys it lacks are left out of the page.
        series: Content of ``series.npz``.

    Raises:
        BadInput: The result's ``verb`` is none that has a report.
    """
    with style():
        page = build_page(result, series)
    return written(page)


def written(page: Page) -> str:
    """A page as HTML."""
    script = _script()
    digest = b64encode(hashlib.sha256(script.encode()).digest()).decode()
    return (
        _environment()
        .get_template("report.html.j2")
        .render(page=page, script=Markup(script), script_hash=f"sha256-{digest}")
    )


@cache
def _script() -> str:
    return (files("excitant.reports") / "templates" / "report.js").read_text("utf-8")


@cache
def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("excitant.reports"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.filters["drawing"] = Markup  # SVG of ours, its texts are escaped
    environment.filters["breakable"] = _breakable
    return environment


def _breakable(name: str) -> Markup:
    """A name, escaped, that may break after an underscore where lines are short."""
    return Markup(str(escape(name)).replace("_", "_<wbr>"))
