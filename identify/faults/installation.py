"""How an arm stands against its model, and how its log relates to it: one search.

An `Installation` is what differs: the direction of gravity, zero positions, frames of the given
inertias, order, signs and coupling of the columns, their units, the clock. The evidence of the
torque for bodies near the nominal ones (`TorqueFit`) judges it, against that of the arm as its
model has it, any one link of which may be another body. The search judges the few discrete moves
that bring the torque of the nominal bodies nearest, and the gravity, zero positions and clock that
do, each sought from a grid. What positions or torque far beyond the limits show needs no odds.

Denavit and Hartenberg's standard convention gives inertia in the distal frame, at the next joint, a
URDF at the link's own joint.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
import scipy

from excitant.exceptions import BadRecording
from excitant.identify.drive_gains import BODY_STD
from excitant.identify.faults.fault import (
    ALARM,
    DOUBT,
    FAULTS,
    INSTALLATION,
    OPEN,
    Fault,
    Log,
    Remedy,
    Rows,
    after_repair,
    as_guess,
    joints_without_torque,
)
from excitant.identify.faults.time import RATES, clock_confirmed, slow_clock
from excitant.identify.faults.torque_fit import (
    MODEL_ERROR,
    Smooth,
    TorqueFit,
    is_described,
    smooth,
    torque_fit,
)
from excitant.identify.reading.units import sizes_of
from excitant.identify.recording import Recording
from excitant.robots.effects.sensing import LONGEST_DELAY
from excitant.robots.limits import UNLIMITED
from excitant.robots.motion import Array, Motion
from excitant.robots.regressor import (
    CIRCLE,
    circle_weights,
    rigid_body_torque,
)
from excitant.robots.robot import Robot, spans


@dataclass(frozen=True)
class Search:
    """Settings of the search, with which `benchmarks/mistakes.py` moves."""

    fits: float = 0.1
    "Squares per independent row, errors of the model counted: less needs no other installation."
    halved: float = 0.5
    "Part of the squares that another installation leaves at most."
    rare: float = 0.02
    "Probability that an arm has another installation than its model."
    choices: int = 12
    "Installations of each joint that are tried."
    scales: int = 30
    "Factors of a clock or of a joint's torque that data tell apart: 1e-3 to 1e3, to about a half."
    alike: float = 2.0
    "Twice the log of the ratio of evidence below which two installations look the same."
    tried: int = 6
    "Installations that are judged in full: of the discrete ones, and of all, the nearest."
    widest: float = 5.0
    """Radius of gyration over the arm's reach beyond which no body is: kg·cm² make it 100 times too
    large, lb·in² 58 times; that of a long link is a tenth of the reach, of 1 kg and 1 kg·m² 1 m."""
    least_reach: float = 0.1
    "Reach of an arm whose joints and centres of mass lie nearer than that, as of a flywheel [m]."
    polished: int = 3
    "Newton steps of what is no choice among few: an angle, gravity, a delay."
    turn: float = 0.02
    "Angles of their differences [rad], in which squares are parabolic to 1e-4."
    step: float = np.pi / 6
    "Step of the first grid of zero positions [rad]."
    right: float = np.pi / 2
    "Zero positions are multiples of it [rad], unless another is better beyond chance."
    far: float = 10.0
    "Torque in its limit that no drive makes, whatever the limit means."
    least_scale: float = 3.0
    "Factor of a torque that bodies off by `BODY_STD` do not make (3.7 std of its logarithm)."
    clear_scale: float = 0.5
    "Relative std of a joint's factor below which it is one."
    explained: float = 2 * MODEL_ERROR
    "Rms of a torque that bodies leave, in its own, below which it needs no other unit."
    clock: float = 0.1
    "Least relative error of a clock that the torque alone can show."
    parts: int = 3
    "Parts of a log, none of which may speak against an installation."
    latest: float = 0.5
    "Delay of the torque that is looked for at most [s]."


SEARCH = Search()
ANY_VALUE = 2 * np.log(SEARCH.scales)
"""Twice the log of the values that an angle or a factor may as well have, if any will do."""
_SERVOS = (360.0, 300.0, 270.0, 180.0)
"""Ranges [°] that the positions of servos count through."""
_FACTORS = np.geomspace(1e-3, 1e3, 49)
"""Factors of the time, and of positions, that are tried first."""


@dataclass(frozen=True, eq=False)
class Installation:
    """How an arm stands and how its log relates to its model, as what differs.

    Attributes:
        faults: What the model or the log has otherwise.
        price: Twice the log odds against it before data are seen.
    """

    faults: tuple[Fault, ...] = ()
    price: float = 0.0

    @property
    def evidence(self) -> dict[str, Any]:
        """Evidence of its faults by name; of several, that of the first."""
        several = [fault.evidence for fault in reversed(self.faults)]
        return {name: value for each in several for name, value in each.items()}

    @property
    def remedies(self) -> list[Remedy]:
        """What makes the log one of the model's columns; the model itself is moved by `robot`."""
        return [
            remedy
            for fault in self.faults
            if fault.fault not in INSTALLATION
            for remedy in fault.remedies
        ]

    def robot(self, robot: Robot) -> Robot:
        """The robot mounted and zeroed, its inertias in the frames, as it says."""
        for fault in self.faults:
            if fault.fault == "wrong_mounting":
                robot = robot.with_gravity(fault.evidence["gravity"])
            elif fault.fault == "wrong_zero":
                for joint in fault.joints:
                    robot = robot.with_zero(joint, fault.evidence["offset"])
            elif fault.fault == "wrong_frame":
                robot = robot.with_parameters(in_joint_frames(robot))
        return robot

    def fit(self, case: TorqueFit) -> TorqueFit:
        """The fit of a log's torque in this installation."""
        if not self.faults:
            return case
        unscaled = case.unscaled | {
            case.log.joints.index(joint)
            for fault in self.faults
            if fault.fault == "wrong_unit" and not fault.remedies
            for joint in fault.joints
        }
        data = self.read(case.data)
        robot = self.robot(case.robot)
        # what was taken off is known no better than the bodies
        weighed = None if robot.gravity.any() else case.robot
        return TorqueFit(robot, case.log, data, case.joints, unscaled, weighed)

    def read(self, data: Smooth) -> Smooth:
        """A log as it reads it."""
        since = self.evidence.get("since", data.since)
        return data.remedied(self.remedies)._replace(since=since)

    def joined(self, other: Installation) -> Installation:
        """It and another that was found in it."""
        return Installation(self.faults + other.faults, self.price + other.price)


