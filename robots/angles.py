"""Angles that a description rounds: a multiple of 15° written with few digits is meant exactly.

A right angle written as 1.5708 would let torque depend, by rounding alone, on parameters that it
does not depend on. An angle is taken as a multiple of 15°, other than zero, that is nearer than one
unit of its last printed digit (3.1415 is π cut off), and no further than 2 mrad (3.14 is π).
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from itertools import permutations

import numpy as np
import pinocchio as pin

from excitant.names import listed
from excitant.robots.motion import Array

STEP = np.pi / 12
_FURTHEST = 2e-3  # rad
_UNSEEN = (
    1e-8  # rad: too little for a decision on what torque shows, and so for a note
)
_SHOWN = 4
_TURNS = 1e3  # beyond which no number is an angle
_RPY = re.compile(r"""(?<=\srpy=)(["'])([^"']*)\1""")


class Angles:
    """Reads angles as they are meant, and remembers which it changed.

    Attributes:
        changed: Angles as written, and in degrees as they are meant.
    """

    def __init__(self) -> None:
        self.changed: dict[str, float] = {}

    def meant(self, text: str) -> float | None:
        """Multiple of 15° that an angle stands for [rad], if it is not that already."""
        value = float(text)
        if not abs(value) < _TURNS:
            return None
        multiple = round(value / STEP)
        exact = float(multiple * STEP)
        off = abs(value - exact)
        if not multiple or not 0 < off <= min(_unit(text), _FURTHEST):
            return None
        if off > _UNSEEN:
            self.changed[text] = 15.0 * multiple
        return exact

    def exact(self, values: Iterable[float]) -> Array:
        """Angles that were read as numbers, with the digits that these need [rad]."""
        words = [repr(float(value)) for value in values]
        return np.array([self._exact(word) for word in words], float)

    def urdf(self, text: str) -> str:
        """A URDF whose ``rpy`` are exact; what they are not is left as it is."""
        return _RPY.sub(
            lambda found: f"{found[1]}{self._words(found[2])}{found[1]}", text
        )

    def _words(self, text: str) -> str:
        words = text.split()
        try:
            exact = list(map(self._exact, words))
        except ValueError:
            return text  # refused where it is read as numbers
        return text if exact == words else " ".join(map(str, exact))

    def _exact(self, word: str) -> float | str:
        """What an angle stands for, or itself."""
        exact = self.meant(word)
        return word if exact is None else exact

    def quaternion(self, wxyz: Array) -> Array:
        """A quaternion of turns by multiples of 15°, where rounding explains the rest."""
        if not 0 < np.abs(wxyz).max() < _TURNS:
            return wxyz
        words = [repr(float(value)) for value in wxyz]
        unit = min(map(_unit, words))
        length = float(np.linalg.norm(wxyz))
        given = np.asarray(wxyz, float) / length
        R = pin.Quaternion(*given).matrix()
        turn = pin.log3(R)
        angle = _angle(R)
        for exact in (_turns(R, axes) for axes in permutations(range(3))):
            off = _angle(R.T @ exact)
            if 0 < off <= min(4 * unit, _FURTHEST) and not np.allclose(
                exact, np.eye(3)
            ):
                break
        else:  # perhaps the digits are those of an angle that was rounded before
            words = [f"{angle:.{digits}f}" for digits in (2, 3, 4)]
            near = (
                w for w in words if abs(float(w) - angle) <= min(4 * unit, 1e-5)
            )
            meant = next(
                (a for a in map(Angles().meant, near) if a is not None), None
            )
            if meant is None:
                return wxyz
            exact = pin.exp3(turn * meant / angle)
            off = abs(meant - angle)
        if off > _UNSEEN:
            words = [f"{value:g}" for value in wxyz]
            self.changed[f"({', '.join(words)})"] = float(np.degrees(_angle(exact)))
        x, y, z, w = pin.Quaternion(exact).coeffs()
        return np.array([w, x, y, z])

    @property
    def notes(self) -> tuple[str, ...]:
        """A sentence on what was changed, if anything."""
        shown = [f"{text} as {angle:.4g}°" for text, angle in self.changed.items()]
        if not shown:
            return ()
        changes = listed(shown, _SHOWN)
        return (
            f"angles rounded in the file are taken as multiples of 15°: {changes}",
        )


def _angle(R: Array) -> float:
    """Angle of a rotation [rad]."""
    return float(np.linalg.norm(pin.log3(R)))


def _unit(text: str) -> float:
    """Unit of the last printed digit."""
    mantissa, _, exponent = text.lower().partition("e")
    return float(10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2])))


def _turns(R: Array, axes: tuple[int, ...]) -> Array:
    """Rotation about three different axes in turn by the nearest multiples of 15°."""
    i, j, k = axes
    sign = 1.0 if (j - i) % 3 == 1 else -1.0
    angles = (
        np.arctan2(-sign * R[j, k], R[k, k]),
        np.arcsin(np.clip(sign * R[i, k], -1, 1)),
        np.arctan2(-sign * R[i, j], R[i, i]),
    )
    exact: Array = np.eye(3)
    for axis, angle in zip(axes, angles, strict=True):
        exact = exact @ pin.exp3(STEP * round(angle / STEP) * np.eye(3)[axis])
    return exact
