"""Whether a robot's description can be right: inertias, axes, limits, and the arm's own weight."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin

from excitant.robots.base_parameters import base_parameters
from excitant.robots.bodies import Body, bent_pose, bodies, sketch, zero_pose
from excitant.robots.check_inertias import ModelWarning, inertia_warnings
from excitant.robots.motion import Array
from excitant.robots.robot import Robot

_MASS = 0.05  # relative deviation from the stated mass that goes unsaid
_BASE = 0.4  # of the stated mass: what a base that the model leaves out may weigh
_SPOILS_WEIGHT = ("inertia_not_physical", "centre_of_mass")
_POSES = 600  # random ones that the search for the largest gravity torque starts from
_STEPS = 24  # positions that it tries of each joint in turn
_ROUNDS = 2
_UNIT = 1e-3  # deviation of an axis from length one that digits left out explain
_LEVEL = 1e-9  # N·m: no gravity torque
_EXACT = 1e-8  # rad: too little for a decision on what torque shows


@dataclass(frozen=True, eq=False)
class ModelCheck:
    """What an arm's description says, and what looks wrong in it.

    Attributes:
        robot: The arm.
        mass: What the whole arm weighs with its base, where that is known [kg].
    """

    robot: Robot
    mass: float | None = None

    @cached_property
    def bodies(self) -> tuple[Body, ...]:
        """The links as stated."""
        return bodies(self.robot)

    @cached_property
    def gravity_peaks(self) -> Array:
        """Largest gravity torque of each joint within the ranges, shape (nv,) [N·m or N]."""
        return gravity_peaks(self.robot)

    @property
    def moving_mass(self) -> float:
        """Mass that the joints move [kg]."""
        return float(self.robot.phi[::10].sum())

    @property
    def total_mass(self) -> float:
        """The same with the base as far as the description states it [kg]."""
        return self.moving_mass + sum(body.mass for body in self.bodies if not body.carrier)

    @cached_property
    def warnings(self) -> tuple[ModelWarning, ...]:
        """Everything that looks wrong, hints last.

        A warning names what is almost surely wrong or missing; a hint what may well be right.
        """
        robot = self.robot
        found = [
            *inertia_warnings(robot, self.bodies),
            *axis_warnings(robot),
            *limit_warnings(robot),
            *self._mass_warnings(),
        ]
        if not any(warning.check in _SPOILS_WEIGHT for warning in found):
            found += gravity_warnings(robot, self.gravity_peaks)
        return tuple(sorted(found, key=lambda warning: warning.hint))

    def _mass_warnings(self) -> Iterator[ModelWarning]:
        moving, total, stated = self.moving_mass, self.total_mass, self.mass
        if stated is None or abs(total - stated) <= _MASS * stated:
            return
        rest = stated - total
        if total == moving and 0 < rest <= _BASE * stated:
            yield ModelWarning(
                "total_mass",
                (self.robot.name,),
                f"its links weigh {moving:.4g} kg and its base states no mass; {stated:.4g} kg is "
                f"right if the base weighs {rest:.3g} kg",
                hint=True,
            )
            return
        yield ModelWarning(
            "total_mass",
            (self.robot.name,),
            f"the description weighs {total:.4g} kg, {abs(rest):.3g} kg "
            f"{'less' if rest > 0 else 'more'} than the {stated:.4g} kg stated; look for links "
            "that lack mass, count twice or have another unit",
        )

    def result(self) -> dict[str, Any]:
        """Joints, links, limits, effects and warnings, for ``result.json``."""
        robot, limits = self.robot, self.robot.limits
        joints = [
            {
                "name": joint,
                "link": robot.links[j],
                "kind": "revolute" if robot.revolute[j] else "prismatic",
                "position": [_finite(x) for x in limits.position[j]],
                "velocity": _finite(limits.velocity[j]),
                "acceleration": _finite(limits.acceleration[j]),
                "torque": _finite(limits.torque[j]),
                "gravity_torque": _finite(self.gravity_peaks[j]),
                "mass": float(robot.phi[10 * j]),
            }
            for j, joint in enumerate(robot.joints)
        ]
        values = [
            {"effect": effect.name, "name": parameter.name, "value": value, "unit": parameter.unit}
            for effect in robot.effects
            if effect.values is not None
            for parameter, value in zip(effect.parameters(robot), effect.values, strict=True)
        ]
        return {
            "verb": "robots",
            "robot": robot.name,
            "name": robot.name,
            "mass": self.moving_mass,
            "total_mass": self.total_mass,
            "stated_mass": self.mass,
            "gravity": robot.gravity.tolist(),
            "base_parameters": len(base_parameters(robot)),
            "effects": [effect.name for effect in robot.effects],
            "effect_values": values,
            "warnings": [{**asdict(w), "where": list(w.where)} for w in self.warnings],
            "joints": joints,
            "links": [_link(body) for body in self.bodies],
            "locked": dict(robot.locked),
            "parameters": dict(zip(robot.parameter_names, robot.phi.tolist(), strict=True)),
            "notes": list(robot.notes),
        }

    def series(self) -> dict[str, Array]:
        """What a picture of the arm needs: ``zero_`` and ``bent_`` with the keys of `sketch`."""
        poses = {"zero": zero_pose(self.robot), "bent": bent_pose(self.robot)}
        return {
            f"{name}_{key}": array
            for name, q in poses.items()
            for key, array in sketch(self.robot, q).items()
        }


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _link(body: Body) -> dict[str, Any]:
    moments = np.linalg.eigvalsh(body.inertia)
    spread = np.linalg.eigvalsh(body.second_moment)[-1] if body.mass > 0 else 0.0
    return {
        "link": body.link,
        "moves_with": body.carrier or None,
        "mass": body.mass,
        "com": body.com.tolist(),
        "principal_moments": moments.tolist(),
        "radius_of_gyration": float(np.sqrt(max(spread, 0.0))),
        "size": body.size,
        "solids": len(body.shapes),
    }


def axis_warnings(robot: Robot) -> Iterator[ModelWarning]:
    """Axes that are no directions; rounded angles; mirrored meshes; neighbours of opposite axes."""
    root = ET.fromstring(robot.urdf)
    elements = {str(joint.get("name")): joint for joint in root.findall("joint")}
    for joint in robot.joints:
        if joint not in elements:
            continue
        axis = elements[joint].find("axis")
        text = "1 0 0" if axis is None else axis.get("xyz", "1 0 0")
        length = float(np.linalg.norm([float(x) for x in text.split()]))
        if abs(length - 1) > _UNIT:
            yield ModelWarning(
                "joint_axis",
                (joint,),
                f'its axis "{text}" has length {length:.4g}; write a unit vector',
            )
    yield from _rounded(root)
    for link in root.findall("link"):
        for mesh in link.iter("mesh"):
            scale = [float(x) for x in mesh.get("scale", "1 1 1").split()]
            if np.prod(scale) < 0:
                yield ModelWarning(
                    "mirrored_mesh",
                    (str(link.get("name")),),
                    f"a mesh of it is mirrored (scale {mesh.get('scale')}), which makes its frame "
                    "left-handed; mirror its inertia and axes too, or export the true part",
                    hint=True,
                )
                break
    yield from _opposite(robot)


def _rounded(root: ET.Element) -> Iterator[ModelWarning]:
    """Multiples of 45° between joints that are written with few digits."""
    found: dict[str, tuple[str, float]] = {}
    for joint in root.findall("joint"):
        origin = joint.find("origin")
        for text in ("" if origin is None else origin.get("rpy", "")).split():
            meant = round(4 * float(text) / np.pi) * np.pi / 4
            digits = len(text.partition(".")[2])
            if digits > 1 and meant and _EXACT < abs(float(text) - meant) < 10.0**-digits:
                found.setdefault(str(joint.get("name")), (text, meant))
    if found:
        text, meant = next(iter(found.values()))
        yield ModelWarning(
            "rounded_angles",
            tuple(found),
            f"angles such as {text} are rounded; torque then depends, by a hair, on what the exact "
            f"one hides, and what hardly shows is identified badly; write {meant!r}",
            hint=True,
        )


def _opposite(robot: Robot) -> Iterator[ModelWarning]:
    """Links of equal mass one after the other whose parallel axes point in opposite directions."""
    axes, phi = robot.axes(np.zeros(robot.nv)), robot.phi.reshape(-1, 10)
    for j in range(robot.nv - 1):
        alike = np.allclose(phi[j, 0], phi[j + 1, 0], rtol=1e-9)
        own, next_own = (np.sort(np.abs(phi[k, [4, 6, 9]])) for k in (j, j + 1))
        alike = alike and np.allclose(own, next_own, rtol=1e-6) and phi[j, 0] > 0
        same_kind = robot.revolute[j] == robot.revolute[j + 1]
        if alike and same_kind and axes[j] @ axes[j + 1] < -1 + 1e-9:
            yield ModelWarning(
                "opposite_axes",
                (robot.joints[j], robot.joints[j + 1]),
                "equal links whose parallel axes differ in sign only; check that the arm counts "
                "these angles in opposite directions",
                hint=True,
            )


def limit_warnings(robot: Robot) -> Iterator[ModelWarning]:
    """Limits that are absent, zero or upside down, and zeros that lie outside them."""
    root = ET.fromstring(robot.urdf)
    elements = {str(joint.get("name")): joint.find("limit") for joint in root.findall("joint")}
    kinds = {str(joint.get("name")): joint.get("type") for joint in root.findall("joint")}
    for name, values, unit in (
        ("velocity", robot.limits.velocity, "rad/s or m/s"),
        ("effort", robot.limits.torque, "N·m or N"),
    ):
        absent = [j for j, x in zip(robot.joints, values, strict=True) if not np.isfinite(x)]
        if absent:
            yield ModelWarning(
                f"no_{name}_limit",
                tuple(absent),
                f"no {name} limit, or zero, so that nothing bounds it here; give it in the "
                f"<limit> [{unit}] or with --limits",
            )
    for j, joint in enumerate(robot.joints):
        low, high = robot.limits.position[j]
        limit = elements.get(joint)
        if not np.isfinite([low, high]).all() and kinds.get(joint) != "continuous":
            given = "none" if limit is None else f"{limit.get('lower')} to {limit.get('upper')}"
            yield ModelWarning(
                "position_limits",
                (joint,),
                f"its range ({given}) is empty or missing and was taken for unlimited; give lower "
                "< upper, or make it continuous",
            )
        elif low > 0 or high < 0:
            yield ModelWarning(
                "zero_outside_limits",
                (joint,),
                f"its zero lies outside its range, {low:.4g} to {high:.4g}, so that the arm "
                "cannot stand at zero; name another pose where one is asked for (--from, lock)",
                hint=True,
            )


def gravity_warnings(robot: Robot, peak: Array) -> Iterator[ModelWarning]:
    """Joints that cannot hold the arm in every pose."""
    for joint, torque, limit, turns in zip(
        robot.joints, peak, robot.limits.torque, robot.revolute, strict=True
    ):
        if torque > limit:
            unit = "N·m" if turns else "N"
            yield ModelWarning(
                "gravity",
                (joint,),
                f"gravity takes up to {torque:.3g} {unit} of its {limit:.3g} {unit}, so that it "
                "cannot hold the arm in every pose; check masses and effort limit",
            )


def gravity_peaks(robot: Robot) -> Array:
    """Largest gravity torque of each joint within the ranges, by search, (nv,) [N·m or N]."""
    model, data = robot.model, robot.model.createData()

    def weight(q: Array) -> Array:
        tau: Array = np.abs(np.asarray(pin.computeGeneralizedGravity(model, data, q), float))
        return tau

    poses = robot.random_motion(np.random.default_rng(0), _POSES)[0]
    tau = np.array([weight(q) for q in poses])
    low, high = np.clip(robot.limits.position, -np.pi, np.pi).T
    best = poses[tau.argmax(axis=0)]
    peak: Array = tau.max(axis=0)
    for j in np.flatnonzero(peak > _LEVEL):
        for _ in range(_ROUNDS):
            for k in range(robot.nv):
                for x in np.linspace(low[k], high[k], _STEPS):
                    q = best[j].copy()
                    q[k] = x
                    if (torque := weight(q)[j]) > peak[j]:
                        peak[j], best[j] = torque, q
    return np.where(peak > _LEVEL, peak, 0.0)