class _Judged(NamedTuple):
    """An installation with twice the log odds for it, and the squares that it leaves."""

    installation: Installation
    odds: float
    squares: float


def _is_right(fault: Fault) -> bool:
    """Whether an offset, if it is one, is a multiple of a right angle."""
    return not fault.evidence.get("offset", 0.0) % SEARCH.right


def odds_against(robot: Robot) -> float:
    """Twice the log odds against any one other installation of an arm before data are seen."""
    return 2 * float(np.log(SEARCH.choices * robot.nv / SEARCH.rare))


def installation_faults(case: TorqueFit) -> list[Fault]:
    """The faults of unit, installation and clock that the torque shows."""
    beyond = [*positions_beyond_limits(case.robot, case.data.motion.q)]
    if faults := [*_torque_beyond_limits(case, bool(beyond))]:
        return beyond + faults
    best = Installation()
    reasons = dict[int, Sequence[Any]]()
    doubts = list[Fault]()
    for _ in range(case.robot.nv):
        tried = [best.joined(move) for move in _moves(best.fit(case))]
        judged = sorted(_judge(case, tried), key=lambda each: -each.odds)
        # one by one: what another leaves is no noise of theirs
        likely = [
            _polished(case, each.installation)
            for each in judged[: SEARCH.tried]
            if each.odds > 0 and _likelier(case, each.installation, best)
        ]
        if not likely:
            if not best.faults:
                doubts = _doubts(case, judged)
            break
        stands, *same = _judge(case, [Installation(), *likely])
        simplest, *reason = _simplest(stands, same, case)
        # no other is told where a load is as likely
        if "load" in simplest.installation.evidence:
            break
        best = simplest.installation
        reasons[len(best.faults) - 1] = reason
        if simplest.squares < case.rows.sum():
            break
    if not best.faults or not _throughout(case, best):
        return beyond + doubts
    faults = [*best.faults]
    for k, (because, more) in reasons.items():
        fault = faults[k]
        evidence = {**fault.evidence, **more}
        faults[k] = replace(fault, detail=fault.detail + because, evidence=evidence)
    # those found beside a guess rest on it
    first = next(
        (k for k, f in enumerate(faults) if OPEN in f.evidence), len(faults)
    )
    return faults[:first] + [as_guess(fault) for fault in faults[first:]]


def _doubts(case: TorqueFit, judged: Sequence[_Judged]) -> list[Fault]:
    """What the torque speaks for, yet not beyond the odds against any other installation."""
    against = odds_against(case.robot)
    likely = [
        found
        for each in judged[: SEARCH.tried]
        if (found := _likelier(case, each.installation, Installation(), -against))
    ]
    if not likely:
        return []
    [stands] = _judge(case, [Installation()])
    best, because, evidence = _simplest(stands, likely, case)
    if not _throughout(case, best.installation):
        return []
    why = (
        f"{because}, but so may it be that of other bodies: undecided (odds of "
        f"{np.exp(best.odds / 2):.2g}); record dq too, which shows the clock, and known loads, "
        "which show units, signs and zero positions"
    )
    return [
        as_guess(
            replace(
                fault,
                detail=f"perhaps {fault.detail}{why}",
                evidence={**fault.evidence, **evidence, DOUBT: True},
            )
        )
        for fault in best.installation.faults
    ]


def _polished(case: TorqueFit, installation: Installation) -> Installation:
    """It with the angles, gravity and delays that leave the fewest squares, each with its std.

    Bodies are near the nominal ones, noise is what no bodies explain. Zero positions that are right
    angles, which no other was better than beyond chance, stay such.
    """
    faults = installation.faults
    each = [_ways(case, fault) for fault in faults]
    ways = scipy.linalg.block_diag(*each)
    ends = np.cumsum([len(some) for some in each])
    if not ways.any():
        return installation
    start = installation.fit(case)
    noise = np.minimum(start.power / start.size, MODEL_ERROR**2)
    weight = start.weight(0.0, start.rows) * MODEL_ERROR**2 / noise[start.joints]

    def moved(change: Array, std: Array | None = None) -> Installation:
        steps = np.split(change, ends[:-1])
        stds = [None] * len(faults) if std is None else np.split(std, ends[:-1])
        parts = zip(faults, steps, stds, strict=True)
        return replace(
            installation, faults=tuple(_moved(case, *part) for part in parts)
        )

    def squares(x: Array) -> float:
        return moved(ways @ x).fit(case).squares(weight)

    x, least, covariance = _newton(squares, ways.shape[1])
    if not np.isfinite(covariance).all():
        return installation
    covariance = covariance * max(1.0, least / start.rows.sum())
    std = np.sqrt(np.diag(ways @ covariance @ ways.T))
    right = [f.fault == "wrong_zero" and _is_right(f) for f in faults]
    fixed = np.repeat(right, [len(some) for some in each])
    return moved(np.where(fixed, 0.0, ways @ x), std)


def _newton(
    squares: Callable[[Array], float], size: int
) -> tuple[Array, float, Array]:
    """Where squares are least near zero, shape (size,), their least, and the covariance of that.

    The latter is infinite where they are not least.
    """
    moves = SEARCH.turn * np.eye(size)
    x = np.zeros(size)
    least = squares(x)
    covariance = np.full((size, size), np.inf)
    for _ in range(SEARCH.polished):
        ahead, behind = (
            np.array([squares(x + move) for move in way]) for way in (moves, -moves)
        )
        curvature = np.diag(ahead + behind - 2 * least)
        for i, k in itertools.combinations(range(size), 2):
            both = squares(x + moves[i] + moves[k])
            curvature[i, k] = curvature[k, i] = both - ahead[i] - ahead[k] + least
        if np.linalg.eigvalsh(curvature).min() <= 0:
            break
        covariance = 2 * SEARCH.turn**2 * np.linalg.inv(curvature)
        change = moves @ np.linalg.solve(curvature, (ahead - behind) / 2)
        left = squares(x - change)
        if left >= least:
            # too far where squares are no parabola
            change = change / 2
            left = squares(x - change)
        if left >= least:
            break
        x = x - change
        least = left
    return x, least, covariance


def _ways(case: TorqueFit, fault: Fault) -> Array:
    """Ways in which values of a fault that are no choice among few change, (values, steps).

    A step is an angle [rad]: gravity turns about two axes; no gravity has no direction. It is also
    so many samples of a delay.
    """
    if fault.fault == "wrong_mounting":
        gravity = fault.evidence["gravity"]
        turned = np.linalg.svd(gravity[None])[2][1:].T
        return np.linalg.norm(gravity) * turned[:, : 2 * gravity.any()]
    if fault.fault == "time_delay":
        return np.array([[1 / (case.data.rate * SEARCH.turn)]])
    values = int(fault.fault == "wrong_zero")
    return np.ones((values, values))


