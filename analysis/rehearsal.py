"""`rehearse`: a motion tried on a virtual arm, and the parameters recovered from it.

The arm runs the motion, and again at 80 % of the speed as hold-out; its true values must be
recovered. Then it changes, and the diagnosis of the identified model must name the change.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import msgspec
import numpy as np
import numpy.typing as npt

from excitant.analysis.confirmation import Finding
from excitant.analysis.diagnosis import Diagnosis, diagnose
from excitant.analysis.evidence import Candidate
from excitant.design.constraints import clearance as clearance_along
from excitant.design.optimal import SceneOption
from excitant.design.trajectory import HermiteTrajectory, Trajectory
from excitant.exceptions import RankDeficient
from excitant.identify.estimate import Estimate, identify_robot
from excitant.identify.reading.logs import recording_from_table
from excitant.identify.recording import Recording
from excitant.names import listed
from excitant.results import Requirement
from excitant.robots.effects import EFFECTS, Effect, plain, standard_effects
from excitant.robots.geometry import CLEARANCE, Scene, usual_scene
from excitant.robots.motion import Array, numbered, read_only, root_mean_square
from excitant.robots.plant.planting import plant
from excitant.robots.plant.sensors import Run
from excitant.robots.robot import Robot
from excitant.robots.shown import Shown, Table
from excitant.robots.threads import on_one_thread
from excitant.robots.torque import observation_columns
from excitant.robots.virtual_arm import (
    HiddenEffect,
    VirtualArm,
    draw_hidden_effect,
    industrial_sensors,
    nominal_truth,
    typical_motion,
    typical_torque,
    virtual_arm,
)

Path = Trajectory | HermiteTrajectory
Progress = Callable[[float, str], None]

_CHANGES = ("payload", "viscous_friction", "coulomb_friction")
# of the torque limit
_SHARE = {
    "viscous": 0.1,
    "coulomb": 0.04,
    "rotor": 0.1,
    "offset": 0.01,
}
_TOLERANCE = 0.05  # of masses, centres of mass and inertias
_SLOWER = 0.8  # speed of the hold-out
_READINGS = 6
_LISTED = 4  # names in a sentence
_CASES = 300  # noisy recordings of the same run, and intervals to judge, at least

_OVER = 0.05  # of a limit: an arm that tracks a motion overshoots it a little
_KNOWN = 0.1  # of a friction coefficient: accuracy required
_COVERED = 0.9  # of base parameters within their 95 % intervals
_WORSE = 1.1  # error of the model over that of the truth behind the same sensors
_ELSEWHERE = 0.05  # of typical torque: error at motions within half the limits
_FEEBLE = 0.3  # of its speed limit: a joint that should move more
_HOPELESS = 5.0  # uncertainty beyond which a longer record alone will not do


def _item(
    name: str,
    joint: str,
    passed: bool,
    detail: str,
    advice: str,
    planted: float | None = None,
    recovered: float | None = None,
    std: float | None = None,
    unit: str = "",
) -> Requirement:
    """A requirement, with advice where it is not met, and values where it is about one."""
    said = "" if passed else advice
    values = (planted, recovered, std, unit)
    return Requirement(name, joint, bool(passed), detail, said, *values)


@dataclass(frozen=True, eq=False)
class Situation:
    """Common input of all items: the robot as given, and the arm's run of the motion."""

    robot: Robot
    run: Run

    @property
    def use(self) -> dict[str, float]:
        """Highest speed of each joint relative to its limit, 3 rad/s where there is none."""
        top = self.robot.limits.usual_speed
        shares = np.abs(self.run.dq).max(axis=0) / top
        return dict(zip(self.robot.joints, shares.tolist(), strict=True))

    def faster(self, joint: str = "", lack: float = 0.0) -> str:
        """Advice for an uncertainty too large by a factor: more amplitude, else a longer motion."""
        feeble = [
            f"{name} ({100 * share:.2g} % of its speed limit)"
            for name, share in self.use.items()
            if share < _FEEBLE and joint in ("", name)
        ]
        if feeble:
            return f"move farther and faster: {', '.join(feeble)}"
        times = (
            f"{int(np.ceil(lack**2))} times as long"
            if 1 < lack < _HOPELESS
            else "longer"
        )
        return f"record {times}, or design a motion with more harmonics"


