"""What shows a cause: the error without it against the quantity that tells it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from excitant.analysis.confirmation import Finding
from excitant.analysis.residuals import Residual, explanatory
from excitant.robots.effects import plain, standard_effects
from excitant.robots.motion import Array
from excitant.robots.robot import Robot

if TYPE_CHECKING:
    from excitant.analysis.diagnosis import Diagnosis

_DRAWN_OVER = {"": "time", "constant": "time", "direction": "velocity"}


@dataclass(frozen=True, eq=False)
class Curve:
    """One figure of evidence.

    Attributes:
        joint: Index of the joint that is shown.
        x_label: What the abscissa is.
        x: Abscissa at the rows of the hold-out, NaN where not to be shown, shape (n,).
        residual: What is left there without the cause, shape (n,) [torque unit].
        fit: Torque of the cause, shape (n,) [torque unit]; None where there is none.
        rival: Torque of its closest rival, fitted to the residual shown; None without one.
    """

    joint: int
    x_label: str
    x: Array
    residual: Array
    fit: Array | None = None
    rival: Array | None = None

    def labels(self, robot: Robot, unit: str) -> dict[str, str]:
        """What its axes are, as result.json says it; unit of torque."""
        return {
            "x_label": self.x_label,
            "y_label": f"torque [{unit}]",
            "joint": robot.joints[self.joint],
        }


def curve_of(diagnosis: Diagnosis, item: Finding | Residual) -> Curve:
    """The figure that shows a finding, or what is left unexplained."""
    moves = diagnosis.held.moves
    if isinstance(item, Residual):
        j = diagnosis.robot.joint_index(item.joint)
        label, x = _abscissa(diagnosis, _DRAWN_OVER.get(item.dominant, item.dominant), j)
        return Curve(j, label, np.where(moves[:, j], x, np.nan), diagnosis.left[:, j])
    j, other = _shown(diagnosis, item)
    torque = item.torque[:, j]
    domain = item.effect.abscissa
    if domain == "own torque":
        label = f"torque of the fitted {plain(item.effect.name)} [{diagnosis.data.unit}]"
        x = torque
    else:
        label, x = _abscissa(diagnosis, domain, j, other)
    label, x = item.effect.drawn(label, x)
    x, residual = np.where(moves[:, j], x, np.nan), diagnosis.left[:, j] + torque
    return Curve(j, label, x, residual, torque, _rival(diagnosis, item, j, residual))


def _rival(diagnosis: Diagnosis, finding: Finding, j: int, residual: Array) -> Array | None:
    """Torque of the first rival, with the coefficients that fit the residual of a joint best.

    Only for friction against friction of one joint, with viscous friction and offset of that joint
    free too: where bodies are in play, they change along with a rival, and a curve of it alone
    would say nothing.
    """
    effects = [finding.effect, *(r.candidate.effect for r in finding.rivals[:1])]
    alike = all(e.jointwise and e.family == "friction" for e in effects)
    if len(effects) < 2 or not alike:
        return None
    model, segments = diagnosis.extension.model, diagnosis.data.validate
    usual = standard_effects((diagnosis.robot.joints[j],))
    beside = [e for e in usual if e.joint_property in ("viscous", "offset")]
    columns = np.concatenate(
        [
            np.concatenate([s.rows(partial(e.columns, model))[:, j] for s in segments])
            for e in (effects[1], *beside)
        ],
        axis=1,
    )
    rows = diagnosis.held.moves[:, j]
    sizes = np.sqrt((columns[rows] ** 2).sum(axis=0))
    live = columns[:, sizes > 0] / sizes[sizes > 0]
    if not live.shape[1]:
        return None
    fitted: Array = live @ np.linalg.lstsq(live[rows], residual[rows], rcond=1e-8)[0]
    return fitted


def _shown(diagnosis: Diagnosis, finding: Finding) -> tuple[int, int]:
    """The joint where a cause shows most against what is left, and the other of a pair."""
    joints = finding.effect.rows(diagnosis.robot)
    if finding.effect.jointwise:
        return joints[0], joints[0]
    size = np.sqrt((finding.torque**2).mean(axis=0)) / diagnosis.extended.rms
    shown = int(np.argmax(size))
    return shown, next((j for j in joints if j != shown), shown)


def _abscissa(diagnosis: Diagnosis, domain: str, j: int, other: int = 0) -> tuple[str, Array]:
    """Label and values of a quantity at the rows of the hold-out."""
    unit, name = diagnosis.data.unit, diagnosis.robot.joints[other]
    way_unit, far_unit = ("rad" if diagnosis.robot.revolute[k] else "m" for k in (j, other))
    t, torque = diagnosis.held.series.t, diagnosis.predicted[:, j]
    way = np.sign(diagnosis.velocity[:, j])
    if domain == "reversal":
        where = explanatory(diagnosis.data.validate, diagnosis.predicted)
        label = f"distance since the last reversal, signed by direction [{way_unit}]"
        return label, where.reversal[:, j]
    return {
        "velocity": (f"joint velocity [{way_unit}/s]", diagnosis.velocity[:, j]),
        "other velocity": (f"velocity of {name} [{far_unit}/s]", diagnosis.velocity[:, other]),
        "acceleration": (f"joint acceleration [{way_unit}/s²]", diagnosis.acceleration[:, j]),
        "other acceleration": (
            f"acceleration of {name} [{far_unit}/s²]",
            diagnosis.acceleration[:, other],
        ),
        "position": (f"joint position [{way_unit}]", diagnosis.position[:, j]),
        "torque": (f"torque of the given model [{unit}]", diagnosis.simulated[:, j]),
        "torque rate": (f"rate of torque [{unit}/s]", np.gradient(torque, t)),
        "load": (f"size of the joint's torque, signed by direction [{unit}]", abs(torque) * way),
        "time": ("time [s]", t),
    }[domain]
