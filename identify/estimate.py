"""`identify`: from recordings to a physically consistent model, judged on a hold-out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
import scipy

from excitant.exceptions import BadInput, BadRecording, UnknownName
from excitant.files import write_file
from excitant.identify.dataset import RecordingLike, Recordings, as_recordings
from excitant.identify.drive_gains import DriveGains
from excitant.identify.estimators import ESTIMATORS, estimated
from excitant.identify.faults import warn_of_faults
from excitant.identify.friction import (
    FrictionCurve,
    curves_over_velocity,
    friction_curve,
)
from excitant.identify.knowledge import Knowledge
from excitant.identify.least_squares import (
    LeastSquares,
    autocorrelation,
    autocorrelation_time,
    essential_parameters,
    weighted_least_squares,
)
from excitant.identify.lengths import LengthErrors, length_deviations, length_errors
from excitant.identify.physical import PhysicalFit, centre_of_mass, fit_physical
from excitant.identify.preprocessing import Mask, prepare
from excitant.identify.prior import decided_by, prior_parameters
from excitant.identify.regression import regression_of
from excitant.identify.rows import (
    Accuracy,
    Data,
    FitRows,
    Series,
    fit_rows,
    fitted,
    gains_of,
    identified_robot,
    predicted_torque,
    series,
    split,
    states,
    told,
)
from excitant.identify.shapes import Shapes, refined_shapes
from excitant.robots.base_estimate import BaseEstimate, is_covariance
from excitant.robots.base_parameters import BaseParameters, base_parameters, categories
from excitant.robots.effects import Effect, effect_values, plain, standard_effects
from excitant.robots.loading import RobotLike, as_robot
from excitant.robots.motion import Array, read_only
from excitant.robots.parameters import UNITS, inertia, violations
from excitant.robots.regressor import rigid_body_torque
from excitant.robots.robot import Robot
from excitant.robots.shown import Shown, Table, data_frame, share
from excitant.robots.threads import on_one_thread
from excitant.robots.torque import torque

if TYPE_CHECKING:
    import pandas as pd

    from excitant.identify.export import Publication
    from excitant.identify.recording import Recording

LEVEL = 0.95
_FEWEST = 3.0  # degrees of freedom, below which no noise is known
_MOST = 0.5  # of the residual's variance that is given back
_FAR = 0.02
_CERTAIN = 2.0  # share of samples and standard deviations that chance is allowed
_HALF = 0.5  # of a mass or a length: so large a change is named
_SLIGHT = 0.01  # m: a smaller one is not
_BY = ("data", "both", "prior")
_WHO = {
    "data": "by the data",
    "both": "between data and prior",
    "prior": "as shared out by the prior",
}
# standard errors by which columns at a lower rate may move a base parameter
_MOVED = 0.01
_ROUNDS = 2  # until the torque that columns hold is that of the identified arm


@dataclass(frozen=True, eq=False)
class BodyChange:
    """Mass and centre of mass of a link, of the prior and identified, in its joint's frame."""

    link: str
    given_mass: float  # [kg]
    mass: float  # [kg]
    mass_std: float  # [kg]
    mass_by: str  # data, prior or both
    given_centre: Array  # shape (3,) [m]
    centre: Array  # shape (3,) [m]
    centre_std: Array  # shape (3,) [m]
    centre_by: str
    length: float  # from its joint to the next or to its given centre of mass, the longer [m]

    @property
    def shift(self) -> tuple[float, float]:
        """How far the centre of mass moved, and its standard deviation along that way [m]."""
        way = self.centre - self.given_centre
        size = float(np.linalg.norm(way))
        return size, float(np.linalg.norm(self.centre_std * way) / max(size, 1e-300))

    @property
    def moved(self) -> str:
        """What moved by half of the given mass or of the link's length, in words; empty if not."""
        said = []
        (size, std) = self.shift
        if abs(self.mass - self.given_mass) >= _HALF * self.given_mass:
            said.append(
                f"mass {self.given_mass:.3g} → {self.mass:.3g} ± {self.mass_std:.2g} kg "
                f"({_WHO[self.mass_by]})"
            )
        if size >= max(_HALF * self.length, _SLIGHT):
            said.append(
                f"centre of mass by {1e3 * size:.3g} ± {1e3 * std:.2g} mm ({_WHO[self.centre_by]})"
            )
        return f"{self.link}: {' and '.join(said)}" if said else ""

    def entry(self) -> dict[str, Any]:
        """Its entry in ``result.json``."""
        mass = {"given": self.given_mass, "value": self.mass, "std": self.mass_std}
        centre = {
            "given": self.given_centre,
            "value": self.centre,
            "std": self.centre_std,
        }
        lists = {name: values.tolist() for name, values in centre.items()}
        lists |= dict(zip(("shift", "shift_std"), self.shift, strict=True))
        return {
            "link": self.link,
            "mass": mass | {"decided_by": self.mass_by},
            "centre": lists | {"decided_by": self.centre_by},
            "moved": self.moved or None,
        }


