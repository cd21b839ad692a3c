"""A progress bar on a terminal, nothing in a pipe."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from excitant.interrupts import check
from excitant.names import printable

_LONGEST = 36_000.0  # s over which speed is averaged: all of the work so far

Advance = Callable[[float, str], None]
"""Called with the fraction done and a few words on how it stands."""


@contextmanager
def progress_bar(label: str) -> Iterator[Advance]:
    """Show a bar with the time left on the error stream while the block runs, on a terminal.

    Until the first call it only shows that work goes on. A call after Ctrl-C raises
    KeyboardInterrupt, should the signal itself have been lost.
    """
    if not sys.stderr.isatty():
        yield lambda fraction, words: check()
        return
    from rich import progress as show
    from rich.console import Console
    from rich.markup import escape

    def update(fraction: float, words: str) -> None:
        check()
        bar.update(
            task, total=1.0, completed=fraction, words=escape(printable(words))
        )

    columns = (
        *("{task.description}", show.BarColumn(), show.TimeElapsedColumn()),
        *("left", show.TimeRemainingColumn(), "{task.fields[words]}"),
    )
    options: Any = {
        "console": Console(stderr=True),
        "speed_estimate_period": _LONGEST,
    }
    with show.Progress(*columns, transient=True, **options) as bar:
        task = bar.add_task(label, total=None, words="")
        yield update
