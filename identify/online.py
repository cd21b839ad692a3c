"""On-line estimation: recursive least squares in square-root information form.

Samples come one by one. A causal local polynomial gives velocity and acceleration of the instant
in the middle of its window; the torque of that same instant is taken (matched delays), and the
mean over a block of K samples is the filter that every column and the torque pass alike. One row
per joint and block updates that joint's own triangle. Joints are weighted only when an estimate
is asked for, so noise levels may be learnt on the way without touching the past, and the result
is that of weighted least squares on all rows.

Forgetting weighs a row of age a by exp(−a / τ); what was known beforehand is never forgotten, so
where a motion shows nothing the estimate falls back to the prior instead of blowing up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from excitant.exceptions import BadInput, BadRecording
from excitant.identify.differentiators import (
    LocalPolynomial,
    causal_polynomial,
    position_spectrum,
    savitzky_golay,
)
from excitant.identify.information import Information, InformationFilter, combined
from excitant.identify.least_squares import autocorrelation_time
from excitant.identify.preprocessing import dry_joints, resampled, uninterrupted
from excitant.identify.prior import BasePrior, base_prior
from excitant.identify.recording import Recording
from excitant.robots.base_parameters import BaseParameters, base_parameters
from excitant.robots.effects import Effect, standard_effects
from excitant.robots.effects.base import Law
from excitant.robots.motion import Array, Motion, freeze
from excitant.robots.robot import Robot
from excitant.robots.torque import observation_columns

_Indices = npt.NDArray[np.intp]

_WINDOW_S = 0.03  # half width of the differentiator that serves when none is given
_BLOCK_S = 0.01  # block over which rows are averaged when none is given
RECENT = 10.0  # rows kept to judge residuals and excitation
_CERTAIN = 3.0  # standard deviations of a step above which its sign is known
_CORNERS = 5  # positions under the window between which a joint must go one way
_ROUNDING = 1e-12  # rad: positions are never better than this
_ROUNDS = 4  # of re-estimating the noise of each joint
_RING = 4096  # samples between two moves of the buffer
_BETWEEN = 1.0  # s set between recordings that follow each other
_FEWEST = 5  # samples without a gap
_STATES = 100  # random ones, for the structure of the columns


@dataclass(frozen=True, eq=False)
class OnlineEstimate:
    """What is known at an instant.

    Attributes:
        t: Instant it speaks about: the newest block [s].
        data: What the data alone say, rows of unit noise.
        beta: Estimate, shape (r,).
        covariance: Its covariance, shape (r, r).
        sigma: Standard deviation of each joint's row, shape (nv,) [torque unit].
        inflation: Integrated autocorrelation time of recent residuals [rows], shape (nv,).
    """

    t: float
    data: Information
    beta: Array
    covariance: Array
    sigma: Array
    inflation: Array

    def __post_init__(self) -> None:
        freeze(self, "beta", "covariance", "sigma", "inflation")

    @property
    def std(self) -> Array:
        """Standard deviations, shape (r,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)), float)


@dataclass(frozen=True, eq=False)
class RecentRows:
    """Recent rows of the estimator.

    Attributes:
        motion: State in the middle of each block, n blocks.
        W: Columns of the base parameters, shape (n, nv, r).
        tau: Torque, shape (n, nv).
        used: Rows that count, shape (n, nv); the others are of joints at rest.
    """

    motion: Motion
    W: Array
    tau: Array
    used: npt.NDArray[np.bool_]


