"""Residual torque of a model: the share of noise, and the variables that explain the rest.

The share of a quantity is that of the means of the error over its bins (the correlation ratio of
Pearson 1905), less that expected by chance. Shares overlap, so the simplest quantity that
explains nearly as much as the best is the dominant one.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from excitant.analysis.thresholds import STRUCTURED
from excitant.identify.least_squares import autocorrelation_time
from excitant.identify.preprocessing import (
    Segment,
    away_from_rest,
    position_cutoff,
    top_speed,
)
from excitant.identify.rows import states
from excitant.robots.motion import (
    Array,
    Indices,
    Mask,
    power_density,
    root_mean_square,
)
from excitant.robots.regressor import torque_derivatives
from excitant.robots.robot import Robot

QUANTITIES = {
    "constant": "are a constant offset",
    "direction": "vary with the direction of motion",
    "velocity": "vary with velocity",
    "position": "vary with position",
    "load": "vary with load",
    "reversal": "vary with the distance since the last reversal",
    "time": "drift with time",
}
"""Variables that may explain an error, simplest first; load and reversal by direction."""

BINS = 24
TREND_DEGREE = 2  # degree of what changes slowly over time
OUTSIDE_BAND = (
    0.02  # of the power of positions below the lowest frequency of a motion
)

ABOVE_MOTION = 1.5  # times the cut-off: where nothing of the motion is left
PASSED_NOISE = 0.898  # of white noise below the cut-off: ∫ dx / (1 + x⁸)²
NEAR_CUTOFF = (0.6, 0.95)  # of the cut-off
HIGHEST_BAND = (
    1.5  # times the cut-off: up to where noise of positions is looked for
)
POSES = 50  # at which inertia is evaluated
PERIODOGRAM = 512  # samples of a periodogram's stretch
LARGEST_RATIO = 100.0  # of error to noise; larger ones are not quoted


@dataclass(frozen=True, eq=False)
class Explanatory:
    """Explanatory variables at the rows of a hold-out; arrays of shape (n, nv)."""

    position: Array  # [rad or m]
    velocity: Array  # [rad/s or m/s]
    load: Array  # torque of a model [torque unit]
    reversal: Array  # distance since the joint last turned back, signed by velocity [rad or m]
    duration: float  # of all rows [s]
    lowest_hz: Array  # lowest frequency of each joint's motion, shape (nv,) [Hz]


def explanatory(segments: Sequence[Segment], load: Array) -> Explanatory:
    """Explanatory variables at the rows of segments, beside a load (n, nv)."""
    slowest = STRUCTURED.least_direction * top_speed(segments)
    since = [
        since_reversal(s.motion.q, s.motion.dq, slowest)[s.keep] for s in segments
    ]
    motion = states(segments)
    return Explanatory(
        position=motion.q,
        velocity=motion.dq,
        load=load,
        reversal=np.concatenate(since),
        duration=sum(len(s.t) * (s.t[1] - s.t[0]) for s in segments),
        lowest_hz=_lowest_frequency(segments),
    )


def since_reversal(q: Array, dq: Array, slowest: Array) -> Array:
    """Signed distance from where each joint last turned back, or from the start, shape (n, nv)."""
    way = np.where(np.abs(dq) > slowest, np.sign(dq), 0.0)
    at = np.arange(len(q))[:, None]
    last_moved = np.maximum.accumulate(np.where(way != 0, at, 0), axis=0)
    way = np.take_along_axis(way, last_moved, axis=0)
    turned = np.vstack([np.ones((1, q.shape[1]), bool), way[1:] != way[:-1]])
    last = np.maximum.accumulate(np.where(turned, at, 0), axis=0)
    return way * np.abs(q - np.take_along_axis(q, last, axis=0))


def shares(e: Array, by: Explanatory, j: int, rows: Mask) -> dict[str, float]:
    """Share of the power of joint j's error (n,) that each of `QUANTITIES` explains.

    Time is left out where the motion repeats too little to tell a trend from it.
    """
    e = e[rows]
    time = np.flatnonzero(rows).astype(float)
    dq = by.velocity[rows, j]
    load = by.load[rows, j]
    constant = e.mean()
    total = max((e**2).sum(), 1e-300)
    explained = {"constant": _explained(e, constant, 1) / total}
    rest = e - constant
    forward = (dq > 0).astype(np.intp)

    def even(x: Array, bins: int) -> Indices:
        edges = np.quantile(x, np.linspace(0, 1, bins + 1)[1:-1])
        return np.searchsorted(edges, x)

    distance = np.abs(by.reversal[rows, j])
    near = np.searchsorted(
        np.quantile(distance, 0.5 ** np.arange(7, 0, -1)), distance
    )
    bins = {
        "direction": forward,
        "velocity": even(dq, BINS),
        "position": even(by.position[rows, j], BINS),
        "load": 2 * even(load, BINS // 2) + forward,
        "reversal": 2 * near + forward,
    }
    for name, bin_of in bins.items():
        means = (np.bincount(bin_of, rest) / np.maximum(np.bincount(bin_of), 1))[
            bin_of
        ]
        explained[name] = (
            _explained(rest, means, len(np.unique(bin_of)) - 1) / total
        )
    if by.lowest_hz[j] * by.duration >= STRUCTURED.trend_periods:
        trend = np.polynomial.Polynomial.fit(time, rest, TREND_DEGREE)(time)
        explained["time"] = _explained(rest, trend, TREND_DEGREE) / total
    return {
        name: float(np.clip(share, 0.0, 1.0)) for name, share in explained.items()
    }


def _explained(e: Array, fitted: Array | float, freedom: int) -> float:
    """Power of an error that a fit with some coefficients removes, less that by chance."""
    rest = e - fitted
    remaining = (rest**2).sum()
    independent = max(len(e) / autocorrelation_time(rest), 1.0)
    return (e**2).sum() - remaining - remaining * freedom / independent


def _lowest_frequency(segments: Sequence[Segment]) -> Array:
    """Lowest frequency at which each joint moves, shape (nv,) [Hz]."""
    # all but a fiftieth of the power of its positions lies above
    longest = max(segments, key=lambda s: len(s.motion))
    q = longest.motion.q
    f, power = power_density(q, longest.rate_hz, len(q))
    power[0] = 0.0
    reached = np.cumsum(power, axis=0) >= OUTSIDE_BAND * power.sum(axis=0)
    return f[np.argmax(reached, axis=0)]


@dataclass(frozen=True)
class Residual:
    """Residual of one joint's torque while the joint moves [torque unit]."""

    joint: str
    rms: float
    floor: float  # what noise alone would leave
    given: float  # rms that the given model leaves
    correlation_s: float  # how long the error stays correlated [s]
    shares: Mapping[str, float]  # of the error's power, by `QUANTITIES`
    # whether it ever moves: at rest, dry friction holds what is left
    moves: bool = True

    @property
    def structured(self) -> float:
        """Rms of the error beyond the noise [torque unit]."""
        return float(np.sqrt(max(self.rms**2 - self.floor**2, 0.0)))

    @property
    def visible(self) -> bool:
        """Whether it is of motion, slow, well above noise and a material share of the given one."""
        share = self.structured**2 / max(self.given**2, 1e-300)
        return (
            self.moves
            and self.correlation_s > STRUCTURED.correlation_s / 2
            and self.structured > STRUCTURED.visible * self.floor
            and share > STRUCTURED.share
        )

    @property
    def dominant(self) -> str:
        """Simplest quantity that explains nearly as much as the best; empty if none does."""
        enough = max(self.shares.values()) - STRUCTURED.nearly
        if enough < STRUCTURED.explains - STRUCTURED.nearly:
            return ""
        return next(
            name for name in QUANTITIES if self.shares.get(name, -1.0) >= enough
        )

    @property
    def structure(self) -> str:
        """The residual in words."""
        if not self.visible and self.correlation_s < STRUCTURED.correlation_s:
            return "noise-like"
        words = f"structured: stays correlated over {self.correlation_s:.2g} s"
        if not self.dominant:
            return words
        share = f"{100 * self.shares[self.dominant]:.0f} %"
        return f"{words}; {share} {QUANTITIES[self.dominant]}"

    @property
    def against_noise(self) -> str:
        """Ratio of error to noise in words; else the reason why the noise is not known."""
        if self.floor <= STRUCTURED.measurable * max(self.rms, 1e-300):
            return "no noise is seen in the recorded torque, which was smoothed or computed"
        ratio = self.rms / self.floor
        if ratio > LARGEST_RATIO:
            return f"over {LARGEST_RATIO:.0f} times the noise"
        return f"{ratio:.{0 if ratio >= 10 else 1}f} times the noise"


