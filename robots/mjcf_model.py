"""MJCF text as a URDF: MuJoCo compiles it, and its model is written out.

Bodies become links, hinges and slides become revolute, continuous and prismatic joints; several
joints on one body become a chain of links without mass. A link's frame lies at the anchor of its
last joint with the axes of the body, so that its URDF states what MuJoCo computes with. What a
URDF has no word for is kept beside it: gravity, armatures, springs, loops. This module is imported
in a child process, which opens no file.
"""

import warnings
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any
from xml.etree.ElementTree import Element, SubElement

import msgspec
import numpy as np
import numpy.typing as npt
import pinocchio as pin

from excitant.robots.angles import Angles
from excitant.robots.limits import UNLIMITED
from excitant.robots.motion import Array
from excitant.robots.urdf_writer import (
    collision,
    inertial_element,
    joint_element,
    numbers_text,
    urdf_text,
)

# at once: the child that imports this module may open no file afterwards; `excitant.robots.mjcf`
# asks for it where it is missing
with suppress(ImportError):
    import mujoco


def described(
    text: str,
    models: Mapping[str, bytes],
    assets: Mapping[str, bytes],
    places: Mapping[str, str],
) -> bytes:
    """`excitant.robots.mjcf.Description` of an MJCF as JSON, but for what it may lack.

    Args:
        text: The MJCF, without includes.
        models: Other MJCF that it attaches, by the names that it gives them.
        assets: Content of its meshes and height fields, by those names.
        places: Where those are, and others that are missing.

    Raises:
        ValueError: It is none, or not of an arm.
    """
    angles = Angles()
    mujoco.set_mju_user_warning(lambda _: None)  # else it writes a log
    try:
        spec = mujoco.MjSpec.from_string(
            text, include=dict(models), assets=dict(assets)
        )
        if not len(spec.worldbody.bodies):
            raise _Unfit("its <worldbody> holds no bodies; give an MJCF of an arm")
        spec.compiler.fusestatic = False
        _leave_out_missing(spec, {*places} - {*assets}, places)
        _take_exact_angles(spec, angles)
        with warnings.catch_warnings():
            # of attributes that MuJoCo will drop
            warnings.simplefilter("ignore", UserWarning)
            model = spec.compile()
    except _Unfit:
        raise
    except (ValueError, RuntimeError) as error:
        why = str(error).replace("XML Error:", "").replace("Error:", "")
        for name, place in places.items():
            why = why.replace(name, place)
        raise ValueError(f"MuJoCo cannot read it: {why}") from None
    _check_numbers(model)
    writer = _Writer(spec, model, places)
    writer.notes += angles.notes
    writer.read_equalities()
    writer.write()
    return msgspec.json.encode(
        {
            "urdf": urdf_text(writer.robot),
            "gravity": model.opt.gravity.tolist(),
            "armature": writer.armature,
            "springs": writer.springs,
            "lock": writer.lock,
            "loops": writer.loops,
            "notes": writer.notes,
        }
    )


class _Unfit(ValueError):
    """An MJCF that MuJoCo reads, but that is not one of an arm."""


def _take_exact_angles(spec: Any, angles: Angles) -> None:
    """Give bodies, their inertias and shapes the angles that are meant."""
    kinds = mujoco.mjtOrientation
    for element in (*spec.bodies, *spec.frames, *spec.geoms):
        for quaternion, other in (("quat", "alt"), ("iquat", "ialt")):
            if not hasattr(element, quaternion):
                continue
            alternative = getattr(element, other)
            if alternative.type == kinds.mjORIENTATION_QUAT:
                exact = angles.quaternion(getattr(element, quaternion))
                setattr(element, quaternion, exact)
            elif spec.compiler.degree:
                continue
            elif alternative.type == kinds.mjORIENTATION_EULER:
                alternative.euler = angles.exact(alternative.euler)
            elif alternative.type == kinds.mjORIENTATION_AXISANGLE:
                angle = angles.exact(alternative.axisangle[3:])
                alternative.axisangle = [*alternative.axisangle[:3], *angle]