class OnlineEstimator:
    """Recursive estimation of base parameters inside a control loop.

    ``push`` takes a sample; ``estimate`` says what is known. Work is spread so that no ``push``
    costs much more than another: rows wait, and one joint's rows are taken in per block.

    Args:
        robot: The arm; its inertias and effects are the prior.
        effects: Effects to estimate; friction, offset and rotor inertia when None.
        rate_hz: Sampling rate [Hz].
        differentiator: A causal polynomial; 61 samples of degree 4 at 1 kHz when None.
        block: Samples per row; 10 ms when None.
        forgetting: Time constant τ [s]; nothing is forgotten when None.
        sigma: Noise of a row of each joint, shape (nv,) [torque unit]; learnt when None.
        prior: What is known beforehand; the given robot when None, ``False`` for nothing.
        position_noise: Of the encoders, shape (nv,) [rad]: a joint that does not go one way all
            through the window gives no row, because its dry friction could be anything.
        base: Base parameters of robot and effects, where they are at hand.

    Attributes:
        span: Number of samples that a row rests on.
        rows: Number of rows (blocks) so far.

    Raises:
        BadInput: Options that do not fit, or an effect that depends on the past.
        BadRobot: A link without mass where the robot is the prior.
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
        prior: BasePrior | bool | None = None,
        position_noise: Array | float = 0.0,
        base: BaseParameters | None = None,
    ) -> None:
        self.robot = robot
        self.effects = standard_effects(robot.joints) if effects is None else tuple(effects)
        self.base = base_parameters(robot, self.effects) if base is None else base
        half = max(2, round(_WINDOW_S * rate_hz))
        self.differentiator = differentiator or savitzky_golay(half, min(4, 2 * half), causal=True)
        self.block = max(1, round(_BLOCK_S * rate_hz)) if block is None else block
        self.rate_hz = rate_hz
        self._refuse_options(forgetting)
        if prior is None or prior is True:
            prior = base_prior(robot, self.effects, self.base)
        self.prior = prior.information() if isinstance(prior, BasePrior) else None
        self._sigma = None if sigma is None else np.array(sigma, float)
        self._fade = 1.0 if forgetting is None else float(np.exp(-self.row_period / forgetting))
        noise = np.maximum(position_noise, _ROUNDING)
        self._still = _CERTAIN * np.sqrt(2) * np.broadcast_to(noise, (robot.nv,))
        self._columns = _BlockColumns(robot, self.effects, self.base, self.block)
        self._allocate()

    @property
    def row_period(self) -> float:
        """Time between rows [s]."""
        return self.block / self.rate_hz

    @property
    def delay(self) -> float:
        """Age of the newest instant it can speak about [s]."""
        return self.differentiator.delay(self.rate_hz)

    def _refuse_options(self, forgetting: float | None) -> None:
        if not self.differentiator.causal:
            raise BadInput("on-line estimation: the differentiator must be causal")
        if self.block < 1:
            raise BadInput(f"on-line estimation: a block of {self.block} samples; give at least 1")
        if forgetting is not None and not forgetting > self.row_period:
            raise BadInput(
                f"on-line estimation: forgetting within {forgetting:g} s, but a row takes "
                f"{self.row_period:g} s; give a longer time constant"
            )

    def _allocate(self) -> None:
        nv, r, m = self.robot.nv, len(self.base), self.differentiator.half_width
        kernels = [self.differentiator.kernel(k) * self.rate_hz**k for k in range(3)]
        self._kernels, self._middle, self._width = np.array(kernels), m, 2 * m + 1
        self.span = self._width + self.block - 1  # samples that a block rests on
        self._corners = np.linspace(-self.span, -1, _CORNERS).astype(int)
        self._ring = np.zeros((_RING + self.span, 2 * nv))
        self._end, self._filled, self._clock = 0, 0, -np.inf
        self._model, self._data = self.robot.model, self.robot.model.createData()
        self._Y, self._tau, self._t_sum = np.zeros((nv, 10 * nv)), np.zeros(nv), 0.0
        self._states, self._inside = np.zeros((self.block, 3, nv)), 0
        self._filters = [InformationFilter(used, r) for used in self._columns.used]
        self._picked = [np.append(used, r) for used in self._columns.used]
        self._ages, self._weight = [0] * nv, np.zeros(nv)
        self.rows, self._turn = 0, 0
        size = max(64, 4 * nv, round(RECENT / self.row_period))
        self._rows, self._used = np.zeros((size, nv, r + 1)), np.zeros((size, nv), bool)
        self._instants, self._middles = np.zeros(size), np.zeros((size, 3, nv))
        self._last_sigma: Array | None = None

    def push(self, t: float, q: Array, tau: Array) -> None:
        """Take one sample.

        After a pause of more than two samples the window of the differentiator fills anew.

        Args:
            t: Time [s].
            q: Positions, shape (nv,) [rad or m].
            tau: Torque, shape (nv,) [torque unit].

        Raises:
            BadInput: Time that goes back, or a value that is not a number.
        """
        if not t > self._clock:
            raise BadInput(f"on-line estimation: time {t:g} s after {self._clock:g} s goes back")
        if (t - self._clock) * self.rate_hz > 2.5:
            self._restart()
        self._clock = t
        if self._end == len(self._ring):
            self._ring[: self.span] = self._ring[-self.span :]
            self._end = self.span
        nv, row = self.robot.nv, self._ring[self._end]
        row[:nv], row[nv:] = q, tau
        self._end += 1
        self._filled += 1
        if self._filled >= self._width:
            window = self._ring[self._end - self._width : self._end]
            self._take(t - self.delay, self._kernels @ window[:, :nv], window[self._middle, nv:])

    def extend(self, t: Array, q: Array, tau: Array) -> None:
        """Take many samples, shapes (n,), (n, nv) and (n, nv)."""
        for k in range(len(t)):
            self.push(float(t[k]), q[k], tau[k])

    def _restart(self) -> None:
        self._end = self._filled = self._inside = 0
        self._Y[:], self._tau[:], self._t_sum = 0.0, 0.0, 0.0

    def _take(self, t: float, state: Array, tau: Array) -> None:
        """Add one instant to the block; its rows are made at the end, and absorbed afterwards."""
        self._Y += pin.computeJointTorqueRegressor(self._model, self._data, *state)
        self._states[self._inside] = state
        self._tau += tau
        self._t_sum += t
        self._inside += 1
        if self._inside == self.block:
            self._finish_block()
        elif self._inside == 1:
            self._absorb_next()

    def _finish_block(self) -> None:
        k, r, share = self.rows % len(self._rows), len(self.base), 1 / self.block
        self._rows[k, :, :r] = self._columns(share * self._Y, self._states)
        self._rows[k, :, r] = share * self._tau
        if not np.isfinite(self._rows[k]).all():
            raise BadInput(f"on-line estimation: a value before {self._clock:g} s is not a number")
        path = self._ring[self._end + self._corners, : self.robot.nv]
        self._used[k] = self._columns.certain(path, self._still)
        self._instants[k], self._middles[k] = share * self._t_sum, self._states[self.block // 2]
        self._weight = self._fade * self._weight + self._used[k]
        self.rows += 1
        self._inside, self._t_sum = 0, 0.0
        self._Y[:], self._tau[:] = 0.0, 0.0
        if self.block == 1 or self.rows - self._ages[self._turn] >= len(self._rows):
            self._absorb_next()

    def _absorb_next(self) -> None:
        self._absorb(self._turn)
        self._turn = (self._turn + 1) % self.robot.nv

    def _absorb(self, j: int) -> None:
        """Let a joint's triangle take in the rows that wait."""
        age, now = self._ages[j], self.rows
        if self._fade < 1:
            self._filters[j].forget(self._fade ** (now - age))
        self._ages[j] = now
        numbers = np.arange(age, now)
        k = numbers % len(self._rows)
        numbers, k = numbers[self._used[k, j]], k[self._used[k, j]]
        rows = self._rows[k[:, None], j, self._picked[j]]
        if self._fade < 1:
            rows *= self._fade ** ((now - 1 - numbers[:, None]) / 2)
        self._filters[j].update(rows)

    def recent(self) -> RecentRows:
        """Rows of the last ten seconds.

        Raises:
            BadInput: No row yet.
        """
        if not self.rows:
            raise BadInput("on-line estimation: no row yet; push more samples")
        size = len(self._rows)
        k = np.arange(max(0, self.rows - size), self.rows) % size
        motion = Motion(self._instants[k], *self._middles[k].transpose(1, 0, 2))
        rows, r = self._rows[k], len(self.base)
        return RecentRows(motion, rows[:, :, :r], rows[:, :, r], self._used[k])

    def estimate(self) -> OnlineEstimate:
        """What is known now; costs about as much as a hundred samples.

        Raises:
            BadInput: No row yet.
        """
        rows = self.recent()
        for j in range(self.robot.nv):
            self._absorb(j)
        parts = [each.information() for each in self._filters]
        sigma, beta = self._noise(parts)
        residual = rows.tau - rows.W @ beta
        inflation = np.array(
            [
                autocorrelation_time(residual[used, j]) if used.sum() > 20 else 1.0
                for j, used in enumerate(rows.used.T)
            ]
        )
        data, total = self._total(parts, sigma * np.sqrt(inflation))
        beta, r = total.solve(), len(self.base)
        known = np.abs(np.diag(total.R)).min() > 0
        covariance = total.covariance() if known else np.full((r, r), np.inf)
        t = float(rows.motion.t[-1])
        return OnlineEstimate(t, data, beta, covariance, sigma, inflation)

    def _total(self, parts: list[Information], sigma: Array) -> tuple[Information, Information]:
        """Data of all joints, and data with the prior."""
        data = combined([part.scaled(1 / s) for part, s in zip(parts, sigma, strict=True)])
        return data, data if self.prior is None else combined([data, self.prior])

    def _noise(self, parts: list[Information]) -> tuple[Array, Array]:
        """Noise of each joint and the estimate under it, by turns until they agree."""
        if self._sigma is not None:
            return self._sigma, self._total(parts, self._sigma)[1].solve()
        count = np.maximum(self._weight, 1.0)
        share = count.sum() / max(count.sum() - len(self.base), 0.1 * count.sum())
        torque = np.sqrt([p.squares(np.zeros(len(p.z))) for p in parts]) / np.sqrt(count)
        floor = 1e-9 * torque + 1e-12  # data without noise
        rest = np.array([part.rest for part in parts])
        sigma = np.sqrt(rest / count) if self._last_sigma is None else self._last_sigma
        for _ in range(_ROUNDS):
            beta = self._total(parts, np.maximum(sigma, floor))[1].solve()
            squares = np.array([part.squares(beta) for part in parts])
            sigma = np.maximum(np.sqrt(share * squares / count), floor)
        self._last_sigma = sigma
        return sigma, beta