def _moved(case: TorqueFit, fault: Fault, step: Array, std: Array | None) -> Fault:
    """A fault whose gravity, offset [rad] or delay [s] changes by a step, and is known to a std."""
    name, told = _OF_VALUES.get(fault.fault, ("", None))
    # no gravity has no direction
    if told is None or not np.any(fault.evidence[name]):
        return fault
    joints = [case.log.joints.index(joint) for joint in fault.joints]
    return told(case, joints, fault.evidence[name] + step, std)


def _throughout(case: TorqueFit, installation: Installation) -> bool:
    """Whether no part of a log speaks against it, as those do that lack the push of a hand."""
    dead = {*case.log.joints} - {case.log.joints[j] for j in case.joints}
    for rows in np.array_split(np.arange(len(case.log)), SEARCH.parts):
        log = case.log.take(rows)
        part = torque_fit(case.robot, log, smooth(log), dead)
        if part:
            stands, judged = _judge(part, [Installation(), installation])
            if judged.squares > stands.squares + SEARCH.fits * part.rows.sum():
                return False
    return True


def _likelier(
    case: TorqueFit,
    installation: Installation,
    other: Installation,
    least: float = 0.0,
) -> _Judged | None:
    """An installation that leaves half the squares of another, or fits, and is likelier.

    That is by twice the log odds that are given. A change in mid-run, which stands for much that a
    model may lack, leaves a tenth. A load or other bodies explain much, but no torque that is too
    small everywhere: a factor of it that is not known leaves one per row.
    """
    theirs, mine = _judge(case, [other, installation])
    share = SEARCH.fits if "since" in installation.evidence else SEARCH.halved
    fits = 1.0 if "small" in installation.evidence else SEARCH.fits
    allowed = max(share * theirs.squares, fits * case.rows.sum())
    likelier = mine.odds > theirs.odds + least and mine.squares <= allowed
    return mine if likelier else None


def _judge(case: TorqueFit, installations: Sequence[Installation]) -> list[_Judged]:
    """Each installation by the evidence of the torque and its price."""
    evidence = _evidence(case, [each.fit(case) for each in installations])
    return [
        _Judged(each, gain - each.price, squares)
        for each, (gain, squares) in zip(installations, evidence, strict=True)
    ]


def _evidence(
    case: TorqueFit, fits: Sequence[TorqueFit]
) -> Iterator[tuple[float, float]]:
    """Twice the log evidence of fits against that of the log as it stands, and their squares.

    As it stands any one of the links may be another body: that needs no other installation. Errors
    of the model count as noise.
    """
    nv = case.robot.nv
    noise = case.power
    for fit in fits:
        power = fit.power / fit.data.scale**2
        noise = np.minimum(noise, power[np.argsort(fit.data.recorded)])
    links = [case.surprise(noise, case.rows, link) for link in range(nv)]
    squares, surprises = zip(*links, strict=True)
    rows = case.rows.sum()
    for fit in fits:
        if fit is case:
            yield 0.0, min(squares)
            continue
        order = fit.data.recorded
        left, surprise = fit.surprise(noise[order], case.rows[order], nv - 1)
        yield (min(surprises) - surprise) / max(1.0, left / rows), left


def _simplest(
    stands: _Judged, likely: Sequence[_Judged], case: TorqueFit
) -> tuple[_Judged, str, dict[str, Any]]:
    """The first of those that look the same, why in words, and its evidence; see `_likelier`.

    Few faults come before many, then as in `FAULTS`, right angles before others, and joints from
    the base: all recordings of an arm name the same one.
    """
    rows = case.rows.sum()
    least_odds = max(each.odds for each in likely) - SEARCH.alike
    same = [each for each in likely if each.odds >= least_odds]
    least = min(each.squares for each in same)
    allowed = max(least / SEARCH.halved, SEARCH.fits * rows)

    def rank(each: _Judged) -> tuple[int, int, int, list[int]]:
        faults = each.installation.faults
        places = [case.log.joints.index(fault.joints[0]) for fault in faults]
        odd = sum(not _is_right(fault) for fault in faults)
        return len(faults), FAULTS.index(faults[0].fault), odd, places

    best, *others = sorted((x for x in same if x.squares <= allowed), key=rank)
    because = (
        "; so read, the torque is that of bodies near the given ones (sum of squares "
        f"{stands.squares:.3g} → {best.squares:.3g} in {rows:.0f} independent rows)"
    )
    alike = dict[tuple[Any, ...], str]()
    for other in others:
        faults = other.installation.faults
        details = " and ".join(fault.detail for fault in faults)
        alike.setdefault(_kinds(faults), details)
    kinds = _kinds(best.installation.faults)
    alike.pop(kinds, None)
    if alike:
        because += (
            f"; the torque would be the same if {' or if '.join(alike.values())}"
        )
    told = {kind[:2] for kind in kinds}
    others_kinds = [*itertools.chain(*alike)]
    rivals = [x[:2] for x in others_kinds if x[:2] not in told]
    evidence: dict[str, Any] = {"alike": rivals}
    # which column of a joint has the sign
    if any(x[:2] in told and x not in kinds for x in others_kinds):
        evidence[OPEN] = True
    return best, because, evidence


def _kinds(faults: Sequence[Fault]) -> tuple[Any, ...]:
    """What faults are of, whatever their values: a sign of q is another than one of torque."""
    return tuple((f.fault, f.joints, f.channel) for f in faults)


def pose_faults(robot: Robot, log: Log) -> Iterator[Fault]:
    """Joints of an arm at rest whose torque is that of nominal bodies by a factor none can make.

    Beyond what comes by chance of so many poses, as friction at rest is no such multiple.
    """
    if log.unit != "N·m" or not is_described(robot):
        return
    still = np.zeros_like(log.q)
    model = rigid_body_torque(robot, Motion(log.t, log.q, still, still))
    for j in np.flatnonzero(np.ptp(model, axis=0) > 0):
        x, y = (every[:, j] - every[:, j].mean() for every in (model, log.tau))
        factor = x @ y / (x @ x)
        share = factor * (x @ y) / max(y @ y, 1e-300)
        unexplained = max(1 - share, 0.0)
        # of a correlation as large, of normal values
        chance = scipy.special.betainc((len(log) - 2) / 2, 0.5, unexplained)
        if chance >= ALARM / log.nv or unexplained >= SEARCH.halved:
            continue
        joints = log.names([j])
        times = f"tau of {joints[0]} at rest is {factor:.3g} times that of the nominal bodies"
        evidence = {"channel": "tau"}
        if factor < 0:
            detail = f"{times}: q or tau counts the other way than the robot's"
            yield Fault("wrong_sign", joints, detail, evidence)
        elif abs(np.log(factor)) > np.log(SEARCH.least_scale):
            detail = f"{times}: another unit, or a current"
            yield Fault("wrong_unit", joints, detail, evidence)


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
    case = torque_fit(robot, log, smooth(log), joints_without_torque(others))
    if case is None:
        return 0.0
    likely = _likelier(case, Installation(tuple(faults)), Installation())
    return likely.odds if likely else -np.inf


