"""One self-contained HTML page from a saved result."""

from __future__ import annotations

from functools import cache

import jinja2
from markupsafe import Markup, escape

from excitant.reports.drawing import style
from excitant.reports.reading import Result, Series
from excitant.reports.sections import build_page


def render(result: Result, series: Series) -> str:
    """Report page of a result: no network, no scripts, figures drawn inside.

    Args:
        result: Content of ``result.json``; keys it lacks are left out of the page.
        series: Content of ``series.npz``.

    Raises:
        BadInput: The result's ``verb`` is none that has a report.
    """
    with style():
        page = build_page(result, series)
    return _environment().get_template("report.html.j2").render(page=page)


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
