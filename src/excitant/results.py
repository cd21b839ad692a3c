"""What each verb reports: the records of ``result.json``, and its reference.

A file holds one record, that of its ``verb``. Units are SI unless a field says otherwise: torque
in N·m (N at sliding joints), or in A where ``unit`` says that a drive gain is not known; angles
in rad, inertias about the joint frame. A number that is not known is null; a field with the
default null may be missing. Files are paths as printed.
"""

from collections.abc import Mapping
from datetime import date
from typing import Any, Literal, TypeAlias

import msgspec

Number: TypeAlias = float | None
"""A number, or null where it is not known or not finite."""
Three: TypeAlias = tuple[float, float, float]
"""Coordinates in the base frame."""
Category: TypeAlias = Literal["unique", "combined", "unidentifiable"]
Decider: TypeAlias = Literal["data", "both", "prior", "expectation"]


class Record(msgspec.Struct, forbid_unknown_fields=True, omit_defaults=True):
    """Base of all records: only the fields that are declared."""


# --- shared


class Run(Record, kw_only=True):
    """What the records of all verbs about an arm have."""

    robot: str
    "Name of the arm."
    files: list[str] = []
    "Files written."


class Accuracy(Record):
    """Error of one joint's torque, measured and predicted torque filtered alike."""

    rms: Number
    "Root mean square of measured minus predicted torque [N·m or A]."
    rms_raw: Number
    "The same with the measured torque unfiltered."
    nrmse: Number
    "rms over the standard deviation of the measured torque."
    r2: Number
    "1 − nrmse²."
    rms_all: Number
    "rms over all rows, those of rest included, where dry friction holds any torque."
    judged: Number
    "Share of the rows at which the joint moves, and errors count."


class JointAccuracy(Accuracy):
    """`Accuracy` of a joint by name."""

    name: str
    "Joint."


class Interval(Record):
    """95 % interval of the predicted torque."""

    half_width: Number
    "Mean half width [N·m or A]."
    half_width_parameters: Number
    "Share of it that the uncertainty of parameters makes."
    coverage: Number
    "Share of the hold-out's rows that lie within."


class HoldoutAccuracy(Accuracy):
    """`Accuracy` on the hold-out, with the interval of the prediction."""

    interval95: Interval | None = None
    "95 % interval of the predicted torque."


class Fault(Record):
    """A fault of a recording."""

    recording: str
    "Name of the recording."
    fault: str
    "Name of the fault, such as ``wrong_unit``."
    joints: list[str]
    "Joints concerned; empty where all are."
    detail: str
    "What was seen, in one sentence."
    evidence: dict[str, Any]
    "Figures behind it: channel, rows, factor, ..."
    repair: str | None = None
    "What --repair does about it; null where it can do nothing."
    map: str | None = None
    "The same as entries of a file for --map; null where none can state it."
    repaired: bool = False
    "Whether that was done."


class ExportedFile(Record):
    """A model file and its own error, with only what its format holds."""

    file: str
    "Name of the file."
    written: bool
    "False where it would predict the hold-out worse than the nominal model."
    nrmse: list[Number]
    "nrmse per joint on the hold-out."
    rms: list[Number]
    "rms per joint on the hold-out [N·m or A]."
    lacks: list[str]
    "Effects of the model that the format cannot hold, in words."
    refitted: bool
    "True where the file's friction, or bodies too, are fitted to make up for these."


class Extreme(Record):
    """Worst use of one limit."""

    joint: str
    "Joint that comes closest to its limit."
    t: float
    "When [s]."
    ratio: float
    "Share of the limit; at most 1 where it holds."


class Certified(Record):
    """Range of one joint over the continuous motion."""

    low: float
    "Smallest value."
    high: float
    "Largest value."
    ratio: float
    "Share of the limit."
    t: float
    "When it comes closest to it [s]."


class Closest(Record):
    """The two bodies that come closest."""

    bodies: list[str]
    "Their names."
    t: float
    "When [s]."
    distance_m: float
    "Distance [m]."


class Pair(Record):
    """A figure before and after."""

    initial: Number
    "Of the first feasible motion."
    final: Number
    "Of the motion designed."
    lower_bound: Number = None
    "Lower bound for any motion within the limits, with --bound."


class Persistency(Record):
    """Persistency of excitation over a motion."""

    level: Number
    "Least excitation level."
    shown: int
    "Number of base parameters that it shows."
    visible: int
    "Number of them that a motion can show."
    missing: int
    "Number of these that it does not show."
    joints: list[str]
    "Joints whose motion is lacking."
    sentence: str
    "The above in words."


# --- motions


class JointFrame(Record):
    """Where a joint sits in the chain that is drawn."""

    parent: int
    "Number of the joint before it; 0 for the base."
    place: list[float]
    "Pose in its frame at zero: x, y, z [m] and the quaternion x, y, z, w."
    axis: list[float]
    "Axis in its own frame."
    slides: bool
    "Whether it is prismatic."


