"""How an arm stands against its model, and how its log relates to it: one search.

An `Installation` is what differs: the direction of gravity, zero positions, frames of the given
inertias, order, signs and coupling of the columns, their units, the clock. The evidence of the
torque for bodies near the nominal ones (`TorqueFit`) judges it, against that of the arm as its
model has it, any one link of which may be another body. The search tries every discrete move that
brings the torque of the nominal bodies nearest, and the best gravity, zero position and clock, each
sought globally. What positions or torque far beyond the limits show needs no odds.

Denavit and Hartenberg's standard convention gives inertia in the distal frame, at the next joint, a
URDF at the link's own joint.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np
import pinocchio as pin
import scipy

from excitant.identify.drive_gains import without_effects
from excitant.identify.faults.fault import (
    ALARM,
    INSTALLATION,
    Fault,
    Log,
    Remedy,
    Rows,
    after_repair,
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
from excitant.robots.motion import Array, Motion
from excitant.robots.regressor import regressor, rigid_body_torque
from excitant.robots.robot import Robot


@dataclass(frozen=True)
class Search:
    """Settings of the search, with which `benchmarks/mistakes.py` moves."""

    fits: float = 0.1
    "Squares per independent row, errors of the model counted: less needs no other installation."
    explained: float = 1.0
    "The same: an installation that leaves less needs no second one."
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
    factors: int = 61
    "Factors of positions beyond limits, 1e-3 to 1, that are compared with degrees."
    directions: int = 200
    "Directions of gravity on the first grid."
    polished: int = 3
    "Newton steps of what is no choice among few: an angle, gravity, a delay."
    turn: float = 0.02
    "Angles of their differences [rad], in which squares are parabolic to 1e-4."
    least_noise: float = 0.01
    "Noise that is assumed then at least, in parts of the torque's rms."
    step: float = np.pi / 18
    "Step of the first grid of zero positions [rad]."
    right: float = np.pi / 2
    "Zero positions are multiples of it [rad], unless another is better beyond chance."
    far: float = 10.0
    "Torque in its limit that no drive makes, whatever the limit means."
    least_scale: float = 3.0
    "Factor of a torque that bodies off by `BODY_STD` do not make (3.7 std of its logarithm)."
    clear_scale: float = 0.5
    "Relative std of a joint's factor below which it is one."
    named_scale: float = 0.3
    "Logarithm within which a unit is named: one std of bodies near the nominal ones."
    clock: float = 0.1
    "Least relative error of a clock that the torque alone can show."
    parts: int = 3
    "Parts of a log, none of which may speak against an installation."
    latest: float = 0.5
    "Delay of the torque that is looked for at most [s]."


SEARCH = Search()
_ANGLES = np.linspace(0, 2 * np.pi, 5, endpoint=False)
"""Zero offsets [rad] that determine a trigonometric polynomial of degree 2."""
_RATES = np.geomspace(1e-3, 1e3, 49)
"""Factors of the time that are tried first."""


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
                robot = robot.with_zero(fault.joints[0], fault.evidence["offset"])
            elif fault.fault == "wrong_frame":
                robot = robot.with_parameters(in_joint_frames(robot))
        return robot

    def fit(self, case: TorqueFit) -> TorqueFit:
        """The fit of a log's torque in this installation."""
        if not self.faults:
            return case
        unscaled = {
            case.log.joints.index(joint)
            for fault in self.faults
            if fault.fault == "wrong_unit" and not fault.remedies
            for joint in fault.joints
        }
        data = case.data.remedied(self.remedies)
        robot = self.robot(case.robot)
        joints = frozenset(unscaled) | case.unscaled
        return TorqueFit(robot, case.log, data, case.joints, joints)

    def order(self, nv: int) -> Rows:
        """Of each joint's torque the column of the log, shape (nv,)."""
        order: Rows = np.arange(nv)
        for remedy in self.remedies:
            if (remedy.action, remedy.channel) == ("order", "tau"):
                order = order[[*remedy.joints]]
        return order

    def joined(self, other: Installation) -> Installation:
        """It and another that was found in it."""
        return Installation(self.faults + other.faults, self.price + other.price)


class _Judged(NamedTuple):
    """An installation with twice the log odds for it, and the squares that it leaves."""

    installation: Installation
    odds: float
    squares: float

    @property
    def rank(self) -> tuple[int, int]:
        """Sort key of those that look the same: fewest faults, order, signs, mounting, offsets."""
        faults = self.installation.faults
        odd = not _is_right(faults[-1].evidence.get("offset", 0.0))
        kinds = ("wrong_order", "wrong_sign", "wrong_mounting")
        first = faults[0].fault
        place = kinds.index(first) if first in kinds else len(kinds)
        return len(faults), place + odd


