"""Groups: columns whose names differ by the joint only."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from excitant.exceptions import BadRecording
from excitant.identify.importers.names import Meaning
from excitant.robots.robot import Robot

SAID = {"t": "time", "q": "positions", "dq": "speeds", "tau": "torques", "i": "currents"}


@dataclass(frozen=True)
class Joints:
    """The joints that a recording must hold.

    Attributes:
        count: How many.
        names: Their names, where the arm is known.
        revolute: Whether each turns, where the arm is known.
    """

    count: int
    names: tuple[str, ...] = ()
    revolute: tuple[bool, ...] = ()

    @classmethod
    def of(cls, robot: Robot | int) -> Joints:
        """Joints of a robot, or as many without names."""
        if isinstance(robot, int):
            return cls(robot)
        return cls(robot.nv, robot.joints, tuple(bool(turns) for turns in robot.revolute))

    @property
    def labels(self) -> tuple[str, ...]:
        """Names, or numbers from 1 where there are none."""
        return self.names or tuple(str(k + 1) for k in range(self.count))

    def turns(self, k: int) -> bool | None:
        """Whether joint k turns; None when not known."""
        return self.revolute[k] if self.revolute else None


@dataclass(frozen=True)
class Group:
    """Columns of one quantity, by joint.

    Attributes:
        role: Quantity.
        members: Meaning per joint's number or name.
        words: What else the names hold.
        canonical: Whether the columns are named ``q1, q2, ...`` exactly.
        named: Whether joints are matched by name.
        twice: A joint that has two columns.
    """

    role: str
    members: Mapping[str | int | None, Meaning]
    words: tuple[str, ...] = ()
    canonical: bool = False
    named: bool = False
    twice: Meaning | None = None

    @classmethod
    def numbered(cls, prefix: str, names: Sequence[str], role: str) -> Group:
        """The columns ``prefix1, prefix2, ...``."""
        form = re.compile(rf"{re.escape(prefix)}([1-9]\d*)$", re.ASCII)
        found = [(int(m[1]), name) for name in names if (m := form.match(name))]
        return cls(role, {k: Meaning(name, role, k) for k, name in found}, canonical=True)

    def keys(self, joints: Joints) -> list[str | int | None]:
        """Under which key each joint should be."""
        if self.named:
            return list(joints.names)
        if joints.count == 1 and None in self.members:
            return [None]
        first = 0 if 0 in self.members else 1
        return [first + k for k in range(joints.count)]

    def full(self, joints: Joints) -> bool:
        """Whether every joint has its column and there are no others."""
        keys = self.keys(joints)
        return set(keys) <= set(self.members) and (self.named or len(self.members) == len(keys))

    def columns(self, joints: Joints) -> tuple[str, ...]:
        """Columns in the robot's order."""
        return tuple(self.members[key].column for key in self.keys(joints))

    def units(self, joints: Joints) -> tuple[str | None, ...]:
        """Units in the columns' names, in the robot's order."""
        return tuple(self.members[key].unit for key in self.keys(joints))

    def check(self, joints: Joints, file: str, prefix: str | None = None) -> None:
        """Refuse another number of joints, holes and surplus."""
        if self.twice is not None:
            raise BadRecording(
                file, "names a joint that another column names too; rename or remove one",
                column=self.twice.column,
            )  # fmt: skip
        numbers = sorted(k for k in self.members if isinstance(k, int))
        keys = self.keys(joints)
        run = list(range(numbers[0], numbers[0] + len(numbers))) if numbers else []
        if self.role == "q" and numbers and run == numbers and numbers[0] in (0, 1):
            self._check_count(numbers, joints, file)
        for key in keys:
            if key not in self.members:
                raise BadRecording(
                    file, "is missing; rename or add it", column=self._name(key, prefix)
                )
        if numbers and len(numbers) > joints.count:
            raise BadRecording(
                file,
                f"belongs to no joint: the robot has {joints.count}; remove it or give the "
                f"right robot",
                column=self.members[numbers[-1]].column,
            )

    def _check_count(self, numbers: Sequence[int], joints: Joints, file: str) -> None:
        if len(numbers) == joints.count:
            return
        first, last = (self.members[k].column for k in (numbers[0], numbers[-1]))
        span = first + (f"..{last}" if len(numbers) > 1 else "")
        raise BadRecording(
            file,
            f"has {len(numbers)} joint{'s' if len(numbers) > 1 else ''} ({span}), the robot has "
            f"{joints.count}; give the recording of this robot, or lock the joints that it "
            f"leaves out",
        )

    def _name(self, key: str | int | None, prefix: str | None) -> str:
        """What the column of a joint would be called."""
        if prefix is not None:
            return f"{prefix}{key}"
        like = next(iter(self.members.values()))
        if self.named or like.joint is None:
            return f"{SAID[self.role]} of {key}"
        head, _, tail = like.column.rpartition(str(like.joint))
        return f"{head}{key}{tail}"
