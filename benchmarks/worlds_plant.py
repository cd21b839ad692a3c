"""Arms of MuJoCo with effects in closed form, and how what they hide is drawn.

Nothing of the plant is excitant's: rigid bodies are MuJoCo's (`mj_inverse`), everything else is
numpy. excitant only loads the arm and holds its parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
import scipy
from arms import ARMS as OTHERS
from arms import data_folder, with_assumed_limits

from excitant.exceptions import ExcitantError
from excitant.robots import Robot, load_robot
from excitant.robots.effects import CoulombFriction, Effect, ViscousFriction, effect_values
from excitant.robots.motion import Array
from excitant.robots.parameters import from_pseudo_inertia, pseudo_inertia

SHIPPED = ("ur10", "panda", "puma560")
DURATION = 15.0  # of each motion [s]
SIZES = (0.03, 0.4)  # of an effect's torque to its joint's, rms
SLIDING = 1e-3  # speed below which dry friction grows with speed [rad/s]
LONGEST, DRAWS = 0.06, 20  # of the delays [s]; of an effect, until it shows
GIVES = {"joint_elasticity": (1e-3, 2e-2), "backlash": (1e-3, 1e-2)}  # at rms torque; play [rad]
FLANK = 0.3  # what flanks give at rms torque, of the play
DAMPING, FLANK_DAMPING = 0.1, 0.5  # of elastic gears and of flanks, relative to critical damping
STEP, SETTLING = 1e-3, 0.5  # of the integration of links behind gears [s]
READING = 8  # of these steps, over which drives average: knocks of flanks are shorter

FRICTION = ("coulomb_friction", "viscous_friction")
BODIES = ("inertial_parameters", "payload")
KINDS = (
    *(*FRICTION, "stribeck_friction", "asymmetric_friction", "load_dependent_friction"),
    *("torque_offset", "spring", "torque_ripple", "rotor_inertia", "friction_coupling"),
    *("torque_gain", "time_delay", "encoder_offset", "gravity_direction", *BODIES),
    *("nonlinear_viscous_friction", "presliding_hysteresis", "thermal_friction_drift"),
    *("inertia_coupling", "kinematic_error", "motor_saturation"),
    *("encoder_scale", "encoder_eccentricity", "joint_elasticity", "backlash", "gradual_reversal"),
)
REVERSALS = ("presliding_hysteresis", "gradual_reversal")  # of the known dry friction
SET_UPS = ("mounting", "torque sign", "joint sign", "swapped", "zero position", "degrees")
STRUCTURES = ("hose", "bumper", "swaying table")

Rng = np.random.Generator
Trajectory = Callable[..., Array]
Edit = Callable[[Array, Array], tuple[Array, Array]]


@dataclass(frozen=True, eq=False)
class State:
    """True motion and rigid-body torque at instants: t (n,), the others (n, nv), in SI units."""

    t: Array
    q: Array
    dq: Array
    ddq: Array
    rigid: Array
    at: Callable[[Array], State]  # the same motion at other instants


Shape = Callable[[State], Array]
"""Torque of one joint, (n,), or of all, (n, nv), up to a factor."""


@dataclass(frozen=True, eq=False)
class Plant:
    """The true arm; motions are those that its encoders read."""

    robot: Robot  # true bodies and gravity, without effects
    viscous: Array
    coulomb: Array
    laws: tuple[tuple[Shape, Array], ...] = ()  # with the factor for each joint
    gain: Array | float = 1.0  # of the readings of torque
    delay: Array | float = 0.0  # of these [s]
    offset: Array | float = 0.0  # true position less reading [rad]
    scale: Array | float = 1.0  # true motion over reading
    level: Array | float = np.inf  # at which readings of torque stay
    eccentricity: Array | complex = 0.0  # true position less reading: real part of it times e^(iq)
    play: Array | float = 0.0  # of gears, from flank to flank [rad]
    compliance: Array | float = 0.0  # of these [rad/(N·m)]; motors bear friction and rotors
    edit: Edit = lambda q, tau: (q, tau)  # of what was recorded

    @cached_property
    def model(self) -> Any:
        """MuJoCo's model of the bodies alone, each a child of the one that carries it."""
        spec, arm = mujoco.MjSpec(), self.robot.model
        spec.option.gravity = self.robot.gravity
        spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
        bodies = [spec.worldbody]
        for k, values in enumerate(self.robot.phi.reshape(-1, 10), start=1):
            place, inertia = arm.jointPlacements[k], pin.Inertia.FromDynamicParameters(values)
            turned = pin.Quaternion(place.rotation)
            body = bodies[arm.parents[k]].add_body(
                pos=place.translation,
                quat=[turned.w, turned.x, turned.y, turned.z],
                mass=inertia.mass,
                ipos=inertia.lever,
                fullinertia=inertia.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]],
                explicitinertial=True,
            )
            slide, turn = np.split(np.ravel(arm.joints[k].createData().S), 2)
            kind = mujoco.mjtJoint.mjJNT_SLIDE if slide.any() else mujoco.mjtJoint.mjJNT_HINGE
            body.add_joint(type=kind, axis=slide + turn)
            bodies.append(body)
        return spec.compile()

    def motors(self, motion: Trajectory, t: Array) -> Array:
        """True positions, velocities and accelerations of motors, (3, n, nv)."""
        q, dq, ddq = (self.scale * motion(t, order) for order in range(3))
        off = self.eccentricity * np.exp(1j * q)
        turns = 1 - off.imag
        return np.array([q + self.offset + off.real, dq * turns, ddq * turns - off.real * dq**2])

    def state(self, motion: Trajectory, t: Array) -> State:
        """The true motion of motors, and what torque the rigid bodies need by MuJoCo."""
        motors, data = self.motors(motion, t), mujoco.MjData(self.model)
        rigid = np.empty_like(motors[0])
        for k, state in enumerate(np.moveaxis(motors - self.lag(motion, t), 1, 0)):
            data.qpos, data.qvel, data.qacc = state
            mujoco.mj_inverse(self.model, data)
            rigid[k] = data.qfrc_inverse
        return State(t, *motors, rigid, lambda other: self.state(motion, other))

    def lag(self, motion: Trajectory, t: Array) -> Array:
        """How far, how fast and how much faster links fall behind their motors, (3, n, nv).

        The lag x of a link whose gear gives obeys τ(x'') = k (x beyond play) + d x', with τ what
        the links need for their motion; steps are implicit in x of the gear and x'' of the link.
        """
        give, play = (x + 0 * self.viscous for x in (self.compliance, self.play))
        some, half = np.flatnonzero(give).tolist(), (play / 2).tolist()
        if not some:
            return np.zeros((3, len(t), len(give)))
        fine = np.arange(t[0] - SETTLING, t[-1] + 2 * STEP, STEP)
        states, data = np.moveaxis(self.motors(motion, fine), 1, 0), mujoco.MjData(self.model)
        M, path = np.empty((len(give), len(give))), np.zeros((len(fine) + 1, 3, len(give)))
        data.qpos, data.qvel, data.qacc = states[0]
        mujoco.mj_inverse(self.model, data)
        path[0, 0] = (give * data.qfrc_inverse + play / 2 * np.sign(data.qfrc_inverse)) * (give > 0)
        for k, state in enumerate(states):
            data.qpos, data.qvel, data.qacc = state - path[k]
            mujoco.mj_inverse(self.model, data)
            mujoco.mj_fullM(self.model, data, M)
            for j in some:
                x, v, a = path[k, :, j].tolist()
                m, needed = M[j, j], data.qfrc_inverse[j] + M[j, j] * a
                beyond = x - max(-half[j], min(half[j], x))
                stiff = bool(beyond) / give[j]
                damped = 2 * (FLANK_DAMPING if half[j] else DAMPING) * np.sqrt(m * stiff)
                force = needed - beyond / give[j] - (damped + STEP * stiff) * v
                path[k, 2, j] = a = force / (m + STEP * damped + STEP**2 * stiff)
                v += STEP * a
                path[k + 1, :, j] = x + STEP * v, v, a
        means = scipy.ndimage.uniform_filter1d(path[:-1], READING, axis=0)
        return np.moveaxis(scipy.interpolate.make_interp_spline(fine, means, 1)(t), 1, 0)

    def now(self, motion: Trajectory, t: Array) -> Array:
        """Torque with friction and all laws, (n, nv)."""
        s = self.state(motion, t)
        tau = s.rigid + self.viscous * s.dq + self.coulomb * sign(s.dq)
        for shape, factors in self.laws:
            tau = tau + np.atleast_2d(shape(s).T).T * factors
        return tau

    def torque(self, motion: Trajectory, t: Array) -> Array:
        """Torque as it is read, without noise, (n, nv)."""
        delay = np.broadcast_to(self.delay, self.viscous.shape)
        tau = np.empty((len(t), len(delay)))
        for each in np.unique(delay):
            tau[:, delay == each] = self.now(motion, t - each)[:, delay == each]
        return np.clip(self.gain * tau, -np.asarray(self.level), self.level)


