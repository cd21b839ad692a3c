"""Pinocchio's model of a URDF with all its joints."""

import os
import sys
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from xml.etree.ElementTree import Element, SubElement, tostring

import pinocchio as pin

from excitant.exceptions import BadRobot
from excitant.robots.limits import UNLIMITED
from excitant.robots.motion import Array
from excitant.robots.urdf_writer import ENDS

_RENAMED = " (link)"  # after the name of a link that is also that of a joint


def _bound_continuous_joints(root: Element) -> None:
    """Make continuous joints revolute with no limits, so that q and q̇ have the same size."""
    for joint in root.findall("joint[@type='continuous']"):
        joint.set("type", "revolute")
        limit = joint.find("limit")
        limit = SubElement(joint, "limit") if limit is None else limit
        limit.attrib |= {"lower": str(-UNLIMITED), "upper": str(UNLIMITED)}
        for key in ("effort", "velocity"):
            limit.set(key, limit.get(key) or str(UNLIMITED))


def _rename_links_called_as_joints(root: Element) -> None:
    """Give links that share a joint's name another one: Pinocchio cannot hold such joints."""
    joints = {joint.get("name") for joint in root.findall("joint")}
    named = [(link, "name") for link in root.findall("link")]
    named += [(end, "link") for tag in ENDS for end in root.findall(f"joint/{tag}")]
    for element, key in named:
        if element.get(key) in joints:
            element.set(key, f"{element.get(key)}{_RENAMED}")


def restore_link_names(model: pin.Model) -> None:
    """Give the links their names in the description again, once no joint is to be held."""
    for frame in model.frames:
        if frame.type == pin.FrameType.BODY:
            frame.name = frame.name.removesuffix(_RENAMED)


def build_model(root: Element, source: str) -> pin.Model:
    """Pinocchio's model; the URDF is changed into one that Pinocchio can take."""
    root.set("name", root.get("name") or "robot")
    _bound_continuous_joints(root)
    _rename_links_called_as_joints(root)
    with quietly(source):
        return pin.buildModelFromXML(tostring(root, encoding="unicode"))


@contextmanager
def quietly(source: str) -> Iterator[None]:
    """Run Pinocchio on a description: what it prints and raises is one `BadRobot`."""
    with tempfile.TemporaryFile() as sink:
        for stream in (sys.stdout, sys.stderr):
            if stream is not None:
                stream.flush()
        saved = [os.dup(stream) for stream in (1, 2)]
        for stream in (1, 2):
            os.dup2(sink.fileno(), stream)
        try:
            yield
        except Exception as error:
            sink.seek(0)
            lines = (
                *sink.read().decode(errors="replace").splitlines(),
                *str(error).splitlines(),
            )
            told = [
                line.partition("message:")[2]
                for line in lines
                if "message:" in line
            ]
            first = next(
                (s for line in (*told, *lines) if (s := line.strip())), repr(error)
            )
            raise BadRobot(source, f"Pinocchio cannot read it: {first}") from None
        finally:
            for stream, before in zip((1, 2), saved, strict=True):
                os.dup2(before, stream)
                os.close(before)


def with_held(model: pin.Model, held: Mapping[str, float]) -> pin.Model:
    """A copy of a model without some joints, whose bodies are part of what carries them."""
    named = model.copy()
    for frame in named.frames:
        if frame.type == pin.FrameType.BODY and frame.name in list(model.names):
            frame.name += _RENAMED  # see `_rename_links_called_as_joints`
    reduced = pin.buildReducedModel(named, *held_pose(named, held))
    restore_link_names(reduced)
    reduced.gravity = model.gravity
    return reduced


def held_pose(
    model: pin.Model, held: Mapping[str, float | None]
) -> tuple[list[int], Array]:
    """Indices of held joints, and a configuration that has them in place."""
    reference = pin.neutral(model)
    for name, value in held.items():
        joint = model.joints[model.getJointId(name)]
        if joint.nq == 1:
            reference[joint.idx_q] = value
    return [model.getJointId(name) for name in held], reference
