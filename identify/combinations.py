"""Combinations of base parameters in readable form: each with a leading parameter of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from excitant.robots.motion import Array, freeze

_CLEAR = (0.3, 0.1, 1e-2, 1e-4, 1e-7)  # share of a leading parameter outside those before it
_NOTHING = 1e-6  # coefficient, in units of the parameters' scale


@dataclass(frozen=True, eq=False)
class Combinations:
    """Rows of coefficients F, each with the coefficient 1 of a parameter that no other row has.

    Attributes:
        F: Coefficients, shape (k, r).
        leading: The parameter that leads each row, k of them.
    """

    F: Array
    leading: tuple[int, ...]

    def __post_init__(self) -> None:
        freeze(self, "F")

    def __len__(self) -> int:
        return len(self.leading)

    def with_more(self, rows: Array, scale: Array, preferred: Sequence[int]) -> Combinations:
        """These and further independent rows, free of the parameters that lead these.

        Args:
            rows: Coefficients of the further combinations, shape (m, r).
            scale: Scale of each parameter, shape (r,).
            preferred: Parameters that should lead, in this order; then the others.
        """
        if len(rows) == 0:
            return self
        led = list(self.leading)
        rest = (rows - rows[:, led] @ self.F) * scale
        rest[:, led] = 0.0
        Q = np.linalg.qr(rest.T)[0].T
        others = [k for k in range(len(scale)) if k not in preferred]
        free = [k for k in (*preferred, *others) if k not in led]
        leading = _leading(Q, free)
        new = np.linalg.solve(Q[:, leading], Q)
        new[np.abs(new) < _NOTHING] = 0.0
        new[:, leading] = np.eye(len(leading))
        new *= scale[leading, None] / scale
        return Combinations(np.vstack([self.F, new]), (*self.leading, *leading))


def no_combinations(r: int) -> Combinations:
    """None of r parameters."""
    return Combinations(np.zeros((0, r)), ())


def _leading(Q: Array, order: Sequence[int]) -> list[int]:
    """The first columns, in an order, that are clearly independent; as many as rows."""
    chosen: list[int] = []
    basis = np.zeros((len(Q), 0))
    for clear in _CLEAR:
        for k in order:
            if len(chosen) == len(Q):
                return chosen
            if k in chosen:
                continue
            rest = Q[:, k] - basis @ (basis.T @ Q[:, k])
            size = float(np.linalg.norm(rest))
            if size > clear:
                basis = np.column_stack([basis, rest / size])
                chosen.append(k)
    return chosen
