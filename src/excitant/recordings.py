"""The commands about recordings: go, identify, analyze, diagnose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from os.path import isdir
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

import excitant as ex
from excitant.design.options import Columns
from excitant.exceptions import BadInput, UnknownName
from excitant.options import (
    Data,
    Effects,
    Files,
    Names,
    Numbers,
    Part,
    RobotOrFolder,
    Run,
)
from excitant.progress import progress_bar

if TYPE_CHECKING:
    from excitant.identify import (
        DriveGains,
        PayloadEstimate,
        Recording,
    )
    from excitant.options import Readings
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
        self,
        read: Readings,
        recordings: Sequence[Recording],
        options: dict[str, Any],
    ) -> DriveGains | None:
        """Drive gains from recordings with a known payload; None where none is given."""
        if not self.payload_recording or self.payload_mass is None:
            return None
        payload = ex.identify.KnownPayload(
            self.payload_mass, self.payload_mass_std, self.payload_com
        )
        loaded = read.others(self.payload_recording)
        return ex.identify.identify_drive_gains(
            read.robot, recordings, loaded, payload, **options
        )

    def carried(
        self,
        read: Readings,
        recordings: Sequence[Recording],
        drive: DriveGains | None,
        effects: Sequence[Effect] | None,
        fit: Fit,
    ) -> PayloadEstimate:
        """The payload of these recordings."""
        unloaded = read.others(self.unloaded) if self.unloaded else []
        if drive is not None:
            unloaded = drive.torque(unloaded)
        return ex.identify_payload(
            read.robot,
            recordings,
            unloaded=unloaded,
            effects=effects,
            forgetting=fit.forgetting,
            over_time=fit.online,
        )


@Parameter(name="*")
@dataclass(frozen=True)
class Fit:
    """What is estimated, and how."""

    effects: Effects = None
    (
        "Effects to estimate, or auto: the standard ones and what the recordings call for. "
        "Default: viscous_friction,coulomb_friction,torque_offset,rotor_inertia."
    )
    estimator: str | None = None
    (
        "Of the base parameters: wls (weighted least squares), irls (robust against wrong "
        "torques), iv or smooth (noisy positions). Default: wls; irls where bursts spoil the "
        "torque, smooth where encoders are coarse beside the motion, as the recordings show."
    )
    trajectory: str | None = None
    "Commanded trajectory.json: without --cutoff the filter passes its highest harmonic."
    knowledge: str | None = None
    "YAML with what is known of the bodies: masses, their sum, where centres of mass lie."
    online: bool = False
    "Sample by sample, as in a control loop: estimates over time."
    link_by_link: bool = False
    "From the last link inward, each from its own joint's torque."
    forgetting: float | None = None
    "With --online: time constant of forgetting [s]; default: nothing is forgotten."

    @property
    def automatic(self) -> bool:
        """Whether effects are chosen from the recordings."""
        return self.effects == ["auto"]

    @property
    def by_parts(self) -> bool:
        """Whether rows are not fitted all at once."""
        return self.online or self.link_by_link

    def require(self, load: Load) -> None:
        """Refuse options that contradict each other."""
        com = load.payload_com
        refused = [
            (
                self.automatic and (self.by_parts or load.payload),
                "--effects auto needs all rows at once and the arm alone; name effects, or "
                "leave --online, --link-by-link and --payload out",
            ),
            (
                load.unloaded and not load.payload,
                "--unloaded names what --payload is compared with; give --payload too",
            ),
            (
                bool(load.payload_recording) != (load.payload_mass is not None),
                "--payload-recording and --payload-mass belong together; give both",
            ),
            (
                com and len(com) != 3,
                "--payload-com needs three numbers, X,Y,Z in metres",
            ),
            (
                self.forgetting is not None and not self.online,
                "--forgetting is for --online; give --online too",
            ),
            (
                self.link_by_link and self.online,
                "--link-by-link needs whole recordings; leave --online out",
            ),
        ]
        for name in ("estimator", "knowledge", "trajectory"):
            why = "is for all rows at once; leave the other way out"
            refused.append(
                (getattr(self, name) and self.by_parts, f"--{name} {why}")
            )
        for wrong, why in refused:
            if wrong:
                raise BadInput(why)
        UnknownName.refuse(
            "estimator",
            [self.estimator] if self.estimator else (),
            ex.identify.ESTIMATORS,
        )

    def identified(
        self,
        robot: ex.Robot,
        recordings: Sequence[Recording],
        options: dict[str, Any],
    ) -> Any:
        """The estimate, on-line or link by link where that is asked for."""
        with progress_bar("identify") as advance:
            if self.online:
                return ex.identify_online(
                    robot,
                    recordings,
                    forgetting=self.forgetting,
                    progress=lambda share: advance(share, ""),
                    **options,
                )
            if self.link_by_link:
                return ex.identify_link_by_link(robot, recordings, **options)
            return ex.identify_robot(
                robot,
                recordings,
                estimator=self.estimator,
                trajectory=self.trajectory,
                knowledge=self.knowledge,
                progress=advance,
                **options,
            )


@Parameter(name="*")
@dataclass(frozen=True)
class Model:
    """Files of the model."""

    formats: Names = None
    (
        "Files of the model beside URDF and model.yaml: mjcf, sdf, ros2_control (parameters of "
        "controllers); default: mjcf,sdf."
    )
    mujoco: bool = False
    (
        "Also the torque that the given and the identified model need in MuJoCo, as MJCF, for the "
        "motion of the hold-out."
    )
    force: bool = False
    "Publish the model even if the given one, or none, predicts the hold-out better."

    def require(self) -> None:
        """Refuse what cannot be written, before the work and not after it."""
        if self.mujoco:
            import_module("mujoco")
        UnknownName.refuse("format", self.formats or (), ex.identify.FORMATS)


def go(
    robot: RobotOrFolder,
    /,
    *recordings: str,
    data: Data = Data(),
    part: Part = Part(),
    run: Run = Run(),
) -> int:
    """All that recordings say of a model, on one page with one verdict.

    The robot as read, faults of the data, the identified model, what can be known,
    and what is wrong with the given model.

    Args:
        recordings: Parquet, CSV, JSON, NPZ, MAT, ROS bag or MCAP, or folders of them; all of the
            folder or bag when none is named.
    """
    read = data.read(part.dataset(robot, data.map), recordings)
    with progress_bar("go") as advance, read.blamed():
        examined = ex.analysis.examine(
            read.robot,
            read.fit,
            validate=read.holdout,
            cutoff_hz=data.cutoff,
            faults=read.entries["faults"],
            notes=read.notes,
            progress=advance,
        )
    use = examined.use
    run.finish(
        examined.result() | {"import": read.entries["import"]},
        examined.series(),
        examined.files,
        first=(
            examined.estimate.undetermined,
            "" if use else f"use no model of these recordings: {examined.refusal}",
        ),
        shown=(*examined.recommended, "report.html"),
    )
    return 0 if use else 1


def identify(
    robot: RobotOrFolder,
    /,
    *recordings: str,
    data: Data = Data(),
    fit: Fit = Fit(),
    model: Model = Model(),
    load: Load = Load(),
    part: Part = Part(),
    run: Run = Run(),
) -> int:
    """From recordings to a physically consistent model.

    Args:
        recordings: Parquet, CSV, JSON, NPZ, MAT, ROS bag or MCAP; all of the folder when none is
            named.
    """
    fit.require(load)
    model.require()
    others = [*(load.unloaded or ()), *(load.payload_recording or ())]
    read = data.read(part.dataset(robot, data.map), recordings, others)
    return identify_readings(read, run, data.cutoff, fit, model, load)


def identify_readings(
    read: Readings,
    run: Run,
    cutoff: float | None = None,
    fit: Fit = Fit(),
    model: Model = Model(),
    load: Load = Load(),
) -> int:
    """The command `identify`, of recordings that are read."""
    arm = read.robot
    notes = list(read.notes)
    named = None if fit.automatic else ex.api.as_effects(fit.effects, arm)
    options: dict[str, Any] = {"effects": named, "cutoff": cutoff}
    train = read.fit
    holdout = read.holdout
    drive = load.drive(
        read,
        train,
        {"validate": holdout, "cutoff_hz": cutoff, "effects": named},
    )
    if drive is not None:
        train = drive.torque(train)
        holdout = drive.torque(holdout)
    if fit.automatic:
        options["effects"] = "auto"
    with read.blamed():
        identified = fit.identified(arm, train, options | {"validate": holdout})
    estimate: ex.Estimate = getattr(identified, "estimate", identified)
    if fit.automatic:
        notes += ex.analysis.described(estimate.model.effects)
    result = identified.result()
    if load.payload:
        carried = load.carried(read, train, drive, named, fit)
        result["payload"] = carried.result()
    result |= read.entries
    series = estimate.series() | identified.series()
    published = ex.identify.publication(
        estimate,
        formats=model.formats or ex.identify.USUAL,
        force=model.force,
        faults=ex.identify.proven(read.entries["faults"]),
    )
    if model.mujoco:
        beside = ex.identify.side_by_side(estimate, published.arm("mjcf"))
        result["mujoco"] = beside.result()
        series |= beside.series()
    result["notes"] += notes
    published.note_in(result)
    run.finish(
        result,
        series,
        published.files,
        first=(estimate.undetermined, published.note),
    )
    return 0 if published.published else 1


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
    if trajectory and recording:
        raise BadInput(
            "--trajectory and --recording exclude each other; leave one out"
        )
    estimate = None
    notes = list[str]()
    entries = dict[str, Any]()
    if recording:
        read = data.read(part.dataset(robot, data.map), recording, held=False)
        arm = read.robot
        entries = read.entries
        estimate, brief = ex.api.estimate_shown(
            arm,
            read.fit,
            validate=read.holdout,
            cutoff=data.cutoff,
            columns=columns,
        )
        notes = [*read.notes, *brief]
    elif isdir(robot):
        arm = part.dataset(robot, data.map).robot
    else:
        arm = part.robot(robot)
    identifiability = ex.analyze(
        arm,
        trajectory=trajectory,
        estimate=estimate,
        noise=noise,
        moving=moving,
        measured=measured,
        columns=columns,
        frames=frames,
    )
    result = identifiability.result() | entries
    result["notes"] += notes
    first = "" if estimate is None else estimate.undetermined
    run.finish(result, identifiability.series(), first=(first,))


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
) -> int:
    """Errors of the given model, by cause.

    Args:
        recordings: Parquet, CSV, JSON, NPZ, MAT, ROS bag or MCAP; all of the folder when none is
            named.
        experiments: Look for motions that would settle what is undecided.
        experiment_time: End that search after this time [s].
        force: Publish the extended model even if the given one, or none, predicts the hold-out
            better.
    """
    read = data.read(part.dataset(robot, data.map), recordings)
    return diagnose_readings(
        read,
        run,
        data.cutoff,
        experiments=experiments,
        experiment_time=experiment_time,
        force=force,
    )


def diagnose_readings(
    read: Readings,
    run: Run,
    cutoff: float | None = None,
    *,
    experiments: bool,
    experiment_time: float | None = None,
    force: bool = False,
) -> int:
    """The command `diagnose`, of recordings that are read."""
    entries = read.entries
    with progress_bar("diagnose"), read.blamed():
        diagnosis = ex.diagnose(
            read.robot, read.fit, validate=read.holdout, cutoff=cutoff
        )
    plan = ex.analysis.Plan()
    notes = list(read.notes)
    if experiments:
        plan = ex.experiments(diagnosis, time_limit=experiment_time)
        if experiment_time is not None:
            notes.append(
                f"experiments: searched for {experiment_time:g} s at most (--experiment-time), so "
                "that those found depend on the machine"
            )
    entries["faults"] = ex.analysis.with_repairs(diagnosis, entries["faults"])
    model = ex.analysis.extended_publication(
        diagnosis, entries["faults"], force=force
    )
    files = dict(model.files)
    result = diagnosis.result(plan) | entries
    folder = run.folder(result)
    result["extended"]["files"] = [str(folder / name) for name in files]
    result["notes"] += notes
    model.note_in(result)
    for k, motion in enumerate(plan.motions, start=1):
        files[f"separate-{k}.csv"] = ex.design.trajectory_csv(motion)
        files[f"separate-{k}.json"] = ex.design.trajectory_json(motion, read.robot)
    run.finish(
        result,
        diagnosis.series(),
        files,
        folder,
        first=(diagnosis.undetermined, model.note),
    )
    return 0 if model.published else 1
