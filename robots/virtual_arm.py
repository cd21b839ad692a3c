"""The virtual arm: a hidden truth with a controller and sensors, to test whoever looks for it.

The truth is the nominal arm with inertias, friction and rotor inertia off by a few per cent, and
with effects that the nominal arm does not have. What is recorded is what sensors would give.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol, cast

import numpy as np
import pandas as pd
import pinocchio as pin

from excitant.exceptions import BadInput, BadRobot, UnknownName
from excitant.robots.motion import Array, freeze, read_only
from excitant.robots.parameters import STANDARD
from excitant.robots.plant import Drives, Progress, Trajectory, simulate
from excitant.robots.robot import Robot

_DRIVE_OF = {
    "viscous_friction": {"Fv": "viscous"},
    "coulomb_friction": {"Fc": "coulomb"},
    "stribeck_friction": {"Fs": "stribeck", "velocity": "stribeck_velocity"},
    "rotor_inertia": {"Ia": "rotor"},
    "torque_offset": {"offset": "offset"},
}
_ADDED_INERTIA = ("payload", "inertial_parameters")
_FRICTION_TOLERANCE = 0.05


@dataclass(frozen=True)
class HiddenEffect:
    """Something the true arm has and the nominal one has not.

    Attributes:
        effect: Name of the effect.
        joint: Joint it acts on; for a payload the joint whose link holds it.
        parameters: Names and values in SI units: ``Fv``, ``Fc``, ``Fs`` and ``velocity``,
            ``Ia``, ``offset``, or the ten standard parameters of a payload about the joint frame.
    """

    effect: str
    joint: str
    parameters: tuple[tuple[str, float], ...]


@dataclass(frozen=True, eq=False)
class Sensors:
    """What is recorded of the truth.

    Attributes:
        rate_hz: Sampling rate [Hz].
        position_resolution: Encoder step [rad or m]; 0 for none.
        velocity_noise: Standard deviation of the velocity [rad/s or m/s].
        torque_noise: Standard deviation of each torque, shape (nv,) [N·m].
        torque_resolution: Step of each torque, shape (nv,) [N·m]; 0 for none.
    """

    rate_hz: float
    position_resolution: float
    velocity_noise: float
    torque_noise: Array
    torque_resolution: Array

    def __post_init__(self) -> None:
        freeze(self, "torque_noise", "torque_resolution")


def industrial_sensors(robot: Robot, rate_hz: float = 250.0) -> Sensors:
    """17-bit encoders, and torque from motor current with a noise of 0.3 % of the limit."""
    typical = 4 * typical_torque(robot)
    scale = np.where(np.isfinite(robot.limits.torque), robot.limits.torque, typical)
    return Sensors(rate_hz, 2 * np.pi / 2**17, 2e-3, 3e-3 * scale, 3e-4 * scale)


def ideal_sensors(robot: Robot, rate_hz: float = 250.0) -> Sensors:
    """Sensors that tell the truth."""
    return Sensors(rate_hz, 0.0, 0.0, np.zeros(robot.nv), np.zeros(robot.nv))


@dataclass(frozen=True, eq=False)
class VirtualArm:
    """A true arm that its user knows by its nominal description only.

    Attributes:
        nominal: What is known, and what the controller believes.
        model: The true rigid bodies, rotor inertia as armature; never edited.
        drives: The true friction.
        hidden: What the truth has beside the nominal effects.
        sensors: What is recorded.
    """

    nominal: Robot
    model: Any
    drives: Drives
    hidden: tuple[HiddenEffect, ...]
    sensors: Sensors

    def record(
        self,
        trajectory: Trajectory,
        duration: float,
        rng: np.random.Generator,
        progress: Progress | None = None,
    ) -> pd.DataFrame:
        """Run a trajectory and record it.

        Args:
            trajectory: ``trajectory(t, order)``, shape (n, nv); starts at rest.
            duration: Length of the recording [s].
            rng: Noise of the sensors.
            progress: Called with the fraction done.

        Returns:
            Columns ``t``, ``q1..qn``, ``dq1..dqn``, ``tau1..taun``.

        Raises:
            BadInput: The trajectory starts in motion or cannot be followed.
        """
        believed = nominal_truth(self.nominal)
        rate = self.sensors.rate_hz
        true = (self.model, self.drives)
        run = simulate(self.nominal, believed, true, trajectory, duration, rate, progress)
        s, shape = self.sensors, run.q.shape
        tau = run.tau + self.drives.offset + s.torque_noise * rng.standard_normal(shape)
        columns = {
            "q": _quantised(run.q, s.position_resolution),
            "dq": run.dq + s.velocity_noise * rng.standard_normal(shape),
            "tau": _quantised(tau, s.torque_resolution),
        }
        numbered = {f"{c}{j + 1}": v[:, j] for c, v in columns.items() for j in range(shape[1])}
        return pd.DataFrame({"t": run.t, **numbered})


def _quantised(values: Array, step: float | Array) -> Array:
    width = np.broadcast_to(step, values.shape)
    fine = np.where(width > 0, width, 1.0)
    return np.where(width > 0, np.round(values / fine) * fine, values)


class _Known(Protocol):
    """What a robot's effects offer here: a name, joints, and one value per parameter."""

    name: str
    joints: tuple[str, ...]
    values: tuple[float, ...] | None


