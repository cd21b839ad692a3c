"""What is wrong with the given model: where its error shows, and what wrong values explain."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from excitant.analysis.diagnosis import Diagnosis
from excitant.analysis.domains import Places, band_shares, places, shares, telling
from excitant.analysis.forward import Forward, Simulated, forward
from excitant.analysis.refit import LIKELY, Move, Refit, refit
from excitant.analysis.sticking import Mask, sliding
from excitant.exceptions import ExcitantError
from excitant.robots.effects import InertialParameters, Payload, plain
from excitant.robots.motion import Array

_HARDLY = 0.1  # of the squared error: less is no explanation


def given_error_result(diagnosis: Diagnosis) -> dict[str, Any]:
    """Entries of result.json.

    ``error``: rms of the given model per joint, the share of its squared error that each quantity
    explains (`excitant.analysis.domains`), and what of it the extended model leaves.
    ``refit``: what inertias alone would explain. ``forward``: both models simulated forward.
    """
    entries: dict[str, Any] = {"error": {"joints": _shapes(diagnosis)}}
    try:
        entries["refit"] = _refit(diagnosis, refit(diagnosis))
    except ExcitantError as error:
        entries["refit"] = {"sentence": f"Inertias could not be fitted alone: {error}"}
    try:
        entries["forward"] = _forward(diagnosis, forward(diagnosis))
    except ExcitantError as error:
        entries["forward"] = {"joints": [], "notes": [f"Not simulated forward: {error}"]}
    return entries


def _shapes(diagnosis: Diagnosis) -> list[dict[str, Any]]:
    segments = diagnosis.data.validate
    where = places(segments, diagnosis.simulated)
    after = places(segments, diagnosis.predicted)
    moves, measured = sliding(segments), diagnosis.series.measured
    found = []
    for j, joint in enumerate(diagnosis.robot.joints):
        rows = moves[:, j] if moves[:, j].any() else ~moves[:, j]
        given, left = (
            _shape(measured - predicted, at, j, rows)
            for predicted, at in ((diagnosis.simulated, where), (diagnosis.predicted, after))
        )
        low, high = where.bands[j].tolist()
        found.append({"name": joint, **given, "left": left, "motion_hz": [low, high]})
    return found


def _shape(error: Array, where: Places, j: int, rows: Mask) -> dict[str, Any]:
    held = shares(error[:, j], where, j, rows)
    return {
        "rms": float(np.sqrt((error[rows, j] ** 2).mean())),
        "shares": held,
        "bands": band_shares(error[:, j], where, j),
        "telling": telling(held),
    }


def _refit(diagnosis: Diagnosis, found: Refit) -> dict[str, Any]:
    models = {
        "given": found.given,
        "inertias": found.free,
        "bodies": found.physical,
        "extended": found.extended,
    }
    moves = sorted(found.moves, key=lambda move: -move.most)
    return {
        "sentence": refit_sentence(diagnosis, found),
        "joints": [
            {"name": joint, **{key: float(each[j]) for key, each in models.items()}}
            for j, joint in enumerate(diagnosis.robot.joints)
        ],
        "possible": found.possible,
        "distance": found.distance,
        "most_moved": found.most_moved.link,
        "links": [
            {
                "link": move.link,
                "mass_kg": move.mass,
                "centre_mm": 1e3 * move.centre,
                "inertia": move.inertia,
                "deviations": dict(
                    zip(("mass", "centre", "inertia"), move.deviations, strict=True)
                ),
            }
            for move in moves
        ],
    }


def refit_sentence(diagnosis: Diagnosis, found: Refit) -> str:
    """What re-fitting the inertias alone would do, and whether it is believable."""
    share = 1 - _total(found.free, found) / max(_total(found.given, found), 1e-300)
    if share < _HARDLY:
        what = "would not help" if share < 0 else "would hardly help"
        return (
            f"Re-fitting the inertias alone {what} on the hold-out "
            f"({_quoted(diagnosis, found)}): the cause is not in their values."
        )
    said = (
        f"Re-fitting the inertias alone would take {100 * share:.0f} % of the squared error off "
        f"the hold-out ({_quoted(diagnosis, found)})"
    )
    if not found.possible:
        return f"{said}, but no bodies can have the values that this takes: the cause is elsewhere."
    move = found.most_moved
    if move.most <= LIKELY:
        return f"{said}, within what given values may be off."
    far = f"{said}, but {_farthest(move)} ({move.most:.0f} standard deviations of a given value)"
    if move.link in _wrong_links(diagnosis):
        return f"{far}: that link is among the findings."
    return f"{far}: unless that link is so wrong, the cause is elsewhere."


def _quoted(diagnosis: Diagnosis, found: Refit) -> str:
    """The joint with the largest error, before and after."""
    worst = int(np.argmax(found.given / np.maximum(found.spread, 1e-12)))
    given, free, after = (float(e[worst]) for e in (found.given, found.free, found.extended))
    said = f"{diagnosis.robot.joints[worst]} from {given:.3g} to {free:.3g} {diagnosis.data.unit}"
    return f"{said}; with the findings {after:.3g}" if diagnosis.findings else said


def _farthest(move: Move) -> str:
    which = int(np.argmax(move.deviations))
    if which == 0:
        return f"the mass of {move.link} would have to change by {move.mass:+.2g} kg"
    if which == 1:
        return f"the centre of mass of {move.link} would have to move {1e3 * move.centre:.0f} mm"
    change = 100 * (np.exp(move.inertia) - 1)
    return f"the inertia of {move.link} would have to change by {change:+.0f} %"


def _wrong_links(diagnosis: Diagnosis) -> set[str]:
    robot = diagnosis.robot
    return {
        robot.links[robot.joint_index(f.effect.joints[0])]
        for f in diagnosis.findings
        if isinstance(f.effect, InertialParameters | Payload)
    }


def _total(error: Array, found: Refit) -> float:
    """Squared error over all joints, each relative to its torque."""
    return float(((error / np.maximum(found.spread, 1e-12)) ** 2).sum())


def _forward(diagnosis: Diagnosis, found: Forward) -> dict[str, Any]:
    rows = []
    for j, joint in enumerate(diagnosis.robot.joints):
        turns = bool(diagnosis.robot.revolute[j])
        rows.append(
            {
                "name": joint,
                "given": float(found.given.position[j]),
                "extended": float(found.extended.position[j]),
                "unit": "rad" if turns else "m",
                "velocity": {
                    "given": float(found.given.velocity[j]),
                    "extended": float(found.extended.velocity[j]),
                    "unit": "rad/s" if turns else "m/s",
                },
            }
        )
    return {
        "joints": rows,
        "windows": found.windows,
        "window_s": found.seconds,
        "bandwidth_hz": found.bandwidth_hz,
        "notes": [
            *_notes("given", found.given),
            *_notes("extended", found.extended),
        ],
    }


def _notes(which: str, simulated: Simulated) -> Sequence[str]:
    if simulated.diverged:
        return (f"The {which} model leaves the motion for good: {simulated.diverged}.",)
    if simulated.along:
        names = ", ".join(plain(name) for name in simulated.along)
        return (f"In the {which} model, torque of {names} was taken along the recorded motion.",)
    return ()
