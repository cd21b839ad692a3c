"""The virtual arm: a simulated arm with hidden effects, a controller and sensors.

The truth is the nominal arm with inertias, friction and rotor inertia off by a few per cent, and
with effects that the nominal arm does not have. What is recorded is what sensors would give. Known
effects of the nominal arm are read by their names and their parameters' names alone, never by
their formulas.
"""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
import pinocchio as pin

from excitant.exceptions import BadInput, BadRobot, UnknownName
from excitant.robots.motion import Array, root_mean_square
from excitant.robots.parameters import STANDARD, elements, inertia, steiner
from excitant.robots.plant.arm import (
    Progress,
    Trajectory,
    rigid_torque,
    simulate,
)
from excitant.robots.plant.physics import Drives, Truth
from excitant.robots.plant.planting import HiddenEffect, plant
from excitant.robots.plant.sensors import Encoder, Recorder, Run, Sensors, recorded
from excitant.robots.robot import Robot, spans

__all__ = [
    "HiddenEffect",
    "Sensors",
    "VirtualArm",
    "draw_hidden_effect",
    "ideal_sensors",
    "industrial_sensors",
    "nominal_truth",
    "typical_motion",
    "typical_torque",
    "virtual_arm",
]

FRICTION_TOLERANCE = (
    0.05  # largest relative deviation of friction and rotor inertia
)
VISIBLE_NOISE = (
    4.0  # least torque of a drawn effect, in standard deviations of its noise
)


@dataclass(frozen=True, eq=False)
class VirtualArm:
    """A true arm that its user knows by its nominal description only."""

    nominal: Robot  # what is known, and what the controller believes
    truth: Truth  # the physics
    # what the truth has beside the nominal effects
    hidden: tuple[HiddenEffect, ...]
    sensors: Sensors  # what is recorded

    def run(
        self,
        trajectory: Trajectory,
        duration: float,
        rng: np.random.Generator,
        progress: Progress | None = None,
    ) -> Run:
        """True run of a trajectory; see `record`."""
        return simulate(
            self.nominal,
            nominal_truth(self.nominal),
            self.truth.drawn(rng, duration),
            trajectory,
            duration,
            self.sensors.rate_hz,
            progress,
        )

    def record(
        self,
        trajectory: Trajectory,
        duration: float,
        rng: np.random.Generator,
        progress: Progress | None = None,
    ) -> pd.DataFrame:
        """Run a trajectory ``trajectory(t, order)`` for a time [s] and record it.

        Returns:
            Columns ``t``, ``q1..qn``, ``dq1..dqn``, ``tau1..taun``.

        Raises:
            BadInput: The trajectory starts in motion or cannot be followed.
        """
        return self.recorded(self.run(trajectory, duration, rng, progress), rng)

    def recorded(self, run: Run, rng: np.random.Generator) -> pd.DataFrame:
        """The table that its sensors give of a run."""
        return recorded(
            run, self.sensors, self.truth.recorder, self.truth.drives.offset, rng
        )


def virtual_arm(
    robot: Robot,
    rng: np.random.Generator,
    *,
    hidden: Sequence[HiddenEffect] | None = None,
    sensors: Sensors | None = None,
    tolerance: float = 0.03,
) -> VirtualArm:
    """Build a truth around a nominal arm, whose effects, if any, are known ones.

    Args:
        robot: The nominal arm.
        rng: Draws the deviations.
        hidden: What the truth has besides; one effect drawn at random when not given.
        sensors: `industrial_sensors` when not given.
        tolerance: Largest relative deviation of masses, centres of mass (in radii of gyration)
            and central inertias; with any, friction deviates by up to 5 %.

    Raises:
        BadInput: Hidden effects that leave a mass without physical consistency.
    """
    if hidden is None:
        hidden = (draw_hidden_effect(robot, rng),)
    known = nominal_truth(robot)
    model = known.model.copy()
    drives = known.drives
    for j in range(1, robot.nv + 1):
        model.inertias[j] = _perturbed(model.inertias[j], rng, tolerance)
    spread = FRICTION_TOLERANCE if tolerance > 0 else 0.0
    nearby = {
        name: getattr(drives, name) * (1 + spread * rng.uniform(-1, 1, robot.nv))
        for name in ("viscous", "coulomb", "stribeck", "rotor")
    }
    drives = replace(drives, **nearby)
    model.armature = drives.rotor
    nearly = replace(known, model=model, drives=drives)
    truth = plant(nearly, robot.joints, hidden)
    for link, body in zip(robot.links, list(truth.model.inertias)[1:], strict=True):
        if body.mass < 0:
            raise BadInput(
                f"virtual arm: hidden effects leave {link} with {body.mass:.3g} kg"
            )
    return VirtualArm(
        robot, truth, tuple(hidden), sensors or industrial_sensors(robot)
    )


