"""Where commands put their results: run folders, files and the terminal."""

from __future__ import annotations

import argparse
import io
import json
import os
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from excitant.identify import Recording
from excitant.reports import brief, load_run, save_run
from excitant.robots import Array, Robot


def table_bytes(table: pd.DataFrame, suffix: str) -> bytes:
    """A table as the content of a ``.csv`` or ``.parquet`` file."""
    buffer = io.BytesIO()
    if suffix == ".csv":
        table.to_csv(buffer, index=False)
    else:
        table.to_parquet(buffer, index=False)
    return buffer.getvalue()


def write_atomically(target: Path, content: bytes) -> None:
    """Write a file whole or not at all; its folder is made when missing."""
    target.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
        os.replace(name, target)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


def run_directory(args: argparse.Namespace, verb: str, robot: Robot) -> Path:
    """Folder named by the user, else one named by verb, robot and time."""
    if args.output:
        return Path(args.output)
    stamp = time.strftime("%Y%m%d-%H%M%S")
    return Path("runs") / f"{verb}-{robot.name}-{stamp}"


def finish(
    args: argparse.Namespace,
    directory: Path,
    result: dict[str, Any],
    series: Mapping[str, Array],
    files: Mapping[str, str | bytes],
) -> None:
    """Save the run, then print its paths and summary, or its result as JSON."""
    result["files"] = [str(directory / name) for name in files]
    paths, page = save_run(directory, result, series, files)
    if args.json:
        print_json(load_run(directory)[0])
        return
    print(brief(page))
    print()
    print_paths(paths)


def print_paths(paths: Sequence[Path]) -> None:
    """All paths, the report last because it is the one to open."""
    for path in sorted(paths, key=lambda path: path.suffix == ".html"):
        print(path)


def print_json(content: Mapping[str, Any]) -> None:
    """Print plain values as JSON."""
    json.dump(content, sys.stdout, indent=1, ensure_ascii=False)
    print()


def show_import(recordings: Sequence[Recording]) -> dict[str, list[str]]:
    """Say at once how columns were understood, where names left a choice."""
    for recording in recordings:
        for note in recording.notes:
            print(f"{recording.name}: {note}", file=sys.stderr)
    return {recording.name: list(recording.notes) for recording in recordings if recording.notes}
