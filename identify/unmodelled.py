"""What the data hold that the model lacks: values of no arm, and torque by the position of a joint.

A spring, a counterbalance or a cable at joint j pulls with s_j(q_j), which the columns W of bodies,
friction and offset partly take over. What they leave of q_j shows it,

    k = C⊥ᵀ Λ e / C⊥ᵀ Λ C⊥,   C⊥ = C − W B,   B = (Wᵀ Λ W)⁻¹ Wᵀ Λ C,

with the column C of a linear spring and the errors e of the fit. Gravity takes over a cos q_j +
b sin q_j wholly: of bodies that are far off and a spring, the fit can choose neither. Nominal
bodies can, where few directions are off, not a whole body (`physical.agreement`).

Base parameters are then off by B θ. The coefficients θ of q_j, cos q_j, sin q_j and 1, given data
and nominal bodies, have the second moment M = θ̂ θ̂ᵀ + V, which covariances get as B M Bᵀ.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy

from excitant.exceptions import RankDeficient
from excitant.identify.estimators import FALSE_ALARM
from excitant.identify.least_squares import (
    LeastSquares,
    autocorrelation_time,
    weighted_least_squares,
)
from excitant.identify.physical import AGREEMENT, PhysicalFit, agreement
from excitant.identify.prior import link_coordinates, link_weights
from excitant.identify.regression import DEPENDENT, Regression
from excitant.identify.rows import FitRows, states
from excitant.identify.shapes import REFINEMENT
from excitant.robots.base_parameters import BaseParameters, categories
from excitant.robots.effects import EFFECTS, Effect
from excitant.robots.motion import Array, read_only
from excitant.robots.robot import Robot

IMPOSSIBLE_BY_CHANCE = 0.05
"""Probability that any possible coefficient is said to be none, of all of them; convention."""
TERMS = ("q", "cos q", "sin q", "1")
"""Columns of the torque by the position of a joint; that of 1 stands for where it is at rest."""


def impossible_values(
    robot: Robot, effects: Sequence[Effect], base: BaseParameters, fit: LeastSquares
) -> tuple[int, ...]:
    """Base parameters that are a coefficient alone, estimated below its least value beyond chance.

    A rotor inertia, say, that is negative: the model lacks what the data hold in its place, as a
    spring or hysteresis, and the physically consistent fit keeps to the least value.
    """
    lower = np.full(len(base.names), -np.inf)
    lower[10 * robot.nv :] = [p.lower for e in effects for p in e.parameters(robot)]
    category = categories(base)
    alone = [category[k] == "unique" for k in base.columns]
    least = np.where(alone, lower[list(base.columns)], -np.inf)
    tried = max(np.isfinite(least).sum(), 1)
    beyond = fit.beta - scipy.special.ndtri(IMPOSSIBLE_BY_CHANCE / tried) * fit.std
    return tuple(np.flatnonzero(beyond < least).tolist())


def allowing_for_springs(
    rows: FitRows, fit: LeastSquares, physical: PhysicalFit, noise: Array
) -> tuple[LeastSquares, PhysicalFit, tuple[str, ...]]:
    """Both fits with what springs that the model lacks leave open, and what is told of these.

    The fits are as they were where neither errors nor nominal bodies show any. E[EᵀE] β of errors
    E of the columns is noise, shape (r,); see `attenuation`.
    """
    robot = rows.robot
    seen, noisy = _seen(rows, fit, noise)
    sigma = np.broadcast_to(physical.prior.sigma, robot.nv)
    moved = sigma > sigma.min()
    # at the last link, a tool that the description lacks
    if not seen and not moved[:-1].any():
        return fit, physical, ()
    end = rows.regression.p
    wide = _with_all_terms(rows)
    R, z = wide.factor(noisy.weight)
    bodies = physical.prior.bodies
    own = [robot.nv + j for j in seen]
    of_links, of_joints = np.split(agreement(R, z, bodies, len(TERMS), own), 2)
    instead = moved & (of_links == of_links.min())
    joints = np.flatnonzero(of_joints) if instead.any() else np.array([*seen], int)
    if not len(joints):
        return fit, physical, ()
    terms = end + np.arange(robot.nv * len(TERMS)).reshape(robot.nv, -1)
    at = terms[joints].ravel()
    at = at[R[:, at].any(axis=0)]
    own_std = np.repeat(of_joints, len(TERMS)).reshape(terms.shape)
    # where it is at rest no motion shows: it may hold all of the joint's torque
    own_std[:, -1] = 1 / AGREEMENT.least
    distance = link_weights(robot.nv, of_links)[:, None]
    prior = scipy.linalg.block_diag(
        distance * np.linalg.inv(link_coordinates(bodies)),
        np.zeros((0, end - bodies.size)),
        np.diag(1 / own_std.ravel()[at - end]),
    )
    off = z - R[:, : bodies.size] @ bodies.ravel()
    root = _second_moment(
        np.vstack([R[:, [*range(end), *at]], prior]),
        np.append(off, np.zeros(len(prior))),
        len(at),
    )
    torque = wide.select(at.tolist()).torque(root[:, 0]).std(axis=0)
    links = tuple(np.array(robot.links)[instead].tolist())
    r = len(fit.beta)
    gram = wide.select([*rows.base.columns, *at]).gram(fit.sigma**-2.0)
    of_base = np.linalg.solve(gram[:r, :r], gram[:r, r:-1]) @ root
    gram = wide.gram(fit.weight**2)
    of_all = physical.covariance @ gram[:end, at] @ root
    covariance = physical.covariance + of_all @ of_all.T
    stiffness = dict.fromkeys(joints.tolist(), "") | seen
    return (
        replace(fit, bias=read_only(of_base)),
        replace(physical, covariance=covariance, undecided=links),
        (_sentence(robot, stiffness, torque, links),),
    )


def _sentence(
    robot: Robot, stiffness: dict[int, str], torque: Array, instead: Sequence[str]
) -> str:
    """What is told of springs at joints that hold a torque, (nv,), with stiffness where seen."""
    listed = ", ".join(
        f"{robot.joints[j]} ({torque[j]:.3g} {robot.torque_unit(joint=j)} rms{linear})"
        for j, linear in stiffness.items()
    )
    depends = "depends" if any(stiffness.values()) else "may depend"
    parts = [
        f"torque of {listed} {depends} on position as of a spring, counterbalance or cable, which "
        "the model lacks"
    ]
    if instead:
        test = EFFECTS["spring"].words.separated_by["inertial_parameters"]
        parts.append(
            f"with it the data agree with the given values of {', '.join(instead)}, which the fit "
            f"moved in its place; to decide between both, {test}"
        )
    parts.append(
        "the ± of all that could take its place are as much wider; `--effects auto` or `excitant "
        "diagnose` looks for it"
    )
    return "; ".join(parts)


def _second_moment(A: Array, b: Array, last: int) -> Array:
    """Root of the second moment of the last parameters by rows A x ≈ b, their mean first.

    Shape (last, p + 1), the other columns being a root of the covariance.
    """
    norms = np.linalg.norm(A, axis=0)
    norms = np.where(norms > 0, norms, 1.0)
    U, s, Vt = np.linalg.svd(A / norms, full_matrices=False)
    inverse = np.divide(1.0, s, out=np.zeros_like(s), where=s > DEPENDENT * s[0])
    root = Vt.T * inverse / norms[:, None]
    return np.column_stack([root @ (U.T @ b), root])[-last:]


def _linear(rows: FitRows) -> Array:
    """Columns of linear springs relaxed amid their motion, shape (n, nv, nv) [rad or m]."""
    q = states(rows.data.train)[0]
    used = rows.used
    centre = (q * used).sum(axis=0) / np.maximum(used.sum(axis=0), 1)
    return ((q - centre) * used)[:, :, None] * np.eye(rows.robot.nv)


def _with_all_terms(rows: FitRows) -> Regression:
    """The regression with `TERMS` of each joint, a share `Agreement.least` of its torque."""
    q = states(rows.data.train)[0]
    joints = range(rows.robot.nv)
    linear = _linear(rows)[:, joints, joints]
    rms = np.sqrt((linear**2).mean(axis=0))
    linear = np.divide(linear, rms, out=np.zeros_like(linear), where=rms > 0)
    lever = rows.used * rows.robot.revolute
    terms = [linear, lever * np.cos(q), lever * np.sin(q), rows.used]
    size = AGREEMENT.least * np.sqrt((rows.tau**2).mean(axis=0))
    columns = np.zeros((*q.shape, len(joints), len(TERMS)))
    columns[:, joints, joints] = np.stack(terms, axis=2) * size[:, None]
    names = [f"{joint} {term}" for joint in rows.robot.joints for term in TERMS]
    return rows.regression.with_columns(columns.reshape(*q.shape, -1), names)


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
    chance = -float(scipy.special.ndtri(FALSE_ALARM / (2 * robot.nv)))
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
        std = float(np.hypot(wider.std[-1], bias[surest]))
        if not abs(stiffness) > chance * std:
            break
        best = wider
        j = surest - r
        per = f"{robot.torque_unit(joint=j)}/{'rad' if robot.revolute[j] else 'm'}"
        found[j] = f", {stiffness:.3g} ± {std:.2g} {per}"
    return found, best


def _alone(
    problem: Regression, at: Sequence[int], beta: Array, sigma: Array, noise: Array
) -> tuple[Array, Array]:
    """Scores of single columns beside some, fitted with β, and bias of their coefficients, (p,).

    Errors have the standard deviation sigma, shape (nv,); noise of the motion adds the bias.
    """
    gram = problem.gram(sigma**-2.0)[:-1, :-1]
    B = np.linalg.solve(gram[np.ix_(at, at)], gram[at])
    fitted = np.zeros(problem.p)
    fitted[list(at)] = beta
    error = problem.residual(fitted) / sigma
    scores = np.zeros(problem.p)
    bias = np.zeros(problem.p)
    for k in np.setdiff1d(np.arange(problem.p), at).tolist():
        x = np.zeros(problem.p)
        x[list(at)] = -B[:, k]
        x[k] = 1.0
        beyond = problem.torque(x) / sigma
        power = float((beyond**2).sum())
        if not power > DEPENDENT * gram[k, k]:
            continue
        score = float((beyond * error).sum())
        products = beyond * (error - score / power * beyond)
        times = [autocorrelation_time(column) for column in products.T]
        attenuated = float(x[: len(noise)] @ noise)
        variance = (products**2).sum(axis=0) @ times + attenuated**2
        scores[k] = score / np.sqrt(variance)
        bias[k] = attenuated / power
    return scores, bias