@dataclass(frozen=True, eq=False)
class Hidden:
    """What a plant has and the given model has not."""

    kind: str  # as drawn
    effect: str  # as findings call it
    joints: tuple[str, ...]
    parameters: dict[str, Any] = field(default_factory=dict)
    size: float = float("nan")  # largest rms of its torque relative to that of its joint


def sign(x: Array) -> Array:
    return np.tanh(x / SLIDING)


def rms(x: Array) -> Array:
    return np.sqrt(np.mean(np.square(x), axis=0))


LAWS: dict[str, Callable[[State, int], Array]] = {  # without parameters
    "viscous_friction": lambda s, j: s.dq[:, j],
    "coulomb_friction": lambda s, j: sign(s.dq[:, j]),
    "load_dependent_friction": lambda s, j: np.abs(s.rigid[:, j]) * sign(s.dq[:, j]),
    "torque_offset": lambda s, j: np.ones(len(s.t)),
    "rotor_inertia": lambda s, j: s.ddq[:, j],
}


def joint_law(
    kind: str, rng: Rng, q: Array, dq: Array, joints: Sequence[int]
) -> tuple[Shape, dict[str, float]]:
    """Torque of an effect of joints up to a factor, in closed form, from a typical motion."""
    j, identity = joints[-1], np.eye(dq.shape[1])
    if kind in LAWS:
        return lambda s: LAWS[kind](s, j), {}
    fastest, middle = float(np.abs(dq[:, j]).max()), float(q[:, j].mean())
    p: dict[str, float] = {}
    match kind:
        case "stribeck_friction":  # beside the known Fc: (Fs - Fc) exp(-(v/vs)²)
            p["vs"] = vs = rng.uniform(0.03, 0.2) * fastest
            return lambda s: sign(s.dq[:, j]) * np.exp(-((s.dq[:, j] / vs) ** 2)), p
        case "asymmetric_friction":
            p["side"] = side = float(rng.choice([-1, 1]))
            return lambda s: sign(s.dq[:, j]) * (side * s.dq[:, j] > 0), p
        case "nonlinear_viscous_friction":
            p["exponent"] = a = rng.choice([rng.uniform(0.3, 0.6), rng.uniform(1.6, 2.0)])
            return lambda s: sign(s.dq[:, j]) * np.abs(s.dq[:, j]) ** a, p
        case "presliding_hysteresis":  # of the known dry friction, which builds up
            p["reach"] = reach = rng.uniform(0.01, 0.05) * float(np.ptp(q[:, j]))
            return lambda s: drag(s.q[:, j], reach) - sign(s.dq[:, j]), p
        case "gradual_reversal":  # of the known dry friction, which turns with speed
            p["speed"] = speed = rng.uniform(0.02, 0.2) * fastest
            return lambda s: np.tanh(s.dq[:, j] / speed) - sign(s.dq[:, j]), p
        case "thermal_friction_drift":
            p["time"] = time = rng.uniform(4.0, 10.0)
            return lambda s: (sign(s.dq[:, j]) + s.dq[:, j]) * np.exp(-s.t / time), p
        case "friction_coupling":
            p["dry"], p["ratio"] = dry, ratio = rng.uniform(), float(rng.choice([-1, 1]))
            sliding = identity[joints[0]] + ratio * identity[j]
            rest = (1 - dry) / rms(dq @ sliding)
            return lambda s: dry * sign(s.dq @ sliding) + rest * (s.dq @ sliding), p
        case "inertia_coupling":
            return lambda s: s.ddq[:, joints[::-1]] @ identity[joints], p
        case "spring":
            p["rest"] = rest = middle + rng.uniform(-0.5, 0.5)
            return lambda s: s.q[:, j] - rest, p
        case "torque_ripple":  # below 6 Hz at typical speed
            most = np.clip(2 * np.pi * 6.0 / rms(dq[:, j]), 3.0, 60.0)
            p["order"] = order = float(np.round(np.exp(rng.uniform(np.log(2.0), np.log(most)))))
            p["phase"] = phase = rng.uniform(-np.pi, np.pi)
            return lambda s: np.sin(order * s.q[:, j] + phase), p
        case "hose":
            p["reach"] = reach = 0.1 * float(np.ptp(q[:, j]))
            half = float(np.ptp(q[:, j])) / 2
            return lambda s: ((s.q[:, j] - middle) / half) ** 3 + 0.3 * drag(s.q[:, j], reach), p
        case "bumper":
            p["from"] = edge = float(np.quantile(q[:, j], rng.uniform(0.75, 0.9)))
            return lambda s: np.maximum(s.q[:, j] - edge, 0.0), p
        case "swaying table":
            p["Hz"], p["damping"] = rng.uniform(3.0, 6.0), rng.uniform(0.03, 0.1)
            return lambda s: sway(s, j, p["Hz"], p["damping"]), p
    raise ValueError(f"no law of {kind}")


