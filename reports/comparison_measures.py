"""The key figures by which two runs of a command are compared."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from excitant.reports.reading import Result, at, middle, real, records, text, words, worst_points
from excitant.reports.wording import listing, plain


@dataclass(frozen=True)
class Measure:
    """One key figure of a run.

    Attributes:
        label: What it is.
        read: Its value in a result: a number, a text, or None.
        unit: Unit, ``torque`` for that of the run's torques; empty for counts and texts.
        good: ``low`` or ``high`` where one is better, else empty.
    """

    label: str
    read: Callable[[Result], float | str | None]
    unit: str = ""
    good: str = ""


def _number(*keys: str) -> Callable[[Result], float | None]:
    return lambda result: real(result, *keys)


def _word(*keys: str) -> Callable[[Result], str | None]:
    return lambda result: plain(text(result, *keys)) or None


def _count(key: str) -> Callable[[Result], float | None]:
    return lambda result: None if at(result, key) is None else float(len(records(result, key)))


def _median(key: str, *, rows: tuple[str, ...] = ("joints",), scale: float = 1.0,
            of: str = "") -> Callable[[Result], float | None]:  # fmt: skip
    keys = (of, key) if of else (key,)

    def read(result: Result) -> float | None:
        found = middle(records(result, *rows), *keys)
        return None if found is None else scale * found

    return read


def _sum_of_errors(result: Result) -> float | None:
    errors = [x for row in records(result, "joints") if (x := real(row, "validate", "rms"))]
    return sum(errors) if errors else None


def _effects(result: Result) -> str | None:
    return listing([plain(effect) for effect in words(result, "effects")], "") or None


def _yes(*keys: str) -> Callable[[Result], str | None]:
    return lambda result: {True: "yes", False: "no"}.get(at(result, *keys))


def _worst_limit(result: Result) -> float | None:
    ratios = [point.ratio for point in worst_points(result) if point.ratio is not None]
    return 100 * max(ratios) if ratios else None


def _named(result: Result) -> float | None:
    rows = records(result, "findings")
    return float(sum(text(row, "verdict") == "named" for row in rows)) if rows else None


def _alone(key: str) -> Callable[[Result], float | None]:
    def read(result: Result) -> float | None:
        links = records(result, "links")
        return float(sum(len(words(link, key)) for link in links)) if links else None

    return read


_MOTION = (
    Measure("Limits used up to", _worst_limit, "%"),
    Measure("Clearance", _number("clearance_m"), "m", "high"),
)

MEASURES: Mapping[str, tuple[Measure, ...]] = {
    "design": (
        Measure("Condition number", _number("condition_number", "final"), "", "low"),
        Measure("Condition number at the start", _number("condition_number", "initial")),
        Measure("Lower bound of any motion", _number("condition_number", "lower_bound")),
        Measure("Scaled condition number", _number("condition_number_scaled", "final"), "", "low"),
        Measure("Duration", _number("duration"), "s"),
        Measure("Harmonics", _number("harmonics")),
        Measure("Base parameters", _number("base_parameters")),
        Measure("Columns", _word("columns")),
        Measure("Criterion", _word("criterion")),
        *_MOTION,
        Measure("Starts", _count("starts")),
    ),
    "check": (
        Measure("Trajectory", lambda result: text(result, "trajectory") or None),
        Measure("Limits hold", _yes("holds")),
        Measure("Condition number", _number("condition_number"), "", "low"),
        Measure("Duration", _number("duration"), "s"),
        Measure("Columns", _word("columns")),
        *_MOTION,
    ),
    "identify": (
        Measure("Summed error on the hold-out", _sum_of_errors, "torque", "low"),
        Measure("Median nrmse on the hold-out",
                _median("nrmse", of="validate", scale=100), "%", "low"),
        Measure("Median r² on the hold-out", _median("r2", of="validate")),
        Measure("Median nrmse of the model as given",
                _median("nrmse", of="baseline", scale=100), "%"),
        Measure("Cut-off", _number("cutoff_hz"), "Hz"),
        Measure("Base parameters", _count("base_parameters")),
        Measure("Physically consistent", _yes("physical", "consistent")),
        Measure("Estimator", _word("estimator")),
        Measure("Effects", _effects),
        Measure("Hold-out", lambda result: text(result, "holdout") or None),
    ),
    "analyze": (
        Measure("Standard parameters", _number("standard_parameters")),
        Measure("Base parameters", _number("base_parameters")),
        Measure("Identifiable one by one", _alone("unique"), "", "high"),
        Measure("Not identifiable", _alone("unidentifiable"), "", "low"),
        Measure("Condition number", _number("condition_number"), "", "low"),
        Measure("Not shown by the motion", _count("not_shown"), "", "low"),
    ),
    "diagnose": (
        Measure("Median nrmse of the model as given",
                _median("nrmse", rows=("simulation", "joints"), scale=100), "%"),
        Measure("Median nrmse with the findings",
                _median("nrmse", rows=("extended", "joints"), scale=100), "%", "low"),
        Measure("Findings", _count("findings")),
        Measure("Findings named", _named),
        Measure("Data faults", _count("faults")),
        Measure("Cut-off", _number("cutoff_hz"), "Hz"),
        Measure("Headline", lambda result: text(result, "headline") or None),
    ),
    "robots": (
        Measure("Joints", _count("joints")),
        Measure("Moving mass", _number("mass"), "kg"),
        Measure("Mass with the base", _number("total_mass"), "kg"),
        Measure("Base parameters", _number("base_parameters")),
        Measure("Effects", _effects),
        Measure("Warnings and hints", _count("warnings")),
    ),
}  # fmt: skip
