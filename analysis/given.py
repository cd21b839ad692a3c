"""What is given to judge an arm by: a motion with assumed noise, or what a recording came to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from excitant.analysis.needed import PAYLOAD_KG, resting, scale_deviation
from excitant.analysis.partial import clean_rows
from excitant.analysis.practical import TORQUE_NOISE, Sight, sight, torque_noise
from excitant.analysis.prior_influence import (
    Prior,
    PriorInfluence,
    prior_influence,
    prior_of,
    refits,
)
from excitant.exceptions import BadRobot
from excitant.identify.estimate import Estimate
from excitant.identify.physical import EffectPrior, prior_parameters
from excitant.identify.rows import fit_rows, implausible_size
from excitant.robots.base_parameters import BaseParameters
from excitant.robots.effects import Effect
from excitant.robots.motion import Array, Motion, freeze
from excitant.robots.robot import Robot
from excitant.robots.torque import effect_values, observation_columns, torque


@dataclass(frozen=True, eq=False)
class Given:
    """A motion with its noise, and what is known of the parameters.

    Attributes:
        W: Columns of all parameters at the measured joints, shape (n, rows, p).
        sigma: Noise of those joints' torque, per independent row, shape (rows,) [N·m].
        seen: What the motion shows.
        x: Values of all parameters, zero where not known, shape (p,).
        known: Which of them are known.
        beta: Values of the base parameters, shape (r,).
        prior: What is known without data; None where a link has no mass.
        std: Standard deviation of each parameter with the prior counted in, shape (p,).
        influence: How far each parameter follows the prior.
        rests: Joints that do not move.
        motion: The motion, or the longest stretch of a recording.
        pose: Where joints are on average, shape (nv,) [rad or m].
        basis: Where the standard deviations come from, as a sentence.
        notes: What the user should know, as sentences.
    """

    W: Array
    sigma: Array
    seen: Sight
    x: Array
    known: tuple[bool, ...]
    beta: Array
    prior: Prior | None
    std: Array | None
    influence: PriorInfluence | None
    rests: tuple[int, ...]
    motion: Motion
    pose: Array
    basis: str
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        freeze(self, "W", "sigma", "x", "beta", "pose")

    @property
    def loudness(self) -> Array:
        """Largest rms torque of each parameter per unit, in noise, shape (p,)."""
        rms = np.sqrt((self.W**2).mean(axis=0)) / self.sigma[:, None]
        return np.asarray(rms.max(axis=0), float)


def given_motion(
    robot: Robot,
    base: BaseParameters,
    effects: Sequence[Effect],
    motion: Motion,
    noise: Sequence[float] | None = None,
    measured: Sequence[int] | None = None,
) -> Given:
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
    seen, known = sight(base, W, sigma), effect_values(robot)
    coefficients = base.names[10 * robot.nv :]
    x = np.concatenate([robot.phi, [known.get(name, 0.0) for name in coefficients]])
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
    return Given(
        W=W,
        sigma=sigma,
        seen=seen,
        x=x,
        known=(*(True,) * (10 * robot.nv), *(name in known for name in coefficients)),
        beta=base.regrouping @ x,
        prior=prior,
        std=None if prior is None else prior.posterior_std(seen.R),
        influence=influence,
        rests=resting(motion.q),
        motion=motion,
        pose=motion.q.mean(axis=0),
        basis=f"for torque noise {how}, independent at each of {len(motion)} instants",
        notes=notes,
    )


def given_estimate(
    robot: Robot, base: BaseParameters, estimate: Estimate, rng: np.random.Generator | None = None
) -> Given:
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
    seen = sight(base, rows.W, sigma, fit.covariance if complete else None)
    prior = prior_of(estimate.prior.reshape(-1, 10), rows.open_prior)
    influence = prior_influence(
        seen,
        base.regrouping,
        prior,
        estimate.physical.x,
        np.random.default_rng(0) if rng is None else rng,
        refits(estimate, rows) if rng is not None else None,
    )
    return Given(
        W=rows.W,
        sigma=sigma,
        seen=seen,
        x=estimate.physical.x,
        known=(True,) * len(base.names),
        beta=fit.beta if complete else base.regrouping @ estimate.physical.x,
        prior=prior,
        std=np.sqrt(np.diag(estimate.physical.covariance)),
        influence=influence,
        rests=resting(q),
        motion=max((s.motion for s in estimate.data.train), key=len),
        pose=q.mean(axis=0),
        basis="from the residual of the recording, with its autocorrelation",
        notes=(
            *_limit_note(robot, prior.at_limit(estimate.physical.x)),
            *(_scale_note(robot, effects, sigma) if estimate.data.unit == "A" else ()),
        ),
    )


def _limit_note(robot: Robot, flat: Sequence[int]) -> tuple[str, ...]:
    if not flat:
        return ()
    names = ", ".join(robot.links[k] for k in flat)
    return (f"at the limit of what a body can have: {names}; the data alone would go beyond",)


def _scale_note(robot: Robot, effects: Sequence[Effect], sigma: Array) -> tuple[str, ...]:
    std = scale_deviation(robot, effects, sigma)
    return (
        "torque came as current: all values hang on one common scale that currents do not show; "
        f"a known payload of {PAYLOAD_KG:g} kg would show it to ±{100 * std:.2g} % "
        "in ten seconds of lively motion",
    )