def drag(q: Array, reach: float) -> Array:
    """Dahl's friction of positions in order, from -1 to 1, which builds up over a reach."""
    z = np.zeros(len(q))
    for k, step in enumerate(np.diff(q)):
        end = np.sign(step)
        z[k + 1] = end + (z[k] - end) * np.exp(-abs(step) / reach)
    return z


def sway(s: State, j: int, hertz: float, damping: float) -> Array:
    """Acceleration of a base on springs that a joint's torque drives, from rest, (n,)."""
    fine = np.arange(min(s.t[0], 0.0), s.t[-1] + 4e-3, 2e-3)
    force, w = s.at(fine).rigid[:, j], 2 * np.pi * hertz
    b, a = scipy.signal.bilinear([w**2, 0, 0], [1, 2 * damping * w, w**2], 500.0)
    return np.interp(s.t, fine, scipy.signal.lfilter(b, a, force - force[0]))


@dataclass(frozen=True, eq=False)
class Drawing:
    """What drawing an effect needs: a plant without any, two motions and their statistics."""

    plant: Plant
    given: Plant  # with the friction that the given model has
    motions: tuple[Trajectory, ...]
    rng: Rng
    sizes: tuple[float, float] = SIZES

    @cached_property
    def t(self) -> Array:
        """Instants of the statistics [s]."""
        return np.arange(0.0, DURATION, 0.01)

    @cached_property
    def states(self) -> list[State]:
        """The motions of the plant without effects."""
        return [self.plant.state(motion, self.t) for motion in self.motions]

    @cached_property
    def usual(self) -> Array:
        """Rms torque of each joint [N·m]."""
        return rms(self._torque(self.plant))

    def size(self, plant: Plant) -> float:
        """Rms of the torque that a plant has beyond that without effects, of the usual one."""
        more = self._torque(plant) - self._torque(self.plant)
        return float((rms(more) / self.usual).max())

    def _torque(self, plant: Plant) -> Array:
        return np.concatenate([plant.torque(motion, self.t) for motion in self.motions])

    def law(self, kind: str, joints: Sequence[int], size: float) -> tuple[Any, dict[str, Any]]:
        """The law of an effect with its factors, scaled to show so much, and its parameters."""
        q, dq = (np.concatenate([getattr(s, x) for s in self.states]) for x in ("q", "dq"))
        shape, found = joint_law(kind, self.rng, q, dq, joints)
        unit = np.eye(len(self.usual))[joints].sum(axis=0)
        unit[joints[-1]] *= found.get("ratio", 1.0)
        factor = size / self.size(replace(self.plant, laws=((shape, unit),)))
        if kind in REVERSALS:  # a part of presliding, all of what turns with speed
            most = self.plant.coulomb[joints[0]]
            factor = most if kind == "gradual_reversal" else min(factor, most)
        if kind in ("torque_offset", "torque_ripple"):
            factor *= float(self.rng.choice([-1, 1]))
        return (shape, factor * unit), found | {"factor": factor}

    def joints_of(self, kind: str, taken: set[int]) -> list[int]:
        """Where an effect of a kind may be; at joints that no other effect has yet, if it can."""
        rng, nv = self.rng, len(self.usual)
        match kind:
            case "friction_coupling" | "inertia_coupling":  # of the wrist
                return [nv - 2, nv - 1] if rng.random() < 0.5 else [nv - 3, nv - 2]
            case "swaying table":
                return [0, 1]
            case "payload" | "gravity_direction":
                return list(range(nv))[-1 if kind == "payload" else 0 :]
            case "time_delay" if rng.random() < 0.5:
                return list(range(nv))
            case "joint_elasticity" | "backlash":  # where it shows, of what gears give at most
                shown = [GIVES[kind][1] * self.yields(j) * (j not in taken) for j in range(nv)]
                clear = np.flatnonzero(np.array(shown) > min(self.sizes[0], max(shown) / 2))
                return [int(rng.choice(clear))]
        inner = kind == "encoder_offset" and nv > 2  # elsewhere it may not show
        some = range(inner, nv - inner)
        return [int(rng.choice([j for j in some if j not in taken] or some))]

    def change(self, kind: str, joints: list[int]) -> tuple[dict[str, Any], dict[str, Any]]:
        """What an effect changes of the plant without any, and its parameters."""
        rng, alone = self.rng, self.plant
        robot = alone.robot
        size, way = float(np.exp(rng.uniform(*np.log(self.sizes)))), float(rng.choice([-1, 1]))
        unit = np.eye(robot.nv)[joints].sum(axis=0)
        changed, found = dict[str, Any](), dict[str, Any]()
        match kind:
            case "torque_gain":
                changed = found = {"gain": 1 + way * size * unit}
            case "time_delay":
                delay = 0.01 * size / self.size(replace(alone, delay=0.01 * unit))
                changed = found = {"delay": min(delay, LONGEST) * unit}
            case "encoder_offset":
                changed = found = {"offset": way * rng.uniform(0.02, 0.1) * unit}
            case "encoder_scale":
                changed = found = {"scale": 1 + way * rng.uniform(0.02, 0.1) * unit}
            case "encoder_eccentricity":
                off = rng.uniform(0.01, 0.05) * np.exp(1j * rng.uniform(-np.pi, np.pi))
                changed, found = {"eccentricity": off * unit}, {"wave": [off.real, -off.imag]}
            case "motor_saturation":
                high = rng.uniform(0.5, 0.9) * np.abs(self._torque(alone)).max(axis=0)
                changed = found = {"level": np.where(unit > 0, high, np.inf)}
            case "joint_elasticity" | "backlash":
                changed = found = self.gear(kind, joints[0], size)
            case "gravity_direction":
                changed = {"robot": tilted(robot, rng, rng.uniform(0.05, 0.3))}
                found = {"gravity": changed["robot"].gravity}
            case "kinematic_error":
                model, step = robot.model.copy(), rng.normal(size=3)
                step *= rng.uniform(0.01, 0.05) / np.linalg.norm(step)
                place = model.jointPlacements[joints[0] + 1]
                place = pin.SE3(place.rotation, place.translation + step)
                model.jointPlacements[joints[0] + 1] = place
                changed, found = {"robot": replace(robot, model=model)}, {"moved": step}
            case "payload":
                phi = payload(robot, rng)
                phi *= size / self.size(replace(alone, robot=heavier(robot, joints[0], phi)))
                changed, found = {"robot": heavier(robot, joints[0], phi)}, {"phi": phi}
            case "inertial_parameters":  # twice those given
                phi = robot.phi.reshape(-1, 10)[joints[0]]
                changed, found = {"robot": heavier(robot, joints[0], phi)}, {"phi": phi}
            case _:
                law, found = self.law(kind, joints, size)
                changed = {"laws": (law,)}
        return changed, found

    def yields(self, j: int) -> float:
        """Size of an elasticity of a joint without swings, over its lag at rms torque [1/rad]."""
        more = []
        for motion, state in zip(self.motions, self.states, strict=True):
            lag = scipy.interpolate.make_interp_spline(self.t, 1e-3 * state.rigid[:, j], 5)
            one = np.eye(len(self.usual))[j] / self.usual[j]
            links = lambda t, order: motion(t, order) - lag(t, order)[:, None] * one  # noqa: B023, E731
            more.append(self.plant.state(links, self.t).rigid - state.rigid)
        return float((rms(np.concatenate(more)) / self.usual).max()) / 1e-3

    def gear(self, kind: str, j: int, size: float) -> dict[str, Array]:
        """Play by chance, or an elasticity of a size if that is within what gears give."""
        low, high = GIVES[kind]
        give = np.zeros(len(self.usual))
        if kind == "joint_elasticity":
            give[j] = np.clip(size / self.yields(j), low, high)
            return {"compliance": give / self.usual}
        give[j] = np.exp(self.rng.uniform(*np.log(GIVES[kind])))
        return {"play": give, "compliance": FLANK * give / self.usual}

    def hide(self, plant: Plant, kind: str, taken: set[int]) -> tuple[Plant, Hidden]:
        """A plant with one more effect of a kind, drawn again as long as it hardly shows."""
        robot, shown = self.plant.robot, 0.0
        for _ in range(DRAWS):
            joints = self.joints_of(kind, taken)
            changed, found = self.change(kind, joints)
            shown = self.size(replace(self.plant, **changed))
            if shown > 0.99 * self.sizes[0] or kind in GIVES:
                break
        if kind in FRICTION:  # what is hidden is all by which the given friction is off there
            known = kind.removesuffix("_friction")
            own = getattr(plant, known).copy()
            own[joints] = getattr(self.given, known)[joints]
            changed[known] = own
        if "laws" in changed:
            changed["laws"] = (*plant.laws, *changed["laws"])
        for name in {"play", "compliance"} & changed.keys():
            changed[name] = getattr(plant, name) + changed[name]
        if "robot" in changed:  # bodies add up, and gravity stays turned
            phi = plant.robot.phi + changed["robot"].phi - robot.phi
            tilt = changed["robot"] if kind == "gravity_direction" else plant.robot
            frames = changed["robot"] if kind == "kinematic_error" else plant.robot
            changed["robot"] = frames.with_parameters(phi).with_gravity(tilt.gravity)
        taken.update(joints if len(joints) < robot.nv else [])
        effect = "unknown" if kind in STRUCTURES else kind
        names = tuple(robot.joints[j] for j in joints)
        return replace(plant, **changed), Hidden(kind, effect, names, found, shown)

    def set_up(self, plant: Plant, kind: str) -> tuple[Plant, Hidden]:
        """A plant set up, or recorded, otherwise than the model has it, which clearly shows."""
        for _ in range(DRAWS):
            other, found = self._otherwise(plant, kind)
            if found.size > self.sizes[1]:
                break
        return other, found

    def misfit(self, plant: Plant) -> float:
        """Rms of a plant's torque beside what that without effects needs, as it is recorded."""

        def wrong(motion: Trajectory) -> Array:
            def read(t: Array, order: int) -> Array:
                q = motion(t, order)
                return plant.edit(q, q)[0]

            tau = plant.torque(motion, self.t)
            return plant.edit(tau, tau)[1] - self.plant.torque(read, self.t)

        return float((rms(np.concatenate([*map(wrong, self.motions)])) / self.usual).max())

    def _otherwise(self, plant: Plant, kind: str) -> tuple[Plant, Hidden]:
        rng, names = self.rng, plant.robot.joints
        nv = len(names)
        j, joints, flip = int(rng.integers(nv)), names, np.ones(nv)
        match kind:
            case "mounting":
                way = str(rng.choice(["sideways", "any", "tilted"]))
                g = rng.choice([-1, 1]) * 9.81 * np.eye(3)[rng.integers(2)]
                if way == "any":
                    g = rng.normal(size=3)
                    g *= 9.81 / np.linalg.norm(g)
                turned = plant.robot.with_gravity(g)
                turned = tilted(plant.robot, rng, 0.3) if way == "tilted" else turned
                changed, found = {"robot": turned}, {"gravity": turned.gravity}
                effect = "gravity_direction"
            case "zero position":
                j = int(rng.integers(1, max(2, nv - 1)))  # elsewhere it may not show
                angles = [np.pi / 2, -np.pi / 2, np.pi, rng.uniform(-np.pi, np.pi)]
                angle = float(rng.choice(angles))
                changed, found = {"offset": angle * np.eye(nv)[j]}, {"angle": angle}
                effect, joints = "encoder_offset", (names[j],)
            case "swapped":
                order = np.arange(nv)
                a, b = rng.choice(nv, 2, replace=False)
                order[[a, b]] = order[[b, a]]
                whole = bool(rng.random() < 0.5)
                edit: Edit = lambda q, tau: (q[:, order] if whole else q, tau[:, order])  # noqa: E731
                changed, found = {"edit": edit}, {"positions too": whole}
                effect, joints = "wrong_order", (names[a], names[b])
            case "degrees":
                changed, found = {"edit": lambda q, tau: (np.degrees(q), tau)}, {}
                effect = "wrong_unit"
            case _:
                flip[j] = -1.0
                also = flip if kind == "joint sign" else np.ones(nv)
                changed, found = {"edit": lambda q, tau: (q * also, tau * flip)}, {}
                effect, joints = "wrong_sign", (names[j],)
        other = replace(plant, **changed)
        return other, Hidden(kind, effect, tuple(joints), found, self.misfit(other))