def nominal_truth(robot: Robot) -> tuple[Any, Drives]:
    """Rigid bodies and drives of the robot as described, with its effects.

    Raises:
        BadRobot: An effect that the virtual arm does not have, or one without values.
    """
    known: list[HiddenEffect] = []
    for effect in (cast(_Known, e) for e in robot.effects):
        if effect.values is None:
            raise BadRobot(robot.source, f"effect {effect.name} has no values; give them")
        symbols = STANDARD if effect.name in _ADDED_INERTIA else list(_rows(effect.name))[:1]
        values = np.reshape(effect.values, (len(effect.joints), len(symbols)))
        extra = [("velocity", effect.velocity)] if hasattr(effect, "velocity") else []
        for joint, row in zip(effect.joints, values.tolist(), strict=True):
            numbers = (*zip(symbols, row, strict=True), *extra)
            known.append(HiddenEffect(effect.name, joint, numbers))
    zeros = np.zeros(robot.nv)
    still = Drives(zeros, zeros, zeros, np.full(robot.nv, 0.1), zeros, zeros)
    return with_effects(robot, robot.model.copy(), still, known)


def _rows(effect: str) -> dict[str, str]:
    if effect not in _DRIVE_OF:
        raise UnknownName("effect of a virtual arm", effect, [*_DRIVE_OF, *_ADDED_INERTIA])
    return _DRIVE_OF[effect]


def with_effects(
    robot: Robot, model: Any, drives: Drives, effects: Iterable[HiddenEffect]
) -> tuple[Any, Drives]:
    """A truth with further effects; the model given is left alone.

    Raises:
        UnknownName: An effect that the virtual arm does not have, or a joint it has not.
    """
    model = model.copy()
    rows = {name: np.array(getattr(drives, name)) for name in vars(drives)}
    for effect in effects:
        if effect.joint not in robot.joints:
            raise UnknownName("joint", effect.joint, robot.joints)
        j = robot.joint_index(effect.joint)
        parameters = dict(effect.parameters)
        if effect.effect in _ADDED_INERTIA:
            added = np.array([parameters[name] for name in STANDARD])
            phi = model.inertias[j + 1].toDynamicParameters() + added
            model.inertias[j + 1] = pin.Inertia.FromDynamicParameters(phi)
            continue
        for symbol, row in _rows(effect.effect).items():
            if symbol == "velocity":
                rows[row][j] = parameters.get(symbol, rows[row][j])
            else:
                rows[row][j] += parameters[symbol]
    drives = Drives(**rows)
    model.armature = np.array(drives.rotor)
    return model, drives


