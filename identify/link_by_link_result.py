"""What was identified link by link, as JSON and as arrays for figures."""

from __future__ import annotations

from typing import Any

import numpy as np

from excitant.identify.link_by_link import LinkByLink, Stage
from excitant.identify.result import identify_result, identify_series
from excitant.robots.motion import Array
from excitant.robots.robot import Robot


def link_by_link_result(found: LinkByLink) -> dict[str, Any]:
    """Machine-readable result: that of `identify`, and the stages under ``link_by_link``."""
    robot, estimate = found.estimate.given, found.estimate
    result = identify_result(estimate)
    result["estimator"] = (
        "link by link from the last inward, each from its own joint's row with the outer links "
        "known; then physically consistent semidefinite fit"
    )
    result["link_by_link"] = {
        "stages": [_stage(robot, stage) for stage in found.stages],
        "determined": sum(len(stage.determined) for stage in found.stages),
        "base_parameters": len(estimate.base),
        "comparison": {
            "all_at_once": found.all_at_once_means,
            "refusal": found.refusal or None,
            "joints": [
                {
                    "name": joint,
                    "given": float(estimate.baseline.rms[j]),
                    "all_at_once": float(found.all_at_once.validate.rms[j]),
                    "link_by_link": float(estimate.validate.rms[j]),
                    "measured_std": float(estimate.series.measured[:, j].std()),
                }
                for j, joint in enumerate(robot.joints)
            ],
        },
    }
    return result


def _stage(robot: Robot, stage: Stage) -> dict[str, Any]:
    noise = stage.noise
    return {
        "link": robot.links[stage.joint],
        "joint": robot.joints[stage.joint],
        "rows": noise.rows,
        "recordings": list(stage.recordings),
        "mode": stage.mode,
        "noise": noise.sigma if np.isfinite(noise.sigma) else None,
        "determined": [
            {"expression": each.expression, "value": each.value, "std": each.std}
            for each in stage.determined
        ],
        "missing": list(stage.missing),
        "needed": list(stage.needed),
    }


def link_by_link_series(found: LinkByLink) -> dict[str, Array]:
    """Measured torque and that of the models on the hold-out, each of shape (n, nv)."""
    return identify_series(found.estimate) | {"all_at_once": found.all_at_once.predicted}
