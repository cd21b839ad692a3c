"""The commands about recordings: go, identify, analyze, diagnose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from os.path import isdir
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from excitant.exceptions import BadInput, RankDeficient, UnknownName
from excitant.options import (
    Columns,
    Data,
    Effects,
    Files,
    Names,
    Numbers,
    Part,
    RobotOrFolder,
    Run,
    Window,
)
from excitant.progress import progress_bar

if TYPE_CHECKING:
    from excitant.identify import Dataset, DriveGains, Estimate, Recording
    from excitant.robots import Robot
    from excitant.robots.effects import Effect


@Parameter(name="*", group="Payload and drive gains")
@dataclass(frozen=True)
class Load:
    """Payload of the arm, known or sought."""

    payload: bool = False
    (
        "Also what the last link carries in these recordings, on top of the model given (an "
        "identified model.yaml knows how sure it is) or --unloaded; over time with --online."
    )
    unloaded: Files = None
    "With --payload: the arm without load, any motion."
    payload_recording: Files = None
    "Drive gains from a known payload, where currents are recorded: the arm with it, any motion."
    payload_mass: float | None = None
    "Its mass [kg]."
    payload_mass_std: float = 0.0
    "Standard deviation of the mass [kg]."
    payload_com: Numbers = None
    "Its centre of mass in the frame of the last joint [m], X,Y,Z."

    def drive(
        self, dataset: Dataset, recordings: Sequence[Recording], options: dict[str, Any]
    ) -> DriveGains | None:
        """Drive gains from recordings with a known payload; None where none is given."""
        if not self.payload_recording or self.payload_mass is None:
            return None
        from excitant.identify import KnownPayload, identify_drive_gains

        payload = KnownPayload(
            self.payload_mass, self.payload_mass_std, self.payload_com
        )
        loaded = dataset.recordings(self.payload_recording)
        return identify_drive_gains(
            dataset.robot, recordings, loaded, payload, **options
        )


def go(
    robot: RobotOrFolder,
    /,
    *recordings: str,
    data: Data = Data(),
    part: Part = Part(),
    run: Run = Run(),
) -> int:
    """All that recordings say of a model, on one page with one verdict.

    The robot as read, faults of the data, the identified model, what can be known, and what is
    wrong with the given model.

    Args:
        recordings: Parquet, CSV, JSON, NPZ, MAT, ROS bag or MCAP, or folders of them; all of the
            folder or bag when none is named.
    """
    from excitant.analysis import examine

    dataset = part.dataset(robot, data.map)
    fit, held, said, notes = data.read(dataset, recordings)
    options: dict[str, Any] = {"validate": held, "cutoff_hz": data.cutoff}
    with progress_bar("go") as advance:
        found = examine(
            dataset.robot,
            fit,
            faults=said["faults"],
            notes=notes,
            progress=advance,
            **options,
        )
    result = found.result() | {"import": said["import"]}
    refusal = "" if found.use else f"use no model of these recordings: {found.refusal}"
    shown = (*found.recommended, "report.html")
    run.finish(result, found.series(), found.files, first=refusal, shown=shown)
    return 0 if found.use else 1


def identify(
    robot: RobotOrFolder,
    /,
    *recordings: str,
    data: Data = Data(),
    effects: Effects = None,
    estimator: str | None = None,
    trajectory: str | None = None,
    knowledge: str | None = None,
    length_std: Numbers = None,
    formats: Names = None,
    mujoco: bool = False,
    force: bool = False,
    online: bool = False,
    link_by_link: bool = False,
    forgetting: float | None = None,
    load: Load = Load(),
    part: Part = Part(),
    run: Run = Run(),
) -> int:
    """From recordings to a physically consistent model.

    Args:
        recordings: Parquet, CSV, JSON, NPZ, MAT, ROS bag or MCAP; all of the folder when none is
            named.
        effects: Effects to estimate, or auto: the standard ones and what the recordings call
            for. Default: viscous_friction,coulomb_friction,torque_offset,rotor_inertia.
        estimator: Of the base parameters: wls (weighted least squares, the default), irls (robust
            against wrong torques), iv or oe (noisy positions).
        trajectory: trajectory.json that the arm was told: without --cutoff, the cut-off is high
            enough for the torque of its harmonics.
        knowledge: YAML with what is known of the bodies: masses, their sum, where centres of mass
            lie.
        length_std: Lengths that are assumed, not measured: standard deviation [m] of where joints
            sit in their links, one for all or one per joint S1,S2,...; default: that of robot.yaml,
            else 0. It widens what is said of parameters and torque.
        formats: Files of the model beside URDF and model.yaml: mjcf, sdf, ros2_control (parameters
            of controllers); default: mjcf,sdf.
        mujoco: Also the torque that the given and the identified model need in MuJoCo, as MJCF,
            for the motion of the hold-out.
        force: Publish the model even if the given one, or none, predicts the hold-out better.
        online: Sample by sample, as in a control loop: estimates over time.
        link_by_link: From the last link inward, each from its own joint's torque.
        forgetting: With --online: time constant of forgetting [s]; default: nothing is forgotten.
    """
    import excitant.identify as identification
    from excitant.identify.estimators import ESTIMATORS
    from excitant.identify.export import FORMATS, USUAL
    from excitant.identify.faults import proven
    from excitant.identify.rows import fitted

    if mujoco:
        import_module("mujoco")  # refused before the work, not after it
    chosen = effects == ["auto"]
    whole: dict[str, Any] = {"estimator": estimator, "knowledge": knowledge}
    whole |= {"trajectory": trajectory, "length-std": length_std}
    _refuse_contradictions(load, chosen, online, link_by_link, forgetting, whole)
    UnknownName.refuse("estimator", [estimator] if estimator else (), ESTIMATORS)
    UnknownName.refuse("format", formats or (), FORMATS)
    dataset = part.dataset(robot, data.map)
    arm = dataset.robot
    named = None if chosen else _named(effects, arm)
    options: dict[str, Any] = {"effects": named, "cutoff_hz": data.cutoff}
    others = [*(load.unloaded or ()), *(load.payload_recording or ())]
    fit, held, said, notes = data.read(dataset, recordings, others)
    drive = load.drive(dataset, fit, options | {"validate": held})
    if drive is not None:
        fit = drive.torque(fit)
        held = drive.torque(held)
    if chosen:
        from excitant.analysis.effect_choice import choose_effects, described

        with progress_bar("effects") as advance:
            options["effects"] = choose_effects(
                arm, fitted(fit, held), cutoff_hz=data.cutoff, progress=advance
            )
        notes += described(options["effects"])
    options["validate"] = held
    with progress_bar("identify") as advance:
        if online:
            options |= {
                "forgetting": forgetting,
                "progress": lambda share: advance(share, ""),
            }
            found: Any = identification.identify_online(arm, fit, **options)
        elif link_by_link:
            found = identification.identify_link_by_link(arm, fit, **options)
        else:
            known = (
                identification.load_knowledge(knowledge, arm.links)
                if knowledge
                else None
            )
            highest = _highest_harmonic(trajectory, arm) if trajectory else None
            options |= {
                "knowledge": known,
                "harmonics_hz": highest,
                "length_std": length_std,
            }
            found = identification.identify_robot(
                arm, fit, **options, estimator=estimator or "wls"
            )
    estimate: Estimate = getattr(found, "estimate", found)
    result = found.result()
    if load.payload:
        unloaded = dataset.recordings(load.unloaded) if load.unloaded else []
        if drive is not None:
            unloaded = drive.torque(unloaded)
        over: dict[str, Any] = {"forgetting": forgetting, "over_time": online}
        carried = identification.identify_payload(
            arm, fit, unloaded=unloaded, effects=named, **over
        )
        result["payload"] = carried.result()
    if arm.length_std and (online or link_by_link or load.payload):
        notes.append(
            "length_std of the robot counts where all rows are fitted at once: not on-line, link "
            "by link, or in a payload"
        )
    result |= said
    series = estimate.series() | found.series()
    if mujoco:
        from excitant.identify.mujoco import side_by_side

        beside = side_by_side(estimate)
        result["mujoco"] = beside.result()
        series |= beside.series()
    published = identification.publication(
        estimate, formats=formats or USUAL, force=force, faults=proven(said["faults"])
    )
    result["notes"] += notes
    published.note_in(result)
    run.finish(result, series, published.files, first=published.note)
    return 0 if published.published else 1


def _refuse_contradictions(
    load: Load, chosen: bool, online: bool, by_link: bool, forgetting: float | None,
    whole: dict[str, Any],
) -> None:  # fmt: skip
    com = load.payload_com
    another = online or by_link
    alone = load.unloaded and not load.payload
    apart = bool(load.payload_recording) != (load.payload_mass is not None)
    refused: list[tuple[object, str]] = [
        (
            chosen and (another or load.payload),
            "--effects auto needs all rows at once and the arm alone; name effects, or leave "
            "--online, --link-by-link and --payload out",
        ),
        (alone, "--unloaded names what --payload is compared with; give --payload too"),
        (apart, "--payload-recording and --payload-mass belong together; give both"),
        (com and len(com) != 3, "--payload-com needs three numbers, X,Y,Z in metres"),
        (
            forgetting is not None and not online,
            "--forgetting is for --online; give --online too",
        ),
        (
            by_link and online,
            "--link-by-link needs whole recordings; leave --online out",
        ),
    ]
    why = "is for all rows at once; leave the other way out"
    refused += [(value and another, f"--{name} {why}") for name, value in whole.items()]
    for wrong, why in refused:
        if wrong:
            raise BadInput(why)


def _highest_harmonic(path: str, robot: Robot) -> float:
    from excitant.design import load_trajectory
    from excitant.robots import Motion

    planned = load_trajectory(path, robot)
    if isinstance(planned, Motion):
        raise BadInput(
            f"--trajectory {path} holds samples; give the trajectory.json, which holds harmonics"
        )
    return planned.harmonics / planned.period


def _named(names: Sequence[str] | None, robot: Robot) -> list[Effect] | None:
    if names is None:
        return None
    from excitant.robots.effects import EFFECTS, Acts

    known = {name: kind for name, kind in EFFECTS.items() if kind.acts_on is Acts.EACH}
    UnknownName.refuse("effect", names, known)
    return [known[name](robot.joints) for name in names]


def analyze(
    robot: RobotOrFolder,
    /,
    *,
    trajectory: str | None = None,
    recording: Files = None,
    data: Data = Data(),
    noise: Numbers = None,
    moving: Names = None,
    measured: Names = None,
    columns: Columns = "friction",
    frames: Literal["joint", "dh"] = "joint",
    window: Window = None,
    part: Part = Part(),
    run: Run = Run(),
) -> None:
    """Identifiability of every parameter, link by link.

    Args:
        trajectory: How well this motion shows it.
        recording: Or these recordings.
        noise: With --trajectory: torque noise of each joint; default: 1 % of its limit.
        moving: Joints that move, J1,J2,...; default: all, or as the motion says.
        measured: Joints whose torque is measured; default: all.
        columns: All that identify estimates, or the links only.
        frames: Frames that the links' inertias are about: their joints', or Denavit-Hartenberg's
            (distal) as in Khosla (1987).
    """
    from excitant.analysis import identifiability
    from excitant.robots.effects import standard_effects

    if trajectory and recording:
        raise BadInput("--trajectory and --recording exclude each other; leave one out")
    dataset = part.dataset(robot, data.map) if recording or isdir(robot) else None
    arm = part.robot(robot) if dataset is None else dataset.robot
    effects = standard_effects(arm.joints) if columns == "friction" else ()
    given: dict[str, Any] = {
        "noise": noise,
        "moving": moving,
        "measured": measured,
        "frames": frames,
    }
    notes = list[str]()
    said = dict[str, Any]()
    if dataset is not None and recording:
        import numpy as np

        fit, held, said, notes = data.read(dataset, recording)
        options = {"effects": effects, "validate": held, "cutoff_hz": data.cutoff}
        given["estimate"] = _as_far_as_shown(arm, fit, options, notes)
        given["rng"] = np.random.default_rng(0)
    elif trajectory:
        from excitant.design import load_trajectory
        from excitant.motions import path_of

        given["motion"], _ = path_of(load_trajectory(trajectory, arm))
    found = identifiability.analyze(arm, effects=effects, **given)
    result = found.result() | said
    result["notes"] += notes
    run.finish(result, found.series())


def _as_far_as_shown(
    robot: Robot,
    recordings: Sequence[Recording],
    options: dict[str, Any],
    notes: list[str],
) -> Estimate:
    """An estimate even where the recorded motion leaves parameters open, or is brief."""
    from excitant.analysis import identify_shown
    from excitant.identify import identify_robot
    from excitant.identify.recording import MINIMUM_DURATION
    from excitant.identify.rows import FIT_SHARE

    short = MINIMUM_DURATION / (1 - FIT_SHARE)
    brief = [r for r in recordings if r.duration < short and not options["validate"]]
    notes += [
        f"{r.name} lasts {r.duration:.3g} s, too short to hold a part of it back: all of it is "
        "analysed, and what so few rows say of the noise is rough; record longer"
        for r in brief
    ]
    options |= {"validate": recordings} if brief else {}
    try:
        return identify_robot(robot, recordings, **options)
    except RankDeficient:
        return identify_shown(robot, recordings, **options)


def diagnose(
    robot: RobotOrFolder,
    /,
    *recordings: str,
    data: Data = Data(),
    experiments: Annotated[bool, Parameter(negative="--no-experiments")] = True,
    experiment_time: float | None = None,
    force: bool = False,
    part: Part = Part(),
    run: Run = Run(),
) -> None:
    """Errors of the given model, by cause.

    Args:
        recordings: Parquet, CSV, JSON, NPZ, MAT, ROS bag or MCAP; all of the folder when none is
            named.
        experiments: Look for motions that would settle what is undecided.
        experiment_time: End that search after this time [s].
        force: Publish the extended model even if the given one, or none, predicts the hold-out
            better.
    """
    import numpy as np

    from excitant.analysis import diagnosis
    from excitant.analysis.discrimination import Plan
    from excitant.analysis.publication import extended_publication
    from excitant.design import trajectory_csv, trajectory_json

    dataset = part.dataset(robot, data.map)
    fit, held, said, notes = data.read(dataset, recordings)
    with progress_bar("diagnose"):
        found = diagnosis.diagnose(
            dataset.robot, fit, validate=held, cutoff_hz=data.cutoff
        )
    plan = Plan()
    if experiments:
        from excitant.analysis.discrimination_plan import plan as planned

        limit = np.inf if experiment_time is None else experiment_time
        plan = planned(found, np.random.default_rng(0), time_limit=limit)
    said["faults"] = found.amended(said["faults"])
    model = extended_publication(found, said["faults"], force=force)
    files = dict(model.files)
    result = found.result(plan) | said
    result["notes"] += notes
    model.note_in(result)
    if experiments and experiment_time is not None:
        result["notes"].append(
            f"experiments: searched for {experiment_time:g} s at most (--experiment-time), so that "
            "those found depend on the machine"
        )
    folder = run.folder(result)
    result["extended"]["files"] = [str(folder / name) for name in files]
    for k, motion in enumerate(plan.motions, start=1):
        files[f"separate-{k}.csv"] = trajectory_csv(motion)
        files[f"separate-{k}.json"] = trajectory_json(motion, dataset.robot)
    run.finish(result, found.series(), files, folder, first=model.note)
