"""Estimators of base parameters: a `Regression` in, a `LeastSquares` out.

| name | for | source |
|---|---|---|
| `wls` | joints of different noise; the default | Gautier 1997 |
| `irls` | wrong torques here and there | Huber and Ronchetti 2009 |
| `iv` | noise in the motion | Janot, Vandanjon, Gautier 2014 |
| `oe` | noise in the motion: columns on the simulated one | Gautier, Janot, Vandanjon 2013 |
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import scipy

from excitant.exceptions import BadInput, Infeasible, RankDeficient
from excitant.identify.least_squares import (
    SMALLEST,
    Factor,
    LeastSquares,
    believed,
    factorised,
    noise_of,
    weighted_least_squares,
    with_covariance,
)
from excitant.identify.preprocessing import (
    POSITION_RATIO,
    Segment,
    certain_rows,
    prepare,
    uninterrupted,
)
from excitant.identify.prior import prior_parameters
from excitant.identify.recording import Recording
from excitant.identify.regression import (
    Regression,
    dense,
    joined,
    regression_of,
    triangle,
)
from excitant.identify.rows import FitRows, identified_robot
from excitant.identify.signals import detrended, low_pass
from excitant.robots.motion import Array, Motion
from excitant.robots.robot import Robot
from excitant.robots.simulation import Controller, Diverged, simulate
from excitant.robots.torque import observation_columns

ESTIMATORS: Mapping[str, str] = MappingProxyType(
    {
        "wls": "weighted least squares",
        "irls": "robust regression (iteratively reweighted, Student's t)",
        "iv": "instrumental variables (even and odd samples)",
        "oe": "output error (closed loop simulated, DIDIM)",
    }
)
"""Name and description of every estimator."""

_CERTAIN = 0.01  # chance of a false alarm of the test for errors in the motion
_ROUNDS = 200  # of reweighting
_SETTLED = 1e-7  # change of the fitted torque, rms, of the noise
_ROUNDING = 1e-13  # of the largest torque: what rounding leaves of an exact fit
_FLATTEST = 0.05  # mean slope of an influence; less is no minimum
_NORMAL = 0.6744897501960817  # median magnitude of a standard normal variable
_HUBER = 1.345  # 95 % efficient for normal noise (Huber and Ronchetti 2009)
_STUDENT = 4.0  # degrees of freedom (Lange, Little, Taylor 1989)
_STAGES = 3  # of re-estimating the noise of each joint with instruments
_SAME = 1e-6  # of a column's length: smaller errors are those of interpolation
_RATE_SHARE = 0.2  # of the rate of all samples: 0.8 of what every second one can show
_SIMULATIONS = 15  # at most; two to four do
_STILL = 1e-2  # of a standard deviation
_UNCHANGED = 1e-6  # of the rms torque
_WIDER = 2.5  # than the motion: cut-off of the reference, which leaves the motion alone to 1e-3
_HIGHEST = 0.4  # of the sampling rate
_SHARES = (1.0, 0.5, 0.25, 0.1)  # of the way from the given arm to an estimate
_MASS_MOVES = 1e-3  # as easily as other parameters where β leaves a choice
_CAUTION = 2.0  # times the noise, lest the largest of many frequencies pass for motion
_BLACKMAN_HARRIS = np.array(
    [0.35875, -0.48829, 0.14128, -0.01168]
)  # of cosines of 0 to 3 turns
_QUINTIC = 5  # degree of a spline
# of half the rate: where positions show nothing but the noise of encoders
_FLOOR = (0.5, 0.9)


def estimated(
    rows: FitRows, recordings: Sequence[Recording], name: str
) -> tuple[LeastSquares, str, tuple[str, ...]]:
    """Base parameters by the estimator of a name, which it was, and what the user should know.

    `iv` and `oe` look again at the recordings behind these rows, in order. Weighted least squares
    takes the place of `iv` where half of the samples, as of a coarse encoder, show too little.

    Raises:
        RankDeficient: Motion that leaves base parameters undetermined.
        Infeasible: Robust regression or output error that does not converge.
    """
    problem = rows.reduced
    said = f"base parameters by {ESTIMATORS[name]}"
    if name == "wls":
        return weighted_least_squares(problem), name, ()
    if name == "irls":
        return irls(problem), name, (said,)
    if name == "iv":
        even, odd = half_regressions(rows, recordings)
        try:
            fit = iv(even, odd)
            return fit, name, (said, _tested(even, odd, fit))
        except (np.linalg.LinAlgError, RankDeficient) as error:
            why = f"{ESTIMATORS[name]} left out ({error}): positions are too coarse or the motion"
            note = f"{why} too poor in every second sample; {ESTIMATORS['wls']} instead"
            return weighted_least_squares(problem), "wls", (note,)
    loop = closed_loop(rows, recordings)
    found = output_error(loop.problem, loop.simulated)
    return found.fit, name, (said, found.sentence(loop.bandwidth_hz))


def irls(problem: Regression) -> LeastSquares:
    """Solve Σ_j W_jᵀ ψ(ε_j / σ_j) / σ_j = 0, σ_j from the median magnitude of joint j's residual.

    Huber's ψ first, whose solution is unique; from there Student's of four degrees of freedom,
    which gives gross errors no influence in the end. With m_j the mean of ψ', the pseudo-torque
    W_j β + σ_j ψ / m_j has β for its least-squares solution under weights m_j / σ_j², and errors to
    which the estimate responds to first order as least squares does: hence the covariance, valid
    for coloured noise too (Huber and Ronchetti 2009, ch. 7; Holland and Welsch 1977).

    It withstands wrong torques, not wrong positions. A filter before it spreads a spike over its
    neighbours, which then look like noise.

    Raises:
        RankDeficient: The motion does not show some columns.
        Infeasible: The weights did not settle, or leave too few rows.
    """
    centred = [tau - tau.mean() for tau in problem.counted(problem.tau) if len(tau)]
    start = factorised(problem, _scale(centred, 0))
    beta = _settled(start, start.solve(), _huber)
    beta = _settled(start, beta, _student)
    residual = problem.residual(beta)
    sigma = _scale(problem.counted(residual), problem.p)
    u = residual / sigma
    slope = (_STUDENT + 1) * (_STUDENT - u**2) / (_STUDENT + u**2) ** 2
    flat = np.maximum([each.mean() for each in problem.counted(slope)], _FLATTEST)
    factor = factorised(problem, sigma / np.sqrt(flat))
    return with_covariance(factor, beta, sigma * u * _student(u) / flat, sigma)


def _huber(u: Array) -> Array:
    """ψ(u) / u of a residual of u standard deviations."""
    return np.minimum(1.0, _HUBER / np.maximum(np.abs(u), SMALLEST))


def _student(u: Array) -> Array:
    """ψ(u) / u of a residual of u standard deviations."""
    return (_STUDENT + 1) / (_STUDENT + u**2)


def _scale(residuals: Sequence[Array], r: int) -> Array:
    """Standard deviation of the normal noise with these median magnitudes, shape (nv,)."""
    rows = sum(map(len, residuals))
    freedom = np.sqrt(rows / max(rows - r, 1))
    size = np.array([np.median(np.abs(e)) for e in residuals]) / _NORMAL * freedom
    least = 1e-9 * noise_of(residuals, r)  # most rows fit exactly
    return believed(np.maximum(size, least))


def _settled(start: Factor, beta: Array, influence: Callable[[Array], Array]) -> Array:
    """β at which reweighting rests; steps are taken in the orthonormal columns of the start."""
    problem = start.problem
    inverse = start.inverse / start.norms[:, None]
    parts = enumerate(zip(problem.index, problem.columns, strict=True))
    Q = np.stack(
        [X @ inverse[index] / start.weight[j] for j, (index, X) in parts], axis=1
    )
    flat = Q.reshape(-1, problem.p)
    for _ in range(_ROUNDS):
        residual = problem.residual(beta)
        sigma = _scale(problem.counted(residual), problem.p)
        weight = influence(residual / sigma) * (start.weight / sigma) ** 2
        weighted = (Q * weight[:, :, None]).reshape(flat.shape)
        score = weighted.T @ (residual / start.weight).ravel()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error", scipy.linalg.LinAlgWarning)
                step = scipy.linalg.solve(weighted.T @ flat, score, assume_a="pos")
        except (np.linalg.LinAlgError, scipy.linalg.LinAlgWarning):
            raise Infeasible(
                "robust regression",
                "rows that count do not determine all parameters; use another estimator, or "
                "record more",
            ) from None
        beta = beta + inverse @ step
        moved = Q @ step * start.weight
        rounding = _ROUNDING * np.abs(problem.tau).max(axis=0)
        if float(((moved / (sigma + rounding / _SETTLED)) ** 2).mean()) <= _SETTLED**2:
            return beta
    raise Infeasible(
        "robust regression",
        f"weights did not settle in {_ROUNDS} rounds; use another estimator, or record more",
    )


def iv(problem: Regression, instruments: Regression) -> LeastSquares:
    """Two-stage least squares: W projected on the instruments Z, then fitted to the torque.

    Least squares is biased where W has errors, because WᵀW contains their squares. Instruments
    have errors independent of those of W and of the torque, so that Zᵀ(τ − W β) = 0 has no such
    term. Janot, Vandanjon, Gautier (2014) simulate the closed loop for them; here they are
    columns on other samples of the same motion (`half_regressions`), at least as many. Variance is
    larger than that of least squares; weak instruments leave bias, and so do columns that are no
    linear functions of the noise (signs of velocities).

    Raises:
        RankDeficient: Columns, or instruments, that the motion does not show.
    """
    sigma = weighted_least_squares(problem).sigma
    for _ in range(_STAGES):
        factor = factorised(_projected(problem, instruments, sigma), sigma)
        beta = factor.solve()
        residual = problem.residual(beta)
        sigma = noise_of(problem.counted(residual), len(beta))
    return with_covariance(factor, beta, residual, sigma)


def _projected(
    problem: Regression, instruments: Regression, sigma: Array
) -> Regression:
    """The problem with the part of its columns that instruments explain."""
    k = instruments.p
    r = problem.p
    stage = factorised(instruments, sigma)
    both = instruments.with_columns(problem.W, problem.names)
    R = triangle(both.stacked(1 / sigma)[:, :-1] / np.append(stage.norms, np.ones(r)))
    C = scipy.linalg.solve_triangular(R[:k, :k], R[:k, k:]) / stage.norms[:, None]
    pairs = zip(instruments.index, instruments.columns, strict=True)
    explained = np.stack([Z @ C[index] for index, Z in pairs], axis=1)
    return dense(explained, problem.tau, problem.names, problem.used)


def errors_in_variables(
    problem: Regression, instruments: Regression
) -> tuple[float, float]:
    """Test whether errors of W move with those of the torque (Durbin, Wu, Hausman 1978).

    V is the part of W that instruments do not explain. Without errors in W that matter, V has no
    coefficient of its own in τ ≈ W β + V γ. The statistic γ̂ᵀ C⁻¹ γ̂, C the covariance of γ̂ under
    coloured noise, is then χ² with as many degrees of freedom as V has independent columns. A
    model that lacks physics leaves p large, unless what it lacks moves with V.

    Returns:
        Statistic, and p, the chance of one as large where least squares is not biased.

    Raises:
        BadInput: Instruments that explain W entirely leave nothing to test.
        RankDeficient: Columns, or instruments, that the motion does not show.
    """
    r = problem.p
    W = problem.W
    sigma = weighted_least_squares(problem).sigma
    left = (W - _projected(problem, instruments, sigma).W) / sigma[:, None]
    lengths = np.linalg.norm(W / sigma[:, None], axis=(0, 1))
    U, s, _ = scipy.linalg.svd((left / lengths).reshape(-1, r), full_matrices=False)
    keep = s > _SAME
    if not keep.any():
        raise BadInput(
            "the instruments explain the columns entirely, so nothing is left to test; "
            "give instruments with errors of their own"
        )
    V = U[:, keep].reshape(*W.shape[:2], -1) * sigma[:, None]
    added = tuple(f"error {k + 1}" for k in range(V.shape[2]))
    fit = weighted_least_squares(problem.with_columns(V, added))
    gamma = fit.beta[r:]
    C = fit.covariance[r:, r:]
    statistic = float(gamma @ scipy.linalg.solve(C, gamma, assume_a="pos"))
    return statistic, float(scipy.special.chdtrc(len(gamma), statistic))


def _tested(problem: Regression, instruments: Regression, fit: LeastSquares) -> str:
    """Verdict of the test on least squares of the same columns, and its importance."""
    try:
        statistic, p = errors_in_variables(problem, instruments)
    except BadInput:
        return "even and odd samples show one and the same motion: no errors of it to be tested"
    moved = np.abs(weighted_least_squares(problem).beta - fit.beta) / fit.std
    found = "are seen" if p < _CERTAIN else "are not seen"
    return (
        f"errors of the motion that bias least squares {found} (Durbin-Wu-Hausman: "
        f"{statistic:.4g}, p = {p:.2g}); instruments move its base parameters by up to "
        f"{moved.max():.2g} standard deviations"
    )


def every_second(recording: Recording, first: int) -> Recording:
    """The motion as its even samples (0) show it, or its odd ones (1), at all instants."""
    t = recording.t

    def shown(channel: Array) -> Array:
        values = np.array(channel)
        for part in uninterrupted(t):
            if len(seen := part[first::2]) > _QUINTIC:
                spline = scipy.interpolate.make_interp_spline(
                    t[seen], values[seen], k=_QUINTIC
                )
                values[part] = spline(t[part])
        return values

    dq = None if recording.dq is None else shown(recording.dq)
    return replace(recording, q=shown(recording.q), dq=dq)


def half_regressions(
    rows: FitRows, recordings: Sequence[Recording]
) -> tuple[Regression, Regression]:
    """Base columns from even and from odd samples at the rows of a fit, of recordings in order.

    Their errors are independent where the noise of a position sensor is so from sample to sample:
    not for a sensor that low-passes before it logs, nor for errors that depend on the position
    (scale, eccentricity), for which every sample is wrong alike.

    Raises:
        BadInput: A rate below five times the cut-off.
    """
    cutoff_hz = rows.data.cutoff_hz
    halves = []
    for first in (0, 1):
        segments = []
        for recording in recordings:
            rate_hz = 1 / float(np.median(np.diff(recording.t)))
            highest = _RATE_SHARE * rate_hz
            if cutoff_hz > highest * (1 + 1e-6):
                raise BadInput(
                    f"{recording.name}: every second sample at {rate_hz:.4g} Hz does not show "
                    f"motion up to the cut-off of {cutoff_hz:g} Hz; choose one up to "
                    f"{highest:.3g} Hz"
                )
            band_hz = min(POSITION_RATIO * cutoff_hz, highest)
            segments += prepare(every_second(recording, first), cutoff_hz, band_hz)
        whole = rows.data.train[0].whole
        segments = [replace(segment, whole=whole) for segment in segments]
        half = rows.fitting(regression_of(rows.robot, rows.effects, segments))
        halves.append(half.select(rows.base.columns, rows.base.expressions))
    return halves[0], halves[1]


class OutputError(NamedTuple):
    """An output-error estimate, the weighted least squares it began with, simulations it took."""

    fit: LeastSquares
    start: LeastSquares
    iterations: int

    def sentence(self, bandwidth_hz: Array) -> str:
        """Simulation with positions up to a bandwidth for reference [Hz]."""
        low = bandwidth_hz.min()
        high = bandwidth_hz.max()
        width = (
            f"{low:.3g} Hz" if high - low < 0.1 * low else f"{low:.3g} to {high:.3g} Hz"
        )
        moved = np.abs(self.fit.beta - self.start.beta) / self.fit.std
        return (
            f"the model was simulated on the measured motion up to {width}, as the positions "
            f"themselves suggest; converged after {self.iterations} iterations, which moved "
            f"parameters by up to {moved.max():.2g} standard deviations"
        )


def output_error(
    problem: Regression, simulated: Callable[[Array], Regression]
) -> OutputError:
    """Output error by direct and inverse models (DIDIM: Gautier, Janot, Vandanjon 2013).

    The closed loop of the model is simulated with the current β, which gives columns W_s(β) of a
    motion without the noise of the measured one, and τ ≈ W_s(β) β is solved by weighted least
    squares for the next. How the simulated motion depends on β is left out of the derivative,
    because the controller holds the motion whatever β is.

    Begins with the columns on the reference; ``simulated`` gives those of parameters β.

    Raises:
        Infeasible: It does not converge.
        RankDeficient: The motion does not show some columns.
    """
    start = fit = weighted_least_squares(problem)
    scale = np.maximum(np.sqrt((problem.tau**2).mean(axis=0)), np.finfo(float).tiny)
    for done in range(1, _SIMULATIONS + 1):
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
        if change < _STILL or torque < _UNCHANGED:
            return OutputError(fit, start, done)
    raise Infeasible(
        "output error",
        f"parameters still move by {change:.2g} standard deviations after {_SIMULATIONS} "
        "simulations; use wls or iv",
    )


class ClosedLoop(NamedTuple):
    """A regression on the reference, and on the motion of the model with parameters β.

    Positions are the reference up to a bandwidth, shape (segments, nv) [Hz].
    """

    problem: Regression
    simulated: Callable[[Array], Regression]
    bandwidth_hz: Array


def closed_loop(rows: FitRows, recordings: Sequence[Recording]) -> ClosedLoop:
    """The regression of a fit with the simulated loop of each segment of its recordings.

    A recording holds neither the commanded motion nor the controller, so measured positions are
    the reference, passed up to 2.5 times the frequency where noise drowns the acceleration. The
    bias that noise below that makes falls with the bandwidth to the power 5. Base parameters far
    from the truth may be those of no arm, of which no motion comes: the model simulated is then
    one between the given arm and the estimate.
    """
    pairs = _with_recordings(rows.data.train, recordings)
    loops = [_reference(segment, recording) for segment, recording in pairs]
    used = certain_rows(
        rows.effects, rows.robot.joints, [segment for segment, *_ in loops]
    )
    commands = [command for _, command, _ in loops]
    model_of = _completion(rows)

    def regression(motions: Sequence[Motion]) -> Regression:
        parts = []
        for (segment, _, _), motion in zip(loops, motions, strict=True):
            columns = observation_columns(rows.robot, rows.effects, motion)
            W = segment.filtered(columns[:, :, rows.base.columns], segment.keep)
            parts.append(
                dense(W, segment.tau[segment.keep] * rows.gains, rows.base.expressions)
            )
        return joined(parts).counting(used)

    def simulated_at(beta: Array, share: float) -> Regression:
        model = model_of(beta, share)
        return regression([simulate(model, c, Controller()).motion for c in commands])

    def simulated(beta: Array) -> Regression:
        for share in _SHARES:
            with suppress(Diverged):
                return simulated_at(beta, share)
        return simulated_at(beta, 0.0)

    return ClosedLoop(
        regression(commands), simulated, np.array([width for *_, width in loops])
    )


def _with_recordings(
    segments: Sequence[Segment], recordings: Sequence[Recording]
) -> list[tuple[Segment, Recording]]:
    """Every segment with the recording that it is a part of, both in order."""
    found = []
    left = list(segments)
    for recording in recordings:
        last = -np.inf
        while left and left[0].name == recording.name and left[0].motion.t[0] > last:
            last = float(left[0].motion.t[-1])
            found.append((left.pop(0), recording))
    return found


def _reference(segment: Segment, recording: Recording) -> tuple[Segment, Motion, Array]:
    """Rows away from the edges of the filter, positions up to the bandwidth, and it, (nv,)."""
    rate = segment.rate_hz
    t = segment.motion.t
    part = (recording.t >= t[0] - 1e-9) & (recording.t <= t[-1] + 1e-6 + 1 / rate)
    q = scipy.interpolate.make_interp_spline(recording.t[part], recording.q[part], k=3)(
        t
    )
    width = np.clip(
        _WIDER * _motion_bandwidth(q, rate), 4 * rate / len(q), _HIGHEST * rate
    )
    smooth = np.column_stack(
        [low_pass(q[:, j], float(hz), rate) for j, hz in enumerate(width)]
    )
    spline = scipy.interpolate.make_interp_spline(t, smooth, k=5)
    keep = segment.keep
    edge = max(keep.start, round(rate / float(width.min())))
    first = keep.start + keep.step * int(np.ceil((edge - keep.start) / keep.step))
    inner = slice(first, min(keep.stop, len(t) - edge), keep.step)
    return (
        replace(segment, keep=inner),
        Motion(t, *(spline(t, k) for k in range(3))),
        width,
    )


def _motion_bandwidth(q: Array, rate_hz: float) -> Array:
    """Frequency up to which passing positions makes the best acceleration, shape (nv,) [Hz].

    The expected squared error of acceleration, Σ_{f > f_b} (2πf)⁴ (P − N) + Σ_{f ≤ f_b} (2πf)⁴ N
    (signal lost, noise kept), is smallest where Σ_{f ≤ f_b} f⁴ (2N − P) is. Noise N of encoders is
    taken from the upper part of the spectrum P, its median there being ln 2 of its mean.
    """
    along = 2 * np.pi * np.arange(len(q)) / (len(q) - 1)
    window = np.cos(np.outer(along, np.arange(4))) @ _BLACKMAN_HARRIS
    spectrum = np.fft.rfft(window[:, None] * detrended(q), axis=0)
    f = np.fft.rfftfreq(len(q), 1 / rate_hz)
    power = np.abs(spectrum) ** 2
    upper = (f >= _FLOOR[0] * rate_hz / 2) & (f <= _FLOOR[1] * rate_hz / 2)
    noise = np.median(power[upper], axis=0) / np.log(2)
    cost = np.cumsum(f[:, None] ** 4 * (2 * _CAUTION * noise - power), axis=0)
    return f[np.argmin(cost, axis=0)]


def _completion(rows: FitRows) -> Callable[[Array, float], Robot]:
    """A robot near the given one that has base parameters β, or a share of the way there.

    The choice makes no difference to any torque; masses move least, so that they stay positive.
    """
    B = rows.base.regrouping
    links = 10 * rows.robot.nv
    given = np.zeros(B.shape[1])
    given[:links] = prior_parameters(rows.robot).ravel()
    size = np.sqrt((rows.W**2).mean(axis=(0, 1)))
    scale = 1 / np.where(size > 1e-9 * size.max(), size, size.max())
    scale[:links:10] *= _MASS_MOVES
    G = scale[:, None] * np.linalg.pinv(B * scale)

    def model(beta: Array, share: float) -> Robot:
        x = given + share * (G @ (beta - B @ given))
        return identified_robot(rows.robot, rows.effects, x)

    return model