def residuals(
    joints: Sequence[str],
    segments: Sequence[Segment],
    error: Array,
    nominal_error: Array,
    load: Array,
) -> tuple[Residual, ...]:
    """Residual torque of each joint where it moves.

    Error, the given model's error and the load, a model's torque, are (n, nv) [torque unit].
    """
    by = explanatory(segments, load)
    moves = away_from_rest(segments)
    step = segments[0].t[1] - segments[0].t[0]
    cutoff = segments[0].cutoff_hz
    of_joints = []
    for j, joint in enumerate(joints):
        at = moves[:, j] if moves[:, j].any() else ~moves[:, j]
        e = error[at, j]
        of_joints.append(
            Residual(
                joint,
                rms=float(root_mean_square(e)),
                floor=max(
                    noise_floor(segments, j), _fast(error[:, j], 1 / step, cutoff)
                ),
                given=float(root_mean_square(nominal_error[at, j])),
                correlation_s=float(autocorrelation_time(e) * step),
                shares=shares(error[:, j], by, j, at),
                moves=bool(moves[:, j].any()),
            )
        )
    return tuple(of_joints)


def noise_floor(segments: Sequence[Segment], j: int) -> float:
    """Rms that white noise of joint j's raw torque leaves after the filter; 0 if not visible."""
    power = 0.0
    weight = 0
    for s in segments:
        n = len(s.tau_raw)
        f, density = power_density(s.tau_raw[:, j], s.rate_hz, PERIODOGRAM)
        above = density[f > ABOVE_MOTION * s.cutoff_hz]
        if len(above):
            power += n * float(np.median(above)) * PASSED_NOISE * s.cutoff_hz
            weight += n
    return float(np.sqrt(power / weight)) if weight else 0.0