def _perturbed(body: Any, rng: np.random.Generator, tolerance: float) -> Any:
    """A nearby body: mass and central inertia scaled, centre of mass moved."""
    factors = rng.uniform(-tolerance, tolerance, 2)
    shift = rng.uniform(-1, 1, 3)
    if body.mass <= 0:
        return body
    gyration = np.sqrt(max(np.trace(body.inertia), 0.0) / (2 * body.mass))
    mass = body.mass * (1 + factors[0])
    c = np.array(body.lever)
    c += tolerance * gyration * shift / max(1.0, np.linalg.norm(shift))
    tensor = body.inertia * (1 + factors[1]) + steiner(mass, c)
    return inertia(np.array([mass, *(mass * c), *elements(tensor)]))


def nominal_truth(robot: Robot) -> Truth:
    """Rigid bodies and drives of the robot as described, with its effects.

    Raises:
        BadRobot: An effect without values.
        UnknownName: An effect that the virtual arm does not have.
    """
    n = robot.nv
    zeros = np.zeros(n)
    rigid = Truth(
        robot.model.copy(),
        Drives(zeros, zeros, zeros, np.full(n, 0.1), zeros, zeros),
        np.zeros((n, n)),
        Encoder(np.ones(n), zeros),
        Recorder(np.eye(n), zeros),
    )
    nominal = [
        hidden for effect in robot.effects for hidden in _described(robot, effect)
    ]
    return plant(rigid, robot.joints, nominal)


def industrial_sensors(robot: Robot, rate_hz: float = 250.0) -> Sensors:
    """17-bit encoders, and torque from motor current with a noise of 0.3 % of the limit."""
    typical = 4 * typical_torque(robot)
    scale = np.where(np.isfinite(robot.limits.torque), robot.limits.torque, typical)
    return Sensors(rate_hz, 2 * np.pi / 2**17, 2e-3, 3e-3 * scale, 3e-4 * scale)


def ideal_sensors(robot: Robot, rate_hz: float = 250.0) -> Sensors:
    """Sensors without errors."""
    return Sensors(rate_hz, 0.0, 0.0, np.zeros(robot.nv), np.zeros(robot.nv))


def typical_torque(robot: Robot) -> Array:
    """Root mean square torque at moderate speeds, shape (nv,) [N·m]."""
    truth = nominal_truth(robot)
    motion = typical_motion(robot)
    return root_mean_square(
        truth.drives.friction(motion[1]) + rigid_torque(truth.model, *motion)
    )


def typical_motion(robot: Robot) -> tuple[Array, Array, Array]:
    """Random states at half the limits of velocity and acceleration, each (200, nv)."""
    q, dq, ddq = robot.random_motion(0, 200)
    return q, dq / 2, ddq / 2


Numbers = Mapping[str, float]


def _ripple(x: Numbers) -> dict[str, float]:
    """A cos(n q) + B sin(n q) as one sine; the order is in the coefficients' names."""
    cosine, sine = (value for name, value in x.items() if name.startswith("ripple"))
    amplitude = math.hypot(cosine, sine)
    phase = math.atan2(cosine, sine)
    return {"amplitude": amplitude, "order": x["order"], "phase": phase}


