"""An identified model as files for other programs, and whether it is one to publish.

MJCF is the format of MuJoCo, SDFormat 1.9 that of Gazebo and Drake. Viscous friction is
``damping`` there, Coulomb friction ``frictionloss`` or ``friction``, rotor inertia ``armature`` or
``drake:rotor_inertia``; a linear spring has its stiffness and reference in both, and a torque
offset is the bias of a joint's actuator in MJCF. Payloads and
corrections of inertia are part of the links, and joints that are held are part of what carries
them.
"""

from __future__ import annotations

import warnings
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import pinocchio as pin
import yaml

from excitant.exceptions import BadInput, UnknownName
from excitant.files import write_file
from excitant.identify.accuracy import Accuracy, worse_joints
from excitant.identify.objections import (
    HoldOut,
    Objection,
    objections,
    of_data,
    useless_joints,
)
from excitant.identify.preprocessing import Segment
from excitant.identify.refit import Refit
from excitant.identify.repeats import unsure_zeros
from excitant.identify.rows import predicted_torque
from excitant.identify.tables import of_bodies
from excitant.robots.effects import (
    Effect,
    effect_entries,
    turning,
    turning_speed,
)
from excitant.robots.limits import LIMIT_NAMES
from excitant.robots.motion import Array, Mask
from excitant.robots.parameters import inertia
from excitant.robots.robot import Robot, own_axes
from excitant.robots.urdf_writer import LIMIT_KEYS, current_urdf, numbers_text

if TYPE_CHECKING:
    from excitant.identify.estimate import Estimate

USUAL = ("urdf", "mjcf", "sdf")
FORMATS = (*USUAL, "ros2_control")
JOINT_PROPERTIES = ("viscous", "coulomb", "offset", "rotor")
_SUFFIXES = {"urdf": ".urdf", "mjcf": ".xml", "sdf": ".sdf"}
_ENDS = {**_SUFFIXES, "ros2_control": "_ros2_control.yaml"}
MODEL_SUFFIXES = (*_SUFFIXES.values(), ".yaml")
DEFAULT_GRAVITY = (0.0, 0.0, -9.81)
SHORTEST_LINE = (
    1e-3  # distance of joints [m], below which no line is drawn between them
)
_MADE_UP = "its parameters are fitted to make up for it: they are not the model's"
_ROS2_REMARKS = (
    "gains: read by joint_trajectory_controller with an effort interface, [N·m·s/rad]",
    "friction [N·m·s/rad, N·m, N·m, kg·m²], links [kg, m in the frame of the joint, kg·m² about",
    "the centre of mass in its axes: xx, xy, xz, yy, yz, zz], gravity:",
    "names of excitant's own, for controllers that declare them",
)
_MJCF_NAMES = {"damping": "viscous", "frictionloss": "coulomb", "armature": "rotor"}
_STIFF_FRICTION = {  # with its default, a slow joint has half of its dry friction
    "solreffriction": (0.004, 1.0),
    "solimpfriction": (0.999, 0.999),
}
LISTED_EFFECTS = 3  # in a sentence on files that are not written