def tilted(robot: Robot, rng: Rng, angle: float) -> Robot:
    """The arm with its base turned by an angle about a level axis."""
    way = rng.uniform(-np.pi, np.pi)
    turn = pin.exp3(angle * np.array([np.cos(way), np.sin(way), 0.0]))
    return robot.with_gravity(turn @ robot.gravity)


def heavier(robot: Robot, j: int, phi: Array) -> Robot:
    return robot.with_parameters(robot.phi + np.kron(np.eye(robot.nv)[j], phi))


def payload(robot: Robot, rng: Rng) -> Array:
    """Parameters of a body of 1 kg up to 0.15 m beside the flange, in the last link's frame."""
    flange = list(robot.model.frames)[robot.tip].placement
    lever = flange.act(rng.uniform(-1, 1, 3) * [0.07, 0.07, 0.1])
    box = pin.Inertia.FromBox(1.0, *rng.uniform(0.05, 0.2, 3))
    return np.array(pin.Inertia(1.0, lever, box.inertia).toDynamicParameters())


def perturbed(robot: Robot, rng: Rng, share: float) -> Robot:
    """The arm with each pseudo-inertia L Lᵀ replaced by L (1 + E) (1 + E)ᵀ Lᵀ, mean kept."""
    bodies = []
    for values in robot.phi.reshape(-1, 10):
        root = np.linalg.cholesky(pseudo_inertia(values))
        root = root @ (np.eye(4) + share / 2 * rng.normal(size=(4, 4))) / np.hypot(1, share)
        bodies.append(from_pseudo_inertia(root @ root.T))
    return robot.with_parameters(np.concatenate(bodies))