@dataclass(frozen=True, eq=False, repr=False)
class Estimate(Shown):
    """Result of an identification.

    Attributes:
        given: The robot as given.
        model: The identified robot: physically consistent inertias, effects with values, and its
            base parameters with their covariance.
        base: Base parameters of links and effects together.
        least_squares: Estimate of the base parameters.
        physical: Physically consistent fit of all parameters.
        std: Standard deviations of all parameters in the units in which they are told, those of
            drive gains included.
        base_std: The same of the base parameters.
        data: What was fitted and held out.
        notes: What the user should know, as sentences.
        drive: Drive gains, if torque was recorded as current.
        estimator: How the base parameters were estimated, in words.
        knowledge: What was taken for known of the bodies.
        shapes: Shapes of effects, refined where that fits better; None where there are none.
        lengths: Errors of lengths that are counted; None where lengths are taken to be right.
    """

    given: Robot
    model: Robot
    base: BaseParameters
    least_squares: LeastSquares
    physical: PhysicalFit
    std: Array
    base_std: Array
    data: Data
    notes: tuple[str, ...]
    drive: DriveGains | None = None
    estimator: str = ESTIMATORS["wls"]
    knowledge: Knowledge = field(default_factory=Knowledge)
    shapes: Shapes | None = None
    lengths: LengthErrors | None = None

    @property
    def gains(self) -> Array:
        """Torque per reading, shape (nv,): drive gains of currents [N·m/A], ones otherwise."""
        return read_only(gains_of(self.given, self.data, self.drive))

    @cached_property
    def prior(self) -> Array:
        """Standard parameters of the prior, shape (10 nv,)."""
        return read_only(prior_parameters(self.given).ravel())

    @cached_property
    def fitted(self) -> Series:
        """Rows of the fit."""
        return series(self.data.train)

    @cached_property
    def predicted_fitted(self) -> Array:
        """Torque of the model at the rows of the fit, shape (n, nv) [torque unit]."""
        return read_only(predicted_torque(self.model, self.data.train) / self.gains)

    @cached_property
    def train(self) -> Accuracy:
        """Accuracy of the model on the rows of the fit."""
        return self.fitted.accuracy(self.predicted_fitted)

    @cached_property
    def holdout(self) -> Series:
        """Rows of the hold-out."""
        return series(self.data.validate)

    @cached_property
    def velocity(self) -> Array:
        """Velocities at these rows, shape (n, nv) [rad/s or m/s]; NaN where it rests."""
        dq = states(self.data.validate)[1]
        return read_only(np.where(self.holdout.counts, dq, np.nan))

    @cached_property
    def friction(self) -> tuple[FrictionCurve | None, ...]:
        """Friction of each joint by its velocity; None where none was estimated."""
        return tuple(friction_curve(self, joint) for joint in self.given.joints)

    @cached_property
    def predicted(self) -> Array:
        """Torque of the model at the rows of the hold-out, shape (n, nv) [torque unit]."""
        return read_only(predicted_torque(self.model, self.data.validate) / self.gains)

    @cached_property
    def predicted_given(self) -> Array:
        """Torque of the given robot at these rows, shape (n, nv) [torque unit]."""
        return read_only(predicted_torque(self.given, self.data.validate) / self.gains)

    @cached_property
    def validate(self) -> Accuracy:
        """Accuracy of the model on the hold-out."""
        return self.holdout.accuracy(self.predicted)

    @cached_property
    def baseline(self) -> Accuracy:
        """Accuracy of the given robot on the hold-out."""
        return self.holdout.accuracy(self.predicted_given)

    @property
    def told(self) -> list[tuple[float, str]]:
        """Factor and unit in which each parameter of links and effects is told."""
        return _told(self.given, self.model.effects, self.drive)

    @property
    def phi(self) -> Array:
        """Identified standard parameters, shape (10 nv,)."""
        return read_only(self.physical.x[: 10 * self.given.nv])

    @cached_property
    def holdout_columns(self) -> Array:
        """Columns of the base parameters at the rows of the hold-out, shape (n, nv, r)."""
        found = regression_of(self.model, self.model.effects, self.data.validate)
        return read_only(found.select(self.base.columns).W)

    @cached_property
    def interval(self) -> PredictionInterval:
        """95 % intervals of readings at the rows of the hold-out."""
        W = self.holdout_columns
        fit = self.least_squares
        lengths = self.lengths
        if lengths is not None:
            W = np.concatenate([W, lengths.columns(self.data.validate)], axis=2)
            left = [
                e / gain for e, gain in zip(lengths.residuals, self.gains, strict=True)
            ]
            return prediction_interval(
                W, fit, left, self.gains, lengths.of_prediction(fit)
            )
        residuals = self.fitted.counted(self.fitted.measured - self.predicted_fitted)
        return prediction_interval(W, fit, residuals, self.gains)

    def result(self) -> dict[str, Any]:
        """Machine-readable result of `identify`."""
        robot = self.given
        fit = self.least_squares
        broken = violations(self.phi, robot.links)
        half = self.interval.half_width
        known = self.interval.parameters
        error = np.abs(self.holdout.measured - self.predicted)
        inside = [each <= 0 for each in self.holdout.counted(error - half)]
        held = coverage(inside)
        sensors = self.data.sensors
        cutoff_hz = self.data.cutoff_hz
        intervals = [
            {
                "half_width": float(half[:, j].mean()),
                "half_width_parameters": float(1.96 * known[:, j].mean()),
                "coverage": float(held.share[j]),
            }
            for j in range(robot.nv)
        ]
        return {
            "verb": "identify",
            "robot": robot.name,
            "estimator": f"{self.estimator}, then physically consistent semidefinite fit",
            "effects": [effect.name for effect in self.model.effects],
            "cutoff_hz": self.data.cutoff_hz,
            **({} if self.shapes is None else {"shapes": self.shapes.entry()}),
            **({} if self.lengths is None else {"lengths": self.lengths.entry()}),
            "unit": robot.torque_unit(self.data.unit),
            "holdout": self.data.holdout,
            **(
                {"drive_gain_Nm_per_A": None}
                if self.drive is None
                else self.drive.result()
            ),
            "joints": [
                {
                    "name": joint,
                    "train": self.train.entry(j),
                    "validate": self.validate.entry(j) | {"interval95": intervals[j]},
                    "baseline": self.baseline.entry(j),
                    **(
                        {}
                        if sensors is None
                        else {"motion": sensors.entry(j, cutoff_hz)}
                    ),
                    **({} if curve is None else {"friction": curve.entry()}),
                }
                for j, (joint, curve) in enumerate(
                    zip(robot.joints, self.friction, strict=True)
                )
            ],
            "links": [body.entry() for body in self.bodies],
            "prior_sigma": self._sigma.tolist(),
            "parameters": self._parameters(),
            "base_parameters": [
                {
                    "expression": text,
                    "value": float(value),
                    "std": float(s),
                    "rel_std": float(s / abs(value)) if value else None,
                }
                for text, value, s in zip(
                    self.base.expressions, fit.beta, self.base_std, strict=True
                )
            ],
            "essential": self._essential(),
            "physical": {
                "consistent": not broken,
                "violations": broken,
                "kkt": vars(self.physical.kkt),
            },
            "knowledge": self.knowledge.entry(),
            "notes": [
                *self.notes,
                *self._moved(),
                *([self.knowledge.sentence] if self.knowledge.sentence else []),
                *_missed(robot.joints, held),
            ],
        }

    def predict(self, recording: RecordingLike, *, filtered: bool = True) -> Array:
        """Torque of the model at the instants of a recording, shape (n, nv) [torque unit].

        It is that of the motion as `identify_robot` sees it: positions are filtered at twice the
        cut-off. As measured torque is, it then passes the torque filter, if ``filtered``, whose
        ends say little. NaN where samples are too few to be filtered.
        """
        (run,) = self._alike(recording)
        found = np.full(run.tau.shape, np.nan)
        for s in prepare(run, self.data.cutoff_hz):
            tau = torque(self.model, s.motion) / self.gains
            t = s.motion.t
            tau = s.filtered(tau) if filtered else tau
            at = (run.t >= t[0]) & (run.t < t[-1] + 1 / s.rate_hz)
            found[at] = np.column_stack(
                [np.interp(run.t[at], t, column) for column in tau.T]
            )
        return read_only(found)

    def score(self, recordings: Recordings) -> list[dict[str, Any]]:
        """Accuracy of the model on recordings joint by joint, as ``result.json`` has it.

        ``rms``, ``rms_raw`` [torque unit], ``nrmse`` and ``r2`` while the joint moves, below the
        cut-off of this estimate.
        """
        cutoff_hz = self.data.cutoff_hz
        rows = [s for each in self._alike(recordings) for s in prepare(each, cutoff_hz)]
        found = series(rows).accuracy(predicted_torque(self.model, rows) / self.gains)
        return [
            {"name": name, **found.entry(j)} for j, name in enumerate(self.given.joints)
        ]

    def _alike(self, recordings: Recordings) -> list[Recording]:
        found = as_recordings(recordings, self.given)
        for each in found:
            if each.unit != self.data.unit:
                why = f"torque is in {each.unit}, but in {self.data.unit} where it was identified"
                raise BadRecording(each.file, f"{why}; use recordings of one unit")
        return found

    def to_frame(
        self,
        of: Literal["parameters", "base_parameters", "joints", "links"] = "parameters",
    ) -> pd.DataFrame:
        """Records of ``result.json`` of one kind, a row each."""
        names = {"parameters": "name", "base_parameters": "expression"}
        names |= {"joints": "name", "links": "link"}
        UnknownName.refuse("table", [of], names)
        return data_frame(self.result()[of], names[of])

    def series(self) -> dict[str, Array]:
        """Torques and states on the hold-out, each of shape (n, nv), and curves of friction."""
        return {
            "t": self.holdout.t,
            "measured": self.holdout.measured,
            "given": self.predicted_given,
            "identified": self.predicted,
            "half_width": self.interval.half_width,
            "position": states(self.data.validate)[0],
            "velocity": self.velocity,
            **curves_over_velocity(self),
        }

    def save(self, path: str | Path) -> list[Path]:
        """Write the model as .urdf, .xml (MJCF), .sdf, or .yaml with the files it refers to.

        `excitant.save` writes the whole run into a folder.

        Raises:
            BadInput: A folder.
            UnknownName: Another suffix.
        """
        from excitant.identify.export import model_files

        path = Path(path)
        gains = self.gains if self.data.unit == "A" else None
        if not path.suffix:
            why = "name a file, such as model.yaml; excitant.save(estimate, folder) saves the run"
            raise BadInput(f"{path}: a model is saved into one file; {why}")
        files = model_files(self.model, path.stem, f"{path.stem}.yaml", gains=gains)
        formats = {Path(name).suffix for name in files} - {".csv"}
        UnknownName.refuse("format", [path.suffix], sorted(formats))
        beside = [
            path.with_suffix(".urdf"),
            path.with_name(f"{path.stem}-estimate.csv"),
        ]
        written = [path] + beside * (path.suffix == ".yaml")
        for file in written:
            write_file(file, files[file.name])
        return written

    def publication(self, *, force: bool = False) -> Publication:
        """Files of the model, unless the hold-out speaks against it; see `publication`."""
        from excitant.identify.export import publication

        return publication(self, force=force)

    @cached_property
    def bodies(self) -> tuple[BodyChange, ...]:
        """Masses and centres of mass of the links, given and identified."""
        covariance = self.physical.covariance
        changes = list[BodyChange]()
        who = decided_by(self.physical.influence)
        places = list(self.given.model.jointPlacements)
        for k, link in enumerate(self.given.links):
            at = slice(10 * k, 10 * k + 10)
            body = inertia(self.prior[at])
            centre, std = centre_of_mass(self.phi[at], covariance[at, at])
            ends = [
                np.array(body.lever),
                *(place.translation for place in places[k + 2 : k + 3]),
            ]
            radius = np.sqrt(np.trace(body.inertia) / 2 / body.mass)
            length = max(radius, *(np.linalg.norm(end) for end in ends))
            mass = (
                float(self.phi[10 * k]),
                float(np.sqrt(covariance[10 * k, 10 * k])),
                who[10 * k],
            )
            by = max(who[10 * k + 1 : 10 * k + 4], key=_BY.index)
            change = body.mass, *mass, ends[0], centre, std, by, float(length)
            changes.append(BodyChange(link, *change))
        return tuple(changes)

    def _essential(self) -> dict[str, Any]:
        """The fewest base parameters, and their accuracy on the hold-out (median over joints)."""
        essential = essential_parameters(
            self.least_squares.beta, self.least_squares.covariance
        )
        names = self.base.expressions
        every, few = (
            float(
                np.nanmedian(
                    self.holdout.accuracy(self.holdout_columns @ b / self.gains).nrmse
                )
            )
            for b in (self.least_squares.beta, essential.beta)
        )
        return {
            "kept": [names[k] for k in essential.kept],
            "dropped": [names[k] for k in essential.dropped],
            "p_value": essential.p_value,
            "nrmse_all": every,
            "nrmse_essential": few,
        }

    @property
    def _sigma(self) -> Array:
        """Relative uncertainty of each given link, shape (links,)."""
        return np.broadcast_to(np.asarray(self.physical.prior.sigma), (self.given.nv,))

    def _moved(self) -> list[str]:
        """Sentences on how far the given bodies agree with the data, and which moved by half."""
        sigma = self._sigma[0]
        tool = self._sigma[-1]
        last = f" ({self.given.links[-1]}: {100 * tool:.0f} %)" if tool != sigma else ""
        found = [
            f"the given bodies are off by about {100 * sigma:.0f} %{last} where the recordings see "
            "them; as much is allowed for where they do not"
        ]
        if moved := "; ".join(body.moved for body in self.bodies if body.moved):
            found.append(f"moved by half or more against the given model: {moved}")
        return found

    def _parameters(self) -> list[dict[str, Any]]:
        robot = self.given
        physical = self.physical
        effects = [p for e in self.model.effects for p in e.parameters(robot)]
        owners = [link for link in robot.links for _ in UNITS]
        owners += [p.name.rpartition(".")[0] for p in effects]
        prior = [*self.prior, *(None,) * len(effects)]
        known = effect_values(robot)
        given = [*robot.phi, *(known.get(p.name) for p in effects)]
        who = decided_by(physical.influence)
        return [
            {
                "name": self.base.names[k],
                "link": owners[k],
                "value": factor * float(physical.x[k]),
                "std": float(self.std[k]),
                "unit": unit,
                "category": category,
                "given": None if given[k] is None else factor * float(given[k]),
                "prior": None if prior[k] is None else float(prior[k]),
                "prior_dominated": category == "unidentifiable" or who[k] == "prior",
                "decided_by": "prior" if category == "unidentifiable" else who[k],
            }
            for k, (category, (factor, unit)) in enumerate(
                zip(categories(self.base), self.told, strict=True)
            )
        ]

    def _lines(self) -> list[str]:
        errors = (
            share(float(np.nanmedian(x.nrmse))) for x in (self.baseline, self.validate)
        )
        below = f"{self.data.cutoff_hz:.3g} Hz"
        broken = violations(self.phi, self.given.links)
        effects = self.model.effects
        return [
            f"Estimate of {self.given.name} ({self.estimator}), on the hold-out",
            f"error {' → '.join(errors)} (nrmse, median over joints, below {below})",
            f"{len(self.base)} base parameters, {'not ' * bool(broken)}physically consistent; "
            f"effects: {', '.join(dict.fromkeys(plain(e.name) for e in effects)) or 'none'}",
        ]

    def _table(self) -> Table:
        columns = (
            self.baseline.rms,
            self.validate.rms,
            self.validate.nrmse,
            self.validate.r2,
        )
        rows = zip(
            self.given.joints, *(column.tolist() for column in columns), strict=True
        )
        heads = ("joint", "rms error as given", "identified", "nrmse", "r²")
        return heads, rows


