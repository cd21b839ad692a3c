"""Poses: an arm at rest, a row each, whose torque shows gravity and nothing of motion.

    τ = Y(q, 0, 0) φ + Σ_e C_e(q) θ_e + f,    |f_j| ≤ breakaway torque of joint j,

with the effects e that act at rest. Dry friction f holds any torque up to its breakaway torque, as
the arm came to each pose: it is the noise here, so that a joint whose torque varies by no more than
that shows friction and no gravity.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from excitant.exceptions import BadRecording
from excitant.identify.least_squares import NOISE
from excitant.identify.preprocessing import REST, Segment
from excitant.identify.recording import LEAST_RATE_HZ, Recording
from excitant.identify.regression import regression_of
from excitant.identify.rows import (
    Data,
    FitRows,
    counted_rows,
    fitted_and_held,
    refuse_other_units,
)
from excitant.robots.base_parameters import (
    BaseParameters,
    observe,
    regroup,
    structural_motion,
)
from excitant.robots.effects import Effect, standard_effects
from excitant.robots.motion import Array, Motion
from excitant.robots.robot import Robot

SAME_POSE = 3e-3
"""Positions [rad or m] within which rows in a row are one pose: a servo holds a joint to that."""
SHOWN = 3.0
"""Standard deviation of a joint's torque over its scatter, above which it shows gravity: the best
model misses a third of it then, and by chance of ten poses less than what is objected to
(`objections.MISSED`)."""
NO_MOTION = (
    "at rest torque shows gravity and its offsets, no friction and no inertia, of which nothing is "
    "identified"
)


def pose_rows(
    robot: Robot, recordings: Sequence[Recording], validate: Sequence[Recording]
) -> FitRows:
    """Rows of poses for the effects that act at rest, and the base parameters that gravity shows.

    Raises:
        BadRecording: A row in which a joint moves, or a hold-out with poses that are fitted.
    """
    first = recordings[0]
    refuse_other_units((*recordings, *validate), first.unit, f"in {first.file}")
    train, held = (
        [_poses(each, robot) for each in some] for some in (recordings, validate)
    )
    _refuse_shared(train, held)
    fit, holdout = (
        tuple(_segment(each) for each in some)
        for some in fitted_and_held(train, held)
    )
    names = ", ".join(each.name for each in held)
    unseen = names or "the last 30 % of each recording (no hold-out was named)"
    data = Data(
        fit,
        holdout,
        first.unit,
        np.inf,
        f"held out: {unseen}, {_count(holdout)} poses beside {_count(fit)} that are fitted: "
        f"{NO_MOTION}",
        "poses: dry friction holds any torque up to its breakaway torque, which counts as noise: "
        "come to the poses from both sides",
        first.drive,
    )
    effects = at_rest(robot)
    base = _base(robot, effects)
    regression = regression_of(robot, effects, fit)
    return counted_rows(robot, effects, base, data, regression)


def at_rest(robot: Robot) -> tuple[Effect, ...]:
    """Effects that are estimated: offsets of the torque, and what the given arm has at rest."""
    offsets = tuple(
        effect
        for effect in standard_effects(robot.joints)
        if effect.name == "torque_offset"
    )
    motion = _stopped(structural_motion(robot, np.random.default_rng(1)))
    others = tuple(
        effect
        for effect in robot.effects
        if effect.name != "torque_offset" and effect.columns(robot, motion).any()
    )
    return offsets + others


def kept(robot: Robot) -> tuple[Effect, ...]:
    """Effects of the given arm of which rest shows nothing."""
    shown = {effect.name for effect in at_rest(robot)}
    return tuple(effect for effect in robot.effects if effect.name not in shown)


def scatter(rows: FitRows) -> Array:
    """Torque that no parameters of a joint's own explain, shape (nv,) [torque unit].

    One that all joints together do not explain, as of another sign, is no friction for that.

    Raises:
        BadRecording: So few poses that some parameters explain whatever the torque is.
    """
    problem = rows.reduced
    unexplained = []
    for j, T in enumerate(problem.triangles):
        own, _, rank, _ = np.linalg.lstsq(T[:, :-1], T[:, -1])
        freedom = len(problem) - int(rank)
        if freedom < NOISE.freedom:
            raise BadRecording(
                ", ".join(s.name for s in rows.data.train),
                f"{len(problem)} poses are fitted, of which {int(rank)} parameters explain any "
                f"torque of {rows.robot.joints[j]}: record more poses",
            )
        left = T[:, -1] - T[:, :-1] @ own
        unexplained.append(float(np.sqrt(left @ left / freedom)))
    return np.array(unexplained) / rows.gains


def _count(segments: Sequence[Segment]) -> int:
    return sum(len(segment.motion) for segment in segments)


def _base(robot: Robot, effects: Sequence[Effect]) -> BaseParameters:
    motion = structural_motion(robot, np.random.default_rng(0))
    return regroup(observe(robot, effects, _stopped(motion)))


def _stopped(motion: Motion) -> Motion:
    still = np.zeros_like(motion.q)
    return replace(motion, dq=still, ddq=still)


def _poses(recording: Recording, robot: Robot) -> Recording:
    """One row a pose, the mean of rows in a row at one place."""
    _refuse_moving(recording, robot)
    first = [0]
    for row, q in enumerate(recording.q):
        if np.abs(q - recording.q[first[-1]]).max() > SAME_POSE:
            first.append(row)
    if len(first) < 2:
        raise BadRecording(
            recording.file,
            f"its {len(recording)} rows are one pose: record several",
        )
    counts = np.diff(np.append(first, len(recording)))
    q, tau = (
        np.add.reduceat(x, first, axis=0) / counts[:, None]
        for x in (recording.q, recording.tau)
    )
    return replace(
        recording, t=recording.t[first], q=q, tau=tau, dq=None, extras={}
    )


def _refuse_moving(recording: Recording, robot: Robot) -> None:
    if recording.dq is None:
        return
    limit = robot.limits.usual_speed
    moving = np.abs(recording.dq) > REST.moving_share * limit
    if not moving.any():
        return
    rows = np.flatnonzero(moving.any(axis=1))
    row = int(rows[0])
    j = int(np.argmax(moving[row]))
    unit = "rad/s" if robot.revolute[j] else "m/s"
    raise BadRecording(
        recording.file,
        f"joints move in {len(rows)} of {len(moving)} rows ({robot.joints[j]} at "
        f"{recording.dq[row, j]:.3g} {unit} here), so that these are no poses, and rows "
        f"{recording.step:.3g} s apart do not show accelerations: record at "
        f"{LEAST_RATE_HZ:.0f} Hz or more, or at rest",
        row=row,
    )


def _refuse_shared(train: Sequence[Recording], held: Sequence[Recording]) -> None:
    """Refuse a hold-out with a pose and its torques as they are fitted, to the last digit."""
    seen = {row.tobytes() for each in train for row in _values(each)}
    for each in held:
        shared = sum(row.tobytes() in seen for row in _values(each))
        if shared:
            raise BadRecording(
                each.file,
                f"{shared} of its {len(each)} poses are fitted too: a hold-out must be unseen; "
                "name another",
            )


def _values(recording: Recording) -> Array:
    return np.column_stack([recording.q, recording.tau])


def pose_segment(recording: Recording, robot: Robot) -> Segment:
    """The poses of a recording as a segment.

    Raises:
        BadRecording: A row in which a joint moves, or one pose only.
    """
    return _segment(_poses(recording, robot))


def _segment(recording: Recording) -> Segment:
    """Poses as a segment that nothing filters."""
    still = np.zeros_like(recording.q)
    return Segment(
        name=recording.name,
        motion=Motion(recording.t, recording.q, still, still),
        tau=recording.tau,
        tau_raw=recording.tau,
        cutoff_hz=np.inf,
        keep=slice(0, len(recording)),
    )