def virtual_arm(
    robot: Robot,
    rng: np.random.Generator,
    *,
    hidden: Sequence[HiddenEffect] | None = None,
    sensors: Sensors | None = None,
    tolerance: float = 0.03,
) -> VirtualArm:
    """Build a truth around a nominal arm.

    Args:
        robot: The nominal arm; its effects, if any, are known ones.
        rng: Draws the deviations.
        hidden: What the truth has besides; one effect drawn at random when not given.
        sensors: `industrial_sensors` when not given.
        tolerance: Largest relative deviation of masses, centres of mass (relative to the
            radius of gyration) and central inertias; friction deviates by up to 5 % when this is
            not zero.

    Raises:
        BadInput: Hidden effects that leave a mass without physical consistency.
    """
    if hidden is None:
        hidden = (draw_hidden_effect(robot, rng),)
    model, drives = nominal_truth(robot)
    for j in range(1, robot.nv + 1):
        model.inertias[j] = _perturbed(model.inertias[j], rng, tolerance)
    spread = _FRICTION_TOLERANCE if tolerance > 0 else 0.0
    factors = {
        name: 1 + spread * rng.uniform(-1, 1, robot.nv)
        for name in ("viscous", "coulomb", "stribeck", "rotor")
    }
    drives = replace(drives, **{k: getattr(drives, k) * f for k, f in factors.items()})
    model, drives = with_effects(robot, model, drives, hidden)
    for link, body in zip(robot.links, list(model.inertias)[1:], strict=True):
        if body.mass < 0:
            raise BadInput(f"virtual arm: hidden effects leave {link} with {body.mass:.3g} kg")
    return VirtualArm(robot, model, drives, tuple(hidden), sensors or industrial_sensors(robot))


def _perturbed(body: Any, rng: np.random.Generator, tolerance: float) -> Any:
    """A nearby body: mass and central inertia scaled, centre of mass moved."""
    factors, shift = rng.uniform(-tolerance, tolerance, 2), rng.uniform(-1, 1, 3)
    if body.mass <= 0:
        return body
    gyration = np.sqrt(max(np.trace(body.inertia), 0.0) / (2 * body.mass))
    mass, c = body.mass * (1 + factors[0]), np.array(body.lever)
    c += tolerance * gyration * shift / max(1.0, np.linalg.norm(shift))
    inertia = body.inertia * (1 + factors[1]) + mass * (c @ c * np.eye(3) - np.outer(c, c))
    rows, columns = [0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]
    return pin.Inertia.FromDynamicParameters(np.array([mass, *(mass * c), *inertia[rows, columns]]))


def draw_hidden_effect(robot: Robot, rng: np.random.Generator) -> HiddenEffect:
    """Draw a kind of effect, a joint, and a size that shows but is not absurd.

    At moderate speed the effect makes 8 to 20 % of the joint's typical torque and at least four
    times the noise of `industrial_sensors`. Rotor inertia is drawn only where no inertia of the
    links could pass for it; a payload weighs 7 to 16 % of the arm and hangs at its last link,
    less if it would load a joint with more than its typical torque.
    """
    kinds = ["viscous_friction", "coulomb_friction", "stribeck_friction", "torque_offset"]
    separable = _separable_rotors(robot)
    kinds += ["payload", *(["rotor_inertia"] if separable else [])]
    kind = str(rng.choice(kinds))
    if kind == "payload":
        return _draw_payload(robot, rng)
    joint = str(rng.choice(separable if kind == "rotor_inertia" else robot.joints))
    j = robot.joint_index(joint)
    floor = 4 * float(industrial_sensors(robot).torque_noise[j])
    torque = max(float(rng.uniform(0.08, 0.2) * typical_torque(robot)[j]), floor)
    _, dq, ddq = (np.sqrt(np.mean(x[:, j] ** 2)) for x in _typical_motion(robot))
    fast = min(float(robot.limits.velocity[j]), 3.0)
    sizes = {
        "viscous_friction": {"Fv": torque / dq},
        "coulomb_friction": {"Fc": torque},
        "stribeck_friction": {"Fs": 2 * torque, "velocity": rng.uniform(0.03, 0.08) * fast},
        "torque_offset": {"offset": torque * rng.choice([-1.0, 1.0])},
        "rotor_inertia": {"Ia": torque / ddq},
    }[kind]
    return HiddenEffect(kind, joint, tuple((name, float(v)) for name, v in sizes.items()))


