"""Elements of a URDF."""

from __future__ import annotations

import warnings
import xml.etree.ElementTree as ET
from collections.abc import Iterable

import numpy as np
from scipy.spatial.transform import Rotation

from excitant.robots.motion import Array


def numbers_text(values: Iterable[float]) -> str:
    """Numbers as a URDF has them, with all their digits."""
    return " ".join(repr(float(value)) for value in values)


def origin_element(rotation: Array, translation: Array) -> ET.Element:
    """``<origin>`` of a pose."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # gimbal lock: one angle is free
        rpy = Rotation.from_matrix(rotation).as_euler("xyz")
    return ET.Element("origin", xyz=numbers_text(translation), rpy=numbers_text(rpy))


def inertial_element(phi: Array) -> ET.Element:
    """``<inertial>`` of standard parameters about the link's frame, shape (10,)."""
    mass = phi[0]
    lever = phi[1:4] / mass if mass else np.zeros(3)
    xx, xy, yy, xz, yz, zz = phi[4:] - mass * (
        lever @ lever * np.array([1.0, 0, 1, 0, 0, 1])
        - np.outer(lever, lever)[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
    )
    element = ET.Element("inertial")
    ET.SubElement(element, "origin", xyz=numbers_text(lever), rpy="0 0 0")
    ET.SubElement(element, "mass", value=repr(float(mass)))
    tensor = {"ixx": xx, "ixy": xy, "ixz": xz, "iyy": yy, "iyz": yz, "izz": zz}
    ET.SubElement(element, "inertia", {key: repr(float(x)) for key, x in tensor.items()})
    return element
