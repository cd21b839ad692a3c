"""Payload from recordings, sample by sample: loaded against unloaded, or against the model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from excitant.exceptions import BadInput
from excitant.identify.accuracy import series
from excitant.identify.base_prior import base_prior
from excitant.identify.estimate import Estimate
from excitant.identify.information import Information, gaussian
from excitant.identify.payload import PayloadEstimate, estimate_payload
from excitant.identify.recording import Recording
from excitant.identify.regression import observation
from excitant.identify.replay import joined, replay
from excitant.identify.rows import split, torque_per_reading
from excitant.robots.base_parameters import BaseParameters, base_parameters
from excitant.robots.effects import Effect, standard_effects
from excitant.robots.motion import Array
from excitant.robots.robot import Robot

_MODEL_ERROR = 0.01  # of a given model, where neither recording nor estimate says better


def identify_payload(
    robot: Robot,
    loaded: Sequence[Recording],
    *,
    unloaded: Sequence[Recording] = (),
    arm: Estimate | None = None,
    effects: Sequence[Effect] | None = None,
) -> PayloadEstimate:
    """What the arm carries in some recordings.

    The unloaded arm is known from recordings, from an estimate, or else from the given model.

    Args:
        robot: The arm without its load.
        loaded: Recordings with the load.
        unloaded: Recordings of the same arm without it; any motion.
        arm: An estimate of the arm without it, in place of recordings; it brings its effects.
        effects: Effects of the arm; friction, offset and rotor inertia when None.

    Raises:
        BadInput: Currents of a loaded arm with nothing to compare them with.
        BadRecording: Recordings that cannot be used.
        Infeasible: The semidefinite solver failed.
    """
    if arm is not None:
        effects, base = arm.model.effects, arm.base
    else:
        effects = standard_effects(robot.joints) if effects is None else tuple(effects)
        base = base_parameters(robot, effects)
    unit = loaded[0].unit
    if arm is None and not unloaded and unit == "A":
        raise BadInput(
            f"payload: {loaded[0].file} has currents, whose gain the load would be taken for; "
            "name recordings without load (--unloaded)"
        )
    if any(each.unit != unit for each in (*loaded, *unloaded)):
        raise BadInput("payload: recordings in N·m and in A; use recordings of one unit")
    gains = _gains(robot, effects, base, unloaded or loaded) if arm is None else arm.gains
    known, note = _unloaded(robot, effects, base, unloaded, arm, gains)
    run = replay(robot, joined(loaded), effects=effects, base=base, prior=False, gains=gains)
    found = estimate_payload(robot, base, run.estimate.data, known, unit=unit)
    return replace(found, notes=(note, *found.notes))


def _gains(
    robot: Robot, effects: Sequence[Effect], base: BaseParameters, recordings: Sequence[Recording]
) -> Array:
    """Torque per reading, from recordings of currents, shape (nv,)."""
    if recordings[0].unit != "A":
        return np.ones(robot.nv)
    segments = split(recordings, recordings).train
    W = observation(robot, effects, segments)
    return torque_per_reading(robot, base, W, series(segments), "A")


def _unloaded(
    robot: Robot,
    effects: Sequence[Effect],
    base: BaseParameters,
    unloaded: Sequence[Recording],
    arm: Estimate | None,
    gains: Array,
) -> tuple[Information, str]:
    """What is known of the arm without load, and where from."""
    if arm is not None:
        fit = arm.least_squares
        return gaussian(fit.beta, fit.covariance), "the unloaded arm was identified before"
    if unloaded:
        run = replay(robot, joined(unloaded), effects=effects, base=base, prior=False, gains=gains)
        return run.estimate.data, "the unloaded arm was recorded"
    prior = base_prior(robot, effects, base)
    return gaussian(prior.mean, _MODEL_ERROR**2 * prior.covariance), (
        f"the given model stands for the unloaded arm, taken to be right to "
        f"{100 * _MODEL_ERROR:g} %; record the arm without load (--unloaded) to know better"
    )