def _is_right(angle: float) -> bool:
    turns = angle / SEARCH.right
    return bool(abs(turns - round(turns)) < 1e-9)  # rounding


def odds_against(robot: Robot) -> float:
    """Twice the log odds against any one other installation of an arm before data are seen."""
    return 2 * float(np.log(SEARCH.choices * robot.nv / SEARCH.rare))


def installation_faults(case: TorqueFit) -> list[Fault]:
    """The faults of unit, installation and clock that the torque shows."""
    if faults := [*_torque_beyond_limits(case)]:
        return faults
    best = Installation()
    for _ in range(case.robot.nv):
        tried = [best.joined(move) for move in _moves(best.fit(case))]
        _, ranked = _judge(case, tried)
        nearest = [j.installation for j in ranked[: SEARCH.tried] if j.odds > 0]
        likely = [each for each in nearest if _gain(case, each, best) > -np.inf]
        if not likely:
            break
        before, ranked = _judge(case, likely)
        best, squares = _simplest(ranked, before, case)
        if squares < SEARCH.explained * float(case.rows.sum()):
            break
    if best.faults and _throughout(case, best):
        return [*_polished(case, best).faults]
    return [*positions_beyond_limits(case)]


def _polished(case: TorqueFit, installation: Installation) -> Installation:
    """It with the angles, gravity and delays that leave the fewest squares, each with its std.

    Bodies are near the nominal ones, noise is what no bodies explain. Zero positions that are right
    angles, which no other was better than beyond chance, stay such.
    """
    faults = installation.faults
    sizes = [_freedom(fault) for fault in faults]
    if not sum(sizes):
        return installation
    parts = np.split(np.arange(sum(sizes)), np.cumsum(sizes)[:-1])
    steps = np.full(sum(sizes), SEARCH.turn)
    for fault, part in zip(faults, parts, strict=True):
        if fault.fault == "time_delay":
            steps[part] = 1 / case.data.rate
    start = installation.fit(case)
    noise = np.clip(start.power / start.size, SEARCH.least_noise**2, MODEL_ERROR**2)
    weight = (start.rows / (noise * start.size * len(start.tau)))[start.joints]

    def moved(x: Array) -> Installation:
        pairs = zip(faults, parts, strict=True)
        return replace(
            installation,
            faults=tuple(_moved(case, fault, x[part]) for fault, part in pairs),
        )

    def squares(x: Array) -> float:
        return float(moved(x).fit(case).family(weight)(np.ones(1)))

    x = np.zeros(len(steps))
    least = squares(x)
    for _ in range(SEARCH.polished):
        slope, curvature = _derivatives(squares, x, steps, least)
        if np.linalg.eigvalsh(curvature).min() <= 0:
            return installation
        change = np.linalg.solve(curvature, slope)
        left = squares(x - steps * change)
        if left >= least:
            break
        x = x - steps * change
        least = left
    dispersion = max(1.0, least / float(start.rows.sum()))
    inverse = np.linalg.inv(curvature) * np.outer(steps, steps)
    covariance = np.asarray(2 * dispersion * inverse, float)
    for fault, part in zip(faults, parts, strict=True):
        if fault.fault == "wrong_zero" and _is_right(fault.evidence["offset"]):
            x[part] = 0.0
    pairs = zip(faults, parts, strict=True)
    known = [
        _moved(case, fault, x[part], covariance[np.ix_(part, part)])
        for fault, part in pairs
    ]
    return replace(installation, faults=tuple(known))


def _derivatives(
    f: Callable[[Array], float], x: Array, steps: Array, value: float
) -> tuple[Array, Array]:
    """Slope (k,) and curvature (k, k) of a function per step, by differences around its value."""
    moves = np.diag(steps)
    ahead = np.array([f(x + move) for move in moves])
    behind = np.array([f(x - move) for move in moves])
    curvature = np.diag(ahead + behind - 2 * value)
    for i, k in itertools.combinations(range(len(steps)), 2):
        both = f(x + moves[i] + moves[k])
        curvature[i, k] = curvature[k, i] = both - ahead[i] - ahead[k] + value
    return (ahead - behind) / 2, curvature


def _freedom(fault: Fault) -> int:
    """Number of values of a fault that are no choice among few: none has no direction."""
    if fault.fault == "wrong_mounting":
        return 2 * bool(np.any(fault.evidence["gravity"]))
    return int(fault.fault in ("wrong_zero", "time_delay"))