def model_files(
    model: Robot,
    stem: str,
    yaml_name: str,
    formats: Sequence[str] = USUAL,
    gains: Array | None = None,
    *,
    exported: Sequence[ExportedFile] | None = None,
    known: Mask | None = None,
) -> dict[str, str]:
    """A robot as files; URDF and YAML always, and its base parameters with covariance where known.

    The YAML refers to the URDF and adds what that cannot hold: `load_robot` reads it back to the
    same torque and the same estimate. The others are ``.xml`` (MJCF), ``.sdf``, and
    ``_ros2_control.yaml`` with parameters of controllers. Gains, shape (nv,) [N·m/A], are given
    where torque was measured as current; where one is not ``known``, shape (nv,), only the YAML
    holds it, and friction, offset and rotor inertia of its joint, which predict the current
    together. ``exported`` says what formats hold, and which are refused; all hold the robot's own
    parameters when None. Where the URDF is refitted or refused, the description that the YAML
    refers to is named ``.links``, and says that it is no model by itself.

    Raises:
        UnknownName: A format that is not one of `FORMATS`.
        BadInput: An effect without values.
    """
    UnknownName.refuse("format", formats, FORMATS)
    arm = folded(model)
    told = told_in_torque(arm, known)
    accepted = [file for file in exported or () if not file.refused]
    own = {file.file_format: file.arm for file in accepted if file.refitted}
    urdf = exported is None or any(x.file_format == "urdf" for x in accepted)

    def remark(file_format: str) -> str:
        return comment(told, file_format, yaml_name, own.get(file_format))

    alone = urdf and "urdf" not in own
    description = f"{stem}.urdf" if alone else f"{stem}.links"
    table = f"{yaml_name.removesuffix('.yaml')}-estimate.csv"
    beside = {} if model.estimate is None else {"estimate": table}
    files = {}
    if "urdf" in own:
        files[f"{stem}.urdf"] = _urdf(own["urdf"], remark("urdf"))
    links = [
        f"links and joints of {yaml_name}",
        "no model without the effects there",
    ]
    words = remark("urdf") if alone else _commented(links)
    files[description] = _urdf(held_by(told, "urdf"), words)
    files[yaml_name] = _yaml(arm, {"model": description} | beside, gains)
    if unknown := _unknown(arm, known):
        files[yaml_name] = (
            f"# {unknown}: its current is predicted, no torque\n{files[yaml_name]}"
        )
        gains = None  # a control is a torque
    # the same with or without bodies folded into links
    if model.estimate is not None:
        files[table] = model.estimate.csv()
    writers: dict[str, Callable[[Robot, str], str]] = {
        "mjcf": partial(_mjcf, gains=gains),
        "sdf": _sdf,
        "ros2_control": _ros2_control,
    }
    for name, write in writers.items():
        if name in formats:
            arm_there = own.get(name) or held_by(told, name)
            files[f"{stem}{_ENDS[name]}"] = write(arm_there, remark(name))
    return files


def told_in_torque(arm: Robot, known: Mask | None) -> Robot:
    """A `folded` arm without properties of joints whose drive gain is not known, (nv,)."""
    if known is None:
        return arm
    effects = []
    for effect in arm.effects:
        keep = known[effect.rows(arm)]
        if effect.exported.joint_property and not keep.all():
            joints = tuple(np.array(effect.joints)[keep].tolist())
            values = np.reshape(effect.values or (), (len(keep), -1))[keep]
            effect = replace(effect, joints=joints, values=None).with_values(values)
        if effect.joints:
            effects.append(effect)
    return arm.with_effects(effects)


def _unknown(arm: Robot, known: Mask | None) -> str:
    """At which joints the drive gain is not known; empty where there are none."""
    if known is None or known.all():
        return ""
    names = ", ".join(np.array(arm.joints)[~known].tolist())
    return f"not determined: the drive gain of {names}"


def folded(robot: Robot) -> Robot:
    """The robot with bodies among its effects in its links.

    Raises:
        BadInput: An effect without values.
    """
    arm = robot
    torques = []
    for effect in robot.effects:
        if effect.values is None:
            raise BadInput(
                f"{robot.name}: effect {effect.name} has no values; identify it first"
            )
        if effect.role == "torque":
            torques.append(effect)
        else:
            arm = effect.applied(arm)
    return arm.with_effects(torques)


def lacking(arm: Robot, file_format: str) -> list[str]:
    """What a file cannot hold of an arm whose bodies are `folded`, in words with the joints."""
    missing = dict[str, list[str]]()
    for effect in arm.effects:
        name = effect.label
        values = effect.values or ()
        joints = list(effect.joints)
        below = list[str]()
        if effect.exported.joint_property:
            lowest = [p.lower for p in effect.parameters(arm)]
            owners = np.repeat(joints, len(effect.own_terms)).tolist()
            rows = list(zip(owners, values, lowest, strict=True))
            joints = [joint for joint, value, _ in rows if value]
            below = [joint for joint, value, low in rows if value < low]
        if file_format not in effect.exported.formats:
            missing.setdefault(name, []).extend(joints)
        else:
            missing.setdefault(f"negative {name}", []).extend(below)
        # no format has friction that turns over a range of speeds
        if turning_speed(effect) and any(values):
            missing.setdefault("gradual reversal of the friction", []).extend(
                joints
            )
    found = []
    for what, joints in missing.items():
        joints = [*dict.fromkeys(joints)]
        listed = "all joints" if len(joints) == arm.nv else ", ".join(joints)
        if joints:
            found.append(f"{what} of {listed}")
    return found


