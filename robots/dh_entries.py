"""Denavit-Hartenberg arms in a ``robot.yaml``.

::

    name: scara                  # the file's name when not given
    convention: standard         # or modified (Craig)
    angles: degrees              # of alpha, theta and rpy; radians when not given
    dh:                          # one entry per joint, from the base outward
      - {a: 0.4, alpha: 0, d: 0.3, theta: 0, type: revolute, joint: shoulder, link: upper_arm,
         m: 5.0, com: [-0.2, 0, 0], Ic: {xx: 0.01, yy: 0.07, zz: 0.07},
         collision: [{from: [-0.4, 0, 0], to: [0, 0, 0], radius: 0.05}]}
      - {a: 0.3, m: 3.0, mc: [-0.4, 0, 0], I: {xx: 0.01, yy: 0.1, zz: 0.1}}
    base: {position: [0, 0, 0.5], rpy: [0, 0, 0], collision: []}   # frame 0 in the base frame
    tool: {position: [0, 0, 0.1], rpy: [0, 0, 0]}                  # the tool in the last frame
    gravity: [0, 0, -9.81]                                         # in the base frame

Numbers left out are 0, ``type`` is ``revolute``, names are ``joint1``, ``link1``, and so on. In
the modified convention ``a`` and ``alpha`` are Craig's a_{i−1} and α_{i−1}. Every link needs its
mass ``m`` [kg]. Its centre of mass is ``com`` [m], or its first moment ``mc`` [kg·m]; its inertia
tensor [kg·m²] is ``I`` about the origin of the link frame, or ``Ic`` about the centre of mass,
both along the axes of the link frame, with products as tensor elements (xy is −∫ x y dm).
``limits``, ``lock``, ``joints`` and ``effects`` are as for any arm.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from excitant.exceptions import BadRobot, UnknownName
from excitant.robots.dh import CONVENTIONS, Cylinder, DHChain
from excitant.robots.motion import Array

_NUMBERS = ("a", "d", "alpha", "theta")
_KEYS = (*_NUMBERS, "type", "joint", "link", "m", "com", "mc", "I", "Ic", "collision")
_TENSOR = ("xx", "xy", "yy", "xz", "yz", "zz")
_ANGLES = {"radians": 1.0, "degrees": np.pi / 180}


def chain_from_entries(content: Mapping[str, Any], source: str, gravity: Array) -> DHChain:
    """The chain that a ``robot.yaml`` describes; see the module for its form.

    Args:
        content: The file's entries.
        source: The file, for messages.
        gravity: Gravity in the base frame, shape (3,) [m/s²].

    Raises:
        BadRobot: An entry that is missing, unknown or no number; names the link.
    """
    entries = content["dh"]
    if not isinstance(entries, list) or not entries:
        raise BadRobot(source, "'dh' must be a list with one entry 'a, d, alpha, m, ..' per joint")
    convention = _choice(content, "convention", CONVENTIONS, source)
    angles = _choice({"angles": "radians", **content}, "angles", tuple(_ANGLES), source)
    unit = _ANGLES[angles]
    names = [_names(entry, i, source) for i, entry in enumerate(entries, start=1)]
    joints, links = zip(*names, strict=True)
    rows = zip(entries, links, strict=True)
    numbers = np.array([[_number(e, key, link, source) for key in _NUMBERS] for e, link in rows])
    base, tool = (_place(content, key, unit, source) for key in ("base", "tool"))
    on_base = (content.get("base") or {}).get("collision")
    return DHChain(
        name=str(content.get("name") or Path(source).stem),
        convention=convention,
        joints=joints,
        links=links,
        revolute=np.array([_revolute(e, n, source) for e, n in zip(entries, links, strict=True)]),
        a=numbers[:, 0],
        d=numbers[:, 1],
        alpha=unit * numbers[:, 2],
        theta=unit * numbers[:, 3],
        phi=np.concatenate([_phi(e, n, source) for e, n in zip(entries, links, strict=True)]),
        gravity=gravity,
        base=base,
        tool=tool,
        shapes=tuple(
            shape
            for i, given in enumerate((on_base, *(e.get("collision") for e in entries)))
            for shape in _shapes(given, i, ("base", *links)[i], source)
        ),
    )


def _choice(content: Mapping[str, Any], key: str, known: Sequence[str], source: str) -> Any:
    value = content.get(key)
    if value not in known:
        raise BadRobot(source, f"'{key}: {value}' must be one of {', '.join(known)}")
    return value


def _names(entry: Any, i: int, source: str) -> tuple[str, str]:
    if not isinstance(entry, dict):
        raise BadRobot(source, f"dh entry {i} must hold 'a, d, alpha, theta, m, ..'")
    joint, link = str(entry.get("joint", f"joint{i}")), str(entry.get("link", f"link{i}"))
    for key in entry:
        if key not in _KEYS:
            raise BadRobot(source, f"{link}: {UnknownName('entry', str(key), _KEYS)}")
    return joint, link


def _revolute(entry: Mapping[str, Any], link: str, source: str) -> bool:
    kind = entry.get("type", "revolute")
    if kind not in ("revolute", "prismatic"):
        raise BadRobot(source, f"{link}: type '{kind}' must be revolute or prismatic")
    return bool(kind == "revolute")


def _number(entry: Mapping[str, Any], key: str, owner: str, source: str) -> float:
    return float(_numbers(entry.get(key, 0.0), (), f"{key}", owner, source))


def _numbers(value: Any, shape: tuple[int, ...], key: str, owner: str, source: str) -> Array:
    try:
        numbers = np.asarray(value, float)
    except (TypeError, ValueError):
        numbers = np.array(np.nan)
    if numbers.shape != shape or not np.isfinite(numbers).all():
        wanted = "a number" if not shape else f"{shape[0]} numbers"
        raise BadRobot(source, f"{owner}: {key} = {value} must be {wanted}")
    return numbers


def _phi(entry: Mapping[str, Any], link: str, source: str) -> Array:
    """Standard parameters about the link frame, shape (10,)."""
    for one, other in (("com", "mc"), ("I", "Ic")):
        if one in entry and other in entry:
            raise BadRobot(source, f"{link}: both '{one}' and '{other}' are given; keep one")
    m = _number(entry, "m", link, source)
    if m <= 0:
        raise BadRobot(source, f"{link}: mass m = {m:g} kg must be given and positive")
    key = "com" if "com" in entry else "mc"
    mc = _numbers(entry.get(key, np.zeros(3)), (3,), key, link, source)
    mc = m * mc if key == "com" else mc
    key = "Ic" if "Ic" in entry else "I"
    given = entry.get(key)
    if not isinstance(given, dict) or not set(given) <= set(_TENSOR):
        raise BadRobot(
            source,
            f"{link}: give the inertia as 'I: {{xx: .., yy: .., zz: .., xy: ..}}' about the link "
            "frame, or as 'Ic' about the centre of mass",
        )
    tensor = np.array([_number(given, t, f"{link}: {key}", source) for t in _TENSOR])
    if key == "Ic":
        c = mc / m
        tensor += m * np.array([c @ c - c[0] ** 2, -c[0] * c[1], c @ c - c[1] ** 2,
                                -c[0] * c[2], -c[1] * c[2], c @ c - c[2] ** 2])  # fmt: skip
    return np.concatenate([[m], mc, tensor])


def _place(content: Mapping[str, Any], key: str, unit: float, source: str) -> Array:
    given = content.get(key) or {}
    if not isinstance(given, dict) or not set(given) <= {"position", "rpy", "collision"}:
        raise BadRobot(source, f"'{key}' must hold 'position: [x, y, z]' and 'rpy: [r, p, y]'")
    T = np.eye(4)
    T[:3, 3] = _numbers(given.get("position", np.zeros(3)), (3,), "position", key, source)
    rpy = unit * _numbers(given.get("rpy", np.zeros(3)), (3,), "rpy", key, source)
    T[:3, :3] = pin.rpy.rpyToMatrix(*rpy)
    return T


def _shapes(given: Any, link: int, name: str, source: str) -> list[Cylinder]:
    if given is None:
        return []
    if not isinstance(given, list) or not all(
        isinstance(s, dict) and set(s) == {"from", "to", "radius"} for s in given
    ):
        raise BadRobot(
            source, f"{name}: 'collision' must list entries 'from: [..], to: [..], radius: ..'"
        )
    found = []
    for shape in given:
        start, end = (_numbers(shape[k], (3,), k, name, source) for k in ("from", "to"))
        radius = _number(shape, "radius", name, source)
        if radius <= 0:
            raise BadRobot(source, f"{name}: collision radius {radius:g} m must be positive")
        x, y, z = start.tolist()
        u, v, w = end.tolist()
        found.append(Cylinder(link, (x, y, z), (u, v, w), radius))
    return found
