"""Figures of the pages as Matplotlib axes, for notebooks and scripts: ``excitant.plot``.

Every function draws what the page of the same noun shows, into one new figure of pyplot with a
panel per joint or kind, and returns all its axes. Where only one is drawn, ``ax`` may be axes of
your own to draw it into. Joints are named; all of them are drawn where none is.

All raise UnknownName for a name that the arm does not have, and BadInput where nothing is to draw
or ``ax`` is one axes for several drawings.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from excitant.exceptions import BadInput, UnknownName
from excitant.reports import values as v
from excitant.reports.figure import Figure
from excitant.reports.figures.estimate import forest_figure, friction_figure
from excitant.reports.figures.motion import motion_figure
from excitant.reports.figures.residual import residual_figure
from excitant.reports.figures.torque import torque_figure
from excitant.reports.pyplot import draw, draw_onto
from excitant.reports.run import Reportable, as_saved
from excitant.reports.sections.identify import CURVES
from excitant.reports.values import Result, Series
from excitant.robots.motion import Array, Motion
from excitant.robots.robot import Robot

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from excitant.design import Design, Trajectory
    from excitant.identify import Estimate

__all__ = ["friction", "motion", "parameters", "residuals", "torque"]

Names = str | Sequence[str] | None
_Drawn = tuple[dict[str, Any], dict[str, Array]]
# entries with one item per joint
_BY_JOINT = ("joints", "revolute", "limit_values", "certified")
_SAMPLES = 1000  # of a period


def torque(estimate: Estimate, joints: Names = None) -> list[Axes]:
    """Measured and predicted torque over the hold-out, below it the residual: two axes a joint."""
    result, series = _of_joints(estimate, joints)
    names = v.joint_names(result)
    unit = v.text(result, "unit")
    return _drawn(torque_figure(names, series, unit, CURVES))


def friction(
    estimate: Estimate, joints: Names = None, *, ax: Axes | None = None
) -> list[Axes]:
    """Friction over velocity with its 95 % interval, and the readings of the hold-out."""
    result, series = _of_joints(estimate, joints)
    return _drawn(friction_figure(result, series), ax)


def residuals(estimate: Estimate, joints: Names = None) -> list[Axes]:
    """Residual over position, velocity and load, and its spectrum: four axes a joint."""
    result, series = _of_joints(estimate, joints)
    return _drawn(residual_figure(result, series, v.text(result, "unit")))


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
    return _drawn(forest_figure({"parameters": chosen}), ax)


def motion(
    motion: Design | Trajectory | Motion,
    robot: Robot | None = None,
    joints: Names = None,
) -> list[Axes]:
    """Position, velocity and acceleration of each joint, an axes each, against the robot's limits.

    A design knows its robot, and shows torque too.
    """
    if isinstance(motion, Reportable):
        result, series = _of_joints(motion, joints)
    else:
        samples = motion if isinstance(motion, Motion) else motion.sample(_SAMPLES)
        entries: dict[str, Any] = {
            "joints": [f"joint {j + 1}" for j in range(motion.nv)]
        }
        if robot is not None:
            from excitant.design import check

            entries = {"joints": robot.joints, "revolute": robot.revolute}
            entries |= check(robot, motion).entries(robot.limits)
        curves = {name: getattr(samples, name) for name in ("t", "q", "dq", "ddq")}
        result, series = _chosen(entries, curves, joints)
    return _drawn(motion_figure(v.joint_names(result), result, series))


def _of_joints(noun: Reportable, joints: Names) -> _Drawn:
    return _chosen(noun.result(), noun.series(), joints)


def _chosen(result: Result, series: Series, joints: Names) -> _Drawn:
    """Result and series of some joints, in the order in which they are named."""
    result = as_saved(result, {})[0]
    names = v.joint_names(result)
    wanted = (
        names
        if joints is None
        else [joints]
        if isinstance(joints, str)
        else list(joints)
    )
    UnknownName.refuse("joint", wanted, names)
    rows = [names.index(name) for name in wanted]
    nv = len(names)

    def of_joints(entry: Any) -> Any:
        if isinstance(entry, dict):
            return {key: of_joints(value) for key, value in entry.items()}
        per_joint = isinstance(entry, list) and len(entry) == nv
        return [entry[row] for row in rows] if per_joint else entry

    result |= {key: of_joints(result[key]) for key in _BY_JOINT if key in result}
    arrays = {
        key: x[:, rows] if np.shape(x)[1:] == (nv,) else x for key, x in series.items()
    }
    return result, arrays


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