def held_by(arm: Robot, file_format: str) -> Robot:
    """What a format holds of a `folded` arm: what its file says, with one effect a property.

    Values of a joint property add up, and are cut off at the lowest that it may have.
    """
    effects: dict[str, Effect] = {}
    for effect in arm.effects:
        if file_format not in effect.exported.formats:
            continue
        whole = replace(turning(effect, 0.0), joints=arm.joints)
        values = np.zeros((arm.nv, len(effect.own_terms)))
        if before := effects.get(effect.exported.joint_property):
            values += np.reshape(before.values or (), values.shape)
        values[effect.rows(arm)] += np.reshape(
            effect.values or (), (-1, values.shape[1])
        )
        effects[effect.exported.joint_property] = whole.with_values(values)
    lowest = {
        name: [p.lower for p in effect.parameters(arm)]
        for name, effect in effects.items()
    }
    return arm.with_effects(
        [
            effect.with_values(np.maximum(effect.values or (), lowest[name]))
            for name, effect in effects.items()
        ]
    )


def _drives(held: Robot) -> Mapping[str, Array]:
    """Values of the joint properties that a format holds, each of shape (nv,)."""
    drives = dict.fromkeys(JOINT_PROPERTIES, np.zeros(held.nv))
    return drives | {
        e.exported.joint_property: np.array(e.values) for e in held.effects
    }


def _springs(held: Robot) -> list[tuple[float, float]]:
    """Stiffness k and rest q_0 of the spring of each joint, τ = k (q − q_0); both 0 of none.

    A moment alone is that of a spring so soft that no position changes it.
    """
    none = np.zeros(2 * held.nv)
    values = np.reshape(_drives(held).get("spring", none), (held.nv, 2))
    softest = float(np.finfo(float).eps)
    springs = []
    for stiffness, moment in values.tolist():
        k = stiffness or softest * bool(moment)
        springs.append((k, -moment / k if k else 0.0))
    return springs


def comment(
    robot: Robot, file_format: str, complete: str, refit: Robot | None = None
) -> str:
    """Deviations of a file from the model, and the file that is complete.

    ``refit`` is what the file holds where that is fitted to make up for what it lacks.
    """
    left_out = lacking(robot, file_format)
    own = [
        note
        for effect in (refit or robot).effects
        if (note := effect.exported.formats.get(file_format))
        and any(effect.values or ())
    ]
    if file_format == "sdf" and not np.allclose(robot.gravity, DEFAULT_GRAVITY):
        own.append(
            "gravity is that of the world, which Drake wants to be told in code"
        )
    missing = [f"not in this file: {name}" for name in left_out]
    made_up = [_MADE_UP] * (refit is not None)
    last = [f"{complete} holds everything"] if left_out else []
    return _commented(["identified by excitant", *missing, *made_up, *own, *last])


def _commented(lines: Sequence[str]) -> str:
    text = "\n    ".join(("", *lines))
    while "--" in text:  # which ends no comment
        text = text.replace("--", "- -")
    return f"{text}\n  "


def _urdf(held: Robot, remark: str) -> str:
    root = ET.fromstring(current_urdf(held))
    root.insert(0, ET.Comment(remark))
    return _text_of(root, declared=True)


def _yaml(arm: Robot, beside: Mapping[str, str], gains: Array | None) -> str:
    limits = arm.limits
    names = LIMIT_NAMES[: limits.orders + 1]
    content = {
        **beside,
        "joints": list(arm.joints),
        "gravity": arm.gravity.tolist(),
        "limits": {name: getattr(limits, name).tolist() for name in names},
        "effects": effect_entries(arm.effects),
    }
    if gains is not None:
        content["drive"] = {"gain_Nm_per_A": [float(gain) for gain in gains]}
    return yaml.safe_dump(content, sort_keys=False, allow_unicode=True)