def _moved(
    case: TorqueFit, fault: Fault, x: Array, covariance: Array | None = None
) -> Fault:
    """A fault whose offset [rad], delay [s] or gravity, turned about two axes [rad], changes by x.

    With the covariance of x where that is known.
    """
    if not len(x):
        return fault
    evidence = fault.evidence
    if fault.fault == "wrong_mounting":
        gravity = evidence["gravity"]
        size = np.linalg.norm(gravity)
        turns = size * np.linalg.svd(gravity[None])[2][1:].T
        turned = gravity + turns @ x
        old = _mounted(case, gravity)
        new = _mounted(case, turned * size / np.linalg.norm(turned))
        if covariance is not None:
            covariance = turns @ covariance @ turns.T
    else:
        at = [case.log.joints.index(joint) for joint in fault.joints]
        name, told = (
            ("offset", partial(_zero, case.log, at[0]))
            if fault.fault == "wrong_zero"
            else ("delay", partial(_late, case.log, at))
        )
        std = None if covariance is None else float(np.sqrt(covariance[0, 0]))
        old = told(evidence[name], evidence.get("std"))
        new = told(evidence[name] + float(x[0]), std)
    detail = new.detail + fault.detail.removeprefix(old.detail)
    evidence = {**evidence, **new.evidence}
    if covariance is not None:
        stds = np.sqrt(np.diag(covariance)).tolist()
        evidence["std"] = stds if len(stds) > 1 else stds[0]
    return replace(new, detail=detail, evidence=evidence)


def _throughout(case: TorqueFit, installation: Installation) -> bool:
    """Whether no part of a log speaks against it, as those do that lack the push of a hand."""
    dead = {*case.log.joints} - {case.log.joints[j] for j in case.joints}
    for rows in np.array_split(np.arange(len(case.log)), SEARCH.parts):
        log = case.log.take(rows)
        data = smooth(log)
        part = data and torque_fit(case.robot, log, data, dead)
        if part:
            before, [judged] = _judge(part, [installation])
            allowed = before + SEARCH.fits * float(part.rows.sum())
            if judged.squares > allowed:
                return False
    return True


def _gain(case: TorqueFit, one: Installation, other: Installation) -> float:
    """Twice the log odds for an installation that is likelier than another; else −∞.

    It also leaves half the squares of the other, or fits.
    """
    before, judged = _judge(case, [one, other] if other.faults else [one])
    of = {each.installation: each for each in judged}
    theirs = of.get(other, _Judged(other, 0.0, before))
    mine = of[one]
    fits = SEARCH.fits * float(case.rows.sum())
    allowed = max(SEARCH.halved * theirs.squares, fits)
    likelier = mine.odds > theirs.odds and mine.squares <= allowed
    return mine.odds if likelier else -np.inf


def _judge(
    case: TorqueFit, installations: Sequence[Installation]
) -> tuple[float, list[_Judged]]:
    """Installations by their odds, and the squares that the log as it stands leaves."""
    nv = case.robot.nv
    fits = [installation.fit(case) for installation in installations]
    orders = [installation.order(nv) for installation in installations]
    before, evidence = _evidence(case, fits, orders)
    judged = [
        _Judged(installation, gain - installation.price, squares)
        for installation, (gain, squares) in zip(
            installations, evidence, strict=True
        )
    ]
    return before, sorted(judged, key=lambda each: -each.odds)


def _evidence(
    case: TorqueFit, fits: Sequence[TorqueFit], orders: Sequence[Rows]
) -> tuple[float, list[tuple[float, float]]]:
    """Squares that a log as it stands leaves; of other fits twice the log evidence, and squares.

    As it stands any one of the links may be another body: that needs no other installation. Errors
    of the model count as noise. Joint j of a fit has the torque recorded as ``order[j]``.
    """
    nv = case.robot.nv
    noise = case.power
    for fit, order in zip(fits, orders, strict=True):
        noise = np.minimum(noise, fit.power[np.argsort(order)])
    as_it_stands = [case.surprise(noise, case.rows, link) for link in range(nv)]
    before = min(surprise for _, surprise in as_it_stands)
    most = min(squares for squares, _ in as_it_stands)
    rows = float(case.rows.sum())
    evidence = []
    for fit, order in zip(fits, orders, strict=True):
        squares, surprise = fit.surprise(noise[order], case.rows[order], nv - 1)
        evidence.append(((before - surprise) / max(1.0, squares / rows), squares))
    return most, evidence


def _simplest(
    likely: Sequence[_Judged], before: float, case: TorqueFit
) -> tuple[Installation, float]:
    """The simplest of those that look the same, which names the others, and how well it fits."""
    same = [each for each in likely if each.odds >= likely[0].odds - SEARCH.alike]
    least = min(each.squares for each in same) / SEARCH.halved
    allowed = max(least, SEARCH.fits * float(case.rows.sum()))
    same = [each for each in same if each.squares <= allowed]
    best, *others = sorted(same, key=lambda each: each.rank)
    *faults, last = best.installation.faults
    detail = (
        f"{last.detail}; so read, the torque is that of bodies near the given ones (sum of squares "
        f"{before:.3g} → {best.squares:.3g} in {case.rows.sum():.0f} independent rows)"
    )
    told = [_names(best.installation)]
    words = list[str]()
    alike = list[tuple[str, tuple[str, ...]]]()
    for other in others:
        names = _names(other.installation)
        if names not in told:
            told.append(names)
            alike += names
            details = (fault.detail for fault in other.installation.faults)
            words.append(" and ".join(details))
    if alike:
        detail += f"; the torque would be the same if {' or if '.join(words)}"
    evidence = {**last.evidence, "gain": best.odds, "alike": alike}
    stated = replace(last, detail=detail, evidence=evidence)
    return replace(best.installation, faults=(*faults, stated)), best.squares


