"""Units, order, signs and rate: torque against the physics of the arm.

A hypothesis ("positions in degrees", "joint 3 counted the other way", "time twice too slow") is
named when it explains the torque better than the log as it stands: a likelihood ratio beyond chance
in independent rows, at least one joint's squared error halved, and no joint's larger beyond chance.
Y(q, q̇, q̈) = G(q) + D(q, q̇, q̈), and D scales with 1/c² when the time runs c times too slow. All
parameters are free, so nothing depends on the masses given, and filters are set in parts of the
motion's own bandwidth, so that they mean the same whatever the unit of time.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import cached_property, lru_cache
from itertools import combinations
from typing import NamedTuple

import numpy as np
import scipy

from excitant.identify.drive_gains import BODY_STD, gain_doubt, without_effects
from excitant.identify.faults.fault import ALARM, Fault, Log, Remedy, normal_bound
from excitant.identify.faults.time import RATES, clock_confirmed, slow_clock
from excitant.identify.least_squares import autocorrelation_time
from excitant.identify.prior import link_coordinates, link_weights, prior_parameters
from excitant.identify.signals import low_pass
from excitant.robots.motion import Array, Motion, read_only
from excitant.robots.regressor import regressor, rigid_body_torque
from excitant.robots.robot import Robot

MODEL_ERROR = 0.05  # of a torque's rms: errors of the model that count as noise
HALVED = 0.5  # of a squared error: what a hypothesis must bring it below
_BAND = 8.0  # bandwidth kept, in parts of the motion's rms frequency
_RANK_TOLERANCE = 1e-10  # of the largest eigenvalue or singular value
EXPLAINED = 0.5  # of the torque's variance: the model is worth listening to
_FAR = 10.0  # times its limit: no drive does that, whatever the limit means
_TORQUE_UNITS = {100.0: "N·cm", 1000.0: "N·mm", 1e6: "µN·m"}
_BROAD = np.geomspace(1e-3, 1e3, 25)  # time factors tried first
_MOTION = ("q", "dq", "ddq")
_MOVED = {"q": (*_MOTION, "dry"), "tau": ("tau",)}
"""Arrays of a `Smooth` that a remedy of a channel acts on."""


class Smooth(NamedTuple):
    """A log in its motion's own bandwidth, evenly sampled at N instants."""

    motion: Motion
    dry: Array  # signs of the velocities through the same filter, shape (N, nv)
    tau: Array  # likewise, shape (N, nv)
    cutoff: float  # of the filters [1/time unit of the log]
    rate: float  # rows per time unit of the log

    @property
    def effects(self) -> Array:
        """Columns of each joint's own effects, shape (N, nv, 4)."""
        ones = np.ones_like(self.dry)
        columns = [self.motion.dq, self.dry, self.motion.ddq, ones]
        return np.stack(columns, axis=2)

    def remedied(self, remedies: Iterable[Remedy]) -> Smooth:
        """The log with remedies of time, positions and torque; speeds are those of positions."""
        arrays = {name: np.array(getattr(self.motion, name)) for name in _MOTION}
        arrays |= {"dry": np.array(self.dry), "tau": np.array(self.tau)}
        for remedy in remedies:
            joints = list(remedy.joints)
            if remedy.channel == "t":
                arrays["dq"] /= remedy.factor
                arrays["ddq"] /= remedy.factor**2
            for name in _MOVED.get(remedy.channel, ()):
                values = arrays[name]
                if remedy.action == "order":
                    values[:] = values[:, joints]
                elif name == "dry":
                    values[:, joints] *= np.sign(remedy.factor)
                else:
                    values[:, joints] *= remedy.factor
        motion = Motion(self.motion.t, *(arrays[name] for name in _MOTION))
        return self._replace(motion=motion, dry=arrays["dry"], tau=arrays["tau"])


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
    cutoff = min(max(_BAND * frequency, least), 0.2 * rate)

    def filtered(x: Array) -> Array:
        even = np.column_stack([np.interp(grid, log.t, column) for column in x.T])
        return low_pass(even, cutoff, rate)

    spline = scipy.interpolate.make_interp_spline(grid, filtered(log.q), k=5)
    # eight rows per period of the cut-off, and at most some 1200 in all
    stride = max(1, int(rate / (8 * cutoff)), len(grid) // 1200)
    at = grid[::stride]
    speed = spline.derivative(1)
    motion = Motion(at, spline(at), speed(at), spline.derivative(2)(at))
    dry = low_pass(np.sign(speed(grid)), cutoff, rate)[::stride]
    tau = filtered(log.tau)[::stride]
    return Smooth(motion, dry, tau, cutoff, rate / stride)


class TorqueFit:
    """Least squares of a log's filtered torque on the links, each joint's own effects free.

    Attributes:
        G: Columns of the links at rest, shape (N, nv, 10 nv).
        D: What motion adds to them, likewise.
        F: Columns of each joint's own effects, shape (N, nv, 4).
        tau: Torque, shape (N, nv).
        loose: Where currents were recorded, columns of the links are in ampere, by the drive gains
            that suit the nominal bodies best; their relative standard deviation, shape (nv,).
        per: Those gains, shape (nv,) [A/(N·m)]; else 1.
        size: Mean square of each torque, shape (nv,).
        parts: Of each of ``joints`` the columns of G and D of the links behind it, and the torque,
            less what its own effects explain.
        sigma: Noise of each of ``joints`` when fitted alone.
    """

    def __init__(
        self, robot: Robot, log: Log, data: Smooth, joints: Sequence[int]
    ) -> None:
        """Normal equations of the ``joints`` whose torque counts."""
        self.robot = robot
        self.log = log
        self.data = data
        self.joints = joints
        motion = data.motion
        still = np.zeros_like(motion.q)
        G = regressor(robot, replace(motion, dq=still, ddq=still))
        self.G = self.filtered(G)
        self.D = self.filtered(regressor(robot, motion) - G)
        self.F = self.filtered(data.effects)
        self.tau = self.filtered(data.tau)
        self.loose: Array = np.zeros(robot.nv)
        self.per: Array = np.ones(robot.nv)
        self.size: Array = np.maximum((self.tau**2).mean(axis=0), 1e-300)
        self.parts = [self._part(j) for j in joints]
        if log.unit != "N·m":
            self.per, self.loose = self.readings_per_torque()
            self.G *= self.per[:, None]
            self.D *= self.per[:, None]
            self.parts = [self._part(j) for j in joints]
        self._normal_equations()
        A = self._A.sum(axis=0)
        b = self._b.sum(axis=0)
        alone = np.array(list(map(_solve, A, b)))
        self.sigma = np.sqrt(self._unexplained(A, b, alone))

    @property
    def freedom(self) -> int:
        """Number of parameters."""
        return 14 * self.robot.nv

    def _part(self, j: int) -> tuple[Array, ...]:
        # no joint's torque depends on the links before it
        later = slice(10 * j, None)
        columns = self.G[:, j, later], self.D[:, j, later]
        return without_effects(self.F[:, j], *columns, self.tau[:, j])

    def _normal_equations(self) -> None:
        """A and b of each joint, as polynomials in the factor of D, (3, n, p, p) and (2, n, p)."""
        p = len(self.robot.phi)
        self._A = np.zeros((3, len(self.joints), p, p))
        self._b = np.zeros((2, len(self.joints), p))
        self._squares = np.zeros(len(self.joints))
        for k, (still, moving, tau) in enumerate(self.parts):
            later = slice(p - still.shape[1], None)
            cross = still.T @ moving
            self._A[:, k, later, later] = (
                still.T @ still,
                cross + cross.T,
                moving.T @ moving,
            )
            self._b[:, k, later] = still.T @ tau, moving.T @ tau
            self._squares[k] = tau @ tau

    def filtered(self, values: Array) -> Array:
        """Values at the instants of the motion, (n, ...), filtered once more; its ends left out."""
        rate = self.data.rate
        cutoff = self.data.cutoff
        edge = round(rate / cutoff)
        low = min(cutoff / 2, 0.45 * rate)
        return low_pass(values, low, rate, slice(edge, len(values) - edge))

    def _unexplained(self, A: Array, b: Array, x: Array) -> Array:
        """Mean square that parameters leave of each of the joints' torque."""
        x = np.broadcast_to(x, b.shape)
        explained = ((2 * b - np.einsum("jkl,jl->jk", A, x)) * x).sum(axis=1)
        left = (self._squares - explained) / len(self.tau)
        return np.asarray(np.maximum(left, 1e-10 * self.size[self.joints]))

    def fit(self, s: float = 1.0, sign: Array | None = None) -> tuple[Array, Array]:
        """Parameters and mean square left of each torque; what motion adds is multiplied by s."""
        A = self._A[0] + s * self._A[1] + s**2 * self._A[2]
        b = self._b[0] + s * self._b[1]
        b = b if sign is None else sign[self.joints, None] * b
        x = _solve(np.tensordot(self.sigma**-2, A, 1), self.sigma**-2 @ b)
        power = self.size.copy()
        power[self.joints] = self._unexplained(A, b, x)
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
        for j, (still, moving, tau) in zip(self.joints, self.parts, strict=True):
            error = tau - (still + moving) @ x[10 * j :]
            rows[j] = (
                len(error) / autocorrelation_time(error) if error.any() else 1.0
            )
        return rows

    def readings_per_torque(self) -> tuple[Array, Array]:
        """Readings that a joint of the nominal bodies needs per torque, and their relative std.

        Both have shape (nv,).
        """
        phi = self.robot.phi
        per = np.ones(self.robot.nv)
        std = np.zeros(self.robot.nv)
        doubt = self.gain_std
        for j, (still, moving, current) in zip(
            self.joints, self.parts, strict=True
        ):
            model = (still + moving) @ phi[10 * j :]
            least = 1e-12  # N·m: bodies that need no more need none
            squares = max(float(model @ model), len(model) * least**2)
            gain = float(model @ current) / squares
            error = current - gain * model
            noise = float(error @ error) / len(error) * autocorrelation_time(error)
            per[j] = max(abs(gain), 1e-300)
            by_noise = np.sqrt(noise / squares) / per[j]
            std[j] = np.hypot(by_noise, doubt[j])
        return per, std

    @property
    def gain_std(self) -> Array:
        """Std of each joint's gain on the model if its bodies are off by `BODY_STD`, (nv,)."""
        phi = self.robot.phi
        std = np.zeros(self.robot.nv)
        if (phi[::10] > 0).all():
            near = spread(self.robot)
            for j, (still, moving, _) in zip(self.joints, self.parts, strict=True):
                later = slice(10 * j, None)
                std[j] = gain_doubt(still + moving, phi[later], near[later])
        return std

    def remedied(self, remedies: Iterable[Remedy]) -> TorqueFit:
        """The fit of the log with these remedies."""
        data = self.data.remedied(remedies)
        return TorqueFit(self.robot, self.log, data, self.joints)

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
        """Squares that bodies near the nominal ones φ̄ leave, and −2 log of the evidence for them.

        Bodies are φ̄ + S z, z of unit variance; gains of drives are off by what is not known of
        them; each joint's own effects are free, but that friction brakes.

        Args:
            noise: Mean square of each joint's noise, shape (nv,); `MODEL_ERROR` comes to it.
            rows: Independent rows that it has, shape (nv,).
            S: Root of the covariance of the bodies, shape (10 nv, 10 nv).
        """
        bodies = self.robot.phi
        noise = noise + MODEL_ERROR**2 * self.size
        weight = (rows / len(self.tau) / noise)[self.joints]
        A = self._A.sum(axis=0)
        b = self._b.sum(axis=0)
        # a gain that is off by N(0, loose²) is projected out of each joint's columns
        v = A @ bodies
        t = b @ bodies
        loose = self.loose[self.joints]
        information = weight * (v @ bodies) * loose**2
        share = weight * loose**2 / (1 + information)
        squares = float(weight @ (self._squares - share * t**2))
        G = np.tensordot(weight, A, 1) - (weight * share * v.T) @ v
        h = weight @ b - (weight * share * t) @ v
        H = S.T @ G @ S + np.eye(len(S))
        z = np.linalg.solve(H, S.T @ (h - G @ bodies))
        x = bodies + S @ z
        left = max(squares - float((2 * h - G @ x) @ x), 1e-10 * squares)
        # power of the friction, whose own errors, those of the gain and of bodies add up
        power, variance, reach = self._friction
        along = reach @ bodies
        reach = reach - (along * share)[:, None] * v
        power = power - along * share * t - reach @ x
        variance = variance / weight + along**2 * share / weight
        variance += np.einsum(
            "jp,pj->j", reach @ S, np.linalg.solve(H, (reach @ S).T)
        )
        driving = np.minimum(power, 0.0) ** 2 / np.maximum(variance, 1e-300)
        total = left + float(z @ z) + float(driving.sum())
        occam = float(np.linalg.slogdet(H)[1] + np.log1p(information).sum())
        return total, total + occam

    @cached_property
    def _friction(self) -> tuple[Array, Array, Array]:
        """Power of each joint's friction, variance per noise, derivative by what links explain."""
        power = np.zeros(len(self.joints))
        variance = np.zeros(len(self.joints))
        reach = np.zeros((len(self.joints), len(self.robot.phi)))
        for k, j in enumerate(self.joints):
            F = self.F[:, j]
            weight = np.append(F[:, 0] @ F[:, :2], np.zeros(2))
            x = _solve(F.T @ F, weight)
            power[k] = F @ x @ self.tau[:, j]
            variance[k] = weight @ x
            reach[k] = F @ x @ (self.G[:, j] + self.D[:, j])
        return power, variance, reach

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
    moved = np.ptp(data.tau, axis=0) > 0
    alive = [j for j in range(robot.nv) if log.joints[j] not in dead and moved[j]]
    case = TorqueFit(robot, log, data, alive) if alive else None
    return case if case and len(case.tau) >= 60 else None


def unlike(robot: Robot, data: Smooth) -> Array:
    """Share of each torque of a log that the nominal bodies and own effects leave, (nv,).

    The bodies' torque counts up to a factor of each joint.
    """
    model = rigid_body_torque(robot, data.motion)
    F = data.effects
    squares = []
    for j in range(robot.nv):
        wanted, measured = without_effects(F[:, j], model[:, j], data.tau[:, j])
        along = max(float(wanted @ measured), 0.0)
        factor = along / max(float(wanted @ wanted), 1e-300)
        squares.append(float(((measured - factor * wanted) ** 2).sum()))
    whole = np.maximum((data.tau**2).sum(axis=0), 1e-300)
    return np.asarray(np.maximum(squares / whole, MODEL_ERROR**2), float)


def scaled_least_squares(W: Array, y: Array) -> tuple[Array, Array, Array]:
    """Columns scaled to a mean square of 1, their coefficients, and the residual of y."""
    size = np.sqrt((W**2).mean(axis=0))
    W = W / np.where(size > 0, size, 1.0)
    x = np.asarray(np.linalg.lstsq(W, y, rcond=_RANK_TOLERANCE)[0], float)
    return W, x, y - W @ x


def fits(case: TorqueFit, S: Array) -> bool:
    """Whether bodies near the nominal ones explain the torque so well that nothing is off.

    They leave less than a tenth of a square per independent row, errors of the model counted.
    """
    squares, _ = case.surprise(0 * case.power, case.rows, S)
    return squares < 0.1 * float(case.rows.sum())


def _solve(A: Array, b: Array) -> Array:
    """Solution of least norm of A x = b, A positive semidefinite, in scaled unknowns."""
    d = np.sqrt(np.maximum(np.diag(A), 0.0))  # rounding leaves some below zero
    d = np.where(d > 0, d, 1.0)
    values, V = np.linalg.eigh(A / np.outer(d, d))
    determined = values > _RANK_TOLERANCE * max(float(values[-1]), 1e-300)
    V = V[:, determined] / d[:, None]
    return np.asarray(V @ ((V.T @ b).T / values[determined]).T, float)


def degrees(case: TorqueFit) -> Iterator[Fault]:
    """Positions in degrees, of all joints or of those beyond a turn."""
    log = case.log
    largest = np.abs(log.q).max(axis=0)
    turning = np.asarray(case.robot.revolute)
    # more than joints turn to one side
    beyond = turning & (largest > 1.2 * 2 * np.pi)
    if not beyond.any():
        return
    readings = []
    for mask in [turning] if beyond.all() else [turning, beyond]:
        turned = tuple(np.flatnonzero(mask).tolist())
        scaled = [
            Remedy("scale", name, turned, factor=np.pi / 180)
            for name in ("q", "dq")
        ]
        power = case.remedied(scaled).power
        readings.append((case.gain(power), scaled, power))
    gain, remedies, power = max(readings, key=lambda reading: reading[0])
    joints = list(remedies[0].joints)
    reach = np.abs(case.robot.limits.position).max(axis=1)[joints]
    within = (largest[joints] * np.pi / 180 < 1.1 * reach).all()
    impossible = within and (largest[joints] > 3.0 * reach).any()
    if not case.better(power, len(readings)) and not (impossible and gain > 0):
        return
    widest = int(np.argmax(largest))
    detail = (
        f"q is in degrees: it reaches {largest[widest]:.4g} at {log.joints[widest]}, and read in "
        f"degrees {case.compared(power)}"
    )
    done = "multiplies q and dq, which agrees with it, by π/180"
    evidence = {"channel": "q", "gain": gain, "largest": largest}
    names = log.names(joints)
    yield Fault("wrong_unit", names, detail, evidence, done, tuple(remedies))


def positions_beyond_limits(case: TorqueFit) -> Iterator[Fault]:
    """Joints whose positions leave their limits by more than a turn, or by their whole range."""
    robot = case.robot
    low, high = robot.limits.position.T
    margin = np.where(robot.revolute, 2 * np.pi, high - low)
    reach = np.maximum(case.log.q.max(axis=0) - high, low - case.log.q.min(axis=0))
    beyond = np.flatnonzero(reach > margin)
    if not len(beyond):
        return
    names = case.log.names(beyond)
    worst = int(beyond[np.argmax((reach / margin)[beyond])])
    largest = float(np.abs(case.log.q[:, worst]).max())
    detail = (
        f"q of {', '.join(names)} leaves the joints' limits by more than "
        f"{'a turn' if robot.revolute[worst] else 'their range'}: {case.log.joints[worst]} reaches "
        f"{largest:.4g}, its limits are {low[worst]:.4g} and {high[worst]:.4g}: motor positions, "
        "counts or another unit"
    )
    yield Fault("wrong_unit", names, detail, {"channel": "q", "largest": largest})


def torque_unit(case: TorqueFit) -> Iterator[Fault]:
    """Torques far beyond what the drives can do, or where no limit is known, beyond the model's."""
    log = case.log
    joints = case.joints
    if log.unit != "N·m":
        return
    limit = case.robot.limits.torque[joints]
    peak = np.abs(log.tau[:, joints]).max(axis=0)
    limited = np.isfinite(limit)
    if limited.any():
        what = "the torque limit"
        sizes = (peak / limit)[limited]
        far = _FAR
    else:
        what = "the torque of the given model"
        sizes = np.array(_clear_gains(case))
        far = _FAR**1.5
    if not len(sizes) or np.median(sizes) <= far:
        return
    typical = float(np.median(sizes))
    # after the repair torques stay below three times what they should be
    enough = (size for size in _TORQUE_UNITS if typical / size < 3.0)
    factor = next(enough, max(_TORQUE_UNITS))
    unit = _TORQUE_UNITS[factor]
    detail = f"tau is {typical:.3g} times {what} (median over joints), as in {unit}"
    remedy = Remedy("scale", "tau", tuple(range(log.nv)), factor=1 / factor)
    done = f"divides tau by {factor:g}"
    evidence = {"channel": "tau", "factor": typical}
    yield Fault("wrong_unit", log.joints, detail, evidence, done, (remedy,))


def _clear_gains(case: TorqueFit) -> list[float]:
    """Positive gains of joints on the model that explain their torque and are hardly in doubt."""
    model = (case.G + case.D) @ case.robot.phi
    doubt = case.gain_std
    votes = [(_signs(case, model[:, j], j), doubt[j]) for j in case.joints]
    return [
        vote.gain
        for vote, std in votes
        if vote.gain_z > 0 and vote.explained > EXPLAINED and std < BODY_STD
    ]


def _orders(case: TorqueFit) -> list[tuple[Remedy, ...]]:
    """Two joints exchanged, all shifted, reversed or by name: of all columns, or of torque."""
    n = case.robot.nv
    same = tuple(range(n))
    orders = {same[::-1], (*same[1:], 0), (n - 1, *same[:-1])}
    orders.add(tuple(np.argsort(np.argsort(case.log.joints)).tolist()))
    for i, k in combinations(same, 2):
        swap = [*same]
        swap[i], swap[k] = k, i
        orders.add(tuple(swap))
    return [
        tuple(Remedy("order", channel, joints) for channel in channels)
        for joints in sorted(orders - {same})
        for channels in (("q", "dq", "tau"), ("tau",))
    ]


def order(case: TorqueFit) -> Iterator[Fault]:
    """Columns of joints in another order: two exchanged, all shifted, reversed or by name."""
    log = case.log
    n = case.robot.nv
    if not len(case.joints) == n > 1 or (case.robot.phi[::10] <= 0).any():
        return
    S = spread(case.robot)
    if fits(case, S):
        return
    tried = _orders(case)

    def unlikeness(remedies: Sequence[Remedy]) -> float:
        """Log of the torque's share that the nominal bodies leave, over all rows."""
        left = unlike(case.robot, case.data.remedied(remedies))
        return float(case.rows[[*remedies[0].joints]] @ np.log(left))

    judged = []
    for remedies in sorted(tried, key=unlikeness)[:4]:
        at = [*remedies[0].joints]
        fit = case.remedied(remedies)
        noise = np.minimum(case.power[at], fit.power)
        left, _ = fit.surprise(noise, case.rows[at], S)
        before, _ = case.surprise(noise[np.argsort(at)], case.rows, S)
        judged.append((before, left, remedies))
    before, left, best = max(judged, key=lambda some: some[0] / max(some[1], 1e-9))
    bound = float(scipy.special.chdtri(n, ALARM / len(tried)))
    rows = float(case.rows.sum())
    dispersion = max(1.0, left / rows)  # errors of the model count as noise
    if before - left < bound * dispersion or left > HALVED * before:
        return
    at = [*best[0].joints]
    names = log.names(at)
    wrong = [j for j in range(n) if at[j] != j]
    words = ", ".join(f"{log.joints[j]} is recorded as {names[j]}" for j in wrong)
    what = "columns" if len(best) > 1 else "torque columns"
    detail = (
        f"{what} are in another order: {words}; so read, the torque is that of bodies near the "
        f"given ones (sum of squares {before:.3g} → {left:.3g} in {rows:.0f} "
        "independent rows)"
    )
    done = f"puts the {what} of {len(wrong)} joints in the order of the robot"
    channels = tuple(remedy.channel for remedy in best)
    evidence = {"order": names, "channels": channels, "gain": before - left}
    yield Fault("wrong_order", log.names(wrong), detail, evidence, done, best)


def position_signs(case: TorqueFit) -> Iterator[Fault]:
    """Joints whose positions count the other way, whatever the nominal bodies are."""
    n = case.robot.nv
    for j, joint in enumerate(case.log.joints):
        flip = np.where(np.arange(n) == j, -1.0, 1.0)
        remedies = [
            Remedy("scale", name, (j,), factor=-1.0) for name in ("q", "dq", "tau")
        ]
        negated = case.remedied(remedies[:2])
        readings = (
            ("q", remedies[:2], negated.power),
            ("q and tau", remedies, negated.fit(sign=flip)[1]),
        )
        for what, remedies, power in readings:
            if not case.better(power, len(readings) * n):
                continue
            detail = (
                f"{what} of {joint} count the other way than the robot's: negated, "
                f"{case.compared(power)}"
            )
            evidence = {"channel": what, "gain": case.gain(power)}
            done = f"negates {what} (and dq) of {joint}"
            yield Fault(
                "wrong_sign", (joint,), detail, evidence, done, tuple(remedies)
            )


def rate(case: TorqueFit) -> Iterator[Fault]:
    """Profile likelihood over a factor of the time: inertial torque goes with its square."""
    if clock_confirmed(case.log):
        return

    def gain(logarithm: float) -> float:
        return case.gain(case.fit(s=float(np.exp(2 * logarithm)))[1])

    def bound(side: int) -> float:
        """Factor at which twice the log-likelihood has fallen by its 95 % bound."""
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
    margin = 0.05
    near = [rate for rate in RATES if abs(c / rate - 1) < margin]
    # an odd factor may stand for anything that the model lacks
    freedom = 1 if near else None
    if abs(c - 1) < 2 * margin or not case.better(power, len(_BROAD), freedom):
        return
    of_joints = (case.rows * np.log(case.power / power))[case.joints]
    if np.median(of_joints) < scipy.special.chdtri(1, 0.05):
        return  # by chance at most joints, but a clock is wrong for all of them
    low = bound(-1)
    high = bound(1)
    factor = near[0] if near else c
    detail = (
        f"the time runs {c:.3g} times too {'slow' if c > 1 else 'fast'} for the torque "
        f"(95 % between {low:.3g} and {high:.3g}): so corrected, {case.compared(power)}; the "
        f"median step is {log.step:.4g} s, {log.step / factor:.4g} s would fit"
    )
    evidence = {"factor": c, "interval": (low, high), "gain": case.gain(power)}
    yield slow_clock(log, factor, detail, **evidence)


def torque_signs(case: TorqueFit) -> Iterator[Fault]:
    """Torques whose gain g on the model, or whose friction power, is negative beyond chance.

    τ_j = g τ_model + F_v q̇ + F_c sign q̇ + I_a q̈ + offset; neither may object to the other. A gain
    says nothing where the nominal bodies, off by `BODY_STD`, might have reversed it.
    """
    model = (case.G + case.D) @ case.robot.phi
    doubt = case.gain_std
    bound = normal_bound(2 * len(case.joints))
    for j in case.joints:
        if not case.log.moving[:, j].any():
            continue  # dry friction of a joint that stands could be anything
        votes = _signs(case, model[:, j], j)
        sure = abs(votes.gain) > 2 * doubt[j]
        gain = votes.gain_z * sure
        friction = votes.friction_z
        explained = votes.explained
        clear = [z for z in (gain, friction) if abs(z) > bound]
        if explained < EXPLAINED or not clear or max(clear) > 0:
            continue
        joint = case.log.joints[j]
        why = []
        if gain < -bound:
            off = f"{gain:.1f} standard errors"
            why.append(f"it is {off} opposite to the given model's torque")
        if friction < -bound:
            off = f"{-friction:.1f} standard errors"
            why.append(f"its friction would drive the joint by {off}")
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
    """Root of the covariance of bodies near the nominal ones, to `BODY_STD`, (10 nv, 10 nv)."""
    coordinates = link_coordinates(prior_parameters(robot))
    return read_only(coordinates / link_weights(robot.nv, BODY_STD))


class _Signs(NamedTuple):
    gain: float  # on the model
    gain_z: float  # in standard errors, 0 within the error
    friction_z: float  # power of friction, likewise
    explained: float  # share of the torque's variance


def _signs(case: TorqueFit, model: Array, j: int) -> _Signs:
    """Signs of a joint's gain on its model torque, shape (N,), and of its friction power."""
    y = case.tau[:, j]
    columns = np.column_stack([model, case.F[:, j]])
    W, x, error = scaled_least_squares(columns, y)
    std = float(error.std())
    independent = max(len(y) / autocorrelation_time(error), 8.0)
    C = np.linalg.pinv(W.T @ W / len(y), rcond=1e-10) * std**2 / independent
    dq, dry = case.F[:, j, :2].T
    size = np.sqrt((columns[:, 1:3] ** 2).mean(axis=0))
    size = np.where(size > 0, size, 1.0)
    power = np.array([(dq * dq).mean(), np.abs(dq * dry).mean()]) / size

    def z_of(part: slice, weight: Array) -> float:
        if (W[:, part] @ x[part]).std() <= 3 * std:
            return 0.0  # a part that is to have a sign stands clear of the error
        variance = float(weight @ C[part, part] @ weight)
        return float(weight @ x[part] / np.sqrt(max(variance, 1e-300)))

    gain = float(x[0]) / max(float(np.sqrt((model**2).mean())), 1e-300)
    gain_z = z_of(slice(0, 1), np.ones(1))
    friction_z = z_of(slice(1, 3), power)
    explained = 1 - float(error.var() / max(y.var(), 1e-300))
    return _Signs(gain, gain_z, friction_z, explained)