def _draw_payload(robot: Robot, rng: np.random.Generator) -> HiddenEffect:
    """A box at the frame farthest out on the last link."""
    model = robot.model
    reach = sum(float(np.linalg.norm(p.translation)) for p in list(model.jointPlacements)[1:])
    fixed = [f.placement.translation for f in list(model.frames) if f.parentJoint == robot.nv]
    centre = np.array(model.inertias[robot.nv].lever)
    flange = max([centre, *fixed], key=lambda x: float(np.linalg.norm(x - centre)))
    reach = max(reach + float(np.linalg.norm(flange)), 0.1)
    strongest = float(robot.limits.torque.max())
    moving = sum(body.mass for body in list(model.inertias)[1:])
    mass = min(rng.uniform(0.07, 0.16) * moving, 0.3 * strongest / (9.81 * reach))
    direction = rng.standard_normal(3)
    direction *= np.sign(direction @ (flange - centre)) or 1.0
    lever = flange + reach * rng.uniform(0.02, 0.06) * direction / np.linalg.norm(direction)
    box = pin.Inertia.FromBox(mass, *(reach * rng.uniform(0.03, 0.1, 3)))
    phi = pin.Inertia(mass, lever, box.inertia).toDynamicParameters()
    phi *= _bearable(robot, phi)
    values = tuple(zip(STANDARD, phi.tolist(), strict=True))
    return HiddenEffect("payload", robot.joints[-1], values)


def _bearable(robot: Robot, payload: Array) -> float:
    """Share of a payload that loads no joint with more than 0.9 of its typical torque."""
    loaded = robot.model.copy()
    phi = loaded.inertias[robot.nv].toDynamicParameters() + payload
    loaded.inertias[robot.nv] = pin.Inertia.FromDynamicParameters(phi)
    one, other = robot.model.createData(), loaded.createData()
    added = [
        pin.rnea(loaded, other, *x) - pin.rnea(robot.model, one, *x)
        for x in zip(*_typical_motion(robot), strict=True)
    ]
    load = np.sqrt(np.mean(np.square(added), axis=0))
    noise = industrial_sensors(robot).torque_noise
    bearable = 0.9 * np.maximum(typical_torque(robot), 6 * noise)
    return min(1.0, float((bearable / np.maximum(load, 1e-12)).min()))


def typical_torque(robot: Robot) -> Array:
    """Root mean square torque at moderate speeds, shape (nv,) [N·m]."""
    model, drives = nominal_truth(robot)
    data, q, dq, ddq = model.createData(), *_typical_motion(robot)
    tau = drives.friction(dq) + [pin.rnea(model, data, *x) for x in zip(q, dq, ddq, strict=True)]
    return read_only(np.sqrt(np.mean(tau**2, axis=0)))


def _typical_motion(robot: Robot) -> tuple[Array, Array, Array]:
    q, dq, ddq = robot.random_motion(np.random.default_rng(0), 200)
    return q, dq / 2, ddq / 2


def _separable_rotors(robot: Robot) -> list[str]:
    """Joints whose rotor inertia makes a torque that no link inertia can make."""
    data, (q, dq, ddq) = robot.model.createData(), _typical_motion(robot)
    states = zip(q, dq, ddq, strict=True)
    Y = np.array([pin.computeJointTorqueRegressor(robot.model, data, *x) for x in states])
    basis = np.linalg.svd(Y.reshape(-1, Y.shape[2]), full_matrices=False)
    span = basis.U[:, basis.S / basis.S[0] > 1e-10]
    columns = np.einsum("ij,kj->kij", np.eye(robot.nv), ddq).reshape(-1, robot.nv)
    rest = columns - span @ (span.T @ columns)
    share = np.linalg.norm(rest, axis=0) / np.linalg.norm(columns, axis=0)
    return [joint for joint, s in zip(robot.joints, share, strict=True) if s > 1e-3]
