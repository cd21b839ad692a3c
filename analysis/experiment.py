"""An experiment to judge an arm by: a planned motion with assumed noise, or a recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from excitant.analysis.next_experiment import (
    PAYLOAD_KG,
    known_values,
    resting_joints,
    scale_deviation,
)
from excitant.analysis.prior_influence import (
    Prior,
    PriorInfluence,
    prior_influence,
    prior_of,
    refits,
)
from excitant.analysis.uncertainty import (
    TORQUE_NOISE,
    MotionInformation,
    motion_information,
    shown_base,
    torque_noise,
    without_rounding,
)
from excitant.exceptions import BadRobot
from excitant.identify.estimate import Estimate, judged
from excitant.identify.least_squares import weighted_least_squares
from excitant.identify.physical import fit_physical
from excitant.identify.prior import EffectPrior, prior_parameters
from excitant.identify.recording import Recording
from excitant.identify.regression import dense, regression_of
from excitant.identify.rows import FitRows, fit_rows, implausible_size, split
from excitant.robots.base_parameters import BaseParameters
from excitant.robots.effects import Effect, standard_effects
from excitant.robots.motion import Array, Motion, freeze
from excitant.robots.robot import Robot
from excitant.robots.torque import column_names, observation_columns, torque


@dataclass(frozen=True, eq=False)
class Experiment:
    """A motion with its noise, and what is known of the parameters.

    Attributes:
        W: Columns of all parameters at the measured joints, shape (n, rows, p).
        sigma: Noise of those joints' torque, per independent row, shape (rows,) [N·m].
        information: What the motion shows.
        x: Values of all parameters, zero where not known, shape (p,).
        known: Which of them are known.
        beta: Values of the base parameters, shape (r,).
        prior: What is known without data; None where a link has no mass.
        std: Standard deviation of each parameter with the prior counted in, shape (p,).
        influence: How far each parameter follows the prior.
        resting: Joints that do not move.
        motion: The motion, or the longest stretch of a recording.
        pose: Where joints are on average, shape (nv,) [rad or m].
        basis: Where the standard deviations come from, as a sentence.
        notes: What the user should know, as sentences.
    """

    W: Array
    sigma: Array
    information: MotionInformation
    x: Array
    known: tuple[bool, ...]
    beta: Array
    prior: Prior | None
    std: Array | None
    influence: PriorInfluence | None
    resting: tuple[int, ...]
    motion: Motion
    pose: Array
    basis: str
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        freeze(self, "W", "sigma", "x", "beta", "pose")

    @property
    def signal(self) -> Array:
        """Largest rms torque of each parameter per unit, in noise, shape (p,)."""
        rms = np.sqrt((self.W**2).mean(axis=0)) / self.sigma[:, None]
        return np.asarray(rms.max(axis=0), float)


def planned_experiment(
    robot: Robot,
    base: BaseParameters,
    effects: Sequence[Effect],
    motion: Motion,
    noise: Sequence[float] | None = None,
    measured: Sequence[int] | None = None,
) -> Experiment:
    """A motion to judge before it is run.

    Args:
        robot: The arm.
        base: Base parameters of links and effects.
        effects: Effects whose coefficients are unknown too.
        motion: The motion; torque noise is independent at every instant of it.
        noise: Torque noise of each joint [N·m]; 1 % of each limit if None.
        measured: Joints whose torque is measured; all if None.

    Raises:
        BadInput: Noise that does not fit, or no torque limit to scale it by.
    """
    rows = list(range(robot.nv) if measured is None else measured)
    sigma = torque_noise(robot, noise)[rows]
    W = observation_columns(robot, effects, motion)[:, rows]
    seen, (x, known) = motion_information(base, W, sigma), known_values(robot, effects)
    notes: tuple[str, ...] = ()
    prior, influence = None, None
    try:
        size = implausible_size(W[:, :, 10 * robot.nv :], torque(robot, motion)[:, rows])
        nothing = EffectPrior(np.zeros_like(size), size, np.full_like(size, -np.inf))
        prior = prior_of(prior_parameters(robot), nothing)
        influence = prior_influence(seen, base.regrouping, prior, x, np.random.default_rng(0))
    except BadRobot as error:
        notes = (f"there is no prior to count in: {error.why}",)
    how = "as given" if noise is not None else f"of {100 * TORQUE_NOISE:g} % of each limit"
    return Experiment(
        W=W,
        sigma=sigma,
        information=seen,
        x=x,
        known=tuple(known),
        beta=base.regrouping @ x,
        prior=prior,
        std=None if prior is None else prior.posterior_std(seen.R),
        influence=influence,
        resting=resting_joints(motion.q),
        motion=motion,
        pose=motion.q.mean(axis=0),
        basis=f"for torque noise {how}, independent at each of {len(motion)} instants",
        notes=notes,
    )


def recorded_experiment(
    robot: Robot, base: BaseParameters, estimate: Estimate, rng: np.random.Generator | None = None
) -> Experiment:
    """What a recording came to.

    Args:
        robot: The arm.
        base: Base parameters of links and effects.
        estimate: What was identified, of all base parameters or of those the recording shows.
        rng: Draws perturbed priors for refits; linear theory instead if None.

    Raises:
        Infeasible: A refit failed.
    """
    q = np.concatenate([s.motion.q[s.keep] for s in estimate.data.train])
    fit, effects = estimate.least_squares, estimate.model.effects
    rows = clean_rows(fit_rows(robot, effects, estimate.base, estimate.data))
    sigma = fit.sigma * np.sqrt(fit.inflation)
    complete = estimate.base.columns == base.columns
    seen = motion_information(base, rows.W, sigma, fit.covariance if complete else None)
    prior = prior_of(estimate.prior.reshape(-1, 10), rows.open_prior)
    influence = prior_influence(
        seen,
        base.regrouping,
        prior,
        estimate.physical.x,
        np.random.default_rng(0) if rng is None else rng,
        refits(estimate, rows) if rng is not None else None,
    )
    notes = []
    if flat := prior.at_limit(estimate.physical.x):
        names = ", ".join(robot.links[k] for k in flat)
        notes.append(
            f"at the limit of what a body can have: {names}; the data alone would go beyond"
        )
    if estimate.data.unit == "A":
        notes.append(
            "torque came as current: all values hang on one common scale that currents do not "
            f"show; a known payload of {PAYLOAD_KG:g} kg would show it to "
            f"±{100 * scale_deviation(robot, effects, sigma):.2g} % in ten seconds of motion of "
            "all joints"
        )
    return Experiment(
        W=rows.W,
        sigma=sigma,
        information=seen,
        x=estimate.physical.x,
        known=(True,) * len(base.names),
        beta=fit.beta if complete else base.regrouping @ estimate.physical.x,
        prior=prior,
        std=np.sqrt(np.diag(estimate.physical.covariance)),
        influence=influence,
        resting=resting_joints(q),
        motion=max((s.motion for s in estimate.data.train), key=len),
        pose=q.mean(axis=0),
        basis="from the residual of the recording, with its autocorrelation",
        notes=tuple(notes),
    )


def identify_shown(
    robot: Robot,
    recordings: Sequence[Recording],
    effects: Sequence[Effect] | None = None,
    *,
    validate: Sequence[Recording] = (),
) -> Estimate:
    """Identify the base parameters that a recording's own motion has, be they few.

    Base parameters are taken from the recorded rows in place of random states, so that a motion
    that rests a joint is no error; what it leaves open stays at the prior.

    Args:
        robot: The arm; its inertias are the prior.
        recordings: What to fit.
        effects: Effects to estimate; friction, offset and rotor inertia when None.
        validate: What to judge on; the last 30 % of each recording when empty.

    Raises:
        BadRecording: Recordings that cannot be used.
        BadRobot: Links without mass, so no prior.
        Infeasible: The semidefinite solver failed.
    """
    prior = prior_parameters(robot)
    effects = standard_effects(robot.joints) if effects is None else tuple(effects)
    data = split(recordings, validate)
    W = without_rounding(regression_of(robot, effects, data.train).W)
    rows = clean_rows(fit_rows(robot, effects, shown_base(column_names(robot, effects), W), data))
    fit = weighted_least_squares(rows.reduced)
    R, z = rows.regression.factor(fit.weight)
    physical = fit_physical(R, z, prior, rows.open_prior)
    return judged(robot, rows, fit, physical, (data.holdout,))


def clean_rows(rows: FitRows) -> FitRows:
    """The rows without columns that are rounding alone, of which nothing is known beforehand."""
    known = rows.regression
    clean = dense(without_rounding(known.W), known.tau, known.names, known.starts)
    return replace(rows, regression=clean)
