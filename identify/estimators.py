"""Estimators of base parameters: a `Regression` in, a `LeastSquares` out.

| name | for | source |
|---|---|---|
| `wls` | joints of different noise | Gautier 1997 |
| `irls` | wrong torques here and there | Huber and Ronchetti 2009 |
| `iv` | noise in the motion | Janot, Vandanjon, Gautier 2014 |
| `smooth` | noise in the motion: columns on positions without it | Gautier 1997 |
"""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
import scipy

from excitant.exceptions import BadInput, Infeasible, RankDeficient
from excitant.identify.attenuation import ATTENUATION, coarseness, half_segments
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
    Segment,
    certain_rows,
)
from excitant.identify.recording import Recording
from excitant.identify.regression import (
    Regression,
    dense,
    regression_of,
    triangle,
)
from excitant.identify.rows import FitRows
from excitant.identify.signals import detrended, low_pass
from excitant.robots.motion import Array, Motion, power_density

ESTIMATORS = MappingProxyType(
    {
        "wls": "weighted least squares",
        "irls": "robust regression (iteratively reweighted, Student's t)",
        "iv": "instrumental variables (even and odd samples)",
        "smooth": "weighted least squares on smoothed positions",
    }
)
"""Name and description of every estimator."""

FALSE_ALARM = 0.01  # of the test whether errors follow the motion
SHIFTS = 199  # of errors against the motion: FALSE_ALARM is two ranks of them and the own one
GOLDEN = (np.sqrt(5) - 1) / 2


@dataclass(frozen=True)
class Robust:
    """Settings of robust regression.

    Attributes:
        huber: Residual in standard deviations from which Huber's influence is constant; 95 %
            efficient for normal noise (Huber and Ronchetti 2009).
        student: Degrees of freedom (Lange, Little, Taylor 1989).
        rounds: Largest number of reweightings.
        settled: Change of the fitted torque, rms, over the noise at which they end.
        rounding: Noise of an exact fit over the largest torque.
        flattest: Least mean slope of the influence; less is no minimum.
        outlying: Rms of residuals over the scale of most of them from which on it is tried in place
            of least squares,
        felt: if the same rms is also more of the torque's than models are off by anyway.
        gain: Variance of least squares over its own from which on it then takes that place: as much
            as four times the data give.
        gross: Residual in standard deviations that is called gross: one of 15 000 normal ones.
    """

    huber: float = 1.345
    student: float = 4.0
    rounds: int = 200
    settled: float = 1e-7
    rounding: float = 1e-13
    flattest: float = 0.05
    outlying: float = 2.0
    felt: float = 0.02
    gain: float = 4.0
    gross: float = 4.0


ROBUST = Robust()


@dataclass(frozen=True)
class Smoothing:
    """Settings of smoothed positions.

    Attributes:
        wider: Cut-off of positions over the bandwidth of the motion, which passes to 1e-3.
        narrower: The same, lower: what estimates change by is what either may be off.
        highest: Largest cut-off over the sampling rate.
        caution: Factor of the noise, lest the largest of many frequencies pass for motion.
    """

    wider: float = 2.5
    narrower: float = 2.0
    highest: float = 0.4
    caution: float = 2.0


SMOOTHING = Smoothing()


def estimated(
    rows: FitRows, recordings: Sequence[Recording], name: str | None
) -> tuple[FitRows, LeastSquares, str, tuple[str, ...]]:
    """Base parameters by the estimator of a name, which it was, and what the user should know.

    First come the rows, with drive gains of currents by what the estimator believes of them.

    Without a name, weighted least squares, or what the fitted rows call for in its place: `irls`
    where gross errors of torque spoil it, else `smooth` where noise of the motion does.
    `iv` looks again at the recordings behind these rows, in order.

    Raises:
        RankDeficient: Motion that leaves base parameters undetermined.
        BadInput: Samples that show too little of the motion for the estimator.
        Infeasible: Robust regression that does not converge.
    """
    problem = rows.reduced
    if name is None:
        fit = weighted_least_squares(problem)
        robust, sentence = _robust(problem, fit, rows.robot.joints)
        if sentence:
            return *_regained(rows, robust), "irls", (sentence,)
        rows, fit, sentence = _smooth(rows, fit)
        if sentence:
            return rows, fit, "smooth", (sentence,)
        return rows, fit, "wls", ()
    if name == "wls":
        return rows, weighted_least_squares(problem), name, ()
    note = f"base parameters by {ESTIMATORS[name]}"
    if name == "irls":
        return *_regained(rows, irls(problem)), name, (note,)
    if name == "iv":
        try:
            fit = iv(*half_regressions(rows, recordings))
            return rows, fit, name, (note,)
        except np.linalg.LinAlgError as error:
            few = "every second sample shows too little of the motion; take smooth"
            raise BadInput(f"estimator iv: {few}") from error
    rows, fit, cutoffs_hz = smoothed_fit(rows)
    up_to = f"positions count up to {_band(cutoffs_hz)}"
    said = f"{up_to}, above which noise drowns their acceleration"
    return rows, fit, name, (note, said)


