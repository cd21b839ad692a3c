"""Files: read within bounds, written whole or not at all."""

import ctypes
import errno
import fcntl
import hashlib
import os
import secrets
import shutil
import stat
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from os.path import exists, isdir, lexists
from pathlib import Path

from excitant.exceptions import BadInput
from excitant.interrupts import deferred

LARGEST = 256 << 20
"""Bytes of a file that is read at once: descriptions, trajectories, results."""

_HERE = -100  # AT_FDCWD
_SWAP = 2  # RENAME_EXCHANGE of Linux


def size_of(path: str | Path) -> int:
    """Bytes of a regular file.

    Raises:
        OSError: There is none, or it is a folder, pipe, device or socket.
    """
    return _regular(os.stat(path), path)


def _regular(status: os.stat_result, path: str | Path) -> int:
    if stat.S_ISDIR(status.st_mode):
        raise IsADirectoryError(errno.EISDIR, "it is a folder", str(path))
    if not stat.S_ISREG(status.st_mode):
        raise OSError(errno.EINVAL, "it is a pipe, device or socket", str(path))
    return status.st_size


def read_bytes(path: str | Path, most: int = LARGEST) -> bytes:
    """Content of a regular file of at most so many bytes, else OSError.

    It is opened once, without waiting for whoever writes a pipe, and what was opened is looked at.
    """
    handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    try:
        size = _regular(os.fstat(handle), path)
        with open(handle, "rb", closefd=False) as file:
            content = b"" if size > most else file.read(most + 1)
    finally:
        os.close(handle)
    if max(size, len(content)) > most:
        why = f"it is {max(size, len(content)) / 1e6:.4g} MB large, more than {most / 1e6:.4g} MB"
        raise OSError(errno.EFBIG, why, str(path))
    return content


def read_text(path: str | Path, most: int = LARGEST) -> str:
    """Text in UTF-8 of a regular file of at most so many bytes, else OSError or UnicodeError."""
    return read_bytes(path, most).decode("utf-8-sig").replace("\r\n", "\n")


def real_path(path: str | Path) -> Path:
    """Absolute path without symbolic links; a loop of links is left as it is."""
    return Path(os.path.realpath(path))


def require_replaceable(folder: str | Path) -> None:
    """Refuse, as BadInput, a folder that `write_folder` could not put in place."""
    path = real_path(folder)
    why = _unwritable(path)
    if exists(path) and not isdir(path):
        why = "is a file"
    elif lexists(path) and not exists(path):
        why = "is a link that leads nowhere"
    elif path in (Path.cwd(), *Path.cwd().parents):
        why = "is the working folder or holds it, and would be replaced as a whole"
    elif os.path.ismount(path):
        why = "is a mount point, which cannot be replaced as a whole"
    if why:
        raise BadInput(f"{folder}: {why}; choose another folder, such as runs/1")


def require_file(path: str | Path, suffixes: Sequence[str]) -> Path:
    """The file; BadInput where `write_file` could not write it, or it has another suffix."""
    file = Path(path)
    if file.suffix not in suffixes:
        raise BadInput(f"{file}: name a {' or '.join(suffixes)} file")
    real = real_path(file)
    why = "is a folder" if isdir(real) else _unwritable(real)
    if why:
        raise BadInput(f"{file}: {why}; choose another file")
    return file


def _unwritable(path: Path) -> str:
    """Why nothing can be written at an absolute path; empty where it can."""
    # a link that leads nowhere is there, though nothing can be written in it
    parent = next((each for each in path.parents if lexists(each)), path)
    if not isdir(parent):
        return f"{parent} is no folder"
    if not os.access(parent, os.W_OK | os.X_OK):
        return f"nothing can be written in {parent}"
    longest = os.pathconf(parent, "PC_NAME_MAX")
    if any(len(os.fsencode(name)) > longest for name in path.parts):
        return f"has a name of more than {longest} bytes"
    if len(os.fsencode(path)) + longest > os.pathconf(parent, "PC_PATH_MAX"):
        return "is too long a path"
    return ""


