"""The relaxation behind the lower bound: which states a motion can mix, and their price."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from excitant.design.criterion import Information, information
from excitant.design.mixture import Mixture, Multipliers, best_mixture
from excitant.design.states import StateSpace, numbered, state_space
from excitant.design.stationarity import TestFunctions, test_functions
from excitant.robots.motion import Array, Motion
from excitant.robots.robot import Robot

_STATES = 1000  # random states for scales and symmetries
_SAME = 1e-9
_TORQUE_PENALTY = 1e3
_DRAWS = 30  # random points per point kept
_STEPS = (0.05, 0.25, 1.0, 4.0)  # tried along every gradient, as multiples of the last step
_IDENTITY_SHARE = 0.5
_MULTIPLIER = 0.1  # largest of an equality row, in units of the typical tr M; 0.03 occurs


@dataclass(frozen=True, eq=False)
class Relaxation:
    """Mixtures of feasible states in place of motions.

    M = ∫ M(x) dξ(x) over states x, with E[dφ/dt] = 0 for the test functions. Each M(x) is
    averaged with its reverse in time, M(q, −q̇, q̈) = S M S with signs S: then M has a block of
    columns even and one of columns odd in q̇.

    Attributes:
        information: What is to be made visible.
        space: The feasible states.
        blocks: Base columns of each block.
        tests: Test functions, scaled; None for any motion whatever.
        unit: Typical tr M of a state.
    """

    information: Information
    space: StateSpace
    blocks: tuple[npt.NDArray[np.intp], ...]
    tests: TestFunctions | None
    unit: float

    def matrices(self, motion: Motion) -> list[Array]:
        """M of each state by blocks, each of shape (n, p_b, p_b)."""
        Y = self.information.observation(motion)
        return [np.swapaxes(Y[:, :, b], 1, 2) @ Y[:, :, b] for b in self.blocks]

    def rows(self, motion: Motion) -> Array:
        """Rates of the test functions, shape (n, m)."""
        if self.tests is None:
            return np.zeros((len(motion), 0))
        return self.tests.rates(motion.q, motion.dq, motion.ddq)

    def mixture(self, motion: Motion, tolerance: float) -> Mixture:
        """The best mixture of these states."""
        M = self.matrices(motion)
        size = sum(np.trace(block, axis1=1, axis2=2) for block in M) + _SAME * self.unit
        found = best_mixture(
            [block / size[:, None, None] for block in M],
            self.rows(motion) * (self.unit / size)[:, None],
            bound=_MULTIPLIER,
            tolerance=tolerance,
        )
        multipliers = replace(found.multipliers, y=found.multipliers.y * self.unit)
        return replace(found, multipliers=multipliers, weights=found.weights / size)

    def price(self, multipliers: Multipliers, motion: Motion) -> Array:
        """Violation g / ⟨R, M⟩ at each state, shape (n,).

        g = ⟨P − Q, M⟩ + y·dφ/dt must not be positive; R = (I/p + Q)/2 repairs it.
        """
        Y, F = self.information.observation(motion), self.forms(multipliers)
        g, size = (self._form(Y, form) for form in F)
        if self.tests is not None:
            g = g + self.rows(motion) @ multipliers.y
        price: Array = g / (size + 1e-300)
        return price

    def forms(self, multipliers: Multipliers) -> tuple[list[Array], list[Array]]:
        """P − Q and R by blocks."""
        p = sum(len(b) for b in self.blocks)
        return (
            [P - Q for P, Q in zip(multipliers.P, multipliers.Q, strict=True)],
            [
                _IDENTITY_SHARE * np.eye(len(Q)) / p + (1 - _IDENTITY_SHARE) * Q
                for Q in multipliers.Q
            ],
        )

    def repaired(self, multipliers: Multipliers, violation: float) -> Multipliers:
        """Multipliers that hold wherever the violation is at most this: Q + violation R."""
        e = max(violation, 0.0)
        R = self.forms(multipliers)[1]
        return Multipliers(
            tuple(P / (1 + e) for P in multipliers.P),
            tuple((Q + e * r) / (1 + e) for Q, r in zip(multipliers.Q, R, strict=True)),
            multipliers.y / (1 + e),
        )

    def worst(
        self, multipliers: Multipliers, starts: Array, steps: int, kept: int, polish: int
    ) -> tuple[Motion, Array]:
        """States of highest price, by ascent from points of the cube.

        Torque above its limit is penalised on the way, and time stretched in the end until it
        holds.

        Args:
            multipliers: What prices the states.
            starts: Points of the cube, shape (n, 3 nv).
            steps: Steps from every start.
            kept: How many of the best go on.
            polish: Further steps of those.

        Returns:
            The states and their prices, highest first.
        """
        u, merit = self._ascend(multipliers, starts, steps)
        order = np.argsort(-merit)
        polished = self._ascend(multipliers, u[order[:kept]], polish)[0]
        u = np.concatenate([polished, u[order[kept:]]])
        motion = self.space.slowed(self.space.motion(u))
        price = self.price(multipliers, motion)
        order = np.argsort(-price)
        return motion[order], price[order]

    def _ascend(self, multipliers: Multipliers, u: Array, steps: int) -> tuple[Array, Array]:
        """Projected gradient ascent: points and merits. Of several steps the best is taken."""
        value, reach = self._merit(multipliers, u), np.full(len(u), 0.3)
        for _ in range(steps):
            d = self._slope(multipliers, u)
            d = np.where((np.abs(u) >= 1) & (d * u > 0), 0.0, d)
            d /= np.maximum(np.abs(d).max(axis=1, keepdims=True), 1e-300)
            best, top, used = u.copy(), value.copy(), 0.2 * reach
            for factor in _STEPS:
                there = np.clip(u + (factor * reach)[:, None] * d, -1, 1)
                merit = self._merit(multipliers, there)
                up = merit > top
                best[up], top[up], used[up] = there[up], merit[up], factor * reach[up]
            u, value, reach = best, top, np.clip(used, 1e-5, 2.0)
        return u, value

    def promising(
        self, multipliers: Multipliers, known: Array, rng: np.random.Generator, n: int
    ) -> Array:
        """The n best-priced of many points of the cube: random ones and mutants of known ones."""
        count = _DRAWS * n
        u = rng.uniform(-1, 1, (count, 3 * self.space.robot.nv))
        u = np.where(rng.random(u.shape) < rng.choice([0.0, 0.5], (count, 1)), np.sign(u), u)
        parents = known[rng.integers(len(known), size=count)]
        inherited = rng.random(u.shape) < rng.choice([0.0, 0.7, 0.9], (count, 1))
        u = np.where(inherited, parents, u)
        best: Array = u[np.argsort(-self._merit(multipliers, u))[:n]]
        return best

    def _form(self, Y: Array, form: Sequence[Array]) -> Array:
        """⟨form, M⟩ at each state."""
        total = np.zeros(len(Y))
        for b, F in zip(self.blocks, form, strict=True):
            total += np.einsum("nij,nij->n", Y[:, :, b] @ F, Y[:, :, b])
        return total

    def _merit(self, multipliers: Multipliers, u: Array) -> Array:
        motion = self.space.motion(u)
        over = np.maximum(self.space.excess(motion) - 1, 0.0)
        merit: Array = self.price(multipliers, motion) - _TORQUE_PENALTY * over**2
        return merit

    def _slope(self, multipliers: Multipliers, u: Array) -> Array:
        """Gradient of the merit by u (friction's share of the torque held fast)."""
        motion = self.space.motion(u)
        exact = self.information.linearise(motion)
        price, (G, R) = self.price(multipliers, motion), self.forms(multipliers)
        size = self._form(exact.Y, R) + 1e-300
        T = np.zeros_like(exact.Y)
        for b, g, r in zip(self.blocks, G, R, strict=True):
            T[:, :, b] = exact.Y[:, :, b] @ g - price[:, None, None] * (exact.Y[:, :, b] @ r)
        T = 2 * T / size[:, None, None] - self._torque_slope(motion)
        slopes = [
            np.einsum("jnir,nir->nj", by, T, optimize=True)
            for by in (exact.by_q, exact.by_dq, exact.by_ddq)
        ]
        if self.tests is not None:
            added = self.tests.gradient(motion.q, motion.dq, motion.ddq, multipliers.y)
            slopes = [s + a / size[:, None] for s, a in zip(slopes, added, strict=True)]
        return self.space.pull(u, *slopes)

    def _torque_slope(self, motion: Motion) -> Array:
        """Derivative of the torque penalty by the base columns, shape (n, nv, r)."""
        use, sign = self.space.use(motion)
        over = np.where(use >= use.max(axis=1, keepdims=True), np.maximum(use - 1, 0.0), 0.0)
        slope = 2 * _TORQUE_PENALTY * over * sign / self.space.robot.limits.torque
        base, phi = self.information.base, self.space.robot.phi
        beta = base.regrouping[:, : len(phi)] @ phi
        product: Array = slope[:, :, None] * beta
        return product


def relaxation(robot: Robot, columns: str, top: float, *, stationary: bool) -> Relaxation:
    """The relaxation for motions without angular frequencies above ``top`` [rad/s].

    Args:
        robot: The arm; its limits count.
        columns: ``"friction"`` or ``"inertial"``.
        top: Highest angular frequency, or infinity [rad/s].
        stationary: Whether E[dφ/dt] = 0 holds.
    """
    visible, space = information(robot, columns), state_space(robot, top)
    rng = np.random.default_rng(0)
    motion = space.motion(rng.uniform(-1, 1, (_STATES, 3 * robot.nv)))
    Y = visible.observation(motion)
    back = visible.observation(numbered(motion.q, -motion.dq, motion.ddq))
    odd = np.abs(Y + back).max(axis=(0, 1)) < np.abs(Y - back).max(axis=(0, 1))
    blocks = tuple(np.flatnonzero(part) for part in (~odd, odd) if part.any())
    tests = None
    if stationary:
        plain = test_functions(_shown(visible, motion, Y), robot.revolute)
        rates = plain.rates(motion.q, motion.dq, motion.ddq)
        tests = replace(plain, scale=np.sqrt((rates**2).mean(axis=0)))
    return Relaxation(visible, space, blocks, tests, float((Y**2).sum(axis=(1, 2)).mean()))


def _shown(visible: Information, motion: Motion, Y: Array) -> npt.NDArray[np.intp]:
    """Joints whose position the torques depend on; not the first when it turns about gravity."""
    changed = []
    for unit in np.eye(motion.nv):
        moved = visible.observation(numbered(motion.q + unit, motion.dq, motion.ddq))
        changed.append(np.abs(moved - Y).max() > _SAME * np.abs(Y).max())
    return np.flatnonzero(changed)
