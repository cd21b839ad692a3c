"""Inertias that no body has, or that this link can hardly have.

With the second moment per mass about the centre of mass, S = ½ tr(I)/m 1 − I/m, a link of given
extent has S no larger than its box allows, the long axis of S along the link, and a centre of mass
within. A tensor about the joint frame given as one about the centre of mass c shows as S + c cᵀ
(Steiner).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from excitant.robots.bodies import Body
from excitant.robots.motion import Array
from excitant.robots.parameters import elements, violations
from excitant.robots.robot import Robot

_OUTSIDE = {True: 0.15, False: 0.5}  # of the link's size, with and without solids
_TOO_WIDE = 1.0  # radius of gyration over the link's size; a half is possible
_TOO_NARROW = 0.02
_EXTENT = 0.02  # m: joints closer together say nothing about a link's size
_LIGHT = 0.1  # kg/m of link
_SHARE = 5e-4  # of the arm's mass: a moving link of less is a placeholder
_ELONGATED = (4.0, 3.0)  # ratio of the two largest second moments: of the solids, of the inertia
_ACROSS = 50.0  # degrees between both long axes
_EXCESS, _CLOSER = 0.75, 0.4  # a tensor about the joint: how far off, how much nearer without it
_LEVER = 0.05  # of the arm: centres of mass nearer to the joint make no difference worth a word
_SLIGHT = 0.01  # of a joint's torque: what changes less matters to none
_ROUNDING = 1e-3  # relative violation that digits left out explain


@dataclass(frozen=True)
class ModelWarning:
    """What looks wrong, where, and what to do about it.

    Attributes:
        check: Which check says so, e.g. ``placeholder_inertia``.
        where: The links or joints concerned.
        sentence: What was found and what to do, in one line.
        hint: Whether it may well be right, or matters to no torque.
    """

    check: str
    where: tuple[str, ...]
    sentence: str
    hint: bool = False

    def __str__(self) -> str:
        return f"{', '.join(self.where)}: {self.sentence}"


def inertia_warnings(robot: Robot, bodies: Sequence[Body]) -> Iterator[ModelWarning]:
    """What looks wrong in the inertias; of each link only the first thing that is found."""
    moving = [body for body in bodies if body.carrier]
    yield from _without_inertia(robot, moving)
    stated = [body for body in moving if body.given and not _is_point(body)]
    alike = list(_placeholders(robot, stated))
    yield from alike
    named = {link for warning in alike for link in warning.where}
    checks: tuple[Callable[[Robot, Body], ModelWarning | None], ...] = (
        _not_physical,
        _centre_outside,
        _light,
        _about_joint,
        _too_wide,
        _across,
    )
    for body in stated:
        if body.link in named:
            continue
        for check in checks:
            warning = check(robot, body)
            if warning is not None:
                yield warning
                break


def _is_point(body: Body) -> bool:
    """A marker or a point mass fixed to a moving link, which needs no tensor of its own."""
    return not body.inertia.any() and (body.link != body.carrier or body.mass == 0)


def _without_inertia(robot: Robot, moving: Sequence[Body]) -> Iterator[ModelWarning]:
    masses = dict(zip(robot.links, robot.phi[::10], strict=True))
    for link, mass in masses.items():
        if mass == 0 and not any(b.given and b.carrier == link for b in moving):
            yield ModelWarning(
                "no_inertia",
                (link,),
                "has no mass, and nothing fixed to it has; add its <inertial>",
            )


def _placeholders(robot: Robot, stated: Sequence[Body]) -> Iterator[ModelWarning]:
    """One inertia used for several links of a chain, round numbers, and next to no mass."""
    own = [body for body in stated if body.link == body.carrier]
    seen: dict[tuple[float, ...], list[Body]] = {}
    for body in own:
        values = (body.mass, *np.linalg.eigvalsh(body.inertia))
        seen.setdefault(tuple(float(f"{x:.6g}") for x in values), []).append(body)
    advice = "replace it by values from CAD, a data sheet or identification"
    for group in seen.values():
        body, links = group[0], tuple(body.link for body in group)
        moments = np.linalg.eigvalsh(body.inertia)
        value = f"{body.mass:.4g} kg and {moments[-1]:.3g} kg·m²"
        ball = np.ptp(moments) <= 1e-9 * moments[-1]
        if _in_a_row(robot, links) > 2:
            yield ModelWarning(
                "placeholder_inertia",
                links,
                f"have one and the same inertia ({value}), perhaps a placeholder; {advice}",
            )
        elif ball and _power_of_ten(body.mass) and _power_of_ten(float(moments[-1])):
            yield ModelWarning(
                "placeholder_inertia",
                links,
                f"{value} alike about all axes looks like a placeholder; {advice}",
            )
    arm = float(robot.phi[::10].sum())
    masses = [float(robot.phi[10 * robot.links.index(body.link)]) for body in own]
    light = [(b.link, m) for b, m in zip(own, masses, strict=True) if 0 < m < _SHARE * arm]
    if light:
        yield ModelWarning(
            "placeholder_inertia",
            tuple(link for link, _ in light),
            f"no more than {1e3 * max(m for _, m in light):.3g} g, next to nothing of the arm's "
            f"{arm:.3g} kg; give the true mass, in kg",
        )


def _in_a_row(robot: Robot, links: Sequence[str]) -> int:
    """How many of these links are on one way from the base; legs side by side may be equal."""
    joints = {robot.links.index(link) + 1 for link in links}
    return max(len(joints & set(robot.model.supports[j])) for j in joints)


def _power_of_ten(value: float) -> bool:
    return value > 0 and abs(np.log10(value) - round(np.log10(value))) < 1e-9


def _not_physical(robot: Robot, body: Body) -> ModelWarning | None:
    found = violations(np.array([body.mass, 0, 0, 0, *elements(body.inertia)]), (body.link,))
    if not found:
        return None
    why = found[0].removeprefix(f"{body.link}: ")
    advice = "check its numbers and their order (ixx ixy ixz iyy iyz izz)"
    if body.mass > 0:
        steiner = np.linalg.eigvalsh(body.second_moment + np.outer(body.com, body.com))
        spread = np.linalg.eigvalsh(body.second_moment)
        if steiner[0] > 0 and np.linalg.norm(body.com) > _EXTENT:
            advice = (
                "the parallel-axis term may be subtracted twice; give the tensor about the "
                "centre of mass"
            )
        elif spread[0] > -_ROUNDING * spread[-1]:
            advice = "rounding may do this to a flat or thin link; give more digits"
    return ModelWarning("inertia_not_physical", (body.link,), f"{why}; {advice}")


def _centre_outside(robot: Robot, body: Body) -> ModelWarning | None:
    low, high = body.box
    gap = float(np.linalg.norm(body.com - np.clip(body.com, low, high)))
    size, arm = body.size, _arm_size(robot)
    if size > _EXTENT:
        least = _OUTSIDE[bool(body.shapes)] * size + _EXTENT + (not body.shapes) * 0.1 * arm
        where = f"{_length(gap)} outside the link, which measures {_length(size)}"
    else:
        least, where = 0.75 * arm, f"{_length(gap)} from its joint, in an arm of {_length(arm)}"
    if gap <= least:
        return None
    c = " ".join(f"{x:.4g}" for x in body.com)
    return ModelWarning(
        "centre_of_mass",
        (body.link,),
        f"its centre of mass ({c}) m lies {where}; check signs, units (m, not mm) and the frame",
    )


def _length(metres: float) -> str:
    return f"{metres:.3g} m" if metres >= 1 else f"{1e3 * metres:.3g} mm"


def _arm_size(robot: Robot) -> float:
    return float(sum(np.linalg.norm(p.translation) for p in list(robot.model.jointPlacements)[1:]))


def _light(robot: Robot, body: Body) -> ModelWarning | None:
    known = bool(body.shapes) or body.size >= 5 * _EXTENT
    if not known or body.link != body.carrier or body.mass >= _LIGHT * body.size:
        return None
    return ModelWarning(
        "placeholder_inertia",
        (body.link,),
        f"weighs {1e3 * body.mass:.3g} g over {_length(body.size)}, less than any arm's link; "
        "check the density of the CAD export and the unit (kg)",
    )


def _about_joint(robot: Robot, body: Body) -> ModelWarning | None:
    """A tensor that fits the link once the parallel-axis term is taken off."""
    expected = _expected(body)
    if expected is None or np.linalg.norm(body.com) < _LEVER * _arm_size(robot):
        return None
    given = body.second_moment
    reduced = given - np.outer(body.com, body.com)
    size = float(np.linalg.norm(expected))
    off, near = (float(np.linalg.norm(S - expected)) for S in (given, reduced))
    if np.linalg.eigvalsh(reduced)[0] <= 0 or off < _EXCESS * size or near > _CLOSER * off:
        return None
    return ModelWarning(
        "inertia_frame",
        (body.link,),
        "its tensor may be about the joint frame instead of the centre of mass: only without "
        "the parallel-axis term m(c²1 − ccᵀ) does it fit the link's extent; subtract that term",
    )


def _expected(body: Body) -> Array | None:
    """Second moment per mass of the solids, or of a bar to the next joint; None without either."""
    if body.solid_second_moment is not None:
        return body.solid_second_moment
    far = body.points[int(np.argmax(np.linalg.norm(body.points, axis=1)))]
    length = float(np.linalg.norm(far))
    if length < 5 * _EXTENT:
        return None
    return np.asarray(np.outer(far, far) / 12 + (0.15 * length) ** 2 / 4 * np.eye(3))


def _too_wide(robot: Robot, body: Body) -> ModelWarning | None:
    values, vectors = np.linalg.eigh(body.second_moment)
    radius, size = float(np.sqrt(values[-1])), body.size
    if not body.shapes:
        size = max(size, 0.25 * _arm_size(robot))
    if _TOO_NARROW * size <= radius <= _TOO_WIDE * size or size < _EXTENT:
        return None
    if radius < size and not body.shapes:
        return None
    word = "too large" if radius > size else "too small"
    sentence = (
        f"its inertia is {word} for {body.mass:.3g} kg: radius of gyration "
        f"{_length(radius)} in a link that measures {_length(size)}"
    )
    excess = (values[-1] - size**2 / 16) * body.mass * np.outer(vectors[:, -1], vectors[:, -1])
    if _moves_nothing(robot, body, excess):
        return ModelWarning(
            "inertia_size", (body.link,), f"{sentence}; hardly any torque depends on it", hint=True
        )
    return ModelWarning(
        "inertia_size", (body.link,), f"{sentence}; check its unit (kg·m², not g·mm² or kg·mm²)"
    )


def _moves_nothing(robot: Robot, body: Body, moment: Array) -> bool:
    """Whether taking a second moment off a link hardly changes a torque in a few states."""
    if body.link != body.carrier:
        return False
    k = robot.links.index(body.link)
    phi = robot.phi.copy()
    phi[10 * k + 4 : 10 * k + 10] -= elements(np.trace(moment) * np.eye(3) - moment)
    other = robot.with_parameters(phi).model
    states = zip(*robot.random_motion(np.random.default_rng(0), 5), strict=True)
    tau = [
        [pin.rnea(model, model.createData(), *state) for model in (robot.model, other)]
        for state in states
    ]
    before, after = np.swapaxes(np.array(tau), 0, 1)
    change = np.abs(after - before).max(axis=0)
    return bool((change <= _SLIGHT * np.abs(before).max(axis=0)).all())


def _across(robot: Robot, body: Body) -> ModelWarning | None:
    """An elongated inertia whose long axis lies across that of the solids."""
    if body.solid_second_moment is None:
        return None
    along = [
        _long_axis(S, ratio)
        for S, ratio in zip((body.solid_second_moment, body.second_moment), _ELONGATED, strict=True)
    ]
    if along[0] is None or along[1] is None:
        return None
    angle = float(np.degrees(np.arccos(min(1.0, abs(float(along[0] @ along[1]))))))
    if angle < _ACROSS:
        return None
    names = ["xyz"[int(np.argmax(np.abs(axis)))] for axis in along if axis is not None]
    return ModelWarning(
        "inertia_axes",
        (body.link,),
        f"its inertia is that of a body along {names[1]}, its collision shapes lie along "
        f"{names[0]} ({angle:.0f}° apart); check the order of ixx, iyy, izz and the rpy of the "
        "<inertial> origin",
    )


def _long_axis(second_moment: Array, ratio: float) -> Array | None:
    values, vectors = np.linalg.eigh(second_moment)
    return np.asarray(vectors[:, -1]) if values[-1] > ratio * values[-2] else None
