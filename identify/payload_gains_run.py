"""Drive gains from recordings with and without a known payload, and torques made with them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from excitant.exceptions import BadInput
from excitant.identify.accuracy import series
from excitant.identify.known_payload import KnownPayload
from excitant.identify.payload_gains import DriveGains, Rows, payload_gains
from excitant.identify.preprocessing import Segment
from excitant.identify.recording import Recording
from excitant.identify.regression import observation
from excitant.identify.rows import split
from excitant.robots.base_parameters import BaseParameters, base_parameters
from excitant.robots.effects import Effect, standard_effects
from excitant.robots.robot import Robot


def identify_drive_gains(
    robot: Robot,
    recordings: Sequence[Recording],
    loaded: Sequence[Recording],
    payload: KnownPayload,
    *,
    validate: Sequence[Recording] = (),
    effects: Sequence[Effect] | None = None,
    cutoff_hz: float | None = None,
) -> DriveGains:
    """Drive gains of an arm whose motor currents were recorded.

    Args:
        robot: The arm without the payload; its masses are of no account.
        recordings: Currents without the payload; what `identify` fits of them is used.
        loaded: Currents with the payload.
        payload: What is known of it.
        validate: As given to `identify`.
        effects: Effects of the arm; friction, offset and rotor inertia when None.
        cutoff_hz: Cut-off of the filter [Hz].

    Raises:
        BadInput: Recordings that are no currents, or a payload that hardly shows in them.
        BadRecording: Recordings that cannot be used.
    """
    for recording in (*recordings, *loaded):
        if recording.unit != "A":
            raise BadInput(
                f"payload: {recording.file} holds torque in {recording.unit}, for which no drive "
                "gain is needed; --payload-recording is for motor currents"
            )
    effects = standard_effects(robot.joints) if effects is None else tuple(effects)
    base = base_parameters(robot, effects)
    data = split(recordings, validate, cutoff_hz)
    more = split(loaded, loaded, data.cutoff_hz).train
    free, held = (_rows(robot, effects, base, parts) for parts in (data.train, more))
    return payload_gains(free, held, payload)


def _rows(
    robot: Robot, effects: Sequence[Effect], base: BaseParameters, segments: Sequence[Segment]
) -> Rows:
    W, last = observation(robot, effects, segments), 10 * (robot.nv - 1)
    return Rows(W[:, :, list(base.columns)], W[:, :, last : last + 10], series(segments).measured)


def in_torque(recordings: Sequence[Recording], drive: DriveGains) -> list[Recording]:
    """Recordings of currents as recordings of torque."""
    return [replace(r, tau=r.tau * drive.gains, unit="N·m") for r in recordings]


def drive_result(drive: DriveGains) -> dict[str, Any]:
    """Drive gains as entries of result.json."""
    return {
        "drive_gain_Nm_per_A": drive.gains.tolist(),
        "drive_gain_std_Nm_per_A": drive.std.tolist(),
        "drive_gain_shown": list(drive.shown),
        "drive_gain_scale_rel_std": drive.scale_std,
    }
