"""Tables of an identification: joints, links, parameters, and what its user should know."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from excitant.identify.accuracy import Coverage, coverage, worse_joints
from excitant.identify.friction import curves_over_velocity, friction_curves
from excitant.identify.objections import Objection
from excitant.identify.prior import decided_by, placeholder_links
from excitant.identify.rows import states, units_of
from excitant.identify.unmodelled import impossible_values
from excitant.robots.base_parameters import categories
from excitant.robots.motion import Array
from excitant.robots.parameters import UNITS, inertia, violations
from excitant.robots.robot import Robot
from excitant.robots.torque import coefficients, known_values

if TYPE_CHECKING:
    from excitant.identify.estimate import Estimate

LARGE_CHANGE = 0.5
"""Of a nominal mass or of a link's length: it is named."""
IMPOSSIBLE_CHANGE = 5.0
"""Ratio of a mass to the nominal one, or the reverse, that no description of a link misses:
convention. A last link may carry any tool."""
SMALLEST_SHIFT = 0.01  # of a centre of mass [m]: a smaller one is not named
SURE_STDS = 2.0  # standard deviations by which a first moment must be off
_DECIDED_BY = {  # from the surest to the least sure
    "data": "by the data",
    "both": "between data and prior",
    "prior": "as shared out by the prior",
}


def body_changes(estimate: Estimate) -> list[dict[str, Any]]:
    """Mass and centre of mass of each link, given and identified, as ``result.json`` has them.

    ``moved`` says in words what differs by half of the given mass or of the link's length; None
    where nothing does, or where currents were recorded and no drive gain is known.
    """
    who = _deciders(estimate)
    drive = estimate.drive
    known = drive is None or bool(drive.known.any())
    bodies = estimate.physical.prior.bodies
    lengths = link_lengths(estimate.given, bodies)
    entries = []
    for k, link in enumerate(estimate.given.links):
        phi = estimate.phi[10 * k : 10 * k + 4]
        mass = float(phi[0])
        centre = phi[1:] / mass
        given = inertia(bodies[k])
        shift = float(np.linalg.norm(centre - given.lever))
        mass_by = who[10 * k]
        # by the least sure of its coordinates
        centre_by = max(who[10 * k + 1 : 10 * k + 4], key=[*_DECIDED_BY].index)
        changes = []
        if abs(mass - given.mass) >= LARGE_CHANGE * given.mass:
            shown = "" if mass_by == "data" else _shown_with(estimate, k)
            changes.append(
                f"mass {given.mass:.3g} → {mass:.3g} kg ({_DECIDED_BY[mass_by]}{shown})"
            )
        if shift >= max(LARGE_CHANGE * lengths[k], SMALLEST_SHIFT):
            changes.append(
                f"centre of mass by {1e3 * shift:.3g} mm ({_DECIDED_BY[centre_by]})"
            )
        entries.append(
            {
                "link": link,
                "mass": {"given": given.mass, "value": mass, "decided_by": mass_by},
                "centre": {
                    "given": given.lever.tolist(),
                    "value": centre.tolist(),
                    "shift": shift,
                    "decided_by": centre_by,
                },
                "moved": f"{link}: {' and '.join(changes)}"
                if changes and known
                else None,
            }
        )
    return entries


def of_bodies(estimate: Estimate) -> list[Objection]:
    """Objections to masses that no description misses so far, unless the data tell them alone."""
    bodies = zip(
        body_changes(estimate)[:-1], placeholder_links(estimate.given), strict=False
    )
    changes = {
        f"{body['link']} has {mass['value']:.2g} kg, not {mass['given']:.3g} kg as given": change
        for body, holds_a_place in bodies
        if body["moved"] and not holds_a_place
        if (mass := body["mass"])["decided_by"] != "data"
        and abs(change := np.log(mass["value"] / mass["given"]))
        > np.log(IMPOSSIBLE_CHANGE)
    }
    if not changes:
        return []
    why = f"{'; '.join(changes)}, which the data do not tell alone"
    advice = "excite more, or say what is known of these bodies (--knowledge)"
    if max(changes.values()) < 0 and 2 * len(changes) >= estimate.given.nv:
        signs = "of the opposite sign, or in another unit"
        advice = f"see whether torque is that of motors, {signs}; else {advice}"
    return [Objection(why, advice)]


