"""A planned or recorded experiment, and the influence of the prior on its result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import scipy

from excitant.analysis.thresholds import RESOLUTION
from excitant.analysis.uncertainty import (
    MotionInformation,
    known_values,
    motion_information,
    torque_noise,
    without_rounding,
)
from excitant.exceptions import BadRobot
from excitant.identify.prior import (
    BodyPrior,
    linear_influence,
    prior_parameters,
)
from excitant.identify.regression import dense
from excitant.identify.rows import FitRows, fit_rows, implausible_size, units_of
from excitant.robots.base_parameters import BaseParameters
from excitant.robots.effects import Effect
from excitant.robots.motion import Array, Motion
from excitant.robots.parameters import pseudo_inertia
from excitant.robots.robot import Robot
from excitant.robots.torque import observation_columns, torque

if TYPE_CHECKING:
    from excitant.identify.estimate import Estimate


def prior_root(bodies: Array, effects: Array) -> Array:
    """L of the covariance L Lᵀ of all parameters before any data, shape (p, p).

    The prior is that of `fit_physical`, of consistent bodies, shape (links, 10), and standard
    deviations of effect coefficients.
    """
    _, J = BodyPrior(bodies).quadratic(bodies.ravel())
    root = np.linalg.inv(np.linalg.qr(J, mode="r"))
    return scipy.linalg.block_diag(root, np.diag(effects))


def posterior_std(R: Array, L: Array) -> Array:
    """Standard deviation of each parameter after data, constraints ignored, shape (p,)."""
    _, s, Vt = np.linalg.svd(R @ L)
    s = np.pad(s, (0, len(Vt) - len(s)))
    return np.asarray(np.linalg.norm(L @ Vt.T / np.sqrt(1 + s**2), axis=1), float)


def flat_links(phi: Array, given: Array) -> tuple[int, ...]:
    """Links at the limit of physical consistency, almost flat or thin; both (links, 10)."""
    pairs = zip(pseudo_inertia(phi), pseudo_inertia(given), strict=True)
    smallest = [scipy.linalg.eigvalsh(body, own)[0] for body, own in pairs]
    return tuple(k for k, least in enumerate(smallest) if least < RESOLUTION.flat)


@dataclass(frozen=True, eq=False)
class Experiment:
    """A motion with its noise, and what is known of the p parameters."""

    sigma: Array  # noise of the measured joints' torque, per independent row, shape (rows,) [N·m]
    information: MotionInformation
    x: Array  # values of all parameters, zero where unknown, shape (p,)
    known: tuple[bool, ...]  # which of them are known
    beta: Array  # values of the base parameters, shape (r,)
    bodies: (
        Array | None
    )  # the prior's, shape (nv, 10); None where a link has no mass
    # standard deviation of each parameter as told, prior included, shape (p,)
    std: Array | None
    # how far each parameter follows the prior, 0 to 1, shape (p,)
    influence: Array | None
    motion: Motion  # or the longest stretch of a recording
    q: Array  # positions at all rows, shape (n, nv) [rad or m]
    basis: str  # where the standard deviations come from, as a sentence
    notes: Sequence[str] = ()
    # factor and unit of each parameter, if not its own
    told: Sequence[tuple[float, str]] = ()

    @property
    def resting(self) -> tuple[int, ...]:
        """Joints that do not move."""
        return tuple(
            int(j)
            for j in np.flatnonzero(np.ptp(self.q, axis=0) < RESOLUTION.rests)
        )


def planned_experiment(
    robot: Robot,
    base: BaseParameters,
    effects: Sequence[Effect],
    motion: Motion,
    noise: Sequence[float] | None,
    rows: list[int],
) -> Experiment:
    """A motion to judge before it is run, torque measured at the joints of ``rows``."""
    sigma = torque_noise(robot, noise)[rows]
    W = observation_columns(robot, effects, motion)[:, rows]
    information = motion_information(base, W, sigma)
    values = known_values(robot, effects)
    x = np.array([value or 0.0 for value in values])
    notes: list[str] = []
    bodies = None
    std = None
    influence = None
    try:
        size = implausible_size(
            W[:, :, 10 * robot.nv :], torque(robot, motion)[:, rows]
        )
        bodies = prior_parameters(robot)
        L = prior_root(bodies, size)
        std = posterior_std(information.R, L)
        influence = linear_influence(information.R, L, x, robot.nv)
    except BadRobot as error:
        notes.append(f"the prior is left out: {error.why}")
    how = (
        "as given"
        if noise is not None
        else f"of {100 * RESOLUTION.torque_noise:g} % of each limit"
    )
    return Experiment(
        sigma=sigma,
        information=information,
        x=x,
        known=tuple(value is not None for value in values),
        beta=base.regrouping @ x,
        bodies=bodies,
        std=std,
        influence=influence,
        motion=motion,
        q=motion.q,
        basis=f"for torque noise {how}, independent at each of {len(motion)} instants",
        notes=notes,
    )


def recorded_experiment(
    robot: Robot, base: BaseParameters, estimate: Estimate
) -> Experiment:
    """Experiment of an estimate."""
    fit = estimate.least_squares
    effects = estimate.model.effects
    rows = cleaned(fit_rows(robot, effects, estimate.base, estimate.data))
    sigma = fit.sigma * np.sqrt(fit.inflation)
    complete = estimate.base.columns == base.columns
    information = motion_information(
        base, rows.W, sigma, fit.covariance if complete else None
    )
    x = estimate.physical.x
    bodies = estimate.physical.prior.bodies
    notes = []
    if flat := flat_links(x[: bodies.size].reshape(-1, 10), bodies):
        names = ", ".join(robot.links[k] for k in flat)
        notes.append(
            f"at the limit of physical consistency: {names}; the data alone would go beyond"
        )
    if estimate.data.unit == "A":
        notes.append(
            "torque was recorded as current: all values share one scale that currents do not "
            "show; recordings with a known payload would determine it (identify "
            "--payload-recording)"
        )
    return Experiment(
        sigma=sigma,
        information=information,
        x=x,
        known=(True,) * len(base.names),
        beta=fit.beta if complete else base.regrouping @ x,
        bodies=bodies,
        std=estimate.std,
        told=units_of(estimate.given, effects, estimate.drive),
        influence=estimate.physical.influence,
        motion=max((s.motion for s in estimate.data.train), key=len),
        q=np.concatenate([s.motion.q[s.keep] for s in estimate.data.train]),
        basis="from the residual of the recording, with its autocorrelation",
        notes=notes,
    )


def cleaned(rows: FitRows) -> FitRows:
    """The rows with columns that are rounding alone set to zero."""
    regression = rows.regression
    clean = dense(
        without_rounding(regression.W),
        regression.tau,
        regression.names,
        regression.used,
    )
    return replace(rows, regression=clean)
