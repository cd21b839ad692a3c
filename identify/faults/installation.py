"""Installation of an arm against its model: mounting, zero positions, signs and joint order.

An installation is judged by the squares that bodies near the nominal ones (±30 %, and any tool on
the last link) leave of the torque, each joint's own effects free. Torque is linear in gravity, and
in the zero offset δ of a joint a trigonometric polynomial of degree 2, which five angles determine.
So the columns of any installation are mixtures of a few, and small matrices judge all directions of
gravity and all angles of a joint: the search is global.

Denavit and Hartenberg's standard convention gives inertia in the distal frame, at the next joint, a
URDF at the link's own joint.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
import scipy

from excitant.identify.drive_gains import without_effects
from excitant.identify.faults.fault import (
    ALARM,
    Fault,
    Log,
    Remedy,
    after_repair,
    joints_without_torque,
)
from excitant.identify.faults.physics import (
    EXPLAINED,
    HALVED,
    MODEL_ERROR,
    Smooth,
    TorqueFit,
    degrees,
    fits,
    order,
    position_signs,
    positions_beyond_limits,
    rate,
    scaled_least_squares,
    smooth,
    spread,
    torque_fit,
    torque_signs,
    torque_unit,
    unlike,
)
from excitant.identify.reading.units import sizes_of
from excitant.identify.recording import Recording
from excitant.robots.motion import Array, Motion
from excitant.robots.regressor import regressor
from excitant.robots.robot import Robot

_ANGLES = np.linspace(0, 2 * np.pi, 5, endpoint=False)
"""Zero offsets [rad] that determine a trigonometric polynomial of degree 2."""


@dataclass(frozen=True)
class Search:
    """Settings of the search, with which `benchmarks/planted_faults.py` moves."""

    fits: float = 0.25
    "Squares per independent row, errors of the model counted: less needs no other installation."
    another_body: float = 1 / 0.3
    "Std of a link that is another body than the nominal one, in those of `BODY_STD`."
    tool: float = 10.0
    "Likewise of the last link, which carries a tool."
    rows: int = 600
    "Rows that a search uses, at most."
    directions: int = 200
    "Directions of gravity on the first grid."
    starts: int = 3
    "The best of them that are refined."
    polished: int = 3
    "Times that gravity is refined with the noise that the last installation leaves."
    least_noise: float = 0.01
    "Noise that is assumed then at least, in parts of the torque's rms."
    step: float = np.pi / 18
    "Step of the first grid of zero offsets [rad]."
    right: float = np.pi / 2
    "Zero offsets are multiples of it [rad], unless another angle is better beyond chance."
    hypotheses: int = 12
    "Installations of each joint that are tried."
    rare: float = 0.02
    "Probability that an arm has another installation than its model."
    alike: float = 2.0
    "Twice the log of the ratio of evidence below which two installations look the same."


SEARCH = Search()

CLEAR_GAIN = 0.5  # relative std of a gain by bodies near the nominal ones, below which it is one


@dataclass(frozen=True)
class Scales:
    """Factors between readings and torque that are taken for another unit."""

    least: float = 3.0
    "Smallest: bodies off by `BODY_STD` do not make it at any joint (3.7 std of its logarithm)."
    choices: float = 30.0
    "Of each joint that data tell apart: factors of 1e-3 to 1e3, known to about a half."
    alike: float = 3.0
    "Standard deviations within which factors of joints are one."
    named: float = 0.3
    "Logarithm within which a unit is named: one std of bodies near the nominal ones."


SCALES = Scales()


@dataclass(frozen=True, eq=False)
class _Hypothesis:
    """An installation with the faults that it explains.

    Attributes:
        faults: Faults.
        robot: Robot so installed.
        data: Log with their remedies applied.
        order: Joint j's torque is the one recorded as ``order[j]``.
    """

    faults: Sequence[Fault]
    robot: Robot
    data: Smooth
    order: Sequence[int]

    def fit(self, case: TorqueFit) -> TorqueFit:
        """The fit of a log's torque in this installation."""
        return TorqueFit(self.robot, case.log, self.data, case.joints)


