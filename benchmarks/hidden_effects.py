"""Hidden effects of a wanted size: how strongly one shows, and drawing one that shows so much.

The *visible size* of what a virtual arm hides is the root mean square of the torque it makes, at
the motion that was recorded, behind the filter that identification uses, in units of what the
torque noise leaves behind the same filter. At 1 it drowns; 2 is just visible; 30 is plain.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
import pinocchio as pin
import scipy.interpolate
import scipy.signal

from excitant.design import random_trajectory
from excitant.exceptions import BadInput, UnknownName
from excitant.robots.motion import Array
from excitant.robots.parameters import STANDARD
from excitant.robots.plant.arm import Believed, Trajectory, simulate
from excitant.robots.plant.physics import Truth
from excitant.robots.plant.planting import STRUCTURES, HiddenEffect, plant
from excitant.robots.plant.sensors import Sensors, recorded
from excitant.robots.robot import Robot
from excitant.robots.virtual_arm import (
    VirtualArm,
    draw_payload,
    industrial_sensors,
    nominal_truth,
    separable_rotors,
    virtual_arm,
)

_HARMONICS = 5  # of the motion on which an effect is measured
Rng = np.random.Generator
Numbers = dict[str, float]


@dataclass(frozen=True, eq=False)
class TypicalMotion:
    """A typical motion of the nominal arm: samples (n, nv), figures of joints (nv,), SI units."""

    robot: Robot
    q: Array
    dq: Array
    ddq: Array
    tau: Array
    load: Array  # torque without friction and rotors
    tip: Array  # positions in the base frame, shape (n, 3)
    coulomb: Array
    inertia: Array  # mean of each joint's own entry of the mass matrix
    rotor: Array
    wanted: Array  # torque that an effect should make

    @property
    def size(self) -> float:
        """Longest distance of the tip from the origin on the motion, at least 0.1 m."""
        return max(float(np.linalg.norm(self.tip, axis=1).max()), 0.1)

    def per(self, j: int, signal: Array) -> float:
        """Coefficient with which a signal makes the wanted torque of a joint."""
        return float(self.wanted[j]) / rms(signal)


def typical_motion(
    robot: Robot, trajectory: Trajectory, duration: float, wanted: Array
) -> TypicalMotion:
    t = np.linspace(0.0, duration, 300)
    states, truth = [trajectory(t, order) for order in range(3)], nominal_truth(robot)
    bare = truth.model.copy()
    bare.armature = np.zeros(robot.nv)
    data, rotating = bare.createData(), truth.model.createData()
    tau = truth.drives.friction(states[1])
    load, tip, inertia = (np.zeros((len(t), k)) for k in (robot.nv, 3, robot.nv))
    for k, (q, dq, ddq) in enumerate(zip(*states, strict=True)):
        tau[k] += pin.rnea(truth.model, rotating, q, dq, ddq)
        load[k] = pin.rnea(bare, data, q, dq, ddq)
        inertia[k] = np.diag(pin.crba(bare, data, q))
        pin.forwardKinematics(bare, data, q)
        tip[k] = pin.updateFramePlacement(bare, data, robot.tip).translation
    drives, mean = truth.drives, inertia.mean(axis=0)
    return TypicalMotion(robot, *states, tau, load, tip, drives.coulomb, mean, drives.rotor, wanted)


@dataclass(frozen=True, eq=False)
class Recipe:
    """An effect that lacks only its size: parameters are ``around + scale · scaled``, and fixed."""

    joints: tuple[int, ...]  # indices
    scaled: Numbers
    fixed: Numbers = field(default_factory=dict)
    guess: float = 1.0  # scale that may give what is wanted
    most: float = np.inf  # largest scale that such arms may have
    around: float = 0.0
    powers: Numbers = field(default_factory=dict)  # of the scale, where it is not one

    def make(self, robot: Robot, kind: str, scale: float) -> HiddenEffect:
        """The effect at a scale."""
        names = tuple(robot.joints[j] for j in self.joints)
        grown = {
            n: self.around + scale ** self.powers.get(n, 1) * x for n, x in self.scaled.items()
        }
        values = tuple((name, float(x)) for name, x in (grown | self.fixed).items())
        effect, structure = ("unknown", kind) if kind in STRUCTURES else (kind, "")
        several = names if len(names) > 1 else ()
        return HiddenEffect(effect, (*names, "")[0], values, several, structure)


def rms(x: Array) -> float:
    """Root mean square, never zero."""
    return max(float(np.sqrt(np.mean(np.square(x)))), 1e-9)


def _sign(rng: Rng) -> float:
    return float(rng.choice([-1.0, 1.0]))


def recipe(kind: str, m: TypicalMotion, rng: Rng) -> Recipe:
    match kind:
        case "friction_coupling" | "inertia_coupling":
            j = int(rng.integers(max(m.robot.nv - 1, 1)))
            return _coupled(kind, m, rng, j, j + 1)
        case "joint_elasticity" | "backlash":  # where much inertia bends the gear
            strong = np.flatnonzero(m.inertia >= 0.1 * m.inertia.max())
            return _gear(kind, m, rng, int(rng.choice(strong)))
        case "torque_gain" | "time_delay":  # one time in four of all joints
            every = rng.random() < 0.25
            joints = tuple(range(m.robot.nv)) if every else (int(rng.integers(m.robot.nv)),)
            if kind == "time_delay":
                return Recipe(joints, {"delay": _sign(rng) * 0.01}, most=6.0)
            size = min(m.per(j, m.tau[:, j]) for j in joints)
            return Recipe(joints, {"gain": _sign(rng) * size}, most=0.4 / size, around=1.0)
        case "rotor_inertia":  # only where no inertia of the links can pass for it
            j = m.robot.joint_index(str(rng.choice(separable_rotors(m.robot))))
            return Recipe((j,), {"Ia": m.per(j, m.ddq[:, j])})
        case "kinematic_error":  # never of the first joint
            j = int(rng.integers(min(1, m.robot.nv - 1), m.robot.nv))
            d = rng.standard_normal(3)
            d *= 0.03 * m.size / np.linalg.norm(d)
            return Recipe((j,), dict(zip(("dx", "dy", "dz"), d, strict=True)), most=6.0)
        case "gravity_direction":
            way = rng.uniform(-np.pi, np.pi)
            tilt = {"roll": 0.03 * np.cos(way), "pitch": 0.03 * np.sin(way)}
            return Recipe((), tilt, most=10.0)
        case "payload":
            drawn = dict(draw_payload(m.robot, rng).parameters)
            return Recipe((m.robot.nv - 1,), drawn, guess=0.3, most=3.0)
        case "wall_contact":
            return _wall(m, rng)
        case "sensor_crosstalk":  # from a joint that is not a neighbour, where there is one
            j, k = (int(i) for i in rng.choice(m.robot.nv, 2, replace=False))
            if abs(j - k) < 2 and m.robot.nv > 2:
                k = (j + 2) % m.robot.nv
            size = m.per(j, m.tau[:, k])
            return Recipe((j, k), {"gain": _sign(rng) * size}, most=0.6 / size)
        case _:
            return _at_a_joint(kind, m, rng, int(rng.integers(m.robot.nv)))


def _at_a_joint(kind: str, m: TypicalMotion, rng: Rng, j: int) -> Recipe:
    q, dq, wanted = m.q[:, j], m.dq[:, j], m.wanted[j]
    match kind:
        case "viscous_friction":
            return Recipe((j,), {"Fv": m.per(j, dq)})
        case "coulomb_friction":
            return Recipe((j,), {"Fc": wanted})
        case "asymmetric_friction":
            side, share = str(rng.choice(["plus", "minus"])), rng.uniform(0.3, 0.7)
            dry, wet = (1 - share) * wanted, share * m.per(j, dq)
            return Recipe((j,), {f"Fc_{side}": dry, f"Fv_{side}": wet}, guess=1.4)
        case "stribeck_friction":
            v = rng.uniform(0.05, 0.2) * float(np.abs(dq).max())
            return Recipe((j,), {"Fs": wanted}, {"velocity": v}, 3.0)
        case "nonlinear_viscous_friction":
            a = float(rng.choice([rng.uniform(0.3, 0.6), rng.uniform(1.6, 2.0)]))
            return Recipe((j,), {"Fn": m.per(j, np.abs(dq) ** a)}, {"exponent": a})
        case "load_dependent_friction":
            size = m.per(j, m.load[:, j])
            return Recipe((j,), {"Fl": size}, most=0.3 / size)
        case "presliding_hysteresis":  # shows beside at most 1.5 times the dry friction there is
            x = float(np.exp(rng.uniform(np.log(0.01), np.log(0.15))))
            most = 1.5 * m.coulomb[j] if m.coulomb[j] > 0 else 0.5 * rms(m.tau[:, j])
            return Recipe((j,), {"Fh": wanted}, {"distance": x}, 3.0, most / wanted)
        case "thermal_friction_drift":
            share, time = rng.uniform(0.3, 0.7), rng.uniform(6.0, 25.0)
            sizes = {"Fv": share * m.per(j, dq), "Fc": (1 - share) * wanted}
            return Recipe((j,), sizes, {"time": time}, 1.3)
        case "torque_offset":
            return Recipe((j,), {"offset": _sign(rng) * wanted})
        case "torque_ripple":  # slow enough at typical speed to pass the filter
            phase = rng.uniform(-np.pi, np.pi)
            fastest = np.clip(2 * np.pi * 6.0 / rms(dq), 2.0, 60.0)
            order = float(np.round(np.exp(rng.uniform(0.0, np.log(fastest)))))
            amplitude = np.sqrt(2) * wanted
            return Recipe((j,), {"amplitude": amplitude}, {"order": order, "phase": phase})
        case "spring":  # a coil or a counterbalance
            name = str(rng.choice(["stiffness", "moment"]))
            rest = float(q.mean() + rng.uniform(-0.5, 0.5))
            size = m.per(j, q - rest if name == "stiffness" else np.sin(q - rest))
            return Recipe((j,), {name: size}, {"rest": rest})
        case "encoder_offset":
            return Recipe((j,), {"offset": _sign(rng) * 0.05}, most=8.0)
        case "encoder_scale":
            return Recipe((j,), {"scale": _sign(rng) * 0.02}, most=4.0, around=1.0)
        case "telegraph_torque":
            return Recipe((j,), {"amplitude": wanted}, {"rate": rng.uniform(0.7, 3.0)})
        case _:
            return _inertial(m, rng, j)


def _coupled(kind: str, m: TypicalMotion, rng: Rng, j: int, k: int) -> Recipe:
    """A shaft that turns with both joints, or at most 60 % of a singular mass matrix."""
    sign = _sign(rng)
    if kind == "friction_coupling":
        share, dry = rng.uniform(0.3, 0.7), min(m.wanted[j], m.wanted[k])
        wet = dry / rms(m.dq[:, j] + sign * m.dq[:, k])
        return Recipe((j, k), {"Fv": share * wet, "Fc": (1 - share) * dry}, {"ratio": sign})
    own, size = m.inertia + m.rotor, min(m.per(j, m.ddq[:, k]), m.per(k, m.ddq[:, j]))
    return Recipe((j, k), {"Ic": sign * size}, most=0.6 * np.sqrt(own[j] * own[k]) / size)


def _gear(kind: str, m: TypicalMotion, rng: Rng, j: int) -> Recipe:
    """Backlash, or a gear softer with scale, down to a resonance of 3 Hz with the motor held."""
    elastic = kind == "joint_elasticity"
    resonance, damping = (12.0, rng.uniform(0.03, 0.1)) if elastic else (25.0, 0.15)
    k = m.inertia[j] * (2 * np.pi * resonance) ** 2
    gear = {"stiffness": k, "damping": 2 * damping * np.sqrt(k * m.inertia[j])}
    motor = {"motor": 0.0 if m.rotor[j] > 0 else 0.2 * float(m.inertia[j])}
    if not elastic:
        return Recipe((j,), {"gap": 0.01}, gear | motor, most=10.0)
    return Recipe((j,), gear, motor, most=16.0, powers={"stiffness": -1.0, "damping": -0.5})


def _inertial(m: TypicalMotion, rng: Rng, j: int) -> Recipe:
    """A link that is lighter or heavier throughout, or carries something beside its centre."""
    body = list(m.robot.model.inertias)[j + 1]
    mass, way = max(float(body.mass), 0.1), str(rng.choice(["lighter", "heavier", "beside"]))
    phi = body.toDynamicParameters()
    if way == "beside" or body.mass <= 0:
        lever = np.array(body.lever) + 0.1 * m.size * rng.uniform(-1, 1, 3)
        box = pin.Inertia.FromBox(mass, *(0.1 * m.size * rng.uniform(0.5, 1.5, 3)))
        phi = pin.Inertia(mass, lever, box.inertia).toDynamicParameters()
    sign, most = (-1.0, 0.6) if way == "lighter" else (1.0, 1.0)
    return Recipe((j,), dict(zip(STANDARD, sign * phi, strict=True)), guess=0.1, most=most)


def _wall(m: TypicalMotion, rng: Rng) -> Recipe:
    """Touched during a fifth to a third of the typical motion."""
    normal = rng.standard_normal(3) * (np.ptp(m.tip, axis=0) > 0.02 * m.size)
    normal /= max(float(np.linalg.norm(normal)), 1e-9)
    distance = float(np.quantile(m.tip @ normal, rng.uniform(0.67, 0.8)))
    k = float(m.wanted.max()) / (0.02 * m.size**2)
    place = dict(zip(("nx", "ny", "nz"), normal, strict=True)) | {"distance": distance}
    return Recipe((), {"stiffness": k, "damping": 0.01 * k}, place, 0.3, 50.0)


KINDS = (
    *("inertial_parameters", "payload", "gravity_direction", "viscous_friction"),
    *("coulomb_friction", "asymmetric_friction", "stribeck_friction", "nonlinear_viscous_friction"),
    *("load_dependent_friction", "presliding_hysteresis", "friction_coupling"),
    *("thermal_friction_drift", "rotor_inertia", "inertia_coupling", "torque_offset"),
    *("torque_gain", "torque_ripple", "spring", "joint_elasticity", "backlash", "time_delay"),
    *("encoder_offset", "encoder_scale", "kinematic_error", "unknown"),
)
"""Kinds of effects that `draw_effect` draws."""

_CUTOFF = 10.0  # Hz, of the zero-phase low-pass (Butterworth, fourth order)
_EDGE = 0.3  # s at either end where the filter has not settled
_STILL = 3e-3  # of the highest speed: a joint that stands
_DURATION = 6.0  # s of motion on which a drawn effect is measured
_PRECISION = 1.15  # to which a wanted size is met
_TRIALS, _DRAWS = 7, 16  # of scales, and of joints and shapes
_GROWTH = 3.0  # how much faster than its scale an effect may grow at most


@dataclass(frozen=True, eq=False)
class VisibleSize:
    """How strongly something hidden shows."""

    rms: Array  # filtered torque that it makes at the recorded motion, shape (nv,) [N·m]
    floor: Array  # what the torque noise leaves behind the filter, shape (nv,) [N·m]

    @property
    def size(self) -> float:
        """Largest ratio of all joints; infinite with sensors that tell the truth."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return float(np.where(self.rms > 0, self.rms / self.floor, 0.0).max())