def _names(installation: Installation) -> list[tuple[str, tuple[str, ...]]]:
    return [(fault.fault, fault.joints) for fault in installation.faults]


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
    if case is None:
        return 0.0
    return _gain(case, Installation(tuple(faults)), Installation())


def swapped(robot: Robot, recordings: Sequence[Recording]) -> list[tuple[int, int]]:
    """Pairs of recordings, of as many rows each, of which each has the torque of the other.

    As an installation, that has to be likelier than all that the model may lack, all pairs counted.
    """
    if not is_described(robot):
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
    """Twice the log evidence ratio of a log with another's torque; −∞ where that is not likely."""
    moved = smooth(replace(log, tau=other.tau))
    if data is None or moved is None:
        return -np.inf
    if _unlikeness(robot, moved) - _unlikeness(robot, data) > np.log(SEARCH.halved):
        return -np.inf
    case = torque_fit(robot, log, data, set())
    if case is None:
        return -np.inf
    exchanged = replace(case, data=moved)
    _, [(gain, _)] = _evidence(case, [exchanged], [np.arange(robot.nv)])
    return gain


def _moves(fit: TorqueFit) -> Iterator[Installation]:
    """Installations next to the one of a fit, each the likeliest of its kind."""
    if next(positions_beyond_limits(fit), None):
        # a gear ratio may look like degrees, but suits the torque at another factor
        for installation in _in_degrees(fit):
            if _is_best_factor(fit, installation.remedies[0]):
                yield installation
        for installation in _nearest(fit, [*_orders(fit)]):
            if not next(positions_beyond_limits(installation.fit(fit)), None):
                yield installation
        return
    rows = np.maximum(fit.rows, 1.0)
    squares, _ = fit.surprise(0 * fit.power, rows, fit.robot.nv - 1)
    if squares < SEARCH.fits * float(rows.sum()):
        return
    yield from _in_degrees(fit)
    yield from _clock(fit)
    yield from _delays(fit)
    signs = [*_signs(fit)]
    if not is_described(fit.robot):
        yield from signs
        return
    yield from _nearest(fit, [*signs, *_orders(fit), *_couplings(fit)])
    if squares > SEARCH.explained * float(rows.sum()):
        yield from _nearest(fit, [*_two_zeros(fit)])
    yield from _frames(fit)
    yield from _scales(fit)
    yield from _mounting(fit)
    for j in fit.joints:
        if fit.robot.revolute[j]:
            yield from _zeros(fit, j)


def _one(fit: TorqueFit, *faults: Fault, more: float = 0.0) -> Installation:
    """An installation by its faults, and twice the log of further choices that it had."""
    return Installation(faults, len(faults) * odds_against(fit.robot) + more)


def _unlikeness(robot: Robot, data: Smooth) -> float:
    """Mean log of the share of each torque that the nominal bodies and own effects leave.

    The bodies' torque counts up to a factor of each joint.
    """
    return float(_misfits(rigid_body_torque(robot, data.motion), data).mean())


def _misfits(model: Array, data: Smooth) -> Array:
    """The same of each joint for a torque of the bodies, shape (N, nv); (nv,)."""
    F = data.effects
    squares = []
    for j in range(model.shape[1]):
        wanted, measured = without_effects(F[:, j], model[:, j], data.tau[:, j])
        along = max(float(wanted @ measured), 0.0)
        factor = along / max(float(wanted @ wanted), 1e-300)
        squares.append(float(((measured - factor * wanted) ** 2).sum()))
    whole = np.maximum((data.tau**2).sum(axis=0), 1e-300)
    return np.asarray(np.log(np.maximum(squares / whole, MODEL_ERROR**2)), float)


def _nearest(
    fit: TorqueFit, tried: Sequence[Installation]
) -> Iterator[Installation]:
    """The few of many that suit the nominal bodies best, and better than as it stands."""
    unlikeness = [
        _unlikeness(each.robot(fit.robot), fit.data.remedied(each.remedies))
        for each in tried
    ]
    as_it_stands = _unlikeness(fit.robot, fit.data)
    for k in np.argsort(unlikeness, kind="stable")[: SEARCH.tried]:
        if unlikeness[k] < as_it_stands:
            yield tried[int(k)]


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
            yield _one(
                fit,
                Fault(
                    "wrong_order",
                    log.names(wrong),
                    f"{what} are in another order: {words}",
                    {"order": names, "channels": channels},
                    f"puts the {what} of {len(wrong)} joints in the order of the robot",
                    tuple(Remedy("order", channel, order) for channel in channels),
                ),
            )


