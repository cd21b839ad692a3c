"""Persistency of excitation of a motion, as plain values and a sentence.

The measure is `excitant.identify.excitation`: over every window of a given length, how many times
more the rows know of each visible combination of parameters than was known beforehand.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from excitant.identify.excitation import Persistency, WindowExcitation, persistency
from excitant.robots.effects import Effect
from excitant.robots.motion import Array, Motion
from excitant.robots.robot import Robot


def persistency_result(
    robot: Robot,
    effects: Sequence[Effect],
    motion: Motion,
    *,
    window: float | None = None,
    sigma: Array | None = None,
) -> dict[str, Any]:
    """Whether a motion is persistently exciting, over which window, at which level, and what lacks.

    Args:
        robot: The arm.
        effects: Effects whose coefficients are unknown beside the inertias.
        motion: Samples evenly spread in time.
        window: Length of the windows [s]; the whole motion when None.
        sigma: Noise of an independent row of torque, shape (nv,) [N·m]; 1 % of the torque of a
            lively motion when None.

    Returns:
        ``persistent``, ``level`` (of the weakest direction in the weakest window; 1 is enough,
        None when nothing is visible), ``window_s``, ``shortest_window_s`` (None when no window
        is exciting), ``visible``, ``missing``, ``joints`` whose motion is missing, the one that
        helps most first, ``weak`` combinations, each ``windows`` entry, and a ``sentence``.

    Raises:
        BadInput: A window longer than the motion or without samples.
    """
    found = persistency(robot, motion, effects, window=window, sigma=sigma)
    weakest = found.weakest
    return {
        "persistent": found.persistent,
        "level": _number(found.level),
        "window_s": float(found.window),
        "shortest_window_s": found.shortest,
        "visible": len(weakest.levels),
        "missing": weakest.missing,
        "joints": list(weakest.joints),
        "weak": [
            {
                "parameters": list(direction.parameters),
                "level": float(direction.level),
                "joints": list(direction.joints),
            }
            for direction in weakest.weak
        ],
        "windows": [
            {
                "start_s": float(each.start),
                "end_s": float(each.end),
                "level": _number(each.level),
                "missing": each.missing,
                "joints": list(each.joints),
            }
            for each in found.windows
        ],
        "sentence": _sentence(found, weakest),
    }


def _number(level: float) -> float | None:
    return float(level) if np.isfinite(level) else None


def _sentence(found: Persistency, weakest: WindowExcitation) -> str:
    visible = len(weakest.levels)
    if not visible:
        return "no motion of this arm shows any parameter above the noise"
    if found.persistent:
        text = (
            f"persistently exciting over {found.window:.3g} s at level {found.level:.3g}: all "
            f"{visible} visible combinations become better known than they were"
        )
        if found.shortest is not None and found.shortest < found.window:
            text += f"; windows of {found.shortest:.3g} s are enough"
        return text
    text = (
        f"not persistently exciting over {found.window:.3g} s: from {weakest.start:.3g} to "
        f"{weakest.end:.3g} s {weakest.missing} of {visible} visible combinations are missing "
        f"(level {found.level:.2g})"
    )
    if weakest.weak:
        text += f", first of all {weakest.weak[0].parameters[0]}"
    if weakest.joints:
        text += f"; move {', '.join(weakest.joints)}"
    return text
