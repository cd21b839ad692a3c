"""How the fit was filtered, what depends on it, and which estimator predicted best."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from excitant.identify.estimators import ESTIMATORS
from excitant.reports.drawing import FITTED, LIGHT, axes, label_y, panel
from excitant.reports.model import GOOD, Block, Cell, Figure, Key, Notes, Panel, Table, table
from excitant.reports.reading import Result, at, items, real, records, text
from excitant.reports.wording import NONE, number, percent, quantity, shorten, value_and_std
from excitant.robots.motion import Array

_FLAT = 0.05  # relative change of an error that is called none
_UNCERTAIN = 2.0  # standard deviations: the line in the figure

Parts = list[tuple[str, list[Block | None]]]


def cutoff_parts(result: Result) -> Parts:
    """Parts on the filter and on the estimator; none where a result says nothing of them."""
    return [
        ("Filter of the fit", [_sentence(result), _figure(result), _joint_table(result)]),
        ("Choice of the estimator", [_contest(result)]),
    ]


def _curves(result: Result) -> tuple[Array, Array, Array] | None:
    """Factors (k,), errors relative to those at the cut-offs chosen (k, nv), changes (k,)."""
    rows = records(result, "sensitivity")
    factors = np.array([real(row, "factor") or np.nan for row in rows])
    errors = [[real(j, "rms") or np.nan for j in records(row, "joints")] for row in rows]
    chosen = np.flatnonzero(np.abs(factors - 1) < 1e-6)
    if len(rows) < 2 or len(chosen) != 1 or len({len(e) for e in errors}) != 1 or not errors[0]:
        return None
    rms = np.array(errors)
    changes = [real(row, "largest_change", "standard_deviations") for row in rows]
    moved = np.array([np.nan if change is None else change for change in changes])
    if not all(np.isfinite(values).all() for values in (factors, rms, moved)) or not rms.all():
        return None
    return factors, rms / rms[chosen[0]], moved


def _sentence(result: Result) -> Notes | None:
    found = _curves(result)
    if found is None:
        return None
    return Notes((_about_errors(result, *found[:2]), _about_parameters(result, found[0], found[2])))


def _about_errors(result: Result, factors: Array, errors: Array) -> str:
    middle = np.median(errors, axis=1) - 1
    k = int(np.argmax(np.abs(middle)))
    worst, joint = np.unravel_index(int(np.argmax(np.abs(errors - 1))), errors.shape)
    name = text(records(records(result, "sensitivity")[int(worst)], "joints")[int(joint)], "name")
    one = f"that of {name} by {_change(errors[worst, joint] - 1)} at {factors[worst]:.2g} times"
    if abs(middle[k]) <= _FLAT:
        return (
            f"On the whole the prediction does not hinge on the filter: between {factors[0]:.2g} "
            f"and {factors[-1]:.2g} times the cut-off the median error on the hold-out changes by "
            f"{percent(abs(middle[k]))} at most, {one}."
        )
    return (
        f"The filter matters: at {factors[k]:.2g} times the cut-off the median error on the "
        f"hold-out changes by {_change(middle[k])}, {one}."
    )


def _change(share: float) -> str:
    return f"{'+' if share > 0 else ''}{percent(share)}"


def _about_parameters(result: Result, factors: Array, moved: Array) -> str:
    worst = int(np.argmax(moved))
    change = at(records(result, "sensitivity")[worst], "largest_change")
    name = shorten(text(change, "expression"), 60)
    judged = (
        "; more than two says that the filter lets in, or takes away, more than the noise that its "
        "uncertainty counts with."
        if moved[worst] > _UNCERTAIN
        else ", within its uncertainty."
    )
    return (
        f"The base parameter that depends on it most, {name}, moves by {number(moved[worst], 2)} "
        f"standard deviations at {factors[worst]:.2g} times the cut-off{judged}"
    )


def _figure(result: Result) -> Figure | None:
    found = _curves(result)
    if found is None:
        return None
    factors, errors, moved = found
    caption = (
        "The fit repeated by weighted least squares with all cut-offs changed by a factor, judged "
        "at the same cut-off on the same hold-out: a flat curve on the left says that the choice "
        "does not matter, a bar on the right below the line that parameters stay within their "
        "uncertainty."
    )
    legend = (Key("line", FITTED, "median of the joints"), Key("line", LIGHT, "each joint"))
    return Figure((_error_panel(factors, errors), _change_panel(factors, moved)), caption, legend)


def _error_panel(factors: Array, errors: Array) -> Panel:
    (ax,) = axes(2.2)
    for curve in errors.T:
        ax.plot(factors, curve, color=LIGHT, lw=1)
    middle = np.median(errors, axis=1)
    ax.plot(factors, middle, "o-", color=FITTED, ms=4, lw=1.8)
    _factor_axis(ax, factors)
    label_y(ax, "error / chosen's [–]")
    said = ", ".join(f"{f:.2g}: {e:.3f}" for f, e in zip(factors, middle, strict=True))
    return panel(ax, f"hold-out error over cut-off factor, median: {said}", "error on the hold-out")


def _change_panel(factors: Array, moved: Array) -> Panel:
    (ax,) = axes(2.2)
    ax.bar(factors, moved, width=0.16 * factors, color=FITTED)
    ax.axhline(_UNCERTAIN, color=LIGHT, lw=1.4)
    _factor_axis(ax, factors)
    label_y(ax, "largest change [std]")
    ax.set_ylim(0, max(2.4, 1.1 * float(np.max(moved))))
    said = ", ".join(f"{f:.2g}: {m:.2g}" for f, m in zip(factors, moved, strict=True))
    return panel(
        ax, f"largest change of a base parameter in standard deviations: {said}", "base parameters"
    )


def _factor_axis(ax: Axes, factors: Array) -> None:
    ax.set_xscale("log", base=2)
    ax.xaxis.set_major_locator(FixedLocator(factors.tolist()))
    ax.xaxis.set_minor_locator(NullLocator())
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.2g}"))
    ax.set_xlim(factors[0] / 1.15, factors[-1] * 1.15)
    ax.set_xlabel("factor of the cut-offs")


def _joint_table(result: Result) -> Table | None:
    reasons = {text(row, "reason") for row in records(result, "cutoff_hz_per_joint")}
    alike = len(reasons) == 1
    zones = {text(row, "name"): row for row in records(result, "dead_zone", "joints")}
    chosen = items(result, "cutoff_hz_per_joint")
    rows: list[list[Cell | str]] = []
    still = any((real(zone, "share") or 0.0) > 0 for zone in zones.values())
    for row in records(result, "cutoff_hz_per_joint"):
        zone = zones.get(text(row, "name"))
        slow = [number(at(zone, "slower_than"), 2), percent(at(zone, "share"))] if still else []
        rows.append(
            [
                text(row, "name"),
                quantity(at(row, "cutoff_hz"), "Hz"),
                quantity(at(row, "explained_up_to_hz"), "Hz", 2),
                quantity(at(row, "residual_densest_at_hz"), "Hz", 2),
                *slow,
                *([] if alike else [text(row, "reason") or NONE]),
            ]
        )
    if not rows or len(rows) != len(chosen):
        return None
    why = f": {reasons.pop()}" if alike and any(reasons) else ""
    left = at(result, "dead_zone", "left_out") is True
    did = "is left out of the fit" if left else "stays in the fit"
    return table(
        "name:Joint | number:Cut-off | number:Explained up to | number:Residual densest at"
        + (" | number:Sign known above [rad/s] | number:Rows slower" if still else "")
        + ("" if alike else " | text:Why this cut-off"),
        rows,
        f"Chosen from the training data{why}. Explained up to: the highest frequency at which the "
        "model explains more of the torque than it leaves. Residual densest at: the frequency at "
        "which most of the residual lies."
        + (
            " A row during which the joint is slower than the speed from which the sign of its "
            f"velocity is known {did}."
            if still
            else ""
        ),
    )


def _contest(result: Result) -> Table | None:
    rows: list[list[Cell | str]] = []
    for row in records(result, "estimators"):
        fall, error = real(row, "lower_by"), real(row, "lower_by_std")
        compared = fall is not None and error is not None and error > 0
        rows.append(
            [
                ESTIMATORS.get(text(row, "name"), text(row, "name")),
                Cell("chosen", GOOD) if at(row, "chosen") is True else "",
                percent(at(row, "nrmse"), 3),
                _change_of(-(fall or 0.0), error) if compared else NONE,
            ]
        )
    if not rows:
        return None
    return table(
        "name:Estimator | text:Choice | number:Inner hold-out, nrmse | "
        "number:Mean square error, change",
        rows,
        "Errors on blocks of the training data left out in turn; the change of the mean square "
        "error against the first estimator, with its standard error from the same blocks. Another "
        "one is chosen only where it is better beyond chance.",
    )


def _change_of(share: float, std: float | None) -> str:
    """A change with its standard error, both to the decimals of the latter."""
    value, error = value_and_std(100 * share, None if std is None else 100 * std)
    return f"{value} ± {error}\u00a0%"
