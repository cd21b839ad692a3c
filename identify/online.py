"""On-line estimation: recursive least squares in square-root information form, and its monitor.

A causal local polynomial gives velocity and acceleration in the middle of its window; the torque
of that same instant is taken (matched delays), and the mean over a block of K samples is the
filter that every column and the torque pass alike. One row per joint and block updates that
joint's own triangle. Joints are weighted only when an estimate is asked for, so noise levels are
learnt without touching the past, and the result is weighted least squares on all rows. Forgetting
weighs a row of age a by exp(−a / τ); what was known beforehand is never forgotten, so where a
motion shows nothing the estimate falls back to the prior.
"""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
import pinocchio as pin

from excitant.exceptions import BadInput, BadRecording
from excitant.identify.accuracy import torque_std
from excitant.identify.differentiators import (
    LocalPolynomial,
    causal_polynomial,
    position_spectrum,
)
from excitant.identify.estimate import Estimate, estimate_by
from excitant.identify.excitation import (
    ROWS_PER_SECOND,
    WindowExcitation,
    excitation,
)
from excitant.identify.information import (
    TOGETHER,
    Information,
    InformationFilter,
    combined,
)
from excitant.identify.least_squares import LeastSquares, autocorrelation_time
from excitant.identify.preprocessing import dry_joints, resampled, uninterrupted
from excitant.identify.prior import (
    BasePrior,
    base_prior,
    reference_motion,
)
from excitant.identify.recording import Recording, Recordings, recordings_of
from excitant.identify.rows import effects_of, fit_rows, fitted, places_of, split
from excitant.robots.base_parameters import BaseParameters, base_parameters
from excitant.robots.effects import Effect
from excitant.robots.effects.base import Law
from excitant.robots.motion import (
    Array,
    Indices,
    Mask,
    Motion,
    numbered,
    root_mean_square,
)
from excitant.robots.robot import Robot
from excitant.robots.threads import on_one_thread
from excitant.robots.torque import observation_columns

HALF_WINDOW_S = 0.03  # of the differentiator that serves when none is given
BLOCK_S = 0.01  # over which rows are averaged when no block is given
RECENT_S = 10.0  # of rows that are kept to judge residuals and excitation
STEP_STDS = 3.0  # of position noise, above which the sign of a step is certain
CORNERS = 5  # positions within the window between which a joint must go one way
POSITION_ROUNDING = 1e-12  # least noise of positions [rad]
NOISE_ROUNDS = 4  # of re-estimating the noise of each joint
LONGEST_STEP = 2.5  # samples, after which the window fills anew
PAUSE_S = 1.0  # between recordings that follow each other
FEWEST_SAMPLES = 5  # without a gap, of a part that is used
RANDOM_STATES = 100  # that show which columns act on which joint
MONITOR_WINDOW_S = 8.0  # of motion that the monitor judges
PERIOD = 0.5  # between two looks of the monitor [s]
REFERENCE_S = 10.0
"""Of reference motion, over which the uncertainty of torque is taken."""


@dataclass(frozen=True, eq=False)
class OnlineEstimate(LeastSquares):
    """Estimate at an instant; inflation is that of recent residuals."""

    t: float  # instant of the estimate: the newest block [s]
    data: Information  # what the data alone say, rows of unit noise


class RecentRows(NamedTuple):
    """Recent rows: state in the middle of each of n blocks, W (n, nv, r), τ and which count."""

    motion: Motion
    W: Array
    tau: Array
    used: Mask


