"""What is chosen before the final fit: shapes of effects, cut-offs, dead zone, estimator."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from excitant.identify.cutoff_harmonics import Harmonics
from excitant.identify.cutoff_study import Study, study
from excitant.identify.estimator_choice import AUTO, EstimatorChoice, estimator_for
from excitant.identify.knowledge import Knowledge
from excitant.identify.least_squares import LeastSquares
from excitant.identify.physical import PhysicalFit
from excitant.identify.recording import Recording
from excitant.identify.rows import FitRows
from excitant.identify.shape_search import refined_shapes
from excitant.identify.shapes import Shapes
from excitant.robots.motion import Array
from excitant.robots.robot import Robot

_OF_ROWS = ("ols", "wls", "irls", "gls", "tls")  # rows are all they see of a recording


@dataclass(frozen=True, eq=False)
class FitChoices:
    """Rows as they are to be fitted, by which estimator, and why.

    Attributes:
        rows: What is fitted.
        estimator: Its name.
        study: Cut-offs and dead zone; None where not asked for.
        contest: How estimators compared; None where one was asked for.
        shapes: Shapes of effects; None where there are none, or they are not to be chosen.
        notes: What the user should know, as sentences.
    """

    rows: FitRows
    estimator: str
    study: Study | None = None
    contest: EstimatorChoice | None = None
    shapes: Shapes | None = None
    notes: tuple[str, ...] = field(default=())

    def widened(self, fit: LeastSquares, physical: PhysicalFit) -> tuple[LeastSquares, PhysicalFit]:
        """Fits with the uncertainty of the shapes that they were made with."""
        if self.shapes is None or not self.shapes.better:
            return fit, physical
        return self.shapes.widened(fit, physical, self.rows.base)


def tuned_choices(
    robot: Robot,
    rows: FitRows,
    recordings: Sequence[Recording],
    estimator: str,
    prior: Array,
    knowledge: Knowledge,
    *,
    fixed: bool,
    harmonics: Harmonics | None,
) -> FitChoices:
    """Shapes, cut-offs, dead zone and, where it is to be chosen, the estimator.

    Args:
        robot: The arm that effects take their torque from.
        rows: Rows with one cut-off for all joints.
        recordings: Behind these rows, in order.
        estimator: A name, or ``"auto"``.
        prior: Standard parameters of the prior, shape (nv, 10).
        knowledge: What is known of the bodies.
        fixed: Keep that cut-off, because the user gave it.
        harmonics: Those of the motion as planned, if they are known.
    """
    shapes = refined_shapes(robot, rows, prior, knowledge)
    if shapes is not None and shapes.better:
        rows = shapes.rows(robot, rows)
    alone = estimator in (AUTO, *_OF_ROWS)
    found = study(robot, rows, recordings, fixed=fixed, untouched=not alone, harmonics=harmonics)
    contest = None
    if estimator == AUTO:
        contest = estimator_for(robot, found.rows, recordings, rows)
        estimator = contest.name
        if estimator not in _OF_ROWS:  # it looks at the recordings itself
            found = study(robot, rows, recordings, fixed=fixed, untouched=True)
    said = (
        shapes.sentence if shapes else "",
        *found.choice.notes,
        contest.sentence if contest else "",
    )
    notes = tuple(each for each in said if each)
    return FitChoices(found.rows, estimator, replace(found, shapes=shapes), contest, shapes, notes)


def plain_choices(
    robot: Robot, rows: FitRows, recordings: Sequence[Recording], estimator: str
) -> FitChoices:
    """The rows as they are, and the estimator where it is to be chosen.

    Args:
        robot: The arm that effects take their torque from.
        rows: Rows with one cut-off for all joints.
        recordings: Behind these rows, in order.
        estimator: A name, or ``"auto"``.
    """
    if estimator != AUTO:
        return FitChoices(rows, estimator)
    contest = estimator_for(robot, rows, recordings)
    return FitChoices(rows, contest.name, contest=contest, notes=(contest.sentence,))
