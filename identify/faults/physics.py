"""Rate, units and signs: velocity against position, and torque against the physics of the arm.

Without any model: over windows, ∫ q̇ dt must be Δq. The slope b of one against the other is 1; it is
−1 where a sign is flipped, 180/π or 30/π where the velocity is in degrees or revolutions per
minute, and c for all joints at once where the time runs c times too fast.

With a model, a hypothesis ("positions in degrees", "joint 3 counted the other way", "time twice too
slow") is named when it explains the torque better than the log as it stands: a likelihood ratio
beyond chance in independent rows, at least one joint's squared error halved, and no joint's larger
beyond chance. Y(q, q̇, q̈) = G(q) + D(q, q̇, q̈), and D scales with 1/c² when the time runs c times too
slow. All parameters are free, so nothing depends on the masses given, and filters are set in parts
of the motion's own bandwidth, so that they mean the same whatever the unit of time.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
import scipy

from excitant.identify.drive_gains import gain_doubt, without_effects
from excitant.identify.faults.fault import ALARM, Fault, Log, Remedy, normal_bound
from excitant.identify.least_squares import autocorrelation_time
from excitant.identify.prior import link_coordinates, link_weights, prior_parameters
from excitant.identify.regression import Index
from excitant.identify.spectra import low_pass
from excitant.robots.motion import Array, Motion, read_only
from excitant.robots.regressor import regressor, rigid_body_torque
from excitant.robots.robot import Robot

_WINDOW_S = 0.2
_WINDOW_ROWS = 8
_ENOUGH = 8  # windows in which the joint moves
_CLEAR = 20.0  # resolutions: what counts as moving
_FOLLOWS = 0.9  # correlation from which on one channel is the other's integral
# a scale that is off by less changes inertial torque by less than a tenth
_MARGIN = 0.05
_UNIT_NEAR = 0.03  # of a named factor
_FALLS = 0.1  # of what one rate leaves, two leave at most
_UNITS = {
    180 / np.pi: ("dq", ": dq is in degrees per second"),
    30 / np.pi: ("dq", ": dq is in revolutions per minute"),
    1 / (2 * np.pi): ("dq", ": dq is in revolutions per second"),
    np.pi / 180: ("q", ", as with q in degrees and dq in rad/s"),
    2 * np.pi: ("q", ", as with q in turns and dq in rad/s"),
}
"""Slopes of ∫q̇ dt against Δq that a unit explains, the channel in that unit, and words."""
_RATES = (0.5, 2.0, 0.25, 4.0, 1e-3, 1e3, 1e-6, 1e6, 1e-9, 1e9)
"""Factors by which a clock may be off for a reason."""
_BAND = 8.0  # bandwidth kept, in parts of the motion's rms frequency
_OVERSAMPLED = 8  # rows per period of the cut-off
_ROWS = 1200  # at most
_NYQUIST = 0.2  # of the sampling rate: highest cut-off
_RANK = 1e-10
HALVED = 0.5
_BROAD = np.geomspace(1e-3, 1e3, 25)  # time factors tried first
_NEAR = 0.05  # of a clear factor
_BY_CHANCE = 0.05  # probability of what most joints show by chance
_EXPLAINED = 0.5  # of the torque's variance: the model is worth listening to
# a part of the torque that is to have a sign exceeds the error by so much
_SIGNAL = 3.0
_OFF = 0.3  # of given bodies
_SURE = 2.0  # standard deviations
_FAR = 10.0  # times its limit: no drive does that, whatever its limit is to mean
_TORQUE_UNITS = {100.0: "N·cm", 1000.0: "N·mm", 1e6: "µN·m"}
_WITHIN = 3.0  # times the limit, after a repair
_FEW = 4  # orders, the likeliest by the given bodies, that are looked at closely
_CLEARLY = 0.1  # squares per independent row, errors of the model counted: less needs no search
FITS = 0.25  # squares per independent row: less needs no other order
MODEL_ERROR = 0.05  # of a torque
_NO_TORQUE = 1e-12  # N·m: bodies that need no more need none
_BEYOND = 1.2 * 2 * np.pi  # rad: more than joints turn to one side
_REACHES = 1.1  # of the position limits: what a joint reaches
_IMPOSSIBLE = 3.0  # what it never does


def velocity_faults(log: Log) -> list[Fault]:
    """Faults that show in the velocity against the position."""
    b, error, follows = _slopes(log)
    bound = normal_bound(log.nv)
    wrong = [j for j in follows if abs(b[j] - 1) > max(_MARGIN, bound * error[j])]
    # the factor that all moving joints share, when more than one moves
    common = (
        float(np.median(b[follows])) if len(follows) > 1 and wrong == follows else None
    )
    if common is not None and (np.abs(b[follows] / common - 1) >= _MARGIN).any():
        common = None
    if len(log) > 3 and (np.diff(log.t) == 1.0).all():
        detail = (
            "every time step is exactly 1, so t counts samples "
            f"({log.t[0]:g} to {log.t[-1]:g})"
        )
        if common is None or common <= 0:
            return [Fault("wrong_sample_rate", log.joints, detail, {"step": 1.0})]
        detail += f"; q and dq agree at a step of {1 / common:.4g} s ({common:.4g} Hz)"
        return [_slower(log, common, detail, step=1.0)]
    if wrong and (change := _rate_change(log)) is not None:
        return [change]
    if common is None or common <= 0 or _named(common) is not None:
        return [_of_joint(log, j, float(b[j]), float(error[j])) for j in wrong]
    factor = next((c for c in _RATES if abs(common / c - 1) < _UNIT_NEAR), common)
    detail = (
        f"the time runs {common:.4g} times too {'slow' if common > 1 else 'fast'} for the motion: "
        f"∫dq dt is {common:.4g} ± {np.nanmedian(error):.2g} times the change of q at all "
        f"{len(follows)} moving joints; the median step is {log.step:.4g} s, "
        f"{log.step / factor:.4g} s would fit"
    )
    return [_slower(log, factor, detail, factor=common, slopes=b, errors=error)]


def _windows(log: Log, dq: Array) -> tuple[int, Array, Array]:
    """Rows of a window, Δq and ∫q̇ dt over windows, each of shape (windows, nv)."""
    w = min(max(_WINDOW_ROWS, round(_WINDOW_S / log.step)), len(log) // 20)
    steps = np.diff(log.t)[:, None] * (dq[1:] + dq[:-1]) / 2
    way = np.concatenate([np.zeros((1, dq.shape[1])), steps.cumsum(axis=0)])
    return w, np.diff(log.q[::w], axis=0), np.diff(way[::w], axis=0)


def _slopes(log: Log) -> tuple[Array, Array, list[int]]:
    """Slopes of ∫q̇ dt on Δq (NaN without motion), their standard errors, joints in proportion."""
    b, error = np.full((2, log.nv), np.nan)
    follows: list[int] = []
    if log.dq is None or len(log) < 5 * _WINDOW_ROWS:
        return b, error, follows
    _, dq, dv = _windows(log, log.dq)
    for j, (x, y) in enumerate(zip(dq.T, dv.T, strict=True)):
        clear = np.abs(x) > _CLEAR * log.grain[j]
        if clear.sum() < _ENOUGH or np.ptp(y) == 0:
            continue
        b[j] = x @ y / (x @ x)
        error[j] = np.sqrt(((y - b[j] * x) ** 2 * x**2).sum()) / (x @ x)
        if abs(x @ y) > _FOLLOWS * np.sqrt((x @ x) * (y @ y)):
            follows.append(j)
    return b, error, follows


def _rate_change(log: Log) -> Fault | None:
    """A rate that changes once, all joints alike, while the stamps run on as before."""
    w, x, y = _windows(log, np.asarray(log.dq))
    unit = np.maximum(np.abs(x).max(axis=0), 1e-12)
    x = x / unit
    y = y / unit
    xx, xy, yy = ((a * b).sum(axis=1).cumsum() for a, b in ((x, x), (x, y), (y, y)))
    k = np.arange(_ENOUGH, len(x) - _ENOUGH)
    if not len(k) or (xx[k] <= 0).any() or (xx[-1] - xx[k] <= 0).any():
        return None
    first = xy[k] / xx[k]
    second = (xy[-1] - xy[k]) / (xx[-1] - xx[k])
    left = yy[-1] - first * xy[k] - second * (xy[-1] - xy[k])
    best = int(np.argmin(left))
    before = float(first[best])
    after = float(second[best])
    clear = left[best] <= _FALLS * (yy[-1] - xy[-1] ** 2 / xx[-1])
    if not clear or not any(abs(after / before / r - 1) < _MARGIN for r in _RATES):
        return None
    at = float(log.t[(int(k[best]) + 1) * w])
    detail = (
        f"the sample rate changes near t = {at:.4g} s though the stamps run on: ∫dq dt is "
        f"{before:.4g} times the change of q before and {after:.4g} times after, at all moving "
        f"joints alike; cut the recording there and stretch the time of one part"
    )
    evidence = {"at": at, "before": before, "after": after}
    return Fault("wrong_sample_rate", log.joints, detail, evidence)


def _named(slope: float) -> float | None:
    return next(
        (factor for factor in _UNITS if abs(abs(slope) / factor - 1) < _UNIT_NEAR), None
    )


def _slower(log: Log, factor: float, detail: str, /, **evidence: object) -> Fault:
    """The fault of a clock that runs so many times too slow."""
    done = f"divides the time by {factor:.5g}"
    remedy = Remedy("scale", "t", factor=1 / factor)
    known = {"factor": factor, **evidence}
    return Fault("wrong_sample_rate", log.joints, detail, known, done, (remedy,))


def _of_joint(log: Log, j: int, b: float, error: float) -> Fault:
    joint = log.joints[j]
    unit = _named(b)
    sign = float(np.sign(b))
    fault = "wrong_unit"
    flipped = ", and its sign is flipped" if b < 0 else ""
    channel, what = (
        _UNITS[unit] if unit else ("dq", ": no unit that is known, a scale is wrong")
    )
    factor = unit or abs(b)
    repair = f"divides dq of {joint} by {sign * (unit or abs(b)):.6g}"
    remedy = Remedy("scale", channel, (j,), factor=sign / factor)
    if abs(b + 1) <= _MARGIN:
        fault = "wrong_sign"
        what = ": dq has the opposite sign of q"
        flipped = ""
        repair = f"negates dq of {joint}"
        remedy = replace(remedy, factor=-1.0)
    elif channel == "q":
        repair = f"multiplies q of {joint} by {factor:.6g}"
        remedy = replace(remedy, factor=sign * factor)
    detail = f"∫dq dt of {joint} is {b:.4g} ± {error:.2g} times the change of its q{what}{flipped}"
    evidence = {"channel": channel, "slope": b, "error": error}
    return Fault(fault, (joint,), detail, evidence, repair, (remedy,))


class Smooth(NamedTuple):
    """A log in its motion's own bandwidth, evenly sampled at N instants."""

    motion: Motion
    dry: Array  # signs of the velocities through the same filter, shape (N, nv)
    tau: Array  # likewise, shape (N, nv)
    cutoff: float  # of the filters [1/time unit of the log]
    rate: float  # rows per time unit of the log