class Tool(Record):
    """Where the tool sits."""

    joint: int
    "Number of the joint that carries it."
    place: list[float]
    "Pose in its frame."


class Shape(Record):
    """A body that is drawn."""

    joint: int
    "Number of the joint that carries it; 0 for the base."
    place: list[float]
    "Pose in its frame."
    kind: str
    "Box, sphere, cylinder, capsule or mesh."
    size: list[float] | None = None
    "Dimensions [m]."
    mesh: int | None = None
    "Number of the mesh in series.npz."


class Appearance(Record):
    """The arm as it is drawn."""

    joints: list[JointFrame]
    "Joints in the order of the model."
    tool: Tool
    "The tool."
    shapes: list[Shape]
    "Bodies."
    notes: list[str]
    "What could not be drawn."


class Box(Record, tag_field="shape", tag="box"):
    """A box in the cell."""

    name: str
    "Its name."
    size: Three
    "Edges [m]."
    position: Three
    "Centre [m]."
    rpy: Three = (0.0, 0.0, 0.0)
    "Roll, pitch and yaw [rad]."


class Sphere(Record, tag_field="shape", tag="sphere"):
    """A sphere in the cell."""

    name: str
    "Its name."
    radius: float
    "Radius [m]."
    position: Three
    "Centre [m]."


class HalfSpace(Record, tag_field="shape", tag="half_space"):
    """All points x with n·x ≤ offset, such as the floor."""

    name: str
    "Its name."
    normal: Three
    "Normal n."
    offset: float
    "Offset [m]."


class Workspace(Record, tag_field="shape", tag="workspace"):
    """The axis-aligned box that the tool stays in."""

    name: str
    "Its name."
    low: Three
    "Lower corner [m]."
    high: Three
    "Upper corner [m]."


Obstacle: TypeAlias = Box | Sphere | HalfSpace | Workspace
"""An obstacle by its ``shape``."""


class Motion(Run, kw_only=True):
    """What is certified of a motion over continuous time, and what is needed to draw it."""

    joints: list[str]
    "Names of the joints."
    revolute: list[bool]
    "Whether each joint turns."
    duration: float
    "Length of the motion [s]."
    limits: dict[str, Number]
    "Worst use of each limit, as a share of it."
    worst: dict[str, Extreme | None]
    "Joint and instant of it."
    unchecked: str
    "What was not checked, and why; empty where all was."
    clearance_m: Number
    "Least distance between bodies that is certified [m]; null without geometry."
    appearance: Appearance
    "The arm as it is drawn."
    bodies: list[list[str]]
    "Pairs of bodies whose distance is checked."
    limit_values: dict[str, list[Any] | None] | None = None
    "Limits by quantity; null where there is none."
    certified: dict[str, list[Certified | None]] | None = None
    "Range of each joint by quantity."
    closest: Closest | None = None
    "Bodies that come closest."
    obstacles: list[Obstacle] = []
    "Obstacles, as in an obstacle file."


class WeakParameter(Record):
    """A base parameter that makes little torque of its own."""

    name: str
    "Standard parameter that leads it."
    expression: str
    "The combination."
    unit: str
    "Its unit."
    value: float
    "Value in the nominal model."
    std_per_unit_noise_initial: float
    "Standard deviation for torque noise of 1, of the first motion."
    std_per_unit_noise_final: float
    "The same of the motion designed."


class Start(Record):
    """A search from one start."""

    start: int
    "Its number."
    parent: int | None
    "The search that it builds upon; null for a random start."
    condition_number: Number
    "Condition number reached."
    status: str
    "Why it ended."
    iterations: int
    "Convex steps taken."


class FirstRun(Record):
    """The slow first run."""

    speed: float
    "Share of the speed."
    duration: float
    "Its length [s]."
    limit: float
    "Largest use of a limit."


class DesignStage(Record):
    """The motion for one link of a design link by link."""

    link: str
    "Link that it is for."
    joint: str
    "Joint whose equation it serves."
    file: str
    "File of the motion."
    moves: list[str]
    "Joints that move."
    duration: float
    "Length [s]."
    periods: int
    "Equal periods of it."
    harmonics: int
    "Harmonics of a period."
    base_parameters: int
    "Number of base parameters that it makes visible."
    condition_number: Pair
    "Condition number of their columns, unscaled."
    condition_number_scaled: Pair
    "The same with columns scaled to unit length."
    limits: dict[str, Number]
    "Worst use of each limit, as a share of it."
    weakest: list[WeakParameter]
    "Base parameters that make least torque of their own."
    clearance_m: Number
    "Least distance between bodies that is certified [m]."
    iterations: int
    "Convex steps of all searches."


class DesignStages(Record):
    """A design link by link."""

    stages: list[DesignStage]
    "One motion per link, the last link first."


