"""The model in closed loop on the motion of a recording, for `output_error`.

Gautier, Janot and Vandanjon (2013) simulate the reference and the controller of the real arm. A
recording holds neither. Where the commanded motion is known, give it as a reference, with the
controller if that is known too: then nothing of the measured positions is used. Else measured
positions are the reference, passed up to the bandwidth of the motion and no further. Noise below
it stays in the columns; what reaches the acceleration falls with the bandwidth to the power 5/2,
so that the bias it makes, small as it then is, is its square.

Base parameters far from the truth may be those of no arm: inertia or friction is negative
somewhere, and no motion comes of it. As the controller holds the motion whatever the parameters
are, the model simulated is then one between the given arm and the estimate.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
import scipy.interpolate

from excitant.exceptions import BadInput
from excitant.identify.bandwidth import motion_bandwidth
from excitant.identify.differentiators import low_pass
from excitant.identify.estimators.regression import Regression
from excitant.identify.estimators.unfiltered import unfiltered_positions, with_recordings
from excitant.identify.physical import prior_parameters
from excitant.identify.preprocessing import Segment
from excitant.identify.recording import Recording
from excitant.identify.rows import FitRows
from excitant.robots.motion import Array, Motion
from excitant.robots.robot import Robot
from excitant.robots.simulation import STEP, Controller, Diverged, simulate
from excitant.robots.torque import observation_columns

Reference = Callable[[Array], Motion]
"""Commanded motion at instants of a recording, shape (n,) [s]."""

_WIDER = 2.5  # than the motion: cut-off of the reference, which leaves the motion alone to 1e-3
_HIGHEST = 0.4  # of the sampling rate
_SHARES = (1.0, 0.5, 0.25, 0.1)  # of the way from the given arm to an estimate
_MASS_MOVES = 1e-3  # as easily as other parameters where β leaves a choice


@dataclass(frozen=True, eq=False)
class ClosedLoop:
    """A regression with the simulation that `output_error` needs.

    Attributes:
        problem: The regression; its columns are those on the reference.
        bandwidth_hz: Up to where positions are the reference, shape (segments, nv) [Hz];
            infinite where the reference was given.
        chosen: Whether that was found in the positions.
        kept: Which instants of each segment's motion are rows.
    """

    problem: Regression
    bandwidth_hz: Array
    chosen: bool
    kept: tuple[slice, ...]


@dataclass(frozen=True, eq=False)
class _Loop:
    """One segment: its reference, and which instants become rows."""

    segment: Segment
    command: Motion
    keep: slice

    def rows(self, robot: Robot, rows: FitRows, motion: Motion) -> Array:
        columns = observation_columns(robot, rows.effects, motion)[:, :, list(rows.base.columns)]
        return self.segment.filtered(columns)[self.keep]


def closed_loop(
    robot: Robot,
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
        robot: The arm; where β leaves its parameters open, they stay near its own.
        rows: What is fitted.
        recordings: Behind these rows, in order.
        bandwidth_hz: Up to where measured positions are the reference [Hz]; found per joint and
            segment when None, as 2.5 times the frequency where noise drowns the acceleration.
        references: The commanded motion of each recording instead.
        controller: Of the loop; one whose feed-forward is that of the current model when None.
        step: Longest step of integration [s].

    Raises:
        BadInput: A bandwidth that the sampling rate does not show, or too few references.
    """
    pairs = with_recordings(rows.data.to_fit, recordings)
    if references is not None and len(references) != len(recordings):
        raise BadInput(
            f"output error: {len(references)} references for {len(recordings)} recordings; "
            "give one for each"
        )
    loops, widths = [], []
    for segment, recording in pairs:
        if references is not None:
            command = references[list(recordings).index(recording)](segment.motion.t)
            loops.append(_Loop(segment, command, segment.keep))
            widths.append(np.full(robot.nv, np.inf))
        else:
            loop, width = _measured(segment, recording, bandwidth_hz)
            loops.append(loop)
            widths.append(width)
    tau = np.concatenate([x.segment.tau[x.keep] for x in loops]) * rows.gains
    W = np.concatenate([x.rows(robot, rows, x.command) for x in loops])
    sizes = [len(x.segment.motion.t[x.keep]) for x in loops]
    starts = tuple(int(k) for k in np.cumsum([0, *sizes[:-1]]))
    loop_of = controller or Controller()
    model_of = _Completion(robot, rows)

    def simulated(beta: Array) -> Array:
        motions = _motions(model_of, beta, [x.command for x in loops], loop_of, step)
        pairs = zip(loops, motions, strict=True)
        return np.concatenate([x.rows(robot, rows, motion) for x, motion in pairs])

    problem = Regression(W, tau, rows.base.expressions, starts, simulated=simulated)
    chosen = bandwidth_hz is None and references is None
    return ClosedLoop(problem, np.array(widths), chosen, tuple(x.keep for x in loops))


