"""Plausibility checks of a robot's description: inertias, axes, limits, gravity torques.

With the second moment per mass about the centre of mass, S = ½ tr(I)/m 1 − I/m, a link of given
extent has S no larger than its box allows, the long axis of S along the link, and a centre of mass
within. A tensor about the joint frame given as one about the centre of mass c shows as S + c cᵀ
(Steiner).
"""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from itertools import islice
from typing import Any
from xml.etree.ElementTree import Element, fromstring

import numpy as np
import pinocchio as pin

from excitant.robots.appearance import Appearance
from excitant.robots.base_parameters import base_parameters
from excitant.robots.geometry import Body, zero_pose
from excitant.robots.limits import endless_ranges
from excitant.robots.motion import Array, numbered
from excitant.robots.parameters import PLACEHOLDER, elements, violations
from excitant.robots.regressor import rigid_body_torque
from excitant.robots.robot import Robot, spans
from excitant.robots.urdf_writer import child_attribute, floats, stated_joints

_MASS = 0.05  # relative deviation from the stated mass that goes unsaid
_BASE = 0.4  # of the stated mass: what a base that the model leaves out may weigh
_SPOILS_WEIGHT = ("inertia_not_physical", "centre_of_mass")
_POSES = (
    600  # random ones that the search for the largest gravity torque starts from
)
_STEPS = 24  # positions that it tries of each joint in turn
_ROUNDS = 2
_UNIT = 1e-3  # deviation of an axis from length one that digits left out explain
_LEVEL = 1e-9  # N·m: no gravity torque
_SLIDE = 0.3  # m: how far a sliding joint is shown to move

_OUTSIDE = {True: 0.15, False: 0.5}  # of the link's size, with and without solids
_TOO_WIDE = 1.0  # radius of gyration over the link's size; a half is possible
_TOO_NARROW = 0.02
_EXTENT = 0.02  # m: joints closer together say nothing about a link's size
_LIGHT = 0.1  # kg/m of link
# ratio of the two largest second moments: of the solids, of the inertia
_ELONGATED = (4.0, 3.0)
_ACROSS = 50.0  # degrees between both long axes
_EXCESS = 0.75  # a tensor about the joint: how far off
_CLOSER = 0.4  # how much nearer without it
_LEVER = 0.05  # of the arm: centres of mass nearer to the joint make no difference worth a word
_SLIGHT = 0.01  # of a joint's torque: what changes less matters to none
_ROUNDING = 1e-3  # relative violation that digits left out explain
_UNSEEN = "hardly any torque depends on it"  # makes a hint of a warning


@dataclass(frozen=True)
class ModelWarning:
    """A suspicious entry of the description, its place, and the remedy."""

    check: str  # which check says so, e.g. "placeholder_inertia"
    where: tuple[str, ...]  # the links or joints concerned
    sentence: str  # what was found and what to do, in one line
    hint: bool = False  # it may well be right, or matters to no torque

    def __str__(self) -> str:
        return f"{', '.join(self.where)}: {self.sentence}"


Warnings = Iterator[ModelWarning]


