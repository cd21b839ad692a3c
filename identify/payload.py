"""What an arm carries: ten parameters of a body on the last link, on top of an identified arm.

A body π on the last link adds K π to the base parameters of the arm, because its columns are
those of that link: β_loaded = β_arm + K π. What the unloaded arm and the loaded arm each say of
their base parameters therefore holds everything about the body, whether both were recorded,
or the arm was identified before, or the loaded data still come in sample by sample:

    R_loaded (β + K π) ≈ z_loaded,    R_arm β ≈ z_arm.

Eliminating β leaves ten rows about π, to which the physically consistent fit is made.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from excitant.exceptions import BadInput
from excitant.identify.information import Information, information_of, marginal
from excitant.identify.physical import EffectPrior, KktResiduals, fit_physical
from excitant.robots.base_parameters import BaseParameters
from excitant.robots.motion import Array, freeze
from excitant.robots.parameters import STANDARD, UNITS, from_pseudo_inertia
from excitant.robots.robot import Robot

_SHARE = 0.05  # of the arm's mass: the payload expected
_RADIUS = 0.1  # m: its radius of gyration
_OPEN = 10.0  # relative uncertainty of that expectation: nothing is known
_MASS_GOAL, _CENTRE_GOAL = 0.02, 0.003  # relative, m
_CERTAIN = 2.0  # standard deviations


@dataclass(frozen=True, eq=False)
class PayloadEstimate:
    """A body on the last link, about the frame of its joint.

    Attributes:
        link: The link that carries it.
        phi: Standard parameters, physically consistent, shape (10,).
        covariance: Their covariance, constraints ignored, shape (10, 10).
        prior_share: Part of each parameter's uncertainty that no data reduced, shape (10,).
        kkt: Optimality of the consistent fit.
        notes: What the user should know, as sentences.
    """

    link: str
    phi: Array
    covariance: Array
    prior_share: Array
    kkt: KktResiduals
    notes: tuple[str, ...]

    def __post_init__(self) -> None:
        freeze(self, "phi", "covariance", "prior_share")

    @property
    def mass(self) -> float:
        """Mass [kg]."""
        return float(self.phi[0])

    @property
    def mass_std(self) -> float:
        """Standard deviation of the mass [kg]."""
        return float(np.sqrt(self.covariance[0, 0]))

    @property
    def centre(self) -> Array:
        """Centre of mass in the joint frame, shape (3,) [m]."""
        return np.asarray(self.phi[1:4] / self.mass, float)

    @property
    def centre_std(self) -> Array:
        """Standard deviation of the centre of mass, shape (3,) [m]."""
        J = np.column_stack([-self.centre, np.eye(3)]) / self.mass
        return np.asarray(np.sqrt(np.diag(J @ self.covariance[:4, :4] @ J.T)), float)

    @property
    def std(self) -> Array:
        """Standard deviations of the ten parameters."""
        return np.asarray(np.sqrt(np.diag(self.covariance)), float)

    @property
    def shortcomings(self) -> tuple[str, ...]:
        """Why the payload is not known to 2 % and 3 mm with 95 % confidence; empty when it is."""
        spread = _CERTAIN * self.mass_std
        if spread >= self.mass:
            return (f"no payload is seen: {self.mass:.2g} kg, give or take {spread:.2g} kg",)
        found = []
        if spread > _MASS_GOAL * self.mass:
            found.append(
                f"mass {self.mass:.4g} kg is known to ±{spread:.2g} kg only: lift it through "
                "more poses, move slower or longer"
            )
        worst = int(np.argmax(self.centre_std))
        if _CERTAIN * self.centre_std[worst] > _CENTRE_GOAL:
            off = float(f"{1e3 * _CERTAIN * self.centre_std[worst]:.2g}")
            found.append(
                f"centre of mass along {'xyz'[worst]} is known to ±{off:g} mm only: turn the last "
                "joints through more orientations"
            )
        return tuple(found)


def estimate_payload(
    robot: Robot,
    base: BaseParameters,
    loaded: Information,
    arm: Information,
    *,
    unit: str = "N·m",
) -> PayloadEstimate:
    """The body that turns one arm into the other.

    Args:
        robot: The arm.
        base: Base parameters of both pieces of information.
        loaded: Data of the loaded arm alone, without a prior.
        arm: What is known of the unloaded arm: data, or an identified model.
        unit: Unit the torque was recorded in.

    Raises:
        BadInput: Information about other parameters.
        Infeasible: The semidefinite solver failed.
    """
    r = len(base)
    for part in (loaded, arm):
        if part.R.shape != (r, r):
            raise BadInput(
                f"payload: information about {part.R.shape[0]} parameters, the arm has {r} base "
                "parameters; use one set of effects for both"
            )
    about = payload_information(robot, base, loaded, arm)
    body = _expected_body(robot)[None]
    nothing = EffectPrior(np.zeros(0), np.zeros(0), np.zeros(0))
    fit = fit_physical(about.R, about.z, body, nothing, prior_sigma=_OPEN)
    notes = []
    if unit == "A":
        notes.append(
            "torque came as motor current: a gain that is wrong by 1 % makes mass, first moments "
            "and inertia wrong by 1 %, which no current shows; weigh one load to fix it (the "
            "centre of mass does not depend on the gain)"
        )
    return PayloadEstimate(
        robot.links[-1], fit.x, fit.covariance, fit.prior_share, fit.kkt, tuple(notes)
    )


def payload_information(
    robot: Robot, base: BaseParameters, loaded: Information, arm: Information
) -> Information:
    """What two states of an arm say of the body between them, shape (10, 10)."""
    last = 10 * (robot.nv - 1)
    K, r = base.regrouping[:, last : last + 10], len(base)
    A = np.vstack(
        [np.hstack([loaded.R, loaded.R @ K]), np.hstack([arm.R, np.zeros((r, K.shape[1]))])]
    )
    total = information_of(A, np.concatenate([loaded.z, arm.z]))
    return marginal(total, slice(r, r + K.shape[1]))


def _expected_body(robot: Robot) -> Array:
    """A ball at the flange with a twentieth of the arm's mass, shape (10,)."""
    mass = _SHARE * max(float(robot.phi[::10].sum()), 1e-3)
    frame = list(robot.model.frames)[robot.tip]
    centre = np.array(frame.placement.translation)
    P = np.zeros((4, 4))
    P[:3, :3] = mass * (_RADIUS**2 * np.eye(3) + np.outer(centre, centre))
    P[:3, 3] = P[3, :3] = mass * centre
    P[3, 3] = mass
    return from_pseudo_inertia(P)


def payload_result(payload: PayloadEstimate) -> dict[str, object]:
    """A payload as entries of result.json."""
    return {
        "link": payload.link,
        "mass": {"value": payload.mass, "std": payload.mass_std, "unit": "kg"},
        "centre_of_mass": {
            "value": payload.centre.tolist(), "std": payload.centre_std.tolist(), "unit": "m",
        },
        "parameters": [
            {"name": name, "value": float(value), "std": float(std), "unit": unit,
             "prior_dominated": bool(share > 0.5)}
            for name, value, std, unit, share in zip(
                STANDARD, payload.phi, payload.std, UNITS, payload.prior_share, strict=True
            )
        ],
        "shortcomings": list(payload.shortcomings),
        "notes": list(payload.notes),
    }  # fmt: skip