def physics_faults(case: TorqueFit) -> list[Fault]:
    """The faults of unit, installation and rate that the torque shows."""
    for test in (
        torque_unit,
        degrees,
        positions_beyond_limits,
        torque_scale,
        installation_faults,
    ):
        if faults := [*test(case)]:
            return faults
    signs = [*position_signs(case)]
    if _informative(case.robot):
        # what such bodies contradict is something that no model has
        signs = [f for f in signs if _log_odds(case, _installed(case, [f])) > 0]
    return sorted(signs, key=lambda fault: -fault.evidence["gain"])[:1]


def _informative(robot: Robot) -> bool:
    """Whether the nominal bodies say anything: each has a mass, and not all the same."""
    mass = robot.phi[::10]
    return bool((mass > 0).all() and np.ptp(mass) > 1e-6 * mass.max())


def torque_scale(case: TorqueFit) -> Iterator[Fault]:
    """Readings that are the torque of bodies near the nominal ones by a factor of each joint.

    As they stand, any one link may be another body; with a factor of each joint, as for currents,
    only the last one may, which carries a tool. Factors are prior anywhere within `SCALES`.
    """
    robot = case.robot
    if case.log.unit != "N·m" or not _informative(robot):
        return
    per, std = case.readings_per_torque()
    joints = [j for j in case.joints if std[j] < CLEAR_GAIN]
    gains = per[joints]
    if not joints or np.abs(np.log(gains)).min() < np.log(SCALES.least):
        return
    loose = TorqueFit(robot, replace(case.log, unit="A"), case.data, case.joints)
    noise = np.minimum(case.power, loose.power)
    tool = _body_spread(robot, robot.nv - 1)
    left, after = loose.surprise(noise, case.rows, tool)
    before = min(
        case.surprise(noise, case.rows, _body_spread(robot, link))[1]
        for link in range(robot.nv)
    )
    dispersion = max(1.0, left / float(case.rows.sum()))
    price = odds_against(robot) + 2 * len(joints) * np.log(SCALES.choices)
    if (before - after) / dispersion < price:
        return
    names = case.log.names(joints)
    typical = float(np.exp(np.log(gains).mean()))
    spread = np.log(gains / typical) / std[joints]
    of_one = (np.abs(spread) < SCALES.alike).all()
    like = ", ".join(
        f"{name} {gain:.3g}" for name, gain in zip(names, gains, strict=True)
    )
    what = "not the torque of bodies near the given ones, but that by a factor of each joint"
    if of_one:
        what = f"{typical:.3g} times the torque of bodies near the given ones"
        like = ", ".join(
            f"{1 / size:.3g} in {unit}"
            for unit, size in sizes_of("tau").items()
            if abs(np.log(typical * size)) < SCALES.named
        )
    detail = (
        f"tau is {what}{f' ({like})' if like else ''}: another unit, currents or per cent, or "
        "inertias of the model in another unit"
    )
    yield Fault("wrong_unit", names, detail, {"channel": "tau", "factor": gains})


def installation_faults(case: TorqueFit) -> list[Fault]:
    """Faults of the installation: that which explains most first, the others with it repaired."""
    faults: list[Fault] = []
    for _ in range(case.robot.nv):
        proposed = _proposed(case)
        searched = [_installed(case, faults) for faults in _searched(case)]
        odds = {h: _log_odds(case, h) for h in (*proposed, *searched)}
        # what a test of its own has shown needs no odds
        able = [*proposed, *(h for h in searched if odds[h] > 0)]
        if not able:
            break
        plausible = [h for h in odds if np.isfinite(odds[h])]
        alike = sorted(_likeliest(case, plausible or able), key=_rank)
        faults += _with_alternatives(alike[0].faults, alike[1:])
        case = alike[0].fit(case)
    return faults