def _signs(fit: TorqueFit) -> Iterator[Installation]:
    """Each joint that counts or measures torque the other way."""
    for j in fit.joints:
        moves = fit.log.moving[:, j].any()
        for channels in (("q", "dq"), ("tau",), ("q", "dq", "tau")):
            if moves or "q" not in channels:
                yield _one(fit, _sign(fit.log, j, channels))


def _sign(log: Log, j: int, channels: Sequence[str]) -> Fault:
    what = " and ".join(name for name in channels if name != "dq")
    joint = log.joints[j]
    return Fault(
        "wrong_sign",
        (joint,),
        f"{what} of {joint} count{'s' * (' and ' not in what)} the other way than the robot's",
        {"channel": what},
        f"negates {what}{' (and dq)' * ('dq' in channels)} of {joint}",
        tuple(Remedy("scale", name, (j,), factor=-1.0) for name in channels),
    )


def _couplings(fit: TorqueFit) -> Iterator[Installation]:
    """Neighbours of which one's position is logged with that of the other added or taken off.

    θ = L q has the power of τ_θᵀ θ̇ = τᵀ q̇, so that τ = Lᵀ τ_θ, where torque is of the same axes.
    """
    log = fit.log
    n = fit.robot.nv
    neighbours = [(j, j + 1) for j in range(n - 1)]
    for j, k in [*neighbours, *(pair[::-1] for pair in neighbours)]:
        if fit.robot.revolute[j] != fit.robot.revolute[k]:
            continue
        for sign, with_torque in itertools.product((1.0, -1.0), (True, False)):
            joint, other = log.names((j, k))
            how = "added" if sign > 0 else "taken off"
            remedies = [
                Remedy("add", name, (j, k), factor=-sign) for name in ("q", "dq")
            ]
            if with_torque:
                remedies.append(Remedy("add", "tau", (k, j), factor=sign))
            and_torque = ", and torque is that of these axes" * with_torque
            yield _one(
                fit,
                Fault(
                    "coupled_axes",
                    (joint, other),
                    f"q of {joint} is logged with that of {other} {how}{and_torque}",
                    {"channel": "q", "factor": sign, "torque": with_torque},
                    f"{'takes' if sign > 0 else 'adds'} q of {other} "
                    f"{'off' if sign > 0 else 'to'} that of {joint}",
                    tuple(remedies),
                ),
            )


def _two_zeros(fit: TorqueFit) -> Iterator[Installation]:
    """Zero positions of two joints that are off by right angles."""
    turning = [j for j in range(fit.robot.nv) if fit.robot.revolute[j]]
    right = (SEARCH.right, -SEARCH.right, 2 * SEARCH.right)
    for pair in itertools.combinations(turning, 2):
        for angles in itertools.product(right, right):
            places = zip(pair, angles, strict=True)
            yield _one(fit, *(_zero(fit.log, j, angle) for j, angle in places))


def _zero(log: Log, j: int, offset: float, std: float | None = None) -> Fault:
    joint = log.joints[j]
    side = "+" if offset > 0 else "−"
    known = f" ± {np.degrees(std):.2g}" if std else ""
    angle = f"{side} {abs(np.degrees(offset)):.3g}{known}°"
    detail = f"the zero position of {joint} is off: its true angle is the reading {angle}"
    done = f"adds {np.degrees(offset):.4g}° to q of {joint}"
    remedy = Remedy("offset", "q", (j,), factor=offset)
    return Fault(
        "wrong_zero", (joint,), detail, {"offset": offset}, done, (remedy,)
    )


def _in_degrees(fit: TorqueFit) -> Iterator[Installation]:
    """Positions in degrees, of all joints that turn or of those beyond a turn."""
    log = fit.log
    largest = np.abs(fit.data.motion.q).max(axis=0)
    turning = np.asarray(fit.robot.revolute)
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
                {"channel": "q", "largest": largest},
                "multiplies q and dq, which agrees with it, by π/180",
                tuple(remedies),
            ),
        )


def _is_best_factor(fit: TorqueFit, remedy: Remedy) -> bool:
    """Whether no other factor of these positions suits the nominal bodies better."""

    def unlikeness(factor: float) -> float:
        data = fit.data.remedied([replace(remedy, factor=factor)])
        return _unlikeness(fit.robot, data)

    least = min(map(unlikeness, np.geomspace(1e-3, 1.0, SEARCH.factors)))
    # of a logarithm: a twentieth of an error
    return unlikeness(remedy.factor) < least + 0.1


