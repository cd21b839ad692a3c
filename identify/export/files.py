"""The files of a published model, by name."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import yaml

from excitant.exceptions import UnknownName
from excitant.identify.export.bodies import folded, tree
from excitant.identify.export.code import c_function, python_module
from excitant.identify.export.mjcf import mjcf_text
from excitant.identify.export.sdf import sdf_text
from excitant.identify.export.urdf import urdf_text
from excitant.robots.effects import effect_entries
from excitant.robots.motion import Array
from excitant.robots.robot import Robot

FORMATS = ("urdf", "mjcf", "sdf", "python", "c")
DEFAULT_FORMATS = ("urdf", "mjcf", "sdf")


def model_files(
    model: Robot,
    stem: str,
    yaml_name: str,
    formats: Sequence[str] = DEFAULT_FORMATS,
    gains: Array | None = None,
) -> dict[str, str]:
    """A robot as files; URDF and YAML always.

    The YAML refers to the URDF and adds what that cannot hold: `load_robot` reads it back to the
    same torque. The others are ``.xml`` (MJCF), ``.sdf``, ``.py``, ``.c`` and ``.h``. Payloads
    and corrections of inertia are part of the links in all of them.

    Args:
        model: The robot; its effects have values.
        stem: Name of the files without ending.
        yaml_name: Name of the YAML.
        formats: Some of `FORMATS`.
        gains: Drive gains, shape (nv,) [N·m/A], where torque was measured as current.

    Raises:
        UnknownName: A format that is not one of `FORMATS`.
        BadInput: An effect without values, or one that code cannot hold.
    """
    for name in formats:
        if name not in FORMATS:
            raise UnknownName("format", name, FORMATS)
    arm = tree(model)
    files = {
        f"{stem}.urdf": urdf_text(model, yaml_name),
        yaml_name: _yaml(model, f"{stem}.urdf", gains),
    }
    if "mjcf" in formats:
        files[f"{stem}.xml"] = mjcf_text(arm, yaml_name, gains)
    if "sdf" in formats:
        files[f"{stem}.sdf"] = sdf_text(arm, yaml_name)
    if "python" in formats:
        files[f"{stem}.py"] = python_module(arm)
    if "c" in formats:
        files[f"{stem}.c"], files[f"{stem}.h"] = c_function(arm, stem)
    return files


def _yaml(model: Robot, urdf: str, gains: Array | None) -> str:
    limits = model.limits
    names = ["position", "velocity", "acceleration", "torque"]
    names += ["jerk"] if np.isfinite(limits.jerk).any() else []
    content: dict[str, Any] = {
        "model": urdf,
        "joints": list(model.joints),
        "gravity": [float(g) for g in model.gravity],
        "limits": {name: getattr(limits, name).tolist() for name in names},
        "effects": effect_entries(folded(model).effects),
    }
    if gains is not None:
        content["drive"] = {"gain_Nm_per_A": [float(gain) for gain in gains]}
    return yaml.safe_dump(content, sort_keys=False, allow_unicode=True)
