"""Robots from MJCF files, by way of a URDF.

Bodies become links, hinges and slides become revolute, continuous and prismatic joints; several
joints on one body become a chain of links without mass. A link's frame lies at the anchor of its
last joint with the axes of the body, so that its URDF states what MuJoCo computes with. What a
URDF has no word for is kept beside it: gravity, armatures, springs, loops.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
import pinocchio as pin

from excitant.exceptions import BadRobot
from excitant.robots.description import Description
from excitant.robots.mjcf_actuators import JointActuation, actuation
from excitant.robots.mjcf_document import Document, about, read_document
from excitant.robots.mjcf_equalities import Equalities, equalities
from excitant.robots.mjcf_inertia import Placed, bounded, given_inertia, inertia_of_shapes
from excitant.robots.mjcf_shapes import collisions
from excitant.robots.urdf_elements import inertial_element, numbers_text, origin_element

_KINDS = ("hinge", "slide")


def description_from_mjcf(text: str, source: str) -> Description:
    """Description of the robot in the text of an MJCF file.

    Args:
        text: The MJCF.
        source: Path of the file, beside which included files and meshes lie.

    Raises:
        BadRobot: Not an MJCF, or one with elements that have no counterpart; names the culprit.
    """
    document = read_document(text, source)
    writer = _Writer(document, actuation(document), equalities(document))
    writer.write()
    option: dict[str, str] = {}
    for element in document.root.findall("option"):
        option |= element.attrib
    x, y, z = document.numbers(option, "gravity", (0, 0, -9.81)).tolist()
    ET.indent(writer.robot)
    return Description(
        urdf=ET.tostring(writer.robot, encoding="unicode") + "\n",
        gravity=(x, y, z),
        armature={joint: value for joint, value in writer.armature.items() if value},
        springs=writer.springs,
        lock=writer.equalities.fixed,
        loops=writer.loops,
        notes=(*writer.notes, *writer.equalities.notes),
    )


@dataclass
class _Writer:
    """Writes links and joints while it walks over the bodies."""

    document: Document
    actuation: Mapping[str, JointActuation]
    equalities: Equalities
    armature: dict[str, float] = field(default_factory=dict)
    springs: dict[str, tuple[float, float]] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    count: int = 0

    @cached_property
    def robot(self) -> ET.Element:
        """The URDF so far."""
        name = self.document.root.get("model") or Path(self.document.source).stem
        return ET.Element("robot", name=name)

    @property
    def loops(self) -> tuple[tuple[str, str], ...]:
        """Ties between links that were written."""
        links = {str(link.get("name")) for link in self.robot.iter("link")}
        return tuple(ends for ends in self.equalities.ties if set(ends) <= links)

    def write(self) -> None:
        """Write all bodies, the world first."""
        bodies = self.document.root.findall("worldbody")
        if not bodies:
            raise BadRobot(
                self.document.source,
                "<mujoco> without <worldbody> holds no bodies; give an MJCF of an arm",
            )
        link = ET.SubElement(self.robot, "link", name="world")
        for world in bodies:
            self._shapes(link, world, pin.SE3.Identity(), "main")
            self._bodies_of(world, "world", pin.SE3.Identity(), "main")
        self._scale_masses()

    def _bodies_of(self, body: ET.Element, link: str, offset: pin.SE3, childclass: str) -> None:
        for element, frame, inner in _parts(self.document, body, "body", childclass):
            self._body(element, link, offset * frame, inner)

    def _body(self, body: ET.Element, parent: str, frame: pin.SE3, childclass: str) -> None:
        """Write a body, whose parent's frame lies at ``frame`` in the parent link."""
        document = self.document
        self.count += 1
        name = body.get("name") or f"body_{self.count}"
        inner = body.get("childclass", childclass)
        if document.number(body.attrib, "gravcomp"):
            self.notes.append(f"body {name}: gravcomp is left out, as a controller's doing")
        placement = frame * document.pose(body.attrib)
        joints = self._joints(body, inner, name)
        for k, (given, joint) in enumerate(joints):
            child = name if k == len(joints) - 1 else f"{name}_before_{joints[k + 1][0]['name']}"
            placement = self._joint(given, joint, parent, child, placement)
            parent = child
            if child != name:
                ET.SubElement(self.robot, "link", name=child)
        if not joints:
            self._joint_element(f"{name}_weld", "fixed", parent, name, placement)
            placement = pin.SE3.Identity()
        link = ET.SubElement(self.robot, "link", name=name)
        inertia = self._inertia(body, inner, name)
        if inertia.mass > 0:
            link.append(inertial_element(placement.act(inertia).toDynamicParameters()))
        self._shapes(link, body, placement, inner)
        self._bodies_of(body, name, placement, inner)

    def _inertia(self, body: ET.Element, childclass: str, name: str) -> pin.Inertia:
        document = self.document
        way = document.compiler.get("inertiafromgeom", "auto")
        given = body.find("inertial")
        if given is not None and way != "true":
            return bounded(document, given_inertia(document, given))
        if way == "false":
            return bounded(document, pin.Inertia.Zero())
        geoms = _parts(document, body, "geom", childclass)
        return bounded(document, inertia_of_shapes(document, geoms, name))

    def _shapes(self, link: ET.Element, body: ET.Element, frame: pin.SE3, inner: str) -> None:
        for element, pose, childclass in _parts(self.document, body, "geom", inner):
            link.extend(collisions(self.document, element, frame * pose, childclass))

    def _joints(
        self, body: ET.Element, childclass: str, name: str
    ) -> list[tuple[dict[str, str], pin.SE3]]:
        """Attributes of a body's joints with a name each, and frames they are given in."""
        found: list[tuple[dict[str, str], pin.SE3]] = []
        for tag in ("joint", "freejoint"):
            for element, frame, inner in _parts(self.document, body, tag, childclass):
                given = self.document.attributes(element, inner) if tag == "joint" else {
                    **element.attrib, "type": "free"}  # fmt: skip
                given.setdefault("type", "hinge")
                given.setdefault("name", f"{name}_joint{len(found) + 1 if found else ''}")
                found.append((given, frame))
        return found

    def _joint(
        self, given: Mapping[str, str], frame: pin.SE3, parent: str, child: str, body: pin.SE3
    ) -> pin.SE3:
        """Write one joint; the body's frame in the link it carries."""
        document, name, kind = self.document, given["name"], given["type"]
        if kind not in _KINDS:
            self._joint_element(name, "floating", parent, child, body)
            return pin.SE3.Identity()
        hinge = kind == "hinge"
        anchor = frame.act(document.numbers(given, "pos", (0, 0, 0)))
        axis = frame.rotation @ document.numbers(given, "axis", (0, 0, 1))
        if not np.any(axis):
            raise BadRobot(document.source, f"joint '{name}' has an axis of no length")
        axis = axis / np.linalg.norm(axis)
        rest = self._coordinate(given, "ref", hinge)
        back = (
            pin.SE3(about(axis, -rest), np.zeros(3)) if hinge else pin.SE3(np.eye(3), -rest * axis)
        )
        at_anchor = pin.SE3(np.eye(3), anchor)
        element = self._joint_element(
            name, self._kind(given, hinge), parent, child, body * at_anchor * back
        )
        ET.SubElement(element, "axis", xyz=numbers_text(axis))
        self._facts(element, given, hinge)
        return at_anchor.inverse()

    def _coordinate(self, given: Mapping[str, str], key: str, hinge: bool) -> float:
        value = self.document.number(given, key)
        return self.document.angle(value) if hinge else value

    def _kind(self, given: Mapping[str, str], hinge: bool) -> str:
        if not hinge:
            return "prismatic"
        return "revolute" if self._limited(given) else "continuous"

    def _limited(self, given: Mapping[str, str]) -> bool:
        said = given.get("limited", "auto")
        if said != "auto":
            return said == "true"
        return "range" in given and self.document.compiler.get("autolimits", "true") == "true"

    def _facts(self, element: ET.Element, given: Mapping[str, str], hinge: bool) -> None:
        """Limits, friction, rotor inertia and spring of a joint."""
        document, name = self.document, given["name"]
        drive = self.actuation.get(name, JointActuation())
        limit = {"effort": repr(drive.effort(document, given)), "velocity": "0"}
        if self._limited(given):
            low, high = document.numbers(given, "range", (0, 0)).tolist()
            low, high = (document.angle(x) if hinge else x for x in (low, high))
            limit |= {"lower": repr(low), "upper": repr(high)}
        ET.SubElement(element, "limit", limit)
        damping = self._linear(given, "damping") + drive.damping
        friction = document.number(given, "frictionloss")
        if damping or friction:
            ET.SubElement(element, "dynamics", damping=repr(damping), friction=repr(friction))
        self.armature[name] = document.number(given, "armature") + drive.armature
        if stiffness := self._linear(given, "stiffness"):
            self.springs[name] = (stiffness, self._coordinate(given, "springref", hinge))
        if document.numbers(given, "springdamper", (0, 0)).any():
            self.notes.append(f"joint {name}: springdamper is left out; give stiffness and damping")
        if name in self.equalities.followers:
            master, offset, multiplier = self.equalities.followers[name]
            ET.SubElement(element, "mimic", joint=master, multiplier=repr(multiplier),
                          offset=repr(offset))  # fmt: skip

    def _linear(self, given: Mapping[str, str], key: str) -> float:
        """The linear coefficient of a polynomial; a note says when there are others."""
        values = self.document.numbers(given, key, (0.0,), at_most=3)
        if values[1:].any():
            self.notes.append(f"joint {given['name']}: {key} beyond its first number is left out")
        return float(values[0])

    def _joint_element(
        self, name: str, kind: str, parent: str, child: str, placement: pin.SE3
    ) -> ET.Element:
        element = ET.SubElement(self.robot, "joint", name=name, type=kind)
        ET.SubElement(element, "parent", link=parent)
        ET.SubElement(element, "child", link=child)
        element.append(origin_element(placement.rotation, placement.translation))
        return element

    def _scale_masses(self) -> None:
        """Scale all inertias to the total mass that ``settotalmass`` asks for."""
        total = self.document.number(self.document.compiler, "settotalmass", -1.0)
        masses = [float(mass.get("value", "0")) for mass in self.robot.iter("mass")]
        if total <= 0 or not sum(masses):
            return
        for element in (*self.robot.iter("mass"), *self.robot.iter("inertia")):
            for key, value in element.attrib.items():
                element.set(key, repr(float(value) * total / sum(masses)))


def _parts(document: Document, body: ET.Element, tag: str, childclass: str) -> Iterator[Placed]:
    """A body's own elements of a kind, those in frames too, with frame and default class."""
    for element in body:
        if element.tag == tag:
            yield element, pin.SE3.Identity(), childclass
        elif element.tag == "frame":
            pose, inner = document.pose(element.attrib), element.get("childclass", childclass)
            for part, frame, own in _parts(document, element, tag, inner):
                yield part, pose * frame, own
