"""The verbs of every day, which take names, files, tables and arrays as well as nouns.

Here names become nouns, and nowhere else: the packages below take nouns only. The commands call
the same functions.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

import excitant.analysis.diagnosis as diagnosis
import excitant.analysis.identifiability as identifiability
import excitant.analysis.rehearsal as rehearsal
import excitant.design.feasible as feasible
import excitant.design.optimal as optimal
import excitant.identify.estimate as estimation
import excitant.identify.online as online
import excitant.identify.payload as payload
import excitant.identify.reading.logs as logs
import excitant.identify.sequential as sequential
import excitant.robots.virtual_arm as virtual
from excitant.analysis.diagnosis import Diagnosis
from excitant.analysis.examination import Examination, examine
from excitant.analysis.identifiability import Identifiability
from excitant.analysis.rehearsal import Rehearsal
from excitant.analysis.shown import identify_shown
from excitant.design import export
from excitant.design.criterion import information
from excitant.design.optimal import Progress, SceneOption
from excitant.design.result import Design, TrajectoryCheck
from excitant.design.trajectory import FourierTrajectory, HermiteTrajectory, Trajectory
from excitant.exceptions import BadInput, RankDeficient, UnknownName
from excitant.identify.dataset import Dataset, read_recordings
from excitant.identify.estimate import Estimate
from excitant.identify.faults import Checked, warn_of_faults
from excitant.identify.faults import check as check_recordings
from excitant.identify.knowledge import Knowledge, load_knowledge
from excitant.identify.online import OnlineIdentification
from excitant.identify.payload import PayloadEstimate
from excitant.identify.preprocessing import prepare
from excitant.identify.reading.mapping import ColumnMap
from excitant.identify.recording import (
    MINIMUM_DURATION,
    Recording,
    recordings_of,
)
from excitant.identify.rows import FIT_SHARE
from excitant.identify.sequential import LinkByLink
from excitant.robots.chains import RobotSpec
from excitant.robots.effects import EFFECTS, Acts, Effect, standard_effects
from excitant.robots.geometry import (
    CLEARANCE,
    Obstacle,
    Scene,
    base_plane,
    floor,
    scene,
    unchecked,
)
from excitant.robots.limits_file import load_limits
from excitant.robots.loading import load_robot
from excitant.robots.motion import Motion
from excitant.robots.obstacles_file import load_obstacles
from excitant.robots.robot import Robot
from excitant.robots.virtual_arm import HiddenEffect, VirtualArm
from excitant.surroundings import Surroundings

if TYPE_CHECKING:
    import pandas as pd

RobotLike: TypeAlias = Robot | RobotSpec | str | Path
"""A robot, or what `load_robot` finds one by: its built-in name or a file."""
RecordingLike: TypeAlias = "Recording | pd.DataFrame | str | Path"
"""A recording, a table in memory, or a file."""
Recordings: TypeAlias = "RecordingLike | Sequence[RecordingLike]"
TrajectoryLike: TypeAlias = Trajectory | Motion | str | Path
"""A trajectory, samples of one, or a file of either."""
Columns: TypeAlias = Literal["friction", "inertial"]

SAMPLE_HZ = 100.0  # of a trajectory that has no samples of its own
TOLERANCE = 0.03  # relative, of what a virtual arm hides beside its effect


def as_robot(robot: RobotLike) -> Robot:
    """The robot itself, or the one of a built-in name or a file; see `load_robot`."""
    return robot if isinstance(robot, Robot) else load_robot(robot)


def as_recordings(recordings: Recordings, robot: Robot) -> list[Recording]:
    """Recordings as they are, and those of tables and files; see `load_recording`."""
    # recordings and data frames have columns, which tells them without importing pandas
    single = isinstance(recordings, str | Path) or hasattr(recordings, "columns")
    several: Any = [recordings] if single else recordings
    sources = list[Any]()
    for source in several:
        if isinstance(source, str | Path):
            sources += Dataset(robot).paths([str(source)])
        else:
            sources.append(source)
    paths = [source for source in sources if isinstance(source, Path)]
    read = iter(read_recordings(paths, robot))
    nouns = list[Recording]()
    for k, source in enumerate(sources, start=1):
        if isinstance(source, Recording):
            nouns.append(source)
        elif isinstance(source, Path):
            nouns.append(next(read))
        else:
            label = f"table {k}"
            nouns.append(
                logs.recording_from_table(source, robot, file=label, name=label)
            )
    return recordings_of(nouns, robot)


def as_path(
    trajectory: TrajectoryLike, robot: Robot
) -> tuple[Motion, Trajectory | HermiteTrajectory]:
    """Samples of a trajectory, at 100 Hz where it has none of its own, and what is between."""
    if isinstance(trajectory, str | Path):
        trajectory = export.load_trajectory(trajectory, robot)
    if isinstance(trajectory, Motion):
        return trajectory, HermiteTrajectory(trajectory)
    return trajectory.motion(SAMPLE_HZ), trajectory


def as_effects(effects: Sequence[Effect | str], robot: Robot) -> list[Effect]:
    """Effects as they are, and those of names, of all joints."""
    kinds = {name: kind for name, kind in EFFECTS.items() if kind.acts_on is Acts.EACH}
    names = [effect for effect in effects if isinstance(effect, str)]
    UnknownName.refuse("effect", names, kinds)
    return [
        kinds[effect](robot.joints) if isinstance(effect, str) else effect
        for effect in effects
    ]


def within(robot: RobotLike, surroundings: Surroundings) -> Robot:
    """The robot with the limits, and torque limits that hold as far as masses are uncertain."""
    arm = as_robot(robot)
    if surroundings.limits:
        arm = arm.with_limits(load_limits(surroundings.limits, arm))
    uncertainty = surroundings.mass_uncertainty
    if not 0 <= uncertainty < 100:
        raise BadInput(f"--mass-uncertainty {uncertainty:g}: give 0 to 100 [%]")
    return arm.with_limits(replace(arm.limits, mass_uncertainty=uncertainty / 100))


def obstacles_around(robot: Robot, surroundings: Surroundings) -> tuple[Obstacle, ...]:
    """Obstacles and the floor, if it is known."""
    if surroundings.no_floor and surroundings.floor is not None:
        raise BadInput("--floor and --no-floor exclude each other; leave one out")
    path = surroundings.obstacles
    obstacles = load_obstacles(path) if path else ()
    height = surroundings.floor
    if height is None and not surroundings.no_floor:
        height = base_plane(robot)
    return obstacles if height is None else (*obstacles, floor(height))


def clearance_of(surroundings: Surroundings) -> float:
    """Least distance to keep [m]."""
    least = surroundings.clearance
    return CLEARANCE if least is None else least


def scene_around(robot: Robot, surroundings: Surroundings) -> Scene | None:
    """Scene to keep clear of, if any.

    Raises:
        BadInput: Clearance is asked for, but the arm has no shapes.
    """
    if surroundings.ignore_collisions:
        return None
    obstacles = obstacles_around(robot, surroundings)
    around = scene(robot, obstacles, clearance_of(surroundings))
    options = (surroundings.obstacles, surroundings.floor, surroundings.clearance)
    if around is None and any(option is not None for option in options):
        raise BadInput(
            f"{robot.source}: clearance cannot be checked ({unchecked(robot, None)}); give "
            "its URDF <collision> elements whose meshes are there, or leave --obstacles, "
            "--floor and --clearance out"
        )
    return around


def _kept_clear(robot: Robot, surroundings: Surroundings) -> dict[str, Any]:
    around: SceneOption = scene_around(robot, surroundings) or ()
    return {"scene": around, "clearance": clearance_of(surroundings)}


def load_recording(
    path: str | Path, robot: RobotLike | int, *, mapping: ColumnMap | None = None
) -> Recording:
    """Recording of a robot, or of a number of joints; see `identify.reading.logs`."""
    return logs.load_recording(path, _or_count(robot), mapping=mapping)


def recording_from_table(
    table: Any,
    robot: RobotLike | int,
    *,
    file: str,
    name: str,
    mapping: ColumnMap | None = None,
) -> Recording:
    """Recording from a table in memory; see `identify.reading.logs`."""
    return logs.recording_from_table(
        table, _or_count(robot), file=file, name=name, mapping=mapping
    )


def _or_count(robot: RobotLike | int) -> Robot | int:
    return robot if isinstance(robot, int) else as_robot(robot)


def load_trajectory(path: str | Path, robot: RobotLike) -> Trajectory | Motion:
    """Trajectory from a file of coefficients (JSON) or of samples (CSV)."""
    return export.load_trajectory(path, as_robot(robot))


def random_trajectory(
    robot: RobotLike, rng: np.random.Generator, duration: float, harmonics: int
) -> FourierTrajectory:
    """A random motion within all limits; see `excitant.design.random_trajectory`."""
    return feasible.random_trajectory(as_robot(robot), rng, duration, harmonics)


def virtual_arm(
    robot: RobotLike,
    rng: np.random.Generator,
    *,
    hidden: Sequence[HiddenEffect] | None = None,
    **options: Any,
) -> VirtualArm:
    """An arm that differs from its description; see `excitant.robots.virtual_arm`."""
    return virtual.virtual_arm(as_robot(robot), rng, hidden=hidden, **options)


def design_trajectory(
    robot: RobotLike,
    *,
    noise: npt.ArrayLike | None = None,
    after: Recordings | Sequence[Motion] = (),
    surroundings: Surroundings = Surroundings(),
    progress: Progress | None = None,
    **options: Any,
) -> Design:
    """Excitation trajectory that makes the base parameters best visible within the limits.

    Args:
        robot: The arm; its limits and effects count.
        noise: Torque noise of each joint, which weights its equations [N·m or N].
        after: Recordings made already, or their motions: what should run next?
        surroundings: Limits, and what to keep clear of: without a word the arm's own bodies and
            the floor that it stands on.
        progress: Called whenever a search has news.
        options: Fields of `excitant.design.Search`: duration, harmonics, starts, time_limit, ...

    Errors are those of `excitant.design.design_trajectory`.
    """
    arm = within(robot, surroundings)
    return optimal.design_trajectory(
        arm,
        noise=noise,
        after=recorded_motions(after, arm),
        progress=progress,
        **_kept_clear(arm, surroundings),
        **options,
    )


def recorded_motions(
    recordings: Recordings | Sequence[Motion], robot: Robot
) -> list[Motion]:
    """Motions as they are, and those of recordings as they are identified from."""
    if isinstance(recordings, Sequence) and not isinstance(recordings, str):
        motions = [motion for motion in recordings if isinstance(motion, Motion)]
        if len(motions) == len(recordings):
            return motions
    read = as_recordings(recordings, robot)  # type: ignore[arg-type]
    parts = [part for recording in read for part in prepare(recording)]
    return [part.motion[part.keep] for part in parts]


def check(
    robot: RobotLike,
    trajectory: TrajectoryLike,
    *,
    columns: Columns = "friction",
    surroundings: Surroundings = Surroundings(),
) -> TrajectoryCheck:
    """Limits between samples, clearance and conditioning of any trajectory."""
    arm = within(robot, surroundings)
    motion, path = as_path(trajectory, arm)
    around = scene_around(arm, surroundings)
    asked = information(arm, columns)
    return TrajectoryCheck(arm, motion, path, around, clearance_of(surroundings), asked)


def show(
    robot: RobotLike,
    trajectory: TrajectoryLike,
    *,
    surroundings: Surroundings = Surroundings(),
) -> TrajectoryCheck:
    """The arm in motion, to watch before it runs; `report` makes its page."""
    arm = within(robot, surroundings)
    motion, path = as_path(trajectory, arm)
    least = clearance_of(surroundings)
    around = None
    if not surroundings.ignore_collisions:
        around = scene(arm, obstacles_around(arm, surroundings), least)
    return TrajectoryCheck(arm, motion, path, around, least)


class Simulation(NamedTuple):
    """What a virtual arm recorded of a trajectory."""

    table: pd.DataFrame
    duration: float  # s
    hidden: tuple[HiddenEffect, ...]


def simulate(
    robot: RobotLike,
    trajectory: TrajectoryLike,
    *,
    seed: int = 0,
    hidden: bool = False,
    progress: Callable[[float], None] = lambda share: None,
) -> Simulation:
    """Recording of a virtual arm.

    Args:
        robot: The arm as described.
        trajectory: What it runs.
        seed: Draws noise and what is hidden.
        hidden: Let the arm differ from its model: values off by some per cent, and one effect
            that is not in the model.
        progress: Called with the share done.
    """
    arm = as_robot(robot)
    motion, path = as_path(trajectory, arm)
    duration = float(motion.t[-1])
    rng = np.random.default_rng(seed)
    true = virtual.virtual_arm(
        arm,
        rng,
        hidden=None if hidden else (),
        tolerance=TOLERANCE if hidden else 0.0,
    )
    table = true.record(path, duration, rng, progress)
    return Simulation(table, duration, tuple(true.hidden))


def identify_robot(
    robot: RobotLike,
    recordings: Recordings,
    *,
    validate: Recordings = (),
    effects: Sequence[Effect | str] | None = None,
    cutoff: float | None = None,
    estimator: str = "wls",
    trajectory: Trajectory | str | Path | None = None,
    knowledge: Knowledge | str | Path | None = None,
    length_std: float | Sequence[float] | None = None,
) -> Estimate:
    """Identify a physically consistent model from recordings.

    Faults of recordings are warned of (`FaultWarning`), not repaired.

    Args:
        robot: The arm; its inertias are the prior.
        recordings: What to fit.
        validate: What to judge on; the last 30 % of each recording when empty.
        effects: Effects to estimate, or their names; friction, offset and rotor inertia when None.
        cutoff: Cut-off of the torque filter [Hz]; see `excitant.identify.split`.
        estimator: One of `excitant.identify.estimators.ESTIMATORS`.
        trajectory: Commanded trajectory: without a cut-off the filter passes its highest harmonic.
        knowledge: What is known of the bodies beforehand.
        length_std: Standard deviation of where each joint sits in its parent link [m].

    Errors are those of `excitant.identify.identify_robot`.
    """
    arm = as_robot(robot)
    fit = as_recordings(recordings, arm)
    warn_of_faults(arm, fit)
    if isinstance(knowledge, str | Path):
        knowledge = load_knowledge(knowledge, arm.links)
    return estimation.identify_robot(
        arm,
        fit,
        validate=as_recordings(validate, arm),
        effects=None if effects is None else as_effects(effects, arm),
        cutoff_hz=cutoff,
        estimator=estimator,
        knowledge=knowledge,
        harmonics_hz=None if trajectory is None else highest_harmonic(trajectory, arm),
        length_std=length_std,
    )


def highest_harmonic(trajectory: Trajectory | str | Path, robot: Robot) -> float:
    """Frequency of the highest harmonic of a commanded trajectory [Hz]."""
    planned: Trajectory | Motion = (
        export.load_trajectory(trajectory, robot)
        if isinstance(trajectory, str | Path)
        else trajectory
    )
    if isinstance(planned, Motion):
        raise BadInput(
            f"--trajectory {trajectory} holds samples; give the trajectory.json, which holds "
            "harmonics"
        )
    return planned.harmonics / planned.period


def identify_online(
    robot: RobotLike,
    recordings: Recordings,
    *,
    validate: Recordings = (),
    effects: Sequence[Effect | str] | None = None,
    cutoff: float | None = None,
    forgetting: float | None = None,
    progress: Callable[[float], None] | None = None,
) -> OnlineIdentification:
    """Identify as if samples came one by one.

    Args are those of `identify_robot`, and the time constant of forgetting [s].
    """
    arm = as_robot(robot)
    return online.identify_online(
        arm,
        as_recordings(recordings, arm),
        validate=as_recordings(validate, arm),
        effects=None if effects is None else as_effects(effects, arm),
        cutoff_hz=cutoff,
        forgetting=forgetting,
        progress=progress,
    )


def identify_link_by_link(
    robot: RobotLike,
    recordings: Recordings,
    *,
    validate: Recordings = (),
    effects: Sequence[Effect | str] | None = None,
    cutoff: float | None = None,
) -> LinkByLink:
    """Identify from the last link inward; args are those of `identify_robot`."""
    arm = as_robot(robot)
    return sequential.identify_link_by_link(
        arm,
        as_recordings(recordings, arm),
        validate=as_recordings(validate, arm),
        effects=None if effects is None else as_effects(effects, arm),
        cutoff_hz=cutoff,
    )


def identify_payload(
    robot: RobotLike,
    loaded: Recordings,
    *,
    unloaded: Recordings = (),
    effects: Sequence[Effect | str] | None = None,
    forgetting: float | None = None,
    over_time: bool = False,
) -> PayloadEstimate:
    """Payload of the arm in some recordings; see `excitant.identify.identify_payload`."""
    arm = as_robot(robot)
    return payload.identify_payload(
        arm,
        as_recordings(loaded, arm),
        unloaded=as_recordings(unloaded, arm),
        effects=None if effects is None else as_effects(effects, arm),
        forgetting=forgetting,
        over_time=over_time,
    )


def estimate_shown(
    robot: Robot,
    recordings: Sequence[Recording],
    *,
    validate: Sequence[Recording],
    cutoff: float | None,
    columns: Columns,
    notes: list[str],
) -> Estimate:
    """An estimate even where the recorded motion leaves parameters open, or is brief.

    What is done about brief recordings is noted.
    """
    effects = standard_effects(robot.joints) if columns == "friction" else ()
    short = MINIMUM_DURATION / (1 - FIT_SHARE)
    brief = [r for r in recordings if r.duration < short and not validate]
    notes += [
        f"{r.name} lasts {r.duration:.3g} s, too short to hold a part of it back: all of it is "
        "analysed, and what so few rows say of the noise is rough; record longer"
        for r in brief
    ]
    options: dict[str, Any] = {
        "effects": effects,
        "validate": recordings if brief else validate,
        "cutoff_hz": cutoff,
    }
    try:
        return estimation.identify_robot(robot, recordings, **options)
    except RankDeficient:
        return identify_shown(robot, recordings, **options)


def analyze(
    robot: RobotLike,
    *,
    trajectory: TrajectoryLike | None = None,
    estimate: Estimate | None = None,
    noise: Sequence[float] | None = None,
    moving: Sequence[str] | None = None,
    measured: Sequence[str] | None = None,
    columns: Columns = "friction",
    frames: Literal["joint", "dh"] = "joint",
    window: float | None = None,
) -> Identifiability:
    """Identifiability of every parameter, link by link.

    Args:
        robot: The arm.
        trajectory: How well this motion shows it.
        estimate: Or the recordings of this estimate.
        noise: With a trajectory: torque noise of each joint [N·m]; 1 % of its limit when None.
        moving: Joints that move; all, or as the motion says, when None.
        measured: Joints whose torque is measured; all when None.
        columns: All that is estimated, or the links only.
        frames: Frames that the links' inertias are about; see `excitant.analysis.analyze`.
        window: Length of the windows in which excitation is judged [s]; the whole motion if None.

    Errors are those of `excitant.analysis.analyze`.
    """
    arm = as_robot(robot)
    return identifiability.analyze(
        arm,
        effects=standard_effects(arm.joints) if columns == "friction" else (),
        motion=None if trajectory is None else as_path(trajectory, arm)[0],
        estimate=estimate,
        noise=noise,
        moving=moving,
        measured=measured,
        frames=frames,
        window=window,
        rng=None if estimate is None else np.random.default_rng(0),
    )


def diagnose(
    robot: RobotLike,
    recordings: Recordings,
    *,
    validate: Recordings = (),
    cutoff: float | None = None,
) -> Diagnosis:
    """Errors of the given model, by cause.

    Args:
        robot: The given model: inertias and effects as they are believed to be.
        recordings: Recordings to explain.
        validate: What to judge on; the last 30 % of each recording when empty.
        cutoff: Cut-off of the torque filter [Hz].

    Errors are those of `excitant.analysis.diagnose`.
    """
    arm = as_robot(robot)
    fit = as_recordings(recordings, arm)
    holdout = as_recordings(validate, arm)
    warn_of_faults(arm, fit)
    return diagnosis.diagnose(arm, fit, validate=holdout, cutoff_hz=cutoff)


def go(
    robot: RobotLike,
    recordings: Recordings,
    *,
    validate: Recordings = (),
    cutoff: float | None = None,
    repair: bool = False,
    progress: Callable[[float, str], None] = lambda share, words: None,
) -> Examination:
    """All that recordings say of a model, with one verdict.

    Args:
        robot: The given model.
        recordings: Recordings to fit.
        validate: What to judge on; the last 30 % of each recording when empty.
        cutoff: Cut-off of the torque filter [Hz].
        repair: Repair the faults of the recordings to fit that can be repaired.
        progress: Called with the share of the work that is done, and what is next.

    Errors are those of `identify_robot` and `diagnose`.
    """
    arm = as_robot(robot)
    read = check_recordings(arm, as_recordings(recordings, arm), repaired=repair)
    return examined(
        arm,
        read,
        validate=as_recordings(validate, arm),
        cutoff=cutoff,
        progress=progress,
    )


def examined(
    robot: Robot,
    checked: Checked,
    *,
    validate: Sequence[Recording],
    cutoff: float | None,
    progress: Callable[[float, str], None],
) -> Examination:
    """`go` of recordings whose faults are known."""
    return examine(
        robot,
        checked.recordings,
        validate=validate,
        cutoff_hz=cutoff,
        faults=checked.entries(),
        notes=checked.notes,
        progress=progress,
    )


def rehearse(
    robot: RobotLike,
    trajectory: TrajectoryLike,
    *,
    seed: int = 0,
    surroundings: Surroundings = Surroundings(),
    progress: Callable[[float, str], None] | None = None,
) -> Rehearsal:
    """A motion tried on a virtual arm, up to what it recovers; from rest to rest.

    Args:
        robot: The arm as it is known.
        trajectory: The motion.
        seed: Draws the arm, its noise and the effect to name.
        surroundings: Limits, and what to keep clear of, as in `check`.
        progress: Called with the fraction done and the current step.

    Errors are those of `excitant.analysis.rehearsal.rehearse`.
    """
    arm = within(robot, surroundings)
    motion, path = as_path(trajectory, arm)
    return rehearsal.rehearse(
        arm,
        path,
        float(motion.t[-1]),
        np.random.default_rng(seed),
        progress=progress,
        **_kept_clear(arm, surroundings),
    )