def limit_items(situation: Situation) -> list[Requirement]:
    """Limits compared with the motion of the arm, friction and tracking errors included."""
    limits = situation.robot.limits
    run = situation.run
    items = []
    bounded = np.isfinite(limits.position).all(axis=1)
    low, high = np.where(bounded, limits.position.T, 0.0)
    half = np.where(bounded, (high - low) / 2, np.inf)
    shares = {
        "position": np.abs(run.q - (low + high) / 2).max(axis=0) / half,
        "velocity": np.abs(run.dq).max(axis=0) / limits.velocity,
        "torque": np.abs(run.tau).max(axis=0) / limits.torque,
    }
    for name, share in shares.items():
        joint = situation.robot.joints[share.argmax()]
        worst = share.max()
        speed = min(1 / max(worst, 1.0) ** (0.5 if name == "torque" else 1.0), 0.99)
        slower = f"play the motion at {100 * speed:.0f} % of its speed"
        advice = (
            f"make the motion of {joint} smaller" if name == "position" else slower
        )
        detail = f"{100 * worst:.1f} % of the limit used"
        items.append(
            _item(f"{name} limits", joint, worst <= 1 + _OVER, detail, advice)
        )
    return items


def clearance_item(scene: Scene, path: Path, required: float) -> Requirement:
    """Distance between bodies over the continuous motion, as `check` has it."""
    near = clearance_along(scene, path)
    distance_mm = 1000 * near.distance / near.scale
    required_mm = 1000 * required / near.scale
    detail = (
        f"{' and '.join(near.bodies)} come within {distance_mm:.3g} mm at {near.time:.4g} s, "
        f"required {required_mm:.3g} mm"
    )
    advice = (
        f"keep {' and '.join(near.bodies)} apart: design the motion for this scene"
    )
    return _item("clearance", "", near.distance >= required, detail, advice)


def _recovered(
    situation: Situation, estimates: Sequence[Estimate], x: Array
) -> list[Requirement]:
    beta = estimates[0].base.regrouping @ x
    fits = [e.least_squares for e in estimates]
    inside = np.array([np.abs(f.beta - beta) <= 1.96 * f.std for f in fits])
    share = inside.mean()
    detail = (
        f"{100 * share:.1f} % of {inside.size} cases within their 95 % intervals "
        f"({len(beta)} parameters, {len(estimates)} recordings)"
    )
    return [
        *_friction(situation, estimates[0], beta),
        _item("base parameters", "", share >= _COVERED, detail, situation.faster()),
        _prediction(situation, estimates[0], beta),
        _other_motions(situation, estimates[0], beta),
    ]


def _friction(
    situation: Situation, estimate: Estimate, beta: Array
) -> list[Requirement]:
    robot = situation.robot
    items = []
    fit = estimate.least_squares
    names = [estimate.base.names[k] for k in estimate.base.columns]
    for effect in standard_effects(robot.joints)[:2]:
        for joint, parameter in zip(
            robot.joints, effect.parameters(robot), strict=True
        ):
            k = names.index(parameter.name)
            true, value, s = map(float, (beta[k], fit.beta[k], fit.std[k]))
            lack = max(abs(value - true), 1.96 * s) / (_KNOWN * abs(true))
            unit = parameter.unit
            advice = situation.faster(joint, lack)
            detail = f"planted {true:.4g}, recovered {value:.4g} ± {s:.2g} {unit}"
            items.append(
                _item(
                    plain(effect.name),
                    joint,
                    lack <= 1,
                    detail,
                    advice,
                    true,
                    value,
                    s,
                    unit,
                )
            )
    return items