@on_one_thread
def identify_robot(
    robot: RobotLike,
    recordings: Recordings,
    *,
    validate: Recordings = (),
    effects: Sequence[Effect] | None = None,
    cutoff_hz: float | None = None,
    estimator: str = "wls",
    knowledge: Knowledge | None = None,
    harmonics_hz: float | None = None,
    length_std: float | Sequence[float] | None = None,
) -> Estimate:
    """Identify a robot from recordings.

    Weighted least squares gives noise levels and base parameters; the semidefinite fit then gives
    physically consistent standard parameters. With any other estimator, that fit is to the torque
    that its base parameters predict on these rows, weighted by the noise it found. Shapes of
    effects, in which torque is not linear, are refined where that fits better. Faults of recordings
    are warned of (`FaultWarning`), not repaired.

    Args:
        robot: The arm, or its built-in name or file; its inertias are the prior.
        recordings: What to fit: recordings, or tables or files of them.
        validate: What to judge on, likewise; the last 30 % of each recording when empty.
        effects: Effects to estimate; friction, offset and rotor inertia when None.
        cutoff_hz: Cut-off of the torque filter [Hz]; see `excitant.identify.split`.
        estimator: One of `excitant.identify.estimators.ESTIMATORS`.
        knowledge: What is known of the bodies beforehand.
        harmonics_hz: Highest harmonic of the motion as planned [Hz], which the filter passes.
        length_std: Standard deviation of where each joint sits in its parent link, along x, y and
            z, one for all joints or one per joint [m]; that of the robot when None.

    Raises:
        BadInput: Knowledge that no body fulfils, or of links that the arm does not have; lengths
            with no standard deviation that can be.
        BadRecording: Recordings that cannot be used.
        BadRobot: A link of negative mass.
        UnknownName: There is no such estimator.
        RankDeficient: Motion that leaves base parameters undetermined.
        Infeasible: An estimator does not converge, or knowledge leaves no room.
    """
    UnknownName.refuse("estimator", [estimator], ESTIMATORS)
    robot = as_robot(robot)
    recordings = as_recordings(recordings, robot)
    validate = as_recordings(validate, robot)
    unsure = length_deviations(
        robot.length_std if length_std is None else length_std, robot
    )
    prior = prior_parameters(robot)
    known = (knowledge or Knowledge()).of(robot)
    warn_of_faults(robot, recordings)
    effects = standard_effects(robot.joints) if effects is None else tuple(effects)
    data = split(recordings, validate, cutoff_hz, harmonics_hz)

    def fitted_to(data: Data) -> tuple[Estimate, float]:
        rows = fit_rows(robot, effects, base_parameters(robot, effects), data)
        rows = with_own_torque(rows, prior, known)
        notes = notes_on(rows, prior)
        shapes = refined_shapes(rows, prior, known)
        if shapes is not None:
            rows = shapes.rows(rows) if shapes.better else rows
            notes += (shapes.sentence,)
        fit, name, said = estimated(rows, fitted(recordings, validate), estimator)
        R, z = rows.regression.factor(fit.weight)
        if name != "wls":
            z = R[:, rows.base.columns] @ fit.beta
        physical = fit_physical(
            R, z, prior, rows.open_prior, knowledge=known, links=robot.links
        )
        lengths = (
            length_errors(rows, fit, physical, unsure) if unsure[1:].any() else None
        )
        if lengths is not None:
            fit, physical = lengths.widened(fit, physical)
            said += (lengths.sentence,)
        if shapes is not None and shapes.better:
            fit, physical = shapes.widened(fit, physical, rows.base)
        found = judged(robot, rows, fit, physical, (*notes, *said))
        found = replace(found, estimator=ESTIMATORS[name], knowledge=known)
        return replace(found, shapes=shapes, lengths=lengths), _moved_by_rate(
            rows, fit, physical.x
        )

    found, moved = fitted_to(data)
    if moved > _MOVED:
        found, _ = fitted_to(data.whole)
        return found
    rates = {f"{s.thin.rate_hz:.4g}" for s in data.train if s.thin is not s}
    if not rates:
        return found
    said = (
        f"smooth columns are evaluated at {' and '.join(sorted(rates))} Hz, which moves no base "
        f"parameter by more than {max(moved, 1e-4):.1g} of its standard error"
    )
    return replace(found, notes=(*found.notes, said))