def _ros2_control(arm: Robot, remark: str) -> str:
    """Parameters of ROS 2 for any node, which are doubles throughout, in SI units."""
    drives = _drives(arm)
    friction = {
        joint: {name: float(drives[name][j]) for name in JOINT_PROPERTIES}
        for j, joint in enumerate(arm.joints)
    }
    bodies = map(inertia, arm.phi.reshape(-1, 10))
    links = {
        link: {
            "mass": float(body.mass),
            "centre_of_mass": body.lever.tolist(),
            "inertia": body.inertia[np.triu_indices(3)].tolist(),
        }
        for link, body in zip(arm.links, bodies, strict=True)
    }
    gains = {
        joint: {"ff_velocity_scale": own["viscous"]}
        for joint, own in friction.items()
    }
    parameters = {"gains": gains, "friction": friction, "links": links}
    parameters |= {"gravity": arm.gravity.tolist()}
    remarks = remark.strip().splitlines()
    head = "".join(f"# {line.strip()}\n" for line in [*remarks, *_ROS2_REMARKS])
    content = {"/**": {"ros__parameters": parameters}}
    return head + yaml.safe_dump(content, sort_keys=False, allow_unicode=True)


def _mjcf(arm: Robot, remark: str, gains: Array | None) -> str:
    """MJCF text; a control is a torque [N·m], or a current [A] where drive gains are given."""
    drives = _drives(arm)
    springs = _springs(arm)
    root = ET.Element("mujoco", model=arm.name)
    root.append(ET.Comment(remark))
    _add(
        root, "compiler", angle="radian", inertiafromgeom="false", autolimits="true"
    )
    _add(root, "option", gravity=arm.gravity, integrator="implicitfast")
    _add(_add(root, "default"), "geom", contype="0", conaffinity="0", group="1")
    elements = [_add(root, "worldbody")]  # by Pinocchio's number of the joint
    _sites(elements[0], arm, 0)
    actuators = _add(root, "actuator")
    for j, (joint, link) in enumerate(zip(arm.joints, arm.links, strict=True)):
        place = arm.model.jointPlacements[j + 1]
        parent = elements[arm.model.parents[j + 1]]
        length = float(np.linalg.norm(place.translation))
        # a line to look at, no more
        if parent is not elements[0] and length > SHORTEST_LINE:
            line = f"0 0 0 {numbers_text(place.translation)}"
            _add(
                parent,
                "geom",
                type="capsule",
                size=0.1 * min(length, 0.5),
                fromto=line,
            )
        name = link if link != "world" else "world_"  # that of MuJoCo's own root
        body = _add(parent, "body", name=name, **_pose(place))
        elements.append(body)
        central = inertia(arm.phi[10 * j : 10 * j + 10])
        moments, axes = np.linalg.eigh(central.inertia)
        axes[:, 0] *= np.linalg.det(axes)
        frame = _pose(pin.SE3(axes, central.lever))
        mass = central.mass
        _add(body, "inertial", **frame, mass=mass, diaginertia=moments)
        kind = "hinge" if arm.revolute[j] else "slide"
        limits = arm.limits.position[j]
        properties = {"axis": own_axes(arm)[j]}
        if np.isfinite(limits).all():
            properties["range"] = limits
        for key, drive in _MJCF_NAMES.items():
            if drives[drive][j]:
                properties[key] = drives[drive][j]
        stiffness, rest = springs[j]
        if stiffness:
            properties |= {"stiffness": stiffness, "springref": rest}
        if "frictionloss" in properties:
            properties |= _STIFF_FRICTION
        _add(body, "joint", name=joint, type=kind, **properties)
        _sites(body, arm, j + 1)
        # force = gear (control + bias), the bias against the offset that the model needs
        gain = 1.0 if gains is None else float(gains[j])
        actuator = _add(actuators, "general", name=joint, joint=joint, gear=gain)
        if offset := drives["offset"][j]:
            actuator.set("biastype", "affine")
            actuator.set("biasprm", numbers_text([-offset / gain, 0.0, 0.0]))
        largest = arm.limits.torque[j] / abs(gain)
        if np.isfinite(largest):
            actuator.set("ctrlrange", numbers_text([-largest, largest]))
    return _text_of(root)