def _spring(x: Numbers) -> dict[str, float]:
    """K q + c, or a cos q + b sin q, by the angle at which the torque vanishes."""
    if "spring_cos" in x:
        moment = math.hypot(x["spring_cos"], x["spring_sin"])
        return {
            "moment": moment,
            "rest": -math.atan2(x["spring_cos"], x["spring_sin"]),
        }
    return {"stiffness": x["k"], "rest": -x["moment"] / x["k"] if x["k"] else 0.0}


_AFFIXES = re.compile("^(payload|delta)_|_cold$")  # which the plant's names lack
_SAME_PARAMETERS = (  # have otherwise the same names and meaning in the plant
    "thermal_friction_drift",
    "payload",
    "inertial_parameters",
    "viscous_friction",
    "coulomb_friction",
    "stribeck_friction",
    "asymmetric_friction",
    "nonlinear_viscous_friction",
    "load_dependent_friction",
    "presliding_hysteresis",
    "rotor_inertia",
    "torque_offset",
    "friction_coupling",
    "inertia_coupling",
    "time_delay",
)
_TRANSLATION: dict[str, Callable[[Numbers], Numbers]] = {
    **dict.fromkeys(_SAME_PARAMETERS, lambda x: x),
    "torque_ripple": _ripple,
    "spring": _spring,
    "torque_gain": lambda x: {"gain": 1 + x["gain"]},
}
_COMMON = ("friction_coupling", "inertia_coupling", "torque_gain", "time_delay")
_SHAPES = ("velocity", "exponent", "distance", "time", "order", "ratio")


def _described(robot: Robot, effect: Any) -> list[HiddenEffect]:
    """One effect of a nominal arm, joint by joint where it acts on each alone."""
    name = effect.name
    UnknownName.refuse("effect of a nominal virtual arm", [name], _TRANSLATION)
    if effect.values is None:
        raise BadRobot(robot.source, f"effect {name} has no values; give them")
    symbols = [_AFFIXES.sub("", term.name) for term in effect.own_terms]
    shape = {key: getattr(effect, key) for key in _SHAPES if hasattr(effect, key)}
    groups = [(joint,) for joint in effect.joints]
    if name in _COMMON:
        groups = [effect.joints]
    rows = np.reshape(effect.values, (len(groups), -1)).tolist()
    hidden = []
    for joints, row in zip(groups, rows, strict=True):
        numbers = dict(zip(symbols, row, strict=True)) | shape
        parameters = tuple(_TRANSLATION[name](numbers).items())
        several = joints if len(joints) > 1 else ()
        hidden.append(HiddenEffect(name, joints[0], parameters, several))
    return hidden


def draw_hidden_effect(robot: Robot, rng: np.random.Generator) -> HiddenEffect:
    """Draw a kind of effect, a joint, and a size that shows but is not absurd.

    At moderate speed the effect makes 8 to 20 % of the joint's typical torque and at least four
    times the noise of `industrial_sensors`. Rotor inertia is drawn only where no inertia of the
    links could pass for it; a payload weighs 7 to 16 % of the arm and hangs at its last link,
    less if it would load a joint with more than its typical torque; one that no joint feels, as on
    the axis of an arm's only joint, is drawn again.
    """
    kinds = [
        "viscous_friction",
        "coulomb_friction",
        "stribeck_friction",
        "torque_offset",
        "payload",
    ]
    separable = separable_rotors(robot)
    kind = str(rng.choice(kinds + ["rotor_inertia"] * bool(separable)))
    if kind == "payload":
        payload = draw_payload(robot, rng)
        load = _load(robot, np.array([value for _, value in payload.parameters]))
        felt = load >= VISIBLE_NOISE * industrial_sensors(robot).torque_noise
        return payload if felt.any() else draw_hidden_effect(robot, rng)
    joint = str(rng.choice(separable if kind == "rotor_inertia" else robot.joints))
    j = robot.joint_index(joint)
    floor = VISIBLE_NOISE * float(industrial_sensors(robot).torque_noise[j])
    torque = max(float(rng.uniform(0.08, 0.2) * typical_torque(robot)[j]), floor)
    _, dq, ddq = (float(root_mean_square(x[:, j])) for x in typical_motion(robot))
    fast = min(float(robot.limits.velocity[j]), 3.0)
    sizes = {
        "viscous_friction": {"Fv": torque / dq},
        "coulomb_friction": {"Fc": torque},
        "stribeck_friction": {
            "Fs": 2 * torque,
            "velocity": rng.uniform(0.03, 0.08) * fast,
        },
        "torque_offset": {"offset": torque * rng.choice([-1.0, 1.0])},
        "rotor_inertia": {"Ia": torque / ddq},
    }[kind]
    return HiddenEffect(
        kind, joint, tuple((name, float(v)) for name, v in sizes.items())
    )