class Design(Motion, tag_field="verb", tag="design"):
    """``excitant design``: an excitation trajectory."""

    harmonics: int
    "Harmonics of a period."
    columns: str
    "What is made visible: ``friction`` (all that identify estimates) or ``inertial``."
    base_parameters: int
    "Number of base parameters."
    criterion: str
    "What is minimised: ``condition``, ``d``, ``a`` or ``e``."
    condition_number: Pair
    "Condition number of the base columns, unscaled."
    starts: list[Start]
    "Searches."
    iterations: int
    "Convex steps of all searches."
    wall_s: float
    "Time taken [s]."
    limit_use: float
    "Share of the limits on velocity, acceleration, jerk and torque that may be used."
    notes: list[str]
    "Remarks."
    periods: int | None = None
    "Equal periods of the motion."
    condition_number_scaled: Pair | None = None
    "The same with columns scaled to unit length."
    joint_weights: list[float] = []
    "Weights of the joints' equations."
    weakest: list[WeakParameter] = []
    "Base parameters that make least torque of their own."
    repeat: int = 1
    "Periods in trajectory.csv."
    first_run: FirstRun | None = None
    "The slow first run."
    link_by_link: DesignStages | None = None
    "With --link-by-link: the motions."


class Checked(Motion, kw_only=True):
    """A trajectory from a file, and whether it keeps the limits."""

    holds: bool
    "Whether all limits hold and bodies keep clear."
    verdicts: list[str]
    "What does not hold, in words."
    trajectory: str | None = None
    "File of the trajectory."


class Check(Checked, tag_field="verb", tag="check"):
    """``excitant check``: limits, clearance and conditioning of any trajectory."""

    columns: str | None = None
    "What the condition number is of."
    condition_number: Number = None
    "Condition number of the base columns, unscaled."
    persistency: Persistency | None = None
    "Persistency of excitation."


class Show(Checked, tag_field="verb", tag="show"):
    """``excitant show``: a motion in 3D."""


class Hidden(Record):
    """What a virtual arm hides from its model."""

    effect: str
    "Effect."
    joint: str
    "Joint."
    parameters: dict[str, float]
    "Sizes in SI units."


class Simulate(Run, tag_field="verb", tag="simulate"):
    """``excitant simulate``: a recording of a virtual arm."""

    samples: int
    "Rows of the recording."
    duration: float
    "Its length [s]."
    hidden: list[Hidden]
    "What the arm hides."


# --- identification


class FrictionNoise(Record):
    """Units of a joint's friction curve in series.npz."""

    unit: str
    "Unit of the torque."
    velocity_unit: str
    "Unit of the velocity."
    per_reading: Number
    "Standard deviation of a single measurement of friction."


class IdentifiedJoint(Record):
    """Errors of the identified model at one joint."""

    name: str
    "Joint."
    train: Accuracy
    "On the recordings that were fitted."
    validate: HoldoutAccuracy
    "On the hold-out."
    baseline: Accuracy
    "Of the nominal model, on the hold-out."
    friction: FrictionNoise | None = None
    "Units of the friction curve."


class BodyMass(Record):
    """Mass of a link."""

    given: Number
    "Nominal [kg]."
    value: Number
    "Identified [kg]."
    decided_by: Decider
    "Whether the data, the prior or both decide the value."


class BodyCentre(Record):
    """Centre of mass of a link."""

    given: list[Number]
    "Nominal [m]."
    value: list[Number]
    "Identified [m]."
    shift: Number
    "Distance between them [m]."
    decided_by: Decider
    "Whether the data, the prior or both decide the value."


class Body(Record):
    """Mass and centre of mass of a link."""

    link: str
    "Link."
    mass: BodyMass
    "Mass."
    centre: BodyCentre
    "Centre of mass in the joint frame."
    moved: str | None
    "How much they differ from the nominal ones, where that is much."


class Parameter(Record):
    """A standard parameter or a coefficient of an effect."""

    name: str
    "Name, such as ``link3.mcx``."
    link: str
    "Link or joint."
    value: Number
    "Identified value."
    std: Number
    "Standard deviation; null where torque does not determine the parameter alone, or determines "
    "a value that physics does not allow."
    unit: str
    "Unit."
    category: Category
    "Whether torque determines it alone, in combinations or not at all."
    given: Number
    "Nominal value; null for an effect that the nominal model lacks."
    prior: Number
    "Prior mean; null where there is no prior."
    prior_dominated: bool
    "Whether the prior decides the value."
    decided_by: Decider
    "Whether the data, the prior or both decide it."


class Determined(Record):
    """An estimate of a combination of parameters."""

    expression: str
    "Combination of standard parameters."
    value: Number
    "Estimate."
    std: Number
    "Standard deviation."


