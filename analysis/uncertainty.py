"""Uncertainty of an arm's parameters by one motion, planned or recorded, and what reduces it.

With the torque noise σ of each joint, the whitened columns W/σ of all parameters x have a
triangular factor R, and ‖R δ‖ is the torque that a change δ makes, in standard deviations of the
noise: null directions are not seen, and (RᵀR)⁻¹ is the covariance of what is (Gautier and Khalil
1992; Swevers et al. 1997). A further experiment adds rows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
import scipy

from excitant.analysis.thresholds import RESOLUTION
from excitant.exceptions import BadInput, BadRobot
from excitant.identify.prior import (
    BodyPrior,
    all_directions,
    linear_influence,
    prior_parameters,
    reference_motion,
    silent_columns,
)
from excitant.identify.regression import dense
from excitant.identify.rows import (
    FitRows,
    fit_rows,
    implausible_size,
    states,
    units_of,
)
from excitant.results import Practical
from excitant.robots.base_parameters import (
    BaseParameters,
    Observation,
    regroup,
)
from excitant.robots.effects import Effect
from excitant.robots.motion import Array, Mask, Motion, root_mean_square
from excitant.robots.parameters import pseudo_inertia
from excitant.robots.robot import Robot
from excitant.robots.torque import (
    coefficients,
    known_values,
    observation_columns,
    torque,
)

if TYPE_CHECKING:
    from excitant.identify.estimate import Estimate

NOT_SHOWN = "not_shown"
ROUNDING = 1e-9  # smallest singular value of normalised columns, relative
UNSEEN_PART = (
    1e-6  # of a unit vector: from here on it has a part in unseen directions
)

DURATION_S = 10.0  # of a further experiment
RATE_HZ = 20.0
_NEVER = "never by joint torques"
APART = f"{_NEVER} or base forces: weigh or swing the link apart from the arm"


def default_noise(robot: Robot) -> Array:
    """Torque noise (nv,): 1 % of the limit, or 1 N·m where there is none."""
    limits = robot.limits.torque
    stated = np.isfinite(limits) & (limits > 0)
    return np.where(stated, RESOLUTION.torque_noise * limits, 1.0)


def torque_noise(robot: Robot, noise: Sequence[float] | None) -> Array:
    """Standard deviation of each joint's torque noise, the default by its limit, (nv,) [N·m]."""
    if noise is None:
        unlimited = np.isinf(robot.limits.torque)
        if unlimited.any():
            joint = robot.joints[np.argmax(unlimited)]
            raise BadInput(
                f"{robot.source}: joint {joint} has no torque limit to scale noise by; "
                "give the noise of each joint (--noise) or a limit"
            )
        return default_noise(robot)
    sigma = np.asarray(noise, float)
    if sigma.shape != (robot.nv,) or not (np.isfinite(sigma) & (sigma > 0)).all():
        raise BadInput(
            f"noise {', '.join(f'{s:g}' for s in sigma)}: give one positive number [N·m] for "
            f"each of the {robot.nv} joints of {robot.name}"
        )
    return sigma


def triangle(W: Array, sigma: Array) -> Array:
    """Triangular factor R of columns (n, rows, p) whitened by σ (rows,), shape (p, p)."""
    p = W.shape[2]
    R = np.linalg.qr((W / sigma[:, None]).reshape(-1, p), mode="r")
    return np.vstack([R, np.zeros((p - len(R), p))])


def deviations(R: Array, A: Array) -> Array:
    """Standard deviation of combinations A x, A (m, p), by least squares, (m,); inf if unseen."""
    scale, s, V, seen = _decomposed(R)
    parts = (A / scale) @ V
    size = np.linalg.norm(parts, axis=1)
    hidden = np.linalg.norm(parts[:, ~seen], axis=1) > UNSEEN_PART * size
    std = np.sqrt(((parts[:, seen] / s[seen]) ** 2).sum(axis=1))
    return np.where(hidden, np.inf, std)


def _unit_columns(R: Array) -> tuple[Array, Array]:
    """Lengths of the columns, and the columns scaled to length one, or to zero where negligible."""
    norms = np.linalg.norm(R, axis=0)
    nonzero = ~silent_columns(R)
    scale = np.where(nonzero, norms, norms[nonzero].min() if nonzero.any() else 1.0)
    return scale, np.where(nonzero, R / scale, 0.0)


def _decomposed(R: Array) -> tuple[Array, Array, Array, Mask]:
    """Column scales; singular values and right vectors of R in these scales, and which are seen."""
    scale, unit = _unit_columns(R)
    s, Vt = all_directions(unit)
    return scale, s, Vt.T, s > ROUNDING * max(s.max(initial=0.0), 1e-300)


def shown_base(names: tuple[str, ...], W: Array) -> BaseParameters:
    """The base parameters that columns (n, rows, p) of one motion show, which may be fewer."""
    R = triangle(W, np.ones(W.shape[1]))
    norms, unit = _unit_columns(R)
    return regroup(
        Observation(names, unit, np.where(unit.any(axis=0), norms, 0.0)), ROUNDING
    )


