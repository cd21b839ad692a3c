"""Hidden effects of a wanted size: how strongly one shows, and drawing one that shows so much.

The *visible size* of what a virtual arm hides is the root mean square of the torque it makes, at
the motion that was recorded, behind the filter that identification uses, in units of what the
torque noise leaves behind the same filter. At 1 it drowns; 2 is just visible; 30 is plain.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
import scipy.interpolate
import scipy.signal

from excitant.exceptions import BadInput, UnknownName
from excitant.robots.motion import Array, freeze
from excitant.robots.parameters import STANDARD
from excitant.robots.plant.controller import Trajectory
from excitant.robots.plant.drawing import draw_payload, separable_rotors
from excitant.robots.plant.nominal import industrial_sensors, nominal_truth
from excitant.robots.plant.physics import Truth
from excitant.robots.plant.planting import STRUCTURES, HiddenEffect, plant
from excitant.robots.plant.run import simulate
from excitant.robots.plant.sensors import Sensors, recorded
from excitant.robots.robot import Robot
from excitant.robots.virtual_arm import VirtualArm, virtual_arm

_HARMONICS = 5
_SHARE = 0.7  # of the limits of velocity and acceleration, used at most
_REACH = 0.8  # of the range of position
_TORQUE = 0.7  # of the limits of torque


def typical_trajectory(robot: Robot, rng: np.random.Generator, duration: float) -> Trajectory:
    """A random periodic motion from rest to rest, within the limits of the nominal arm.

    q(t) = q_0 + Σ a_k (cos ω_k t − 1) with random a_k; drawn again, and smaller, while it asks
    for more than 70 % of a torque limit.

    Args:
        robot: The arm.
        rng: Source of randomness.
        duration: Period [s].
    """
    omega: Array = 2 * np.pi * np.arange(1.0, _HARMONICS + 1.0) / duration
    low, high = np.clip(robot.limits.position, -np.pi, np.pi).T
    speed = np.where(np.isfinite(robot.limits.velocity), robot.limits.velocity, 3.0)
    acceleration = np.where(np.isfinite(robot.limits.acceleration), robot.limits.acceleration, 20.0)
    t: Array = np.linspace(0.0, duration, 400)
    share = _SHARE
    for _ in range(40):
        a = rng.standard_normal((_HARMONICS, robot.nv)) / np.arange(1, _HARMONICS + 1)[:, None]
        spread = np.ptp(_cosines(omega, a, t, 0), axis=0)
        fastest, hardest = (np.abs(_cosines(omega, a, t, n)).max(axis=0) for n in (1, 2))
        a *= np.minimum.reduce(
            [
                _REACH * (high - low) / spread,
                share * np.minimum(speed, 4.0) / fastest,
                share * np.minimum(acceleration, 20.0) / hardest,
            ]
        )
        swing = _cosines(omega, a, t, 0)
        start = rng.uniform(low - swing.min(axis=0), high - swing.max(axis=0))
        trajectory = _path(start, omega, a)
        if _torque_share(robot, trajectory, t) <= _TORQUE:
            break
        share *= 0.93
    return trajectory


def _cosines(omega: Array, a: Array, t: Array, order: int) -> Array:
    phase = np.outer(t, omega) + order * np.pi / 2
    values: Array = (np.cos(phase) - (order == 0)) @ (omega[:, None] ** order * a)
    return values


def _path(start: Array, omega: Array, a: Array) -> Trajectory:
    def trajectory(t: Array, order: int = 0) -> Array:
        moved = _cosines(omega, a, np.asarray(t, dtype=float), order)
        return start + moved if order == 0 else moved

    return trajectory


def _torque_share(robot: Robot, trajectory: Trajectory, t: Array) -> float:
    truth = nominal_truth(robot)
    data, states = truth.model.createData(), [trajectory(t[::4], order) for order in range(3)]
    tau = truth.drives.friction(states[1])
    tau = tau + [pin.rnea(truth.model, data, *x) for x in zip(*states, strict=True)]
    return float(np.max(np.abs(tau) / robot.limits.torque))


@dataclass(frozen=True, eq=False)
class Habits:
    """A typical motion of an arm; arrays of samples have shape (n, nv).

    Attributes:
        robot: The nominal arm.
        q: Positions.
        dq: Velocities.
        ddq: Accelerations.
        tau: Torque of the nominal arm [N·m].
        load: The same without friction and rotors [N·m].
        tip: Positions of the tip in the base frame, shape (n, 3) [m].
        coulomb: Dry friction of the nominal arm, shape (nv,) [N·m].
        inertia: Mean of each joint's own entry of the mass matrix, shape (nv,) [kg·m²].
        rotor: Rotor inertia of the nominal arm, shape (nv,) [kg·m²].
        wanted: Torque that an effect should make, shape (nv,) [N·m].
    """

    robot: Robot
    q: Array
    dq: Array
    ddq: Array
    tau: Array
    load: Array
    tip: Array
    coulomb: Array
    inertia: Array
    rotor: Array
    wanted: Array

    def __post_init__(self) -> None:
        freeze(self, "q", "dq", "ddq", "tau", "load", "tip", "coulomb", "inertia", "rotor")
        freeze(self, "wanted")

    @property
    def nv(self) -> int:
        """Number of joints."""
        return self.robot.nv

    @property
    def size(self) -> float:
        """Longest distance of the tip from the origin on the motion, at least 0.1 m."""
        return max(float(np.linalg.norm(self.tip, axis=1).max()), 0.1)


def habits(robot: Robot, trajectory: Trajectory, duration: float, wanted: Array) -> Habits:
    """What an arm does on a motion.

    Args:
        robot: The nominal arm.
        trajectory: Its motion.
        duration: Length of the motion [s].
        wanted: Torque that an effect should make, shape (nv,) [N·m].
    """
    truth = nominal_truth(robot)
    model, bare, t = truth.model, truth.model.copy(), np.linspace(0.0, duration, 300)
    bare.armature = np.zeros(robot.nv)
    data, q, dq, ddq = model.createData(), *(trajectory(t, order) for order in range(3))
    tau, load, tip, inertia = (np.zeros((len(t), k)) for k in (robot.nv, robot.nv, 3, robot.nv))
    for k, state in enumerate(zip(q, dq, ddq, strict=True)):
        tau[k] = pin.rnea(model, data, *state) + truth.drives.friction(dq[k])
        load[k] = pin.rnea(bare, data, *state)
        inertia[k] = np.diag(pin.crba(bare, data, q[k]))
        pin.forwardKinematics(model, data, q[k])
        tip[k] = pin.updateFramePlacement(model, data, robot.tip).translation
    coulomb, rotor = truth.drives.coulomb, truth.drives.rotor
    mean = inertia.mean(axis=0)
    return Habits(robot, q, dq, ddq, tau, load, tip, coulomb, mean, rotor, wanted)


Rng = np.random.Generator
Make = Callable[[float], HiddenEffect]


@dataclass(frozen=True, eq=False)
class Recipe:
    """An effect that lacks only its size.

    Attributes:
        make: The effect at a scale.
        guess: Scale that may give what is wanted.
        most: Largest scale that such arms may have.
    """

    make: Make
    guess: float = 1.0
    most: float = np.inf


def rms(x: Array) -> float:
    """Root mean square, never zero."""
    return max(float(np.sqrt(np.mean(np.square(x)))), 1e-9)


def either_way(rng: Rng) -> float:
    """A sign by chance."""
    return float(rng.choice([-1.0, 1.0]))


def effect_on(kind: str, habit: Habits, *joints: int, **parameters: float) -> HiddenEffect:
    """The effect on joints by index, parameters as plain numbers."""
    names = tuple(habit.robot.joints[j] for j in joints)
    values = tuple((name, float(value)) for name, value in parameters.items())
    effect, structure = ("unknown", kind) if kind in STRUCTURES else (kind, "")
    first = names[0] if names else ""
    return HiddenEffect(effect, first, values, names if len(names) > 1 else (), structure)


def any_joint(habit: Habits, rng: Rng) -> int:
    """A joint by chance."""
    return int(rng.integers(habit.nv))


def neighbours(habit: Habits, rng: Rng) -> tuple[int, int]:
    """A joint and the next."""
    j = int(rng.integers(max(habit.nv - 1, 1)))
    return j, j + 1


def strong_joint(habit: Habits, rng: Rng) -> int:
    """A joint by chance that moves much: where elastic gears bend."""
    strong = np.flatnonzero(habit.inertia >= 0.1 * habit.inertia.max())
    return int(rng.choice(strong))


def one_or_all(habit: Habits, rng: Rng) -> tuple[int, ...]:
    """A joint by chance, or one time in four all of them."""
    return tuple(range(habit.nv)) if rng.random() < 0.25 else (any_joint(habit, rng),)


def _viscous(habit: Habits, rng: Rng) -> Recipe:
    j = any_joint(habit, rng)
    size = habit.wanted[j] / rms(habit.dq[:, j])
    return Recipe(lambda s: effect_on("viscous_friction", habit, j, Fv=s * size))


def _coulomb(habit: Habits, rng: Rng) -> Recipe:
    j = any_joint(habit, rng)
    return Recipe(lambda s: effect_on("coulomb_friction", habit, j, Fc=s * habit.wanted[j]))


def _asymmetric(habit: Habits, rng: Rng) -> Recipe:
    """More friction in one direction, of both kinds."""
    j, side, share = (
        any_joint(habit, rng),
        str(rng.choice(["plus", "minus"])),
        rng.uniform(0.3, 0.7),
    )
    dry = habit.wanted[j]
    wet = dry / rms(habit.dq[:, j])

    def make(s: float) -> HiddenEffect:
        values = {f"Fc_{side}": s * (1 - share) * dry, f"Fv_{side}": s * share * wet}
        return effect_on("asymmetric_friction", habit, j, **values)

    return Recipe(make, 1.4)


def _stribeck(habit: Habits, rng: Rng) -> Recipe:
    j, slow = any_joint(habit, rng), rng.uniform(0.05, 0.2)
    v = slow * float(np.abs(habit.dq[:, j]).max())
    return Recipe(
        lambda s: effect_on("stribeck_friction", habit, j, Fs=s * habit.wanted[j], velocity=v), 3.0
    )


def _power_law(habit: Habits, rng: Rng) -> Recipe:
    j = any_joint(habit, rng)
    a = float(rng.choice([rng.uniform(0.3, 0.6), rng.uniform(1.6, 2.0)]))
    size = habit.wanted[j] / rms(np.abs(habit.dq[:, j]) ** a)
    return Recipe(
        lambda s: effect_on("nonlinear_viscous_friction", habit, j, Fn=s * size, exponent=a)
    )


def _load_dependent(habit: Habits, rng: Rng) -> Recipe:
    j = any_joint(habit, rng)
    size = habit.wanted[j] / rms(habit.load[:, j])
    return Recipe(
        lambda s: effect_on("load_dependent_friction", habit, j, Fl=s * size), most=0.3 / size
    )


def _presliding(habit: Habits, rng: Rng) -> Recipe:
    """At most one and a half times the dry friction there is, so that the hysteresis shows."""
    j, x = any_joint(habit, rng), float(np.exp(rng.uniform(np.log(0.01), np.log(0.15))))
    size = habit.wanted[j]
    most = 1.5 * habit.coulomb[j] if habit.coulomb[j] > 0 else 0.5 * rms(habit.tau[:, j])
    return Recipe(
        lambda s: effect_on("presliding_hysteresis", habit, j, Fh=s * size, distance=x),
        3.0,
        most / size,
    )


def _coupled_friction(habit: Habits, rng: Rng) -> Recipe:
    """A shaft that turns with the sum or difference of neighbouring joints."""
    j, k = neighbours(habit, rng)
    ratio, share = either_way(rng), rng.uniform(0.3, 0.7)
    dry = min(habit.wanted[j], habit.wanted[k])
    wet = dry / rms(habit.dq[:, j] + ratio * habit.dq[:, k])
    return Recipe(
        lambda s: effect_on(
            "friction_coupling",
            habit,
            j,
            k,
            Fv=s * share * wet,
            Fc=s * (1 - share) * dry,
            ratio=ratio,
        )
    )


def _thermal(habit: Habits, rng: Rng) -> Recipe:
    j, share, time = any_joint(habit, rng), rng.uniform(0.3, 0.7), rng.uniform(6.0, 25.0)
    dry = habit.wanted[j]
    wet = dry / rms(habit.dq[:, j])
    return Recipe(
        lambda s: effect_on(
            "thermal_friction_drift",
            habit,
            j,
            Fv=s * share * wet,
            Fc=s * (1 - share) * dry,
            time=time,
        ),
        1.3,
    )


def _rotor(habit: Habits, rng: Rng) -> Recipe:
    """Only where no inertia of the links can pass for it."""
    j = habit.robot.joint_index(str(rng.choice(separable_rotors(habit.robot))))
    size = habit.wanted[j] / rms(habit.ddq[:, j])
    return Recipe(lambda s: effect_on("rotor_inertia", habit, j, Ia=s * size))


def _coupled_rotors(habit: Habits, rng: Rng) -> Recipe:
    """At most 60 % of what would make the mass matrix singular."""
    j, k = neighbours(habit, rng)
    sign, own = either_way(rng), habit.inertia + habit.rotor
    size = min(habit.wanted[j] / rms(habit.ddq[:, k]), habit.wanted[k] / rms(habit.ddq[:, j]))
    most = 0.6 * np.sqrt(own[j] * own[k]) / size
    return Recipe(
        lambda s: effect_on("inertia_coupling", habit, j, k, Ic=s * sign * size), 1.0, most
    )


def _offset(habit: Habits, rng: Rng) -> Recipe:
    j, sign = any_joint(habit, rng), either_way(rng)
    return Recipe(lambda s: effect_on("torque_offset", habit, j, offset=s * sign * habit.wanted[j]))


def _gain(habit: Habits, rng: Rng) -> Recipe:
    joints, sign = one_or_all(habit, rng), either_way(rng)
    size = min(habit.wanted[j] / rms(habit.tau[:, j]) for j in joints)
    return Recipe(
        lambda s: effect_on("torque_gain", habit, *joints, gain=1 + s * sign * size),
        1.0,
        0.4 / size,
    )


def _ripple(habit: Habits, rng: Rng) -> Recipe:
    """Orders up to 60, and slow enough at typical speed to pass the filter."""
    j, phase = any_joint(habit, rng), rng.uniform(-np.pi, np.pi)
    fastest = np.clip(2 * np.pi * 6.0 / rms(habit.dq[:, j]), 2.0, 60.0)
    order = float(np.round(np.exp(rng.uniform(0.0, np.log(fastest)))))
    size = np.sqrt(2) * habit.wanted[j]
    return Recipe(
        lambda s: effect_on("torque_ripple", habit, j, amplitude=s * size, order=order, phase=phase)
    )


def _spring(habit: Habits, rng: Rng) -> Recipe:
    """A coil or a counterbalance."""
    j, name = any_joint(habit, rng), str(rng.choice(["stiffness", "moment"]))
    rest = float(habit.q[:, j].mean() + rng.uniform(-0.5, 0.5))
    bent = habit.q[:, j] - rest
    size = habit.wanted[j] / rms(bent if name == "stiffness" else np.sin(bent))
    return Recipe(lambda s: effect_on("spring", habit, j, **{name: s * size}, rest=rest))


def _elasticity(habit: Habits, rng: Rng) -> Recipe:
    """Softer with scale, down to a resonance of 3 Hz with the motor held."""
    j, damping, motor = strong_joint(habit, rng), rng.uniform(0.03, 0.1), 0.0
    inertia = habit.inertia[j]
    if habit.rotor[j] <= 0:
        motor = 0.2 * inertia
    stiff = inertia * (2 * np.pi * 12.0) ** 2

    def make(s: float) -> HiddenEffect:
        k = stiff / s
        c = 2 * damping * np.sqrt(k * inertia)
        return effect_on("joint_elasticity", habit, j, stiffness=k, damping=c, motor=motor)

    return Recipe(make, 1.0, 16.0)


def _backlash(habit: Habits, rng: Rng) -> Recipe:
    j = strong_joint(habit, rng)
    inertia = habit.inertia[j]
    stiff = inertia * (2 * np.pi * 25.0) ** 2
    motor = 0.0 if habit.rotor[j] > 0 else 0.2 * inertia
    c = 0.3 * np.sqrt(stiff * inertia)

    def make(s: float) -> HiddenEffect:
        return effect_on(
            "backlash", habit, j, gap=0.01 * s, stiffness=stiff, damping=c, motor=motor
        )

    return Recipe(make, 1.0, 10.0)


def _delay(habit: Habits, rng: Rng) -> Recipe:
    """Of the torque or of the position."""
    joints, sign = one_or_all(habit, rng), either_way(rng)
    return Recipe(
        lambda s: effect_on("time_delay", habit, *joints, delay=s * sign * 0.01), 1.0, 6.0
    )


def _encoder_offset(habit: Habits, rng: Rng) -> Recipe:
    j, sign = any_joint(habit, rng), either_way(rng)
    return Recipe(lambda s: effect_on("encoder_offset", habit, j, offset=s * sign * 0.05), 1.0, 8.0)


def _encoder_scale(habit: Habits, rng: Rng) -> Recipe:
    j, sign = any_joint(habit, rng), either_way(rng)
    return Recipe(
        lambda s: effect_on("encoder_scale", habit, j, scale=1 + s * sign * 0.02), 1.0, 4.0
    )


def _kinematic(habit: Habits, rng: Rng) -> Recipe:
    """A joint that is not where the drawing says; never the first."""
    j = int(rng.integers(min(1, habit.nv - 1), habit.nv))
    d = rng.standard_normal(3)
    d *= 0.03 * habit.size / np.linalg.norm(d)
    return Recipe(
        lambda s: effect_on("kinematic_error", habit, j, dx=s * d[0], dy=s * d[1], dz=s * d[2]),
        1.0,
        6.0,
    )


def _tilt(habit: Habits, rng: Rng) -> Recipe:
    way = rng.uniform(-np.pi, np.pi)
    return Recipe(
        lambda s: effect_on(
            "gravity_direction", habit, roll=0.03 * s * np.cos(way), pitch=0.03 * s * np.sin(way)
        ),
        1.0,
        10.0,
    )


def _inertial(habit: Habits, rng: Rng) -> Recipe:
    """A link that is lighter or heavier throughout, or carries something beside its centre."""
    j = any_joint(habit, rng)
    body = list(habit.robot.model.inertias)[j + 1]
    mass, way = max(float(body.mass), 0.1), str(rng.choice(["lighter", "heavier", "beside"]))
    phi = body.toDynamicParameters()
    if way == "beside" or body.mass <= 0:
        lever = np.array(body.lever) + 0.1 * habit.size * rng.uniform(-1, 1, 3)
        box = pin.Inertia.FromBox(mass, *(0.1 * habit.size * rng.uniform(0.5, 1.5, 3)))
        phi = pin.Inertia(mass, lever, box.inertia).toDynamicParameters()
    sign, most = (-1.0, 0.6) if way == "lighter" else (1.0, 1.0)

    def make(s: float) -> HiddenEffect:
        values = dict(zip(STANDARD, (s * sign * phi).tolist(), strict=True))
        return effect_on("inertial_parameters", habit, j, **values)

    return Recipe(make, 0.1, most)


def _payload(habit: Habits, rng: Rng) -> Recipe:
    drawn = draw_payload(habit.robot, rng)

    def make(s: float) -> HiddenEffect:
        values = {name: s * value for name, value in drawn.parameters}
        return effect_on("payload", habit, habit.nv - 1, **values)

    return Recipe(make, 0.3, 3.0)


def _wall(habit: Habits, rng: Rng) -> Recipe:
    """Touched during a fifth to a third of the typical motion."""
    normal = rng.standard_normal(3) * (np.ptp(habit.tip, axis=0) > 0.02 * habit.size)
    normal /= max(float(np.linalg.norm(normal)), 1e-9)
    distance = float(np.quantile(habit.tip @ normal, rng.uniform(0.67, 0.8)))
    k = float(habit.wanted.max()) / (0.02 * habit.size**2)
    n = dict(zip(("nx", "ny", "nz"), normal.tolist(), strict=True))

    def make(s: float) -> HiddenEffect:
        return effect_on(
            "wall_contact", habit, **n, distance=distance, stiffness=s * k, damping=0.01 * s * k
        )

    return Recipe(make, 0.3, 50.0)


def _cable(habit: Habits, rng: Rng) -> Recipe:
    """Guided beside or above the base; its friction is half its tension."""
    place = rng.standard_normal(3)
    place *= habit.size * rng.uniform(0.4, 0.9) / np.linalg.norm(place)
    pull = float(habit.wanted.max()) / (0.5 * habit.size)
    x = dict(zip(("x", "y", "z"), place.tolist(), strict=True))

    def make(s: float) -> HiddenEffect:
        return effect_on(
            "cable_pull",
            habit,
            **x,
            tension=s * pull,
            friction=0.5 * s * pull,
            distance=0.02 * habit.size,
        )

    return Recipe(make, 1.0)


def _telegraph(habit: Habits, rng: Rng) -> Recipe:
    j, rate = any_joint(habit, rng), rng.uniform(0.7, 3.0)
    return Recipe(
        lambda s: effect_on("telegraph_torque", habit, j, amplitude=s * habit.wanted[j], rate=rate)
    )


def _crosstalk(habit: Habits, rng: Rng) -> Recipe:
    """From a joint that is not a neighbour, where there is one."""
    j, k = (int(i) for i in rng.choice(habit.nv, 2, replace=False))
    if abs(j - k) < 2 and habit.nv > 2:
        k = (j + 2) % habit.nv
    size = habit.wanted[j] / rms(habit.tau[:, k])
    sign = either_way(rng)
    return Recipe(
        lambda s: effect_on("sensor_crosstalk", habit, j, k, gain=s * sign * size), 1.0, 0.6 / size
    )


def _wrong_sign(habit: Habits, rng: Rng) -> Recipe:
    j, torque = any_joint(habit, rng), rng.random() < 0.5
    values = {"tau": -1.0} if torque else {"q": -1.0, "dq": -1.0}
    return Recipe(lambda s: effect_on("wrong_sign", habit, j, **values))


def _wrong_unit(habit: Habits, rng: Rng) -> Recipe:
    """Degrees for radians, or N·mm for N·m, in all columns."""
    degrees = 180 / np.pi
    torque = rng.random() < 0.3
    values = {"tau": 1000.0} if torque else {"q": degrees, "dq": degrees}
    return Recipe(lambda s: effect_on("wrong_unit", habit, **values))


RECIPES: dict[str, Callable[[Habits, Rng], Recipe]] = {
    "inertial_parameters": _inertial,
    "payload": _payload,
    "gravity_direction": _tilt,
    "viscous_friction": _viscous,
    "coulomb_friction": _coulomb,
    "asymmetric_friction": _asymmetric,
    "stribeck_friction": _stribeck,
    "nonlinear_viscous_friction": _power_law,
    "load_dependent_friction": _load_dependent,
    "presliding_hysteresis": _presliding,
    "friction_coupling": _coupled_friction,
    "thermal_friction_drift": _thermal,
    "rotor_inertia": _rotor,
    "inertia_coupling": _coupled_rotors,
    "torque_offset": _offset,
    "torque_gain": _gain,
    "torque_ripple": _ripple,
    "spring": _spring,
    "joint_elasticity": _elasticity,
    "backlash": _backlash,
    "time_delay": _delay,
    "encoder_offset": _encoder_offset,
    "encoder_scale": _encoder_scale,
    "kinematic_error": _kinematic,
    "wall_contact": _wall,
    "cable_pull": _cable,
    "telegraph_torque": _telegraph,
    "sensor_crosstalk": _crosstalk,
    "wrong_sign": _wrong_sign,
    "wrong_unit": _wrong_unit,
}
"""How each kind is drawn."""

FAULTS = ("wrong_sign", "wrong_unit")
"""Data faults that can be planted; they have no size."""
KINDS = (*(kind for kind in RECIPES if kind not in (*STRUCTURES, *FAULTS)), "unknown")
"""Kinds of effects that `draw_effect` draws."""

_CUTOFF = 10.0  # Hz
_EDGE = 0.3  # s at either end where the filter has not settled
_STILL = 3e-3  # of the highest speed: a joint that stands
_DURATION = 6.0  # s of motion on which a drawn effect is measured
_PRECISION = 1.15  # to which a wanted size is met
_TRIALS, _DRAWS = 7, 16  # of scales, and of joints and shapes
_GROWTH = 3.0  # how much faster than its scale an effect may grow at most
_SMALLEST, _LARGEST = 2.0, 30.0  # visible sizes drawn


@dataclass(frozen=True, eq=False)
class VisibleSize:
    """How strongly something hidden shows.

    Attributes:
        rms: Filtered torque that it makes at the recorded motion, shape (nv,) [N·m].
        floor: What the torque noise leaves behind the filter, shape (nv,) [N·m].
    """

    rms: Array
    floor: Array

    def __post_init__(self) -> None:
        freeze(self, "rms", "floor")

    @property
    def ratio(self) -> Array:
        """Rms over floor, shape (nv,); infinite with sensors that tell the truth."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(self.rms > 0, self.rms / self.floor, 0.0)

    @property
    def size(self) -> float:
        """Largest ratio of all joints."""
        return float(self.ratio.max())