class OnlineEstimator:
    """Recursive estimation of base parameters inside a control loop: `push`, then `estimate`.

    Args:
        effects: Effects to estimate; friction, offset and rotor inertia when None.
        differentiator: The polynomial; 61 samples of degree 4 at 1 kHz when None.
        block: Samples per row; 10 ms when None.
        forgetting: Time constant τ [s]; nothing is forgotten when None.
        sigma: Noise of a row of each joint, shape (nv,) [torque unit]; learnt when None.
        prior: What is known beforehand; the given robot when None, ``False`` for nothing.
        position_noise: Of the encoders, shape (nv,) [rad]: a joint that does not go one way all
            through the window gives no row, because its dry friction could be anything.

    Raises:
        BadInput: Options that do not fit, or an effect that depends on the past.
    """

    def __init__(
        self,
        robot: Robot,
        effects: Sequence[Effect] | None = None,
        *,
        rate_hz: float,
        differentiator: LocalPolynomial | None = None,
        block: int | None = None,
        forgetting: float | None = None,
        sigma: Array | None = None,
        prior: BasePrior | Literal[False] | None = None,
        position_noise: Array | float = 0.0,
        base: BaseParameters | None = None,
    ) -> None:
        self.robot = robot
        self.rate_hz = rate_hz
        self.rows = 0
        self.effects = effects_of(robot, effects)
        self.base = base_parameters(robot, self.effects) if base is None else base
        half = max(2, round(HALF_WINDOW_S * rate_hz))
        self.differentiator = differentiator or LocalPolynomial(
            half, min(4, 2 * half)
        )
        self.block = max(1, round(BLOCK_S * rate_hz)) if block is None else block
        if self.block < 1:
            raise BadInput(
                f"on-line estimation: a block of {self.block} samples; give at least 1"
            )
        if forgetting is not None and not forgetting > self.row_period:
            raise BadInput(
                f"on-line estimation: forgetting within {forgetting:g} s, but a row takes "
                f"{self.row_period:g} s; give a longer time constant"
            )
        if prior is None:
            prior = base_prior(robot, self.effects, self.base)
        self.prior = prior.information() if prior else None
        self._sigma = None if sigma is None else np.array(sigma, float)
        self._last_sigma: Array | None = None
        self._fade = (
            1.0 if forgetting is None else np.exp(-self.row_period / forgetting)
        )
        noise = np.broadcast_to(
            np.maximum(position_noise, POSITION_ROUNDING), (robot.nv,)
        )
        self._still = STEP_STDS * np.sqrt(2) * noise
        self._dry = dry_joints(self.effects, robot.joints)
        acting = _acting_columns(robot, self.effects, self.base)
        self._filters = [
            InformationFilter(columns, len(self.base)) for columns in acting
        ]
        self._weight = np.zeros(robot.nv)
        self._kernels = np.array(
            [self.differentiator.kernel(k) * rate_hz**k for k in range(3)]
        )
        # samples that a row depends on
        self.span = self._kernels.shape[1] + self.block - 1
        self._samples = np.zeros((self.span, 3 * robot.nv))
        self._filled = 0
        self._corners = np.linspace(-self.span, -1, CORNERS).astype(int)
        self._clock = -np.inf
        self._turn = 0
        self._data = robot.model.createData()
        # of the instants of a block so far: how many, states, sums of columns and torque
        self._count = 0
        self._start = 0.0
        self._states = np.zeros((self.block, 3, robot.nv))
        self._sort_effects()
        most = max(64, round(RECENT_S / self.row_period))
        self._recent: deque[tuple[float, Array, Array, Mask]] = deque(maxlen=most)

    def _sort_effects(self) -> None:
        """Sort effects by what they depend on: a joint's own state at an instant, or more."""
        places = list[Array]()
        self._laws = list[tuple[Law, Any]]()
        self._others = list[tuple[Effect, slice]]()
        for effect, own in places_of(self.robot, self.effects):
            if effect.law is None:
                self._others.append((effect, own))
            else:  # terms of one joint after those of another
                rows = effect.rows(self.robot)
                columns = np.arange(own.start, own.stop)
                of_joints = columns.reshape(len(effect.joints), -1)
                all_joints = rows == list(range(self.robot.nv))
                self._laws.append(
                    (effect.law, slice(None) if all_joints else np.array(rows))
                )
                places += [np.array([rows, k]) for k in of_joints.T]
        end = len(self.base.names)
        self._picked = np.array([*self.base.columns, end])
        self._row = np.zeros((self.robot.nv, end + 1))
        self._Y = np.zeros((self.robot.nv, 10 * self.robot.nv))
        self._tau = np.zeros(self.robot.nv)
        self._places = (
            np.concatenate(places, axis=1) if places else np.zeros((2, 0), int)
        )
        self._terms = np.zeros(self._places.shape[1])
        self._each = np.split(
            self._terms, np.cumsum([place.shape[1] for place in places])[:-1]
        )

    @property
    def row_period(self) -> float:
        """Time between rows [s]."""
        return self.block / self.rate_hz

    @property
    def delay(self) -> float:
        """Age of the newest instant that can be estimated [s]."""
        return self.differentiator.delay(self.rate_hz)

    def push(self, t: float, q: Array, tau: Array, dq: Array | None = None) -> None:
        """Take one sample, shapes (nv,); after a pause of two samples the window fills anew.

        Measured velocities dq, where all samples of a window have them, give velocity and
        acceleration in place of the positions.

        Raises:
            BadInput: Time that goes back, or a value that is not a number.
        """
        if not t > self._clock:
            raise BadInput(
                f"on-line estimation: time {t:g} s after {self._clock:g} s goes back"
            )
        if (t - self._clock) * self.rate_hz > LONGEST_STEP:
            self._filled = 0
            self._count = 0
        self._clock = t
        nv = self.robot.nv
        width = self._kernels.shape[1]
        self._samples[:-1] = self._samples[1:]
        self._samples[-1, :nv] = q
        self._samples[-1, nv : 2 * nv] = tau
        self._samples[-1, 2 * nv :] = np.nan if dq is None else dq
        self._filled += 1
        if self._filled >= width:
            self._take_instant(t - self.delay, self._samples[-width:])
        if self._count == self.block:
            self._finish_block()
        else:  # one joint at a time, so that no sample takes long
            grown = self._filters[self._turn]
            self._turn = (self._turn + 1) % nv
            if grown.waiting >= TOGETHER:
                grown.take()

    def extend(
        self, t: Array, q: Array, tau: Array, dq: Array | None = None
    ) -> None:
        """Take many samples, shapes (n,) and (n, nv)."""
        for k in range(len(t)):
            self.push(float(t[k]), q[k], tau[k], None if dq is None else dq[k])

    def _take_instant(self, t: float, window: Array) -> None:
        k = self._count
        nv = self.robot.nv
        if k == 0:
            self._start = t
            self._Y[:] = 0.0
            self._tau[:] = 0.0
            self._terms[:] = 0.0
        states = self._states[k]
        speeds = window[:, 2 * nv :]
        if np.isfinite(speeds).all():
            states[0] = self._kernels[0] @ window[:, :nv]
            states[1:] = self._kernels[:2] @ speeds
        else:
            states[:] = self._kernels @ window[:, :nv]
        q, dq, ddq = states
        self._Y += pin.computeJointTorqueRegressor(
            self.robot.model, self._data, q, dq, ddq
        )
        self._tau += window[len(window) // 2, nv : 2 * nv]
        sums = iter(self._each)
        for law, own in self._laws:
            for values in law(q[own], dq[own], ddq[own]):
                total = next(sums)
                total += values
        self._count = k + 1

    def _finish_block(self) -> None:
        row = self._row
        motion = None
        self._count = 0
        row[:, : 10 * self.robot.nv] = self._Y
        row[:, -1] = self._tau
        row[*self._places] = self._terms
        for effect, own in self._others:
            t = self._start + np.arange(self.block) / self.rate_hz
            motion = motion or Motion(t, *self._states.transpose(1, 0, 2))
            row[:, own] = effect.columns(self.robot, motion).sum(axis=0)
        rows = row[:, self._picked] / self.block
        if not np.isfinite(rows).all():
            raise BadInput(
                f"on-line estimation: a value before {self._clock:g} s is not a number"
            )
        used = self._goes_one_way() | ~self._dry
        self._weight = self._fade * self._weight + used
        for row, counts, grown in zip(rows, used, self._filters, strict=True):
            if self._fade < 1:
                grown.forget(self._fade)
            if counts:
                grown.add(row)
        middle = (self._start + self._clock - self.delay) / 2
        self._recent.append(
            (middle, self._states[self.block // 2].copy(), rows, used)
        )
        self.rows += 1

    def _goes_one_way(self) -> Mask:
        steps = np.diff(self._samples[self._corners, : self.robot.nv], axis=0)
        return (steps.min(axis=0) > self._still) | (
            steps.max(axis=0) < -self._still
        )

    def recent(self) -> RecentRows:
        """Rows of the last ten seconds; refuses when there are none yet."""
        if not self._recent:
            raise BadInput("on-line estimation: no row yet; push more samples")
        columns = zip(*self._recent, strict=True)
        t, middles, rows, used = (np.array(column) for column in columns)
        motion = Motion(t, *middles.transpose(1, 0, 2))
        return RecentRows(motion, rows[:, :, :-1], rows[:, :, -1], used)

    def estimate(self) -> OnlineEstimate:
        """Current estimate; refuses before the first row."""
        rows = self.recent()
        parts = [joint.information() for joint in self._filters]
        sigma, beta = self._noise(parts)
        residual = rows.tau - rows.W @ beta
        counted = [e[used] for e, used in zip(residual.T, rows.used.T, strict=True)]
        inflation = np.array(
            [autocorrelation_time(e) if len(e) > 20 else 1.0 for e in counted]
        )
        data, total = self._total(parts, sigma * np.sqrt(inflation))
        covariance = np.full(total.R.shape, np.inf)
        if np.abs(np.diag(total.R)).min() > 0:
            covariance = total.covariance()
        t = float(rows.motion.t[-1])
        return OnlineEstimate(total.solve(), covariance, sigma, inflation, t, data)

    def _total(
        self, parts: list[Information], sigma: Array
    ) -> tuple[Information, Information]:
        data = combined(
            [part.scaled(1 / s) for part, s in zip(parts, sigma, strict=True)]
        )
        return data, data if self.prior is None else combined([data, self.prior])

    def _noise(self, parts: list[Information]) -> tuple[Array, Array]:
        """Noise of each joint and the estimate under it, by turns until they agree.

        Its squares are shared by the rows of the joint less what the fit took out of them; a joint
        whose rows the fit can follow all is taken to be as uncertain as its torque is large.
        """
        if self._sigma is not None:
            return self._sigma, self._total(parts, self._sigma)[1].solve()
        count = np.maximum(self._weight, 1.0)
        torque = np.sqrt([p.squares(np.zeros(len(p.z))) for p in parts]) / np.sqrt(
            count
        )
        floor = 1e-9 * torque + 1e-12  # data without noise
        rest = np.array([part.rest for part in parts])
        sigma = (
            np.sqrt(rest / count) if self._last_sigma is None else self._last_sigma
        )
        for _ in range(NOISE_ROUNDS):
            sigma = np.maximum(sigma, floor)
            total = self._total(parts, sigma)[1]
            beta = total.solve()
            half = np.linalg.pinv(total.R, rcond=1e-12)
            squares = np.array([part.squares(beta) for part in parts])
            taken = (
                np.array([np.sum((part.R @ half) ** 2) for part in parts])
                / sigma**2
            )
            freedom = count - taken
            sigma = np.where(
                freedom >= 1, np.sqrt(squares / np.maximum(freedom, 1.0)), torque
            )
        sigma = np.maximum(sigma, floor)
        self._last_sigma = sigma
        return sigma, beta


def _acting_columns(
    robot: Robot, effects: Sequence[Effect], base: BaseParameters
) -> list[Indices]:
    """Base columns that can act on each joint; refuses effects that depend on the past."""
    rng = np.random.default_rng(1)
    states = robot.random_motion(rng, RANDOM_STATES)
    order = rng.permutation(RANDOM_STATES)
    motion = numbered(*states)
    shuffled = numbered(*(x[order] for x in states))
    for effect in effects:
        plain = effect.columns(robot, motion)
        if not np.allclose(plain[order], effect.columns(robot, shuffled)):
            raise BadInput(
                f"on-line estimation: {effect.name} depends on the past motion; leave it out, "
                "or identify off line"
            )
    W = observation_columns(robot, effects, motion)[:, :, base.columns]
    return [np.flatnonzero(row) for row in np.abs(W).max(axis=0) > 0]


def replayable(
    robot: Robot,
    recordings: Sequence[Recording],
    effects: tuple[Effect, ...],
    base: BaseParameters,
    *,
    gains: Array,
    forgetting: float | None = None,
    prior: BasePrior | Literal[False] | None = None,
) -> tuple[OnlineEstimator, tuple[Array, Array, Array], str]:
    """An estimator for recordings, their samples at a regular rate, and why these velocities.

    Recordings follow each other a second apart; where time is irregular they are resampled, gaps
    stay. Gains are torque per reading, shape (nv,).

    Raises:
        BadRecording: Too short for one row.
    """
    times = []
    end = recordings[0].t[0]
    for each in recordings:
        times.append(each.t - each.t[0] + end)
        end = times[-1][-1] + PAUSE_S
    file = recordings[0].file
    q, tau = (
        np.concatenate([getattr(r, name) for r in recordings])
        for name in ("q", "tau")
    )
    recording = Recording(file, file, np.concatenate(times), q, tau)
    parts = [
        part
        for part in uninterrupted(recording.t, q)
        if len(part) >= FEWEST_SAMPLES
    ]
    if not parts:
        raise BadRecording(file, "no five samples without a gap", column="t")
    pieces = zip(*(resampled(recording, part)[:3] for part in parts), strict=True)
    t, q, tau = (np.concatenate(piece) for piece in pieces)
    longest = max(uninterrupted(t, q), key=len)
    spectrum = position_spectrum(t[longest], q[longest])
    choice = causal_polynomial(spectrum)
    estimator = OnlineEstimator(
        robot,
        effects,
        rate_hz=1 / float(np.median(np.diff(t))),
        differentiator=choice.differentiator,
        forgetting=forgetting,
        prior=prior,
        position_noise=spectrum.noise,
        base=base,
    )
    if len(longest) < estimator.span:
        raise BadRecording(
            file, "too short or interrupted too often for on-line rows"
        )
    return estimator, (t, q, tau * gains), choice.why


@dataclass(frozen=True, eq=False)
class Look:
    """Reading of the monitor at an instant."""

    estimate: OnlineEstimate
    # of the last seconds; None before a whole window
    excitation: WindowExcitation | None
    # of torque on a reference motion, rms, shape (nv,) [torque unit]
    uncertainty: Array

    @property
    def converged(self) -> bool:
        """Whether the estimate is surer of the torque than a row of data is, joint by joint."""
        return bool((self.uncertainty < self.estimate.sigma).all())


class Monitor:
    """Watches an `OnlineEstimator`: convergence, and excitation in a sliding window.

    A look costs some ten milliseconds: once a second, beside the loop rather than inside it. The
    window is in seconds; excitation is measured against the prior.
    """

    def __init__(
        self,
        estimator: OnlineEstimator,
        prior: BasePrior,
        window: float = MONITOR_WINDOW_S,
    ) -> None:
        self.estimator = estimator
        self.prior = prior
        self.window = window
        # what changed from look to look, time [s]
        self.messages: list[tuple[float, str]] = []
        self._enough = True
        self._converged = False
        motion = reference_motion(estimator.robot, REFERENCE_S, ROWS_PER_SECOND)
        columns = observation_columns(estimator.robot, estimator.effects, motion)
        self._reference: Array = columns[:, :, estimator.base.columns]

    def look(self) -> Look:
        """Look now, and say what has changed; refuses before the first row."""
        estimate = self.estimator.estimate()
        uncertainty = np.full(self.estimator.robot.nv, np.inf)
        if np.isfinite(estimate.covariance).all():
            std = torque_std(self._reference, estimate.covariance)
            uncertainty = root_mean_square(std)
        window = self._excitation(estimate)
        look = Look(estimate, window, uncertainty)
        if look.converged != self._converged:
            self._converged = look.converged
            text = "no longer converged"
            if look.converged:
                text = "converged: the estimate is surer of the torque than a row of data"
            self.messages.append((estimate.t, text))
        if window is not None and window.enough != self._enough:
            self._enough = window.enough
            self.messages.append((estimate.t, window.sentence))
        return look

    def _excitation(self, estimate: OnlineEstimate) -> WindowExcitation | None:
        e = self.estimator
        rows = self.estimator.recent()
        if estimate.t - rows.motion.t[0] < self.window - 2 * e.row_period:
            return None
        independent = estimate.inflation * ROWS_PER_SECOND * e.row_period
        sigma = estimate.sigma * np.sqrt(np.maximum(independent, 1e-12))
        first = np.searchsorted(rows.motion.t, estimate.t - self.window)
        late = slice(first, None)
        W = rows.W[late] * rows.used[late, :, None]
        motion = rows.motion[late]
        return excitation(e.robot, e.effects, e.base, self.prior, motion, W, sigma)


@dataclass(frozen=True, eq=False)
class OnlineIdentification:
    """Result of online identification, judged as an estimate from the whole recording is."""

    estimate: Estimate
    looks: tuple[Look, ...]  # of the monitor on the way, the last at the end
    messages: tuple[tuple[float, str], ...]  # time [s] and text
    delay: float  # age of the newest instant that can be estimated [s]
    differentiator: str  # why which was taken

    def result(self) -> dict[str, Any]:
        """Machine-readable result: that of `identify`, and the way there under ``online``."""
        return self.estimate.result() | {
            "estimator": "recursive least squares in square-root information form, on line; "
            "then physically consistent semidefinite fit",
            "online": {
                "delay_s": self.delay,
                "differentiator": self.differentiator,
                "messages": [{"t": t, "text": text} for t, text in self.messages],
                "converged": self.looks[-1].converged,
                "history": {
                    "t": [look.estimate.t for look in self.looks],
                    "excitation_level": [
                        x.excitation and x.excitation.level for x in self.looks
                    ],
                },
            },
        }

    def series(self) -> dict[str, Array]:
        """For figures: estimates over time, ``online_t`` (k,), values and std (k, r)."""
        estimates = [look.estimate for look in self.looks]
        return {
            "online_t": np.array([estimate.t for estimate in estimates]),
            "online_value": np.array([estimate.beta for estimate in estimates]),
            "online_std": np.array([estimate.std for estimate in estimates]),
        }


@on_one_thread
def identify_online(
    robot: Robot,
    recordings: Recordings,
    *,
    validate: Recordings = (),
    effects: Sequence[Effect] | None = None,
    cutoff_hz: float | None = None,
    forgetting: float | None = None,
    progress: Callable[[float], None] | None = None,
) -> OnlineIdentification:
    """Identify a robot as if the samples came one by one.

    Args and errors are those of `identify_robot`, and the time constant of forgetting [s] (nothing
    is forgotten when None); ``progress`` is told the fraction done.
    """
    recordings = recordings_of(recordings, robot)
    validate = recordings_of(validate, robot)
    effects = effects_of(robot, effects)
    data = split(recordings, validate, cutoff_hz)
    base = base_parameters(robot, effects)
    rows = fit_rows(robot, effects, base, data)
    estimator, samples, why = replayable(
        robot,
        fitted(recordings, validate),
        effects,
        base,
        gains=rows.gains,
        forgetting=forgetting,
    )
    monitor = Monitor(estimator, base_prior(robot, effects, base))
    looks = list[Look]()
    due = samples[0][0] + 1.0
    for k, (t, q, tau) in enumerate(zip(*samples, strict=True)):
        estimator.push(float(t), q, tau)
        if t >= due and estimator.rows:
            looks.append(monitor.look())
            due = t + PERIOD
            if progress is not None:
                progress(k / len(samples[0]))
    if not looks or looks[-1].estimate.t < estimator.recent().motion.t[-1]:
        looks.append(monitor.look())
    fit = looks[-1].estimate
    whitened = fit.data.R @ base.regrouping, fit.data.z
    estimate = estimate_by(robot, rows, fit, whitened, (data.holdout, why))
    return OnlineIdentification(
        estimate, tuple(looks), tuple(monitor.messages), estimator.delay, why
    )
