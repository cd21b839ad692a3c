"""What can be known of an arm's parameters, link by link, and how well one motion shows it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from excitant.exceptions import BadInput
from excitant.identify.estimate import Estimate
from excitant.identify.least_squares import weighted_least_squares
from excitant.identify.rows import observation
from excitant.robots.base_parameters import BaseParameters, base_parameters, categories
from excitant.robots.effects import Effect
from excitant.robots.motion import Array, Motion
from excitant.robots.robot import Robot
from excitant.robots.torque import effect_values, observation_columns

TORQUE_NOISE = 0.01  # of each joint's torque limit, where no recording tells the noise
_WELL, _ROUGHLY = 0.1, 0.3  # relative standard deviation


@dataclass(frozen=True)
class Practical:
    """How well a motion shows one base parameter.

    Attributes:
        expression: The base parameter.
        value: Its value.
        std: Standard deviation of its estimate.
        negligible: Whether its torque stays below the noise whatever value within two standard
            deviations it has.
    """

    expression: str
    value: float
    std: float
    negligible: bool

    @property
    def rel_std(self) -> float | None:
        """Standard deviation relative to the value; None when the value is zero."""
        return self.std / abs(self.value) if self.value else None

    @property
    def verdict(self) -> str:
        """``well`` (to 10 %), ``roughly`` (to 30 %), ``negligible`` or ``hardly`` determined."""
        if self.rel_std is not None and self.rel_std <= _ROUGHLY:
            return "well" if self.rel_std <= _WELL else "roughly"
        return "negligible" if self.negligible else "hardly"


@dataclass(frozen=True, eq=False)
class Identifiability:
    """Identifiability of an arm: structural, and practical where a motion is given.

    Attributes:
        robot: The arm.
        base: Base parameters of links and effects.
        category: ``unique``, ``combined`` or ``unidentifiable`` for each parameter of
            ``base.names``.
        condition_number: Of the unscaled base columns under the motion, cond₂(W).
        practical: Each base parameter under the motion.
        basis: Where the standard deviations come from, as a sentence.
    """

    robot: Robot
    base: BaseParameters
    category: tuple[str, ...]
    condition_number: float | None = None
    practical: tuple[Practical, ...] = ()
    basis: str = ""


def analyze(
    robot: Robot,
    *,
    effects: Sequence[Effect] = (),
    motion: Motion | None = None,
    estimate: Estimate | None = None,
) -> Identifiability:
    """Identifiability of an arm's parameters.

    Args:
        robot: The arm.
        effects: Effects whose coefficients are unknown too.
        motion: A motion to judge; standard deviations then assume torque noise of 1 % of each
            joint's limit, independent at every instant of the motion.
        estimate: Instead, what was identified from a recording: its noise and motion.

    Raises:
        RankDeficient: The motion leaves base parameters undetermined.
        BadInput: A motion is to be judged, but a joint has no torque limit to scale noise by.
    """
    if estimate is not None:
        fit = estimate.least_squares
        std = np.sqrt(np.diag(fit.covariance))
        W = observation(robot, estimate.model.effects, estimate.data.train)
        W = W[:, :, estimate.base.columns]
        practical = _practical(estimate.base, fit.beta, std, W, fit.sigma)
        basis = "from the residual of the recording, with its autocorrelation"
        return Identifiability(
            robot,
            estimate.base,
            categories(estimate.base),
            float(np.linalg.cond(W.reshape(-1, len(estimate.base)))),
            practical,
            basis,
        )
    base = base_parameters(robot, effects)
    structural = Identifiability(robot, base, categories(base))
    if motion is None:
        return structural
    return _under_motion(structural, effects, motion)


def _under_motion(
    structural: Identifiability, effects: Sequence[Effect], motion: Motion
) -> Identifiability:
    robot, base = structural.robot, structural.base
    sigma = TORQUE_NOISE * robot.limits.torque
    if not np.isfinite(sigma).all():
        joint = robot.joints[int(np.argmin(np.isfinite(sigma)))]
        raise BadInput(f"{robot.source}: joint {joint} has no torque limit; give one in --limits")
    W = observation_columns(robot, effects, motion)[:, :, base.columns]
    weighted_least_squares(W, np.ones(W.shape[:2]), base.expressions)  # refuses what is not shown
    rows = (W / sigma[:, None]).reshape(-1, len(base))
    std = np.sqrt(np.diag(np.linalg.inv(rows.T @ rows)))
    values = base.regrouping @ _values(robot, effects)
    return Identifiability(
        robot,
        base,
        structural.category,
        float(np.linalg.cond(W.reshape(-1, len(base)))),
        _practical(base, values, std, W, sigma),
        f"for torque noise of {100 * TORQUE_NOISE:g} % of each limit at {len(motion)} instants",
    )


def _values(robot: Robot, effects: Sequence[Effect]) -> Array:
    """Standard parameters and effect coefficients of the robot as given; zero if unknown."""
    known = effect_values(robot)
    added = [known.get(p.name, 0.0) for effect in effects for p in effect.parameters(robot)]
    return np.concatenate([robot.phi, added])


def _practical(
    base: BaseParameters, values: Array, std: Array, W: Array, sigma: Array
) -> tuple[Practical, ...]:
    """Verdicts from values, standard deviations, base columns (n, nv, r) and noise (nv,)."""
    per_unit = (np.sqrt((W**2).mean(axis=0)) / sigma[:, None]).max(axis=0)
    torque = (np.abs(values) + 2 * std) * per_unit
    return tuple(
        Practical(text, float(value), float(s), bool(t < 1))
        for text, value, s, t in zip(base.expressions, values, std, torque, strict=True)
    )


def analyze_result(identifiability: Identifiability) -> dict[str, Any]:
    """Machine-readable result of `analyze` (keys of DESIGN.md, section 5)."""
    base = identifiability.base
    return {
        "verb": "analyze",
        "robot": identifiability.robot.name,
        "standard_parameters": len(base.names),
        "base_parameters": len(base),
        "gap": list(base.gap),
        "links": [
            _link(identifiability, link, joint)
            for link, joint in zip(
                identifiability.robot.links, identifiability.robot.joints, strict=True
            )
        ],
        "condition_number": identifiability.condition_number,
        "practical": [
            {"name": p.expression, "value": p.value, "std": p.std, "rel_std": p.rel_std,
             "verdict": p.verdict}
            for p in identifiability.practical
        ],
        "basis": identifiability.basis,
    }  # fmt: skip


def _link(identifiability: Identifiability, link: str, joint: str) -> dict[str, Any]:
    base = identifiability.base
    own = [k for k, n in enumerate(base.names) if n.rpartition(".")[0] in (link, joint)]
    of = {
        category: [base.names[k] for k in own if identifiability.category[k] == category]
        for category in ("unique", "unidentifiable")
    }
    combined = []
    for row, text in zip(base.regrouping, base.expressions, strict=True):
        members = [base.names[k] for k in np.flatnonzero(np.abs(row) > 1e-7)]
        if len(members) > 1 and any(abs(row[k]) > 1e-7 for k in own):
            combined.append({"expression": text, "members": members})
    return {
        "link": link,
        "joint": joint,
        "unique": of["unique"],
        "combined": combined,
        "unidentifiable": of["unidentifiable"],
    }