def _moved_by_rate(rows: FitRows, fit: LeastSquares, x: Array) -> float:
    """Largest change of a base parameter by columns at a lower rate, in standard errors.

    The columns lack what separates the torque of the identified bodies at every sample from that
    at the lower rate; x as in `PhysicalFit`.
    """
    if all(s.thin is s for s in rows.data.train):
        return 0.0
    bodies = partial(rigid_body_torque, identified_robot(rows.robot, rows.effects, x))
    lacking = [s.rows(bodies) - s.thin.rows(bodies) for s in rows.data.train]
    G = rows.reduced.with_torque(np.concatenate(lacking)).gram(fit.weight**2)
    change = np.abs(np.linalg.lstsq(G[:-1, :-1], G[:-1, -1], rcond=None)[0])
    std = np.sqrt(np.diag(fit.covariance))
    return float(np.max(change / np.maximum(std, np.finfo(float).tiny), initial=0.0))


def judged(
    robot: Robot,
    rows: FitRows,
    fit: LeastSquares,
    physical: PhysicalFit,
    notes: tuple[str, ...],
) -> Estimate:
    """The estimate of a robot as given from rows, with base parameters and physical ones.

    Uncertain drive gains k of currents add J C Jᵀ to the covariances, C that of log k. A gain
    scales its joint's torque, so the columns of J are A⁻¹ W_jᵀ τ_j, A that of the normal equations.
    Predicted currents rest on no gain, so the least-squares covariance stays as it is.
    """
    drive = rows.drive
    widened = fit.covariance
    std = np.sqrt(np.diag(physical.covariance))
    if drive is not None:
        pull = rows.by_gain(fit.weight)
        R, _ = rows.reduced.factor(fit.weight)
        J = np.linalg.solve(R.T @ R, pull[list(rows.base.columns)])
        widened = widened + J @ drive.covariance @ J.T
        J = physical.covariance @ pull
        wider = physical.covariance + J @ drive.covariance @ J.T
        physical = replace(physical, covariance=wider)
        factors = np.array([factor for factor, _ in _told(robot, rows.effects, drive)])
        std = np.where(factors == 1, np.sqrt(np.diag(wider)), factors * std)
    model = identified_robot(robot, rows.effects, physical.x)
    if is_covariance(widened):
        model = replace(
            model, estimate=BaseEstimate(rows.base.leading, fit.beta, widened)
        )
    notes += () if drive is None else (drive.sentence(robot.joints),)
    notes += (physical.note,) if physical.note else ()
    stds = std, np.sqrt(np.diag(widened))
    return Estimate(
        robot, model, rows.base, fit, physical, *stds, rows.data, notes, drive=drive
    )