def _check_numbers(model: Any) -> None:
    """Refuse NaN, infinities and numbers beyond any arm in what is taken of a model."""
    for name in _TAKEN:
        values = np.asarray(getattr(model, name), float)
        if values.size and not np.abs(values).max() < UNLIMITED:
            what = name.partition("_")[2].replace("_", " ")
            raise ValueError(
                f"a number is not finite or beyond any arm's size ({what})"
            )
    if not np.abs(model.opt.gravity).max() < UNLIMITED:
        raise ValueError("gravity is not finite or beyond reason; give it in m/s²")


_TAKEN = (
    "qpos0",
    "qpos_spring",
    "jnt_stiffness",
    "dof_armature",
    "eq_data",
    "actuator_gear",
    "actuator_armature",
)
"""What the URDF does not hold, whose own numbers are checked when it is read."""


def _leave_out_missing(
    spec: Any, missing: set[str], places: Mapping[str, str]
) -> None:
    """Remove shapes whose mesh is missing and makes no inertia."""
    for mesh in [mesh for mesh in spec.meshes if mesh.file in missing]:
        for geom in [g for g in spec.geoms if g.meshname == mesh.name]:
            body = geom.parent
            if not body.explicitinertial or spec.compiler.inertiafromgeom == 1:
                where = places[mesh.file]
                raise _Unfit(
                    f"body '{body.name}' has its mass from {where}, which is missing"
                )
            spec.delete(geom)
        spec.delete(mesh)


def _pose(position: Array, quaternion: Array) -> pin.SE3:
    return pin.SE3(pin.Quaternion(*quaternion).normalized(), np.array(position))


def _shifted(position: npt.ArrayLike) -> pin.SE3:
    return pin.SE3(np.eye(3), np.array(position))