def draw_payload(robot: Robot, rng: np.random.Generator) -> HiddenEffect:
    """A box at the frame farthest out on the last link."""
    model = robot.model
    fixed = [
        f.placement.translation for f in model.frames if f.parentJoint == robot.nv
    ]
    centre = np.array(model.inertias[robot.nv].lever)
    flange = max([centre, *fixed], key=lambda x: float(np.linalg.norm(x - centre)))
    reach = max(sum(spans(robot)) + float(np.linalg.norm(flange)), 0.1)
    strongest = float(robot.limits.torque.max())
    moving = sum(body.mass for body in list(model.inertias)[1:])
    mass = min(rng.uniform(0.07, 0.16) * moving, 0.3 * strongest / (9.81 * reach))
    direction = rng.standard_normal(3)
    direction *= np.sign(direction @ (flange - centre)) or 1.0
    shift = reach * rng.uniform(0.02, 0.06) * direction
    lever = flange + shift / np.linalg.norm(direction)
    box = pin.Inertia.FromBox(mass, *(reach * rng.uniform(0.03, 0.1, 3)))
    phi = pin.Inertia(mass, lever, box.inertia).toDynamicParameters()
    phi *= _bearable(robot, phi)
    values = tuple(zip(STANDARD, phi.tolist(), strict=True))
    return HiddenEffect("payload", robot.joints[-1], values)


def _load(robot: Robot, payload: Array) -> Array:
    """Root mean square torque that a payload adds at moderate speeds, shape (nv,) [N·m]."""
    loaded = robot.model.copy()
    phi = loaded.inertias[robot.nv].toDynamicParameters() + payload
    loaded.inertias[robot.nv] = pin.Inertia.FromDynamicParameters(phi)
    motion = typical_motion(robot)
    return root_mean_square(
        rigid_torque(loaded, *motion) - rigid_torque(robot.model, *motion)
    )


def _bearable(robot: Robot, payload: Array) -> float:
    """Share of a payload that loads no joint with more than 0.9 of its typical torque."""
    noise = industrial_sensors(robot).torque_noise
    bearable = 0.9 * np.maximum(typical_torque(robot), 6 * noise)
    load = np.maximum(_load(robot, payload), 1e-12)
    return min(1.0, float((bearable / load).min()))


def separable_rotors(robot: Robot) -> list[str]:
    """Joints whose rotor inertia makes a torque that no link inertia can make."""
    data = robot.model.createData()
    motion = typical_motion(robot)
    states = zip(*motion, strict=True)
    Y = np.array(
        [pin.computeJointTorqueRegressor(robot.model, data, *x) for x in states]
    )
    Y = Y.reshape(-1, 10 * robot.nv)
    columns = np.einsum("ij,kj->kij", np.eye(robot.nv), motion[2])
    columns = columns.reshape(-1, robot.nv)
    rest = columns - Y @ np.linalg.lstsq(Y, columns, rcond=1e-10)[0]
    share = np.linalg.norm(rest, axis=0) / np.linalg.norm(columns, axis=0)
    return [joint for joint, s in zip(robot.joints, share, strict=True) if s > 1e-3]
