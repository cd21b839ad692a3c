"""Drawing of a hidden effect that shows at moderate speed: what the demo plants."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from excitant.robots.motion import Array
from excitant.robots.parameters import STANDARD
from excitant.robots.plant.nominal import industrial_sensors, typical_motion, typical_torque
from excitant.robots.plant.planting import HiddenEffect
from excitant.robots.robot import Robot


def draw_hidden_effect(robot: Robot, rng: np.random.Generator) -> HiddenEffect:
    """Draw a kind of effect, a joint, and a size that shows but is not absurd.

    At moderate speed the effect makes 8 to 20 % of the joint's typical torque and at least four
    times the noise of `industrial_sensors`. Rotor inertia is drawn only where no inertia of the
    links could pass for it; a payload weighs 7 to 16 % of the arm and hangs at its last link,
    less if it would load a joint with more than its typical torque.
    """
    kinds = ["viscous_friction", "coulomb_friction", "stribeck_friction", "torque_offset"]
    separable = separable_rotors(robot)
    kinds += ["payload", *(["rotor_inertia"] if separable else [])]
    kind = str(rng.choice(kinds))
    if kind == "payload":
        return draw_payload(robot, rng)
    joint = str(rng.choice(separable if kind == "rotor_inertia" else robot.joints))
    j = robot.joint_index(joint)
    floor = 4 * float(industrial_sensors(robot).torque_noise[j])
    torque = max(float(rng.uniform(0.08, 0.2) * typical_torque(robot)[j]), floor)
    _, dq, ddq = (np.sqrt(np.mean(x[:, j] ** 2)) for x in typical_motion(robot))
    fast = min(float(robot.limits.velocity[j]), 3.0)
    sizes = {
        "viscous_friction": {"Fv": torque / dq},
        "coulomb_friction": {"Fc": torque},
        "stribeck_friction": {"Fs": 2 * torque, "velocity": rng.uniform(0.03, 0.08) * fast},
        "torque_offset": {"offset": torque * rng.choice([-1.0, 1.0])},
        "rotor_inertia": {"Ia": torque / ddq},
    }[kind]
    return HiddenEffect(kind, joint, tuple((name, float(v)) for name, v in sizes.items()))


def draw_payload(robot: Robot, rng: np.random.Generator) -> HiddenEffect:
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
        for x in zip(*typical_motion(robot), strict=True)
    ]
    load = np.sqrt(np.mean(np.square(added), axis=0))
    noise = industrial_sensors(robot).torque_noise
    bearable = 0.9 * np.maximum(typical_torque(robot), 6 * noise)
    return min(1.0, float((bearable / np.maximum(load, 1e-12)).min()))


def separable_rotors(robot: Robot) -> list[str]:
    """Joints whose rotor inertia makes a torque that no link inertia can make."""
    data, (q, dq, ddq) = robot.model.createData(), typical_motion(robot)
    states = zip(q, dq, ddq, strict=True)
    Y = np.array([pin.computeJointTorqueRegressor(robot.model, data, *x) for x in states])
    basis = np.linalg.svd(Y.reshape(-1, Y.shape[2]), full_matrices=False)
    span = basis.U[:, basis.S / basis.S[0] > 1e-10]
    columns = np.einsum("ij,kj->kij", np.eye(robot.nv), ddq).reshape(-1, robot.nv)
    rest = columns - span @ (span.T @ columns)
    share = np.linalg.norm(rest, axis=0) / np.linalg.norm(columns, axis=0)
    return [joint for joint, s in zip(robot.joints, share, strict=True) if s > 1e-3]