def link_lengths(robot: Robot, bodies: Array) -> Array:
    """Lengths of links with these bodies, shape (nv, 10), each the longest of three, (nv,) [m].

    From the joint to the next one, to the centre of mass, or the radius of gyration.
    """
    places = list(robot.model.jointPlacements)
    lengths = []
    for k, phi in enumerate(bodies):
        body = inertia(phi)
        next_joint = [place.translation for place in places[k + 2 : k + 3]]
        radius = np.sqrt(np.trace(body.inertia) / 2 / body.mass)
        ends = (np.linalg.norm(end) for end in (body.lever, *next_joint))
        lengths.append(max(radius, *ends))
    return np.array(lengths)


def _shown_with(estimate: Estimate, k: int) -> str:
    """By how much the simplest sum is off the given one that holds the mass of a link, in words.

    Torque shows the sum, whatever the prior, and so a payload, wherever in the link it is: nothing
    else of that link and no effect is in it.
    """
    base = estimate.base
    given = estimate.given.phi
    links = base.regrouping[:, : given.size]
    excess = estimate.least_squares.beta - links @ given
    std = estimate.base_std
    own = links[:, 10 * k + 1 : 10 * k + 10]
    effects = base.regrouping[:, given.size :]
    beside = np.hstack([own, effects]).any(axis=1)
    holds = (links[:, 10 * k] != 0) & ~beside & (np.abs(excess) > SURE_STDS * std)
    members = np.where(holds, np.count_nonzero(links, axis=1), np.inf)
    i = np.argmin(members)
    if not holds[i]:
        return ""
    unit = UNITS[base.columns[i] % len(UNITS)]
    lever = links[i, 10 * k]
    alone = f"{excess[i] / lever:+.2g} ± {std[i] / abs(lever):.1g} kg"
    return (
        f"; {base.expressions[i]} is off by {excess[i]:+.3g} ± {std[i]:.1g} {unit}, "
        f"as {alone} of this link alone would be"
    )


def _deciders(estimate: Estimate) -> list[str]:
    """Who decided each parameter: of links that a spring may have moved, not the data alone."""
    who = decided_by(estimate.physical.influence, categories(estimate.base))
    undecided = estimate.physical.undecided
    owners = (name.rpartition(".")[0] for name in estimate.base.names)
    pairs = zip(who, owners, strict=True)
    return [
        "both" if by == "data" and owner in undecided else by for by, owner in pairs
    ]


def result_of(estimate: Estimate) -> dict[str, Any]:
    """Contents of the ``result.json`` of an identification."""
    robot = estimate.given
    broken = violations(estimate.phi, robot.links)
    half_width = estimate.interval.half_width
    error = np.abs(estimate.holdout.measured - estimate.predicted)
    beyond = estimate.holdout.counted(error - half_width)
    covered = coverage([e <= 0 for e in beyond])
    bodies = body_changes(estimate)
    drive = estimate.drive
    repeats = estimate.repeats
    return {
        "verb": "identify",
        "robot": robot.name,
        "estimator": f"{estimate.estimator}, then physically consistent semidefinite fit",
        "effects": [effect.name for effect in estimate.model.effects],
        "cutoff_hz": estimate.data.cutoff_hz,
        **({} if estimate.shapes is None else {"shapes": estimate.shapes.entry()}),
        "unit": robot.torque_unit(estimate.data.unit),
        "holdout": estimate.data.holdout,
        **({"drive_gain_Nm_per_A": None} if drive is None else drive.result()),
        "joints": _joints(estimate, covered),
        "links": bodies,
        "parameters": _parameters(estimate),
        "base_parameters": _base_parameters(estimate),
        **({} if repeats is None else {"repeats": repeats.entry()}),
        "reversals": [each.entry(robot) for each in estimate.reversals],
        "differences": [each.entry(robot) for each in estimate.differences],
        "physical": {
            "consistent": not broken,
            "violations": broken,
        },
        "knowledge": estimate.knowledge.entry(),
        "notes": [
            *estimate.notes,
            *(
                []
                if repeats is None
                else [repeats.sentence(estimate.least_squares.std)]
            ),
            *(each.sentence(robot) for each in estimate.differences),
            *_moved(estimate, bodies),
            *filter(None, [estimate.knowledge.sentence]),
            *_lacking(estimate),
            *_missed(robot.joints, covered),
        ],
    }