class BaseParameter(Determined):
    """A base parameter; null where it rests on a drive gain that is not known."""

    link: str
    "Link or joint that it is written with."
    coefficients: dict[str, float]
    "The combination with all digits, by the names of its parameters."
    rel_std: Number
    "Standard deviation over the value."
    spread: Number
    "Standard deviation by what several recordings say apart; null of a single one."


class Repeat(Record):
    """Agreement of one of several recordings with all of them."""

    recording: str
    "Recording."
    deviation: Number
    "By how many standard errors its estimates are off, rms; about 1 by noise."


class Physical(Record):
    """Physical consistency of the identified bodies."""

    consistent: bool
    "Whether every link has positive mass and a possible inertia."
    violations: list[str]
    "What is not."


class RefinedShape(Record):
    """A shape parameter of an effect."""

    effect: str
    "Effect."
    joint: str
    "Joint."
    field: str
    "Shape parameter."
    unit: str
    "Unit."
    given: Number
    "Value before."
    value: Number
    "Value after."
    std: Number
    "Standard deviation."


class Shapes(Record):
    """Shapes of effects, refined with bodies and coefficients."""

    refined: bool
    "Whether they were changed."
    effects: list[RefinedShape]
    "Shape parameters."


class Reversal(Record):
    """Dry friction of a joint that turns over a range of speeds, F_c tanh(q̇ / v)."""

    joint: str
    "Joint."
    speed: Number
    "Speed v below which it turns."
    std: Number
    "Standard deviation of v; null where it is not determined to half of v."
    unit: str
    "Unit of the speed."


class Stage(Record):
    """One link of an identification link by link."""

    link: str
    "Link."
    joint: str
    "Joint whose equation is used."
    rows: int
    "Rows of data."
    noise: Number
    "Standard deviation of its torque noise [N·m or A]."
    inflation: Number
    "Integrated autocorrelation time of the noise [rows]."
    recordings: list[str]
    "Recordings used."
    determined: list[Determined]
    "What the equation determined."
    missing: list[str]
    "What it leaves open."


class LinkByLink(Record):
    """Identification link by link."""

    stages: list[Stage]
    "Links, the last one first."
    determined: int
    "Number of base parameters determined."
    base_parameters: int
    "Number of base parameters."


class Message(Record):
    """A message at an instant."""

    t: float
    "When [s]."
    text: str
    "What."


class History(Record):
    """Base parameters over time."""

    t: list[float]
    "Instants [s]."
    excitation_level: list[Number]
    "Excitation level of the last window."


class Online(Record):
    """Identification on line."""

    delay_s: float
    "Age of the newest instant that can be estimated [s]."
    differentiator: str
    "Which was used, and why."
    messages: list[Message]
    "What the monitor reported."
    converged: bool
    "Whether the estimates have settled."
    history: History
    "Estimates over time."


class Quantity(Record, kw_only=True):
    """A value with its standard deviation."""

    name: str = ""
    "What it is."
    value: Any
    "Value, or list of values."
    std: Any
    "Standard deviation."
    unit: str
    "Unit."


class PayloadParameter(Record):
    """An inertial parameter of the payload."""

    name: str
    "m, mcx, ..., Izz about the frame of the last joint."
    value: Number
    "Estimate."
    std: Number
    "Standard deviation."
    unit: str
    "Unit."
    prior_dominated: bool
    "Whether the prior decides it."


class Centre(Record):
    """A point with its standard deviations."""

    value: list[float]
    "x, y, z."
    std: list[float]
    "Standard deviations of x, y, z."
    unit: str
    "Unit."


class PayloadHistory(Record):
    """Mass and centre of mass over time."""

    t: list[float]
    "Instants [s]."
    mass: list[Number]
    "Mass [kg]."
    mass_std: list[Number]
    "Its standard deviation [kg]."
    centre: list[list[Number]]
    "Centre of mass [m]."
    centre_std: list[list[Number]]
    "Its standard deviations [m]."


class Payload(Record):
    """The payload on the last link."""

    link: str
    "Link that carries it."
    mass: Quantity
    "Mass."
    centre_of_mass: Centre
    "Centre of mass in the joint frame."
    parameters: list[PayloadParameter]
    "Inertial parameters."
    shortcomings: list[str]
    "What the motion does not show."
    notes: list[str]
    "Remarks."
    history: PayloadHistory | None = None
    "Mass and centre of mass over time, with --online."


class MujocoJoint(Record):
    """Errors of one joint in MuJoCo."""

    name: str
    "Joint."
    given: Accuracy | None
    "Of the nominal model."
    identified: Accuracy
    "Of the identified model."
    differs: Number
    "rms difference to the torque of excitant over the measured torque's standard deviation."


class Mujoco(Record):
    """Nominal and identified model in MuJoCo on the hold-out."""

    version: str
    "Version of MuJoCo."
    joints: list[MujocoJoint]
    "Errors."
    notes: list[str]
    "Remarks."