def beyond_limits(robot: Robot, q: Array) -> tuple[Rows, Array]:
    """Joints whose positions (n, nv) leave their limits by a turn, or their range, and by how much.

    The latter in these, shape (nv,).
    """
    low, high = robot.limits.position.T
    margin = np.where(robot.revolute, 2 * np.pi, high - low)
    reach = np.maximum(q.max(axis=0) - high, low - q.min(axis=0)) / margin
    return np.flatnonzero(reach > 1), reach


def positions_beyond_limits(fit: TorqueFit) -> Iterator[Fault]:
    """Positions that leave the joints' limits by more than a turn, or by their whole range."""
    robot = fit.robot
    joints = fit.log.joints
    q = fit.data.motion.q
    beyond, reach = beyond_limits(robot, q)
    if not len(beyond):
        return
    low, high = robot.limits.position.T
    names = fit.log.names(beyond)
    worst = int(beyond[np.argmax(reach[beyond])])
    largest = float(np.abs(q[:, worst]).max())
    detail = (
        f"q of {', '.join(names)} leaves the joints' limits by more than "
        f"{'a turn' if robot.revolute[worst] else 'their range'}: {joints[worst]} reaches "
        f"{largest:.4g}, its limits are {low[worst]:.4g} and {high[worst]:.4g}: motor positions, "
        "counts or another unit"
    )
    yield Fault("wrong_unit", names, detail, {"channel": "q", "largest": largest})


def _torque_beyond_limits(case: TorqueFit) -> Iterator[Fault]:
    """Torques far beyond what drives can do, in the unit that brings them nearest."""
    log = case.log
    limit = case.robot.limits.torque[case.joints]
    peak = np.abs(log.tau[:, case.joints]).max(axis=0)
    limited = np.isfinite(limit)
    if log.unit != "N·m" or not limited.any():
        return
    typical = float(np.median((peak / limit)[limited]))
    if typical <= SEARCH.far:
        return
    # after the repair torques stay below three times what they should be
    powers = {1e2: "N·cm", 1e3: "N·mm", 1e6: "µN·m"}
    factor = next(
        (f for f in powers if typical / f < SEARCH.least_scale), max(powers)
    )
    detail = (
        f"tau is {typical:.3g} times the torque limit (median over joints), as in "
        f"{powers[factor]}"
    )
    remedy = Remedy("scale", "tau", tuple(range(log.nv)), factor=1 / factor)
    evidence = {"channel": "tau", "factor": typical}
    done = f"divides tau by {factor:g}"
    yield Fault("wrong_unit", log.joints, detail, evidence, done, (remedy,))


def _scales(fit: TorqueFit) -> Iterator[Installation]:
    """Readings that are the torque of bodies near the nominal ones by a factor of each joint."""
    if fit.log.unit != "N·m" or fit.unscaled:
        return
    gains, std = fit.gains
    far = np.abs(np.log(gains)) > np.log(SEARCH.least_scale)
    clear = std < SEARCH.clear_scale
    some = np.flatnonzero(far & clear)
    if not len(some):
        return
    joints = np.array(fit.joints)
    names = fit.log.names(joints[some])
    # joints whose torque tells no factor have one as well
    unscaled = fit.log.names(joints[far | ~clear])
    gains = gains[some]
    typical = float(np.exp(np.log(gains).mean()))
    apart = np.abs(np.log(gains / typical)) / std[some]
    what = "not the torque of bodies near the given ones, but that by a factor of each joint"
    factors = len(some)
    like = ", ".join(f"{n} {g:.3g}" for n, g in zip(names, gains, strict=True))
    if (apart < 3.0).all():  # standard deviations
        factors = 1
        what = f"{typical:.3g} times the torque of bodies near the given ones"
        like = ", ".join(
            f"{1 / size:.3g} in {unit}"
            for unit, size in sizes_of("tau").items()
            if abs(np.log(typical * size)) < SEARCH.named_scale
        )
    detail = (
        f"tau of {', '.join(names)} is {what}{f' ({like})' if like else ''}: another unit, "
        "currents or per cent, or inertias of the model in another unit"
    )
    evidence = {"channel": "tau", "factor": gains}
    fault = Fault("wrong_unit", unscaled, detail, evidence)
    yield _one(fit, fault, more=2 * factors * float(np.log(SEARCH.scales)))


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
    moved = []
    for place, phi in zip(places, robot.phi.reshape(robot.nv, 10), strict=True):
        body = pin.Inertia.FromDynamicParameters(phi)
        moved.append(place.act(body).toDynamicParameters())
    return np.concatenate(moved)