def spoiled(rows: FitRows) -> bool:
    """Whether gross errors of torque spoil least squares, so that `irls` takes its place."""
    fit = weighted_least_squares(rows.reduced)
    return bool(_robust(rows.reduced, fit, rows.robot.joints)[1])


def _robust(
    problem: Regression, fit: LeastSquares, joints: Sequence[str]
) -> tuple[LeastSquares, str]:
    """Robust regression where gross errors spoil least squares, and the sentence that says so.

    Where errors follow the motion, the model lacks something, and all rows count.
    """
    residuals = problem.counted(problem.residual(fit.beta))
    rms = noise_of(residuals, problem.p)
    size = [values.std() for values in problem.counted(problem.tau)]
    outlying = rms > ROBUST.outlying * _scale(residuals, problem.p)
    if not (outlying & (rms > ROBUST.felt * np.array(size))).any():
        return fit, ""
    try:
        robust = irls(problem)
    except (Infeasible, RankDeficient):
        return fit, ""
    variances = np.diag(fit.covariance) / np.diag(robust.covariance)
    if not np.exp(np.log(variances).mean()) > ROBUST.gain:
        return fit, ""
    residual = problem.residual(robust.beta)
    if _follow_motion(problem, fit.sigma, residual):
        return fit, ""
    sizes = np.abs(residual) / robust.sigma
    gross = [(u > ROBUST.gross).mean() for u in problem.counted(sizes)]
    worst = int(np.argmax(gross))
    return robust, (
        f"torque is far off in up to {100 * gross[worst]:.1f} % of the rows ({joints[worst]}), as "
        f"in bursts or contact: {ESTIMATORS['irls']} instead of least squares"
    )


def _follow_motion(problem: Regression, sigma: Array, errors: Array) -> bool:
    """Whether errors, shape (n, nv), depend on the motion.

    Columns then explain more of them as they are than at other times, to which each joint's errors
    are shifted circularly (a permutation test, exact for any distribution of the errors: a few
    bursts have no normal estimate to be compared with). Shifts are multiples of the golden ratio:
    evenly spread, and no period of a motion.
    """
    flat = _orthonormal(factorised(problem, sigma)).reshape(-1, problem.p)
    of_joints = problem.counted(errors / sigma)

    def explained(share: float) -> float:
        shifted = np.zeros(errors.shape)
        for j, values in enumerate(of_joints):
            shifted[problem.rows(j), j] = np.roll(
                values, round(share * len(values))
            )
        return ((flat.T @ shifted.ravel()) ** 2).sum()

    others = [explained(k * GOLDEN % 1) for k in range(1, SHIFTS + 1)]
    as_large = 1 + sum(other >= explained(0.0) for other in others)
    return as_large <= FALSE_ALARM * (SHIFTS + 1)


def _regained(rows: FitRows, fit: LeastSquares) -> tuple[FitRows, LeastSquares]:
    """Robust regression with drive gains of currents by rows without gross errors."""
    if rows.data.unit != "A":
        return rows, fit
    problem = rows.reduced
    sound = np.abs(problem.residual(fit.beta)) <= ROBUST.gross * fit.sigma
    rows = rows.regained(problem.counting(sound))
    return rows, irls(rows.reduced)


def _smooth(rows: FitRows, fit: LeastSquares) -> tuple[FitRows, LeastSquares, str]:
    """Least squares on smoothed positions where coarse ones spoil it, and the sentence for it.

    Errors of the columns, noise of the motion or motion that is smoothed away, leave more of the
    torque. Of the same torque and as many parameters, the columns of greater likelihood count.
    """
    share = coarseness(rows.data.train)
    if not (share > ATTENUATION).any():
        return rows, fit, ""
    try:
        smooth, found, cutoffs_hz = smoothed_fit(rows)
    except RankDeficient:
        return rows, fit, ""
    error = found.sigma / smooth.gains
    if np.log(error * rows.gains / fit.sigma).sum() >= 0:
        return rows, fit, ""
    worst = np.argmax(share)
    sentence = (
        f"positions are coarse beside the motion (noise of {100 * share[worst]:.2g} % of the "
        f"acceleration of {rows.robot.joints[worst]}): {ESTIMATORS['smooth']}, which count up to "
        f"{_band(cutoffs_hz)}"
    )
    return smooth, found, sentence


