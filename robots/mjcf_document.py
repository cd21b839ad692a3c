"""What the words of an MJCF file mean: included files, default classes, angles and poses."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from excitant.exceptions import BadRobot
from excitant.robots.motion import Array

ORIENTATIONS = ("quat", "axisangle", "euler", "xyaxes", "zaxis")
_BUILDERS = ("attach", "replicate", "composite", "flexcomp")
_ACTUATORS = (
    "general", "motor", "position", "velocity", "intvelocity", "pid", "damper", "cylinder",
    "muscle", "adhesion", "dcmotor", "orientation", "plugin",
)  # fmt: skip
_DEEPEST = 20  # files that include files


@dataclass(frozen=True)
class Document:
    """An MJCF file with all that it includes.

    Attributes:
        source: Its path, for messages.
        root: Its elements.
        defaults: Attributes by class and tag, inherited ones included.
        compiler: Attributes of all ``<compiler>`` elements.
    """

    source: str
    root: ET.Element
    defaults: Mapping[str, Mapping[str, Mapping[str, str]]]
    compiler: Mapping[str, str]

    @property
    def degrees(self) -> bool:
        """Whether angles are in degrees."""
        return self.compiler.get("angle", "degree") == "degree"

    def angle(self, value: float) -> float:
        """An angle of the file [rad]."""
        return float(np.deg2rad(value)) if self.degrees else value

    def attributes(self, element: ET.Element, childclass: str = "main") -> dict[str, str]:
        """Attributes of an element, with those of its default class."""
        name = element.get("class", childclass)
        if name not in self.defaults:
            raise BadRobot(self.source, f"<{element.tag}>: there is no default class '{name}'")
        tag = "actuator" if element.tag in _ACTUATORS else element.tag
        inherited = dict(self.defaults[name].get(tag, {}))
        if any(key in element.attrib for key in ORIENTATIONS):
            inherited = {key: x for key, x in inherited.items() if key not in ORIENTATIONS}
        return inherited | element.attrib

    def numbers(
        self, given: Mapping[str, str], key: str, default: Sequence[float], at_most: int = 0
    ) -> Array:
        """Finite numbers of an attribute, as many as the default has unless ``at_most`` says so."""
        if key not in given:
            return np.array(default, float)
        try:
            found = np.array([float(word) for word in given[key].split()])
        except ValueError:
            found = np.array([np.nan])
        fits = 0 < len(found) <= at_most if at_most else len(found) == len(default)
        if not fits or not np.isfinite(found).all():
            expected = f"{len(default)} numbers" if len(default) > 1 else "a number"
            raise BadRobot(
                self.source,
                f"{key}=\"{given[key]}\" of '{given.get('name', '(no name)')}' is not {expected}",
            )
        return found

    def number(self, given: Mapping[str, str], key: str, default: float = 0.0) -> float:
        """A finite number of an attribute."""
        return float(self.numbers(given, key, [default])[0])

    def pose(self, given: Mapping[str, str]) -> pin.SE3:
        """Pose that an element's ``pos`` and orientation give it in its parent."""
        return pin.SE3(self.rotation(given), self.numbers(given, "pos", (0, 0, 0)))

    def rotation(self, given: Mapping[str, str]) -> Array:
        """Rotation of an element in its parent, shape (3, 3)."""
        if "quat" in given:
            w, *xyz = self.numbers(given, "quat", (1, 0, 0, 0))
            return self._rotation(given, "quat", [*xyz, w])
        if "axisangle" in given:
            *axis, angle = self.numbers(given, "axisangle", (0, 0, 1, 0))
            return about(np.array(axis), self.angle(float(angle)))
        if "euler" in given:
            return self._euler(self.numbers(given, "euler", (0, 0, 0)))
        if "xyaxes" in given:
            x, y = self.numbers(given, "xyaxes", (1, 0, 0, 0, 1, 0)).reshape(2, 3)
            x = _unit(x)
            y = _unit(y - (x @ y) * x)
            return np.column_stack([x, y, np.cross(x, y)])
        if "zaxis" in given:
            return along(self.numbers(given, "zaxis", (0, 0, 1)))
        return np.eye(3)

    def _rotation(self, given: Mapping[str, str], key: str, xyzw: Sequence[float]) -> Array:
        if not np.any(xyzw):
            raise BadRobot(self.source, f'{key}="{given[key]}" is no rotation')
        rotation: Array = Rotation.from_quat(xyzw).as_matrix()
        return rotation

    def _euler(self, angles: Array) -> Array:
        """Rotations about the axes of ``eulerseq``, of the fixed frame where in capitals."""
        R = np.eye(3)
        for letter, value in zip(self.compiler.get("eulerseq", "xyz"), angles, strict=True):
            axis = np.eye(3)["xyz".index(letter.lower())]
            turn = about(axis, self.angle(float(value)))
            R = R @ turn if letter.islower() else turn @ R
        return R


