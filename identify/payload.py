"""Recordings with a payload: the payload on a known arm, or the drive gains.

A body π on the last link adds K π to the base parameters of the arm, because its columns are
those of that link: β_loaded = β_arm + K π. What the unloaded arm and the loaded arm each say of
their base parameters therefore holds everything about the body:

    R_loaded (β + K π) ≈ z_loaded,    R_arm β ≈ z_arm.

Eliminating β leaves ten rows about π, to which the physically consistent fit is made.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin

from excitant.exceptions import BadInput
from excitant.identify.drive_gains import DriveGains, KnownPayload, payload_gains
from excitant.identify.information import Information, gaussian, information_of
from excitant.identify.online import PERIOD, OnlineEstimator, replayable
from excitant.identify.physical import PhysicalFit, centre_of_mass, fit_physical
from excitant.identify.prior import (
    BodyPrior,
    EffectPrior,
    base_prior,
    prior_parameters,
)
from excitant.identify.recording import Recording, Recordings, recordings_of
from excitant.identify.regression import regression_of
from excitant.identify.rows import effects_of, fit_rows, split
from excitant.robots.base_parameters import BaseParameters, base_parameters
from excitant.robots.effects import Effect
from excitant.robots.motion import Array
from excitant.robots.parameters import STANDARD, UNITS
from excitant.robots.robot import Robot
from excitant.robots.threads import on_one_thread

EXPECTED_SHARE = 0.05  # of the arm's mass: mass of the payload expected
EXPECTED_RADIUS = 0.1  # of gyration about each axis, of the payload expected [m]
OPEN_STD = 100.0  # relative std of that expectation: nothing is known of it
MASS_GOAL = 0.02  # relative uncertainty of the mass that suffices
CENTRE_GOAL = 0.003  # uncertainty of the centre of mass that suffices [m]
SEEN_STDS = 3.0  # of the mass: some is always found, for no body has less than none
CONFIDENCE_STDS = 2.0  # of an uncertainty as it is reported
MODEL_ERROR = 0.01  # relative std of a given model that says nothing of its own
_CURRENT = (
    "torque was recorded as current: a gain that is wrong by 1 % makes mass, first moments and "
    "inertia wrong by 1 %, which no current shows; weigh one load to fix it (the centre of mass "
    "does not depend on the gain)"
)


@dataclass(frozen=True, eq=False)
class PayloadEstimate:
    """A body on the last link, about the frame of its joint."""

    link: str  # that carries it
    fit: PhysicalFit  # of its standard parameters
    notes: tuple[str, ...] = ()
    # relative, of the scale of drive gains on which its mass rests
    scale_std: float = 0.0
    # time [s] and estimate on the way
    history: tuple[tuple[float, PayloadEstimate], ...] = ()

    @property
    def phi(self) -> Array:
        """Standard parameters, shape (10,)."""
        return self.fit.x

    @property
    def mass(self) -> float:
        """Mass [kg]."""
        return float(self.phi[0])

    @property
    def centre(self) -> Array:
        """Centre of mass in the joint frame, shape (3,) [m]."""
        return centre_of_mass(self.phi, self.fit.covariance)[0]

    @property
    def centre_std(self) -> Array:
        """Standard deviation of the centre of mass, shape (3,) [m]."""
        return centre_of_mass(self.phi, self.fit.covariance)[1]

    @property
    def std(self) -> Array:
        """Standard deviations of the ten parameters."""
        alone = np.sqrt(np.diag(self.fit.covariance))
        return np.hypot(alone, self.scale_std * self.phi)

    @property
    def shortcomings(self) -> tuple[str, ...]:
        """Reason for uncertainty above 2 % or 3 mm at 95 % confidence; empty below."""
        interval = CONFIDENCE_STDS * self.std[0]
        centre = CONFIDENCE_STDS * self.centre_std
        if self.mass < SEEN_STDS * self.std[0]:
            return (
                f"no payload is seen: {self.mass:.2g} kg, give or take {interval:.2g} kg",
            )
        reasons = []
        if interval > MASS_GOAL * self.mass:
            reasons.append(
                f"mass {self.mass:.4g} kg is known to ±{interval:.2g} kg only: "
                + (
                    "weigh one load, from which the drive gains follow (--payload-recording)"
                    if 2 * (CONFIDENCE_STDS * self.scale_std * self.mass) ** 2
                    > interval**2
                    else "lift it through more poses, move slower or longer"
                )
            )
        if centre.max() > CENTRE_GOAL:
            worst = np.argmax(centre)
            off = float(f"{1e3 * centre.max():.2g}")
            reasons.append(
                f"centre of mass along {'xyz'[worst]} is known to ±{off:g} mm only: turn the last "
                "joints through more orientations"
            )
        return tuple(reasons)

    def result(self) -> dict[str, Any]:
        """Entries of result.json."""
        parameters = {
            "name": STANDARD,
            "value": self.phi.tolist(),
            "std": self.std.tolist(),
            "unit": UNITS,
            "prior_dominated": (self.fit.prior_share > 0.5).tolist(),
        }
        rows = zip(*parameters.values(), strict=True)
        history = {"t": [t for t, _ in self.history]}
        for key in ("mass", "centre", "centre_std"):
            history[key] = [
                np.asarray(getattr(each, key)).tolist() for _, each in self.history
            ]
        history["mass_std"] = [float(each.std[0]) for _, each in self.history]
        return {
            "link": self.link,
            "mass": {"value": self.mass, "std": float(self.std[0]), "unit": "kg"},
            "centre_of_mass": {
                "value": self.centre.tolist(),
                "std": self.centre_std.tolist(),
                "unit": "m",
            },
            "parameters": [dict(zip(parameters, row, strict=True)) for row in rows],
            "shortcomings": list(self.shortcomings),
            "notes": list(self.notes),
            **({"history": history} if self.history else {}),
        }


class PayloadEstimator:
    """Payload inside a control loop: `push` each sample, `estimate` beside the loop.

    A sample costs what it costs an `OnlineEstimator`, an estimate some milliseconds.

    Args:
        robot: The unloaded arm; as identified, it keeps its estimate.
        rate_hz: Rate of the samples.
        effects: Effects of the arm; as in `identify_payload` when None.
        options: Of the `OnlineEstimator`, as ``forgetting``, the time constant [s] within which a
            load that is picked up or set down shows.

    Raises:
        BadInput: Options that do not fit, or an effect that depends on the past.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        rate_hz: float,
        effects: Sequence[Effect] | None = None,
        **options: Any,
    ) -> None:
        effects = _own_effects(robot, effects)
        self.arm = OnlineEstimator(
            robot, effects, rate_hz=rate_hz, prior=False, **options
        )
        self._known, _ = _given_arm(robot, effects, self.arm.base)

    def push(self, t: float, q: Array, tau: Array, dq: Array | None = None) -> None:
        """Take one sample, shapes (nv,), as `OnlineEstimator.push`."""
        self.arm.push(t, q, tau, dq)

    def estimate(self) -> PayloadEstimate:
        """The payload by all samples so far; refuses before the first row."""
        known = self.arm.estimate().data
        return estimate_payload(self.arm.robot, self.arm.base, known, self._known)


