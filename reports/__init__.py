"""Reports: pages and texts drawn from saved results only."""

from excitant.reports.pages import SavedRun, compare, page_of
from excitant.reports.render import brief, html, summary, table_lines
from excitant.reports.run import load_run, save_run
from excitant.reports.tables import table_files

__all__ = [
    "SavedRun",
    "brief",
    "compare",
    "html",
    "load_run",
    "page_of",
    "save_run",
    "summary",
    "table_files",
    "table_lines",
]
