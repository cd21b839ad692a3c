"""The relaxation behind the lower bound: states that a motion can mix, and their price."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from excitant.design.constraints import position_range
from excitant.design.criterion import Information, information
from excitant.exceptions import BadInput
from excitant.robots.motion import (
    Array,
    Indices,
    Mask,
    Motion,
    numbered,
    root_mean_square,
)
from excitant.robots.robot import Robot
from excitant.robots.torque import torque


@dataclass(frozen=True)
class StateSampling:
    """States that scale the relaxation, and the ascent to those that violate it."""

    difference: float = 1e-6
    "Step of finite differences in the cube of states."
    stretchings: int = 25
    "Factors by which time is stretched until torque holds."
    states: int = 1000
    "Random states for scales and symmetries."
    same: float = 1e-9
    "Relative change of the regressor below which it does not depend on a position."
    torque_penalty: float = 1e3
    "Weight of the squared torque excess on the way."
    draws: int = 30
    "Random points drawn for each that is kept."
    steps: tuple[float, ...] = (0.05, 0.25, 1.0, 4.0)
    "Multiples of the last step that are tried along a gradient."
    identity_share: float = 0.5
    "Share of I / r in the matrix that repairs a violation."


SAMPLING = StateSampling()


@dataclass(frozen=True, eq=False)
class StateSpace:
    """The image of the cube u = (u₁, u₂, u₃) ∈ [−1, 1]^{3 nv}, less what torque forbids.

    q = middle + half u₁, q̇ = b(q) u₂ and q̈ = c(q̇) u₃ joint by joint, where

        b = min(speed, Ω √(half² − (q − middle)²)),   c = min(acceleration, Ω √(speed² − q̇²)).

    For a finite Fourier series with harmonics up to Ω = Hω these are the inequalities of
    Bernstein and Szegő. A joint without position limits is not bounded and turns by half = π.
    """

    robot: Robot
    middle: Array
    half: Array
    bounded: Array
    speed: Array
    acceleration: Array
    top: float

    def motion(self, u: Array) -> Motion:
        """States of points of the cube, shape (n, 3 nv), numbered instead of timed."""
        u1, u2, u3 = np.split(u, 3, axis=1)
        dq = self._speeds(u1) * u2
        return numbered(
            self.middle + self.half * u1, dq, self._accelerations(dq) * u3
        )

    def cube(self, motion: Motion) -> Array:
        """Points of the cube for states, the nearest where a state is outside."""
        u1 = (motion.q - self.middle) / self.half
        u1 = np.where(self.bounded, np.clip(u1, -1, 1), np.mod(u1 + 1, 2) - 1)
        u2 = np.clip(motion.dq / self._speeds(u1), -1, 1)
        u3 = np.clip(motion.ddq / self._accelerations(motion.dq), -1, 1)
        return np.concatenate([u1, u2, u3], axis=1)

    def use(self, motion: Motion) -> Array:
        """Largest torque over its limit at each state, shape (n,)."""
        return (np.abs(torque(self.robot, motion)) / self.robot.limits.torque).max(
            axis=1
        )

    def slowed(self, motion: Motion) -> Motion:
        """The states, time stretched until torque holds; those that gravity forbids left out."""
        share = np.full(len(motion), np.nan)
        for factor in (1.0, *np.linspace(0.99, 0.0, SAMPLING.stretchings)):
            rest = np.flatnonzero(np.isnan(share))
            slower = _stretched(motion[rest], np.full(len(rest), factor))
            share[rest[self.use(slower) <= 1]] = factor
        keep = ~np.isnan(share)
        return _stretched(motion[keep], share[keep])

    def _speeds(self, u1: Array) -> Array:
        return _arc(
            u1, np.where(self.bounded, self.top * self.half, np.inf), self.speed
        )

    def _accelerations(self, dq: Array) -> Array:
        return _arc(dq / self.speed, self.top * self.speed, self.acceleration)


def _stretched(motion: Motion, share: Array) -> Motion:
    s = share[:, None]
    return numbered(motion.q, s * motion.dq, s**2 * motion.ddq)


def _arc(x: Array, radius: Array, cap: Array) -> Array:
    """min(radius √(1 − x²), cap), above 0 at the ends too."""
    root = np.sqrt(np.maximum(1 - x**2, 1e-9))
    return np.minimum(radius * root, cap)


def state_space(robot: Robot, top: float) -> StateSpace:
    """Feasible states of motions without angular frequencies above ``top`` [rad/s]."""
    limits = robot.limits
    middle, half = position_range(limits)
    bounded = np.isfinite(half)
    half = np.where(bounded, half, np.pi)
    speed = np.minimum(limits.velocity, np.where(bounded, top * half, np.inf))
    acceleration = np.minimum(limits.acceleration, top * speed)
    for lacking, why in (
        (~bounded & ~robot.revolute, "slides without position limits"),
        (np.isinf(speed), "has no velocity limit"),
    ):
        for j in np.flatnonzero(lacking)[:1]:
            raise BadInput(
                f"no lower bound for {robot.name}: joint {robot.joints[j]} {why}, so that the "
                "states it can pass are unlimited; give the limit"
            )
    return StateSpace(robot, middle, half, bounded, speed, acceleration, top)


@dataclass(frozen=True, eq=False)
class TestFunctions:
    """Functions φ = f(q_j) q̇_i with f among 1, sin, cos (turning) or 1, x, x² (sliding joints).

    Over a period, and from rest to rest, E[dφ/dt] = E[f′(q_j) q̇_j q̇_i + f(q_j) q̈_i] = 0: the
    virial theorem where f = 1 or x. Functions even in q̇ would say nothing: a motion and its
    reverse count alike.
    """

    # joints j that turn and that slide, of those on whose position the torque depends
    turning: Indices
    sliding: Indices
    scale: Array | float = 1.0  # that divides them

    def rates(self, motion: Motion) -> Array:
        """dφ/dt at n states, shape (n, m)."""
        angle = motion.q[:, self.turning]
        x = motion.q[:, self.sliding]
        one = np.ones((len(motion), 1))
        sin = np.sin(angle)
        cos = np.cos(angle)
        f = np.hstack([one, sin, cos, x, x * x])
        slope = np.hstack([0 * one, cos, -sin, np.ones_like(x), 2 * x])
        j = np.concatenate(
            [[0], self.turning, self.turning, self.sliding, self.sliding]
        )
        df = slope * motion.dq[:, j]
        rates = (
            df[:, :, None] * motion.dq[:, None]
            + f[:, :, None] * motion.ddq[:, None]
        )
        return rates.reshape(len(motion), -1) / self.scale


@dataclass(frozen=True, eq=False)
class Multipliers:
    """Dual variables of the best mixture of states: a lower bound tr P on κ, when all agree.

    P ⪰ 0 of Σ w M ⪰ I and Q ⪰ 0 of Σ w M ⪯ κ I, tr Q = 1, both (r, r); y of the equality rows (m,).
    """

    P: Array
    Q: Array
    y: Array

    @property
    def value(self) -> float:
        """The bound on κ, tr P."""
        return float(np.trace(self.P))

    @property
    def repair(self) -> Array:
        """R = (I / r + Q) / 2 of trace 1, by which a violation is repaired."""
        R = SAMPLING.identity_share * np.eye(len(self.Q)) / len(self.Q)
        return R + (1 - SAMPLING.identity_share) * self.Q

    def repaired(self, violation: float) -> Multipliers:
        """Multipliers that hold wherever the violation is at most this: Q + violation R."""
        e = 1 + violation
        return Multipliers(
            self.P / e, (self.Q + violation * self.repair) / e, self.y / e
        )


@dataclass(frozen=True, eq=False)
class Relaxation:
    """Mixtures of feasible states in place of motions.

    M = ∫ M(x) dξ(x) over states x, with E[dφ/dt] = 0 for the test functions. Each M(x) is
    averaged with its reverse in time, M(q, −q̇, q̈) = S M S with signs S: columns even and columns
    odd in q̇ then have nothing in common.
    """

    information: Information  # what is to be made visible
    space: StateSpace  # the feasible states
    odd: Mask  # whether each base column is odd in q̇, shape (r,)
    tests: TestFunctions  # test functions, scaled
    unit: float  # typical tr M of a state

    def matrices(self, motion: Motion) -> Array:
        """M of each state, shape (n, r, r)."""
        Y = self.information.observation(motion)
        return np.swapaxes(Y, 1, 2) @ Y * (self.odd[:, None] == self.odd)

    def price(self, multipliers: Multipliers, motion: Motion) -> Array:
        """Violation g / ⟨R, M⟩ at each state, shape (n,).

        g = ⟨P − Q, M⟩ + y·dφ/dt must not be positive; R repairs it.
        """
        Y = self.information.observation(motion)
        g = (
            _form(Y, multipliers.P - multipliers.Q)
            + self.tests.rates(motion) @ multipliers.y
        )
        return g / (_form(Y, multipliers.repair) + 1e-300)

    def worst(
        self,
        multipliers: Multipliers,
        known: Motion,
        rng: np.random.Generator,
        n: int,
        steps: int,
    ) -> tuple[Motion, Array]:
        """States of highest price and their prices, by some steps of ascent from 2 n starts.

        Half of them are the best-priced of the states ``known``, the others random.
        Torque above its limit is penalised on the way, and time stretched in the end until it
        holds.
        """
        best = np.argsort(-self.price(multipliers, known))[:n]
        near = self.space.cube(known[best])
        u = np.concatenate(
            [near, self._promising(multipliers, near[: n // 2], rng, n)]
        )
        u = self._ascend(multipliers, u, steps)
        motion = self.space.slowed(self.space.motion(u))
        return motion, self.price(multipliers, motion)

    def _ascend(self, multipliers: Multipliers, u: Array, steps: int) -> Array:
        """Points of higher merit by projected gradients, each the best of some lengths."""
        value = self._merit(multipliers, u)
        reach = np.full(len(u), 0.3)
        for _ in range(steps):
            d = self._slope(multipliers, u, value)
            d = np.where((np.abs(u) >= 1) & (d * u > 0), 0.0, d)
            d /= np.maximum(np.abs(d).max(axis=1, keepdims=True), 1e-300)
            here = u
            used = 0.2 * reach
            for factor in SAMPLING.steps:
                there = np.clip(here + (factor * reach)[:, None] * d, -1, 1)
                merit = self._merit(multipliers, there)
                up = merit > value
                u = np.where(up[:, None], there, u)
                value = np.where(up, merit, value)
                used = np.where(up, factor * reach, used)
            reach = np.clip(used, 1e-5, 2.0)
        return u

    def _promising(
        self,
        multipliers: Multipliers,
        known: Array,
        rng: np.random.Generator,
        n: int,
    ) -> Array:
        """The n best-priced of many points of the cube: random ones and mutants of known ones."""
        count = SAMPLING.draws * n
        u = rng.uniform(-1, 1, (count, 3 * self.space.robot.nv))
        u = np.where(
            rng.random(u.shape) < rng.choice([0.0, 0.5], (count, 1)), np.sign(u), u
        )
        parents = known[rng.integers(len(known), size=count)]
        inherited = rng.random(u.shape) < rng.choice([0.0, 0.7, 0.9], (count, 1))
        u = np.where(inherited, parents, u)
        return u[np.argsort(-self._merit(multipliers, u))[:n]]

    def _merit(self, multipliers: Multipliers, u: Array) -> Array:
        motion = self.space.motion(u)
        over = np.maximum(self.space.use(motion) - 1, 0.0)
        return self.price(multipliers, motion) - SAMPLING.torque_penalty * over**2

    def _slope(self, multipliers: Multipliers, u: Array, merit: Array) -> Array:
        """Gradient of the merit by u, by differences towards the inside of the cube."""
        step = np.where(u > 0, -SAMPLING.difference, SAMPLING.difference)
        columns = [
            (self._merit(multipliers, u + step * unit) - merit) / step[:, k]
            for k, unit in enumerate(np.eye(u.shape[1]))
        ]
        return np.stack(columns, axis=1)


def _form(Y: Array, F: Array) -> Array:
    """⟨F, YᵀY⟩ at each state, shape (n,)."""
    return np.einsum("nij,nij->n", Y @ F, Y)


def relaxation(robot: Robot, columns: str, top: float) -> Relaxation:
    """The relaxation of motions without angular frequencies above ``top`` [rad/s]."""
    visible = information(robot, columns)
    space = state_space(robot, top)
    rng = np.random.default_rng(0)
    motion = space.motion(rng.uniform(-1, 1, (SAMPLING.states, 3 * robot.nv)))
    Y = visible.observation(motion)
    back = visible.observation(numbered(motion.q, -motion.dq, motion.ddq))
    odd = np.abs(Y + back).max(axis=(0, 1)) < np.abs(Y - back).max(axis=(0, 1))
    felt = np.zeros(robot.nv, bool)  # not a first joint along gravity
    for j, unit in enumerate(np.eye(robot.nv)):
        moved = visible.observation(
            numbered(motion.q + unit, motion.dq, motion.ddq)
        )
        felt[j] = np.abs(moved - Y).max() > SAMPLING.same * np.abs(Y).max()
    turning = np.flatnonzero(felt & robot.revolute)
    sliding = np.flatnonzero(felt & ~robot.revolute)
    tests = TestFunctions(turning, sliding)
    tests = replace(tests, scale=root_mean_square(tests.rates(motion)))
    return Relaxation(
        visible, space, odd, tests, float((Y**2).sum(axis=(1, 2)).mean())
    )
