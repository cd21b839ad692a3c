"""What on-line estimation did over time: facts, messages and drawings."""

from __future__ import annotations

import numpy as np

from excitant.reports.design_section import known_facts
from excitant.reports.model import FAIR, GOOD, Block, Cell, Fact, Facts, Table, table
from excitant.reports.online_figures import (
    ENOUGH,
    convergence_figure,
    estimates_figure,
    excitation_figure,
    excitation_levels,
    history_of,
    left_figure,
)
from excitant.reports.reading import Result, Series, at, real, records, text
from excitant.reports.wording import number, percent, quantity

_MESSAGES = 8  # shown without opening a fold

Parts = list[tuple[str, list[Block | None]]]


def online_parts(result: Result, series: Series) -> Parts:
    """Parts of the page that `identify --online` adds; none without its result."""
    if at(result, "online") is None:
        return []
    history = history_of(result, series)
    return [
        ("On-line estimation", [_facts(result), _message_table(result)]),
        ("Estimates over time", [left_figure(history), estimates_figure(history)]),
        ("Excitation over time", [excitation_figure(result)]),
        ("Convergence", [convergence_figure(result)]),
    ]


def _facts(result: Result) -> Facts | None:
    converged = at(result, "online", "converged")
    state = {True: "yes", False: "not yet"}.get(converged) if isinstance(converged, bool) else None
    t, level = excitation_levels(result)
    judged = np.isfinite(level)
    share = float((level[judged] >= ENOUGH).mean()) if judged.any() else None
    delay = real(result, "online", "delay_s")
    facts = [
        Fact(
            "Converged",
            state or "–",
            "every joint's torque surer than one row of data",
            GOOD if state == "yes" else FAIR,
        ),
        Fact(
            "Exciting enough",
            percent(share),
            f"of the windows at {int(judged.sum())} looks" if judged.any() else "too short to say",
        ),
        Fact(
            "Delay",
            quantity(None if delay is None else 1e3 * delay, "ms"),
            "age of the newest instant the estimate speaks about",
        ),
    ]
    if len(t):
        facts.append(Fact("Duration", quantity(float(t[-1] - t[0]), "s"), f"{len(t)} looks kept"))
    return known_facts(facts)


def _message_table(result: Result) -> Table | None:
    rows: list[list[Cell | str]] = [
        [number(at(row, "t"), 4), text(row, "text")]
        for row in records(result, "online", "messages")
    ]
    if not rows:
        return None
    return table(
        "number:Time [s] | text:Message",
        rows,
        "What the monitor said while the samples came in; it speaks when something changes.",
        f"All {len(rows)} messages of the monitor" if len(rows) > _MESSAGES else "",
    )