def visible_size(
    arm: VirtualArm,
    trajectory: Trajectory,
    duration: float,
    rng: np.random.Generator,
    effects: Sequence[HiddenEffect] | None = None,
    cutoff_hz: float = _CUTOFF,
) -> VisibleSize:
    """Torque that hidden effects make at the motion that is recorded with them.

    The arm is recorded without noise, then the same arm without the effects follows the recorded
    motion; the difference of what is recorded as torque is filtered. While a joint stands still
    its motion does not determine its torque, so no difference counts.

    Args:
        arm: The virtual arm; its sensors' noise sets the floor.
        trajectory: Desired motion; starts at rest.
        duration: Length of the run [s].
        rng: Decides what chance decides in the run.
        effects: The hidden effects to measure, beside which the others stay; all when not given.
        cutoff_hz: Cut-off of the zero-phase low-pass (Butterworth, fourth order) [Hz].
    """
    chosen = arm.hidden if effects is None else tuple(effects)
    kept = [effect for effect in arm.hidden if effect not in chosen]
    without = plant(arm.bare, arm.nominal.joints, kept)
    true = _noiseless(arm.sensors)
    table = replace(arm, sensors=true).record(trajectory, duration, rng)
    names = range(1, arm.nominal.nv + 1)
    t = table["t"].to_numpy(float)
    q, dq, tau = (table[[f"{c}{j}" for j in names]].to_numpy(float) for c in ("q", "dq", "tau"))
    expected = _torque_at(arm.nominal, without, t, q, true)
    still = np.abs(dq) < _STILL * np.abs(dq).max(axis=0)
    error = np.where(still, 0.0, tau - expected)
    rms = _filtered_rms(error, arm.sensors.rate_hz, cutoff_hz)
    return VisibleSize(rms, _noise_floor(arm.sensors, cutoff_hz))


