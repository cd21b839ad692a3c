"""Angles that a description rounds: a multiple of 15° written with few digits is meant exactly.

A right angle written as 1.5708 would let torque depend, by rounding alone, on parameters that it
does not depend on. An angle is taken as a multiple of 15°, other than zero, that is nearer than one
unit of its last printed digit (3.1415 is π cut off), and no further than 2 mrad (3.14 is π).
"""

import re
import warnings
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from excitant.names import listed
from excitant.robots.motion import Array

STEP = np.pi / 12
_FURTHEST = 2e-3  # rad
_UNSEEN = (
    1e-8  # rad: too little for a decision on what torque shows, and so for a note
)
_SHOWN = 4
_TURNS = 1e3  # beyond which no number is an angle
_ORDERS: tuple[Any, ...] = ("XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX")
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
        given = Rotation.from_quat(wxyz, scalar_first=True)
        unit = min(_unit(repr(float(value))) for value in wxyz)
        meant = (*_turns(given, 4 * unit), *_about_axis(given, 4 * unit))
        if not meant:
            return wxyz
        exact = meant[0]
        if (given.inv() * exact).magnitude() > _UNSEEN:
            words = [f"{value:g}" for value in wxyz]
            angle = float(np.degrees(exact.magnitude()))
            self.changed[f"({', '.join(words)})"] = angle
        return exact.as_quat(scalar_first=True)

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


def _unit(text: str) -> float:
    """Unit of the last printed digit."""
    mantissa, _, exponent = text.lower().partition("e")
    return float(10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2])))


def _turns(given: Rotation, near: float) -> Iterator[Rotation]:
    """Rotations about three axes in turn by multiples of 15°, as near as the digits say [rad]."""
    for axes in _ORDERS:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # of turns with no one way
            angles = given.as_euler(axes)
        exact = Rotation.from_euler(axes, STEP * np.round(angles / STEP))
        off = (given.inv() * exact).magnitude()
        if 0 < off <= min(near, _FURTHEST) and exact.magnitude() > 0:
            yield exact


def _about_axis(given: Rotation, near: float) -> Iterator[Rotation]:
    """A rotation by what its angle stands for, if its digits are of an angle rounded before."""
    turn = given.as_rotvec()
    angle = float(given.magnitude())
    for word in (f"{angle:.{digits}f}" for digits in (2, 3, 4)):
        meant = Angles().meant(word)
        if meant is not None and abs(float(word) - angle) <= min(near, 1e-5):
            yield Rotation.from_rotvec(turn * meant / angle)
