"""The seed's arm and the recursion that judges its own: tables and the classical Newton-Euler.

Tables of the CMU DD Arm II (Khosla 1987, Tables 2 to 4): initial and estimated values.

The arm itself is ``load_robot("cmu_dd_arm_ii")``; its file says what is printed, what is derived
and what is assumed (all lengths are).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from excitant.robots.dh import DHChain, chain_from_record, joint_frames, moved_parameters
from excitant.robots.loading import builtin_record, load_robot
from excitant.robots.motion import Array
from excitant.robots.newton_euler import forward_recursion, select_torque
from excitant.robots.parameters import STANDARD
from excitant.robots.robot import Robot

Column = Literal["initial", "estimated"]

_NAME = "cmu_dd_arm_ii"
_M4, _M5 = 1.880, 0.937  # kg, initially; the tables estimate their sum only
_SLENDER = 0.2  # assumed: central moment along the arm relative to that across
_UNITS = {"I": "kg·m²", "mc": "kg·m"}


@dataclass(frozen=True)
class TableEntry:
    """One row of the tables.

    Attributes:
        name: Name as in the paper, e.g. ``m4s4z``, ``I6xy`` or ``m5+m4``.
        parameter: The standard parameter it is, e.g. ``link4.mcz``. Inertias are about the
            distal Denavit-Hartenberg frame of the link (I1zz about the centre of mass);
            products are +∫ x y dm, the opposite of the tensor element.
        unit: Unit.
        initial: Value from drawings, as read.
        estimated: Value from the experiment, as read.
        doubtful: Which column is in doubt: ``""``, ``"initial"``, ``"estimated"``, ``"both"``.
        printed: What the print or its scan shows, where in doubt.
        likely: What the doubtful value probably is; None when unknown or when as read.
        why: Reason for the doubt, one sentence.
    """

    name: str
    parameter: str
    unit: str
    initial: float
    estimated: float
    doubtful: str = ""
    printed: str = ""
    likely: float | None = None
    why: str = ""

    def value(self, column: Column, likely: bool = False) -> float:
        """The value of a column, as read or, where in doubt, as it probably is."""
        if likely and self.likely is not None and self.doubtful in (column, "both"):
            return self.likely
        return self.initial if column == "initial" else self.estimated


def dd_arm_tables() -> tuple[TableEntry, ...]:
    """The 46 rows of Tables 2 to 4, link 6 first, doubtful digits marked."""
    rows = []
    for row in builtin_record(_NAME).tables or ():
        symbol = str(row["parameter"]).split(".")[1]
        unit = next((u for start, u in _UNITS.items() if symbol.startswith(start)), "kg")
        rows.append(TableEntry(unit=unit, **row))
    return tuple(rows)


def dd_arm_chain() -> DHChain:
    """The arm in the paper's frames (standard Denavit-Hartenberg); lengths are assumed."""
    return chain_from_record(builtin_record(_NAME), _NAME)


def dd_arm_parameters(column: Column = "initial", *, likely: bool = False) -> Array:
    """Standard parameters of a column of the tables about the frames of `dd_arm_chain`.

    m4 + m5 is shared out as initially (1.880 to 0.937). What the tables leave out of links 1
    and 2 is assumed: centre of mass in the listed directions only, central moments across the
    arm equal, along it a fifth. No torque depends on it.

    Args:
        column: ``"initial"`` (physically consistent) or ``"estimated"`` (links 4 and 5 are not,
            as printed).
        likely: Doubtful values as they probably are instead of as read.

    Returns:
        Shape (60,), tensor elements, in the order of `excitant.robots.parameters.STANDARD`.
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
    mass_only = np.array([*phi[:4], *np.zeros(6)])
    m, c, offset = central_parameters(mass_only)  # offset is minus the parallel-axis term
    across = phi[known] if central else phi[known] + offset[(known - 3) // 3, (known - 3) // 3]
    body = np.zeros(10)
    body[0], body[[known, other]], body[4] = m, across, _SLENDER * across
    T = np.eye(4)
    T[:3, 3] = c
    return moved_parameters(body, T)


def dd_arm(column: Column = "initial", *, likely: bool = False) -> Robot:
    """The built-in arm with the parameters of a column; see `dd_arm_parameters`."""
    phi = parameter_map(dd_arm_chain()) @ dd_arm_parameters(column, likely=likely)
    return load_robot(_NAME).with_parameters(phi)


def classical_torque(
    chain: DHChain,
    q: npt.ArrayLike,
    dq: npt.ArrayLike,
    ddq: npt.ArrayLike,
    wrench: npt.ArrayLike | None = None,
) -> Array:
    """Torque by the classical recursion, eqs (1)–(9): motion and inertia of centres of mass.

    It shares the forward recursion with `modified_torque` and nothing else; in m, c and the
    central inertia it is not linear (the centre of mass enters as m c c').

    Args:
        chain: The arm with its parameters; masses not zero.
        q: Positions, shape (n, nv) [rad or m].
        dq: Velocities, shape (n, nv).
        ddq: Accelerations, shape (n, nv).
        wrench: As in `modified_torque`.

    Returns:
        Shape (n, nv) [N·m or N].
    """
    motion = forward_recursion(chain, q, dq, ddq)
    m, c, central = central_parameters(chain.phi.reshape(-1, 10))
    force, moment = np.split(
        np.broadcast_to(np.zeros(6) if wrench is None else wrench, (len(motion.dv), 6)), 2, axis=1
    )
    g = np.empty((*motion.dv.shape[:2], 6))
    turn = np.broadcast_to(np.eye(3), (len(g), 3, 3))
    for i in reversed(range(chain.nv)):
        w, dw, reach = motion.omega[:, i], motion.domega[:, i], motion.reach[:, i]
        F = m[i] * (motion.dv[:, i] + np.cross(dw, c[i]) + np.cross(w, np.cross(w, c[i])))
        N = dw @ central[i] + np.cross(w, w @ central[i])
        force = (turn @ force[..., None])[..., 0]
        moment = (turn @ moment[..., None])[..., 0] + np.cross(reach, force)
        moment = moment + np.cross(motion.p[:, i] + c[i], F) + N
        force = force + F
        g[:, i], turn = np.concatenate([force, moment], axis=1), motion.turn[:, i]
    return select_torque(chain, motion, g)


def central_parameters(phi: npt.ArrayLike) -> tuple[Array, Array, Array]:
    """Mass, centre of mass and inertia about it; (..., 10) to (...), (..., 3), (..., 3, 3)."""
    phi = np.asarray(phi, float)
    m = phi[..., 0]
    c = phi[..., 1:4] / m[..., None]
    frame = np.empty((*phi.shape[:-1], 3, 3))
    for k, (i, j) in enumerate(((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))):
        frame[..., i, j] = frame[..., j, i] = phi[..., 4 + k]
    square = np.sum(c * c, axis=-1)[..., None, None] * np.eye(3) - c[..., :, None] * c[..., None, :]
    return m, c, frame - m[..., None, None] * square


def parameter_map(chain: DHChain) -> Array:
    """B with φ(joint frames) = B φ(link frames), shape (10 nv, 10 nv)."""
    B = np.zeros((10 * chain.nv, 10 * chain.nv))
    for i, T in enumerate(joint_frames(chain)):
        part = slice(10 * i, 10 * i + 10)
        B[part, part] = moved_parameters(np.eye(10), T).T
    return B
