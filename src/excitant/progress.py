"""A progress bar on a terminal, nothing in a pipe."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import rich.console
import rich.progress

Advance = Callable[[float, str], None]
"""Called with the fraction done and a few words on how it stands."""


@contextmanager
def progress_bar(label: str) -> Iterator[Advance]:
    """Show a bar on the error stream while the block runs, when that is a terminal."""
    console = rich.console.Console(stderr=True)
    if not console.is_terminal:
        yield lambda fraction, words: None
        return
    columns = (
        rich.progress.TextColumn("{task.description}"),
        rich.progress.BarColumn(),
        rich.progress.TimeElapsedColumn(),
        rich.progress.TextColumn("{task.fields[words]}"),
    )
    with rich.progress.Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(label, total=1.0, words="")
        yield lambda fraction, words: bar.update(task, completed=fraction, words=words)
