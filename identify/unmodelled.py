"""What the data hold that the model lacks: values of no arm, a delay, torque by position.

A spring, a counterbalance or a cable at joint j pulls with s_j(q_j), which the columns W of bodies,
friction and offset partly take over. What they leave of q_j shows it,

    k = C⊥ᵀ Λ e / C⊥ᵀ Λ C⊥,   C⊥ = C − W B,   B = (Wᵀ Λ W)⁻¹ Wᵀ Λ C,

with the column C of a linear spring and the errors e of the fit. Gravity takes over a cos q_j +
b sin q_j wholly: of bodies that are far off and a spring, the fit can choose neither. Nominal
bodies can, where few directions are off, not a whole body (`physical.agreement`).

Bodies are then fitted beside such torque, whose coefficients θ of q_j, cos q_j, sin q_j and 1 have
a normal prior; the model has both. Base parameters without it are off by B θ: their covariance gets
B M Bᵀ, M = θ̂ θ̂ᵀ + V the second moment of θ.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy

from excitant.exceptions import RankDeficient
from excitant.identify.attenuation import attenuation
from excitant.identify.estimators import FALSE_ALARM
from excitant.identify.knowledge import Knowledge
from excitant.identify.least_squares import (
    LeastSquares,
    autocorrelation_time,
    settled,
    weighted_least_squares,
)
from excitant.identify.physical import (
    AGREEMENT,
    PhysicalFit,
    agreement,
    fit_physical,
)
from excitant.identify.prior import BodyPrior
from excitant.identify.recording import Recording
from excitant.identify.regression import (
    DEPENDENT,
    Regression,
    effect_columns,
    triangle,
)
from excitant.identify.rows import FitRows, states
from excitant.identify.shapes import REFINEMENT
from excitant.robots.base_parameters import BaseParameters, categories
from excitant.robots.effects import EFFECTS, Effect, Spring
from excitant.robots.effects.sensing import LONGEST_DELAY
from excitant.robots.motion import Array, quotient, read_only, root_mean_square
from excitant.robots.robot import Robot
from excitant.robots.torque import coefficients

Fits = tuple[LeastSquares, PhysicalFit, tuple[str, ...]]
"""Of base parameters and of bodies, and what is told of what the model lacks."""

IMPOSSIBLE_BY_CHANCE = 0.05
"""Probability that any possible coefficient is said to be none, of all of them; convention."""


def impossible_values(
    robot: Robot, effects: Sequence[Effect], base: BaseParameters, fit: LeastSquares
) -> tuple[int, ...]:
    """Base parameters that are a coefficient alone, estimated below its least value beyond chance.

    A rotor inertia, say, that is negative: the model lacks what the data hold in its place, as a
    spring or hysteresis, and the physically consistent fit keeps to the least value.
    """
    lower = np.full(len(base.names), -np.inf)
    lower[10 * robot.nv :] = [p.lower for p in coefficients(robot, effects)]
    category = categories(base)
    alone = [category[k] == "unique" for k in base.columns]
    least = np.where(alone, lower[list(base.columns)], -np.inf)
    tried = max(np.isfinite(least).sum(), 1)
    beyond = fit.beta - scipy.special.ndtri(IMPOSSIBLE_BY_CHANCE / tried) * fit.std
    return tuple(np.flatnonzero(beyond < least).tolist())


class Delay(NamedTuple):
    """Time by which the torque of all joints lags the motion, with its standard deviation [s]."""

    value: float = 0.0
    std: float = 0.0

    @property
    def sentence(self) -> str:
        """How late the torque is, and what was done."""
        way, read = ("lags", "earlier") if self.value > 0 else ("leads", "later")
        return (
            f"torque {way} the motion by {1e3 * abs(self.value):.2f} ± {1e3 * self.std:.1g} ms: it "
            f"is read as much {read}, in the hold-out too"
        )

    def on_time(self, recording: Recording) -> Recording:
        """The recording with the torque read earlier."""
        t = recording.t
        tau = scipy.interpolate.make_interp_spline(t, recording.tau, k=3)
        return replace(recording, tau=tau(np.clip(t + self.value, t[0], t[-1])))


def delay_of(rows: FitRows) -> Delay | None:
    """Delay d of the torque, τ(t) = W(t − d) x, by rows apart from reversals; None if by chance.

    The column of a change of d is −dτ/dt, one for each joint. Rows around a reversal are left out:
    what the law of friction lacks there is no delay.
    """
    direction = np.sign(states(rows.data.train).dq)
    window = 7  # rows: the filter reaches two on either side, 40 ms the third
    turns = scipy.ndimage.maximum_filter1d(direction, window, axis=0) != (
        scipy.ndimage.minimum_filter1d(direction, window, axis=0)
    )
    some = slice(None, None, -(-len(turns) // REFINEMENT.instants))
    apart = replace(rows, used=rows.used & ~turns)
    problem = rows.reduced.counting(apart.used).at(some)
    torque = _torque_over_time(rows)
    nv = rows.robot.nv
    names = [f"delay {joint}" for joint in rows.robot.joints]
    chance = -scipy.special.ndtri(FALSE_ALARM / 2)
    value = 0.0
    for _ in range(REFINEMENT.rounds):
        rate = -torque(value, 1)[some, :, None] * np.eye(nv)
        late = problem.with_torque(torque(value, 0)[some]).with_columns(rate, names)
        try:
            factor, beta, _, _ = settled(late)
            root = factor.inverse[-nv:]
            white, *_ = _common(beta[-nv:], root @ root.T)
            if abs(value + white.value) < chance * white.std:
                return None  # coloured noise leaves it less certain still
            fit = weighted_least_squares(late)
        except RankDeficient:
            return None
        step, scatter, share = _common(fit.beta[-nv:], fit.covariance[-nv:, -nv:])
        value += step.value
        std = step.std * np.sqrt(max(scatter, 1.0))
        if not chance * std < abs(value) < LONGEST_DELAY + chance * std:
            return None
        if abs(step.value) < std / 10:
            break
    std = float(np.hypot(std, share @ _by_noise(apart, late, fit)[-nv:]))
    return Delay(value, std) if abs(value) > chance * std else None


def _common(values: Array, covariance: Array) -> tuple[Delay, float, Array]:
    """Mean of the joints' delays, (nv,), that is least uncertain, scatter, and share of each.

    By the scatter, the squares of what joints disagree by over those of chance, the variance of the
    mean is larger (Birge 1932): a delay is common to all, what friction laws lack is not.
    """
    information = np.linalg.inv(covariance)
    share = information.sum(axis=0) / information.sum()
    mean = float(share @ values)
    off = values - mean
    scatter = float(off @ information @ off) / max(len(values) - 1, 1)
    return Delay(mean, float(information.sum() ** -0.5)), scatter, share


def spread_of(
    delay: Delay, rows: FitRows, fit: LeastSquares, covariance: Array
) -> Array:
    """Change of all parameters, of that covariance, by one standard deviation of it, (p, 1)."""
    rate = _torque_over_time(rows)(0.0, 1)
    gram = rows.regression.with_columns(rate[:, :, None], ["delay"]).gram(
        fit.weight**2
    )
    p = len(covariance)
    return delay.std * covariance @ gram[:p, p:-1]


def _torque_over_time(rows: FitRows) -> Callable[[float, int], Array]:
    """Torque at the rows, read later by a time [s], or its derivative of an order, (n, nv)."""
    segments = rows.data.train
    pairs = [
        (scipy.interpolate.make_interp_spline(s.motion.t, s.tau, k=3), s.t)
        for s in segments
    ]

    def torque(delay: float, order: int) -> Array:
        parts = [spline(t + delay, order) for spline, t in pairs]
        return np.concatenate(parts) * rows.gains

    return torque


def of_noise(rows: FitRows, fit: LeastSquares) -> Array:
    """E[EᵀE] β of base columns with errors E by noise of the motion, β the first of a fit, (r,)."""
    base = rows.base.columns
    return attenuation(
        rows.robot,
        rows.effects,
        rows.data.train,
        rows.used,
        1 / fit.sigma,
        base,
        fit.beta[: len(base)],
    )


def _by_noise(rows: FitRows, problem: Regression, fit: LeastSquares) -> Array:
    """Bias of coefficients by noise of the motion, of which delays have none, shape (r + nv,)."""
    noise = of_noise(rows, fit) * len(problem) / len(rows.used)
    gram = problem.gram(fit.sigma**-2.0)[:-1, :-1]
    padded = np.pad(noise, (0, len(gram) - len(noise)))
    return np.asarray(np.linalg.solve(gram, padded), float)


def allowing_for_springs(
    rows: FitRows,
    fit: LeastSquares,
    physical: PhysicalFit,
    noise: Array,
    knowledge: Knowledge,
    times: float,
) -> Fits:
    """Both fits with springs that the model lacks, and what is told of these.

    The fits are as they were where neither errors nor nominal bodies show any. Else base parameters
    get the bias, and bodies are fitted beside springs. E[EᵀE] β of errors E of the columns is
    noise, shape (r,); see `attenuation`. The data are so many times less certain than by noise.
    """
    robot = rows.robot
    seen, noisy = _seen(rows, fit, noise)
    sigma = np.broadcast_to(physical.prior.sigma, robot.nv)
    moved = sigma > sigma.min()
    # at the last link, a tool that the description lacks
    if not seen and not moved[:-1].any():
        return fit, physical, ()
    end = rows.regression.p
    springs = _springs(robot)
    names = [p.name for p in coefficients(robot, springs)]
    columns = effect_columns(robot, springs, rows.data.train)
    wide = rows.regression.with_parts(columns, names)
    size = _sizes(rows)
    R, z = wide.factor(noisy.weight / times)
    z = z + R[:, rows.base.columns] @ _beyond_least_squares(rows, fit)
    scaled = np.hstack([R[:, :end], R[:, end:] * size.ravel()])
    bodies = physical.prior.bodies
    own = [robot.nv + j for j in seen]
    of_links, of_joints = np.split(
        agreement(scaled, z, bodies, size.shape[1], own), 2
    )
    # all bodies together need not be off by more where springs may act too
    common = of_links == of_links.min()
    of_links = np.where(common, np.minimum(of_links, sigma.min()), of_links)
    instead = moved & (of_links == of_links.min())
    joints = np.flatnonzero(of_joints) if instead.any() else np.array([*seen], int)
    if not len(joints):
        return fit, physical, ()
    std = np.zeros_like(size)
    std[joints] = size[joints] * of_joints[joints, None]
    # of q, 1, cos q and sin q, the constant may hold all of the joint's torque: no motion shows it
    std[joints, 1] = size[joints, 1] / AGREEMENT.least
    acting = std.ravel() > 0
    at = [*range(end), *(end + np.flatnonzero(acting)).tolist()]
    prior = BodyPrior(bodies, of_links)
    found, root = _beside(R[:, at], z, std.ravel()[acting], prior, rows, knowledge)
    values = np.zeros(std.size)
    values[acting] = root[:, 0]
    torque = wide.torque(np.append(np.zeros(end), values)).std(axis=0)
    links = tuple(np.array(robot.links)[instead].tolist())
    r = len(fit.beta)
    gram = wide.select([*rows.base.columns, *at[end:]]).gram(fit.sigma**-2.0)
    of_base = np.linalg.solve(gram[:r, :r], gram[:r, r:-1]) @ root
    stiffness = dict.fromkeys(joints.tolist(), "") | seen
    pairs = zip(springs, np.split(values, len(springs)), strict=True)
    valued = tuple(spring.with_values(own) for spring, own in pairs if own.any())
    return (
        replace(fit, bias=read_only(of_base)),
        replace(found, undecided=links, springs=valued),
        (_sentence(robot, stiffness, torque, links),),
    )


def _springs(robot: Robot) -> list[Spring]:
    """Springs of each joint, torque by q and 1, then by cos q and sin q."""
    levers = (False, True)
    return [Spring((j,), lever=lever) for j in robot.joints for lever in levers]


def _beyond_least_squares(rows: FitRows, fit: LeastSquares) -> Array:
    """What another estimator adds to least squares of the base parameters, shape (r,)."""
    R, z = rows.reduced.factor(1 / fit.sigma)
    return fit.beta - np.linalg.lstsq(R, z)[0]


def _beside(
    R: Array,
    z: Array,
    std: Array,
    prior: BodyPrior,
    rows: FitRows,
    knowledge: Knowledge,
) -> tuple[PhysicalFit, Array]:
    """The fit of all parameters beside coefficients θ, normal around zero, (s,), the last columns.

    Second, the root of their second moment, their mean first, shape (s, s + 1).
    """
    s = len(std)
    data = np.column_stack([R[:, -s:], R[:, :-s], z])
    known = np.eye(s, data.shape[1]) / std[:, None]
    rows_of_all = triangle(np.vstack([data, known]))
    own = rows_of_all[:s, :s]
    across = rows_of_all[:s, s:-1]
    links = rows.robot.links
    fit = fit_physical(
        rows_of_all[s:, s:-1],
        rows_of_all[s:, -1],
        prior,
        rows.open_prior,
        knowledge,
        links,
    )
    inverse = np.linalg.inv(own)
    mean = inverse @ (rows_of_all[:s, -1] - across @ fit.x)
    by_others = inverse @ across
    covariance = inverse @ inverse.T + by_others @ fit.covariance @ by_others.T
    return fit, np.column_stack([mean, np.linalg.cholesky(covariance)])


def _sentence(
    robot: Robot, stiffness: dict[int, str], torque: Array, instead: Sequence[str]
) -> str:
    """Springs at joints, with the torque that they hold, (nv,), and stiffness where seen."""
    listed = ", ".join(
        f"{robot.joints[j]} ({torque[j]:.3g} {robot.torque_unit(joint=j)} rms{linear})"
        for j, linear in stiffness.items()
    )
    depends = "depends" if any(stiffness.values()) else "may depend"
    parts = [
        f"torque of {listed} {depends} on position as of a spring, counterbalance or cable, which "
        "the effects lack and the model has beside its bodies"
    ]
    if instead:
        test = EFFECTS["spring"].words.separated_by["inertial_parameters"]
        parts.append(
            f"with it the data agree with the given values of {', '.join(instead)}, without it not "
            f"at all; to decide between both, {test}"
        )
    parts.append(
        "the ± of all that could take its place are as much wider; `--effects auto` or `excitant "
        "diagnose` looks for it"
    )
    return "; ".join(parts)


def _linear(rows: FitRows) -> Array:
    """Columns of linear springs relaxed amid their motion, shape (n, nv, nv) [rad or m]."""
    q = states(rows.data.train).q
    used = rows.used
    centre = (q * used).sum(axis=0) / np.maximum(used.sum(axis=0), 1)
    return ((q - centre) * used)[:, :, None] * np.eye(rows.robot.nv)


def _sizes(rows: FitRows) -> Array:
    """Coefficients of springs at each joint that make a share of its torque, (nv, terms).

    `Agreement.least` is the share; 0 where a joint rests, and of levers at a sliding joint.
    """
    linear = _linear(rows).sum(axis=2)
    rms = root_mean_square(linear)
    stiffness = quotient(1.0, rms)
    revolute = rows.robot.revolute.astype(float)
    terms = [stiffness, np.ones_like(rms), revolute, revolute]
    torque = AGREEMENT.least * root_mean_square(rows.tau)
    return np.column_stack(terms) * torque[:, None]


def _seen(
    rows: FitRows, fit: LeastSquares, noise: Array
) -> tuple[dict[int, str], LeastSquares]:
    """Joints whose errors show a linear spring beyond chance, with its stiffness in words.

    One after the other, the surest first: by the errors of the fit, then fitted with the others.
    The fit with all of them is the second value: its noise is without their torque.
    """
    robot = rows.robot
    r = len(fit.beta)
    names = [f"spring {joint}" for joint in robot.joints]
    wide = rows.reduced.with_columns(_linear(rows), names)
    thin = wide.at(slice(None, None, -(-len(wide) // REFINEMENT.instants)))
    chance = -scipy.special.ndtri(FALSE_ALARM / (2 * robot.nv))
    noise = noise * len(thin) / len(wide)
    at = [*range(r)]
    found = dict[int, str]()
    best = fit
    while len(found) < robot.nv:
        scores, bias = _alone(thin, at, best.beta, fit.sigma, noise)
        surest = int(np.argmax(np.abs(scores)))
        if not abs(scores[surest]) > chance:
            break
        at.append(surest)
        try:
            wider = weighted_least_squares(wide.select(at))
        except RankDeficient:
            break
        stiffness = wider.beta[-1]
        std = np.hypot(wider.std[-1], bias[surest])
        if not abs(stiffness) > chance * std:
            break
        best = wider
        j = surest - r
        per = f"{robot.torque_unit(joint=j)}/{'rad' if robot.revolute[j] else 'm'}"
        found[j] = f", {stiffness:.3g} ± {std:.2g} {per}"
    return found, best


def _alone(
    problem: Regression, at: list[int], beta: Array, sigma: Array, noise: Array
) -> tuple[Array, Array]:
    """Scores of single columns beside some, fitted with β, and bias of their coefficients, (p,).

    Errors have the standard deviation sigma, shape (nv,); noise of the motion adds the bias.
    """
    gram = problem.gram(sigma**-2.0)[:-1, :-1]
    B = np.linalg.solve(gram[np.ix_(at, at)], gram[at])
    fitted = np.zeros(problem.p)
    fitted[at] = beta
    error = problem.residual(fitted) / sigma
    scores = np.zeros(problem.p)
    bias = np.zeros(problem.p)
    for k in np.setdiff1d(np.arange(problem.p), at).tolist():
        x = np.zeros(problem.p)
        x[at] = -B[:, k]
        x[k] = 1.0
        beyond = problem.torque(x) / sigma
        power = (beyond**2).sum()
        if not power > DEPENDENT * gram[k, k]:
            continue
        score = (beyond * error).sum()
        products = beyond * (error - score / power * beyond)
        times = [autocorrelation_time(column) for column in products.T]
        attenuated = float(x[: len(noise)] @ noise)
        variance = (products**2).sum(axis=0) @ times + attenuated**2
        scores[k] = score / np.sqrt(variance)
        bias[k] = attenuated / power
    return scores, bias
