"""The seed's arm, the CMU DD Arm II: Tables 2 to 4 of Khosla (1987), initial and estimated.

The arm itself is ``load_robot("cmu_dd_arm_ii")``; its file says what is printed, what is derived
and what is assumed (all lengths are).
"""

from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np

from excitant.robots import DHChain, Robot, load_robot
from excitant.robots.angles import Angles
from excitant.robots.dh import chain_from_record, joint_frames
from excitant.robots.loading import builtin_record
from excitant.robots.motion import Array
from excitant.robots.parameters import STANDARD, elements, moved_parameters, steiner

Column = Literal["initial", "estimated"]

_NAME = "cmu_dd_arm_ii"
_M4, _M5 = 1.880, 0.937  # kg, initially; the tables estimate their sum only
_SLENDER = 0.2  # assumed: central moment along the arm relative to that across


@dataclass(frozen=True)
class TableEntry:
    """One row of the tables.

    Inertias are about the distal Denavit-Hartenberg frame of the link (I1zz about the centre of
    mass); products are +∫ x y dm, the opposite of the tensor element.
    """

    name: str  # as in the paper, e.g. ``m4s4z``, ``I6xy`` or ``m5+m4``
    parameter: str  # the standard parameter it is, e.g. ``link4.mcz``
    initial: float  # from drawings, as read
    estimated: float  # from the experiment, as read
    doubtful: str = ""  # which column: ``""``, ``"initial"``, ``"estimated"``, ``"both"``
    printed: str = ""  # what the print or its scan shows, where in doubt
    likely: float | None = None  # what it probably is; None when unknown or when as read
    why: str = ""  # reason for the doubt

    def value(self, column: Column, likely: bool = False) -> float:
        """The value of a column, as read or, where in doubt, as it probably is."""
        if likely and self.likely is not None and self.doubtful in (column, "both"):
            return self.likely
        return self.initial if column == "initial" else self.estimated


@cache
def dd_arm_tables() -> tuple[TableEntry, ...]:
    """The 46 rows of Tables 2 to 4, link 6 first, doubtful digits marked."""
    return tuple(TableEntry(**row) for row in builtin_record(_NAME).tables or ())


@cache
def dd_arm_chain() -> DHChain:
    """The arm in the paper's frames (standard Denavit-Hartenberg); lengths are assumed."""
    return chain_from_record(builtin_record(_NAME), _NAME, Angles())


def dd_arm_parameters(column: Column = "initial", *, likely: bool = False) -> Array:
    """Standard parameters of a column about the frames of `dd_arm_chain`, shape (60,).

    m4 + m5 is shared out as initially (1.880 to 0.937). What the tables leave out of links 1
    and 2 is assumed: centre of mass in the listed directions only, central moments across the
    arm equal, along it a fifth. No torque depends on it. The estimated links 4 and 5 are not
    physically consistent, as printed. ``likely``: doubtful values as they probably are.
    """
    phi = np.zeros((6, 10))
    for entry in dd_arm_tables():
        value = entry.value(column, likely)
        if entry.name == "m5+m4":
            phi[3, 0], phi[4, 0] = np.array([_M4, _M5]) / (_M4 + _M5) * value
            continue
        link, symbol = entry.parameter.split(".")
        product = symbol in ("Ixy", "Ixz", "Iyz")
        phi[int(link[4:]) - 1, STANDARD.index(symbol)] = -value if product else value
    return np.concatenate([_about_frame(phi[0], 9, 6, True), _about_frame(phi[1], 6, 9), *phi[2:]])


def _about_frame(phi: Array, known: int, other: int, central: bool = False) -> Array:
    """A long body along x of whose inertia one element across is known, shape (10,)."""
    m, c = phi[0], phi[1:4] / phi[0]
    body, lever = np.zeros(10), elements(steiner(m, c))
    across = phi[known] if central else phi[known] - lever[known - 4]
    body[[known, other]], body[4] = across, _SLENDER * across
    body[4:] += lever
    body[:4] = phi[:4]
    return body


@cache
def dd_arm(column: Column = "initial", *, likely: bool = False) -> Robot:
    phi = parameter_map(dd_arm_chain()) @ dd_arm_parameters(column, likely=likely)
    return load_robot(_NAME).with_parameters(phi)


def parameter_map(chain: DHChain) -> Array:
    """B with φ(joint frames) = B φ(link frames), shape (10 nv, 10 nv)."""
    B = np.zeros((10 * chain.nv, 10 * chain.nv))
    for i, T in enumerate(joint_frames(chain)):
        part = slice(10 * i, 10 * i + 10)
        B[part, part] = moved_parameters(np.eye(10), T).T
    return B
