"""Recipes of hidden friction and of what rotors add."""

from __future__ import annotations

import numpy as np

from excitant.robots.plant.drawing import separable_rotors
from excitant.robots.plant.habits import Habits
from excitant.robots.plant.hidden_effect import HiddenEffect
from excitant.robots.plant.recipe import (
    Recipe,
    Rng,
    any_joint,
    effect_on,
    either_way,
    neighbours,
    rms,
)


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
        3.0, most / size,
    )  # fmt: skip


def _coupled_friction(habit: Habits, rng: Rng) -> Recipe:
    """A shaft that turns with the sum or difference of neighbouring joints."""
    j, k = neighbours(habit, rng)
    ratio, share = either_way(rng), rng.uniform(0.3, 0.7)
    dry = min(habit.wanted[j], habit.wanted[k])
    wet = dry / rms(habit.dq[:, j] + ratio * habit.dq[:, k])
    return Recipe(
        lambda s: effect_on(
            "friction_coupling", habit, j, k,
            Fv=s * share * wet, Fc=s * (1 - share) * dry, ratio=ratio,
        )
    )  # fmt: skip


def _thermal(habit: Habits, rng: Rng) -> Recipe:
    j, share, time = any_joint(habit, rng), rng.uniform(0.3, 0.7), rng.uniform(6.0, 25.0)
    dry = habit.wanted[j]
    wet = dry / rms(habit.dq[:, j])
    return Recipe(
        lambda s: effect_on(
            "thermal_friction_drift", habit, j,
            Fv=s * share * wet, Fc=s * (1 - share) * dry, time=time,
        ),
        1.3,
    )  # fmt: skip


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


FRICTION = {
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
}
"""How each kind is drawn."""
