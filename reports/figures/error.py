"""Errors as bars, of each joint by model."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from excitant.reports import values as v
from excitant.reports.figure import FITTED, GIVEN, Bar, Bars, Key
from excitant.reports.figures.torque import GIVEN_MODEL
from excitant.results import Accuracy

_SHARE = "rms of residual, share of the measured torque's std"
_TALLEST = 4.0  # times the median error, or 1.5: bars beyond are cut


def error_bars(
    joints: Sequence[str],
    models: Sequence[Sequence[Accuracy]],
    unit: str,
    identified: str,
    what: str,
) -> Bars | None:
    """Errors per joint as bars as long as nrmse, or else rms, which stands beside.

    Args:
        joints: Names of the joints.
        models: Errors by joint of the given model and of the ``identified`` one, named so.
        unit: Of the errors.
        identified: Name of the second model.
        what: The words that begin the caption.
    """
    errors = [
        [(row.rms, row.nrmse) for row in rows] for rows in zip(*models, strict=True)
    ]
    count = 1 + any(rms is not None for pairs in errors for rms, _ in pairs[1:])
    looks = ((GIVEN_MODEL, GIVEN), (identified, FITTED))[:count]
    every = [pair for pairs in errors for pair in pairs[:count]]
    shares = all(share is not None or rms is None for rms, share in every)
    lengths = [x for pair in every if (x := pair[shares]) is not None]
    if not lengths:
        return None
    top = max(lengths)
    if shares:  # one useless model must not make all other bars invisible
        top = min(top, max(1.5, _TALLEST * float(np.median(lengths))))
    rows = []
    remarks = []
    for joint, pairs in zip(joints, errors, strict=True):
        bars = []
        for pair, (label, colour) in zip(pairs, looks, strict=False):
            length = pair[shares]
            words = v.quantity(pair[0], unit)
            remarks.append(f"{label} {words} at {joint}")
            if length is not None and length > top:
                words += " (bar cut)"
            pieces = () if length is None else ((min(length, top), colour),)
            bars.append(Bar(pieces, words))
        rows.append((joint, bars))
    measure = (
        "as a share of the measured torque's standard deviation"
        if shares
        else "as rms"
    )
    return Bars(
        rows,
        _SHARE if shares else f"rms [{unit}]",
        top or 1.0,
        f"rms per joint: {'; '.join(remarks)}",
        f"{what}, {measure}; beside each bar the rms [{unit}]: shorter is better.",
        [Key("box", colour, label) for label, colour in looks],
    )