class _BlockColumns:
    """Mean columns of a block of K states.

    Effects whose shape is one formula for all joints are evaluated once for all of them.

    Args:
        robot: The arm.
        effects: Effects to estimate; each must depend on the present state alone.
        base: Base parameters of robot and effects.
        block: K.

    Attributes:
        used: For every joint, the base columns that its row can contain.

    Raises:
        BadInput: An effect that depends on the past.
    """

    def __init__(
        self, robot: Robot, effects: Sequence[Effect], base: BaseParameters, block: int
    ) -> None:
        self.robot, self._block, self._mean = robot, block, np.full(block, 1 / block)
        chosen = np.array(base.columns, int)
        self._links = chosen[chosen < 10 * robot.nv]
        self._chosen = chosen[chosen >= 10 * robot.nv] - 10 * robot.nv
        self._count = sum(len(effect.parameters(robot)) for effect in effects)
        self._fast: dict[tuple[str, ...], tuple[_Indices, list[tuple[Law, _Indices]]]] = {}
        self._slow: list[tuple[Effect, int]] = []
        start = 0
        for effect in effects:
            if effect.law is not None:
                _refuse_memory(effect.name, effect.law)
                joints = np.array(effect.rows(robot), int)
                terms = len(effect.parameters(robot)) // len(joints)
                columns = start + terms * np.arange(len(joints)) + np.arange(terms)[:, None]
                members = self._fast.setdefault(effect.joints, (joints, []))[1]
                members.append((effect.law, joints * self._count + columns))
            else:
                self._slow.append((effect, start))
            start += len(effect.parameters(robot))
        self._dry = dry_joints(effects, robot.joints)
        self.used = _structure(robot, effects, chosen)

    def __call__(self, Y: Array, states: Array) -> Array:
        """Mean columns, shape (nv, r).

        Args:
            Y: Mean regressor of the block, shape (nv, 10 nv).
            states: Position, velocity and acceleration, shape (K, 3, nv).
        """
        F, mean = np.zeros((self.robot.nv, self._count)), self._mean
        for joints, members in self._fast.values():
            q, dq, ddq = states[:, :, joints].transpose(1, 0, 2).reshape(3, -1)
            for law, cells in members:
                for cell, values in zip(cells, law(q, dq, ddq), strict=True):
                    F.put(cell, mean @ values.reshape(self._block, -1))
        for slow, start in self._slow:
            motion = Motion(np.arange(float(self._block)), *states.transpose(1, 0, 2))
            columns = slow.columns(self.robot, motion).mean(axis=0)
            F[:, start : start + columns.shape[1]] = columns
        return np.concatenate([Y[:, self._links], F[:, self._chosen]], axis=1)

    def certain(self, path: Array, least: Array) -> npt.NDArray[np.bool_]:
        """Joints that go one way along a path, or have no dry friction, shape (nv,).

        Args:
            path: Positions, shape (k, nv).
            least: Steps between them that are more than noise, shape (nv,).
        """
        steps = path[1:] - path[:-1]
        one_way = (steps > least).all(axis=0) | (steps < -least).all(axis=0)
        return np.asarray(one_way | ~self._dry, bool)