class Imported(Run, kw_only=True, rename={"imported": "import"}):
    """What the records of verbs on recordings have."""

    notes: list[str]
    "Remarks."
    imported: dict[str, list[str]] = {}
    "What was assumed in reading each recording."


class RecordingDifference(Record):
    """What one recording has otherwise than those that are fitted beside it."""

    recording: str
    "Its name."
    effect: str
    "What differs, by the name of an effect."
    joints: list[str]
    "Where."
    sizes: list[Quantity]
    "By how much."
    left: float
    "Part of the squared error that is left with that."
    rivals: list[tuple[str, list[str]]] = []
    "Effects and joints that would do as well."


class Modelled(Imported, kw_only=True):
    """What the records of verbs that make a model have."""

    cutoff_hz: Number
    "Cut-off of the torque filter [Hz]."
    unit: str
    "Unit of torque."
    holdout: str
    "What models are judged on, in words."
    drive_gain_Nm_per_A: list[Number] | None  # noqa: N815
    "Drive gains [N·m/A], null at joints where they are not known; null where torque was given."
    drive_gain_std_Nm_per_A: list[Number] | None = None  # noqa: N815
    "Standard deviations of the drive gains, null likewise."
    drive_gain_scale_rel_std: Number = None
    "Relative standard deviation of the scale that all gains share."
    published: bool | None = None
    "Whether the model was written."
    refusal: str = ""
    "Why not."
    exported: list[ExportedFile] = []
    "Errors of each model file."
    differences: list[RecordingDifference] = []
    "What single recordings have otherwise; a diagnosis takes it off."


class Identify(Modelled, tag_field="verb", tag="identify"):
    """``excitant identify``: a physically consistent model from recordings."""

    estimator: str
    "How base parameters and bodies were estimated."
    effects: list[str]
    "Effects of the model."
    joints: list[IdentifiedJoint]
    "Errors by joint."
    links: list[Body]
    "Masses and centres of mass."
    parameters: list[Parameter]
    "All parameters; from poses those that gravity and offsets have."
    base_parameters: list[BaseParameter]
    "Base parameters."
    physical: Physical
    "Physical consistency."
    knowledge: dict[str, Any]
    "What --knowledge states."
    repeats: list[Repeat] = []
    "Whether several recordings agree."
    reversals: list[Reversal] = []
    "Joints whose dry friction turns over a range of speeds."
    shapes: Shapes | None = None
    "Shapes of effects that were refined."
    link_by_link: LinkByLink | None = None
    "With --link-by-link."
    online: Online | None = None
    "With --online."
    payload: Payload | None = None
    "With --payload."
    mujoco: Mujoco | None = None
    "With --mujoco."
    faults: list[Fault] | None = None
    "Faults of the recordings; null where none was looked for."


# --- identifiability


class Combined(Record):
    """A combination that torque determines."""

    expression: str
    "The combination."
    members: list[str]
    "Parameters in it."


class ParameterIdentifiability(Record):
    """Identifiability of one parameter."""

    name: str
    "Parameter."
    unit: str
    "Unit."
    category: Category
    "Whether torque determines it alone, in combinations or not at all."
    value: Number = None
    "Value."
    std: Number = None
    "Standard deviation from this motion; null where torque does not determine it alone."
    rel_std: Number = None
    "The same over the value."
    std_data: Number = None
    "Standard deviation without the prior."
    prior: Number = None
    "Prior mean."
    prior_dominated: bool = False
    "Whether the prior decides it."
    margin: Number = None
    "Distance of the decision on its category from the threshold."
    verdict: str | None = None
    "How well this motion shows it."
    prior_influence: Number = None
    "Change of the value with the prior, relative."
    decided_by: Decider | None = None
    "Whether the data, the prior or both decide it."
    expression: str | None = None
    "The combination that holds it."
    needed: str | None = None
    "What would be needed to see it."


class LinkIdentifiability(Record):
    """Identifiability of one link."""

    link: str
    "Link."
    joint: str
    "Joint that moves it."
    unique: list[str]
    "Parameters that torque determines alone."
    unidentifiable: list[str]
    "Parameters that no torque contains."
    combined: list[Combined]
    "Combinations with members of this link."
    parameters: list[ParameterIdentifiability]
    "All parameters of the link and its joint."


class Practical(Record):
    """A base parameter under the motion."""

    name: str
    "Combination."
    value: Number
    "Value."
    std: Number
    "Standard deviation."
    rel_std: Number
    "The same over the value."
    verdict: str
    "How well this motion shows it."
    needed: str | None = None
    "What would be needed to see it."


class NotShown(Record):
    """A base parameter that the motion does not show."""

    name: str
    "Combination."
    needed: str | None
    "What would be needed to see it."