def _sites(parent: ET.Element, arm: Robot, joint: int) -> None:
    for name, place in _frames(arm, joint):
        _add(parent, "site", name=name, **_pose(place))


def _sdf(arm: Robot, remark: str) -> str:
    """SDF text of an arm, fixed in a world; links, joints and frames share one list of names."""
    drives = _drives(arm)
    springs = _springs(arm)
    root = ET.Element("sdf", {"version": "1.9", "xmlns:drake": "drake.mit.edu"})
    root.append(ET.Comment(remark))
    world = _add(root, "world", name="default")
    _add(world, "gravity", arm.gravity)
    model = _add(world, "model", name=_unreserved(arm.name))
    links = [_unreserved(link) for link in arm.links]
    taken = set(links)
    links.insert(0, _fresh("base", taken))  # by Pinocchio's number of the joint
    joints = [_fresh(joint, taken) for joint in arm.joints]
    _add(model, "link", name=links[0])
    mount = _add(model, "joint", name=_fresh("mount", taken), type="fixed")
    _add(mount, "parent", "world")
    _add(mount, "child", links[0])
    for j, (link, joint) in enumerate(zip(links[1:], joints, strict=True)):
        _sdf_link(model, link, joint, inertia(arm.phi[10 * j : 10 * j + 10]))
        limits = arm.limits
        bounded = np.isfinite(limits.position[j]).all()
        kind = (
            "prismatic"
            if not arm.revolute[j]
            else "revolute"
            if bounded
            else "continuous"
        )
        element = _add(model, "joint", name=joint, type=kind)
        parent = links[arm.model.parents[j + 1]]
        _placed(element, arm.model.jointPlacements[j + 1], parent)
        _add(element, "parent", parent)
        _add(element, "child", link)
        axis = _add(element, "axis")
        _add(axis, "xyz", own_axes(arm)[j])
        limit = _add(axis, "limit")
        ends = (*limits.position[j], limits.torque[j], limits.velocity[j])
        for key, value in zip(LIMIT_KEYS, ends, strict=True):
            if np.isfinite(value):
                _add(limit, key, value)
        dynamics = _add(axis, "dynamics")
        _add(dynamics, "damping", drives["viscous"][j])
        _add(dynamics, "friction", drives["coulomb"][j])
        stiffness, rest = springs[j]
        if stiffness:
            _add(dynamics, "spring_reference", rest)
            _add(dynamics, "spring_stiffness", stiffness)
        if drives["rotor"][j] > 0:
            _add(element, "drake:rotor_inertia", drives["rotor"][j])
        _sdf_frames(model, arm, j + 1, link, taken)
    _sdf_frames(model, arm, 0, links[0], taken)
    return _text_of(root, declared=True)


def _sdf_link(
    model: ET.Element, name: str, joint: str, central: pin.Inertia
) -> None:
    link = _add(model, "link", name=name)
    _add(link, "pose", relative_to=joint)
    inertial = _add(link, "inertial")
    _add(inertial, "pose", [*central.lever, 0, 0, 0])
    _add(inertial, "mass", central.mass)
    tensor = _add(inertial, "inertia")
    for i, j in zip(*np.triu_indices(3), strict=True):
        _add(tensor, f"i{'xyz'[i]}{'xyz'[j]}", central.inertia[i, j])


def _sdf_frames(
    model: ET.Element, arm: Robot, joint: int, link: str, taken: set[str]
) -> None:
    for frame, place in _frames(arm, joint):
        name = _fresh(_unreserved(frame), taken)
        _placed(_add(model, "frame", name=name, attached_to=link), place, link)


def _placed(parent: ET.Element, T: pin.SE3, relative_to: str) -> None:
    pose = [*T.translation, *pin.Quaternion(T.rotation).coeffs()]
    _add(parent, "pose", pose, relative_to=relative_to, rotation_format="quat_xyzw")


def _fresh(name: str, taken: set[str]) -> str:
    while name in taken:
        name += "_"
    taken.add(name)
    return name


