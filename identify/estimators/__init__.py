"""Estimators of base parameters under one interface: a `Regression` in, a `LeastSquares` out.

| name | for | source |
|---|---|---|
| `ols` | joints of like noise | Gauss 1809 |
| `wls` | joints of different noise; the default | Gautier 1997 |
| `irls` | wrong torques here and there | Huber and Ronchetti 2009 |
| `gls` | coloured torque noise | Cochrane and Orcutt 1949 |
| `iv` | noise in the motion | Janot, Vandanjon, Gautier 2014 |
| `tls` | errors of columns in known ratio | Van Huffel and Vandewalle 1991 |
| `oe` | noise in the motion: columns on the simulated one | Gautier, Janot, Vandanjon 2013 |
| `ml` | noise that joints share; periods that repeat | Swevers 1997; Olsen 2002 |

Some need more than rows: `iv` its instruments, `oe` a simulation
(`excitant.identify.estimators.closed_loop`), `ml` the noise between periods, if there are any
(`excitant.identify.estimators.periodic`).
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from excitant.exceptions import UnknownName
from excitant.identify.estimators.generalised import gls
from excitant.identify.estimators.halves import EverySecond, half_columns
from excitant.identify.estimators.instrumental import errors_in_variables, iv
from excitant.identify.estimators.maximum_likelihood import ml
from excitant.identify.estimators.ordinary import ols, wls
from excitant.identify.estimators.output_error import OutputError, oe, output_error
from excitant.identify.estimators.regression import Estimator, Regression
from excitant.identify.estimators.robust import HUBER, STUDENT, Influence, irls
from excitant.identify.estimators.total import tls

ESTIMATORS: Mapping[str, Estimator] = MappingProxyType(
    {"ols": ols, "wls": wls, "irls": irls, "gls": gls, "iv": iv, "tls": tls, "oe": oe, "ml": ml}
)
"""Every estimator by its name."""

DESCRIPTIONS: Mapping[str, str] = MappingProxyType(
    {
        "ols": "ordinary least squares",
        "wls": "weighted least squares",
        "irls": "robust regression (iteratively reweighted, Student's t)",
        "gls": "generalised least squares (rows prewhitened)",
        "iv": "instrumental variables (even and odd samples)",
        "tls": "total least squares",
        "oe": "output error (closed loop simulated, DIDIM)",
        "ml": "maximum likelihood (periods averaged)",
    }
)
"""What every estimator is, in words."""


def estimator_named(name: str) -> Estimator:
    """The estimator of a name.

    Raises:
        UnknownName: There is none.
    """
    if name not in ESTIMATORS:
        raise UnknownName("estimator", name, ESTIMATORS)
    return ESTIMATORS[name]


__all__ = [
    "DESCRIPTIONS",
    "ESTIMATORS",
    "HUBER",
    "STUDENT",
    "Estimator",
    "EverySecond",
    "Influence",
    "OutputError",
    "Regression",
    "errors_in_variables",
    "estimator_named",
    "gls",
    "half_columns",
    "irls",
    "iv",
    "ml",
    "oe",
    "ols",
    "output_error",
    "tls",
    "wls",
]
