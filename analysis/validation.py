"""How good the given model is: what wrong inertias alone would explain, and forward simulation.

Inertias alone, all given effects kept:

    τ − τ_effects ≈ W β     least squares of the links' base parameters, and
    β = B φ, P(φ_k) ≻ 0     the nearest bodies that have them, if any

The unconstrained fit says how far inertias can go at most; whether bodies can have its values is
decided by their distance from the nearest consistent ones under their covariance, which is χ²
distributed when they can. How far each link would have to move is the least change, in units of
the tolerance of given values, that explains what inertias can explain.

Forward: the recorded torque drives a model over short windows, and one slow loop holds it on the
recorded motion (`excitant.robots.simulation.forward_error`).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from excitant.analysis.candidates import TOLERANCE, Observed, tolerance_metric
from excitant.analysis.confirmation import HeldOut
from excitant.analysis.residuals import Mask, moving
from excitant.exceptions import BadInput
from excitant.identify.least_squares import SMALLEST, autocorrelation_time
from excitant.identify.physical import fit_physical
from excitant.identify.preprocessing import Segment
from excitant.identify.prior import EffectPrior, link_coordinates, link_weights, prior_parameters
from excitant.robots.base_parameters import base_parameters
from excitant.robots.effects import Effect, plain
from excitant.robots.motion import Array, Motion, freeze
from excitant.robots.parameters import pseudo_inertia
from excitant.robots.robot import Robot
from excitant.robots.simulation import LOOP_HZ, Diverged, forward_error, forward_model

LIKELY = 3.0  # times the tolerance's standard deviation: farther off, given values are wrong
_ROUNDS = 3  # of estimating the noise
_FREE = 30.0  # relative size of changes that nothing but consistency holds back
_WEAK = 1.0  # relative size of changes where the least one is looked for
_DEPENDENT = 1e-6  # of the largest singular value: what the motion does not show
_CERTAIN = 0.99  # that values which bodies can have lie nearer
_HARDLY = 0.1  # of the squared error: less is no explanation

_WINDOW = 0.6  # s: fifteen time constants of the loop that holds a model
_WINDOWS = 4  # at least, spread over the hold-out, where it is long enough
_COARSE = 2e-3  # s: longest step of integration, a twentieth of that time constant


@dataclass(frozen=True)
class Move:
    """How far one link would have to change.

    Attributes:
        link: Name.
        mass: Change of its mass [kg].
        centre: Distance its centre of mass moves [m].
        inertia: Logarithm of the factor by which its mean moment of inertia about the centre of
            mass changes.
        deviations: Each of the three over the standard deviation of given values.
    """

    link: str
    mass: float
    centre: float
    inertia: float
    deviations: dict[str, float]

    @property
    def most(self) -> float:
        """The largest of the deviations."""
        return max(self.deviations.values())

    @property
    def sentence(self) -> str:
        """The change that deviates most."""
        which = max(self.deviations, key=self.deviations.__getitem__)
        if which == "mass":
            return f"the mass of {self.link} would have to change by {self.mass:+.2g} kg"
        if which == "centre":
            far = f"{1e3 * self.centre:.0f} mm"
            return f"the centre of mass of {self.link} would have to move {far}"
        change = 100 * (np.exp(self.inertia) - 1)
        return f"the inertia of {self.link} would have to change by {change:+.0f} %"


@dataclass(frozen=True, eq=False)
class Refit:
    """The given model with inertias fitted anew and its effects kept.

    Errors are rms on the hold-out while the joint moves, each of shape (nv,) [torque unit].

    Attributes:
        given: Error of the given model.
        free: Error of the unconstrained fit.
        physical: Error of the nearest bodies.
        extended: Error of the extended model.
        spread: Standard deviation of the measured torque.
        possible: Whether bodies can have the values of the unconstrained fit.
        distance: How far these are from what bodies can have, over what chance allows.
        moves: How far each link would have to change.
    """

    given: Array
    free: Array
    physical: Array
    extended: Array
    spread: Array
    possible: bool
    distance: float
    moves: tuple[Move, ...]

    def __post_init__(self) -> None:
        freeze(self, "given", "free", "physical", "extended", "spread")

    @property
    def most_moved(self) -> Move:
        """The link that would have to change most, in units of the tolerance."""
        return max(self.moves, key=lambda move: move.most)

    @property
    def gain(self) -> float:
        """Share of the squared error that free inertias take off, joints relative to torque."""
        left, given = (
            float(((error / np.maximum(self.spread, 1e-12)) ** 2).sum())
            for error in (self.free, self.given)
        )
        return 1 - left / max(given, 1e-300)

    def sentence(
        self, joints: Sequence[str], unit: str, findings: bool, wrong_links: Collection[str]
    ) -> str:
        """What re-fitting the inertias alone would do, and whether it is believable.

        Args:
            joints: Names.
            unit: Of torque.
            findings: Whether the diagnosis has any.
            wrong_links: Links among them.
        """
        worst = int(np.argmax(self.given / np.maximum(self.spread, 1e-12)))
        quoted = f"{joints[worst]} from {self.given[worst]:.3g} to {self.free[worst]:.3g} {unit}"
        if findings:
            quoted += f"; with the findings {self.extended[worst]:.3g}"
        if self.gain < _HARDLY:
            what = "would not help" if self.gain < 0 else "would hardly help"
            return (
                f"Re-fitting the inertias alone {what} on the hold-out "
                f"({quoted}): the cause is not in their values."
            )
        said = (
            f"Re-fitting the inertias alone would take {100 * self.gain:.0f} % of the squared "
            f"error off the hold-out ({quoted})"
        )
        if not self.possible:
            impossible = "no bodies can have the values that this takes"
            return f"{said}, but {impossible}: the cause is elsewhere."
        move = self.most_moved
        if move.most <= LIKELY:
            return f"{said}, within what given values may be off."
        far = f"{said}, but {move.sentence} ({move.most:.0f} standard deviations of a given value)"
        if move.link in wrong_links:
            return f"{far}: that link is among the findings."
        return f"{far}: unless that link is so wrong, the cause is elsewhere."

    def result(self, joints: Sequence[str]) -> dict[str, Any]:
        """Entries of result.json."""
        models = {
            "given": self.given,
            "inertias": self.free,
            "bodies": self.physical,
            "extended": self.extended,
        }
        return {
            "joints": [
                {"name": joint, **{key: float(each[j]) for key, each in models.items()}}
                for j, joint in enumerate(joints)
            ],
            "possible": self.possible,
            "distance": self.distance,
            "most_moved": self.most_moved.link,
            "links": [
                {
                    "link": move.link,
                    "mass_kg": move.mass,
                    "centre_mm": 1e3 * move.centre,
                    "inertia": move.inertia,
                    "deviations": move.deviations,
                }
                for move in sorted(self.moves, key=lambda move: -move.most)
            ],
        }


def refit(train: Observed, tau: Array, held: HeldOut, extended: Array) -> Refit:
    """Fit the inertias alone to what was fitted, and judge that on the hold-out.

    Args:
        train: What was fitted, of the given robot.
        tau: Measured torque at its rows, shape (n, nv) [N·m].
        held: The hold-out.
        extended: Torque of the extended model there [torque unit].

    Raises:
        BadRobot: A link without mass.
        Infeasible: The semidefinite solver failed.
    """
    robot, Y, Yv = train.robot, train.links, held.observed.links
    base, prior = base_parameters(robot), prior_parameters(robot)
    B = base.regrouping
    rest = tau - (train.torque() - Y @ robot.phi)
    root, beta, rank = _least_squares(Y[:, :, base.columns], rest, moving(train.segments))
    nothing = EffectPrior(*(np.zeros(0),) * 3)
    free, least = (
        fit_physical(root @ B, root @ beta, prior, nothing, sigma, tolerance_metric(prior)).x
        for sigma in (_FREE, _WEAK)
    )
    distance = float(((root @ (B @ free - beta)) ** 2).sum())
    allowed = float(scipy.stats.chi2.ppf(_CERTAIN, rank))
    left = held.given + Yv @ robot.phi / held.gains
    return Refit(
        given=held.rms(held.given),
        free=held.rms(left - Yv[:, :, base.columns] @ beta / held.gains),
        physical=held.rms(left - Yv @ least / held.gains),
        extended=held.rms(held.series.measured - extended),
        spread=held.series.measured.std(axis=0),
        possible=distance <= allowed,
        distance=distance / allowed,
        moves=_moves(robot, prior, least.reshape(-1, 10)),
    )


def _least_squares(W: Array, tau: Array, counts: Mask) -> tuple[Array, Array, int]:
    """Root of the information on base parameters, shape (r, r), their estimate, and its rank.

    What the motion does not show stays at its smallest size and has no information.
    """
    W, tau = W * counts[:, :, None], tau * counts
    scale = np.sqrt((W**2).sum(axis=(0, 1)))
    scale = np.where(scale > 0, scale, 1.0)
    sigma, rounds = tau.std(axis=0), 0
    while True:
        weight = 1 / np.maximum(sigma, SMALLEST)
        rows = (W / scale * weight[:, None]).reshape(-1, W.shape[2])
        Q, R = scipy.linalg.qr(rows, mode="economic")
        beta, _, rank, _ = np.linalg.lstsq(R, Q.T @ (tau * weight).ravel(), rcond=_DEPENDENT)
        if rounds == _ROUNDS:
            return np.asarray(R * scale, float), np.asarray(beta / scale, float), int(rank)
        error = tau - W @ (beta / scale)
        size = np.sqrt((error**2).sum(axis=0) / np.maximum(counts.sum(axis=0), 1))
        slow = np.array([autocorrelation_time(column) for column in error.T])
        sigma, rounds = size * np.sqrt(slow), rounds + 1


def _moves(robot: Robot, prior: Array, found: Array) -> tuple[Move, ...]:
    """Change of each link; given values have the covariance spread · spreadᵀ."""
    moves = []
    metric = tolerance_metric(prior)
    for link, before, after, body in zip(robot.links, prior, found, metric, strict=True):
        spread = link_coordinates(body[None]) / link_weights(1, TOLERANCE)
        root = _slopes(before) @ spread
        covariance, change = root @ root.T, _figures(after) - _figures(before)
        shift = float(np.linalg.norm(change[1:4]))
        way = change[1:4] / max(shift, 1e-300)
        stds = np.sqrt([covariance[0, 0], way @ covariance[1:4, 1:4] @ way, covariance[4, 4]])
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
    """Derivatives of `_figures`, shape (5, 10)."""
    m, centre = phi[0], phi[1:4] / phi[0]
    J = np.zeros((5, 10))
    J[0, 0] = 1.0
    J[1:4, 0], J[1:4, 1:4] = -centre / m, np.eye(3) / m
    J[4, 0], J[4, 1:4] = centre @ centre, -2 * centre
    J[4, [4, 6, 9]] = 0.5
    J[4] /= np.exp(_figures(phi)[4])
    return J


@dataclass(frozen=True, eq=False)
class Simulated:
    """A model simulated forward over windows of the hold-out.

    Attributes:
        position: Rms error of position per joint, shape (nv,) [rad or m]; NaN where it diverges.
        velocity: Rms error of velocity per joint, shape (nv,) [rad/s or m/s].
        diverged: Why the simulation was given up, empty when it was not.
        along: Effects whose torque was taken on the recorded motion: those of sensors, and those
            that depend on the past.
    """

    position: Array
    velocity: Array
    diverged: str
    along: tuple[str, ...]

    def __post_init__(self) -> None:
        freeze(self, "position", "velocity")


@dataclass(frozen=True, eq=False)
class Forward:
    """The given and the extended model, simulated alike.

    Attributes:
        given: The given model.
        extended: The extended model.
        windows: Number of windows.
        seconds: Length of each [s].
    """

    given: Simulated
    extended: Simulated
    windows: int
    seconds: float

    def result(self, robot: Robot) -> dict[str, Any]:
        """Entries of result.json."""
        units = ["rad" if turns else "m" for turns in robot.revolute]
        models = {"given": self.given, "extended": self.extended}
        notes = []
        for name, model in models.items():
            if model.diverged:
                notes.append(f"The {name} model leaves the motion for good: {model.diverged}.")
            elif model.along:
                along = ", ".join(map(plain, model.along))
                notes.append(
                    f"In the {name} model, torque of {along} was taken along the recorded motion."
                )
        return {
            "joints": [
                {
                    "name": joint,
                    **{name: float(model.position[j]) for name, model in models.items()},
                    "unit": unit,
                    "velocity": {
                        **{name: float(model.velocity[j]) for name, model in models.items()},
                        "unit": f"{unit}/s",
                    },
                }
                for j, (joint, unit) in enumerate(zip(robot.joints, units, strict=True))
            ],
            "windows": self.windows,
            "window_s": self.seconds,
            "bandwidth_hz": LOOP_HZ,
            "notes": notes,
        }


def forward(given: Robot, extended: Robot, segments: Sequence[Segment], gains: Array) -> Forward:
    """Simulate two models forward over short windows of the hold-out.

    Args:
        given: The given robot.
        extended: The extended model.
        segments: The hold-out.
        gains: Torque per reading, shape (nv,).
    """
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


def _simulated(robot: Robot, gains: Array, found: list[tuple[Motion, Array]]) -> Simulated:
    kept = [effect for effect in robot.effects if _simulable(robot, effect)]
    along = [effect for effect in robot.effects if effect not in kept]
    model, names = robot.with_effects(kept), tuple(dict.fromkeys(e.name for e in along))
    nothing, errors = np.full(robot.nv, np.nan), []
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
    """Whether a simulation from state to state knows an effect."""
    if not effect.of_state_alone:
        return False
    try:
        forward_model(robot.with_effects([effect]))
    except BadInput:
        return False
    return True