def _motions(
    model_of: _Completion,
    beta: Array,
    commands: Sequence[Motion],
    controller: Controller,
    step: float,
) -> list[Motion]:
    """What the model does on each command, as near to β as it can be simulated.

    Raises:
        Diverged: Not even the given arm follows.
    """
    for share in _SHARES:
        model = model_of(beta, share)
        with suppress(Diverged):
            return [simulate(model, command, controller, step=step).motion for command in commands]
    given = model_of(beta, 0.0)
    return [simulate(given, command, controller, step=step).motion for command in commands]


def motion_reach(q: Array, rate_hz: float) -> Array:
    """Cut-off that leaves each joint's motion alone and little of the noise above it, (nv,) [Hz].

    Args:
        q: Measured positions at a regular rate, shape (n, nv).
        rate_hz: That rate [Hz].
    """
    slowest = 4 * rate_hz / len(q)
    return np.clip(_WIDER * motion_bandwidth(q, rate_hz), slowest, _HIGHEST * rate_hz)


def _measured(
    segment: Segment, recording: Recording, bandwidth_hz: float | None
) -> tuple[_Loop, Array]:
    """Positions up to the bandwidth as reference; rows away from the edges of that filter."""
    q, rate, nv = unfiltered_positions(segment, recording), segment.rate_hz, segment.motion.nv
    highest = _HIGHEST * rate
    if bandwidth_hz is None:
        width = motion_reach(q, rate)
    elif 0 < bandwidth_hz <= highest * (1 + 1e-9):
        width = np.full(nv, float(bandwidth_hz))
    else:
        raise BadInput(
            f"output error: a bandwidth of {bandwidth_hz:g} Hz does not fit the rate of "
            f"'{recording.name}', {rate:.4g} Hz; choose one up to {highest:.3g} Hz"
        )
    smooth = np.column_stack([low_pass(q[:, j], float(width[j]), rate) for j in range(nv)])
    t, keep = segment.motion.t, segment.keep
    spline = scipy.interpolate.make_interp_spline(t, smooth, k=5)
    edge = max(keep.start, round(rate / float(width.min())))
    shifted = keep.start + keep.step * int(np.ceil((edge - keep.start) / keep.step))
    inner = slice(shifted, min(keep.stop, len(t) - edge), keep.step)
    return _Loop(segment, Motion(t, spline(t), spline(t, 1), spline(t, 2)), inner), width


class _Completion:
    """From base parameters to a robot that has them, near the given one.

    The choice makes no difference to any torque; masses move least, so that they stay positive.
    """

    def __init__(self, robot: Robot, rows: FitRows) -> None:
        self.robot, self.effects = robot, rows.effects
        B, links = rows.base.regrouping, 10 * robot.nv
        self.x = np.zeros(B.shape[1])
        self.x[:links] = prior_parameters(robot).ravel()
        size = np.sqrt((rows.W**2).mean(axis=(0, 1)))
        scale = 1 / np.where(size > 1e-9 * size.max(), size, size.max())
        scale[:links:10] *= _MASS_MOVES
        S = B * scale
        self.offset = B @ self.x
        self.G = scale[:, None] * np.linalg.pinv(S)

    def __call__(self, beta: Array, share: float = 1.0) -> Robot:
        x = self.x + share * (self.G @ (beta - self.offset))
        links, valued = 10 * self.robot.nv, []
        start = links
        for effect in self.effects:
            count = len(effect.parameters(self.robot))
            valued.append(effect.with_values(x[start : start + count]))
            start += count
        return self.robot.with_parameters(x[:links]).with_effects(valued)