def _proposed(case: TorqueFit) -> list[_Hypothesis]:
    """Installations that the tests of order, signs, frames and rate propose."""
    frames = [*wrong_frame(case)] if _informative(case.robot) else []
    proposals = [[*order(case)], [*torque_signs(case)], frames, [*rate(case)]]
    return [_installed(case, faults) for faults in proposals if faults]


def _installed(case: TorqueFit, faults: Sequence[Fault]) -> _Hypothesis:
    """The installation with the remedies of faults applied, mounted and zeroed as they say."""
    remedies = [remedy for fault in faults for remedy in fault.remedies]
    orders = [
        r.joints for r in remedies if (r.action, r.channel) == ("order", "tau")
    ]
    order = [*orders[-1]] if orders else range(case.robot.nv)
    data = case.data.remedied(remedies)
    return _Hypothesis(faults, amended(case.robot, faults), data, order)


def _likeliest(
    case: TorqueFit, hypotheses: Sequence[_Hypothesis]
) -> list[_Hypothesis]:
    """Those of most evidence by one measure of noise, the least that any leaves."""
    fits = [hypothesis.fit(case) for hypothesis in hypotheses]
    noise = np.min([fit.power for fit in fits], axis=0)
    S = _body_spread(case.robot, case.robot.nv - 1)
    surprises = [
        fit.surprise(noise, case.rows[hypothesis.order], S)[1]
        for fit, hypothesis in zip(fits, hypotheses, strict=True)
    ]
    bound = min(surprises) + SEARCH.alike
    pairs = zip(hypotheses, surprises, strict=True)
    return [hypothesis for hypothesis, surprise in pairs if surprise <= bound]


def _rank(hypothesis: _Hypothesis) -> tuple[int, int]:
    """Sort key of indistinguishable hypotheses: fewest faults, order, signs, mounting, offsets."""
    first = hypothesis.faults[0]
    turns = hypothesis.faults[-1].evidence.get("offset", 0.0) / SEARCH.right
    odd = abs(turns - round(turns)) > 1e-9  # beyond rounding
    place = {"wrong_order": 0, "wrong_sign": 1, "wrong_mounting": 2}.get(
        first.fault, 3
    )
    return len(hypothesis.faults), place + odd


def _with_alternatives(
    faults: Sequence[Fault], others: Sequence[_Hypothesis]
) -> list[Fault]:
    """Faults of an installation, the last of which names those that would look the same."""
    names = [(fault.fault, fault.joints) for fault in faults]
    seen = [names]
    words = list[str]()
    alike = list[tuple[str, tuple[str, ...]]]()
    for other in others:
        its = [(fault.fault, fault.joints) for fault in other.faults]
        if its not in seen:
            words.append(" and ".join(fault.detail for fault in other.faults))
            alike += its
        seen.append(its)
    if not alike:
        return [*faults]
    last = faults[-1]
    detail = (
        f"{last.detail}; the torque would be the same if {' or if '.join(words)}"
    )
    evidence = {**last.evidence, "alike": alike}
    return [*faults[:-1], replace(last, detail=detail, evidence=evidence)]


def _log_odds(case: TorqueFit, other: _Hypothesis) -> float:
    """Twice the log odds of another installation, all that were tried counted; see `_evidence`."""
    return _evidence(case, other) - odds_against(case.robot)


def odds_against(robot: Robot) -> float:
    """Twice the log odds against any one other installation of an arm before data are seen."""
    return 2 * float(np.log(SEARCH.hypotheses * robot.nv / SEARCH.rare))


