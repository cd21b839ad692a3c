"""Differentiators side by side: what they pass, what noise they let in, which one served."""

from __future__ import annotations

import numpy as np

from excitant.reports.drawing import (
    AMBER,
    FITTED,
    GIVEN,
    GREEN,
    LIGHT,
    MEASURED,
    PURPLE,
    SKY,
    axes,
    label_y,
    log_x,
    log_y,
    panel,
)
from excitant.reports.model import GOOD, Block, Cell, Figure, Key, Notes, Panel, Table, table
from excitant.reports.reading import Result, Series, at, curve, real, records, text
from excitant.reports.wording import number, quantity, sentence
from excitant.robots.motion import Array

_COLOURS = {
    "five-point": GIVEN,
    "Savitzky-Golay": GREEN,
    "Butterworth, spline": FITTED,
    "Butterworth, central": SKY,
    "Fourier series": PURPLE,
    "Savitzky-Golay, causal": AMBER,
}
_ALIKE = {"five-point, causal": "five-point"}  # the same gain, only later

Parts = list[tuple[str, list[Block | None]]]


def differentiator_parts(result: Result, series: Series) -> Parts:
    """The part on differentiators; none where a result says nothing of them."""
    found = at(result, "differentiators")
    if found is None:
        return []
    why = text(found, "why")
    served = sentence(f"Served on line: {why}") if why else ""
    return [
        (
            "Differentiators",
            [
                Notes((served,)) if served else None,
                _figure(found, series),
                _table(found),
            ],
        )
    ]


def _figure(found: Result, series: Series) -> Figure | None:
    f, rows = curve(series, "differentiator_f"), records(found, "contestants")
    panels: list[Panel | None] = []
    if f is not None and len(f) > 1:
        for order in ("velocity", "acceleration"):
            gains = np.asarray(series.get(f"differentiator_gain_{order}", np.empty(0)), float)
            if gains.shape == (len(f), len(rows)):
                panels.append(_gain_panel(f, gains, rows, order))
    panels.append(_spectrum_panel(found, series))
    present = tuple(each for each in panels if each is not None)
    if not present:
        return None
    drawn = [text(row, "label") for row in rows if text(row, "label") in _COLOURS]
    legend = [
        Key(
            "line", _COLOURS[label], label + (" (causal: the same gain)" if label in shared else "")
        )
        for shared in [set(_ALIKE.values())]
        for label in drawn
    ]
    caption = (
        "Gain of each differentiator relative to the true derivative over frequency, 1 is ideal "
        "(the one that served is thick): a good one stays at 1 where the positions have signal, "
        "which the last drawing shows, and falls where they have only noise."
    )
    return Figure(present, caption, tuple(legend))


def _gain_panel(f: Array, gains: Array, rows: list[Result], order: str) -> Panel:
    (ax,) = axes(2.4)
    for row, gain in zip(rows, gains.T, strict=True):
        label = text(row, "label")
        chosen = at(row, "chosen") is True
        colour = _COLOURS.get(_ALIKE.get(label, label))
        if colour is None or (label in _ALIKE and not chosen):
            continue
        ax.plot(f, gain, color=colour, lw=2.4 if chosen else 1.1, zorder=3 if chosen else 2)
    ax.set_xlim(f[0], f[-1])
    log_x(ax)
    ax.set_ylim(-0.25, 1.15)
    ax.set_xlabel("frequency [Hz]")
    label_y(ax, f"gain of the {order} [–]")
    half = ", ".join(
        f"{text(row, 'label')} {_half(f, gain)}" for row, gain in zip(rows, gains.T, strict=True)
    )
    return panel(ax, f"gain of the {order} over frequency, one half at: {half}", order)


def _half(f: Array, gain: Array) -> str:
    """Where a gain first falls below one half."""
    below = np.flatnonzero(gain < 0.5)
    return quantity(f[below[0]], "Hz") if len(below) else "no frequency"


def _spectrum_panel(found: Result, series: Series) -> Panel | None:
    f, power = curve(series, "position_f"), curve(series, "position_signal")
    rate, noise = real(found, "rate_hz"), real(found, "position_noise")
    if f is None or power is None or len(f) != len(power) or not (power > 0).any():
        return None
    seen = power > 0
    (ax,) = axes(2.4)
    ax.plot(f[seen], np.sqrt(power[seen]), "o-", ms=2, lw=0.9, color=MEASURED)
    joint = number(at(found, "joint"), 1)
    said = f"signal up to {quantity(f[seen][-1], 'Hz')}"
    if rate and noise:
        floor = noise * np.sqrt(2 / rate)
        ax.axhline(floor, color=LIGHT, lw=1.6)
        ax.annotate(
            f"noise, std {quantity(noise, 'rad')}", (0, floor), (3, 3),
            xycoords=("axes fraction", "data"), textcoords="offset points", ha="left", fontsize=8,
        )  # fmt: skip
        said += f", noise of standard deviation {quantity(noise, 'rad')}"
    ax.set_xlim(f[0], f[-1])
    log_x(ax)
    log_y(ax)
    ax.set_xlabel("frequency [Hz]")
    label_y(ax, "position [rad/√Hz]")
    return panel(ax, f"positions of joint {joint}: {said}", f"recorded positions of joint {joint}")


def _table(found: Result) -> Table | None:
    rows: list[list[Cell | str]] = []
    for row in records(found, "contestants"):
        chosen, delay = at(row, "chosen") is True, real(row, "delay_s")
        rows.append(
            [
                text(row, "name"),
                Cell("served", GOOD) if chosen else "",
                number(None if delay is None else 1e3 * delay),
                number(at(row, "noise_gain_velocity")),
                number(at(row, "noise_gain_acceleration")),
                number(at(row, "signal_lost")),
                number(at(row, "noise")),
                number(at(row, "error")),
            ]
        )
    if not rows:
        return None
    joint = number(at(found, "joint"), 1)
    return table(
        "text:Differentiator | text:Use | number:Delay [ms] | number:Noise gain, velocity [1/s] | "
        "number:Noise gain, acceleration [1/s²] | number:Signal lost [rad/s²] | "
        "number:Noise let in [rad/s²] | number:Acceleration error [rad/s²]",
        rows,
        f"Predicted error of the acceleration of joint {joint}, before anything is differentiated; "
        "each kind with the settings that suit this recording best. A loop can use the causal "
        "ones only; a Fourier series needs a motion that is periodic over the recording.",
    )