def position_noise(segments: Sequence[Segment]) -> Array:
    """Density of white noise of the positions, shape (nv,) [rad²/Hz or m²/Hz].

    It shows in accelerations as (2πf)⁴ times it between the cut-offs of torque and positions,
    where nothing of the motion is left.
    """
    power = np.zeros(segments[0].motion.q.shape[1])
    weight = 0
    for s in segments:
        n = len(s.motion)
        top = min(HIGHEST_BAND * s.cutoff_hz, 0.45 * s.rate_hz)
        f, density = power_density(s.motion.ddq, s.rate_hz, PERIODOGRAM)
        within = (f > s.cutoff_hz) & (f < top)
        if within.any():
            power += n * np.median(
                density[within] / _slope(s, f[within])[:, None], axis=0
            )
            weight += n
    return power / max(weight, 1)


def _slope(s: Segment, f: Array) -> Array:
    """Power of accelerations over that of the positions they are differentiated from, (m,)."""
    inner = position_cutoff(s.cutoff_hz, s.rate_hz)
    return (2 * np.pi * f) ** 4 / (1 + (f / inner) ** 8) ** 2


def motion_noise(robot: Robot, segments: Sequence[Segment]) -> Array:
    """Rms torque that noise of the positions puts on a model's, shape (nv,) [N·m or N]."""
    white = position_noise(segments)
    power = np.zeros(robot.nv)
    for s in segments:
        f = np.linspace(0.0, s.rate_hz / 2, PERIODOGRAM)
        passed = np.trapezoid(_slope(s, f) / (1 + (f / s.cutoff_hz) ** 8) ** 2, f)
        few = s.motion[:: max(1, len(s.motion) // POSES)]
        inertia = torque_derivatives(robot, few)[2]
        power += len(s.motion) * passed * ((inertia**2).mean(axis=0) @ white)
    return np.sqrt(power / sum(len(s.motion) for s in segments))


def _fast(e: Array, rate_hz: float, cutoff_hz: float) -> float:
    """Rms of an error if its density near the cut-off held at all frequencies below it."""
    f, density = power_density(e, rate_hz, PERIODOGRAM // 4)
    near = density[
        (f > NEAR_CUTOFF[0] * cutoff_hz) & (f < NEAR_CUTOFF[1] * cutoff_hz)
    ]
    return (
        float(np.sqrt(np.median(near) * PASSED_NOISE * cutoff_hz))
        if len(near)
        else 0.0
    )
