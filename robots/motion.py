"""Motion: sampled joint positions with their first and second derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]
Mask = npt.NDArray[np.bool_]


def read_only(values: npt.ArrayLike) -> Array:
    """Float array that refuses writing: a copy, or (a part of) what has been made one already."""
    if isinstance(values, np.ndarray) and values.dtype == np.float64:
        owner = values if values.base is None else values.base
        if (
            isinstance(owner, np.ndarray)
            and owner.flags.owndata
            and not owner.flags.writeable
        ):
            return values
    array = np.array(values, dtype=float)
    array.setflags(write=False)
    return array


def frozen(made: Array) -> Array:
    """An array just made, which nobody else holds, as `read_only` without a copy."""
    for each in (made, made.base):
        if isinstance(each, np.ndarray):
            each.setflags(write=False)
    return made


def freeze(noun: object, *names: str) -> None:
    """Replace arrays of a frozen dataclass, as it is made, by copies that refuse writing."""
    for name in names:
        object.__setattr__(noun, name, read_only(getattr(noun, name)))


@dataclass(frozen=True, eq=False)
class Noun:
    """A frozen dataclass whose fields declared as ``Array`` are copies that refuse writing."""

    def __post_init__(self) -> None:
        arrays = (
            field.name for field in fields(self) if field.type in ("Array", Array)
        )
        freeze(self, *arrays)


@dataclass(frozen=True, eq=False)
class Motion:
    """Joint motion at ``n`` instants.

    Attributes:
        t: Time, shape (n,) [s].
        q: Joint positions, shape (n, nv) [rad or m].
        dq: Joint velocities, shape (n, nv) [rad/s or m/s].
        ddq: Joint accelerations, shape (n, nv) [rad/s² or m/s²].
    """

    t: Array
    q: Array
    dq: Array
    ddq: Array

    def __post_init__(self) -> None:
        freeze(self, "t", "q", "dq", "ddq")
        if not (
            self.q.shape
            == self.dq.shape
            == self.ddq.shape
            == (len(self.t), self.nv)
        ):
            raise ValueError(
                f"shapes differ: t {self.t.shape}, q {self.q.shape}, "
                f"dq {self.dq.shape}, ddq {self.ddq.shape}"
            )

    @property
    def nv(self) -> int:
        """Number of joints."""
        return int(self.q.shape[1])

    def __len__(self) -> int:
        return len(self.t)

    def __repr__(self) -> str:
        span = float(np.ptp(self.t)) if len(self) else 0.0
        return f"Motion of {self.nv} joints: {len(self)} instants over {span:.4g} s"

    def __getitem__(self, rows: slice | Indices | Mask) -> Motion:
        """The motion at some of its instants."""
        return Motion(*(part[rows] for part in vars(self).values()))


def numbered(q: Array, dq: Array, ddq: Array) -> Motion:
    """States that follow no time, each of shape (n, nv)."""
    return Motion(np.arange(len(q), dtype=float), q, dq, ddq)


def together(motions: Sequence[Motion]) -> Motion:
    """The states of motions, one after another."""
    names = ("q", "dq", "ddq")
    return numbered(
        *(np.concatenate([getattr(m, name) for m in motions]) for name in names)
    )


def interpolated(at: Array, t: Array, values: Array) -> Array:
    """Columns of values at t, shape (n, k), between them at other instants, shape (m, k)."""
    return np.column_stack([np.interp(at, t, column) for column in values.T])


def root_mean_square(values: Array, axis: int | tuple[int, ...] = 0) -> Array:
    """Root mean square along axes, in the unit of the values."""
    return np.sqrt(np.mean(values**2, axis=axis))


def quotient(
    dividend: npt.ArrayLike, divisor: Array, otherwise: float = 0.0
) -> Array:
    """Dividend over divisor where that is positive, else a given value, each shape (...)."""
    made = np.full(divisor.shape, otherwise)
    return np.divide(dividend, divisor, out=made, where=divisor > 0)


def power_density(
    values: Array, rate_hz: float, longest: int
) -> tuple[Array, Array]:
    """Frequencies (m,) [Hz] and one-sided power density (m, ...) of columns, shape (n, ...).

    Mean over parts of at most ``longest`` samples that overlap by half, each less its own mean and
    under a Hann window (Welch 1967).
    """
    size = min(longest, len(values))
    windows = np.lib.stride_tricks.sliding_window_view(values, size, axis=0)
    parts = windows[:: size - size // 2]
    hann = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(size) / size)
    windowed = hann * (parts - parts.mean(axis=-1, keepdims=True))
    power = (np.abs(np.fft.rfft(windowed, axis=-1)) ** 2).mean(axis=0)
    power /= rate_hz * (hann**2).sum()
    # negative frequencies; neither 0 nor the Nyquist one
    power[..., 1 : (size + 1) // 2] *= 2
    f = np.asarray(np.fft.rfftfreq(size, 1 / rate_hz), float)
    return f, np.moveaxis(power, -1, 0)