def smooth(log: Log) -> Smooth | None:
    """Filter, differentiate and decimate; None when the log is too short for it."""
    if not 99 <= log.duration / log.step <= 4 * len(log) or np.ptp(log.q) == 0:
        return None
    grid = np.arange(log.t[0], log.t[-1] + 1e-9 * log.step, log.step)
    rate = 1 / log.step
    span = np.std(log.q, axis=0)
    frequency = 0.0
    moved = span > 50 * log.grain
    if moved.any():
        speed = np.sqrt((log.travel[:, moved] ** 2).mean(axis=0)) / log.step
        frequency = float((speed / span[moved]).max() / (2 * np.pi))
    least = 2 * _BAND / (grid[-1] - grid[0])
    cutoff = min(max(_BAND * frequency, least), _NYQUIST * rate)
    q, tau = (
        low_pass(
            np.column_stack([np.interp(grid, log.t, c) for c in x.T]), cutoff, rate
        )
        for x in (log.q, log.tau)
    )
    spline = scipy.interpolate.make_interp_spline(grid, q, k=5)
    stride = max(1, int(rate / (_OVERSAMPLED * cutoff)), len(grid) // _ROWS)
    at = grid[::stride]
    motion = Motion(at, spline(at), spline.derivative(1)(at), spline.derivative(2)(at))
    dry = low_pass(np.sign(spline.derivative(1)(grid)), cutoff, rate)[::stride]
    return Smooth(motion, dry, tau[::stride], cutoff, rate / stride)


class TorqueFit:
    """Least squares of a log's filtered torque on everything that is free, by normal equations.

    Columns of the links at rest G and what motion adds D, (N, nv, 10 nv), of each joint's own
    effects F, (N, nv, 4). ``factor`` multiplies positions. Where currents were recorded, columns of
    the links are in ampere, by the drive gains that suit the given bodies best, whose relative
    uncertainty is ``loose``, (nv,).
    """

    def __init__(
        self,
        robot: Robot,
        log: Log,
        data: Smooth,
        joints: list[int],
        factor: Array | float = 1.0,
    ) -> None:
        q, dq, ddq = (
            x * factor for x in (data.motion.q, data.motion.dq, data.motion.ddq)
        )
        still = np.zeros_like(q)
        G = regressor(robot, Motion(data.motion.t, q, still, still))
        D = regressor(robot, Motion(data.motion.t, q, dq, ddq)) - G
        dry = data.dry * np.sign(factor)
        F = np.stack([dq, dry, ddq, np.ones_like(q)], axis=2)
        self.robot = robot
        self.log = log
        self.data = data
        self.joints = joints
        self.G, self.D, self.F, self.tau = map(self.filtered, (G, D, F, data.tau))
        self.loose: Array = np.zeros(robot.nv)
        if log.unit != "N·m":
            per, self.loose = self._readings_per_torque()
            self.G = per[:, None] * self.G
            self.D = per[:, None] * self.D
        self.size: Array = np.maximum((self.tau**2).mean(axis=0), 1e-300)
        self.freedom = p = 14 * robot.nv
        self._A = tuple(np.zeros((len(joints), p, p)) for _ in range(3))
        self._b = tuple(np.zeros((len(joints), p)) for _ in range(2))
        for k, j in enumerate(joints):
            links, effects = self._own(j)
            own = np.append(links, effects)
            m = len(links) + 4
            X = np.column_stack(
                [self.G[:, j, links], self.F[:, j], self.D[:, j, links]]
            )
            C = X.T @ X
            c = X.T @ self.tau[:, j]
            self._A[0][k][np.ix_(own, own)] = C[:m, :m]
            self._A[1][k][np.ix_(own, links)] = C[:m, m:]
            self._A[1][k] += self._A[1][k].T
            self._A[2][k][np.ix_(links, links)] = C[m:, m:]
            self._b[0][k, own] = c[:m]
            self._b[1][k, links] = c[m:]
        A = np.sum(self._A, axis=0)
        b = np.sum(self._b, axis=0)
        self.sigma = np.sqrt(self._left(A, b, np.array(list(map(_solve, A, b)))))

    def _own(self, j: int) -> tuple[Index, Index]:
        """Parameters on which a joint's torque depends: of no link before it, its own effects."""
        links = 10 * self.robot.nv
        return np.arange(10 * j, links), np.arange(links + 4 * j, links + 4 * j + 4)

    def filtered(self, values: Array) -> Array:
        """Values at the instants of the motion, (n, ...), filtered once more; its ends left out."""
        rate = self.data.rate
        cutoff = self.data.cutoff
        edge = round(rate / cutoff)
        low = min(cutoff / 2, 0.45 * rate)
        return low_pass(values, low, rate, slice(edge, len(values) - edge))

    def _left(self, A: Array, b: Array, x: Array) -> Array:
        """Mean square that parameters leave of each of the joints' torque."""
        size = self.size[self.joints]
        x = np.broadcast_to(x, b.shape)
        left = size - ((2 * b - np.einsum("jkl,jl->jk", A, x)) * x).sum(axis=1) / len(
            self.tau
        )
        return np.asarray(np.maximum(left, 1e-10 * size))

    def fit(self, s: float = 1.0, sign: Array | None = None) -> tuple[Array, Array]:
        """Parameters and mean square left of each torque; what motion adds is multiplied by s."""
        A = self._A[0] + s * self._A[1] + s**2 * self._A[2]
        b = self._b[0] + s * self._b[1]
        b = b if sign is None else sign[self.joints, None] * b
        x = _solve(np.tensordot(self.sigma**-2, A, 1), self.sigma**-2 @ b)
        power = self.size.copy()
        power[self.joints] = self._left(A, b, x)
        return x, power

    @cached_property
    def power(self) -> Array:
        """Mean square residual torque of each joint with the log as it stands, shape (nv,)."""
        return self.fit()[1]

    @cached_property
    def rows(self) -> Array:
        """Independent rows of each joint's error, shape (nv,)."""
        rows = np.ones(self.robot.nv)
        x = self.fit()[0]
        for j in self.joints:
            links, effects = self._own(j)
            columns = self.G[:, j, links] + self.D[:, j, links]
            error = self.tau[:, j] - columns @ x[links] - self.F[:, j] @ x[effects]
            rows[j] = len(error) / autocorrelation_time(error) if error.any() else 1.0
        return rows

    def _readings_per_torque(self) -> tuple[Array, Array]:
        """Current that a joint of the given bodies needs per torque, its relative std, (nv,)."""
        robot = self.robot
        columns = self.G + self.D
        found = np.ones(robot.nv)
        loose = np.zeros(robot.nv)
        near = (
            spread(robot)
            if (robot.phi[::10] > 0).all()
            else np.zeros((len(robot.phi), 1))
        )
        for j in self.joints:
            Y, read = without_effects(self.F[:, j], columns[:, j], self.tau[:, j])
            model = Y @ robot.phi
            squares = max(float(model @ model), len(model) * _NO_TORQUE**2)
            gain = float(model @ read) / squares
            error = read - gain * model
            noise = float(error @ error) / len(error) * autocorrelation_time(error)
            found[j] = max(abs(gain), 1e-300)
            by_noise = np.sqrt(noise / squares) / found[j]
            loose[j] = np.hypot(by_noise, gain_doubt(Y, robot.phi, near))
        return found, loose

    def gain(self, power: Array) -> float:
        """Twice the log-likelihood ratio of another reading against the log as it stands."""
        return float((self.rows * np.log(self.power / power))[self.joints].sum())

    def better(self, power: Array, tests: int, freedom: int | None = None) -> bool:
        """Whether another of some readings, with ``freedom`` more parameters, is beyond chance."""
        ratio = (power / self.power)[self.joints]
        rows = self.rows[self.joints]
        worse = (rows * np.log(ratio)).max() > scipy.special.chdtri(
            1, ALARM / len(rows)
        )
        bound = float(scipy.special.chdtri(freedom or self.freedom, ALARM / tests))
        return self.gain(power) > bound and bool(ratio.min() < HALVED and not worse)

    def surprise(self, noise: Array, rows: Array, S: Array) -> tuple[float, float]:
        """Squares that bodies near the given ones φ̄ leave, and −2 log of the evidence for them.

        Noise is a mean square of each joint, shape (nv,), in so many independent rows; a twentieth
        of the torque comes to it. Bodies are φ̄ + S z, z of unit variance, S (10 nv, 10 nv), gains
        of drives are off by what is not known of them, and each joint's own effects free, but that
        friction brakes.
        """
        weight = (rows / len(self.tau) / (noise + MODEL_ERROR**2 * self.size))[
            self.joints
        ]
        A = np.sum(self._A, axis=0)
        b = np.sum(self._b, axis=0)
        y = self.size * len(self.tau)
        bodies = self.robot.phi
        links = len(self.robot.phi)
        # a gain that is off by N(0, loose²) is projected out of each joint's columns
        v = A[:, :, :links] @ bodies
        t = b[:, :links] @ bodies
        loose = self.loose[self.joints]
        told = weight * (v[:, :links] @ bodies) * loose**2
        share = (weight * loose**2 / (1 + told))[:, None]
        A = A - share[:, :, None] * v[:, :, None] * v[:, None, :]
        b = b - share * t[:, None] * v
        y = y[self.joints] - share[:, 0] * t**2
        G = np.tensordot(weight, A, 1)
        h = weight @ b
        whole = h
        h = h - G[:, :links] @ bodies
        effects = np.eye(len(h) - links)
        own = _solve(
            G[links:, links:], np.column_stack([effects, G[links:, :links], h[links:]])
        )
        alone = own[:, : len(effects)]
        per_body = own[:, len(effects) : -1]
        own = own[:, -1]
        H = S.T @ (G[:links, :links] - G[:links, links:] @ per_body) @ S + np.eye(links)
        z = np.linalg.solve(H, S.T @ (h[:links] - G[:links, links:] @ own))
        x = np.concatenate([bodies + S @ z, own - per_body @ (S @ z)])
        left = max(
            float(weight @ y - (2 * whole - G @ x) @ x), 1e-10 * float(weight @ y)
        )
        unsure = alone + (M := per_body @ S) @ np.linalg.solve(H, M.T)
        squares = left + float(z @ z) + self._driving(x[links:], unsure)
        occam = float(np.linalg.slogdet(H)[1] + np.log1p(told).sum())
        return squares, squares + occam

    def _driving(self, own: Array, covariance: Array) -> float:
        """Squared standard errors by which joints' own effects have friction that drives them."""
        total = 0.0
        for j in self.joints:
            dq = self.F[:, j, 0]
            at = slice(4 * j, 4 * j + 2)
            power = dq @ self.F[:, j, :2]
            variance = float(power @ covariance[at, at] @ power)
            total += min(float(power @ own[at]), 0.0) ** 2 / max(variance, 1e-300)
        return total

    def compared(self, power: Array) -> str:
        """Improvement by another reading, in words."""
        ratio = np.sqrt(power / self.power)[self.joints]
        best = self.joints[int(np.argmin(ratio))]
        return (
            f"the error of the best model of its torque falls to {100 * ratio.min():.2g} % at "
            f"{self.log.joints[best]} (likelihood ratio {self.gain(power):.3g} in "
            f"{self.rows[self.joints].sum():.0f} independent rows)"
        )


def torque_fit(
    robot: Robot, log: Log, data: Smooth, dead: set[str]
) -> TorqueFit | None:
    """The fit of a log's torque; None when no joint's torque can be used."""
    alive = [
        j
        for j in range(robot.nv)
        if log.joints[j] not in dead and np.ptp(data.tau[:, j]) > 0
    ]
    case = TorqueFit(robot, log, data, alive) if alive else None
    return case if case and len(case.tau) >= 60 else None


def unlike(robot: Robot, data: Smooth) -> Array:
    """Share of each torque of a log that the given bodies and own effects leave, (nv,).

    The bodies' torque counts up to a factor of each joint.
    """
    model = rigid_body_torque(robot, data.motion)
    motion = data.motion
    F = np.stack([motion.dq, data.dry, motion.ddq, np.ones_like(motion.q)], axis=2)
    shares = []
    for j in range(robot.nv):
        wanted, read = without_effects(F[:, j], model[:, j], data.tau[:, j])
        factor = max(float(wanted @ read), 0.0) / max(float(wanted @ wanted), 1e-300)
        shares.append(float(((read - factor * wanted) ** 2).sum()))
    whole = (data.tau**2).sum(axis=0)
    return np.asarray(
        np.maximum(shares / np.maximum(whole, 1e-300), MODEL_ERROR**2), float
    )


def scaled_least_squares(W: Array, y: Array) -> tuple[Array, Array, Array]:
    """Columns scaled to a mean square of 1, their coefficients, and what is left of y."""
    size = np.sqrt((W**2).mean(axis=0))
    W = W / np.where(size > 0, size, 1.0)
    x = np.asarray(np.linalg.lstsq(W, y, rcond=_RANK)[0], float)
    return W, x, y - W @ x


def fits(case: TorqueFit, S: Array) -> bool:
    """Whether bodies near the given ones explain the torque so well that nothing is off."""
    return case.surprise(0 * case.power, case.rows, S)[0] < _CLEARLY * float(
        case.rows.sum()
    )


def _solve(A: Array, b: Array) -> Array:
    d = np.sqrt(np.maximum(np.diag(A), 0.0))  # rounding leaves some below zero
    d = np.where(d > 0, d, 1.0)
    values, V = np.linalg.eigh(A / np.outer(d, d))
    kept = values > _RANK * max(float(values[-1]), 1e-300)
    V = V[:, kept] / d[:, None]
    return np.asarray(V @ ((V.T @ b).T / values[kept]).T, float)


def degrees(case: TorqueFit) -> Iterator[Fault]:
    """Positions in degrees, of all joints or of those beyond a turn."""
    log = case.log
    largest = np.abs(case.log.q).max(axis=0)
    turning = np.asarray(case.robot.revolute)
    beyond = turning & (largest > _BEYOND)
    if not beyond.any():
        return
    tried = []
    for mask in [turning] if beyond.all() else [turning, beyond]:
        factor = np.where(mask, np.pi / 180, 1.0)
        power = TorqueFit(case.robot, log, case.data, case.joints, factor).power
        tried.append((case.gain(power), np.flatnonzero(mask), power))
    gain, joints, power = max(tried, key=lambda reading: reading[0])
    widest = int(np.argmax(largest))
    reach = np.abs(case.robot.limits.position).max(axis=1)[joints]
    within = (largest[joints] * np.pi / 180 < _REACHES * reach).all()
    impossible = within and (largest[joints] > _IMPOSSIBLE * reach).any()
    if not case.better(power, len(tried)) and not (impossible and gain > 0):
        return
    detail = (
        f"q is in degrees: it reaches {largest[widest]:.4g} at {log.joints[widest]}, and read in "
        f"degrees {case.compared(power)}"
    )
    done = "multiplies q and dq, which agrees with it, by π/180"
    remedies = [
        Remedy("scale", name, tuple(joints), factor=np.pi / 180) for name in ("q", "dq")
    ]
    evidence = {"channel": "q", "gain": gain, "largest": largest}
    yield Fault(
        "wrong_unit", log.names(joints), detail, evidence, done, tuple(remedies)
    )


def torque_unit(case: TorqueFit) -> Iterator[Fault]:
    """Torques far beyond what the drives can do, or where no limit is known, beyond the model's."""
    log = case.log
    joints = case.joints
    if log.unit != "N·m":
        return
    limit = case.robot.limits.torque[joints]
    peak = np.abs(log.tau[:, joints]).max(axis=0)
    known = np.isfinite(limit)
    if known.any():
        sizes = (peak / limit)[known]
        what = "the torque limit"
        far = np.median(sizes) > _FAR
    else:
        model = (case.G + case.D) @ case.robot.phi
        doubt = _doubt(case)
        signs = [(_signs(case, model[:, j], j), doubt[j]) for j in joints]
        clear = [s[0] for s, u in signs if s[1] > 0 and s[3] > _EXPLAINED and u < _OFF]
        sizes = np.array(clear)
        what = "the torque of the given model"
        far = len(sizes) > 0 and np.median(sizes) > _FAR**1.5
    if not far:
        return
    typical = float(np.median(sizes))
    factor = next(
        (f for f in _TORQUE_UNITS if typical / f < _WITHIN), max(_TORQUE_UNITS)
    )
    unit = _TORQUE_UNITS[factor]
    detail = f"tau is {typical:.3g} times {what} (median over joints), as in {unit}"
    remedy = Remedy("scale", "tau", tuple(range(log.nv)), factor=1 / factor)
    done = f"divides tau by {factor:g}"
    evidence = {"channel": "tau", "factor": typical}
    yield Fault("wrong_unit", log.joints, detail, evidence, done, (remedy,))


def order(case: TorqueFit) -> Iterator[Fault]:
    """Columns of joints in another order: two exchanged, all shifted, reversed or by name."""
    log = case.log
    n = case.robot.nv
    if not len(case.joints) == n > 1 or (case.robot.phi[::10] <= 0).any():
        return
    same = list(range(n))
    orders = {tuple(same[::-1]), (*same[1:], 0), (n - 1, *same[:-1])}
    orders.add(tuple(np.argsort(np.argsort(log.joints)).tolist()))
    for i in same:
        for k in same[:i]:
            swap = same.copy()
            swap[i], swap[k] = k, i
            orders.add(tuple(swap))
    known = spread(case.robot)
    data = case.data
    if fits(case, known):
        return
    tried = list[tuple[float, list[int], tuple[str, ...], Smooth]]()
    found = []
    for order in sorted(orders - {tuple(same)}):
        at = list(order)
        columns = (getattr(data.motion, name)[:, at] for name in ("q", "dq", "ddq"))
        moved = data._replace(
            motion=Motion(data.motion.t, *columns), dry=data.dry[:, at]
        )
        every: tuple[str, ...] = ("q", "dq", "tau")
        for channels, whole in ((every, moved), (every[2:], data)):
            other = whole._replace(tau=data.tau[:, at])
            left = float(case.rows[at] @ np.log(unlike(case.robot, other)))
            tried.append((left, at, channels, other))
    for _, at, channels, other in sorted(tried, key=lambda each: each[0])[:_FEW]:
        fit = TorqueFit(case.robot, log, other, case.joints)
        noise = np.minimum(
            case.power[at], fit.power
        )  # joint j is the one recorded as at[j]
        left = fit.surprise(noise, case.rows[at], known)[0]
        back = np.argsort(at)
        found.append(
            (case.surprise(noise[back], case.rows, known)[0], left, at, channels)
        )
    as_it_stands, left, at, channels = max(
        found, key=lambda each: each[0] / max(each[1], 1e-9)
    )
    bound = float(scipy.special.chdtri(n, ALARM / len(tried)))
    dispersion = max(
        1.0, left / float(case.rows.sum())
    )  # errors of the model count as noise
    if as_it_stands - left < bound * dispersion or left > HALVED * as_it_stands:
        return
    wrong = [j for j in same if at[j] != j]
    words = ", ".join(
        f"{log.joints[j]} is recorded as {log.joints[at[j]]}" for j in wrong
    )
    what = "columns" if len(channels) > 1 else "torque columns"
    detail = (
        f"{what} are in another order: {words}; so read, the torque is that of bodies near the "
        f"given ones (sum of squares {as_it_stands:.3g} → {left:.3g} in {case.rows.sum():.0f} "
        "independent rows)"
    )
    remedies = tuple(Remedy("order", channel, tuple(at)) for channel in channels)
    done = f"puts the {what} of {len(wrong)} joints in the order of the robot"
    evidence = {
        "order": log.names(at),
        "channels": channels,
        "gain": as_it_stands - left,
    }
    yield Fault("wrong_order", log.names(wrong), detail, evidence, done, remedies)


def position_signs(case: TorqueFit) -> Iterator[Fault]:
    """Joints whose positions count the other way, whatever the given bodies are."""
    for j, joint in enumerate(case.log.joints):
        flip = np.where(np.arange(case.robot.nv) == j, -1.0, 1.0)
        negated = TorqueFit(case.robot, case.log, case.data, case.joints, flip)
        readings = (
            ("q", ("q", "dq"), negated.power),
            ("q and tau", ("q", "dq", "tau"), negated.fit(sign=flip)[1]),
        )
        for what, channels, power in readings:
            if case.better(power, 2 * case.robot.nv):
                yield Fault(
                    "wrong_sign",
                    (joint,),
                    f"{what} of {joint} count the other way than the robot's: negated, "
                    f"{case.compared(power)}",
                    {"channel": what, "gain": case.gain(power)},
                    f"negates {what} (and dq) of {joint}",
                    tuple(
                        Remedy("scale", name, (j,), factor=-1.0) for name in channels
                    ),
                )


def rate(case: TorqueFit) -> Iterator[Fault]:
    """Profile likelihood over a factor of the time: inertial torque goes with its square."""

    def gain(logarithm: float) -> float:
        return case.gain(case.fit(s=float(np.exp(2 * logarithm)))[1])

    def bound(side: int) -> float:
        """Factor at which the likelihood has fallen by its 95 % bound."""
        width = 0.01
        while gain(peak) - gain(peak + side * width) < 3.84 and width < 3:
            width *= 1.5
        return float(np.exp(peak + side * width))

    start = max(np.log(_BROAD).tolist(), key=gain)
    step = np.log(_BROAD[1] / _BROAD[0])
    peak = scipy.optimize.minimize_scalar(
        lambda x: -gain(x),
        bounds=(start - step, start + step),
        method="bounded",
        options={"xatol": 1e-3, "maxiter": 25},
    ).x
    c = float(np.exp(peak))
    log = case.log
    power = case.fit(s=c**2)[1]
    near = [r for r in _RATES if abs(c / r - 1) < _NEAR]
    freedom = (
        1 if near else None
    )  # an odd factor may stand for anything the model lacks
    if abs(c - 1) < 2 * _NEAR or not case.better(power, len(_BROAD), freedom):
        return
    each = (case.rows * np.log(case.power / power))[case.joints]
    if np.median(each) < scipy.special.chdtri(1, _BY_CHANCE):
        return  # a clock is wrong for all joints
    low = bound(-1)
    high = bound(1)
    factor = near[0] if near else c
    detail = (
        f"the time runs {c:.3g} times too {'slow' if c > 1 else 'fast'} for the torque "
        f"(95 % between {low:.3g} and {high:.3g}): so corrected, {case.compared(power)}; the "
        f"median step is {log.step:.4g} s, {log.step / factor:.4g} s would fit"
    )
    yield _slower(
        log, factor, detail, factor=c, interval=(low, high), gain=case.gain(power)
    )


def torque_signs(case: TorqueFit) -> Iterator[Fault]:
    """Torques whose gain g on the model, or whose friction power, is negative beyond chance.

    τ_j = g τ_model + F_v q̇ + F_c sign q̇ + I_a q̈ + offset; neither may object to the other. A gain
    says nothing where the given bodies, if they were off by 30 %, might have reversed it.
    """
    model = (case.G + case.D) @ case.robot.phi
    doubt = _doubt(case)
    bound = normal_bound(2 * len(case.joints))
    for j in case.joints:
        g, gain, friction, explained = _signs(case, model[:, j], j)
        gain *= abs(g) > _SURE * doubt[j]
        votes = [z for z in (gain, friction) if abs(z) > bound]
        if explained < _EXPLAINED or not votes or max(votes) > 0:
            continue
        joint = case.log.joints[j]
        why = []
        if gain < -bound:
            why.append(
                f"it is {gain:.1f} standard errors opposite to the given model's torque"
            )
        if friction < -bound:
            why.append(
                f"its friction would drive the joint by {-friction:.1f} standard errors"
            )
        yield Fault(
            "wrong_sign",
            (joint,),
            f"tau of {joint} has the wrong sign: {' and '.join(why)} "
            f"({100 * explained:.0f} % of its variance explained)",
            {
                "channel": "tau",
                "gain": gain,
                "friction": friction,
                "explained": explained,
            },
            f"negates tau of {joint}",
            (Remedy("scale", "tau", (j,), factor=-1.0),),
        )


@lru_cache(maxsize=8)
def spread(robot: Robot) -> Array:
    """Root of the covariance of bodies near the given ones, to 30 %, (10 nv, 10 nv)."""
    return read_only(
        link_coordinates(prior_parameters(robot)) / link_weights(robot.nv, _OFF)
    )


def _doubt(case: TorqueFit) -> Array:
    """Standard deviation of each joint's gain on the model if its bodies are off by 30 %, (nv,)."""
    robot = case.robot
    columns = case.G + case.D
    doubt = np.zeros(case.robot.nv)
    if (robot.phi[::10] > 0).all():
        near = spread(robot)
        for j in case.joints:
            [Y] = without_effects(case.F[:, j], columns[:, j])
            doubt[j] = gain_doubt(Y, robot.phi, near)
    return doubt


def _signs(case: TorqueFit, model: Array, j: int) -> tuple[float, float, float, float]:
    """Gain; it and friction power in standard errors, 0 within the error; variance explained."""
    dq, dry, y = *case.F[:, j, :2].T, case.tau[:, j]
    columns = np.column_stack([model, case.F[:, j]])
    W, x, error = scaled_least_squares(columns, y)
    left = float(error.std())
    independent = max(len(y) / autocorrelation_time(error), 8.0)
    C = np.linalg.pinv(W.T @ W / len(y), rcond=1e-10) * left**2 / independent
    size = np.sqrt((columns[:, 1:3] ** 2).mean(axis=0))
    power = np.array([(dq * dq).mean(), np.abs(dq * dry).mean()]) / np.where(
        size > 0, size, 1.0
    )
    z = []
    for part, weight in ((slice(0, 1), np.ones(1)), (slice(1, 3), power)):
        clear = (W[:, part] @ x[part]).std() > _SIGNAL * left
        variance = float(weight @ C[part, part] @ weight)
        z.append(
            float(weight @ x[part] / np.sqrt(max(variance, 1e-300))) if clear else 0.0
        )
    gain = float(x[0]) / max(float(np.sqrt((model**2).mean())), 1e-300)
    return gain, z[0], z[1], 1 - float(error.var() / max(y.var(), 1e-300))