def _told(
    robot: Robot, effects: Sequence[Effect], drive: DriveGains | None
) -> list[tuple[float, str]]:
    """Factor and unit in which each parameter of links and effects is told."""
    coefficients = [p for e in effects for p in e.parameters(robot)]
    links = [(1.0, unit) for unit in UNITS * robot.nv]
    return links + [told(p, robot, drive) for p in coefficients]


def notes_on(rows: FitRows, prior: Array) -> tuple[str, ...]:
    """Notes on the hold-out, the cut-off and the prior."""
    robot = rows.robot
    notes = [rows.data.holdout, rows.data.cutoff_why]
    if rows.data.sensors is not None:
        notes.append(rows.data.sensors.sentence(robot.joints))
    if rows.rests:
        notes.append(rows.rests)
    moved = [
        link
        for link, given, used in zip(
            robot.links, robot.phi.reshape(-1, 10), prior, strict=True
        )
        if not np.allclose(given, used)
    ]
    if moved:
        notes.append(
            f"the given inertia of {', '.join(moved)} is one no body can have; "
            "the nearest possible one serves as prior"
        )
    return tuple(notes)


def with_own_torque(rows: FitRows, prior: Array, knowledge: Knowledge) -> FitRows:
    """The rows with columns of effects that hold the torque of the identified arm.

    Columns of load, delay or elasticity hold the torque of the arm, from which that of the given
    one may be far off. The arm is identified without them first, then with those that it
    selects. The prior has shape (nv, 10).
    """
    robot = rows.robot
    effects = rows.effects
    apart = tuple(e for e in effects if not e.depends_on_model)
    if len(apart) == len(effects):
        return rows
    counts = [len(e.parameters(robot)) for e in effects]
    links, *places = np.split(
        range(rows.regression.p), np.cumsum([10 * robot.nv, *counts])[:-1]
    )
    own = [at for e, at in zip(effects, places, strict=True) if not e.depends_on_model]
    regression = rows.regression.select(np.concatenate([links, *own]).tolist())
    known = replace(
        rows, effects=apart, base=base_parameters(robot, apart), regression=regression
    )
    for _ in range(_ROUNDS):
        R, z = known.regression.factor(weighted_least_squares(known.reduced).weight)
        found = fit_physical(
            R, z, prior, known.open_prior, knowledge=knowledge, links=robot.links
        )
        reference = identified_robot(robot, known.effects, found.x)
        columns = regression_of(reference, effects, rows.data.train)
        known = replace(rows, robot=reference, regression=rows.fitting(columns))
    return known


