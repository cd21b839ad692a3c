"""The extended model: effects added, everything re-identified physically consistently."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from excitant.analysis.evidence import Candidate, Evidence
from excitant.analysis.hypotheses import TOLERANCE, WRONG_LINK, coefficient_sizes
from excitant.analysis.observed import Observed
from excitant.analysis.sticking import sliding
from excitant.identify.physical import EffectPrior, fit_physical
from excitant.identify.resting import identified_robot
from excitant.robots.effects import Effect, InertialParameters, JointwiseEffect, Payload
from excitant.robots.motion import Array, read_only
from excitant.robots.parameters import from_pseudo_inertia, isotropic
from excitant.robots.robot import Robot
from excitant.robots.torque import effect_values

_PAYLOAD_SIGMA = 100.0  # a payload is anything
_PAYLOAD_SHARE, _PAYLOAD_RADIUS = 0.05, 0.1  # of the arm's mass, m: its reference body


@dataclass(frozen=True, eq=False)
class Extension:
    """An extended model with the covariance of what was fitted.

    Attributes:
        model: The given robot with re-identified inertias and effects, those found included.
        std: Standard deviation of each effect coefficient by parameter name.
        link_std: Standard deviation of the standard parameters, shape (10 nv,).
    """

    model: Robot
    std: dict[str, float]
    link_std: Array


def extend(
    robot: Robot,
    prior: Array,
    evidence: Evidence,
    chosen: Sequence[Candidate],
    train: Observed,
    tau: Array,
) -> Extension:
    """Fit the given robot plus the chosen causes to a recording.

    What was found wrong is free; everything else stays within the tolerance of its given value.

    Args:
        robot: The given robot.
        prior: Standard parameters of the given robot as prior, shape (nv, 10).
        evidence: Noise levels.
        chosen: Causes found.
        train: What to fit, of the robot as understood so far.
        tau: Measured torque at the rows, shape (n, nv) [N·m].
    """
    effects = _effects(robot, chosen)
    W = train.matrix(effects)
    weight = sliding(train.segments) / (evidence.sigma * np.sqrt(evidence.inflation))
    rows = (np.concatenate([W, tau[:, :, None]], axis=2) * weight[:, :, None]).reshape(
        -1, W.shape[2] + 1
    )
    R = np.asarray(np.linalg.qr(rows, mode="r"), float)
    bodies, sigma = _bodies(robot, prior, chosen, evidence.tolerance[0])
    start = 10 * len(bodies)
    fit = fit_physical(
        R[:, :-1],
        R[:, -1],
        bodies,
        _effect_prior(robot, effects, chosen, W[:, :, start:], tau, evidence.tolerance[1]),
        sigma,
        tolerance_metric(bodies),
    )
    std = np.sqrt(np.diag(fit.covariance))
    links, names = 10 * robot.nv, [p.name for e in effects for p in e.parameters(robot)]
    deviations = dict(zip(names, std[links:].tolist(), strict=True))
    model = identified_robot(robot, effects, fit.x)
    return Extension(model, deviations, read_only(std[:links]))


def _effects(robot: Robot, chosen: Sequence[Candidate]) -> list[Effect]:
    """A payload first, then the given effects, then those found on joints that had none."""
    has = {p.name for e in robot.effects for p in e.parameters(robot)}
    found = [c.effect for c in chosen if not isinstance(c.effect, InertialParameters)]
    payloads: list[Effect] = [e for e in found if isinstance(e, Payload)]
    added = [
        e
        for e in found
        if not isinstance(e, Payload) and not {p.name for p in e.parameters(robot)} <= has
    ]
    return [*payloads, *robot.effects, *merged(added)]


def merged(effects: Sequence[Effect]) -> list[Effect]:
    """Effects of one kind and shape as one effect on several joints."""
    kinds: dict[Effect, list[str]] = {}
    for effect in effects:
        if isinstance(effect, JointwiseEffect):
            kinds.setdefault(replace(effect, joints=(), values=None), []).extend(effect.joints)
    together: list[Effect] = [replace(kind, joints=tuple(js)) for kind, js in kinds.items()]
    return together + [e for e in effects if not isinstance(e, JointwiseEffect)]


def tolerance_metric(bodies: Array) -> Array:
    """What ten per cent of a link is ten per cent of, shape (links, 10)."""
    return np.array([isotropic(phi) for phi in bodies])


def _bodies(
    robot: Robot, prior: Array, chosen: Sequence[Candidate], tolerance: float
) -> tuple[Array, Array]:
    """Prior and its relative uncertainty for every link, and for a payload when there is one."""
    wrong = {c.effect.joints[0] for c in chosen if isinstance(c.effect, InertialParameters)}
    sigma = [WRONG_LINK if joint in wrong else tolerance * TOLERANCE for joint in robot.joints]
    if not any(isinstance(c.effect, Payload) for c in chosen):
        return prior, np.array(sigma)
    mass = _PAYLOAD_SHARE * prior[:, 0].sum()
    reference = from_pseudo_inertia(mass * np.diag([*(_PAYLOAD_RADIUS**2,) * 3, 1.0]))
    return np.vstack([prior, reference]), np.array([*sigma, _PAYLOAD_SIGMA])


def _effect_prior(
    robot: Robot,
    effects: Sequence[Effect],
    chosen: Sequence[Candidate],
    columns: Array,
    tau: Array,
    tolerance: float,
) -> EffectPrior:
    """Given coefficients within tolerance; those found, free."""
    free = {p.name for c in chosen for p in c.effect.parameters(robot)}
    scalar = [e for e in effects if not isinstance(e, Payload)]
    parameters = [p for e in scalar for p in e.parameters(robot)]
    given = [v for e in scalar for v in (e.values or (0.0,) * len(e.parameters(robot)))]
    open_std = coefficient_sizes(parameters, columns, tau)
    mean = np.array(given)
    tight = np.maximum(tolerance * TOLERANCE * np.abs(mean), 1e-9)
    loose = np.array([p.name in free for p in parameters], dtype=bool)
    return EffectPrior(
        mean=mean,
        std=np.where(loose, open_std, tight),
        lower=np.array([p.lower for p in parameters]),
    )


def contribution(robot: Robot, effect: Effect, extended: Observed) -> Array:
    """Torque that one cause adds to the given model at the rows, shape (n, nv) [N·m].

    Args:
        robot: The given robot.
        effect: The cause.
        extended: Rows of the extended model.
    """
    model = extended.robot
    if isinstance(effect, InertialParameters):
        j = robot.joint_index(effect.joints[0])
        part = slice(10 * j, 10 * j + 10)
        values = model.phi[part] - robot.phi[part]
    else:
        fitted, given = (effect_values(owner) for owner in (model, robot))
        names = [p.name for p in effect.parameters(robot)]
        values = np.array([fitted[name] - given.get(name, 0.0) for name in names])
    torque: Array = extended.columns(effect) @ values
    return torque
