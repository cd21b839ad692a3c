"""Recipes: for each kind of hidden effect, joints and shape by chance, and a size to be scaled."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin

from excitant.robots.parameters import STANDARD
from excitant.robots.plant.drawing import draw_payload
from excitant.robots.plant.friction_recipes import FRICTION
from excitant.robots.plant.habits import Habits
from excitant.robots.plant.hidden_effect import HiddenEffect
from excitant.robots.plant.recipe import (
    Recipe,
    Rng,
    any_joint,
    effect_on,
    either_way,
    one_or_all,
    rms,
    strong_joint,
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
        1.0, 6.0,
    )  # fmt: skip


def _tilt(habit: Habits, rng: Rng) -> Recipe:
    way = rng.uniform(-np.pi, np.pi)
    return Recipe(
        lambda s: effect_on(
            "gravity_direction", habit, roll=0.03 * s * np.cos(way), pitch=0.03 * s * np.sin(way)
        ),
        1.0, 10.0,
    )  # fmt: skip


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
            "cable_pull", habit, **x, tension=s * pull, friction=0.5 * s * pull,
            distance=0.02 * habit.size,
        )  # fmt: skip

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
    **FRICTION,
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
