"""Closed-form grouping rules of serial arms, read off the Denavit-Hartenberg numbers alone.

Gautier and Khalil, "Direct calculation of minimum set of inertial parameters of serial robots"
(IEEE T-RA 1990); Khalil and Dombre, "Modeling, Identification and Control of Robots" (2002),
chapter 9. In their frames (modified Denavit-Hartenberg) the parameters YY, MZ, M of a revolute
link and the six inertias of a prismatic link group into the link before. With r1 the first
revolute joint and r2 the first one after it that is not parallel to it, links before r2 show
less:

    revolute, r1 ≤ j < r2      ZZ, and MX, MY unless its axis stands still and gravity is along it
    prismatic, j < r1          M
    prismatic, r1 < j < r2     M, and across r1: the two first moments not along r1
    revolute, j ≥ r2           XX − YY, XY, XZ, YZ, ZZ, MX, MY
    prismatic, j ≥ r2          M, MX, MY, MZ

The rules presume gravity, or that all revolute axes are parallel.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate

import numpy as np

from excitant.exceptions import BadInput
from excitant.robots.dh import DHChain, dh_from_robot, inverse, moved_parameters
from excitant.robots.motion import Array, freeze
from excitant.robots.parameters import STANDARD
from excitant.robots.robot import Robot

_SAME = 1e-9  # rad, or parts of the chain's length
_INDEX = {name: k for k, name in enumerate(STANDARD)}
_INERTIAS = ("Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")


@dataclass(frozen=True, eq=False)
class Grouping:
    """What the rules say of an arm.

    Attributes:
        names: Names of the standard parameters, p of them.
        shown: Number of base parameters that each link brings, one per link.
        rule: Which rule each link follows.
        null_space: Orthonormal basis of the null space in the robot's joint frames, (p, p − r).
    """

    names: tuple[str, ...]
    shown: tuple[int, ...]
    rule: tuple[str, ...]
    null_space: Array

    def __post_init__(self) -> None:
        freeze(self, "null_space")

    def __len__(self) -> int:
        """Number r of base parameters."""
        return sum(self.shown)


def grouping(robot: Robot) -> Grouping:
    """Base parameters of an arm by rule.

    Args:
        robot: A serial arm.

    Raises:
        BadRobot: Joints that branch.
        BadInput: No gravity, and axes that are not parallel: no rule is published for it.
    """
    chain = dh_from_robot(robot, "modified")
    frames = _frames_in_joints(robot, chain)
    kinds = _rules(chain)
    lost = [_lost(chain, j, kind) for j, kind in enumerate(kinds)]
    N = np.zeros((10 * chain.nv, sum(len(u) for u in lost)))
    column = 0
    for j, directions in enumerate(lost):
        end = column + len(directions)
        N[10 * j : 10 * j + 10, column:end] = _about(frames[j], directions).T
        if j > 0:
            before = into_previous(chain, j, directions)
            N[10 * j - 10 : 10 * j, column:end] = -_about(frames[j - 1], before).T
        column = end
    basis = np.linalg.qr(N / np.linalg.norm(N, axis=0))[0]
    shown = tuple(10 - len(u) for u in lost)
    return Grouping(robot.parameter_names, shown, kinds, basis)


def largest_count(revolute: int, prismatic: int, first_along_gravity: bool) -> int:
    """Most base parameters an arm can have: 7 n_r + 4 n_p − 4 − 2 n_g, n_g 0 or 1.

    For revolute arms with parallel or orthogonal axes, of which the first two are not parallel,
    this is the count itself (Mayeda, Yoshida and Osuka, IEEE T-RA 1990).

    Args:
        revolute: Number n_r of revolute joints, at least one.
        prismatic: Number n_p of prismatic joints.
        first_along_gravity: Whether the first joint is revolute and along gravity (n_g = 1).
    """
    return 7 * revolute + 4 * prismatic - 4 - 2 * first_along_gravity


def _frames_in_joints(robot: Robot, chain: DHChain) -> Array:
    """Pose of each link's frame of the chain in the robot's own joint frame, (nv, 4, 4)."""
    placements = list(robot.model.jointPlacements)[1:]
    poses = list(accumulate((place.homogeneous for place in placements), np.matmul))
    frames: Array = inverse(np.array(poses)) @ chain.frames(np.zeros((1, chain.nv)))[0, 1:]
    return frames


def _about(T: Array, phi: Array) -> Array:
    """Parameters about the robot's joint frame, from those about the chain's link frame."""
    return moved_parameters(phi, np.broadcast_to(T, (len(phi), 4, 4)))


def _rules(chain: DHChain) -> tuple[str, ...]:
    """The rule that each link follows."""
    frames = chain.frames(np.zeros((1, chain.nv)))[0, 1:]
    axes, points = frames[:, :3, 2], frames[:, :3, 3]
    turning = [j for j in range(chain.nv) if chain.revolute[j]]
    first = turning[0] if turning else chain.nv
    other = next((j for j in turning if not _along(axes[j], axes[first])), chain.nv)
    if not chain.gravity.any() and other < chain.nv:
        raise BadInput(
            f"{chain.name}: without gravity the closed-form rules only hold for parallel axes; "
            "use parameter_nullspace"
        )
    slides = [k for k in range(other) if not chain.revolute[k]]
    found = []
    for j in range(chain.nv):
        if j >= other:
            found.append("revolute" if chain.revolute[j] else "prismatic")
        elif not chain.revolute[j]:
            across = j > first and not _along(axes[j], axes[first])
            found.append("prismatic across r1" if across else "prismatic, mass only")
        else:
            still = all(_same_line(axes[j], points[k] - points[j], chain) for k in turning if k < j)
            still &= all(_along(axes[k], axes[first]) for k in slides if k < j)
            still &= _along(chain.gravity, axes[first])
            found.append("parallel to r1, standing still" if still else "parallel to r1")
    return tuple(found)


def _along(a: Array, b: Array) -> bool:
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return bool(np.linalg.norm(np.cross(a, b)) <= _SAME * size)


def _same_line(axis: Array, gap: Array, chain: DHChain) -> bool:
    length = float(np.abs(chain.a).sum() + np.abs(chain.d).sum())
    return bool(np.linalg.norm(np.cross(axis, gap)) <= _SAME * length)


def _lost(chain: DHChain, j: int, rule: str) -> Array:
    """Directions of a link's parameters that group into the link before or show nowhere, (k, 10).

    About the link's frame.
    """
    unit = np.eye(10)
    if rule == "revolute":
        both = unit[_INDEX["Ixx"]] + unit[_INDEX["Iyy"]]
        return np.array([both, unit[_INDEX["mcz"]], unit[_INDEX["m"]]])
    kept = {
        "prismatic": ("m", "mcx", "mcy", "mcz"),
        "prismatic across r1": ("m", "mcx", "mcy", "mcz"),
        "prismatic, mass only": ("m",),
        "parallel to r1": ("Izz", "mcx", "mcy"),
        "parallel to r1, standing still": ("Izz",),
    }[rule]
    lost = unit[[k for name, k in _INDEX.items() if name not in kept]]
    if rule != "prismatic across r1":
        return lost
    frames = chain.frames(np.zeros((1, chain.nv)))[0, 1:]
    first = int(np.argmax(chain.revolute))
    along = np.zeros(10)
    along[1:4] = frames[j, :3, :3].T @ frames[first, :3, 2]
    return np.vstack([lost, along])


def into_previous(chain: DHChain, j: int, phi: Array) -> Array:
    """Parameters about frame j − 1 of what has parameters φ about frame j, (k, 10), q_j = 0.

    For a revolute joint and parameters that turning about its axis does not change (YY with XX,
    MZ, M), these are the published relations, with α, d of Khalil and Dombre's table called
    alpha, a here, and their r called d.
    """
    if chain.revolute[j] and _turns_into_itself(phi):
        return _published(chain.a[j], chain.d[j], chain.alpha[j], phi)
    return moved_parameters(phi, chain.poses(np.zeros((1, chain.nv)))[0, [j] * len(phi)])


def _turns_into_itself(phi: Array) -> bool:
    others = [_INDEX[name] for name in ("mcx", "mcy", "Ixy", "Ixz", "Iyz", "Izz")]
    alike = np.array_equal(phi[:, _INDEX["Ixx"]], phi[:, _INDEX["Iyy"]])
    return alike and not phi[:, others].any()


def _published(a: float, d: float, alpha: float, phi: Array) -> Array:
    """Relations (9.34) of Khalil and Dombre for YY, MZ and M of a revolute link."""
    c, s = np.cos(alpha), np.sin(alpha)
    YY, MZ, M = (phi[:, _INDEX[name]] for name in ("Iyy", "mcz", "m"))
    h = 2 * d * MZ + d**2 * M
    moved = {
        "m": M,
        "mcx": a * M,
        "mcy": -s * (MZ + d * M),
        "mcz": c * (MZ + d * M),
        "Ixx": YY + h,
        "Ixy": a * s * (MZ + d * M),
        "Ixz": -a * c * (MZ + d * M),
        "Iyy": c**2 * (YY + h) + a**2 * M,
        "Iyz": c * s * (YY + h),
        "Izz": s**2 * (YY + h) + a**2 * M,
    }
    return np.column_stack([moved[name] for name in STANDARD])
