"""The part on the filter says what the numbers say, and survives results that lack some."""

from __future__ import annotations

import copy
from typing import Any

import pytest

from excitant.reports.cutoff_figure import cutoff_parts
from excitant.reports.model import Figure, Notes, Table

FACTORS = (0.5, 0.71, 1.0, 1.41, 2.0)


def result(errors: tuple[float, ...], moved: float) -> dict[str, Any]:
    """Two joints; the second one's error follows `errors`."""
    return {
        "cutoff_hz_per_joint": [
            {
                "name": name,
                "cutoff_hz": hz,
                "reason": why,
                "explained_up_to_hz": 4.2,
                "residual_densest_at_hz": 15.0,
            }
            for name, hz, why in (
                ("a", 10.0, "default"),
                ("b", 7.07, "spectrum: residual at 15 Hz"),
            )
        ],
        "dead_zone": {
            "left_out": True,
            "joints": [{"name": name, "slower_than": 1e-3, "share": 0.031} for name in "ab"],
        },
        "sensitivity": [
            {
                "factor": factor,
                "joints": [
                    {"name": "a", "rms": 2.0, "nrmse": 0.1},
                    {"name": "b", "rms": 3.0 * error, "nrmse": 0.1 * error},
                ],
                "largest_change": {
                    "standard_deviations": 0.0 if factor == 1 else moved * factor,
                    "expression": None if factor == 1 else "b.Fc",
                },
            }
            for factor, error in zip(FACTORS, errors, strict=True)
        ],
        "estimators": [
            {"name": "wls", "chosen": False, "nrmse": 0.1, "lower_by": 0.0, "lower_by_std": 0.0},
            {"name": "irls", "chosen": True, "nrmse": 0.09, "lower_by": 0.2, "lower_by_std": 0.05},
        ],
    }


def words(value: dict[str, Any]) -> str:
    parts = dict(cutoff_parts(value))
    notes = parts["Filter of the fit"][0]
    assert isinstance(notes, Notes)
    return " ".join(notes.sentences).replace("\u00a0", " ")


def test_a_flat_curve_is_called_one() -> None:
    said = words(result((1.01, 1.0, 1.0, 1.02, 1.06), 0.5))
    assert "does not hinge on the filter" in said
    assert "changes by 3.0 % at most, that of b by +6.0 % at 2 times" in said
    assert "b.Fc, moves by 1.0 standard deviations at 2 times the cut-off, within" in said


def test_a_steep_curve_is_called_one() -> None:
    said = words(result((0.9, 1.0, 1.0, 1.2, 1.5), 2.0))
    assert "The filter matters: at 2 times the cut-off" in said
    assert "changes by +25 %, that of b by +50 %" in said
    assert "moves by 4.0 standard deviations" in said
    assert "more than two says" in said


def test_tables_say_what_was_chosen() -> None:
    parts = dict(cutoff_parts(result((1.0,) * 5, 0.5)))
    figure, joints = parts["Filter of the fit"][1:]
    assert isinstance(figure, Figure)
    assert isinstance(joints, Table)
    assert [row[1].text.replace("\u00a0", " ") for row in joints.rows] == ["10.0 Hz", "7.07 Hz"]
    assert "is left out of the fit" in joints.caption
    [contest] = parts["Choice of the estimator"]
    assert isinstance(contest, Table)
    assert [row[1].text for row in contest.rows] == ["", "chosen"]
    assert contest.rows[1][3].text.replace("\u00a0", " ") == "−20.0 ± 5.0 %"


def _leaves(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    if isinstance(value, dict):
        return [leaf for k, v in value.items() for leaf in [(*path, k), *_leaves(v, (*path, k))]]
    if isinstance(value, list):
        return [leaf for k, v in enumerate(value) for leaf in [(*path, k), *_leaves(v, (*path, k))]]
    return []


@pytest.mark.parametrize("path", _leaves(result((1.0,) * 5, 0.5)), ids=str)
def test_any_value_may_be_null(path: tuple[Any, ...]) -> None:
    value = copy.deepcopy(result((1.0,) * 5, 0.5))
    inner: Any = value
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = None
    for _, blocks in cutoff_parts(value):
        assert all(block is None or block.kind for block in blocks)
