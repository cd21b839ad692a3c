"""Torque over time against what models predict, and how closely an arm follows with each."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from excitant.reports import values as v
from excitant.reports.figure import (
    BAND,
    FITTED,
    GIVEN,
    MEASURED,
    Axes,
    Axis,
    Band,
    Figure,
    Key,
    Line,
    Mark,
    Panel,
    Rule,
    Timeline,
    figure,
)
from excitant.reports.values import Series

INTERVAL = "95\u00a0% interval of a reading"
_INTERVAL_CAPTION = (
    " The band holds 95\u00a0% of readings if noise and parameters are all that "
    "is off."
)
GIVEN_MODEL = "model as given"


@dataclass(frozen=True)
class Curves:
    """Series drawn against the measurement: two models, the half width of intervals."""

    before: str
    after: str
    after_label: str
    caption: str
    band: str = ""


def over_holdout(unit: str) -> str:
    """Heading of the torque figure, which shows currents where torque is recorded as such."""
    return "Current on the hold-out" if unit == "A" else "Torque on the hold-out"


def torque_figure(
    joints: Sequence[str], series: Series, unit: str, curves: Curves
) -> Figure | None:
    """Measured torque against the model before and after, the residual below, per joint."""
    panels = [
        _torque_panel(k, joint, series, unit, curves)
        for k, joint in enumerate(joints)
    ]

    def drawn(key: str) -> bool:
        return any(v.curve(series, key, k) is not None for k in range(len(joints)))

    legend = [
        Key("line", MEASURED, "measured"),
        *[Key("line", GIVEN, GIVEN_MODEL)] * drawn(curves.before),
        *[Key("line", FITTED, curves.after_label)] * drawn(curves.after),
        *[Key("box", BAND, INTERVAL)] * drawn(curves.band),
    ]
    caption = curves.caption + _INTERVAL_CAPTION * drawn(curves.band)
    return figure(panels, caption, legend)


def _torque_panel(
    k: int, joint: str, series: Series, unit: str, curves: Curves
) -> Panel | None:
    t = v.times(series)
    measured = v.curve(series, "measured", k)
    if t is None or measured is None or len(measured) != len(t):
        return None
    timeline = Timeline.of(t)
    torque: list[Mark] = []
    residual: list[Mark] = [Rule(0.0)]
    remarks = []
    half, after = (
        v.curve(series, key, k, len(t)) for key in (curves.band, curves.after)
    )
    if half is not None and np.isfinite(half).all() and after is not None:
        for marks, centre in ((torque, after), (residual, np.zeros(len(t)))):
            low = timeline.broken(centre - half)
            high = timeline.broken(centre + half)
            marks.append(Band(timeline.t, low, high))
        remarks.append(f"{INTERVAL} ±{v.quantity(float(half.mean()), unit)}")
    curve = timeline.broken(measured)
    torque.append(Line(timeline.t, curve, MEASURED, "measured", 1.3))
    for key, label, colour in (
        (curves.before, GIVEN_MODEL, GIVEN),
        (curves.after, curves.after_label, FITTED),
    ):
        model = v.curve(series, key, k, len(t))
        if model is None:
            continue
        predicted = timeline.broken(model)
        torque.append(Line(timeline.t, predicted, colour, label, 0.9))
        residual.append(Line(timeline.t, curve - predicted, colour, label, 0.8))
        remarks.append(f"below it what the {label} leaves")
    name = "current" if unit == "A" else "torque"
    above = Axes(torque, timeline.axis(""), Axis(f"{name} [{unit}]"), 150)
    ordinate = Axis(f"residual [{unit}]")
    below = Axes(residual, timeline.axis(), ordinate, 120)
    label = f"{joint}: measured torque over time; {'; '.join(remarks)}"
    return Panel((above, below), label, joint)
