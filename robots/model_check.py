"""Whether a robot's description can be right: inertias, axes, limits, and the arm's own weight."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from excitant.robots.model_check_bodies import Body, bodies
from excitant.robots.model_check_inertias import inertia_warnings
from excitant.robots.model_check_joints import axis_warnings, gravity_warnings, limit_warnings
from excitant.robots.model_check_warning import ModelWarning
from excitant.robots.robot import Robot

_MASS = 0.05  # relative deviation from the stated mass that goes unsaid
_BASE = 0.4  # of the stated mass: what a base that the model leaves out may weigh
_SPOILS_WEIGHT = ("inertia_not_physical", "centre_of_mass")


def check_model(robot: Robot, mass: float | None = None) -> tuple[ModelWarning, ...]:
    """Everything in an arm's description that looks wrong, hints last.

    Args:
        robot: The arm.
        mass: What the whole arm weighs with its base, where that is known [kg].

    Returns:
        Nothing for a description without doubts. A warning names what is almost surely wrong
        or missing; a hint what may well be right.
    """
    links = bodies(robot)
    found = [
        *inertia_warnings(robot, links),
        *axis_warnings(robot),
        *limit_warnings(robot),
        *(_mass_warnings(robot, links, mass) if mass is not None else ()),
    ]
    if not any(warning.check in _SPOILS_WEIGHT for warning in found):
        found += gravity_warnings(robot)
    return tuple(sorted(found, key=lambda warning: warning.hint))


def total_mass(robot: Robot, links: Sequence[Body] | None = None) -> tuple[float, float]:
    """Mass that the joints move, and with the base as far as the description states it [kg]."""
    links = bodies(robot) if links is None else links
    moving = float(robot.phi[::10].sum())
    return moving, moving + sum(body.mass for body in links if not body.carrier)


def _mass_warnings(robot: Robot, links: Sequence[Body], stated: float) -> Iterator[ModelWarning]:
    moving, total = total_mass(robot, links)
    if abs(total - stated) <= _MASS * stated:
        return
    rest = stated - total
    if total == moving and 0 < rest <= _BASE * stated:
        yield ModelWarning(
            "total_mass", (robot.name,),
            f"its links weigh {moving:.4g} kg and its base states no mass; {stated:.4g} kg is "
            f"right if the base weighs {rest:.3g} kg",
            hint=True,
        )  # fmt: skip
        return
    yield ModelWarning(
        "total_mass", (robot.name,),
        f"the description weighs {total:.4g} kg, {abs(rest):.3g} kg "
        f"{'less' if rest > 0 else 'more'} than the {stated:.4g} kg stated; look for links that "
        "lack mass, count twice or have another unit",
    )  # fmt: skip