def _band(cutoffs_hz: Array) -> str:
    return f"{cutoffs_hz.min():.3g} to {cutoffs_hz.max():.3g} Hz"


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
    sigma = _scale(problem.counted(problem.residual(beta)), problem.p)
    error, flat = _influence(problem, beta, sigma)
    factor = factorised(problem, sigma / np.sqrt(flat))
    return with_covariance(factor, beta, error, sigma)


def without_gross_errors(problem: Regression, fit: LeastSquares) -> Array:
    """The pseudo-torque of `irls`, shape (n, nv) [torque unit]."""
    error, _ = _influence(problem, fit.beta, fit.sigma)
    return problem.tau - problem.residual(fit.beta) + error


def _influence(
    problem: Regression, beta: Array, sigma: Array
) -> tuple[Array, Array]:
    """Errors σ_j ψ / m_j of the rows, shape (n, nv), and m_j, (nv,)."""
    u = problem.residual(beta) / sigma
    nu = ROBUST.student
    slope = (nu + 1) * (nu - u**2) / (nu + u**2) ** 2
    means = [values.mean() for values in problem.counted(slope)]
    flat = np.maximum(means, ROBUST.flattest)
    return sigma * u * _student(u) / flat, flat


def _huber(u: Array) -> Array:
    """ψ(u) / u of a residual of u standard deviations."""
    return np.minimum(1.0, ROBUST.huber / np.maximum(np.abs(u), SMALLEST))


def _student(u: Array) -> Array:
    """ψ(u) / u of a residual of u standard deviations."""
    return (ROBUST.student + 1) / (ROBUST.student + u**2)


def _scale(residuals: Sequence[Array], r: int) -> Array:
    """Standard deviation of the normal noise with these median magnitudes, shape (nv,)."""
    rows = sum(map(len, residuals))
    freedom = np.sqrt(rows / max(rows - r, 1))
    medians = np.array([np.median(np.abs(e)) for e in residuals])
    standard = scipy.special.ndtri(0.75)  # that of normal noise of variance one
    least = 1e-9 * noise_of(residuals, r)  # most rows fit exactly
    return believed(np.maximum(medians / standard * freedom, least))


def _settled(
    start: Factor, beta: Array, influence: Callable[[Array], Array]
) -> Array:
    """β at which reweighting rests; steps are taken in the orthonormal columns of the start."""
    problem = start.problem
    inverse = start.inverse
    Q = _orthonormal(start)
    flat = Q.reshape(-1, problem.p)
    rounding = ROBUST.rounding * np.abs(problem.tau).max(axis=0)
    for _ in range(ROBUST.rounds):
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
        change = Q @ step * start.weight / (sigma + rounding / ROBUST.settled)
        if (change**2).mean() <= ROBUST.settled**2:
            return beta
    raise Infeasible(
        "robust regression",
        f"weights did not settle in {ROBUST.rounds} rounds; use another estimator, or record more",
    )


def _orthonormal(factor: Factor) -> Array:
    """Q of W / weight = Q R, shape (n, nv, p)."""
    problem = factor.problem
    inverse = factor.inverse
    parts = zip(problem.index, problem.columns, factor.weight, strict=True)
    return np.stack([X @ inverse[index] / w for index, X, w in parts], axis=1)


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
    for _ in range(3):  # noise of each joint with instruments
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
    norms = factorised(instruments, sigma).norms
    both = instruments.with_columns(problem.W, problem.names)
    scale = np.append(norms, np.ones(r))
    R = triangle(both.stacked(1 / sigma)[:, :-1] / scale)
    C = scipy.linalg.solve_triangular(R[:k, :k], R[:k, k:]) / norms[:, None]
    pairs = zip(instruments.index, instruments.columns, strict=True)
    explained = np.stack([Z @ C[index] for index, Z in pairs], axis=1)
    return dense(explained, problem.tau, problem.names, problem.used)


