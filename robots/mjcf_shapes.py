"""Collision shapes of MJCF geoms as a URDF has them."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping

import numpy as np
import pinocchio as pin

from excitant.robots.mjcf_document import Document
from excitant.robots.mjcf_inertia import mesh_file, shape_kind, shape_size
from excitant.robots.urdf_elements import numbers_text, origin_element


def collisions(
    document: Document, element: ET.Element, frame: pin.SE3, childclass: str
) -> Iterator[ET.Element]:
    """``<collision>`` elements of a geom that may touch others; planes and fields have none.

    A capsule becomes a cylinder with two spheres, an ellipsoid the box around it. A mesh that is
    turned (refquat) and then stretched unequally has no URDF word and is left out.
    """
    given = document.attributes(element, childclass)
    if not document.number(given, "contype", 1) and not document.number(given, "conaffinity", 1):
        return
    kind = shape_kind(given)
    if kind == "mesh":
        file, scale, measured = mesh_file(document, given["mesh"])
        mesh = {"filename": str(file), "scale": numbers_text(scale)}
        if np.ptp(scale) and not np.allclose(measured.rotation, np.eye(3)):
            return
        back = measured.rotation.T
        moved = pin.SE3(back, -scale * (back @ measured.translation))
        yield _collision(frame * document.pose(given) * moved, "mesh", mesh)
        return
    if "mesh" in given or kind not in ("sphere", "capsule", "cylinder", "box", "ellipsoid"):
        return
    size, placement = shape_size(document, given)
    for shift, shape, attributes in _primitives(kind, *size.tolist()):
        moved = pin.SE3(np.eye(3), np.array([0.0, 0.0, shift]))
        yield _collision(frame * placement * moved, shape, attributes)


def _primitives(
    kind: str, x: float, y: float, z: float
) -> Iterator[tuple[float, str, Mapping[str, str]]]:
    """Shift along z, shape and attributes of what a geom is made of."""
    if kind == "sphere":
        yield 0.0, "sphere", {"radius": repr(x)}
    elif kind in ("box", "ellipsoid"):
        yield 0.0, "box", {"size": numbers_text((2 * x, 2 * y, 2 * z))}
    else:
        yield 0.0, "cylinder", {"radius": repr(x), "length": repr(2 * y)}
    if kind == "capsule":
        yield y, "sphere", {"radius": repr(x)}
        yield -y, "sphere", {"radius": repr(x)}


def _collision(placement: pin.SE3, shape: str, attributes: Mapping[str, str]) -> ET.Element:
    element = ET.Element("collision")
    element.append(origin_element(placement.rotation, placement.translation))
    ET.SubElement(ET.SubElement(element, "geometry"), shape, dict(attributes))
    return element
