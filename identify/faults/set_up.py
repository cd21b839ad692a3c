"""Set-up of an arm against its model: mounting, zero positions, signs and order of its joints.

A set-up is judged by the squares that bodies near the given ones (±30 %, and any tool on the last
link) leave of the torque, the joints' own effects free. Torque is linear in gravity, and in the
angle δ by which a joint's zero position is off a trigonometric polynomial of degree 2, which five
angles determine. So the columns of any set-up are mixtures of a few, and small matrices judge all
directions of gravity and all angles of a joint: the search is global.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy

from excitant.identify.drive_gains import without_effects
from excitant.identify.faults.fault import (
    ALARM,
    NO_TORQUE,
    Fault,
    Log,
    Remedy,
    after_repair,
)
from excitant.identify.faults.modelled import in_joint_frames, wrong_frame
from excitant.identify.faults.physics import (
    FITS,
    HALVED,
    MODEL_ERROR,
    Smooth,
    TorqueFit,
    degrees,
    fits,
    order,
    position_signs,
    rate,
    smooth,
    spread,
    torque_fit,
    torque_signs,
    torque_unit,
    unlike,
)
from excitant.identify.recording import Recording
from excitant.robots.motion import Array, Motion
from excitant.robots.regressor import regressor
from excitant.robots.robot import Robot

_ROUNDING = 1e-12  # of squares that a prior of a body's own hardly bounds
_OTHER = 1 / 0.3  # times the tolerance: of a body that is another
_TOOL = 10.0  # of one with a tool
_ROWS = 600  # of a search, at most
_ANGLES = (
    0.4 * np.pi * np.arange(5)
)  # that determine a trigonometric polynomial of degree 2
_DIRECTIONS = 200  # of gravity tried
_STARTS = 3  # the best of them, refined
_FLAT = 0.01  # slope at which it ends
_SLOPE = 1e-6  # step by which it is found
_POLISHED = 3  # times, with the noise that the set-up found leaves
_LEAST_NOISE = 0.01  # of the torque, then
_TRIED = 12  # set-ups of each joint
_RARE = 0.02  # probability that an arm has another
_ALIKE = 2.0  # twice the log of the ratio of evidence: set-ups that look the same
_STEP = np.pi / 18  # between zero positions tried
_TIE = 1e-9  # of it: rounding
_RIGHT = (
    np.pi / 2
)  # zero positions are off by multiples of it, unless another angle is better


@dataclass(frozen=True, eq=False)
class _SetUp:
    """A set-up with the faults that it amends."""

    faults: Sequence[Fault]
    robot: Robot
    data: Smooth
    order: Sequence[int]  # joint j's torque is the one recorded as order[j]


def physics_faults(case: TorqueFit) -> list[Fault]:
    """The faults of unit, set-up and rate that the torque shows."""
    for test in (torque_unit, degrees):
        if found := [*test(case)]:
            return found
    if found := set_up_faults(case):
        return found
    signs = [*position_signs(case)]
    if _known(case.robot):  # what such bodies contradict is something that no model has
        signs = [fault for fault in signs if _gain(case, _amended(case, [fault])) > 0]
    return sorted(signs, key=lambda fault: -fault.evidence["gain"])[:1]


def _known(robot: Robot) -> bool:
    """Whether the given bodies say anything: each has a mass, and not all the same."""
    mass = robot.phi[::10]
    return bool((mass > 0).all() and np.ptp(mass) > 1e-6 * mass.max())


def set_up_faults(case: TorqueFit) -> list[Fault]:
    """Faults of the set-up: that which explains most first, the others with it amended."""
    found: list[Fault] = []
    for _ in range(case.robot.nv):
        swaps = [*order(case)]
        signs = [*torque_signs(case)]
        rates = [*rate(case)]
        proposed = [_amended(case, faults) for faults in (swaps, signs) if faults]
        if _known(case.robot) and (frames := [*wrong_frame(case)]):
            moved = case.robot.with_parameters(in_joint_frames(case.robot))
            proposed.append(replace(_amended(case, frames), robot=moved))
        proposed += [_amended(case, [fault]) for fault in rates]
        judged = [(_gain(case, each), each) for each in proposed]
        amends = (_set_up(case, faults) for faults in _searched(case))
        searched = [(_gain(case, each), each) for each in amends]
        if not (able := [*judged, *(each for each in searched if each[0] > 0)]):
            break
        fit_well = [each for gain, each in (*judged, *searched) if np.isfinite(gain)]
        alike = sorted(
            _likeliest(case, fit_well or [each for _, each in able]), key=_rank
        )
        best = alike[0]
        found += _beside(best.faults, alike[1:])
        case = _fit(case, best)
    return found


def _set_up(case: TorqueFit, faults: Sequence[Fault]) -> _SetUp:
    """The set-up with the remedies of faults applied, the robot mounted and counted as they say."""
    return replace(_amended(case, faults), robot=amended(case.robot, faults))


def _likeliest(case: TorqueFit, among: Sequence[_SetUp]) -> list[_SetUp]:
    """The set-ups that have most evidence by one measure of noise, the least that any leaves."""
    fits = [_fit(case, each) for each in among]
    noise = np.min([fit.power for fit in fits], axis=0)
    S = _spread(case.robot, case.robot.nv - 1)
    surprise = [
        fit.surprise(noise, case.rows[each.order], S)[1]
        for fit, each in zip(fits, among, strict=True)
    ]
    least = min(surprise) + _ALIKE
    return [each for each, own in zip(among, surprise, strict=True) if own <= least]


def _rank(set_up: _SetUp) -> tuple[int, int]:
    """Which of set-ups that look the same is told: one fault, order, signs, mounting, angles."""
    first = set_up.faults[0]
    turn = set_up.faults[-1].evidence.get("offset", 0.0) / _RIGHT
    place = {"wrong_order": 0, "wrong_sign": 1, "wrong_mounting": 2}.get(first.fault, 3)
    return len(set_up.faults), place + (abs(turn - round(turn)) > _TIE)


def _beside(faults: Sequence[Fault], others: Sequence[_SetUp]) -> list[Fault]:
    """Faults of a set-up, the last of which tells what would look the same."""
    known = [
        [(f.fault, f.joints) for f in each]
        for each in (faults, *(o.faults for o in others))
    ]
    new = [k for k, each in enumerate(known) if each not in known[:k]][1:]
    if not new:
        return [*faults]
    words = " or if ".join(
        " and ".join(f.detail for f in others[k - 1].faults) for k in new
    )
    alike = [each for k in new for each in known[k]]
    last = faults[-1]
    told = f"{last.detail}; the torque would be the same if {words}"
    return [
        *faults[:-1],
        replace(last, detail=told, evidence={**last.evidence, "alike": alike}),
    ]


def _fit(case: TorqueFit, set_up: _SetUp) -> TorqueFit:
    return TorqueFit(set_up.robot, case.log, set_up.data, case.joints)


def _gain(case: TorqueFit, other: _SetUp) -> float:
    """Twice the log of the odds of another set-up, all that were tried counted; see `_evidence`."""
    return _evidence(case, other) - odds_against(case.robot)


def odds_against(robot: Robot) -> float:
    """Twice the log of the odds against any one other set-up of an arm before data are seen."""
    return 2 * float(np.log(_TRIED * robot.nv / _RARE))


def _evidence(case: TorqueFit, other: _SetUp) -> float:
    """Twice the log evidence ratio of another set-up; −∞ where it does not fit.

    As it stands any one of the links may be another body: that needs no other set-up. Errors of
    the model count as noise; the other set-up leaves half as much, or hardly more than these.
    """
    robot = case.robot
    last = case.robot.nv - 1
    if (robot.phi[::10] <= 0).any():
        return 0.0
    fit = _fit(case, other)
    back = np.argsort(other.order)
    rows = float(case.rows.sum())
    noise = np.minimum(case.power[other.order], fit.power)
    left, after = fit.surprise(noise, case.rows[other.order], _spread(robot, last))
    tried = (
        case.surprise(noise[back], case.rows, _spread(robot, k))
        for k in range(last + 1)
    )
    squares, before = map(min, zip(*tried, strict=True))
    if left > max(HALVED * squares, FITS * rows):
        return -np.inf
    return float(before - after) / max(1.0, left / rows)


def _spread(robot: Robot, other: int) -> Array:
    """Root of the covariance of bodies near the given ones, of which one may be another."""
    S = spread(robot).copy()
    S[:, 10 * other : 10 * other + 10] *= _TOOL if other == robot.nv - 1 else _OTHER
    return S


def _amended(case: TorqueFit, faults: Sequence[Fault]) -> _SetUp:
    """The set-up in which the remedies of faults are applied."""
    motion = case.data.motion
    at = list(range(case.robot.nv))
    known = {"dry": case.data.dry, "tau": case.data.tau}
    known |= {name: getattr(motion, name) for name in ("q", "dq", "ddq")}
    channels = {name: np.array(values) for name, values in known.items()}
    for remedy in (remedy for fault in faults for remedy in fault.remedies):
        if remedy.channel == "t":
            channels["dq"] /= remedy.factor
            channels["ddq"] /= remedy.factor**2
        for name in {"q": ("q", "dq", "ddq", "dry"), "tau": ("tau",)}.get(
            remedy.channel, ()
        ):
            values = channels[name]
            joints = list(remedy.joints)
            if remedy.action == "order":
                values[:] = values[:, joints]
            else:
                values[:, joints] *= (
                    np.sign(remedy.factor) if name == "dry" else remedy.factor
                )
        if remedy.action == "order" and remedy.channel == "tau":
            at = list(remedy.joints)
    signs = channels.pop("dry")
    tau = channels.pop("tau")
    data = case.data._replace(motion=Motion(motion.t, **channels), dry=signs, tau=tau)
    return _SetUp(faults, case.robot, data, at)


def _searched(case: TorqueFit) -> Iterator[list[Fault]]:
    """The best mountings, and zero positions and signs of each joint that turns."""
    robot = case.robot
    if not _known(robot) or fits(case, _spread(robot, robot.nv - 1)):
        return
    yield from _mounting(case)
    for j in case.joints:
        if robot.revolute[j]:
            yield from _zeros(case, j)


@dataclass(frozen=True, eq=False)
class _Mixtures:
    """Squares that bodies near the given ones leave of the torque, by mixture of m columns.

    The last of the p columns of a part is the torque of the given bodies.
    """

    grams: (
        Array  # of two parts, p columns each, of each joint, shape (m, m, joints, p, p)
    )
    moments: Array  # of a part and the torque, shape (m, joints, p)
    squares: Array  # of the torque, shape (joints,)
    weights: Array  # of the squares of each joint, shape (joints,)
    loose: (
        Array  # relative uncertainty of the drive gains, 0 for torques, shape (joints,)
    )

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
            G = self.weights[:, None, None] * np.tensordot(pairs, self.grams, 2)
            own = np.maximum(G[..., -1, -1], 1e-300)
            scale = np.maximum(h[..., -1], 0.0) / own
            G = scale[..., None, None] ** 2 * G
            h = scale[..., None] * h
            share = (1 / (scale**2 * own + 1 / self.loose**2))[..., None]
            v = G[..., -1]
            t = h[..., -1:]
            G = G - share[..., None] * v[..., :, None] * v[..., None, :]
            h = h - share * t * v
            y = y - (share * t**2)[..., 0]
            A = G.sum(axis=-3)
        else:
            A = np.tensordot(pairs, grams, 2)
        b = h.sum(axis=-2)
        # H z = g minimises: the squares are the last pivot of H bordered by g and their constant
        A[..., :-1, :-1] += np.eye(b.shape[-1] - 1)
        A[..., -1, -1] += y.sum(axis=-1) - 2 * b[..., -1]
        A[..., -1, :-1] -= b[..., :-1]
        A[..., *np.diag_indices(b.shape[-1])] *= 1 + _ROUNDING
        return np.asarray(np.linalg.cholesky(A)[..., -1, -1] ** 2, float)


def _mixtures(case: TorqueFit, parts: Sequence[Array]) -> _Mixtures:
    """Of columns of the links in some set-ups, filtered as the torque is, (N, nv, 10 nv) each."""
    n = len(case.tau)
    m = len(parts)
    S = _spread(case.robot, case.robot.nv - 1)
    own = np.column_stack([S, case.robot.phi])
    rows = slice(None, None, -(-n // _ROWS))
    joints = len(case.joints)
    p = own.shape[1]
    grams = np.zeros((m, m, joints, p, p))
    moments = np.zeros((m, joints, p))
    squares = []
    for k, j in enumerate(case.joints):
        later = slice(10 * j, None)  # no joint's torque depends on the links before it
        X = np.concatenate(
            [part[rows, j, later] @ own[later, later] for part in parts], axis=1
        )
        X, y = without_effects(case.F[rows, j], X, case.tau[rows, j])
        gram = (X.T @ X).reshape(m, len(X.T) // m, m, -1) / len(y)
        grams[:, :, k, later, later] = gram.swapaxes(1, 2)
        moments[:, k, later] = (X.T @ y).reshape(m, -1) / len(y)
        squares.append(float(y @ y) / len(y))
    weights = (case.rows / (MODEL_ERROR**2 * case.size))[case.joints]
    return _Mixtures(
        grams, moments, np.array(squares), weights, case.loose[case.joints]
    )


def _sharper(case: TorqueFit, at: _Mixtures, found: _SetUp) -> _Mixtures:
    """Mixtures weighted by the noise that a set-up leaves."""
    noise = np.minimum(_fit(case, found).power, MODEL_ERROR**2 * case.size)
    noise = np.maximum(noise, _LEAST_NOISE**2 * case.size)
    return replace(at, weights=(case.rows / noise)[case.joints])


def _mounting(case: TorqueFit) -> list[list[Fault]]:
    """The arm under the direction of gravity that suits its torque best."""
    robot = case.robot
    motion = case.data.motion
    size = float(np.linalg.norm(robot.gravity))
    if size == 0:
        return []
    still = np.zeros_like(motion.q)
    rest = replace(motion, dq=still, ddq=still)
    pulls = [(robot.with_gravity(unit), rest) for unit in np.eye(3)]
    parts = [(robot.with_gravity(np.zeros(3)), motion), *pulls]
    mixtures = _mixtures(case, [case.filtered(regressor(*part)) for part in parts])

    def unit(x: Array) -> Array:
        return np.asarray(size * x / np.linalg.norm(x, axis=-1, keepdims=True), float)

    def with_motion(pull: Array) -> Array:
        return np.insert(pull, 0, 1.0, axis=-1)

    def best_of(starts: Sequence[Array], at: _Mixtures) -> Array:
        def left(x: Array) -> tuple[float, Array]:
            """The squares for a direction, and their slopes."""
            squares = at.left(with_motion(unit(x + _SLOPE * np.eye(4, 3, -1))))
            return float(squares[0]), (squares[1:] - squares[0]) / _SLOPE

        ends = [
            scipy.optimize.minimize(left, start, jac=True, tol=_FLAT)
            for start in starts
        ]
        return unit(min(ends, key=lambda end: end.fun).x)

    k = np.arange(_DIRECTIONS) + 0.5  # a Fibonacci lattice on the sphere
    z = 1 - 2 * k / _DIRECTIONS
    turn = np.pi * (1 + np.sqrt(5)) * k
    r = np.sqrt(1 - z**2)
    tried = np.column_stack([r * np.cos(turn), r * np.sin(turn), z])
    tried = np.vstack([robot.gravity / size, tried])
    tenths = np.array_split(
        with_motion(unit(tried)), 10
    )  # all at once need too much memory
    best = np.argsort(
        np.concatenate([mixtures.left(some) for some in tenths]), kind="stable"
    )
    gravity = best_of([*tried[best[:_STARTS]]], mixtures)
    for _ in range(_POLISHED):
        turned = _SetUp([], robot.with_gravity(gravity), case.data, range(robot.nv))
        gravity = best_of([gravity / size], _sharper(case, mixtures, turned))
    angle = np.degrees(np.arccos(np.clip(gravity @ robot.gravity / size**2, -1, 1)))
    vector = ", ".join(f"{x:.2f}" for x in gravity)
    detail = (
        f"the arm is mounted otherwise than its model says: gravity points along ({vector}) m/s² "
        f"in the base frame, {angle:.0f}° from the given direction; give robot.yaml that gravity"
    )
    evidence = {"gravity": gravity, "angle": angle}
    return [[Fault("wrong_mounting", case.log.joints, detail, evidence)]]


def _zeros(case: TorqueFit, j: int) -> list[list[Fault]]:
    """One joint at another zero position, counting or measuring torque the other way.

    The simplest, and that which measures torque as it is recorded; none where that is as it stands.
    """
    motion = case.data.motion
    unit = np.eye(case.robot.nv)[j]
    found = list[tuple[float, bool, float, float]]()
    for sign in (1.0, -1.0):
        way = 1 + (sign - 1) * unit
        q, dq, ddq = (x * way for x in (motion.q, motion.dq, motion.ddq))
        moved = [Motion(motion.t, q + angle * unit, dq, ddq) for angle in _ANGLES]
        mixtures = _mixtures(
            case, [case.filtered(regressor(case.robot, m)) for m in moved]
        )
        for flipped in (None, case.joints.index(j)):
            known = mixtures, flipped
            tried = np.arange(-np.pi, np.pi, _STEP)
            near = tried[int(np.argmin(_left_at(tried, *known)))]
            ends = near - _STEP, near + _STEP
            search = scipy.optimize.minimize_scalar
            free = float(search(_left_at, args=known, bounds=ends, method="bounded").x)
            angles = np.array([0.0, _RIGHT * round(free / _RIGHT), free])
            for squares, angle in zip(_left_at(angles, *known), angles, strict=True):
                found.append((float(squares), flipped is not None, sign, float(angle)))
    found.sort(key=lambda each: (each[2] < 0) + each[1])
    ways = [found, [each for each in found if not each[1]]]
    simplest = dict.fromkeys(_simplest(case, way) for way in ways)
    return [
        _zero_faults(case, j, *each) for each in simplest if each != (False, 1.0, 0.0)
    ]


def _left_at(angle: Any, mixtures: _Mixtures, flipped: int | None) -> Any:
    """The squares (...) that mixtures of `_ANGLES` leave at angles (...) of a joint."""
    x = np.subtract.outer(angle, _ANGLES)
    return mixtures.left((1 + 2 * np.cos(x) + 2 * np.cos(2 * x)) / 5, flipped)


def _simplest(
    case: TorqueFit, found: Sequence[tuple[float, bool, float, float]]
) -> tuple[bool, float, float]:
    """The first of zero positions, by the squares they leave, than which none is better by chance.

    Other angles come before other signs, and a multiple of 90° before any other angle.
    """
    least = min(squares for squares, *_ in found)
    chance = float(scipy.special.chdtri(1, ALARM)) * max(
        1.0, least / float(case.rows.sum())
    )
    return next(each[1:] for each in found if each[0] < least + chance)


def _zero_faults(
    case: TorqueFit, j: int, flipped: bool, sign: float, angle: float
) -> list[Fault]:
    joint = case.log.joints[j]
    faults = list[Fault]()
    if channels := ("q", "dq") * (sign < 0) + ("tau",) * flipped:
        what = " and ".join(name for name in channels if name != "dq")
        detail = f"{what} of {joint} count the other way than the robot's"
        done = f"negates {what}{' (and dq)' * (sign < 0)} of {joint}"
        remedies = tuple(Remedy("scale", name, (j,), factor=-1.0) for name in channels)
        faults.append(
            Fault("wrong_sign", (joint,), detail, {"channel": what}, done, remedies)
        )
    if angle:
        off = f"{'+' if angle > 0 else '−'} {abs(np.degrees(angle)):.3g}°"
        detail = (
            f"the zero position of {joint} is off: its true angle is the reading {off}"
        )
        faults.append(Fault("wrong_zero", (joint,), detail, {"offset": angle}))
    return faults


def amended(robot: Robot, faults: Sequence[Fault]) -> Robot:
    """The robot mounted and counted as faults of the set-up say."""
    for fault in faults:
        if fault.fault == "wrong_mounting":
            robot = robot.with_gravity(fault.evidence["gravity"])
        elif fault.fault == "wrong_zero":
            robot = robot.with_zero(fault.joints[0], fault.evidence["offset"])
    return robot


def support(
    robot: Robot, recording: Recording, faults: Sequence[Fault], others: Sequence[Fault]
) -> float:
    """Twice the log evidence ratio of a set-up in a recording with its other faults repaired.

    It is −∞ where the set-up does not fit, 0 where the torque tells nothing.
    """
    log, _ = after_repair(Log.of(robot, recording), others)
    dead = {
        f.joints[0] for f in others if (f.fault, f.evidence.get("channel")) == NO_TORQUE
    }
    if (data := smooth(log)) is None or (
        case := torque_fit(robot, log, data, dead)
    ) is None:
        return 0.0
    return _evidence(case, _set_up(case, faults))


def swapped(robot: Robot, recordings: Sequence[Recording]) -> list[tuple[int, int]]:
    """Pairs of recordings, of as many rows each, of which each has the torque of the other.

    As a set-up, that has to be likelier than all that the model may lack, all pairs counted.
    """
    if not _known(robot):
        return []
    logs = [Log.of(robot, recording) for recording in recordings]
    found = list[tuple[int, int]]()
    pairs = [
        (i, k)
        for i, k in itertools.combinations(range(len(logs)), 2)
        if (len(logs[i]), logs[i].unit) == (len(logs[k]), logs[k].unit)
    ]
    data = {k: smooth(logs[k]) for k in dict.fromkeys(itertools.chain(*pairs))}
    odds = 2 * float(np.log(max(len(pairs), 1) / _RARE))
    for pair in pairs:
        if {*pair} & {k for taken in found for k in taken}:
            continue
        gain = 0.0
        for i, k in (pair, pair[::-1]):
            gain += (
                _with_torque_of(robot, logs[i], data[i], logs[k])
                if gain > -np.inf
                else 0.0
            )
        if gain > odds:
            found.append(pair)
    return found


def _with_torque_of(robot: Robot, log: Log, data: Smooth | None, other: Log) -> float:
    """Twice the log evidence ratio of a log with another's torque; see `_evidence`."""
    if data is None or (moved := smooth(replace(log, tau=other.tau))) is None:
        return -np.inf
    left = (np.log(unlike(robot, each)).mean() for each in (moved, data))
    if next(left) - next(left) > np.log(HALVED):
        return -np.inf
    case = torque_fit(robot, log, data, set())
    return (
        -np.inf
        if case is None
        else _evidence(case, _SetUp([], robot, moved, range(robot.nv)))
    )