def _prediction(
    situation: Situation, estimate: Estimate, beta: Array
) -> Requirement:
    robot = situation.robot
    rms = estimate.validate.rms
    floor = estimate.holdout.accuracy(estimate.holdout_columns @ beta).rms
    worse = rms / floor
    j = int(worse.argmax())
    unit = robot.torque_unit(joint=j)
    left = f"with the true parameters, noise leaves {floor[j]:.3g} {unit}"
    detail = f"rms error {rms[j]:.3g} {unit}; {left}"
    advice = situation.faster(lack=float(worse[j] / _WORSE))
    return _item(
        "torque on the hold-out",
        robot.joints[j],
        worse[j] <= _WORSE,
        detail,
        advice,
    )


def _other_motions(
    situation: Situation, estimate: Estimate, beta: Array
) -> Requirement:
    """Error at states within half the limits, which the motion need not have visited."""
    robot = situation.robot
    base = estimate.base
    motion = numbered(*typical_motion(robot))
    W = observation_columns(robot, standard_effects(robot.joints), motion)[
        :, :, base.columns
    ]
    torque = root_mean_square(W @ beta)
    share = root_mean_square(W @ (estimate.least_squares.beta - beta)) / torque
    j = int(share.argmax())
    unsure = root_mean_square(W[:, j]) * estimate.least_squares.std
    weak = base.names[base.columns[unsure.argmax()]]
    size = f"rms error {100 * share[j]:.2g} % of the torque at half the limits"
    advice = situation.faster(lack=float(share[j] / _ELSEWHERE))
    passed = share[j] <= _ELSEWHERE
    detail = f"{size}; least certain: {weak}"
    return _item("torque at other motions", robot.joints[j], passed, detail, advice)


def _undetermined(situation: Situation, error: RankDeficient) -> Requirement:
    names = listed(error.names, _LISTED)
    weakest = min(situation.use, key=situation.use.__getitem__)
    detail = (
        f"the motion leaves {len(error.names)} parameters undetermined: {names}"
    )
    return _item(
        "identification", weakest, False, detail, situation.faster(weakest)
    )


def _named(
    situation: Situation, diagnosis: Diagnosis, change: HiddenEffect
) -> Requirement:
    """The change of the arm is named, on its joint, before anything else."""
    # a payload and other added inertia may explain the data equally well; that is no failure
    planted = f"planted {plain(change.effect)} on {change.joint}"
    advice = situation.faster(change.joint)
    if not diagnosis.findings:
        return _item(
            "diagnosis", change.joint, False, f"{planted}, found nothing", advice
        )
    lead = diagnosis.findings[0]
    found = [_cause(lead), *(_cause(rival.candidate) for rival in lead.rivals)]
    named = f"found {' or '.join(found)} ({lead.verdict})"
    right = lead.effect.name == change.effect and change.joint in lead.effect.joints
    mass = EFFECTS[change.effect].family == "body"
    others = [
        r for r in lead.rivals if not (mass and r.candidate.effect.family == "body")
    ]
    passed = right and not lead.downgrade and not others
    detail = f"{planted}, {named}"
    told = "diagnosis", change.joint, passed, detail, advice
    if not right or lead.effect.values is None:
        return _item(*told)
    return _item(
        *told,
        change.parameters[0][1],
        float(lead.effect.values[0] - lead.nominal[0]),
        float(lead.std[0]),
        lead.effect.parameters(diagnosis.robot)[0].unit,
    )


def _cause(cause: Finding | Candidate) -> str:
    return f"{plain(cause.effect.name)} on {', '.join(cause.effect.joints)}"


