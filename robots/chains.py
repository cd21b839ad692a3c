"""Which joints of a robot move: a chain of a larger tree, the rest held in place."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from excitant.exceptions import BadInput, BadRobot, UnknownName

MOVING = ("revolute", "continuous", "prismatic")
_SEVERAL = ("floating", "planar")
_SHOWN = 4  # names of joints in a note


@dataclass(frozen=True)
class Choice:
    """What is kept of a robot; everything when nothing is said.

    Attributes:
        joints: Joints to keep; all others are held.
        base: Link that the chain starts from; the root of the tree when None.
        tip: Link that the chain ends at; links beyond it are carried along.
        lock: Joints to hold and their positions [rad or m].
        loops: Pairs of links that a constraint of the description ties together.
    """

    joints: Sequence[str] | None = None
    base: str | None = None
    tip: str | None = None
    lock: Mapping[str, float] | None = None
    loops: tuple[tuple[str, str], ...] = ()

    def __bool__(self) -> bool:
        """Whether joints are chosen, other than by holding single ones."""
        return self.joints is not None or self.base is not None or self.tip is not None


@dataclass(frozen=True)
class TreeJoint:
    """A joint of the tree.

    Attributes:
        name: Its name.
        kind: Its type in the URDF.
        parent: Link it hangs from.
        child: Link it carries.
        mimic: Joint it follows as multiplier · q + offset, if it does.
    """

    name: str
    kind: str
    parent: str
    child: str
    mimic: tuple[str, float, float] | None


@dataclass(frozen=True)
class Tree:
    """The joints of a URDF, by name.

    Attributes:
        source: File of the URDF, for messages.
        joints: All joints, fixed ones included.
        links: Names of all links.
    """

    source: str
    joints: Mapping[str, TreeJoint]
    links: tuple[str, ...]

    @cached_property
    def carrier(self) -> dict[str, TreeJoint]:
        """Joint that carries each link, none for the root."""
        return {joint.child: joint for joint in self.joints.values()}

    def ancestors(self, link: str) -> list[TreeJoint]:
        """Joints from a link to the root, the nearest first."""
        found: list[TreeJoint] = []
        while link in self.carrier and len(found) < len(self.joints):
            found.append(self.carrier[link])
            link = found[-1].parent
        return found

    def path(self, base: str | None, tip: str) -> list[TreeJoint]:
        """Joints from a base, or the root, to a tip."""
        upward = self.ancestors(self._link(tip))
        if base is None:
            return upward[::-1]
        names = [tip, *(joint.parent for joint in upward)]
        if self._link(base) not in names:
            raise BadRobot(
                self.source,
                f"link '{tip}' does not hang from link '{base}'; on its way to the root are "
                f"{', '.join(names[1:]) or 'none'}",
            )
        return upward[: names.index(base)][::-1]

    def below(self, base: str) -> list[TreeJoint]:
        """Joints that a link carries, in the order of the file."""
        self._link(base)
        return [
            joint
            for joint in self.joints.values()
            if base in {above.parent for above in self.ancestors(joint.child)}
        ]

    def _link(self, name: str) -> str:
        if name not in self.links:
            raise UnknownName("link", name, self.links)
        return name


def tree(root: ET.Element, source: str) -> Tree:
    """The tree of a URDF whose joints all name a known parent and child."""
    joints = {}
    for element in root.findall("joint"):
        ends = {end: element.find(end) for end in ("parent", "child")}
        parent, child = (str(e.get("link")) if e is not None else "" for e in ends.values())
        name = str(element.get("name"))
        mimic = _mimic(element, name, source)
        joints[name] = TreeJoint(name, str(element.get("type")), parent, child, mimic)
    return Tree(source, joints, tuple(str(link.get("name")) for link in root.findall("link")))


def _mimic(element: ET.Element, name: str, source: str) -> tuple[str, float, float] | None:
    mimic = element.find("mimic")
    if mimic is None:
        return None
    try:
        return (
            str(mimic.get("joint")),
            float(mimic.get("multiplier", "1")),
            float(mimic.get("offset", "0")),
        )
    except ValueError:
        raise BadRobot(source, f"joint '{name}': its mimic numbers are no numbers") from None


@dataclass(frozen=True)
class Chain:
    """What moves and what is held.

    Attributes:
        held: Joints that are held and their positions, None for those of several degrees of
            freedom, which rest where the description puts them.
        notes: What was decided that nobody asked for.
    """

    held: Mapping[str, float | None]
    notes: tuple[str, ...] = ()


def chain(robot: Tree, choice: Choice) -> Chain:
    """Joints to hold so that only the chosen ones move.

    Raises:
        BadInput: Contradictory choice.
        UnknownName: A joint or link that the robot does not have.
        BadRobot: A chosen joint follows another one, closes a loop, or has several degrees of
            freedom.
    """
    lock = dict(choice.lock or {})
    movable = [j for j in robot.joints.values() if j.kind in (*MOVING, *_SEVERAL)]
    names = [joint.name for joint in movable]
    for name in (*lock, *(choice.joints or ())):
        if name not in names:
            raise UnknownName("joint", name, names)
    kept = _kept(robot, replace(choice, lock=lock), movable)
    _refuse_several(robot, kept, choice)
    _refuse_coupled(robot, kept, choice, lock)
    kept_names = {joint.name for joint in kept}
    held: dict[str, float | None] = {
        joint.name: None if joint.kind in _SEVERAL else _position(robot, joint, lock)
        for joint in movable
        if joint.name not in kept_names
    }
    return Chain(held, tuple(_notes(robot, choice, kept_names, held)))


def _kept(robot: Tree, choice: Choice, movable: Sequence[TreeJoint]) -> list[TreeJoint]:
    lock = choice.lock or {}
    if choice.joints is not None:
        if choice.tip is not None or choice.base is not None:
            raise BadInput(
                "joints are named, and a chain by base or tip too; choose in one way only"
            )
        both = [name for name in choice.joints if name in lock]
        if both:
            raise BadInput(f"joint '{both[0]}' is both kept and locked; do one of them")
        return [joint for joint in movable if joint.name in choice.joints]
    path: Iterable[TreeJoint] = movable
    if choice.tip is not None:
        path = robot.path(choice.base, choice.tip)
    elif choice.base is not None:
        path = robot.below(choice.base)
    kept = [joint for joint in path if joint in movable and joint.name not in lock]
    if not kept and choice:
        where = f"from {choice.base or 'the root'} to {choice.tip or 'the ends'}"
        raise BadRobot(robot.source, f"no joint moves {where}; name links further apart")
    return kept


def _refuse_several(robot: Tree, kept: Sequence[TreeJoint], choice: Choice) -> None:
    for joint in kept:
        if joint.kind not in MOVING:
            way = f"--base {joint.child}" + ("" if choice.tip else " or --tip LINK")
            raise BadRobot(
                robot.source,
                f"joint '{joint.name}' is {joint.kind}: it has several degrees of freedom, and "
                f"only revolute, continuous and prismatic joints are supported; choose a chain "
                f"without it ({way}), or hold it (--lock {joint.name})",
            )


def _refuse_coupled(
    robot: Tree, kept: Sequence[TreeJoint], choice: Choice, lock: Mapping[str, float]
) -> None:
    """Refuse joints that cannot move on their own."""
    names = {joint.name for joint in kept}
    pairs = [(joint.name, joint.mimic[0]) for joint in kept if joint.mimic is not None]
    if pairs:
        every = ",".join(dict.fromkeys(name for pair in pairs for name in pair))
        raise BadRobot(
            robot.source,
            f"joint '{pairs[0][0]}' mimics '{pairs[0][1]}', and coupled joints cannot be kept; "
            f"hold them (--lock {every}), or choose a chain without them (--tip LINK)",
        )
    for ends in choice.loops:
        ways = [{joint.name for joint in robot.ancestors(end)} for end in ends]
        inside = sorted((ways[0] ^ ways[1]) & names)
        if inside:
            raise BadRobot(
                robot.source,
                f"links '{ends[0]}' and '{ends[1]}' are tied together, which closes a loop over "
                f"joint '{inside[0]}'; hold its joints (--lock {','.join(inside)}), or choose a "
                "chain without them (--tip LINK)",
            )


def _position(robot: Tree, joint: TreeJoint, lock: Mapping[str, float]) -> float:
    """Where a joint is held: as told, as the joint it follows, or at zero."""
    factor, offset, seen = 1.0, 0.0, {joint.name}
    while joint.name not in lock and joint.mimic is not None:
        master, multiplier, shift = joint.mimic
        factor, offset = factor * multiplier, offset + factor * shift
        if master in seen:
            raise BadRobot(robot.source, f"joint '{master}' mimics itself; remove one <mimic>")
        seen.add(master)
        if master not in robot.joints:
            return offset
        joint = robot.joints[master]
    return factor * lock.get(joint.name, 0.0) + offset


def _notes(
    robot: Tree, choice: Choice, kept: set[str], held: Mapping[str, float | None]
) -> Iterable[str]:
    lock = choice.lock or {}
    for name, value in held.items():
        joint = robot.joints[name]
        if name in lock:
            continue
        if value is None:
            yield f"{joint.kind} joint {name} is held where the file puts it"
        elif joint.mimic is not None:
            moves = ", though that one moves" if joint.mimic[0] in kept else ""
            yield f"joint {name} follows {joint.mimic[0]} and is held at {value:g}{moves}"
    at_zero = [
        name for name, value in held.items() if value is not None and name not in lock
        and robot.joints[name].mimic is None
    ]  # fmt: skip
    if at_zero:
        more = len(at_zero) - _SHOWN
        shown = ", ".join(at_zero[:_SHOWN]) + (f" and {more} more" if more > 0 else "")
        yield f"held at 0, as they are not chosen: {shown}"
