"""Files of the models that an identification and a diagnosis end in, or why there are none."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from excitant.analysis.diagnosis import Diagnosis
from excitant.identify.estimate import Estimate
from excitant.identify.export import Publication, publication, published
from excitant.identify.faults import proven
from excitant.identify.objections import of_data
from excitant.identify.repeats import unsure_zeros


def publication_of(noun: object, *, force: bool = False) -> Publication | None:
    """Publication of the model of an estimate or a diagnosis; None for any other noun."""
    if isinstance(noun, Estimate):
        return publication(noun, force=force)
    if isinstance(noun, Diagnosis):
        return extended_publication(noun, force=force)
    return None


def extended_publication(
    diagnosis: Diagnosis,
    faults: Sequence[Mapping[str, Any]] = (),
    *,
    force: bool = False,
) -> Publication:
    """Publication of the extended model.

    Faults, as `with_repairs` tells them, or a larger error on the hold-out than that of the
    given model forbid it unless by ``force``.
    """
    return published(
        diagnosis.extension.model,
        "extended",
        "extended.yaml",
        replace(diagnosis.holdout, predicted=diagnosis.extension.predicted),
        diagnosis.train.segments,
        force=force,
        against=of_data(
            [
                *proven(faults),
                *unsure_zeros(diagnosis.robot, diagnosis.differences),
            ]
        ),
    )