def _unreserved(name: str) -> str:
    """A name that SDF does not keep for itself: ``world``, and what two underscores enclose."""
    name = name.replace("::", "_")
    reserved = name == "world" or (name.startswith("__") and name.endswith("__"))
    return f"{name.strip('_')}_link" if reserved else name


def _frames(robot: Robot, joint: int) -> Iterator[tuple[str, pin.SE3]]:
    """Links that are fixed to the one of a joint of Pinocchio's, 0 for the base; their poses."""
    for frame in list(robot.model.frames):
        body = frame.type == pin.FrameType.BODY and frame.parentJoint == joint
        if body and frame.name not in robot.links:
            yield str(frame.name), frame.placement


def _pose(T: pin.SE3) -> dict[str, str]:
    x, y, z, w = pin.Quaternion(T.rotation).coeffs()
    return {"pos": numbers_text(T.translation), "quat": numbers_text([w, x, y, z])}


def _add(
    parent: ET.Element,
    tag: str,
    content: str | npt.ArrayLike | None = None,
    **attributes: Any,
) -> ET.Element:
    own = {
        k: v if isinstance(v, str) else numbers_text(v)
        for k, v in attributes.items()
    }
    element = ET.SubElement(parent, tag, own)
    if content is not None:
        element.text = (
            content if isinstance(content, str) else numbers_text(content)
        )
    return element


def _text_of(root: ET.Element, declared: bool = False) -> str:
    ET.indent(root)
    return ET.tostring(root, encoding="unicode", xml_declaration=declared) + "\n"


@dataclass(frozen=True, eq=False)
class ExportedFile:
    """How well a program that reads one file of a model predicts the hold-out.

    Attributes:
        file: Its name.
        accuracy: Errors of what the file holds, joint by joint.
        arm: What the file holds.
        file_format: Its format; empty of the file that holds everything.
        lacks: What its format cannot hold, in words.
        refitted: Whether bodies and joint properties are fitted to make up for that.
        refused: What predicts the hold-out better, so that it is not written; empty where it is.
    """

    file: str
    accuracy: Accuracy
    arm: Robot
    file_format: str = ""
    lacks: tuple[str, ...] = ()
    refitted: bool = False
    refused: str = ""

    def entry(self) -> dict[str, Any]:
        """Its entry in ``result.json``."""
        return {
            "file": self.file,
            "written": not self.refused,
            "nrmse": self.accuracy.nrmse.tolist(),
            "rms": self.accuracy.rms.tolist(),
            "lacks": list(self.lacks),
            "refitted": self.refitted,
        }


@dataclass(frozen=True)
class Publication:
    """Publication of an identified model: files, or the reason for none."""

    files: Mapping[str, str]  # by name; none when it is not published
    published: bool
    note: str  # why not, or why it is nevertheless; empty when nothing is to say
    exported: tuple[ExportedFile, ...] = ()  # of a published model, by format

    @property
    def refusal(self) -> str:
        """Why the model is not published; empty where it is."""
        return "" if self.published else self.note

    def arm(self, file_format: str) -> Robot | None:
        """What the file of a format holds of a published model; None without one."""
        arms = [e.arm for e in self.exported if e.file_format == file_format]
        return arms[0] if arms else None

    def note_in(self, result: dict[str, Any]) -> None:
        """Say in the contents of a result.json whether the model is published, and why not."""
        result |= {"published": self.published, "refusal": self.refusal}
        result["exported"] = [file.entry() for file in self.exported]
        result["notes"] = [*result["notes"], *[self.note] * bool(self.note)]