def _own_effects(
    robot: Robot, effects: Sequence[Effect] | None
) -> tuple[Effect, ...]:
    if effects is None and robot.estimate is not None:
        return robot.effects
    return effects_of(robot, effects)


def _given_arm(
    robot: Robot, effects: Sequence[Effect], base: BaseParameters
) -> tuple[Information, str]:
    """What a model says of the unloaded arm, and how sure it is taken to be, as a sentence."""
    if (estimate := robot.estimate) is not None:
        if estimate.names != base.leading:
            raise BadInput(
                f"payload: {robot.name} was identified with other effects "
                f"({', '.join(effect.name for effect in robot.effects)}) or another geometry; "
                "leave --effects out, or record the arm without load (--unloaded)"
            )
        return gaussian(estimate.value, estimate.covariance), (
            "the given model stands for the unloaded arm, as sure as its covariance says"
        )
    prior = base_prior(robot, effects, base)
    return gaussian(prior.mean, MODEL_ERROR**2 * prior.covariance), (
        f"the given model stands for the unloaded arm, taken to be right to "
        f"{100 * MODEL_ERROR:g} %; record the arm without load (--unloaded), or give an "
        "identified model.yaml, which keeps its estimate, to know better"
    )


@on_one_thread
def identify_payload(
    robot: Robot,
    loaded: Recordings,
    *,
    unloaded: Recordings = (),
    effects: Sequence[Effect] | None = None,
    forgetting: float | None = None,
    over_time: bool = False,
) -> PayloadEstimate:
    """Payload of the arm in some recordings.

    Args:
        robot: The arm; without unloaded recordings it stands for the unloaded one, as sure as
            its covariance says where it was identified.
        loaded: The arm with the payload.
        unloaded: The same arm without it, any motion.
        effects: Effects of the arm; those of an identified robot when None, else friction,
            offset and rotor inertia.
        forgetting: Time constant of forgetting what is loaded [s]; nothing is forgotten when None.
        over_time: Also the estimates on the way, every half second.

    Raises:
        BadInput: Currents of a loaded arm with nothing to compare them with.
        BadRecording: Recordings that cannot be used.
    """
    loaded = recordings_of(loaded, robot)
    unloaded = recordings_of(unloaded, robot)
    effects = _own_effects(robot, effects)
    base = base_parameters(robot, effects)
    unit = loaded[0].unit
    drive = loaded[0].drive
    if not unloaded and unit == "A":
        raise BadInput(
            f"payload: {loaded[0].file} has currents, whose gain the load would be taken for; "
            "name recordings without load (--unloaded)"
        )
    if any(each.unit != unit for each in (*loaded, *unloaded)):
        raise BadInput(
            "payload: recordings in N·m and in A; use recordings of one unit"
        )
    if unit == "A":
        halves = split(unloaded)
        whole = replace(halves, train=(*halves.train, *halves.validate))
        drive = fit_rows(robot, effects, base, whole).drive
    gains = drive.gains if drive is not None and unit == "A" else np.ones(robot.nv)
    replay: dict[str, Any] = {"gains": gains, "prior": False}
    if unloaded:
        estimator, samples, _ = replayable(robot, unloaded, effects, base, **replay)
        estimator.extend(*samples)
        known = estimator.estimate().data
        note = "the unloaded arm was recorded"
    else:
        known, note = _given_arm(robot, effects, base)
    replay["forgetting"] = forgetting
    estimator, samples, _ = replayable(robot, loaded, effects, base, **replay)
    scale = 0.0 if drive is None else drive.scale_std
    history = list[tuple[float, PayloadEstimate]]()

    def found() -> PayloadEstimate:
        body = estimate_payload(robot, base, estimator.estimate().data, known)
        return replace(body, scale_std=scale)

    due = samples[0][0] + PERIOD
    for t, q, tau in zip(*samples, strict=True):
        estimator.push(float(t), q, tau)
        if over_time and t >= due and estimator.rows:
            history.append((float(t), found()))
            due = t + PERIOD
    notes = (note, *([_CURRENT] if unit == "A" else []))
    return replace(found(), notes=notes, history=tuple(history))


