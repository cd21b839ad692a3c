"""Joints, parameters, limits and findings of two runs, matched by name."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from excitant.reports.reading import (
    Result,
    at,
    real,
    reals,
    records,
    text,
    words,
    worst_points,
)
from excitant.robots.parameters import STANDARD, UNITS

Row = dict[str, Any]
APART = 2.0  # standard deviations: 1 in 20 of equal values lies further apart by chance
_ROUNDING = 1e-9  # relative difference of equal values
_ERRORS = ("rms", "nrmse", "r2")


def compared_joints(a: Result, b: Result, models: Sequence[str]) -> list[Row]:
    """Errors of each joint in both runs.

    Args:
        a: One run's result.
        b: The other's.
        models: Which errors: keys of a joint's row, or of results that hold rows themselves.
    """
    found: dict[str, Row] = {}
    for side, result in (("a", a), ("b", b)):
        for model in models:
            rows = records(result, model, "joints")
            own = {text(row, "name"): row for row in rows}
            if not rows:
                own = {text(row, "name"): at(row, model) for row in records(result, "joints")}
            for name, errors in own.items():
                kept = {key: real(errors, key) for key in _ERRORS}
                found.setdefault(name, {"name": name}).setdefault(model, {})[side] = kept
    last = models[-1]
    for row in found.values():
        before, after = (real(row, last, side, "rms") for side in "ab")
        row["change"] = after / before - 1 if before and after is not None else None
    return list(found.values())


def compared_parameters(a: Result, b: Result, key: str, name: str) -> dict[str, Any]:
    """Estimates in both runs, and how many standard deviations they lie apart.

    The deviation is |b − a| / √(σ_a² + σ_b²), as for independent data. A value that follows its
    prior, or that has no standard deviation, is left undecided.

    Returns:
        ``rows`` in order of the deviation, and the names that ``only_a`` or ``only_b`` has.
    """
    first, second = ({text(row, name): row for row in records(r, key)} for r in (a, b))
    rows = [_pair(n, row, second[n]) for n, row in first.items() if n in second]
    rows.sort(key=lambda row: -(row["deviations"] or 0.0))
    return {
        "rows": rows,
        "judged": sum(row["deviations"] is not None for row in rows),
        "apart": sum(row["apart"] for row in rows),
        "only_a": [n for n in first if n not in second],
        "only_b": [n for n in second if n not in first],
    }


def _pair(name: str, a: Result, b: Result) -> Row:
    values = [real(row, "value") for row in (a, b)]
    stds = [real(row, "std") for row in (a, b)]
    known = None not in (*values, *stds) and not any(at(r, "prior_dominated") for r in (a, b))
    spread = math.hypot(*(std or 0.0 for std in stds))
    difference = None
    if values[0] is not None and values[1] is not None:
        difference = values[1] - values[0]
    deviations = abs(difference) / spread if known and difference is not None and spread else None
    return {
        "name": name,
        "unit": text(a, "unit"),
        "a": {"value": values[0], "std": stds[0]},
        "b": {"value": values[1], "std": stds[1]},
        "difference": difference,
        "deviations": deviations,
        "apart": deviations is not None and deviations > APART,
    }


def compared_limits(a: Result, b: Result) -> list[Row]:
    """The worst point of each limited quantity in both motions."""
    found: dict[str, Row] = {}
    for side, result in (("a", a), ("b", b)):
        for point in worst_points(result):
            row = found.setdefault(point.quantity, {"quantity": point.quantity})
            row[side] = {"ratio": point.ratio, "joint": point.joint, "t": point.t}
    return list(found.values())


def compared_findings(a: Result, b: Result, key: str, name: str) -> dict[str, Any]:
    """What both runs found, and what only one did.

    Two findings are one where the effect is the same and some joints are; where several could
    be paired, those that share most joints are.
    """
    first, second = records(a, key), records(b, key)
    alike = [
        (-_overlap(x, y), i, j)
        for i, x in enumerate(first)
        for j, y in enumerate(second)
        if text(x, name) == text(y, name) and _overlap(x, y) > 0
    ]
    twin: dict[int, int] = {}
    for _, i, j in sorted(alike):
        if i not in twin and j not in twin.values():
            twin[i] = j
    return {
        "common": [
            {"a": _finding(first[i], name), "b": _finding(second[j], name)}
            | _shared(first[i], second[j])
            for i, j in sorted(twin.items())
        ],
        "only_a": [_finding(x, name) for i, x in enumerate(first) if i not in twin],
        "only_b": [_finding(y, name) for j, y in enumerate(second) if j not in twin.values()],
    }


def _overlap(a: Result, b: Result) -> float:
    """Joints in common, as a share of all that either has; one where neither has any."""
    one, other = (set(words(finding, "joints")) for finding in (a, b))
    return len(one & other) / len(one | other) if one | other else 1.0


def _finding(finding: Result, name: str) -> Row:
    kept = {key: at(finding, key) for key in ("explained", "verdict", "detail") if key in finding}
    return {name: text(finding, name), "joints": words(finding, "joints")} | kept


def _shared(a: Result, b: Result) -> Row:
    return {"parameters": compared_parameters(a, b, "parameters", "name")["rows"]}


def compared_categories(a: Result, b: Result) -> list[Row]:
    """Standard parameters that the two analyses put into different categories."""
    first, second = (_categories(result) for result in (a, b))
    return [
        {"name": name, "a": first.get(name), "b": second.get(name)}
        for name in {**first, **second}
        if first.get(name) != second.get(name)
    ]


def _categories(result: Result) -> dict[str, str]:
    found: dict[str, str] = {}
    for link in records(result, "links"):
        combined = [name for row in records(link, "combined") for name in words(row, "members")]
        found |= dict.fromkeys(combined, "combined")
        for category in ("unique", "unidentifiable"):
            found |= dict.fromkeys(words(link, category), category)
    return found


def compared_precision(a: Result, b: Result) -> dict[str, Any]:
    """Standard deviation of each base parameter with both motions; ``ratio`` is b over a."""
    first, second = ({text(row, "name"): row for row in records(r, "practical")} for r in (a, b))
    rows: list[Row] = []
    for name, row in first.items():
        if name not in second:
            continue
        before, after = real(row, "std"), real(second[name], "std")
        rows.append(
            {
                "name": name,
                "a": {"std": before, "verdict": at(row, "verdict")},
                "b": {"std": after, "verdict": at(second[name], "verdict")},
                "ratio": after / before if before and after is not None else None,
            }
        )
    rows.sort(key=lambda row: -abs(math.log(real(row, "ratio") or 1.0)))
    return {
        "rows": rows,
        "only_a": [n for n in first if n not in second],
        "only_b": [n for n in second if n not in first],
    }


def compared_models(a: Result, b: Result) -> dict[str, Any]:
    """Numbers of two models that differ: joints' limits and loads, then parameters.

    Returns:
        ``rows`` of what differs, how many values were ``compared``, and the names that ``only_a``
        or ``only_b`` has.
    """
    first, second = ({**_joint_values(r), **_parameter_values(r)} for r in (a, b))
    common = [name for name in first if name in second]
    rows: list[Row] = [
        {"name": name, "unit": first[name][1], "a": first[name][0], "b": second[name][0]}
        for name in common
        if not _equal(first[name][0], second[name][0])
    ]
    return {
        "rows": rows,
        "compared": len(common),
        "only_a": [n for n in first if n not in second],
        "only_b": [n for n in second if n not in first],
    }


def _equal(a: float | None, b: float | None) -> bool:
    return a == b if a is None or b is None else math.isclose(a, b, rel_tol=_ROUNDING)


def _joint_values(result: Result) -> dict[str, tuple[float | None, str]]:
    """Limits and greatest torque of gravity of every joint, None where there is no limit."""
    found: dict[str, tuple[float | None, str]] = {}
    for joint in records(result, "joints"):
        way, force = ("m", "N") if text(joint, "kind") == "prismatic" else ("rad", "N·m")
        lower, upper = [*reals(joint, "position"), math.nan, math.nan][:2]
        values = {
            "lower limit": (lower, way),
            "upper limit": (upper, way),
            "velocity limit": (at(joint, "velocity"), f"{way}/s"),
            "acceleration limit": (at(joint, "acceleration"), f"{way}/s²"),
            "torque limit": (at(joint, "torque"), force),
            "greatest torque of gravity": (at(joint, "gravity_torque"), force),
        }
        for what, (value, unit) in values.items():
            found[f"{text(joint, 'name')}: {what}"] = (real(value), unit)
    return found


def _parameter_values(result: Result) -> dict[str, tuple[float | None, str]]:
    """Standard parameters of all links, and coefficients of effects."""
    phi, units = at(result, "parameters"), dict(zip(STANDARD, UNITS, strict=True))
    found = {
        name: (real(value), units.get(name.rpartition(".")[2], ""))
        for name, value in (phi if isinstance(phi, Mapping) else {}).items()
    }
    return found | {
        text(row, "name"): (real(row, "value"), text(row, "unit"))
        for row in records(result, "effect_values")
    }