@dataclass(frozen=True, eq=False)
class MotionInformation:
    """Information of a motion's torque on the r base parameters β of p parameters x."""

    R: Array  # triangular factor of the whitened columns, shape (p, p)
    columns: tuple[int, ...]  # those of β among them, shape (r,)
    covariance: Array  # of β as far as it is seen, shape (r, r); zero along unseen directions
    signal: (
        Array  # largest rms torque per unit of each parameter over the noise, (p,)
    )
    # of the unscaled columns of β; inf when some are not shown
    condition_number: float

    def std(self, C: Array) -> Array:
        """Standard deviation of combinations C β, C (m, r), shape (m,); inf where unseen."""
        values = np.sqrt(
            np.maximum(np.einsum("mr,rs,ms->m", C, self.covariance, C), 0.0)
        )
        unseen = np.isinf(deviations(self.R[:, self.columns], C))
        return np.where(unseen, np.inf, values)


def motion_information(
    base: BaseParameters, W: Array, sigma: Array, covariance: Array | None = None
) -> MotionInformation:
    """Information of columns (n, rows, p) with noise (rows,), or covariance (r, r) if known."""
    R = triangle(W, sigma)
    columns = base.columns
    scale, s, V, seen = _decomposed(R[:, columns])
    if covariance is None:
        half = V[:, seen] / s[seen] / scale[:, None]
        covariance = half @ half.T
    plain = np.linalg.qr(W[:, :, columns].reshape(-1, len(base)), mode="r")
    condition = float(np.linalg.cond(plain)) if seen.all() else np.inf
    signal = (root_mean_square(W) / sigma[:, None]).max(axis=0)
    return MotionInformation(R, columns, covariance, signal, condition)


def relative(std: float | None, value: float | None) -> float | None:
    """Standard deviation relative to a value; None where either is not known, or the value zero."""
    if std is None or not np.isfinite(std) or not value:
        return None
    return std / abs(value)


def verdict(std: float, value: float, negligible: bool) -> str:
    """``well`` (to 10 %), ``roughly`` (to 30 %), ``negligible``, ``hardly`` or ``not_shown``."""
    if not np.isfinite(std):
        return NOT_SHOWN
    if value and std <= RESOLUTION.roughly * abs(value):
        return "well" if std <= RESOLUTION.well * abs(value) else "roughly"
    return "negligible" if negligible else "hardly"


def resolution(value: Array, std: Array, signal: Array) -> tuple[Mask, Array]:
    """Which are negligible, and the size relative to which a deviation should be small; all (m,).

    Negligible is what stays below the noise at any value within two deviations. The size is the
    value, or where that is zero, such that 30 % of it make half the noise; 0 if shown is enough.
    """
    signal = np.maximum(signal, 1e-300)
    negligible = (np.abs(value) + 2 * std) * signal < 1
    size = np.where(value == 0, 0.5 / RESOLUTION.roughly / signal, np.abs(value))
    return negligible, np.where(negligible | ~np.isfinite(std), 0.0, size)


def practical(
    base: BaseParameters,
    values: Array,
    seen: MotionInformation,
    candidates: Mapping[str, Array],
) -> tuple[Practical, ...]:
    """Every base parameter under a motion, values (r,), and the experiment that would show it."""
    std = seen.std(np.eye(len(base)))
    negligible, size = resolution(values, std, seen.signal[list(base.columns)])
    needed = experiments_needed(seen.R, base.regrouping, size, candidates)
    rows = zip(base.expressions, values.tolist(), std.tolist(), strict=True)
    return tuple(
        Practical(
            name,
            x,
            s,
            relative(s, x),
            verdict(s, x, bool(negligible[k])),
            needed[k] or None,
        )
        for k, (name, x, s) in enumerate(rows)
    )


def candidate_experiments(
    robot: Robot,
    effects: Sequence[Effect],
    sigma: Array,
    rests: Sequence[int],
    pose: Array,
    measured: Sequence[int],
) -> dict[str, Array]:
    """Factors (p, p) of further experiments, the easiest first, by words after "shown by ...".

    Joints ``rests`` rested so far, at a pose (nv,); sigma (nv,) is the torque noise [N·m].
    """
    every_joint = reference_motion(robot, DURATION_S, RATE_HZ)

    def factor(
        arm: Robot, motion: Motion = every_joint, others: Sequence[int] = ()
    ) -> Array:
        rows = [*measured, *others]
        return triangle(
            observation_columns(arm, effects, motion)[:, rows], sigma[rows]
        )

    experiments = {}
    for j in rests:
        partly_resting = _holding(every_joint, [k for k in rests if k != j], pose)
        experiments[f"moving {robot.joints[j]}, which rests"] = factor(
            robot, partly_resting
        )
    if len(rests) > 1:
        experiments[
            f"moving {', '.join(robot.joints[j] for j in rests)} together"
        ] = factor(robot)
    elif not rests:
        experiments["a wider and faster motion of all joints"] = factor(robot)
    for j, name in enumerate(robot.joints):
        if j not in measured:
            experiments[f"measuring the torque of {name}"] = factor(
                robot, others=[j]
            )
    sensor = f"{_NEVER}; by a force and torque sensor under the base"
    tilts = _tilts(robot)
    others = len(coefficients(robot, effects))
    experiments |= {f"the base {how}": factor(arm) for how, arm in tilts.items()}
    for how, arm in {"": robot, **tilts}.items():
        W = base_wrench_columns(arm, every_joint)
        largest = np.abs(W @ arm.phi).max(axis=0)
        least = 1e-3 * max(largest.max(), 1e-3)
        noise = RESOLUTION.sensor_noise * np.maximum(largest, least)
        wide = np.pad(W, ((0, 0), (0, 0), (0, others)))
        experiments[f"{sensor}, {how}".removesuffix(", ")] = triangle(wide, noise)
    return experiments