def series_of(estimate: Estimate) -> dict[str, Array]:
    """Torques and states on the hold-out, each of shape (n, nv), and curves of friction."""
    motion = states(estimate.data.validate)
    return {
        "t": estimate.holdout.t,
        "measured": estimate.holdout.measured,
        "given": estimate.predicted_given,
        "identified": estimate.predicted,
        "half_width": estimate.interval.half_width,
        "position": motion.q,
        "velocity": estimate.holdout.in_motion(motion.dq),
        **curves_over_velocity(friction_curves(estimate)),
    }


def _joints(estimate: Estimate, covered: Coverage) -> list[dict[str, Any]]:
    half_width = estimate.interval.half_width.mean(axis=0)
    by_parameters = estimate.interval.parameters.mean(axis=0)
    entries = []
    for j, curve in enumerate(friction_curves(estimate)):
        interval = {
            "half_width": float(half_width[j]),
            "half_width_parameters": float(1.96 * by_parameters[j]),
            "coverage": float(covered.share[j]),
        }
        entry = {
            "name": estimate.given.joints[j],
            "train": estimate.train.entry(j),
            "validate": estimate.validate.entry(j) | {"interval95": interval},
            "baseline": estimate.baseline.entry(j),
        }
        if curve is not None:
            entry["friction"] = curve.entry()
        entries.append(entry)
    return entries


def _parameters(estimate: Estimate) -> list[dict[str, Any]]:
    robot = estimate.given
    physical = estimate.physical
    effects = physical.estimated(estimate.model.effects)
    nominal = known_values(robot, effects)
    bodies = physical.prior.bodies.ravel().tolist()
    rows = zip(
        estimate.base.names,
        physical.x.tolist(),
        map(_known, estimate.std),
        units_of(robot, effects, estimate.drive),
        categories(estimate.base),
        nominal,
        [*bodies, *(None,) * (len(nominal) - len(bodies))],
        _deciders(estimate),
        strict=True,
    )
    entries = [
        {
            "name": name,
            "link": name.rpartition(".")[0],
            "value": factor * value,
            "std": std,
            "unit": unit,
            "category": kind,
            "given": None if given is None else factor * given,
            "prior": prior,
            "prior_dominated": by == "prior",
            "decided_by": by,
        }
        for name, value, std, (factor, unit), kind, given, prior, by in rows
        # poses show no inertia
        if estimate.data.poses is None or kind != "unidentifiable"
    ]
    return entries + _of_springs(estimate)


def _of_springs(estimate: Estimate) -> list[dict[str, Any]]:
    """Springs that the model has beside the estimated effects: bodies may share their torque."""
    robot = estimate.given
    springs = estimate.physical.springs
    units = units_of(robot, springs, estimate.drive)[robot.phi.size :]
    names = [p.name for p in coefficients(robot, springs)]
    values = [value for spring in springs for value in spring.values or ()]
    return [
        {
            "name": name,
            "link": name.rpartition(".")[0],
            "value": factor * value,
            "unit": unit,
            "category": "combined",
            "prior_dominated": False,
            "decided_by": "both",
            **dict.fromkeys(("std", "given", "prior")),
        }
        for name, value, (factor, unit) in zip(names, values, units, strict=True)
    ]


def _known(std: float) -> float | None:
    return None if np.isnan(std) else float(std)