def about(axis: Array, angle: float) -> Array:
    """Rotation about an axis of any length, shape (3, 3)."""
    rotation: Array = Rotation.from_rotvec(angle * _unit(axis)).as_matrix()
    return rotation


def along(direction: Array) -> Array:
    """The smallest rotation that turns z into a direction, shape (3, 3)."""
    axis = np.cross([0.0, 0.0, 1.0], direction)
    sine = float(np.linalg.norm(axis))
    axis = axis if sine > 1e-10 * float(np.linalg.norm(direction)) else np.array([1.0, 0.0, 0.0])
    return about(axis, float(np.arctan2(sine, direction[2])))


def _unit(vector: Array) -> Array:
    length = float(np.linalg.norm(vector))
    unit: Array = vector / length if length > 0 else np.array([0.0, 0.0, 1.0])
    return unit


def read_document(text: str, source: str) -> Document:
    """Document of the text of an MJCF file.

    Args:
        text: The MJCF.
        source: Path of the file; what it includes lies beside it.

    Raises:
        BadRobot: Not XML, files that are missing, or elements that build others.
    """
    root = _parse(text, source)
    if root.tag != "mujoco":
        raise BadRobot(source, f"not an MJCF: the root element is <{root.tag}>, not <mujoco>")
    _include(root, Path(source).parent, source, 0)
    for tag in _BUILDERS:
        if next(root.iter(tag), None) is not None:
            raise BadRobot(
                source,
                f"<{tag}> is not supported; load it in MuJoCo once, save it with mj_saveLastXML, "
                "and give that file",
            )
    compiler: dict[str, str] = {}
    for element in root.findall("compiler"):
        compiler |= element.attrib
    if compiler.get("coordinate", "local") != "local":
        raise BadRobot(source, "global coordinates are not supported; save it with a new MuJoCo")
    sequence = compiler.get("eulerseq", "xyz")
    if len(sequence) != 3 or not set(sequence.lower()) <= set("xyz"):
        raise BadRobot(source, f'eulerseq="{sequence}" is not three of x, y, z')
    return Document(source, root, _defaults(root), compiler)


def _parse(text: str, source: str) -> ET.Element:
    try:
        return ET.fromstring(text)
    except ET.ParseError as error:
        raise BadRobot(source, f"not XML ({error}); give an MJCF file") from None


def _include(element: ET.Element, folder: Path, source: str, depth: int) -> None:
    """Put the elements of included files where they are included."""
    if depth > _DEEPEST:
        raise BadRobot(source, "its files include one another without end")
    for child in list(element):
        if child.tag != "include":
            _include(child, folder, source, depth)
            continue
        path = folder / child.get("file", "")
        if not path.is_file():
            raise BadRobot(source, f"includes {path}, which does not exist")
        included = _parse(path.read_text(encoding="utf-8"), str(path))
        _include(included, folder, source, depth + 1)
        at = list(element).index(child)
        element.remove(child)
        for k, part in enumerate(included):
            element.insert(at + k, part)


def _defaults(root: ET.Element) -> dict[str, dict[str, dict[str, str]]]:
    """Attributes by class and tag; a class has those of the class around it."""
    found: dict[str, dict[str, dict[str, str]]] = {"main": {}}
    for section in root.findall("default"):
        _collect(section, section.get("class", "main"), {}, found)
    return found


def _collect(
    section: ET.Element,
    name: str,
    inherited: Mapping[str, Mapping[str, str]],
    found: dict[str, dict[str, dict[str, str]]],
) -> None:
    own = {tag: dict(values) for tag, values in {**inherited, **found.get(name, {})}.items()}
    for part in section:
        if part.tag != "default":
            tag = "actuator" if part.tag in _ACTUATORS else part.tag
            own[tag] = own.get(tag, {}) | part.attrib
    found[name] = own
    for part in section.findall("default"):
        _collect(part, part.get("class", name), own, found)
