"""The command about arms: which there are, what one is, and what looks wrong in it."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from excitant.options import Run, print_json
from excitant.reports import page_of, summary, table_lines
from excitant.robots import Robot, builtin_robots
from excitant.robots.check import ModelCheck
from excitant.robots.library.catalogue import arm_entry, catalogue, catalogue_rows


def show_robot(name: str, robot: Robot, mass: float | None, run: Run) -> None:
    """One arm and what looks wrong in it, on the terminal, as JSON or as a page."""
    check = ModelCheck(robot, mass)
    result = check.result()
    if name in builtin_robots():
        entry = arm_entry(name)
        result |= {"kind": entry.kind, "sources": entry.sources}
    if run.output is not None:
        run.finish(Path(run.output), result, check.series(), {})
    elif run.json:
        print_json(result)
    else:
        print(summary(page_of(result, {})), end="")


def list_robots(as_json: bool) -> None:
    """All built-in arms."""
    if as_json:
        arms = [
            {**asdict(arm), "joints": arm.joints, "mass": arm.moving_mass} for arm in catalogue()
        ]
        print_json({"verb": "robots", "robots": arms})
        return
    heads, *rows = catalogue_rows()
    kinds = ["number" if "[kg]" in head else "name" for head in heads]
    print("\n".join(table_lines(list(zip(heads, kinds, strict=True)), rows)))
