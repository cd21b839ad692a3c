"""What a residual goes with: the quantity that shows an effect, state, load, and frequency."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from excitant.reports import values as v
from excitant.reports.figure import (
    CLOUD,
    FITTED,
    GIVEN,
    MEASURED,
    Axes,
    Axis,
    Figure,
    Key,
    Line,
    Mark,
    Panel,
    Points,
    Rule,
    Timeline,
    figure,
)
from excitant.reports.values import Series
from excitant.results import Finding, IdentifiedJoint, Identify
from excitant.robots.motion import Array, power_density

_CLOUD = 1000  # points drawn of a cloud
_MEDIANS = 24  # bins of a cloud, whose medians are drawn
_CURVE = 60  # points along a fitted effect
_WIDE = (
    0.08  # of the abscissa: across wider stretches without data no curve is drawn
)
_SHOWN = 2.0  # times the cut-off: frequencies up to there are drawn
_WINDOWS = 8  # at least, of which a spectrum is the mean
_DECADES = 4.0  # below the highest density, what is drawn of a spectrum
_MODELS = (
    ("given", GIVEN, "model as given"),
    ("identified", FITTED, "identified model"),
)
MEDIANS = Key("dot", MEASURED, "median in bins")


def cloud(x: Array, y: Array, name: str) -> list[Mark]:
    """A cloud of points, thinned, and their medians in bins where there are enough of them."""
    x, y = _along(x, y)
    rows = np.linspace(0, len(x) - 1, min(len(x), _CLOUD)).astype(int)
    marks: list[Mark] = [Points(x[rows], y[rows], CLOUD, name, 2.5, "cloud")]
    if len(x) >= 4 * _MEDIANS:
        centres, medians = _medians(x, y, _MEDIANS)
        marks.append(Points(centres, medians, MEASURED, "median", 4.0))
    return marks


def _along(x: Array, y: Array) -> tuple[Array, Array]:
    """Points that are known, in the order of x."""
    seen = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
    order = seen[np.argsort(x[seen], kind="stable")]
    return x[order], y[order]


def _medians(
    x: Array, y: Array, bins: int, fewest: int | None = None
) -> tuple[Array, Array]:
    """Median of y in equal bins of the sorted x, of few points in none; x and y when short."""
    if len(x) <= 2 * bins or x[-1] <= x[0]:
        return x, y
    lower, upper = np.quantile(x, [0.002, 0.998])
    if upper <= lower:
        lower = x[0]
        upper = x[-1]
    edges = np.searchsorted(x, np.linspace(lower, upper, bins + 1))
    least = max(3, len(x) // (40 * bins)) if fewest is None else fewest
    pairs = [
        (np.median(x[first:last]), np.median(y[first:last]))
        for first, last in pairwise(edges)
        if last - first >= least
    ]
    centres, medians = np.array(pairs, dtype=float).reshape(-1, 2).T
    return centres, medians


def evidence_figure(
    index: int, finding: Finding, series: Series, unit: str
) -> Figure | None:
    """Residual before an effect was added, over the quantity that shows it, and the fit."""
    keys = ("x", "residual", "fit")
    x, residual, fit = v.curves(
        series, None, *(f"finding{index}_{k}" for k in keys)
    )
    if x is None or residual is None or len(_along(x, residual)[0]) < 2:
        return None
    effect = v.plain(finding.effect)
    labels = finding.figure
    quantity = labels.x_label if labels else "quantity that shows it"
    joints = v.listing(finding.joints, "all joints")
    joint = (labels and labels.joint) or joints
    marks = cloud(x, residual, "residual before")
    legend = [Key("dot", CLOUD, "residual before")]
    legend += [MEDIANS] * (len(marks) > 1)
    caption = (
        f"What everything found leaves at {joint}, against {quantity}: medians that bend away "
        "from zero are what no candidate describes."
    )
    if fit is not None:
        marks.append(_curve(x, fit, effect))
        legend.append(Key("line", FITTED, "fitted effect"))
        through = "medians" if MEDIANS in legend else "points"
        caption = (
            f"Residual at {joint} without {effect} but with all other findings, against "
            f"{quantity}: the fitted effect (blue) should run through the {through}."
        )
    ordinate = Axis((labels and labels.y_label) or f"residual [{unit}]")
    axes = Axes(marks, Axis(quantity), ordinate, 210)
    label = f"{joint}: residual against {quantity}, with the fitted {effect}"
    return Figure((Panel((axes,), label, joint),), caption, legend)


def _curve(x: Array, y: Array, name: str) -> Line:
    along, height = _medians(*_along(x, y), _CURVE, 1)
    gaps = np.flatnonzero(np.diff(along, prepend=along[:1]) > _WIDE * np.ptp(along))
    along = np.insert(along, gaps, np.nan)
    return Line(along, np.insert(height, gaps, np.nan), FITTED, name, 1.8)


def residual_figure(result: Identify, series: Series) -> Figure | None:
    """Residual of the identified model over position, velocity, load and frequency, per joint."""
    cutoff = result.cutoff_hz
    rows = enumerate(result.joints)
    panels = [_residual(k, row, series, result.unit, cutoff) for k, row in rows]
    caption = (
        "What the identified model leaves while the joint moves on the hold-out. Medians that bend "
        "away from zero over position tell of springs or ripple, over velocity of friction, over "
        "load (the torque's magnitude, signed by direction) of gains or load-dependent friction. "
        "Last its spectrum, with those of the torque and of the given model's residual."
    )
    legend = [
        Key("dot", CLOUD, "residual"),
        MEDIANS,
        Key("line", MEASURED, "spectrum of the torque"),
        *(
            Key("line", colour, f"of the residual, {name}")
            for _, colour, name in _MODELS
        ),
    ]
    return figure(panels, caption, legend)


def _residual(
    k: int, row: IdentifiedJoint, series: Series, unit: str, cutoff: float | None
) -> Panel | None:
    t = v.times(series)
    keys = ("measured", "given", "identified", "position", "velocity")
    measured, given, model, q, dq = v.curves(series, k, *keys)
    if t is None or measured is None or model is None or q is None or dq is None:
        return None
    if len(measured) != len(t):
        return None
    speed = row.friction.velocity_unit if row.friction else ""
    abscissae = (
        ("position", q, speed.removesuffix("/s")),
        ("velocity", dq, speed),
        ("load", np.abs(model) * np.sign(dq), unit),
    )
    stack = []
    for name, x, si in abscissae:
        moving = np.where(np.isfinite(dq), x, np.nan)
        marks = [Rule(0.0), *cloud(moving, measured - model, "residual")]
        abscissa = Axis(f"{name} [{si}]" if si else name)
        stack.append(Axes(marks, abscissa, Axis(f"[{unit}]"), 130))
    lines = [(measured, MEASURED, "torque")]
    for other, (_, colour, name) in zip((given, model), _MODELS, strict=True):
        if other is not None:
            residual = np.where(np.isfinite(dq), measured - other, 0.0)
            lines.append((residual, colour, name))
    rate = 1.0 / float(np.median(np.diff(Timeline.of(t).t)))
    stack.append(_spectra(rate, lines, cutoff, unit))
    joint = row.name
    label = f"{joint}: residual over position, velocity and load, and its spectrum"
    return Panel(stack, label, joint, shared=False)


def _spectra(
    rate: float,
    signals: Sequence[tuple[Array, str, str]],
    cutoff: float | None,
    unit: str,
) -> Axes:
    """Amplitude densities of signals with their colours and names, up to twice the cut-off [Hz]."""
    top = min(rate / 2, _SHOWN * (cutoff or rate))
    highest = 0.0
    marks: list[Mark] = []
    for values, colour, name in signals:
        finite = values[np.isfinite(values)]
        window = max(8, len(finite) // _WINDOWS)
        f, power = power_density(finite, rate, window)
        within = (f > 0) & (f <= top)
        density = np.sqrt(power[within])
        highest = max(highest, float(density.max(initial=0.0)))
        marks.append(Line(f[within], density, colour, name, 1.0))
    if cutoff is not None and cutoff < top:
        marks.append(Rule(cutoff, MEASURED, "x", dashed=True))
    ordinate = Axis(f"[{unit}/√Hz]")
    if highest > 0:
        least = highest / 10**_DECADES
        ordinate = Axis(f"[{unit}/√Hz]", least, 2 * highest, log=True)
    abscissa = Axis("frequency [Hz], cut-off dashed", 0.0, top)
    return Axes(marks, abscissa, ordinate, 130)
