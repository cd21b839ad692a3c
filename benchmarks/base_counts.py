"""Base parameters of every serial chain of ``example-robot-data``, counted in three ways.

    python benchmarks/base_counts.py [--data FOLDER] [--only NAME ...] [-o FILE]

A chain runs from the fixed root of a model to one of its last joints; all other joints are held
at zero. Counted by the rank of the regressor on random states, by the recursion of null spaces
from base to tip, and, where they apply, by the closed-form grouping rules. ``angle`` is the
largest angle between the null spaces of the first two, ``close`` the number of parameters
decided by a hair.
"""

from __future__ import annotations

import argparse
import json
import os
import site
import sys
import time
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from excitant.analysis.grouping_rules import grouping
from excitant.analysis.nullspace import parameter_nullspace
from excitant.analysis.structure import structure
from excitant.exceptions import BadInput, ExcitantError
from excitant.robots import Robot, builtin_robots, load_robot
from excitant.robots.scale import arm_length
from excitant.robots.urdf import robot_from_urdf

MOVING = ("revolute", "continuous", "prismatic")
SAME = 1e-6  # rad between null spaces


@dataclass(frozen=True)
class Count:
    """One chain, counted in three ways (``rules`` None where no rule is published)."""

    model: str
    tip: str
    kinds: str
    regressor: int
    recursion: int
    rules: int | None
    angle: float
    close: int
    seconds: float

    @property
    def agree(self) -> bool:
        """Whether all counts and the null spaces are the same."""
        return self.angle < SAME and self.rules in (None, self.regressor)


def data_folder(given: str | None) -> Path | None:
    """Folder of the models: given, from EXAMPLE_ROBOT_DATA, or installed beside this Python."""
    named = given or os.environ.get("EXAMPLE_ROBOT_DATA")
    installed = (
        Path(packages, "cmeel.prefix", "share", "example-robot-data", "robots")
        for packages in site.getsitepackages()
    )
    return next((f for f in ([Path(named)] if named else installed) if f.is_dir()), None)


def chains(text: str) -> Iterator[tuple[str, ...]]:
    """Names of the moving joints of every way from the root of a URDF to a last joint."""
    children: dict[str, list[ET.Element]] = {}
    inner = set()
    for joint in ET.fromstring(text).findall("joint"):
        parent, child = joint.find("parent"), joint.find("child")
        if parent is None or child is None:
            continue
        children.setdefault(str(parent.get("link")), []).append(joint)
        inner.add(str(child.get("link")))
    pending: list[tuple[str, tuple[str, ...]]] = [
        (link, ()) for link in children if link not in inner
    ]
    found: set[tuple[str, ...]] = set()
    while pending:
        link, path = pending.pop()
        found.add(path)
        for joint in children.get(link, []):
            child = joint.find("child")
            own = (str(joint.get("name")),) if joint.get("type") in MOVING else ()
            pending.append((str(child.get("link")) if child is not None else "", path + own))
    for path in sorted(found):
        if path and not any(other[: len(path)] == path for other in found if other != path):
            yield path


def distinct(text: str) -> str:
    """The URDF with other names for joints that share a link's: Pinocchio cannot hold those."""
    root = ET.fromstring(text)
    links = {link.get("name") for link in root.findall("link")}
    for joint in root.findall("joint"):
        if joint.get("name") in links:
            joint.set("name", f"{joint.get('name')}_joint")
            for mimic in joint.findall("mimic"):
                joint.remove(mimic)
    return ET.tostring(root, encoding="unicode")


def count(robot: Robot, model: str) -> Count:
    start = time.process_time()
    numerical, recursive = structure(robot), parameter_nullspace(robot)
    try:
        rules = len(grouping(robot))
    except BadInput:
        rules = None
    return Count(
        model,
        robot.links[-1],
        "".join("R" if turns else "P" for turns in robot.revolute),
        len(numerical.base),
        len(recursive),
        rules,
        recursive.angle(numerical.base.null_space, arm_length(robot)),
        len(numerical.close),
        time.process_time() - start,
    )


def signature(robot: Robot) -> bytes:
    """What the structure depends on, to count no chain twice."""
    parts = [placement.homogeneous for placement in list(robot.model.jointPlacements)[1:]]
    axes = [np.array(joint.createData().S) for joint in list(robot.model.joints)[1:]]
    return np.round(np.concatenate([np.ravel(x) for x in (*parts, *axes)]), 9).tobytes()


def all_counts(folder: Path, only: list[str]) -> Iterator[Count | str]:
    """Every chain of the models in a folder that is not yet counted; a sentence where refused."""
    seen = set()
    for file in sorted(folder.rglob("*.urdf")):
        if only and not any(name in file.stem for name in only):
            continue
        try:
            text = distinct(file.read_text(encoding="utf-8", errors="replace"))
            paths = list(chains(text))
        except ET.ParseError as error:
            yield f"{file.stem}: {error}"
            continue
        for path in paths:
            try:
                robot = robot_from_urdf(text, source=file.name, joints=path)
            except ExcitantError as error:
                yield f"{file.stem} to {path[-1]}: {error}"
                continue
            if (mark := signature(robot)) not in seen:
                seen.add(mark)
                yield count(robot, file.stem)


HEADER = f"{'model':28} {'tip':30} {'joints':14} regr recu rule   angle close     s"


def row(c: Count) -> str:
    rules = "  –" if c.rules is None else f"{c.rules:3d}"
    verdict = "" if c.agree else "  DIFFERENT"
    return (
        f"{c.model[:28]:28} {c.tip[:30]:30} {c.kinds[:14]:14} {c.regressor:4d} {c.recursion:4d}"
        f"  {rules} {c.angle:7.0e} {c.close:5d} {c.seconds:5.2f}{verdict}"
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--data", help="folder of URDF files")
    parser.add_argument("--only", nargs="*", default=[], help="parts of model names")
    parser.add_argument("-o", "--output", help="JSON file to write")
    given = parser.parse_args()
    print(HEADER)
    done = [count(load_robot(name), name) for name in builtin_robots()]
    print("\n".join(map(row, done)))
    folder, refused = data_folder(given.data), 0
    if folder is None:
        print("no example-robot-data: install it, or name its folder with --data")
    for found in all_counts(folder, given.only) if folder else ():
        if isinstance(found, str):
            refused += 1
            print(f"refused: {found}")
        else:
            done.append(found)
            print(row(found), flush=True)
    different = [c for c in done if not c.agree]
    ruled = [c for c in done if c.rules is not None]
    print(
        f"{len(done)} chains, {len(done) - len(different)} agree ({len(ruled)} of them also under "
        f"the rules), largest angle {max(c.angle for c in done):.1e} rad, {refused} refused"
    )
    if given.output:
        Path(given.output).write_text(json.dumps([asdict(c) for c in done], indent=1) + "\n")
    return 1 if different else 0


if __name__ == "__main__":
    sys.exit(main())
