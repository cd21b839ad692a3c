"""The weighted linear problem W x ≈ τ: filtered columns, joint by joint, built once.

The columns of one joint are kept without those that are silent there: a joint feels its own link
and those beyond, and its own friction, so that less than half of W is held.

    problem = regression_of(model, model.effects, segments)      # all columns, torque, segments
    R, z = problem.factor(weight)                                # ‖R x − z‖² is the weighted misfit
    wider = problem.with_columns(more, names)                    # further effects
    fit = weighted_least_squares(problem.select(base.columns))   # with noise and covariance
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import scipy

from excitant.exceptions import BadInput
from excitant.identify.preprocessing import Segment
from excitant.identify.signals import live
from excitant.robots.effects import Effect
from excitant.robots.motion import Array, Motion, freeze, frozen, read_only
from excitant.robots.regressor import regressor
from excitant.robots.robot import Robot
from excitant.robots.torque import column_names

_SILENT = 1e-10  # of the longest column
_DEPENDENT = 1e-9  # of the largest singular value, columns of unit length
_MEMBER = 0.1  # of a dependence: its columns with at least this part

Index = npt.NDArray[np.intp]
Mask = npt.NDArray[np.bool_]


class ActingColumns(NamedTuple):
    """Columns of torque at n instants, k of them, on the m joints where they act; else zero."""

    joints: Index  # shape (m,)
    values: Array  # shape (n, m, k)

    @classmethod
    def of(cls, columns: Array, joints: Sequence[int] | None = None) -> ActingColumns:
        """Columns of all joints or some, shape (n, m, k)."""
        acts = live(columns).any(axis=1)
        known = np.arange(columns.shape[1])
        return cls(
            (known if joints is None else np.array(joints))[acts],
            columns if acts.all() else frozen(columns[:, acts]),
        )

    def __matmul__(self, x: Array) -> ActingColumns:
        """Their combinations by x, shape (k, l)."""
        return ActingColumns(self.joints, np.tensordot(self.values, x, 1))

    def on(self, nv: int) -> Array:
        """The columns with zeros where they do not act, shape (n, nv, k)."""
        n, _, k = self.values.shape
        found: Array = np.zeros((n, nv, k))
        found[:, self.joints] = self.values
        return found


@dataclass(frozen=True, eq=False)
class Regression:
    """W x ≈ τ at n instants of nv joints.

    Attributes:
        names: What the columns stand for, p of them.
        index: For each joint, which columns act on it, u of them.
        columns: For each joint, those columns, shape (n, u).
        tau: Torque, shape (n, nv) [N·m].
        used: Rows that count, shape (n, nv), the others zero; None where all do.
    """

    names: tuple[str, ...]
    index: tuple[Index, ...]
    columns: tuple[Array, ...]
    tau: Array
    used: Mask | None = None

    def __post_init__(self) -> None:
        freeze(self, "tau")
        if not all(np.isfinite(values).all() for values in (*self.columns, self.tau)):
            raise BadInput(
                "regression: values that are no finite numbers; remove their instants"
            )

    def __len__(self) -> int:
        return len(self.tau)

    @property
    def nv(self) -> int:
        """Number of joints."""
        return int(self.tau.shape[1])

    @property
    def p(self) -> int:
        """Number of columns."""
        return len(self.names)

    @property
    def W(self) -> Array:
        """All columns, zeros too, shape (n, nv, p)."""
        found: Array = np.zeros((len(self), self.nv, self.p))
        for j, (index, columns) in enumerate(
            zip(self.index, self.columns, strict=True)
        ):
            found[:, j, index] = columns
        return found

    def rows(self, joint: int) -> Mask | slice:
        """Rows of a joint that count."""
        return slice(None) if self.used is None else self.used[:, joint]

    def counted(self, values: Array) -> list[Array]:
        """Values of each joint, shape (n, nv), at its rows that count."""
        return [values[self.rows(j), j] for j in range(self.nv)]

    def torque(self, x: Array) -> Array:
        """W x, shape (p,) or (p, k) → (n, nv) or (n, nv, k)."""
        found = []
        for index, columns in zip(self.index, self.columns, strict=True):
            own = x[index]
            some = np.flatnonzero(
                own.any(axis=tuple(range(1, own.ndim)))
            )  # few of all candidates
            found.append(columns[:, some] @ own[some])
        return np.stack(found, axis=1)

    def residual(self, x: Array) -> Array:
        """τ − W x, shape (n, nv)."""
        return self.tau - self.torque(x)

    def select(
        self, columns: Sequence[int], names: Sequence[str] | None = None
    ) -> Regression:
        """The problem with some of its columns, in this order, and names for them."""
        place = np.full(self.p, -1)
        place[list(columns)] = np.arange(len(columns))
        index = []
        kept = []
        for own, values in zip(self.index, self.columns, strict=True):
            here = np.flatnonzero(place[own] >= 0)
            here = here[np.argsort(place[own[here]])]
            index.append(place[own[here]])
            kept.append(frozen(values[:, here]))
        named = (
            tuple(names) if names is not None else tuple(self.names[k] for k in columns)
        )
        return replace(self, names=named, index=tuple(index), columns=tuple(kept))

    def with_columns(self, more: Array, names: Sequence[str]) -> Regression:
        """The problem with further columns, shape (n, nv, k)."""
        index = []
        wider = []
        more = more if self.used is None else more * self.used[:, :, None]
        for j, (own, values) in enumerate(zip(self.index, self.columns, strict=True)):
            acting = np.flatnonzero(live(more[:, j]))
            index.append(np.concatenate([own, self.p + acting]))
            wider.append(
                frozen(np.asfortranarray(np.hstack([values, more[:, j, acting]])))
            )
        return replace(
            self, names=(*self.names, *names), index=tuple(index), columns=tuple(wider)
        )

    def counting(self, rows: Mask) -> Regression:
        """The problem with rows of joints that do not count set to zero, shape (n, nv)."""
        used = rows if self.used is None else rows & self.used
        columns = (v * used[:, [j]] for j, v in enumerate(self.columns))
        tau = self.tau * used
        return replace(self, columns=tuple(map(frozen, columns)), tau=tau, used=used)

    def at(self, instants: slice) -> Regression:
        """The problem at some instants."""
        columns = tuple(read_only(values[instants]) for values in self.columns)
        used = None if self.used is None else self.used[instants]
        return replace(self, columns=columns, tau=self.tau[instants], used=used)

    def with_torque(self, tau: Array) -> Regression:
        """The same columns for another torque, shape (n, nv)."""
        return replace(self, tau=tau if self.used is None else tau * self.used)

    @cached_property
    def grams(self) -> tuple[Array, ...]:
        """Of each joint [W τ]ᵀ[W τ], shape (u + 1, u + 1)."""
        found = []
        for X, tau in zip(self.columns, self.tau.T, strict=True):
            b = X.T @ tau
            found.append(frozen(np.block([[X.T @ X, b[:, None]], [b, tau @ tau]])))
        return tuple(found)

    def gram(self, weight: Array, columns: Index | None = None) -> Array:
        """[W τ]ᵀ[W τ] of all p or some columns, joints weighted, shape (p + 1, p + 1)."""
        columns = np.arange(self.p) if columns is None else columns
        place = np.full(self.p + 1, -1)
        place[columns], place[-1] = np.arange(len(columns)), len(columns)
        total = np.zeros((len(columns) + 1, len(columns) + 1))
        for w, index, own in zip(weight, self.index, self.grams, strict=True):
            at = place[np.append(index, self.p)]
            here = np.flatnonzero(at >= 0)
            total[np.ix_(at[here], at[here])] += w * own[np.ix_(here, here)]
        return total

    @cached_property
    def triangles(self) -> tuple[Array, ...]:
        """Of each joint the triangle of [W τ], which keeps all digits, shape (≤ u + 1, u + 1)."""
        pairs = enumerate(self.columns)
        return tuple(triangle(np.column_stack([X, self.tau[:, j]])) for j, X in pairs)

    @cached_property
    def undetermined(self) -> tuple[int, ...]:
        """Columns that are silent, else those that others explain; none where all are shown.

        Decided by the motion alone: noise weighs rows, but shows and hides nothing.
        """
        rows = self.stacked(np.ones(self.nv))[:, :-1]
        norms = np.linalg.norm(rows, axis=0)
        silent = norms <= _SILENT * norms.max(initial=0.0)
        if silent.any():
            return tuple(np.flatnonzero(silent).tolist())
        _, s, Vt = np.linalg.svd(triangle(rows / norms))
        if len(s) == self.p and (not len(s) or s[-1] >= _DEPENDENT * s[0]):
            return ()
        return tuple(np.flatnonzero(np.abs(Vt[-1]) > _MEMBER).tolist())

    def factor(self, weight: Array) -> tuple[Array, Array]:
        """R and z with ‖R x − z‖² = Σ_j (w_j ‖τ_j − W_j x‖)²."""
        R = triangle(self.stacked(weight))
        return R[:, :-1], R[:, -1]

    def stacked(self, weight: Array) -> Array:
        """The weighted triangles of all joints over each other, shape (rows, p + 1)."""
        parts = []
        for w, index, own in zip(weight, self.index, self.triangles, strict=True):
            part = np.zeros((len(own), self.p + 1))
            part[:, np.append(index, self.p)] = w * own
            parts.append(part)
        return np.concatenate(parts)


def triangle(A: Array) -> Array:
    """R of A = Q R, without rows of zeros below, shape (min(n, m), m)."""
    return scipy.linalg.qr(A, mode="r")[0][: A.shape[1]]


def dense(
    W: Array | Sequence[ActingColumns],
    tau: Array,
    names: Sequence[str],
    used: Mask | None = None,
) -> Regression:
    """The problem of columns of shape (n, nv, p), or of parts of them, and torque (n, nv).

    Rows that do not count are set to zero.
    """
    n, nv = tau.shape
    parts = [ActingColumns(np.arange(nv), W)] if isinstance(W, np.ndarray) else W
    shapes = [part.values.shape for part in parts]
    p = sum(shape[-1] for shape in shapes)
    fitting = [
        (n, len(part.joints), shape[-1])
        for part, shape in zip(parts, shapes, strict=True)
    ]
    if shapes != fitting or len(names) != p:
        raise BadInput(
            f"regression: columns of shape {' + '.join(map(str, shapes))} with "
            f"torque of shape {tau.shape} and {len(names)} names; give (n, nv, p), (n, nv) and p"
        )
    index: list[list[Index]] = [[np.zeros(0, np.intp)] for _ in range(nv)]
    rows: list[list[Array]] = [[np.zeros((0, n))] for _ in range(nv)]
    start = 0
    for part, shape in zip(parts, shapes, strict=True):
        for j, own in zip(part.joints, part.values.transpose(1, 2, 0), strict=True):
            acts = np.flatnonzero(live(own.T))
            index[j].append(start + acts)
            rows[j].append(own if len(acts) == len(own) else own[acts])
        start += shape[-1]
    columns = [np.concatenate(own) for own in rows]
    if used is not None:
        tau = tau * used
        for own, counts in zip(columns, used.T, strict=True):
            own *= counts
    found = tuple(frozen(own.T) for own in columns)
    return Regression(tuple(names), tuple(map(np.concatenate, index)), found, tau, used)


def regression_of(
    robot: Robot, effects: Sequence[Effect], segments: Sequence[Segment]
) -> Regression:
    """Columns of links and effects at the rows of segments, with the torque measured there.

    Smooth columns are evaluated at the rate that positions need (`Segment.thin`), those that jump
    at every sample. Effects that rest on the torque of the arm take it from the robot.
    """
    names = column_names(robot, effects)
    parts = []
    for s in segments:
        columns = [ActingColumns.of(s.thin.rows(partial(regressor, robot)))]
        columns += [effect_columns(robot, effect, [s]) for effect in effects]
        parts.append(dense(columns, s.tau[s.keep], names))
    return joined(parts)


def effect_columns(
    robot: Robot, effect: Effect, segments: Sequence[Segment]
) -> ActingColumns:
    """Columns of one effect at the rows of segments; see `regression_of`."""
    joints = effect.affected(robot)

    def columns(motion: Motion) -> Array:
        return effect.columns(robot, motion)[:, joints]

    parts = [(s.thin if effect.physics.smooth else s).rows(columns) for s in segments]
    return ActingColumns.of(frozen(np.concatenate(parts)), joints)


def joined(parts: Sequence[Regression]) -> Regression:
    """One problem of problems with the same columns, one after the other."""
    index = []
    columns = []
    for j in range(parts[0].nv):
        acting = np.unique(np.concatenate([part.index[j] for part in parts]))
        found = np.zeros((sum(map(len, parts)), len(acting)), order="F")
        begin = 0
        for part in parts:
            rows = slice(begin, begin + len(part))
            found[rows, np.searchsorted(acting, part.index[j])] = part.columns[j]
            begin += len(part)
        index.append(acting)
        columns.append(frozen(found))
    tau = np.concatenate([part.tau for part in parts])
    return Regression(parts[0].names, tuple(index), tuple(columns), tau)
