"""Set-up errors of an arm or its recordings, amended before any other cause is looked for.

`excitant.identify.faults` finds them by a global search with bodies near the given ones. Faults of
the data (signs, order, units, clock) are repaired; mounting and zero positions are changed in the
model, and their angles refined by Gauss–Newton steps on all rows, each joint's own effects free and
the bodies known to ±30 %.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy

from excitant.analysis.candidates import Observed, observed
from excitant.analysis.evidence import Candidate
from excitant.analysis.selection import Rival
from excitant.identify.faults import Fault, faults_of, find_swapped, repair
from excitant.identify.faults.fault import PROVEN, SET_UP
from excitant.identify.faults.set_up import amended, odds_against, support
from excitant.identify.least_squares import autocorrelation_time
from excitant.identify.preprocessing import Segment, away_from_rest
from excitant.identify.prior import link_coordinates, link_weights
from excitant.identify.recording import Recording
from excitant.identify.rows import implausible_size
from excitant.robots.effects import EFFECTS, Effect, Size, standard_effects
from excitant.robots.motion import Array, Motion
from excitant.robots.robot import Robot


@dataclass(frozen=True)
class DataFault(Effect):
    """A fault of the data that was repaired, as a cause of the given model's errors."""

    family = "set-up"
    jointwise = True
    abscissa = "time"
    fault: str = ""
    detail: str = ""

    @property
    def name(self) -> str:  # type: ignore[override]
        """The fault."""
        return self.fault

    def columns(self, robot: Robot, motion: Motion) -> Array:
        """It has none."""
        return np.zeros((len(motion), robot.nv, 0))

    def sentence(
        self, robot: Robot, joints: Sequence[str], sizes: Sequence[Size]
    ) -> str:
        """The fault's own detail."""
        return f"{self.detail[:1].upper()}{self.detail[1:]} (repaired)"


_OFF = 0.3  # relative standard deviation of the given bodies
_FREE = 10.0  # standard deviation [rad or m/s²] of what the data alone tell
_STEPS = 8
_SMALL = 0.1  # of its standard deviation: a step that ends the refinement


@dataclass(frozen=True, eq=False)
class SetUp:
    """An arm as it is set up.

    Attributes:
        given: The robot as given.
        robot: The robot with the mounting and zero positions found.
        std: Standard deviations of what was found: of each joint's zero position, by its name, or
            of gravity along three axes.
        repaired: Faults of the data that are repaired, by recording.
        notes: What was done, a sentence each.
        shown: Faults of the arm, which all recordings share.
    """

    given: Robot
    robot: Robot
    std: dict[str, tuple[float, ...]]
    repaired: dict[str, tuple[Fault, ...]]
    notes: tuple[str, ...] = ()
    shown: tuple[Fault, ...] = ()

    @cached_property
    def rivals(self) -> tuple[Rival, ...]:
        """Other set-ups that would make the same torque; they have no columns."""
        joints = self.robot.joints
        none = np.zeros((0, 0))
        alike = (
            each for fault in self.shown for each in fault.evidence.get("alike", ())
        )
        return tuple(
            Rival(Candidate(_effect_of(fault, at, joints), slice(0, 0), none), 0.0, 1.0)
            for fault, at in alike
        )

    @cached_property
    def effects(self) -> tuple[Effect, ...]:
        """The changes of mounting and zero positions, with values."""
        found: list[Effect] = []
        if (turned := self.robot.gravity - self.given.gravity).any():
            effect = EFFECTS["gravity_direction"](self.robot.joints)
            found.append(effect.with_values(turned))
        known = dict(self.given.zeros)
        for joint, angle in self.robot.zeros:
            if off := angle - known.get(joint, 0.0):
                found.append(EFFECTS["encoder_offset"]((joint,)).with_values([off]))
        return tuple(found)

    @cached_property
    def faults(self) -> tuple[DataFault, ...]:
        """The faults that are repaired, each once, whatever the number of recordings."""
        found = dict[tuple[str, tuple[str, ...]], DataFault]()
        for fault in (fault for faults in self.repaired.values() for fault in faults):
            cause = DataFault(fault.joints, (), fault.fault, fault.detail)
            found.setdefault((fault.fault, fault.joints), cause)
        return tuple(found.values())

    def amends(self, fault: Mapping[str, Any]) -> bool:
        """Whether a fault, under its JSON names, is repaired or in the model."""
        repaired = {f.fault for f in self.repaired.get(str(fault["recording"]), ())}
        changed = self.robot is not self.given
        return fault["fault"] in repaired or (changed and fault["fault"] in SET_UP)

    def without(self, effect: Effect, model: Robot) -> Robot:
        """A model of the arm that has this one thing as given."""
        if effect.family == "static":
            return model.with_gravity(self.given.gravity)
        return model.with_zero(effect.joints[0], -(effect.values or (0.0,))[0])

    def std_of(self, effect: Effect) -> tuple[float, ...]:
        """Standard deviations of the coefficients of one of its effects."""
        return self.std["gravity" if effect.family == "static" else effect.joints[0]]


