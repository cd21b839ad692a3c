from . import plot
from .nouns import report, save
from .pages import SavedRun, compare, page_of
from .render import brief, html, load_templates, summary, table_lines
from .run import as_saved, load_run, read_result, save_run

__all__ = [
    "SavedRun",
    "as_saved",
    "brief",
    "compare",
    "html",
    "load_run",
    "load_templates",
    "page_of",
    "plot",
    "read_result",
    "report",
    "save",
    "save_run",
    "summary",
    "table_lines",
]