@dataclass(frozen=True, eq=False)
class ModelCheck:
    """Summary of an arm's description with warnings.

    Attributes:
        robot: The arm.
        mass: What the whole arm weighs with its base, where that is known [kg].
    """

    robot: Robot
    mass: float | None = None

    @cached_property
    def bodies(self) -> tuple[Body, ...]:
        """The links as stated."""
        return self.robot.format.bodies(self.robot)

    @cached_property
    def gravity_peaks(self) -> Array:
        """Largest gravity torque of each joint within the ranges, by search, (nv,) [N·m or N]."""
        robot = self.robot
        model = robot.model
        data = model.createData()

        def weight(q: Array) -> Array:
            return np.abs(
                [pin.computeGeneralizedGravity(model, data, pose) for pose in q]
            )

        poses = robot.random_motion(0, _POSES)[0]
        tau = weight(poses)
        low, high = np.clip(robot.limits.position, -np.pi, np.pi).T
        best = poses[tau.argmax(axis=0)]
        peak = tau.max(axis=0)
        for j in np.flatnonzero(peak > _LEVEL):
            for k in [*range(robot.nv)] * _ROUNDS:
                q = np.tile(best[j], (_STEPS, 1))
                q[:, k] = np.linspace(low[k], high[k], _STEPS)
                tau = weight(q)[:, j]
                if tau.max() > peak[j]:
                    peak[j], best[j] = tau.max(), q[tau.argmax()]
        return np.where(peak > _LEVEL, peak, 0.0)

    @property
    def moving_mass(self) -> float:
        """Mass that the joints move [kg]."""
        return float(self.robot.phi[::10].sum())

    @property
    def total_mass(self) -> float:
        """The same with the base as far as the description states it [kg]."""
        return self.moving_mass + sum(
            body.mass for body in self.bodies if not body.carrier
        )

    @cached_property
    def warnings(self) -> tuple[ModelWarning, ...]:
        """Everything that looks wrong, hints last.

        A warning names what is almost surely wrong or missing; a hint what may well be right.
        """
        robot = self.robot
        root = fromstring(robot.description)
        warnings = [
            *_inertias(robot, self.bodies),
            *_axes(robot, root),
            *_limits(robot, root),
            *self._weight(),
        ]
        if not any(warning.check in _SPOILS_WEIGHT for warning in warnings):
            warnings += _gravity(robot, self.gravity_peaks)
        return tuple(sorted(warnings, key=lambda warning: warning.hint))

    def _weight(self) -> Warnings:
        moving = self.moving_mass
        total = self.total_mass
        stated = self.mass
        if stated is None or abs(total - stated) <= _MASS * stated:
            return
        rest = stated - total
        base = total == moving and 0 < rest <= _BASE * stated
        sentence = (
            f"its links weigh {moving:.4g} kg and its base states no mass; {stated:.4g} kg is "
            f"right if the base weighs {rest:.3g} kg"
            if base
            else f"the description weighs {total:.4g} kg, {abs(rest):.3g} kg "
            f"{'less' if rest > 0 else 'more'} than the {stated:.4g} kg stated; look for links "
            "that lack mass, count twice or have another unit"
        )
        yield ModelWarning("total_mass", (self.robot.name,), sentence, hint=base)

    def result(self) -> dict[str, Any]:
        """Joints, links, limits, effects and warnings, for ``result.json``."""
        robot = self.robot
        limits = robot.limits
        joints = [
            {
                "name": joint,
                "link": robot.links[j],
                "kind": "revolute" if robot.revolute[j] else "prismatic",
                "position": list(map(_finite, limits.position[j])),
                "velocity": _finite(limits.velocity[j]),
                "acceleration": _finite(limits.acceleration[j]),
                "torque": _finite(limits.torque[j]),
                "gravity_torque": _finite(self.gravity_peaks[j]),
                "mass": float(robot.phi[10 * j]),
            }
            for j, joint in enumerate(robot.joints)
        ]
        values = [
            {
                "effect": effect.name,
                "name": parameter.name,
                "value": value,
                "unit": parameter.unit,
            }
            for effect in robot.effects
            if effect.values is not None
            for parameter, value in zip(
                effect.parameters(robot), effect.values, strict=True
            )
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
            "warnings": [
                {**asdict(w), "where": list(w.where)} for w in self.warnings
            ],
            "joints": joints,
            "appearance": Appearance(robot).entries(),
            "links": [_link(body) for body in self.bodies],
            "locked": dict(robot.locked),
            "parameters": dict(
                zip(robot.parameter_names, robot.phi.tolist(), strict=True)
            ),
            "notes": list(robot.notes),
        }

    def series(self) -> dict[str, Array]:
        """Frames in which each joint alone swings away from zero and back, one after the other.

        Returns:
            ``play_t`` (n,) [s], ``play_q``, ``play_dq`` (n, nv); meshes as of `Appearance.meshes`.
        """
        robot = self.robot
        zero = zero_pose(robot)
        low, high = robot.limits.position.T
        side = np.where(high - zero >= zero - low, 1.0, -1.0)
        step = np.where(robot.revolute, np.pi / 2, _SLIDE)
        way = np.clip(zero + side * step, low, high) - zero
        t = np.linspace(0.0, 2.0 * robot.nv, 40 * robot.nv + 1)
        turn = np.minimum(t // 2, robot.nv - 1)[:, None]
        way = np.where(np.arange(robot.nv) == turn, way, 0.0)
        angle = np.pi * t[:, None]
        return {
            "play_t": t,
            "play_q": zero + way * (1 - np.cos(angle)) / 2,
            "play_dq": way * np.pi / 2 * np.sin(angle),
            **Appearance(robot).meshes(),
        }


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _link(body: Body) -> dict[str, Any]:
    spread = np.linalg.eigvalsh(body.second_moment)[-1] if body.mass > 0 else 0.0
    return {
        "link": body.link,
        "moves_with": body.carrier or None,
        "mass": body.mass,
        "com": body.com.tolist(),
        "principal_moments": np.linalg.eigvalsh(body.inertia).tolist(),
        "radius_of_gyration": float(np.sqrt(max(spread, 0.0))),
        "size": body.size,
    }


def _axes(robot: Robot, root: Element) -> Warnings:
    """Axes that are no unit vectors."""
    for name, joint in stated_joints(root).items():
        text = child_attribute(joint, "axis", "xyz", "1 0 0")
        length = float(np.linalg.norm(floats(text)))
        if name in robot.joints and abs(length - 1) > _UNIT:
            sentence = (
                f'its axis "{text}" has length {length:.4g}; write a unit vector'
            )
            yield ModelWarning("joint_axis", (name,), sentence)


def _limits(robot: Robot, root: Element) -> Warnings:
    """Limits that are absent, zero or upside down, and zeros that lie outside them."""
    for name, values, unit in (
        ("velocity", robot.limits.velocity, "rad/s or m/s"),
        ("effort", robot.limits.torque, "N·m or N"),
    ):
        absent = np.array(robot.joints)[~np.isfinite(values)].tolist()
        if absent:
            yield ModelWarning(
                f"no_{name}_limit",
                tuple(absent),
                f"no {name} limit, or zero, so that nothing bounds it here; give it in the "
                f"<limit> [{unit}] or with --limits",
            )
    wide, why = endless_ranges(robot)
    if wide:
        yield ModelWarning("limits_unit", wide, why)
    stated = stated_joints(root)
    for joint, (low, high) in zip(robot.joints, robot.limits.position, strict=True):
        kind = stated[joint].get("type")
        limit = stated[joint].find("limit")
        if not np.isfinite([low, high]).all() and kind != "continuous":
            given = (
                "none"
                if limit is None
                else f"{limit.get('lower')} to {limit.get('upper')}"
            )
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


def _gravity(robot: Robot, peak: Array) -> Warnings:
    """Joints that cannot hold the arm in every pose."""
    for j in np.flatnonzero(peak > robot.limits.torque):
        unit = "N·m" if robot.revolute[j] else "N"
        yield ModelWarning(
            "gravity",
            (robot.joints[j],),
            f"gravity takes up to {peak[j]:.3g} {unit} of its {robot.limits.torque[j]:.3g} {unit}, "
            "so that it cannot hold the arm in every pose; check masses and effort limit",
        )


def _inertias(robot: Robot, stated: Sequence[Body]) -> Warnings:
    """Implausible inertias; of each link only the first warning."""
    moving = [body for body in stated if body.carrier]
    for link, mass in zip(robot.links, robot.phi[::10], strict=True):
        if mass == 0 and not any(b.given and b.carrier == link for b in moving):
            sentence = (
                "has no mass, and nothing fixed to it has; add its <inertial>"
            )
            yield ModelWarning("no_inertia", (link,), sentence)
    # a marker or a point mass fixed to a moving link needs no tensor of its own
    moving = [
        body
        for body in moving
        if body.given
        and (body.inertia.any() or (body.link == body.carrier and body.mass != 0))
    ]
    own = [body for body in moving if body.link == body.carrier]
    alike = list(_placeholders(robot, own))
    yield from alike
    named = {link for warning in alike for link in warning.where}
    for body in moving:
        doubts = (
            ModelWarning(name, (body.link,), text, hint=_UNSEEN in text)
            for name, check in _LINK_CHECKS.items()
            for text in check(robot, body)
        )
        if body.link not in named:
            yield from islice(doubts, 1)


def _placeholders(robot: Robot, own: Sequence[Body]) -> Warnings:
    """One inertia used for several links of a chain, round numbers, and next to no mass."""
    seen: dict[tuple[float, ...], list[Body]] = {}
    for body in own:
        values = (body.mass, *np.linalg.eigvalsh(body.inertia))
        seen.setdefault(tuple(float(f"{x:.6g}") for x in values), []).append(body)
    advice = "replace it by values from CAD, a data sheet or identification"
    for group in seen.values():
        body = group[0]
        links = tuple(body.link for body in group)
        moments = np.linalg.eigvalsh(body.inertia)
        value = f"{body.mass:.4g} kg and {moments[-1]:.3g} kg·m²"
        ball = np.ptp(moments) <= 1e-9 * moments[-1]
        sentence = ""
        if _in_a_row(robot, links) > 2:
            sentence = f"one and the same inertia ({value}), perhaps a placeholder; {advice}"
        elif (
            ball and _power_of_ten(body.mass) and _power_of_ten(float(moments[-1]))
        ):
            sentence = (
                f"{value} alike about all axes looks like a placeholder; {advice}"
            )
        if sentence:
            yield ModelWarning("placeholder_inertia", links, sentence)
    arm = float(robot.phi[::10].sum())
    masses = dict(zip(robot.links, robot.phi[::10], strict=True))
    light = {
        body.link: masses[body.link]
        for body in own
        if 0 < masses[body.link] < PLACEHOLDER * arm
    }
    if light:
        yield ModelWarning(
            "placeholder_inertia",
            tuple(light),
            f"no more than {1e3 * max(light.values()):.3g} g, next to nothing of the arm's "
            f"{arm:.3g} kg; give the true mass, in kg",
        )


def _in_a_row(robot: Robot, links: Sequence[str]) -> int:
    """Number of these links on one path from the base; parallel legs may be equal."""
    joints = {robot.links.index(link) + 1 for link in links}
    return max(len(joints & {*robot.model.supports[j]}) for j in joints)


def _power_of_ten(value: float) -> bool:
    return value > 0 and abs(np.log10(value) - round(np.log10(value))) < 1e-9


def _not_physical(robot: Robot, body: Body) -> Iterator[str]:
    for violation in violations(
        [body.mass, 0, 0, 0, *elements(body.inertia)], (body.link,)
    ):
        advice = "check its numbers and their order (ixx ixy ixz iyy iyz izz)"
        if body.mass > 0:
            moment = body.second_moment
            shifted = np.linalg.eigvalsh(moment + np.outer(body.com, body.com))
            spread = np.linalg.eigvalsh(moment)
            lever = body.mass * float(body.com @ body.com)
            if (np.abs(np.diag(body.inertia)) <= _ROUNDING * lever).any():
                advice = "a moment that is zero or missing: give ixx, iyy and izz"
            elif shifted[0] > 0 and np.linalg.norm(body.com) > _EXTENT:
                advice = (
                    "the parallel-axis term may be subtracted twice; give the tensor about the "
                    "centre of mass"
                )
            elif spread[0] > -_ROUNDING * spread[-1]:
                advice = (
                    "rounding may do this to a flat or thin link; give more digits"
                )
        yield f"{violation.removeprefix(f'{body.link}: ')}; {advice}"


def _centre_outside(robot: Robot, body: Body) -> Iterator[str]:
    gap = float(np.linalg.norm(body.com - np.clip(body.com, *body.box)))
    size = body.size
    arm = sum(spans(robot))
    if size > _EXTENT:
        least = _OUTSIDE[bool(body.shapes)] * size + _EXTENT
        if not body.shapes:
            least += 0.1 * arm
        where = f"{_length(gap)} outside the link, which measures {_length(size)}"
    else:
        least = 0.75 * arm
        where = f"{_length(gap)} from its joint, in an arm of {_length(arm)}"
    if gap > least:
        c = " ".join(f"{x:.4g}" for x in body.com)
        advice = "check signs, units (m, not mm) and the frame"
        yield f"its centre of mass ({c}) m lies {where}; {advice}"


def _length(metres: float) -> str:
    return f"{metres:.3g} m" if metres >= 1 else f"{1e3 * metres:.3g} mm"


def _light(robot: Robot, body: Body) -> Iterator[str]:
    known = bool(body.shapes) or body.size >= 5 * _EXTENT
    if known and body.link == body.carrier and body.mass < _LIGHT * body.size:
        yield (
            f"weighs {1e3 * body.mass:.3g} g over {_length(body.size)}, less than any arm's link; "
            "check the density of the CAD export and the unit (kg)"
        )


def _about_joint(robot: Robot, body: Body) -> Iterator[str]:
    """A tensor that fits the solids, or a bar, once the parallel-axis term is taken off."""
    expected = body.solid_second_moment
    if expected is None:  # a bar to the next joint
        far = body.points[int(np.argmax(np.linalg.norm(body.points, axis=1)))]
        length = float(np.linalg.norm(far))
        if length < 5 * _EXTENT:
            return
        expected = np.outer(far, far) / 12 + (0.15 * length) ** 2 / 4 * np.eye(3)
    given = body.second_moment
    reduced = given - np.outer(body.com, body.com)
    off, near = (float(np.linalg.norm(S - expected)) for S in (given, reduced))
    if (
        np.linalg.norm(body.com) >= _LEVER * sum(spans(robot))
        and np.linalg.eigvalsh(reduced)[0] > 0
        and off >= _EXCESS * float(np.linalg.norm(expected))
        and near <= _CLOSER * off
    ):
        yield (
            "its tensor may be about the joint frame instead of the centre of mass: only without "
            "the parallel-axis term m(c²1 − ccᵀ) does it fit the link's extent; subtract that term"
        )


def _size(robot: Robot, body: Body) -> Iterator[str]:
    """A radius of gyration that is too large or too small for the link."""
    values, vectors = np.linalg.eigh(body.second_moment)
    radius = float(np.sqrt(values[-1]))
    size = body.size
    if not body.shapes:
        size = max(size, 0.25 * sum(spans(robot)))
    too_small = radius < _TOO_NARROW * size and body.shapes
    if size >= _EXTENT and (too_small or radius > _TOO_WIDE * size):
        axis = vectors[:, -1]
        excess = (values[-1] - size**2 / 16) * body.mass * np.outer(axis, axis)
        unit = "check its unit (kg·m², not g·mm² or kg·mm²)"
        yield (
            f"its inertia is {'too small' if too_small else 'too large'} for {body.mass:.3g} kg: "
            f"radius of gyration {_length(radius)} in a link that measures {_length(size)}; "
            f"{_UNSEEN if _moves_nothing(robot, body, excess) else unit}"
        )


def _moves_nothing(robot: Robot, body: Body, moment: Array) -> bool:
    """Whether taking a second moment off a link hardly changes a torque in a few states."""
    if body.link != body.carrier:
        return False
    k = robot.links.index(body.link)
    phi = robot.phi.copy()
    phi[10 * k + 4 : 10 * k + 10] -= elements(np.trace(moment) * np.eye(3) - moment)
    states = robot.random_motion(0, 5)
    motion = numbered(*states)
    before = rigid_body_torque(robot, motion)
    change = rigid_body_torque(robot.with_parameters(phi), motion) - before
    largest = _SLIGHT * np.abs(before).max(axis=0)
    return bool((np.abs(change).max(axis=0) <= largest).all())


def _across(robot: Robot, body: Body) -> Iterator[str]:
    """An elongated inertia whose long axis lies across that of the solids."""
    solids = body.solid_second_moment
    if solids is None:
        return
    own, axes = np.linalg.eigh(solids)
    other, principal = np.linalg.eigh(body.second_moment)
    axis = axes[:, -1]
    inertia = principal[:, -1]
    long = (
        own[-1] > _ELONGATED[0] * own[-2] and other[-1] > _ELONGATED[1] * other[-2]
    )
    angle = np.degrees(np.arccos(min(1.0, abs(axis @ inertia))))
    if long and angle >= _ACROSS:
        along, lie = ("xyz"[int(np.argmax(np.abs(x)))] for x in (inertia, axis))
        yield (
            f"its inertia is that of a body along {along}, its collision shapes lie along "
            f"{lie} ({angle:.0f}° apart); check the order of ixx, iyy, izz and the rpy of the "
            "<inertial> origin"
        )


_LINK_CHECKS = {
    "inertia_not_physical": _not_physical,
    "centre_of_mass": _centre_outside,
    "placeholder_inertia": _light,
    "inertia_frame": _about_joint,
    "inertia_size": _size,
    "inertia_axes": _across,
}