def _evidence(case: TorqueFit, other: _Hypothesis) -> float:
    """Twice the log evidence ratio of another installation; −∞ where it does not fit.

    As it stands any one of the links may be another body: that needs no other installation. Errors
    of the model count as noise; the other installation leaves half as much, or hardly more.
    """
    robot = case.robot
    if (robot.phi[::10] <= 0).any():
        return 0.0
    fit = other.fit(case)
    back = np.argsort(other.order)
    rows = float(case.rows.sum())
    noise = np.minimum(case.power[other.order], fit.power)
    own_rows = case.rows[other.order]
    squares, surprise = fit.surprise(
        noise, own_rows, _body_spread(robot, robot.nv - 1)
    )
    as_it_stands = [
        case.surprise(noise[back], case.rows, _body_spread(robot, link))
        for link in range(robot.nv)
    ]
    least = min(left for left, _ in as_it_stands)
    if squares > max(HALVED * least, SEARCH.fits * rows):
        return -np.inf
    before = min(before for _, before in as_it_stands)
    return float(before - surprise) / max(1.0, squares / rows)


def _body_spread(robot: Robot, other: int) -> Array:
    """Root of the covariance of bodies near the nominal ones, of which one may be another."""
    S = spread(robot).copy()
    std = SEARCH.tool if other == robot.nv - 1 else SEARCH.another_body
    S[:, 10 * other : 10 * other + 10] *= std
    return S


def _searched(case: TorqueFit) -> Iterator[Sequence[Fault]]:
    """The best mounting, and zero position and signs of each joint that turns."""
    robot = case.robot
    if not _informative(robot) or fits(case, _body_spread(robot, robot.nv - 1)):
        return
    yield from _mounting(case)
    for j in case.joints:
        if robot.revolute[j]:
            yield from _zeros(case, j)


@dataclass(frozen=True, eq=False)
class _Mixtures:
    """Squares that bodies near the nominal ones leave of the torque, by mixture of m parts.

    The last of the p columns of a part is the torque of the nominal bodies.

    Attributes:
        grams: Of two parts' columns, by joint, shape (m, m, joints, p, p).
        moments: Of a part's columns and the torque, shape (m, joints, p).
        squares: Of the torque, shape (joints,).
        weights: Of the squares of each joint, shape (joints,).
        loose: Relative std of the drive gains, 0 for torques, shape (joints,).
    """

    grams: Array
    moments: Array
    squares: Array
    weights: Array
    loose: Array

    @cached_property
    def _whole(self) -> tuple[Array, Array]:
        """Weighted grams of all joints together, (m, m, p, p), and moments, (joints, m, p)."""
        moments = self.weights[:, None, None] * self.moments.swapaxes(0, 1)
        return np.einsum("j,mnjpq->mnpq", self.weights, self.grams), moments

    def left(self, weights: Array, flipped: int | None = None) -> Array:
        """The squares (...) for weights (..., m) of the parts, the torque of one joint flipped."""
        grams, moments = self._whole
        pairs = weights[..., :, None] * weights[..., None, :]
        h = np.tensordot(weights, moments, (-1, 1))
        y = self.weights * self.squares
        if flipped is not None:
            h[..., flipped, :] *= -1
        if self.loose.any():
            # a gain off by N(0, loose²) is projected out of each joint's columns
            G = self.weights[:, None, None] * np.tensordot(pairs, self.grams, 2)
            nominal = np.maximum(G[..., -1, -1], 1e-300)
            gain = np.maximum(h[..., -1], 0.0) / nominal
            G = gain[..., None, None] ** 2 * G
            h = gain[..., None] * h
            share = (1 / (gain**2 * nominal + 1 / self.loose**2))[..., None]
            v = G[..., -1]
            t = h[..., -1:]
            G = G - share[..., None] * v[..., :, None] * v[..., None, :]
            h = h - share * t * v
            y = y - (share * t**2)[..., 0]
            A = G.sum(axis=-3)
        else:
            A = np.tensordot(pairs, grams, 2)
        b = h.sum(axis=-2)
        # H z = g minimises: the squares are the last pivot of H bordered by g
        A[..., :-1, :-1] += np.eye(b.shape[-1] - 1)
        A[..., -1, -1] += y.sum(axis=-1) - 2 * b[..., -1]
        A[..., -1, :-1] -= b[..., :-1]
        # rounding, where the prior hardly bounds a body
        A[..., *np.diag_indices(b.shape[-1])] *= 1 + 1e-12
        return np.asarray(np.linalg.cholesky(A)[..., -1, -1] ** 2, float)