def _missed(joints: Sequence[str], held: Coverage) -> list[str]:
    """A sentence on joints with coverage far from 95 %, where there are any."""
    low = np.flatnonzero(held.too_few)
    if not len(low):
        return []
    shares = ", ".join(f"{joints[int(j)]} {100 * held.share[j]:.0f} %" for j in low)
    return [
        f"95 % intervals of the predicted torque hold less of the hold-out ({shares}): the model "
        "misses something there; `excitant diagnose` looks for its cause"
    ]


class PredictionInterval(NamedTuple):
    """95 % prediction interval of a new reading, around the predicted torque.

    The torque W β̂ of a row has the variance w Σ wᵀ, Σ the covariance of the base parameters, which
    counts coloured noise. A new reading lies around it by that and by the noise of its joint, whose
    variance is that of the residuals, with what the fit took out of them given back. Coloured
    residuals know it from ν = n / Σ ρ_k² independent samples (Bartlett): quantiles are Student's.

    Attributes:
        parameters: Standard deviation of the predicted torque by parameters, and by lengths where
            these may be off, shape (n, nv) [torque unit].
        noise: Standard deviation of the noise, shape (nv,) [torque unit].
        freedom: Degrees of freedom that the noise is known with, shape (nv,).
    """

    parameters: Array
    noise: Array
    freedom: Array

    @property
    def half_width(self) -> Array:
        """Half of the interval's width, shape (n, nv) [torque unit]."""
        quantile = scipy.special.stdtrit(self.freedom, 0.5 + LEVEL / 2)
        return np.asarray(quantile * np.hypot(self.parameters, self.noise), float)


