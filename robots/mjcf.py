"""Robots from MJCF files: what they consist of is read here, and compiled in a child process.

MuJoCo gets texts and bytes under names that are given here, never a path.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from importlib.util import find_spec
from os.path import exists
from pathlib import Path, PurePosixPath
from xml.etree.ElementTree import Element, tostring

import msgspec
import numpy as np

from excitant.exceptions import BadRobot
from excitant.files import read_bytes, real_path
from excitant.limited import Exceeded, in_child
from excitant.robots.files import (
    DEEPEST,
    LARGEST,
    parse_xml,
    read_description,
    within,
)
from excitant.robots.urdf import GRAVITY

SECONDS = (
    10  # of processor time that compiling may take; a humanoid with meshes takes 2
)
MEMORY = (
    2 << 30
)  # bytes of address space that it may take; libraries alone take 0.3 GB


@dataclass(frozen=True)
class Description:
    """A robot as URDF text, and what the text cannot hold."""

    urdf: str
    gravity: tuple[float, float, float] = GRAVITY  # in the root's frame [m/s²]
    # by joint [kg·m² or kg]
    armature: Mapping[str, float] = field(default_factory=dict)
    # stiffness, rest
    springs: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    # joints held, and where [rad or m]
    lock: Mapping[str, float] = field(default_factory=dict)
    # pairs of links that a constraint ties together
    loops: tuple[tuple[str, str], ...] = ()
    notes: tuple[str, ...] = ()  # what was left out


def description_from_mjcf(
    path: str | Path, packages: Iterable[str | Path]
) -> Description:
    """Description of the robot in an MJCF file; `BadRobot` where MuJoCo is missing or refuses.

    Files that it names must lie below its folder or one of the packages.
    """
    if find_spec("mujoco") is None:
        why = "MJCF files are read by MuJoCo; install it (pip install 'excitant[mjcf]')"
        raise BadRobot(path, why)
    parts = _Parts(Path(path), tuple(packages))
    task = (parts.text(Path(path)), parts.models, parts.assets, parts.places)
    try:
        answer = in_child(_WORK, *task, seconds=SECONDS, memory=MEMORY, files=0)
    except Exceeded as error:
        raise BadRobot(path, f"compiling it {error}; no arm needs that") from None
    except ValueError as error:
        raise BadRobot(path, str(error)) from None
    return msgspec.json.decode(answer, type=Description)


_WORK = "excitant.robots.mjcf_model.described"  # which imports MuJoCo
_FILES = 200  # that one MJCF may consist of
_ASSETS = 256_000_000  # bytes of all its meshes and height fields
_BODIES = 1000  # as many as links of a URDF
_COPIES = 300  # that <replicate> may make, over all levels
# products of these attributes
_SIZES = {
    "count": 10_000,
    "nrow": 2_000,
    "ncol": 2_000,
    "params": 10_000,
}
_DRAWN = ("material", "texture", "skin")  # elements, and attributes that name them
_FOLDERS = ("meshdir", "texturedir", "assetdir", "strippath")


class _Parts:
    """The files that one MJCF consists of, under names of our own.

    Attributes:
        models: MJCF that are attached, by name.
        assets: Content of other files, by name.
        places: Where files are, those that are missing too, by name.
    """

    def __init__(self, path: Path, packages: tuple[str | Path, ...]) -> None:
        self.path = path
        self.packages = packages
        self.models: dict[str, bytes] = {}
        self.assets: dict[str, bytes] = {}
        self.places: dict[str, str] = {}
        self._names: dict[Path, str] = {}
        self._read = 0  # files of text
        self._size = 0  # bytes of text
        self._large = 0  # bytes of assets

    def text(self, path: Path) -> str:
        """Text of an MJCF that includes nothing, draws nothing, and names files as we do."""
        root = self._root(path)
        inside: dict[Element, str] = {}  # folder of the file that includes it
        self._include(root, path.parent, "", {real_path(path)}, inside)
        _check_sizes(root, self.path)
        _leave_out_drawing(root)
        compiler: dict[str, str] = {}
        for element in root.iter("compiler"):
            compiler |= element.attrib
            for key in _FOLDERS:
                element.attrib.pop(key, None)
        folder = path.parent / compiler.get("meshdir", compiler.get("assetdir", ""))
        for element in root.iter():
            for key in [key for key in element.attrib if key.startswith("file")]:
                file = element.attrib[key].replace("\\", "/")
                if element.tag == "model":
                    bases = (path.parent, path.parent / inside.get(element, ""))
                else:
                    bases = (folder, folder / inside.get(element, ""))
                    if compiler.get("strippath") == "true":
                        file = PurePosixPath(file).name
                if element.tag in ("mesh", "hfield"):
                    stem = PurePosixPath(file).stem
                    element.attrib.setdefault("name", stem)
                element.set(key, self._named(element.tag, file, bases))
        return tostring(root, encoding="unicode")

    def _root(self, path: Path) -> Element:
        text = read_description(path)
        self._read += 1
        self._size += len(text)
        if self._read > _FILES or self._size > LARGEST:
            why = f"it is made of more than {_FILES} files or {LARGEST / 1e6:g} MB"
            raise BadRobot(self.path, why)
        return parse_xml(text, path, "MJCF")

    def _include(
        self,
        root: Element,
        main: Path,
        below: str,
        seen: set[Path],
        inside: dict[Element, str],
    ) -> None:
        """Put the content of files in place of the elements that include them."""
        for parent in list(root.iter()):
            content = list[Element]()
            for child in parent:
                inside[child] = below
                if child.tag != "include":
                    content.append(child)
                    continue
                name = child.get("file", "").replace("\\", "/")
                file = self._found(name, (main, main / below))
                if file is None:
                    raise BadRobot(
                        self.path, f"it includes {name}, which is missing"
                    )
                if file in seen:
                    raise BadRobot(self.path, f"{name} is already included")
                seen.add(file)
                included = self._root(file)
                around = str(PurePosixPath(below) / PurePosixPath(name).parent)
                self._include(included, main, around, seen, inside)
                content += included
            parent[:] = content

    def _found(self, name: str, bases: Iterable[Path]) -> Path | None:
        """Real path of a file that may be read; None if there is none."""
        for file in (base / name for base in bases):
            if exists(file):
                return within(file, self.path, self.packages)
        return None

    def _named(self, tag: str, file: str, bases: tuple[Path, ...]) -> str:
        """Our name of a file, whose content is taken."""
        found = self._found(file, bases)
        real = found or real_path(bases[0] / file)
        if real in self._names:
            return self._names[real]
        name = f"file{len(self._names)}_{PurePosixPath(file).suffix}"
        self._names[real] = name
        self.places[name] = str(real)
        if found is not None and tag == "model":
            self.models[name] = self.text(found).encode()
        elif found is not None:
            self.assets[name] = self._content(found)
        return name

    def _content(self, file: Path) -> bytes:
        try:
            content = read_bytes(file, _ASSETS - self._large)
        except OSError as error:
            why = f"it asks for {file}, which cannot be read ({error.strerror})"
            raise BadRobot(self.path, why) from None
        self._large += len(content)
        return content


def _leave_out_drawing(root: Element) -> None:
    """Remove what is only drawn."""
    for element in root.iter():
        element[:] = [child for child in element if child.tag not in _DRAWN]
        for key in _DRAWN:
            element.attrib.pop(key, None)


def _check_sizes(root: Element, path: Path) -> None:
    """Refuse depths, and numbers of copies, grids and memory, that no arm needs."""
    rest = [(root, 1.0, 1)]
    bodies = 0.0
    while rest:
        element, copies, depth = rest.pop()
        numbers = {key: _product(element.get(key, "")) for key in _SIZES}
        large = [key for key, most in _SIZES.items() if numbers[key] > most]
        if element.tag == "size":
            large += [key for key, text in element.items() if _product(text) > 1e6]
        elif element.tag == "replicate":
            copies *= numbers["count"]
        elif element.tag == "body":
            bodies += copies
        if large or copies > _COPIES:
            key = (*large, "count")[0]
            what = f'<{element.tag} {key}="{element.get(key)}">'
            raise BadRobot(path, f"{what} builds more than an arm can have")
        if bodies > _BODIES or depth > DEEPEST:
            what = f"{_BODIES} bodies" if bodies > _BODIES else f"{DEEPEST} levels"
            raise BadRobot(path, f"it builds more than {what}; no arm needs that")
        rest += [(child, copies, depth + 1) for child in element]


def _product(text: str) -> float:
    """Product of the numbers in a text, 1 without any; infinite where one is nan."""
    try:
        product = float(
            np.prod([max(abs(float(word)), 1.0) for word in text.split()])
        )
    except ValueError:
        return 1.0
    return np.inf if np.isnan(product) else product