def visible_size(arm: VirtualArm, trajectory: Trajectory, duration: float, rng: Rng) -> VisibleSize:
    """Torque that an arm's hidden effects make at the motion that is recorded with them.

    The arm is recorded without noise, then the same arm without the effects follows the recorded
    motion; the difference of the recorded torques is filtered. While a joint stands still its
    motion does not determine its torque, so no difference counts. The noise of the arm's sensors
    sets the floor.
    """
    without = plant(arm.bare, arm.nominal.joints, ())
    still = np.zeros_like(arm.sensors.torque_noise)
    true = Sensors(arm.sensors.rate_hz, 0.0, 0.0, still, still)
    table = replace(arm, sensors=true).record(trajectory, duration, rng)
    names = range(1, arm.nominal.nv + 1)
    t = table["t"].to_numpy(float)
    q, dq, tau = (table[[f"{c}{j}" for j in names]].to_numpy(float) for c in ("q", "dq", "tau"))
    expected = _torque_at(arm.nominal, without, t, q, true)
    still = np.abs(dq) < _STILL * np.abs(dq).max(axis=0)
    error = np.where(still, 0.0, tau - expected)
    edge, sections = int(_EDGE * arm.sensors.rate_hz), _filter(arm.sensors.rate_hz)
    inner = scipy.signal.sosfiltfilt(sections, error, axis=0)[edge:-edge]
    return VisibleSize(np.sqrt(np.mean(inner**2, axis=0)), _noise_floor(arm.sensors))