class Coverage(NamedTuple):
    """Share of readings that lie in their intervals, each array of shape (nv,).

    The standard deviation is that by chance where 95 % do, readings in a row counted by how many
    are independent.
    """

    share: Array
    std: Array

    @property
    def too_few(self) -> Array:
        """Joints with more readings outside than by chance, shape (nv,) of bool."""
        return np.asarray(self.share < LEVEL - _FAR - _CERTAIN * self.std, bool)


def torque_std(W: Array, covariance: Array) -> Array:
    """Standard deviation of the torque W β by the covariance of β, shape (n, nv)."""
    variance = np.einsum("njr,njr->nj", W @ covariance, W, optimize=True)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)), float)


def prediction_interval(
    W: Array,
    fit: LeastSquares,
    residuals: Sequence[Array],
    gains: Array | float = 1.0,
    covariance: Array | None = None,
) -> PredictionInterval:
    """95 % intervals of readings at new rows of the base columns, shape (n, nv, r).

    The residual of each joint, (m_j,), is measured less predicted torque at its fitted rows. The
    covariance is that of the fit, or of what W has columns of.
    """
    size = sum(map(len, residuals))
    left = 1 - np.minimum(fit.inflation * len(fit.beta) / size, _MOST)
    noise = np.sqrt(np.array([(e**2).mean() for e in residuals]) / left)
    freedom = np.array([independent_squares(e) for e in residuals]) * left
    parameters = (
        torque_std(W, fit.covariance if covariance is None else covariance) / gains
    )
    return PredictionInterval(parameters, noise, np.maximum(freedom, _FEWEST))


def independent_squares(residual: Array) -> float:
    """ν = n / (1 + 2 Σ ρ_k²): how many independent samples know the variance as well, (n,) → ν.

    Correlations that samples of white noise have by chance are left out.
    """
    n = len(residual)
    rho = autocorrelation(residual)[1:]
    chance = np.flatnonzero(np.abs(rho) < 2 / np.sqrt(n))
    end = int(chance[0]) if len(chance) else len(rho)
    return float(n / (1 + 2 * np.sum(rho[:end] ** 2)))


def coverage(inside: Sequence[Mask]) -> Coverage:
    """Share of readings within their intervals: whether each of a joint's is, one (n,) a joint."""
    hits = [each.astype(float) for each in inside]
    independent = np.array([len(each) / autocorrelation_time(each) for each in hits])
    share = np.array([each.mean() for each in hits])
    return Coverage(share, np.sqrt(LEVEL * (1 - LEVEL) / independent))