def _noiseless(sensors: Sensors) -> Sensors:
    still = np.zeros_like(sensors.torque_noise)
    return replace(
        sensors,
        position_resolution=0.0,
        velocity_noise=0.0,
        torque_noise=still,
        torque_resolution=still,
        velocity="tachometer",
    )


def _torque_at(robot: Robot, truth: Truth, t: Array, q: Array, sensors: Sensors) -> Array:
    """Recorded torque of an arm that follows sampled positions, its controller knowing it."""
    path = scipy.interpolate.CubicSpline(t, q, bc_type="clamped")

    def trajectory(at: Array, order: int = 0) -> Array:
        return np.asarray(path(at, order), dtype=np.float64)

    believed, fine = (truth.model, truth.drives), bool(np.isfinite(sensors.torque_cutoff_hz))
    rate, quiet = sensors.rate_hz, np.random.default_rng(0)
    run = simulate(robot, believed, truth, trajectory, float(t[-1]), rate, fine=fine)
    table = recorded(run, sensors, truth.recorder, truth.drives.offset, quiet)
    return table[[f"tau{j + 1}" for j in range(robot.nv)]].to_numpy(float)


def _filtered_rms(error: Array, rate_hz: float, cutoff_hz: float) -> Array:
    """Root mean square behind the filter, away from the edges."""
    sections = scipy.signal.butter(4, cutoff_hz, fs=rate_hz, output="sos")
    edge = int(_EDGE * rate_hz)
    inner = scipy.signal.sosfiltfilt(sections, error, axis=0)[edge:-edge]
    return np.asarray(np.sqrt(np.mean(inner**2, axis=0)), dtype=np.float64)