def _torque_at(robot: Robot, truth: Truth, t: Array, q: Array, sensors: Sensors) -> Array:
    """Recorded torque of an arm that follows sampled positions, its controller knowing it."""
    path = scipy.interpolate.CubicSpline(t, q, bc_type="clamped")

    def trajectory(at: Array, order: int = 0) -> Array:
        return np.asarray(path(at, order), dtype=np.float64)

    believed, quiet = Believed(truth.model, truth.drives), np.random.default_rng(0)
    run = simulate(robot, believed, truth, trajectory, float(t[-1]), sensors.rate_hz)
    table = recorded(run, sensors, truth.recorder, truth.drives.offset, quiet)
    return table[[f"tau{j + 1}" for j in range(robot.nv)]].to_numpy(float)


def _noise_floor(sensors: Sensors) -> Array:
    """What the torque noise leaves behind the filter."""
    _, H = scipy.signal.sosfreqz(_filter(sensors.rate_hz), 4096)
    noise = np.sqrt(sensors.torque_noise**2 + sensors.torque_resolution**2 / 12)
    return np.asarray(np.sqrt(np.mean(np.abs(H) ** 4)) * noise, dtype=np.float64)


def _filter(rate_hz: float) -> Array:
    return np.asarray(scipy.signal.butter(4, _CUTOFF, fs=rate_hz, output="sos"))


