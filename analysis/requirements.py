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
from excitant.robots.plant.sensors import Run
from excitant.robots.robot import Robot
from excitant.robots.torque import observation_columns
from excitant.robots.virtual_arm import HiddenEffect, VirtualArm, typical_motion

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


def _item(name: str, joint: str, passed: bool, detail: str, advice: str) -> Item:
    return Item(name, joint, bool(passed), detail, "" if passed else advice)


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


def limit_items(situation: Situation) -> list[Item]:
    """Limits kept by what the arm does, friction and tracking errors included."""
    limits, run, items = situation.robot.limits, situation.run, []
    bounded = np.isfinite(limits.position).all(axis=1)
    low, high = np.where(bounded, limits.position.T, 0.0)
    half = np.where(bounded, (high - low) / 2, np.inf)
    shares = {
        "position": np.abs(run.q - (low + high) / 2).max(axis=0) / half,
        "velocity": np.abs(run.dq).max(axis=0) / limits.velocity,
        "torque": np.abs(run.tau).max(axis=0) / limits.torque,
    }
    for name, share in shares.items():
        joint, worst = situation.robot.joints[int(share.argmax())], float(share.max())
        speed = 1 / max(worst, 1.0) ** (0.5 if name == "torque" else 1.0)
        advice = f"play the motion at {100 * min(speed, 0.99):.0f} % of its speed"
        if name == "position":
            advice = f"make the motion of {joint} smaller"
        detail = f"{100 * worst:.1f} % of the limit used"
        items.append(_item(f"{name} limits", joint, worst <= 1 + _OVER, detail, advice))
    return items


def recovery_items(situation: Situation, estimates: Sequence[Estimate], x: Array) -> list[Item]:
    """What estimates from several readings recover of the arm's parameters x, shape (p,)."""
    estimate, beta = estimates[0], estimates[0].base.regrouping @ x
    return [
        *_friction(situation, estimate, beta),
        _coverage(situation, estimates, beta),
        _prediction(situation, estimate, beta),
        _other_motions(situation, estimate, beta),
    ]


def _std(estimate: Estimate) -> Array:
    return np.asarray(np.sqrt(np.diag(estimate.least_squares.covariance)), float)


def _friction(situation: Situation, estimate: Estimate, beta: Array) -> list[Item]:
    """Viscous and Coulomb friction of every joint, each known to 10 %."""
    robot, items = situation.robot, []
    names = [estimate.base.names[k] for k in estimate.base.columns]
    for effect in standard_effects(robot.joints)[:2]:
        for joint, parameter in zip(robot.joints, effect.parameters(robot), strict=True):
            k = names.index(parameter.name)
            each = beta[k], estimate.least_squares.beta[k], _std(estimate)[k]
            true, value, std = map(float, each)
            lack = max(abs(value - true), 1.96 * std) / (_KNOWN * abs(true))
            unit, advice = parameter.unit, situation.faster(joint, lack)
            detail = f"planted {true:.4g}, recovered {value:.4g} ± {std:.2g} {unit}"
            item = _item(plain(effect.name), joint, lack <= 1, detail, advice)
            items.append(replace(item, planted=true, recovered=value, std=std, unit=unit))
    return items


def _coverage(situation: Situation, estimates: Sequence[Estimate], beta: Array) -> Item:
    """Stated intervals hold what was planted."""
    inside = [np.abs(e.least_squares.beta - beta) <= 1.96 * _std(e) for e in estimates]
    share = float(np.mean(inside))
    detail = (
        f"{100 * share:.1f} % of {np.size(inside)} cases within their 95 % intervals "
        f"({len(beta)} parameters, {len(estimates)} readings)"
    )
    return _item("base parameters", "", share >= _COVERED, detail, situation.faster())


def _prediction(situation: Situation, estimate: Estimate, beta: Array) -> Item:
    """Error on the hold-out close to that of the true parameters behind the same sensors."""
    robot, rms = situation.robot, estimate.validate.rms
    floor = estimate.holdout.accuracy(estimate.holdout_columns @ beta).rms
    worse = rms / floor
    j = int(worse.argmax())
    unit = "N·m" if robot.revolute[j] else "N"
    detail = (
        f"rms error {rms[j]:.3g} {unit}, of which noise leaves {floor[j]:.3g} {unit} even to the "
        "true parameters"
    )
    advice = situation.faster(lack=float(worse[j] / _WORSE))
    return _item("torque on the hold-out", robot.joints[j], worse[j] <= _WORSE, detail, advice)


def _other_motions(situation: Situation, estimate: Estimate, beta: Array) -> Item:
    """Error at states within half the limits, which the motion need not have shown."""
    robot, base = situation.robot, estimate.base
    q, dq, ddq = typical_motion(robot)
    motion = Motion(np.arange(len(q), dtype=float), q, dq, ddq)
    W = observation_columns(robot, standard_effects(robot.joints), motion)[:, :, base.columns]
    torque = np.sqrt(np.mean((W @ beta) ** 2, axis=0))
    share = np.sqrt(np.mean((W @ (estimate.least_squares.beta - beta)) ** 2, axis=0)) / torque
    j = int(share.argmax())
    unsure = np.sqrt(np.mean(W[:, j] ** 2, axis=0)) * _std(estimate)
    weak = base.names[base.columns[int(unsure.argmax())]]
    detail = (
        f"rms error {100 * share[j]:.2g} % of the torque at half the limits, known least: {weak}"
    )
    advice = situation.faster(lack=float(share[j] / _ELSEWHERE))
    passed = share[j] <= _ELSEWHERE
    return _item("torque at other motions", robot.joints[j], passed, detail, advice)


def undetermined_item(situation: Situation, error: RankDeficient) -> Item:
    """The motion does not determine the parameters at all."""
    names = ", ".join(error.names[:4]) + (", ..." if len(error.names) > 4 else "")
    weakest = situation.robot.joints[int(situation.use.argmin())]
    detail = f"the motion leaves {len(error.names)} parameters undetermined: {names}"
    return _item("identification", weakest, False, detail, situation.faster(weakest))


def diagnosis_item(situation: Situation, found: Diagnosis, change: HiddenEffect) -> Item:
    """The change of the arm is named, on its joint, before anything else.

    A payload is inertia by another name: that other inertia explains it as well is no fault.
    """
    planted = f"{plain(change.effect)} on {change.joint}"
    advice = situation.faster(change.joint)
    if not found.findings:
        return _item("diagnosis", change.joint, False, f"{planted}: nothing was named", advice)
    lead = found.findings[0]
    named = f"{lead.verdict} {_cause(lead)}"
    if lead.rivals:
        named += f" (or {', '.join(_cause(rival.candidate) for rival in lead.rivals)})"
    right = lead.effect.name == change.effect and change.joint in lead.effect.joints
    masses = {name for name, kind in EFFECTS.items() if kind.family == "body"}
    alike = masses if change.effect in masses else set()
    others = {rival.candidate.effect.name for rival in lead.rivals} - alike
    passed = right and not lead.downgrade and not others
    item = _item("diagnosis", change.joint, passed, f"{planted}: {named}", advice)
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