class Structure(Record):
    """What the structural analysis rests on."""

    circumstances: list[str]
    "What it holds for: gravity, installation, joints that move."
    close: list[str]
    "Parameters whose category is close to another."
    marginal: str | None
    "Decisions that lie near the threshold, in words."
    frames: str | None = None
    "``dh`` where links were described in Denavit-Hartenberg frames."
    singular_values: list[Number] = []
    "Singular values of the columns of all parameters."
    singular_vectors: list[str] = []
    "Right singular vectors by their largest members."


class Analyze(Imported, tag_field="verb", tag="analyze"):
    """``excitant analyze``: identifiability of every parameter."""

    standard_parameters: int
    "Number of parameters."
    base_parameters: int
    "Number of base parameters."
    gap: list[Number]
    "Smallest singular value that counts and largest that does not, relative."
    structure: Structure
    "Circumstances of the structural analysis, its frames and decomposition."
    links: list[LinkIdentifiability]
    "Link by link."
    condition_number: Number
    "Condition number of the base columns under the motion, unscaled."
    practical: list[Practical]
    "Base parameters under the motion."
    basis: str
    "Where the standard deviations come from."
    noise: list[Number] = []
    "Torque noise of each measured joint [N·m]."
    resting_joints: list[str] = []
    "Joints that do not move."
    not_shown: list[NotShown] = []
    "Base parameters that the motion does not show."
    persistency: Persistency | None = None
    "Persistency of excitation."
    faults: list[Fault] = []
    "Faults of the recordings."


# --- diagnosis


class FoundParameter(Record):
    """Size of a cause."""

    name: str
    "Coefficient."
    value: Number
    "Estimate."
    std: Number = None
    "Standard deviation; null of an undecided cause, which may be absent."
    given: Number = None
    "Nominal value."
    unit: str = ""
    "Unit."


class RmsChange(Record):
    """Error on the hold-out."""

    rms_before: Number
    "Without the cause [N·m or A]."
    rms_after: Number
    "With it."


class Rival(Record):
    """Another cause that the recordings do not exclude."""

    effect: str
    "Effect."
    joints: list[str]
    "Joints."
    why: str
    "What speaks for it."
    experiment: str
    "Experiment that decides."
    separation: Number = None
    "Expected separation by that experiment, in standard deviations."
    repetitions: int | None = None
    "How often it must run."
    file: str | None = None
    "File of the motion."


class Part(Record, kw_only=True):
    """One kind of a cause that has several."""

    effect: str
    "Effect."
    joints: list[str]
    "Joints."
    sentence: str
    "Cause and size in words."
    parameters: list[FoundParameter]
    "Coefficients."
    explained: Number
    "Share of the nominal model's squared error that it removes, at most all of it."
    by_joint: dict[str, Number] = {}
    "Rms of its torque on the hold-out at each joint; of ``unknown``, of what is left there."
    holdout: RmsChange
    "Error on the hold-out without it and with it."
    unit: str
    "Unit of these."
    verdict: Literal["named", "undecided", "unknown"]
    "Whether it is named as a cause; ``unknown`` where no cause explains what is left."
    doubt: str = ""
    "Why it is undecided."
    experiment: str = ""
    "Of an undecided one: the experiment that decides, or why none is looked for."
    rivals: list[Rival]
    "Other causes that the recordings do not exclude."
    sizes: list[Quantity] = []
    "Sizes that do not depend on the phase, such as an amplitude."


class Axes(Record):
    """Axes of the figure of a finding."""

    x_label: str
    "Horizontal axis."
    y_label: str
    "Vertical axis."
    joint: str
    "Joint."


class Finding(Part, kw_only=True):
    """A cause of the mismatch, in order of importance."""

    parts: list[Part] = []
    "Its kinds, where it has several (friction)."
    figure: Axes | None = None
    "Axes of its figure; data are in series.npz."
    share: Number = None
    "Of ``unknown``: share of the squared error that is left."
    structure: str | None = None
    "Of ``unknown``: the variable that explains most of it."


class Unexplained(Record):
    """What is left at one joint."""

    joint: str
    "Joint."
    share: Number
    "Share of the measured torque's variance."
    against_noise: str
    "Comparison of both in words."
    structure: str
    "The variable that explains most of it, in words."


class JointResidual(Record):
    """Structure of the error of a joint."""

    name: str
    "Joint."
    rms: Number
    "Root mean square [N·m or A]."
    shares: dict[str, Number]
    "Share of it that each variable explains."
    telling: str
    "The above in words."


class ErrorStructure(Record):
    """Structure of the nominal model's error."""

    joints: list[JointResidual]
    "By joint."


class Simulation(Record):
    """Errors of the nominal model on the hold-out."""

    joints: list[JointAccuracy]
    "By joint."


class Extended(Simulation):
    """Errors of the extended model on the hold-out."""

    files: list[str] = []
    "Its files."


