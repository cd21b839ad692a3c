"""What MuJoCo says of the hold-out: torque of the exported models, by its inverse dynamics."""

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

import numpy as np

from excitant.exceptions import BadInput
from excitant.identify.estimate import Estimate
from excitant.identify.export import model_files
from excitant.identify.preprocessing import Segment
from excitant.robots.motion import Array, Motion
from excitant.robots.robot import Robot


def mujoco_torque(
    robot: Robot, segments: Sequence[Segment], gains: Array | None = None
) -> Array:
    """Controls that MuJoCo's arm needs at the rows of segments, filtered alike, shape (n, nv).

    The arm is the MJCF that is written of the robot, with its damping, armatures, friction and
    biases; its joint limits are left aside. Controls are torques [N·m], or currents [A] where drive
    gains [N·m/A] are given.

    Raises:
        BadInput: MuJoCo refuses the model, say for an impossible inertia.
        ModuleNotFoundError: MuJoCo is not installed (extra ``mjcf``).
    """
    import mujoco

    text = model_files(robot, "arm", "arm.yaml", ["mjcf"], gains)["arm.xml"]
    try:
        model = mujoco.MjModel.from_xml_string(text)
    except ValueError as error:
        raise BadInput(f"MuJoCo refuses {robot.name}: {error}") from None
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT
    data = mujoco.MjData(model)
    gear = model.actuator_gear[:, 0]
    # one branch after the other
    order = [model.joint(joint).dofadr[0] for joint in robot.joints]

    def controls(motion: Motion) -> Array:
        force = np.empty(motion.q.shape)
        for k in range(len(motion)):
            data.qpos[order] = motion.q[k]
            data.qvel[order] = motion.dq[k]
            data.qacc[order] = motion.ddq[k]
            mujoco.mj_inverse(model, data)
            force[k] = data.qfrc_inverse[order]
        return force / gear - model.actuator_biasprm[:, 0]

    return np.concatenate([segment.rows(controls) for segment in segments])


@dataclass(frozen=True, eq=False)
class SideBySide:
    """Given and identified model in MuJoCo on the hold-out, each (n, nv) [torque unit].

    Attributes:
        estimate: The identification.
        given: Torque of the given model; None where MuJoCo refuses it.
        identified: Torque of the identified model.
        notes: What MuJoCo refuses, as sentences.
    """

    estimate: Estimate
    given: Array | None
    identified: Array
    notes: tuple[str, ...]

    def result(self) -> dict[str, Any]:
        """Its entry in ``result.json``; ``differs`` from excitant's torque by share of its std."""
        rows = self.estimate.holdout
        std = np.where(rows.std > 0, rows.std, np.nan)
        differs = rows.rms(self.identified - self.estimate.predicted) / std
        identified = rows.accuracy(self.identified)
        given = None if self.given is None else rows.accuracy(self.given)
        return {
            "version": version("mujoco-core"),
            "joints": [
                {
                    "name": joint,
                    "given": None if given is None else given.entry(j),
                    "identified": identified.entry(j),
                    "differs": float(differs[j]),
                }
                for j, joint in enumerate(self.estimate.given.joints)
            ],
            "notes": list(self.notes),
        }

    def series(self) -> dict[str, Array]:
        """Torque of both models at the rows of the hold-out."""
        given = {} if self.given is None else {"mujoco_given": self.given}
        return given | {"mujoco_identified": self.identified}


def side_by_side(estimate: Estimate, written: Robot | None = None) -> SideBySide:
    """Both models of an identification in MuJoCo, on its hold-out; BadInput as `mujoco_torque`.

    ``written`` is what the MJCF holds, where that is not simply the model.
    """
    gains = estimate.gains if estimate.data.unit == "A" else None
    segments = estimate.data.validate
    notes = list[str]()
    identified = mujoco_torque(written or estimate.model, segments, gains)
    try:
        given = mujoco_torque(estimate.given, segments, gains)
    except BadInput as error:
        given = None
        notes.append(str(error))
    return SideBySide(estimate, given, identified, tuple(notes))
