"""Test functions whose rate has mean zero over every motion from rest to rest, or periodic."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from excitant.robots.motion import Array

Indices = npt.NDArray[np.intp]

_ONE, _SIN, _COS, _X, _XX = range(5)


@dataclass(frozen=True, eq=False)
class TestFunctions:
    """Functions φ = f(q_j) q̇_i with f among 1, sin, cos (turning) or 1, x, x² (sliding joints).

    Over a period, and from rest to rest, E[dφ/dt] = E[f′(q_j) q̇_j q̇_i + f(q_j) q̈_i] = 0: the
    virial theorem where f = 1 or x, the balance of generalised momentum in general. Functions
    even in q̇ would say nothing, for M is even, and a motion and its reverse count alike.

    Attributes:
        joints: Joint j of the factor, shape (m,).
        factors: Kind of the factor f, shape (m,).
        speeds: Joint i of the velocity, shape (m,).
        scale: Divisor of each function, shape (m,).
    """

    joints: Indices
    factors: Indices
    speeds: Indices
    scale: Array

    def __len__(self) -> int:
        return len(self.joints)

    def rates(self, q: Array, dq: Array, ddq: Array) -> Array:
        """dφ/dt at n states, shape (n, m)."""
        f, df, _ = self._factors(q)
        rates: Array = df * dq[:, self.joints] * dq[:, self.speeds] + f * ddq[:, self.speeds]
        return rates / self.scale

    def gradient(self, q: Array, dq: Array, ddq: Array, y: Array) -> tuple[Array, Array, Array]:
        """Derivatives of Σ y dφ/dt by q, q̇ and q̈, each of shape (n, nv)."""
        f, df, ddf = self._factors(q)
        j, i = (np.eye(q.shape[1])[index] for index in (self.joints, self.speeds))
        y = y / self.scale
        v, u, a = dq[:, self.joints], dq[:, self.speeds], ddq[:, self.speeds]
        by_q = (y * (ddf * v * u + df * a)) @ j
        by_dq = (y * df * u) @ j + (y * df * v) @ i
        return by_q, by_dq, (y * f) @ i

    def _factors(self, q: Array) -> tuple[Array, Array, Array]:
        """f, f′ and f″ at n states, each of shape (n, m)."""
        x, kind = q[:, self.joints], self.factors
        sin, cos, zero, one = np.sin(x), np.cos(x), np.zeros_like(x), np.ones_like(x)
        return (
            np.choose(kind, [one, sin, cos, x, x * x]),
            np.choose(kind, [zero, cos, -sin, one, 2 * x]),
            np.choose(kind, [zero, -sin, -cos, zero, 2 * one]),
        )


def test_functions(shown: Indices, revolute: npt.NDArray[np.bool_]) -> TestFunctions:
    """All test functions of an arm, unscaled.

    Args:
        shown: Joints whose position the torques depend on.
        revolute: Whether each joint turns, shape (nv,).
    """
    factors = [(0, _ONE)]
    for j in shown:
        factors += [(int(j), kind) for kind in ((_SIN, _COS) if revolute[j] else (_X, _XX))]
    table = np.array([(j, kind, i) for j, kind in factors for i in range(len(revolute))])
    return TestFunctions(table[:, 0], table[:, 1], table[:, 2], np.ones(len(table)))
