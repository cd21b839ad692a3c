"""Effects that a nominal arm is known to have, in the words of the plant.

They are read by their names and parameters' names alone, never by their formulas.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, Protocol, cast

import numpy as np

from excitant.exceptions import BadRobot, UnknownName
from excitant.robots.parameters import STANDARD
from excitant.robots.plant.hidden_effect import HiddenEffect
from excitant.robots.robot import Robot

Numbers = Mapping[str, float]


class _Named(Protocol):
    @property
    def name(self) -> str: ...


class _Known(Protocol):
    """What a robot's effects offer here."""

    name: str
    joints: tuple[str, ...]
    values: tuple[float, ...] | None

    def parameters(self, robot: Robot) -> tuple[_Named, ...]:
        """Parameters by name, each ``owner.symbol``."""


def _same(*names: str) -> Callable[[Numbers], dict[str, float]]:
    return lambda x: {name: x[name] for name in names if name in x}


def _ripple(x: Numbers) -> dict[str, float]:
    """A cos(n q) + B sin(n q) as one sine."""
    cosine, sine = (
        next(value for name, value in x.items() if name.startswith(f"ripple_{part}"))
        for part in ("cos", "sin")
    )
    amplitude, phase = math.hypot(cosine, sine), math.atan2(cosine, sine)
    return {"amplitude": amplitude, "order": x["order"], "phase": phase}


def _spring(x: Numbers) -> dict[str, float]:
    """K q + c, or a cos q + b sin q, by the angle at which the torque vanishes."""
    if "spring_cos" in x:
        moment = math.hypot(x["spring_cos"], x["spring_sin"])
        return {"moment": moment, "rest": -math.atan2(x["spring_cos"], x["spring_sin"])}
    return {"stiffness": x["k"], "rest": -x["moment"] / x["k"] if x["k"] else 0.0}


_TRANSLATION: dict[str, Callable[[Numbers], dict[str, float]]] = {
    "viscous_friction": _same("Fv"),
    "coulomb_friction": _same("Fc"),
    "stribeck_friction": _same("Fs", "velocity"),
    "asymmetric_friction": _same("Fc_plus", "Fc_minus", "Fv_plus", "Fv_minus"),
    "nonlinear_viscous_friction": _same("Fn", "exponent"),
    "load_dependent_friction": _same("Fl"),
    "presliding_hysteresis": _same("Fh", "distance"),
    "thermal_friction_drift": lambda x: {
        "Fv": x["Fv_cold"], "Fc": x["Fc_cold"], "time": x["time"]
    },
    "rotor_inertia": _same("Ia"),
    "torque_offset": _same("offset"),
    "torque_ripple": _ripple,
    "spring": _spring,
    "friction_coupling": _same("Fv", "Fc", "ratio"),
    "inertia_coupling": _same("Ic"),
    "torque_gain": lambda x: {"gain": 1 + x["gain"]},
    "time_delay": _same("delay"),
    "payload": lambda x: {name: x[f"payload_{name}"] for name in STANDARD},
    "inertial_parameters": lambda x: {name: x[f"delta_{name}"] for name in STANDARD},
}  # fmt: skip
_TOGETHER = ("friction_coupling", "inertia_coupling", "torque_gain", "time_delay")
_SHAPES = ("velocity", "exponent", "distance", "time", "order", "ratio")


def described(robot: Robot, effect: Any) -> list[HiddenEffect]:
    """One effect of a nominal arm, joint by joint where it acts on each alone.

    Raises:
        BadRobot: It has no values.
        UnknownName: The plant cannot have it as a known effect.
    """
    known = cast(_Known, effect)
    if known.name not in _TRANSLATION:
        raise UnknownName("effect of a nominal virtual arm", known.name, _TRANSLATION)
    if known.values is None:
        raise BadRobot(robot.source, f"effect {known.name} has no values; give them")
    symbols = [p.name.rsplit(".", 1)[-1] for p in known.parameters(robot)]
    shape = {name: getattr(effect, name) for name in _SHAPES if hasattr(effect, name)}
    together = known.name in _TOGETHER
    groups = [known.joints] if together else [(joint,) for joint in known.joints]
    width = len(symbols) // max(len(groups), 1)
    rows = np.reshape(known.values, (len(groups), width)).tolist()
    found = []
    for k, (joints, row) in enumerate(zip(groups, rows, strict=True)):
        numbers = dict(zip(symbols[k * width : (k + 1) * width], row, strict=True)) | shape
        parameters = tuple(_TRANSLATION[known.name](numbers).items())
        several = joints if len(joints) > 1 else ()
        found.append(HiddenEffect(known.name, (*joints, "")[0], parameters, several))
    return found