def swapped(robot: Robot, recordings: Sequence[Recording]) -> list[tuple[int, int]]:
    """Pairs of recordings, of as many rows each, of which each has the torque of the other.

    As an installation, that has to be likelier than all that the model may lack, all pairs counted.
    """
    if not is_described(robot):
        return []
    logs = [Log.of(robot, recording) for recording in recordings]
    kinds = [(len(log), log.unit) for log in logs]
    pairs = [
        pair
        for pair in itertools.combinations(range(len(logs)), 2)
        if kinds[pair[0]] == kinds[pair[1]]
    ]
    odds = 2 * np.log(max(len(pairs), 1) / SEARCH.rare)
    exchanged = list[tuple[int, int]]()
    for i, k in pairs:
        if {i, k} & {*itertools.chain(*exchanged)}:
            continue
        gain = _with_torque_of(robot, logs[i], logs[k])
        if gain > -np.inf:
            gain += _with_torque_of(robot, logs[k], logs[i])
        if gain > odds:
            exchanged.append((i, k))
    return exchanged


def _with_torque_of(robot: Robot, log: Log, other: Log) -> float:
    """Twice the log evidence ratio of a log with another's torque; −∞ where that is not likely."""
    case = torque_fit(robot, log, smooth(log), set())
    moved = smooth(replace(log, tau=other.tau))
    if case is None or moved is None:
        return -np.inf
    exchanged = replace(case, data=moved)
    if _unlikeness(exchanged) - _unlikeness(case) > np.log(SEARCH.halved):
        return -np.inf
    [(gain, _)] = _evidence(case, [exchanged])
    return gain


def _moves(fit: TorqueFit) -> Iterator[Installation]:
    """Installations next to the one of a fit, each the likeliest of its kind."""
    if len(beyond_limits(fit.robot, fit.data.motion.q)[0]):
        # a gear ratio may look like degrees, but suits the torque at another factor
        for installation in _in_degrees(fit):
            if _is_best_factor(fit, installation.faults[0]):
                yield installation
        for installation in _nearest(fit, _orders(fit)):
            q = installation.fit(fit).data.motion.q
            if not len(beyond_limits(fit.robot, q)[0]):
                yield installation
        return
    rows = np.maximum(fit.rows, 1.0)
    squares, _ = fit.surprise(0 * fit.power, rows, fit.robot.nv - 1)
    if squares < SEARCH.fits * rows.sum():
        return
    yield from _in_degrees(fit)
    yield _backwards(fit)
    yield from _clock(fit)
    yield from _delays(fit)
    yield from _changes(fit)
    # friction tells signs that the torque of bodies does not
    yield from _signs(fit)
    if not is_described(fit.robot):
        return
    yield from _nearest(fit, [*_orders(fit), *_couplings(fit)])
    yield from _from_zero(fit)
    if squares > rows.sum():
        yield from _nearest(fit, _two_zeros(fit))
    yield from _frames(fit)
    yield from _of_limits(fit)
    yield from _scales(fit)
    yield from _mounting(fit)
    turning = [j for j in fit.joints if fit.robot.revolute[j]]
    zeros = [move for j in turning for move in _zeros(fit, j)]
    yield from _nearest(fit, zeros)


def _one(fit: TorqueFit, *faults: Fault, more: float = 0.0) -> Installation:
    """An installation by its faults, and twice the log of further choices that it had."""
    return Installation(faults, len(faults) * odds_against(fit.robot) + more)


def _unlikeness(fit: TorqueFit, faults: Sequence[Fault] = ()) -> float:
    """Mean log of the share of torque that nominal bodies and own effects leave, with faults."""
    installation = Installation(tuple(faults))
    data = installation.read(fit.data)
    model = rigid_body_torque(installation.robot(fit.robot), data.motion)
    return float(_shares(fit, _products(data, [model]), data)[[*fit.joints]].mean())


def _products(data: Smooth, torques: Sequence[Array]) -> Array:
    """Products of m torques, (N, nv) each, and the measured one, without own effects.

    Returns:
        Shape (nv, m + 1, m + 1).
    """
    every = np.stack([*torques, data.tau], axis=2).swapaxes(0, 1)
    Q = np.linalg.qr(data.effects.swapaxes(0, 1))[0]
    every = every - Q @ (Q.swapaxes(1, 2) @ every)
    return every.swapaxes(1, 2) @ every


def _shares(fit: TorqueFit, products: Array, data: Smooth) -> Array:
    """Logarithm of these shares, from the products of a torque of the bodies; shape (nv,).

    The bodies' torque counts up to a factor of each joint: one that other bodies may make, where
    torque was recorded.
    """
    size = np.maximum(products[:, 0, 0], 1e-300)
    both = products[:, 0, 1]
    factor = both / size
    most = np.full(fit.robot.nv, np.inf)
    if is_described(fit.robot) and fit.log.unit == "N·m":
        most[:] = SEARCH.least_scale
        most[[*fit.unscaled]] = np.inf
    factor = np.clip(factor, 1 / most, most)
    left = products[:, 1, 1] - 2 * factor * both + factor**2 * size
    share = left / np.maximum((data.tau**2).sum(axis=0), 1e-300)
    return np.log(np.maximum(share, MODEL_ERROR**2))


def _of_sums(
    fit: TorqueFit,
    faults: Sequence[Fault],
    robots: Iterable[Robot],
    weights: Callable[[Array], Array],
) -> Callable[[Array], float]:
    """`_unlikeness` by values with which the torque is the weighted sum of that of robots.

    Args:
        fit: A log.
        faults: What is otherwise whatever the values.
        robots: m of them.
        weights: Function of the values, (d,), shape (m,).
    """
    data = Installation(tuple(faults)).read(fit.data)
    torques = [rigid_body_torque(robot, data.motion) for robot in robots]
    products = _products(data, torques)

    def unlikeness(values: Array) -> float:
        sums = np.zeros((len(torques) + 1, 2))
        sums[:-1, 0] = weights(values)
        sums[-1, 1] = 1.0
        shares = _shares(fit, sums.T @ products @ sums, data)
        return float(shares[[*fit.joints]].mean())

    return unlikeness