def _weight(fit: TorqueFit) -> Array:
    """Weights of the joints' squares where only errors of the model count as noise."""
    return fit.weight(0 * fit.power, fit.rows)


def _clock(fit: TorqueFit) -> Iterator[Installation]:
    """The factor of the time that suits the torque best: what motion adds goes with its square."""
    if clock_confirmed(fit.log):
        return
    motion = fit.data.motion
    still = np.zeros_like(motion.q)
    at_rest = regressor(fit.robot, replace(motion, dq=still, ddq=still))
    parts = at_rest, regressor(fit.robot, motion) - at_rest
    left = fit.mixed(parts).family(_weight(fit))

    def squares(logarithm: Array) -> Array:
        factor = np.exp(2 * logarithm)
        return left(np.stack([np.ones_like(factor), factor], axis=-1))

    factor = float(np.exp(_least(squares, np.log(_RATES))))
    if abs(factor - 1) < SEARCH.clock:
        return
    close = [rate for rate in RATES if abs(factor / rate - 1) < SEARCH.clock / 2]
    # an odd factor may stand for anything that the model lacks
    odd = 0.0 if close else 2 * float(np.log(SEARCH.scales))
    exact = close[0] if close else factor
    log = fit.log
    detail = (
        f"the time runs {factor:.3g} times too {'slow' if factor > 1 else 'fast'} for the torque: "
        f"the median step is {log.step:.4g} s, {log.step / exact:.4g} s would fit"
    )
    yield _one(fit, slow_clock(log.joints, exact, detail), more=odd)


def _delays(fit: TorqueFit) -> Iterator[Installation]:
    """Torque of all joints, or of that it suits best, later or earlier than drives and filters are.

    Sought at nominal bodies, refined with bodies near them.
    """
    robot = fit.robot
    data = fit.data
    model = rigid_body_torque(robot, data.motion)
    step = 1 / data.rate
    rows = int(min(SEARCH.latest, fit.log.duration / 10) * data.rate)
    lags = step * np.arange(-rows, rows + 1)
    every = tuple(range(robot.nv))

    def advanced(joints: tuple[int, ...], delay: float) -> Smooth:
        return data.remedied([Remedy("advance", "tau", joints, factor=delay)])

    misfits = np.array(
        [_misfits(model, advanced(every, lag)) for lag in lags.tolist()]
    )
    fall = misfits[rows] - misfits.min(axis=0)
    latest = max(fit.joints, key=lambda j: fall[j])
    for joints in dict.fromkeys((every, (latest,))):
        near = float(lags[np.argmin(misfits[:, joints].mean(axis=1))])
        if abs(near) <= LONGEST_DELAY - step:
            continue
        choices = 2 * float(np.log(len(lags)))
        late = _polished(fit, _one(fit, _late(fit.log, joints, near), more=choices))
        evidence = late.faults[0].evidence
        std = float(evidence.get("std", np.inf))
        if abs(evidence["delay"]) > LONGEST_DELAY + 2 * std:
            yield late


def _late(
    log: Log, joints: Sequence[int], delay: float, std: float | None = None
) -> Fault:
    names = log.names(joints)
    known = f" ± {1e3 * std:.2g}" if std else ""
    where = f" of {names[0]}" if len(joints) < log.nv else ""
    size = 1e3 * abs(delay)
    way, side = ("lags", "later") if delay > 0 else ("leads", "earlier")
    return Fault(
        "time_delay",
        names,
        f"the torque{where} {way} the motion by {size:.1f}{known} ms, more than a drive and its "
        "filters",
        {"channel": "tau", "delay": delay},
        f"reads the torque{where} {size:.1f} ms {side}",
        (Remedy("advance", "tau", tuple(joints), factor=delay),),
    )


def _mounting(fit: TorqueFit) -> Iterator[Installation]:
    """The arm under the direction of gravity that suits its torque best, or under none."""
    robot = fit.robot
    motion = fit.data.motion
    size = float(np.linalg.norm(robot.gravity))
    if size == 0:
        return
    still = np.zeros_like(motion.q)
    rest = replace(motion, dq=still, ddq=still)
    pulls = [(robot.with_gravity(axis), rest) for axis in np.eye(3)]
    parts = [(robot.with_gravity(np.zeros(3)), motion), *pulls]
    left = fit.mixed([regressor(*part) for part in parts]).family(_weight(fit))

    def scaled(x: Array) -> Array:
        return np.asarray(
            size * x / np.linalg.norm(x, axis=-1, keepdims=True), float
        )

    def squares(gravity: Array) -> Array:
        return left(np.insert(gravity, 0, 1.0, axis=-1))

    def refined(start: Array) -> Array:
        step = 1e-6  # of the differences that give slopes

        def objective(x: Array) -> tuple[float, Array]:
            values = squares(scaled(x + step * np.eye(4, 3, -1)))
            return float(values[0]), (values[1:] - values[0]) / step

        end = scipy.optimize.minimize(objective, start / size, jac=True, tol=0.01)
        return scaled(end.x)

    tried = scaled(np.vstack([robot.gravity, _sphere(SEARCH.directions)]))
    blocks = np.array_split(tried, 10)  # all at once need too much memory
    of_tried = np.concatenate([squares(block) for block in blocks])
    if float(squares(np.zeros(3))) < of_tried.min():
        detail = (
            "the torque has no gravity: it was taken off, or gravity is balanced; give robot.yaml "
            "gravity: [0, 0, 0], or record the torque of the drives"
        )
        evidence = {"gravity": np.zeros(3), "angle": 0.0}
        yield _one(fit, Fault("wrong_mounting", fit.log.joints, detail, evidence))
        return
    starts = tried[np.argsort(of_tried, kind="stable")[:3]]
    gravity = min(map(refined, starts), key=lambda end: float(squares(end)))
    yield _one(fit, _mounted(fit, gravity))