def _base_parameters(estimate: Estimate) -> list[dict[str, Any]]:
    base = estimate.base
    repeats = estimate.repeats
    spread = [None] * len(base) if repeats is None else repeats.spread.tolist()
    beta = estimate.least_squares.beta.tolist()
    rows = zip(
        base.expressions,
        base.leading,
        base.regrouping,
        beta,
        map(_known, estimate.base_std),
        spread,
        strict=True,
    )
    return [
        {
            "expression": text,
            "link": leading.rpartition(".")[0],
            "coefficients": {
                base.names[k]: float(row[k]) for k in np.flatnonzero(row).tolist()
            },
            "value": None if std is None else value,
            "std": std,
            "rel_std": std / abs(value) if value and std is not None else None,
            "spread": apart,
        }
        for text, leading, row, value, std, apart in rows
    ]


def _moved(estimate: Estimate, bodies: Sequence[dict[str, Any]]) -> list[str]:
    """Sentences on how far the nominal bodies agree with the data, and which moved by half."""
    links = estimate.given.links
    # relative uncertainty of each
    std = np.broadcast_to(estimate.physical.prior.sigma, len(links))
    common = std.min()
    sentences = [
        f"the given bodies are off by about {100 * common:.0f} % where the recordings see them; as "
        "much is allowed for where they do not"
    ]
    wrong = np.flatnonzero(std > max(common, LARGE_CHANGE)).tolist()
    if wrong:
        listed = ", ".join(f"{links[k]} ({100 * std[k]:.0f} %)" for k in wrong)
        tool = _tool(estimate) if len(std) - 1 in wrong else ""
        sentences.append(
            f"the data contradict the given values of {listed}, for which as much is allowed{tool}"
        )
    if moved := "; ".join(body["moved"] for body in bodies if body["moved"]):
        sentences.append(f"moved by half or more against the given model: {moved}")
    return sentences


def _tool(estimate: Estimate) -> str:
    """What may hang on the last link, as far as the data alone determine it."""
    first = 10 * estimate.given.nv - 10
    given = estimate.physical.prior.bodies[-1]
    parts = []
    for k, axis in enumerate("xyz", start=1):
        excess = estimate.phi[first + k] - given[k]
        std = estimate.std[first + k]
        if abs(excess) > SURE_STDS * std:
            parts.append(f"{excess:+.3g} ± {std:.1g} kg·m along {axis}")
    moment = f", with a first moment of {', '.join(parts)}" if parts else ""
    return f": a payload or another tool{moment}?"


def _lacking(estimate: Estimate) -> list[str]:
    """Sentences on what shows that the model lacks something, if anything does."""
    robot = estimate.given
    base = estimate.base
    fit = estimate.least_squares
    effects = estimate.physical.estimated(estimate.model.effects)
    units = units_of(robot, effects, estimate.drive)
    values = []
    for i in impossible_values(robot, effects, base, fit):
        k = base.columns[i]
        factor, unit = units[k]
        spread = f"{factor * fit.beta[i]:.2g} ± {factor * fit.std[i]:.1g} {unit}"
        values.append(f"{base.names[k]} = {spread}")
    sentences = []
    if values:
        sentences.append(
            f"least squares ends where physics allows no arm: {', '.join(values)}; the data hold "
            "something there that the model lacks, as a spring, hysteresis or a lag, and the model "
            "keeps to what is possible; `--effects auto` looks for it"
        )
    least = estimate.holdout_columns @ fit.beta / estimate.gains
    if worse := worse_joints(
        robot.joints, estimate.holdout, estimate.predicted, least
    ):
        sentences.append(
            "least squares without regard to what bodies can be predicts the hold-out better than "
            f"the model, beyond chance, at {', '.join(worse)}: the model lacks something there; "
            "`excitant diagnose` looks for its cause"
        )
    return sentences


def _missed(joints: Sequence[str], covered: Coverage) -> list[str]:
    """A sentence on joints with coverage far from 95 %, where there are any."""
    low = np.flatnonzero(covered.too_few).tolist()
    if not low:
        return []
    shares = ", ".join(f"{joints[j]} {100 * covered.share[j]:.0f} %" for j in low)
    return [
        f"95 % intervals of the predicted torque hold less of the hold-out ({shares}): the model "
        "misses something there; `excitant diagnose` looks for its cause"
    ]
