"""Joints whose axes, limits or torques look wrong."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator

import numpy as np
import pinocchio as pin

from excitant.robots.model_check_warning import ModelWarning
from excitant.robots.motion import Array
from excitant.robots.robot import Robot

_POSES = 600  # random ones that the search for the largest gravity torque starts from
_STEPS = 24  # positions that it tries of each joint in turn
_ROUNDS = 2
_UNIT = 1e-3  # deviation of an axis from length one that digits left out explain
_LEVEL = 1e-9  # N·m: no gravity torque
_EXACT = 1e-8  # rad: too little for a decision on what torque shows


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
                "joint_axis", (joint,),
                f'its axis "{text}" has length {length:.4g}; write a unit vector',
            )  # fmt: skip
    yield from _rounded(root)
    for link in root.findall("link"):
        for mesh in link.iter("mesh"):
            scale = [float(x) for x in mesh.get("scale", "1 1 1").split()]
            if np.prod(scale) < 0:
                yield ModelWarning(
                    "mirrored_mesh", (str(link.get("name")),),
                    f"a mesh of it is mirrored (scale {mesh.get('scale')}), which makes its frame "
                    "left-handed; mirror its inertia and axes too, or export the true part",
                    hint=True,
                )  # fmt: skip
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
            "rounded_angles", tuple(found),
            f"angles such as {text} are rounded; torque then depends, by a hair, on what the exact "
            f"one hides, and what hardly shows is identified badly; write {meant!r}",
            hint=True,
        )  # fmt: skip


def _opposite(robot: Robot) -> Iterator[ModelWarning]:
    """Links of equal mass one after the other whose parallel axes point in opposite directions."""
    data = robot.model.createData()
    J = pin.computeJointJacobians(robot.model, data, np.zeros(robot.nv))
    axes = np.where(robot.revolute[:, None], J[3:].T, J[:3].T)
    phi = robot.phi.reshape(-1, 10)
    for j in range(robot.nv - 1):
        alike = np.allclose(phi[j, 0], phi[j + 1, 0], rtol=1e-9)
        own, next_own = (np.sort(np.abs(phi[k, [4, 6, 9]])) for k in (j, j + 1))
        alike = alike and np.allclose(own, next_own, rtol=1e-6) and phi[j, 0] > 0
        same_kind = robot.revolute[j] == robot.revolute[j + 1]
        if alike and same_kind and axes[j] @ axes[j + 1] < -1 + 1e-9:
            yield ModelWarning(
                "opposite_axes", (robot.joints[j], robot.joints[j + 1]),
                "equal links whose parallel axes differ in sign only; check that the arm counts "
                "these angles in opposite directions",
                hint=True,
            )  # fmt: skip


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
                f"no_{name}_limit", tuple(absent),
                f"no {name} limit, or zero, so that nothing bounds it here; give it in the "
                f"<limit> [{unit}] or with --limits",
            )  # fmt: skip
    for j, joint in enumerate(robot.joints):
        low, high = robot.limits.position[j]
        limit = elements.get(joint)
        if not np.isfinite([low, high]).all() and kinds.get(joint) != "continuous":
            given = "none" if limit is None else f"{limit.get('lower')} to {limit.get('upper')}"
            yield ModelWarning(
                "position_limits", (joint,),
                f"its range ({given}) is empty or missing and was taken for unlimited; give lower "
                "< upper, or make it continuous",
            )  # fmt: skip
        elif low > 0 or high < 0:
            yield ModelWarning(
                "zero_outside_limits", (joint,),
                f"its zero lies outside its range, {low:.4g} to {high:.4g}, so that the arm "
                "cannot stand at zero; name another pose where one is asked for (--from, lock)",
                hint=True,
            )  # fmt: skip


def gravity_warnings(robot: Robot) -> Iterator[ModelWarning]:
    """Joints that cannot hold the arm in every pose."""
    peak, _ = gravity_peaks(robot)
    for joint, torque, limit, turns in zip(
        robot.joints, peak, robot.limits.torque, robot.revolute, strict=True
    ):
        if torque > limit:
            unit = "N·m" if turns else "N"
            yield ModelWarning(
                "gravity", (joint,),
                f"gravity takes up to {torque:.3g} {unit} of its {limit:.3g} {unit}, so that it "
                "cannot hold the arm in every pose; check masses and effort limit",
            )  # fmt: skip


def gravity_peaks(robot: Robot) -> tuple[Array, Array]:
    """Largest gravity torque of each joint within the ranges, found by search.

    Returns:
        Torques, shape (nv,) [N·m or N], and the pose of each, shape (nv, nv) [rad or m].
    """
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
    return np.where(peak > _LEVEL, peak, 0.0), best
