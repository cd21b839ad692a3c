"""Structural identifiability under stated circumstances, and its numerical margin.

Every category is a decision on which sizes are zero; with nearly special geometry (a twist 1e-6 rad
off a right angle) it depends on the tolerance, and the result says so.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from excitant.exceptions import BadInput, UnknownName
from excitant.names import listed
from excitant.robots.base_parameters import (
    TOLERANCE,
    BaseParameters,
    Observation,
    categories,
    categories_of,
    dependence,
    independent_columns,
    observe,
    regroup,
    structural_motion,
)
from excitant.robots.effects import Effect
from excitant.robots.motion import Array, Motion, Noun
from excitant.robots.robot import Robot, own_axes

MARGIN = 1e3  # factor on the tolerance that must not change a category
HALF_DECADES = 6  # to there
PARALLEL = 1e-6  # sine of an angle, or distance [m], that counts as none
LISTED = 6  # parameters, or members of a vector, that are spelt out


@dataclass(frozen=True, eq=False)
class Structure(Noun):
    """Structural identifiability of each parameter, under stated circumstances."""

    base: BaseParameters  # of links and effects
    # unique, combined or unidentifiable, of each of ``base.names``
    category: tuple[str, ...]
    margin: Array  # factor on `TOLERANCE` that changes the category, at most `MARGIN`, shape (p,)
    circumstances: tuple[str, ...]  # under which it holds, as sentences
    close: tuple[str, ...]  # names of those whose margin is below `MARGIN`
    flips_at: Array  # tolerance at which the category changes, nan where it does not, shape (p,)
    # of the columns of all parameters, in units of the arm: greatest first, shape (p,), and what
    # each is seen of, one vector a row, shape (p, p); the last p − r span the null space
    singular_values: Array
    singular_vectors: Array
    # of the links, in their joint frames, (nv, 4, 4); those when None
    frames: Array | None = None

    def decomposition(self) -> dict[str, Any]:
        """Frames and, in those of Denavit and Hartenberg, singular values and vectors in words."""
        if self.frames is None:
            return {"frames": "joint"}
        return {
            "frames": "dh",
            "singular_values": self.singular_values.tolist(),
            "singular_vectors": [
                _members(row, self.base.names) for row in self.singular_vectors
            ],
        }

    @property
    def marginal(self) -> str | None:
        """A sentence on categories that a small change of the tolerance would change."""
        if not self.close:
            return None
        low = np.nanmin(self.flips_at)
        high = np.nanmax(self.flips_at)
        size = f"{low:.0e}" if high < 2 * low else f"{low:.0e} to {high:.0e}"
        return (
            f"{len(self.close)} of {len(self.base.names)} parameters have a category that depends "
            f"on about {size} of their torque (geometry, pose or mounting nearly special): "
            f"{listed(self.close, LISTED)}"
        )


def structure(
    robot: Robot,
    effects: Sequence[Effect] = (),
    *,
    moving: Sequence[str] | None = None,
    measured: Sequence[str] | None = None,
    anywhere: bool = False,
    frames: Array | None = None,
) -> Structure:
    """Structural identifiability of an arm's parameters; gravity and locked joints count.

    All joints move and are measured if None; the others are held at zero, or rest ``anywhere``, in
    many positions. Parameters are about the joint frames, or about frames in these, (nv, 4, 4).
    """
    named = (*(moving or ()), *(measured or ()))
    UnknownName.refuse("joint", named, robot.joints)
    motion = _circumstantial(robot, moving, anywhere)
    rows = None if measured is None else np.isin(robot.joints, measured)
    observation = observe(robot, effects, motion, rows, frames)
    base = regroup(observation)
    category = categories(base)
    flips_at = _flips(observation, base, category)
    margin = np.nan_to_num(
        np.maximum(flips_at / TOLERANCE, TOLERANCE / flips_at), nan=MARGIN
    )
    close = tuple(np.array(base.names)[np.isfinite(flips_at)].tolist())
    singular_values, singular_vectors = _decomposed(observation.R, category)
    return Structure(
        base,
        category,
        margin,
        _circumstances(robot, moving, measured, anywhere),
        close,
        flips_at,
        singular_values,
        singular_vectors,
        frames,
    )


def _decomposed(R: Array, category: Sequence[str]) -> tuple[Array, Array]:
    """Singular values (p,) and right singular vectors (p, p), those of absent columns last."""
    nonzero = np.array(category) != "unidentifiable"
    _, s, Vt = np.linalg.svd(R[:, nonzero], full_matrices=True)
    values = np.zeros(len(nonzero))
    vectors = np.zeros((len(nonzero), len(nonzero)))
    values[: len(s)] = s
    vectors[: len(Vt), nonzero] = Vt
    vectors[len(Vt) :, ~nonzero] = np.eye(int((~nonzero).sum()))
    return values, vectors


def _members(vector: Array, names: Sequence[str]) -> str:
    """Members of a unit vector that make nine tenths of it, six at most; the first is positive."""
    order = np.argsort(-np.abs(vector), kind="stable")
    count = int(np.searchsorted(np.cumsum(vector[order] ** 2), 0.9)) + 1
    text = ""
    first = vector[order[0]]
    for k in order[: min(count, LISTED)]:
        sign = (" − " if vector[k] * first < 0 else " + ") if text else ""
        size = f"{abs(vector[k]):.2g}"
        text += sign + ("" if size == "1" else f"{size}·") + names[k]
    return text + " + …" * (count > LISTED)


def _circumstantial(
    robot: Robot, moving: Sequence[str] | None, anywhere: bool
) -> Motion:
    motion = structural_motion(robot, np.random.default_rng(0))
    if moving is None:
        return motion
    still = ~np.isin(robot.joints, moving)
    q, dq, ddq = (np.array(x) for x in (motion.q, motion.dq, motion.ddq))
    dq[:, still] = ddq[:, still] = 0.0
    if not anywhere:
        q[:, still] = 0.0
    return replace(motion, q=q, dq=dq, ddq=ddq)


def _flips(
    observation: Observation, base: BaseParameters, category: tuple[str, ...]
) -> Array:
    """Tolerance nearest to the one in use at which each category changes, shape (p,)."""
    # in the middle of the half decade in which it does; nan if none within a factor of `MARGIN`
    R = observation.R
    accepted, rejected = base.gap
    usual = dependence(R, base.columns)
    flips_at = np.full(len(category), np.nan)
    for step in range(HALF_DECADES, 0, -1):  # the nearest is written last
        for sign in (1, -1):
            tolerance = TOLERANCE * 10 ** (sign * step / 2)
            leading, B = base.columns, usual
            if not rejected <= tolerance < accepted:  # others are independent
                leading, _ = independent_columns(R, tolerance)
                B = dependence(R, leading)
            other = categories_of(np.abs(B) >= tolerance, leading)
            changed = np.array(other) != np.array(category)
            flips_at[changed] = TOLERANCE * 10 ** (sign * (step - 0.5) / 2)
    return flips_at


def _circumstances(
    robot: Robot,
    moving: Sequence[str] | None,
    measured: Sequence[str] | None,
    anywhere: bool,
) -> tuple[str, ...]:
    circumstances = ["the base is fixed", _gravity_sentence(robot.gravity)]
    if robot.locked:
        locked = [f"{name} at {value:.4g}" for name, value in robot.locked]
        circumstances.append(f"{_joints(locked)} locked")
    still = [
        name for name in robot.joints if moving is not None and name not in moving
    ]
    if still:
        where = "at rest in many positions" if anywhere else "held at 0"
        circumstances.append(f"{_joints(still)} {where}")
    missing = [
        name
        for name in robot.joints
        if measured is not None and name not in measured
    ]
    if missing:
        circumstances.append(f"torque of {_joints(missing)} not measured")
    return tuple(circumstances)


def _joints(words: Sequence[str]) -> str:
    return f"{'joint' if len(words) == 1 else 'joints'} {', '.join(words)}"


def _gravity_sentence(gravity: Array) -> str:
    size = np.linalg.norm(gravity)
    if size == 0:
        return "no gravity"
    direction = gravity / size
    k = np.argmax(np.abs(direction))
    if abs(direction[k]) > 1 - 1e-12:
        return (
            f"gravity along {'−' if direction[k] < 0 else ''}{'xyz'[k]} of the base"
        )
    return f"gravity along ({', '.join(f'{x:.4g}' for x in direction)}) of the base"


def distal_frames(robot: Robot) -> Array:
    """Pose of each link's standard Denavit-Hartenberg frame in its joint frame, (nv, 4, 4).

    Frame i is on the axis of joint i + 1 where that is nearest to the axis of joint i, with x along
    the common normal; for the last link, on the z axis of the tool. What the axes leave open is as
    the description places the next joint, so that an arm given in this form has its own frames.

    Raises:
        BadInput: An arm that branches.
    """
    model = robot.model
    nv = robot.nv
    if list(model.parents)[1:] != list(range(nv)):
        raise BadInput(
            f"{robot.name} branches: Denavit-Hartenberg frames are those of one chain"
        )
    own = own_axes(robot)
    places = [
        *list(model.jointPlacements)[2:],
        list(model.frames)[robot.tip].placement,
    ]
    frames = np.tile(np.eye(4), (nv, 1, 1))
    for T, place, here, beyond in zip(
        frames, places, own, [*own[1:], np.eye(3)[2]], strict=True
    ):
        z = place.rotation @ beyond
        point = place.translation
        across = np.cross(here, z)
        x = place.rotation[:, np.argmin(np.abs(beyond))]
        if np.linalg.norm(across) > PARALLEL:
            steps = np.linalg.solve(np.column_stack([here, -z, across]), point)
            point = point + steps[1] * z
            normal = across
        else:
            normal = point - here * (here @ point)
        if np.linalg.norm(normal) > PARALLEL:
            x = normal if normal @ x >= 0 else -normal
        x = x - z * (z @ x)
        x = x / np.linalg.norm(x)
        T[:3] = np.column_stack([x, np.cross(z, x), z, point])
    return frames
