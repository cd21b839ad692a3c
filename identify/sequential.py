"""Identification link by link (Khosla 1987, section 4): parameters from the last joint inward.

Row τ_i contains no parameter of links before i (Property 4), so the row of the last joint alone
identifies the last link, the row before it the link before, with the outer one known, and so on.
Recordings in which one joint or a few move are enough for what they show; what they do not show
stays at the given robot, and the motion that would show it is named.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
import numpy.typing as npt

from excitant.exceptions import RankDeficient
from excitant.identify.accuracy import series
from excitant.identify.cascade import Cascade, beginning, further, led_combinations
from excitant.identify.drive_gains import current_gains
from excitant.identify.estimate import Estimate, identify_robot, judged
from excitant.identify.least_squares import LeastSquares
from excitant.identify.physical import fit_physical
from excitant.identify.preprocessing import Mask, dry_joints, moving, stilled
from excitant.identify.prior import base_prior, prior_parameters
from excitant.identify.recording import Recording
from excitant.identify.regression import regression_of
from excitant.identify.rows import Data, FitRows, split
from excitant.robots.base_parameters import BaseParameters, base_parameters, expression, last_rows
from excitant.robots.effects import Effect, standard_effects
from excitant.robots.motion import Array, Motion
from excitant.robots.robot import Robot
from excitant.robots.torque import observation_columns

_NEGLIGIBLE = 0.05  # standard deviations of a combination: terms that matter less are not written
_SOMETIMES = 0.1  # of the time that a joint moves: what happens more rarely is not mentioned
_STATES = 40  # at which a motion is tried, beyond the parameters sought
_VISIBLE = 1e-6  # of the largest singular value
_PAIRS = 10  # joints up to which pairs of them are tried
_POSE = 0.1  # rad or m: positions that differ less are one pose


@dataclass(frozen=True, eq=False)
class LinkRows:
    """Rows of all recordings, and which of them count.

    Attributes:
        fit: Columns and torque; joints that stay still in a segment are held exactly.
        moves: Instants at which joints move, per segment at its full rate, each (n, nv).
        used: Rows that count: of moving joints, and of those without dry friction, (n, nv).
        last: The last joint whose row holds each base parameter, shape (r,).
        scale: Uncertainty of the given robot's base parameters, shape (r,).
        compared: Whether drive gains rest on rows of several joints.
    """

    fit: FitRows
    moves: tuple[Mask, ...]
    used: Mask
    last: npt.NDArray[np.intp]
    scale: Array
    compared: bool

    @property
    def base(self) -> BaseParameters:
        """Base parameters of links and effects."""
        return self.fit.base

    def recordings(self, joint: int) -> tuple[str, ...]:
        """Recordings in which rows of a joint count."""
        train = self.fit.data.train
        parts = np.split(self.used[:, joint], np.cumsum([len(s.t) for s in train])[:-1])
        names = [s.name for s, used in zip(train, parts, strict=True) if used.any()]
        return tuple(dict.fromkeys(names))

    def pose(self, joint: int) -> Array:
        """Where the arm stands on average while a joint moves, shape (nv,)."""
        train = self.fit.data.train
        pairs = zip(train, self.moves, strict=True)
        poses = [s.motion.q[m[:, joint]] for s, m in pairs if m[:, joint].any()]
        poses = poses or [s.motion.q for s in train]
        return np.asarray(np.concatenate(poses).mean(axis=0), float)

    def mode(self, robot: Robot, joint: int) -> str:
        """Which joints move while a joint does, in words; rare moments are left aside."""
        times, poses = [], []
        for segment, moves in zip(self.fit.data.train, self.moves, strict=True):
            now = moves[:, joint]
            if now.any():
                times.append(moves[now].sum(axis=0) / segment.rate_hz)
                poses.append(np.delete(segment.motion.q[now].mean(axis=0), joint))
        if not poses:
            return "does not move"
        each = np.array(times)
        share = each.sum(axis=0) / each[:, joint].sum()
        often = each[:, joint] > _SOMETIMES * each[:, joint].sum()
        share[joint] = 0.0
        others = np.flatnonzero(share > _SOMETIMES)
        if len(others):
            if joint and set(range(joint)) <= set(others.tolist()):
                return "moves with all joints before it"
            return "moves with " + ", ".join(robot.joints[k] for k in others)
        spread = np.ptp(np.array(poses)[often], axis=0).max(initial=0.0)
        briefly = " but for moments" if share.max() > 0 else ""
        return f"moves alone{briefly}, the others in " + (
            "several poses" if spread > _POSE else "one pose"
        )


def link_rows(robot: Robot, effects: tuple[Effect, ...], data: Data) -> LinkRows:
    """Rows of the training segments, see `LinkRows`."""
    moves = tuple(moving(robot, data.train))
    train = tuple(stilled(s, m) for s, m in zip(data.train, moves, strict=True))
    data = replace(data, train=train)
    base = base_parameters(robot, effects)
    regression, measured = regression_of(robot, effects, train), series(train)
    used = np.concatenate([m[s.keep] for s, m in zip(train, moves, strict=True)])
    used = used | ~dry_joints(effects, robot.joints)
    gains, compared = np.ones(robot.nv), True
    if data.unit == "A":
        gains, compared = current_gains(robot, base, regression.W, measured.measured, used)
    regression = regression.with_torque(regression.tau * gains)
    fit = FitRows(robot, effects, base, data, gains, regression)
    scale = np.sqrt(np.diag(base_prior(robot, effects, base).covariance))
    return LinkRows(fit, moves, used, last_rows(robot, effects, base), scale, compared)


@dataclass(frozen=True)
class Determined:
    """A combination of parameters that a stage determines, e.g. ``link3.Izz + 0.36·link4.m``."""

    expression: str
    value: float
    std: float


@dataclass(frozen=True)
class Stage:
    """One link.

    Attributes:
        joint: Index of its joint, whose row was read.
        rows: Number of its rows that count.
        noise: Their standard deviation [torque unit]; NaN without rows.
        inflation: Rows that count as one independent row.
        recordings: Recordings with such rows.
        mode: Which joints moved with it, in words.
        determined: Combinations that the row adds to those of the links further out.
        missing: Base parameters of the link that no row of the recordings shows.
        needed: The motion that would show them, as sentences.
    """

    joint: int
    rows: int
    noise: float
    inflation: float
    recordings: tuple[str, ...]
    mode: str
    determined: tuple[Determined, ...]
    missing: tuple[str, ...] = ()
    needed: tuple[str, ...] = ()

    def result(self, robot: Robot) -> dict[str, Any]:
        """Entry of result.json."""
        return {
            "link": robot.links[self.joint],
            "joint": robot.joints[self.joint],
            "rows": self.rows,
            "recordings": list(self.recordings),
            "mode": self.mode,
            "noise": self.noise if np.isfinite(self.noise) else None,
            "determined": [vars(each) for each in self.determined],
            "missing": list(self.missing),
            "needed": list(self.needed),
        }


@dataclass(frozen=True, eq=False)
class LinkByLink:
    """What was identified link by link.

    Attributes:
        estimate: Physically consistent model and its accuracy.
        cascade: The base parameters with their covariance.
        stages: The links, last one first.
        all_at_once: All links from all rows together, for comparison.
        refusal: Why weighted least squares of all rows was not possible, empty if it was; the
            comparison then rests on the given robot too.
    """

    estimate: Estimate
    cascade: Cascade
    stages: tuple[Stage, ...]
    all_at_once: Estimate
    refusal: str

    def result(self) -> dict[str, Any]:
        """Machine-readable result: that of `identify`, and the stages under ``link_by_link``."""
        robot, estimate, whole = self.estimate.given, self.estimate, self.all_at_once
        how = "weighted least squares of all rows, then physically consistent fit"
        if self.refusal:
            how = (
                "all rows with the given robot as prior, because weighted least squares refuses: "
                + self.refusal
            )
        rms = {
            "given": estimate.baseline.rms,
            "all_at_once": whole.validate.rms,
            "link_by_link": estimate.validate.rms,
            "measured_std": estimate.holdout.measured.std(axis=0),
        }
        return estimate.result() | {
            "estimator": "link by link from the last inward, each from its own joint's row with "
            "the outer links known; then physically consistent semidefinite fit",
            "link_by_link": {
                "stages": [stage.result(robot) for stage in self.stages],
                "determined": sum(len(stage.determined) for stage in self.stages),
                "base_parameters": len(estimate.base),
                "comparison": {
                    "all_at_once": how,
                    "refusal": self.refusal or None,
                    "joints": [
                        {"name": joint} | {key: float(each[j]) for key, each in rms.items()}
                        for j, joint in enumerate(robot.joints)
                    ],
                },
            },
        }

    def series(self) -> dict[str, Array]:
        """Measured torque and that of the models on the hold-out, each of shape (n, nv)."""
        return self.estimate.series() | {"all_at_once": self.all_at_once.predicted}


def identify_link_by_link(
    robot: Robot,
    recordings: Sequence[Recording],
    *,
    validate: Sequence[Recording] = (),
    effects: Sequence[Effect] | None = None,
    cutoff_hz: float | None = None,
) -> LinkByLink:
    """Identify a robot from the last link inward, and compare with all links at once.

    Args:
        robot: The arm; its inertias are the prior.
        recordings: What to fit; one joint, a few or all may move.
        validate: What to judge on; the last 30 % of each recording when empty.
        effects: Effects to estimate; friction, offset and rotor inertia when None.
        cutoff_hz: Cut-off of the torque filter [Hz].

    Raises:
        BadRecording: Recordings that cannot be used.
        BadRobot: Links without mass, so no prior.
        Infeasible: The semidefinite solver failed.
    """
    effects = standard_effects(robot.joints) if effects is None else tuple(effects)
    prior = prior_parameters(robot)
    data = split(recordings, validate, cutoff_hz)
    rows = link_rows(robot, effects, data)
    cascade, stages = run_stages(robot, rows)
    fit = LeastSquares(
        cascade.beta,
        cascade.covariance,
        np.array([stage.noise for stage in reversed(stages)]),
        np.array([stage.inflation for stage in reversed(stages)]),
    )
    known = cascade.information()
    physical = fit_physical(known.R @ rows.base.regrouping, known.z, prior, rows.fit.open_prior)
    estimate = judged(robot, rows.fit, fit, physical, _notes(rows, stages))
    try:
        whole = identify_robot(
            robot, recordings, validate=validate, effects=effects, cutoff_hz=cutoff_hz
        )
        refusal = ""
    except RankDeficient as error:
        whole, refusal = _with_prior(robot, rows, fit), str(error)
    return LinkByLink(estimate, cascade, stages, whole, refusal)


def run_stages(robot: Robot, rows: LinkRows) -> tuple[Cascade, tuple[Stage, ...]]:
    """All stages, from the last joint inward, and what is known of the base parameters then."""
    fit = rows.fit
    W, tau = fit.W[:, :, fit.base.columns], fit.tau
    known = beginning(base_prior(robot, fit.effects, fit.base))
    F, leading, stages = np.zeros((0, len(fit.base))), list[int](), []
    for j in reversed(range(robot.nv)):
        before, counted = len(leading), rows.used[:, j]
        known, noise, inflation = further(known, W[counted, j], tau[counted, j])
        own = np.flatnonzero(rows.last == j).tolist()
        F, leading = led_combinations(F, leading, known.functionals[before:], rows.scale, own)
        found = _determined(known, F[before:], leading[before:], rows)
        mode, names = rows.mode(robot, j), rows.recordings(j)
        stages.append(Stage(j, int(counted.sum()), noise, inflation, names, mode, found))
    return known, tuple(_completed(robot, rows, F, leading, stage) for stage in stages)


def _determined(
    known: Cascade, F: Array, leading: Sequence[int], rows: LinkRows
) -> tuple[Determined, ...]:
    base, (values, covariance) = rows.base, known.of(F)
    found = []
    for row, lead, value, s in zip(F, leading, values, np.sqrt(np.diag(covariance)), strict=True):
        kept = np.where(np.abs(row) * rows.scale > _NEGLIGIBLE * s, row, 0.0)
        kept[lead] = 1.0
        text = expression(kept @ base.regrouping, base.names, base.columns[lead])
        found.append(Determined(text, float(value), float(s)))
    return tuple(found)


def _completed(
    robot: Robot, rows: LinkRows, F: Array, leading: Sequence[int], stage: Stage
) -> Stage:
    """The stage with what is still missing of its link, and the motion that would show it."""
    own = np.flatnonzero(rows.last == stage.joint)
    missing = [k for k in own if k not in leading]
    if not missing:
        return stage
    shown = F[[k in own for k in leading]][:, own]
    sentence = _needed_motion(robot, rows, stage.joint, own, shown)
    outer = any(k not in leading for k in np.flatnonzero(rows.last > stage.joint))
    condition = "; then complete the links further out" if outer else ""
    return replace(
        stage,
        missing=tuple(rows.base.expressions[k] for k in missing),
        needed=(sentence + condition,),
    )


def _needed_motion(
    robot: Robot, rows: LinkRows, joint: int, own: npt.NDArray[np.intp], shown: Array
) -> str:
    """The smallest change of the recordings whose torque of a joint shows all its parameters.

    Tried in this order: the joint alone; at several positions of one other joint; together with
    one; the same with two; together with all joints before it.

    Args:
        robot: The arm.
        rows: The recordings; joints that are not mentioned stand as in them.
        joint: The joint whose row is read; it moves.
        own: Its base parameters, m of them.
        shown: Combinations of them that are shown already, shape (k, m).
    """
    columns, scale = [rows.base.columns[k] for k in own], rows.scale[own]
    pose, name = rows.pose(joint), robot.joints[joint]
    others = [k for k in range(robot.nv) if k != joint]
    changes: list[tuple[tuple[int, ...], tuple[int, ...]]] = [((), ())]  # moved, turned
    for size in (1, 2) if robot.nv <= _PAIRS else (1,):
        changes += [((), chosen) for chosen in combinations(others, size)]
        changes += [(chosen, ()) for chosen in combinations(others, size)]
    for moved, turned in (*changes, (tuple(range(joint)), ())):
        count = len(own) + _STATES
        q, dq, ddq = robot.random_motion(np.random.default_rng(0), count)
        still = np.ones(robot.nv, bool)
        still[[joint, *moved]] = False
        dq[:, still] = ddq[:, still] = 0.0
        still[list(turned)] = False
        q[:, still] = pose[still]
        motion = Motion(np.arange(float(count)), q, dq, ddq)
        W = observation_columns(robot, rows.fit.effects, motion)[:, joint, columns]
        parts = [A / max(float(np.linalg.norm(A)), 1e-300) for A in (W * scale, shown * scale)]
        s = np.linalg.svd(np.vstack(parts), compute_uv=False)
        if len(s) == len(own) and s[-1] > _VISIBLE * s[0]:
            listed = " and ".join(robot.joints[k] for k in (*moved, *turned))
            if turned:
                return f"move {name} alone at several positions of {listed}"
            if moved:
                return f"move {name} together with {listed}"
            return f"move {name} alone, farther or faster than here"
    return f"move {name} together with all joints before it, at several positions of those after it"


def _with_prior(robot: Robot, rows: LinkRows, fit: LeastSquares) -> Estimate:
    """All rows at once with the given robot as prior, the noise that of the stages."""
    sigma = np.where(np.isfinite(fit.sigma), fit.sigma, np.inf)
    noise = LeastSquares(fit.beta, fit.covariance, sigma, fit.inflation)
    R, z = rows.fit.regression.counting(rows.used).factor(noise.weight)
    physical = fit_physical(R, z, prior_parameters(robot), rows.fit.open_prior)
    return judged(robot, rows.fit, fit, physical, ())


def _notes(rows: LinkRows, stages: Sequence[Stage]) -> tuple[str, ...]:
    data, base = rows.fit.data, rows.base
    count = sum(len(stage.determined) for stage in stages)
    rest = "" if count == len(base) else "; the rest stays at the given robot"
    notes = [
        data.holdout,
        f"link by link, these recordings determine {count} of {len(base)} base combinations{rest}",
    ]
    gains = ", ".join(f"{k:.3g}" for k in rows.fit.gains)
    if data.unit == "A" and rows.compared:
        notes.append(
            "torque came as motor current; drive gains relative to each other were estimated "
            f"({gains} N·m/A); their common scale rests on the given masses and is not "
            "determined by currents"
        )
    elif data.unit == "A":
        notes.append(
            "torque came as motor current, and joints that move one at a time do not show their "
            f"drives' gains relative to each other: they ({gains} N·m/A) rest on the given "
            "masses, and on each other where masses hardly load the joint. A joint's own current "
            "is predicted alike for any gain; what outer links cost inner joints, and values in "
            "N·m, kg or kg·m², are as good as these gains"
        )
    return tuple(notes)
