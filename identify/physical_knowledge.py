"""What is known of bodies as rows and restrictions of the physically consistent fit.

All of it is convex in the standard parameters: masses and their sum are linear; a centre of mass
c in a box is m c_lo ≤ m c ≤ m c_hi; in an ellipsoid of radii r around c₀ it is the second-order
cone ‖(m c − m c₀) / r‖ ≤ m; and a body of positive density inside an ellipsoid exists for
P ≻ 0 exactly when tr(P E) ≥ 0, the mean of 1 − ‖(x − c₀) / r‖² over its mass (Wensing, Kim,
Slotine 2018).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from excitant.exceptions import BadInput
from excitant.identify.knowledge import Box, Ellipsoid, Knowledge, LinkKnowledge, Quantity
from excitant.identify.physical_program import Restriction
from excitant.robots.motion import Array
from excitant.robots.parameters import PSEUDO_INERTIA_BASIS


@dataclass(frozen=True, eq=False)
class KnownRows:
    """Knowledge of standard parameters φ, all in units of the standard deviation.

    Attributes:
        C: Rows with C φ ≈ d, shape (c, 10 links).
        d: Shape (c,).
        restrictions: What holds exactly, about φ.
    """

    C: Array
    d: Array
    restrictions: tuple[Restriction, ...]


def known_rows(knowledge: Knowledge, links: Sequence[str]) -> KnownRows:
    """Knowledge about the links of an arm.

    Raises:
        BadInput: Knowledge of a link that the arm does not have.
    """
    for name in knowledge.links:
        if name not in links:
            raise BadInput(f"{knowledge.source}: links: the arm has no link '{name}'")
    p, masses = 10 * len(links), np.zeros(10 * len(links))
    masses[::10] = 1.0
    about: list[tuple[str, Array, Quantity | None]] = [("total_mass", masses, knowledge.total_mass)]
    restrictions: list[Restriction] = []
    for k, name in enumerate(links):
        known = knowledge.links.get(name, LinkKnowledge())
        about.append((f"mass of {name}", np.eye(p)[10 * k], known.mass))
        for each in _places(known, name):
            G = np.zeros((len(each.h), p))
            G[:, 10 * k : 10 * k + 10] = each.G
            restrictions.append(Restriction(each.cone, G, each.h, each.name))
    rows, values = [np.zeros((0, p))], [np.zeros(0)]
    for name, row, quantity in about:
        if quantity is None:
            continue
        if quantity.std:
            rows.append(row[None] / quantity.std)
            values.append(np.array([quantity.value / quantity.std]))
        else:
            what, h = f"{name} = {quantity.value:g} kg", np.array([quantity.value])
            restrictions.append(Restriction("zero", row[None], h, what))
    return KnownRows(np.vstack(rows), np.concatenate(values), tuple(restrictions))


def _places(known: LinkKnowledge, name: str) -> Iterator[Restriction]:
    """Restrictions of one link's ten parameters."""
    if known.com_box is not None:
        yield from _in_box(known.com_box, f"com_box of {name}")
    if known.com_ellipsoid is not None:
        yield _in_ellipsoid(known.com_ellipsoid, f"com_ellipsoid of {name}")
    if known.body_ellipsoid is not None:
        yield _within(known.body_ellipsoid, f"body_ellipsoid of {name}")


def _in_box(box: Box, name: str) -> Iterator[Restriction]:
    """Centre of mass in a box; where it has no width, a coordinate is known."""
    first, mass = np.eye(10)[1:4], np.eye(10)[0]
    low, high = np.array(box.low), np.array(box.high)
    flat = low == high
    G = np.vstack([first - np.outer(low, mass), np.outer(high, mass) - first])
    wide = np.concatenate([~flat, ~flat])
    if wide.any():
        yield Restriction("nonnegative", G[wide], np.zeros(int(wide.sum())), name)
    if flat.any():
        yield Restriction("zero", G[:3][flat], np.zeros(int(flat.sum())), name)


def _in_ellipsoid(ellipsoid: Ellipsoid, name: str) -> Restriction:
    first, mass = np.eye(10)[1:4], np.eye(10)[0]
    centre, radii = np.array(ellipsoid.centre), np.array(ellipsoid.radii)
    offset = (first - np.outer(centre, mass)) / radii[:, None]
    return Restriction("second_order", np.vstack([mass, offset]), np.zeros(4), name)


def _within(ellipsoid: Ellipsoid, name: str) -> Restriction:
    centre, weight = np.array(ellipsoid.centre), np.array(ellipsoid.radii) ** -2.0
    E = np.zeros((4, 4))
    E[:3, :3] = -np.diag(weight)
    E[:3, 3] = E[3, :3] = weight * centre
    E[3, 3] = 1 - weight @ centre**2
    row = np.einsum("kij,ij->k", PSEUDO_INERTIA_BASIS, E)
    return Restriction("nonnegative", row[None], np.zeros(1), name)
