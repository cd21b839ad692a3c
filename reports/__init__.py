"""Reports: pages and summaries drawn from saved results only."""

from excitant.reports.brief import brief
from excitant.reports.comparison import SavedRun, compare
from excitant.reports.html import render
from excitant.reports.run import load_run, save_run
from excitant.reports.summary import summarize

__all__ = ["SavedRun", "brief", "compare", "load_run", "render", "save_run", "summarize"]