def _tilts(robot: Robot) -> dict[str, Robot]:
    """The arm with its base tilted by 90° about each of its axes that changes gravity."""
    g = robot.gravity
    tilts = {}
    for name, axis in zip("xyz", np.eye(3), strict=True):
        turned = np.cross(axis, g) + axis * (axis @ g)
        if np.linalg.norm(turned - g) > 1e-6:
            tilts[f"tilted by 90° about its {name} axis"] = robot.with_gravity(
                turned
            )
    return tilts


def _holding(motion: Motion, rests: Sequence[int], pose: Array) -> Motion:
    still = np.isin(np.arange(motion.nv), rests)
    dq, ddq = (np.where(still, 0.0, values) for values in (motion.dq, motion.ddq))
    return Motion(motion.t, np.where(still, pose, motion.q), dq, ddq)


def base_wrench_columns(robot: Robot, motion: Motion) -> Array:
    """Force and torque on the base [N, N·m] per unit of each standard parameter, (n, 6, 10 nv).

    The sum over links of the wrench that moves a body of inertia I: I (a − g) + v ×* I v.
    """
    model = robot.model
    data = robot.model.createData()
    columns = np.empty((len(motion), 6, 10 * robot.nv))
    for k in range(len(motion)):
        pin.forwardKinematics(model, data, motion.q[k], motion.dq[k], motion.ddq[k])
        for j in range(1, robot.nv + 1):
            a = data.a[j] - data.oMi[j].actInv(model.gravity)
            body = pin.bodyRegressor(data.v[j], a)
            columns[k, :, 10 * j - 10 : 10 * j] = (
                data.oMi[j].toDualActionMatrix() @ body
            )
    return columns


def experiments_needed(
    R: Array, A: Array, size: Array, candidates: Mapping[str, Array]
) -> tuple[str, ...]:
    """Experiment that shows each combination A x, A (m, p); empty where the rows show it.

    More of the motion, else the first candidate that shows it to 30 % of its size (m,), else, or
    where that is 0, the first that shows it at all.
    """
    enough = np.where(size == 0, np.inf, RESOLUTION.roughly * np.abs(size))
    now = deviations(R, A)
    tried = {
        what: deviations(np.vstack([R, more]), A)
        for what, more in candidates.items()
    }
    answers = []
    for k, (std, limit) in enumerate(zip(now, enough, strict=True)):
        some = [what for what, with_it in tried.items() if np.isfinite(with_it[k])]
        good = [what for what in some if tried[what][k] <= limit]
        shown = np.isfinite(std)
        times = (std / limit) ** 2 if shown else np.inf
        if shown and std <= limit:
            answers.append("")
        elif times <= RESOLUTION.repeats:
            answers.append(
                f"about {int(np.ceil(times))} times the length of this motion"
            )
        elif good:
            answers.append(good[0])
        elif shown:
            answers.append("less torque noise: too uncertain in every motion tried")
        else:
            answers.append(
                f"{some[0]}, but no better than to 30 %" if some else APART
            )
    return tuple(answers)


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
    s, Vt = all_directions(R @ L)
    return np.linalg.norm(L @ Vt.T / np.sqrt(1 + s**2), axis=1)


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
    notes: Sequence[str]
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
    effects = estimate.physical.estimated(estimate.model.effects)
    rows = cleaned(fit_rows(robot, effects, estimate.base, estimate.data))
    sigma = fit.sigma * np.sqrt(fit.inflation)
    complete = estimate.base.columns == base.columns
    information = motion_information(
        base, rows.W, sigma, fit.uncertainty if complete else None
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
        q=states(estimate.data.train).q,
        basis="from the residual of the recording, with its autocorrelation",
        notes=notes,
    )


def cleaned(rows: FitRows) -> FitRows:
    """The rows with columns that are rounding alone set to zero."""
    regression = rows.regression
    rounding = silent_columns(np.linalg.norm(regression.W, axis=0))
    W = np.where(rounding, 0.0, regression.W)
    clean = dense(W, regression.tau, regression.names, regression.used)
    return replace(rows, regression=clean)
