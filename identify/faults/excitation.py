"""A motion that does not show the parameters it is recorded for."""

from __future__ import annotations

import numpy as np

from excitant.exceptions import ExcitantError
from excitant.identify.excitation import persistency
from excitant.identify.faults.fault import Fault
from excitant.identify.faults.fit import Smooth
from excitant.identify.faults.log import Log
from excitant.robots.robot import Robot

_TELLS = 0.1  # of the prior's information: less makes nothing more certain by even 5 %


def poor_excitation(robot: Robot, log: Log, data: Smooth | None) -> Fault | None:
    """Directions of the base parameters that the motion shows worse than they are known."""
    still = np.ptp(log.q, axis=0) <= 50 * np.maximum(log.resolution, log.quantum)
    if data is None:
        if not still.all() and np.ptp(log.q) > 0:
            return None
        return Fault(
            "poor_excitation", log.joints,
            f"no joint moves: positions vary by at most {np.ptp(log.q, axis=0).max():.3g}",
            {"span": np.ptp(log.q, axis=0)},
        )  # fmt: skip
    try:
        window = persistency(robot, data.motion).weakest
    except ExcitantError:
        return None  # the arm has no inertia to compare with
    missing = int((window.levels < _TELLS).sum())
    if not missing:
        return None
    names = tuple(j for j in log.joints if j in window.joints) or log.names(np.flatnonzero(still))
    weakest = ", ".join(window.weak[0].parameters) if window.weak else "all"
    return Fault(
        "poor_excitation", names or log.joints,
        f"{missing} of {len(window.levels)} directions of the parameters that such an arm can show "
        f"in this time get less than {_TELLS:g} of the information that the given model already "
        f"has, the weakest {window.level:.2g} ({weakest}); move {', '.join(names or log.joints)}",
        {"missing": missing, "visible": len(window.levels), "level": window.level,
         "still": log.names(np.flatnonzero(still))},
    )  # fmt: skip