def _best(
    unlikeness: Callable[[Array], float], starts: Array, reach: float
) -> Array:
    """Values (d,) with which the torque is least unlike, near the best of starts, (m, d)."""
    near = min(starts, key=unlikeness)
    bounds = [(x - reach, x + reach) for x in near]
    found = scipy.optimize.minimize(
        unlikeness, near, method="Powell", bounds=bounds, tol=SEARCH.turn
    )
    return found.x


def _nearest(
    fit: TorqueFit, tried: Iterable[Installation]
) -> Iterator[Installation]:
    """The few of many that suit the nominal bodies best, and better than as it stands."""
    as_it_stands = _unlikeness(fit)
    unlikeness = [(_unlikeness(fit, each.faults), each) for each in tried]
    unlikeness.sort(key=lambda pair: pair[0])
    for value, installation in unlikeness[: SEARCH.tried]:
        if value < as_it_stands:
            yield installation


def _orders(fit: TorqueFit) -> Iterator[Installation]:
    """Two joints exchanged, all shifted, reversed or by name: of all columns, or of torque."""
    log = fit.log
    n = fit.robot.nv
    if not len(fit.joints) == n > 1:
        return
    same = tuple(range(n))
    orders = {same[::-1], (*same[1:], 0), (n - 1, *same[:-1])}
    orders.add(tuple(np.argsort(np.argsort(log.joints)).tolist()))
    for i, k in itertools.combinations(same, 2):
        swap = [*same]
        swap[i], swap[k] = k, i
        orders.add(tuple(swap))
    for order in sorted(orders - {same}):
        names = log.names(order)
        wrong = [j for j in same if order[j] != j]
        words = ", ".join(
            f"{log.joints[j]} is recorded as {names[j]}" for j in wrong
        )
        for channels in (("q", "dq", "tau"), ("tau",)):
            what = "columns" if len(channels) > 1 else "torque columns"
            fault = Fault(
                "wrong_order",
                log.names(wrong),
                f"{what} are in another order: {words}",
                {},
                f"puts the {what} of {len(wrong)} joints in the order of the robot",
                tuple(Remedy("order", channel, order) for channel in channels),
            )
            yield _one(fit, fault)


def _signs(fit: TorqueFit) -> Iterator[Installation]:
    """Each joint that counts or measures torque the other way, two torques, or all."""
    several = itertools.combinations(fit.joints, 2)
    more = 2 * np.log(fit.robot.nv)
    pairs = (_one(fit, _sign(fit, pair), more=more) for pair in several)
    yield from _nearest(fit, pairs)
    if len(fit.joints) > 2:
        yield _one(fit, _sign(fit, fit.joints))
    for j in fit.joints:
        moves = fit.log.moving[:, j].any()
        for channels in (("q", "dq"), ("tau",), ("q", "dq", "tau")):
            if moves or "q" not in channels:
                yield _one(fit, _sign(fit, [j], channels))


def _sign(
    fit: TorqueFit, joints: Sequence[int], channels: Sequence[str] = ("tau",)
) -> Fault:
    what = " and ".join(name for name in channels if name != "dq")
    names = fit.log.names(joints)
    listed = ", ".join(names)
    return Fault(
        "wrong_sign",
        names,
        f"{what} of {listed} count{'s' * (' and ' not in what)} the other way than the robot's",
        {"channel": what},
        f"negates {what}{' (and dq)' * ('dq' in channels)} of {listed}",
        tuple(
            Remedy("scale", name, tuple(joints), factor=-1.0) for name in channels
        ),
    )


def _couplings(fit: TorqueFit) -> Iterator[Installation]:
    """Neighbours of which one's position is logged with that of the other added or taken off.

    θ = L q has the power of τ_θᵀ θ̇ = τᵀ q̇, so that τ = Lᵀ τ_θ, where torque is of the same axes.
    Bodies tell that: friction of motors is of their axes in any case.
    """
    turns = fit.robot.revolute
    bodies = rigid_body_torque(fit.robot, fit.data.motion).std(axis=0)
    tells = bodies > MODEL_ERROR * fit.data.tau.std(axis=0)
    neighbours = [
        (j, k)
        for j, k in itertools.permutations(range(fit.robot.nv), 2)
        if abs(j - k) == 1 and turns[j] == turns[k] and (tells[j] or tells[k])
    ]
    choices = itertools.product(neighbours, (1.0, -1.0), (True, False))
    for (j, k), sign, torque in choices:
        joint, other = fit.log.names((j, k))
        added = sign > 0
        remedies = [
            Remedy("add", name, (j, k), factor=-sign) for name in ("q", "dq")
        ]
        remedies += [Remedy("add", "tau", (k, j), factor=sign)] * torque
        fault = Fault(
            "coupled_axes",
            (joint, other),
            f"q of {joint} is logged with that of {other} {'added' if added else 'taken off'}"
            + ", and torque is that of these axes" * torque,
            {"channel": "q"},
            f"{'takes' if added else 'adds'} q of {other} {'off' if added else 'to'} that of "
            f"{joint}",
            tuple(remedies),
        )
        yield _one(fit, fault)


def _two_zeros(fit: TorqueFit) -> Iterator[Installation]:
    """Zero positions of two joints that are off by right angles."""
    turning = [j for j in range(fit.robot.nv) if fit.robot.revolute[j]]
    right = (SEARCH.right, -SEARCH.right, 2 * SEARCH.right)
    for pair in itertools.combinations(turning, 2):
        for angles in itertools.product(right, right):
            places = zip(pair, angles, strict=True)
            zeros = [_zero(fit, [j], np.array([angle])) for j, angle in places]
            yield _one(fit, *zeros)


def _from_zero(fit: TorqueFit) -> Iterator[Installation]:
    """Positions of servos that count from zero, where the model has the middle of their range."""
    turning = np.flatnonzero(fit.robot.revolute)
    q = fit.data.motion.q[:, turning]
    if not len(turning) or q.min() < -SEARCH.turn:
        return
    for degrees in _SERVOS:
        if q.max() < np.radians(degrees) + SEARCH.turn:
            middle = np.radians([-degrees / 2])
            yield _one(fit, _zero(fit, turning.tolist(), middle))


