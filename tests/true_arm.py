"""Arms without the product's dynamics: Pinocchio's bodies, and drives written here."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin

from excitant.identify import Recording
from excitant.robots import Motion

Values = np.ndarray | float


def newton_euler(model: pin.Model, motion: Motion) -> np.ndarray:
    """Pinocchio's torque of rigid bodies, shape (n, nv)."""
    data, states = model.createData(), zip(motion.q, motion.dq, motion.ddq, strict=True)
    return np.array([pin.rnea(model, data, *state) for state in states])


@dataclass(frozen=True)
class TrueArm:
    """Rigid bodies, and what each joint has besides, shapes (nv,)."""

    model: pin.Model
    Fv: Values = 0.0
    Fc: Values = 0.0
    offset: Values = 0.0
    Ia: Values = 0.0

    def torque(self, motion: Motion) -> np.ndarray:
        friction = self.Fv * motion.dq + self.Fc * np.sign(motion.dq) + self.offset
        return newton_euler(self.model, motion) + friction + self.Ia * motion.ddq


def save(recording: Recording, folder: Path) -> Path:
    """The recording as CSV: t, q1.., and tau1.. or currents i1.. ."""
    read = "i" if recording.unit == "A" else "tau"
    names = [f"{kind}{k + 1}" for kind in ("q", read) for k in range(recording.q.shape[1])]
    values = np.column_stack([recording.t, recording.q, recording.tau])
    path, header = folder / f"{recording.name}.csv", ",".join(["t", *names])
    np.savetxt(path, values, delimiter=",", header=header, comments="")
    return path
