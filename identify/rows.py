"""Fitted and held-out data, the regression of an arm on them, and its accuracy."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import numpy as np
import numpy.typing as npt

from excitant.exceptions import BadInput, BadRecording
from excitant.identify.drive_gains import DriveGains, current_gains
from excitant.identify.preprocessing import (
    CUTOFF_HZ,
    Segment,
    certain_rows,
    default_cutoff,
    prepare,
)
from excitant.identify.prior import EffectPrior
from excitant.identify.recording import Recording
from excitant.identify.regression import Regression, regression_of
from excitant.identify.signals import SensorNoise, mean_noise
from excitant.robots.base_parameters import BaseParameters
from excitant.robots.effects import Effect, Parameter, standard_effects
from excitant.robots.motion import (
    Array,
    Mask,
    Motion,
    quotient,
    root_mean_square,
    together,
)
from excitant.robots.parameters import UNITS
from excitant.robots.robot import Robot
from excitant.robots.torque import coefficients, torque

FIT_SHARE = 0.7  # of each recording is fitted when no hold-out is named
NAMED_SHARE = (
    0.05  # of a joint's rows that is left out, from which on it is reported
)
SEEN_ROWS = (
    50  # in a row, in motion: so many of a coarse servo never repeat by chance
)
SEEN_APART = 5  # rows of one recording to one of its copy that left rows out
HARMONICS_FACTOR = (
    2.0  # centrifugal torque has twice the highest harmonic of a motion
)


class Poses(NamedTuple):
    """What else is known of data that are poses of an arm at rest.

    Attributes:
        least: Standard deviation of a joint's torque that shows gravity, shape (nv,) [torque unit].
        kept: Effects of the given arm of which they show nothing.
    """

    least: Array
    kept: tuple[Effect, ...]


@dataclass(frozen=True, eq=False)
class Data:
    """Recordings ready for fitting and for judging.

    Attributes:
        train: Segments to fit.
        validate: Segments held out.
        unit: Unit of the torque columns, ``"N·m"`` or ``"A"``.
        cutoff_hz: Cut-off of the torque filter [Hz].
        holdout: What was held out, as a sentence.
        cutoff_why: Why that cut-off, as a sentence.
        drive: Drive gains on which torque in N·m rests, if it was recorded as current.
        poses: What is known of poses; None of motions.
        delay: Time by which the torque was read earlier than it was logged [s].
    """

    train: tuple[Segment, ...]
    validate: tuple[Segment, ...]
    unit: str
    cutoff_hz: float
    holdout: str
    cutoff_why: str = ""
    drive: DriveGains | None = None
    poses: Poses | None = None
    delay: float = 0.0

    @property
    def sensors(self) -> SensorNoise | None:
        """Noise of positions and speeds of the fitted recordings, rms over time."""
        sensors = [s.sensors for s in self.train if s.sensors is not None]
        samples = [len(s.motion) for s in self.train]
        return mean_noise(sensors, samples) if sensors else None


def split(
    recordings: Sequence[Recording],
    validate: Sequence[Recording] = (),
    cutoff_hz: float | None = None,
    harmonics_hz: float | None = None,
) -> Data:
    """Prepare recordings; without a hold-out, keep back the last 30 % of each.

    Without a cut-off of the torque filter [Hz], it is 10 Hz, or twice the highest harmonic of the
    motion as planned [Hz] where that is higher, or a fifth of the slowest sampling rate where that
    is lower.

    Raises:
        BadInput: No recording.
        BadRecording: Recordings in different units, too short to split, or a hold-out that shares
            rows with what is fitted.
    """
    if not recordings:
        raise BadInput("no recording given; give at least one")
    first = recordings[0]
    refuse_other_units((*recordings, *validate), first.unit, f"in {first.file}")
    _refuse_seen(recordings, validate)
    why = "as given"
    if cutoff_hz is None:
        parts = fitted_and_held(recordings, validate)
        highest = min(default_cutoff(r) for group in parts for r in group)
        cutoff_hz, why = _cutoff(harmonics_hz or 0.0, highest)
    train, holdout = (
        tuple(s for r in group for s in prepare(r, cutoff_hz))
        for group in fitted_and_held(recordings, validate)
    )
    names = ", ".join(r.name for r in validate)
    unseen = names or "the last 30 % of each recording (no hold-out was named)"
    return Data(
        train,
        holdout,
        first.unit,
        cutoff_hz,
        holdout=f"held out: {unseen}",
        cutoff_why=f"cut-off: {cutoff_hz:.3g} Hz ({why})",
        drive=first.drive,
    )


def refuse_other_units(
    recordings: Sequence[Recording], unit: str, where: str
) -> None:
    """Refuse recordings whose torque is in another unit than it is elsewhere."""
    for recording in recordings:
        if recording.unit != unit:
            raise BadRecording(
                recording.file,
                f"torque is in {recording.unit}, but in {unit} {where}; "
                "use recordings of one unit",
            )


def _refuse_seen(
    recordings: Sequence[Recording], validate: Sequence[Recording]
) -> None:
    """Refuse a hold-out that repeats `SEEN_ROWS` rows in a row of what is fitted, in motion.

    Of either, only every row of a number up to `SEEN_APART` may be there. The very objects that are
    fitted may be named: where nothing is to be judged.
    """
    fitted_runs = [(r, _runs(r)) for r in recordings] if validate else []
    for held in validate:
        thinned = _runs(held)
        for recording, others in fitted_runs:
            if recording is held:
                continue
            dense = np.isin(thinned[0], np.concatenate(others))
            thin = np.isin(np.concatenate(thinned), others[0])
            if seen := max(int(dense.sum()), int(thin.sum())):
                raise BadRecording(
                    held.file,
                    f"{seen + SEEN_ROWS - 1} of its {len(held)} rows are those of "
                    f"{recording.file}, which is fitted: a hold-out must be unseen; name another",
                )


def _runs(recording: Recording) -> list[npt.NDArray[np.uint64]]:
    """Numbers for every `SEEN_ROWS` rows of positions and torques, none at rest.

    Of rows in a row first, then of every second, ..., of every `SEEN_APART`-th row.
    """
    values = np.column_stack([recording.q, recording.tau])
    words = np.ascontiguousarray(values).view(np.uint64)
    rng = np.random.default_rng(0)
    columns, places = (
        2 * rng.integers(2**62, size=size, dtype=np.uint64) + 1
        for size in (words.shape[1], SEEN_ROWS)
    )
    rows = (words * columns).sum(axis=1, dtype=np.uint64)

    def numbers(some: npt.NDArray[np.uint64]) -> npt.NDArray[np.uint64]:
        if len(some) < SEEN_ROWS:
            return np.zeros(0, np.uint64)
        changes = np.append(0, np.cumsum(np.diff(some) != 0))
        moved = changes[SEEN_ROWS - 1 :] - changes[: 1 - SEEN_ROWS]
        return np.convolve(some, places, "valid")[moved >= SEEN_ROWS / 2]

    return [
        np.concatenate([numbers(rows[first::stride]) for first in range(stride)])
        for stride in range(1, SEEN_APART + 1)
    ]


def _cutoff(harmonics_hz: float, highest: float) -> tuple[float, str]:
    """Cut-off that passes the motion, at most the highest that sampling allows [Hz], and why."""
    wanted = max(CUTOFF_HZ, HARMONICS_FACTOR * harmonics_hz)
    why = "above the motion of arms and below their structural resonances"
    if wanted > CUTOFF_HZ:
        why = "twice the highest harmonic of the motion, for torque holds products of two speeds"
    if highest < wanted:
        why = (
            "a fifth of the lowest sampling rate, so that positions are still filtered at "
            "twice it"
        )
    return min(wanted, highest), why


def fitted(
    recordings: Sequence[Recording], validate: Sequence[Recording]
) -> list[Recording]:
    """Recordings to fit: as they are, or their first part where none is held out."""
    return list(fitted_and_held(recordings, validate)[0])


def fitted_and_held(
    recordings: Sequence[Recording], validate: Sequence[Recording]
) -> tuple[Iterable[Recording], Iterable[Recording]]:
    """Fitted and held-out recordings one at a time, since long ones fill the memory."""
    if validate:
        return recordings, validate
    return (
        (r.between(0, FIT_SHARE, "first 70 %") for r in recordings),
        (r.between(FIT_SHARE, 1, "last 30 %") for r in recordings),
    )


def states(segments: Sequence[Segment]) -> Motion:
    """The motion at the rows of segments, one after another."""
    return together([s.motion[s.keep] for s in segments])


def predicted_torque(robot: Robot, segments: Sequence[Segment]) -> Array:
    """Torque of the robot with its effects at the rows, filtered alike, shape (n, nv) [N·m]."""
    return np.concatenate(
        [s.rows(lambda motion: torque(robot, motion)) for s in segments]
    )


@dataclass(frozen=True, eq=False)
class FitRows:
    """The regression of an arm: of all its parameters on the training segments.

    Attributes:
        robot: The arm; effects whose columns hold its torque take it from here.
        effects: Effects that are estimated.
        base: Base parameters of links and effects.
        data: Segments for fitting and for validation.
        used: Rows that count, shape (n, nv); see `certain_rows`.
        regression: Columns of all parameters of links and effects, and torque [N·m], at those.
        drive: Drive gains, if torque was recorded as current.
    """

    robot: Robot
    effects: tuple[Effect, ...]
    base: BaseParameters
    data: Data
    used: Mask
    regression: Regression
    drive: DriveGains | None

    def fitting(self, regression: Regression) -> Regression:
        """Other columns at the rows that count, with the torque there."""
        return regression.counting(self.used).with_torque(self.tau)

    @property
    def rests(self) -> str:
        """Joints with rows that are left out, as a sentence; empty where there are few."""
        shares = zip(self.robot.joints, (~self.used).mean(axis=0), strict=True)
        listed = ", ".join(
            f"{joint} {100 * share:.0f} %"
            for joint, share in shares
            if share >= NAMED_SHARE
        )
        if not listed:
            return ""
        return (
            "left out of the fit: rows at which a joint rests, where dry friction holds any torque "
            f"near that of motion, or its sensors show no direction ({listed})"
        )

    @property
    def gains(self) -> Array:
        """Torque per reading, shape (nv,) [N·m per reading]."""
        return gains_of(self.robot, self.data, self.drive)

    @property
    def tau(self) -> Array:
        """Measured torque, shape (n, nv) [N·m]."""
        return self.regression.tau

    @property
    def W(self) -> Array:
        """Columns of links and effects, shape (n, nv, p)."""
        return self.regression.W

    def regained(self, problem: Regression) -> Self:
        """The rows with drive gains of currents by better columns, or by fewer rows, of the base.

        As they are where torque was recorded. The problem has these rows' units.
        """
        if self.data.unit != "A":
            return self
        columns = problem.W @ self.base.regrouping
        current = problem.tau / self.gains
        drive = current_gains(self.robot, columns, current, problem.used)
        torque = self.tau * drive.gains / self.gains
        regression = self.regression.with_torque(torque)
        return replace(self, drive=drive, regression=regression)

    def by_gain(self, weight: Array, beta: Array) -> Array:
        """Wᵀ W β of each joint, rows times weight (nv,): what a relative change of its gain adds.

        W holds the base columns of β, shape (r,), Wᵀ all columns: shape (p, nv). Torque as fitted
        stands for the measured one, of which the fit may have passed over gross errors.
        """
        x = np.zeros(self.regression.p)
        x[list(self.base.columns)] = beta
        pull = np.zeros((self.regression.p, self.robot.nv))
        parts = zip(
            self.regression.index, self.regression.triangles, weight, strict=True
        )
        for j, (index, T, w) in enumerate(parts):
            own = T[:, :-1]
            pull[index, j] = w**2 * own.T @ (own @ x[index])
        return pull

    @property
    def reduced(self) -> Regression:
        """The regression of the base parameters."""
        return self.regression.select(self.base.columns, self.base.expressions)

    @property
    def open_prior(self) -> EffectPrior:
        """Nothing known of coefficients of effects but their signs."""
        effects = self.regression.select(
            range(10 * self.robot.nv, self.regression.p)
        )
        std = implausible_size(effects.W, self.tau)
        lower = [p.lower for p in coefficients(self.robot, self.effects)]
        return EffectPrior(np.zeros_like(std), std, np.array(lower))


def effects_of(
    robot: Robot, effects: Sequence[Effect] | None
) -> tuple[Effect, ...]:
    """Effects to estimate; friction, offset and rotor inertia of each joint when None."""
    return standard_effects(robot.joints) if effects is None else tuple(effects)


def fit_rows(
    robot: Robot, effects: Sequence[Effect], base: BaseParameters, data: Data
) -> FitRows:
    """The rows of the training segments at which no dry friction may hold a joint."""
    regression = regression_of(robot, effects, data.train)
    return counted_rows(robot, effects, base, data, regression)


def counted_rows(
    robot: Robot,
    effects: Sequence[Effect],
    base: BaseParameters,
    data: Data,
    regression: Regression,
) -> FitRows:
    """Those of the regression of an arm at every row."""
    used = certain_rows(effects, robot.joints, data.train)
    drive = data.drive
    regression = regression.counting(used)
    if data.unit == "A":
        drive = current_gains(robot, regression.W, regression.tau, used)
        regression = regression.with_torque(regression.tau * drive.gains)
    return FitRows(robot, tuple(effects), base, data, used, regression, drive)


def gains_of(robot: Robot, data: Data, drive: DriveGains | None) -> Array:
    """Torque per reading, shape (nv,): ones where torque was read, or made of currents before."""
    return (
        drive.gains if drive is not None and data.unit == "A" else np.ones(robot.nv)
    )


def told(
    parameter: Parameter, robot: Robot, drive: DriveGains | None
) -> tuple[float, str]:
    """Factor and unit in which to tell a coefficient: in amperes where its gain is not known."""
    owner = parameter.name.rpartition(".")[0]
    if drive is None or owner not in robot.joints:
        return 1.0, parameter.unit
    return drive.told(parameter.unit, robot.joint_index(owner))


def units_of(
    robot: Robot, effects: Sequence[Effect], drive: DriveGains | None
) -> list[tuple[float, str]]:
    """Factor and unit in which to tell each parameter of links and effects."""
    links = [(1.0, unit) for unit in UNITS * robot.nv]
    return links + [told(p, robot, drive) for p in coefficients(robot, effects)]


def implausible_size(columns: Array, tau: Array) -> Array:
    """A hundred times the coefficient of columns, (n, nv, e), that explains all torque, (e,)."""
    size = root_mean_square(columns, axis=(0, 1))
    largest = 100 * root_mean_square(tau, axis=(0, 1))
    return quotient(largest, size, otherwise=1e3)


def places_of(
    robot: Robot, effects: Sequence[Effect]
) -> Iterator[tuple[Effect, slice]]:
    """Each effect with its columns among those of all parameters, after those of the links."""
    stop = 10 * robot.nv
    for effect in effects:
        start = stop
        stop += len(effect.parameters(robot))
        yield effect, slice(start, stop)


def identified_robot(robot: Robot, effects: Sequence[Effect], x: Array) -> Robot:
    """The robot with identified inertias and effects; x as in `PhysicalFit`."""
    valued = [e.with_values(x[own]) for e, own in places_of(robot, effects)]
    return robot.with_parameters(x[: 10 * robot.nv]).with_effects(valued)