def _zero(
    fit: TorqueFit, joints: Sequence[int], offset: Array, std: Array | None = None
) -> Fault:
    names = fit.log.names(joints)
    listed = ", ".join(names)
    [angle] = np.degrees(offset)
    known = "" if std is None else f" ± {np.degrees(std[0]):.2g}"
    reading = f"{'+' if angle > 0 else '−'} {abs(angle):.3g}{known}°"
    return Fault(
        "wrong_zero",
        names,
        f"the zero position of {listed} is off: {'its' if len(names) == 1 else 'each'} true angle "
        f"is the reading {reading}",
        {"offset": float(offset[0])} | _known(std),
        f"adds {angle:.4g}° to q of {listed}",
        (Remedy("offset", "q", tuple(joints), factor=float(offset[0])),),
    )


def _known(std: Array | None) -> dict[str, Any]:
    """Evidence of how well a value is known, or each of several."""
    if std is None:
        return {}
    return {"std": std.tolist() if len(std) > 1 else float(std[0])}


def _in_degrees(fit: TorqueFit) -> Iterator[Installation]:
    """Positions in degrees, of all joints that turn or of those beyond a turn."""
    log = fit.log
    largest = np.abs(fit.data.motion.q).max(axis=0)
    turning = fit.robot.revolute
    # more than joints turn to one side
    beyond = turning & (largest > 1.2 * 2 * np.pi)
    if not beyond.any():
        return
    for mask in [turning] if beyond[turning].all() else [turning, beyond]:
        joints = tuple(np.flatnonzero(mask).tolist())
        widest = max(joints, key=lambda j: largest[j])
        remedies = (
            Remedy("scale", name, joints, factor=np.pi / 180)
            for name in ("q", "dq")
        )
        yield _one(
            fit,
            Fault(
                "wrong_unit",
                log.names(joints),
                f"q is in degrees: it reaches {largest[widest]:.4g} at {log.joints[widest]}",
                {"channel": "q"},
                "multiplies q and dq, which agrees with it, by π/180",
                tuple(remedies),
            ),
        )


def _is_best_factor(fit: TorqueFit, fault: Fault) -> bool:
    """Whether no other factor of these positions suits the nominal bodies better."""

    def scaled(factor: float) -> list[Fault]:
        remedies = tuple(replace(r, factor=factor) for r in fault.remedies)
        return [replace(fault, remedies=remedies)]

    least = min(_unlikeness(fit, scaled(x)) for x in _FACTORS[_FACTORS <= 1])
    # of a logarithm: a twentieth of an error
    return _unlikeness(fit, [fault]) < least + 0.1


def beyond_limits(robot: Robot, q: Array) -> tuple[Rows, Array]:
    """Joints whose positions (n, nv) leave their limits by a turn, or their range, and by how much.

    The latter in these, shape (nv,).
    """
    low, high = np.clip(robot.limits.position, -UNLIMITED, UNLIMITED).T
    margin = np.where(robot.revolute, 2 * np.pi, high - low)
    reach = np.maximum(q.max(axis=0) - high, low - q.min(axis=0)) / margin
    return np.flatnonzero(reach > 1), reach


def inertias_beyond_size(robot: Robot) -> Iterator[Fault]:
    """Given inertias of bodies far wider than the whole arm, which only another unit explains."""
    bodies = robot.phi.reshape(-1, 10)
    bodies = bodies[bodies[:, 0] > 0]
    links = np.array(robot.links)[robot.phi[::10] > 0]
    com = np.linalg.norm(bodies[:, 1:4] / bodies[:, :1], axis=1)
    trace = bodies[:, [4, 6, 9]].sum(axis=1)
    square = trace / (2 * bodies[:, 0]) - com**2
    radius = np.sqrt(np.maximum(square, 0.0))
    reach = max(sum(spans(robot)) + com.max(initial=0.0), SEARCH.least_reach)
    wide = radius > SEARCH.widest * reach
    if not wide.any():
        return
    detail = (
        f"the given inertias of {', '.join(links[wide])} do not go with the masses: radius of "
        f"gyration {radius.max():.3g} m in an arm of {reach:.2g} m: another unit; give kg·m² (not "
        "kg·mm² or g·mm²) and kg in the robot's file"
    )
    joints = tuple(robot.joints[robot.links.index(link)] for link in links[wide])
    yield Fault("wrong_unit", joints, detail, {"channel": "inertia"})


def refuse_positions_beyond(robot: Robot, recording: Recording) -> None:
    """Refuse, as BadRecording, what cannot be the joints' positions [rad or m]."""
    for fault in positions_beyond_limits(robot, recording.q):
        raise BadRecording(recording.file, fault.detail)


def positions_beyond_limits(robot: Robot, q: Array) -> Iterator[Fault]:
    """Positions that leave the joints' limits by more than a turn, or by their whole range."""
    joints = robot.joints
    beyond, reach = beyond_limits(robot, q)
    if not len(beyond):
        return
    low, high = robot.limits.position.T
    names = tuple(joints[j] for j in beyond)
    worst = np.argmax(reach)
    largest = np.abs(q[:, worst]).max()
    detail = (
        f"q of {', '.join(names)} leaves the joints' limits by more than "
        f"{'a turn' if robot.revolute[worst] else 'their range'}: {joints[worst]} reaches "
        f"{largest:.4g}, its limits are {low[worst]:.4g} and {high[worst]:.4g}: motor positions, "
        "counts or another unit"
    )
    yield Fault("wrong_unit", names, detail, {"channel": "q"})


def _torque_beyond_limits(case: TorqueFit, registers: bool) -> Iterator[Fault]:
    """Torques far beyond what drives can do, in the unit that brings them nearest.

    It has a name where bodies near the nominal ones have that torque then, and q is no register.
    """
    log = case.log
    limit = case.robot.limits.torque[case.joints]
    peak = np.abs(log.tau[:, case.joints]).max(axis=0)
    limited = np.isfinite(limit)
    if log.unit != "N·m" or not limited.any():
        return
    typical = np.median((peak / limit)[limited])
    if typical <= SEARCH.far:
        return
    # after the repair torques stay below three times what they should be
    powers = {1e2: "N·cm", 1e3: "N·mm", 1e6: "µN·m"}
    factor = next(
        (f for f in powers if typical / f < SEARCH.least_scale), max(powers)
    )
    likely = _is_unit(case, np.full(len(limit), factor))
    detail = f"tau is {typical:.3g} times the torque limit (median over joints)"
    fault = Fault(
        "wrong_unit",
        log.joints,
        f"{detail}: another unit",
        {"channel": "tau"},
    )
    if likely and not registers:
        every = tuple(range(log.nv))
        fault = replace(
            fault,
            detail=f"{detail}, as in {powers[factor]}",
            repair=f"divides tau by {factor:g}",
            remedies=(Remedy("scale", "tau", every, factor=1 / factor),),
        )
    yield fault