def _structure(robot: Robot, effects: Sequence[Effect], columns: _Indices) -> list[_Indices]:
    q, dq, ddq = robot.random_motion(np.random.default_rng(1), _STATES)
    W = observation_columns(robot, effects, Motion(np.arange(float(_STATES)), q, dq, ddq))
    present = np.abs(W[:, :, columns]).max(axis=0) > 0
    return [np.flatnonzero(row) for row in present]


def _refuse_memory(name: str, law: Law) -> None:
    """Refuse an effect whose torque changes when the order of the samples does."""
    rng = np.random.default_rng(2)
    q, dq, ddq = rng.standard_normal((3, _STATES))
    order = rng.permutation(_STATES)
    plain, shuffled = law(q, dq, ddq), law(q[order], dq[order], ddq[order])
    if not all(np.allclose(a[order], b) for a, b in zip(plain, shuffled, strict=True)):
        raise BadInput(
            f"on-line estimation: {name} depends on the past motion; leave it out, "
            "or identify off line"
        )


def joined(recordings: Sequence[Recording]) -> Recording:
    """Recordings one after the other, a second apart."""
    if len(recordings) == 1:
        return recordings[0]
    times, start = [], 0.0
    for recording in recordings:
        times.append(recording.t - recording.t[0] + start)
        start = float(times[-1][-1]) + _BETWEEN
    return Recording(
        name=", ".join(r.name for r in recordings),
        file=recordings[0].file,
        t=np.concatenate(times),
        q=np.concatenate([r.q for r in recordings]),
        tau=np.concatenate([r.tau for r in recordings]),
        unit=recordings[0].unit,
    )