def estimate_payload(
    robot: Robot, base: BaseParameters, loaded: Information, arm: Information
) -> PayloadEstimate:
    """The body between data of the loaded arm alone and what is known of the unloaded one.

    Raises:
        BadInput: Information about other parameters than the base parameters.
    """
    about = payload_information(robot, base, loaded, arm)
    # a ball at the flange with a twentieth of the arm's mass
    mass = EXPECTED_SHARE * float(prior_parameters(robot)[:, 0].sum())
    tip = list(robot.model.frames)[robot.tip].placement.translation
    ball = pin.Inertia(
        mass, tip, 2 * mass * EXPECTED_RADIUS**2 * np.eye(3)
    ).toDynamicParameters()
    nothing = EffectPrior(np.zeros(0), np.zeros(0), np.zeros(0))
    fit = fit_physical(about.R, about.z, BodyPrior(ball[None], OPEN_STD), nothing)
    return PayloadEstimate(robot.links[-1], fit)


def payload_information(
    robot: Robot, base: BaseParameters, loaded: Information, arm: Information
) -> Information:
    """Information of two states of an arm on the body between them, shape (10, 10)."""
    r = len(base)
    for part in (loaded, arm):
        if part.R.shape != (r, r):
            raise BadInput(
                f"payload: information about {part.R.shape[0]} parameters, the arm has {r} base "
                "parameters; use one set of effects for both"
            )
    K = _body(robot, base)
    A = np.block([[loaded.R, loaded.R @ K], [arm.R, np.zeros((r, 10))]])
    joint = information_of(A, np.concatenate([loaded.z, arm.z]))
    return Information(joint.R[r:, r:], joint.z[r:], joint.rest)


def _body(robot: Robot, base: BaseParameters) -> Array:
    return base.regrouping[:, 10 * (robot.nv - 1) : 10 * robot.nv]


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
    """Drive gains of an arm from motor currents without and with (``loaded``) a payload.

    Its masses are of no account. The other arguments are those of `identify_robot`.

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
    effects = effects_of(robot, effects)
    base = base_parameters(robot, effects)
    free = split(recordings, validate, cutoff_hz)
    carrying = split(loaded, loaded, free.cutoff_hz)
    unloaded, with_payload = (
        regression_of(robot, effects, data.train).select(base.columns)
        for data in (free, carrying)
    )
    return payload_gains(unloaded, with_payload, payload, _body(robot, base))
