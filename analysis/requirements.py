"""What a rehearsal requires, each with its figures, and what to change where it is not met."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from excitant.analysis.confirmation import Finding
from excitant.analysis.diagnosis import Diagnosis
from excitant.analysis.evidence import Candidate
from excitant.exceptions import RankDeficient
from excitant.identify import Estimate
from excitant.robots.effects import EFFECTS, plain, standard_effects
from excitant.robots.motion import Array, Motion
from excitant.robots.plant.nominal import typical_motion
from excitant.robots.plant.sensors import Run
from excitant.robots.robot import Robot
from excitant.robots.torque import observation_columns
from excitant.robots.virtual_arm import HiddenEffect, VirtualArm

_OVER = 0.05  # of a limit: an arm that tracks a motion overshoots it a little
_KNOWN = 0.1  # of a friction coefficient: to which it must be known
_COVERED = 0.9  # of base parameters within their 95 % intervals
_WORSE = 1.1  # error of the model over that of the truth behind the same sensors
_ELSEWHERE = 0.05  # of typical torque: error at motions within half the limits
_FEEBLE = 0.3  # of its speed limit: a joint that should move more
_HOPELESS = 5.0  # uncertainty beyond which a longer record alone will not do
_UNLIMITED = 3.0  # rad/s, where there is no limit on speed


@dataclass(frozen=True)
class Item:
    """One requirement.

    Attributes:
        name: What is required.
        joint: The joint concerned; empty when none.
        passed: Whether it is met.
        detail: The figures, in words.
        advice: What to change; empty when met.
        planted: True value; None where the item is not about one value.
        recovered: Its estimate.
        std: Standard deviation of the estimate.
        unit: Unit of the three.
    """

    name: str
    joint: str
    passed: bool
    detail: str
    advice: str = ""
    planted: float | None = None
    recovered: float | None = None
    std: float | None = None
    unit: str = ""


@dataclass(frozen=True, eq=False)
class Situation:
    """What all items look at: the robot as given, the arm, and its run of the motion."""

    robot: Robot
    arm: VirtualArm
    run: Run

    @property
    def use(self) -> Array:
        """Highest speed of each joint relative to its limit, 3 rad/s where there is none."""
        limit = self.robot.limits.velocity
        top = np.where(np.isfinite(limit), limit, _UNLIMITED)
        return np.asarray(np.abs(self.run.dq).max(axis=0) / top, dtype=np.float64)

    def faster(self, joint: str | None = None, lack: float = 0.0) -> str:
        """Advice: more amplitude on joints that hardly move, else a longer motion.

        Args:
            joint: The joint concerned; any when None.
            lack: By what factor an uncertainty is too large.
        """
        names = [joint] if joint else self.robot.joints
        use = {name: float(self.use[self.robot.joint_index(name)]) for name in names}
        feeble = {name: share for name, share in use.items() if share < _FEEBLE}
        if feeble:
            listed = ", ".join(f"{name} ({100 * share:.2g} %)" for name, share in feeble.items())
            return f"move farther and faster: {listed} of the speed limit is reached now"
        times = f"{int(np.ceil(lack**2))} times as long" if 1 < lack < _HOPELESS else "longer"
        return f"record {times}, or design a motion with more harmonics"


def limit_items(situation: Situation) -> tuple[Item, ...]:
    """Limits kept by what the arm does, friction and tracking errors included."""
    limits, run = situation.robot.limits, situation.run
    bounded = np.isfinite(limits.position).all(axis=1)
    low, high = np.where(bounded, limits.position.T, 0.0)
    half = np.where(bounded, (high - low) / 2, np.inf)
    shares = {
        "position": np.abs(run.q - (low + high) / 2).max(axis=0) / half,
        "velocity": np.abs(run.dq).max(axis=0) / limits.velocity,
        "torque": np.abs(run.tau).max(axis=0) / limits.torque,
    }
    return tuple(_limit(situation, name, share) for name, share in shares.items())


def _limit(situation: Situation, name: str, share: Array) -> Item:
    joint, worst = situation.robot.joints[int(share.argmax())], float(share.max())
    passed = worst <= 1 + _OVER
    slower = np.sqrt(1 / worst) if name == "torque" else 1 / worst
    advice = "" if passed else (
        f"make the motion of {joint} smaller" if name == "position"
        else f"play the motion at {100 * min(slower, 0.99):.0f} % of its speed"
    )  # fmt: skip
    return Item(f"{name} limits", joint, passed, f"{100 * worst:.1f} % of the limit used", advice)


def friction_items(situation: Situation, estimate: Estimate, beta: Array) -> tuple[Item, ...]:
    """Viscous and Coulomb friction of every joint, each known to 10 %."""
    names = [estimate.base.names[k] for k in estimate.base.columns]
    std = np.sqrt(np.diag(estimate.least_squares.covariance))
    found = []
    for effect in standard_effects(situation.robot.joints)[:2]:
        for joint, parameter in zip(
            situation.robot.joints, effect.parameters(situation.robot), strict=True
        ):
            k = names.index(parameter.name)
            value, true, s = estimate.least_squares.beta[k], beta[k], std[k]
            lack = max(abs(value - true), 1.96 * s) / (_KNOWN * abs(true))
            found.append(
                Item(
                    plain(effect.name), joint, bool(lack <= 1),
                    f"planted {true:.4g}, recovered {value:.4g} ± {s:.2g} {parameter.unit}",
                    "" if lack <= 1 else situation.faster(joint, lack),
                    float(true), float(value), float(s), parameter.unit,
                )
            )  # fmt: skip
    return tuple(found)


def coverage_item(situation: Situation, estimates: Sequence[Estimate], beta: Array) -> Item:
    """Stated intervals hold what was planted."""
    inside = [
        np.abs(e.least_squares.beta - beta) <= 1.96 * np.sqrt(np.diag(e.least_squares.covariance))
        for e in estimates
    ]
    share, cases = float(np.mean(inside)), int(np.size(inside))
    passed = share >= _COVERED
    return Item(
        "base parameters", "", passed,
        f"{100 * share:.1f} % of {cases} cases within their 95 % intervals "
        f"({len(beta)} parameters, {len(estimates)} readings)",
        "" if passed else situation.faster(),
    )  # fmt: skip


def prediction_item(situation: Situation, estimate: Estimate, beta: Array) -> Item:
    """Error on the hold-out close to that of the true parameters behind the same sensors."""
    rows = estimate.holdout
    floor = rows.accuracy(estimate.holdout_columns @ beta).rms
    worse = estimate.validate.rms / floor
    j = int(worse.argmax())
    passed, joint = bool(worse[j] <= _WORSE), situation.robot.joints[j]
    unit = "N·m" if situation.robot.revolute[j] else "N"
    return Item(
        "torque on the hold-out", joint, passed,
        f"rms error {estimate.validate.rms[j]:.3g} {unit}, of which noise leaves {floor[j]:.3g} "
        f"{unit} even to the true parameters",
        "" if passed else situation.faster(lack=float(worse[j] / _WORSE)),
    )  # fmt: skip


def other_motions_item(situation: Situation, estimate: Estimate, beta: Array) -> Item:
    """Error at states within half the limits, which the motion need not have shown."""
    robot, base = situation.robot, estimate.base
    q, dq, ddq = typical_motion(robot)
    motion = Motion(np.arange(len(q), dtype=float), q, dq, ddq)
    W = observation_columns(robot, standard_effects(robot.joints), motion)[:, :, base.columns]
    torque = np.sqrt(np.mean((W @ beta) ** 2, axis=0))
    share = np.sqrt(np.mean((W @ (estimate.least_squares.beta - beta)) ** 2, axis=0)) / torque
    j = int(share.argmax())
    passed = bool(share[j] <= _ELSEWHERE)
    std = np.sqrt(np.diag(estimate.least_squares.covariance))
    unsure = np.sqrt(np.mean(W[:, j] ** 2, axis=0)) * std
    weak = base.names[base.columns[int(unsure.argmax())]]
    return Item(
        "torque at other motions", robot.joints[j], passed,
        f"rms error {100 * share[j]:.2g} % of the torque at half the limits, "
        f"known least: {weak}",
        "" if passed else situation.faster(lack=float(share[j] / _ELSEWHERE)),
    )  # fmt: skip


def undetermined_item(situation: Situation, error: RankDeficient) -> Item:
    """The motion does not determine the parameters at all."""
    names = ", ".join(error.names[:4]) + (", ..." if len(error.names) > 4 else "")
    weakest = situation.robot.joints[int(situation.use.argmin())]
    return Item(
        "identification", weakest, False,
        f"the motion leaves {len(error.names)} parameters undetermined: {names}",
        situation.faster(weakest),
    )  # fmt: skip


def diagnosis_item(situation: Situation, found: Diagnosis, change: HiddenEffect) -> Item:
    """The change of the arm is named, on its joint, before anything else.

    A payload is inertia by another name: that other inertia explains it as well is no fault.
    """
    planted = f"{plain(change.effect)} on {change.joint}"
    if not found.findings:
        return Item("diagnosis", change.joint, False, f"{planted}: nothing was named",
                    situation.faster(change.joint))  # fmt: skip
    lead = found.findings[0]
    named = f"{lead.verdict} {_cause(lead)}"
    if lead.rivals:
        named += f" (or {', '.join(_cause(rival.candidate) for rival in lead.rivals)})"
    right = lead.effect.name == change.effect and change.joint in lead.effect.joints
    others = {rival.candidate.effect.name for rival in lead.rivals}
    masses = {name for name, kind in EFFECTS.items() if kind.family == "body"}
    alike = masses if change.effect in masses else set()
    passed = right and not lead.downgrade and others <= alike
    item = Item(
        "diagnosis", change.joint, passed, f"{planted}: {named}",
        "" if passed else situation.faster(change.joint),
    )  # fmt: skip
    if not right or lead.effect.values is None:
        return item
    return replace(
        item,
        planted=change.parameters[0][1],
        recovered=float(lead.effect.values[0] - lead.given[0]),
        std=float(lead.std[0]),
        unit=lead.effect.parameters(found.robot)[0].unit,
    )


def _cause(found: Finding | Candidate) -> str:
    return f"{plain(found.effect.name)} on {', '.join(found.effect.joints)}"
