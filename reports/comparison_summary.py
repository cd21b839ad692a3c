"""Two runs side by side as plain text."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from excitant.reports.plain_text import Cells, fields, numbers_first, one_line, sentences, table
from excitant.reports.reading import Result, at, items, real, records, text, words
from excitant.reports.wording import plain


def comparison_lines(result: Result) -> list[str]:
    """Summary of a comparison: which runs, key figures, then what differs."""
    lines = fields("", result, ("of",))
    for side, run in zip("AB", records(result, "runs"), strict=False):
        lines += fields("", {side: text(run, "name")}, (side,))
    sections = at(result, "sections")
    if not isinstance(sections, Mapping):
        return lines + _compared(result)
    for verb, content in sections.items():
        lines += ["", f"[[{verb}]]", *_compared(content)]
    return lines


def _compared(result: Result) -> list[str]:
    lines = sentences("remarks", words(result, "remarks"))
    lines += _key_figures(result)
    for key, write in _WRITERS.items():
        if at(result, key) is not None:
            lines += write(result)
    return lines


def _key_figures(result: Result) -> list[str]:
    rows: list[Cells] = []
    said: list[str] = []
    for row in records(result, "key_figures"):
        label, unit = text(row, "figure"), text(row, "unit")
        values = [at(row, side) for side in "ab"]
        if any(isinstance(value, str) for value in values):
            said += [
                f"{label}, {s.upper()}: {value or '-'}"
                for s, value in zip("ab", values, strict=True)
            ]
        elif any(value is not None for value in values):
            name = f"{label} [{unit}]" if unit else label
            numbers = [real(value) for value in values]
            rows.append((name, *numbers, real(row, "difference"), text(row, "better") or "-"))
    return [
        *table("key figures", ("figure", "A", "B", "B - A", "better"), rows),
        *sentences("settings", said),
    ]  # fmt: skip


def _errors(result: Result) -> list[str]:
    lines = []
    rows = records(result, "errors")
    models = [key for key in (rows[0] if rows else ()) if key not in ("name", "change")]
    for model in models:
        cells: list[Cells] = [
            (
                text(row, "name"),
                *(real(row, model, side, key) for key in ("rms", "nrmse", "r2") for side in "ab"),
            )
            for row in rows
        ]
        heads = ("joint", "rms A", "rms B", "nrmse A", "nrmse B", "r2 A", "r2 B")
        lines += table(f"error: {model}", heads, cells)
    return lines


def _estimates(key: str) -> Callable[[Result], list[str]]:
    title = plain(key)

    def write(result: Result) -> list[str]:
        rows: list[Cells] = [
            (
                text(row, "name"),
                *(real(row, side, what) for side in "ab" for what in ("value", "std")),
                real(row, "deviations"),
                "apart" if at(row, "apart") else "-",
            )
            for row in records(result, key, "rows")
        ]
        heads = ("A", "std A", "B", "std B", "deviations", "verdict")
        only = [f"only in {s.upper()}: {name}" for s in "ab"
                for name in words(result, key, f"only_{s}")]  # fmt: skip
        return [
            *fields("", at(result, key), ("judged", "apart")),
            *numbers_first(title, heads, rows),
            *sentences(f"{title} of one run", only),
        ]

    return write


def _limits(result: Result) -> list[str]:
    rows: list[Cells] = [
        (
            text(row, "quantity"),
            *(real(row, side, "ratio") for side in "ab"),
            *(text(row, side, "joint") or "-" for side in "ab"),
        )
        for row in records(result, "limits")
    ]
    return table("limits: worst ratio", ("quantity", "A", "B", "joint A", "joint B"), rows)


def _listed(key: str, name: str) -> Callable[[Result], list[str]]:
    def write(result: Result) -> list[str]:
        found = at(result, key)
        groups = [("both", [at(pair, "a") for pair in records(found, "common")])]
        groups += [(f"only {s.upper()}", list(items(found, f"only_{s}"))) for s in "ab"]
        return sentences(
            key,
            [
                f"{by}: {text(row, name)} at {', '.join(words(row, 'joints')) or '-'}"
                for by, rows in groups
                for row in rows
            ],
        )

    return write


def _categories(result: Result) -> list[str]:
    return sentences(
        "parameters in another category",
        [
            f"{text(row, 'name')}: {text(row, 'a') or '-'} in A, {text(row, 'b') or '-'} in B"
            for row in records(result, "categories")
        ],
    )


def _precision(result: Result) -> list[str]:
    rows: list[Cells] = [
        (one_line(text(row, "name")), *(real(row, s, "std") for s in "ab"), real(row, "ratio"))
        for row in records(result, "precision", "rows")
    ]
    return numbers_first("standard deviations", ("std A", "std B", "B / A"), rows)


def _models(result: Result) -> list[str]:
    rows: list[Cells] = [
        (text(row, "name"), real(row, "a"), real(row, "b"), text(row, "unit") or "-")
        for row in records(result, "models", "rows")
    ]
    return table("values that differ", ("value", "A", "B", "unit"), rows)


_WRITERS: Mapping[str, Callable[[Result], list[str]]] = {
    "errors": _errors,
    "base_parameters": _estimates("base_parameters"),
    "parameters": _estimates("parameters"),
    "limits": _limits,
    "findings": _listed("findings", "effect"),
    "faults": _listed("faults", "fault"),
    "categories": _categories,
    "precision": _precision,
    "models": _models,
}