def replayable(
    robot: Robot,
    recording: Recording,
    effects: tuple[Effect, ...],
    base: BaseParameters,
    *,
    gains: Array,
    forgetting: float | None = None,
    prior: BasePrior | bool | None = None,
) -> tuple[OnlineEstimator, tuple[Array, Array, Array], str]:
    """An estimator for a recording, its samples at a regular rate, and why these velocities.

    The causal differentiator is the one that suits the positions of the recording best.

    Args:
        robot: The arm; the prior where no other is given.
        recording: What was logged; resampled where its time is irregular, gaps stay.
        effects: Effects to estimate.
        base: Base parameters of both.
        gains: Torque per reading [N·m per reading], shape (nv,).
        forgetting: Time constant [s]; nothing is forgotten when None.
        prior: What is known beforehand; the given robot when None, ``False`` for nothing.

    Returns:
        The estimator; time, positions and torque of the samples to push; a sentence.

    Raises:
        BadRecording: Too short for one row.
    """
    parts = [part for part in uninterrupted(recording.t) if len(part) >= _FEWEST]
    if not parts:
        raise BadRecording(recording.file, "no five samples without a gap", column="t")
    pieces = zip(*(resampled(recording, part) for part in parts), strict=True)
    t, q, tau = (np.concatenate(piece) for piece in pieces)
    longest = max(uninterrupted(t), key=len)
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
        raise BadRecording(recording.file, "too short or interrupted too often for on-line rows")
    return estimator, (t, q, tau * gains), choice.why
