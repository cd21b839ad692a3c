"""Arms of which everything is known: their motion, their recordings, and whitened rows of them."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from arms import Truth

from excitant.identify import Recording
from excitant.identify.knowledge import Knowledge
from excitant.identify.physical import PhysicalFit, fit_physical
from excitant.identify.prior import BodyPrior, EffectPrior, prior_parameters
from excitant.identify.rows import FitRows, fit_rows, split
from excitant.robots import Array, Motion, Robot, base_parameters, load_robot
from excitant.robots.effects import Effect, standard_effects
from excitant.robots.torque import observation_columns

HARMONICS = np.array([0.3, 0.5, 0.8, 1.3])  # Hz, far below the cut-off of the torque filter
Call = Callable[..., Any]  # a fixture that is a function
NONE = EffectPrior(*(np.zeros(0),) * 3)
Z95 = 1.959963984540054  # standard deviations on either side of 95 %


def smooth_motion(robot: Robot, t: Array, seed: int = 0, hz: Array = HARMONICS) -> Motion:
    """Sums of sines with random phases, differentiated on paper."""
    rng = np.random.default_rng(seed)
    phase = rng.uniform(0, 2 * np.pi, (len(hz), robot.nv))
    omega = 2 * np.pi * hz[:, None]
    size = rng.uniform(0.5, 1.0, phase.shape) * np.array([0.8, 0.5, 0.3, 0.15])[:, None]
    angle = omega * t[:, None, None] + phase
    orders = ((size * omega**k * np.sin(angle + k * np.pi / 2)).sum(axis=1) for k in range(3))
    return Motion(t, *orders)


def recorded(
    known: Truth, motion: Motion, seed: int, encoder: float = 0.0, noise: float = 0.02,
    friction: Callable[[Array], Array] = np.zeros_like,
) -> Recording:  # fmt: skip
    """Torque that no code of the product makes, seen by sensors with noise."""
    rng = np.random.default_rng(seed)
    tau = known.arm.torque(motion) + friction(motion.dq)
    tau += noise * np.sqrt((tau**2).mean(axis=0)) * rng.standard_normal(tau.shape)
    q = motion.q + encoder * rng.standard_normal(tau.shape)
    return Recording(f"run{seed}", "run.csv", motion.t, q, tau)


def write_csv(path: Path, run: Recording) -> Path:
    replace(run, dq=None).to_frame().to_csv(path, index=False)
    return path


def rows_of(
    robot: Robot, run: Recording, further: Sequence[Effect] = (), cutoff_hz: float = 10.0
) -> FitRows:
    effects = (*standard_effects(robot.joints), *further)
    return fit_rows(robot, effects, base_parameters(robot, effects), split([run], [run], cutoff_hz))


class Whitened:
    """Whitened rows R of an arm's states, its prior, and that of its friction."""

    def __init__(self, name: str, noise: float, effects: bool = True, n: int = 200) -> None:
        self.robot = robot = load_robot(name)
        fitted = standard_effects(robot.joints) if effects else ()
        motion = Motion(np.arange(n) / 100, *robot.random_motion(np.random.default_rng(1), n))
        W = observation_columns(robot, fitted, motion)
        self.R = W.reshape(-1, W.shape[2]) / noise
        self.prior, self.links = prior_parameters(robot), 10 * robot.nv
        lower = np.array([p.lower for e in fitted for p in e.parameters(robot)])
        self.effects = EffectPrior(np.zeros_like(lower), np.full_like(lower, 1e3), lower)

    def fit(self, z: Array, knowledge: Knowledge | None = None, sigma: float = 1) -> PhysicalFit:
        prior = BodyPrior(self.prior, sigma)
        return fit_physical(self.R, z, prior, self.effects, knowledge, self.robot.links)