@dataclass(frozen=True, eq=False, repr=False)
class Rehearsal(Shown):
    """Recovery of a virtual arm's parameters by a motion.

    Attributes:
        robot: The robot as given, with its limits.
        duration: Length of the motion [s].
        arm: The arm that ran it.
        change: What was added to the arm before its diagnosis.
        run: The motion as the arm ran it.
        items: Requirements, in order.
        estimate: Identified model; None where the motion leaves parameters undetermined.
        diagnosis: Diagnosis of that model after the change; None without an estimate.
    """

    robot: Robot
    duration: float
    arm: VirtualArm
    change: HiddenEffect
    run: Run
    items: tuple[Requirement, ...]
    estimate: Estimate | None = None
    diagnosis: Diagnosis | None = None

    @property
    def passed(self) -> bool:
        """Whether the motion meets all requirements."""
        return all(item.passed for item in self.items)

    def result(self) -> dict[str, Any]:
        """Contents of result.json: the requirements, and whether they are met."""
        failed = [item for item in self.items if not item.passed]
        return {
            "verb": "rehearse",
            "robot": self.robot.name,
            "joints": list(self.robot.joints),
            "duration": self.duration,
            "passed": self.passed,
            "headline": self.headline,
            "items": msgspec.to_builtins(self.items),
            "advice": list(dict.fromkeys(item.advice for item in failed)),
            "effect": self.change.entry(),
            "limit_values": {
                x: getattr(self.robot.limits, x)
                for x in ("position", "velocity", "torque")
            },
        }

    def series(self) -> dict[str, Array]:
        """The run of the motion on the virtual arm: t [s], q, dq, tau in SI units, (n, nv)."""
        return {name: getattr(self.run, name) for name in ("t", "q", "dq", "tau")}

    @property
    def headline(self) -> str:
        """The verdict in a sentence."""
        if self.passed:
            met = f"all {len(self.items)} requirements are met"
            return f"The motion would do: {met} on a virtual arm"
        failed = [
            f"{x.name} of {x.joint}".removesuffix(" of ")
            for x in self.items
            if not x.passed
        ]
        names = listed(list(dict.fromkeys(failed)), _LISTED)
        return f"The motion would not do: {names}"

    def _lines(self) -> list[str]:
        met = sum(x.passed for x in self.items)
        verdict = "would do" if self.passed else "would not do"
        return [
            f"Rehearsal: the motion {verdict}",
            f"of {self.robot.name}; {met} of {len(self.items)} requirements are met",
            self.headline,
        ]

    def _table(self) -> Table:
        rows = [
            ("met" if x.passed else "not met", x.name, x.joint, x.detail)
            for x in self.items
        ]
        return ("", "requirement", "joint", "figures"), rows


