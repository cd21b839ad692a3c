"""The design problem in the free coefficients of a trajectory at rest at both ends."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from excitant.design.constraints import kinematic_limits
from excitant.design.criterion import Information
from excitant.design.feasible import random_start
from excitant.design.trajectory import FourierSeries, Trajectory
from excitant.robots.geometry import Scene
from excitant.robots.motion import Array, Indices, Motion
from excitant.robots.robot import Robot

# share of every limit kept free, above what the exchange leaves violated
_MARGIN = 1e-4
_SAMPLES = {"inertial": 12, "friction": 20}  # per harmonic, for the information
_PEAK_SAMPLES = 32  # per harmonic, for finding peaks
_REACH = np.pi  # taken as half the range of an unlimited joint


@dataclass(frozen=True, eq=False)
class DesignProblem:
    """Minimise a criterion of the information over trajectories within the limits.

    The unknowns z, shape (c − 2, nv), are the coefficients X = Z z in an orthonormal basis Z
    of those at rest at both ends.
    """

    information: Information  # what is to be made visible, on which robot
    criterion: str  # ``"condition"``, ``"d"``, ``"a"`` or ``"e"``
    # functions of time that the motion is a combination of; c of them
    series: FourierSeries
    # the arm's bodies and obstacles; None to leave clearance out
    scene: Scene | None
    required: float  # smallest distance between bodies [m]

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

    @cached_property
    def samples(self) -> Array:
        """Instants at which the information is summed [s]."""
        return self.series.instants(_SAMPLES[self.information.columns])

    @cached_property
    def sample_bases(self) -> Sequence[Array]:
        """Basis of q, q̇, q̈ at `samples`."""
        return self.bases(self.samples)

    @cached_property
    def instants(self) -> Array:
        """Equidistant instants between which peaks are looked for [s]."""
        return self.series.instants(_PEAK_SAMPLES)

    @cached_property
    def grid_bases(self) -> Sequence[Array]:
        """Basis of q and the derivatives that `kinematic_peaks` needs, at `instants`."""
        return self.bases(self.instants, self.robot.limits.orders + 2)

    @cached_property
    def middle(self) -> Array:
        """Middle of the range of q, q̇, q̈ (and jerk); shape (orders, nv)."""
        return kinematic_limits(self.robot.limits)[0][: self.robot.limits.orders]

    @cached_property
    def bound(self) -> Array:
        """Largest distance of q, q̇, q̈ (and jerk) from the middle, less a margin."""
        return kinematic_limits(self.robot.limits)[1][
            : self.robot.limits.orders
        ] * (1 - _MARGIN)

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
        return self.series.basis(t, order) @ self.series.rest

    def bases(self, t: Array, orders: int = 3) -> list[Array]:
        """Basis functions of z for q, q̇, q̈ (and more) at given instants, each (n, c − 2)."""
        return [self.basis(t, order) for order in range(orders)]

    def trajectory(self, z: Array) -> Trajectory:
        """The trajectory of these unknowns."""
        return self.series.trajectory(self.series.rest @ z)

    def random(self, rng: np.random.Generator) -> Trajectory:
        """A random trajectory within all limits, clearance included."""
        return random_start(self.robot, rng, self.series, self.scene, self.required)

    def unknowns(self, trajectory: Trajectory) -> Array:
        """The unknowns of a trajectory at rest, or of the nearest that the series holds."""
        return self.series.rest.T @ self.series.nearest(trajectory)

    def sampled(self, z: Array) -> Motion:
        """The motion at `samples`."""
        return Motion(self.samples, *(basis @ z for basis in self.sample_bases))

    def information_matrix(self, z: Array) -> Array:
        """M at the samples, with the smooth sign of velocity, shape (r, r)."""
        return self.information.matrix(self.sampled(z), smooth=True)

    def kinematic_peaks(
        self, z: Array, order: int, share: float
    ) -> tuple[Array, Indices]:
        """Instants [s] and joints of extrema beyond a share of the bound, by one Newton step."""
        value, slope, curve = (
            basis @ z for basis in self.grid_bases[order : order + 3]
        )
        use = np.abs(value - self.middle[order]) / self.bound[order]
        peak = (use >= np.roll(use, 1, axis=0)) & (use > np.roll(use, -1, axis=0))
        k, joint = np.nonzero(peak & (use > 0.98 * share))
        slope = slope[k, joint]
        curve = curve[k, joint]
        spacing = self.period / len(use)
        shift = -slope / np.where(curve == 0.0, np.inf, curve)
        shift = np.clip(shift, -spacing, spacing)
        rise = (
            np.abs(shift * (slope + 0.5 * curve * shift)) / self.bound[order, joint]
        )
        high = use[k, joint] + rise > share
        return (self.instants[k] + shift)[high], joint[high]
