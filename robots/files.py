"""Files of others: read up to a size and a depth, and only where their text may point to."""

import os
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator
from os.path import exists, isdir, isfile
from pathlib import Path

from defusedxml import EntitiesForbidden
from defusedxml.ElementTree import XMLParser

from excitant.exceptions import BadRobot
from excitant.files import read_text, real_path

LARGEST = 32_000_000
"""Bytes of a text that is read; descriptions of whole humanoids have a hundredth."""

DEEPEST = 100
"""Elements within one another."""

_MOST = 200_000  # elements

ALLOW = "--package FOLDER"
"""How files elsewhere are allowed."""


def read_description(path: str | Path) -> str:
    """Text of a robot's description, or `BadRobot`."""
    try:
        return read_text(path, LARGEST)
    except UnicodeDecodeError:
        why = "not a text file in UTF-8; give a URDF, xacro, MJCF or a robot.yaml"
    except OSError as error:
        why = f"cannot be read ({error.strerror})"
    raise BadRobot(path, why)


def parse_xml(
    text: str, source: str | Path, form: str = "URDF", prefix: str = ""
) -> ET.Element:
    """Root of an XML text, which is neither deep, nor huge, nor built of entities.

    Args:
        text: The text.
        source: The file, for messages.
        form: The format that is expected, for messages.
        prefix: Prefix of the namespace whose names are kept as ``prefix:name``, those of all
            others as ``name``; without one, names stay as XML has them, ``{namespace}name``.
    """
    target = _Tree(source, prefix)
    try:
        parser = XMLParser(target=target, forbid_entities=True)
        parser.feed(text)
        root = parser.close()
    except EntitiesForbidden:
        why = "its XML declares entities; write out what they stand for"
        raise BadRobot(source, why) from None
    except ET.ParseError as error:
        raise BadRobot(source, f"not XML ({error}); give a {form} file") from None
    return root


class _Tree(ET.TreeBuilder):
    """Builds a tree within bounds of size and depth."""

    def __init__(self, source: str | Path, prefix: str) -> None:
        super().__init__()
        self.source = source
        self.prefix = prefix
        self.spaces: dict[str, str] = {}  # what stands for each namespace in a name
        self.depth = 0
        self.count = 0

    def start_ns(self, prefix: str, uri: str) -> None:
        """Begin the scope of a namespace."""
        self.spaces[uri] = f"{prefix}:" if prefix == self.prefix else ""

    def start(self, tag: str, attrs: dict[str, str]) -> ET.Element:
        """Begin an element."""
        self.depth += 1
        self.count += 1
        if self.depth > DEEPEST or self.count > _MOST:
            deep = self.depth > DEEPEST
            what = f"{DEEPEST} elements deep" if deep else f"{_MOST} elements"
            why = f"its XML is more than {what}; no arm needs that"
            raise BadRobot(self.source, why)
        if self.prefix:
            tag = self._named(tag)
            attrs = {self._named(name): value for name, value in attrs.items()}
        return super().start(tag, attrs)

    def end(self, tag: str) -> ET.Element:
        """End an element."""
        self.depth -= 1
        return super().end(self._named(tag) if self.prefix else tag)

    def _named(self, name: str) -> str:
        space, _, local = name.rpartition("}")
        return self.spaces.get(space[1:], "") + local


def within(
    path: str | Path,
    named_by: str | Path,
    packages: Iterable[str | Path] = (),
    allow: str = ALLOW,
) -> Path:
    """Real path of a file or folder that a file names.

    It lies below the `home` of the one that names it, or one of ``packages``.

    Raises:
        BadRobot: It lies elsewhere, or is a pipe, device or socket.
    """
    real = real_path(path)
    if not any(
        map(real.is_relative_to, (home(named_by), *map(real_path, packages)))
    ):
        raise BadRobot(
            named_by,
            f"it asks for {path}, which is outside its folder; if you trust it, allow that with "
            f"{allow}",
        )
    if exists(real) and not (isfile(real) or isdir(real)):
        raise BadRobot(
            named_by, f"it asks for {path}, which is no file; name a file"
        )
    return real


def home(path: str | Path) -> Path:
    """Folder that a file may read in: its package (the nearest ``package.xml``), else its own."""
    folder = real_path(path).parent
    around = (folder, *folder.parents)
    return next((f for f in around if isfile(f / "package.xml")), folder)


def package_folders(
    name: str, named_by: str | Path, packages: Iterable[str | Path]
) -> Iterator[Path]:
    """Folders of a package, by their name or that in ``package.xml``.

    They are those given (the package itself, or a folder that holds it), then the `home` of the
    file that names it, then those of ROS.
    """
    for around in (*map(real_path, packages), home(named_by)):
        for folder in map(real_path, _called(name, around)):
            if folder.is_relative_to(around):
                yield folder
    yield from ros_folders(name)


def ros_folders(name: str) -> Iterator[Path]:
    """Folders of a package by the user's ``ROS_PACKAGE_PATH`` and ``AMENT_PREFIX_PATH``."""
    for variable, inner in (
        ("ROS_PACKAGE_PATH", ""),
        ("AMENT_PREFIX_PATH", "share"),
    ):
        for path in filter(None, os.environ.get(variable, "").split(os.pathsep)):
            yield from _called(name, Path(path) / inner)


def _called(name: str, around: Path) -> Iterator[Path]:
    """A folder, and one in it, that are a package of this name."""
    for folder in (around, around / name):
        if (
            re.fullmatch(r"\w[\w.-]*", name)
            and isdir(folder)
            and name in (folder.name, _package_name(folder))
        ):
            yield folder


def _package_name(folder: Path) -> str:
    """Name that a folder's package.xml gives it, if any."""
    try:
        name = parse_xml(
            read_text(folder / "package.xml", LARGEST), folder
        ).findtext("name")
    except (OSError, UnicodeDecodeError, BadRobot):
        name = None
    return (name or "").strip()
