"""Whether an identified model is one to publish, and its files if so."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from excitant.identify.estimate import Estimate
from excitant.identify.export.files import DEFAULT_FORMATS, model_files

_AS_GOOD = 1.01  # times the error of the given model: what chance makes of equal ones


@dataclass(frozen=True)
class Publication:
    """What becomes of an identified model.

    Attributes:
        files: Its files by name; none when it is not published.
        published: Whether it is.
        note: Why not, or why it is nevertheless, as a sentence; empty when nothing is to say.
    """

    files: Mapping[str, str]
    published: bool
    note: str


def publication(
    estimate: Estimate, *, formats: Sequence[str] = DEFAULT_FORMATS, force: bool = False
) -> Publication:
    """Files of an identified model, unless the model as given predicts the hold-out better.

    It does when its nrmse, summed over the joints, is the smaller by more than 1 %.

    Args:
        estimate: What was identified.
        formats: Some of `FORMATS`.
        force: Publish whatever the hold-out says.

    Raises:
        UnknownName: A format that is not one of `FORMATS`.
        BadInput: An effect that code cannot hold.
    """
    gains = estimate.gains if estimate.data.unit == "A" else None
    files = model_files(estimate.model, "identified", "model.yaml", formats, gains)
    found, given = (
        float(np.nansum(accuracy.nrmse)) for accuracy in (estimate.validate, estimate.baseline)
    )
    if found <= _AS_GOOD * given:
        return Publication(files, True, "")
    why = (
        f"on the hold-out its nrmse summed over the joints is {found:.4g}, that of the model as "
        f"given {given:.4g}"
    )
    if force:
        return Publication(files, True, f"published because it was forced: {why}")
    return Publication({}, False, f"the identified model is not published: {why}; record a "
                       "motion that excites more, or give --force")  # fmt: skip
