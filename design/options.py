"""Options of a design, the same from Python and the command line."""

from dataclasses import dataclass
from typing import Literal

Columns = Literal["friction", "inertial"]
"""What a motion is to make visible: all that identify estimates, or the links only."""


@dataclass(frozen=True)
class Search:
    """Options of the motion and its optimisation."""

    duration: float = 10.0
    "Length of the motion [s]."
    periods: int | Literal["search"] = "search"
    "Equal periods that it has; 'search' for as many as lower the condition number."
    harmonics: int | Literal["search"] = 5
    "Harmonics of a period, or 'search' to add them as long as they lower the condition number."
    max_frequency: float = 2.5
    "Highest frequency [Hz] that a search for periods or harmonics goes to."
    criterion: Literal["condition", "d", "a", "e"] = "condition"
    (
        "What to make small: the condition number, or of the covariance the determinant (d), the "
        "trace (a) or the largest eigenvalue (e)."
    )
    columns: Columns = "friction"
    "What to make visible: all that identify estimates, or the links only."
    use: float = 0.9
    "Share of the limits on velocity, acceleration, torque and jerk that is used."
    starts: int | None = None
    "Number of searches; default: 16."
    jobs: int | None = None
    "Processes; default: all processors."
    cluster: str | None = None
    "Dask scheduler to search on, such as tcp://10.0.0.5:8786."
    seed: int = 0
    "Draws the starts."
    time_limit: float | None = None
    "Return the best so far after this time [s]."
