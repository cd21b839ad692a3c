"""Selection of the moving joints: a chain of a larger tree, the rest held in place."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from xml.etree.ElementTree import Element

from excitant.exceptions import BadInput, BadRobot, UnknownName
from excitant.names import listed

_SINGLE = ("revolute", "continuous", "prismatic")
_SEVERAL = ("floating", "planar")
_SHOWN = 4  # names of joints in a note


@dataclass(frozen=True)
class RobotSpec:
    """A robot and the joints kept of it; all of them by default."""

    path: str | Path  # built-in name, URDF, xacro, MJCF or robot.yaml
    joints: tuple[str, ...] | None = None  # to keep; all others are held
    # link that the chain starts from; the root of the tree when None
    base: str | None = None
    # link that the chain ends at; links beyond it are carried along
    tip: str | None = None
    # joints held, and where [rad or m]
    lock: Mapping[str, float] = field(default_factory=dict)
    xacro_args: Mapping[str, str] = field(default_factory=dict)
    # folders of packages, in which files may lie
    packages: tuple[str | Path, ...] = ()

    def __fspath__(self) -> str:
        """The path, so that a spec stands where a path does."""
        return str(self.path)

    def __str__(self) -> str:
        return str(self.path)

    @property
    def is_part(self) -> bool:
        """Whether a part of the robot is chosen, other than by holding single joints."""
        return (self.joints, self.base, self.tip) != (None, None, None)


@dataclass(frozen=True)
class TreeJoint:
    """A joint of the tree; ``mimic`` is the joint it follows as multiplier · q + offset."""

    name: str
    kind: str
    parent: str
    child: str
    mimic: tuple[str, float, float] | None

    @property
    def is_single(self) -> bool:
        """Whether it has one degree of freedom of its own."""
        return self.kind in _SINGLE and self.mimic is None


@dataclass(frozen=True)
class Tree:
    """The joints of a URDF, fixed ones included, by name, and the names of its links."""

    source: str
    joints: Mapping[str, TreeJoint]
    links: tuple[str, ...]

    @cached_property
    def parents(self) -> dict[str, TreeJoint]:
        """Joint that carries each link, none for the root."""
        return {joint.child: joint for joint in self.joints.values()}

    def ancestors(self, link: str) -> list[TreeJoint]:
        """Joints from a link to the root, the nearest first."""
        joints: list[TreeJoint] = []
        while link in self.parents and len(joints) < len(self.joints):
            joints.append(self.parents[link])
            link = joints[-1].parent
        return joints

    def carrier(self, link: str, moving: Sequence[str]) -> str:
        """The nearest of the moving links that carries a link, itself included; else empty."""
        way = [link, *(joint.parent for joint in self.ancestors(link))]
        return next((name for name in way if name in moving), "")

    def chain(self, base: str | None, tip: str | None) -> list[TreeJoint]:
        """Joints from a base, or the root, to a tip, or to all ends."""
        ends = [name for name in (base, tip) if name is not None]
        UnknownName.refuse("link", ends, self.links)
        if tip is None:
            return [
                joint
                for joint in self.joints.values()
                if base is None
                or base in {x.parent for x in self.ancestors(joint.child)}
            ]
        upward = self.ancestors(tip)
        names = [tip, *(joint.parent for joint in upward)]
        if base is not None and base not in names:
            raise BadRobot(
                self.source,
                f"link '{tip}' does not hang from link '{base}'; on its way to the root are "
                f"{', '.join(names[1:]) or 'none'}",
            )
        return upward[: names.index(base) if base else None][::-1]


def tree(root: Element, source: str) -> Tree:
    """The tree of a URDF that was checked: its joints name known links, its numbers are some."""
    joints = {}
    for element in root.findall("joint"):
        name = str(element.get("name"))
        mimic = element.find("mimic")
        parent, child = (
            str(next(element.iter(tag)).get("link")) for tag in ("parent", "child")
        )
        follows = None
        if mimic is not None:
            multiplier = float(mimic.get("multiplier", "1"))
            offset = float(mimic.get("offset", "0"))
            follows = (str(mimic.get("joint")), multiplier, offset)
        joints[name] = TreeJoint(
            name, str(element.get("type")), parent, child, follows
        )
    return Tree(
        source,
        joints,
        tuple(str(link.get("name")) for link in root.findall("link")),
    )


def held_joints(
    robot: Tree, spec: RobotSpec, loops: Sequence[tuple[str, str]]
) -> tuple[dict[str, float | None], tuple[str, ...]]:
    """Joints to hold so that only the chosen ones move, and the defaults applied, as sentences.

    Joints of several degrees of freedom have no position: they rest where the description puts
    them. ``loops`` are pairs of links that a constraint of the description ties together.
    """
    movable = [j for j in robot.joints.values() if j.kind in (*_SINGLE, *_SEVERAL)]
    names = [joint.name for joint in movable]
    UnknownName.refuse("joint", (*spec.lock, *(spec.joints or ())), names)
    kept = _kept(robot, spec, movable)
    _refuse_dependent(robot, kept, spec, loops)
    moving = {joint.name for joint in kept}
    held = {
        joint.name: _position(robot, joint, spec.lock)
        for joint in movable
        if joint.name not in moving
    }
    return held, tuple(_notes(robot, spec, moving, held))


def _kept(
    robot: Tree, spec: RobotSpec, movable: Sequence[TreeJoint]
) -> list[TreeJoint]:
    """Joints that move: those that are named, or those of the chain that do not mimic."""
    if spec.joints is not None:
        if spec.tip is not None or spec.base is not None:
            raise BadInput(
                "joints are named, and a chain by base or tip too; choose in one way only"
            )
        both = [name for name in spec.joints if name in spec.lock]
        if both:
            raise BadInput(
                f"joint '{both[0]}' is both kept and locked; do one of them"
            )
        return [joint for joint in movable if joint.name in spec.joints]
    free = [j for j in movable if j.mimic is None and j.name not in spec.lock]
    kept = [joint for joint in robot.chain(spec.base, spec.tip) if joint in free]
    if not kept and spec.is_part:
        where = f"from {spec.base or 'the root'} to {spec.tip or 'the ends'}"
        raise BadRobot(
            robot.source, f"no joint moves {where}; name links further apart"
        )
    return kept


def _refuse_dependent(
    robot: Tree,
    kept: Sequence[TreeJoint],
    spec: RobotSpec,
    loops: Sequence[tuple[str, str]],
) -> None:
    """Refuse joints of several degrees of freedom, and those that cannot move on their own."""
    for joint in kept:
        if joint.kind in _SEVERAL:
            way = f"--base {joint.child}" + ("" if spec.tip else " or --tip LINK")
            raise BadRobot(
                robot.source,
                f"joint '{joint.name}' is {joint.kind}: it has several degrees of freedom, and "
                f"only revolute, continuous and prismatic joints are supported; choose a chain "
                f"without it ({way}), or hold it (--lock {joint.name})",
            )
        if joint.mimic is not None:
            raise BadRobot(
                robot.source,
                f"joint '{joint.name}' mimics '{joint.mimic[0]}', and a mimic joint can only be "
                "held; leave it out of the joints to keep",
            )
    for ends in loops:
        one, other = (
            {joint.name for joint in robot.ancestors(end)} for end in ends
        )
        inside = sorted((one ^ other) & {joint.name for joint in kept})
        if inside:
            raise BadRobot(
                robot.source,
                f"links '{ends[0]}' and '{ends[1]}' are tied together, which closes a loop over "
                f"joint '{inside[0]}'; hold its joints (--lock {','.join(inside)}), or choose a "
                "chain without them (--tip LINK)",
            )


def _position(
    robot: Tree, joint: TreeJoint, lock: Mapping[str, float]
) -> float | None:
    """Position at which a joint is held: as given, as of the joint it follows, zero, or none."""
    if joint.kind in _SEVERAL:
        return None
    factor = 1.0
    offset = 0.0
    seen = {joint.name}
    while joint.name not in lock and joint.mimic is not None:
        master, multiplier, shift = joint.mimic
        factor, offset = factor * multiplier, offset + factor * shift
        if master in seen:
            raise BadRobot(
                robot.source, f"joint '{master}' mimics itself; remove one <mimic>"
            )
        seen.add(master)
        if master not in robot.joints:
            return offset
        joint = robot.joints[master]
    return factor * lock.get(joint.name, 0.0) + offset


def _notes(
    robot: Tree, spec: RobotSpec, moving: set[str], held: Mapping[str, float | None]
) -> Iterator[str]:
    """Sentences on joints that are held by default: why, and where."""
    groups: dict[str, list[str]] = {
        "mimic joints held as the joints they mimic": [],
        "mimic joints held, whose motion with the joints they mimic is not modelled": [],
        "held at 0, as they are not chosen": [],
    }
    with_master, uncoupled, at_zero = groups.values()
    for name, value in held.items():
        joint = robot.joints[name]
        if name in spec.lock:
            continue
        if value is None:
            yield f"{joint.kind} joint {name} is held where the file puts it"
        elif joint.mimic is None:
            at_zero.append(name)
        else:
            group = uncoupled if joint.mimic[0] in moving else with_master
            group.append(f"{name} at {value:g}")
    for what, names in groups.items():
        if names:
            yield f"{what}: {listed(names, _SHOWN)}"