def _is_unit(fit: TorqueFit, factors: Array) -> bool:
    """Whether factors, (k,), bring the torque near that of nominal bodies where it tells one."""
    gains, std = fit.gains
    off = np.abs(np.log(gains / factors))[std < SEARCH.clear_scale]
    return len(off) > 0 and bool(np.median(off) < np.log(SEARCH.least_scale))


def _of_limits(fit: TorqueFit) -> Iterator[Installation]:
    """Torque in parts of each joint's limit, as drives tell it."""
    limit = fit.robot.limits.torque
    if fit.log.unit != "N·m" or fit.unscaled or not np.isfinite(limit).all():
        return
    # a load makes the torque of bodies, however large
    if (fit.left < SEARCH.explained).all():
        return
    for whole, name in ((100.0, "per cent"), (1000.0, "per mille")):
        if not _is_unit(fit, whole / limit[fit.joints]):
            continue
        remedies = (
            Remedy("scale", "tau", (j,), factor=most / whole)
            for j, most in enumerate(limit.tolist())
        )
        yield _one(
            fit,
            Fault(
                "wrong_unit",
                fit.log.joints,
                f"tau is in {name} of the torque limits",
                {"channel": "tau"},
                f"multiplies tau by the torque limits and divides it by {whole:g}",
                tuple(remedies),
            ),
        )


def _scales(fit: TorqueFit) -> Iterator[Installation]:
    """Readings that are the torque of bodies near the nominal ones by a factor of each joint."""
    if fit.log.unit != "N·m" or fit.unscaled:
        return
    gains, std = fit.gains
    # of bodies that are off, and of noise
    scatter = np.maximum(std / BODY_STD, 1.0)
    far = np.abs(np.log(gains)) > scatter * np.log(SEARCH.least_scale)
    clear = std < SEARCH.clear_scale
    some = np.flatnonzero(far & clear)
    if not len(some):
        return
    # a load makes the torque of bodies, however large
    loaded = (gains[some] > 1).all() and (fit.left[some] < SEARCH.explained).all()
    joints = np.array(fit.joints)
    # joints whose torque tells no factor have one as well
    unscaled = fit.log.names(joints[far | ~clear])
    gains = gains[some]
    typical = np.exp(np.log(gains).mean())
    one = bool((np.abs(np.log(gains / typical)) < 3.0 * std[some]).all())
    names = fit.log.names(joints[some])
    if one:
        like = [
            f"{1 / size:.3g} in {unit}"
            for unit, size in sizes_of("tau").items()
            if abs(np.log(typical * size)) < BODY_STD
        ]
        what = f"{typical:.3g} times the torque of bodies near the given ones"
    else:
        like = [f"{n} {g:.3g}" for n, g in zip(names, gains, strict=True)]
        what = "not the torque of bodies near the given ones, but that by a factor of each joint"
    if like:
        what += f" ({', '.join(like)})"
    detail = (
        f"tau of {', '.join(names)} is {what}: another unit, currents or per cent, or inertias of "
        "the model in another unit"
    )
    marks = {"small": (gains < 1).all(), "load": loaded}
    evidence = {"channel": "tau"} | {mark: True for mark, of in marks.items() if of}
    fault = Fault("wrong_unit", unscaled, detail, evidence)
    factors = 1 if one else len(names)
    yield _one(fit, fault, more=factors * ANY_VALUE)


def _frames(fit: TorqueFit) -> Iterator[Installation]:
    """The nominal inertias as those about the distal frames."""
    detail = (
        "the inertias of the given model are those about the distal frames, at the next joints; "
        "move them to the joints' own in the robot's file"
    )
    yield _one(fit, Fault("wrong_frame", fit.log.joints, detail, {}))


def in_joint_frames(robot: Robot) -> Array:
    """Standard parameters in the joints' frames, those given being in the distal ones, (10 nv,)."""
    model = robot.model
    places = [model.jointPlacements[j + 1] for j in range(1, robot.nv)]
    places.append(model.frames[robot.tip].placement)
    bodies = map(pin.Inertia.FromDynamicParameters, robot.phi.reshape(-1, 10))
    pairs = zip(places, bodies, strict=True)
    moved = [place.act(body).toDynamicParameters() for place, body in pairs]
    return np.concatenate(moved)


def _backwards(fit: TorqueFit) -> Installation:
    """The motion from its end to its begin: friction drives then, inertia and weight stay."""
    detail = (
        "the rows run backwards in time: friction drives where it should brake, and dq, if it is "
        "logged, is the opposite of the change of q; reverse the rows of all columns but time"
    )
    reversal = Remedy("scale", "t", factor=-1.0)
    evidence = {"channel": "t", OPEN: True}
    fault = Fault(
        "wrong_sample_rate", fit.log.joints, detail, evidence, None, (reversal,)
    )
    return _one(fit, fault)


def _clock(fit: TorqueFit) -> Iterator[Installation]:
    """The factor of the time that suits the torque best, and factors that are so for a reason."""
    log = fit.log
    if clock_confirmed(log):
        return

    def told(logarithm: Array) -> list[Fault]:
        factor = float(np.exp(logarithm[0]))
        detail = (
            f"the time runs {factor:.3g} times too {'slow' if factor > 1 else 'fast'} for the "
            f"torque: the median step is {log.step:.4g} s, {log.step / factor:.4g} s would fit"
        )
        return [slow_clock(log.joints, factor, detail)]

    yield from _nearest(fit, [_one(fit, *told(np.log([rate]))) for rate in RATES])
    grid = np.log(_FACTORS)
    best = _best(
        lambda logarithm: _unlikeness(fit, told(logarithm)),
        grid[:, None],
        grid[1] - grid[0],
    )
    if np.abs(best) >= SEARCH.clock:
        # an odd factor may stand for anything that the model lacks
        yield _one(fit, *told(best), more=ANY_VALUE)


def _delays(fit: TorqueFit) -> Iterator[Installation]:
    """Torque of all joints, or of that it suits best, later or earlier than drives and filters are.

    Sought at nominal bodies, refined with bodies near them.
    """
    data = fit.data
    step = 1 / data.rate
    rows = int(min(SEARCH.latest, fit.log.duration / 10) / step)
    lags = np.linspace(-rows * step, rows * step, 2 * rows + 1)
    every = tuple(range(fit.robot.nv))
    late = (
        data.remedied([Remedy("advance", "tau", every, factor=lag)])
        for lag in lags.tolist()
    )
    rises = _rises(fit, late)
    rises[np.abs(lags) <= LONGEST_DELAY - step] = 0.0
    lag, place = np.unravel_index(np.argmin(rises), rises.shape)
    if rises[lag, place] == 0:
        return
    joints = [every, *((j,) for j in fit.joints)][place]
    choices = 2 * np.log(len(lags))
    found = _polished(
        fit, _one(fit, _late(fit, joints, lags[lag : lag + 1]), more=choices)
    )
    evidence = found.evidence
    std = evidence.get("std", np.inf)
    if LONGEST_DELAY + 2 * std < abs(evidence["delay"]) <= SEARCH.latest:
        yield found


