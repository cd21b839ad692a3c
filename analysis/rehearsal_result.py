"""A rehearsal as result.json and series."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from excitant.analysis.rehearsal import Rehearsal
from excitant.robots.motion import Array


def rehearse_result(rehearsal: Rehearsal) -> dict[str, Any]:
    """Contents of result.json: what was required, and whether it was met."""
    robot, change = rehearsal.robot, rehearsal.change
    failed = [item for item in rehearsal.items if not item.passed]
    return {
        "verb": "rehearse",
        "robot": robot.name,
        "joints": list(robot.joints),
        "duration": rehearsal.duration,
        "passed": rehearsal.passed,
        "headline": _headline(rehearsal),
        "items": [asdict(item) for item in rehearsal.items],
        "advice": list(dict.fromkeys(item.advice for item in failed)),
        "effect": {
            "effect": change.effect,
            "joint": change.joint,
            "parameters": dict(change.parameters),
        },
        "limit_values": {
            name: getattr(robot.limits, name) for name in ("position", "velocity", "torque")
        },
    }


def _headline(rehearsal: Rehearsal) -> str:
    failed = [item for item in rehearsal.items if not item.passed]
    if not failed:
        return (
            f"The motion would do: all {len(rehearsal.items)} requirements are met on a virtual arm"
        )
    names = list(dict.fromkeys(f"{x.name} of {x.joint}" if x.joint else x.name for x in failed))
    listed = ", ".join(names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")
    return f"The motion would not do: {listed}"


def rehearse_series(rehearsal: Rehearsal) -> dict[str, Array]:
    """The run of the motion on the virtual arm: t [s], q, dq, tau in SI units, (n, nv)."""
    run = rehearsal.run
    return {"t": run.t, "q": run.q, "dq": run.dq, "tau": run.tau}
