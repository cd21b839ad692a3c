"""Columns of a diagnosis at the rows of a recording, joint by joint without what is zero."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from excitant.robots.motion import Array, read_only

Index = npt.NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Signatures:
    """Columns of shape (n, nv, p), most of which act on one joint only.

    Attributes:
        size: Number of columns p.
        index: For each joint, which columns act on it.
        rows: For each joint, those columns, shape (n, len(index)).
    """

    size: int
    index: tuple[Index, ...]
    rows: tuple[Array, ...]

    @property
    def nv(self) -> int:
        """Number of joints."""
        return len(self.rows)

    def __len__(self) -> int:
        return len(self.rows[0])

    @cached_property
    def grams(self) -> tuple[Array, ...]:
        """Inner products of each joint's columns, shape (len(index), len(index))."""
        return tuple(read_only(X.T @ X) for X in self.rows)

    def acting(self, columns: slice) -> Iterator[tuple[int, Index]]:
        """Joints that some columns act on, each with where these are among its own."""
        for j, at in enumerate(self.index):
            here = np.flatnonzero((at >= columns.start) & (at < columns.stop))
            if len(here):
                yield j, here

    def moments(self, r: Array) -> Array:
        """Inner products of all columns with torque (n, nv), joint by joint: (nv, p)."""
        found = np.zeros((self.nv, self.size))
        for j, (at, X) in enumerate(zip(self.index, self.rows, strict=True)):
            found[j, at] = X.T @ r[:, j]
        return found

    def gram(self, weight: Array) -> Array:
        """Inner products over all joints, weighted by joint, shape (p, p)."""
        total = np.zeros((self.size, self.size))
        for w, at, G in zip(weight, self.index, self.grams, strict=True):
            total[np.ix_(at, at)] += w * G
        return total

    def torque(self, coordinates: Array) -> Array:
        """All columns times coordinates, (p, ...) → (n, nv, ...)."""
        used = np.asarray(coordinates.reshape(self.size, -1).any(axis=1))
        parts = []
        for at, X in zip(self.index, self.rows, strict=True):
            here = np.flatnonzero(used[at])
            parts.append(X[:, here] @ coordinates[at[here]])
        return np.stack(parts, axis=1)


def signatures(columns: Sequence[Array], counts: npt.NDArray[np.bool_]) -> Signatures:
    """Signatures of blocks of columns, each of shape (n, nv, k), where rows count, (n, nv)."""
    size = sum(block.shape[2] for block in columns)
    index, rows = [], []
    for j in range(columns[0].shape[1]):
        whole = np.concatenate([block[:, j] for block in columns], axis=1)
        at = np.flatnonzero(whole.any(axis=0))
        index.append(at)
        rows.append(read_only(np.asfortranarray(whole[:, at] * counts[:, [j]])))
    return Signatures(size, tuple(index), tuple(rows))
