"""Accuracy of the given model: share explained by inertias alone, and forward simulation.

Inertias alone, all given effects kept:

    τ − τ_effects ≈ W β     least squares of the links' base parameters, and
    β = B φ, P(φ_k) ≻ 0     the nearest bodies that have them, if any

The unconstrained fit is tested for physical consistency by its distance from the nearest consistent
values, χ² distributed if it is consistent. The change of each link is the smallest, in units of the
tolerance of given values, that explains as much.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from excitant.analysis.candidates import TOLERANCE, Observed
from excitant.analysis.confirmation import HeldOut
from excitant.exceptions import BadInput
from excitant.identify.least_squares import SMALLEST, autocorrelation_time
from excitant.identify.physical import fit_physical
from excitant.identify.preprocessing import Mask, Segment, away_from_rest
from excitant.identify.prior import (
    BodyPrior,
    EffectPrior,
    link_coordinates,
    link_weights,
    prior_parameters,
)
from excitant.identify.regression import Regression, dense
from excitant.robots.base_parameters import base_parameters
from excitant.robots.effects import Effect, plain
from excitant.robots.motion import Array, Motion
from excitant.robots.parameters import pseudo_inertia
from excitant.robots.robot import Robot
from excitant.robots.simulation import LOOP_HZ, Diverged, forward_error, forward_model

# times the tolerance's standard deviation: beyond it, given values are wrong
LIKELY = 3.0
_ROUNDS = 4  # of fitting with the noise of the fit before
_FREE = 30.0  # relative size of changes that only consistency restricts
_WEAK = 1.0  # relative size of changes in the search for the smallest one
# of the largest singular value: directions that the motion does not show
_DEPENDENT = 1e-6
_CERTAIN = 0.99  # probability that physically consistent values lie nearer
_HARDLY = 0.1  # of the squared error: less explains nothing

_WINDOW = 0.6  # s: fifteen time constants of the stabilising loop
_WINDOWS = 4  # at least, spread over the hold-out, where it is long enough
_COARSE = 2e-3  # s: longest step of integration, a twentieth of that time constant


@dataclass(frozen=True)
class Move:
    """Change of one link that would explain the error."""

    link: str
    mass: float  # change [kg]
    centre: float  # distance that its centre of mass moves [m]
    inertia: (
        float  # logarithm of the factor on its mean moment about the centre of mass
    )
    deviations: dict[str, float]  # of each of the three, over the std of given values

    @property
    def most(self) -> float:
        """The largest of the deviations."""
        return max(self.deviations.values())

    @property
    def sentence(self) -> str:
        """The change that deviates most."""
        would = f"of {self.link} would have to"
        return {
            "mass": f"the mass {would} change by {self.mass:+.2g} kg",
            "centre": f"the centre of mass {would} move {1e3 * self.centre:.0f} mm",
            "inertia": f"the inertia {would} change by {100 * np.expm1(self.inertia):+.0f} %",
        }[max(self.deviations, key=self.deviations.__getitem__)]

    def result(self) -> dict[str, Any]:
        """Entry of result.json."""
        return {
            "link": self.link,
            "mass_kg": self.mass,
            "centre_mm": 1e3 * self.centre,
            "inertia": self.inertia,
            "deviations": self.deviations,
        }


@dataclass(frozen=True, eq=False)
class Refit:
    """The given model with inertias fitted anew and its effects kept.

    ``errors`` are rms on the hold-out while joints move, each of shape (nv,) [torque unit]: of the
    ``given`` model, of free ``inertias``, of the nearest ``bodies`` and of the ``extended`` model.
    """

    errors: Mapping[str, Array]
    spread: Array  # standard deviation of the measured torque, shape (nv,)
    possible: (
        bool  # whether the unconstrained fit is physically consistent but for chance
    )
    distance: (
        float  # of that fit from consistent values, relative to what chance allows
    )
    moves: tuple[Move, ...]  # of each link

    @property
    def most_moved(self) -> Move:
        """The link that would have to change most, in units of the tolerance."""
        return max(self.moves, key=lambda move: move.most)

    @property
    def gain(self) -> float:
        """Share of the squared error that free inertias remove, joints relative to torque."""
        sizes = {
            name: (e / np.maximum(self.spread, 1e-12))
            for name, e in self.errors.items()
        }
        left, given = (
            float((sizes[name] ** 2).sum()) for name in ("inertias", "given")
        )
        return 1 - left / max(given, 1e-300)

    def sentence(
        self,
        joints: Sequence[str],
        unit: str,
        findings: bool,
        wrong_links: Collection[str],
    ) -> str:
        """Refit of the inertias alone, and its plausibility."""
        worst = int(np.argmax(self.errors["given"] / np.maximum(self.spread, 1e-12)))
        given, free, extended = (
            f"{self.errors[name][worst]:.3g}"
            for name in ("given", "inertias", "extended")
        )
        quoted = f"{joints[worst]} from {given} to {free} {unit}"
        if findings:
            quoted += f"; with the findings {extended}"
        if self.gain < _HARDLY:
            what = "would not help" if self.gain < 0 else "would hardly help"
            return (
                f"Re-fitting the inertias alone {what} on the hold-out "
                f"({quoted}): the cause is not in their values."
            )
        said = (
            f"Re-fitting the inertias alone would remove {100 * self.gain:.0f} % of the squared "
            f"error on the hold-out ({quoted})"
        )
        if not self.possible:
            impossible = "only physically inconsistent inertias would achieve this"
            return f"{said}, but {impossible}: the cause is elsewhere."
        move = self.most_moved
        if move.most <= LIKELY:
            return f"{said}, within the tolerance of the given values."
        far = f"{said}, but {move.sentence} ({move.most:.0f} standard deviations of a given value)"
        if move.link in wrong_links:
            return f"{far}: that link is among the findings."
        return f"{far}: unless that link is that far off, the cause is elsewhere."

    def result(self, joints: Sequence[str]) -> dict[str, Any]:
        """Entries of result.json."""
        return {
            "joints": [
                {
                    "name": joint,
                    **{key: float(each[j]) for key, each in self.errors.items()},
                }
                for j, joint in enumerate(joints)
            ],
            "possible": self.possible,
            "distance": self.distance,
            "most_moved": self.most_moved.link,
            "links": [
                move.result()
                for move in sorted(self.moves, key=lambda move: -move.most)
            ],
        }


def refit(train: Observed, tau: Array, held: HeldOut, extended: Array) -> Refit:
    """Fit the inertias alone to torque tau [N·m], and judge them beside the extended model."""
    robot = train.robot
    Y = train.links
    Yv = held.observed.links
    base = base_parameters(robot)
    prior = prior_parameters(robot)
    B = base.regrouping
    rest = tau - (train.torque() - Y @ robot.phi)
    W = Y[:, :, base.columns]
    problem = dense(W, rest, base.expressions)
    root, beta, rank = _least_squares(problem, away_from_rest(train.segments))
    nothing = EffectPrior(*(np.zeros(0),) * 3)
    free, least = (
        fit_physical(root @ B, root @ beta, BodyPrior(prior, sigma), nothing).x
        for sigma in (_FREE, _WEAK)
    )
    distance = float(((root @ (B @ free - beta)) ** 2).sum())
    allowed = float(scipy.special.chdtri(rank, 1 - _CERTAIN))
    left = held.given + Yv @ robot.phi / held.gains
    errors = {
        "given": held.given,
        "inertias": left - Yv[:, :, base.columns] @ beta / held.gains,
        "bodies": left - Yv @ least / held.gains,
        "extended": held.series.measured - extended,
    }
    return Refit(
        {name: held.series.rms(error) for name, error in errors.items()},
        spread=held.series.measured.std(axis=0, where=held.series.counts),
        possible=distance <= allowed,
        distance=distance / allowed,
        moves=_moves(robot, prior, least.reshape(-1, 10)),
    )


def _least_squares(problem: Regression, counts: Mask) -> tuple[Array, Array, int]:
    """Root of the information on base parameters, their estimate, and its rank."""
    # directions that the motion does not show get the least norm and no information
    problem = problem.counting(counts)
    counted = np.maximum(counts.sum(axis=0), 1)
    scale = np.linalg.norm(problem.factor(np.ones(problem.nv))[0], axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    sigma = problem.tau.std(axis=0)
    for _ in range(_ROUNDS):
        R, z = problem.factor(1 / np.maximum(sigma, SMALLEST))
        beta, _, rank, _ = np.linalg.lstsq(R / scale, z, rcond=_DEPENDENT)
        error = problem.residual(beta / scale)
        slow = np.array([autocorrelation_time(column) for column in error.T])
        sigma = np.sqrt((error**2).sum(axis=0) / counted * slow)
    return R, np.asarray(beta / scale, float), int(rank)


def _moves(robot: Robot, prior: Array, found: Array) -> tuple[Move, ...]:
    moves = []
    for link, before, after in zip(robot.links, prior, found, strict=True):
        spread = link_coordinates(before[None]) / link_weights(1, TOLERANCE)
        root = _slopes(before) @ spread
        covariance = root @ root.T
        change = _figures(after) - _figures(before)
        shift = float(np.linalg.norm(change[1:4]))
        way = change[1:4] / max(shift, 1e-300)
        stds = np.sqrt(
            [covariance[0, 0], way @ covariance[1:4, 1:4] @ way, covariance[4, 4]]
        )
        size = {"mass": float(change[0]), "centre": shift, "inertia": float(change[4])}
        far = {
            name: abs(x) / max(float(s), 1e-300)
            for (name, x), s in zip(size.items(), stds, strict=True)
        }
        moves.append(Move(link, **size, deviations=far))
    return tuple(moves)


def _figures(phi: Array) -> Array:
    """Mass, centre of mass and logarithm of the mean central moment of a link, shape (5,)."""
    P = pseudo_inertia(phi)
    centre = P[:3, 3] / P[3, 3]
    central = np.trace(P[:3, :3]) - P[3, 3] * (centre @ centre)
    return np.array([P[3, 3], *centre, np.log(max(float(central), 1e-12 * P[3, 3]))])


def _slopes(phi: Array) -> Array:
    m = phi[0]
    centre = phi[1:4] / phi[0]
    J = np.zeros((5, 10))
    J[0, 0] = 1.0
    J[1:4, 0], J[1:4, 1:4] = -centre / m, np.eye(3) / m
    J[4, 0] = centre @ centre
    J[4, 1:4] = -2 * centre
    J[4, [4, 6, 9]] = 0.5
    J[4] /= np.exp(_figures(phi)[4])
    return J


@dataclass(frozen=True, eq=False)
class Simulated:
    """A model simulated forward over windows of the hold-out; rms errors of joints, (nv,)."""

    position: Array  # [rad or m]; NaN where it diverges
    velocity: Array  # [rad/s or m/s]
    diverged: str  # why the simulation was stopped; empty when it was not
    along: tuple[
        str, ...
    ]  # effects of sensors or with memory, evaluated on the recorded motion


@dataclass(frozen=True, eq=False)
class Forward:
    """The given and the extended model, simulated alike."""

    given: Simulated
    extended: Simulated
    windows: int  # number of windows
    seconds: float  # length of each [s]

    def result(self, robot: Robot) -> dict[str, Any]:
        """Entries of result.json."""
        units = ["rad" if turns else "m" for turns in robot.revolute]
        models = {"given": self.given, "extended": self.extended}
        notes = []
        for name, model in models.items():
            if model.diverged:
                notes.append(
                    f"Simulation of the {name} model was stopped: {model.diverged}."
                )
            elif model.along:
                along = ", ".join(map(plain, model.along))
                notes.append(
                    f"In the {name} model, torque of {along} was evaluated on the recorded motion."
                )
        rows = []
        for j, (joint, unit) in enumerate(zip(robot.joints, units, strict=True)):
            far, fast = (
                {name: float(getattr(model, what)[j]) for name, model in models.items()}
                for what in ("position", "velocity")
            )
            velocity = {**fast, "unit": f"{unit}/s"}
            rows.append({"name": joint, **far, "unit": unit, "velocity": velocity})
        return {
            "joints": rows,
            "windows": self.windows,
            "window_s": self.seconds,
            "bandwidth_hz": LOOP_HZ,
            "notes": notes,
        }


def forward(
    given: Robot, extended: Robot, segments: Sequence[Segment], gains: Array
) -> Forward:
    """Simulate two models forward over short windows of the hold-out; gains are (nv,)."""
    found = windows(segments)
    return Forward(
        _simulated(given, gains, found),
        _simulated(extended, gains, found),
        windows=len(found),
        seconds=float(np.mean([motion.t[-1] - motion.t[0] for motion, _ in found])),
    )


def windows(segments: Sequence[Segment]) -> list[tuple[Motion, Array]]:
    """Motion and torque of short stretches spread over segments, the filter's edges left out."""
    longest = sorted(segments, key=lambda s: -len(s.motion))[:_WINDOWS]
    each = -(-_WINDOWS // len(longest))
    found = []
    for s in longest:
        first, stop, _ = s.keep.indices(len(s.motion))
        size = min(round(_WINDOW * s.rate_hz) + 1, stop - first)
        count = max(1, min(each, (stop - first) // size))
        for start in np.linspace(first, stop - size, count).astype(int):
            part = slice(int(start), int(start) + size)
            found.append((s.motion[part], s.tau[part]))
    return found


def _simulated(
    robot: Robot, gains: Array, found: list[tuple[Motion, Array]]
) -> Simulated:
    kept = [effect for effect in robot.effects if _simulable(robot, effect)]
    along = [effect for effect in robot.effects if effect not in kept]
    model = robot.with_effects(kept)
    names = tuple(dict.fromkeys(e.name for e in along))
    nothing = np.full(robot.nv, np.nan)
    errors = []
    for motion, reading in found:
        tau = reading * gains - sum(e.torque(robot, motion) for e in along)
        try:
            moved = forward_error(model, motion, tau, step=_COARSE)
        except Diverged as error:
            return Simulated(nothing, nothing, f"{error.joint} diverges", names)
        errors.append(np.stack([moved.error, motion.dq - moved.motion.dq]))
    rms = np.sqrt((np.concatenate(errors, axis=1) ** 2).mean(axis=1))
    return Simulated(rms[0], rms[1], "", names)


def _simulable(robot: Robot, effect: Effect) -> bool:
    """Whether forward simulation supports an effect."""
    with suppress(BadInput):
        return (
            effect.physics.of_state
            and forward_model(robot.with_effects([effect])) is not None
        )
    return False