def draw_effect(
    robot: Robot,
    rng: Rng,
    kind: str,
    size: float,
    trajectory: Trajectory | None = None,
    duration: float = _DURATION,
) -> HiddenEffect:
    """Draw joints and parameters of a kind of effect, or of a structure of an unknown one.

    It shows as much as wanted, within 15 %, behind `industrial_sensors` on a motion from rest; on
    a random one when none is given.

    Raises:
        UnknownName: There is no such kind.
        BadInput: No joint of this arm can show so much of it.
    """
    if kind == "unknown":
        kind = str(rng.choice(STRUCTURES))
    UnknownName.refuse("kind of hidden effect", [kind], (*KINDS, *STRUCTURES))
    sensors = industrial_sensors(robot)
    if trajectory is None:
        trajectory = random_trajectory(robot, rng, duration, _HARMONICS)
    motion = typical_motion(robot, trajectory, duration, size * _noise_floor(sensors))

    def measure(effect: HiddenEffect) -> float:
        """Visible size on an arm that is otherwise nominal; huge where it fails."""
        rng = np.random.default_rng(0)
        arm = virtual_arm(robot, rng, hidden=(effect,), sensors=sensors, tolerance=0.0)
        try:
            return visible_size(arm, trajectory, duration, rng).size
        except BadInput:
            return 1e6

    for _ in range(_DRAWS):
        drawn = recipe(kind, motion, rng)
        found = _sized(drawn, partial(drawn.make, robot, kind), size, measure)
        if found is not None:
            return found
    raise BadInput(f"virtual arm: {robot.name} cannot show a {kind} of size {size:.3g}")


