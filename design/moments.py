"""What the time averages of every motion obey: stationarity, and the band of its harmonics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from excitant.robots.motion import Array

Indices = npt.NDArray[np.intp]

FACTORS = ("1", "x", "sin", "cos", "sin2", "cos2", "x2")


@dataclass(frozen=True, eq=False)
class TestFunctions:
    joints: Indices   # (m,2)
    kinds: Indices    # (m,2)
    speeds: Indices   # (m,3), nv where none
    middle: Array
    half: Array
    speed: Array

    def __len__(self): return len(self.joints)
    def __getitem__(self, r):
        return TestFunctions(self.joints[r], self.kinds[r], self.speeds[r], self.middle, self.half, self.speed)
    @property
    def nv(self): return len(self.middle)

    def rates(self, q, dq, ddq):
        return self._terms(q, dq, ddq, False)[0]

    def gradient(self, q, dq, ddq, y):
        A, gq, gdq, gddq = self._terms(q, dq, ddq, True)
        nv = self.nv
        one = lambda idx: (idx[:, None] == np.arange(nv)[None, :]).astype(float)
        out = []
        for terms, slots in ((gq, self.joints.T), (None, None), (gddq, self.speeds.T)):
            if terms is None:
                tot = sum(((t * y) @ one(i)) for t, i in zip(gdq[0], self.joints.T)) + sum(((t * y) @ one(i)) for t, i in zip(gdq[1], self.speeds.T))
            else:
                tot = sum(((t * y) @ one(i)) for t, i in zip(terms, slots))
            out.append(tot)
        return A @ y, *out

    def _terms(self, q, dq, ddq, grad):
        tables = self._tables(q)
        U, D, DD = ([t[self.kinds[:, a], :, self.joints[:, a]].T for a in range(2)] for t in tables)
        s = [dq[:, self.joints[:, a]] for a in range(2)]
        v = np.concatenate([dq, np.ones((len(q), 1))], 1); acc = np.concatenate([ddq, np.zeros((len(q), 1))], 1)
        V = [v[:, self.speeds[:, b]] for b in range(3)]; C = [acc[:, self.speeds[:, b]] for b in range(3)]
        rest = [V[1] * V[2], V[0] * V[2], V[0] * V[1]]
        pi = V[0] * rest[0]; f = U[0] * U[1]
        T = sum(c * r for c, r in zip(C, rest))
        S = D[0] * s[0] * U[1] + D[1] * s[1] * U[0]
        A = S * pi + f * T
        if not grad: return A, None, None, None
        gq = [DD[0] * s[0] * U[1] * pi + D[0] * D[1] * s[1] * pi + D[0] * U[1] * T,
              DD[1] * s[1] * U[0] * pi + D[0] * D[1] * s[0] * pi + D[1] * U[0] * T]
        gv_pos = [D[0] * U[1] * pi, D[1] * U[0] * pi]
        gv = [rest[0] * S + f * (C[1] * V[2] + C[2] * V[1]), rest[1] * S + f * (C[0] * V[2] + C[2] * V[0]), rest[2] * S + f * (C[0] * V[1] + C[1] * V[0])]
        return A, gq, (gv_pos, gv), [f * r for r in rest]

    def _tables(self, q):
        h = 1 / self.half
        x = (q - self.middle) * h
        one, zero = np.ones_like(q), np.zeros_like(q)
        s, c, s2, c2 = np.sin(q), np.cos(q), np.sin(2 * q), np.cos(2 * q)
        U = np.stack([one, x, s, c, s2, c2, x * x])
        D = np.stack([zero, one * h, c, -s, 2 * c2, -2 * s2, 2 * x * h])
        DD = np.stack([zero, zero, -s, -c, -4 * s2, -4 * c2, 2 * one * h * h])
        return U, D, DD


def candidates(middle, half, speed, kinds=(1, 2, 3, 4, 5, 6), pairs=False, cubic=True, first=0):
    nv = len(middle)
    F = [(0, 0, 0, 0)] + [(j, c, 0, 0) for j in range(first, nv) for c in kinds]
    P = [(j, c, k, d) for j in range(first, nv) for k in range(first, j) for c in (2, 3) for d in (2, 3)] if pairs else []
    rows = [(f, (i, nv, nv)) for f in F + P for i in range(nv)]
    if cubic:
        rows += [(f, (i, j, k)) for f in F for i in range(nv) for j in range(i + 1) for k in range(j + 1)]
    J = np.array([[f[0], f[2]] for f, _ in rows]); K = np.array([[f[1], f[3]] for f, _ in rows])
    return TestFunctions(J, K, np.array([v for _, v in rows]), middle, half, speed)


@dataclass(frozen=True, eq=False)
class Band:
    """Second moments of a periodic motion with harmonics 1 … H.

    With the power S_h ⪰ 0 of each harmonic, E[q̃q̃ᵀ] = Σ S_h, E[q̇q̇ᵀ] = Σ h²ω² S_h and
    E[q̈q̈ᵀ] = Σ h⁴ω⁴ S_h, so Σ c(h²) S_h ⪰ 0 for each quadratic c that is not negative at
    h = 0 … H. They are combinations of (s − k²)(s − (k+1)²) and s (H² − s).
    """

    omega: float
    harmonics: int

    @property
    def quadratics(self) -> Array:
        """Coefficients of 1, s, s² per cone, scaled, shape (H + 1, 3)."""
        H = self.harmonics
        out = [[k * k * (k + 1) ** 2, -(k * k + (k + 1) ** 2), 1] for k in range(H)]
        out.append([0, H * H, -1])
        c = np.array(out, float)
        return c / np.abs(c * [1, H**2, H**4]).max(axis=1, keepdims=True)

    def scaled(self, x: Array, dq: Array, ddq: Array) -> tuple[Array, Array, Array]:
        return x, dq / self.omega, ddq / self.omega**2

    def matrices(self, x: Array, dq: Array, ddq: Array) -> list[Array]:
        """N per cone, each (n, nv, nv)."""
        outer = [v[:, :, None] * v[:, None, :] for v in self.scaled(x, dq, ddq)]
        return [sum(a * o for a, o in zip(c, outer, strict=True)) for c in self.quadratics]

    def form(self, B: Sequence[Array]) -> list[Array]:
        """Σ ⟨B, N⟩ as quadratic forms of q̃, q̇ and q̈."""
        c = self.quadratics
        w = self.omega
        return [
            sum(c[k, d] * B[k] for k in range(len(B))) / w ** (2 * d) for d in range(3)
        ]
