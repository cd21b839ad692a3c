"""A recording played through the on-line estimator, watched on the way: `identify --online`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from excitant.identify.estimate import Estimate, judged
from excitant.identify.excitation import (
    ROWS_PER_SECOND,
    WindowExcitation,
    excitation_judge,
)
from excitant.identify.least_squares import LeastSquares
from excitant.identify.online import OnlineEstimate, OnlineEstimator, joined, replayable
from excitant.identify.physical import fit_physical
from excitant.identify.prior import BasePrior, base_prior, prior_parameters, reference_motion
from excitant.identify.recording import Recording
from excitant.identify.rows import fit_rows, fitted, split
from excitant.robots.base_parameters import base_parameters
from excitant.robots.effects import Effect, standard_effects
from excitant.robots.motion import Array
from excitant.robots.robot import Robot
from excitant.robots.torque import observation_columns

WINDOW = 8.0  # s of motion that the monitor looks at
_PERIOD = 0.5  # s between two looks
_KEPT = 100  # looks written to result.json
_REFERENCE = 10.0  # s of reference motion over which the uncertainty of the torque is taken


@dataclass(frozen=True, eq=False)
class Look:
    """What the monitor saw at an instant.

    Attributes:
        estimate: The estimate.
        excitation: What the last seconds showed; None before a whole window.
        uncertainty: Rms torque error that the uncertainty of the estimate makes on a reference
            motion, shape (nv,) [torque unit].
    """

    estimate: OnlineEstimate
    excitation: WindowExcitation | None
    uncertainty: Array

    @property
    def converged(self) -> bool:
        """Whether the estimate is surer of the torque than a row of data is, joint by joint."""
        return bool((self.uncertainty < self.estimate.sigma).all())


class Monitor:
    """Watches an `OnlineEstimator`: convergence, and excitation in a sliding window.

    A look costs some ten milliseconds: once a second, beside the loop rather than inside it.

    Args:
        estimator: The estimator.
        prior: What is known beforehand, to measure excitation against.
        window: Length of the sliding window [s].
    """

    def __init__(
        self, estimator: OnlineEstimator, prior: BasePrior, window: float = WINDOW
    ) -> None:
        self.estimator, self.prior, self.window = estimator, prior, window
        self.messages: list[tuple[float, str]] = []
        self._enough, self._converged = True, False
        robot, base = estimator.robot, estimator.base
        motion = reference_motion(robot, _REFERENCE, ROWS_PER_SECOND)
        columns = observation_columns(robot, estimator.effects, motion)
        self._reference: Array = columns[:, :, base.columns]

    def look(self) -> Look:
        """Look now, and say what has changed.

        Raises:
            BadInput: No row yet.
        """
        estimate = self.estimator.estimate()
        uncertainty = self._uncertainty(estimate.covariance)
        found = Look(estimate, self._excitation(estimate), uncertainty)
        self._tell(found)
        return found

    def _uncertainty(self, P: Array) -> Array:
        if not np.isfinite(P).all():
            return np.full(self.estimator.robot.nv, np.inf)
        W = self._reference
        variance = np.einsum("njr,rs,njs->nj", W, P, W, optimize=True).mean(axis=0)
        return np.asarray(np.sqrt(np.maximum(variance, 0)), float)

    def _excitation(self, estimate: OnlineEstimate) -> WindowExcitation | None:
        e, rows = self.estimator, self.estimator.recent()
        first = np.searchsorted(rows.motion.t, estimate.t - self.window)
        if estimate.t - rows.motion.t[0] < self.window - 2 * e.row_period:
            return None
        independent = estimate.inflation * ROWS_PER_SECOND * e.row_period
        sigma = estimate.sigma * np.sqrt(np.maximum(independent, 1e-12))
        judge = excitation_judge(
            e.robot, e.effects, window=self.window, sigma=sigma, base=e.base, prior=self.prior
        )
        late = slice(int(first), None)
        W = judge.rows(rows.W[late] * rows.used[late, :, None])
        return judge.judge(rows.motion[late], W)

    def _tell(self, found: Look) -> None:
        t, seen = found.estimate.t, found.excitation
        if found.converged != self._converged:
            self._converged = found.converged
            words = "converged: the estimate is surer of the torque than a row of data"
            self.messages.append((t, words if found.converged else "no longer converged"))
        if seen is not None and seen.enough != self._enough:
            self._enough = seen.enough
            self.messages.append((t, seen.sentence()))


@dataclass(frozen=True, eq=False)
class OnlineIdentification:
    """What was identified on line, judged as an estimate from the whole recording is.

    Attributes:
        estimate: Physically consistent model and its accuracy.
        looks: The monitor's looks on the way, the last at the end.
        messages: Time [s] and text.
        delay: Age of the newest instant that the estimator can speak about [s].
        differentiator: Why which differentiator was taken.
    """

    estimate: Estimate
    looks: tuple[Look, ...]
    messages: tuple[tuple[float, str], ...]
    delay: float
    differentiator: str

    def result(self) -> dict[str, Any]:
        """Machine-readable result: that of `identify`, and the way there under ``online``."""
        looks = list(self.looks[:: max(1, -(-len(self.looks) // _KEPT))])
        if looks[-1] is not self.looks[-1]:
            looks.append(self.looks[-1])
        return self.estimate.result() | {
            "estimator": "recursive least squares in square-root information form, on line; "
            "then physically consistent semidefinite fit",
            "online": {
                "delay_s": self.delay,
                "differentiator": self.differentiator,
                "messages": [{"t": float(t), "text": text} for t, text in self.messages],
                "converged": looks[-1].converged,
                "history": {
                    "t": [look.estimate.t for look in looks],
                    "value": [look.estimate.beta.tolist() for look in looks],
                    "std": [look.estimate.std.tolist() for look in looks],
                    "excitation_level": [
                        None if look.excitation is None else look.excitation.level for look in looks
                    ],
                    "torque_uncertainty": [look.uncertainty.tolist() for look in looks],
                    "noise": [look.estimate.sigma.tolist() for look in looks],
                },
            },
        }

    def series(self) -> dict[str, Array]:
        """For figures: estimates over time, ``online_t`` (k,), values and std (k, r)."""
        looks = [look.estimate for look in self.looks]
        return {
            "online_t": np.array([each.t for each in looks]),
            "online_value": np.array([each.beta for each in looks]),
            "online_std": np.array([each.std for each in looks]),
        }


def identify_online(
    robot: Robot,
    recordings: Sequence[Recording],
    *,
    validate: Sequence[Recording] = (),
    effects: Sequence[Effect] | None = None,
    cutoff_hz: float | None = None,
    forgetting: float | None = None,
    progress: Callable[[float], None] | None = None,
) -> OnlineIdentification:
    """Identify a robot as if the samples came one by one.

    Args:
        robot: The arm; its inertias are the prior.
        recordings: What to fit, one after the other.
        validate: What to judge on; the last 30 % of each recording when empty.
        effects: Effects to estimate; friction, offset and rotor inertia when None.
        cutoff_hz: Cut-off of the torque filter that accuracy is judged under [Hz].
        forgetting: Time constant of forgetting [s]; nothing is forgotten when None.
        progress: Told the fraction done.

    Raises:
        BadRecording: Recordings that cannot be used.
        BadRobot: Links without mass, so no prior.
        Infeasible: The semidefinite solver failed.
    """
    effects = standard_effects(robot.joints) if effects is None else tuple(effects)
    prior = prior_parameters(robot)
    data = split(recordings, validate, cutoff_hz)
    base = base_parameters(robot, effects)
    rows = fit_rows(robot, effects, base, data)
    recording = joined(fitted(recordings, validate))
    estimator, samples, why = replayable(
        robot, recording, effects, base, gains=rows.gains, forgetting=forgetting
    )
    monitor, looks = Monitor(estimator, base_prior(robot, effects, base)), []
    due = samples[0][0] + 1.0
    for k, (t, q, tau) in enumerate(zip(*samples, strict=True)):
        estimator.push(float(t), q, tau)
        if t >= due and estimator.rows:
            looks.append(monitor.look())
            due = t + _PERIOD
            if progress is not None:
                progress(k / len(samples[0]))
    if not looks or looks[-1].estimate.t < estimator.recent().motion.t[-1]:
        looks.append(monitor.look())
    last = looks[-1].estimate
    known = last.data
    physical = fit_physical(known.R @ base.regrouping, known.z, prior, rows.open_prior)
    fit = LeastSquares(last.beta, last.covariance, last.sigma, last.inflation)
    estimate = judged(robot, rows, fit, physical, (data.holdout, why))
    return OnlineIdentification(
        estimate, tuple(looks), tuple(monitor.messages), estimator.delay, why
    )