def save_model(estimate: Estimate, path: str | Path) -> list[Path]:
    """Write an identified model as .urdf, .xml (MJCF), .sdf, or .yaml with the files beside it.

    A file that `publication` would leave out is written with a warning; beside a .yaml, a URDF is
    what `publication` would write.

    Raises:
        BadInput: A path without a suffix.
        UnknownName: Another suffix.
    """
    path = Path(path)
    if not path.suffix:
        why = "name a file, such as model.yaml; excitant.save(estimate, folder) saves the run"
        raise BadInput(f"{path}: a model is saved into one file; {why}")
    formats = {suffix: name for name, suffix in _SUFFIXES.items()}
    UnknownName.refuse("format", [path.suffix], sorted(MODEL_SUFFIXES))
    gains = estimate.gains if estimate.data.unit == "A" else None
    complete = f"{path.stem}.yaml"
    known = None if estimate.drive is None else estimate.drive.known
    asked = formats.get(path.suffix)
    judged = exported_files(
        estimate.model,
        path.stem,
        complete,
        hold_out(estimate),
        estimate.data.train,
        [asked or "urdf"],
    )
    exported: Sequence[ExportedFile] | None = judged
    if asked:
        if poor := [file for file in judged if file.refused]:
            warnings.warn(f"{path.name}: {_shortcoming(poor)}", stacklevel=2)
        # where no drive gain is known, the YAML alone is judged
        exported = _accepted(judged) if len(judged) > 1 else None
    files = model_files(
        estimate.model,
        path.stem,
        complete,
        [asked] if asked else [],
        gains,
        exported=exported,
        known=known,
    )
    if unknown := _unknown(estimate.model, known):
        warnings.warn(f"{path.name}: {unknown}", stacklevel=2)
    written = [path] if asked else [path.with_name(name) for name in files]
    for file in written:
        write_file(file, files[file.name])
    return written


def publication(
    estimate: Estimate,
    *,
    formats: Sequence[str] = USUAL,
    force: bool = False,
    faults: Sequence[str] = (),
) -> Publication:
    """Files of an identified model, unless the data or the hold-out speak against it.

    The data do by proven ``faults`` that were not repaired, a sentence each. Bodies do that no
    description misses so far, unless the data tell them alone (`of_bodies`). The hold-out does
    where no model, the mean torque of a joint, predicts it better (r² < 0), and where the model as
    given predicts all joints together better than chance allows (`chance_of_loss`). With ``force``
    the model is published all the same. Joints that the model as given predicts better, though not
    all together, are named. So are files whose format lacks so much of the model that they
    predict the hold-out worse than the model as given: they are not written.

    Raises:
        UnknownName: A format that is not one of `FORMATS`.
    """
    poses = estimate.data.poses
    model = estimate.model
    if poses is not None:
        model = model.with_effects([*model.effects, *poses.kept])
    return published(
        model,
        "identified",
        "model.yaml",
        hold_out(estimate),
        estimate.data.train,
        formats=formats,
        gains=estimate.gains if estimate.data.unit == "A" else None,
        force=force,
        against=[
            *of_data(
                (*faults, *unsure_zeros(estimate.given, estimate.differences))
            ),
            *of_bodies(estimate),
        ],
    )


def hold_out(estimate: Estimate) -> HoldOut:
    """The hold-out of an identification."""
    return HoldOut(
        estimate.data.validate,
        estimate.holdout,
        estimate.gains,
        estimate.predicted,
        estimate.predicted_given,
        estimate.drive,
    )


def published(
    model: Robot,
    kind: str,
    yaml_name: str,
    judged: HoldOut,
    fitted: Sequence[Segment],
    *,
    formats: Sequence[str] = USUAL,
    gains: Array | None = None,
    force: bool,
    against: Sequence[Objection],
) -> Publication:
    """The same of any model, whose files are named by its kind, ``identified`` or ``extended``.

    It was ``fitted`` to these segments. Gains are written, shape (nv,) [N·m/A], where torque was
    measured as current. What speaks ``against`` it comes before what the hold-out has to object.
    """
    UnknownName.refuse("format", formats, FORMATS)
    against = [*against, *objections(model, judged)]
    worse = worse_joints(
        model.joints, judged.series, judged.predicted, judged.nominal
    )
    reasons = "; ".join(objection.why for objection in against)
    if len(against) == 1 and worse and judged.got_worse:
        reasons += f"; worst at {'; '.join(worse)}"
    if against and not force:
        advice = against[0].advice
        note = f"the {kind} model is not published: {reasons}; {advice}, or give --force"
        return Publication({}, False, note)
    known = None if judged.drive is None else judged.drive.known
    if known is not None and not known.any():
        formats = ()
    wanted = ("urdf", *formats)
    exported = exported_files(model, kind, yaml_name, judged, fitted, wanted)
    if force:
        exported = _accepted(exported)
    files = model_files(
        model, kind, yaml_name, formats, gains, exported=exported, known=known
    )
    notes = [f"published because it was forced: {reasons}"] if against else []
    if worse and not against:
        notes.append(
            f"the model as given predicts the hold-out better at {'; '.join(worse)}"
        )
    if unknown := _unknown(model, known):
        held = "hold no friction, offset and rotor inertia there"
        if formats == ():
            held = f"are not written; {yaml_name} predicts currents"
        notes.append(f"{unknown}: files of other formats {held}")
    if refused := [file for file in exported if file.refused]:
        notes.append(_unwritten(refused, yaml_name))
    unwritten = {file.file for file in refused}
    written = {name: text for name, text in files.items() if name not in unwritten}
    return Publication(written, True, "; ".join(notes), exported)