def half_regressions(
    rows: FitRows, recordings: Sequence[Recording]
) -> tuple[Regression, Regression]:
    """Base columns from even and from odd samples at the rows of a fit, of recordings in order.

    Errors are those of `half_segments`.
    """
    even, odd = (
        rows.fitting(regression_of(rows.robot, rows.effects, half)).select(
            rows.base.columns, rows.base.expressions
        )
        for half in half_segments(recordings, rows.data)
    )
    return even, odd


def smoothed_fit(rows: FitRows) -> tuple[FitRows, LeastSquares, Array]:
    """Least squares on smoothed positions, and their cut-offs, (segments, nv) [Hz].

    The rows come first, with drive gains of currents by the smoothed positions: noise of the
    motion makes gains too large. What a lower cut-off changes, of noise that is left and of motion
    that is lost, is uncertain.
    """
    smoothed, cutoffs_hz = smoothed_regression(rows)
    less, _ = smoothed_regression(rows, SMOOTHING.narrower)
    regained = rows.regained(smoothed)
    ratio = regained.gains / rows.gains
    fit, narrower = (
        weighted_least_squares(problem.with_torque(problem.tau * ratio))
        for problem in (smoothed, less)
    )
    change = narrower.beta - fit.beta
    covariance = fit.covariance + np.outer(change, change)
    return regained, replace(fit, covariance=covariance), cutoffs_hz


def smoothed_regression(
    rows: FitRows, wider: float | None = None
) -> tuple[Regression, Array]:
    """The regression of a fit on smoothed positions, and their cut-offs, (segments, nv) [Hz].

    Positions pass up to 2.5 times the frequency where noise drowns the acceleration: the bias that
    noise below that makes falls with the bandwidth to the power 5. Simulating the closed loop of
    the model on this motion (output error: Gautier, Janot, Vandanjon 2013) predicts no better.
    """
    wider = wider or SMOOTHING.wider
    smoothed = [_smoothed(segment, wider) for segment in rows.data.train]
    segments = [segment for segment, _ in smoothed]
    every = regression_of(rows.robot, rows.effects, segments)
    problem = every.select(rows.base.columns, rows.base.expressions)
    used = certain_rows(rows.effects, rows.robot.joints, segments)
    problem = problem.with_torque(problem.tau * rows.gains).counting(used)
    return problem, np.array([cutoff_hz for _, cutoff_hz in smoothed])


def _smoothed(segment: Segment, wider: float) -> tuple[Segment, Array]:
    """Rows away from the edges of the filter, positions up to their cut-offs, (nv,) [Hz]."""
    rate = segment.rate_hz
    t = segment.motion.t
    q = segment.motion.q
    widest = SMOOTHING.highest * rate
    wanted = wider * _motion_bandwidth(segment)
    cutoff_hz = np.clip(wanted, 4 * rate / len(q), widest)
    pairs = zip(q.T, cutoff_hz.tolist(), strict=True)
    smooth = np.column_stack([low_pass(channel, hz, rate) for channel, hz in pairs])
    keep = segment.keep
    moves = segment.motion.dq.any(axis=0)  # a joint that stands has no edges
    lowest = float(cutoff_hz[moves].min(initial=widest))
    edge = max(keep.start, round(rate / lowest))
    skipped = -(-(edge - keep.start) // keep.step)
    first = keep.start + keep.step * skipped
    inner = slice(first, min(keep.stop, len(t) - edge), keep.step)
    spline = scipy.interpolate.make_interp_spline(t, smooth, k=5)
    motion = Motion(t, *(spline(t, order) for order in range(3)))
    return replace(segment, keep=inner, motion=motion), cutoff_hz


def _motion_bandwidth(segment: Segment) -> Array:
    """Frequency up to which passing positions makes the best acceleration, shape (nv,) [Hz].

    The expected squared error of acceleration, Σ_{f > f_b} (2πf)⁴ (P − N) + Σ_{f ≤ f_b} (2πf)⁴ N
    (signal lost, noise kept), is smallest where Σ_{f ≤ f_b} f⁴ (2N − P) is, P the power density of
    positions and N that of their white noise.
    """
    assert segment.sensors is not None  # of a recording
    q = detrended(segment.motion.q)
    f, power = power_density(q, segment.rate_hz, len(q))
    noise = 2 * segment.sensors.position**2 / segment.rate_hz
    balance = f[:, None] ** 4 * (2 * SMOOTHING.caution * noise - power)
    return f[np.argmin(np.cumsum(balance, axis=0), axis=0)]