def write_file(path: str | Path, content: str | bytes) -> None:
    """Write a file, or replace it in one step.

    Raises:
        BadInput: It cannot be written.
    """
    path = real_path(path)
    with _put_aside(path) as stage:
        _write(stage / path.name, content, path)
        os.replace(stage / path.name, path)


def write_folder(
    folder: str | Path,
    contents: Mapping[str, str | bytes],
    without: Collection[str] = (),
) -> list[Path]:
    """Write a folder, or replace it in one step; at every instant the old or the new one is whole.

    Args:
        folder: Made when missing, with its parents.
        contents: Content of files by their names relative to the folder.
        without: Names of files of an old folder that are left out; others stay in it.

    Returns:
        The files written.

    Raises:
        BadInput: It cannot be written; an old folder is as it was.
    """
    require_replaceable(folder)
    target = real_path(folder)
    for name in contents:
        if isdir(target / name):
            raise BadInput(
                f"{Path(folder) / name}: is a folder where a file is to be written; "
                "move it, or choose another folder"
            )
    with _put_aside(target) as stage:
        new = stage / "run"
        if exists(target):
            gone = {*contents, *without}
            shutil.copytree(
                target, new, symlinks=True, copy_function=_link,
                ignore=lambda at, names: {n for n in names if _below(target, at, n) in gone},
            )  # fmt: skip
        for name, content in contents.items():
            (new / name).parent.mkdir(parents=True, exist_ok=True)
            _write(new / name, content, Path(folder) / name)
        if exists(target):
            _exchange(new, target)
        else:
            os.rename(new, target)
    return [Path(folder) / name for name in contents]


def _below(folder: Path, at: str, name: str) -> str:
    return (Path(at) / name).relative_to(folder).as_posix()


@contextmanager
def _put_aside(target: Path) -> Iterator[Path]:
    """A folder beside the target, removed in the end, as are those of runs that were killed.

    Signals that end a command wait until then.
    """
    missing = [folder for folder in target.parents if not exists(folder)]
    prefix = (
        f".excitant-{hashlib.sha256(os.fsencode(target.name)).hexdigest()[:12]}-"
    )
    with deferred(f"{target} was written"):
        try:
            for folder in reversed(missing):
                folder.mkdir(exist_ok=True)
            for left in target.parent.glob(f"{prefix}*"):
                with suppress(OSError), _locked(left):
                    shutil.rmtree(left)
            stage = target.parent / f"{prefix}{secrets.token_hex(4)}"
            stage.mkdir()
            with _locked(stage):
                try:
                    yield stage
                finally:
                    shutil.rmtree(stage, ignore_errors=True)
        except BaseException as error:
            for folder in missing:
                with suppress(OSError):
                    folder.rmdir()
            if not isinstance(error, OSError):
                raise
            why = error.strerror or str(error)
            full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
            what = (
                error.filename
                if full and prefix not in str(error.filename)
                else None
            )
            advice = "free some space or " * full + "choose another folder"
            raise BadInput(
                f"{what or target}: cannot be written: {why}; {advice}"
            ) from error


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """The folder while nobody else has it, else OSError."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    finally:
        os.close(handle)


def _write(path: Path, content: str | bytes, shown: Path) -> None:
    try:
        with path.open("xb") as file:
            file.write(content.encode() if isinstance(content, str) else content)
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        raise OSError(
            error.errno, error.strerror or str(error), str(shown)
        ) from None


def _link(source: str, target: str) -> str:
    try:
        os.link(source, target, follow_symlinks=False)
    except OSError:  # a file system without links
        shutil.copy2(source, target, follow_symlinks=False)
    return target


def _exchange(new: Path, old: Path) -> None:
    """Exchange two folders, in one step where the system can."""
    swap = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
    if swap and swap(_HERE, os.fsencode(new), _HERE, os.fsencode(old), _SWAP) == 0:
        return
    aside = new.with_name("old")
    os.rename(old, aside)
    try:
        os.rename(new, old)
    except BaseException:
        os.rename(aside, old)
        raise
