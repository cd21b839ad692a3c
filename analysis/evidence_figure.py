"""Figures of evidence: the error without a cause over the variable that characterises it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from excitant.analysis.explanation import Item
from excitant.analysis.residuals import explanatory
from excitant.identify.rows import states
from excitant.robots.effects import plain
from excitant.robots.motion import Array

if TYPE_CHECKING:
    from excitant.analysis.diagnosis import Diagnosis

_DRAWN_OVER = {"": "time", "constant": "time", "direction": "velocity"}


@dataclass(frozen=True, eq=False)
class Curve:
    """One figure of evidence."""

    joint: int  # index of the joint that is shown
    x_label: str
    x: Array  # at the rows of the hold-out, NaN where not to be shown, shape (n,)
    residual: Array  # residual there without the cause, shape (n,) [torque unit]
    fit: Array | None = None  # torque of the cause; None where there is none


def curve_of(diagnosis: Diagnosis, item: Item) -> Curve:
    """The figure of a group of findings, by its first, or of the largest unexplained residual."""
    moves = diagnosis.holdout.series.moves
    error = diagnosis.error
    if not item.findings:
        residual = item.residuals[0]
        j = diagnosis.robot.joint_index(residual.joint)
        domain = _DRAWN_OVER.get(residual.dominant, residual.dominant)
        label, x = _abscissa(diagnosis, domain, j)
        return Curve(j, label, np.where(moves[:, j], x, np.nan), error[:, j])
    lead = item.findings[0]
    effect = lead.effect
    j = lead.joint
    other = next((k for k in effect.rows(diagnosis.robot) if k != j), j)
    # all friction of a joint is one curve
    torque = np.sum([f.torque[:, j] for f in item.findings], axis=0)
    if effect.words.abscissa == "own torque":
        label = f"torque of the fitted {plain(effect.name)} [{diagnosis.unit(j)}]"
        x = torque
    else:
        label, x = _abscissa(diagnosis, effect.words.abscissa, j, other)
    if effect.words.drawn is not None:
        label, x = effect.words.drawn(effect, label, x)
    x = np.where(moves[:, j], x, np.nan)
    residual_torque = error[:, j] + torque
    return Curve(j, label, x, residual_torque, torque)


def _abscissa(
    diagnosis: Diagnosis, domain: str, j: int, other: int = 0
) -> tuple[str, Array]:
    robot = diagnosis.robot
    unit = diagnosis.unit(j)
    name = robot.joints[other]
    own_unit, other_unit = ("rad" if robot.revolute[k] else "m" for k in (j, other))
    segments = diagnosis.data.validate
    predicted = diagnosis.extension.predicted
    torque = predicted[:, j]
    t = diagnosis.holdout.series.t
    if domain == "reversal":
        label = (
            f"distance since the last reversal, signed by direction [{own_unit}]"
        )
        return label, explanatory(segments, predicted).reversal[:, j]
    q, dq, ddq = states(segments)
    return {
        "velocity": (f"joint velocity [{own_unit}/s]", dq[:, j]),
        "other velocity": (f"velocity of {name} [{other_unit}/s]", dq[:, other]),
        "acceleration": (f"joint acceleration [{own_unit}/s²]", ddq[:, j]),
        "other acceleration": (
            f"acceleration of {name} [{other_unit}/s²]",
            ddq[:, other],
        ),
        "position": (f"joint position [{own_unit}]", q[:, j]),
        "torque": (
            f"torque of the given model [{unit}]",
            diagnosis.holdout.nominal[:, j],
        ),
        "torque rate": (f"rate of torque [{unit}/s]", np.gradient(torque, t)),
        "load": (
            f"magnitude of the joint's torque, signed by direction [{unit}]",
            abs(torque) * np.sign(dq[:, j]),
        ),
        "time": ("time [s]", t),
    }[domain]
