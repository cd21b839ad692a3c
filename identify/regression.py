"""The weighted linear problem W x ≈ τ: filtered columns, joint by joint, built once.

The columns of one joint are kept without those that are silent there: a joint feels its own link
and those beyond, and its own friction, so that less than half of W is held.

    problem = regression_of(model, model.effects, segments)      # all columns, torque, segments
    R, z = problem.factor(weight)                                # ‖R x − z‖² is the weighted misfit
    wider = problem.with_columns(more, names)                    # further effects
    fit = weighted_least_squares(problem.select(base.columns))   # with noise and covariance
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
import scipy

from excitant.exceptions import BadInput
from excitant.identify.preprocessing import Segment
from excitant.identify.signals import live
from excitant.robots.effects import Effect
from excitant.robots.motion import (
    Array,
    Indices,
    Mask,
    Motion,
    freeze,
    frozen,
    read_only,
)
from excitant.robots.regressor import regressor
from excitant.robots.robot import Robot
from excitant.robots.torque import column_names

SILENT = 1e-10  # length of a column over the longest
DEPENDENT = 1e-9  # singular value over the largest, columns of unit length
MEMBER = 0.1  # least part of a column that is a member of a dependence


class ActingColumns(NamedTuple):
    """Columns of torque at n instants, k of them, on the m joints where they act; else zero."""

    joints: Indices  # shape (m,)
    values: Array  # shape (n, m, k)

    @classmethod
    def of(
        cls, columns: Array, joints: Sequence[int] | None = None
    ) -> ActingColumns:
        """Columns of all joints or some, shape (n, m, k)."""
        acts = live(columns).any(axis=1)
        names = np.arange(columns.shape[1]) if joints is None else np.array(joints)
        acting = columns if acts.all() else frozen(columns[:, acts])
        return cls(names[acts], acting)

    def __matmul__(self, x: Array) -> ActingColumns:
        """Their combinations by x, shape (k, l)."""
        return ActingColumns(self.joints, np.tensordot(self.values, x, 1))

    def on(self, nv: int) -> Array:
        """The columns with zeros where they do not act, shape (n, nv, k)."""
        n, _, k = self.values.shape
        columns = np.zeros((n, nv, k))
        columns[:, self.joints] = self.values
        return columns


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
    index: tuple[Indices, ...]
    columns: tuple[Array, ...]
    tau: Array
    used: Mask | None = None

    def __post_init__(self) -> None:
        freeze(self, "tau")
        if not all(
            np.isfinite(values).all() for values in (*self.columns, self.tau)
        ):
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
        W = np.zeros((len(self), self.nv, self.p))
        for j, index in enumerate(self.index):
            W[:, j, index] = self.columns[j]
        return W

    @cached_property
    def acts(self) -> Mask:
        """Which columns act on which joint, shape (nv, p)."""
        acts = np.zeros((self.nv, self.p), bool)
        for j, index in enumerate(self.index):
            acts[j, index] = True
        return acts

    def rows(self, joint: int) -> Mask | slice:
        """Rows of a joint that count."""
        return slice(None) if self.used is None else self.used[:, joint]

    def counted(self, values: Array) -> list[Array]:
        """Values of each joint, shape (n, nv), at its rows that count."""
        return [values[self.rows(j), j] for j in range(self.nv)]

    def torque(self, x: Array) -> Array:
        """W x, shape (p,) or (p, k) → (n, nv) or (n, nv, k)."""
        tau = []
        for index, columns in zip(self.index, self.columns, strict=True):
            own = x[index]
            nonzero = np.asarray(own.any(axis=tuple(range(1, own.ndim))), bool)
            # those up to the first zero, of given values, are not copied
            first = np.append(nonzero, False).argmin()
            few = first + np.flatnonzero(nonzero[first:])
            tau.append(
                columns[:, :first] @ own[:first] + columns[:, few] @ own[few]
            )
        return np.stack(tau, axis=1)

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
        selected = []
        for acting, values in zip(self.index, self.columns, strict=True):
            target = place[acting]
            order = np.argsort(target)
            order = order[target[order] >= 0]
            index.append(target[order])
            selected.append(frozen(values[:, order]))
        names = [self.names[k] for k in columns] if names is None else names
        return replace(
            self, names=tuple(names), index=tuple(index), columns=tuple(selected)
        )

    def with_columns(self, more: Array, names: Sequence[str]) -> Regression:
        """The problem with further columns, shape (n, nv, k)."""
        return self.with_parts([ActingColumns(np.arange(self.nv), more)], names)

    def with_parts(
        self, parts: Sequence[ActingColumns], names: Sequence[str]
    ) -> Regression:
        """The problem with further columns, in parts; zero at rows that do not count."""
        index = [[own] for own in self.index]
        columns = [[own.T] for own in self.columns]
        start = self.p
        for part in parts:
            of_joints = part.values.transpose(1, 2, 0)
            for j, values in zip(part.joints, of_joints, strict=True):
                acts = live(values.T)
                index[j].append(start + np.flatnonzero(acts))
                used = True if self.used is None else self.used[:, j]
                columns[j].append(values[acts] * used)
            start += part.values.shape[-1]
        wider = tuple(frozen(np.concatenate(rows).T) for rows in columns)
        return replace(
            self,
            names=(*self.names, *names),
            index=tuple(map(np.concatenate, index)),
            columns=wider,
        )

    def with_column(self, column: int, joint: int, values: Array) -> Regression:
        """The problem with other values, shape (n,), of a column on a joint on which it acts."""
        columns = list(self.columns)
        own = np.array(columns[joint], order="F")
        own[:, self.index[joint] == column] = values[:, None]
        columns[joint] = frozen(own)
        return replace(self, columns=tuple(columns))

    def counting(self, rows: Mask) -> Regression:
        """The problem with rows of joints that do not count set to zero, shape (n, nv)."""
        used = rows if self.used is None else rows & self.used
        columns = (v * used[:, [j]] for j, v in enumerate(self.columns))
        tau = self.tau * used
        return replace(
            self, columns=tuple(map(frozen, columns)), tau=tau, used=used
        )

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
        pairs = zip(self.columns, self.tau.T, strict=True)
        joints = [np.column_stack([X, tau]) for X, tau in pairs]
        return tuple(frozen(both.T @ both) for both in joints)

    @cached_property
    def products(self) -> scipy.sparse.csc_array:
        """Of each joint [W τ]ᵀ[W τ] among all columns, as a column, shape ((p + 1)², nv)."""
        return self.products_of(np.arange(self.p))

    def products_of(self, columns: Indices) -> scipy.sparse.csc_array:
        """Of each joint [W τ]ᵀ[W τ] of some columns, as a column, shape ((columns + 1)², nv)."""
        size = len(columns) + 1
        place = np.full(self.p + 1, -1, np.int32)
        place[np.append(columns, self.p)] = np.arange(size)
        rows = []
        values = []
        for index, gram in zip(self.index, self.grams, strict=True):
            target = place[np.append(index, self.p)]
            here = np.flatnonzero(target >= 0)
            at = target[here]
            rows.append((at[:, None] * size + at).ravel())
            values.append(gram[np.ix_(here, here)].ravel())
        ends = np.cumsum([0, *map(len, rows)], dtype=np.int32)
        parts = np.concatenate(values), np.concatenate(rows), ends
        return scipy.sparse.csc_array(parts, shape=(size * size, self.nv))

    def gram(self, weight: Array) -> Array:
        """[W τ]ᵀ[W τ] of all columns, joints weighted, shape (p + 1, p + 1)."""
        return weighted(self.products, weight)

    @cached_property
    def triangles(self) -> tuple[Array, ...]:
        """Of each joint the triangle of [W τ], which keeps all digits, shape (≤ u + 1, u + 1)."""
        pairs = zip(self.columns, self.tau.T, strict=True)
        return tuple(triangle(np.column_stack([X, tau])) for X, tau in pairs)

    @cached_property
    def undetermined(self) -> tuple[int, ...]:
        """Columns that are silent, else those that others explain; none where all are shown.

        Decided by the motion alone: noise weighs rows, but shows and hides nothing.
        """
        rows = self.stacked(np.ones(self.nv))[:, :-1]
        norms = np.linalg.norm(rows, axis=0)
        silent = norms <= SILENT * norms.max(initial=0.0)
        if silent.any():
            return tuple(np.flatnonzero(silent).tolist())
        _, s, Vt = np.linalg.svd(triangle(rows / norms))
        if len(s) == self.p and (not len(s) or s[-1] >= DEPENDENT * s[0]):
            return ()
        return tuple(np.flatnonzero(np.abs(Vt[-1]) > MEMBER).tolist())

    def factor(self, weight: Array) -> tuple[Array, Array]:
        """R and z with ‖R x − z‖² = Σ_j (w_j ‖τ_j − W_j x‖)²."""
        R = triangle(self.stacked(weight))
        return R[:, :-1], R[:, -1]

    def stacked(self, weight: Array) -> Array:
        """The weighted triangles of all joints over each other, shape (rows, p + 1)."""
        parts = []
        for w, index, R in zip(weight, self.index, self.triangles, strict=True):
            part = np.zeros((len(R), self.p + 1))
            part[:, np.append(index, self.p)] = w * R
            parts.append(part)
        return np.concatenate(parts)


def weighted(products: scipy.sparse.csc_array, weight: Array) -> Array:
    """Sum of products of joints, as of `Regression.products_of`, weighted, square."""
    size = math.isqrt(products.shape[0])
    return (products @ weight).reshape(size, size)


def triangle(A: Array) -> Array:
    """R of A = Q R, without rows of zeros below, shape (min(n, m), m)."""
    return np.asarray(np.linalg.qr(A, mode="r"), float)


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
    expected = [(n, len(part.joints), part.values.shape[-1]) for part in parts]
    if shapes != expected or len(names) != p:
        raise BadInput(
            f"regression: columns of shape {' + '.join(map(str, shapes))} with "
            f"torque of shape {tau.shape} and {len(names)} names; give (n, nv, p), (n, nv) and p"
        )
    empty = Regression(
        names=(),
        index=(np.zeros(0, np.intp),) * nv,
        columns=(np.zeros((n, 0)),) * nv,
        tau=tau if used is None else tau * used,
        used=used,
    )
    return empty.with_parts(parts, names)


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
        columns += effect_columns(robot, effects, [s])
        parts.append(dense(columns, s.tau[s.keep], names))
    return joined(parts)


def effect_columns(
    robot: Robot, effects: Sequence[Effect], segments: Sequence[Segment]
) -> list[ActingColumns]:
    """Columns of each effect at the rows of segments; see `regression_of`."""
    joints = [effect.affected(robot) for effect in effects]
    parts: list[list[Array]] = [[] for _ in effects]

    def columns(k: int, motion: Motion) -> Array:
        return effects[k].columns(robot, motion)[:, joints[k]]

    for segment in segments:
        for smooth, sampled in ((True, segment.thin), (False, segment)):
            alike = [
                k
                for k, effect in enumerate(effects)
                if effect.physics.smooth == smooth
            ]
            rows = sampled.rows_of([partial(columns, k) for k in alike])
            for k, values in zip(alike, rows, strict=True):
                parts[k].append(values)
    return [
        ActingColumns.of(frozen(np.concatenate(values)), at)
        for values, at in zip(parts, joints, strict=True)
    ]


def joined(parts: Sequence[Regression]) -> Regression:
    """One problem of problems with the same columns, one after the other."""
    index = []
    columns = []
    for j in range(parts[0].nv):
        acting = np.unique(np.concatenate([part.index[j] for part in parts]))
        stacked = np.zeros((sum(map(len, parts)), len(acting)), order="F")
        begin = 0
        for part in parts:
            rows = slice(begin, begin + len(part))
            stacked[rows, np.searchsorted(acting, part.index[j])] = part.columns[j]
            begin += len(part)
        index.append(acting)
        columns.append(frozen(stacked))
    tau = np.concatenate([part.tau for part in parts])
    return Regression(parts[0].names, tuple(index), tuple(columns), tau)
