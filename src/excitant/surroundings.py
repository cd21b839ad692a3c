"""What an arm is to keep within and clear of, as commands and Python functions take it."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Surroundings:
    """Limits, and what the arm must keep clear of."""

    limits: str | None = None
    "YAML or JSON with limits to use instead."
    mass_uncertainty: float = 0.0
    "Hold the torque limits even if each link's mass and inertia are larger or smaller by this [%]."
    obstacles: str | None = None
    "YAML with boxes, spheres, half-spaces, or a workspace of the tool."
    floor: float | None = None
    "Height of the floor in the base frame [m]; default: the plane that the base stands on."
    no_floor: bool = False
    "There is no floor."
    clearance: float | None = None
    "Least distance [m] to floor, obstacles and between bodies; default: 0.01 m."
    ignore_collisions: bool = False
    "Leave clearance out."