def _mixtures(case: TorqueFit, parts: Sequence[Array]) -> _Mixtures:
    """Of columns of the links, (N, nv, 10 nv) each, in some installations, as the torque."""
    n = len(case.tau)
    m = len(parts)
    S = _body_spread(case.robot, case.robot.nv - 1)
    basis = np.column_stack([S, case.robot.phi])
    rows = slice(None, None, -(-n // SEARCH.rows))
    joints = len(case.joints)
    p = basis.shape[1]
    grams = np.zeros((m, m, joints, p, p))
    moments = np.zeros((m, joints, p))
    squares = []
    for k, j in enumerate(case.joints):
        # no joint's torque depends on the links before it
        later = slice(10 * j, None)
        own = basis[later, later]
        X = np.concatenate([part[rows, j, later] @ own for part in parts], axis=1)
        X, y = without_effects(case.F[rows, j], X, case.tau[rows, j])
        gram = (X.T @ X).reshape(m, len(X.T) // m, m, -1) / len(y)
        grams[:, :, k, later, later] = gram.swapaxes(1, 2)
        moments[:, k, later] = (X.T @ y).reshape(m, -1) / len(y)
        squares.append(float(y @ y) / len(y))
    weights = (case.rows / (MODEL_ERROR**2 * case.size))[case.joints]
    return _Mixtures(
        grams, moments, np.array(squares), weights, case.loose[case.joints]
    )


def _sharper(case: TorqueFit, mixtures: _Mixtures, gravity: Array) -> _Mixtures:
    """Mixtures weighted by the noise that is left under some gravity."""
    robot = case.robot.with_gravity(gravity)
    power = TorqueFit(robot, case.log, case.data, case.joints).power
    noise = np.minimum(power, MODEL_ERROR**2 * case.size)
    noise = np.maximum(noise, SEARCH.least_noise**2 * case.size)
    return replace(mixtures, weights=(case.rows / noise)[case.joints])


def _mounting(case: TorqueFit) -> Iterator[Sequence[Fault]]:
    """The arm under the direction of gravity that suits its torque best."""
    robot = case.robot
    motion = case.data.motion
    size = float(np.linalg.norm(robot.gravity))
    if size == 0:
        return
    still = np.zeros_like(motion.q)
    rest = replace(motion, dq=still, ddq=still)
    pulls = [(robot.with_gravity(axis), rest) for axis in np.eye(3)]
    parts = [(robot.with_gravity(np.zeros(3)), motion), *pulls]
    mixtures = _mixtures(case, [case.filtered(regressor(*part)) for part in parts])

    def scaled(x: Array) -> Array:
        return np.asarray(
            size * x / np.linalg.norm(x, axis=-1, keepdims=True), float
        )

    def squares_under(gravity: Array, at: _Mixtures) -> Array:
        return at.left(np.insert(gravity, 0, 1.0, axis=-1))

    def refined(starts: Sequence[Array], at: _Mixtures) -> Array:
        step = 1e-6  # of the differences that give slopes

        def objective(x: Array) -> tuple[float, Array]:
            squares = squares_under(scaled(x + step * np.eye(4, 3, -1)), at)
            return float(squares[0]), (squares[1:] - squares[0]) / step

        minimize = scipy.optimize.minimize
        ends = [minimize(objective, start, jac=True, tol=0.01) for start in starts]
        return scaled(min(ends, key=lambda end: end.fun).x)

    none = float(mixtures.left(np.eye(4)[0]))
    tried = np.vstack([robot.gravity / size, _sphere(SEARCH.directions)])
    blocks = np.array_split(scaled(tried), 10)  # all at once need too much memory
    squares = np.concatenate([squares_under(block, mixtures) for block in blocks])
    best = np.argsort(squares, kind="stable")
    if none < squares[best[0]]:
        detail = (
            "the torque has no gravity: it was taken off, or gravity is balanced; give robot.yaml "
            "gravity: [0, 0, 0], or record the torque of the drives"
        )
        evidence = {"gravity": np.zeros(3), "angle": 0.0}
        yield [Fault("wrong_mounting", case.log.joints, detail, evidence)]
        return
    gravity = refined([*tried[best[: SEARCH.starts]]], mixtures)
    for _ in range(SEARCH.polished):
        gravity = refined([gravity / size], _sharper(case, mixtures, gravity))
    cosine = np.clip(gravity @ robot.gravity / size**2, -1, 1)
    angle = np.degrees(np.arccos(cosine))
    vector = ", ".join(f"{x:.2f}" for x in gravity)
    detail = (
        f"the arm is mounted otherwise than its model says: gravity points along ({vector}) m/s² "
        f"in the base frame, {angle:.0f}° from the given direction; give robot.yaml that gravity"
    )
    evidence = {"gravity": gravity, "angle": angle}
    yield [Fault("wrong_mounting", case.log.joints, detail, evidence)]


def _sphere(n: int) -> Array:
    """Unit vectors of a Fibonacci lattice on the sphere, shape (n, 3)."""
    k = np.arange(n) + 0.5
    z = 1 - 2 * k / n
    r = np.sqrt(1 - z**2)
    turn = np.pi * (1 + np.sqrt(5)) * k
    return np.column_stack([r * np.cos(turn), r * np.sin(turn), z])


class _Zero(NamedTuple):
    """A joint's zero position, and which way it counts and measures torque."""

    squares: float
    flipped: bool  # the torque
    sign: float  # of the position
    offset: float  # [rad]

    @property
    def signs(self) -> int:
        """Number of signs that differ from the model's."""
        return self.flipped + (self.sign < 0)


def _zeros(case: TorqueFit, j: int) -> Iterator[Sequence[Fault]]:
    """One joint at another zero position, counting or measuring torque the other way.

    The simplest, and that which measures torque as it is recorded; none where that is as it stands.
    """
    motion = case.data.motion
    axis = np.eye(case.robot.nv)[j]
    zeros = list[_Zero]()
    for sign in (1.0, -1.0):
        way = 1 + (sign - 1) * axis
        q, dq, ddq = (x * way for x in (motion.q, motion.dq, motion.ddq))
        moved = [Motion(motion.t, q + angle * axis, dq, ddq) for angle in _ANGLES]
        columns = [case.filtered(regressor(case.robot, m)) for m in moved]
        mixtures = _mixtures(case, columns)
        for flipped in (None, case.joints.index(j)):
            grid = np.arange(-np.pi, np.pi, SEARCH.step)
            near = grid[int(np.argmin(_squares_at(grid, mixtures, flipped)))]
            search = scipy.optimize.minimize_scalar(
                _squares_at,
                args=(mixtures, flipped),
                bounds=(near - SEARCH.step, near + SEARCH.step),
                method="bounded",
            )
            free = float(search.x)
            right = SEARCH.right * round(free / SEARCH.right)
            offsets = np.array([0.0, right, free])
            squares = _squares_at(offsets, mixtures, flipped)
            zeros += [
                _Zero(float(left), flipped is not None, sign, float(offset))
                for left, offset in zip(squares, offsets, strict=True)
            ]
    zeros.sort(key=lambda zero: zero.signs)
    as_recorded = [zero for zero in zeros if not zero.flipped]
    simplest = [_simplest(case, some) for some in (zeros, as_recorded)]
    for zero in {z[1:]: z for z in simplest}.values():
        if faults := _zero_faults(case.log, j, zero):
            yield faults


def _squares_at(offset: Any, mixtures: _Mixtures, flipped: int | None) -> Any:
    """The squares (...) that mixtures of `_ANGLES` leave at zero offsets (...) of a joint."""
    x = np.subtract.outer(offset, _ANGLES)
    return mixtures.left((1 + 2 * np.cos(x) + 2 * np.cos(2 * x)) / 5, flipped)


def _simplest(case: TorqueFit, zeros: Sequence[_Zero]) -> _Zero:
    """The first of zero positions than which none leaves fewer squares beyond chance.

    Other angles come before other signs, and a multiple of 90° before any other angle.
    """
    least = min(zero.squares for zero in zeros)
    dispersion = max(1.0, least / float(case.rows.sum()))
    chance = float(scipy.special.chdtri(1, ALARM)) * dispersion
    return next(zero for zero in zeros if zero.squares < least + chance)


def _zero_faults(log: Log, j: int, zero: _Zero) -> list[Fault]:
    joint = log.joints[j]
    faults = list[Fault]()
    channels = ("q", "dq") * (zero.sign < 0) + ("tau",) * zero.flipped
    if channels:
        what = " and ".join(name for name in channels if name != "dq")
        detail = f"{what} of {joint} count the other way than the robot's"
        done = f"negates {what}{' (and dq)' * (zero.sign < 0)} of {joint}"
        evidence: dict[str, Any] = {"channel": what}
        remedies = tuple(
            Remedy("scale", name, (j,), factor=-1.0) for name in channels
        )
        faults.append(
            Fault("wrong_sign", (joint,), detail, evidence, done, remedies)
        )
    if zero.offset:
        side = "+" if zero.offset > 0 else "−"
        angle = f"{side} {abs(np.degrees(zero.offset)):.3g}°"
        detail = f"the zero position of {joint} is off: its true angle is the reading {angle}"
        evidence = {"offset": zero.offset}
        faults.append(Fault("wrong_zero", (joint,), detail, evidence))
    return faults


def amended(robot: Robot, faults: Sequence[Fault]) -> Robot:
    """The robot mounted and zeroed, its inertias in the frames, as faults say."""
    for fault in faults:
        if fault.fault == "wrong_mounting":
            robot = robot.with_gravity(fault.evidence["gravity"])
        elif fault.fault == "wrong_zero":
            robot = robot.with_zero(fault.joints[0], fault.evidence["offset"])
        elif fault.fault == "wrong_frame":
            robot = robot.with_parameters(in_joint_frames(robot))
    return robot


def support(
    robot: Robot,
    recording: Recording,
    faults: Sequence[Fault],
    others: Sequence[Fault],
) -> float:
    """Twice the log evidence ratio of an installation in a recording, its other faults repaired.

    It is −∞ where the installation does not fit, 0 where the torque tells nothing.
    """
    log, _ = after_repair(Log.of(robot, recording), others)
    data = smooth(log)
    if data is None:
        return 0.0
    case = torque_fit(robot, log, data, joints_without_torque(others))
    return 0.0 if case is None else _evidence(case, _installed(case, faults))


def swapped(robot: Robot, recordings: Sequence[Recording]) -> list[tuple[int, int]]:
    """Pairs of recordings, of as many rows each, of which each has the torque of the other.

    As an installation, that has to be likelier than all that the model may lack, all pairs counted.
    """
    if not _informative(robot):
        return []
    logs = [Log.of(robot, recording) for recording in recordings]
    kinds = [(len(log), log.unit) for log in logs]
    pairs = [
        (i, k)
        for i, k in itertools.combinations(range(len(logs)), 2)
        if kinds[i] == kinds[k]
    ]
    data = {k: smooth(logs[k]) for k in dict.fromkeys(itertools.chain(*pairs))}
    odds = 2 * float(np.log(max(len(pairs), 1) / SEARCH.rare))
    exchanged = list[tuple[int, int]]()
    for i, k in pairs:
        if {i, k} & {*itertools.chain(*exchanged)}:
            continue
        gain = _with_torque_of(robot, logs[i], data[i], logs[k])
        if gain > -np.inf:
            gain += _with_torque_of(robot, logs[k], data[k], logs[i])
        if gain > odds:
            exchanged.append((i, k))
    return exchanged


def _with_torque_of(
    robot: Robot, log: Log, data: Smooth | None, other: Log
) -> float:
    """Twice the log evidence ratio of a log with another's torque; see `_evidence`."""
    moved = smooth(replace(log, tau=other.tau))
    if data is None or moved is None:
        return -np.inf
    after = np.log(unlike(robot, moved)).mean()
    before = np.log(unlike(robot, data)).mean()
    if after - before > np.log(HALVED):
        return -np.inf
    case = torque_fit(robot, log, data, set())
    if case is None:
        return -np.inf
    return _evidence(case, _Hypothesis([], robot, moved, range(robot.nv)))


def wrong_frame(case: TorqueFit) -> Iterator[Fault]:
    """The nominal inertias, where they explain the torque only if all are in the distal frames.

    Both readings get each joint's friction, offset, rotor inertia and a gain.
    """
    if (case.robot.phi[::10] <= 0).any():
        return  # links without mass say nothing
    joints = case.joints
    variance = np.maximum(case.tau.var(axis=0)[joints], 1e-300)
    as_read = _unexplained(case, case.robot.phi)
    moved = _unexplained(case, in_joint_frames(case.robot))
    before = np.sqrt(as_read / variance)
    after = np.sqrt(moved / variance)
    gain = float((case.rows[joints] * np.log(as_read / moved)).sum())
    clear = gain > scipy.special.chdtri(1, ALARM)
    better = after.sum() < 0.75 * before.sum()
    worse = (after > 1.5 * before).any()
    if not (clear and better) or worse or np.median(after**2) > 1 - EXPLAINED:
        return
    best = int(np.argmin(after / before))
    detail = (
        f"the inertias of the given model are those about the distal frames, at the next "
        f"joints: read so, the error of the model with friction falls to "
        f"{100 * after.sum() / before.sum():.2g} % over all joints and to "
        f"{100 * after[best] / before[best]:.2g} % at {case.log.joints[joints[best]]} "
        f"(likelihood ratio {gain:.3g}); move them to the joints' frames in the robot's file"
    )
    evidence = {"nrmse_as_read": before, "nrmse_moved": after, "gain": gain}
    yield Fault("wrong_frame", case.log.joints, detail, evidence)


def in_joint_frames(robot: Robot) -> Array:
    """Standard parameters in the joints' frames, those given being in the distal ones, (10 nv,)."""
    model = robot.model
    places = [model.jointPlacements[j + 1] for j in range(1, robot.nv)]
    places.append(model.frames[robot.tip].placement)
    moved = []
    for place, phi in zip(places, robot.phi.reshape(robot.nv, 10), strict=True):
        body = pin.Inertia.FromDynamicParameters(phi)
        moved.append(place.act(body).toDynamicParameters())
    return np.concatenate(moved)


def _unexplained(case: TorqueFit, phi: Array) -> Array:
    """Mean square that a model and each joint's own effects leave, of the joints that count."""
    torque = (case.G + case.D) @ phi
    squares = []
    for j in case.joints:
        columns = np.column_stack([torque[:, j], case.F[:, j]])
        error = scaled_least_squares(columns, case.tau[:, j])[2]
        squares.append(max(float((error**2).mean()), 1e-12 * float(case.size[j])))
    return np.array(squares)