class Diagnose(Modelled, tag_field="verb", tag="diagnose"):
    """``excitant diagnose``: what the nominal model gets wrong, by cause."""

    headline: str
    "Main cause."
    simulation: Simulation
    "Errors of the nominal model."
    faults: list[Fault]
    "Faults of the recordings."
    findings: list[Finding]
    "Causes in order of importance."
    corrected: list[FoundParameter]
    "Given values within their tolerance that the data correct beyond chance."
    unexplained: list[Unexplained]
    "What is left at each joint."
    extended: Extended
    "Errors of the extended model."
    error: ErrorStructure
    "Structure of the nominal model's error."


# --- robots, examinations, fleets, comparisons


class RobotJoint(Record):
    """A joint as read."""

    name: str
    "Joint."
    link: str
    "Link that it moves."
    kind: Literal["revolute", "prismatic"]
    "Kind."
    position: list[Number]
    "Lower and upper limit [rad or m]."
    velocity: Number
    "Limit [rad/s or m/s]."
    acceleration: Number
    "Limit [rad/s² or m/s²]."
    torque: Number
    "Limit [N·m or N]."
    gravity_torque: Number
    "Largest torque that gravity needs [N·m or N]."
    mass: Number
    "Mass of the link [kg]."


class RobotLink(Record):
    """A body as described."""

    link: str
    "Link."
    moves_with: str | None
    "Link that carries it, where it has no joint of its own."
    mass: Number
    "Mass [kg]."
    com: list[Number]
    "Centre of mass [m]."
    principal_moments: list[Number]
    "Principal moments of inertia [kg·m²]."
    radius_of_gyration: Number
    "Largest radius of gyration [m]."
    size: Number
    "Extent of its shapes [m]."


class ModelWarning(Record):
    """Something that looks wrong in the description."""

    check: str
    "Which check says so."
    where: list[str]
    "Links or joints concerned."
    sentence: str
    "What was found and what to do."
    hint: bool
    "Whether it may well be right."


class EffectValue(Record):
    """A coefficient of an effect of the description."""

    effect: str
    "Effect."
    name: str
    "Coefficient."
    value: Number
    "Value."
    unit: str
    "Unit."


class Robots(Run, tag_field="verb", tag="robots"):
    """``excitant robots NAME``: one arm as read, and what looks wrong in it."""

    name: str
    "The same."
    mass: Number
    "Mass of the moving links [kg]."
    total_mass: Number
    "Mass of all links [kg]."
    stated_mass: Number
    "Mass given by --mass [kg]."
    gravity: list[float]
    "Acceleration of gravity in the base frame [m/s²]."
    base_parameters: int
    "Number of base parameters."
    effects: list[str]
    "Effects of the description."
    effect_values: list[EffectValue]
    "Their coefficients."
    warnings: list[ModelWarning]
    "What looks wrong."
    joints: list[RobotJoint]
    "Joints."
    links: list[RobotLink]
    "Bodies."
    locked: dict[str, float]
    "Positions of joints that are held [rad or m]."
    parameters: dict[str, Number]
    "Standard parameters by name."
    notes: list[str]
    "Remarks on reading."
    appearance: Appearance
    "The arm as it is drawn."
    kind: str | None = None
    "Kind of a built-in arm."
    sources: Any = None
    "Where its values come from."


class Verdict(Record):
    """The verdict of an examination."""

    sentences: list[str]
    "In words."
    use: Literal["given", "identified", "extended"] | None
    "Model to use; null where none may be."
    files: list[str]
    "Its files."
    refused: list[str]
    "Why models were not written."
    next: str
    "What to do where something is open."
    effect: str | None
    "Main cause."
    joints: list[str]
    "Its joints."
    verdict: str | None
    "Whether it is named or undecided."
    truth: Literal["named", "undecided", "missed"] | None = None
    "Of a demonstration: what became of the hidden effect."
    correct: bool | None = None
    "Whether it was named."


class Examination(Imported, kw_only=True):
    """An arm examined by all commands, and the verdict."""

    verdict: Verdict
    "Verdict."
    robots: Robots
    "The arm as read."
    identify: Identify
    "The identified model."
    analyze: Analyze
    "What the recordings can show."
    diagnose: Diagnose
    "What the nominal model gets wrong."


class Go(Examination, tag_field="verb", tag="go"):
    """``excitant go``: a recording to a verdict."""


class Demo(Examination, tag_field="verb", tag="demo"):
    """``excitant demo``: the main job on a virtual arm."""

    seed: int
    "Seed of what is hidden."
    truth: Hidden
    "What is hidden."
    design: Design
    "The excitation trajectory."


class Requirement(Record):
    """A requirement of a rehearsal."""

    name: str
    "Requirement."
    joint: str
    "Joint."
    passed: bool
    "Whether it is met."
    detail: str
    "What was seen."
    advice: str
    "What to do where it is not."
    planted: Number
    "Value of the virtual arm."
    recovered: Number
    "Value that was identified."
    std: Number
    "Its standard deviation."
    unit: str
    "Unit."