@on_one_thread
def rehearse(
    robot: Robot,
    path: Path,
    duration: float,
    rng: np.random.Generator,
    *,
    scene: SceneOption = None,
    clearance: float = CLEARANCE,
    progress: Progress | None = None,
) -> Rehearsal:
    """Try a motion on a virtual arm.

    Args:
        robot: The arm as it is known, with its limits.
        path: Positions ``path(t, order)`` and derivatives, shape (n, nv); from rest.
        duration: Length of the motion [s].
        rng: Draws the arm, its noise and its change.
        scene: Bodies that must keep apart; the arm's own and the floor that it stands on when
            None; an empty tuple leaves clearance out.
        clearance: Smallest distance that they must keep [m].
        progress: Called with the fraction done and the current step.

    Raises:
        BadInput: The motion starts at speed, or an arm cannot follow it.
        BadRecording: The motion is too short to be identified from.
        BadRobot: A link of negative mass.
    """
    tell = progress or (lambda fraction, words: None)
    tell(0.0, "running the motion")
    arm = rehearsal_arm(robot, rng)
    change = draw_change(robot, rng)
    run = arm.run(path, duration, rng)
    situation = Situation(robot, run)
    common = (robot, duration, arm, change, run)
    items = limit_items(situation)
    around = usual_scene(robot, clearance) if scene is None else scene or None
    if around is not None:
        items.append(clearance_item(around, path, clearance))
    tell(0.15, "running it slower")

    def slower(t: npt.ArrayLike, order: int = 0) -> Array:
        return _SLOWER**order * path(_SLOWER * np.asarray(t, float), order)

    slow = slower, duration / _SLOWER
    held = _recording(arm, arm.run(*slow, rng), "slower", rng)
    tell(0.35, "identifying")
    try:
        estimates = list[Estimate]()
        count = _READINGS
        while len(estimates) < count:
            reading = _recording(arm, run, "motion", rng)
            estimates.append(identify_robot(robot, [reading], validate=[held]))
            count = max(_READINGS, -(-_CASES // len(estimates[0].base)))
    except RankDeficient as error:
        items.append(_undetermined(situation, error))
        return Rehearsal(*common, tuple(items))
    tell(0.55, "running it on the changed arm")
    later = changed(arm, change)
    recordings = [
        _recording(later, later.run(p, d, rng), name, rng)
        for name, p, d in (
            ("motion after the change", path, duration),
            ("slower after it", *slow),
        )
    ]
    tell(0.75, "diagnosing")
    diagnosis = diagnose(
        estimates[0].model, recordings[:1], validate=recordings[1:]
    )
    planted = planted_parameters(arm, standard_effects(robot.joints))
    items += _recovered(situation, estimates, planted)
    items.append(_named(situation, diagnosis, change))
    return Rehearsal(*common, tuple(items), estimates[0], diagnosis)


def _recording(
    arm: VirtualArm, run: Run, name: str, rng: np.random.Generator
) -> Recording:
    table = arm.recorded(run, rng)
    return recording_from_table(table, arm.nominal.nv, file=name, name=name)


def rehearsal_arm(robot: Robot, rng: np.random.Generator) -> VirtualArm:
    """A virtual arm like the robot, with drives, perturbed inertias and industrial sensors.

    Drives take the shares of the torque limit typical of geared arms, unless the robot has its own.
    All values differ by up to 5 % from the controller's model; torque has no limits, so that the
    torque needed by a motion can be compared with them.
    """
    free = replace(robot.limits, torque=np.full(robot.nv, np.inf))
    given = robot.with_limits(free).with_effects(_drives(robot, rng))
    sensors = industrial_sensors(robot.with_effects(()))
    return virtual_arm(given, rng, hidden=(), tolerance=_TOLERANCE, sensors=sensors)


def _drives(robot: Robot, rng: np.random.Generator) -> list[Effect]:
    known = robot.with_effects([e for e in robot.effects if e.search.standard])
    given = nominal_truth(known).drives
    strength = with_strength(robot).limits.torque
    # close to the limits
    _, dq, ddq = (2 * np.abs(x).max(axis=0) for x in typical_motion(robot))
    per_unit = {
        "viscous": dq,
        "rotor": ddq,
        "offset": rng.choice([-1.0, 1.0], robot.nv),
    }
    effects = []
    for effect in standard_effects(robot.joints):
        drive = effect.export.joint_property
        own = getattr(given, drive)
        usual = _SHARE[drive] * strength / per_unit.get(drive, 1.0)
        effects.append(
            replace(effect, values=tuple(np.where(own != 0, own, usual).tolist()))
        )
    return effects


def with_strength(robot: Robot) -> Robot:
    """The robot with a torque limit at each joint: four times typical torque where it has none."""
    limit = robot.limits.torque
    strength = np.where(np.isfinite(limit), limit, 4 * typical_torque(robot))
    return robot.with_limits(replace(robot.limits, torque=strength))


def draw_change(robot: Robot, rng: np.random.Generator) -> HiddenEffect:
    """A change after identification: a payload, or more friction on one joint."""
    while True:
        effect = draw_hidden_effect(robot, rng)
        if effect.effect in _CHANGES:
            return effect


def changed(arm: VirtualArm, effect: HiddenEffect) -> VirtualArm:
    """The same arm after a change."""
    truth = plant(arm.truth, arm.nominal.joints, [effect])
    return replace(arm, truth=truth, hidden=(*arm.hidden, effect))


def planted_parameters(arm: VirtualArm, effects: tuple[Effect, ...]) -> Array:
    """True standard parameters of the links, then those of standard effects, shape (p,)."""
    bodies = [
        body.toDynamicParameters() for body in list(arm.truth.model.inertias)[1:]
    ]
    drives = [
        getattr(arm.truth.drives, effect.export.joint_property)
        for effect in effects
    ]
    return read_only(np.concatenate([*bodies, *drives]))