def exported_files(
    model: Robot,
    stem: str,
    yaml_name: str,
    judged: HoldOut,
    fitted: Sequence[Segment],
    formats: Sequence[str],
) -> tuple[ExportedFile, ...]:
    """Files of a model that a program can read as one, with their errors on the hold-out.

    One that lacks something is refitted on the segments that the model was fitted to, where that
    makes up for it (`Refit`). It is refused where it predicts the hold-out worse than no model at
    a joint, as a model is, or worse than the nominal one by the nrmse summed over the joints. There
    are none where no drive gain is known.
    """
    known = None if judged.drive is None else judged.drive.known
    stated = np.ones(model.nv, dtype=bool) if known is None else known
    if not stated.any():
        formats = ()
    arm = told_in_torque(folded(model), known)
    refit = Refit(arm, fitted, judged.gains, stated)
    # poses show nothing of what a refit would move
    of_motion = not any(segment.of_poses for segment in fitted)
    exported = [ExportedFile(yaml_name, judged.accuracy, model)]
    for file_format, end in _ENDS.items():
        if file_format not in formats:
            continue
        name = f"{stem}{end}"
        lacks = tuple(lacking(arm, file_format))
        held = held_by(arm, file_format)
        file = ExportedFile(name, judged.accuracy, held, file_format, lacks)
        if lacks:
            refitted = refit.of(held, file_format) if of_motion else None
            if refitted is not None:
                file = replace(file, arm=refitted, refitted=True)
            file = _judged(file, judged)
        exported.append(file)
    return tuple(exported)


def _judged(file: ExportedFile, judged: HoldOut) -> ExportedFile:
    """The file with its own errors, refused where something else predicts better."""
    tau = predicted_torque(file.arm, judged.segments) / judged.gains
    if judged.drive is not None:  # elsewhere it states no torque
        tau = np.where(judged.drive.known, tau, judged.predicted)
    reduced = replace(judged, predicted=tau)
    useless = useless_joints(file.arm.joints, reduced)
    nominal, error = (
        float(np.nansum(accuracy.nrmse))
        for accuracy in (judged.nominal_accuracy, reduced.accuracy)
    )
    why = f"no model at {'; '.join(useless)}" if useless else ""
    if error > nominal and not useless:
        why = (
            "the model as given, nrmse summed over the joints "
            f"{nominal:.4g} → {error:.4g}"
        )
    return replace(file, accuracy=reduced.accuracy, refused=why)


def _accepted(exported: Sequence[ExportedFile]) -> tuple[ExportedFile, ...]:
    """The files, none of them refused."""
    return tuple(replace(file, refused="") for file in exported)


def _unwritten(files: Sequence[ExportedFile], complete: str) -> str:
    """A line on the files that are not written, at least one of them."""
    verb = "is" if len(files) == 1 else "are"
    names = ", ".join(file.file for file in files)
    return f"{names} {verb} not written: {_shortcoming(files)}; {complete} holds everything"


def _shortcoming(files: Sequence[ExportedFile]) -> str:
    """What files lack that predict the hold-out worse than something else."""
    common = [x for x in files[0].lacks if all(x in file.lacks for file in files)]
    few = [*common[:LISTED_EFFECTS], *["and more"] * (len(common) > LISTED_EFFECTS)]
    without = (
        f"without {', '.join(few)}" if few else "without what its format lacks"
    )
    return f"{without}, the hold-out is predicted worse than by {files[0].refused}"
