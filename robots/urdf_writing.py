"""Writing identified inertias and friction back into a URDF."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from excitant.robots.chains import tree
from excitant.robots.motion import Array
from excitant.robots.robot import Robot
from excitant.robots.urdf_elements import inertial_element


def urdf_with_parameters(
    robot: Robot,
    phi: npt.ArrayLike,
    friction: Mapping[str, tuple[float, float]] | None = None,
) -> str:
    """The robot's URDF with other inertias and joint friction.

    Each moving link gets the inertia of everything it carries: links fixed to it, or held by
    a locked joint, lose their own ``<inertial>`` so that nothing counts twice.

    Args:
        robot: The arm.
        phi: Standard parameters in the order of ``robot.phi``, shape (10 nv,).
        friction: Viscous [N·m·s/rad] and Coulomb [N·m] friction by joint, written as
            ``<dynamics damping friction>``; left as they are when not given.

    Returns:
        URDF text; reloading it gives the same torque.
    """
    root = ET.fromstring(robot.urdf)
    values: dict[str, Array] = dict(
        zip(robot.links, np.reshape(np.asarray(phi, float), (-1, 10)), strict=True)
    )
    carrier = _carriers(root, robot)
    for link in root.findall("link"):
        name = str(link.get("name"))
        if carrier.get(name) is None:
            continue
        for inertial in link.findall("inertial"):
            link.remove(inertial)
        if name in values:
            link.insert(0, inertial_element(values[name]))
    for joint in root.findall("joint"):
        _set_friction(joint, friction or {})
    ET.indent(root)
    return ET.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _set_friction(joint: ET.Element, friction: Mapping[str, tuple[float, float]]) -> None:
    name = str(joint.get("name"))
    if name not in friction:
        return
    dynamics = joint.find("dynamics")
    if dynamics is None:
        dynamics = ET.SubElement(joint, "dynamics")
    for key, value in zip(("damping", "friction"), friction[name], strict=True):
        dynamics.set(key, repr(float(value)))


def _carriers(root: ET.Element, robot: Robot) -> dict[str, str | None]:
    """For every link the moving link that carries it; None for what stands still."""
    named = tree(root, robot.source)
    parent = {link: joint.parent for link, joint in named.carrier.items()}

    def carrier(link: str | None) -> str | None:
        while link is not None and link not in robot.links:
            link = parent.get(link)
        return link

    return {link: carrier(link) for link in named.links}