class Rehearse(Run, tag_field="verb", tag="rehearse"):
    """``excitant rehearse``: a motion tried on a virtual arm."""

    joints: list[str]
    "Names of the joints."
    duration: float
    "Length of the motion [s]."
    passed: bool
    "Whether all requirements are met."
    headline: str
    "The verdict in words."
    items: list[Requirement]
    "Requirements."
    advice: list[str]
    "What to do."
    effect: Hidden
    "Effect to name."
    limit_values: dict[str, list[Any] | None]
    "Limits by quantity."
    trajectory: str | None = None
    "File of the trajectory."
    seed: int | None = None
    "Seed of the arm."


class DataSet(Record):
    """One data set of a fleet."""

    name: str
    "Name."
    arm: str
    "Arm."
    date: str | None
    "Date."
    type: str | None
    "Type of arm."
    failed: str | None
    "Why it could not be examined."
    found: list[str]
    "Main findings and faults."


class Deviation(Record):
    """A parameter by which an arm differs from the others of its type."""

    arm: str
    "Arm."
    parameter: str
    "Parameter."
    unit: str
    "Unit."
    value: float
    "Of the arm."
    std: float
    "Its standard deviation."
    siblings: float
    "Mean of the other arms."
    spread: float
    "Their standard deviation."
    difference: float
    "Of the arm from that mean."
    difference_std: float
    "Its standard deviation."
    count: int
    "Number of the other arms."
    ratio: float
    "Difference over what chance allows."


class Difference(Record):
    """A parameter that is not the same for all arms of a type, and none of them is odd."""

    parameter: str
    "Parameter."
    unit: str
    "Unit."
    low: str
    "Arm furthest below the mean of all, in its standard deviations."
    low_value: float
    "Its value."
    high: str
    "Arm furthest above it, likewise."
    high_value: float
    "Its value."
    difference: float
    "Between both."
    std: float
    "Its standard deviation."
    count: int
    "Number of arms."
    chance: float
    "Probability, in a fleet of equal arms, of values as far apart."


class Drift(Record):
    """A parameter that changes with time."""

    arm: str
    "Arm."
    parameter: str
    "Parameter."
    unit: str
    "Unit."
    per_year: float
    "Slope [unit per year]."
    std: float
    "Its standard deviation."
    first: date
    "Date of the first data set."
    last: date
    "Date of the last one."
    before: float
    "Value of the line at the first date."
    after: float
    "Value at the last one."
    count: int
    "Number of data sets."
    chance: float
    "Probability, in a fleet without any change, of one as clear."


class Fleet(Record, tag_field="verb", tag="fleet"):
    """``excitant fleet``: many arms at many dates."""

    of: str
    "How many data sets."
    arms: int
    "Number of arms."
    types: list[str]
    "Types of arms."
    data_sets: list[DataSet]
    "Data sets."
    deviations: list[Deviation]
    "Arms that differ."
    differences: list[Difference]
    "What is not the same for all arms, though none of them is odd; the clearest first."
    drifts: list[Drift]
    "What changes."
    notes: list[str]
    "Remarks."
    files: list[str] = []
    "Files written."


class ComparedRun(Record):
    """A run that is compared."""

    name: str
    "Name."
    folder: str
    "Folder."
    leads: list[str]
    "Its main results in words."


class ComparedFigure(Record):
    """A figure of all runs."""

    section: str
    "Section of the page."
    part: str
    "Part of it."
    of: str
    "What the rows of its table are."
    name: str
    "Row."
    figure: str
    "Quantity."
    written: list[str]
    "As written on the pages."
    values: list[Number]
    "Values."
    deviations: list[Number]
    "Differences to the first run in their standard deviations; null of what is no estimate."


class Compare(Run, tag_field="verb", tag="compare"):
    """``excitant report A B ...``: runs side by side."""

    of: str
    "Verb of the runs; ``robot`` has the names of their arms."
    runs: list[ComparedRun]
    "Runs, A first."
    remarks: list[str]
    "What makes them hard to compare."
    figures: list[ComparedFigure]
    "Figures."


Result: TypeAlias = (
    Robots
    | Design
    | Check
    | Show
    | Simulate
    | Identify
    | Analyze
    | Diagnose
    | Go
    | Demo
    | Rehearse
    | Fleet
    | Compare
)
"""The record of any verb."""


def verb_of(record: Record) -> str:
    """The verb of a result."""
    return str(record.__struct_config__.tag)


def plain_of(record: Record) -> dict[str, Any]:
    """Plain values of a record, without fields that have their defaults."""
    return msgspec.to_builtins(record)


def record_of(result: Mapping[str, Any]) -> Result:
    """The record of plain values, as they are read from JSON.

    Raises:
        msgspec.ValidationError: An unknown verb, or a field that is missing, unknown or of another
            type; names its path.
    """
    return msgspec.convert(result, Result)