def _rises(fit: TorqueFit, tried: Iterable[Smooth]) -> Array:
    """Rises of all `_shares`, and of each joint's, as a log is read otherwise, (m, 1 + k)."""
    model = rigid_body_torque(fit.robot, fit.data.motion)
    every = (fit.data, *tried)
    shares = np.array([_shares(fit, _products(x, [model]), x) for x in every])
    rises = (shares[1:] - shares[0])[:, fit.joints]
    return np.column_stack([rises.sum(axis=1), rises])


def _changes(fit: TorqueFit) -> Iterator[Installation]:
    """Dry friction and offset of all joints, or of that it suits best, others from some time on."""
    data = fit.data
    # beside a factor that is not known, a change may be a load
    if data.since is not None or fit.unscaled:
        return
    t = data.motion.t
    nv = fit.robot.nv
    # a fifth of the log, at either end, says too little of one of the two
    times = np.linspace(t[0], t[-1], SEARCH.scales)[6:-6]
    rises = _rises(fit, (data._replace(since=np.full(nv, x)) for x in times))
    every = tuple(range(nv))
    one = int(np.argmin(rises[:, 1:].min(axis=0)))
    for joints, rise in (
        (every, rises[:, 0]),
        ((fit.joints[one],), rises[:, 1 + one]),
    ):
        since = np.full(nv, np.inf)
        since[[*joints]] = start = times[np.argmin(rise)]
        names = fit.log.names(joints)
        where = f" of {names[0]}" if len(joints) < len(every) else ""
        detail = (
            f"the torque{where} is another from t = {start:.3g} s on, by an offset or dry "
            "friction, as where a brake closes, a load is taken up or a sensor is zeroed: cut the "
            "recording there"
        )
        evidence = {"channel": "tau", "since": since, "jumps": 1}
        # of a time, and of two values of each joint
        choices = ANY_VALUE + 2 * len(joints) * np.log(fit.rows.sum())
        yield _one(
            fit, Fault("corrupt_rows", names, detail, evidence), more=choices
        )


def _late(
    fit: TorqueFit, joints: Sequence[int], delay: Array, std: Array | None = None
) -> Fault:
    names = fit.log.names(joints)
    size = 1e3 * abs(delay[0])
    known = "" if std is None else f" ± {1e3 * std[0]:.2g}"
    where = f" of {names[0]}" if len(joints) < fit.robot.nv else ""
    way, side = ("lags", "later") if delay[0] > 0 else ("leads", "earlier")
    return Fault(
        "time_delay",
        names,
        f"the torque{where} {way} the motion by {size:.1f}{known} ms, more than a drive and its "
        "filters",
        {"channel": "tau", "delay": float(delay[0])} | _known(std),
        f"reads the torque{where} {size:.1f} ms {side}",
        (Remedy("advance", "tau", tuple(joints), factor=float(delay[0])),),
    )


def _mounting(fit: TorqueFit) -> Iterator[Installation]:
    """The arm under the direction of gravity that suits its torque best, or under none."""
    if not fit.robot.gravity.any():
        return
    detail = (
        "the torque has no gravity: it was taken off, or gravity is balanced; give robot.yaml "
        "gravity: [0, 0, 0], or record the torque of the drives"
    )
    evidence = {"gravity": np.zeros(3)}
    yield _one(fit, Fault("wrong_mounting", fit.log.joints, detail, evidence))
    axes = np.array([x for x in itertools.product((-1, 0, 1), repeat=3) if any(x)])

    # torque is linear in gravity
    size = np.linalg.norm(fit.robot.gravity)
    robots = [fit.robot.with_gravity(size * x) for x in (np.zeros(3), *np.eye(3))]

    def weights(gravity: Array) -> Array:
        unit = gravity / np.linalg.norm(gravity)
        return np.append(1 - unit.sum(), unit)

    gravity = _best(_of_sums(fit, (), robots, weights), axes, 0.5)
    yield _one(fit, _mounted(fit, range(fit.robot.nv), gravity), more=ANY_VALUE)


def _mounted(
    fit: TorqueFit, joints: Sequence[int], gravity: Array, std: Array | None = None
) -> Fault:
    """The fault of an arm under another gravity than its model's, of the same size [m/s²]."""
    given = fit.robot.gravity
    gravity = gravity * (np.linalg.norm(given) / np.linalg.norm(gravity))
    angle = np.degrees(np.arccos(np.clip(gravity @ given / (given @ given), -1, 1)))
    vector = ", ".join(f"{x:.2f}" for x in gravity)
    detail = (
        f"the arm is mounted otherwise than its model says: gravity points along ({vector}) m/s² "
        f"in the base frame, {angle:.0f}° from the given direction; give robot.yaml that gravity"
    )
    evidence = {"gravity": gravity} | _known(std)
    return Fault("wrong_mounting", fit.log.names(joints), detail, evidence)


_OF_VALUES: dict[str, tuple[str, Callable[..., Fault]]] = {
    "wrong_mounting": ("gravity", _mounted),
    "wrong_zero": ("offset", _zero),
    "time_delay": ("delay", _late),
}
"""Faults whose evidence has values that are no choice among few, these, and how they are told."""


def _zeros(fit: TorqueFit, j: int) -> Iterator[Installation]:
    """One joint at another zero position, counting or measuring torque the other way."""
    robots = [fit.robot.with_zero(fit.robot.joints[j], x) for x in CIRCLE]
    grid = np.arange(-np.pi, np.pi, SEARCH.step)
    for channels in ((), ("q", "dq"), ("tau",), ("q", "dq", "tau")):
        signs = [_sign(fit, [j], channels)] * bool(channels)
        unlikeness = _of_sums(fit, signs, robots, circle_weights)
        free = _best(unlikeness, grid[:, None], SEARCH.step)
        right = SEARCH.right * np.round(free / SEARCH.right)
        if np.abs(free) > SEARCH.turn:
            yield _one(fit, *signs, _zero(fit, [j], free), more=ANY_VALUE)
        if right.any():
            yield _one(fit, *signs, _zero(fit, [j], right))