def _noise_floor(sensors: Sensors, cutoff_hz: float) -> Array:
    """What the torque noise leaves behind the filter."""
    sections = scipy.signal.butter(4, cutoff_hz, fs=sensors.rate_hz, output="sos")
    _, H = scipy.signal.sosfreqz(sections, 4096)
    noise = np.sqrt(sensors.torque_noise**2 + sensors.torque_resolution**2 / 12)
    return np.asarray(np.sqrt(np.mean(np.abs(H) ** 4)) * noise, dtype=np.float64)


def draw_effect(
    robot: Robot,
    rng: np.random.Generator,
    kind: str | None = None,
    size: float | None = None,
    sensors: Sensors | None = None,
    trajectory: Trajectory | None = None,
    duration: float = _DURATION,
) -> HiddenEffect:
    """Draw a hidden effect: its kind, its joints and its parameters.

    Args:
        robot: The nominal arm.
        rng: Source of randomness.
        kind: Name of an effect, a structure of an unknown one, or a data fault; any of `KINDS`
            when not given.
        size: Wanted visible size, met within 15 %; when not given one between 2 and 30, or the
            next smaller one that the arm can show. Data faults have none.
        sensors: Their torque noise sets the floor; `industrial_sensors` when not given.
        trajectory: Motion that the size holds for, from rest; a typical one when not given.
        duration: Length of that motion [s].

    Raises:
        UnknownName: There is no such kind.
        BadInput: No joint of this arm can show so much of it.
    """
    kind = kind or str(rng.choice(KINDS))
    if kind == "unknown":
        kind = str(rng.choice(STRUCTURES))
    if kind not in RECIPES:
        raise UnknownName("kind of hidden effect", kind, (*RECIPES, "unknown"))
    sensors = sensors or industrial_sensors(robot)
    if trajectory is None:
        trajectory = typical_trajectory(robot, rng, duration)
    sizes = [size] if size else _sizes(rng)
    habit = habits(robot, trajectory, duration, sizes[0] * _noise_floor(sensors, _CUTOFF))
    if kind in FAULTS:
        return RECIPES[kind](habit, rng).make(1.0)

    def measure(effect: HiddenEffect) -> float:
        return _shown(robot, effect, sensors, trajectory, duration)

    for wanted in sizes:
        for _ in range(_DRAWS):
            found = _sized(RECIPES[kind](habit, rng), wanted, measure)
            if found is not None:
                return found
    raise BadInput(f"virtual arm: {robot.name} cannot show a {kind} of size {sizes[-1]:.3g}")


def _sizes(rng: np.random.Generator) -> list[float]:
    """A size by chance, and smaller ones for what no joint can show so much of."""
    size = float(np.exp(rng.uniform(np.log(_SMALLEST), np.log(_LARGEST))))
    return [max(size * share, _SMALLEST) for share in (1.0, 0.4, 0.1)]


def _shown(
    robot: Robot,
    effect: HiddenEffect,
    sensors: Sensors,
    trajectory: Trajectory,
    duration: float,
) -> float:
    """Visible size of one effect on an arm that is otherwise nominal; huge where it fails."""
    rng = np.random.default_rng(0)
    arm = virtual_arm(robot, rng, hidden=(effect,), sensors=sensors, tolerance=0.0)
    try:
        return visible_size(arm, trajectory, duration, rng).size
    except BadInput:
        return 1e6


def _sized(
    recipe: Recipe, size: float, measure: Callable[[HiddenEffect], float]
) -> HiddenEffect | None:
    """Effect of a recipe at the scale that shows as much as wanted; None beyond its bounds."""
    scale = min(recipe.guess, recipe.most)
    known: list[tuple[float, float]] = []
    for _ in range(_TRIALS):
        effect = recipe.make(scale)
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