@dataclass
class _Writer:
    """Writes links and joints of a compiled model."""

    spec: Any
    model: Any
    places: Mapping[str, str]
    armature: dict[str, float] = field(default_factory=dict)
    springs: dict[str, tuple[float, float]] = field(default_factory=dict)
    lock: dict[str, float] = field(default_factory=dict)
    loops: list[tuple[str, str]] = field(default_factory=list)
    mimics: dict[str, dict[str, str]] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        model = self.model
        self.robot = Element("robot", name=self.spec.modelname or "robot")
        self.bodies = [
            model.body(b).name or f"body_{b}" for b in range(model.nbody)
        ]
        self.joints = []
        for j, b in enumerate(model.jnt_bodyid):
            k = j - model.body_jntadr[b] + 1
            unnamed = f"{self.bodies[b]}_joint{k if k > 1 else ''}"
            self.joints.append(model.jnt(j).name or unnamed)

    def read_equalities(self) -> None:
        """Find which joints follow others or are held, and which bodies are tied together."""
        model = self.model
        kinds = mujoco.mjtEq
        others = 0
        for e in np.flatnonzero(model.eq_active0):
            kind = kinds(model.eq_type[e])
            one = int(model.eq_obj1id[e])
            other = int(model.eq_obj2id[e])
            if kind == kinds.mjEQ_JOINT:
                self._follow(one, other, model.eq_data[e, :5].tolist())
            elif kind in (kinds.mjEQ_CONNECT, kinds.mjEQ_WELD):
                if model.eq_objtype[e] == mujoco.mjtObj.mjOBJ_SITE:
                    one, other = model.site_bodyid[[one, other]]
                self.loops.append((self.bodies[one], self.bodies[other]))
            else:
                others += 1
        if others:
            self.notes.append(
                f"{others} equalities of tendons or flexible bodies are left out"
            )

    def _follow(self, j: int, master: int, polynomial: list[float]) -> None:
        """Hold a joint, or let it follow one; MuJoCo measures from reference positions."""
        offset, slope, *curve = polynomial
        name = self.joints[j]
        rest = float(self.model.jnt(j).qpos0[0]) + offset
        if master < 0:
            self.lock[name] = rest
            return
        leader = self.joints[master]
        if any(curve):
            self.notes.append(
                f"joint {name} follows {leader} on a curve, taken as a line"
            )
        self.mimics[name] = {
            "joint": leader,
            "multiplier": repr(slope),
            "offset": repr(rest - slope * float(self.model.jnt(master).qpos0[0])),
        }

    def write(self) -> None:
        """Write all bodies, the world first; parents come before what they carry."""
        model = self.model
        frames: dict[int, pin.SE3] = {}  # of each body in its link
        solid = (model.geom_contype | model.geom_conaffinity) != 0
        for b, name in enumerate(self.bodies):
            body = model.body(b)
            if model.body_gravcomp[b]:
                self.notes.append(
                    f"body {name}: gravcomp is left out, as a controller's doing"
                )
            frames[b] = self._joints(b, frames) if b else pin.SE3.Identity()
            link = SubElement(self.robot, "link", name=name)
            mass = float(body.mass[0])
            if b and mass > 0:
                place = _pose(body.ipos, body.iquat)
                R = place.rotation
                tensor = R @ np.diag(body.inertia) @ R.T
                inertia = frames[b].act(
                    pin.Inertia(mass, place.translation, tensor)
                )
                link.append(inertial_element(inertia.toDynamicParameters()))
            for g in np.flatnonzero(solid & (model.geom_bodyid == b)):
                link.extend(self._collisions(model.geom(g), frames[b]))

    def _joints(self, b: int, frames: Mapping[int, pin.SE3]) -> pin.SE3:
        """Write the joints of a body; the body's frame in the last link they carry."""
        body = self.model.body(b)
        name = self.bodies[b]
        parent = int(body.parentid[0])
        place = frames[parent] * _pose(body.pos, body.quat)
        above = self.bodies[parent]
        joints = np.flatnonzero(self.model.jnt_bodyid == b).tolist()
        if not joints:
            joint_element(
                self.robot, f"{name}_weld", "fixed", above, name, place.homogeneous
            )
            return pin.SE3.Identity()
        for j in joints:
            last = j == joints[-1]
            child = name if last else f"{name}_before_{self.joints[j + 1]}"
            place = self._joint(j, place, above, child)
            if not last:
                SubElement(self.robot, "link", name=child)
            above = child
        return place

    def _joint(self, j: int, place: pin.SE3, above: str, child: str) -> pin.SE3:
        """Write a joint that sits on a body's frame; the body's frame in what it carries."""
        name = self.joints[j]
        joint = self.model.jnt(j)
        kinds = mujoco.mjtJoint
        at = _shifted(joint.pos)
        back = -joint.qpos0[0] * joint.axis
        if joint.type[0] == kinds.mjJNT_SLIDE:
            word = "prismatic"
            turned = _shifted(back)
        elif joint.type[0] == kinds.mjJNT_HINGE:
            word = "revolute" if joint.limited[0] else "continuous"
            turned = pin.SE3(pin.exp3(back), np.zeros(3))
        else:
            pose = place.homogeneous
            joint_element(self.robot, name, "floating", above, child, pose)
            return pin.SE3.Identity()
        start = (place * at * turned).homogeneous
        element = joint_element(self.robot, name, word, above, child, start)
        SubElement(element, "axis", xyz=numbers_text(joint.axis))
        self._facts(element, j)
        return at.inverse()

    def _facts(self, element: Element, j: int) -> None:
        """Limits, friction, rotor inertia and spring of a joint."""
        joint = self.model.jnt(j)
        name = self.joints[j]
        effort, armature, damping = self._actuation(j)
        limit = {"effort": repr(effort), "velocity": "0"}
        if joint.limited[0]:
            low, high = joint.range.tolist()
            limit |= {"lower": repr(low), "upper": repr(high)}
        SubElement(element, "limit", limit)
        damping += float(joint.damping[0])
        friction = float(joint.frictionloss[0])
        if damping or friction:
            SubElement(
                element, "dynamics", damping=repr(damping), friction=repr(friction)
            )
        if armature := armature + float(joint.armature[0]):
            self.armature[name] = armature
        if stiffness := float(joint.stiffness[0]):
            self.springs[name] = (stiffness, float(joint.qpos_spring[0]))
        if joint.stiffnesspoly.any() or joint.dampingpoly.any():
            self.notes.append(
                f"joint {name}: higher powers of stiffness and damping are left out"
            )
        if name in self.mimics:
            SubElement(element, "mimic", self.mimics[name])

    def _actuation(self, j: int) -> tuple[float, float, float]:
        """Torque limit for both directions (0 for none), rotor inertia and damping of drives."""
        model = self.model
        total = np.zeros(2)
        armature = 0.0
        damping = 0.0
        direct = [mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT]
        here = (model.actuator_trnid[:, 0] == j) & np.isin(
            model.actuator_trntype, direct
        )
        for a in np.flatnonzero(here):
            drive = model.actuator(a)
            gear = float(drive.gear[0])
            gain = float(drive.gainprm[0])
            force = _range(drive.forcerange, drive.forcelimited[0])
            plain = drive.gaintype[0] == mujoco.mjtGain.mjGAIN_FIXED
            plain &= drive.biastype[0] == mujoco.mjtBias.mjBIAS_NONE
            if plain and gain:
                control = _range(drive.ctrlrange, drive.ctrllimited[0])
                force = np.clip(np.sort(gain * control), *force)
            total = total + (
                np.sort(gear * force) if gear and (gain or not plain) else 0.0
            )
            armature += gear**2 * float(model.actuator_armature[a])
            damping += gear**2 * float(model.actuator_damping[a])
        low, high = total if here.any() else (-np.inf, np.inf)
        own = _range(model.jnt_actfrcrange[j], model.jnt_actfrclimited[j])
        limit = float(min(-max(low, own[0]), min(high, own[1])))
        return limit if np.isfinite(limit) and limit > 0 else 0.0, armature, damping

    def _collisions(self, geom: Any, frame: pin.SE3) -> Iterator[Element]:
        """``<collision>`` elements of a geom; planes and fields have none.

        A capsule becomes a cylinder with two spheres, an ellipsoid the box around it. A mesh that
        is turned (refquat) and then stretched unequally has no URDF word and is left out.
        """
        place = frame * _pose(geom.pos, geom.quat)
        kind = mujoco.mjtGeom(geom.type[0]).name
        x, y, z = geom.size.tolist()
        if kind == "mjGEOM_MESH":
            m = int(geom.dataid[0])
            mesh = self.spec.mesh(self.model.mesh(m).name)
            scale = np.array(mesh.scale)
            turn = _pose(mesh.refpos, mesh.refquat)
            if not mesh.file or (
                np.ptp(scale) and not np.allclose(turn.rotation, np.eye(3))
            ):
                return
            back = turn.rotation.T
            moved = pin.SE3(back, -scale * (back @ turn.translation))
            stored = _pose(self.model.mesh_pos[m], self.model.mesh_quat[m])
            place = place * stored.inverse() * moved
            file = self.places[mesh.file]
            yield collision(place, "mesh", filename=file, scale=numbers_text(scale))
        elif kind == "mjGEOM_SPHERE":
            yield collision(place, "sphere", radius=repr(x))
        elif kind in ("mjGEOM_BOX", "mjGEOM_ELLIPSOID"):
            yield collision(place, "box", size=numbers_text((2 * x, 2 * y, 2 * z)))
        elif kind in ("mjGEOM_CAPSULE", "mjGEOM_CYLINDER"):
            yield collision(place, "cylinder", radius=repr(x), length=repr(2 * y))
            for end in (y, -y) if kind == "mjGEOM_CAPSULE" else ():
                tip = place * _shifted([0.0, 0.0, end])
                yield collision(tip, "sphere", radius=repr(x))


def _range(limits: Array, limited: bool) -> Array:
    if limited and limits[0] < limits[1]:
        return limits
    return np.array([-np.inf, np.inf])
