"""Persistency of excitation: whether a motion shows the parameters, and which joint lacks.

Rows W of torque noise σ carry the information J = Σ Wᵀ σ⁻² W about the base parameters. The
eigenvalues of LᵀJL, P = LLᵀ what is known beforehand, say how many times more a window knows than
the prior, direction by direction. Directions that a reference motion of all joints, as long as the
window, does not show above the noise are left out. A motion is persistently exciting at level α
over a window when in every such window no visible direction falls below α; level 1 is what it takes
to know a parameter better from the window than from the prior.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy

from excitant.exceptions import BadInput
from excitant.identify.information import square_root
from excitant.identify.prior import (
    REFERENCE,
    BasePrior,
    base_prior,
    needed_torque,
    reference_motion,
)
from excitant.identify.rows import effects_of
from excitant.robots.base_parameters import BaseParameters, base_parameters
from excitant.robots.effects import Effect
from excitant.robots.motion import Array, Motion, Noun
from excitant.robots.robot import Robot
from excitant.robots.torque import observation_columns

ROWS_PER_SECOND = 20.0  # independent rows of torque filtered at 10 Hz
# noise of a row in parts of the torque of a reference motion, when not known
_NOISE_SHARE = 0.01
_ENOUGH = 1.0  # the window knows as much as the prior
_VISIBLE = (
    10.0  # level of a reference motion that makes a direction worth asking for
)


@dataclass(frozen=True, eq=False)
class WindowExcitation(Noun):
    """Excitation in a window of a motion, from start to end [s]."""

    start: float
    end: float
    levels: Array  # of each visible direction, ascending, shape (v,)
    # at most three base parameters that lead the weakest direction below level 1
    weakest: tuple[str, ...] = ()
    # whose motion is missing, that which would help most first
    joints: tuple[str, ...] = ()
    # of all combinations, those better known from the window than from the prior
    shown: int = 0
    # base parameters of links and effects, whether a motion can show them
    combinations: int = 0

    @property
    def level(self) -> float:
        """Level of the weakest visible direction."""
        return float(self.levels[0]) if len(self.levels) else np.inf

    @property
    def missing(self) -> int:
        """Number of visible directions below level 1."""
        return int((self.levels < _ENOUGH).sum())

    @property
    def enough(self) -> bool:
        """Whether every visible direction reaches level 1."""
        return self.missing == 0

    @property
    def summary(self) -> str:
        """The finding on a whole motion in words."""
        if not len(self.levels):
            return "no motion of this arm shows any parameter above the noise"
        length = f"{self.end - self.start:.3g} s"
        if not self.enough:
            return (
                f"not persistently exciting over {length}: {self.count} become better known than "
                f"they were; of the {len(self.levels)} that a motion can show, {self.missing} are "
                f"missing (level {self.level:.2g}), first of all "
                f"{self.weakest[0]}{self.advice}"
            )
        rest = self.combinations - self.shown
        others = (
            f"; of the other {rest} no motion of this arm tells more in that time"
        )
        return (
            f"persistently exciting over {length} at level {self.level:.3g}: {self.count} become "
            f"better known than they were{others if rest else ''}"
        )

    def result(self) -> dict[str, Any]:
        """Its entry in ``result.json``."""
        return {
            "level": self.level,
            "shown": self.shown,
            "visible": len(self.levels),
            "missing": self.missing,
            "joints": self.joints,
            "sentence": self.summary,
        }

    @property
    def sentence(self) -> str:
        """The finding in words."""
        if self.enough:
            return f"exciting: shows {self.count} (level {self.level:.3g})"
        return (
            f"not exciting enough since {self.start:.1f} s: shows {self.count}, {self.missing} of "
            f"the {len(self.levels)} that a motion can show are missing{self.advice}"
        )

    @property
    def count(self) -> str:
        """How many of all combinations it shows, in words."""
        return f"{self.shown} of {self.combinations} combinations"

    @property
    def advice(self) -> str:
        """Joints to move, as the end of a sentence."""
        return f"; move {', '.join(self.joints)}" if self.joints else ""


def excitation(
    robot: Robot,
    effects: tuple[Effect, ...],
    base: BaseParameters,
    prior: BasePrior,
    motion: Motion,
    W: Array,
    sigma: Array | None = None,
) -> WindowExcitation:
    """Excitation in a window by evenly spread states.

    Args:
        robot: The arm.
        effects: Effects that are estimated.
        base: Base parameters of links and effects.
        prior: What is known of them beforehand.
        motion: The states, n of them, from the start of the window to its end.
        W: Columns of the base parameters there, shape (n, nv, r).
        sigma: Noise of an independent row, shape (nv,) [torque unit]; see `persistency`.
    """
    length = float(motion.t[-1] - motion.t[0])
    rate_hz = np.clip(ROWS_PER_SECOND, 40 / length, REFERENCE.rows / length)
    reference = reference_motion(robot, length, rate_hz)
    if sigma is None:
        sigma = _NOISE_SHARE * needed_torque(robot, reference)
    L = square_root(prior.covariance)
    to_compare = observation_columns(robot, effects, reference)[:, :, base.columns]
    whole = _information(ROWS_PER_SECOND / rate_hz, to_compare / sigma[:, None] @ L)
    levels, V = scipy.linalg.eigh(whole)
    # so that squares are levels; the first directions no motion shows above the noise
    basis = L @ V
    visible = basis[:, levels >= _VISIBLE]
    J = _information(_share(motion), W / sigma[:, None] @ basis)
    hidden = len(base) - visible.shape[1]
    levels, V = np.linalg.eigh(J[hidden:, hidden:])
    window = WindowExcitation(
        float(motion.t[0]),
        float(motion.t[-1]),
        np.maximum(levels, 0),
        shown=int((np.linalg.eigvalsh(J) >= _ENOUGH).sum()),
        combinations=len(base),
    )
    if window.enough:
        return window
    weak = visible @ V[:, : window.missing]
    helped = []
    for livelier in _livelier(motion, reference):
        columns = observation_columns(robot, effects, livelier)[:, :, base.columns]
        seen = columns / sigma[:, None] @ weak
        helped.append(_share(livelier) * (seen**2).sum(axis=(0, 1)))
    helps = np.array(helped) >= 0.5 * np.max(helped, axis=0)
    count = helps.sum(axis=1)
    order = np.argsort(-count, kind="stable")
    joints = tuple(robot.joints[j] for j in order if count[j])
    # base parameters that make nine tenths of the weakest, in units of prior spread
    spread = np.linalg.norm(visible, axis=1)
    share = (weak[:, 0] / np.where(spread > 0, spread, 1.0)) ** 2
    leading = np.argsort(-share)
    most = int(np.searchsorted(np.cumsum(share[leading]), 0.9 * share.sum())) + 1
    names = [base.names[base.columns[k]] for k in leading[: min(most, 3)]]
    return replace(window, weakest=tuple(names), joints=joints)


def _livelier(motion: Motion, reference: Motion) -> Iterator[Motion]:
    """The motion with one joint after the other moving as in the reference."""
    n = min(len(motion), len(reference))
    thin, other = (
        each[np.linspace(0, len(each) - 1, n).astype(int)]
        for each in (motion, reference)
    )
    for j in range(motion.nv):
        own = np.arange(motion.nv) == j
        pairs = ((thin.q, other.q), (thin.dq, other.dq), (thin.ddq, other.ddq))
        yield Motion(other.t, *(np.where(own, y, x) for x, y in pairs))


def _share(motion: Motion) -> float:
    """Independent rows per row of a motion."""
    step = (motion.t[-1] - motion.t[0]) / max(len(motion) - 1, 1)
    return float(min(1.0, ROWS_PER_SECOND * step)) if step > 0 else 1.0


def _information(share: float, rows: Array) -> Array:
    return share * np.tensordot(rows, rows, ((0, 1), (0, 1)))


def persistency(
    robot: Robot,
    motion: Motion,
    effects: Sequence[Effect] | None = None,
    *,
    sigma: Array | None = None,
) -> WindowExcitation:
    """Whether a motion, evenly sampled, is persistently exciting over its length.

    The robot's inertias are the prior; effects are friction, offset and rotor inertia when None;
    sigma, the noise of an independent row of torque, shape (nv,) [torque unit], is 1 % of the
    torque of a reference motion when None.

    Raises:
        BadInput: A motion without duration.
    """
    duration = float(motion.t[-1] - motion.t[0])
    if not duration > 0:
        raise BadInput(
            f"excitation: a motion of {duration:.4g} s; give one that lasts"
        )
    effects = effects_of(robot, effects)
    base = base_parameters(robot, effects)
    prior = base_prior(robot, effects, base)
    step = int((len(motion) - 1) / (duration * 2 * ROWS_PER_SECOND))
    thin = motion[:: max(1, step)]
    W = observation_columns(robot, effects, thin)[:, :, base.columns]
    return excitation(robot, effects, base, prior, thin, W, sigma)
