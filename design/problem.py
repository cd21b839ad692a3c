"""The design problem in the free coefficients of a trajectory at rest at both ends."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
import numpy.typing as npt

from excitant.design.constraints import kinematic_limits, pose_use
from excitant.design.criterion import Information
from excitant.design.feasible import random_start
from excitant.design.trajectory import Series, Trajectory
from excitant.robots import Array, Motion, Robot
from excitant.robots.geometry import Scene

_MARGIN = 1e-4  # share of every limit kept free, above what the exchange leaves violated
_SAMPLES = {"inertial": 12, "friction": 20}  # per harmonic, for the information
_PEAK_SAMPLES = 32  # per harmonic, for finding peaks
_REACH = np.pi  # taken as half the range of an unlimited joint

Bases = Sequence[Array]


@dataclass(frozen=True, eq=False)
class DesignProblem:
    """Minimise a criterion of the information over trajectories within the limits.

    The unknowns z, shape (c − 2, nv), are the coefficients X = Z z in an orthonormal basis Z
    of those at rest at both ends.

    Attributes:
        information: What is to be made visible, on which robot.
        criterion: ``"condition"``, ``"d"``, ``"a"`` or ``"e"``.
        series: Functions of time that the motion is a combination of; c of them.
        scene: The arm's bodies and obstacles; None to leave clearance out.
        required: Smallest distance between bodies [m].
    """

    information: Information
    criterion: str
    series: Series
    scene: Scene | None = None
    required: float = 0.0

    @property
    def robot(self) -> Robot:
        """The arm."""
        return self.information.robot

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return (self.series.size - 2) * self.robot.nv

    @property
    def period(self) -> float:
        """Duration [s]."""
        return self.series.period

    @property
    def Z(self) -> Array:
        """Basis of the coefficients at rest, shape (c, c − 2)."""
        return self.series.rest

    @cached_property
    def samples(self) -> Array:
        """Instants at which the information is summed [s]."""
        return self.series.instants(_SAMPLES[self.information.columns])

    @cached_property
    def sample_bases(self) -> Bases:
        """Basis of q, q̇, q̈ at `samples`."""
        return self.bases(self.samples)

    @cached_property
    def instants(self) -> Array:
        """Equidistant instants between which peaks are looked for [s]."""
        return self.series.instants(_PEAK_SAMPLES)

    @cached_property
    def middle(self) -> Array:
        """Middle of the range of q, q̇, q̈ (and jerk); shape (orders, nv)."""
        return kinematic_limits(self.robot.limits)[0][: self.robot.limits.orders]

    @cached_property
    def bound(self) -> Array:
        """Largest distance of q, q̇, q̈ (and jerk) from the middle, less a margin."""
        return kinematic_limits(self.robot.limits)[1][: self.robot.limits.orders] * (1 - _MARGIN)

    @cached_property
    def torque_bound(self) -> Array:
        """Torque limits less a margin, shape (nv,) [N·m]."""
        return self.robot.limits.torque * (1 - _MARGIN)

    @cached_property
    def reach(self) -> Array:
        """Largest useful change of each coefficient alone, shape (c, nv)."""
        bound = self.bound.copy()
        bound[0] = np.minimum(bound[0], _REACH)
        return self.series.reach(bound)

    def basis(self, t: Array, order: int) -> Array:
        """Basis functions of z for a derivative of q at given instants, shape (n, c − 2)."""
        return self.series.basis(t, order) @ self.Z

    def bases(self, t: Array) -> Bases:
        """Basis functions of z for q, q̇ and q̈ at given instants, each (n, c − 2)."""
        return [self.basis(t, order) for order in range(3)]

    def trajectory(self, z: Array) -> Trajectory:
        """The trajectory of these unknowns."""
        return self.series.trajectory(self.Z @ z)

    def random(self, rng: np.random.Generator) -> Trajectory:
        """A random trajectory within all limits, clearance included."""
        use = None if self.scene is None else partial(pose_use, self.scene, self.required)
        return random_start(self.robot, rng, self.series, use)

    def unknowns(self, trajectory: Trajectory) -> Array:
        """The unknowns of a trajectory at rest, or of the nearest that the series holds."""
        z: Array = self.Z.T @ self.series.nearest(trajectory)
        return z

    def information_matrix(self, z: Array, *, smooth: bool = True) -> Array:
        """M at the samples, shape (r, r)."""
        return self.information.matrix(motion_of(z, self.samples, self.sample_bases), smooth=smooth)

    @cached_property
    def grid_bases(self) -> tuple[Array, ...]:
        """Basis of q and the derivatives that `kinematic_peaks` needs, at `instants`."""
        return tuple(
            self.basis(self.instants, order) for order in range(self.robot.limits.orders + 2)
        )

    def kinematic_peaks(
        self, z: Array, order: int, share: float
    ) -> tuple[Array, npt.NDArray[np.intp]]:
        """Local extrema of a derivative beyond a share of its bound, by one Newton step.

        Returns:
            Instants [s] and joints, both of shape (k,).
        """
        value, slope, curve = (basis @ z for basis in self.grid_bases[order : order + 3])
        use = np.abs(value - self.middle[order]) / self.bound[order]
        peak = (use >= np.roll(use, 1, axis=0)) & (use > np.roll(use, -1, axis=0))
        k, joint = np.nonzero(peak & (use > 0.98 * share))
        slope, curve, spacing = slope[k, joint], curve[k, joint], self.period / len(use)
        shift = -slope / np.where(curve == 0.0, np.inf, curve)
        shift = np.clip(shift, -spacing, spacing)
        rise = np.abs(shift * (slope + 0.5 * curve * shift)) / self.bound[order, joint]
        high = use[k, joint] + rise > share
        return (self.instants[k] + shift)[high], joint[high]


def motion_of(z: Array, t: Array, bases: Bases) -> Motion:
    """Motion of the unknowns at instants whose bases are known."""
    return Motion(t, bases[0] @ z, bases[1] @ z, bases[2] @ z)
