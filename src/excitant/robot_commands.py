"""The command about arms: which there are, what one is, and what looks wrong in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from excitant.options import Run, print_json
from excitant.reports.wording import number
from excitant.robots import Robot, builtin_robots
from excitant.robots.library.catalogue import arm_entry, catalogue, catalogue_rows
from excitant.robots.model_check import check_model
from excitant.robots.model_check_result import robot_result, robot_series


def show_robot(name: str, robot: Robot, mass: float | None, run: Run) -> None:
    """One arm and what looks wrong in it, on the terminal, as JSON or as a page."""
    result = robot_result(robot, check_model(robot, mass), mass)
    if name in builtin_robots():
        entry = arm_entry(name)
        result |= {"kind": entry.kind, "sources": entry.sources}
    if run.output is not None:
        run.finish(Path(run.output), result, robot_series(robot), {})
    elif run.json:
        print_json(result)
    else:
        _show(result)


def list_robots(as_json: bool) -> None:
    """All built-in arms."""
    if as_json:
        arms = [
            {**asdict(arm), "joints": arm.joints, "mass": arm.moving_mass} for arm in catalogue()
        ]
        print_json({"verb": "robots", "robots": arms})
        return
    _print_table(catalogue_rows())


def _show(result: dict[str, Any]) -> None:
    """One arm on the terminal: joints, links, then what looks wrong."""
    joints = result["joints"]
    print(
        f"{result['robot']}: {len(joints)} joints, {result['base_parameters']} base parameters, "
        f"{number(result['total_mass'], 4)} kg, of which {number(result['mass'], 4)} kg move"
    )
    print()
    heads = ("joint", "kind", "lower", "upper", "speed", "accel.", "effort", "gravity")
    keys = ("velocity", "acceleration", "torque", "gravity_torque")
    rows = [
        (j["name"], j["kind"], *(_short(x) for x in (*j["position"], *(j[key] for key in keys))))
        for j in joints
    ]
    _print_table([heads, *rows], numbers=range(2, 8))
    print("(rad, m, N·m, N; gravity: the most that it takes within the ranges)")
    print()
    about = ("link", "moves with", "mass [kg]", "centre of mass [m]", "principal moments [kg·m²]")
    links = [
        (
            link["link"],
            link["moves_with"] or "(stands)",
            _short(link["mass"]),
            " ".join(f"{x:.4g}" for x in link["com"]),
            " ".join(f"{x:.3g}" for x in link["principal_moments"]),
        )
        for link in result["links"]
        if link["mass"] != 0
    ]
    _print_table([about, *links], numbers=(2,))
    print()
    for line in warning_lines(result["warnings"]):
        print(line)


def warning_lines(warnings: Sequence[dict[str, Any]]) -> list[str]:
    """What looks wrong, one line each."""
    if not warnings:
        return ["nothing looks wrong in inertias, axes and limits, and the arm can hold itself"]
    return [
        f"{'hint' if w['hint'] else 'WARNING'}: {', '.join(w['where'])}: {w['sentence']}"
        for w in warnings
    ]


def _short(value: float | None) -> str:
    return "none" if value is None else f"{value:.4g}"


def _print_table(rows: Sequence[Sequence[str]], numbers: Sequence[int] = ()) -> None:
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    for row in rows:
        cells = [
            cell.rjust(width) if k in numbers else cell.ljust(width)
            for k, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        print("  ".join(cells).rstrip())
