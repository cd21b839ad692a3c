"""An identified model as files for other programs, and whether it is one to publish."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
import yaml

from excitant.exceptions import UnknownName
from excitant.identify.estimate import Estimate
from excitant.identify.export.bodies import Tree, tree, written
from excitant.identify.export.mjcf import mjcf_text
from excitant.identify.export.sdf import sdf_text
from excitant.robots.effects import effect_entries
from excitant.robots.motion import Array
from excitant.robots.robot import Robot
from excitant.robots.urdf import urdf_with_parameters

__all__ = ["FORMATS", "Publication", "model_files", "publication"]

FORMATS = ("urdf", "mjcf", "sdf")
_OF_MOVING_JOINTS = ("axis", "limit", "dynamics", "mimic", "calibration", "safety_controller")
_AS_GOOD = 1.01  # times the error of the given model: what chance makes of equal ones


def model_files(
    model: Robot,
    stem: str,
    yaml_name: str,
    formats: Sequence[str] = FORMATS,
    gains: Array | None = None,
) -> dict[str, str]:
    """A robot as files; URDF and YAML always.

    The YAML refers to the URDF and adds what that cannot hold: `load_robot` reads it back to the
    same torque. The others are ``.xml`` (MJCF) and ``.sdf``. Payloads and corrections of inertia
    are part of the links in all of them.

    Args:
        model: The robot; its effects have values.
        stem: Name of the files without ending.
        yaml_name: Name of the YAML.
        formats: Some of `FORMATS`.
        gains: Drive gains, shape (nv,) [N·m/A], where torque was measured as current.

    Raises:
        UnknownName: A format that is not one of `FORMATS`.
        BadInput: An effect without values.
    """
    for name in formats:
        if name not in FORMATS:
            raise UnknownName("format", name, FORMATS)
    arm = tree(model)
    files = {
        f"{stem}.urdf": _urdf(arm, yaml_name),
        yaml_name: _yaml(arm, f"{stem}.urdf", gains),
    }
    if "mjcf" in formats:
        files[f"{stem}.xml"] = mjcf_text(arm, yaml_name, gains)
    if "sdf" in formats:
        files[f"{stem}.sdf"] = sdf_text(arm, yaml_name)
    return files


def _urdf(arm: Tree, complete: str) -> str:
    """URDF text of an arm; meshes and everything else in its URDF stay.

    Each moving link has the inertia of all it carries. Joints that are held become fixed joints
    at their position, since what they carry is part of other links now.
    """
    friction = {b.joint: (b.positive("viscous"), b.positive("coulomb")) for b in arm.bodies}
    root = ET.fromstring(urdf_with_parameters(arm.robot, arm.robot.phi, friction))
    held = {name for name, _ in arm.robot.locked}
    for joint in root.findall("joint"):
        if joint.get("name") in held:
            _fix(joint, arm.robot.model)
        for mimic in joint.findall("mimic"):
            if mimic.get("joint") in held:
                joint.remove(mimic)
    root.insert(0, ET.Comment(arm.comment("urdf", complete)))
    ET.indent(root)
    return ET.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _fix(joint: ET.Element, model: pin.Model) -> None:
    """Make a joint fixed where it is held: both its links are part of one body."""
    for tag in (*_OF_MOVING_JOINTS, "origin"):
        for element in joint.findall(tag):
            joint.remove(element)
    links = {element.tag: element.get("link") for element in joint}
    parent, child = (
        model.frames[model.getFrameId(links[end], pin.FrameType.BODY)].placement
        for end in ("parent", "child")
    )
    T = parent.actInv(child)
    rpy = written(pin.rpy.matrixToRpy(T.rotation))
    ET.SubElement(joint, "origin", xyz=written(T.translation), rpy=rpy)
    joint.set("type", "fixed")


def _yaml(arm: Tree, urdf: str, gains: Array | None) -> str:
    model, limits = arm.robot, arm.robot.limits
    names = ["position", "velocity", "acceleration", "torque"]
    names += ["jerk"] if np.isfinite(limits.jerk).any() else []
    content: dict[str, Any] = {
        "model": urdf,
        "joints": list(model.joints),
        "gravity": [float(g) for g in model.gravity],
        "limits": {name: getattr(limits, name).tolist() for name in names},
        "effects": effect_entries(model.effects),
    }
    if gains is not None:
        content["drive"] = {"gain_Nm_per_A": [float(gain) for gain in gains]}
    return yaml.safe_dump(content, sort_keys=False, allow_unicode=True)


@dataclass(frozen=True)
class Publication:
    """What becomes of an identified model.

    Attributes:
        files: Its files by name; none when it is not published.
        published: Whether it is.
        note: Why not, or why it is nevertheless, as a sentence; empty when nothing is to say.
    """

    files: Mapping[str, str]
    published: bool
    note: str


def publication(
    estimate: Estimate, *, formats: Sequence[str] = FORMATS, force: bool = False
) -> Publication:
    """Files of an identified model, unless the model as given predicts the hold-out better.

    It does when its nrmse, summed over the joints, is the smaller by more than 1 %.

    Args:
        estimate: What was identified.
        formats: Some of `FORMATS`.
        force: Publish whatever the hold-out says.

    Raises:
        UnknownName: A format that is not one of `FORMATS`.
    """
    gains = estimate.gains if estimate.data.unit == "A" else None
    files = model_files(estimate.model, "identified", "model.yaml", formats, gains)
    found, given = (
        float(np.nansum(accuracy.nrmse)) for accuracy in (estimate.validate, estimate.baseline)
    )
    if found <= _AS_GOOD * given:
        return Publication(files, True, "")
    why = (
        f"on the hold-out its nrmse summed over the joints is {found:.4g}, that of the model as "
        f"given {given:.4g}"
    )
    if force:
        return Publication(files, True, f"published because it was forced: {why}")
    advice = "record a motion that excites more, or give --force"
    return Publication({}, False, f"the identified model is not published: {why}; {advice}")