def set_up(
    robot: Robot, recordings: Sequence[Recording], validate: Sequence[Recording] = ()
) -> tuple[SetUp, list[Recording]]:
    """The set-up that recordings show, not yet refined, and all of them, repaired where need be.

    The arm is set up one way: of the set-ups that single recordings show, that which all of them
    together support most, if those held out do so by themselves.
    """
    everything, swaps = find_swapped(robot, [*recordings, *validate])
    validate = everything[len(recordings) :]
    faults = {
        each: [f for f in faults_of(robot, each) if _amendable(f)]
        for each in everything
    }
    of_data = {
        each: [f for f in found if not f.of_the_arm] for each, found in faults.items()
    }

    def supported(shown: Sequence[Fault], by: Sequence[Recording]) -> float:
        return sum(support(robot, each, shown, of_data[each]) for each in by)

    shown = tuple[Fault, ...]()
    most = odds_against(robot)
    for each in (tuple(_of_the_arm(found)) for found in faults.values()):
        gain = supported(each, everything) if each else 0.0
        if gain > most and (not validate or supported(each, validate) > 0):
            shown = each
            most = gain
    found = list[Recording]()
    repaired = dict[str, tuple[Fault, ...]]()
    notes = list[str]()
    for recording in everything:
        wrong = [f for f in (*of_data[recording], *shown) if f.remedies]
        wrong = [*((swaps[recording.name],) if recording.name in swaps else ()), *wrong]
        better, said = repair(recording, wrong) if wrong else (recording, ())
        found.append(better)
        if wrong:
            repaired[recording.name] = tuple(wrong)
        notes += [f"{recording.name}: {sentence}" for sentence in said]
    return SetUp(robot, amended(robot, shown), {}, repaired, tuple(notes), shown), found


def _effect_of(fault: str, at: tuple[str, ...], joints: tuple[str, ...]) -> Effect:
    """What a fault is called among the causes of a model's errors."""
    if fault == "wrong_mounting":
        return EFFECTS["gravity_direction"](joints)
    return (
        EFFECTS["encoder_offset"](at)
        if fault == "wrong_zero"
        else DataFault(at, (), fault)
    )


def _amendable(fault: Fault) -> bool:
    return fault.fault in SET_UP or (fault.fault in PROVEN and bool(fault.remedies))


def _of_the_arm(faults: Sequence[Fault]) -> Iterator[Fault]:
    return (fault for fault in faults if fault.of_the_arm)


def refined(
    found: SetUp, segments: Sequence[Segment], tau: Array, bodies: Array
) -> SetUp:
    """The set-up with the angles that suit torque tau, (n, nv) [N·m], at the rows of segments best.

    Bodies (nv, 10) are the given ones, consistent.
    """
    size = float(np.linalg.norm(found.given.gravity))
    robot = found.robot
    std = dict[str, tuple[float, ...]]()
    if not found.effects:
        return found
    for _ in range(_STEPS):
        train = observed(robot, segments)
        columns = list[Array]()
        turns = np.zeros((3, 0))
        for effect in found.effects:
            own = train.columns(effect)
            if effect.family == "static":  # of the tangents at gravity of its length
                turns = np.linalg.svd(robot.gravity[None])[2][1:].T
                own = own @ turns
            columns.append(own)
        x, covariance = _step(train, columns, tau, bodies)
        at = 0
        for effect, own in zip(found.effects, columns, strict=True):
            part = slice(at, at + own.shape[2])
            at = part.stop
            block = covariance[part, part]
            if effect.family == "static":
                moved = robot.gravity + turns @ x[part]
                robot = robot.with_gravity(size * moved / np.linalg.norm(moved))
                spread = np.sqrt(np.diag(turns @ block @ turns.T))
                std["gravity"] = tuple(spread.tolist())
            else:
                robot = robot.with_zero(effect.joints[0], float(x[part][0]))
                std[effect.joints[0]] = (float(np.sqrt(block[0, 0])),)
        if (np.abs(x) < _SMALL * np.sqrt(np.diag(covariance))).all():
            break
    return replace(found, robot=robot, std=std)


def _step(
    train: Observed, columns: Sequence[Array], tau: Array, bodies: Array
) -> tuple[Array, Array]:
    """Least-squares change of the angles whose columns are given, and its covariance."""
    robot = train.robot
    usual = [train.columns(effect) for effect in standard_effects(robot.joints)]
    own = np.concatenate(usual, axis=2)
    links = train.links @ link_coordinates(bodies)
    scale = implausible_size(own, tau)
    W = np.concatenate([*columns, links, own * scale], axis=2)
    k = sum(part.shape[2] for part in columns)
    weights = link_weights(robot.nv, _OFF) ** 2
    precision = np.concatenate([np.full(k, _FREE**-2.0), weights, np.ones(len(scale))])
    residual = tau - train.torque()
    counts = away_from_rest(train.segments)
    noise = np.ones(robot.nv)
    x = np.zeros(W.shape[2])
    for _ in range(2):
        left = np.where(counts, residual - W @ x, 0.0)
        sigma = np.sqrt((left**2).sum(axis=0) / np.maximum(counts.sum(axis=0), 1))
        inflation = np.array([autocorrelation_time(column) for column in left.T])
        noise = np.maximum(sigma, 1e-9 * np.abs(tau).max()) * np.sqrt(inflation)
        A = ((W * counts[:, :, None]) / noise[:, None]).reshape(-1, W.shape[2])
        b = (residual * counts / noise).ravel()
        H = A.T @ A + np.diag(precision)
        factor = scipy.linalg.cho_factor(H)
        x = scipy.linalg.cho_solve(factor, A.T @ b)
    return x[:k], scipy.linalg.cho_solve(factor, np.eye(len(H))[:, :k])[:k]
