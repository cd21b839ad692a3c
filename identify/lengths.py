"""Lengths that are assumed and not measured: what their errors do to a fit.

With δ by how much joints sit elsewhere in their parent links than the model says, to first order

    τ = W β + J δ + ε,   J = ∂τ/∂δ,   δ ~ N(0, S),  S diagonal,

so that δ is further noise, which moves with the arm: of covariance J S Jᵀ beside Γ, that of ε.
Weighted least squares stays as it is, since its parameters predict best with the lengths of the
model, but its error, and with it that of the torque that it predicts, is

    β̂ − β = A⁻¹ Wᵀ (J δ + ε),   W β̂ − (W β + J δ) = (W A⁻¹ Wᵀ J − J) δ + W A⁻¹ Wᵀ ε,   A = WᵀW,

rows weighted. Integrated over δ, the covariance of β̂ becomes A⁻¹ Wᵀ (Γ + J S Jᵀ) W A⁻¹. Γ is that
of what the likeliest lengths leave, or their errors would count as noise, too. All matrices have
as many columns as there are parameters or lengths, none as many as there are rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import scipy

from excitant.exceptions import BadInput
from excitant.identify.least_squares import (
    LeastSquares,
    factorised,
    with_covariance,
)
from excitant.identify.physical import PhysicalFit
from excitant.identify.preprocessing import Segment
from excitant.identify.rows import FitRows, identified_robot
from excitant.robots.effects import KinematicError
from excitant.robots.motion import Array, freeze
from excitant.robots.robot import Robot


def length_deviations(std: float | Sequence[float], robot: Robot) -> Array:
    """Standard deviations of where joints sit, of one number or one per joint, shape (nv,) [m].

    Raises:
        BadInput: Another number of them, or what is no standard deviation.
    """
    values = np.atleast_1d(np.asarray(std, float))
    if values.shape not in ((1,), (robot.nv,)):
        raise BadInput(
            f"standard deviation of lengths: {len(values)} numbers for {robot.nv} joints of "
            f"{robot.name}; give one, or one per joint [m]"
        )
    wrong = ~((values >= 0) & np.isfinite(values))
    if wrong.any():
        at = int(np.argmax(wrong))
        whose = f" of {robot.joints[at]}" if len(values) > 1 else ""
        raise BadInput(
            f"standard deviation of lengths{whose}: {values[at]:g} m; give a number from 0 on"
        )
    return np.broadcast_to(values, robot.nv).copy()


@dataclass(frozen=True, eq=False)
class LengthErrors:
    """Errors of lengths, and how estimates move with them.

    Attributes:
        std: Standard deviation of x, y and z of each joint's place in its parent, (nv,) [m].
        model: The identified arm, whose torque J is of.
        base: How base parameters move by one standard deviation of each coordinate, (r, 3 nv).
        full: How all parameters of links and effects do, shape (p, 3 nv).
        by_noise: Covariance of base parameters by noise alone, shape (r, r).
        residuals: What neither parameters nor such lengths explain of the fitted torque of each
            joint, at its rows that count [N·m].
    """

    std: Array
    model: Robot
    base: Array
    full: Array
    by_noise: Array
    residuals: tuple[Array, ...]

    def __post_init__(self) -> None:
        freeze(self, "std", "base", "full", "by_noise")

    @property
    def widening(self) -> Array:
        """Standard deviations of base parameters with these errors over those without, (r,)."""
        return np.sqrt(1 + (self.base**2).sum(axis=1) / np.diag(self.by_noise))

    @property
    def sentence(self) -> str:
        """Summary in words."""
        std_mm = (1e3 * self.std[1:]).round(6).tolist()
        ends = dict.fromkeys((min(std_mm), max(std_mm)))
        size = " to ".join(f"{x:g}" for x in ends)
        widening = self.entry()["widening"]
        return (
            f"lengths are assumed: joints may sit elsewhere in their links by ± {size} mm along "
            "each axis (standard deviation). That multiplies standard deviations of base "
            f"parameters by {widening['median']:.2g} in the median, "
            f"{widening['largest']:.2g} at most, and widens the intervals of torque; values stay "
            "those that predict best with the lengths of the model"
        )

    def entry(self) -> dict[str, Any]:
        """As an entry of result.json."""
        median = float(np.median(self.widening))
        return {
            "std": self.std.tolist(),
            "widening": {"median": median, "largest": float(self.widening.max())},
        }

    def columns(self, segments: Sequence[Segment]) -> Array:
        """J by standard deviations at the rows of segments, shape (n, nv, 3 nv) [N·m]."""
        return _columns(self.model, self.std, segments)

    def widened(
        self, fit: LeastSquares, physical: PhysicalFit
    ) -> tuple[LeastSquares, PhysicalFit]:
        """Fits with the covariance that counts these errors."""
        return (
            replace(fit, covariance=self.by_noise + self.base @ self.base.T),
            replace(
                physical, covariance=physical.covariance + self.full @ self.full.T
            ),
        )

    def of_prediction(self, fit: LeastSquares) -> Array:
        """Covariance of (β̂ − β, −δ / std) of a widened fit, which [W J] turns into that of torque.

        Shape (r + 3 nv, r + 3 nv).
        """
        k = self.base.shape[1]
        return np.block([[fit.covariance, -self.base], [-self.base.T, np.eye(k)]])


def length_errors(
    rows: FitRows, fit: LeastSquares, physical: PhysicalFit, std: Array
) -> LengthErrors:
    """What errors of lengths, (nv,) [m], do to the estimates of these rows."""
    model = identified_robot(rows.robot, rows.effects, physical.x)
    J = _columns(model, std, rows.data.train)
    problem = rows.reduced
    size = J.shape[2]
    wide = problem.with_columns(J, [f"length {k + 1}" for k in range(size)])
    R, _ = wide.factor(1 / fit.sigma)
    r = problem.p
    base = scipy.linalg.solve_triangular(R[:r, :r], R[:r, r:])
    # what neither parameters nor lengths explain, the latter as far as they may be off
    R, z = wide.factor(fit.weight)
    likely = (
        np.vstack([R, np.eye(r + size)[r:]]),
        np.concatenate([z, np.zeros(size)]),
    )
    residual = wide.residual(np.linalg.lstsq(*likely)[0])
    noise = with_covariance(
        factorised(problem, fit.sigma), fit.beta, residual, fit.sigma
    )
    wide = rows.regression.with_columns(J, wide.names[r:])
    p = rows.regression.p
    R, _ = wide.factor(fit.weight)
    full = physical.covariance @ (R[:, :p].T @ R[:, p:])
    return LengthErrors(
        std, model, base, full, noise.covariance, tuple(problem.counted(residual))
    )


def _columns(robot: Robot, std: Array, segments: Sequence[Segment]) -> Array:
    parts = []
    for joint, size in zip(robot.joints, std, strict=True):
        columns = partial(KinematicError((joint,)).columns, robot)
        parts.append(
            size * np.concatenate([segment.rows(columns) for segment in segments])
        )
    return np.concatenate(parts, axis=2)
