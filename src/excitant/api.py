"""The verbs of every day, which take names, files, tables and arrays as well as nouns.

Here names become nouns, and nowhere else: the packages below take nouns only. The commands call
the same functions. Packages load their modules when these are first used.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from excitant import analysis, design, identify
from excitant.design.options import Columns
from excitant.exceptions import BadInput, RankDeficient, UnknownName
from excitant.progress import Advance
from excitant.robots import Motion, Robot, geometry, load_limits, load_robot
from excitant.robots.effects import EFFECTS, Acts, Effect
from excitant.robots.obstacles_file import load_obstacles
from excitant.surroundings import Surroundings

if TYPE_CHECKING:
    import pandas as pd

    from excitant.analysis import (
        Diagnosis,
        Examination,
        Identifiability,
        Plan,
        Rehearsal,
    )
    from excitant.design import (
        Design,
        HermiteTrajectory,
        LinkByLinkDesign,
        Trajectory,
        TrajectoryCheck,
    )
    from excitant.design.optimal import Progress
    from excitant.identify import (
        ColumnMap,
        Estimate,
        Knowledge,
        LinkByLink,
        OnlineIdentification,
        Parked,
        PayloadEstimate,
        Recording,
    )
    from excitant.robots.chains import RobotSpec
    from excitant.robots.geometry import Obstacle, Scene
    from excitant.robots.virtual_arm import HiddenEffect, VirtualArm

RobotLike: TypeAlias = "Robot | RobotSpec | str | Path"
"""A robot, or what `load_robot` finds one by: its built-in name or a file."""
RecordingLike: TypeAlias = "Recording | pd.DataFrame | str | Path"
"""A recording, a table in memory, or a file."""
Recordings: TypeAlias = "RecordingLike | Sequence[RecordingLike]"
TrajectoryLike: TypeAlias = "Trajectory | Motion | str | Path"
"""A trajectory, samples of one, or a file of either."""
EffectsLike: TypeAlias = "Sequence[Effect | str] | None"
"""Effects or their names; friction, offset and rotor inertia when None."""

SAMPLE_HZ = 100.0  # of a trajectory that has no samples of its own
TOLERANCE = 0.03  # relative, of what a virtual arm hides beside its effect


def as_robot(robot: RobotLike) -> Robot:
    """The robot itself, or the one of a built-in name or a file; see `load_robot`."""
    return robot if isinstance(robot, Robot) else load_robot(robot)


def as_recordings(recordings: Recordings, robot: Robot) -> list[Recording]:
    """Recordings as they are, and those of tables and files; see `load_recording`."""
    sources = _sources(recordings, robot)
    paths = [source for source in sources if isinstance(source, Path)]
    logs = iter(identify.read_recordings(paths, robot))
    nouns: list[Recording] = []
    for k, source in enumerate(sources, start=1):
        if isinstance(source, identify.Recording):
            nouns.append(source)
        elif isinstance(source, Path):
            nouns.append(next(logs))
        else:
            label = f"table {k}"
            nouns.append(
                recording_from_table(source, robot, file=label, name=label)
            )
    return identify.recordings_of(nouns, robot)


def _sources(recordings: Recordings, robot: Robot) -> list[Any]:
    """Recordings, tables and paths of files, those in folders one by one."""
    # recordings and data frames have columns, which tells them without importing pandas
    single = isinstance(recordings, str | Path) or hasattr(recordings, "columns")
    several: Any = [recordings] if single else recordings
    sources = list[Any]()
    for source in several:
        if isinstance(source, str | Path):
            sources += identify.Dataset(robot).paths([str(source)])
        else:
            sources.append(source)
    return sources


def as_recorded(
    robot: RobotLike, recordings: Recordings, others: Recordings = ()
) -> tuple[Parked, list[Recording], list[Recording]]:
    """The robot with the joints held that stand in recordings, these, and others beside them.

    Columns of held joints are left out; see `excitant.identify.parked`.
    """
    arm = as_robot(robot)
    fit, beside = (_sources(some, arm) for some in (recordings, others))
    free = identify.freed_for(arm, [*fit, *beside])
    fitted = as_recordings(fit, free)
    parked = identify.parked(arm, free, fitted)
    return parked, parked.of(fitted), parked.of(as_recordings(beside, free))


def as_path(
    trajectory: TrajectoryLike, robot: Robot
) -> tuple[Motion, Trajectory | HermiteTrajectory]:
    """Samples of a trajectory, at 100 Hz where it has none of its own, and what is between."""
    if isinstance(trajectory, str | Path):
        trajectory = design.load_trajectory(trajectory, robot)
    if isinstance(trajectory, Motion):
        return trajectory, design.HermiteTrajectory(trajectory)
    return trajectory.motion(SAMPLE_HZ), trajectory


def as_effects(effects: EffectsLike, robot: Robot) -> list[Effect] | None:
    """Effects as they are, and those of names, of all joints; None as it is."""
    if effects is None:
        return None
    kinds = {
        name: kind for name, kind in EFFECTS.items() if kind.acts_on is Acts.EACH
    }
    names = [effect for effect in effects if isinstance(effect, str)]
    UnknownName.refuse("effect", names, kinds)
    named = [
        kinds[effect](robot.joints) if isinstance(effect, str) else effect
        for effect in effects
    ]
    held = {joint for joint, _ in robot.locked}
    restricted = [
        effect.among(robot.joints) if held & {*effect.joints} else effect
        for effect in named
    ]
    return [effect for effect in restricted if effect is not None]


def within(robot: RobotLike, surroundings: Surroundings) -> Robot:
    """The robot with the limits, and torque limits that hold as far as masses are uncertain."""
    arm = as_robot(robot)
    if surroundings.limits:
        arm = arm.with_limits(load_limits(surroundings.limits, arm))
    uncertainty = surroundings.mass_uncertainty
    if not 0 <= uncertainty < 100:
        raise BadInput(f"--mass-uncertainty {uncertainty:g}: give 0 to 100 [%]")
    return arm.with_limits(replace(arm.limits, mass_uncertainty=uncertainty / 100))


def obstacles_around(
    robot: Robot, surroundings: Surroundings
) -> tuple[Obstacle, ...]:
    """Obstacles and the floor, if it is known."""
    if surroundings.no_floor and surroundings.floor is not None:
        raise BadInput("--floor and --no-floor exclude each other; leave one out")
    path = surroundings.obstacles
    obstacles = load_obstacles(path) if path else ()
    height = surroundings.floor
    if height is None and not surroundings.no_floor:
        height = geometry.base_plane(robot)
    return obstacles if height is None else (*obstacles, geometry.floor(height))


def clearance_of(surroundings: Surroundings) -> float:
    """Least distance to keep [m]."""
    least = surroundings.clearance
    return geometry.CLEARANCE if least is None else least


def scene_around(robot: Robot, surroundings: Surroundings) -> Scene | None:
    """Scene to keep clear of, if any."""
    if surroundings.ignore_collisions:
        return None
    obstacles = obstacles_around(robot, surroundings)
    return geometry.scene(robot, obstacles, clearance_of(surroundings))


def required_scene(robot: Robot, surroundings: Surroundings) -> Scene | None:
    """Scene to keep clear of, if any.

    Raises:
        BadInput: Clearance is asked for, but the arm has no shapes.
    """
    around = scene_around(robot, surroundings)
    options = (surroundings.obstacles, surroundings.floor, surroundings.clearance)
    if around is None and any(option is not None for option in options):
        why = geometry.unchecked(robot, None)
        raise BadInput(
            f"{robot.source}: clearance cannot be checked ({why}); give "
            "its URDF <collision> elements whose meshes are there, or leave --obstacles, "
            "--floor and --clearance out"
        )
    return around


def _kept_clear(robot: Robot, surroundings: Surroundings) -> dict[str, Any]:
    return {
        "scene": required_scene(robot, surroundings) or (),
        "clearance": clearance_of(surroundings),
    }


def load_recording(
    path: str | Path, robot: RobotLike | int, *, mapping: ColumnMap | None = None
) -> Recording:
    """Recording of a robot, or of a number of joints; see `identify.reading.logs`."""
    return identify.load_recording(path, _or_count(robot), mapping=mapping)


def recording_from_table(
    table: Any,
    robot: RobotLike | int,
    *,
    file: str,
    name: str,
    mapping: ColumnMap | None = None,
) -> Recording:
    """Recording from a table in memory; see `identify.reading.logs`."""
    return identify.recording_from_table(
        table, _or_count(robot), file=file, name=name, mapping=mapping
    )


def _or_count(robot: RobotLike | int) -> Robot | int:
    return robot if isinstance(robot, int) else as_robot(robot)


def load_trajectory(path: str | Path, robot: RobotLike) -> Trajectory | Motion:
    """Trajectory from a file of coefficients (JSON) or of samples (CSV)."""
    return design.load_trajectory(path, as_robot(robot))


def random_trajectory(
    robot: RobotLike, rng: np.random.Generator, duration: float, harmonics: int
) -> Trajectory:
    """A random motion within all limits; see `excitant.design.random_trajectory`."""
    return design.random_trajectory(as_robot(robot), rng, duration, harmonics)


def virtual_arm(
    robot: RobotLike,
    rng: np.random.Generator,
    *,
    hidden: Sequence[HiddenEffect] | None = None,
    **options: Any,
) -> VirtualArm:
    """An arm that differs from its description; see `excitant.robots.virtual_arm`."""
    from excitant.robots import virtual_arm as virtual

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
    return design.design_trajectory(
        arm,
        noise=noise,
        after=recorded_motions(after, arm),
        progress=progress,
        **_kept_clear(arm, surroundings),
        **options,
    )


def design_link_by_link(
    robot: RobotLike,
    *,
    surroundings: Surroundings = Surroundings(),
    progress: Callable[[float, str, float], None] | None = None,
    **options: Any,
) -> LinkByLinkDesign:
    """One motion per link, from the last inward; args are those of `design_trajectory`."""
    arm = within(robot, surroundings)
    return design.design_link_by_link(
        arm, progress=progress, **_kept_clear(arm, surroundings), **options
    )


def recorded_motions(
    recordings: Recordings | Sequence[Motion], robot: Robot
) -> list[Motion]:
    """Motions as they are, and those of recordings as they are identified from."""
    if isinstance(recordings, Sequence) and not isinstance(recordings, str):
        motions = [motion for motion in recordings if isinstance(motion, Motion)]
        if len(motions) == len(recordings):
            return motions
    logs = as_recordings(recordings, robot)  # type: ignore[arg-type]
    for log in logs:
        identify.refuse_positions_beyond(robot, log)
    parts = [part for recording in logs for part in identify.prepare(recording)]
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
    around = required_scene(arm, surroundings)
    asked = design.information(arm, columns)
    least = clearance_of(surroundings)
    return design.TrajectoryCheck(arm, path, around, motion, least, asked)


def show(
    robot: RobotLike,
    trajectory: TrajectoryLike,
    *,
    surroundings: Surroundings = Surroundings(),
) -> TrajectoryCheck:
    """The arm in motion, to watch before it runs; `report` makes its page."""
    arm = within(robot, surroundings)
    motion, path = as_path(trajectory, arm)
    around = scene_around(arm, surroundings)
    return design.TrajectoryCheck(
        arm, path, around, motion, clearance_of(surroundings)
    )


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
    nothing = {"hidden": (), "tolerance": 0.0}
    differs = {"tolerance": TOLERANCE} if hidden else nothing
    true = virtual_arm(arm, rng, **differs)
    table = true.record(path, duration, rng, progress)
    return Simulation(table, duration, tuple(true.hidden))


def identify_robot(
    robot: RobotLike,
    recordings: Recordings,
    *,
    validate: Recordings = (),
    effects: EffectsLike | Literal["auto"] = None,
    cutoff: float | None = None,
    estimator: str | None = None,
    trajectory: Trajectory | str | Path | None = None,
    knowledge: Knowledge | str | Path | None = None,
    progress: Advance = lambda share, words: None,
) -> Estimate:
    """Identify a physically consistent model from recordings.

    Faults of recordings are warned of (`FaultWarning`), not repaired.

    Args:
        robot: The arm; its inertias are the prior.
        recordings: What to fit.
        validate: What to judge on; the last 30 % of each recording when empty.
        effects: Effects to estimate, or their names; friction, offset and rotor inertia when None;
            ``"auto"`` for these and what the recordings call for.
        cutoff: Cut-off of the torque filter [Hz]; see `excitant.identify.split`.
        estimator: One of `excitant.identify.estimators.ESTIMATORS`; when None weighted least
            squares, on smoothed positions where the recordings show coarse ones, or robust
            regression where they show gross errors of torque, which a note tells.
        trajectory: Commanded trajectory: without a cut-off the filter passes its highest harmonic.
        knowledge: What is known of the bodies beforehand.
        progress: Called while effects are chosen.

    Errors are those of `excitant.identify.identify_robot`.
    """
    parked, fit, holdout = as_recorded(robot, recordings, validate)
    arm = parked.robot
    identify.warn_of_faults(arm, fit)
    automatic = effects == "auto"
    if automatic:
        effects = analysis.choose_effects(
            arm, identify.fitted(fit, holdout), cutoff_hz=cutoff, progress=progress
        )
    if isinstance(knowledge, str | Path):
        knowledge = identify.load_knowledge(knowledge, arm.links)
    estimate = identify.identify_robot(
        arm,
        fit,
        validate=holdout,
        effects=as_effects(effects, arm),
        cutoff_hz=cutoff,
        estimator=estimator,
        knowledge=knowledge,
        harmonics_hz=None
        if trajectory is None
        else highest_harmonic(trajectory, arm),
        turning=automatic or None,
    )
    return replace(estimate, notes=(*parked.notes, *estimate.notes))


def highest_harmonic(trajectory: Trajectory | str | Path, robot: Robot) -> float:
    """Frequency of the highest harmonic of a commanded trajectory [Hz]."""
    planned = (
        design.load_trajectory(trajectory, robot)
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
    effects: EffectsLike = None,
    cutoff: float | None = None,
    forgetting: float | None = None,
    progress: Callable[[float], None] | None = None,
) -> OnlineIdentification:
    """Identify as if samples came one by one.

    Args are those of `identify_robot`, and the time constant of forgetting [s].
    """
    parked, fit, holdout = as_recorded(robot, recordings, validate)
    arm = parked.robot
    return identify.identify_online(
        arm,
        fit,
        validate=holdout,
        effects=as_effects(effects, arm),
        cutoff_hz=cutoff,
        forgetting=forgetting,
        progress=progress,
    )


def identify_link_by_link(
    robot: RobotLike,
    recordings: Recordings,
    *,
    validate: Recordings = (),
    effects: EffectsLike = None,
    cutoff: float | None = None,
) -> LinkByLink:
    """Identify from the last link inward; args are those of `identify_robot`."""
    parked, fit, holdout = as_recorded(robot, recordings, validate)
    arm = parked.robot
    return identify.identify_link_by_link(
        arm,
        fit,
        validate=holdout,
        effects=as_effects(effects, arm),
        cutoff_hz=cutoff,
    )


def identify_payload(
    robot: RobotLike,
    loaded: Recordings,
    *,
    unloaded: Recordings = (),
    effects: EffectsLike = None,
    forgetting: float | None = None,
    over_time: bool = False,
) -> PayloadEstimate:
    """Payload of the arm in some recordings; see `excitant.identify.identify_payload`."""
    parked, with_load, without = as_recorded(robot, loaded, unloaded)
    arm = parked.robot
    return identify.identify_payload(
        arm,
        with_load,
        unloaded=without,
        effects=as_effects(effects, arm),
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
) -> tuple[Estimate, list[str]]:
    """An estimate even where the recorded motion leaves parameters open, or is brief.

    The notes say what is done about brief recordings.
    """
    short = identify.MINIMUM_DURATION / (1 - identify.FIT_SHARE)
    brief = [r for r in recordings if r.duration < short and not validate]
    notes = [
        f"{r.name} lasts {r.duration:.3g} s, too short to hold a part of it back: all of it is "
        "analysed, and what so few rows say of the noise is rough; record longer"
        for r in brief
    ]
    options: dict[str, Any] = {
        "effects": None if columns == "friction" else (),
        "validate": recordings if brief else validate,
        "cutoff_hz": cutoff,
    }
    try:
        return identify.identify_robot(robot, recordings, **options), notes
    except RankDeficient:
        return analysis.identify_shown(robot, recordings, **options), notes


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

    Errors are those of `excitant.analysis.analyze`.
    """
    arm = as_robot(robot)
    return analysis.analyze(
        arm,
        effects=design.estimated_effects(arm, columns),
        motion=None if trajectory is None else as_path(trajectory, arm)[0],
        estimate=estimate,
        noise=noise,
        moving=moving,
        measured=measured,
        frames=frames,
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
    parked, fit, holdout = as_recorded(robot, recordings, validate)
    arm = parked.robot
    identify.warn_of_faults(arm, fit)
    diagnosis = analysis.diagnose(arm, fit, validate=holdout, cutoff_hz=cutoff)
    return replace(diagnosis, notes=(*parked.notes, *diagnosis.notes))


def experiments(diagnosis: Diagnosis, *, time_limit: float | None = None) -> Plan:
    """Motions and actions that decide what a diagnosis leaves undecided.

    The search ends after a time limit [s], where there is one.
    """
    limit = np.inf if time_limit is None else time_limit
    return analysis.plan(diagnosis, np.random.default_rng(0), time_limit=limit)


def go(
    robot: RobotLike,
    recordings: Recordings,
    *,
    validate: Recordings = (),
    cutoff: float | None = None,
    repair: bool = False,
    progress: Advance = lambda share, words: None,
) -> Examination:
    """All that recordings say of a model, with one verdict.

    Args:
        robot: The given model.
        recordings: Recordings to fit.
        validate: What to judge on; the last 30 % of each recording when empty.
        cutoff: Cut-off of the torque filter [Hz].
        repair: Repair the faults of the recordings that can be repaired.
        progress: Called with the share of the work that is done, and what is next.

    Errors are those of `identify_robot` and `diagnose`.
    """
    parked, fit, holdout = as_recorded(robot, recordings, validate)
    arm = parked.robot
    checked = identify.check_recordings(arm, fit, repaired=repair)
    held = identify.check_recordings(
        arm, holdout, repaired=repair, known=checked.of_the_arm
    )
    notes = (*parked.notes, *checked.notes, *held.notes)
    return analysis.examine(
        arm,
        checked.recordings,
        validate=held.recordings,
        cutoff_hz=cutoff,
        faults=[*checked.entries(), *held.entries()],
        notes=notes,
        progress=progress,
    )


def rehearse(
    robot: RobotLike,
    trajectory: TrajectoryLike,
    *,
    seed: int = 0,
    surroundings: Surroundings = Surroundings(),
    progress: Advance | None = None,
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
    return analysis.rehearse(
        arm,
        path,
        float(motion.t[-1]),
        np.random.default_rng(seed),
        progress=progress,
        **_kept_clear(arm, surroundings),
    )
