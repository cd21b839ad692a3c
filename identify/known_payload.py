"""KnownPayload: a body that was weighed, to be carried for the sake of what it shows."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from excitant.exceptions import BadInput
from excitant.robots.motion import Array
from excitant.robots.parameters import from_pseudo_inertia


@dataclass(frozen=True)
class KnownPayload:
    """A body on the last link, as weighed and measured.

    Attributes:
        mass: Its mass [kg].
        mass_std: Standard deviation of the mass [kg].
        centre: Its centre of mass in the frame of the last joint [m]; None where not known.
        centre_std: Standard deviation of the centre along each axis [m].
        inertia: Its inertia about the centre of mass, in that frame, Ixx, Ixy, Iyy, Ixz, Iyz, Izz
            [kg·m²]; None where not known. Needs the centre.
    """

    mass: float
    mass_std: float = 0.0
    centre: tuple[float, float, float] | None = None
    centre_std: float = 0.0
    inertia: tuple[float, float, float, float, float, float] | None = None

    def __post_init__(self) -> None:
        if not self.mass > 0 or min(self.mass_std, self.centre_std) < 0:
            raise BadInput(
                f"payload: {self.mass:g} ± {self.mass_std:g} kg; give a mass above 0 kg and "
                "standard deviations that are not negative"
            )
        if self.inertia is not None and self.centre is None:
            raise BadInput(
                "payload: its inertia is of no use without its centre of mass; give both"
            )

    @property
    def known(self) -> Array:
        """The standard parameters that are known, zero elsewhere, shape (10,)."""
        phi = np.zeros(10)
        phi[0] = self.mass
        if self.centre is not None:
            c = np.array(self.centre)
            P = np.zeros((4, 4))
            P[:3, :3], P[:3, 3], P[3, :3], P[3, 3] = np.outer(c, c), c, c, 1.0
            phi = self.mass * from_pseudo_inertia(P)
        if self.inertia is not None:
            phi[4:] += self.inertia
        return phi

    @property
    def open_parameters(self) -> slice:
        """Standard parameters that are not known."""
        if self.centre is None:
            return slice(1, 10)
        return slice(10, 10) if self.inertia is not None else slice(4, 10)

    def moved(self) -> tuple[KnownPayload, ...]:
        """Payloads that differ by a standard deviation of one thing that is known of it."""
        others = []
        if self.mass_std:
            others.append(replace(self, mass=self.mass + self.mass_std))
        if self.centre is not None and self.centre_std:
            for k in range(3):
                c = np.array(self.centre)
                c[k] += self.centre_std
                others.append(replace(self, centre=(float(c[0]), float(c[1]), float(c[2]))))
        return tuple(others)
