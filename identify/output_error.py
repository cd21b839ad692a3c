"""Output error: the regressor on the motion that the model makes, not on the measured one.

Direct and inverse dynamic identification models (Gautier, Janot, Vandanjon 2013): the closed loop
of the model is simulated with the current β, which gives columns W_s(β) of a motion without the
noise of the measured one, and τ ≈ W_s(β) β is solved by weighted least squares for the next. How
the simulated motion depends on β is left out of the derivative, because the controller holds the
motion whatever β is.

They simulate the reference and the controller of the real arm; a recording holds neither. Where the
commanded motion is known, give it as a reference, with the controller if that is known too: then
nothing of the measured positions is used. Else measured positions are the reference, passed up to
the bandwidth of the motion and no further. Noise below it stays in the columns; what reaches the
acceleration falls with the bandwidth to the power 5/2, so that the bias it makes, small as it then
is, is its square.

Base parameters far from the truth may be those of no arm: inertia or friction is negative
somewhere, and no motion comes of it. As the controller holds the motion whatever the parameters
are, the model simulated is then one between the given arm and the estimate.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
import scipy

from excitant.exceptions import BadInput, Infeasible
from excitant.identify.differentiators import low_pass
from excitant.identify.least_squares import LeastSquares, weighted_least_squares
from excitant.identify.preprocessing import Segment
from excitant.identify.prior import prior_parameters
from excitant.identify.recording import Recording
from excitant.identify.regression import Regression, dense, joined
from excitant.identify.rows import FitRows, identified_robot
from excitant.robots.motion import Array, Motion
from excitant.robots.robot import Robot
from excitant.robots.simulation import STEP, Controller, Diverged, simulate
from excitant.robots.torque import observation_columns

Reference = Callable[[Array], Motion]
"""Commanded motion at instants of a recording, shape (n,) [s]."""

_ROUNDS = 15  # of simulating; two to four do
_SETTLED = 1e-2  # of a standard deviation, by which no parameter moves any more
_SAME = 1e-6  # of the rms torque, by which the prediction does not
_WIDER = 2.5  # than the motion: cut-off of the reference, which leaves the motion alone to 1e-3
_HIGHEST = 0.4  # of the sampling rate
_SHARES = (1.0, 0.5, 0.25, 0.1)  # of the way from the given arm to an estimate
_MASS_MOVES = 1e-3  # as easily as other parameters where β leaves a choice
_CAUTION = 2.0  # times the noise, lest the largest of many frequencies pass for motion
_FLOOR = (0.5, 0.9)  # of half the rate: where positions show nothing but the noise of encoders


@dataclass(frozen=True, eq=False)
class OutputError:
    """An output-error estimate and the way to it.

    Attributes:
        fit: The estimate.
        start: The one of weighted least squares that it began with.
        iterations: Simulations that it took.
    """

    fit: LeastSquares
    start: LeastSquares
    iterations: int

    def sentence(self, bandwidth_hz: Array) -> str:
        """What the simulation was told, and what came of it.

        Args:
            bandwidth_hz: Up to where positions were the reference [Hz].
        """
        low, high = bandwidth_hz.min(), bandwidth_hz.max()
        width = f"{low:.3g} Hz" if high - low < 0.1 * low else f"{low:.3g} to {high:.3g} Hz"
        moved = np.abs(self.fit.beta - self.start.beta) / self.fit.std
        return (
            f"the model was simulated on the measured motion up to {width}, as the positions "
            f"themselves suggest; converged after {self.iterations} iterations, which moved "
            f"parameters by up to {moved.max():.2g} standard deviations"
        )


def output_error(problem: Regression, simulated: Callable[[Array], Regression]) -> OutputError:
    """Gauss-Newton on the torque that the model gives on its own simulated motion.

    Args:
        problem: Columns on the reference, to begin with.
        simulated: Columns on the motion that the model with parameters β makes, shape (r,) → p = r.

    Raises:
        Infeasible: It does not converge.
        RankDeficient: The motion does not show some columns.
    """
    start = fit = weighted_least_squares(problem)
    scale = np.maximum(np.sqrt((problem.tau**2).mean(axis=0)), np.finfo(float).tiny)
    for done in range(1, _ROUNDS + 1):
        try:
            now = simulated(fit.beta)
        except Diverged as error:
            raise Infeasible(
                "output error",
                f"no motion of the model after {done - 1} iterations ({error}); "
                "use wls or iv, or a recording that shows all parameters",
            ) from error
        found = weighted_least_squares(now)
        moved = found.beta - fit.beta
        change = float((np.abs(moved) / found.std).max())
        torque = float(np.sqrt(((now.torque(moved) / scale) ** 2).mean()))
        fit = found
        if change < _SETTLED or torque < _SAME:
            return OutputError(fit, start, done)
    raise Infeasible(
        "output error",
        f"parameters still move by {change:.2g} standard deviations after {_ROUNDS} "
        "simulations; give the controller more bandwidth, or use wls or iv",
    )


@dataclass(frozen=True, eq=False)
class ClosedLoop:
    """A regression with the simulation that `output_error` needs.

    Attributes:
        problem: The regression; its columns are those on the reference.
        simulated: The regression on the motion of the model with parameters β.
        bandwidth_hz: Up to where positions are the reference, shape (segments, nv) [Hz];
            infinite where the reference was given.
    """

    problem: Regression
    simulated: Callable[[Array], Regression]
    bandwidth_hz: Array


def closed_loop(
    rows: FitRows,
    recordings: Sequence[Recording],
    *,
    bandwidth_hz: float | None = None,
    references: Sequence[Reference] | None = None,
    controller: Controller | None = None,
    step: float = STEP,
) -> ClosedLoop:
    """The regression of a fit with the simulated loop of each of its segments.

    Args:
        rows: What is fitted; where β leaves parameters open, they stay near the arm's own.
        recordings: Behind these rows, in order.
        bandwidth_hz: Up to where measured positions are the reference [Hz]; found per joint and
            segment when None, as 2.5 times the frequency where noise drowns the acceleration.
        references: The commanded motion of each recording instead.
        controller: Of the loop; one whose feed-forward is that of the current model when None.
        step: Longest step of integration [s].

    Raises:
        BadInput: A bandwidth that the sampling rate does not show, or too few references.
    """
    if references is not None and len(references) != len(recordings):
        raise BadInput(
            f"output error: {len(references)} references for {len(recordings)} recordings; "
            "give one for each"
        )
    loops: list[tuple[Segment, Motion]] = []
    widths = []
    for segment, recording in _with_recordings(rows.data.train, recordings):
        if references is not None:
            command = references[list(recordings).index(recording)](segment.motion.t)
            width = np.full(segment.motion.nv, np.inf)
        else:
            segment, command, width = _measured(segment, recording, bandwidth_hz)
        loops.append((segment, command))
        widths.append(width)

    def regression(robot: Robot, motions: Sequence[Motion]) -> Regression:
        parts = []
        for (segment, _), motion in zip(loops, motions, strict=True):
            columns = observation_columns(robot, rows.effects, motion)[:, :, rows.base.columns]
            tau = segment.tau[segment.keep] * rows.gains
            W = segment.filtered(columns)[segment.keep]
            parts.append(dense(W, tau, rows.base.expressions))
        return joined(parts)

    commands = [command for _, command in loops]
    model_of, loop = _Completion(rows), controller or Controller()

    def simulated(beta: Array) -> Regression:
        for share in _SHARES:
            with suppress(Diverged):
                model = model_of(beta, share)
                motions = [simulate(model, c, loop, step=step).motion for c in commands]
                return regression(rows.robot, motions)
        model = model_of(beta, 0.0)
        return regression(
            rows.robot, [simulate(model, c, loop, step=step).motion for c in commands]
        )

    return ClosedLoop(regression(rows.robot, commands), simulated, np.array(widths))


def _with_recordings(
    segments: Sequence[Segment], recordings: Sequence[Recording]
) -> list[tuple[Segment, Recording]]:
    """Every segment with the recording that it is a part of, both in order."""
    found, left = [], list(segments)
    for recording in recordings:
        last = -np.inf
        while left and left[0].name == recording.name and left[0].motion.t[0] > last:
            last = float(left[0].motion.t[-1])
            found.append((left.pop(0), recording))
    return found


def _measured(
    segment: Segment, recording: Recording, bandwidth_hz: float | None
) -> tuple[Segment, Motion, Array]:
    """Positions up to the bandwidth as reference; rows away from the edges of that filter."""
    rate, t = segment.rate_hz, segment.motion.t
    part = (recording.t >= t[0] - 1e-9) & (recording.t <= t[-1] + 1e-6 + 1 / rate)
    q = scipy.interpolate.make_interp_spline(recording.t[part], recording.q[part], k=3)(t)
    highest = _HIGHEST * rate
    if bandwidth_hz is None:
        width = np.clip(_WIDER * motion_bandwidth(q, rate), 4 * rate / len(q), highest)
    elif 0 < bandwidth_hz <= highest * (1 + 1e-9):
        width = np.full(segment.motion.nv, float(bandwidth_hz))
    else:
        raise BadInput(
            f"output error: a bandwidth of {bandwidth_hz:g} Hz does not fit the rate of "
            f"'{recording.name}', {rate:.4g} Hz; choose one up to {highest:.3g} Hz"
        )
    smooth = np.column_stack([low_pass(q[:, j], float(hz), rate) for j, hz in enumerate(width)])
    spline, keep = scipy.interpolate.make_interp_spline(t, smooth, k=5), segment.keep
    edge = max(keep.start, round(rate / float(width.min())))
    first = keep.start + keep.step * int(np.ceil((edge - keep.start) / keep.step))
    inner = slice(first, min(keep.stop, len(t) - edge), keep.step)
    command = Motion(t, spline(t), spline(t, 1), spline(t, 2))
    return replace(segment, keep=inner), command, width


def motion_bandwidth(q: Array, rate_hz: float) -> Array:
    """Frequency up to which passing positions makes the best acceleration, shape (nv,) [Hz].

    Passing all up to f_b loses the signal above and keeps the noise below it. The expected squared
    error of acceleration, Σ_{f > f_b} (2πf)⁴ (P − N) + Σ_{f ≤ f_b} (2πf)⁴ N, is smallest where
    Σ_{f ≤ f_b} f⁴ (2N − P) is. White noise N of encoders is taken from the upper part of the
    spectrum P, its median there being ln 2 of its mean; it counts twice. The window falls off at
    both ends, so that a motion that does not end where it began does not pass for a fast one.

    Args:
        q: Positions at a regular rate, shape (n, nv).
        rate_hz: That rate [Hz].
    """
    window = scipy.signal.windows.blackmanharris(len(q))[:, None]
    spectrum = np.fft.rfft(window * scipy.signal.detrend(q, axis=0), axis=0)
    f = np.asarray(np.fft.rfftfreq(len(q), 1 / rate_hz), float)
    power = np.abs(spectrum) ** 2
    upper = (f >= _FLOOR[0] * rate_hz / 2) & (f <= _FLOOR[1] * rate_hz / 2)
    noise = np.median(power[upper], axis=0) / np.log(2)
    cost = np.cumsum(f[:, None] ** 4 * (2 * _CAUTION * noise - power), axis=0)
    return np.asarray(f[np.argmin(cost, axis=0)], float)


class _Completion:
    """From base parameters to a robot that has them, near the given one.

    The choice makes no difference to any torque; masses move least, so that they stay positive.
    """

    def __init__(self, rows: FitRows) -> None:
        self.robot, self.effects = rows.robot, rows.effects
        B, links = rows.base.regrouping, 10 * rows.robot.nv
        self.x = np.zeros(B.shape[1])
        self.x[:links] = prior_parameters(rows.robot).ravel()
        size = np.sqrt((rows.W**2).mean(axis=(0, 1)))
        scale = 1 / np.where(size > 1e-9 * size.max(), size, size.max())
        scale[:links:10] *= _MASS_MOVES
        self.offset = B @ self.x
        self.G = scale[:, None] * np.linalg.pinv(B * scale)

    def __call__(self, beta: Array, share: float) -> Robot:
        x = self.x + share * (self.G @ (beta - self.offset))
        return identified_robot(self.robot, self.effects, x)
