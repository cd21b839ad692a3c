"""Standard and base parameters: a link's by definition, an arm's as data showed them.

A link's standard parameters have the order of Pinocchio's ``Inertia.toDynamicParameters``:
m, mcx, mcy, mcz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz; inertia about the joint frame.

The pseudo-inertia (Wensing, Kim, Slotine 2018) of a body is

    P = [[Σ, m c], [(m c)ᵀ, m]],   Σ = ½ tr(I) 1 − I,

and a body of positive mass density exists for the parameters exactly when P ≻ 0.
"""

import csv
import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from excitant.exceptions import BadRobot
from excitant.robots.motion import Array, freeze

STANDARD = ("m", "mcx", "mcy", "mcz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
PLACEHOLDER = 5e-4  # of an arm's mass: a moving link of less only holds a place
UNITS = ("kg", "kg·m", "kg·m", "kg·m", *("kg·m²",) * 6)


PSEUDO_INERTIA_BASIS = np.array(
    [
        pin.PseudoInertia.FromDynamicParameters(unit).toMatrix()
        for unit in np.eye(10)
    ]
)
"""P(φ) = Σ_k φ_k · PSEUDO_INERTIA_BASIS[k], shape (10, 4, 4)."""


def pseudo_inertia(phi: npt.ArrayLike) -> Array:
    """Pseudo-inertia of one link or of many.

    Args:
        phi: Standard parameters, shape (..., 10).

    Returns:
        Shape (..., 4, 4).
    """
    phi = np.asarray(phi, float)
    P = phi @ PSEUDO_INERTIA_BASIS.reshape(10, 16)
    return P.reshape(*phi.shape[:-1], 4, 4)


def from_pseudo_inertia(P: npt.ArrayLike) -> Array:
    """Standard parameters, shape (..., 10), of pseudo-inertias, shape (..., 4, 4)."""
    P = np.asarray(P, float)
    sigma = P[..., :3, :3]
    inertia = (
        np.trace(sigma, axis1=-2, axis2=-1)[..., None, None] * np.eye(3) - sigma
    )
    return np.concatenate(
        [P[..., 3, 3:], P[..., :3, 3], elements(inertia)], axis=-1
    )


def moved_parameters(phi: npt.ArrayLike, T: npt.ArrayLike) -> Array:
    """Standard parameters of the same body about another frame, P ← T P Tᵀ; linear in them.

    Args:
        phi: Standard parameters, shape (..., 10).
        T: Pose of the old frame in the new one, shape (..., 4, 4).
    """
    T = np.asarray(T, float)
    return from_pseudo_inertia(T @ pseudo_inertia(phi) @ np.swapaxes(T, -1, -2))


def elements(tensor: Array) -> Array:
    """(I_xx, I_xy, I_yy, I_xz, I_yz, I_zz) of tensors, shape (..., 3, 3) to (..., 6)."""
    return tensor[..., [0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]


def steiner(mass: float, c: Array) -> Array:
    """M (c² 1 − c cᵀ): what a tensor about the centre of mass lacks of one about −c, (3, 3)."""
    return mass * (c @ c * np.eye(3) - np.outer(c, c))


def inertia(phi: npt.ArrayLike) -> pin.Inertia:
    """Pinocchio's inertia of one link, shape (10,); a link without mass has no first moment."""
    phi = np.asarray(phi, float)
    if phi[0] != 0:
        return pin.Inertia.FromDynamicParameters(phi)
    tensor = np.array([phi[[4, 5, 7]], phi[[5, 6, 8]], phi[[7, 8, 9]]])
    return pin.Inertia(0.0, np.zeros(3), tensor)


def _lever_moment(P: Array) -> Array:
    """Second moment of the mass if it were all in its centre, m c cᵀ, (3, 3)."""
    return np.outer(P[:3, 3], P[:3, 3]) / P[3, 3]


def violations(phi: npt.ArrayLike, links: tuple[str, ...]) -> list[str]:
    """Links that no body of positive density can have, each with the violated inequality.

    Args:
        phi: Standard parameters of all links, shape (10 · links,).
        links: Names of the links.

    Returns:
        One sentence per offending link.
    """
    sentences = []
    for link, P in zip(
        links, pseudo_inertia(np.reshape(phi, (-1, 10))), strict=True
    ):
        if P[3, 3] <= 0:
            sentences.append(f"{link}: mass {P[3, 3]:.4g} kg is not positive")
            continue
        second = np.linalg.eigvalsh(P[:3, :3] - _lever_moment(P))
        low, middle, high = np.sort(second.sum() - second)
        if low <= 0:
            sentences.append(
                f"{link}: inertia about the centre of mass is not positive "
                f"(smallest principal moment {low:.4g} kg·m²)"
            )
        elif second[0] <= 0:
            sentences.append(
                f"{link}: principal moments break the triangle inequality "
                f"({high:.4g} > {low:.4g} + {middle:.4g} kg·m²)"
            )
    return sentences


def isotropic(phi: npt.ArrayLike) -> Array:
    """A body of the same mass, centre of mass and radius of gyration, alike in all directions.

    The scale for "ten per cent of a link" that does not shrink with the link's thickness.

    Args:
        phi: Consistent standard parameters of one link, shape (10,).
    """
    P = pseudo_inertia(phi)
    lever = _lever_moment(P)
    P[:3, :3] = np.trace(P[:3, :3] - lever) / 3 * np.eye(3) + lever
    return from_pseudo_inertia(P)


def nearest_consistent(phi: npt.ArrayLike) -> Array:
    """Parameters of one link moved to the nearest pseudo-inertia bounded away from singular.

    The second moment about the centre of mass is clipped at 1e-4 of its largest eigenvalue (or,
    for a point mass, at a radius of gyration of 1 cm); mass and first moment are kept.

    Args:
        phi: Standard parameters of one link with positive mass, shape (10,).
    """
    P = pseudo_inertia(phi)
    point = P[3, 3] * 0.01**2  # kg·m²: a link is not a point
    if point <= 0:
        raise ValueError(f"mass {P[3, 3]} kg is not positive")
    lever = _lever_moment(P)
    values, vectors = np.linalg.eigh(P[:3, :3] - lever)
    floor = 1e-4 * max(values[-1], point) if values[-1] > 0 else point
    if values[0] >= floor:
        return np.array(phi, float)
    P[:3, :3] = (vectors * np.maximum(values, floor)) @ vectors.T + lever
    return from_pseudo_inertia(P)


_AGAIN = "write the model again, or leave its entry 'estimate' out"
_ROUNDING = 1e-8  # of a correlation


@dataclass(frozen=True, eq=False)
class BaseEstimate:
    """Base parameters of links and effects by the data alone.

    Attributes:
        names: The parameter that each is written with, r of them.
        value: Their values, shape (r,).
        covariance: Of their errors, positive definite, shape (r, r).
    """

    names: tuple[str, ...]
    value: Array
    covariance: Array

    def __post_init__(self) -> None:
        # but for rounding it is
        symmetric = (self.covariance + self.covariance.T) / 2
        object.__setattr__(self, "covariance", symmetric)
        freeze(self, "value", "covariance")

    def csv(self) -> str:
        """A line for each: name, value and its row of the covariance, every digit kept."""
        text = io.StringIO()
        table = csv.writer(text, lineterminator="\n")
        table.writerow(["parameter", "value", *self.names])
        numbers = np.column_stack([self.value, self.covariance]).tolist()
        for name, row in zip(self.names, numbers, strict=True):
            table.writerow([name, *row])
        return text.getvalue()


def base_estimate_from_csv(text: str, path: Path) -> BaseEstimate:
    """The table that `BaseEstimate.csv` writes; `BadRobot` where a text holds none."""
    import pandas as pd

    why = "not a table 'parameter,value,...' of base parameters with a column for each"
    try:
        table = pd.read_csv(io.StringIO(text), index_col="parameter", dtype=str)
        numbers = table.to_numpy(float)
    except ValueError as error:
        raise BadRobot(path, f"{why} ({error}); {_AGAIN}") from None
    names = tuple(map(str, table.index))
    if not names or list(table.columns) != ["value", *names]:
        raise BadRobot(path, f"{why}; {_AGAIN}")
    if not np.isfinite(numbers).all() or not is_covariance(numbers[:, 1:]):
        why = "its values are not finite, or its covariance not symmetric and positive definite"
        raise BadRobot(path, f"{why}; {_AGAIN}")
    return BaseEstimate(names, numbers[:, 0], numbers[:, 1:])


def is_covariance(matrix: Array) -> bool:
    """Whether a matrix, (r, r), is finite, symmetric and, as correlations, positive definite."""
    variance = np.diag(matrix)
    if not np.isfinite(matrix).all() or not (variance > 0).all():
        return False
    unit = matrix / np.sqrt(np.outer(variance, variance))
    return bool(
        np.abs(unit - unit.T).max() <= _ROUNDING and np.linalg.eigvalsh(unit)[0] > 0
    )