def drawn_arm(rng: Rng) -> Robot:
    """A shipped arm, or one of example-robot-data's where these are installed."""
    folder = data_folder(None)
    for _ in range(20 if folder and rng.random() < 0.5 else 0):
        other = OTHERS[int(rng.integers(len(OTHERS)))]
        try:
            robot = with_assumed_limits(load_robot(replace(other, path=folder / other.path)))
            perturbed(robot, rng, 0.0)
            if robot.nv >= 4 and robot.revolute.all():
                return robot
        except (ExcitantError, np.linalg.LinAlgError):
            continue
    return load_robot(str(rng.choice(SHIPPED)))


def given_and_true(robot: Robot, rng: Rng, off: float) -> tuple[Robot, Plant, Plant]:
    """The model that a diagnosis is given, with friction; the plant as that has it; the true one.

    Both plants have no other effects.
    """
    known, joints, bare = effect_values(robot), robot.joints, robot.with_effects([])
    true = bare if off == 0 else perturbed(bare, rng, off)
    plant = Plant(true, np.zeros(robot.nv), np.zeros(robot.nv))
    q, dq, ddq = robot.random_motion(rng, 50)
    poses = lambda t, order: (q, dq, ddq)[order]  # noqa: E731
    usual = 0.03 * np.abs(plant.state(poses, np.arange(50.0)).rigid).max(axis=0)
    values, wrong, effects = list[Array](), list[Array](), list[Effect]()
    for kind, symbol in ((ViscousFriction, "Fv"), (CoulombFriction, "Fc")):
        model = [known.get(f"{j}.{symbol}", 0.0) or u for j, u in zip(joints, usual, strict=True)]
        values.append(np.array(model) * rng.uniform(0.5, 1.5, robot.nv))
        wrong.append(values[-1] * (1 + off * rng.normal(size=robot.nv).clip(-2, 2)))
        effects.append(kind(joints).with_values(values[-1]))
    return bare.with_effects(effects), Plant(bare, *values), Plant(true, *wrong)
