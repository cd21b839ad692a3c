"""Figures of the pages as Matplotlib axes, for notebooks and scripts: ``excitant.plot``.

Every function draws what the page of the same noun shows, into one new figure of pyplot with a
panel per joint or kind, and returns all its axes. Where only one is drawn, ``ax`` may be axes of
your own to draw it into. Joints are named; all of them are drawn where none is.

All raise UnknownName for a name that the arm does not have, and BadInput where nothing is to draw
or ``ax`` is one axes for several drawings.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from excitant.exceptions import BadInput, UnknownName
from excitant.reports.figure import Figure
from excitant.reports.figures.estimate import forest_figure, friction_figure
from excitant.reports.figures.motion import Limits, motion_figure
from excitant.reports.figures.residual import residual_figure
from excitant.reports.figures.torque import torque_figure
from excitant.reports.pyplot import draw, draw_onto
from excitant.reports.run import Reportable, as_saved
from excitant.reports.sections.identify import CURVES
from excitant.reports.values import Series
from excitant.results import Certified, Identify, Parameter
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
    record = msgspec.convert(result, Identify)
    names = [row.name for row in record.joints]
    return _drawn(torque_figure(names, series, record.unit, CURVES))


def friction(
    estimate: Estimate, joints: Names = None, *, ax: Axes | None = None
) -> list[Axes]:
    """Friction over velocity with its 95 % interval, and the readings of the hold-out."""
    result, series = _of_joints(estimate, joints)
    return _drawn(
        friction_figure(msgspec.convert(result, Identify).joints, series), ax
    )


def residuals(estimate: Estimate, joints: Names = None) -> list[Axes]:
    """Residual over position, velocity and load, and its spectrum: four axes a joint."""
    result, series = _of_joints(estimate, joints)
    return _drawn(residual_figure(msgspec.convert(result, Identify), series))


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
    limits = Limits(
        result.get("limit_values"),
        msgspec.convert(
            result.get("certified"), dict[str, list[Certified | None]] | None
        ),
        result.get("revolute", ()),
    )
    return _drawn(motion_figure(result["joints"], limits, series))


def _of_joints(noun: Reportable, joints: Names) -> _Drawn:
    return _chosen(noun.result(), noun.series(), joints)


def _chosen(result: Mapping[str, Any], series: Series, joints: Names) -> _Drawn:
    """Result and series of some joints, in the order in which they are named."""
    result = as_saved(result, {})[0]
    names = [
        row["name"] if isinstance(row, dict) else row for row in result["joints"]
    ]
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
        key: x[:, rows] if np.shape(x)[1:] == (nv,) else x
        for key, x in series.items()
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
