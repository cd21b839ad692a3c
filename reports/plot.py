"""Figures of the pages as Matplotlib axes, for notebooks and scripts: ``excitant.plot``.

Every function draws what the page of the same noun shows, into one new figure of pyplot with a
panel per joint or kind, and returns all its axes. Where only one is drawn, ``ax`` may be axes of
your own to draw it into. Joints are named; all of them are drawn where none is.

All raise UnknownName for a name that the arm does not have, and BadInput where nothing is to draw
or ``ax`` is one axes for several drawings.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import msgspec

from excitant.exceptions import BadInput, UnknownName
from excitant.reports.figure import Figure
from excitant.reports.figures.estimate import forest_figure, friction_figure
from excitant.reports.figures.motion import Limits, motion_figure
from excitant.reports.figures.residual import residual_figure
from excitant.reports.figures.torque import torque_figure
from excitant.reports.nouns import Reportable
from excitant.reports.pyplot import draw, draw_onto
from excitant.reports.run import as_saved
from excitant.reports.sections.identify import CURVES
from excitant.results import Certified, Identify, Parameter
from excitant.robots.motion import Motion
from excitant.robots.robot import Robot

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from excitant.design import Design, Trajectory
    from excitant.identify import Estimate

__all__ = ["friction", "motion", "parameters", "residuals", "torque"]

Names = str | Sequence[str] | None
_SAMPLES = 1000  # of a period


def torque(estimate: Estimate, joints: Names = None) -> list[Axes]:
    """Measured and predicted torque over the hold-out, below it the residual: two axes a joint."""
    record = _record(estimate)
    names = [row.name for row in record.joints]
    figure = torque_figure(names, estimate.series(), record.unit, CURVES)
    return _of_joints(figure, names, joints)


def friction(
    estimate: Estimate, joints: Names = None, *, ax: Axes | None = None
) -> list[Axes]:
    """Friction over velocity with its 95 % interval, and the readings of the hold-out."""
    rows = _record(estimate).joints
    figure = friction_figure(rows, estimate.series())
    return _of_joints(figure, [row.name for row in rows], joints, ax)


def residuals(estimate: Estimate, joints: Names = None) -> list[Axes]:
    """Residual over position, velocity and load, and its spectrum: four axes a joint."""
    record = _record(estimate)
    figure = residual_figure(record, estimate.series())
    return _of_joints(figure, [row.name for row in record.joints], joints)


def parameters(
    estimate: Estimate, names: Names = None, *, ax: Axes | None = None
) -> list[Axes]:
    """Identified parameters with their 95 % intervals beside the given ones, by kind.

    Names are those of links, joints or parameters, or symbols such as ``m`` and ``Fc``.
    """
    rows = estimate.result()["parameters"]
    aliases = [{row["name"], *row["name"].rpartition(".")[::2]} for row in rows]
    wanted = {names} if isinstance(names, str) else set(names or ())
    UnknownName.refuse("parameter", sorted(wanted), sorted(set().union(*aliases)))
    chosen = [
        row
        for row, names in zip(rows, aliases, strict=True)
        if not wanted or names & wanted
    ]
    return _drawn(forest_figure(msgspec.convert(chosen, list[Parameter])), ax)


def motion(
    motion: Design | Trajectory | Motion,
    robot: Robot | None = None,
    joints: Names = None,
) -> list[Axes]:
    """Position, velocity and acceleration of each joint, an axes each, against the robot's limits.

    A design knows its robot, and shows torque too.
    """
    if isinstance(motion, Reportable):
        entries = dict(motion.result())
        series = motion.series()
    else:
        samples = motion if isinstance(motion, Motion) else motion.sample(_SAMPLES)
        series = vars(samples)
        entries = {"joints": [f"joint {j + 1}" for j in range(motion.nv)]}
        if robot is not None:
            from excitant.design import check

            entries = {"joints": robot.joints, "revolute": robot.revolute}
            entries |= check(robot, motion).entries(robot.limits)
    result = as_saved(entries, {})[0]
    limits = Limits(
        result.get("limit_values"),
        msgspec.convert(
            result.get("certified"), dict[str, list[Certified | None]] | None
        ),
        result.get("revolute", ()),
    )
    names = result["joints"]
    return _of_joints(motion_figure(names, limits, series), names, joints)


def _record(estimate: Estimate) -> Identify:
    return msgspec.convert(as_saved(estimate.result(), {})[0], Identify)


def _of_joints(
    figure: Figure | None,
    names: Sequence[str],
    joints: Names,
    ax: Axes | None = None,
) -> list[Axes]:
    """The panels of some joints, in the order in which they are named."""
    wanted = [joints] if isinstance(joints, str) else joints or names
    UnknownName.refuse("joint", wanted, names)
    if figure is not None:
        panels = {panel.title: panel for panel in figure.panels}
        chosen = [panels[name] for name in wanted if name in panels]
        figure = replace(figure, panels=chosen) if chosen else None
    return _drawn(figure, ax)


def _drawn(figure: Figure | None, ax: Axes | None = None) -> list[Axes]:
    if figure is None:
        raise BadInput("there is nothing to draw: the result holds none of it")
    if ax is None:
        return draw(figure)
    if len(figure.panels) > 1:
        why = "name one joint or kind of parameters, or leave ax out"
        raise BadInput(
            f"ax holds one drawing, but these are {len(figure.panels)}; {why}"
        )
    draw_onto(ax, figure)
    return [ax]
