"""Two runs of one command side by side: what differs between them, as a result of its own."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any

import numpy as np

from excitant.exceptions import BadInput
from excitant.reports.comparison_measures import MEASURES, Measure
from excitant.reports.comparison_rows import (
    compared_categories,
    compared_findings,
    compared_joints,
    compared_limits,
    compared_models,
    compared_parameters,
    compared_precision,
)
from excitant.reports.reading import (
    Result,
    Series,
    curve,
    items,
    joint_names,
    part,
    real,
    text,
    times,
)
from excitant.robots.motion import Array

VERB = "compare"
_DEMO = ("design", "identify", "analyze", "diagnose")
_DRAWN: Mapping[str, tuple[str, ...]] = {
    "design": ("t", "q", "dq", "eigenvalues_final"),
    "check": ("t", "q", "dq", "eigenvalues_final"),
    "identify": ("t", "measured", "given", "identified"),
    "analyze": ("singular_values",),
    "diagnose": ("t", "measured", "simulated", "extended"),
    "robots": (),
}


@dataclass(frozen=True)
class SavedRun:
    """A run as it was saved.

    Attributes:
        folder: Where.
        result: Content of its ``result.json``.
        series: Content of its ``series.npz``.
    """

    folder: str
    result: Result
    series: Series


def compare(a: SavedRun, b: SavedRun) -> tuple[dict[str, Any], dict[str, Array]]:
    """What two runs of one command have in common and where they differ.

    Returns:
        A result of its own (``verb`` is ``compare``), differences counted as ``b`` minus ``a``,
        and the series of both runs that its figures draw.

    Raises:
        BadInput: The runs are of different commands, or of one that has no comparison.
    """
    verb = text(a.result, "verb")
    _refuse_unlike(a, b)
    head = {
        "verb": VERB,
        "of": verb,
        "robot": _robot(a, b),
        "runs": [_about(a, b), _about(b, a)],
    }
    if verb != "demo":
        return head | _compared(verb, a, b), _series(verb, a.series, b.series)
    series: dict[str, Array] = {}
    sections = {}
    for name in _DEMO:
        pair = [_section_of(run, name) for run in (a, b)]
        if all(run.result for run in pair):
            sections[name] = _compared(name, *pair)
            found = _series(name, pair[0].series, pair[1].series)
            series |= {f"{name}/{key}": values for key, values in found.items()}
    return head | {"remarks": [], "sections": sections}, series


def _refuse_unlike(a: SavedRun, b: SavedRun) -> None:
    verb, other = (text(run.result, "verb") for run in (a, b))
    if verb != other:
        raise BadInput(
            f"{b.folder}: a run of '{other}', but {a.folder} is one of '{verb}'; "
            "compare two runs of one command"
        )
    if verb not in (*MEASURES, "demo"):
        known = ", ".join((*MEASURES, "demo"))
        raise BadInput(f"{a.folder}: runs of '{verb}' cannot be compared, only those of {known}")


def _section_of(run: SavedRun, name: str) -> SavedRun:
    found = run.result.get(name)
    result = found if isinstance(found, Mapping) else {}
    return SavedRun(run.folder, result, part(run.series, name))


def _robot(a: SavedRun, b: SavedRun) -> str:
    names = [text(run.result, "robot") for run in (a, b)]
    return names[0] if names[0] == names[1] else " and ".join(filter(None, names))


def _about(run: SavedRun, other: SavedRun) -> dict[str, str]:
    name, twin = (PurePath(each.folder).name for each in (run, other))
    return {"name": run.folder if name == twin else name, "folder": run.folder}


def _compared(verb: str, a: SavedRun, b: SavedRun) -> dict[str, Any]:
    same = same_rows(verb, _series(verb, a.series, b.series))
    remarks = _remarks(a, b, same)
    return {
        "unit": text(a.result, "unit") or "N·m",
        "joints": _joints(a, b),
        "revolute": items(a.result, "revolute"),
        "same_rows": same,
        "remarks": remarks,
        "key_figures": [_key_figure(measure, a, b, not remarks) for measure in MEASURES[verb]],
        **{key: build(a.result, b.result) for key, build in _ROWS[verb].items()},
    }


_ROWS: Mapping[str, Mapping[str, Callable[[Result, Result], Any]]] = {
    "design": {"limits": compared_limits},
    "check": {"limits": compared_limits},
    "identify": {
        "errors": lambda a, b: compared_joints(a, b, ("baseline", "train", "validate")),
        "base_parameters": lambda a, b: compared_parameters(a, b, "base_parameters", "expression"),
        "parameters": lambda a, b: compared_parameters(a, b, "parameters", "name"),
    },
    "analyze": {"categories": compared_categories, "precision": compared_precision},
    "diagnose": {
        "errors": lambda a, b: compared_joints(a, b, ("simulation", "extended")),
        "findings": lambda a, b: compared_findings(a, b, "findings", "effect"),
        "faults": lambda a, b: compared_findings(a, b, "faults", "fault"),
    },
    "robots": {"models": compared_models},
}


def _joints(a: SavedRun, b: SavedRun) -> list[str]:
    """Joints that both runs have at the same place, as the columns of series need."""
    found = [joint_names(run.result, "simulation.joints", "extended.joints") for run in (a, b)]
    return found[0] if found[0] == found[1] else []


def _key_figure(measure: Measure, a: SavedRun, b: SavedRun, comparable: bool) -> dict[str, Any]:
    values = [measure.read(run.result) for run in (a, b)]
    first, second = (real(value) for value in values)
    difference = None if first is None or second is None else second - first
    return {
        "figure": measure.label,
        "unit": text(a.result, "unit") or "N·m" if measure.unit == "torque" else measure.unit,
        "a": values[0],
        "b": values[1],
        "difference": difference,
        "better": _better(measure, first, second) if comparable else None,
    }


def _better(measure: Measure, a: float | None, b: float | None) -> str | None:
    """Which run is better by more than a hundredth."""
    if a is None or b is None or not measure.good or abs(b - a) <= 0.01 * max(abs(a), abs(b)):
        return None
    return "b" if (b < a) == (measure.good == "low") else "a"


def _remarks(a: SavedRun, b: SavedRun, same: bool | None) -> list[str]:
    """What keeps the two runs' figures from being compared one to one."""
    found = []
    for key, sentence in (
        ("robot", "The runs are of different arms, {} and {}."),
        ("cutoff_hz", "Errors are after different filters, {} and {} Hz: they do not compare."),
        ("unit", "Torques are in different units, {} and {}: errors do not compare."),
        ("columns", "The designs count different columns, {} and {}: their conditions differ."),
    ):
        values = [text(run.result, key) for run in (a, b)]
        if all(values) and values[0] != values[1]:
            found.append(sentence.format(*values))
    if same is False:
        found.append(
            "The runs were judged on different rows: a difference of errors may be one of the rows."
        )
    return found


def same_rows(verb: str, series: Series) -> bool | None:
    """Whether both runs were judged on the same instants and readings; None where unknown."""
    if "measured" not in _DRAWN[verb]:
        return None
    pairs = [[np.asarray(series[k]) for s in "ab" if (k := f"{s}/{key}") in series]
             for key in ("t", "measured")]  # fmt: skip
    if any(len(pair) != 2 for pair in pairs):
        return None
    return all(
        x.shape == y.shape and np.allclose(x, y, rtol=1e-5, atol=1e-9, equal_nan=True)
        for x, y in pairs
    )


def _series(verb: str, a: Series, b: Series) -> dict[str, Array]:
    keys: Sequence[str] = _DRAWN[verb]
    return {
        f"{side}/{key}": np.asarray(series[key])
        for side, series in (("a", a), ("b", b))
        for key in keys
        if key in series
    }


def drawn(series: Series, side: str, key: str, joint: int) -> tuple[Array, Array] | None:
    """Time and one joint's column of a run's series, or None where either is missing."""
    own = part(series, side)
    t, values = times(own), curve(own, key, joint)
    return None if t is None or values is None or len(t) != len(values) else (t, values)