def _sized(
    recipe: Recipe,
    make: Callable[[float], HiddenEffect],
    size: float,
    measure: Callable[[HiddenEffect], float],
) -> HiddenEffect | None:
    """Effect of a recipe at the scale that shows as much as wanted; None beyond its bounds."""
    scale = min(recipe.guess, recipe.most)
    known: list[tuple[float, float]] = []
    for _ in range(_TRIALS):
        effect = make(scale)
        shown = max(measure(effect), 1e-9)
        if abs(np.log(shown / size)) < np.log(_PRECISION):
            return effect
        if shown * recipe.most / scale < size / _GROWTH or (scale >= recipe.most and shown < size):
            return None
        known.append((float(np.log(scale)), float(np.log(shown))))
        scale = min(_next_scale(known, float(np.log(size))), recipe.most)
    return None


def _next_scale(known: Sequence[tuple[float, float]], wanted: float) -> float:
    """Between the neighbours of the wanted size, all in logarithms; before, proportional."""
    below = max((k for k in known if k[1] < wanted), key=lambda k: k[1], default=None)
    above = min((k for k in known if k[1] >= wanted), key=lambda k: k[1], default=None)
    if below is None or above is None:
        return float(np.exp(known[-1][0] + np.clip(wanted - known[-1][1], -2.0, 2.0)))
    share = np.clip((wanted - below[1]) / (above[1] - below[1]), 0.1, 0.9)
    return float(np.exp(below[0] + share * (above[0] - below[0])))