def _mounted(fit: TorqueFit, gravity: Array) -> Fault:
    """The fault of an arm under another gravity than its model's [m/s²]."""
    given = fit.robot.gravity
    cosine = gravity @ given / np.linalg.norm(gravity) / np.linalg.norm(given)
    angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    vector = ", ".join(f"{x:.2f}" for x in gravity)
    detail = (
        f"the arm is mounted otherwise than its model says: gravity points along ({vector}) m/s² "
        f"in the base frame, {angle:.0f}° from the given direction; give robot.yaml that gravity"
    )
    evidence = {"gravity": gravity, "angle": float(angle)}
    return Fault("wrong_mounting", fit.log.joints, detail, evidence)


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

    def faults(self, log: Log, j: int) -> Iterator[Fault]:
        """The same as faults of the installation."""
        channels = ("q", "dq") * (self.sign < 0) + ("tau",) * self.flipped
        if channels:
            yield _sign(log, j, channels)
        if self.offset:
            yield _zero(log, j, self.offset)


def _zeros(fit: TorqueFit, j: int) -> Iterator[Installation]:
    """One joint at another zero position, counting or measuring torque the other way.

    The simplest, and that which measures torque as it is recorded; none where that is as it stands.
    """
    motion = fit.data.motion
    axis = np.eye(fit.robot.nv)[j]
    zeros = list[_Zero]()
    for sign in (1.0, -1.0):
        way = 1 + (sign - 1) * axis
        q, dq, ddq = (x * way for x in (motion.q, motion.dq, motion.ddq))
        moved = [Motion(motion.t, q + angle * axis, dq, ddq) for angle in _ANGLES]
        parts = [regressor(fit.robot, each) for each in moved]
        left = fit.mixed(parts).family(_weight(fit))
        for flipped in (None, fit.joints.index(j)):
            squares = partial(_at_zero, left, flipped)
            free = _least(squares, np.arange(-np.pi, np.pi, SEARCH.step))
            right = SEARCH.right * round(free / SEARCH.right)
            offsets = np.array([0.0, right, free])
            zeros += [
                _Zero(float(left), flipped is not None, sign, float(offset))
                for left, offset in zip(squares(offsets), offsets, strict=True)
            ]
    zeros.sort(key=lambda zero: zero.signs)
    as_recorded = [zero for zero in zeros if not zero.flipped]
    simplest = [_simplest_zero(fit, some) for some in (zeros, as_recorded)]
    for zero in {z[1:]: z for z in simplest}.values():
        if faults := [*zero.faults(fit.log, j)]:
            yield _one(fit, *faults)


def _at_zero(
    left: Callable[..., Array], flipped: int | None, offsets: Array
) -> Array:
    """Squares of a family of `_ANGLES` at zero offsets of a joint."""
    x = np.subtract.outer(offsets, _ANGLES)
    return left((1 + 2 * np.cos(x) + 2 * np.cos(2 * x)) / 5, flipped)


def _least(squares: Callable[[Array], Array], grid: Array) -> float:
    """Where squares are least, on ever finer grids around the best place of the one before."""
    for _ in range(3):
        near = grid[int(np.argmin(squares(grid)))]
        step = grid[1] - grid[0]
        grid = near + step * np.linspace(-1, 1, 21)
    return float(near)


def _simplest_zero(fit: TorqueFit, zeros: Sequence[_Zero]) -> _Zero:
    """The first of zero positions than which none leaves fewer squares beyond chance.

    Other angles come before other signs, and a multiple of 90° before any other angle.
    """
    least = min(zero.squares for zero in zeros)
    dispersion = max(1.0, least / float(fit.rows.sum()))
    chance = float(scipy.special.chdtri(1, ALARM)) * dispersion
    return next(zero for zero in zeros if zero.squares < least + chance)
